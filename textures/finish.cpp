#include "textures/finish.h"

#include <algorithm>
#include <cmath>

#include "generator/core/parallel.h"
#include "textures/noise.h"

namespace moomill {
namespace {

constexpr std::uint32_t clump_key = 0xc1a3u;
// Standard deviations of slopes per unit of height and size: of hair_streak() across the hair, of gradient_noise().
constexpr double streak_slope = 1.45, noise_slope = 0.75;

double ramp(double lower, double upper, double x) {
  const double t = std::clamp((x - lower) / std::max(upper - lower, 1e-9), 0.0, 1.0);
  return t * t * (3 - 2 * t);
}

// Metres a texel is across, on average over the atlas.
double texel_size(const Hide& hide, int resolution) {
  const Surface& s = *hide.surface;
  double atlas = 0;  // share of the atlas that is painted
  for (const uvec3& t : s.triangles) {
    const dvec2 a(s.uvs[t.x]), b(s.uvs[t.y]), c(s.uvs[t.z]);
    const double area = 0.5 * std::abs((b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x));
    if (std::isfinite(area)) atlas += area;
  }
  return atlas > 0 ? std::sqrt(hide.area / atlas) / resolution : 1;
}

std::uint8_t to_byte(double x) { return static_cast<std::uint8_t>(std::lround(255 * std::clamp(x, 0.0, 1.0))); }

}  // namespace

FinishMaps bake_finish(const Finish& finish, Hide& hide, const TexelMap& texels) {
  const Surface& s = *hide.surface;
  const int resolution = texels.resolution;
  std::vector<int> fields;
  for (const PartFinish& p : finish.parts) {
    know_part(hide, p.part);
    fields.push_back(hide.pattern(p.part));
  }
  const Hair& hair = finish.hair;
  const double texel = texel_size(hide, resolution);
  const double tuft = ramp(1, 2.5, hair.tuft_width / texel), clump = ramp(1, 2.5, 0.5 * finish.clump_size / texel);
  const double tuft_height = tuft * finish.tuft_slope * hair.tuft_width / streak_slope;
  const double clump_height = clump * finish.clump_slope * finish.clump_size / noise_slope;
  // Slope variance that is too fine to draw, per axis: tufts are steep across the hair alone, so half of theirs.
  const double lost = 0.5 * (1 - tuft * tuft) * finish.tuft_slope * finish.tuft_slope +
                      (1 - clump * clump) * finish.clump_slope * finish.clump_slope;

  FinishMaps maps{Image8(resolution, resolution, 3, 128), Image8(resolution, resolution, 1, to_byte(finish.roughness))};
  parallel_for(resolution, 4, [&](std::size_t row) {
    const int y = static_cast<int>(row);
    std::vector<float> inside;
    for (int x = 0; x < resolution; ++x) {
      maps.normal.at(x, y, 2) = 255;
      const std::uint32_t t = texels.owner.at(x, y);
      if (t == texel_nobody) continue;
      const dvec3 w = texel_barycentrics(s, t, resolution, x, y);
      HidePoint p = hide_point(hide, t, w, inside, false);
      p.streak = texels.streak[texels.owner.index(x, y)];
      double bump = 1, roughness = finish.roughness + 0.03 * p.streak;
      for (std::size_t i = 0; i < fields.size(); ++i) {
        const double soft = std::max(finish.parts[i].softness, 1e-4);
        const double cover = ramp(-0.5 * soft, 0.5 * soft, inside[fields[i]]);
        bump += cover * (finish.parts[i].bump - bump);
        roughness += cover * (finish.parts[i].roughness - roughness);
      }
      const double alpha = roughness * roughness;
      maps.roughness.at(x, y) = to_byte(std::sqrt(std::sqrt(alpha * alpha + 2 * bump * bump * lost)));

      // The renderer's frame: shading normal, and the direction of u made square to it.
      const uvec3& v = s.triangles[t];
      const vec3 f(w);
      const vec3 sum = f.x * s.normals[v.x] + f.y * s.normals[v.y] + f.z * s.normals[v.z];
      const float length = glm::length(sum);
      if (bump <= 0 || !(length > 1e-6f)) continue;
      const dvec3 n(sum / length);
      const vec3 e1 = s.rest[v.y] - s.rest[v.x], e2 = s.rest[v.z] - s.rest[v.x];
      const vec2 d1 = s.uvs[v.y] - s.uvs[v.x], d2 = s.uvs[v.z] - s.uvs[v.x];
      const float det = d1.x * d2.y - d1.y * d2.x;
      const dvec3 along_u((e1 * d2.y - e2 * d1.y) * (det < 0 ? -1.0f : 1.0f));
      const dvec3 tangent = along_u - n * glm::dot(n, along_u);
      const double tangent_length = glm::length(tangent);
      if (det == 0 || !(tangent_length > 1e-12)) continue;
      const dvec3 tx = tangent / tangent_length, ty = glm::cross(n, tx) * (det < 0 ? 1.0 : -1.0);

      // Slopes of the unevenness along both, by differences over a small fraction of its finest size.
      double slope_x = 0, slope_y = 0;
      if (tuft_height > 0) {
        const double e = 0.04 * hair.tuft_width, scale = tuft_height / e;
        slope_x += scale * (hair_streak(hair, p.at + e * tx, p.hair) - p.streak);
        slope_y += scale * (hair_streak(hair, p.at + e * ty, p.hair) - p.streak);
      }
      if (clump_height > 0) {
        const double e = 0.05, scale = clump_height / (e * finish.clump_size);
        const dvec3 q = p.at / finish.clump_size;
        const double here = gradient_noise(q, clump_key);
        slope_x += scale * (gradient_noise(q + e * tx, clump_key) - here);
        slope_y += scale * (gradient_noise(q + e * ty, clump_key) - here);
      }
      const dvec3 bent = glm::normalize(dvec3(-bump * slope_x, -bump * slope_y, 1.0));
      for (int c = 0; c < 3; ++c) maps.normal.at(x, y, c) = to_byte(0.5 * bent[c] + 0.5);
    }
  });
  return maps;
}

}  // namespace moomill
