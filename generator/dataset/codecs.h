#pragma once
// Image files. The hot writers (JPEG, PNG, EXR) each stand in one file on the plain library; OpenImageIO, which pulls
// in some 260 shared libraries, stands behind read_image8() and read_imagef() alone.
#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "generator/core/image.h"

namespace moomill {

// --- encoders: to bytes, deterministic; written to disk by write_file_atomically() ---
std::vector<std::uint8_t> encode_jpeg(const Image8& rgb, int quality = 95);  // 3 channels, 4:4:4 (libjpeg-turbo)
std::vector<std::uint8_t> encode_png8(const Image8& image);                  // 1, 3 or 4 channels
std::vector<std::uint8_t> encode_png16(const Image<std::uint16_t>& image);   // 1 channel

// A named channel of an EXR; data has width * height values.
struct ExrChannel {
  std::string name;  // "R", "depth.Z", ...
  const float* floats = nullptr;
  const std::uint32_t* ids = nullptr;  // instead of floats
  int stride = 1;                      // values from one pixel to the next
};
// ZIP compression in blocks of 16 rows (lossless); the bytes do not depend on the number of threads.
std::vector<std::uint8_t> encode_exr(int width, int height, const std::vector<ExrChannel>& channels);

// --- decoders for our own files, used by validate and neural; InputError names the file ---
Image8 decode_jpeg(const std::filesystem::path& file);
Image8 decode_png8(const std::filesystem::path& file);
Image<std::uint16_t> decode_png16(const std::filesystem::path& file);
struct ExrImage {
  int width = 0, height = 0;
  std::vector<std::string> names;        // alphabetical, as in the file
  std::vector<std::vector<float>> data;  // per channel (uint32 channels as ids instead)
  std::vector<std::vector<std::uint32_t>> ids;
  int channel(std::string_view name) const;  // -1 when absent
};
ExrImage decode_exr(const std::filesystem::path& file);

// --- any image by OpenImageIO: coats, textures, environment maps ---
Image8 read_image8(const std::filesystem::path& file);  // 1 to 4 channels as stored
Image8 read_image8(const std::vector<std::uint8_t>& bytes, const std::string& name);
ImageF read_imagef(const std::filesystem::path& file);  // linear floats (HDR, EXR); NaN and infinity are an InputError

// --- files ---
// Writes to a temporary name in the same folder, flushes and renames, so a partial file never has a final name.
// Makes the folder. RunError names the file and the system's reason (full disk, permission).
void write_file_atomically(const std::filesystem::path& file, const void* data, std::size_t size);
void write_file_atomically(const std::filesystem::path& file, const std::string& text);
// For writers that want a path: make(temporary) writes the file, which is then renamed. The temporary keeps the
// extension.
void make_file_atomically(const std::filesystem::path& file,
                          const std::function<void(const std::filesystem::path&)>& make);
// Writes all bytes to an open file; RunError names `file` and the system's reason.
void write_all(int descriptor, const std::filesystem::path& file, const void* data, std::size_t size);
bool is_temporary(const std::filesystem::path& file);                    // left behind by a killed run
std::vector<std::uint8_t> read_file(const std::filesystem::path& file);  // InputError when it cannot be read
std::string xxh64_hex(const void* data, std::size_t size);               // 16 hex digits

}  // namespace moomill
