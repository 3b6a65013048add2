// The overlap of silhouettes: the pictures against plain references, the fit against a known answer.
#include "validate/studies/silhouette.h"

#include <doctest/doctest.h>

#include "generator/core/random.h"
#include "tests/temporary_file.h"
#include "validate/studies/evolution.h"

using namespace moomill;
using test::contains;
using test::message_of;

namespace {

SilhouetteMesh ellipse(double a, double b) {
  SilhouetteMesh mesh;
  constexpr std::uint32_t sides = 2000;
  mesh.points.push_back(dvec3(0));
  for (std::uint32_t i = 0; i < sides; ++i) {
    mesh.points.push_back({a * std::cos(2 * pi * i / sides), 0, b * std::sin(2 * pi * i / sides)});
    mesh.triangles.push_back({0, i + 1, (i + 1) % sides + 1});
  }
  return mesh;
}

void add_block(Rig& rig, const dvec3& lower, const dvec3& upper, std::uint32_t bone, std::uint16_t part) {
  const auto first = static_cast<std::uint32_t>(rig.surface.rest.size());
  for (int k = 0; k < 8; ++k) {
    rig.surface.rest.push_back({k & 1 ? upper.x : lower.x, k & 2 ? upper.y : lower.y, k & 4 ? upper.z : lower.z});
    rig.surface.normals.push_back({0, 0, 1});
    rig.influences.push_back({bone, 1});
    rig.influence_begin.push_back(static_cast<std::uint32_t>(rig.influences.size()));
  }
  constexpr std::uint32_t faces[6][4] = {{0, 2, 3, 1}, {4, 5, 7, 6}, {0, 1, 5, 4}, {2, 6, 7, 3}, {0, 4, 6, 2}, {1, 3, 7, 5}};
  for (const auto& f : faces)
    for (const auto& t : {uvec3(f[0], f[1], f[2]), uvec3(f[0], f[2], f[3])}) {
      rig.surface.triangles.push_back(first + t);
      rig.surface.parts.push_back(part);
      rig.surface.materials.push_back(0);
    }
}

// A body, a neck that turns, two legs that turn as mirror images, and a flag that is left out.
Species blocks() {
  Species s;
  s.name = "blocks";
  Rig& rig = s.rig;
  rig.source = "blocks";
  rig.nodes = {{.name = "body", .translation = {0, 0, 1}},
               {.name = "neck", .parent = 0, .translation = {0.6, 0, 0.1}},
               {.name = "left_leg", .parent = 0, .translation = {-0.4, 0.2, -0.2}},
               {.name = "right_leg", .parent = 0, .translation = {-0.4, -0.2, -0.2}}};
  const auto bone = [](int node, const dvec3& at) { return Bone{node, compose({.translation = -at})}; };
  rig.bones = {bone(0, {0, 0, 1}), bone(1, {0.6, 0, 1.1}), bone(2, {-0.4, 0.2, 0.8}), bone(3, {-0.4, -0.2, 0.8})};
  rig.influence_begin = {0};
  rig.part_names = {"whole", "flag_l"};
  rig.materials = {{}};
  add_block(rig, {-0.6, -0.25, 0.75}, {0.65, 0.25, 1.25}, 0, 0);
  add_block(rig, {0.5, -0.1, 1.0}, {1.2, 0.1, 1.2}, 1, 0);
  add_block(rig, {-0.47, 0.12, 0}, {-0.33, 0.24, 0.85}, 2, 0);
  add_block(rig, {-0.47, -0.24, 0}, {-0.33, -0.12, 0.85}, 3, 0);
  add_block(rig, {0, -0.05, 1.2}, {0.1, 0.05, 2}, 0, 1);
  rig.meshes = {{.name = "blocks", .vertex_count = 40, .triangle_count = 60, .skinned = true}};
  s.neutral = rest_pose(rig);
  return s;
}

SilhouetteReference with_turns() {
  SilhouetteReference r;
  r.name = "known";
  r.left_out_parts = {"flag*"};
  r.turns = {{"neck", 1, -40, 40, false}, {"left_leg", 0, -20, 20, true}, {"left_leg", 1, -30, 30, true}};
  return r;
}

}  // namespace

TEST_CASE("a silhouette holds exactly the pixels whose centre lies in a triangle") {
  const SilhouetteGrid grid{40, 30, 0.25, {-1, -2}};
  for (std::uint64_t round = 0; round < 200; ++round) {
    SilhouetteMesh mesh;
    for (std::uint64_t i = 0; i < 9; ++i) {
      const auto u = [&](std::uint64_t k) { return to_unit(hash_identity({round, i, k})); };
      mesh.points.push_back({-3 + 14 * u(0), 0, -4 + 12 * u(1)});  // reaches beyond the picture
      if (round % 4 == 0) mesh.points.back() = glm::floor(mesh.points.back()) + dvec3(0.125);  // on pixel centres
    }
    mesh.triangles = {{0, 1, 2}, {3, 5, 4}, {6, 7, 8}, {0, 0, 4}};
    const Image8 drawn = draw_silhouette(mesh, {0, 2}, grid);
    for (int y = 0; y < grid.height; ++y)
      for (int x = 0; x < grid.width; ++x) {
        const dvec2 c(-1 + 0.25 * (x + 0.5), -2 + 0.25 * (y + 0.5));
        bool inside = false, unsure = false;
        for (const uvec3& t : mesh.triangles) {
          double lowest = 1e9, highest = -1e9;
          for (int k = 0; k < 3; ++k) {
            const dvec3 &a = mesh.points[t[k]], &b = mesh.points[t[(k + 1) % 3]];
            const double side = (b.x - a.x) * (c.y - a.z) - (b.z - a.z) * (c.x - a.x);
            lowest = std::min(lowest, side);
            highest = std::max(highest, side);
          }
          inside = inside || lowest > 1e-9 || highest < -1e-9;
          unsure = unsure || std::abs(lowest) <= 1e-9 || std::abs(highest) <= 1e-9;
        }
        if (inside || !unsure) CHECK(drawn.at(x, y) == (inside ? 1 : 0));
      }
  }
  // Edges belong to the triangle: a square over whole pixels and their centres.
  SilhouetteMesh square;
  square.points = {{-0.875, 0, -1.875}, {0.125, 0, -1.875}, {0.125, 0, -0.875}, {-0.875, 0, -0.875}};
  square.triangles = {{0, 1, 2}, {0, 2, 3}};
  int set = 0;
  for (const std::uint8_t p : draw_silhouette(square, {0, 2}, grid).data) set += p;
  CHECK(set == 25);
}

TEST_CASE("the overlap of ellipses is that of their areas") {
  const SilhouetteGrid grid{1200, 900, 0.002, {-1.2, -0.9}};
  const Image8 small = draw_silhouette(ellipse(0.8, 0.5), {0, 2}, grid), large = draw_silhouette(ellipse(1.0, 0.7), {0, 2}, grid);
  CHECK(intersection_over_union(small, large) == doctest::Approx(0.8 * 0.5 / 0.7).epsilon(0.002));
  CHECK(intersection_over_union(large, large) == 1);
  // Crossed ellipses a, b and b, a: they overlap in 4 ab atan(b / a).
  const double a = 0.8, b = 0.5, both = 4 * a * b * std::atan(b / a);
  CHECK(intersection_over_union(draw_silhouette(ellipse(a, b), {0, 2}, grid), draw_silhouette(ellipse(b, a), {0, 2}, grid)) ==
        doctest::Approx(both / (2 * pi * a * b - both)).epsilon(0.002));
  const Image8 nothing(1200, 900, 1);
  CHECK(intersection_over_union(nothing, small) == 0);
  CHECK(intersection_over_union(nothing, nothing) == 0);
}

TEST_CASE("evolution finds the bottom of a bent valley") {
  // Rosenbrock's function in six numbers: 0 at (1, ..., 1).
  const auto valley = [](const std::vector<double>& x) {
    double sum = 0;
    for (std::size_t i = 0; i + 1 < x.size(); ++i)
      sum += 100 * (x[i + 1] - x[i] * x[i]) * (x[i + 1] - x[i] * x[i]) + (1 - x[i]) * (1 - x[i]);
    return sum;
  };
  const std::vector<double> found = minimise(valley, std::vector<double>(6, 0.0), {16, 1000, 0.3, 1});
  for (const double x : found) CHECK(x == doctest::Approx(1).epsilon(1e-4));
  CHECK(minimise(valley, std::vector<double>(6, 0.0), {16, 1000, 0.3, 1}) == found);
  const auto bowl = [](const std::vector<double>& x) { return std::abs(x[0] - 3) + 10 * std::abs(x[1] + 0.25); };
  const std::vector<double> bottom = pattern_search(bowl, {0, 0}, 0.5, 1e-6, 1000);
  CHECK(bottom[0] == doctest::Approx(3).epsilon(1e-5));
  CHECK(bottom[1] == doctest::Approx(-0.25).epsilon(1e-5));
  CHECK(pattern_search(bowl, {0, 0}, 0.5, 1e-6, 1) == std::vector<double>{0, 0});
}

TEST_CASE("a rig fits itself, posed and scaled by known numbers") {
  const Species species = blocks();
  Species posed = species;
  posed.limits = {{1, dvec3(0, 25, 0), dvec3(0, 25, 0)}, {2, dvec3(8, -15, 0), dvec3(8, -15, 0)}, {3, dvec3(-8, -15, 0), dvec3(-8, -15, 0)}};
  const PosedSurface surface =
      skin(species.rig, bone_matrices(species.rig, world_transforms(species.rig, sample_within_limits(posed, {}))), {}, SkinningMethod::linear_blend, dvec3(0));
  const dvec3 scale(1.25, 0.9, 1.1), offset(0.3, -0.05, 0.2);
  SilhouetteMesh mesh;
  for (const vec3& p : surface.positions) mesh.points.push_back(scale * dvec3(p) + offset);
  for (std::size_t i = 0; i < 48; ++i) mesh.triangles.push_back(species.rig.surface.triangles[i]);  // without the flag
  const SilhouetteReference reference = with_turns();
  const SilhouetteFit fit = fit_silhouettes(species, reference, mesh);
  for (int v = 0; v < 3; ++v) {
    INFO("view " << silhouette_views[v]);
    CHECK(fit.overlap[v] > 0.99);
    CHECK(fit.scale[v] == doctest::Approx(scale[v]).epsilon(0.01));
    CHECK(std::abs(fit.offset[v] - offset[v]) < 0.01);
  }
  CHECK(std::abs(fit.turns_deg[0] - 25) < 1);
  CHECK(std::abs(fit.turns_deg[1] - 8) < 1);
  CHECK(std::abs(fit.turns_deg[2] + 15) < 1);
  CHECK(fit.parts_left_out == std::vector<std::string>{"flag_l"});
  const StudyResult study = silhouette_study(species, reference, fit);
  CHECK(study.figures[0].name == "side overlap");
  CHECK(contains(study.table, "left_leg and its twin"));
  const Image8 sheet = silhouette_sheet(fit, study.title);
  CHECK((sheet.width > 600 && sheet.channels == 3));

  // With the flag left in, it stands out: 0.08 square metres before the scales, of about 1.0.
  SilhouetteReference whole = reference;
  whole.left_out_parts.clear();
  CHECK(fit_silhouettes(species, whole, mesh).overlap[0] < 0.97);

  // Limits of the species narrow the turns.
  Species stiff = species;
  stiff.limits = {{1, dvec3(0, -10, 0), dvec3(0, 10, 0)}};
  const SilhouetteFit less = fit_silhouettes(stiff, reference, mesh);
  CHECK(less.turns_deg[0] == doctest::Approx(10));
  CHECK(less.overlap[0] < fit.overlap[0] - 0.01);
}

TEST_CASE("what does not fit together is said in a sentence") {
  const Species species = blocks();
  const SilhouetteMesh mesh = ellipse(1, 1);
  SilhouetteReference reference = with_turns();
  reference.turns[0].joint = "beak";
  CHECK(contains(message_of([&] { fit_silhouettes(species, reference, mesh); }), "no joint 'beak'"));
  reference = with_turns();
  reference.turns[0].mirror = true;
  CHECK(contains(message_of([&] { fit_silhouettes(species, reference, mesh); }), "'neck' has no twin"));
  reference = with_turns();
  reference.left_out_parts = {"*"};
  CHECK(contains(message_of([&] { fit_silhouettes(species, reference, mesh); }), "every part is left out"));
  Species stiff = species;
  stiff.limits = {{1, dvec3(0, 50, 0), dvec3(0, 60, 0)}};
  CHECK(contains(message_of([&] { fit_silhouettes(stiff, with_turns(), mesh); }), "outside its limits 50 to 60"));
}

TEST_CASE("a reference file is read, and its mesh scaled, turned and cut") {
  const test::TemporaryFile file("block.toml", R"(
name = "block"
file = "block.glb"
yaw_deg = -90
height_m = 4
at_least = { side = 0.5 }
leave_out = [{ what = "flag", lower = [-9, -9, 2.6], upper = [9, 9, 9] }]
leave_out_parts = ["flag*"]
turns = [{ joint = "neck", axis = "y", lower_deg = -3, upper_deg = 4 }, { joint = "left_leg", axis = "x", lower_deg = 0, upper_deg = 4, mirror = true }]
)");
  const auto variant = [&](const std::string& from, const std::string& to) {
    std::ifstream in(file.path);
    std::string text((std::istreambuf_iterator<char>(in)), {});
    const std::size_t at = text.find(from);
    REQUIRE(at != std::string::npos);
    text.replace(at, from.size(), to);
    const std::filesystem::path other = file.folder() / "other.toml";
    std::ofstream(other) << text;
    return other;
  };
  CHECK(contains(message_of([&] { read_silhouette_reference(file.path); }), "there is no mesh block.glb"));
  Rig rig = blocks().rig;
  turn_rig(rig, 90);
  finish_rig(rig);
  write_glb(rig, file.folder() / "block.glb");
  const SilhouetteReference r = read_silhouette_reference(file.path);
  CHECK(r.name == "block");
  CHECK(r.turns.size() == 2);
  CHECK(r.turns[1].mirror);
  CHECK((r.at_least[0] == 0.5 && !r.at_least[1]));
  const SilhouetteMesh mesh = load_silhouette_reference(r);
  CHECK(mesh.triangles.size() < 60);
  CHECK(mesh.triangles.size() >= 48);
  Box box;
  for (const uvec3& t : mesh.triangles)
    for (int k = 0; k < 3; ++k) box.add(mesh.points[t[k]]);
  // 2 m high with the flag, drawn 4 m high; 1.8 m long, 1.25 m to the top of the body.
  CHECK(box.lower.z == doctest::Approx(0));
  CHECK(box.lower.x == doctest::Approx(-1.8));
  CHECK(box.upper.x == doctest::Approx(1.8));
  CHECK(box.size().y == doctest::Approx(1));

  const auto says = [&](const std::string& from, const std::string& to) {
    return message_of([&] { load_silhouette_reference(read_silhouette_reference(variant(from, to))); });
  };
  CHECK(contains(says("upper = [9, 9, 9]", "upper = [9, 9, 1]"), "of 'flag' is not below upper along z"));
  CHECK(contains(says("lower = [-9, -9, 2.6]", "lower = [-9, 8, 2.6]"), "'flag' of the reference 'block' leaves out no triangle"));
  CHECK(contains(says("lower = [-9, -9, 2.6]", "lower = [-9, -9, -9]"), "leave out all of it"));
  CHECK(contains(says("height_m = 4", "height_m = -4"), "height_m"));
  CHECK(contains(says("axis = \"y\"", "axis = \"w\""), "axis"));
  CHECK(contains(says("\"left_leg\", axis = \"x\"", "\"neck\", axis = \"y\""), "turns about y already"));
  CHECK(contains(says("yaw_deg", "yow_deg"), "yow_deg"));
}
