// What the chosen modalities do not need is neither loaded, built nor traced; every modality gets its map.
#include "scenes/runner.h"

#include <doctest/doctest.h>

#include "generator/render/camera.h"
#include "tests/temporary_file.h"

using namespace moomill;

namespace {

SceneSpec small_scene(const std::vector<std::string>& modalities, const std::vector<int>& coats = {0}) {
  SceneSpec scene = read_scene(data_root() / "scenes/quick.toml");
  Overrides o;
  o.modalities = modalities;
  o.coats = coats;
  o.resolution = {64, 48};
  o.samples = 2;
  o.cameras = {2};
  apply_overrides(scene, o);
  scene.render.coat_resolution = 64;
  return scene;
}

View view_of(const Mill& mill, int frame = 1) {
  const Frame f = mill.prepare(frame);
  return mill.trace(f, f.cameras.at(0));
}

}  // namespace

TEST_CASE("labels alone load no coat, no light, and trace no path") {
  const Mill mill(small_scene({"silhouette", "depth"}));
  view_of(mill);
  const StageCounts& c = mill.counts();
  CHECK(c.first_hits == 1);
  CHECK(c.hierarchies == 1);
  CHECK(c.coats == 0);
  CHECK(c.finishes == 0);
  CHECK(c.images == 0);
  CHECK(c.environments == 0);
  CHECK(c.radiance == 0);
  CHECK(c.coverage == 0);
  CHECK(c.keypoints == 0);
  CHECK(c.occlusion == 0);
}

TEST_CASE("colour alone traces no labels and bakes only the coats asked for") {
  const Mill mill(small_scene({"rgb"}, {0, 11}));
  const View view = view_of(mill);
  const StageCounts& c = mill.counts();
  CHECK(c.coats == 2);
  CHECK(c.finishes == 1);
  CHECK(c.radiance == 1);
  CHECK(c.first_hits == 0);
  CHECK(c.keypoints == 0);
  CHECK(view.maps.size() == 2);
  CHECK(view.find(Modality::rgb, 11) != nullptr);
}

TEST_CASE("keypoints alone trace a ray each and no image") {
  const Mill mill(small_scene({"keypoints"}));
  const View view = view_of(mill);
  CHECK(mill.counts().first_hits == 0);
  CHECK(mill.counts().radiance == 0);
  CHECK(mill.counts().keypoints == 1);
  CHECK(view.maps.empty());
  REQUIRE(view.keypoints.size() == 1);
  CHECK(view.keypoints[0].size() == 25);
}

TEST_CASE("frames of one pose share their skin and hierarchy") {
  SceneSpec scene = small_scene({"depth"});
  scene.animals[0].poses = {ClipFrames{"idle", 1}};
  const Mill mill(scene);
  view_of(mill, 1);
  view_of(mill, 2);
  CHECK(mill.counts().skins == 1);
  CHECK(mill.counts().hierarchies == 1);
  CHECK(view_of(mill, 1).find(Modality::depth)->f.data == view_of(mill, 2).find(Modality::depth)->f.data);
}

TEST_CASE("every row of the modality table becomes its maps, empty where no animal is") {
  const Mill mill(small_scene({"all"}));
  const View view = view_of(mill);
  for (const ModalityRow& r : modality_table()) {
    INFO(r.name);
    if (r.storage == Storage::record) continue;
    const Map* map = view.find(r.id, r.per_coat ? 0 : -1, r.id == Modality::occlusion ? 0 : -1);
    REQUIRE(map != nullptr);
    const Map* silhouette = view.find(Modality::silhouette);
    std::size_t inside = 0;
    for (std::size_t p = 0; p < silhouette->u.data.size(); ++p) {
      const bool on = silhouette->u.data[p] != 0;
      inside += on;
      if (r.id == Modality::rgb || r.id == Modality::coverage) continue;  // these are filtered
      if (!map->u.empty()) CHECK((map->u.data[p] != 0) == on);
      if (!map->f.empty() && !on && r.id != Modality::triangle)
        CHECK(map->f.data[p * map->f.channels] == static_cast<float>(r.background));
    }
    CHECK(inside > 100);
  }
}

TEST_CASE("NNOPCS of a triangle and barycentrics is the same in every pose") {
  const Mill mill(small_scene({"nnopcs", "triangle"}));
  const Surface& s = mill.species(0).rig.surface;
  for (int frame : {1, 2, 3, 4}) {
    const View view = view_of(mill, frame);
    const Map *n = view.find(Modality::nnopcs), *t = view.find(Modality::triangle);
    double worst = 0;
    std::size_t compared = 0;
    for (std::size_t p = 0; p < t->u.data.size(); ++p) {
      if (t->u.data[p] == 0) continue;
      const uvec3 tri = s.triangles[t->u.data[p] - 1];
      const double u = t->f.data[2 * p], v = t->f.data[2 * p + 1];
      const dvec3 expected = (1 - u - v) * dvec3(s.nnopcs[tri[0]]) + u * dvec3(s.nnopcs[tri[1]]) + v * dvec3(s.nnopcs[tri[2]]);
      for (int k = 0; k < 3; ++k) worst = std::max(worst, std::abs(n->f.data[3 * p + k] - expected[k]));
      ++compared;
    }
    CHECK(compared > 100);
    CHECK(worst < 1e-7);
  }
}

TEST_CASE("a camera inside the animal is refused in one sentence") {
  SceneSpec scene = small_scene({"depth"});
  scene.cameras.rings.reset();
  scene.cameras.only.clear();
  ListedCamera inside;
  inside.id = 0;
  inside.position = constant_vector({0, 0, 1.1});
  scene.cameras.list = {inside};
  const Mill mill(scene);
  CHECK_THROWS_WITH_AS(view_of(mill), doctest::Contains("camera 0 stands inside an animal in frame 1"), InputError);
}

TEST_CASE("an animal far from the world's origin gets the labels it has at the origin") {
  SceneSpec near = small_scene({"nnopcs"}), far = small_scene({"nnopcs"});
  const dvec3 away(4096, -8192, 0);  // exact in float, so that even the last bits may agree
  far.animals[0].position = constant_vector(away);
  far.cameras.target = constant_vector(away + draw_vector(near.cameras.target, 0, 1, 2));
  const Mill a(near), b(far);
  const View va = view_of(a), vb = view_of(b);
  const auto &na = va.find(Modality::nnopcs)->f.data, &nb = vb.find(Modality::nnopcs)->f.data;
  std::size_t differ = 0;
  for (std::size_t i = 0; i < na.size(); ++i) differ += std::abs(na[i] - nb[i]) > 1e-4;
  CHECK(differ <= na.size() / 1000);
}

TEST_CASE("a pose that tears or flattens the animal is refused, not rendered empty") {
  for (const char* pose : {R"([{"root": {"translation": [1e300, 0, 0]}}])", R"([{"root": {"scale": [0, 0, 0]}}])"}) {
    SceneSpec scene = small_scene({"silhouette"});
    scene.animals[0].poses = {PoseFile{"torn.json", std::make_shared<const Json>(Json::parse(pose))}};
    const Mill mill(scene);
    CHECK_THROWS_AS(mill.prepare(1), InputError);
  }
}
