#include "generator/render/camera.h"

namespace moomill {

Camera Camera::from_matrix(const std::array<double, 12>& m, double fx, double fy, double cx, double cy, int width,
                           int height) {
  Camera c;
  for (int r = 0; r < 3; ++r)
    for (int k = 0; k < 3; ++k) c.world_to_camera[k][r] = m[4 * r + k];
  c.centre = -(glm::transpose(c.world_to_camera) * dvec3(m[3], m[7], m[11]));
  c.fx = fx;
  c.fy = fy;
  c.cx = cx;
  c.cy = cy;
  c.width = width;
  c.height = height;
  return c;
}

}  // namespace moomill
