// Files on disk: whole or not at all.
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>
#include <xxhash.h>

#include <atomic>
#include <cerrno>
#include <cstring>

#include "generator/core/error.h"
#include "generator/dataset/codecs.h"

namespace moomill {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view temporary_prefix = ".moomill-part-";

const char* mend(int error) {
  switch (error) {
    case ENOSPC:
    case EDQUOT:
      return "free space there and run the same command again, it resumes";
    case EFBIG:
      return "raise the file size limit (ulimit -f)";
    case EACCES:
    case EPERM:
      return "check the permissions of the folder";
    case EROFS:
      return "choose a folder that is not read-only";
    case ENOTDIR:
    case EEXIST:
      return "a part of the path is a file; move it away or choose another folder";
    default:
      return "check the path and the disk";
  }
}

[[noreturn]] void cannot_write(const fs::path& file, int error) {
  run_error("{}: cannot be written: {}; {}", file.string(), std::strerror(error), mend(error));
}

// Unique among the threads and processes that write to one folder; keeps the extension for writers that look at it.
fs::path temporary_for(const fs::path& file) {
  static std::atomic<std::uint64_t> counter{0};
  return file.parent_path() /
         fmt::format("{}{}-{}-{}", temporary_prefix, ::getpid(), counter.fetch_add(1), file.filename().string());
}

void make_folder(const fs::path& folder) {
  if (folder.empty()) return;
  std::error_code error;
  fs::create_directories(folder, error);
  if (error) run_error("{}: cannot be made: {}; {}", folder.string(), error.message(), mend(error.value()));
}

void rename_or_throw(const fs::path& temporary, const fs::path& file) {
  if (::rename(temporary.c_str(), file.c_str()) == 0) return;
  const int error = errno;
  ::unlink(temporary.c_str());
  cannot_write(file, error);
}

}  // namespace

bool is_temporary(const fs::path& file) {
  return file.filename().string().starts_with(temporary_prefix);
}

void write_all(int descriptor, const fs::path& file, const void* data, std::size_t size) {
  const char* bytes = static_cast<const char*>(data);
  while (size > 0) {
    const ssize_t written = ::write(descriptor, bytes, size);
    if (written < 0) {
      if (errno == EINTR) continue;
      cannot_write(file, errno);
    }
    bytes += written;
    size -= static_cast<std::size_t>(written);
  }
}

void write_file_atomically(const fs::path& file, const void* data, std::size_t size) {
  const fs::path temporary = temporary_for(file);
  const int flags = O_CREAT | O_EXCL | O_WRONLY | O_CLOEXEC;
  int descriptor = ::open(temporary.c_str(), flags, 0666);
  if (descriptor < 0 && errno == ENOENT) {  // the folder is made when it is first missed: no stat for every file
    make_folder(file.parent_path());
    descriptor = ::open(temporary.c_str(), flags, 0666);
  }
  if (descriptor < 0) cannot_write(file, errno);
  try {
    write_all(descriptor, file, data, size);
  } catch (...) {
    ::close(descriptor);
    ::unlink(temporary.c_str());
    throw;
  }
  if (::close(descriptor) != 0) {  // quota and network file systems report here
    const int error = errno;
    ::unlink(temporary.c_str());
    cannot_write(file, error);
  }
  rename_or_throw(temporary, file);
}

void write_file_atomically(const fs::path& file, const std::string& text) {
  write_file_atomically(file, text.data(), text.size());
}

void make_file_atomically(const fs::path& file, const std::function<void(const fs::path&)>& make) {
  make_folder(file.parent_path());
  const fs::path temporary = temporary_for(file);
  try {
    make(temporary);
  } catch (...) {
    ::unlink(temporary.c_str());
    throw;
  }
  rename_or_throw(temporary, file);
}

std::vector<std::uint8_t> read_file(const fs::path& file) {
  const int descriptor = ::open(file.c_str(), O_RDONLY | O_CLOEXEC);
  if (descriptor < 0) input_error("{}: cannot be read: {}; check the path", file.string(), std::strerror(errno));
  struct stat status {};
  std::vector<std::uint8_t> bytes;
  int error = ::fstat(descriptor, &status) == 0 ? 0 : errno;
  if (!error && S_ISDIR(status.st_mode)) error = EISDIR;
  if (!error) {
    bytes.resize(static_cast<std::size_t>(status.st_size));
    std::size_t filled = 0;
    for (;;) {  // also pipes and files that grow
      if (filled == bytes.size()) bytes.resize(filled + 1 + (S_ISREG(status.st_mode) ? 0 : 65536));
      const ssize_t got = ::read(descriptor, bytes.data() + filled, bytes.size() - filled);
      if (got < 0 && errno == EINTR) continue;
      if (got < 0) error = errno;
      if (got <= 0) break;
      filled += static_cast<std::size_t>(got);
    }
    bytes.resize(filled);
  }
  ::close(descriptor);
  if (error) input_error("{}: cannot be read: {}; check the path", file.string(), std::strerror(error));
  return bytes;
}

std::string xxh64_hex(const void* data, std::size_t size) {
  return fmt::format("{:016x}", static_cast<std::uint64_t>(XXH64(data, size, 0)));
}

}  // namespace moomill
