#pragma once
// The files of one view, encoded.
#include <string>
#include <vector>

#include "generator/dataset/dataset.h"

namespace moomill {

struct EncodedFile {
  std::string path;  // relative to the dataset
  std::vector<std::uint8_t> bytes;
};

// Every file that one map of the view becomes: one, or two for NNOPCS (float and 8-bit), none for record modalities.
std::vector<EncodedFile> encode_map(const Manifest& manifest, const View& view, const Map& map);

// The EXR of a float or id modality.
std::vector<std::uint8_t> encode_map_exr(const Map& map);

}  // namespace moomill
