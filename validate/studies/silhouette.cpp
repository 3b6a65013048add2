#include "validate/studies/silhouette.h"

#include <map>
#include <set>

#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "generator/dataset/draw.h"
#include "rigs/quadruped.h"
#include "scenes/scene.h"
#include "validate/studies/evolution.h"

namespace moomill {
namespace {

// The search, from coarse to fine pictures: pixels along the longest side of the reference, starts, generations, first
// step (of a unit below), and how much it costs to lie outside, per mean share of the length (see pull).
struct Level {
  int pixels, starts, generations;
  double step, pull;
  int tries;  // of the coordinate search that follows
};
constexpr Level levels[] = {{64, 3, 250, 0.5, 10, 0}, {128, 2, 250, 0.2, 0, 1500}, {384, 1, 30, 0.05, 0, 500}};
constexpr int population = 14;
constexpr double measured_pixel = 0.002;               // metres, of the overlap that is reported
// What a parameter of 1 stands for: one step of the search moves everything by about as much.
constexpr double offset_unit = 0.1, log_scale_unit = 0.1, turn_unit_deg = 10;

Box bounds(const SilhouetteMesh& mesh) {
  Box box;
  for (const uvec3& t : mesh.triangles)
    for (int k = 0; k < 3; ++k) box.add(mesh.points[t[k]]);
  return box;
}

bool matches(std::string_view pattern, std::string_view name) {
  if (pattern.empty()) return name.empty();
  if (pattern[0] != '*') return !name.empty() && name[0] == pattern[0] && matches(pattern.substr(1), name.substr(1));
  for (std::size_t skip = 0; skip <= name.size(); ++skip)
    if (matches(pattern.substr(1), name.substr(skip))) return true;
  return false;
}

SilhouetteGrid grid_over(const Box& box, const std::array<int, 2>& axes, double pixel, double margin) {
  SilhouetteGrid grid;
  grid.pixel = pixel;
  grid.lower = dvec2(box.lower[axes[0]], box.lower[axes[1]]) - margin;
  const dvec3 size = box.size();
  grid.width = static_cast<int>(std::ceil((size[axes[0]] + 2 * margin) / pixel));
  grid.height = static_cast<int>(std::ceil((size[axes[1]] + 2 * margin) / pixel));
  return grid;
}

// Nodes and bones only: enough to pose, cheap to copy for every trial.
Species skeleton_of(const Species& species) {
  Species s;
  s.rig.nodes = species.rig.nodes;
  s.rig.bones = species.rig.bones;
  s.neutral = species.neutral;
  if (s.neutral.local.empty()) s.neutral = bind_pose(s.rig);
  s.neutral.placement = dmat4(1.0);
  return s;
}

// The surface of a rig without some of its parts and, where `cell` is positive, with vertices merged that share a
// cell of that many metres: fewer points to move, for coarse pictures.
Rig thinned(const Rig& rig, const std::vector<vec3>& rest, const std::vector<char>& part_out, double cell) {
  Rig out;
  out.nodes = rig.nodes;
  out.bones = rig.bones;
  out.influence_begin = {0};
  std::map<std::array<std::int64_t, 3>, std::uint32_t> cells;
  std::vector<std::uint32_t> place(rest.size(), std::numeric_limits<std::uint32_t>::max());
  const auto keep = [&](std::uint32_t v) {
    if (place[v] != std::numeric_limits<std::uint32_t>::max()) return place[v];
    const auto fresh = static_cast<std::uint32_t>(out.surface.rest.size());
    if (cell > 0) {
      std::array<std::int64_t, 3> key;
      for (int k = 0; k < 3; ++k) key[k] = static_cast<std::int64_t>(std::floor(rest[v][k] / cell));
      const auto [known, is_new] = cells.try_emplace(key, fresh);
      if (!is_new) return place[v] = known->second;
    }
    out.surface.rest.push_back(rest[v]);
    out.surface.normals.push_back(vec3(0, 0, 1));
    out.influences.insert(out.influences.end(), rig.influences.begin() + rig.influence_begin[v],
                          rig.influences.begin() + rig.influence_begin[v + 1]);
    out.influence_begin.push_back(static_cast<std::uint32_t>(out.influences.size()));
    return place[v] = fresh;
  };
  for (std::size_t i = 0; i < rig.surface.triangles.size(); ++i) {
    if (part_out[rig.surface.parts[i]]) continue;
    const uvec3& t = rig.surface.triangles[i];
    const uvec3 u(keep(t[0]), keep(t[1]), keep(t[2]));
    if (cell <= 0 || (u[0] != u[1] && u[1] != u[2] && u[2] != u[0])) out.surface.triangles.push_back(u);
  }
  return out;
}

// The parameters of the fit: offset (3), logarithms of the scales (3), then one turn each.
class Fitting {
 public:
  Fitting(const Species& species, const SilhouetteReference& reference)
      : skeleton_(skeleton_of(species)), reference_(reference), method_(species.skinning) {
    const auto limits_of = [&](int node) {
      for (const JointLimit& l : species.limits)
        if (l.node == node) return l;
      return JointLimit{node, dvec3(-360), dvec3(360)};
    };
    for (const FittedTurn& t : reference.turns) {
      const int node = species.rig.find_node(t.joint);
      if (node < 0) input_error("{}: there is no joint '{}', which the fit of '{}' turns; name one of the rig's joints", species.rig.source, t.joint, reference.name);
      const JointLimit l = limits_of(node);
      lower_.push_back(std::max(t.lower_deg, l.lower_deg[t.axis]));
      upper_.push_back(std::min(t.upper_deg, l.upper_deg[t.axis]));
      if (lower_.back() > upper_.back())
        input_error("the fit of '{}' turns joint '{}' by {} to {} degrees, outside its limits {} to {} in {}", reference.name, t.joint, t.lower_deg, t.upper_deg, l.lower_deg[t.axis], l.upper_deg[t.axis], species.name);
      int twin = -1;
      if (t.mirror) {
        const std::string name = mirror_name(t.joint);
        twin = species.rig.find_node(name);
        if (twin < 0 || twin == node) input_error("{}: joint '{}' has no twin, so it cannot turn mirrored", species.rig.source, t.joint);
      }
      slots_.push_back({slot(node), twin < 0 ? -1 : slot(twin)});
    }
  }

  std::size_t size() const { return 6 + slots_.size(); }
  double turn_deg(const std::vector<double>& p, std::size_t i) const {
    return std::clamp(turn_unit_deg * p[6 + i], lower_[i], upper_[i]);
  }
  static dvec3 scale(const std::vector<double>& p) {
    dvec3 s;
    for (int k = 0; k < 3; ++k) s[k] = std::exp(log_scale_unit * p[3 + k]);
    return s;
  }
  static dvec3 offset(const std::vector<double>& p) { return offset_unit * dvec3(p[0], p[1], p[2]); }
  std::pair<double, double> range_deg(std::size_t i) const { return {lower_[i], upper_[i]}; }

  // Grows with the distance beyond the ranges, so that the search comes back.
  double excess(const std::vector<double>& p) const {
    double sum = 0;
    for (std::size_t i = 0; i < slots_.size(); ++i) {
      const double d = turn_unit_deg * p[6 + i] - turn_deg(p, i);
      sum += d * d;
    }
    return 1e-4 * sum;
  }

  SilhouetteMesh posed(const Rig& rig, const std::vector<double>& p) const {
    Species s = skeleton_;
    for (std::size_t i = 0; i < slots_.size(); ++i) {
      const double angle = turn_deg(p, i);
      const int axis = reference_.turns[i].axis;
      s.limits[slots_[i].first].lower_deg[axis] += angle;
      if (slots_[i].second >= 0) s.limits[slots_[i].second].lower_deg[axis] += axis == 1 ? angle : -angle;
    }
    for (JointLimit& l : s.limits) l.upper_deg = l.lower_deg;
    const Pose pose = sample_within_limits(s, {});
    const PosedSurface surface =
        skin(rig, bone_matrices(s.rig, world_transforms(s.rig, pose)), {}, method_, dvec3(0));
    SilhouetteMesh mesh;
    mesh.triangles = rig.surface.triangles;
    mesh.points.reserve(surface.positions.size());
    const dvec3 by = scale(p), to = offset(p);
    for (const vec3& v : surface.positions) mesh.points.push_back(by * dvec3(v) + to);
    return mesh;
  }

 private:
  int slot(int node) {
    for (std::size_t i = 0; i < skeleton_.limits.size(); ++i)
      if (skeleton_.limits[i].node == node) return static_cast<int>(i);
    skeleton_.limits.push_back({node, dvec3(0), dvec3(0)});
    return static_cast<int>(skeleton_.limits.size()) - 1;
  }

  Species skeleton_;  // with one (zero) limit per turned joint
  const SilhouetteReference& reference_;
  SkinningMethod method_;
  std::vector<std::pair<int, int>> slots_;  // into skeleton_.limits: the joint's, its twin's or -1
  std::vector<double> lower_, upper_;
};

// For every pixel, how far the nearest set pixel is: metres, by steps to the eight neighbours (an error below 8 %).
std::vector<float> distance_to_set(const Image8& image, double pixel) {
  std::vector<float> d(image.data.size());
  for (std::size_t i = 0; i < d.size(); ++i) d[i] = image.data[i] ? 0.0f : 1e9f;
  const auto straight = static_cast<float>(pixel), diagonal = static_cast<float>(pixel * std::sqrt(2.0));
  const auto relax = [&](int x, int y, int dx, int dy) {
    if (x + dx < 0 || x + dx >= image.width || y + dy < 0 || y + dy >= image.height) return;
    float& here = d[image.index(x, y)];
    here = std::min(here, d[image.index(x + dx, y + dy)] + (dx && dy ? diagonal : straight));
  };
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width; ++x) relax(x, y, -1, 0), relax(x, y, -1, -1), relax(x, y, 0, -1), relax(x, y, 1, -1);
  for (int y = image.height; y-- > 0;)
    for (int x = image.width; x-- > 0;) relax(x, y, 1, 0), relax(x, y, 1, 1), relax(x, y, 0, 1), relax(x, y, -1, 1);
  return d;
}

std::string letters_of_axis(int axis) {
  return axis == 0 ? "roll (x)" : axis == 1 ? "pitch (y)" : "yaw (z)";
}

}  // namespace

Image8 draw_silhouette(const SilhouetteMesh& mesh, const std::array<int, 2>& axes, const SilhouetteGrid& grid) {
  Image8 out(grid.width, grid.height, 1);
  std::vector<dvec2> points;  // in pixels; centres are at whole numbers
  points.reserve(mesh.points.size());
  const double per_metre = 1 / grid.pixel;
  for (const dvec3& p : mesh.points)
    points.emplace_back((p[axes[0]] - grid.lower.x) * per_metre - 0.5, (p[axes[1]] - grid.lower.y) * per_metre - 0.5);
  for (const uvec3& t : mesh.triangles) {
    const dvec2 p[3] = {points[t[0]], points[t[1]], points[t[2]]};
    const double low = std::min({p[0].y, p[1].y, p[2].y}), high = std::max({p[0].y, p[1].y, p[2].y});
    const int first = static_cast<int>(std::ceil(std::max(low, 0.0)));
    const int last = static_cast<int>(std::floor(std::min(high, grid.height - 1.0)));
    if (first > last) continue;
    double slope[3];  // along the edge from corner k
    for (int k = 0; k < 3; ++k) {
      const dvec2 d = p[(k + 1) % 3] - p[k];
      slope[k] = d.y == 0 ? 0 : d.x / d.y;
    }
    for (int row = first; row <= last; ++row) {
      double left = std::numeric_limits<double>::infinity(), right = -left;
      for (int k = 0; k < 3; ++k) {
        const dvec2 &a = p[k], &b = p[(k + 1) % 3];
        if ((a.y < row && b.y < row) || (a.y > row && b.y > row)) continue;
        const double x = a.x + (row - a.y) * slope[k], other = a.y == b.y ? b.x : x;
        left = std::min({left, x, other});
        right = std::max({right, x, other});
      }
      const int from = static_cast<int>(std::ceil(std::max(left, 0.0)));
      const int to = static_cast<int>(std::floor(std::min(right, grid.width - 1.0)));
      for (int column = from; column <= to; ++column) out.at(column, row) = 1;
    }
  }
  return out;
}

double intersection_over_union(const Image8& a, const Image8& b) {
  check(a.width == b.width && a.height == b.height, "silhouettes of different sizes");
  std::size_t both = 0, any = 0;
  for (std::size_t i = 0; i < a.data.size(); ++i) {
    both += a.data[i] & b.data[i];
    any += a.data[i] | b.data[i];
  }
  return any ? static_cast<double>(both) / static_cast<double>(any) : 0;
}

SilhouetteMesh load_silhouette_reference(const SilhouetteReference& reference) {
  Rig rig = load_rig(reference.file);
  if (rig.surface.triangles.empty()) input_error("{}: the reference '{}' has no triangles", rig.source, reference.name);
  turn_rig(rig, reference.yaw_deg);
  SilhouetteMesh mesh;
  for (const vec3& p : rig.surface.rest) mesh.points.push_back(dvec3(p));
  mesh.triangles = rig.surface.triangles;
  const Box box = bounds(mesh);
  if (!(box.size().z > 0)) input_error("{}: the reference '{}' has no height", rig.source, reference.name);
  const double factor = reference.height / box.size().z;
  const dvec3 foot(box.centre().x, box.centre().y, box.lower.z);
  for (dvec3& p : mesh.points) p = factor * (p - foot);
  std::vector<char> out(mesh.triangles.size(), 0);
  for (const LeftOut& l : reference.left_out) {
    std::size_t count = 0;
    for (std::size_t i = 0; i < mesh.triangles.size(); ++i) {
      const uvec3& t = mesh.triangles[i];
      const dvec3 c = (mesh.points[t[0]] + mesh.points[t[1]] + mesh.points[t[2]]) / 3.0;
      bool inside = true;
      for (int k = 0; k < 3; ++k) inside = inside && c[k] >= l.box.lower[k] && c[k] <= l.box.upper[k];
      if (inside) out[i] = 1, ++count;
    }
    if (count == 0)
      input_error(
          "the box '{}' of the reference '{}' leaves out no triangle; the mesh spans {:.2f} to {:.2f}, {:.2f} to {:.2f}, {:.2f} to {:.2f} m "
          "in x, y and z",
          l.what, reference.name, factor * (box.lower.x - foot.x), factor * (box.upper.x - foot.x),
          factor * (box.lower.y - foot.y), factor * (box.upper.y - foot.y), 0.0, reference.height);
  }
  std::vector<uvec3> kept;
  for (std::size_t i = 0; i < mesh.triangles.size(); ++i)
    if (!out[i]) kept.push_back(mesh.triangles[i]);
  if (kept.empty()) input_error("the boxes of the reference '{}' leave out all of it; make them smaller", reference.name);
  mesh.triangles = std::move(kept);
  return mesh;
}

SilhouetteFit fit_silhouettes(const Species& species, const SilhouetteReference& reference) {
  return fit_silhouettes(species, reference, load_silhouette_reference(reference));
}

SilhouetteFit fit_silhouettes(const Species& species, const SilhouetteReference& reference, const SilhouetteMesh& mesh) {
  const Fitting fitting(species, reference);
  const Rig& rig = species.rig;
  SilhouetteFit fit;
  std::vector<char> part_out(rig.part_names.size(), 0);
  for (std::size_t i = 0; i < rig.part_names.size(); ++i)
    for (const std::string& pattern : reference.left_out_parts)
      if (!part_out[i] && matches(pattern, rig.part_names[i])) part_out[i] = 1, fit.parts_left_out.push_back(rig.part_names[i]);
  // Morph targets as the neutral pose has them.
  const std::vector<vec3> rest =
      skin(rig, std::vector<dmat4>(rig.bones.size(), dmat4(1.0)), species.neutral.morph_weights, SkinningMethod::linear_blend, dvec3(0)).positions;
  const Box target = bounds(mesh);
  const double longest = std::max({target.size().x, target.size().y, target.size().z});
  const Rig whole = thinned(rig, rest, part_out, 0);
  if (whole.surface.triangles.empty()) input_error("{}: every part is left out by the patterns of '{}'", rig.source, reference.name);

  // One less the mean overlap. While `pull` is positive, what of ours lies outside also costs by how far out it is:
  // else a leg beside that of the reference would not know which way to go.
  const auto cost_on = [&](const Rig& shape, double pixel, double pull) {
    std::array<SilhouetteGrid, 3> grids;
    std::array<Image8, 3> wanted;
    std::array<std::vector<float>, 3> distance;
    std::array<double, 3> area{};  // pixels
    for (int v = 0; v < 3; ++v) {
      grids[v] = grid_over(target, silhouette_axes[v], pixel, 0.1 * longest);
      wanted[v] = draw_silhouette(mesh, silhouette_axes[v], grids[v]);
      distance[v] = distance_to_set(wanted[v], pixel);
      for (const std::uint8_t set : wanted[v].data) area[v] += set;
    }
    return [&fitting, &shape, pull, grids, wanted, distance, area](const std::vector<double>& p) {
      const SilhouetteMesh ours = fitting.posed(shape, p);
      double sum = 0, outside = 0;
      for (int v = 0; v < 3; ++v) {
        const Image8 drawn = draw_silhouette(ours, silhouette_axes[v], grids[v]);
        sum += intersection_over_union(wanted[v], drawn);
        double far = 0;
        for (std::size_t i = 0; i < drawn.data.size(); ++i) far += drawn.data[i] * distance[v][i];
        if (area[v] > 0) outside += far / area[v];
      }
      return 1 - sum / 3 + pull * outside / 3 + fitting.excess(p);
    };
  };

  // Start where the boxes agree.
  std::vector<double> p(fitting.size(), 0.0);
  const Box own = bounds(fitting.posed(whole, p));
  for (int k = 0; k < 3; ++k) {
    const double by = own.size()[k] > 0 ? target.size()[k] / own.size()[k] : 1.0;
    if (!(by > 0)) input_error("the reference '{}' is flat, there is nothing to fit", reference.name);
    p[3 + k] = std::log(by) / log_scale_unit;
    p[k] = (target.centre()[k] - by * own.centre()[k]) / offset_unit;
  }
  for (const Level& level : levels) {
    const double pixel = longest / level.pixels;
    const dvec3 by = Fitting::scale(p);
    const Rig shape = thinned(rig, rest, part_out, 1.5 * pixel / std::max({by.x, by.y, by.z}));
    const auto cost = cost_on(shape, pixel, level.pull / longest);
    std::vector<double> best = p;
    double least = std::numeric_limits<double>::infinity();
    for (int start = 0; start < level.starts; ++start) {
      std::vector<double> found = minimise(cost, p, {population, level.generations, level.step, static_cast<std::uint64_t>(start)});
      if (const double value = cost(found); value < least) least = value, best = std::move(found);
    }
    p = pattern_search(cost, best, level.step, 0.01, level.tries);
  }

  fit.offset = Fitting::offset(p);
  fit.scale = Fitting::scale(p);
  for (std::size_t i = 0; i < reference.turns.size(); ++i) fit.turns_deg.push_back(fitting.turn_deg(p, i));
  const SilhouetteMesh ours = fitting.posed(whole, p);
  Box both = bounds(ours);
  both.add(target.lower);
  both.add(target.upper);
  fit.pixel = std::max(measured_pixel, longest / 4096);  // the pixel suits animals; larger things get larger ones
  for (int v = 0; v < 3; ++v) {
    const SilhouetteGrid grid = grid_over(both, silhouette_axes[v], fit.pixel, 2 * fit.pixel);
    fit.reference[v] = draw_silhouette(mesh, silhouette_axes[v], grid);
    fit.ours[v] = draw_silhouette(ours, silhouette_axes[v], grid);
    fit.overlap[v] = intersection_over_union(fit.reference[v], fit.ours[v]);
    for (std::size_t i = 0; i < fit.ours[v].data.size(); ++i) {
      fit.reference_only[v] += fit.pixel * fit.pixel * (fit.reference[v].data[i] > fit.ours[v].data[i]);
      fit.ours_only[v] += fit.pixel * fit.pixel * (fit.reference[v].data[i] < fit.ours[v].data[i]);
    }
  }
  return fit;
}

Image8 silhouette_sheet(const SilhouetteFit& fit, const std::string& title) {
  constexpr int longest = 1000, gap = 24, label = 2 * text_rows + 12;
  constexpr Color8 paper{255, 255, 255}, ink{40, 40, 40};
  int most = 1;
  for (const Image8& i : fit.ours) most = std::max({most, i.width, i.height});
  const double shrink = std::min(1.0, static_cast<double>(longest) / most);
  std::array<Image8, 3> cells;
  for (int v = 0; v < 3; ++v) {
    const Image8 &a = fit.reference[v], &b = fit.ours[v];
    Image8 full(a.width, a.height, 3);
    for (int y = 0; y < a.height; ++y)
      for (int x = 0; x < a.width; ++x) {
        const bool ref = a.at(x, y), own = b.at(x, y);
        const Color8 c = ref && own ? Color8{190, 190, 190} : ref ? Color8{225, 45, 40} : own ? Color8{40, 90, 230} : paper;
        for (int k = 0; k < 3; ++k) full.at(x, a.height - 1 - y, k) = c[k];
      }
    cells[v] = scale_down(full, std::max(1, static_cast<int>(a.width * shrink)), std::max(1, static_cast<int>(a.height * shrink)));
  }
  // Side and front beside each other, the top below the side.
  const int head = 3 * text_rows + 2 * gap;
  const int column = std::max(cells[0].width, cells[2].width), row = std::max(cells[0].height, cells[1].height);
  Image8 sheet(std::max(3 * gap + column + cells[1].width, 2 * gap + text_width(title, 2)),
               head + row + cells[2].height + 2 * (label + gap), 3, 255);
  draw_text(sheet, gap, gap, title, 2, ink);
  const std::array<std::array<int, 2>, 3> at{{{gap, head}, {2 * gap + column, head}, {gap, head + row + label + gap}}};
  for (int v = 0; v < 3; ++v) {
    paste(sheet, at[v][0], at[v][1], cells[v]);
    draw_text(sheet, at[v][0], at[v][1] + cells[v].height + 6, fmt::format("{} {:.3f}", silhouette_views[v], fit.overlap[v]), 2, ink);
  }
  const std::string legend = "red: reference alone   blue: ours alone   grey: both";
  draw_text(sheet, gap, gap + text_rows * 2 + 10, legend, 1, ink);
  return sheet;
}

StudyResult silhouette_study(const Species& species, const SilhouetteReference& reference, const SilhouetteFit& fit) {
  StudyResult r;
  r.title = fmt::format("silhouettes of {} against {}", species.name, reference.name);
  r.table = fmt::format("{}\n\n| view | overlap | bar | reference alone, m² | ours alone, m² |\n|---|---|---|---|---|\n", r.title);
  for (int v = 0; v < 3; ++v) {
    const auto& bar = reference.at_least[v];
    r.table += fmt::format("| {} | {:.4f} | {} | {:.4f} | {:.4f} |\n", silhouette_views[v], fit.overlap[v], bar ? fmt::format("{:.2f}", *bar) : "", fit.reference_only[v], fit.ours_only[v]);
    r.figures.push_back({fmt::format("{} overlap", silhouette_views[v]), fit.overlap[v], "", {}, bar});
  }
  r.figures.push_back({"mean overlap", (fit.overlap[0] + fit.overlap[1] + fit.overlap[2]) / 3, "", {}, {}});
  r.table += fmt::format("\n| scale of | factor |\n|---|---|\n| length | {:.4f} |\n| width | {:.4f} |\n| height | {:.4f} |\n", fit.scale.x, fit.scale.y, fit.scale.z);
  for (int k = 0; k < 3; ++k) r.figures.push_back({fmt::format("scale of {}", k == 0 ? "length" : k == 1 ? "width" : "height"), fit.scale[k], "", {}, {}});
  if (!fit.turns_deg.empty()) r.table += "\n| joint | turn | degrees | range |\n|---|---|---|---|\n";
  for (std::size_t i = 0; i < fit.turns_deg.size(); ++i) {
    const FittedTurn& t = reference.turns[i];
    const bool at_end = fit.turns_deg[i] <= t.lower_deg + 0.05 || fit.turns_deg[i] >= t.upper_deg - 0.05;
    r.table += fmt::format("| {}{} | {} | {:.1f}{} | {:g} to {:g} |\n", t.joint, t.mirror ? " and its twin" : "", letters_of_axis(t.axis), fit.turns_deg[i], at_end ? " (at the end)" : "", t.lower_deg, t.upper_deg);
  }
  std::string boxes, parts;
  for (const LeftOut& l : reference.left_out) boxes += (boxes.empty() ? "" : ", ") + l.what;
  for (const std::string& p : fit.parts_left_out) parts += (parts.empty() ? "" : ", ") + p;
  r.table += fmt::format("\nLeft out of the reference: {}. Left out of ours: {}.\n\n", boxes.empty() ? "nothing" : boxes, parts.empty() ? "nothing" : parts);
  return r;
}

}  // namespace moomill
