#include "generator/core/error.h"
#include "generator/dataset/codecs.h"
#include "generator/dataset/json.h"
#include "validate/studies/crosscheck.h"

namespace moomill {
namespace {

namespace fs = std::filesystem;

class Folder {
 public:
  explicit Folder(fs::path path) : path_(std::move(path)) {}
  // The name under which the values lie, or null where there are none.
  template <class T>
  Json write(const std::string& name, const std::vector<T>& values) const {
    static_assert(std::is_trivially_copyable_v<T>);
    if (values.empty()) return nullptr;
    write(name, values.data(), values.size() * sizeof(T));
    return name;
  }
  void write(const std::string& name, const void* data, std::size_t size) const {
    write_file_atomically(path_ / name, data, size);
    written_ += name + " " + xxh64_hex(data, size) + "\n";
  }
  std::string hash() const { return xxh64_hex(written_.data(), written_.size()); }

 private:
  fs::path path_;
  mutable std::string written_;  // names and hashes, in order
};

Json vec_json(const vec3& v) { return {v.x, v.y, v.z}; }

const char* name_of(Wrap wrap) {
  switch (wrap) {
    case Wrap::clamp: return "clamp";
    case Wrap::mirror: return "mirror";
    case Wrap::repeat: break;
  }
  return "repeat";
}

// Textures as they are added to the file.
class TextureList {
 public:
  explicit TextureList(const Folder& folder) : folder_(folder) {}
  Json list = Json::array();

  int add(const Image8& image, const TexturePlacement& p) {
    if (p.wrap_u != p.wrap_v)
      input_error("crosscheck: a texture goes on beyond its border in one way along u and in another along v, which Blender cannot; give both one wrap mode");
    const int index = static_cast<int>(list.size());
    list.push_back({{"file", folder_.write(fmt::format("texture{}.u8", index), image.data)},
                    {"width", image.width},
                    {"height", image.height},
                    {"channels", image.channels},
                    {"wrap", name_of(p.wrap_u)},
                    {"placement", {{"offset", {p.offset.x, p.offset.y}}, {"scale", {p.scale.x, p.scale.y}}, {"rotation", p.rotation}}}});
    return index;
  }

 private:
  const Folder& folder_;
};

Json paint_json(const Paint& paint, const Appearance& appearance, const std::vector<int>& exported, TextureList& textures) {
  Json coats = Json::array();
  const int n = static_cast<int>(paint.coats.size());
  for (int t = 0; t < n; ++t) {
    const Paint::PerCoat& coat = paint.coats[t];
    if (paint.stack.empty()) {
      coats.push_back({{"factor", vec_json(coat.factor)}, {"texture", coat.texture >= 0 ? exported[coat.texture] : -1}, {"vertex_colors", coat.vertex_colors}});
      continue;
    }
    Image8 image(paint.stack_width, paint.stack_height, 3);
    for (std::size_t i = 0; i < image.data.size(); ++i) image.data[i] = paint.stack[i * n + t];
    coats.push_back({{"factor", {1, 1, 1}}, {"texture", textures.add(image, paint.stack_placement)}, {"vertex_colors", false}});
  }
  check(static_cast<int>(appearance.coat_count) == n, "a paint has a colour for every coat");
  return coats;
}

Json lights_json(const Lights& lights, const Folder& folder, std::vector<const Environment*>& maps) {
  Json j;
  const Environment& e = *lights.environment;
  j["environment"] = {{"constant", vec_json(e.mean_radiance())}, {"map", nullptr}, {"yaw_rad", 0.0}};
  if (e.is_map()) {
    const auto found = std::find(maps.begin(), maps.end(), &e);
    const std::string name = fmt::format("environment{}.f32", found - maps.begin());
    if (found == maps.end()) {
      maps.push_back(&e);
      folder.write(name, e.map().data);
    }
    j["environment"]["map"] = {{"file", name}, {"width", e.map().width}, {"height", e.map().height}};
    j["environment"]["yaw_rad"] = e.yaw_rad();
  }
  j["suns"] = Json::array();
  for (const Sun& s : lights.suns)
    j["suns"].push_back({{"direction", vec_json(s.direction)}, {"irradiance", vec_json(s.irradiance)}, {"angular_radius_rad", s.angular_radius}});
  j["rectangles"] = Json::array();
  for (const RectangleLight& r : lights.rectangles)
    j["rectangles"].push_back({{"corner", vec_json(r.corner)}, {"edge_u", vec_json(r.edge_u)}, {"edge_v", vec_json(r.edge_v)}, {"radiance", vec_json(r.radiance)}});
  return j;
}

}  // namespace

std::string export_crosscheck(const Mill& mill, const Frame& frame, const Dressed& dressed, const fs::path& path) {
  const Folder folder(path);
  const Scene& scene = dressed.scene;
  const Appearance& appearance = *scene.appearance;
  const SceneSpec& spec = mill.spec();
  Json j;
  j["schema"] = "moomill crosscheck 1";
  j["frame"] = frame.number;
  j["origin"] = vector_to_json(scene.origin);
  j["filter_radius"] = spec.render.filter_radius;
  j["max_bounces"] = spec.render.max_bounces;
  j["environment_visible"] = spec.background.kind == BackgroundSpec::Kind::environment;
  j["coats"] = dressed.coats;

  j["cameras"] = Json::array();
  std::vector<std::shared_ptr<const Environment>> alive;  // so that addresses tell maps apart
  std::vector<const Environment*> maps;
  for (const CameraRecord& c : frame.cameras) {
    // In double here: Blender keeps floats, which far from the world's origin would move the camera.
    Json m = Json::array();
    for (int r = 0; r < 3; ++r) {
      const double* w = &c.world_to_camera[4 * r];
      m.insert(m.end(), {w[0], w[1], w[2], w[0] * scene.origin.x + w[1] * scene.origin.y + w[2] * scene.origin.z + w[3]});
    }
    const Lights lights = mill.lights(frame, c);
    alive.push_back(lights.environment);
    j["cameras"].push_back({{"id", c.id}, {"width", c.width}, {"height", c.height}, {"fx", c.fx}, {"fy", c.fy}, {"cx", c.cx}, {"cy", c.cy},
                            {"world_to_camera", m}, {"lights", lights_json(lights, folder, maps)}});
  }

  TextureList textures(folder);
  std::vector<int> exported;
  for (const auto& t : appearance.textures) exported.push_back(textures.add(t->image, t->placement));
  j["paints"] = Json::array();
  for (const auto& p : appearance.paints) j["paints"].push_back(paint_json(*p, appearance, exported, textures));
  j["textures"] = textures.list;
  j["materials"] = Json::array();
  auto texture = [&](int index) { return index < 0 ? -1 : exported[index]; };
  for (const Material& m : appearance.materials)
    j["materials"].push_back({{"roughness", m.roughness}, {"metallic", m.metallic}, {"metallic_roughness_texture", texture(m.metallic_roughness_texture)},
                              {"normal_texture", texture(m.normal_texture)}, {"normal_scale", m.normal_scale}, {"alpha_texture", texture(m.alpha_texture)},
                              {"alpha", m.alpha}, {"alpha_cutoff", m.alpha_cutoff}, {"paint", m.paint}});

  j["instances"] = Json::array();
  for (std::size_t i = 0; i < scene.instances.size(); ++i) {
    const Instance& in = scene.instances[i];
    const Surface& s = *in.surface;
    auto name = [&](const char* what) { return fmt::format("instance{}.{}", i, what); };
    j["instances"].push_back({{"animal", in.animal}, {"vertices", in.posed.positions.size()}, {"triangles", s.triangles.size()}, {"materials", in.materials},
                              {"positions", folder.write(name("positions.f32"), in.posed.positions)}, {"normals", folder.write(name("normals.f32"), in.posed.normals)},
                              {"uvs", folder.write(name("uvs.f32"), s.uvs)}, {"colors", folder.write(name("colors.f32"), s.colors)},
                              {"nnopcs", folder.write(name("nnopcs.f32"), s.nnopcs)}, {"faces", folder.write(name("faces.u32"), s.triangles)},
                              {"face_materials", folder.write(name("face_materials.u16"), s.materials)}, {"parts", folder.write(name("parts.u16"), s.parts)}});
  }
  const std::string text = dump_json(j);
  folder.write("scene.json", text.data(), text.size());
  return folder.hash();
}

Dressed with_surface(const Dressed& dressed, CheckedSurface surface) {
  Dressed out = dressed;
  if (surface == CheckedSurface::full) return out;
  auto appearance = std::make_shared<Appearance>(*dressed.scene.appearance);
  for (Material& m : appearance->materials) {
    m.specular = 0;
    m.metallic = 0;
    m.normal_texture = -1;
  }
  out.scene.appearance = std::move(appearance);
  return out;
}

const char* name_of(CheckedSurface surface) { return surface == CheckedSurface::diffuse ? "diffuse" : "full"; }

}  // namespace moomill
