#include "scenes/parts_file.h"

namespace moomill {
namespace {

constexpr double far = 10;  // metres; no part is larger

EyePart read_eye(TomlReader& r) {
  EyePart e;
  e.length = r.number("length_m", e.length, 1e-3, far);
  e.height = r.number("height_m", 0.66 * e.length, 1e-3, far);
  e.bulge = r.number("bulge_m", 0.22 * e.length, 0, far);
  e.slant_deg = r.number("slant_deg", e.slant_deg, -90, 90);
  e.brow = r.number("brow_m", 0.18 * e.length, 0, far);
  return e;
}

EarPart read_ear(TomlReader& r) {
  EarPart e;
  e.length = r.number("length_m", e.length, 1e-3, far);
  e.width = r.number("width_m", 0.5 * e.length, 1e-3, far);
  e.set_deg = r.number("set_deg", e.set_deg, -90, 90);
  e.forward_deg = r.number("forward_deg", e.forward_deg, -90, 90);
  e.opening_deg = r.number("opening_deg", e.opening_deg, -180, 180);
  e.cup = r.number("cup_m", 0.18 * e.width, 0, far);
  e.thickness = r.number("thickness_m", e.thickness, 1e-3, far);
  e.tip = r.number("tip", e.tip, 0.05, 1);
  return e;
}

NostrilPart read_nostril(TomlReader& r) {
  NostrilPart n;
  n.length = r.number("length_m", n.length, 1e-3, far);
  n.width = r.number("width_m", 0.5 * n.length, 1e-3, far);
  n.depth = r.number("depth_m", 0.45 * n.length, 1e-3, far);
  n.slant_deg = r.number("slant_deg", n.slant_deg, -180, 180);
  n.flare = r.number("flare_m", 0.08 * n.length, 0, far);
  return n;
}

HoofPart read_hoof(TomlReader& r) {
  HoofPart h;
  h.cloven = r.word("claws", "cloven", {"cloven", "single"}) == "cloven";
  h.width = r.number("width_m", h.width, 1e-3, far);
  h.length = r.number("length_m", h.length, 1e-3, far);
  h.height = r.number("height_m", h.height, 1e-3, far);
  h.toe_deg = r.number("toe_deg", h.toe_deg, 20, 89);
  h.cleft = r.number("cleft_m", h.cleft, 0, far);
  if (h.cloven && h.cleft >= 0.8 * h.width) r.fail("cleft_m", "leaves no width for the claws; make it smaller");
  h.coronet = r.number("coronet_m", h.coronet, 0, 0.1);
  return h;
}

DewclawPart read_dewclaws(TomlReader& r) {
  DewclawPart d;
  d.size = r.number("size_m", d.size, 1e-3, far);
  d.spacing = r.number("spacing_m", d.spacing, 1e-3, far);
  return d;
}

MouthPart read_mouth(TomlReader& r) {
  MouthPart m;
  m.length = r.number("length_m", m.length, 1e-3, far);
  m.width = r.number("width_m", m.width, 1e-3, far);
  m.slant_deg = r.number("slant_deg", m.slant_deg, -90, 90);
  m.gape = r.number("gape_m", m.gape, 1e-3, far);
  m.depth = r.number("depth_m", m.depth, 1e-3, far);
  return m;
}

HornPart read_horn(TomlReader& r, bool ossicone) {
  HornPart h;
  if (ossicone) h.length = 0.15, h.thickness = 0.055, h.set_deg = 70, h.curve_deg = 0, h.tip = 0.7, h.knob = 0.06;
  h.length = r.number("length_m", h.length, 1e-3, far);
  h.thickness = r.number("thickness_m", h.thickness, 1e-3, far);
  h.set_deg = r.number("set_deg", h.set_deg, -90, 90);
  h.forward_deg = r.number("forward_deg", h.forward_deg, -180, 180);
  h.curve_deg = r.number("curve_deg", h.curve_deg, -360, 360);
  h.tip = r.number("tip", h.tip, 0.05, 1);
  h.knob = ossicone ? r.number("knob_m", h.knob, 1e-3, far) : 0;
  return h;
}

BonePart read_bone(TomlReader& r) {
  BonePart b;
  b.size = r.number("size_m", b.size, 1e-3, far);
  b.out = r.number("out_m", 0.25 * b.size, 0, far);
  b.blend = r.number("blend_m", b.blend, 1e-3, 1);
  return b;
}

DewlapPart read_dewlap(TomlReader& r) {
  DewlapPart d;
  d.to_joint = r.text("to_joint");
  d.to_offset = r.vector3("to_offset", d.to_offset);
  d.depth = r.number("depth_m", d.depth, 1e-3, far);
  d.thickness = r.number("thickness_m", d.thickness, 1e-3, far);
  return d;
}

UdderPart read_udder(TomlReader& r) {
  UdderPart u;
  u.length = r.number("length_m", u.length, 1e-3, far);
  u.width = r.number("width_m", u.width, 1e-3, far);
  u.depth = r.number("depth_m", u.depth, 1e-3, far);
  u.teats = static_cast<int>(r.integer("teats", u.teats, 0, 4));
  if (u.teats != 0 && u.teats != 2 && u.teats != 4) r.fail("teats", "must be 0, 2 or 4");
  u.teat = r.number("teat_m", u.teat, 1e-3, far);
  return u;
}

TailPart read_tail(TomlReader& r) {
  TailPart t;
  t.along = r.texts("along");
  t.thickness = r.number("thickness_m", t.thickness, 1e-3, far);
  t.tip = r.number("tip_m", 0.45 * t.thickness, 1e-3, far);
  t.hair_from = r.number("hair_from", t.hair_from, 0, 1);
  t.hair = r.number("hair_m", t.thickness, 1e-3, far);
  return t;
}

ManePart read_mane(TomlReader& r) {
  ManePart m;
  m.along = r.texts("along");
  m.height = r.number("height_m", m.height, 1e-3, far);
  m.thickness = r.number("thickness_m", m.thickness, 1e-3, far);
  m.fall = r.number("fall_m", m.fall, 0, far);
  m.forelock = r.number("forelock_m", m.forelock, 0, far);
  return m;
}

}  // namespace

PartSpec read_part(TomlReader r) {
  PartSpec p;
  if (!r.has("kind")) r.missing("kind", "kind = \"eye\"");
  const std::string kind =
      r.word("kind", "", {"eye", "ear", "nostril", "mouth", "horn", "ossicone", "hoof", "dewclaws", "bone", "dewlap",
                          "udder", "tail", "mane"});
  p.name = r.text("name", kind);
  if (kind != "tail" && kind != "mane") p.joint = r.text("joint");  // those two follow a list of joints
  p.offset = r.vector3("offset", p.offset);
  p.part = r.text("part", "");
  if (kind == "eye") p.kind = read_eye(r);
  if (kind == "ear") p.kind = read_ear(r);
  if (kind == "nostril") p.kind = read_nostril(r);
  if (kind == "mouth") p.kind = read_mouth(r);
  if (kind == "horn" || kind == "ossicone") p.kind = read_horn(r, kind == "ossicone");
  if (kind == "hoof") p.kind = read_hoof(r);
  if (kind == "dewclaws") p.kind = read_dewclaws(r);
  if (kind == "bone") p.kind = read_bone(r);
  if (kind == "dewlap") p.kind = read_dewlap(r);
  if (kind == "udder") p.kind = read_udder(r);
  if (kind == "tail") p.kind = read_tail(r);
  if (kind == "mane") p.kind = read_mane(r);
  r.finish();
  return p;
}

}  // namespace moomill
