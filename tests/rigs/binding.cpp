// Binding of scans, on an animal of boxes whose every part is known.
#include "rigs/bind.h"

#include <doctest/doctest.h>

#include <fstream>

#include "fixtures.h"
#include "generator/core/error.h"
#include "rigs/warp.h"
#include "scenes/bind_file.h"
#include "scenes/scene.h"

using namespace moomill;

namespace {

void add_box(Surface& s, const dvec3& lower, const dvec3& upper, int cuts = 6) {
  // Every face a grid of its own; welded by position. Cells that share a face of two boxes are no matter to a scan.
  for (int axis = 0; axis < 3; ++axis)
    for (int side = 0; side < 2; ++side) {
      const std::uint32_t first = static_cast<std::uint32_t>(s.rest.size());
      const int u = (axis + 1) % 3, v = (axis + 2) % 3;
      for (int j = 0; j <= cuts; ++j)
        for (int i = 0; i <= cuts; ++i) {
          dvec3 p;
          p[axis] = side ? upper[axis] : lower[axis];
          p[u] = glm::mix(lower[u], upper[u], static_cast<double>(i) / cuts);
          p[v] = glm::mix(lower[v], upper[v], static_cast<double>(j) / cuts);
          s.rest.emplace_back(p);
          dvec3 n(0);
          n[axis] = side ? 1 : -1;
          s.normals.emplace_back(n);
        }
      for (int j = 0; j < cuts; ++j)
        for (int i = 0; i < cuts; ++i) {
          const std::uint32_t a = first + j * (cuts + 1) + i, b = a + 1, c = a + cuts + 1, d = c + 1;
          if (side) {
            s.triangles.emplace_back(a, b, d);
            s.triangles.emplace_back(a, d, c);
          } else {
            s.triangles.emplace_back(a, d, b);
            s.triangles.emplace_back(a, c, d);
          }
          s.materials.insert(s.materials.end(), 2, 0);
        }
    }
}

struct Limb {
  const char* name;
  dvec3 at, lower, upper;  // joint, box
};
const std::vector<Limb>& limbs() {
  static const std::vector<Limb> list{{"body", {0, 0, 0.8}, {-0.6, -0.25, 0.6}, {0.6, 0.25, 1.0}},
                                      {"head", {0.6, 0, 0.9}, {0.58, -0.1, 0.8}, {0.95, 0.1, 1.0}},
                                      {"left_fore", {0.5, 0.18, 0.62}, {0.42, 0.1, 0}, {0.58, 0.24, 0.65}},
                                      {"right_fore", {0.5, -0.18, 0.62}, {0.42, -0.24, 0}, {0.58, -0.1, 0.65}},
                                      {"left_hind", {-0.5, 0.18, 0.62}, {-0.58, 0.1, 0}, {-0.42, 0.24, 0.65}},
                                      {"right_hind", {-0.5, -0.18, 0.62}, {-0.58, -0.24, 0}, {-0.42, -0.1, 0.65}}};
  return list;
}

Rig as_static(Surface surface) {
  Rig rig;
  rig.source = "scan.glb";
  rig.nodes.resize(1);
  rig.nodes[0].name = "scan";
  rig.bones.push_back({0, dmat4(1.0)});
  rig.surface = std::move(surface);
  const auto n = static_cast<std::uint32_t>(rig.surface.rest.size());
  rig.meshes.push_back({"scan", 0, n, 0, static_cast<std::uint32_t>(rig.surface.triangles.size()), false, 0});
  for (std::uint32_t v = 0; v < n; ++v) rig.influence_begin.push_back(v), rig.influences.push_back({0, 1});
  rig.influence_begin.push_back(n);
  rig.materials.resize(1);
  return rig;
}

Surface body() {
  Surface s;
  for (const Limb& limb : limbs()) add_box(s, limb.lower, limb.upper);
  return s;
}

Species boxes() {
  Species species;
  species.name = "boxes";
  species.rig = as_static(body());
  Rig& rig = species.rig;
  rig.nodes.clear(), rig.bones.clear(), rig.influences.clear();
  for (std::size_t i = 0; i < limbs().size(); ++i) {
    Node node;
    node.name = limbs()[i].name;
    node.parent = i == 0 ? -1 : 0;
    node.translation = i == 0 ? limbs()[i].at : limbs()[i].at - limbs()[0].at;
    Bone bone;
    bone.node = static_cast<int>(i);
    bone.inverse_bind[3] = dvec4(-limbs()[i].at, 1);
    rig.nodes.push_back(node);
    rig.bones.push_back(bone);
  }
  const std::size_t each = rig.surface.rest.size() / limbs().size();
  for (std::size_t v = 0; v < rig.surface.rest.size(); ++v)
    rig.influences.push_back({static_cast<std::uint32_t>(v / each), 1});
  rig.meshes[0].skinned = true;
  finish_rig(rig);
  const auto key = [&](const std::string& name, int node, const dvec3& at) {
    species.keypoints.push_back({name, JointAnchor{node, at}, 0.1});
  };
  key("body", 0, limbs()[0].at);
  key("head", 1, limbs()[1].at);
  key("nose", 1, {0.9, 0, 0.9});
  for (int i = 2; i < 6; ++i) {
    key(limbs()[i].name, i, limbs()[i].at);
    key(std::string(limbs()[i].name) + "_foot", i, limbs()[i].at - dvec3(0, 0, 0.58));
  }
  species.pairs = {{3, 5}, {4, 6}, {7, 9}, {8, 10}};
  species.edges = {{0, 1}, {1, 2}};
  species.neutral = rest_pose(rig);
  return species;
}

// The boxes as a scanner would give them: in tens of centimetres, facing +Y, somewhere.
dvec3 scanned(const dvec3& p) {
  return 10.0 * dvec3(-p.y, p.x, p.z) + dvec3(3, -2, 5);
}

Rig scan(Surface s) {
  for (vec3& p : s.rest) p = vec3(scanned(dvec3(p)));
  for (vec3& n : s.normals) n = vec3(-n.y, n.x, n.z);
  return as_static(std::move(s));
}

BindSpec clicks(const Species& base) {
  BindSpec spec;
  spec.source = "clicks.toml";
  for (const Keypoint& k : base.keypoints) spec.keypoints.push_back(scanned(std::get<JointAnchor>(k.anchor).neutral));
  return spec;
}

std::string refusal(const Rig& rig, const Species& base, const BindSpec& spec) {
  try {
    bind_scan(rig, base, spec);
  } catch (const InputError& e) {
    return e.what();
  }
  return "";
}

bool says(const std::string& text, const std::string& what) {
  INFO(text);
  const bool found = text.find(what) != std::string::npos;
  CHECK(found);
  return found;
}

}  // namespace

TEST_CASE("A warp takes its points to their places and is exact for affine maps") {
  std::vector<dvec3> from, to;
  const dmat3 linear(dvec3(1, 0.2, 0), dvec3(-0.1, 2, 0), dvec3(0.3, 0, 0.5));
  for (int i = 0; i < 8; ++i) {
    from.emplace_back(i & 1, i >> 1 & 1, i >> 2);
    to.push_back(linear * from.back() + dvec3(4, 5, 6));
  }
  Warp warp;
  REQUIRE(fit_warp(from, to, warp));
  const dvec3 p(0.3, -2, 0.7);
  CHECK(glm::length(warp.apply(p) - (linear * p + dvec3(4, 5, 6))) < 1e-9);
  to[3] += dvec3(0.1, 0, 0);
  REQUIRE(fit_warp(from, to, warp));
  for (int i = 0; i < 8; ++i) CHECK(glm::length(warp.apply(from[i]) - to[i]) < 1e-9);
  CHECK_FALSE(fit_warp({{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 1, 0}}, {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 1, 0}}, warp));
}

TEST_CASE("A turned and scaled scan is bound where its keypoints are, each leg to its own joint") {
  const Species base = boxes();
  Surface s = body();
  const std::size_t body_vertices = s.rest.size();
  add_box(s, {0.94, 0.03, 0.92}, {0.97, 0.06, 0.95}, 1);  // an eye
  add_box(s, {-1, -1, -0.02}, {1, 1, -0.005});            // ground
  const std::size_t count = s.triangles.size();
  for (std::size_t t = 0; t < count; t += 5) {  // double-sided in places
    s.triangles.emplace_back(s.triangles[t].x, s.triangles[t].z, s.triangles[t].y);
    s.materials.push_back(0);
  }
  const BoundScan bound = bind_scan(scan(s), base, clicks(base));
  const Rig& rig = bound.species.rig;
  CHECK(rig.surface.rest.size() == body_vertices + 24);
  REQUIRE(bound.notes.size() == 2);
  says(bound.notes[0], "ground");
  const std::vector<dmat4> world = world_transforms(rig, bound.species.neutral);
  for (std::size_t i = 0; i < limbs().size(); ++i) {
    const dvec3 moved = dvec3(world[i][3]) - limbs()[i].at;
    CHECK(glm::length(moved) < 1e-3);
  }
  double wrong = 0, far = 0;
  for (std::size_t v = 0; v < body_vertices; ++v) {
    const vec3 p = rig.surface.rest[v];
    far = std::max(far, glm::length(dvec3(p) - dvec3(body().rest[v])));
    if (p.z > 0.25) continue;
    const std::uint32_t own = 2 + (p.x < 0 ? 2 : 0) + (p.y < 0 ? 1 : 0);
    for (std::uint32_t i = rig.influence_begin[v]; i < rig.influence_begin[v + 1]; ++i)
      if (rig.influences[i].bone != own) wrong = std::max<double>(wrong, rig.influences[i].weight);
  }
  CHECK(wrong < 0.05);
  CHECK(far < 1e-3);
  // The eye is rigid: all its vertices weigh the same.
  for (std::size_t v = body_vertices + 1; v < rig.surface.rest.size(); ++v) {
    REQUIRE(rig.influence_begin[v + 1] - rig.influence_begin[v] == rig.influence_begin[body_vertices + 1] - rig.influence_begin[body_vertices]);
    CHECK(rig.influences[rig.influence_begin[v]].weight == rig.influences[rig.influence_begin[body_vertices]].weight);
  }
}

TEST_CASE("What cannot be bound is refused in one sentence") {
  const Species base = boxes();
  const Rig rig = scan(body());
  const BindSpec good = clicks(base);
  SUBCASE("a keypoint far outside") {
    BindSpec spec = good;
    spec.keypoints[2].y += 4;
    const std::string text = refusal(rig, base, spec);
    says(text, "'nose' by 0.3");
    says(text, "outside the mesh");
  }
  SUBCASE("one pair swapped") {
    BindSpec spec = good;
    std::swap(spec.keypoints[4], spec.keypoints[6]);
    says(refusal(rig, base, spec), "'left_fore_foot' and 'right_fore_foot' are swapped");
  }
  SUBCASE("all pairs swapped") {
    BindSpec spec = good;
    for (const auto& [l, r] : base.pairs) std::swap(spec.keypoints[l], spec.keypoints[r]);
    says(refusal(rig, base, spec), "swapped in all 4 pairs");
  }
  SUBCASE("a second animal beside") {
    Surface two = body();
    const std::size_t n = two.rest.size(), t = two.triangles.size();
    for (std::size_t v = 0; v < n; ++v) two.rest.push_back(two.rest[v] + vec3(0, 1.5f, 0)), two.normals.push_back(two.normals[v]);
    for (std::size_t i = 0; i < t; ++i) two.triangles.push_back(two.triangles[i] + static_cast<unsigned>(n)), two.materials.push_back(0);
    says(refusal(scan(two), base, good), "two animals");
  }
  SUBCASE("nothing at all") {
    says(refusal(as_static({}), base, good), "no triangles");
  }
  SUBCASE("no volume") {
    Surface sheet;
    for (const vec3& p : {vec3(-0.6f, 0, 0), vec3(0.95f, 0, 0), vec3(0.95f, 0, 1), vec3(-0.6f, 0, 1)})
      sheet.rest.push_back(p), sheet.normals.emplace_back(0, 1, 0);
    sheet.triangles = {{0, 1, 2}, {0, 2, 3}};
    sheet.materials = {0, 0};
    says(refusal(scan(sheet), base, good), "encloses no volume");
  }
  SUBCASE("facing the wrong way") {
    BindSpec spec = good;
    spec.yaw_deg = 90;
    says(refusal(rig, base, spec), "about -90");
  }
}

TEST_CASE("A keypoint file is bound, and its species file read back; misspelt and missing keypoints are named") {
  const TempFolder folder;
  const Species base = boxes();
  write_glb(base.rig, folder.path / "boxes.glb");
  Rig scanned_rig = scan(body());
  finish_rig(scanned_rig);
  write_glb(scanned_rig, folder.path / "scan.glb");
  const auto write = [&](const std::string& name, const std::string& text) { std::ofstream(folder.path / name) << text; };
  BoundScan plain;
  plain.species = base;
  plain.species.expected_length = 1.55, plain.species.expected_height = 1;
  write("boxes.toml", bound_species_toml(plain, "boxes", "boxes.glb", "a test"));
  std::string keys = "species = \"./boxes.toml\"\n[keypoints]\n";
  for (const Keypoint& k : base.keypoints) {
    const dvec3 p = scanned(std::get<JointAnchor>(k.anchor).neutral);
    keys += fmt::format("{} = [{}, {}, {}]\n", k.name, p.x, p.y, p.z);
  }
  write("clicks.toml", keys);
  const BoundScan bound = bind_scan_file(folder.path / "scan.glb", folder.path / "clicks.toml");
  write_glb(bound.species.rig, folder.path / "bound.glb");
  write("bound.toml", bound_species_toml(bound, "bound", "bound.glb", "clicks.toml"));
  const Species back = read_species((folder.path / "bound.toml").string(), NnopcsNormalization::box, {});
  REQUIRE(back.keypoints.size() == base.keypoints.size());
  CHECK(back.pairs == base.pairs);
  CHECK(glm::length(std::get<JointAnchor>(back.keypoints[2].anchor).neutral - dvec3(0.9, 0, 0.9)) < 2e-3);

  const auto refused = [&](const std::string& text) -> std::string {
    write("bad.toml", text);
    try {
      bind_scan_file(folder.path / "scan.glb", folder.path / "bad.toml");
    } catch (const InputError& e) {
      return e.what();
    }
    return "";
  };
  std::string misspelt = keys;
  misspelt.replace(misspelt.find("nose"), 4, "nosee");
  says(refused(misspelt), "did you mean 'nose'?");
  std::string missing = keys;
  missing.erase(missing.find("nose"), missing.find('\n', missing.find("nose")) - missing.find("nose"));
  says(refused(missing), "lacks 'nose'");
}
