#include "validate/studies/error_measures.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "generator/core/color.h"
#include "generator/core/error.h"

namespace moomill {
namespace {

constexpr double nan = std::numeric_limits<double>::quiet_NaN();

vec3 pixel(const ImageF& image, std::size_t i) {
  const float* p = image.data.data() + i * image.channels;
  return {p[0], p[1], p[2]};
}

void check_sizes(const ImageF& a, const ImageF& b, const ImageU32& mask) {
  check(a.width == b.width && a.height == b.height && a.width == mask.width && a.height == mask.height,
        "picture, reference and mask have different sizes");
  check(a.channels >= 3 && b.channels >= 3 && mask.channels == 1, "errors are of colours inside a mask");
}

}  // namespace

PictureError picture_error(const ImageF& picture, const ImageF& reference, const ImageU32& mask) {
  check_sizes(picture, reference, mask);
  PictureError sum;
  std::size_t pixels = 0;
  for (std::size_t i = 0; i < mask.data.size(); ++i) {
    if (!mask.data[i]) continue;
    ++pixels;
    const vec3 x = pixel(picture, i), r = pixel(reference, i);
    for (int c = 0; c < 3; ++c) {
      const double d = double(x[c]) - double(r[c]), square = d * d;
      sum.mse += square;
      sum.relative_mse += square / (double(r[c]) * r[c] + relative_epsilon);
    }
    sum.ciede2000 += ciede2000(lab_from_linear(glm::clamp(x, 0.0f, 1.0f)), lab_from_linear(glm::clamp(r, 0.0f, 1.0f)));
  }
  check(pixels > 0, "an error needs a pixel inside the mask");
  return {sum.mse / (3.0 * pixels), sum.relative_mse / (3.0 * pixels), sum.ciede2000 / pixels};
}

Reference join_halves(const ImageF& a, const ImageF& b, const ImageU32& mask) {
  Reference out{a, 0.25 * picture_error(a, b, mask).mse};
  check(a.data.size() == b.data.size(), "the halves of a reference have different sizes");
  for (std::size_t i = 0; i < a.data.size(); ++i) out.picture.data[i] = 0.5f * (a.data[i] + b.data[i]);
  return out;
}

double student_t_975(int degrees_of_freedom) {
  static constexpr double few[] = {nan, 12.7062, 4.3027, 3.1824, 2.7764};
  if (degrees_of_freedom < 1) return nan;
  if (degrees_of_freedom < 5) return few[degrees_of_freedom];
  // Cornish and Fisher's expansion around the normal quantile (Abramowitz and Stegun, 26.7.5); within 0.2 % from 5 on.
  const double z = 1.959964, n = degrees_of_freedom, z2 = z * z;
  return z * (1 + (z2 + 1) / (4 * n) + ((5 * z2 + 16) * z2 + 3) / (96 * n * n) +
              (((3 * z2 + 19) * z2 + 17) * z2 - 15) / (384 * n * n * n));
}

PowerLaw fit_power_law(const std::vector<double>& samples, const std::vector<double>& error) {
  check(samples.size() == error.size(), "a fit needs as many errors as sample counts");
  std::vector<dvec2> points;
  dvec2 mean(0);
  for (std::size_t i = 0; i < samples.size(); ++i) {
    if (!(samples[i] > 0) || !(error[i] > 0) || !std::isfinite(error[i])) continue;
    points.emplace_back(std::log(samples[i]), std::log(error[i]));
    mean += points.back();
  }
  PowerLaw fit{nan, nan, nan, nan, static_cast<int>(points.size())};
  if (points.size() < 3) return fit;
  mean /= double(points.size());
  double xx = 0, xy = 0;
  for (const dvec2& p : points) {
    xx += (p.x - mean.x) * (p.x - mean.x);
    xy += (p.x - mean.x) * (p.y - mean.y);
  }
  if (!(xx > 0)) return fit;
  fit.slope = xy / xx;
  fit.scale = std::exp(mean.y - fit.slope * mean.x);
  double residual = 0;
  for (const dvec2& p : points) {
    const double r = p.y - mean.y - fit.slope * (p.x - mean.x);
    residual += r * r;
  }
  const int free = fit.points - 2;
  const double half = student_t_975(free) * std::sqrt(residual / free / xx);
  fit.low = fit.slope - half;
  fit.high = fit.slope + half;
  return fit;
}

std::optional<double> time_for_error(const std::vector<TimedError>& curve, double error) {
  std::size_t after = curve.size();  // the first point from which on the error stays at or below
  while (after > 0 && curve[after - 1].error <= error) --after;
  if (after == 0 && !curve.empty() && curve[0].error == error) return curve[0].seconds;
  if (after == 0 || after == curve.size() || !(error > 0)) return std::nullopt;
  const TimedError &a = curve[after - 1], &b = curve[after];
  if (!(a.seconds > 0) || !(b.error > 0)) return std::nullopt;
  const double t = std::log(a.error / error) / std::log(a.error / b.error);
  return a.seconds * std::pow(b.seconds / a.seconds, t);
}

double median(std::vector<double> values) {
  if (values.empty()) return nan;
  std::sort(values.begin(), values.end());
  const std::size_t half = values.size() / 2;
  return values.size() % 2 ? values[half] : 0.5 * (values[half - 1] + values[half]);
}

}  // namespace moomill
