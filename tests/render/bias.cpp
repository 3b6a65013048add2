// Bias of the path tracer: means of many independent low-sample pictures of every kind of light on every kind of material, against stored references
// of the same 64 x 64 pictures. tests/render/bias_reference.txt holds two: one of the product with many samples a pixel (its head says how many), and
// one of an independent integrator (double precision, brute-force intersection, its own surface model and sampling) with a quarter as many. To make
// it again with 65,536, which takes a quarter of an hour of processor time, or with fewer:
//
//   [MOOMILL_BIAS_SAMPLES=16384] build/release/bin/test_render -tc="references of the bias test*" --no-skip
//
// Pixels of a picture may share their samples, so nothing here takes them as independent: every mean's spread comes from pictures with streams of
// their own.
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <sstream>

#include "generator/core/error.h"
#include "tests/render/bias_scene.h"

using namespace moomill;
using namespace moomill::test;
using namespace moomill::test::bias;

namespace {

constexpr int block = 8;  // pixels

// --- pictures, and what is compared: means over blocks of 8 x 8 pixels, over each material's pixels, over all ---

using Picture = std::vector<dvec3>;  // 64 x 64

Picture product_picture(const Stage& stage, const Accel& accel, int samples, std::uint64_t stream, int max_bounces = 0,
                        const SkyShares* sky = nullptr) {
  PixelMask all_pixels(size, size);
  all_pixels.fill();
  PathOptions o;
  o.samples = samples;
  o.stream = stream;
  o.max_bounces = max_bounces;
  o.sky = sky;  // the sky's soft part as a control variate: the same expectation
  const Radiance r = trace_radiance(stage.scene, stage.lights, accel, stage.camera, all_pixels, o);
  CHECK(r.not_finite == 0);
  Picture p(pixels);
  for (int i = 0; i < pixels; ++i) p[i] = {r.coats[0].data[4 * i], r.coats[0].data[4 * i + 1], r.coats[0].data[4 * i + 2]};
  return p;
}

Picture independent_picture(const Independent& model, int samples, std::uint64_t stream) {
  Picture p(pixels);
  const Camera& camera = model.stage.camera;
  parallel_for(pixels, 16, [&](std::size_t i) {
    std::mt19937_64 random(stream * 1000003 + i);
    dvec3 sum(0);
    for (int s = 0; s < samples; ++s) {
      const double x = static_cast<double>(i % size) + 0.5 + window(random), y = static_cast<double>(i / size) + 0.5 + window(random);
      const dvec3 pinhole((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 1);
      sum += model.radiance(camera.centre, glm::normalize(glm::transpose(camera.world_to_camera) * pinhole), random);
    }
    p[i] = sum / double(samples);
  });
  return p;
}

// Of each pixel: the material that its whole filter sees, or -1.
std::vector<int> whole_materials(const Stage& stage) {
  const Independent model(stage);
  std::vector<int> m(pixels, -1);
  for (int i = 0; i < pixels; ++i) {
    int plate = -2;
    for (const double dx : {-1.5, 1.5})
      for (const double dy : {-1.5, 1.5}) {
        const dvec3 d = glm::normalize(stage.camera.direction(i % size + 0.5 + dx, i / size + 0.5 + dy));
        const int seen = model.intersect(stage.camera.centre, d).plate;
        plate = plate == -2 || plate == seen ? seen : -1;
      }
    if (plate >= 0 && plate < kinds) m[i] = plate;
  }
  return m;
}

constexpr int blocks = (size / block) * (size / block), rows = blocks + kinds + 1;
std::string row_name(int row) {
  if (row < blocks) return "block_" + std::to_string(row % (size / block)) + "_" + std::to_string(row / (size / block));
  std::string name = row < blocks + kinds ? kind_names[row - blocks] : "picture";
  std::replace(name.begin(), name.end(), ' ', '_');
  return name;
}
using Rows = std::vector<dvec3>;
Rows rows_of(const Picture& p, const std::vector<int>& materials) {
  Rows sum(rows, dvec3(0));
  std::vector<int> count(rows, 0);
  const auto add = [&](int row, const dvec3& v) { sum[row] += v, ++count[row]; };
  for (int i = 0; i < pixels; ++i) {
    add((i / size / block) * (size / block) + i % size / block, p[i]);
    if (materials[i] >= 0) add(blocks + materials[i], p[i]);
    add(rows - 1, p[i]);
  }
  for (int k = 0; k < rows; ++k) sum[k] /= std::max(1, count[k]);
  return sum;
}

// The pixels that see one material: at the others' edges a sample in thousands decides, and no spread can be told from few.
std::vector<dvec3> one_material(const Picture& p, const std::vector<int>& materials) {
  std::vector<dvec3> some;
  for (int i = 0; i < pixels; ++i)
    if (materials[i] >= 0) some.push_back(p[i]);
  return some;
}

// Mean over independent pictures, and the variance of that mean.
struct Estimate {
  std::vector<dvec3> mean, variance;
  int n = 0;
  void add(const std::vector<dvec3>& x) {
    if (n++ == 0) mean.assign(x.size(), dvec3(0)), sum2.assign(x.size(), dvec3(0));
    for (std::size_t k = 0; k < x.size(); ++k) {
      const dvec3 d = x[k] - mean[k];  // Welford 1962
      mean[k] += d / double(n);
      sum2[k] += d * (x[k] - mean[k]);
    }
  }
  void finish() {
    for (const dvec3& s : sum2) variance.push_back(s / (double(n) * (n - 1)));
  }

 private:
  std::vector<dvec3> sum2;
};

// Two-sided tail of Student's t, by integrating its density.
double student_p(double t, double freedom) {
  const double scale = std::exp(std::lgamma((freedom + 1) / 2) - std::lgamma(freedom / 2)) / std::sqrt(freedom * pi);
  constexpr int n = 4000;  // t = tan(a): the tail is a finite interval
  const double from = std::atan(std::abs(t)), width = (pi / 2 - from) / n;
  double sum = 0;
  for (int i = 0; i < n; ++i) {
    const double x = std::tan(from + (i + 0.5) * width);
    sum += scale * std::pow(1 + x * x / freedom, -(freedom + 1) / 2) * (1 + x * x) * width;
  }
  return std::min(1.0, 2 * sum);
}

// The least p of all values, times their number (Bonferroni): the p of the picture, whatever the values' correlation. `allowance`: relative
// difference that is no bias. Values below `least` are left out.
struct Verdict {
  double p = 1, worst_t = 0, largest = 0;  // largest relative difference
  std::size_t worst = 0;                   // index
};
Verdict compare(const Estimate& x, const std::vector<dvec3>& truth, const std::vector<dvec3>& truth_variance, std::size_t from, std::size_t to,
                double allowance, const dvec3& least = dvec3(0)) {
  Verdict v;
  int tests = 0;
  for (std::size_t k = from; k < to; ++k)
    for (int c = 0; c < 3; ++c) {
      const double variance = x.variance[k][c] + truth_variance[k][c];
      if (variance <= 0 || truth[k][c] < least[c]) continue;
      ++tests;
      const double difference = std::abs(x.mean[k][c] - truth[k][c]);
      if (truth[k][c] > 0) v.largest = std::max(v.largest, difference / truth[k][c]);
      const double t = std::max(0.0, difference - allowance * truth[k][c]) / std::sqrt(variance);
      if (t > v.worst_t) v.worst_t = t, v.worst = k;
    }
  REQUIRE(tests > 0);
  v.p = std::min(1.0, tests * student_p(v.worst_t, x.n - 1));
  return v;
}

std::filesystem::path reference_file() {
  return std::filesystem::path(MOOMILL_SOURCE_DIR) / "tests/render/bias_reference.txt";
}

struct Reference {
  Rows own, own_variance, independent, independent_variance;
};
std::map<std::string, Reference> read_references() {
  std::map<std::string, Reference> all_references;
  std::ifstream in(reference_file());
  REQUIRE_MESSAGE(in, "tests/render/bias_reference.txt cannot be read");
  std::string line;
  while (std::getline(in, line)) {
    if (line.empty() || line[0] == '#') continue;
    std::istringstream words(line);
    std::string light, row;
    dvec3 v[4];
    words >> light >> row;
    for (dvec3& x : v) words >> x.x >> x.y >> x.z;
    REQUIRE(words);
    Reference& r = all_references[light];
    REQUIRE(row == row_name(static_cast<int>(r.own.size())));
    r.own.push_back(v[0]);
    r.own_variance.push_back(v[1] * v[1]);
    r.independent.push_back(v[2]);
    r.independent_variance.push_back(v[3] * v[3]);
  }
  return all_references;
}

constexpr double significance = 1e-4;  // of every picture's test: 20 tests in all, so 2 runs in 1000 fail without a mistake
// What the surface model's tables of directional albedo may be off (measured by the tests of energy): no bias of the sampling.
constexpr double table_allowance = 0.003;

}  // namespace

TEST_CASE("no bias: 16-sample pictures against references of many samples, every light on every material") {
  const auto references = read_references();
  for (int light = 0; light < light_kinds; ++light) {
    const Stage stage(static_cast<Light>(light));
    const Accel accel(stage.scene);
    const std::vector<int> materials = whole_materials(stage);
    const Reference& reference = references.at(light_names[light]);
    REQUIRE(reference.own.size() == rows);
    const SkyShares sky = sky_shares(stage.scene, accel);
    Estimate low, steered, capped;
    for (int k = 0; k < 40; ++k) low.add(rows_of(product_picture(stage, accel, 16, 500 + k), materials));
    for (int k = 0; k < 12; ++k) capped.add(rows_of(product_picture(stage, accel, 16, 900 + k, 2), materials));
    const bool has_sky = light == constant || light == map || light == all;
    if (has_sky)
      for (int k = 0; k < 40; ++k) steered.add(rows_of(product_picture(stage, accel, 16, 1300 + k, 0, &sky), materials));
    low.finish();
    steered.finish();
    capped.finish();
    for (int k = 0; k < kinds; ++k) REQUIRE(std::count(materials.begin(), materials.end(), k) > 80);
    const auto told = [&](const char* what, const Verdict& v) {
      INFO(std::string(light_names[light]), ", ", std::string(what), ": t ", v.worst_t, " at ", row_name(static_cast<int>(v.worst)), ", p ", v.p);
      MESSAGE(std::string(light_names[light]), ", ", std::string(what), ": largest difference ", v.largest, ", t ", v.worst_t, ", p ", v.p);
      return v.p;
    };
    INFO("light: ", std::string(light_names[light]));
    // A block that only the filter's outermost tails reach is left out: it holds a hundred-thousandth of the light, from too few samples to tell.
    const dvec3 least = 1e-3 * reference.own[rows - 1];
    CHECK(told("blocks", compare(low, reference.own, reference.own_variance, 0, blocks, 0, least)) > significance);
    CHECK(told("materials", compare(low, reference.own, reference.own_variance, blocks, rows, 0)) > significance);
    CHECK(told("blocks, independent", compare(low, reference.independent, reference.independent_variance, 0, blocks, table_allowance, least)) > significance);
    CHECK(told("materials, independent", compare(low, reference.independent, reference.independent_variance, blocks, rows, table_allowance)) >
          significance);
    if (has_sky) {
      CHECK(told("blocks, sky shares", compare(steered, reference.own, reference.own_variance, 0, blocks, 0, least)) > significance);
      CHECK(told("materials, sky shares", compare(steered, reference.own, reference.own_variance, blocks, rows, 0)) > significance);
    }
    // The test sees a bias: two bounces at most.
    CHECK(told("capped", compare(capped, reference.own, reference.own_variance, blocks, rows, 0)) < significance);
  }
}

// The filter's weights are divided by their sum, which is another one for every stream: that must not shift an edge, also at one sample.
TEST_CASE("no bias of the pixel filter: coverage at an edge is the window's integral, at 1, 4 and 16 samples") {
  const Surface plate = plate_surface({-100, -100, 0}, {100.3f, 0, 0}, {0, 200, 0});
  Scene scene;
  auto a = std::make_shared<Appearance>();
  add_material(*a, 1, 0, {vec3(0)});
  scene.appearance = a;
  scene.instances = {instance_of(plate, 0, 0)};
  Lights dark;
  dark.prepare(vec3(0));
  const Accel accel(scene);
  constexpr int width = 8;
  const Camera camera = look_at({0, 0, 10}, {0, 0, 0}, 10, width, 2);  // a pixel is a metre
  PixelMask both(width, 2);
  both.fill();
  std::vector<dvec3> truth(width);
  for (int x = 0; x < width; ++x)
    for (int k = 0; k < 20000; ++k) {
      const double q = (k + 0.5) / 20000, w = 0.35875 - 0.48829 * std::cos(2 * pi * q) + 0.14128 * std::cos(4 * pi * q) - 0.01168 * std::cos(6 * pi * q);
      if (x + 0.5 + 1.5 * (2 * q - 1) < 4.3f) truth[x] += w / (0.35875 * 20000);
    }
  for (const auto& [samples, streams] : {std::pair(1, 20000), std::pair(4, 6000), std::pair(16, 2000)}) {
    Estimate seen;
    for (int k = 0; k < streams; ++k) {
      PathOptions o;
      o.samples = samples;
      o.stream = 7777 + k;
      const Radiance r = trace_radiance(scene, dark, accel, camera, both, o);
      std::vector<dvec3> alpha;
      for (int x = 0; x < width; ++x) alpha.emplace_back(r.coats[0].data[4 * x + 3]);
      seen.add(alpha);
    }
    seen.finish();
    CAPTURE(samples);
    for (int x = 0; x < width; ++x) {
      const double error = std::sqrt(seen.variance[x].x);
      if (error > 0) MESSAGE(samples, " samples, column ", x, ": ", seen.mean[x].x, " +- ", error, ", window ", truth[x].x);
      CHECK(std::abs(seen.mean[x].x - truth[x].x) < 4.5 * error + 2e-4);  // 2e-4: of 1; float weights, and what the division shifts
    }
  }
}

TEST_CASE("references of the bias test, made again" * doctest::skip()) {
  const char* wish = std::getenv("MOOMILL_BIAS_SAMPLES");
  const int samples = wish ? std::atoi(wish) : 65536, runs = 64;
  REQUIRE(samples >= 4 * runs);
  std::ofstream out(reference_file());
  out << "# Made by tests/render/bias.cpp, which says how; " << samples << " samples a pixel by the product, " << samples / 4 << " by the independent\n"
      << "# integrator, each in " << runs << " independent runs.\n"
      << "# light, row, then r g b of: mean by the product, its standard error, mean by the independent integrator, its standard error\n";
  for (int light = 0; light < light_kinds; ++light) {
    const Stage stage(static_cast<Light>(light));
    const Accel accel(stage.scene);
    const Independent model(stage);
    const std::vector<int> materials = whole_materials(stage);
    Estimate own, independent, own_pixels, independent_pixels, low_pixels;
    for (int k = 0; k < runs; ++k) {
      const Picture a = product_picture(stage, accel, samples / runs, 10000 + k);
      const Picture b = independent_picture(model, samples / runs / 4, 10000 + k);
      own.add(rows_of(a, materials));
      independent.add(rows_of(b, materials));
      own_pixels.add(one_material(a, materials));
      independent_pixels.add(one_material(b, materials));
    }
    for (int k = 0; k < 128; ++k) low_pixels.add(one_material(product_picture(stage, accel, 16, 20000 + k), materials));
    for (Estimate* e : {&own, &independent, &own_pixels, &independent_pixels, &low_pixels}) e->finish();
    // Per pixel, which the stored file does not hold.
    const Verdict pixel = compare(low_pixels, own_pixels.mean, own_pixels.variance, 0, own_pixels.mean.size(), 0);
    const Verdict truth = compare(own, independent.mean, independent.variance, blocks, rows, table_allowance);
    const Verdict truth_pixels = compare(own_pixels, independent_pixels.mean, independent_pixels.variance, 0, own_pixels.mean.size(), table_allowance);
    MESSAGE(std::string(light_names[light]), ": 128 pictures of 16 samples, per pixel: t ", pixel.worst_t, ", p ", pixel.p,
            "; product against independent: pools differ by at most ", truth.largest, ", t ", truth.worst_t, ", p ", truth.p, "; per pixel t ",
            truth_pixels.worst_t, ", p ", truth_pixels.p);
    CHECK(pixel.p > significance);
    CHECK(truth.p > significance);
    CHECK(truth_pixels.p > significance);
    char text[400];
    for (int k = 0; k < rows; ++k) {
      out << light_names[light] << " " << row_name(k);
      for (const dvec3& v : {own.mean[k], glm::sqrt(own.variance[k]), independent.mean[k], glm::sqrt(independent.variance[k])}) {
        std::snprintf(text, sizeof text, " %.6g %.6g %.6g", v.x, v.y, v.z);
        out << text;
      }
      out << "\n";
    }
    out.flush();
    REQUIRE(out);
  }
}
