// The path tracer against an independent integrator: double precision, brute-force intersection, uniform directions,
// no importance sampling, no tables from the code under test.
#include <tbb/global_control.h>

#include "generator/core/parallel.h"
#include "tests/render/fixtures.h"
#include "tests/render/reference.h"

using namespace moomill;
using namespace moomill::test;

namespace {

struct Finish {
  ReferenceFinish model;
  dvec3 base;
  Finish(double roughness, double metallic, dvec3 base_) : model(roughness, metallic), base(base_) {}
  dvec3 evaluate(const dvec3& wo, const dvec3& wi) const { return model.evaluate(wo, wi, base); }
};

struct World {
  const Scene* scene;
  const Lights* lights;
  std::vector<const Finish*> finishes;  // per material
};

dvec3 emitted(const World& w, const dvec3& from, const dvec3& d, double surface) {
  dvec3 sum(0);
  if (std::isinf(surface)) {
    sum += dvec3(w.lights->environment->radiance(vec3(d)));
    for (const Sun& s : w.lights->suns)
      if (glm::dot(d, dvec3(s.direction)) > std::cos(double(s.angular_radius))) sum += dvec3(s.radiance());
  }
  for (const RectangleLight& r : w.lights->rectangles) {
    const dvec3 n = glm::cross(dvec3(r.edge_u), dvec3(r.edge_v));
    const double facing = glm::dot(d, n);
    if (facing >= 0) continue;
    const double t = glm::dot(dvec3(r.corner) - from, n) / facing;
    if (t <= 0 || t >= surface) continue;
    const dvec3 p = from + t * d - dvec3(r.corner);
    const double a = glm::dot(p, dvec3(r.edge_u)) / glm::dot(dvec3(r.edge_u), dvec3(r.edge_u));
    const double b = glm::dot(p, dvec3(r.edge_v)) / glm::dot(dvec3(r.edge_v), dvec3(r.edge_v));
    if (a >= 0 && a <= 1 && b >= 0 && b <= 1) sum += dvec3(r.radiance);
  }
  return sum;
}

struct BruteHit {
  double t = std::numeric_limits<double>::infinity();
  dvec3 normal{0};
  int material = -1;
};
BruteHit brute(const World& w, const dvec3& o, const dvec3& d) {
  BruteHit best;
  for (const Instance& in : w.scene->instances)
    for (std::size_t k = 0; k < in.surface->triangles.size(); ++k) {
      const uvec3 t = in.surface->triangles[k];
      const dvec3 a(in.posed.positions[t[0]]), b(in.posed.positions[t[1]]), c(in.posed.positions[t[2]]);
      const double det = glm::determinant(dmat3(a - b, a - c, d));
      const double beta = glm::determinant(dmat3(a - o, a - c, d)) / det, gamma = glm::determinant(dmat3(a - b, a - o, d)) / det;
      const double dist = glm::determinant(dmat3(a - b, a - c, a - o)) / det;
      if (beta >= 0 && gamma >= 0 && beta + gamma <= 1 && dist > 1e-6 && dist < best.t) {
        best.t = dist;
        best.normal = glm::normalize(glm::cross(b - a, c - a));
        best.material = in.materials[0];
      }
    }
  return best;
}

// One sample of the radiance along a ray.
dvec3 brute_radiance(const World& w, dvec3 o, dvec3 d, std::mt19937_64& random, bool camera_ray) {
  auto unit = [&] { return (random() >> 11) * 0x1p-53; };
  dvec3 throughput(1), sum(0);
  for (int depth = 0; depth < 40; ++depth) {
    const BruteHit hit = brute(w, o, d);
    if (!camera_ray || depth > 0) sum += throughput * emitted(w, o, d, hit.t);
    if (std::isinf(hit.t)) break;
    const dvec3 n = glm::dot(hit.normal, d) < 0 ? hit.normal : -hit.normal;
    const Frame frame{vec3(n)};
    auto local = [&](const dvec3& v) { return dvec3(glm::dot(v, dvec3(frame.x)), glm::dot(v, dvec3(frame.y)), glm::dot(v, n)); };
    const double z = unit(), phi = 2 * pi * unit(), s = std::sqrt(1 - z * z);
    const dvec3 wi(s * std::cos(phi), s * std::sin(phi), z);
    throughput *= w.finishes[hit.material]->evaluate(local(-d), wi) * z * 2.0 * pi;
    o = o + hit.t * d;
    d = glm::normalize(wi.x * dvec3(frame.x) + wi.y * dvec3(frame.y) + wi.z * n);
    if (depth > 4) {
      if (unit() > 0.7) break;
      throughput /= 0.7;
    }
  }
  return sum;
}

struct Stage {
  Surface floor = plate_surface({-2, -2, 0}, {4, 0, 0}, {0, 4, 0});
  Surface wall = plate_surface({-2, 1, 0}, {4, 0, 0}, {0, 0, 2});
  Surface roof = plate_surface({-0.6f, -0.4f, 0.9f}, {0, 1.2f, 0.2f}, {1.3f, 0, 0.1f});
  Scene scene;
  Lights lights;
  Stage(double roughness, double metallic, const vec3& base) {
    auto a = std::make_shared<Appearance>();
    add_material(*a, 0.8f, 0, {vec3(0.6f, 0.5f, 0.4f)});
    add_material(*a, float(roughness), float(metallic), {base});
    scene.appearance = a;
    scene.instances = {instance_of(floor, 0, 1), instance_of(wall, 0, 0), instance_of(roof, 0, 0)};
    scene.animal_count = 1;
  }
};

}  // namespace

TEST_CASE("radiance agrees with an independent brute-force integrator: z-test per pixel and light") {
  const Camera camera = look_at({1.5, -4, 2.2}, {0, 0, 0.4}, 14, 12, 9);
  struct Setup {
    const char* name;
    double roughness, metallic;
    vec3 base;
    int light;  // 0 constant, 1 map, 2 sun, 3 rectangle, 4 all
  };
  const Setup setups[] = {{"constant, diffuse", 1.0, 0, vec3(0.7f, 0.3f, 0.1f), 0},
                          {"constant, glossy metal", 0.4, 1, vec3(0.9f, 0.6f, 0.3f), 0},
                          {"map, rough dielectric", 0.6, 0, vec3(0.5f), 1},
                          {"sun, glossy dielectric", 0.45, 0, vec3(0.2f, 0.4f, 0.6f), 2},
                          {"rectangle, half metal", 0.5, 0.5, vec3(0.8f, 0.7f, 0.2f), 3},
                          {"everything", 0.5, 0.2, vec3(0.4f, 0.5f, 0.6f), 4}};
  for (const Setup& s : setups) {
    Stage stage(s.roughness, s.metallic, s.base);
    Lights& l = stage.lights;
    if (s.light == 0) l.environment = std::make_shared<Environment>(vec3(1.0f, 0.8f, 0.6f));
    if (s.light == 1 || s.light == 4) {
      ImageF map(8, 4, 3, 0.3f);
      map.at(2, 1, 0) = 6, map.at(5, 0, 2) = 5;
      l.environment = std::make_shared<Environment>(map, "test", 1.0f, 0.3);
    }
    if (s.light == 2 || s.light == 4) {
      Sun sun;
      sun.direction = glm::normalize(vec3(0.5f, -1, 1.2f));
      sun.angular_radius = 0.35f;  // wide, so that brute force finds it
      sun.irradiance = {2, 1.8f, 1.5f};
      l.suns.push_back(sun);
    }
    if (s.light >= 3) {
      RectangleLight r;
      r.corner = {-1.5f, -1.5f, 1.8f};
      r.edge_u = {0, 1.5f, 0};
      r.edge_v = {1.5f, 0, 0};
      r.radiance = {4, 5, 6};
      REQUIRE(r.normal().z < 0);
      l.rectangles.push_back(r);
    }
    l.prepare(vec3(0));

    const Finish wall(0.8, 0, {0.6, 0.5, 0.4}), floor(s.roughness, s.metallic, dvec3(s.base));
    const World world{&stage.scene, &l, {&wall, &floor}};
    const Accel accel(stage.scene);
    PixelMask all(12, 9);
    all.fill();
    const SkyShares sky = sky_shares(stage.scene, accel);
    // Independent runs give the variance of our mean.
    constexpr int runs = 16;
    std::vector<dvec3> ours(12 * 9, dvec3(0)), ours2(12 * 9, dvec3(0));
    std::vector<dvec3> run_sum(runs, dvec3(0));
    for (int run = 0; run < runs; ++run) {
      PathOptions o;
      o.samples = 256;
      o.stream = 1000 + run;
      o.sky = &sky;
      const Radiance r = trace_radiance(stage.scene, l, accel, camera, all, o);
      CHECK(r.not_finite == 0);
      for (int p = 0; p < 12 * 9; ++p) {
        const dvec3 v(r.coats[0].data[4 * p], r.coats[0].data[4 * p + 1], r.coats[0].data[4 * p + 2]);
        ours[p] += v / double(runs);
        ours2[p] += v * v / double(runs);
        run_sum[run] += v;
      }
    }
    std::vector<double> z_values(12 * 9 * 3);
    dvec3 sum_ours(0), sum_brute(0), sum_brute_variance(0), sum_ours_variance(0);
    std::vector<dvec3> brute_mean(12 * 9), brute_error(12 * 9);
    parallel_for(12 * 9, 1, [&](std::size_t p) {
      std::mt19937_64 random(p * 7919 + 13);
      // Even over the filter's square and weighted: drawn from the window, its tails would hardly ever be looked at, and an edge
      // that only they reach would seem to have no error.
      const auto window = [](double u) {
        return (0.35875 - 0.48829 * std::cos(2 * pi * u) + 0.14128 * std::cos(4 * pi * u) - 0.01168 * std::cos(6 * pi * u)) / 0.35875;
      };
      dvec3 sum(0), sum2(0);
      constexpr int n = 12000;
      const int x = static_cast<int>(p % 12), y = static_cast<int>(p / 12);
      for (int i = 0; i < n; ++i) {
        const double ux = (random() >> 11) * 0x1p-53, uy = (random() >> 11) * 0x1p-53;
        const dvec3 d = glm::normalize(camera.direction(x + 0.5 + 1.5 * (2 * ux - 1), y + 0.5 + 1.5 * (2 * uy - 1)));
        // What the camera sees directly of the sky and lights is not part of the animal.
        const dvec3 v = window(ux) * window(uy) * brute_radiance(world, camera.centre, d, random, true);
        sum += v;
        sum2 += v * v;
      }
      brute_mean[p] = sum / double(n);
      brute_error[p] = (sum2 / double(n) - brute_mean[p] * brute_mean[p]) / double(n);
    });
    double chi = 0;
    int tests = 0, beyond = 0;
    for (int p = 0; p < 12 * 9; ++p)
      for (int k = 0; k < 3; ++k) {
        const double variance = brute_error[p][k] + (ours2[p][k] - ours[p][k] * ours[p][k]) / (runs - 1);
        if (variance <= 0) continue;
        const double z = (ours[p][k] - brute_mean[p][k]) / std::sqrt(variance);
        chi += z * z;
        ++tests;
        beyond += std::abs(z) > 5;
        sum_ours[k] += ours[p][k];
        sum_brute[k] += brute_mean[p][k];
        sum_brute_variance[k] += brute_error[p][k];
      }
    INFO(std::string(s.name));
    MESSAGE(std::string(s.name), ": mean squared z ", chi / tests, " over ", tests, ", sums ", sum_ours[0], " / ", sum_brute[0]);
    REQUIRE(tests > 100);
    CHECK(beyond == 0);
    CHECK(chi / tests < 1.6);  // channels share samples, so the mean of z^2 scatters more than a plain chi-squared
    // The whole picture: pixels of ours are correlated, so its variance is that of the runs' sums.
    for (const dvec3& r : run_sum) sum_ours_variance += (r - sum_ours) * (r - sum_ours) / double(runs * (runs - 1));
    for (int k = 0; k < 3; ++k) CHECK(std::abs(sum_ours[k] - sum_brute[k]) < 4.5 * std::sqrt(sum_brute_variance[k] + sum_ours_variance[k]));
  }
}

TEST_CASE("white furnace in a scene: a white ball in a white world disappears") {
  const Surface ball = sphere_surface(160, 320);
  for (const float roughness : {0.1f, 0.5f, 1.0f})
    for (const float metallic : {0.0f, 1.0f}) {
      Scene scene;
      auto a = std::make_shared<Appearance>();
      add_material(*a, roughness, metallic, {vec3(1.0f)});
      scene.appearance = a;
      scene.instances = {instance_of(ball, 0, 0)};
      Lights lights;
      lights.environment = std::make_shared<Environment>(vec3(1.0f));
      lights.prepare(vec3(0));
      const Accel accel(scene);
      const Camera camera = look_at({8, 0, 0}, {0, 0, 0}, 90, 16, 16);
      PixelMask all(16, 16);
      all.fill();
      PathOptions o;
      o.samples = 1024;
      o.environment_visible = true;
      const Radiance r = trace_radiance(scene, lights, accel, camera, all, o);
      double sum = 0;
      for (int p = 0; p < 256; ++p) sum += r.coats[0].data[4 * p + 1] / 256;
      CAPTURE(roughness);
      CAPTURE(metallic);
      CHECK(sum == doctest::Approx(1).epsilon(0.005));
    }
}

TEST_CASE("green of a normal map leans the surface towards -v, as glTF has it, also where the UVs are mirrored") {
  for (const bool mirrored : {false, true}) {
    Surface plate = plate_surface({-1, -1, 0}, {2, 0, 0}, {0, 2, 0});
    for (std::size_t i = 0; i < plate.rest.size(); ++i) {
      const vec2 uv = 0.5f * vec2(plate.rest[i]) + 0.5f;  // v along +y
      plate.uvs[i] = {mirrored ? 1 - uv.x : uv.x, uv.y};
    }
    Scene scene;
    auto a = std::make_shared<Appearance>();
    add_material(*a, 1, 0, {vec3(0.8f)});
    Texture map;
    map.image = Image8(2, 2, 3);
    for (std::size_t i = 0; i < map.image.data.size(); i += 3) {
      map.image.data[i] = 128;
      map.image.data[i + 1] = map.image.data[i + 2] = 218;  // (0, 0.71, 0.71): 45 degrees
    }
    a->textures.push_back(std::make_shared<Texture>(map));
    a->materials[0].normal_texture = 0;
    scene.appearance = a;
    scene.instances = {instance_of(plate, 0, 0)};
    const Accel accel(scene);
    const Camera camera = look_at({0, 0.001, 6}, {0, 0, 0}, 90, 16, 16);
    PixelMask all(16, 16);
    all.fill();
    PathOptions o;
    o.samples = 16;
    const auto lit_from = [&](float y) {
      Lights lights;
      lights.environment = std::make_shared<Environment>(vec3(0.0f));
      lights.suns.push_back({glm::normalize(vec3(0, y, 1)), vec3(1), 0.01f});
      lights.prepare(vec3(0));
      const Radiance r = trace_radiance(scene, lights, accel, camera, all, o);
      double sum = 0;
      for (int p = 0; p < 256; ++p) sum += r.coats[0].data[4 * p + 1];
      return sum;
    };
    CAPTURE(mirrored);
    CHECK(lit_from(-1) > 1);
    CHECK(lit_from(-1) > 10 * lit_from(1));  // the leaning surface faces one sun and sees the other edge on
  }
}

TEST_CASE("a coat alone equals the same coat in a batch of twelve and of any other size, bit for bit, on one thread and on two") {
  const Surface ball = sphere_surface(30, 60);
  std::mt19937 random(1);
  std::vector<Image8> textures;
  for (int t = 0; t < most_coats; ++t) {
    Image8 im(64, 32, 3);
    for (auto& v : im.data) v = static_cast<std::uint8_t>(random());
    textures.push_back(im);
  }
  auto render = [&](std::vector<int> coats, bool stacked, int threads) {
    tbb::global_control control(tbb::global_control::max_allowed_parallelism, threads);
    auto a = std::make_shared<Appearance>();
    Material m;
    m.roughness = 0.5f;
    m.paint = 0;
    a->materials = {m};
    a->coat_count = static_cast<int>(coats.size());
    Paint p;
    std::vector<const Image8*> images;
    for (int c : coats) {
      p.coats.push_back({vec3(1), stacked ? -1 : int(a->textures.size()), false});
      if (!stacked) a->textures.push_back(std::make_shared<Texture>(Texture{textures[c], {}}));
      images.push_back(&textures[c]);
    }
    if (stacked) build_stack(p, images);
    a->paints = {std::make_shared<Paint>(p)};
    Scene scene;
    scene.appearance = a;
    scene.instances = {instance_of(ball, 0, 0)};
    Lights lights;
    lights.environment = std::make_shared<Environment>(vec3(0.5f));
    lights.suns.push_back({glm::normalize(vec3(1, 1, 1)), vec3(2), 0.01f});
    lights.prepare(vec3(0));
    const Accel accel(scene);
    const Camera camera = look_at({6, 1, 1}, {0, 0, 0}, 60, 24, 24);
    PathOptions o;
    o.samples = 12;
    return trace_radiance(scene, lights, accel, camera, footprint(scene, camera, o.filter_radius), o);
  };
  std::vector<int> all(12);
  for (int i = 0; i < 12; ++i) all[i] = i;
  const Radiance batch = render(all, true, 2);
  for (int c : {0, 5, 11}) {
    CHECK(render({c}, true, 1).coats[0].data == batch.coats[c].data);
    CHECK(render({c}, false, 2).coats[0].data == batch.coats[c].data);
  }
  CHECK(render({3, 7}, true, 1).coats[1].data == batch.coats[7].data);
  CHECK(batch.coats[0].data != batch.coats[1].data);
  const Radiance single = render(all, true, 1);
  for (int c = 0; c < 12; ++c) CHECK(single.coats[c].data == batch.coats[c].data);
  // Other sizes, in another order: every padding, with and without lanes to spare.
  for (const int n : {7, 8, 9, 17, 32, 40, 64, 101, most_coats}) {
    std::vector<int> turned(n);
    for (int i = 0; i < n; ++i) turned[i] = (i + n - 5) % n;
    const Radiance more = render(turned, n != 40, 2);
    CAPTURE(n);
    for (int i = 0; i < n; ++i)
      if (turned[i] < 12) CHECK(more.coats[i].data == batch.coats[turned[i]].data);
  }
}

TEST_CASE("a target error is met, by samples that no coat has a say in") {
  const Surface ball = sphere_surface(40, 80), plate = plate_surface({-1.5f, -1.5f, -0.7f}, {3, 0, 0}, {0, 3, 0});
  auto render = [&](const std::vector<vec3>& coats, double target, int samples, std::uint64_t stream) {
    auto a = std::make_shared<Appearance>();
    add_material(*a, 0.7f, 0, coats);
    Scene scene;
    scene.appearance = a;
    scene.instances = {instance_of(ball, 0, 0), instance_of(plate, 0, 0)};  // in each other's shadow
    Lights lights;
    lights.environment = std::make_shared<Environment>(vec3(0.4f));
    lights.suns.push_back({glm::normalize(vec3(1, 0.3f, 1)), vec3(2), 0.05f});
    lights.prepare(vec3(0));
    const Accel accel(scene);
    const SkyShares sky = sky_shares(scene, accel);
    const Camera camera = look_at({5, 1, 1}, {0, 0, 0}, 70, 64, 64);
    PathOptions o;
    o.samples = samples;
    o.target_error = target;
    o.stream = stream;
    o.sky = &sky;
    return trace_radiance(scene, lights, accel, camera, footprint(scene, camera, o.filter_radius), o);
  };
  const std::vector<vec3> coats = {vec3(1), vec3(0.5f, 0.2f, 0.1f), vec3(0.03f)};
  const Radiance reference = render(coats, 0, 4096, 1);
  std::uint64_t last = 0;
  for (const double target : {0.025, 0.01}) {  // where more than a few samples are needed; of fewer the pilot says less
    double worst = 0;
    constexpr int runs = 4;
    std::uint64_t paths = 0;
    std::vector<double> error(coats.size(), 0.0);
    for (int run = 0; run < runs; ++run) {
      const Radiance r = render(coats, target, 1, 100 + run);
      paths += r.paths / runs;
      for (std::size_t c = 0; c < coats.size(); ++c) {
        double sum = 0, n = 0;
        for (std::size_t p = 0; p < 64 * 64; ++p) {
          if (reference.coats[c].data[4 * p + 3] < 0.5f) continue;
          for (int k = 0; k < 3; ++k) {
            const double x = r.coats[c].data[4 * p + k], e = reference.coats[c].data[4 * p + k];
            sum += (x - e) * (x - e) / (e * e + 0.01) / 3;
          }
          n += 1;
        }
        error[c] += sum / n / runs;
      }
    }
    for (const double e : error) worst = std::max(worst, std::sqrt(e));
    CAPTURE(target);
    MESSAGE("target ", target, ": ", worst, " with ", double(paths) / (64 * 64), " samples a pixel of the picture");
    CHECK(worst < 1.5 * target);  // the pilot's eight samples say it to some 20 %
    CHECK(worst > 0.5 * target);
    CHECK(paths > 2 * last);
    last = paths;
  }
  // Alone and in a batch: the same bits, so no coat has moved a sample.
  const Radiance batch = render(coats, 0.05, 1, 7);
  for (std::size_t c = 0; c < coats.size(); ++c) CHECK(render({coats[c]}, 0.05, 1, 7).coats[0].data == batch.coats[c].data);
}

TEST_CASE("even areas stay even where tiles of different sample counts meet") {
  // A white plate under an even sky, with a ball on it whose shadow takes more samples than the rest.
  const Surface ball = sphere_surface(30, 60, 0.5f), plate = plate_surface({-20, -20, -0.4f}, {40, 0, 0}, {0, 40, 0});
  auto a = std::make_shared<Appearance>();
  add_material(*a, 1, 0, {vec3(0.8f)});
  Scene scene;
  scene.appearance = a;
  scene.instances = {instance_of(ball, 0, 0), instance_of(plate, 0, 0)};
  Lights lights;
  lights.environment = std::make_shared<Environment>(vec3(1.0f));
  lights.suns.push_back({glm::normalize(vec3(1, 0.3f, 0.5f)), vec3(4), 0.2f});
  lights.prepare(vec3(0));
  const Accel accel(scene);
  const Camera camera = look_at({0.01, 0, 12}, {0, 0, 0}, 200, 128, 128);
  PixelMask all(128, 128);
  all.fill();
  PathOptions o;
  o.target_error = 0.05;
  const Radiance r = trace_radiance(scene, lights, accel, camera, all, o);
  double least = 1, most = 0;
  for (std::size_t p = 0; p < 128 * 128; ++p) {
    least = std::min<double>(least, r.coats[0].data[4 * p + 3]);
    most = std::max<double>(most, r.coats[0].data[4 * p + 3]);
  }
  // Without the division by what a pixel receives, borders of 4 and 16 samples would be up to 6 % off.
  CHECK(least == doctest::Approx(1).epsilon(1e-5));
  CHECK(most == doctest::Approx(1).epsilon(1e-5));
  CHECK(r.paths > 1.2 * 128 * 128 * (8 + 4));  // not all tiles at the least
}
