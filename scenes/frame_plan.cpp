// The poses of an animal, frame by frame.
#include "generator/core/error.h"
#include "generator/core/random.h"
#include "scenes/scene.h"
#include "scenes/words.h"

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

dmat4 translation(const dvec3& t) {
  dmat4 m(1.0);
  m[3] = dvec4(t, 1.0);
  return m;
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
  const dvec3 travel = spec.pose_in_place ? root_travel(species, pose) : dvec3(0);
  const dvec3 position = draw_vector(spec.position, scene.seed, frame, 0);
  const double yaw = draw_number(spec.yaw_deg, scene.seed, frame, 0) * degrees;
  pose.placement = translation(position) * turn_about_z(yaw) * translation(species.standing - travel);
  return pose;
}

}  // namespace moomill
