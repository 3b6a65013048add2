#pragma once
// Rigs and files that the tests make themselves, and where assets of others are.
#include <doctest/doctest.h>
#include <unistd.h>

#include <algorithm>
#include <cstring>
#include <filesystem>
#include <vector>

#include "rigs/pose.h"
#include "rigs/rig.h"

namespace moomill {

struct TempFolder {
  std::filesystem::path path;
  TempFolder() {
    std::string name = (std::filesystem::temp_directory_path() / "moomill-rigs-XXXXXX").string();
    if (!mkdtemp(name.data())) throw std::runtime_error("no temporary folder");
    path = name;
  }
  ~TempFolder() {
    std::error_code error;
    std::filesystem::remove_all(path, error);
  }
  TempFolder(const TempFolder&) = delete;
  TempFolder& operator=(const TempFolder&) = delete;
};

// Model files of others below a folder; empty, with a message, where the folder is not there.
inline std::vector<std::filesystem::path> assets(const std::string& below) {
  const std::filesystem::path folder = std::filesystem::path(MOOMILL_SOURCE_DIR) / "../shared/assets" / below;
  std::vector<std::filesystem::path> files;
  std::error_code error;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(folder, error)) {
    const std::string e = entry.path().extension().string();
    if (e == ".glb" || e == ".gltf" || e == ".fbx" || e == ".obj" || e == ".dae") files.push_back(entry.path());
  }
  std::sort(files.begin(), files.end());
  if (files.empty()) MESSAGE("no assets in ", below, ": nothing tested");
  return files;
}

namespace fixtures {

// A tube of rings along z from 0 to 2, radius 0.2, bound to two joints at z = 0 and z = 1 with weights that blend
// around the second.
inline Rig tube(int rings = 21, int sides = 16) {
  Rig rig;
  rig.source = "tube";
  rig.nodes = {{.name = "lower"}, {.name = "upper", .parent = 0, .translation = {0, 0, 1}}};
  rig.bones = {{0, dmat4(1.0)}, {1, glm::inverse(compose({.translation = {0, 0, 1}}))}};
  rig.influence_begin = {0};
  for (int r = 0; r < rings; ++r)
    for (int s = 0; s < sides; ++s) {
      const double z = 2.0 * r / (rings - 1), a = 2 * pi * s / sides;
      rig.surface.rest.push_back(vec3(0.2 * std::cos(a), 0.2 * std::sin(a), z));
      rig.surface.normals.push_back(vec3(std::cos(a), std::sin(a), 0));
      const float w = static_cast<float>(std::clamp(z - 0.5, 0.0, 1.0));
      if (w < 1) rig.influences.push_back({0, 1 - w});
      if (w > 0) rig.influences.push_back({1, w});
      rig.influence_begin.push_back(static_cast<std::uint32_t>(rig.influences.size()));
      if (r == 0) continue;
      const auto at = [&](int ring, int side) { return static_cast<std::uint32_t>(ring * sides + side % sides); };
      rig.surface.triangles.push_back({at(r - 1, s), at(r - 1, s + 1), at(r, s + 1)});
      rig.surface.triangles.push_back({at(r - 1, s), at(r, s + 1), at(r, s)});
    }
  rig.meshes = {{.name = "tube",
                 .vertex_count = static_cast<std::uint32_t>(rig.surface.rest.size()),
                 .triangle_count = static_cast<std::uint32_t>(rig.surface.triangles.size()),
                 .skinned = true,
                 .node = 0}};
  finish_rig(rig);
  return rig;
}

// A rig with everything that a file format may lose: interleaved materials and parts, uneven doubles, five influences,
// two bones on one node, a sheared node, a morph target, several roots, a clip with each kind of channel.
inline Rig awkward_rig() {
  Rig rig;
  rig.source = "awkward";
  dmat4 shear(1.0);
  shear[1][0] = 0.3;
  shear[3] = dvec4(0.1, -0.2, 1.0 / 3, 1);
  rig.nodes = {{.name = "root",
                .translation = {0.1, 1.0 / 3, -0.7},
                .rotation = glm::angleAxis(0.3, glm::normalize(dvec3(1, 2, 3)))},
               {.name = "a", .parent = 0, .translation = {0, 0, 0.25}, .scale = {1, 1.5, 0.75}},
               {.name = "b", .parent = 1, .matrix = shear},
               {.name = "c", .parent = 0},
               {.name = "prop", .translation = {5, 0, 0}}};
  for (int i = 0; i < 6; ++i) {
    LocalTransform local{.translation = {0.1 * i, 1.0 / (i + 3), 0.2},
                         .rotation = glm::angleAxis(0.1 * i, dvec3(0, 1, 0))};
    rig.bones.push_back({i % 5, compose(local)});
  }
  rig.influence_begin = {0};
  Surface& s = rig.surface;
  for (int v = 0; v < 12; ++v) {
    s.rest.push_back(vec3(0.1f * v, std::sin(1.0f * v), 1.0f / (v + 1)));
    s.normals.push_back(glm::normalize(vec3(v - 5.5f, 1, 0.3f * v)));
    s.uvs.push_back(vec2(0.07f * v, 1.1f - 0.3f * v));
    s.colors.push_back(vec3(0.05f * v, 0.5f, 1));
    // The second mesh hangs on bone 5, which shares its node with bone 0 of the first.
    if (v >= 9)
      rig.influences.push_back({5, 1});
    else
      for (std::uint32_t k = 0; k < 1 + v % 5u; ++k) rig.influences.push_back({(v + 2 * k) % 5u, 1.0f / (1 + v % 5)});
    rig.influence_begin.push_back(static_cast<std::uint32_t>(rig.influences.size()));
  }
  s.triangles = {{0, 1, 2}, {3, 4, 5}, {6, 7, 8}, {2, 1, 3}, {9, 10, 11}};
  s.materials = {1, 0, 1, 0, 1};
  s.parts = {2, 0, 1, 2, 0};
  rig.part_names = {"head", "leg", "tail"};
  rig.meshes = {
      {.name = "body", .vertex_count = 9, .triangle_count = 4, .skinned = true, .node = 3},
      {.name = "horn", .first_vertex = 9, .vertex_count = 3, .first_triangle = 4, .triangle_count = 1, .node = 4}};
  rig.images = {{.name = "hide", .bytes = {0x89, 'P', 'N', 'G', 1, 2, 3}}};
  rig.materials = {{.name = "plain", .base_color = {0.1f, 0.2f, 0.3f}, .roughness = 0.7f},
                   {.name = "hide", .alpha_mask = true, .alpha_cutoff = 0.3f}};
  rig.materials[1].base_texture = {
      .image = 0, .wrap_u = Wrap::mirror, .offset = {0.1f, 0.2f}, .scale = {2, 3}, .rotation = 0.4f};
  MorphTarget smile{.name = "smile", .positions = std::vector<vec3>(9, vec3(0.01f, 0.02f, 0.03f))};
  rig.morphs = {smile};
  rig.morph_weights = {0.25};
  rig.morph_node = {3};
  rig.morph_index = {0};
  Clip clip{.name = "nod", .duration = 1};
  clip.channels.push_back(
      {.node = 1, .path = ChannelPath::rotation, .times = {0, 1}, .values = {0, 0, 0, 1, 0.6, 0, 0, 0.8}});
  clip.channels.push_back({.node = 0,
                           .path = ChannelPath::translation,
                           .interpolation = Interpolation::step,
                           .times = {0, 0.5},
                           .values = {0, 0, 0, 1, 2, 3}});
  clip.channels.push_back({.node = 3,
                           .path = ChannelPath::scale,
                           .interpolation = Interpolation::cubic_spline,
                           .times = {0, 1},
                           .values = {0, 0, 0, 1, 1, 1, 0, 0, 0, 0, 0, 0, 2, 2, 2, 0, 0, 0}});
  clip.channels.push_back({.node = 3, .path = ChannelPath::weights, .times = {0, 1}, .values = {0, 1}});
  rig.clips = {clip};
  finish_rig(rig);
  return rig;
}

}  // namespace fixtures
}  // namespace moomill
