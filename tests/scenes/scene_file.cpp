#include <doctest/doctest.h>

#include <cstdlib>

#include "scenes/scene.h"
#include "tests/temporary_file.h"

using namespace moomill;
using namespace moomill::test;
namespace fs = std::filesystem;

namespace {

// A folder with a rig beside the scene; read_scene() wants the files to be there but does not open rigs.
struct SceneFolder : TemporaryFile {
  explicit SceneFolder(const std::string& scene) : TemporaryFile("a.toml", scene) {
    std::ofstream(folder() / "rig.glb") << "glTF";
    std::ofstream(folder() / "coat.png") << "png";
    std::ofstream(folder() / "one.exr") << "exr";
    std::ofstream(folder() / "two.exr") << "exr";
  }
  // What read_scene() says, without the folder.
  std::string message() const {
    std::string m = message_of([&] { read_scene(path); });
    for (std::size_t at; (at = m.find(folder().string() + "/")) != std::string::npos;)
      m.erase(at, folder().string().size() + 1);
    return m;
  }
};

const std::string animal = "[[animals]]\nspecies = \"rig.glb\"\n";  // two lines

std::string refused(const std::string& more) {
  return SceneFolder(animal + more).message();
}

}  // namespace

TEST_CASE("two lines are a scene") {
  const SceneFolder file(animal);
  const SceneSpec s = read_scene(file.path);
  CHECK(s.animals.size() == 1);
  CHECK(s.animals[0].coats == std::vector<std::string>{"own"});
  CHECK(s.frames.size() == 10);
  CHECK(s.frames.front() == 1);
  CHECK(s.coat_indices == std::vector<int>{0});
  CHECK(s.modalities.has(Modality::rgb));
  CHECK(s.modalities.has(Modality::keypoints));
  CHECK_FALSE(s.modalities.has(Modality::triangle));
  CHECK(s.light.suns.size() == 1);
  CHECK(cameras_of_frame(s, 1).size() == 24);
  CHECK_FALSE(cameras_vary(s));
  CHECK(s.resolved["cameras"]["resolution"] == Json{1024, 768});
  CHECK_FALSE(contains(s.resolved.dump(), file.folder().string()));
}

TEST_CASE("every key is read") {
  const SceneFolder file(R"(
seed = 42
subset = "novel_views"
modalities = ["depth", "triangle"]
only_coats = [1]
[frames]
number_from = 0
first = 10
count = 3
every = 20
[[animals]]
species = "rig.glb"
coats = ["own", "coat.png"]
poses = [{clip = "walk", count = 40}, {random = 60, spread = 0.5}]
position = [1, 2, 0]
yaw_deg = {uniform = [-10, 10]}
pose_in_place = false
[[animals]]
species = "rig.glb"
poses = [{clip = "walk", count = 1}]
[cameras]
focal_mm = {log_uniform = [50, 200], per = "view"}
sensor_mm = 24
resolution = [640, 480]
only = [7, 3]
[[cameras.list]]
id = 3
position = [10, 0, 2]
[[cameras.list]]
id = 7
position = {normal = [[0, 10, 2], 0.1]}
target = [0, 0, 1]
[light]
environment_file = {choose = ["one.exr", "two.exr"], per = "view"}
environment_strength = 2
environment_yaw_deg = {uniform = [0, 360]}
[[light.suns]]
azimuth_deg = 10
elevation_deg = {normal = [45, 20]}
irradiance = 3
color = [1, 0.5, 0.25]
angular_diameter_deg = 1
[[light.rectangles]]
position = [1, 2, 3]
target = [0, 0, 0]
radiance = 4
color = 0.5
width = 2
height = 3
[background]
kind = "image"
image = "coat.png"
color = 0.25
[ground]
color = [0.1, 0.2, 0.3]
roughness = 0.5
size = 10
[render]
samples = 8
max_bounces = 2
filter_radius = 1
coat_resolution = 256
[nnopcs]
normalization = "diagonal"
)");
  REQUIRE(file.message() == "(no error)");
  const SceneSpec s = read_scene(file.path);
  CHECK(s.seed == 42);
  CHECK(s.subset == Subset::novel_views);
  CHECK(s.frames == std::vector<int>{10, 30, 50});
  CHECK(s.first_frame == 0);
  CHECK(s.coat_indices == std::vector<int>{1});
  CHECK(s.animals[0].poses.size() == 2);
  CHECK(std::get<PoseSampler>(s.animals[0].poses[1]).spread == 0.5);
  CHECK_FALSE(s.animals[0].pose_in_place);
  CHECK(draw_vector(s.animals[0].position, s.seed, 10, 0) == dvec3(1, 2, 0));
  CHECK(s.cameras.only == std::vector<int>{3, 7});
  CHECK(cameras_vary(s));
  CHECK(cameras_of_frame(s, 10).size() == 2);
  CHECK(s.light.suns.size() == 1);
  CHECK(s.light.suns[0].elevation_deg.values.size() == 4);  // clamped to [-90, 90]
  CHECK(s.light.suns[0].elevation_deg.key == "light.suns[0].elevation_deg");
  CHECK(s.light.environment_file->per_view);
  CHECK(s.background.kind == BackgroundSpec::Kind::image);
  CHECK(draw_vector(s.background.color, 0, 0, 0) == dvec3(0.25));
  CHECK(s.ground.present);
  CHECK(s.render.samples == 8);
  CHECK(s.normalization == NnopcsNormalization::diagonal);
  CHECK(s.resolved["light"]["environment_file"]["choose"][1] == "two.exr");
  CHECK(s.resolved["frames"] == Json{{"number_from", 0}, {"first", 10}, {"every", 20}, {"count", 3}});
  const Json drawn = drawn_values(s, 10, {3, 7});
  CHECK(drawn["cameras.focal_mm"].size() == 2);
  CHECK(drawn["cameras.list[1].position"].size() == 3);
  CHECK(drawn["light.environment_file"].size() == 2);
}

TEST_CASE("what a scene cannot mean is refused with line and mend") {
  CHECK(refused("seeed = 1\n") ==
        "a.toml:3: unknown key 'seeed' in [animals[0]]; known are coats, pose_in_place, poses, "
        "position, species, yaw_deg");
  CHECK(refused("[rendr]\n") == "a.toml:3: unknown key 'rendr'; did you mean 'render'?");
  CHECK(refused("[cameras]\nresolution = [0, 0]\n") ==
        "a.toml:4: 'resolution' in [cameras] must be [width, height], whole numbers from 1 to 16384, e.g. [1024, 768], "
        "not [0, 0]");
  CHECK(contains(refused("[cameras]\nresolution = [16385, 10]\n"), "a.toml:4: 'resolution'"));
  CHECK(contains(refused("[cameras]\nresolution = [10.5, 10]\n"), "not [10.5, 10]"));
  CHECK(contains(SceneFolder("modalities = [\"rbg\"]\n" + animal).message(),
                 "a.toml:1: there is no modality 'rbg' (did you mean 'rgb'?); the modalities are rgb, silhouette,"));
  CHECK(contains(SceneFolder("modalities = []\n" + animal).message(), "must name at least one"));
  CHECK(
      contains(SceneFolder("seed = -1\n" + animal).message(), "a.toml:1: 'seed' must be a whole number of at least 0"));
  CHECK(contains(SceneFolder("seed = 1\n").message(), "a.toml:1: 'animals' is missing; add e.g. [[animals]]"));
  CHECK(
      contains(SceneFolder("[[animals]]\nspecies = \"gone.glb\"\n").message(), "a.toml:2: there is no file gone.glb"));
  CHECK(contains(SceneFolder("[[animals]]\nspecies = \"unicorn\"\n").message(),
                 "a.toml:2: there is no species 'unicorn'"));
  CHECK(contains(refused("coats = [\"gone.png\"]\n"), "a.toml:3: there is no file gone.png"));
  CHECK(contains(refused("coats = [\"onw\"]\n"), "a.toml:3: there is no coat 'onw'"));
  CHECK(contains(refused("coats = []\n"), "a.toml:3: 'coats' in [animals[0]] must name at least one"));
  CHECK(contains(refused("poses = [{clip = \"walk\"}]\n"), "a.toml:3: 'count' in [animals[0].poses[0]] is missing"));
  CHECK(contains(refused("poses = [{count = 4}]\n"), "must have exactly one of clip, file and random"));
  CHECK(contains(refused("poses = [{random = 5}]\n[frames]\ncount = 6\n"),
                 "a.toml:5: frame 6 needs 6 poses, but [animals[0]] has 5"));
  CHECK(contains(refused("[frames]\nlist = [3, 3]\n"), "a.toml:4: 'list' in [frames] holds 3 twice"));
  CHECK(contains(refused("[frames]\nlist = [0]\n"), "whole numbers of at least 1, not 0"));
  CHECK(contains(refused("[frames]\nlist = [1]\ncount = 2\n"),
                 "a.toml:5: 'count' in [frames] cannot stand beside 'list'"));
  CHECK(contains(refused("[frames]\ncount = 0\n"), "a.toml:4: 'count' in [frames] must be a whole number from 1"));
  CHECK(contains(refused("yaw_deg = {unifrom = [0, 1]}\n"),
                 "a.toml:3: unknown key 'unifrom' in [animals[0].yaw_deg]; did you mean 'uniform'?"));
  CHECK(contains(refused("yaw_deg = {uniform = [0, 1], per = \"view\"}\n"), "must be the same for all cameras"));
  CHECK(contains(refused("yaw_deg = {uniform = [1, 0]}\n"), "as [lower, upper], not [1, 0]"));
  CHECK(contains(refused("yaw_deg = {uniform = [0, nan]}\n"), "must be finite, not nan"));
  CHECK(contains(refused("yaw_deg = {}\n"), "must have exactly one of uniform, normal, log_uniform and choose"));
  CHECK(contains(refused("yaw_deg = [0, 1]\n"), "must be a number, not a list"));
  CHECK(contains(refused("yaw_deg = {uniform = [0, 1], clamp = [0, 1]}\n"), "'clamp' only beside 'normal'"));
  CHECK(contains(refused("yaw_deg = {choose = []}\n"), "must not give choose an empty list"));
  CHECK(contains(refused("position = [0, 0]\n"), "must be three numbers [x, y, z], not a list of 2"));
  CHECK(contains(refused("[light]\nenvironment_file = \"gone.exr\"\n"), "a.toml:4: there is no file gone.exr"));
  {
    const TemporaryFile file("a.toml", "[[animals]]\nspecies = \"rig.glb\"\n[light]\nenvironment_color = 1\nenvironment_file = \"sky.hdr\"\n");
    for (const char* name : {"rig.glb", "sky.hdr"}) std::ofstream(file.folder() / name) << "x";
    CHECK(contains(message_of([&] { read_scene(file.path); }), "a.toml:4: 'environment_color' in [light] means nothing beside environment_file"));
  }
  CHECK(contains(refused("[[light.suns]]\nelevation_deg = 91\n"),
                 "a.toml:4: 'elevation_deg' in [light.suns[0]] must lie from -90 to 90, not 91"));
  CHECK(contains(refused("[[light.suns]]\nirradiance = {log_uniform = [0, 1]}\n"), "positive bounds for log_uniform"));
  CHECK(contains(refused("[[light.suns]]\nirradiance = {normal = [1, -1]}\n"), "sigma of at least 0"));
  CHECK(contains(refused("[background]\nkind = \"image\"\n"), "'image' in [background] is missing"));
  CHECK(contains(refused("[[cameras.list]]\nposition = [1, 0, 0]\n[[cameras.list]]\nid = 0\nposition = [1, 0, 0]\n"),
                 "a.toml:6: 'id' in [cameras.list[1]] is 0 for two cameras"));
  CHECK(contains(refused("[cameras]\nonly = [24]\n"), "names camera 24, which the scene does not have"));
  CHECK(contains(refused("[cameras.rings]\nheights = []\n"), "one height per ring"));
}

TEST_CASE("pose files are checked when the scene is read") {
  auto with_poses = [](const std::string& json) {
    const SceneFolder file(animal + "poses = [{file = \"p.json\"}]\n");
    std::ofstream(file.folder() / "p.json") << json;
    return file.message();
  };
  CHECK(with_poses(R"({"poses": [{"hip": {"rotation": [0, 0, 0, 1], "translation": [0, 0, 1]}}, {}]})") ==
        "(no error)");
  CHECK(contains(with_poses("{"), "a.toml:3: p.json is not valid JSON at byte"));
  CHECK(contains(with_poses("[]"), "a.toml:3: p.json has no poses"));
  CHECK(contains(with_poses(R"({"poses": [{"hip": {"rotation": [0, 0, 1]}}]})"),
                 "p.json: pose 0 must give the rotation of node 'hip' as 4 finite numbers"));
  CHECK(contains(with_poses(R"({"poses": [{"hip": {"rotation": [0, 0, 0, 2]}}]})"), "no unit quaternion"));
  CHECK(contains(with_poses(R"({"poses": [{"hip": {"turn": [0]}}]})"), "has 'turn' for node 'hip'"));
}

TEST_CASE("overrides change the scene and what it says of itself") {
  const SceneFolder good(animal + "coats = [\"own\", \"coat.png\"]\n[frames]\ncount = 20\n");
  SceneSpec s = read_scene(good.path);
  Overrides o;
  o.first_frame = 3;
  o.last_frame = 5;
  o.cameras = {9, 2};
  o.coats = {1};
  o.modalities = {"depth"};
  o.resolution = {320, 240};
  o.samples = 2;
  apply_overrides(s, o);
  CHECK(s.frames == std::vector<int>{3, 4, 5});
  CHECK(s.coat_indices == std::vector<int>{1});
  CHECK(s.render.samples == 2);
  const std::vector<CameraRecord> cameras = cameras_of_frame(s, 3);
  REQUIRE(cameras.size() == 2);
  CHECK(cameras[0].id == 2);
  CHECK(cameras[1].id == 9);
  CHECK(cameras[0].width == 320);
  CHECK(s.resolved["render"]["samples"] == 2);
  CHECK(s.resolved["modalities"] == Json{"depth"});
  auto refuses = [&](auto change) {
    Overrides wrong;
    change(wrong);
    return message_of([&] { apply_overrides(s, wrong); });
  };
  CHECK(contains(refuses([](Overrides& x) { x.first_frame = 100; }), "--frames: the range holds none"));
  CHECK(contains(refuses([](Overrides& x) { x.cameras = {24}; }), "--cameras: there is no 24; the scene has 0, 1,"));
  CHECK(contains(refuses([](Overrides& x) { x.coats = {2}; }), "--coats: there is no 2; the scene has 0, 1"));
  CHECK(contains(refuses([](Overrides& x) { x.modalities = {"dept"}; }),
                 "--modalities: there is no modality 'dept' (did"));
  CHECK(contains(refuses([](Overrides& x) { x.resolution = {0, 0}; }), "--resolution: 0x0 is not possible"));
  CHECK(contains(refuses([](Overrides& x) { x.samples = 0; }), "--spp"));
}
