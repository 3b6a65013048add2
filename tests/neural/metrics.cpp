// Every metric against a value worked out by hand.
#include "neural/metrics.h"

#include <cmath>

#include "tests/neural/doctest_torch.h"

using namespace moomill;
using torch::Tensor;

namespace {

Tensor half_mask(int height, int width) {  // the left half
  Tensor mask = torch::zeros({height, width});
  mask.slice(1, 0, width / 2) = 1;
  return mask;
}

}  // namespace

TEST_CASE("errors are means over the mask's pixels and channels, whatever lies outside") {
  const Tensor mask = half_mask(4, 6);
  Tensor a = torch::zeros({3, 4, 6}), b = torch::zeros({3, 4, 6});
  b[0] = 0.3;  // one of three channels is off by 0.3
  b.slice(2, 3, 6) = 77;
  CHECK(*masked_squared_error(a, b, mask) == doctest::Approx(0.09 / 3));
  CHECK(*masked_absolute_error(a, b, mask) == doctest::Approx(0.1));
  CHECK(*masked_absolute_error(a[0], b[0], mask) == doctest::Approx(0.3));
  CHECK_FALSE(masked_squared_error(a, b, torch::zeros({4, 6})).has_value());
  CHECK_FALSE(masked_absolute_error(a, b, torch::zeros({4, 6})).has_value());
}

TEST_CASE("a mean over images weighs each alike and counts those without a value") {
  Mean mean;
  CHECK(std::isnan(mean.value()));
  mean.add(1.0);
  mean.add(std::nullopt);
  mean.add(4.0);
  CHECK(mean.value() == doctest::Approx(2.5));
  CHECK(mean.count == 2);
  CHECK(mean.skipped == 1);
}

TEST_CASE("intersection over union") {
  Tensor a = torch::zeros({4, 4}), b = torch::zeros({4, 4});
  CHECK_FALSE(mask_iou(a, b).has_value());
  a.slice(1, 0, 2) = 1;  // 8 pixels
  CHECK(*mask_iou(a, b) == 0);
  b.slice(1, 1, 3) = 1;  // 8 pixels, 4 shared
  CHECK(*mask_iou(a, b) == doctest::Approx(4.0 / 12));
  CHECK(*mask_iou(a, a) == 1);
}

TEST_CASE("keypoint error is the mean distance") {
  const Tensor a = torch::zeros({2, 3});
  const Tensor b = torch::tensor({{3.0f, 4.0f, 0.0f}, {0.0f, 0.0f, 1.0f}});
  CHECK(keypoint_error(a, b) == doctest::Approx(3));
  CHECK(keypoint_error(b, b) == 0);
}

TEST_CASE("PSNR has peak 1, is capped for equal images and does not exist without pixels") {
  CHECK(psnr(0.01) == doctest::Approx(20));
  CHECK(psnr(1) == doctest::Approx(0));
  CHECK(psnr(0) == psnr_cap);
  CHECK(psnr(1e-30) == psnr_cap);
  const Tensor mask = half_mask(5, 8), a = torch::full({3, 5, 8}, 0.5);
  CHECK(*masked_psnr(a, a + 0.1, mask) == doctest::Approx(20).epsilon(1e-5));
  CHECK(*masked_psnr(a, a, mask) == psnr_cap);
  CHECK_FALSE(masked_psnr(a, a, torch::zeros({5, 8})).has_value());
}

TEST_CASE("painting in the mean colour errs by the variance of the mask's colours") {
  Tensor color = torch::full({3, 2, 4}, 0.5);
  color.slice(2, 0, 1) += 0.2;  // left half of the mask 0.7, right half 0.5: variance 0.01
  color.slice(2, 2, 4) = 9;     // outside
  CHECK(*mean_color_psnr(color, half_mask(2, 4)) == doctest::Approx(20).epsilon(1e-5));
  CHECK(*mean_color_psnr(torch::full({3, 2, 4}, 0.5), half_mask(2, 4)) == psnr_cap);
  CHECK_FALSE(mean_color_psnr(color, torch::zeros({2, 4})).has_value());
}

TEST_CASE("the box of a mask") {
  Tensor mask = torch::zeros({10, 20});
  CHECK(mask_box(mask).empty());
  mask[3][7] = 1;
  PixelBox box = mask_box(mask);
  CHECK(box.x0 == 7);
  CHECK(box.y0 == 3);
  CHECK(box.width() == 1);
  CHECK(box.height() == 1);
  mask[9][19] = 1;
  box = mask_box(mask);
  CHECK(box.x1 == 20);
  CHECK(box.y1 == 10);
}

TEST_CASE("SSIM of constant images is the luminance term") {
  const Tensor a = torch::full({16, 16}, 0.3), b = torch::full({16, 16}, 0.6);
  const double c1 = 1e-4;
  CHECK(*ssim(a, b) == doctest::Approx((2 * 0.3 * 0.6 + c1) / (0.09 + 0.36 + c1)).epsilon(1e-6));
  CHECK(*ssim(a, a) == doctest::Approx(1));
}

TEST_CASE("SSIM of a picture and its mirror in brightness is the negated structure term") {
  // With y = 1 - x and a mean of one half in every window the luminance term is 1; variances are equal and the
  // covariance is minus the variance: (c2 - 2 v) / (c2 + 2 v). A checkerboard of 0.5 +- 0.2 has weighted mean and
  // variance known in closed form: the Gaussian's alternating sum s = sum_i (-1)^i w_i gives a mean of 0.5 +- 0.2 s^2.
  const int n = 24;
  Tensor sign = torch::ones({n, n}, torch::kDouble);
  for (int y = 0; y < n; ++y)
    for (int x = 0; x < n; ++x)
      if ((x + y) % 2) sign[y][x] = -1;
  double sum = 0, alternating = 0;
  for (int i = -5; i <= 5; ++i) {
    const double w = std::exp(-i * i / 4.5);
    sum += w;
    alternating += (i % 2 ? -1 : 1) * w;
  }
  const double s = alternating / sum * (alternating / sum);
  const double v = 0.04 * (1 - s * s), c1 = 1e-4, c2 = 9e-4;
  const double x = 0.5 + 0.2 * s, y = 0.5 - 0.2 * s;
  const double expected = (2 * x * y + c1) / (x * x + y * y + c1) * (c2 - 2 * v) / (c2 + 2 * v);
  CHECK(*ssim(0.5 + 0.2 * sign, 0.5 - 0.2 * sign) == doctest::Approx(expected).epsilon(1e-9));
  CHECK_FALSE(ssim(sign.slice(0, 0, 10), sign.slice(0, 0, 10)).has_value());
}

TEST_CASE("SSIM in a mask's box looks half a window beyond it, no further, and never off the image") {
  Tensor mask = torch::zeros({40, 60});
  mask.slice(0, 15, 25).slice(1, 20, 40) = 1;
  const Tensor a = torch::full({3, 40, 60}, 0.5);
  Tensor far = a.clone(), near = a.clone();
  far.slice(2, 46, 60) = 0;
  near.slice(2, 43, 60) = 0;
  CHECK(*masked_box_ssim(a, far, mask) == doctest::Approx(1));
  CHECK(*masked_box_ssim(a, near, mask) < 0.999);
  CHECK_FALSE(masked_box_ssim(a, a, torch::zeros({40, 60})).has_value());
  for (const int corner : {0, 39}) {  // one pixel at the border still has its window
    Tensor one = torch::zeros({40, 60});
    one[corner][corner == 0 ? 0 : 59] = 1;
    CHECK(*masked_box_ssim(a, a, one) == doctest::Approx(1));
  }
  CHECK_FALSE(masked_box_ssim(a.slice(1, 0, 8), a.slice(1, 0, 8), torch::ones({8, 60})).has_value());
}

TEST_CASE("luma weighs the channels to one") {
  CHECK(luma(torch::ones({3, 1, 1})).item<float>() == doctest::Approx(1));
  Tensor green = torch::zeros({3, 1, 1});
  green[1] = 1;
  CHECK(luma(green).item<float>() == doctest::Approx(0.587));
}
