// What belongs to the dataset as a whole: rigs, tables, cameras, splits.
#include <charconv>
#include <set>
#include <sstream>

#include "generator/core/error.h"
#include "generator/dataset/codecs.h"
#include "validate/context.h"

namespace moomill {
namespace {

constexpr double camera_bar = 1e-4;    // px
constexpr double symmetry_bar = 1e-6;  // m
constexpr int ring = 8;

std::string text_of(const std::filesystem::path& file) {
  const std::vector<std::uint8_t> bytes = read_file(file);
  return {bytes.begin(), bytes.end()};
}

// Reads a whole text as a number.
std::optional<double> number(std::string_view text) {
  while (!text.empty() && text.front() == ' ') text.remove_prefix(1);
  while (!text.empty() && (text.back() == ' ' || text.back() == '\r')) text.remove_suffix(1);
  double value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return value;
}

// INI as Python's configparser reads it, as far as these files go: section, key, value.
using Ini = std::map<std::string, std::map<std::string, std::string>>;
Ini parse_ini(const std::string& text) {
  Ini ini;
  std::istringstream lines(text);
  std::string line, section;
  while (std::getline(lines, line)) {
    if (line.empty() || line[0] == '#' || line[0] == ';') continue;
    if (line[0] == '[') {
      section = line.substr(1, line.find(']') - 1);
    } else if (const auto equals = line.find('='); equals != std::string::npos) {
      std::string key = line.substr(0, equals);
      while (!key.empty() && key.back() == ' ') key.pop_back();
      ini[section][key] = line.substr(equals + 1);
    }
  }
  return ini;
}

double value(const Ini& ini, const std::string& section, const std::string& key,
             const std::string& fallback_section = {}) {
  for (const std::string& s : {section, fallback_section}) {
    const auto found = ini.find(s);
    if (found == ini.end() || !found->second.count(key)) continue;
    const std::optional<double> v = number(found->second.at(key));
    if (v) return *v;
    input_error("[{}] {} is not a number", s, key);
  }
  input_error("[{}] {} is missing", section, key);
}

void check_csv(Context& context, Tally& tally) {
  const Manifest& m = context.dataset.manifest;
  if (m.keypoint_names.empty()) return;
  const std::filesystem::path file = context.dataset.keypoints_csv();
  const auto wrong = [&](const std::string& what) {
    tally.failed(Check::keypoints_csv, file.string() + ": " + what + ".");
  };
  tally.compared(Check::keypoints_csv);
  std::string text;
  try {
    text = text_of(file);
  } catch (const InputError& e) {
    return tally.failed(Check::keypoints_csv, std::string(e.what()) + ".");
  }
  std::istringstream lines(text);
  std::string line;
  std::getline(lines, line);
  const std::size_t columns = 1 + 3 * m.keypoint_names.size();
  if (line.starts_with('#')) wrong("the header starts with '#', so NumPy would drop the first pose");
  if (number(line.substr(0, line.find(',')))) wrong("the first line is not a header of names");
  if (static_cast<std::size_t>(std::count(line.begin(), line.end(), ',')) + 1 != columns)
    wrong(fmt::format("the header has not {} names", columns));
  std::vector<int> frames;
  while (std::getline(lines, line)) {
    std::vector<double> row;
    std::istringstream cells(line);
    for (std::string cell; std::getline(cells, cell, ',');) {
      const std::optional<double> v = number(cell);
      if (!v) wrong(fmt::format("line {} has \"{}\" where a number should be", frames.size() + 2, cell));
      row.push_back(v.value_or(0));
    }
    tally.compared(Check::keypoints_csv);
    if (row.size() != columns) {
      wrong(fmt::format("line {} has {} columns where {} should be", frames.size() + 2, row.size(), columns));
      row.resize(columns);
    }
    const int frame = static_cast<int>(row[0]);
    frames.push_back(frame);
    std::vector<dvec3>& points = context.csv[frame];
    points.clear();
    for (std::size_t k = 1; k + 2 < row.size(); k += 3) points.emplace_back(row[k], row[k + 1], row[k + 2]);
  }
  if (frames != m.held_frames) wrong("its rows are not the frames of the dataset, in order");
}

void check_parameters(Context& context, Tally& tally) {
  const Manifest& m = context.dataset.manifest;
  const std::filesystem::path file = context.dataset.parameters_cfg();
  std::vector<CameraRecord> cameras = m.cameras;
  try {
    if (m.per_frame_cameras && !m.held_frames.empty())
      cameras = cameras_of(context.dataset, read_frame(context.dataset, m.held_frames.front()));
    const Ini ini = parse_ini(text_of(file));
    for (const CameraRecord& c : cameras) {
      const std::string section = fmt::format("extrinsics_Camera.{:03}", c.id);
      const auto get = [&](const std::string& key) { return value(ini, section, key); };
      const auto lens = [&](const std::string& key) { return value(ini, section, key, "intrinsics"); };
      const dvec3 euler(get("center_cam_rx_rad"), get("center_cam_ry_rad"), get("center_cam_rz_rad"));
      const dvec3 centre(get("center_cam_x_m"), get("center_cam_y_m"), get("center_cam_z_m"));
      const int width = static_cast<int>(lens("image_resolution_x_px")),
                height = static_cast<int>(lens("image_resolution_y_px"));
      const Pinhole p =
          pinhole_from_euler(centre, euler, lens("focal_length_mm"), lens("sensor_size_mm"), width, height);
      context.parameters[c.id] = p;
      const double distance = std::max(1.0, glm::length(centre));
      const Pinhole matrix = pinhole_from_matrix(c);
      const double apart = std::max(pinhole_difference(p, matrix, width, height, distance),
                                    glm::distance(p.centre, matrix.centre) * p.fx / distance);
      tally.within(Check::parameters, width == c.width && height == c.height ? apart : INFINITY, camera_bar, [&] {
        return fmt::format("{}: camera {} is not the manifest's: {} px apart at the corners.", file.string(), c.id,
                           apart);
      });
      tally.within(Check::euler_y, std::abs(euler.y), 0.0, [&] {
        return fmt::format("{}: camera {} has ry = {}, which the public reader turns the wrong way.", file.string(),
                           c.id, euler.y);
      });
    }
  } catch (const InputError& e) {
    tally.compared(Check::parameters);
    tally.failed(Check::parameters, fmt::format("{}: {}.", file.string(), e.what()));
  }
}

// Rings are found by their geometry: eight ids in a row, most of them at one height and one distance from the Z axis.
void check_symmetry(Context& context, Tally& tally) {
  const Manifest& m = context.dataset.manifest;
  if (m.per_frame_cameras) return context.collector.note(Check::camera_symmetry, "cameras vary from frame to frame");
  std::map<int, const CameraRecord*> by_id;
  for (const CameraRecord& c : m.cameras) by_id[c.id] = &c;
  bool any = false;
  for (int first = 0; by_id.size() >= ring && first <= by_id.rbegin()->first; first += ring) {
    std::vector<const CameraRecord*> cameras;
    for (int id = first; id < first + ring; ++id)
      if (by_id.count(id)) cameras.push_back(by_id[id]);
    if (cameras.size() != ring) continue;
    const auto alike = [](const CameraRecord& a, const CameraRecord& b) {
      return std::abs(a.centre.z - b.centre.z) < 1e-3 &&
             std::abs(std::hypot(a.centre.x, a.centre.y) - std::hypot(b.centre.x, b.centre.y)) < 1e-3;
    };
    int most = 0;
    for (const auto* a : cameras)
      most = std::max(most, static_cast<int>(std::count_if(cameras.begin(), cameras.end(),
                                                           [&](const auto* b) { return alike(*a, *b); })));
    if (most < ring / 2) continue;
    any = true;
    const double c = std::sqrt(0.5);
    const auto turned = [&](const dvec3& v) { return dvec3(c * (v.x - v.y), c * (v.x + v.y), v.z); };
    for (int k = 0; k < ring; ++k) {
      const Pinhole from = pinhole_from_matrix(*cameras[k]), to = pinhole_from_matrix(*cameras[(k + 1) % ring]);
      double apart = glm::distance(turned(from.centre), to.centre);
      for (int r = 0; r < 3; ++r) apart = std::max(apart, glm::distance(turned(from.axes[r]), to.axes[r]));
      tally.within(Check::camera_symmetry, apart, symmetry_bar, [&] {
        return fmt::format("Turned by 45 degrees, camera {} is {} m from camera {}.", cameras[k]->id, apart,
                           cameras[(k + 1) % ring]->id);
      });
    }
  }
  if (!any) context.collector.note(Check::camera_symmetry, "there are no rings of eight cameras");
}

}  // namespace

void check_tables(Context& context) {
  Tally tally;
  check_csv(context, tally);
  check_parameters(context, tally);
  context.collector.add(0, std::move(tally));
}

void check_manifest(Context& context) {
  Tally tally;
  const Manifest& m = context.dataset.manifest;
  const auto wrong = [&](const std::string& what) {
    tally.failed(Check::splits, (context.dataset.folder / manifest_name).string() + ": " + what + ".");
  };
  for (std::size_t i = 0; i < m.frames.size(); ++i) {
    tally.compared(Check::splits);
    if (m.frames[i] < 1) wrong(fmt::format("frame {} is below 1", m.frames[i]));
    if (i > 0 && m.frames[i] <= m.frames[i - 1])
      wrong(fmt::format("frame {} follows frame {}", m.frames[i], m.frames[i - 1]));
  }
  std::map<int, int> seen;
  try {
    for (const char* split : {"train", "validate", "test"})
      for (const Json& frame : context.dataset.json.at("splits").at(split)) ++seen[frame.get<int>()];
  } catch (const Json::exception&) {
    wrong("\"splits\" is missing or wrong");
  }
  for (int frame : m.frames)
    if (seen[frame] != 1) wrong(fmt::format("frame {} is in {} splits", frame, seen[frame]));
  if (seen.size() != m.frames.size()) wrong("the splits have other frames than the dataset");
  check_symmetry(context, tally);
  context.collector.add(0, std::move(tally));
}

void read_rigs(Context& context) {
  Tally tally;
  const Manifest& m = context.dataset.manifest;
  context.meshes.resize(m.animals.size());
  const auto unusable = [&](const std::string& why) {
    for (Check check : {Check::surface_nnopcs, Check::surface_pixel, Check::surface_depth})
      context.collector.note(check, why);
  };
  const Json hashes = context.dataset.json.value("rig_hashes", Json::object());
  for (const auto& [path, entry] : hashes.items()) {
    tally.compared(Check::rigs);
    try {
      const std::vector<std::uint8_t> bytes = read_file(context.dataset.folder / path);
      if (bytes.size() != entry.at(0).get<std::size_t>() ||
          xxh64_hex(bytes.data(), bytes.size()) != entry.at(1).get<std::string>())
        tally.failed(Check::rigs, fmt::format("{}: is not the file that the manifest recorded.", path));
    } catch (const std::exception& e) {
      tally.failed(Check::rigs, std::string(e.what()) + ".");
    }
  }
  const dvec3 size = m.nnopcs_upper - m.nnopcs_lower;
  for (std::size_t a = 0; a < m.animals.size(); ++a) {
    if (m.animals[a] != m.animals[static_cast<std::size_t>(labelled_animal)]) {
      unusable("the manifest has no NNOPCS box of " + m.animals[a]);
      continue;
    }
    try {
      if (!hashes.contains(rig_path(m, static_cast<int>(a)))) {
        unusable("the dataset holds no rig file");
        continue;
      }
      auto mesh = std::make_unique<AnimalMesh>();
      mesh->rig = load_rig(context.dataset.folder / rig_path(m, static_cast<int>(a)));
      const Surface& surface = mesh->rig.surface;
      mesh->neutral.assign(surface.rest.begin(), surface.rest.end());
      Box box;
      for (const uvec3& t : surface.triangles)
        for (int k = 0; k < 3; ++k) box.add(mesh->neutral[t[k]]);
      if (box.empty() || glm::length(box.lower - m.nnopcs_lower) > 1e-4 ||
          glm::length(box.upper - m.nnopcs_upper) > 1e-4) {
        unusable("the bind pose of the rig is not the neutral pose of the NNOPCS box");
        continue;
      }
      for (int k = 0; k < 3; ++k) {
        if (m.nnopcs_normalization == "diagonal") {
          mesh->scale[k] = 1 / std::max(glm::length(size), 1e-12);
          mesh->shift[k] = 0.5 - 0.5 * (m.nnopcs_lower[k] + m.nnopcs_upper[k]) * mesh->scale[k];
        } else {
          mesh->scale[k] = size[k] > 0 ? 1 / size[k] : 1;
          mesh->shift[k] = size[k] > 0 ? -m.nnopcs_lower[k] * mesh->scale[k] : 0.5 - m.nnopcs_lower[k];
        }
      }
      mesh->grid = std::make_unique<TriangleGrid>(mesh->neutral, surface.triangles);
      context.meshes[a] = std::move(mesh);
    } catch (const InputError& e) {
      tally.compared(Check::rigs);
      tally.failed(Check::rigs, std::string(e.what()) + ".");
      unusable("the rig file cannot be read");
    }
  }
  context.collector.add(0, std::move(tally));
}

}  // namespace moomill
