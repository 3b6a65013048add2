#include "generator/dataset/reader.h"

#include "generator/core/error.h"
#include "generator/dataset/codecs.h"
#include "generator/dataset/json.h"

namespace moomill {

std::string DatasetFolder::template_of(const std::string& name, const std::string& key) const {
  const Json& paths = json.at("paths");
  if (!paths.contains(name)) return {};
  const Json& entry = paths.at(name);
  if (entry.is_string()) return key.empty() ? entry.get<std::string>() : std::string{};
  if (!entry.is_object() || !entry.contains(key) || !entry.at(key).is_string()) return {};
  return entry.at(key).get<std::string>();
}

namespace {

std::filesystem::path resolve(const DatasetFolder& d, const std::string& name, const std::string& key, int frame,
                              int camera) {
  const std::string path = d.template_of(name, key);
  if (path.empty())
    input_error("{}: \"paths\" has no \"{}\"{}; this dataset was made without it", (d.folder / manifest_name).string(),
                name, key.empty() ? "" : " for " + key);
  return d.folder / expand_template(path, frame, camera);
}

}  // namespace

std::filesystem::path DatasetFolder::file(Modality modality, int frame, int camera, int coat, int animal) const {
  const ModalityRow& r = row(modality);
  const int key = r.per_coat ? coat : modality == Modality::occlusion ? animal : -1;
  return resolve(*this, r.name, key < 0 ? "" : std::to_string(key), frame, camera);
}

std::filesystem::path DatasetFolder::nnopcs8(int frame, int camera) const {
  return resolve(*this, "nnopcs8", "", frame, camera);
}
std::filesystem::path DatasetFolder::record(int frame) const {
  return resolve(*this, "record", "", frame, 0);
}
std::filesystem::path DatasetFolder::keypoints_csv() const {
  return resolve(*this, "keypoints_csv", "", 0, 0);
}
std::filesystem::path DatasetFolder::parameters_cfg() const {
  return resolve(*this, "parameters_cfg", "", 0, 0);
}

DatasetFolder open_dataset(const std::filesystem::path& folder) {
  DatasetFolder d;
  d.folder = folder;
  const std::filesystem::path file = folder / manifest_name;
  std::error_code ignored;
  if (!std::filesystem::exists(file, ignored)) {
    if (std::filesystem::exists(folder / journal_name, ignored))
      input_error("{}: holds an unfinished dataset; run the `generate` that made it again, it resumes",
                  folder.string());
    input_error("{}: holds no dataset (there is no {}); name the folder that `generate -o` made", folder.string(),
                manifest_name);
  }
  d.json = parse_json_file(file);
  d.manifest = manifest_from_json(d.json, file.string());
  const auto inside = [&](const Json& path) {
    if (!path.is_string()) return;
    const std::string text = path.get<std::string>();
    if (text.starts_with('/') || text.find("..") != std::string::npos)
      input_error("{}: the path \"{}\" leaves the dataset; make the dataset anew", file.string(), text);
  };
  if (!d.json.contains("paths") || !d.json.at("paths").is_object())
    input_error("{}: \"paths\" is missing; make the dataset anew", file.string());
  for (const Json& path : d.json.at("paths")) {
    inside(path);
    if (path.is_object())
      for (const Json& by_key : path) inside(by_key);
  }
  for (const std::string& rig : d.manifest.rig_files) inside(rig);
  return d;
}

Json identity_of(const DatasetFolder& dataset) {
  Json json = dataset.json;
  json.erase("held_frames");
  json.erase("rig_hashes");
  return json;
}

StoredFrame read_frame(const DatasetFolder& dataset, int frame) {
  const std::filesystem::path file = dataset.record(frame);
  const std::vector<std::uint8_t> bytes = read_file(file);
  StoredFrame stored = record_from_text(std::string(bytes.begin(), bytes.end()), file.string());
  if (stored.frame.frame != frame)
    input_error("{}: is the record of frame {}; make the frame anew", file.string(), stored.frame.frame);
  return stored;
}

const std::vector<CameraRecord>& cameras_of(const DatasetFolder& dataset, const StoredFrame& frame) {
  return frame.frame.cameras.empty() ? dataset.manifest.cameras : frame.frame.cameras;
}

}  // namespace moomill
