// The poses of an animal, frame by frame.
#include "generator/core/error.h"
#include "generator/core/random.h"
#include "scenes/scene.h"
#include "generator/core/words.h"

namespace moomill {
namespace {

int count_of(const PoseSource& source) {
  if (const auto* clip = std::get_if<ClipFrames>(&source)) return clip->count;
  if (const auto* file = std::get_if<PoseFile>(&source)) return file->poses ? static_cast<int>(file->poses->size()) : 0;
  return std::get<PoseSampler>(source).count;
}

const Clip* find_clip_or_refuse(const SceneSpec& scene, const Species& species, const std::string& name) {
  const std::vector<Clip>& clips = species.rig.clips;
  if (name.empty()) return clips.empty() ? nullptr : &clips[0];
  const int index = species.rig.find_clip(name);
  if (index >= 0) return &clips[index];
  std::vector<std::string> names;
  for (const Clip& c : clips) names.push_back(c.name);
  input_error("{}: {} has no clip '{}'{}", scene.file, species.rig.source, name,
              names.empty() ? "; it has no clips at all, use {random = 100}" : suggestion(name, names));
}

Pose pose_from_clip(const SceneSpec& scene, const ClipFrames& source, const Species& species, int index) {
  const Clip* clip = find_clip_or_refuse(scene, species, source.clip);
  if (!clip) return species.neutral;
  return sample_clip(species.rig, *clip, clip->duration * index / source.count);
}

// How far the pose has moved the root joint horizontally from where the neutral pose has it, in model space.
dvec3 root_travel(const Species& species, const Pose& pose) {
  if (species.rig.bones.empty()) return dvec3(0);
  int root = species.rig.bones[0].node;  // parents come before children: the least index is a topmost joint
  for (const Bone& b : species.rig.bones) root = std::min(root, b.node);
  Pose here = pose, neutral = species.neutral;
  here.placement = neutral.placement = dmat4(1.0);
  const dvec3 moved =
      dvec3(world_transforms(species.rig, here)[root][3]) - dvec3(world_transforms(species.rig, neutral)[root][3]);
  return {moved.x, moved.y, 0};
}

// What a clip's topmost joint has advanced by, evenly, at a frame of it.
dvec3 even_advance(const SceneSpec& scene, const ClipFrames& source, const Species& species, int index) {
  const Clip* clip = find_clip_or_refuse(scene, species, source.clip);
  if (!clip) return dvec3(0);
  const dvec3 way = root_travel(species, sample_clip(species.rig, *clip, clip->duration)) -
                    root_travel(species, sample_clip(species.rig, *clip, 0));
  return way * (static_cast<double>(index) / source.count);
}

LocalTransform rest_of(const Node& node) {
  return {node.translation, node.rotation, node.scale};
}

Pose pose_from_json(const Json& json, const Species& species) {
  Pose pose = species.neutral;
  pose.local.resize(species.rig.nodes.size());
  for (const auto& [name, parts] : json.items()) {
    const int node = find_joint(species.rig, name);
    LocalTransform t = pose.local[node].value_or(rest_of(species.rig.nodes[node]));
    auto vector = [&](const char* key, dvec3& out) {
      if (!parts.contains(key)) return;
      for (int i = 0; i < 3; ++i) out[i] = parts[key][i].get<double>();
    };
    vector("translation", t.translation);
    vector("scale", t.scale);
    if (parts.contains("rotation")) {
      const Json& q = parts["rotation"];  // x, y, z, w as in glTF
      t.rotation =
          glm::normalize(dquat(q[3].get<double>(), q[0].get<double>(), q[1].get<double>(), q[2].get<double>()));
    }
    pose.local[node] = t;
  }
  return pose;
}

// Uniform numbers for the limits' three axes each. `spread` draws them in towards no rotation at all, which need not
// be the middle of the limits.
std::vector<double> uniforms_for(const SceneSpec& scene, const AnimalSpec& spec, const Species& species, double spread,
                                 int frame_index) {
  std::vector<double> u;
  const std::uint64_t identity =
      hash_identity({scene.seed, hash_text(spec.key + ".poses"), static_cast<std::uint64_t>(frame_index)});
  for (std::size_t i = 0; i < species.limits.size(); ++i)
    for (int axis = 0; axis < 3; ++axis) {
      const double lower = species.limits[i].sampled_lower()[axis], upper = species.limits[i].sampled_upper()[axis];
      const double rest = upper > lower ? std::clamp(-lower / (upper - lower), 0.0, 1.0) : 0.5;
      u.push_back(rest + spread * (to_unit(hash_identity({identity, 3 * i + axis})) - rest));
    }
  return u;
}

dmat4 translation(const dvec3& t) {
  dmat4 m(1.0);
  m[3] = dvec4(t, 1.0);
  return m;
}

// Puts a posed animal down on z = `floor`: the plane that touches it from below at three points around its middle
// becomes level (by `steepest` at most, so that an odd pose does not lie down), then the lowest point is lowered onto the
// floor. Of all planes below the surface that one is highest under the middle; its height there is a concave function
// of the two slopes, so ternary searches within one another find it.
dmat4 put_down(const Species& species, const Pose& pose, double floor) {
  constexpr double steepest = 6 * degrees;
  Pose here = pose;
  here.placement = dmat4(1.0);
  const PosedSurface surface =
      skin(species.rig, bone_matrices(species.rig, world_transforms(species.rig, here)), pose.morph_weights,
           species.skinning, dvec3(0));
  Box box;
  for (const vec3& p : surface.positions) box.add(dvec3(p));
  const dvec3 middle(box.centre().x, box.centre().y, 0);
  std::vector<dvec3> low;  // those that a plane within the slopes can touch first
  const double reach = std::tan(steepest) * 2 * std::hypot(box.size().x, box.size().y);
  for (const vec3& p : surface.positions)
    if (p.z < box.lower.z + reach) low.push_back(dvec3(p) - middle);
  const auto height = [&](double along_x, double along_y) {
    double h = std::numeric_limits<double>::infinity();
    for (const dvec3& p : low) h = std::min(h, p.z - along_x * p.x - along_y * p.y);
    return h;
  };
  const auto highest = [](const auto& f, double reach_of_slope) {
    double a = -reach_of_slope, b = reach_of_slope;
    for (int i = 0; i < 26; ++i) {  // to 5 microradians
      const double c = a + (b - a) / 3, d = b - (b - a) / 3;
      if (f(c) < f(d))
        a = c;
      else
        b = d;
    }
    return 0.5 * (a + b);
  };
  const double slope = std::tan(steepest);
  const auto best_y = [&](double x) { return highest([&](double y) { return height(x, y); }, slope); };
  const double along_x = highest([&](double x) { return height(x, best_y(x)); }, slope), along_y = best_y(along_x);
  const dvec3 up = glm::normalize(dvec3(-along_x, -along_y, 1));
  const dvec3 axis = glm::cross(up, dvec3(0, 0, 1));
  dmat4 tilt(1.0);
  if (glm::length(axis) > 1e-12)
    tilt = glm::mat4_cast(glm::angleAxis(std::asin(std::min(1.0, glm::length(axis))), glm::normalize(axis)));
  tilt = translation(middle) * tilt * translation(-middle);
  double lowest = std::numeric_limits<double>::infinity();
  for (const vec3& p : surface.positions) lowest = std::min(lowest, transform_point(tilt, dvec3(p)).z);
  return translation({0, 0, floor - lowest}) * tilt;
}

dmat4 turn_about_z(double angle) {
  dmat4 m(1.0);
  m[0][0] = m[1][1] = std::cos(angle);
  m[0][1] = std::sin(angle);
  m[1][0] = -m[0][1];
  return m;
}

}  // namespace

int find_joint(const Rig& rig, const std::string& reference) {
  const int count = static_cast<int>(rig.nodes.size());
  const int named = rig.find_node(reference);
  if (named >= 0) return named;
  const bool digits = reference.size() > 1 && reference.size() < 9 && reference[0] == '#' &&
                      reference.find_first_not_of("0123456789", 1) == std::string::npos;
  if (digits) {
    const int index = std::stoi(reference.substr(1));
    if (index < count) return index;
    input_error("{} has no joint {}; its joints are #0 to #{}", rig.source, reference, count - 1);
  }
  std::vector<std::string> names;
  for (const Node& n : rig.nodes) names.push_back(n.name);
  const std::string near = nearest_word(reference, names);
  const std::string hint =
      near.empty() ? "; `moomill rig info` lists its joints" : fmt::format("; did you mean '{}'?", near);
  input_error("{} has no joint '{}'{}", rig.source, reference, hint);
}

int pose_count(const AnimalSpec& spec, const Species&) {
  int n = 0;
  for (const PoseSource& p : spec.poses) n += count_of(p);
  return n;
}

Pose pose_of_frame(const SceneSpec& scene, const AnimalSpec& spec, const Species& species, int frame_index) {
  const int count = pose_count(spec, species);
  int index = count == 1 ? 0 : frame_index;  // a single pose holds for all frames
  if (index < 0 || index >= count)
    input_error("{}: frame {} needs {} poses, but [{}] has {}; ask for fewer frames or add poses", scene.file,
                scene.first_frame + frame_index, frame_index + 1, spec.key, count);
  const PoseSource* source = nullptr;
  for (const PoseSource& p : spec.poses) {
    source = &p;
    if (index < count_of(p)) break;
    index -= count_of(p);
  }
  Pose pose;
  if (const auto* clip = std::get_if<ClipFrames>(source))
    pose = pose_from_clip(scene, *clip, species, index);
  else if (const auto* file = std::get_if<PoseFile>(source))
    pose = pose_from_json((*file->poses)[index], species);
  else
    pose = sample_within_limits(species,
                                uniforms_for(scene, spec, species, std::get<PoseSampler>(*source).spread, frame_index));
  const int frame = scene.first_frame + frame_index;
  dvec3 travel = spec.pose_in_place ? root_travel(species, pose) : dvec3(0);
  if (const auto* clip = std::get_if<ClipFrames>(source); clip && clip->treadmill && !spec.pose_in_place)
    travel = even_advance(scene, *clip, species, index);
  dmat4 ground(1.0);
  if (const auto* sampler = std::get_if<PoseSampler>(source); sampler && sampler->on_ground)
    ground = put_down(species, pose, -species.standing.z);
  const dvec3 position = draw_vector(spec.position, scene.seed, frame, 0);
  const double yaw = draw_number(spec.yaw_deg, scene.seed, frame, 0) * degrees;
  pose.placement = translation(position) * turn_about_z(yaw) * translation(species.standing - travel) * ground;
  return pose;
}

}  // namespace moomill
