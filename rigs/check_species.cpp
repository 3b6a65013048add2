// The linter on what a species file adds to its rig: sizes, keypoints, symmetry, joint limits.
#include <array>
#include <map>
#include <set>

#include "rigs/findings.h"
#include "rigs/mesh_checks.h"
#include "rigs/quadruped.h"

namespace moomill {
namespace {

constexpr double far_outside = 0.1;            // of the animal's diagonal
constexpr double most_asymmetric = 0.02;       // share of the vertices without counterpart
constexpr double most_weight_difference = 0.1;  // summed over the joints of a vertex and of its counterpart

// Generalised winding number (Jacobson et al. 2013) of the surface about a point: 1 inside, 0 outside, between where
// the surface has holes.
double winding_number(const Surface& s, const std::vector<vec3>& positions, const dvec3& p) {
  double sum = 0;
  for (const uvec3& t : s.triangles) {
    const dvec3 a = dvec3(positions[t[0]]) - p, b = dvec3(positions[t[1]]) - p, c = dvec3(positions[t[2]]) - p;
    const double la = glm::length(a), lb = glm::length(b), lc = glm::length(c);
    const double solid = std::atan2(glm::dot(a, glm::cross(b, c)),
                                    la * lb * lc + glm::dot(a, b) * lc + glm::dot(b, c) * la + glm::dot(c, a) * lb);
    sum += 2 * solid;
  }
  return sum / (4 * pi);
}

double distance_to_triangle(const dvec3& p, const dvec3& a, const dvec3& b, const dvec3& c) {
  const auto to_segment = [&](const dvec3& u, const dvec3& v) {
    const dvec3 d = v - u;
    const double t = glm::dot(d, d) > 0 ? glm::clamp(glm::dot(p - u, d) / glm::dot(d, d), 0.0, 1.0) : 0.0;
    return glm::length(p - (u + t * d));
  };
  const dvec3 n = glm::cross(b - a, c - a);
  const double area = glm::dot(n, n);
  if (area > 0) {
    const double u = glm::dot(glm::cross(c - b, p - b), n) / area, v = glm::dot(glm::cross(a - c, p - c), n) / area;
    if (u >= 0 && v >= 0 && u + v <= 1) return std::abs(glm::dot(p - a, n)) / std::sqrt(area);
  }
  return std::min({to_segment(a, b), to_segment(b, c), to_segment(c, a)});
}

double distance_to_surface(const Surface& s, const std::vector<vec3>& positions, const dvec3& p) {
  double nearest = std::numeric_limits<double>::infinity();
  for (const uvec3& t : s.triangles)
    nearest = std::min(nearest,
                       distance_to_triangle(p, dvec3(positions[t[0]]), dvec3(positions[t[1]]), dvec3(positions[t[2]])));
  return nearest;
}

// Points by cells of a grid, to find the nearest within a cell's size.
class NearbyPoints {
 public:
  NearbyPoints(const std::vector<dvec3>& points, double cell) : points_(points), cell_(cell) {
    for (std::size_t i = 0; i < points.size(); ++i) cells_[key(points[i])].push_back(i);
  }
  // Index of the nearest point at most `cell` away, the first of equals; -1 for none.
  std::ptrdiff_t nearest(const dvec3& p) const {
    std::ptrdiff_t best = -1;
    double least = cell_;
    const Key centre = key(p);
    for (int x = -1; x <= 1; ++x)
      for (int y = -1; y <= 1; ++y)
        for (int z = -1; z <= 1; ++z) {
          const auto found = cells_.find({centre[0] + x, centre[1] + y, centre[2] + z});
          if (found == cells_.end()) continue;
          for (const std::size_t i : found->second)
            if (const double d = glm::length(points_[i] - p); d < least || (d == least && best < 0))
              least = d, best = static_cast<std::ptrdiff_t>(i);
        }
    return best;
  }

 private:
  using Key = std::array<std::int64_t, 3>;
  Key key(const dvec3& p) const {
    Key k;
    for (int i = 0; i < 3; ++i) k[i] = static_cast<std::int64_t>(std::floor(p[i] / cell_));
    return k;
  }
  const std::vector<dvec3>& points_;
  double cell_;
  std::map<Key, std::vector<std::size_t>> cells_;
};

// Does every vertex have a counterpart on the other side, and does it move with the counterparts of the same joints?
// Across the model's plane y = middle, or x = middle where the left and right joints lie along x.
void check_symmetry(const Species& species, Findings& findings) {
  if (species.pairs.empty()) return;
  const Rig& rig = species.rig;
  const Surface& s = rig.surface;
  dvec3 across(0);
  for (const auto& [left, right] : species.pairs) {
    if (left < 0 || right < 0 || std::max(left, right) >= static_cast<int>(species.keypoints.size())) return;
    const auto* l = std::get_if<JointAnchor>(&species.keypoints[left].anchor);
    const auto* r = std::get_if<JointAnchor>(&species.keypoints[right].anchor);
    if (l && r) across += glm::abs(l->neutral - r->neutral);
  }
  const int axis = across.x > across.y ? 0 : 1;
  Box box;
  for (const uvec3& t : s.triangles)
    for (int k = 0; k < 3; ++k) box.add(dvec3(s.rest[t[k]]));
  const double size = box.diagonal();
  const auto mirrored = [&](dvec3 p) {
    p[axis] = 2 * box.centre()[axis] - p[axis];
    return p;
  };

  // One vertex per place, so that seams count once.
  const std::vector<std::uint32_t> place = weld(s.rest);
  std::vector<dvec3> points;
  std::vector<std::size_t> vertex;  // of a point
  std::vector<char> used(s.rest.size(), 0);
  for (const uvec3& t : s.triangles)
    for (int k = 0; k < 3; ++k) used[t[k]] = 1;
  std::vector<char> seen(s.rest.size(), 0);
  for (std::size_t v = 0; v < s.rest.size(); ++v)
    if (used[v] && !seen[place[v]]) seen[place[v]] = 1, points.push_back(dvec3(s.rest[v])), vertex.push_back(v);
  double edges = 0;
  for (const uvec3& t : s.triangles) edges += glm::length(dvec3(s.rest[t[0]]) - dvec3(s.rest[t[1]]));
  const NearbyPoints nearby(points, std::max(0.01 * size, edges / static_cast<double>(s.triangles.size())));

  // Joints across: by name, else by place.
  std::vector<dvec3> joint_at;
  for (const Bone& b : rig.bones) joint_at.push_back(dvec3(glm::inverse(b.inverse_bind)[3]));
  std::vector<std::size_t> twin(rig.bones.size());
  for (std::size_t b = 0; b < rig.bones.size(); ++b) {
    const int named = rig.find_node(mirror_name(rig.nodes[rig.bones[b].node].name));
    std::size_t best = b;
    double least = std::numeric_limits<double>::infinity();
    for (std::size_t c = 0; c < rig.bones.size(); ++c) {
      // Of joints at one place, the joint itself comes first.
      const double d = glm::length(joint_at[c] - mirrored(joint_at[b])) + (c == b ? -1e-6 * size : 0);
      if (rig.bones[c].node == named && named != rig.bones[b].node) {
        best = c;
        break;
      }
      if (d < least) least = d, best = c;
    }
    twin[b] = best;
  }

  std::size_t alone = 0, uneven = 0, first_alone = 0, worst_vertex = 0;
  double worst = 0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const std::ptrdiff_t other = nearby.nearest(mirrored(points[i]));
    if (other < 0) {
      if (alone++ == 0) first_alone = vertex[i];
      continue;
    }
    // Weights are compared where the counterpart is exact.
    if (glm::length(points[other] - mirrored(points[i])) > 1e-4 * size) continue;
    std::map<std::size_t, double> difference;
    const auto add = [&](std::size_t v, bool turn, double sign) {
      for (std::uint32_t k = rig.influence_begin[v]; k < rig.influence_begin[v + 1]; ++k)
        difference[turn ? twin[rig.influences[k].bone] : rig.influences[k].bone] += sign * rig.influences[k].weight;
    };
    add(vertex[i], true, 1);
    add(vertex[static_cast<std::size_t>(other)], false, -1);
    double sum = 0;
    for (const auto& [bone, d] : difference) sum += std::abs(d);
    if (sum > most_weight_difference) ++uneven;
    if (sum > worst) worst = sum, worst_vertex = vertex[i];
  }
  const auto where = [&](std::size_t v) {
    return fmt::format("{} at ({:.2f}, {:.2f}, {:.2f}) m", vertex_place(rig, v), s.rest[v].x, s.rest[v].y, s.rest[v].z);
  };
  if (static_cast<double>(alone) > most_asymmetric * static_cast<double>(points.size()))
    suspicious(findings, "left and right differ in shape: {} of {} vertices have no counterpart across {} = {:.2f} m, the first is {}", alone,
               points.size(), "xy"[axis], box.centre()[axis], where(first_alone));
  if (uneven)
    suspicious(findings, "left and right differ in weights: at {} of {} vertices by more than {} in all, most ({:.2f}) at {}", uneven,
               points.size(), most_weight_difference, worst, where(worst_vertex));
}

}  // namespace

std::vector<Finding> check_species(const Species& species) {
  Findings findings = check_rig(species.rig);
  const Rig& rig = species.rig;
  if (rig.surface.triangles.empty()) return findings;
  Pose neutral = species.neutral;
  if (neutral.local.empty()) neutral = bind_pose(rig);
  const std::vector<dmat4> world = world_transforms(rig, neutral);
  const PosedSurface posed = skin(rig, bone_matrices(rig, world), neutral.morph_weights, species.skinning, dvec3(0));
  Box box;
  for (const uvec3& t : rig.surface.triangles)
    for (int k = 0; k < 3; ++k) box.add(dvec3(posed.positions[t[k]]));
  const double size = box.diagonal();

  // Sizes: animals face along x or y, so length is the longer horizontal side.
  const double length = std::max(box.size().x, box.size().y), height = box.size().z;
  const auto compare = [&](const char* what, double is, const std::optional<double>& expected) {
    if (expected && (is > 2 * *expected || is < 0.5 * *expected))
      wrong(findings, "the {} is {:.3f} m, {:.3f} m was expected: check the unit, or set scale in [source] to {:.4g} times what it is",
            what, is, *expected, *expected / is);
    else if (expected && std::abs(is - *expected) > 0.1 * *expected)
      suspicious(findings, "the {} is {:.3f} m, {:.3f} m was expected (10 % are allowed)", what, is, *expected);
  };
  compare("length", length, species.expected_length);
  compare("height", height, species.expected_height);
  if (std::abs(box.lower.z) > 0.02 * size)
    suspicious(findings, "the lowest point is at z = {:.3f} m, the ground is at 0", box.lower.z);

  // Keypoints: anchors exist, names are unique, places are in the body or on it.
  std::set<std::string> names;
  bool anchored = true;
  const int nodes = static_cast<int>(rig.nodes.size());
  for (const Keypoint& k : species.keypoints) {
    if (!names.insert(k.name).second) wrong(findings, "two keypoints are called '{}'", k.name);
    if (!(k.tolerance >= 0) || k.tolerance > size)
      wrong(findings, "the tolerance of keypoint '{}' is {} m", k.name, k.tolerance);
    bool here = true;
    if (const auto* joint = std::get_if<JointAnchor>(&k.anchor))
      here = joint->node >= 0 && joint->node < nodes && all_finite(joint->neutral);
    if (const auto* point = std::get_if<SurfaceAnchor>(&k.anchor))
      here = point->triangle < rig.surface.triangles.size() && all_finite(point->barycentrics);
    if (!here) wrong(findings, "keypoint '{}' is anchored to what does not exist", k.name);
    anchored &= here;
  }
  if (anchored) {
    const std::vector<dvec3> points = keypoint_positions(species, world, world, posed);
    for (std::size_t i = 0; i < points.size(); ++i) {
      const Keypoint& k = species.keypoints[i];
      if (std::holds_alternative<SurfaceAnchor>(k.anchor)) {
        const dvec2 b = std::get<SurfaceAnchor>(k.anchor).barycentrics;
        if (b.x < -1e-6 || b.y < -1e-6 || b.x + b.y > 1 + 1e-6)
          suspicious(findings, "keypoint '{}' lies outside of its triangle", k.name);
        continue;
      }
      const double from_surface = distance_to_surface(rig.surface, posed.positions, points[i]);
      if (from_surface > 0.005 * size && winding_number(rig.surface, posed.positions, points[i]) < 0.5) {
        // A joint may be a little outside; far out it belongs to another animal, or another unit.
        if (from_surface > far_outside * size)
          wrong(findings, "keypoint '{}' is far outside of the body, {:.3f} m from its surface", k.name, from_surface);
        else if (from_surface > k.tolerance)
          suspicious(findings, "keypoint '{}' is outside of the body, {:.3f} m from its surface", k.name, from_surface);
      }
    }
    // Left and right mirror each other across the plane that all pairs suggest.
    const int count = static_cast<int>(points.size());
    dvec3 across(0), middle(0);
    bool sound = !species.pairs.empty();
    for (const auto& [left, right] : species.pairs) {
      if (left < 0 || right < 0 || left >= count || right >= count || left == right) {
        wrong(findings, "the pair ({}, {}) names keypoints that do not exist", left, right);
        sound = false;
        continue;
      }
      across += points[left] - points[right];
      middle += 0.5 * (points[left] + points[right]);
    }
    if (sound && !(glm::length(across) > 1e-6))
      wrong(findings, "the left and right keypoints of all pairs cancel out, some are swapped");
    else if (sound) {
      const dvec3 normal = glm::normalize(across);
      middle /= static_cast<double>(species.pairs.size());
      for (const auto& [left, right] : species.pairs) {
        const dvec3 mirrored = points[right] - 2 * glm::dot(points[right] - middle, normal) * normal;
        const std::string& l = species.keypoints[left].name;
        const std::string& r = species.keypoints[right].name;
        if (glm::dot(points[left] - points[right], normal) < 0)
          wrong(findings, "'{}' and '{}' are swapped: the left one is on the right", l, r);
        else if (const double error = glm::length(mirrored - points[left]); error > 0.02 * size)
          suspicious(findings, "'{}' and '{}' do not mirror each other, by {:.3f} m", l, r, error);
      }
    }
    for (const auto& [a, b] : species.edges)
      if (a < 0 || b < 0 || a >= count || b >= count || a == b)
        wrong(findings, "the skeleton edge ({}, {}) names keypoints that do not exist", a, b);
    std::vector<std::string> loose;
    for (int i = 0; i < count; ++i)
      if (std::none_of(species.edges.begin(), species.edges.end(), [&](const auto& e) { return e.first == i || e.second == i; }))
        loose.push_back(species.keypoints[i].name);
    if (!species.edges.empty() && !loose.empty())
      suspicious(findings, "{} keypoints are in no edge of the skeleton: {}", loose.size(), list_names(loose));
  }

  check_symmetry(species, findings);

  std::set<int> limited;
  for (const JointLimit& limit : species.limits) {
    limited.insert(limit.node);
    if (limit.node < 0 || limit.node >= nodes) {
      wrong(findings, "a joint limit names node {}, but there are {}", limit.node, nodes);
      continue;
    }
    const std::string& name = rig.nodes[limit.node].name;
    for (int axis = 0; axis < 3; ++axis) {
      const double lower = limit.lower_deg[axis], upper = limit.upper_deg[axis];
      const char letter = "xyz"[axis];
      if (!std::isfinite(lower) || !std::isfinite(upper) || lower > upper)
        wrong(findings, "the limit of '{}' about {} is from {} to {} degrees", name, letter, lower, upper);
      else if (lower > 0 || upper < 0)
        suspicious(findings, "the limit of '{}' about {}, {} to {} degrees, leaves out the neutral pose", name, letter,
                   lower, upper);
      else if (upper - lower > 240)
        suspicious(findings, "'{}' may turn by {} degrees about {}, more than joints do", name, upper - lower, letter);
    }
  }
  // Where some joints have limits, the others never move in sampled poses.
  std::vector<char> moves(rig.nodes.size(), 0);
  for (const Influence& i : rig.influences)
    if (i.weight > 0.2f) moves[rig.bones[i.bone].node] = 1;
  std::vector<std::string> free;
  for (int i = 0; i < nodes; ++i)
    if (moves[i] && !limited.count(i) && rig.nodes[i].parent >= 0) free.push_back(rig.nodes[i].name);
  if (!species.limits.empty() && !free.empty())
    suspicious(findings, "{} joints move the surface but have no limits, so sampled poses leave them alone: {}", free.size(), list_names(free));
  if (rig.surface.nnopcs.size() != rig.surface.rest.size())
    wrong(findings, "neutral coordinates are not baked: call bake_nnopcs after loading");
  return findings;
}

}  // namespace moomill
