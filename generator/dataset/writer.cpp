// A dataset folder in the making: views as they come, a record and a journal line per frame, the rest at the end.
#include <algorithm>
#include <mutex>
#include <set>

#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "generator/core/stage_times.h"
#include "generator/dataset/codecs.h"
#include "generator/dataset/encode_view.h"
#include "generator/dataset/journal.h"
#include "generator/dataset/json.h"
#include "generator/dataset/reader.h"
#include "generator/dataset/tables.h"

namespace moomill {
namespace {

namespace fs = std::filesystem;

fs::path record_path(const fs::path& folder, int frame) {
  return folder / expand_template(record_template(), frame, 0);
}

std::string read_text(const fs::path& file) {
  const std::vector<std::uint8_t> bytes = read_file(file);
  return {bytes.begin(), bytes.end()};
}

// The hash of a frame's record when the record and every file it names are there with their sizes; else empty. Contents
// are the business of `validate`: to resume, no more must be read than was written.
std::string intact_record(const fs::path& folder, int frame, const std::string& expected_hash) {
  const fs::path file = record_path(folder, frame);
  std::error_code error;
  if (!fs::exists(file, error)) return {};
  const std::string text = read_text(file);
  const std::string hash = xxh64_hex(text.data(), text.size());
  if (!expected_hash.empty() && hash != expected_hash) return {};
  try {
    for (const auto& [path, entry] : record_from_text(text, file.string()).files)
      if (fs::file_size(folder / path, error) != entry.bytes || error) return {};
  } catch (const InputError&) {
    return {};
  }
  return hash;
}

// Says which parts of two identities differ.
std::string differences(const Json& a, const Json& b) {
  std::string out;
  for (const auto& [key, value] : b.items()) {
    if (a.contains(key) && a.at(key) == value) continue;
    if (key == "splits" || key == "paths") continue;  // follow from others
    out += (out.empty() ? "" : ", ") + key;
  }
  return out.empty() ? "something else" : out;
}

void require_same(const Json& there, const Json& ours, const fs::path& folder) {
  if (there == ours) return;
  input_error("{}: holds another dataset (it differs in: {}); choose another folder or delete this one",
              folder.string(), differences(there, ours));
}

void remove_temporaries(const fs::path& folder) {
  std::vector<fs::path> found;
  std::error_code error;
  for (fs::recursive_directory_iterator i(folder, error), end; !error && i != end; i.increment(error))
    if (is_temporary(i->path())) found.push_back(i->path());
  for (const fs::path& file : found) fs::remove(file, error);
}

// Folder that belongs to somebody else: it has entries, none of them hidden, and none of them ours.
bool is_foreign(const fs::path& folder) {
  std::error_code error;
  for (fs::directory_iterator i(folder, error), end; !error && i != end; i.increment(error))
    if (!i->path().filename().string().starts_with('.')) return true;
  return false;
}

}  // namespace

struct DatasetWriter::State {
  fs::path folder;
  Manifest manifest;
  Json identity;
  std::unique_ptr<Journal> journal;  // none when the dataset is complete
  bool complete = false;
  std::mutex mutex;  // guards the rest
  std::set<int> done;
  std::map<int, StoredFrame> open;  // frames with views written, not yet finished

  void verify(const std::map<int, std::string>& frames, std::map<int, std::string>& intact) const {
    std::vector<std::pair<int, std::string>> list(frames.begin(), frames.end());
    std::vector<std::string> hashes(list.size());
    parallel_for(list.size(), 1,
                 [&](std::size_t i) { hashes[i] = intact_record(folder, list[i].first, list[i].second); });
    for (std::size_t i = 0; i < list.size(); ++i)
      if (!hashes[i].empty()) intact[list[i].first] = hashes[i];
  }

  void hold_also(const std::set<int>& frames) {
    std::set<int> all(manifest.held_frames.begin(), manifest.held_frames.end());
    for (int frame : frames)
      if (std::binary_search(manifest.frames.begin(), manifest.frames.end(), frame)) all.insert(frame);
    manifest.held_frames.assign(all.begin(), all.end());
  }
};

DatasetWriter::DatasetWriter(fs::path folder, Manifest manifest, int threads) : state_(std::make_unique<State>()) {
  State& s = *state_;
  s.folder = std::move(folder);
  s.manifest = std::move(manifest);
  std::sort(s.manifest.frames.begin(), s.manifest.frames.end());
  if (s.manifest.held_frames.empty()) s.manifest.held_frames = s.manifest.frames;
  s.identity = Json::parse(manifest_identity(s.manifest).dump(-1, ' ', false, Json::error_handler_t::replace));

  std::error_code error;
  fs::create_directories(s.folder, error);
  if (error)
    run_error("{}: cannot be made: {}; check the path and its permissions", s.folder.string(), error.message());
  const fs::path manifest_file = s.folder / manifest_name, journal_file = s.folder / journal_name;
  const bool has_manifest = fs::exists(manifest_file, error), has_journal = fs::exists(journal_file, error);
  if (!has_manifest && !has_journal && is_foreign(s.folder))
    input_error("{}: is not empty and holds no dataset of moomill; choose a new or an empty folder", s.folder.string());

  const auto with_threads = [&](const auto& body) {
    tbb::task_arena(std::clamp(threads, 1, hardware_threads())).execute(body);
  };
  std::map<int, std::string> intact;
  if (has_manifest && !has_journal) {
    const DatasetFolder there = open_dataset(s.folder);
    require_same(identity_of(there), s.identity, s.folder);
    std::map<int, std::string> held;
    for (int frame : there.manifest.held_frames) held[frame] = "";
    with_threads([&] { s.verify(held, intact); });
    s.hold_also({there.manifest.held_frames.begin(), there.manifest.held_frames.end()});
    if (intact.size() == s.manifest.held_frames.size()) {
      s.complete = true;
      for (const auto& [frame, hash] : intact) s.done.insert(frame);
      return;
    }
  }
  s.journal = std::make_unique<Journal>(s.folder);
  if (!s.journal->is_new()) {
    require_same(s.journal->identity(), s.identity, s.folder);
    with_threads([&] { s.verify(s.journal->frames(), intact); });
    remove_temporaries(s.folder);
  } else {
    s.journal->start(s.identity);
    // Held by a finished shard that is extended now.
    for (const auto& [frame, hash] : intact) s.journal->append(frame, hash);
  }
  fs::remove(manifest_file, error);  // a folder with a manifest is a finished dataset
  for (const auto& [frame, hash] : intact) s.done.insert(frame);
  s.hold_also(s.done);
}

DatasetWriter::~DatasetWriter() = default;

bool DatasetWriter::is_complete() const {
  return state_->complete;
}

bool DatasetWriter::is_done(int frame) const {
  std::lock_guard lock(state_->mutex);
  return state_->done.count(frame) > 0;
}

void DatasetWriter::write_rig(int animal, const fs::path& made) {
  const std::vector<std::uint8_t> bytes = read_file(made);
  write_file_atomically(state_->folder / rig_path(state_->manifest, animal), bytes.data(), bytes.size());
}

void DatasetWriter::write_rig(int animal, const std::function<void(const fs::path&)>& make) {
  make_file_atomically(state_->folder / rig_path(state_->manifest, animal), make);
}

void DatasetWriter::write_pictures(const View& view) {
  State& s = *state_;
  std::vector<std::vector<std::pair<std::string, FileRecord>>> written(view.maps.size());
  parallel_for(view.maps.size(), 1, [&](std::size_t i) {
    if (!s.manifest.modalities.has(view.maps[i].modality)) return;  // computed for another modality's sake
    const Map& map = view.maps[i];
    const StageTimer timer("encode", map.coat < 0 ? row(map.modality).name : fmt::format("{} of coat {}", row(map.modality).name, map.coat));
    for (const EncodedFile& file : encode_map(s.manifest, view, map)) {
      write_file_atomically(s.folder / file.path, file.bytes.data(), file.bytes.size());
      written[i].emplace_back(file.path,
                              FileRecord{file.bytes.size(), xxh64_hex(file.bytes.data(), file.bytes.size())});
    }
  });
  std::lock_guard lock(s.mutex);
  StoredFrame& frame = s.open[view.frame];
  for (const auto& files : written)
    for (const auto& [path, file] : files)
      check(frame.files.emplace(path, file).second, "a file was written twice in one frame");
}

void DatasetWriter::write_view(const View& view) {
  State& s = *state_;
  write_pictures(view);
  View kept;
  kept.frame = view.frame;
  kept.camera = view.camera;
  kept.width = view.width;
  kept.height = view.height;
  kept.keypoints = view.keypoints;
  kept.occlusion = view.occlusion;
  std::lock_guard lock(s.mutex);
  s.open[view.frame].views.push_back(std::move(kept));
}

void DatasetWriter::finish_frame(const FrameRecord& record) {
  State& s = *state_;
  StoredFrame stored;
  {
    std::lock_guard lock(s.mutex);
    if (const auto found = s.open.find(record.frame); found != s.open.end()) {
      stored = std::move(found->second);
      s.open.erase(found);
    }
  }
  stored.frame = record;
  std::sort(stored.views.begin(), stored.views.end(), [](const View& a, const View& b) { return a.camera < b.camera; });
  const std::size_t cameras = s.manifest.per_frame_cameras ? record.cameras.size() : s.manifest.cameras.size();
  check(stored.views.size() == cameras, "a frame was finished before all its views were written");
  adopt_frame(record.frame, record_text(stored));
}

void DatasetWriter::adopt_frame(int frame, const std::string& record) {
  State& s = *state_;
  check(s.journal != nullptr, "a complete dataset takes no more frames");
  write_file_atomically(record_path(s.folder, frame), record);
  s.journal->append(frame, xxh64_hex(record.data(), record.size()));
  std::lock_guard lock(s.mutex);
  s.done.insert(frame);
}

void DatasetWriter::finish() {
  State& s = *state_;
  if (s.complete) return;
  const Manifest& m = s.manifest;
  for (int frame : m.held_frames) check(s.done.count(frame) > 0, "a dataset was finished before all its frames");

  // From the records, not from memory: a resumed run must end in the same bytes.
  std::string keypoints = keypoints_csv_header(m);
  std::vector<CameraRecord> cameras = m.cameras;
  const std::size_t animal = static_cast<std::size_t>(labelled_animal);
  for (std::size_t i = 0; i < m.held_frames.size(); ++i) {
    const fs::path file = record_path(s.folder, m.held_frames[i]);
    const FrameRecord record = record_from_text(read_text(file), file.string()).frame;
    if (animal < record.keypoints.size()) keypoints += keypoints_csv_row(record.frame, record.keypoints[animal]);
    if (i == 0 && m.per_frame_cameras) cameras = record.cameras;
  }
  if (!m.keypoint_names.empty()) write_file_atomically(s.folder / keypoints_csv_path(m), keypoints);
  write_file_atomically(s.folder / parameters_cfg_path(m), parameters_cfg(m, cameras));
  Json json = manifest_to_json(m);
  Json rigs = Json::object();
  for (int a = 0; a < static_cast<int>(m.animals.size()); ++a) {
    const fs::path rig = s.folder / rig_path(m, a);
    std::error_code error;
    if (!fs::exists(rig, error)) continue;
    const std::vector<std::uint8_t> bytes = read_file(rig);
    rigs[rig_path(m, a)] = Json::array({bytes.size(), xxh64_hex(bytes.data(), bytes.size())});
  }
  json["rig_hashes"] = rigs;
  write_file_atomically(s.folder / manifest_name, dump_json(json));
  s.journal->remove();
  s.journal.reset();
  s.complete = true;
}

}  // namespace moomill
