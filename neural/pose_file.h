#pragma once
// Poses, cameras and photographs that come in files of their own rather than in a dataset.
//
//   {"keypoints": [[x, y, z], ...],                    world metres, in the order of the model's keypoints
//    "camera": {"world_to_camera": [[4 numbers] x 3],  or 12 numbers in a row; OpenCV axes (x right, y down, z forward)
//               "fx", "fy", "cx", "cy": pixels, "width", "height": pixels}}
#include <torch/torch.h>

#include <filesystem>
#include <optional>

#include "neural/inference.h"

namespace moomill {

struct PoseFile {
  torch::Tensor keypoints;             // [K, 3]; undefined where the file has none
  std::optional<CameraRecord> camera;  // where the file has one
};
// InputError names file, key and mend: a wrong number of coordinates, NaN (null), a matrix that is no rotation, a size
// of nothing.
PoseFile read_pose_file(const std::filesystem::path& file);
// The camera of a pose file, or a file that is a camera object itself.
CameraRecord read_camera_file(const std::filesystem::path& file);

// The camera with another number of pixels on the same sensor.
CameraRecord resized(const CameraRecord& camera, int width, int height);

// A photograph with the silhouette of its animal.
struct Photo {
  torch::Tensor color;  // [3, h, w] sRGB in [0, 1]
  torch::Tensor mask;   // [h, w], 0 or 1
};
// mask: any picture of the same size; above half in its first channel is inside. InputError when sizes differ or it is
// empty.
Photo read_photo(const std::filesystem::path& picture, const std::filesystem::path& mask);

}  // namespace moomill
