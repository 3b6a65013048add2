#pragma once
// Three kinds of error, kept apart: bad input (exit status 2), failures while running (exit status 1), and broken
// invariants (bugs). Libraries throw; only main() turns them into exit codes.
#include <fmt/format.h>

#include <stdexcept>
#include <string>

namespace moomill {

// What the user gave us cannot be used. The message is one sentence: the file, the place in it, and the mend.
struct InputError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

// The input was fine but the work failed: a full disk, an unwritable folder, a lost file.
struct RunError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

template <class... Args>
[[noreturn]] void input_error(fmt::format_string<Args...> format, Args&&... args) {
  throw InputError(fmt::format(format, std::forward<Args>(args)...));
}

template <class... Args>
[[noreturn]] void run_error(fmt::format_string<Args...> format, Args&&... args) {
  throw RunError(fmt::format(format, std::forward<Args>(args)...));
}

// An invariant of our own code; checked in every build. Never used to validate input.
inline void check(bool holds, const char* what) {
  if (!holds) throw std::logic_error(std::string("internal error: ") + what);
}

}  // namespace moomill
