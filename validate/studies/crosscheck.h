#pragma once
// The same frame by Blender's Cycles: exported, rendered by validate/blender/crosscheck.py, compared.
//
// What is exported is a folder of scene.json and raw little-endian arrays beside it: per instance positions, normals,
// uvs, colors, nnopcs (float32, [vertices, 2 or 3]; positions relative to `origin`), faces (uint32, [triangles, 3]),
// face_materials and parts (uint16, [triangles]); textures as the 8-bit values they are (uint8, [height, width,
// channels], top row first; colours are sRGB); environment maps as linear floats times their strength. Cameras are
// OpenCV's, their world_to_camera relative to the origin. Everything else in scene.json has the names and units of
// render/scene.h and light.h.
#include <atomic>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "generator/core/image.h"
#include "scenes/runner.h"
#include "validate/studies/study.h"

namespace moomill {

// What the animals are made of in the comparison of colours.
enum class CheckedSurface {
  diffuse,  // Lambert's matt surface in the coat's colours, no normal map: no model to disagree about
  full,     // as the scene has it
};
const char* name_of(CheckedSurface surface);

// The dressed scene with its surfaces made so.
Dressed with_surface(const Dressed& dressed, CheckedSurface surface);

// Writes a frame, the cameras it holds and one batch of coats into the folder. Returns a hash of all that it wrote,
// names and bytes: equal for exports that are equal byte for byte.
std::string export_crosscheck(const Mill& mill, const Frame& frame, const Dressed& dressed,
                              const std::filesystem::path& folder);

// --- comparison; knows maps, not renderers ---

struct LabelMaps {
  int width = 0, height = 0;
  std::vector<std::uint32_t> animal;  // 0: none, else 1 + its index
  std::vector<float> depth;           // metres, camera z
  std::vector<float> nnopcs;          // 3 per pixel
};

// A segment of an outline in pixels.
struct OutlineSegment {
  dvec2 a{0}, b{0};
};
// Outlines of the animals in a view: edges with one triangle, or with one that faces the camera and one that does not,
// projected in double from the camera matrix as recorded. Edges that reach behind the camera are left out.
std::vector<OutlineSegment> outlines_in_view(const Scene& scene, const CameraRecord& camera);
double distance_to_outline(const dvec2& pixel, const std::vector<OutlineSegment>& outlines);

struct LabelDifference {
  std::uint64_t pixels = 0;       // where either sees an animal
  std::uint64_t differing = 0;    // one sees an animal where the other sees none or another
  std::uint64_t unexplained = 0;  // of those, with their centre farther than 0.01 pixels from every outline
  double farthest = 0;            // pixels, of the differing ones
  std::uint64_t compared = 0;     // where both see the same animal
  std::uint64_t depth_off = 0, nnopcs_off = 0;  // of those, off by more than 1e-4 (metres; any coordinate)
  double depth_worst = 0, nnopcs_worst = 0;
  double depth_median = 0, nnopcs_median = 0;
};
inline constexpr double label_tolerance = 1e-4, outline_tolerance = 0.01;
LabelDifference compare_labels(const LabelMaps& ours, const LabelMaps& theirs,
                               const std::vector<OutlineSegment>& outlines);

// What pixel-centre rays meet first, in double and by trying every triangle that covers the pixel: no hierarchy, no
// camera and no intersection of the renderer's. Takes surfaces for whole, so it is for scenes without cut-outs. The
// scene must outlive it.
class ExactView {
 public:
  ExactView(const Scene& scene, const CameraRecord& camera);
  struct Hit {
    std::uint32_t animal = 0;  // 0: none, else 1 + its index
    double depth = 0;          // metres, camera z
    dvec3 nnopcs{0};
    dvec3 normal{0}, geometric{0},
        eye{0};  // camera axes, unit: interpolated, of the triangle (on the eye's side), towards the eye
  };
  Hit first_hit(int x, int y) const;

 private:
  struct Triangle {
    dvec3 a, b, c;  // metres, camera axes
    const Instance* instance = nullptr;
    std::uint32_t index = 0;
  };
  CameraRecord camera_;
  std::vector<Triangle> triangles_;
  int tiles_x_ = 0, tiles_y_ = 0;
  std::vector<std::vector<std::uint32_t>> tiles_;  // triangles whose bounding rectangle touches a tile of the picture
};

// Whether Cycles bends the interpolated normal there: it does so wherever the eye's mirror image would leave under the
// triangle (R = 2 (N.I) N - I with R.Ng below the smaller of 0.01 and 0.9 Ng.I), for matt surfaces too; moomill takes
// the normal as it is.
bool bent_by_cycles(const ExactView::Hit& hit);
// Pixels within two of one where it does, row by row.
std::vector<bool> bent_pixels(const ExactView& exact, int width, int height);

// Ours and theirs against double precision: at every pixel where they are off from each other by more than the
// tolerance, and at some of the others, evenly spread.
struct LabelJudgement {
  std::uint64_t off = 0;                                   // where they are off from each other, in depth or NNOPCS
  std::uint64_t off_ours_right = 0, off_theirs_right = 0;  // of those, within the tolerance of the double-precision hit
  std::uint64_t judged = 0;                                // these and the others
  double our_depth = 0, their_depth = 0;                   // worst, metres
  double our_nnopcs = 0, their_nnopcs = 0;                 // worst coordinate
};
LabelJudgement judge_labels(const LabelMaps& ours, const LabelMaps& theirs, const ExactView& exact, int others = 400);

struct ColorDifference {
  dvec3 ours{0}, theirs{0};       // mean linear colour over the pixels where either has alpha
  double worst_mean = 0;          // largest relative difference of the three means
  double alpha = 0;               // relative difference of the mean alpha
  double rms = 0;                 // of the pixels' difference, relative to the mean luminance
  double left_out = 0;            // share of the pixels that blocks leave out
  double worst_mean_without = 0;  // worst_mean without them
  double block_worst = 0;  // largest difference of means over blocks of 16 x 16 pixels, relative to the mean luminance
  double block_rms = 0;    // alike, root mean square over blocks
};
// 4 channels, premultiplied. Blocks leave out the pixels so marked; means do not.
ColorDifference compare_colors(const ImageF& ours, const ImageF& theirs, const std::vector<bool>& leave_out = {});

// Ours, theirs and the difference side by side: colours as sRGB; the difference times `gain` around middle grey.
Image8 difference_sheet(const ImageF& ours, const ImageF& theirs, double gain);
// Ours, theirs, and where they differ: depth by up to 1e-4 m, NNOPCS by up to 1e-4 (red is more), other silhouettes
// white.
Image8 label_sheet(const LabelMaps& ours, const LabelMaps& theirs);

// --- the whole ---

struct CrosscheckOptions {
  std::filesystem::path out;
  std::string blender = "blender";  // program, by name or path
  std::optional<int> frame;         // default: the scene's first
  int label_scale = 3;              // odd: how much finer Cycles' labels are rendered, of which the middle pixels count
  int threads = 0;                  // of Blender; 0: all
  std::vector<int> timing_samples;  // with any: no comparison but timed renders of Blender's own material, at each
  int reference_samples =
      0;  // of the timed renders' errors; 0: errors stay empty. Those in the folder are kept, see below
  const std::atomic<bool>* stop = nullptr;  // set: Blender is ended, RunError
};
// Exports, renders both, compares. Writes crosscheck.csv (a row per view, coat and surface), crosscheck.md and pictures
// into the folder; the result is for finish_study(). InputError when there is no Blender.
StudyResult crosscheck(const SceneSpec& scene, const CrosscheckOptions& options);

// Renders every exported view and coat with Blender's own material and writes convergence.csv in converge's columns.
// Beside each picture lies FILE.json with a hash of what it was made from (export, scripts, version of Blender); a
// reference whose hash is still right is kept instead of rendered again, so that a run which was stopped goes on where
// it was.
StudyResult time_cycles(const SceneSpec& scene, const CrosscheckOptions& options);

// Where a program is: a path as it is, a name on PATH; empty when it is not there.
std::filesystem::path find_program(const std::string& name);

}  // namespace moomill
