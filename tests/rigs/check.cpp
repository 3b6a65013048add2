#include "rigs/check.h"

#include <doctest/doctest.h>

#include <fstream>

#include "generator/core/error.h"
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
  rig.nodes.push_back({.name = "lower", .parent = 1});
  rig.bones.push_back({2, dmat4(1.0)});
  rig.nodes[1].translation = {0, 0, 1.25};  // saved in a pose
  for (vec3& p : rig.surface.rest) p *= 100.0f;
  const auto findings = check_rig(rig);
  CHECK(finds(findings, "1 of 641 triangles have no area", suspicious));
  CHECK(finds(findings, "3 of 976 edges have more than two triangles", suspicious));
  CHECK(finds(findings, "edges join triangles that face opposite ways", suspicious));
  CHECK(finds(findings, "weights of 1 vertices do not sum to 1", wrong));
  CHECK(finds(findings, "1 nodes share a name with another: lower", wrong));
  CHECK(finds(findings, "1 joints move no vertex: lower", suspicious));
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
  std::get<JointAnchor>(species.keypoints[0].anchor).neutral = {0.5, 0, 0.5};
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
  CHECK(finds(findings, "keypoint 'left' is outside of the body, 0.3", suspicious));
  species = tube_species();
  species.keypoints.push_back({.name = "left hoof", .anchor = JointAnchor{0, {-0.05, 0, 0.2}}});
  species.keypoints.push_back({.name = "right hoof", .anchor = JointAnchor{0, {0.05, 0, 0.2}}});
  species.pairs.push_back({2, 3});
  CHECK(finds(check_species(species), "'left hoof' and 'right hoof' are swapped", wrong));
  species.rig.surface.nnopcs.clear();
  CHECK(finds(check_species(species), "not baked", wrong));
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
