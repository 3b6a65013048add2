// Shards into one dataset: the same bytes as one straight run.
#include <atomic>
#include <set>

#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "generator/dataset/codecs.h"
#include "generator/dataset/reader.h"

namespace moomill {
namespace {

namespace fs = std::filesystem;

// A hard link where the file system allows it, else a copy. Files are never changed in place, so links are safe.
void place(const fs::path& from, const std::vector<std::uint8_t>& bytes, const fs::path& to) {
  std::error_code error;
  fs::create_directories(to.parent_path(), error);
  fs::create_hard_link(from, to, error);
  if (!error) return;
  if (fs::equivalent(from, to, error) && !error) return;
  write_file_atomically(to, bytes.data(), bytes.size());
}

std::string text_of(const fs::path& file) {
  const std::vector<std::uint8_t> bytes = read_file(file);
  return {bytes.begin(), bytes.end()};
}

std::string listed(const std::vector<int>& frames) {
  std::string out;
  for (std::size_t i = 0; i < frames.size() && i < 5; ++i) out += (i ? ", " : "") + std::to_string(frames[i]);
  return frames.size() > 5 ? out + ", ..." : out;
}

}  // namespace

void merge_datasets(const std::vector<fs::path>& shards, const fs::path& out, bool allow_missing) {
  if (shards.empty()) input_error("no shards were named; give the folders that `generate --shard` made");
  std::vector<DatasetFolder> parts;
  for (const fs::path& shard : shards) {
    std::error_code error;
    if (fs::equivalent(shard, out, error) && !error)
      input_error("{}: is both a shard and the folder to make; choose another -o", out.string());
    parts.push_back(open_dataset(shard));
    if (fs::exists(shard / journal_name, error))
      input_error("{}: is unfinished; run its `generate` again, it resumes", shard.string());
  }
  const Json identity = identity_of(parts.front());
  if (identity != manifest_identity(parts.front().manifest))
    input_error("{}: was made by version {} and this is {}; merge with the version that made the shards",
                parts.front().folder.string(), identity.value("program_version", "?"), MOOMILL_VERSION);
  for (const DatasetFolder& part : parts)
    if (identity_of(part) != identity)
      input_error("{}: is a shard of another dataset than {}; merge shards of one scene, seed and program version",
                  part.folder.string(), parts.front().folder.string());

  std::map<int, std::vector<const DatasetFolder*>> holders;
  for (const DatasetFolder& part : parts)
    for (int frame : part.manifest.held_frames) holders[frame].push_back(&part);
  Manifest manifest = parts.front().manifest;
  manifest.held_frames.clear();
  std::vector<int> missing;
  for (int frame : manifest.frames) (holders.count(frame) ? manifest.held_frames : missing).push_back(frame);
  if (!missing.empty() && !allow_missing)
    input_error("{}: {} of {} frames are in no shard (frames {}); add their shards or pass --allow-missing",
                out.string(), missing.size(), manifest.frames.size(), listed(missing));
  if (manifest.held_frames.empty()) input_error("{}: the shards hold no frame; name other shards", out.string());

  DatasetWriter writer(out, manifest, hardware_threads());
  if (writer.is_complete()) return;
  for (int animal = 0; animal < static_cast<int>(manifest.animals.size()); ++animal) {
    const fs::path first = parts.front().folder / rig_path(manifest, animal);
    std::error_code error;
    if (!fs::exists(first, error)) continue;
    const std::vector<std::uint8_t> bytes = read_file(first);
    for (const DatasetFolder& part : parts)
      if (read_file(part.folder / rig_path(manifest, animal)) != bytes)
        input_error("{}: differs from {}; make the shards anew with one program version",
                    (part.folder / rig_path(manifest, animal)).string(), first.string());
    writer.write_rig(animal, first);
  }
  parallel_for(manifest.held_frames.size(), 1, [&](std::size_t i) {
    const int frame = manifest.held_frames[i];
    const std::vector<const DatasetFolder*>& from = holders.at(frame);
    const std::string record = text_of(from.front()->record(frame));
    for (const DatasetFolder* other : from)
      if (text_of(other->record(frame)) != record)
        input_error("{}: frame {} differs from {}; make one of the shards anew", other->record(frame).string(), frame,
                    from.front()->record(frame).string());
    if (writer.is_done(frame)) return;
    for (const auto& [path, entry] : read_frame(*from.front(), frame).files) {
      const fs::path file = from.front()->folder / path;
      const std::vector<std::uint8_t> bytes = read_file(file);
      if (bytes.size() != entry.bytes || xxh64_hex(bytes.data(), bytes.size()) != entry.xxh64)
        input_error("{}: is not the file that frame {} recorded; make its shard anew", file.string(), frame);
      place(file, bytes, out / path);
    }
    writer.adopt_frame(frame, record);
  });
  writer.finish();
}

}  // namespace moomill
