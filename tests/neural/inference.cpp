// Rendering, encoding and evaluation with small networks of random weights: shortcuts against the full evaluation,
// batches against single views, files against tensors, figures against figures worked out anew.
#include "neural/inference.h"

#include <fmt/format.h>

#include <fstream>

#include "generator/core/error.h"
#include "generator/dataset/codecs.h"
#include "generator/dataset/json.h"
#include "neural/codes.h"
#include "neural/commands_infer.h"
#include "neural/evaluate.h"
#include "neural/pose_file.h"
#include "neural/speed.h"
#include "tests/neural/doctest_torch.h"
#include "tests/neural/tiny_dataset.h"
#include "tests/temporary_file.h"

using namespace moomill;
using torch::Tensor;
namespace fs = std::filesystem;

namespace {

NetepuConfig small_config(int keypoints = 10) {
  NetepuConfig config;
  config.model.keypoints = keypoints;
  config.model.local_features = 32;
  config.model.global_features = 32;
  config.model.head_width = 32;
  config.model.head_blocks = 2;
  config.model.encoder_blocks = 1;
  config.model.keypoint_bottleneck = 16;
  config.model.near_neighbours = 4;
  config.model.neighbours = 6;
  config.model.image_channels = {8, 16};
  config.model.image_blocks = 1;
  config.texture.encoder.width = 16;
  config.texture.encoder.height = 12;
  return config;
}

void set_parameter(torch::nn::Module& module, const std::string& name, const Tensor& value) {
  const torch::NoGradGuard guard;
  module.named_parameters()[name].copy_(value);
}

Model small_model(const NetepuConfig& config = small_config()) {
  torch::manual_seed(5);
  Model model;
  model.config = config;
  model.geometry = GeometryNetwork(config.model);
  model.texture = TextureNetwork(config.model);
  model.geometry->eval();
  model.texture->eval();
  model.coat_names = {"coat_0", "coat_1", "coat_2"};
  return model;
}

PosedAnimal tiny_animal(Model& model, int frame = 3) {
  const std::vector<dvec3> points = test::tiny_keypoints(test::tiny_pose(frame));
  Tensor keypoints = torch::empty({static_cast<std::int64_t>(points.size()), 3});
  for (std::size_t k = 0; k < points.size(); ++k)
    for (int i = 0; i < 3; ++i) keypoints[static_cast<std::int64_t>(k)][i] = points[k][i];
  return pose_animal(model.geometry, keypoints, "tiny pose");
}

CameraRecord camera_of_size(int width, int height) {
  return resized(test::tiny_camera(10, {}), width, height);
}

// Teaches the network the ellipsoid's silhouette before one camera, so that its logits are those of a trained one:
// sharp at a rim, far from zero elsewhere.
void teach_silhouette(Model& model, const PosedAnimal& animal, const CameraRecord& camera, int frame) {
  const test::TinyOptions options;
  CameraBatch batch = see_keypoints(animal.keypoints, camera);
  torch::optim::Adam optimiser(model.geometry->parameters(), torch::optim::AdamOptions(5e-3));
  for (int step = 0; step < 250; ++step) {
    Tensor points = torch::empty({1, 256, 2}), inside = torch::zeros({1, 256});
    for (int i = 0; i < 256; ++i) {
      const auto unit = [&](std::uint64_t axis) {
        return to_unit(hash_identity({static_cast<std::uint64_t>(step), static_cast<std::uint64_t>(i), axis}));
      };
      // Half of them about the animal, half anywhere.
      const double x = i % 2 ? unit(0) : 0.3 + 0.4 * unit(0), y = i % 2 ? unit(1) : 0.3 + 0.4 * unit(1);
      points[0][i][0] = x;
      points[0][i][1] = y;
      inside[0][i] = test::tiny_trace(test::tiny_pose(frame), camera, x * camera.width, y * camera.height).has_value();
    }
    optimiser.zero_grad();
    const ViewFeatures view = model.geometry->view(model.geometry->encode(animal.keypoints.unsqueeze(0)), batch);
    torch::binary_cross_entropy_with_logits(model.geometry->silhouette(model.geometry->attend(view, points)), inside)
        .backward();
    optimiser.step();
  }
  optimiser.zero_grad();
}

// Gives the untrained network a silhouette: a bias that puts this share of the image's pixels inside.
void shape_silhouette(Model& model, const AnimalView& view, double share) {
  const Inference guard;
  const int w = view.camera.width, h = view.camera.height;
  std::vector<std::int64_t> pixels(static_cast<std::size_t>(w) * h);
  for (std::size_t i = 0; i < pixels.size(); ++i) pixels[i] = static_cast<std::int64_t>(i);
  const Tensor logits =
      model.geometry->silhouette(model.geometry->attend(view.features, pixel_points(pixels, w, h).unsqueeze(0)))
          .flatten();
  const double cut =
      std::get<0>(logits.sort())[static_cast<std::int64_t>((1 - share) * static_cast<double>(logits.numel()))]
          .item<double>();
  const Tensor bias = model.geometry->named_parameters()["head_silhouette.out_bias"];
  set_parameter(*model.geometry, "head_silhouette.out_bias", bias - cut);
}

RefineOptions every_pixel() {
  RefineOptions options;
  options.mask_cell = 1;
  return options;
}

void write_pose(const fs::path& file, const Tensor& keypoints, const CameraRecord& camera) {
  Json list = Json::array();
  for (std::int64_t k = 0; k < keypoints.size(0); ++k)
    list.push_back({keypoints[k][0].item<double>(), keypoints[k][1].item<double>(), keypoints[k][2].item<double>()});
  Json json{{"keypoints", list},
            {"camera",
             {{"world_to_camera", camera.world_to_camera},
              {"fx", camera.fx},
              {"fy", camera.fy},
              {"cx", camera.cx},
              {"cy", camera.cy},
              {"width", camera.width},
              {"height", camera.height}}}};
  write_file_atomically(file, json.dump());
}

}  // namespace

TEST_CASE("keypoints are projected as by hand, and must lie before the camera") {
  CameraRecord camera;
  camera.width = 100;
  camera.height = 50;
  camera.fx = 80;
  camera.fy = 60;
  camera.cx = 50;
  camera.cy = 20;
  camera.world_to_camera = {1, 0, 0, 0.5, 0, 1, 0, 0, 0, 0, 1, 2};
  const CameraBatch batch = see_keypoints(torch::tensor({{0.5f, 1.0f, 2.0f}}), camera);
  CHECK(batch.keypoints_2d[0][0][0].item<double>() == doctest::Approx((80 * 1.0 / 4 + 50) / 100));
  CHECK(batch.keypoints_2d[0][0][1].item<double>() == doctest::Approx((60 * 1.0 / 4 + 20) / 50));
  CHECK(batch.world_to_camera[0][0][3].item<double>() == doctest::Approx(0.5));
  CHECK_THROWS_WITH_AS(see_keypoints(torch::tensor({{0.0f, 0.0f, 5.0f}, {0.0f, 0.0f, -2.5f}}), camera),
                       doctest::Contains("keypoint 1 does not lie in front"), InputError);
  // Another number of pixels on the same sensor: the same shares of the image.
  const CameraBatch larger = see_keypoints(torch::tensor({{0.5f, 1.0f, 2.0f}}), resized(camera, 400, 150));
  CHECK(torch::allclose(larger.keypoints_2d, batch.keypoints_2d));
}

TEST_CASE("poses that do not fit the model are refused") {
  Model model = small_model();
  CHECK_THROWS_WITH_AS(pose_animal(model.geometry, torch::zeros({7, 3}), "pose.json"),
                       doctest::Contains("7 keypoints, the model 10"), InputError);
  Tensor broken = torch::rand({10, 3});
  broken[4][1] = NAN;
  CHECK_THROWS_WITH_AS(pose_animal(model.geometry, broken, "pose.json"), doctest::Contains("not a finite number"),
                       InputError);
}

TEST_CASE("a network's silhouette traced coarse to fine is the full one but for a bounded share") {
  Model model = small_model();
  const CameraRecord camera = camera_of_size(320, 240);
  teach_silhouette(model, tiny_animal(model), camera, 3);
  const PosedAnimal animal = tiny_animal(model);
  const AnimalView view = view_animal(model.geometry, animal, camera);
  std::int64_t all = 0, some = 0;
  const ViewMaps full = render_maps(model.geometry, view, animal, every_pixel(), Surface::depth_and_nnopcs, &all);
  const ViewMaps traced = render_maps(model.geometry, view, animal, {}, Surface::depth_and_nnopcs, &some);
  Tensor truth = torch::zeros({240, 320});
  for (int y = 0; y < 240; ++y)
    for (int x = 0; x < 320; ++x)
      truth[y][x] = test::tiny_trace(test::tiny_pose(3), camera, x + 0.5, y + 0.5).has_value();
  REQUIRE(*mask_iou(full.mask, truth) > 0.8);
  const MapDifference d = compare_maps(full, traced);
  CHECK(d.mask_share < 0.002);
  CHECK(d.nnopcs_max < 1e-6);  // evaluated at the same points
  CHECK(d.depth_max_mm < 1e-2);
  CHECK(some < all / 3);

  RefineOptions coarse;
  coarse.surface_cell = 8;
  std::int64_t fewer = 0;
  const MapDifference interpolated =
      compare_maps(full, render_maps(model.geometry, view, animal, coarse, Surface::depth_and_nnopcs, &fewer));
  CHECK(interpolated.nnopcs_mean < 1e-3);
  CHECK(interpolated.nnopcs_max > 0);
  CHECK(fewer < some);
}

TEST_CASE("maps are what the heads say at the pixels' centres, and nothing outside") {
  Model model = small_model();
  const PosedAnimal animal = tiny_animal(model);
  const AnimalView view = view_animal(model.geometry, animal, camera_of_size(40, 30));
  shape_silhouette(model, view, 0.3);
  const ViewMaps maps = render_maps(model.geometry, view, animal, every_pixel());
  CHECK(maps.mask.sum().item<double>() == doctest::Approx(0.3 * 1200).epsilon(0.02));
  const Inference guard;
  int checked = 0;
  for (int y = 0; y < 30; y += 3)
    for (int x = 0; x < 40; x += 3) {
      const Tensor point = torch::tensor({{(static_cast<float>(x) + 0.5f) / 40, (static_cast<float>(y) + 0.5f) / 30}});
      const bool inside =
          model.geometry->silhouette(model.geometry->attend(view.features, point.unsqueeze(0))).item<float>() > 0;
      CHECK(maps.mask[y][x].item<float>() == (inside ? 1.0f : 0.0f));
      if (!inside) {
        CHECK(maps.depth[y][x].item<float>() == 0);
        CHECK(maps.nnopcs.select(1, y).select(1, x).abs().max().item<float>() == 0);
        continue;
      }
      ++checked;
      const Tensor surface = surface_at(model.geometry, view, point)[0];
      CHECK(maps.depth[y][x].item<float>() ==
            doctest::Approx(surface[0].item<float>() * view.depth_range + view.near_depth).epsilon(1e-4));
      for (int c = 0; c < 3; ++c)
        CHECK(maps.nnopcs[c][y][x].item<float>() ==
              doctest::Approx(surface[c + 1].clamp(0, 1).item<float>()).epsilon(1e-3));
    }
  CHECK(checked > 10);
}

TEST_CASE("NNOPCS is the same without depth") {
  Model model = small_model();
  const PosedAnimal animal = tiny_animal(model);
  const AnimalView view = view_animal(model.geometry, animal, camera_of_size(40, 30));
  const Tensor mask = torch::ones({30, 40});
  const ViewMaps both = render_surface(model.geometry, view, mask, {}),
                 one = render_surface(model.geometry, view, mask, {}, Surface::nnopcs);
  CHECK(torch::equal(both.nnopcs, one.nnopcs));
  CHECK_FALSE(one.depth.defined());
  NetepuConfig config = small_config();
  config.model.nnopcs = false;
  Model plain = small_model(config);
  const ViewMaps neither =
      render_surface(plain.geometry, view_animal(plain.geometry, tiny_animal(plain), camera_of_size(40, 30)), mask, {},
                     Surface::nnopcs);
  CHECK_FALSE(neither.nnopcs.defined());
}

TEST_CASE("coats of a view rendered and encoded together are those of each alone") {
  Model model = small_model();
  const PosedAnimal animal = tiny_animal(model);
  const AnimalView view = view_animal(model.geometry, animal, camera_of_size(32, 24));
  shape_silhouette(model, view, 0.3);
  const ViewMaps maps = render_maps(model.geometry, view, animal, every_pixel());
  torch::manual_seed(1);
  const Tensor colors = torch::rand({3, 3, 24, 32});
  const Tensor codes = encode_coats(model, colors, maps.mask, maps.nnopcs);
  const Tensor rendered = render_color(model, codes * 30, view, animal, maps.mask, {});
  CHECK(rendered.sizes() == torch::IntArrayRef({3, 3, 24, 32}));
  CHECK((rendered * (1 - maps.mask)).abs().max().item<float>() == 0);
  CHECK((rendered[0] - rendered[1]).abs().max().item<float>() > 1e-5);
  for (int i = 0; i < 3; ++i) {
    const Tensor code = encode_coats(model, colors.slice(0, i, i + 1), maps.mask, maps.nnopcs);
    CHECK(torch::allclose(code[0], codes[i], 1e-4, 1e-6));
    CHECK(torch::allclose(render_color(model, code * 30, view, animal, maps.mask, {})[0], rendered[i], 1e-3,
                          1e-5));
  }
  // What lies outside the silhouette does not enter the code.
  const Tensor other = encode_coats(model, colors * maps.mask + 0.7 * (1 - maps.mask), maps.mask, maps.nnopcs);
  CHECK(torch::equal(other, codes));
}

TEST_CASE("a camera that looks past the animal sees nothing") {
  Model model = small_model();
  const PosedAnimal animal = tiny_animal(model);
  CameraRecord camera = camera_of_size(64, 48);
  camera.cx += 10000;
  const AnimalView view = view_animal(model.geometry, animal, camera);
  CHECK(search_box(view, animal).empty());
  const ViewMaps maps = render_maps(model.geometry, view, animal, {});
  CHECK(maps.mask.sum().item<float>() == 0);
  CHECK(maps.depth.abs().max().item<float>() == 0);
  CHECK(torch::isfinite(encode_coats(model, torch::rand({1, 3, 48, 64}), maps.mask, maps.nnopcs)).all().item<bool>());
}

TEST_CASE("pose files are read, and broken ones refused in one sentence") {
  const test::TemporaryFile scratch("empty", "");
  const fs::path file = scratch.folder() / "pose.json";
  const CameraRecord camera = test::tiny_camera(3, {});
  const Tensor keypoints = torch::rand({4, 3});
  write_pose(file, keypoints, camera);
  const PoseFile pose = read_pose_file(file);
  CHECK(torch::allclose(pose.keypoints, keypoints));
  REQUIRE(pose.camera.has_value());
  CHECK(pose.camera->world_to_camera == camera.world_to_camera);
  CHECK(pose.camera->fx == camera.fx);
  CHECK(read_camera_file(file).width == camera.width);

  const std::string rotation =
      R"("world_to_camera": [[1,0,0,0],[0,1,0,0],[0,0,1,5]], "fy": 9, "cx": 1, "cy": 1, "height": 8)";
  const std::pair<std::string, std::string> broken[] = {
      {"[1, 2", "not valid JSON"},
      {"[1, 2]", "not a JSON object"},
      {R"({"keypoints": 3})", "not a list"},
      {R"({"keypoints": []})", "not a list"},
      {R"({"keypoints": [[1, 2, 3], [1, 2]]})", "keypoint 1: is not [x, y, z]"},
      {R"({"keypoints": [[1, null, 3]]})", "keypoint 0: is not a number within 1e9"},
      {R"({"keypoints": [[1, 1e300, 3]]})", "keypoint 0: is not a number within 1e9"},
      {R"({"keypoints": [[1, "a", 3]]})", "keypoint 0: is not a number within 1e9"},
      {R"({"camera": {"fx": 9}})", "no \"world_to_camera\""},
      {R"({"camera": {"world_to_camera": [1, 2, 3]}})", "not a 3 x 4 matrix"},
      {R"({"camera": {"world_to_camera": [[2,0,0,0],[0,1,0,0],[0,0,1,5]]}})", "no rotation"},
      {R"({"camera": {"world_to_camera": [[-1,0,0,0],[0,1,0,0],[0,0,1,5]]}})", "no rotation"},
      {"{\"camera\": {" + rotation + R"(, "fx": 0, "width": 8}})", "\"fx\""},
      {"{\"camera\": {" + rotation + R"(, "fx": 9}})", "no \"width\""},
      {"{\"camera\": {" + rotation + R"(, "fx": 9, "width": 7.5}})", "whole number of pixels"},
  };
  for (const auto& [text, message] : broken) {
    CAPTURE(text);
    write_file_atomically(file, text);
    const std::string said = test::message_of([&] { read_pose_file(file); });
    CHECK(said.find(message) != std::string::npos);
    CHECK(said.find("pose.json") != std::string::npos);
  }
}

TEST_CASE("render writes what the network says, for a pose file, a camera file and a stored code") {
  const test::TemporaryFile scratch("empty", "");
  const fs::path folder = scratch.folder();
  Model model = small_model();
  const PosedAnimal animal = tiny_animal(model);
  const CameraRecord camera = camera_of_size(48, 36);
  const AnimalView view = view_animal(model.geometry, animal, camera);
  shape_silhouette(model, view, 0.2);
  save_model(folder / "model.netepu", model, false);
  write_pose(folder / "pose.json", animal.keypoints, camera);
  CodeSet set;
  set.codes = torch::rand({2, 32}) * 10;
  set.views = {{1, 1, 0}, {1, 1, 1}};
  set.names = {"a", "b"};
  write_codes(folder / "codes.npy", set);

  RenderCommand command;
  command.model.model = folder / "model.netepu";
  command.pose = folder / "pose.json";
  command.code = folder / "codes.npy";
  command.code_row = 1;
  command.every_pixel = true;
  command.out = folder / "out";
  REQUIRE(run_render(command) == 0);
  const ViewMaps maps = render_maps(model.geometry, view, animal, every_pixel());
  const Image8 mask = decode_png8(folder / "out/mask.png");
  CHECK(mask.channels == 1);
  CHECK(torch::equal(tensor_of(mask)[0], maps.mask));
  const ExrImage depth = decode_exr(folder / "out/depth.exr"), nnopcs = decode_exr(folder / "out/nnopcs.exr");
  const auto plane = [](const ExrImage& exr, const char* name) {
    const int c = exr.channel(name);
    REQUIRE(c >= 0);
    return torch::tensor(exr.data[static_cast<std::size_t>(c)]).view({exr.height, exr.width});
  };
  CHECK(torch::allclose(plane(depth, exr_channel_names(Modality::depth)[0].c_str()), maps.depth, 1e-4, 1e-5));
  for (int c = 0; c < 3; ++c)
    CHECK(torch::allclose(plane(nnopcs, exr_channel_names(Modality::nnopcs)[static_cast<std::size_t>(c)].c_str()),
                          maps.nnopcs[c], 1e-4, 1e-5));
  CHECK(decode_png8(folder / "out/nnopcs.png").channels == 3);
  const Image8 color = decode_png8(folder / "out/color.png");
  REQUIRE(color.channels == 4);
  const Tensor expected = render_color(model, set.codes.slice(0, 1, 2), view, animal, maps.mask, {})[0];
  CHECK((tensor_of(color) - expected).abs().max().item<float>() < 0.003);
  for (int i = 0; i < 48; ++i) CHECK(color.at(i, 18, 3) == mask.at(i, 18));

  // Photo of the same pose: the code is that of its pixels, masked.
  write_png(folder / "photo.png", picture_of(torch::rand({3, 36, 48})));
  command.code.clear();
  command.photo = {folder / "photo.png", folder / "out/mask.png", folder / "pose.json"};
  command.out = folder / "photographed";
  command.width = 96;
  command.height = 72;
  REQUIRE(run_render(command) == 0);
  CHECK(decode_png8(folder / "photographed/color.png").width == 96);
  EmbedCommand embed_photo;
  embed_photo.model = command.model;
  embed_photo.photo = command.photo;
  embed_photo.photo_name = "Berta";
  embed_photo.out = folder / "photo.npy";
  REQUIRE(run_embed(embed_photo) == 0);
  CHECK(read_codes(folder / "photo.npy").names == std::vector<std::string>{"Berta"});

  // What is missing or too much is said.
  const auto said = [&](const std::function<void(RenderCommand&)>& change) {
    RenderCommand other = command;
    change(other);
    return test::message_of([&] { run_render(other); });
  };
  CHECK(said([](RenderCommand& c) { c.pose.clear(); }).find("no pose is given") != std::string::npos);
  CHECK(said([](RenderCommand& c) { c.frame = 3; }).find("numbers of a dataset") != std::string::npos);
  CHECK(said([&](RenderCommand& c) { c.code = folder / "codes.npy"; }).find("give one of them") != std::string::npos);
  CHECK(said([](RenderCommand& c) { c.photo.mask.clear(); }).find("--photo-mask") != std::string::npos);
  CHECK(said([](RenderCommand& c) { c.mask_cell = 3, c.every_pixel = false; }).find("power of two") !=
        std::string::npos);
  CHECK(said([](RenderCommand& c) { c.height = 0; }).find("--resolution") != std::string::npos);
  CHECK(said([](RenderCommand& c) { c.model.precision = "half"; }).find("neither float32 nor bfloat16") !=
        std::string::npos);
  CHECK(said([&](RenderCommand& c) {
          c.photo = {};
          c.code = folder / "codes.npy";
          c.code_row = 2;
        }).find("no row 2") != std::string::npos);
  write_png(folder / "small.png", picture_of(torch::ones({4, 4})));
  CHECK(said([&](RenderCommand& c) { c.photo.mask = folder / "small.png"; }).find("mask of the picture's size") !=
        std::string::npos);
  write_png(folder / "empty.png", picture_of(torch::zeros({36, 48})));
  CHECK(said([&](RenderCommand& c) { c.photo.mask = folder / "empty.png"; }).find("no pixel of the mask") !=
        std::string::npos);
  write_pose(folder / "pose.json", torch::rand({9, 3}), camera);
  CHECK(said([](RenderCommand&) {}).find("has 9 keypoints, the model 10") != std::string::npos);
}

TEST_CASE("a whole dataset: evaluated, embedded, identified, timed") {
  const test::TemporaryFile scratch("empty", "");
  const fs::path folder = scratch.folder();
  test::TinyOptions tiny;
  tiny.frames = 4;  // all in the test split
  tiny.rings = 1;
  tiny.coats = 2;
  test::write_tiny_dataset(folder / "data", tiny);
  Model model = small_model();
  const SampleSource source(folder / "data", {0, 1});

  EvaluateOptions options;
  options.views = {{2, 3, -1}, {4, 1, -1}};
  options.pictures = 1;
  options.refine = every_pixel();

  SUBCASE("figures are those worked out from the maps") {
    const PosedAnimal first = pose_animal(model.geometry, source.view({2, 3, -1}).keypoints, "frame");
    shape_silhouette(model, view_animal(model.geometry, first, camera_of(source.view({2, 3, -1}))), 0.2);
    const EvaluationResult r = evaluate(model, source, options);
    CHECK(r.views == 2);
    CHECK(r.frames == 2);
    CHECK(r.average.psnr.count == 4);
    double squared = 0, depth = 0, iou = 0, psnr_first = 0;
    for (const ViewId& id : options.views) {
      const FullView truth = source.view({id.frame, id.camera, 1});
      const PosedAnimal animal = pose_animal(model.geometry, truth.keypoints, "frame");
      const AnimalView view = view_animal(model.geometry, animal, camera_of(truth));
      CHECK(torch::allclose(view.batch.keypoints_2d[0], truth.keypoints_2d, 1e-4, 1e-5));
      const ViewMaps there = render_surface(model.geometry, view, truth.mask, {});
      const ViewMaps own = render_maps(model.geometry, view, animal, every_pixel());
      squared += ((there.nnopcs - truth.nnopcs).square().sum() / (3 * truth.mask.sum())).item<double>() / 2;
      depth += 1000 * ((there.depth - truth.depth).abs().sum() / truth.mask.sum()).item<double>() / 2;
      iou += ((own.mask * truth.mask).sum() / torch::maximum(own.mask, truth.mask).sum()).item<double>() / 2;
      const Tensor code = encode_coats(model, truth.color.unsqueeze(0), own.mask, own.nnopcs);
      const Tensor color = render_color(model, code, view, animal, truth.mask, {})[0];
      const double error =
          (((color - truth.color) * truth.mask).square().sum() / (3 * truth.mask.sum())).item<double>();
      psnr_first += -10 * std::log10(error) / 2;
    }
    CHECK(r.geometry.nnopcs_squared.value() == doctest::Approx(squared).epsilon(1e-4));
    CHECK(r.geometry.depth_mm.value() == doctest::Approx(depth).epsilon(1e-4));
    CHECK(r.geometry.iou.value() == doctest::Approx(iou).epsilon(1e-6));
    CHECK(r.per_coat[1].psnr.value() == doctest::Approx(psnr_first).epsilon(1e-4));
    CHECK(r.average.psnr.value() == doctest::Approx((r.per_coat[0].psnr.value() + r.per_coat[1].psnr.value()) / 2));
    CHECK_FALSE(r.geometry_picture.empty());
    CHECK(r.coat_pictures.size() == 1);
    write_evaluation(r, model, folder / "eval");
    const Json summary = parse_json_file(folder / "eval/summary.json"),
               results = parse_json_file(folder / "eval/results.json");
    CHECK(summary.at("figures").size() > 10);
    CHECK(results.at("geometry").at("nnopcs_mse").at("mean").get<double>() == doctest::Approx(squared).epsilon(1e-4));
    CHECK(results.at("color").at("coats").size() == 2);
    for (const char* name : {"table.md", "nnopcs.png", "coats1.png"}) CHECK(fs::exists(folder / "eval" / name));
  }

  SUBCASE("without an own silhouette the picture is all background") {
    set_parameter(*model.geometry, "head_silhouette.out_bias", torch::full({1}, -1e4));
    const EvaluationResult r = evaluate(model, source, options);
    CHECK(r.geometry.iou.value() == 0);
    CHECK(r.geometry.nnopcs_squared.count == 2);
    CHECK(r.geometry.nnopcs_squared_own.count == 0);
    CHECK(r.geometry.nnopcs_squared_own.skipped == 2);
    double expected = 0;
    for (const ViewId& id : options.views) {
      const FullView truth = source.view({id.frame, id.camera, 0});
      const double error =
          (((truth.color - test::tiny_background) * truth.mask).square().sum() / (3 * truth.mask.sum())).item<double>();
      expected += -10 * std::log10(error) / 2;
    }
    CHECK(r.per_coat[0].psnr_own.value() == doctest::Approx(expected).epsilon(0.01));  // the background is of 8 bits
    CHECK(r.per_coat[0].psnr_image.value() > r.per_coat[0].psnr_own.value());
  }

  SUBCASE("codes from another camera's picture, or from true maps, are other codes") {
    const PosedAnimal first = pose_animal(model.geometry, source.view({2, 3, -1}).keypoints, "frame");
    shape_silhouette(model, view_animal(model.geometry, first, camera_of(source.view({2, 3, -1}))), 0.2);
    set_parameter(*model.texture, "encoder_code_second.weight",
                  300 * model.texture->named_parameters()["encoder_code_second.weight"]);
    const double own = evaluate(model, source, options).average.psnr.value();
    EvaluateOptions other = options;
    other.code_camera_shift = 8;  // all around: the same camera
    CHECK(evaluate(model, source, other).average.psnr.value() == own);
    other.code_camera_shift = -1;
    CHECK(evaluate(model, source, other).average.psnr.value() != own);
    other = options;
    other.true_codes = true;
    CHECK(evaluate(model, source, other).average.psnr.value() != own);
  }

  SUBCASE("commands, from the checkpoint on") {
    const AnimalView view = view_animal(model.geometry, tiny_animal(model), test::tiny_camera(3, tiny));
    shape_silhouette(model, view, 0.2);
    save_model(folder / "model.netepu", model, false);
    EvalCommand eval;
    eval.model.model = folder / "model.netepu";
    eval.data.dataset = folder / "data";
    eval.data.max_views = 3;
    eval.out = folder / "eval";
    std::string printed;
    int most = 0;
    CommandTools tools;
    tools.print = [&](const std::string& text) { printed += text; };
    tools.progress = [&](std::size_t done, std::size_t, const std::string& stage) {
      if (stage == "evaluating") most = static_cast<int>(done);
    };
    CHECK(run_eval(eval, tools) == 0);
    CHECK(most == 3);
    CHECK(printed.find("3 views x 2 coats = 6 images") != std::string::npos);
    eval.enforce = true;
    CHECK(run_eval(eval, tools) == 1);  // nobody trained it
    eval.data.split = "train";
    CHECK(test::message_of([&] { run_eval(eval, tools); }).find("train split has no frames") != std::string::npos);
    eval.data.split = "half";
    CHECK(test::message_of([&] { run_eval(eval, tools); }).find("none of train") != std::string::npos);

    EmbedCommand command;
    command.model = eval.model;
    command.data.dataset = folder / "data";
    command.out = folder / "codes.npy";
    CHECK(run_embed(command, tools) == 0);
    const CodeSet set = read_codes(folder / "codes.npy");
    CHECK(set.codes.sizes() == torch::IntArrayRef({4 * 8 * 2, 32}));
    CHECK((set.views[1] == ViewId{1, 0, 1}));
    CHECK(set.names[1] == "coat_1");
    IdentifyCommand identify;
    identify.queries = folder / "codes.npy";
    identify.out = folder / "identification";
    CHECK(run_identify(identify, tools) == 0);
    CHECK(fs::exists(folder / "identification/summary.json"));

    RenderCommand render;
    render.model = eval.model;
    render.dataset = folder / "data";
    render.frame = 2;
    render.camera = 5;
    render.coat = 1;
    render.coat_camera = 0;
    render.out = folder / "view";
    CHECK(run_render(render, tools) == 0);
    CHECK(decode_png8(folder / "view/color.png").width == tiny.width);
    render.frame = 77;
    CHECK(test::message_of([&] { run_render(render, tools); }).find("77") != std::string::npos);

    SpeedCommand speed;
    speed.model = eval.model;
    speed.data.dataset = folder / "data";
    speed.width = 64;
    speed.height = 48;
    speed.views = 2;
    speed.repeats = 1;
    speed.out = folder / "speed";
    CHECK(run_speed(speed, tools) == 0);
    const Json timed = parse_json_file(folder / "speed/speed.json");
    CHECK(timed.at("variants").size() >= 3);
    CHECK(timed.at("variants")[1].at("points_evaluated").get<double>() <
          timed.at("variants")[0].at("points_evaluated").get<double>());
  }

  SUBCASE("a model of another number of keypoints, or without texture, is refused") {
    Model other = small_model(small_config(9));
    CHECK(test::message_of([&] { evaluate(other, source, options); }).find("10 keypoints a frame, the model 9") !=
          std::string::npos);
    model.texture = nullptr;
    CHECK(test::message_of([&] { evaluate(model, source, options); }).find("geometry only") != std::string::npos);
    options.color = false;
    CHECK(evaluate(model, source, options).average.psnr.count == 0);
  }

  SUBCASE("a dataset without NNOPCS is refused by a model that has them") {
    tiny.nnopcs = false;
    test::write_tiny_dataset(folder / "bare", tiny);
    const SampleSource bare(folder / "bare", {0, 1});
    CHECK(test::message_of([&] { evaluate(model, bare, options); }).find("no NNOPCS maps") != std::string::npos);
    NetepuConfig config = small_config();
    config.model.nnopcs = false;
    Model plain = small_model(config);
    const EvaluationResult r = evaluate(plain, bare, options);
    CHECK(r.geometry.nnopcs_squared.count == 0);
    CHECK(r.average.psnr.count == 4);
    CHECK_FALSE(to_json(r).at("geometry").contains("nnopcs_mse"));
  }
}

TEST_CASE("views are chosen by step and number, each once") {
  const std::vector<int> frames{1, 2, 3, 4, 5, 6}, cameras{0, 1, 2, 3};
  CHECK(chosen_views(frames, cameras, 1, 1, 0).size() == 24);
  const std::vector<ViewId> some = chosen_views(frames, cameras, 2, 3, 0);
  CHECK(some.size() == 6);
  CHECK((some[1] == ViewId{1, 3, -1}));
  const std::vector<ViewId> few = chosen_views(frames, cameras, 1, 1, 7);
  CHECK(few.size() == 7);
  for (std::size_t i = 1; i < few.size(); ++i)
    CHECK(few[i - 1].frame * 4 + few[i - 1].camera < few[i].frame * 4 + few[i].camera);
  CHECK(chosen_views(frames, cameras, 1, 1, 99).size() == 24);
  CHECK_THROWS_AS(chosen_views(frames, cameras, 0, 1, 0), InputError);
}
