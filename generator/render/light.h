#pragma once
// Lights: an environment (constant or a map), suns, rectangles. All radiances are linear Rec. 709.
#include <array>
#include <memory>
#include <optional>
#include <vector>

#include "generator/core/image.h"
#include "generator/core/math.h"

namespace moomill {

// A direction or point towards a light, drawn for a shading point.
struct LightSample {
  vec3 direction{0};      // unit, towards the light
  float distance = 0;     // metres; infinity for suns and the environment
  vec3 radiance{0};
  float pdf = 0;          // solid angle; 0: nothing drawn
};

// Radiance from all directions: a constant, or an equirectangular map with +Z up, seen from inside as panoramas are: its centre column is -Y turned
// by yaw, columns to the right of it lie to the right. The map is looked up without filtering, so the tabulated density is proportional to it.
//
// It falls into two parts. The soft one, in no channel more than twice the mean of its brightest one, and all of a constant, is left to the rays that
// BSDF sampling sends out: they find it as well as any, and with them it can be a control variate (path_kernel.h). The bright one, the rest,
// is drawn from by sample(). (Karlik et al. 2019 take a mean from the density alone, to the same end.)
class Environment {
 public:
  Environment() = default;
  explicit Environment(const vec3& constant) : constant_(constant) {}
  // map: 3 channels, finite and not negative (checked: InputError naming `name`).
  Environment(ImageF map, const std::string& name, float strength, double yaw_rad);

  bool is_black() const { return !is_map() && constant_ == vec3(0); }
  bool is_map() const { return !map_.empty(); }
  vec3 radiance(const vec3& direction) const;  // of both parts
  struct Parts {
    vec3 soft{0}, bright{0};
    float pdf = 0;  // of sample() in this direction, solid angle
  };
  Parts parts(const vec3& direction) const;
  vec3 soft_radiance(const vec3& direction) const { return is_map() ? soft(radiance(direction)) : constant_; }
  // The soft part's mean over the hemisphere around a unit normal, weighted by the cosine; of a map's, as far as spherical harmonics of
  // the second order hold it (Ramamoorthi and Hanrahan 2001: within a few per cent).
  vec3 soft_around(const vec3& normal) const;
  bool has_bright_part() const { return bright_mean_ != vec3(0); }
  LightSample sample(const vec2& u) const;  // of the bright part
  float pdf(const vec3& direction) const { return parts(direction).pdf; }
  vec3 mean_radiance() const { return is_map() ? mean_ : constant_; }
  vec3 bright_mean() const { return bright_mean_; }
  const ImageF& map() const { return map_; }  // times the strength; empty for a constant
  double yaw_rad() const { return yaw_turns_ * 2 * pi; }

 private:
  glm::ivec2 texel(const vec3& direction) const;
  vec3 soft(const vec3& radiance) const;
  vec3 constant_{0}, mean_{0}, bright_mean_{0};
  float soft_at_most_ = 0;           // the soft part's brightest channel
  std::array<vec3, 9> harmonics_{};  // soft_around() is a polynomial of the normal with these coefficients
  ImageF map_;
  float yaw_turns_ = 0;
  std::vector<float> row_cdf_, column_cdf_;  // rows + 1; rows * (columns + 1)
  std::vector<float> density_;               // per texel, per unit square of the map
};

struct Sun {
  vec3 direction{0, 0, 1};  // unit, towards the sun
  vec3 irradiance{1};       // on a surface that faces it, W/m^2 in scene units
  float angular_radius = 0.00465f;  // radians; 0 for a point
  // What is sampled: a disc narrower than float directions resolve would have no density.
  float disc_radius() const { return std::max(angular_radius, 1e-4f); }
  float one_minus_cos() const;      // of the disc's rim
  vec3 radiance() const;
  LightSample sample(const vec2& u) const;
  float pdf(const vec3& direction) const;  // 0 outside the disc
};

struct RectangleLight {
  vec3 corner{0}, edge_u{1, 0, 0}, edge_v{0, 1, 0};  // metres, world minus origin
  vec3 radiance{1};                                  // on the side that cross(edge_u, edge_v) points to; none on the other
  vec3 normal() const { return glm::normalize(glm::cross(edge_u, edge_v)); }
  float area() const { return glm::length(glm::cross(edge_u, edge_v)); }
  LightSample sample(const vec3& from, const vec2& u) const;
  // Distance along a ray to the lit side, if it meets it, and the solid-angle density of sample() there.
  std::optional<float> intersect(const vec3& from, const vec3& direction) const;
  float pdf(const vec3& direction, float distance) const;
};

// All lights of a scene, and the choice of one per shading point. Rectangles shine but do not block, and the camera
// does not see them or the suns.
struct Lights {
  std::shared_ptr<const Environment> environment = std::make_shared<Environment>();  // black; shared by frames
  std::vector<Sun> suns;
  std::vector<RectangleLight> rectangles;

  // Chances of the choice, in proportion to the irradiance at `centre`; call after the lights are set.
  void prepare(const vec3& centre);
  int count() const { return static_cast<int>(cdf_.size()); }  // lights that are sampled
  // Picks a light with xi and a direction with u; radiance and pdf (with the chance of the choice) are of that light.
  LightSample sample(const vec3& from, float xi, const vec2& u) const;
  // What a ray that BSDF sampling sent out meets of the lights, each weighted against sample() by the power heuristic
  // (Veach 1997). `surface`: distance of the surface it meets, infinity where it leaves the scene.
  vec3 seen_by_bsdf_ray(const vec3& from, const vec3& direction, float bsdf_pdf, float surface) const;

 private:
  std::vector<float> cdf_, chance_;  // the environment's bright part if any, then suns, then rectangles
};

inline float power_heuristic(float a, float b) {
  // A density may be huge (narrow lobes): square the ratio, not the values.
  if (!(a > 0)) return 0;
  const float r = b / a;
  return 1.0f / (1.0f + r * r);
}

inline float luminance(const vec3& c) { return 0.2126f * c.x + 0.7152f * c.y + 0.0722f * c.z; }  // Rec. 709

}  // namespace moomill
