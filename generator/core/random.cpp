#include "generator/core/random.h"

#include <cmath>

namespace moomill {
namespace {

constexpr double ln2_high = 0x1.62e42fee00000p-1;  // upper bits of ln 2: k * ln2_high is exact for |k| < 2^20
constexpr double ln2_low = 0x1.a39ef35793c76p-33;

}  // namespace

std::uint64_t hash_identity(std::initializer_list<std::uint64_t> parts) {
  constexpr std::uint64_t golden = 0x9e3779b97f4a7c15ull;  // 2^64 / golden ratio
  std::uint64_t h = mix64(golden * (parts.size() + 1));
  // Chained, so order matters; the addition keeps the all-zero tuple away from the fixed point 0 of mix64.
  for (const std::uint64_t part : parts) h = mix64(h + golden + mix64(part + golden));
  return h;
}

std::uint64_t hash_text(std::string_view text) {
  std::uint64_t h = 0xcbf29ce484222325ull;
  for (const char c : text) h = (h ^ static_cast<unsigned char>(c)) * 0x100000001b3ull;
  return mix64(h ^ text.size());
}

double to_normal(std::uint64_t identity) {
  for (std::uint64_t attempt = 0;; ++attempt) {
    const double x = 2 * to_unit(hash_identity({identity, attempt, 0})) - 1;
    const double y = 2 * to_unit(hash_identity({identity, attempt, 1})) - 1;
    const double s = x * x + y * y;
    if (s > 0 && s < 1) return x * std::sqrt(-2 * portable_log(s) / s);
  }
}

double portable_log(double x) {
  // x = m 2^k with m in [sqrt(1/2), sqrt(2)); ln m = 2 artanh z, z = (m - 1) / (m + 1), |z| < 0.1716.
  int k = 0;
  double m = std::frexp(x, &k);  // [0.5, 1)
  if (m < 0.70710678118654752) {
    m *= 2;
    --k;
  }
  const double z = (m - 1) / (m + 1), z2 = z * z;
  double sum = 0;  // z2 / 3 + z2^2 / 5 + ... ; the first term left out is below 1e-17
  for (int i = 21; i >= 3; i -= 2) sum = (sum + 1.0 / i) * z2;
  return k * ln2_high + (2 * z + (2 * z * sum + k * ln2_low));
}

double portable_exp(double x) {
  if (x > 709.7) return std::ldexp(1.0, 1023) * 2;  // infinity
  if (x < -745) return 0;
  const double k = std::floor(x * 1.4426950408889634 + 0.5);
  const double r = (x - k * ln2_high) - k * ln2_low;  // |r| <= 0.3466
  double sum = 0;                                     // Taylor, to r^16 / 16! < 1e-20
  for (int i = 16; i >= 1; --i) sum = (sum + 1) * r / i;
  return std::ldexp(1 + sum, static_cast<int>(k));
}

}  // namespace moomill
