#include "scenes/quadruped_file.h"

#include "scenes/parts_file.h"

namespace moomill {
namespace {

constexpr double far = 100;  // metres; no animal is larger

using Joints = std::vector<QuadrupedJoint>;

// Where the joint is, twins of mirrored ones included.
dvec3 joint_place(const TomlReader& r, const std::string& key, const Joints& joints, const std::string& name) {
  std::vector<std::string> names;
  for (const QuadrupedJoint& j : joints) {
    if (j.name == name) return j.at;
    names.push_back(j.name);
    if (j.mirror && mirror_name(j.name) == name) return {j.at.x, -j.at.y, j.at.z};
  }
  r.fail(key, fmt::format("names '{}', which is no joint{}", name, suggestion(name, names)));
}

// Fills the place; returns the joint that moves the bone, empty for a section with `at`.
std::string read_place(TomlReader& r, const Joints& joints, SolidSection& s) {
  if (r.has("at") == r.has("along"))
    r.fail(r.has("at") ? "along" : "at", "or the other of 'at' and 'along' must be there, and only one of them");
  if (r.has("at")) {
    s.at = r.vector3("at");
    return "";
  }
  const std::vector<std::string> bone = r.texts("along");
  if (bone.size() != 2) r.fail("along", "must be two joints, [from, to]");
  const dvec3 from = joint_place(r, "along", joints, bone[0]), to = joint_place(r, "along", joints, bone[1]);
  s.at = from + r.number("t", -10, 10) * (to - from) + r.vector3("offset", dvec3(0));
  return bone[0];
}

void read_size(TomlReader& r, SolidSection& s) {
  if (r.has("width_m") || r.has("depth_m")) {
    if (r.has("radii")) r.fail("radii", "cannot stand beside 'width_m' and 'depth_m'; leave one of them out");
    s.side = 0.5 * r.number("width_m", 1e-4, far);
    s.up = s.down = 0.5 * r.number("depth_m", 1e-4, far);
    return;
  }
  const std::vector<double> radii = r.numbers("radii");
  if (radii.empty() || radii.size() > 3) r.fail("radii", "must be [all], [side, up] or [side, up, down], in metres");
  for (const double v : radii)
    if (!(v >= 1e-4 && v < far)) r.fail("radii", fmt::format("must be from 0.0001 to {:.0f} metres each, not {}", far, v));
  s.side = radii[0];
  s.up = radii.size() > 1 ? radii[1] : radii[0];
  s.down = radii.size() > 2 ? radii[2] : s.up;
}

SolidSection read_section(TomlReader r, const Joints& joints, bool bone_moves) {
  SolidSection s;
  const std::string bone = read_place(r, joints, s);
  read_size(r, s);
  s.power = r.number("power", 2, 2, 8);
  s.joint = r.text("joint", bone_moves ? bone : "");
  s.part = r.text("part", "");
  r.finish();
  return s;
}

Solid read_solid(TomlReader r, const Joints& joints) {
  Solid s;
  s.name = r.text("name");
  const std::string kind = r.word("kind", "add", {"add", "carve", "paint"});
  s.kind = kind == "carve" ? Solid::Kind::carve : kind == "paint" ? Solid::Kind::paint : Solid::Kind::add;
  s.blend = r.number("blend_m", 0.03, 1e-4, 1);
  s.detail = r.number("detail", 1, 0.05, 10);
  s.up = r.vector3("up", s.up);
  if (glm::length(s.up) < 1e-6) r.fail("up", "must not be zero");
  s.up = glm::normalize(s.up);
  s.mirror = r.boolean("mirror", false);
  const std::string part = r.text("part", ""), joint = r.text("joint", "");
  for (TomlReader& section : r.tables("sections"))
    s.sections.push_back(read_section(section, joints, joint.empty()));
  if (s.sections.empty()) r.fail("sections", "is missing or empty; give at least one section");
  if (s.sections[0].part.empty()) s.sections[0].part = part;
  if (s.sections[0].joint.empty()) s.sections[0].joint = joint;
  for (std::size_t i = 1; i < s.sections.size(); ++i)
    if (glm::length(s.sections[i].at - s.sections[i - 1].at) < 1e-4)
      r.fail("sections", fmt::format("{} and {} are at the same place; move one", i - 1, i));
  // Unless told, caps are as round as the ends are thick.
  const auto cap = [&](const SolidSection& e) { return std::min(e.side, 0.5 * (e.up + e.down)); };
  s.cap_start = r.number("cap_start_m", r.number("cap_m", cap(s.sections.front()), 1e-4, far), 1e-4, far);
  s.cap_end = r.number("cap_end_m", r.number("cap_m", cap(s.sections.back()), 1e-4, far), 1e-4, far);
  r.finish();
  return s;
}

}  // namespace

LegSpec read_leg(TomlReader r) {
  LegSpec l;
  l.blade = r.text("blade", "");
  l.swing = r.text("swing");
  l.bend = r.text("bend");
  l.fold = r.text("fold");
  l.pastern = r.text("pastern");
  l.foot = r.text("foot");
  l.couple = r.number("couple", 0, -4, 4);
  l.blade_share = r.number("blade_share", l.blade_share, 0, 1);
  l.mirror = r.boolean("mirror", true);
  r.finish();
  return l;
}

QuadrupedSpec read_quadruped(TomlReader r) {
  QuadrupedSpec spec;
  spec.source = r.file();
  spec.target_edge = r.number("target_edge_m", spec.target_edge, 0.002, 1);
  spec.grid = r.number("grid_m", spec.grid, 0.002, 1);
  spec.gutter = r.number("gutter", spec.gutter, 0, 0.1);
  spec.handles = static_cast<int>(r.integer("handles", 0, 0, 1000));
  for (TomlReader& j : r.tables("joints")) {
    QuadrupedJoint joint;
    joint.name = j.text("name");
    joint.parent = j.text("parent", "");
    joint.at = j.vector3("at");
    joint.mirror = j.boolean("mirror", false);
    if (joint.mirror && mirror_name(joint.name) == joint.name)
      j.fail("mirror", "needs a name with 'left' in it or ending in '_l', so that its twin can have one too");
    j.finish();
    spec.joints.push_back(std::move(joint));
  }
  for (TomlReader& solid : r.tables("solids")) spec.solids.push_back(read_solid(solid, spec.joints));
  std::vector<PartSpec> parts;
  for (TomlReader& part : r.tables("parts")) parts.push_back(read_part(part));
  if (!parts.empty()) {
    const std::vector<Solid> solids = expand_parts(parts, spec);
    spec.solids.insert(spec.solids.end(), solids.begin(), solids.end());
  }
  spec.scale = r.number("scale", 1, 0.01, 100);
  for (TomlReader& leg : r.tables("legs")) spec.legs.push_back(read_leg(leg));
  if (r.has("clips")) r.fail("clips", "has moved: one file a clip in the folder 'motion' beside this file");
  r.finish();
  return spec;
}

}  // namespace moomill
