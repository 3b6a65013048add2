#include "textures/coat.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "generator/core/parallel.h"
#include "generator/core/random.h"
#include "textures/noise.h"
#include "textures/pattern.h"

namespace moomill {
namespace {

// One stream of noise per use, or patches and freckles of one seed would follow each other.
enum Stream : std::uint64_t {
  patch_shape,
  patch_detail,
  patch_border,
  freckle,
  freckle_shape,
  tuft,
  dirt,
  mark_border,
  plain
};

std::uint32_t key(std::uint64_t seed, Stream stream, std::uint64_t more = 0) {
  return static_cast<std::uint32_t>(hash_identity({seed, stream, more}));
}

double ramp(double lower, double upper, double x) {  // smoothstep; a step where the two agree
  if (upper <= lower) return x >= upper ? 1 : 0;
  const double t = std::clamp((x - lower) / (upper - lower), 0.0, 1.0);
  return t * t * (3 - 2 * t);
}

// Noise whose upper part is patches, without the raggedness of their borders.
double patch_level(const PatchPattern& p, const dvec3& at, std::uint64_t seed) {
  // Gradient noise has a blob in about every other cell: half the patch size per cell.
  const dvec3 q = at / (0.75 * p.scale);
  double level = gradient_noise(q, key(seed, patch_shape)) + 0.45 * gradient_noise(2.3 * q, key(seed, patch_detail));
  if (p.high > p.low) level -= 1.5 * (1 - ramp(p.low, p.high, at.z));
  return level;
}

double threshold_on_average(const PatchPattern& p) {
  const double share = std::clamp(p.share, 1e-4, 1 - 1e-4);
  return 0.3 * portable_log((1 - share) / share) / 1.702;  // the logistic stands in for the normal distribution
}

vec3 patches(const PatchPattern& p, const dvec3& at, std::uint64_t seed) {
  double level = patch_level(p, at, seed) - p.threshold.value_or(threshold_on_average(p));
  // The level changes by about 0.75 over one patch size, which turns lengths into levels.
  const double per_metre = 0.75 / p.scale;
  const double reach = 1.8 * p.raggedness * per_metre, soft = 0.5 * p.edge_softness * per_metre;
  if (std::abs(level) < reach + soft)
    level += p.raggedness * per_metre *
             (1.6 * gradient_noise(at / 0.07, key(seed, patch_border, 0)) +
              0.9 * gradient_noise(at / 0.027, key(seed, patch_border, 1)) +
              0.5 * gradient_noise(at / 0.009, key(seed, patch_border, 2)));
  return glm::mix(p.ground, p.patch, static_cast<float>(ramp(-soft, soft, level)));
}

vec3 plain_color(const PlainPattern& p, const dvec3& at, std::uint64_t seed) {
  const dvec3 q = at / p.variation_scale;
  const double v = gradient_noise(q, key(seed, plain, 0)) + 0.5 * gradient_noise(2.1 * q, key(seed, plain, 1));
  return p.color * static_cast<float>(std::max(0.0, 1 + 2 * p.variation * v));
}

// How much of a freckle covers a point. Freckles are balls around jittered points of a lattice: by Delesse's rule they
// cover the same share of any surface as of space.
double freckle_cover(const Freckles& f, const dvec3& where, std::uint64_t seed) {
  if (f.density <= 0) return 0;
  constexpr double cell = 1.3;            // in freckle sizes; no ball reaches farther than half a cell
  constexpr double mean_volume = 0.5628;  // of balls with radii uniform in [0.35, 0.65]
  const double presence = std::min(1.0, f.density * cell * cell * cell / mean_volume);
  const std::uint32_t shape = key(seed, freckle_shape);
  const dvec3 wobble(gradient_noise(where / (0.5 * f.size), shape),
                     gradient_noise(where / (0.5 * f.size) + 57.3, shape), 0);
  const dvec3 q = where / (cell * f.size) + 0.12 * wobble;
  const dvec3 base = glm::floor(q - 0.5);
  double cover = 0;
  for (int k = 0; k < 8; ++k) {
    const int x = static_cast<int>(base.x) + (k & 1), y = static_cast<int>(base.y) + (k >> 1 & 1),
              z = static_cast<int>(base.z) + (k >> 2);
    const std::uint32_t h = hash_cell(x, y, z, key(seed, freckle));
    if ((h >> 8) * 0x1.0p-24 >= presence) continue;
    const std::uint64_t more = mix64(h);
    const dvec3 centre = dvec3(x, y, z) + dvec3(more & 0xffff, more >> 16 & 0xffff, more >> 32 & 0xffff) * 0x1.0p-16;
    const double radius = (0.35 + 0.3 * static_cast<double>(more >> 48) * 0x1.0p-16) / cell;
    cover = std::max(cover, 1 - ramp(0.85, 1.1, glm::length(q - centre) / radius));
  }
  return cover;
}

double mark_cover(const Mark& m, const dvec3& at, std::uint32_t noise_key) {
  const dvec3 p = m.mirror ? dvec3(at.x, std::abs(at.y), at.z) : at;
  const dvec3 q = (p - m.at) / m.radii;
  const double r = glm::length(q);
  const double k1 = glm::length(q / m.radii);
  double d = r < 0.05 ? -std::min({m.radii.x, m.radii.y, m.radii.z}) : r * (r - 1) / k1;  // metres, to first order
  if (std::abs(d) < 2 * m.raggedness + m.softness)
    d += m.raggedness * (1.4 * gradient_noise(at / 0.06, noise_key) + 0.8 * gradient_noise(at / 0.02, noise_key + 1));
  return 1 - ramp(-0.5 * m.softness, 0.5 * m.softness, d);
}

bool matches(const std::string& pattern, const std::string& part) {
  if (pattern.ends_with('*')) return part.starts_with(std::string_view(pattern).substr(0, pattern.size() - 1));
  return pattern == part;
}

}  // namespace

bool part_has_color(const PartColor& color, const std::string& part) {
  return matches(color.part, part);
}

vec3 coat_color_without_parts(const ProceduralCoat& coat, const dvec3& at) {
  vec3 color = std::holds_alternative<PatchPattern>(coat.base)
                   ? patches(std::get<PatchPattern>(coat.base), at, coat.seed)
                   : plain_color(std::get<PlainPattern>(coat.base), at, coat.seed);
  color = glm::mix(color, coat.freckles.color, static_cast<float>(freckle_cover(coat.freckles, at, coat.seed)));
  for (std::size_t i = 0; i < coat.marks.size(); ++i)
    color = glm::mix(color, coat.marks[i].color,
                     static_cast<float>(mark_cover(coat.marks[i], at, key(coat.seed, mark_border, i))));
  return color;
}

float fur_shade(const ProceduralCoat& coat, const dvec3& at) {
  if (coat.fur <= 0) return 1;
  const double v = 1.6 * gradient_noise(at / dvec3(0.010, 0.006, 0.014), key(coat.seed, tuft)) +
                   0.8 * gradient_noise(at / 0.12, key(coat.seed, dirt));
  return static_cast<float>(std::max(0.0, 1 + coat.fur * v));
}

ProceduralCoat calibrated(ProceduralCoat coat, const Surface& surface) {
  PatchPattern* pattern = std::get_if<PatchPattern>(&coat.base);
  if (!pattern || pattern->threshold || surface.triangles.empty()) return coat;
  const std::size_t n = surface.triangles.size();
  std::vector<double> level(n), area(n);
  parallel_for(n, 256, [&](std::size_t t) {
    const uvec3& v = surface.triangles[t];
    const dvec3 a(surface.rest[v.x]), b(surface.rest[v.y]), c(surface.rest[v.z]);
    level[t] = patch_level(*pattern, (a + b + c) / 3.0, coat.seed);
    area[t] = 0.5 * glm::length(glm::cross(b - a, c - a));
  });
  std::vector<std::uint32_t> order(n);
  std::iota(order.begin(), order.end(), 0u);
  std::sort(order.begin(), order.end(),
            [&](auto a, auto b) { return level[a] != level[b] ? level[a] > level[b] : a < b; });
  const double wanted = pattern->share * std::accumulate(area.begin(), area.end(), 0.0);
  double covered = 0;
  pattern->threshold = level[order.back()] - 1;
  for (const std::uint32_t t : order) {
    if (covered >= wanted) {
      pattern->threshold = level[t];
      break;
    }
    covered += area[t];
  }
  return coat;
}

vec3 coat_color(const ProceduralCoat& coat, const dvec3& neutral, const vec3&, const std::string& part) {
  vec3 color = coat_color_without_parts(coat, neutral);
  for (const PartColor& p : coat.parts)
    if (part_has_color(p, part)) color = p.color;
  return glm::clamp(color * fur_shade(coat, neutral), 0.0f, 1.0f);
}

}  // namespace moomill
