// The study of motion, on what ships and on a rig whose motion is known.
#include "validate/studies/motion.h"

#include <doctest/doctest.h>

#include "generator/core/error.h"

using namespace moomill;

namespace {

const Species& cow() {
  static const Species species = read_species("cow", NnopcsNormalization::box, {});
  return species;
}

double value_of(const StudyResult& r, const std::string& name) {
  for (const Figure& f : r.figures)
    if (f.name == name) return f.value;
  FAIL("no figure ", name);
  return 0;
}

}  // namespace

TEST_CASE("every clip of the cow holds: feet on the ground without sliding, joints within their limits") {
  const StudyResult r = study_motion(cow(), {50});
  CHECK(r.figures.size() == 5 * cow().rig.clips.size());
  for (const Figure& f : r.figures) {
    INFO(f.name, " ", f.value);
    CHECK(f.holds());
  }
}

TEST_CASE("the study sees a foot that slides, floats or sinks, and a joint beyond its limit") {
  Species s = cow();
  const int walk = s.rig.find_clip("walk");
  const auto root = [&](Clip& clip) -> Channel& {
    for (Channel& c : clip.channels)
      if (c.node == 0 && c.path == ChannelPath::translation) return c;
    FAIL("the walk does not move the root");
    return clip.channels[0];
  };
  s.rig.clips = {s.rig.clips[walk]};
  s.clip_plans = {s.clip_plans[walk]};
  const double planted = value_of(study_motion(s, {40}), "walk: slip of a bearing foot");
  Clip kept = s.rig.clips[0];
  Channel& travel = root(s.rig.clips[0]);
  for (std::size_t k = 0; 3 * k < travel.values.size(); ++k)  // 10 cm further along the clip than the feet were planned for
    travel.values[3 * k] += 0.1 * static_cast<double>(k) / static_cast<double>(travel.times.size() - 1);
  const double sliding = value_of(study_motion(s, {40}), "walk: slip of a bearing foot");
  CHECK(sliding - planted == doctest::Approx(0.066).epsilon(0.15));  // the share of the cycle a foot is down
  s.rig.clips[0] = kept;
  Channel& lifted = root(s.rig.clips[0]);
  for (std::size_t k = 0; 3 * k < lifted.values.size(); ++k) lifted.values[3 * k + 2] += 0.03;
  StudyResult r = study_motion(s, {40});
  CHECK(value_of(r, "walk: bearing feet off the ground, at most") == doctest::Approx(0.03).epsilon(0.15));
  for (std::size_t k = 0; 3 * k < lifted.values.size(); ++k) lifted.values[3 * k + 2] -= 0.06;
  r = study_motion(s, {40});
  CHECK(value_of(r, "walk: depth below the ground") == doctest::Approx(0.03).epsilon(0.1));
  s.rig.clips[0] = kept;
  for (JointLimit& l : s.limits)
    if (s.rig.nodes[l.node].name == "left_fore_carpus") l.upper_deg.y = 20;
  CHECK(value_of(study_motion(s, {40}), "walk: joint angles beyond limits") > 3);
}

TEST_CASE("joint angles are those that made the turn, also beyond a right angle and under turned parents") {
  const Species& s = cow();
  for (const JointLimit& limit : s.limits) {
    const int parent = s.rig.nodes[limit.node].parent;
    if (parent < 0) continue;
    Species one = s;
    const dvec3 deg = 0.3 * limit.lower_deg + 0.7 * limit.upper_deg;
    JointLimit only = limit;
    only.usual_lower_deg = only.usual_upper_deg = deg;
    one.limits = {only};
    const JointAngles a = joint_angles(s.rig, s.neutral, sample_within_limits(one, {}), limit);
    INFO(s.rig.nodes[limit.node].name);
    CHECK(a.excess < 1e-6);
    for (int i = 0; i < 3; ++i) CHECK(a.deg[i] == doctest::Approx(deg[i]).epsilon(1e-6).scale(1));
  }
}

TEST_CASE("a clip nobody planned is measured from its mesh: of the walk's 1.4 m hardly anything counts as slip") {
  Species s = cow();
  const int walk = s.rig.find_clip("walk");
  s.rig.clips = {s.rig.clips[walk]};
  s.clip_plans = {};
  const StudyResult r = study_motion(s, {80});
  CHECK(value_of(r, "walk: slip of a bearing foot") < 0.15);  // a foot close over the ground in its swing counts as well
  for (const Figure& f : r.figures) CHECK_FALSE(f.at_most.has_value());
}
