// The finish: normals and roughness baked from the hair, against what a plane must have.
#include "textures/finish.h"

#include <doctest/doctest.h>

#include "generator/core/parallel.h"
#include "scenes/scene.h"
#include "textures/coat.h"

using namespace moomill;

namespace {

// A square of 0.3 m in z = 0, subdivided a little; `mirrored`: u runs against x, so the UVs are turned over.
Surface plane(bool mirrored) {
  Surface s;
  constexpr int n = 8;
  for (int y = 0; y <= n; ++y)
    for (int x = 0; x <= n; ++x) {
      s.rest.push_back({0.3f * x / n, 0.3f * y / n, 0});
      s.normals.push_back({0, 0, 1});
      const float u = static_cast<float>(x) / n, v = static_cast<float>(y) / n;
      s.uvs.push_back({mirrored ? 1 - u : u, v});
    }
  for (int y = 0; y < n; ++y)
    for (int x = 0; x < n; ++x) {
      const std::uint32_t a = y * (n + 1) + x;
      s.triangles.push_back({a, a + 1, a + n + 2});
      s.triangles.push_back({a, a + n + 2, a + n + 1});
    }
  s.parts.assign(s.triangles.size(), 0);
  s.materials.assign(s.triangles.size(), 0);
  return s;
}

// As the renderer reads it (generator/render/path.cpp) where the surface lies in z = 0 and u runs along +x or -x.
dvec3 world_normal(const Image8& normal, int x, int y, bool mirrored) {
  dvec3 local;
  for (int c = 0; c < 3; ++c) local[c] = normal.at(x, y, c) / 127.5 - 1;
  const double det = mirrored ? -1 : 1;
  const dvec3 n(0, 0, 1), tx(det, 0, 0);  // along u
  const dvec3 ty = glm::cross(n, tx) * (det < 0 ? 1.0 : -1.0);
  return glm::normalize(local.x * tx + local.y * ty + local.z * n);
}

Finish hair_along_x() {
  Finish f;
  f.hair.direction = {1, 0, 0};
  f.hair.smoothing = 0;
  f.clump_slope = 0;
  return f;
}

}  // namespace

TEST_CASE("Normals of the finish are unit, slope as steep as asked across the hair, and point where the hair's shape does") {
  for (const bool mirrored : {false, true}) {
    const Surface s = plane(mirrored);
    const Finish finish = hair_along_x();
    Hide hide = make_hide(s, {"torso"}, finish.hair);
    constexpr int n = 512;
    const FinishMaps maps = bake_finish(finish, hide, map_texels(hide, n));
    double across = 0, along = 0, error = 0, longest = 0, shortest = 9;
    int count = 0;
    const double height = finish.tuft_slope * finish.hair.tuft_width / 1.45, e = 1e-5;
    for (int y = 8; y < n - 8; y += 3)
      for (int x = 8; x < n - 8; x += 3) {
        dvec3 local;
        for (int c = 0; c < 3; ++c) local[c] = maps.normal.at(x, y, c) / 127.5 - 1;
        longest = std::max(longest, glm::length(local));
        shortest = std::min(shortest, glm::length(local));
        const dvec3 w = world_normal(maps.normal, x, y, mirrored);
        across += w.y / w.z * (w.y / w.z);
        along += w.x / w.z * (w.x / w.z);
        // The plain way: central differences of the height at the texel.
        const double u = (x + 0.5) / n;
        const dvec3 at(0.3 * (mirrored ? 1 - u : u), 0.3 * (y + 0.5) / n, 0);
        const auto h = [&](const dvec3& p) { return height * hair_streak(finish.hair, p, {1, 0, 0}); };
        const double dx = (h(at + dvec3(e, 0, 0)) - h(at - dvec3(e, 0, 0))) / (2 * e),
                     dy = (h(at + dvec3(0, e, 0)) - h(at - dvec3(0, e, 0))) / (2 * e);
        error += glm::length(w - glm::normalize(dvec3(-dx, -dy, 1)));
        ++count;
      }
    CHECK(longest < 1.01);
    CHECK(shortest > 0.99);
    CHECK(std::sqrt(across / count) == doctest::Approx(finish.tuft_slope).epsilon(0.2));
    CHECK(std::sqrt(along / count) < 0.75 * std::sqrt(across / count));
    CHECK(error / count < 0.05);  // 8 bits, and a one-sided difference
  }
}

TEST_CASE("What is too fine for the texels becomes roughness") {
  const Surface s = plane(false);
  const Finish finish = hair_along_x();
  Hide hide = make_hide(s, {"torso"}, finish.hair);
  const FinishMaps fine = bake_finish(finish, hide, map_texels(hide, 512)),
                   coarse = bake_finish(finish, hide, map_texels(hide, 16));
  double fine_mean = 0, coarse_mean = 0;
  for (const auto b : fine.roughness.data) fine_mean += b / 255.0 / fine.roughness.data.size();
  for (const auto b : coarse.roughness.data) coarse_mean += b / 255.0 / coarse.roughness.data.size();
  CHECK(fine_mean == doctest::Approx(finish.roughness).epsilon(0.02));
  const double alpha = finish.roughness * finish.roughness;
  CHECK(coarse_mean == doctest::Approx(std::pow(alpha * alpha + finish.tuft_slope * finish.tuft_slope, 0.25)).epsilon(0.02));
  CHECK(coarse.normal.at(8, 8, 0) == 128);
  CHECK(coarse.normal.at(8, 8, 1) == 128);
  CHECK(coarse.normal.at(8, 8, 2) == 255);
}

TEST_CASE("The cow's finish is the same for any number of threads, and continuous across UV seams") {
  const Species cow = read_species("cow", NnopcsNormalization::box, ".");
  const Finish finish = read_finish("cow");
  REQUIRE(finish.parts.size() >= 5);
  const Surface& s = cow.rig.surface;
  const auto run = [&](int threads, int resolution) {
    tbb::task_arena arena(threads);
    return arena.execute([&] {
      Hide hide = make_hide(s, cow.rig.part_names, finish.hair);
      return bake_finish(finish, hide, map_texels(hide, resolution));
    });
  };
  const FinishMaps one = run(1, 256), two = run(2, 256);
  CHECK(one.normal.data == two.normal.data);
  CHECK(one.roughness.data == two.roughness.data);

  // Eyes are glossy, hair is not.
  int lowest = 255, highest = 0;
  for (const auto b : one.roughness.data) lowest = std::min<int>(lowest, b), highest = std::max<int>(highest, b);
  CHECK(lowest < 40);
  CHECK(highest > 140);

  Hide hide = make_hide(s, cow.rig.part_names, finish.hair);
  const FinishMaps large = run(2, 1024);
  const auto texel = [&](std::uint32_t v) {
    const int x = std::clamp(static_cast<int>(s.uvs[v].x * 1024), 0, 1023), y = std::clamp(static_cast<int>(s.uvs[v].y * 1024), 0, 1023);
    return int(large.roughness.at(x, y));
  };
  std::vector<std::int64_t> first(hide.welded_count, -1);
  int pairs = 0, far = 0;
  for (std::uint32_t v = 0; v < s.rest.size(); ++v) {
    std::int64_t& f = first[hide.welded[v]];
    if (f < 0) {
      f = v;
      continue;
    }
    ++pairs;
    far += std::abs(texel(v) - texel(static_cast<std::uint32_t>(f))) > 24;
  }
  REQUIRE(pairs > 300);
  CHECK(far < 0.02 * pairs);
}

TEST_CASE("Borders of patches are as ragged as asked, and hair reaches over those it crosses") {
  const Species cow = read_species("cow", NnopcsNormalization::box, ".");
  Hide hide = make_hide(cow.rig.surface, cow.rig.part_names, read_finish("cow").hair);
  const auto coat = [&](double raggedness, double fringe) {
    ProceduralCoat c;
    PatchPattern p;
    p.raggedness = raggedness;
    p.fringe = fringe;
    c.base = p;
    return ready_coat(c, hide);
  };
  const ReadyCoat smooth = coat(0, 0), ragged = coat(0.02, 0), fringed = coat(0, 0.02);
  double lobes = 0, hairs = 0, mean = 0;
  int near = 0;
  std::vector<float> inside;
  for (const Hide::Sample& sample : hide.samples) {
    const HidePoint p = hide_point(hide, sample.triangle, dvec3(sample.weights), inside);
    const double depth = patch_depth(smooth, p);
    if (std::abs(depth) > 0.01) continue;
    ++near;
    lobes += std::pow(patch_depth(ragged, p) - depth, 2);
    mean += patch_depth(ragged, p) - depth;
    hairs += std::pow(patch_depth(fringed, p) - depth, 2);
  }
  REQUIRE(near > 150);
  CHECK(std::sqrt(lobes / near) > 0.3 * 0.02);
  CHECK(std::sqrt(lobes / near) < 1.0 * 0.02);
  CHECK(std::abs(mean / near) < 0.2 * 0.02);  // patches keep their size
  CHECK(std::sqrt(hairs / near) > 0.1 * 0.02);
  CHECK(std::sqrt(hairs / near) < 0.7 * 0.02);
}
