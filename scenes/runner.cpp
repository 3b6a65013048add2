#include "scenes/runner.h"

#include <list>

#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "generator/core/random.h"
#include "generator/core/stage_times.h"
#include "generator/dataset/codecs.h"
#include "generator/render/labels.h"
#include "scenes/appearance.h"
#include "scenes/breed_file.h"

namespace moomill {
namespace {

// Streams of random numbers of one view.
enum class Stream : std::uint64_t { light = 1, coverage = 2 };

Camera to_camera(const CameraRecord& r) {
  return Camera::from_matrix(r.world_to_camera, r.fx, r.fy, r.cx, r.cy, r.width, r.height);
}

std::uint64_t stream_of(const SceneSpec& s, int frame, int camera, Stream stream) {
  return hash_identity({s.seed, static_cast<std::uint64_t>(frame), static_cast<std::uint64_t>(camera), static_cast<std::uint64_t>(stream)});
}

Surface ground_surface(double size) {
  Surface s;
  const float h = static_cast<float>(0.5 * size);
  s.rest = {{-h, -h, 0}, {h, -h, 0}, {h, h, 0}, {-h, h, 0}};
  s.normals.assign(4, vec3(0, 0, 1));
  s.triangles = {{0, 1, 2}, {0, 2, 3}};
  s.materials.assign(2, 0);
  s.parts.assign(2, 0);
  return s;
}

// Small caches of files by name; scenes draw from lists of a few.
template <class Value>
class FileCache {
 public:
  template <class Load>
  std::shared_ptr<const Value> get(const std::string& key, const Load& load) {
    std::lock_guard lock(mutex_);
    for (auto i = entries_.begin(); i != entries_.end(); ++i)
      if (i->first == key) {
        entries_.splice(entries_.begin(), entries_, i);
        return entries_.front().second;
      }
    entries_.emplace_front(key, load());
    if (entries_.size() > 4) entries_.pop_back();
    return entries_.front().second;
  }

 private:
  std::mutex mutex_;
  std::list<std::pair<std::string, std::shared_ptr<const Value>>> entries_;
};

}  // namespace

struct Mill::Loaded {
  std::vector<std::unique_ptr<Species>> species;  // distinct
  std::vector<const Species*> of_animal;
  std::vector<std::vector<dmat4>> neutral_world;  // per animal
  std::unique_ptr<Wardrobe> wardrobe;
  Surface ground;
  bool traces = false;  // whether any ray is traced at all
  FileCache<Environment> environments;
  FileCache<ImageF> backgrounds;
};

Mill::Mill(SceneSpec spec) : spec_(std::move(spec)), loaded_(std::make_unique<Loaded>()) {
  Loaded& l = *loaded_;
  const auto folder = std::filesystem::path(spec_.file).parent_path();
  if (spec_.animals.empty()) input_error("{}: a scene wants at least one [[animals]]", spec_.file);
  if (animals() > max_animals) input_error("{}: {} animals; at most {} fit in a scene", spec_.file, animals(), max_animals);
  std::map<std::string, const Species*> by_name;
  for (const AnimalSpec& a : spec_.animals) {
    auto [found, fresh] = by_name.try_emplace(a.species, nullptr);
    if (fresh) {
      const StageTimer timer("species");
      l.species.push_back(std::make_unique<Species>(read_species(a.species, spec_.normalization, folder)));
      found->second = l.species.back().get();
      ++counts_.species;
    }
    const Box& neutral = found->second->rig.surface.neutral_box;
    if (!(neutral.diagonal() > 0)) input_error("{}: {} has no area, nothing can be rendered; export it again", spec_.file, found->second->rig.source);
    l.of_animal.push_back(found->second);
    l.neutral_world.push_back(world_transforms(found->second->rig, found->second->neutral));
  }
  const ModalitySet& m = spec_.modalities;
  if (m.has(Modality::uv) && species(0).rig.surface.uvs.empty())
    input_error("{}: the modality uv is asked for, but {} has no UVs; leave it out or give the rig UVs", spec_.file, species(0).rig.source);
  l.traces = m.any(&ModalityRow::needs_first_hit) || m.has(Modality::rgb) || m.has(Modality::coverage) || m.has(Modality::keypoints);
  l.wardrobe = std::make_unique<Wardrobe>(spec_, l.of_animal, m.has(Modality::rgb), counts_);
  if (spec_.ground.present) l.ground = ground_surface(spec_.ground.size);
}

Mill::~Mill() = default;

const Species& Mill::species(int animal) const { return *loaded_->of_animal[animal]; }

Manifest Mill::manifest() const {
  Manifest m;
  m.species = species(0).name;
  m.subset = spec_.subset;
  m.seed = spec_.seed;
  m.scene = spec_.resolved;
  // What the files behind the scene's names hold: a dataset is not continued with another cow or coat under an old name.
  const auto folder = std::filesystem::path(spec_.file).parent_path();
  const auto hash = [](const std::filesystem::path& file) {
    const auto bytes = read_file(file);
    return xxh64_hex(bytes.data(), bytes.size());
  };
  for (const AnimalSpec& a : spec_.animals) {
    m.scene["file_hashes"][a.species] = hash(find_species(a.species, folder));
    if (!spec_.modalities.has(Modality::rgb)) continue;
    if (const auto file = find_finish(a.species); !file.empty())
      m.scene["file_hashes"][fmt::format("finish of {}", a.species)] = hash(file);
    for (std::size_t i = 0; i < a.coats.size(); ++i) {
      const Individual* one = a.individual(i);
      const std::string key = one ? "breed " + one->breed : a.coats[i];
      if (m.scene["file_hashes"].contains(key)) continue;
      const auto file = one ? find_breed(one->breed, find_species(a.species, folder).stem().string(), folder)
                            : find_coat(a.coats[i], a.species, folder);
      if (!file.empty()) m.scene["file_hashes"][key] = hash(file);
    }
  }
  m.per_frame_cameras = cameras_vary(spec_);
  m.cameras = cameras_of_frame(spec_, spec_.frames.empty() ? spec_.first_frame : spec_.frames.front());
  m.coats = spec_.animals[0].coats;
  if (m.coats.empty()) m.coats = {"own"};
  m.coat_indices = spec_.coat_indices;
  m.individuals = spec_.animals[0].individuals;
  for (int a = 0; a < animals(); ++a) {
    m.animals.push_back(species(a).name);
    m.rig_files.push_back(fmt::format("rigs/{}.glb", a));
  }
  const Species& s = species(0);
  for (const Keypoint& k : s.keypoints) {
    m.keypoint_names.push_back(k.name);
    m.keypoint_tolerance.push_back(k.tolerance);
  }
  m.skeleton = s.edges;
  m.pairs = s.pairs;
  m.part_names = s.rig.part_names;
  m.frames = spec_.frames;
  m.modalities = spec_.modalities;
  m.nnopcs_lower = s.rig.surface.neutral_box.lower;
  m.nnopcs_upper = s.rig.surface.neutral_box.upper;
  m.nnopcs_normalization = spec_.normalization == NnopcsNormalization::box ? "box" : "diagonal";
  m.skinning = s.skinning == SkinningMethod::linear_blend ? "linear_blend" : "dual_quaternion";
  m.reader_radius = s.reader_radius;
  return m;
}

Frame Mill::prepare(int frame) const {
  set_float_state();
  const Loaded& l = *loaded_;
  Frame f;
  f.number = frame;
  f.cameras = cameras_of_frame(spec_, frame);

  auto g = std::make_shared<FrameGeometry>();
  std::vector<std::vector<dmat4>> world(animals());
  for (int a = 0; a < animals(); ++a) {
    const Species& s = species(a);
    const Pose pose = pose_of_frame(spec_, spec_.animals[a], s, frame - spec_.first_frame);
    world[a] = world_transforms(s.rig, pose);
    g->bones.push_back(bone_matrices(s.rig, world[a]));
    g->morph_weights.push_back(pose.morph_weights.empty() ? s.rig.morph_weights : pose.morph_weights);
    g->placement.push_back(pose.placement);
    for (const dmat4& m : g->bones.back())
      for (int c = 0; c < 4; ++c)
        if (!all_finite(m[c])) input_error("{}: frame {} of {} has a pose that is not finite; look at its clip or pose file", spec_.file, frame, s.name);
  }
  // A rigid scene, or one pose for many frames: nothing to skin or build again.
  {
    std::lock_guard lock(mutex_);
    if (last_geometry_ && last_geometry_->bones == g->bones && last_geometry_->morph_weights == g->morph_weights) {
      f.geometry = last_geometry_;
      return f;
    }
  }
  Scene& scene = g->scene;
  // Positions are float relative to here; rounded, so that a standing animal's coordinates stay round.
  const dmat4& first = g->placement[0];
  scene.origin = glm::round(dvec3(first[3]));
  scene.animal_count = animals();
  scene.appearance = l.wardrobe->bare();
  for (int a = 0; a < animals(); ++a) {
    const Species& s = species(a);
    Instance in;
    in.surface = &s.rig.surface;
    const StageTimer timer("skin");
    in.posed = skin(s.rig, g->bones[a], g->morph_weights[a], s.skinning, scene.origin);
    ++counts_.skins;
    Box posed;
    bool finite = true;
    for (const vec3& v : in.posed.positions) {
      finite = finite && all_finite(v);
      posed.add(dvec3(v));
    }
    const double size = posed.diagonal(), neutral = s.rig.surface.neutral_box.diagonal();
    if (!finite || !(size > 1e-3 * neutral) || !(size < 1e3 * neutral))
      input_error("{}: frame {} tears or flattens {} ({:.3g} m across, {:.3g} m in the neutral pose); look at its clip or pose file",
                  spec_.file, frame, s.name, size, neutral);
    in.materials = l.wardrobe->materials()[a];
    in.animal = a;
    g->keypoints.push_back(keypoint_positions(s, world[a], l.neutral_world[a], in.posed));
    scene.instances.push_back(std::move(in));
  }
  if (spec_.ground.present) {
    Instance in;
    in.surface = &l.ground;
    in.posed.origin = scene.origin;
    for (const vec3& p : l.ground.rest) in.posed.positions.push_back(vec3(dvec3(p) - dvec3(0, 0, scene.origin.z)));
    in.posed.normals = l.ground.normals;
    in.materials = {l.wardrobe->ground_material()};
    scene.instances.push_back(std::move(in));
  }
  if (l.traces) {
    const StageTimer timer("hierarchy");
    g->accel = std::make_unique<Accel>(scene);
    ++counts_.hierarchies;
  }
  if (g->accel && batches() > 0) {
    const StageTimer timer("light");
    g->sky = sky_shares(scene, *g->accel);
  }
  f.geometry = g;
  std::lock_guard lock(mutex_);
  last_geometry_ = g;
  return f;
}

Lights Mill::lights(const Frame& frame, const CameraRecord& camera) const {
  const LightSpec& spec = spec_.light;
  const int f = frame.number, c = camera.id;
  auto number = [&](const Distribution& d) { return draw_number(d, spec_.seed, f, c); };
  auto vector = [&](const Distribution& d) { return draw_vector(d, spec_.seed, f, c); };
  Lights lights;
  if (spec.environment_file) {
    const std::string name = draw_text(*spec.environment_file, spec_.seed, f, c);
    const double strength = number(spec.environment_strength), yaw = number(spec.environment_yaw_deg);
    const StageTimer timer("environment");
    lights.environment = loaded_->environments.get(fmt::format("{}|{}|{}", name, strength, yaw), [&] {
      ++counts_.environments;
      const auto path = find_file(name, std::filesystem::path(spec_.file).parent_path());
      return std::make_shared<const Environment>(read_imagef(path), path.string(), static_cast<float>(strength), yaw * degrees);
    });
  } else {
    lights.environment = std::make_shared<Environment>(vec3(vector(spec.environment_color) * number(spec.environment_strength)));
  }
  for (const LightSpec::Sun& s : spec.suns) {
    const double azimuth = number(s.azimuth_deg) * degrees, elevation = number(s.elevation_deg) * degrees;
    Sun sun;
    sun.direction = glm::normalize(vec3(std::cos(elevation) * std::cos(azimuth), std::cos(elevation) * std::sin(azimuth), std::sin(elevation)));
    sun.irradiance = vec3(number(s.irradiance) * vector(s.color));
    sun.angular_radius = static_cast<float>(0.5 * number(s.angular_diameter_deg) * degrees);
    lights.suns.push_back(sun);
  }
  const dvec3 origin = frame.geometry->scene.origin;
  for (const LightSpec::Rectangle& r : spec.rectangles) {
    const dvec3 position = vector(r.position), target = vector(r.target);
    const dvec3 toward = target - position;
    if (!(glm::length(toward) > 1e-9)) input_error("{}: a rectangular light stands at its own target in frame {}; move one of them", spec_.file, f);
    const dvec3 n = glm::normalize(toward);
    const dvec3 x = glm::normalize(glm::cross(std::abs(n.z) > 0.99 ? dvec3(0, 1, 0) : dvec3(0, 0, 1), n));
    const dvec3 y = glm::cross(n, x);
    RectangleLight light;
    light.edge_u = vec3(x * r.width);
    light.edge_v = vec3(y * r.height);
    light.corner = vec3(position - origin - 0.5 * r.width * x - 0.5 * r.height * y);
    light.radiance = vec3(number(r.radiance) * vector(r.color));
    lights.rectangles.push_back(light);
  }
  const Box& box = frame.geometry->accel->bounds(true);
  lights.prepare(box.empty() ? vec3(0) : vec3(box.centre()));
  return lights;
}

// Puts the scene's background behind every coat, where it gives one.
void Mill::composite(View& view, const CameraRecord& camera) const {
  const BackgroundSpec& b = spec_.background;
  if (b.kind != BackgroundSpec::Kind::color && b.kind != BackgroundSpec::Kind::image) return;
  const dvec3 color = draw_vector(b.color, spec_.seed, view.frame, camera.id);
  std::shared_ptr<const ImageF> image;
  if (b.kind == BackgroundSpec::Kind::image && b.image) {
    const std::string name = draw_text(*b.image, spec_.seed, view.frame, camera.id);
    image = loaded_->backgrounds.get(name, [&] {
      ++counts_.images;
      return std::make_shared<const ImageF>(read_imagef(find_file(name, std::filesystem::path(spec_.file).parent_path())));
    });
  }
  // An image covers the view: scaled to fill it, cropped in the middle.
  const double scale = image ? std::min(image->width / double(view.width), image->height / double(view.height)) : 0;
  for (Map& map : view.maps) {
    if (map.modality != Modality::rgb) continue;
    for (int y = 0; y < view.height; ++y)
      for (int x = 0; x < view.width; ++x) {
        float* p = &map.f.data[map.f.index(x, y)];
        vec3 behind(color);
        if (image) {
          const double sx = 0.5 * image->width + (x + 0.5 - 0.5 * view.width) * scale - 0.5;
          const double sy = 0.5 * image->height + (y + 0.5 - 0.5 * view.height) * scale - 0.5;
          const int x0 = std::clamp(int(std::floor(sx)), 0, image->width - 1), x1 = std::min(x0 + 1, image->width - 1);
          const int y0 = std::clamp(int(std::floor(sy)), 0, image->height - 1), y1 = std::min(y0 + 1, image->height - 1);
          const auto fx = static_cast<float>(std::clamp(sx - x0, 0.0, 1.0)), fy = static_cast<float>(std::clamp(sy - y0, 0.0, 1.0));
          for (int k = 0; k < 3; ++k) {
            const int c = std::min(k, image->channels - 1);
            behind[k] = (image->at(x0, y0, c) * (1 - fx) + image->at(x1, y0, c) * fx) * (1 - fy) +
                        (image->at(x0, y1, c) * (1 - fx) + image->at(x1, y1, c) * fx) * fy;
          }
        }
        for (int k = 0; k < 3; ++k) p[k] += (1 - p[3]) * behind[k];
        p[3] = 1;
      }
  }
}

View Mill::trace_labels(const Frame& frame, const CameraRecord& record) const {
  set_float_state();
  const FrameGeometry& g = *frame.geometry;
  const Camera camera = to_camera(record);
  const ModalitySet& wanted = spec_.modalities;
  View view;
  view.frame = frame.number;
  view.camera = record.id;
  view.width = record.width;
  view.height = record.height;
  if (!g.accel) return view;
  const Scene& scene = g.scene;
  const Accel& accel = *g.accel;
  if (camera_is_inside(scene, accel, camera))
    input_error("{}: camera {} stands inside an animal in frame {}; raise the radius or move the camera", spec_.file, record.id, frame.number);

  if (wanted.any(&ModalityRow::needs_first_hit) || wanted.has(Modality::coverage)) {
    const FirstHits hits = [&] {
      const StageTimer timer("first hits");
      return trace_first_hits(scene, accel, camera, footprint(scene, camera, 0));
    }();
    ++counts_.first_hits;
    LabelRequest request;
    request.modalities = wanted;
    if (spec_.subset == Subset::occlusions) request.only_animal = 0;
    add_labels(view, scene, hits, request);
    if (wanted.has(Modality::coverage)) {
      ++counts_.coverage;
      const StageTimer timer("coverage");
      Map map;
      map.modality = Modality::coverage;
      map.f = trace_coverage(scene, accel, camera, hits, stream_of(spec_, frame.number, record.id, Stream::coverage));
      view.maps.push_back(std::move(map));
    }
    if (wanted.has(Modality::occlusion)) {
      ++counts_.occlusion;
      const StageTimer timer("occlusion");
      add_occlusion(view, scene, accel, camera, hits);
    }
  }
  if (wanted.has(Modality::keypoints)) {
    ++counts_.keypoints;
    const StageTimer timer("keypoints");
    for (int a = 0; a < animals(); ++a) {
      std::vector<KeypointView> seen;
      for (std::size_t k = 0; k < g.keypoints[a].size(); ++k)
        seen.push_back(trace_keypoint(scene, accel, camera, a, {g.keypoints[a][k], species(a).keypoints[k].tolerance}));
      view.keypoints.push_back(std::move(seen));
    }
  }
  return view;
}

int Mill::batches() const { return loaded_->wardrobe->batches(); }

std::shared_ptr<const Dressed> Mill::dress(const Frame& frame, int batch) const {
  set_float_state();
  const Wardrobe& wardrobe = *loaded_->wardrobe;
  auto out = std::make_shared<Dressed>();
  out->scene = frame.geometry->scene;
  out->scene.appearance = wardrobe.dress(batch);
  out->coats = wardrobe.batch(batch);
  if (spec_.ground.present) {  // colour and roughness may be drawn per frame
    auto a = std::make_shared<Appearance>(*out->scene.appearance);
    Material& m = a->materials[wardrobe.ground_material()];
    m.roughness = static_cast<float>(draw_number(spec_.ground.roughness, spec_.seed, frame.number, 0));
    auto paint = std::make_shared<Paint>();
    paint->coats.assign(a->coat_count, {vec3(draw_vector(spec_.ground.color, spec_.seed, frame.number, 0)), -1, false});
    a->paints[m.paint] = std::move(paint);
    out->scene.appearance = std::move(a);
  }
  if (spec_.render.surface_light) {
    const StageTimer timer("light");
    out->light = std::make_shared<SurfaceLight>(gather_light(out->scene, lights(frame, frame.cameras.at(0)), *frame.geometry->accel));
  }
  return out;
}

PathOptions Mill::path_options(const Frame& frame, const CameraRecord& record, const Dressed& dressed, const Resampling& resampling) const {
  PathOptions options;
  options.samples = resampling.samples > 0 ? resampling.samples : spec_.render.samples;
  if (resampling.samples <= 0) options.target_error = resampling.target_error > 0 ? resampling.target_error : spec_.render.target_error;
  options.max_bounces = spec_.render.max_bounces;
  options.filter_radius = spec_.render.filter_radius;
  if (!frame.geometry->sky.empty()) options.sky = &frame.geometry->sky;
  if (!resampling.paths_only) options.light = dressed.light.get();
  options.environment_visible = spec_.background.kind == BackgroundSpec::Kind::environment;
  options.stream = stream_of(spec_, frame.number, record.id, Stream::light);
  if (resampling.repetition != 0) options.stream = hash_identity({options.stream, resampling.repetition});
  return options;
}

PixelMask Mill::lit_pixels(const Frame& frame, const CameraRecord& record) const {
  const Camera camera = to_camera(record);
  if (spec_.background.kind != BackgroundSpec::Kind::environment && !spec_.ground.present)
    return footprint(frame.geometry->scene, camera, spec_.render.filter_radius);
  PixelMask mask(camera.width, camera.height);
  mask.fill();
  return mask;
}

double Mill::chosen_samples(const Frame& frame, const CameraRecord& record, const Dressed& dressed) const {
  set_float_state();
  const Camera camera = to_camera(record);
  return mean_chosen_samples(dressed.scene, lights(frame, record), *frame.geometry->accel, camera, lit_pixels(frame, record),
                             path_options(frame, record, dressed, {}));
}

View Mill::trace_coats(const Frame& frame, const CameraRecord& record, const Dressed& dressed, const Resampling& resampling) const {
  set_float_state();
  ++counts_.radiance;
  const StageTimer timer("light");
  const Camera camera = to_camera(record);
  View view;
  view.frame = frame.number;
  view.camera = record.id;
  view.width = record.width;
  view.height = record.height;
  const PathOptions options = path_options(frame, record, dressed, resampling);
  const PixelMask mask = lit_pixels(frame, record);
  Radiance radiance = trace_radiance(dressed.scene, lights(frame, record), *frame.geometry->accel, camera, mask, options);
  view.samples = static_cast<double>(radiance.paths) / static_cast<double>(std::max<std::uint64_t>(1, mask.count()));
  for (std::size_t t = 0; t < radiance.coats.size(); ++t) {
    Map map;
    map.modality = Modality::rgb;
    map.coat = dressed.coats[t];
    map.f = std::move(radiance.coats[t]);
    view.maps.push_back(std::move(map));
  }
  composite(view, record);
  return view;
}

View Mill::trace(const Frame& frame, const CameraRecord& camera) const {
  View view = trace_labels(frame, camera);
  if (!frame.geometry->accel) return view;
  for (int b = 0; b < batches(); ++b) {
    View pictures = trace_coats(frame, camera, *dress(frame, b));
    view.background = pictures.background;
    std::move(pictures.maps.begin(), pictures.maps.end(), std::back_inserter(view.maps));
  }
  return view;
}

FrameRecord Mill::record(const Frame& frame) const {
  const FrameGeometry& g = *frame.geometry;
  FrameRecord r;
  r.frame = frame.number;
  r.keypoints = g.keypoints;
  r.bones = g.bones;
  r.placement = g.placement;
  r.morph_weights = g.morph_weights;
  for (int a = 0; a < animals(); ++a) {
    std::vector<std::string> names;
    for (const Bone& b : species(a).rig.bones) names.push_back(species(a).rig.nodes[b.node].name);
    r.bone_names.push_back(std::move(names));
  }
  if (cameras_vary(spec_)) r.cameras = frame.cameras;
  std::vector<int> ids;
  for (const CameraRecord& c : frame.cameras) ids.push_back(c.id);
  r.drawn = drawn_values(spec_, frame.number, ids);
  return r;
}

}  // namespace moomill
