#pragma once
// Models and training states on disk. One file: a magic line, a JSON header (configuration, stage, scalars, name, shape and place
// of every tensor), then the tensors' bytes. Written atomically; a file cut short or of another configuration is refused.
#include <torch/torch.h>

#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "neural/networks.h"

namespace moomill {

// Named tensors and a header, as they lie in the file. Tensors are float32, float16 or int64.
struct TensorFile {
  nlohmann::json header;  // what the writer put there
  std::map<std::string, torch::Tensor> tensors;
};
void write_tensor_file(const std::filesystem::path& file, const TensorFile& contents);
TensorFile read_tensor_file(const std::filesystem::path& file);  // InputError where it is none, or cut short

// A trained model. Geometry is always there; texture is empty where only the geometry was trained.
struct Model {
  NetepuConfig config;
  GeometryNetwork geometry{nullptr};
  TextureNetwork texture{nullptr};
  std::vector<std::string> coat_names;  // that the texture was trained on
  nlohmann::json provenance;            // dataset, epochs and minutes of training, as the trainer put it
};

// half: weights as float16 (shipping); they are float32 again after loading.
void save_model(const std::filesystem::path& file, const Model& model, bool half);
Model load_model(const std::filesystem::path& file);  // in evaluation mode; InputError names the file

// Parameters and buffers of a module under a prefix, to and from a tensor map. Restoring refuses (InputError) a missing tensor or
// another shape: the file is of another configuration.
void store_module(const torch::nn::Module& module, const std::string& prefix, bool half,
                  std::map<std::string, torch::Tensor>& tensors);
void restore_module(torch::nn::Module& module, const std::string& prefix, const std::map<std::string, torch::Tensor>& tensors,
                    const std::string& file);

}  // namespace moomill
