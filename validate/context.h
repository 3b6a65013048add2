#pragma once
// What the checks of all frames share, and one view as read from its files.
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "generator/core/image.h"
#include "generator/dataset/reader.h"
#include "validate/collector.h"
#include "validate/geometry.h"

namespace moomill {

// The mesh of one animal, with what its neutral pose says about NNOPCS.
struct AnimalMesh {
  Rig rig;
  std::vector<dvec3> neutral;          // metres, per vertex
  dvec3 scale{1}, shift{0};            // NNOPCS = metres * scale + shift
  std::unique_ptr<TriangleGrid> grid;  // over the neutral surface, in metres
};

struct Context {
  DatasetFolder dataset;
  Collector collector;
  std::vector<std::unique_ptr<AnimalMesh>> meshes;  // per animal; none where it cannot be used
  std::map<int, Pinhole> parameters;                // cameras of parameters.cfg
  std::map<int, std::vector<dvec3>> csv;            // keypoints.csv by frame
};

// One view; what the dataset does not have, or what cannot be read, is empty.
struct ViewData {
  const View* view = nullptr;
  const CameraRecord* camera = nullptr;
  Pinhole pinhole;
  Image8 silhouette, nnopcs8, instance;
  ImageF depth, nnopcs;  // depth: three planes interleaved, as in the file
  ImageU32 triangle;     // 1 + index
  ImageF barycentrics;   // of `triangle`
  bool foreground(std::size_t pixel) const { return silhouette.data[pixel] == 255; }
};

// The posed meshes of one frame, per animal; empty where they cannot be made.
using PosedMeshes = std::vector<std::optional<std::vector<dvec3>>>;

// dataset_checks.cpp: what does not belong to one frame. Fills the context.
void read_rigs(Context& context);
void check_tables(Context& context);
void check_manifest(Context& context);

// view_checks.cpp: the maps of one view.
ViewData load_view(const Context& context, const View& view, const CameraRecord& camera, Tally& tally);
void check_maps(const Context& context, const ViewData& data, Tally& tally);

// surface_checks.cpp: views against the posed meshes, keypoints and each other.
void check_keypoints(const Context& context, const StoredFrame& frame, const ViewData& data, Tally& tally);
void check_surface(const Context& context, const PosedMeshes& meshes, const ViewData& data, Tally& tally);
void check_two_views(const Context& context, const ViewData& a, const ViewData& b, Tally& tally);

}  // namespace moomill
