// Stress cases of statistics: what is summed up over samples, pixels and runs.
#include "generator/core/error.h"
#include "generator/core/random.h"
#include "generator/core/statistics.h"
#include "validate/studies/stress.h"
#include "validate/studies/stress_scenes.h"

namespace moomill {
namespace {

// Mean and variance by two passes in long double, both corrected by what the first pass was off.
struct Truth {
  long double mean = 0, variance = 0;
  explicit Truth(const std::vector<double>& data) {
    const auto n = static_cast<long double>(data.size());
    long double rough = 0, off = 0, squares = 0;
    for (const double x : data) rough += x / n;
    for (const double x : data) {
      off += x - rough;
      squares += (x - rough) * (x - rough);
    }
    mean = rough + off / n;
    variance = (squares - off * off / n) / (n - 1);
  }
};

Moments moments_of(const std::vector<double>& data) {
  Moments m;
  for (const double x : data) m.add(x);
  return m;
}

double constant_data(const StressOptions&) {
  Moments m;
  for (int i = 0; i < 1'000'000; ++i) m.add(0.1);
  return std::max(m.variance(), std::abs(m.mean() - 0.1));
}

double offset_data(double offset) {
  std::vector<double> data;
  for (int i = 0; i < 100'000; ++i)
    data.push_back(offset + to_normal(hash_identity({1, static_cast<std::uint64_t>(i)})));
  const Truth truth(data);
  const Moments m = moments_of(data);
  return std::max(static_cast<double>(std::abs(m.variance() / truth.variance - 1)),
                  static_cast<double>(std::abs(m.mean() / truth.mean - 1)));
}

// Data near the largest double: the mean must survive, and a variance that no double holds be refused.
double overflowing(const StressOptions&) {
  Moments m;
  const double huge = std::numeric_limits<double>::max();
  for (int i = 0; i < 1000; ++i) m.add(i % 2 ? huge : -0.5 * huge);
  double error = std::abs(m.mean() / (0.25 * huge) - 1);
  try {
    m.variance();
    error += 1;
  } catch (const RunError&) {
  }
  // The deviation of this data is a double, though its square is not.
  return std::max(error, std::abs(m.deviation() / (0.75 * huge * std::sqrt(1000.0 / 999)) - 1));
}

double tiny_data(const StressOptions&) {
  Moments m;
  for (int i = 0; i < 1000; ++i) m.add(i % 2 ? 1e-200 : 3e-200);
  return std::max(std::abs(m.mean() / 2e-200 - 1), std::abs(m.deviation() / (1e-200 * std::sqrt(1000.0 / 999)) - 1));
}

double not_finite_data(const StressOptions&) {
  double taken = 0;
  for (const double x : {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity(),
                         -std::numeric_limits<double>::infinity()}) {
    Moments m;
    try {
      m.add(x);
      ++taken;
    } catch (const RunError&) {
    }
  }
  try {
    (void)Moments().mean();
    ++taken;
  } catch (const RunError&) {
  }
  return taken;
}

double merged(const StressOptions&) {
  std::vector<double> data;
  for (int i = 0; i < 100'000; ++i) data.push_back(1e9 + to_normal(hash_identity({2, static_cast<std::uint64_t>(i)})));
  Moments whole;
  for (std::size_t begin = 0, n = 1; begin < data.size(); begin += n, n = 2 * n + 1) {
    Moments part;
    for (std::size_t i = begin; i < std::min(begin + n, data.size()); ++i) part.add(data[i]);
    whole.merge(part);
  }
  const Truth truth(data);
  return static_cast<double>(std::abs(whole.variance() / truth.variance - 1));
}

// A pixel of the background, 0.1, averaged over a million samples.
double long_mean(int samples) {
  Stage stage;
  stage.add(stress_plate({50, 50, 50}, {1, 0, 0}, {0, 1, 0}), 0);  // out of sight
  stage.environment(vec3(0.1f, 0.3f, 1e-3f));
  PathOptions o;
  o.samples = samples;
  o.environment_visible = true;
  const Shaded r = shade(stage, stress_camera({3, 0, 0}, {0, 0, 0}, 40, 2, 2), o);
  double worst = 0;
  for (const vec3& p : r.pixels)
    for (int k = 0; k < 3; ++k) worst = std::max(worst, std::abs(double(p[k]) / vec3(0.1f, 0.3f, 1e-3f)[k] - 1));
  return r.pixels.size() == 4 ? worst : 1;
}

}  // namespace

std::vector<StressCase> statistics_stress() {
  constexpr Oracle analytic = Oracle::analytic, precise = Oracle::high_precision, predicate = Oracle::exact_predicate;
  return {
      {"variance of constant data", "a million times 0.1", predicate, 0, "",
       "no difference ever arises, so mean and variance are exact", constant_data},
      {"variance at an offset of 1e9", "100,000 normal numbers around 1e9", precise, 1e-12, "",
       "differences from the first value are exact, so the offset costs nothing; the sum of 100,000 squares errs by "
       "some 1e-14",
       [](const StressOptions&) { return offset_data(1e9); }},
      {"variance at an offset of 1e15", "100,000 normal numbers around 1e15, themselves rounded to eighths", precise,
       1e-12, "", "as above", [](const StressOptions&) { return offset_data(1e15); }},
      {"overflowing data", "1,000 numbers at the ends of what a double holds", analytic, 1e-12, "",
       "mean and deviation are doubles and right to rounding; the variance is not one and is refused", overflowing},
      {"vanishing data", "1,000 numbers near 1e-200, whose squares vanish", analytic, 1e-12, "",
       "mean and deviation are right to rounding", tiny_data},
      {"data that is not finite", "not-a-number, both infinities, and no data at all", predicate, 0, "inputs",
       "each is refused with a sentence", not_finite_data},
      {"merged in uneven parts", "100,000 numbers around 1e9, in parts of 1, 3, 7, 15, ...", precise, 1e-12, "",
       "as in one go", merged},
      {"mean of 65,536 samples", "a background of 0.1, 0.3 and 1e-3 in the path tracer's mean", analytic,
       4 * float_rounding, "",
       "the samples are equal: the compensated sum, the share of one sample and their product are rounded, the "
       "constant was before",
       [](const StressOptions&) { return long_mean(1 << 16); }},
      {"mean of a million samples", "the same with 1,000,000 samples", analytic, 4 * float_rounding, "",
       "the samples are equal: the compensated sum, the share of one sample and their product are rounded, the "
       "constant was before",
       [](const StressOptions&) { return long_mean(1'000'000); }},
  };
}

}  // namespace moomill
