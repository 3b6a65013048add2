// Coarse to fine against every pixel, on silhouettes and surfaces known in closed form.
#include "neural/refine.h"

#include <algorithm>
#include <cmath>

#include "tests/neural/doctest_torch.h"

using namespace moomill;
using torch::Tensor;

namespace {

struct Capsule {
  double x0, y0, x1, y1, radius;  // image units of a square image
};

// Signed distance to a union of capsules, as logits of a sharp silhouette: positive inside, 0 at the boundary.
PointFunction capsules(const std::vector<Capsule>& parts, double sharpness) {
  return [parts, sharpness](const Tensor& points) {
    Tensor best = torch::full({points.size(0)}, -1e9);
    for (const Capsule& c : parts) {
      const double dx = c.x1 - c.x0, dy = c.y1 - c.y0, length = std::max(1e-12, dx * dx + dy * dy);
      const Tensor px = points.select(1, 0) - c.x0, py = points.select(1, 1) - c.y0;
      const Tensor t = ((px * dx + py * dy) / length).clamp(0, 1);
      best = torch::maximum(best, c.radius - torch::hypot(px - t * dx, py - t * dy));
    }
    return best * sharpness;
  };
}

// A body, a head, four legs and a tail thinner than a coarse cell.
const std::vector<Capsule> beast{{0.3, 0.4, 0.65, 0.42, 0.11},   {0.22, 0.33, 0.3, 0.38, 0.05},
                                 {0.33, 0.5, 0.31, 0.72, 0.012}, {0.38, 0.5, 0.40, 0.72, 0.012},
                                 {0.6, 0.5, 0.62, 0.72, 0.012},  {0.66, 0.5, 0.66, 0.72, 0.012},
                                 {0.75, 0.4, 0.80, 0.62, 0.004}};

// Pixels of points given in image units: what keypoints are to an animal.
std::vector<std::int64_t> seeds_of(const std::vector<Capsule>& parts, int size) {
  std::vector<std::int64_t> seeds;
  for (const Capsule& c : parts)
    for (const double t : {0.0, 0.5, 1.0})
      seeds.push_back(static_cast<std::int64_t>((c.y0 + t * (c.y1 - c.y0)) * size) * size +
                      static_cast<std::int64_t>((c.x0 + t * (c.x1 - c.x0)) * size));
  return seeds;
}

double differing_share(const Tensor& a, const Tensor& b) {
  return (a != b).sum().item<double>() / b.sum().item<double>();
}

}  // namespace

TEST_CASE("a silhouette traced coarse to fine is the full one, from a small part of the points") {
  for (const int size : {128, 512, 1000}) {  // the last is no multiple of a cell
    CAPTURE(size);
    const PointFunction logits = capsules(beast, 300);
    RefineOptions full;
    full.mask_cell = 1;
    std::int64_t all = 0, some = 0;
    const Tensor truth = trace_mask(logits, size, size, {}, {}, full, &all);
    CHECK(all == std::int64_t{size} * size);
    CHECK(truth.sum().item<double>() > 0.08 * size * size);
    const PixelBox box{size / 8, size / 5, size * 7 / 8, size * 4 / 5};
    const Tensor traced = trace_mask(logits, size, size, box, seeds_of(beast, size), {}, &some);
    CHECK(differing_share(traced, truth) < 1e-3);
    if (size >= 512) CHECK(some < all / 8);
  }
}

TEST_CASE("parts thinner than a cell are found where a seed lies in them, and only then") {
  const std::vector<Capsule> thin{{0.2, 0.5, 0.4, 0.5, 0.1}, {0.70, 0.51, 0.74, 0.57, 0.002}};
  const PointFunction logits = capsules(thin, 5000);
  RefineOptions full, coarse;
  full.mask_cell = 1;
  coarse.mask_cell = 32;
  const int size = 512;
  const PixelBox everything{0, 0, size, size};
  const Tensor truth = trace_mask(logits, size, size, everything, {}, full);
  const Tensor right = truth.slice(1, size / 2, size);
  REQUIRE(right.sum().item<double>() > 20);
  const Tensor blind = trace_mask(logits, size, size, everything, {}, coarse);
  CHECK(blind.slice(1, size / 2, size).sum().item<double>() == 0);
  const Tensor seen = trace_mask(logits, size, size, everything, seeds_of(thin, size), coarse);
  CHECK((seen != truth).sum().item<double>() == 0);
}

TEST_CASE("a box that is too small grows until its rim is background") {
  const PointFunction logits = capsules({{0.1, 0.5, 0.9, 0.5, 0.05}}, 300);
  RefineOptions full;
  full.mask_cell = 1;
  const Tensor truth = trace_mask(logits, 256, 256, {}, {}, full);
  const Tensor traced = trace_mask(logits, 256, 256, {120, 120, 130, 130}, {}, {});
  CHECK((traced != truth).sum().item<double>() == 0);
  // Up to the image's border, where it ends.
  const PointFunction everywhere = [](const Tensor& points) { return torch::ones({points.size(0)}); };
  CHECK(trace_mask(everywhere, 100, 60, {50, 30, 51, 31}, {}, {}).sum().item<double>() == 6000);
  CHECK(trace_mask(everywhere, 1, 1, {0, 0, 1, 1}, {0}, {}).sum().item<double>() == 1);
}

TEST_CASE("an empty box and an empty silhouette give an empty mask") {
  const PointFunction nothing = [](const Tensor& points) { return torch::full({points.size(0)}, -9.0); };
  std::int64_t evaluated = 0;
  CHECK(trace_mask(nothing, 64, 48, {}, {}, {}, &evaluated).sum().item<double>() == 0);
  CHECK(evaluated == 0);
  CHECK(trace_mask(nothing, 64, 48, {0, 0, 64, 48}, {100}, {}, &evaluated).sum().item<double>() == 0);
  CHECK(evaluated > 0);
  const PointFunction broken = [](const Tensor& points) { return torch::full({points.size(0)}, NAN); };
  CHECK(trace_mask(broken, 64, 48, {0, 0, 64, 48}, {}, {}).sum().item<double>() == 0);
}

TEST_CASE("chunks bound what is evaluated at a time and change nothing") {
  std::int64_t largest = 0;
  const PointFunction inner = capsules(beast, 300);
  const PointFunction logits = [&](const Tensor& points) {
    largest = std::max(largest, points.size(0));
    return inner(points);
  };
  RefineOptions small;
  small.chunk = 100;
  const PixelBox box{0, 0, 300, 300};
  const Tensor a = trace_mask(logits, 300, 300, box, {}, small);
  CHECK(largest <= 100);
  CHECK((a != trace_mask(inner, 300, 300, box, {}, {})).sum().item<double>() == 0);
}

TEST_CASE("what is filled is what is evaluated, inside the mask alone") {
  const PointFunction values = [](const Tensor& p) { return torch::stack({p.select(1, 0), p.select(1, 1) + 2}, 1); };
  Tensor mask = torch::zeros({30, 40});
  mask.slice(0, 5, 20).slice(1, 10, 33) = 1;
  std::int64_t evaluated = 0;
  const Tensor out = fill_mask(values, 2, mask, {}, &evaluated);
  CHECK(evaluated == mask.sum().item<std::int64_t>());
  CHECK(out.sizes() == torch::IntArrayRef({2, 30, 40}));
  CHECK(out[0][6][12].item<float>() == doctest::Approx(12.5 / 40));
  CHECK(out[1][19][32].item<float>() == doctest::Approx(19.5 / 30 + 2));
  CHECK((out * (1 - mask)).abs().max().item<float>() == 0);
  CHECK(fill_mask(values, 2, torch::zeros({30, 40}), {}).abs().max().item<float>() == 0);
}

TEST_CASE("interpolation keeps to its tolerance on smooth surfaces, from a small part of the points") {
  // Curvature c: a cell of s pixels of 1 / 400 errs by c (s / 400)^2 / 8 a direction at most.
  const PointFunction values = [](const Tensor& p) {
    const Tensor x = p.select(1, 0), y = p.select(1, 1);
    return torch::stack({torch::sin(6 * x) * torch::cos(5 * y) * 0.5 + 0.5, x * y}, 1);
  };
  const Tensor mask = trace_mask(capsules(beast, 300), 400, 400, {0, 0, 400, 400}, seeds_of(beast, 400), {});
  RefineOptions coarse;
  coarse.surface_cell = 8;
  std::int64_t all = 0, some = 0;
  const Tensor exact = fill_mask(values, 2, mask, {}, &all), near = fill_mask(values, 2, mask, coarse, &some);
  const Tensor difference = (exact - near).abs();
  CHECK(difference.max().item<double>() < 36.0 * 0.5 * (8.0 / 400) * (8.0 / 400) / 4 + 1e-6);
  CHECK(difference.max().item<double>() > 0);
  CHECK(some < all / 2);
  CHECK((near * (1 - mask)).abs().max().item<float>() == 0);
}

TEST_CASE("interpolation does not smear a step") {
  const PointFunction step = [](const Tensor& p) { return (p.select(1, 0) > 0.415).to(torch::kFloat).unsqueeze(1); };
  const Tensor mask = torch::ones({128, 128});
  RefineOptions coarse;
  coarse.surface_cell = 16;
  const Tensor exact = fill_mask(step, 1, mask, {}), near = fill_mask(step, 1, mask, coarse);
  CHECK((exact - near).abs().max().item<float>() == 0);
}

TEST_CASE("grids that are no powers of two are refused") {
  const PointFunction values = [](const Tensor& p) { return p.select(1, 0); };
  RefineOptions odd;
  odd.mask_cell = 6;
  CHECK_THROWS_WITH(trace_mask(values, 8, 8, {}, {}, odd), doctest::Contains("not a power of two"));
  odd.surface_cell = 12;
  CHECK_THROWS_WITH(fill_mask(values, 1, torch::ones({8, 8}), odd), doctest::Contains("not a power of two"));
}
