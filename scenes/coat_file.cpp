// Coat files (textures/<species>/<name>.toml, documented in textures/cow/README.md) and coats named otherwise: "own"
// for the rig's materials, or an image in the rig's UV space.
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

PatchPattern read_patches(TomlReader r) {
  PatchPattern p;
  p.ground = color(r, "ground", p.ground);
  p.patch = color(r, "patch", p.patch);
  p.scale = r.number("scale_m", p.scale, 0.001, 100);
  p.share = r.number("share", p.share, 0, 1);
  p.raggedness = r.number("raggedness_m", p.raggedness, 0, 10);
  p.edge_softness = r.number("softness_m", p.edge_softness, 0, 10);
  p.low = r.number("low_m", p.low, 0, 100);
  p.high = r.number("high_m", p.high, 0, 100);
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

}  // namespace

ProceduralCoat read_procedural_coat(TomlReader& r) {
  ProceduralCoat coat;
  coat.seed = static_cast<std::uint64_t>(r.integer("seed", 1, 0, std::numeric_limits<std::int64_t>::max()));
  coat.fur = r.number("fur", coat.fur, 0, 1);
  auto patches = r.table("patches"), plain = r.table("plain");
  if (patches && plain) r.fail("plain", "cannot stand beside [patches]; leave one of them out");
  if (!patches && !plain) r.fail("patches", "is missing; give the coat [patches], [plain] or image = \"file.png\"");
  if (patches)
    coat.base = read_patches(*patches);
  else
    coat.base = read_plain(*plain);
  if (auto f = r.table("freckles")) {
    coat.freckles.color = color(*f, "color", coat.freckles.color);
    coat.freckles.density = f->number("density", 0.05, 0, 0.25);
    coat.freckles.size = f->number("size_m", coat.freckles.size, 0.001, 1);
    f->finish();
  }
  for (TomlReader& m : r.tables("marks")) {
    Mark mark;
    mark.at = m.vector3("at");
    mark.radii = m.vector3("radii_m");
    for (int i = 0; i < 3; ++i)
      if (!(mark.radii[i] > 0)) m.fail("radii_m", "must hold three numbers greater than 0");
    mark.color = color(m, "color", mark.color);
    mark.raggedness = m.number("raggedness_m", mark.raggedness, 0, 1);
    mark.softness = m.number("softness_m", mark.softness, 0, 1);
    mark.mirror = m.boolean("mirror", false);
    m.finish();
    coat.marks.push_back(mark);
  }
  for (TomlReader& p : r.tables("parts")) {
    PartColor part;
    part.part = p.text("part");
    part.color = color(p, "color", part.color);
    part.softness = p.number("softness_m", part.softness, 0, 1);
    p.finish();
    coat.parts.push_back(std::move(part));
  }
  return coat;
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
  r.text("about", "");  // for people
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
