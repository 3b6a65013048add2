// Views against keypoints, posed meshes and each other.
#include "generator/core/error.h"
#include "validate/context.h"

namespace moomill {
namespace {

constexpr double keypoint_bar = 1e-6;    // px and m: both sides are double
constexpr double parameters_bar = 1e-4;  // px
constexpr double nnopcs_bar = 2e-6;      // [0, 1]: float storage of corners and of the map
constexpr double pixel_bar = 0.01;       // px
constexpr double depth_bar = 1e-5;       // m, at 10 m or nearer
constexpr double search_radius = 1e-5;   // m around a decoded NNOPCS
constexpr std::size_t samples_per_view = 400;

std::string where(const ViewData& d, std::size_t pixel) {
  const std::size_t width = static_cast<std::size_t>(d.camera->width);
  return fmt::format("Frame {}, camera {}, pixel ({}, {})", d.view->frame, d.view->camera, pixel % width,
                     pixel / width);
}

dvec2 centre_of(const ViewData& d, std::size_t pixel) {
  const std::size_t width = static_cast<std::size_t>(d.camera->width);
  return {pixel % width + 0.5, pixel / width + 0.5};
}

dvec3 nnopcs_at(const ViewData& d, std::size_t pixel) {
  return {d.nnopcs.data[3 * pixel], d.nnopcs.data[3 * pixel + 1], d.nnopcs.data[3 * pixel + 2]};
}

// Foreground pixels spread evenly over the view.
std::vector<std::size_t> samples(const ViewData& d) {
  std::vector<std::size_t> all;
  for (std::size_t i = 0; i < d.silhouette.data.size(); ++i)
    if (d.foreground(i)) all.push_back(i);
  const std::size_t step = std::max<std::size_t>(1, all.size() / samples_per_view);
  std::vector<std::size_t> out;
  for (std::size_t i = static_cast<std::size_t>(d.view->camera) % step; i < all.size(); i += step)
    out.push_back(all[i]);
  return out;
}

// Whose surface a foreground pixel shows; -1 when the dataset does not say.
int animal_of(const Manifest& m, const ViewData& d, std::size_t pixel) {
  if (!d.instance.empty()) return int{d.instance.data[pixel]} - 1;
  return m.animals.size() == 1 || m.subset == Subset::occlusions ? labelled_animal : -1;
}

// What the depth map says about a keypoint inside the image.
enum class Verdict { undecided, hidden, visible };
Verdict verdict(const ViewData& d, const KeypointView& k, double tolerance) {
  const int x0 = static_cast<int>(std::floor(k.pixel.x)), y0 = static_cast<int>(std::floor(k.pixel.y));
  double nearest = std::numeric_limits<double>::infinity(), farthest = 0;
  int surfaces = 0, tested = 0;
  for (int y = y0 - 1; y <= y0 + 1; ++y)
    for (int x = x0 - 1; x <= x0 + 1; ++x) {
      if (x < 0 || y < 0 || x >= d.depth.width || y >= d.depth.height) continue;
      ++tested;
      const double depth = d.depth.at(x, y, 0);
      if (!(depth > 0)) continue;
      ++surfaces;
      nearest = std::min(nearest, depth);
      farthest = std::max(farthest, depth);
    }
  if (surfaces == 0) return Verdict::visible;
  if (surfaces != tested) return Verdict::undecided;  // at an outline
  // Between pixel centres the surface may bulge beyond what they saw: a margin of that range and 2 mm.
  const double slack = 0.002 + (farthest - nearest);
  const double slant =
      glm::length(dvec3((k.pixel.x - d.pinhole.cx) / d.pinhole.fx, (k.pixel.y - d.pinhole.cy) / d.pinhole.fy, 1));
  if ((k.depth - nearest + slack) * slant <= tolerance) return Verdict::visible;
  if ((k.depth - farthest - slack) * slant > tolerance) return Verdict::hidden;
  return Verdict::undecided;
}

}  // namespace

void check_keypoints(const Context& context, const StoredFrame& frame, const ViewData& d, Tally& tally) {
  const Manifest& m = context.dataset.manifest;
  const auto parameters = context.parameters.find(d.view->camera);
  for (std::size_t animal = 0; animal < d.view->keypoints.size() && animal < frame.frame.keypoints.size(); ++animal) {
    const std::vector<KeypointView>& views = d.view->keypoints[animal];
    const std::vector<dvec3>& points = frame.frame.keypoints[animal];
    for (std::size_t k = 0; k < views.size() && k < points.size(); ++k) {
      const KeypointView& v = views[k];
      const auto name = [&] {
        return fmt::format("Frame {}, camera {}, animal {}, keypoint {}", d.view->frame, d.view->camera, animal,
                           k < m.keypoint_names.size() ? m.keypoint_names[k] : std::to_string(k));
      };
      const double depth = d.pinhole.to_camera(points[k]).z;
      tally.within(Check::keypoints_matrix, std::abs(depth - v.depth), keypoint_bar,
                   [&] { return fmt::format("{}: the depth is {} and should be {}.", name(), v.depth, depth); });
      const std::optional<dvec2> pixel = d.pinhole.pixel(points[k]);
      const bool inside =
          pixel && pixel->x >= 0 && pixel->y >= 0 && pixel->x < d.camera->width && pixel->y < d.camera->height;
      if (pixel) {
        // A point far off the image is a small angle times a large number.
        const double bar = 1 + glm::distance(*pixel, dvec2(d.pinhole.cx, d.pinhole.cy)) / 1000;
        tally.within(Check::keypoints_matrix, glm::distance(*pixel, v.pixel), keypoint_bar * bar, [&] {
          return fmt::format("{}: it is at ({}, {}) and should be at ({}, {}).", name(), v.pixel.x, v.pixel.y, pixel->x,
                             pixel->y);
        });
        if (parameters != context.parameters.end() && !m.per_frame_cameras) {
          const std::optional<dvec2> other = parameters->second.pixel(points[k]);
          const double apart = other ? glm::distance(*other, v.pixel) : std::numeric_limits<double>::infinity();
          tally.within(Check::keypoints_parameters, apart, parameters_bar * bar, [&] {
            return fmt::format("{}: it is at ({}, {}), and parameters.cfg puts it {}.", name(), v.pixel.x, v.pixel.y,
                               other ? fmt::format("at ({}, {})", other->x, other->y) : "behind the camera");
          });
        }
      }
      // At the very border rounding decides.
      const bool border =
          pixel && (std::abs(pixel->x) < 1e-6 || std::abs(pixel->y) < 1e-6 ||
                    std::abs(pixel->x - d.camera->width) < 1e-6 || std::abs(pixel->y - d.camera->height) < 1e-6);
      if (!border) {
        tally.compared(Check::visibility);
        if ((v.visibility != Visibility::off_frame) != inside)
          tally.failed(Check::visibility, fmt::format("{}: it is {} the image, but its visibility is {}.", name(),
                                                      inside ? "inside" : "outside", static_cast<int>(v.visibility)));
      }
      // The depth map of `occlusions` shows one animal only, so what hides behind others is not in it.
      if (!inside || d.depth.empty() || v.cause == HiddenBy::other_animal || v.cause == HiddenBy::scenery) continue;
      if (m.subset == Subset::occlusions && static_cast<int>(animal) != labelled_animal) continue;
      const Verdict seen = verdict(d, v, k < m.keypoint_tolerance.size() ? m.keypoint_tolerance[k] : 0.0);
      if (seen == Verdict::undecided) continue;
      tally.compared(Check::visibility);
      if ((seen == Verdict::visible) != (v.visibility == Visibility::visible) && v.visibility != Visibility::off_frame)
        tally.failed(Check::visibility, fmt::format("{}: the depth map says {}, the record {}.", name(),
                                                    seen == Verdict::visible ? "visible" : "hidden",
                                                    v.visibility == Visibility::visible ? "visible" : "hidden"));
    }
  }
}

void check_surface(const Context& context, const PosedMeshes& posed, const ViewData& d, Tally& tally) {
  if (d.silhouette.empty() || (d.nnopcs.empty() && d.triangle.empty())) return;
  const Manifest& m = context.dataset.manifest;
  for (const std::size_t pixel : samples(d)) {
    const int only = animal_of(m, d, pixel);
    double best = std::numeric_limits<double>::infinity(), depth = 0;
    bool usable = false;
    for (int animal = 0; animal < static_cast<int>(posed.size()); ++animal) {
      if ((only >= 0 && animal != only) || !posed[animal]) continue;
      usable = true;
      const AnimalMesh& mesh = *context.meshes[animal];
      std::vector<MeshPoint> candidates;
      if (!d.triangle.empty()) {
        const std::uint32_t id = d.triangle.data[pixel];
        tally.compared(Check::label_values);
        if (id == 0 || id > mesh.rig.surface.triangles.size()) {
          tally.failed(Check::label_values, fmt::format("{}: triangle {} is not in the mesh.", where(d, pixel), id));
          continue;
        }
        candidates.push_back({id - 1, d.barycentrics.data[2 * pixel], d.barycentrics.data[2 * pixel + 1]});
        if (!d.nnopcs.empty()) {
          const dvec3 c = at(mesh.neutral, mesh.rig.surface.triangles[id - 1], candidates[0]) * mesh.scale + mesh.shift;
          tally.within(Check::surface_nnopcs, glm::length(c - nnopcs_at(d, pixel)), nnopcs_bar, [&] {
            const dvec3 v = nnopcs_at(d, pixel);
            return fmt::format("{}: NNOPCS is ({}, {}, {}) and its triangle gives ({}, {}, {}).", where(d, pixel), v.x,
                               v.y, v.z, c.x, c.y, c.z);
          });
        }
      } else {
        candidates = mesh.grid->near((nnopcs_at(d, pixel) - mesh.shift) / mesh.scale, search_radius);
      }
      for (const MeshPoint& point : candidates) {
        const dvec3 world = at(*posed[animal], mesh.rig.surface.triangles[point.triangle], point);
        const std::optional<dvec2> p = d.pinhole.pixel(world);
        if (!p || glm::distance(*p, centre_of(d, pixel)) >= best) continue;
        best = glm::distance(*p, centre_of(d, pixel));
        depth = d.pinhole.to_camera(world).z;
      }
    }
    if (!usable) continue;
    if (!std::isfinite(best)) {
      tally.compared(Check::surface_pixel);
      tally.failed(Check::surface_pixel, fmt::format("{}: no surface point has its NNOPCS.", where(d, pixel)));
      continue;
    }
    tally.within(Check::surface_pixel, best, pixel_bar,
                 [&] { return fmt::format("{}: its surface point is seen {} px beside it.", where(d, pixel), best); });
    if (d.depth.empty()) continue;
    const double stored = d.depth.data[3 * pixel];
    tally.within(Check::surface_depth, std::abs(stored - depth), depth_bar * std::max(1.0, depth / 10), [&] {
      return fmt::format("{}: the depth is {} m and its surface point is at {} m.", where(d, pixel), stored, depth);
    });
  }
}

void check_two_views(const Context& context, const ViewData& a, const ViewData& b, Tally& tally) {
  for (const ViewData* d : {&a, &b})
    if (d->silhouette.empty() || d->depth.empty() || d->nnopcs.empty()) return;
  const Manifest& m = context.dataset.manifest;
  const dvec3 box = glm::max(m.nnopcs_upper - m.nnopcs_lower, dvec3(1e-9));
  const dvec3 metres = m.nnopcs_normalization == "diagonal" ? dvec3(glm::length(box)) : box;
  for (const std::size_t pixel : samples(a)) {
    const dvec2 centre = centre_of(a, pixel);
    const dvec3 world = a.pinhole.world(centre.x, centre.y, a.depth.data[3 * pixel]);
    const std::optional<dvec2> seen = b.pinhole.pixel(world);
    if (!seen) continue;
    // The four pixel centres around it must be surface, and the surface there must be at the depth of the point:
    // else another part is in front.
    const int x = static_cast<int>(std::floor(seen->x - 0.5)), y = static_cast<int>(std::floor(seen->y - 0.5));
    if (x < 0 || y < 0 || x + 1 >= b.camera->width || y + 1 >= b.camera->height) continue;
    const double s = seen->x - 0.5 - x, t = seen->y - 0.5 - y;
    const double weights[4] = {(1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t};
    dvec3 nnopcs(0), lower(2), upper(-1);
    double depth = 0;
    bool surface = true;
    for (int k = 0; k < 4; ++k) {
      const std::size_t i = b.depth.index(x + k % 2, y + k / 2) / 3;
      surface = surface && b.foreground(i) && animal_of(m, a, pixel) == animal_of(m, b, i);
      nnopcs += weights[k] * nnopcs_at(b, i);
      depth += weights[k] * b.depth.data[3 * i];
      lower = glm::min(lower, nnopcs_at(b, i));
      upper = glm::max(upper, nnopcs_at(b, i));
    }
    const double spread = glm::length((upper - lower) * metres);
    if (!surface || spread > 0.03 || std::abs(depth - b.pinhole.to_camera(world).z) > 0.001) continue;
    const double apart = glm::length((nnopcs - nnopcs_at(a, pixel)) * metres);
    tally.within(Check::two_views, apart, spread + 0.002, [&] {
      return fmt::format("{}: in camera {} the same point of space shows a surface point {} m away.", where(a, pixel),
                         b.view->camera, apart);
    });
  }
}

}  // namespace moomill
