#pragma once
// A skinned animal rig as loaded: plain data, already converted to our conventions (right-handed, Z up, metres).
// glTF, FBX, Collada, OBJ and our own builder all make the same Rig.
#include <array>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "generator/core/image.h"
#include "generator/core/math.h"
#include "generator/core/surface.h"

namespace moomill {

// A node of the hierarchy; joints are nodes too. Parents come before children.
struct Node {
  std::string name;  // unique within a rig; made so at load where the file repeats or omits names
  int parent = -1;
  dvec3 translation{0};  // metres
  dquat rotation{1, 0, 0, 0};
  dvec3 scale{1};
  std::optional<dmat4> matrix;  // instead of the three above, when the file gives a matrix that they cannot express
};

// What vertices are bound to: a node and the matrix that takes bind-pose model space into its frame. A mesh without
// skin is bound rigidly to its node, and its rest positions are in model space like all others.
struct Bone {
  int node = 0;
  dmat4 inverse_bind{1.0};
};

struct Influence {
  std::uint32_t bone = 0;
  float weight = 0;
};

// A range of vertices and triangles that was one primitive of one mesh in the file.
struct MeshPart {
  std::string name;
  std::uint32_t first_vertex = 0, vertex_count = 0;
  std::uint32_t first_triangle = 0, triangle_count = 0;
  bool skinned = false;
  int node = -1;
};

struct MorphTarget {
  std::string name;
  std::uint32_t first_vertex = 0;  // of the vertex range it moves
  std::vector<vec3> positions;     // metres, added to rest
  std::vector<vec3> normals;       // empty, or added to normals
  int weight_slot = 0;             // index into Pose::morph_weights
};

// An image in use by a material, with glTF's texture transform (KHR_texture_transform).
struct TextureUse {
  int image = -1;  // index into Rig::images, -1 for none
  Wrap wrap_u = Wrap::repeat, wrap_v = Wrap::repeat;
  vec2 offset{0}, scale{1};
  float rotation = 0;  // radians
};

// Metallic-roughness material, as in glTF 2.0.
struct RigMaterial {
  std::string name;
  vec3 base_color{1};  // linear
  float alpha = 1;
  TextureUse base_texture;
  float roughness = 1, metallic = 0;
  TextureUse metallic_roughness_texture;  // G roughness, B metallic
  TextureUse normal_texture;
  float normal_scale = 1;
  bool alpha_mask = false;  // texels with alpha below the cutoff are not there
  float alpha_cutoff = 0.5f;
};

enum class ChannelPath : std::uint8_t { translation, rotation, scale, weights };
enum class Interpolation : std::uint8_t { step, linear, cubic_spline };

struct Channel {
  int node = 0;
  ChannelPath path{};
  Interpolation interpolation = Interpolation::linear;
  std::vector<double> times;   // seconds, increasing
  std::vector<double> values;  // per key: 3, 4 (x, y, z, w) or the number of weights; cubic_spline: in-tangent, value, out-tangent
};

struct Clip {
  std::string name;
  double duration = 0;  // seconds
  std::vector<Channel> channels;
};

struct Rig {
  std::string source;  // file name, for messages
  std::vector<Node> nodes;
  std::vector<Bone> bones;
  Surface surface;  // all meshes, concatenated
  std::vector<std::uint32_t> influence_begin;  // per vertex, into influences; one more at the end
  std::vector<Influence> influences;           // normalised: weights of a vertex sum to 1
  std::vector<MeshPart> meshes;
  std::vector<MorphTarget> morphs;
  std::vector<double> morph_weights;  // default weight of every slot
  std::vector<int> morph_node;        // node whose `weights` channel drives a slot
  std::vector<int> morph_index;       // index of the slot within that node's weights
  std::vector<RigMaterial> materials;  // at least one
  std::vector<EncodedImage> images;
  std::vector<Clip> clips;
  std::vector<std::string> part_names;  // of Surface::parts
  std::vector<std::string> warnings;    // what was mended at load, one sentence each, with counts
  int find_node(std::string_view name) const;  // -1 when absent
  int find_clip(std::string_view name) const;
};

// "vertex 12 of mesh 'Cow'", for messages.
std::string vertex_place(const Rig& rig, std::size_t vertex);

// Turns the whole rig about the model's Z axis, counter-clockwise seen from above. Node indices stay.
void turn_rig(Rig& rig, double yaw_deg);

// Multiplies every length in the rig.
void scale_rig(Rig& rig, double factor);

struct LoadOptions {
  std::optional<int> scene;      // glTF: which scene; the file's default otherwise
  double scale = 1;              // further factor on all lengths
  std::vector<std::string> include_meshes;  // names; default: skinned meshes where any mesh is skinned, else all
};

// Reads .glb, .gltf, .fbx, .dae, .obj by content and extension. Throws InputError with file, place and mend.
Rig load_rig(const std::filesystem::path& file, const LoadOptions& options = {});

// Each in its one file (gltf.cpp, assimp.cpp); load_rig() chooses.
Rig load_gltf(const std::filesystem::path& file, const LoadOptions& options);
Rig load_with_assimp(const std::filesystem::path& file, const LoadOptions& options);

// Writes a .glb that load_gltf() reads back to the same Rig (positions, weights, transforms bit for bit where float
// allows). Throws RunError when the file cannot be written.
void write_glb(const Rig& rig, const std::filesystem::path& file);

// Shared by the loaders: sorts nodes parents first, makes names unique, normalises weights (with a counted warning),
// refuses negative, NaN or all-zero weights naming the vertex, names parts (one per dominant joint when skinned, else
// one per mesh), drops degenerate indices never, checks every index, fills missing normals.
void finish_rig(Rig& rig);

}  // namespace moomill
