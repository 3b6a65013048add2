#include "generator/core/topology.h"

#include <algorithm>
#include <array>
#include <bit>
#include <numeric>
#include <unordered_map>

namespace moomill {
namespace {

template <class Bits, class Vec>
std::vector<std::uint32_t> weld_bits(const std::vector<Vec>& positions) {
  using Key = std::array<Bits, 3>;
  struct Hash {
    std::size_t operator()(const Key& k) const {
      std::uint64_t h = k[0];
      h = (h * 0x9e3779b97f4a7c15u) ^ k[1];
      h = (h * 0x9e3779b97f4a7c15u) ^ k[2];
      return h ^ (h >> 29);
    }
  };
  std::unordered_map<Key, std::uint32_t, Hash> known;
  known.reserve(2 * positions.size());
  std::vector<std::uint32_t> place(positions.size());
  for (std::size_t i = 0; i < positions.size(); ++i) {
    const Vec p = positions[i] + Vec(0);  // minus zero becomes zero
    const Key key{std::bit_cast<Bits>(p.x), std::bit_cast<Bits>(p.y), std::bit_cast<Bits>(p.z)};
    place[i] = known.try_emplace(key, static_cast<std::uint32_t>(known.size())).first->second;
  }
  return place;
}

}  // namespace

std::vector<std::uint32_t> weld(const std::vector<vec3>& positions) {
  return weld_bits<std::uint32_t>(positions);
}

std::vector<std::uint32_t> weld(const std::vector<dvec3>& positions) {
  return weld_bits<std::uint64_t>(positions);
}

DisjointSets::DisjointSets(std::size_t n) : root_(n) {
  std::iota(root_.begin(), root_.end(), 0u);
}

std::uint32_t DisjointSets::find(std::uint32_t v) {
  while (root_[v] != v) v = root_[v] = root_[root_[v]];
  return v;
}

void DisjointSets::join(std::uint32_t a, std::uint32_t b) {
  a = find(a), b = find(b);
  root_[std::max(a, b)] = std::min(a, b);
}

DisjointSets connected_vertices(std::size_t count, const std::vector<uvec3>& triangles,
                                const std::vector<std::uint32_t>& place) {
  const auto at = [&](std::uint32_t v) { return place.empty() ? v : place[v]; };
  DisjointSets sets(count);
  for (const uvec3& t : triangles) {
    sets.join(at(t.x), at(t.y));
    sets.join(at(t.y), at(t.z));
  }
  return sets;
}

std::vector<std::vector<std::uint32_t>> vertex_neighbours(std::size_t count, const std::vector<uvec3>& triangles,
                                                          const std::vector<std::uint32_t>& place) {
  const auto at = [&](std::uint32_t v) { return place.empty() ? v : place[v]; };
  std::vector<std::vector<std::uint32_t>> near(count);
  for (const uvec3& t : triangles)
    for (int k = 0; k < 3; ++k) {
      near[at(t[k])].push_back(at(t[(k + 1) % 3]));
      near[at(t[k])].push_back(at(t[(k + 2) % 3]));
    }
  for (auto& list : near) {
    std::sort(list.begin(), list.end());
    list.erase(std::unique(list.begin(), list.end()), list.end());
  }
  return near;
}

}  // namespace moomill
