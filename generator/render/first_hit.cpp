#include "generator/render/first_hit.h"

#include <atomic>

#include "generator/core/error.h"
#include "generator/core/parallel.h"

namespace moomill {
namespace {

constexpr int tile = 32;             // pixels, side of a unit of parallel work
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

// Pixels of the mask whose centre lies so near a projected vertex that Embree's ray, rounded to float, may pass through it.
// Its test is watertight across edges, but at a vertex the tests of all faces round on their own, and one ray in a hundred
// that is aimed at it slips between them.
std::vector<glm::ivec2> pixels_at_vertices(const Scene& scene, const Camera& camera, const PixelMask& mask, std::uint32_t ray_mask) {
  std::vector<glm::ivec2> pixels;
  const double radius = 1e-3 + 0x1p-22 * std::max(camera.fx, camera.fy);  // four roundings of a direction, in pixels
  const dmat3 turn = glm::transpose(camera.world_to_camera);               // its columns are the rows of the rotation
  const dvec3 to_x = camera.fx * turn[0] + camera.cx * turn[2], to_y = camera.fy * turn[1] + camera.cy * turn[2];
  const dvec3 eye = camera.centre - scene.origin;
  for (const Instance& in : scene.instances) {
    if (!(animal_mask(in.animal) & ray_mask)) continue;
    for (const vec3& position : in.posed.positions) {
      const dvec3 p = dvec3(position) - eye;
      const double z = glm::dot(turn[2], p);
      if (!(z > 0)) continue;
      const double x = glm::dot(to_x, p) / z, y = glm::dot(to_y, p) / z;
      if (!(x >= 0 && y >= 0 && x < camera.width && y < camera.height)) continue;
      const int i = static_cast<int>(x), j = static_cast<int>(y);
      if (std::abs(x - i - 0.5) < radius && std::abs(y - j - 0.5) < radius && mask.get(i, j)) pixels.push_back({i, j});
    }
  }
  return pixels;
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
  instance.assign(n, no_hit);
  triangle.assign(n, no_hit);
  u.assign(n, 0);
  v.assign(n, 0);
  depth.assign(n, 0);
}

FirstHits trace_first_hits(const Scene& scene, const Accel& accel, const Camera& camera, const PixelMask& mask,
                           std::uint32_t ray_mask) {
  FirstHits hits(camera.width, camera.height);
  const DepthRange range = depth_range(scene, accel, camera);
  if (!(range.far > range.near)) return hits;
  const dvec3 origin = camera.centre - scene.origin;
  const dvec3 step_x = camera.direction(1, 0) - camera.direction(0, 0);
  const dvec3 step_y = camera.direction(0, 1) - camera.direction(0, 0);
  const dvec3 corner = camera.direction(0.5, 0.5);
  const float far = static_cast<float>(range.far - range.near);
  std::atomic<std::uint64_t> rays_traced{0}, rays_resolved{0};
  const int tiles_x = (camera.width + tile - 1) / tile, tiles_y = (camera.height + tile - 1) / tile;

  parallel_for(static_cast<std::size_t>(tiles_x) * tiles_y, 1, [&](std::size_t index) {
    const int x_begin = static_cast<int>(index % tiles_x) * tile, y_begin = static_cast<int>(index / tiles_x) * tile;
    const int x_end = std::min(x_begin + tile, camera.width), y_end = std::min(y_begin + tile, camera.height);
    std::uint64_t traced = 0, resolved = 0;
    for (int by = y_begin; by < y_end; by += 2)
      for (int bx = x_begin; bx < x_end; bx += 4) {
        Ray8 rays;
        alignas(32) double dx[8], dy[8], dz[8];
        int any = 0;
        for (int i = 0; i < 8; ++i) {
          const int x = bx + (i & 3), y = by + (i >> 2);
          const int on = x < x_end && y < y_end && mask.get(x, y);
          rays.active[i] = on;
          any += on;
          dx[i] = corner.x + x * step_x.x + y * step_y.x;
          dy[i] = corner.y + x * step_x.y + y * step_y.y;
          dz[i] = corner.z + x * step_x.z + y * step_y.z;
        }
        if (!any) continue;
        traced += any;
        for (int i = 0; i < 8; ++i) {
          rays.ox[i] = static_cast<float>(origin.x + range.near * dx[i]);
          rays.oy[i] = static_cast<float>(origin.y + range.near * dy[i]);
          rays.oz[i] = static_cast<float>(origin.z + range.near * dz[i]);
          rays.dx[i] = static_cast<float>(dx[i]);
          rays.dy[i] = static_cast<float>(dy[i]);
          rays.dz[i] = static_cast<float>(dz[i]);
          rays.near[i] = 0;
          rays.far[i] = far;
        }
        accel.intersect8(rays, true, ray_mask);

        // The same as intersect_triangle(), eight lanes side by side so that the compiler can vectorise it.
        alignas(32) double p[9][8];
        int met = 0;
        for (int i = 0; i < 8; ++i) {
          const bool hit = rays.instance[i] != no_hit;
          met += hit;
          const TriangleRef c = hit ? corners(scene, rays.instance[i], rays.triangle[i]) : TriangleRef{};
          for (int k = 0; k < 3; ++k) {
            p[k][i] = hit ? (*c.p0)[k] : 0.0;
            p[3 + k][i] = hit ? (*c.p1)[k] : k == 0;
            p[6 + k][i] = hit ? (*c.p2)[k] : k == 1;
          }
        }
        if (!met) continue;
        alignas(32) double t[8], u[8], v[8];
        for (int i = 0; i < 8; ++i) {
          const double e1x = p[3][i] - p[0][i], e1y = p[4][i] - p[1][i], e1z = p[5][i] - p[2][i];
          const double e2x = p[6][i] - p[0][i], e2y = p[7][i] - p[1][i], e2z = p[8][i] - p[2][i];
          const double qx = dy[i] * e2z - e2y * dz[i], qy = dz[i] * e2x - e2z * dx[i], qz = dx[i] * e2y - e2x * dy[i];
          const double det = e1x * qx + e1y * qy + e1z * qz;
          const double sx = origin.x - p[0][i], sy = origin.y - p[1][i], sz = origin.z - p[2][i];
          const double rx = sy * e1z - e1y * sz, ry = sz * e1x - e1z * sx, rz = sx * e1y - e1x * sy;
          u[i] = (sx * qx + sy * qy + sz * qz) / det;
          v[i] = (dx[i] * rx + dy[i] * ry + dz[i] * rz) / det;
          t[i] = (e2x * rx + e2y * ry + e2z * rz) / det;
        }
        for (int i = 0; i < 8; ++i) {
          if (rays.instance[i] == no_hit) continue;
          const std::size_t pixel = hits.index(bx + (i & 3), by + (i >> 2));
          const bool inside = u[i] >= -edge_slack && v[i] >= -edge_slack && u[i] + v[i] <= 1 + edge_slack && t[i] > 0;
          if (inside) {
            hits.instance[pixel] = rays.instance[i];
            hits.triangle[pixel] = rays.triangle[i];
            hits.u[pixel] = static_cast<float>(u[i]);
            hits.v[pixel] = static_cast<float>(v[i]);
            hits.depth[pixel] = static_cast<float>(t[i]);
          } else {  // also where the triangle is seen edge-on and u is NaN
            ++resolved;
            const PreciseHit h = resolve(scene, accel, origin, {dx[i], dy[i], dz[i]}, step_x, step_y, range, ray_mask,
                                         rays.instance[i], rays.triangle[i]);
            hits.instance[pixel] = h.instance;
            hits.triangle[pixel] = h.triangle;
            hits.u[pixel] = static_cast<float>(h.u);
            hits.v[pixel] = static_cast<float>(h.v);
            hits.depth[pixel] = static_cast<float>(h.t);
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
