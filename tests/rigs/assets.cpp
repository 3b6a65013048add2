// Rigs made by others: load, pose, and compare. The folder is not part of the project; without it these pass by.
#include <doctest/doctest.h>

#include <algorithm>

#include "generator/core/error.h"
#include "rigs/pose.h"
#include "tests/rigs/fixtures.h"

using namespace moomill;
namespace fs = std::filesystem;

namespace {

PosedSurface posed_at_rest(const Rig& rig, SkinningMethod method = SkinningMethod::linear_blend) {
  return skin(rig, bone_matrices(rig, world_transforms(rig, rest_pose(rig))), {}, method, dvec3(0));
}

Box bounds(const std::vector<vec3>& points) {
  Box box;
  for (const vec3& p : points) box.add(dvec3(p));
  return box;
}

}  // namespace

TEST_CASE("Rigs of others load, and skinning their rest pose gives their rest positions") {
  for (const char* folder : {"rigged", "static"})
    for (const fs::path& file : assets(folder)) {
      CAPTURE(file.string());
      const Rig rig = load_rig(file);
      const Box box = bounds(rig.surface.rest);
      CHECK(rig.surface.triangles.size() > 100);
      for (const auto method : {SkinningMethod::linear_blend, SkinningMethod::dual_quaternion}) {
        const PosedSurface posed = posed_at_rest(rig, method);
        double worst = 0;
        for (std::size_t i = 0; i < posed.positions.size(); ++i)
          worst = std::max<double>(worst, glm::length(posed.positions[i] - rig.surface.rest[i]));
        MESSAGE(file.filename().string(), ": ", rig.nodes.size(), " nodes, ", rig.bones.size(), " bones, ",
                rig.clips.size(), " clips, ", rig.surface.rest.size(), " vertices, ", rig.surface.triangles.size(),
                " triangles, size ", box.size().x, " ", box.size().y, " ", box.size().z, ", lower z ", box.lower.z,
                ", rest error ", worst);
        for (const std::string& w : rig.warnings) MESSAGE("  ", w);
        CHECK(worst <= 1e-5 * box.diagonal());
      }
    }
}

TEST_CASE("The same sheep from FBX and from glTF has the same rest pose") {
  const auto files = assets("rigged");
  if (files.empty()) return;
  const fs::path folder = files.front().parent_path();
  const fs::path one = folder.filename() == "rigged" ? folder : folder.parent_path();
  const Rig fbx = load_rig(one / "quaternius_2018_sheep.fbx");
  const Rig gltf = load_rig(one / "quaternius_2018_sheep_gltf" / "Sheep.gltf");
  const auto distance = [](const std::vector<vec3>& from, const std::vector<vec3>& to) {
    double worst = 0;
    for (const vec3& p : from) {
      double nearest = 1e30;
      for (const vec3& q : to) nearest = std::min<double>(nearest, glm::length(dvec3(p) - dvec3(q)));
      worst = std::max(worst, nearest);
    }
    return worst;
  };
  const double size = bounds(gltf.surface.rest).diagonal();
  const double there = distance(fbx.surface.rest, gltf.surface.rest) / size;
  const double back = distance(gltf.surface.rest, fbx.surface.rest) / size;
  MESSAGE("sheep, FBX to glTF ", there, ", glTF to FBX ", back, " of its size (", size, " m), ",
          fbx.surface.rest.size(), " and ", gltf.surface.rest.size(), " vertices");
  CHECK(fbx.surface.triangles.size() == gltf.surface.triangles.size());
  CHECK(there < 1e-4);
  CHECK(back < 1e-4);
}

TEST_CASE("The same sheep moves alike in both formats, and no clip of any rig tears it apart") {
  const auto files = assets("rigged");
  if (files.empty()) return;
  std::vector<std::pair<std::string, std::vector<PosedSurface>>> sheep;
  for (const fs::path& file : files) {
    CAPTURE(file.string());
    const Rig rig = load_rig(file);
    const double size = bounds(rig.surface.rest).diagonal();
    for (const Clip& clip : rig.clips) {
      std::vector<PosedSurface> frames;
      for (const double part : {0.0, 0.37, 0.81}) {
        const auto world = world_transforms(rig, sample_clip(rig, clip, part * clip.duration));
        frames.push_back(skin(rig, bone_matrices(rig, world), {}, SkinningMethod::linear_blend, dvec3(0)));
        const Box box = bounds(frames.back().positions);
        CHECK(box.diagonal() > 0.5 * size);
        CHECK(box.diagonal() < 2 * size);
      }
      if (file.string().find("sheep") != std::string::npos && clip.name.find("Idle") != std::string::npos)
        sheep.emplace_back(clip.name, std::move(frames));
    }
  }
  REQUIRE(sheep.size() == 2);
  for (std::size_t frame = 0; frame < 3; ++frame) {
    double worst = 0;
    for (const vec3& p : sheep[0].second[frame].positions) {
      double nearest = 1e30;
      for (const vec3& q : sheep[1].second[frame].positions)
        nearest = std::min<double>(nearest, glm::length(dvec3(p) - dvec3(q)));
      worst = std::max(worst, nearest);
    }
    MESSAGE(sheep[0].first, " and ", sheep[1].first, ", frame ", frame, ": nearest vertices within ", worst, " m");
    CHECK(worst < 0.02);  // of 7.7 m; the FBX has its rotations as baked Euler angles
  }
}
