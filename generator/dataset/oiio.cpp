// Images of any kind by OpenImageIO: coats, textures, environment maps. The only file that includes it.
#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>

#include <algorithm>
#include <cmath>
#include <memory>

#include "generator/core/error.h"
#include "generator/dataset/codecs.h"

namespace moomill {
namespace {

// Libraries report in paragraphs; our messages are one sentence.
std::string first_line(const std::string& text) { return text.substr(0, text.find('\n')); }

constexpr std::int64_t largest_image = std::int64_t{1} << 28;  // pixels

template <class T>
Image<T> read(const std::string& name, OIIO::Filesystem::IOProxy* proxy, OIIO::TypeDesc type) {
  OIIO::ImageSpec config;
  config["oiio:UnassociatedAlpha"] = 1;  // colours as stored, not multiplied by alpha
  if (proxy) config.attribute("oiio:ioproxy", OIIO::TypeDesc::PTR, &proxy);  // with a configuration it must be in there
  std::unique_ptr<OIIO::ImageInput> input = OIIO::ImageInput::open(name, &config, proxy);
  if (!input) {
    std::string why = OIIO::geterror();
    if (const auto line_end = why.find('\n'); line_end != std::string::npos) why.resize(line_end);
    input_error("{}: is not a readable image: {}; convert it to PNG, JPEG, TIFF, HDR or EXR", name, why);
  }
  const OIIO::ImageSpec& spec = input->spec();
  if (spec.width <= 0 || spec.height <= 0 || std::int64_t{spec.width} * spec.height > largest_image)
    input_error("{}: has an implausible size of {} x {}; use at most {} pixels", name, spec.width, spec.height,
                largest_image);
  const int channels = std::min(spec.nchannels, 4);
  Image<T> image(spec.width, spec.height, channels);
  if (!input->read_image(0, 0, 0, channels, type, image.data.data()))
    input_error("{}: is damaged: {}; get the file anew", name, first_line(input->geterror()));
  input->close();
  return image;
}

// OpenImageIO chooses the codec by the extension first; data without one is tried by content.
std::string name_with_extension(const std::vector<std::uint8_t>& bytes, const std::string& name) {
  const auto starts = [&](std::initializer_list<std::uint8_t> magic) {
    return bytes.size() >= magic.size() && std::equal(magic.begin(), magic.end(), bytes.begin());
  };
  const char* extension = starts({0x89, 'P', 'N', 'G'})      ? ".png"
                          : starts({0xff, 0xd8})             ? ".jpg"
                          : starts({'I', 'I', 42, 0})        ? ".tif"
                          : starts({'M', 'M', 0, 42})        ? ".tif"
                          : starts({'R', 'I', 'F', 'F'})     ? ".webp"
                          : starts({'B', 'M'})               ? ".bmp"
                          : starts({'#', '?'})               ? ".hdr"
                          : starts({0x76, 0x2f, 0x31, 0x01}) ? ".exr"
                          : starts({'D', 'D', 'S', ' '})     ? ".dds"
                                                             : "";
  return name.ends_with(extension) ? name : name + extension;
}

}  // namespace

Image8 read_image8(const std::filesystem::path& file) {
  const std::vector<std::uint8_t> bytes = read_file(file);
  return read_image8(bytes, file.string());
}

Image8 read_image8(const std::vector<std::uint8_t>& bytes, const std::string& name) {
  if (bytes.empty()) input_error("{}: is empty; get the file anew", name);
  // OpenImageIO gives a JPEG that is cut short its missing half in grey; whole ones have an end marker.
  if (bytes.size() > 2 && bytes[0] == 0xff && bytes[1] == 0xd8) {
    constexpr std::uint8_t end_marker[] = {0xff, 0xd9};
    const auto tail = bytes.end() - static_cast<std::ptrdiff_t>(std::min<std::size_t>(bytes.size(), 65536));
    if (std::search(tail, bytes.end(), end_marker, end_marker + 2) == bytes.end())
      input_error("{}: is damaged: it ends too early; get the file anew", name);
  }
  OIIO::Filesystem::IOMemReader proxy(const_cast<std::uint8_t*>(bytes.data()), bytes.size());
  return read<std::uint8_t>(name_with_extension(bytes, name), &proxy, OIIO::TypeDesc::UINT8);
}

ImageF read_imagef(const std::filesystem::path& file) {
  read_file(file);  // for the plain message where it is missing
  ImageF image = read<float>(file.string(), nullptr, OIIO::TypeDesc::FLOAT);
  for (std::size_t i = 0; i < image.data.size(); ++i)
    if (!std::isfinite(image.data[i])) {
      const std::size_t pixel = i / image.channels;
      input_error("{}: pixel ({}, {}) is not finite; mend the file, light must be finite", file.string(),
                  pixel % image.width, pixel / image.width);
    }
  return image;
}

}  // namespace moomill
