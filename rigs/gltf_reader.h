#pragma once
// The state of reading one glTF file. gltf.cpp fills it from any file, gltf_own.cpp from those that write_glb() wrote.
#include <map>
#include <memory>

#include "generator/core/error.h"
#include "rigs/gltf_container.h"
#include "rigs/rig.h"

namespace tinygltf {  // only gltf.cpp knows what these are
class Model;
struct Primitive;
}  // namespace tinygltf

namespace moomill::gltf {

// An accessor as doubles; normalised integers are already in [0, 1] or [-1, 1].
struct Values {
  std::size_t count = 0;
  int width = 0;
  std::vector<double> data;
  const double* operator[](std::size_t i) const { return data.data() + i * width; }
};

struct Reader {
  explicit Reader(const std::filesystem::path& path);

  std::string file;
  Container container;
  std::shared_ptr<tinygltf::Model> parsed;  // what `model` refers to
  tinygltf::Model& model;
  Rig rig;
  std::vector<int> node_of;                  // file node -> rig node, -1 where left out
  std::map<int, std::uint32_t> skin_bones;   // file skin -> first bone
  std::map<int, dmat4> skin_to_model;        // file skin -> what takes its mesh space to model space
  std::map<int, std::uint32_t> rigid_bones;  // file node -> bone
  std::map<int, int> images;                 // file image -> rig image
  std::vector<dmat4> world;                  // of rig nodes, as the file poses them
  std::size_t skipped_primitives = 0, leftover_indices = 0;

  template <class... Args>
  [[noreturn]] void fail(fmt::format_string<Args...> format, Args&&... args) const {
    throw InputError(file + ": " + fmt::format(format, std::forward<Args>(args)...));
  }
  void index_in(int index, std::size_t size, const std::string& who, const char* what) const {
    if (index < 0 || static_cast<std::size_t>(index) >= size)
      fail("{} refers to {} {}, but there are {}, export it again", who, what, index, size);
  }

  // The bytes [offset, offset + size) of a buffer view; checked.
  const std::uint8_t* bytes(int view_index, std::size_t offset, std::size_t size, const std::string& who) const;
  // A whole accessor; `widths` are the numbers per element that make sense for its use.
  Values values(int index, const std::string& what, std::initializer_list<int> widths) const;

  // What gltf_own.cpp needs to know of the document.
  std::size_t node_count() const;
  const std::map<std::string, int>& attributes(int mesh) const;  // of the first primitive
  const std::vector<std::map<std::string, int>>& morph_targets(int mesh) const;
  void retarget_own_channels();

  void parse();
  std::vector<int> scene_roots(const LoadOptions& options) const;
  std::vector<int> reachable(const std::vector<int>& roots) const;
  std::vector<int> parents() const;
  Node convert_node(int i, double matrix_error) const;
  void read_nodes(const std::vector<int>& in_scene);
  void read_skin(int skin);
  std::uint32_t rigid_bone(int node);
  int image(int index);
  template <class Info>
  TextureUse texture(const Info& info, const std::string& material);
  void read_materials();
  void read_mesh(int node);
  std::vector<std::uint32_t> read_triangles(const tinygltf::Primitive& primitive, std::size_t vertices,
                                            const std::string& who);
  void read_primitive(int node, const tinygltf::Primitive& primitive, const std::string& name, int first_slot);
  void read_clips();
  void read_own(const nlohmann::json& own);
  void read_own_mesh(const nlohmann::json& about, int mesh);
};

}  // namespace moomill::gltf
