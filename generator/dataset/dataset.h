#pragma once
// Datasets on disk: layout, manifest, per-frame records, journal, merge. Knows files, not rays.
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "generator/core/modality.h"

namespace moomill {

using Json = nlohmann::json;  // object keys come out sorted

// A camera as the dataset records it. Euler angles as Blender's XYZ (camera looks along -Z, +Y up); ry is 0 for
// NePuMoo cameras. world_to_camera is OpenCV (x right, y down, z forward), row-major 3x4.
struct CameraRecord {
  int id = 0;
  dvec3 centre{0};     // metres
  dvec3 euler_xyz{0};  // radians
  double focal_mm = 100, sensor_mm = 36;
  int width = 1024, height = 768;
  std::array<double, 12> world_to_camera{};
  double fx = 0, fy = 0, cx = 0, cy = 0;  // pixels
};

// Who wears a coat, where it was drawn from a breed rather than made by hand: what tells animals apart.
struct Individual {
  std::string breed;
  std::uint64_t seed = 0;
  int index = 0;
  bool operator==(const Individual&) const = default;
};

enum class Subset { main, novel_views, occlusions };

// Everything that is the same for all frames of a dataset. Goes into manifest.json.
struct Manifest {
  std::string species = "cow";
  Subset subset = Subset::main;
  std::uint64_t seed = 0;
  Json scene;                         // as resolved
  std::vector<CameraRecord> cameras;  // when per_frame_cameras is false
  bool per_frame_cameras = false;     // cameras drawn per frame or view are in the frame records instead
  std::vector<std::string> coats;     // names by index
  std::vector<std::optional<Individual>> individuals;  // by coat index; empty where no coat is drawn from a breed
  std::vector<int> coat_indices;      // which of them this dataset holds (all, unless --coats)
  std::vector<std::string> animals;   // species per animal; the labelled one is the first
  std::vector<std::string> keypoint_names;
  std::vector<std::pair<int, int>> skeleton, pairs;
  std::vector<double> keypoint_tolerance;  // metres
  std::vector<std::string> part_names;
  std::vector<int> frames;       // as numbered, ascending: all frames of the whole dataset
  std::vector<int> held_frames;  // of those, the ones this folder holds (a shard holds fewer); empty: all
  ModalitySet modalities;
  dvec3 nnopcs_lower{0}, nnopcs_upper{0};  // metres, the neutral box
  std::string nnopcs_normalization = "box";
  std::string skinning = "linear_blend";
  std::vector<std::string> rig_files;  // per animal, relative to the dataset: rigs/<animal>.glb, used by validate
  double reader_radius = 1.5;
};

// What is particular to one frame; goes into frames/<frame>.json together with the keypoints, occluders and hashes
// of its views.
struct FrameRecord {
  int frame = 0;
  std::vector<std::vector<dvec3>> keypoints;         // per animal, world metres
  std::vector<std::vector<std::string>> bone_names;  // per animal; only names, for readers
  std::vector<std::vector<dmat4>> bones;             // per animal: skinning matrices, bind-pose model space to world
  std::vector<dmat4> placement;                      // per animal, model to world
  std::vector<std::vector<double>> morph_weights;    // per animal
  std::vector<CameraRecord> cameras;                 // when drawn per frame or view
  Json drawn;                                        // values drawn from distributions, by key
};

// --- where things lie (layout.cpp). Paths are relative to the dataset folder, which plays the part of the public
// loader's `multiview_<species>/`. Templates hold {frame:04} and {camera:03}; the manifest carries them, and readers
// use the manifest's (reader.h), so that a layout can change without them. ---
std::string coat_folder(const Manifest& manifest, int coat);
std::string path_template(const Manifest& manifest, Modality modality, int coat, int animal);
std::string nnopcs8_template(const Manifest& manifest);  // the 8-bit NNOPCS beside the float one
std::string record_template();                           // per-frame records
std::string keypoints_csv_path(const Manifest& manifest);
std::string parameters_cfg_path(const Manifest& manifest);
std::string rig_path(const Manifest& manifest, int animal);  // manifest.rig_files, or rigs/<animal>.glb
std::string expand_template(const std::string& path, int frame, int camera);
std::filesystem::path file_of(const Manifest& manifest, Modality modality, int frame, int camera, int coat, int animal);
std::vector<std::string> exr_channel_names(Modality modality);  // in the order of Map::f; depth: its one plane thrice
inline constexpr int labelled_animal = 0;  // the first of a scene: the one that masks, keypoints.csv and NNOPCS speak of

Json manifest_to_json(const Manifest& manifest);
Manifest manifest_from_json(const Json& json, const std::string& file);  // InputError on a foreign schema

// The part of a manifest that determines bytes: all of it but the frames held. Equal for all shards of a dataset.
Json manifest_identity(const Manifest& manifest);

// NumPy's RandomState(seed).permutation(n): MT19937, legacy shuffle.
std::vector<int> numpy_permutation(std::uint32_t seed, int n);

// The split of NePuMoo: chunks of 10 frames permuted by NumPy's RandomState(0).permutation; 63 : 9 : 19 of 91.
struct Splits {
  std::vector<int> train, validate, test;
};
Splits make_splits(const std::vector<int>& frames);

// A file of a frame, as its record has it.
struct FileRecord {
  std::uint64_t bytes = 0;
  std::string xxh64;
};

// What frames/<frame>.json holds: the frame, its views without maps, and its files by relative path.
struct StoredFrame {
  FrameRecord frame;
  std::vector<View> views;  // ascending by camera
  std::map<std::string, FileRecord> files;
};
std::string record_text(const StoredFrame& stored);
StoredFrame record_from_text(const std::string& text, const std::string& file);  // InputError names the file

// One folder being made. Thread-safe where said. The journal is locked while it exists: a second process that opens
// the same folder gets a RunError.
class DatasetWriter {
 public:
  // Opens or resumes `folder`. Resuming reads the journal: frames in it are done, as long as their records and files
  // are there. Frames that the folder holds already, of another shard of the same dataset, are kept. InputError when
  // the folder holds a dataset of another scene or something else entirely; RunError when it cannot be written.
  DatasetWriter(std::filesystem::path folder, Manifest manifest, int threads);
  ~DatasetWriter();
  bool is_complete() const;                                                           // finished before; nothing to do
  bool is_done(int frame) const;                                                      // in the journal
  void write_rig(int animal, const std::filesystem::path& made_by_caller_temporary);  // a copy of that file
  void write_rig(int animal,
                 const std::function<void(const std::filesystem::path&)>& make);  // make() writes the .glb there
  void write_view(const View& view);      // thread-safe; encodes and writes every file of the view, keeps its record
  void write_pictures(const View& view);  // thread-safe; further maps of a view, which keep no record of their own
  void finish_frame(const FrameRecord&);  // thread-safe; after all its views: record, then journal line
  void adopt_frame(int frame, const std::string& record);  // thread-safe; for merging: its files are in place already
  void finish();  // keypoints.csv, parameters.cfg, manifest; removes the journal
 private:
  struct State;
  std::unique_ptr<State> state_;
};

// Joins shards of one dataset. InputError when they disagree, overlap with different bytes, or leave frames out.
void merge_datasets(const std::vector<std::filesystem::path>& shards, const std::filesystem::path& out,
                    bool allow_missing);

// 8-bit sRGB over the given linear background colour, from linear premultiplied RGBA. Rounds half up.
Image8 to_srgb8(const ImageF& rgba, const vec3& background);
// 8-bit NNOPCS as NePuMoo stores it: round(255 v), foreground components below half a step written as 1.
Image8 nnopcs_to_8bit(const ImageF& nnopcs, const ImageU32& silhouette);

}  // namespace moomill
