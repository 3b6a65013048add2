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

glm::ivec2 choose_texel(const TexturePlacement& placement, int width, int height, const vec2& uv, const vec2& xi) {
  const vec2 q = place(placement, uv);
  const float x = texel_coordinate(q.x, width), y = texel_coordinate(q.y, height);
  const float x0 = std::floor(x), y0 = std::floor(y);
  const int ix = static_cast<int>(x0) + (x - x0 > xi.x ? 1 : 0);
  const int iy = static_cast<int>(y0) + (y - y0 > xi.y ? 1 : 0);
  return {wrap(ix, width, placement.wrap_u), wrap(iy, height, placement.wrap_v)};
}

namespace {

// The four texels around a point and their weights.
struct Corners {
  const std::uint8_t* texel[4];
  float fx, fy;
  float mix(int c) const {
    const float top = texel[0][c] * (1 - fx) + texel[1][c] * fx, bottom = texel[2][c] * (1 - fx) + texel[3][c] * fx;
    return (top * (1 - fy) + bottom * fy) / 255.0f;
  }
};
Corners corners_at(const Texture& texture, const vec2& uv) {
  const Image8& im = texture.image;
  const vec2 q = place(texture.placement, uv);
  const float x = texel_coordinate(q.x, im.width), y = texel_coordinate(q.y, im.height);
  const float x0 = std::floor(x), y0 = std::floor(y);
  const int xa = wrap(static_cast<int>(x0), im.width, texture.placement.wrap_u);
  const int xb = wrap(static_cast<int>(x0) + 1, im.width, texture.placement.wrap_u);
  const int ya = wrap(static_cast<int>(y0), im.height, texture.placement.wrap_v);
  const int yb = wrap(static_cast<int>(y0) + 1, im.height, texture.placement.wrap_v);
  const std::uint8_t* data = im.data.data();
  return {{data + im.index(xa, ya), data + im.index(xb, ya), data + im.index(xa, yb), data + im.index(xb, yb)}, x - x0, y - y0};
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

vec3 single_paint(const Paint::PerCoat& coat, const std::vector<std::shared_ptr<const Texture>>& textures, const vec2& uv,
                  const vec3& vertex_color, const vec2& xi) {
  const auto& srgb = srgb_table();
  vec3 color = coat.factor;
  if (coat.texture >= 0) {
    const Texture& tex = *textures[coat.texture];
    const glm::ivec2 texel = choose_texel(tex.placement, tex.image.width, tex.image.height, uv, xi);
    const std::uint8_t* s = &tex.image.data[tex.image.index(texel.x, texel.y)];
    // One and two channels are grey and grey with alpha.
    color *= tex.image.channels >= 3 ? vec3(srgb[s[0]], srgb[s[1]], srgb[s[2]]) : vec3(srgb[s[0]]);
  }
  return coat.vertex_colors ? color * vertex_color : color;
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

namespace {

// The choices that choose_texel() makes of four numbers xi, and how often it makes each.
constexpr vec2 corner_xi[4] = {{1, 1}, {0, 1}, {1, 0}, {0, 0}};
void corner_weights(const TexturePlacement& placement, int width, int height, const vec2& uv, float* weight) {
  const vec2 q = place(placement, uv);
  const float x = texel_coordinate(q.x, width), y = texel_coordinate(q.y, height);
  const float fx = x - std::floor(x), fy = y - std::floor(y);
  weight[0] = (1 - fx) * (1 - fy);
  weight[1] = fx * (1 - fy);
  weight[2] = (1 - fx) * fy;
  weight[3] = fx * fy;
}

}  // namespace

PaintPoint find_paint(const Paint& paint, const vec2& uv, const vec3& vertex_color, const vec2& xi, bool all_four) {
  PaintPoint p;
  p.paint = &paint;
  p.all_four = all_four;
  p.uv = uv;
  p.xi = xi;
  p.vertex_color = vertex_color;
  if (paint.stack.empty()) return p;
  const std::size_t bytes = 3 * paint.coats.size();
  if (all_four) corner_weights(paint.stack_placement, paint.stack_width, paint.stack_height, uv, p.weight);
  for (int k = 0; k < (all_four ? 4 : 1); ++k) {
    p.texel[k] = stacked_texel(paint, uv, all_four ? corner_xi[k] : xi);
    for (std::size_t i = 0; i < bytes; i += 64) __builtin_prefetch(p.texel[k] + i);
    __builtin_prefetch(p.texel[k] + bytes - 1);
  }
  return p;
}

void fetch_single_paints(const PaintPoint& p, const std::vector<std::shared_ptr<const Texture>>& textures, int first, float (*base)[8], float (*square)[8]) {
  const int n = static_cast<int>(p.paint->coats.size());
  for (int i = 0; i < 8; ++i) {
    for (int c = 0; c < 3; ++c) base[c][i] = square[c][i] = 0;
    if (first + i >= n) continue;
    const Paint::PerCoat& coat = p.paint->coats[first + i];
    float weight[4] = {1, 0, 0, 0};
    const bool all_four = p.all_four && coat.texture >= 0;
    if (all_four) {
      const Texture& texture = *textures[coat.texture];
      corner_weights(texture.placement, texture.image.width, texture.image.height, p.uv, weight);
    }
    // The operations are those on a stack (path_kernel.h), so that a coat has the same bits in any batch.
    for (int k = 0; k < (all_four ? 4 : 1); ++k) {
      const vec3 color = single_paint(coat, textures, p.uv, p.vertex_color, all_four ? corner_xi[k] : p.xi);
      for (int c = 0; c < 3; ++c) {
        const float part = weight[k] * color[c];
        base[c][i] += part;
        square[c][i] = std::fma(part, color[c], square[c][i]);
      }
    }
  }
}

}  // namespace moomill
