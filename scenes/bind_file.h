#pragma once
// The keypoint file of `moomill rig bind`, and the species file that makes its result usable in a scene. What the keys
// mean: rigs/scans/README.md.
#include <filesystem>
#include <string>
#include <vector>

#include "rigs/bind.h"

namespace moomill {

// Reads the keypoints, binds the mesh to the species they name and gives it the species' motion. InputError names the file, the
// place in it and the mend.
BoundScan bind_scan_file(const std::filesystem::path& mesh, const std::filesystem::path& keypoints);

// A species file for a rig that lies beside it: skeleton, keypoints, limits and legs of the bound scan.
std::string bound_species_toml(const BoundScan& bound, const std::string& name, const std::string& rig_file,
                               const std::string& made_from);

}  // namespace moomill
