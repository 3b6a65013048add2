// Baking: which triangle paints which texel, how part colours fade, and the evaluation of every texel.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <unordered_map>

#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "textures/coat.h"
#include "textures/pattern.h"

namespace moomill {
namespace {

constexpr std::uint32_t nobody = 0xffffffffu;
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

struct VecHash {
  std::size_t operator()(const std::array<std::uint32_t, 3>& v) const {
    return (v[0] * 0x9e3779b97f4a7c15ull ^ v[1]) * 0xbf58476d1ce4e5b9ull ^ v[2];
  }
};

// Vertices of equal position are one here.
std::vector<std::uint32_t> weld(const Surface& s, std::size_t& count) {
  std::unordered_map<std::array<std::uint32_t, 3>, std::uint32_t, VecHash> seen;
  seen.reserve(s.rest.size());
  std::vector<std::uint32_t> id(s.rest.size());
  for (std::size_t i = 0; i < s.rest.size(); ++i) {
    std::array<std::uint32_t, 3> bits;
    const vec3 p = s.rest[i] + 0.0f;  // minus zero welds with zero
    std::memcpy(bits.data(), &p, sizeof p);
    id[i] = seen.try_emplace(bits, static_cast<std::uint32_t>(seen.size())).first->second;
  }
  count = seen.size();
  return id;
}

// How much of a part colour every vertex wears: a field that crosses one half along a smoothed border of the part.
struct PartField {
  std::vector<float> cover;  // per vertex
  float half_width = 0.5f;   // of the fade, in units of cover
};

PartField part_field(const Surface& s, const std::vector<std::uint8_t>& in_part, const std::vector<std::uint32_t>& id,
                     std::size_t count, double softness) {
  std::vector<double> area(count, 0.0), inside(count, 0.0);
  for (std::size_t t = 0; t < s.triangles.size(); ++t) {
    const uvec3& v = s.triangles[t];
    const double a = glm::length(glm::cross(s.rest[v.y] - s.rest[v.x], s.rest[v.z] - s.rest[v.x]));
    for (int k = 0; k < 3; ++k) {
      area[id[v[k]]] += a;
      if (in_part[t]) inside[id[v[k]]] += a;
    }
  }
  std::vector<double> value(count);
  for (std::size_t i = 0; i < count; ++i) value[i] = area[i] > 0 ? inside[i] / area[i] : 0;
  for (int round = 0; round < 2; ++round) {
    std::vector<double> sum(count, 0.0);
    std::vector<int> n(count, 0);
    for (const uvec3& v : s.triangles)
      for (int k = 0; k < 3; ++k) {
        sum[id[v[k]]] += value[id[v[(k + 1) % 3]]] + value[id[v[(k + 2) % 3]]];
        n[id[v[k]]] += 2;
      }
    for (std::size_t i = 0; i < count; ++i)
      if (n[i] > 0) value[i] = 0.6 * value[i] + 0.4 * sum[i] / n[i];
  }
  // Mean slope of the field where it crosses one half: turns the wanted softness from metres into cover.
  double slope = 0, weight = 0;
  for (const uvec3& v : s.triangles)
    for (int k = 0; k < 3; ++k) {
      const double a = value[id[v[k]]], b = value[id[v[(k + 1) % 3]]],
                   length = glm::length(s.rest[v[k]] - s.rest[v[(k + 1) % 3]]);
      if ((a < 0.5) != (b < 0.5) && length > 0) slope += std::abs(a - b) / length, weight += 1;
    }
  PartField field;
  field.half_width = weight > 0 ? static_cast<float>(std::clamp(0.5 * softness * slope / weight, 0.02, 0.5)) : 0.5f;
  field.cover.resize(s.rest.size());
  for (std::size_t i = 0; i < s.rest.size(); ++i) field.cover[i] = static_cast<float>(value[id[i]]);
  return field;
}

// 8-bit sRGB by comparing with the 255 linear values between neighbouring codes: no pow per texel.
struct SrgbEncoder {
  std::array<float, 255> between;
  SrgbEncoder() {
    for (int i = 0; i < 255; ++i) {
      const double v = (i + 0.5) / 255;
      between[i] = static_cast<float>(v <= 0.04045 ? v / 12.92 : std::pow((v + 0.055) / 1.055, 2.4));
    }
  }
  std::uint8_t operator()(float linear) const {
    return static_cast<std::uint8_t>(std::upper_bound(between.begin(), between.end(), linear) - between.begin());
  }
};

}  // namespace

Image8 bake_coat(const ProceduralCoat& given, const Surface& s, const std::vector<std::string>& part_names,
                 int resolution) {
  if (s.uvs.size() != s.rest.size() || s.uvs.empty())
    input_error("the rig has no UVs, so no coat can be baked for it; give it UVs or use its own materials");
  if (resolution < 1 || resolution > 32768)
    input_error("a coat cannot have {} texels a side; choose 1 to 32768", resolution);
  const ProceduralCoat coat = calibrated(given, s);
  const ImageU32 owner = texel_owners(s, resolution, std::max(2, resolution / 256));

  std::size_t count = 0;
  const std::vector<std::uint32_t> id = weld(s, count);
  std::vector<PartField> fields(coat.parts.size());
  parallel_for(coat.parts.size(), 1, [&](std::size_t i) {
    std::vector<std::uint8_t> in_part(s.triangles.size(), 0);
    for (std::size_t t = 0; t < s.triangles.size(); ++t)
      in_part[t] =
          t < s.parts.size() && s.parts[t] < part_names.size() && part_has_color(coat.parts[i], part_names[s.parts[t]]);
    fields[i] = part_field(s, in_part, id, count, coat.parts[i].softness);
  });

  const SrgbEncoder encode;
  Image8 image(resolution, resolution, 3);
  parallel_for(resolution, 4, [&](std::size_t row) {
    const int y = static_cast<int>(row);
    for (int x = 0; x < resolution; ++x) {
      const std::uint32_t t = owner.at(x, y);
      if (t == nobody) continue;
      const uvec3& v = s.triangles[t];
      const dvec3 w = glm::clamp(barycentrics(corners_of(s, t, resolution), {x + 0.5, y + 0.5}), -3.0, 4.0);
      const dvec3 at = w.x * dvec3(s.rest[v.x]) + w.y * dvec3(s.rest[v.y]) + w.z * dvec3(s.rest[v.z]);
      vec3 color = coat_color_without_parts(coat, at);
      for (std::size_t i = 0; i < fields.size(); ++i) {
        const std::vector<float>& c = fields[i].cover;
        const float cover =
            static_cast<float>(w.x) * c[v.x] + static_cast<float>(w.y) * c[v.y] + static_cast<float>(w.z) * c[v.z];
        const float f = std::clamp((cover - 0.5f) / (2 * fields[i].half_width) + 0.5f, 0.0f, 1.0f);
        if (f > 0) color = glm::mix(color, coat.parts[i].color, f * f * (3 - 2 * f));
      }
      color *= fur_shade(coat, at);
      for (int c = 0; c < 3; ++c) image.at(x, y, c) = encode(color[c]);
    }
  });

  // What no island reaches takes the mean colour, so that even coarse mip levels stay near the coat's own colours.
  std::array<std::uint64_t, 3> sum{};
  std::uint64_t painted = 0;
  for (std::size_t i = 0; i < owner.data.size(); ++i) {
    if (owner.data[i] == nobody) continue;
    ++painted;
    for (int c = 0; c < 3; ++c) sum[c] += image.data[3 * i + c];
  }
  for (std::size_t i = 0; i < owner.data.size() && painted > 0; ++i)
    if (owner.data[i] == nobody)
      for (int c = 0; c < 3; ++c) image.data[3 * i + c] = static_cast<std::uint8_t>(sum[c] / painted);
  return image;
}

}  // namespace moomill
