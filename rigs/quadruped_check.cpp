#include "rigs/quadruped_check.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "generator/core/error.h"
#include "generator/core/topology.h"
#include "rigs/mesh_checks.h"

namespace moomill {
namespace {

std::string place(const dvec3& p) {
  return fmt::format("({:.3f}, {:.3f}, {:.3f})", p.x, p.y, p.z);
}

const QuadrupedJoint* find(const std::vector<QuadrupedJoint>& joints, const std::string& name) {
  for (const QuadrupedJoint& j : joints)
    if (j.name == name) return &j;
  return nullptr;
}

// The solid whose surface is nearest to a point, of those that add to the body; "other than" by name.
const Shape* nearest_shape(const Field& field, const dvec3& p, const std::string& other_than = "") {
  const Shape* best = nullptr;
  double least = std::numeric_limits<double>::infinity();
  for (const Shape& shape : field.shapes) {
    if (shape.kind != Solid::Kind::add || shape.name == other_than) continue;
    if (const double d = std::abs(sample_shape(shape, p).distance); d < least) least = d, best = &shape;
  }
  return best;
}

}  // namespace

std::vector<QuadrupedJoint> ordered_joints(const QuadrupedSpec& spec) {
  std::vector<QuadrupedJoint> all;
  for (const QuadrupedJoint& j : spec.joints) {
    all.push_back(j);
    if (j.mirror) all.push_back({mirror_name(j.name), mirror_name(j.parent), {j.at.x, -j.at.y, j.at.z}, true});
  }
  if (all.empty()) input_error("{}: [builder] has no joints; add at least a root", spec.source);
  std::set<std::string> names;
  std::string root;
  for (const QuadrupedJoint& j : all) {
    if (!all_finite(j.at)) input_error("{}: the place of joint '{}' is not finite", spec.source, j.name);
    if (!names.insert(j.name).second)
      input_error("{}: the joint '{}' occurs twice in [builder] joints (a mirrored joint makes its twin itself); "
                  "rename or remove one",
                  spec.source, j.name);
    if (!j.parent.empty()) continue;
    if (!root.empty())
      input_error("{}: the joints '{}' and '{}' in [builder] both have no parent; only one can be the root, give the "
                  "other a parent",
                  spec.source, root, j.name);
    root = j.name;
  }
  for (const QuadrupedJoint& j : all)
    if (!j.parent.empty() && !names.count(j.parent))
      input_error("{}: joint '{}' in [builder] has the parent '{}', which is no joint; correct the name or add it",
                  spec.source, j.name, j.parent);
  std::vector<QuadrupedJoint> ordered;
  std::set<std::string> placed;
  while (ordered.size() < all.size()) {
    const std::size_t before = ordered.size();
    for (const QuadrupedJoint& j : all)
      if (!placed.count(j.name) && (j.parent.empty() || placed.count(j.parent))) {
        ordered.push_back(j);
        placed.insert(j.name);
      }
    if (ordered.size() > before) continue;
    // What is left hangs on a cycle: walk up until a joint comes again.
    const auto left = std::find_if(all.begin(), all.end(), [&](auto& j) { return !placed.count(j.name); });
    std::vector<std::string> way{left->name};
    while (std::count(way.begin(), way.end(), way.back()) == 1) way.push_back(find(all, way.back())->parent);
    way.erase(way.begin(), std::find(way.begin(), way.end(), way.back()));
    std::string cycle = way[0];
    for (std::size_t i = 1; i < way.size(); ++i) cycle += " -> " + way[i];
    input_error("{}: the joints in [builder] hang on each other in a cycle, {} (each has the next as its parent); give "
                "one of them a parent nearer to the root",
                spec.source, cycle);
  }
  for (const QuadrupedJoint& j : ordered) {
    const std::string other = mirror_name(j.name);
    if (other == j.name) {
      if (std::abs(j.at.y) > 1e-6)
        input_error("{}: joint '{}' is {:.3f} m off the middle plane but has no left or right in its name; set y to 0, "
                    "or name it 'left_{}' with mirror = true",
                    spec.source, j.name, std::abs(j.at.y), j.name);
      continue;
    }
    const QuadrupedJoint* twin = find(ordered, other);
    if (!twin)
      input_error("{}: joint '{}' has no counterpart '{}' in [builder]; set mirror = true at it, or add the other",
                  spec.source, j.name, other);
    const double off = glm::length(twin->at - dvec3(j.at.x, -j.at.y, j.at.z));
    if (off > 1e-6)
      input_error("{}: the joints '{}' and '{}' are not mirror images, by {:.3f} m; give one of them only, with "
                  "mirror = true",
                  spec.source, j.name, other, off);
  }
  return ordered;
}

void check_numbers(const QuadrupedSpec& spec) {
  const auto positive = [&](double v, const char* what) {
    if (!(v > 0 && std::isfinite(v))) input_error("{}: {} in [builder] must be greater than 0, not {}", spec.source, what, v);
  };
  positive(spec.target_edge, "target_edge_m");
  positive(spec.grid, "grid_m");
  if (spec.solids.empty()) input_error("{}: [builder] has no solids; add at least one", spec.source);
  for (const Solid& solid : spec.solids) {
    const auto refuse = [&](const std::string& what) {
      input_error("{}: solid '{}' in [builder] {}", spec.source, solid.name, what);
    };
    if (solid.sections.empty()) refuse("has no sections; add at least one");
    for (const double v : {solid.blend, solid.detail, solid.cap_start, solid.cap_end})
      if (!(v > 0 && std::isfinite(v))) refuse(fmt::format("has a blend, detail or cap of {}; they must be greater than 0", v));
    if (!all_finite(solid.up) || !(glm::length(solid.up) > 1e-6)) refuse("has an 'up' without direction");
    for (std::size_t i = 0; i < solid.sections.size(); ++i) {
      const SolidSection& s = solid.sections[i];
      if (!all_finite(s.at)) refuse(fmt::format("has section {} at no finite place", i));
      for (const double v : {s.side, s.up, s.down})
        if (!(v > 0 && std::isfinite(v)))
          refuse(fmt::format("has a radius of {} in section {}; radii must be greater than 0", v, i));
      if (!(s.power >= 1 && std::isfinite(s.power))) refuse(fmt::format("has a power of {} in section {}", s.power, i));
      if (!solid.mirror && s.at.y < -1e-6 && s.at.y + std::max({s.side, s.up, s.down}) < 0)
        refuse(fmt::format("has section {} on the right (y = {:.3f}); describe the left side, y > 0, with mirror = true",
                           i, s.at.y));
      if (!solid.mirror && s.at.y > 1e-6 && s.at.y - std::max({s.side, s.up, s.down}) > 0)
        refuse(fmt::format("has section {} on the left (y = {:.3f}) without mirror = true; set that, or y to 0", i, s.at.y));
      if (i > 0 && !(glm::length(s.at - solid.sections[i - 1].at) > 1e-4))
        refuse(fmt::format("has sections {} and {} at the same place; move one", i - 1, i));
    }
  }
}

void keep_one_body(const QuadrupedSpec& spec, const Field& field, HalfMesh& mesh) {
  const std::size_t n = mesh.positions.size();
  DisjointSets bodies = connected_vertices(n, mesh.triangles);
  const auto top = [&](std::uint32_t v) { return bodies.find(v); };
  // Signed volumes: the missing half of the border lies in y = 0, through the origin, and counts nothing.
  std::vector<double> volume(n, 0.0);
  for (const uvec3& t : mesh.triangles)
    volume[top(t.x)] += glm::dot(mesh.positions[t.x], glm::cross(mesh.positions[t.y], mesh.positions[t.z])) / 6;
  std::uint32_t largest = 0;
  for (std::uint32_t v = 0; v < n; ++v)
    if (volume[v] > volume[largest]) largest = v;
  std::vector<std::uint32_t> body, other;
  for (std::uint32_t v = 0; v < n; ++v) {
    if (top(v) == largest) body.push_back(v);
  }
  for (std::uint32_t v = 0; v < n && other.empty(); ++v)
    if (top(v) == v && v != largest && volume[v] > 0)
      for (std::uint32_t u = 0; u < n; ++u)
        if (top(u) == v) other.push_back(u);
  if (!other.empty()) {
    // The nearest two vertices: coarsely first, then each against all of the other body.
    const auto nearest = [&](const std::vector<std::uint32_t>& list, const dvec3& p, std::size_t stride) {
      std::uint32_t best = list[0];
      for (std::size_t i = 0; i < list.size(); i += stride)
        if (glm::length(mesh.positions[list[i]] - p) < glm::length(mesh.positions[best] - p)) best = list[i];
      return best;
    };
    const std::size_t few = other.size() / 300 + 1, some = body.size() / 3000 + 1;
    std::uint32_t a = body[0], b = other[0];
    for (std::size_t i = 0; i < other.size(); i += few) {
      const std::uint32_t v = nearest(body, mesh.positions[other[i]], some);
      if (glm::length(mesh.positions[v] - mesh.positions[other[i]]) < glm::length(mesh.positions[a] - mesh.positions[b]))
        a = v, b = other[i];
    }
    for (int i = 0; i < 4; ++i) {
      b = nearest(other, mesh.positions[a], 1);
      a = nearest(body, mesh.positions[b], 1);
    }
    const Shape* second = nearest_shape(field, mesh.positions[b]);
    const Shape* first = nearest_shape(field, mesh.positions[a], second ? second->name : "");
    input_error("{}: the solids '{}' and '{}' in [builder] do not meet, {:.1f} mm are missing near {}; move or enlarge "
                "one until they overlap",
                spec.source, first ? first->name : "?", second ? second->name : "?",
                1000 * glm::length(mesh.positions[a] - mesh.positions[b]), place(mesh.positions[b]));
  }
  if (body.size() == n) return;
  HalfMesh kept;
  std::vector<std::uint32_t> number(n, 0);
  for (const std::uint32_t v : body) {
    number[v] = static_cast<std::uint32_t>(kept.positions.size());
    kept.positions.push_back(mesh.positions[v]);
    kept.on_midplane.push_back(mesh.on_midplane[v]);
  }
  for (const uvec3& t : mesh.triangles)
    if (top(t.x) == largest) kept.triangles.emplace_back(number[t.x], number[t.y], number[t.z]);
  mesh = std::move(kept);
}

void check_joints_inside(const QuadrupedSpec& spec, const std::vector<QuadrupedJoint>& joints, const Field& field,
                         const HalfMesh& mesh) {
  Box box;
  for (const dvec3& p : mesh.positions) box.add(p), box.add({p.x, -p.y, p.z});
  for (const QuadrupedJoint& j : joints) {
    const dvec3 p(j.at.x, std::abs(j.at.y), j.at.z);
    double least = std::numeric_limits<double>::infinity();
    for (const dvec3& v : mesh.positions) least = std::min(least, glm::length(v - p));
    const dvec3 off = glm::max(dvec3(0.0), glm::max(box.lower - p, p - box.upper));
    const bool inside = glm::length(off) == 0 && field.distance(p) < 0;
    if (!inside && least > 0.1 * box.diagonal())
      input_error("{}: joint '{}' in [builder] at {} is {:.3f} m outside the body; move it, or add a solid around it",
                  spec.source, j.name, place(j.at), least);
  }
}

void check_surface(const QuadrupedSpec& spec, const Field& field, Rig& rig) {
  const Surface& s = rig.surface;
  const std::vector<std::uint32_t> welded = weld(s.rest);
  const MeshChecks found = check_mesh(s.rest, s.triangles, welded);
  if (!found.watertight())
    input_error("{}: the surface is not closed ({} border edges, {} edges and {} vertices that are no manifold); some "
                "part is thinner than grid_m = {} in [builder], make the grid finer or the part thicker",
                spec.source, found.border_edges, found.non_manifold_edges, found.non_manifold_vertices, spec.grid);
  if (static_cast<int>(found.genus) != spec.handles) {
    const std::vector<Ring> rings = find_rings(s.rest, s.triangles, welded);
    std::string where;
    if (!rings.empty()) {
      const dvec3 p(rings[0].centre.x, std::abs(rings[0].centre.y), rings[0].centre.z);
      const Shape* first = nearest_shape(field, p);
      const Shape* second = nearest_shape(field, p, first ? first->name : "");
      where = fmt::format(", one of {:.3f} m around near {} at the solids '{}' and '{}'", rings[0].length,
                          place(rings[0].centre), first ? first->name : "?", second ? second->name : "?");
    }
    rig.warnings.push_back(
        fmt::format("the body has {} handles (loops one can reach through){}, 'handles' in [builder] says {}; part the "
                    "solids or let them overlap more, or set handles",
                    found.genus, where, spec.handles));
  }
  if (found.self_intersections > 0)
    rig.warnings.push_back(fmt::format("the surface cuts itself in {} pairs of triangles, one near {}",
                                       found.self_intersections,
                                       place(dvec3(s.rest[s.triangles[found.intersecting[0].first].x]))));
}

}  // namespace moomill
