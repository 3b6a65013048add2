#include "rigs/quadruped.h"

#include <algorithm>
#include <cmath>

#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "generator/core/topology.h"
#include "rigs/quadruped_check.h"
#include "rigs/remesh.h"
#include "rigs/skin_weights.h"
#include "rigs/solids.h"
#include "rigs/unwrap.h"

namespace moomill {

namespace {

// Cells along the longest side of the body that weights diffuse on.
constexpr double weight_cells = 140;

void add_joints(const std::vector<QuadrupedJoint>& joints, Rig& rig) {
  for (const QuadrupedJoint& j : joints) {
    Node node;
    node.name = j.name;
    node.parent = rig.find_node(j.parent);
    node.translation = node.parent >= 0 ? j.at - joints[node.parent].at : j.at;
    Bone bone;
    bone.node = static_cast<int>(rig.nodes.size());
    bone.inverse_bind[3] = dvec4(-j.at, 1.0);  // all joints are turned as the model is in the neutral pose
    rig.nodes.push_back(std::move(node));
    rig.bones.push_back(bone);
  }
}

// Angle-weighted normals (Thuermer and Wuethrich 1998). Not the field's gradient: where solids meet it may jump.
std::vector<vec3> vertex_normals(const HalfMesh& mesh) {
  std::vector<dvec3> sum(mesh.positions.size(), dvec3(0));
  for (const uvec3& t : mesh.triangles)
    for (int k = 0; k < 3; ++k) {
      const dvec3 p = mesh.positions[t[k]], a = mesh.positions[t[(k + 1) % 3]] - p,
                  b = mesh.positions[t[(k + 2) % 3]] - p;
      const dvec3 n = glm::cross(a, b);
      const double length = glm::length(n);
      if (length > 0) sum[t[k]] += n / length * std::atan2(length, glm::dot(a, b));
    }
  std::vector<vec3> normals(sum.size());
  for (std::size_t i = 0; i < sum.size(); ++i) {
    if (mesh.on_midplane[i]) sum[i].y = 0;  // the mirror image's triangles cancel it
    normals[i] = vec3(glm::normalize(sum[i]));
  }
  return normals;
}

// Skin weights of the half mesh, dense: the joints that the solids' sections name, evened out by heat inside the body,
// then a little along the surface, where cells leave steps.
std::vector<double> skin_weights(const HalfMesh& mesh, const Field& field, const std::vector<int>& twin) {
  const std::size_t n = mesh.positions.size(), joints = twin.size();
  std::vector<dvec3> positions = mesh.positions;
  std::vector<uvec3> triangles = mesh.triangles;
  Box box;
  for (const dvec3& p : mesh.positions) {
    positions.emplace_back(p.x, -p.y, p.z);
    box.add(p);
    box.add(positions.back());
  }
  for (const uvec3& t : mesh.triangles) {
    const auto other = [&](std::uint32_t v) {
      return mesh.on_midplane[v] ? v : v + static_cast<std::uint32_t>(n);
    };
    triangles.emplace_back(other(t.x), other(t.z), other(t.y));
  }
  const dvec3 size = box.size();
  const VoxelSolid solid = voxelise(positions, triangles, std::max({size.x, size.y, size.z}) / weight_cells);
  Seeds seeds(solid.places.size() * joints);
  parallel_for(solid.places.size(), 64, [&](std::size_t i) {
    const Influencing f = field.influences(solid.centre(i));
    for (std::size_t j = 0; j < joints; ++j) seeds[i * joints + j] = static_cast<float>(f.joint_weights[j]);
  });
  std::vector<double> weights = diffuse_weights(solid, seeds, static_cast<int>(joints), mesh.positions);
  std::vector<double> next(n * joints);
  const std::vector<std::vector<std::uint32_t>> near = vertex_neighbours(n, mesh.triangles);
  constexpr int rounds = 3;
  for (int round = 0; round <= rounds; ++round) {
    parallel_for(n, 64, [&](std::size_t i) {
      double* to = &next[i * joints];
      std::fill(to, to + joints, 0.0);
      double total = 0;
      for (const std::uint32_t v : near[i]) {
        const double* from = &weights[v * joints];
        const bool reflect = mesh.on_midplane[i] && !mesh.on_midplane[v];  // its mirror image is a neighbour too
        for (std::size_t j = 0; j < joints; ++j) to[j] += reflect ? from[j] + from[twin[j]] : from[j];
        total += reflect ? 2 : 1;
      }
      const double* own = &weights[i * joints];
      const double keep = round < rounds ? 0.5 : 1;  // the last round only makes the midplane symmetric
      for (std::size_t j = 0; j < joints; ++j) to[j] = keep * own[j] + (1 - keep) * to[j] / total;
      if (mesh.on_midplane[i])
        for (std::size_t j = 0; j < joints; ++j)
          if (static_cast<std::size_t>(twin[j]) > j) to[j] = to[twin[j]] = 0.5 * (to[j] + to[twin[j]]);
    });
    weights.swap(next);
  }
  return weights;
}

}  // namespace

Rig build_quadruped(const QuadrupedSpec& spec) {
  Rig rig;
  rig.source = spec.source;
  check_numbers(spec);
  const std::vector<QuadrupedJoint> joints = ordered_joints(spec);
  add_joints(joints, rig);
  std::vector<std::string> names;
  for (const Node& node : rig.nodes) names.push_back(node.name);
  std::vector<int> twin;
  for (std::size_t j = 0; j < names.size(); ++j) {
    const int other = rig.find_node(mirror_name(names[j]));
    twin.push_back(other >= 0 ? other : static_cast<int>(j));
  }

  const Field field = build_field(spec, names, rig.part_names);
  HalfMesh half = polygonise(field, spec.grid);
  keep_one_body(spec, field, half);
  remesh(half, field, spec.target_edge, 8);
  check_joints_inside(spec, joints, field, half);
  const std::vector<double> weights = skin_weights(half, field, twin);

  const std::size_t half_triangles = half.triangles.size();
  const std::vector<vec3> normals = vertex_normals(half);
  std::vector<std::uint16_t> parts(half_triangles);
  parallel_for(half_triangles, 64, [&](std::size_t t) {
    const uvec3& v = half.triangles[t];
    parts[t] = static_cast<std::uint16_t>(
        field.influences((half.positions[v.x] + half.positions[v.y] + half.positions[v.z]) / 3.0).part);
  });
  std::vector<std::uint16_t> part_twin;
  for (std::size_t i = 0; i < rig.part_names.size(); ++i) {
    const auto found = std::find(rig.part_names.begin(), rig.part_names.end(), mirror_name(rig.part_names[i]));
    part_twin.push_back(static_cast<std::uint16_t>(found != rig.part_names.end() ? found - rig.part_names.begin() : i));
  }

  std::vector<Chart> charts = cut_charts(half.positions, half.triangles);
  const std::size_t left_charts = charts.size();
  for (std::size_t c = 0; c < left_charts; ++c) {
    charts.push_back(charts[c]);
    for (dvec2& p : charts.back().flat) p.x = -p.x;
  }
  pack_charts(charts, half.triangles, spec.gutter);

  // Vertices chart by chart: a vertex on a seam occurs once in every chart that touches it.
  Surface& s = rig.surface;
  for (std::size_t c = 0; c < charts.size(); ++c) {
    const Chart& chart = charts[c];
    const bool right = c >= left_charts;
    const std::uint32_t first = static_cast<std::uint32_t>(s.rest.size());
    for (std::size_t k = 0; k < chart.vertices.size(); ++k) {
      const std::uint32_t v = chart.vertices[k];
      const vec3 flip(1, right ? -1 : 1, 1);
      s.rest.push_back(vec3(half.positions[v]) * flip);
      if (half.on_midplane[v]) s.rest.back().y = 0;  // not minus zero: both sides weld bit for bit
      s.normals.push_back(normals[v] * flip);
      s.uvs.emplace_back(static_cast<float>(chart.flat[k].x),
                         static_cast<float>(1 - chart.flat[k].y));  // (0, 0) is top left
      rig.influence_begin.push_back(static_cast<std::uint32_t>(rig.influences.size()));
      for (Influence i : strongest_influences(&weights[v * names.size()], names.size())) {
        if (right) i.bone = static_cast<std::uint32_t>(twin[i.bone]);
        rig.influences.push_back(i);
      }
    }
    for (const std::uint32_t t : chart.triangles) {
      uvec3 local;
      for (int k = 0; k < 3; ++k)
        local[k] = first + static_cast<std::uint32_t>(
                               std::lower_bound(chart.vertices.begin(), chart.vertices.end(), half.triangles[t][k]) -
                               chart.vertices.begin());
      if (right) std::swap(local.y, local.z);
      s.triangles.push_back(local);
      s.parts.push_back(right ? part_twin[parts[t]] : parts[t]);
      s.materials.push_back(0);
    }
  }
  rig.influence_begin.push_back(static_cast<std::uint32_t>(rig.influences.size()));
  check_surface(spec, field, rig);

  MeshPart mesh;
  mesh.name = "body";
  mesh.vertex_count = static_cast<std::uint32_t>(s.rest.size());
  mesh.triangle_count = static_cast<std::uint32_t>(s.triangles.size());
  mesh.skinned = true;
  rig.meshes.push_back(mesh);
  RigMaterial material;
  material.name = "skin";
  rig.materials.push_back(material);
  scale_rig(rig, spec.scale);
  return rig;
}

}  // namespace moomill
