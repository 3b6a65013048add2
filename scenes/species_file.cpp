// Reading a species file (rigs/<species>/<species>.toml, documented in scenes/README.md): where the mesh comes from,
// what its neutral pose, keypoints, skeleton and joint limits are.
#include <set>

#include "scenes/motion_file.h"
#include "scenes/quadruped_file.h"
#include "scenes/scene.h"
#include "generator/core/toml.h"

namespace moomill {
namespace {

namespace fs = std::filesystem;

// A name that can be a folder's on any system.
bool is_plain_name(const std::string& name) {
  return !name.empty() && name.size() <= 64 &&
         name.find_first_not_of(
             "abcdefghijklmnopqrstuvwxyz"
             "ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-") == std::string::npos;
}

std::string plain_name(std::string name) {
  for (char& c : name)
    if (!is_plain_name({c})) c = '_';
  return is_plain_name(name) ? name : "animal";
}

enum class Stand { as_is, ground, centred };

// What every species needs once its rig and neutral pose are there.
void finish_species(Species& species, NnopcsNormalization normalization, Stand stand) {
  Rig& rig = species.rig;
  if (rig.surface.triangles.empty())
    input_error("{} has no triangles, so there is nothing to show; name its meshes by include_meshes", rig.source);
  species.neutral.placement = dmat4(1.0);
  const std::vector<dmat4> world = world_transforms(rig, species.neutral);
  const PosedSurface neutral =
      skin(rig, bone_matrices(rig, world), species.neutral.morph_weights, species.skinning, dvec3(0));
  bake_nnopcs(rig.surface, neutral.positions, normalization);
  const Box& box = rig.surface.neutral_box;
  if (stand == Stand::centred) species.standing = {-box.centre().x, -box.centre().y, -box.lower.z};
  if (stand == Stand::ground) species.standing = {0, 0, -box.lower.z};
}

class SpeciesReader {
 public:
  SpeciesReader(const toml::table& table, const fs::path& file)
      : root_(table, file.string()), folder_(file.parent_path()) {}

  Species read(NnopcsNormalization normalization) {
    s_.name = root_.text("name");
    if (!is_plain_name(s_.name))
      root_.fail("name", "names folders, so it must be made of letters, digits, _ and - only");
    if (root_.has("expected_length_m")) s_.expected_length = root_.number("expected_length_m", 1e-3, 1e4);
    if (root_.has("expected_height_m")) s_.expected_height = root_.number("expected_height_m", 1e-3, 1e4);
    s_.reader_radius = root_.number("reader_radius_m", 1.5, 1e-3, 1e4);
    const bool dual = root_.word("skinning", "linear_blend", {"linear_blend", "dual_quaternion"}) == "dual_quaternion";
    s_.skinning = dual ? SkinningMethod::dual_quaternion : SkinningMethod::linear_blend;
    const bool built = read_source();
    const std::string stand = root_.word("stand", built ? "as_is" : "centred", {"as_is", "ground", "centred"});
    read_neutral();
    read_keypoints();
    s_.edges = read_name_pairs("edges");
    s_.pairs = read_name_pairs("pairs");
    check_pairs(built);
    read_limits();
    for (TomlReader& leg : root_.tables("legs")) legs_.push_back(read_leg(leg));
    root_.finish();
    read_clips();
    finish_species(s_, normalization,
                   stand == "as_is"    ? Stand::as_is
                   : stand == "ground" ? Stand::ground
                                       : Stand::centred);
    return std::move(s_);
  }

 private:
  // True when the rig was built from numbers.
  bool read_source() {
    std::optional<TomlReader> t = root_.table("source");
    if (!t) root_.missing("source", "[source] with file = \"rig.glb\"");
    if (t->has("file") == t->has("builder")) t->refuse("", "[source] must have either 'file' or 'builder'");
    if (t->has("builder")) {
      t->word("builder", "", {"quadruped"});
      t->finish();
      std::optional<TomlReader> numbers = root_.table("builder");
      if (!numbers) root_.missing("builder", "[builder] with the joints and solids of the animal");
      const QuadrupedSpec spec = read_quadruped(*numbers);
      s_.rig = build_quadruped(spec);
      legs_ = spec.legs;
      return true;
    }
    if (root_.has("builder")) root_.fail("builder", "has no effect beside [source] file; leave one of them out");
    LoadOptions options;
    options.scale = t->number("scale", 1, 1e-9, 1e9);
    if (t->has("scene")) options.scene = static_cast<int>(t->integer("scene", 0, 0, 1'000'000));
    if (t->has("include_meshes")) options.include_meshes = t->texts("include_meshes");
    const std::string name = t->text("file");
    const double yaw = t->number("yaw_deg", 0, -360, 360);
    t->finish();
    s_.rig = load_rig(t->at_key("file", [&] { return find_file(name, folder_); }), options);
    if (yaw != 0) turn_rig(s_.rig, yaw);
    return false;
  }

  // Clips of motion files come after those that the rig file has.
  void read_clips() {
    Motion motion = build_motion(root_.file(), legs_, read_motion(folder_ / "motion"), s_.rig, s_.neutral, s_.limits);
    for (const Clip& c : motion.clips)
      if (s_.rig.find_clip(c.name) >= 0)
        input_error("{}: {} has a clip '{}' of its own; rename the file", (folder_ / "motion" / c.name).string() + ".toml",
                    s_.rig.source, c.name);
    std::move(motion.clips.begin(), motion.clips.end(), std::back_inserter(s_.rig.clips));
    s_.clip_plans = std::move(motion.plans);
  }

  int read_joint(TomlReader& t, const std::string& key) {
    const std::string name = t.text(key);
    return t.at_key(key, [&] { return find_joint(s_.rig, name); });
  }

  void read_neutral() {
    s_.neutral = rest_pose(s_.rig);
    std::optional<TomlReader> t = root_.table("neutral");
    if (!t) return;
    if (t->has("clip")) {
      if (t->has("rotations_deg")) t->fail("rotations_deg", "cannot stand beside 'clip'; leave one of them out");
      const std::string name = t->text("clip");
      const int clip = s_.rig.find_clip(name);
      if (clip < 0) {
        std::vector<std::string> names;
        for (const Clip& c : s_.rig.clips) names.push_back(c.name);
        t->refuse("clip", fmt::format("{} has no clip '{}'{}", s_.rig.source, name, suggestion(name, names)));
      }
      s_.neutral = sample_clip(s_.rig, s_.rig.clips[clip], t->number("time_s", 0, 0, 1e6));
    } else if (auto rotations = t->table("rotations_deg")) {
      // The same turns as of the pose sampler, with limits that leave one value.
      Species turned;
      turned.rig = s_.rig;
      turned.neutral = s_.neutral;
      for (const std::string& joint : rotations->keys()) {
        const int node = rotations->at_key(joint, [&] { return find_joint(s_.rig, joint); });
        const dvec3 angles = rotations->vector3(joint);
        turned.limits.push_back({node, angles, angles});
      }
      s_.neutral = sample_within_limits(turned, {});
    }
    t->finish();
  }

  void read_keypoints() {
    Pose neutral = s_.neutral;
    neutral.placement = dmat4(1.0);
    const std::vector<dmat4> world = world_transforms(s_.rig, neutral);
    for (TomlReader& t : root_.tables("keypoints")) {
      Keypoint k;
      k.name = t.text("name");
      for (const Keypoint& other : s_.keypoints)
        if (other.name == k.name)
          t.fail("name", fmt::format("'{}' is that of an earlier keypoint too; rename one", k.name));
      if (t.has("joint") == t.has("triangle"))
        t.refuse("name", fmt::format("keypoint '{}' must have either 'joint' or 'triangle'", k.name));
      if (t.has("joint"))
        k.anchor = read_joint_anchor(t, world);
      else
        k.anchor = read_surface_anchor(t);
      k.tolerance = t.number("tolerance_m", k.tolerance, 0, 100);
      t.finish();
      s_.keypoints.push_back(std::move(k));
    }
  }

  JointAnchor read_joint_anchor(TomlReader& t, const std::vector<dmat4>& world) {
    JointAnchor a;
    a.node = read_joint(t, "joint");
    if (t.has("at") && t.has("offset")) t.fail("offset", "cannot stand beside 'at'; leave one of them out");
    if (t.has("at"))
      a.neutral = t.vector3("at");
    else
      a.neutral = dvec3(world[a.node][3]) + t.vector3("offset", dvec3(0));
    return a;
  }

  SurfaceAnchor read_surface_anchor(TomlReader& t) {
    SurfaceAnchor a;
    const auto count = static_cast<std::int64_t>(s_.rig.surface.triangles.size());
    a.triangle = static_cast<std::uint32_t>(t.integer("triangle", 0, 0, std::max<std::int64_t>(0, count - 1)));
    const std::vector<double> b = t.numbers("barycentrics");
    if (b.size() != 2 || b[0] < 0 || b[1] < 0 || b[0] + b[1] > 1 + 1e-9)
      t.fail("barycentrics",
             "must be two numbers of at least 0, of the triangle's second and third vertex, that sum "
             "to at most 1");
    a.barycentrics = {b[0], b[1]};
    return a;
  }

  int find_keypoint(const std::string& key, const std::string& name) {
    std::vector<std::string> names;
    for (std::size_t i = 0; i < s_.keypoints.size(); ++i) {
      if (s_.keypoints[i].name == name) return static_cast<int>(i);
      names.push_back(s_.keypoints[i].name);
    }
    root_.fail(key, fmt::format("names '{}', which is no keypoint{}", name, suggestion(name, names)));
  }

  std::vector<std::pair<int, int>> read_name_pairs(const std::string& key) {
    std::vector<std::pair<int, int>> out;
    const toml::node* node = root_.node(key);
    if (!node) return out;
    const toml::array* list = node->as_array();
    if (!list) root_.fail(key, "must be a list of pairs, [[\"nose\", \"poll\"], ...]");
    for (const toml::node& e : *list) {
      const toml::array* two = e.as_array();
      if (!two || two->size() != 2 || !(*two)[0].is_string() || !(*two)[1].is_string())
        root_.fail(key, "must hold pairs of keypoint names, [\"nose\", \"poll\"]");
      const std::string a = (*two)[0].as_string()->get(), b = (*two)[1].as_string()->get();
      if (a == b) root_.fail(key, fmt::format("pairs '{}' with itself", a));
      const int first = find_keypoint(key, a);
      out.emplace_back(first, find_keypoint(key, b));
    }
    return out;
  }

  // With names as the builder gives them, every left keypoint has its right one, and the two are a pair.
  void check_pairs(bool built) {
    std::set<int> seen;
    for (const auto& [left, right] : s_.pairs)
      for (const int k : {left, right})
        if (!seen.insert(k).second)
          root_.fail("pairs", fmt::format("names '{}' twice; a keypoint has one counterpart", s_.keypoints[k].name));
    if (!built) return;
    for (std::size_t k = 0; k < s_.keypoints.size(); ++k) {
      const std::string& name = s_.keypoints[k].name;
      const std::string other = mirror_name(name);
      if (other == name) continue;
      if (std::none_of(s_.keypoints.begin(), s_.keypoints.end(), [&](auto& p) { return p.name == other; }))
        root_.fail("keypoints", fmt::format("hold '{}' but not its counterpart '{}'; add it", name, other));
      if (!seen.count(static_cast<int>(k)))
        root_.fail("pairs", fmt::format("lack '{}' and '{}'; add [\"{}\", \"{}\"]", name, other, name, other));
    }
  }

  void read_limits() {
    std::set<int> seen;
    for (TomlReader& t : root_.tables("limits")) {
      JointLimit l;
      l.node = read_joint(t, "joint");
      if (!seen.insert(l.node).second) t.fail("joint", "has limits already; keep one of the two");
      l.lower_deg = t.vector3("lower_deg");
      l.upper_deg = t.vector3("upper_deg");
      for (int i = 0; i < 3; ++i) {
        if (l.lower_deg[i] > l.upper_deg[i])
          t.fail("lower_deg",
                 fmt::format("is above upper_deg about {}: {} > {}", "xyz"[i], l.lower_deg[i], l.upper_deg[i]));
        if (l.lower_deg[i] < -360 || l.upper_deg[i] > 360)
          t.fail("lower_deg", "and upper_deg must lie from -360 to 360");
      }
      if (t.has("usual_lower_deg") || t.has("usual_upper_deg")) {
        l.usual_lower_deg = t.vector3("usual_lower_deg", l.lower_deg);
        l.usual_upper_deg = t.vector3("usual_upper_deg", l.upper_deg);
        for (int i = 0; i < 3; ++i)
          if (!(l.lower_deg[i] <= (*l.usual_lower_deg)[i] && (*l.usual_lower_deg)[i] <= (*l.usual_upper_deg)[i] &&
                (*l.usual_upper_deg)[i] <= l.upper_deg[i]))
            t.fail("usual_lower_deg", fmt::format("and usual_upper_deg must lie within the limits about {}", "xyz"[i]));
      }
      t.finish();
      s_.limits.push_back(l);
    }
  }

  Species s_;
  TomlReader root_;
  fs::path folder_;
  std::vector<LegSpec> legs_;
};

}  // namespace

Species read_species(const std::string& name_or_path, NnopcsNormalization normalization, const fs::path& relative_to) {
  const fs::path file = find_species(name_or_path, relative_to);
  if (file.extension() == ".toml") {
    const toml::table table = TomlReader::parse(file);
    return SpeciesReader(table, file).read(normalization);
  }
  Species species;
  species.name = plain_name(file.stem().string());
  species.rig = load_rig(file);
  species.neutral = rest_pose(species.rig);
  finish_species(species, normalization, Stand::centred);
  return species;
}

}  // namespace moomill
