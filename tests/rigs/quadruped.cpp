// The builder, on the cow that ships and on small bodies made here.
#include "rigs/quadruped.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <map>
#include <set>

#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "generator/core/random.h"
#include "rigs/pose.h"
#include "scenes/quadruped_file.h"
#include "scenes/scene.h"

using namespace moomill;

namespace {

const Species& cow() {
  static const Species species = read_species("cow", NnopcsNormalization::box, ".");
  return species;
}

QuadrupedSpec cow_spec() {
  const std::string file = (data_root() / "rigs/cow/cow.toml").string();
  const toml::table table = TomlReader::parse(file);
  TomlReader reader(table, file);
  return read_quadruped(*reader.table("builder"));
}

// Two lobes on a bar, one joint each.
QuadrupedSpec dumbbell() {
  QuadrupedSpec spec;
  spec.source = "dumbbell";
  spec.target_edge = 0.04;
  spec.grid = 0.02;
  spec.joints = {{"root", "", {0, 0, 0.3}}, {"left_arm", "root", {0, 0.2, 0.3}, true}};
  Solid bar;
  bar.name = "bar";
  bar.sections = {{{-0.2, 0, 0.3}, 0.1, 0.1, 0.1, 2, "root", "bar"}, {{0.2, 0, 0.3}, 0.1, 0.1, 0.1}};
  Solid lobe;
  lobe.name = "lobe";
  lobe.mirror = true;
  lobe.cap_start = lobe.cap_end = 0.1;
  lobe.sections = {{{0, 0.15, 0.3}, 0.1, 0.1, 0.1, 2, "left_arm", "lobe_l"}};
  spec.solids = {bar, lobe};
  return spec;
}

using Bits = std::array<float, 3>;
Bits bits(const vec3& p) {
  return {p.x, p.y, p.z};
}

std::vector<int> weld(const Surface& s) {
  std::map<Bits, int> seen;
  std::vector<int> id;
  for (const vec3& p : s.rest) id.push_back(seen.try_emplace(bits(p), static_cast<int>(seen.size())).first->second);
  return id;
}

double cross2(const vec2& a, const vec2& b) {
  return static_cast<double>(a.x) * b.y - static_cast<double>(a.y) * b.x;
}

void check_closed(const Surface& s) {
  const std::vector<int> id = weld(s);
  std::map<std::pair<int, int>, int> edges;
  for (const uvec3& t : s.triangles)
    for (int k = 0; k < 3; ++k) ++edges[{id[t[k]], id[t[(k + 1) % 3]]}];
  int wrong = 0;
  for (const auto& [edge, count] : edges)
    wrong += count != 1 || !edges.count({edge.second, edge.first}) || edge.first == edge.second;
  CHECK(wrong == 0);
}

double volume(const Surface& s) {
  double v = 0;
  for (const uvec3& t : s.triangles)
    v += glm::dot(dvec3(s.rest[t.x]), glm::cross(dvec3(s.rest[t.y]), dvec3(s.rest[t.z]))) / 6;
  return v;
}

// Crossings of a ray along +x, by solid angle: 1 inside, 0 outside (van Oosterom and Strackee 1983).
double winding(const Surface& s, const dvec3& p) {
  double sum = 0;
  for (const uvec3& t : s.triangles) {
    const dvec3 a = dvec3(s.rest[t.x]) - p, b = dvec3(s.rest[t.y]) - p, c = dvec3(s.rest[t.z]) - p;
    const double la = glm::length(a), lb = glm::length(b), lc = glm::length(c);
    sum += 2 * std::atan2(glm::dot(a, glm::cross(b, c)),
                          la * lb * lc + glm::dot(a, b) * lc + glm::dot(b, c) * la + glm::dot(c, a) * lb);
  }
  return sum / (4 * pi);
}

std::uint64_t hash_rig(const Rig& rig) {
  std::uint64_t h = 0;
  const auto add = [&](const auto& v) {
    h = hash_identity({h, hash_text({reinterpret_cast<const char*>(v.data()), v.size() * sizeof(v[0])})});
  };
  add(rig.surface.rest), add(rig.surface.normals), add(rig.surface.uvs), add(rig.surface.triangles),
      add(rig.surface.parts);
  add(rig.influence_begin);
  for (const Influence& i : rig.influences)
    h = hash_identity({h, i.bone, static_cast<std::uint64_t>(std::llround(i.weight * 1e9))});
  for (const Clip& c : rig.clips)
    for (const Channel& ch : c.channels) add(ch.values);
  return h;
}

}  // namespace

TEST_CASE("A small body is closed, symmetric and of the right volume") {
  const Rig rig = build_quadruped(dumbbell());
  check_closed(rig.surface);
  Box box;
  for (const vec3& p : rig.surface.rest) box.add(dvec3(p));
  CHECK(box.size().y == doctest::Approx(0.5).epsilon(0.03));
  // Bar with round ends 0.0168 m3, and of each ball of 0.0042 m3 what sticks out; plus the fillets.
  CHECK(volume(rig.surface) > 0.0175);
  CHECK(volume(rig.surface) < 0.0230);
  CHECK(std::set<std::string>(rig.part_names.begin(), rig.part_names.end()) ==
        std::set<std::string>{"bar", "lobe_l", "lobe_r"});
}

TEST_CASE("What contradicts itself in a spec is refused with the place") {
  QuadrupedSpec spec = dumbbell();
  spec.solids[1].sections[0].joint = "nobody";
  CHECK_THROWS_WITH_AS(build_quadruped(spec), doctest::Contains("nobody"), InputError);
  spec = dumbbell();
  spec.joints[1].parent = "nobody";
  CHECK_THROWS_WITH_AS(build_quadruped(spec), doctest::Contains("nobody"), InputError);
  spec = dumbbell();
  spec.solids[1].sections[0].at.y = 1;
  CHECK_THROWS_WITH_AS(build_quadruped(spec), doctest::Contains("more than one body"), InputError);
  spec = dumbbell();
  spec.solids[0].up = {1, 0, 0};
  CHECK_THROWS_WITH_AS(build_quadruped(spec), doctest::Contains("'up'"), InputError);
}

TEST_CASE("Names are mirrored both ways") {
  CHECK(mirror_name("left_fore_elbow") == "right_fore_elbow");
  CHECK(mirror_name("hoof_hind_right") == "hoof_hind_left");
  CHECK(mirror_name("ear_l") == "ear_r");
  CHECK(mirror_name("withers") == "withers");
}

TEST_CASE("The cow's mesh is closed, without degenerate triangles, of a cow's size") {
  const Surface& s = cow().rig.surface;
  check_closed(s);
  for (const uvec3& t : s.triangles) {
    const dvec3 a(s.rest[t.x]), b(s.rest[t.y]), c(s.rest[t.z]);
    REQUIRE(glm::length(glm::cross(b - a, c - a)) > 1e-9);
  }
  CHECK(volume(s) > 0.4);
  CHECK(volume(s) < 0.8);
  const dvec3 size = s.neutral_box.size();
  CHECK(size.x == doctest::Approx(2.2).epsilon(0.01));
  CHECK(size.z == doctest::Approx(1.65).epsilon(0.01));
  CHECK(size.y == doctest::Approx(0.67).epsilon(0.05));
  CHECK(std::abs(s.neutral_box.lower.z) < 0.005);
  for (const vec3& n : s.normals) REQUIRE(glm::length(n) == doctest::Approx(1).epsilon(1e-4));
}

TEST_CASE("The cow's skin weights are few, sum to one, and do not leak between legs") {
  const Rig& rig = cow().rig;
  REQUIRE(rig.influence_begin.size() == rig.surface.rest.size() + 1);
  const auto names_of = [&](std::size_t v) {
    std::vector<std::string> names;
    for (std::uint32_t i = rig.influence_begin[v]; i < rig.influence_begin[v + 1]; ++i)
      names.push_back(rig.nodes[rig.bones[rig.influences[i].bone].node].name);
    return names;
  };
  for (std::size_t v = 0; v < rig.surface.rest.size(); ++v) {
    const std::uint32_t first = rig.influence_begin[v], last = rig.influence_begin[v + 1];
    REQUIRE(last > first);
    REQUIRE(last - first <= 4);
    double sum = 0;
    for (std::uint32_t i = first; i < last; ++i) sum += rig.influences[i].weight;
    REQUIRE(sum == doctest::Approx(1).epsilon(1e-5));
    if (rig.surface.rest[v].z > 0.5f) continue;
    // Below the belly every limb is on its own.
    std::set<std::string> limbs;
    for (const std::string& n : names_of(v)) {
      if (n.starts_with("tail")) limbs.insert("tail");
      if (n.starts_with("left") || n.starts_with("right")) limbs.insert(n.substr(0, n.find('_', n.find('_') + 1)));
    }
    REQUIRE(limbs.size() <= 1);
  }
}

TEST_CASE("The cow is left/right symmetric: surface and weights") {
  const Rig& rig = cow().rig;
  std::map<Bits, std::size_t> at;
  for (std::size_t v = 0; v < rig.surface.rest.size(); ++v) at.emplace(bits(rig.surface.rest[v]), v);
  for (std::size_t v = 0; v < rig.surface.rest.size(); ++v) {
    const vec3 p = rig.surface.rest[v] * vec3(1, -1, 1) + 0.0f;
    const auto found = at.find(bits(p));
    REQUIRE(found != at.end());
    std::map<std::string, float> mine, other;
    for (std::uint32_t i = rig.influence_begin[v]; i < rig.influence_begin[v + 1]; ++i)
      mine[mirror_name(rig.nodes[rig.bones[rig.influences[i].bone].node].name)] = rig.influences[i].weight;
    for (std::uint32_t i = rig.influence_begin[found->second]; i < rig.influence_begin[found->second + 1]; ++i)
      other[rig.nodes[rig.bones[rig.influences[i].bone].node].name] = rig.influences[i].weight;
    REQUIRE(mine.size() == other.size());
    for (const auto& [name, weight] : mine) REQUIRE(other[name] == doctest::Approx(weight).epsilon(1e-5));
  }
}

TEST_CASE("The cow's UV atlas lies in the unit interval and covers no texel twice") {
  const Surface& s = cow().rig.surface;
  REQUIRE(s.uvs.size() == s.rest.size());
  for (const vec2& uv : s.uvs) {
    REQUIRE(uv.x >= 0);
    REQUIRE(uv.x <= 1);
    REQUIRE(uv.y >= 0);
    REQUIRE(uv.y <= 1);
  }
  constexpr int n = 2048;
  std::vector<std::uint8_t> covered(static_cast<std::size_t>(n) * n, 0);
  int twice = 0;
  std::size_t painted = 0;
  for (const uvec3& t : s.triangles) {
    const vec2 a = s.uvs[t.x] * float(n), b = s.uvs[t.y] * float(n), c = s.uvs[t.z] * float(n);
    const double area = cross2(b - a, c - a);
    REQUIRE(area != 0);
    const vec2 low = glm::min(a, glm::min(b, c)), high = glm::max(a, glm::max(b, c));
    for (int y = static_cast<int>(low.y); y <= std::min(n - 1, static_cast<int>(high.y)); ++y)
      for (int x = static_cast<int>(low.x); x <= std::min(n - 1, static_cast<int>(high.x)); ++x) {
        const vec2 p(x + 0.5f, y + 0.5f);
        const double e = 1e-4;  // texels on a shared edge belong to both sides within rounding
        if (cross2(b - a, p - a) / area < e || cross2(c - b, p - b) / area < e || cross2(a - c, p - c) / area < e)
          continue;
        painted += covered[static_cast<std::size_t>(y) * n + x] == 0;
        twice += covered[static_cast<std::size_t>(y) * n + x]++ > 0;
      }
  }
  CHECK(twice == 0);
  CHECK(painted > 0.3 * n * n);  // an atlas that wastes more is worth mending
}

TEST_CASE("The cow has its 25 keypoints in order, at joints inside the body") {
  const Species& c = cow();
  const std::vector<std::string> trunk = {"nose",   "poll",      "neck",     "withers", "mid_back",
                                          "sacrum", "tail_base", "tail_mid", "tail_tip"};
  std::vector<std::string> wanted = trunk;
  for (const std::string leg : {"left_fore", "right_fore"})
    for (const std::string j : {"_elbow", "_carpus", "_fetlock", "_hoof"}) wanted.push_back(leg + j);
  for (const std::string leg : {"left_hind", "right_hind"})
    for (const std::string j : {"_stifle", "_hock", "_fetlock", "_hoof"}) wanted.push_back(leg + j);
  REQUIRE(c.keypoints.size() == 25);
  for (std::size_t i = 0; i < wanted.size(); ++i) {
    CHECK(c.keypoints[i].name == wanted[i]);
    const auto& anchor = std::get<JointAnchor>(c.keypoints[i].anchor);
    CHECK(c.rig.nodes[anchor.node].name == wanted[i]);
    INFO(wanted[i]);
    CHECK(winding(c.rig.surface, anchor.neutral) == doctest::Approx(1).epsilon(0.01));
  }
  CHECK(c.pairs.size() == 8);
  CHECK(c.edges.size() == 24);  // a tree over 25 keypoints
}

TEST_CASE("The same bytes for any number of threads, and a finer mesh on demand") {
  QuadrupedSpec spec = cow_spec();
  const auto build = [&](int threads) {
    tbb::task_arena arena(threads);
    return arena.execute([&] { return hash_rig(build_quadruped(spec)); });
  };
  CHECK(build(1) == build(2));
  spec.target_edge *= 0.45;
  const Rig fine = build_quadruped(spec);
  check_closed(fine.surface);
  CHECK(fine.surface.triangles.size() > 100000);
}
