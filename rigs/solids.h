#pragma once
// The implicit body of a quadruped: a field that is negative inside, about metric near the surface, made of lofted
// solids joined by smooth unions. Internal to the quadruped builder.
#include <cstdint>
#include <string>
#include <vector>

#include "generator/core/math.h"
#include "rigs/quadruped.h"

namespace moomill {

// A solid made ready for evaluation: its sections resampled finely and evenly along a smooth axis.
struct Shape {
  struct Point {
    dvec3 at, side_axis, up_axis;
    double side, up, down, power;
    double along;  // section number and fraction
  };
  std::string name;  // of the solid, for messages
  Solid::Kind kind = Solid::Kind::add;
  std::vector<Point> points;  // every `step` metres of the axis; one only: an ellipsoid
  double step = 0;
  // Every `stride` metres of the axis a point to look for the nearest by, some beyond its ends; x, y, z apart.
  double stride = 0;
  std::vector<double> axis_x, axis_y, axis_z;
  std::vector<int> joints, parts;  // per section
  dvec3 start_axis{0}, end_axis{0};
  double cap_start = 0, cap_end = 0, blend = 0, detail = 1;
  Box box;  // holds the whole shape
};

// Where a point is relative to one shape.
struct ShapeSample {
  double distance = 0;  // metres, negative inside; first order exact at the surface
  double along = 0;     // section number and fraction
};
ShapeSample sample_shape(const Shape& shape, const dvec3& p);

struct FieldSample {
  double distance = 0;
  double detail = 1;
};

struct Influencing {
  std::vector<double> joint_weights;  // per joint, sums to 1
  int part = 0;
};

// All shapes of an animal, left, right and midline, with a coarse grid that knows which of them matter where.
struct Field {
  static constexpr double nothing_near = 1.0;  // distance where no shape is known within `looks_at` metres
  static constexpr double looks_at = 0.06;
  std::vector<Shape> shapes;
  Box box;            // holds the whole surface
  double cell = 0.1;  // metres, of the coarse grid
  int nx = 0, ny = 0, nz = 0;
  std::vector<std::vector<std::uint16_t>> near;  // per coarse cell: shapes that matter, ascending
  int joint_count = 0;

  const std::vector<std::uint16_t>& near_shapes(const dvec3& p) const;
  FieldSample sample(const dvec3& p) const;
  double distance(const dvec3& p) const { return sample(p).distance; }
  dvec3 gradient(const dvec3& p) const;  // differences over half a millimetre
  // Nearest point of the surface by damped Newton steps along the gradient.
  dvec3 project(const dvec3& p, int steps, bool on_midplane) const;
  Influencing influences(const dvec3& p) const;
};

// `joint_names` and `part_names` list every name, mirrored ones included. Throws InputError on unknown joints.
Field build_field(const QuadrupedSpec& spec, const std::vector<std::string>& joint_names,
                  std::vector<std::string>& part_names);

}  // namespace moomill
