#pragma once
// The commands of netepu that use a trained model, without the command line around them. Each throws InputError or
// RunError and returns the exit status otherwise: 0, or 1 where a figure misses its bound and the command says that
// this fails.
#include <cstddef>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "neural/networks.h"

namespace moomill {

// What the program around a command lends it; all may be empty.
struct CommandTools {
  std::function<void(std::size_t done, std::size_t total, const std::string& stage)> progress;
  std::function<bool()> stop;                          // asked now and then; true: leave off and keep what is done
  std::function<void(const std::string& text)> print;  // results, to stdout
};

// Of every command: the model and how it is evaluated.
struct ModelChoice {
  std::filesystem::path model;  // checkpoint
  bool plain = false;           // straightforward LibTorch instead of the fused operators
  std::string precision =
      "float32";  // or "bfloat16", of the second layers' products; InputError where the processor has none
};

// What --plain and --precision ask for. InputError where they contradict each other or the processor cannot.
Evaluation evaluation_of(bool plain, const std::string& precision);

// A dataset, and what of it.
struct DatasetChoice {
  std::filesystem::path dataset;
  std::filesystem::path cache;  // packed samples; empty: beside the dataset
  std::vector<int> coats;       // empty: all the dataset holds
  std::string split = "test";   // train, validate, test, or all
  int every_frame = 1, every_camera = 1;
  int max_views = 0;  // frame and camera pairs; 0: all
};

// A picture of an animal whose texture is wanted, instead of a dataset's view.
struct PhotoChoice {
  std::filesystem::path picture, mask;
  std::filesystem::path pose;  // JSON of pose_file.h with keypoints and camera
};

// netepu render: silhouette, depth, NNOPCS and colour of one pose before one camera. Writes into a folder: mask.png,
// depth.exr (metres, 0 outside), nnopcs.png (8 bits), nnopcs.exr (float), color.png (RGBA, the silhouette is the
// alpha).
struct RenderCommand {
  ModelChoice model;
  std::filesystem::path out;
  std::filesystem::path dataset, cache;        // where frame, camera and coat are numbers of a dataset
  std::optional<int> frame;                    // the pose: of this frame ...
  std::filesystem::path pose;                  // ... or of this file
  std::optional<int> camera;                   // the camera: of the dataset ...
  std::filesystem::path camera_file;           // ... or of this file ...; else the one in the pose file
  int width = 0, height = 0;                   // pixels; 0: the camera's own
  std::optional<int> coat;                     // the texture: of the dataset's view with this coat ...
  std::optional<int> coat_frame, coat_camera;  // ... in this frame and from this camera (default: the rendered ones)
  PhotoChoice photo;                           // ... or of a photograph ...
  std::filesystem::path code;                  // ... or a code of a file that `embed` wrote,
  int code_row = 0;                            // this row of it. None of them: no colour.
  int mask_cell = 0, surface_cell = 1;         // grids in pixels (RefineOptions)
  bool every_pixel = false;                    // the full evaluation instead of coarse to fine
};
int run_render(const RenderCommand& command, const CommandTools& tools = {});

// netepu eval: figures of reconstruction on a split, as results.json, summary.json, table.md, nnopcs.png, coats<n>.png.
struct EvalCommand {
  ModelChoice model;
  DatasetChoice data;
  std::filesystem::path out;  // folder; empty: the table alone is printed
  bool geometry_only = false;
  bool true_codes = false;    // texture codes from the true silhouette and NNOPCS
  int code_camera_shift = 0;  // texture codes from the picture of so many cameras further on
  int pictures = 6;
  bool enforce = false;  // exit status 1 where a figure misses its bound
};
int run_eval(const EvalCommand& command, const CommandTools& tools = {});

// netepu embed: texture codes of a dataset's views, or of one photograph, to NAME.npy and NAME.jsonl.
struct EmbedCommand {
  ModelChoice model;
  DatasetChoice data;  // data.dataset empty: the photo
  PhotoChoice photo;
  std::string photo_name;     // whose it is, where that is known
  std::filesystem::path out;  // ends in .npy
  bool true_maps = false;     // the dataset's silhouette and NNOPCS instead of the model's own
  int surface_cell = 4;       // grid of NNOPCS in pixels; 1: every pixel
};
int run_embed(const EmbedCommand& command, const CommandTools& tools = {});

// netepu identify: names the individual of every query code by its nearest gallery code, and where the queries' coats
// are known, says how often that is right: results.json, summary.json, table.md, and names.jsonl with a line per query.
struct IdentifyCommand {
  std::filesystem::path queries, gallery;  // .npy of embed; gallery empty: the queries themselves
  // Codes of the training split: what scatters among views of one coat then counts for less (scatter_normalisation); empty: as embedded.
  std::filesystem::path calibrate;
  std::filesystem::path out;               // folder; may be empty
  // Or cosine: on the shipped model 99.99 and 100.00 % of its own coats, 33.4 and 32.4 % of strangers (neural/results/).
  std::string distance = "euclidean";
  bool enforce = false;
};
int run_identify(const IdentifyCommand& command, const CommandTools& tools = {});

// netepu speed: re-identified views a second, and what the shortcuts change. Without a model: random weights of a
// configuration.
struct SpeedCommand {
  ModelChoice model;  // model.model empty: random weights of `config`
  std::filesystem::path config;
  DatasetChoice data;  // poses, cameras, pictures; one coat is enough
  int width = 1024, height = 768;
  int views = 5, repeats = 3;
  int surface_cell = 8;
  std::filesystem::path out;  // folder; may be empty
};
int run_speed(const SpeedCommand& command, const CommandTools& tools = {});

}  // namespace moomill
