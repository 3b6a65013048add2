// JPEG by libjpeg-turbo.
#include <turbojpeg.h>

#include "generator/core/error.h"
#include "generator/dataset/codecs.h"

namespace moomill {
namespace {

// One (de)compressor per thread; making one costs more than a small image.
struct Handle {
  tjhandle handle;
  explicit Handle(tjhandle h) : handle(h) {}
  ~Handle() {
    if (handle) tjDestroy(handle);
  }
  Handle(const Handle&) = delete;
  Handle& operator=(const Handle&) = delete;
};

}  // namespace

std::vector<std::uint8_t> encode_jpeg(const Image8& rgb, int quality) {
  check(rgb.channels == 3 && rgb.width > 0 && rgb.height > 0, "a JPEG needs three channels");
  thread_local Handle compressor(tjInitCompress());
  check(compressor.handle != nullptr, "libjpeg-turbo gave no compressor");
  unsigned long size = tjBufSize(rgb.width, rgb.height, TJSAMP_444);
  std::vector<std::uint8_t> bytes(size);
  std::uint8_t* buffer = bytes.data();
  // The accurate DCT: the same bits from the SIMD and the plain code.
  if (tjCompress2(compressor.handle, rgb.data.data(), rgb.width, 0, rgb.height, TJPF_RGB, &buffer, &size, TJSAMP_444,
                  quality, TJFLAG_NOREALLOC | TJFLAG_ACCURATEDCT) != 0)
    run_error("a JPEG of {} x {} pixels cannot be encoded: {}; use a resolution of at most 65500 pixels a side",
              rgb.width, rgb.height, tjGetErrorStr2(compressor.handle));
  bytes.resize(size);
  return bytes;
}

Image8 decode_jpeg(const std::filesystem::path& file) {
  const std::vector<std::uint8_t> bytes = read_file(file);
  thread_local Handle decompressor(tjInitDecompress());
  check(decompressor.handle != nullptr, "libjpeg-turbo gave no decompressor");
  int width = 0, height = 0, sampling = 0, space = 0;
  if (bytes.empty() ||
      tjDecompressHeader3(decompressor.handle, bytes.data(), bytes.size(), &width, &height, &sampling, &space) != 0)
    input_error("{}: is not a JPEG: {}; make the file anew", file.string(),
                bytes.empty() ? "it is empty" : tjGetErrorStr2(decompressor.handle));
  Image8 image(width, height, 3);
  // Warnings (a truncated file) count as errors: half an image is not ground truth.
  if (tjDecompress2(decompressor.handle, bytes.data(), bytes.size(), image.data.data(), width, 0, height, TJPF_RGB,
                    TJFLAG_ACCURATEDCT) != 0)
    input_error("{}: is damaged: {}; make the file anew", file.string(), tjGetErrorStr2(decompressor.handle));
  return image;
}

}  // namespace moomill
