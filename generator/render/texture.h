#pragma once
// Textures, and base colours of many coats fetched at once.
#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "generator/core/image.h"
#include "generator/core/math.h"

namespace moomill {

// 8-bit sRGB to linear, 256 entries (IEC 61966-2-1).
const std::array<float, 256>& srgb_table();

struct TexturePlacement {  // glTF's texture transform and wrap modes
  Wrap wrap_u = Wrap::repeat, wrap_v = Wrap::repeat;
  vec2 offset{0}, scale{1};
  float rotation = 0;  // radians
  bool operator==(const TexturePlacement&) const = default;
};

struct Texture {
  Image8 image;  // 1 to 4 channels
  TexturePlacement placement;
};

// The texel that a bilinear look-up chooses with a probability equal to its weight (stochastic filtering: one fetch
// instead of four; the expectation is the bilinear value). xi in [0, 1)^2; xi = 0.5 gives the nearest texel.
glm::ivec2 choose_texel(const TexturePlacement& placement, int width, int height, const vec2& uv, const vec2& xi);

// Channel of a texture at uv, [0, 1], bilinear, not colour-converted. For roughness, metalness, normals and alpha.
float texture_value(const Texture& texture, const vec2& uv, int channel);
vec3 texture_rgb(const Texture& texture, const vec2& uv);  // its channels 0, 1, 2 at once; the last one stands for those it lacks

// Base colours of one material for every coat of the batch. The sampling never depends on them.
struct Paint {
  // Per coat: a colour, or a texture times a colour.
  struct PerCoat {
    vec3 factor{1};    // linear
    int texture = -1;  // index into Appearance::textures
    bool vertex_colors = false;
  };
  std::vector<PerCoat> coats;
  // When all coats are textures of one size and placement: their texels side by side, [y][x][channel][coat], so that
  // one look-up reads one run of memory. Then PerCoat::texture is not looked at.
  int stack_width = 0, stack_height = 0;
  std::vector<std::uint8_t> stack;  // sRGB; eight more bytes than texels, so that eight coats can be read anywhere
  TexturePlacement stack_placement;
};

// Interleaves equally sized images (3 or 4 channels, sRGB) into paint.stack.
void build_stack(Paint& paint, const std::vector<const Image8*>& images);

// base[c * stride + t] = linear base colour, channel c, coat t. `xi` as in choose_texel.
void fetch_paint(const Paint& paint, const std::vector<std::shared_ptr<const Texture>>& textures, const vec2& uv, const vec3& vertex_color,
                 const vec2& xi, int stride, float* base);

// Where a paint is read: the same for all coats, whose colours are fetched from there, eight at a time. One texel chosen by xi, or all four
// around the point: what is asked of them then is the mean of the colour and of its square, which is what the choice has in the mean.
struct PaintPoint {
  const Paint* paint = nullptr;
  std::array<const std::uint8_t*, 4> texel{};  // of the stack, if there is one, the first alone or all; on their way into the cache
  float fx = 0, fy = 0;                          // on the way from the left ones to the right, from the upper to the lower
  bool all_four = false;
  vec2 uv{0}, xi{0};
  vec3 vertex_color{1};
};
PaintPoint find_paint(const Paint& paint, const vec2& uv, const vec3& vertex_color, const vec2& xi, bool all_four);

// Of the coats first .. first + 7 without a stack: base[c][i], 0 beyond the last coat, and the mean of its square.
void fetch_single_paints(const PaintPoint& p, const std::vector<std::shared_ptr<const Texture>>& textures, int first, float (*base)[8], float (*square)[8]);

}  // namespace moomill
