#include "generator/dataset/contact_sheet.h"

#include <set>

#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "generator/dataset/codecs.h"
#include "generator/dataset/draw.h"
#include "generator/dataset/reader.h"

namespace moomill {
namespace {

constexpr Color8 left_color{90, 170, 255}, right_color{255, 90, 80}, middle_color{255, 220, 60},
    edge_color{230, 230, 230};
constexpr Color8 paper{24, 24, 28}, ink{235, 235, 235};
constexpr int gap = 4;

}  // namespace

Color8 color_of_id(std::uint32_t id) {
  if (id == 0) return {0, 0, 0};
  const double hue = std::fmod(id * 0.6180339887498949, 1.0) * 6, level = id % 2 ? 1.0 : 0.7;
  Color8 out{};
  for (int c = 0; c < 3; ++c) {
    const double wave = std::clamp(std::abs(std::fmod(hue + 2 * (3 - c), 6.0) - 3) - 1, 0.0, 1.0);
    out[c] = static_cast<std::uint8_t>(255 * level * (0.15 + 0.85 * wave));
  }
  return out;
}

namespace {

Image8 to_rgb(const Image8& image) {
  if (image.channels == 3) return image;
  Image8 out(image.width, image.height, 3);
  for (std::size_t i = 0; i < out.data.size(); ++i)
    out.data[i] = image.data[i / 3 * image.channels + (image.channels == 4 ? i % 3 : 0)];
  return out;
}

const std::vector<float>& plane(const ExrImage& image, const char* name, const std::filesystem::path& file) {
  const int c = image.channel(name);
  if (c < 0 || image.data[c].empty())
    input_error("{}: has no float channel \"{}\"; make the file anew", file.string(), name);
  return image.data[c];
}

// Near is bright; the range is that of the view.
Image8 show_depth(const std::filesystem::path& file) {
  const ExrImage exr = decode_exr(file);
  const std::vector<float>& depth = plane(exr, "R", file);
  float near = std::numeric_limits<float>::infinity(), far = 0;
  for (float d : depth)
    if (d > 0) near = std::min(near, d), far = std::max(far, d);
  Image8 out(exr.width, exr.height, 3);
  for (std::size_t i = 0; i < depth.size(); ++i) {
    if (!(depth[i] > 0)) continue;
    const double t = far > near ? (depth[i] - near) / (far - near) : 0;
    const double ramp[3] = {1.0 - 0.8 * t, 0.95 - 0.75 * t * t, 0.5 + 0.4 * std::sin(pi * t)};
    for (int c = 0; c < 3; ++c) out.data[3 * i + c] = static_cast<std::uint8_t>(255 * std::clamp(ramp[c], 0.0, 1.0));
  }
  return out;
}

// scale * value + shift as RGB; pixels where all channels are at the background stay black.
Image8 show_vectors(const std::filesystem::path& file, const std::vector<std::string>& names, float background,
                    float scale, float shift) {
  const ExrImage exr = decode_exr(file);
  Image8 out(exr.width, exr.height, 3);
  for (std::size_t i = 0; i < out.data.size() / 3; ++i) {
    bool any = false;
    for (const std::string& name : names) any = any || plane(exr, name.c_str(), file)[i] != background;
    if (!any) continue;
    for (std::size_t c = 0; c < names.size(); ++c)
      out.data[3 * i + c] = static_cast<std::uint8_t>(
          255 * std::clamp(scale * plane(exr, names[c].c_str(), file)[i] + shift, 0.0f, 1.0f) + 0.5f);
  }
  return out;
}

template <class Ids>
Image8 show_ids(int width, int height, const Ids& ids) {
  Image8 out(width, height, 3);
  for (std::size_t i = 0; i < static_cast<std::size_t>(width) * height; ++i) {
    const Color8 color = color_of_id(static_cast<std::uint32_t>(ids[i]));
    for (int c = 0; c < 3; ++c) out.data[3 * i + c] = color[c];
  }
  return out;
}

Image8 show(const DatasetFolder& d, Modality modality, int frame, int camera, int coat, int animal) {
  const std::filesystem::path file = d.file(modality, frame, camera, coat, animal);
  switch (modality) {
    case Modality::rgb:
      return decode_jpeg(file);
    case Modality::depth:
      return show_depth(file);
    case Modality::nnopcs:
      return show_vectors(file, exr_channel_names(modality), 0, 1, 0);
    case Modality::normal:
      return show_vectors(file, exr_channel_names(modality), 0, 0.5f, 0.5f);
    case Modality::uv:
      return show_vectors(file, exr_channel_names(modality), -1, 1, 0);
    case Modality::part: {
      const Image<std::uint16_t> image = decode_png16(file);
      return show_ids(image.width, image.height, image.data);
    }
    case Modality::instance: {
      const Image8 image = decode_png8(file);
      return show_ids(image.width, image.height, image.data);
    }
    case Modality::triangle: {
      const ExrImage exr = decode_exr(file);
      const int c = exr.channel("id");
      if (c < 0 || exr.ids[c].empty()) input_error("{}: has no channel \"id\"; make the file anew", file.string());
      return show_ids(exr.width, exr.height, exr.ids[c]);
    }
    default:
      return to_rgb(decode_png8(file));
  }
}

// What a view is shown as: colour first, then what says most about the shape.
std::optional<Modality> best_modality(const DatasetFolder& d) {
  for (Modality m : {Modality::rgb, Modality::nnopcs, Modality::normal, Modality::depth, Modality::silhouette,
                     Modality::instance, Modality::coverage})
    if (d.manifest.modalities.has(m) && (m != Modality::rgb || !d.manifest.coat_indices.empty())) return m;
  return std::nullopt;
}

}  // namespace

void draw_keypoints(Image8& image, const Manifest& m, const View& view, int animal, double scale) {
  if (animal >= static_cast<int>(view.keypoints.size())) return;
  const std::vector<KeypointView>& points = view.keypoints[animal];
  const auto drawn = [&](int i) {
    return i < static_cast<int>(points.size()) && points[i].depth > 0 && all_finite(points[i].pixel);
  };
  const double radius = std::max(2.0, image.width / 110.0), thin = std::max(1.0, image.width / 300.0);
  for (const auto& [a, b] : m.skeleton)
    if (drawn(a) && drawn(b)) draw_line(image, points[a].pixel * scale, points[b].pixel * scale, thin, edge_color);
  std::set<int> left, right;
  for (const auto& [l, r] : m.pairs) left.insert(l), right.insert(r);
  for (int i = 0; i < static_cast<int>(points.size()); ++i) {
    if (!drawn(i) || points[i].visibility == Visibility::off_frame) continue;
    const Color8 color = left.count(i) ? left_color : right.count(i) ? right_color : middle_color;
    if (points[i].visibility == Visibility::visible) {
      draw_disc(image, points[i].pixel * scale, radius + 1, {0, 0, 0});
      draw_disc(image, points[i].pixel * scale, radius, color);
    } else {
      draw_ring(image, points[i].pixel * scale, radius, thin, color);
    }
  }
}

namespace {

struct Chosen {
  DatasetFolder dataset;
  StoredFrame frame;
  int coat = -1;
};

Chosen choose(const std::filesystem::path& folder, const ContactSheetOptions& o) {
  Chosen c;
  c.dataset = open_dataset(folder);
  const Manifest& m = c.dataset.manifest;
  const auto has = [](const std::vector<int>& list, int v) {
    return std::find(list.begin(), list.end(), v) != list.end();
  };
  if (m.held_frames.empty()) input_error("{}: holds no frame; make the dataset anew", folder.string());
  const int frame = o.frame.value_or(m.held_frames.front());
  if (!has(m.held_frames, frame))
    input_error("{}: holds no frame {}; it has {} to {}", folder.string(), frame, m.held_frames.front(),
                m.held_frames.back());
  c.coat = o.coat.value_or(m.coat_indices.empty() ? -1 : m.coat_indices.front());
  if (o.coat && !has(m.coat_indices, *o.coat))
    input_error("{}: holds no coat {}; its manifest lists them", folder.string(), *o.coat);
  c.frame = read_frame(c.dataset, frame);
  if (c.frame.views.empty()) input_error("{}: frame {} has no views; make the dataset anew", folder.string(), frame);
  if (o.columns < 1 || o.thumbnail_width < 16)
    input_error("a contact sheet needs at least one column and thumbnails of 16 pixels");
  return c;
}

}  // namespace

Image8 picture_grid(const std::vector<Image8>& cells, const std::vector<std::string>& labels, int columns,
            const std::string& title) {
  int cell_width = 0, cell_height = 0;
  for (const Image8& cell : cells)
    cell_width = std::max(cell_width, cell.width), cell_height = std::max(cell_height, cell.height);
  const int scale = cell_width >= 160 ? 2 : 1, title_height = 2 * (text_rows * 2 + gap);
  const int label_height = text_rows * scale + 2 * gap;
  columns = std::min(columns, static_cast<int>(cells.size()));
  const int rows = (static_cast<int>(cells.size()) + columns - 1) / columns;
  Image8 sheet(std::max(gap + columns * (cell_width + gap), 2 * gap + text_width(title, 2)),
               title_height + rows * (cell_height + label_height + gap), 3);
  for (std::size_t i = 0; i < sheet.data.size(); ++i) sheet.data[i] = paper[i % 3];
  draw_text(sheet, gap, title_height / 2 - text_rows, title, 2, ink);
  for (int i = 0; i < static_cast<int>(cells.size()); ++i) {
    const int x = gap + i % columns * (cell_width + gap),
              y = title_height + i / columns * (cell_height + label_height + gap);
    paste(sheet, x, y, cells[i]);
    // A label that is too long for its picture must not run into the next one.
    const auto letters = static_cast<std::size_t>(std::max(1, cell_width / text_width("m", scale)));
    draw_text(sheet, x, y + cell_height + gap, labels[i].substr(0, letters), scale, ink);
  }
  return sheet;
}

namespace {

std::string coat_label(const Manifest& m, int coat) {
  return coat >= 0 && coat < static_cast<int>(m.coats.size()) ? fmt::format("  coat {} {}", coat, m.coats[coat]) : "";
}

}  // namespace

Image8 contact_sheet(const std::filesystem::path& folder, const ContactSheetOptions& o) {
  const Chosen c = choose(folder, o);
  const Manifest& m = c.dataset.manifest;
  const std::optional<Modality> modality = best_modality(c.dataset);
  const std::vector<View>& views = c.frame.views;
  std::vector<Image8> cells(views.size());
  std::vector<std::string> labels;
  for (const View& view : views) labels.push_back(fmt::format("camera {}", view.camera));
  parallel_for(views.size(), 1, [&](std::size_t i) {
    const View& view = views[i];
    const Image8 full = modality ? show(c.dataset, *modality, view.frame, view.camera, c.coat, -1)
                                 : Image8(std::max(view.width, 1), std::max(view.height, 1), 3);
    const int width = std::min(o.thumbnail_width, full.width);
    const double scale = static_cast<double>(width) / full.width;
    cells[i] = scale_down(full, width, std::max(1, static_cast<int>(std::lround(full.height * scale))));
    if (o.keypoints)
      for (int animal = 0; animal < static_cast<int>(view.keypoints.size()); ++animal)
        draw_keypoints(cells[i], m, view, animal, scale);
  });
  return picture_grid(cells, labels, o.columns,
              fmt::format("{}  frame {}{}", m.species, c.frame.frame.frame,
                          modality == Modality::rgb ? coat_label(m, c.coat) : ""));
}

Image8 modality_sheet(const std::filesystem::path& folder, const ContactSheetOptions& o) {
  const Chosen c = choose(folder, o);
  const Manifest& m = c.dataset.manifest;
  const int camera = o.camera.value_or(c.frame.views.front().camera);
  const auto view =
      std::find_if(c.frame.views.begin(), c.frame.views.end(), [&](const View& v) { return v.camera == camera; });
  if (view == c.frame.views.end())
    input_error("{}: has no camera {}; its manifest lists them", folder.string(), camera);
  std::vector<Image8> cells;
  std::vector<std::string> labels;
  const auto add = [&](const Image8& full, const std::string& label) {
    const int width = std::min(2 * o.thumbnail_width, full.width);
    cells.push_back(
        scale_down(full, width, std::max(1, static_cast<int>(std::int64_t{full.height} * width / full.width))));
    labels.push_back(label);
  };
  for (const ModalityRow& r : modality_table()) {
    if (!m.modalities.has(r.id) || r.storage == Storage::record) continue;
    if (r.id == Modality::occlusion) {
      for (int animal = 0; animal < std::max(1, static_cast<int>(m.animals.size())); ++animal)
        add(show(c.dataset, r.id, view->frame, camera, -1, animal), fmt::format("whole mask {}", animal));
    } else if (!r.per_coat || c.coat >= 0) {
      add(show(c.dataset, r.id, view->frame, camera, c.coat, -1), r.name);
    }
  }
  if (!cells.empty() && o.keypoints) {
    Image8 marked = cells.front();
    for (int animal = 0; animal < static_cast<int>(view->keypoints.size()); ++animal)
      draw_keypoints(marked, m, *view, animal, static_cast<double>(marked.width) / std::max(view->width, 1));
    cells.push_back(marked);
    labels.push_back("keypoints");
  }
  if (cells.empty()) input_error("{}: holds no modality that can be shown; make it with more of them", folder.string());
  return picture_grid(cells, labels, 4,
              fmt::format("{}  frame {}  camera {}{}", m.species, view->frame, camera, coat_label(m, c.coat)));
}

}  // namespace moomill
