// Files made here, byte by byte: what glTF allows must load to values known beforehand, what it forbids must be refused
// in one sentence.
#include <doctest/doctest.h>

#include <fstream>
#include <nlohmann/json.hpp>
#include <random>

#include "generator/core/error.h"
#include "rigs/pose.h"
#include "tests/rigs/fixtures.h"

using namespace moomill;
using nlohmann::json;
namespace fs = std::filesystem;

namespace {

std::string base64(const std::string& bytes) {
  const char* digits = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string out;
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    std::uint32_t v = 0;
    for (std::size_t k = 0; k < 3; ++k)
      v = v << 8 | (i + k < bytes.size() ? static_cast<std::uint8_t>(bytes[i + k]) : 0u);
    for (std::size_t k = 0; k < 4; ++k) out += i + k > bytes.size() ? '=' : digits[v >> (18 - 6 * k) & 63];
  }
  return out;
}

// A document under construction. Data goes into one buffer.
struct File {
  json j = {{"asset", {{"version", "2.0"}}}};
  std::string bin;

  int view(const std::string& bytes, int stride = 0) {
    while (bin.size() % 4) bin += '\0';
    json v = {{"buffer", 0}, {"byteOffset", bin.size()}, {"byteLength", bytes.size()}};
    if (stride) v["byteStride"] = stride;
    bin += bytes;
    j["bufferViews"].push_back(v);
    return static_cast<int>(j["bufferViews"].size()) - 1;
  }
  template <class T>
  static std::string raw(const std::vector<T>& v) {
    return std::string(reinterpret_cast<const char*>(v.data()), v.size() * sizeof(T));
  }
  int accessor(int view_index, int component, int count, const char* type, int offset = 0) {
    json a = {{"componentType", component}, {"count", count}, {"type", type}, {"byteOffset", offset}};
    if (view_index >= 0) a["bufferView"] = view_index;
    j["accessors"].push_back(a);
    return static_cast<int>(j["accessors"].size()) - 1;
  }
  int floats(const std::vector<float>& v, const char* type, int width) {
    return accessor(view(raw(v)), 5126, static_cast<int>(v.size()) / width, type);
  }
  int indices(const std::vector<std::uint16_t>& v) {
    return accessor(view(raw(v)), 5123, static_cast<int>(v.size()), "SCALAR");
  }
  // One node with one mesh of one primitive, unless there are nodes already.
  void mesh(json primitive) {
    j["meshes"].push_back({{"name", "m"}, {"primitives", {std::move(primitive)}}});
    if (!j.contains("nodes")) j["nodes"] = {{{"mesh", 0}, {"name", "n"}}};
    if (!j.contains("scenes")) j["scenes"] = {{{"nodes", {0}}}};
  }
  std::string glb() {
    while (bin.size() % 4) bin += '\0';
    if (!bin.empty()) j["buffers"] = {{{"byteLength", bin.size()}}};
    std::string text = j.dump();
    while (text.size() % 4) text += ' ';
    const auto word = [](std::size_t v) {
      const auto w = static_cast<std::uint32_t>(v);
      return std::string(reinterpret_cast<const char*>(&w), 4);
    };
    std::string body = word(text.size()) + "JSON" + text;
    if (!bin.empty()) body += word(bin.size()) + std::string("BIN\0", 4) + bin;
    return "glTF" + word(2) + word(12 + body.size()) + body;
  }
  std::string data_uri_gltf() {
    j["buffers"] = {{{"byteLength", bin.size()}, {"uri", "data:application/octet-stream;base64," + base64(bin)}}};
    return j.dump();
  }
};

void put(const fs::path& file, const std::string& bytes) {
  std::ofstream(file, std::ios::binary) << bytes;
}

Rig load_bytes(const std::string& bytes, const char* name = "file.glb", const LoadOptions& options = {}) {
  const TempFolder folder;
  put(folder.path / name, bytes);
  return load_rig(folder.path / name, options);
}

// The message of the refusal; empty where the file loads.
std::string refusal(const std::string& bytes, const char* name = "file.glb") {
  try {
    load_bytes(bytes, name);
  } catch (const InputError& e) {
    const std::string message = e.what();
    CHECK(message.find(name) != std::string::npos);  // names the file
    CHECK(message.find('\n') == std::string::npos);  // one sentence
    CHECK(message.size() < 600);
    return message;
  }
  return {};
}

bool has(const std::string& text, const std::string& part) {
  INFO(text);
  const bool found = text.find(part) != std::string::npos;
  CHECK(found);
  return found;
}

const std::vector<float> triangle = {0, 0, 0, 1, 0, 0, 0, 2, 0};  // glTF axes

// Three vertices bound to two joints; weights and joints as given.
File skinned(const std::vector<float>& weights,
             const std::vector<std::uint8_t>& joints = {0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0}) {
  File f;
  f.j["nodes"] = {{{"mesh", 0}, {"skin", 0}, {"name", "holder"}, {"translation", {100, 0, 0}}},
                  {{"name", "hip"}, {"children", {2}}, {"translation", {0, 1, 0}}},
                  {{"name", "knee"}, {"translation", {0, 1, 0}}}};
  f.j["scenes"] = {{{"nodes", {0, 1}}}};
  std::vector<float> bind(32, 0);
  for (int m = 0; m < 2; ++m) {
    for (int i = 0; i < 4; ++i) bind[16 * m + 5 * i] = 1;
    bind[16 * m + 13] = m ? -2.0f : -1.0f;
  }
  f.j["skins"] = {{{"joints", {1, 2}}, {"inverseBindMatrices", f.floats(bind, "MAT4", 16)}}};
  f.mesh({{"attributes",
           {{"POSITION", f.floats(triangle, "VEC3", 3)},
            {"JOINTS_0", f.accessor(f.view(File::raw(joints)), 5121, 3, "VEC4")},
            {"WEIGHTS_0", f.floats(weights, "VEC4", 4)}}}});
  return f;
}

std::vector<vec3> posed(const Rig& rig) {
  return skin(rig, bone_matrices(rig, world_transforms(rig, bind_pose(rig))), {}, SkinningMethod::linear_blend,
              dvec3(0))
      .positions;
}

}  // namespace

TEST_CASE("glTF axes become ours by an exact permutation, and a file without normals gets flat or smooth ones") {
  File f;
  f.mesh({{"attributes", {{"POSITION", f.floats({0.1f, 0.2f, 0.3f, 1, 0.2f, 0.3f, 0.1f, 0.2f, -1}, "VEC3", 3)}}}});
  f.j["nodes"][0]["translation"] = {0, 0, 0};
  const Rig rig = load_bytes(f.glb());
  CHECK(rig.surface.rest[0] == vec3(0.1f, -0.3f, 0.2f));
  CHECK(rig.surface.rest[2] == vec3(0.1f, 1, 0.2f));
  CHECK(glm::length(rig.surface.normals[1] - vec3(0, 0, 1)) < 1e-6f);
  CHECK(rig.part_names == std::vector<std::string>{"m"});
}

TEST_CASE("Data URIs, buffer files with spaces and larger than needed, and scenes are found") {
  File f;
  f.mesh({{"attributes", {{"POSITION", f.floats(triangle, "VEC3", 3)}}}});
  CHECK(load_bytes(f.data_uri_gltf(), "file.gltf").surface.rest[2] == vec3(0, 0, 2));
  const TempFolder folder;
  put(folder.path / "a b.bin", f.bin + "more than byteLength");
  f.j["buffers"] = {{{"byteLength", f.bin.size()}, {"uri", "a%20b.bin"}}};
  put(folder.path / "x.gltf", f.j.dump());
  CHECK(load_rig(folder.path / "x.gltf").surface.rest[2] == vec3(0, 0, 2));
  fs::remove(folder.path / "a b.bin");
  CHECK_THROWS_WITH_AS(load_rig(folder.path / "x.gltf"), doctest::Contains("'a b.bin', which is not there"),
                       InputError);
  put(folder.path / "a b.bin", "short");
  CHECK_THROWS_WITH_AS(load_rig(folder.path / "x.gltf"), doctest::Contains("should have 36 bytes"), InputError);
}

TEST_CASE("Scenes: the default, one by number, none at all") {
  File f;
  f.j["nodes"] = {{{"mesh", 0}, {"name", "n0"}}, {{"mesh", 1}, {"name", "n1"}, {"translation", {0, 0, -5}}}};
  f.j["scenes"] = {{{"nodes", {0}}}, {{"nodes", {1}}}};
  f.j["scene"] = 1;
  for (int i = 0; i < 2; ++i) f.mesh({{"attributes", {{"POSITION", f.floats(triangle, "VEC3", 3)}}}});
  CHECK(load_bytes(f.glb()).surface.rest[0] == vec3(0, 5, 0));
  CHECK(load_bytes(f.glb(), "file.glb", {.scene = 0}).surface.rest[0] == vec3(0, 0, 0));
  CHECK_THROWS_WITH_AS(load_bytes(f.glb(), "file.glb", {.scene = 2}), doctest::Contains("no scene 2"), InputError);
  f.j.erase("scene");
  CHECK(load_bytes(f.glb()).surface.rest.size() == 3);
  f.j.erase("scenes");
  CHECK(load_bytes(f.glb()).surface.rest.size() == 6);
  CHECK(load_bytes(f.glb(), "file.glb", {.include_meshes = {"n1"}}).surface.rest.size() == 3);
  CHECK_THROWS_WITH_AS(load_bytes(f.glb(), "file.glb", {.include_meshes = {"x"}}), doctest::Contains("no mesh 'x'"),
                       InputError);
  CHECK(load_bytes(f.glb(), "file.glb", {.scale = 0.5}).surface.rest[2] == vec3(0, 0, 1));
}

TEST_CASE("Strips, fans, unindexed triangles, and points that are left out") {
  const std::vector<float> square = {0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0};
  const auto normals_of = [](const Rig& rig) {
    std::vector<vec3> n;
    for (const uvec3& t : rig.surface.triangles)
      n.push_back(
          glm::cross(rig.surface.rest[t[1]] - rig.surface.rest[t[0]], rig.surface.rest[t[2]] - rig.surface.rest[t[0]]));
    return n;
  };
  File strip;
  strip.mesh({{"attributes", {{"POSITION", strip.floats(square, "VEC3", 3)}}}, {"mode", 5}});
  File fan;
  fan.mesh({{"attributes", {{"POSITION", fan.floats(square, "VEC3", 3)}}},
            {"mode", 6},
            {"indices", fan.indices({0, 1, 3, 2})}});
  for (File* f : {&strip, &fan}) {
    const Rig rig = load_bytes(f->glb());
    const auto n = normals_of(rig);
    REQUIRE(n.size() == 2);  // both face glTF's +z, our -y
    CHECK(n[0] == vec3(0, -1, 0));
    CHECK(n[1] == vec3(0, -1, 0));
  }
  File points;
  points.mesh({{"attributes", {{"POSITION", points.floats(square, "VEC3", 3)}}}, {"mode", 0}});
  has(refusal(points.glb()), "no triangles");
  points.j["meshes"][0]["primitives"][0]["mode"] = 9;
  has(refusal(points.glb()), "primitive mode 9");
}

TEST_CASE("Sparse accessors, with and without a base") {
  File f;
  json sparse = {{"count", 1},
                 {"indices", {{"bufferView", f.view(File::raw<std::uint8_t>({2}))}, {"componentType", 5121}}},
                 {"values", {{"bufferView", f.view(File::raw<float>({7, 8, 9}))}}}};
  const int with_base = f.floats(triangle, "VEC3", 3);
  f.j["accessors"][with_base]["sparse"] = sparse;
  const int without = f.accessor(-1, 5126, 3, "VEC3");
  f.j["accessors"][without]["sparse"] = sparse;
  f.mesh({{"attributes", {{"POSITION", with_base}}}});
  CHECK(load_bytes(f.glb()).surface.rest[1] == vec3(1, 0, 0));
  CHECK(load_bytes(f.glb()).surface.rest[2] == vec3(7, -9, 8));
  f.j["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = without;
  CHECK(load_bytes(f.glb()).surface.rest[1] == vec3(0, 0, 0));
  CHECK(load_bytes(f.glb()).surface.rest[2] == vec3(7, -9, 8));
  f.j["accessors"][without]["sparse"]["count"] = 4;
  has(refusal(f.glb()), "broken sparse part");
  f.j["accessors"][without]["sparse"]["count"] = 1;
  f.j["accessors"][without]["count"] = 2;
  has(refusal(f.glb()), "replaces element 2");
  f.j["accessors"][without].erase("sparse");
  f.j["accessors"][without]["count"] = 1000000000000;
  has(refusal(f.glb()), "no data");
}

TEST_CASE("Interleaved and quantised attributes") {
  File f;
  std::string bytes;
  for (int i = 0; i < 3; ++i) {
    const std::int16_t p[3] = {static_cast<std::int16_t>(i == 1 ? 32767 : 0),
                               static_cast<std::int16_t>(i == 2 ? -32768 : 0), 0};
    const std::uint8_t uv[2] = {static_cast<std::uint8_t>(51 * i), 255};
    bytes += std::string(reinterpret_cast<const char*>(p), 6) + std::string(2, '\0') +
             std::string(reinterpret_cast<const char*>(uv), 2) + std::string(2, '\0');
  }
  const int view = f.view(bytes, 12);
  const int position = f.accessor(view, 5122, 3, "VEC3"), uv = f.accessor(view, 5121, 3, "VEC2", 8);
  f.j["accessors"][position]["normalized"] = true;
  f.j["accessors"][uv]["normalized"] = true;
  f.j["extensionsRequired"] = {"KHR_mesh_quantization"};
  f.mesh({{"attributes", {{"POSITION", position}, {"TEXCOORD_0", uv}}}});
  const Rig rig = load_bytes(f.glb());
  CHECK(rig.surface.rest[1] == vec3(1, 0, 0));
  CHECK(rig.surface.rest[2] == vec3(0, 0, -1));  // -32768 is clamped to -1
  CHECK(rig.surface.uvs[2] == vec2(0.4f, 1));
  f.j["accessors"][uv]["byteOffset"] = 12;
  has(refusal(f.glb()), "past the end");
}

TEST_CASE("Skins: the node of a skinned mesh does not move it, weights are normalised, zero weights are dropped") {
  File f = skinned({0.5f, 0.5f, 0, 0, 2, 6, 0, 0, 0, 1, 0, 0});
  const Rig rig = load_bytes(f.glb());
  CHECK(rig.surface.rest[2] == vec3(0, 0, 2));
  CHECK(rig.bones.size() == 2);
  CHECK(rig.influences.size() == 5);
  CHECK(rig.influences[2].weight == 0.25f);
  REQUIRE(rig.warnings.size() == 2);
  CHECK(rig.warnings[0].find("1 of 3 vertices did not sum to 1") != std::string::npos);
  CHECK(rig.part_names == std::vector<std::string>{"knee"});
  const auto p = posed(rig);
  for (int i = 0; i < 3; ++i) CHECK(glm::length(p[i] - rig.surface.rest[i]) < 1e-6f);
  Pose bent = bind_pose(rig);  // the knee turns by 90 degrees about our y axis, at z = 2
  bent.local[rig.find_node("knee")] =
      LocalTransform{.translation = {0, 0, 1}, .rotation = glm::angleAxis(pi / 2, dvec3(0, 1, 0))};
  const auto q =
      skin(rig, bone_matrices(rig, world_transforms(rig, bent)), {}, SkinningMethod::linear_blend, dvec3(0)).positions;
  CHECK(glm::length(q[2] - vec3(0, 0, 2)) < 1e-6f);                                     // on the joint
  CHECK(glm::length(q[1] - (0.25f * vec3(1, 0, 0) + 0.75f * vec3(-2, 0, 1))) < 1e-6f);  // analytic blend
}

TEST_CASE("A skin in units of its own comes to metres without moving a posed vertex") {
  File f = skinned({0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0});
  f.j["nodes"][1]["scale"] = {0.01, 0.01, 0.01};  // centimetres below an armature, as exporters do
  const Rig rig = load_bytes(f.glb());
  const auto p = posed(rig);
  // world(knee) * inverse bind * p = (0, 1, 0) + 0.01 * ((0, 1, 0) + p - (0, 2, 0)) in glTF axes
  CHECK(glm::length(p[2] - vec3(0, 0, 1.01f)) < 1e-6f);
  CHECK(glm::length(rig.surface.rest[1] - rig.surface.rest[0] - vec3(0.01f, 0, 0)) < 1e-7f);
}

TEST_CASE("u8 normalised weights sum to one exactly enough, and eight influences are read in order") {
  File f = skinned({1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0});
  auto& attributes = f.j["meshes"][0]["primitives"][0]["attributes"];
  const std::vector<std::uint8_t> w = {100, 55, 0, 0, 100, 55, 0, 0, 100, 55, 0, 0},
                                  w1 = {50, 50, 0, 0, 50, 50, 0, 0, 50, 50, 0, 0};
  const std::vector<std::uint8_t> joints = {1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0};
  for (int set = 0; set < 2; ++set) {
    const int a = f.accessor(f.view(File::raw(set ? w1 : w)), 5121, 3, "VEC4");
    f.j["accessors"][a]["normalized"] = true;
    attributes[set ? "WEIGHTS_1" : "WEIGHTS_0"] = a;
    attributes[set ? "JOINTS_1" : "JOINTS_0"] = f.accessor(f.view(File::raw(joints)), 5121, 3, "VEC4");
  }
  const Rig rig = load_bytes(f.glb());
  REQUIRE(rig.influence_begin[1] == 4);
  const float expected[] = {100 / 255.f, 55 / 255.f, 50 / 255.f, 50 / 255.f};
  for (int k = 0; k < 4; ++k) {
    CHECK(rig.influences[k].weight == expected[k]);
    CHECK(rig.influences[k].bone == (k % 2 ? 0u : 1u));
  }
  CHECK(rig.warnings.size() == 1);  // the normals; not the weights
  attributes.erase("WEIGHTS_1");
  has(refusal(f.glb()), "JOINTS_1 but no WEIGHTS_1");
}

TEST_CASE("Bad weights, positions and joints are refused by the name of the vertex") {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  has(refusal(skinned({1, 0, 0, 0, 1.5f, -0.5f, 0, 0, 1, 0, 0, 0}).glb()),
      "vertex 1 of mesh 'm' has the negative weight -0.5");
  has(refusal(skinned({1, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0}).glb()), "vertex 2 of mesh 'm' has no weight");
  has(refusal(skinned({nan, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0}).glb()),
      "vertex 0 of mesh 'm' has a weight that is not a number");
  has(refusal(skinned({1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0}, {0, 0, 0, 0, 9, 0, 0, 0, 0, 0, 0, 0}).glb()),
      "vertex 1 of mesh 'm' is bound to joint 9");
  File f;
  f.mesh({{"attributes", {{"POSITION", f.floats({0, 0, 0, 1, nan, 0, 0, 1, 0}, "VEC3", 3)}}}});
  has(refusal(f.glb()), "position of vertex 1 of mesh 'm' is not finite");
}

TEST_CASE("The same mesh on several nodes is there several times, a mirrored node keeps triangles facing out") {
  File f;
  f.j["nodes"] = {{{"mesh", 0}, {"name", "n"}},
                  {{"mesh", 0}, {"name", "n"}, {"scale", {-1, 1, 1}}, {"translation", {0, 0, -3}}}};
  f.j["scenes"] = {{{"nodes", {0, 1}}}};
  f.mesh(
      {{"attributes",
        {{"POSITION", f.floats(triangle, "VEC3", 3)}, {"NORMAL", f.floats({0, 0, 1, 0, 0, 1, 0, 0, 1}, "VEC3", 3)}}}});
  const Rig rig = load_bytes(f.glb());
  REQUIRE(rig.surface.triangles.size() == 2);
  CHECK(rig.surface.rest[4] == vec3(-1, 3, 0));
  CHECK(rig.nodes[1].name == "n.2");
  for (const uvec3& t : rig.surface.triangles) {
    const auto& p = rig.surface.rest;
    CHECK(glm::dot(glm::cross(p[t[1]] - p[t[0]], p[t[2]] - p[t[0]]), rig.surface.normals[t[0]]) > 0);
  }
  const auto q = posed(rig);
  CHECK(glm::length(q[4] - vec3(-1, 3, 0)) < 1e-6f);
}

TEST_CASE("Clips: step, linear on the short way round, and spline, against values worked out by hand") {
  File f;
  f.mesh({{"attributes", {{"POSITION", f.floats(triangle, "VEC3", 3)}}}});
  const int times = f.floats({1, 3}, "SCALAR", 1);
  const float h = std::sqrt(0.5f);
  const int steps = f.floats({1, 2, 3, 4, 5, 6}, "VEC3", 3);
  const int turns = f.floats({0, 0, 0, 1, 0, 0, -h, -h}, "VEC4", 4);  // -q of 90 degrees about z
  const int spline = f.floats({0, 0, 0, 1, 1, 1, 2, 0, 0, 0, 0, 0, 5, 1, 1, 0, 0, 0}, "VEC3", 3);
  f.j["animations"] = {{{"name", "go"},
                        {"samplers",
                         {{{"input", times}, {"output", steps}, {"interpolation", "STEP"}},
                          {{"input", times}, {"output", turns}},
                          {{"input", times}, {"output", spline}, {"interpolation", "CUBICSPLINE"}}}},
                        {"channels",
                         {{{"sampler", 0}, {"target", {{"node", 0}, {"path", "translation"}}}},
                          {{"sampler", 1}, {"target", {{"node", 0}, {"path", "rotation"}}}},
                          {{"sampler", 2}, {"target", {{"node", 0}, {"path", "scale"}}}}}}}};
  const Rig rig = load_bytes(f.glb());
  const Clip& clip = rig.clips.at(rig.find_clip("go"));
  CHECK(clip.duration == 3);
  const auto at = [&](double t) { return *sample_clip(rig, clip, t).local[0]; };
  CHECK(at(-7).translation == dvec3(1, -3, 2));
  CHECK(at(2.999).translation == dvec3(1, -3, 2));
  CHECK(at(3).translation == dvec3(4, -6, 5));
  CHECK(at(99).translation == dvec3(4, -6, 5));
  // 45 degrees half way, about glTF's z, which is our -y.
  const dquat q = at(2).rotation;
  CHECK(q.w == doctest::Approx(std::cos(pi / 8)).epsilon(1e-7));
  CHECK(q.y == doctest::Approx(-std::sin(pi / 8)).epsilon(1e-7));
  // Appendix C at t = 1/4 of a span of 2 s: value 1 -> 5, leaving with tangent 2, arriving with 0.
  const double t = 0.25, expected = (2 * t * t * t - 3 * t * t + 1) * 1 + 2 * (t * t * t - 2 * t * t + t) * 2 +
                                    (3 * t * t - 2 * t * t * t) * 5;
  CHECK(at(1.5).scale.x == doctest::Approx(expected).epsilon(1e-7));
  f.j["animations"][0]["samplers"][0]["interpolation"] = "ODD";
  has(refusal(f.glb()), "interpolation 'ODD'");
  f.j["animations"][0]["samplers"][0]["interpolation"] = "CUBICSPLINE";
  has(refusal(f.glb()), "2 times but 2 values");
}

TEST_CASE("Morph targets, their default weights and clips of weights") {
  File f;
  const int delta = f.floats({0, 0, 0, 0, 0, 0, 0, 0, -1}, "VEC3", 3);
  f.mesh({{"attributes", {{"POSITION", f.floats(triangle, "VEC3", 3)}}}, {"targets", {{{"POSITION", delta}}}}});
  f.j["meshes"][0]["weights"] = {0.5};
  f.j["meshes"][0]["extras"]["targetNames"] = {"open"};
  f.j["animations"] = {
      {{"samplers", {{{"input", f.floats({0, 1}, "SCALAR", 1)}, {"output", f.floats({0, 1}, "SCALAR", 1)}}}},
       {"channels", {{{"sampler", 0}, {"target", {{"node", 0}, {"path", "weights"}}}}}}}};
  const Rig rig = load_bytes(f.glb());
  REQUIRE(rig.morphs.size() == 1);
  CHECK(rig.morphs[0].name == "open");
  CHECK(posed(rig)[2] == vec3(0, 0.5f, 2));
  CHECK(sample_clip(rig, rig.clips[0], 0.25).morph_weights == std::vector<double>{0.25});
}

TEST_CASE("Materials: colour, transform and wrap of textures, missing and embedded images") {
  File f;
  f.mesh({{"attributes", {{"POSITION", f.floats(triangle, "VEC3", 3)}}}, {"material", 0}});
  f.j["images"] = {{{"bufferView", f.view("\x89PNGbytes")}, {"mimeType", "image/png"}}, {{"uri", "lost%20hide.png"}}};
  f.j["samplers"] = {{{"wrapS", 33071}, {"wrapT", 33648}}};
  f.j["textures"] = {{{"source", 0}, {"sampler", 0}}, {{"source", 1}}};
  f.j["materials"] = {
      {{"name", "hide"},
       {"alphaMode", "MASK"},
       {"normalTexture", {{"index", 1}}},
       {"pbrMetallicRoughness",
        {{"baseColorFactor", {0.1, 0.2, 0.3, 0.4}},
         {"baseColorTexture",
          {{"index", 0},
           {"extensions",
            {{"KHR_texture_transform", {{"offset", {0.5, 0}}, {"scale", {2, 3}}, {"rotation", 1.5}}}}}}}}}}};
  const Rig rig = load_bytes(f.glb());
  const RigMaterial& m = rig.materials.at(0);
  CHECK(m.base_color == vec3(0.1f, 0.2f, 0.3f));
  CHECK(m.alpha == 0.4f);
  CHECK(m.alpha_mask);
  CHECK(m.metallic == 1);
  CHECK(m.base_texture.wrap_u == Wrap::clamp);
  CHECK(m.base_texture.wrap_v == Wrap::mirror);
  CHECK(m.base_texture.scale == vec2(2, 3));
  CHECK(m.base_texture.rotation == 1.5f);
  REQUIRE(rig.images.size() == 1);
  CHECK(rig.images[0].bytes.size() == 9);
  CHECK(m.normal_texture.image == -1);
  CHECK(rig.warnings.at(0).find("'lost hide.png' is not there") != std::string::npos);
  f.j["textures"][0]["source"] = 5;
  has(refusal(f.glb()), "refers to image 5");
}

TEST_CASE("Broken structure is refused by its place") {
  File f;
  f.mesh({{"attributes", {{"POSITION", f.floats(triangle, "VEC3", 3)}}}, {"indices", f.indices({0, 1, 2})}});
  const auto with = [&](const char* pointer, const json& value) {
    File g = f;
    g.j[json::json_pointer(pointer)] = value;
    return refusal(g.glb());
  };
  CHECK(refusal(f.glb()).empty());
  has(with("/nodes", {{{"mesh", 0}, {"children", {1}}}, {{"children", {0}}}}), "own ancestor");
  has(with("/nodes", {{{"mesh", 0}, {"children", {0}}}}), "own ancestor");
  has(with("/nodes", {{{"children", {2}}}, {{"children", {2}}}, {{"mesh", 0}}}), "child of both");
  has(with("/nodes/0/children", {7}), "refers to node 7");
  has(with("/nodes/0/mesh", 3), "refers to mesh 3");
  has(with("/nodes/0/rotation", {0, 0, 0, 0}), "rotation is zero");
  has(with("/nodes/0/scale", {1, 2}), "scale has 2 numbers");
  has(with("/nodes/0/skin", 0), "refers to skin 0");
  has(with("/scenes/0/nodes", {4}), "refers to node 4");
  has(with("/scene", 4), "refers to scene 4");
  has(with("/accessors/0/bufferView", 9), "refers to bufferView 9");
  has(with("/accessors/0/count", 400), "past the end of bufferViews[0]");
  has(with("/accessors/0/type", "VEC2"), "2 numbers per element");
  has(with("/accessors/0/componentType", 5124), "component type 5124");
  has(with("/bufferViews/0/byteOffset", 1000), "past the end of buffer 0");
  has(with("/bufferViews/0/byteLength", std::uint64_t(-1)), "past the end of buffer 0");
  has(with("/bufferViews/0/buffer", 3), "refers to buffer 3");
  has(with("/meshes/0/primitives/0/attributes/NORMAL", 1), "1 numbers per element");
  has(with("/meshes/0/primitives/0/material", 2), "refers to material 2");
  has(with("/asset/version", "1.0"), "glTF version 1.0 is not supported");
  has(with("/extensionsRequired", {"KHR_draco_mesh_compression"}), "requires the extension KHR_draco_mesh_compression");
  has(refusal("{\"asset\":", "file.gltf"), "JSON cannot be read");
  has(refusal("[]", "file.gltf"), "not an object");
  has(refusal("{}", "file.gltf"), "asset.version is missing");
  has(refusal(std::string(5000, '['), "file.gltf"), "nests deeper");
  has(refusal("{\"asset\":{\"version\":\"2.0\"},\"extras\":" + std::string(500, '[') + std::string(500, ']') + "}",
              "file.gltf"),
      "nests deeper");
  has(refusal("", "file.glb"), "is empty");
  has(refusal("hello", "file.txt"), "'.txt' is not a model format");
  CHECK_THROWS_AS(load_rig("no/such/file.glb"), InputError);
  CHECK_THROWS_AS(load_rig(fs::temp_directory_path()), InputError);
  File other = f;
  std::uint16_t wild = 3;
  std::memcpy(other.bin.data() + other.j["bufferViews"][1]["byteOffset"].get<int>(), &wild, 2);
  has(refusal(other.glb()), "index 0 of mesh 'm' is 3");
}

TEST_CASE("A .glb cut short anywhere is refused") {
  const TempFolder folder;
  write_glb(fixtures::tube(), folder.path / "tube.glb");
  std::ifstream in(folder.path / "tube.glb", std::ios::binary);
  const std::string whole{std::istreambuf_iterator<char>(in), {}};
  REQUIRE(whole.size() > 10000);
  CHECK(refusal(whole).empty());
  std::size_t tried = 0;
  for (std::size_t size = 0; size < whole.size(); size += 64, ++tried) {
    std::string cut = whole.substr(0, size);
    CHECK(!refusal(cut).empty());
    if (size < 12) continue;
    // The same with a header that claims the file is whole.
    const auto length = static_cast<std::uint32_t>(size);
    std::memcpy(&cut[8], &length, 4);
    CHECK(!refusal(cut).empty());
  }
  MESSAGE(tried, " prefixes refused");
}

TEST_CASE("Flipped bytes never crash: files load or are refused in a sentence") {
  const TempFolder folder;
  write_glb(fixtures::awkward_rig(), folder.path / "own.glb");
  std::ifstream in(folder.path / "own.glb", std::ios::binary);
  const std::string own{std::istreambuf_iterator<char>(in), {}};
  std::string plain = own;
  plain.replace(plain.find("\"moomill\":"), 10, "\"someone\":");
  const std::string text = skinned({0.5f, 0.5f, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0}).data_uri_gltf();
  const std::pair<const std::string*, const char*> inputs[] = {
      {&own, "file.glb"}, {&plain, "file.glb"}, {&text, "file.gltf"}};
  std::mt19937 random(12345);
  std::size_t loaded = 0, refused = 0;
  for (int i = 0; i < 500; ++i)
    for (const auto& [bytes, name] : inputs) {
      std::string broken = *bytes;
      // Every other time only digits become other digits: such files pass the JSON parser and break further in.
      for (unsigned flips = 1 + random() % 4; flips-- > 0;) {
        std::size_t at = random() % broken.size();
        if (i % 2)
          for (std::size_t tries = 0; tries < broken.size() && !std::isdigit(static_cast<unsigned char>(broken[at]));
               ++tries)
            at = (at + 1) % broken.size();
        broken[at] = static_cast<char>(i % 2 ? '0' + random() % 10 : random());
      }
      try {
        const Rig rig = load_bytes(broken, name);
        const auto p = posed(rig);
        CHECK(p.size() == rig.surface.rest.size());
        ++loaded;
      } catch (const InputError& e) {
        CHECK(std::string(e.what()).find('\n') == std::string::npos);
        ++refused;
      }
    }
  CHECK(loaded + refused == 1500);
  MESSAGE(loaded, " files with flipped bytes load, ", refused, " are refused");
}

TEST_CASE("Edge cases of others load or are refused in a sentence") {
  for (const fs::path& file : assets("edge")) {
    const std::string name = file.parent_path().filename().string() + "/" + file.filename().string();
    try {
      const Rig rig = load_rig(file);
      const auto p = posed(rig);
      for (const vec3& v : p) REQUIRE(all_finite(v));
      MESSAGE(name, ": loaded, ", rig.surface.triangles.size(), " triangles, ", rig.bones.size(), " bones, ",
              rig.clips.size(), " clips");
      for (const std::string& warning : rig.warnings) MESSAGE("    ", warning);
    } catch (const InputError& e) {
      MESSAGE(name, ": refused, ", std::string(e.what()));
      CHECK(std::string(e.what()).find('\n') == std::string::npos);
    }
  }
}
