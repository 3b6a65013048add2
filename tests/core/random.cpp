#include "generator/core/random.h"

#include <doctest/doctest.h>

#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <set>
#include <string_view>

using namespace moomill;

TEST_CASE("identities are pinned: a change here changes every dataset") {
  CHECK(mix64(0) == 0);
  CHECK(mix64(1) == 0x5692161d100b05e5ull);
  CHECK(hash_identity({}) == 0xe220a8397b1dcdafull);
  CHECK(hash_identity({1, 2, 3}) == 0xac4a3ed9fc9901f2ull);
  CHECK(hash_text("seed") == 0x8c539d5c5e853d27ull);
  CHECK(hash_identity({1, 2}) != hash_identity({2, 1}));
  CHECK(hash_identity({0}) != hash_identity({0, 0}));
  CHECK(hash_identity({0}) != 0);
  CHECK(hash_text("") != hash_text(std::string_view("\0", 1)));
  CHECK(hash_text("light.suns[0]") != hash_text("light.suns[1]"));
}

TEST_CASE("to_unit stays in the half-open unit interval") {
  CHECK(to_unit(0) == 0.0);
  CHECK(to_unit(~0ull) < 1.0);
  CHECK(to_unit(~0ull) == 1.0 - 0x1.0p-53);
}

TEST_CASE("neighbouring identities are uniform and uncorrelated") {
  // 64 bins over 2^18 consecutive frames; chi-squared with 63 degrees of freedom has sigma sqrt(126).
  constexpr int n = 1 << 18, bins = 64;
  std::array<int, bins> count{};
  double sum = 0, product = 0, previous = 0.5;
  for (int frame = 0; frame < n; ++frame) {
    const double u = to_unit(hash_identity({7, 11, static_cast<std::uint64_t>(frame), 3}));
    ++count[static_cast<int>(u * bins)];
    sum += u;
    product += (u - 0.5) * (previous - 0.5);
    previous = u;
  }
  double chi2 = 0;
  for (const int c : count) chi2 += (c - n / double(bins)) * (c - n / double(bins)) / (n / double(bins));
  CHECK(std::abs(chi2 - 63) < 5 * std::sqrt(126.0));
  CHECK(std::abs(sum / n - 0.5) < 5 * std::sqrt(1 / 12.0 / n));
  CHECK(std::abs(product / n) < 5 * (1 / 12.0) / std::sqrt(n));
}

TEST_CASE("flipping any bit of any part flips about half the output bits") {
  double flipped = 0;
  int cases = 0;
  for (int part = 0; part < 4; ++part)
    for (int bit = 0; bit < 64; ++bit)
      for (std::uint64_t base = 0; base < 16; ++base) {
        std::array<std::uint64_t, 4> a{base, 2 * base, 3, 4}, b = a;
        b[part] ^= 1ull << bit;
        const int d = std::popcount(hash_identity({a[0], a[1], a[2], a[3]}) ^ hash_identity({b[0], b[1], b[2], b[3]}));
        CHECK(d > 8);
        flipped += d;
        ++cases;
      }
  CHECK(std::abs(flipped / cases - 32) < 5 * 4 / std::sqrt(cases));
}

TEST_CASE("no collisions among 200,000 view identities") {
  std::set<std::uint64_t> seen;
  for (std::uint64_t frame = 0; frame < 1000; ++frame)
    for (std::uint64_t camera = 0; camera < 200; ++camera) seen.insert(hash_identity({1, 2, frame, camera}));
  CHECK(seen.size() == 200000);
}

TEST_CASE("portable logarithm and exponential agree with libm") {
  double worst_log = 0, worst_exp = 0;
  for (int i = 0; i < 20000; ++i) {
    const double u = to_unit(hash_identity({5, static_cast<std::uint64_t>(i)}));
    const double x = std::ldexp(1 + u, i % 2000 - 1000);
    worst_log = std::max(worst_log, std::abs(portable_log(x) - std::log(x)) / std::max(1.0, std::abs(std::log(x))));
    const double near_one = 1 + (u - 0.5) * 1e-3;
    worst_log =
        std::max(worst_log, std::abs(portable_log(near_one) - std::log(near_one)) / std::abs(std::log(near_one)));
    const double e = (u - 0.5) * 1400;
    worst_exp = std::max(worst_exp, std::abs(portable_exp(e) / std::exp(e) - 1));
  }
  CHECK(worst_log < 1e-15);
  CHECK(worst_exp < 1e-15);
  CHECK(portable_log(1) == 0);
  CHECK(portable_exp(0) == 1);
  CHECK(portable_exp(-1e9) == 0);
  CHECK(portable_exp(1e9) == std::numeric_limits<double>::infinity());
}

TEST_CASE("keyed normal numbers have mean 0, variance 1 and the normal's tails") {
  constexpr int n = 200000;
  double sum = 0, squares = 0;
  int beyond_2 = 0;
  for (int i = 0; i < n; ++i) {
    const double x = to_normal(hash_identity({9, static_cast<std::uint64_t>(i)}));
    sum += x;
    squares += x * x;
    beyond_2 += std::abs(x) > 2;
  }
  CHECK(std::abs(sum / n) < 5 / std::sqrt(n));
  CHECK(std::abs(squares / n - 1) < 5 * std::sqrt(2.0 / n));
  const double p = 0.0455003;
  CHECK(std::abs(beyond_2 / double(n) - p) < 5 * std::sqrt(p * (1 - p) / n));
}
