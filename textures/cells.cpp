#include "textures/cells.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "generator/core/random.h"
#include "textures/noise.h"

namespace moomill {
namespace {

double ramp(double lower, double upper, double x) {
  if (upper <= lower) return x >= upper ? 1 : 0;
  const double t = std::clamp((x - lower) / (upper - lower), 0.0, 1.0);
  return t * t * (3 - 2 * t);
}

}  // namespace

CellField strew_cells(const CellPattern& pattern, const Hide& hide, std::uint64_t seed) {
  CellField field;
  std::vector<double> factor(std::max<std::size_t>(hide.part_names.size(), 1), 1.0);
  for (std::size_t i = 0; i < hide.part_names.size(); ++i)
    for (const auto& [part, f] : pattern.parts)
      if (part_matches(part, hide.part_names[i])) factor[i] = f;
  double largest = 0.5 * pattern.size;
  for (const double f : factor) largest = std::max(largest, 0.5 * pattern.size * f);

  // Darts: candidates in the order of their hashes; one is taken where no earlier one is too near.
  std::vector<std::uint32_t> order(hide.samples.size());
  std::iota(order.begin(), order.end(), 0u);
  std::vector<std::uint64_t> rank(order.size());
  for (std::uint32_t i = 0; i < rank.size(); ++i) rank[i] = hash_identity({seed, 0xce11, i});
  std::sort(order.begin(), order.end(), [&](auto a, auto b) { return rank[a] != rank[b] ? rank[a] < rank[b] : a < b; });
  field.origin = hide.box.empty() ? dvec3(0) : hide.box.lower - 2 * largest;
  field.cell = 2 * largest;
  const dvec3 size = (hide.box.empty() ? dvec3(0) : hide.box.size()) + 4 * largest;
  field.nx = static_cast<int>(size.x / field.cell) + 1, field.ny = static_cast<int>(size.y / field.cell) + 1,
  field.nz = static_cast<int>(size.z / field.cell) + 1;
  std::vector<std::vector<std::uint32_t>> bins(static_cast<std::size_t>(field.nx) * field.ny * field.nz);
  const auto place = [&](const dvec3& p, int axis) {
    const int n = axis == 0 ? field.nx : axis == 1 ? field.ny : field.nz;
    return std::clamp(static_cast<int>((p[axis] - field.origin[axis]) / field.cell), 0, n - 1);
  };
  const auto around = [&](const dvec3& p, const auto& visit) {
    const int x = place(p, 0), y = place(p, 1), z = place(p, 2);
    for (int k = std::max(z - 1, 0); k <= std::min(z + 1, field.nz - 1); ++k)
      for (int j = std::max(y - 1, 0); j <= std::min(y + 1, field.ny - 1); ++j)
        for (int i = std::max(x - 1, 0); i <= std::min(x + 1, field.nx - 1); ++i)
          visit(bins[(static_cast<std::size_t>(k) * field.ny + j) * field.nx + i]);
  };
  std::vector<float> inside;
  for (const std::uint32_t i : order) {
    const Hide::Sample& s = hide.samples[i];
    const dvec3 at = hide_point(hide, s.triangle, dvec3(s.weights), inside, false).at;
    const std::size_t part = hide.surface->parts.empty() ? 0 : hide.surface->parts[s.triangle];
    const double radius = 0.5 * pattern.size * factor[std::min(part, factor.size() - 1)];
    bool free = true;
    around(at, [&](const auto& bin) {
      for (const std::uint32_t p : bin)
        free = free && glm::length(field.points[p].at - at) >= pattern.regularity * (field.points[p].radius + radius);
    });
    if (!free) continue;
    bins[(static_cast<std::size_t>(place(at, 2)) * field.ny + place(at, 1)) * field.nx + place(at, 0)].push_back(
        static_cast<std::uint32_t>(field.points.size()));
    field.points.push_back({at, radius, static_cast<std::uint32_t>(rank[i])});
  }
  // What may own a place: points of its grid cell and those around it.
  for (int z = 0; z < field.nz; ++z)
    for (int y = 0; y < field.ny; ++y)
      for (int x = 0; x < field.nx; ++x) {
        field.begin.push_back(static_cast<std::uint32_t>(field.sorted.size()));
        around(field.origin + field.cell * (dvec3(x, y, z) + 0.5), [&](const auto& bin) {
          field.sorted.insert(field.sorted.end(), bin.begin(), bin.end());
        });
      }
  field.begin.push_back(static_cast<std::uint32_t>(field.sorted.size()));
  return field;
}

CellSample sample_cells(const CellPattern& pattern, const CellField& field, const dvec3& at) {
  CellSample sample;
  if (field.points.empty()) return sample;
  const auto place = [&](int axis, int n) {
    return std::clamp(static_cast<int>((at[axis] - field.origin[axis]) / field.cell), 0, n - 1);
  };
  const std::size_t bin =
      (static_cast<std::size_t>(place(2, field.nz)) * field.ny + place(1, field.ny)) * field.nx + place(0, field.nx);
  const auto first = field.begin[bin], last = field.begin[bin + 1];
  const auto power = [&](const CellField::Point& p) {
    const dvec3 d = at - p.at;
    return glm::dot(d, d) / (p.radius * p.radius);
  };
  double least = std::numeric_limits<double>::infinity();
  std::uint32_t owner = 0;
  for (auto k = first; k < last; ++k)
    if (const double v = power(field.points[field.sorted[k]]); v < least) least = v, owner = field.sorted[k];
  if (!std::isfinite(least)) return sample;
  const CellField::Point& mine = field.points[owner];
  double depth = mine.radius;
  for (auto k = first; k < last; ++k) {
    if (field.sorted[k] == owner) continue;
    const CellField::Point& other = field.points[field.sorted[k]];
    depth = std::min(depth, (power(other) - least) * mine.radius * other.radius / (2 * glm::length(other.at - mine.at)));
  }
  const double from_point = glm::length(at - mine.at);
  sample.depth = depth;
  sample.inward = depth / std::max(depth + from_point, 1e-9);
  sample.scale = 2 * mine.radius / pattern.size;
  sample.hash = mine.hash;
  return sample;
}

vec3 cell_color(const CellPattern& p, const CellField& field, const HidePoint& h, std::uint32_t k) {
  // Slightly bent space: no border is quite straight.
  const dvec3 bent = h.at + 0.06 * p.size * dvec3(gradient_noise(h.at / (0.6 * p.size), k + 20),
                                                  gradient_noise(h.at / (0.6 * p.size), k + 21),
                                                  gradient_noise(h.at / (0.6 * p.size), k + 22));
  const CellSample s = sample_cells(p, field, bent);
  const double narrow = std::sqrt(s.scale);
  double depth = s.depth - 0.5 * p.gap * narrow * (1 + 0.5 * gradient_noise(h.at / (0.8 * p.size), k + 1));
  depth += p.raggedness * (1.3 * gradient_noise(h.at / 0.03, k + 2) + 0.7 * h.streak);
  if (p.jag > 0) {
    const double lobe = 0.22 * p.size * s.scale;
    depth -= p.jag * narrow * std::max(0.0, 0.25 + 1.9 * gradient_noise(bent / lobe, k + 3) + 0.9 * gradient_noise(bent / (0.45 * lobe), k + 4));
  }
  const double shade = 1 + p.variation * (2 * ((s.hash >> 8) * 0x1.0p-24) - 1);
  const vec3 cell = glm::mix(p.cell, p.center, static_cast<float>(ramp(0.1, 0.75, s.inward))) * static_cast<float>(shade);
  return glm::mix(p.line, cell, static_cast<float>(ramp(-0.5 * p.softness, 0.5 * p.softness, depth)));
}

}  // namespace moomill
