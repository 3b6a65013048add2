#include "generator/render/first_hit.h"

#include <immintrin.h>

#include <atomic>
#include <bit>

#include "generator/core/error.h"
#include "generator/core/parallel.h"

namespace moomill {
namespace {

constexpr int tile = 32;             // pixels, side of a unit of parallel work; half a word of the mask
constexpr double edge_slack = 1e-12; // barycentrics; double rounding alone

// Planes of constant camera z that enclose everything. Rays start at the near one, so that their float origins and
// distances are small and keep their digits.
struct DepthRange {
  double near, far;
};
DepthRange depth_range(const Scene& scene, const Accel& accel, const Camera& camera) {
  const Box& box = accel.bounds(false);
  DepthRange r{std::numeric_limits<double>::infinity(), 0};
  if (box.empty()) return {0, 0};
  for (int i = 0; i < 8; ++i) {
    const dvec3 p(i & 1 ? box.upper.x : box.lower.x, i & 2 ? box.upper.y : box.lower.y, i & 4 ? box.upper.z : box.lower.z);
    const double z = camera.to_camera(p + scene.origin).z;
    r.near = std::min(r.near, z);
    r.far = std::max(r.far, z);
  }
  const double margin = 1e-3 * (r.far - r.near) + 1e-3;
  r.near = std::max(0.0, r.near - margin);
  r.far += margin;
  return r;
}

struct TriangleRef {
  const vec3 *p0, *p1, *p2;
};
TriangleRef corners(const Scene& scene, std::uint32_t instance, std::uint32_t triangle) {
  const Instance& in = scene.instances[instance];
  const uvec3 t = in.surface->triangles[triangle];
  const vec3* p = in.posed.positions.data();
  return {p + t[0], p + t[1], p + t[2]};
}

// The true nearest hit of a ray whose float hit cannot be trusted: because it lay outside its triangle, or because the ray
// passes a vertex. Candidates are it and what rays a little beside it meet, in growing rings.
PreciseHit resolve(const Scene& scene, const Accel& accel, const dvec3& origin, const dvec3& direction,
                   const dvec3& step_x, const dvec3& step_y, const DepthRange& range, std::uint32_t mask,
                   std::uint32_t known_instance, std::uint32_t known_triangle) {
  PreciseHit best;
  best.t = std::numeric_limits<double>::infinity();
  std::vector<std::uint32_t> named;  // instances that any of the rays has met
  auto consider = [&](std::uint32_t instance, std::uint32_t triangle) {
    if (instance == no_hit) return;
    if (std::find(named.begin(), named.end(), instance) == named.end()) named.push_back(instance);
    const TriangleRef c = corners(scene, instance, triangle);
    double t, u, v;
    if (!intersect_triangle(origin, direction, *c.p0, *c.p1, *c.p2, edge_slack, t, u, v) || t <= 0) return;
    // The nearest; of two that share the edge hit, the lower index.
    if (t < best.t || (t == best.t && std::pair(instance, triangle) < std::pair(best.instance, best.triangle)))
      best = {instance, triangle, u, v, t};
  };
  consider(known_instance, known_triangle);
  static constexpr double ring[8][2] = {{1, 0}, {0.7071, 0.7071}, {0, 1}, {-0.7071, 0.7071}, {-1, 0}, {-0.7071, -0.7071}, {0, -1}, {0.7071, -0.7071}};
  for (const double radius : {2e-4, 2e-3, 2e-2}) {  // pixels
    Ray8 rays{};
    for (int i = 0; i < 8; ++i) {
      const dvec3 d = direction + radius * (ring[i][0] * step_x + ring[i][1] * step_y);
      const dvec3 o = origin + range.near * d;
      rays.ox[i] = static_cast<float>(o.x), rays.oy[i] = static_cast<float>(o.y), rays.oz[i] = static_cast<float>(o.z);
      rays.dx[i] = static_cast<float>(d.x), rays.dy[i] = static_cast<float>(d.y), rays.dz[i] = static_cast<float>(d.z);
      rays.near[i] = 0;
      rays.far[i] = static_cast<float>(range.far - range.near);
      rays.active[i] = 1;
    }
    accel.intersect8(rays, true, mask);
    int misses = 0;
    for (int i = 0; i < 8; ++i) {
      consider(rays.instance[i], rays.triangle[i]);
      misses += rays.instance[i] == no_hit;
    }
    if (best.instance != no_hit) return best;
    if (misses > 0) break;  // most likely an outline against the background, passed on the outside
  }
  // Or a vertex of so many faces that none of the rays met the right one: rare enough to look at every face. Not where
  // some are cut out, for that only Embree's filter knows.
  for (std::size_t i = 0; i < named.size(); ++i) {
    const Instance& in = scene.instances[named[i]];
    if (scene.cut_out(in)) continue;
    for (std::size_t k = 0; k < in.surface->triangles.size(); ++k) consider(named[i], static_cast<std::uint32_t>(k));
  }
  if (best.instance != no_hit) return best;
  best.t = 0;
  return best;
}

// Four lanes: pixels of one row, or vertices in a row.
using Double4 = double __attribute__((vector_size(32)));
using Mask4 = std::int64_t __attribute__((vector_size(32)));
struct Vec4 {
  Double4 x, y, z;
};
Vec4 operator-(const Vec4& a, const Vec4& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
// In the order of glm's, so that one lane and a scalar round alike.
Double4 dot(const Vec4& a, const Vec4& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
Double4 dot(const dvec3& a, const Vec4& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
Vec4 cross(const Vec4& a, const Vec4& b) {
  return {a.y * b.z - b.y * a.z, a.z * b.x - b.z * a.x, a.x * b.y - b.x * a.y};
}
Vec4 operator-(const dvec3& a, const Vec4& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
Vec4 operator-(const Vec4& a, const dvec3& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
int lanes_of(Mask4 m) { return _mm256_movemask_pd(reinterpret_cast<__m256d>(m)); }
Double4 floor(Double4 v) { return reinterpret_cast<Double4>(_mm256_floor_pd(reinterpret_cast<__m256d>(v))); }
Double4 widen(__m128 v) { return reinterpret_cast<Double4>(_mm256_cvtps_pd(v)); }
__m128 narrow(Double4 v) { return _mm256_cvtpd_ps(reinterpret_cast<__m256d>(v)); }

// Four points from where they lie; reads no byte beyond them.
Vec4 gather(const vec3* const p[4]) {
  const __m128i three = _mm_setr_epi32(-1, -1, -1, 0);
  const auto load = [&](const vec3* q) { return _mm_maskload_ps(&q->x, three); };
  const __m128 a = load(p[0]), b = load(p[1]), c = load(p[2]), d = load(p[3]);
  const __m128 ab = _mm_unpacklo_ps(a, b), cd = _mm_unpacklo_ps(c, d);
  const __m128 z_ab = _mm_unpackhi_ps(a, b), z_cd = _mm_unpackhi_ps(c, d);
  return {widen(_mm_movelh_ps(ab, cd)), widen(_mm_movehl_ps(cd, ab)), widen(_mm_movelh_ps(z_ab, z_cd))};
}

// Pixels of the mask whose centre lies so near a projected vertex that Embree's ray, rounded to float, may pass through it.
// Its test is watertight across edges, but at a vertex the tests of all faces round on their own, and one ray in a hundred
// that is aimed at it slips between them.
std::vector<glm::ivec2> pixels_at_vertices(const Scene& scene, const Camera& camera, const PixelMask& mask, std::uint32_t ray_mask) {
  constexpr std::size_t chunk = 4096;  // vertices, a multiple of 4
  const double radius = 1e-3 + 0x1p-22 * std::max(camera.fx, camera.fy);  // four roundings of a direction, in pixels
  const dmat3 turn = glm::transpose(camera.world_to_camera);               // its columns are the rows of the rotation
  const dvec3 to_x = camera.fx * turn[0] + camera.cx * turn[2], to_y = camera.fy * turn[1] + camera.cy * turn[2];
  const dvec3 eye = camera.centre - scene.origin;
  std::vector<glm::ivec2> all;
  for (const Instance& in : scene.instances) {
    if (!(animal_mask(in.animal) & ray_mask)) continue;
    const auto& positions = in.posed.positions;
    std::vector<std::vector<glm::ivec2>> found((positions.size() + chunk - 1) / chunk);
    parallel_for(found.size(), 1, [&](std::size_t c) {
      const std::size_t end = std::min(positions.size(), (c + 1) * chunk);
      for (std::size_t i = c * chunk; i < end; i += 4) {
        const vec3* p[4];
        for (std::size_t k = 0; k < 4; ++k) p[k] = &positions[std::min(i + k, end - 1)];
        const Vec4 from_eye = gather(p) - eye;
        const Double4 z = dot(turn[2], from_eye);
        const Double4 x = dot(to_x, from_eye) / z, y = dot(to_y, from_eye) / z;
        const Mask4 inside = (z > 0.0) & (x >= 0.0) & (y >= 0.0) & (x < double(camera.width)) & (y < double(camera.height));
        const Double4 dx = x - floor(x) - 0.5, dy = y - floor(y) - 0.5;
        const int near = lanes_of(inside & (dx > -radius) & (dx < radius) & (dy > -radius) & (dy < radius));
        for (int k = 0; k < 4 && near; ++k) {
          if (!(near >> k & 1) || i + k >= end) continue;
          const glm::ivec2 pixel(static_cast<int>(x[k]), static_cast<int>(y[k]));
          if (mask.get(pixel.x, pixel.y)) found[c].push_back(pixel);
        }
      }
    });
    for (const auto& some : found) all.insert(all.end(), some.begin(), some.end());
  }
  return all;
}

// The same as intersect_triangle() for four rays of one origin, each against the triangle of its own.
struct Hit4 {
  Double4 t, u, v;
};
Hit4 intersect_triangles(const dvec3& origin, const Vec4& direction, const Vec4& p0, const Vec4& p1, const Vec4& p2) {
  const Vec4 e1 = p1 - p0, e2 = p2 - p0, q = cross(direction, e2);
  const Double4 det = dot(e1, q);
  const Vec4 s = origin - p0, r = cross(s, e1);
  return {dot(e2, r) / det, dot(s, q) / det, dot(direction, r) / det};
}

}  // namespace

bool intersect_triangle(const dvec3& origin, const dvec3& direction, const vec3& p0, const vec3& p1, const vec3& p2,
                        double slack, double& t, double& u, double& v) {
  const dvec3 a(p0), e1 = dvec3(p1) - a, e2 = dvec3(p2) - a;
  const dvec3 q = glm::cross(direction, e2);
  const double det = glm::dot(e1, q);
  if (det == 0) return false;
  const dvec3 s = origin - a, r = glm::cross(s, e1);
  u = glm::dot(s, q) / det;
  v = glm::dot(direction, r) / det;
  t = glm::dot(e2, r) / det;
  return u >= -slack && v >= -slack && u + v <= 1 + slack;
}

FirstHits::FirstHits(int w, int h) : width(w), height(h) {
  const std::size_t n = static_cast<std::size_t>(w) * h;
  instance.resize(n);
  triangle.resize(n);
  u.resize(n);
  v.resize(n);
  depth.resize(n);
}

FirstHits trace_first_hits(const Scene& scene, const Accel& accel, const Camera& camera, const PixelMask& mask,
                           std::uint32_t ray_mask) {
  FirstHits hits(camera.width, camera.height);
  const DepthRange range = depth_range(scene, accel, camera);
  if (!(range.far > range.near)) {
    std::fill(hits.instance.begin(), hits.instance.end(), no_hit);
    std::fill(hits.triangle.begin(), hits.triangle.end(), no_hit);
    for (PixelVector<float>* map : {&hits.u, &hits.v, &hits.depth}) std::fill(map->begin(), map->end(), 0.0f);
    return hits;
  }
  const dvec3 origin = camera.centre - scene.origin;
  const dvec3 step_x = camera.direction(1, 0) - camera.direction(0, 0);
  const dvec3 step_y = camera.direction(0, 1) - camera.direction(0, 0);
  const dvec3 corner = camera.direction(0.5, 0.5);
  const float far = static_cast<float>(range.far - range.near);
  struct Mesh {
    const uvec3* triangles;
    const vec3* positions;
  };
  std::vector<Mesh> meshes;
  for (const Instance& in : scene.instances) meshes.push_back({in.surface->triangles.data(), in.posed.positions.data()});
  std::atomic<std::uint64_t> rays_traced{0}, rays_resolved{0};
  const int tiles_x = (camera.width + tile - 1) / tile, tiles_y = (camera.height + tile - 1) / tile;

  parallel_for(static_cast<std::size_t>(tiles_x) * tiles_y, 1, [&](std::size_t index) {
    const int x_begin = static_cast<int>(index % tiles_x) * tile, y_begin = static_cast<int>(index / tiles_x) * tile;
    const int x_end = std::min(x_begin + tile, camera.width), y_end = std::min(y_begin + tile, camera.height);
    std::uint64_t traced = 0, resolved = 0;
    const auto write = [&](std::size_t pixel, const PreciseHit& h) {
      hits.instance[pixel] = h.instance;
      hits.triangle[pixel] = h.triangle;
      hits.u[pixel] = static_cast<float>(h.u);
      hits.v[pixel] = static_cast<float>(h.v);
      hits.depth[pixel] = static_cast<float>(h.t);
    };
    // Blocks of 4 x 2 pixels, a row of a tile at a time: all are traced, then their vertices looked up, then refined, so that what one
    // step fetches from memory is there for the next.
    struct Block {
      int x;
      Vec4 direction[2];
      alignas(32) std::array<std::uint32_t, 8> instance, triangle;
      const vec3* p[3][8];
    };
    std::array<Block, tile / 4> blocks;
    for (int by = y_begin; by < y_end; by += 2) {
      const int rows = std::min(2, y_end - by);
      std::uint32_t wanted[2] = {0, 0};  // a row of a tile is half a word of the mask
      for (int r = 0; r < rows; ++r) {
        wanted[r] = static_cast<std::uint32_t>(mask.bits[static_cast<std::size_t>(by + r) * mask.words + x_begin / 64] >> (x_begin % 64));
        const std::size_t first = hits.index(x_begin, by + r);
        if (x_end - x_begin == tile) {
          std::fill_n(hits.instance.data() + first, tile, no_hit);
          std::fill_n(hits.depth.data() + first, tile, 0.0f);
        } else {
          std::fill_n(hits.instance.data() + first, x_end - x_begin, no_hit);
          std::fill_n(hits.triangle.data() + first, x_end - x_begin, no_hit);
          for (PixelVector<float>* map : {&hits.u, &hits.v, &hits.depth}) std::fill_n(map->data() + first, x_end - x_begin, 0.0f);
        }
      }
      int count = 0;
      while (wanted[0] | wanted[1]) {
        const int column = std::countr_zero(wanted[0] | wanted[1]) & ~3;
        const std::uint32_t on = (wanted[0] >> column & 15) | (wanted[1] >> column & 15) << 4;
        for (std::uint32_t& w : wanted) w &= ~(15u << column);
        traced += std::popcount(on);

        Block& b = blocks[count++];
        b.x = x_begin + column;
        Ray8 rays;
        const Double4 x = static_cast<double>(b.x) + Double4{0, 1, 2, 3};
        for (int r = 0; r < 2; ++r) {
          const double y = by + r;
          const Vec4 d{corner.x + x * step_x.x + y * step_y.x, corner.y + x * step_x.y + y * step_y.y, corner.z + x * step_x.z + y * step_y.z};
          _mm_store_ps(&rays.ox[4 * r], narrow(origin.x + range.near * d.x));
          _mm_store_ps(&rays.oy[4 * r], narrow(origin.y + range.near * d.y));
          _mm_store_ps(&rays.oz[4 * r], narrow(origin.z + range.near * d.z));
          _mm_store_ps(&rays.dx[4 * r], narrow(d.x));
          _mm_store_ps(&rays.dy[4 * r], narrow(d.y));
          _mm_store_ps(&rays.dz[4 * r], narrow(d.z));
          b.direction[r] = d;
        }
        rays.near.fill(0);
        rays.far.fill(far);
        for (int i = 0; i < 8; ++i) rays.active[i] = static_cast<std::int32_t>(on >> i & 1);
        accel.intersect8(rays, true, ray_mask);
        b.instance = rays.instance;
        b.triangle = rays.triangle;
        for (int i = 0; i < 8; ++i)
          if (b.instance[i] != no_hit) _mm_prefetch(reinterpret_cast<const char*>(meshes[b.instance[i]].triangles + b.triangle[i]), _MM_HINT_T0);
      }
      for (int k = 0; k < count; ++k) {
        Block& b = blocks[k];
        for (int i = 0; i < 8; ++i) {
          static const vec3 anything[3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
          if (b.instance[i] == no_hit) {
            for (int c = 0; c < 3; ++c) b.p[c][i] = anything + c;
            continue;
          }
          const Mesh& mesh = meshes[b.instance[i]];
          const uvec3 t = mesh.triangles[b.triangle[i]];
          for (int c = 0; c < 3; ++c) {
            b.p[c][i] = mesh.positions + t[c];
            _mm_prefetch(reinterpret_cast<const char*>(b.p[c][i]), _MM_HINT_T0);
          }
        }
      }
      for (int k = 0; k < count; ++k)
        for (int r = 0; r < rows; ++r) {
          const Block& b = blocks[k];
          const __m128i instance = _mm_load_si128(reinterpret_cast<const __m128i*>(&b.instance[4 * r]));
          const __m128i triangle = _mm_load_si128(reinterpret_cast<const __m128i*>(&b.triangle[4 * r]));
          const __m128 missed = _mm_castsi128_ps(_mm_cmpeq_epi32(instance, _mm_set1_epi32(-1)));
          const int met = ~_mm_movemask_ps(missed) & 15;
          const Hit4 h = intersect_triangles(origin, b.direction[r], gather(&b.p[0][4 * r]), gather(&b.p[1][4 * r]), gather(&b.p[2][4 * r]));
          const int inside = lanes_of((h.u >= -edge_slack) & (h.v >= -edge_slack) & (h.u + h.v <= 1 + edge_slack) & (h.t > 0.0));
          const std::size_t pixel = hits.index(b.x, by + r);
          if (b.x + 4 <= x_end) {
            const auto store = [&](PixelVector<float>& map, Double4 value) { _mm_storeu_ps(map.data() + pixel, _mm_andnot_ps(missed, narrow(value))); };
            _mm_storeu_si128(reinterpret_cast<__m128i*>(hits.instance.data() + pixel), instance);
            _mm_storeu_si128(reinterpret_cast<__m128i*>(hits.triangle.data() + pixel), triangle);
            store(hits.u, h.u);
            store(hits.v, h.v);
            store(hits.depth, h.t);
          } else {
            for (int i = 0; i < 4; ++i)
              if (met >> i & 1) write(pixel + i, {b.instance[4 * r + i], b.triangle[4 * r + i], h.u[i], h.v[i], h.t[i]});
          }
          for (int i = 0; i < 4; ++i) {  // also where the triangle is seen edge-on and u is NaN
            if (!(met & ~inside & 1 << i)) continue;
            ++resolved;
            const dvec3 d(b.direction[r].x[i], b.direction[r].y[i], b.direction[r].z[i]);
            write(pixel + i, resolve(scene, accel, origin, d, step_x, step_y, range, ray_mask, b.instance[4 * r + i], b.triangle[4 * r + i]));
          }
        }
    }
    rays_traced += traced;
    rays_resolved += resolved;
  });
  for (const glm::ivec2& at : pixels_at_vertices(scene, camera, mask, ray_mask)) {
    const std::size_t pixel = hits.index(at.x, at.y);
    const PreciseHit h = resolve(scene, accel, origin, camera.direction(at.x + 0.5, at.y + 0.5), step_x, step_y, range, ray_mask,
                                 hits.instance[pixel], hits.triangle[pixel]);
    ++rays_resolved;
    if (!h.valid() || (hits.instance[pixel] != no_hit && static_cast<float>(h.t) >= hits.depth[pixel])) continue;
    hits.instance[pixel] = h.instance;
    hits.triangle[pixel] = h.triangle;
    hits.u[pixel] = static_cast<float>(h.u);
    hits.v[pixel] = static_cast<float>(h.v);
    hits.depth[pixel] = static_cast<float>(h.t);
  }
  hits.rays = rays_traced;
  hits.resolved = rays_resolved;
  return hits;
}

PreciseHit trace_precise(const Scene& scene, const Accel& accel, const Camera& camera, const dvec3& direction,
                         std::uint32_t ray_mask) {
  const DepthRange range = depth_range(scene, accel, camera);
  if (!(range.far > range.near)) return {};
  const dvec3 origin = camera.centre - scene.origin;
  const dvec3 o = origin + range.near * direction;
  const SurfaceHit h = accel.intersect({vec3(o), 0, vec3(direction), static_cast<float>(range.far - range.near)}, ray_mask);
  // Always resolved: keypoints often are vertices, where Embree's hit, or its miss, says little.
  const dvec3 step_x = camera.direction(1, 0) - camera.direction(0, 0);
  const dvec3 step_y = camera.direction(0, 1) - camera.direction(0, 0);
  return resolve(scene, accel, origin, direction, step_x, step_y, range, ray_mask, h.instance, h.triangle);
}

bool camera_is_inside(const Scene& scene, const Accel& accel, const Camera& camera) {
  const Box& box = accel.bounds(true);
  const dvec3 p = camera.centre - scene.origin;
  if (box.empty() || glm::any(glm::lessThan(p, box.lower)) || glm::any(glm::greaterThan(p, box.upper))) return false;
  // Inside a closed surface, whatever is met first is met from behind; open borders may mislead one direction, not most.
  static constexpr double directions[5][3] = {{1, 0.13, 0.07}, {-0.2, 1, 0.11}, {0.09, -0.17, 1}, {-1, -0.31, 0.05}, {0.21, 0.12, -1}};
  int from_behind = 0;
  for (const auto& d : directions) {
    const vec3 direction(static_cast<float>(d[0]), static_cast<float>(d[1]), static_cast<float>(d[2]));
    const SurfaceHit h = accel.intersect({vec3(p), 0, direction}, everything_mask & ~animal_mask(-1));
    if (!h.valid()) continue;
    const TriangleRef c = corners(scene, h.instance, h.triangle);
    from_behind += glm::dot(glm::cross(*c.p1 - *c.p0, *c.p2 - *c.p0), direction) > 0;
  }
  return from_behind >= 3;
}

}  // namespace moomill
