#pragma once
// Random numbers keyed by identity: a number is a hash of what it is for (seed, key, frame, camera, pixel, ...), never
// the next of a shared stream. So it is the same in any order, on any number of threads, and on any machine: only
// integer and basic IEEE operations are used here, no std::hash, no std distributions, no libm.
#include <cstdint>
#include <initializer_list>
#include <string_view>

namespace moomill {

// One round of the splitmix64 finaliser (variant 13 of D. Stafford's search; Steele, Lea, Flood, OOPSLA 2014): a
// bijection of 64 bits whose every output bit depends on every input bit.
constexpr std::uint64_t mix64(std::uint64_t z) {
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebull;
  return z ^ (z >> 31);
}

// Hash of a tuple; depends on the order and the number of its parts.
std::uint64_t hash_identity(std::initializer_list<std::uint64_t> parts);

// Hash of a text or of bytes (FNV-1a, 64 bits, then mixed), to be a part of an identity.
std::uint64_t hash_text(std::string_view text);

// The upper 53 bits as a number in [0, 1).
constexpr double to_unit(std::uint64_t bits) {
  return static_cast<double>(bits >> 11) * 0x1.0p-53;
}

// A standard normal number of an identity (Marsaglia's polar method; attempts are numbered, so it stays keyed).
double to_normal(std::uint64_t identity);

// Natural logarithm of a positive, finite, normal number and exponential, to about 1e-15 relative, from basic
// operations only: libm may differ in the last bit from one machine to the next.
double portable_log(double x);
double portable_exp(double x);

}  // namespace moomill
