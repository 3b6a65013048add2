// Voxel solids and diffusion on bodies whose answers are known.
#include "rigs/skin_weights.h"

#include <doctest/doctest.h>

#include <numeric>

using namespace moomill;

namespace {

struct Mesh {
  std::vector<dvec3> positions;
  std::vector<uvec3> triangles;
};

void add_box(Mesh& mesh, const dvec3& lower, const dvec3& upper, bool open_top = false) {
  const std::uint32_t first = static_cast<std::uint32_t>(mesh.positions.size());
  for (int i = 0; i < 8; ++i)
    mesh.positions.emplace_back(i & 1 ? upper.x : lower.x, i & 2 ? upper.y : lower.y, i & 4 ? upper.z : lower.z);
  constexpr int faces[6][4] = {{0, 2, 3, 1}, {0, 1, 5, 4}, {1, 3, 7, 5}, {3, 2, 6, 7}, {2, 0, 4, 6}, {4, 5, 7, 6}};
  for (int f = 0; f < (open_top ? 5 : 6); ++f) {
    mesh.triangles.emplace_back(first + faces[f][0], first + faces[f][1], first + faces[f][2]);
    mesh.triangles.emplace_back(first + faces[f][0], first + faces[f][2], first + faces[f][3]);
  }
}

// A bar along x from 0 to 1, 0.2 thick.
Mesh bar() {
  Mesh mesh;
  add_box(mesh, {0, -0.1, -0.1}, {1, 0.1, 0.1});
  return mesh;
}

}  // namespace

TEST_CASE("A box encloses its volume, also doubled, turned inside out or open at the top") {
  Mesh plain, open;
  add_box(plain, {0, 0, 0}, {1, 0.5, 0.5});
  add_box(open, {0, 0, 0}, {1, 0.5, 0.5}, true);
  Mesh doubled = plain;
  for (const uvec3& t : plain.triangles) doubled.triangles.emplace_back(t.x, t.z, t.y);
  Mesh flipped = plain;
  for (uvec3& t : flipped.triangles) std::swap(t.y, t.z);
  for (const Mesh* mesh : {&plain, &open, &doubled, &flipped}) {
    const VoxelSolid solid = voxelise(mesh->positions, mesh->triangles, 0.02);
    const double inside = static_cast<double>(solid.enclosed()) * std::pow(0.02, 3);
    const double all = static_cast<double>(solid.places.size()) * std::pow(0.02, 3);
    CHECK(inside < 0.25);
    CHECK(all > 0.25);
    CHECK(inside == doctest::Approx(0.25).epsilon(0.15));
    const int middle = solid.find({0.5, 0.25, 0.25}, 0);
    REQUIRE(middle >= 0);
    CHECK(solid.thickness[middle] == doctest::Approx(0.25).epsilon(0.1));
    CHECK(solid.closed_gap == 0);
  }
}

TEST_CASE("A single sheet encloses nothing") {
  const std::vector<dvec3> positions{{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}};
  CHECK(voxelise(positions, {{0, 1, 2}, {0, 2, 3}}, 0.05).enclosed() == 0);
  CHECK(voxelise({}, {}, 0.05).places.empty());
}

TEST_CASE("Weights are a partition of one and fall off as the screened Laplace equation says") {
  // Long bar, seeds split at x = 0.5, constant smoothing length s: along the bar w'' = (w - p) / s^2 with no flow at the
  // ends, so w = 1 - cosh(x / s) / (2 cosh(0.5 / s)) on the near half.
  const Mesh mesh = bar();
  const VoxelSolid solid = voxelise(mesh.positions, mesh.triangles, 0.01);
  Seeds seeds(solid.places.size() * 2);
  for (std::size_t i = 0; i < solid.places.size(); ++i) seeds[2 * i + (solid.centre(i).x > 0.5)] = 1;
  DiffusionOptions options;
  options.reach = 100;  // everywhere the most
  options.slope = 0;
  const double thickest = *std::max_element(solid.thickness.begin(), solid.thickness.end());
  const double s = 0.1;
  options.most = s / thickest;
  std::vector<dvec3> points;
  for (int k = 0; k <= 10; ++k) points.emplace_back(0.05 * k, 0.1, 0.03);
  const std::vector<double> w = diffuse_weights(solid, seeds, 2, points, options);
  for (std::size_t k = 0; k < points.size(); ++k) {
    const double expected = 1 - std::cosh(points[k].x / s) / (2 * std::cosh(0.5 / s));
    CHECK(w[2 * k] + w[2 * k + 1] == doctest::Approx(1));
    CHECK(w[2 * k] == doctest::Approx(expected).epsilon(0.03));
  }
}

TEST_CASE("Nothing leaks between two legs that only the body joins, however near they are") {
  Mesh mesh;  // a body with two legs 0.03 apart
  add_box(mesh, {-0.3, -0.3, 0.5}, {0.3, 0.3, 0.9});
  add_box(mesh, {-0.1, 0.015, 0}, {0.1, 0.2, 0.55});
  add_box(mesh, {-0.1, -0.2, 0}, {0.1, -0.015, 0.55});
  const VoxelSolid solid = voxelise(mesh.positions, mesh.triangles, 0.01);
  const std::vector<BoneSegment> bones{{0, {-0.3, 0, 0.7}, {0.3, 0, 0.7}, 0.25},
                                       {1, {0, 0.1, 0.5}, {0, 0.1, 0}, 0.1},
                                       {2, {0, -0.1, 0.5}, {0, -0.1, 0}, 0.1}};
  const Seeds seeds = seeds_of_bones(solid, bones, 3);
  const std::vector<double> w = diffuse_weights(solid, seeds, 3, {{0, 0.015, 0.05}, {0, -0.015, 0.05}, {0, 0.3, 0.7}});
  CHECK(w[1] > 0.99);
  CHECK(w[2] < 0.001);
  CHECK(w[3 + 2] > 0.99);
  CHECK(w[3 + 1] < 0.001);
  CHECK(w[6] > 0.8);
}

TEST_CASE("Bones share a bar in the middle between them") {
  const Mesh mesh = bar();
  const VoxelSolid solid = voxelise(mesh.positions, mesh.triangles, 0.02);
  const Seeds seeds = seeds_of_bones(solid, {{0, {0, 0, 0}, {0.3, 0, 0}, 0.1}, {1, {0.7, 0, 0}, {1, 0, 0}, 0.1}}, 2);
  for (std::size_t i = 0; i < solid.places.size(); ++i) {
    const double x = solid.centre(i).x;
    if (std::abs(x - 0.5) > 0.03) CHECK(seeds[2 * i] == (x < 0.5 ? 1.0f : 0.0f));
  }
}

TEST_CASE("Four influences stay, and none jumps where the fourth and the fifth change places") {
  const std::vector<double> before{0.4, 0.3, 0.2, 0.0501, 0.0499}, after{0.4, 0.3, 0.2, 0.0499, 0.0501};
  std::vector<double> a(5, 0.0), b(5, 0.0);
  double sum = 0;
  const std::vector<Influence> left = strongest_influences(before.data(), 5);
  CHECK(left.size() <= 4);
  for (const Influence& i : left) a[i.bone] = i.weight, sum += i.weight;
  for (const Influence& i : strongest_influences(after.data(), 5)) b[i.bone] = i.weight;
  CHECK(sum == doctest::Approx(1));
  for (int j = 0; j < 5; ++j) CHECK(std::abs(a[j] - b[j]) < 1e-3);
}
