#include "generator/render/light.h"

#include "generator/core/error.h"
#include "generator/render/bsdf.h"

namespace moomill {
namespace {

constexpr float pi_f = std::numbers::pi_v<float>;
constexpr float infinity = std::numeric_limits<float>::infinity();
constexpr double soft_up_to = 2;  // times the mean of the soft part itself, by the brightest channel (docs/figures.md has others)
constexpr float brightest = 1e30f;  // radiance of a map's pixel: room for weights and sums below the largest float

// Index i with cdf[i] <= x < cdf[i + 1], and where x lies in it.
std::pair<int, float> find_interval(const float* cdf, int n, float x) {
  int i = static_cast<int>(std::upper_bound(cdf, cdf + n + 1, x) - cdf) - 1;
  i = std::clamp(i, 0, n - 1);
  while (i > 0 && cdf[i + 1] == cdf[i]) --i;  // never an interval of no width
  while (i < n - 1 && cdf[i + 1] == cdf[i]) ++i;
  const float width = cdf[i + 1] - cdf[i];
  return {i, width > 0 ? std::clamp((x - cdf[i]) / width, 0.0f, 0x1.fffffep-1f) : 0.5f};
}

// Real spherical harmonics up to the second order are these polynomials of a unit vector, each times a constant. The mean over the
// hemisphere around n, weighted by the cosine, is the sum of cosine_kernel polynomial(n) (integral of radiance times polynomial)
// (Ramamoorthi and Hanrahan 2001, eq. 8 and 13: the harmonics' constants squared, times 1, 2/3 and 1/4).
constexpr double cosine_kernel[9] = {1 / (4 * pi),   1 / (2 * pi),   1 / (2 * pi),  1 / (2 * pi), 15 / (16 * pi),
                                     15 / (16 * pi), 15 / (16 * pi), 5 / (64 * pi), 15 / (64 * pi)};
std::array<float, 9> polynomials(const vec3& d) {
  return {1, d.x, d.y, d.z, d.x * d.y, d.y * d.z, d.z * d.x, 3 * d.z * d.z - 1, d.x * d.x - d.y * d.y};
}

// Of a map whose pixels come from `pixel`: the integrals of radiance times the polynomials, exact for pixels of one colour each. In
// x = -s sin(phi), y = -s cos(phi), s^2 = 1 - z^2, each is a function of z times one of phi.
template <class Pixel>
std::array<dvec3, 9> integrals_of_polynomials(int w, int h, double yaw_turns, const Pixel& pixel) {
  std::vector<std::array<double, 5>> columns(w);  // integrals over phi of 1, sin, cos, sin 2 phi, cos 2 phi
  for (int x = 0; x < w; ++x) {
    const double a = 2 * pi * (static_cast<double>(x) / w - 0.5 - yaw_turns), b = 2 * pi * (static_cast<double>(x + 1) / w - 0.5 - yaw_turns);
    columns[x] = {b - a, std::cos(a) - std::cos(b), std::sin(b) - std::sin(a), (std::cos(2 * a) - std::cos(2 * b)) / 2, (std::sin(2 * b) - std::sin(2 * a)) / 2};
  }
  std::array<dvec3, 9> out{};
  for (int y = 0; y < h; ++y) {
    const double top = std::cos(pi * y / h), bottom = std::cos(pi * (y + 1) / h);
    const auto between = [&](const auto& primitive) { return primitive(top) - primitive(bottom); };
    const auto root = [](double z) { return std::sqrt(std::max(0.0, 1 - z * z)); };
    const double one = top - bottom, z = between([](double t) { return t * t / 2; }), zonal = between([](double t) { return t * t * t - t; }),
                 s = between([&](double t) { return (t * root(t) + std::asin(t)) / 2; }), s2 = between([](double t) { return t - t * t * t / 3; }),
                 sz = between([&](double t) { return -std::pow(root(t), 3) / 3; });
    dvec3 sum[5] = {};
    for (int x = 0; x < w; ++x) {
      const dvec3 p(pixel(x, y));
      for (int k = 0; k < 5; ++k) sum[k] += columns[x][k] * p;
    }
    out[0] += one * sum[0];
    out[1] -= s * sum[1];
    out[2] -= s * sum[2];
    out[3] += z * sum[0];
    out[4] += 0.5 * s2 * sum[3];
    out[5] -= sz * sum[2];
    out[6] -= sz * sum[1];
    out[7] += zonal * sum[0];
    out[8] -= s2 * sum[4];
  }
  return out;
}

float brightest_channel(const vec3& c) { return std::max({c.x, c.y, c.z}); }

}  // namespace

Environment::Environment(ImageF map, const std::string& name, float strength, double yaw_rad) : map_(std::move(map)) {
  const int w = map_.width, h = map_.height;
  if (w < 1 || h < 1 || map_.channels < 3)
    input_error("{}: an environment map wants at least one pixel and three channels", name);
  ImageF rgb(w, h, 3);
  for (int y = 0; y < h; ++y)
    for (int x = 0; x < w; ++x)
      for (int c = 0; c < 3; ++c) {
        const float v = map_.at(x, y, c);
        if (!std::isfinite(v) || v < 0)
          input_error("{}: pixel ({}, {}) is {}; an environment map wants finite values of 0 or more", name, x, y, v);
        if (!(v * strength >= 0) || v * strength > brightest)
          input_error("{}: pixel ({}, {}) is {}, times the strength {}; at most {:.0e} can be rendered, lower the strength", name, x, y, v,
                      strength, brightest);
        rgb.at(x, y, c) = v * strength;
      }
  map_ = std::move(rgb);
  yaw_turns_ = static_cast<float>(yaw_rad / (2 * pi));

  const auto pixel = [&](int x, int y) { return vec3(map_.at(x, y, 0), map_.at(x, y, 1), map_.at(x, y, 2)); };
  const auto solid_angle = [&](int y) { return (std::cos(pi * y / h) - std::cos(pi * (y + 1) / h)) * 2 * pi / w; };  // of a pixel
  dvec3 mean(0);
  double limit = 0;
  for (int y = 0; y < h; ++y)
    for (int x = 0; x < w; ++x) {
      mean += dvec3(pixel(x, y)) * (solid_angle(y) / (4 * pi));
      limit += soft_up_to * brightest_channel(pixel(x, y)) * (solid_angle(y) / (4 * pi));
    }
  mean_ = vec3(mean);
  // The greatest L that is soft_up_to times the mean of min(brightest channel, L): Newton's method on a convex function, from above. It falls
  // to nothing where less than half of the sky shines.
  for (int round = 0; round < 30; ++round) {
    double below = 0, above = 0;  // mean of what is below the limit, and share of the sphere that is not
    for (int y = 0; y < h; ++y) {
      const double share = solid_angle(y) / (4 * pi);
      for (int x = 0; x < w; ++x) {
        const float v = brightest_channel(pixel(x, y));
        if (v < limit)
          below += v * share;
        else
          above += share;
      }
    }
    const double next = soft_up_to * above < 1 ? soft_up_to * below / (1 - soft_up_to * above) : 0;
    if (!(next < 0.999 * limit)) break;
    limit = next;
  }
  soft_at_most_ = static_cast<float>(limit);
  const auto integrals = integrals_of_polynomials(w, h, yaw_turns_, [&](int x, int y) { return soft(pixel(x, y)); });
  for (int k = 0; k < 9; ++k) harmonics_[k] = vec3(cosine_kernel[k] * integrals[k]);

  // Density over the unit square, in proportion to the bright part's luminance times the solid angle of the row.
  std::vector<double> row_sum(h, 0.0);
  density_.resize(static_cast<std::size_t>(w) * h);
  column_cdf_.assign(static_cast<std::size_t>(h) * (w + 1), 0.0f);
  row_cdf_.assign(h + 1, 0.0f);
  double total = 0;
  dvec3 bright_mean(0);
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      const vec3 bright = pixel(x, y) - soft(pixel(x, y));
      const double v = luminance(bright) * solid_angle(y);
      density_[static_cast<std::size_t>(y) * w + x] = static_cast<float>(v);
      row_sum[y] += v;
      bright_mean += dvec3(bright) * (solid_angle(y) / (4 * pi));
    }
    total += row_sum[y];
  }
  bright_mean_ = vec3(bright_mean);
  if (!has_bright_part()) soft_at_most_ = infinity;  // all of it, even what was too little to have a mean
  double rows = 0;
  for (int y = 0; y < h; ++y) {
    double columns = 0;
    float* cdf = &column_cdf_[static_cast<std::size_t>(y) * (w + 1)];
    for (int x = 0; x < w; ++x) {
      columns += density_[static_cast<std::size_t>(y) * w + x];
      cdf[x + 1] = row_sum[y] > 0 ? static_cast<float>(columns / row_sum[y]) : static_cast<float>(x + 1) / w;
    }
    cdf[w] = 1.0f;
    rows += row_sum[y];
    row_cdf_[y + 1] = total > 0 ? static_cast<float>(rows / total) : static_cast<float>(y + 1) / h;
  }
  row_cdf_[h] = 1.0f;
  // What is drawn has the density of the rounded tables, so that density is what pdf() must return.
  for (int y = 0; y < h; ++y)
    for (int x = 0; x < w; ++x) {
      const float* cdf = &column_cdf_[static_cast<std::size_t>(y) * (w + 1)];
      density_[static_cast<std::size_t>(y) * w + x] = (row_cdf_[y + 1] - row_cdf_[y]) * h * (cdf[x + 1] - cdf[x]) * w;
    }
}

glm::ivec2 Environment::texel(const vec3& d) const {
  float u = std::atan2(-d.x, -d.y) / (2.0f * pi_f) + 0.5f + yaw_turns_;
  u -= std::floor(u);
  const float v = std::acos(std::clamp(d.z, -1.0f, 1.0f)) / pi_f;
  return {std::min(static_cast<int>(u * map_.width), map_.width - 1),
          std::min(static_cast<int>(v * map_.height), map_.height - 1)};
}

vec3 Environment::radiance(const vec3& direction) const {
  if (!is_map()) return constant_;
  const glm::ivec2 t = texel(direction);
  const float* p = &map_.data[map_.index(t.x, t.y)];
  return {p[0], p[1], p[2]};
}

LightSample Environment::sample(const vec2& u) const {
  LightSample s;
  const int w = map_.width, h = map_.height;
  const auto [y, fy] = find_interval(row_cdf_.data(), h, u.y);
  const auto [x, fx] = find_interval(&column_cdf_[static_cast<std::size_t>(y) * (w + 1)], w, u.x);
  // Within a row, uniform in cos(theta): its pixels then have exactly their solid angles.
  const float top = std::cos(pi_f * y / h), bottom = std::cos(pi_f * (y + 1) / h);
  const float z = top + (bottom - top) * fy, sine = std::sqrt(std::max(0.0f, 1.0f - z * z));
  const float phi = 2.0f * pi_f * ((x + fx) / w - 0.5f - yaw_turns_);
  s.direction = {-sine * std::sin(phi), -sine * std::cos(phi), z};
  s.distance = infinity;
  const float* p = &map_.data[map_.index(x, y)];
  s.radiance = vec3(p[0], p[1], p[2]) - soft({p[0], p[1], p[2]});
  s.pdf = density_[static_cast<std::size_t>(y) * w + x] / (h * 2.0f * pi_f * (top - bottom));
  return s;
}

vec3 Environment::soft(const vec3& radiance) const {
  const float most = brightest_channel(radiance);
  return most > soft_at_most_ ? radiance * (soft_at_most_ / most) : radiance;
}

Environment::Parts Environment::parts(const vec3& direction) const {
  if (!is_map()) return {constant_, vec3(0), 0};
  const int w = map_.width, h = map_.height;
  const glm::ivec2 t = texel(direction);
  const float* p = &map_.data[map_.index(t.x, t.y)];
  const vec3 all(p[0], p[1], p[2]), soft_part = soft(all);
  if (!has_bright_part()) return {all, vec3(0), 0};
  const float density = density_[static_cast<std::size_t>(t.y) * w + t.x];
  if (!(density > 0)) return {soft_part, all - soft_part, 0};
  const float top = std::cos(pi_f * t.y / h), bottom = std::cos(pi_f * (t.y + 1) / h);
  return {soft_part, all - soft_part, density / (h * 2.0f * pi_f * (top - bottom))};
}

vec3 Environment::soft_around(const vec3& normal) const {
  if (!is_map()) return constant_;
  const auto p = polynomials(normal);
  vec3 sum(0);
  for (int k = 0; k < 9; ++k) sum += p[k] * harmonics_[k];
  return glm::max(sum, vec3(0));
}

float Sun::one_minus_cos() const {
  const float s = std::sin(0.5f * disc_radius());
  return 2.0f * s * s;  // 1 - cos without cancellation
}

vec3 Sun::radiance() const {
  // irradiance = radiance * pi * sin^2(radius)
  const float s = std::sin(disc_radius());
  return irradiance / (pi_f * s * s);
}

LightSample Sun::sample(const vec2& u) const {
  LightSample l;
  const float rim = one_minus_cos(), q = u.x * rim;  // 1 - cos(theta), uniform
  const float sine = std::sqrt(std::max(0.0f, q * (2.0f - q))), phi = 2.0f * pi_f * u.y;
  l.direction = glm::normalize(Frame(direction).to_world({sine * std::cos(phi), sine * std::sin(phi), 1.0f - q}));
  l.distance = infinity;
  l.radiance = radiance();
  l.pdf = 1.0f / (2.0f * pi_f * rim);
  return l;
}

float Sun::pdf(const vec3& d) const {
  // |d - s|^2 = 2 (1 - cos): compared so, the narrow cone keeps its digits.
  const vec3 e = d - direction;
  const float rim = one_minus_cos();
  return glm::dot(e, e) <= 2.0f * rim ? 1.0f / (2.0f * pi_f * rim) : 0.0f;
}

LightSample RectangleLight::sample(const vec3& from, const vec2& u) const {
  LightSample l;
  const vec3 d = corner + u.x * edge_u + u.y * edge_v - from;
  const float distance2 = glm::dot(d, d);
  if (!(distance2 > 0)) return l;
  l.distance = std::sqrt(distance2);
  l.direction = d / l.distance;
  l.pdf = pdf(l.direction, l.distance);
  if (l.pdf > 0) l.radiance = radiance;
  return l;
}

float RectangleLight::pdf(const vec3& direction, float distance) const {
  const float cosine = -glm::dot(direction, normal());
  return cosine > 1e-6f ? distance * distance / (cosine * area()) : 0.0f;
}

std::optional<float> RectangleLight::intersect(const vec3& from, const vec3& direction) const {
  const vec3 n = glm::cross(edge_u, edge_v);
  const float facing = glm::dot(direction, n);
  if (facing >= 0) return std::nullopt;
  const float t = glm::dot(corner - from, n) / facing;
  if (!(t > 0)) return std::nullopt;
  const vec3 p = from + t * direction - corner;
  const float n2 = glm::dot(n, n);
  const float a = glm::dot(glm::cross(p, edge_v), n) / n2, b = glm::dot(glm::cross(edge_u, p), n) / n2;
  if (a < 0 || a > 1 || b < 0 || b > 1) return std::nullopt;
  return t;
}

void Lights::prepare(const vec3& centre) {
  chance_.clear();
  cdf_.clear();
  std::vector<double> power;
  if (environment->has_bright_part()) power.push_back(luminance(environment->bright_mean()) * pi);
  for (const Sun& s : suns) power.push_back(luminance(s.irradiance));
  for (const RectangleLight& r : rectangles) {
    const vec3 d = r.corner + 0.5f * (r.edge_u + r.edge_v) - centre;
    power.push_back(luminance(r.radiance) * r.area() / std::max(1e-6, double(glm::dot(d, d))));
  }
  double total = 0;
  for (double p : power) total += p;
  // A tenth is shared out evenly: a light that is weak at the centre may be strong elsewhere.
  float sum = 0;
  for (double p : power) {
    const double share = total > 0 ? p / total : 1.0 / power.size();
    chance_.push_back(static_cast<float>(0.9 * share + 0.1 / power.size()));
    sum += chance_.back();
    cdf_.push_back(sum);
  }
}

LightSample Lights::sample(const vec3& from, float xi, const vec2& u) const {
  if (cdf_.empty()) return {};
  const float x = xi * cdf_.back();
  int i = static_cast<int>(std::upper_bound(cdf_.begin(), cdf_.end(), x) - cdf_.begin());
  i = std::min(i, count() - 1);
  const float chance = chance_[i];
  const int first_sun = environment->has_bright_part() ? 1 : 0;
  LightSample s;
  if (i < first_sun)
    s = environment->sample(u);
  else if (i < first_sun + static_cast<int>(suns.size()))
    s = suns[i - first_sun].sample(u);
  else
    s = rectangles[i - first_sun - suns.size()].sample(from, u);
  s.pdf *= chance;
  return s;
}

vec3 Lights::seen_by_bsdf_ray(const vec3& from, const vec3& direction, float bsdf_pdf, float surface) const {
  vec3 sum(0);
  std::size_t i = 0;
  const bool leaves = surface == infinity;
  if (leaves) {
    const Environment::Parts e = environment->parts(direction);
    sum += e.soft;  // sampled by the BSDF alone
    if (e.bright != vec3(0)) sum += e.bright * power_heuristic(bsdf_pdf, e.pdf * chance_[i]);
  }
  i += environment->has_bright_part();
  for (const Sun& s : suns) {
    const float p = leaves ? s.pdf(direction) : 0.0f;
    if (p > 0) sum += s.radiance() * power_heuristic(bsdf_pdf, p * chance_[i]);
    ++i;
  }
  for (const RectangleLight& r : rectangles) {
    if (const auto t = r.intersect(from, direction); t && *t < surface)
      sum += r.radiance * power_heuristic(bsdf_pdf, r.pdf(direction, *t) * chance_[i]);
    ++i;
  }
  return sum;
}

}  // namespace moomill
