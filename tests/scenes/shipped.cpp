// The scene files that ship.
#include <doctest/doctest.h>

#include <cstdlib>

#include "generator/render/camera.h"
#include "scenes/generate.h"

using namespace moomill;
namespace fs = std::filesystem;

namespace {

SceneSpec shipped(const std::string& name) {
  return read_scene(fs::path(MOOMILL_SOURCE_DIR) / "scenes" / name);
}

const Species& cow() {
  static const Species species = read_species("cow", NnopcsNormalization::box, {});
  return species;
}

std::vector<vec3> vertices(const SceneSpec& scene, int frame, std::size_t animal = 0) {
  const Pose pose = pose_of_frame(scene, scene.animals[animal], cow(), frame - scene.first_frame);
  return skin(cow().rig, bone_matrices(cow().rig, world_transforms(cow().rig, pose)), pose.morph_weights,
              cow().skinning, dvec3(0))
      .positions;
}

Box bounds(const SceneSpec& scene, int frame, std::size_t animal = 0) {
  Box box;
  for (const vec3& p : vertices(scene, frame, animal)) box.add(dvec3(p));
  return box;
}

}  // namespace

TEST_CASE("every shipped scene file reads and can be planned") {
  int count = 0;
  for (const fs::directory_entry& e : fs::directory_iterator(fs::path(MOOMILL_SOURCE_DIR) / "scenes")) {
    if (e.path().extension() != ".toml") continue;
    INFO(e.path().string());
    const SceneSpec scene = read_scene(e.path());
    CHECK(plan(scene).json["views"] > 0);
    ++count;
  }
  CHECK(count >= 4);
}

TEST_CASE("the main set has 910 poses, 24 cameras and twelve coats: 262,080 views") {
  const SceneSpec s = shipped("nepumoo.toml");
  CHECK(plan(s).json["views"] == 262080);
  CHECK(s.frames.size() == 910);
  CHECK(s.frames.front() == 1);
  CHECK(s.animals[0].coats.size() == 12);
  CHECK(s.animals[0].coats == shipped_coats("cow"));
  CHECK(s.cameras.width == 1024);
  CHECK(s.render.samples == 64);
}

TEST_CASE("the occlusion and novel-view sets have the animal of the main set") {
  const SceneSpec main = shipped("nepumoo.toml"), hidden = shipped("occlusion.toml"),
                  novel = shipped("novel_views.toml");
  for (const SceneSpec* s : {&hidden, &novel}) {
    CHECK(s->seed == main.seed);
    CHECK(s->animals[0].coats == main.animals[0].coats);
    CHECK(s->resolved["animals"][0] == main.resolved["animals"][0]);
  }
  CHECK(hidden.frames.size() == 50);
  CHECK(hidden.coat_indices == std::vector<int>{11});
  const std::vector<CameraRecord> all = cameras_of_frame(main, 1), two = cameras_of_frame(hidden, 1);
  REQUIRE(two.size() == 2);
  CHECK(two[0].world_to_camera == all[2].world_to_camera);
  CHECK(two[1].world_to_camera == all[6].world_to_camera);
  std::vector<int> ids;
  for (const CameraRecord& c : cameras_of_frame(novel, 1)) {
    ids.push_back(c.id);
    for (const CameraRecord& other : all) CHECK(glm::length(c.centre - other.centre) > 1);
  }
  CHECK(ids == std::vector<int>{1, 3, 6, 10, 12, 13, 15, 19, 20, 22});
  CHECK(novel.frames.front() == 1);
  CHECK(novel.frames[1] == 91);
  CHECK(novel.frames.back() == 901);
}

TEST_CASE("what the networks learn from: 89,280 views, and novel views of poses they are not trained on") {
  const SceneSpec main = shipped("netepu.toml"), novel = shipped("netepu_novel.toml");
  CHECK(plan(main).json["views"] == 89280);
  CHECK(plan(novel).json["views"] == 14 * 10 * 12);
  CHECK(novel.seed == main.seed);
  CHECK(novel.resolved["animals"][0] == main.resolved["animals"][0]);
  CHECK(novel.resolved["light"] == main.resolved["light"]);
  const std::vector<int> test = make_splits(main.frames).test;
  for (const int frame : novel.frames) {
    CAPTURE(frame);
    CHECK(std::find(test.begin(), test.end(), frame) != test.end());
  }
  for (const CameraRecord& c : cameras_of_frame(novel, 1))
    for (const CameraRecord& other : cameras_of_frame(main, 1)) CHECK(glm::length(c.centre - other.centre) > 1);
}

TEST_CASE("the default cameras and the further ones frame every pose of the main set") {
  const SceneSpec main = shipped("nepumoo.toml"), novel = shipped("novel_views.toml");
  std::vector<CameraRecord> cameras = cameras_of_frame(main, 1);
  for (const CameraRecord& c : cameras_of_frame(novel, 1)) cameras.push_back(c);
  double slack = 1e9;
  for (std::size_t i = 0; i < main.frames.size(); i += 9) {
    const std::vector<vec3> positions = vertices(main, main.frames[i]);
    for (const CameraRecord& c : cameras) {
      const Camera camera = Camera::from_matrix(c.world_to_camera, c.fx, c.fy, c.cx, c.cy, c.width, c.height);
      for (const vec3& v : positions) {
        const dvec2 p = camera.project(camera.to_camera(dvec3(v)));
        slack = std::min({slack, p.x, p.y, c.width - p.x, c.height - p.y});
      }
    }
  }
  MESSAGE("least distance of the cow from the image border: ", slack, " px");
  CHECK(slack > 0);
}

TEST_CASE("the other cows stand clear of the one in question, and before it for either camera") {
  const SceneSpec s = shipped("occlusion.toml");
  for (const int frame : {1, 17, 33, 50}) {
    const Box cow_box = bounds(s, frame, 0), left = bounds(s, frame, 1), right = bounds(s, frame, 2);
    CHECK(left.lower.y > cow_box.upper.y);
    CHECK(right.upper.y < cow_box.lower.y);
    CHECK(left.lower.x < cow_box.upper.x - 0.5);
    CHECK(left.lower.x > cow_box.lower.x + 0.3);
    CHECK(right.upper.x > cow_box.lower.x + 0.5);
    CHECK(right.upper.x < cow_box.upper.x - 0.3);
  }
}
