#include "validate/studies/converge.h"

#include <doctest/doctest.h>

#include <cmath>
#include <fstream>

#include "generator/core/error.h"
#include "generator/core/random.h"
#include "tests/temporary_file.h"
#include "validate/studies/error_measures.h"

using namespace moomill;

namespace {

double uniform(std::uint64_t a, std::uint64_t b, std::uint64_t c) { return to_unit(hash_identity({a, b, c})); }

ConvergenceRow row_of(int coat, int samples, double seconds, double error, int camera = 0) {
  return {"test", 1, camera, coat, samples, seconds, 2 * seconds, {error, error, error}};
}

}  // namespace

TEST_CASE("picture errors of a hand example") {
  ImageF x(2, 1, 4), r(2, 1, 4);
  ImageU32 mask(2, 1, 1);
  mask.data = {1, 0};
  x.data = {0.5f, 0.25f, 0, 1, 9, 9, 9, 1};  // the second pixel is outside
  r.data = {0.25f, 0.25f, 0.5f, 1, 0, 0, 0, 1};
  const PictureError e = picture_error(x, r, mask);
  CHECK(e.mse == doctest::Approx((0.0625 + 0 + 0.25) / 3));
  CHECK(e.relative_mse == doctest::Approx((0.0625 / 0.0725 + 0.25 / 0.26) / 3));
  // Black against white is a difference of 100 in lightness alone, and above white there is no further difference.
  x.data = {7, 7, 7, 1, 0, 0, 0, 0};
  r.data = {0, 0, 0, 1, 0, 0, 0, 0};
  CHECK(picture_error(x, r, mask).ciede2000 == doctest::Approx(100).epsilon(1e-4));
}

TEST_CASE("the error of a joined reference is that of the average of its halves") {
  ImageF a(256, 64, 3), b = a;
  for (std::size_t i = 0; i < a.data.size(); ++i) {  // around 0, so the true error is known
    a.data[i] = static_cast<float>(uniform(1, i, 0) - 0.5);
    b.data[i] = static_cast<float>(uniform(2, i, 0) - 0.5);
  }
  const Reference joined = join_halves(a, b, ImageU32(256, 64, 1, 1));
  CHECK(joined.mse == doctest::Approx(1.0 / 24).epsilon(0.03));  // variance 1/12, halved
  double sum = 0;
  for (const float v : joined.picture.data) sum += double(v) * v;
  CHECK(sum / joined.picture.data.size() == doctest::Approx(1.0 / 24).epsilon(0.03));
}

TEST_CASE("power laws: exact points, Student's t, and an integrand of known variance") {
  CHECK(student_t_975(1) == doctest::Approx(12.7062).epsilon(1e-4));
  CHECK(student_t_975(5) == doctest::Approx(2.5706).epsilon(2e-3));
  CHECK(student_t_975(30) == doctest::Approx(2.0423).epsilon(1e-4));
  const PowerLaw exact = fit_power_law({1, 2, 4, 8}, {3, 1.5, 0.75, 0.375});
  CHECK(exact.slope == doctest::Approx(-1));
  CHECK(exact.scale == doctest::Approx(3));
  CHECK(exact.high - exact.low < 1e-9);
  CHECK(std::isnan(fit_power_law({1, 2}, {3, 1}).slope));
  CHECK(fit_power_law({1, 2, 4, 8}, {3, 0, 0.75, 0.375}).points == 3);

  // The mean of n squares of uniform numbers estimates 1/3 with the variance (1/5 - 1/9) / n = (4/45) / n: slope -1. In 200 runs of
  // the whole experiment the interval holds the true slope about 190 times.
  int held = 0;
  double mean_slope = 0, mean_scale = 0;
  constexpr int runs = 200;
  for (int run = 0; run < runs; ++run) {
    std::vector<double> samples, errors;
    for (int n = 1; n <= 64; n *= 2) {
      double mse = 0;
      constexpr int pixels = 200;
      for (int p = 0; p < pixels; ++p) {
        double sum = 0;
        for (int s = 0; s < n; ++s) {
          const double u = uniform(run, n * 1000 + p, s);
          sum += u * u;
        }
        mse += (sum / n - 1.0 / 3) * (sum / n - 1.0 / 3) / pixels;
      }
      samples.push_back(n);
      errors.push_back(mse);
    }
    const PowerLaw fit = fit_power_law(samples, errors);
    held += fit.low <= -1 && fit.high >= -1;
    mean_slope += fit.slope / runs;
    mean_scale += fit.scale / runs;
  }
  CHECK(mean_slope == doctest::Approx(-1).epsilon(0.01));
  CHECK(mean_scale == doctest::Approx(4.0 / 45).epsilon(0.03));
  CHECK(held >= 178);  // 95 % of 200 is 190, standard deviation 3.1
  CHECK(held <= 199);
}

TEST_CASE("time for an error lies between the points around it, in logarithms") {
  const std::vector<TimedError> curve{{1, 0.1}, {4, 0.025}, {16, 0.00625}};
  CHECK(*time_for_error(curve, 0.05) == doctest::Approx(2));
  CHECK(*time_for_error(curve, 0.025) == doctest::Approx(4));
  CHECK(*time_for_error(curve, 0.1) == doctest::Approx(1));
  CHECK(*time_for_error(curve, 0.0125) == doctest::Approx(8));
  CHECK_FALSE(time_for_error(curve, 0.2));    // reached before the first point: no extrapolation
  CHECK_FALSE(time_for_error(curve, 0.001));  // never reached
  CHECK_FALSE(time_for_error({}, 0.1));
  // A curve that rises once more counts from where it stays down.
  CHECK(*time_for_error({{1, 0.4}, {2, 0.1}, {4, 0.2}, {8, 0.05}}, 0.1) == doctest::Approx(std::sqrt(32.0)));
}

TEST_CASE("speed-up at equal error of a hand example") {
  // Ours: 1, 2, 4 seconds for the errors 0.4, 0.2, 0.1; two coats share them. The other needs 40 s for 0.2.
  std::vector<ConvergenceRow> own, other;
  for (const int coat : {0, 1})
    for (const int n : {1, 2, 4}) own.push_back(row_of(coat, n, 0.5 * n, 0.4 / n));
  for (const int coat : {0, 1, 2})
    for (const int n : {16, 64}) other.push_back(row_of(coat, n, n == 64 ? 20 : 5, n == 64 ? 0.2 : 0.8));
  SpeedUp s = speed_up(own, other, 64, Measure::relative_mse, false);
  REQUIRE(s.ratios.size() == 1);  // coats 0 and 1 together; coat 2 was not measured here
  CHECK(s.ratios[0] == doctest::Approx(20));
  CHECK(speed_up(own, other, 64, Measure::mse, true).ratios[0] == doctest::Approx(20));
  CHECK(speed_up(own, other, 16, Measure::mse, false).outside == 1);
  CHECK_THROWS_AS(speed_up(own, other, 32, Measure::mse, false), InputError);
  CHECK_THROWS_AS(speed_up(own, {row_of(0, 64, 1, 1, 5)}, 64, Measure::mse, false), InputError);
  own.insert(own.end(), own.begin(), own.begin() + 3);  // a second repetition of coat 0 alone: a pair more
  CHECK(speed_up(own, other, 64, Measure::mse, false).ratios.size() == 2);
}

TEST_CASE("convergence tables come back as written, and what is none is refused with its line") {
  std::vector<ConvergenceRow> rows{row_of(0, 1, 0.25, 0.5), row_of(3, 64, 12.5, 1e-7)};
  const test::TemporaryFile file(convergence_file, convergence_csv(rows));
  const auto back = read_convergence(file.folder());
  REQUIRE(back.size() == 2);
  CHECK(back[1].coat == 3);
  CHECK(back[1].core_seconds == 25);
  CHECK(back[1].error.relative_mse == 1e-7);
  CHECK(back[1].renderer == "test");
  for (const char* bad : {"test,1,0,0,64,1,1,1,1", "test,1,0,0,x,1,1,1,1,1", "test,1,0,0,64,1,1,nan,1,1", "test,1,0,0,0,1,1,1,1,1", "test,1,0,0,64,1,1,1,1,1,1"}) {
    const test::TemporaryFile wrong("some.csv", std::string(convergence_header) + "\n" + bad + "\n");
    CAPTURE(bad);
    CHECK_THROWS_WITH_AS(read_convergence(wrong.path), doctest::Contains("line 2"), InputError);
  }
  CHECK_THROWS_AS(read_convergence(test::TemporaryFile("some.csv", "a,b\n").path), InputError);
  CHECK_THROWS_AS(read_convergence(file.folder() / "none"), InputError);
}

TEST_CASE("a small scene converges against its own reference, with repetitions that differ and runs that agree") {
  SceneSpec scene = read_scene(data_root() / "scenes/quick.toml");
  Overrides o;
  o.first_frame = o.last_frame = 1;
  o.coats = {0, 11};
  o.resolution = {40, 30};
  o.cameras = {2};
  apply_overrides(scene, o);
  scene.render.coat_resolution = 64;
  ConvergeOptions options;
  options.max_samples = 16;
  options.repetitions = 2;
  const Convergence measured = measure_convergence(scene, options);
  REQUIRE(measured.rows.size() == 2 * 2 * 5);  // repetitions, coats, sample counts
  REQUIRE(measured.references.size() == 2);
  CHECK(measured.references[0].samples == 256);
  CHECK(measured.rows[0].error.mse != measured.rows[10].error.mse);  // the second repetition of the same picture
  CHECK(measured.rows[0].samples == measured.rows[10].samples);
  const StudyResult study = convergence_study("small", measured, -0.8, Against{measured.rows, 4});
  for (const Figure& f : study.figures) {
    CAPTURE(f.name);
    CHECK(f.holds());
    // Against itself neither is faster; on so few pixels one repetition may be luckier than the other.
    if (f.name == "speed-up over moomill at equal relative MSE, core seconds: median") CHECK(f.value == doctest::Approx(1).epsilon(0.7));
  }
  // Two sample counts have no slope to hold.
  Convergence two = measured;
  std::erase_if(two.rows, [](const ConvergenceRow& r) { return r.samples > 2; });
  CHECK(convergence_study("two", two, -0.97, std::nullopt).holds());
  // What cannot be compared is refused before anything is measured.
  CHECK_NOTHROW(require_common_pictures(scene, {measured.rows, 4}));
  CHECK(test::contains(test::message_of([&] { require_common_pictures(scene, {measured.rows, 5}); }), "--at-spp: the other run was not measured at 5 samples"));
  o.cameras = {3};
  apply_overrides(scene, o);
  CHECK(test::contains(test::message_of([&] { require_common_pictures(scene, {measured.rows, 4}); }),
                 "--against: no picture was measured in both runs (frame 1, camera 3, coat 0 and others here, frame 1, camera 2, coat 0 and others there)"));
  for (const auto& [name, svg] : convergence_plots(measured, std::nullopt)) {
    CAPTURE(name);
    CHECK(svg.find("nan") == std::string::npos);
    CHECK(svg.find("<polyline") != std::string::npos);
  }
}
