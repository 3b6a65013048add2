// Baking: which triangle paints which texel, and the evaluation of every texel.
#include <algorithm>
#include <array>
#include <cmath>

#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "textures/coat.h"

namespace moomill {
namespace {

constexpr std::uint32_t nobody = texel_nobody;
constexpr int band = 32;  // rows rasterised by one thread at a time

double cross2(const dvec2& a, const dvec2& b) {
  return a.x * b.y - a.y * b.x;
}

struct Corners {
  dvec2 a, b, c;  // texels
  double area;    // twice the signed area
};

Corners corners_of(const Surface& s, std::uint32_t t, int resolution) {
  const uvec3& v = s.triangles[t];
  Corners k{dvec2(s.uvs[v.x]) * double(resolution), dvec2(s.uvs[v.y]) * double(resolution),
            dvec2(s.uvs[v.z]) * double(resolution), 0};
  k.area = cross2(k.b - k.a, k.c - k.a);
  return k;
}

dvec3 barycentrics(const Corners& k, const dvec2& p) {
  const double u = cross2(k.c - k.b, p - k.b) / k.area, v = cross2(k.a - k.c, p - k.c) / k.area;
  return {u, v, 1 - u - v};
}

// The triangle over every texel centre, then grown outwards by `rings` texels: those are painted with the triangle's
// plane carried on, so that bilinear look-ups at a seam see the same colour from both sides.
ImageU32 texel_owners(const Surface& s, int resolution, int rings) {
  ImageU32 owner(resolution, resolution, 1, nobody);
  std::vector<std::vector<std::uint32_t>> bands((resolution + band - 1) / band);
  for (std::uint32_t t = 0; t < s.triangles.size(); ++t) {
    const Corners k = corners_of(s, t, resolution);
    if (k.area == 0 || !std::isfinite(k.area)) continue;
    const double low = std::min({k.a.y, k.b.y, k.c.y}), high = std::max({k.a.y, k.b.y, k.c.y});
    const int first = std::clamp(static_cast<int>(low), 0, resolution - 1) / band,
              last = std::clamp(static_cast<int>(high), 0, resolution - 1) / band;
    for (int b = first; b <= last; ++b) bands[b].push_back(t);
  }
  parallel_for(bands.size(), 1, [&](std::size_t b) {
    const int top = static_cast<int>(b) * band, bottom = std::min(resolution, top + band);
    for (const std::uint32_t t : bands[b]) {
      const Corners k = corners_of(s, t, resolution);
      const dvec2 low = glm::min(k.a, glm::min(k.b, k.c)), high = glm::max(k.a, glm::max(k.b, k.c));
      const int x0 = std::max(0, static_cast<int>(low.x)), x1 = std::min(resolution - 1, static_cast<int>(high.x));
      const int y0 = std::max(top, static_cast<int>(low.y)), y1 = std::min(bottom - 1, static_cast<int>(high.y));
      for (int y = y0; y <= y1; ++y)
        for (int x = x0; x <= x1; ++x) {
          const dvec3 w = barycentrics(k, {x + 0.5, y + 0.5});
          if (std::min({w.x, w.y, w.z}) >= -1e-9) owner.at(x, y) = t;
        }
    }
  });
  std::vector<std::size_t> front;
  for (int y = 0; y < resolution; ++y)
    for (int x = 0; x < resolution; ++x) {
      const std::size_t i = owner.index(x, y);
      if (owner.data[i] == nobody) continue;
      const bool edge = (x > 0 && owner.data[i - 1] == nobody) || (x + 1 < resolution && owner.data[i + 1] == nobody) ||
                        (y > 0 && owner.data[i - resolution] == nobody) ||
                        (y + 1 < resolution && owner.data[i + resolution] == nobody);
      if (edge) front.push_back(i);
    }
  for (int ring = 0; ring < rings; ++ring) {
    std::vector<std::size_t> next;
    for (const std::size_t i : front) {
      const int x = static_cast<int>(i % resolution), y = static_cast<int>(i / resolution);
      for (int k = 0; k < 9; ++k) {
        const int u = x + k % 3 - 1, v = y + k / 3 - 1;
        if (u < 0 || v < 0 || u >= resolution || v >= resolution || owner.at(u, v) != nobody) continue;
        owner.at(u, v) = owner.data[i];
        next.push_back(owner.index(u, v));
      }
    }
    front = std::move(next);
  }
  return owner;
}

}  // namespace

dvec3 texel_barycentrics(const Surface& s, std::uint32_t t, int resolution, int x, int y) {
  return glm::clamp(barycentrics(corners_of(s, t, resolution), {x + 0.5, y + 0.5}), -3.0, 4.0);
}

TexelMap map_texels(const Hide& hide, int resolution) {
  const Surface& s = *hide.surface;
  if (s.uvs.size() != s.rest.size() || s.uvs.empty())
    input_error("the rig has no UVs, so no coat can be baked for it; give it UVs or use its own materials");
  if (resolution < 1 || resolution > 32768)
    input_error("a coat cannot have {} texels a side; choose 1 to 32768", resolution);
  TexelMap map;
  map.resolution = resolution;
  map.owner = texel_owners(s, resolution, std::max(2, resolution / 256));
  map.streak.assign(map.owner.data.size(), 0.0f);
  parallel_for(resolution, 4, [&](std::size_t row) {
    const int y = static_cast<int>(row);
    std::vector<float> inside;
    for (int x = 0; x < resolution; ++x) {
      const std::uint32_t t = map.owner.at(x, y);
      if (t == texel_nobody) continue;
      const uvec3& v = s.triangles[t];
      const dvec3 w = texel_barycentrics(s, t, resolution, x, y);
      const dvec3 at = w.x * dvec3(s.rest[v.x]) + w.y * dvec3(s.rest[v.y]) + w.z * dvec3(s.rest[v.z]);
      vec3 hair = static_cast<float>(w.x) * hide.hairs[v.x] + static_cast<float>(w.y) * hide.hairs[v.y] +
                  static_cast<float>(w.z) * hide.hairs[v.z];
      const float length = glm::length(hair);
      if (length > 1) hair /= length;
      map.streak[map.owner.index(x, y)] = hair_streak(hide.hair, at, hair);
    }
  });
  return map;
}

Image8 bake_coat(const ReadyCoat& coat, const Hide& hide, const TexelMap& texels) {
  const int resolution = texels.resolution;
  const ImageU32& owner = texels.owner;
  Image8 image(resolution, resolution, 3);
  parallel_for(resolution, 4, [&](std::size_t row) {
    const int y = static_cast<int>(row);
    std::vector<float> inside;
    for (int x = 0; x < resolution; ++x) {
      const std::uint32_t t = owner.at(x, y);
      if (t == texel_nobody) continue;
      HidePoint p = hide_point(hide, t, texel_barycentrics(*hide.surface, t, resolution, x, y), inside, false);
      p.streak = texels.streak[owner.index(x, y)];
      const vec3 color = coat_color(coat, p);
      for (int c = 0; c < 3; ++c) image.at(x, y, c) = encode_srgb(color[c]);
    }
  });

  // What no island reaches takes the mean colour, so that even coarse mip levels stay near the coat's own colours.
  std::array<std::uint64_t, 3> sum{};
  std::uint64_t painted = 0;
  for (std::size_t i = 0; i < owner.data.size(); ++i) {
    if (owner.data[i] == texel_nobody) continue;
    ++painted;
    for (int c = 0; c < 3; ++c) sum[c] += image.data[3 * i + c];
  }
  for (std::size_t i = 0; i < owner.data.size() && painted > 0; ++i)
    if (owner.data[i] == texel_nobody)
      for (int c = 0; c < 3; ++c) image.data[3 * i + c] = static_cast<std::uint8_t>(sum[c] / painted);
  return image;
}

Image8 bake_coat(const ProceduralCoat& coat, Hide& hide, int resolution) {
  const TexelMap texels = map_texels(hide, resolution);
  know_parts(hide, coat);
  return bake_coat(ready_coat(coat, hide), hide, texels);
}

}  // namespace moomill
