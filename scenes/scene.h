#pragma once
// A scene file as plain data, and the readers of scene, species and coat files. What a frame is made of is drawn from
// it by frame_plan.cpp, as a pure function of (scene, seed, frame, camera).
#include <array>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "generator/core/modality.h"
#include "generator/dataset/dataset.h"
#include "rigs/species.h"
#include "textures/coat.h"

namespace moomill {

// A value or a distribution over values, drawn per frame or per view, keyed by identity (seed, key path, frame, camera).
//   1.5   {uniform = [a, b]}   {normal = [mean, sigma], clamp = [a, b]}   {log_uniform = [a, b]}   {choose = [..]}
// each with an optional  per = "frame" (default) | "view".
struct Choice {
  enum class Kind { constant, uniform, normal, log_uniform, choose } kind = Kind::constant;
  bool per_view = false;
  std::vector<std::vector<double>> values;  // constant: 1; uniform: lower, upper; normal: mean, sigma, [lower, upper]; choose: n
  std::vector<std::string> words;           // choose or constant over texts (file lists)
  std::string key;                          // dotted path in the scene file: part of the identity
  bool is_constant() const { return kind == Kind::constant; }
};

using Distribution = Choice;  // of numbers, vectors (componentwise) or texts

// Draws. `camera` is ignored unless per_view. Same (seed, key, frame, camera): same value, in any order.
double draw_number(const Distribution& d, std::uint64_t seed, int frame, int camera);
dvec3 draw_vector(const Distribution& d, std::uint64_t seed, int frame, int camera);
std::string draw_text(const Distribution& d, std::uint64_t seed, int frame, int camera);

struct ClipFrames {  // `count` frames spread evenly over a clip
  std::string clip;
  int count = 0;
};
struct PoseFile {  // a JSON file of poses: {"poses": [{"node": {"rotation": [x, y, z, w], "translation": [..]}, ...}, ...]}
  std::string file;
};
struct PoseSampler {  // `count` poses within the species' joint limits
  int count = 0;
  double spread = 1;  // share of the limits in use
};
using PoseSource = std::variant<ClipFrames, PoseFile, PoseSampler>;

struct AnimalSpec {
  std::string species;              // name (rigs/<name>/<name>.toml) or a path to a species or rig file
  std::vector<std::string> coats;   // names (textures/<species>/<name>.toml), image files, or "own"
  std::vector<PoseSource> poses;    // in order; frame f takes the f-th pose
  Distribution position;            // metres, on the ground
  Distribution yaw_deg;
  bool pose_in_place = true;        // drop the root's horizontal travel
};

struct RingCameras {
  int count = 8;                    // azimuths per ring, the same on every ring
  Distribution radius;              // metres from the target axis, horizontally
  std::vector<double> heights;      // metres above the target, one per ring
  double first_azimuth_deg = 0;
};
struct ListedCamera {
  int id = 0;
  Distribution position;            // metres
  std::optional<Distribution> target;
};

struct CameraSpec {
  std::optional<RingCameras> rings;
  std::vector<ListedCamera> list;
  Distribution target;              // metres
  Distribution focal_mm;            // 100
  double sensor_mm = 36;
  int width = 1024, height = 768;
};

struct LightSpec {
  struct Sun { Distribution azimuth_deg, elevation_deg, irradiance, color, angular_diameter_deg; };
  struct Rectangle { Distribution position, target, radiance, color; double width = 1, height = 1; };
  Distribution environment_color;       // radiance of a constant environment
  std::optional<Distribution> environment_file;  // HDR map, instead of the constant
  Distribution environment_strength, environment_yaw_deg;
  std::vector<Sun> suns;
  std::vector<Rectangle> rectangles;
};

struct BackgroundSpec {
  enum class Kind { transparent, color, environment, image } kind = Kind::transparent;
  Distribution color;                   // linear; what 8-bit files show behind the animal (also for transparent: black)
  std::optional<Distribution> image;    // file list
};

struct GroundSpec {
  bool present = false;
  Distribution color, roughness;
  double size = 50;                     // metres, side of the square at z = 0
};

struct RenderSpec {
  int samples = 64;                     // per pixel
  int max_bounces = 6;
  double filter_radius = 1.5;           // pixels
  int coat_resolution = 2048;
};

struct SceneSpec {
  std::string file;
  std::uint64_t seed = 0;
  Subset subset = Subset::main;
  ModalitySet modalities;
  int first_frame = 1;
  std::vector<int> frames;              // as numbered, ascending
  std::vector<AnimalSpec> animals;      // the labelled one first
  CameraSpec cameras;
  LightSpec light;
  BackgroundSpec background;
  GroundSpec ground;
  RenderSpec render;
  NnopcsNormalization normalization = NnopcsNormalization::box;
  Json resolved;                        // the whole file with defaults filled in, for the manifest
};

SceneSpec read_scene(const std::filesystem::path& file);

// Species file, or any rig file (then a species without keypoints named after it). `need_uv`, `need_images`: what the
// chosen modalities ask for; what they do not is dropped at once.
Species read_species(const std::string& name_or_path, NnopcsNormalization normalization, const std::filesystem::path& relative_to);

Coat read_coat(const std::string& name_or_path, const std::string& species, const std::filesystem::path& relative_to);

// Where data folders are: $MOOMILL_HOME, else the source tree the program was built from.
std::filesystem::path data_root();

// All frames' poses of one animal, as the scene says (frame index 0-based). Pure.
Pose pose_of_frame(const SceneSpec& scene, const AnimalSpec& spec, const Species& species, int frame_index);
int pose_count(const AnimalSpec& spec, const Species& species);

// The cameras of one frame, in order. With constant distributions the same for all frames.
std::vector<CameraRecord> cameras_of_frame(const SceneSpec& scene, int frame);
bool cameras_vary(const SceneSpec& scene);

}  // namespace moomill
