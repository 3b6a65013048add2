#include "generator/core/color.h"

namespace moomill {

dvec3 lab_from_linear(const vec3& rgb) {
  const dvec3 c(rgb);
  // Rec. 709 primaries, each row over the white point's value, so that white is (1, 1, 1).
  const dvec3 xyz(glm::dot(dvec3(0.4124564, 0.3575761, 0.1804375), c) / 0.95047,
                  glm::dot(dvec3(0.2126729, 0.7151522, 0.0721750), c),
                  glm::dot(dvec3(0.0193339, 0.1191920, 0.9503041), c) / 1.08883);
  dvec3 f;
  for (int i = 0; i < 3; ++i)
    f[i] = xyz[i] > 216.0 / 24389 ? std::cbrt(xyz[i]) : (24389.0 / 27 * xyz[i] + 16) / 116;
  return {116 * f.y - 16, 500 * (f.x - f.y), 200 * (f.y - f.z)};
}

double ciede2000(const dvec3& lab1, const dvec3& lab2) {
  const auto seventh = [](double c) { return std::sqrt(std::pow(c, 7) / (std::pow(c, 7) + 6103515625.0)); };  // 25^7
  const double mean_c = 0.5 * (std::hypot(lab1.y, lab1.z) + std::hypot(lab2.y, lab2.z));
  const double g = 0.5 * (1 - seventh(mean_c));
  const double a1 = (1 + g) * lab1.y, a2 = (1 + g) * lab2.y;
  const double c1 = std::hypot(a1, lab1.z), c2 = std::hypot(a2, lab2.z);
  const auto hue = [](double a, double b) {  // degrees in [0, 360); 0 for greys
    if (a == 0 && b == 0) return 0.0;
    const double h = std::atan2(b, a) / degrees;
    return h < 0 ? h + 360 : h;
  };
  const double h1 = hue(a1, lab1.z), h2 = hue(a2, lab2.z);

  const double dl = lab2.x - lab1.x, dc = c2 - c1;
  double dh = 0, mean_h = h1 + h2;
  if (c1 * c2 != 0) {
    dh = h2 - h1;
    if (dh > 180) dh -= 360;
    if (dh < -180) dh += 360;
    if (std::abs(h1 - h2) <= 180)
      mean_h = 0.5 * (h1 + h2);
    else
      mean_h = h1 + h2 < 360 ? 0.5 * (h1 + h2 + 360) : 0.5 * (h1 + h2 - 360);
  }
  const double big_dh = 2 * std::sqrt(c1 * c2) * std::sin(0.5 * dh * degrees);
  const double l = 0.5 * (lab1.x + lab2.x), c = 0.5 * (c1 + c2);
  const double t = 1 - 0.17 * std::cos((mean_h - 30) * degrees) + 0.24 * std::cos(2 * mean_h * degrees) +
                   0.32 * std::cos((3 * mean_h + 6) * degrees) - 0.20 * std::cos((4 * mean_h - 63) * degrees);
  const double turn = 30 * std::exp(-std::pow((mean_h - 275) / 25, 2));
  const double sl = 1 + 0.015 * (l - 50) * (l - 50) / std::sqrt(20 + (l - 50) * (l - 50));
  const double sc = 1 + 0.045 * c, sh = 1 + 0.015 * c * t;
  const double rt = -std::sin(2 * turn * degrees) * 2 * seventh(c);
  const double x = dl / sl, y = dc / sc, z = big_dh / sh;
  return std::sqrt(std::max(0.0, x * x + y * y + z * z + rt * y * z));
}

}  // namespace moomill
