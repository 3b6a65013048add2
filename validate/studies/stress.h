#pragma once
// Numerical stability: what the mill computes where it hurts, case by case, each held against an oracle.
//
// To add a case: one StressCase in the file of its group (stress_<group>.cpp). The runner, the tables, the command and
// the tests follow from it. A case runs the product's own code; only its oracle is computed here, by other means.
#include <atomic>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "validate/studies/study.h"

namespace moomill {

struct StressOptions {
  std::uint64_t edge_rays = 10'000'000;  // of each case that hunts for cracks
  std::string group;                     // only this one; empty: all
  const std::atomic<bool>* stop = nullptr;  // set: RunError before the next case
};

// How the right answer is known.
enum class Oracle : std::uint8_t {
  analytic,         // a formula
  high_precision,   // the same quantity in double or long double, by another algorithm
  exact_predicate,  // a property that holds or does not; the error counts where it does not
};
const char* name(Oracle oracle);

struct StressCase {
  std::string name;  // unique within its group
  std::string what;  // what is done to what
  Oracle oracle{};
  double allowed = 0;
  std::string unit;                                     // of error and bound; empty: relative
  std::string why;                                      // why this is the right bound
  std::function<double(const StressOptions&)> measure;  // the error; throwing, or not finite, is out of bounds
};

struct StressOutcome {
  StressCase what;
  std::string group;
  double error = 0;
  double seconds = 0;   // of processor time, all threads together
  std::string failure;  // what was thrown
  bool holds() const { return failure.empty() && error <= what.allowed; }
};

// The groups in the order of the table, and the cases of one. InputError where there is no such group.
const std::vector<std::string>& stress_groups();
std::vector<StressCase> stress_cases(const std::string& group);

// Runs the cases of a group, or all, one after the other; each may use all threads.
std::vector<StressOutcome> run_stress(const StressOptions& options);

// A figure per case with its bound, the number of cases, and a table by groups.
StudyResult stress_study(const std::vector<StressOutcome>& outcomes);

// stress.csv and stress.md: every case in full. Beside what write_study() writes.
void write_stress(const std::vector<StressOutcome>& outcomes, const std::filesystem::path& folder);

// Each in its one file.
std::vector<StressCase> geometry_stress();
std::vector<StressCase> edge_stress();
std::vector<StressCase> skinning_stress();
std::vector<StressCase> light_stress();
std::vector<StressCase> surface_light_stress();
std::vector<StressCase> sampling_stress();
std::vector<StressCase> keypoint_stress();
std::vector<StressCase> statistics_stress();

}  // namespace moomill
