#include "validate/studies/deformation.h"

#include <fmt/format.h>

#include <array>
#include <glm/gtc/matrix_inverse.hpp>
#include <map>

#include "generator/core/parallel.h"

namespace moomill {
namespace {

using Edge = std::pair<std::uint32_t, std::uint32_t>;

dvec3 joint_place(const Bone& bone) {
  return dvec3(glm::affineInverse(bone.inverse_bind)[3]);
}

dvec3 vector_area(const std::vector<dvec3>& loop) {
  dvec3 sum(0);
  for (std::size_t i = 0; i < loop.size(); ++i)
    sum += glm::cross(loop[i] - loop[0], loop[(i + 1) % loop.size()] - loop[0]);
  return 0.5 * sum;
}

// Whether a loop goes round the line through `at` along `axis`, by the angle it sweeps.
bool goes_round(const std::vector<dvec3>& loop, const dvec3& at, const dvec3& axis) {
  double angle = 0;
  for (std::size_t i = 0; i < loop.size(); ++i) {
    const dvec3 a = loop[i] - at, b = loop[(i + 1) % loop.size()] - at;
    angle += std::atan2(glm::dot(axis, glm::cross(a, b)), glm::dot(a, b) - glm::dot(a, axis) * glm::dot(b, axis));
  }
  return std::abs(angle) > pi;
}

// The smallest closed loop around `at` in which a plane cuts the surface; without points when there is none.
Ring cut(const Rig& rig, const std::vector<std::uint32_t>& place, const dvec3& at, const dvec3& axis) {
  const Surface& s = rig.surface;
  std::vector<double> height(s.rest.size());
  for (std::size_t v = 0; v < height.size(); ++v) height[v] = glm::dot(dvec3(s.rest[v]) - at, axis);
  std::map<Edge, Ring::Point> points;
  std::map<Edge, std::vector<Edge>> next;  // crossed edges, joined by the triangles between them
  for (const uvec3& t : s.triangles) {
    std::vector<Edge> crossed;
    for (int k = 0; k < 3; ++k) {
      std::uint32_t a = t[k], b = t[(k + 1) % 3];
      if ((height[a] < 0) == (height[b] < 0)) continue;
      if (place[a] > place[b]) std::swap(a, b);
      const Edge edge{place[a], place[b]};
      points.try_emplace(edge, Ring::Point{a, b, height[a] / (height[a] - height[b])});
      crossed.push_back(edge);
    }
    if (crossed.size() == 2) next[crossed[0]].push_back(crossed[1]), next[crossed[1]].push_back(crossed[0]);
  }
  Ring best;
  std::map<Edge, bool> done;
  for (const auto& [first, ends] : next) {
    if (done[first] || ends.size() != 2) continue;
    Ring ring;
    std::vector<dvec3> loop;
    Edge here = first, before = first;
    bool closed = false;
    do {
      done[here] = true;
      const Ring::Point& p = points[here];
      ring.points.push_back(p);
      loop.push_back(glm::mix(dvec3(s.rest[p.a]), dvec3(s.rest[p.b]), p.share));
      const std::vector<Edge>& to = next[here];
      if (to.size() != 2) break;
      const Edge from = here;
      here = to[0] != before || before == here ? to[0] : to[1];
      before = from;
      closed = here == first;
    } while (!closed && !done[here]);
    if (!closed || loop.size() < 3 || !goes_round(loop, at, axis)) continue;
    ring.area = glm::length(vector_area(loop));
    if (ring.area > 1e-8 && (best.points.empty() || ring.area < best.area)) best = std::move(ring);
  }
  return best;
}

std::vector<Ring> find_rings(const Rig& rig, const std::vector<std::uint32_t>& place) {
  std::vector<int> bone_of(rig.nodes.size(), -1);
  std::vector<double> skin(rig.bones.size(), 0.0);
  for (const Influence& i : rig.influences) skin[i.bone] += i.weight;
  for (std::size_t b = 0; b < rig.bones.size(); ++b)
    if (bone_of[rig.bones[b].node] < 0) bone_of[rig.bones[b].node] = static_cast<int>(b);
  std::vector<std::vector<Ring>> found(rig.nodes.size());
  parallel_for(rig.nodes.size(), 1, [&](std::size_t n) {
    const int bone = bone_of[n], parent = rig.nodes[n].parent;
    if (bone < 0 || parent < 0 || bone_of[parent] < 0 || skin[bone] <= 0) return;
    const dvec3 at = joint_place(rig.bones[bone]);
    dvec3 in = at - joint_place(rig.bones[bone_of[parent]]), out(0);
    for (std::size_t c = 0; c < rig.nodes.size(); ++c)
      if (rig.nodes[c].parent == static_cast<int>(n) && bone_of[c] >= 0) out += joint_place(rig.bones[bone_of[c]]) - at;
    if (glm::length(in) < 1e-9 && glm::length(out) < 1e-9) return;
    dvec3 axis(0);
    if (glm::length(in) > 1e-9) axis += glm::normalize(in);
    if (glm::length(out) > 1e-9) axis += glm::normalize(out);
    if (glm::length(axis) < 0.1) axis = in;
    axis = glm::normalize(axis);
    Ring middle = cut(rig, place, at, axis);
    if (middle.points.empty()) return;
    const double radius = std::sqrt(middle.area / pi), area = middle.area;
    middle.node = static_cast<int>(n);
    found[n].push_back(std::move(middle));
    for (const double share : {-1.0, -0.5, 0.5, 1.0}) {
      Ring ring = cut(rig, place, at + share * radius * axis, axis);
      if (ring.points.empty() || ring.area > 3 * area) continue;  // the plane has left the limb
      ring.node = static_cast<int>(n);
      ring.offset = share * radius;
      found[n].push_back(std::move(ring));
    }
  });
  std::vector<Ring> rings;
  for (auto& list : found)
    for (Ring& ring : list) rings.push_back(std::move(ring));
  return rings;
}

struct Spread {
  double least = 0, most = 0, mean = 0, p95 = 0;
  std::size_t least_at = 0, most_at = 0;
};
Spread spread(const std::vector<double>& values) {
  Spread s;
  if (values.empty()) return s;
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (values[i] < values[s.least_at]) s.least_at = i;
    if (values[i] > values[s.most_at]) s.most_at = i;
    s.mean += values[i] / static_cast<double>(values.size());
  }
  s.least = values[s.least_at], s.most = values[s.most_at];
  std::vector<double> sorted = values;
  std::sort(sorted.begin(), sorted.end());
  s.p95 = sorted[(sorted.size() - 1) * 95 / 100];
  return s;
}

constexpr std::array<SkinningMethod, 2> methods{SkinningMethod::linear_blend, SkinningMethod::dual_quaternion};

Deformation deform(const Species& species, const DeformationReference& reference, Pose pose, SkinningMethod method) {
  pose.placement = dmat4(1.0);
  const std::vector<dmat4> bones = bone_matrices(species.rig, world_transforms(species.rig, pose));
  return measure_deformation(species.rig, reference, bones,
                             skin(species.rig, bones, pose.morph_weights, method, dvec3(0)));
}

// One joint turned to a limit about one axis, all others neutral.
struct Extreme {
  Pose pose;
  std::string what;
};
std::vector<Extreme> extremes(const Species& species, double factor) {
  std::vector<Extreme> result;
  Species one;
  one.rig.nodes = species.rig.nodes;
  one.neutral = species.neutral;
  for (const JointLimit& limit : species.limits)
    for (int axis = 0; axis < 3; ++axis)
      for (const dvec3& end : {limit.lower_deg, limit.upper_deg}) {
        if (end[axis] == 0) continue;
        dvec3 angle(0);
        angle[axis] = factor * end[axis];
        one.limits = {{limit.node, angle, angle}};
        result.push_back({sample_within_limits(one, {}),
                          fmt::format("{} {:+.0f} deg about {}", species.rig.nodes[limit.node].name, angle[axis],
                                      "xyz"[axis])});
      }
  return result;
}

}  // namespace

DeformationReference deformation_reference(const Rig& rig) {
  const Surface& s = rig.surface;
  DeformationReference r;
  std::map<std::array<float, 3>, std::uint32_t> known;
  for (const vec3& p : s.rest)
    r.place.push_back(
        known.try_emplace({p.x + 0.0f, p.y + 0.0f, p.z + 0.0f}, static_cast<std::uint32_t>(known.size())).first->second);
  std::map<Edge, int> edges;
  for (const uvec3& t : s.triangles) {
    const dvec3 a(s.rest[t.x]), n = glm::cross(dvec3(s.rest[t.y]) - a, dvec3(s.rest[t.z]) - a);
    const double length = glm::length(n);
    r.areas.push_back(0.5 * length);
    r.area += 0.5 * length;
    r.normals.push_back(length > 0 ? n / length : dvec3(0));
    for (int k = 0; k < 3; ++k) ++edges[{r.place[t[k]], r.place[t[(k + 1) % 3]]}];
  }
  r.closed = !edges.empty();
  for (const auto& [edge, count] : edges) {
    const auto back = edges.find({edge.second, edge.first});
    if (count != 1 || back == edges.end() || back->second != 1) r.closed = false;
  }
  r.rings = find_rings(rig, r.place);
  return r;
}

Deformation measure_deformation(const Rig& rig, const DeformationReference& reference, const std::vector<dmat4>& bones,
                                const PosedSurface& posed) {
  const Surface& s = rig.surface;
  Deformation d;
  for (const vec3& p : posed.positions) d.finite &= all_finite(p);
  for (const vec3& n : posed.normals) d.finite &= all_finite(n);
  if (!d.finite) return d;
  std::vector<std::int64_t> first(s.rest.size(), -1);
  for (std::size_t v = 0; v < s.rest.size(); ++v) {
    std::int64_t& f = first[reference.place[v]];
    if (f < 0)
      f = static_cast<std::int64_t>(v);
    else
      d.seam = std::max(d.seam, glm::length(dvec3(posed.positions[v]) - dvec3(posed.positions[f])));
  }
  const dvec3 about = posed.positions.empty() ? dvec3(0) : dvec3(posed.positions[0]);
  const auto at = [&](std::uint32_t v) { return dvec3(posed.positions[v]) - about; };
  for (std::size_t t = 0; t < s.triangles.size(); ++t) {
    const uvec3& v = s.triangles[t];
    const dvec3 a = at(v.x), b = at(v.y), c = at(v.z);
    const dvec3 normal = glm::cross(b - a, c - a);
    d.volume += glm::dot(a, glm::cross(b, c)) / 6;
    if (reference.areas[t] <= 0) continue;
    dvec3 carried(0);
    for (int k = 0; k < 3; ++k)
      for (std::uint32_t i = rig.influence_begin[v[k]]; i < rig.influence_begin[v[k] + 1]; ++i)
        carried += static_cast<double>(rig.influences[i].weight) *
                   transform_vector(bones[rig.influences[i].bone], reference.normals[t]);
    if (glm::dot(carried, normal) < 0) d.inverted += reference.areas[t];
    // Smallest stretch of the map from the triangle at rest: eigenvalues of its metric in an orthonormal basis there.
    const dvec3 e1 = dvec3(s.rest[v.y]) - dvec3(s.rest[v.x]), e2 = dvec3(s.rest[v.z]) - dvec3(s.rest[v.x]);
    const double l1 = glm::length(e1);
    const dvec3 x = e1 / l1, y = glm::cross(reference.normals[t], x);
    const double e2x = glm::dot(e2, x), e2y = glm::dot(e2, y);
    const dvec3 fx = (b - a) / l1, fy = (c - a - e2x * fx) / e2y;
    const double m = 0.5 * (glm::dot(fx, fx) + glm::dot(fy, fy)), h = 0.5 * (glm::dot(fx, fx) - glm::dot(fy, fy)),
                 o = glm::dot(fx, fy);
    if (m - std::sqrt(h * h + o * o) < 0.0625) d.crushed += reference.areas[t];
  }
  d.inverted /= reference.area;
  d.crushed /= reference.area;
  for (const Ring& ring : reference.rings) {
    std::vector<dvec3> loop;
    for (const Ring::Point& p : ring.points) loop.push_back(glm::mix(at(p.a), at(p.b), p.share));
    d.rings.push_back(glm::length(vector_area(loop)) / ring.area);
  }
  return d;
}

StudyResult study_deformation(const Species& species, const std::vector<Pose>& poses, int first_frame) {
  const Rig& rig = species.rig;
  const DeformationReference reference = deformation_reference(rig);
  StudyResult result;
  result.title = fmt::format("Deformation of {} in {} poses", species.name, poses.size());
  std::string& table = result.table;
  table = fmt::format(
      "# {}\n\nRelative to the neutral pose: {} triangles{}. Worst (frame), mean and 95th percentile over the poses.\n\n"
      "| measure | linear blend | dual quaternion |\n|---|---|---|\n",
      result.title, rig.surface.triangles.size(), reference.closed ? ", closed" : "; open, so volume is not measured");

  struct Measured {
    std::vector<double> loss, gain, inverted, crushed, ring;
    std::vector<Spread> joints;  // per node: the worst ring of each pose
    std::vector<char> has_ring;
    bool finite = true;
    double seam = 0;
  };
  std::array<Measured, 2> all;
  for (std::size_t m = 0; m < 2; ++m) {
    const double neutral = deform(species, reference, species.neutral, methods[m]).volume;
    std::vector<Deformation> each(poses.size());
    parallel_for(poses.size(), 1, [&](std::size_t p) { each[p] = deform(species, reference, poses[p], methods[m]); });
    Measured& out = all[m];
    std::vector<std::vector<double>> by_node(rig.nodes.size());
    for (const Deformation& d : each) {
      out.finite &= d.finite;
      out.seam = std::max(out.seam, d.seam);
      const double change = reference.closed && d.finite ? d.volume / neutral - 1 : 0;
      out.loss.push_back(std::max(-change, 0.0));
      out.gain.push_back(std::max(change, 0.0));
      out.inverted.push_back(d.inverted);
      out.crushed.push_back(d.crushed);
      double least = 1;
      std::vector<double> node_least(rig.nodes.size(), std::numeric_limits<double>::infinity());
      for (std::size_t r = 0; r < d.rings.size(); ++r) {
        least = std::min(least, d.rings[r]);
        double& n = node_least[reference.rings[r].node];
        n = std::min(n, d.rings[r]);
      }
      out.ring.push_back(least);
      for (std::size_t n = 0; n < by_node.size(); ++n)
        if (std::isfinite(node_least[n])) by_node[n].push_back(node_least[n]);
    }
    for (const auto& values : by_node) {
      out.joints.push_back(spread(values));
      out.has_ring.push_back(!values.empty());
    }
  }
  const auto frame = [&](std::size_t index) { return first_frame + static_cast<int>(index); };
  const auto row = [&](const std::string& what, double unit, const char* format, bool least, auto get) {
    table += "| " + what + " |";
    for (const Measured& m : all) {
      const Spread s = spread(get(m));
      table += fmt::format(fmt::runtime(std::string(" ") + format + " ({}), " + format + ", " + format + " |"),
                           unit * (least ? s.least : s.most), frame(least ? s.least_at : s.most_at), unit * s.mean,
                           unit * s.p95);
    }
    table += "\n";
  };
  if (reference.closed) {
    row("volume lost, %", 100, "{:.2f}", false, [](const Measured& m) { return m.loss; });
    row("volume gained, %", 100, "{:.2f}", false, [](const Measured& m) { return m.gain; });
  }
  row("area inverted, %", 100, "{:.4f}", false, [](const Measured& m) { return m.inverted; });
  row("area squeezed below a quarter, %", 100, "{:.3f}", false, [](const Measured& m) { return m.crushed; });
  row("smallest ring at a joint", 1, "{:.3f}", true, [](const Measured& m) { return m.ring; });

  table += "\n| ring at joint: smallest area over rest (frame), mean | linear blend | dual quaternion |\n|---|---|---|\n";
  for (std::size_t n = 0; n < rig.nodes.size(); ++n)
    if (all[0].has_ring[n] && std::min(all[0].joints[n].least, all[1].joints[n].least) < 0.97) {
      table += fmt::format("| {} |", rig.nodes[n].name);
      for (const Measured& m : all)
        table += fmt::format(" {:.3f} ({}), {:.3f} |", m.joints[n].least, frame(m.joints[n].least_at), m.joints[n].mean);
      table += "\n";
    }

  // Joint limits, one at a time.
  const std::size_t own = species.skinning == SkinningMethod::dual_quaternion;
  bool extreme_finite = true;
  double extreme_seam = 0;
  for (const double factor : {1.0, 1.5}) {
    const std::vector<Extreme> list = extremes(species, factor);
    if (list.empty()) continue;
    table += fmt::format("\n| {} joint angles {} | linear blend | dual quaternion |\n|---|---|---|\n", list.size(),
                         factor == 1 ? "at their limits" : "50 % past their limits");
    std::array<std::vector<Deformation>, 2> each;
    std::array<double, 2> neutral{};
    for (std::size_t m = 0; m < 2; ++m) {
      neutral[m] = deform(species, reference, species.neutral, methods[m]).volume;
      each[m].resize(list.size());
      parallel_for(list.size(), 1,
                   [&](std::size_t i) { each[m][i] = deform(species, reference, list[i].pose, methods[m]); });
      for (const Deformation& d : each[m]) extreme_finite &= d.finite, extreme_seam = std::max(extreme_seam, d.seam);
    }
    const auto worst = [&](const std::string& what, auto get) {
      table += "| " + what + " |";
      for (std::size_t m = 0; m < 2; ++m) {
        std::vector<double> values;
        for (const Deformation& d : each[m]) values.push_back(get(d, neutral[m]));
        const Spread s = spread(values);
        table += fmt::format(" {:.3f} ({}) |", s.most, list[s.most_at].what);
      }
      table += "\n";
    };
    if (reference.closed)
      worst("volume changed, %", [](const Deformation& d, double v) { return 100 * std::abs(d.volume / v - 1); });
    worst("area inverted, %", [](const Deformation& d, double) { return 100 * d.inverted; });
    worst("ring area lost, %", [](const Deformation& d, double) {
      double least = 1;
      for (const double r : d.rings) least = std::min(least, r);
      return 100 * (1 - least);
    });
    table += "| not finite |";
    for (std::size_t m = 0; m < 2; ++m)
      table += fmt::format(" {} |", std::count_if(each[m].begin(), each[m].end(), [](auto& d) { return !d.finite; }));
    table += "\n";
  }
  table += fmt::format("\nThe species' own method is {}.\n", own ? "dual_quaternion" : "linear_blend");

  for (std::size_t m = 0; m < 2; ++m) {
    const std::string name = m ? "dual quaternion: " : "linear blend: ";
    const auto bound = [&](double value) { return m == own ? std::optional<double>(value) : std::nullopt; };
    if (reference.closed) {
      const double change = std::max(spread(all[m].loss).most, spread(all[m].gain).most);
      result.figures.push_back({name + "largest change of volume", change, "", bound(0.08), {}});
    }
    result.figures.push_back({name + "largest share of inverted area", spread(all[m].inverted).most, "", bound(0.001), {}});
    result.figures.push_back({name + "smallest ring area at a joint", spread(all[m].ring).least, "", {}, bound(smallest_ring)});
    result.figures.push_back({name + "area squeezed below a quarter, worst pose", spread(all[m].crushed).most, "", {}, {}});
  }
  double seam = extreme_seam;
  for (const Measured& m : all) seam = std::max(seam, m.seam), extreme_finite &= m.finite;
  result.figures.push_back({"every pose and extreme finite", extreme_finite ? 1.0 : 0.0, "", {}, 1.0});
  result.figures.push_back({"seams open by at most", seam, "m", 1e-6, {}});
  if (reference.closed) result.figures.push_back({"closed", 1, "", {}, 1.0});
  return result;
}

}  // namespace moomill
