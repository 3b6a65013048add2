#include "neural/training.h"

#include "generator/core/error.h"
#include "neural/training_loop.h"
#include "tests/neural/doctest_torch.h"
#include "tests/neural/tiny_dataset.h"

using namespace moomill;
using torch::Tensor;
namespace fs = std::filesystem;

namespace {

// Sixty frames, so that every split has some; eight cameras.
struct Tiny {
  test::TemporaryFolder folder;
  std::unique_ptr<SampleSource> source;
  Tiny() {
    test::TinyOptions options;
    options.frames = 60, options.rings = 1;
    test::write_tiny_dataset(folder.path / "data", options);
    source = std::make_unique<SampleSource>(folder.path / "data", std::vector<int>{0, 1, 2});
  }
  fs::path run(const std::string& name) const { return folder.path / name; }
};

NetepuConfig small_config(const SampleSource& source) {
  NetepuConfig c;
  ModelConfig& m = c.model;
  m.keypoints = source.keypoint_count();
  m.local_features = 32, m.global_features = 32, m.head_width = 32, m.head_blocks = 2, m.encoder_blocks = 1;
  m.keypoint_bottleneck = 32, m.near_neighbours = 4, m.neighbours = 6;
  m.image_channels = {8, 16}, m.image_blocks = 1;
  m.position_gradient = false;
  c.geometry.batch = 8, c.geometry.epochs = 4, c.geometry.validate_every = 2;
  c.geometry.silhouette_points = 48, c.geometry.surface_points = 32;
  c.texture.batch = 8, c.texture.epochs = 4, c.texture.validate_every = 2, c.texture.surface_points = 32;
  for (OptimiserConfig* o : {&c.geometry.optimiser, &c.texture.optimiser}) o->schedule.rate = 2e-3;
  return c;
}

struct Log {
  std::vector<std::string> lines;
  TrainingControl control;
  explicit Log(std::int64_t max_steps = 0) {
    control.log = [this](const std::string& line) { lines.push_back(line); };
    control.max_steps = max_steps;
  }
};

std::map<std::string, Tensor> tensors_of(const fs::path& file) {
  return read_tensor_file(file).tensors;
}

void check_same(const fs::path& a, const fs::path& b) {
  const auto first = tensors_of(a), second = tensors_of(b);
  REQUIRE(first.size() == second.size());
  REQUIRE(first.size() > 100);
  for (const auto& [name, tensor] : first) {
    INFO(name);
    CHECK(torch::equal(tensor, second.at(name)));
  }
}

std::string message_of(const std::function<void()>& run) {
  try {
    run();
  } catch (const std::exception& e) {
    return e.what();
  }
  return "";
}

Batch first_batch(const SampleSource& source, const NetepuConfig& c, bool color) {
  SampleOptions o;
  o.batch = 6;
  o.silhouette_points = color ? 0 : c.geometry.silhouette_points;
  o.surface_points = 48;
  o.color = color;
  return source.batch(o, 0, 0);
}

}  // namespace

TEST_CASE("agreement of codes: worked out by hand, and its extremes") {
  // Directions: two of coat 0 along x, one of coat 1 along y. Each of the two sees likeness 10 of its partner and 0 of the other.
  const torch::Tensor codes = torch::tensor({{2.0, 0.0}, {5.0, 0.0}, {0.0, 3.0}}, torch::kDouble);
  CHECK(agreement_loss(codes, {0, 0, 1}).item<double>() == doctest::Approx(std::log1p(std::exp(-10.0))).epsilon(1e-6));
  CHECK(agreement_loss(codes, {0, 1, 0}).item<double>() == doctest::Approx(0.5 * (10 + std::log1p(std::exp(-10.0)) + std::log(2.0))).epsilon(1e-6));
  CHECK(agreement_loss(codes, {0, 1, 2}).item<double>() == 0);
  CHECK(agreement_loss(codes.slice(0, 0, 1), {4}).item<double>() == 0);
  for (const double size : {0.0, 1e-20, 1e15}) {
    torch::Tensor extreme = (codes * size).to(torch::kFloat).requires_grad_();
    const torch::Tensor loss = agreement_loss(extreme, {0, 0, 1});
    loss.backward();
    CHECK(std::isfinite(loss.item<double>()));
    CHECK(extreme.grad().isfinite().all().item<bool>());
  }
  torch::Tensor random = torch::randn({9, 4}, torch::kDouble).requires_grad_();
  const std::vector<int> coats{0, 1, 2, 0, 1, 2, 0, 3, 3};
  CHECK(torch::autograd::grad({agreement_loss(random, coats)}, {random})[0].isfinite().all().item<bool>());
  const torch::Tensor slope = torch::autograd::grad({agreement_loss(random, coats)}, {random})[0], step = torch::randn_like(random);
  const double h = 1e-6;
  torch::NoGradGuard fixed;
  const double measured = (agreement_loss(random + h * step, coats) - agreement_loss(random - h * step, coats)).item<double>() / (2 * h);
  CHECK((slope * step).sum().item<double>() == doctest::Approx(measured).epsilon(1e-5));
}

TEST_CASE("the geometry network learns one batch by heart") {
  const Tiny tiny;
  NetepuConfig c = small_config(*tiny.source);
  torch::manual_seed(1);
  GeometryNetwork network(c.model);
  c.geometry.nnopcs_weight = 100, c.geometry.code_weight = 0;
  const Batch batch = first_batch(*tiny.source, c, false);
  torch::optim::AdamW optimiser(network->parameters(), torch::optim::AdamWOptions(3e-3).weight_decay(0));
  GeometryLosses first, last;
  constexpr int steps = 700;
  for (int i = 0; i < steps; ++i) {
    static_cast<torch::optim::AdamWOptions&>(optimiser.param_groups()[0].options()).lr(3e-3 * (1 - i / (steps + 1.0)));
    optimiser.zero_grad();
    last = geometry_losses(predict(network, batch), batch, c);
    if (i == 0) first = last;
    last.total().backward();
    optimiser.step();
  }
  MESSAGE("silhouette " << last.silhouette.item<double>() / 3 << ", keypoints " << last.keypoints.item<double>() / 2 << ", depth "
                        << last.depth.item<double>() << ", NNOPCS " << last.nnopcs.item<double>() / 100);
  CHECK(last.silhouette.item<double>() / 3 < 0.02);  // mean cross-entropy; log 2 = 0.69 for a guess
  CHECK(last.keypoints.item<double>() / 2 < 0.003);  // 9 mm
  CHECK(last.depth.item<double>() < 0.05 * first.depth.item<double>());
  CHECK(last.nnopcs.item<double>() / 100 < 1e-4);
}

TEST_CASE("the texture networks learn one batch by heart") {
  const Tiny tiny;
  const NetepuConfig c = small_config(*tiny.source);
  torch::manual_seed(2);
  GeometryNetwork geometry(c.model);
  geometry->eval();
  TextureNetwork texture(c.model);
  const Batch batch = first_batch(*tiny.source, c, true);
  torch::optim::AdamW optimiser(texture->parameters(), torch::optim::AdamWOptions(3e-3).weight_decay(0));
  double first = 0, last = 0;
  constexpr int steps = 500;
  for (int i = 0; i < steps; ++i) {
    static_cast<torch::optim::AdamWOptions&>(optimiser.param_groups()[0].options()).lr(3e-3 * (1 - i / (steps + 1.0)));
    optimiser.zero_grad();
    const TextureLosses l = texture_losses(geometry, texture, batch, c.texture, {});
    l.total().backward();
    optimiser.step();
    last = l.color.item<double>() / c.texture.color_weight;
    if (i == 0) first = last;
  }
  MESSAGE("colour error " << first << " -> " << last);
  CHECK(last < 3e-4);  // 35 dB
  CHECK(last < 0.02 * first);
}

TEST_CASE("a resumed run equals an uninterrupted one, bit for bit, in both stages") {
  const Tiny tiny;
  const NetepuConfig c = small_config(*tiny.source);
  Log whole, part(3), rest;
  CHECK(train_geometry(*tiny.source, c, tiny.run("whole"), whole.control) == TrainingEnd::finished);
  CHECK(train_geometry(*tiny.source, c, tiny.run("parts"), part.control) == TrainingEnd::stopped);
  CHECK(train_geometry(*tiny.source, c, tiny.run("parts"), part.control) == TrainingEnd::stopped);
  CHECK(train_geometry(*tiny.source, c, tiny.run("parts"), rest.control) == TrainingEnd::finished);
  check_same(tiny.run("whole") / "state.netepu", tiny.run("parts") / "state.netepu");
  check_same(tiny.run("whole") / "model.netepu", tiny.run("parts") / "model.netepu");
  for (const char* file : {"scalars.csv", "curves.svg", "error.svg", "config.json"}) CHECK(fs::file_size(tiny.run("parts") / file) > 100);
  // Prolonged: goes on with the schedule of the longer run.
  NetepuConfig longer = c;
  longer.geometry.epochs = 6;
  Log more;
  CHECK(train_geometry(*tiny.source, longer, tiny.run("parts"), more.control) == TrainingEnd::finished);
  CHECK(more.lines.front().starts_with("going on in epoch 5 of 6"));
  Log again;
  CHECK(train_geometry(*tiny.source, c, tiny.run("whole"), again.control) == TrainingEnd::finished);
  CHECK(again.lines.back() == "finished before; nothing to do");

  const fs::path geometry = tiny.run("whole") / "model.netepu";
  NetepuConfig micro = c;
  micro.texture.micro_batch = 3;
  CHECK(train_texture(*tiny.source, micro, geometry, tiny.run("texture"), whole.control) == TrainingEnd::finished);
  CHECK(train_texture(*tiny.source, micro, geometry, tiny.run("texture parts"), part.control) == TrainingEnd::stopped);
  CHECK(train_texture(*tiny.source, micro, geometry, tiny.run("texture parts"), rest.control) == TrainingEnd::finished);
  check_same(tiny.run("texture") / "state.netepu", tiny.run("texture parts") / "state.netepu");
  CHECK_THROWS_WITH_AS(train_texture(*tiny.source, micro, tiny.run("parts") / "model.netepu", tiny.run("texture"), rest.control),
                       doctest::Contains("was trained on another geometry model"), InputError);
  const Model model = load_model(tiny.run("texture") / "model.netepu");
  CHECK(model.coat_names == tiny.source->coat_names());
  CHECK_FALSE(model.texture.is_empty());
}

// Of the texture stage only the same number of threads gives the same weights: the convolutions of LibTorch (oneDNN) sum their
// weight gradients by thread.
TEST_CASE("one thread and two give the same weights of the geometry") {
  const Tiny tiny;
  NetepuConfig c = small_config(*tiny.source);
  c.geometry.epochs = 2;
  const int before = at::get_num_threads();
  for (const int threads : {1, 2}) {
    at::set_num_threads(threads);
    Log log;
    const std::string name = std::to_string(threads);
    train_geometry(*tiny.source, c, tiny.run("g" + name), log.control);
  }
  at::set_num_threads(before);
  check_same(tiny.run("g1") / "state.netepu", tiny.run("g2") / "state.netepu");
}

TEST_CASE("a diverging run ends in a sentence that says where, and keeps what was saved") {
  const Tiny tiny;
  NetepuConfig c = small_config(*tiny.source);
  c.geometry.epochs = 40;
  c.geometry.optimiser.schedule.rate = 1e4;
  Log log;
  const std::string said = message_of([&] { train_geometry(*tiny.source, c, tiny.run("wild"), log.control); });
  INFO(said);
  CHECK(said.find("diverged in epoch ") != std::string::npos);
  CHECK(said.find(", step ") != std::string::npos);
  CHECK(said.find("lower [geometry] rate") != std::string::npos);
  if (fs::exists(tiny.run("wild") / "state.netepu"))
    for (const auto& [name, tensor] : tensors_of(tiny.run("wild") / "state.netepu"))
      if (tensor.is_floating_point()) CHECK(torch::isfinite(tensor).all().item<bool>());
}

TEST_CASE("a not-a-number in the data stops the run at once and names the term") {
  const Tiny tiny;
  const NetepuConfig c = small_config(*tiny.source);
  torch::manual_seed(1);
  GeometryNetwork network(c.model);
  Stage stage;
  stage.name = "geometry";
  stage.module = network.get();
  stage.groups = network->clip_groups();
  stage.samples.batch = 8, stage.samples.silhouette_points = 16, stage.samples.surface_points = 16;
  stage.accumulate = [&](const Batch& clean, std::int64_t) {
    Batch b = clean;
    b.nnopcs[2][3][1] = NAN;
    const GeometryLosses l = geometry_losses(predict(network, b), b, c);
    l.total().backward();
    return Scalars{{"silhouette", l.silhouette.item<double>()}, {"nnopcs", l.nnopcs.item<double>()}};
  };
  Log log;
  const auto before = network->parameters().front().clone();
  const std::string said = message_of([&] { run_training(*tiny.source, c, stage, tiny.run("nan"), log.control); });
  CHECK(said.find("diverged in epoch 1, step 0") != std::string::npos);
  CHECK(said.find("the term 'nnopcs' is not finite") != std::string::npos);
  CHECK(torch::equal(before, network->parameters().front()));
}

TEST_CASE("a run is not continued with another configuration, another stage's state or a broken one") {
  const Tiny tiny;
  NetepuConfig c = small_config(*tiny.source);
  Log one(1);
  train_geometry(*tiny.source, c, tiny.run("r"), one.control);
  NetepuConfig other = c;
  other.geometry.batch = 4;
  CHECK(message_of([&] { train_geometry(*tiny.source, other, tiny.run("r"), one.control); }).find("another 'geometry.batch'") != std::string::npos);
  other = c;
  other.model.head_blocks = 3;
  CHECK(message_of([&] { train_geometry(*tiny.source, other, tiny.run("r"), one.control); }).find("another 'model.head_blocks'") != std::string::npos);
  fs::resize_file(tiny.run("r") / "state.netepu", 5000);
  CHECK(message_of([&] { train_geometry(*tiny.source, c, tiny.run("r"), one.control); }).find("cut short") != std::string::npos);
  other = c;
  other.model.keypoints = 12;
  CHECK(message_of([&] { train_geometry(*tiny.source, other, tiny.run("k"), one.control); }).find("set [model] keypoints = 10") != std::string::npos);
}

TEST_CASE("extreme log-variances stay finite, and the divergence is that of normal distributions") {
  const Tiny tiny;
  const NetepuConfig c = small_config(*tiny.source);
  torch::manual_seed(3);
  GeometryNetwork geometry(c.model);
  geometry->eval();
  TextureNetwork texture(c.model);
  const Batch batch = first_batch(*tiny.source, c, true);
  const int z = c.model.global_features;
  for (const double logvar : {-1e30, -1e4, -1.0, 0.0, 1.0, 1e4, 1e30}) {
    torch::NoGradGuard fixed;
    for (auto& p : texture->named_parameters())
      if (p.key() == "encoder_code_second.weight") p.value().zero_();
      else if (p.key() == "encoder_code_second.bias") p.value().slice(0, 0, z).fill_(0.5), p.value().slice(0, z, 2 * z).fill_(logvar);
    const TextureLosses l = texture_losses(geometry, texture, batch, c.texture, keyed_normal(5, {6, z}));
    INFO(logvar);
    CHECK(torch::isfinite(l.color).item<bool>());
    CHECK(torch::isfinite(l.divergence).item<bool>());
    const double seen = std::clamp(logvar < 0 ? 0.1 * logvar : logvar, least_logvar, greatest_logvar);  // leaky ReLU, then the clamp
    const double expected = 0.5 * (std::exp(seen) + 0.25 - 1 - seen) * 6 * z;
    CHECK(l.divergence.item<double>() / c.texture.divergence_weight == doctest::Approx(expected).epsilon(1e-4));
  }
}

TEST_CASE("the learning rate decays by epochs, rises first and can end in a cosine") {
  RateSchedule s;
  s.rate = 1, s.decay_factor = 0.2, s.decay_epochs = 10;
  CHECK(rate_of(s, 0, 5, 100) == 1);
  CHECK(rate_of(s, 49, 5, 100) == 1);
  CHECK(rate_of(s, 50, 5, 100) == doctest::Approx(0.2));
  CHECK(rate_of(s, 149, 5, 100) == doctest::Approx(0.04));
  s.decay_epochs = 0, s.warmup_steps = 4, s.final_share = 0.1;
  CHECK(rate_of(s, 0, 5, 4) == doctest::Approx(0.25));
  CHECK(rate_of(s, 4, 5, 4) == doctest::Approx(1));
  CHECK(rate_of(s, 19, 5, 4) == doctest::Approx(0.1));
}

TEST_CASE("keyed normal numbers are standard normal and the same every time") {
  const Tensor a = keyed_normal(7, {200, 500});
  CHECK(torch::equal(a, keyed_normal(7, {200, 500})));
  CHECK_FALSE(torch::equal(a, keyed_normal(8, {200, 500})));
  CHECK(std::abs(a.mean().item<double>()) < 0.015);                         // 4.7 standard errors
  CHECK(a.var().item<double>() == doctest::Approx(1).epsilon(0.022));       // 4.9 standard errors
}
