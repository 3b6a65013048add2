#include "generator/core/stage_times.h"

#include <time.h>

#include <atomic>
#include <mutex>

#include "generator/core/error.h"

namespace moomill {
namespace {

std::atomic<bool> listening{false};
std::mutex mutex;
std::map<std::string, double> sums;  // guarded by the mutex

double clock_seconds(clockid_t clock) {
  timespec t{};
  clock_gettime(clock, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

}  // namespace

double thread_processor_seconds() { return clock_seconds(CLOCK_THREAD_CPUTIME_ID); }
double process_processor_seconds() { return clock_seconds(CLOCK_PROCESS_CPUTIME_ID); }

StageTimes::StageTimes() {
  std::lock_guard lock(mutex);
  check(!listening, "stage times are listened to twice at once");
  sums.clear();
  listening = true;
}

StageTimes::~StageTimes() { listening = false; }

std::map<std::string, double> StageTimes::seconds() const {
  std::lock_guard lock(mutex);
  return sums;
}

StageTimer::StageTimer(const char* stage, const std::string& detail) {
  if (!listening.load(std::memory_order_relaxed)) return;
  name_ = detail.empty() ? std::string(stage) : std::string(stage) + " " + detail;
  start_ = thread_processor_seconds();
}

StageTimer::~StageTimer() {
  if (name_.empty()) return;
  const double took = thread_processor_seconds() - start_;
  std::lock_guard lock(mutex);
  sums[name_] += took;
}

}  // namespace moomill
