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

}  // namespace

PartSpec read_part(TomlReader r) {
  PartSpec p;
  if (!r.has("kind")) r.missing("kind", "kind = \"eye\"");
  const std::string kind = r.word("kind", "", {"eye", "ear", "nostril", "hoof", "dewclaws"});
  p.name = r.text("name", kind);
  p.joint = r.text("joint");
  p.offset = r.vector3("offset", p.offset);
  p.part = r.text("part", "");
  if (kind == "eye")
    p.kind = read_eye(r);
  else if (kind == "ear")
    p.kind = read_ear(r);
  else if (kind == "nostril")
    p.kind = read_nostril(r);
  else if (kind == "hoof")
    p.kind = read_hoof(r);
  else
    p.kind = read_dewclaws(r);
  r.finish();
  return p;
}

}  // namespace moomill
