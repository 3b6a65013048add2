#pragma once
// A scene file as plain data, and the readers of scene, species and coat files. What a frame is made of is drawn from
// it by frame_plan.cpp, as a pure function of (scene, seed, frame, camera).
#include <array>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "generator/core/data_root.h"
#include "generator/core/modality.h"
#include "generator/dataset/dataset.h"
#include "rigs/species.h"
#include "textures/coat.h"
#include "textures/finish.h"

namespace moomill {

// A value or a distribution over values, drawn per frame or per view, keyed by identity (seed, key path, frame,
// camera).
//   1.5   {uniform = [a, b]}   {normal = [mean, sigma], clamp = [a, b]}   {log_uniform = [a, b]}   {choose = [..]}
// each with an optional  per = "frame" (default) | "view".
struct Choice {
  enum class Kind { constant, uniform, normal, log_uniform, choose } kind = Kind::constant;
  bool per_view = false;
  std::vector<std::vector<double>>
      values;                      // constant: 1; uniform: lower, upper; normal: mean, sigma, [lower, upper]; choose: n
  std::vector<std::string> words;  // choose or constant over texts (file lists)
  std::string key;                 // dotted path in the scene file: part of the identity
  bool is_constant() const { return kind == Kind::constant; }
};

using Distribution = Choice;  // of numbers, vectors (componentwise) or texts

Distribution constant_number(double value);
Distribution constant_vector(const dvec3& value);
Distribution constant_text(const std::string& value);

// Draws. `camera` is ignored unless per_view. Same (seed, key, frame, camera): same value, in any order. A distribution
// without values draws 0 (or an empty text); a vector drawn from one number has it in all components.
double draw_number(const Distribution& d, std::uint64_t seed, int frame, int camera);
dvec3 draw_vector(const Distribution& d, std::uint64_t seed, int frame, int camera);
std::string draw_text(const Distribution& d, std::uint64_t seed, int frame, int camera);

struct ClipFrames {  // `count` frames spread evenly over a clip, its end left out (of a loop it equals the start)
  std::string clip;  // empty: the rig's first clip, or its neutral pose when it has none
  int count = 0;
  bool treadmill = false;  // take the clip's even advance out, keep the sway: the horizontal way from its first moment to
                           // its last, at constant speed
};
// A JSON file of poses: {"poses": [{"node": {"rotation": [x, y, z, w], "translation": [..], "scale": [..]}, ...},
// ...]}. A part left out is as in the neutral pose.
struct PoseFile {
  std::string file;
  std::shared_ptr<const Json> poses;  // the list, read once by read_scene()
};
struct PoseSampler {  // `count` poses within the species' joint limits
  int count = 0;
  double spread = 1;      // share of the limits in use
  bool on_ground = true;  // tilted and lowered until the lowest hooves stand on the ground
};
using PoseSource = std::variant<ClipFrames, PoseFile, PoseSampler>;

struct AnimalSpec {
  std::string key;      // "animals[0]": part of the identity of its sampled poses
  std::string species;  // name (rigs/<name>/<name>.toml) or a path to a species or rig file
  // Names (textures/<species>/<name>.toml), image files, or "own". Animals after the first have one coat (worn beside
  // every coat of the first) or as many as the first (worn index by index).
  std::vector<std::string> coats;
  // By coat, those drawn from a breed ({breed = "holstein", count = 1000, seed = 7}); empty where none is. Their names are
  // those of individuals ("holstein_000007").
  std::vector<std::optional<Individual>> individuals;
  const Individual* individual(std::size_t coat) const {
    return coat < individuals.size() && individuals[coat] ? &*individuals[coat] : nullptr;
  }
  std::vector<PoseSource> poses;  // in order; frame f takes the f-th pose; a single pose holds for all frames
  Distribution position;          // metres, on the ground
  Distribution yaw_deg;
  bool pose_in_place = true;  // drop the root's horizontal travel
};

struct RingCameras {
  int count = 8;                // azimuths per ring, the same on every ring
  Distribution radius;          // metres from the target axis, horizontally
  std::vector<double> heights;  // metres above the target, one per ring
  double first_azimuth_deg = 0;
};
struct ListedCamera {
  int id = 0;
  Distribution position;  // metres
  std::optional<Distribution> target;
};

struct CameraSpec {
  std::optional<RingCameras> rings;
  std::vector<ListedCamera> list;
  std::vector<int> only;  // ids to render, ascending; empty: all
  Distribution target;    // metres
  Distribution focal_mm;  // 100
  double sensor_mm = 36;  // width of the longer side
  int width = 1024, height = 768;
};

struct LightSpec {
  struct Sun {
    Distribution azimuth_deg, elevation_deg, irradiance, color, angular_diameter_deg;
  };
  struct Rectangle {
    Distribution position, target, radiance, color;
    double width = 1, height = 1;
  };
  Distribution environment_color;                // radiance of a constant environment
  std::optional<Distribution> environment_file;  // HDR map, instead of the constant
  Distribution environment_strength, environment_yaw_deg;
  std::vector<Sun> suns;
  std::vector<Rectangle> rectangles;
};

struct BackgroundSpec {
  enum class Kind { transparent, color, environment, image } kind = Kind::transparent;
  Distribution color;                 // linear; what 8-bit files show behind the animal (also for transparent: black)
  std::optional<Distribution> image;  // file list
};

struct GroundSpec {
  bool present = false;
  Distribution color, roughness;
  double size = 50;  // metres, side of the square at z = 0
};

struct RenderSpec {
  int samples = 64;  // per pixel
  double target_error = 0;  // relative; where it is not 0, samples follow from it (PathOptions::target_error)
  int max_bounces = 0;         // 0: no cap, unbiased (Russian roulette ends paths)
  double filter_radius = 1.5;  // pixels
  // Light gathered on the animals once per frame and looked up by all its views: faster, with a small bias. Off: pure paths.
  bool surface_light = false;
  int coat_resolution = 2048;
  // What baked coats and pictures in the making may take together, in MB (1e6 bytes), with two views in the making.
  // Coats that do not fit are baked again for every frame; no picture depends on it, so it is no part of a dataset.
  double memory_mb = 4000;
};

struct SceneSpec {
  std::string file;
  std::uint64_t seed = 0;
  Subset subset = Subset::main;
  ModalitySet modalities;
  int first_frame = 1;              // the number of pose 0
  std::vector<int> frames;          // as numbered, ascending
  std::vector<AnimalSpec> animals;  // the labelled one first
  std::vector<int> coat_indices;    // of the first animal's coats, those to render, ascending
  CameraSpec cameras;
  LightSpec light;
  BackgroundSpec background;
  GroundSpec ground;
  RenderSpec render;
  NnopcsNormalization normalization = NnopcsNormalization::box;
  Json resolved;  // the whole file with defaults filled in, for the manifest
};

SceneSpec read_scene(const std::filesystem::path& file);
bool is_scene_file(const std::filesystem::path& file);  // a TOML file with [[animals]]; species files have none

inline constexpr int largest_resolution = 16384;  // pixels a side
inline constexpr int largest_samples = 1 << 20;   // per pixel
inline constexpr double least_target_error = 1e-3;  // about what 4096 samples, the most, reach of an animal, by extrapolation from 256

// By name, as in the modality table, or "all"; InputError lists them and suggests the nearest.
ModalitySet modalities_from_names(const std::vector<std::string>& names);
std::vector<int> all_camera_ids(const CameraSpec& cameras);  // ascending, whatever `only` says

// What the command line may change. Frames are as numbered and inclusive; an empty list changes nothing.
struct Overrides {
  std::optional<int> first_frame, last_frame;
  std::vector<int> cameras, coats;
  std::vector<std::string> modalities;
  std::optional<std::pair<int, int>> resolution;  // width, height
  std::optional<int> samples;
  std::optional<bool> surface_light;
  std::optional<double> target_error;
};
void apply_overrides(SceneSpec& scene, const Overrides& overrides);  // InputError on what the scene does not have

// The scene with defaults filled in; what SceneSpec::resolved holds. Paths as written in the scene file (of absolute
// ones only the file name), so it says the same on every machine.
Json scene_to_json(const SceneSpec& scene);

// Calls visit(d) for every distribution of the scene.
// InputError where light is to be gathered once per frame and yet differs between its views, or has a cap on bounces.
void check_surface_light(const SceneSpec& scene);
void for_each_distribution(const SceneSpec& scene, const std::function<void(const Distribution&)>& visit);
// The values drawn for one frame, by key (per view: a list in the order of `cameras`), for FrameRecord::drawn.
Json drawn_values(const SceneSpec& scene, int frame, const std::vector<int>& cameras);

// Species file, or any rig file (then a species without keypoints named after it, standing centred on the ground).
Species read_species(const std::string& name_or_path, NnopcsNormalization normalization,
                     const std::filesystem::path& relative_to);

// The file a species name or path means; InputError names what there is. Names are those of rigs/<name>/<name>.toml
// under data_root(); anything with a slash or an extension is a path, relative to `relative_to` or else to data_root().
std::filesystem::path find_species(const std::string& name_or_path, const std::filesystem::path& relative_to);
// The file a coat name or path means, alike; empty for "own". `species`: by name or by path.
std::filesystem::path find_coat(const std::string& name_or_path, const std::string& species,
                                const std::filesystem::path& relative_to);
// Names of the coats that ship for a species, in the order of their index; empty when there are none.
std::vector<std::string> shipped_coats(const std::string& species);
// The file a path in a scene means: relative to the scene's folder, else to data_root(). InputError when it is absent.
std::filesystem::path find_file(const std::string& path, const std::filesystem::path& relative_to);

// Where cameras stand when a scene does not say: three rings around an animal of the size its species file expects, or
// of the size its rig has where there is no such word.
struct CameraFraming {
  dvec3 target{0, 0, 0.8};                     // metres
  double radius = 10.5;                        // metres, horizontally
  std::vector<double> heights{0.9, 3.8, 8.8};  // metres above the target: elevations of 5, 20 and 40 degrees
  double focal_mm = 100;
};
CameraFraming default_framing(const std::string& species, const std::filesystem::path& relative_to);

// The node a scene or species file means: its name, or "#12" for the rig's node of that index. InputError suggests the
// nearest name.
int find_joint(const Rig& rig, const std::string& reference);

Coat read_coat(const std::string& name_or_path, const std::string& species, const std::filesystem::path& relative_to);
// textures/<species>/finish.toml; where a species has none, the defaults, and of find_finish() an empty path.
Finish read_finish(const std::string& species);
std::filesystem::path find_finish(const std::string& species);

// All frames' poses of one animal, as the scene says (frame index 0-based: frame - first_frame). Pure. The placement
// stands the animal where position and yaw_deg say.
Pose pose_of_frame(const SceneSpec& scene, const AnimalSpec& spec, const Species& species, int frame_index);
int pose_count(const AnimalSpec& spec, const Species& species);

// The cameras of one frame, ascending by id, those of `only`. With constant distributions the same for all frames.
std::vector<CameraRecord> cameras_of_frame(const SceneSpec& scene, int frame);
// One camera at `centre` that looks at `target` without roll (Euler ry = 0), also straight up or down.
CameraRecord make_camera(int id, const dvec3& centre, const dvec3& target, double focal_mm, double sensor_mm, int width,
                         int height);
bool cameras_vary(const SceneSpec& scene);

}  // namespace moomill
