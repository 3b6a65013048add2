// Drawing from distributions, keyed by identity.
#include "generator/core/error.h"
#include "generator/core/random.h"
#include "scenes/scene.h"

namespace moomill {
namespace {

// What a draw is for. The camera counts only where the value differs per view; every frame-wide value has the same
// stand-in, so that asking for it from another camera changes nothing.
std::uint64_t identity_of(const Choice& d, std::uint64_t seed, int frame, int camera) {
  constexpr std::uint64_t any_camera = ~0ull;
  const std::uint64_t view = d.per_view ? static_cast<std::uint64_t>(camera) : any_camera;
  return hash_identity({seed, hash_text(d.key), static_cast<std::uint64_t>(frame), view});
}

// A component of an entry; a single number stands for all components.
double component(const std::vector<double>& v, int c) {
  check(v.size() == 1 || c < static_cast<int>(v.size()), "a distribution has too few components");
  return v.size() == 1 ? v[0] : v[c];
}

double draw_component(const Choice& d, std::uint64_t identity, int c) {
  if (d.values.empty()) return 0;
  const std::uint64_t own = hash_identity({identity, static_cast<std::uint64_t>(c)});
  auto value = [&](std::size_t i) {
    check(i < d.values.size(), "a distribution has too few values");
    return component(d.values[i], c);
  };
  switch (d.kind) {
    case Choice::Kind::constant:
      return value(0);
    case Choice::Kind::uniform: {
      const double lower = value(0), upper = value(1);
      return std::clamp(lower + to_unit(own) * (upper - lower), lower, upper);
    }
    case Choice::Kind::normal: {
      const double x = value(0) + value(1) * to_normal(own);
      return d.values.size() > 2 ? std::clamp(x, value(2), value(3)) : x;
    }
    case Choice::Kind::log_uniform: {
      const double lower = portable_log(value(0)), upper = portable_log(value(1));
      return std::clamp(portable_exp(lower + to_unit(own) * (upper - lower)), value(0), value(1));
    }
    case Choice::Kind::choose: {
      // One entry for all components: a colour is chosen whole.
      const double u = to_unit(hash_identity({identity}));
      return value(static_cast<std::size_t>(u * static_cast<double>(d.values.size())));
    }
  }
  return 0;
}

bool is_vector(const Choice& d) {
  return std::any_of(d.values.begin(), d.values.end(), [](const std::vector<double>& v) { return v.size() == 3; });
}

Distribution constant_of(std::vector<double> values) {
  Distribution d;
  d.values = {std::move(values)};
  return d;
}

}  // namespace

Distribution constant_number(double value) {
  return constant_of({value});
}
Distribution constant_vector(const dvec3& value) {
  return constant_of({value.x, value.y, value.z});
}

Distribution constant_text(const std::string& value) {
  Distribution d;
  d.words = {value};
  return d;
}

double draw_number(const Distribution& d, std::uint64_t seed, int frame, int camera) {
  return draw_component(d, identity_of(d, seed, frame, camera), 0);
}

dvec3 draw_vector(const Distribution& d, std::uint64_t seed, int frame, int camera) {
  const std::uint64_t identity = identity_of(d, seed, frame, camera);
  const int last = is_vector(d) ? 2 : 0;  // a grey is drawn once
  return {draw_component(d, identity, 0), draw_component(d, identity, std::min(1, last)),
          draw_component(d, identity, last)};
}

std::string draw_text(const Distribution& d, std::uint64_t seed, int frame, int camera) {
  if (d.words.empty()) return "";
  const double u = to_unit(hash_identity({identity_of(d, seed, frame, camera)}));
  return d.words[static_cast<std::size_t>(u * static_cast<double>(d.words.size()))];
}

void for_each_distribution(const SceneSpec& scene, const std::function<void(const Distribution&)>& visit) {
  auto visit_optional = [&](const std::optional<Distribution>& d) {
    if (d) visit(*d);
  };
  for (const AnimalSpec& a : scene.animals) {
    visit(a.position);
    visit(a.yaw_deg);
  }
  if (scene.cameras.rings) visit(scene.cameras.rings->radius);
  for (const ListedCamera& c : scene.cameras.list) {
    visit(c.position);
    visit_optional(c.target);
  }
  visit(scene.cameras.target);
  visit(scene.cameras.focal_mm);
  const LightSpec& light = scene.light;
  visit(light.environment_color);
  visit_optional(light.environment_file);
  visit(light.environment_strength);
  visit(light.environment_yaw_deg);
  for (const LightSpec::Sun& s : light.suns)
    for (const Distribution* d : {&s.azimuth_deg, &s.elevation_deg, &s.irradiance, &s.color, &s.angular_diameter_deg})
      visit(*d);
  for (const LightSpec::Rectangle& r : light.rectangles)
    for (const Distribution* d : {&r.position, &r.target, &r.radiance, &r.color}) visit(*d);
  visit(scene.background.color);
  visit_optional(scene.background.image);
  visit(scene.ground.color);
  visit(scene.ground.roughness);
}

void check_surface_light(const SceneSpec& scene) {
  if (!scene.render.surface_light) return;
  if (scene.render.max_bounces > 0)
    input_error("{}: render.surface_light gathers light of any number of bounces; leave render.max_bounces = {} out, or surface_light", scene.file, scene.render.max_bounces);
  for_each_distribution(scene, [&](const Distribution& d) {
    if (d.per_view && d.key.starts_with("light."))
      input_error("{}: {} is drawn per view, but render.surface_light gathers light once per frame; draw it per frame or leave surface_light out", scene.file, d.key);
  });
}

Json drawn_values(const SceneSpec& scene, int frame, const std::vector<int>& cameras) {
  Json out = Json::object();
  for_each_distribution(scene, [&](const Distribution& d) {
    if (d.is_constant()) return;
    auto value = [&](int camera) -> Json {
      if (!d.words.empty()) return draw_text(d, scene.seed, frame, camera);
      if (!is_vector(d)) return draw_number(d, scene.seed, frame, camera);
      const dvec3 v = draw_vector(d, scene.seed, frame, camera);
      return {v.x, v.y, v.z};
    };
    if (!d.per_view) {
      out[d.key] = value(0);
      return;
    }
    Json list = Json::array();
    for (const int camera : cameras) list.push_back(value(camera));
    out[d.key] = std::move(list);
  });
  return out;
}

}  // namespace moomill
