#include "rigs/motion.h"

#include <glm/gtc/matrix_inverse.hpp>

#include "generator/core/error.h"
#include "rigs/gait.h"
#include "rigs/leg_ik.h"

namespace moomill {
namespace {

// Every joint is turned against the neutral pose about the axes of the model, whatever its local axes are; and shifted,
// in metres along the same axes of its parent.
struct Frame {
  std::vector<dquat> turn;
  std::vector<dvec3> shift;
};

struct Placement {
  dvec3 at{0};
  dquat turn{1, 0, 0, 0};
};

struct Skeleton {
  std::vector<int> parent;
  std::vector<dvec3> at;      // metres, neutral, model space
  std::vector<dvec3> offset;  // from the parent
};

std::vector<Placement> place_all(const Skeleton& s, const Frame& f) {
  std::vector<Placement> out(s.parent.size());
  for (std::size_t j = 0; j < out.size(); ++j) {
    const Placement p = s.parent[j] < 0 ? Placement{} : out[s.parent[j]];
    out[j] = {p.at + p.turn * (s.offset[j] + f.shift[j]), p.turn * f.turn[j]};
  }
  return out;
}

Placement place(const Skeleton& s, const Frame& f, int joint) {
  if (joint < 0) return {};
  const Placement p = place(s, f, s.parent[joint]);
  return {p.at + p.turn * (s.offset[joint] + f.shift[joint]), p.turn * f.turn[joint]};
}

double pitch_of(const dquat& q) {
  const dvec3 down = q * dvec3(0, 0, -1);
  return std::atan2(-down.x, -down.z);
}

dquat from_degrees(const dvec3& d) {
  return about_z(d.z * degrees) * about_y(d.y * degrees) * about_x(d.x * degrees);
}

// The skin that hangs on some joints, for finding how low it comes.
struct Skin {
  struct Vertex {
    std::uint32_t begin = 0, end = 0;  // into `influences`
    dvec3 at{0};                       // metres, neutral
  };
  std::vector<Vertex> vertices;
  std::vector<std::pair<int, double>> influences;  // node, weight

  double lowest(const Skeleton& s, const std::vector<Placement>& placed) const {
    double low = std::numeric_limits<double>::infinity();
    for (const Vertex& v : vertices) {
      double z = 0;
      for (std::uint32_t i = v.begin; i < v.end; ++i) {
        const auto& [node, weight] = influences[i];
        z += weight * (placed[node].at.z + (placed[node].turn * (v.at - s.at[node])).z);
      }
      low = std::min(low, z);
    }
    return low;
  }
};

struct Leg {
  std::string name;  // of its foot
  int blade = -1, swing = 0, bend = 0, fold = 0, pastern = 0, foot = 0;
  double couple = 0, blade_share = 0, side = 1;
  dvec3 toe{0}, heel{0};  // of the sole, from the foot's joint
  double sole = 0;        // metres, height of the sole in the neutral pose
  Skin lower;             // what lies on the ground where the leg rests
};

// Angles of a leg's joints, radians; hoof: its turn against the ground.
struct LegPose {
  double blade = 0, pitch = 0, roll = 0, bend = 0, fold = 0, pastern = 0;
  dquat hoof{1, 0, 0, 0};
};

template <class T>
T keyed(const std::vector<double>& times, const std::vector<T>& values, double time) {
  if (time <= times.front()) return values.front();
  if (time >= times.back()) return values.back();
  const std::size_t i = std::upper_bound(times.begin(), times.end(), time) - times.begin() - 1;
  const double u = smooth((time - times[i]) / (times[i + 1] - times[i]));
  return values[i] * (1 - u) + values[i + 1] * u;
}

double rest_amount(const RestSpec& r, double time) {
  const double in = r.times[1] > r.times[0] ? smooth((time - r.times[0]) / (r.times[1] - r.times[0])) : 1.0;
  const double out = r.times[3] > r.times[2] ? smooth((time - r.times[2]) / (r.times[3] - r.times[2])) : 0.0;
  return std::min(in, 1 - out);
}

class MotionBuilder {
 public:
  MotionBuilder(const std::string& legs_source, const std::vector<LegSpec>& legs, const Rig& rig, const Pose& neutral,
                const std::vector<JointLimit>& limits)
      : rig_(rig), neutral_(neutral) {
    neutral_.placement = dmat4(1.0);
    world_ = world_transforms(rig, neutral_);
    for (std::size_t j = 0; j < rig.nodes.size(); ++j) {
      const int parent = rig.nodes[j].parent;
      skeleton_.parent.push_back(parent);
      skeleton_.at.emplace_back(world_[j][3]);
      skeleton_.offset.push_back(skeleton_.at[j] - (parent < 0 ? dvec3(0) : skeleton_.at[parent]));
    }
    lower_.assign(rig.nodes.size(), dvec3(-180));
    upper_.assign(rig.nodes.size(), dvec3(180));
    for (const JointLimit& l : limits) lower_[l.node] = l.lower_deg, upper_[l.node] = l.upper_deg;
    rest_.turn.assign(rig.nodes.size(), dquat(1, 0, 0, 0));
    rest_.shift.assign(rig.nodes.size(), dvec3(0));
    neutral_skin_ = skin(rig, bone_matrices(rig, world_), neutral_.morph_weights, SkinningMethod::linear_blend,
                         dvec3(0))
                        .positions;
    for (const LegSpec& l : legs) {
      add_leg(l, legs_source, false);
      if (l.mirror) add_leg(l, legs_source, true);
    }
    for (const Leg& l : legs_) leg_length_ += skeleton_.at[l.blade >= 0 ? l.blade : l.swing].z / legs_.size();
    top_ = legs_.empty() ? 0 : legs_[0].swing;
    while (skeleton_.parent[top_] >= 0) top_ = skeleton_.parent[top_];
  }

  void build(const ClipSpec& c, Motion& out) {
    const Prepared p = prepare(c);
    const double advance = c.gait ? c.gait->stride * leg_length_ : 0.0;
    std::vector<Frame> frames;
    for (int k = 0; k <= c.keys; ++k) {
      // The last key of a loop is the first again, to the last bit; so the loop has no seam.
      const double time = static_cast<double>(c.loops ? k % c.keys : k) / c.keys;
      frames.push_back(pose(c, p, time));
      if (!c.in_place) frames.back().shift[top_].x += advance * k / c.keys;
    }
    out.clips.push_back(to_clip(c, frames));
    out.plans.push_back(plan(c, c.in_place ? advance : 0.0));
  }

 private:
  struct Prepared {
    std::vector<const GaitLegs*> gait;  // per leg; nullptr: none
    std::vector<double> phase;
    std::vector<std::vector<StepSpec>> steps;
    std::vector<std::vector<const RestSpec*>> rests;
    std::vector<Skin> reach;  // per ReachSpec
    Skin settle;
  };

  int joint(const std::string& name, const std::string& source) const {
    const int node = rig_.find_node(name);
    if (node < 0) input_error("{} names the joint '{}', which {} does not have", source, name, rig_.source);
    return node;
  }

  std::size_t leg(const std::string& foot, const std::string& source) const {
    for (std::size_t i = 0; i < legs_.size(); ++i)
      if (legs_[i].name == foot) return i;
    std::string known;
    for (const Leg& l : legs_) known += (known.empty() ? "" : ", ") + l.name;
    if (known.empty()) known = "none; describe the legs in the species file";
    input_error("{} names the foot '{}', which is no leg's; known are {}", source, foot, known);
  }

  // All vertices that hang on the marked joints more than on any other.
  Skin skin_of(const std::vector<bool>& marked) const {
    Skin s;
    for (std::size_t v = 0; v + 1 < rig_.influence_begin.size(); ++v) {
      const std::uint32_t first = rig_.influence_begin[v], last = rig_.influence_begin[v + 1];
      const Influence* most = nullptr;
      for (std::uint32_t i = first; i < last; ++i)
        if (!most || rig_.influences[i].weight > most->weight) most = &rig_.influences[i];
      if (!most || !marked[rig_.bones[most->bone].node]) continue;
      Skin::Vertex vertex;
      vertex.begin = static_cast<std::uint32_t>(s.influences.size());
      for (std::uint32_t i = first; i < last; ++i)
        s.influences.emplace_back(rig_.bones[rig_.influences[i].bone].node, rig_.influences[i].weight);
      vertex.end = static_cast<std::uint32_t>(s.influences.size());
      vertex.at = dvec3(neutral_skin_[v]);
      s.vertices.push_back(vertex);
    }
    return s;
  }

  std::vector<bool> with_below(int top) const {
    std::vector<bool> marked(rig_.nodes.size(), false);
    marked[top] = true;
    for (std::size_t j = 0; j < marked.size(); ++j)
      if (skeleton_.parent[j] >= 0 && marked[skeleton_.parent[j]]) marked[j] = true;
    return marked;
  }

  void add_leg(const LegSpec& l, const std::string& source, bool right) {
    const auto find = [&](const std::string& name) {
      return joint(right ? mirror_name(name) : name, source + ": a leg");
    };
    Leg leg;
    if (!l.blade.empty()) leg.blade = find(l.blade);
    leg.swing = find(l.swing), leg.bend = find(l.bend), leg.fold = find(l.fold), leg.pastern = find(l.pastern),
    leg.foot = find(l.foot);
    const int chain[] = {leg.swing, leg.bend, leg.fold, leg.pastern, leg.foot};
    for (int i = 1; i < 5; ++i)
      if (skeleton_.parent[chain[i]] != chain[i - 1])
        input_error("{}: a leg says that '{}' hangs on '{}', but it does not; name the leg's joints from the body down",
                    source, rig_.nodes[chain[i]].name, rig_.nodes[chain[i - 1]].name);
    if (leg.blade >= 0 && skeleton_.parent[leg.swing] != leg.blade)
      input_error("{}: a leg says that '{}' hangs on '{}', but it does not; name the leg's joints from the body down",
                  source, rig_.nodes[leg.swing].name, rig_.nodes[leg.blade].name);
    leg.name = rig_.nodes[leg.foot].name;
    leg.couple = l.couple;
    leg.blade_share = l.blade_share;
    leg.side = skeleton_.at[leg.foot].y < 0 ? -1 : 1;
    const Skin hoof = skin_of(with_below(leg.foot));
    if (hoof.vertices.empty())
      input_error("{}: no skin moves with the foot '{}', so it cannot be put on the ground", source, leg.name);
    leg.sole = std::numeric_limits<double>::infinity();
    for (const Skin::Vertex& v : hoof.vertices) leg.sole = std::min(leg.sole, v.at.z);
    double front = -1e9, back = 1e9;
    for (const Skin::Vertex& v : hoof.vertices) {
      if (v.at.z > leg.sole + 0.006) continue;
      front = std::max(front, v.at.x), back = std::min(back, v.at.x);
    }
    const dvec3 foot = skeleton_.at[leg.foot];
    leg.toe = dvec3(front - foot.x, 0, leg.sole - foot.z);
    leg.heel = dvec3(back - foot.x, 0, leg.sole - foot.z);
    leg.lower = skin_of(with_below(leg.fold));
    legs_.push_back(std::move(leg));
  }

  Prepared prepare(const ClipSpec& c) const {
    Prepared p;
    p.gait.assign(legs_.size(), nullptr);
    p.phase.assign(legs_.size(), 0.0);
    p.steps.resize(legs_.size());
    p.rests.resize(legs_.size());
    if (c.gait)
      for (const GaitLegs& g : c.gait->legs)
        for (std::size_t i = 0; i < g.feet.size(); ++i) {
          const std::size_t l = leg(g.feet[i], c.source);
          p.gait[l] = &g, p.phase[l] = g.phases[i];
        }
    for (const StepSpec& s : c.steps) {
      auto& steps = p.steps[leg(s.foot, c.source)];
      if (!steps.empty() && steps.back().end > s.begin)
        input_error("{}: a step of '{}' begins at {} before the one before it ends; give steps in order of time",
                    c.source, s.foot, s.begin);
      steps.push_back(s);
    }
    for (const RestSpec& r : c.rests) p.rests[leg(r.foot, c.source)].push_back(&r);
    for (const ReachSpec& r : c.reaches) {
      p.reach.push_back(skin_of(with_below(joint(r.joint, c.source))));
      if (p.reach.back().vertices.empty())
        input_error("{}: no skin moves with the joint '{}', so it cannot reach the ground", c.source, r.joint);
      for (const std::string& name : r.joints) joint(name, c.source);
    }
    if (c.settle) {
      std::vector<bool> marked(rig_.nodes.size(), false);
      for (const std::string& name : c.settle->joints) marked[joint(name, c.source)] = true;
      p.settle = skin_of(marked);
      if (p.settle.vertices.empty())
        input_error("{}: no skin moves with the joints of [settle], so nothing can lie on the ground", c.source);
    }
    const auto refuse_solved = [&](const std::string& name, const char* what) {
      const int node = joint(name, c.source);
      for (const Leg& l : legs_)
        for (const int solved : {l.bend, l.fold, l.pastern, l.foot})
          if (solved == node)
            input_error("{}: a {} turns '{}', but inverse kinematics does; use [gait], [[steps]] or [[rests]]", c.source,
                        what, name);
    };
    for (const WaveSpec& w : c.waves) refuse_solved(w.joint, "wave");
    for (const TrackSpec& t : c.tracks) refuse_solved(t.joint, "track");
    return p;
  }

  Range range(int node, int axis) const { return {lower_[node][axis] * degrees, upper_[node][axis] * degrees}; }

  // Turns the blade and finds where the leg hangs from then.
  Placement hang(Frame& f, const Leg& leg, double blade) const {
    if (leg.blade >= 0) f.turn[leg.blade] = f.turn[leg.blade] * about_y(blade);
    const Placement above = place(skeleton_, f, skeleton_.parent[leg.swing]);
    return {above.at + above.turn * (skeleton_.offset[leg.swing] + f.shift[leg.swing]), above.turn * f.turn[leg.swing]};
  }

  // The blade takes its share of the turn from the leg's neutral direction to that of the target.
  double blade_turn(const Frame& f, const Leg& leg, const dvec3& neutral, const dvec3& target) const {
    if (leg.blade < 0) return 0;
    const Placement above = place(skeleton_, f, skeleton_.parent[leg.blade]);
    const dvec3 at = above.at + above.turn * (skeleton_.offset[leg.blade] + f.shift[leg.blade]);
    const dvec3 to = glm::inverse(above.turn) * (target - at), from = neutral - skeleton_.at[leg.blade];
    const double turn = std::remainder(std::atan2(-to.x, -to.z) - std::atan2(-from.x, -from.z), 2 * pi);
    return range(leg.blade, 1).clamp(leg.blade_share * turn);
  }

  double fold_of(const Leg& leg, double bend, double extra) const {
    return range(leg.fold, 1).clamp(leg.couple * bend + (leg.couple == 0 ? extra : 0.0));
  }

  // The foot on the ground, or in its swing. Hoof and pastern depend on the leg above them and it on where they are:
  // a few rounds settle it.
  LegPose plant(const Frame& frame, const Leg& leg, const FootState& foot) const {
    Frame f = frame;
    const dvec3 home = skeleton_.at[leg.foot], stand = home + foot.offset - dvec3(0, 0, leg.sole);
    LegPose p;
    p.blade = blade_turn(f, leg, home, stand);
    const Placement top = hang(f, leg, p.blade);
    const dvec3 a = skeleton_.offset[leg.bend], b = skeleton_.offset[leg.fold], c = skeleton_.offset[leg.pastern],
                d = skeleton_.offset[leg.foot];
    const dquat planted = about_y(foot.roll);
    p.hoof = planted;
    for (int round = 0; round < 16; ++round) {
      const dvec3 pivot = pitch_of(p.hoof) >= 0 ? leg.toe : leg.heel;
      const dvec3 target = glm::inverse(top.turn) * (stand + pivot - p.hoof * pivot - top.at);
      const auto chain = [&](double bend) {
        return a + about_y(bend) * (b + about_y(fold_of(leg, bend, foot.fold)) * (c + about_y(p.pastern) * d));
      };
      const LegAngles angles = solve_leg(chain, target, range(leg.swing, 1), range(leg.swing, 0), range(leg.bend, 1),
                                         0.0);
      p.pitch = angles.pitch, p.roll = angles.roll, p.bend = angles.bend;
      p.fold = fold_of(leg, p.bend, foot.fold);
      const dquat cannon = top.turn * about_y(p.pitch) * about_x(p.roll) * about_y(p.bend) * about_y(p.fold);
      // In stance the pastern follows a part of the cannon's tilt, sinks under load, and goes with the hoof over the toe.
      const double grounded = -0.65 * pitch_of(cannon) - foot.load + 0.6 * std::max(0.0, foot.roll);
      p.pastern = range(leg.pastern, 1).clamp(glm::mix(foot.pastern, grounded, foot.ground));
      const dquat free = cannon * about_y(p.pastern) * about_y(0.25 * foot.pastern);
      p.hoof = glm::slerp(free, planted, foot.ground);
    }
    return p;
  }

  // Lying on the ground from its fold joint down, or `amount` of the way there from standing as `from` does: the lower leg
  // turns over while the fold joint goes to its place, as high as the skin below it needs and, on the way, a little more.
  LegPose lie(const Frame& frame, const Leg& leg, const RestSpec& r, const LegPose& from, double amount) const {
    dvec3 target = skeleton_.at[leg.fold] + leg_length_ * dvec3(r.at.x, leg.side * r.at.y, 0);
    target.z = 0.1 * leg_length_;
    double pitch = r.pitch_deg * degrees;
    LegPose p = from;
    if (amount < 1) {
      Frame f = frame;
      apply(f, leg, from);
      const Placement fold = place(skeleton_, f, leg.fold);
      target = glm::mix(fold.at, target, amount);
      pitch = glm::mix(pitch_of(fold.turn), pitch, amount);
    }
    const double clearance = amount < 1 ? 0.02 * leg_length_ * std::pow(std::sin(pi * amount), 2) : 0.0;
    for (int round = 0; round < 6; ++round) {
      Frame f = frame;
      p.blade = blade_turn(f, leg, skeleton_.at[leg.fold], target);
      const Placement top = hang(f, leg, p.blade);
      const dvec3 a = skeleton_.offset[leg.bend], b = skeleton_.offset[leg.fold];
      const auto chain = [&](double bend) { return a + about_y(bend) * b; };
      const LegAngles angles = solve_leg(chain, glm::inverse(top.turn) * (target - top.at), range(leg.swing, 1),
                                         range(leg.swing, 0), range(leg.bend, 1), 0.0);
      p.pitch = angles.pitch, p.roll = angles.roll, p.bend = angles.bend;
      const dquat upper = top.turn * about_y(p.pitch) * about_x(p.roll) * about_y(p.bend);
      p.fold = range(leg.fold, 1).clamp(pitch - pitch_of(upper));
      p.pastern = range(leg.pastern, 1).clamp(glm::mix(from.pastern, r.pastern_deg * degrees, amount));
      p.hoof = upper * about_y(p.fold) * about_y(p.pastern);
      if (amount < 1) p.hoof = glm::slerp(from.hoof, p.hoof, smooth(3 * amount));
      apply(f, leg, p, false);
      const std::vector<Placement> placed = place_all(skeleton_, f);
      target.z = placed[leg.fold].at.z + clearance - leg.lower.lowest(skeleton_, placed);
    }
    return p;
  }

  void apply(Frame& f, const Leg& leg, const LegPose& p, bool with_blade = true) const {
    if (with_blade && leg.blade >= 0) f.turn[leg.blade] = f.turn[leg.blade] * about_y(p.blade);
    f.turn[leg.swing] = f.turn[leg.swing] * about_y(p.pitch) * about_x(p.roll);
    f.turn[leg.bend] = about_y(p.bend);
    f.turn[leg.fold] = about_y(p.fold);
    f.turn[leg.pastern] = about_y(p.pastern);
    f.turn[leg.foot] = glm::inverse(place(skeleton_, f, leg.pastern).turn) * p.hoof;
  }

  Frame pose(const ClipSpec& c, const Prepared& prepared, double time) const {
    std::vector<dvec3> angles(rig_.nodes.size(), dvec3(0));
    Frame f = rest_;
    for (const WaveSpec& w : c.waves) {
      const int j = joint(w.joint, c.source);
      const double wave = std::sin(2 * pi * (w.cycles * time + w.phase));
      angles[j] += w.offset_deg + w.amplitude_deg * wave;
      f.shift[j] += leg_length_ * (w.offset + w.amplitude * wave);
    }
    for (const TrackSpec& t : c.tracks) {
      const int j = joint(t.joint, c.source);
      if (!t.rotation_deg.empty()) angles[j] += keyed(t.times, t.rotation_deg, time);
      if (!t.shift.empty()) f.shift[j] += leg_length_ * keyed(t.times, t.shift, time);
    }
    const auto turn_all = [&] {
      for (std::size_t j = 0; j < angles.size(); ++j) f.turn[j] = from_degrees(angles[j]);
    };
    turn_all();
    for (std::size_t i = 0; i < c.reaches.size(); ++i) {
      const ReachSpec& r = c.reaches[i];
      const double amount = keyed(r.times, r.amounts, time);
      if (amount <= 0) continue;
      const std::vector<dvec3> before = angles;
      const auto turn_by = [&](double measure) {
        angles = before;
        for (std::size_t k = 0; k < r.joints.size(); ++k) {
          const int j = joint(r.joints[k], c.source);
          angles[j] = glm::clamp(angles[j] + measure * r.turns_deg[k], lower_[j], upper_[j]);
        }
        turn_all();
      };
      const auto above = [&](double measure) {
        turn_by(measure);
        return prepared.reach[i].lowest(skeleton_, place_all(skeleton_, f)) - r.height * leg_length_;
      };
      // Past straight down a neck comes up again: the first measure that gets there counts, or else the best there is.
      constexpr int measures = 48;
      double low = 0, high = 0, best = above(0);
      for (int k = 1; k <= measures && best > 0; ++k) {
        const double measure = r.most * k / measures, here = above(measure);
        if (here >= best) continue;
        best = here, low = here > 0 ? measure : r.most * (k - 1) / measures, high = measure;
      }
      for (int k = 0; k < 20 && low < high; ++k) {
        const double middle = 0.5 * (low + high);
        (above(middle) > 0 ? low : high) = middle;
      }
      turn_by(amount * 0.5 * (low + high));
    }
    if (c.settle) {
      const double amount = keyed(c.settle->times, c.settle->amounts, time);
      if (amount > 0) f.shift[top_].z -= amount * prepared.settle.lowest(skeleton_, place_all(skeleton_, f));
    }
    for (std::size_t i = 0; i < legs_.size(); ++i) {
      const Leg& leg = legs_[i];
      const FootState foot =
          prepared.gait[i]
              ? gait_foot(*c.gait, *prepared.gait[i], prepared.phase[i], time, leg_length_, leg.side)
              : stepping_foot(prepared.steps[i], time, leg_length_, leg.side);
      double resting = 0;
      const RestSpec* rest = nullptr;
      for (const RestSpec* r : prepared.rests[i])
        if (const double amount = rest_amount(*r, time); amount > resting) resting = amount, rest = r;
      LegPose p;
      if (resting < 1) p = plant(f, leg, foot);
      if (rest) p = lie(f, leg, *rest, p, resting);
      apply(f, leg, p);
    }
    return f;
  }

  Clip to_clip(const ClipSpec& c, const std::vector<Frame>& frames) const {
    Clip clip;
    clip.name = c.name;
    clip.duration = c.duration;
    for (std::size_t j = 0; j < rig_.nodes.size(); ++j) {
      const int parent = skeleton_.parent[j];
      const dmat4 above = parent < 0 ? dmat4(1.0) : world_[parent];
      const dquat axes = decompose(above).rotation;
      const dmat3 into = glm::inverse(dmat3(above));
      const LocalTransform local = local_transform(rig_, neutral_, static_cast<int>(j));
      Channel turn, move;
      turn.node = move.node = static_cast<int>(j);
      turn.path = ChannelPath::rotation, move.path = ChannelPath::translation;
      double turned = 0, moved = 0;
      dquat last(1, 0, 0, 0);
      for (std::size_t k = 0; k < frames.size(); ++k) {
        const double time = c.duration * k / c.keys;
        const dquat& t = frames[k].turn[j];
        dquat q = glm::normalize(glm::conjugate(axes) * t * axes * local.rotation);
        if (glm::dot(q, last) < 0) q = -q;
        last = q;
        turn.times.push_back(time), move.times.push_back(time);
        for (const double v : {q.x, q.y, q.z, q.w}) turn.values.push_back(v);
        const dvec3 at = local.translation + into * frames[k].shift[j];
        for (int i = 0; i < 3; ++i) move.values.push_back(at[i]);
        turned = std::max({turned, std::abs(t.x), std::abs(t.y), std::abs(t.z)});
        moved = std::max(moved, glm::length(frames[k].shift[j]));
      }
      if (turned > 1e-9) clip.channels.push_back(std::move(turn));
      if (moved > 1e-12) clip.channels.push_back(std::move(move));
    }
    return clip;
  }

  // When which foot bears weight.
  ClipPlan plan(const ClipSpec& c, double advance) const {
    const Prepared p = prepare(c);
    ClipPlan out{c.name, c.loops, advance, {}};
    for (std::size_t i = 0; i < legs_.size(); ++i) {
      std::vector<std::pair<double, double>> off;  // when it does not
      if (p.gait[i]) {
        const double lifted = p.phase[i] + c.gait->duty - std::floor(p.phase[i] + c.gait->duty);
        const double landed = lifted + 1 - c.gait->duty;
        off.emplace_back(lifted, std::min(landed, 1.0));
        if (landed > 1) off.emplace_back(0.0, landed - 1);
      }
      for (const StepSpec& s : p.steps[i]) off.emplace_back(s.begin, s.end);
      for (const RestSpec* r : p.rests[i]) off.emplace_back(r->times[0], r->times[3]);
      std::sort(off.begin(), off.end());
      double from = 0;
      off.emplace_back(1.0, 1.0);
      for (const auto& [begin, end] : off) {
        if (begin > from + 1e-9) out.contacts.push_back({legs_[i].foot, from * c.duration, begin * c.duration});
        from = std::max(from, end);
      }
    }
    return out;
  }

  const Rig& rig_;
  Pose neutral_;
  Skeleton skeleton_;
  std::vector<dmat4> world_;
  std::vector<vec3> neutral_skin_;
  std::vector<dvec3> lower_, upper_;  // degrees, per node
  Frame rest_;
  std::vector<Leg> legs_;
  double leg_length_ = 0;  // metres
  int top_ = 0;
};

}  // namespace

Motion build_motion(const std::string& legs_source, const std::vector<LegSpec>& legs,
                    const std::vector<ClipSpec>& clips, const Rig& rig, const Pose& neutral,
                    const std::vector<JointLimit>& limits) {
  Motion motion;
  if (clips.empty()) return motion;
  MotionBuilder builder(legs_source, legs, rig, neutral, limits);
  for (const ClipSpec& c : clips) builder.build(c, motion);
  return motion;
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
