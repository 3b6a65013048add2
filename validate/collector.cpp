#include "validate/collector.h"

#include <algorithm>
#include <cmath>

namespace moomill {
namespace {

constexpr std::size_t sentences_kept = 20;

struct Row {
  const char* name;
  const char* unit;
};

constexpr Row rows[] = {
    {"every file of every frame is there, with its size and hash", ""},
    {"images have the size of their camera", ""},
    {"every frame has its record, its views and its keypoints", ""},
    {"frames count from 1 upwards and every one is in one split", ""},
    {"rig files have their hash", ""},
    {"silhouette has one channel of 0 and 255", ""},
    {"silhouette = support of depth", ""},
    {"silhouette = support of 8-bit NNOPCS", ""},
    {"float NNOPCS lies in [0, 1] and only inside the silhouette", ""},
    {"silhouette = support of normal, part, instance and triangle", ""},
    {"depth has three equal channels of finite metres", ""},
    {"8-bit NNOPCS is the float one within half a step", "steps of 1/255"},
    {"8-bit NNOPCS never has a 0 in the foreground", ""},
    {"labels keep to their values", ""},
    {"visible mask lies in the whole mask, and counts are those of the record", "pixels"},
    {"keypoints.csv has its header and the records' positions", "m"},
    {"parameters.cfg gives the manifest's cameras", "px"},
    {"cameras have no Y angle", "rad"},
    {"ring cameras map to their neighbours by 45 degrees about Z", "m"},
    {"2D keypoints = 3D keypoints through world_to_camera", "px"},
    {"2D keypoints = 3D keypoints through parameters.cfg", "px"},
    {"keypoint visibility follows from the depth map", ""},
    {"NNOPCS of a pixel = that of its triangle and barycentrics", "[0, 1]"},
    {"surface point of a pixel's NNOPCS reprojects to the pixel", "px"},
    {"surface point of a pixel's NNOPCS has the pixel's depth", "m"},
    {"a surface point is the same in two views", "m"},
};
static_assert(std::size(rows) == static_cast<std::size_t>(Check::count));

}  // namespace

void Tally::compared(Check check, std::uint64_t things) {
  entries_[static_cast<int>(check)].tested += things;
}

void Tally::worst(Check check, double deviation) {
  Entry& e = entries_[static_cast<int>(check)];
  if (std::isnan(deviation)) deviation = std::numeric_limits<double>::infinity();
  e.worst = std::max(e.worst, deviation);
}

void Tally::failed(Check check, std::string sentence) {
  Entry& e = entries_[static_cast<int>(check)];
  ++e.failures;
  if (e.sentences.size() < sentences_kept) e.sentences.push_back(std::move(sentence));
}

void Collector::add(int frame, Tally tally) {
  std::lock_guard lock(mutex_);
  tallies_.emplace_back(frame, std::move(tally));
}

void Collector::note(Check check, std::string why) {
  std::lock_guard lock(mutex_);
  std::string& note = notes_[static_cast<int>(check)];
  if (note.empty() || why < note) note = std::move(why);  // the same one whatever thread came first
}

std::vector<CheckResult> Collector::results() const {
  std::lock_guard lock(mutex_);
  std::vector<const std::pair<int, Tally>*> sorted;
  for (const auto& tally : tallies_) sorted.push_back(&tally);
  std::stable_sort(sorted.begin(), sorted.end(), [](const auto* a, const auto* b) { return a->first < b->first; });
  std::vector<CheckResult> out;
  for (std::size_t i = 0; i < std::size(rows); ++i) {
    CheckResult& r = out.emplace_back();
    r.name = rows[i].name;
    r.unit = rows[i].unit;
    for (const auto* tally : sorted) {
      const Tally::Entry& e = tally->second.entries_[i];
      r.tested += e.tested;
      r.failure_count += e.failures;
      r.worst = std::max(r.worst, e.worst);
      for (const std::string& sentence : e.sentences)
        if (r.failures.size() < sentences_kept) r.failures.push_back(sentence);
    }
    if (r.tested == 0) r.note = notes_[i].empty() ? "this dataset has nothing to compare" : notes_[i];
  }
  return out;
}

}  // namespace moomill
