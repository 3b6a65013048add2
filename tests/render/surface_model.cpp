// The surface model against formulas and double integrals of tests/render/reference.h: values, energy of every lobe, reciprocity.
#include "generator/render/sampler.h"
#include "tests/render/fixtures.h"
#include "tests/render/reference.h"

using namespace moomill;
using namespace moomill::test;

namespace {

vec3 towards(double cosine) {
  return vec3(dvec3(std::sqrt(1 - cosine * cosine), 0, cosine));
}

// Double integral over the hemisphere of f(wi), which holds the cosine: midpoints of two maps of the square, one by cosine and one by half vectors
// with density D cos(h), joined by the balance heuristic. Exact for each map's own lobe; no random numbers.
template <class F>
dvec3 hemisphere_integral(const vec3& wo, double alpha, const F& f) {
  constexpr int radii = 500, angles = 128;
  const dvec3 o(wo);
  const auto density = [&](const dvec3& wi) {
    const dvec3 h = glm::normalize(o + wi);
    return wi.z / pi + reference_ggx_d(h, alpha) * h.z / (4 * glm::dot(o, h));
  };
  dvec3 sum(0);
  for (int a = 0; a < radii; ++a)
    for (int b = 0; b < angles; ++b) {
      const double s = 1 - (a + 0.5) / radii, q = 1 - s * s * s, weight = 3 * s * s / (radii * angles), phi = 2 * pi * (b + 0.5) / angles;
      const dvec3 around(std::cos(phi), std::sin(phi), 0);
      dvec3 wi = std::sqrt(q) * around + dvec3(0, 0, std::sqrt(1 - q));
      sum += weight / density(wi) * f(wi);
      const double t2 = alpha * alpha * q / (1 - q), z = 1 / std::sqrt(1 + t2);
      const dvec3 h = std::sqrt(t2) * z * around + dvec3(0, 0, z);
      wi = 2 * glm::dot(o, h) * h - o;
      if (wi.z > 0 && glm::dot(o, h) > 0) sum += weight / density(wi) * f(wi);
    }
  return sum;
}

dvec3 product(const Bsdf& bsdf, const dvec3& wi) {
  const BaseResponse r = bsdf.evaluate(vec3(wi));
  return {r.a, r.b, r.c};
}

struct Mix {
  const char* name;
  double metallic, specular;
};
const Mix mixes[] = {{"dielectric", 0, 1}, {"metal", 1, 1}, {"mixed", 0.4, 1}, {"specular 0.5", 0, 0.5}, {"lambert", 0, 0}, {"mixed, specular 0.3", 0.6, 0.3}};
const double roughnesses[] = {0.1, 0.25, 0.5, 0.77, 1.0};

}  // namespace

TEST_CASE("reference: the quadrature of the specular albedo has converged, and agrees with plain midpoints over the hemisphere") {
  for (const double alpha : {0.01, 0.25, 1.0})
    for (const double co : {0.02, 0.2, 0.9}) {
      const double e = reference_specular_albedo(co, alpha, false);
      CHECK(e == doctest::Approx(reference_specular_albedo(co, alpha, false, 1600, 256)).epsilon(2e-4));
      if (alpha < 0.1) continue;
      double sum = 0;
      constexpr int n = 1200;
      const dvec3 wo(std::sqrt(1 - co * co), 0, co);
      for (int a = 0; a < n; ++a)
        for (int b = 0; b < n / 4; ++b) {
          const double z = std::pow((a + 0.5) / n, 2.0), phi = pi * (b + 0.5) / (n / 4), s = std::sqrt(1 - z * z);
          const dvec3 wi(s * std::cos(phi), s * std::sin(phi), z), h = glm::normalize(wo + wi);
          sum += reference_ggx_d(h, alpha) * reference_ggx_g2(co, z, alpha) * reference_fresnel(glm::dot(wo, h)) / (4 * co) * 2 * (a + 0.5) / n;
        }
      CHECK(e == doctest::Approx(sum / (n * (n / 4)) * 2 * pi).epsilon(2e-3));
    }
}

TEST_CASE("BSDF: evaluate() is the formulas in double, coefficient by coefficient") {
  std::mt19937_64 random(3);
  const auto unit = [&] { return static_cast<double>(random() >> 11) * 0x1p-53; };
  std::map<std::string, double> worst;
  for (const double roughness : roughnesses) {
    ReferenceFinish truth(roughness, 0);
    for (const Mix& mix : mixes) {
      truth.metallic = mix.metallic;
      truth.specular = mix.specular;
      for (int i = 0; i < 500; ++i) {
        const vec3 wo = towards(0.02 + 0.98 * unit());
        const double z = 0.02 + 0.98 * unit(), phi = 2 * pi * unit(), s = std::sqrt(1 - z * z);
        const vec3 wi(dvec3(s * std::cos(phi), s * std::sin(phi), z));
        const Bsdf bsdf(static_cast<float>(roughness), static_cast<float>(mix.metallic), wo, static_cast<float>(mix.specular));
        const dvec3 ours = product(bsdf, dvec3(wi)), theirs = truth.coefficients(glm::normalize(dvec3(wo)), glm::normalize(dvec3(wi))) * double(wi.z);
        for (int k = 0; k < 3; ++k) {
          // Against the whole of a white surface. a holds no table; b and c do.
          const double error = std::abs(ours[k] - theirs[k]) / (theirs.x + theirs.y + theirs.z + 1e-4);
          double& w = worst[std::string(mix.name) + (k == 0 ? ", a" : k == 1 ? ", b" : ", c")];
          w = std::max(w, error);
          CAPTURE(roughness);
          CAPTURE(k);
          INFO(std::string(mix.name), " wo.z ", wo.z, " wi.z ", wi.z, " ours ", ours[k], " reference ", theirs[k]);
          CHECK(error < (k == 0 ? 5e-4 : 0.01));
        }
      }
    }
  }
  for (const auto& [name, w] : worst) MESSAGE(name, ": largest relative difference ", w);
}

TEST_CASE("BSDF: directional albedo of every lobe is the tabulated double integral, and sample() carries it") {
  double worst_quadrature = 0, worst_sampled = 0, worst_white = 0, worst_known = 0;
  for (const double roughness : roughnesses) {
    ReferenceFinish truth(roughness, 0);
    for (const Mix& mix : mixes) {
      truth.metallic = mix.metallic;
      truth.specular = mix.specular;
      for (const double cosine : {0.05, 0.2, 0.5, 0.8, 1.0}) {
        const vec3 wo = towards(cosine);
        const Bsdf bsdf(static_cast<float>(roughness), static_cast<float>(mix.metallic), wo, static_cast<float>(mix.specular));
        const dvec3 ours = hemisphere_integral(wo, truth.alpha(), [&](const dvec3& wi) { return product(bsdf, wi); });
        const dvec3 theirs = hemisphere_integral(wo, truth.alpha(), [&](const dvec3& wi) { return truth.coefficients(dvec3(wo), wi) * wi.z; });
        // In closed form where there is one: what the dielectric's lobe reflects, and what it leaves to the base.
        const double ed = mix.specular * reference_specular_albedo(cosine, truth.alpha(), false);
        if (mix.metallic == 0) {
          CHECK(theirs.x == doctest::Approx(ed).epsilon(1e-3));
          CHECK(theirs.y == doctest::Approx(1 - ed).epsilon(1e-3));
          CHECK(theirs.z == 0);
        }
        dvec3 sampled(0);
        constexpr int n = 1 << 14;
        const PixelSampler sampler(9, 4);
        for (int i = 0; i < n; ++i) {
          const BsdfSample s = bsdf.sample(sampler.get(0, i), sampler.get(1, i).x);
          if (s.pdf > 0) sampled += product(bsdf, dvec3(s.wi)) / (double(s.pdf) * n);
        }
        CAPTURE(roughness);
        CAPTURE(cosine);
        INFO(std::string(mix.name));
        for (int k = 0; k < 3; ++k) {
          CHECK(std::abs(ours[k] - theirs[k]) < 0.002);
          CHECK(std::abs(sampled[k] - ours[k]) < 0.006);
          worst_quadrature = std::max(worst_quadrature, std::abs(ours[k] - theirs[k]));
          worst_sampled = std::max(worst_sampled, std::abs(sampled[k] - ours[k]));
          CHECK(ours[k] >= 0);
          CHECK(ours[k] <= 1.002);
        }
        if (bsdf.albedo_is_known()) {
          const BaseResponse known = bsdf.albedo();
          const double off = std::max({std::abs(known.a - ours.x), std::abs(known.b - ours.y), std::abs(known.c - ours.z)});
          CHECK(off < 2e-4);
          worst_known = std::max(worst_known, off);
        }
        const double white = ours.x + ours.y + ours.z;
        worst_white = std::max(worst_white, std::abs(white - 1));
        CHECK(std::abs(white - 1) < 0.002);
      }
    }
  }
  MESSAGE("largest differences: product's integral and the reference's ", worst_quadrature, ", product's samples and its integral ", worst_sampled,
          ", all lobes of a white surface and 1 ", worst_white, ", albedo() where it is known ", worst_known);
}

TEST_CASE("BSDF: reciprocal but for the metal's gain, which is the documented factor of the outgoing side") {
  std::mt19937 random(11);
  const auto unit = [&] { return static_cast<float>(random() >> 8) * 0x1p-24f; };
  for (const Mix& mix : mixes) {
    double worst = 0, asymmetry = 0;
    for (const double roughness : roughnesses) {
      const ReferenceAlbedo mirror(roughness * roughness, true);
      for (int i = 0; i < 300; ++i) {
        const vec3 o = sample_cosine_hemisphere({unit(), unit()}), in = sample_cosine_hemisphere({unit(), unit()});
        if (o.z < 0.02f || in.z < 0.02f) continue;
        const float r = static_cast<float>(roughness), m = static_cast<float>(mix.metallic), s = static_cast<float>(mix.specular);
        const BaseResponse f = Bsdf(r, m, o, s).evaluate(in), g = Bsdf(r, m, in, s).evaluate(o);
        for (const double b : {0.0, 0.5, 1.0}) {
          // The metal's part of either side, without its gain 1 + b (1 - Es) / Es, is the same; so is the dielectric's as it stands.
          const float metal_f = Bsdf(r, 1, o).evaluate(in).at(float(b)), metal_g = Bsdf(r, 1, in).evaluate(o).at(float(b));
          const auto gain = [&](double c) { return 1 + b * (1 - mirror.at(c)) / mirror.at(c); };
          const double both_f = (f.at(float(b)) - m * metal_f * (1 - 1 / gain(o.z))) / in.z, both_g = (g.at(float(b)) - m * metal_g * (1 - 1 / gain(in.z))) / o.z;
          worst = std::max(worst, std::abs(both_f - both_g) / (std::abs(both_f) + 1e-3));
          asymmetry = std::max(asymmetry, std::abs(std::log((f.at(float(b)) / in.z + 1e-6) / (g.at(float(b)) / o.z + 1e-6))));
        }
      }
    }
    INFO(std::string(mix.name));
    MESSAGE(std::string(mix.name), ": largest asymmetry ", std::exp(asymmetry) - 1, ", without the metal's gain ", worst);
    CHECK(worst < 0.01);
    if (mix.metallic == 0) CHECK(std::exp(asymmetry) - 1 < 2e-3);
  }
}
