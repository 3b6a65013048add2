#pragma once
// The projection, skinning and surface look-up that the checks use. Written anew from the format's description, and in
// plain loops: nothing here is shared with the renderer or with the rigs' own skinning.
#include <array>
#include <optional>
#include <vector>

#include "generator/dataset/dataset.h"
#include "rigs/rig.h"

namespace moomill {

// A pinhole as read from somewhere: rows of the world-to-camera rotation, and a centre.
struct Pinhole {
  std::array<dvec3, 3> axes{};            // right, down, forward, in the world
  dvec3 centre{0};                        // metres, world
  double fx = 1, fy = 1, cx = 0, cy = 0;  // pixels

  dvec3 to_camera(const dvec3& world) const;
  std::optional<dvec2> pixel(const dvec3& world) const;  // none at or behind the lens
  dvec3 world(double x, double y, double depth) const;   // of a pixel position and camera z
};

// From the position and XYZ Euler angles of a Blender camera (looks along -Z, +Y up), its lens and the image size.
Pinhole pinhole_from_euler(const dvec3& centre, const dvec3& euler_xyz, double focal_mm, double sensor_mm, int width,
                           int height);
Pinhole pinhole_from_matrix(const CameraRecord& camera);

// Largest difference between two pinholes, in pixels at the corners of the image, for a point at `distance` metres.
double pinhole_difference(const Pinhole& a, const Pinhole& b, int width, int height, double distance);

// Vertices in the world by the bone matrices of a record. Dual quaternions of rigid bones only: none otherwise.
std::optional<std::vector<dvec3>> skinned(const Rig& rig, const std::vector<dmat4>& bones,
                                          const std::vector<double>& morph_weights, bool dual_quaternion);

// A point on a mesh.
struct MeshPoint {
  std::uint32_t triangle = 0;
  double u = 0, v = 0;  // barycentrics of the second and third vertex
};
dvec3 at(const std::vector<dvec3>& vertices, const uvec3& triangle, const MeshPoint& point);

// Finds the triangles that pass near a point, by a uniform grid over them.
class TriangleGrid {
 public:
  TriangleGrid(std::vector<dvec3> vertices, std::vector<uvec3> triangles);
  // All triangles within `radius` of p, each with its point closest to p.
  std::vector<MeshPoint> near(const dvec3& p, double radius) const;

 private:
  std::array<int, 3> cell(const dvec3& p) const;
  std::vector<dvec3> vertices_;
  std::vector<uvec3> triangles_;
  Box box_;
  std::array<int, 3> size_{1, 1, 1};
  dvec3 step_{1};
  std::vector<std::uint32_t> begin_, items_;  // triangles of each cell
};

}  // namespace moomill
