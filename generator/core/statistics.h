#pragma once
// Mean and variance of data that comes one by one, right also where squares would overflow, vanish or cancel.
#include <cstdint>

namespace moomill {

// Welford's recurrence (Technometrics 1962), merged after Chan, Golub and LeVeque (1979). Data is held less its first
// value, so that an offset cancels before it costs digits, and divided by a power of two that follows its size, so that
// no square leaves the range of doubles.
class Moments {
 public:
  void add(double x);  // RunError where x is not finite
  void merge(const Moments& other);
  std::uint64_t count() const { return count_; }
  double mean() const;  // RunError without data
  double variance()
      const;  // of the population the data is drawn from, n - 1; 0 for one value; RunError where no double holds it
  double deviation() const;  // its root, also where the variance itself is beyond doubles
 private:
  void rescale(int exponent);
  std::uint64_t count_ = 0;
  int exponent_ = 0;               // data is held as x 2^-exponent_ - shift_
  double shift_ = 0;               // the first value, scaled
  double mean_ = 0, squares_ = 0;  // of what is held: mean, and sum of squared differences from it
};

}  // namespace moomill
