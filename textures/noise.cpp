#include "textures/noise.h"

namespace moomill {

std::uint32_t hash_cell(int x, int y, int z, std::uint32_t seed) {
  std::uint32_t h = seed ^ (static_cast<std::uint32_t>(x) * 0x8da6b343u) ^
                    (static_cast<std::uint32_t>(y) * 0xd8163841u) ^ (static_cast<std::uint32_t>(z) * 0xcb1ab31fu);
  // A 32-bit finaliser with low bias (C. Wellons, "Prospecting for hash functions", 2018).
  h = (h ^ (h >> 16)) * 0x7feb352du;
  h = (h ^ (h >> 15)) * 0x846ca68bu;
  return h ^ (h >> 16);
}

namespace {

// The twelve edges of a cube, four of them twice.
constexpr double edges[16][3] = {{1, 1, 0}, {-1, 1, 0}, {1, -1, 0}, {-1, -1, 0}, {1, 0, 1},  {-1, 0, 1},
                                 {1, 0, -1}, {-1, 0, -1}, {0, 1, 1}, {0, -1, 1},  {0, 1, -1}, {0, -1, -1},
                                 {1, 1, 0}, {-1, 1, 0}, {0, -1, 1}, {0, -1, -1}};

double corner(std::uint32_t hash, double x, double y, double z) {
  const double* e = edges[hash & 15u];  // a table, not a switch: the hash is unforeseeable for the branch predictor
  return e[0] * x + e[1] * y + e[2] * z;
}

double fade(double t) {
  return t * t * t * (t * (t * 6 - 15) + 10);
}

}  // namespace

double gradient_noise(const dvec3& p, std::uint32_t seed) {
  const double fx = std::floor(p.x), fy = std::floor(p.y), fz = std::floor(p.z);
  const int x = static_cast<int>(fx), y = static_cast<int>(fy), z = static_cast<int>(fz);
  const double dx = p.x - fx, dy = p.y - fy, dz = p.z - fz;
  const double u = fade(dx), v = fade(dy), w = fade(dz);
  const auto at = [&](int i, int j, int k) {
    return corner(hash_cell(x + i, y + j, z + k, seed), dx - i, dy - j, dz - k);
  };
  const auto mix = [](double a, double b, double t) { return a + (b - a) * t; };
  const double low = mix(mix(at(0, 0, 0), at(1, 0, 0), u), mix(at(0, 1, 0), at(1, 1, 0), u), v);
  const double high = mix(mix(at(0, 0, 1), at(1, 0, 1), u), mix(at(0, 1, 1), at(1, 1, 1), u), v);
  return mix(low, high, w);
}

}  // namespace moomill
