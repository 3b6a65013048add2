#include "textures/coat.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "generator/core/error.h"
#include "generator/core/random.h"
#include "textures/noise.h"

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
  plain,
  patch_warp,
  freckle_group,
  shade_blotch,
  part_border,
  part_mottle,
  cell_border
};

std::uint32_t key(std::uint64_t seed, Stream stream, std::uint64_t more = 0) {
  return static_cast<std::uint32_t>(hash_identity({seed, stream, more}));
}

double ramp(double lower, double upper, double x) {  // smoothstep; a step where the two agree
  if (upper <= lower) return x >= upper ? 1 : 0;
  const double t = std::clamp((x - lower) / (upper - lower), 0.0, 1.0);
  return t * t * (3 - 2 * t);
}

// From 0 at `from` to 1 at `to`, which may lie below it.
double rise(double from, double to, double x) {
  return from <= to ? ramp(from, to, x) : 1 - ramp(to, from, x);
}

// What two octaves of noise exceed on this share of space; the logistic stands in for the normal distribution.
double exceeded_by(double share) {
  share = std::clamp(share, 1e-4, 1 - 1e-4);
  return 0.3 * portable_log((1 - share) / share) / 1.702;
}

// Displacement of a border, about in [-1, 1]: round lobes with sharp notches at three sizes.
double lobes(const dvec3& at, std::uint32_t noise_key) {
  const auto billow = [&](double size, std::uint32_t k) { return std::abs(gradient_noise(at / size, k)) - 0.21; };
  return 2.6 * billow(0.13, noise_key) + 1.7 * billow(0.05, noise_key + 1) +
         0.6 * gradient_noise(at / 0.017, noise_key + 2);
}

// Noise whose upper part is patches, without the raggedness of their borders.
double patch_level(const ReadyCoat& c, const PatchPattern& p, const dvec3& at, const vec3& normal) {
  // Gradient noise has a blob in about every other cell: less than the patch size per cell.
  dvec3 q = at / (0.75 * p.scale);
  const std::uint32_t warp = key(c.coat.seed, patch_warp);
  q += 0.30 * dvec3(gradient_noise(1.6 * q, warp), gradient_noise(1.6 * q, warp + 1), gradient_noise(1.6 * q, warp + 2));
  double level = gradient_noise(q, key(c.coat.seed, patch_shape)) +
                 0.35 * gradient_noise(2.1 * q, key(c.coat.seed, patch_detail));
  const double height = (at.z - c.floor) / c.height;
  level += p.dorsal * (2 * (height - 0.65) - ramp(0.5, 0.95, -normal.z));
  if (p.high > p.low) level -= 1.5 * (1 - ramp(p.low, p.high, height));
  return level;
}

// Metres within a patch; exact only near borders, elsewhere large enough.
double depth_in_patch(const ReadyCoat& c, const PatchPattern& p, const HidePoint& h) {
  const double level = patch_level(c, p, h.at, h.normal) - c.threshold;
  const double typical_slope = 0.75 / p.scale;  // per metre
  const double reach = 1.6 * p.raggedness + 1.2 * p.fringe + p.edge_softness + 1.5 * p.skin_shadow;
  if (std::abs(level) > 2.5 * typical_slope * reach) return level / typical_slope;
  // What the surface sees of the slope: differences along two directions that lie in it.
  const dvec3 n(h.normal), t = glm::normalize(glm::cross(n, std::abs(n.y) < 0.7 ? dvec3(0, 1, 0) : dvec3(1, 0, 0))),
              b = glm::cross(n, t);
  constexpr double e = 0.004;
  const double st = (patch_level(c, p, h.at + e * t, h.normal) - c.threshold - level) / e,
               sb = (patch_level(c, p, h.at + e * b, h.normal) - c.threshold - level) / e;
  const dvec3 along = st * t + sb * b;
  const double steep = std::max(glm::length(along), 0.4 * typical_slope);
  // Hair reaches over borders it runs across, not over those it runs along.
  const double across = std::abs(glm::dot(along, dvec3(h.hair))) / steep;
  return level / steep + p.raggedness * lobes(h.at, key(c.coat.seed, patch_border)) +
         p.fringe * (0.25 + 0.75 * across) * h.streak;
}

vec3 patches(const ReadyCoat& c, const PatchPattern& p, const HidePoint& h) {
  const double depth = depth_in_patch(c, p, h);
  vec3 ground = p.ground;
  if (p.skin_shadow > 0 && depth < 0 && depth > -1.5 * p.skin_shadow) {
    // Around a patch the skin stays dark a little farther than the hair, and shows through it bluish ("blue roan" edge).
    const double shadow = 0.5 * ramp(-1.5 * p.skin_shadow, 0, depth);
    ground = glm::mix(ground, p.patch + 0.30f * (p.ground - p.patch) * vec3(0.92f, 0.97f, 1.06f),
                      static_cast<float>(shadow));
  }
  return glm::mix(ground, p.patch, static_cast<float>(ramp(-0.5 * p.edge_softness, 0.5 * p.edge_softness, depth)));
}

vec3 plain_color(const PlainPattern& p, const dvec3& at, std::uint64_t seed) {
  const dvec3 q = at / p.variation_scale;
  const double v = gradient_noise(q, key(seed, plain, 0)) + 0.5 * gradient_noise(2.1 * q, key(seed, plain, 1));
  return p.color * static_cast<float>(std::max(0.0, 1 + 2 * p.variation * v));
}

// How much of a freckle covers a point. Freckles are balls around jittered points of a lattice: by Delesse's rule they
// cover the same share of any surface as of space.
double freckle_cover(double density, double size, const HidePoint& h, std::uint64_t seed, std::uint64_t octave) {
  constexpr double cell = 1.3;            // in freckle sizes; no ball reaches farther than half a cell
  constexpr double mean_volume = 0.5628;  // of balls with radii uniform in [0.35, 0.65]
  const double presence = density * cell * cell * cell / mean_volume;
  const std::uint32_t shape = key(seed, freckle_shape, octave);
  const dvec3 w = h.at / (0.45 * size);
  const dvec3 wobble(gradient_noise(w, shape), gradient_noise(w, shape + 1), gradient_noise(w, shape + 2));
  const dvec3 q = h.at / (cell * size) + 0.28 * wobble;
  const dvec3 base = glm::floor(q - 0.5);
  const std::uint32_t lattice = key(seed, freckle, octave);
  double cover = 0;
  for (int k = 0; k < 8; ++k) {
    const int x = static_cast<int>(base.x) + (k & 1), y = static_cast<int>(base.y) + (k >> 1 & 1),
              z = static_cast<int>(base.z) + (k >> 2);
    const std::uint32_t hash = hash_cell(x, y, z, lattice);
    if ((hash >> 8) * 0x1.0p-24 >= presence) continue;
    const std::uint64_t more = mix64(hash);
    const dvec3 centre = dvec3(x, y, z) + dvec3(more & 0xffff, more >> 16 & 0xffff, more >> 32 & 0xffff) * 0x1.0p-16;
    const double radius = (0.35 + 0.3 * static_cast<double>(more >> 48) * 0x1.0p-16) / cell;
    cover = std::max(cover, 1 - ramp(0.8, 1.15, glm::length(q - centre) / radius + 0.3 * h.streak));
  }
  return cover;
}

double freckles_cover(const Freckles& f, const HidePoint& h, std::uint64_t seed) {
  if (f.density <= 0) return 0;
  // Groups: a factor of mean 1 on the density, which by the noise's symmetry keeps the share.
  const double group = ramp(-0.3, 0.3, gradient_noise(h.at / (10 * f.size), key(seed, freckle_group)));
  const double density = f.density * (1 + f.clustering * (2 * group - 1));
  // Few large ones, many small: three sizes share the area, each thinned by those before it.
  double bare = 1, left = density;
  for (const auto& [part, size] : {std::pair(0.45, 1.0), std::pair(0.33, 0.55), std::pair(0.22, 0.3)}) {
    const double own = part * density / (1 - (density - left));
    bare *= 1 - freckle_cover(own, size * f.size, h, seed, static_cast<std::uint64_t>(100 * size));
    left -= part * density;
  }
  return 1 - bare;
}

double mark_cover(const Mark& m, const PartFrame& frame, const HidePoint& h, std::uint32_t noise_key) {
  const dvec3 p = m.mirror ? dvec3(h.at.x, std::abs(h.at.y), h.at.z) : h.at;
  const dvec3 q = glm::transpose(frame.axes) * (p - frame.centre) / frame.half;
  const double r = glm::length(q), k1 = glm::length(q / frame.half);
  // Metres within, to first order.
  double depth = r < 0.05 ? std::min({frame.half.x, frame.half.y, frame.half.z}) : r * (1 - r) / k1;
  if (std::abs(depth) < 3 * m.raggedness + 1.5 * m.fringe + m.softness)
    depth += m.raggedness * lobes(h.at, noise_key) + m.fringe * h.streak;
  return ramp(-0.5 * m.softness, 0.5 * m.softness, depth);
}

vec3 on_side(const vec3& left, double y) { return {left.x, y < 0 ? -left.y : left.y, left.z}; }

double shade_cover(const ReadyCoat& c, std::size_t i, const HidePoint& h) {
  const Shade& s = c.coat.shades[i];
  double cover = s.amount;
  if (c.shade_parts[i] >= 0) {
    const double inside = h.inside[c.shade_parts[i]] + 0.15 * s.softness * h.streak;
    cover *= ramp(-0.5 * s.softness, 0.5 * s.softness, inside);
  }
  if (s.heights) cover *= rise(s.heights->x, s.heights->y, (h.at.z - c.floor) / c.height);
  if (s.facing != vec3(0))
    cover *= rise(s.facing_range.x, s.facing_range.y,
                  glm::dot(h.normal, glm::normalize(on_side(s.facing, h.at.y))));
  if (cover > 0 && s.patchiness > 0) {
    const std::uint32_t k = key(c.coat.seed, shade_blotch, i);
    const double v = gradient_noise(h.at / s.scale, k) + 0.5 * gradient_noise(2.7 * h.at / s.scale, k + 1) + 0.1 * h.streak;
    cover *= 1 - s.patchiness + s.patchiness * ramp(-0.25, 0.35, v);
  }
  return cover;
}

vec3 part_color(const PartColor& p, double depth, double deepest, const HidePoint& h, std::uint32_t noise_key) {
  vec3 color = p.color;
  if (p.mottle) {
    const dvec3 q = h.at / p.mottle_scale;
    const double v = gradient_noise(q, noise_key + 10) + 0.5 * gradient_noise(2.3 * q, noise_key + 11);
    const double t = exceeded_by(p.mottle_share);
    color = glm::mix(color, *p.mottle, static_cast<float>(ramp(t - 0.13, t + 0.13, v)));
  }
  if (p.tip) {
    const double way = depth / std::max(deepest, 1e-6) + 0.12 * gradient_noise(h.at / 0.02, noise_key + 12);
    color = glm::mix(color, *p.tip, static_cast<float>(rise(p.tip_from, p.tip_to, way)));
  }
  if (p.rings > 0)
    color *= static_cast<float>(
        1 + p.rings * 2.5 * gradient_noise({depth / p.ring_spacing, 0.4, 0.6 + 8 * h.at.y}, noise_key + 13));
  return color;
}

}  // namespace

void know_parts(Hide& hide, const ProceduralCoat& coat) {
  for (const Shade& s : coat.shades)
    if (!s.part.empty()) know_part(hide, s.part);
  for (const PartColor& p : coat.parts) know_part(hide, p.part);
}

ReadyCoat ready_coat(const ProceduralCoat& coat, const Hide& hide) {
  ReadyCoat ready;
  ready.coat = coat;
  if (!hide.box.empty()) {
    ready.floor = hide.box.lower.z;
    ready.height = std::max(hide.box.size().z, 1e-6);
  }
  for (const Mark& m : coat.marks) {
    PartFrame frame = m.part.empty() ? PartFrame{dvec3(0), dmat3(1.0), dvec3(1)} : part_frame(hide, m.part);
    if (!frame.empty()) {
      frame.centre += frame.axes * (m.at * frame.half);
      frame.half *= m.radii;
    }
    ready.mark_frames.push_back(frame);
  }
  for (const Shade& s : coat.shades) ready.shade_parts.push_back(s.part.empty() ? -1 : hide.pattern(s.part));
  for (const PartColor& p : coat.parts) {
    ready.color_parts.push_back(hide.pattern(p.part));
    ready.part_depths.push_back(hide.deepest[ready.color_parts.back()]);
  }
  if (const auto* cells = std::get_if<CellPattern>(&coat.base)) ready.cells = strew_cells(*cells, hide, coat.seed);
  if (const auto* pattern = std::get_if<PatchPattern>(&coat.base)) {
    std::vector<double> levels;
    std::vector<float> inside;
    for (const Hide::Sample& s : hide.samples) {
      const HidePoint p = hide_point(hide, s.triangle, dvec3(s.weights), inside, false);
      levels.push_back(patch_level(ready, *pattern, p.at, p.normal));
    }
    if (levels.empty()) {
      ready.threshold = exceeded_by(pattern->share);
    } else {
      const auto n = levels.size();
      const auto bare = static_cast<std::size_t>((1 - std::clamp(pattern->share, 0.0, 1.0)) * static_cast<double>(n));
      std::sort(levels.begin(), levels.end());
      ready.threshold = bare == 0 ? levels.front() - 10 : bare >= n ? levels.back() + 10 : 0.5 * (levels[bare - 1] + levels[bare]);
    }
  }
  return ready;
}

double patch_depth(const ReadyCoat& coat, const HidePoint& point) {
  const auto* pattern = std::get_if<PatchPattern>(&coat.coat.base);
  return pattern ? depth_in_patch(coat, *pattern, point) : 0;
}

vec3 coat_color(const ReadyCoat& ready, const HidePoint& h) {
  const ProceduralCoat& coat = ready.coat;
  vec3 color;
  if (const auto* p = std::get_if<PatchPattern>(&coat.base))
    color = patches(ready, *p, h);
  else if (const auto* c = std::get_if<CellPattern>(&coat.base))
    color = cell_color(*c, ready.cells, h, key(coat.seed, cell_border));
  else
    color = plain_color(std::get<PlainPattern>(coat.base), h.at, coat.seed);
  color = glm::mix(color, coat.freckles.color, static_cast<float>(freckles_cover(coat.freckles, h, coat.seed)));
  for (std::size_t i = 0; i < coat.marks.size(); ++i)
    if (!ready.mark_frames[i].empty())
      color = glm::mix(color, coat.marks[i].color,
                       static_cast<float>(mark_cover(coat.marks[i], ready.mark_frames[i], h, key(coat.seed, mark_border, i))));
  for (std::size_t i = 0; i < coat.shades.size(); ++i) {
    const Shade& s = coat.shades[i];
    const auto cover = static_cast<float>(shade_cover(ready, i, h));
    if (cover > 0) color = glm::mix(color, s.multiply ? s.color * color : s.color, cover);
  }
  double skin = 0;
  for (int pass = 0; pass < 2; ++pass)  // hair around parts first, then the parts
    for (std::size_t i = 0; i < coat.parts.size(); ++i) {
      const PartColor& p = coat.parts[i];
      double depth = h.inside[ready.color_parts[i]];
      if (pass == 0) {
        if (p.halo && depth > -p.halo_width)
          color = glm::mix(color, *p.halo,
                           static_cast<float>(ramp(-p.halo_width, -0.15 * p.halo_width, depth + 0.2 * p.halo_width * h.streak)));
        continue;
      }
      if (depth < -(0.5 * p.softness + 2 * p.raggedness)) continue;
      const std::uint32_t k = key(coat.seed, part_border, i);
      if (depth < p.softness + 2 * p.raggedness)
        depth += p.raggedness * (1.6 * gradient_noise(h.at / 0.011, k) + 0.5 * h.streak);
      const double cover = ramp(-0.5 * p.softness, 0.5 * p.softness, depth);
      if (cover <= 0) continue;
      color = glm::mix(color, part_color(p, depth, ready.part_depths[i], h, key(coat.seed, part_mottle, i)),
                       static_cast<float>(cover));
      skin = std::max(skin, cover);
    }
  if (coat.fur > 0) {
    const double v = 0.9 * h.streak + 0.9 * gradient_noise(h.at / 0.022, key(coat.seed, tuft)) +
                     0.7 * gradient_noise(h.at / 0.13, key(coat.seed, dirt));
    color *= static_cast<float>(std::max(0.0, 1 + coat.fur * (1 - 0.8 * skin) * v));
  }
  return glm::clamp(color, 0.0f, 1.0f);
}

std::uint8_t encode_srgb(float linear) {
  // By comparing with the 255 linear values between neighbouring codes: no pow per texel.
  static const std::array<float, 255> between = [] {
    std::array<float, 255> t{};
    for (int i = 0; i < 255; ++i) {
      const double v = (i + 0.5) / 255;
      t[i] = static_cast<float>(v <= 0.04045 ? v / 12.92 : std::pow((v + 0.055) / 1.055, 2.4));
    }
    return t;
  }();
  return static_cast<std::uint8_t>(std::upper_bound(between.begin(), between.end(), linear) - between.begin());
}

}  // namespace moomill
