// Files that write_glb() wrote: what glTF cannot carry comes from their extras (see gltf_writer.cpp).
#include <algorithm>

#include "rigs/gltf_axes.h"
#include "rigs/gltf_reader.h"

namespace moomill::gltf {

// Restores what write_glb() wrote, bit for bit. JSON exceptions mean that someone changed it.
void Reader::read_own(const nlohmann::json& own) {
  const std::size_t nodes = own.at("nodes").get<std::size_t>();
  if (nodes > node_count()) fail("should have {} nodes but has {}", nodes, node_count());
  const std::vector<int> parent = parents();
  node_of.assign(node_count(), -1);
  for (std::size_t i = 0; i < nodes; ++i) {
    node_of[i] = static_cast<int>(i);
    rig.nodes.push_back(convert_node(static_cast<int>(i), -1));
    rig.nodes.back().parent = parent[i] >= 0 && parent[i] < static_cast<int>(nodes) ? parent[i] : -1;
  }
  read_materials();
  for (const auto& bone : own.at("bones")) {
    Bone b{bone.at("node").get<int>()};
    for (int k = 0; k < 16; ++k) b.inverse_bind[k / 4][k % 4] = bone.at("inverse_bind").at(k).get<double>();
    index_in(b.node, nodes, "a bone", "node");
    rig.bones.push_back(b);
  }
  for (const auto& slot : own.at("morph_slots")) {
    rig.morph_weights.push_back(slot.at("weight").get<double>());
    rig.morph_node.push_back(slot.at("node").get<int>());
    rig.morph_index.push_back(slot.at("index").get<int>());
  }
  std::map<std::size_t, MorphTarget> morphs;
  rig.influence_begin = {0};
  for (std::size_t m = 0; m < own.at("meshes").size(); ++m) {
    read_own_mesh(own.at("meshes").at(m), static_cast<int>(m));
    const auto& about = own.at("meshes").at(m);
    for (std::size_t t = 0; t < about.at("morphs").size(); ++t) {
      const auto& entry = about.at("morphs").at(t);
      const auto& targets = morph_targets(static_cast<int>(m));
      index_in(static_cast<int>(t), targets.size(), "extras.moomill", "morph target");
      MorphTarget morph{.name = entry.at("name").get<std::string>(), .first_vertex = rig.meshes.back().first_vertex};
      morph.weight_slot = entry.at("slot").get<int>();
      for (const auto& [key, accessor] : targets[t]) {
        const Values v = values(accessor, "morph target", {3});
        if (v.count != rig.meshes.back().vertex_count)
          fail("morph target '{}' has another number of vertices", morph.name);
        std::vector<vec3>& out = key == "NORMAL" ? morph.normals : morph.positions;
        for (std::size_t i = 0; i < v.count; ++i) out.push_back(vec3(to_z_up(dvec3(v[i][0], v[i][1], v[i][2]))));
      }
      morphs[entry.at("order").get<std::size_t>()] = std::move(morph);
    }
  }
  for (auto& [order, morph] : morphs) rig.morphs.push_back(std::move(morph));
  rig.part_names = own.at("part_names").get<std::vector<std::string>>();
  rig.surface.normalization =
      own.at("normalization") == "diagonal" ? NnopcsNormalization::diagonal : NnopcsNormalization::box;
  if (own.contains("neutral_box"))
    for (int k = 0; k < 3; ++k) {
      rig.surface.neutral_box.lower[k] = own.at("neutral_box").at(0).at(k).get<double>();
      rig.surface.neutral_box.upper[k] = own.at("neutral_box").at(1).at(k).get<double>();
    }
  retarget_own_channels();
  read_clips();
  std::vector<Clip> clips = std::move(rig.clips);
  rig.clips.clear();
  std::size_t next = 0;
  for (const auto& entry : own.at("clips")) {
    Clip clip;
    if (!entry.contains("empty")) {
      index_in(static_cast<int>(next), clips.size(), "extras.moomill", "clip");
      clip = std::move(clips[next++]);
    }
    clip.name = entry.at("name").get<std::string>();
    clip.duration = entry.at("duration").get<double>();
    rig.clips.push_back(std::move(clip));
  }
}

void Reader::read_own_mesh(const nlohmann::json& about, int mesh) {
  const auto& known = attributes(mesh);
  Surface& s = rig.surface;
  MeshPart part{.name = about.at("name").get<std::string>()};
  part.first_vertex = static_cast<std::uint32_t>(s.rest.size());
  part.first_triangle = static_cast<std::uint32_t>(s.triangles.size());
  part.skinned = about.at("skinned").get<bool>();
  part.node = about.at("node").get<int>();
  const auto read = [&](const std::string& key, int width) {
    const auto it = known.find(key);
    return it == known.end() ? Values{} : values(it->second, key, {width});
  };
  const Values positions = read("POSITION", 3);
  const std::size_t count = positions.count;
  part.vertex_count = static_cast<std::uint32_t>(count);
  const auto vectors = [&](const Values& v, auto& out, bool turn) {
    if (v.count != 0 && v.count != count) fail("mesh '{}' has attributes of different lengths", part.name);
    for (std::size_t i = 0; i < v.count; ++i) {
      const dvec3 x(v[i][0], v[i][1], v[i][2]);
      out.push_back(vec3(turn ? to_z_up(x) : x));
    }
  };
  vectors(positions, s.rest, true);
  vectors(read("NORMAL", 3), s.normals, true);
  vectors(read("COLOR_0", 3), s.colors, false);
  vectors(read("_NNOPCS", 3), s.nnopcs, false);
  const Values uvs = read("TEXCOORD_0", 2);
  for (std::size_t i = 0; i < uvs.count; ++i) s.uvs.push_back(vec2(uvs[i][0], uvs[i][1]));
  std::vector<std::pair<Values, Values>> sets;
  for (int n = 0; known.count(fmt::format("JOINTS_{}", n)); ++n) {
    sets.emplace_back(read(fmt::format("JOINTS_{}", n), 4), read(fmt::format("WEIGHTS_{}", n), 4));
    if (sets.back().first.count != count || sets.back().second.count != count)
      fail("mesh '{}' has attributes of different lengths", part.name);
  }
  const std::vector<std::uint32_t> bones =
      about.contains("bones") ? about.at("bones").get<std::vector<std::uint32_t>>() : std::vector<std::uint32_t>();
  for (std::size_t i = 0; i < count; ++i) {
    for (const auto& [joint, weight] : sets)
      for (int k = 0; k < 4; ++k) {
        if (weight[i][k] == 0) continue;
        auto bone = static_cast<std::uint32_t>(std::clamp(joint[i][k], 0.0, 1e6));
        if (!bones.empty()) {
          index_in(static_cast<int>(bone), bones.size(), "a vertex", "joint");
          bone = bones[bone];
        }
        rig.influences.push_back({bone, static_cast<float>(weight[i][k])});
      }
    rig.influence_begin.push_back(static_cast<std::uint32_t>(rig.influences.size()));
  }
  const Values corners = values(about.at("triangles").get<int>(), "triangles", {1});
  const Values materials = values(about.at("materials").get<int>(), "materials", {1});
  const Values parts = values(about.at("parts").get<int>(), "parts", {1});
  part.triangle_count = static_cast<std::uint32_t>(corners.count / 3);
  if (corners.count % 3 || materials.count * 3 != corners.count || parts.count != materials.count)
    fail("mesh '{}' has lists of triangles of different lengths", part.name);
  for (std::size_t t = 0; t < materials.count; ++t) {
    uvec3 triangle;
    for (int k = 0; k < 3; ++k) {
      const double corner = corners.data[3 * t + k];
      if (!(corner >= 0 && corner < static_cast<double>(count)))
        fail("a triangle of mesh '{}' has no such vertex", part.name);
      triangle[k] = part.first_vertex + static_cast<std::uint32_t>(corner);
    }
    s.triangles.push_back(triangle);
    s.materials.push_back(static_cast<std::uint16_t>(std::clamp(materials.data[t], 0.0, 65535.0)));
    s.parts.push_back(static_cast<std::uint16_t>(std::clamp(parts.data[t], 0.0, 65535.0)));
  }
  rig.meshes.push_back(std::move(part));
}

}  // namespace moomill::gltf
