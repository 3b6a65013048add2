// Coat files (textures/<species>/<name>.toml, documented in textures/cow/README.md) and coats named otherwise: "own"
// for the rig's materials, or an image in the rig's UV space. Also finish files (textures/<species>/finish.toml).
#include "scenes/coat_file.h"

#include "scenes/scene.h"

namespace moomill {
namespace {

namespace fs = std::filesystem;

bool is_image(const fs::path& file) {
  std::string e = file.extension().string();
  for (char& c : e) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return e == ".png" || e == ".jpg" || e == ".jpeg";
}

vec3 color(TomlReader& r, const std::string& key, const vec3& fallback) {
  const dvec3 c = r.vector3(key, dvec3(fallback));
  for (int i = 0; i < 3; ++i)
    if (c[i] < 0 || c[i] > 1) r.fail(key, "must hold three numbers from 0 to 1: linear red, green, blue");
  return vec3(c);
}

vec3 factor(TomlReader& r, const std::string& key, const vec3& fallback) {
  const dvec3 c = r.vector3(key, dvec3(fallback));
  for (int i = 0; i < 3; ++i)
    if (c[i] < 0 || c[i] > 10) r.fail(key, "must hold three numbers from 0 to 10: factors of red, green, blue");
  return vec3(c);
}

std::optional<vec3> optional_color(TomlReader& r, const std::string& key) {
  if (!r.has(key)) return std::nullopt;
  return color(r, key, vec3(0));
}

dvec2 pair(TomlReader& r, const std::string& key, const dvec2& fallback) {
  if (!r.has(key)) return fallback;
  const std::vector<double> v = r.numbers(key);
  if (v.size() != 2 || !std::isfinite(v[0]) || !std::isfinite(v[1])) r.fail(key, "must hold two numbers");
  return {v[0], v[1]};
}

PatchPattern read_patches(TomlReader r) {
  PatchPattern p;
  p.ground = color(r, "ground", p.ground);
  p.patch = color(r, "patch", p.patch);
  p.scale = r.number("scale_m", p.scale, 0.001, 100);
  p.share = r.number("share", p.share, 0, 1);
  p.raggedness = r.number("raggedness_m", p.raggedness, 0, 10);
  p.fringe = r.number("fringe_m", p.fringe, 0, 1);
  p.edge_softness = r.number("softness_m", p.edge_softness, 0, 10);
  p.skin_shadow = r.number("skin_shadow_m", p.skin_shadow, 0, 1);
  p.dorsal = r.number("dorsal", p.dorsal, 0, 10);
  p.low = r.number("low", p.low, 0, 1);
  p.high = r.number("high", p.high, 0, 1);
  r.finish();
  return p;
}

PlainPattern read_plain(TomlReader r) {
  PlainPattern p;
  p.color = color(r, "color", p.color);
  p.variation = r.number("variation", p.variation, 0, 1);
  p.variation_scale = r.number("variation_scale_m", p.variation_scale, 0.001, 100);
  r.finish();
  return p;
}

CellPattern read_cells(TomlReader r) {
  CellPattern c;
  c.line = color(r, "line", c.line);
  c.cell = color(r, "cell", c.cell);
  c.center = color(r, "center", c.cell);
  c.size = r.number("size_m", c.size, 0.005, 100);
  c.gap = r.number("gap_m", c.gap, 0, 10);
  c.regularity = r.number("regularity", c.regularity, 0.2, 0.9);
  c.jag = r.number("jag_m", c.jag, 0, 10);
  c.raggedness = r.number("raggedness_m", c.raggedness, 0, 10);
  c.softness = r.number("softness_m", c.softness, 0, 10);
  c.variation = r.number("variation", c.variation, 0, 1);
  for (TomlReader& p : r.tables("parts")) {
    const std::string part = p.text("part");
    c.parts.emplace_back(part, p.number("size", 1, 0.05, 1));
    p.finish();
  }
  r.finish();
  return c;
}

Freckles read_freckles(TomlReader r) {
  Freckles f;
  f.color = color(r, "color", f.color);
  f.density = r.number("density", 0.05, 0, 0.25);
  f.size = r.number("size_m", f.size, 0.001, 1);
  f.clustering = r.number("clustering", f.clustering, 0, 1);
  r.finish();
  return f;
}

Mark read_mark(TomlReader r) {
  Mark m;
  m.part = r.text("part", "");
  m.at = r.vector3("at");
  const std::string radii = m.part.empty() ? "radii_m" : "radii";
  m.radii = r.vector3(radii);
  for (int i = 0; i < 3; ++i)
    if (!(m.radii[i] > 0)) r.fail(radii, "must hold three numbers greater than 0");
  m.color = color(r, "color", m.color);
  m.raggedness = r.number("raggedness_m", m.raggedness, 0, 1);
  m.fringe = r.number("fringe_m", m.fringe, 0, 1);
  m.softness = r.number("softness_m", m.softness, 0, 1);
  m.mirror = r.boolean("mirror", false);
  r.finish();
  return m;
}

Shade read_shade(TomlReader r) {
  Shade s;
  if (r.has("color") == r.has("factor")) r.fail("color", "must be given, or instead of it a factor on the coat's colour");
  s.multiply = r.has("factor");
  s.color = s.multiply ? factor(r, "factor", s.color) : color(r, "color", s.color);
  s.amount = r.number("amount", s.amount, 0, 1);
  s.part = r.text("part", "");
  s.softness = r.number("softness_m", s.softness, 0, 1);
  if (r.has("heights")) s.heights = pair(r, "heights", {0, 1});
  s.facing = vec3(r.vector3("facing", dvec3(0)));
  s.facing_range = pair(r, "facing_range", s.facing_range);
  s.patchiness = r.number("patchiness", s.patchiness, 0, 1);
  s.scale = r.number("scale_m", s.scale, 0.001, 100);
  r.finish();
  return s;
}

PartColor read_part(TomlReader r) {
  PartColor p;
  p.part = r.text("part");
  p.color = color(r, "color", p.color);
  p.softness = r.number("softness_m", p.softness, 0, 1);
  p.raggedness = r.number("raggedness_m", p.raggedness, 0, 1);
  p.halo = optional_color(r, "halo");
  p.halo_width = r.number("halo_width_m", p.halo_width, 0.001, 0.25);
  p.mottle = optional_color(r, "mottle");
  p.mottle_share = r.number("mottle_share", p.mottle_share, 0, 1);
  p.mottle_scale = r.number("mottle_scale_m", p.mottle_scale, 0.001, 1);
  p.tip = optional_color(r, "tip");
  p.tip_from = r.number("tip_from", p.tip_from, -1, 2);
  p.tip_to = r.number("tip_to", p.tip_to, -1, 2);
  p.rings = r.number("rings", p.rings, 0, 1);
  p.ring_spacing = r.number("ring_spacing_m", p.ring_spacing, 0.0005, 1);
  r.finish();
  return p;
}

}  // namespace

ProceduralCoat read_procedural_coat(TomlReader& r) {
  ProceduralCoat coat;
  coat.seed = static_cast<std::uint64_t>(r.integer("seed", 1, 0, std::numeric_limits<std::int64_t>::max()));
  coat.fur = r.number("fur", coat.fur, 0, 1);
  auto patches = r.table("patches"), plain = r.table("plain"), cells = r.table("cells");
  if (patches && plain) r.fail("plain", "cannot stand beside [patches]; leave one of them out");
  if (cells && (patches || plain)) r.fail("cells", "cannot stand beside [patches] or [plain]; leave one of them out");
  if (!patches && !plain && !cells)
    r.fail("patches", "is missing; give the coat [patches], [plain], [cells] or image = \"file.png\"");
  if (patches)
    coat.base = read_patches(*patches);
  else if (cells)
    coat.base = read_cells(*cells);
  else
    coat.base = read_plain(*plain);
  if (auto f = r.table("freckles")) coat.freckles = read_freckles(*f);
  for (TomlReader& m : r.tables("marks")) coat.marks.push_back(read_mark(m));
  for (TomlReader& s : r.tables("shades")) coat.shades.push_back(read_shade(s));
  for (TomlReader& p : r.tables("parts")) coat.parts.push_back(read_part(p));
  return coat;
}

Finish read_finish(const std::string& species) {
  Finish finish;
  const fs::path file = find_finish(species);
  if (file.empty()) return finish;
  const toml::table table = TomlReader::parse(file);
  TomlReader r(table, file.string());
  r.text("about", "");  // for people
  finish.roughness = r.number("roughness", finish.roughness, 0, 1);
  finish.tuft_slope = r.number("tuft_slope", finish.tuft_slope, 0, 2);
  finish.clump_slope = r.number("clump_slope", finish.clump_slope, 0, 2);
  finish.clump_size = r.number("clump_size_m", finish.clump_size, 0.001, 10);
  if (auto h = r.table("hair")) {
    const auto direction = [](TomlReader& t, const vec3& fallback) {
      const vec3 d(t.vector3("direction", dvec3(fallback)));
      if (!(glm::length(d) > 0)) t.fail("direction", "must have a length; it is where the tips of the hair point");
      return glm::normalize(d);
    };
    Hair& hair = finish.hair;
    hair.direction = direction(*h, hair.direction);
    hair.smoothing = h->number("smoothing_m", hair.smoothing, 0, 1);
    hair.tuft_width = h->number("tuft_width_m", hair.tuft_width, 0.0005, 1);
    hair.tuft_length = h->number("tuft_length_m", hair.tuft_length, 0.0005, 1);
    for (TomlReader& p : h->tables("parts")) {
      const std::string part = p.text("part");
      hair.parts.emplace_back(part, direction(p, hair.direction));
      p.finish();
    }
    h->finish();
  }
  for (TomlReader& p : r.tables("parts")) {
    PartFinish part;
    part.part = p.text("part");
    part.roughness = p.number("roughness", part.roughness, 0, 1);
    part.bump = p.number("bump", part.bump, 0, 10);
    part.softness = p.number("softness_m", part.softness, 0, 1);
    p.finish();
    finish.parts.push_back(std::move(part));
  }
  r.finish();
  return finish;
}

Coat read_coat(const std::string& name_or_path, const std::string& species, const fs::path& relative_to) {
  Coat coat;
  coat.name = fs::path(name_or_path).stem().string();
  const fs::path file = find_coat(name_or_path, species, relative_to);
  if (file.empty()) {
    coat.source = OwnMaterials{};
    return coat;
  }
  if (is_image(file)) {
    coat.source = ImageCoat{file.string()};
    return coat;
  }
  if (file.extension() != ".toml") input_error("{} is no coat; name a .toml file, a .png or a .jpg", file.string());
  const toml::table table = TomlReader::parse(file);
  TomlReader r(table, file.string());
  coat.about = r.text("about", "");
  coat.looks_like = r.text("looks_like", "");
  if (r.has("image")) {
    const std::string image = r.text("image");
    coat.source = ImageCoat{find_file(image, file.parent_path()).string()};
  } else {
    coat.source = read_procedural_coat(r);
  }
  r.finish();
  return coat;
}

}  // namespace moomill
