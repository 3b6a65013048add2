#include "rigs/parts.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "generator/core/error.h"
#include "rigs/solids.h"

namespace moomill {
namespace {

dvec3 unit(const dvec3& v) {
  return glm::normalize(v);
}

// `v` without what runs along the unit vector n, made unit; `other` where nothing is left.
dvec3 square_to(const dvec3& v, const dvec3& n, const dvec3& other) {
  const dvec3 t = v - n * glm::dot(v, n);
  return glm::length(t) > 0.05 ? unit(t) : unit(other - n * glm::dot(other, n));
}

// The body with the parts so far, and its skin.
class Body {
 public:
  explicit Body(const QuadrupedSpec& spec) : spec_(spec), own_(spec.solids.size()) {
    for (const QuadrupedJoint& j : spec.joints) {
      joints_.push_back(j.name);
      if (j.mirror) joints_.push_back(mirror_name(j.name));
    }
  }

  struct Skin {
    dvec3 at, normal;
  };

  const QuadrupedJoint& joint(const PartSpec& part, const std::string& name) const {
    for (const QuadrupedJoint& j : spec_.joints)
      if (j.name == name) return j;
    input_error("{}: part '{}' names the joint '{}', which is not in builder.joints", spec_.source, part.name, name);
  }

  // Where the skin is nearest to the part's place.
  Skin skin(const PartSpec& part, const dvec3& near) {
    const Field& f = field();
    const dvec3 at = f.project(near, 40, false);
    if (std::abs(f.distance(at)) > 1e-3 || glm::length(at - near) > 0.15)
      input_error("{}: part '{}' finds no skin within 0.15 m of ({:.3f}, {:.3f}, {:.3f}); mend its offset",
                  spec_.source, part.name, near.x, near.y, near.z);
    return {at, unit(f.gradient(at))};
  }

  // The same on the middle plane.
  Skin skin_in_middle(const PartSpec& part, const dvec3& near) {
    const Field& f = field();
    const dvec3 at = f.project({near.x, 0, near.z}, 40, true);
    if (std::abs(f.distance(at)) > 1e-3)
      input_error("{}: part '{}' finds no skin near ({:.3f}, 0, {:.3f}); mend its offset", spec_.source, part.name,
                  near.x, near.z);
    dvec3 n = f.gradient(at);
    n.y = 0;
    return {at, unit(n)};
  }

  // Where a ray from inside leaves the body.
  dvec3 way_out(const PartSpec& part, const dvec3& from, const dvec3& direction) {
    const Field& f = field();
    double inside = -1;
    for (double t = 0; t < 1; t += 0.004) {
      const dvec3 p = from + direction * t;
      if (f.distance(p) < 0)
        inside = t;
      else if (inside >= 0)
        break;
    }
    if (inside < 0)
      input_error("{}: part '{}' starts outside the body at ({:.3f}, {:.3f}, {:.3f}); move its joints into it",
                  spec_.source, part.name, from.x, from.y, from.z);
    return f.project(from + direction * inside, 10, std::abs(from.y) < 1e-9 && std::abs(direction.y) < 1e-9);
  }

  void add(Solid solid) {
    spec_.solids.push_back(std::move(solid));
    field_.reset();
  }

  double detail(double edge) const { return std::clamp(edge / spec_.target_edge, 0.03, 1.0); }
  double grid() const { return spec_.grid; }
  std::vector<Solid> added() const { return {spec_.solids.begin() + static_cast<std::ptrdiff_t>(own_), spec_.solids.end()}; }

 private:
  const Field& field() {
    if (!field_) {
      std::vector<std::string> part_names;
      field_ = build_field(spec_, joints_, part_names);
    }
    return *field_;
  }

  QuadrupedSpec spec_;
  std::size_t own_;
  std::vector<std::string> joints_;
  std::optional<Field> field_;
};

struct Look {  // what solids of one part share
  std::string name, part, joint;
  double blend, detail;
  bool mirror = true;
};

Solid solid(const Look& look, const dvec3& up, Solid::Kind kind = Solid::Kind::add) {
  Solid s;
  s.name = look.name;
  s.kind = kind;
  s.blend = look.blend;
  s.detail = look.detail;
  s.up = up;
  s.mirror = look.mirror;
  return s;
}

void section(Solid& s, const Look& look, const dvec3& at, double side, double up, double down, double power = 2) {
  const bool first = s.sections.empty();
  s.sections.push_back({at, side, up, down, power, first ? look.joint : "", first ? look.part : ""});
}

// An ellipsoid turned at will: radii along `axis`, along `up`, and across both.
Solid ellipsoid(const Look& look, const dvec3& at, const dvec3& axis, const dvec3& up, const dvec3& radii,
                Solid::Kind kind = Solid::Kind::add) {
  Solid s = solid(look, up, kind);
  section(s, look, at - 2.5e-4 * axis, radii.z, radii.y, radii.y);
  section(s, look, at + 2.5e-4 * axis, radii.z, radii.y, radii.y);
  s.cap_start = s.cap_end = radii.x;
  return s;
}

void expand(const EyePart& e, const PartSpec& part, Body& body) {
  const dvec3 near = body.joint(part, part.joint).at + part.offset;
  const auto [at, n] = body.skin(part, near);
  const double slant = e.slant_deg * degrees;
  const dvec3 along = square_to({std::cos(slant), 0, -std::sin(slant)}, n, {0, 0, -1});
  dvec3 above = glm::cross(n, along);
  if (above.z < 0) above = -above;
  const double a = 0.5 * e.length, b = 0.5 * e.height;
  const std::string skin_part = part.part.empty() ? "head" : part.part;
  if (e.brow > 0) {
    const Look brow{part.name + " brow", skin_part, part.joint, 1.2 * e.length, body.detail(0.2 * e.length)};
    Solid s = solid(brow, n);
    const dvec3 middle = at + above * (2.1 * b);
    const double r = 0.30 * e.length;
    section(s, brow, middle - along * (1.1 * a) + n * (0.6 * e.brow - r), 0.9 * r, r, r);
    section(s, brow, middle + n * (e.brow - r), 0.9 * r, r, r);
    section(s, brow, middle + along * (1.1 * a) + n * (0.4 * e.brow - r), 0.9 * r, r, r);
    s.cap_start = s.cap_end = r;
    body.add(s);
  }
  // Lids: a mound, opened by a slot, with the ball put back into the slot. Nothing undercuts, so the mesh stays clean.
  const Look lid{part.name + " lids", "eyelid_l", part.joint, 0.35 * e.length, body.detail(0.11 * e.length)};
  const double sunk = 0.25 * e.length;
  body.add(ellipsoid(lid, at - n * sunk, along, n, {1.34 * a, sunk + e.bulge, 1.55 * b}));
  const Look slot{part.name + " slot", "", part.joint, 0.0035, body.detail(0.09 * e.length)};
  Solid cut = solid(slot, above, Solid::Kind::carve);
  for (const double t : {0.0, 0.5, 1.0}) {  // from the floor of the slot to well outside, a little wider there
    const double out = e.bulge - 0.30 * e.length + t * (0.30 * e.length + e.bulge), wide = 1 + 0.15 * t * t;
    section(cut, slot, at + n * out, a * wide, b * wide, b * wide);
  }
  cut.cap_start = 0.002, cut.cap_end = 0.02;
  body.add(cut);
  const Look ball{part.name, "eye_l", part.joint, 0.002, body.detail(0.09 * e.length)};
  const double apex = e.bulge - 0.03 * e.length, radius = 0.62 * e.length;
  body.add(ellipsoid(ball, at + n * (apex - radius), along, n, {radius, radius, 0.9 * radius}));
  cut.kind = Solid::Kind::paint;  // the ball lies within the mound: what shows in the slot is eye
  cut.sections[0].part = "eye_l";
  body.add(cut);
}

void expand(const EarPart& e, const PartSpec& part, Body& body) {
  const QuadrupedJoint& joint = body.joint(part, part.joint);
  const double set = e.set_deg * degrees, forward = e.forward_deg * degrees, open = e.opening_deg * degrees;
  const dvec3 d(std::cos(set) * std::sin(forward), std::cos(set) * std::cos(forward), std::sin(set));
  const dvec3 ahead = square_to({1, 0, 0}, d, {0, 0, -1}), outward = square_to({0, 1, 0}, d, {0, 0, -1});
  const dvec3 look = square_to(std::cos(open) * ahead + std::sin(open) * outward, d, {1, 0, 0});
  const auto [root, n] = body.skin(part, joint.at + part.offset);
  const double half = 0.5 * e.width, shell = std::max(e.thickness, 1.25 * body.grid());
  const std::string name = part.part.empty() ? "ear_l" : part.part;
  // The leaf: narrow stalk, widest before the middle, drawn out to the tip, bent a little towards its hollow.
  struct Row {
    double t, width;
  };
  const Row rows[] = {{0, 0.42}, {0.16, 0.62}, {0.34, 0.95}, {0.52, 1}, {0.72, 0.80}, {0.88, 0.5}, {1, e.tip}};
  const auto at = [&](double t) {
    return root + d * (e.length * t) + look * (e.length * (0.05 * std::sin(pi * t) - 0.04 * t));
  };
  const Look leaf{part.name, name, part.joint, 0.5 * half, body.detail(std::max(0.008, 0.045 * e.length))};
  Solid s = solid(leaf, look);
  const Look stalk{part.name, name, joint.parent, 0, 0};
  section(s, stalk, root - d * (0.10 * e.length), 0.42 * half, 0.36 * half, 0.36 * half);
  for (const Row& r : rows) {
    const double width = std::max(half * r.width, 0.8 * shell);
    const double stem = std::max(0.0, 1 - r.t / 0.3) * 0.2 * half;  // the stalk is round
    section(s, leaf, at(r.t), width, std::min(0.5 * shell + stem, width), std::min(0.5 * shell + stem, width),
            2 + std::min(1.0, 4 * r.t));  // boxier: the rim must not be thinner than the grid
    if (s.sections.size() == 2) s.sections.back().joint = part.joint;
  }
  // Cup it: the back bulges by the hollow's depth where the hollow is.
  for (std::size_t i = 2; i + 1 < s.sections.size(); ++i) s.sections[i].down += e.cup * std::min(1.0, rows[i - 1].width);
  s.cap_start = 0.3 * half;
  s.cap_end = 0.6 * shell;
  body.add(s);
  if (e.cup <= 0) return;
  const Look hollow{part.name + " hollow", "", part.joint, 0.006, body.detail(std::max(0.008, 0.045 * e.length))};
  Solid cut = solid(hollow, look, Solid::Kind::carve);
  for (std::size_t i = 1; i < 6; ++i) {
    const double width = std::max(half * rows[i].width - 1.1 * shell, 0.2 * half) * (i == 1 ? 0.6 : 1.0);
    const double deep = e.cup * std::min(1.0, rows[i].width) * (i == 1 || i == 5 ? 0.6 : 1.0);
    section(cut, hollow, at(rows[i].t) + look * (0.5 * shell), width, 1.5 * shell, deep);
  }
  cut.cap_start = cut.cap_end = 0.25 * half;
  body.add(cut);
}

void expand(const NostrilPart& p, const PartSpec& part, Body& body) {
  const auto [at, n] = body.skin(part, body.joint(part, part.joint).at + part.offset);
  const double slant = p.slant_deg * degrees;
  const dvec3 back = square_to({-std::cos(slant), 0.35, std::sin(slant)}, n, {0, 0, 1});
  const dvec3 across = glm::cross(n, back);
  const dvec3 curl = across.z < 0 ? -across : across;  // the tail curls upwards
  const std::string name = part.part.empty() ? "muzzle" : part.part;
  const double l = p.length, r = 0.5 * p.width;
  const auto path = [&](double t) { return at + back * (l * (t - 0.35)) + curl * (l * 0.28 * t * t); };
  const double edge = body.detail(std::max(0.0035, 0.22 * p.width));
  if (p.flare > 0) {
    const Look rim{part.name + " rim", name, part.joint, p.width, edge * 1.3};
    Solid s = solid(rim, n);
    for (const double t : {0.0, 0.35, 0.75})
      section(s, rim, path(t) - n * (1.6 * r), r * (2.0 - 0.8 * t), 1.6 * r + p.flare, 1.6 * r);
    s.cap_start = 2 * r, s.cap_end = 1.4 * r;
    body.add(s);
  }
  const Look hole{part.name, "", part.joint, 0.004, edge};
  Solid cut = solid(hole, n, Solid::Kind::carve);
  for (const double t : {0.05, 0.30, 0.60, 0.90})
    section(cut, hole, path(t), r * (t < 0.2 ? 0.95 : 1.25 - 1.05 * t), p.flare + 0.01, p.depth * (1.1 - 0.75 * t));
  cut.cap_start = 0.8 * r, cut.cap_end = 0.2 * r;
  body.add(cut);
}

// left_fore_hoof, left_fore_fetlock -> hoof_fore_left.
std::string hoof_name(const std::string& joint) {
  const std::string leg = joint.find("hind") != std::string::npos ? "hind" : "fore";
  return joint.find("left") != std::string::npos ? "hoof_" + leg + "_left" : "hoof_" + leg;
}

void expand(const HoofPart& h, const PartSpec& part, Body& body) {
  const QuadrupedJoint& joint = body.joint(part, part.joint);
  const dvec3 centre(joint.at.x + part.offset.x, joint.at.y + part.offset.y, part.offset.z);
  const std::string name = part.part.empty() ? hoof_name(part.joint) : part.part;
  const double toe = 0.66 * h.length, heel = 0.34 * h.length;
  const double run = h.height / std::tan(h.toe_deg * degrees);  // how far the front wall runs forward on its way down
  const double top_toe = std::max(toe - run, 0.26 * h.length), top_heel = 0.38 * h.length;
  const Look look{part.name, name, part.joint, 0.006, body.detail(std::max(0.009, 0.09 * h.length)), joint.mirror};
  // The axis stands upright, so the sole is level; front and back walls are in the forward and backward radii.
  const auto claw = [&](double y, double half, double inner) {
    Solid s = solid(look, {1, 0, 0});
    const auto row = [&](double z, double grow, double wide, double power) {
      const double t = 1 - z / h.height;
      section(s, look, centre + dvec3(0, y - inner * t, z), half * wide + grow, top_toe + (toe - top_toe) * t + grow,
              top_heel + (heel - top_heel) * t + grow, power);
    };
    row(1.06 * h.height, -0.001, 0.76, 2.1);
    row(0.93 * h.height, h.coronet, 0.80, 2.2);
    row(0.78 * h.height, 0, 0.85, 2.3);
    row(0.40 * h.height, 0, 0.96, 2.4);
    row(0.12 * h.height, 0, 1, 2.5);
    row(0.04 * h.height, 0, 1, 2.5);
    s.cap_start = 0.006, s.cap_end = 0.04 * h.height;
    return s;
  };
  if (!h.cloven) {
    body.add(claw(0, 0.5 * h.width, 0));
    return;
  }
  const double half = 0.25 * (h.width - h.cleft), y = 0.5 * h.cleft + half;
  body.add(claw(y, half, 0));
  body.add(claw(-y, half, 0));
}

void expand(const DewclawPart& d, const PartSpec& part, Body& body) {
  const QuadrupedJoint& joint = body.joint(part, part.joint);
  const std::string name = part.part.empty() ? hoof_name(part.joint) : part.part;
  const Look look{part.name, name, part.joint, 0.008, body.detail(std::max(0.007, 0.3 * d.size)), joint.mirror};
  for (const double side : {0.5, -0.5}) {
    const auto [at, n] = body.skin(part, joint.at + part.offset + dvec3(0, side * d.spacing, 0));
    const dvec3 down = unit(dvec3(0, 0, -1) + 0.35 * n);
    Solid s = solid(look, n);
    const dvec3 from = at - n * (0.12 * d.size);
    section(s, look, from - down * (0.25 * d.size), 0.40 * d.size, 0.34 * d.size, 0.34 * d.size);
    section(s, look, from + down * (0.45 * d.size), 0.30 * d.size, 0.30 * d.size, 0.30 * d.size);
    s.cap_start = 0.35 * d.size, s.cap_end = 0.25 * d.size;
    body.add(s);
  }
}

void expand(const MouthPart& m, const PartSpec& part, Body& body) {
  const double slant = m.slant_deg * degrees;
  const dvec3 back(-std::cos(slant), 0, std::sin(slant)), above(std::sin(slant), 0, std::cos(slant));
  const dvec3 front = body.skin_in_middle(part, body.joint(part, part.joint).at + part.offset).at;
  const Look look{part.name, "", part.joint, 0.003, body.detail(0.0045)};
  Solid cut = solid(look, above, Solid::Kind::carve);
  for (const double t : {0.02, 0.12, 0.35, 0.68, 1.0}) {
    const dvec3 near = front + back * (m.length * t) + dvec3(0, 0.5 * m.width * std::sqrt(t), 0);
    const double gape = 0.5 * m.gape * (1 - 0.4 * t);
    section(cut, look, body.skin(part, near).at, m.depth * (1 - 0.5 * t), gape, gape);
  }
  cut.cap_start = 0.01, cut.cap_end = 0.004;
  body.add(cut);
}

void expand(const HornPart& h, const PartSpec& part, Body& body) {
  const QuadrupedJoint& joint = body.joint(part, part.joint);
  const auto [root, n] = body.skin(part, joint.at + part.offset);
  const std::string name = !part.part.empty() ? part.part : h.knob > 0 ? "ossicone_l" : "horn_l";
  const Look look{part.name, name, part.joint, 0.5 * h.thickness, body.detail(std::max(0.006, 0.22 * h.thickness))};
  const double forward = h.forward_deg * degrees;
  const dvec3 level(std::sin(forward), std::cos(forward), 0);
  const dvec3 across = glm::cross(level, dvec3(0, 0, 1));  // the bend is in the plane square to it
  Solid s = solid(look, across);
  dvec3 at = root;
  constexpr int steps = 6;
  for (int i = 0; i <= steps; ++i) {
    const double t = static_cast<double>(i) / steps, elevation = (h.set_deg + h.curve_deg * t) * degrees;
    const dvec3 d = std::cos(elevation) * level + std::sin(elevation) * dvec3(0, 0, 1);
    if (i == 0) section(s, look, at - d * (0.4 * h.thickness), 0.5 * h.thickness, 0.5 * h.thickness, 0.5 * h.thickness);
    const double taper = h.knob > 0 ? t : t * t * (2 - t);  // horns keep their strength, then point
    const double r = 0.5 * h.thickness * (1 + (h.tip - 1) * taper);
    section(s, look, at, r, r, r);
    at += d * (h.length / steps);
  }
  const dvec3 end = s.sections.back().at;
  s.cap_start = 0.3 * h.thickness;
  s.cap_end = std::max(0.5 * h.tip * h.thickness, 0.004);
  body.add(s);
  if (h.knob > 0) {
    const Look knob{part.name + " knob", name, part.joint, 0.6 * h.knob, look.detail};
    const dvec3 axis = unit(end - s.sections[s.sections.size() - 2].at);
    body.add(ellipsoid(knob, end, axis, across, {0.45 * h.knob, 0.5 * h.knob, 0.5 * h.knob}));
  }
}

void expand(const BonePart& b, const PartSpec& part, Body& body) {
  const auto [at, n] = body.skin(part, body.joint(part, part.joint).at + part.offset);
  const Look look{part.name, part.part.empty() ? "torso" : part.part, part.joint, b.blend, body.detail(0.35 * b.size),
                  part.offset.y != 0 || body.joint(part, part.joint).mirror};
  const double r = 0.5 * b.size;
  const dvec3 along = square_to({1, 0, 0}, n, {0, 0, 1});
  // The union lifts its surface by a quarter of the blend where both meet at depth 0; take that off.
  body.add(ellipsoid(look, at + n * (b.out - r - 0.2 * b.blend), along, n, {1.2 * r, r, r}));
}

void expand(const DewlapPart& d, const PartSpec& part, Body& body) {
  const dvec3 from = body.joint(part, part.joint).at + part.offset, to = body.joint(part, d.to_joint).at + d.to_offset;
  const Look look{part.name, part.part.empty() ? "neck" : part.part, part.joint, d.thickness,
                  body.detail(std::max(0.012, 0.5 * d.thickness)), false};
  Solid s = solid(look, {1, 0, -0.4});
  constexpr int steps = 6;
  for (int i = 0; i <= steps; ++i) {
    const double t = static_cast<double>(i) / steps, full = 0.35 + 0.65 * std::sin(pi * std::pow(t, 0.7));
    const auto [at, n] = body.skin_in_middle(part, glm::mix(from, to, t));
    section(s, look, at, 0.5 * d.thickness, std::max(0.01, d.depth * full), 0.03);
    if (i == steps / 2) s.sections.back().joint = d.to_joint;
  }
  s.cap_start = s.cap_end = 0.5 * d.thickness;
  body.add(s);
}

void expand(const UdderPart& u, const PartSpec& part, Body& body) {
  const auto [at, n] = body.skin_in_middle(part, body.joint(part, part.joint).at + part.offset);
  const std::string name = part.part.empty() ? "udder" : part.part;
  const Look half{part.name, name, part.joint, 0.05, body.detail(0.022)};
  const double y = 0.22 * u.width;
  body.add(ellipsoid(half, at + dvec3(0, y, 0.1 * u.depth), {1, 0, 0}, {0, 0, 1}, {0.5 * u.length, 1.1 * u.depth, 0.28 * u.width}));
  if (u.teats == 0) return;
  const Look look{part.name + " teat", name, part.joint, 0.3 * u.teat, body.detail(std::max(0.006, 0.16 * u.teat))};
  for (const double x : u.teats == 4 ? std::vector<double>{0.22, -0.2} : std::vector<double>{0}) {
    const dvec3 root = body.way_out(part, at + dvec3(x * u.length, y, 0), {0, 0, -1});
    Solid s = solid(look, {1, 0, 0});
    section(s, look, root + dvec3(0, 0, 0.25 * u.teat), 0.24 * u.teat, 0.24 * u.teat, 0.24 * u.teat);
    section(s, look, root - dvec3(0, -0.1 * u.teat, 0.82 * u.teat), 0.18 * u.teat, 0.18 * u.teat, 0.18 * u.teat);
    s.cap_start = s.cap_end = 0.18 * u.teat;
    body.add(s);
  }
}

// A curve through joints; `owner` is the joint that moves a place.
struct Track {
  std::vector<dvec3> at;
  std::vector<std::string> joints;
  double length = 0;

  dvec3 place(double t) const {  // t in [0, 1] by length
    double left = t * length;
    for (std::size_t i = 0; i + 1 < at.size(); ++i) {
      const double l = glm::length(at[i + 1] - at[i]);
      if (left <= l || i + 2 == at.size()) return at[i] + (at[i + 1] - at[i]) * (left / l);
      left -= l;
    }
    return at.back();
  }
  const std::string& owner(double t, bool end_too) const {
    double left = t * length;
    for (std::size_t i = 0; i + 1 < at.size(); ++i) {
      const double l = glm::length(at[i + 1] - at[i]);
      if (left < l - 1e-9) return joints[i];
      left -= l;
    }
    return joints[joints.size() - (end_too ? 1 : 2)];
  }
};

Track track(const PartSpec& part, const std::vector<std::string>& joints, const Body& body) {
  if (joints.size() < 2) input_error("part '{}' needs at least two joints in 'along'", part.name);
  Track t;
  t.joints = joints;
  for (const std::string& j : joints) {
    t.at.push_back(body.joint(part, j).at + part.offset);
    if (t.at.size() > 1) t.length += glm::length(t.at.back() - t.at[t.at.size() - 2]);
  }
  return t;
}

void expand(const TailPart& p, const PartSpec& part, Body& body) {
  const Track line = track(part, p.along, body);
  const std::string name = part.part.empty() ? "tail" : part.part;
  const Look look{part.name, name, body.joint(part, p.along[0]).parent, 0.5 * p.thickness,
                  body.detail(std::max(0.009, 0.35 * p.tip)), false};
  Solid s = solid(look, {0, 1, 0});
  const dvec3 into = unit(line.at[0] - line.at[1]);
  const double r0 = 0.5 * p.thickness;
  section(s, look, line.at[0] + dvec3(0.8 * p.thickness, 0, 0) + into * (0.2 * p.thickness), 1.1 * r0, 1.1 * r0, 1.1 * r0);
  constexpr int steps = 14;
  for (int i = 0; i <= steps; ++i) {
    const double t = static_cast<double>(i) / steps;
    double r = r0 + (0.5 * p.tip - r0) * std::pow(t, 0.6);
    if (t > p.hair_from) {  // swells soon, stays, and thins to an end that is not a point
      const double f = (t - p.hair_from) / (1 - p.hair_from);
      const double full = std::sin(0.5 * pi * std::min(1.0, f / 0.35)) * (f > 0.55 ? 1 - 0.78 * std::pow((f - 0.55) / 0.45, 1.5) : 1);
      r = std::max(r * (1 - f), 0.5 * p.hair * full);
      r = std::max(r, 0.35 * p.tip);
    }
    section(s, look, line.place(t), 1.1 * r, 0.9 * r, 0.9 * r);
    s.sections.back().joint = line.owner(t, false);
    s.sections.back().part = t > p.hair_from ? name + "_switch" : name;
  }
  s.cap_start = r0, s.cap_end = s.sections.back().side;
  body.add(s);
}

void expand(const ManePart& m, const PartSpec& part, Body& body) {
  const Track line = track(part, m.along, body);
  const std::string name = part.part.empty() ? "mane" : part.part;
  const int steps = std::max(8, static_cast<int>(line.length / 0.07));
  const double edge = body.detail(std::max(0.010, 0.4 * m.thickness));
  const Look ridge{part.name, name, m.along[0], 0.6 * m.thickness, edge, false};
  // From the first crest to the last, square to the chord between them: crest points keep their order in any bend.
  const dvec3 last = unit(line.at.back() - line.at[line.at.size() - 2]);
  const dvec3 a = body.way_out(part, line.at[0], {0, 0, 1});
  const dvec3 b = body.way_out(part, line.at.back(), unit(dvec3(-last.z, 0, last.x)));
  const dvec3 chord = unit(b - a), up(-chord.z, 0, chord.x);
  std::vector<dvec3> crest;
  for (int i = 0; i <= steps; ++i)
    crest.push_back(body.way_out(part, glm::mix(a, b, static_cast<double>(i) / steps) - up * (0.12 * glm::length(b - a)), up));
  Solid s = solid(ridge, up);
  for (int i = 0; i <= steps; ++i) {
    const double t = static_cast<double>(i) / steps;
    const double high = m.height * std::min({1.0, 0.35 + 5 * t, 0.45 + 5 * (1 - t)});
    section(s, ridge, crest[i], 0.5 * m.thickness, high, 0.6 * m.thickness);
    s.sections.back().joint = line.owner(t, true);
  }
  s.cap_start = s.cap_end = m.thickness;
  body.add(s);
  if (m.fall > 0) {  // sheets of hair down both sides, in locks of uneven length
    const Look sheet{part.name + " fall", name, m.along[0], 0.006, edge};
    const double thick = std::max(0.5 * m.thickness, 0.9 * body.grid());
    std::vector<dvec3> at;
    std::vector<double> lock, when;
    dvec3 outward(0);
    for (int i = 1; i < steps; ++i) {
      const double t = static_cast<double>(i) / steps;
      const double uneven = 0.9 + 0.13 * std::sin(17 * t) + 0.09 * std::sin(41 * t + 1);
      when.push_back(t);
      lock.push_back(m.fall * uneven * std::min({1.0, 0.3 + 3.5 * t, 0.5 + 3 * (1 - t)}));
      const Body::Skin skin = body.skin(part, crest[i] - up * (0.5 * lock.back()) + dvec3(0, 0.5 * m.fall, 0));
      at.push_back(skin.at - skin.normal * (0.25 * thick));
      outward += skin.normal;
    }
    Solid hair = solid(sheet, unit(outward));
    for (std::size_t i = 0; i < at.size(); ++i) {
      section(hair, sheet, at[i], 0.55 * lock[i], 0.6 * thick, 0.8 * thick, 2.4);
      hair.sections.back().joint = line.owner(when[i], true);
    }
    hair.cap_start = hair.cap_end = 0.12 * m.fall;
    body.add(hair);
  }
  if (m.forelock > 0) {
    const Look look{part.name + " forelock", name, m.along.back(), 0.008, edge, false};
    const dvec3 top = crest.back() + up * (0.3 * m.height);
    Solid lock = solid(look, up);
    const dvec3 down = unit(dvec3(up.z, 0, -up.x) - 0.8 * up);
    for (const double t : {0.0, 0.3, 0.65, 1.0}) {
      const Body::Skin at = body.skin_in_middle(part, top + down * (0.075 + m.forelock * t));
      section(lock, look, at.at + at.normal * 0.002, m.thickness * (t < 0.5 ? 0.75 : 1.25 - t), 0.5 * m.thickness * (1.2 - 0.6 * t), 0.02);
    }
    lock.cap_start = lock.cap_end = 0.5 * m.thickness;
    body.add(lock);
  }
}

}  // namespace

std::vector<Solid> expand_parts(const std::vector<PartSpec>& parts, const QuadrupedSpec& spec) {
  Body body(spec);
  for (const PartSpec& part : parts)
    std::visit([&](const auto& kind) { expand(kind, part, body); }, part.kind);
  return body.added();
}

}  // namespace moomill
