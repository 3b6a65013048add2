#include "scenes/motion_file.h"

#include <algorithm>

#include "scenes/toml.h"

namespace moomill {
namespace {

namespace fs = std::filesystem;

constexpr double far = 100;  // metres; no animal is larger

WaveSpec read_wave(TomlReader r) {
  WaveSpec w;
  w.joint = r.text("joint");
  w.amplitude_deg = r.vector3("amplitude_deg", w.amplitude_deg);
  w.offset_deg = r.vector3("offset_deg", w.offset_deg);
  w.amplitude_m = r.vector3("amplitude_m", w.amplitude_m);
  w.offset_m = r.vector3("offset_m", w.offset_m);
  w.cycles = static_cast<int>(r.integer("cycles", 1, 1, 1000));
  w.phase = r.number("phase", 0, -1, 1);
  r.finish();
  return w;
}

TrackSpec read_track(TomlReader r) {
  TrackSpec t;
  t.joint = r.text("joint");
  t.times = r.numbers("times");
  for (std::size_t i = 0; i < t.times.size(); ++i)
    if (t.times[i] < 0 || t.times[i] > 1 || (i > 0 && t.times[i] <= t.times[i - 1]))
      r.fail("times", "must ascend within [0, 1]; they are shares of the clip");
  const std::vector<double> angles = r.numbers("rotation_deg");
  if (angles.size() != 3 * t.times.size())
    r.fail("rotation_deg", fmt::format("must hold three angles for each of the {} times, {} numbers, not {}",
                                       t.times.size(), 3 * t.times.size(), angles.size()));
  for (std::size_t i = 0; i < angles.size(); i += 3)
    t.rotation_deg.emplace_back(angles[i], angles[i + 1], angles[i + 2]);
  r.finish();
  return t;
}

GaitSpec read_gait(TomlReader r) {
  GaitSpec g;
  g.stride = r.number("stride_m", g.stride, 0, far);
  g.duty = r.number("duty", g.duty, 0.05, 0.95);
  g.lift = r.number("lift_m", g.lift, 0, far);
  g.fold_deg = r.number("fold_deg", g.fold_deg, 0, 150);
  g.pastern_deg = r.number("pastern_deg", g.pastern_deg, -150, 150);
  g.blade_deg = r.number("blade_deg", g.blade_deg, -90, 90);
  g.phases = r.numbers("phases");
  r.finish();
  return g;
}

ClipSpec read_clip(TomlReader r, const std::string& name) {
  ClipSpec c;
  c.source = r.file();
  c.name = name;
  c.duration = r.number("duration_s", 1, 0.01, 3600);
  c.keys = static_cast<int>(r.integer("keys", 24, 2, 100000));
  for (TomlReader& wave : r.tables("waves")) c.waves.push_back(read_wave(wave));
  for (TomlReader& track : r.tables("tracks")) c.tracks.push_back(read_track(track));
  if (auto gait = r.table("gait")) c.gait = read_gait(*gait);
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
