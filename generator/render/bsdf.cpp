#include "generator/render/bsdf.h"

#include <vector>

#include "generator/core/parallel.h"

namespace moomill {
namespace {

constexpr float pi_f = std::numbers::pi_v<float>;

float smith_lambda(float cosine, float alpha) {
  const float c2 = std::max(cosine * cosine, 1e-14f);
  const float tan2 = std::max(0.0f, 1.0f - c2) / c2;
  return 0.5f * (std::sqrt(1.0f + alpha * alpha * tan2) - 1.0f);
}
float smith_g1(float cosine, float alpha) { return 1.0f / (1.0f + smith_lambda(cosine, alpha)); }
float smith_g2(float co, float ci, float alpha) {
  return 1.0f / (1.0f + smith_lambda(co, alpha) + smith_lambda(ci, alpha));
}

float alpha_of(float roughness) { return std::max(roughness * roughness, bsdf_min_alpha); }

// Directional albedo of the specular lobe, tabulated over cosine (quadratically denser towards grazing) and roughness.
struct AlbedoTable {
  static constexpr int cosines = 64, roughnesses = 65;
  std::vector<float> value = std::vector<float>(cosines * roughnesses);
  std::vector<float> average = std::vector<float>(roughnesses);  // 2 * integral of value * cosine

  // Midpoint rule over visible normals: the weight of a sample is F G2 / G1. The average integrates the table as
  // it is interpolated, so that what the diffuse base gets is exactly what the lobe leaves.
  template <class Fresnel>
  explicit AlbedoTable(const Fresnel& fresnel) {
    parallel_for(roughnesses, 1, [&](std::size_t r) {
      const float alpha = alpha_of(r / float(roughnesses - 1));
      for (int i = 0; i < cosines; ++i) {
        const float x = i / float(cosines - 1), co = std::max(x * x, 1e-4f);
        const vec3 wo(std::sqrt(1.0f - co * co), 0.0f, co);
        // Strata in the radius are finer towards its end: the long tail of GGX decides what falls below the horizon.
        constexpr int radii = 64, angles = 16;  // of half the circle: the other half mirrors it
        double sum = 0, weights = 0;
        for (int a = 0; a < radii; ++a) {
          const float q = 1.0f - (a + 0.5f) / radii, weight = q * q;
          weights += weight * angles;
          for (int b = 0; b < angles; ++b) {
            const vec3 h = sample_ggx_visible_normal(wo, alpha, {1.0f - q * q * q, 0.5f * (b + 0.5f) / angles - 0.25f});
            const float oh = glm::dot(wo, h);
            const vec3 wi = 2.0f * oh * h - wo;
            if (wi.z > 0 && oh > 0) sum += weight * fresnel(oh) * smith_g2(co, wi.z, alpha) / smith_g1(co, alpha);
          }
        }
        value[r * cosines + i] = static_cast<float>(std::min(1.0, sum / weights));
      }
    });
    for (int r = 0; r < roughnesses; ++r) {
      constexpr int n = 4096;
      double sum = 0;
      for (int k = 0; k < n; ++k) {
        const float c = (k + 0.5f) / n;
        sum += 2.0 * c * at(c, r / float(roughnesses - 1)) / n;
      }
      average[r] = static_cast<float>(sum);
    }
  }

  float at(float cosine, float roughness) const {
    const float x = std::sqrt(std::clamp(cosine, 0.0f, 1.0f)) * (cosines - 1);
    const float y = std::clamp(roughness, 0.0f, 1.0f) * (roughnesses - 1);
    const int i = std::min(static_cast<int>(x), cosines - 2), j = std::min(static_cast<int>(y), roughnesses - 2);
    const float fx = x - i, fy = y - j;
    const float* v = &value[j * cosines + i];
    return (v[0] * (1 - fx) + v[1] * fx) * (1 - fy) + (v[cosines] * (1 - fx) + v[cosines + 1] * fx) * fy;
  }
  float average_at(float roughness) const {
    const float y = std::clamp(roughness, 0.0f, 1.0f) * (roughnesses - 1);
    const int j = std::min(static_cast<int>(y), roughnesses - 2);
    return average[j] * (1 - (y - j)) + average[j + 1] * (y - j);
  }
};

const AlbedoTable& dielectric_albedo() {
  static const AlbedoTable table([](float c) { return fresnel_dielectric(c, bsdf_ior); });
  return table;
}
const AlbedoTable& mirror_albedo() {
  static const AlbedoTable table([](float) { return 1.0f; });
  return table;
}

}  // namespace

float specular_albedo(float cosine, float roughness) {
  return dielectric_albedo().at(cosine, std::sqrt(alpha_of(std::clamp(roughness, 0.0f, 1.0f))));
}
float mean_specular_albedo(float roughness) {
  return dielectric_albedo().average_at(std::sqrt(alpha_of(std::clamp(roughness, 0.0f, 1.0f))));
}

float fresnel_dielectric(float cosine, float ior) {
  const float c = std::clamp(cosine, 0.0f, 1.0f);
  const float g2 = ior * ior - 1.0f + c * c;
  if (g2 <= 0) return 1.0f;
  const float g = std::sqrt(g2);
  const float a = (g - c) / (g + c), b = (c * (g + c) - 1.0f) / (c * (g - c) + 1.0f);
  return 0.5f * a * a * (1.0f + b * b);
}

float ggx_d(const vec3& h, float alpha) {
  if (h.z <= 0) return 0;
  // From the sine, not from 1 - cos^2: at small alpha the difference would lose all digits.
  const float a2 = alpha * alpha, d = h.z * h.z * a2 + h.x * h.x + h.y * h.y;
  return a2 / (pi_f * d * d);
}

vec3 sample_ggx_visible_normal(const vec3& wo, float alpha, const vec2& u) {
  const vec3 v = glm::normalize(vec3(alpha * wo.x, alpha * wo.y, wo.z));
  const float length2 = v.x * v.x + v.y * v.y;
  const vec3 t1 = length2 > 1e-14f ? vec3(-v.y, v.x, 0) / std::sqrt(length2) : vec3(1, 0, 0);
  const vec3 t2 = glm::cross(v, t1);
  const float r = std::sqrt(u.x), phi = 2.0f * pi_f * u.y;
  const float p1 = r * std::cos(phi), s = 0.5f * (1.0f + v.z);
  const float p2 = (1.0f - s) * std::sqrt(std::max(0.0f, 1.0f - p1 * p1)) + s * r * std::sin(phi);
  const vec3 n = p1 * t1 + p2 * t2 + std::sqrt(std::max(0.0f, 1.0f - p1 * p1 - p2 * p2)) * v;
  return glm::normalize(vec3(alpha * n.x, alpha * n.y, std::max(1e-7f, n.z)));
}

vec3 sample_cosine_hemisphere(const vec2& u) {
  const float r = std::sqrt(u.x), phi = 2.0f * pi_f * u.y;
  return {r * std::cos(phi), r * std::sin(phi), std::sqrt(std::max(1e-12f, 1.0f - u.x))};
}

Frame::Frame(const vec3& n) : z(n) {
  const float sign = std::copysign(1.0f, n.z), a = -1.0f / (sign + n.z), b = n.x * n.y * a;
  x = {1.0f + sign * n.x * n.x * a, sign * b, -sign * n.x};
  y = {b, sign + n.y * n.y * a, -n.y};
}

Bsdf::Bsdf(float roughness, float metallic, const vec3& wo, float specular, float least_specular)
    : wo_(wo),
      alpha_(alpha_of(std::clamp(roughness, 0.0f, 1.0f))),
      roughness_(std::sqrt(alpha_)),
      metallic_(std::clamp(metallic, 0.0f, 1.0f)),
      specular_(specular) {
  ed_wo_ = specular_ * dielectric_albedo().at(wo.z, roughness_);
  ed_average_ = specular_ * dielectric_albedo().average_at(roughness_);
  es_wo_ = metallic_ > 0 ? mirror_albedo().at(wo.z, roughness_) : 1.0f;
  // As for a white base.
  const float share = metallic_ + (1.0f - metallic_) * ed_wo_;
  specular_probability_ = metallic_ == 1.0f ? 1.0f : share == 0.0f ? 0.0f : std::clamp(share, least_specular, 0.95f);
}

BaseResponse Bsdf::evaluate(const vec3& wi) const { return value(wi).response; }

Bsdf::Value Bsdf::value(const vec3& wi) const {
  Value out;
  if (wi.z <= 0 || wo_.z <= 0) return out;
  BaseResponse& r = out.response;
  const vec3 h = glm::normalize(wo_ + wi);
  const float oh = glm::dot(wo_, h);
  const float lambda_o = smith_lambda(wo_.z, alpha_), lambda_i = smith_lambda(wi.z, alpha_);
  const float d = ggx_d(h, alpha_) / (4.0f * wo_.z);
  const float dg = d / (1.0f + lambda_o + lambda_i);  // times cos(wi)
  const float dielectric = 1.0f - metallic_;
  if (dielectric > 0) {
    if (specular_ > 0) r.a += dielectric * dg * fresnel_dielectric(oh, bsdf_ior) * specular_;
    const float ed_wi = specular_ > 0 ? specular_ * dielectric_albedo().at(wi.z, roughness_) : 0.0f;
    r.b += dielectric * (1.0f - ed_wo_) * (1.0f - ed_wi) / (1.0f - ed_average_) * wi.z / pi_f;
  }
  if (metallic_ > 0) {
    const float m = 1.0f - std::clamp(oh, 0.0f, 1.0f), m2 = m * m, s5 = m2 * m2 * m;
    const float k = (1.0f - es_wo_) / std::max(es_wo_, 1e-3f);
    r.a += metallic_ * dg * s5;
    r.b += metallic_ * dg * ((1.0f - s5) + s5 * k);
    r.c += metallic_ * dg * (1.0f - s5) * k;
  }
  out.specular_pdf = d / (1.0f + lambda_o);
  out.pdf = specular_probability_ * out.specular_pdf + (1.0f - specular_probability_) * wi.z / pi_f;
  return out;
}

BaseResponse Bsdf::albedo() const {
  BaseResponse r;
  if (wo_.z <= 0) return r;
  r.a = (1.0f - metallic_) * ed_wo_;
  r.b = (1.0f - metallic_) * (1.0f - ed_wo_);
  return r;
}

float Bsdf::pdf(const vec3& wi) const {
  if (wi.z <= 0 || wo_.z <= 0) return 0;
  const vec3 h = glm::normalize(wo_ + wi);
  // Density of visible normals, D G1 (wo.h) / (wo.z), over the Jacobian 4 (wo.h).
  const float specular = ggx_d(h, alpha_) * smith_g1(wo_.z, alpha_) / (4.0f * wo_.z);
  return specular_probability_ * specular + (1.0f - specular_probability_) * wi.z / pi_f;
}

bool Bsdf::sample_direction(const vec2& u, float lobe, vec3& wi) const {
  if (wo_.z <= 0) return false;
  if (lobe < specular_probability_) return sample_specular(u, wi);
  wi = glm::normalize(sample_cosine_hemisphere(u));
  return true;
}

bool Bsdf::sample_specular(const vec2& u, vec3& wi) const {
  if (wo_.z <= 0) return false;
  const vec3 h = sample_ggx_visible_normal(wo_, alpha_, u);
  wi = 2.0f * glm::dot(wo_, h) * h - wo_;
  if (wi.z <= 0) return false;  // below the surface: a failed sample carries nothing
  wi = glm::normalize(wi);
  return true;
}

float Bsdf::diffuse_factor() const { return (1.0f - metallic_) * (1.0f - ed_wo_) / (1.0f - ed_average_) / pi_f; }

BsdfSample Bsdf::sample(const vec2& u, float lobe) const {
  BsdfSample s;
  if (sample_direction(u, lobe, s.wi)) s.pdf = pdf(s.wi);
  return s;
}

}  // namespace moomill
