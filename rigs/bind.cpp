#include "rigs/bind.h"

#include <array>
#include <cmath>
#include <glm/gtc/matrix_inverse.hpp>
#include <map>
#include <numeric>

#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "generator/core/topology.h"
#include "rigs/skin_weights.h"
#include "rigs/warp.h"

namespace moomill {
namespace {

constexpr double cells_along = 140;  // along the longest side, as for the builder

// Triangles that hang together, vertices at the same place being one.
struct Pieces {
  std::vector<std::uint32_t> place;     // per vertex: one number per distinct position
  std::vector<std::uint32_t> of_vertex;  // per vertex: its piece
  std::vector<Box> boxes;
  std::vector<double> areas;
};

Pieces find_pieces(const Surface& s) {
  Pieces p;
  p.place = weld(s.rest);
  DisjointSets sets = connected_vertices(s.rest.size(), s.triangles, p.place);
  std::map<std::uint32_t, std::uint32_t> number;
  for (const std::uint32_t v : p.place)
    p.of_vertex.push_back(number.try_emplace(sets.find(v), static_cast<std::uint32_t>(number.size())).first->second);
  p.boxes.resize(number.size());
  p.areas.resize(number.size(), 0.0);
  for (const uvec3& t : s.triangles) {
    const dvec3 a(s.rest[t.x]), b(s.rest[t.y]), c(s.rest[t.z]);
    const std::uint32_t piece = p.of_vertex[t.x];
    p.areas[piece] += 0.5 * glm::length(glm::cross(b - a, c - a));
    for (const dvec3& q : {a, b, c}) p.boxes[piece].add(q);
  }
  return p;
}

Box bounds(const Pieces& pieces) {
  Box box;
  for (const Box& b : pieces.boxes)
    if (!b.empty()) box.add(b.lower), box.add(b.upper);
  return box;
}

// Keeps only the triangles for which keep(piece) holds, and the vertices they use.
void keep_pieces(Rig& rig, const Pieces& pieces, const std::vector<char>& keep) {
  Surface& s = rig.surface;
  std::vector<std::uint32_t> moved(s.rest.size());
  Surface out = s;
  out.rest.clear(), out.normals.clear(), out.uvs.clear(), out.colors.clear(), out.triangles.clear(), out.materials.clear();
  std::vector<MeshPart> parts;
  for (MeshPart part : rig.meshes) {
    const std::uint32_t first_vertex = static_cast<std::uint32_t>(out.rest.size()),
                        first_triangle = static_cast<std::uint32_t>(out.triangles.size());
    for (std::uint32_t v = part.first_vertex; v < part.first_vertex + part.vertex_count; ++v) {
      if (!keep[pieces.of_vertex[v]]) continue;
      moved[v] = static_cast<std::uint32_t>(out.rest.size());
      out.rest.push_back(s.rest[v]);
      if (!s.normals.empty()) out.normals.push_back(s.normals[v]);
      if (!s.uvs.empty()) out.uvs.push_back(s.uvs[v]);
      if (!s.colors.empty()) out.colors.push_back(s.colors[v]);
    }
    for (std::uint32_t t = part.first_triangle; t < part.first_triangle + part.triangle_count; ++t) {
      const uvec3& v = s.triangles[t];
      if (!keep[pieces.of_vertex[v.x]]) continue;
      out.triangles.emplace_back(moved[v.x], moved[v.y], moved[v.z]);
      out.materials.push_back(s.materials[t]);
    }
    part.first_vertex = first_vertex, part.first_triangle = first_triangle;
    part.vertex_count = static_cast<std::uint32_t>(out.rest.size()) - first_vertex;
    part.triangle_count = static_cast<std::uint32_t>(out.triangles.size()) - first_triangle;
    part.skinned = true;
    if (part.triangle_count > 0) parts.push_back(part);
  }
  rig.meshes = std::move(parts);
  s = std::move(out);
}

// A sheet on which the animal stands: flat, wide, at the very bottom.
std::vector<char> without_ground(const Pieces& pieces, std::vector<std::string>& notes, const std::string& source) {
  const Box all = bounds(pieces);
  const dvec3 size = all.size();
  std::vector<char> keep(pieces.boxes.size(), 1);
  for (std::size_t i = 0; i < pieces.boxes.size(); ++i) {
    const Box& b = pieces.boxes[i];
    if (b.empty()) continue;
    const dvec3 s = b.size();
    if (s.z < 0.08 * size.z && b.upper.z < all.lower.z + 0.1 * size.z && std::min(s.x, s.y) > 0.25 * size.z &&
        pieces.boxes.size() > 1) {
      keep[i] = 0;
      notes.push_back(fmt::format("{}: a flat piece at the feet, {:.3g} x {:.3g} of its units, was taken for ground and left out",
                                  source, s.x, s.y));
    }
  }
  return keep;
}

struct Frame {
  double yaw = 0, scale = 1;  // radians counter-clockwise; metres per unit of the scan
};

// How to turn and scale the scan so that its keypoints lie like the species': a similarity about the vertical, by least
// squares over the midline and the middles of pairs, so that swapped sides do not matter.
Frame frame_of(const Species& base, const std::vector<dvec3>& from, const std::vector<dvec3>& to) {
  std::vector<char> paired(from.size(), 0);
  std::vector<std::pair<dvec3, dvec3>> points;
  for (const auto& [l, r] : base.pairs) {
    paired[l] = paired[r] = 1;
    points.emplace_back(0.5 * (from[l] + from[r]), 0.5 * (to[l] + to[r]));
  }
  for (std::size_t i = 0; i < from.size(); ++i)
    if (!paired[i]) points.emplace_back(from[i], to[i]);
  dvec3 a(0), b(0);
  for (const auto& [p, q] : points) a += p / static_cast<double>(points.size()), b += q / static_cast<double>(points.size());
  double along = 0, across = 0, from_size = 0, to_size = 0;
  for (const auto& [p0, q0] : points) {
    const dvec3 p = p0 - a, q = q0 - b;
    along += p.x * q.x + p.y * q.y;
    across += p.x * q.y - p.y * q.x;
    from_size += glm::dot(p, p), to_size += glm::dot(q, q);
  }
  if (!(from_size > 0)) input_error("{}: all keypoints are at one place", base.name);
  return {std::atan2(across, along), std::sqrt(to_size / from_size)};
}

std::string sentence_list(const std::vector<std::string>& names) {
  std::string text;
  for (std::size_t i = 0; i < names.size(); ++i) text += (i == 0 ? "" : i + 1 == names.size() ? " and " : ", ") + names[i];
  return text;
}

void check_sides(const Species& base, const BindSpec& spec, const std::vector<dvec3>& points, const std::vector<dvec3>& home) {
  std::vector<std::string> swapped;
  for (const auto& [l, r] : base.pairs)
    if ((points[l].y - points[r].y) * (home[l].y - home[r].y) < 0)
      swapped.push_back(fmt::format("'{}' and '{}'", base.keypoints[l].name, base.keypoints[r].name));
  if (swapped.empty()) return;
  if (swapped.size() == base.pairs.size())
    input_error("{}: left and right are swapped in all {} pairs; swap their names, the animal's left is meant", spec.source,
                swapped.size());
  input_error("{}: {} are swapped left and right; exchange them", spec.source, sentence_list(swapped));
}

// Two bodies side by side, or much of the mesh where no keypoint is.
void check_one_animal(const BindSpec& spec, const Pieces& pieces, const std::vector<dvec3>& points) {
  Box keypoints;
  for (const dvec3& p : points) keypoints.add(p);
  const double reach = 0.35 * keypoints.diagonal();
  const auto outside = [&](const dvec3& p) {
    return glm::length(glm::max(dvec3(0.0), glm::max(keypoints.lower - p, p - keypoints.upper)));
  };
  const double most = *std::max_element(pieces.areas.begin(), pieces.areas.end());
  std::vector<std::size_t> large;
  for (std::size_t i = 0; i < pieces.boxes.size(); ++i)
    if (pieces.areas[i] > 0.4 * most) large.push_back(i);
  for (const std::size_t i : large)
    if (outside(pieces.boxes[i].centre()) > 0.1 * keypoints.diagonal())
      input_error(
          "{}: the mesh seems to hold two animals: a large piece lies {:.2f} m from all keypoints; bind them one by one, each mesh alone",
          spec.source, outside(pieces.boxes[i].centre()));
  for (const std::size_t i : large)
    for (const std::size_t j : large) {
      const Box &a = pieces.boxes[i], &b = pieces.boxes[j];
      const double gap = std::max({a.lower.x - b.upper.x, a.lower.y - b.upper.y});
      if (gap > 0.01 * a.size().z && std::min(a.size().z, b.size().z) > 0.7 * std::max(a.size().z, b.size().z))
        input_error("{}: the mesh seems to hold two animals, {:.2f} m apart; bind them one by one, each mesh alone",
                    spec.source, gap);
    }
  const Box all = bounds(pieces);
  const double far = std::max(outside(all.lower), outside(all.upper));
  if (far > 1.5 * reach)
    input_error("{}: the mesh reaches {:.2f} m beyond the keypoints; does it hold two animals, or more than the animal?",
                spec.source, far);
}

void check_inside(const Species& base, const BindSpec& spec, const VoxelSolid& solid, const std::vector<dvec3>& points,
                  double tolerance, double scale) {
  std::vector<std::string> names;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (solid.find(points[i], tolerance) >= 0) continue;
    double least = std::numeric_limits<double>::infinity();
    for (std::size_t c = 0; c < solid.places.size(); ++c) least = std::min(least, glm::length(solid.centre(c) - points[i]));
    names.push_back(fmt::format("'{}' by {:.2f} m ({:.3g} of its units)", base.keypoints[i].name, least, least / scale));
  }
  if (!names.empty())
    input_error("{}: keypoints lie outside the mesh: {}; click them again, {} m are let pass", spec.source,
                sentence_list(names), fmt::format("{:.2f}", tolerance));
}

// The nearest of many points: a tree that halves them along x, y and z in turn (Bentley 1975).
class NearestPoint {
 public:
  explicit NearestPoint(const std::vector<dvec3>& points) : points_(points), order_(points.size()) {
    std::iota(order_.begin(), order_.end(), 0u);
    build(0, order_.size(), 0);
  }
  std::uint32_t find(const dvec3& p) const {
    Found best;
    search(p, 0, order_.size(), 0, best);
    return best.index;
  }

 private:
  struct Found {
    std::uint32_t index = 0;
    double square = std::numeric_limits<double>::infinity();
  };
  void build(std::size_t first, std::size_t last, int axis) {
    if (last - first < 2) return;
    const std::size_t middle = (first + last) / 2;
    const auto at = [&](std::size_t i) { return order_.begin() + static_cast<std::ptrdiff_t>(i); };
    std::nth_element(at(first), at(middle), at(last), [&](std::uint32_t i, std::uint32_t j) {
      return points_[i][axis] != points_[j][axis] ? points_[i][axis] < points_[j][axis] : i < j;
    });
    build(first, middle, (axis + 1) % 3);
    build(middle + 1, last, (axis + 1) % 3);
  }
  void search(const dvec3& p, std::size_t first, std::size_t last, int axis, Found& best) const {
    if (first >= last) return;
    const std::size_t middle = (first + last) / 2;
    const std::uint32_t i = order_[middle];
    const dvec3 d = points_[i] - p;
    const double square = glm::dot(d, d);
    if (square < best.square || (square == best.square && i < best.index)) best = {i, square};
    const double side = p[axis] - points_[i][axis];
    const int next = (axis + 1) % 3;
    side < 0 ? search(p, first, middle, next, best) : search(p, middle + 1, last, next, best);
    if (side * side <= best.square) side < 0 ? search(p, middle + 1, last, next, best) : search(p, first, middle, next, best);
  }
  const std::vector<dvec3>& points_;
  std::vector<std::uint32_t> order_;
};

// The species' weights where the inverse warp finds its skin, on the cells at the surface; cells inside take those of
// the nearest cell at the surface.
Seeds carried_seeds(const VoxelSolid& solid, const Species& base, const std::vector<dvec3>& skin_points, const Warp& back) {
  const std::size_t bones = base.rig.bones.size(), n = solid.places.size();
  const NearestPoint nearest(skin_points);
  Seeds seeds(n * bones, 0.0f);
  parallel_for(n, 64, [&](std::size_t i) {
    if (!solid.on_surface[i]) return;
    const std::uint32_t v = nearest.find(back.apply(solid.centre(i)));
    for (std::uint32_t k = base.rig.influence_begin[v]; k < base.rig.influence_begin[v + 1]; ++k)
      seeds[i * bones + base.rig.influences[k].bone] = base.rig.influences[k].weight;
  });
  std::vector<std::int32_t> front, next;
  std::vector<char> done(n, 0);
  for (std::size_t i = 0; i < n; ++i)
    if (solid.on_surface[i]) done[i] = 1, front.push_back(static_cast<std::int32_t>(i));
  while (!front.empty()) {
    for (const std::int32_t i : front)
      for (const std::int32_t j : solid.near[i])
        if (j >= 0 && !done[j]) {
          done[j] = 1;
          std::copy_n(&seeds[i * bones], bones, &seeds[j * bones]);
          next.push_back(j);
        }
    front.swap(next);
    next.clear();
  }
  return seeds;
}

// Weights spread over edges of the welded mesh: what cells leave of steps.
void even_out(std::vector<double>& weights, std::size_t bones, const std::vector<std::vector<std::uint32_t>>& near, int rounds) {
  std::vector<double> next(weights.size());
  for (int round = 0; round < rounds; ++round) {
    parallel_for(near.size(), 64, [&](std::size_t i) {
      for (std::size_t j = 0; j < bones; ++j) {
        double sum = 0;
        for (const std::uint32_t v : near[i]) sum += weights[v * bones + j];
        const double own = weights[i * bones + j];
        next[i * bones + j] = near[i].empty() ? own : 0.5 * own + 0.5 * sum / static_cast<double>(near[i].size());
      }
    });
    weights.swap(next);
  }
}

void weigh(Rig& rig, const Species& base, const VoxelSolid& solid, const Seeds& seeds, std::vector<std::string>& notes,
           const std::string& source) {
  const Surface& s = rig.surface;
  const Pieces pieces = find_pieces(s);
  const std::size_t bones = base.rig.bones.size(), places = *std::max_element(pieces.place.begin(), pieces.place.end()) + 1u;
  std::vector<dvec3> points(places);
  std::vector<std::uint32_t> piece(places);
  for (std::size_t v = 0; v < s.rest.size(); ++v)
    points[pieces.place[v]] = dvec3(s.rest[v]), piece[pieces.place[v]] = pieces.of_vertex[v];
  std::vector<double> weights = diffuse_weights(solid, seeds, static_cast<int>(bones), points);
  even_out(weights, bones, vertex_neighbours(places, s.triangles, pieces.place), 2);
  // Small loose pieces (eyes, teeth, horns): one set of weights each, that of the body nearest to them.
  const double most = *std::max_element(pieces.areas.begin(), pieces.areas.end());
  std::vector<dvec3> body;
  std::vector<std::uint32_t> body_place;
  for (std::uint32_t p = 0; p < places; ++p)
    if (pieces.areas[piece[p]] > 0.1 * most) body.push_back(points[p]), body_place.push_back(p);
  const NearestPoint nearest(body);
  std::size_t carried = 0;
  for (std::uint32_t i = 0; i < pieces.areas.size(); ++i) {
    if (pieces.areas[i] > 0.1 * most || pieces.boxes[i].empty()) continue;
    ++carried;
    double least = std::numeric_limits<double>::infinity();
    std::uint32_t from = 0;
    for (std::uint32_t p = 0; p < places; ++p) {
      if (piece[p] != i) continue;
      const std::uint32_t b = nearest.find(points[p]);
      const double d = glm::length(body[b] - points[p]);
      if (d < least) least = d, from = body_place[b];
    }
    for (std::uint32_t p = 0; p < places; ++p)
      if (piece[p] == i) std::copy_n(&weights[from * bones], bones, &weights[p * bones]);
  }
  if (carried > 0) notes.push_back(fmt::format("{}: {} small loose pieces move rigidly with the body nearest to them", source, carried));
  rig.influence_begin.clear();
  rig.influences.clear();
  for (const std::uint32_t p : pieces.place) {
    rig.influence_begin.push_back(static_cast<std::uint32_t>(rig.influences.size()));
    const std::vector<Influence> list = strongest_influences(&weights[p * bones], bones);
    rig.influences.insert(rig.influences.end(), list.begin(), list.end());
  }
  rig.influence_begin.push_back(static_cast<std::uint32_t>(rig.influences.size()));
}

}  // namespace

BoundScan bind_scan(Rig scan, const Species& base, const BindSpec& spec) {
  check(spec.keypoints.size() == base.keypoints.size(), "one place for every keypoint of the species");
  if (scan.surface.triangles.empty()) input_error("{}: has no triangles, there is nothing to bind", scan.source);
  if (base.rig.bones.empty()) input_error("{}: the species '{}' has no skinned skeleton to fit", spec.source, base.name);
  BoundScan out;
  scan.clips.clear();
  {
    const Pieces pieces = find_pieces(scan.surface);
    keep_pieces(scan, pieces, without_ground(pieces, out.notes, scan.source));
  }
  if (scan.surface.triangles.empty()) input_error("{}: holds nothing but flat ground, there is nothing to bind", scan.source);

  // The species as it stands.
  Pose neutral = base.neutral;
  neutral.placement = dmat4(1.0);
  const std::vector<dmat4> world = world_transforms(base.rig, neutral);
  const PosedSurface posed = skin(base.rig, bone_matrices(base.rig, world), neutral.morph_weights, base.skinning, dvec3(0));
  const std::vector<dvec3> home = keypoint_positions(base, world, world, posed);

  // Turned, scaled, on the ground.
  const Frame frame = frame_of(base, spec.keypoints, home);
  const double yaw = spec.yaw_deg ? *spec.yaw_deg * degrees : frame.yaw;
  if (std::abs(std::remainder(yaw - frame.yaw, 2 * pi)) > 60 * degrees)
    input_error("{}: with yaw_deg = {:.0f} the keypoints face away from +X; about {:.0f} would turn them there, and without the key it is found",
                spec.source, *spec.yaw_deg, frame.yaw / degrees);
  Box box;
  for (const vec3& p : scan.surface.rest) box.add(dvec3(p));
  const double scale = spec.height ? *spec.height / box.size().z : frame.scale;
  const dmat3 turn = scale * glm::mat3_cast(glm::angleAxis(yaw, dvec3(0, 0, 1)));
  dvec3 shift(0);
  for (std::size_t i = 0; i < home.size(); ++i)
    shift += (home[i] - turn * spec.keypoints[i]) / static_cast<double>(home.size());
  shift.z = -scale * box.lower.z;
  const auto place = [&](const dvec3& p) { return turn * p + shift; };
  for (vec3& p : scan.surface.rest) p = vec3(place(dvec3(p)));
  for (vec3& n : scan.surface.normals) n = vec3(glm::normalize(turn * dvec3(n)));
  std::vector<dvec3> points;
  for (const dvec3& p : spec.keypoints) points.push_back(place(p));

  check_sides(base, spec, points, home);
  check_one_animal(spec, find_pieces(scan.surface), points);

  box = {};
  for (const vec3& p : scan.surface.rest) box.add(dvec3(p));
  const dvec3 size = box.size();
  out.cell = std::max({size.x, size.y, size.z}) / cells_along;
  const std::vector<dvec3> positions(scan.surface.rest.begin(), scan.surface.rest.end());
  const VoxelSolid solid = voxelise(positions, scan.surface.triangles, out.cell);
  if (static_cast<double>(solid.enclosed()) * std::pow(out.cell, 3) < 0.01 * size.x * size.y * size.z)
    input_error("{}: the mesh encloses no volume; close its holes, or bind a mesh of the whole body", scan.source);
  if (solid.closed_gap > 0)
    out.notes.push_back(fmt::format("{}: gaps up to {:.3f} m wide were closed to find the inside", scan.source, solid.closed_gap));
  check_inside(base, spec, solid, points, 0.04 * size.z, scale);

  // Skeleton: keypoints and clicked joints pull, the rest follows.
  std::vector<dvec3> from = home, to = points;
  std::vector<std::optional<dvec3>> fixed(base.rig.nodes.size());
  for (std::size_t i = 0; i < base.keypoints.size(); ++i)
    if (const auto* joint = std::get_if<JointAnchor>(&base.keypoints[i].anchor))
      if (glm::length(home[i] - dvec3(world[joint->node][3])) < 1e-6) fixed[joint->node] = points[i];
  for (const auto& [name, at] : spec.joints) {
    const int node = base.rig.find_node(name);
    check(node >= 0, "the joints were looked up");
    fixed[node] = place(at);
    from.push_back(dvec3(world[node][3]));
    to.push_back(place(at));
  }
  Warp there;
  if (!fit_warp(from, to, there)) input_error("{}: the keypoints lie in one plane; click those of both sides", spec.source);
  std::vector<dvec3> joints, base_joints;
  for (std::size_t n = 0; n < base.rig.nodes.size(); ++n) {
    base_joints.emplace_back(world[n][3]);
    joints.push_back(fixed[n] ? *fixed[n] : there.apply(base_joints.back()));
  }
  Warp back;
  if (!fit_warp(to, from, back)) input_error("{}: the keypoints lie in one plane; click those of both sides", spec.source);

  Species& species = out.species;
  species = base;
  species.rig = std::move(scan);
  Rig& rig = species.rig;
  rig.nodes.clear(), rig.bones.clear(), rig.morphs.clear(), rig.morph_weights.clear(), rig.morph_node.clear(),
      rig.morph_index.clear(), rig.surface.parts.clear(), rig.part_names.clear();
  std::vector<dmat4> stands;
  for (std::size_t n = 0; n < base.rig.nodes.size(); ++n) {
    Node node;
    node.name = base.rig.nodes[n].name;
    node.parent = base.rig.nodes[n].parent;
    dmat4 global = glm::mat4_cast(decompose(world[n]).rotation);
    global[3] = dvec4(joints[n], 1);
    const dmat4 local = node.parent >= 0 ? glm::affineInverse(stands[node.parent]) * global : global;
    node.translation = dvec3(local[3]);
    node.rotation = glm::normalize(glm::quat_cast(dmat3(local)));
    stands.push_back(global);
    rig.nodes.push_back(std::move(node));
  }
  for (const Bone& bone : base.rig.bones) rig.bones.push_back({bone.node, glm::affineInverse(stands[bone.node])});
  for (MeshPart& part : rig.meshes) part.skinned = true, part.node = -1;
  std::vector<dvec3> skin_points;
  for (const vec3& p : posed.positions) skin_points.emplace_back(p);
  weigh(rig, base, solid, carried_seeds(solid, base, skin_points, back), out.notes, rig.source);
  finish_rig(rig);

  species.neutral = rest_pose(rig);
  species.standing = dvec3(0);
  species.expected_length = size.x;
  species.expected_height = size.z;
  for (std::size_t i = 0; i < species.keypoints.size(); ++i) {
    JointAnchor anchor;
    anchor.neutral = points[i];
    if (const auto* joint = std::get_if<JointAnchor>(&base.keypoints[i].anchor)) {
      anchor.node = joint->node;
    } else {  // on the skin: with the bone that weighs most at the vertex nearest to it
      std::size_t best = 0;
      for (std::size_t v = 0; v < rig.surface.rest.size(); ++v)
        if (glm::length(dvec3(rig.surface.rest[v]) - points[i]) < glm::length(dvec3(rig.surface.rest[best]) - points[i])) best = v;
      anchor.node = rig.bones[rig.influences[rig.influence_begin[best]].bone].node;
    }
    species.keypoints[i].anchor = anchor;
  }
  return out;
}

}  // namespace moomill
