#pragma once
// A pinhole camera. OpenCV axes: x right, y down, z forward; pixel (i, j) has its centre at (i + 0.5, j + 0.5).
#include <array>

#include "generator/core/math.h"

namespace moomill {

struct Camera {
  dmat3 world_to_camera{1.0};  // rotation; glm is column-major
  dvec3 centre{0};             // metres, world
  double fx = 1, fy = 1, cx = 0.5, cy = 0.5;  // pixels
  int width = 1, height = 1;

  // From a 3x4 row-major world_to_camera.
  static Camera from_matrix(const std::array<double, 12>& world_to_camera, double fx, double fy, double cx, double cy,
                            int width, int height);
  dvec3 to_camera(const dvec3& world) const { return world_to_camera * (world - centre); }
  // Pixel of a camera-space point; z must not be 0.
  dvec2 project(const dvec3& p) const { return {fx * p.x / p.z + cx, fy * p.y / p.z + cy}; }
  // Direction through a pixel position, world axes, with camera z = 1: metres along it times 1 are depth.
  dvec3 direction(double x, double y) const {
    return glm::transpose(world_to_camera) * dvec3((x - cx) / fx, (y - cy) / fy, 1.0);
  }
};

}  // namespace moomill
