#include "neural/samples.h"

#include <omp.h>

#include <set>

#include "tests/neural/doctest_torch.h"
#include "tests/neural/tiny_dataset.h"

using namespace moomill;
using namespace moomill::test;

namespace {

torch::Tensor matrix_of(const CameraRecord& c) {
  return torch::tensor(std::vector<double>(c.world_to_camera.begin(), c.world_to_camera.end())).reshape({3, 4});
}

// Every tensor of a batch, to compare whole batches.
std::vector<torch::Tensor> tensors(const Batch& b) {
  std::vector<torch::Tensor> out{b.keypoints,   b.noisy_keypoints,   b.keypoints_2d, b.world_to_camera, b.near_depth,
                                 b.depth_range, b.silhouette_points, b.silhouette,   b.surface_points,  b.depth};
  for (const torch::Tensor& t : {b.nnopcs, b.color, b.images})
    if (t.defined()) out.push_back(t);
  return out;
}

bool same(const Batch& a, const Batch& b) {
  const auto x = tensors(a), y = tensors(b);
  if (a.views != b.views || x.size() != y.size()) return false;
  for (std::size_t i = 0; i < x.size(); ++i)
    if (!torch::equal(x[i], y[i])) return false;
  return true;
}

SampleOptions all_options() {
  SampleOptions o;
  o.batch = 8;
  o.views_per_frame = 3;
  o.silhouette_points = 40;
  o.surface_points = 50;
  o.keypoint_noise_m = 0.003;
  o.turn_cameras = true;
  o.color = true;
  o.encoder = {13, 9};
  return o;
}

float value(const torch::Tensor& t, std::initializer_list<std::int64_t> place) {
  const float* v = t.data_ptr<float>();
  int axis = 0;
  for (const std::int64_t i : place) v += i * t.stride(axis++);
  return *v;
}

std::string input_message(const std::function<void()>& body) {
  return message_of<InputError>(body);
}

void check_message(const std::string& message, std::initializer_list<std::string> parts) {
  for (const std::string& part : parts) {
    INFO(message);
    CHECK(message.find(part) != std::string::npos);
  }
  CHECK(message.find('\n') == std::string::npos);
}

bool is_animal(const torch::Tensor& mask, int x, int y) {
  return x >= 0 && y >= 0 && x < mask.size(1) && y < mask.size(0) && value(mask, {y, x}) == 1;
}

}  // namespace

TEST_CASE("surface points of a batch carry the analytic depth, NNOPCS and colour") {
  const TemporaryFolder folder;
  const TinyOptions tiny{.frames = 20};
  write_tiny_dataset(folder / "data", tiny);
  const SampleSource source(folder / "data", {0, 1, 2});
  CHECK(source.keypoint_count() == 10);
  CHECK(source.width() == 32);
  CHECK(source.cameras().size() == 24);
  CHECK(source.coat_names() == std::vector<std::string>{"coat_0", "coat_1", "coat_2"});
  SampleOptions o = all_options();
  o.turn_cameras = false;
  o.keypoint_noise_m = 0.01;
  double color_error = 0, noise = 0;
  int points = 0, noises = 0;
  std::set<int> coats;
  for (int n = 0; n < source.batches_per_epoch(o); ++n) {
    const Batch b = source.batch(o, 0, n);
    for (std::size_t i = 0; i < b.views.size(); ++i) {
      const TinyPose pose = tiny_pose(b.views[i].frame);
      const CameraRecord c = tiny_camera(b.views[i].camera, tiny);
      coats.insert(b.views[i].coat);
      CHECK(torch::allclose(b.world_to_camera[i], matrix_of(c).to(torch::kFloat32)));
      double nearest = 1e9, farthest = -1e9;
      const std::vector<dvec3> keypoints = tiny_keypoints(pose);
      for (int k = 0; k < 10; ++k) {
        const dvec3 q = tiny_to_camera(c, keypoints[k]);
        nearest = std::min(nearest, q.z);
        farthest = std::max(farthest, q.z);
        CHECK(value(b.keypoints_2d, {int(i), k, 0}) == doctest::Approx((c.fx * q.x / q.z + c.cx) / 32).epsilon(1e-6));
        CHECK(value(b.keypoints_2d, {int(i), k, 1}) == doctest::Approx((c.fy * q.y / q.z + c.cy) / 24).epsilon(1e-6));
        for (int d = 0; d < 3; ++d) {
          CHECK(value(b.keypoints, {int(i), k, d}) == static_cast<float>(keypoints[k][d]));
          noise += std::pow(value(b.noisy_keypoints, {int(i), k, d}) - keypoints[k][d], 2);
          ++noises;
        }
      }
      const double near = value(b.near_depth, {int(i)}), range = value(b.depth_range, {int(i)});
      CHECK(near == doctest::Approx(nearest).epsilon(1e-6));
      CHECK(range == doctest::Approx(farthest - nearest).epsilon(1e-6));
      for (int p = 0; p < o.surface_points; ++p) {
        const double x = value(b.surface_points, {int(i), p, 0}) * 32, y = value(b.surface_points, {int(i), p, 1}) * 24;
        CHECK(std::abs(x - std::floor(x) - 0.5) < 1e-4);
        const std::optional<TinyHit> hit = tiny_trace(pose, c, x, y);
        REQUIRE(hit.has_value());
        // A ray that grazes the ellipsoid moves far with the rounding of x.
        CHECK(std::abs(value(b.depth, {int(i), p}) * range + near - hit->depth) < 1e-3);
        for (int d = 0; d < 3; ++d) {
          CHECK(std::abs(value(b.nnopcs, {int(i), p, d}) - hit->nnopcs[d]) < 1e-3);
          color_error += std::abs(value(b.color, {int(i), p, d}) - tiny_color(b.views[i].coat, hit->nnopcs)[d]);
          ++points;
        }
      }
    }
  }
  CHECK(coats == std::set<int>{0, 1, 2});
  CHECK(color_error / points < 0.02);  // JPEG
  CHECK(std::sqrt(noise / noises) == doctest::Approx(0.01).epsilon(0.1));
}

TEST_CASE("a turned camera sees the turned keypoints and the turned animal") {
  const TemporaryFolder folder;
  const TinyOptions tiny{.frames = 20, .coats = 0};
  write_tiny_dataset(folder / "data", tiny);
  const SampleSource source(folder / "data", {});
  SampleOptions o;
  o.batch = 12;
  o.views_per_frame = 8;
  o.surface_points = 20;
  o.turn_cameras = true;
  std::array<int, 8> seen{};
  for (int n = 0; n < source.batches_per_epoch(o); ++n) {
    const Batch b = source.batch(o, 3, n);
    for (std::size_t i = 0; i < b.views.size(); ++i) {
      const TinyPose pose = tiny_pose(b.views[i].frame);
      const std::vector<dvec3> keypoints = tiny_keypoints(pose);
      const auto turn = [](const dvec3& p, int k) {
        const double c = std::cos(k * pi / 4), s = std::sin(k * pi / 4);
        return dvec3(c * p.x - s * p.y, s * p.x + c * p.y, p.z);
      };
      int found = -1;  // the turn that the keypoints have
      for (int k = 0; k < 8; ++k) {
        double worst = 0;
        for (int j = 0; j < 10; ++j)
          for (int d = 0; d < 3; ++d)
            worst = std::max(worst, std::abs(value(b.keypoints, {int(i), j, d}) - turn(keypoints[j], k)[d]));
        if (worst < 1e-6) found = k;
      }
      REQUIRE(found >= 0);
      ++seen[found];
      const int from = b.views[i].camera, to = from / 8 * 8 + (from % 8 + found) % 8;
      const CameraRecord c = tiny_camera(to, tiny);
      CHECK(torch::allclose(b.world_to_camera[i], matrix_of(c).to(torch::kFloat32)));
      for (int j = 0; j < 10; ++j) {
        const dvec3 q = tiny_to_camera(c, turn(keypoints[j], found));
        CHECK(value(b.keypoints_2d, {int(i), j, 0}) == doctest::Approx((c.fx * q.x / q.z + c.cx) / 32).epsilon(1e-5));
      }
      // Points of the picture, taken back to the world through the turned camera, lie on the turned animal.
      const double near = value(b.near_depth, {int(i)}), range = value(b.depth_range, {int(i)});
      for (int p = 0; p < o.surface_points; ++p) {
        const double z = value(b.depth, {int(i), p}) * range + near;
        const dvec3 q((value(b.surface_points, {int(i), p, 0}) * 32 - c.cx) / c.fx * z,
                      (value(b.surface_points, {int(i), p, 1}) * 24 - c.cy) / c.fy * z, z);
        dvec3 world = c.centre;
        for (int r = 0; r < 3; ++r)
          for (int d = 0; d < 3; ++d) world[d] += c.world_to_camera[4 * r + d] * q[r];
        const dvec3 s = tiny_sphere_point(pose, turn(world, 8 - found));
        CHECK(std::abs(glm::length(s) - 1) < 1e-4);
        for (int d = 0; d < 3; ++d) CHECK(std::abs(value(b.nnopcs, {int(i), p, d}) - (0.5 + 0.5 * s[d])) < 1e-4);
      }
    }
  }
  for (int k = 0; k < 8; ++k) CHECK(seen[k] > 0);
}

TEST_CASE("cameras that are no rings about the Z axis through the origin are not turned") {
  const TemporaryFolder folder;
  write_tiny_dataset(folder / "aside", {.frames = 10, .rings = 1, .coats = 0, .shift = {0.1, 0, 0}});
  const SampleSource aside(folder / "aside", {});
  SampleOptions o;
  CHECK(aside.batches_per_epoch(o) == 1);
  aside.batch(o, 0, 0);
  o.turn_cameras = true;
  check_message(input_message([&] { aside.batch(o, 0, 0); }),
                {"aside", "camera 1 is not camera 0 turned", "turn_cameras = false"});
  // A shift along the axis leaves it an axis.
  write_tiny_dataset(folder / "up", {.frames = 10, .rings = 1, .coats = 0, .shift = {0, 0, 0.1}});
  const SampleSource up(folder / "up", {});
  CHECK(up.batch(o, 0, 0).views.size() == 10);
}

TEST_CASE("a batch depends on seed, epoch and number alone") {
  const TemporaryFolder folder;
  write_tiny_dataset(folder / "data", {.frames = 20});
  const SampleSource source(folder / "data", {0, 2});
  const SampleOptions o = all_options();
  const int n = source.batches_per_epoch(o);
  REQUIRE(n >= 3);
  std::vector<Batch> forward, threaded;
  const int threads = omp_get_max_threads();
  omp_set_num_threads(1);
  for (int i = 0; i < n; ++i) forward.push_back(source.batch(o, 5, i));
  omp_set_num_threads(5);
  const SampleSource again(folder / "data", {0, 2});
  for (int i = n - 1; i >= 0; --i) CHECK(same(forward[i], again.batch(o, 5, i)));
  omp_set_num_threads(threads);
  SampleOptions other = o;
  other.seed = 2;
  CHECK(!same(forward[0], source.batch(other, 5, 0)));
  CHECK(!same(forward[0], source.batch(o, 6, 0)));
  CHECK(!same(forward[0], forward[1]));

  Prefetcher ahead(source, o, 5, n - 1, 2);
  CHECK(same(forward[n - 1], ahead.next()));
  const Batch first_of_next = source.batch(o, 6, 0);
  CHECK(same(first_of_next, ahead.next()));
  CHECK(same(source.batch(o, 6, 1), ahead.next()));
}

TEST_CASE("a prefetcher hands on the error of its thread, and ends when it is full") {
  const TemporaryFolder folder;
  write_tiny_dataset(folder / "data", {.frames = 10, .rings = 1, .coats = 0, .nnopcs = false});
  const SampleSource source(folder / "data", {});
  SampleOptions o;
  {
    Prefetcher wrong(source, o, 0, 0);
    check_message(input_message([&] { wrong.next(); }), {"data", "no NNOPCS", "nnopcs = false"});
    check_message(input_message([&] { wrong.next(); }), {"no NNOPCS"});
  }
  o.nnopcs = false;
  const Prefetcher idle(source, o, 0, 0, 1);
  CHECK(!source.has_nnopcs());
  CHECK(!source.batch(o, 0, 0).nnopcs.defined());
}

TEST_CASE("an epoch shows every training frame, and its cameras without repetition") {
  const TemporaryFolder folder;
  write_tiny_dataset(folder / "data", {.frames = 30, .rings = 1, .coats = 0});
  const SampleSource source(folder / "data", {});
  const std::vector<int> train = source.frames(Split::train), test = source.frames(Split::test);
  CHECK(train.size() == 20);
  CHECK(test.size() == 10);
  CHECK(source.frames(Split::validate).empty());
  CHECK(source.describe().find("30 poses, 8 cameras") != std::string::npos);
  SampleOptions o;
  o.batch = 16;
  o.views_per_frame = 8;
  o.surface_points = 1;
  CHECK(source.batches_per_epoch(o) == 10);
  std::set<std::pair<int, int>> seen;
  for (int i = 0; i < 10; ++i)
    for (const ViewId& v : source.batch(o, 0, i).views) {
      CHECK(std::count(train.begin(), train.end(), v.frame) == 1);
      CHECK(v.coat == -1);
      seen.insert({v.frame, v.camera});
    }
  CHECK(seen.size() == 160);

  o.views_per_frame = 1;
  CHECK(source.batches_per_epoch(o) == 1);  // the short second batch is dropped
  o.split = Split::test;
  CHECK(source.batches_per_epoch(o) == 1);
  CHECK(source.batch(o, 0, 0).views.size() == 10);
  o.batch = 4;
  CHECK(source.batches_per_epoch(o) == 3);
  CHECK(source.batch(o, 0, 2).views.size() == 2);  // kept where it is not training
  o.split = Split::validate;
  check_message(input_message([&] { source.batches_per_epoch(o); }),
                {"data", "30 frames", "validation split", "51 or more"});
}

TEST_CASE("views equal the files of the dataset") {
  const TemporaryFolder folder;
  const TinyOptions tiny{.frames = 2, .rings = 1, .width = 70, .height = 30, .coats = 2};
  write_tiny_dataset(folder / "data", tiny);
  const DatasetFolder d = open_dataset(folder / "data");
  const SampleSource source(folder / "data", {});
  for (int camera = 0; camera < 8; ++camera) {
    const FullView v = source.view({2, camera, 1});
    const Image8 mask = decode_png8(d.file(Modality::silhouette, 2, camera)),
                 color = decode_jpeg(d.file(Modality::rgb, 2, camera, 1));
    const ExrImage depth = decode_exr(d.file(Modality::depth, 2, camera)),
                   nnopcs = decode_exr(d.file(Modality::nnopcs, 2, camera));
    int wrong = 0, animal = 0;
    for (int y = 0; y < 30; ++y)
      for (int x = 0; x < 70; ++x) {
        const std::size_t i = static_cast<std::size_t>(y) * 70 + x;
        const bool in = mask.data[i] == 255;
        animal += in;
        wrong += v.mask.data_ptr<float>()[i] != (in ? 1.0f : 0.0f);
        wrong += v.depth.data_ptr<float>()[i] != depth.data[0][i];
        for (int c = 0; c < 3; ++c) {
          wrong += v.nnopcs.data_ptr<float>()[2100 * c + i] != nnopcs.data[nnopcs.channel(std::string(1, "RGB"[c]))][i];
          wrong += v.color.data_ptr<float>()[2100 * c + i] != color.data[3 * i + c] / 255.0f;
        }
      }
    CHECK(wrong == 0);
    CHECK(animal > 50);
    CHECK(torch::allclose(v.world_to_camera, matrix_of(tiny_camera(camera, tiny)).to(torch::kFloat32)));
    CHECK(value(v.intrinsics, {0, 0}) == doctest::Approx(100 * 70 / 36.0));
    CHECK(value(v.intrinsics, {0, 2}) == 35);
    CHECK(value(v.keypoints, {1, 0}) == static_cast<float>(tiny_keypoints(tiny_pose(2))[1].x));
  }
  CHECK(!source.view({1, 0, -1}).color.defined());
  check_message(input_message([&] { source.view({3, 0, 0}); }), {"no frame 3"});
  check_message(input_message([&] { source.view({1, 8, 0}); }), {"no camera 8"});
  check_message(input_message([&] { source.view({1, 0, 2}); }), {"coat 2", "its coats are 0, 1"});
}

TEST_CASE("silhouette points sit on the boundary, and carry the label of their pixel") {
  const TemporaryFolder folder;
  // Wider than a machine word, not a multiple of it, and so narrow a lens that the animal is cut off by the border.
  const TinyOptions tiny{.frames = 10, .rings = 1, .width = 150, .height = 20, .coats = 0};
  write_tiny_dataset(folder / "data", tiny);
  const SampleSource source(folder / "data", {});
  SampleOptions o;
  o.batch = 10;
  o.silhouette_points = 8000;
  o.surface_points = 0;
  o.near_sigma = o.far_sigma = 0;
  const Batch exact = source.batch(o, 0, 0);
  o.near_sigma = 0.02;
  o.far_sigma = 0.4;  // so far that many are clamped
  const Batch spread = source.batch(o, 0, 0);
  for (std::size_t i = 0; i < exact.views.size(); ++i) {
    const torch::Tensor mask = source.view(exact.views[i]).mask;
    std::set<std::pair<int, int>> expected, drawn;
    for (int y = 0; y < 20; ++y)
      for (int x = 0; x < 150; ++x) {
        int in = 0;
        for (int dy = -1; dy <= 1; ++dy)
          for (int dx = -1; dx <= 1; ++dx) in += is_animal(mask, x + dx, y + dy);
        if (in > 0 && in < 9) expected.insert({x, y});
      }
    for (int p = 0; p < o.silhouette_points; ++p)
      drawn.insert({static_cast<int>(value(exact.silhouette_points, {int(i), p, 0}) * 150),
                    static_cast<int>(value(exact.silhouette_points, {int(i), p, 1}) * 20)});
    CHECK(drawn == expected);
    int wrong = 0;
    for (int p = 0; p < o.silhouette_points; ++p) {
      const float x = value(spread.silhouette_points, {int(i), p, 0}),
                  y = value(spread.silhouette_points, {int(i), p, 1});
      wrong += !(x >= 0 && x < 1 && y >= 0 && y < 1);
      wrong += is_animal(mask, static_cast<int>(x * 150.0), static_cast<int>(y * 20.0)) !=
               (value(spread.silhouette, {int(i), p}) == 1);
    }
    CHECK(wrong == 0);
    CHECK(spread.silhouette[i].mean().item<float>() > 0.1);
    CHECK(spread.silhouette[i].mean().item<float>() < 0.9);
  }
}

TEST_CASE("silhouette points spread as told; a mask of one pixel is enough, an empty one is passed over") {
  const TemporaryFolder folder;
  TinyOptions tiny{.frames = 10, .rings = 1, .width = 300, .height = 200, .coats = 1};
  // One pixel in the middle where the camera is even, none where it is odd, none at all in frame 4.
  tiny.edit = [](View& v) {
    for (Map& map : v.maps)
      if (map.modality == Modality::silhouette) {
        std::fill(map.u.data.begin(), map.u.data.end(), 0);
        if (v.camera % 2 == 0 && v.frame != 4) map.u.at(150, 100) = 255;
      } else if (map.modality == Modality::depth) {
        map.f.at(150, 100) = 5;
      }
  };
  write_tiny_dataset(folder / "data", tiny);
  const SampleSource source(folder / "data", {0});
  CHECK(source.describe().find("1 pose left out") != std::string::npos);
  CHECK(source.frames(Split::train).size() == 9);
  CHECK(source.view({4, 0, -1}).mask.sum().item<float>() == 0);
  SampleOptions o;
  o.batch = 9;
  o.views_per_frame = 6;
  o.silhouette_points = 4000;
  o.surface_points = 3;
  o.color = true;
  double sum[2][2] = {}, squares[2][2] = {};
  int count = 0;
  std::map<int, std::set<int>> cameras;
  for (int n = 0; n < source.batches_per_epoch(o); ++n) {
    const Batch b = source.batch(o, 0, n);
    const torch::Tensor points = b.silhouette_points.to(torch::kFloat64);
    for (int half = 0; half < 2; ++half)
      for (int c = 0; c < 2; ++c) {
        const double middle = c == 0 ? 150.5 / 300 : 100.5 / 200;
        const torch::Tensor offset = points.slice(1, 2000 * half, 2000 * (half + 1)).select(2, c) - middle;
        sum[half][c] += offset.sum().item<double>();
        squares[half][c] += offset.square().sum().item<double>();
      }
    count += static_cast<int>(b.views.size()) * 2000;
    CHECK(b.silhouette.sum().item<float>() > 0);
    CHECK((b.surface_points.select(2, 0) - 150.5f / 300).abs().max().item<float>() < 1e-6);
    for (const ViewId& v : b.views) cameras[v.frame].insert(v.camera);
  }
  CHECK(cameras.size() == 9);
  for (const auto& [frame, ids] : cameras) CHECK(ids == std::set<int>{0, 2, 4, 6});
  for (int half = 0; half < 2; ++half)
    for (int c = 0; c < 2; ++c) {
      const double sigma = half == 0 ? 0.0125 : 0.125, pixel = c == 0 ? 1.0 / 300 : 1.0 / 200;
      // The nine pixels about the one of the mask are its boundary.
      const double expected = std::sqrt(sigma * sigma + 2.0 / 3 * pixel * pixel);
      CHECK(std::sqrt(squares[half][c] / count) == doctest::Approx(expected).epsilon(0.02));
      CHECK(std::abs(sum[half][c] / count) < 0.02 * sigma);
    }
}

TEST_CASE("encoder images are area averages of masked colour and NNOPCS") {
  const TemporaryFolder folder;
  write_tiny_dataset(folder / "data", {.frames = 10, .rings = 1});
  const SampleSource source(folder / "data", {0, 1, 2});
  SampleOptions o = all_options();
  o.turn_cameras = false;
  const std::pair<int, int> sizes[] = {{16, 12}, {13, 9}, {32, 24}, {0, 0}, {50, 31}, {1, 1}};
  for (const auto& [w, h] : sizes) {
    o.encoder = {w, h};
    const Batch b = source.batch(o, 1, 0);
    const FullView v = source.view(b.views[2]);
    const torch::Tensor image = source.encoder_image(v, {w, h});
    CHECK(torch::equal(image, b.images[2]));
    const torch::Tensor whole = (torch::cat({v.color, v.nnopcs}) * v.mask).contiguous();
    const int tw = w ? w : 32, th = h ? h : 24;
    REQUIRE(image.sizes() == torch::IntArrayRef({6, th, tw}));
    double worst = 0;
    for (int c = 0; c < 6; ++c)
      for (int y = 0; y < th; ++y)
        for (int x = 0; x < tw; ++x) {
          double sum = 0, area = 0;  // over the source pixels under this one
          for (int sy = 0; sy < 24; ++sy)
            for (int sx = 0; sx < 32; ++sx) {
              const double across = std::min(sx + 1.0, (x + 1) * 32.0 / tw) - std::max(double(sx), x * 32.0 / tw);
              const double down = std::min(sy + 1.0, (y + 1) * 24.0 / th) - std::max(double(sy), y * 24.0 / th);
              if (across <= 0 || down <= 0) continue;
              sum += across * down * whole.data_ptr<float>()[768 * c + 32 * sy + sx];
              area += across * down;
            }
          worst = std::max(worst, std::abs(sum / area - value(image, {c, y, x})));
        }
    CHECK(worst < 1e-5);
  }
  const FullView v = source.view({1, 0, 0});
  CHECK(make_encoder_image(v.color, v.mask, {}, {16, 12}).size(0) == 3);
  CHECK(torch::allclose(make_encoder_image(v.color, 0.5 * v.mask, v.nnopcs, {16, 12}),
                        0.5 * source.encoder_image(v, {16, 12})));
}

TEST_CASE("a cropped encoder image is the animal's window of the picture") {
  const TemporaryFolder folder;
  write_tiny_dataset(folder / "data", {.frames = 10, .rings = 1});
  const SampleSource source(folder / "data", {0, 1, 2});
  SampleOptions o = all_options();
  o.turn_cameras = false;
  o.encoder = {16, 12, true};
  const Batch b = source.batch(o, 1, 0);
  const FullView v = source.view(b.views[2]);
  const torch::Tensor image = source.encoder_image(v, o.encoder);
  CHECK(torch::equal(image, b.images[2]));
  CHECK((image.slice(0, 3) > 0).any(0).sum().item<double>() > 1.3 * (source.encoder_image(v, {16, 12}).slice(0, 3) > 0).any(0).sum().item<double>());

  // A rectangle of 20 x 10 pixels in a picture of 64 x 48, whose red rises to the right: window 20 * 0.99 * 7 / 6 wide.
  torch::Tensor mask = torch::zeros({48, 64});
  mask.slice(0, 30, 40).slice(1, 5, 25).fill_(1);
  const torch::Tensor ramp = torch::arange(64, torch::kFloat).expand({3, 48, 64}) / 64;
  const torch::Tensor seen = make_encoder_image(ramp, mask, {}, {64, 48, true});
  const double pixel = 20 * 0.99 * 7 / 6 / 64;  // of the window, in source pixels
  CHECK(seen.sum().item<double>() * pixel * pixel == doctest::Approx((ramp * mask).sum().item<double>()).epsilon(1e-4));
  CHECK(value(seen, {0, 24, 32}) == doctest::Approx((15 + 0.5 * pixel) / 64).epsilon(0.05));
  // A stray pixel far away leaves the window as it was, within a tenth of its width.
  mask.slice(0, 2, 3).slice(1, 60, 61).fill_(1);
  CHECK((make_encoder_image(ramp, mask, {}, {64, 48, true}) - seen).abs().mean().item<double>() < 0.02);

  CHECK(make_encoder_image(ramp, torch::zeros({48, 64}), {}, {16, 12, true}).abs().max().item<float>() == 0);
  torch::Tensor dot = torch::zeros({48, 64});
  dot.slice(0, 0, 1).slice(1, 63, 64).fill_(1);  // in a corner: the window reaches beyond the picture
  const torch::Tensor one = make_encoder_image(ramp, dot, {}, {16, 12, true});
  CHECK(one.isfinite().all().item<bool>());
  CHECK(one.slice(0, 0, 1).sum().item<double>() * std::pow(8.0 / 12, 2) == doctest::Approx(63.0 / 64).epsilon(1e-4));
  // Where in the picture the animal stands makes no difference.
  torch::Tensor moved = torch::zeros({48, 64});
  moved.slice(0, 10, 20).slice(1, 40, 60).fill_(1);
  const torch::Tensor flat = torch::full({3, 48, 64}, 0.5f);
  CHECK(torch::allclose(make_encoder_image(flat, moved, {}, {16, 12, true}),
                        make_encoder_image(flat, torch::roll(moved, {20, -35}, {0, 1}), {}, {16, 12, true}), 1e-5, 1e-5));
}

TEST_CASE("a dataset without manifest is read by its folders, with the same batches") {
  const TemporaryFolder folder;
  for (const std::string species : {"cow", "goat"}) {
    const fs::path with = folder / species, without = folder / (species + "_bare");
    write_tiny_dataset(with, {.frames = 20, .rings = 1, .species = species});
    fs::copy(with, without, fs::copy_options::recursive);
    fs::remove(without / manifest_name);
    fs::remove_all(without / "frames");
    const SampleSource a(with, {0, 1, 2}), b(without, {0, 1, 2});
    CHECK(b.reader_radius() == 1.5);
    CHECK(b.available_coats() == std::vector<int>{0, 1, 2});
    CHECK(a.frames(Split::train) == b.frames(Split::train));
    CHECK(a.frames(Split::test) == b.frames(Split::test));
    const Batch x = a.batch(all_options(), 0, 1), y = b.batch(all_options(), 0, 1);
    CHECK((x.views == y.views));
    CHECK(torch::equal(x.keypoints, y.keypoints));
    CHECK(torch::equal(x.surface_points, y.surface_points));
    CHECK(torch::equal(x.nnopcs, y.nnopcs));
    CHECK(torch::equal(x.images, y.images));
    CHECK(torch::allclose(x.world_to_camera, y.world_to_camera, 1e-6, 1e-6));
    CHECK(torch::allclose(x.keypoints_2d, y.keypoints_2d, 1e-5, 1e-6));
    CHECK(torch::allclose(x.depth, y.depth, 1e-4, 1e-5));
  }
  // Without the float maps, the 8-bit NNOPCS serve, manifest or not.
  const torch::Tensor exact = SampleSource(folder / "cow", {}).view({3, 4, -1}).nnopcs;
  for (const char* name : {"cow", "cow_bare"}) {
    for (const auto& entry : fs::recursive_directory_iterator(folder / name / "cow_positional_encoding"))
      if (entry.path().extension() == ".exr") fs::remove(entry.path());
    const SampleSource source(folder / name, {});
    const float difference = (source.view({3, 4, -1}).nnopcs - exact).abs().max().item<float>();
    CHECK(difference > 1e-4);
    CHECK(difference < 0.5 / 255 + 1e-6);
  }
}
