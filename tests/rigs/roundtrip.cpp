#include <doctest/doctest.h>
#include <unistd.h>

#include <fstream>

#include "generator/core/error.h"
#include "rigs/pose.h"
#include "tests/rigs/fixtures.h"

using namespace moomill;
namespace fs = std::filesystem;

namespace {

template <class A, class B>
bool same_bits(const A& a, const B& b) {
  return a.size() == b.size() && (a.empty() || std::memcmp(a.data(), b.data(), a.size() * sizeof(a[0])) == 0);
}

std::string bytes_of(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

void check_same(const Rig& a, const Rig& b) {
  REQUIRE(a.nodes.size() == b.nodes.size());
  for (std::size_t i = 0; i < a.nodes.size(); ++i) {
    CHECK(a.nodes[i].name == b.nodes[i].name);
    CHECK(a.nodes[i].parent == b.nodes[i].parent);
    CHECK(a.nodes[i].matrix == b.nodes[i].matrix);
    if (a.nodes[i].matrix) continue;
    CHECK(a.nodes[i].translation == b.nodes[i].translation);
    CHECK(a.nodes[i].rotation == b.nodes[i].rotation);
    CHECK(a.nodes[i].scale == b.nodes[i].scale);
  }
  REQUIRE(a.bones.size() == b.bones.size());
  for (std::size_t i = 0; i < a.bones.size(); ++i) {
    CHECK(a.bones[i].node == b.bones[i].node);
    CHECK(a.bones[i].inverse_bind == b.bones[i].inverse_bind);
  }
  CHECK(same_bits(a.surface.rest, b.surface.rest));
  CHECK(same_bits(a.surface.normals, b.surface.normals));
  CHECK(same_bits(a.surface.uvs, b.surface.uvs));
  CHECK(same_bits(a.surface.colors, b.surface.colors));
  CHECK(same_bits(a.surface.nnopcs, b.surface.nnopcs));
  CHECK(same_bits(a.surface.triangles, b.surface.triangles));
  CHECK(same_bits(a.surface.materials, b.surface.materials));
  CHECK(same_bits(a.surface.parts, b.surface.parts));
  CHECK(a.surface.neutral_box.lower == b.surface.neutral_box.lower);
  CHECK(a.surface.neutral_box.upper == b.surface.neutral_box.upper);
  CHECK(a.surface.normalization == b.surface.normalization);
  CHECK(same_bits(a.influence_begin, b.influence_begin));
  CHECK(same_bits(a.influences, b.influences));
  CHECK(a.part_names == b.part_names);
  REQUIRE(a.meshes.size() == b.meshes.size());
  for (std::size_t i = 0; i < a.meshes.size(); ++i) {
    CHECK(a.meshes[i].name == b.meshes[i].name);
    CHECK(a.meshes[i].first_vertex == b.meshes[i].first_vertex);
    CHECK(a.meshes[i].triangle_count == b.meshes[i].triangle_count);
    CHECK(a.meshes[i].skinned == b.meshes[i].skinned);
    CHECK(a.meshes[i].node == b.meshes[i].node);
  }
  REQUIRE(a.materials.size() == b.materials.size());
  for (std::size_t i = 0; i < a.materials.size(); ++i) {
    const RigMaterial &x = a.materials[i], &y = b.materials[i];
    CHECK(x.name == y.name);
    CHECK(x.base_color == y.base_color);
    CHECK(x.roughness == y.roughness);
    CHECK(x.metallic == y.metallic);
    CHECK(x.base_texture.image == y.base_texture.image);
    CHECK(x.base_texture.offset == y.base_texture.offset);
    CHECK(x.base_texture.wrap_u == y.base_texture.wrap_u);
    CHECK(x.alpha_mask == y.alpha_mask);
  }
  REQUIRE(a.images.size() == b.images.size());
  for (std::size_t i = 0; i < a.images.size(); ++i) {
    CHECK(a.images[i].name == b.images[i].name);
    CHECK(a.images[i].bytes == b.images[i].bytes);
  }
  REQUIRE(a.morphs.size() == b.morphs.size());
  for (std::size_t i = 0; i < a.morphs.size(); ++i) {
    CHECK(a.morphs[i].name == b.morphs[i].name);
    CHECK(same_bits(a.morphs[i].positions, b.morphs[i].positions));
    CHECK(a.morphs[i].weight_slot == b.morphs[i].weight_slot);
  }
  CHECK(a.morph_weights == b.morph_weights);
  CHECK(a.morph_node == b.morph_node);
  REQUIRE(a.clips.size() == b.clips.size());
  for (std::size_t c = 0; c < a.clips.size(); ++c) {
    CHECK(a.clips[c].name == b.clips[c].name);
    CHECK(a.clips[c].duration == b.clips[c].duration);
    REQUIRE(a.clips[c].channels.size() == b.clips[c].channels.size());
    for (std::size_t k = 0; k < a.clips[c].channels.size(); ++k) {
      const Channel &x = a.clips[c].channels[k], &y = b.clips[c].channels[k];
      CHECK(x.node == y.node);
      CHECK(x.path == y.path);
      CHECK(x.interpolation == y.interpolation);
      REQUIRE(x.values.size() == y.values.size());
      for (std::size_t i = 0; i < x.values.size(); ++i)
        REQUIRE(static_cast<float>(x.values[i]) == static_cast<float>(y.values[i]));
    }
  }
}

}  // namespace

TEST_CASE("A rig written as .glb comes back bit for bit, and the same rig gives the same bytes") {
  const TempFolder folder;
  Rig rig = fixtures::awkward_rig();
  bake_nnopcs(rig.surface, rig.surface.rest, NnopcsNormalization::diagonal);
  write_glb(rig, folder.path / "a.glb");
  write_glb(rig, folder.path / "b.glb");
  CHECK(bytes_of(folder.path / "a.glb") == bytes_of(folder.path / "b.glb"));
  const Rig back = load_rig(folder.path / "a.glb");
  check_same(rig, back);
  CHECK(back.warnings.empty());
  write_glb(back, folder.path / "c.glb");
  CHECK(bytes_of(folder.path / "a.glb") == bytes_of(folder.path / "c.glb"));
  CHECK_THROWS_AS(write_glb(rig, folder.path / "no" / "such" / "folder.glb"), RunError);
}

TEST_CASE("Rigs of others come back bit for bit as well") {
  const TempFolder folder;
  for (const char* below : {"rigged", "static", "edge/khronos_samples", "edge/blender_io_roundtrip/01_morphed_cube"})
    for (const fs::path& file : assets(below)) {
      CAPTURE(file.string());
      Rig rig = load_rig(file);
      bake_nnopcs(rig.surface, rig.surface.rest, NnopcsNormalization::box);
      write_glb(rig, folder.path / "a.glb");
      check_same(rig, load_rig(folder.path / "a.glb"));
    }
}

TEST_CASE("Other readers of the written file pose it as we do") {
  // Without our extras the file is plain glTF: read as such it must skin to the same points.
  const TempFolder folder;
  const Rig rig = fixtures::awkward_rig();
  write_glb(rig, folder.path / "a.glb");
  std::string bytes = bytes_of(folder.path / "a.glb");
  bytes.replace(bytes.find("\"moomill\":"), 10, "\"someone\":");
  std::ofstream(folder.path / "plain.glb", std::ios::binary) << bytes;
  const Rig plain = load_rig(folder.path / "plain.glb");
  const auto pose = [](const Rig& r) {
    const Pose p = sample_clip(r, r.clips.at(0), 0.3);
    return skin(r, bone_matrices(r, world_transforms(r, p)), p.morph_weights, SkinningMethod::linear_blend, dvec3(0));
  };
  const PosedSurface a = pose(rig), b = pose(plain);
  for (std::size_t t = 0; t < rig.surface.triangles.size(); ++t)
    for (int k = 0; k < 3; ++k) {
      // Primitives are sorted by material there, so look the corner up by position.
      const vec3 p = a.positions[rig.surface.triangles[t][k]];
      double nearest = 1e9;
      for (const vec3& q : b.positions) nearest = std::min<double>(nearest, glm::length(p - q));
      CHECK(nearest < 1e-5);
    }
}

TEST_CASE("Meshes with a normal map are written with tangents, others without") {
  // A square seen from above, u to the right, v downwards: the tangent is +x, and green points up the picture, to -v.
  const auto written = [](bool mirrored, bool normal_map) {
    Rig rig;
    rig.source = "square";
    rig.surface.rest = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}};
    rig.surface.normals.assign(4, vec3(0, 0, 1));
    for (const vec3& p : rig.surface.rest) rig.surface.uvs.push_back(vec2(mirrored ? 1 - p.x : p.x, 1 - p.y));
    rig.surface.triangles = {{0, 1, 2}, {0, 2, 3}};
    rig.meshes = {{.name = "square", .vertex_count = 4, .triangle_count = 2}};
    rig.nodes = {{.name = "root"}};
    rig.meshes[0].node = 0;
    rig.materials = {{.name = "hide"}};
    rig.surface.materials.assign(2, 0);
    if (normal_map) {
      rig.images = {{"bumps", {0x89, 'P', 'N', 'G'}}};
      rig.materials[0].normal_texture.image = 0;
    }
    finish_rig(rig);
    const TempFolder folder;
    write_glb(rig, folder.path / "a.glb");
    return bytes_of(folder.path / "a.glb");
  };
  CHECK(written(false, false).find("TANGENT") == std::string::npos);
  for (const bool mirrored : {false, true}) {
    const std::string bytes = written(mirrored, true);
    REQUIRE(bytes.find("\"TANGENT\"") != std::string::npos);
    const float side = mirrored ? -1.0f : 1.0f, tangent[4] = {side, 0, 0, side};
    std::string four;
    for (int v = 0; v < 4; ++v) four.append(reinterpret_cast<const char*>(tangent), sizeof tangent);
    CHECK(bytes.find(four) != std::string::npos);
  }
}
