// Reading validate/silhouettes/*.toml (documented in the README.md beside them).
#include "scenes/scene.h"
#include "generator/core/toml.h"
#include "validate/studies/silhouette.h"

namespace moomill {
namespace {

namespace fs = std::filesystem;

fs::path find_mesh(const std::string& name, const fs::path& folder) {
  const fs::path p(name);
  std::error_code ignored;
  std::vector<fs::path> candidates;
  if (p.is_absolute())
    candidates = {p};
  else
    candidates = {folder / p, data_root() / p, data_root() / "../shared/assets" / p};
  for (const fs::path& c : candidates)
    if (fs::is_regular_file(c, ignored)) return c.lexically_normal();
  std::string tried;
  for (const fs::path& c : candidates) tried += (tried.empty() ? "" : ", ") + c.lexically_normal().string();
  input_error("there is no mesh {} (looked for {}); the meshes are not part of this project, put yours there or name it by its whole path",
              name, tried);
}

}  // namespace

SilhouetteReference read_silhouette_reference(const fs::path& file) {
  const toml::table table = TomlReader::parse(file);
  TomlReader root(table, file.string());
  SilhouetteReference r;
  r.name = root.text("name");
  r.yaw_deg = root.number("yaw_deg", 0, -360, 360);
  r.height = root.number("height_m", 1e-3, 1e4);
  if (std::optional<TomlReader> bars = root.table("at_least")) {
    for (int v = 0; v < 3; ++v)
      if (bars->has(silhouette_views[v])) r.at_least[v] = bars->number(silhouette_views[v], 0, 1);
    bars->finish();
  }
  for (TomlReader& t : root.tables("leave_out")) {
    LeftOut l;
    l.what = t.text("what");
    l.box.lower = t.vector3("lower");
    l.box.upper = t.vector3("upper");
    for (int k = 0; k < 3; ++k)
      if (!(l.box.lower[k] < l.box.upper[k]))
        t.fail("lower", fmt::format("of '{}' is not below upper along {}: {} and {}", l.what, "xyz"[k], l.box.lower[k], l.box.upper[k]));
    t.finish();
    r.left_out.push_back(l);
  }
  if (root.has("leave_out_parts")) r.left_out_parts = root.texts("leave_out_parts");
  for (TomlReader& t : root.tables("turns")) {
    FittedTurn f;
    f.joint = t.text("joint");
    const std::string axis = t.word("axis", "y", {"x", "y", "z"});
    f.axis = axis[0] - 'x';
    f.lower_deg = t.number("lower_deg", -180, 0);
    f.upper_deg = t.number("upper_deg", 0, 180);
    f.mirror = t.boolean("mirror", false);
    t.finish();
    for (const FittedTurn& other : r.turns)
      if (other.joint == f.joint && other.axis == f.axis) t.fail("joint", fmt::format("'{}' turns about {} already; keep one of the two", f.joint, axis));
    r.turns.push_back(f);
  }
  const std::string mesh = root.text("file");
  r.file = root.at_key("file", [&] { return find_mesh(mesh, file.parent_path()); });
  root.finish();
  return r;
}

}  // namespace moomill
