#include "rigs/solids.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "generator/core/error.h"

namespace moomill {
namespace {

constexpr int beyond = 4;  // entries of Shape::axis_x before the start and after the end of the axis

// Slopes for cubic Hermite interpolation over uneven knots; `monotone` keeps radii from overshooting (the limiter of
// Fritsch and Carlson, 1980).
double slope(double h0, double h1, double d0, double d1, bool monotone) {
  const double m = (d0 * h1 + d1 * h0) / (h0 + h1);
  if (!monotone) return m;
  if (d0 * d1 <= 0) return 0;
  const double most = 3 * std::min(std::abs(d0), std::abs(d1));
  return std::clamp(m, -most, most);
}

double hermite(const std::vector<double>& knots, const std::vector<double>& values, std::size_t i, double f,
               bool monotone) {
  const std::size_t n = values.size();
  const double h = knots[i + 1] - knots[i];
  const auto delta = [&](std::size_t k) { return (values[k + 1] - values[k]) / (knots[k + 1] - knots[k]); };
  const double d = delta(i);
  const double m0 = i > 0 ? slope(knots[i] - knots[i - 1], h, delta(i - 1), d, monotone) : d;
  const double m1 = i + 2 < n ? slope(h, knots[i + 2] - knots[i + 1], d, delta(i + 1), monotone) : d;
  const double f2 = f * f, f3 = f2 * f;
  return (2 * f3 - 3 * f2 + 1) * values[i] + (f3 - 2 * f2 + f) * h * m0 + (3 * f2 - 2 * f3) * values[i + 1] +
         (f3 - f2) * h * m1;
}

// Between the two points around s metres of the axis.
Shape::Point axis_at(const Shape& shape, double s) {
  const double x = std::clamp(s / shape.step, 0.0, static_cast<double>(shape.points.size() - 1));
  const std::size_t k = std::min(static_cast<std::size_t>(x), shape.points.size() - 2);
  const Shape::Point &a = shape.points[k], &b = shape.points[k + 1];
  const double f = x - static_cast<double>(k);
  const auto mix = [&](const auto& u, const auto& v) { return u + (v - u) * f; };
  return {mix(a.at, b.at), mix(a.side_axis, b.side_axis), mix(a.up_axis, b.up_axis), mix(a.side, b.side),
          mix(a.up, b.up), mix(a.down, b.down),           mix(a.power, b.power),     mix(a.along, b.along)};
}

// Metres along the axis of where p belongs; outside of [0, length] beyond an end. A soft nearest point: the mean of
// the places around it, weighted by exp(-squared distance). Where the axis is straight this is the nearest point; where it bends
// so much that the nearest point jumps from one place to another, the mean goes over smoothly, so the field has no
// tears.
double place_on_axis(const Shape& shape, const dvec3& p) {
  constexpr std::size_t most = 64;
  std::array<double, most> d2;
  const std::size_t n = shape.axis_x.size();
  for (std::size_t k = 0; k < n; ++k) {
    const double x = shape.axis_x[k] - p.x, y = shape.axis_y[k] - p.y, z = shape.axis_z[k] - p.z;
    d2[k] = x * x + y * y + z * z;
  }
  std::size_t nearest = 0;
  for (std::size_t k = 1; k < n; ++k)
    if (d2[k] < d2[nearest]) nearest = k;
  // From the nearest point both ways until places are much farther: another stretch of the axis that comes near again
  // (a ring's other end) has no part in it.
  const double scale = 1 / (2 * shape.stride * shape.stride);
  double sum = static_cast<double>(nearest), total = 1;
  const auto add = [&](std::size_t k) {
    const double e = (d2[k] - d2[nearest]) * scale;
    if (e > 12) return false;
    const double w = std::exp(-e);
    sum += w * static_cast<double>(k), total += w;
    return true;
  };
  for (std::size_t k = nearest + 1; k < n && add(k); ++k) {}
  for (std::size_t k = nearest; k > 0 && add(k - 1); --k) {}
  return (sum / total - beyond) * shape.stride;
}

void add_points(Shape& shape, const Solid& solid, const std::string& source) {
  const auto& sections = solid.sections;
  const std::size_t n = sections.size();
  std::vector<double> knots(n, 0.0);
  for (std::size_t i = 1; i < n; ++i) knots[i] = knots[i - 1] + glm::length(sections[i].at - sections[i - 1].at);
  const auto column = [&](auto get) {
    std::vector<double> values(n);
    for (std::size_t i = 0; i < n; ++i) values[i] = get(sections[i]);
    return values;
  };
  const std::vector<double> x = column([](auto&s) { return s.at.x; }), y = column([](auto&s) { return s.at.y; }),
                            z = column([](auto&s) { return s.at.z; }), side = column([](auto&s) { return s.side; }),
                            up = column([](auto&s) { return s.up; }), down = column([](auto&s) { return s.down; }),
                            power = column([](auto&s) { return s.power; });
  const double length = knots.back();
  double least = length;
  for (std::size_t i = 1; i < n; ++i) least = std::min(least, knots[i] - knots[i - 1]);
  const std::size_t count =
      n == 1 ? 1 : std::clamp<std::size_t>(static_cast<std::size_t>(6 * length / least), 24, 512) + 1;
  shape.step = n == 1 ? 0 : length / static_cast<double>(count - 1);
  for (std::size_t k = 0, i = 0; k < count; ++k) {
    Shape::Point p{};
    if (n == 1) {
      p.at = sections[0].at;
      p.side = side[0], p.up = up[0], p.down = down[0], p.power = power[0];
    } else {
      const double s = static_cast<double>(k) * shape.step;
      while (i + 2 < n && s > knots[i + 1]) ++i;
      const double f = std::clamp((s - knots[i]) / (knots[i + 1] - knots[i]), 0.0, 1.0);
      const auto at = [&](const std::vector<double>& v, bool monotone) { return hermite(knots, v, i, f, monotone); };
      p.at = {at(x, false), at(y, false), at(z, false)};
      p.side = at(side, true), p.up = at(up, true), p.down = at(down, true), p.power = at(power, true);
      p.along = static_cast<double>(i) + f;
    }
    shape.points.push_back(p);
  }
  // Frames: the axis by central differences, `up` made square to it. One section: its axis is chosen so that `side`
  // is across the animal and the caps reach along the remaining direction.
  for (std::size_t k = 0; k < count; ++k) {
    dvec3 axis = count == 1 ? glm::cross(dvec3(0, 1, 0), solid.up)
                            : shape.points[std::min(k + 1, count - 1)].at - shape.points[k > 0 ? k - 1 : 0].at;
    if (glm::length(axis) < 1e-9) axis = {1, 0, 0};
    axis = glm::normalize(axis);
    const dvec3 across = glm::cross(solid.up, axis);
    if (glm::length(across) < 0.1 || (k > 0 && glm::dot(across, shape.points[k - 1].side_axis) < 0))
      input_error("{}: solid '{}' in [builder] runs along its 'up' at section {} ({:.3f}, {:.3f}, {:.3f}); give it an "
                  "'up' that is square to all of its axis",
                  source, solid.name, static_cast<int>(shape.points[k].along + 0.5), shape.points[k].at.x,
                  shape.points[k].at.y, shape.points[k].at.z);
    shape.points[k].side_axis = glm::normalize(across);
    shape.points[k].up_axis = glm::cross(axis, shape.points[k].side_axis);
    if (k == 0) shape.start_axis = -axis;
    if (k + 1 == count) shape.end_axis = axis;
  }
  if (n > 1) {
    constexpr int strides = 40;
    shape.stride = length / strides;
    for (int k = -beyond; k <= strides + beyond; ++k) {
      const double s = k * shape.stride;
      const dvec3 at = axis_at(shape, s).at + (s < 0        ? -s * shape.start_axis
                                               : s > length ? (s - length) * shape.end_axis
                                                            : dvec3(0));
      shape.axis_x.push_back(at.x), shape.axis_y.push_back(at.y), shape.axis_z.push_back(at.z);
    }
  }
  for (const auto& p : shape.points) {
    const double reach = std::max({p.side, p.up, p.down, shape.cap_start, shape.cap_end}) * (p.power > 2 ? 1.42 : 1.0);
    shape.box.add(p.at - reach);
    shape.box.add(p.at + reach);
  }
}

Solid mirrored(Solid solid) {
  solid.up.y = -solid.up.y;
  for (SolidSection& s : solid.sections) {
    s.at.y = -s.at.y;
    s.joint = mirror_name(s.joint);
    s.part = mirror_name(s.part);
  }
  return solid;
}

double box_distance(const Box& box, const dvec3& lower, const dvec3& upper) {
  return glm::length(glm::max(dvec3(0.0), glm::max(box.lower - upper, lower - box.upper)));
}

}  // namespace

ShapeSample sample_shape(const Shape& shape, const dvec3& p) {
  // The place along the axis first, then the cross-section there: one superellipse per query.
  const bool ellipsoid = shape.points.size() == 1;
  const double length = shape.step * static_cast<double>(shape.points.size() - 1);
  const double place = ellipsoid ? 0 : place_on_axis(shape, p);
  const Shape::Point c = ellipsoid ? shape.points[0] : axis_at(shape, place);
  const dvec3 q = p - c.at;
  const double s = glm::dot(q, c.side_axis), u = glm::dot(q, c.up_axis);
  const double rs = c.side, ru = u >= 0 ? c.up : c.down;
  // Beyond an end, how far. It sets in over a quarter stride, as the soft place may reach the end a little early.
  double w = 0, rw = 1;
  const auto cap = [&](double past, const dvec3& axis, double reach) {
    const double out = glm::dot(q, axis);
    if (out > 0) w = ellipsoid ? out : out * std::min(1.0, past / (0.25 * shape.stride)), rw = reach;
  };
  if (place <= 0) cap(-place, shape.start_axis, shape.cap_start);
  if (place >= length) cap(place - length, shape.end_axis, shape.cap_end);
  ShapeSample result;
  result.along = c.along;
  // Distance to first order: (g - 1) / |grad g| for the homogeneous g that is 1 on the surface.
  const double n = c.power;
  const double as = std::abs(s) / rs, au = std::abs(u) / ru, aw = std::abs(w) / rw;
  double g, slope;
  if (n < 2.001) {
    g = std::sqrt(as * as + au * au + aw * aw);
    const double gs = as / rs, gu = au / ru, gw = aw / rw;
    slope = std::sqrt(gs * gs + gu * gu + gw * gw) / std::max(g, 1e-9);
  } else {
    const double ps = std::pow(as, n - 1), pu = std::pow(au, n - 1), pw = std::pow(aw, n - 1);
    const double sum = ps * as + pu * au + pw * aw;
    g = std::pow(sum, 1 / n);
    const double gs = ps / rs, gu = pu / ru, gw = pw / rw;
    slope = std::sqrt(gs * gs + gu * gu + gw * gw) * (sum > 1e-12 ? g / sum : 0.0);
  }
  // Near the axis the slope has no meaning; the smallest radius is as far as the surface can be.
  const double least = std::min(rs, ru);
  result.distance = g < 0.05 ? (g - 1) * least : std::max((g - 1) / slope, -least);
  // Well inside, the ends may be nearer than the sides (a flat sole, say).
  if (!ellipsoid && result.distance < 0)
    result.distance =
        std::max({result.distance, -(std::max(place, 0.0) + shape.cap_start - (place < 0 ? w : 0)),
                  -(std::max(length - place, 0.0) + shape.cap_end - (place > length ? w : 0))});
  return result;
}

const std::vector<std::uint16_t>& Field::near_shapes(const dvec3& p) const {
  const dvec3 q = (p - box.lower) / cell;
  const int x = std::clamp(static_cast<int>(q.x), 0, nx - 1), y = std::clamp(static_cast<int>(q.y), 0, ny - 1),
            z = std::clamp(static_cast<int>(q.z), 0, nz - 1);
  return near[(static_cast<std::size_t>(z) * ny + y) * nx + x];
}

FieldSample Field::sample(const dvec3& p) const {
  FieldSample f{nothing_near, 1.0};
  for (const std::uint16_t i : near_shapes(p)) {
    const Shape& shape = shapes[i];
    if (shape.kind == Solid::Kind::paint) continue;
    // Too far to change anything: saves most of the work.
    const dvec3 away = glm::max(dvec3(0.0), glm::max(shape.box.lower - p, p - shape.box.upper));
    const double limit =
        shape.kind == Solid::Kind::add ? std::max(f.distance, 0.0) + shape.blend + 0.03 : shape.blend + 0.06;
    if (glm::dot(away, away) > limit * limit) continue;
    const double d = sample_shape(shape, p).distance;
    // Polynomial smooth union (Quilez); carving is the smooth intersection with the outside.
    if (shape.kind == Solid::Kind::carve) {
      const double h = std::max(shape.blend - std::abs(f.distance + d), 0.0) / shape.blend;
      f.distance = std::max(f.distance, -d) + h * h * shape.blend / 4;
      if (-d > f.distance - 0.01) f.detail = std::min(f.detail, shape.detail);
      continue;
    }
    const double h = std::max(shape.blend - std::abs(f.distance - d), 0.0) / shape.blend;
    const double m = 0.5 * h * h;
    const bool nearer = d < f.distance;
    f.distance = std::min(f.distance, d) - m * shape.blend / 2;
    f.detail += (shape.detail - f.detail) * (nearer ? 1 - m : m);
  }
  return f;
}

dvec3 Field::gradient(const dvec3& p) const {
  // Four samples at the corners of a tetrahedron instead of six.
  constexpr double e = 5e-4;
  const dvec3 a(1, -1, -1), b(-1, -1, 1), c(-1, 1, -1), d(1, 1, 1);
  return (a * distance(p + e * a) + b * distance(p + e * b) + c * distance(p + e * c) + d * distance(p + e * d)) /
         (4 * e);
}

dvec3 Field::project(const dvec3& start, int steps, bool on_midplane) const {
  dvec3 p = start;
  for (int i = 0; i < steps; ++i) {
    const double d = distance(p);
    if (std::abs(d) < 1e-6) break;
    dvec3 g = gradient(p);
    if (on_midplane) g.y = 0;
    const double g2 = glm::dot(g, g);
    if (g2 < 1e-6) break;
    const dvec3 step = -g * (d / std::max(g2, 0.25));
    const double length = glm::length(step);
    p += step * (length > 0.02 ? 0.02 / length : 1.0);
  }
  if (on_midplane) p.y = 0;
  return p;
}

Influencing Field::influences(const dvec3& p) const {
  Influencing result;
  result.joint_weights.assign(joint_count, 0.0);
  struct Entry {
    const Shape* shape;
    ShapeSample sample;
  };
  std::vector<Entry> entries;
  double least = std::numeric_limits<double>::infinity();
  int painted = -1;
  const auto section_at = [](const Shape& shape, double along) {
    return std::min(static_cast<std::size_t>(along), shape.joints.size() - 1);
  };
  for (const std::uint16_t i : near_shapes(p)) {
    const Shape& shape = shapes[i];
    if (shape.kind == Solid::Kind::carve) continue;
    const ShapeSample s = sample_shape(shape, p);
    if (shape.kind == Solid::Kind::paint) {
      if (s.distance < 0) painted = shape.parts[section_at(shape, s.along)];
      continue;
    }
    if (s.distance < least) least = s.distance, result.part = shape.parts[section_at(shape, s.along)];
    entries.push_back({&shape, s});
  }
  if (painted >= 0) result.part = painted;
  double total = 0;
  for (const auto& [shape, s] : entries) {
    const double width = std::max(0.01, 0.4 * shape->blend);
    const double w = std::exp(-(s.distance - least) / width);
    if (w < 1e-4) continue;
    const std::size_t i = section_at(*shape, s.along);
    const double f = s.along - static_cast<double>(i);
    const double second = i + 1 < shape->joints.size() ? f * f * (3 - 2 * f) : 0.0;
    result.joint_weights[shape->joints[i]] += w * (1 - second);
    if (second > 0) result.joint_weights[shape->joints[i + 1]] += w * second;
    total += w;
  }
  for (double& w : result.joint_weights) w /= total;
  return result;
}

Field build_field(const QuadrupedSpec& spec, const std::vector<std::string>& joint_names,
                  std::vector<std::string>& part_names) {
  Field field;
  field.joint_count = static_cast<int>(joint_names.size());
  const auto part_index = [&](const std::string& name) {
    const auto found = std::find(part_names.begin(), part_names.end(), name);
    if (found != part_names.end()) return static_cast<int>(found - part_names.begin());
    part_names.push_back(name);
    return static_cast<int>(part_names.size()) - 1;
  };
  const auto add = [&](const Solid& solid) {
    Shape shape;
    shape.name = solid.name;
    shape.kind = solid.kind;
    shape.blend = solid.blend, shape.detail = solid.detail;
    shape.cap_start = solid.cap_start, shape.cap_end = solid.cap_end;
    std::string joint, part;
    for (const SolidSection& s : solid.sections) {
      if (!s.joint.empty()) joint = s.joint;
      if (!s.part.empty()) part = s.part;
      const auto found = std::find(joint_names.begin(), joint_names.end(), joint);
      if (found == joint_names.end() && solid.kind == Solid::Kind::add)
        input_error("{}: solid '{}' names the joint '{}', which is not in [builder] joints; {}", spec.source, solid.name, joint,
                    std::find(joint_names.begin(), joint_names.end(), mirror_name(joint)) != joint_names.end()
                        ? fmt::format("set mirror = true at the joint '{}', whose twin it is", mirror_name(joint))
                        : "correct the name or add the joint");
      if (part.empty() && solid.kind != Solid::Kind::carve)
        input_error("{}: solid '{}' has no part; give its first section one", spec.source, solid.name);
      shape.joints.push_back(found == joint_names.end() ? 0 : static_cast<int>(found - joint_names.begin()));
      shape.parts.push_back(part.empty() ? 0 : part_index(part));
    }
    add_points(shape, solid, spec.source);
    if (solid.kind == Solid::Kind::add) {
      field.box.add(shape.box.lower);
      field.box.add(shape.box.upper);
    }
    field.shapes.push_back(std::move(shape));
  };
  for (const Solid& solid : spec.solids) {
    if (solid.sections.empty()) input_error("{}: solid '{}' has no sections", spec.source, solid.name);
    add(solid);
    if (solid.mirror) add(mirrored(solid));
  }
  if (field.box.empty()) input_error("{}: [[builder.solids]] is empty; add at least one solid", spec.source);

  field.box.lower -= 0.05;
  field.box.upper += 0.05;
  // A shape matters as far as its own fillet reaches, or that of a later shape that may join it.
  std::vector<double> reach;
  for (std::size_t i = 0; i < field.shapes.size(); ++i) {
    double most = field.shapes[i].blend;
    for (std::size_t j = i + 1; j < field.shapes.size(); ++j) {
      const Shape& later = field.shapes[j];
      if (box_distance(field.shapes[i].box, later.box.lower, later.box.upper) < 2 * later.blend)
        most = std::max(most, later.blend);
    }
    reach.push_back(most + Field::looks_at);
  }
  const dvec3 size = field.box.size() / field.cell;
  field.nx = static_cast<int>(size.x) + 1, field.ny = static_cast<int>(size.y) + 1,
  field.nz = static_cast<int>(size.z) + 1;
  field.near.resize(static_cast<std::size_t>(field.nx) * field.ny * field.nz);
  for (int z = 0; z < field.nz; ++z)
    for (int y = 0; y < field.ny; ++y)
      for (int x = 0; x < field.nx; ++x) {
        const dvec3 lower = field.box.lower + field.cell * dvec3(x, y, z), upper = lower + field.cell;
        auto& list = field.near[(static_cast<std::size_t>(z) * field.ny + y) * field.nx + x];
        for (std::size_t i = 0; i < field.shapes.size(); ++i)
          if (box_distance(field.shapes[i].box, lower, upper) < reach[i]) list.push_back(static_cast<std::uint16_t>(i));
      }
  return field;
}

}  // namespace moomill
