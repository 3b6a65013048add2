#include "neural/samples.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <optional>

#include "generator/core/error.h"
#include "generator/core/random.h"
#include "neural/area_average.h"
#include "neural/packed_cache.h"

namespace moomill {
namespace {

namespace fs = std::filesystem;

constexpr double least_z = 1e-6;            // metres: keypoints behind the camera are projected from here
constexpr double least_depth_range = 1e-3;  // metres
constexpr int turns = 8;                    // of 45 degrees

// What a random number is for.
enum class Draw : std::uint64_t { order, camera, coat, turn, noise, boundary, offset, surface };

std::uint64_t key(std::uint64_t identity, Draw what, std::uint64_t i = 0, std::uint64_t j = 0) {
  return hash_identity({identity, static_cast<std::uint64_t>(what), i, j});
}

std::size_t pick(std::uint64_t identity, std::size_t count) {  // uniform in [0, count)
  return std::min(static_cast<std::size_t>(to_unit(identity) * static_cast<double>(count)), count - 1);
}

std::vector<int> permutation(std::uint64_t identity, std::size_t count) {
  std::vector<int> order(count);
  std::iota(order.begin(), order.end(), 0);
  for (std::size_t i = count; i > 1; --i) std::swap(order[i - 1], order[pick(hash_identity({identity, i}), i)]);
  return order;
}

const char* name_of(Split split) {
  return split == Split::train ? "training" : split == Split::validate ? "validation" : "test";
}

// --- silhouettes ---

bool inside(const std::uint64_t* mask, std::size_t words, int x, int y) {
  return mask[words * y + x / 64] >> (x % 64) & 1;
}

// Pixels whose 3 x 3 neighbourhood holds both foreground and background; beyond the image all is background.
void list_boundary(const std::uint64_t* mask, int width, int height, std::vector<std::uint32_t>& out) {
  const std::size_t words = words_per_row(width);
  std::vector<std::uint64_t> any(words * height), all(words * height);  // of three pixels in a row
  for (int y = 0; y < height; ++y)
    for (std::size_t w = 0; w < words; ++w) {
      const std::uint64_t *row = mask + words * y, m = row[w];
      const std::uint64_t left = m << 1 | (w > 0 ? row[w - 1] >> 63 : 0),
                          right = m >> 1 | (w + 1 < words ? row[w + 1] << 63 : 0);
      any[words * y + w] = m | left | right;
      all[words * y + w] = m & left & right;
    }
  out.clear();
  for (int y = 0; y < height; ++y)
    for (std::size_t w = 0; w < words; ++w) {
      const std::size_t at = words * y + w;
      const std::uint64_t up_any = y > 0 ? any[at - words] : 0, up_all = y > 0 ? all[at - words] : 0;
      const std::uint64_t down_any = y + 1 < height ? any[at + words] : 0,
                          down_all = y + 1 < height ? all[at + words] : 0;
      for (std::uint64_t rest = (any[at] | up_any | down_any) & ~(all[at] & up_all & down_all); rest;
           rest &= rest - 1) {
        const int x = static_cast<int>(w) * 64 + std::countr_zero(rest);
        if (x < width) out.push_back(static_cast<std::uint32_t>(y * width + x));
      }
    }
}

struct Projected {
  dvec2 pixel;
  double z;
};

Projected project(const CameraRecord& c, const dvec3& p) {
  const double* m = c.world_to_camera.data();
  const auto row = [&](int r) { return m[4 * r] * p.x + m[4 * r + 1] * p.y + m[4 * r + 2] * p.z + m[4 * r + 3]; };
  const double z = row(2), divisor = std::max(z, least_z);
  return {{c.fx * row(0) / divisor + c.cx, c.fy * row(1) / divisor + c.cy}, z};
}

dvec3 turned(const dvec3& p, int k) {
  constexpr double h = 0.70710678118654752;
  constexpr double cosine[turns] = {1, h, 0, -h, -1, -h, 0, h};
  const double c = cosine[k], s = cosine[(k + 6) % turns];
  return {c * p.x - s * p.y, s * p.x + c * p.y, p.z};
}

torch::Tensor zeros(at::IntArrayRef shape) {
  return torch::zeros(shape, torch::kFloat32);
}

}  // namespace

struct SampleSource::State {
  DatasetSource source;
  PackedGeometry geometry;
  std::vector<int> coats;
  std::vector<PackedCoat> packed;      // parallel to coats
  std::vector<std::vector<int>> seen;  // per frame: places of the cameras that see the animal
  int left_out = 0;                    // frames that no camera sees
  std::string rings;                   // why the cameras cannot be turned; empty where they can

  std::size_t view(int frame_at, int camera_at) const {
    return static_cast<std::size_t>(frame_at) * source.camera_ids.size() + camera_at;
  }
  int frame_at(int frame) const {
    const auto found = std::lower_bound(source.frames.begin(), source.frames.end(), frame);
    if (found == source.frames.end() || *found != frame)
      input_error("{}: has no frame {}; its frames go from {} to {}", source.folder.string(), frame,
                  source.frames.front(), source.frames.back());
    return static_cast<int>(found - source.frames.begin());
  }
  std::vector<int> places(Split split) const {  // of frames of a split that some camera sees
    const std::vector<int>& frames = split == Split::train      ? source.splits.train
                                     : split == Split::validate ? source.splits.validate
                                                                : source.splits.test;
    std::vector<int> out;
    for (int frame : frames)
      if (const int at = frame_at(frame); !seen[at].empty()) out.push_back(at);
    return out;
  }
  std::vector<int> needed_places(Split split) const {
    const std::vector<int> out = places(split);
    if (!out.empty()) return out;
    int needed = 1;  // frames a dataset must have for its split to have any
    for (;; ++needed) {
      std::vector<int> frames(needed);
      std::iota(frames.begin(), frames.end(), 0);
      const Splits splits = make_splits(frames);
      if (!(split == Split::train ? splits.train : split == Split::validate ? splits.validate : splits.test).empty())
        break;
    }
    input_error("{}: its {} frames leave none for the {} split; make a dataset of {} or more", source.folder.string(),
                source.frames.size(), name_of(split), std::max(needed, 1));
  }
};

SampleSource::SampleSource(const fs::path& dataset, const std::vector<int>& coats, const fs::path& cache,
                           const std::function<void(const std::string&, std::size_t, std::size_t)>& progress)
    : state_(std::make_unique<State>()) {
  State& s = *state_;
  s.source = read_dataset_source(dataset);
  for (int coat : coats) s.source.coat_at(coat);  // before the long work
  fs::path folder = cache;
  if (folder.empty()) {
    const fs::path whole = fs::absolute(s.source.folder).lexically_normal();
    folder = whole.parent_path() / (whole.filename().string() + ".cache");
  }
  s.geometry = PackedGeometry(s.source, folder, progress);
  s.coats = coats;
  for (int coat : coats) s.packed.emplace_back(s.source, s.geometry, coat, folder, progress);
  s.seen.resize(s.source.frames.size());
  for (std::size_t f = 0; f < s.seen.size(); ++f) {
    for (std::size_t c = 0; c < s.source.camera_ids.size(); ++c)
      if (s.geometry.count(s.view(static_cast<int>(f), static_cast<int>(c))) > 0)
        s.seen[f].push_back(static_cast<int>(c));
    if (s.seen[f].empty()) ++s.left_out;
  }
  s.rings = why_not_rings(s.source);
}

SampleSource::~SampleSource() = default;

int SampleSource::keypoint_count() const {
  return static_cast<int>(state_->source.keypoints.front().size());
}
int SampleSource::width() const {
  return state_->source.width;
}
int SampleSource::height() const {
  return state_->source.height;
}
bool SampleSource::has_nnopcs() const {
  return !state_->source.nnopcs_template.empty();
}
double SampleSource::reader_radius() const {
  return state_->source.reader_radius;
}
const std::vector<int>& SampleSource::coats() const {
  return state_->coats;
}
std::vector<int> SampleSource::cameras() const {
  return state_->source.camera_ids;
}

std::vector<std::string> SampleSource::coat_names() const {
  std::vector<std::string> out;
  for (int coat : state_->coats) out.push_back(state_->source.coats[state_->source.coat_at(coat)].second);
  return out;
}

std::vector<int> SampleSource::available_coats() const {
  std::vector<int> out;
  for (const auto& [index, name] : state_->source.coats) out.push_back(index);
  return out;
}

std::vector<int> SampleSource::frames(Split split) const {
  std::vector<int> out;
  for (int at : state_->places(split)) out.push_back(state_->source.frames[at]);
  return out;
}

std::string SampleSource::describe() const {
  const State& s = *state_;
  std::string out = fmt::format(
      "{} poses, {} cameras, {} of {} coats, {} x {} pixels, {} keypoints, {}; {} training, {} validation, {} test",
      s.source.frames.size(), s.source.camera_ids.size(), s.coats.size(), s.source.coats.size(), width(), height(),
      keypoint_count(), has_nnopcs() ? "NNOPCS" : "no NNOPCS", frames(Split::train).size(),
      frames(Split::validate).size(), frames(Split::test).size());
  if (s.left_out > 0)
    out += fmt::format("; {} pose{} left out: no camera sees the animal", s.left_out, s.left_out == 1 ? "" : "s");
  return out;
}

FullView SampleSource::view(const ViewId& id) const {
  const State& s = *state_;
  const int frame_at = s.frame_at(id.frame), w = width(), h = height();
  const auto& ids = s.source.camera_ids;
  const auto found = std::find(ids.begin(), ids.end(), id.camera);
  if (found == ids.end())
    input_error("{}: has no camera {}; its {} cameras go from {} to {}", s.source.folder.string(), id.camera,
                ids.size(), ids.front(), ids.back());
  const int camera_at = static_cast<int>(found - ids.begin());
  const std::size_t v = s.view(frame_at, camera_at);
  const CameraRecord& camera = s.source.camera(frame_at, camera_at);

  FullView out{.id = id, .width = w, .height = h};
  const int k = keypoint_count();
  out.keypoints = zeros({k, 3});
  out.keypoints_2d = zeros({k, 2});
  for (int i = 0; i < k; ++i) {
    const dvec3& p = s.source.keypoints[frame_at][i];
    const Projected q = project(camera, p);
    for (int c = 0; c < 3; ++c) out.keypoints.data_ptr<float>()[3 * i + c] = static_cast<float>(p[c]);
    out.keypoints_2d.data_ptr<float>()[2 * i] = static_cast<float>(q.pixel.x / w);
    out.keypoints_2d.data_ptr<float>()[2 * i + 1] = static_cast<float>(q.pixel.y / h);
  }
  out.world_to_camera = zeros({3, 4});
  for (int i = 0; i < 12; ++i) out.world_to_camera.data_ptr<float>()[i] = static_cast<float>(camera.world_to_camera[i]);
  const float lens[9] = {static_cast<float>(camera.fx),
                         0,
                         static_cast<float>(camera.cx),
                         0,
                         static_cast<float>(camera.fy),
                         static_cast<float>(camera.cy),
                         0,
                         0,
                         1};
  out.intrinsics = zeros({3, 3});
  std::copy(lens, lens + 9, out.intrinsics.data_ptr<float>());

  std::vector<std::uint32_t> pixels;
  s.geometry.pixels(v, pixels);
  out.mask = zeros({h, w});
  out.depth = zeros({h, w});
  if (has_nnopcs()) out.nnopcs = zeros({3, h, w});
  const std::size_t plane = static_cast<std::size_t>(w) * h;
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    out.mask.data_ptr<float>()[pixels[i]] = 1;
    out.depth.data_ptr<float>()[pixels[i]] = s.geometry.depth(v)[i];
    if (has_nnopcs())
      for (int c = 0; c < 3; ++c) out.nnopcs.data_ptr<float>()[c * plane + pixels[i]] = s.geometry.nnopcs(v)[3 * i + c];
  }
  if (id.coat >= 0) {  // with its background, which the cache does not hold
    const fs::path file = s.source.path(s.source.coat_templates[s.source.coat_at(id.coat)], id.frame, id.camera);
    const Image8 image = read_color(s.source, file);
    out.color = zeros({3, h, w});
    for (std::size_t i = 0; i < plane; ++i)
      for (int c = 0; c < 3; ++c)
        out.color.data_ptr<float>()[c * plane + i] = static_cast<float>(image.data[3 * i + c]) / 255.0f;
  }
  return out;
}

torch::Tensor SampleSource::encoder_image(const FullView& view, const EncoderInput& encoder) const {
  return make_encoder_image(view.color, view.mask, view.nnopcs, encoder);
}

int SampleSource::batches_per_epoch(const SampleOptions& o) const {
  if (o.batch < 1 || o.views_per_frame < 1)
    input_error("a batch of {} with {} views of a frame makes no sense; both must be at least 1", o.batch,
                o.views_per_frame);
  if (o.silhouette_points < 0 || o.surface_points < 0 || !(o.near_sigma >= 0) || !(o.far_sigma >= 0) ||
      !(o.keypoint_noise_m >= 0))
    input_error("numbers of points, sigmas and noise must not be negative");
  const int items = static_cast<int>(state_->needed_places(o.split).size()) * o.views_per_frame;
  return o.split == Split::train ? std::max(1, items / o.batch) : (items + o.batch - 1) / o.batch;
}

Batch SampleSource::batch(const SampleOptions& o, int epoch, int index) const {
  const State& s = *state_;
  const std::string where = s.source.folder.string();
  if (o.nnopcs && !has_nnopcs())
    input_error("{}: has no NNOPCS maps; make them, or train without (nnopcs = false)", where);
  if (o.color && s.coats.empty()) input_error("{}: was opened without coats; name those to train on", where);
  if (o.turn_cameras && !s.rings.empty())
    input_error("{}: {}, so that its cameras cannot be turned; train with turn_cameras = false", where, s.rings);
  const int batches = batches_per_epoch(o);
  check(index >= 0 && index < batches, "the number of a batch is within its epoch");

  // Repetition r of a frame takes the r-th of its cameras in an order of its own, so an epoch never shows a view twice
  // before it has shown them all.
  const std::vector<int> places = s.needed_places(o.split);
  const std::size_t per_pass = places.size(), items = per_pass * o.views_per_frame;
  const std::size_t begin = static_cast<std::size_t>(index) * o.batch, end = std::min(items, begin + o.batch);
  const std::int64_t b = static_cast<std::int64_t>(end - begin);
  const std::uint64_t epoch_key = hash_identity({o.seed, static_cast<std::uint64_t>(epoch)});
  struct Item {
    int frame_at, camera_at, turned_camera_at, turn, coat_at;
    std::size_t view;
    std::uint64_t identity;
  };
  std::vector<Item> list;
  std::vector<int> order;
  std::size_t order_of = items;  // the pass that `order` belongs to
  for (std::size_t i = begin; i < end; ++i) {
    const std::size_t pass = i / per_pass;
    if (pass != order_of) order = permutation(key(epoch_key, Draw::order, order_of = pass), per_pass);
    Item item{};
    item.frame_at = places[order[i % per_pass]];
    const auto frame = static_cast<std::uint64_t>(s.source.frames[item.frame_at]);
    item.identity = hash_identity({epoch_key, frame, pass});
    const std::vector<int>& seen = s.seen[item.frame_at];
    const std::vector<int> cameras = permutation(key(epoch_key, Draw::camera, frame, pass / seen.size()), seen.size());
    item.camera_at = item.turned_camera_at = seen[cameras[pass % seen.size()]];
    if (o.turn_cameras) {
      item.turn = static_cast<int>(pick(key(item.identity, Draw::turn), turns));
      const int azimuth = item.camera_at % turns;
      item.turned_camera_at = item.camera_at - azimuth + (azimuth + item.turn) % turns;
    }
    item.coat_at = o.color ? static_cast<int>(pick(key(item.identity, Draw::coat), s.coats.size())) : -1;
    item.view = s.view(item.frame_at, item.camera_at);
    list.push_back(item);
  }

  const int w = width(), h = height(), k = keypoint_count();
  const int sil = o.silhouette_points, sur = o.surface_points;
  const int ew = o.encoder.width > 0 ? o.encoder.width : w, eh = o.encoder.height > 0 ? o.encoder.height : h;
  const int image_channels = o.nnopcs ? 6 : 3;
  Batch out;
  for (const Item& item : list)
    out.views.push_back({s.source.frames[item.frame_at], s.source.camera_ids[item.camera_at],
                         item.coat_at < 0 ? -1 : s.coats[item.coat_at]});
  out.keypoints = zeros({b, k, 3});
  out.noisy_keypoints = zeros({b, k, 3});
  out.keypoints_2d = zeros({b, k, 2});
  out.world_to_camera = zeros({b, 3, 4});
  out.near_depth = zeros({b});
  out.depth_range = zeros({b});
  out.silhouette_points = zeros({b, sil, 2});
  out.silhouette = zeros({b, sil});
  out.surface_points = zeros({b, sur, 2});
  out.depth = zeros({b, sur});
  if (o.nnopcs) out.nnopcs = zeros({b, sur, 3});
  if (o.color) {
    out.color = zeros({b, sur, 3});
    out.images = zeros({b, image_channels, eh, ew});
  }
  const AreaAverage resize_whole(w, h, o.color ? ew : 1, o.color ? eh : 1);
  // Pointers taken here: the threads below touch nothing of LibTorch.
  const auto floats = [](const torch::Tensor& t) { return t.defined() ? t.data_ptr<float>() : nullptr; };
  float *keypoints = floats(out.keypoints), *noisy = floats(out.noisy_keypoints), *flat = floats(out.keypoints_2d);
  float *extrinsics = floats(out.world_to_camera), *near = floats(out.near_depth), *range = floats(out.depth_range);
  float *sil_points = floats(out.silhouette_points), *labels = floats(out.silhouette);
  float *sur_points = floats(out.surface_points), *depth = floats(out.depth), *nnopcs = floats(out.nnopcs);
  float *color = floats(out.color), *images = floats(out.images);

  for_each_index(list.size(), [&](std::size_t i) {
    const Item& item = list[i];
    const std::size_t v = item.view;
    const CameraRecord& camera = s.source.camera(item.frame_at, item.turned_camera_at);
    double nearest = std::numeric_limits<double>::infinity(), farthest = -nearest;
    for (int j = 0; j < k; ++j) {
      const dvec3 p = turned(s.source.keypoints[item.frame_at][j], item.turn);
      const Projected q = project(camera, p);
      nearest = std::min(nearest, q.z);
      farthest = std::max(farthest, q.z);
      const std::size_t at = i * k + j;
      for (int c = 0; c < 3; ++c) {
        keypoints[3 * at + c] = static_cast<float>(p[c]);
        const double noise =
            o.keypoint_noise_m > 0 ? o.keypoint_noise_m * to_normal(key(item.identity, Draw::noise, j, c)) : 0;
        noisy[3 * at + c] = static_cast<float>(p[c] + noise);
      }
      flat[2 * at] = static_cast<float>(q.pixel.x / w);
      flat[2 * at + 1] = static_cast<float>(q.pixel.y / h);
    }
    for (int c = 0; c < 12; ++c) extrinsics[12 * i + c] = static_cast<float>(camera.world_to_camera[c]);
    const double spread = std::max(farthest - nearest, least_depth_range);
    near[i] = static_cast<float>(nearest);
    range[i] = static_cast<float>(spread);

    std::vector<std::uint32_t> pixels;
    if (sil > 0) {
      list_boundary(s.geometry.mask(v), w, h, pixels);
      for (int j = 0; j < sil; ++j) {
        const std::uint32_t pixel = pixels[pick(key(item.identity, Draw::boundary, j), pixels.size())];
        const double sigma = j < (sil + 1) / 2 ? o.near_sigma : o.far_sigma;
        const double centre[2] = {(pixel % w + 0.5) / w, (pixel / w + 0.5) / h};
        int cell[2];
        for (int c = 0; c < 2; ++c) {
          const double x = centre[c] + sigma * to_normal(key(item.identity, Draw::offset, j, c));
          const float clamped = std::clamp(static_cast<float>(x), 0.0f, std::nextafter(1.0f, 0.0f));
          sil_points[2 * (i * sil + j) + c] = clamped;
          cell[c] = static_cast<int>(static_cast<double>(clamped) * (c == 0 ? w : h));
        }
        labels[i * sil + j] = inside(s.geometry.mask(v), words_per_row(w), cell[0], cell[1]) ? 1.0f : 0.0f;
      }
    }
    if (sur == 0 && !o.color) return;
    s.geometry.pixels(v, pixels);
    const float *depth_of = s.geometry.depth(v), *nnopcs_of = o.nnopcs ? s.geometry.nnopcs(v) : nullptr;
    const std::uint8_t* color_of = o.color ? s.packed[item.coat_at].color(s.geometry, v) : nullptr;
    for (int j = 0; j < sur; ++j) {
      const std::size_t from = pick(key(item.identity, Draw::surface, j), pixels.size()), at = i * sur + j;
      sur_points[2 * at] = static_cast<float>((pixels[from] % w + 0.5) / w);
      sur_points[2 * at + 1] = static_cast<float>((pixels[from] / w + 0.5) / h);
      depth[at] = static_cast<float>((depth_of[from] - nearest) / spread);
      for (int c = 0; c < 3 && nnopcs_of; ++c) nnopcs[3 * at + c] = nnopcs_of[3 * from + c];
      for (int c = 0; c < 3 && color_of; ++c) color[3 * at + c] = static_cast<float>(color_of[3 * from + c]) / 255.0f;
    }
    if (!o.color) return;
    std::optional<AreaAverage> resize_window;
    if (o.encoder.crop) {
      std::vector<double> columns(w), rows(h);
      for (const std::uint32_t pixel : pixels) columns[pixel % w] += 1, rows[pixel / w] += 1;
      resize_window.emplace(w, h, ew, eh, mask_window(columns, rows, ew, eh));
    }
    const AreaAverage& resize = resize_window ? *resize_window : resize_whole;
    float* planes = images + i * image_channels * static_cast<std::size_t>(ew) * eh;
    for (std::size_t j = 0; j < pixels.size(); ++j) {
      float values[6];
      for (int c = 0; c < 3; ++c) values[c] = static_cast<float>(color_of[3 * j + c]) / 255.0f;
      for (int c = 0; c < 3 && nnopcs_of; ++c) values[3 + c] = nnopcs_of[3 * j + c];
      resize.add(static_cast<int>(pixels[j] % w), static_cast<int>(pixels[j] / w), image_channels, values, planes);
    }
  });
  return out;
}

}  // namespace moomill
