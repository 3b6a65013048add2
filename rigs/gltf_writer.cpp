// glTF 2.0 out, as one .glb. Any viewer shows it; what glTF cannot carry goes into `extras.moomill`, from which
// gltf.cpp restores the rig bit for bit:
//   nodes            how many of the file's nodes are the rig's; those after them only hold meshes
//   bones            node and inverse bind matrix in double (glTF has float), Z up, column after column
//   meshes           per part: triangles in order with material and body part of each, morph slots, node, skinned
//   part_names, neutral_box, normalization, morph_slots, clip durations
// Neutral coordinates are the vertex attribute _NNOPCS, along our axes. Same rig, same bytes.
#include <cstring>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <set>

#include "generator/core/error.h"
#include "rigs/gltf_axes.h"
#include "rigs/rig.h"

namespace moomill {
namespace gltf {
namespace {

using nlohmann::json;

enum Component { u16 = 5123, u32 = 5125, f32 = 5126 };

template <class V>
json numbers(const V& v) {
  json list = json::array();
  for (int i = 0; i < V::length(); ++i) list.push_back(v[i]);
  return list;
}

json matrix_numbers(const dmat4& m) {
  json list = json::array();
  for (int c = 0; c < 4; ++c)
    for (int r = 0; r < 4; ++r) list.push_back(m[c][r]);
  return list;
}

struct Writer {
  const Rig& rig;
  json document = json::object();
  std::vector<std::uint8_t> binary{};
  std::map<std::array<int, 3>, int> textures{};

  int view(const void* data, std::size_t size) {
    binary.resize((binary.size() + 3) / 4 * 4, 0);
    document["bufferViews"].push_back({{"buffer", 0}, {"byteOffset", binary.size()}, {"byteLength", size}});
    binary.insert(binary.end(), static_cast<const std::uint8_t*>(data), static_cast<const std::uint8_t*>(data) + size);
    return static_cast<int>(document["bufferViews"].size()) - 1;
  }

  template <class T>
  int accessor(const std::vector<T>& values, const char* type, Component component, std::size_t width, int target = 0) {
    json entry = {{"bufferView", view(values.data(), values.size() * sizeof(T))},
                  {"componentType", static_cast<int>(component)},
                  {"count", values.size() / width},
                  {"type", type}};
    if (target) document["bufferViews"].back()["target"] = target;
    document["accessors"].push_back(std::move(entry));
    return static_cast<int>(document["accessors"].size()) - 1;
  }

  // Floats with the bounds that glTF wants of positions and times.
  int bounded(const std::vector<float>& values, const char* type, std::size_t width, int target = 0) {
    const int index = accessor(values, type, f32, width, target);
    json lower = json::array(), upper = json::array();
    for (std::size_t k = 0; k < width; ++k) {
      float least = values[k], most = values[k];
      for (std::size_t i = k; i < values.size(); i += width)
        least = std::min(least, values[i]), most = std::max(most, values[i]);
      lower.push_back(least);
      upper.push_back(most);
    }
    document["accessors"].back()["min"] = lower;
    document["accessors"].back()["max"] = upper;
    return index;
  }

  template <class V>
  static std::vector<float> flat(const V* values, std::size_t count, bool turn) {
    std::vector<float> out;
    out.reserve(count * V::length());
    for (std::size_t i = 0; i < count; ++i) {
      V v = values[i];
      if constexpr (V::length() == 3)
        if (turn) v = to_y_up(v);
      for (int k = 0; k < V::length(); ++k) out.push_back(v[k]);
    }
    return out;
  }

  void write_nodes();
  json texture(const TextureUse& use);
  void write_materials();
  void write_meshes(json& own);
  void write_clips(json& own);
};

void Writer::write_nodes() {
  for (const Node& node : rig.nodes) {
    json entry = {{"name", node.name}};
    if (node.matrix) {
      entry["matrix"] = matrix_numbers(to_y_up(*node.matrix));
    } else {
      const dquat q = to_y_up(node.rotation);
      if (node.translation != dvec3(0)) entry["translation"] = numbers(to_y_up(node.translation));
      if (node.rotation != dquat(1, 0, 0, 0)) entry["rotation"] = {q.x, q.y, q.z, q.w};
      if (node.scale != dvec3(1)) entry["scale"] = numbers(swap_scale(node.scale));
    }
    document["nodes"].push_back(std::move(entry));
  }
  for (std::size_t i = 0; i < rig.nodes.size(); ++i)
    if (rig.nodes[i].parent >= 0) document["nodes"][rig.nodes[i].parent]["children"].push_back(i);
}

json Writer::texture(const TextureUse& use) {
  const auto gl_wrap = [](Wrap wrap) { return wrap == Wrap::repeat ? 10497 : wrap == Wrap::mirror ? 33648 : 33071; };
  const std::array<int, 3> key = {use.image, gl_wrap(use.wrap_u), gl_wrap(use.wrap_v)};
  const auto [it, added] = textures.try_emplace(key, static_cast<int>(textures.size()));
  if (added) {
    document["samplers"].push_back({{"wrapS", key[1]}, {"wrapT", key[2]}});
    document["textures"].push_back({{"source", use.image}, {"sampler", it->second}});
  }
  json info = {{"index", it->second}};
  if (use.offset != vec2(0) || use.scale != vec2(1) || use.rotation != 0)
    info["extensions"]["KHR_texture_transform"] = {
        {"offset", numbers(use.offset)}, {"scale", numbers(use.scale)}, {"rotation", use.rotation}};
  return info;
}

void Writer::write_materials() {
  for (const EncodedImage& image : rig.images) {
    const auto starts = [&](const char* magic, std::size_t size) {
      return image.bytes.size() >= size && std::memcmp(image.bytes.data(), magic, size) == 0;
    };
    const char* mime = starts("\x89PNG", 4)    ? "image/png"
                       : starts("\xFF\xD8", 2) ? "image/jpeg"
                                               : "application/octet-stream";
    document["images"].push_back(
        {{"name", image.name}, {"mimeType", mime}, {"bufferView", view(image.bytes.data(), image.bytes.size())}});
  }
  for (const RigMaterial& m : rig.materials) {
    json pbr = {{"baseColorFactor", {m.base_color.x, m.base_color.y, m.base_color.z, m.alpha}},
                {"roughnessFactor", m.roughness},
                {"metallicFactor", m.metallic}};
    if (m.base_texture.image >= 0) pbr["baseColorTexture"] = texture(m.base_texture);
    if (m.metallic_roughness_texture.image >= 0)
      pbr["metallicRoughnessTexture"] = texture(m.metallic_roughness_texture);
    json entry = {{"name", m.name}, {"pbrMetallicRoughness", std::move(pbr)}};
    if (m.normal_texture.image >= 0) {
      entry["normalTexture"] = texture(m.normal_texture);
      entry["normalTexture"]["scale"] = m.normal_scale;
    }
    if (m.alpha_mask) entry["alphaMode"] = "MASK", entry["alphaCutoff"] = m.alpha_cutoff;
    document["materials"].push_back(std::move(entry));
  }
  for (const json& entry : document["materials"])
    if (entry.dump().find("KHR_texture_transform") != std::string::npos)
      document["extensionsUsed"] = {"KHR_texture_transform"};
}

std::vector<int> used_bones(const Rig& rig, const MeshPart& part) {
  std::set<int> used;
  for (std::uint32_t i = rig.influence_begin[part.first_vertex];
       i < rig.influence_begin[part.first_vertex + part.vertex_count]; ++i)
    used.insert(static_cast<int>(rig.influences[i].bone));
  return {used.begin(), used.end()};
}

// Unit tangents along u with the side that -v is on (glTF 3.7.2.1: bitangent = cross(normal, tangent) * w, where green of
// a normal map points), four floats a vertex, Y up. Without them every viewer makes up its own.
std::vector<float> tangents(const Surface& s, const MeshPart& part) {
  std::vector<dvec3> along(part.vertex_count, dvec3(0));
  std::vector<double> side(part.vertex_count, 0);
  for (std::size_t i = part.first_triangle; i < part.first_triangle + part.triangle_count; ++i) {
    const uvec3& t = s.triangles[i];
    const dvec3 e1 = dvec3(s.rest[t[1]]) - dvec3(s.rest[t[0]]), e2 = dvec3(s.rest[t[2]]) - dvec3(s.rest[t[0]]);
    const dvec2 d1 = dvec2(s.uvs[t[1]]) - dvec2(s.uvs[t[0]]), d2 = dvec2(s.uvs[t[2]]) - dvec2(s.uvs[t[0]]);
    const double det = d1.x * d2.y - d1.y * d2.x, sign = det < 0 ? -1 : 1;
    const dvec3 u = sign * (e1 * d2.y - e2 * d1.y);
    const double length = glm::length(u), area = glm::length(glm::cross(e1, e2));
    if (det == 0 || !(length > 0)) continue;
    for (int k = 0; k < 3; ++k) {
      along[t[k] - part.first_vertex] += area / length * u;
      side[t[k] - part.first_vertex] -= area * sign;
    }
  }
  std::vector<float> out;
  out.reserve(4 * std::size_t{part.vertex_count});
  for (std::size_t v = 0; v < part.vertex_count; ++v) {
    const dvec3 n(s.normals[part.first_vertex + v]);
    dvec3 x = along[v] - n * glm::dot(n, along[v]);
    if (!(glm::length(x) > 1e-9 * glm::length(along[v])) || !(glm::length(x) > 0))
      x = glm::cross(n, std::abs(n.x) < 0.6 ? dvec3(1, 0, 0) : dvec3(0, 1, 0));  // no u here: any will do
    const vec3 unit = to_y_up(vec3(glm::normalize(x)));
    for (int k = 0; k < 3; ++k) out.push_back(unit[k] + 0.0f);  // no -0
    out.push_back(side[v] < 0 ? -1.0f : 1.0f);
  }
  return out;
}

// One skin with all bones, in order; or, where two bones hang on one node (which a glTF skin must not have), one skin
// per part with the bones that it uses.
void Writer::write_meshes(json& own) {
  const Surface& s = rig.surface;
  std::set<int> nodes;
  for (const Bone& bone : rig.bones) nodes.insert(bone.node);
  const bool one_skin = nodes.size() == rig.bones.size();
  std::vector<int> bones(rig.bones.size());
  for (std::size_t b = 0; b < bones.size(); ++b) bones[b] = static_cast<int>(b);
  const auto write_skin = [&](const std::vector<int>& list) {
    std::vector<float> matrices;
    json joints = json::array();
    std::set<int> seen;
    for (const int b : list) {
      if (!seen.insert(rig.bones[b].node).second)
        run_error("{}: a mesh is bound twice to the node '{}', which glTF cannot say", rig.source,
                  rig.nodes[rig.bones[b].node].name);
      joints.push_back(rig.bones[b].node);
      const dmat4 m = to_y_up(rig.bones[b].inverse_bind);
      for (int c = 0; c < 4; ++c)
        for (int r = 0; r < 4; ++r) matrices.push_back(static_cast<float>(m[c][r]));
    }
    document["skins"].push_back({{"joints", joints}, {"inverseBindMatrices", accessor(matrices, "MAT4", f32, 16)}});
  };
  if (one_skin) write_skin(bones);

  constexpr int vertices_target = 34962, indices_target = 34963;
  own["meshes"] = json::array();
  for (const MeshPart& part : rig.meshes) {
    json about = {{"name", part.name}, {"skinned", part.skinned}, {"node", part.node}, {"morphs", json::array()}};
    const std::size_t v0 = part.first_vertex, count = part.vertex_count;
    if (count == 0 || part.triangle_count == 0)
      run_error("{}: mesh '{}' has no triangles and cannot be written", rig.source, part.name);
    if (!one_skin) write_skin(bones = used_bones(rig, part));
    std::map<int, std::uint16_t> joint_of;
    for (std::size_t j = 0; j < bones.size(); ++j) joint_of[bones[j]] = static_cast<std::uint16_t>(j);

    json attributes = {{"POSITION", bounded(flat(&s.rest[v0], count, true), "VEC3", 3, vertices_target)},
                       {"NORMAL", accessor(flat(&s.normals[v0], count, true), "VEC3", f32, 3, vertices_target)}};
    if (!s.uvs.empty())
      attributes["TEXCOORD_0"] = accessor(flat(&s.uvs[v0], count, false), "VEC2", f32, 2, vertices_target);
    bool bumpy = false;
    for (std::size_t t = part.first_triangle; t < part.first_triangle + part.triangle_count; ++t)
      bumpy = bumpy || rig.materials[s.materials[t]].normal_texture.image >= 0;
    if (bumpy && !s.uvs.empty())
      attributes["TANGENT"] = accessor(tangents(s, part), "VEC4", f32, 4, vertices_target);
    if (!s.colors.empty())
      attributes["COLOR_0"] = accessor(flat(&s.colors[v0], count, false), "VEC3", f32, 3, vertices_target);
    if (!s.nnopcs.empty())
      attributes["_NNOPCS"] = accessor(flat(&s.nnopcs[v0], count, false), "VEC3", f32, 3, vertices_target);
    std::uint32_t most = 1;
    for (std::size_t v = v0; v < v0 + count; ++v)
      most = std::max(most, rig.influence_begin[v + 1] - rig.influence_begin[v]);
    for (std::uint32_t set = 0; set * 4 < most; ++set) {
      std::vector<std::uint16_t> joints(count * 4, 0);
      std::vector<float> weights(count * 4, 0);
      for (std::size_t v = 0; v < count; ++v)
        for (std::uint32_t k = 0; k < 4; ++k) {
          const std::uint32_t i = rig.influence_begin[v0 + v] + set * 4 + k;
          if (i >= rig.influence_begin[v0 + v + 1]) break;
          joints[4 * v + k] = joint_of.at(static_cast<int>(rig.influences[i].bone));
          weights[4 * v + k] = rig.influences[i].weight;
        }
      attributes[fmt::format("JOINTS_{}", set)] = accessor(joints, "VEC4", u16, 4, vertices_target);
      attributes[fmt::format("WEIGHTS_{}", set)] = accessor(weights, "VEC4", f32, 4, vertices_target);
    }

    json mesh = {{"name", part.name}, {"primitives", json::array()}}, targets = json::array();
    for (std::size_t m = 0; m < rig.morphs.size(); ++m) {
      const MorphTarget& morph = rig.morphs[m];
      if (morph.first_vertex != v0 || morph.positions.size() != count) continue;
      json target = {{"POSITION", bounded(flat(morph.positions.data(), count, true), "VEC3", 3, vertices_target)}};
      if (!morph.normals.empty())
        target["NORMAL"] = accessor(flat(morph.normals.data(), count, true), "VEC3", f32, 3, vertices_target);
      targets.push_back(std::move(target));
      about["morphs"].push_back({{"name", morph.name}, {"slot", morph.weight_slot}, {"order", m}});
      mesh["weights"].push_back(rig.morph_weights[morph.weight_slot]);
      mesh["extras"]["targetNames"].push_back(morph.name);
    }

    // One primitive per material, sharing the vertices; the order of all triangles stands beside it.
    std::map<int, std::vector<std::uint32_t>> by_material;
    std::vector<std::uint32_t> corners;
    std::vector<std::uint16_t> materials, parts;
    for (std::size_t t = part.first_triangle; t < part.first_triangle + part.triangle_count; ++t) {
      for (int k = 0; k < 3; ++k) {
        corners.push_back(s.triangles[t][k] - part.first_vertex);
        by_material[s.materials[t]].push_back(corners.back());
      }
      materials.push_back(s.materials[t]);
      parts.push_back(s.parts[t]);
    }
    for (const auto& [material, indices] : by_material) {
      json primitive = {{"attributes", attributes},
                        {"material", material},
                        {"indices", accessor(indices, "SCALAR", u32, 1, indices_target)}};
      if (by_material.size() == 1) about["triangles"] = primitive["indices"];
      if (!targets.empty()) primitive["targets"] = targets;
      mesh["primitives"].push_back(std::move(primitive));
    }
    if (by_material.size() > 1) about["triangles"] = accessor(corners, "SCALAR", u32, 1);
    about["materials"] = accessor(materials, "SCALAR", u16, 1);
    about["parts"] = accessor(parts, "SCALAR", u16, 1);
    if (!one_skin) about["bones"] = bones;
    document["meshes"].push_back(std::move(mesh));
    document["nodes"].push_back({{"name", part.name + " mesh"},
                                 {"mesh", document["meshes"].size() - 1},
                                 {"skin", document["skins"].size() - 1}});
    own["meshes"].push_back(std::move(about));
  }
  for (const MorphTarget& morph : rig.morphs) {
    const auto fits = [&](const MeshPart& part) {
      return morph.first_vertex == part.first_vertex && morph.positions.size() == part.vertex_count;
    };
    if (std::none_of(rig.meshes.begin(), rig.meshes.end(), fits))
      run_error("{}: morph target '{}' does not cover one mesh and cannot be written", rig.source, morph.name);
  }
}

void Writer::write_clips(json& own) {
  own["clips"] = json::array();
  for (const Clip& clip : rig.clips) {
    json animation = {{"name", clip.name}, {"channels", json::array()}, {"samplers", json::array()}};
    for (const Channel& channel : clip.channels) {
      const char* paths[] = {"translation", "rotation", "scale", "weights"};
      const char* interpolations[] = {"STEP", "LINEAR", "CUBICSPLINE"};
      std::vector<float> times(channel.times.begin(), channel.times.end()), values;
      if (times.empty()) continue;
      const auto& v = channel.values;
      switch (channel.path) {
        case ChannelPath::translation:
          for (std::size_t i = 0; i + 2 < v.size(); i += 3)
            for (const double x : {v[i], v[i + 2], -v[i + 1]}) values.push_back(static_cast<float>(x));
          break;
        case ChannelPath::scale:
          for (std::size_t i = 0; i + 2 < v.size(); i += 3)
            for (const double x : {v[i], v[i + 2], v[i + 1]}) values.push_back(static_cast<float>(x));
          break;
        case ChannelPath::rotation:
          for (std::size_t i = 0; i + 3 < v.size(); i += 4)
            for (const double x : {v[i], v[i + 2], -v[i + 1], v[i + 3]}) values.push_back(static_cast<float>(x));
          break;
        case ChannelPath::weights:
          values.assign(v.begin(), v.end());
          break;
      }
      const bool weights = channel.path == ChannelPath::weights;
      const std::size_t width = weights ? 1 : channel.path == ChannelPath::rotation ? 4 : 3;
      animation["samplers"].push_back({{"input", bounded(times, "SCALAR", 1)},
                                       {"output", accessor(values,
                                                           weights      ? "SCALAR"
                                                           : width == 4 ? "VEC4"
                                                                        : "VEC3",
                                                           f32, width)},
                                       {"interpolation", interpolations[static_cast<int>(channel.interpolation)]}});
      const std::size_t sampler = animation["samplers"].size() - 1;
      // Weights move the nodes that hold the meshes here; the rig's own node is noted with the first of them.
      std::vector<std::size_t> holders;
      if (weights)
        for (std::size_t m = 0; m < rig.meshes.size(); ++m)
          if (rig.meshes[m].node == channel.node) holders.push_back(rig.nodes.size() + m);
      for (std::size_t h = 0; h < std::max<std::size_t>(holders.size(), 1); ++h) {
        json entry = {{"sampler", sampler},
                      {"target",
                       {{"node", weights && !holders.empty() ? holders[h] : channel.node},
                        {"path", paths[static_cast<int>(channel.path)]}}}};
        entry["extras"]["node"] = h == 0 ? channel.node : -1;
        animation["channels"].push_back(std::move(entry));
      }
    }
    own["clips"].push_back({{"name", clip.name}, {"duration", clip.duration}});
    if (animation["channels"].empty()) {
      own["clips"].back()["empty"] = true;  // glTF wants at least one channel
      continue;
    }
    document["animations"].push_back(std::move(animation));
  }
}

void append_u32(std::string& out, std::size_t value) {
  for (int i = 0; i < 4; ++i) out.push_back(static_cast<char>(value >> (8 * i)));
}

}  // namespace
}  // namespace gltf

void write_glb(const Rig& rig, const std::filesystem::path& file) {
  using nlohmann::json;
  check(!rig.surface.triangles.empty() && rig.influence_begin.size() == rig.surface.rest.size() + 1,
        "only a finished rig can be written");
  gltf::Writer w{.rig = rig};
  json own = {{"version", 1}, {"nodes", rig.nodes.size()}, {"part_names", rig.part_names}};
  own["normalization"] = rig.surface.normalization == NnopcsNormalization::box ? "box" : "diagonal";
  if (!rig.surface.neutral_box.empty())
    own["neutral_box"] = {gltf::numbers(rig.surface.neutral_box.lower), gltf::numbers(rig.surface.neutral_box.upper)};
  own["bones"] = json::array();
  for (const Bone& bone : rig.bones)
    own["bones"].push_back({{"node", bone.node}, {"inverse_bind", gltf::matrix_numbers(bone.inverse_bind)}});
  own["morph_slots"] = json::array();
  for (std::size_t i = 0; i < rig.morph_weights.size(); ++i)
    own["morph_slots"].push_back(
        {{"node", rig.morph_node[i]}, {"index", rig.morph_index[i]}, {"weight", rig.morph_weights[i]}});
  w.document["asset"] = {{"version", "2.0"}, {"generator", "moomill " MOOMILL_VERSION}};
  w.write_nodes();
  w.write_materials();
  w.write_meshes(own);
  w.write_clips(own);

  // Joints of a skin need a common root; where the rig has several, one is put above them.
  json roots = json::array();
  for (std::size_t i = 0; i < rig.nodes.size(); ++i)
    if (rig.nodes[i].parent < 0) roots.push_back(i);
  if (roots.size() > 1) {
    w.document["nodes"].push_back({{"name", "roots"}, {"children", roots}});
    roots = {w.document["nodes"].size() - 1};
  }
  for (std::size_t m = 0; m < rig.meshes.size(); ++m) roots.push_back(rig.nodes.size() + m);
  w.document["scenes"] = {{{"nodes", roots}}};
  w.document["scene"] = 0;
  w.document["extras"]["moomill"] = std::move(own);
  w.binary.resize((w.binary.size() + 3) / 4 * 4, 0);
  w.document["buffers"] = {{{"byteLength", w.binary.size()}}};

  std::string text = w.document.dump(-1, ' ', false, json::error_handler_t::replace);
  text.resize((text.size() + 3) / 4 * 4, ' ');
  const std::size_t total = 12 + 8 + text.size() + 8 + w.binary.size();
  if (total > 0xFFFFFFFF) run_error("{}: would need {} bytes, a .glb holds at most 4 GB", file.string(), total);
  std::string out = "glTF";
  gltf::append_u32(out, 2);
  gltf::append_u32(out, total);
  gltf::append_u32(out, text.size());
  out += "JSON" + text;
  gltf::append_u32(out, w.binary.size());
  out.append("BIN\0", 4);
  out.append(reinterpret_cast<const char*>(w.binary.data()), w.binary.size());

  const std::filesystem::path partial = file.string() + ".partial";
  {
    std::ofstream stream(partial, std::ios::binary);
    stream.write(out.data(), static_cast<std::streamsize>(out.size()));
    stream.close();
    if (!stream) run_error("{}: cannot be written, check the folder and the space left", file.string());
  }
  std::error_code error;
  std::filesystem::rename(partial, file, error);
  if (error) run_error("{}: cannot be written ({})", file.string(), error.message());
}

}  // namespace moomill
