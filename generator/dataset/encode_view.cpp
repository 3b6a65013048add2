#include "generator/dataset/encode_view.h"

#include <algorithm>
#include <cmath>

#include "generator/core/error.h"
#include "generator/dataset/codecs.h"

namespace moomill {
namespace {

// Label images of up to 8 bits. Masks are 0 or 255 on disk, whatever non-zero value marks the foreground.
Image8 labels8(const Map& map) {
  Image8 out(map.u.width, map.u.height, 1);
  const bool mask = map.modality == Modality::silhouette || map.modality == Modality::occlusion;
  for (std::size_t i = 0; i < out.data.size(); ++i) {
    const std::uint32_t v = map.u.data[i];
    if (!mask && v > 255)
      run_error("modality {} has the value {}, more than 8 bits hold; use fewer animals", row(map.modality).name, v);
    out.data[i] = mask ? (v ? 255 : 0) : static_cast<std::uint8_t>(v);
  }
  return out;
}

Image8 fraction8(const ImageF& f) {
  Image8 out(f.width, f.height, 1);
  for (std::size_t i = 0; i < out.data.size(); ++i)
    out.data[i] = static_cast<std::uint8_t>(std::min(std::max(f.data[i * f.channels], 0.0f), 1.0f) * 255.0f + 0.5f);
  return out;
}

Image<std::uint16_t> labels16(const Map& map) {
  Image<std::uint16_t> out(map.u.width, map.u.height, 1);
  for (std::size_t i = 0; i < out.data.size(); ++i) {
    if (map.u.data[i] > 65535)
      run_error("modality {} has the value {}, more than 16 bits hold; use fewer parts", row(map.modality).name,
                map.u.data[i]);
    out.data[i] = static_cast<std::uint16_t>(map.u.data[i]);
  }
  return out;
}

// Where the NNOPCS map has a surface: the silhouette of the same animal or of the view; without one, any component.
ImageU32 foreground(const View& view, const Map& nnopcs) {
  const Map* silhouette = view.find(Modality::silhouette, -1, nnopcs.animal);
  if (!silhouette) silhouette = view.find(Modality::silhouette);
  ImageU32 mask(nnopcs.f.width, nnopcs.f.height, 1);
  for (std::size_t i = 0; i < mask.data.size(); ++i) {
    const float* v = nnopcs.f.data.data() + 3 * i;
    // With several animals the silhouette may be of one of them while NNOPCS has all: either will do.
    mask.data[i] = (silhouette && silhouette->u.data[i]) || v[0] > 0 || v[1] > 0 || v[2] > 0;
  }
  return mask;
}

}  // namespace

std::vector<std::uint8_t> encode_map_exr(const Map& map) {
  const std::vector<std::string> names = exr_channel_names(map.modality);
  std::vector<ExrChannel> channels;
  if (row(map.modality).storage == Storage::exr_ids) {
    check(map.f.channels == 2 && map.u.channels == 1, "ids come with two barycentrics");
    channels.push_back({names[0], nullptr, map.u.data.data(), 1});
    for (int c = 0; c < 2; ++c) channels.push_back({names[c + 1], map.f.data.data() + c, nullptr, 2});
    return encode_exr(map.f.width, map.f.height, channels);
  }
  for (int c = 0; c < static_cast<int>(names.size()); ++c) {
    const int source = std::min(c, map.f.channels - 1);  // depth: one plane as R, G and B
    channels.push_back({names[c], map.f.data.data() + source, nullptr, map.f.channels});
  }
  return encode_exr(map.f.width, map.f.height, channels);
}

std::vector<EncodedFile> encode_map(const Manifest& manifest, const View& view, const Map& map) {
  const ModalityRow& r = row(map.modality);
  const auto path = [&](const std::string& path_of) { return expand_template(path_of, view.frame, view.camera); };
  const std::string main_path = path(path_template(manifest, map.modality, map.coat, map.animal));
  std::vector<EncodedFile> out;
  switch (r.storage) {
    case Storage::jpeg8:
      out.push_back({main_path, encode_jpeg(to_srgb8(map.f, view.background))});
      break;
    case Storage::png8:
      out.push_back({main_path, encode_png8(map.u.empty() ? fraction8(map.f) : labels8(map))});
      break;
    case Storage::png16:
      out.push_back({main_path, encode_png16(labels16(map))});
      break;
    case Storage::exr32:
    case Storage::exr_ids:
      out.push_back({main_path, encode_map_exr(map)});
      break;
    case Storage::record:
      break;
  }
  if (map.modality == Modality::nnopcs)
    out.push_back({path(nnopcs8_template(manifest)), encode_png8(nnopcs_to_8bit(map.f, foreground(view, map)))});
  return out;
}

}  // namespace moomill
