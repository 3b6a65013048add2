#pragma once
// What a dataset is, for training: frames, cameras, keypoints and where the pictures lie. Known from the manifest, or,
// for a dataset in the nepumoo layout from elsewhere, from keypoints.csv, parameters.cfg and the names of folders. No
// pictures are read here.
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "generator/core/math.h"
#include "generator/dataset/dataset.h"

namespace moomill {

struct DatasetSource {
  std::filesystem::path folder;
  int width = 0, height = 0;                       // pixels, of every view
  std::vector<int> frames;                         // as numbered, ascending
  Splits splits;                                   // of those frames
  std::vector<std::vector<CameraRecord>> cameras;  // one list for all frames, or one per frame; the same ids in each
  std::vector<int> camera_ids;
  std::vector<std::vector<dvec3>> keypoints;       // per frame, world metres
  std::vector<std::pair<int, std::string>> coats;  // index and name of every coat there is
  std::string mask_template, depth_template;
  std::string nnopcs_template;              // empty: none
  std::vector<std::string> coat_templates;  // parallel to coats
  double reader_radius = 1.5;               // metres
  bool has_records = false;                 // with a manifest; they tell of every picture
  std::string
      identity;  // changes with masks, depth and NNOPCS, and, where there are records, with the pictures of the coats

  const CameraRecord& camera(int frame_at, int camera_at) const {
    return cameras[cameras.size() == 1 ? 0 : frame_at][camera_at];
  }
  std::filesystem::path path(const std::string& path_template, int frame, int camera) const {
    return folder / expand_template(path_template, frame, camera);
  }
  int coat_at(int coat) const;  // place in coats; InputError where there is no such coat
};

// InputError, in one sentence, when the folder holds no dataset or lacks masks, depth or keypoints.
DatasetSource read_dataset_source(const std::filesystem::path& folder);

// Changes with the pictures of a coat, as far as source.identity does not.
std::string coat_identity(const DatasetSource& source, int coat_at);

std::vector<int> coats_of_dataset(const std::filesystem::path& dataset);  // indices of all it holds, ascending

// Whether camera (ring, a + 1) sees a world turned by 45 degrees about the Z axis through the origin as camera (ring,
// a) saw it before, on rings of eight, to a tenth of a millimetre. Says what is wrong, or is empty.
std::string why_not_rings(const DatasetSource& source);

}  // namespace moomill
