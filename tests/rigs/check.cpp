#include "rigs/check.h"

#include <doctest/doctest.h>

#include <fstream>

#include "generator/core/error.h"
#include "scenes/scene.h"
#include "tests/rigs/fixtures.h"

using namespace moomill;

namespace {

bool finds(const std::vector<Finding>& findings, const std::string& text, Finding::Level level) {
  for (const Finding& f : findings)
    if (f.level == level && f.text.find(text) != std::string::npos) return true;
  std::string all;
  for (const Finding& f : findings) all += f.text + "\n";
  INFO("found: ", all);
  return false;
}
constexpr auto wrong = Finding::Level::wrong;
constexpr auto suspicious = Finding::Level::suspicious;

Species tube_species() {
  Species species;
  species.rig = fixtures::tube();
  bake_nnopcs(species.rig.surface, species.rig.surface.rest, NnopcsNormalization::box);
  species.neutral = bind_pose(species.rig);
  species.keypoints = {{.name = "left", .anchor = JointAnchor{0, {0.1, 0, 0.5}}},
                       {.name = "right", .anchor = JointAnchor{0, {-0.1, 0, 0.5}}}};
  species.pairs = {{0, 1}};
  species.edges = {{0, 1}};
  species.limits = {{.node = 1, .lower_deg = {-10, 0, 0}, .upper_deg = {10, 0, 0}}};
  species.expected_height = 2.0;
  return species;
}

}  // namespace

TEST_CASE("An open tube: two rims of borders, no UVs, nothing wrong") {
  const Rig rig = fixtures::tube();
  const auto findings = check_rig(rig);
  CHECK(
      finds(findings, "32 of 976 edges have a triangle on one side only", suspicious));  // 2 x 16 of 21 * 16 + 20 * 32
  CHECK(finds(findings, "no UVs", suspicious));
  for (const Finding& f : findings) CHECK(f.level == suspicious);
  CHECK(findings.size() == 2);
}

TEST_CASE("Faults put into a rig are found and counted") {
  Rig rig = fixtures::tube();
  rig.surface.triangles[5] = uvec3(rig.surface.triangles[5].x);  // no area
  rig.surface.triangles[7] =
      uvec3(rig.surface.triangles[7].x, rig.surface.triangles[7].z, rig.surface.triangles[7].y);  // turned over
  rig.surface.triangles.push_back(rig.surface.triangles[100]);  // three triangles at its edges
  rig.surface.materials.push_back(0);
  rig.surface.parts.push_back(0);
  rig.influences[3].weight = 0.5f;
  rig.nodes.push_back({.name = "lower"});
  rig.bones.push_back({2, dmat4(1.0)});
  rig.nodes[1].translation = {0, 0, 1.25};  // saved in a pose
  for (vec3& p : rig.surface.rest) p *= 100.0f;
  const auto findings = check_rig(rig);
  CHECK(finds(findings, "1 of 641 triangles have no area", suspicious));
  CHECK(finds(findings, "3 of 976 edges have more than two triangles", suspicious));
  CHECK(finds(findings, "edges join triangles that face opposite ways", suspicious));
  CHECK(finds(findings, "weights of 1 vertices do not sum to 1", wrong));
  CHECK(finds(findings, "1 nodes share a name with another: lower", wrong));
  CHECK(finds(findings, "1 of 3 joints move no vertex: lower", suspicious));
  CHECK(finds(findings, "the longest side is 200 m", suspicious));
  CHECK(finds(findings, "up to 0.25 m from where they were bound", suspicious));
  rig.surface.rest[0].x = std::numeric_limits<float>::quiet_NaN();
  CHECK(finds(check_rig(rig), "1 positions or normals are not finite", wrong));
}

TEST_CASE("More than four influences and isolated vertices are counted") {
  Rig rig = fixtures::awkward_rig();
  const auto findings = check_rig(rig);
  CHECK(finds(findings, "1 of 12 vertices have more than 4 joints (at most 5)", suspicious));
  rig.surface.triangles.pop_back();
  CHECK(finds(check_rig(rig), "3 of 12 vertices belong to no triangle", suspicious));
}

TEST_CASE("A sound species has no findings of its own") {
  for (const Finding& f : check_species(tube_species())) {
    INFO(f.text);
    const bool from_the_tube = f.text.find("UVs") != std::string::npos || f.text.find("borders") != std::string::npos;
    CHECK(from_the_tube);
  }
}

TEST_CASE("Faults of a species are found") {
  Species species = tube_species();
  species.expected_height = 1.5;
  std::get<JointAnchor>(species.keypoints[0].anchor).neutral = {0.35, 0, 0.5};
  species.keypoints.push_back({.name = "left", .anchor = JointAnchor{9, {}}});
  species.limits = {{.node = 1, .lower_deg = {20, 5, -200}, .upper_deg = {10, 9, 200}}};
  auto findings = check_species(species);
  CHECK(finds(findings, "the height is 2.000 m, 1.500 m was expected", suspicious));
  CHECK(finds(findings, "two keypoints are called 'left'", wrong));
  CHECK(finds(findings, "'left' is anchored to what does not exist", wrong));
  CHECK(finds(findings, "about x is from 20 to 10 degrees", wrong));
  CHECK(finds(findings, "leaves out the neutral pose", suspicious));
  CHECK(finds(findings, "may turn by 400 degrees about z", suspicious));
  species.keypoints.pop_back();
  findings = check_species(species);
  CHECK(finds(findings, "keypoint 'left' is outside of the body, 0.15", suspicious));
  species = tube_species();
  species.keypoints.push_back({.name = "left hoof", .anchor = JointAnchor{0, {-0.05, 0, 0.2}}});
  species.keypoints.push_back({.name = "right hoof", .anchor = JointAnchor{0, {0.05, 0, 0.2}}});
  species.pairs.push_back({2, 3});
  CHECK(finds(check_species(species), "'left hoof' and 'right hoof' are swapped", wrong));
  species.rig.surface.nnopcs.clear();
  CHECK(finds(check_species(species), "not baked", wrong));
}

TEST_CASE("Faults of the mesh are named with count and place") {
  const auto says = [](const auto& spoil, const char* text) {
    Rig rig = fixtures::tube();
    spoil(rig);
    return finds(check_rig(rig), text, suspicious);
  };
  const auto move = [](std::size_t vertex, const vec3& by) {
    return [=](Rig& r) { r.surface.rest[vertex] += by; };
  };
  CHECK(says(move(0, vec3(0)), "around 2 holes or open borders, the first at ("));
  // A vertex of the side pushed through the other side; one moved almost onto the line of its neighbours.
  CHECK(says(move(10 * 16, vec3(-0.7f, 0, 0)), "pairs of triangles go through each other, the first at ("));
  CHECK(says([](Rig& r) { r.surface.rest[16 * 10] = glm::mix(r.surface.rest[16 * 9], r.surface.rest[16 * 10], 0.001f); },
             "slivers with an angle below 1 degree, the first at ("));
  CHECK(says([](Rig& r) { r.surface.triangles[5] = uvec3(r.surface.triangles[5].x); }, "1 of 640 triangles have no area, the first at ("));
  CHECK(says([](Rig& r) { r.surface.rest.push_back(vec3(9)), r.surface.normals.push_back(vec3(0, 0, 1)), r.influences.push_back({0, 1}), r.influence_begin.push_back(static_cast<std::uint32_t>(r.influences.size())), ++r.meshes[0].vertex_count; },
             "1 of 337 vertices belong to no triangle, the first is vertex 336 of mesh 'tube'"));
  CHECK(says([](Rig& r) { r.meshes[0].skinned = false; }, "no mesh is skinned"));
  CHECK(says([](Rig& r) { for (vec3& p : r.surface.rest) p *= 14.85f; }, "the longest side is 29.7 m"));
  CHECK(says([](Rig& r) {
    // A second tube beside the first.
    Rig other = fixtures::tube();
    const auto n = static_cast<std::uint32_t>(r.surface.rest.size()), w = static_cast<std::uint32_t>(r.influences.size());
    for (std::size_t v = 0; v < n; ++v) r.surface.rest.push_back(other.surface.rest[v] + vec3(1, 0, 0)), r.surface.normals.push_back(other.surface.normals[v]);
    for (const uvec3& t : other.surface.triangles) r.surface.triangles.push_back(t + n), r.surface.parts.push_back(0), r.surface.materials.push_back(0);
    r.influences.insert(r.influences.end(), other.influences.begin(), other.influences.end());
    for (std::size_t v = 1; v <= n; ++v) r.influence_begin.push_back(other.influence_begin[v] + w);
  }, "the surface is of 2 separate pieces"));
}

TEST_CASE("A closed body is inside out or touches itself in a point, and is told so") {
  // Two tetrahedra that share one vertex.
  Rig rig;
  rig.source = "tetrahedra";
  rig.nodes = {{.name = "root"}};
  rig.surface.rest = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {-1, 0, 0}, {0, -1, 0}, {0, 0, -1}};
  rig.surface.triangles = {{0, 2, 1}, {0, 1, 3}, {0, 3, 2}, {1, 2, 3}, {0, 5, 4}, {0, 4, 6}, {0, 6, 5}, {4, 5, 6}};
  for (std::size_t t = 4; t < 8; ++t) std::swap(rig.surface.triangles[t].y, rig.surface.triangles[t].z);
  rig.meshes = {{.name = "tetrahedra", .vertex_count = 7, .triangle_count = 8, .node = 0}};
  finish_rig(rig);
  CHECK(finds(check_rig(rig), "at 1 of 7 vertices separate parts of the surface touch in a point", suspicious));
  CHECK_FALSE(finds(check_rig(rig), "inside out", suspicious));
  for (uvec3& t : rig.surface.triangles) std::swap(t.y, t.z);
  CHECK(finds(check_rig(rig), "inside out", suspicious));
}

TEST_CASE("Faults of the UV atlas are found") {
  const auto with_uvs = [](const auto& uv) {
    Rig rig = fixtures::tube();
    for (std::size_t v = 0; v < rig.surface.rest.size(); ++v) rig.surface.uvs.push_back(uv(v / 16, v % 16));
    return check_rig(rig);
  };
  // Ring and side as they are; the last side of the tube, between side 15 and side 0, covers all others once more.
  const auto wrapped = with_uvs([](std::size_t ring, std::size_t side) { return vec2(side / 15.0f, ring / 20.0f); });
  CHECK(finds(wrapped, "UVs overlap: 4194304 of the 4194304 texels in use (1e+02 %, of 2048 x 2048)", suspicious));
  CHECK(finds(wrapped, "the first at (0.000, 0.000)", suspicious));
  CHECK(finds(with_uvs([](std::size_t ring, std::size_t side) { return vec2(side / 10.0f, ring / 20.0f); }), "vertices have UVs outside of the unit square", suspicious));
  CHECK(finds(with_uvs([](std::size_t ring, std::size_t side) { return 0.5f * vec2(side / 15.0f, ring / 20.0f); }), "the UV atlas is used to 25 % only", suspicious));
  CHECK(finds(with_uvs([](std::size_t ring, std::size_t side) { return vec2(side / 15.0f, std::pow(ring / 20.0f, 4.0f)); }), "texels are unevenly spread", suspicious));
  CHECK(finds(with_uvs([](std::size_t, std::size_t side) { return vec2(side / 15.0f, 0.5f); }), "640 of 640 triangles have no area in the UV atlas", suspicious));
}

TEST_CASE("Left and right are compared in shape and in weights") {
  Species species = tube_species();
  const auto none = [](const Species& s) { return !finds(check_species(s), "left and right differ", suspicious); };
  CHECK(none(species));
  for (vec3& p : species.rig.surface.rest)
    if (p.x > 0) p.y *= 0.1f;  // one side is flattened
  CHECK(finds(check_species(species), "left and right differ in shape: ", suspicious));
  CHECK(finds(check_species(species), "have no counterpart across x = 0.00 m, the first is vertex", suspicious));
  species = tube_species();
  // Vertex 168, of ring 10 at x = 0.2, is bound half and half.
  species.rig.influences[species.rig.influence_begin[160]].weight = 0.8f;
  species.rig.influences[species.rig.influence_begin[160] + 1].weight = 0.2f;
  CHECK(finds(check_species(species), "left and right differ in weights: at 2 of 336 vertices by more than 0.1 in all, most (0.60) at vertex 160", suspicious));
}

TEST_CASE("Sizes far off are wrong, and so are keypoints far outside; joints without limits and loose keypoints are suspicious") {
  Species species = tube_species();
  species.expected_height = 29.7;
  CHECK(finds(check_species(species), "the height is 2.000 m, 29.700 m was expected: check the unit", wrong));
  species = tube_species();
  std::get<JointAnchor>(species.keypoints[1].anchor).neutral = {-1.5, 0, 0.5};
  CHECK(finds(check_species(species), "keypoint 'right' is far outside of the body, 1.30", wrong));
  species = tube_species();
  species.keypoints.push_back({.name = "tip", .anchor = JointAnchor{1, {0, 0, 1.9}}});
  CHECK(finds(check_species(species), "1 keypoints are in no edge of the skeleton: tip", suspicious));
  species = tube_species();
  species.limits = {{.node = 0, .lower_deg = {-10, 0, 0}, .upper_deg = {10, 0, 0}}};
  CHECK(finds(check_species(species), "1 joints move the surface but have no limits, so sampled poses leave them alone: upper", suspicious));
}

TEST_CASE("The cow that ships is clean, and its file brings back the same poses") {
  const Species cow = read_species("cow", NnopcsNormalization::box, ".");
  for (const Finding& f : check_species(cow)) {
    INFO(f.text);
    CHECK(false);
  }
  const TempFolder folder;
  write_glb(cow.rig, folder.path / "cow.glb");
  const Rig back = load_rig(folder.path / "cow.glb");
  REQUIRE(!cow.rig.clips.empty());
  REQUIRE(back.clips.size() == cow.rig.clips.size());
  double most = 0;
  for (std::size_t c = 0; c < cow.rig.clips.size(); ++c)
    for (const double share : {0.0, 0.21, 0.55, 0.83}) {
      const auto posed = [&](const Rig& r) {
        const Pose p = sample_clip(r, r.clips[c], share * r.clips[c].duration);
        return skin(r, bone_matrices(r, world_transforms(r, p)), p.morph_weights, cow.skinning, dvec3(0));
      };
      const PosedSurface a = posed(cow.rig), b = posed(back);
      REQUIRE(a.positions.size() == b.positions.size());
      for (std::size_t v = 0; v < a.positions.size(); ++v) most = std::max<double>(most, glm::length(a.positions[v] - b.positions[v]));
    }
  MESSAGE("the poses differ by at most ", most, " m");
  CHECK(most < 1e-6);
}

TEST_CASE("The description names joints, clips, sizes, materials and parts") {
  const std::string text = describe_rig(fixtures::awkward_rig());
  for (const char* part :
       {"    a *", "nod: 1.000 s, 4 channels", "12 vertices, 5 triangles", "at most 5 joints per vertex",
        "hide: colour 1.000", "base hide", "head: 2 triangles", "smile"}) {
    INFO(part, " in\n", text);
    CHECK(text.find(part) != std::string::npos);
  }
}

TEST_CASE("finish_rig sorts nodes, makes names unique, names parts, and refuses what does not fit") {
  Rig rig = fixtures::tube();
  std::swap(rig.nodes[0], rig.nodes[1]);
  rig.nodes[0].parent = 1;
  rig.nodes[1].parent = -1;
  std::swap(rig.bones[0].node, rig.bones[1].node);
  rig.nodes.push_back({.name = "upper", .parent = 0});
  rig.part_names.clear();
  finish_rig(rig);
  CHECK(rig.nodes[0].name == "lower");
  CHECK(rig.nodes[rig.bones[1].node].name == "upper");
  CHECK(rig.nodes[2].name == "upper.2");
  CHECK(rig.part_names == std::vector<std::string>{"lower", "upper"});
  CHECK(rig.surface.parts.front() == 0);
  CHECK(rig.surface.parts.back() == 1);
  CHECK(rig.find_clip("none") == -1);
  const auto refuses = [&](const auto& spoil, const char* why) {
    Rig broken = rig;
    spoil(broken);
    CHECK_THROWS_WITH_AS(finish_rig(broken), doctest::Contains(why), InputError);
  };
  refuses([](Rig& r) { r.nodes[0].parent = 1; }, "its own ancestor");
  refuses([](Rig& r) { r.nodes[0].parent = 77; }, "does not exist");
  refuses([](Rig& r) { r.bones[0].node = -1; }, "node -1");
  refuses([](Rig& r) { r.surface.triangles[3].y = 9999; }, "vertex 9999");
  refuses([](Rig& r) { r.surface.triangles.clear(); }, "no triangles");
  refuses([](Rig& r) { r.surface.uvs.resize(3); }, "3 UVs");
  refuses([](Rig& r) { r.surface.rest[4].z = std::numeric_limits<float>::infinity(); },
          "vertex 4 of mesh 'tube' is not finite");
  refuses([](Rig& r) { r.influences[2].bone = 5; }, "bound to joint 5");
  refuses([](Rig& r) { r.influence_begin[3] = 0; }, "table of influences");
  refuses([](Rig& r) { r.meshes[0].vertex_count--; }, "mesh");
  refuses([](Rig& r) { r.nodes[1].rotation = dquat(0, 0, 0, 0); }, "node 'upper'");
}

TEST_CASE("Smooth normals of a mesh without normals point outwards across seams") {
  Rig rig = fixtures::tube();
  const auto exact = rig.surface.normals;
  rig.surface.normals.clear();
  finish_rig(rig);
  for (int ring = 1; ring < 20; ++ring)
    for (int s = 0; s < 16; ++s) CHECK(glm::length(rig.surface.normals[ring * 16 + s] - exact[ring * 16 + s]) < 1e-5f);
}

TEST_CASE("Collada: centimetres and axes are taken out of the root, node by node") {
  const auto dae = [](const char* unit, const char* up) {
    return std::string(
               "<?xml version=\"1.0\"?><COLLADA xmlns=\"http://www.collada.org/2005/11/COLLADASchema\" "
               "version=\"1.4.1\"><asset>") +
           unit + "<up_axis>" + up +
           "</up_axis></asset><library_geometries><geometry id=\"g\" name=\"g\"><mesh><source id=\"p\">"
           "<float_array id=\"pa\" count=\"9\">0 0 0 100 0 0 0 0 200</float_array><technique_common><accessor "
           "source=\"#pa\" count=\"3\" stride=\"3\">"
           "<param name=\"X\" type=\"float\"/><param name=\"Y\" type=\"float\"/><param name=\"Z\" "
           "type=\"float\"/></accessor></technique_common></source>"
           "<vertices id=\"v\"><input semantic=\"POSITION\" source=\"#p\"/></vertices><triangles count=\"1\"><input "
           "semantic=\"VERTEX\" source=\"#v\" offset=\"0\"/>"
           "<p>0 1 2</p></triangles></mesh></geometry></library_geometries><library_visual_scenes><visual_scene "
           "id=\"s\" name=\"s\"><node id=\"n\" name=\"n\">"
           "<translate>10 20 30</translate><instance_geometry "
           "url=\"#g\"/></node></visual_scene></library_visual_scenes><scene><instance_visual_scene "
           "url=\"#s\"/></scene></COLLADA>";
  };
  const TempFolder folder;
  const auto load = [&](const char* unit, const char* up) {
    std::ofstream(folder.path / "a.dae") << dae(unit, up);
    return load_rig(folder.path / "a.dae");
  };
  const Rig z = load("<unit name=\"centimeter\" meter=\"0.01\"/>", "Z_UP");
  CHECK(glm::length(z.surface.rest[1] - vec3(1.1f, 0.2f, 0.3f)) < 1e-6f);
  CHECK(glm::length(z.surface.rest[2] - vec3(0.1f, 0.2f, 2.3f)) < 1e-6f);
  CHECK(glm::length(z.nodes[z.find_node("n")].translation - dvec3(0.1, 0.2, 0.3)) < 1e-7);
  CHECK(z.nodes[0].scale == dvec3(1));
  const Rig y = load("", "Y_UP");
  CHECK(y.surface.rest[2] == vec3(10, -230, 20));
  const Rig x = load("", "X_UP");
  CHECK(x.surface.rest[1] == vec3(-20, -30, 110));
  std::ofstream(folder.path / "a.dae") << "<COLLADA";
  CHECK_THROWS_AS(load_rig(folder.path / "a.dae"), InputError);
}

TEST_CASE("OBJ: texture coordinates grow downwards, MTL textures are found, missing ones are a warning") {
  const TempFolder folder;
  std::ofstream(folder.path / "a.obj")
      << "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 0.75\nvt 0 1\n"
         "usemtl hide\nf 1/1 2/2 3/3 4/4\n";
  std::ofstream(folder.path / "a.mtl") << "newmtl hide\nKd 0.5 0.25 1\nmap_Kd some\\folder\\hide.png\n";
  const auto texture = [](const Rig& rig) { return rig.materials.at(rig.surface.materials.at(0)).base_texture.image; };
  Rig rig = load_rig(folder.path / "a.obj");
  CHECK(rig.surface.triangles.size() == 2);
  CHECK(rig.surface.rest.size() == 4);
  CHECK(rig.surface.rest[2] == vec3(1, 0, 1));
  CHECK(rig.surface.uvs[2] == vec2(1, 0.25f));
  CHECK(texture(rig) == -1);
  CHECK(rig.warnings.at(0).find("is not there") != std::string::npos);
  std::ofstream(folder.path / "hide.png") << "\x89PNG";
  rig = load_rig(folder.path / "a.obj");
  REQUIRE(texture(rig) == 0);
  CHECK(rig.images.at(0).bytes.size() == 4);
  CHECK(rig.materials.at(rig.surface.materials.at(0)).base_color == vec3(0.5f, 0.25f, 1));
}
