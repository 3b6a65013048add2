// The species that ship, each by its own numbers: built, closed, of its size, with coats, clips and keypoints; and none
// of them named in the program.
#include <doctest/doctest.h>

#include <array>
#include <fstream>
#include <map>
#include <regex>
#include <set>

#include "rigs/check.h"
#include "scenes/scene.h"

using namespace moomill;
namespace fs = std::filesystem;

namespace {

struct Expectation {
  std::string species;
  std::size_t keypoints;
  std::vector<std::string> clips;
  double withers;  // metres, height of the back there
};

const std::vector<Expectation> expectations = {
    {"horse", 25, {"walk", "trot", "graze", "drink", "look_around", "idle"}, 1.62},
    {"giraffe", 26, {"walk", "browse", "drink", "look_around", "idle"}, 2.72},
};

const Species& shipped(const std::string& name) {
  static std::map<std::string, Species> known;
  auto found = known.find(name);
  if (found == known.end()) found = known.emplace(name, read_species(name, NnopcsNormalization::box, {})).first;
  return found->second;
}

}  // namespace

TEST_CASE("horse and giraffe are closed, of the size they say, with 30,000 to 120,000 triangles") {
  for (const Expectation& e : expectations) {
    INFO(e.species);
    const Species& s = shipped(e.species);
    const std::size_t triangles = s.rig.surface.triangles.size();
    CHECK(triangles >= 30000);
    CHECK(triangles <= 120000);
    const dvec3 size = s.rig.surface.neutral_box.size();
    CHECK(size.x == doctest::Approx(*s.expected_length).epsilon(0.02));
    CHECK(size.z == doctest::Approx(*s.expected_height).epsilon(0.02));
    CHECK(std::abs(s.rig.surface.neutral_box.lower.z) < 0.005);
    for (const Finding& f : check_species(s)) {
      INFO(f.text);
      CHECK(f.level != Finding::Level::wrong);
      CHECK(f.text.find("move no vertex") != std::string::npos);
    }
    // The top of the back above the joint of the withers.
    const dvec3 at = dvec3(world_transforms(s.rig, s.neutral)[s.rig.find_node("withers")][3]);
    double top = 0;
    for (const vec3& p : s.rig.surface.rest)
      if (std::abs(p.x - at.x) < 0.03 && std::abs(p.y) < 0.03f) top = std::max(top, static_cast<double>(p.z));
    CHECK(top == doctest::Approx(e.withers).epsilon(0.03));
  }
}

TEST_CASE("horse and giraffe have their keypoints, a skeleton that is a tree, and clips that keep them on the ground") {
  for (const Expectation& e : expectations) {
    INFO(e.species);
    const Species& s = shipped(e.species);
    CHECK(s.keypoints.size() == e.keypoints);
    CHECK(s.edges.size() == e.keypoints - 1);
    CHECK(s.pairs.size() == 8);
    for (const std::string& name : e.clips) {
      INFO(name);
      const int clip = s.rig.find_clip(name);
      REQUIRE(clip >= 0);
      for (int i = 0; i < 6; ++i) {
        const double time = s.rig.clips[clip].duration * i / 6;
        const std::vector<dmat4> world = world_transforms(s.rig, sample_clip(s.rig, s.rig.clips[clip], time));
        const PosedSurface posed = skin(s.rig, bone_matrices(s.rig, world), {}, s.skinning, dvec3(0));
        float lowest = 10;
        for (const vec3& p : posed.positions) lowest = std::min(lowest, p.z);
        CHECK(lowest > -0.045f);  // legs splayed wide stand on the edges of their hooves
        CHECK(lowest < (name == "trot" ? 0.10f : 0.03f));
      }
    }
  }
}

TEST_CASE("every coat of every species reads, and names parts that its animal has") {
  for (const Expectation& e : expectations) {
    const Species& s = shipped(e.species);
    const std::vector<std::string> coats = shipped_coats(e.species);
    CHECK(coats.size() >= 3);
    for (const std::string& name : coats) {
      INFO(e.species, " ", name);
      const Coat coat = read_coat(name, e.species, {});
      const auto& procedural = std::get<ProceduralCoat>(coat.source);
      std::vector<std::string> patterns;
      for (const PartColor& p : procedural.parts) patterns.push_back(p.part);
      for (const Shade& p : procedural.shades)
        if (!p.part.empty()) patterns.push_back(p.part);
      for (const Mark& p : procedural.marks)
        if (!p.part.empty()) patterns.push_back(p.part);
      for (const std::string& pattern : patterns) {
        INFO(pattern);
        CHECK(std::any_of(s.rig.part_names.begin(), s.rig.part_names.end(),
                          [&](const std::string& part) { return part_matches(pattern, part); }));
      }
    }
  }
}

TEST_CASE("a builder's scale makes the same animal in another size") {
  const fs::path file = fs::path(MOOMILL_SOURCE_DIR) / "rigs/horse/horse.toml";
  std::ifstream in(file);
  std::string text((std::istreambuf_iterator<char>(in)), {});
  const auto at = text.find("[builder]\n");
  REQUIRE(at != std::string::npos);
  text.insert(at + 10, "scale = 0.5\n");
  const fs::path folder = fs::temp_directory_path() / "moomill_half_horse";
  fs::create_directories(folder);
  std::ofstream(folder / "half.toml") << text;
  const Species half = read_species((folder / "half.toml").string(), NnopcsNormalization::box, {});
  fs::remove_all(folder);
  const Species& whole = shipped("horse");
  const dvec3 a = half.rig.surface.neutral_box.size(), b = whole.rig.surface.neutral_box.size();
  for (int i = 0; i < 3; ++i) CHECK(a[i] == doctest::Approx(0.5 * b[i]).epsilon(0.01));
}

TEST_CASE("no species is named in the code of the program, but in the examples of --help and of messages") {
  const std::regex species("\\b(cow|cows|horse|horses|giraffe|giraffes|cattle)\\b", std::regex::icase);
  int files = 0;
  for (const char* folder : {"rigs", "scenes", "textures", "generator", "validate"})
    for (const auto& entry : fs::recursive_directory_iterator(fs::path(MOOMILL_SOURCE_DIR) / folder)) {
      const std::string extension = entry.path().extension().string();
      if (extension != ".cpp" && extension != ".h") continue;
      // The public dataset's folders bear the name of its one animal; they are part of that format.
      if (entry.path().parent_path().filename() == "dataset") continue;
      ++files;
      std::ifstream in(entry.path());
      int number = 0;
      for (std::string line; std::getline(in, line);) {
        ++number;
        const auto comment = line.find("//");
        const std::string code = line.substr(0, comment);
        if (!std::regex_search(code, species)) continue;
        // Examples of --help and of messages show a species; nothing else may.
        const bool example = code.find("moomill ") != std::string::npos || code.find("example") != std::string::npos ||
                             code.find(" = \\\"") != std::string::npos ||
                             code.find("std::string species = ") != std::string::npos;
        INFO(entry.path().string(), ":", number, ": ", line);
        CHECK(example);
      }
    }
  CHECK(files > 80);
}
