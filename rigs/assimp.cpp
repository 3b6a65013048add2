// FBX, Collada and OBJ in, through Assimp: the only file that knows it.
//
// Assimp 5.2 leaves FBX in the file's own axes and unit and only reports them as metadata; Collada's it folds into the
// root node (the axes unless told not to, the unit always); OBJ has neither. All three are converted here, node by
// node, as glTF is.
#include <assimp/config.h>
#include <assimp/postprocess.h>
#include <assimp/scene.h>

#include <assimp/Importer.hpp>
#include <cctype>
#include <cstring>
#include <fstream>
#include <glm/gtc/matrix_inverse.hpp>
#include <map>
#include <unordered_map>

#include "generator/core/error.h"
#include "rigs/loading.h"
#include "rigs/pose.h"
#include "rigs/rig.h"

namespace moomill {
namespace {

// How a file's coordinates become ours: ours = metres_per_unit * axes * theirs. `axes` is a signed permutation.
struct Convention {
  dmat3 axes{dvec3(1, 0, 0), dvec3(0, 0, 1), dvec3(0, -1, 0)};  // columns; right-handed, Y up
  double metres_per_unit = 1;

  dvec3 vector(const dvec3& v) const { return axes * v; }
  dvec3 point(const dvec3& v) const { return metres_per_unit * (axes * v); }
  dvec3 scale(const dvec3& s) const { return glm::abs(axes * s) * glm::sign(permute(s)); }
  dquat rotation(const dquat& q) const {  // an axis of rotation is mirrored once more than a vector
    const dvec3 v = glm::determinant(axes) * (axes * dvec3(q.x, q.y, q.z));
    return dquat(q.w, v.x, v.y, v.z);
  }
  dmat4 matrix(const dmat4& m) const {
    dmat4 result(axes * dmat3(m) * glm::transpose(axes));
    result[3] = dvec4(point(dvec3(m[3])), 1);
    return result;
  }

 private:
  dvec3 permute(const dvec3& s) const { return dmat3(glm::abs(axes[0]), glm::abs(axes[1]), glm::abs(axes[2])) * s; }
};

dvec3 vec(const aiVector3D& v) {
  return {v.x, v.y, v.z};
}
dquat quat(const aiQuaternion& q) {
  return dquat(q.w, q.x, q.y, q.z);
}
dmat4 mat(const aiMatrix4x4& m) {
  dmat4 r;
  for (int column = 0; column < 4; ++column)
    for (int row = 0; row < 4; ++row) r[column][row] = m[row][column];
  return r;
}
std::string text(const aiString& s) {
  return std::string(s.data, s.length);
}

std::string lower(std::string s) {
  for (char& c : s) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return s;
}

Convention fbx_convention(const aiScene& scene, std::vector<std::string>& warnings) {
  Convention convention;
  convention.metres_per_unit = 0.01;
  if (!scene.mMetaData) return convention;
  float unit = 1;
  double unit_double = 1;
  if (scene.mMetaData->Get("UnitScaleFactor", unit_double))
    unit = static_cast<float>(unit_double);
  else
    scene.mMetaData->Get("UnitScaleFactor", unit);
  if (unit > 0 && std::isfinite(unit)) convention.metres_per_unit = static_cast<double>(unit) * 0.01;  // centimetres
  // FBX says which axis points up, which to the front (to us), and which to the right.
  int axis[3] = {0, 2, 1}, sign[3] = {1, 1, 1};  // right, front, up
  const char* names[3] = {"CoordAxis", "FrontAxis", "UpAxis"};
  for (int i = 0; i < 3; ++i) {
    int value = 0;
    if (scene.mMetaData->Get(names[i], value)) axis[i] = value;
    if (scene.mMetaData->Get(std::string(names[i]) + "Sign", value)) sign[i] = value < 0 ? -1 : 1;
  }
  dmat3 rows(0.0);
  const int ours[3] = {0, 1, 2};
  const int towards[3] = {1, -1, 1};  // the front looks along our -y
  for (int i = 0; i < 3; ++i) {
    if (axis[i] < 0 || axis[i] > 2) continue;
    rows[axis[i]][ours[i]] = sign[i] * towards[i];
  }
  if (std::abs(glm::determinant(rows)) == 1)
    convention.axes = rows;
  else
    warnings.push_back("the axes the file declares make no sense, Y is taken as up");
  return convention;
}

// <unit meter="..."/> and <up_axis> of Collada's asset element, which Assimp does not report.
Convention collada_convention(const std::filesystem::path& file) {
  Convention convention;
  std::ifstream in(file, std::ios::binary);
  std::string head(1 << 16, '\0');
  in.read(head.data(), static_cast<std::streamsize>(head.size()));
  head.resize(static_cast<std::size_t>(in.gcount()));
  if (const auto end = head.find("</asset>"); end != std::string::npos) head.resize(end);
  if (const auto unit = head.find("<unit"); unit != std::string::npos) {
    const auto meter = head.find("meter=", unit);
    if (meter != std::string::npos && meter < head.find('>', unit) && meter + 7 < head.size()) {
      const double value = std::strtod(head.c_str() + meter + 7, nullptr);
      if (value > 0 && std::isfinite(value)) convention.metres_per_unit = value;
    }
  }
  if (head.find("Z_UP") != std::string::npos) convention.axes = dmat3(1.0);
  // X up: file x is up, y is to the left, z towards us (Collada 1.4, 5-13).
  if (head.find("X_UP") != std::string::npos) convention.axes = dmat3(dvec3(0, 0, 1), dvec3(-1, 0, 0), dvec3(0, -1, 0));
  return convention;
}

struct Importer {
  std::filesystem::path file;
  const aiScene& scene;
  Convention convention;
  Rig rig{};
  std::map<std::string, int> node_by_name{};
  std::vector<std::pair<const aiNode*, int>> holders{};  // nodes with meshes
  std::vector<dmat4> world{};
  std::map<std::string, int> image_by_path{};
  std::size_t not_triangles = 0;
  double root_scale = 1;  // what Assimp multiplied the root node by

  std::string source() const { return file.string(); }

  void read_nodes(const aiNode* from, int parent) {
    struct Item {
      const aiNode* node;
      int parent;
    };
    std::vector<Item> stack = {{from, parent}};
    while (!stack.empty()) {
      const Item item = stack.back();
      stack.pop_back();
      Node node;
      node.name = text(item.node->mName);
      node.parent = item.parent;
      dmat4 theirs = mat(item.node->mTransformation);
      if (item.parent < 0 && root_scale != 1)
        for (int c = 0; c < 4; ++c) theirs[c] = dvec4(dvec3(theirs[c]) / root_scale, theirs[c].w);
      const dmat4 m = convention.matrix(theirs);
      for (int c = 0; c < 4; ++c)
        if (!all_finite(m[c])) input_error("{}: the transform of node '{}' is not finite", source(), node.name);
      set_transform(node, m, 2e-6);  // the matrices are products in float
      const int index = static_cast<int>(rig.nodes.size());
      node_by_name.try_emplace(node.name, index);
      if (item.node->mNumMeshes) holders.emplace_back(item.node, index);
      rig.nodes.push_back(std::move(node));
      for (unsigned i = item.node->mNumChildren; i-- > 0;) stack.push_back({item.node->mChildren[i], index});
    }
  }

  int image(const aiString& path_text) {
    std::string path = text(path_text);
    for (char& c : path)
      if (c == '\\') c = '/';
    if (const auto it = image_by_path.find(path); it != image_by_path.end()) return it->second;
    EncodedImage image{.name = path, .bytes = {}};
    if (const aiTexture* embedded = scene.GetEmbeddedTexture(path_text.C_Str())) {
      if (embedded->mHeight == 0) {
        const auto* bytes = reinterpret_cast<const std::uint8_t*>(embedded->pcData);
        image.bytes.assign(bytes, bytes + embedded->mWidth);
      } else {
        rig.warnings.push_back(fmt::format("embedded texture '{}' is not compressed, its material goes without", path));
      }
    } else {
      // Files often hold the path on the machine of their author: then the name alone beside the model will do.
      const auto folder = file.parent_path();
      const auto name = std::filesystem::path(path).filename();
      std::error_code error;
      for (const auto& candidate : {folder / path, folder / name, folder / "textures" / name}) {
        if (!std::filesystem::is_regular_file(candidate, error)) continue;
        std::ifstream in(candidate, std::ios::binary);
        image.bytes.assign(std::istreambuf_iterator<char>(in), {});
        break;
      }
      if (image.bytes.empty())
        rig.warnings.push_back(fmt::format("texture '{}' is not there, its material goes without", path));
    }
    const int index = image.bytes.empty() ? -1 : static_cast<int>(rig.images.size());
    if (index >= 0) rig.images.push_back(std::move(image));
    return image_by_path[path] = index;
  }

  TextureUse texture(const aiMaterial& material, aiTextureType type) {
    TextureUse use;
    aiString path;
    if (material.GetTextureCount(type) == 0 || material.GetTexture(type, 0, &path) != AI_SUCCESS) return use;
    use.image = image(path);
    const auto wrap = [&](const char* key) {
      int mode = aiTextureMapMode_Wrap;
      material.Get(key, type, 0, mode);
      return mode == aiTextureMapMode_Wrap     ? Wrap::repeat
             : mode == aiTextureMapMode_Mirror ? Wrap::mirror
                                               : Wrap::clamp;
    };
    use.wrap_u = wrap(_AI_MATKEY_MAPPINGMODE_U_BASE);
    use.wrap_v = wrap(_AI_MATKEY_MAPPINGMODE_V_BASE);
    aiUVTransform moved;
    if (material.Get(_AI_MATKEY_UVTRANSFORM_BASE, type, 0, moved) == AI_SUCCESS &&
        (moved.mTranslation != aiVector2D(0, 0) || moved.mScaling != aiVector2D(1, 1) || moved.mRotation != 0))
      rig.warnings.push_back(fmt::format("the UV transform of texture '{}' is not applied", text(path)));
    return use;
  }

  void read_materials() {
    for (unsigned i = 0; i < scene.mNumMaterials; ++i) {
      const aiMaterial& from = *scene.mMaterials[i];
      RigMaterial m;
      aiString name;
      if (from.Get(AI_MATKEY_NAME, name) == AI_SUCCESS) m.name = text(name);
      aiColor4D color(1, 1, 1, 1);
      if (from.Get(AI_MATKEY_BASE_COLOR, color) != AI_SUCCESS) from.Get(AI_MATKEY_COLOR_DIFFUSE, color);
      m.base_color = vec3(color.r, color.g, color.b);
      float opacity = 1;
      if (from.Get(AI_MATKEY_OPACITY, opacity) == AI_SUCCESS) m.alpha = opacity;
      float roughness = 0, shininess = 0;
      if (from.Get(AI_MATKEY_SHININESS, shininess) == AI_SUCCESS && shininess > 0)
        m.roughness = std::sqrt(2.0f / (shininess + 2.0f));  // Blinn exponent to GGX roughness squared
      if (from.Get(AI_MATKEY_ROUGHNESS_FACTOR, roughness) == AI_SUCCESS && roughness > 0 && roughness <= 1)
        m.roughness = roughness;
      m.base_texture = texture(from, aiTextureType_BASE_COLOR);
      if (m.base_texture.image < 0) m.base_texture = texture(from, aiTextureType_DIFFUSE);
      m.normal_texture = texture(from, aiTextureType_NORMALS);
      rig.materials.push_back(std::move(m));
    }
  }

  // Bones of all meshes that one node holds (a mesh with several materials comes as several), and their common space.
  dmat4 read_bones(const aiNode& holder, std::map<std::string, std::uint32_t>& bones) {
    std::vector<std::pair<int, dmat4>> found;
    std::vector<std::string> names;
    for (unsigned i = 0; i < holder.mNumMeshes; ++i) {
      const aiMesh& mesh = *scene.mMeshes[holder.mMeshes[i]];
      for (unsigned b = 0; b < mesh.mNumBones; ++b) {
        const std::string name = text(mesh.mBones[b]->mName);
        if (bones.count(name)) continue;
        const auto node = node_by_name.find(name);
        if (node == node_by_name.end())
          input_error("{}: mesh '{}' is bound to the joint '{}', which does not exist", source(), text(mesh.mName),
                      name);
        bones[name] = static_cast<std::uint32_t>(rig.bones.size() + found.size());
        found.emplace_back(node->second, convention.matrix(mat(mesh.mBones[b]->mOffsetMatrix)));
        for (int c = 0; c < 4; ++c)
          if (!all_finite(found.back().second[c]))
            input_error("{}: the bind matrix of joint '{}' is not finite", source(), name);
      }
    }
    if (found.empty()) return dmat4(1.0);
    const auto top =
        std::min_element(found.begin(), found.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
    const dmat4 to_model = skin_space(world[top->first], top->second, rig.warnings);
    const dmat4 from_model = glm::affineInverse(to_model);
    for (const auto& [node, offset] : found) rig.bones.push_back({node, offset * from_model});
    return to_model;
  }

  void read_mesh(const aiMesh& mesh, const std::string& name, int node, const dmat4& to_model,
                 const std::map<std::string, std::uint32_t>& bones, bool skinned);
  void read_clips();
};

// Assimp hands out a vertex per corner; vertices that agree in everything are one again here.
void Importer::read_mesh(const aiMesh& mesh, const std::string& name, int node, const dmat4& to_model,
                         const std::map<std::string, std::uint32_t>& bones, bool skinned) {
  Surface& s = rig.surface;
  const auto first = static_cast<std::uint32_t>(s.rest.size());
  MeshPart part{.name = name,
                .first_vertex = first,
                .first_triangle = static_cast<std::uint32_t>(s.triangles.size()),
                .skinned = skinned,
                .node = node};
  std::vector<std::vector<Influence>> influences(mesh.mNumVertices);
  for (unsigned b = 0; b < mesh.mNumBones && skinned; ++b) {
    const aiBone& bone = *mesh.mBones[b];
    for (unsigned i = 0; i < bone.mNumWeights; ++i) {
      const aiVertexWeight& w = bone.mWeights[i];
      if (w.mVertexId >= mesh.mNumVertices)
        input_error("{}: joint '{}' weighs vertex {} of mesh '{}', which has {}", source(), text(bone.mName),
                    w.mVertexId, name, mesh.mNumVertices);
      if (w.mWeight != 0) influences[w.mVertexId].push_back({bones.at(text(bone.mName)), w.mWeight});
    }
  }
  if (!skinned) {
    const auto bone = static_cast<std::uint32_t>(rig.bones.size());
    rig.bones.push_back({node, is_invertible(world[node]) ? glm::affineInverse(world[node]) : dmat4(1.0)});
    for (auto& list : influences) list.push_back({bone, 1});
  }
  const dmat3 linear(to_model), turn = is_invertible(to_model) ? glm::inverseTranspose(linear) : dmat3(1.0);
  const bool mirrored = (glm::determinant(linear) < 0) != (glm::determinant(convention.axes) < 0);
  const bool uv = mesh.HasTextureCoords(0), color = mesh.HasVertexColors(0), normal = mesh.HasNormals();
  if (uv) s.uvs.resize(first, vec2(0));
  if (color) s.colors.resize(first, vec3(1));

  std::unordered_map<std::string, std::uint32_t> known;
  std::vector<std::uint32_t> place(mesh.mNumVertices, 0);
  std::vector<unsigned> kept;  // Assimp's number of each of our vertices
  const auto vertex = [&](unsigned i) {
    std::string key;
    const auto append = [&](const auto& value) { key.append(reinterpret_cast<const char*>(&value), sizeof value); };
    append(mesh.mVertices[i]);
    if (normal) append(mesh.mNormals[i]);
    if (uv) append(mesh.mTextureCoords[0][i]);
    if (color) append(mesh.mColors[0][i]);
    for (const Influence& influence : influences[i]) append(influence.bone), append(influence.weight);
    for (unsigned m = 0; m < mesh.mNumAnimMeshes; ++m)
      if (mesh.mAnimMeshes[m]->HasPositions() && i < mesh.mAnimMeshes[m]->mNumVertices)
        append(mesh.mAnimMeshes[m]->mVertices[i]);
    const auto [it, added] = known.try_emplace(key, static_cast<std::uint32_t>(s.rest.size()));
    if (!added) return it->second;
    s.rest.push_back(vec3(transform_point(to_model, convention.point(vec(mesh.mVertices[i])))));
    dvec3 n(0);
    if (normal) n = turn * convention.vector(vec(mesh.mNormals[i]));
    s.normals.push_back(vec3(glm::length(n) > 0 ? glm::normalize(n) : n));
    // Texture coordinates grow upwards in these formats, downwards in glTF and here.
    if (uv) s.uvs.push_back(vec2(mesh.mTextureCoords[0][i].x, 1 - mesh.mTextureCoords[0][i].y));
    if (color) s.colors.push_back(vec3(mesh.mColors[0][i].r, mesh.mColors[0][i].g, mesh.mColors[0][i].b));
    rig.influences.insert(rig.influences.end(), influences[i].begin(), influences[i].end());
    rig.influence_begin.push_back(static_cast<std::uint32_t>(rig.influences.size()));
    kept.push_back(i);
    return it->second;
  };
  for (unsigned f = 0; f < mesh.mNumFaces; ++f) {
    const aiFace& face = mesh.mFaces[f];
    if (face.mNumIndices != 3) {
      ++not_triangles;
      continue;
    }
    uvec3 t;
    for (int k = 0; k < 3; ++k) {
      if (face.mIndices[k] >= mesh.mNumVertices)
        input_error("{}: face {} of mesh '{}' uses vertex {}, but there are {}", source(), f, name, face.mIndices[k],
                    mesh.mNumVertices);
      t[k] = vertex(face.mIndices[k]);
    }
    if (mirrored) std::swap(t[1], t[2]);
    s.triangles.push_back(t);
    s.materials.push_back(static_cast<std::uint16_t>(std::min(mesh.mMaterialIndex, 0xFFFFu)));
  }
  part.vertex_count = static_cast<std::uint32_t>(s.rest.size()) - first;
  part.triangle_count = static_cast<std::uint32_t>(s.triangles.size()) - part.first_triangle;
  if (part.triangle_count == 0) return;  // points or lines only; no vertex was added
  rig.meshes.push_back(std::move(part));

  for (unsigned m = 0; m < mesh.mNumAnimMeshes; ++m) {
    const aiAnimMesh& from = *mesh.mAnimMeshes[m];
    MorphTarget morph{.name = text(from.mName), .first_vertex = first};
    morph.weight_slot = static_cast<int>(rig.morph_weights.size());
    rig.morph_weights.push_back(0);  // a weight in the file is where a clip may start, not the shape at rest
    rig.morph_node.push_back(node);
    rig.morph_index.push_back(static_cast<int>(m));
    for (const unsigned i : kept)
      morph.positions.push_back(from.HasPositions() && i < from.mNumVertices
                                    ? vec3(linear * convention.point(vec(from.mVertices[i]) - vec(mesh.mVertices[i])))
                                    : vec3(0));
    rig.morphs.push_back(std::move(morph));
  }
}

void Importer::read_clips() {
  std::size_t lost = 0;
  for (unsigned a = 0; a < scene.mNumAnimations; ++a) {
    const aiAnimation& from = *scene.mAnimations[a];
    Clip clip{.name = text(from.mName)};
    const double rate = from.mTicksPerSecond > 0 ? from.mTicksPerSecond : 25;  // Assimp's documented default
    for (unsigned c = 0; c < from.mNumChannels; ++c) {
      const aiNodeAnim& moves = *from.mChannels[c];
      const auto node = node_by_name.find(text(moves.mNodeName));
      if (node == node_by_name.end()) {
        ++lost;
        continue;
      }
      const auto channel = [&](ChannelPath path, unsigned count, const auto* keys, const auto& convert) {
        Channel out{.node = node->second, .path = path};
        for (unsigned k = 0; k < count; ++k) {
          const double time = keys[k].mTime / rate;
          if (!std::isfinite(time) || (k && time < out.times.back()))
            input_error("{}: clip '{}' moves node '{}' at times that do not increase", source(), clip.name,
                        text(moves.mNodeName));
          out.times.push_back(time);
          convert(keys[k].mValue, out.values);
        }
        for (const double v : out.values)
          if (!std::isfinite(v))
            input_error("{}: clip '{}' moves node '{}' to where is not finite", source(), clip.name,
                        text(moves.mNodeName));
        if (out.times.empty()) return;
        clip.duration = std::max(clip.duration, out.times.back());
        clip.channels.push_back(std::move(out));
      };
      channel(ChannelPath::translation, moves.mNumPositionKeys, moves.mPositionKeys,
              [&](const aiVector3D& v, auto& out) {
                const dvec3 p = convention.point(vec(v));
                out.insert(out.end(), {p.x, p.y, p.z});
              });
      channel(ChannelPath::rotation, moves.mNumRotationKeys, moves.mRotationKeys,
              [&](const aiQuaternion& v, auto& out) {
                const dquat q = convention.rotation(quat(v));
                out.insert(out.end(), {q.x, q.y, q.z, q.w});
              });
      channel(ChannelPath::scale, moves.mNumScalingKeys, moves.mScalingKeys, [&](const aiVector3D& v, auto& out) {
        const dvec3 p = convention.scale(vec(v));
        out.insert(out.end(), {p.x, p.y, p.z});
      });
    }
    rig.clips.push_back(std::move(clip));
  }
  if (lost) rig.warnings.push_back(fmt::format("{} animation channels move nodes that do not exist", lost));
}

}  // namespace

Rig load_with_assimp(const std::filesystem::path& file, const LoadOptions& options) {
  const std::string extension = lower(file.extension().string());
  Assimp::Importer assimp;
  assimp.SetPropertyBool(AI_CONFIG_IMPORT_FBX_PRESERVE_PIVOTS, false);
  assimp.SetPropertyBool(AI_CONFIG_IMPORT_COLLADA_IGNORE_UP_DIRECTION, true);
  const aiScene* scene = assimp.ReadFile(file.string(), aiProcess_Triangulate);
  if (!scene || !scene->mRootNode) {
    std::string why = assimp.GetErrorString();
    for (char& c : why)
      if (c == '\n') c = ' ';
    input_error("{}: cannot be read ({}), export it again", file.string(), why);
  }
  Importer in{.file = file, .scene = *scene, .convention = {}};
  if (extension == ".dae") in.convention = collada_convention(file);
  if (extension == ".dae")
    in.root_scale = static_cast<float>(in.convention.metres_per_unit);
  else if (extension != ".obj")
    in.convention = fbx_convention(*scene, in.rig.warnings);
  in.rig.source = file.string();
  in.read_nodes(scene->mRootNode, -1);
  in.world = world_transforms(in.rig, bind_pose(in.rig));
  in.read_materials();

  const auto is_skinned = [&](const aiNode& node) {
    for (unsigned i = 0; i < node.mNumMeshes; ++i)
      if (scene->mMeshes[node.mMeshes[i]]->HasBones()) return true;
    return false;
  };
  bool any_skinned = false;
  for (const auto& [node, index] : in.holders) any_skinned |= is_skinned(*node);
  MeshChoice choice(options, any_skinned);
  in.rig.influence_begin = {0};
  for (const auto& [node, index] : in.holders) {
    const std::string name = text(node->mName);
    if (!choice.takes(name, text(scene->mMeshes[node->mMeshes[0]]->mName), is_skinned(*node))) continue;
    std::map<std::string, std::uint32_t> bones;
    const dmat4 skin_to_model = in.read_bones(*node, bones);
    for (unsigned i = 0; i < node->mNumMeshes; ++i) {
      const aiMesh& mesh = *scene->mMeshes[node->mMeshes[i]];
      std::string full = name.empty() ? text(mesh.mName) : name;
      if (node->mNumMeshes > 1 && mesh.mMaterialIndex < in.rig.materials.size())
        full += "/" + in.rig.materials[mesh.mMaterialIndex].name;
      const bool skinned = mesh.HasBones();
      const dmat4 rigid = is_invertible(in.world[index]) ? in.world[index] : dmat4(1.0);
      in.read_mesh(mesh, full, index, skinned ? skin_to_model : rigid, bones, skinned);
    }
  }
  choice.finish(in.rig);
  Surface& s = in.rig.surface;
  if (!s.uvs.empty()) s.uvs.resize(s.rest.size(), vec2(0));
  if (!s.colors.empty()) s.colors.resize(s.rest.size(), vec3(1));
  if (in.not_triangles)
    in.rig.warnings.push_back(fmt::format("{} faces are points or lines and were left out", in.not_triangles));
  in.read_clips();
  finish_rig(in.rig);
  scale_rig(in.rig, options.scale);
  return std::move(in.rig);
}

}  // namespace moomill
