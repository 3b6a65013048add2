#include "generator/render/texture.h"

#include "generator/core/error.h"

namespace moomill {
namespace {

int wrap(int i, int n, Wrap mode) {
  switch (mode) {
    case Wrap::clamp: return std::clamp(i, 0, n - 1);
    case Wrap::mirror: {
      int k = i % (2 * n);
      if (k < 0) k += 2 * n;
      return k < n ? k : 2 * n - 1 - k;
    }
    case Wrap::repeat: break;
  }
  const int k = i % n;
  return k < 0 ? k + n : k;
}

vec2 place(const TexturePlacement& p, const vec2& uv) {
  if (p.rotation == 0) return uv * p.scale + p.offset;
  const float c = std::cos(p.rotation), s = std::sin(p.rotation);
  const vec2 q = uv * p.scale;
  return vec2(c * q.x + s * q.y, -s * q.x + c * q.y) + p.offset;
}

// Texel coordinates kept where an int holds them; a UV of 1e30 in a broken file must not overflow.
float texel_coordinate(float u, int n) {
  const float x = u * static_cast<float>(n) - 0.5f;
  return std::isfinite(x) ? std::clamp(x, -1e8f, 1e8f) : 0.0f;
}

}  // namespace

const std::array<float, 256>& srgb_table() {
  static const std::array<float, 256> table = [] {
    std::array<float, 256> t{};
    for (int i = 0; i < 256; ++i) {
      const double s = i / 255.0;
      t[i] = static_cast<float>(s <= 0.04045 ? s / 12.92 : std::pow((s + 0.055) / 1.055, 2.4));
    }
    return t;
  }();
  return table;
}

namespace {

// The four texels around a point: that at (x, y), before wrapping, and its neighbours to the right and below; fx and fy on the way to those.
struct Around {
  int x, y;
  float fx, fy;
  Around(const TexturePlacement& placement, int width, int height, const vec2& uv) {
    const vec2 q = place(placement, uv);
    const float u = texel_coordinate(q.x, width), v = texel_coordinate(q.y, height), left = std::floor(u), top = std::floor(v);
    x = static_cast<int>(left);
    y = static_cast<int>(top);
    fx = u - left;
    fy = v - top;
  }
};

}  // namespace

glm::ivec2 choose_texel(const TexturePlacement& placement, int width, int height, const vec2& uv, const vec2& xi) {
  const Around a(placement, width, height, uv);
  return {wrap(a.x + (a.fx > xi.x), width, placement.wrap_u), wrap(a.y + (a.fy > xi.y), height, placement.wrap_v)};
}

namespace {

// Their first bytes in a grid of texels of so many bytes: left and right, above and below.
std::array<const std::uint8_t*, 4> corners_of(const Around& a, const TexturePlacement& placement, int width, int height, const std::uint8_t* data, std::size_t bytes) {
  const int xa = wrap(a.x, width, placement.wrap_u), xb = wrap(a.x + 1, width, placement.wrap_u);
  const std::size_t ya = static_cast<std::size_t>(wrap(a.y, height, placement.wrap_v)) * width, yb = static_cast<std::size_t>(wrap(a.y + 1, height, placement.wrap_v)) * width;
  return {data + (ya + xa) * bytes, data + (ya + xb) * bytes, data + (yb + xa) * bytes, data + (yb + xb) * bytes};
}

// The four texels around a point and their weights.
struct Corners {
  std::array<const std::uint8_t*, 4> texel;
  float fx, fy;
  float mix(int c) const {
    const float top = texel[0][c] * (1 - fx) + texel[1][c] * fx, bottom = texel[2][c] * (1 - fx) + texel[3][c] * fx;
    return (top * (1 - fy) + bottom * fy) / 255.0f;
  }
};
Corners corners_at(const Texture& texture, const vec2& uv) {
  const Image8& im = texture.image;
  const Around a(texture.placement, im.width, im.height, uv);
  return {corners_of(a, texture.placement, im.width, im.height, im.data.data(), im.channels), a.fx, a.fy};
}

}  // namespace

float texture_value(const Texture& texture, const vec2& uv, int channel) {
  return corners_at(texture, uv).mix(std::min(channel, texture.image.channels - 1));
}

vec3 texture_rgb(const Texture& texture, const vec2& uv) {
  const Corners corners = corners_at(texture, uv);
  const int last = texture.image.channels - 1;
  return {corners.mix(0), corners.mix(std::min(1, last)), corners.mix(std::min(2, last))};
}

void build_stack(Paint& paint, const std::vector<const Image8*>& images) {
  check(!images.empty() && images.size() == paint.coats.size(), "a paint stack wants one image per coat");
  const int w = images[0]->width, h = images[0]->height, n = static_cast<int>(images.size());
  for (const Image8* im : images) check(im->width == w && im->height == h && im->channels >= 3, "a paint stack wants equal images");
  paint.stack_width = w;
  paint.stack_height = h;
  paint.stack.assign(static_cast<std::size_t>(w) * h * 3 * n + 8, 0);
  std::size_t out = 0;
  for (std::size_t p = 0; p < static_cast<std::size_t>(w) * h; ++p)
    for (int c = 0; c < 3; ++c)
      for (int t = 0; t < n; ++t) paint.stack[out++] = images[t]->data[p * images[t]->channels + c];
}

namespace {

const std::uint8_t* stacked_texel(const Paint& paint, const vec2& uv, const vec2& xi) {
  const glm::ivec2 texel = choose_texel(paint.stack_placement, paint.stack_width, paint.stack_height, uv, xi);
  return &paint.stack[(static_cast<std::size_t>(texel.y) * paint.stack_width + texel.x) * 3 * paint.coats.size()];
}

// Colour of a coat where it is read at this texel of its texture, if it has one.
vec3 coat_color(const Paint::PerCoat& coat, const std::uint8_t* texel, int channels, const vec3& vertex_color) {
  const auto& srgb = srgb_table();
  vec3 color = coat.factor;
  // One and two channels are grey and grey with alpha.
  if (texel) color *= channels >= 3 ? vec3(srgb[texel[0]], srgb[texel[1]], srgb[texel[2]]) : vec3(srgb[texel[0]]);
  return coat.vertex_colors ? color * vertex_color : color;
}

vec3 single_paint(const Paint::PerCoat& coat, const std::vector<std::shared_ptr<const Texture>>& textures, const vec2& uv,
                  const vec3& vertex_color, const vec2& xi) {
  if (coat.texture < 0) return coat_color(coat, nullptr, 0, vertex_color);
  const Image8& im = textures[coat.texture]->image;
  const glm::ivec2 at = choose_texel(textures[coat.texture]->placement, im.width, im.height, uv, xi);
  return coat_color(coat, &im.data[im.index(at.x, at.y)], im.channels, vertex_color);
}

}  // namespace

void fetch_paint(const Paint& paint, const std::vector<std::shared_ptr<const Texture>>& textures, const vec2& uv, const vec3& vertex_color,
                 const vec2& xi, int stride, float* base) {
  const int n = static_cast<int>(paint.coats.size());
  if (!paint.stack.empty()) {
    const auto& srgb = srgb_table();
    const std::uint8_t* s = stacked_texel(paint, uv, xi);
    for (int c = 0; c < 3; ++c)
      for (int t = 0; t < n; ++t) base[c * stride + t] = srgb[*s++];
    return;
  }
  for (int t = 0; t < n; ++t) {
    const vec3 color = single_paint(paint.coats[t], textures, uv, vertex_color, xi);
    for (int c = 0; c < 3; ++c) base[c * stride + t] = color[c];
  }
}

PaintPoint find_paint(const Paint& paint, const vec2& uv, const vec3& vertex_color, const vec2& xi, bool all_four) {
  PaintPoint p;
  p.paint = &paint;
  p.all_four = all_four;
  p.uv = uv;
  p.xi = xi;
  p.vertex_color = vertex_color;
  if (paint.stack.empty()) return p;
  const std::size_t bytes = 3 * paint.coats.size();
  if (all_four) {
    const Around a(paint.stack_placement, paint.stack_width, paint.stack_height, uv);
    p.texel = corners_of(a, paint.stack_placement, paint.stack_width, paint.stack_height, paint.stack.data(), bytes);
    p.fx = a.fx;
    p.fy = a.fy;
  } else {
    p.texel[0] = stacked_texel(paint, uv, xi);
  }
  for (const std::uint8_t* texel : p.texel) {
    if (!texel) break;
    for (std::size_t i = 0; i < bytes; i += 64) __builtin_prefetch(texel + i);
    __builtin_prefetch(texel + bytes - 1);
  }
  return p;
}

void fetch_single_paints(const PaintPoint& p, const std::vector<std::shared_ptr<const Texture>>& textures, int first, float (*base)[8], float (*square)[8]) {
  const int n = static_cast<int>(p.paint->coats.size());
  // The operations are those on a stack (path_kernel.h), so that a coat has the same bits in any batch.
  const auto between = [](float a, float b, float f) { return std::fma(f, b - a, a); };
  for (int i = 0; i < 8; ++i) {
    for (int c = 0; c < 3; ++c) base[c][i] = square[c][i] = 0;
    if (first + i >= n) continue;
    const Paint::PerCoat& coat = p.paint->coats[first + i];
    if (!p.all_four || coat.texture < 0) {
      const vec3 color = single_paint(coat, textures, p.uv, p.vertex_color, p.xi);
      for (int c = 0; c < 3; ++c) base[c][i] = color[c], square[c][i] = color[c] * color[c];
      continue;
    }
    const Corners corners = corners_at(*textures[coat.texture], p.uv);
    vec3 color[4];
    for (int k = 0; k < 4; ++k) color[k] = coat_color(coat, corners.texel[k], textures[coat.texture]->image.channels, p.vertex_color);
    for (int c = 0; c < 3; ++c) {
      const float v[4] = {color[0][c], color[1][c], color[2][c], color[3][c]};
      base[c][i] = between(between(v[0], v[1], corners.fx), between(v[2], v[3], corners.fx), corners.fy);
      square[c][i] = between(between(v[0] * v[0], v[1] * v[1], corners.fx), between(v[2] * v[2], v[3] * v[3], corners.fx), corners.fy);
    }
  }
}

}  // namespace moomill
