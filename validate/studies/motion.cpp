#include "validate/studies/motion.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <numeric>

#include "generator/core/error.h"
#include "generator/core/parallel.h"

namespace moomill {
namespace {

// The vertices that move with a foot, or with what hangs on it, more than with anything else.
struct Foot {
  int node = 0;
  std::vector<std::uint32_t> vertices;
};

struct ClipSamples {
  std::vector<double> times;                  // seconds
  std::vector<std::vector<vec3>> positions;   // per time, model space, metres, standing on z = 0
};

struct ClipResult {
  std::string name;
  bool planned = false;
  double bearing = 0;      // mean share of the time a foot bears weight
  double off_ground = 0;   // metres, worst height of the lowest point of a bearing foot, either way
  double slip = 0;         // metres, worst of one stance
  double below = 0;        // metres, deepest point of the whole mesh
  double closure = 0;      // metres, furthest vertex between start and end of a loop
  int beyond = 0;          // joint angles out of limits, samples times joints
  double excess_deg = 0;   // the worst of them
  double speed = 0;        // m/s over the ground
  std::string worst_joint, deepest_joint;
  double deepest_at = 0;  // seconds
};

double model_height(const Species& s) {
  return s.rig.surface.neutral_box.size().z;
}

std::vector<int> dominant_nodes(const Rig& rig) {
  std::vector<int> out;
  for (std::size_t v = 0; v + 1 < rig.influence_begin.size(); ++v) {
    const auto first = rig.influences.begin() + rig.influence_begin[v],
               last = rig.influences.begin() + rig.influence_begin[v + 1];
    const auto most = std::max_element(first, last, [](const Influence& a, const Influence& b) {
      return a.weight < b.weight;
    });
    out.push_back(most == last ? -1 : rig.bones[most->bone].node);
  }
  return out;
}

std::vector<vec3> posed(const Species& s, const Pose& pose) {
  Pose here = pose;
  here.placement = dmat4(1.0);
  here.placement[3] = dvec4(s.standing, 1);
  return skin(s.rig, bone_matrices(s.rig, world_transforms(s.rig, here)), here.morph_weights, s.skinning, dvec3(0))
      .positions;
}

Foot foot_of(const Rig& rig, const std::vector<int>& dominant, int node) {
  std::vector<bool> below(rig.nodes.size(), false);
  below[node] = true;
  for (std::size_t j = 0; j < below.size(); ++j)
    if (rig.nodes[j].parent >= 0 && below[rig.nodes[j].parent]) below[j] = true;
  Foot foot{node, {}};
  for (std::uint32_t v = 0; v < dominant.size(); ++v)
    if (dominant[v] >= 0 && below[dominant[v]]) foot.vertices.push_back(v);
  return foot;
}

// Feet of a rig nobody described: the joints whose skin stands on the ground in the neutral pose.
std::vector<Foot> find_feet(const Species& s, const std::vector<int>& dominant) {
  const std::vector<vec3> neutral = posed(s, s.neutral);
  double low = std::numeric_limits<double>::infinity();
  for (const vec3& p : neutral) low = std::min(low, static_cast<double>(p.z));
  std::vector<Foot> feet;
  for (std::uint32_t v = 0; v < neutral.size(); ++v) {
    if (dominant[v] < 0 || neutral[v].z > low + 0.03 * model_height(s)) continue;
    if (std::none_of(feet.begin(), feet.end(), [&](const Foot& f) { return f.node == dominant[v]; }))
      feet.push_back(foot_of(s.rig, dominant, dominant[v]));
  }
  return feet;
}

double lowest(const std::vector<vec3>& positions, const Foot& foot) {
  double low = std::numeric_limits<double>::infinity();
  for (const std::uint32_t v : foot.vertices) low = std::min(low, static_cast<double>(positions[v].z));
  return low;
}

// Mean move of the points of a foot that touch the ground at both times.
std::optional<dvec3> contact_move(const std::vector<vec3>& before, const std::vector<vec3>& after, const Foot& foot,
                                  double thickness) {
  const double low_before = lowest(before, foot), low_after = lowest(after, foot);
  dvec3 sum(0);
  int count = 0;
  for (const std::uint32_t v : foot.vertices)
    if (before[v].z < low_before + thickness && after[v].z < low_after + thickness)
      sum += dvec3(after[v]) - dvec3(before[v]), ++count;
  if (count == 0) return {};
  sum /= count;
  return dvec3(sum.x, sum.y, 0);
}

// When a foot bears weight, as ranges of samples, both ends included.
using Stances = std::vector<std::pair<int, int>>;

Stances planned_stances(const ClipPlan& plan, int node, const std::vector<double>& times) {
  Stances out;
  for (const Contact& c : plan.contacts) {
    if (c.node != node) continue;
    int first = -1, last = -1;
    for (int i = 0; i < static_cast<int>(times.size()); ++i)
      if (times[i] >= c.begin - 1e-9 && times[i] <= c.end + 1e-9) {
        if (first < 0) first = i;
        last = i;
      }
    if (last > first) out.emplace_back(first, last);
  }
  return out;
}

Stances found_stances(const ClipSamples& samples, const Foot& foot, double ground, double thickness) {
  Stances out;
  int first = -1;
  const int n = static_cast<int>(samples.times.size());
  for (int i = 0; i <= n; ++i) {
    const bool down = i < n && lowest(samples.positions[i], foot) < ground + thickness;
    if (down && first < 0) first = i;
    if (!down && first >= 0) {
      if (i - 1 > first) out.emplace_back(first, i - 1);
      first = -1;
    }
  }
  return out;
}

double median(std::vector<double> v) {
  if (v.empty()) return 0;
  std::nth_element(v.begin(), v.begin() + v.size() / 2, v.end());
  return v[v.size() / 2];
}

ClipResult measure_clip(const Species& s, const Clip& clip, const std::vector<int>& dominant, int samples) {
  const auto found = std::find_if(s.clip_plans.begin(), s.clip_plans.end(),
                                  [&](const ClipPlan& p) { return p.clip == clip.name; });
  const ClipPlan* plan = found == s.clip_plans.end() ? nullptr : &*found;
  const double scale = model_height(s) / 1.65;  // bounds are for a cow
  ClipResult r;
  r.name = clip.name;
  r.planned = plan != nullptr;
  ClipSamples shot;
  shot.times.resize(samples + 1);
  shot.positions.resize(samples + 1);
  std::vector<std::vector<JointAngles>> angles(samples + 1);
  parallel_for(samples + 1, 1, [&](std::size_t i) {
    shot.times[i] = clip.duration * i / samples;
    const Pose pose = sample_clip(s.rig, clip, shot.times[i]);
    shot.positions[i] = posed(s, pose);
    for (const JointLimit& l : s.limits) angles[i].push_back(joint_angles(s.rig, s.neutral, pose, l));
  });
  for (const auto& list : angles)
    for (std::size_t l = 0; l < list.size(); ++l) {
      if (list[l].excess <= 0.01) continue;  // the angles of a matrix are not more exact than that
      ++r.beyond;
      if (list[l].excess > r.excess_deg)
        r.excess_deg = list[l].excess, r.worst_joint = s.rig.nodes[s.limits[l].node].name;
    }
  std::vector<Foot> feet;
  if (plan) {
    for (const Contact& c : plan->contacts)
      if (std::none_of(feet.begin(), feet.end(), [&](const Foot& f) { return f.node == c.node; }))
        feet.push_back(foot_of(s.rig, dominant, c.node));
  } else {
    feet = find_feet(s, dominant);
  }
  double ground = 0;
  r.below = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < shot.positions.size(); ++i)
    for (std::size_t v = 0; v < shot.positions[i].size(); ++v)
      if (const double z = shot.positions[i][v].z; z < r.below) {
        r.below = z, r.deepest_at = shot.times[i];
        r.deepest_joint = dominant[v] < 0 ? "" : s.rig.nodes[dominant[v]].name;
      }
  if (!plan) {  // where the lowest foot mostly is
    std::vector<double> low(shot.positions.size(), std::numeric_limits<double>::infinity());
    for (std::size_t i = 0; i < low.size(); ++i)
      for (const Foot& foot : feet) low[i] = std::min(low[i], lowest(shot.positions[i], foot));
    ground = median(low);
  }
  std::vector<Stances> stances;
  for (const Foot& foot : feet)
    stances.push_back(plan ? planned_stances(*plan, foot.node, shot.times)
                           : found_stances(shot, foot, ground, 0.015 * scale));
  // How fast bearing feet go back under the body.
  const double step = clip.duration / samples;
  dvec3 back(0);
  if (plan) {
    back.x = -plan->advance / clip.duration;
  } else {
    std::vector<double> x, y;
    for (std::size_t f = 0; f < feet.size(); ++f)
      for (const auto& [first, last] : stances[f])
        for (int i = first; i < last; ++i)
          if (const auto move = contact_move(shot.positions[i], shot.positions[i + 1], feet[f], 0.004 * scale))
            x.push_back(move->x / step), y.push_back(move->y / step);
    back = {median(x), median(y), 0};
  }
  r.speed = glm::length(back);
  std::size_t bearing = 0;
  for (std::size_t f = 0; f < feet.size(); ++f)
    for (const auto& [first, last] : stances[f]) {
      bearing += last - first;
      dvec3 slid(0), low(0), high(0);
      for (int i = first; i <= last; ++i) {
        r.off_ground = std::max(r.off_ground, std::abs(lowest(shot.positions[i], feet[f]) - ground));
        if (i == last) break;
        if (const auto move = contact_move(shot.positions[i], shot.positions[i + 1], feet[f], 0.004 * scale))
          slid += *move - back * step;
        low = glm::min(low, slid), high = glm::max(high, slid);
        r.slip = std::max(r.slip, glm::length(high - low));
      }
    }
  r.bearing = feet.empty() ? 0 : static_cast<double>(bearing) / (samples * feet.size());
  const bool loops = !plan || plan->loops;
  if (loops) {
    const auto &a = shot.positions.front(), &b = shot.positions.back();
    dvec3 way(0);
    for (std::size_t v = 0; v < a.size(); ++v) way += (dvec3(b[v]) - dvec3(a[v])) / static_cast<double>(a.size());
    way.z = 0;
    if (plan) r.speed = std::max(r.speed, glm::length(way) / clip.duration);
    for (std::size_t v = 0; v < a.size(); ++v)
      r.closure = std::max(r.closure, glm::length(dvec3(b[v]) - dvec3(a[v]) - way));
  }
  return r;
}

std::string clip_table(const std::vector<ClipResult>& results) {
  std::string t =
      "| clip | bearing feet from | bearing | speed m/s | off the ground cm | slip cm | lowest point cm | loop closes cm | "
      "angles beyond limits | worst beyond, deg |\n|---|---|---|---|---|---|---|---|---|---|\n";
  for (const ClipResult& r : results)
    t += fmt::format("| {} | {} | {:.0f} % | {:.2f} | {:.2f} | {:.2f} | {:.2f} at {:.2f} s, {} | {:.4f} | {} | {:.1f} {} |\n", r.name,
                     r.planned ? "the plan" : "the mesh", 100 * r.bearing, r.speed, 100 * r.off_ground, 100 * r.slip,
                     100 * r.below, r.deepest_at, r.deepest_joint, 100 * r.closure, r.beyond, r.excess_deg, r.worst_joint);
  return t;
}

void add_figures(const ClipResult& r, StudyResult& out) {
  const auto bound = [&](double most) { return r.planned ? std::optional<double>(most) : std::nullopt; };
  out.figures.push_back({r.name + ": bearing feet off the ground, at most", r.off_ground, "m", bound(0.01), {}});
  out.figures.push_back({r.name + ": slip of a bearing foot", r.slip, "m", bound(0.02), {}});
  out.figures.push_back({r.name + ": depth below the ground", std::max(0.0, -r.below), "m", bound(0.01), {}});
  out.figures.push_back({r.name + ": joint angles beyond limits", static_cast<double>(r.beyond), "", bound(0), {}});
  out.figures.push_back({r.name + ": gap of the loop", r.closure, "m", bound(1e-3), {}});
}

// RMS over poses and keypoints of the distance to the mean pose, metres.
double spread_of(const std::vector<std::vector<dvec3>>& poses) {
  if (poses.empty() || poses[0].empty()) return 0;
  std::vector<dvec3> mean(poses[0].size(), dvec3(0));
  for (const auto& p : poses)
    for (std::size_t k = 0; k < p.size(); ++k) mean[k] += p[k] / static_cast<double>(poses.size());
  double sum = 0;
  for (const auto& p : poses)
    for (std::size_t k = 0; k < p.size(); ++k) sum += glm::dot(p[k] - mean[k], p[k] - mean[k]);
  return std::sqrt(sum / (static_cast<double>(poses.size()) * static_cast<double>(mean.size())));
}

// Least distance of the mesh from the border over all pictures, pixels; negative where it is cut.
double picture_margin(const std::vector<vec3>& world, const CameraRecord& c) {
  double least = std::numeric_limits<double>::infinity();
  const auto& m = c.world_to_camera;
  for (const vec3& p : world) {
    const double x = m[0] * p.x + m[1] * p.y + m[2] * p.z + m[3], y = m[4] * p.x + m[5] * p.y + m[6] * p.z + m[7],
                 z = m[8] * p.x + m[9] * p.y + m[10] * p.z + m[11];
    if (z <= 0) return -std::numeric_limits<double>::infinity();
    const double u = c.fx * x / z + c.cx, v = c.fy * y / z + c.cy;
    least = std::min({least, u, v, c.width - u, c.height - v});
  }
  return least;
}

}  // namespace

JointAngles joint_angles(const Rig& rig, const Pose& neutral, const Pose& pose, const JointLimit& limit) {
  Pose rest = neutral;
  if (rest.local.empty()) rest = bind_pose(rig);
  rest.placement = dmat4(1.0);
  const int parent = rig.nodes[limit.node].parent;
  dquat axes(1, 0, 0, 0);
  if (parent >= 0) axes = decompose(world_transforms(rig, rest)[parent]).rotation;
  const dquat turn = axes * local_transform(rig, pose, limit.node).rotation *
                     glm::conjugate(local_transform(rig, rest, limit.node).rotation) * glm::conjugate(axes);
  const dmat3 m = glm::mat3_cast(glm::normalize(turn));  // Rz Ry Rx; m[column][row]
  const double y = std::asin(std::clamp(-m[0][2], -1.0, 1.0));
  const dvec3 one = dvec3(std::atan2(m[1][2], m[2][2]), y, std::atan2(m[0][1], m[0][0])) / degrees;
  const auto wrapped = [](double d) { return std::remainder(d, 360.0); };
  const dvec3 other(wrapped(one.x + 180), wrapped(180 - one.y), wrapped(one.z + 180));
  JointAngles best;
  best.excess = std::numeric_limits<double>::infinity();
  for (const dvec3& deg : {one, other}) {
    double excess = 0;
    for (int i = 0; i < 3; ++i)
      excess = std::max({excess, limit.lower_deg[i] - deg[i], deg[i] - limit.upper_deg[i]});
    if (excess < best.excess) best = {deg, excess};
  }
  return best;
}

StudyResult study_motion(const Species& species, const MotionOptions& options) {
  if (options.samples < 2) input_error("a motion study needs at least 2 samples a clip, not {}", options.samples);
  StudyResult out;
  out.title = "Motion of " + species.name;
  if (species.rig.clips.empty()) input_error("{} has no clips to measure", species.rig.source);
  const std::vector<int> dominant = dominant_nodes(species.rig);
  std::vector<ClipResult> results;
  for (const Clip& clip : species.rig.clips) {
    results.push_back(measure_clip(species, clip, dominant, options.samples));
    add_figures(results.back(), out);
  }
  out.table = clip_table(results);
  return out;
}

StudyResult study_motion(const SceneSpec& scene, const Species& species, const MotionOptions& options) {
  StudyResult out = species.rig.clips.empty() ? StudyResult{"Motion of " + species.name, {}, ""}
                                              : study_motion(species, options);
  const AnimalSpec& animal = scene.animals[0];
  const std::size_t count = scene.frames.size();
  Pose neutral = species.neutral;
  neutral.placement = dmat4(1.0);
  const std::vector<dmat4> neutral_world = world_transforms(species.rig, neutral);
  std::vector<std::vector<dvec3>> keypoints(count);
  std::vector<double> margins(count), lows(count);
  std::vector<int> cameras(count);
  std::vector<bool> random(count);
  for (std::size_t f = 0; f < count; ++f) {
    int index = scene.frames[f] - scene.first_frame;
    for (const PoseSource& p : animal.poses) {
      const auto* clip = std::get_if<ClipFrames>(&p);
      const auto* sampler = std::get_if<PoseSampler>(&p);
      const auto* file = std::get_if<PoseFile>(&p);
      const int n = clip ? clip->count : sampler ? sampler->count : file->poses ? static_cast<int>(file->poses->size()) : 0;
      if (index < n) {
        random[f] = sampler && sampler->on_ground;
        break;
      }
      index -= n;
    }
  }
  const auto keypoints_at_home = [&](const Pose& pose, const dvec3& at, double yaw) {
    const std::vector<dmat4> world = world_transforms(species.rig, pose);
    const PosedSurface surface =
        skin(species.rig, bone_matrices(species.rig, world), pose.morph_weights, species.skinning, dvec3(0));
    std::vector<dvec3> points = keypoint_positions(species, world, neutral_world, surface);
    const double c = std::cos(-yaw), s = std::sin(-yaw);
    for (dvec3& p : points) {
      p -= at;
      p = {c * p.x - s * p.y, s * p.x + c * p.y, p.z};
    }
    return std::pair{points, surface.positions};
  };
  parallel_for(count, 1, [&](std::size_t f) {
    const int frame = scene.frames[f];
    const Pose pose = pose_of_frame(scene, animal, species, frame - scene.first_frame);
    const auto [points, positions] =
        keypoints_at_home(pose, draw_vector(animal.position, scene.seed, frame, 0),
                          draw_number(animal.yaw_deg, scene.seed, frame, 0) * degrees);
    keypoints[f] = points;
    lows[f] = std::numeric_limits<double>::infinity();
    for (const vec3& p : positions) lows[f] = std::min(lows[f], static_cast<double>(p.z));
    margins[f] = std::numeric_limits<double>::infinity();
    for (const CameraRecord& c : cameras_of_frame(scene, frame)) {
      const double margin = picture_margin(positions, c);
      if (margin < margins[f]) margins[f] = margin, cameras[f] = c.id;
    }
  });
  const std::size_t tightest = std::min_element(margins.begin(), margins.end()) - margins.begin();
  double off = 0;
  for (std::size_t f = 0; f < count; ++f)
    if (random[f]) off = std::max(off, std::abs(lows[f]));
  const double spread = spread_of(keypoints);
  out.table += fmt::format("\n{} poses of {}: keypoints {:.3f} m from the mean pose (RMS)", count, scene.file, spread);
  Figure figure{"pose set: keypoints from the mean pose, RMS", spread, "m", {}, {}};
  if (species.rig.find_clip("walk") >= 0 && !species.keypoints.empty()) {
    SceneSpec walking = scene;
    walking.animals = {animal};
    walking.animals[0].position = constant_vector(dvec3(0));
    walking.animals[0].yaw_deg = constant_number(0);
    walking.animals[0].poses = {ClipFrames{"walk", 130, true}};
    std::vector<std::vector<dvec3>> walk(130);
    parallel_for(walk.size(), 1, [&](std::size_t i) {
      walk[i] =
          keypoints_at_home(pose_of_frame(walking, walking.animals[0], species, static_cast<int>(i)), dvec3(0), 0).first;
    });
    const double alone = spread_of(walk);
    figure.at_least = alone;
    out.figures.push_back({"walk alone: keypoints from the mean pose, RMS", alone, "m", {}, {}});
    out.table += fmt::format(", the walk alone {:.3f} m", alone);
  }
  out.figures.push_back(figure);
  if (std::find(random.begin(), random.end(), true) != random.end())
    out.figures.push_back({"random poses: lowest point off the ground", off, "m", 0.01, {}});
  out.figures.push_back({"deepest point of any pose below the ground",
                         std::max(0.0, -*std::min_element(lows.begin(), lows.end())), "m", 0.01, {}});
  out.figures.push_back({"smallest margin of the animal in any picture", margins[tightest], "px", {}, 1});
  out.table += fmt::format(". Nearest to the border: {:.1f} px, frame {}, camera {}.\n", margins[tightest],
                           scene.frames[tightest], cameras[tightest]);
  return out;
}

}  // namespace moomill
