// Reading a scene file. Every key is documented in scenes/README.md; to add one: read it here, write it in
// scene_json.cpp (it decides the frames, so the manifest must say it), and document it there.
#include <fstream>
#include <numeric>
#include <set>
#include <sstream>

#include "scenes/breed_file.h"
#include "scenes/read_distribution.h"
#include "scenes/scene.h"
#include "generator/core/toml.h"

namespace moomill {
namespace {

namespace fs = std::filesystem;
using Kind = Quantity::Kind;

constexpr int most_frames = 10'000'000;
constexpr int default_pose_count = 10;
constexpr int most_individuals = 1'000'000;

constexpr Quantity length{Kind::vector, -1e5, 1e5};
constexpr Quantity positive_length{Kind::number, 1e-3, 1e5};
constexpr Quantity color{Kind::color, 0, 1e6};
constexpr Quantity albedo{Kind::color, 0, 1};
constexpr Quantity strength{Kind::number, 0, 1e9};
constexpr Quantity angle{Kind::number, -36000, 36000};
constexpr Quantity file_name{Kind::text, 0, 0};

class SceneReader {
 public:
  SceneReader(const toml::table& table, const fs::path& file)
      : root_(table, file.string()), folder_(file.parent_path()) {
    scene_.file = file.string();
  }

  SceneSpec read() {
    scene_.seed = static_cast<std::uint64_t>(root_.integer("seed", 0, 0, std::numeric_limits<std::int64_t>::max()));
    const std::string subset = root_.word("subset", "main", {"main", "novel_views", "occlusions"});
    scene_.subset = subset == "main"          ? Subset::main
                    : subset == "novel_views" ? Subset::novel_views
                                              : Subset::occlusions;
    read_modalities();
    read_animals();
    read_frames();
    read_only_coats();
    read_cameras();
    read_light();
    read_background();
    read_ground();
    read_render();
    if (auto t = root_.table("nnopcs")) {
      const bool box = t->word("normalization", "box", {"box", "diagonal"}) == "box";
      scene_.normalization = box ? NnopcsNormalization::box : NnopcsNormalization::diagonal;
      t->finish();
    }
    root_.finish();
    check_surface_light(scene_);
    scene_.resolved = scene_to_json(scene_);
    return std::move(scene_);
  }

 private:
  void require_files(TomlReader& t, const std::string& key, const std::optional<Distribution>& d) {
    if (!d) return;
    for (const std::string& word : d->words) t.at_key(key, [&] { return find_file(word, folder_); });
  }

  void read_modalities() {
    std::vector<std::string> names{"rgb", "silhouette", "depth", "nnopcs", "keypoints"};
    if (root_.has("modalities")) names = root_.texts("modalities");
    if (names.empty()) root_.fail("modalities", "must name at least one, e.g. [\"rgb\", \"depth\"]");
    scene_.modalities = root_.at_key("modalities", [&] { return modalities_from_names(names); });
  }

  void read_animals() {
    std::vector<TomlReader> tables = root_.tables("animals");
    if (tables.empty()) root_.missing("animals", "[[animals]] with species = \"cow\"");
    for (std::size_t i = 0; i < tables.size(); ++i) read_animal(tables[i], i);
  }

  void read_animal(TomlReader& t, std::size_t index) {
    AnimalSpec a;
    a.key = t.where();
    a.species = t.text("species");
    const fs::path file = t.at_key("species", [&] { return find_species(a.species, folder_); });
    is_species_file_.push_back(file.extension() == ".toml");
    const std::string name = file.stem().string();
    if (t.has("coats")) {
      read_coats(t, a, name);
    } else {
      a.coats = shipped_coats(name);
      // Beside the first animal's coats one is enough.
      if (a.coats.empty()) a.coats = {"own"};
      if (index > 0) a.coats.resize(1);
    }
    for (std::size_t i = 0; i < a.coats.size(); ++i)
      if (!a.individual(i)) t.at_key("coats", [&] { return find_coat(a.coats[i], name, folder_); });
    if (index > 0 && a.coats.size() != 1 && a.coats.size() != scene_.animals[0].coats.size())
      t.fail("coats", fmt::format("must name one coat, or as many as the first animal has ({}), not {}",
                                  scene_.animals[0].coats.size(), a.coats.size()));
    for (TomlReader& p : t.tables("poses")) a.poses.push_back(read_pose_source(p));
    Quantity on_ground = length, turn = angle;
    on_ground.may_vary_per_view = turn.may_vary_per_view = false;
    a.position = read_distribution(t, "position", on_ground, constant_vector(dvec3(0)));
    a.yaw_deg = read_distribution(t, "yaw_deg", turn, constant_number(0));
    a.pose_in_place = t.boolean("pose_in_place", true);
    t.finish();
    scene_.animals.push_back(std::move(a));
  }

  // Names, {breed, count, seed, first} tables, or a list of both.
  void read_coats(TomlReader& t, AnimalSpec& a, const std::string& species) {
    const toml::node& node = *t.node("coats");
    const auto take = [&](const toml::node& entry) {
      if (const toml::table* herd = entry.as_table()) {
        read_herd(TomlReader(*herd, t.file(), t.path_of("coats")), a, species);
        return;
      }
      if (!entry.is_string() || entry.as_string()->get().empty())
        t.fail("coats", fmt::format("must hold names and tables such as {{breed = \"holstein\", count = 100}}, not {}",
                                    describe_node(entry)));
      a.coats.push_back(entry.as_string()->get());
    };
    if (const toml::array* list = node.as_array())
      for (const toml::node& entry : *list) take(entry);
    else if (node.is_table())
      take(node);
    else
      t.fail("coats", fmt::format("must be a list of names, or a table such as {{breed = \"holstein\", count = 100}}, not {}",
                                  describe_node(node)));
    if (a.coats.empty()) t.fail("coats", "must name at least one, e.g. [\"own\"]");
    if (!a.individuals.empty()) a.individuals.resize(a.coats.size());
  }

  void read_herd(TomlReader t, AnimalSpec& a, const std::string& species) {
    Individual one;
    one.breed = t.text("breed");
    if (!t.has("count")) t.missing("count", "count = 100");
    const auto count = t.integer("count", 1, 1, most_individuals);
    one.seed = static_cast<std::uint64_t>(t.integer("seed", 0, 0, std::numeric_limits<std::int64_t>::max()));
    const auto first = t.integer("first", 0, 0, most_individuals);
    t.finish();
    const Breed breed = t.at_key("breed", [&] { return read_breed(one.breed, species, folder_); });
    if (a.coats.size() + static_cast<std::size_t>(count) > most_individuals)
      t.fail("count", fmt::format("makes more than {} coats in one scene; split it", most_individuals));
    a.individuals.resize(a.coats.size());
    // Herds of another seed are other animals: their names say so, as long as one herd of the breed came before.
    const bool another = std::any_of(a.individuals.begin(), a.individuals.end(), [&](const auto& other) {
      return other && other->breed == one.breed && other->seed != one.seed;
    });
    const std::string herd = another ? fmt::format("{}_seed{}", breed.name, one.seed) : breed.name;
    std::set<std::string> known(a.coats.begin(), a.coats.end());
    for (std::int64_t i = 0; i < count; ++i) {
      one.index = static_cast<int>(first + i);
      const std::string name = individual_name(herd, one.index);
      if (!known.insert(name).second)
        t.fail("breed", fmt::format("gives {} a second time; begin another herd with first = {} or another seed", name,
                                    first + count));
      a.coats.push_back(name);
      a.individuals.push_back(one);
    }
  }

  PoseSource read_pose_source(TomlReader& t) {
    PoseSource source;
    const int kinds = int(t.has("clip")) + int(t.has("file")) + int(t.has("random"));
    if (kinds != 1)
      t.refuse("",
               fmt::format("[{}] must have exactly one of clip, file and random, e.g. {{clip = \"walk\", count = 100}}",
                           t.where()));
    if (t.has("clip")) {
      ClipFrames clip;
      clip.clip = t.text("clip");
      if (!t.has("count")) t.missing("count", "count = 100");
      clip.count = static_cast<int>(t.integer("count", 1, 1, most_frames));
      clip.treadmill = t.boolean("treadmill", clip.treadmill);
      source = clip;
    } else if (t.has("file")) {
      source = read_pose_file(t);
    } else {
      PoseSampler sampler;
      sampler.count = static_cast<int>(t.integer("random", 1, 1, most_frames));
      sampler.spread = t.number("spread", 1, 0, 1);
      sampler.on_ground = t.boolean("on_ground", sampler.on_ground);
      source = sampler;
    }
    t.finish();
    return source;
  }

  PoseFile read_pose_file(TomlReader& t) {
    PoseFile out;
    out.file = t.text("file");
    const fs::path path = t.at_key("file", [&] { return find_file(out.file, folder_); });
    std::ifstream in(path, std::ios::binary);
    std::stringstream text;
    text << in.rdbuf();
    Json json;
    try {
      json = Json::parse(text.str());
    } catch (const Json::parse_error& e) {
      t.refuse("file", fmt::format("{} is not valid JSON at byte {}; mend it there", out.file, e.byte));
    }
    if (!json.is_object() || !json.contains("poses") || !json["poses"].is_array() || json["poses"].empty())
      t.refuse("file", fmt::format("{} has no poses; it must be {{\"poses\": [{{...}}, ...]}}", out.file));
    for (std::size_t i = 0; i < json["poses"].size(); ++i) {
      const std::string wrong = wrong_with_pose(json["poses"][i]);
      if (!wrong.empty()) t.refuse("file", fmt::format("{}: pose {} {}", out.file, i, wrong));
    }
    out.poses = std::make_shared<const Json>(std::move(json["poses"]));
    return out;
  }

  static std::string wrong_with_pose(const Json& pose) {
    if (!pose.is_object()) return "must be an object of nodes";
    for (const auto& [node, parts] : pose.items()) {
      if (!parts.is_object()) return fmt::format("must give node '{}' as an object", node);
      for (const auto& [name, list] : parts.items()) {
        const std::size_t size = name == "rotation" ? 4 : name == "translation" || name == "scale" ? 3 : 0;
        if (size == 0) return fmt::format("has '{}' for node '{}'; known are rotation, translation, scale", name, node);
        bool numbers = list.is_array() && list.size() == size;
        double squares = 0;
        for (std::size_t i = 0; numbers && i < size; ++i) {
          numbers = list[i].is_number() && std::isfinite(list[i].get<double>());
          if (numbers) squares += list[i].get<double>() * list[i].get<double>();
        }
        if (!numbers) return fmt::format("must give the {} of node '{}' as {} finite numbers", name, node, size);
        if (size == 4 && std::abs(squares - 1) > 1e-2)
          return fmt::format("has a rotation of node '{}' that is no unit quaternion [x, y, z, w]", node);
      }
    }
    return "";
  }

  static int count_of(const AnimalSpec& a) {
    int n = 0;
    for (const PoseSource& p : a.poses) {
      if (const auto* clip = std::get_if<ClipFrames>(&p)) n += clip->count;
      if (const auto* file = std::get_if<PoseFile>(&p)) n += static_cast<int>(file->poses->size());
      if (const auto* sampler = std::get_if<PoseSampler>(&p)) n += sampler->count;
    }
    return n;
  }

  void read_frames() {
    AnimalSpec& first_animal = scene_.animals[0];
    const int poses = count_of(first_animal);
    std::vector<int>& frames = scene_.frames;
    std::string culprit = "frames";
    std::optional<TomlReader> t = root_.table("frames");
    if (t && t->has("list")) {
      culprit = "list";
      for (const char* other : {"first", "count", "every"})
        if (t->has(other)) t->fail(other, "cannot stand beside 'list'; leave one of them out");
      scene_.first_frame = static_cast<int>(t->integer("number_from", 1, 0, most_frames));
      std::set<int> sorted;
      for (const double f : t->numbers("list")) {
        if (f != std::floor(f) || f < scene_.first_frame || f > most_frames)
          t->fail("list", fmt::format("must hold whole numbers of at least {}, not {}", scene_.first_frame, f));
        if (!sorted.insert(static_cast<int>(f)).second) t->fail("list", fmt::format("holds {} twice", f));
      }
      if (sorted.empty()) t->fail("list", "must hold at least one frame");
      frames.assign(sorted.begin(), sorted.end());
    } else {
      int first = 1, every = 1;
      std::optional<int> count;
      if (t) {
        scene_.first_frame = static_cast<int>(t->integer("number_from", 1, 0, most_frames));
        first = static_cast<int>(t->integer("first", scene_.first_frame, scene_.first_frame, most_frames));
        every = static_cast<int>(t->integer("every", 1, 1, most_frames));
        if (t->has("count")) count = static_cast<int>(t->integer("count", 1, 1, most_frames));
        culprit = t->has("count") ? "count" : "first";
      }
      const int skipped = first - scene_.first_frame;
      if (!count) count = std::max(1, ((poses ? poses : default_pose_count) - skipped + every - 1) / every);
      if (static_cast<std::int64_t>(first) + static_cast<std::int64_t>(every) * (*count - 1) > most_frames)
        t->fail(culprit, fmt::format("makes frame numbers above {}", most_frames));
      for (int i = 0; i < *count; ++i) frames.push_back(first + every * i);
    }
    if (t) t->finish();
    const int needed = frames.back() - scene_.first_frame + 1;
    for (std::size_t i = 0; i < scene_.animals.size(); ++i) {
      AnimalSpec& a = scene_.animals[i];
      // A species brings joint limits to draw poses from; a bare rig file has its first clip, if any.
      if (a.poses.empty())
        a.poses.push_back(is_species_file_[i] ? PoseSource(PoseSampler{needed, 1})
                                              : PoseSource(ClipFrames{"", needed}));
      const int there = count_of(a);
      if (there == 1 || there >= needed) continue;
      const std::string sentence =
          fmt::format("frame {} needs {} poses, but [{}] has {}; ask for fewer frames or add poses", frames.back(),
                      needed, a.key, there);
      if (t) t->refuse(culprit, sentence);
      root_.refuse("animals", sentence);
    }
  }

  void read_only_coats() {
    const int count = static_cast<int>(scene_.animals[0].coats.size());
    if (!root_.has("only_coats")) {
      scene_.coat_indices.resize(count);
      std::iota(scene_.coat_indices.begin(), scene_.coat_indices.end(), 0);
      return;
    }
    std::set<int> chosen;
    for (const double c : root_.numbers("only_coats")) {
      if (c != std::floor(c) || c < 0 || c >= count)
        root_.fail("only_coats",
                   fmt::format("must hold indices from 0 to {}, of the first animal's coats, not {}", count - 1, c));
      chosen.insert(static_cast<int>(c));
    }
    if (chosen.empty()) root_.fail("only_coats", "must hold at least one index");
    scene_.coat_indices.assign(chosen.begin(), chosen.end());
  }

  void read_cameras() {
    CameraSpec& c = scene_.cameras;
    const CameraFraming framing = default_framing(scene_.animals[0].species, folder_);
    c.target = constant_vector(framing.target);
    c.focal_mm = constant_number(framing.focal_mm);
    RingCameras rings;
    rings.radius = constant_number(framing.radius);
    rings.heights = framing.heights;
    std::optional<TomlReader> t = root_.table("cameras");
    if (!t) {
      c.rings = rings;
      return;
    }
    c.target = read_distribution(*t, "target", length, c.target);
    c.focal_mm = read_distribution(*t, "focal_mm", {Kind::number, 0.1, 1e5}, c.focal_mm);
    c.sensor_mm = t->number("sensor_mm", 36, 0.1, 1e4);
    read_resolution(*t);
    std::vector<TomlReader> list = t->tables("list");
    for (TomlReader& l : list) read_listed_camera(l);
    std::optional<TomlReader> r = t->table("rings");
    if (r && !list.empty()) t->fail("rings", "cannot stand beside [[cameras.list]]; leave one of them out");
    if (r) read_rings(*r, rings);
    if (list.empty()) c.rings = rings;
    if (t->has("only")) {
      const std::vector<int> ids = all_camera_ids(c);
      std::set<int> chosen;
      for (const double id : t->numbers("only")) {
        if (std::none_of(ids.begin(), ids.end(), [&](int i) { return i == id; }))
          t->fail("only", fmt::format("names camera {}, which the scene does not have; ids run from {} to {}", id,
                                      ids.front(), ids.back()));
        chosen.insert(static_cast<int>(id));
      }
      if (chosen.empty()) t->fail("only", "must hold at least one camera id");
      c.only.assign(chosen.begin(), chosen.end());
    }
    t->finish();
  }

  void read_resolution(TomlReader& t) {
    if (!t.has("resolution")) return;
    const std::vector<double> size = t.numbers("resolution");
    const auto possible = [](double v) { return v == std::floor(v) && v >= 1 && v <= largest_resolution; };
    if (size.size() != 2 || !possible(size[0]) || !possible(size[1])) {
      std::string got;
      for (const double v : size) got += fmt::format("{}{}", got.empty() ? "" : ", ", v);
      t.fail("resolution",
             fmt::format("must be [width, height], whole numbers from 1 to {}, e.g. [1024, 768], not [{}]",
                         largest_resolution, got));
    }
    scene_.cameras.width = static_cast<int>(size[0]);
    scene_.cameras.height = static_cast<int>(size[1]);
  }

  void read_rings(TomlReader& r, RingCameras& rings) {
    rings.count = static_cast<int>(r.integer("count", rings.count, 1, 3600));
    rings.radius = read_distribution(r, "radius", positive_length, rings.radius);
    if (r.has("heights")) {
      rings.heights = r.numbers("heights");
      if (rings.heights.empty()) r.fail("heights", "must hold one height per ring, e.g. [1, 4, 9]");
      if (rings.heights.size() > 1000) r.fail("heights", "must hold at most 1000 heights");
    }
    rings.first_azimuth_deg = r.number("first_azimuth_deg", 0, -360, 360);
    r.finish();
  }

  void read_listed_camera(TomlReader& t) {
    CameraSpec& c = scene_.cameras;
    ListedCamera l;
    l.id = static_cast<int>(t.integer("id", static_cast<int>(c.list.size()), 0, 99999));
    for (const ListedCamera& other : c.list)
      if (other.id == l.id) t.fail("id", fmt::format("is {} for two cameras; every id must be different", l.id));
    if (!t.has("position")) t.missing("position", "position = [10.5, 0, 2]");
    l.position = read_distribution(t, "position", length, {});
    l.target = read_optional_distribution(t, "target", length);
    t.finish();
    c.list.push_back(std::move(l));
  }

  void read_light() {
    LightSpec& light = scene_.light;
    light.environment_color = constant_number(0.5);
    light.environment_strength = constant_number(1);
    light.environment_yaw_deg = constant_number(0);
    std::optional<TomlReader> t = root_.table("light");
    if (!t) {
      light.suns.push_back(default_sun());
      return;
    }
    light.environment_color = read_distribution(*t, "environment_color", color, light.environment_color);
    light.environment_file = read_optional_distribution(*t, "environment_file", file_name);
    require_files(*t, "environment_file", light.environment_file);
    if (light.environment_file && t->has("environment_color"))
      t->fail("environment_color", "means nothing beside environment_file; leave one of them out");
    light.environment_strength = read_distribution(*t, "environment_strength", strength, light.environment_strength);
    light.environment_yaw_deg = read_distribution(*t, "environment_yaw_deg", angle, light.environment_yaw_deg);
    for (TomlReader& s : t->tables("suns")) light.suns.push_back(read_sun(s));
    for (TomlReader& r : t->tables("rectangles")) light.rectangles.push_back(read_rectangle(r));
    // A file that names no light of its own still has the sun; `suns = []` is how to do without.
    if (!t->has("suns") && light.rectangles.empty() && !light.environment_file) light.suns.push_back(default_sun());
    t->finish();
  }

  static LightSpec::Sun default_sun() {
    return {constant_number(-60), constant_number(50), constant_number(1.6), constant_vector({1, 0.97, 0.92}),
            constant_number(0.53)};
  }

  LightSpec::Sun read_sun(TomlReader& t) {
    LightSpec::Sun s = default_sun();
    s.azimuth_deg = read_distribution(t, "azimuth_deg", angle, s.azimuth_deg);
    s.elevation_deg = read_distribution(t, "elevation_deg", {Kind::number, -90, 90}, s.elevation_deg);
    s.irradiance = read_distribution(t, "irradiance", strength, s.irradiance);
    s.color = read_distribution(t, "color", color, s.color);
    s.angular_diameter_deg =
        read_distribution(t, "angular_diameter_deg", {Kind::number, 0, 90}, s.angular_diameter_deg);
    t.finish();
    return s;
  }

  LightSpec::Rectangle read_rectangle(TomlReader& t) {
    LightSpec::Rectangle r;
    if (!t.has("position")) t.missing("position", "position = [3, 3, 4]");
    r.position = read_distribution(t, "position", length, {});
    r.target = read_distribution(t, "target", length, constant_vector({0, 0, 0.8}));
    r.radiance = read_distribution(t, "radiance", strength, constant_number(10));
    r.color = read_distribution(t, "color", color, constant_number(1));
    r.width = t.number("width", 1, 1e-6, 1e5);
    r.height = t.number("height", 1, 1e-6, 1e5);
    t.finish();
    return r;
  }

  void read_background() {
    BackgroundSpec& b = scene_.background;
    b.color = constant_number(0);
    std::optional<TomlReader> t = root_.table("background");
    if (!t) return;
    const bool with_color = t->has("color"), with_image = t->has("image");
    b.color = read_distribution(*t, "color", color, b.color);
    b.image = read_optional_distribution(*t, "image", file_name);
    require_files(*t, "image", b.image);
    const std::string kind = t->word("kind",
                                     with_image   ? "image"
                                     : with_color ? "color"
                                                  : "transparent",
                                     {"transparent", "color", "environment", "image"});
    using K = BackgroundSpec::Kind;
    b.kind = kind == "color"         ? K::color
             : kind == "environment" ? K::environment
             : kind == "image"       ? K::image
                                     : K::transparent;
    if (b.kind == K::image && !with_image) t->missing("image", "image = {choose = [\"a.jpg\", \"b.jpg\"]}");
    if (b.kind != K::image && with_image) t->fail("image", "has no effect unless kind = \"image\"; leave one out");
    t->finish();
  }

  void read_ground() {
    GroundSpec& g = scene_.ground;
    g.color = constant_vector({0.18, 0.2, 0.12});
    g.roughness = constant_number(1);
    std::optional<TomlReader> t = root_.table("ground");
    if (!t) return;
    g.present = t->boolean("present", true);
    g.color = read_distribution(*t, "color", albedo, g.color);
    g.roughness = read_distribution(*t, "roughness", {Kind::number, 0, 1}, g.roughness);
    g.size = t->number("size", 50, 1e-3, 1e5);
    t->finish();
  }

  void read_render() {
    std::optional<TomlReader> t = root_.table("render");
    if (!t) return;
    RenderSpec& r = scene_.render;
    r.samples = static_cast<int>(t->integer("samples", r.samples, 1, largest_samples));
    r.max_bounces = static_cast<int>(t->integer("max_bounces", r.max_bounces, 0, 1000));
    r.filter_radius = t->number("filter_radius", r.filter_radius, 0.5, 8);
    r.target_error = t->number("target_error", r.target_error, 0, 1);
    if (r.target_error > 0 && r.target_error < least_target_error)
      input_error("{}: render.target_error is {}; 0 for none, or from {} to 1", scene_.file, r.target_error, least_target_error);
    r.surface_light = t->boolean("surface_light", r.surface_light);
    r.memory_mb = t->number("memory_mb", r.memory_mb, 64, 1e7);
    r.coat_resolution = static_cast<int>(t->integer("coat_resolution", r.coat_resolution, 16, 16384));
    t->finish();
  }

  SceneSpec scene_;
  TomlReader root_;
  fs::path folder_;
  std::vector<bool> is_species_file_;  // per animal
};

}  // namespace

SceneSpec read_scene(const fs::path& file) {
  const toml::table table = TomlReader::parse(file);
  return SceneReader(table, file).read();
}

bool is_scene_file(const fs::path& file) {
  return TomlReader::parse(file).contains("animals");
}

}  // namespace moomill
