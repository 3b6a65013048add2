#pragma once
// Metallic-roughness surface: a diffuse base under a dielectric GGX coat (IOR 1.5), mixed with a GGX metal.
//
// For a pair of directions the value is A + B b + C b^2 in the base colour b, with A, B, C that no coat enters. So all
// coats share them, and every sampling decision (made as for b = 1) is the same for every coat.
//
//   dielectric: D G F / (4 co ci)  +  b / pi (1 - Ed(co)) (1 - Ed(ci)) / (1 - Ed_avg)
//               Ed: directional albedo of the specular lobe. What it does not reflect reaches the base, so a white
//               base reflects everything at any roughness (Kulla & Conty 2017; Kelemen & Szirmay-Kalos 2001).
//               A factor `specular` scales F and with it Ed; at 0 the surface is Lambert's.
//   metal:      D G F_Schlick(b) / (4 co ci) (1 + b (1 - Es) / Es), the multiple-scattering gain of Turquin 2019.
//               Es: directional albedo of the lobe for F = 1.
// D, G: GGX with height-correlated Smith masking; visible-normal sampling (Heitz 2018). alpha = roughness^2.
#include <array>

#include "generator/core/math.h"

namespace moomill {

// Coefficients of the base colour polynomial.
struct BaseResponse {
  float a = 0, b = 0, c = 0;
  float at(float base) const { return a + base * (b + base * c); }
  float white() const { return a + b + c; }
};

struct BsdfSample {
  vec3 wi{0};       // local frame, z along the shading normal
  float pdf = 0;    // solid angle; 0: the sample failed and carries nothing
};

// A surface point's BSDF, prepared for one outgoing direction. Directions are local, z up, unit.
class Bsdf {
 public:
  Bsdf() = default;  // of no surface; to be assigned
  // least_specular: the least chance of the specular lobe to be sampled, where there is one. Its share as of a white base is best for
  // that; for dark coats, whose highlights are most of what they send back, more is.
  Bsdf(float roughness, float metallic, const vec3& wo, float specular = 1, float least_specular = 0.15f);
  BaseResponse evaluate(const vec3& wi) const;  // BSDF times cos(wi), 1 / sr
  float pdf(const vec3& wi) const;              // 1 / sr
  BsdfSample sample(const vec2& u, float lobe) const;
  // evaluate() and pdf() at once, which share most of their work.
  struct Value {
    BaseResponse response;
    float pdf = 0;
    float specular_pdf = 0;  // of sample_specular()
  };
  Value value(const vec3& wi) const;
  // Integral of evaluate() over the hemisphere, from tables.
  BaseResponse albedo() const;
  // Whether albedo() is right within 6e-5 of the whole: for narrow lobes the table is too coarse, and metals have none.
  bool albedo_is_known() const { return roughness_ >= 0.4f && metallic_ == 0; }
  // The direction of sample(); false where it fails.
  bool sample_direction(const vec2& u, float lobe, vec3& wi) const;
  // A direction of the specular lobe alone; false where it fails.
  bool sample_specular(const vec2& u, vec3& wi) const;
  // The matt base's share of evaluate() is b times diffuse_factor() (1 - Ed(ci)) cos(wi).
  float diffuse_factor() const;

 private:
  vec3 wo_{0, 0, 1};
  float alpha_ = 1, roughness_ = 1, metallic_ = 0, specular_ = 0, specular_probability_ = 0, ed_wo_ = 0, ed_average_ = 0, es_wo_ = 1;
};

// Ed above: what the dielectric's specular lobe reflects, at `specular` = 1; and its mean over the cosine-weighted hemisphere.
float specular_albedo(float cosine, float roughness);
float mean_specular_albedo(float roughness);

// Unpolarised Fresnel reflectance of a dielectric for light arriving with this cosine from outside.
float fresnel_dielectric(float cosine, float ior);
inline constexpr float bsdf_ior = 1.5f;
// The smallest alpha in use: below it a lobe is narrower than float directions resolve.
inline constexpr float bsdf_min_alpha = 1e-3f;

float ggx_d(const vec3& h, float alpha);
vec3 sample_ggx_visible_normal(const vec3& wo, float alpha, const vec2& u);
vec3 sample_cosine_hemisphere(const vec2& u);

// Orthonormal basis around a unit vector (Duff et al. 2017).
struct Frame {
  vec3 x{1, 0, 0}, y{0, 1, 0}, z{0, 0, 1};
  Frame() = default;
  explicit Frame(const vec3& normal);
  vec3 to_local(const vec3& v) const { return {glm::dot(v, x), glm::dot(v, y), glm::dot(v, z)}; }
  vec3 to_world(const vec3& v) const { return v.x * x + v.y * y + v.z * z; }
};

}  // namespace moomill
