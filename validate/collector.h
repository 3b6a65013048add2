#pragma once
// The list of checks, and the place where threads put what they compared.
#include <array>
#include <mutex>

#include "validate/checks.h"

namespace moomill {

// Every check of validate_dataset(), in the order of the report. To add one: a value here, a row in collector.cpp, and
// the code that feeds it; tests/validate/corruption.cpp wants a corruption that it catches.
enum class Check {
  files,
  sizes,
  frames,
  splits,
  rigs,
  silhouette_values,
  silhouette_depth,
  silhouette_nnopcs8,
  silhouette_nnopcs,
  silhouette_labels,
  depth_planes,
  nnopcs_half_step,
  nnopcs_zero,
  label_values,
  occlusion,
  keypoints_csv,
  parameters,
  euler_y,
  camera_symmetry,
  keypoints_matrix,
  keypoints_parameters,
  visibility,
  surface_nnopcs,
  surface_pixel,
  surface_depth,
  two_views,
  count,
};

// What one thread compared in one go. Added to the collector at its end.
class Tally {
 public:
  void compared(Check check, std::uint64_t things = 1);
  void worst(Check check, double deviation);
  void failed(Check check, std::string sentence);  // one failure; the first ones keep their sentence
  // One comparison of a deviation against a bar.
  template <class Sentence>
  void within(Check check, double deviation, double bar, const Sentence& sentence) {
    compared(check);
    worst(check, deviation);
    if (!(deviation <= bar)) failed(check, sentence());
  }

 private:
  friend class Collector;
  struct Entry {
    std::uint64_t tested = 0, failures = 0;
    double worst = 0;
    std::vector<std::string> sentences;
  };
  std::array<Entry, static_cast<std::size_t>(Check::count)> entries_;
};

class Collector {
 public:
  // Tallies of a frame are kept apart until the end, so that the report does not depend on threads.
  void add(int frame, Tally tally);
  void note(Check check, std::string why);
  std::vector<CheckResult> results() const;

 private:
  mutable std::mutex mutex_;
  std::vector<std::pair<int, Tally>> tallies_;
  std::array<std::string, static_cast<std::size_t>(Check::count)> notes_;
};

}  // namespace moomill
