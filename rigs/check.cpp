#include "rigs/check.h"

#include <fmt/format.h>

#include <array>
#include <functional>
#include <map>
#include <set>

#include "generator/core/error.h"
#include "rigs/loading.h"

namespace moomill {
namespace {

using Findings = std::vector<Finding>;

template <class... Args>
void wrong(Findings& findings, fmt::format_string<Args...> format, Args&&... args) {
  findings.push_back({Finding::Level::wrong, fmt::format(format, std::forward<Args>(args)...)});
}
template <class... Args>
void suspicious(Findings& findings, fmt::format_string<Args...> format, Args&&... args) {
  findings.push_back({Finding::Level::suspicious, fmt::format(format, std::forward<Args>(args)...)});
}

Box bounds(const Rig& rig) {
  Box box;
  for (const uvec3& t : rig.surface.triangles)
    for (int k = 0; k < 3; ++k) box.add(dvec3(rig.surface.rest[t[k]]));
  return box;
}

// For every vertex, one number per distinct position: seams of normals and UVs are not borders.
std::vector<std::uint32_t> weld(const Surface& s) {
  std::map<std::array<float, 3>, std::uint32_t> known;
  std::vector<std::uint32_t> place(s.rest.size());
  for (std::size_t i = 0; i < s.rest.size(); ++i) {
    const vec3& p = s.rest[i];
    place[i] =
        known.try_emplace({p.x + 0.0f, p.y + 0.0f, p.z + 0.0f}, static_cast<std::uint32_t>(known.size())).first->second;
  }
  return place;
}

struct Topology {
  std::size_t degenerate = 0, isolated = 0, border = 0, non_manifold = 0, inconsistent = 0, edges = 0;
};

Topology topology(const Surface& s) {
  Topology found;
  const std::vector<std::uint32_t> place = weld(s);
  std::vector<char> used(s.rest.size(), 0);
  struct Uses {
    int forward = 0, backward = 0;
  };
  std::map<std::pair<std::uint32_t, std::uint32_t>, Uses> edges;
  for (const uvec3& t : s.triangles) {
    for (int k = 0; k < 3; ++k) used[t[k]] = 1;
    const dvec3 a(s.rest[t[0]]), b(s.rest[t[1]]), c(s.rest[t[2]]);
    const double longest = std::max({glm::length(b - a), glm::length(c - a), glm::length(c - b)});
    if (!(glm::length(glm::cross(b - a, c - a)) > 1e-10 * longest * longest)) {
      ++found.degenerate;
      if (place[t[0]] == place[t[1]] || place[t[1]] == place[t[2]] || place[t[2]] == place[t[0]]) continue;
    }
    for (int k = 0; k < 3; ++k) {
      const std::uint32_t p = place[t[k]], q = place[t[(k + 1) % 3]];
      ++(p < q ? edges[{p, q}].forward : edges[{q, p}].backward);
    }
  }
  found.isolated = static_cast<std::size_t>(std::count(used.begin(), used.end(), 0));
  found.edges = edges.size();
  for (const auto& [edge, uses] : edges) {
    const int all = uses.forward + uses.backward;
    found.border += all == 1;
    found.non_manifold += all > 2;
    found.inconsistent += all == 2 && uses.forward != 1;
  }
  return found;
}

std::vector<std::size_t> influence_counts(const Rig& rig) {
  std::vector<std::size_t> with(1, 0);
  for (std::size_t v = 0; v + 1 < rig.influence_begin.size(); ++v) {
    const std::size_t count = rig.influence_begin[v + 1] - rig.influence_begin[v];
    if (count >= with.size()) with.resize(count + 1, 0);
    ++with[count];
  }
  return with;
}

// Largest distance between the vertices as the file poses them and their rest positions.
double bind_mismatch(const Rig& rig) {
  const PosedSurface posed =
      skin(rig, bone_matrices(rig, world_transforms(rig, bind_pose(rig))),
           std::vector<double>(rig.morph_weights.size(), 0.0), SkinningMethod::linear_blend, dvec3(0));
  double most = 0;
  for (std::size_t i = 0; i < posed.positions.size(); ++i)
    most = std::max(most, glm::length(dvec3(posed.positions[i]) - dvec3(rig.surface.rest[i])));
  return most;
}

std::string list(const std::vector<std::string>& names) {
  std::string text;
  for (std::size_t i = 0; i < names.size() && i < 5; ++i) text += (i ? ", " : "") + names[i];
  if (names.size() > 5) text += fmt::format(" and {} more", names.size() - 5);
  return text;
}

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

}  // namespace

std::string describe_rig(const Rig& rig) {
  const Surface& s = rig.surface;
  const Box box = bounds(rig);
  std::string out = fmt::format("{}\n", rig.source);
  const auto line = [&]<class... Args>(fmt::format_string<Args...> format, Args&&... args) {
    out += fmt::format(format, std::forward<Args>(args)...) + "\n";
  };
  if (!box.empty())
    line("size       {:.3f} x {:.3f} x {:.3f} m (x, y, z), from ({:.3f}, {:.3f}, {:.3f})", box.size().x, box.size().y,
         box.size().z, box.lower.x, box.lower.y, box.lower.z);
  line("surface    {} vertices, {} triangles, {}, {}", s.rest.size(), s.triangles.size(),
       s.uvs.empty() ? "no UVs" : "UVs", s.colors.empty() ? "no vertex colours" : "vertex colours");
  const std::vector<std::size_t> with = influence_counts(rig);
  line("weights    at most {} joints per vertex, {:.2f} on average", with.size() - 1,
       s.rest.empty() ? 0.0 : static_cast<double>(rig.influences.size()) / static_cast<double>(s.rest.size()));
  for (std::size_t n = 1; n < with.size(); ++n)
    if (with[n]) line("             {} joints: {} vertices", n, with[n]);
  line("meshes     {}", rig.meshes.size());
  for (const MeshPart& part : rig.meshes)
    line("             {}: {} vertices, {} triangles, {}", part.name, part.vertex_count, part.triangle_count,
         part.skinned ? "skinned" : "rigid");
  line("materials  {}", rig.materials.size());
  const auto image_name = [&](const TextureUse& use) {
    return use.image >= 0 && use.image < static_cast<int>(rig.images.size()) ? rig.images[use.image].name
                                                                             : std::string("none");
  };
  for (const RigMaterial& m : rig.materials)
    line(
        "             {}: colour {:.3f} {:.3f} {:.3f}, roughness {:.2f}, metallic {:.2f}, textures: base {}, normal {}",
        m.name, m.base_color.x, m.base_color.y, m.base_color.z, m.roughness, m.metallic, image_name(m.base_texture),
        image_name(m.normal_texture));
  line("parts      {}", rig.part_names.size());
  std::vector<std::size_t> triangles_of(rig.part_names.size(), 0);
  for (const std::uint16_t part : s.parts) ++triangles_of[part];
  for (std::size_t i = 0; i < rig.part_names.size(); ++i)
    line("             {:>3} {}: {} triangles", i, rig.part_names[i], triangles_of[i]);
  if (!rig.morphs.empty()) {
    line("morphs     {}", rig.morphs.size());
    for (const MorphTarget& morph : rig.morphs) line("             {}", morph.name);
  }
  line("clips      {}", rig.clips.size());
  for (const Clip& clip : rig.clips)
    line("             {}: {:.3f} s, {} channels", clip.name, clip.duration, clip.channels.size());
  std::set<int> joints;
  for (const Bone& bone : rig.bones) joints.insert(bone.node);
  line("nodes      {}, of them {} joints (*)", rig.nodes.size(), joints.size());
  std::vector<std::vector<int>> children(rig.nodes.size());
  for (std::size_t i = 0; i < rig.nodes.size(); ++i)
    if (rig.nodes[i].parent >= 0) children[rig.nodes[i].parent].push_back(static_cast<int>(i));
  std::vector<std::pair<int, int>> stack;  // node, depth
  for (std::size_t i = rig.nodes.size(); i-- > 0;)
    if (rig.nodes[i].parent < 0) stack.emplace_back(static_cast<int>(i), 0);
  while (!stack.empty()) {
    const auto [node, depth] = stack.back();
    stack.pop_back();
    line("             {:{}}{}{}", "", 2 * std::min(depth, 40), rig.nodes[node].name, joints.count(node) ? " *" : "");
    for (auto child = children[node].rbegin(); child != children[node].rend(); ++child)
      stack.emplace_back(*child, depth + 1);
  }
  line("warnings   {}", rig.warnings.size());
  for (const std::string& warning : rig.warnings) line("             {}", warning);
  return out;
}

std::vector<Finding> check_rig(const Rig& rig) {
  Findings findings;
  const Surface& s = rig.surface;
  for (const std::string& warning : rig.warnings) suspicious(findings, "when loading: {}", warning);
  std::size_t bad = 0;
  for (const vec3& p : s.rest) bad += !all_finite(p);
  for (const vec3& n : s.normals) bad += !all_finite(n);
  if (bad) wrong(findings, "{} positions or normals are not finite numbers", bad);
  if (s.triangles.empty() || bad) {
    if (s.triangles.empty()) wrong(findings, "there are no triangles");
    return findings;
  }

  std::size_t off = 0, negative = 0;
  for (std::size_t v = 0; v + 1 < rig.influence_begin.size(); ++v) {
    double sum = 0;
    for (std::uint32_t i = rig.influence_begin[v]; i < rig.influence_begin[v + 1]; ++i) {
      sum += rig.influences[i].weight;
      negative += !(rig.influences[i].weight >= 0);
    }
    off += !(std::abs(sum - 1) < 1e-4);
  }
  if (off) wrong(findings, "the weights of {} vertices do not sum to 1", off);
  if (negative) wrong(findings, "{} weights are negative or not numbers", negative);
  const std::vector<std::size_t> with = influence_counts(rig);
  std::size_t many = 0;
  for (std::size_t n = 5; n < with.size(); ++n) many += with[n];
  if (many)
    suspicious(
        findings,
        "{} of {} vertices have more than 4 joints (at most {}), all are used here but other programs may drop some",
        many, s.rest.size(), with.size() - 1);

  const Topology found = topology(s);
  if (found.degenerate) suspicious(findings, "{} of {} triangles have no area", found.degenerate, s.triangles.size());
  if (found.isolated) suspicious(findings, "{} of {} vertices belong to no triangle", found.isolated, s.rest.size());
  if (found.border)
    suspicious(findings, "{} of {} edges have a triangle on one side only: the surface has holes or open borders",
               found.border, found.edges);
  if (found.non_manifold)
    suspicious(findings, "{} of {} edges have more than two triangles", found.non_manifold, found.edges);
  if (found.inconsistent)
    suspicious(findings, "{} of {} edges join triangles that face opposite ways", found.inconsistent, found.edges);

  const Box box = bounds(rig);
  const double length = std::max({box.size().x, box.size().y, box.size().z});
  if (length < 0.05 || length > 30)
    suspicious(findings,
               "the longest side is {:.4g} m, which no animal has: check the unit of the file, or load it with a scale",
               length);
  if (const double mismatch = bind_mismatch(rig); !(mismatch <= 1e-4 * box.diagonal()))
    suspicious(findings,
               "as the file poses it, vertices are up to {:.4g} m from where they were bound: it was saved in a pose",
               mismatch);
  if (s.uvs.empty()) suspicious(findings, "there are no UVs: image coats and UV maps cannot be made");

  const auto duplicates = [&](const auto& items, const char* what) {
    std::map<std::string, int> count;
    for (const auto& item : items) ++count[item.name];
    std::vector<std::string> names;
    for (const auto& [name, n] : count)
      if (n > 1) names.push_back(name);
    if (!names.empty()) wrong(findings, "{} {} share a name with another: {}", names.size(), what, list(names));
  };
  duplicates(rig.nodes, "nodes");
  duplicates(rig.clips, "clips");

  std::vector<char> moves(rig.bones.size(), 0);
  for (const Influence& influence : rig.influences) moves[influence.bone] = 1;
  std::map<int, bool> idle;  // by node: several bones may hang on one
  for (std::size_t b = 0; b < rig.bones.size(); ++b)
    idle.try_emplace(rig.bones[b].node, true).first->second &= !moves[b];
  std::vector<std::string> names;
  for (const auto& [node, none] : idle)
    if (none) names.push_back(rig.nodes[node].name);
  if (!names.empty()) suspicious(findings, "{} joints move no vertex: {}", names.size(), list(names));
  for (const Bone& bone : rig.bones)
    if (!is_invertible(bone.inverse_bind))
      wrong(findings, "the bind matrix of joint '{}' is flat or not finite", rig.nodes[bone.node].name);
  return findings;
}

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
    if (expected && std::abs(is - *expected) > 0.1 * *expected)
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
      if (winding_number(rig.surface, posed.positions, points[i]) < 0.5 &&
          from_surface > std::max(k.tolerance, 0.005 * size))
        suspicious(findings, "keypoint '{}' is outside of the body, {:.3f} m from its surface", k.name, from_surface);
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
  }

  for (const JointLimit& limit : species.limits) {
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
  if (rig.surface.nnopcs.size() != rig.surface.rest.size())
    wrong(findings, "neutral coordinates are not baked: call bake_nnopcs after loading");
  return findings;
}

}  // namespace moomill
