#pragma once
// `moomill validate DIR`: re-derives every invariant of a written dataset from the files alone. Never calls the
// renderer's camera code, or it would agree with the renderer's mistakes.
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

namespace moomill {

struct CheckResult {
  std::string name;                   // "silhouette = support of depth"
  std::uint64_t tested = 0;           // how many things were compared
  std::vector<std::string> failures;  // one sentence each; at most 20 kept
  std::uint64_t failure_count = 0;
  double worst = 0;  // largest deviation seen, in `unit`
  std::string unit;
  std::string note;  // why nothing could be compared, where tested is 0
  bool passed() const { return failure_count == 0; }
};

// All checks, also those that compared nothing (tested is 0, note says why). `progress(done, total)` is called after
// every frame, from any thread but never from two at once. Throws InputError when the folder holds no dataset at all.
std::vector<CheckResult> validate_dataset(const std::filesystem::path& folder,
                                          const std::function<void(std::size_t, std::size_t)>& progress = {});

}  // namespace moomill
