#pragma once
// The renderer's surface model and light transport once more, from the formulas that generator/render/bsdf.h states: in double precision, with
// directional albedos by quadrature, brute-force intersection, and nothing of the product's code. What tests hold the product against.
#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <vector>

#include "generator/core/math.h"

namespace moomill::test {

// Reflectance of a dielectric of index 1.5, from Snell's law and Fresnel's equations.
inline double reference_fresnel(double c) {
  const double ct = std::sqrt(1 - (1 - c * c) / (1.5 * 1.5));
  const double rs = (c - 1.5 * ct) / (c + 1.5 * ct), rp = (1.5 * c - ct) / (1.5 * c + ct);
  return 0.5 * (rs * rs + rp * rp);
}

inline double reference_ggx_d(const dvec3& h, double alpha) {
  const double a2 = alpha * alpha, q = a2 * h.z * h.z + h.x * h.x + h.y * h.y;
  return a2 / (pi * q * q);
}

inline double reference_ggx_g2(double co, double ci, double alpha) {
  const auto lambda = [&](double c) { return 0.5 * (std::sqrt(1 + alpha * alpha * (1 - c * c) / (c * c)) - 1); };
  return 1 / (1 + lambda(co) + lambda(ci));
}

// Double integral over the hemisphere of D G F / (4 co) for an outgoing cosine; mirror: F = 1. In half vectors drawn by D cos(h), where the
// integrand is F G (o.h) / (co h.z) over the unit square; the radial variable is stretched towards the tail, which falls below the horizon.
inline double reference_specular_albedo(double co, double alpha, bool mirror, int radii = 400, int angles = 96) {
  const dvec3 wo(std::sqrt(std::max(0.0, 1 - co * co)), 0, co);
  double sum = 0;
  for (int a = 0; a < radii; ++a) {
    const double s = 1 - (a + 0.5) / radii, q = 1 - s * s * s, weight = 3 * s * s / radii;
    const double t2 = alpha * alpha * q / (1 - q), z = 1 / std::sqrt(1 + t2), r = std::sqrt(t2) * z;
    for (int b = 0; b < angles; ++b) {
      const double phi = pi * (b + 0.5) / angles;  // the other half mirrors it
      const dvec3 h(r * std::cos(phi), r * std::sin(phi), z);
      const double oh = glm::dot(wo, h), ci = 2 * oh * z - co;
      if (oh > 0 && ci > 0) sum += weight / angles * (mirror ? 1.0 : reference_fresnel(oh)) * reference_ggx_g2(co, ci, alpha) * oh / (co * z);
    }
  }
  return sum;
}

// That integral tabulated over the square root of the cosine, and its cosine-weighted mean over the hemisphere.
struct ReferenceAlbedo {
  static constexpr int n = 160;
  std::vector<double> table;
  double average = 0;
  ReferenceAlbedo(double alpha, bool mirror) {
    for (int i = 0; i <= n; ++i) {
      const double x = std::max(i / double(n), 0.01);
      table.push_back(reference_specular_albedo(x * x, alpha, mirror));
    }
    constexpr int m = 4000;
    for (int i = 0; i < m; ++i) average += 2 * at((i + 0.5) / m) * (i + 0.5) / m / m;
  }
  double at(double cosine) const {
    const double x = std::sqrt(std::clamp(cosine, 0.0, 1.0)) * n;
    const int i = std::min(n - 1, static_cast<int>(x));
    return table[i] + (x - i) * (table[i + 1] - table[i]);
  }
};

// A finish. Directions are local, z up.
struct ReferenceFinish {
  double roughness, metallic, specular;
  ReferenceAlbedo dielectric, mirror;
  ReferenceFinish(double roughness_, double metallic_, double specular_ = 1)
      : roughness(roughness_), metallic(metallic_), specular(specular_), dielectric(alpha(), false), mirror(alpha(), true) {}
  double alpha() const { return roughness * roughness; }

  // BSDF without the cosine is x + y b + z b^2 in the base colour b.
  dvec3 coefficients(const dvec3& wo, const dvec3& wi) const {
    const dvec3 h = glm::normalize(wo + wi);
    const double oh = glm::dot(wo, h);
    const double lobe = reference_ggx_d(h, alpha()) * reference_ggx_g2(wo.z, wi.z, alpha()) / (4 * wo.z * wi.z);
    const double below = (1 - specular * dielectric.at(wo.z)) * (1 - specular * dielectric.at(wi.z)) / (1 - specular * dielectric.average);
    const double s5 = std::pow(1 - oh, 5.0), es = mirror.at(wo.z), gain = (1 - es) / es;
    dvec3 f = (1 - metallic) * dvec3(lobe * specular * reference_fresnel(oh), below / pi, 0);
    f += metallic * lobe * dvec3(s5, 1 - s5 + s5 * gain, (1 - s5) * gain);  // (s5 + (1 - s5) b) (1 + b gain)
    return f;
  }
  dvec3 evaluate(const dvec3& wo, const dvec3& wi, const dvec3& base) const {
    const dvec3 c = coefficients(wo, wi);
    return c.x + base * (c.y + base * c.z);
  }
};

}  // namespace moomill::test
