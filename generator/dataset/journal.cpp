#include "generator/dataset/journal.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <sstream>

#include "generator/core/error.h"
#include "generator/dataset/codecs.h"
#include "generator/dataset/reader.h"

namespace moomill {
namespace {

constexpr std::string_view header_start = "moomill journal 1 ";

}  // namespace

Journal::Journal(const std::filesystem::path& folder) : file_(folder / journal_name) {
  for (;;) {
    descriptor_ = ::open(file_.c_str(), O_RDWR | O_CREAT | O_APPEND | O_CLOEXEC, 0666);
    if (descriptor_ < 0)
      run_error("{}: cannot be written: {}; check the permissions of the folder", file_.string(), std::strerror(errno));
    if (::flock(descriptor_, LOCK_EX | LOCK_NB) != 0) {
      const int error = errno;
      ::close(descriptor_);
      descriptor_ = -1;
      if (error == EWOULDBLOCK)
        run_error("{}: another process is writing to this folder; wait for it or choose another folder",
                  folder.string());
      run_error("{}: cannot be locked: {}; choose a folder on a file system with locks", file_.string(),
                std::strerror(error));
    }
    // The process that had the lock may have finished and removed the file between our open and our lock.
    struct stat ours {
    }, there{};
    if (::fstat(descriptor_, &ours) == 0 && ::stat(file_.c_str(), &there) == 0 && ours.st_ino == there.st_ino) break;
    ::close(descriptor_);
  }
  const std::vector<std::uint8_t> bytes = read_file(file_);
  std::string text(bytes.begin(), bytes.end());
  // A line without its end was cut short by a kill: as if it had not been written.
  const auto last = text.rfind('\n');
  text.resize(last == std::string::npos ? 0 : last + 1);
  if (text.size() != bytes.size() && ::ftruncate(descriptor_, static_cast<off_t>(text.size())) != 0)
    run_error("{}: cannot be shortened: {}; delete it", file_.string(), std::strerror(errno));
  std::istringstream lines(text);
  std::string line;
  if (!std::getline(lines, line)) return;
  Json header;
  if (line.starts_with(header_start)) header = Json::parse(line.substr(header_start.size()), nullptr, false);
  if (!header.is_object())
    input_error("{}: line 1 is not the header of a journal of moomill; choose another folder", file_.string());
  identity_ = std::move(header);
  while (std::getline(lines, line)) {
    std::istringstream words(line);
    std::string word, hash;
    int frame = 0;
    if (words >> word >> frame >> hash && word == "frame" && hash.size() == 16) frames_[frame] = hash;
  }
}

Journal::~Journal() {
  if (descriptor_ >= 0) ::close(descriptor_);
}

void Journal::start(const Json& identity) {
  const std::string line =
      std::string(header_start) + identity.dump(-1, ' ', false, Json::error_handler_t::replace) + "\n";
  write_all(descriptor_, file_, line.data(), line.size());
  identity_ = identity;
}

void Journal::append(int frame, const std::string& record_hash) {
  const std::string line = fmt::format("frame {} {}\n", frame, record_hash);
  write_all(descriptor_, file_, line.data(), line.size());
}

void Journal::remove() {
  if (::unlink(file_.c_str()) != 0 && errno != ENOENT)
    run_error("{}: cannot be removed: {}; remove it by hand", file_.string(), std::strerror(errno));
}

}  // namespace moomill
