// What must hold for whole pictures: no light made or lost in a white world, the same flux when emitter and sensor change places, what bent normals
// and smooth normals on coarse meshes lose, and bytes that come back as they went in.
#include <filesystem>

#include "generator/dataset/codecs.h"
#include "generator/dataset/dataset.h"
#include "tests/render/fixtures.h"
#include "tests/temporary_file.h"

using namespace moomill;
using namespace moomill::test;

namespace {

// Every triangle with three vertices of its own and the triangle's normal.
Surface flat(const Surface& s) {
  Surface f;
  for (const uvec3& t : s.triangles) {
    const vec3 n = glm::normalize(glm::cross(s.rest[t[1]] - s.rest[t[0]], s.rest[t[2]] - s.rest[t[0]]));
    const unsigned first = static_cast<unsigned>(f.rest.size());
    for (int k = 0; k < 3; ++k) {
      f.rest.push_back(s.rest[t[k]]);
      f.normals.push_back(n);
      f.uvs.push_back(s.uvs[t[k]]);
    }
    f.triangles.push_back({first, first + 1, first + 2});
  }
  f.materials.assign(f.triangles.size(), 0);
  f.parts.assign(f.triangles.size(), 0);
  f.nnopcs = f.rest;
  return f;
}

// Sums over a picture of one channel and of alpha, so that their ratio is the mean radiance of what is seen.
struct Sums {
  double radiance = 0, alpha = 0;
  double mean() const { return radiance / alpha; }
};
std::vector<Sums> sums_of(const Scene& scene, const Lights& lights, const Camera& camera, const PathOptions& options) {
  const Accel accel(scene);
  PixelMask all(camera.width, camera.height);
  all.fill();
  const Radiance r = trace_radiance(scene, lights, accel, camera, all, options);
  CHECK(r.not_finite == 0);
  std::vector<Sums> sums(r.coats.size());
  for (std::size_t coat = 0; coat < sums.size(); ++coat)
    for (std::size_t p = 0; p < r.coats[coat].data.size(); p += 4) {
      sums[coat].radiance += r.coats[coat].data[p + 1];
      sums[coat].alpha += r.coats[coat].data[p + 3];
    }
  REQUIRE(sums[0].alpha > 0);
  return sums;
}
Sums shade(const Scene& scene, const Lights& lights, const Camera& camera, const PathOptions& options) {
  return sums_of(scene, lights, camera, options)[0];
}

Lights sky(float radiance, bool map) {
  Lights l;
  l.environment = map ? std::make_shared<Environment>(ImageF(8, 4, 3, radiance), "white", 1.0f, 0.2) : std::make_shared<Environment>(vec3(radiance));
  l.prepare(vec3(0));
  return l;
}

struct Estimate {
  double mean = 0, error = 0;  // standard error, from independent pictures
};
template <class Picture>
Estimate estimate(int pictures, const Picture& picture) {
  double sum = 0, sum2 = 0;
  for (int k = 0; k < pictures; ++k) {
    const double v = picture(static_cast<std::uint64_t>(k) + 1);
    sum += v;
    sum2 += v * v;
  }
  const double mean = sum / pictures;
  return {mean, std::sqrt(std::max(0.0, sum2 / pictures - mean * mean) / (pictures - 1))};
}

}  // namespace

TEST_CASE("white furnace through a whole scene: posed concave shapes of seven finishes, textures and holes, under an even sky and a white map") {
  const Surface thorns = thorny_surface(150, 5), bowl = flat(sphere_surface(12, 20, 1.6f, true));
  Surface mixed_thorns = thorns, half_bowl = bowl;
  half_bowl.triangles.clear();
  for (const uvec3& t : bowl.triangles)
    if (bowl.rest[t[0]].z + bowl.rest[t[1]].z + bowl.rest[t[2]].z < -1.0f) half_bowl.triangles.push_back(t);
  const auto finish_of = [](Surface& s) {
    s.materials.resize(s.triangles.size());
    for (std::size_t i = 0; i < s.triangles.size(); ++i) s.materials[i] = static_cast<std::uint32_t>(i % 7);
    s.parts.assign(s.triangles.size(), 0);
  };
  finish_of(mixed_thorns);
  finish_of(half_bowl);

  auto a = std::make_shared<Appearance>();
  const float finishes[7][3] = {{1, 0, 0}, {0.2f, 0, 1}, {0.8f, 0, 1}, {0.3f, 1, 1}, {0.5f, 0.5f, 1}, {0.5f, 0, 0.5f}, {1, 1, 1}};
  for (const auto& f : finishes) {
    add_material(*a, f[0], f[1], {vec3(1), vec3(1), vec3(0.5f)});
    a->materials.back().specular = f[2];
  }
  Texture white, finish, holes;
  white.image = Image8(4, 4, 3, 255);
  finish.image = Image8(8, 8, 3);
  holes.image = Image8(4, 4, 4, 255);
  std::mt19937 random(2);
  for (auto& v : finish.image.data) v = static_cast<std::uint8_t>(random());
  for (std::size_t i = 3; i < holes.image.data.size(); i += 4) holes.image.data[i] = random() % 3 == 0 ? 0 : 255;
  a->textures = {std::make_shared<Texture>(white), std::make_shared<Texture>(finish), std::make_shared<Texture>(holes)};
  a->materials[6].metallic_roughness_texture = 1;  // every roughness and metalness there is
  a->materials[5].alpha_texture = 2;
  a->materials[5].alpha_cutoff = 0.5f;
  Paint textured;
  textured.coats = {{vec3(1), -1, false}, {vec3(1), 0, false}, {vec3(0.5f), 0, false}};
  a->paints[2] = std::make_shared<Paint>(textured);
  Scene scene;
  scene.appearance = a;
  std::vector<int> all_finishes = {0, 1, 2, 3, 4, 5, 6};
  scene.instances = {instance_of(mixed_thorns, 0, 0), instance_of(half_bowl, 0, 0, {0, 0, 0.1f})};
  const glm::mat3 turn(0.36f, 0.48f, -0.8f, -0.8f, 0.6f, 0, 0.48f, 0.64f, 0.6f);
  for (vec3& p : scene.instances[0].posed.positions) p = 0.9f * (turn * p);
  for (vec3& n : scene.instances[0].posed.normals) n = turn * n;
  for (Instance& in : scene.instances) in.materials = all_finishes;
  scene.animal_count = 1;

  const Camera camera = look_at({3, 2, 4.5}, {0, 0, -0.3}, 42, 32, 32);
  PathOptions o;
  o.samples = 64;
  for (const bool map : {false, true}) {
    const Lights lights = sky(2, map);
    Estimate of_coat[3];
    std::vector<std::vector<Sums>> pictures;
    for (int stream = 1; stream <= 24; ++stream) {
      PathOptions p = o;
      p.stream = stream;
      pictures.push_back(sums_of(scene, lights, camera, p));
    }
    for (int coat = 0; coat < 3; ++coat) of_coat[coat] = estimate(24, [&](std::uint64_t stream) { return pictures[stream - 1][coat].mean() / 2; });
    MESSAGE(std::string(map ? "map: " : "even sky: "), of_coat[0].mean, " +- ", of_coat[0].error);
    CAPTURE(map);
    CHECK(of_coat[0].error < 0.003);
    CHECK(std::abs(of_coat[0].mean - 1) < 4 * of_coat[0].error + 0.002);  // 0.002: tables of albedo
    CHECK(of_coat[1].mean == of_coat[0].mean);                            // a white texture is white
    CHECK(of_coat[2].mean < 0.7);                                         // a grey coat is not
  }
}

TEST_CASE("light transport is reciprocal: emitter and sensor change places, with many bounces between") {
  struct Setup {
    const char* name;
    float roughness, metallic, specular;
    bool reciprocal;
  };
  for (const Setup& setup : {Setup{"lambert", 1, 0, 0, true}, Setup{"glossy dielectric", 0.35f, 0, 1, true}, Setup{"specular 0.5", 0.6f, 0, 0.5f, true},
                             Setup{"rough white metal", 1, 1, 1, false}}) {
    const float c = std::cos(0.5f), s = std::sin(0.5f);
    struct End {
      vec3 corner, u, v;
    };
    // Two Lambert plates, the one level, the other tilted; each is the emitter once and the sensor once.
    const End ends[2] = {{{-1.6f, -0.4f, 0}, {0.8f, 0, 0}, {0, 0.8f, 0}}, {{0.9f, -0.3f, 0.3f}, {0.6f * c, 0, 0.6f * s}, {0, 0.6f, 0}}};
    const Surface plate[2] = {plate_surface(ends[0].corner, ends[0].u, ends[0].v), plate_surface(ends[1].corner, ends[1].u, ends[1].v)};
    const Surface back = plate_surface({-2, 0.6f, -0.2f}, {4, 0, 0}, {0, 0.2f, 1.5f}), front = plate_surface({2, -0.6f, -0.2f}, {-4, 0, 0}, {0, 0, 1.2f}),
                  between = plate_surface({0, -0.5f, -0.2f}, {0, 0.9f, 0}, {0.1f, 0, 0.6f});
    auto a = std::make_shared<Appearance>();
    add_material(*a, 1, 0, {vec3(0.4f)});
    a->materials[0].specular = 0;
    add_material(*a, setup.roughness, setup.metallic, {vec3(0.9f)});
    a->materials[1].specular = setup.specular;
    Scene scene;
    scene.appearance = a;
    scene.instances = {instance_of(plate[0], 0, 0), instance_of(plate[1], 0, 0), instance_of(back, 0, 1), instance_of(front, 0, 1), instance_of(between, 0, 1)};
    scene.animal_count = 1;
    Estimate flux[2];
    for (int emitter = 0; emitter < 2; ++emitter) {
      const End &e = ends[emitter], &sensor = ends[1 - emitter];
      Lights lights;
      RectangleLight light;
      light.edge_u = e.u;
      light.edge_v = e.v;
      light.corner = e.corner + 5e-5f * light.normal();
      light.radiance = vec3(1);
      lights.rectangles = {light};
      lights.prepare(vec3(0));
      // The picture is the sensor's plate, seen head-on from afar: its mean is the radiosity, in proportion to what arrives.
      const dvec3 n(glm::normalize(glm::cross(sensor.u, sensor.v))), centre = dvec3(sensor.corner) + 0.5 * dvec3(sensor.u) + 0.5 * dvec3(sensor.v);
      constexpr int side = 24;
      const Camera camera = look_at(centre + 40.0 * n, centre, side * 40 / glm::length(dvec3(sensor.u)), side, side);
      flux[emitter] = estimate(16, [&](std::uint64_t stream) {
        PathOptions o;
        o.samples = 128;
        o.filter_radius = 0.5;
        o.stream = stream + 100 * emitter;
        const Sums sums = shade(scene, lights, camera, o);
        CHECK(sums.alpha > 0.99 * side * side);
        return sums.mean() * glm::length(sensor.u) * glm::length(sensor.v);
      });
    }
    const double difference = flux[0].mean - flux[1].mean, error = std::hypot(flux[0].error, flux[1].error);
    MESSAGE(std::string(setup.name), ": ratio ", flux[0].mean / flux[1].mean, " +- ", error / flux[1].mean);
    INFO(std::string(setup.name));
    CHECK(error < 0.01 * flux[1].mean);
    if (setup.reciprocal) CHECK(std::abs(difference) < 4 * error + 0.002 * flux[1].mean);
  }
}

TEST_CASE("a bent normal in a white world leaves (1 + cos) / 2, and light below the true surface adds nothing") {
  const Surface plate = plate_surface({-1, -1, 0}, {2, 0, 0}, {0, 2, 0});
  for (const std::array<std::uint8_t, 3>& texel : {std::array<std::uint8_t, 3>{128, 128, 255}, {218, 128, 218}, {128, 40, 200}, {250, 128, 140}}) {
    auto a = std::make_shared<Appearance>();
    add_material(*a, 1, 0, {vec3(1)});
    a->materials[0].specular = 0;
    Texture map;
    map.image = Image8(2, 2, 3);
    for (std::size_t i = 0; i < map.image.data.size(); ++i) map.image.data[i] = texel[i % 3];
    a->textures = {std::make_shared<Texture>(map)};
    a->materials[0].normal_texture = 0;
    Scene scene;
    scene.appearance = a;
    scene.instances = {instance_of(plate, 0, 0)};
    const dvec3 n = glm::normalize(2.0 / 255 * dvec3(texel[0], texel[1], texel[2]) - 1.0), in_world(n.x, -n.y, n.z);
    const Camera camera = look_at({0, 0.001, 30}, {0, 0, 0}, 120, 8, 8);
    // The cosine lobe around n, cut by the horizon of a surface whose normal makes this angle with it (form factor of a tilted plate).
    const double kept = estimate(8, [&](std::uint64_t stream) {
                          PathOptions o;
                          o.samples = 512;
                          o.stream = stream;
                          return shade(scene, sky(1, false), camera, o).mean();
                        }).mean;
    CAPTURE(n.z);
    CHECK(kept == doctest::Approx((1 + n.z) / 2).epsilon(0.005));
    const auto lit = [&](const dvec3& from) {
      Lights lights;
      lights.suns.push_back({vec3(glm::normalize(from)), vec3(1), 0.001f});
      lights.prepare(vec3(0));
      PathOptions o;
      o.samples = 16;
      return shade(scene, lights, camera, o).mean();
    };
    const dvec3 level = n.z < 0.99 ? glm::normalize(dvec3(in_world.x, in_world.y, 0)) : dvec3(1, 0, 0);
    CHECK(lit(level - 0.02 * dvec3(0, 0, 1)) == 0);  // the bent normal may face it, the plate does not
    const dvec3 above = glm::normalize(level + 0.02 * dvec3(0, 0, 1)), behind = glm::normalize(-level + 0.02 * dvec3(0, 0, 1));
    CHECK(lit(above) == doctest::Approx(glm::dot(above, in_world) / pi).epsilon(0.03));
    if (n.z < 0.99) CHECK(lit(behind) == 0);  // above the plate, but the bent normal looks away
  }
}

TEST_CASE("a bent normal that looks away from the viewer leans until it does not: nothing turns black, nothing shines more than white") {
  const Surface plate = plate_surface({-4, -4, 0}, {8, 0, 0}, {0, 8, 0});
  for (const float roughness : {0.3f, 1.0f}) {
    auto a = std::make_shared<Appearance>();
    add_material(*a, roughness, 0, {vec3(1)});
    Texture map;
    map.image = Image8(2, 2, 3);
    for (std::size_t i = 0; i < map.image.data.size(); ++i) map.image.data[i] = std::array<std::uint8_t, 3>{30, 128, 180}[i % 3];
    a->textures = {std::make_shared<Texture>(map)};
    a->materials[0].normal_texture = 0;
    Scene scene;
    scene.appearance = a;
    scene.instances = {instance_of(plate, 0, 0)};
    PathOptions o;
    o.samples = 256;
    const double grazing = shade(scene, sky(1, false), look_at({40, 0, 6}, {0, 0, 0}, 60, 8, 8), o).mean();
    CAPTURE(roughness);
    MESSAGE("roughness ", roughness, ": ", grazing);
    CHECK(grazing > 0.3);
    CHECK(grazing < 1.003);
  }
}

TEST_CASE("shading terminator: what smooth normals on a coarse white ball lose, against the number of its faces") {
  double finest_sun[2] = {0, 0};
  for (const int rows : {256, 64, 32, 16, 8}) {
    const Surface smooth = sphere_surface(rows, 2 * rows), facets = flat(smooth);
    const Camera camera = look_at({0, -30, 0.01}, {0, 0, 0}, 440, 32, 32);
    for (const bool metal : {false, true}) {
      auto a = std::make_shared<Appearance>();
      add_material(*a, metal ? 0.3f : 1, metal, {vec3(1)});
      a->materials[0].specular = 0;
      double loss[2], sun_mean = 0;
      for (const bool flatly : {false, true}) {
        Scene scene;
        scene.appearance = a;
        scene.instances = {instance_of(flatly ? facets : smooth, 0, 0)};
        PathOptions o;
        o.samples = 256;
        loss[flatly] = 1 - shade(scene, sky(1, false), camera, o).mean();
        if (flatly) continue;
        Lights lights;
        lights.suns.push_back({glm::normalize(vec3(1, -0.2f, 0.3f)), vec3(1), 0.00465f});
        lights.prepare(vec3(0));
        sun_mean = shade(scene, lights, camera, o).mean();
      }
      if (rows == 256) finest_sun[metal] = sun_mean;
      MESSAGE(rows, " x ", 2 * rows, std::string(metal ? ", metal" : ", matt"), ": even sky loses ", loss[0], " (flat normals ", loss[1], "), sun from the side ",
              1 - sun_mean / finest_sun[metal]);
      CAPTURE(rows);
      CAPTURE(metal);
      CHECK(std::abs(loss[1]) < (metal ? 0.002 : 1e-5));
      if (metal) {
        CHECK(loss[0] > -0.002);
        CHECK(loss[0] < 1.0 / rows);
      } else {  // second order: (1 - cos) / 2 of the angle between the normals
        CHECK(loss[0] > -1e-4);
        CHECK(loss[0] < 0.6 / (rows * rows) + 1e-4);
        if (rows <= 16) CHECK(loss[0] > 0.2 / (rows * rows));
        CHECK(std::abs(1 - sun_mean / finest_sun[metal]) < 0.6 / (rows * rows) + 5e-4);
      }
    }
  }
}

TEST_CASE("colour: every 8-bit sRGB value of a coat comes back as the same byte, through linear light, PNG and EXR") {
  TemporaryFile folder("colour/x", "");
  const auto file = [&](const char* name) { return folder.path.parent_path() / name; };
  // A coat image through PNG first: what is read is what was painted.
  Image8 ramp(256, 1, 3);
  for (int i = 0; i < 256; ++i) ramp.at(i, 0, 0) = static_cast<std::uint8_t>(i), ramp.at(i, 0, 1) = static_cast<std::uint8_t>(255 - i), ramp.at(i, 0, 2) = static_cast<std::uint8_t>(i * 7);
  const auto write = [&](const char* name, const std::vector<std::uint8_t>& bytes) {
    write_file_atomically(file(name), bytes.data(), bytes.size());
    return file(name);
  };
  const auto png = write("ramp.png", encode_png8(ramp));
  CHECK(decode_png8(png).data == ramp.data);
  const Image8 read = read_image8(png);
  REQUIRE(read.data == ramp.data);

  const Surface plate = plate_surface({-4, -4, 0}, {8, 0, 0}, {0, 8, 0});
  for (const bool stacked : {false, true}) {
    int wrong = 0;
    double worst = 0;
    for (int batch = 0; batch < 8; ++batch) {
      auto a = std::make_shared<Appearance>();
      Material m;
      m.specular = 0;
      m.paint = 0;
      a->materials = {m};
      a->coat_count = 32;
      Paint paint;
      std::vector<Image8> images;
      for (int k = 0; k < 32; ++k) {
        Image8 im(4, 4, 3);
        for (int p = 0; p < 16; ++p)
          for (int c = 0; c < 3; ++c) im.data[3 * p + c] = read.at(32 * batch + k, 0, c);
        images.push_back(im);
      }
      std::vector<const Image8*> pointers;
      for (const Image8& im : images) {
        paint.coats.push_back({vec3(1), stacked ? -1 : static_cast<int>(a->textures.size()), false});
        if (!stacked) a->textures.push_back(std::make_shared<Texture>(Texture{im, {}}));
        pointers.push_back(&im);
      }
      if (stacked) build_stack(paint, pointers);
      a->paints = {std::make_shared<Paint>(paint)};
      Scene scene;
      scene.appearance = a;
      scene.instances = {instance_of(plate, 0, 0)};
      const Accel accel(scene);
      PixelMask all(4, 4);
      all.fill();
      PathOptions o;
      o.samples = 16;
      const Radiance r = trace_radiance(scene, sky(1, false), accel, look_at({0, 0.1, 10}, {0, 0, 0}, 20, 4, 4), all, o);
      for (int k = 0; k < 32; ++k) {
        // Written as EXR and read back by either reader: the same floats.
        const ImageF& f = r.coats[k];
        std::vector<ExrChannel> channels;
        for (int c = 0; c < 3; ++c) channels.push_back({std::string(1, "RGB"[c]), &f.data[c], nullptr, 4});
        if (k == 5) {
          const auto exr = write("picture.exr", encode_exr(4, 4, channels));
          const ExrImage back = decode_exr(exr);
          const ImageF other = read_imagef(exr);
          for (int p = 0; p < 16; ++p)
            for (int c = 0; c < 3; ++c) {
              wrong += back.data[back.channel(std::string(1, "RGB"[c]))][p] != f.data[4 * p + c];
              wrong += other.data[other.channels * p + c] != f.data[4 * p + c];
            }
        }
        const Image8 out = to_srgb8(f, vec3(0));
        const auto picture = decode_png8(write("picture.png", encode_png8(out)));
        for (int p = 0; p < 16; ++p)
          for (int c = 0; c < 3; ++c) {
            const std::uint8_t painted = images[k].data[c];
            wrong += picture.data[picture.channels * p + c] != painted;
            const double s = painted / 255.0, linear = s <= 0.04045 ? s / 12.92 : std::pow((s + 0.055) / 1.055, 2.4);
            worst = std::max(worst, std::abs(f.data[4 * p + c] - linear));
          }
      }
    }
    CAPTURE(stacked);
    CHECK(wrong == 0);
    CHECK(worst < 1e-6);
    MESSAGE("largest difference of a linear value: ", worst);
  }
}
