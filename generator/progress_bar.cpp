#include "generator/progress_bar.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <cstdio>

namespace moomill {
namespace {

constexpr double terminal_seconds = 0.1, line_seconds = 10;  // between two updates

std::string clock_text(double seconds) {
  const auto s = static_cast<long long>(seconds + 0.5);
  if (s >= 3600) return fmt::format("{}:{:02}:{:02}", s / 3600, s / 60 % 60, s % 60);
  return fmt::format("{}:{:02}", s / 60, s % 60);
}

}  // namespace

ProgressBar::ProgressBar(std::string unit)
    : unit_(std::move(unit)), terminal_(::isatty(STDERR_FILENO) != 0), start_(Clock::now()), last_(start_) {}

ProgressBar::~ProgressBar() {
  if (terminal_ && shown_) std::fputc('\n', stderr);
}

std::string ProgressBar::line(std::size_t done, std::size_t total, const std::string& stage) const {
  const double seconds = std::chrono::duration<double>(Clock::now() - start_).count();
  const double rate = seconds > 1e-3 ? static_cast<double>(done - first_done_) / seconds : 0;
  const double share = total > 0 ? static_cast<double>(done) / static_cast<double>(total) : 1;
  std::string text = fmt::format("{:3.0f} %  {}/{} {}", 100 * share, done, total, unit_);
  if (rate > 0) {
    text += rate < 1 ? fmt::format("  {:.1f} s each", 1 / rate) : fmt::format("  {:.1f}/s", rate);
    if (done < total) text += fmt::format("  {} left", clock_text(static_cast<double>(total - done) / rate));
  }
  if (done >= total) text += fmt::format("  in {}", clock_text(seconds));
  if (!stage.empty() && done < total) text += "  " + stage;
  if (!terminal_) return text;
  constexpr int width = 24;
  const int filled = static_cast<int>(share * width);
  return fmt::format("[{}{}] {}", std::string(filled, '#'), std::string(width - filled, '.'), text);
}

void ProgressBar::update(std::size_t done, std::size_t total, const std::string& stage) {
  const std::lock_guard lock(mutex_);
  const Clock::time_point now = Clock::now();
  if (!started_) {
    started_ = true;
    first_done_ = done;
    start_ = now;
  }
  const double since = std::chrono::duration<double>(now - last_).count();
  if (shown_ && done < total && since < (terminal_ ? terminal_seconds : line_seconds)) return;
  last_ = now;
  shown_ = true;
  if (!terminal_) {
    spdlog::info("{}", line(done, total, stage));
    return;
  }
  fmt::print(stderr, "\r\033[K{}", line(done, total, stage));
  std::fflush(stderr);
}

}  // namespace moomill
