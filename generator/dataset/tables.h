#pragma once
// The two text files that the public loader reads beside the pictures.
#include <string>
#include <vector>

#include "generator/dataset/dataset.h"

namespace moomill {

std::string keypoints_csv_header(const Manifest& manifest);  // "frame,nose_x,nose_y,nose_z,..." and a newline
std::string keypoints_csv_row(int frame,
                              const std::vector<dvec3>& keypoints);  // shortest text that reads back the same
std::string parameters_cfg(const Manifest& manifest, const std::vector<CameraRecord>& cameras);

}  // namespace moomill
