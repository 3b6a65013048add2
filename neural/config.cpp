#include "neural/config.h"

#include "generator/core/error.h"
#include "generator/core/toml.h"

namespace moomill {
namespace {

// Every key of a table, once: readers and writers of TOML and JSON iterate it. f(key, field, lowest, highest).
template <class F>
void fields(ModelConfig& m, F&& f) {
  f("keypoints", m.keypoints, 1, 4096);
  f("local_features", m.local_features, 16, 4096);
  f("global_features", m.global_features, 1, 65536);
  f("head_width", m.head_width, 16, 4096);
  f("head_blocks", m.head_blocks, 1, 64);
  f("encoder_blocks", m.encoder_blocks, 0, 64);
  f("keypoint_bottleneck", m.keypoint_bottleneck, 1, 65536);
  f("near_neighbours", m.near_neighbours, 1, 4096);
  f("neighbours", m.neighbours, 1, 4096);
  f("position_scale", m.position_scale, 1e-6, 1e6);
  f("position_gradient", m.position_gradient, 0, 1);
  f("reader_radius_m", m.reader_radius, 1e-6, 1e6);
  f("nnopcs", m.nnopcs, 0, 1);
  f("surface_octaves", m.surface_octaves, 0, 16);
  f("image_channels", m.image_channels, 1, 8192);
  f("image_blocks", m.image_blocks, 1, 64);
  f("code_activation", m.code_activation, 0, 1);
}

template <class F>
void fields(OptimiserConfig& o, F&& f) {
  f("rate", o.schedule.rate, 0, 1e6);
  f("decay_factor", o.schedule.decay_factor, 1e-9, 1);
  f("decay_epochs", o.schedule.decay_epochs, 0, 1000000000);
  f("warmup_steps", o.schedule.warmup_steps, 0, 1000000000);
  f("final_share", o.schedule.final_share, 0, 1);
  f("weight_decay", o.weight_decay, 0, 10);
  f("clip_norm", o.clip_norm, 0, 1e9);
}

// What both stages have.
template <class Stage, class F>
void stage_fields(Stage& t, F&& f) {
  fields(t.optimiser, f);
  f("batch", t.batch, 1, 65536);
  f("epochs", t.epochs, 1, 1000000000);
  f("views_per_frame", t.views_per_frame, 1, 65536);
  f("validate_every", t.validate_every, 1, 1000000000);
  f("surface_points", t.surface_points, 1, 1000000);
  f("keypoint_noise_m", t.keypoint_noise_m, 0, 1e3);
  f("turn_cameras", t.turn_cameras, 0, 1);
}

template <class F>
void fields(GeometryTraining& g, F&& f) {
  stage_fields(g, f);
  f("silhouette_points", g.silhouette_points, 2, 1000000);
  f("near_sigma", g.near_sigma, 0, 10);
  f("far_sigma", g.far_sigma, 0, 10);
  f("silhouette_weight", g.silhouette_weight, 0, 1e6);
  f("keypoint_weight", g.keypoint_weight, 0, 1e6);
  f("depth_weight", g.depth_weight, 0, 1e6);
  f("code_weight", g.code_weight, 0, 1e6);
  f("nnopcs_weight", g.nnopcs_weight, 0, 1e6);
  f("squared_depth", g.squared_depth, 0, 1);
}

template <class F>
void fields(TextureTraining& t, F&& f) {
  stage_fields(t, f);
  f("micro_batch", t.micro_batch, 0, 65536);
  f("color_weight", t.color_weight, 0, 1e6);
  f("divergence_weight", t.divergence_weight, 0, 1e6);
  f("agreement_weight", t.agreement_weight, 0, 1e6);
  f("encoder_width", t.encoder.width, 0, 16384);
  f("encoder_height", t.encoder.height, 0, 16384);
  f("encoder_crop", t.encoder.crop, 0, 1);
}

struct FromToml {
  TomlReader& table;
  void operator()(const char* key, int& v, double lo, double hi) const {
    v = static_cast<int>(table.integer(key, v, static_cast<std::int64_t>(lo), static_cast<std::int64_t>(hi)));
  }
  void operator()(const char* key, double& v, double lo, double hi) const { v = table.number(key, v, lo, hi); }
  void operator()(const char* key, bool& v, double, double) const { v = table.boolean(key, v); }
  void operator()(const char* key, std::vector<int>& v, double lo, double hi) const {
    if (!table.has(key)) return;
    v.clear();
    for (const double n : table.numbers(key)) {
      if (n != std::floor(n) || n < lo || n > hi) table.fail(key, fmt::format("must hold whole numbers from {} to {}", lo, hi));
      v.push_back(static_cast<int>(n));
    }
    if (v.empty()) table.fail(key, "must hold at least one number");
  }
};

struct ToJson {
  nlohmann::json& out;
  template <class T>
  void operator()(const char* key, const T& v, double, double) const {
    out[key] = v;
  }
};

struct FromJson {
  const nlohmann::json& in;
  const std::string& file;
  template <class T>
  void operator()(const char* key, T& v, double lo, double hi) const {
    const auto check_range = [&](double number) {
      if (lo < hi && !(number >= lo && number <= hi))
        input_error("{}: its configuration's \"{}\" is out of range; it is damaged, train anew", file, key);
    };
    try {
      v = in.at(key).get<T>();
      if constexpr (std::is_same_v<T, std::vector<int>>) {
        if (v.empty()) input_error("{}: its configuration's \"{}\" is empty; it is damaged, train anew", file, key);
        for (const int number : v) check_range(number);
      } else {
        check_range(static_cast<double>(v));
      }
    } catch (const nlohmann::json::exception&) {
      input_error("{}: its configuration has no usable \"{}\"; it was written by another version, train anew", file, key);
    }
  }
};

template <class T>
nlohmann::json json_of(const T& value) {
  nlohmann::json out;
  fields(const_cast<T&>(value), ToJson{out});  // only read
  return out;
}

void check_model(const ModelConfig& m, const std::string& place) {
  for (const auto& [name, value] : {std::pair{"local_features", m.local_features}, {"head_width", m.head_width}})
    if (value % 16 != 0) input_error("{}: '{}' must be a multiple of 16, not {}", place, name, value);
  if (m.surface_octaves > 0 && !m.nnopcs) input_error("{}: 'surface_octaves' needs nnopcs = true, or must be 0", place);
}

}  // namespace

NetepuConfig read_config(const std::filesystem::path& file) {
  const toml::table parsed = TomlReader::parse(file);
  TomlReader top(parsed, file.string());
  NetepuConfig c;
  c.seed = static_cast<std::uint64_t>(top.integer("seed", 1, 0, std::numeric_limits<std::int64_t>::max()));
  const auto section = [&](const char* name, auto& value) {
    if (std::optional<TomlReader> table = top.table(name)) {
      fields(value, FromToml{*table});
      table->finish();
    }
  };
  section("model", c.model);
  section("geometry", c.geometry);
  section("texture", c.texture);
  top.finish();
  check_model(c.model, file.string());
  if ((c.texture.encoder.width == 0) != (c.texture.encoder.height == 0))
    input_error("{}: [texture] needs both encoder_width and encoder_height, or neither", file.string());
  return c;
}

nlohmann::json to_json(const ModelConfig& model) {
  return json_of(model);
}

ModelConfig model_from_json(const nlohmann::json& json, const std::string& file) {
  ModelConfig model;
  fields(model, FromJson{json, file});
  check_model(model, file);
  return model;
}

nlohmann::json to_json(const NetepuConfig& config) {
  return {{"seed", config.seed},
          {"model", json_of(config.model)},
          {"geometry", json_of(config.geometry)},
          {"texture", json_of(config.texture)}};
}

NetepuConfig config_from_json(const nlohmann::json& json, const std::string& file) {
  NetepuConfig c;
  for (const char* key : {"seed", "model", "geometry", "texture"})
    if (!json.contains(key)) input_error("{}: its configuration has no \"{}\"; it was cut short or is no checkpoint", file, key);
  FromJson{json, file}("seed", c.seed, 0, 0);
  c.model = model_from_json(json.at("model"), file);
  fields(c.geometry, FromJson{json.at("geometry"), file});
  fields(c.texture, FromJson{json.at("texture"), file});
  return c;
}

}  // namespace moomill
