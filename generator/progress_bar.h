#pragma once
// Progress on stderr: a bar with rate and time left on a terminal, a line now and then elsewhere.
#include <chrono>
#include <mutex>
#include <string>

namespace moomill {

class ProgressBar {
 public:
  explicit ProgressBar(std::string unit);  // what is counted, e.g. "views"
  ~ProgressBar();                          // ends the line
  ProgressBar(const ProgressBar&) = delete;
  ProgressBar& operator=(const ProgressBar&) = delete;

  // Thread-safe. `stage` is what is being done; may be empty.
  void update(std::size_t done, std::size_t total, const std::string& stage = {});

 private:
  using Clock = std::chrono::steady_clock;
  std::string line(std::size_t done, std::size_t total, const std::string& stage) const;

  std::string unit_;
  bool terminal_;
  bool shown_ = false;
  std::mutex mutex_;
  Clock::time_point start_, last_;
  std::size_t first_done_ = 0;  // what an earlier run had done already does not count for the rate
  bool started_ = false;
};

}  // namespace moomill
