#include <doctest/doctest.h>

#include "scenes/scene.h"
#include "tests/temporary_file.h"

using namespace moomill;
using namespace moomill::test;
namespace fs = std::filesystem;

namespace {

// A beam 2 m long on two joints, 0.5 m above the ground, with a clip that lifts and carries it.
Rig beam() {
  Rig rig;
  rig.source = "beam.glb";
  rig.nodes.resize(2);
  rig.nodes[0].name = "hip";
  rig.nodes[0].translation = {0, 0, 1};
  rig.nodes[1].name = "head";
  rig.nodes[1].parent = 0;
  rig.nodes[1].translation = {1, 0, 0};
  rig.bones.resize(2);
  for (int i = 0; i < 2; ++i) {
    rig.bones[i].node = i;
    rig.bones[i].inverse_bind[3] = dvec4(-double(i), 0, -1, 1);
  }
  Surface& s = rig.surface;
  s.rest = {{0, 0, 0.5f}, {2, 0, 0.5f}, {2, 1, 1.5f}, {0, 1, 1.5f}};
  s.normals.assign(4, vec3(0, -0.70710678f, 0.70710678f));
  s.triangles = {{0, 1, 2}, {0, 2, 3}};
  s.materials = {0, 0};
  s.parts = {0, 0};
  rig.influence_begin = {0, 1, 2, 3, 4};
  rig.influences = {{0, 1}, {1, 1}, {1, 1}, {0, 1}};
  MeshPart mesh;
  mesh.name = "beam";
  mesh.vertex_count = 4;
  mesh.triangle_count = 2;
  mesh.skinned = true;
  mesh.node = -1;
  rig.meshes = {mesh};
  rig.materials.resize(1);
  Clip clip;
  clip.name = "walk";
  clip.duration = 2;
  Channel c;
  c.node = 0;
  c.path = ChannelPath::translation;
  c.times = {0, 2};
  c.values = {0, 0, 1, 4, 2, 3};
  clip.channels = {c};
  rig.clips = {clip};
  finish_rig(rig);
  return rig;
}

struct BeamFolder : TemporaryFile {
  explicit BeamFolder(const std::string& species) : TemporaryFile("beam.toml", species) {
    write_glb(beam(), folder() / "beam.glb");
  }
  Species read() const { return read_species("beam.toml", NnopcsNormalization::box, folder()); }
  std::string message() const {
    std::string m = message_of([&] { read(); });
    for (std::size_t at; (at = m.find(folder().string() + "/")) != std::string::npos;)
      m.erase(at, folder().string().size() + 1);
    return m;
  }
};

const std::string head = "name = \"beam\"\n[source]\nfile = \"beam.glb\"\n";  // three lines

}  // namespace

TEST_CASE("a species file says what a rig is") {
  const BeamFolder file(R"(
name = "beam"
expected_length_m = 2
expected_height_m = 1
reader_radius_m = 2.5
skinning = "dual_quaternion"
edges = [["tip", "mid"]]
pairs = [["tip", "mid"]]
[source]
file = "beam.glb"
[[keypoints]]
name = "tip"
joint = "head"
offset = [1, 0, 0]
tolerance_m = 0.1
[[keypoints]]
name = "hip"
joint = "#0"
at = [0.25, 0, 1]
[[keypoints]]
name = "mid"
triangle = 1
barycentrics = [0.25, 0.5]
[[limits]]
joint = "head"
lower_deg = [0, -10, -20]
upper_deg = [0, 10, 20]
)");
  REQUIRE(file.message() == "(no error)");
  const Species s = file.read();
  CHECK(s.name == "beam");
  CHECK(s.skinning == SkinningMethod::dual_quaternion);
  CHECK(s.reader_radius == 2.5);
  CHECK(*s.expected_length == 2);
  REQUIRE(s.keypoints.size() == 3);
  CHECK(s.keypoints[0].tolerance == 0.1);
  CHECK(glm::length(std::get<JointAnchor>(s.keypoints[0].anchor).neutral - dvec3(2, 0, 1)) < 1e-6);
  CHECK(std::get<JointAnchor>(s.keypoints[1].anchor).neutral == dvec3(0.25, 0, 1));
  CHECK(s.edges == std::vector<std::pair<int, int>>{{0, 2}});
  CHECK(s.limits.size() == 1);
  CHECK(s.rig.surface.nnopcs.size() == s.rig.surface.rest.size());
  CHECK(glm::length(s.rig.surface.neutral_box.upper - dvec3(2, 1, 1.5)) < 1e-6);
  CHECK(glm::length(s.standing - dvec3(-1, -0.5, -0.5)) < 1e-6);
}

TEST_CASE("the neutral pose may be of a clip or of turned joints, NNOPCS and keypoints follow it") {
  const Species clip = BeamFolder(head +
                                  "[[keypoints]]\nname = \"k\"\njoint = \"head\"\n"
                                  "[neutral]\nclip = \"walk\"\ntime_s = 1\n")
                           .read();
  CHECK(glm::length(clip.rig.surface.neutral_box.lower - dvec3(2, 1, 1.5)) < 1e-6);
  CHECK(glm::length(std::get<JointAnchor>(clip.keypoints[0].anchor).neutral - dvec3(3, 1, 2)) < 1e-6);
  const Species turned = BeamFolder(head +
                                    "[[keypoints]]\nname = \"k\"\njoint = \"head\"\n"
                                    "[neutral.rotations_deg]\nhip = [0, -90, 0]\n")
                             .read();
  CHECK(glm::length(std::get<JointAnchor>(turned.keypoints[0].anchor).neutral - dvec3(0, 0, 2)) < 1e-6);
}

TEST_CASE("yaw_deg turns the whole rig, clips included, scale scales it") {
  const Species s = BeamFolder("name = \"beam\"\n[source]\nfile = \"beam.glb\"\nyaw_deg = 90\nscale = 2\n").read();
  CHECK(glm::length(s.rig.surface.neutral_box.lower - dvec3(-2, 0, 1)) < 1e-5);
  CHECK(glm::length(s.rig.surface.neutral_box.upper - dvec3(0, 4, 3)) < 1e-5);
  const Pose end = sample_clip(s.rig, s.rig.clips[0], 2);
  CHECK(glm::length(dvec3(world_transforms(s.rig, end)[0][3]) - dvec3(-4, 8, 6)) < 1e-5);
  const Pose rest = rest_pose(s.rig);
  const PosedSurface posed = skin(s.rig, bone_matrices(s.rig, world_transforms(s.rig, rest)), {}, s.skinning, dvec3(0));
  for (std::size_t i = 0; i < posed.positions.size(); ++i)
    CHECK(glm::length(posed.positions[i] - s.rig.surface.rest[i]) < 1e-5f);
}

TEST_CASE("a bare rig file is a species without keypoints that stands on the ground") {
  const BeamFolder file(head);
  const Species s = read_species("beam.glb", NnopcsNormalization::diagonal, file.folder());
  CHECK(s.name == "beam");
  CHECK(s.keypoints.empty());
  CHECK(s.standing.z == doctest::Approx(-0.5));
}

TEST_CASE("mistakes in a species file are told with line and mend") {
  auto refused = [](const std::string& more) { return BeamFolder(head + more).message(); };
  const std::string k = "[[keypoints]]\nname = \"a\"\n";
  CHECK(contains(refused(k + "joint = \"haed\"\n"), "beam.toml:6: "));
  CHECK(contains(refused(k + "joint = \"haed\"\n"), "has no joint 'haed'; did you mean 'head'?"));
  CHECK(contains(refused(k + "joint = \"#99\"\n"), "has no joint #99; its joints are #0 to #"));
  CHECK(contains(refused(k + "joint = \"head\"\ntriangle = 0\n"), "must have either 'joint' or 'triangle'"));
  CHECK(contains(refused(k + "joint = \"head\"\nat = [0, 0, 0]\noffset = [0, 0, 0]\n"), "cannot stand beside 'at'"));
  CHECK(contains(refused(k + "triangle = 2\nbarycentrics = [0, 0]\n"), "whole number from 0 to 1, not 2"));
  CHECK(contains(refused(k + "triangle = 0\nbarycentrics = [1, 1]\n"), "sum to at most 1"));
  CHECK(contains(refused(k + "joint = \"head\"\n" + k + "joint = \"hip\"\n"),
                 "beam.toml:8: 'name' in [keypoints[1]] 'a' is"));
  CHECK(contains(BeamFolder("edges = [[\"a\", \"b\"]]\n" + head + k + "joint = \"hip\"\n").message(),
                 "beam.toml:1: 'edges' names 'b', which is no keypoint"));
  CHECK(contains(BeamFolder("edges = [[\"a\", \"a\"]]\n" + head + k + "joint = \"hip\"\n").message(), "with itself"));
  const std::string l = "[[limits]]\njoint = \"head\"\nlower_deg = [0, 0, 0]\nupper_deg = [1, 1, 1]\n";
  CHECK(contains(refused(l + l), "beam.toml:9: 'joint' in [limits[1]] has limits already"));
  CHECK(contains(refused("[[limits]]\njoint = \"head\"\nlower_deg = [2, 0, 0]\nupper_deg = [1, 1, 1]\n"),
                 "above upper_deg"));
  CHECK(contains(refused("[neutral]\nclip = \"wlak\"\n"), "has no clip 'wlak'; did you mean 'walk'?"));
  CHECK(contains(BeamFolder("name = \"a/b\"\n").message(), "letters, digits"));
  CHECK(contains(BeamFolder("name = \"b\"\n").message(), "'source' is missing"));
  CHECK(contains(BeamFolder("name = \"b\"\n[source]\n").message(), "must have either 'file' or 'builder'"));
  CHECK(
      contains(BeamFolder("name = \"b\"\n[source]\nfile = \"gone.glb\"\n").message(), "beam.toml:3: there is no file"));
  CHECK(contains(refused("[souce]\n"), "unknown key 'souce'; did you mean 'source'?"));
}

TEST_CASE("poses: evenly over a clip without its end, of a file, sampled within the limits") {
  const BeamFolder file(head + "[[limits]]\njoint = \"head\"\nlower_deg = [0, -10, -20]\nupper_deg = [0, 30, 20]\n");
  const Species species = file.read();
  SceneSpec scene;
  scene.file = "test.toml";
  scene.seed = 5;
  AnimalSpec a;
  a.key = "animals[0]";
  a.position = constant_vector({1, 2, 0});
  a.yaw_deg = constant_number(90);
  a.pose_in_place = false;
  const auto list = std::make_shared<const Json>(
      Json::parse(R"([{"head": {"rotation": [0, 0, 1, 0]}}, {"#0": {"translation": [0, 0, 5]}}, {"haed": {}}])"));
  a.poses = {ClipFrames{"walk", 4}, PoseFile{"p.json", list}, PoseSampler{1000, 0.5}, ClipFrames{"", 2}};
  CHECK(pose_count(a, species) == 1009);
  auto hip = [&](int index) {
    return dvec3(world_transforms(species.rig, pose_of_frame(scene, a, species, index))[0][3]);
  };
  // Model space is shifted by (-1, -0.5, -0.5), turned by 90 degrees and moved to (1, 2).
  CHECK(glm::length(hip(0) - dvec3(1.5, 1, 0.5)) < 1e-6);
  CHECK(glm::length(hip(1) - dvec3(1.5 - 0.5, 1 + 1, 1)) < 1e-6);
  CHECK(glm::length(hip(3) - dvec3(1.5 - 1.5, 1 + 3, 2)) < 1e-6);
  CHECK(glm::length(hip(1008) - dvec3(1.5 - 1, 1 + 2, 1.5)) < 1e-6);
  a.pose_in_place = true;
  CHECK(glm::length(hip(3) - dvec3(1.5, 1, 2)) < 1e-6);  // height stays, horizontal travel goes
  CHECK(glm::length(hip(5) - dvec3(1.5, 1, 4.5)) < 1e-6);
  CHECK(contains(message_of([&] { pose_of_frame(scene, a, species, 6); }), "no joint 'haed'; did you mean 'head'?"));
  CHECK(contains(message_of([&] { pose_of_frame(scene, a, species, 1009); }), "frame 1010 needs 1010 poses"));
  double least = 1e9, most = -1e9;
  for (int i = 7; i < 1007; ++i) {
    const Pose p = pose_of_frame(scene, a, species, i);
    const dquat q = p.local[1]->rotation;
    const double pitch = std::asin(2 * (q.w * q.y - q.z * q.x)) / degrees;
    least = std::min(least, pitch);
    most = std::max(most, pitch);
  }
  CHECK(least >= -5 - 1e-9);  // half the limits
  CHECK(most <= 15 + 1e-9);
  CHECK(least < -4.8);
  CHECK(most > 14.8);
  const Pose p = pose_of_frame(scene, a, species, 100), q = pose_of_frame(scene, a, species, 100);
  CHECK(p.local[1]->rotation == q.local[1]->rotation);
}
