// Flattening, cutting and packing of charts, on surfaces whose flat maps are known.
#include "rigs/unwrap.h"

#include <doctest/doctest.h>

#include <cmath>
#include <numeric>

#include "generator/core/error.h"
#include "rigs/mesh_checks.h"

using namespace moomill;

namespace {

struct Sheet {
  std::vector<dvec3> positions;
  std::vector<uvec3> triangles;
};

// n x m quads over the unit square of parameters.
template <class Place>
Sheet sheet(int n, int m, const Place& place) {
  Sheet s;
  for (int y = 0; y <= m; ++y)
    for (int x = 0; x <= n; ++x) s.positions.push_back(place(double(x) / n, double(y) / m));
  for (int y = 0; y < m; ++y)
    for (int x = 0; x < n; ++x) {
      const auto at = [&](int a, int b) { return static_cast<std::uint32_t>((y + b) * (n + 1) + x + a); };
      s.triangles.emplace_back(at(0, 0), at(1, 0), at(1, 1));
      s.triangles.emplace_back(at(0, 0), at(1, 1), at(0, 1));
    }
  return s;
}

// All of it, flat along z to begin with.
Chart whole(const Sheet& s) {
  Chart c;
  c.triangles.resize(s.triangles.size());
  c.vertices.resize(s.positions.size());
  std::iota(c.triangles.begin(), c.triangles.end(), 0u);
  std::iota(c.vertices.begin(), c.vertices.end(), 0u);
  for (const dvec3& p : s.positions) c.flat.emplace_back(p.x, p.y);
  return c;
}

Surface as_surface(const Sheet& sheet, const std::vector<Chart>& charts) {
  Surface s;
  for (const Chart& c : charts) {
    const auto first = static_cast<std::uint32_t>(s.rest.size());
    for (std::size_t i = 0; i < c.vertices.size(); ++i) {
      s.rest.emplace_back(sheet.positions[c.vertices[i]]);
      s.uvs.emplace_back(static_cast<float>(c.flat[i].x), static_cast<float>(1 - c.flat[i].y));
    }
    for (const std::uint32_t t : c.triangles) {
      uvec3 v;
      for (int k = 0; k < 3; ++k)
        v[k] = first + static_cast<std::uint32_t>(
                           std::lower_bound(c.vertices.begin(), c.vertices.end(), sheet.triangles[t][k]) -
                           c.vertices.begin());
      s.triangles.push_back(v);
    }
  }
  return s;
}

Sheet half_tube() {
  return sheet(40, 40, [](double u, double v) {
    const double a = pi * (0.05 + 0.9 * u);
    return dvec3(-std::cos(a), 2 * v, std::sin(a));
  });
}

}  // namespace

TEST_CASE("A half tube unrolls without stretch") {
  const Sheet s = half_tube();
  Chart c = whole(s);
  flatten_rigidly(c, s.positions, s.triangles, 60);
  const Stretch stretch = measure_stretch(c, s.positions, s.triangles);
  CHECK(!stretch.turned_over);
  CHECK(stretch.worst < 1.01);
  CHECK(stretch.uneven == 0);
  CHECK(!border_crosses(c, s.triangles));
  const double diagonal = glm::length(c.flat.back() - c.flat.front());
  CHECK(diagonal == doctest::Approx(std::hypot(2, 0.9 * pi)).epsilon(0.003));
}

TEST_CASE("A cap of a sphere keeps its area, and its stretch is what curvature asks for") {
  const Sheet s = sheet(30, 30, [](double u, double v) {
    const double x = 0.8 * (u - 0.5), y = 0.8 * (v - 0.5);
    return dvec3(x, y, std::sqrt(1 - x * x - y * y));
  });
  Chart c = whole(s);
  flatten_rigidly(c, s.positions, s.triangles, 60);
  const Stretch stretch = measure_stretch(c, s.positions, s.triangles);
  CHECK(stretch.worst > 1.01);
  CHECK(stretch.worst < 1.12);
  CHECK(stretch.uneven == 0);
  double area = 0, flat = 0;
  for (const uvec3& t : s.triangles) {
    area += glm::length(glm::cross(s.positions[t.y] - s.positions[t.x], s.positions[t.z] - s.positions[t.x]));
    const dvec2 b = c.flat[t.y] - c.flat[t.x], d = c.flat[t.z] - c.flat[t.x];
    flat += b.x * d.y - b.y * d.x;
  }
  CHECK(flat == doctest::Approx(area));
}

TEST_CASE("Stretch and crossing borders are measured for what they are") {
  const Sheet s = sheet(8, 8, [](double u, double v) { return dvec3(u, v, 0); });
  Chart c = whole(s);
  for (dvec2& p : c.flat) p.x *= 2;
  CHECK(measure_stretch(c, s.positions, s.triangles).worst == doctest::Approx(2));
  CHECK(measure_stretch(c, s.positions, s.triangles).uneven == doctest::Approx(1));
  for (dvec2& p : c.flat) p.x *= -0.5;
  CHECK(measure_stretch(c, s.positions, s.triangles).turned_over);
  // A ribbon bent so far around a ring that its ends overlap; less far, they do not.
  const Sheet ribbon = sheet(60, 4, [](double u, double v) { return dvec3(u, v, 0); });
  const auto bent = [&](double turns) {
    Chart r = whole(ribbon);
    for (std::size_t i = 0; i < r.flat.size(); ++i) {
      const dvec3& p = ribbon.positions[i];
      const double a = -2 * pi * turns * p.x, radius = 1 + p.y;
      r.flat[i] = {radius * std::cos(a), radius * std::sin(a)};
    }
    return border_crosses(r, ribbon.triangles);
  };
  CHECK(!bent(0.9));
  CHECK(bent(1.1));
}

TEST_CASE("A tube is cut into few charts, and their atlas is sound") {
  // Closed around: no chart can take all of it.
  Sheet s = sheet(80, 40, [](double u, double v) {
    return dvec3(-0.3 * std::cos(2 * pi * u), v, 0.3 * std::sin(2 * pi * u));
  });
  for (uvec3& t : s.triangles)
    for (int k = 0; k < 3; ++k)
      if (t[k] % 81 == 80) t[k] -= 80;
  std::vector<Chart> charts = cut_charts(s.positions, s.triangles);
  CHECK(charts.size() >= 2);
  CHECK(charts.size() <= 8);
  std::size_t covered = 0;
  for (const Chart& c : charts) {
    covered += c.triangles.size();
    CHECK(measure_stretch(c, s.positions, s.triangles).worst < 1.1);
    CHECK(!border_crosses(c, s.triangles));
  }
  CHECK(covered == s.triangles.size());
  pack_charts(charts, s.triangles, 0.008);
  const AtlasChecks a = check_atlas(as_surface(s, charts), 2048);
  CHECK(a.outside == 0);
  CHECK(a.twice == 0);
  CHECK(a.mirrored == 0);
  CHECK(a.charts == charts.size());
  CHECK(a.gutter_texels >= 0.008 * 2048);
  CHECK(a.density_spread() < 1.05);
  CHECK(a.occupancy() > 0.4);
}

TEST_CASE("Packing: squares of many sizes fill most of the atlas; charts too many for their gutter are refused") {
  Sheet s;
  std::vector<Chart> charts;
  for (int i = 0; i < 40; ++i) {
    const double side = 0.05 + 0.01 * (i * 7 % 40);
    const Sheet one = sheet(2, 2, [&](double u, double v) { return dvec3(side * u, side * v, i); });
    Chart c = whole(one);
    for (std::uint32_t& t : c.triangles) t += static_cast<std::uint32_t>(s.triangles.size());
    for (std::uint32_t& v : c.vertices) v += static_cast<std::uint32_t>(s.positions.size());
    for (const uvec3& t : one.triangles) s.triangles.push_back(t + static_cast<std::uint32_t>(s.positions.size()));
    s.positions.insert(s.positions.end(), one.positions.begin(), one.positions.end());
    charts.push_back(c);
  }
  std::vector<Chart> packed = charts;
  pack_charts(packed, s.triangles, 0.004);
  const AtlasChecks a = check_atlas(as_surface(s, packed), 4096);
  CHECK(a.outside == 0);
  CHECK(a.twice == 0);
  CHECK(a.occupancy() > 0.75);
  CHECK(a.gutter_texels >= 0.004 * 4096);
  CHECK(a.density_spread() == doctest::Approx(1).epsilon(1e-3));
  CHECK_THROWS_WITH_AS(pack_charts(charts, s.triangles, 0.2), doctest::Contains("gutter"), InputError);
}
