// Who may include whom (docs/architecture.md), read from the sources themselves.
#include <doctest/doctest.h>

#include <filesystem>
#include <fstream>
#include <map>
#include <set>
#include <string>
#include <vector>

namespace fs = std::filesystem;

namespace {

struct Include {
  std::string file, target;
  bool ours;
};

// Every #include of the folders that hold libraries.
std::vector<Include> all_includes(const fs::path& root) {
  std::vector<Include> found;
  for (const char* folder : {"generator/core", "generator/render", "generator/dataset", "rigs", "textures", "scenes", "validate", "neural"})
    for (const auto& entry : fs::recursive_directory_iterator(root / folder)) {
      if (entry.path().extension() != ".cpp" && entry.path().extension() != ".h") continue;
      std::ifstream in(entry.path());
      for (std::string line; std::getline(in, line);) {
        if (line.rfind("#include", 0) != 0) continue;
        const auto open = line.find_first_of("<\""), close = line.find_first_of(">\"", open + 1);
        if (open == std::string::npos || close == std::string::npos) continue;
        found.push_back({fs::relative(entry.path(), root).string(), line.substr(open + 1, close - open - 1), line[open] == '"'});
      }
    }
  return found;
}

std::string folder_of(const std::string& file) { return fs::path(file).parent_path().string(); }

}  // namespace

TEST_CASE("libraries include only what the architecture lets them") {
  const std::map<std::string, std::set<std::string>> allowed = {
      {"generator/core", {"generator/core"}},
      {"generator/render", {"generator/core", "generator/render"}},
      {"generator/dataset", {"generator/core", "generator/dataset"}},
      {"rigs", {"generator/core", "rigs"}},
      {"textures", {"generator/core", "textures"}},
      {"scenes", {"generator/core", "generator/render", "generator/dataset", "rigs", "textures", "scenes"}},
      {"validate", {"generator/core", "generator/dataset", "rigs", "validate"}},
      {"validate/studies",
       {"generator/core", "generator/render", "generator/dataset", "rigs", "textures", "scenes", "validate", "validate/studies"}},
      {"neural", {"generator/core", "generator/dataset", "neural", "neural/kernels"}},
      {"neural/kernels", {"generator/core", "neural/kernels"}},
  };
  const auto includes = all_includes(MOOMILL_SOURCE_DIR);
  REQUIRE(includes.size() > 300);
  for (const Include& i : includes) {
    if (!i.ours || i.file == "neural/main.cpp") continue;
    INFO(i.file << " includes " << i.target);
    CHECK(allowed.at(folder_of(i.file)).count(folder_of(i.target)) == 1);
  }
}

TEST_CASE("every external library stands behind one file") {
  const std::map<std::string, std::string> owner = {
      {"embree3/", "generator/render/accel.cpp"}, {"tiny_gltf.h", "rigs/gltf.cpp"},   {"assimp/", "rigs/assimp.cpp"},
      {"toml++/", "generator/core/toml.h"},               {"turbojpeg.h", "generator/dataset/jpeg.cpp"},
      {"png.h", "generator/dataset/png.cpp"},     {"OpenEXR/", "generator/dataset/exr.cpp"},
      {"OpenImageIO/", "generator/dataset/oiio.cpp"},
  };
  std::map<std::string, int> seen;
  for (const Include& i : all_includes(MOOMILL_SOURCE_DIR)) {
    for (const auto& [library, file] : owner)
      if (!i.ours && i.target.rfind(library, 0) == 0) {
        INFO(i.file << " includes " << i.target);
        CHECK(i.file == file);
        ++seen[library];
      }
    if (i.target.rfind("torch/", 0) == 0 && folder_of(i.file) != "neural") FAIL_CHECK(i.file << " includes LibTorch");
  }
  CHECK(seen["embree3/"] > 0);
  CHECK(seen["tiny_gltf.h"] > 0);
  CHECK(seen["toml++/"] > 0);
}
