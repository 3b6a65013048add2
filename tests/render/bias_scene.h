#pragma once
// The picture of the bias test, for the product and for an independent integrator.
#include "generator/core/parallel.h"
#include "tests/render/fixtures.h"
#include "tests/render/reference.h"

namespace moomill::test::bias {

constexpr int size = 64, pixels = size * size;

// --- the scene: a floor of eight materials, a wall and a roof, all parallelograms ---

enum Kind { lambert, rough_dielectric, glossy_dielectric, metal, mixed, normal_mapped, textured, half_specular, kinds };
inline const char* const kind_names[] = {"lambert", "rough dielectric", "glossy dielectric", "metal", "mixed", "normal map", "texture", "specular 0.5"};
enum Light { constant, map, sun, rectangle, all, light_kinds };
inline const char* const light_names[] = {"constant", "map", "sun", "rectangle", "all"};

struct Finish {
  double roughness, metallic, specular;
  vec3 base;
};
inline const Finish finishes[kinds] = {{1, 0, 0, {0.6f, 0.5f, 0.4f}},       {0.8, 0, 1, {0.5f, 0.3f, 0.6f}},   {0.35, 0, 1, {0.2f, 0.4f, 0.6f}}, {0.4, 1, 1, {0.9f, 0.6f, 0.3f}},
                                {0.5, 0.5, 1, {0.8f, 0.7f, 0.2f}}, {0.6, 0, 1, {0.5f, 0.5f, 0.5f}}, {0.7, 0, 1, {1, 1, 1}},           {0.5, 0, 0.5, {0.4f, 0.6f, 0.5f}}};
inline constexpr std::array<std::uint8_t, 3> bent_texel = {186, 90, 229};  // leans the normal by some 31 degrees
constexpr int texture_side = 8;

inline Image8 texture_image() {
  Image8 image(texture_side, texture_side, 3);
  std::mt19937 random(5);
  for (auto& v : image.data) v = static_cast<std::uint8_t>(40 + random() % 200);
  return image;
}

struct Plate {
  vec3 corner, u, v;
  int material;
};
inline std::vector<Plate> plates() {
  std::vector<Plate> p;
  for (int k = 0; k < kinds; ++k) p.push_back({{-2.0f + k % 4, -1.0f + k / 4, 0}, {1, 0, 0}, {0, 1, 0}, k});
  p.push_back({{-2, 1, 0}, {4, 0, 0}, {0, 0, 1.2f}, lambert});
  p.push_back({{-1.2f, 0.5f, 1.0f}, {0, 0.5f, 0.1f}, {2.4f, 0, 0.1f}, glossy_dielectric});
  return p;
}

struct Stage {
  std::vector<Plate> parts = plates();
  std::vector<Surface> surfaces;
  Scene scene;
  Lights lights;
  Camera camera = look_at({0.2, -3.6, 5.2}, {0, 0, 0.1}, 100, size, size);
  explicit Stage(Light kind) {
    auto a = std::make_shared<Appearance>();
    for (const Finish& f : finishes) {
      add_material(*a, static_cast<float>(f.roughness), static_cast<float>(f.metallic), {f.base});
      a->materials.back().specular = static_cast<float>(f.specular);
    }
    Texture bent, paint;
    bent.image = Image8(2, 2, 3);
    for (std::size_t i = 0; i < bent.image.data.size(); ++i) bent.image.data[i] = bent_texel[i % 3];
    paint.image = texture_image();
    a->textures = {std::make_shared<Texture>(bent), std::make_shared<Texture>(paint)};
    a->materials[normal_mapped].normal_texture = 0;
    Paint p;
    p.coats.push_back({vec3(1), 1, false});
    a->paints[textured] = std::make_shared<Paint>(p);
    scene.appearance = a;
    for (const Plate& part : parts) surfaces.push_back(plate_surface(part.corner, part.u, part.v));
    for (std::size_t i = 0; i < parts.size(); ++i) scene.instances.push_back(instance_of(surfaces[i], 0, parts[i].material));
    scene.animal_count = 1;

    if (kind == constant) lights.environment = std::make_shared<Environment>(vec3(1.0f, 0.8f, 0.6f));
    if (kind == map || kind == all) {
      ImageF sky(8, 4, 3, 0.3f);
      sky.at(2, 1, 0) = 6, sky.at(5, 0, 2) = 5;
      lights.environment = std::make_shared<Environment>(sky, "test", 1.0f, 0.3);
    }
    if (kind == sun || kind == all) {
      lights.suns.push_back({glm::normalize(vec3(0.5f, -1, 1.4f)), {2, 1.8f, 1.5f}, 0.00465f});
      if (kind == all) lights.suns.push_back({glm::normalize(vec3(-1, -0.4f, 0.8f)), {0.5f, 0.6f, 0.9f}, 0.3f});
    }
    if (kind == rectangle || kind == all) {
      RectangleLight r;
      r.corner = {-1.5f, -1.5f, 1.8f};
      r.edge_u = {0, 1.5f, 0};
      r.edge_v = {1.5f, 0, 0};
      r.radiance = {4, 5, 6};
      lights.rectangles.push_back(r);
    }
    lights.prepare(vec3(0));
  }
};

// --- the independent integrator ---

struct Independent {
  const Stage& stage;
  std::vector<ReferenceFinish> models;
  std::vector<dvec3> texels;
  dvec3 bent;  // normal of the normal map in the frame (u, -v, n) of its plate

  explicit Independent(const Stage& s) : stage(s) {
    for (const Finish& f : finishes) models.emplace_back(f.roughness, f.metallic, f.specular);
    for (std::uint8_t v : texture_image().data) {
      const double c = v / 255.0;
      if (texels.empty() || filled == 3) texels.emplace_back(), filled = 0;
      texels.back()[filled++] = c <= 0.04045 ? c / 12.92 : std::pow((c + 0.055) / 1.055, 2.4);
    }
    bent = glm::normalize(2.0 / 255.0 * dvec3(bent_texel[0], bent_texel[1], bent_texel[2]) - 1.0);
  }

  struct Hit {
    double t = std::numeric_limits<double>::infinity(), u = 0, v = 0;
    int plate = -1;
  };
  Hit intersect(const dvec3& o, const dvec3& d) const {
    Hit best;
    for (std::size_t i = 0; i < stage.parts.size(); ++i) {
      const dvec3 eu(stage.parts[i].u), ev(stage.parts[i].v), n = glm::cross(eu, ev);
      const double t = glm::dot(dvec3(stage.parts[i].corner) - o, n) / glm::dot(d, n);
      if (!(t > 1e-6 && t < best.t)) continue;
      const dvec3 p = o + t * d - dvec3(stage.parts[i].corner);
      const double n2 = glm::dot(n, n), a = glm::dot(glm::cross(p, ev), n) / n2, b = glm::dot(glm::cross(eu, p), n) / n2;
      if (a >= 0 && a <= 1 && b >= 0 && b <= 1) best = {t, a, b, static_cast<int>(i)};
    }
    return best;
  }

  dvec3 base(int material, double u, double v) const {
    if (material != textured) return dvec3(finishes[material].base);
    const double x = u * texture_side - 0.5, y = v * texture_side - 0.5;  // bilinear, repeated
    const int x0 = static_cast<int>(std::floor(x)), y0 = static_cast<int>(std::floor(y));
    const auto at = [&](int i, int j) { return texels[(j + texture_side) % texture_side * texture_side + (i + texture_side) % texture_side]; };
    const double fx = x - x0, fy = y - y0;
    return (1 - fy) * ((1 - fx) * at(x0, y0) + fx * at(x0 + 1, y0)) + fy * ((1 - fx) * at(x0, y0 + 1) + fx * at(x0 + 1, y0 + 1));
  }

  // Radiance of the environment along a ray that meets a surface at this distance; suns and rectangles are sampled.
  dvec3 emitted(const dvec3& d, double surface) const {
    dvec3 sum(0);
    const Environment& env = *stage.lights.environment;
    if (std::isinf(surface)) {
      if (!env.is_map()) {
        sum += dvec3(env.mean_radiance());
      } else {  // centre column towards -Y turned by yaw, columns to the right lie to the right of who looks there
        const ImageF& m = env.map();
        double turn = std::atan2(-d.x, -d.y) / (2 * pi) + 0.5 + env.yaw_rad() / (2 * pi);
        turn -= std::floor(turn);
        const int x = std::min(m.width - 1, static_cast<int>(turn * m.width));
        const int y = std::min(m.height - 1, static_cast<int>(std::acos(std::clamp(d.z, -1.0, 1.0)) / pi * m.height));
        sum += dvec3(m.at(x, y, 0), m.at(x, y, 1), m.at(x, y, 2));
      }
    }
    return sum;
  }

  struct Basis {
    dvec3 x, y, z;
    explicit Basis(const dvec3& n) : z(n) {
      x = glm::normalize(glm::cross(std::abs(n.z) < 0.9 ? dvec3(0, 0, 1) : dvec3(1, 0, 0), n));
      y = glm::cross(n, x);
    }
    dvec3 local(const dvec3& w) const { return {glm::dot(w, x), glm::dot(w, y), glm::dot(w, z)}; }
    dvec3 world(const dvec3& w) const { return w.x * x + w.y * y + w.z * z; }
  };

  // One sample of the radiance that arrives along a camera ray. Suns and rectangles by a point of theirs, the
  // environment where rays happen to meet it; directions half
  // by cosine, half by reflection at half vectors with the density D cos(h).
  template <class Random>
  dvec3 radiance(dvec3 o, dvec3 d, Random& random) const {
    const auto unit = [&] { return static_cast<double>(random() >> 11) * 0x1p-53; };
    dvec3 throughput(1), sum(0);
    for (int depth = 0; depth < 60; ++depth) {
      const Hit hit = intersect(o, d);
      if (depth > 0) sum += throughput * emitted(d, hit.t);
      if (hit.plate < 0) break;
      const Plate& plate = stage.parts[hit.plate];
      const ReferenceFinish& model = models[plate.material];
      const dvec3 albedo = base(plate.material, hit.u, hit.v), wo_world = -d;
      const dvec3 up = glm::normalize(glm::cross(dvec3(plate.u), dvec3(plate.v)));
      dvec3 n = up;
      if (plate.material == normal_mapped) n = bent.x * glm::normalize(dvec3(plate.u)) - bent.y * glm::normalize(dvec3(plate.v)) + bent.z * up;
      const dvec3 geometric = glm::dot(up, wo_world) < 0 ? -up : up;
      if (glm::dot(n, geometric) < 0) n = -n;
      const double facing = glm::dot(n, wo_world);  // a normal that looks away leans
      if (facing < 0.02) n = glm::normalize(n + (0.02 - facing) * wo_world);
      const Basis basis(n);
      const dvec3 wo = basis.local(wo_world), at = o + hit.t * d;

      for (const Sun& s : stage.lights.suns) {
        const double rim = 2 * std::pow(std::sin(0.5 * double(s.angular_radius)), 2), q = unit() * rim, phi = 2 * pi * unit();
        const double r = std::sqrt(q * (2 - q));
        const dvec3 w = Basis(glm::normalize(dvec3(s.direction))).world({r * std::cos(phi), r * std::sin(phi), 1 - q}), wi = basis.local(w);
        if (wi.z <= 0 || glm::dot(w, geometric) <= 0 || intersect(at, w).plate >= 0) continue;
        const dvec3 sun_radiance = dvec3(s.irradiance) / (pi * std::pow(std::sin(double(s.angular_radius)), 2));
        sum += throughput * sun_radiance * model.evaluate(wo, wi, albedo) * wi.z * 2.0 * pi * rim;
      }

      for (const RectangleLight& r : stage.lights.rectangles) {  // by area; it shines but does not block
        const dvec3 eu(r.edge_u), ev(r.edge_v), to = dvec3(r.corner) + unit() * eu + unit() * ev - at;
        const double distance = glm::length(to), facing_light = -glm::dot(to, glm::cross(eu, ev)) / distance;  // cosine times area
        const dvec3 w = to / distance, wi = basis.local(w);
        if (facing_light <= 0 || wi.z <= 0 || glm::dot(w, geometric) <= 0 || intersect(at, w).t < distance) continue;
        sum += throughput * dvec3(r.radiance) * model.evaluate(wo, wi, albedo) * wi.z * facing_light / (distance * distance);
      }

      dvec3 wi;
      const double phi = 2 * pi * unit();
      if (unit() < 0.5) {
        const double q = unit();
        wi = {std::sqrt(q) * std::cos(phi), std::sqrt(q) * std::sin(phi), std::sqrt(1 - q)};
      } else {
        const double q = unit(), t2 = model.alpha() * model.alpha() * q / (1 - q), z = 1 / std::sqrt(1 + t2), r = std::sqrt(t2) * z;
        const dvec3 h(r * std::cos(phi), r * std::sin(phi), z);
        wi = 2 * glm::dot(wo, h) * h - wo;
      }
      if (wi.z <= 1e-9) break;
      const dvec3 h = glm::normalize(wo + wi);
      const double density = 0.5 * wi.z / pi + 0.5 * reference_ggx_d(h, model.alpha()) * h.z / (4 * glm::dot(wo, h));
      throughput *= model.evaluate(wo, wi, albedo) * wi.z / density;
      d = glm::normalize(basis.world(wi));
      if (glm::dot(d, geometric) <= 0) break;
      o = at;
      if (depth > 3) {
        if (unit() > 0.75) break;
        throughput /= 0.75;
      }
    }
    return sum;
  }

 private:
  int filled = 0;  // channels of the last texel
};

// The Blackman-Harris window by rejection from a uniform position, in pixels.
template <class Random>
double window(Random& random) {
  for (;;) {
    const double q = static_cast<double>(random() >> 11) * 0x1p-53, a = 2 * pi * q;
    const double w = 0.35875 - 0.48829 * std::cos(a) + 0.14128 * std::cos(2 * a) - 0.01168 * std::cos(3 * a);
    if (static_cast<double>(random() >> 11) * 0x1p-53 < w) return (2 * q - 1) * 1.5;
  }
}

}  // namespace moomill::test::bias
