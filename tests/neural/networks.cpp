#include "neural/networks.h"

#include "tests/neural/doctest_torch.h"

using namespace moomill;
using torch::Tensor;

namespace {

ModelConfig small_model(int keypoints = 7) {
  ModelConfig c;
  c.keypoints = keypoints;
  c.local_features = 32, c.global_features = 24, c.head_width = 16, c.head_blocks = 2, c.encoder_blocks = 1;
  c.keypoint_bottleneck = 12, c.near_neighbours = 3, c.neighbours = 4;
  c.image_channels = {8, 16}, c.image_blocks = 1;
  c.surface_octaves = 3;
  return c;
}

struct Inputs {
  Tensor keypoints, points, images;
  CameraBatch camera;
};

Inputs random_inputs(int b, int k, int m) {
  Inputs in;
  in.keypoints = torch::randn({b, k, 3}) * 0.7;
  in.points = torch::rand({b, m, 2});
  in.images = torch::rand({b, 6, 24, 32});
  in.camera.keypoints_2d = torch::rand({b, k, 2});
  const Tensor pose = torch::tensor({{0.0f, 1.0f, 0.0f, 0.1f}, {0.0f, 0.0f, -1.0f, 0.2f}, {-1.0f, 0.0f, 0.0f, 10.0f}});
  in.camera.world_to_camera = pose.expand({b, 3, 4}).contiguous();
  return in;
}

// Heads begin with zero second layers; without them a part of the network would be silent in a comparison.
void wake(torch::nn::Module& module) {
  torch::NoGradGuard fixed;
  for (auto& p : module.named_parameters())
    if (p.key().find("second_weight") != std::string::npos) p.value().normal_(0, 0.2);
}

double relative(const Tensor& a, const Tensor& b) {
  return (a - b).abs().max().item<double>() / std::max(1e-20, b.abs().max().item<double>());
}

// Every output of both networks, and the gradient of every parameter of a fixed mixture of them.
std::pair<std::vector<Tensor>, std::map<std::string, Tensor>> run(GeometryNetwork& g, TextureNetwork& t, const Inputs& in, bool fused) {
  g->evaluation.fused = t->evaluation.fused = fused;
  g->zero_grad(), t->zero_grad();
  const Pose3d pose = g->encode(in.keypoints);
  const ViewFeatures view = g->view(pose, in.camera);
  const Tensor features = g->attend(view, in.points);
  const TextureCode code = t->encode(in.images);
  const ViewFeatures texture_view = t->view(code.mean, pose, in.camera);
  std::vector<Tensor> outputs{pose.code, pose.keypoints, pose.features, g->silhouette(features), g->depth(features), g->nnopcs(features),
                              code.mean, code.logvar,    t->color(texture_view, in.points, g->nnopcs(features))};
  Tensor sum = torch::zeros({});
  double weight = 1;
  for (const Tensor& o : outputs) sum = sum + (o * torch::arange(o.numel()).view(o.sizes()).cos()).mean() * (weight += 0.37);
  sum.backward();
  std::map<std::string, Tensor> gradients;
  for (auto& p : g->named_parameters())
    if (p.value().grad().defined()) gradients["geometry." + p.key()] = p.value().grad().clone();
  for (auto& p : t->named_parameters())
    if (p.value().grad().defined()) gradients["texture." + p.key()] = p.value().grad().clone();
  return {outputs, gradients};
}

}  // namespace

TEST_CASE("at paper sizes the networks have as many parameters as the public code") {
  const ModelConfig paper;
  CHECK(count_parameters(*GeometryNetwork(paper)) == 46501840);
  CHECK(count_parameters(*TextureNetwork(paper)) == 52764611);
}

TEST_CASE("fused and plain networks agree in every output and in the gradient of every parameter") {
  torch::manual_seed(3);
  for (const int k : {3, 7, 25}) {  // of one keypoint a batch norm sees equal values, and would blow up their rounding
    GeometryNetwork g(small_model(k));
    TextureNetwork t(small_model(k));
    wake(*g), wake(*t);
    const Inputs in = random_inputs(5, k, 33);
    const auto [plain, plain_gradients] = run(g, t, in, false);
    const auto [fused, fused_gradients] = run(g, t, in, true);
    for (std::size_t i = 0; i < plain.size(); ++i) {
      INFO("output " << i << " with " << k << " keypoints");
      CHECK(relative(fused[i], plain[i]) < 1e-4);  // a dozen layers deep, batch norms among them
    }
    REQUIRE(plain_gradients.size() > 150);
    double largest = 0;
    for (const auto& [name, gradient] : plain_gradients) largest = std::max(largest, gradient.abs().max().item<double>());
    for (const auto& [name, gradient] : plain_gradients) {
      REQUIRE_MESSAGE(fused_gradients.contains(name), name);
      INFO(name << " with " << k << " keypoints");
      // The bias of a softmax's logits changes nothing: its gradient is rounding in one and zero in the other.
      if (name.ends_with("weights.second.bias")) continue;
      const double scale = std::max(gradient.abs().max().item<double>(), 1e-3 * largest);
      CHECK((fused_gradients.at(name) - gradient).abs().max().item<double>() < 2e-3 * scale);
    }
  }
}

TEST_CASE("one keypoint has no depth range, and still every output is finite") {
  torch::manual_seed(4);
  GeometryNetwork g(small_model(1));
  g->eval();
  const Inputs in = random_inputs(1, 1, 9);
  const ViewFeatures view = g->view(g->encode(in.keypoints), in.camera);
  CHECK(view.depth_range.item<double>() == doctest::Approx(minimum_depth_range));
  const Tensor features = g->attend(view, in.points);
  for (const Tensor& o : {g->silhouette(features), g->depth(features), g->nnopcs(features)})
    CHECK(torch::isfinite(o).all().item<bool>());
}

TEST_CASE("coincident keypoints, huge coordinates and a not-a-number stay what they are") {
  torch::manual_seed(5);
  GeometryNetwork g(small_model());
  g->eval();
  Inputs in = random_inputs(2, 7, 9);
  const auto outputs = [&](const Tensor& keypoints) {
    const ViewFeatures view = g->view(g->encode(keypoints), in.camera);
    const Tensor features = g->attend(view, in.points);
    return torch::cat({g->silhouette(features), g->depth(features), g->nnopcs(features).flatten(1)}, 1);
  };
  CHECK(torch::isfinite(outputs(torch::zeros({2, 7, 3}))).all().item<bool>());
  CHECK(torch::isfinite(outputs(in.keypoints * 1e6)).all().item<bool>());
  Tensor broken = in.keypoints.clone();
  broken[0][3][1] = NAN;
  const Tensor out = outputs(broken);
  CHECK(torch::isnan(out[0]).all().item<bool>());      // the frame it is in
  CHECK(torch::isfinite(out[1]).all().item<bool>());   // and no other
}

TEST_CASE("a constant picture has a finite code, and micro-batches of one evaluate") {
  torch::manual_seed(6);
  TextureNetwork t(small_model());
  for (const double value : {0.0, 1.0}) {
    t->train();
    const TextureCode code = t->encode(torch::full({2, 6, 24, 32}, value));
    CHECK(torch::isfinite(code.mean).all().item<bool>());
    CHECK(torch::isfinite(code.logvar).all().item<bool>());
  }
  t->eval();
  CHECK(torch::isfinite(t->encode(torch::rand({1, 6, 3, 3})).mean).all().item<bool>());
}
