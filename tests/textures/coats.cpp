// Coats: the pattern functions, baking, and the coats that ship.
#include <doctest/doctest.h>

#include <array>
#include <map>

#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "scenes/scene.h"
#include "textures/coat.h"

using namespace moomill;

namespace {

const Species& cow() {
  static const Species species = read_species("cow", NnopcsNormalization::box, ".");
  return species;
}

const ProceduralCoat& shipped(const std::string& name, std::map<std::string, Coat>& store) {
  return std::get<ProceduralCoat>(store.try_emplace(name, read_coat(name, "cow", ".")).first->second.source);
}

Hide& cow_hide() {
  static Hide hide = make_hide(cow().rig.surface, cow().rig.part_names, read_finish("cow").hair);
  return hide;
}

Image8 bake(const std::string& name, int resolution) {
  std::map<std::string, Coat> store;
  return bake_coat(shipped(name, store), cow_hide(), resolution);
}

// A coat worn by nobody in particular: no surface to fit patches to, no parts.
vec3 color_in_space(const ProceduralCoat& coat, const dvec3& at) {
  static const Surface nobody;
  static const Hide hide = make_hide(nobody, {});
  HidePoint p;
  p.at = at;
  return coat_color(ready_coat(coat, hide), p);
}

// Bilinear, texel centres at half integers; (0, 0) is the top left corner.
dvec3 lookup(const Image8& image, const vec2& uv) {
  const double x = uv.x * image.width - 0.5, y = uv.y * image.height - 0.5;
  const int x0 = static_cast<int>(std::floor(x)), y0 = static_cast<int>(std::floor(y));
  dvec3 sum(0);
  for (int k = 0; k < 4; ++k) {
    const int u = std::clamp(x0 + (k & 1), 0, image.width - 1), v = std::clamp(y0 + (k >> 1), 0, image.height - 1);
    const double w = ((k & 1) ? x - x0 : 1 - (x - x0)) * ((k >> 1) ? y - y0 : 1 - (y - y0));
    for (int c = 0; c < 3; ++c) sum[c] += w * image.at(u, v, c);
  }
  return sum;
}

// Share of texels where some channel differs by more than `levels`.
double share_differing(const Image8& a, const Image8& b, int levels) {
  std::size_t differ = 0;
  for (std::size_t i = 0; i < a.data.size(); i += 3) {
    int most = 0;
    for (int c = 0; c < 3; ++c) most = std::max(most, std::abs(int(a.data[i + c]) - int(b.data[i + c])));
    differ += most > levels;
  }
  return 3.0 * static_cast<double>(differ) / static_cast<double>(a.data.size());
}

}  // namespace

TEST_CASE("Twelve coats ship, in the order of their index, and all bake") {
  const std::vector<std::string> names = shipped_coats("cow");
  REQUIRE(names.size() == 12);
  const std::array<std::string, 12> begin = {
      "00_holstein", "01_brown_spotted", "02_brown_freckled", "03_white", "04_black_freckled", "05_holstein",
      "06_holstein", "07_holstein",      "08_holstein",       "09_grey",  "10_white",          "11_limousin"};
  std::map<std::string, Image8> baked;
  for (int i = 0; i < 12; ++i) {
    CHECK(names[i].starts_with(begin[i]));
    baked[names[i]] = bake(names[i], 256);
  }
  // All differ in most texels; by much (the eye sees it at once) all but the two pairs that are made to look alike.
  for (int i = 0; i < 12; ++i)
    for (int j = i + 1; j < 12; ++j) {
      const double much = share_differing(baked[names[i]], baked[names[j]], 50);
      INFO(names[i], " ", names[j], " ", much);
      CHECK(share_differing(baked[names[i]], baked[names[j]], 0) > 0.3);
      if ((i == 9 && j == 10) || (i == 1 && j == 11)) {
        CHECK(much < 0.01);
      } else {
        CHECK(much > 0.008);
      }
    }
}

TEST_CASE("A baked coat is the same for any number of threads") {
  const auto run = [](int threads) {
    tbb::task_arena arena(threads);
    return arena.execute([] { return bake("06_holstein_freckled", 256).data; });
  };
  CHECK(run(1) == run(2));
}

TEST_CASE("The colours on both sides of a UV seam agree") {
  const Image8 image = bake("00_holstein", 2048);
  const Surface& s = cow().rig.surface;
  std::map<std::array<float, 3>, std::vector<std::uint32_t>> at;
  for (std::uint32_t v = 0; v < s.rest.size(); ++v) at[{s.rest[v].x, s.rest[v].y, s.rest[v].z}].push_back(v);
  double sum = 0;
  int pairs = 0, far = 0;
  for (const auto& [unused, list] : at)
    for (std::size_t i = 1; i < list.size(); ++i) {
      const double d = glm::length(lookup(image, s.uvs[list[0]]) - lookup(image, s.uvs[list[i]]));
      sum += d;
      ++pairs;
      far += d > 60;  // only where a patch border runs through the vertex, and then by part of a texel
    }
  REQUIRE(pairs > 500);
  CHECK(sum / pairs < 4);
  CHECK(far < 0.01 * pairs);
}

TEST_CASE("Patches cover the share they are asked for") {
  const Hide& hide = cow_hide();
  const Surface& s = cow().rig.surface;
  for (const double share : {0.2, 0.5, 0.7}) {
    ProceduralCoat coat;
    PatchPattern p;
    p.share = share;
    p.skin_shadow = 0;
    coat.base = p;
    coat.seed = 5;
    coat.fur = 0;
    const ReadyCoat ready = ready_coat(coat, hide);
    double covered = 0, total = 0;
    std::vector<float> inside;
    for (std::uint32_t t = 0; t < s.triangles.size(); ++t) {
      const uvec3& v = s.triangles[t];
      const double area = glm::length(glm::cross(s.rest[v.y] - s.rest[v.x], s.rest[v.z] - s.rest[v.x]));
      const vec3 color = coat_color(ready, hide_point(hide, t, dvec3(1.0 / 3), inside));
      covered += area * (p.ground.x - color.x) / (p.ground.x - p.patch.x);
      total += area;
    }
    CHECK(covered / total == doctest::Approx(share).epsilon(0.06));
  }
}

TEST_CASE("Freckles cover the share they are asked for, on average over space, however they are grouped") {
  for (const double clustering : {0.0, 1.0}) {
    ProceduralCoat coat;
    coat.base = PlainPattern{vec3(1), 0, 1};
    coat.fur = 0;
    coat.freckles = {vec3(0), 0.1, 0.02, clustering};
    static const Surface nobody;
    static const Hide hide = make_hide(nobody, {});
    const ReadyCoat ready = ready_coat(coat, hide);
    double covered = 0;
    constexpr int n = 300;
    HidePoint p;
    for (int i = 0; i < n; ++i)
      for (int j = 0; j < n; ++j) {
        p.at = {i * 0.0171, j * 0.0153, 0.37 + i * 0.003};
        covered += 1 - coat_color(ready, p).x;
      }
    CHECK(covered / (n * n) == doctest::Approx(0.1).epsilon(0.2));
  }
}

TEST_CASE("Colours stay within the unit interval") {
  ProceduralCoat coat;
  coat.base = PlainPattern{vec3(1), 0.5, 0.2};
  coat.fur = 0.5;
  for (int i = 0; i < 200; ++i) {
    const vec3 c = color_in_space(coat, {0.013 * i, 0.007 * i, 0.5});
    CHECK(c.x >= 0);
    CHECK(c.x <= 1);
  }
}

TEST_CASE("Part colours go by name or by its beginning, and depth inside a part is measured in metres") {
  // A strip of 40 x 4 squares of 5 mm: the first half is "hoof_a", the other "torso".
  Surface s;
  for (int x = 0; x <= 40; ++x)
    for (int y = 0; y <= 4; ++y) {
      s.rest.push_back({0.005f * x, 0.005f * y, 0});
      s.normals.push_back({0, 0, 1});
    }
  for (int x = 0; x < 40; ++x)
    for (int y = 0; y < 4; ++y) {
      const std::uint32_t a = x * 5 + y, b = a + 5;
      s.triangles.push_back({a, b, b + 1});
      s.triangles.push_back({a, b + 1, a + 1});
      for (int k = 0; k < 2; ++k) s.parts.push_back(x < 20 ? 0 : 1);
    }
  s.materials.assign(s.triangles.size(), 0);
  Hide hide = make_hide(s, {"hoof_a", "torso"});
  ProceduralCoat coat;
  coat.base = PlainPattern{vec3(1), 0, 0.2};
  coat.fur = 0;
  coat.parts.resize(2);
  coat.parts[0] = {.part = "hoof_*", .color = vec3(0.2f)};
  coat.parts[1] = {.part = "muzzle", .color = vec3(0.4f)};  // which the strip does not have
  know_parts(hide, coat);
  const ReadyCoat ready = ready_coat(coat, hide);
  std::vector<float> inside;
  CHECK(coat_color(ready, hide_point(hide, 0, dvec3(1.0 / 3), inside)).x == doctest::Approx(0.2f));
  const auto last = static_cast<std::uint32_t>(s.triangles.size() - 1);
  CHECK(coat_color(ready, hide_point(hide, last, dvec3(1.0 / 3), inside)).x == doctest::Approx(1.0f));
  for (std::uint32_t t = 0; t < s.triangles.size(); ++t) {
    const HidePoint p = hide_point(hide, t, dvec3(1.0 / 3), inside);
    CHECK(inside[0] == doctest::Approx(0.1 - p.at.x).epsilon(0.1).scale(0.05));
    CHECK(inside[1] == -part_reach);
  }
  CHECK(part_frame(hide, "muzzle").empty());
  CHECK(part_frame(hide, "hoof_a").half.x == doctest::Approx(0.05));
}

TEST_CASE("Bare skin is coloured by part in the bake") {
  const Image8 image = bake("11_limousin", 512);
  const Surface& s = cow().rig.surface;
  for (std::size_t t = 0; t < s.triangles.size(); ++t) {
    if (cow().rig.part_names[s.parts[t]] != "muzzle") continue;
    const uvec3& v = s.triangles[t];
    const dvec3 c = lookup(image, (s.uvs[v.x] + s.uvs[v.y] + s.uvs[v.z]) / 3.0f);
    std::vector<float> inside;
    hide_point(cow_hide(), static_cast<std::uint32_t>(t), dvec3(1.0 / 3), inside);
    if (inside[cow_hide().pattern("muzzle")] < 0.015f) continue;
    CHECK(c.z > 70);                      // pink, not the coat's red-brown
  }
}

TEST_CASE("A surface without UVs is refused") {
  Surface s;
  s.rest = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
  s.triangles = {{0, 1, 2}};
  s.normals.assign(3, {0, 0, 1});
  Hide hide = make_hide(s, {});
  CHECK_THROWS_AS(bake_coat({}, hide, 16), InputError);
}
