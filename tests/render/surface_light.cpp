// Light held by vertices: against formulas, double integrals and the path tracer.
#include "generator/render/surface_light.h"

#include <tbb/global_control.h>

#include "generator/core/parallel.h"
#include "generator/render/path_kernel.h"
#include "tests/render/fixtures.h"
#include "tests/render/reference.h"

using namespace moomill;
using namespace moomill::test;

namespace {

// A rectangle as plate_surface() makes it, cut into n x n pairs of triangles.
Surface grid_surface(const vec3& corner, const vec3& u, const vec3& v, int n) {
  Surface s;
  const vec3 normal = glm::normalize(glm::cross(u, v));
  for (int j = 0; j <= n; ++j)
    for (int i = 0; i <= n; ++i) {
      const vec2 at = vec2(i, j) / float(n);
      s.rest.push_back(corner + at.x * u + at.y * v);
      s.normals.push_back(normal);
      s.uvs.push_back(at);
    }
  for (int j = 0; j < n; ++j)
    for (int i = 0; i < n; ++i) {
      const unsigned a = j * (n + 1) + i, b = a + n + 1;
      s.triangles.push_back({a, a + 1, b + 1});
      s.triangles.push_back({a, b + 1, b});
    }
  s.materials.assign(s.triangles.size(), 0);
  s.parts.assign(s.triangles.size(), 0);
  bake_nnopcs(s, s.rest, NnopcsNormalization::box);
  return s;
}

// A scene to be: surfaces stay where they are once they are added.
struct Stage {
  std::vector<std::unique_ptr<Surface>> surfaces;
  std::shared_ptr<Appearance> appearance = std::make_shared<Appearance>();
  Scene scene;
  Lights lights;
  std::unique_ptr<Accel> accel;

  int material(const std::vector<vec3>& coats, float specular = 0, float roughness = 1, float metallic = 0) {
    add_material(*appearance, roughness, metallic, coats);
    appearance->materials.back().specular = specular;
    return static_cast<int>(appearance->materials.size()) - 1;
  }
  void add(Surface s, int material, int animal) {
    surfaces.push_back(std::make_unique<Surface>(std::move(s)));
    scene.instances.push_back(instance_of(*surfaces.back(), animal, material));
    scene.animal_count = std::max(scene.animal_count, animal + 1);
  }
  void sky(const vec3& radiance) { lights.environment = std::make_shared<Environment>(radiance); }
  void sun() { lights.suns.push_back({glm::normalize(vec3(0.4f, -0.5f, 1)), vec3(2, 1.8f, 1.5f), 0.00465f}); }
  void ready() {
    scene.appearance = appearance;
    lights.prepare(vec3(0));
    accel = std::make_unique<Accel>(scene);
  }
  SurfaceLight gather() const { return gather_light(scene, lights, *accel); }
  Radiance picture(const Camera& camera, int samples, const SurfaceLight* light, std::uint64_t stream = 1) const {
    PathOptions o;
    o.samples = samples;
    o.stream = stream;
    o.light = light;
    PixelMask all(camera.width, camera.height);
    all.fill();
    Radiance r = trace_radiance(scene, lights, *accel, camera, all, o);
    CHECK(r.not_finite == 0);
    return r;
  }
};

// What a vertex's light is for a shading normal, one coat, green.
double looked_up(const Stage& stage, const SurfaceLight& light, std::uint32_t instance, std::uint32_t triangle, const vec3& normal, float u = 0, float v = 0) {
  kernel::Trail trail;
  kernel::note_incident(trail, light, stage.scene, {instance, triangle, u, v, 1}, normal, 1);
  double arrives = 0;
  for (int k = 0; k < 3; ++k)
    for (int j = 0; j < 4; ++j) arrives += trail.incident_weight[k][j] * trail.incident[k][(3 * j + 1) * light.padded];
  return std::max(arrives, 0.0);
}

double mean_of(const ImageF& picture) {
  double sum = 0, alpha = 0;
  for (std::size_t p = 0; p < picture.data.size(); p += 4) sum += picture.data[p + 1], alpha += picture.data[p + 3];
  return sum / alpha;
}

bool same_light(const SurfaceLight& a, const SurfaceLight& b) {
  if (a.padded != b.padded || a.instances.size() != b.instances.size()) return false;
  for (std::size_t i = 0; i < a.instances.size(); ++i)
    if (a.instances[i].incident != b.instances[i].incident || a.instances[i].outgoing != b.instances[i].outgoing) return false;
  return true;
}

// An animal of ball and plate on scenery, with a metal animal beside it; every coat of the first has its own colours.
void furnish(Stage& s, const std::vector<vec3>& coats) {
  std::vector<vec3> grey(coats.size(), vec3(0.4f)), metal(coats.size(), vec3(0.9f, 0.6f, 0.3f));
  const int animal = s.material(coats, 1, 0.5f), ground = s.material(grey), shiny = s.material(metal, 1, 0.3f, 1);
  s.add(sphere_surface(10, 20, 0.5f), animal, 0);
  s.add(grid_surface({-1, -0.8f, -0.6f}, {2, 0, 0}, {0, 1.6f, 0}, 8), animal, 0);
  s.add(grid_surface({-3, -3, -0.9f}, {6, 0, 0}, {0, 6, 0}, 2), ground, -1);
  s.add(sphere_surface(10, 20, 0.3f), shiny, 1);
  for (vec3& p : s.scene.instances.back().posed.positions) p += vec3(0.9f, -0.3f, 0.1f);
  s.sky({1, 0.8f, 0.6f});
  s.sun();
  s.ready();
}
const Camera beside = look_at({2, -4, 1.5}, {0, 0, -0.2}, 40, 32, 24);

std::vector<vec3> twelve_coats() {
  std::vector<vec3> coats;
  for (int c = 0; c < 12; ++c) coats.push_back({0.05f + 0.08f * c, 0.9f - 0.07f * c, 0.1f + 0.05f * ((5 * c) % 12)});
  return coats;
}

}  // namespace

TEST_CASE("surface light: a white ball under an even sky holds and looks up the furnace's value") {
  const vec3 radiance(1, 0.5f, 0.25f);
  for (const float specular : {0.0f, 1.0f}) {
    CAPTURE(specular);
    const float roughness = specular > 0 ? 0.5f : 1.0f;
    Stage s;
    s.add(sphere_surface(24, 48), s.material({vec3(1)}, specular, roughness), 0);
    s.sky(radiance);
    s.ready();
    const SurfaceLight light = s.gather();
    REQUIRE(light.holds(0));
    const double passed = 1 - specular * ReferenceAlbedo(roughness * roughness, false).average;
    double worst = 0, worst_out = 0, worst_between = 0;
    for (const uvec3& t : s.scene.instances[0].surface->triangles)
      for (int k = 0; k < 9; ++k) {
        const std::uint32_t v = t[k / 3];
        const int c = k % 3;
        worst = std::max(worst, std::abs(light.incident(0, v)[c * light.padded] / (pi * passed * radiance[c]) - 1));
        worst_out = std::max(worst_out, std::abs(light.outgoing(0, v)[c * light.padded] / double(radiance[c]) - 1));
      }
    // Between vertices the normal leans by up to 5.3 degrees from theirs, and what leans sees a strip of the body itself.
    for (std::uint32_t t = 0; t < s.scene.instances[0].surface->triangles.size(); ++t) {
      const uvec3 i = s.scene.instances[0].surface->triangles[t];
      const auto& n = s.scene.instances[0].posed.normals;
      const vec3 normal = glm::normalize(n[i[0]] + n[i[1]] + n[i[2]]);
      worst_between = std::max(worst_between, std::abs(looked_up(s, light, 0, t, normal, 1 / 3.0f, 1 / 3.0f) / (pi * passed * radiance.y) - 1));
    }
    MESSAGE("specular ", specular, ": incident ", worst, ", outgoing ", worst_out, ", between vertices ", worst_between);
    CHECK(worst < (specular > 0 ? 1e-4 : 1e-6));  // the table of mean albedos, rounding
    CHECK(worst_out < 1e-6);
    CHECK(worst_between < 0.004);

    const Camera camera = look_at({0, -4, 1}, {0, 0, 0}, 60, 24, 24);
    const double held = mean_of(s.picture(camera, 64, &light).coats[0]) / radiance.y, by_paths = mean_of(s.picture(camera, 256, nullptr).coats[0]) / radiance.y;
    MESSAGE("picture ", held, ", by paths ", by_paths);
    CHECK(held == doctest::Approx(1).epsilon(0.004));
    CHECK(held == doctest::Approx(by_paths).epsilon(0.006));
  }
}

TEST_CASE("surface light: what a vertex beside a wall holds, at its normal and leaning ones, is the double integral") {
  // Vertex 0 lies half a metre from a black wall, 1 m high.
  for (const float specular : {0.0f, 1.0f}) {
    CAPTURE(specular);
    const float roughness = specular > 0 ? 0.5f : 1.0f;
    Stage s;
    const int plate = s.material({vec3(0.5f)}, specular, roughness), black = s.material({vec3(0)});
    s.add(plate_surface({0.5f, 0, 0}, {1, 0, 0}, {0, 1, 0}), plate, 0);
    s.add(plate_surface({0, -1.5f, 0}, {0, 3, 0}, {0, 0, 1}), black, -1);
    s.sky(vec3(1));
    s.ready();
    const SurfaceLight light = s.gather();
    CHECK(!light.holds(1));
    const ReferenceAlbedo albedo(roughness * roughness, false);
    const auto integral = [&](const dvec3& n) {
      constexpr int rows = 400, columns = 1200;
      double sum = 0;
      for (int a = 0; a < rows; ++a)
        for (int b = 0; b < columns; ++b) {
          const double z = (a + 0.5) / rows, phi = 2 * pi * (b + 0.5) / columns, r = std::sqrt(1 - z * z);
          const dvec3 d(r * std::cos(phi), r * std::sin(phi), z);
          const double cosine = glm::dot(n, d);
          if (cosine <= 0) continue;
          if (d.x < 0) {
            const double t = -0.5 / d.x;
            if (t * d.z < 1 && std::abs(t * d.y) < 1.5) continue;
          }
          sum += cosine * (1 - specular * albedo.at(cosine));
        }
      return sum * 2 * pi / rows / columns;
    };
    if (specular == 0) {
      // The quadrature itself against Lambert's formula for a polygon (1760): half the sum of the angles its edges span, times
      // the cosines of the planes through them.
      const dvec3 corner[4] = {{-0.5, -1.5, 0}, {-0.5, -1.5, 1}, {-0.5, 1.5, 1}, {-0.5, 1.5, 0}};
      double wall = 0;
      for (int k = 0; k < 4; ++k) {
        const dvec3 a = glm::normalize(corner[k]), b = glm::normalize(corner[(k + 1) % 4]);
        wall += 0.5 * std::acos(glm::dot(a, b)) * glm::normalize(glm::cross(a, b)).z;
      }
      CHECK(integral({0, 0, 1}) == doctest::Approx(pi - std::abs(wall)).epsilon(1e-3));
    }
    double worst[5] = {};
    for (int tilt = 0; tilt < 5; ++tilt)
      for (int turn = 0; turn < (tilt > 0 ? 8 : 1); ++turn) {
        const double angle = 10 * tilt * degrees, azimuth = (turn * 45 + 10) * degrees;
        const dvec3 n(std::sin(angle) * std::cos(azimuth), std::sin(angle) * std::sin(azimuth), std::cos(angle));
        worst[tilt] = std::max(worst[tilt], std::abs(looked_up(s, light, 0, 0, vec3(n)) / integral(n) - 1));
      }
    MESSAGE("specular ", specular, ", leaning by 0 to 40 degrees: ", worst[0], " ", worst[1], " ", worst[2], " ", worst[3], " ", worst[4]);
    CHECK(worst[0] < 0.015);  // 256 rays
    CHECK(worst[1] < 0.025);
    CHECK(worst[2] < 0.03);
    CHECK(worst[3] < 0.04);  // beyond the normals that were fitted
    CHECK(worst[4] < 0.08);
  }
}

TEST_CASE("surface light: light between two white plates is that of paths within a small bias") {
  Stage s;
  const int white = s.material({vec3(0.8f)});
  s.add(grid_surface({-0.5f, -0.5f, 0}, {1, 0, 0}, {0, 1, 0}, 16), white, 0);
  s.add(grid_surface({-0.5f, -0.5f, 0.5f}, {0, 1, 0}, {1, 0, 0}, 16), white, 1);
  s.sky(vec3(1));
  s.ready();
  const SurfaceLight light = s.gather();
  for (const dvec3 eye : {dvec3(0.3, -1.6, 0.4), dvec3(-1.2, 0.4, 0.1)}) {
    const Camera camera = look_at(eye, {0, 0, 0.2}, 20, 20, 20);
    // Independent runs give the scatter of what the paths say.
    double sum = 0, sum2 = 0;
    constexpr int runs = 8;
    for (int run = 0; run < runs; ++run) {
      const double m = mean_of(s.picture(camera, 256, nullptr, 100 + run).coats[0]);
      sum += m, sum2 += m * m;
    }
    const double by_paths = sum / runs, error = std::sqrt(std::max(0.0, sum2 / runs - by_paths * by_paths) / (runs - 1));
    const double held = mean_of(s.picture(camera, 64, &light).coats[0]);
    MESSAGE(held, ", by paths ", by_paths, " +- ", error, ", bias ", held / by_paths - 1);
    CHECK(error < 0.001 * by_paths);
    CHECK(held == doctest::Approx(by_paths).epsilon(0.005));
  }
}

TEST_CASE("surface light: a spherical well is lit as its series of reflections says") {
  // From anywhere on a sphere's inside any part of it fills the same share of the cosine-weighted hemisphere, its area over the sphere's.
  // So under an even sky of 1 a well that is closed to the share c holds E / pi = (1 - c) (1 + q + q^2 + ...), q = c albedo, everywhere; the
  // gathered light has the first 7 terms.
  struct Setup {
    int open_rows;  // of 24
    float albedo;
    double left_out;  // what of the whole series the first terms lack
  };
  for (const Setup& setup : {Setup{12, 0.8f, 0.002}, Setup{8, 0.8f, 0.03}, Setup{8, 1.0f, 0.15}}) {
    CAPTURE(setup.open_rows);
    CAPTURE(setup.albedo);
    Stage s;
    Surface well = sphere_surface(24, 48, 1, true);
    std::erase_if(well.triangles, [&](const uvec3& t) {
      const float z = std::max({well.rest[t[0]].z, well.rest[t[1]].z, well.rest[t[2]].z});
      return z > std::cos(pi * setup.open_rows / 24) + 1e-3;
    });
    well.materials.resize(well.triangles.size());
    well.parts.resize(well.triangles.size());
    const std::vector<uvec3> triangles = well.triangles;
    s.add(std::move(well), s.material({vec3(setup.albedo)}), 0);
    s.sky(vec3(1));
    s.ready();
    const SurfaceLight light = s.gather();
    const double closed = 0.5 * (1 + std::cos(pi * setup.open_rows / 24)), q = closed * setup.albedo;
    const double whole = (1 - closed) / (1 - q), first = whole * (1 - std::pow(q, 7));
    CHECK(1 - first / whole < setup.left_out);
    double sum = 0, worst = 0;
    for (const uvec3& t : triangles)
      for (int k = 0; k < 3; ++k) {
        const double e = light.incident(0, t[k])[light.padded] / pi;
        sum += e;
        worst = std::max(worst, std::abs(e / first - 1));
      }
    const double mean = sum / (3.0 * triangles.size());
    MESSAGE("closed ", closed, ", albedo ", setup.albedo, ": ", mean, ", 7 terms ", first, ", all ", whole, "; worst vertex ", worst);
    CHECK(mean == doctest::Approx(first).epsilon(0.005));
    CHECK(worst < 0.04);  // 256 rays
  }
}

TEST_CASE("surface light: suns and bright parts of maps count in what is thrown back, not in what is held") {
  Stage s;
  const int plate = s.material({vec3(0.5f)}), black = s.material({vec3(0)});
  s.add(plate_surface({0.5f, 0, 0}, {8, 0, 0}, {0, 1, 0}), plate, 0);
  s.add(plate_surface({0, -1.5f, 0}, {0, 3, 0}, {0, 0, 1}), black, -1);
  const vec3 direction = glm::normalize(vec3(-1, 0, 1));  // so that the wall's shadow ends 1 m off it
  s.lights.suns.push_back({direction, vec3(3), 0});
  s.sky(vec3(0));
  s.ready();
  const SurfaceLight sun = s.gather();
  // Vertices 0 and 3 lie in shadow, 1 and 2 in the open.
  for (std::uint32_t v = 0; v < 4; ++v) {
    CHECK(sun.incident(0, v)[sun.padded] == 0);
    CHECK(sun.outgoing(0, v)[sun.padded] == doctest::Approx(v == 0 || v == 3 ? 0 : 0.5 * 3 * direction.z / pi).epsilon(1e-3));
  }
  s.lights = {};
  ImageF lamp(64, 32, 3, 0.0f);
  for (int c = 0; c < 3; ++c) lamp.at(20, 4, c) = 100.0f;
  s.lights.environment = std::make_shared<Environment>(lamp, "test", 1.0f, 0.3);
  s.ready();
  const SurfaceLight map = s.gather();
  for (std::uint32_t v = 0; v < 4; ++v) CHECK(map.incident(0, v)[map.padded] < 1e-3f);
  const double theta = 4.5 * pi / 32, pixel = 2 * pi / 64 * (std::cos(4 * pi / 32) - std::cos(5 * pi / 32));
  CHECK(map.outgoing(0, 2)[map.padded] == doctest::Approx(0.5 * 100 * pixel * std::cos(theta) / pi).epsilon(0.02));
  // An even map is an even sky.
  s.lights.environment = std::make_shared<Environment>(ImageF(8, 4, 3, 2.0f), "test", 1.0f, 0.3);
  s.ready();
  const SurfaceLight even_map = s.gather();
  s.sky(vec3(2));
  s.ready();
  const SurfaceLight even = s.gather();
  for (std::uint32_t v = 0; v < 4; ++v) {
    CHECK(even.incident(0, v)[even.padded] > 1);
    CHECK(even_map.incident(0, v)[even.padded] == doctest::Approx(even.incident(0, v)[even.padded]));
    CHECK(even_map.outgoing(0, v)[even.padded] == doctest::Approx(even.outgoing(0, v)[even.padded]));
  }

  // All together, in every coat, against paths: under an even sky, and under a map with a soft part and a bright one.
  for (const bool under_map : {false, true}) {
    Stage all;
    furnish(all, twelve_coats());
    if (under_map) {
      ImageF sky(32, 16, 3);
      for (int y = 0; y < 16; ++y)
        for (int x = 0; x < 32; ++x)
          for (int c = 0; c < 3; ++c) sky.at(x, y, c) = (y == 5 && x == 20 ? 30.0f : 0.4f + 0.02f * static_cast<float>(16 - y)) * (1 - 0.2f * c);
      all.lights.environment = std::make_shared<Environment>(sky, "test", 1.0f, 0.3);
      all.ready();
      REQUIRE(all.lights.environment->has_bright_part());
      REQUIRE(all.lights.environment->soft_around(vec3(0, 0, 1)).x > 0.5f);
    }
    const SurfaceLight light = all.gather();
    const Radiance held = all.picture(beside, 256, &light), by_paths = all.picture(beside, 1024, nullptr, 2);
    double worst = 0;
    for (int c = 0; c < 12; ++c) worst = std::max(worst, std::abs(mean_of(held.coats[c]) / mean_of(by_paths.coats[c]) - 1));
    MESSAGE("ball, plates, metal and sun", std::string(under_map ? " under a map" : ""), ", worst of 12 coats: ", worst);
    CHECK(worst < 0.01);
  }
}

TEST_CASE("surface light: same bits for a coat alone and in a batch, and on any number of threads") {
  const std::vector<vec3> coats = twelve_coats();
  Stage all;
  furnish(all, coats);
  const SurfaceLight light = all.gather();
  const Radiance together = all.picture(beside, 8, &light);
  REQUIRE(together.coats[0].data != together.coats[11].data);
  const auto held_alike = [&](const Stage& some, const SurfaceLight& of, int coat, int first) {
    for (std::size_t i = 0; i < of.instances.size(); ++i) {
      if (!of.holds(i)) continue;
      const std::size_t vertices = some.scene.instances[i].posed.positions.size();
      for (std::size_t v = 0; v < vertices; ++v) {
        for (int c = 0; c < 12; ++c)
          if (of.incident(i, v)[c * of.padded + first] != light.incident(i, v)[c * light.padded + coat]) return false;
        for (int c = 0; c < 3; ++c)
          if (of.outgoing(i, v)[c * of.padded + first] != light.outgoing(i, v)[c * light.padded + coat]) return false;
      }
    }
    return true;
  };
  for (const int coat : {0, 5, 11}) {
    CAPTURE(coat);
    Stage alone;
    furnish(alone, {coats[coat]});
    const SurfaceLight own = alone.gather();
    CHECK(held_alike(alone, own, coat, 0));
    CHECK(alone.picture(beside, 8, &own).coats[0].data == together.coats[coat].data);
  }
  Stage few;
  furnish(few, {coats[7], coats[2]});
  const SurfaceLight two = few.gather();
  CHECK(held_alike(few, two, 2, 1));
  CHECK(few.picture(beside, 8, &two).coats[1].data == together.coats[2].data);

  for (const int threads : {1, 2}) {
    CAPTURE(threads);
    tbb::global_control control(tbb::global_control::max_allowed_parallelism, threads);
    const SurfaceLight again = all.gather();
    CHECK(same_light(again, light));
    const Radiance r = all.picture(beside, 8, &again);
    for (int c = 0; c < 12; ++c) CHECK(r.coats[c].data == together.coats[c].data);
    CHECK(sky_shares(all.scene, *all.accel) == sky_shares(all.scene, *all.accel));
  }
}

TEST_CASE("surface light: metal and scenery hold none, and without a holder paths give the same bits") {
  Stage s;
  furnish(s, {vec3(0.7f)});
  const SurfaceLight light = s.gather();
  CHECK(light.holds(0));
  CHECK(light.holds(1));
  CHECK(!light.holds(2));
  CHECK(!light.holds(3));
  CHECK(s.picture(beside, 8, &light).coats[0].data != s.picture(beside, 8, nullptr).coats[0].data);

  Stage none;
  const int grey = none.material({vec3(0.5f)}), metal = none.material({vec3(0.9f)}, 1, 0.4f, 1), half = none.material({vec3(0.6f)}, 1, 0.6f, 0.01f);
  none.add(sphere_surface(10, 20, 0.5f), metal, 0);
  none.add(grid_surface({-1, -1, -0.6f}, {2, 0, 0}, {0, 2, 0}, 4), grey, -1);
  none.add(grid_surface({-1, 0.8f, -0.6f}, {2, 0, 0}, {0, 0, 1}, 4), half, 1);
  none.sky({1, 0.8f, 0.6f});
  none.sun();
  none.ready();
  const SurfaceLight nothing = none.gather();
  for (int i = 0; i < 3; ++i) CHECK(!nothing.holds(i));
  CHECK(none.picture(beside, 8, &nothing).coats[0].data == none.picture(beside, 8, nullptr).coats[0].data);
}

TEST_CASE("surface light: the back of a surface looks nothing up") {
  Stage s;
  s.add(grid_surface({-1, -1, 0}, {0, 2, 0}, {2, 0, 0}, 4), s.material({vec3(0.7f)}), 0);  // its front looks down
  s.sky({1, 0.8f, 0.6f});
  s.sun();
  s.ready();
  const SurfaceLight light = s.gather();
  REQUIRE(light.holds(0));
  const Camera above = look_at({0.5, -2, 3}, {0, 0, 0}, 30, 24, 24), below = look_at({0.5, -2, -3}, {0, 0, 0}, 30, 24, 24);
  CHECK(s.picture(above, 8, &light).coats[0].data == s.picture(above, 8, nullptr).coats[0].data);
  CHECK(s.picture(below, 8, &light).coats[0].data != s.picture(below, 8, nullptr).coats[0].data);
}

TEST_CASE("surface light: gathering meets the back of a surface as paths do") {
  // Under a roof whose front, bright in the sky, looks up: only its back is seen from the floor.
  Stage s;
  const int matt = s.material({vec3(0.8f)});
  s.add(grid_surface({-0.5f, -0.5f, 0}, {1, 0, 0}, {0, 1, 0}, 16), matt, 0);
  s.add(grid_surface({-0.5f, -0.5f, 0.3f}, {1, 0, 0}, {0, 1, 0}, 16), matt, 0);
  s.sky(vec3(1));
  s.ready();
  const SurfaceLight light = s.gather();
  const Camera camera = look_at({0.3, -1.6, 0.25}, {0, 0, 0.05}, 30, 24, 16);
  const double held = mean_of(s.picture(camera, 256, &light).coats[0]), by_paths = mean_of(s.picture(camera, 1024, nullptr).coats[0]);
  MESSAGE(held, ", by paths ", by_paths);
  CHECK(held == doctest::Approx(by_paths).epsilon(0.02));
}

TEST_CASE("surface light: vertices without a normal leave no hole") {
  Stage s;
  Surface ball = sphere_surface(16, 32);
  for (std::size_t v = 0; v < ball.normals.size(); v += 7) ball.normals[v] = vec3(0);  // as cancelling faces leave them
  s.add(std::move(ball), s.material({vec3(0.8f)}), 0);
  s.sky(vec3(1));
  s.ready();
  const SurfaceLight light = s.gather();
  const Camera camera = look_at({0, -4, 1}, {0, 0, 0}, 60, 24, 24);
  const double held = mean_of(s.picture(camera, 64, &light).coats[0]), by_paths = mean_of(s.picture(camera, 64, nullptr).coats[0]);
  MESSAGE(held, ", by paths ", by_paths);
  CHECK(held == doctest::Approx(by_paths).epsilon(0.02));
}

TEST_CASE("sky shares: all of the sky for a ball, the form factor for the floor of a well") {
  Stage s;
  const int white = s.material({vec3(1)});
  s.add(sphere_surface(12, 24), white, 0);
  s.ready();
  const SkyShares open = sky_shares(s.scene, *s.accel);
  for (const float share : open[0]) CHECK(share == 1.0f);

  // Of the floor's middle through the opening, a square of side 2 a at height h: 4 x (differential element to a rectangle
  // with a corner above it) = (4 / pi) (a / sqrt(a^2 + h^2)) atan(a / sqrt(a^2 + h^2)). Here a = h = 1.
  Stage well;
  const int grey = well.material({vec3(1)});
  well.add(grid_surface({-1, -1, 0}, {2, 0, 0}, {0, 2, 0}, 64), grey, 0);
  well.add(plate_surface({-1, -1, 0}, {0, 2, 0}, {0, 0, 1}), grey, -1);
  well.add(plate_surface({1, 1, 0}, {0, -2, 0}, {0, 0, 1}), grey, -1);
  well.add(plate_surface({1, -1, 0}, {-2, 0, 0}, {0, 0, 1}), grey, -1);
  well.add(plate_surface({-1, 1, 0}, {2, 0, 0}, {0, 0, 1}), grey, -1);
  well.ready();
  const SkyShares shares = sky_shares(well.scene, *well.accel);
  const double root = std::sqrt(0.5), expected = 4 / pi * root * std::atan(root);
  double mean = 0, worst = 0;
  int count = 0;
  for (std::size_t v = 0; v < shares[0].size(); ++v) {
    const vec3 p = well.scene.instances[0].posed.positions[v];
    if (std::max(std::abs(p.x), std::abs(p.y)) > 0.1f) continue;
    mean += shares[0][v];
    worst = std::max(worst, std::abs(shares[0][v] - expected));
    ++count;
  }
  mean /= count;
  MESSAGE("well: ", mean, " of ", count, " vertices, expected ", expected, ", worst of 16 rays ", worst);
  CHECK(mean == doctest::Approx(expected).epsilon(0.02));
  CHECK(worst < 0.2);

  // Not a share of the sky: a lid closes it.
  well.add(plate_surface({-1, -1, 1}, {0, 2, 0}, {2, 0, 0}), grey, -1);
  well.ready();
  const SkyShares closed = sky_shares(well.scene, *well.accel);
  double most = 0;
  for (std::size_t v = 0; v < closed[0].size(); ++v) {
    const vec3 p = well.scene.instances[0].posed.positions[v];
    if (std::max(std::abs(p.x), std::abs(p.y)) < 0.99f) most = std::max<double>(most, closed[0][v]);
  }
  CHECK(most == 0);
}
