#pragma once
// The journal of a dataset in the making: a header with the manifest's identity, then one line per finished frame. It
// is locked while it is open, so that two processes never write to one folder.
#include <filesystem>
#include <map>
#include <string>

#include "generator/dataset/dataset.h"

namespace moomill {

class Journal {
 public:
  // Opens or makes the journal of `folder` and locks it. RunError when another process has it.
  explicit Journal(const std::filesystem::path& folder);
  ~Journal();
  Journal(const Journal&) = delete;
  Journal& operator=(const Journal&) = delete;

  bool is_new() const { return identity_.is_null(); }  // no header yet
  const Json& identity() const { return identity_; }
  const std::map<int, std::string>& frames() const { return frames_; }  // frame to hash of its record
  void start(const Json& identity);                                     // header of a new journal
  void append(int frame, const std::string& record_hash);               // thread-safe: one write
  void remove();                                                        // at completion

 private:
  std::filesystem::path file_;
  int descriptor_ = -1;
  Json identity_;
  std::map<int, std::string> frames_;
};

}  // namespace moomill
