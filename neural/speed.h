#pragma once
// How many views a second netepu re-identifies: silhouette and NNOPCS rendered from the pose, the masked picture
// encoded.
#include <filesystem>
#include <string>
#include <vector>

#include "neural/inference.h"
#include "neural/report.h"

namespace moomill {

struct SpeedOptions {
  int width = 1024, height = 768;
  int views = 5;         // of the test split (or whichever has frames), spread evenly
  int repeats = 3;       // of every view; the median of all is reported
  int surface_cell = 8;  // of the interpolated variant
  // An untrained model has no silhouette. Then the network is asked at the points that the dataset's own silhouette and
  // NNOPCS would have it asked at, which costs the same; differences of NNOPCS mean nothing and are left out.
  bool untrained = false;
};

struct SpeedVariant {
  std::string name;
  Precision precision = Precision::float32;
  int mask_cell = 0, surface_cell = 1;
  double seconds = 0;           // median of a view, all stages
  double geometry_seconds = 0;  // median of its pose, silhouette and NNOPCS
  double points = 0;            // evaluated a view, mean
  MapDifference difference;     // to every pixel in float32: means are means over views, maxima maxima
};

struct SpeedResult {
  std::string model, dataset;
  int width = 0, height = 0, threads = 0, views = 0;
  bool untrained = false;
  std::vector<SpeedVariant> variants;
};
// Variants: every pixel; coarse to fine; with interpolation; both of these in bfloat16 where the processor has it. No
// depth: codes need none.
SpeedResult measure_speed(Model& model, const SampleSource& source, const SpeedOptions& options);

std::vector<Measure> measures_of(const SpeedResult& result);
nlohmann::json to_json(const SpeedResult& result);
std::string markdown(const SpeedResult& result);
void write_speed(const SpeedResult& result, const std::filesystem::path& folder);

}  // namespace moomill
