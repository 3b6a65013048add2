#pragma once
// How far a noisy picture is from a reference, how fast the distance falls, and when two renderers are equally far.
#include <optional>
#include <vector>

#include "generator/core/image.h"

namespace moomill {

// Added to the squared reference in the relative error, so that black pixels do not decide it; in squared linear radiance.
inline constexpr double relative_epsilon = 0.01;

// Over the N pixels of a mask and the 3 channels of linear Rec. 709, x the picture and r the reference:
struct PictureError {
  double mse = 0;           // sum (x - r)^2 / 3N
  double relative_mse = 0;  // sum (x - r)^2 / (r^2 + relative_epsilon) / 3N
  double ciede2000 = 0;     // mean over pixels of the CIEDE2000 difference of x and r, both clipped to [0, 1] as a screen shows them
};

// Pictures: linear, 3 channels or more, of which the first three count. mask: 1 channel of the same size, nonzero inside;
// at least one pixel is.
PictureError picture_error(const ImageF& picture, const ImageF& reference, const ImageU32& mask);

// The average of two independent halves of a reference, and its own error, estimated from their difference: each half has
// the variance v, their difference 2v, their average v/2, so a quarter of the mean squared difference.
struct Reference {
  ImageF picture;
  double mse = 0;
};
Reference join_halves(const ImageF& a, const ImageF& b, const ImageU32& mask);

// error = scale * samples^slope, by least squares in the logarithms; with Student's t, 95 % of such intervals hold the
// slope where the points scatter independently. Points that are not positive are left out; NaN with fewer than three.
struct PowerLaw {
  double slope = 0, low = 0, high = 0;  // low and high: the interval
  double scale = 0;
  int points = 0;
};
PowerLaw fit_power_law(const std::vector<double>& samples, const std::vector<double>& error);
double student_t_975(int degrees_of_freedom);  // quantile 0.975

// A point of error against time, ascending in time.
struct TimedError {
  double seconds = 0, error = 0;
};
// When the error has fallen to `error` for good: between the last point above it and the next, straight in the
// logarithms of both. Nothing where the curve never gets there, or is there from its first point on: no extrapolation.
std::optional<double> time_for_error(const std::vector<TimedError>& curve, double error);

double median(std::vector<double> values);  // NaN of none

}  // namespace moomill
