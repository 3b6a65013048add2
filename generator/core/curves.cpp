#include "generator/core/curves.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace moomill {
namespace {

constexpr double width = 760, panel_height = 210, left = 78, right = 20, top = 46, gap = 44;
constexpr const char* colors[] = {"#1f6fb4", "#d1552b", "#2e8b57", "#8a4fa3", "#b08a1e", "#4a4a4a"};

std::string escape(const std::string& text) {
  std::string out;
  for (const char c : text) out += c == '<' ? "&lt;" : c == '>' ? "&gt;" : c == '&' ? "&amp;" : std::string(1, c);
  return out;
}

struct Axis {
  double low = 0, high = 1;
  bool logarithmic = false;
  double place(double v) const {  // 0 to 1
    return logarithmic ? (std::log10(v) - std::log10(low)) / (std::log10(high) - std::log10(low)) : (v - low) / (high - low);
  }
  bool shows(double v) const { return std::isfinite(v) && (!logarithmic || v > 0); }
  std::vector<double> ticks() const {
    std::vector<double> out;
    if (logarithmic) {
      const double decades = std::log10(high / low);
      for (double e = std::floor(std::log10(low)); e <= std::ceil(std::log10(high)); ++e)
        for (const double m : {1.0, 2.0, 5.0})
          if (const double v = m * std::pow(10, e); (m == 1 || decades < 3.5) && v >= low * 0.999 && v <= high * 1.001) out.push_back(v);
      return out;
    }
    const double step = std::pow(10, std::floor(std::log10((high - low) / 3)));
    const double nice = (high - low) / step > 8 ? ((high - low) / step > 16 ? 5 * step : 2 * step) : step;
    for (double v = std::ceil(low / nice) * nice; v <= high + 1e-9 * nice; v += nice) out.push_back(std::abs(v) < 1e-12 * nice ? 0 : v);
    return out;
  }
};

Axis axis_of(const std::vector<double>& values, bool may_be_logarithmic) {
  Axis a;
  double low = INFINITY, high = -INFINITY;
  for (const double v : values)
    if (std::isfinite(v)) low = std::min(low, v), high = std::max(high, v);
  if (!(low <= high)) return a;
  a.logarithmic = may_be_logarithmic && low > 0;
  if (a.logarithmic) {
    a.low = low / 1.15, a.high = high * 1.15;
  } else {
    const double margin = high > low ? (may_be_logarithmic ? 0.05 * (high - low) : 0) : std::max(1e-6, 0.05 * std::abs(high));
    a.low = low - margin, a.high = high + margin;
  }
  return a;
}

}  // namespace

std::string draw_curves(const std::string& title, const std::string& x_title, const std::vector<Panel>& panels, bool logarithmic_x) {
  const double height = top + static_cast<double>(panels.size()) * (panel_height + gap) + 14;
  std::string svg = fmt::format(
      "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {0} {1}\" width=\"{0}\" height=\"{1}\" font-family=\"sans-serif\" "
      "font-size=\"12\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n<text x=\"{2}\" y=\"20\" font-size=\"15\">{3}</text>\n",
      width, height, left, escape(title));
  std::vector<double> xs;
  for (const Panel& p : panels)
    for (const Curve& c : p.curves) xs.insert(xs.end(), c.x.begin(), c.x.end());
  const Axis x = axis_of(xs, logarithmic_x);
  for (std::size_t i = 0; i < panels.size(); ++i) {
    const Panel& p = panels[i];
    const double y0 = top + static_cast<double>(i) * (panel_height + gap), y1 = y0 + panel_height;
    std::vector<double> ys;
    for (const Curve& c : p.curves) ys.insert(ys.end(), c.y.begin(), c.y.end());
    if (p.bar != 0) ys.push_back(p.bar);
    const Axis y = axis_of(ys, true);
    const auto px = [&](double v) { return left + x.place(v) * (width - left - right); };
    const auto py = [&](double v) { return y1 - y.place(v) * panel_height; };
    svg += fmt::format("<text x=\"{}\" y=\"{:.1f}\">{}</text>\n", left, y0 - 6, escape(p.title));
    svg += fmt::format("<rect x=\"{}\" y=\"{:.1f}\" width=\"{}\" height=\"{}\" fill=\"none\" stroke=\"#888\"/>\n", left, y0,
                       width - left - right, panel_height);
    for (const double v : y.ticks())
      svg += fmt::format(
          "<line x1=\"{}\" x2=\"{}\" y1=\"{:.1f}\" y2=\"{:.1f}\" stroke=\"#ddd\"/><text x=\"{}\" y=\"{:.1f}\" "
          "text-anchor=\"end\">{:.4g}</text>\n",
          left, width - right, py(v), py(v), left - 6, py(v) + 4, v);
    for (const double v : x.ticks()) {
      if (x.logarithmic)
        svg += fmt::format("<line x1=\"{0:.1f}\" x2=\"{0:.1f}\" y1=\"{1:.1f}\" y2=\"{2:.1f}\" stroke=\"#ddd\"/>", px(v), y0, y1);
      svg += fmt::format("<text x=\"{:.1f}\" y=\"{:.1f}\" text-anchor=\"middle\">{:.4g}</text>\n", px(v), y1 + 16, v);
    }
    if (p.bar != 0)
      svg += fmt::format(
          "<line x1=\"{}\" x2=\"{}\" y1=\"{:.1f}\" y2=\"{:.1f}\" stroke=\"#c00\" stroke-dasharray=\"5 4\"/><text x=\"{}\" "
          "y=\"{:.1f}\" text-anchor=\"end\" fill=\"#c00\">{}</text>\n",
          left, width - right, py(p.bar), py(p.bar), width - right - 4, py(p.bar) - 4, escape(p.bar_name));
    double legend = left + 10 + 7.0 * static_cast<double>(p.title.size());
    for (std::size_t c = 0; c < p.curves.size(); ++c) {
      const char* color = colors[c % std::size(colors)];
      std::string points, marks;
      for (std::size_t k = 0; k < p.curves[c].x.size(); ++k)
        if (x.shows(p.curves[c].x[k]) && y.shows(p.curves[c].y[k])) {
          points += fmt::format("{:.1f},{:.1f} ", px(p.curves[c].x[k]), py(p.curves[c].y[k]));
          if (p.curves[c].x.size() <= 16 && !p.curves[c].dashed)  // few enough to be told apart
            marks += fmt::format("<circle cx=\"{:.1f}\" cy=\"{:.1f}\" r=\"2.6\" fill=\"{}\"/>", px(p.curves[c].x[k]), py(p.curves[c].y[k]), color);
        }
      svg += fmt::format("<polyline points=\"{}\" fill=\"none\" stroke=\"{}\" stroke-width=\"1.6\"{}/>\n", points, color,
                         p.curves[c].dashed ? " stroke-dasharray=\"2 4\"" : "");
      svg += marks;
      svg += fmt::format("<text x=\"{:.1f}\" y=\"{:.1f}\" fill=\"{}\">{}</text>\n", legend, y0 - 6, color, escape(p.curves[c].name));
      legend += 14 + 7.0 * static_cast<double>(p.curves[c].name.size());
    }
  }
  svg += fmt::format("<text x=\"{:.1f}\" y=\"{:.1f}\" text-anchor=\"middle\">{}</text>\n</svg>\n", (left + width - right) / 2,
                     height - 12, escape(x_title));
  return svg;
}

}  // namespace moomill
