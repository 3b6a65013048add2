#include "scenes/motion_file.h"

#include <algorithm>

#include "generator/core/toml.h"

namespace moomill {
namespace {

namespace fs = std::filesystem;

constexpr double far = 10;  // leg lengths

// Ascending shares of the clip.
std::vector<double> read_times(TomlReader& r) {
  const std::vector<double> times = r.numbers("times");
  if (times.empty()) r.fail("times", "is empty; give at least one share of the clip, from 0 to 1");
  for (std::size_t i = 0; i < times.size(); ++i)
    if (times[i] < 0 || times[i] > 1 || (i > 0 && times[i] <= times[i - 1]))
      r.fail("times", "must ascend within [0, 1]; they are shares of the clip");
  return times;
}

// Three numbers per time; empty when the key is absent.
std::vector<dvec3> read_keys(TomlReader& r, const std::string& key, std::size_t times) {
  std::vector<dvec3> out;
  if (!r.has(key)) return out;
  const std::vector<double> values = r.numbers(key);
  if (values.size() != 3 * times)
    r.fail(key, fmt::format("must hold three numbers for each of the {} times, {} in all, not {}", times, 3 * times,
                            values.size()));
  for (std::size_t i = 0; i < values.size(); i += 3) out.emplace_back(values[i], values[i + 1], values[i + 2]);
  return out;
}

std::vector<double> read_amounts(TomlReader& r, std::size_t times) {
  const std::vector<double> amounts = r.numbers("amounts");
  if (amounts.size() != times)
    r.fail("amounts", fmt::format("must hold one number for each of the {} times, not {}", times, amounts.size()));
  for (const double a : amounts)
    if (!(a >= 0 && a <= 1)) r.fail("amounts", "must lie from 0 to 1");
  return amounts;
}

dvec2 read_forward_outward(TomlReader& r, const std::string& key, bool required) {
  if (!required && !r.has(key)) return dvec2(0);
  const std::vector<double> v = r.numbers(key);
  if (v.size() != 2 || std::abs(v[0]) > far || std::abs(v[1]) > far)
    r.fail(key, "must be [forward, outward] in leg lengths, e.g. [0.1, 0.05]");
  return {v[0], v[1]};
}

WaveSpec read_wave(TomlReader r) {
  WaveSpec w;
  w.joint = r.text("joint");
  w.amplitude_deg = r.vector3("amplitude_deg", w.amplitude_deg);
  w.offset_deg = r.vector3("offset_deg", w.offset_deg);
  w.amplitude = r.vector3("amplitude", w.amplitude);
  w.offset = r.vector3("offset", w.offset);
  w.cycles = static_cast<int>(r.integer("cycles", 1, 1, 1000));
  w.phase = r.number("phase", 0, -1, 1);
  r.finish();
  return w;
}

TrackSpec read_track(TomlReader r) {
  TrackSpec t;
  t.joint = r.text("joint");
  t.times = read_times(r);
  t.rotation_deg = read_keys(r, "rotation_deg", t.times.size());
  t.shift = read_keys(r, "shift", t.times.size());
  if (t.rotation_deg.empty() && t.shift.empty()) r.missing("rotation_deg", "rotation_deg = [0, 0, 0,  0, 10, 0]");
  r.finish();
  return t;
}

GaitLegs read_gait_legs(TomlReader r) {
  GaitLegs g;
  g.feet = r.texts("feet");
  g.phases = r.numbers("phases");
  if (g.feet.empty() || g.phases.size() != g.feet.size())
    r.fail("phases", fmt::format("must hold one number for each of the {} feet, not {}", g.feet.size(),
                                 g.phases.size()));
  g.lift = r.number("lift", g.lift, 0, 1);
  g.fold_deg = r.number("fold_deg", g.fold_deg, -150, 150);
  g.pastern_deg = r.number("pastern_deg", g.pastern_deg, -150, 150);
  g.load_deg = r.number("load_deg", g.load_deg, -60, 60);
  g.toe_deg = r.number("toe_deg", g.toe_deg, 0, 90);
  g.heel_deg = r.number("heel_deg", g.heel_deg, 0, 45);
  g.at = read_forward_outward(r, "at", false);
  r.finish();
  return g;
}

GaitSpec read_gait(TomlReader r) {
  GaitSpec g;
  g.stride = r.number("stride", 0, far);
  g.duty = r.number("duty", 0.05, 0.95);
  for (TomlReader& legs : r.tables("legs")) g.legs.push_back(read_gait_legs(legs));
  if (g.legs.empty()) r.missing("legs", "[[gait.legs]] with feet and phases");
  r.finish();
  return g;
}

StepSpec read_step(TomlReader r) {
  StepSpec s;
  s.foot = r.text("foot");
  const std::vector<double> times = read_times(r);
  if (times.size() != 2) r.fail("times", "must be [begin, end] of the step");
  s.begin = times[0], s.end = times[1];
  s.to = read_forward_outward(r, "to", true);
  s.lift = r.number("lift", s.lift, 0, 1);
  r.finish();
  return s;
}

RestSpec read_rest(TomlReader r) {
  RestSpec s;
  s.foot = r.text("foot");
  s.times = r.numbers("times");
  if (s.times.size() != 4 || !std::is_sorted(s.times.begin(), s.times.end()) || s.times.front() < 0 ||
      s.times.back() > 1)
    r.fail("times", "must be the four shares, in order, when the leg begins to fold, lies, begins to unfold, stands");
  s.at = read_forward_outward(r, "at", false);
  s.pitch_deg = r.number("pitch_deg", s.pitch_deg, -180, 180);
  s.pastern_deg = r.number("pastern_deg", s.pastern_deg, -150, 150);
  r.finish();
  return s;
}

ReachSpec read_reach(TomlReader r) {
  ReachSpec s;
  s.joint = r.text("joint");
  s.times = read_times(r);
  s.amounts = read_amounts(r, s.times.size());
  s.height = r.number("height", s.height, 0, far);
  s.most = r.number("most", s.most, 0, 100);
  for (TomlReader& turn : r.tables("turns")) {
    s.joints.push_back(turn.text("joint"));
    s.turns_deg.push_back(turn.vector3("rotation_deg"));
    turn.finish();
  }
  if (s.joints.empty()) r.missing("turns", "turns = [{ joint = \"neck\", rotation_deg = [0, 40, 0] }]");
  r.finish();
  return s;
}

ClipSpec read_clip(TomlReader r, const std::string& name) {
  ClipSpec c;
  c.source = r.file();
  c.name = name;
  c.duration = r.number("duration_s", 0.01, 3600);
  c.keys = static_cast<int>(r.integer("keys", c.keys, 2, 100000));
  c.loops = r.boolean("loops", c.loops);
  c.in_place = r.boolean("in_place", c.in_place);
  for (TomlReader& wave : r.tables("waves")) c.waves.push_back(read_wave(wave));
  for (TomlReader& track : r.tables("tracks")) c.tracks.push_back(read_track(track));
  if (auto gait = r.table("gait")) c.gait = read_gait(*gait);
  for (TomlReader& step : r.tables("steps")) c.steps.push_back(read_step(step));
  for (TomlReader& rest : r.tables("rests")) c.rests.push_back(read_rest(rest));
  for (TomlReader& reach : r.tables("reaches")) c.reaches.push_back(read_reach(reach));
  if (auto settle = r.table("settle")) {
    SettleSpec s;
    s.joints = settle->texts("joints");
    s.times = read_times(*settle);
    s.amounts = read_amounts(*settle, s.times.size());
    settle->finish();
    c.settle = s;
  }
  r.finish();
  return c;
}

}  // namespace

std::vector<ClipSpec> read_motion(const fs::path& folder) {
  std::error_code ignored;
  std::vector<fs::path> files;
  for (const fs::directory_entry& e : fs::directory_iterator(folder, ignored))
    if (e.path().extension() == ".toml") files.push_back(e.path());
  std::sort(files.begin(), files.end());  // the same order on every machine
  std::vector<ClipSpec> clips;
  for (const fs::path& file : files) {
    const toml::table table = TomlReader::parse(file);
    clips.push_back(read_clip(TomlReader(table, file.string()), file.stem().string()));
  }
  return clips;
}

}  // namespace moomill
