// Packing of charts by their outlines on a raster.
#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "rigs/unwrap.h"

namespace moomill {
namespace {

using Index = std::uint32_t;
using Word = std::uint64_t;

// One bit per cell, rows of whole words with one to spare, so that shifted rows may be read past their end.
struct Raster {
  int width = 0, height = 0, words = 0;
  std::vector<Word> bits;
  Raster() = default;
  Raster(int w, int h) : width(w), height(h), words(w / 64 + 2), bits(static_cast<std::size_t>(words) * h, 0) {}
  void set(int x, int y) { bits[static_cast<std::size_t>(y) * words + x / 64] |= Word{1} << (x % 64); }
  bool get(int x, int y) const { return bits[static_cast<std::size_t>(y) * words + x / 64] >> (x % 64) & 1; }
  const Word* row(int y) const { return &bits[static_cast<std::size_t>(y) * words]; }
  Word* row(int y) { return &bits[static_cast<std::size_t>(y) * words]; }
};

dvec2 turned(const dvec2& p, double angle) {
  const double c = std::cos(angle), s = std::sin(angle);
  return {c * p.x - s * p.y, s * p.x + c * p.y};
}

std::pair<dvec2, dvec2> extent(const std::vector<dvec2>& points) {
  dvec2 lower(std::numeric_limits<double>::infinity()), upper = -lower;
  for (const dvec2& p : points) lower = glm::min(lower, p), upper = glm::max(upper, p);
  return {lower, upper};
}

double flat_area(const Chart& chart, const std::vector<uvec3>& triangles) {
  const auto at = [&](Index v) {
    return chart.flat[std::lower_bound(chart.vertices.begin(), chart.vertices.end(), v) - chart.vertices.begin()];
  };
  double sum = 0;
  for (const Index t : chart.triangles) {
    const dvec2 b = at(triangles[t].y) - at(triangles[t].x), c = at(triangles[t].z) - at(triangles[t].x);
    sum += 0.5 * std::abs(b.x * c.y - b.y * c.x);
  }
  return sum;
}

// Turns a chart so that its bounding rectangle is smallest and lies flat, its lower corner at the origin.
void lay_flat(Chart& chart) {
  const auto turned_extent = [&](double angle) {
    std::vector<dvec2> points = chart.flat;
    for (dvec2& p : points) p = turned(p, angle);
    const auto [lower, upper] = extent(points);
    return upper - lower;
  };
  double best = 0, least = std::numeric_limits<double>::infinity();
  for (int i = 0; i < 36; ++i) {
    const dvec2 size = turned_extent(i * 5 * degrees);
    const double area = size.x * size.y * (size.x >= size.y ? 1.0 : 1.0001);
    if (area < least * 0.99999) least = area, best = i * 5 * degrees;
  }
  if (const dvec2 size = turned_extent(best); size.y > size.x) best += 90 * degrees;
  for (dvec2& p : chart.flat) p = turned(p, best);
  const dvec2 lower = extent(chart.flat).first;
  for (dvec2& p : chart.flat) p -= lower;
}

// A chart in one of four turns by right angles: exact, so that coordinates stay what they are.
dvec2 quarter(const dvec2& p, int turn, const dvec2& size) {
  switch (turn) {
    case 1: return {size.y - p.y, p.x};
    case 2: return {size.x - p.x, size.y - p.y};
    case 3: return {p.y, size.x - p.x};
    default: return p;
  }
}

// Every cell that a triangle of the chart touches (or is within rounding of it).
Raster outline(const Chart& chart, const std::vector<uvec3>& triangles, int turn, double cells_per_metre) {
  const dvec2 size = extent(chart.flat).second;
  std::vector<dvec2> at;
  for (const dvec2& p : chart.flat) at.push_back(quarter(p, turn, size) * cells_per_metre);
  const dvec2 cells = (turn % 2 ? dvec2(size.y, size.x) : size) * cells_per_metre;
  Raster raster(static_cast<int>(cells.x + 1e-9) + 1, static_cast<int>(cells.y + 1e-9) + 1);
  const auto local = [&](Index v) {
    return at[std::lower_bound(chart.vertices.begin(), chart.vertices.end(), v) - chart.vertices.begin()];
  };
  for (const Index t : chart.triangles) {
    const std::array<dvec2, 3> p{local(triangles[t].x), local(triangles[t].y), local(triangles[t].z)};
    const dvec2 low = glm::min(p[0], glm::min(p[1], p[2])), high = glm::max(p[0], glm::max(p[1], p[2]));
    // Row by row the span of the triangle within the row.
    const int y0 = std::max(0, static_cast<int>(std::floor(low.y - 1e-9))),
              y1 = std::min(raster.height - 1, static_cast<int>(std::floor(high.y + 1e-9)));
    for (int y = y0; y <= y1; ++y) {
      double left = std::numeric_limits<double>::infinity(), right = -left;
      const double bottom = y - 1e-9, top = y + 1 + 1e-9;
      for (int k = 0; k < 3; ++k) {
        const dvec2 &a = p[k], &b = p[(k + 1) % 3];
        if (a.y >= bottom && a.y <= top) left = std::min(left, a.x), right = std::max(right, a.x);
        for (const double line : {bottom, top}) {
          if ((a.y - line) * (b.y - line) >= 0) continue;
          const double x = a.x + (b.x - a.x) * (line - a.y) / (b.y - a.y);
          left = std::min(left, x), right = std::max(right, x);
        }
      }
      const int x0 = std::max(0, static_cast<int>(std::floor(std::max(left, low.x) - 1e-9))),
                x1 = std::min(raster.width - 1, static_cast<int>(std::floor(std::min(right, high.x) + 1e-9)));
      for (int x = x0; x <= x1; ++x) raster.set(x, y);
    }
  }
  return raster;
}

// The raster, grown by `cells` all around: no cell set here may be another chart's, which leaves `cells` free ones.
// Grown by whole cells in a disc of squares: two cells conflict when the gap between them is less than `cells`.
Raster grown(const Raster& r, int cells) {
  Raster result(r.width + 2 * cells, r.height + 2 * cells);
  for (int y = 0; y < r.height; ++y)
    for (int x = 0; x < r.width; ++x) {
      if (!r.get(x, y)) continue;
      const bool inner = x > 0 && y > 0 && x + 1 < r.width && y + 1 < r.height && r.get(x - 1, y) && r.get(x + 1, y) &&
                         r.get(x, y - 1) && r.get(x, y + 1);
      if (inner) {
        result.set(x + cells, y + cells);
        continue;
      }
      for (int dy = -cells; dy <= cells; ++dy)
        for (int dx = -cells; dx <= cells; ++dx) {
          const int gx = std::max(std::abs(dx) - 1, 0), gy = std::max(std::abs(dy) - 1, 0);
          if (gx * gx + gy * gy < cells * cells) result.set(x + dx + cells, y + dy + cells);
        }
    }
  return result;
}

// 64 cells of a row from x on, which may be negative.
Word at_offset(const Word* row, int words, int x) {
  const int word = x >> 6, shift = x & 63;
  const Word low = word >= 0 && word < words ? row[word] >> shift : 0;
  const Word high = shift && word + 1 >= 0 && word + 1 < words ? row[word + 1] << (64 - shift) : 0;
  return low | high;
}

bool collides(const Raster& atlas, const Raster& chart, int x, int y) {
  const int words = (chart.width + 63) / 64;
  for (int r = 0; r < chart.height; ++r) {
    if (y + r < 0 || y + r >= atlas.height) continue;
    const Word *own = chart.row(r), *there = atlas.row(y + r);
    for (int w = 0; w < words; ++w)
      if (own[w] && (own[w] & at_offset(there, atlas.words, x + 64 * w))) return true;
  }
  return false;
}

struct Place {
  int x = 0, y = 0, turn = 0;
  int top = std::numeric_limits<int>::max();
};

// All charts at this scale on a square of side x side cells, or an empty list.
std::vector<Place> place_all(const std::vector<Chart>& charts, const std::vector<uvec3>& triangles,
                             const std::vector<std::size_t>& order, int side, int gutter, double cells_per_metre) {
  Raster atlas(side, side);
  std::vector<Place> places(charts.size());
  const int margin = (gutter + 1) / 2;
  for (const std::size_t i : order) {
    std::array<Place, 4> found;
    std::array<Raster, 4> shapes;
    parallel_for(4, 1, [&](std::size_t turn) {
      shapes[turn] = outline(charts[i], triangles, static_cast<int>(turn), cells_per_metre);
      const Raster wide = grown(shapes[turn], gutter);
      const int w = shapes[turn].width, h = shapes[turn].height;
      for (int y = margin; y + h + margin <= side; ++y)
        for (int x = margin; x + w + margin <= side; ++x)
          if (!collides(atlas, wide, x - gutter, y - gutter)) {
            found[turn] = {x, y, static_cast<int>(turn), y + h};
            return;
          }
    });
    const Place& best = *std::min_element(found.begin(), found.end(), [](const Place& a, const Place& b) {
      return a.top != b.top ? a.top < b.top : a.x < b.x;
    });
    if (best.top > side) return {};
    places[i] = best;
    const Raster& shape = shapes[best.turn];
    for (int y = 0; y < shape.height; ++y)
      for (int x = 0; x < shape.width; ++x)
        if (shape.get(x, y)) atlas.set(best.x + x, best.y + y);
  }
  return places;
}

}  // namespace

void pack_charts(std::vector<Chart>& charts, const std::vector<uvec3>& triangles, double gutter) {
  for (Chart& chart : charts) lay_flat(chart);
  std::vector<double> area(charts.size(), 0.0);
  double covered = 0;  // square metres
  for (std::size_t c = 0; c < charts.size(); ++c) {
    const dvec2 size = extent(charts[c].flat).second;
    area[c] = size.x * size.y;
    covered += flat_area(charts[c], triangles);
  }
  std::vector<std::size_t> order(charts.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return area[a] > area[b]; });
  // A gutter of two cells, so the raster is as fine as the gutter asks for, within reason.
  const int side = gutter > 0 ? std::clamp(static_cast<int>(std::floor(2 / gutter)), 256, 1024) : 512;
  const int gutter_cells = static_cast<int>(std::ceil(gutter * side - 1e-9));
  // Cells per metre: from what fills some 3/5 of the square, up in steps while it fits, or down until it does.
  double low = 0, high = 0;
  std::vector<Place> best;
  const auto fits = [&](double scale) {
    std::vector<Place> places = place_all(charts, triangles, order, side, gutter_cells, scale);
    if (places.empty()) {
      high = scale;
      return false;
    }
    low = scale, best = std::move(places);
    return true;
  };
  const double first = side * std::sqrt(0.6 / covered);
  if (fits(first)) {
    while (fits(low * 1.03)) {}
  } else {
    for (double step = 0.97; high > 1e-3 * first && !fits(high * step); step *= step) {}
  }
  if (best.empty())
    input_error("{} UV charts do not fit with a gutter of {}; lower 'gutter' in [builder]", charts.size(), gutter);
  fits(0.5 * (low + high));
  for (std::size_t c = 0; c < charts.size(); ++c) {
    const dvec2 size = extent(charts[c].flat).second;
    for (dvec2& p : charts[c].flat)
      p = (quarter(p, best[c].turn, size) * low + dvec2(best[c].x, best[c].y)) / static_cast<double>(side);
  }
}

}  // namespace moomill
