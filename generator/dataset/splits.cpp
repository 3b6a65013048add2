// Training, validation and test frames, as the public loader draws them.
#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "generator/dataset/dataset.h"

namespace moomill {
namespace {

// MT19937 of Matsumoto and Nishimura (1998), seeded by init_genrand() as NumPy's RandomState(seed) does.
class MersenneTwister {
 public:
  explicit MersenneTwister(std::uint32_t seed) {
    state_[0] = seed;
    for (std::uint32_t i = 1; i < n; ++i) state_[i] = 1812433253u * (state_[i - 1] ^ (state_[i - 1] >> 30)) + i;
  }
  std::uint32_t next() {
    if (at_ == n) refill();
    std::uint32_t y = state_[at_++];
    y ^= y >> 11;
    y ^= (y << 7) & 0x9d2c5680u;
    y ^= (y << 15) & 0xefc60000u;
    return y ^ (y >> 18);
  }

 private:
  static constexpr std::uint32_t n = 624, m = 397;
  void refill() {
    for (std::uint32_t i = 0; i < n; ++i) {
      const std::uint32_t y = (state_[i] & 0x80000000u) | (state_[(i + 1) % n] & 0x7fffffffu);
      state_[i] = state_[(i + m) % n] ^ (y >> 1) ^ ((y & 1u) ? 0x9908b0dfu : 0u);
    }
    at_ = 0;
  }
  std::array<std::uint32_t, n> state_{};
  std::uint32_t at_ = n;
};

// Uniform in [0, max]: masked rejection, as in NumPy's legacy shuffle.
std::uint32_t interval(MersenneTwister& random, std::uint32_t max) {
  if (max == 0) return 0;
  std::uint32_t mask = max;
  for (int shift = 1; shift <= 16; shift *= 2) mask |= mask >> shift;
  std::uint32_t value;
  do value = random.next() & mask;
  while (value > max);
  return value;
}

constexpr int chunk_frames = 10;
constexpr int nepumoo_chunks = 91, nepumoo_train = 63, nepumoo_validate = 9;

}  // namespace

std::vector<int> numpy_permutation(std::uint32_t seed, int n) {
  std::vector<int> order(static_cast<std::size_t>(std::max(n, 0)));
  std::iota(order.begin(), order.end(), 0);
  MersenneTwister random(seed);
  for (int i = n - 1; i >= 1; --i) std::swap(order[i], order[interval(random, static_cast<std::uint32_t>(i))]);
  return order;
}

Splits make_splits(const std::vector<int>& frames) {
  Splits splits;
  const int count = static_cast<int>(frames.size());
  if (count < chunk_frames) {  // too few to split
    splits.test = frames;
    return splits;
  }
  const int chunks = (count + chunk_frames - 1) / chunk_frames;  // the last one may be short
  const auto share = [&](int part) { return static_cast<int>(std::lround(double(part) * chunks / nepumoo_chunks)); };
  const int train = share(nepumoo_train), validate = share(nepumoo_validate);
  const std::vector<int> order = numpy_permutation(0, chunks);
  for (int k = 0; k < chunks; ++k) {
    std::vector<int>& split = k < train ? splits.train : k < train + validate ? splits.validate : splits.test;
    for (int i = order[k] * chunk_frames; i < std::min(count, (order[k] + 1) * chunk_frames); ++i)
      split.push_back(frames[i]);
  }
  for (std::vector<int>* split : {&splits.train, &splits.validate, &splits.test})
    std::sort(split->begin(), split->end());
  return splits;
}

}  // namespace moomill
