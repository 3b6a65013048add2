// PNG: written by hand on libdeflate, which is faster than the zlib inside libpng (masks and 8-bit maps are half the
// files of a geometry-only run); read by libpng.
#include <libdeflate.h>
#include <png.h>

#include <csetjmp>
#include <cstring>
#include <memory>

#include "generator/core/error.h"
#include "generator/dataset/codecs.h"

namespace moomill {
namespace {

constexpr int deflate_level =
    1;  // level 6 saves 2 to 4 % of the bytes for up to a quarter more time (tests/bench/codecs.cpp)

void put32(std::vector<std::uint8_t>& out, std::uint32_t v) {
  for (int shift = 24; shift >= 0; shift -= 8) out.push_back(static_cast<std::uint8_t>(v >> shift));
}

void store32(std::uint8_t* out, std::uint32_t v) {
  for (int i = 0; i < 4; ++i) out[i] = static_cast<std::uint8_t>(v >> (24 - 8 * i));
}

void put_chunk(std::vector<std::uint8_t>& out, const char (&type)[5], const std::uint8_t* data, std::size_t size) {
  put32(out, static_cast<std::uint32_t>(size));
  const std::size_t start = out.size();
  out.insert(out.end(), type, type + 4);
  out.insert(out.end(), data, data + size);
  put32(out, libdeflate_crc32(0, out.data() + start, size + 4));
}

// rows: big-endian samples, `stride` bytes a row, `pixel` bytes a pixel. Every row takes filter Up (difference to the
// row above), the first row Sub: on label images that is as good as the usual heuristics and vectorises to nothing.
std::vector<std::uint8_t> encode(int width, int height, int bit_depth, int channels, const std::uint8_t* rows,
                                 std::size_t stride, std::size_t pixel) {
  check(width > 0 && height > 0, "a PNG needs pixels");
  std::vector<std::uint8_t> filtered((stride + 1) * height);
  for (int y = 0; y < height; ++y) {
    const std::uint8_t* row = rows + stride * y;
    std::uint8_t* out = filtered.data() + (stride + 1) * y;
    if (y == 0) {
      *out++ = 1;
      std::memcpy(out, row, pixel);
      for (std::size_t i = pixel; i < stride; ++i) out[i] = static_cast<std::uint8_t>(row[i] - row[i - pixel]);
    } else {
      *out++ = 2;
      const std::uint8_t* above = row - stride;
      for (std::size_t i = 0; i < stride; ++i) out[i] = static_cast<std::uint8_t>(row[i] - above[i]);
    }
  }
  struct Free {
    void operator()(libdeflate_compressor* c) const { libdeflate_free_compressor(c); }
  };
  thread_local const std::unique_ptr<libdeflate_compressor, Free> compressor(
      libdeflate_alloc_compressor(deflate_level));
  check(compressor != nullptr, "libdeflate gave no compressor");

  static constexpr std::uint8_t signature[8] = {0x89, 'P', 'N', 'G', '\r', '\n', 0x1a, '\n'};
  std::vector<std::uint8_t> out(signature, signature + 8);
  std::uint8_t header[13] = {};
  store32(header, static_cast<std::uint32_t>(width));
  store32(header + 4, static_cast<std::uint32_t>(height));
  header[8] = static_cast<std::uint8_t>(bit_depth);
  header[9] = channels == 1 ? PNG_COLOR_TYPE_GRAY : channels == 3 ? PNG_COLOR_TYPE_RGB : PNG_COLOR_TYPE_RGB_ALPHA;
  put_chunk(out, "IHDR", header, sizeof header);

  // The data chunk is compressed in place: length and type before it, checksum after it.
  const std::size_t bound = libdeflate_zlib_compress_bound(compressor.get(), filtered.size());
  const std::size_t start = out.size();
  out.resize(start + 8 + bound + 16);
  const std::size_t size =
      libdeflate_zlib_compress(compressor.get(), filtered.data(), filtered.size(), out.data() + start + 8, bound);
  check(size > 0, "libdeflate ran out of its own bound");
  store32(out.data() + start, static_cast<std::uint32_t>(size));
  std::memcpy(out.data() + start + 4, "IDAT", 4);
  out.resize(start + 8 + size);
  put32(out, libdeflate_crc32(0, out.data() + start + 4, size + 4));
  put_chunk(out, "IEND", nullptr, 0);
  return out;
}

// What libpng's callbacks share.
struct Reading {
  const std::uint8_t* data;
  std::size_t size, at;
  char message[128];
};

void read_bytes(png_structp png, png_bytep out, png_size_t count) {
  auto* reading = static_cast<Reading*>(png_get_io_ptr(png));
  if (count > reading->size - reading->at) png_error(png, "it ends too early");
  std::memcpy(out, reading->data + reading->at, count);
  reading->at += count;
}

void on_error(png_structp png, png_const_charp message) {
  auto* reading = static_cast<Reading*>(png_get_error_ptr(png));
  std::snprintf(reading->message, sizeof reading->message, "%s", message);
  png_longjmp(png, 1);
}

void on_warning(png_structp, png_const_charp) {}

struct Header {
  png_uint_32 width = 0, height = 0;
  int bit_depth = 0, color_type = 0, channels = 0;
};

// libpng leaves by longjmp, so nothing with a destructor is made between setjmp and the end of this function: it is
// called twice, first for the header, then with the caller's rows. Returns false with the message in `reading`.
bool read_png(Reading& reading, Header& header, png_bytep* rows, int wanted_depth) {
  png_structp png = png_create_read_struct(PNG_LIBPNG_VER_STRING, &reading, on_error, on_warning);
  png_infop info = png ? png_create_info_struct(png) : nullptr;
  if (!info) {
    png_destroy_read_struct(&png, nullptr, nullptr);
    std::snprintf(reading.message, sizeof reading.message, "out of memory");
    return false;
  }
  if (setjmp(png_jmpbuf(png))) {
    png_destroy_read_struct(&png, &info, nullptr);
    return false;
  }
  png_set_read_fn(png, &reading, read_bytes);
  png_read_info(png, info);
  png_get_IHDR(png, info, &header.width, &header.height, &header.bit_depth, &header.color_type, nullptr, nullptr,
               nullptr);
  if (wanted_depth == 8) png_set_expand(png);  // palettes and 1-bit masks of other writers
  if (wanted_depth == 16) png_set_swap(png);   // to little-endian
  png_read_update_info(png, info);
  header.channels = png_get_channels(png, info);
  if (rows) {
    png_read_image(png, rows);
    png_read_end(png, nullptr);
  }
  png_destroy_read_struct(&png, &info, nullptr);
  return true;
}

template <class T>
Image<T> decode(const std::filesystem::path& file, int wanted_depth) {
  const std::vector<std::uint8_t> bytes = read_file(file);
  Reading reading{bytes.data(), bytes.size(), 0, {}};
  Header header;
  if (!read_png(reading, header, nullptr, wanted_depth))
    input_error("{}: is not a PNG: {}; make the file anew", file.string(), reading.message);
  if ((header.bit_depth == 16) != (wanted_depth == 16))
    input_error("{}: has {} bits a channel where {} are expected; make the file anew", file.string(), header.bit_depth,
                wanted_depth);
  Image<T> image(static_cast<int>(header.width), static_cast<int>(header.height), header.channels);
  std::vector<png_bytep> rows(header.height);
  for (png_uint_32 y = 0; y < header.height; ++y)
    rows[y] = reinterpret_cast<png_bytep>(image.data.data() + image.index(0, static_cast<int>(y)));
  reading.at = 0;
  if (!read_png(reading, header, rows.data(), wanted_depth))
    input_error("{}: is damaged: {}; make the file anew", file.string(), reading.message);
  return image;
}

}  // namespace

std::vector<std::uint8_t> encode_png8(const Image8& image) {
  check(image.channels == 1 || image.channels == 3 || image.channels == 4, "a PNG has 1, 3 or 4 channels");
  const std::size_t pixel = static_cast<std::size_t>(image.channels);
  return encode(image.width, image.height, 8, image.channels, image.data.data(), pixel * image.width, pixel);
}

std::vector<std::uint8_t> encode_png16(const Image<std::uint16_t>& image) {
  check(image.channels == 1, "a 16-bit PNG has one channel here");
  std::vector<std::uint8_t> rows(image.data.size() * 2);
  for (std::size_t i = 0; i < image.data.size(); ++i) {
    rows[2 * i] = static_cast<std::uint8_t>(image.data[i] >> 8);
    rows[2 * i + 1] = static_cast<std::uint8_t>(image.data[i]);
  }
  return encode(image.width, image.height, 16, 1, rows.data(), 2 * static_cast<std::size_t>(image.width), 2);
}

Image8 decode_png8(const std::filesystem::path& file) {
  return decode<std::uint8_t>(file, 8);
}

Image<std::uint16_t> decode_png16(const std::filesystem::path& file) {
  return decode<std::uint16_t>(file, 16);
}

}  // namespace moomill
