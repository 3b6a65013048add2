#include "scenes/bind_file.h"

#include "rigs/motion.h"
#include "scenes/motion_file.h"
#include "scenes/quadruped_file.h"
#include "scenes/scene.h"
#include "generator/core/toml.h"

namespace moomill {
namespace {

namespace fs = std::filesystem;

// The legs a species file describes, in its builder or of their own.
std::vector<LegSpec> legs_of(const fs::path& file) {
  const toml::table table = TomlReader::parse(file);
  TomlReader reader(table, file.string());
  if (auto builder = reader.table("builder")) return read_quadruped(*builder).legs;
  std::vector<LegSpec> legs;
  for (TomlReader& leg : reader.tables("legs")) legs.push_back(read_leg(leg));
  return legs;
}

// Of clips that came with a rig file the turns carry over; shifts belong to bones of other lengths.
void copy_turns(const Rig& from, Rig& to) {
  for (const Clip& clip : from.clips) {
    Clip turns;
    turns.name = clip.name;
    turns.duration = clip.duration;
    for (const Channel& c : clip.channels)
      if (c.path == ChannelPath::rotation) turns.channels.push_back(c);
    if (!turns.channels.empty()) to.clips.push_back(std::move(turns));
  }
}

dvec3 read_point(TomlReader& t, const std::string& key) {
  const dvec3 p = t.vector3(key);
  if (!all_finite(p)) t.fail(key, "must be three finite numbers, x, y, z in the mesh's units");
  return p;
}

std::string vector_text(const dvec3& v) {
  return fmt::format("[{:.9g}, {:.9g}, {:.9g}]", v.x, v.y, v.z);
}

}  // namespace

BoundScan bind_scan_file(const fs::path& mesh, const fs::path& keypoints) {
  const toml::table table = TomlReader::parse(keypoints);
  TomlReader root(table, keypoints.string());
  BindSpec spec;
  spec.source = keypoints.string();
  const std::string name = root.text("species");
  if (root.has("yaw_deg")) spec.yaw_deg = root.number("yaw_deg", -360, 360);
  if (root.has("height_m")) spec.height = root.number("height_m", 1e-3, 1e3);
  const fs::path species_file = root.at_key("species", [&] { return find_species(name, keypoints.parent_path()); });
  if (species_file.extension() != ".toml")
    root.fail("species", "must be a species with keypoints, not a bare rig file");
  auto clicked = root.table("keypoints");
  if (!clicked) root.missing("keypoints", "[keypoints] with nose = [x, y, z], ...");
  auto joints = root.table("joints");
  root.finish();

  const Species base = read_species(species_file.string(), NnopcsNormalization::box, {});
  std::vector<std::string> known, missing;
  for (const Keypoint& k : base.keypoints) {
    known.push_back(k.name);
    if (!clicked->has(k.name)) missing.push_back(k.name);
  }
  for (const std::string& key : clicked->keys())
    if (std::find(known.begin(), known.end(), key) == known.end())
      clicked->fail(key, fmt::format("is no keypoint of {}{}", base.name, suggestion(key, known)));
  if (!missing.empty()) {
    std::string list;
    for (const std::string& m : missing) list += (list.empty() ? "'" : ", '") + m + "'";
    root.refuse("keypoints", fmt::format("[keypoints] lacks {}; click all {} keypoints of {}", list, known.size(), base.name));
  }
  for (const std::string& k : known) spec.keypoints.push_back(read_point(*clicked, k));
  if (joints) {
    for (const std::string& key : joints->keys()) {
      joints->at_key(key, [&] { return find_joint(base.rig, key); });
      spec.joints.emplace_back(key, read_point(*joints, key));
    }
  }
  BoundScan bound = bind_scan(load_rig(mesh), base, spec);
  const std::vector<LegSpec> legs = legs_of(species_file);
  Species& s = bound.species;
  const std::vector<ClipSpec> clips = read_motion(species_file.parent_path() / "motion");
  if (!legs.empty() && !clips.empty())
    s.rig.clips = build_motion(species_file.string(), legs, clips, s.rig, s.neutral, s.limits).clips;
  else
    copy_turns(base.rig, s.rig);
  return bound;
}

std::string bound_species_toml(const BoundScan& bound, const std::string& name, const std::string& rig_file,
                               const std::string& made_from) {
  const Species& s = bound.species;
  std::string t = fmt::format(
      "# Written by `moomill rig bind` from {}; skeleton, limits and motion are those of {}.\n"
      "name = \"{}\"\nexpected_length_m = {:.4f}\nexpected_height_m = {:.4f}\nreader_radius_m = {:.9g}\nskinning = \"{}\"\n"
      "stand = \"as_is\"\n",
      made_from, s.name, name, *s.expected_length, *s.expected_height, s.reader_radius,
      s.skinning == SkinningMethod::dual_quaternion ? "dual_quaternion" : "linear_blend");
  const auto pairs = [&](const char* key, const std::vector<std::pair<int, int>>& list) {
    t += fmt::format("{} = [\n", key);
    for (const auto& [a, b] : list) t += fmt::format("  [\"{}\", \"{}\"],\n", s.keypoints[a].name, s.keypoints[b].name);
    t += "]\n";
  };
  pairs("edges", s.edges);
  pairs("pairs", s.pairs);
  t += fmt::format("\n[source]\nfile = \"{}\"\n", rig_file);
  for (const Keypoint& k : s.keypoints) {
    const auto& anchor = std::get<JointAnchor>(k.anchor);
    t += fmt::format("\n[[keypoints]]\nname = \"{}\"\njoint = \"{}\"\nat = {}\ntolerance_m = {:.9g}\n", k.name,
                     s.rig.nodes[anchor.node].name, vector_text(anchor.neutral), k.tolerance);
  }
  for (const JointLimit& l : s.limits)
    t += fmt::format("\n[[limits]]\njoint = \"{}\"\nlower_deg = {}\nupper_deg = {}\n", s.rig.nodes[l.node].name,
                     vector_text(l.lower_deg), vector_text(l.upper_deg));
  return t;
}

}  // namespace moomill
