// The maps of one view against each other.
#include <functional>

#include "generator/core/error.h"
#include "generator/dataset/codecs.h"
#include "validate/context.h"

namespace moomill {
namespace {

// The float channels of an EXR, interleaved; empty with a failure where they are not there.
ImageF interleaved(const ExrImage& exr, const std::vector<std::string>& names, const std::filesystem::path& file,
                   Check blame, Tally& tally) {
  ImageF out(exr.width, exr.height, static_cast<int>(names.size()));
  for (std::size_t c = 0; c < names.size(); ++c) {
    const int source = exr.channel(names[c]);
    if (source < 0 || exr.data[source].empty()) {
      tally.compared(blame);
      tally.failed(blame, fmt::format("{}: has no float channel \"{}\".", file.string(), names[c]));
      return {};
    }
    for (std::size_t i = 0; i < exr.data[source].size(); ++i) out.data[i * names.size() + c] = exr.data[source][i];
  }
  return out;
}

template <class T>
bool has_size(const Image<T>& image, const CameraRecord& camera, const std::filesystem::path& file, Tally& tally) {
  tally.compared(Check::sizes);
  if (image.width == camera.width && image.height == camera.height) return true;
  tally.failed(Check::sizes, fmt::format("{}: is {} x {} and its camera {} x {}.", file.string(), image.width,
                                         image.height, camera.width, camera.height));
  return false;
}

// Counts pixels where two supports differ; one failure a view, which names the first such pixel.
class SupportCheck {
 public:
  SupportCheck(Check check, const ViewData& data, Tally& tally) : check_(check), data_(data), tally_(tally) {
    tally_.compared(check, data.silhouette.data.size());
  }
  void differs(std::size_t pixel) {
    if (count_++ == 0) first_ = pixel;
  }
  void done(const std::string& what) const {
    if (count_ == 0) return;
    const std::size_t width = static_cast<std::size_t>(data_.silhouette.width);
    tally_.failed(check_, fmt::format("Frame {}, camera {}: {} at {} pixels, first at ({}, {}).", data_.view->frame,
                                      data_.view->camera, what, count_, first_ % width, first_ / width));
  }

 private:
  Check check_;
  const ViewData& data_;
  Tally& tally_;
  std::size_t count_ = 0, first_ = 0;
};

// Runs over all pixels; bad(pixel) says whether one is wrong.
template <class Bad>
void check_pixels(Check check, const ViewData& data, Tally& tally, const std::string& what, const Bad& bad) {
  SupportCheck support(check, data, tally);
  for (std::size_t i = 0; i < data.silhouette.data.size(); ++i)
    if (bad(i)) support.differs(i);
  support.done(what);
}

// Reads a file that a template names; what cannot be read is a failure of `files`.
template <class Body>
void reading(Tally& tally, const Body& body) {
  try {
    body();
  } catch (const InputError& e) {
    tally.compared(Check::files);
    tally.failed(Check::files, std::string(e.what()) + ".");
  }
}

void check_occlusion(const Context& context, const ViewData& data, Tally& tally) {
  const Manifest& m = context.dataset.manifest;
  const View& view = *data.view;
  ImageU32 covered(data.silhouette.width, data.silhouette.height, 1);
  for (int animal = 0; animal < static_cast<int>(view.occlusion.size()); ++animal) {
    const OcclusionView& o = view.occlusion[animal];
    const auto says = [&](const std::string& what) {
      tally.failed(Check::occlusion,
                   fmt::format("Frame {}, camera {}, animal {}: {}.", view.frame, view.camera, animal, what));
    };
    tally.compared(Check::occlusion);
    const double fraction = o.whole_pixels ? 1.0 - static_cast<double>(o.visible_pixels) / o.whole_pixels : 0.0;
    if (!(std::abs(fraction - o.hidden_fraction) < 1e-9))
      says(fmt::format("the hidden fraction is {} and should be {}", o.hidden_fraction, fraction));
    std::uint64_t by_others = 0;
    for (std::uint64_t pixels : o.occluded) by_others += pixels;
    if (o.visible_pixels > o.whole_pixels || by_others > o.whole_pixels - o.visible_pixels)
      says("more pixels are visible or hidden than the whole has");

    Image8 whole;
    reading(tally, [&] {
      const auto file = context.dataset.file(Modality::occlusion, view.frame, view.camera, -1, animal);
      whole = decode_png8(file);
      if (!has_size(whole, *data.camera, file, tally)) whole = {};
    });
    if (whole.empty() || whole.channels != 1) continue;
    // Which pixels are visibly of this animal: by instance, else by the silhouette where it can only be this one.
    const bool alone = m.animals.size() == 1 || (m.subset == Subset::occlusions && animal == labelled_animal);
    const auto visible = [&](std::size_t i) -> bool {
      return !data.instance.empty() ? data.instance.data[i] == animal + 1 : alone && data.foreground(i);
    };
    std::uint64_t whole_count = 0, visible_count = 0, outside = 0;
    for (std::size_t i = 0; i < whole.data.size(); ++i) {
      whole_count += whole.data[i] == 255;
      visible_count += visible(i);
      outside += visible(i) && whole.data[i] != 255;
      covered.data[i] |= whole.data[i];
    }
    tally.compared(Check::occlusion, whole.data.size());
    if (outside) says(fmt::format("{} visible pixels lie outside the whole mask", outside));
    const auto off = [](std::uint64_t a, std::uint64_t b) { return static_cast<double>(a > b ? a - b : b - a); };
    tally.worst(Check::occlusion, off(whole_count, o.whole_pixels));
    if (whole_count != o.whole_pixels)
      says(fmt::format("the whole mask has {} pixels and the record {}", whole_count, o.whole_pixels));
    if (!data.instance.empty() || alone) {
      tally.worst(Check::occlusion, off(visible_count, o.visible_pixels));
      if (visible_count != o.visible_pixels)
        says(fmt::format("{} pixels are visible and the record has {}", visible_count, o.visible_pixels));
    }
  }
}

void check_labels(const Context& context, const ViewData& data, Tally& tally) {
  const Manifest& m = context.dataset.manifest;
  const View& view = *data.view;
  const auto file = [&](Modality modality) { return context.dataset.file(modality, view.frame, view.camera); };
  const int labelled = labelled_animal;
  if (!data.instance.empty()) {
    // In `occlusions` the silhouette is of one animal, while the instance map shows all.
    check_pixels(Check::silhouette_labels, data, tally, "instance and silhouette disagree", [&](std::size_t i) {
      const int id = data.instance.data[i];
      return data.foreground(i) != (m.subset == Subset::occlusions ? id == labelled + 1 : id > 0);
    });
    check_pixels(Check::label_values, data, tally, "instance is no animal",
                 [&](std::size_t i) { return data.instance.data[i] > static_cast<int>(m.animals.size()); });
  }
  if (m.modalities.has(Modality::part))
    reading(tally, [&] {
      const Image<std::uint16_t> part = decode_png16(file(Modality::part));
      if (!has_size(part, *data.camera, file(Modality::part), tally) || part.channels != 1) return;
      check_pixels(Check::silhouette_labels, data, tally, "part and silhouette disagree",
                   [&](std::size_t i) { return data.foreground(i) != (part.data[i] > 0); });
      if (!m.part_names.empty())
        check_pixels(Check::label_values, data, tally, "part has no name in the manifest",
                     [&](std::size_t i) { return part.data[i] > m.part_names.size(); });
    });
  if (!data.triangle.empty()) {
    check_pixels(Check::silhouette_labels, data, tally, "triangle and silhouette disagree",
                 [&](std::size_t i) { return data.foreground(i) != (data.triangle.data[i] > 0); });
    check_pixels(Check::label_values, data, tally, "barycentrics lie outside their triangle", [&](std::size_t i) {
      const float u = data.barycentrics.data[2 * i], v = data.barycentrics.data[2 * i + 1];
      return !(u >= -1e-6f && v >= -1e-6f && u + v <= 1 + 1e-6f);
    });
  }
  if (m.modalities.has(Modality::normal))
    reading(tally, [&] {
      const ExrImage exr = decode_exr(file(Modality::normal));
      const ImageF normal = interleaved(exr, {"R", "G", "B"}, file(Modality::normal), Check::label_values, tally);
      if (normal.empty() || !has_size(normal, *data.camera, file(Modality::normal), tally)) return;
      const auto length = [&](std::size_t i) {
        return glm::length(dvec3(normal.data[3 * i], normal.data[3 * i + 1], normal.data[3 * i + 2]));
      };
      check_pixels(Check::silhouette_labels, data, tally, "normal and silhouette disagree",
                   [&](std::size_t i) { return data.foreground(i) != (length(i) > 0.5); });
      check_pixels(Check::label_values, data, tally, "normal has not unit length",
                   [&](std::size_t i) { return data.foreground(i) && !(std::abs(length(i) - 1) < 1e-4); });
    });
  if (m.modalities.has(Modality::uv))
    reading(tally, [&] {
      const ImageF uv =
          interleaved(decode_exr(file(Modality::uv)), {"u", "v"}, file(Modality::uv), Check::label_values, tally);
      if (uv.empty() || !has_size(uv, *data.camera, file(Modality::uv), tally)) return;
      check_pixels(Check::label_values, data, tally, "texture coordinates are not finite",
                   [&](std::size_t i) { return !std::isfinite(uv.data[2 * i]) || !std::isfinite(uv.data[2 * i + 1]); });
    });
  if (m.modalities.has(Modality::coverage))
    reading(tally, [&] {
      const Image8 coverage = decode_png8(file(Modality::coverage));
      tally.compared(Check::label_values);
      if (has_size(coverage, *data.camera, file(Modality::coverage), tally) && coverage.channels != 1)
        tally.failed(Check::label_values, file(Modality::coverage).string() + ": has more than one channel.");
    });
  if (m.modalities.has(Modality::rgb))
    for (int coat : m.coat_indices)
      reading(tally, [&] {
        const auto picture = context.dataset.file(Modality::rgb, view.frame, view.camera, coat);
        has_size(decode_jpeg(picture), *data.camera, picture, tally);
      });
}

}  // namespace

ViewData load_view(const Context& context, const View& view, const CameraRecord& camera, Tally& tally) {
  const Manifest& m = context.dataset.manifest;
  ViewData d;
  d.view = &view;
  d.camera = &camera;
  d.pinhole = pinhole_from_matrix(camera);
  const auto file = [&](Modality modality) { return context.dataset.file(modality, view.frame, view.camera); };
  if (m.modalities.has(Modality::silhouette))
    reading(tally, [&] {
      d.silhouette = decode_png8(file(Modality::silhouette));
      if (!has_size(d.silhouette, camera, file(Modality::silhouette), tally)) d.silhouette = {};
      if (d.silhouette.empty() || d.silhouette.channels == 1) return;
      tally.compared(Check::silhouette_values);
      tally.failed(Check::silhouette_values,
                   fmt::format("{}: has {} channels.", file(Modality::silhouette).string(), d.silhouette.channels));
      d.silhouette = {};
    });
  if (m.modalities.has(Modality::depth))
    reading(tally, [&] {
      d.depth = interleaved(decode_exr(file(Modality::depth)), {"R", "G", "B"}, file(Modality::depth),
                            Check::depth_planes, tally);
      if (!d.depth.empty() && !has_size(d.depth, camera, file(Modality::depth), tally)) d.depth = {};
    });
  if (m.modalities.has(Modality::nnopcs)) {
    reading(tally, [&] {
      d.nnopcs = interleaved(decode_exr(file(Modality::nnopcs)), {"R", "G", "B"}, file(Modality::nnopcs),
                             Check::silhouette_nnopcs, tally);
      if (!d.nnopcs.empty() && !has_size(d.nnopcs, camera, file(Modality::nnopcs), tally)) d.nnopcs = {};
    });
    reading(tally, [&] {
      const auto path = context.dataset.nnopcs8(view.frame, view.camera);
      d.nnopcs8 = decode_png8(path);
      tally.compared(Check::silhouette_nnopcs8);
      if (d.nnopcs8.channels != 3)
        tally.failed(Check::silhouette_nnopcs8, fmt::format("{}: has {} channels.", path.string(), d.nnopcs8.channels));
      if (!has_size(d.nnopcs8, camera, path, tally) || d.nnopcs8.channels != 3) d.nnopcs8 = {};
    });
  }
  if (m.modalities.has(Modality::instance))
    reading(tally, [&] {
      d.instance = decode_png8(file(Modality::instance));
      if (!has_size(d.instance, camera, file(Modality::instance), tally) || d.instance.channels != 1) d.instance = {};
    });
  if (m.modalities.has(Modality::triangle))
    reading(tally, [&] {
      const ExrImage exr = decode_exr(file(Modality::triangle));
      const int id = exr.channel("id");
      if (id < 0 || exr.ids[id].empty())
        input_error("{}: has no channel \"id\" of integers", file(Modality::triangle).string());
      d.barycentrics = interleaved(exr, {"u", "v"}, file(Modality::triangle), Check::label_values, tally);
      if (d.barycentrics.empty() || !has_size(d.barycentrics, camera, file(Modality::triangle), tally)) return;
      d.triangle = ImageU32(exr.width, exr.height, 1);
      d.triangle.data = exr.ids[id];
    });
  return d;
}

void check_maps(const Context& context, const ViewData& d, Tally& tally) {
  const Manifest& m = context.dataset.manifest;
  if (!d.depth.empty()) {
    tally.compared(Check::depth_planes, d.depth.data.size() / 3);
    std::size_t bad = 0;
    for (std::size_t i = 0; i < d.depth.data.size(); i += 3) {
      const float v = d.depth.data[i];
      bad += !(std::isfinite(v) && v >= 0 && d.depth.data[i + 1] == v && d.depth.data[i + 2] == v);
    }
    if (bad)
      tally.failed(Check::depth_planes,
                   fmt::format("Frame {}, camera {}: {} pixels have planes that differ, or are negative or not finite.",
                               d.view->frame, d.view->camera, bad));
  }
  if (d.silhouette.empty()) return;  // all else is held against the silhouette
  check_pixels(Check::silhouette_values, d, tally, "the mask is neither 0 nor 255",
               [&](std::size_t i) { return d.silhouette.data[i] != 0 && d.silhouette.data[i] != 255; });
  if (!d.depth.empty())
    check_pixels(Check::silhouette_depth, d, tally, "depth and silhouette disagree",
                 [&](std::size_t i) { return d.foreground(i) != (d.depth.data[3 * i] > 0); });
  if (!d.nnopcs8.empty()) {
    const std::uint8_t* v = d.nnopcs8.data.data();
    check_pixels(Check::silhouette_nnopcs8, d, tally, "8-bit NNOPCS and silhouette disagree", [&](std::size_t i) {
      return d.foreground(i) != (v[3 * i] > 0 || v[3 * i + 1] > 0 || v[3 * i + 2] > 0);
    });
    check_pixels(Check::nnopcs_zero, d, tally, "a foreground component is 0", [&](std::size_t i) {
      return d.foreground(i) && (v[3 * i] == 0 || v[3 * i + 1] == 0 || v[3 * i + 2] == 0);
    });
  }
  if (!d.nnopcs.empty())
    check_pixels(Check::silhouette_nnopcs, d, tally, "float NNOPCS lies outside the silhouette or outside [0, 1]",
                 [&](std::size_t i) {
                   bool bad = false;
                   for (std::size_t c = 0; c < 3; ++c) {
                     const float v = d.nnopcs.data[3 * i + c];
                     bad = bad || (d.foreground(i) ? !(v >= 0 && v <= 1) : v != 0);
                   }
                   return bad;
                 });
  if (!d.nnopcs.empty() && !d.nnopcs8.empty()) {
    double worst = 0;
    check_pixels(Check::nnopcs_half_step, d, tally, "8-bit and float NNOPCS are more than half a step apart",
                 [&](std::size_t i) {
                   bool bad = false;
                   if (d.foreground(i))
                     for (std::size_t c = 0; c < 3; ++c) {
                       const double exact = 255.0 * d.nnopcs.data[3 * i + c], stored = d.nnopcs8.data[3 * i + c];
                       if (stored == 1 && exact < 0.5) continue;  // written as 1 for the public loader's sake
                       worst = std::max(worst, std::abs(exact - stored));
                       bad = bad || !(std::abs(exact - stored) <= 0.5 + 1e-4);
                     }
                   return bad;
                 });
    tally.worst(Check::nnopcs_half_step, worst);
  }
  check_labels(context, d, tally);
  if (m.modalities.has(Modality::occlusion)) check_occlusion(context, d, tally);
}

}  // namespace moomill
