#pragma once
// A file that lives as long as the test case, and the message of the error a call ends in.
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <string>

#include "generator/core/error.h"

namespace moomill::test {

class TemporaryFile {
 public:
  TemporaryFile(const std::string& name, const std::string& text) {
    static int made = 0;
    folder_ = std::filesystem::temp_directory_path() / fmt::format("moomill_test_{}_{}", ::getpid(), made++);
    std::filesystem::create_directories(folder_);
    path = folder_ / name;
    std::filesystem::create_directories(path.parent_path());
    std::ofstream(path, std::ios::binary) << text;
  }
  ~TemporaryFile() {
    std::error_code ignored;
    std::filesystem::remove_all(folder_, ignored);
  }
  TemporaryFile(const TemporaryFile&) = delete;
  TemporaryFile& operator=(const TemporaryFile&) = delete;
  const std::filesystem::path& folder() const { return folder_; }
  std::filesystem::path path;

 private:
  std::filesystem::path folder_;
};

// What the InputError of `call` says, or "(no error)".
template <class Call>
std::string message_of(const Call& call) {
  try {
    call();
  } catch (const InputError& e) {
    return e.what();
  }
  return "(no error)";
}

inline bool contains(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

}  // namespace moomill::test
