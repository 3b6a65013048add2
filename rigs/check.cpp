#include "rigs/check.h"

#include <map>
#include <set>

#include "rigs/findings.h"
#include "rigs/loading.h"
#include "rigs/mesh_checks.h"

namespace moomill {
namespace {

constexpr double longest_animal = 7.5;       // metres; elephants and giraffes stay below
constexpr double least_occupancy = 0.5;      // of the UV atlas
constexpr double most_density_spread = 4;    // of texels a metre, 95 % against 5 % of the surface

Box bounds(const Rig& rig) {
  Box box;
  for (const uvec3& t : rig.surface.triangles)
    for (int k = 0; k < 3; ++k) box.add(dvec3(rig.surface.rest[t[k]]));
  return box;
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

std::string percent(std::size_t part, std::size_t whole) {
  return fmt::format("{:.2g} %", whole ? 100.0 * static_cast<double>(part) / static_cast<double>(whole) : 0.0);
}

// The first triangle for which `fits` holds, or none at all.
template <class Fits>
std::size_t first_triangle(const Surface& s, const Fits& fits) {
  std::size_t t = 0;
  while (t < s.triangles.size() && !fits(s.triangles[t])) ++t;
  return std::min(t, s.triangles.size() - 1);
}

double least_angle_deg(const Surface& s, const uvec3& t) {
  double least = 180;
  for (int k = 0; k < 3; ++k) {
    const dvec3 p(s.rest[t[k]]), u = dvec3(s.rest[t[(k + 1) % 3]]) - p, v = dvec3(s.rest[t[(k + 2) % 3]]) - p;
    least = std::min(least, std::atan2(glm::length(glm::cross(u, v)), glm::dot(u, v)) / degrees);
  }
  return least;
}

// A triangle at an edge that has exactly, or more than, so many triangles.
std::size_t triangle_at_edge(const Surface& s, const std::vector<std::uint32_t>& place, bool border) {
  std::map<std::pair<std::uint32_t, std::uint32_t>, std::pair<int, std::size_t>> edges;
  for (std::size_t t = 0; t < s.triangles.size(); ++t)
    for (int k = 0; k < 3; ++k) {
      const std::uint32_t p = place[s.triangles[t][k]], q = place[s.triangles[t][(k + 1) % 3]];
      if (p == q) continue;
      auto& edge = edges.try_emplace({std::min(p, q), std::max(p, q)}, 0, t).first->second;
      ++edge.first;
    }
  std::size_t first = s.triangles.size();
  for (const auto& [ends, edge] : edges)
    if (border ? edge.first == 1 : edge.first > 2) first = std::min(first, edge.second);
  return std::min(first, s.triangles.size() - 1);
}

void check_surface(const Rig& rig, Findings& findings) {
  const Surface& s = rig.surface;
  const std::vector<std::uint32_t> place = weld(s.rest);
  const MeshChecks m = check_mesh(s.rest, s.triangles, place);
  std::vector<char> used(s.rest.size(), 0);
  for (const uvec3& t : s.triangles)
    for (int k = 0; k < 3; ++k) used[t[k]] = 1;
  const auto isolated = static_cast<std::size_t>(std::count(used.begin(), used.end(), 0));
  if (m.degenerate)
    suspicious(findings, "{} of {} triangles have no area, the first {}", m.degenerate, m.triangles,
               triangle_place(rig, first_triangle(s, [&](const uvec3& t) {
                 const dvec3 a(s.rest[t[0]]), b(s.rest[t[1]]), c(s.rest[t[2]]);
                 const double longest = std::max({glm::length(b - a), glm::length(c - a), glm::length(c - b)});
                 return !(0.5 * glm::length(glm::cross(b - a, c - a)) > 1e-9 * longest * longest);
               })));
  if (m.slivers[0] > m.degenerate)
    suspicious(findings, "{} of {} triangles are slivers with an angle below 1 degree, the first {}",
               m.slivers[0] - m.degenerate, m.triangles, triangle_place(rig, first_triangle(s, [&](const uvec3& t) {
                 const double angle = least_angle_deg(s, t);
                 return angle < 1 && angle > 1e-4;
               })));
  if (isolated)
    suspicious(findings, "{} of {} vertices belong to no triangle, the first is {}", isolated, s.rest.size(),
               vertex_place(rig, static_cast<std::size_t>(std::find(used.begin(), used.end(), 0) - used.begin())));
  if (m.border_edges)
    suspicious(findings,
               "{} of {} edges have a triangle on one side only, around {} holes or open borders, the first {}",
               m.border_edges, m.edges, m.border_loops, triangle_place(rig, triangle_at_edge(s, place, true)));
  if (m.non_manifold_edges)
    suspicious(findings, "{} of {} edges have more than two triangles, the first {}", m.non_manifold_edges, m.edges,
               triangle_place(rig, triangle_at_edge(s, place, false)));
  if (m.inconsistent_edges)
    suspicious(findings, "{} of {} edges join triangles that face opposite ways", m.inconsistent_edges, m.edges);
  if (m.non_manifold_vertices)
    suspicious(findings, "at {} of {} vertices separate parts of the surface touch in a point", m.non_manifold_vertices,
               m.vertices);
  if (m.components > 1)
    suspicious(findings, "the surface is of {} separate pieces, which a pose may pull apart", m.components);
  if (m.self_intersections)
    suspicious(findings, "{} pairs of triangles go through each other, the first {}", m.self_intersections,
               triangle_place(rig, m.intersecting.front().first));
  if (m.border_edges + m.non_manifold_edges == 0 && m.volume < 0)
    suspicious(findings, "the surface is inside out: all its triangles face inwards");
}

void check_uvs(const Rig& rig, Findings& findings) {
  const Surface& s = rig.surface;
  if (s.uvs.empty()) {
    suspicious(findings, "there are no UVs: image coats and UV maps cannot be made");
    return;
  }
  constexpr int resolution = 2048;
  const AtlasChecks a = check_atlas(s, resolution);
  if (a.outside)
    suspicious(findings, "{} of {} vertices have UVs outside of the unit square, where coats repeat", a.outside,
               s.uvs.size());
  if (a.flat) suspicious(findings, "{} of {} triangles have no area in the UV atlas", a.flat, s.triangles.size());
  if (a.twice)
    suspicious(findings,
               "UVs overlap: {} of the {} texels in use ({}, of {} x {}) belong to several places of the surface, the "
               "first at ({:.3f}, {:.3f})",
               a.twice, a.covered, percent(a.twice, a.covered), resolution, resolution, a.first_twice.x,
               a.first_twice.y);
  if (a.outside == 0 && a.occupancy() < least_occupancy)
    suspicious(findings, "the UV atlas is used to {:.0f} % only, coats waste the rest", 100 * a.occupancy());
  if (a.density_spread() > most_density_spread)
    suspicious(findings,
               "texels are unevenly spread: 5 % of the surface has {:.0f} texels a metre or fewer, another 5 % {:.0f} "
               "or more ({} x {})",
               resolution * a.density[0], resolution * a.density[2], resolution, resolution);
}

}  // namespace

std::string list_names(const std::vector<std::string>& names) {
  std::string text;
  for (std::size_t i = 0; i < names.size() && i < 5; ++i) text += (i ? ", " : "") + names[i];
  if (names.size() > 5) text += fmt::format(" and {} more", names.size() - 5);
  return text;
}

std::string triangle_place(const Rig& rig, std::size_t triangle) {
  const uvec3& t = rig.surface.triangles[triangle];
  const dvec3 c = (dvec3(rig.surface.rest[t[0]]) + dvec3(rig.surface.rest[t[1]]) + dvec3(rig.surface.rest[t[2]])) / 3.0;
  std::string text = fmt::format("at ({:.2f}, {:.2f}, {:.2f}) m", c.x, c.y, c.z);
  if (triangle < rig.surface.parts.size() && rig.surface.parts[triangle] < rig.part_names.size())
    text += fmt::format(", part '{}'", rig.part_names[rig.surface.parts[triangle]]);
  return text;
}

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

  check_surface(rig, findings);
  const Box box = bounds(rig);
  const double length = std::max({box.size().x, box.size().y, box.size().z});
  if (length < 0.02 || length > longest_animal)
    suspicious(findings,
               "the longest side is {:.4g} m, which no land animal has: check the unit of the file, or load it with a scale",
               length);
  if (const double mismatch = bind_mismatch(rig); !(mismatch <= 1e-4 * box.diagonal()))
    suspicious(findings,
               "as the file poses it, vertices are up to {:.4g} m from where they were bound: it was saved in a pose",
               mismatch);
  check_uvs(rig, findings);
  if (std::none_of(rig.meshes.begin(), rig.meshes.end(), [](const MeshPart& part) { return part.skinned; }))
    suspicious(findings, "no mesh is skinned, so nothing can be posed: give it a skeleton by `moomill rig bind`");

  const auto duplicates = [&](const auto& items, const char* what) {
    std::map<std::string, int> count;
    for (const auto& item : items) ++count[item.name];
    std::vector<std::string> names;
    for (const auto& [name, n] : count)
      if (n > 1) names.push_back(name);
    if (!names.empty()) wrong(findings, "{} {} share a name with another: {}", names.size(), what, list_names(names));
  };
  duplicates(rig.nodes, "nodes");
  duplicates(rig.clips, "clips");

  std::vector<char> moves(rig.bones.size(), 0);
  for (const Influence& influence : rig.influences) moves[influence.bone] = 1;
  std::map<int, bool> idle;  // by node: several bones may hang on one
  for (std::size_t b = 0; b < rig.bones.size(); ++b)
    idle.try_emplace(rig.bones[b].node, true).first->second &= !moves[b];
  // Roots move nothing themselves, and the last joint of a chain only marks its end.
  std::set<int> above, below;
  for (const auto& [node, none] : idle)
    for (int up = rig.nodes[node].parent; up >= 0; up = rig.nodes[up].parent)
      if (idle.count(up)) above.insert(up), below.insert(node);
  std::vector<std::string> names;
  for (const auto& [node, none] : idle)
    if (none && (above.count(node) == below.count(node))) names.push_back(rig.nodes[node].name);
  if (!names.empty())
    suspicious(findings, "{} of {} joints move no vertex: {}", names.size(), idle.size(), list_names(names));
  for (const Bone& bone : rig.bones)
    if (!is_invertible(bone.inverse_bind))
      wrong(findings, "the bind matrix of joint '{}' is flat or not finite", rig.nodes[bone.node].name);
  return findings;
}

}  // namespace moomill
