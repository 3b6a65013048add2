#pragma once
// From a scene to the maps of a view. Loads once what the chosen modalities need; a frame is then a pure function of
// (scene, seed, frame).
#include <atomic>
#include <memory>
#include <mutex>
#include <vector>

#include "generator/render/accel.h"
#include "generator/render/light.h"
#include "generator/render/path.h"
#include "generator/render/scene.h"
#include "generator/render/surface_light.h"
#include "scenes/scene.h"

namespace moomill {

// How often each stage ran: what a scene does not need stays at 0, and tests hold it to that.
struct StageCounts {
  std::atomic<std::uint64_t> species{0}, images{0}, coats{0}, finishes{0}, environments{0}, skins{0}, hierarchies{0}, first_hits{0},
      radiance{0}, coverage{0}, keypoints{0}, occlusion{0};
};

// The geometry of one frame; shared by frames whose poses are equal.
struct FrameGeometry {
  std::vector<std::vector<dmat4>> bones;  // per animal
  std::vector<std::vector<double>> morph_weights;
  std::vector<std::vector<dvec3>> keypoints;  // per animal, world metres
  std::vector<dmat4> placement;
  Scene scene;
  std::unique_ptr<Accel> accel;  // null when nothing is traced
  SkyShares sky;                 // empty where no light is asked for
};

struct Frame {
  int number = 0;
  std::shared_ptr<const FrameGeometry> geometry;
  std::vector<CameraRecord> cameras;
};

// A frame's animals in one batch of coats.
struct Dressed {
  Scene scene;
  std::vector<int> coats;  // indices
  std::shared_ptr<const SurfaceLight> light;  // where the scene asks for it
};

// For studies of the estimator: other samples of the same view.
struct Resampling {
  int samples = 0;               // per pixel; 0: the scene's, or those of target_error
  double target_error = 0;       // 0: the scene's
  std::uint64_t repetition = 0;  // 0: those of the dataset; any other number: samples independent of every other repetition's
  bool paths_only = false;       // without the surface's light
};

class Mill {
 public:
  // Loads species, coats and textures as far as the scene's modalities want them. InputError on anything unusable.
  explicit Mill(SceneSpec spec);
  ~Mill();

  const SceneSpec& spec() const { return spec_; }
  Manifest manifest() const;
  const Species& species(int animal) const;
  int animals() const { return static_cast<int>(spec_.animals.size()); }

  Frame prepare(int frame) const;                                  // thread-safe
  View trace(const Frame& frame, const CameraRecord& camera) const;  // all of a view; thread-safe
  // The same in parts, for more coats than fit into memory at once: the labels, and the pictures of one batch of coats
  // after the other. A coat's picture is the same in any batch.
  int batches() const;  // of coats; 0 where no light is asked for
  std::shared_ptr<const Dressed> dress(const Frame& frame, int batch) const;            // thread-safe
  View trace_labels(const Frame& frame, const CameraRecord& camera) const;              // thread-safe
  View trace_coats(const Frame& frame, const CameraRecord& camera, const Dressed& dressed,
                   const Resampling& resampling = {}) const;  // thread-safe
  // Samples per pixel, in the mean, that the scene's target error comes to in a view's picture: what trace_coats() would take. Thread-safe.
  double chosen_samples(const Frame& frame, const CameraRecord& camera, const Dressed& dressed) const;
  PixelMask lit_pixels(const Frame& frame, const CameraRecord& camera) const;           // in which something may be seen; thread-safe
  Lights lights(const Frame& frame, const CameraRecord& camera) const;                 // thread-safe
  FrameRecord record(const Frame& frame) const;
  const StageCounts& counts() const { return counts_; }

 private:
  struct Loaded;
  void composite(View& view, const CameraRecord& camera) const;
  PathOptions path_options(const Frame& frame, const CameraRecord& camera, const Dressed& dressed, const Resampling& resampling) const;

  SceneSpec spec_;
  mutable StageCounts counts_;
  std::unique_ptr<Loaded> loaded_;
  mutable std::mutex mutex_;  // of the caches below
  mutable std::shared_ptr<const FrameGeometry> last_geometry_;
};

}  // namespace moomill
