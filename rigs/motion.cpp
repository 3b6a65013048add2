#include "rigs/motion.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "generator/core/error.h"

namespace moomill {
namespace {

// Rotations and shifts of every joint at one moment. In the neutral pose all joints are turned as the model is.
struct Frame {
  std::vector<dquat> rotation;
  std::vector<dvec3> shift;
};

struct Skeleton {
  std::vector<int> parent;
  std::vector<dvec3> offset;  // from the parent
};

dquat about_y(double radians) {
  return {std::cos(0.5 * radians), 0, std::sin(0.5 * radians), 0};
}
dquat about_x(double radians) {
  return {std::cos(0.5 * radians), std::sin(0.5 * radians), 0, 0};
}
dquat about_z(double radians) {
  return {std::cos(0.5 * radians), 0, 0, std::sin(0.5 * radians)};
}
dquat from_degrees(const dvec3& d) {
  return about_z(d.z * degrees) * about_y(d.y * degrees) * about_x(d.x * degrees);
}

struct Placement {
  dvec3 at{0};
  dquat turn{1, 0, 0, 0};
};

// Where a joint is: up the chain of its parents and down again.
Placement locate(const Skeleton& s, const Frame& f, int joint) {
  if (joint < 0) return {};
  const Placement p = locate(s, f, s.parent[joint]);
  return {p.at + p.turn * (s.offset[joint] + f.shift[joint]), p.turn * f.rotation[joint]};
}

struct Leg {
  int blade = -1, swing = 0, bend = 0, fold = 0, pastern = 0, foot = 0;
  double couple = 0;
  dvec3 foot_at{0}, pastern_to_foot{0};  // neutral
};

// What a leg is asked for at one moment.
struct Step {
  dvec3 offset{0};               // of the foot from where it stands, metres
  double reach = 0;              // -1 at the back end of a step to 1 at the front
  double fold = 0, pastern = 0;  // radians
};

Step gait_step(const GaitSpec& g, double phase, double cycle) {
  double s = cycle - phase;
  s -= std::floor(s);
  const double travel = g.stride * g.duty;
  Step step;
  if (s < g.duty) {
    step.offset.x = travel * (0.5 - s / g.duty);
  } else {
    // Cubic Hermite from lift-off to touch-down with the ground's velocity at both ends: the foot neither kicks nor
    // skids.
    const double w = (s - g.duty) / (1 - g.duty), w2 = w * w, w3 = w2 * w;
    const double slope = -travel / g.duty * (1 - g.duty);
    step.offset.x =
        travel * (-0.5 * (2 * w3 - 3 * w2 + 1) + 0.5 * (3 * w2 - 2 * w3)) + slope * ((w3 - 2 * w2 + w) + (w3 - w2));
    const double bump = 16 * w2 * (1 - w) * (1 - w);
    const double early = std::sin(pi * std::pow(w, 0.75));
    step.offset.z = g.lift * bump;
    step.fold = g.fold_deg * degrees * early * early;
    step.pastern = g.pastern_deg * degrees * early * early;
  }
  step.reach = travel > 0 ? step.offset.x / (0.5 * travel) : 0;
  return step;
}

// Turns the leg's joints so that its foot is where the step wants it. Three angles for three coordinates by damped
// least squares (Wampler 1986; Nakamura and Hanafusa 1986), which bends gracefully where a target is out of reach.
void plant(const Skeleton& s, Frame& f, const Leg& leg, const Step& step, double blade) {
  if (leg.blade >= 0) f.rotation[leg.blade] = f.rotation[leg.blade] * about_y(-blade * step.reach);
  const dquat flat = about_y(step.pastern);
  const dvec3 target = leg.foot_at + step.offset - flat * leg.pastern_to_foot;
  const dquat swing = f.rotation[leg.swing], bend = f.rotation[leg.bend], fold = f.rotation[leg.fold];
  const auto apply = [&](const dvec3& angle) {
    f.rotation[leg.swing] = swing * about_y(angle.x) * about_x(angle.y);
    f.rotation[leg.bend] = bend * about_y(angle.z);
    f.rotation[leg.fold] = fold * about_y(leg.couple * angle.z + (leg.couple == 0 ? step.fold : 0.0));
    return locate(s, f, leg.pastern).at - target;
  };
  // A little bent to begin with: straight legs have no way to shorten.
  dvec3 angle(-0.02, 0, 0.04);
  for (int i = 0; i < 30; ++i) {
    const dvec3 error = apply(angle);
    if (glm::length(error) < 1e-7) break;
    constexpr double e = 1e-5;
    dmat3 jacobian;
    for (int k = 0; k < 3; ++k) {
      dvec3 next = angle;
      next[k] += e;
      jacobian[k] = (apply(next) - error) / e;
    }
    const dmat3 t = glm::transpose(jacobian);
    dvec3 change = -(glm::inverse(t * jacobian + 1e-5 * dmat3(1.0)) * (t * error));
    const double most = std::max({std::abs(change.x), std::abs(change.y), std::abs(change.z)});
    if (most > 0.3) change *= 0.3 / most;
    angle += change;
  }
  apply(angle);
  // The foot keeps its attitude towards the ground, whatever the leg above it does.
  f.rotation[leg.pastern] = glm::inverse(locate(s, f, s.parent[leg.pastern]).turn) * flat;
}

dvec3 track_at(const TrackSpec& track, double time) {
  const auto& t = track.times;
  if (time <= t.front()) return track.rotation_deg.front();
  if (time >= t.back()) return track.rotation_deg.back();
  const std::size_t i = std::upper_bound(t.begin(), t.end(), time) - t.begin() - 1;
  const double u = (time - t[i]) / (t[i + 1] - t[i]);
  return glm::mix(track.rotation_deg[i], track.rotation_deg[i + 1], u * u * (3 - 2 * u));
}

class ClipBuilder {
 public:
  ClipBuilder(const std::string& legs_source, const std::vector<LegSpec>& legs, const Rig& rig) : rig_(rig) {
    for (const Node& node : rig.nodes)
      skeleton_.parent.push_back(node.parent), skeleton_.offset.push_back(node.translation);
    rest_.rotation.assign(rig.nodes.size(), dquat(1, 0, 0, 0));
    rest_.shift.assign(rig.nodes.size(), dvec3(0));
    for (const LegSpec& l : legs) {
      add_leg(l, legs_source, false);
      if (l.mirror) add_leg(l, legs_source, true);
    }
  }

  Clip build(const ClipSpec& c) {
    if (c.gait && c.gait->phases.size() != legs_.size())
      input_error("{}: [gait] has {} phases; give one for each of the {} legs", c.source, c.gait->phases.size(), legs_.size());
    std::vector<Frame> frames;
    for (int k = 0; k <= c.keys; ++k) {
      // The last key is the first again, to the last bit; so the loop has no seam. Tracks that end elsewhere may jump.
      frames.push_back(pose(c, static_cast<double>(k) / c.keys, static_cast<double>(k % c.keys) / c.keys));
    }
    Clip clip;
    clip.name = c.name;
    clip.duration = c.duration;
    for (std::size_t j = 0; j < rig_.nodes.size(); ++j) {
      Channel turn, move;
      turn.node = move.node = static_cast<int>(j);
      turn.path = ChannelPath::rotation, move.path = ChannelPath::translation;
      double turned = 0, moved = 0;
      dquat last(1, 0, 0, 0);
      for (int k = 0; k <= c.keys; ++k) {
        const double time = c.duration * k / c.keys;
        dquat q = glm::normalize(frames[k].rotation[j]);
        if (glm::dot(q, last) < 0) q = -q;
        last = q;
        turn.times.push_back(time), move.times.push_back(time);
        for (const double v : {q.x, q.y, q.z, q.w}) turn.values.push_back(v);
        const dvec3 t = skeleton_.offset[j] + frames[k].shift[j];
        for (int i = 0; i < 3; ++i) move.values.push_back(t[i]);
        turned = std::max({turned, std::abs(q.x), std::abs(q.y), std::abs(q.z)});
        moved = std::max(moved, glm::length(frames[k].shift[j]));
      }
      if (turned > 1e-9) clip.channels.push_back(std::move(turn));
      if (moved > 0) clip.channels.push_back(std::move(move));
    }
    return clip;
  }

 private:
  int joint(const std::string& name, const std::string& source) const {
    for (std::size_t i = 0; i < rig_.nodes.size(); ++i)
      if (rig_.nodes[i].name == name) return static_cast<int>(i);
    input_error("{} names the joint '{}', which {} does not have", source, name, rig_.source);
  }

  void add_leg(const LegSpec& l, const std::string& source, bool right) {
    const auto find = [&](const std::string& name) {
      return joint(right ? mirror_name(name) : name, source + ": a leg");
    };
    Leg leg;
    if (!l.blade.empty()) leg.blade = find(l.blade);
    leg.swing = find(l.swing), leg.bend = find(l.bend), leg.fold = find(l.fold), leg.pastern = find(l.pastern),
    leg.foot = find(l.foot);
    leg.couple = l.couple;
    leg.foot_at = locate(skeleton_, rest_, leg.foot).at;
    leg.pastern_to_foot = leg.foot_at - locate(skeleton_, rest_, leg.pastern).at;
    legs_.push_back(leg);
  }

  Frame pose(const ClipSpec& c, double track_time, double cycle) const {
    std::vector<dvec3> angles(rig_.nodes.size(), dvec3(0));
    Frame f = rest_;
    for (const WaveSpec& w : c.waves) {
      const int j = joint(w.joint, c.source);
      const double wave = std::sin(2 * pi * (w.cycles * cycle + w.phase));
      angles[j] += w.offset_deg + w.amplitude_deg * wave;
      f.shift[j] += w.offset_m + w.amplitude_m * wave;
    }
    for (const TrackSpec& t : c.tracks) angles[joint(t.joint, c.source)] += track_at(t, track_time);
    for (std::size_t j = 0; j < angles.size(); ++j) f.rotation[j] = from_degrees(angles[j]);
    for (std::size_t i = 0; i < legs_.size(); ++i) {
      const Step step = c.gait ? gait_step(*c.gait, c.gait->phases[i], cycle) : Step{};
      plant(skeleton_, f, legs_[i], step, c.gait ? c.gait->blade_deg * degrees : 0.0);
    }
    return f;
  }

  const Rig& rig_;
  Skeleton skeleton_;
  Frame rest_;
  std::vector<Leg> legs_;
};

}  // namespace

std::vector<Clip> build_clips(const std::string& legs_source, const std::vector<LegSpec>& legs,
                              const std::vector<ClipSpec>& clips, const Rig& rig) {
  ClipBuilder builder(legs_source, legs, rig);
  std::vector<Clip> built;
  for (const ClipSpec& c : clips) built.push_back(builder.build(c));
  return built;
}

std::string mirror_name(const std::string& name) {
  std::string result = name;
  if (const auto at = result.find("left"); at != std::string::npos) return result.replace(at, 4, "right");
  if (const auto at = result.find("right"); at != std::string::npos) return result.replace(at, 5, "left");
  if (result.ends_with("_l"))
    result.back() = 'r';
  else if (result.ends_with("_r"))
    result.back() = 'l';
  return result;
}

}  // namespace moomill
