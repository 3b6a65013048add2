// Where species, coats and other files of a scene are looked for.
#include <set>

#include "generator/core/error.h"
#include "scenes/breed_file.h"
#include "scenes/scene.h"
#include "generator/core/words.h"

namespace moomill {
namespace fs = std::filesystem;
namespace {

bool is_file(const fs::path& p) {
  std::error_code ignored;
  return fs::is_regular_file(p, ignored);
}

bool looks_like_path(const std::string& s) {
  return s.find('/') != std::string::npos || fs::path(s).has_extension();
}

// Stems of the .toml files in a folder, sorted: their order must not depend on the file system.
std::set<std::string> toml_names(const fs::path& folder) {
  std::set<std::string> names;
  std::error_code ignored;
  for (const fs::directory_entry& e : fs::directory_iterator(folder, ignored))
    if (e.path().extension() == ".toml") names.insert(e.path().stem().string());
  return names;
}

// Of a species by name or by the path of its file.
fs::path coats_of_species(const std::string& species) {
  return data_root() / "textures" / (looks_like_path(species) ? fs::path(species).stem() : fs::path(species));
}

std::vector<std::string> shipped_species() {
  std::vector<std::string> names;
  std::error_code ignored;
  for (const fs::directory_entry& e : fs::directory_iterator(data_root() / "rigs", ignored)) {
    const std::string name = e.path().filename().string();
    if (is_file(e.path() / (name + ".toml"))) names.push_back(name);
  }
  std::sort(names.begin(), names.end());
  return names;
}

}  // namespace

fs::path find_file(const std::string& path, const fs::path& relative_to) {
  const fs::path p(path);
  if (p.is_absolute()) {
    if (is_file(p)) return p;
    input_error("there is no file {}; check the path", path);
  }
  for (const fs::path& folder : {relative_to, data_root()})
    if (is_file(folder / p)) return (folder / p).lexically_normal();
  const std::string here = relative_to.empty() ? "." : relative_to.string();
  input_error("there is no file {} in {} nor in {}; check the path", path, here, data_root().string());
}

fs::path find_species(const std::string& name_or_path, const fs::path& relative_to) {
  if (looks_like_path(name_or_path)) return find_file(name_or_path, relative_to);
  const fs::path file = data_root() / "rigs" / name_or_path / (name_or_path + ".toml");
  if (is_file(file)) return file;
  input_error("there is no species '{}' in {}{}", name_or_path, (data_root() / "rigs").string(),
              suggestion(name_or_path, shipped_species()));
}

std::vector<std::string> shipped_coats(const std::string& species) {
  std::set<std::string> names = toml_names(coats_of_species(species));
  names.erase("finish");  // what they all share
  return {names.begin(), names.end()};
}

fs::path find_finish(const std::string& species) {
  const fs::path file = coats_of_species(species) / "finish.toml";
  return is_file(file) ? file : fs::path();
}

fs::path find_coat(const std::string& name_or_path, const std::string& species, const fs::path& relative_to) {
  if (name_or_path == "own") return {};
  if (looks_like_path(name_or_path)) return find_file(name_or_path, relative_to);
  const fs::path folder = coats_of_species(species);
  const fs::path file = folder / (name_or_path + ".toml");
  if (is_file(file)) return file;
  std::vector<std::string> names = shipped_coats(species);
  names.push_back("own");
  input_error("there is no coat '{}' in {}{}", name_or_path, folder.string(), suggestion(name_or_path, names));
}

std::vector<std::string> shipped_breeds(const std::string& species) {
  const std::set<std::string> names = toml_names(coats_of_species(species) / "breeds");
  return {names.begin(), names.end()};
}

fs::path find_breed(const std::string& name_or_path, const std::string& species, const fs::path& relative_to) {
  if (looks_like_path(name_or_path)) return find_file(name_or_path, relative_to);
  const fs::path folder = coats_of_species(species) / "breeds";
  const fs::path file = folder / (name_or_path + ".toml");
  if (is_file(file)) return file;
  input_error("there is no breed '{}' in {}{}", name_or_path, folder.string(),
              suggestion(name_or_path, shipped_breeds(species)));
}

}  // namespace moomill
