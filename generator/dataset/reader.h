#pragma once
// A dataset as its readers see it (validate, preview, merge, export, training): everything through the manifest's path
// templates, nothing through the layout code.
#include <filesystem>
#include <string>
#include <vector>

#include "generator/dataset/dataset.h"

namespace moomill {

struct DatasetFolder {
  std::filesystem::path folder;
  Manifest manifest;  // held_frames is filled in
  Json json;          // manifest.json itself

  // Absolute paths. InputError when the manifest has no template for it.
  std::filesystem::path file(Modality modality, int frame, int camera, int coat = -1, int animal = -1) const;
  std::filesystem::path nnopcs8(int frame, int camera) const;
  std::filesystem::path record(int frame) const;
  std::filesystem::path keypoints_csv() const;
  std::filesystem::path parameters_cfg() const;
  std::string template_of(const std::string& name, const std::string& key = {}) const;  // empty when there is none
};

// InputError when there is no finished dataset.
DatasetFolder open_dataset(const std::filesystem::path& folder);

StoredFrame read_frame(const DatasetFolder& dataset, int frame);

// manifest_identity() as the program wrote it that made the dataset.
Json identity_of(const DatasetFolder& dataset);

// Cameras of a frame: the frame's own when they vary, else the manifest's.
const std::vector<CameraRecord>& cameras_of(const DatasetFolder& dataset, const StoredFrame& frame);

inline constexpr const char* manifest_name = "manifest.json";
inline constexpr const char* journal_name = "journal.txt";  // exists while a dataset is being made

}  // namespace moomill
