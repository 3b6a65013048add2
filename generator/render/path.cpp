#include "generator/render/path.h"

#include <atomic>

#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "generator/render/path_kernel.h"

namespace moomill {
namespace {

using namespace kernel;

constexpr int tile = 16;  // pixels

// Where the samples of every pixel lie within it, and what they count in the pixels around. All pixels of an image have
// the same places: so the weights of the samples that reach a pixel add up alike everywhere, and dividing by their sum, which
// keeps even areas even at any number of samples, is a constant factor that tends to 1.
struct SamplePlaces {
  std::uint64_t stream;
  int reach;                   // pixels each way
  std::vector<vec2> position;  // per sample: within the pixel, [0, 1)^2; around its centre where reach is 0
  std::vector<float> weight;   // per sample: of columns -reach .. reach, then of rows

  SamplePlaces(const PixelFilter& filter, std::uint64_t image_stream, int samples) : stream(image_stream), reach(filter.reach()), position(samples) {
    const PixelSampler sampler(image_stream, ~0ull);
    const int side = 2 * reach + 1;
    weight.assign(2 * side * static_cast<std::size_t>(samples), 1.0f);
    double total = 0;
    for (int s = 0; s < samples; ++s) {
      const vec2 u = sampler.get(filter_pair, s);
      position[s] = reach > 0 ? u : vec2(0.5f + filter.sample(u.x), 0.5f + filter.sample(u.y));
      if (reach == 0) continue;
      double sum[2] = {0, 0};
      for (int axis = 0; axis < 2; ++axis)
        for (int k = 0; k < side; ++k) {
          const float w = filter.weight(std::abs(position[s][axis] - 0.5f - static_cast<float>(k - reach)));
          weight[(2 * static_cast<std::size_t>(s) + axis) * side + k] = w;
          sum[axis] += w;
        }
      total += sum[0] * sum[1] / samples;
    }
    if (reach > 0)
      for (float& w : weight) w /= static_cast<float>(std::sqrt(total));
  }
  int samples() const { return static_cast<int>(position.size()); }
  // What the samples of a pixel weigh together in the one `column`, `row` pixels from it.
  double total(int column, int row) const {
    const int side = 2 * reach + 1;
    double sum = 0;
    for (int s = 0; s < samples(); ++s) sum += static_cast<double>(of(s)[column + reach]) * of(s)[side + row + reach];
    return sum / samples();
  }
  const float* of(int sample) const { return &weight[2 * static_cast<std::size_t>(sample) * (2 * reach + 1)]; }
};

// Sums of a pixel, with what they have lost to rounding so far (Kahan 1965): a plain sum of a million samples is 1 % off.
template <int P>
struct alignas(32) PixelSums {
  static constexpr int values = 3 * P + 8;  // radiance as in Lanes, then alpha
  float sum[values] = {}, lost[values] = {};

  // Adds eight samples' radiance times their weights, and the weights' sum to alpha, for so many coats. The operations on a coat
  // are the same in any batch.
  void add(const Lanes<P>* radiance, const float* weight, int coats) {
    __m256 w[batch_size];
    float alpha = 0;
    for (int i = 0; i < batch_size; ++i) {
      w[i] = _mm256_set1_ps(weight[i]);
      alpha += weight[i];
    }
    const auto add_eight = [&](int at, __m256 more) {
      const __m256 before = _mm256_load_ps(sum + at), e = _mm256_sub_ps(more, _mm256_load_ps(lost + at)), s = _mm256_add_ps(before, e);
      _mm256_store_ps(lost + at, _mm256_sub_ps(_mm256_sub_ps(s, before), e));
      _mm256_store_ps(sum + at, s);
    };
    for (int c = 0; c < 3; ++c)
      for (int t = 0; t < coats; t += 8) {
        __m256 part = _mm256_mul_ps(w[0], _mm256_load_ps(radiance[0].v[c] + t));
        for (int i = 1; i < batch_size; ++i) part = _mm256_fmadd_ps(w[i], _mm256_load_ps(radiance[i].v[c] + t), part);
        add_eight(c * P + t, part);
      }
    add_eight(3 * P, _mm256_set1_ps(alpha));
  }
};

// All samples of pixel (x, y), which may lie outside the image, added to the sums around `centre`, a pixel of rows `stride` wide.
template <int P>
void trace_pixel(const Tracer& t, const Camera& camera, const SamplePlaces& places, int x, int y, PixelSums<P>* centre, int stride,
                 Counters& counters) {
  const PathOptions& options = t.options;
  const int samples = places.samples();
  const PixelSampler sampler = PixelSampler::in_image(places.stream, x + places.reach, y + places.reach, samples);
  const vec3 origin(camera.centre - t.scene.origin);
  thread_local Batch batch;
  const auto& textures = t.scene.appearance->textures;
  const int coats = t.scene.appearance->coat_count;
  Lanes<P> radiance[batch_size];
  for (auto& r : radiance) r.fill(0.0f);  // of samples that see nothing: any finite values, their weight is 0
  for (int first = 0; first < samples; first += batch_size) {
    const int n = std::min(batch_size, samples - first);
    Ray8 rays;
    vec3 direction[batch_size];
    for (int i = 0; i < batch_size; ++i) {
      const vec2 at = places.position[std::min(first + i, samples - 1)];
      direction[i] = vec3(glm::normalize(camera.direction(static_cast<double>(x) + at.x, static_cast<double>(y) + at.y)));
      rays.set(i, {origin, 0, direction[i], std::numeric_limits<float>::infinity()}, i < n);
    }
    t.accel.intersect8(rays, true);
    counters.paths += n;
    counters.rays += n;
    bool seen[batch_size] = {};
    int any = 0;
    batch.count = 0;
    for (int i = 0; i < n; ++i) {
      const bool met = rays.instance[i] != no_hit;
      if (!met && !options.environment_visible) continue;
      seen[i] = true;
      ++any;
      if (met) {
        batch.start(i, {rays.instance[i], rays.triangle[i], rays.u[i], rays.v[i], rays.far[i]}, -direction[i]);
      } else {
        batch.trail[i].start();
        batch.trail[i].seen = t.lights.environment->radiance(direction[i]);
      }
    }
    if (any == 0) continue;
    trace_paths(t, sampler, first, batch, counters);

    for (int i = 0; i < n; ++i)
      if (seen[i]) counters.not_finite += play(batch.trail[i], textures, coats, P, &radiance[i].v[0][0]);
    const int side = 2 * places.reach + 1;
    for (int row = 0; row < side; ++row)
      for (int column = 0; column < side; ++column) {
        float weight[batch_size] = {};
        for (int i = 0; i < n; ++i)
          if (seen[i]) weight[i] = places.of(first + i)[column] * places.of(first + i)[side + row];
        centre[(row - places.reach) * stride + column - places.reach].add(radiance, weight, coats);
      }
  }
}

// Pixels within `reach` of those in the mask; pixel (x, y) of it is (x - reach, y - reach) of the image.
PixelMask within_reach(const PixelMask& mask, int reach) {
  PixelMask out(mask.width + 2 * reach, mask.height + 2 * reach);
  for (int y = 0; y < mask.height; ++y)
    for (int x = 0; x < mask.width;) {
      if (!mask.get(x, y)) {
        ++x;
        continue;
      }
      const int begin = x;
      while (x < mask.width && mask.get(x, y)) ++x;
      for (int row = y; row <= y + 2 * reach; ++row) out.set_span(row, begin, x - 1 + 2 * reach);
    }
  return out;
}

// Tiles of an image and the rim that its filter reaches, row by row; a tile's number of samples, as the index of its places.
struct Tiles {
  int reach, across, down;
  std::vector<SamplePlaces> places;
  std::vector<std::uint8_t> place;
  Tiles(const Camera& camera, const PixelFilter& filter)
      : reach(filter.reach()), across((camera.width + 2 * reach + tile - 1) / tile), down((camera.height + 2 * reach + tile - 1) / tile),
        place(static_cast<std::size_t>(across) * down, 0) {}
  std::uint8_t place_at(int x, int y) const { return place[static_cast<std::size_t>(y / tile) * across + x / tile]; }  // of the rimmed image
  const SamplePlaces& at(int x, int y) const { return places[place_at(x, y)]; }
};

template <int P>
void trace_tiles(const Tracer& t, const Camera& camera, const PixelMask& mask, const Tiles& tiles, Radiance& out) {
  const int reach = tiles.reach, width = camera.width + 2 * reach, height = camera.height + 2 * reach;
  const PixelMask traced = within_reach(mask, reach);
  std::atomic<std::uint64_t> paths{0}, rays{0}, not_finite{0};
  check(2 * reach <= tile, "a pixel filter reaches at most 8 pixels");
  // A tile adds to pixels up to `reach` around it. Every other tile in both directions at a time: they share no pixel, and the order in
  // which a pixel's parts are added does not depend on threads.
  for (int phase = 0; phase < 4; ++phase) {
    const int across = (tiles.across + 1 - (phase & 1)) / 2, down = (tiles.down + 1 - (phase >> 1)) / 2;
    parallel_for(static_cast<std::size_t>(across) * down, 1, [&](std::size_t index) {
      const int tile_x = 2 * static_cast<int>(index % across) + (phase & 1), tile_y = 2 * static_cast<int>(index / across) + (phase >> 1);
      const int x0 = tile_x * tile, y0 = tile_y * tile;
      const SamplePlaces& places = tiles.at(x0, y0);
      const float scale = 1.0f / places.samples();
      const int stride = tile + 2 * reach;
      std::vector<PixelSums<P>> sums;
      Counters counters;
      for (int y = y0; y < std::min(y0 + tile, height); ++y)
        for (int x = x0; x < std::min(x0 + tile, width); ++x) {
          if (!traced.get(x, y)) continue;
          if (sums.empty()) sums.resize(static_cast<std::size_t>(stride) * stride);
          trace_pixel(t, camera, places, x - reach, y - reach, &sums[(y - y0 + reach) * stride + x - x0 + reach], stride, counters);
        }
      if (sums.empty()) return;
      for (int j = 0; j < stride; ++j)
        for (int i = 0; i < stride; ++i) {
          const int x = x0 + i - 2 * reach, y = y0 + j - 2 * reach;
          if (x < 0 || y < 0 || x >= camera.width || y >= camera.height || !mask.get(x, y)) continue;
          const float* sum = sums[j * stride + i].sum;
          if (sum[3 * P] == 0) continue;  // nothing was seen
          for (std::size_t c = 0; c < out.coats.size(); ++c) {
            float* p = &out.coats[c].data[out.coats[c].index(x, y)];
            for (int k = 0; k < 3; ++k) p[k] += sum[k * P + c] * scale;
            p[3] += sum[3 * P] * scale;
          }
        }
      paths += counters.paths;
      rays += counters.rays;
      not_finite += counters.not_finite;
    });
  }
  out.paths += paths;
  out.rays += rays;
  out.not_finite += not_finite;
}

double blackman_harris(double x) {  // over [0, 1]; Harris 1978, four terms
  const double a = 2 * pi * x;
  return 0.35875 - 0.48829 * std::cos(a) + 0.14128 * std::cos(2 * a) - 0.01168 * std::cos(3 * a);
}
double blackman_harris_integral(double x) {  // from 0; 0.35875 at 1
  const double a = 2 * pi * x;
  return 0.35875 * x - (0.48829 * std::sin(a) - 0.14128 / 2 * std::sin(2 * a) + 0.01168 / 3 * std::sin(3 * a)) / (2 * pi);
}

}  // namespace

float PixelFilter::sample(float xi) const {
  // Newton's method on the lower half, where the integral is convex: from above it comes down to the root without passing it.
  const double half = std::min(xi, 1.0f - xi), target = 0.35875 * half;
  double x = 0.5;
  for (int i = 0; i < 100; ++i) {
    const double step = (blackman_harris_integral(x) - target) / blackman_harris(x);
    x = std::max(x - step, 0.0);
    if (!(step > 1e-10)) break;
  }
  return static_cast<float>((xi < 0.5f ? 2 * x - 1 : 1 - 2 * x) * radius_);
}

float PixelFilter::weight(float distance) const {
  if (!(distance < radius_)) return 0;
  return static_cast<float>(blackman_harris(0.5 + 0.5 * distance / radius_) / (2 * radius_ * 0.35875));
}

namespace {

// Where tiles of different sample counts meet, what a pixel receives from both does not add up to 1: divides by what it adds up to.
void even_out_borders(const Tiles& tiles, const PixelMask& mask, Radiance& out) {
  const int reach = tiles.reach, side = 2 * reach + 1;
  std::vector<double> total;  // by place, row, column
  for (const SamplePlaces& p : tiles.places)
    for (int row = -reach; row <= reach; ++row)
      for (int column = -reach; column <= reach; ++column) total.push_back(p.total(column, row));
  parallel_for(mask.height, 8, [&](std::size_t row_index) {
    const int y = static_cast<int>(row_index);
    for (int x = 0; x < mask.width; ++x) {
      if (!mask.get(x, y)) continue;
      // The corners of what reaches the pixel: a tile is no narrower than that.
      const int first = tiles.place_at(x, y);
      if (tiles.place_at(x + 2 * reach, y) == first && tiles.place_at(x, y + 2 * reach) == first && tiles.place_at(x + 2 * reach, y + 2 * reach) == first) continue;
      double sum = 0;
      for (int j = -reach; j <= reach; ++j)
        for (int i = -reach; i <= reach; ++i)  // from the pixel i, j away, to which this one is -i, -j away
          sum += total[(static_cast<std::size_t>(tiles.place_at(x + reach + i, y + reach + j)) * side + reach - j) * side + reach - i];
      const auto scale = static_cast<float>(1 / sum);
      for (ImageF& coat : out.coats)
        for (int k = 0; k < 4; ++k) coat.at(x, y, k) *= scale;
    }
  });
}

constexpr int pilot_samples = 4, least_samples = 4, most_samples = 4096;  // the pilot's of each of two halves

// The scene in a white and a black coat.
Scene pilot_scene(const Scene& scene) {
  Scene out = scene;
  auto appearance = std::make_shared<Appearance>(*scene.appearance);
  const auto paint = std::make_shared<Paint>();
  paint->coats = {{vec3(1.0f), -1, false}, {vec3(0.03f), -1, false}};
  for (auto& p : appearance->paints) p = paint;
  appearance->coat_count = 2;
  out.appearance = appearance;
  return out;
}

// Samples of every tile for the picture's target error, from the difference of two pictures of few samples each.
void choose_samples(const Tracer& t, const Camera& camera, const PixelMask& mask, const PixelFilter& filter, Tiles& tiles, Radiance& told) {
  const Scene scene = pilot_scene(t.scene);
  const Tracer tracer{scene, t.lights, t.accel, t.options};
  Radiance half[2];
  for (int h = 0; h < 2; ++h) {
    half[h].coats.assign(2, ImageF(camera.width, camera.height, 4));
    tiles.places = {SamplePlaces(filter, mix64(t.options.stream + 0x70696c6f74 + h), pilot_samples)};
    trace_tiles<padded_coats(2)>(tracer, camera, mask, tiles, half[h]);
    told.paths += half[h].paths;
    told.rays += half[h].rays;
    told.not_finite += half[h].not_finite;
  }
  // A quarter of the halves' squared difference is the squared error of their mean. A tile alone has few pixels: those of the
  // tiles around it count a quarter.
  struct Sum {
    double error[2] = {0, 0}, pixels = 0;
  };
  std::vector<Sum> sums(tiles.place.size());
  for (int y = 0; y < camera.height; ++y)
    for (int x = 0; x < camera.width; ++x) {
      if (!mask.get(x, y) || half[0].coats[0].at(x, y, 3) + half[1].coats[0].at(x, y, 3) < 1) continue;  // mostly background
      Sum& s = sums[static_cast<std::size_t>((y + tiles.reach) / tile) * tiles.across + (x + tiles.reach) / tile];
      s.pixels += 1;
      for (int coat = 0; coat < 2; ++coat)
        for (int c = 0; c < 3; ++c) {
          const double a = half[0].coats[coat].at(x, y, c), b = half[1].coats[coat].at(x, y, c), m = 0.5 * (a + b);
          s.error[coat] += 0.25 * (a - b) * (a - b) / (m * m + 0.01) / 3;
        }
    }
  std::vector<double> squared(sums.size(), 0.0);  // error of a pixel of the tile with the pilot's samples
  double root = 0, pixels = 0;
  for (int y = 0; y < tiles.down; ++y)
    for (int x = 0; x < tiles.across; ++x) {
      Sum all;
      for (int j = std::max(0, y - 1); j <= std::min(tiles.down - 1, y + 1); ++j)
        for (int i = std::max(0, x - 1); i <= std::min(tiles.across - 1, x + 1); ++i) {
          const Sum& s = sums[static_cast<std::size_t>(j) * tiles.across + i];
          const double weight = i == x && j == y ? 1 : 0.25;
          all.pixels += weight * s.pixels;
          for (int c = 0; c < 2; ++c) all.error[c] += weight * s.error[c];
        }
      const std::size_t index = static_cast<std::size_t>(y) * tiles.across + x;
      if (all.pixels > 0) squared[index] = std::max(all.error[0], all.error[1]) / all.pixels;
      root += sums[index].pixels * std::sqrt(squared[index]);
      pixels += sums[index].pixels;
    }
  // The least samples for a mean squared error E^2 of the picture, of tiles whose own falls as 1 / n: n in proportion to its root
  // (Neyman 1934).
  const double scale = pixels > 0 ? 2 * pilot_samples * root / (pixels * t.options.target_error * t.options.target_error) : 0;
  const int levels = std::bit_width(static_cast<unsigned>(most_samples / least_samples));
  for (std::size_t i = 0; i < squared.size(); ++i) {
    const double wanted = scale * std::sqrt(squared[i]);
    int level = 0;
    while (level < levels - 1 && (least_samples << level) * std::numbers::sqrt2 < wanted) ++level;  // the nearest power of two
    tiles.place[i] = static_cast<std::uint8_t>(level);
  }
  tiles.places.clear();
  for (int level = 0; level < levels; ++level)
    tiles.places.emplace_back(filter, mix64(t.options.stream + static_cast<std::uint64_t>(level) + 1), least_samples << level);
}

}  // namespace

Radiance trace_radiance(const Scene& scene, const Lights& lights, const Accel& accel, const Camera& camera, const PixelMask& mask,
                        const PathOptions& options) {
  Radiance out;
  out.coats.assign(scene.appearance->coat_count, ImageF(camera.width, camera.height, 4));
  check(scene.appearance->coat_count >= 1 && scene.appearance->coat_count <= most_coats, "a batch holds 1 to 128 coats");
  check(options.samples >= 1, "at least one sample a pixel");
  for (const auto& p : scene.appearance->paints) check(static_cast<int>(p->coats.size()) == scene.appearance->coat_count, "a paint has another number of coats");
  if (options.light) check(options.light->padded == padded_coats(scene.appearance->coat_count), "light on the surface is of another batch of coats");
  const Tracer tracer{scene, lights, accel, options, options.light};
  const PixelFilter filter(options.filter_radius);
  Tiles tiles(camera, filter);
  if (options.target_error > 0)
    choose_samples(tracer, camera, mask, filter, tiles, out);
  else
    tiles.places.emplace_back(filter, options.stream, options.samples);
  with_padded_coats(scene.appearance->coat_count, [&]<int P>() { trace_tiles<P>(tracer, camera, mask, tiles, out); });
  if (options.target_error > 0 && tiles.reach > 0) even_out_borders(tiles, mask, out);
  return out;
}

double mean_chosen_samples(const Scene& scene, const Lights& lights, const Accel& accel, const Camera& camera, const PixelMask& mask,
                           const PathOptions& options) {
  check(options.target_error > 0, "samples follow from a target error");
  const PixelFilter filter(options.filter_radius);
  Tiles tiles(camera, filter);
  Radiance pilot;
  choose_samples({scene, lights, accel, options, options.light}, camera, mask, filter, tiles, pilot);
  const PixelMask traced = within_reach(mask, tiles.reach);
  double samples = 0, pixels = 0;
  for (int y = 0; y < traced.height; ++y)
    for (int x = 0; x < traced.width; ++x)
      if (traced.get(x, y)) {
        samples += tiles.at(x, y).samples();
        ++pixels;
      }
  return pixels > 0 ? samples / pixels : 0;
}

}  // namespace moomill
