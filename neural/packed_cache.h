#pragma once
// The packed form of a dataset: foreground pixels only, memory-mapped. One file for the geometry of all views, one per
// coat. A file carries the identity of what it was packed from, and is made anew when that changed.
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "neural/dataset_source.h"

namespace moomill {

using PackProgress = std::function<void(const std::string& what, std::size_t done, std::size_t of)>;

// Calls body(i) for i in [0, count) on this thread's OpenMP team. Of several exceptions the one of the lowest i is
// thrown.
void for_each_index(std::size_t count, const std::function<void(std::size_t)>& body);

// Bit rows of a mask are padded to whole 64-bit words; bit x % 64 of word x / 64 is pixel x.
inline std::size_t words_per_row(int width) {
  return (static_cast<std::size_t>(width) + 63) / 64;
}

// A file mapped read-only.
class MappedFile {
 public:
  MappedFile() = default;
  explicit MappedFile(const std::filesystem::path& file);  // InputError when it cannot be mapped
  ~MappedFile();
  MappedFile(MappedFile&& other) noexcept;
  MappedFile& operator=(MappedFile&& other) noexcept;
  const std::byte* data() const { return data_; }
  std::size_t size() const { return size_; }

 private:
  const std::byte* data_ = nullptr;
  std::size_t size_ = 0;
};

// Silhouettes, depth and NNOPCS. View v = place of the frame * cameras + place of the camera.
class PackedGeometry {
 public:
  PackedGeometry() = default;
  // Opens <folder>/geometry.pack, packing first where it is missing or stale. InputError names a picture that does not
  // fit.
  PackedGeometry(const DatasetSource& source, const std::filesystem::path& folder, const PackProgress& progress);
  std::size_t views() const { return views_; }
  std::size_t first(std::size_t v) const { return first_[v]; }                   // pixels before those of this view
  std::size_t count(std::size_t v) const { return first_[v + 1] - first_[v]; }   // foreground pixels
  const std::uint64_t* mask(std::size_t v) const { return mask_ + v * words_; }  // [h, words_per_row(w)]
  const float* depth(std::size_t v) const { return depth_ + first_[v]; }         // [count] metres, in raster order
  const float* nnopcs(std::size_t v) const { return nnopcs_ ? nnopcs_ + 3 * first_[v] : nullptr; }  // [count, 3]
  // Pixels y * width + x of the foreground, in raster order.
  void pixels(std::size_t v, std::vector<std::uint32_t>& out) const;
  std::uint64_t identity() const { return identity_; }

 private:
  MappedFile map_;
  std::string name_;
  int width_ = 0, height_ = 0;
  std::size_t views_ = 0, words_ = 0;
  std::uint64_t identity_ = 0;
  const std::uint64_t* first_ = nullptr;
  const std::uint64_t* mask_ = nullptr;
  const float* depth_ = nullptr;
  const float* nnopcs_ = nullptr;
};

// Colours of one coat at the foreground pixels of all views.
class PackedCoat {
 public:
  PackedCoat(const DatasetSource& source, const PackedGeometry& geometry, int coat, const std::filesystem::path& folder,
             const PackProgress& progress);
  const std::uint8_t* color(const PackedGeometry& geometry, std::size_t v) const {  // [count, 3] sRGB
    return color_ + 3 * geometry.first(v);
  }

 private:
  MappedFile map_;
  const std::uint8_t* color_ = nullptr;
};

// A picture of a coat, whole: JPEG or PNG by its extension; InputError when it has another size than the dataset.
Image8 read_color(const DatasetSource& source, const std::filesystem::path& file);

}  // namespace moomill
