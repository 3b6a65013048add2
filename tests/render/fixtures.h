#pragma once
// Small scenes and statistics shared by the renderer's tests.
#include <doctest/doctest.h>

#include <functional>
#include <map>
#include <random>

#include "generator/render/bsdf.h"
#include "generator/render/path.h"

namespace moomill::test {

// A latitude-longitude sphere with smooth normals, one neutral coordinate per vertex, and UVs.
inline Surface sphere_surface(int rows, int columns, float radius = 1, bool inward = false) {
  Surface s;
  for (int i = 0; i <= rows; ++i)
    for (int j = 0; j <= columns; ++j) {
      const double theta = pi * i / rows, phi = 2 * pi * j / columns;
      const dvec3 n(std::sin(theta) * std::cos(phi), std::sin(theta) * std::sin(phi), std::cos(theta));
      s.rest.push_back(vec3(double(radius) * n));
      s.normals.push_back(vec3(inward ? -n : n));
      s.uvs.push_back({float(j) / columns, float(i) / rows});
    }
  auto add = [&](unsigned a, unsigned b, unsigned c) { s.triangles.push_back(inward ? uvec3(a, c, b) : uvec3(a, b, c)); };
  for (int i = 0; i < rows; ++i)
    for (int j = 0; j < columns; ++j) {
      const unsigned a = i * (columns + 1) + j, b = a + 1, c = a + columns + 1, d = c + 1;
      if (i > 0) add(a, c, b);
      if (i < rows - 1) add(b, c, d);
    }
  s.materials.assign(s.triangles.size(), 0);
  s.parts.assign(s.triangles.size(), 0);
  bake_nnopcs(s, s.rest, NnopcsNormalization::box);
  return s;
}

// A rectangle in the plane through `corner`, normal cross(u, v).
inline Surface plate_surface(const vec3& corner, const vec3& u, const vec3& v) {
  Surface s;
  const vec3 n = glm::normalize(glm::cross(u, v));
  s.rest = {corner, corner + u, corner + u + v, corner + v};
  s.normals = {n, n, n, n};
  s.uvs = {{0, 0}, {1, 0}, {1, 1}, {0, 1}};
  s.triangles = {{0, 1, 2}, {0, 2, 3}};
  s.materials = {0, 0};
  s.parts = {0, 0};
  bake_nnopcs(s, s.rest, NnopcsNormalization::box);
  return s;
}

// A bumpy, self-hiding test body made of random triangles around a sphere.
inline Surface thorny_surface(int triangles, unsigned seed) {
  Surface s;
  std::mt19937 random(seed);
  auto unit = [&] { return float(random() >> 8) * 0x1p-24f; };
  for (int i = 0; i < triangles; ++i) {
    const vec3 at(2 * unit() - 1, 2 * unit() - 1, 2 * unit() - 1);
    for (int k = 0; k < 3; ++k) {
      s.rest.push_back(at + 0.3f * vec3(unit() - 0.5f, unit() - 0.5f, unit() - 0.5f));
      s.normals.push_back({0, 0, 1});
      s.uvs.push_back({unit(), unit()});
    }
    const unsigned b = 3 * i;
    s.triangles.push_back({b, b + 1, b + 2});
    const vec3 n = glm::cross(s.rest[b + 1] - s.rest[b], s.rest[b + 2] - s.rest[b]);
    for (int k = 0; k < 3; ++k) s.normals[b + k] = glm::length(n) > 0 ? glm::normalize(n) : vec3(0, 0, 1);
  }
  s.materials.assign(triangles, 0);
  s.parts.assign(triangles, 0);
  bake_nnopcs(s, s.rest, NnopcsNormalization::box);
  return s;
}

inline Instance instance_of(const Surface& s, int animal, int material, const vec3& shift = vec3(0)) {
  Instance in;
  in.surface = &s;
  in.posed.positions = s.rest;
  for (vec3& p : in.posed.positions) p += shift;
  in.posed.normals = s.normals;
  in.materials = {material};
  in.animal = animal;
  return in;
}

// A finish with constant base colours, one per coat.
inline void add_material(Appearance& a, float roughness, float metallic, const std::vector<vec3>& coats) {
  Material m;
  m.roughness = roughness;
  m.metallic = metallic;
  m.paint = static_cast<int>(a.paints.size());
  Paint p;
  for (const vec3& c : coats) p.coats.push_back({c, -1, false});
  a.paints.push_back(std::make_shared<Paint>(p));
  a.materials.push_back(m);
  a.coat_count = static_cast<int>(coats.size());
}

// Looks from `eye` at `target`, Z up.
inline Camera look_at(const dvec3& eye, const dvec3& target, double focal_pixels, int width, int height) {
  Camera c;
  const dvec3 z = glm::normalize(target - eye);
  const dvec3 up = std::abs(z.z) > 0.99 ? dvec3(0, 1, 0) : dvec3(0, 0, 1);
  const dvec3 x = glm::normalize(glm::cross(z, up)), y = glm::cross(z, x);
  c.world_to_camera = glm::transpose(dmat3(x, y, z));
  c.centre = eye;
  c.fx = c.fy = focal_pixels;
  c.cx = 0.5 * width;
  c.cy = 0.5 * height;
  c.width = width;
  c.height = height;
  return c;
}

// Upper tail of the chi-squared distribution (Wilson & Hilferty 1931), good to a percent where it matters here.
inline double chi_squared_p(double statistic, double freedom) {
  const double z = (std::cbrt(statistic / freedom) - (1 - 2 / (9 * freedom))) / std::sqrt(2 / (9 * freedom));
  return 0.5 * std::erfc(z / std::sqrt(2.0));
}

// Pearson's test of directions drawn by `draw` (false: the sample failed) against the density `pdf` over the sphere.
// Cells are cut along theta and phi around `axis_z`; the density is integrated numerically in each.
inline double chi_squared_of_directions(const std::function<bool(vec2, vec3&)>& draw, const std::function<double(const vec3&)>& pdf,
                                        const Frame& frame, const std::vector<double>& cos_edges, int phi_cells, int samples,
                                        unsigned seed, double* pdf_mass = nullptr, int sub_cells = 24) {
  const int rows = static_cast<int>(cos_edges.size()) - 1;
  std::vector<double> expected(rows * phi_cells, 0.0), observed(rows * phi_cells, 0.0);
  const int sub = sub_cells;
  double mass = 0;
  for (int r = 0; r < rows; ++r)
    for (int p = 0; p < phi_cells; ++p) {
      double sum = 0;
      for (int a = 0; a < sub; ++a)
        for (int b = 0; b < sub; ++b) {
          const double z = cos_edges[r] + (cos_edges[r + 1] - cos_edges[r]) * (a + 0.5) / sub;
          const double phi = 2 * pi * (p + (b + 0.5) / sub) / phi_cells, s = std::sqrt(std::max(0.0, 1 - z * z));
          sum += pdf(frame.to_world(vec3(dvec3(s * std::cos(phi), s * std::sin(phi), z))));
        }
      const double cell = sum / (sub * sub) * std::abs(cos_edges[r + 1] - cos_edges[r]) * 2 * pi / phi_cells;
      expected[r * phi_cells + p] = cell * samples;
      mass += cell;
    }
  if (pdf_mass) *pdf_mass = mass;
  std::mt19937 random(seed);
  double failed = 0;
  for (int i = 0; i < samples; ++i) {
    const float u = float(random() >> 8) * 0x1p-24f, v = float(random() >> 8) * 0x1p-24f;
    vec3 d;
    if (!draw({u, v}, d)) {
      ++failed;
      continue;
    }
    const vec3 l = frame.to_local(d);
    int r = 0;
    while (r < rows - 1 && !((l.z - cos_edges[r]) * (l.z - cos_edges[r + 1]) <= 0)) ++r;
    double phi = std::atan2(l.y, l.x);
    if (phi < 0) phi += 2 * pi;
    observed[r * phi_cells + std::min(phi_cells - 1, int(phi / (2 * pi) * phi_cells))] += 1;
  }
  // Cells that expect fewer than five are pooled; failed samples are a cell of their own, expecting the missing mass.
  double statistic = 0, pooled_expected = std::max(0.0, samples - mass * samples), pooled_observed = failed;
  int cells = 0;
  for (std::size_t i = 0; i < expected.size(); ++i) {
    if (expected[i] < 5) {
      pooled_expected += expected[i];
      pooled_observed += observed[i];
      continue;
    }
    statistic += (observed[i] - expected[i]) * (observed[i] - expected[i]) / expected[i];
    ++cells;
  }
  if (pooled_expected >= 5) {
    statistic += (pooled_observed - pooled_expected) * (pooled_observed - pooled_expected) / pooled_expected;
    ++cells;
  }
  return chi_squared_p(statistic, std::max(1, cells - 1));
}

}  // namespace moomill::test
