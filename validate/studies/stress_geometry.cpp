// Stress cases of geometry: triangles, scales, places and lenses at the ends of what a scene may hold.
#include <tbb/global_control.h>

#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "generator/render/labels.h"
#include "rigs/pose.h"
#include "validate/studies/stress.h"
#include "validate/studies/stress_scenes.h"

namespace moomill {
namespace {

// Depth is stored as float; the hit itself is found in double. A hundredth of a rounding is left for that.
constexpr double depth_bound = 1.01 * float_rounding;
const char* const depth_why = "depth is rounded to float once; the hit is computed in double";

double needles(const StressOptions&) {
  // A plate, 2 m wide, of triangles 2 m long and 1e-6 m wide, every other one tipped: aspect two millions. Its height
  // is x / 2, which floats hold exactly.
  Surface s;
  const int n = 2000;
  const float width = 0x1p-20f;
  for (int i = 0; i <= n; ++i)
    for (const float y : {-1.0f, 1.0f}) s.rest.push_back({i * width, y, 0.5f * i * width});
  for (unsigned i = 0; i < static_cast<unsigned>(n); ++i) {
    s.triangles.push_back({2 * i, 2 * i + 2, 2 * i + 1});
    s.triangles.push_back({2 * i + 1, 2 * i + 2, 2 * i + 3});
  }
  finish_surface(s);
  Stage stage;
  stage.add(std::move(s));
  const double middle = 0.5 * n * width;
  Camera camera = stress_camera({middle, 0, 1}, {middle, 0, 0}, 0.1, 64, 64);
  const Accel accel(stage.scene);
  const FirstHits hits = trace_first_hits(stage.scene, accel, camera, all_pixels(camera));
  double worst = 0, wrong = 0;
  for (int y = 0; y < 64; ++y)
    for (int x = 0; x < 64; ++x) {
      const dvec3 d = camera.direction(x + 0.5, y + 0.5);
      const double t = (0.5 * camera.centre.x - camera.centre.z) / (d.z - 0.5 * d.x), at = camera.centre.x + t * d.x;
      if (at < 0 || at > n * double(width)) continue;
      const std::size_t p = hits.index(x, y);
      if (hits.instance[p] == no_hit)
        ++wrong;
      else
        worst = std::max(worst, std::abs(hits.depth[p] - t) / t);
    }
  return wrong > 0 ? wrong : worst;
}

// A plate at z = 0 under triangles without area; the count of pixels that see anything but the plate at its true depth.
double without_area(const StressOptions&) {
  Surface s = stress_plate({-1, -1, 0}, {2, 0, 0}, {0, 2, 0}, 8);
  const unsigned plate = static_cast<unsigned>(s.triangles.size()), base = static_cast<unsigned>(s.rest.size());
  for (int i = 0; i < 200; ++i) {
    const float x = -0.9f + 0.009f * i;
    s.rest.insert(s.rest.end(), {{x, -1, 0.5f}, {x, 1, 0.5f}, {x, 0, 0.5f}});
    s.normals.insert(s.normals.end(), 3, vec3(0, 0, 1));
    s.uvs.insert(s.uvs.end(), 3, vec2(0));
    const unsigned a = base + 3 * i;
    s.triangles.push_back({a, a + 1, a + 2});  // three points on a line
    s.triangles.push_back({a, a, a + 1});      // twice the same vertex
    s.triangles.push_back({a, a, a});
  }
  finish_surface(s);
  Stage stage;
  stage.add(std::move(s));
  const Camera camera = stress_camera({0, 0, 4}, {0, 0, 0}, 25, 201, 201);
  const Accel accel(stage.scene);
  const FirstHits hits = trace_first_hits(stage.scene, accel, camera, all_pixels(camera));
  double wrong = 0;
  for (std::size_t p = 0; p < hits.depth.size(); ++p)
    wrong += hits.instance[p] == no_hit || hits.triangle[p] >= plate || hits.depth[p] != 4.0f;
  return wrong;
}

double without_area_lit(const StressOptions&) {
  Surface s = stress_sphere(24, 48, 1);
  const std::vector<uvec3> whole = s.triangles;
  for (const uvec3& t : whole) {
    s.triangles.push_back({t[0], t[1], t[1]});
    s.triangles.push_back({t[2], t[2], t[2]});
  }
  finish_surface(s);
  Stage stage;
  stage.finish(0.5f, 0.5f, vec3(1));
  stage.add(std::move(s));
  stage.environment(vec3(1));
  PathOptions o;
  o.samples = 256;
  o.environment_visible = true;
  const Shaded r = shade(stage, stress_camera({4, 0, 0}, {0, 0, 0}, 25, 24, 24), o);
  return r.not_finite > 0 ? static_cast<double>(r.not_finite) : std::abs(r.mean.y - 1);
}

// Pixels whose first hit differs between one thread and two, or whose depth between rebuilt and refitted hierarchies.
double differing_pixels(const Stage& stage, const Camera& camera) {
  const auto trace = [&](int threads, BuildKind kind) {
    tbb::global_control control(tbb::global_control::max_allowed_parallelism, threads);
    const Accel accel(stage.scene, kind);
    return trace_first_hits(stage.scene, accel, camera, all_pixels(camera));
  };
  const FirstHits a = trace(1, BuildKind::rebuild);
  double differing = 0;
  const FirstHits b = trace(2, BuildKind::rebuild), c = trace(1, BuildKind::refit);
  for (std::size_t p = 0; p < a.depth.size(); ++p) {
    differing += a.instance[p] != b.instance[p] || a.triangle[p] != b.triangle[p] || a.depth[p] != b.depth[p];
    differing += a.depth[p] != c.depth[p];
  }
  return differing;
}

double duplicated_faces(const StressOptions&) {
  Surface s = stress_sphere(16, 32, 1, 3);
  const std::vector<uvec3> once = s.triangles;
  s.triangles.insert(s.triangles.end(), once.begin(), once.end());
  finish_surface(s);
  Stage stage;
  stage.add(std::move(s));
  const Camera camera = stress_camera({4, 1, 1}, {0, 0, 0}, 35, 48, 48);
  const double wrong = differing_pixels(stage, camera);
  return wrong > 0 ? wrong : depth_error(stage.scene, camera);
}

double coincident_animals(const StressOptions&) {
  Stage stage;
  stage.add(stress_sphere(16, 32, 1, 3), 0);
  stage.add(stress_sphere(16, 32, 1, 3), 1);
  return differing_pixels(stage, stress_camera({4, 1, 1}, {0, 0, 0}, 35, 48, 48));
}

// Occlusion of two animals in the same place: every pixel is whole for both, and visible for exactly one.
double coincident_occlusion(const StressOptions&) {
  Stage stage;
  stage.add(stress_sphere(16, 32, 1, 3), 0);
  stage.add(stress_sphere(16, 32, 1, 3), 1);
  const Camera camera = stress_camera({4, 1, 1}, {0, 0, 0}, 35, 48, 48);
  const Accel accel(stage.scene);
  const FirstHits hits = trace_first_hits(stage.scene, accel, camera, all_pixels(camera));
  View view;
  add_occlusion(view, stage.scene, accel, camera, hits);
  double seen = 0;
  for (const std::uint32_t i : hits.instance) seen += i != no_hit;
  double wrong = 0;
  for (const OcclusionView& o : view.occlusion) wrong += std::abs(static_cast<double>(o.whole_pixels) - seen);
  return wrong +
         std::abs(static_cast<double>(view.occlusion[0].visible_pixels + view.occlusion[1].visible_pixels) - seen);
}

// A dented ball of this radius from three radii away.
double world_of_size(double radius) {
  Stage stage;
  stage.add(stress_sphere(20, 40, radius, 4));
  return depth_error(stage.scene, stress_camera(radius * dvec3(3, 1.1, 0.7), {0, 0, 0}, 40, 48, 48));
}

double furnace_of_size(float radius) {
  Stage stage;
  stage.finish(0.6f, 0, vec3(1));
  stage.add(stress_sphere(40, 80, radius, 4));  // dented, so that light goes from dent to dent
  stage.environment(vec3(1));
  PathOptions o;
  o.samples = 256;
  const Shaded r = shade(stage, stress_camera(double(radius) * dvec3(3, 1.1, 0.7), {0, 0, 0}, 15, 24, 24), o);
  return r.not_finite > 0 ? static_cast<double>(r.not_finite) : std::abs(r.mean.y - 1);
}

// The animal and its camera moved by a million metres: depth against the oracle, which has the same camera.
double far_from_origin(const StressOptions&) {
  Stage stage;
  stage.scene.origin = {1e6, -1e6, 5e5};
  stage.add(stress_sphere(20, 40, 1, 4));
  return depth_error(stage.scene,
                     stress_camera(stage.scene.origin + dvec3(3, 1.1, 0.7), stage.scene.origin, 40, 48, 48));
}

// The same scene at the world's origin and a million metres from it: the largest difference of the depths, in metres.
double moved_scene(const StressOptions&) {
  FirstHits hits[2];
  for (int k = 0; k < 2; ++k) {
    Stage stage;
    stage.scene.origin = k ? dvec3(1e6, -1e6, 5e5) : dvec3(0);
    stage.add(stress_sphere(20, 40, 1, 4));
    Camera camera = stress_camera({3, 1.1, 0.7}, {0, 0, 0}, 40, 96, 96);
    camera.centre += stage.scene.origin;
    const Accel accel(stage.scene);
    hits[k] = trace_first_hits(stage.scene, accel, camera, all_pixels(camera));
  }
  double worst = 0;
  for (std::size_t p = 0; p < hits[0].depth.size(); ++p) {
    if (hits[0].triangle[p] == hits[1].triangle[p])
      worst = std::max<double>(worst, std::abs(hits[0].depth[p] - hits[1].depth[p]));
    if ((hits[0].instance[p] == no_hit) != (hits[1].instance[p] == no_hit)) return 1;
  }
  return worst;
}

double one_degree_lens(const StressOptions&) {
  Stage stage;
  stage.add(stress_sphere(20, 40, 7, 4));
  return depth_error(stage.scene, stress_camera({800, -500, 300}, {0, 0, 0}, 1, 48, 48));
}

// Where a hit's barycentrics put it must be the centre of its pixel again.
double reprojected(const StressOptions&) {
  Stage stage;
  stage.add(stress_sphere(20, 40, 7, 4));
  const Camera camera = stress_camera({800, -500, 300}, {0, 0, 0}, 1, 1024, 768);
  const Accel accel(stage.scene);
  const FirstHits hits = trace_first_hits(stage.scene, accel, camera, all_pixels(camera));
  double worst = 0;
  for (int y = 0; y < camera.height; ++y)
    for (int x = 0; x < camera.width; ++x) {
      const std::size_t p = hits.index(x, y);
      if (hits.instance[p] == no_hit) continue;
      const Instance& in = stage.scene.instances[0];
      const uvec3 t = in.surface->triangles[hits.triangle[p]];
      const dvec3 a(in.posed.positions[t[0]]), b(in.posed.positions[t[1]]), c(in.posed.positions[t[2]]);
      const double u = hits.u[p], v = hits.v[p];
      const dvec2 pixel = camera.project(camera.to_camera((1 - u - v) * a + u * b + v * c));
      worst = std::max(worst, glm::length(pixel - dvec2(x + 0.5, y + 0.5)));
    }
  return worst;
}

double wide_lens(const StressOptions&) {
  Stage stage;
  stage.add(stress_sphere(20, 40, 1, 4));
  return depth_error(stage.scene, stress_camera({1.1, 0, 0}, {0, 0, 0}, 170, 64, 64));
}

// Pixels that meet the animal but lie outside its footprint, with the camera so near that much is behind it.
double wide_footprint(const StressOptions&) {
  double missed = 0;
  for (const double height : {1.1, 1.01, 1.0005}) {
    Stage stage;
    stage.add(stress_sphere(40, 80, 1));
    const Camera camera = stress_camera({height, 0, 0}, {0, 0.3, 0}, 170, 160, 120);
    const Accel accel(stage.scene);
    const PixelMask mask = footprint(stage.scene, camera, 0);
    const FirstHits hits = trace_first_hits(stage.scene, accel, camera, all_pixels(camera));
    for (int y = 0; y < camera.height; ++y)
      for (int x = 0; x < camera.width; ++x) missed += hits.instance[hits.index(x, y)] != no_hit && !mask.get(x, y);
  }
  return missed;
}

// Cameras a tenth of a millimetre inside and outside the surface of a dented ball: how many are judged wrongly.
double inside_or_outside(const StressOptions&) {
  Stage stage;
  stage.add(stress_sphere(48, 96, 1, 4));
  const Accel accel(stage.scene);
  const Surface& s = *stage.surfaces[0];
  double wrong = 0;
  for (std::size_t i = 0; i < s.triangles.size(); i += 7) {
    const uvec3 t = s.triangles[i];
    const dvec3 a(s.rest[t[0]]), b(s.rest[t[1]]), c(s.rest[t[2]]);
    const dvec3 middle = (a + b + c) / 3.0, normal = glm::normalize(glm::cross(b - a, c - a));
    Camera camera;
    camera.centre = middle - 1e-4 * normal;
    wrong += !camera_is_inside(stage.scene, accel, camera);
    camera.centre = middle + 1e-4 * normal;
    wrong += camera_is_inside(stage.scene, accel, camera);
  }
  return wrong;
}

// The camera exactly on a vertex, on an edge and on a face, and a view from inside: values that are not finite, depths
// that are not positive, and hits outside the picture.
double touching(const StressOptions&) {
  double wrong = 0;
  const Surface ball = stress_sphere(16, 32, 1, 3);
  const uvec3 t = ball.triangles[200];
  const dvec3 a(ball.rest[t[0]]), b(ball.rest[t[1]]), c(ball.rest[t[2]]);
  for (const dvec3& eye : {a, 0.5 * (a + b), (a + b + c) / 3.0, dvec3(0)})
    for (const dvec3& target : {dvec3(0.01, 0.02, 0.03), 3.0 * (a + 0.1 * b), a + dvec3(0, 0, 1)}) {
      Stage stage;
      stage.add(stress_sphere(16, 32, 1, 3));
      stage.environment(vec3(1));
      const Camera camera = stress_camera(eye, target, 120, 32, 32);
      const Accel accel(stage.scene);
      const PixelMask mask = footprint(stage.scene, camera, 1.5);
      const FirstHits hits = trace_first_hits(stage.scene, accel, camera, mask);
      for (std::size_t p = 0; p < hits.depth.size(); ++p)
        wrong += hits.instance[p] != no_hit &&
                 (!(hits.depth[p] > 0) || !std::isfinite(hits.depth[p] + hits.u[p] + hits.v[p]));
      PathOptions o;
      o.samples = 4;
      const Shaded r = shade(stage, camera, o);
      wrong += static_cast<double>(r.not_finite) + !std::isfinite(r.most) + (r.least < -1);
    }
  return wrong;
}

// A plate seen from 0.1 mm above it, to 1 km away: the ray of the far end grazes it by 1e-7 radians.
double grazing(const StressOptions&) {
  Stage stage;
  stage.add(stress_plate({0, -512, 0}, {1024, 0, 0}, {0, 1024, 0}, 4));
  const double height = 1e-4;
  Camera camera = stress_camera({-1e-3, 0, height}, {1, 0, height}, 90, 64, 4096);
  camera.fx = 32;
  camera.fy = 4096e4;  // a picture of the last 1e-4 radians below the horizon
  camera.cy = 0;       // the horizon is the upper border
  const Accel accel(stage.scene);
  const FirstHits hits = trace_first_hits(stage.scene, accel, camera, all_pixels(camera));
  double worst = 0, wrong = 0;
  for (int y = 0; y < camera.height; ++y)
    for (int x = 0; x < camera.width; ++x) {
      const dvec3 d = camera.direction(x + 0.5, y + 0.5);
      const double t = -height / d.z;
      const dvec3 at = camera.centre + t * d;
      const std::size_t p = hits.index(x, y);
      if (at.x < 1e-6 || at.x > 1023.999 || std::abs(at.y) > 511.999) continue;
      if (hits.instance[p] == no_hit)
        ++wrong;
      else
        worst = std::max(worst, std::abs(hits.depth[p] - t) / t);
    }
  return wrong > 0 ? wrong : worst;
}

// A ball of 1 mm before a hill of 100 m on a plate of 2 km: depth of all.
double mixed_scales(const StressOptions&) {
  Stage stage;
  stage.add(stress_sphere(16, 32, 0.001, 3), 0);
  stage.add(stress_sphere(16, 32, 100, 3), -1, {-300, 0, 0});
  stage.add(stress_plate({-1024, -1024, -16}, {2048, 0, 0}, {0, 2048, 0}, 4), -1);
  return depth_error(stage.scene, stress_camera({0.004, 0.0005, 0.0005}, {0, 0, 0}, 60, 64, 64));
}

// Nothing at all, and a surface without triangles: anything met, or any failure.
double empty_scene(const StressOptions&) {
  double wrong = 0;
  for (const bool with_surface : {false, true}) {
    Stage stage;
    stage.finish(0.5f, 0, vec3(0.5f));
    if (with_surface) {
      Surface s;
      s.rest = {vec3(0), vec3(1), vec3(2)};
      finish_surface(s);
      stage.add(std::move(s));
    }
    const Camera camera = stress_camera({3, 0, 0}, {0, 0, 0}, 40, 16, 16);
    const Accel accel(stage.scene);
    const FirstHits hits = trace_first_hits(stage.scene, accel, camera, footprint(stage.scene, camera, 0));
    for (const std::uint32_t i : hits.instance) wrong += i != no_hit;
    stage.environment(vec3(1));
    PathOptions o;
    o.samples = 4;
    const Shaded r = shade(stage, camera, o);
    wrong += static_cast<double>(r.not_finite + r.pixels.size());
  }
  return wrong;
}

// Neutral coordinates of flat, tiny and far surfaces must lie in [0, 1] and give the metres back.
double neutral_coordinates(const StressOptions&) {
  double worst = 0;
  for (const NnopcsNormalization kind : {NnopcsNormalization::box, NnopcsNormalization::diagonal})
    for (const double size : {1e-3, 1.0, 1e5})
      for (const bool flat : {false, true}) {
        Surface s = flat ? stress_plate(vec3(size * dvec3(1, 2, 3)), vec3(size, 0, 0), vec3(0, size, 0), 8)
                         : stress_sphere(16, 32, size);
        bake_nnopcs(s, s.rest, kind);
        for (std::size_t i = 0; i < s.rest.size(); ++i) {
          const dvec3 back = nnopcs_to_metres(s, dvec3(s.nnopcs[i]));
          for (int k = 0; k < 3; ++k) {
            if (!(s.nnopcs[i][k] >= 0 && s.nnopcs[i][k] <= 1)) return 1;
            worst = std::max(worst, std::abs(back[k] - s.rest[i][k]) / s.neutral_box.diagonal());
          }
        }
      }
  return worst;
}

// Rigs that cannot be rendered: how many of them are taken, or refused without a sentence that names the place.
double refused_geometry(const StressOptions&) {
  const auto rig_with = [](const std::function<void(Rig&)>& spoil) {
    Rig rig;
    rig.source = "spoilt.glb";
    rig.surface = stress_sphere(4, 8, 1);
    spoil(rig);
    return rig;
  };
  const float nan = std::numeric_limits<float>::quiet_NaN(), infinity = std::numeric_limits<float>::infinity();
  const std::vector<std::function<void(Rig&)>> spoilt = {
      [&](Rig& r) { r.surface.rest[3].y = nan; },
      [&](Rig& r) { r.surface.rest[3].y = infinity; },
      [&](Rig& r) { r.surface.rest[3].y = 1e30f; },
      [&](Rig& r) { r.surface.triangles[2][1] = 4'000'000'000u; },
      [&](Rig& r) {
        r.surface.triangles.clear();
        r.surface.materials.clear();
        r.surface.parts.clear();
      },
      [&](Rig& r) { r.surface.uvs.assign(r.surface.rest.size(), vec2(nan)); },
      [&](Rig& r) {
        r.nodes = {{.name = "a", .parent = 1}, {.name = "b", .parent = 0}};
      },
      [&](Rig& r) {
        r.nodes = {{.name = "a", .translation = {0, std::numeric_limits<double>::infinity(), 0}}};
      },
      [&](Rig& r) { r.nodes = {{.name = "a", .rotation = dquat(0, 0, 0, 0)}}; },
  };
  double taken = 0;
  for (const auto& spoil : spoilt) {
    Rig rig = rig_with(spoil);
    try {
      finish_rig(rig);
      ++taken;
    } catch (const InputError& e) {
      taken += std::string(e.what()).rfind("spoilt.glb: ", 0) != 0;
    }
  }
  return taken;
}

}  // namespace

std::vector<StressCase> geometry_stress() {
  constexpr Oracle analytic = Oracle::analytic, precise = Oracle::high_precision, predicate = Oracle::exact_predicate;
  return {
      {"needles", "4,000 triangles, 2 m long and 1e-6 m wide, seen from 1 m", analytic, depth_bound, "", depth_why,
       needles},
      {"triangles without area", "600 of them, collinear or with a vertex twice, hover before a plate", predicate, 0,
       "pixels", "a set of no area covers no pixel: the plate is seen everywhere, at 4 m exactly", without_area},
      {"triangles without area, lit", "a white ball with two of them on every face, in white light", analytic, 0.005,
       "", "the tables of the BSDF's albedo hold to 0.5 %; what has no area takes no light", without_area_lit},
      {"duplicated faces", "every face twice; one thread, two threads, refitted", precise, depth_bound, "",
       "depth is rounded once, and which twin is met must not depend on threads", duplicated_faces},
      {"coincident animals", "two animals in one place; one thread, two threads, refitted", predicate, 0, "pixels",
       "a tie is broken by index, never by the order of work", coincident_animals},
      {"occlusion of coincident animals", "whole and visible pixels of two animals in one place", predicate, 0,
       "pixels", "each is whole in every pixel, exactly one is visible", coincident_occlusion},
      {"world of 1 mm", "a dented ball of 1 mm from 3 mm away", precise, depth_bound, "", depth_why,
       [](const StressOptions&) { return world_of_size(0.001); }},
      {"world of 100 km", "a dented ball of 100 km from 300 km away", precise, depth_bound, "", depth_why,
       [](const StressOptions&) { return world_of_size(1e5); }},
      {"light in a world of 1 mm", "white dented ball of 1 mm in white light", analytic, 0.01, "",
       "0.5 % for the tables of the albedo, 0.5 % for 256 samples a pixel",
       [](const StressOptions&) { return furnace_of_size(0.001f); }},
      {"light in a world of 100 km", "white dented ball of 100 km in white light", analytic, 0.01, "",
       "0.5 % for the tables of the albedo, 0.5 % for 256 samples a pixel",
       [](const StressOptions&) { return furnace_of_size(1e5f); }},
      {"1e6 m from the origin", "animal and camera at (1e6, -1e6, 5e5) m", precise, depth_bound, "",
       "vertices are float relative to a double origin, so the distance costs nothing but the one rounding",
       far_from_origin},
      {"moved by 1e6 m", "the same scene here and at (1e6, -1e6, 5e5) m, depths compared", analytic, 1e-6, "m",
       "the camera's centre is rounded to 1.2e-10 m there; a float depth of 4 m may then fall to its neighbour, 4.8e-7 "
       "m away",
       moved_scene},
      {"1 degree lens from 1 km", "a dented ball of 7 m from 990 m through a 1 degree lens", precise, depth_bound, "",
       depth_why, one_degree_lens},
      {"reprojection through a 1 degree lens", "barycentrics of every hit put back into the picture", analytic, 1e-4,
       "px",
       "barycentrics are rounded to 6e-8 of a 2 m triangle, and a pixel is 17 mm wide there: 1e-5 px, and slack for "
       "grazing faces",
       reprojected},
      {"170 degree lens at 10 cm", "a ball of 1 m filling a 170 degree picture", precise, depth_bound, "", depth_why,
       wide_lens},
      {"footprint of a 170 degree lens", "10 cm, 1 cm and 0.5 mm before the body", predicate, 0, "pixels",
       "a pixel that meets the animal must lie in its footprint, or it would not be rendered", wide_footprint},
      {"camera inside or outside", "cameras 0.1 mm below and above the faces of a dented ball", predicate, 0, "cameras",
       "0.1 mm is a hundred times the rounding of a ray that leaves a surface", inside_or_outside},
      {"camera touching the body", "camera on a vertex, an edge and a face, and inside; labels and light", predicate, 0,
       "values", "every value is finite and every depth positive, wherever the camera stands", touching},
      {"grazing view", "a plate of 1 km from 0.1 mm above it, down to 1e-7 radians", analytic, depth_bound, "",
       depth_why, grazing},
      {"mixed scales", "a ball of 1 mm, a hill of 100 m and a plate of 2 km in one scene", precise, depth_bound, "",
       depth_why, mixed_scales},
      {"empty scene", "no instance, and a surface without triangles; labels and light", predicate, 0, "pixels",
       "nothing is met and nothing fails", empty_scene},
      {"neutral coordinates",
       "flat and round surfaces of 1 mm, 1 m and 100 km, both normalisations, and back to metres", analytic,
       2 * float_rounding, "", "coordinates are floats in [0, 1]: half a unit of the last place, of the box",
       neutral_coordinates},
      {"rigs that cannot be rendered", "not-a-number, infinite and absurd positions, bad indices, cycles, no rotation",
       predicate, 0, "rigs", "each is refused with a sentence that names the file", refused_geometry},
  };
}

}  // namespace moomill
