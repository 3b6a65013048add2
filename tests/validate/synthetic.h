#pragma once
// A tiny dataset with the truth worked out here by brute force: a box of two bones, seen by a ring of eight cameras.
// Nothing of the renderer is used, so that validation and renderer cannot be wrong together.
#include "generator/dataset/json.h"
#include "rigs/rig.h"
#include "tests/dataset/helpers.h"
#include "validate/checks.h"

namespace moomill::test {

struct SyntheticOptions {
  int frames = 2;
  bool triangles = true;  // write the triangle modality
  bool dual_quaternion = false;
  bool half_pixel_slip = false;  // trace through pixel corners, as a careless renderer would
};

inline constexpr int synthetic_width = 160, synthetic_height = 120;

inline Rig box_rig() {
  Rig rig;
  rig.source = "box";
  rig.nodes = {{.name = "root"}, {.name = "head", .parent = 0}};
  rig.bones = {{0, dmat4(1.0)}, {1, dmat4(1.0)}};
  // A box of 0.5 x 0.25 x 0.3 m in three slices along x; the last slice follows the second bone.
  const auto add = [&](vec3 p, vec3 n) {
    rig.surface.rest.push_back(p);
    rig.surface.normals.push_back(n);
    rig.influence_begin.push_back(static_cast<std::uint32_t>(rig.influences.size()));
    const float w = std::clamp((p.x + 0.05f) / 0.2f, 0.0f, 1.0f);
    if (w < 1) rig.influences.push_back({0, 1 - w});
    if (w > 0) rig.influences.push_back({1, w});
  };
  const auto quad = [&](vec3 a, vec3 b, vec3 c, vec3 d) {
    const auto first = static_cast<std::uint32_t>(rig.surface.rest.size());
    const vec3 n = glm::normalize(glm::cross(b - a, d - a));
    for (const vec3& p : {a, b, c, d}) add(p, n);
    rig.surface.triangles.push_back({first, first + 1, first + 2});
    rig.surface.triangles.push_back({first, first + 2, first + 3});
  };
  const float xs[] = {-0.25f, -0.05f, 0.1f, 0.25f}, y = 0.125f, z = 0.15f;
  for (int i = 0; i < 3; ++i) {
    const float a = xs[i], b = xs[i + 1];
    quad({a, -y, -z}, {b, -y, -z}, {b, -y, z}, {a, -y, z});
    quad({b, y, -z}, {a, y, -z}, {a, y, z}, {b, y, z});
    quad({a, -y, z}, {b, -y, z}, {b, y, z}, {a, y, z});
    quad({a, y, -z}, {b, y, -z}, {b, -y, -z}, {a, -y, -z});
  }
  quad({-0.25f, y, -z}, {-0.25f, -y, -z}, {-0.25f, -y, z}, {-0.25f, y, z});
  quad({0.25f, -y, -z}, {0.25f, y, -z}, {0.25f, y, z}, {0.25f, -y, z});
  rig.influence_begin.push_back(static_cast<std::uint32_t>(rig.influences.size()));
  rig.surface.materials.assign(rig.surface.triangles.size(), 0);
  rig.materials.resize(1);
  rig.meshes = {{.name = "box",
                 .first_vertex = 0,
                 .vertex_count = static_cast<std::uint32_t>(rig.surface.rest.size()),
                 .first_triangle = 0,
                 .triangle_count = static_cast<std::uint32_t>(rig.surface.triangles.size()),
                 .skinned = true,
                 .node = -1}};
  finish_rig(rig);
  return rig;
}

struct Hit {
  double t = std::numeric_limits<double>::infinity(), u = 0, v = 0;
  int triangle = -1;
};

// Moeller and Trumbore, in double, against every triangle.
inline Hit trace(const std::vector<dvec3>& vertices, const std::vector<uvec3>& triangles, const dvec3& o,
                 const dvec3& d) {
  Hit best;
  for (std::size_t i = 0; i < triangles.size(); ++i) {
    const dvec3 a = vertices[triangles[i][0]], e1 = vertices[triangles[i][1]] - a, e2 = vertices[triangles[i][2]] - a;
    const dvec3 p = glm::cross(d, e2);
    const double det = glm::dot(e1, p);
    if (std::abs(det) < 1e-15) continue;
    const dvec3 s = (o - a) / det, q = glm::cross(s, e1);
    const double u = glm::dot(s, p), v = glm::dot(d, q), t = glm::dot(e2, q);
    if (u >= 0 && v >= 0 && u + v <= 1 && t > 0 && t < best.t) best = {t, u, v, static_cast<int>(i)};
  }
  return best;
}

// Looks at the origin from `centre`, without roll.
inline CameraRecord looking_at_origin(int id, const dvec3& centre) {
  CameraRecord c;
  c.id = id;
  c.centre = centre;
  c.width = synthetic_width;
  c.height = synthetic_height;
  c.euler_xyz = {std::atan2(std::hypot(centre.x, centre.y), centre.z), 0, std::atan2(centre.x, -centre.y)};
  const dvec3 forward = -glm::normalize(centre), right = glm::normalize(glm::cross(forward, dvec3(0, 0, 1))),
              down = glm::cross(forward, right);
  const dvec3 rows[3] = {right, down, forward};
  for (int r = 0; r < 3; ++r) {
    for (int k = 0; k < 3; ++k) c.world_to_camera[4 * r + k] = rows[r][k];
    c.world_to_camera[4 * r + 3] = -glm::dot(rows[r], centre);
  }
  c.fx = c.fy = c.focal_mm * c.width / c.sensor_mm;
  c.cx = 0.5 * c.width;
  c.cy = 0.5 * c.height;
  return c;
}

inline Manifest synthetic_manifest(const Rig& rig, const SyntheticOptions& o) {
  Manifest m;
  m.scene = {{"about", "a box"}};
  for (int f = 1; f <= o.frames; ++f) m.frames.push_back(f);
  for (int k = 0; k < 8; ++k)
    m.cameras.push_back(looking_at_origin(k, {1.9 * std::sin(k * pi / 4), -1.9 * std::cos(k * pi / 4), 0.7}));
  m.coats = {"white"};
  m.coat_indices = {0};
  m.animals = {"cow"};
  m.keypoint_names = {"corner", "centre", "front"};
  m.skeleton = {{0, 1}, {1, 2}};
  m.keypoint_tolerance = {0.02, 0.02, 0.02};
  m.part_names = rig.part_names;
  for (const ModalityRow& r : modality_table())
    if ((r.id != Modality::triangle || o.triangles) && r.id != Modality::uv && r.id != Modality::coverage)
      m.modalities.add(r.id);
  Box box;
  for (const vec3& p : rig.surface.rest) box.add(dvec3(p));
  m.nnopcs_lower = box.lower;
  m.nnopcs_upper = box.upper;
  m.rig_files = {"rigs/cow.glb"};
  m.skinning = o.dual_quaternion ? "dual_quaternion" : "linear_blend";
  return m;
}

inline void write_synthetic(const fs::path& folder, const SyntheticOptions& o = {}) {
  TemporaryFolder scratch;
  write_glb(box_rig(), scratch / "box.glb");
  const Rig rig = load_rig(scratch / "box.glb");
  const Manifest m = synthetic_manifest(rig, o);
  DatasetWriter writer(folder, m, 1);
  writer.write_rig(0, scratch / "box.glb");
  for (int frame : m.frames) {
    const double turn = 0.3 * frame, bend = 0.25 * frame;
    dmat4 root(1.0), head(1.0);
    root[0] = {std::cos(turn), std::sin(turn), 0, 0};
    root[1] = {-std::sin(turn), std::cos(turn), 0, 0};
    root[3] = {0.02 * frame, 0.01, -0.03, 1};
    head[0] = {std::cos(bend), 0, -std::sin(bend), 0};
    head[2] = {std::sin(bend), 0, std::cos(bend), 0};
    const std::vector<dmat4> bones = {root, root * head};
    // The only joint turns about Y, so half-way quaternions are half-way angles.
    std::vector<dvec3> posed;
    for (std::size_t v = 0; v < rig.surface.rest.size(); ++v) {
      const dvec3 p(rig.surface.rest[v]);
      double w1 = 0;
      for (std::uint32_t i = rig.influence_begin[v]; i < rig.influence_begin[v + 1]; ++i)
        if (rig.influences[i].bone == 1) w1 = rig.influences[i].weight;
      if (o.dual_quaternion) {
        const double s = w1 * std::sin(bend / 2), c = (1 - w1) + w1 * std::cos(bend / 2), angle = 2 * std::atan2(s, c);
        const dvec3 q(std::cos(angle) * p.x + std::sin(angle) * p.z, p.y,
                      -std::sin(angle) * p.x + std::cos(angle) * p.z);
        posed.push_back(transform_point(root, q));
      } else {
        posed.push_back((1 - w1) * transform_point(bones[0], p) + w1 * transform_point(bones[1], p));
      }
    }
    FrameRecord record;
    record.frame = frame;
    record.keypoints = {
        {posed[0], transform_point(root, dvec3(-0.1, 0, 0)), transform_point(root, dvec3(-0.15, -0.125, 0))}};
    record.bones = {bones};
    record.bone_names = {{"root", "head"}};
    record.placement = {root};
    record.morph_weights = {{}};
    for (const CameraRecord& c : m.cameras) {
      View view;
      view.frame = frame;
      view.camera = c.id;
      view.width = c.width;
      view.height = c.height;
      const auto axis = [&](int r) {
        return dvec3(c.world_to_camera[4 * r], c.world_to_camera[4 * r + 1], c.world_to_camera[4 * r + 2]);
      };
      const auto direction = [&](double x, double y) {
        return (x - c.cx) / c.fx * axis(0) + (y - c.cy) / c.fy * axis(1) + axis(2);
      };
      std::map<Modality, Map> maps;
      for (const ModalityRow& r : modality_table()) {
        if (!m.modalities.has(r.id) || r.storage == Storage::record) continue;
        Map& map = maps[r.id];
        map.modality = r.id;
        if (r.per_coat) map.coat = 0;
        if (r.id == Modality::occlusion) map.animal = 0;
        const bool ids = r.storage == Storage::exr_ids,
                   integers = r.storage == Storage::png8 || r.storage == Storage::png16;
        if (!integers) map.f = ImageF(c.width, c.height, ids ? 2 : r.channels);
        if (integers || ids) map.u = ImageU32(c.width, c.height, 1);
      }
      std::uint64_t count = 0;
      const double centre = o.half_pixel_slip ? 0.0 : 0.5;
      for (int y = 0; y < c.height; ++y)
        for (int x = 0; x < c.width; ++x) {
          const Hit hit = trace(posed, rig.surface.triangles, c.centre, direction(x + centre, y + centre));
          if (hit.triangle < 0) continue;
          ++count;
          const std::size_t i = static_cast<std::size_t>(y) * c.width + x;
          const uvec3 t = rig.surface.triangles[hit.triangle];
          const auto on = [&](const auto& list) {
            return (1 - hit.u - hit.v) * dvec3(list[t[0]]) + hit.u * dvec3(list[t[1]]) + hit.v * dvec3(list[t[2]]);
          };
          const dvec3 nnopcs = (on(rig.surface.rest) - m.nnopcs_lower) / (m.nnopcs_upper - m.nnopcs_lower);
          const dvec3 normal = glm::normalize(glm::cross(posed[t[1]] - posed[t[0]], posed[t[2]] - posed[t[0]]));
          maps[Modality::silhouette].u.data[i] = maps[Modality::occlusion].u.data[i] = 255;
          maps[Modality::depth].f.data[i] = static_cast<float>(hit.t);
          maps[Modality::instance].u.data[i] = 1;
          maps[Modality::part].u.data[i] = 1u + rig.surface.parts[hit.triangle];
          for (int k = 0; k < 3; ++k) {
            maps[Modality::nnopcs].f.data[3 * i + k] = static_cast<float>(std::clamp(nnopcs[k], 0.0, 1.0));
            maps[Modality::normal].f.data[3 * i + k] = static_cast<float>(normal[k]);
            maps[Modality::rgb].f.data[4 * i + k] = static_cast<float>(0.5 + 0.5 * normal[k]);
          }
          maps[Modality::rgb].f.data[4 * i + 3] = 1;
          if (o.triangles) {
            maps[Modality::triangle].u.data[i] = 1u + static_cast<std::uint32_t>(hit.triangle);
            maps[Modality::triangle].f.data[2 * i] = static_cast<float>(hit.u);
            maps[Modality::triangle].f.data[2 * i + 1] = static_cast<float>(hit.v);
          }
        }
      for (auto& [modality, map] : maps) view.maps.push_back(std::move(map));
      view.occlusion = {OcclusionView{count, count, 0, {0}}};
      view.keypoints.resize(1);
      for (const dvec3& p : record.keypoints[0]) {
        KeypointView& k = view.keypoints[0].emplace_back();
        const dvec3 q(glm::dot(axis(0), p - c.centre), glm::dot(axis(1), p - c.centre),
                      glm::dot(axis(2), p - c.centre));
        k.pixel = {c.fx * q.x / q.z + c.cx, c.fy * q.y / q.z + c.cy};
        k.depth = q.z;
        if (k.pixel.x < 0 || k.pixel.y < 0 || k.pixel.x >= c.width || k.pixel.y >= c.height) continue;
        const dvec3 d = direction(k.pixel.x, k.pixel.y);
        const Hit hit = trace(posed, rig.surface.triangles, c.centre, d);
        k.margin = hit.triangle < 0 ? 0 : (q.z - hit.t) * glm::length(d);
        k.visibility = k.margin <= 0.02 ? Visibility::visible : Visibility::hidden;
        k.cause = k.margin <= 0.02 ? HiddenBy::nothing : HiddenBy::self;
      }
      writer.write_view(view);
    }
    writer.finish_frame(record);
  }
  writer.finish();
}

inline const CheckResult& result_of(const std::vector<CheckResult>& results, const std::string& part_of_name) {
  for (const CheckResult& r : results)
    if (r.name.find(part_of_name) != std::string::npos) return r;
  FAIL("no check is called like " << part_of_name);
  return results.front();
}

}  // namespace moomill::test
