#pragma once
// Small scenes of the stress cases, and the plain double-precision oracle that first hits are held against.
#include <memory>
#include <vector>

#include "generator/render/accel.h"
#include "generator/render/camera.h"
#include "generator/render/first_hit.h"
#include "generator/render/light.h"
#include "generator/render/path.h"
#include "generator/render/scene.h"

namespace moomill {

// A latitude-longitude sphere, closed: no vertex is split. bumps > 0 dents it by so many waves of a tenth of its
// radius.
Surface stress_sphere(int rows, int columns, double radius, int bumps = 0);
// A parallelogram cut into n x n cells; its normal is cross(u, v).
Surface stress_plate(const vec3& corner, const vec3& u, const vec3& v, int n = 1);
// Fills what a surface of positions and triangles lacks: normals, materials, parts, neutral coordinates.
void finish_surface(Surface& surface);

// A camera at `eye` that looks at `target`, Z up; full horizontal angle in degrees.
Camera stress_camera(const dvec3& eye, const dvec3& target, double angle_deg, int width, int height);
PixelMask all_pixels(const Camera& camera);

// A scene that owns its surfaces.
struct Stage {
  std::vector<std::unique_ptr<Surface>> surfaces;
  Scene scene;
  Lights lights;
  // Positions are shifted by `offset`. animal -1: scenery.
  void add(Surface surface, int animal = 0, const vec3& offset = vec3(0), int material = 0);
  // Another finish with one base colour; returns its index. The first call sets the one that add() takes by itself.
  int finish(float roughness, float metallic, const vec3& base);
  Material& material(int index);
  int texture(Image8 image);
  void environment(const vec3& radiance);

 private:
  std::shared_ptr<Appearance> own_appearance();
};

// Mean colour of the pixels (those that see something), the brightest channel of any, and samples that were not finite.
struct Shaded {
  dvec3 mean{0};
  double least = 0, most = 0;
  std::uint64_t not_finite = 0;
  std::vector<vec3> pixels;  // of those that see something
};
Shaded shade(const Stage& stage, const Camera& camera, const PathOptions& options);

// Nearest hit of a pixel's ray by Cramer's rule in double over every triangle, its depth again in long double.
// `certain`: no triangle's edge passes within 1e-9 of barycentrics, so that hit or miss is no matter of rounding.
struct OracleHit {
  double depth = 0;  // 0: nothing is met
  bool certain = true;
};
OracleHit oracle_hit(const Scene& scene, const Camera& camera, double x, double y);

// Largest relative error of the depth over all pixels of the camera, plus 1 for every pixel that is hit where the
// oracle has none or the other way round, or that is not finite.
double depth_error(const Scene& scene, const Camera& camera, BuildKind kind = BuildKind::rebuild);

inline constexpr double float_rounding = 0x1p-24;  // half a unit in the last place, relative

}  // namespace moomill
