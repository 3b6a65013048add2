#pragma once
// The path tracer: radiance of every coat of the batch from one set of paths.
#include <cmath>
#include <cstdint>
#include <vector>

#include "generator/core/image.h"
#include "generator/render/first_hit.h"
#include "generator/render/light.h"
#include "generator/render/surface_light.h"

namespace moomill {

struct PathOptions {
  int samples = 64;            // per pixel; not looked at where there is a target_error
  // Relative error of the picture to be reached, sqrt(mean (x - r)^2 / (r^2 + 0.01)) over the pixels at least half covered, or 0. Every tile of
  // 16 x 16 pixels then takes 4 to 4096 samples, a power of two: by what a pilot of eight samples of a white and a black (3 %) coat
  // says, of the worse of the two, so that the whole needs the least. The pilot's samples are not used again and no coat
  // enters, so pictures stay independent of their batch, and unbiased but for the division by the weights received.
  // The pilot is of paths: with `light` the error comes out smaller than asked.
  double target_error = 0;
  double filter_radius = 1.5;  // pixels, of the Blackman-Harris pixel filter
  int roulette_from = 3;       // bounces before Russian roulette; from there on a path survives with at most 0.8
  int max_bounces = 0;         // 0: none, unbiased; otherwise a cap, which darkens
  bool environment_visible = false;  // the camera sees the environment; else the background is transparent
  // How much of the sky every vertex sees, or none; the sky then takes fewer samples. Must outlive the call.
  const SkyShares* sky = nullptr;
  // Light gathered for this scene in these coats, or none: with it pictures take far fewer samples, and have its bias. Must outlive the call.
  const SurfaceLight* light = nullptr;
  std::uint64_t stream = 0;    // hash of (seed, frame, camera): the identity of the samples
};

struct Radiance {
  // Per coat: linear Rec. 709, premultiplied, alpha in the 4th channel. Noise may take dark values below 0.
  std::vector<ImageF> coats;
  std::uint64_t paths = 0, rays = 0;
  std::uint64_t not_finite = 0;    // samples dropped because a value was not finite; 0 in a sane scene
};

// Estimates the radiance of the pixels in `mask`; others stay 0. Alpha: share of the filter that sees a surface (or,
// with a visible environment, 1). Same bits for a coat in any batch, and for any number of threads. Where the filter is
// wider than a pixel, a sample counts in every pixel it reaches, so neighbours' errors are correlated.
Radiance trace_radiance(const Scene& scene, const Lights& lights, const Accel& accel, const Camera& camera,
                        const PixelMask& mask, const PathOptions& options);

// Samples per pixel, in the mean over the pixels that trace_radiance() would trace, that options.target_error comes to; only the pilot is
// traced for it, and the pilot's eight samples are not among them.
double mean_chosen_samples(const Scene& scene, const Lights& lights, const Accel& accel, const Camera& camera,
                           const PixelMask& mask, const PathOptions& options);

// The pixel filter: a Blackman-Harris window of `radius` pixels, along each axis.
class PixelFilter {
 public:
  explicit PixelFilter(double radius) : radius_(radius) {}
  float sample(float xi) const;  // pixels from the centre, in [-radius, radius], distributed as the window
  float weight(float distance) const;  // the window's density at so many pixels from the centre; its integral is 1
  double radius() const { return radius_; }
  // How many pixels each way a sample anywhere in a pixel adds to. 0 for windows no wider than 2 pixels: samples shared by so
  // few would have weights that scatter more than the sharing gains, so each pixel draws its own from the window.
  int reach() const { return radius_ <= 1 ? 0 : static_cast<int>(std::ceil(radius_ - 0.5)); }

 private:
  double radius_;
};

}  // namespace moomill
