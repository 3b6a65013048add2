// glTF 2.0 in. The only file that knows tinygltf, which here gets checked JSON and reads the structure of the document;
// bytes come from gltf_container.cpp, and every index and range is checked below before it is used.
#include <tiny_gltf.h>

#include <cstring>
#include <glm/gtc/matrix_inverse.hpp>
#include <map>

#include "generator/core/error.h"
#include "rigs/gltf_axes.h"
#include "rigs/gltf_reader.h"
#include "rigs/loading.h"
#include "rigs/pose.h"
#include "rigs/rig.h"

namespace moomill {
namespace gltf {
namespace {

constexpr std::size_t most_without_data = 16'000'000;  // elements of an accessor that has no bytes behind it
constexpr std::size_t most_vertices = 50'000'000;      // a small file may instance a mesh without end

int component_bytes(int type) {
  switch (type) {
    case TINYGLTF_COMPONENT_TYPE_BYTE:
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE:
      return 1;
    case TINYGLTF_COMPONENT_TYPE_SHORT:
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT:
      return 2;
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT:
    case TINYGLTF_COMPONENT_TYPE_FLOAT:
      return 4;
    default:
      return 0;
  }
}

int components(int type) {
  switch (type) {
    case TINYGLTF_TYPE_SCALAR:
      return 1;
    case TINYGLTF_TYPE_VEC2:
      return 2;
    case TINYGLTF_TYPE_VEC3:
      return 3;
    case TINYGLTF_TYPE_VEC4:
      return 4;
    case TINYGLTF_TYPE_MAT4:
      return 16;
    default:
      return 0;
  }
}

template <class T>
T load(const std::uint8_t* p) {
  T value;
  std::memcpy(&value, p, sizeof value);
  return value;
}

double component(const std::uint8_t* p, int type, bool normalized) {
  switch (type) {
    case TINYGLTF_COMPONENT_TYPE_BYTE: {
      const double v = load<std::int8_t>(p);
      return normalized ? std::max(v / 127, -1.0) : v;
    }
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE:
      return *p / (normalized ? 255.0 : 1.0);
    case TINYGLTF_COMPONENT_TYPE_SHORT: {
      const double v = load<std::int16_t>(p);
      return normalized ? std::max(v / 32767, -1.0) : v;
    }
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT:
      return load<std::uint16_t>(p) / (normalized ? 65535.0 : 1.0);
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT:
      return load<std::uint32_t>(p);
    default:
      return load<float>(p);
  }
}

}  // namespace

Reader::Reader(const std::filesystem::path& path)
    : file(path.string()),
      container(open_container(path)),
      parsed(std::make_shared<tinygltf::Model>()),
      model(*parsed) {
  rig.source = file;
  rig.warnings = container.warnings;
  parse();
}

std::size_t Reader::node_count() const {
  return model.nodes.size();
}

const std::map<std::string, int>& Reader::attributes(int mesh) const {
  index_in(mesh, model.meshes.size(), "extras.moomill", "mesh");
  if (model.meshes[mesh].primitives.empty()) fail("mesh {} has no primitives", mesh);
  return model.meshes[mesh].primitives[0].attributes;
}

const std::vector<std::map<std::string, int>>& Reader::morph_targets(int mesh) const {
  attributes(mesh);  // checks the number
  return model.meshes[mesh].primitives[0].targets;
}

// Weights channels move the nodes that hold meshes; the rig's own node is noted beside them.
void Reader::retarget_own_channels() {
  for (auto& animation : model.animations)
    for (auto& channel : animation.channels)
      if (channel.extras.IsObject() && channel.extras.Has("node"))
        channel.target_node = channel.extras.Get("node").GetNumberAsInt();
}

const std::uint8_t* Reader::bytes(int view_index, std::size_t offset, std::size_t size, const std::string& who) const {
  index_in(view_index, model.bufferViews.size(), who, "bufferView");
  const tinygltf::BufferView& view = model.bufferViews[view_index];
  index_in(view.buffer, container.buffers.size(), fmt::format("bufferViews[{}]", view_index), "buffer");
  const auto& buffer = container.buffers[view.buffer];
  if (view.byteOffset > buffer.size() || view.byteLength > buffer.size() - view.byteOffset)
    fail("bufferViews[{}] reaches past the end of buffer {} ({} bytes), export it again", view_index, view.buffer,
         buffer.size());
  if (offset > view.byteLength || size > view.byteLength - offset)
    fail("{} reaches past the end of bufferViews[{}] ({} bytes), export it again", who, view_index, view.byteLength);
  return buffer.data() + view.byteOffset + offset;
}

Values Reader::values(int index, const std::string& what, std::initializer_list<int> widths) const {
  index_in(index, model.accessors.size(), what, "accessor");
  const tinygltf::Accessor& a = model.accessors[index];
  const std::string who = fmt::format("accessors[{}] ({})", index, what);
  Values out{a.count, components(a.type), {}};
  const std::size_t size = component_bytes(a.componentType), element = size * out.width;
  if (size == 0) fail("{} has the component type {}, which glTF does not know", who, a.componentType);
  if (std::find(widths.begin(), widths.end(), out.width) == widths.end())
    fail("{} has {} numbers per element, which does not fit its use", who, out.width);
  if (a.bufferView < 0) {
    if (a.count > most_without_data) fail("{} has {} elements but no data, export it again", who, a.count);
    out.data.assign(a.count * out.width, 0.0);
  } else {
    index_in(a.bufferView, model.bufferViews.size(), who, "bufferView");
    std::size_t stride = model.bufferViews[a.bufferView].byteStride;
    if (stride == 0) stride = element;
    if (stride < element) fail("{} has elements of {} bytes every {} bytes, export it again", who, element, stride);
    if (a.count > (std::size_t{1} << 40)) fail("{} has {} elements, export it again", who, a.count);
    const std::uint8_t* p = bytes(a.bufferView, a.byteOffset, a.count ? stride * (a.count - 1) + element : 0, who);
    out.data.resize(a.count * out.width);
    for (std::size_t i = 0; i < a.count; ++i)
      for (int k = 0; k < out.width; ++k)
        out.data[i * out.width + k] = component(p + i * stride + k * size, a.componentType, a.normalized);
  }
  if (a.sparse.isSparse) {
    const std::size_t index_size = component_bytes(a.sparse.indices.componentType);
    if (a.sparse.count < 0 || static_cast<std::size_t>(a.sparse.count) > a.count || index_size == 0 ||
        a.sparse.indices.componentType == TINYGLTF_COMPONENT_TYPE_FLOAT || a.sparse.indices.byteOffset < 0 ||
        a.sparse.values.byteOffset < 0)
      fail("{} has a broken sparse part, export it again", who);
    const std::size_t count = a.sparse.count;
    const auto* at = bytes(a.sparse.indices.bufferView, a.sparse.indices.byteOffset, count * index_size, who);
    const auto* from = bytes(a.sparse.values.bufferView, a.sparse.values.byteOffset, count * element, who);
    for (std::size_t i = 0; i < count; ++i) {
      const double target = component(at + i * index_size, a.sparse.indices.componentType, false);
      if (!(target >= 0 && target < static_cast<double>(a.count)))
        fail("{} replaces element {}, but there are {}, export it again", who, target, a.count);
      for (int k = 0; k < out.width; ++k)
        out.data[static_cast<std::size_t>(target) * out.width + k] =
            component(from + i * element + k * size, a.componentType, a.normalized);
    }
  }
  return out;
}

// tinygltf asks for the buffers by the names parse() gave them.
static bool give_buffer(std::vector<unsigned char>* out, std::string*, const std::string& path, void* user) {
  const auto& buffers = *static_cast<const std::vector<std::vector<std::uint8_t>>*>(user);
  const std::size_t index = std::stoul(path.substr(path.rfind('-') + 1));
  *out = buffers.at(index);
  return true;
}

void Reader::parse() {
  nlohmann::json document = container.json;
  document.erase("images");
  if (auto buffers = document.find("buffers"); buffers != document.end() && buffers->is_array())
    for (std::size_t i = 0; i < buffers->size(); ++i)
      (*buffers)[i] = {{"byteLength", 1}, {"uri", fmt::format("buffer-{}", i)}};
  // The bytes themselves stay here: one stand-in byte each is enough for the parser.
  std::vector<std::vector<std::uint8_t>> stand_in(container.buffers.size(), {0});
  tinygltf::TinyGLTF parser;
  tinygltf::FsCallbacks callbacks{};
  callbacks.FileExists = [](const std::string&, void*) { return true; };
  callbacks.ExpandFilePath = [](const std::string& path, void*) { return path; };
  callbacks.ReadWholeFile = give_buffer;
  callbacks.user_data = &stand_in;
  parser.SetFsCallbacks(callbacks);
  std::string error, warning;
  bool good = false;
  try {
    const std::string text = document.dump();
    if (text.size() > 0xFFFFFFFF) fail("its JSON has more than 4 GB");
    good = parser.LoadASCIIFromString(&model, &error, &warning, text.data(), static_cast<unsigned>(text.size()), "");
  } catch (const InputError&) {
    throw;
  } catch (const std::exception& e) {
    error = e.what();
  }
  if (good) return;
  error = error.substr(0, error.find_last_not_of(".\n ") + 1);
  for (char& c : error)
    if (c == '\n') c = ' ';
  fail("is not valid glTF ({}), export it again", error.empty() ? "no reason given" : error);
}

std::vector<int> Reader::scene_roots(const LoadOptions& options) const {
  const int scenes = static_cast<int>(model.scenes.size());
  if (options.scene) {
    if (*options.scene < 0 || *options.scene >= scenes)
      fail("has {} scenes, counted from 0, so there is no scene {}", scenes, *options.scene);
    return model.scenes[*options.scene].nodes;
  }
  if (model.defaultScene != -1) index_in(model.defaultScene, model.scenes.size(), "the file", "scene");
  if (scenes > 0) return model.scenes[std::max(model.defaultScene, 0)].nodes;
  std::vector<char> is_child(model.nodes.size(), 0);  // no scene at all: everything
  for (const auto& node : model.nodes)
    for (const int child : node.children)
      if (child >= 0 && child < static_cast<int>(is_child.size())) is_child[child] = 1;
  std::vector<int> roots;
  for (std::size_t i = 0; i < is_child.size(); ++i)
    if (!is_child[i]) roots.push_back(static_cast<int>(i));
  return roots;
}

// Nodes below the roots, parents first, in the order of the document's children lists.
std::vector<int> Reader::reachable(const std::vector<int>& roots) const {
  std::vector<int> order, stack;
  std::vector<char> seen(model.nodes.size(), 0);
  for (auto root = roots.rbegin(); root != roots.rend(); ++root) stack.push_back(*root);
  while (!stack.empty()) {
    const int node = stack.back();
    stack.pop_back();
    if (seen[node]) continue;
    seen[node] = 1;
    order.push_back(node);
    const auto& children = model.nodes[node].children;
    for (auto child = children.rbegin(); child != children.rend(); ++child) stack.push_back(*child);
  }
  return order;
}

// A node without its parent. A matrix is kept where translation, rotation and scale miss it by more than the error.
Node Reader::convert_node(int i, double matrix_error) const {
  const tinygltf::Node& from = model.nodes[i];
  const auto numbers = [&](const std::vector<double>& v, std::size_t size, const char* what) {
    if (v.size() != size) fail("nodes[{}].{} has {} numbers instead of {}", i, what, v.size(), size);
    for (const double x : v)
      if (!std::isfinite(x)) fail("nodes[{}].{} is not finite", i, what);
  };
  Node node;
  node.name = from.name;
  if (!from.matrix.empty()) {
    numbers(from.matrix, 16, "matrix");
    dmat4 m;
    for (int k = 0; k < 16; ++k) m[k / 4][k % 4] = from.matrix[k];
    set_transform(node, to_z_up(m), matrix_error);
  }
  if (!from.translation.empty()) {
    numbers(from.translation, 3, "translation");
    node.translation = to_z_up(dvec3(from.translation[0], from.translation[1], from.translation[2]));
  }
  if (!from.rotation.empty()) {
    numbers(from.rotation, 4, "rotation");
    node.rotation = to_z_up(dquat(from.rotation[3], from.rotation[0], from.rotation[1], from.rotation[2]));
    const double length = std::sqrt(glm::dot(node.rotation, node.rotation));
    if (!(length > 1e-6)) fail("nodes[{}].rotation is zero", i);
    // Files round to float; a quaternion of exact length keeps sizes exact. Near enough to 1 it stays bit for bit.
    if (std::abs(length - 1) > 1e-15) node.rotation = node.rotation / length;
  }
  if (!from.scale.empty()) {
    numbers(from.scale, 3, "scale");
    node.scale = swap_scale(dvec3(from.scale[0], from.scale[1], from.scale[2]));
  }
  return node;
}

// The parent of every node, -1 for roots.
std::vector<int> Reader::parents() const {
  const int count = static_cast<int>(model.nodes.size());
  std::vector<int> parent(count, -1);
  for (int i = 0; i < count; ++i)
    for (const int child : model.nodes[i].children) {
      index_in(child, model.nodes.size(), fmt::format("nodes[{}].children", i), "node");
      if (parent[child] != -1) fail("nodes[{}] is a child of both node {} and node {}", child, parent[child], i);
      parent[child] = i;
    }
  // With one parent each, nodes that no parentless node reaches are in a cycle.
  std::vector<int> tops;
  for (int i = 0; i < count; ++i)
    if (parent[i] == -1) tops.push_back(i);
  std::vector<char> sound(count, 0);
  for (const int node : reachable(tops)) sound[node] = 1;
  for (int i = 0; i < count; ++i)
    if (!sound[i]) fail("nodes[{}] is its own ancestor, break the cycle", i);
  return parent;
}

// Keeps the nodes of the scene, and joints outside of it with their ancestors.
void Reader::read_nodes(const std::vector<int>& in_scene) {
  const std::vector<int> parent = parents();
  std::vector<int> roots = in_scene;
  for (const int node : reachable(in_scene)) {
    const int skin = model.nodes[node].skin;
    if (skin < 0) continue;
    index_in(skin, model.skins.size(), fmt::format("nodes[{}]", node), "skin");
    for (const int joint : model.skins[skin].joints) {
      index_in(joint, model.nodes.size(), fmt::format("skins[{}].joints", skin), "node");
      int top = joint;
      while (parent[top] != -1) top = parent[top];
      roots.push_back(top);
    }
  }
  node_of.assign(model.nodes.size(), -1);
  for (const int i : reachable(roots)) {
    Node node = convert_node(i, 1e-12);
    // The parent may lie outside of the scene, where a scene lists a child as a root: then it has none.
    node.parent = parent[i] >= 0 ? node_of[parent[i]] : -1;
    node_of[i] = static_cast<int>(rig.nodes.size());
    rig.nodes.push_back(std::move(node));
  }
  world = world_transforms(rig, bind_pose(rig));
}

// Adds the bones of a skin; see skin_space() for what happens to their matrices.
void Reader::read_skin(int index) {
  if (skin_bones.count(index)) return;
  index_in(index, model.skins.size(), "a node", "skin");
  const tinygltf::Skin& skin = model.skins[index];
  if (skin.joints.empty()) fail("skins[{}] has no joints", index);
  std::vector<dmat4> inverse_bind(skin.joints.size(), dmat4(1.0));
  if (skin.inverseBindMatrices >= 0) {
    const Values v = values(skin.inverseBindMatrices, fmt::format("inverse bind matrices of skin {}", index), {16});
    if (v.count < skin.joints.size())
      fail("skins[{}] has {} joints but {} inverse bind matrices", index, skin.joints.size(), v.count);
    for (std::size_t j = 0; j < inverse_bind.size(); ++j) {
      for (int k = 0; k < 16; ++k) inverse_bind[j][k / 4][k % 4] = v[j][k];
      for (int c = 0; c < 4; ++c)
        if (!all_finite(inverse_bind[j][c]))
          fail("skins[{}]: the inverse bind matrix of joint {} is not finite", index, j);
      inverse_bind[j] = to_z_up(inverse_bind[j]);
    }
  }
  std::size_t top = 0;
  for (std::size_t j = 1; j < skin.joints.size(); ++j)
    if (node_of[skin.joints[j]] < node_of[skin.joints[top]]) top = j;
  const dmat4 to_model = skin_space(world[node_of[skin.joints[top]]], inverse_bind[top], rig.warnings);
  const bool moved = to_model != dmat4(1.0);
  skin_bones[index] = static_cast<std::uint32_t>(rig.bones.size());
  skin_to_model[index] = to_model;
  const dmat4 from_model = moved ? glm::affineInverse(to_model) : dmat4(1.0);
  for (std::size_t j = 0; j < skin.joints.size(); ++j)
    rig.bones.push_back({node_of[skin.joints[j]], moved ? inverse_bind[j] * from_model : inverse_bind[j]});
}

std::uint32_t Reader::rigid_bone(int node) {
  const auto [it, added] = rigid_bones.try_emplace(node, static_cast<std::uint32_t>(rig.bones.size()));
  if (added) {
    const dmat4& to_world = world[node_of[node]];
    rig.bones.push_back({node_of[node], is_invertible(to_world) ? glm::affineInverse(to_world) : dmat4(1.0)});
  }
  return it->second;
}

int Reader::image(int index) {
  if (index < 0) return -1;
  index_in(index, container.images.size(), "a texture", "image");
  if (const auto it = images.find(index); it != images.end()) return it->second;
  EncodedImage image = container.images[index];
  const nlohmann::json& entry = container.json["images"][index];
  if (image.bytes.empty() && entry.is_object() && entry.contains("bufferView") &&
      entry["bufferView"].is_number_unsigned()) {
    const std::uint64_t view = entry["bufferView"].get<std::uint64_t>();
    const std::string who = fmt::format("images[{}]", index);
    index_in(static_cast<int>(std::min<std::uint64_t>(view, 0x7FFFFFFF)), model.bufferViews.size(), who, "bufferView");
    const std::size_t size = model.bufferViews[view].byteLength;
    const std::uint8_t* p = bytes(static_cast<int>(view), 0, size, who);
    image.bytes.assign(p, p + size);
  }
  const int result = image.bytes.empty() ? -1 : static_cast<int>(rig.images.size());
  if (result >= 0) rig.images.push_back(std::move(image));
  return images[index] = result;
}

static Wrap wrap_mode(int mode) {
  if (mode == TINYGLTF_TEXTURE_WRAP_CLAMP_TO_EDGE) return Wrap::clamp;
  return mode == TINYGLTF_TEXTURE_WRAP_MIRRORED_REPEAT ? Wrap::mirror : Wrap::repeat;
}

static double number(const tinygltf::Value& object, const char* key, double otherwise) {
  return object.IsObject() && object.Has(key) && object.Get(key).IsNumber() ? object.Get(key).GetNumberAsDouble()
                                                                            : otherwise;
}

static vec2 pair_of(const tinygltf::Value& object, const char* key, vec2 otherwise) {
  if (!object.IsObject() || !object.Has(key)) return otherwise;
  const tinygltf::Value& v = object.Get(key);
  if (!v.IsArray() || v.ArrayLen() != 2 || !v.Get(0).IsNumber() || !v.Get(1).IsNumber()) return otherwise;
  return vec2(v.Get(0).GetNumberAsDouble(), v.Get(1).GetNumberAsDouble());
}

template <class Info>
TextureUse Reader::texture(const Info& info, const std::string& material) {
  TextureUse use;
  if (info.index < 0) return use;
  index_in(info.index, model.textures.size(), fmt::format("material '{}'", material), "texture");
  const tinygltf::Texture& from = model.textures[info.index];
  use.image = image(from.source);
  if (from.sampler >= 0) {
    index_in(from.sampler, model.samplers.size(), fmt::format("textures[{}]", info.index), "sampler");
    use.wrap_u = wrap_mode(model.samplers[from.sampler].wrapS);
    use.wrap_v = wrap_mode(model.samplers[from.sampler].wrapT);
  }
  int uv_set = info.texCoord;
  if (const auto it = info.extensions.find("KHR_texture_transform"); it != info.extensions.end()) {
    use.offset = pair_of(it->second, "offset", vec2(0));
    use.scale = pair_of(it->second, "scale", vec2(1));
    use.rotation = static_cast<float>(number(it->second, "rotation", 0));
    uv_set = static_cast<int>(number(it->second, "texCoord", uv_set));
  }
  if (uv_set != 0)
    rig.warnings.push_back(fmt::format("material '{}' wants UV set {}, set 0 is used instead", material, uv_set));
  return use;
}

void Reader::read_materials() {
  for (const tinygltf::Material& from : model.materials) {
    RigMaterial m;
    m.name = from.name.empty() ? fmt::format("material{}", rig.materials.size()) : from.name;
    const auto& pbr = from.pbrMetallicRoughness;
    if (pbr.baseColorFactor.size() == 4) {
      m.base_color = vec3(pbr.baseColorFactor[0], pbr.baseColorFactor[1], pbr.baseColorFactor[2]);
      m.alpha = static_cast<float>(pbr.baseColorFactor[3]);
    }
    m.roughness = static_cast<float>(pbr.roughnessFactor);
    m.metallic = static_cast<float>(pbr.metallicFactor);
    m.base_texture = texture(pbr.baseColorTexture, m.name);
    m.metallic_roughness_texture = texture(pbr.metallicRoughnessTexture, m.name);
    m.normal_texture = texture(from.normalTexture, m.name);
    m.normal_scale = static_cast<float>(from.normalTexture.scale);
    m.alpha_mask = from.alphaMode == "MASK";
    m.alpha_cutoff = static_cast<float>(from.alphaCutoff);
    if (const auto it = from.extensions.find("KHR_materials_pbrSpecularGlossiness"); it != from.extensions.end()) {
      // The retired workflow: its diffuse colour is the base colour of everything that is not metal.
      const tinygltf::Value& old = it->second;
      m.metallic = 0;
      m.roughness = static_cast<float>(1 - number(old, "glossinessFactor", 1));
      if (old.IsObject() && old.Has("diffuseTexture")) {
        tinygltf::TextureInfo info;
        info.index = static_cast<int>(number(old.Get("diffuseTexture"), "index", -1));
        m.base_texture = texture(info, m.name);
      }
      if (old.IsObject() && old.Has("diffuseFactor") && old.Get("diffuseFactor").IsArray() &&
          old.Get("diffuseFactor").ArrayLen() == 4)
        for (int k = 0; k < 3; ++k)
          if (old.Get("diffuseFactor").Get(k).IsNumber())
            m.base_color[k] = static_cast<float>(old.Get("diffuseFactor").Get(k).GetNumberAsDouble());
    }
    rig.materials.push_back(std::move(m));
  }
}

// Corner indices, three per triangle.
std::vector<std::uint32_t> Reader::read_triangles(const tinygltf::Primitive& primitive, std::size_t vertices,
                                                  const std::string& who) {
  std::vector<std::uint32_t> corners;
  if (primitive.indices >= 0) {
    const Values v = values(primitive.indices, "indices of " + who, {1});
    if (model.accessors[primitive.indices].componentType == TINYGLTF_COMPONENT_TYPE_FLOAT)
      fail("the indices of {} are not integers", who);
    corners.reserve(v.count);
    for (std::size_t i = 0; i < v.count; ++i) {
      if (!(v.data[i] >= 0 && v.data[i] < static_cast<double>(vertices)))
        fail("index {} of {} is {}, but it has {} vertices, export it again", i, who, v.data[i], vertices);
      corners.push_back(static_cast<std::uint32_t>(v.data[i]));
    }
  } else {
    corners.resize(vertices);
    for (std::size_t i = 0; i < vertices; ++i) corners[i] = static_cast<std::uint32_t>(i);
  }
  if (primitive.mode == TINYGLTF_MODE_TRIANGLES) {
    leftover_indices += corners.size() % 3;
    corners.resize(corners.size() / 3 * 3);
    return corners;
  }
  std::vector<std::uint32_t> out;
  for (std::size_t i = 0; i + 2 < corners.size(); ++i) {
    if (primitive.mode == TINYGLTF_MODE_TRIANGLE_STRIP)  // every other triangle turns the other way
      out.insert(out.end(), {corners[i], corners[i + 1 + i % 2], corners[i + 2 - i % 2]});
    else
      out.insert(out.end(), {corners[i + 1], corners[i + 2], corners[0]});
  }
  return out;
}

void Reader::read_primitive(int node, const tinygltf::Primitive& primitive, const std::string& name, int first_slot) {
  const std::string who = fmt::format("mesh '{}'", name);
  if (primitive.mode < 0 || primitive.mode > TINYGLTF_MODE_TRIANGLE_FAN)
    fail("{} has the primitive mode {}, which glTF does not know", who, primitive.mode);
  const auto attribute = [&](const std::string& key) {
    const auto it = primitive.attributes.find(key);
    return it == primitive.attributes.end() ? -1 : it->second;
  };
  if (primitive.mode < TINYGLTF_MODE_TRIANGLES || !primitive.attributes.count("POSITION")) {
    ++skipped_primitives;
    return;
  }
  const Values positions = values(attribute("POSITION"), "positions of " + who, {3});
  const std::size_t count = positions.count, first = rig.surface.rest.size();
  if (first + count > most_vertices) fail("has more than {} vertices, moomill cannot hold them", most_vertices);
  std::vector<std::uint32_t> corners = read_triangles(primitive, count, who);
  if (corners.empty()) {
    ++skipped_primitives;
    return;
  }
  const auto read = [&](const std::string& key, std::initializer_list<int> widths) {
    if (!primitive.attributes.count(key)) return Values{};
    Values v = values(attribute(key), key + " of " + who, widths);
    if (v.count != count) fail("{} has {} positions but {} of {}", who, count, v.count, key);
    return v;
  };
  const Values normals = read("NORMAL", {3}), uvs = read("TEXCOORD_0", {2}), colors = read("COLOR_0", {3, 4});
  const bool skinned = model.nodes[node].skin >= 0 && primitive.attributes.count("JOINTS_0");
  if (model.nodes[node].skin >= 0 && !skinned)
    rig.warnings.push_back(fmt::format("{} has a skin but no joints, it moves with its node", who));

  // Where vertices go, and how normals turn.
  dmat4 to_model = world[node_of[node]];
  if (skinned) {
    read_skin(model.nodes[node].skin);
    to_model = skin_to_model[model.nodes[node].skin];
  } else if (!is_invertible(to_model)) {
    to_model = dmat4(1.0);  // flattened by its node; the posed surface will be
  }
  const bool exact = to_model == dmat4(1.0);
  const dmat3 linear(to_model), turn = exact ? dmat3(1.0) : glm::inverseTranspose(linear);
  Surface& s = rig.surface;
  MeshPart part{.name = name,
                .first_vertex = static_cast<std::uint32_t>(first),
                .vertex_count = static_cast<std::uint32_t>(count),
                .first_triangle = static_cast<std::uint32_t>(s.triangles.size()),
                .skinned = skinned,
                .node = node_of[node]};

  std::vector<double> normal_length(count, 1);  // of turned normals: morph targets add to normals of length 1
  for (std::size_t i = 0; i < count; ++i) {
    const dvec3 p = to_z_up(dvec3(positions[i][0], positions[i][1], positions[i][2]));
    s.rest.push_back(vec3(exact ? p : transform_point(to_model, p)));
    dvec3 n(0);
    if (normals.count) n = turn * to_z_up(dvec3(normals[i][0], normals[i][1], normals[i][2]));
    if (const double length = glm::length(n); !exact && length > 0) normal_length[i] = length, n /= length;
    s.normals.push_back(vec3(n));
  }
  if (uvs.count) {
    s.uvs.resize(first, vec2(0));
    for (std::size_t i = 0; i < count; ++i) s.uvs.push_back(vec2(uvs[i][0], uvs[i][1]));
  }
  if (colors.count) {
    s.colors.resize(first, vec3(1));
    for (std::size_t i = 0; i < count; ++i) s.colors.push_back(vec3(colors[i][0], colors[i][1], colors[i][2]));
  }

  if (skinned) {
    std::vector<std::pair<Values, Values>> sets;
    for (int n = 0; primitive.attributes.count(fmt::format("JOINTS_{}", n)); ++n) {
      if (!primitive.attributes.count(fmt::format("WEIGHTS_{}", n)))
        fail("{} has JOINTS_{} but no WEIGHTS_{}", who, n, n);
      sets.emplace_back(read(fmt::format("JOINTS_{}", n), {4}), read(fmt::format("WEIGHTS_{}", n), {4}));
    }
    const std::uint32_t first_bone = skin_bones[model.nodes[node].skin];
    const std::size_t joints = model.skins[model.nodes[node].skin].joints.size();
    for (std::size_t i = 0; i < count; ++i) {
      for (const auto& [joint, weight] : sets)
        for (int k = 0; k < 4; ++k) {
          const float w = static_cast<float>(weight[i][k]);
          if (w == 0) continue;
          const double j = joint[i][k];
          if (!(j >= 0 && j < static_cast<double>(joints)))
            fail("vertex {} of {} is bound to joint {}, but its skin has {}, export it again", i, who, j, joints);
          rig.influences.push_back({first_bone + static_cast<std::uint32_t>(j), w});
        }
      rig.influence_begin.push_back(static_cast<std::uint32_t>(rig.influences.size()));
    }
  } else {
    const std::uint32_t bone = rigid_bone(node);
    for (std::size_t i = 0; i < count; ++i) {
      rig.influences.push_back({bone, 1});
      rig.influence_begin.push_back(static_cast<std::uint32_t>(rig.influences.size()));
    }
  }

  if (glm::determinant(linear) < 0)  // mirrored: keep triangles counter-clockwise from outside
    for (std::size_t i = 0; i < corners.size(); i += 3) std::swap(corners[i + 1], corners[i + 2]);
  int material = primitive.material;
  if (material < 0) {  // glTF's default material, once
    const auto known = std::find_if(rig.materials.begin(), rig.materials.end(),
                                    [](const RigMaterial& m) { return m.name == "default"; });
    material = static_cast<int>(known - rig.materials.begin());
    if (known == rig.materials.end()) rig.materials.push_back({.name = "default", .metallic = 0});
  }
  index_in(material, std::min<std::size_t>(rig.materials.size(), 65536), who, "material");
  for (std::size_t i = 0; i < corners.size(); i += 3) {
    s.triangles.push_back(uvec3(first) + uvec3(corners[i], corners[i + 1], corners[i + 2]));
    s.materials.push_back(static_cast<std::uint16_t>(material));
  }
  part.triangle_count = static_cast<std::uint32_t>(s.triangles.size()) - part.first_triangle;
  rig.meshes.push_back(std::move(part));

  for (std::size_t t = 0; t < primitive.targets.size(); ++t) {
    MorphTarget morph{.name = fmt::format("{} morph {}", name, t), .first_vertex = static_cast<std::uint32_t>(first)};
    morph.weight_slot = first_slot + static_cast<int>(t);
    const auto deltas = [&](const char* key, const dmat3& by, std::vector<vec3>& out) {
      const auto it = primitive.targets[t].find(key);
      if (it == primitive.targets[t].end()) return;
      const Values v = values(it->second, fmt::format("morph target {} of {}", t, who), {3});
      if (v.count != count) fail("morph target {} of {} has {} vertices instead of {}", t, who, v.count, count);
      for (std::size_t i = 0; i < count; ++i) {
        const dvec3 d = by * to_z_up(dvec3(v[i][0], v[i][1], v[i][2]));
        if (!all_finite(d)) fail("vertex {} of morph target {} of {} is not finite", i, t, who);
        out.push_back(vec3(std::string_view(key) == "NORMAL" ? d / normal_length[i] : d));
      }
    };
    deltas("POSITION", linear, morph.positions);
    deltas("NORMAL", turn, morph.normals);
    if (morph.positions.empty()) morph.positions.assign(count, vec3(0));
    if (!normals.count) morph.normals.clear();
    rig.morphs.push_back(std::move(morph));
  }
}

void Reader::read_mesh(int node) {
  const tinygltf::Node& holder = model.nodes[node];
  const tinygltf::Mesh& mesh = model.meshes[holder.mesh];
  std::string name = mesh.name.empty() ? holder.name : mesh.name;
  if (name.empty()) name = fmt::format("mesh{}", holder.mesh);
  std::size_t targets = 0;
  for (const auto& primitive : mesh.primitives) targets = std::max(targets, primitive.targets.size());
  const int first_slot = static_cast<int>(rig.morph_weights.size());
  const std::vector<double>& weights = holder.weights.empty() ? mesh.weights : holder.weights;
  for (std::size_t t = 0; t < targets; ++t) {
    rig.morph_weights.push_back(t < weights.size() ? weights[t] : 0.0);
    rig.morph_node.push_back(node_of[node]);
    rig.morph_index.push_back(static_cast<int>(t));
  }
  const std::size_t first_morph = rig.morphs.size();
  for (const auto& primitive : mesh.primitives) {
    std::string full = name;
    if (mesh.primitives.size() > 1) {
      const bool named = primitive.material >= 0 && primitive.material < static_cast<int>(model.materials.size());
      full += named ? "/" + rig.materials[primitive.material].name : std::string("/default");
    }
    read_primitive(node, primitive, full, first_slot);
  }
  if (mesh.extras.IsObject() && mesh.extras.Has("targetNames") && mesh.extras.Get("targetNames").IsArray())
    for (std::size_t m = first_morph; m < rig.morphs.size(); ++m) {
      const tinygltf::Value& names = mesh.extras.Get("targetNames");
      const std::size_t t = rig.morphs[m].weight_slot - first_slot;
      if (t < names.ArrayLen() && names.Get(t).IsString()) rig.morphs[m].name = names.Get(t).Get<std::string>();
    }
}

void Reader::read_clips() {
  std::size_t ignored = 0;
  for (std::size_t a = 0; a < model.animations.size(); ++a) {
    const tinygltf::Animation& animation = model.animations[a];
    Clip clip{.name = animation.name};
    for (std::size_t c = 0; c < animation.channels.size(); ++c) {
      const tinygltf::AnimationChannel& from = animation.channels[c];
      const std::string who = fmt::format("animations[{}].channels[{}]", a, c);
      if (from.target_node < 0) continue;  // allowed: it targets what an extension says
      index_in(from.target_node, model.nodes.size(), who, "node");
      Channel channel;
      channel.node = node_of[from.target_node];
      if (channel.node < 0) continue;
      std::size_t width = 3;
      if (from.target_path == "translation")
        channel.path = ChannelPath::translation;
      else if (from.target_path == "rotation")
        channel.path = ChannelPath::rotation, width = 4;
      else if (from.target_path == "scale")
        channel.path = ChannelPath::scale;
      else if (from.target_path == "weights")
        channel.path = ChannelPath::weights, width = 1;
      else {
        ++ignored;
        continue;
      }
      index_in(from.sampler, animation.samplers.size(), who, "sampler");
      const tinygltf::AnimationSampler& sampler = animation.samplers[from.sampler];
      if (sampler.interpolation == "STEP")
        channel.interpolation = Interpolation::step;
      else if (sampler.interpolation == "CUBICSPLINE")
        channel.interpolation = Interpolation::cubic_spline;
      else if (sampler.interpolation != "LINEAR")
        fail("{} has the interpolation '{}', which glTF does not know", who, sampler.interpolation);
      channel.times = values(sampler.input, "times of " + who, {1}).data;
      const Values v = values(sampler.output, "values of " + who, {static_cast<int>(width)});
      const std::size_t keys = channel.times.size(),
                        per_key = channel.interpolation == Interpolation::cubic_spline ? 3 : 1;
      if (keys == 0) continue;
      if (v.count < keys * per_key || v.count % (keys * per_key) != 0 || (width > 1 && v.count != keys * per_key))
        fail("{} has {} times but {} values, export it again", who, keys, v.count);
      for (std::size_t k = 0; k < keys; ++k)
        if (!std::isfinite(channel.times[k]) || (k && channel.times[k] < channel.times[k - 1]))
          fail("{}: time {} is not after the one before", who, k);
      for (std::size_t i = 0; i < v.count; ++i) {
        const double* x = v[i];
        for (std::size_t k = 0; k < width; ++k)
          if (!std::isfinite(x[k])) fail("{}: value {} is not finite", who, i);
        if (channel.path == ChannelPath::weights) {
          channel.values.push_back(x[0]);
        } else if (channel.path == ChannelPath::rotation) {
          channel.values.insert(channel.values.end(), {x[0], -x[2], x[1], x[3]});
        } else {
          const dvec3 p(x[0], x[1], x[2]), q = channel.path == ChannelPath::scale ? swap_scale(p) : to_z_up(p);
          channel.values.insert(channel.values.end(), {q.x, q.y, q.z});
        }
      }
      if (channel.path == ChannelPath::weights && channel.interpolation == Interpolation::cubic_spline && keys > 0 &&
          channel.values.size() % (3 * keys) != 0)
        fail("{} has a broken spline of weights", who);
      clip.duration = std::max(clip.duration, channel.times.back());
      clip.channels.push_back(std::move(channel));
    }
    rig.clips.push_back(std::move(clip));
  }
  if (ignored) rig.warnings.push_back(fmt::format("{} animation channels move what moomill does not know", ignored));
}

static Rig read(const std::filesystem::path& path, const LoadOptions& options) {
  Reader r(path);
  if (const auto extras = r.container.json.find("extras");
      extras != r.container.json.end() && extras->is_object() && extras->contains("moomill")) {
    try {
      r.read_own((*extras)["moomill"]);
    } catch (const nlohmann::json::exception& e) {
      r.fail("its extras.moomill is broken ({}), write the rig again", e.what());
    }
    return std::move(r.rig);
  }
  const std::vector<int> roots = r.scene_roots(options);
  for (const int root : roots) r.index_in(root, r.model.nodes.size(), "the scene", "node");
  r.read_nodes(roots);
  r.read_materials();

  // Which meshes: those asked for by name, else the skinned ones, else all.
  std::vector<int> holders;
  bool any_skinned = false;
  for (const int node : r.reachable(roots)) {
    if (r.model.nodes[node].mesh < 0) continue;
    r.index_in(r.model.nodes[node].mesh, r.model.meshes.size(), fmt::format("nodes[{}]", node), "mesh");
    holders.push_back(node);
    any_skinned |= r.model.nodes[node].skin >= 0;
  }
  r.rig.influence_begin = {0};
  MeshChoice choice(options, any_skinned);
  for (const int node : holders) {
    const tinygltf::Node& holder = r.model.nodes[node];
    if (choice.takes(holder.name, r.model.meshes[holder.mesh].name, holder.skin >= 0)) r.read_mesh(node);
  }
  choice.finish(r.rig);
  Surface& s = r.rig.surface;
  if (!s.uvs.empty()) s.uvs.resize(s.rest.size(), vec2(0));
  if (!s.colors.empty()) s.colors.resize(s.rest.size(), vec3(1));
  if (r.skipped_primitives)
    r.rig.warnings.push_back(fmt::format("{} primitives without triangles were left out", r.skipped_primitives));
  if (r.leftover_indices)
    r.rig.warnings.push_back(fmt::format("{} indices at the end of a list make no triangle", r.leftover_indices));
  r.read_clips();
  return std::move(r.rig);
}

}  // namespace gltf

Rig load_gltf(const std::filesystem::path& file, const LoadOptions& options) {
  Rig rig = gltf::read(file, options);
  finish_rig(rig);
  scale_rig(rig, options.scale);
  return rig;
}

}  // namespace moomill
