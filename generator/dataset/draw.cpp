#include "generator/dataset/draw.h"

#include <cctype>

#include "generator/core/error.h"

namespace moomill {
namespace {

struct Glyph {
  char letter;
  std::uint8_t rows[text_rows];  // five dots a row, the leftmost is the highest bit
};

// clang-format off
constexpr Glyph glyphs[] = {
    {'0', {0b01110, 0b10001, 0b10011, 0b10101, 0b11001, 0b10001, 0b01110}},
    {'1', {0b00100, 0b01100, 0b00100, 0b00100, 0b00100, 0b00100, 0b01110}},
    {'2', {0b01110, 0b10001, 0b00001, 0b00110, 0b01000, 0b10000, 0b11111}},
    {'3', {0b11110, 0b00001, 0b00001, 0b01110, 0b00001, 0b00001, 0b11110}},
    {'4', {0b00010, 0b00110, 0b01010, 0b10010, 0b11111, 0b00010, 0b00010}},
    {'5', {0b11111, 0b10000, 0b11110, 0b00001, 0b00001, 0b10001, 0b01110}},
    {'6', {0b00110, 0b01000, 0b10000, 0b11110, 0b10001, 0b10001, 0b01110}},
    {'7', {0b11111, 0b00001, 0b00010, 0b00100, 0b01000, 0b01000, 0b01000}},
    {'8', {0b01110, 0b10001, 0b10001, 0b01110, 0b10001, 0b10001, 0b01110}},
    {'9', {0b01110, 0b10001, 0b10001, 0b01111, 0b00001, 0b00010, 0b01100}},
    {'A', {0b01110, 0b10001, 0b10001, 0b11111, 0b10001, 0b10001, 0b10001}},
    {'B', {0b11110, 0b10001, 0b10001, 0b11110, 0b10001, 0b10001, 0b11110}},
    {'C', {0b01110, 0b10001, 0b10000, 0b10000, 0b10000, 0b10001, 0b01110}},
    {'D', {0b11110, 0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b11110}},
    {'E', {0b11111, 0b10000, 0b10000, 0b11110, 0b10000, 0b10000, 0b11111}},
    {'F', {0b11111, 0b10000, 0b10000, 0b11110, 0b10000, 0b10000, 0b10000}},
    {'G', {0b01110, 0b10001, 0b10000, 0b10111, 0b10001, 0b10001, 0b01110}},
    {'H', {0b10001, 0b10001, 0b10001, 0b11111, 0b10001, 0b10001, 0b10001}},
    {'I', {0b01110, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100, 0b01110}},
    {'J', {0b00111, 0b00010, 0b00010, 0b00010, 0b00010, 0b10010, 0b01100}},
    {'K', {0b10001, 0b10010, 0b10100, 0b11000, 0b10100, 0b10010, 0b10001}},
    {'L', {0b10000, 0b10000, 0b10000, 0b10000, 0b10000, 0b10000, 0b11111}},
    {'M', {0b10001, 0b11011, 0b10101, 0b10101, 0b10001, 0b10001, 0b10001}},
    {'N', {0b10001, 0b11001, 0b10101, 0b10011, 0b10001, 0b10001, 0b10001}},
    {'O', {0b01110, 0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b01110}},
    {'P', {0b11110, 0b10001, 0b10001, 0b11110, 0b10000, 0b10000, 0b10000}},
    {'Q', {0b01110, 0b10001, 0b10001, 0b10001, 0b10101, 0b10010, 0b01101}},
    {'R', {0b11110, 0b10001, 0b10001, 0b11110, 0b10100, 0b10010, 0b10001}},
    {'S', {0b01111, 0b10000, 0b10000, 0b01110, 0b00001, 0b00001, 0b11110}},
    {'T', {0b11111, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100}},
    {'U', {0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b01110}},
    {'V', {0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b01010, 0b00100}},
    {'W', {0b10001, 0b10001, 0b10001, 0b10101, 0b10101, 0b11011, 0b10001}},
    {'X', {0b10001, 0b10001, 0b01010, 0b00100, 0b01010, 0b10001, 0b10001}},
    {'Y', {0b10001, 0b10001, 0b01010, 0b00100, 0b00100, 0b00100, 0b00100}},
    {'Z', {0b11111, 0b00001, 0b00010, 0b00100, 0b01000, 0b10000, 0b11111}},
    {'.', {0b00000, 0b00000, 0b00000, 0b00000, 0b00000, 0b01100, 0b01100}},
    {',', {0b00000, 0b00000, 0b00000, 0b00000, 0b01100, 0b00100, 0b01000}},
    {'-', {0b00000, 0b00000, 0b00000, 0b11111, 0b00000, 0b00000, 0b00000}},
    {'_', {0b00000, 0b00000, 0b00000, 0b00000, 0b00000, 0b00000, 0b11111}},
    {':', {0b00000, 0b01100, 0b01100, 0b00000, 0b01100, 0b01100, 0b00000}},
    {'/', {0b00001, 0b00001, 0b00010, 0b00100, 0b01000, 0b10000, 0b10000}},
    {'(', {0b00010, 0b00100, 0b01000, 0b01000, 0b01000, 0b00100, 0b00010}},
    {')', {0b01000, 0b00100, 0b00010, 0b00010, 0b00010, 0b00100, 0b01000}},
    {'%', {0b11001, 0b11001, 0b00010, 0b00100, 0b01000, 0b10011, 0b10011}},
    {'+', {0b00000, 0b00100, 0b00100, 0b11111, 0b00100, 0b00100, 0b00000}},
    {'=', {0b00000, 0b00000, 0b11111, 0b00000, 0b11111, 0b00000, 0b00000}},
    {'#', {0b01010, 0b01010, 0b11111, 0b01010, 0b11111, 0b01010, 0b01010}},
};
// clang-format on

void blend(Image8& image, int x, int y, const Color8& color, double alpha) {
  if (x < 0 || y < 0 || x >= image.width || y >= image.height || alpha <= 0) return;
  for (int c = 0; c < 3; ++c) {
    std::uint8_t& v = image.at(x, y, c);
    v = static_cast<std::uint8_t>(v + (color[c] - v) * std::min(alpha, 1.0) + 0.5);
  }
}

// Covers pixels whose centre is within half a pixel of the shape; distance() is negative inside.
template <class Distance>
void fill(Image8& image, const dvec2& lower, const dvec2& upper, const Color8& color, const Distance& distance) {
  if (!all_finite(lower) || !all_finite(upper)) return;
  const auto first = [](double v, int limit) { return static_cast<int>(std::clamp(v - 1, 0.0, double(limit))); };
  const auto last = [](double v, int limit) { return static_cast<int>(std::clamp(v + 2, 0.0, double(limit))); };
  for (int y = first(lower.y, image.height); y < last(upper.y, image.height); ++y)
    for (int x = first(lower.x, image.width); x < last(upper.x, image.width); ++x)
      blend(image, x, y, color, 0.5 - distance(dvec2(x + 0.5, y + 0.5)));
}

}  // namespace

void draw_disc(Image8& image, const dvec2& centre, double radius, const Color8& color) {
  fill(image, centre - radius, centre + radius, color,
       [&](const dvec2& p) { return glm::distance(p, centre) - radius; });
}

void draw_ring(Image8& image, const dvec2& centre, double radius, double thickness, const Color8& color) {
  fill(image, centre - radius - thickness, centre + radius + thickness, color,
       [&](const dvec2& p) { return std::abs(glm::distance(p, centre) - radius) - 0.5 * thickness; });
}

void draw_line(Image8& image, const dvec2& a, const dvec2& b, double thickness, const Color8& color) {
  const dvec2 along = b - a;
  const double length2 = glm::dot(along, along);
  fill(image, glm::min(a, b) - thickness, glm::max(a, b) + thickness, color, [&](const dvec2& p) {
    const double t = length2 > 0 ? std::clamp(glm::dot(p - a, along) / length2, 0.0, 1.0) : 0.0;
    return glm::distance(p, a + t * along) - 0.5 * thickness;
  });
}

void draw_text(Image8& image, int x, int y, std::string_view text, int scale, const Color8& color) {
  for (const char c : text) {
    const char upper = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
    for (const Glyph& glyph : glyphs) {
      if (glyph.letter != upper) continue;
      for (int row = 0; row < text_rows * scale; ++row)
        for (int column = 0; column < 5 * scale; ++column)
          if (glyph.rows[row / scale] >> (4 - column / scale) & 1) blend(image, x + column, y + row, color, 1);
    }
    x += 6 * scale;
  }
}

int text_width(std::string_view text, int scale) {
  return static_cast<int>(text.size()) * 6 * scale;
}

void paste(Image8& image, int x0, int y0, const Image8& picture) {
  check(image.channels == 3 && picture.channels == 3, "pictures have three channels");
  for (int y = 0; y < picture.height; ++y)
    for (int x = 0; x < picture.width; ++x)
      blend(image, x0 + x, y0 + y, {picture.at(x, y, 0), picture.at(x, y, 1), picture.at(x, y, 2)}, 1);
}

Image8 scale_down(const Image8& image, int width, int height) {
  Image8 out(width, height, image.channels);
  for (int y = 0; y < height; ++y) {
    const int y0 = static_cast<int>(std::int64_t{y} * image.height / height);
    const int y1 = std::max(y0 + 1, static_cast<int>(std::int64_t{y + 1} * image.height / height));
    for (int x = 0; x < width; ++x) {
      const int x0 = static_cast<int>(std::int64_t{x} * image.width / width);
      const int x1 = std::max(x0 + 1, static_cast<int>(std::int64_t{x + 1} * image.width / width));
      for (int c = 0; c < image.channels; ++c) {
        int sum = 0;
        for (int yy = y0; yy < y1; ++yy)
          for (int xx = x0; xx < x1; ++xx) sum += image.at(xx, yy, c);
        const int count = (y1 - y0) * (x1 - x0);
        out.at(x, y, c) = static_cast<std::uint8_t>((sum + count / 2) / count);
      }
    }
  }
  return out;
}

}  // namespace moomill
