// EXR by OpenEXR. The container is the library's; blocks are packed here, in the ZIP layout of the format, because
// libdeflate is faster than the zlib inside the library.
#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfIO.h>
#include <ImfInputFile.h>
#include <ImfThreading.h>
#include <libdeflate.h>
#include <openexr.h>

#include <algorithm>
#include <cstring>
#include <memory>

#include "generator/core/error.h"
#include "generator/dataset/codecs.h"

namespace moomill {
namespace {

constexpr int deflate_level = 1;    // level 6 saves 1 to 2 % of the bytes for up to a quarter more time
constexpr int rows_per_block = 16;  // of ZIP compression, fixed by the format
constexpr std::int64_t largest_image = std::int64_t{1} << 28;  // pixels; a damaged header must not eat the memory

struct Compressor {
  libdeflate_compressor* handle = libdeflate_alloc_compressor(deflate_level);
  std::vector<std::uint8_t> raw, sorted, packed;  // one block each, kept from call to call
  Compressor() = default;
  ~Compressor() { libdeflate_free_compressor(handle); }
  Compressor(const Compressor&) = delete;
  Compressor& operator=(const Compressor&) = delete;

  // The ZIP transform of OpenEXR (Technical Introduction to OpenEXR, "ZIP"): even bytes, then odd bytes, then the
  // difference to the byte before, plus 128; then zlib. Returns the bytes to store: raw ones where packing gains
  // nothing.
  std::pair<const void*, std::size_t> pack(std::size_t size) {
    sorted.resize(size);
    const std::size_t half = (size + 1) / 2;
    for (std::size_t i = 0; i < size / 2; ++i) {
      sorted[i] = raw[2 * i];
      sorted[half + i] = raw[2 * i + 1];
    }
    if (size % 2) sorted[half - 1] = raw[size - 1];
    packed.resize(size + 16);
    std::vector<std::uint8_t>& delta = predicted;
    delta.resize(size);
    if (size > 0) delta[0] = sorted[0];
    for (std::size_t i = 1; i < size; ++i) delta[i] = static_cast<std::uint8_t>(sorted[i] - sorted[i - 1] + 128);
    const std::size_t got = libdeflate_zlib_compress(handle, delta.data(), size, packed.data(), size);
    if (got == 0 || got >= size) return {raw.data(), size};
    return {packed.data(), got};
  }

 private:
  std::vector<std::uint8_t> predicted;
};

void ok(exr_result_t result, const char* what) {
  if (result != EXR_ERR_SUCCESS)
    run_error("an EXR cannot be encoded: {}: {}", what, exr_get_default_error_message(result));
}

std::int64_t write_to_vector(exr_const_context_t, void* user, const void* buffer, std::uint64_t size,
                             std::uint64_t offset, exr_stream_error_func_ptr_t) {
  auto& out = *static_cast<std::vector<std::uint8_t>*>(user);
  if (offset + size > out.size()) out.resize(offset + size);
  std::memcpy(out.data() + offset, buffer, size);
  return static_cast<std::int64_t>(size);
}

void silent(exr_const_context_t, exr_result_t, const char*) {}

// A file in memory for the reader.
class MemoryStream : public Imf::IStream {
 public:
  MemoryStream(const std::string& name, const std::vector<std::uint8_t>& bytes)
      : IStream(name.c_str()), bytes_(bytes) {}
  bool isMemoryMapped() const override { return false; }
  bool read(char out[], int count) override {
    if (count < 0 || at_ > bytes_.size() || static_cast<std::size_t>(count) > bytes_.size() - at_)
      throw std::runtime_error("it ends too early");
    std::memcpy(out, bytes_.data() + at_, static_cast<std::size_t>(count));
    at_ += static_cast<std::size_t>(count);
    return at_ < bytes_.size();
  }
  std::uint64_t tellg() override { return at_; }
  void seekg(std::uint64_t position) override { at_ = position; }
  void clear() override {}

 private:
  const std::vector<std::uint8_t>& bytes_;
  std::uint64_t at_ = 0;
};

}  // namespace

std::vector<std::uint8_t> encode_exr(int width, int height, const std::vector<ExrChannel>& channels) {
  check(width > 0 && height > 0 && !channels.empty(), "an EXR needs pixels and channels");
  std::vector<const ExrChannel*> sorted;
  for (const ExrChannel& c : channels) sorted.push_back(&c);
  std::sort(sorted.begin(), sorted.end(), [](const auto* a, const auto* b) { return a->name < b->name; });

  thread_local Compressor compressor;
  check(compressor.handle != nullptr, "libdeflate gave no compressor");
  std::vector<std::uint8_t> out;
  out.reserve(std::size_t{1} << 20);

  exr_context_initializer_t initializer = EXR_DEFAULT_CONTEXT_INITIALIZER;
  initializer.user_data = &out;
  initializer.write_fn = write_to_vector;
  initializer.error_handler_fn = silent;
  exr_context_t context = nullptr;
  ok(exr_start_write(&context, "memory", EXR_WRITE_FILE_DIRECTLY, &initializer), "start");
  struct Finish {
    exr_context_t* context;
    ~Finish() {
      if (*context) exr_finish(context);
    }
  } finish{&context};
  int part = 0;
  ok(exr_add_part(context, "image", EXR_STORAGE_SCANLINE, &part), "part");
  ok(exr_initialize_required_attr_simple(context, part, width, height, EXR_COMPRESSION_ZIP), "header");
  for (const ExrChannel* c : sorted)
    ok(exr_add_channel(context, part, c->name.c_str(), c->ids ? EXR_PIXEL_UINT : EXR_PIXEL_FLOAT,
                       EXR_PERCEPTUALLY_LOGARITHMIC, 1, 1),
       c->name.c_str());
  ok(exr_write_header(context), "header");

  const std::size_t row_bytes = static_cast<std::size_t>(width) * 4;
  std::vector<std::uint8_t> blank;  // the packed form of an all-zero block: most of a view is background
  for (int y0 = 0; y0 < height; y0 += rows_per_block) {
    const int rows = std::min(rows_per_block, height - y0);
    const std::size_t size = row_bytes * sorted.size() * rows;
    compressor.raw.resize(size);
    std::uint8_t* at = compressor.raw.data();
    std::uint32_t any = 0;
    for (int y = y0; y < y0 + rows; ++y)
      for (const ExrChannel* c : sorted) {
        const std::size_t first = static_cast<std::size_t>(y) * width * c->stride;
        const void* source = c->ids ? static_cast<const void*>(c->ids + first) : c->floats + first;
        if (c->stride == 1) {
          std::memcpy(at, source, row_bytes);
        } else {
          const char* p = static_cast<const char*>(source);
          const std::size_t step = 4 * static_cast<std::size_t>(c->stride);
          for (int x = 0; x < width; ++x) std::memcpy(at + 4 * static_cast<std::size_t>(x), p + step * x, 4);
        }
        for (int x = 0; x < width; ++x) {
          std::uint32_t v;
          std::memcpy(&v, at + 4 * static_cast<std::size_t>(x), 4);
          any |= v;
        }
        at += row_bytes;
      }
    const bool cacheable = any == 0 && rows == rows_per_block;
    if (cacheable && !blank.empty()) {
      ok(exr_write_scanline_chunk(context, part, y0, blank.data(), blank.size()), "block");
      continue;
    }
    const auto [data, bytes] = compressor.pack(size);
    ok(exr_write_scanline_chunk(context, part, y0, data, bytes), "block");
    if (cacheable) blank.assign(static_cast<const std::uint8_t*>(data), static_cast<const std::uint8_t*>(data) + bytes);
  }
  ok(exr_finish(&context), "end");  // writes the table of blocks
  return out;
}

int ExrImage::channel(std::string_view name) const {
  const auto found = std::find(names.begin(), names.end(), name);
  return found == names.end() ? -1 : static_cast<int>(found - names.begin());
}

ExrImage decode_exr(const std::filesystem::path& file) {
  const std::vector<std::uint8_t> bytes = read_file(file);
  try {
    static const bool single_threaded = (Imf::setGlobalThreadCount(0), true);  // threads are ours, not the library's
    (void)single_threaded;
    MemoryStream stream(file.string(), bytes);
    Imf::InputFile input(stream, 0);
    const Imath::Box2i window = input.header().dataWindow();
    const std::int64_t width = std::int64_t{window.max.x} - window.min.x + 1;
    const std::int64_t height = std::int64_t{window.max.y} - window.min.y + 1;
    if (width <= 0 || height <= 0 || width > largest_image || height > largest_image || width * height > largest_image)
      throw std::runtime_error("its size is not plausible");
    ExrImage image;
    image.width = static_cast<int>(width);
    image.height = static_cast<int>(height);
    const std::size_t count = static_cast<std::size_t>(width * height);
    Imf::FrameBuffer buffer;
    const Imf::ChannelList& list = input.header().channels();
    for (auto c = list.begin(); c != list.end(); ++c) {
      if (c.channel().xSampling != 1 || c.channel().ySampling != 1)
        throw std::runtime_error("it has subsampled channels");
      image.names.emplace_back(c.name());
      image.data.emplace_back();
      image.ids.emplace_back();
      const bool ids = c.channel().type == Imf::UINT;
      char* base = nullptr;
      if (ids) {
        image.ids.back().resize(count);
        base = reinterpret_cast<char*>(image.ids.back().data());
      } else {
        image.data.back().resize(count);
        base = reinterpret_cast<char*>(image.data.back().data());
      }
      base -= 4 * (window.min.x + window.min.y * width);
      buffer.insert(c.name(), Imf::Slice(ids ? Imf::UINT : Imf::FLOAT, base, 4, 4 * static_cast<std::size_t>(width)));
    }
    input.setFrameBuffer(buffer);
    input.readPixels(window.min.y, window.max.y);
    return image;
  } catch (const std::exception& e) {
    input_error("{}: is not a readable EXR: {}; make the file anew", file.string(), e.what());
  }
}

}  // namespace moomill
