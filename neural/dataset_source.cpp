#include "neural/dataset_source.h"

#include <algorithm>
#include <charconv>
#include <map>
#include <set>

#include "generator/dataset/json.h"
#include "generator/core/error.h"
#include "generator/dataset/codecs.h"
#include "generator/dataset/reader.h"

namespace moomill {
namespace {

namespace fs = std::filesystem;

constexpr int ring_cameras = 8;
constexpr double ring_tolerance = 1e-4;  // metres, and sines of angles

std::string_view trim(std::string_view text) {
  const auto blank = [](char c) { return c == ' ' || c == '\t' || c == '\r'; };
  while (!text.empty() && blank(text.front())) text.remove_prefix(1);
  while (!text.empty() && blank(text.back())) text.remove_suffix(1);
  return text;
}

bool parse_number(std::string_view text, double& value) {
  text = trim(text);
  if (text.starts_with('+')) text.remove_prefix(1);
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  return error == std::errc() && end == text.data() + text.size() && !text.empty();
}

std::vector<std::string_view> lines_of(const std::string& text) {
  std::vector<std::string_view> out;
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t end = std::min(text.find('\n', at), text.size());
    out.push_back(std::string_view(text).substr(at, end - at));
    at = end + 1;
  }
  return out;
}

std::string read_text(const fs::path& file) {
  const std::vector<std::uint8_t> bytes = read_file(file);
  return {bytes.begin(), bytes.end()};
}

// keypoints.csv: a header, then rows of a first column and K x 3 coordinates.
struct KeypointTable {
  std::vector<double> labels;  // the first column
  std::vector<std::vector<dvec3>> rows;
  std::vector<int> lines;  // where each row stands, for messages
};

KeypointTable read_keypoints(const fs::path& file, int expected) {
  const std::string text = read_text(file);
  KeypointTable table;
  std::size_t columns = expected > 0 ? 1 + 3 * static_cast<std::size_t>(expected) : 0;
  int line = 0;
  for (const std::string_view row : lines_of(text)) {
    if (++line == 1 || trim(row).empty()) continue;
    std::vector<double> values;
    for (std::size_t at = 0; at <= row.size();) {
      const std::size_t end = std::min(row.find(',', at), row.size());
      double value = 0;
      if (!parse_number(row.substr(at, end - at), value) || !std::isfinite(value))
        input_error("{}:{}: value {} (\"{}\") is not a finite number; make the file anew", file.string(), line,
                    values.size() + 1, std::string(trim(row.substr(at, end - at))));
      values.push_back(value);
      at = end + 1;
    }
    if (columns == 0) columns = values.size();
    if (values.size() != columns || columns < 4 || (columns - 1) % 3 != 0)
      input_error("{}:{}: has {} columns where a frame column and {} belong; make the file anew", file.string(), line,
                  values.size(),
                  expected > 0 ? fmt::format("3 x {} coordinates", expected) : "three coordinates of every keypoint");
    table.labels.push_back(values[0]);
    table.lines.push_back(line);
    std::vector<dvec3>& points = table.rows.emplace_back();
    for (std::size_t i = 1; i < columns; i += 3) points.push_back({values[i], values[i + 1], values[i + 2]});
  }
  if (table.rows.empty()) input_error("{}: has no rows of keypoints; make the file anew", file.string());
  return table;
}

// Rows by their first column where that numbers the frames, else by their order.
void take_keypoints(DatasetSource& s, const fs::path& file, int expected) {
  const KeypointTable table = read_keypoints(file, expected);
  std::map<double, std::size_t> by_label;
  for (std::size_t i = 0; i < table.labels.size(); ++i) by_label.emplace(table.labels[i], i);
  const bool labelled = std::all_of(s.frames.begin(), s.frames.end(), [&](int f) { return by_label.count(f) > 0; });
  if (!labelled && table.rows.size() != s.frames.size())
    input_error("{}: has {} rows for {} frames, and its first column does not number them; make the file anew",
                file.string(), table.rows.size(), s.frames.size());
  for (std::size_t i = 0; i < s.frames.size(); ++i)
    s.keypoints.push_back(table.rows[labelled ? by_label.at(s.frames[i]) : i]);
}

// --- with a manifest ---

void take_size(DatasetSource& s, const std::string& where) {
  const CameraRecord& first = s.cameras.front().front();
  s.width = first.width;
  s.height = first.height;
  if (s.width < 1 || s.height < 1)
    input_error("{}: camera {} has {} x {} pixels; make the dataset anew", where, first.id, s.width, s.height);
  for (const CameraRecord& c : s.cameras.front()) s.camera_ids.push_back(c.id);
  for (const auto& list : s.cameras) {
    for (const CameraRecord& c : list) {
      bool finite = c.fx > 0 && c.fy > 0 && std::isfinite(c.fx + c.fy + c.cx + c.cy);
      for (const double value : c.world_to_camera) finite = finite && std::isfinite(value);
      if (!finite)
        input_error("{}: camera {} has a lens or a place that is no number; make the dataset anew", where, c.id);
      if (c.width != s.width || c.height != s.height)
        input_error(
            "{}: camera {} has {} x {} pixels where camera {} has {} x {}; make the dataset with one resolution", where,
            c.id, c.width, c.height, first.id, s.width, s.height);
    }
    if (list.size() != s.camera_ids.size() || !std::equal(list.begin(), list.end(), s.camera_ids.begin(),
                                                          [](const CameraRecord& c, int id) { return c.id == id; }))
      input_error("{}: frames have different sets of cameras; make the dataset with the same ones for all", where);
  }
}

std::string need(const std::string& path_template, const fs::path& folder, const char* what, const char* modality) {
  if (path_template.empty())
    input_error("{}: was made without {}; make it with the modality \"{}\"", folder.string(), what, modality);
  return path_template;
}

DatasetSource from_manifest(const fs::path& folder) {
  const DatasetFolder d = open_dataset(folder);
  const std::string manifest = (folder / manifest_name).string();
  const Manifest& m = d.manifest;
  DatasetSource s;
  s.folder = folder;
  s.has_records = true;
  s.frames = m.held_frames;
  s.reader_radius = m.reader_radius;
  if (s.frames.empty()) input_error("{}: has no frames; make the dataset anew", manifest);
  std::sort(s.frames.begin(), s.frames.end());

  // The manifest lists the splits, so that no reader has to repeat the permutation.
  const auto split = [&](const char* name, std::vector<int>& out) {
    try {
      for (const Json& frame : d.json.at("splits").at(name))
        if (std::binary_search(s.frames.begin(), s.frames.end(), frame.get<int>())) out.push_back(frame.get<int>());
    } catch (const Json::exception& e) {
      input_error("{}: \"splits\" has no list \"{}\" ({}); make the dataset anew", manifest, name, reason_of(e));
    }
  };
  split("train", s.splits.train);
  split("validate", s.splits.validate);
  split("test", s.splits.test);

  s.mask_template = need(d.template_of("silhouette"), folder, "silhouettes", "silhouette");
  s.depth_template = need(d.template_of("depth"), folder, "depth", "depth");
  s.nnopcs_template = d.template_of("nnopcs");  // floats; who wants to save space deletes them and keeps the 8-bit ones
  const int first_camera = m.cameras.empty() ? 0 : m.cameras.front().id;
  std::error_code ignored;
  if (const std::string eight = d.template_of("nnopcs8");
      !eight.empty() &&
      (s.nnopcs_template.empty() || (!fs::exists(s.path(s.nnopcs_template, s.frames.front(), first_camera), ignored) &&
                                     fs::exists(s.path(eight, s.frames.front(), first_camera), ignored))))
    s.nnopcs_template = eight;
  for (int coat : m.coat_indices) {
    const std::string path = d.template_of("rgb", std::to_string(coat));
    if (path.empty()) continue;
    s.coats.emplace_back(
        coat, coat >= 0 && coat < static_cast<int>(m.coats.size()) ? m.coats[coat] : fmt::format("coat {}", coat));
    s.coat_templates.push_back(path);
  }
  if (m.keypoint_names.empty() || d.template_of("keypoints_csv").empty())
    input_error("{}: was made without keypoints; make it with the modality \"keypoints\"", folder.string());
  take_keypoints(s, d.keypoints_csv(), static_cast<int>(m.keypoint_names.size()));

  std::string hashes = identity_of(d).dump(-1, ' ', false, Json::error_handler_t::replace);
  for (int frame : s.frames) {
    const std::vector<std::uint8_t> bytes = read_file(d.record(frame));
    hashes += fmt::format("{} {}\n", frame, xxh64_hex(bytes.data(), bytes.size()));
    if (m.per_frame_cameras)
      s.cameras.push_back(
          record_from_text(std::string(bytes.begin(), bytes.end()), d.record(frame).string()).frame.cameras);
  }
  s.identity = xxh64_hex(hashes.data(), hashes.size());
  if (!m.per_frame_cameras) s.cameras.push_back(m.cameras);
  for (const auto& list : s.cameras)
    if (list.empty()) input_error("{}: has no cameras; make the dataset anew", manifest);
  take_size(s, manifest);
  return s;
}

// --- without ---

using Ini = std::map<std::string, std::map<std::string, std::string>>;

Ini read_ini(const fs::path& file) {
  const std::string text = read_text(file);
  Ini ini;
  std::string section;
  int line = 0;
  for (std::string_view row : lines_of(text)) {
    ++line;
    row = trim(row);
    if (row.empty() || row.front() == '#' || row.front() == ';') continue;
    if (row.front() == '[') {
      if (row.back() != ']') input_error("{}:{}: the section has no \"]\"; mend the line", file.string(), line);
      section = std::string(row.substr(1, row.size() - 2));
      ini[section];
      continue;
    }
    const std::size_t equals = row.find_first_of("=:");
    if (equals == std::string_view::npos)
      input_error("{}:{}: \"{}\" is neither a section nor \"key = value\"; mend the line", file.string(), line,
                  std::string(row));
    ini[section][std::string(trim(row.substr(0, equals)))] = std::string(trim(row.substr(equals + 1)));
  }
  return ini;
}

// World to camera of a Blender camera (XYZ Euler angles; looks along its -Z, +Y up) in OpenCV axes.
std::array<double, 12> from_euler(const dvec3& centre, const dvec3& r) {
  const double cx = std::cos(r.x), sx = std::sin(r.x), cy = std::cos(r.y), sy = std::sin(r.y), cz = std::cos(r.z),
               sz = std::sin(r.z);
  const dvec3 x(cz * cy, sz * cy, -sy);  // columns of Rz Ry Rx: the camera's axes in the world
  const dvec3 y(cz * sy * sx - sz * cx, sz * sy * sx + cz * cx, cy * sx);
  const dvec3 z(cz * sy * cx + sz * sx, sz * sy * cx - cz * sx, cy * cx);
  const dvec3 rows[3] = {x, -y, -z};
  std::array<double, 12> out;
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) out[4 * i + k] = rows[i][k];
    out[4 * i + 3] = -glm::dot(rows[i], centre);
  }
  return out;
}

std::vector<CameraRecord> read_parameters(const fs::path& file) {
  const Ini ini = read_ini(file);
  // A camera's own lens, where it has one, stands in its own section.
  const auto value = [&](const std::string& section, const std::string& key, bool shared) {
    for (const std::string& name :
         shared ? std::vector<std::string>{section, "intrinsics"} : std::vector<std::string>{section}) {
      const auto found = ini.find(name);
      if (found == ini.end() || !found->second.count(key)) continue;
      double number = 0;
      if (!parse_number(found->second.at(key), number) || !std::isfinite(number))
        input_error("{}: \"{}\" of [{}] is not a number (\"{}\"); mend it", file.string(), key, name,
                    found->second.at(key));
      return number;
    }
    input_error("{}: [{}] has no \"{}\"; add it", file.string(), shared ? "intrinsics" : section, key);
  };
  constexpr std::string_view prefix = "extrinsics_Camera.";
  std::vector<CameraRecord> out;
  for (const auto& [section, keys] : ini) {
    if (!section.starts_with(prefix)) continue;
    double id = 0;
    if (!parse_number(std::string_view(section).substr(prefix.size()), id))
      input_error("{}: [{}] names no camera by number; mend it", file.string(), section);
    CameraRecord c;
    c.id = static_cast<int>(id);
    for (int i = 0; i < 3; ++i) {
      c.centre[i] = value(section, fmt::format("center_cam_{}_m", "xyz"[i]), false);
      c.euler_xyz[i] = value(section, fmt::format("center_cam_r{}_rad", "xyz"[i]), false);
    }
    c.focal_mm = value(section, "focal_length_mm", true);
    c.sensor_mm = value(section, "sensor_size_mm", true);
    c.width = static_cast<int>(value(section, "image_resolution_x_px", true));
    c.height = static_cast<int>(value(section, "image_resolution_y_px", true));
    c.fx = c.fy = c.focal_mm * std::max(c.width, c.height) / c.sensor_mm;
    c.cx = 0.5 * c.width;
    c.cy = 0.5 * c.height;
    c.world_to_camera = from_euler(c.centre, c.euler_xyz);
    out.push_back(c);
  }
  std::sort(out.begin(), out.end(), [](const CameraRecord& a, const CameraRecord& b) { return a.id < b.id; });
  return out;
}

// The manifest this folder would have, as far as the layout code needs one: species and coats, by the names of folders.
Manifest manifest_of_folders(const fs::path& folder) {
  constexpr std::string_view middle = "_animation_alltextures";
  std::error_code error;
  std::set<std::string> species;
  for (const auto& entry : fs::directory_iterator(folder, error)) {
    const std::string name = entry.path().filename().string();
    const std::size_t at = name.find(middle);
    if (at == std::string::npos || at == 0 || !entry.is_directory()) continue;
    const std::string tail = name.substr(at + middle.size());
    if (tail.empty() || tail == ".blend") species.insert(name.substr(0, at));
  }
  if (species.empty())
    input_error(
        "{}: holds no dataset (there is neither {} nor a folder <species>{}); name the folder that `generate -o` made",
        folder.string(), manifest_name, middle);
  Manifest m;
  m.species = species.count("cow") ? "cow" : *species.begin();
  if (m.species != "cow") {
    std::set<std::string> names;
    for (const auto& entry : fs::directory_iterator(folder / (m.species + std::string(middle)), error))
      if (entry.is_directory()) names.insert(entry.path().filename().string());
    m.coats.assign(names.begin(), names.end());
    // Masks, depth and tables lie in the folder of the first coat, whatever its name.
    std::stable_partition(m.coats.begin(), m.coats.end(), [&](const std::string& name) {
      return fs::exists(folder / (m.species + std::string(middle)) / name / "keypoints.csv", error);
    });
  }
  // The layout names the folders of the cow's twelve coats itself.
  const int coats = m.species == "cow" ? 12 : static_cast<int>(m.coats.size());
  for (int coat = 0; coat < coats; ++coat)
    if (fs::is_directory(folder / coat_folder(m, coat), error)) m.coat_indices.push_back(coat);
  return m;
}

// Frame numbers of the masks in the folder of one camera.
std::vector<int> frames_in(const fs::path& folder) {
  std::vector<int> out;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(folder, error)) {
    const std::string name = entry.path().filename().string();
    constexpr std::string_view prefix = "objectID";
    if (!name.starts_with(prefix) || !name.ends_with(".png")) continue;
    int frame = 0;
    const char* begin = name.data() + prefix.size();
    const auto [end, wrong] = std::from_chars(begin, name.data() + name.size(), frame);
    if (wrong == std::errc() && end > begin && *end == '.') out.push_back(frame);
  }
  std::sort(out.begin(), out.end());
  return out;
}

// Without records, sizes and times of the files tell whether they changed.
std::string stamps_of(const DatasetSource& s, const std::vector<std::string>& templates) {
  std::string stamps;
  std::error_code error;
  for (const std::string& path : templates) {
    if (path.empty()) continue;
    for (int frame : s.frames)
      for (int camera : s.camera_ids) {
        const fs::path file = s.path(path, frame, camera);
        const auto bytes = fs::file_size(file, error);
        if (error) input_error("{}: cannot be read: {}; make the dataset anew", file.string(), error.message());
        stamps += fmt::format("{} {} {}\n", file.lexically_relative(s.folder).string(), bytes,
                              fs::last_write_time(file, error).time_since_epoch().count());
      }
  }
  return xxh64_hex(stamps.data(), stamps.size());
}

DatasetSource from_folders(const fs::path& folder) {
  const Manifest m = manifest_of_folders(folder);
  DatasetSource s;
  s.folder = folder;
  const fs::path csv = folder / keypoints_csv_path(m), cfg = folder / parameters_cfg_path(m);
  std::error_code error;
  for (const fs::path& file : {csv, cfg})
    if (!fs::exists(file, error))
      input_error("{}: is missing, and there is no {}; name the folder that `generate -o` made", file.string(),
                  manifest_name);
  std::vector<CameraRecord> cameras = read_parameters(cfg);
  std::erase_if(cameras, [&](const CameraRecord& c) {
    return !fs::is_directory((folder / file_of(m, Modality::silhouette, 0, c.id, -1, -1)).parent_path(), error);
  });
  if (cameras.empty())
    input_error(
        "{}: has no section [extrinsics_Camera.<number>] of a camera with a folder beside it; make the dataset anew",
        cfg.string());
  s.cameras.push_back(cameras);
  take_size(s, cfg.string());

  s.mask_template = path_template(m, Modality::silhouette, -1, -1);
  s.depth_template = path_template(m, Modality::depth, -1, -1);
  const int first = cameras.front().id;
  s.frames = frames_in(s.path(s.mask_template, 0, first).parent_path());
  if (s.frames.empty())
    input_error("{}: holds no masks objectID<frame>.<camera>.png; make the dataset with silhouettes",
                s.path(s.mask_template, 0, first).parent_path().string());
  s.splits = make_splits(s.frames);
  take_keypoints(s, csv, 0);
  if (!fs::exists(s.path(s.depth_template, s.frames.front(), first), error))
    input_error("{}: is missing; make the dataset with depth",
                s.path(s.depth_template, s.frames.front(), first).string());
  for (const std::string& path : {path_template(m, Modality::nnopcs, -1, -1), nnopcs8_template(m)})
    if (s.nnopcs_template.empty() && fs::exists(s.path(path, s.frames.front(), first), error)) s.nnopcs_template = path;
  for (int coat : m.coat_indices) {
    std::string path = path_template(m, Modality::rgb, coat, -1);
    if (!fs::exists(s.path(path, s.frames.front(), first), error)) continue;
    s.coats.emplace_back(coat, fs::path(coat_folder(m, coat)).filename().string());
    s.coat_templates.push_back(path);
  }

  s.identity = stamps_of(s, {s.mask_template, s.depth_template, s.nnopcs_template});
  return s;
}

}  // namespace

int DatasetSource::coat_at(int coat) const {
  for (std::size_t i = 0; i < coats.size(); ++i)
    if (coats[i].first == coat) return static_cast<int>(i);
  std::string there;
  for (const auto& [index, name] : coats) there += (there.empty() ? "" : ", ") + std::to_string(index);
  input_error("{}: has no pictures of coat {}; {}", folder.string(), coat,
              there.empty() ? "make it with the modality \"rgb\"" : "its coats are " + there);
}

std::string coat_identity(const DatasetSource& source, int coat_at) {
  const std::string& path = source.coat_templates[coat_at];
  return source.has_records ? path : path + stamps_of(source, {path});
}

DatasetSource read_dataset_source(const fs::path& given) {
  fs::path folder = given.lexically_normal();
  if (!folder.has_filename() && folder.has_parent_path() && folder != folder.root_path()) folder = folder.parent_path();
  std::error_code error;
  if (!fs::is_directory(folder, error))
    input_error("{}: is not a folder; name the folder of a dataset", given.string());
  // An unfinished dataset of ours has the folders too: open_dataset() says what to do about it.
  if (fs::exists(folder / manifest_name, error) || fs::exists(folder / journal_name, error))
    return from_manifest(folder);
  return from_folders(folder);
}

std::string why_not_rings(const DatasetSource& s) {
  if (s.cameras.size() != 1) return "its cameras vary from frame to frame";
  const std::vector<CameraRecord>& cameras = s.cameras.front();
  if (cameras.size() % ring_cameras != 0) return fmt::format("its {} cameras are not rings of eight", cameras.size());
  const double c = std::sqrt(0.5);  // of 45 degrees
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    const std::size_t ring = i / ring_cameras;
    const CameraRecord &a = cameras[i], &b = cameras[ring * ring_cameras + (i + 1) % ring_cameras];
    if (a.fx != b.fx || a.fy != b.fy || a.cx != b.cx || a.cy != b.cy)
      return fmt::format("cameras {} and {} have different lenses", a.id, b.id);
    for (int r = 0; r < 3; ++r) {
      // b.W = a.W Rz(-45 degrees), translation unchanged: only then does the ring's axis pass through the origin.
      const double *w = a.world_to_camera.data() + 4 * r, *v = b.world_to_camera.data() + 4 * r;
      const double turned[4] = {c * w[0] - c * w[1], c * w[0] + c * w[1], w[2], w[3]};
      for (int k = 0; k < 4; ++k)
        if (!(std::abs(turned[k] - v[k]) <= ring_tolerance))
          return fmt::format("camera {} is not camera {} turned by 45 degrees about the Z axis", b.id, a.id);
    }
  }
  return {};
}

std::vector<int> coats_of_dataset(const std::filesystem::path& dataset) {
  std::vector<int> coats;
  for (const auto& [index, name] : read_dataset_source(dataset).coats) coats.push_back(index);
  return coats;
}

}  // namespace moomill
