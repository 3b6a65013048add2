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
  const double floor = 0.30 * e.length;
  for (const double depth : {floor - e.bulge, 0.0, -2 * e.bulge})
    section(cut, slot, at - n * depth, a * (depth < 0 ? 1.15 : 1.0), b * (depth < 0 ? 1.2 : 1.0),
            b * (depth < 0 ? 1.2 : 1.0));
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

}  // namespace

std::vector<Solid> expand_parts(const std::vector<PartSpec>& parts, const QuadrupedSpec& spec) {
  Body body(spec);
  for (const PartSpec& part : parts)
    std::visit([&](const auto& kind) { expand(kind, part, body); }, part.kind);
  return body.added();
}

}  // namespace moomill
