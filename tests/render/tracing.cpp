// First hits against a brute-force oracle in double; footprints, labels, keypoints, occlusion.
#include "generator/core/parallel.h"
#include "generator/render/labels.h"
#include "tests/render/fixtures.h"

using namespace moomill;
using namespace moomill::test;

namespace {

struct OracleHit {
  std::uint32_t instance = no_hit, triangle = no_hit;
  double t = std::numeric_limits<double>::infinity(), u = 0, v = 0;
  double edge_pixels = std::numeric_limits<double>::infinity();  // distance of the pixel centre to the nearest edge of any triangle near the ray
};

// Distance of a point to a segment, in pixels.
double to_segment(const dvec2& p, const dvec2& a, const dvec2& b) {
  const dvec2 d = b - a;
  const double l = glm::dot(d, d), s = l > 0 ? std::clamp(glm::dot(p - a, d) / l, 0.0, 1.0) : 0.0;
  return glm::length(p - a - s * d);
}

OracleHit oracle(const Scene& scene, const Camera& camera, double x, double y) {
  OracleHit best;
  const dvec3 o = camera.centre - scene.origin, d = camera.direction(x, y);
  for (std::uint32_t i = 0; i < scene.instances.size(); ++i) {
    const Instance& in = scene.instances[i];
    for (std::uint32_t k = 0; k < in.surface->triangles.size(); ++k) {
      const uvec3 t = in.surface->triangles[k];
      const dvec3 a(in.posed.positions[t[0]]), b(in.posed.positions[t[1]]), c(in.posed.positions[t[2]]);
      // Cramer's rule, on its own rather than by the code under test.
      const dmat3 m(a - b, a - c, d);
      const double det = glm::determinant(m);
      const dvec3 rhs = a - o;
      const double beta = glm::determinant(dmat3(rhs, a - c, d)) / det;
      const double gamma = glm::determinant(dmat3(a - b, rhs, d)) / det;
      const double dist = glm::determinant(dmat3(a - b, a - c, rhs)) / det;
      if (beta > -0.01 && gamma > -0.01 && beta + gamma < 1.01) {
        const dvec2 pa = camera.project(camera.to_camera(a + scene.origin)), pb = camera.project(camera.to_camera(b + scene.origin)),
                    pc = camera.project(camera.to_camera(c + scene.origin)), p(x, y);
        best.edge_pixels = std::min({best.edge_pixels, to_segment(p, pa, pb), to_segment(p, pb, pc), to_segment(p, pc, pa)});
      }
      if (beta >= 0 && gamma >= 0 && beta + gamma <= 1 && dist > 0 && dist < best.t) {
        best.t = dist, best.u = beta, best.v = gamma, best.instance = i, best.triangle = k;
      }
    }
  }
  return best;
}

Scene scene_of(std::vector<Instance> instances, int animals) {
  Scene s;
  auto a = std::make_shared<Appearance>();
  add_material(*a, 0.5f, 0, {vec3(0.5f)});
  s.appearance = a;
  s.instances = std::move(instances);
  s.animal_count = animals;
  return s;
}

}  // namespace

TEST_CASE("depth, barycentrics and NNOPCS agree with a brute-force oracle in double") {
  struct Case {
    Surface surface;
    dvec3 eye, origin;
    double focal;
  };
  const Case cases[] = {
      {thorny_surface(3000, 1), {9, 3, 4}, {0, 0, 0}, 900},
      {thorny_surface(3000, 2), {0.4, 0.2, 6}, {0, 0, 0}, 500},
      {sphere_surface(60, 120), {-7, 5, 2}, {0, 0, 0}, 700},
      {thorny_surface(2000, 3), {4009, -2997, 1004}, {4000, -3000, 1000}, 900},  // far from the world's origin
      {thorny_surface(2000, 4), {90, 30, 40}, {0, 0, 0}, 9000},                  // long lens
  };
  double worst_depth = 0, worst_nnopcs = 0;
  std::uint64_t compared = 0, exempt = 0, resolved = 0;
  for (const Case& c : cases) {
    Scene scene = scene_of({instance_of(c.surface, 0, 0)}, 1);
    scene.origin = c.origin;
    const Camera camera = look_at(c.eye, c.origin, c.focal, 160, 120);
    const Accel accel(scene);
    PixelMask all(160, 120);
    all.fill();
    const FirstHits hits = trace_first_hits(scene, accel, camera, all);
    const FirstHits masked = trace_first_hits(scene, accel, camera, footprint(scene, camera, 0));
    CHECK(hits.instance == masked.instance);  // the footprint leaves nothing out
    CHECK(masked.rays <= hits.rays);
    resolved += hits.resolved;
    View view;
    LabelRequest request;
    request.modalities.add(Modality::nnopcs);
    add_labels(view, scene, hits, request);
    const ImageF& nnopcs = view.find(Modality::nnopcs)->f;
    std::vector<OracleHit> truth(160 * 120);
    parallel_for(truth.size(), 64, [&](std::size_t p) { truth[p] = oracle(scene, camera, p % 160 + 0.5, p / 160 + 0.5); });
    for (std::size_t p = 0; p < truth.size(); ++p) {
      if (truth[p].edge_pixels < 1e-4) {
        ++exempt;
        continue;
      }
      ++compared;
      REQUIRE((hits.instance[p] == no_hit) == (truth[p].instance == no_hit));
      if (truth[p].instance == no_hit) continue;
      worst_depth = std::max(worst_depth, std::abs(hits.depth[p] - truth[p].t) / truth[p].t);
      const uvec3 t = c.surface.triangles[truth[p].triangle];
      const dvec3 n = (1 - truth[p].u - truth[p].v) * dvec3(c.surface.nnopcs[t[0]]) + truth[p].u * dvec3(c.surface.nnopcs[t[1]]) +
                      truth[p].v * dvec3(c.surface.nnopcs[t[2]]);
      for (int k = 0; k < 3; ++k) worst_nnopcs = std::max(worst_nnopcs, std::abs(nnopcs.data[3 * p + k] - n[k]));
    }
  }
  MESSAGE("pixels compared ", compared, ", exempt near an edge ", exempt, ", resolved in double ", resolved, ", worst relative depth ",
          worst_depth, ", worst NNOPCS ", worst_nnopcs);
  CHECK(compared > 90000);
  CHECK(worst_depth < 1e-6);
  CHECK(worst_nnopcs < 2e-6);
}

TEST_CASE("rays through edges and vertices of a fine grid never slip through, and keep the exact depth") {
  // A plate cut into a grid whose lines pass exactly through pixel centres; and a tilted one, cut so finely that
  // Embree's float often names the neighbour.
  for (const float tilt : {0.0f, 0.37f}) {
    Surface plate;
    const int n = tilt == 0 ? 64 : 800;
    for (int j = 0; j <= n; ++j)
      for (int i = 0; i <= n; ++i) {
        plate.rest.push_back({-1 + 2.0f * i / n, -1 + 2.0f * j / n, tilt * (-1 + 2.0f * i / n)});
        plate.normals.push_back({0, 0, 1});
        plate.uvs.push_back({0, 0});
      }
    for (int j = 0; j < n; ++j)
      for (int i = 0; i < n; ++i) {
        const unsigned a = j * (n + 1) + i;
        plate.triangles.push_back({a, a + 1, a + n + 2});
        plate.triangles.push_back({a, a + n + 2, a + n + 1});
      }
    plate.materials.assign(plate.triangles.size(), 0);
    plate.parts.assign(plate.triangles.size(), 0);
    bake_nnopcs(plate, plate.rest, NnopcsNormalization::box);
    const Scene scene = scene_of({instance_of(plate, 0, 0)}, 1);
    const Accel accel(scene);
    // Pixel pitch at the plate: 1 / 64, so with an odd image every centre falls on a vertex or an edge.
    const int size = tilt == 0 ? 125 : 401;
    const Camera camera = look_at({0, 0, 10}, {0, 0, 0}, 5.12 * size, size, size);
    PixelMask all(size, size);
    all.fill();
    const FirstHits hits = trace_first_hits(scene, accel, camera, all);
    int holes = 0;
    double worst = 0;
    for (int y = 1; y < size - 1; ++y)
      for (int x = 1; x < size - 1; ++x) {
        const std::size_t p = hits.index(x, y);
        const dvec3 d = camera.direction(x + 0.5, y + 0.5);
        const double t = 10 / (1 + double(tilt) * d.x);  // the plane z = tilt x
        const bool within = std::max(std::abs(t * d.x), std::abs(t * d.y)) < 0.999;
        if (within && hits.instance[p] == no_hit) ++holes;
        if (hits.instance[p] == no_hit) continue;
        worst = std::max(worst, std::abs(hits.depth[p] - t) / t);
      }
    MESSAGE("resolved in double: ", hits.resolved);
    CHECK(holes == 0);
    CHECK(worst < 1e-6);
    CHECK(hits.resolved > 0);  // at edges of the tilted plate, at vertices of both
  }
}

TEST_CASE("the footprint holds every pixel that a ray within the filter can hit, and little more") {
  for (const int triangles : {5, 400}) {
    const Surface surface = thorny_surface(triangles, 9);
    const Scene scene = scene_of({instance_of(surface, 0, 0)}, 1);
    const Camera camera = look_at({5, 2, 1}, {0, 0, 0}, 200, 96, 72);
    const Accel accel(scene);
    const PixelMask mask = footprint(scene, camera, 1.5);
    std::mt19937 random(3);
    auto unit = [&] { return (random() >> 8) * 0x1p-24; };
    std::uint64_t hits = 0, marked_hit = 0;
    std::vector<char> hit_near(96 * 72, 0);
    for (int y = 0; y < 72; ++y)
      for (int x = 0; x < 96; ++x)
        for (int s = 0; s < 40; ++s) {
          const dvec3 d = camera.direction(x + 0.5 + 3 * (unit() - 0.5), y + 0.5 + 3 * (unit() - 0.5));
          if (!trace_precise(scene, accel, camera, d).valid()) continue;
          ++hits;
          hit_near[y * 96 + x] = 1;
          REQUIRE(mask.get(x, y));
        }
    for (char h : hit_near) marked_hit += h;
    CHECK(hits > 1000);
    CHECK(mask.count() < 1.35 * marked_hit + 50);
  }
}

TEST_CASE("coverage of a square equals its area, pixel by pixel, only outline pixels are sampled") {
  // A square at depth 10 whose borders lie at fractions of pixels.
  const Surface plate = plate_surface({-1.0f, -1.0f, 0}, {2.0f, 0, 0}, {0, 2.0f, 0});
  const Scene scene = scene_of({instance_of(plate, 0, 0)}, 1);
  const Camera camera = look_at({0, 0, 10}, {0, 0, 0}, 73, 32, 32);
  const Accel accel(scene);
  PixelMask all(32, 32);
  all.fill();
  const FirstHits hits = trace_first_hits(scene, accel, camera, all);
  const ImageF coverage = trace_coverage(scene, accel, camera, hits, 5);
  const double left = 16 - 7.3, right = 16 + 7.3;
  auto overlap = [&](int i) { return std::clamp(std::min(right, i + 1.0) - std::max(left, double(i)), 0.0, 1.0); };
  for (int y = 0; y < 32; ++y)
    for (int x = 0; x < 32; ++x) CHECK(coverage.at(x, y) == doctest::Approx(overlap(x) * overlap(y)).epsilon(0.03));
  CHECK(outlines(scene, camera).count() < 32 * 32 / 4);
}

TEST_CASE("keypoints: visible, hidden by itself, by the other animal, by scenery, outside the image") {
  const Surface ball = sphere_surface(40, 80);
  const Surface wall = plate_surface({-9, -9, -3}, {18, 0, 0}, {0, 18, 0});
  // Two balls on the x axis seen from +x; the second hides the first's front.
  std::vector<Instance> instances = {instance_of(ball, 0, 0), instance_of(ball, 1, 0, {4, 0, 0}), instance_of(wall, -1, 0)};
  const Scene scene = scene_of(std::move(instances), 2);
  const Accel accel(scene);
  const Camera front = look_at({20, 0, 0}, {0, 0, 0}, 100, 64, 64);
  const Camera side = look_at({0, 20, 0.5}, {0, 0, 0}, 100, 64, 64);
  auto see = [&](const Camera& c, int animal, const dvec3& p, double tolerance) {
    return trace_keypoint(scene, accel, c, animal, {p, tolerance});
  };
  KeypointView k = see(front, 0, {1, 0, 0}, 0.01);
  CHECK(k.visibility == Visibility::hidden);
  CHECK(k.cause == HiddenBy::other_animal);
  CHECK(k.occluder == 1);
  CHECK(k.margin == doctest::Approx(4).epsilon(1e-3));
  k = see(side, 0, {0, 0.9, 0}, 0.2);  // inside the body, within its tolerance
  CHECK(k.visibility == Visibility::visible);
  CHECK(k.cause == HiddenBy::nothing);
  CHECK(k.margin == doctest::Approx(0.1).epsilon(0.05));
  k = see(side, 0, {0, 0.9, 0}, 0.05);
  CHECK(k.visibility == Visibility::hidden);
  CHECK(k.cause == HiddenBy::self);
  k = see(side, 0, {0, -1, 0}, 0.2);
  CHECK(k.cause == HiddenBy::self);
  CHECK(k.margin == doctest::Approx(2).epsilon(1e-2));
  k = see(side, 0, {0, 0, -5}, 0.2);
  CHECK(k.cause == HiddenBy::scenery);
  CHECK(k.occluder == -1);
  k = see(side, 1, {4, 1.5, 0}, 0.0);  // hovers in front
  CHECK(k.visibility == Visibility::visible);
  CHECK(k.margin < 0);
  k = see(side, 0, {30, 0, 0}, 0);
  CHECK(k.visibility == Visibility::off_frame);
  CHECK(k.cause == HiddenBy::off_frame);
  k = see(side, 0, {0, 25, 0}, 0);  // behind the camera
  CHECK(k.visibility == Visibility::off_frame);
  CHECK(k.depth < 0);
}

TEST_CASE("occlusion: whole masks equal each animal rendered alone, and the counts add up") {
  const Surface ball = sphere_surface(40, 80);
  const Scene both = scene_of({instance_of(ball, 0, 0), instance_of(ball, 1, 0, {3, 0.8f, 0})}, 2);
  const Accel accel(both);
  const Camera camera = look_at({20, 0, 1}, {1, 0, 0}, 200, 96, 96);
  const FirstHits hits = trace_first_hits(both, accel, camera, footprint(both, camera, 0));
  View view;
  add_occlusion(view, both, accel, camera, hits);
  for (int a = 0; a < 2; ++a) {
    const Scene alone = scene_of({instance_of(ball, 0, 0, a == 0 ? vec3(0) : vec3(3, 0.8f, 0))}, 1);
    const Accel alone_accel(alone);
    const FirstHits alone_hits = trace_first_hits(alone, alone_accel, camera, footprint(alone, camera, 0));
    const ImageU32& whole = view.find(Modality::occlusion, -1, a)->u;
    std::uint64_t pixels = 0;
    for (std::size_t p = 0; p < whole.data.size(); ++p) {
      REQUIRE((whole.data[p] == 255) == (alone_hits.instance[p] != no_hit));
      pixels += whole.data[p] == 255;
    }
    const OcclusionView& o = view.occlusion[a];
    CHECK(o.whole_pixels == pixels);
    CHECK(o.whole_pixels - o.visible_pixels == o.occluded[1 - a]);
  }
  CHECK(view.occlusion[0].hidden_fraction > 0.2);
  CHECK(view.occlusion[1].hidden_fraction == 0);
}

TEST_CASE("texels below the alpha cutoff are not there, for labels and light alike") {
  const Surface plate = plate_surface({-1, -1, 0}, {2, 0, 0}, {0, 2, 0});
  Scene scene = scene_of({instance_of(plate, 0, 0)}, 1);
  auto a = std::make_shared<Appearance>(*scene.appearance);
  Texture texture;
  texture.image = Image8(2, 1, 4, 255);
  texture.image.at(0, 0, 3) = 0;  // the half with u < 0.5 is a hole
  texture.placement.wrap_u = Wrap::clamp;
  a->textures.push_back(std::make_shared<Texture>(texture));
  a->materials[0].alpha_texture = 0;
  a->materials[0].alpha_cutoff = 0.5f;
  scene.appearance = a;
  const Accel accel(scene);
  const Camera camera = look_at({0, 0, 10}, {0, 0, 0}, 100, 32, 32);
  const FirstHits hits = trace_first_hits(scene, accel, camera, footprint(scene, camera, 0));
  int left = 0, right = 0;
  for (int y = 0; y < 32; ++y)
    for (int x = 0; x < 32; ++x)
      if (hits.instance[hits.index(x, y)] != no_hit) ++(plate.uvs.empty() || camera.direction(x + 0.5, y + 0.5).x < 0 ? left : right);
  CHECK(std::min(left, right) == 0);
  CHECK(std::max(left, right) == 10 * 20);
  CHECK(accel.occluded({{0.5f, 0, 5}, 0, {0, 0, -1}}) != accel.occluded({{-0.5f, 0, 5}, 0, {0, 0, -1}}));
}

TEST_CASE("a camera inside an animal is told from one outside its body but inside its box") {
  const Surface ball = sphere_surface(20, 40);
  const Scene scene = scene_of({instance_of(ball, 0, 0)}, 1);
  const Accel accel(scene);
  CHECK(camera_is_inside(scene, accel, look_at({0.2, 0.1, 0}, {5, 0, 0}, 50, 8, 8)));
  CHECK_FALSE(camera_is_inside(scene, accel, look_at({0.9, 0.9, 0.9}, {0, 0, 0}, 50, 8, 8)));
  CHECK_FALSE(camera_is_inside(scene, accel, look_at({4, 0, 0}, {0, 0, 0}, 50, 8, 8)));
}

TEST_CASE("refit and rebuild give the same hits after the pose changed") {
  const Surface body = thorny_surface(2000, 21);
  Scene scene = scene_of({instance_of(body, 0, 0)}, 1);
  Accel refit(scene, BuildKind::refit);
  std::mt19937 random(2);
  for (vec3& p : scene.instances[0].posed.positions) p += 0.05f * vec3(float(random() >> 8) * 0x1p-24f, 0.1f, 0);
  refit.update();
  const Accel rebuilt(scene);
  const Camera camera = look_at({6, 3, 2}, {0, 0, 0}, 300, 128, 96);
  const PixelMask mask = footprint(scene, camera, 0);
  const FirstHits a = trace_first_hits(scene, refit, camera, mask), b = trace_first_hits(scene, rebuilt, camera, mask);
  CHECK(a.depth == b.depth);
  CHECK(a.instance == b.instance);
}
