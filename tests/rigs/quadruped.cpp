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
#include "rigs/mesh_checks.h"
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

void check_closed(const Surface& s) {
  const MeshChecks c = check_mesh(s);
  CHECK(c.watertight());
  CHECK(c.genus == 0);
  CHECK(c.degenerate == 0);
  CHECK(c.self_intersections == 0);
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

// One solid through these sections, moved by one joint.
QuadrupedSpec one_solid(std::vector<SolidSection> sections, const dvec3& up, double edge) {
  QuadrupedSpec spec;
  spec.source = "solid";
  spec.target_edge = edge;
  spec.grid = 0.4 * edge;
  spec.joints = {{"root", "", sections[sections.size() / 2].at}};
  sections[0].joint = "root", sections[0].part = "body";
  Solid solid;
  solid.name = "solid";
  solid.up = up;
  solid.cap_start = sections.front().side, solid.cap_end = sections.back().side;
  solid.sections = std::move(sections);
  spec.solids = {solid};
  return spec;
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

TEST_CASE("A capsule has the volume and the area of a capsule") {
  const double r = 0.1, length = 0.4;
  const Rig rig = build_quadruped(one_solid({{{-0.2, 0, 0}, r, r, r}, {{0.2, 0, 0}, r, r, r}}, {0, 0, 1}, 0.015));
  const MeshChecks c = check_mesh(rig.surface);
  CHECK(c.watertight());
  CHECK(c.volume == doctest::Approx(pi * r * r * length + 4.0 / 3 * pi * r * r * r).epsilon(0.005));
  CHECK(c.area == doctest::Approx(2 * pi * r * length + 4 * pi * r * r).epsilon(0.005));
  CHECK(c.least_angle_deg[0] > 15);
}

TEST_CASE("A ring has one handle, and a spec that does not say so is warned of it") {
  std::vector<SolidSection> sections;
  for (int k = 0; k <= 12; ++k) {
    const double a = 2 * pi * k / 12.0;
    sections.push_back({{0.3 * std::cos(a), 0, 0.3 * std::sin(a)}, 0.08, 0.08, 0.08});
  }
  QuadrupedSpec spec = one_solid(sections, {0, 1, 0}, 0.03);
  const std::vector<std::string> warnings = build_quadruped(spec).warnings;
  REQUIRE(warnings.size() == 1);
  CHECK(warnings[0].find("1 handles") != std::string::npos);
  CHECK(warnings[0].find("'solid'") != std::string::npos);
  spec.handles = 1;
  const Rig rig = build_quadruped(spec);
  CHECK(rig.warnings.empty());
  const MeshChecks c = check_mesh(rig.surface);
  CHECK(c.watertight());
  CHECK(c.genus == 1);
  CHECK(c.self_intersections == 0);
  CHECK(c.volume == doctest::Approx(2 * pi * pi * 0.3 * 0.0064).epsilon(0.03));
}

TEST_CASE("A tube thicker than its bend is wide does not tear or cut itself") {
  const Rig rig = build_quadruped(one_solid(
      {{{-0.25, 0, 0}, 0.16, 0.1, 0.1}, {{0, 0, 0.05}, 0.17, 0.1, 0.1}, {{0.02, 0, -0.25}, 0.12, 0.1, 0.1}},
      {0, 1, 0}, 0.03));
  check_closed(rig.surface);
  CHECK(check_mesh(rig.surface).sharpest_fold_deg < 115);
}

TEST_CASE("What contradicts itself in a spec is refused with the place") {
  const auto refuses = [](const auto& change, const std::vector<std::string>& says) {
    QuadrupedSpec spec = dumbbell();
    change(spec);
    std::string message;
    try {
      build_quadruped(spec);
    } catch (const InputError& e) {
      message = e.what();
    }
    for (const std::string& part : says) {
      INFO(message);
      CHECK(message.find(part) != std::string::npos);
    }
  };
  using Spec = QuadrupedSpec;
  const double nan = std::numeric_limits<double>::quiet_NaN();
  refuses([](Spec& s) { s.solids[1].sections[0].joint = "nobody"; }, {"lobe", "nobody"});
  refuses([](Spec& s) { s.joints[1].parent = "nobody"; }, {"left_arm", "nobody", "correct the name"});
  refuses([](Spec& s) { s.joints.push_back({"tail", "", {0.1, 0, 0.3}}); }, {"root", "tail", "no parent"});
  refuses([](Spec& s) { s.joints.push_back({"root", "root", {0, 0, 0.3}}); }, {"root", "twice"});
  refuses(
      [](Spec& s) {
        s.joints.push_back({"a", "c", {0.1, 0, 0.3}});
        s.joints.push_back({"b", "a", {0.1, 0, 0.3}});
        s.joints.push_back({"c", "b", {0.1, 0, 0.3}});
      },
      {"cycle", "a -> c -> b -> a"});
  refuses([](Spec& s) { s.joints[1].mirror = false; }, {"left_arm", "right_arm", "mirror = true"});
  refuses(
      [](Spec& s) {
        s.joints[1].mirror = false;
        s.joints.push_back({"right_arm", "root", {0, -0.25, 0.3}});
      },
      {"left_arm", "right_arm", "0.050 m"});
  refuses([](Spec& s) { s.joints.push_back({"horn", "root", {0, 0.1, 0.3}}); }, {"horn", "0.100 m off"});
  refuses([](Spec& s) { s.joints.push_back({"far", "root", {2, 0, 0.3}}); }, {"far", "outside the body", "1.7"});
  refuses([=](Spec& s) { s.joints[0].at.x = nan; }, {"root", "not finite"});
  // Two balls of 0.1 m whose centres are 0.15 m and 1 m from the bar of 0.1 m: the gap is 0.8 m.
  refuses([](Spec& s) { s.solids[1].sections[0].at.y = 1; }, {"bar", "lobe", "do not meet", "80"});
  refuses([](Spec& s) { s.solids[0].up = {1, 0, 0}; }, {"bar", "'up'", "section 0"});
  refuses([](Spec& s) { s.solids[0].sections[1].side = 0; }, {"bar", "radius of 0", "section 1"});
  refuses([=](Spec& s) { s.solids[1].sections[0].at.z = nan; }, {"lobe", "section 0"});
  refuses([](Spec& s) { s.solids[0].sections.clear(); }, {"bar", "no sections"});
  refuses([](Spec& s) { s.solids[0].sections[1].at = s.solids[0].sections[0].at; }, {"bar", "same place"});
  refuses(
      [](Spec& s) {
        s.solids[1].mirror = false;
        s.solids[1].sections[0].at.y = -0.15;
      },
      {"lobe", "on the right"});
  refuses([](Spec& s) { s.solids.clear(); }, {"no solids"});
  refuses([](Spec& s) { s.joints.clear(); }, {"no joints"});
}

TEST_CASE("Joints may be listed in any order") {
  QuadrupedSpec spec = dumbbell();
  const Rig listed = build_quadruped(spec);
  std::swap(spec.joints[0], spec.joints[1]);
  const Rig swapped = build_quadruped(spec);
  CHECK(hash_rig(listed) == hash_rig(swapped));
  for (std::size_t i = 0; i < swapped.nodes.size(); ++i) {
    CHECK(swapped.nodes[i].name == listed.nodes[i].name);
    CHECK(swapped.nodes[i].parent < static_cast<int>(i));
  }
}

TEST_CASE("Sections along bones: moving a joint moves the flesh, and the bone's joint moves it") {
  const auto read = [](const std::string& hip, const std::string& section) {
    const toml::table table = toml::parse(
        "joints = [{ name = 'root', at = [0, 0, 1] }, { name = 'left_hip', parent = 'root', at = " + hip +
        ", mirror = true }, { name = 'left_foot', parent = 'left_hip', at = [0, 0.2, 0], mirror = true }]\n" +
        "solids = [{ name = 'leg', part = 'leg', mirror = true, up = [1, 0, 0], sections = [" + section +
        ", { along = ['left_hip', 'left_foot'], t = 1, radii = [0.04] }] }]");
    return read_quadruped(TomlReader(table, "leg.toml"));
  };
  const std::string section = "{ along = ['left_hip', 'left_foot'], t = 0.25, offset = [0.1, 0, 0], width_m = 0.2, depth_m = 0.3 }";
  const Solid leg = read("[0, 0.2, 0.8]", section).solids[0];
  CHECK(glm::length(leg.sections[0].at - dvec3(0.1, 0.2, 0.6)) < 1e-12);
  CHECK(leg.sections[0].side == doctest::Approx(0.1));
  CHECK(leg.sections[0].up == doctest::Approx(0.15));
  CHECK(leg.sections[0].joint == "left_hip");
  const Solid moved = read("[0.4, 0.2, 1.2]", section).solids[0];
  CHECK(glm::length(moved.sections[0].at - dvec3(0.4, 0.2, 0.9)) < 1e-12);
  CHECK(glm::length(moved.sections[1].at - dvec3(0, 0.2, 0)) < 1e-12);
  const auto refused = [&](const std::string& text, const char* says) {
    CHECK_THROWS_WITH_AS(read("[0, 0.2, 0.8]", text), doctest::Contains(says), InputError);
  };
  refused("{ along = ['left_hip', 'left_fot'], t = 0, radii = [0.1] }", "did you mean 'left_foot'");
  refused("{ along = ['left_hip'], t = 0, radii = [0.1] }", "two joints");
  refused("{ along = ['left_hip', 'left_foot'], at = [0, 0, 0], radii = [0.1] }", "'at'");
  refused("{ radii = [0.1] }", "'along'");
  refused("{ at = [0, 0, 0], radii = [0] }", "from 0.0001");
  refused("{ at = [nan, 0, 0], radii = [0.1] }", "finite");
  refused("{ at = [0, 0, 0], radii = [0.1], width_m = 0.1, depth_m = 0.2 }", "radii");
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
  const MeshChecks c = check_mesh(s);
  CHECK(c.triangles >= 30000);
  CHECK(c.triangles <= 120000);
  CHECK(c.least_angle_deg[0] > 5);
  CHECK(c.least_angle_deg[1] > 30);
  CHECK(c.sharpest_fold_deg < 115);
  CHECK(cow().rig.warnings.empty());
  // Head and feet have finer triangles than the trunk.
  std::map<std::string, std::pair<double, int>> edges;
  for (std::size_t t = 0; t < s.triangles.size(); ++t) {
    const uvec3& v = s.triangles[t];
    auto& [sum, count] = edges[cow().rig.part_names[s.parts[t]]];
    for (int k = 0; k < 3; ++k) sum += glm::length(s.rest[v[k]] - s.rest[v[(k + 1) % 3]]), ++count;
  }
  const auto mean = [&](const std::string& part) { return edges.at(part).first / edges.at(part).second; };
  for (const std::string part : {"head", "muzzle", "hoof_fore_left", "hoof_hind_right"}) {
    INFO(part);
    CHECK(mean(part) < 0.6 * mean("torso"));
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

TEST_CASE("The cow's UV atlas: no overlap, well used, even texels, gutters") {
  const AtlasChecks a = check_atlas(cow().rig.surface, 4096);
  CHECK(a.outside == 0);
  CHECK(a.flat == 0);
  CHECK(a.mirrored == 0);
  CHECK(a.twice == 0);
  CHECK(a.occupancy() > 0.55);
  CHECK(a.density_spread() < 1.15);
  CHECK(a.stretch[2] < 1.3);
  CHECK(a.charts < 150);
  CHECK(a.gutter_texels >= 0.004 * 4096);
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
  spec.target_edge *= 0.55;
  const Rig fine = build_quadruped(spec);
  check_closed(fine.surface);
  CHECK(fine.surface.triangles.size() > 100000);
}
