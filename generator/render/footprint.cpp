// Which pixels an animal, or its outline, can touch.
#include <algorithm>
#include <bit>
#include <unordered_map>

#include "generator/core/error.h"
#include "generator/render/first_hit.h"

namespace moomill {
namespace {

constexpr double near_plane = 1e-3;  // metres; what comes nearer marks the whole image
constexpr double float_slack = 2e-3; // pixels, for rays rounded to float

struct Projected {
  std::vector<dvec2> pixel;
  bool all_in_front = true;
};

Projected project_all(const Instance& instance, const Scene& scene, const Camera& camera) {
  Projected out;
  const auto& positions = instance.posed.positions;
  out.pixel.resize(positions.size());
  for (std::size_t i = 0; i < positions.size(); ++i) {
    const dvec3 p = camera.to_camera(dvec3(positions[i]) + scene.origin);
    if (p.z < near_plane) {
      out.all_in_front = false;
      return out;
    }
    out.pixel[i] = camera.project(p);
  }
  return out;
}

int clip_to_int(double x) { return static_cast<int>(std::clamp(x, -1e6, 1e6)); }

// Marks pixels whose centre lies within `radius` (in the maximum norm) of a convex polygon.
void mark_polygon(PixelMask& mask, const dvec2* p, int n, double radius) {
  double y_low = p[0].y, y_high = p[0].y, x_low = p[0].x, x_high = p[0].x;
  for (int i = 1; i < n; ++i) {
    y_low = std::min(y_low, p[i].y), y_high = std::max(y_high, p[i].y);
    x_low = std::min(x_low, p[i].x), x_high = std::max(x_high, p[i].x);
  }
  const int y0 = std::max(0, clip_to_int(std::ceil(y_low - radius - 0.5)));
  const int y1 = std::min(mask.height - 1, clip_to_int(std::floor(y_high + radius - 0.5)));
  for (int y = y0; y <= y1; ++y) {
    double left = x_low, right = x_high;
    if (y1 - y0 > 4) {  // taller than a few rows: the span of the polygon within the row's band, not of its box
      const double a = y + 0.5 - radius, b = y + 0.5 + radius;
      left = std::numeric_limits<double>::infinity();
      right = -left;
      for (int i = 0; i < n; ++i) {
        dvec2 s = p[i], e = p[(i + 1) % n];
        if (s.y > e.y) std::swap(s, e);
        if (e.y < a || s.y > b) continue;
        const double dy = e.y - s.y;
        const double xs = s.y >= a || dy == 0 ? s.x : s.x + (e.x - s.x) * (a - s.y) / dy;
        const double xe = e.y <= b || dy == 0 ? e.x : s.x + (e.x - s.x) * (b - s.y) / dy;
        left = std::min({left, xs, xe});
        right = std::max({right, xs, xe});
      }
      if (left > right) continue;
    }
    mask.set_span(y, clip_to_int(std::ceil(left - radius - 0.5)), clip_to_int(std::floor(right + radius - 0.5)));
  }
}

}  // namespace

void PixelMask::set_span(int y, int x0, int x1) {
  x0 = std::max(x0, 0);
  x1 = std::min(x1, width - 1);
  if (x0 > x1) return;
  std::uint64_t* row_bits = &bits[static_cast<std::size_t>(y) * words];
  const int a = x0 / 64, b = x1 / 64;
  const std::uint64_t first = ~0ull << (x0 % 64), last = ~0ull >> (63 - x1 % 64);
  if (a == b) {
    row_bits[a] |= first & last;
    return;
  }
  row_bits[a] |= first;
  for (int w = a + 1; w < b; ++w) row_bits[w] = ~0ull;
  row_bits[b] |= last;
}

void PixelMask::fill() {
  for (int y = 0; y < height; ++y) set_span(y, 0, width - 1);
}

std::uint64_t PixelMask::count() const {
  std::uint64_t n = 0;
  for (std::uint64_t w : bits) n += std::popcount(w);
  return n;
}

bool Scene::cut_out(const Instance& instance) const {
  for (int m : instance.materials)
    if (appearance->materials[m].alpha_cutoff >= 0) return true;
  return false;
}

Box Scene::bounds(bool animals_only) const {
  Box box;
  for (const Instance& i : instances)
    if (!animals_only || i.animal >= 0)
      for (const vec3& p : i.posed.positions) box.add(dvec3(p));
  return box;
}

PixelMask footprint(const Scene& scene, const Camera& camera, double radius) {
  PixelMask mask(camera.width, camera.height);
  for (const Instance& instance : scene.instances) {
    if (instance.animal < 0) continue;
    const Projected projected = project_all(instance, scene, camera);
    if (!projected.all_in_front) {
      mask.fill();
      return mask;
    }
    for (const uvec3& t : instance.surface->triangles) {
      const dvec2 p[3] = {projected.pixel[t[0]], projected.pixel[t[1]], projected.pixel[t[2]]};
      mark_polygon(mask, p, 3, radius + float_slack);
    }
  }
  return mask;
}

PixelMask outlines(const Scene& scene, const Camera& camera) {
  PixelMask mask(camera.width, camera.height);
  for (const Instance& instance : scene.instances) {
    if (instance.animal < 0) continue;
    const Projected projected = project_all(instance, scene, camera);
    if (!projected.all_in_front) {
      mask.fill();
      return mask;
    }
    if (scene.cut_out(instance)) return footprint(scene, camera, 0.5);  // holes have outlines of their own
    // Vertices split at seams share a position; edges are told apart by position, so that a seam is no outline.
    const auto& positions = instance.posed.positions;
    struct Hash {
      std::size_t operator()(const vec3& p) const {
        std::size_t h = 0;
        for (int i = 0; i < 3; ++i) h = (h ^ std::bit_cast<std::uint32_t>(p[i] + 0.0f)) * 0x9e3779b97f4a7c15ull;
        return h ^ (h >> 29);
      }
    };
    std::unordered_map<vec3, std::uint32_t, Hash> first_at;
    std::vector<std::uint32_t> welded(positions.size());
    first_at.reserve(positions.size());
    for (std::uint32_t i = 0; i < positions.size(); ++i) welded[i] = first_at.try_emplace(positions[i], i).first->second;
    struct Edge {
      std::uint32_t a, b;
      bool front;
      bool operator<(const Edge& o) const { return std::pair(a, b) < std::pair(o.a, o.b); }
    };
    std::vector<Edge> edges;
    edges.reserve(3 * instance.surface->triangles.size());
    for (const uvec3& t : instance.surface->triangles) {
      const dvec2 a = projected.pixel[t[0]], b = projected.pixel[t[1]], c = projected.pixel[t[2]];
      const bool front = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x) < 0;
      for (int k = 0; k < 3; ++k) {
        const std::uint32_t i = welded[t[k]], j = welded[t[(k + 1) % 3]];
        if (i != j) edges.push_back({std::min(i, j), std::max(i, j), front});
      }
    }
    std::sort(edges.begin(), edges.end());
    for (std::size_t i = 0; i < edges.size();) {
      std::size_t j = i + 1;
      bool mixed = false;
      while (j < edges.size() && edges[j].a == edges[i].a && edges[j].b == edges[i].b) mixed |= edges[j++].front != edges[i].front;
      if (j - i != 2 || mixed) {
        const dvec2 p[2] = {projected.pixel[edges[i].a], projected.pixel[edges[i].b]};
        mark_polygon(mask, p, 2, 0.5 + float_slack);
      }
      i = j;
    }
  }
  return mask;
}

}  // namespace moomill
