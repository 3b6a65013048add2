#include <map>

#include "generator/core/color.h"
#include "generator/core/error.h"
#include "generator/core/topology.h"
#include "validate/studies/crosscheck.h"

namespace moomill {
namespace {

double median(std::vector<double>& values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

std::uint8_t to_srgb8(double linear) {
  const double c = std::clamp(linear, 0.0, 1.0);
  const double s = c <= 0.0031308 ? 12.92 * c : 1.055 * std::pow(c, 1 / 2.4) - 0.055;
  return static_cast<std::uint8_t>(std::lround(255 * s));
}

void require_same_size(const ImageF& a, const ImageF& b) {
  check(a.width == b.width && a.height == b.height && a.channels == 4 && b.channels == 4, "compared pictures have one size and four channels");
}

double distance_to_segment(const dvec2& p, const OutlineSegment& s) {
  const dvec2 along = s.b - s.a, from = p - s.a;
  const double length2 = glm::dot(along, along);
  const double t = length2 > 0 ? std::clamp(glm::dot(from, along) / length2, 0.0, 1.0) : 0.0;
  return glm::length(from - t * along);
}

}  // namespace

std::vector<OutlineSegment> outlines_in_view(const Scene& scene, const CameraRecord& camera) {
  std::vector<OutlineSegment> out;
  const auto& m = camera.world_to_camera;
  for (const Instance& in : scene.instances) {
    if (in.animal < 0) continue;
    const std::vector<uvec3>& triangles = in.surface->triangles;
    // Camera space in double; the outline is where the triangles' facing, seen from the camera, changes.
    std::vector<dvec3> p;
    for (const vec3& v : in.posed.positions) {
      const dvec3 w = dvec3(v) + scene.origin;
      dvec3 c;
      for (int r = 0; r < 3; ++r) c[r] = m[4 * r] * w.x + m[4 * r + 1] * w.y + m[4 * r + 2] * w.z + m[4 * r + 3];
      p.push_back(c);
    }
    const std::vector<std::uint32_t> place = weld(in.posed.positions);
    struct Sides {
      int facing = 0, away = 0;
      std::uint32_t a = 0, b = 0;
    };
    std::map<std::pair<std::uint32_t, std::uint32_t>, Sides> edges;
    for (const uvec3& t : triangles) {
      const bool facing = glm::dot(glm::cross(p[t[1]] - p[t[0]], p[t[2]] - p[t[0]]), p[t[0]]) < 0;
      for (int k = 0; k < 3; ++k) {
        const std::uint32_t a = t[k], b = t[(k + 1) % 3];
        Sides& s = edges[std::minmax(place[a], place[b])];
        (facing ? s.facing : s.away) += 1;
        s.a = a;
        s.b = b;
      }
    }
    for (const auto& [key, s] : edges) {
      if (s.facing + s.away > 1 && (s.facing == 0 || s.away == 0)) continue;
      const dvec3 &a = p[s.a], &b = p[s.b];
      if (a.z <= 0 || b.z <= 0) continue;
      out.push_back({{camera.fx * a.x / a.z + camera.cx, camera.fy * a.y / a.z + camera.cy},
                     {camera.fx * b.x / b.z + camera.cx, camera.fy * b.y / b.z + camera.cy}});
    }
  }
  return out;
}

double distance_to_outline(const dvec2& pixel, const std::vector<OutlineSegment>& outlines) {
  double nearest = std::numeric_limits<double>::infinity();
  for (const OutlineSegment& s : outlines) nearest = std::min(nearest, distance_to_segment(pixel, s));
  return nearest;
}

LabelDifference compare_labels(const LabelMaps& ours, const LabelMaps& theirs, const std::vector<OutlineSegment>& outlines) {
  check(ours.width == theirs.width && ours.height == theirs.height, "compared labels have one size");
  LabelDifference d;
  std::vector<double> depth, nnopcs;
  for (std::size_t p = 0; p < ours.animal.size(); ++p) {
    if (ours.animal[p] == 0 && theirs.animal[p] == 0) continue;
    ++d.pixels;
    if (ours.animal[p] != theirs.animal[p]) {
      ++d.differing;
      const double away = distance_to_outline({p % ours.width + 0.5, p / ours.width + 0.5}, outlines);
      d.unexplained += !(away <= outline_tolerance);
      d.farthest = std::max(d.farthest, away);
      continue;
    }
    ++d.compared;
    depth.push_back(std::abs(double(ours.depth[p]) - theirs.depth[p]));
    double worst = 0;
    for (int k = 0; k < 3; ++k) worst = std::max(worst, std::abs(double(ours.nnopcs[3 * p + k]) - theirs.nnopcs[3 * p + k]));
    nnopcs.push_back(worst);
    d.depth_off += !(depth.back() <= label_tolerance);
    d.nnopcs_off += !(worst <= label_tolerance);
    d.depth_worst = std::max(d.depth_worst, depth.back());
    d.nnopcs_worst = std::max(d.nnopcs_worst, worst);
  }
  d.depth_median = median(depth);
  d.nnopcs_median = median(nnopcs);
  return d;
}

ColorDifference compare_colors(const ImageF& ours, const ImageF& theirs, const std::vector<bool>& leave_out) {
  require_same_size(ours, theirs);
  ColorDifference d;
  dvec3 ours_kept(0), theirs_kept(0);
  double count = 0, alpha_ours = 0, alpha_theirs = 0, squares = 0;
  constexpr int block = 16;  // pixels
  const int blocks_x = (ours.width + block - 1) / block, blocks_y = (ours.height + block - 1) / block;
  std::vector<dvec3> sums(static_cast<std::size_t>(blocks_x) * blocks_y, dvec3(0));
  std::vector<double> counts(sums.size(), 0);
  for (int y = 0; y < ours.height; ++y)
    for (int x = 0; x < ours.width; ++x) {
      const float *a = &ours.data[ours.index(x, y)], *b = &theirs.data[theirs.index(x, y)];
      if (a[3] == 0 && b[3] == 0) continue;
      const dvec3 ca(a[0], a[1], a[2]), cb(b[0], b[1], b[2]), difference = ca - cb;
      const std::size_t i = static_cast<std::size_t>(y / block) * blocks_x + x / block;
      count += 1;
      d.ours += ca;
      d.theirs += cb;
      alpha_ours += a[3];
      alpha_theirs += b[3];
      squares += glm::dot(difference, difference) / 3;
      if (!leave_out.empty() && leave_out[static_cast<std::size_t>(y) * ours.width + x]) {
        d.left_out += 1;
        continue;
      }
      ours_kept += ca;
      theirs_kept += cb;
      sums[i] += difference;
      counts[i] += 1;
    }
  if (count == 0) return d;
  d.ours /= count;
  d.theirs /= count;
  d.alpha = alpha_theirs > 0 ? alpha_ours / alpha_theirs - 1 : std::numeric_limits<double>::infinity();
  const double level = std::max(1e-12, 0.2126 * d.theirs.x + 0.7152 * d.theirs.y + 0.0722 * d.theirs.z);
  for (int k = 0; k < 3; ++k) {
    d.worst_mean = std::max(d.worst_mean, std::abs(d.ours[k] - d.theirs[k]) / std::max(1e-12, d.theirs[k]));
    d.worst_mean_without = std::max(d.worst_mean_without, std::abs(ours_kept[k] - theirs_kept[k]) / std::max(1e-12, theirs_kept[k]));
  }
  d.rms = std::sqrt(squares / count) / level;
  d.left_out /= count;
  double block_squares = 0;
  int blocks = 0;
  for (std::size_t i = 0; i < sums.size(); ++i) {
    if (counts[i] < block * block / 2) continue;  // of a block that is mostly background a mean says little
    const dvec3 mean = sums[i] / counts[i];
    for (int k = 0; k < 3; ++k) d.block_worst = std::max(d.block_worst, std::abs(mean[k]) / level);
    block_squares += glm::dot(mean, mean) / 3;
    ++blocks;
  }
  d.block_rms = blocks > 0 ? std::sqrt(block_squares / blocks) / level : 0;
  return d;
}

Image8 difference_sheet(const ImageF& ours, const ImageF& theirs, double gain) {
  require_same_size(ours, theirs);
  const int w = ours.width, h = ours.height;
  Image8 sheet(3 * w, h, 3);
  for (int y = 0; y < h; ++y)
    for (int x = 0; x < w; ++x)
      for (int k = 0; k < 3; ++k) {
        const float a = ours.at(x, y, k), b = theirs.at(x, y, k);
        sheet.at(x, y, k) = to_srgb8(a);
        sheet.at(w + x, y, k) = to_srgb8(b);
        sheet.at(2 * w + x, y, k) = static_cast<std::uint8_t>(std::lround(std::clamp(128 + 255 * gain * (double(a) - b), 0.0, 255.0)));
      }
  return sheet;
}

Image8 label_sheet(const LabelMaps& ours, const LabelMaps& theirs) {
  const int w = ours.width, h = ours.height;
  Image8 sheet(4 * w, h, 3);
  // Of an error of 0 nothing is seen, of the tolerance a half, of twice as much all.
  auto level = [](double error) { return static_cast<std::uint8_t>(std::lround(127.5 * std::clamp(error / label_tolerance, 0.0, 2.0))); };
  for (int y = 0; y < h; ++y)
    for (int x = 0; x < w; ++x) {
      const std::size_t p = static_cast<std::size_t>(y) * w + x;
      for (int k = 0; k < 3; ++k) {
        if (ours.animal[p]) sheet.at(x, y, k) = static_cast<std::uint8_t>(std::lround(255 * std::clamp(ours.nnopcs[3 * p + k], 0.0f, 1.0f)));
        if (theirs.animal[p]) sheet.at(w + x, y, k) = static_cast<std::uint8_t>(std::lround(255 * std::clamp(theirs.nnopcs[3 * p + k], 0.0f, 1.0f)));
      }
      const bool either = ours.animal[p] || theirs.animal[p], same = ours.animal[p] == theirs.animal[p];
      for (int part = 2; part < 4 && either; ++part) {
        double error = 0;
        if (part == 2) error = std::abs(double(ours.depth[p]) - theirs.depth[p]);
        for (int k = 0; part == 3 && k < 3; ++k) error = std::max(error, std::abs(double(ours.nnopcs[3 * p + k]) - theirs.nnopcs[3 * p + k]));
        for (int k = 0; k < 3; ++k) sheet.at(part * w + x, y, k) = !same ? 255 : k == 0 ? level(error) : 40;
      }
    }
  return sheet;
}

}  // namespace moomill
