#include "generator/core/statistics.h"

#include <cmath>
#include <limits>

#include "generator/core/error.h"

namespace moomill {
namespace {

// Scaled data lies below 2^100: squares, and sums of 2^64 of them, are far from the ends of doubles.
constexpr int headroom = 100;

}  // namespace

void Moments::rescale(int exponent) {
  shift_ = std::ldexp(shift_, exponent_ - exponent);
  mean_ = std::ldexp(mean_, exponent_ - exponent);
  squares_ = std::ldexp(squares_, 2 * (exponent_ - exponent));
  exponent_ = exponent;
}

void Moments::add(double x) {
  if (!std::isfinite(x)) run_error("a value of {} cannot be averaged; count such values apart", x);
  if (x != 0) {
    const int size = std::ilogb(x);
    if (shift_ == 0 && mean_ == 0 && squares_ == 0)
      exponent_ = size;  // nothing but zeros so far
    else if (size - exponent_ > headroom)
      rescale(size);
  }
  if (count_ == 0) shift_ = std::ldexp(x, -exponent_);
  const double scaled = std::ldexp(x, -exponent_) - shift_;
  ++count_;
  const double difference = scaled - mean_;
  mean_ += difference / static_cast<double>(count_);
  squares_ += difference * (scaled - mean_);
}

void Moments::merge(const Moments& other) {
  if (other.count_ == 0) return;
  if (count_ == 0) {
    *this = other;
    return;
  }
  Moments b = other;
  if (exponent_ < b.exponent_)
    rescale(b.exponent_);
  else
    b.rescale(exponent_);
  const double n = static_cast<double>(count_), m = static_cast<double>(b.count_),
               difference = (b.shift_ - shift_) + (b.mean_ - mean_);
  count_ += b.count_;
  mean_ += difference * (m / (n + m));
  squares_ += b.squares_ + difference * difference * (n * m / (n + m));
}

double Moments::mean() const {
  if (count_ == 0) run_error("the mean of no data is asked for");
  return std::ldexp(shift_ + mean_, exponent_);
}

double Moments::deviation() const {
  if (count_ == 0) run_error("the deviation of no data is asked for");
  if (count_ == 1) return 0;
  return std::ldexp(std::sqrt(squares_ / static_cast<double>(count_ - 1)), exponent_);
}

double Moments::variance() const {
  if (count_ == 0) run_error("the variance of no data is asked for");
  if (count_ == 1) return 0;
  const double v = std::ldexp(squares_ / static_cast<double>(count_ - 1), 2 * exponent_);
  if (std::isinf(v))
    run_error("the variance is more than a double holds ({:.3g} squared); divide the data by its size first",
              deviation());
  return v;
}

}  // namespace moomill
