// Stress cases of edges: rays aimed at the shared edges and vertices of closed meshes must not slip through.
#include <atomic>

#include "generator/core/parallel.h"
#include "generator/core/random.h"
#include "validate/studies/stress.h"
#include "validate/studies/stress_scenes.h"

namespace moomill {
namespace {

constexpr std::uint64_t rays_per_task = 4096;

double unit(std::uint64_t ray, std::uint64_t what) {
  return to_unit(hash_identity({0x6372616b, ray, what}));
}

// A random point near the middle of a closed mesh, well inside.
dvec3 inside_point(std::uint64_t ray, double radius) {
  return radius * (2.0 * dvec3(unit(ray, 0), unit(ray, 1), unit(ray, 2)) - 1.0);
}

// What a ray is aimed at: a vertex, or a point of an edge at a place that floats rarely hold.
enum class Aim { edge, whole_edge, vertex, around_vertex, pole };

dvec3 target(const Surface& s, std::uint64_t ray, Aim aim) {
  if (aim == Aim::pole) return dvec3(s.rest[hash_identity({ray}) % 2]);
  const uvec3 t = s.triangles[hash_identity({ray, 1}) % s.triangles.size()];
  const int k = static_cast<int>(hash_identity({ray, 2}) % 3);
  const dvec3 a(s.rest[t[k]]), b(s.rest[t[(k + 1) % 3]]);
  if (aim == Aim::vertex) return a;
  if (aim == Aim::around_vertex)
    return a + 0.1 * unit(ray, 3) * (b - a) + 1e-3 * (dvec3(unit(ray, 4), unit(ray, 5), unit(ray, 6)) - 0.5);
  if (aim == Aim::whole_edge) return a + unit(ray, 3) * (b - a);
  return a + (0.001 + 0.998 * unit(ray, 3)) * (b - a);  // not its ends, which are cases of their own
}

Stage closed_body() {
  Stage stage;
  stage.add(stress_sphere(96, 192, 1, 5));
  return stage;
}

// Rays from inside a closed mesh that leave it. Eight at a time, as the path tracer and the labels trace them.
double escaped_packets(std::uint64_t rays, Aim aim, bool coherent) {
  const Stage stage = closed_body();
  const Accel accel(stage.scene);
  const Surface& s = *stage.surfaces[0];
  std::atomic<std::uint64_t> escaped{0};
  parallel_for((rays + rays_per_task - 1) / rays_per_task, 1, [&](std::size_t task) {
    std::uint64_t lost = 0;
    for (std::uint64_t first = task * rays_per_task; first < std::min((task + 1) * rays_per_task, rays); first += 8) {
      Ray8 r;
      for (int i = 0; i < 8; ++i) {
        const vec3 o(inside_point(first + i, 0.3));
        const vec3 d(target(s, first + i, aim) - dvec3(o));
        r.ox[i] = o.x, r.oy[i] = o.y, r.oz[i] = o.z;
        r.dx[i] = d.x, r.dy[i] = d.y, r.dz[i] = d.z;
        r.near[i] = 0;
        r.far[i] = std::numeric_limits<float>::infinity();
        r.active[i] = 1;
      }
      accel.intersect8(r, coherent);
      for (int i = 0; i < 8; ++i) lost += r.instance[i] == no_hit;
    }
    escaped += lost;
  });
  return static_cast<double>(escaped);
}

// The same by single rays: the nearest hit, and the question whether anything is hit at all.
double escaped_single(std::uint64_t rays, Aim aim) {
  const Stage stage = closed_body();
  const Accel accel(stage.scene);
  const Surface& s = *stage.surfaces[0];
  std::atomic<std::uint64_t> escaped{0};
  parallel_for((rays + rays_per_task - 1) / rays_per_task, 1, [&](std::size_t task) {
    std::uint64_t lost = 0;
    for (std::uint64_t i = task * rays_per_task; i < std::min((task + 1) * rays_per_task, rays); ++i) {
      const vec3 o(inside_point(i, 0.3));
      const vec3 d(glm::normalize(target(s, i, aim) - dvec3(o)));
      lost += i % 2 ? !accel.intersect({o, 0, d}).valid() : !accel.occluded({o, 0, d});
    }
    escaped += lost;
  });
  return static_cast<double>(escaped);
}

// Rays of labels and keypoints (double precision) from a camera inside, aimed at edges: those without a hit, and those
// whose hit lies nearer or farther than the point aimed at and not on another face. Also their largest relative error.
double escaped_precise(std::uint64_t rays, Aim aim) {
  const Stage stage = closed_body();
  const Accel accel(stage.scene);
  const Surface& s = *stage.surfaces[0];
  Camera camera = stress_camera({0.01, 0.02, 0.03}, {1, 0.5, 0.2}, 90, 1024, 1024);
  std::atomic<std::uint64_t> escaped{0};
  parallel_for((rays + rays_per_task - 1) / rays_per_task, 1, [&](std::size_t task) {
    std::uint64_t lost = 0;
    for (std::uint64_t i = task * rays_per_task; i < std::min((task + 1) * rays_per_task, rays); ++i) {
      const dvec3 p = target(s, i, aim), at = camera.to_camera(p);
      if (!(at.z > 0.1)) continue;  // behind the camera
      const PreciseHit h = trace_precise(stage.scene, accel, camera, (p - camera.centre) / at.z);
      lost += !h.valid() || h.t > at.z * (1 + 1e-9);
    }
    escaped += lost;
  });
  return static_cast<double>(escaped);
}

// Pictures whose pixel centres fall on the edges and vertices of a grid, whole and tipped: pixels without a hit, and
// the largest relative error of the depth where there are none.
double picture_of_edges(const StressOptions&) {
  double holes = 0, worst = 0;
  for (const float tilt : {0.0f, 0.5f}) {
    Stage stage;
    stage.add(
        stress_plate({-1, -1, -tilt}, {2, 0, 2 * tilt}, {0, 2, 0}, 64));  // vertices are multiples of 1 / 32: exact
    const int size = 249;
    Camera camera = stress_camera({0, 0, 8}, {0, 0, 0}, 10, size, size);
    camera.fx = camera.fy =
        1024;  // pixel pitch 1 / 128 m at the plate's middle; an odd picture has a pixel at the axis
    const Accel accel(stage.scene);
    const FirstHits hits = trace_first_hits(stage.scene, accel, camera, all_pixels(camera));
    for (int y = 0; y < size; ++y)
      for (int x = 0; x < size; ++x) {
        const dvec3 d = camera.direction(x + 0.5, y + 0.5);
        const double t = -8 / (d.z - tilt * d.x);
        if (std::max(std::abs(t * d.x), std::abs(t * d.y)) > 0.9999) continue;
        const std::size_t p = hits.index(x, y);
        if (hits.instance[p] == no_hit)
          ++holes;
        else
          worst = std::max(worst, std::abs(hits.depth[p] - t) / t);
      }
  }
  return holes > 0 ? holes : worst;
}

// Pictures of one pixel whose centre is a vertex, from inside: those whose depth is not the vertex's.
double pictures_of_vertices(const StressOptions& options) {
  const Stage stage = closed_body();
  const Accel accel(stage.scene);
  const Surface& s = *stage.surfaces[0];
  const std::size_t pictures = std::min<std::size_t>(options.edge_rays / 10, s.rest.size());
  std::atomic<std::uint64_t> wrong{0};
  parallel_for(pictures, 64, [&](std::size_t v) {
    const dvec3 eye = inside_point(v, 0.3), p(s.rest[v]);
    Camera camera = stress_camera(eye, p + 0.1 * dvec3(unit(v, 7), unit(v, 8), unit(v, 9)), 60, 3, 3);
    const dvec3 at = camera.to_camera(p);
    camera.fx = camera.fy = 3000;
    camera.cx = 1.5 - camera.fx * at.x / at.z;
    camera.cy = 1.5 - camera.fy * at.y / at.z;
    const FirstHits hits = trace_first_hits(stage.scene, accel, camera, all_pixels(camera));
    const std::size_t middle = hits.index(1, 1);
    wrong += hits.instance[middle] == no_hit || !(hits.depth[middle] <= at.z * (1 + 2 * float_rounding));
  });
  return static_cast<double>(wrong);
}

// Light that leaks into a closed black body through its edges: radiance seen from inside.
double leaked_light(const StressOptions&) {
  Stage stage;
  stage.finish(0.8f, 0, vec3(1));
  stage.add(stress_sphere(96, 192, 1, 5));
  stage.environment(vec3(1e6f));
  stage.lights.suns.push_back({glm::normalize(vec3(1, 2, 3)), vec3(1e6f), 0.01f});
  PathOptions o;
  o.samples = 64;
  const Shaded r = shade(stage, stress_camera({0.01, 0.02, 0.03}, {1, 0.5, 0.2}, 100, 32, 32), o);
  return r.not_finite > 0 ? static_cast<double>(r.not_finite) : r.most;
}

}  // namespace

std::vector<StressCase> edge_stress() {
  constexpr Oracle predicate = Oracle::exact_predicate;
  const char* const no_crack = "a ray from inside a closed mesh meets it";
  return {
      {"cracks at edges, packets",
       "packets of eight from inside a closed mesh of 36,480 faces at points of its edges, a thousandth off their ends",
       predicate, 0, "rays", no_crack,
       [](const StressOptions& o) { return escaped_packets(o.edge_rays, Aim::edge, true); }},
      {"cracks at edges, single rays", "single rays from inside, nearest hit and occlusion, at points of edges",
       predicate, 0, "rays", no_crack,
       [](const StressOptions& o) { return escaped_single(o.edge_rays / 2, Aim::edge); }},
      {"cracks around vertices", "packets from inside within 0.5 mm and a tenth of an edge of the vertices", predicate,
       0, "rays", no_crack,
       [](const StressOptions& o) { return escaped_packets(o.edge_rays / 2, Aim::around_vertex, false); }},
      {"cracks at vertices, raw rays",
       "packets from inside at the vertices exactly, to the last bit of their coordinates", predicate, 0.02,
       "of the rays",
       "Embree's test is watertight across edges; at a vertex, within 1e-7 of it, each face's test rounds on its own. "
       "Labels and keypoints do not "
       "rely on it (see below), and of the path tracer's random rays, by estimate, less than one in 1e9 slips",
       [](const StressOptions& o) {
         return escaped_packets(o.edge_rays / 10, Aim::vertex, false) / static_cast<double>(o.edge_rays / 10);
       }},
      {"cracks at a vertex of 192 faces", "single rays from inside at the two poles", predicate, 0, "rays", no_crack,
       [](const StressOptions& o) { return escaped_single(o.edge_rays / 4, Aim::pole); }},
      {"cracks of label rays at edges", "rays refined in double, from inside at points of edges", predicate, 0, "rays",
       "each has a hit, no farther than the point aimed at by more than 1e-9",
       [](const StressOptions& o) { return escaped_precise(o.edge_rays / 10, Aim::whole_edge); }},
      {"cracks of label rays at vertices", "rays refined in double, from inside at vertices", predicate, 0, "rays",
       "each has a hit, no farther than the point aimed at by more than 1e-9",
       [](const StressOptions& o) { return escaped_precise(o.edge_rays / 10, Aim::vertex); }},
      {"pictures of vertices", "pictures from inside whose pixel centre is a vertex, one after the other", predicate, 0,
       "pictures", "the vertex's depth, to float rounding, whatever Embree met", pictures_of_vertices},
      {"pictures of a grid's edges", "pixel centres on the edges and vertices of a grid, level and tipped by half",
       Oracle::analytic, 1.01 * float_rounding, "", "no hole, and depth is rounded to float once", picture_of_edges},
      {"light through edges", "a closed body under a sun and a sky of 1e6, seen from inside", predicate, 0, "radiance",
       "no light path may pass a closed mesh, at edges or anywhere", leaked_light},
  };
}

}  // namespace moomill
