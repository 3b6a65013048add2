#include "neural/packed_cache.h"

#include <fcntl.h>
#include <omp.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <bit>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <exception>
#include <mutex>
#include <utility>

#include "generator/core/error.h"
#include "generator/core/random.h"
#include "generator/dataset/codecs.h"

namespace moomill {
namespace {

namespace fs = std::filesystem;

constexpr char magic[8] = {'N', 'E', 'T', 'E', 'P', 'A', 'C', 'K'};
constexpr std::uint32_t version = 1;

// The front of a file. Geometry: then first[views + 1] (64-bit counts of pixels), mask[views, h, words], depth[pixels],
// nnopcs[pixels, 3]. Coat: then color[pixels, 3].
struct Header {
  char mark[8] = {};
  std::uint32_t version = 0;
  std::int32_t coat = -1;  // -1: geometry
  std::uint64_t identity = 0;
  std::int32_t width = 0, height = 0;
  std::uint64_t views = 0, pixels = 0;
  std::uint64_t nnopcs = 0;      // 0 or 1
  std::uint64_t index_hash = 0;  // of all the above and first[]
};
static_assert(sizeof(Header) == 64);

std::uint64_t hash_index(Header header, const std::uint64_t* first) {
  header.index_hash = 0;
  std::uint64_t h = hash_text({reinterpret_cast<const char*>(&header), sizeof header});
  if (first)
    h = hash_identity({h, hash_text({reinterpret_cast<const char*>(first), (header.views + 1) * sizeof *first})});
  return h;
}

// Where the parts of a geometry file begin, in bytes.
struct Parts {
  std::uint64_t first, mask, depth, nnopcs, end;
  Parts(std::uint64_t views, std::uint64_t words, std::uint64_t pixels, bool has_nnopcs) {
    first = sizeof(Header);
    mask = first + (views + 1) * 8;
    depth = mask + views * words * 8;
    nnopcs = depth + pixels * 4;
    end = nnopcs + (has_nnopcs ? pixels * 12 : 0);
  }
};

// A file open for writing at any place, by several threads.
class Output {
 public:
  Output(const fs::path& file, fs::path name) : name_(std::move(name)) {
    descriptor_ = ::open(file.c_str(), O_CREAT | O_EXCL | O_RDWR | O_CLOEXEC, 0666);
    if (descriptor_ < 0) failed();
  }
  ~Output() {
    if (descriptor_ >= 0) ::close(descriptor_);
  }
  Output(const Output&) = delete;
  Output& operator=(const Output&) = delete;
  void write(std::uint64_t at, const void* data, std::size_t size) const {
    for (const char* p = static_cast<const char*>(data); size > 0;) {
      const ssize_t done = ::pwrite(descriptor_, p, size, static_cast<off_t>(at));
      if (done < 0 && errno == EINTR) continue;
      if (done <= 0) failed();
      p += done;
      at += static_cast<std::uint64_t>(done);
      size -= static_cast<std::size_t>(done);
    }
  }
  void read(std::uint64_t at, void* data, std::size_t size) const {
    for (char* p = static_cast<char*>(data); size > 0;) {
      const ssize_t done = ::pread(descriptor_, p, size, static_cast<off_t>(at));
      if (done < 0 && errno == EINTR) continue;
      if (done <= 0) failed();
      p += done;
      at += static_cast<std::uint64_t>(done);
      size -= static_cast<std::size_t>(done);
    }
  }
  void close() {
    if (::close(std::exchange(descriptor_, -1)) != 0) failed();
  }

 private:
  [[noreturn]] void failed() const {
    run_error("{}: cannot be written: {}; free space there, or choose another place for the cache", name_.string(),
              std::strerror(errno));
  }
  fs::path name_;
  int descriptor_ = -1;
};

// Reports progress now and then, from any thread.
class Progress {
 public:
  Progress(const PackProgress& report, std::string what, std::size_t of)
      : report_(report), what_(std::move(what)), of_(of) {}
  void step() {
    const std::size_t done = done_.fetch_add(1) + 1;
    if (!report_ || (done % 64 != 0 && done != of_)) return;
    std::lock_guard lock(mutex_);
    if (done <= last_) return;
    last_ = done;
    report_(what_, done, of_);
  }

 private:
  const PackProgress& report_;
  std::string what_;
  std::size_t of_, last_ = 0;
  std::atomic<std::size_t> done_{0};
  std::mutex mutex_;
};

void require_size(const DatasetSource& s, int width, int height, const fs::path& file) {
  if (width != s.width || height != s.height)
    input_error("{}: has {} x {} pixels where the dataset's cameras have {} x {}; make the file anew", file.string(),
                width, height, s.width, s.height);
}

struct ViewPlace {
  int frame, camera;  // as numbered
};

ViewPlace place_of(const DatasetSource& s, std::size_t v) {
  return {s.frames[v / s.camera_ids.size()], s.camera_ids[v % s.camera_ids.size()]};
}

// Every value but 255 of the first channel is background.
void read_mask(const DatasetSource& s, std::size_t v, std::vector<std::uint64_t>& bits) {
  const auto [frame, camera] = place_of(s, v);
  const fs::path file = s.path(s.mask_template, frame, camera);
  const Image8 mask = decode_png8(file);
  require_size(s, mask.width, mask.height, file);
  const std::size_t words = words_per_row(s.width);
  bits.assign(words * s.height, 0);
  for (int y = 0; y < s.height; ++y)
    for (int x = 0; x < s.width; ++x)
      if (mask.at(x, y, 0) == 255) bits[words * y + x / 64] |= std::uint64_t{1} << (x % 64);
}

void list_pixels(const std::uint64_t* bits, int width, int height, std::vector<std::uint32_t>& out) {
  const std::size_t words = words_per_row(width);
  out.clear();
  for (int y = 0; y < height; ++y)
    for (std::size_t w = 0; w < words; ++w)
      for (std::uint64_t rest = bits[words * y + w]; rest; rest &= rest - 1)
        out.push_back(static_cast<std::uint32_t>(y * width + static_cast<int>(w) * 64 + std::countr_zero(rest)));
}

void read_depth(const DatasetSource& s, std::size_t v, const std::vector<std::uint32_t>& pixels,
                std::vector<float>& out) {
  const auto [frame, camera] = place_of(s, v);
  const fs::path file = s.path(s.depth_template, frame, camera);
  const ExrImage image = decode_exr(file);
  require_size(s, image.width, image.height, file);
  int channel = image.channel("R");  // as our own and NePuMoo's; others call it Z
  if (channel < 0) channel = image.channel("Z");
  if (channel < 0 || image.data[channel].empty())
    input_error("{}: has no float channel R or Z; make the file anew", file.string());
  out.resize(pixels.size());
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    out[i] = image.data[channel][pixels[i]];
    if (!(out[i] > 0) || !std::isfinite(out[i]))
      input_error("{}: has depth {} at pixel ({}, {}), inside the silhouette; make the file anew", file.string(),
                  out[i], pixels[i] % s.width, pixels[i] / s.width);
  }
}

void read_nnopcs(const DatasetSource& s, std::size_t v, const std::vector<std::uint32_t>& pixels,
                 std::vector<float>& out) {
  const auto [frame, camera] = place_of(s, v);
  const fs::path file = s.path(s.nnopcs_template, frame, camera);
  out.resize(3 * pixels.size());
  if (file.extension() == ".png") {
    const Image8 image = decode_png8(file);
    require_size(s, image.width, image.height, file);
    if (image.channels < 3)
      input_error("{}: has {} channels where 3 belong; make the file anew", file.string(), image.channels);
    for (std::size_t i = 0; i < pixels.size(); ++i)
      for (int c = 0; c < 3; ++c) out[3 * i + c] = image.data[std::size_t{pixels[i]} * image.channels + c] / 255.0f;
    return;
  }
  const ExrImage image = decode_exr(file);
  require_size(s, image.width, image.height, file);
  for (int c = 0; c < 3; ++c) {
    const int channel = image.channel(std::string_view("RGB").substr(c, 1));
    if (channel < 0 || image.data[channel].empty())
      input_error("{}: has no float channels R, G and B; make the file anew", file.string());
    for (std::size_t i = 0; i < pixels.size(); ++i) {
      const float value = image.data[channel][pixels[i]];
      out[3 * i + c] = std::clamp(value, 0.0f, 1.0f);  // interpolation may step over the box by a rounding error
      if (!(std::abs(value - out[3 * i + c]) < 1e-3f))
        input_error("{}: has NNOPCS {} at pixel ({}, {}), outside [0, 1]; make the file anew", file.string(), value,
                    pixels[i] % s.width, pixels[i] / s.width);
    }
  }
}

// Whether a file of ours lies there at all; another's is left alone.
bool is_ours(const fs::path& file) {
  std::error_code error;
  if (!fs::exists(file, error)) return false;
  const int descriptor = ::open(file.c_str(), O_RDONLY | O_CLOEXEC);
  char mark[sizeof magic] = {};
  const ssize_t got = descriptor < 0 ? -1 : ::read(descriptor, mark, sizeof mark);
  if (descriptor >= 0) ::close(descriptor);
  if (got > 0 && std::memcmp(mark, magic, static_cast<std::size_t>(got)) != 0)
    input_error("{}: is not a cache of netepu; move it away or choose another folder for the cache", file.string());
  return got >= 0;
}

// Packing is for one process at a time: a second one waits, and finds the work done. What a killed one left behind is
// removed.
class PackingLock {
 public:
  explicit PackingLock(const fs::path& folder) {
    std::error_code error;
    fs::create_directories(folder, error);
    if (error)
      run_error("{}: cannot be made: {}; choose another place for the cache", folder.string(), error.message());
    descriptor_ = ::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (descriptor_ < 0)
      run_error("{}: cannot be opened: {}; choose another place for the cache", folder.string(), std::strerror(errno));
    int result;
    do result = ::flock(descriptor_, LOCK_EX);
    while (result != 0 && errno == EINTR);
    if (result != 0) return;  // a file system without locks: two may pack at once, and come to the same file
    std::vector<fs::path> left;
    for (fs::directory_iterator i(folder, error), end; !error && i != end; i.increment(error))
      if (is_temporary(i->path())) left.push_back(i->path());
    for (const fs::path& file : left) fs::remove(file, error);
  }
  ~PackingLock() { ::close(descriptor_); }
  PackingLock(const PackingLock&) = delete;
  PackingLock& operator=(const PackingLock&) = delete;

 private:
  int descriptor_ = -1;
};

bool read_header(const MappedFile& map, Header& header) {
  if (map.size() < sizeof header) return false;
  std::memcpy(&header, map.data(), sizeof header);
  return header.version == version;
}

}  // namespace

void for_each_index(std::size_t count, const std::function<void(std::size_t)>& body) {
  std::exception_ptr error;
  std::atomic<std::size_t> failed{count};
  std::mutex mutex;
#pragma omp parallel for schedule(dynamic, 1)
  for (std::size_t i = 0; i < count; ++i) {
    if (i > failed.load(std::memory_order_relaxed)) continue;
    try {
      body(i);
    } catch (...) {
      std::lock_guard lock(mutex);
      if (i < failed) {
        failed = i;
        error = std::current_exception();
      }
    }
  }
  if (error) std::rethrow_exception(error);
}

MappedFile::MappedFile(const fs::path& file) {
  const int descriptor = ::open(file.c_str(), O_RDONLY | O_CLOEXEC);
  struct stat status {};
  int error = descriptor < 0 || ::fstat(descriptor, &status) != 0 ? errno : 0;
  if (!error && status.st_size > 0) {
    void* at = ::mmap(nullptr, static_cast<std::size_t>(status.st_size), PROT_READ, MAP_SHARED, descriptor, 0);
    if (at == MAP_FAILED) {
      error = errno;
    } else {
      data_ = static_cast<const std::byte*>(at);
      size_ = static_cast<std::size_t>(status.st_size);
    }
  }
  if (descriptor >= 0) ::close(descriptor);
  if (error) input_error("{}: cannot be read: {}; delete it, it is made anew", file.string(), std::strerror(error));
}

MappedFile::~MappedFile() {
  if (data_) ::munmap(const_cast<std::byte*>(data_), size_);
}

MappedFile::MappedFile(MappedFile&& other) noexcept
    : data_(std::exchange(other.data_, nullptr)), size_(std::exchange(other.size_, 0)) {}

MappedFile& MappedFile::operator=(MappedFile&& other) noexcept {
  std::swap(data_, other.data_);
  std::swap(size_, other.size_);
  return *this;
}

PackedGeometry::PackedGeometry(const DatasetSource& s, const fs::path& folder, const PackProgress& report)
    : width_(s.width),
      height_(s.height),
      views_(s.frames.size() * s.camera_ids.size()),
      words_(words_per_row(s.width) * s.height),
      identity_(hash_identity({hash_text(s.identity), static_cast<std::uint64_t>(s.width),
                               static_cast<std::uint64_t>(s.height), views_, hash_text(s.nnopcs_template)})) {
  const fs::path file = folder / "geometry.pack";
  const bool has_nnopcs = !s.nnopcs_template.empty();
  name_ = file.string();
  const auto open = [&] {
    map_ = MappedFile(file);
    Header h;
    if (!read_header(map_, h) || h.coat != -1 || h.identity != identity_ || h.width != width_ || h.height != height_ ||
        h.views != views_ || h.nnopcs != (has_nnopcs ? 1 : 0))
      return false;
    const Parts parts(views_, words_, h.pixels, has_nnopcs);
    if (map_.size() != parts.end) return false;
    first_ = reinterpret_cast<const std::uint64_t*>(map_.data() + parts.first);
    if (hash_index(h, first_) != h.index_hash) return false;
    mask_ = reinterpret_cast<const std::uint64_t*>(map_.data() + parts.mask);
    depth_ = reinterpret_cast<const float*>(map_.data() + parts.depth);
    nnopcs_ = has_nnopcs ? reinterpret_cast<const float*>(map_.data() + parts.nnopcs) : nullptr;
    return true;
  };
  if (is_ours(file) && open()) return;
  const PackingLock lock(folder);
  if (is_ours(file) && open()) return;

  // Masks first: they say how much room every view takes.
  make_file_atomically(file, [&](const fs::path& temporary) {
    Output out(temporary, file);
    std::vector<std::uint64_t> first(views_ + 1, 0);
    Progress progress(report, "packing geometry", 2 * views_);
    const std::uint64_t mask_at = Parts(views_, words_, 0, has_nnopcs).mask;
    for_each_index(views_, [&](std::size_t v) {
      std::vector<std::uint64_t> bits;
      read_mask(s, v, bits);
      for (const std::uint64_t word : bits) first[v + 1] += static_cast<std::uint64_t>(std::popcount(word));
      out.write(mask_at + v * words_ * 8, bits.data(), words_ * 8);
      progress.step();
    });
    for (std::size_t v = 0; v < views_; ++v) first[v + 1] += first[v];
    const Parts parts(views_, words_, first[views_], has_nnopcs);
    for_each_index(views_, [&](std::size_t v) {
      std::vector<std::uint64_t> bits(words_);
      std::vector<std::uint32_t> pixels;
      std::vector<float> values;
      out.read(mask_at + v * words_ * 8, bits.data(), words_ * 8);
      list_pixels(bits.data(), width_, height_, pixels);
      read_depth(s, v, pixels, values);
      out.write(parts.depth + first[v] * 4, values.data(), values.size() * 4);
      if (has_nnopcs) {
        read_nnopcs(s, v, pixels, values);
        out.write(parts.nnopcs + first[v] * 12, values.data(), values.size() * 4);
      }
      progress.step();
    });
    Header h{.version = version,
             .identity = identity_,
             .width = width_,
             .height = height_,
             .views = views_,
             .pixels = first[views_],
             .nnopcs = has_nnopcs ? 1u : 0u};
    std::memcpy(h.mark, magic, sizeof magic);
    h.index_hash = hash_index(h, first.data());
    out.write(0, &h, sizeof h);
    out.write(parts.first, first.data(), first.size() * 8);
    out.close();
  });
  check(open(), "a cache just packed can be opened");
}

void PackedGeometry::pixels(std::size_t v, std::vector<std::uint32_t>& out) const {
  list_pixels(mask(v), width_, height_, out);
  if (out.size() != count(v)) run_error("{}: is damaged; delete it, it is made anew", name_);
}

PackedCoat::PackedCoat(const DatasetSource& s, const PackedGeometry& geometry, int coat, const fs::path& folder,
                       const PackProgress& report) {
  const int at = s.coat_at(coat);
  const fs::path file = folder / fmt::format("coat_{:03}.pack", coat);
  const std::size_t views = geometry.views();
  const std::uint64_t pixels = geometry.first(views);
  const std::uint64_t identity = hash_identity({geometry.identity(), hash_text(coat_identity(s, at))});
  const auto open = [&] {
    map_ = MappedFile(file);
    Header h;
    if (!read_header(map_, h) || h.coat != coat || h.identity != identity || h.views != views || h.pixels != pixels ||
        map_.size() != sizeof h + 3 * pixels || hash_index(h, nullptr) != h.index_hash)
      return false;
    color_ = reinterpret_cast<const std::uint8_t*>(map_.data() + sizeof h);
    return true;
  };
  if (is_ours(file) && open()) return;
  const PackingLock lock(folder);
  if (is_ours(file) && open()) return;

  make_file_atomically(file, [&](const fs::path& temporary) {
    Output out(temporary, file);
    Progress progress(report, fmt::format("packing coat {}", coat), views);
    for_each_index(views, [&](std::size_t v) {
      const auto [frame, camera] = place_of(s, v);
      const Image8 image = read_color(s, s.path(s.coat_templates[at], frame, camera));
      std::vector<std::uint32_t> list;
      geometry.pixels(v, list);
      std::vector<std::uint8_t> values(3 * list.size());
      for (std::size_t i = 0; i < list.size(); ++i)
        for (int c = 0; c < 3; ++c) values[3 * i + c] = image.data[3 * std::size_t{list[i]} + c];
      out.write(sizeof(Header) + 3 * geometry.first(v), values.data(), values.size());
      progress.step();
    });
    Header h{.version = version,
             .coat = coat,
             .identity = identity,
             .width = s.width,
             .height = s.height,
             .views = views,
             .pixels = pixels};
    std::memcpy(h.mark, magic, sizeof magic);
    h.index_hash = hash_index(h, nullptr);
    out.write(0, &h, sizeof h);
    out.close();
  });
  check(open(), "a cache just packed can be opened");
}

Image8 read_color(const DatasetSource& s, const fs::path& file) {
  Image8 image = file.extension() == ".png" ? decode_png8(file) : decode_jpeg(file);
  require_size(s, image.width, image.height, file);
  if (image.channels == 3) return image;
  Image8 rgb(image.width, image.height, 3);
  for (std::size_t i = 0; i < rgb.data.size(); ++i)
    rgb.data[i] = image.data[i / 3 * image.channels + (image.channels > 3 ? i % 3 : 0)];
  return rgb;
}

}  // namespace moomill
