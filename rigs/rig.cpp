#include "rigs/rig.h"

#include <array>
#include <fstream>
#include <map>
#include <numeric>
#include <set>
#include <unordered_map>

#include "generator/core/error.h"

namespace moomill {
namespace {

constexpr float farthest_vertex = 1e9f;  // metres: squares of areas beyond it overflow
constexpr std::size_t largest_surface = 100'000'000;  // vertices or triangles: beyond it a file is broken, not big

// Order in which every parent comes before its children; the order as it is where that holds already.
std::vector<int> parents_first(const Rig& rig) {
  const int count = static_cast<int>(rig.nodes.size());
  bool sorted = true;
  for (int i = 0; i < count; ++i) {
    const int parent = rig.nodes[i].parent;
    if (parent < -1 || parent >= count)
      input_error("{}: node '{}' has the parent {}, which does not exist", rig.source, rig.nodes[i].name, parent);
    sorted &= parent < i;
  }
  std::vector<int> order;
  if (sorted) {
    order.resize(count);
    std::iota(order.begin(), order.end(), 0);
    return order;
  }
  std::vector<std::vector<int>> children(count);
  std::vector<int> stack;
  for (int i = count - 1; i >= 0; --i)
    if (rig.nodes[i].parent < 0)
      stack.push_back(i);
    else
      children[rig.nodes[i].parent].push_back(i);
  while (!stack.empty()) {
    const int node = stack.back();
    stack.pop_back();
    order.push_back(node);
    stack.insert(stack.end(), children[node].begin(), children[node].end());
  }
  if (static_cast<int>(order.size()) != count) {
    std::vector<char> seen(count, 0);
    for (int node : order) seen[node] = 1;
    const auto lost = std::find(seen.begin(), seen.end(), 0) - seen.begin();
    input_error("{}: node '{}' is its own ancestor, break the cycle", rig.source, rig.nodes[lost].name);
  }
  return order;
}

void check_node(const Rig& rig, int node, const char* what) {
  if (node < 0 || node >= static_cast<int>(rig.nodes.size()))
    input_error("{}: {} refers to node {}, but there are {} nodes", rig.source, what, node, rig.nodes.size());
}

// Transforms take rotations for unit quaternions; files hold them rounded.
void normalize_rotations(Rig& rig) {
  for (Node& node : rig.nodes) {
    const double length = std::sqrt(glm::dot(node.rotation, node.rotation));
    if (!all_finite(node.translation) || !all_finite(node.scale) || !std::isfinite(length) || !(length > 0))
      input_error("{}: the transform of node '{}' is not finite or has no rotation", rig.source, node.name);
    if (std::abs(length - 1) > 1e-15) node.rotation = node.rotation / length;
  }
}

void sort_nodes(Rig& rig) {
  const std::vector<int> order = parents_first(rig);
  for (const Bone& bone : rig.bones) check_node(rig, bone.node, "a bone");
  for (const int node : rig.morph_node) check_node(rig, node, "a morph weight");
  for (const Clip& clip : rig.clips)
    for (const Channel& channel : clip.channels) check_node(rig, channel.node, "an animation channel");
  for (const MeshPart& part : rig.meshes)
    if (part.node != -1) check_node(rig, part.node, "a mesh");

  std::vector<int> place(order.size());
  std::vector<Node> nodes(order.size());
  for (std::size_t i = 0; i < order.size(); ++i) place[order[i]] = static_cast<int>(i);
  for (std::size_t i = 0; i < order.size(); ++i) {
    nodes[i] = std::move(rig.nodes[order[i]]);
    if (nodes[i].parent >= 0) nodes[i].parent = place[nodes[i].parent];
  }
  rig.nodes = std::move(nodes);
  for (Bone& bone : rig.bones) bone.node = place[bone.node];
  for (int& node : rig.morph_node) node = place[node];
  for (MeshPart& part : rig.meshes)
    if (part.node >= 0) part.node = place[part.node];
  for (Clip& clip : rig.clips)
    for (Channel& channel : clip.channels) channel.node = place[channel.node];
}

// Gives every item a name that no other has: "Bone", "Bone.2", "Bone.3", ... as modelling programs do.
template <class Items>
void make_unique(Items& items, const char* nameless, const char* what, std::vector<std::string>& warnings) {
  std::set<std::string> taken;
  for (const auto& item : items)
    if (!item.name.empty()) taken.insert(item.name);
  std::set<std::string> seen;
  std::size_t renamed = 0;
  for (std::size_t i = 0; i < items.size(); ++i) {
    std::string& name = items[i].name;
    if (!name.empty() && seen.insert(name).second) continue;
    if (!name.empty()) ++renamed;
    const std::string base = name.empty() ? fmt::format("{}{}", nameless, i) : name;
    name = base;
    for (int n = 2; !taken.insert(name).second; ++n) name = fmt::format("{}.{}", base, n);
    seen.insert(name);
  }
  if (renamed) warnings.push_back(fmt::format("{} {} had a name that another has, and got a number", renamed, what));
}

void check_surface(Rig& rig) {
  const Surface& s = rig.surface;
  const std::size_t vertices = s.rest.size(), triangles = s.triangles.size();
  if (triangles == 0) input_error("{}: has no triangles, nothing can be rendered", rig.source);
  if (vertices > largest_surface || triangles > largest_surface)
    input_error("{}: has {} vertices and {} triangles, more than moomill can hold", rig.source, vertices, triangles);
  const auto per_vertex = [&](std::size_t size, const char* what) {
    if (size != 0 && size != vertices)
      input_error("{}: has {} {} for {} vertices, export it again", rig.source, size, what, vertices);
  };
  per_vertex(s.normals.size(), "normals");
  per_vertex(s.uvs.size(), "UVs");
  per_vertex(s.colors.size(), "colours");
  per_vertex(s.nnopcs.size(), "neutral coordinates");
  for (std::size_t i = 0; i < vertices; ++i) {
    if (!all_finite(s.rest[i]))
      input_error("{}: the position of {} is not finite, export it again", rig.source, vertex_place(rig, i));
    if (glm::any(glm::greaterThan(glm::abs(s.rest[i]), vec3(farthest_vertex))))
      input_error("{}: {} lies more than {:.0e} m from the origin, check the file's unit and its scale", rig.source, vertex_place(rig, i),
                  farthest_vertex);
    if (!s.uvs.empty() && !all_finite(s.uvs[i]))
      input_error("{}: the UV of {} is not finite, export it again", rig.source, vertex_place(rig, i));
    if (!s.colors.empty() && !all_finite(s.colors[i]))
      input_error("{}: the colour of {} is not finite, export it again", rig.source, vertex_place(rig, i));
  }
  for (std::size_t t = 0; t < triangles; ++t)
    for (int k = 0; k < 3; ++k)
      if (s.triangles[t][k] >= vertices)
        input_error("{}: triangle {} uses vertex {}, but there are {} vertices", rig.source, t, s.triangles[t][k],
                    vertices);
  if (rig.surface.materials.empty()) rig.surface.materials.assign(triangles, 0);
  if (s.materials.size() != triangles)
    input_error("{}: has {} material numbers for {} triangles", rig.source, s.materials.size(), triangles);
  if (rig.materials.empty()) rig.materials.push_back({.name = "default"});
  for (std::size_t t = 0; t < triangles; ++t)
    if (s.materials[t] >= rig.materials.size())
      input_error("{}: triangle {} uses material {}, but there are {}", rig.source, t, s.materials[t],
                  rig.materials.size());
  if (rig.meshes.empty())
    rig.meshes.push_back({.name = "mesh",
                          .vertex_count = static_cast<std::uint32_t>(vertices),
                          .triangle_count = static_cast<std::uint32_t>(triangles),
                          .skinned = !rig.bones.empty()});
  std::uint64_t next_vertex = 0, next_triangle = 0;
  for (const MeshPart& part : rig.meshes) {
    if (part.first_vertex != next_vertex || part.first_triangle != next_triangle)
      input_error("{}: mesh '{}' does not begin where the one before it ends", rig.source, part.name);
    next_vertex += part.vertex_count;
    next_triangle += part.triangle_count;
    for (std::uint64_t t = part.first_triangle; t < std::min<std::uint64_t>(next_triangle, triangles); ++t)
      for (int k = 0; k < 3; ++k)
        if (s.triangles[t][k] < part.first_vertex || s.triangles[t][k] >= next_vertex)
          input_error("{}: triangle {} uses a vertex of another mesh than its own '{}'", rig.source, t, part.name);
  }
  if (next_vertex != vertices || next_triangle != triangles)
    input_error("{}: its meshes have {} vertices and {} triangles of {} and {}", rig.source, next_vertex, next_triangle,
                vertices, triangles);
  for (const MorphTarget& morph : rig.morphs)
    if (morph.first_vertex > vertices || morph.positions.size() > vertices - morph.first_vertex ||
        (!morph.normals.empty() && morph.normals.size() != morph.positions.size()) || morph.weight_slot < 0 ||
        morph.weight_slot >= static_cast<int>(rig.morph_weights.size()))
      input_error("{}: morph target '{}' does not fit the surface", rig.source, morph.name);
  if (rig.morph_node.size() != rig.morph_weights.size() || rig.morph_index.size() != rig.morph_weights.size())
    input_error("{}: morph weights without a node that drives them", rig.source);
}

void check_materials(Rig& rig) {
  for (RigMaterial& m : rig.materials)
    for (TextureUse* use : {&m.base_texture, &m.metallic_roughness_texture, &m.normal_texture})
      if (use->image >= static_cast<int>(rig.images.size()) || use->image < -1)
        input_error("{}: material '{}' uses image {}, but there are {}", rig.source, m.name, use->image,
                    rig.images.size());
}

void drop_idle_influences(Rig& rig) {
  std::vector<Influence> kept;
  std::vector<std::uint32_t> begin = {0};
  for (std::size_t v = 0; v + 1 < rig.influence_begin.size(); ++v) {
    for (std::uint32_t i = rig.influence_begin[v]; i < rig.influence_begin[v + 1]; ++i)
      if (rig.influences[i].weight != 0) kept.push_back(rig.influences[i]);
    begin.push_back(static_cast<std::uint32_t>(kept.size()));
  }
  rig.influences = std::move(kept);
  rig.influence_begin = std::move(begin);
}

void check_weights(Rig& rig) {
  const std::size_t vertices = rig.surface.rest.size();
  if (rig.bones.empty()) {  // nothing to bind to: everything hangs on a root that stays
    if (rig.nodes.empty()) rig.nodes.push_back({.name = "root"});
    rig.bones.push_back({});
  }
  if (rig.influence_begin.empty() && rig.influences.empty()) {
    rig.influence_begin.resize(vertices + 1);
    std::iota(rig.influence_begin.begin(), rig.influence_begin.end(), 0u);
    rig.influences.assign(vertices, Influence{0, 1});
  }
  if (rig.influence_begin.size() != vertices + 1 || rig.influence_begin.front() != 0 ||
      rig.influence_begin.back() != rig.influences.size() ||
      !std::is_sorted(rig.influence_begin.begin(), rig.influence_begin.end()))
    input_error("{}: the table of influences does not fit its {} vertices", rig.source, vertices);

  for (const Influence& influence : rig.influences)
    if (influence.weight == 0) {
      drop_idle_influences(rig);
      break;
    }

  // Sums this near to 1 are float rounding: left alone, so that loading what was written changes no bit. The glTF
  // validator allows twice as much a weight.
  constexpr double rounding_of_one = 1e-7, worth_a_warning = 1e-3;
  std::size_t mended = 0;
  for (std::size_t v = 0; v < vertices; ++v) {
    double sum = 0;
    for (std::uint32_t i = rig.influence_begin[v]; i < rig.influence_begin[v + 1]; ++i) {
      const Influence& influence = rig.influences[i];
      if (influence.bone >= rig.bones.size())
        input_error("{}: {} is bound to joint {}, but there are {}", rig.source, vertex_place(rig, v), influence.bone,
                    rig.bones.size());
      if (!std::isfinite(influence.weight))
        input_error("{}: {} has a weight that is not a number, paint its weights again", rig.source,
                    vertex_place(rig, v));
      if (influence.weight < 0)
        input_error("{}: {} has the negative weight {}, paint its weights again", rig.source, vertex_place(rig, v),
                    influence.weight);
      sum += influence.weight;
    }
    if (!(sum > 0))
      input_error("{}: {} has no weight on any joint, assign it to one", rig.source, vertex_place(rig, v));
    const double rounding = rounding_of_one * (rig.influence_begin[v + 1] - rig.influence_begin[v]);
    if (std::abs(sum - 1) <= rounding) continue;
    if (std::abs(sum - 1) > worth_a_warning) ++mended;
    for (std::uint32_t i = rig.influence_begin[v]; i < rig.influence_begin[v + 1]; ++i)
      rig.influences[i].weight = static_cast<float>(rig.influences[i].weight / sum);
  }
  if (mended)
    rig.warnings.push_back(
        fmt::format("the weights of {} of {} vertices did not sum to 1 and were normalised", mended, vertices));
}

// A key under which vertices at the same place meet; -0 and 0 are the same place.
std::array<float, 3> place_of(const vec3& p) {
  return {p.x + 0.0f, p.y + 0.0f, p.z + 0.0f};
}

// Normals where the file has none: weighted by angle (Thuermer and Wuethrich 1998) over all triangles that meet at a
// place, so that UV seams do not show. A mesh that shares no vertex gets flat ones, as glTF asks.
void fill_normals(Rig& rig) {
  Surface& s = rig.surface;
  s.normals.resize(s.rest.size(), vec3(0));
  std::size_t filled = 0;
  for (const MeshPart& part : rig.meshes) {
    const auto missing = [&](std::uint32_t v) {
      const double length = glm::length(dvec3(s.normals[v]));
      return !(length > 1e-20) || !std::isfinite(length);
    };
    std::vector<std::uint32_t> lacking;
    for (std::uint32_t v = part.first_vertex; v < part.first_vertex + part.vertex_count; ++v)
      if (missing(v)) lacking.push_back(v);
    if (lacking.empty()) continue;
    filled += lacking.size();
    std::vector<std::uint8_t> uses(part.vertex_count, 0);
    bool shared = false;
    for (std::uint32_t t = part.first_triangle; t < part.first_triangle + part.triangle_count; ++t)
      for (int k = 0; k < 3; ++k) {
        const std::uint32_t local = s.triangles[t][k] - part.first_vertex;
        if (local < part.vertex_count) shared |= uses[local]++ > 0;
        if (shared) break;
      }
    std::map<std::array<float, 3>, dvec3> at_place;
    std::vector<dvec3> at_vertex(part.vertex_count, dvec3(0));
    for (std::uint32_t t = part.first_triangle; t < part.first_triangle + part.triangle_count; ++t) {
      dvec3 p[3];
      for (int k = 0; k < 3; ++k) p[k] = dvec3(s.rest[s.triangles[t][k]]);
      const dvec3 across = glm::cross(p[1] - p[0], p[2] - p[0]);
      if (!(glm::length(across) > 0)) continue;
      const dvec3 normal = glm::normalize(across);
      for (int k = 0; k < 3; ++k) {
        const dvec3 a = p[(k + 1) % 3] - p[k], b = p[(k + 2) % 3] - p[k];
        const double angle = std::atan2(glm::length(glm::cross(a, b)), glm::dot(a, b));
        const std::uint32_t local = s.triangles[t][k] - part.first_vertex;
        if (local >= part.vertex_count) continue;
        if (shared)
          at_place[place_of(s.rest[s.triangles[t][k]])] += angle * normal;
        else
          at_vertex[local] += angle * normal;
      }
    }
    for (const std::uint32_t v : lacking) {
      const dvec3 sum = shared ? at_place[place_of(s.rest[v])] : at_vertex[v - part.first_vertex];
      const double length = glm::length(sum);
      s.normals[v] = length > 0 ? vec3(sum / length) : vec3(0, 0, 1);
    }
  }
  for (vec3& normal : s.normals) {
    const double length = glm::length(dvec3(normal));
    if (!(length > 0))
      normal = vec3(0, 0, 1);
    else if (std::abs(length - 1) > 1e-6)
      normal = vec3(dvec3(normal) / length);
  }
  if (filled) rig.warnings.push_back(fmt::format("{} of {} vertices had no normal and got one", filled, s.rest.size()));
}

// Body parts: a triangle belongs to the joint with the most weight on its three vertices.
void name_parts(Rig& rig) {
  Surface& s = rig.surface;
  if (!s.parts.empty() && !rig.part_names.empty()) {
    if (s.parts.size() != s.triangles.size())
      input_error("{}: has {} part numbers for {} triangles", rig.source, s.parts.size(), s.triangles.size());
    for (const std::uint16_t part : s.parts)
      if (part >= rig.part_names.size())
        input_error("{}: has part number {}, but {} parts are named", rig.source, part, rig.part_names.size());
    return;
  }
  // Part keys in the order of bones, then of meshes, so that numbers do not depend on the order of triangles.
  const std::size_t nodes = rig.nodes.size();
  std::vector<std::uint32_t> key(s.triangles.size(), 0);
  for (std::size_t m = 0; m < rig.meshes.size(); ++m) {
    const MeshPart& part = rig.meshes[m];
    for (std::uint32_t t = part.first_triangle; t < part.first_triangle + part.triangle_count; ++t) {
      key[t] = static_cast<std::uint32_t>(nodes + m);
      if (!part.skinned) continue;
      std::map<std::uint32_t, double> weight;
      for (int k = 0; k < 3; ++k)
        for (std::uint32_t i = rig.influence_begin[s.triangles[t][k]]; i < rig.influence_begin[s.triangles[t][k] + 1];
             ++i)
          weight[static_cast<std::uint32_t>(rig.bones[rig.influences[i].bone].node)] += rig.influences[i].weight;
      double most = -1;
      for (const auto& [node, w] : weight)
        if (w > most) most = w, key[t] = node;
    }
  }
  std::vector<char> used(nodes + rig.meshes.size() + 1, 0);
  for (const std::uint32_t k : key) used[k] = 1;
  std::vector<std::uint16_t> number(used.size(), 0);
  rig.part_names.clear();
  for (std::size_t k = 0; k < used.size(); ++k) {
    if (!used[k]) continue;
    if (rig.part_names.size() > 0xFFFF) input_error("{}: has more than 65536 body parts", rig.source);
    number[k] = static_cast<std::uint16_t>(rig.part_names.size());
    rig.part_names.push_back(k < nodes ? rig.nodes[k].name : rig.meshes[k - nodes].name);
  }
  s.parts.resize(key.size());
  for (std::size_t t = 0; t < key.size(); ++t) s.parts[t] = number[key[t]];
}

}  // namespace

int Rig::find_node(std::string_view name) const {
  for (std::size_t i = 0; i < nodes.size(); ++i)
    if (nodes[i].name == name) return static_cast<int>(i);
  return -1;
}

int Rig::find_clip(std::string_view name) const {
  for (std::size_t i = 0; i < clips.size(); ++i)
    if (clips[i].name == name) return static_cast<int>(i);
  return -1;
}

std::string vertex_place(const Rig& rig, std::size_t vertex) {
  for (const MeshPart& part : rig.meshes)
    if (vertex >= part.first_vertex && vertex - part.first_vertex < part.vertex_count)
      return fmt::format("vertex {} of mesh '{}'", vertex - part.first_vertex, part.name);
  return fmt::format("vertex {}", vertex);
}

void scale_rig(Rig& rig, double factor) {
  if (factor == 1) return;
  for (Node& node : rig.nodes) {
    node.translation *= factor;
    if (node.matrix) (*node.matrix)[3] = dvec4(dvec3((*node.matrix)[3]) * factor, (*node.matrix)[3].w);
  }
  for (Bone& bone : rig.bones)
    bone.inverse_bind[3] = dvec4(dvec3(bone.inverse_bind[3]) * factor, bone.inverse_bind[3].w);
  for (vec3& p : rig.surface.rest) p = vec3(dvec3(p) * factor);
  for (MorphTarget& morph : rig.morphs)
    for (vec3& p : morph.positions) p = vec3(dvec3(p) * factor);
  for (Clip& clip : rig.clips)
    for (Channel& channel : clip.channels)
      if (channel.path == ChannelPath::translation)
        for (double& value : channel.values) value *= factor;
  rig.surface.neutral_box.lower *= factor;
  rig.surface.neutral_box.upper *= factor;
}

void finish_rig(Rig& rig) {
  make_unique(rig.nodes, "node", "nodes", rig.warnings);
  normalize_rotations(rig);
  sort_nodes(rig);
  make_unique(rig.meshes, "mesh", "meshes", rig.warnings);
  make_unique(rig.clips, "clip", "clips", rig.warnings);
  check_surface(rig);
  check_materials(rig);
  check_weights(rig);
  fill_normals(rig);
  name_parts(rig);
}

Rig load_rig(const std::filesystem::path& file, const LoadOptions& options) {
  if (!(options.scale > 0) || !std::isfinite(options.scale))
    input_error("{}: the scale {} is not a positive number", file.string(), options.scale);
  std::error_code error;
  if (std::filesystem::is_directory(file, error))
    input_error("{}: is a folder, name the model file in it", file.string());
  std::ifstream in(file, std::ios::binary);
  if (!in) input_error("{}: cannot be opened, check the path", file.string());
  std::array<char, 18> head{};
  in.read(head.data(), head.size());
  const std::string_view start(head.data(), static_cast<std::size_t>(in.gcount()));
  if (start.empty()) input_error("{}: is empty, export it again", file.string());
  std::string extension = file.extension().string();
  for (char& c : extension) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  // Content before extension: a .glb renamed to .fbx is still a .glb.
  if (start.starts_with("glTF")) return load_gltf(file, options);
  if (start.starts_with("Kaydara FBX Binary")) return load_with_assimp(file, options);
  if (extension == ".gltf" || extension == ".glb") return load_gltf(file, options);
  if (extension == ".fbx" || extension == ".dae" || extension == ".obj") return load_with_assimp(file, options);
  input_error("{}: '{}' is not a model format moomill reads, use .glb, .gltf, .fbx, .dae or .obj", file.string(),
              extension);
}

}  // namespace moomill
