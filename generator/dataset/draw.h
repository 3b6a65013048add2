#pragma once
// Lines, discs and letters on an 8-bit RGB picture; whatever lies outside it is cut off.
#include <array>
#include <string_view>

#include "generator/core/image.h"
#include "generator/core/math.h"

namespace moomill {

using Color8 = std::array<std::uint8_t, 3>;

void draw_disc(Image8& image, const dvec2& centre, double radius, const Color8& color);
void draw_ring(Image8& image, const dvec2& centre, double radius, double thickness, const Color8& color);
void draw_line(Image8& image, const dvec2& a, const dvec2& b, double thickness, const Color8& color);

// Capitals, digits and a little punctuation, 5 x 7 dots a letter, each dot scale x scale pixels; (x, y) is the top
// left.
void draw_text(Image8& image, int x, int y, std::string_view text, int scale, const Color8& color);
int text_width(std::string_view text, int scale);
inline constexpr int text_rows = 7;

void paste(Image8& image, int x, int y, const Image8& picture);

// Mean over each target pixel's area; the picture keeps its channels.
Image8 scale_down(const Image8& image, int width, int height);

}  // namespace moomill
