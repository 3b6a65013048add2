#include "validate/studies/stress_scenes.h"

#include "generator/core/parallel.h"

namespace moomill {

void finish_surface(Surface& s) {
  if (s.normals.empty()) {
    std::vector<dvec3> sum(s.rest.size(), dvec3(0));
    for (const uvec3& t : s.triangles)
      for (int k = 0; k < 3; ++k)
        sum[t[k]] += glm::cross(dvec3(s.rest[t[1]]) - dvec3(s.rest[t[0]]), dvec3(s.rest[t[2]]) - dvec3(s.rest[t[0]]));
    for (const dvec3& n : sum) s.normals.push_back(glm::length(n) > 0 ? vec3(glm::normalize(n)) : vec3(0, 0, 1));
  }
  s.materials.assign(s.triangles.size(), 0);
  s.parts.assign(s.triangles.size(), 0);
  bake_nnopcs(s, s.rest, NnopcsNormalization::box);
}

Surface stress_sphere(int rows, int columns, double radius, int bumps) {
  Surface s;
  const auto at = [&](int i, int j) -> unsigned {
    if (i == 0) return 0;
    if (i == rows) return 1;
    return 2 + (i - 1) * columns + j % columns;
  };
  s.rest = {vec3(0, 0, radius), vec3(0, 0, -radius)};
  for (int i = 1; i < rows; ++i)
    for (int j = 0; j < columns; ++j) {
      const double theta = pi * i / rows, phi = 2 * pi * j / columns;
      const double r = radius * (bumps > 0 ? 1 + 0.1 * std::sin(bumps * theta) * std::cos(bumps * phi) : 1.0);
      s.rest.push_back(
          vec3(r * std::sin(theta) * std::cos(phi), r * std::sin(theta) * std::sin(phi), r * std::cos(theta)));
    }
  for (int i = 0; i < rows; ++i)
    for (int j = 0; j < columns; ++j) {
      if (i > 0) s.triangles.push_back({at(i, j), at(i + 1, j), at(i, j + 1)});
      if (i < rows - 1) s.triangles.push_back({at(i, j + 1), at(i + 1, j), at(i + 1, j + 1)});
    }
  finish_surface(s);
  return s;
}

Surface stress_plate(const vec3& corner, const vec3& u, const vec3& v, int n) {
  Surface s;
  for (int j = 0; j <= n; ++j)
    for (int i = 0; i <= n; ++i) {
      const float a = static_cast<float>(i) / n, b = static_cast<float>(j) / n;
      s.rest.push_back(corner + a * u + b * v);
      s.uvs.push_back({a, b});
    }
  for (int j = 0; j < n; ++j)
    for (int i = 0; i < n; ++i) {
      const unsigned a = j * (n + 1) + i;
      s.triangles.push_back({a, a + 1, a + n + 2});
      s.triangles.push_back({a, a + n + 2, a + n + 1});
    }
  finish_surface(s);
  return s;
}

Camera stress_camera(const dvec3& eye, const dvec3& target, double angle_deg, int width, int height) {
  Camera c;
  const dvec3 z = glm::normalize(target - eye);
  const dvec3 up = std::abs(z.z) > 0.99 ? dvec3(0, 1, 0) : dvec3(0, 0, 1);
  const dvec3 x = glm::normalize(glm::cross(z, up)), y = glm::cross(z, x);
  c.world_to_camera = glm::transpose(dmat3(x, y, z));
  c.centre = eye;
  c.fx = c.fy = 0.5 * width / std::tan(0.5 * angle_deg * degrees);
  c.cx = 0.5 * width;
  c.cy = 0.5 * height;
  c.width = width;
  c.height = height;
  return c;
}

PixelMask all_pixels(const Camera& camera) {
  PixelMask mask(camera.width, camera.height);
  mask.fill();
  return mask;
}

std::shared_ptr<Appearance> Stage::own_appearance() {
  auto a = std::make_shared<Appearance>(*scene.appearance);
  scene.appearance = a;
  return a;
}

void Stage::add(Surface surface, int animal, const vec3& offset, int material_index) {
  if (scene.appearance->materials.empty()) finish(0.7f, 0, vec3(0.5f));
  surfaces.push_back(std::make_unique<Surface>(std::move(surface)));
  const Surface& s = *surfaces.back();
  Instance in;
  in.surface = &s;
  in.posed.origin = scene.origin;
  in.posed.positions = s.rest;
  for (vec3& p : in.posed.positions) p += offset;
  in.posed.normals = s.normals;
  in.materials = {material_index};
  in.animal = animal;
  scene.instances.push_back(std::move(in));
  scene.animal_count = std::max(scene.animal_count, animal + 1);
}

int Stage::finish(float roughness, float metallic, const vec3& base) {
  const auto a = own_appearance();
  Material m;
  m.roughness = roughness;
  m.metallic = metallic;
  m.paint = static_cast<int>(a->paints.size());
  Paint p;
  p.coats.push_back({base, -1, false});
  a->paints.push_back(std::make_shared<Paint>(p));
  a->materials.push_back(m);
  a->coat_count = 1;
  return static_cast<int>(a->materials.size()) - 1;
}

Material& Stage::material(int index) {
  return own_appearance()->materials[index];
}

int Stage::texture(Image8 image) {
  const auto a = own_appearance();
  a->textures.push_back(std::make_shared<Texture>(Texture{std::move(image), {}}));
  return static_cast<int>(a->textures.size()) - 1;
}

void Stage::environment(const vec3& radiance) {
  lights.environment = std::make_shared<Environment>(radiance);
}

Shaded shade(const Stage& stage, const Camera& camera, const PathOptions& options) {
  Lights lights = stage.lights;
  lights.prepare(vec3(0));
  const Accel accel(stage.scene);
  const SkyShares sky = sky_shares(stage.scene, accel);
  PathOptions with_sky = options;
  with_sky.sky = &sky;
  const Radiance r = trace_radiance(stage.scene, lights, accel, camera, all_pixels(camera), with_sky);
  Shaded out;
  out.not_finite = r.not_finite;
  out.least = std::numeric_limits<double>::infinity();
  const std::vector<float>& d = r.coats[0].data;
  for (std::size_t p = 0; p < d.size(); p += 4) {
    if (!(d[p + 3] > 0)) continue;
    const vec3 c(d[p], d[p + 1], d[p + 2]);
    out.pixels.push_back(c);
    out.mean += dvec3(c);
    for (int k = 0; k < 3; ++k) {
      out.least = std::min<double>(out.least, c[k]);
      out.most = std::max<double>(out.most, c[k]);
    }
  }
  if (!out.pixels.empty()) out.mean /= static_cast<double>(out.pixels.size());
  return out;
}

namespace {

template <class T>
using Vec3 = glm::vec<3, T>;

// Distance and barycentrics of a ray on the plane of a triangle, by determinants.
template <class T>
bool cramer(const Vec3<T>& o, const Vec3<T>& d, const Vec3<T>& a, const Vec3<T>& b, const Vec3<T>& c, T& t, T& u,
            T& v) {
  const auto det = [](const Vec3<T>& p, const Vec3<T>& q, const Vec3<T>& r) { return glm::dot(p, glm::cross(q, r)); };
  const Vec3<T> ab = a - b, ac = a - c, ao = a - o;
  const T whole = det(ab, ac, d);
  if (whole == 0) return false;
  u = det(ao, ac, d) / whole;
  v = det(ab, ao, d) / whole;
  t = det(ab, ac, ao) / whole;
  return true;
}

}  // namespace

OracleHit oracle_hit(const Scene& scene, const Camera& camera, double x, double y) {
  OracleHit best;
  const dvec3 o = camera.centre - scene.origin, d = camera.direction(x, y);
  constexpr double doubt = 1e-9;
  const vec3* nearest[3] = {};
  double depth = std::numeric_limits<double>::infinity();
  for (const Instance& in : scene.instances)
    for (const uvec3& k : in.surface->triangles) {
      const vec3 *a = &in.posed.positions[k[0]], *b = &in.posed.positions[k[1]], *c = &in.posed.positions[k[2]];
      double t = 0, u = 0, v = 0;
      if (!cramer<double>(o, d, dvec3(*a), dvec3(*b), dvec3(*c), t, u, v) || !(t > 0)) continue;
      const double inside = std::min({u, v, 1 - u - v});
      if (std::abs(inside) < doubt) best.certain = false;
      if (!(inside >= 0) || t >= depth) continue;
      depth = t;
      nearest[0] = a, nearest[1] = b, nearest[2] = c;
    }
  if (std::isinf(depth)) return best;
  using L = long double;
  L t = 0, u = 0, v = 0;
  cramer<L>(Vec3<L>(o), Vec3<L>(d), Vec3<L>(*nearest[0]), Vec3<L>(*nearest[1]), Vec3<L>(*nearest[2]), t, u, v);
  best.depth = static_cast<double>(t);
  return best;
}

double depth_error(const Scene& scene, const Camera& camera, BuildKind kind) {
  const Accel accel(scene, kind);
  const FirstHits hits = trace_first_hits(scene, accel, camera, all_pixels(camera));
  std::vector<double> error(hits.depth.size());
  parallel_for(error.size(), 16, [&](std::size_t p) {
    const OracleHit truth = oracle_hit(scene, camera, p % camera.width + 0.5, p / camera.width + 0.5);
    const bool hit = hits.instance[p] != no_hit;
    if (hit != (truth.depth > 0))
      error[p] = truth.certain ? 1 : 0;
    else if (hit)
      error[p] = std::isfinite(hits.depth[p]) ? std::abs(hits.depth[p] - truth.depth) / truth.depth : 1.0;
  });
  double worst = 0, wrong = 0;
  for (const double e : error) {
    if (e >= 1) ++wrong;
    worst = std::max(worst, e);
  }
  return wrong > 0 ? wrong : worst;
}

}  // namespace moomill
