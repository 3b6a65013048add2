#pragma once
// Texture codes of views, and files of them: NAME.npy (NumPy, float32 [N, z], row-major) beside NAME.jsonl, whose first
// line is a header object ("format", "codes", "features", "model", "dataset", "cameras") and whose further lines are
// one view each, in the rows' order: {"frame", "camera", "coat", "name"}. frame, camera, coat -1: unknown (a photo).
#include <torch/torch.h>

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "neural/inference.h"

namespace moomill {

struct CodeSet {
  torch::Tensor codes;             // [N, z] float
  std::vector<ViewId> views;       // N
  std::vector<std::string> names;  // N: whose coat it is; may be empty strings
  std::string model, dataset;      // where they come from
  std::string cameras;             // equal where camera numbers mean the same cameras: a hash of their matrices
};

// Writes both files; `file` ends in .npy (InputError otherwise).
void write_codes(const std::filesystem::path& file, const CodeSet& set);
CodeSet read_codes(const std::filesystem::path& file);  // InputError names the file and what is wrong

struct EmbedOptions {
  bool true_maps = false;  // mask and NNOPCS of the dataset instead of the model's own
  RefineOptions refine;
  std::function<void(int done, int all)> progress;
  std::function<bool()> stop;  // asked between views; true: leaves off
};

// Codes (means) of the given frames and cameras in all coats of the source, by view and then coat.
CodeSet embed(Model& model, const SampleSource& source, const std::vector<ViewId>& views, const EmbedOptions& options);

}  // namespace moomill
