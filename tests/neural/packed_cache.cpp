// The cache of packed pictures, and datasets that cannot be used.
#include "neural/packed_cache.h"

#include <omp.h>

#include <fstream>

#include "neural/samples.h"
#include "tests/neural/doctest_torch.h"
#include "tests/neural/tiny_dataset.h"

using namespace moomill;
using namespace moomill::test;

namespace {

void overwrite(const fs::path& file, const std::string& text) {
  fs::create_directories(file.parent_path());
  std::ofstream(file, std::ios::binary | std::ios::trunc) << text;
}

std::string text_of(const fs::path& file) {
  const std::vector<std::uint8_t> bytes = read_file(file);
  return {bytes.begin(), bytes.end()};
}

void replace(const fs::path& file, const std::string& what, const std::string& by) {
  std::string text = text_of(file);
  const std::size_t found = text.find(what);
  REQUIRE(found != std::string::npos);
  overwrite(file, text.replace(found, what.size(), by));
}

// What is packed when the dataset is opened.
std::vector<std::string> packed(const fs::path& dataset, const std::vector<int>& coats, const fs::path& cache = {}) {
  std::vector<std::string> out;
  std::size_t last = 0, whole = 0;
  SampleSource(dataset, coats, cache, [&](const std::string& what, std::size_t done, std::size_t of) {
    if (out.empty() || out.back() != what) {
      CHECK(last == whole);  // the one before came to its end
      out.push_back(what);
    }
    last = done;
    whole = of;
  });
  CHECK(last == whole);
  return out;
}

void check_refused(const fs::path& dataset, const std::vector<int>& coats, std::initializer_list<std::string> parts) {
  INFO(*parts.begin());
  const std::string message = message_of<InputError>([&] { SampleSource(dataset, coats); });
  INFO(message);
  for (const std::string& part : parts) CHECK(message.find(part) != std::string::npos);
  CHECK(message.find('\n') == std::string::npos);
}

using Names = std::vector<std::string>;
const TinyOptions small{.frames = 10, .rings = 1, .coats = 2};

}  // namespace

TEST_CASE("a cache is made once, and only of what is needed") {
  const TemporaryFolder folder;
  const fs::path data = folder / "data", cache = folder / "data.cache";
  write_tiny_dataset(data, small);
  CHECK(packed(data, {}) == Names{"packing geometry"});
  CHECK(fs::exists(cache / "geometry.pack"));
  CHECK(!fs::exists(cache / "coat_001.pack"));
  CHECK(packed(data, {1}) == Names{"packing coat 1"});
  CHECK(packed(data, {1}).empty());
  CHECK(packed(fs::path(data / ""), {0}) == Names{"packing coat 0"});  // a slash at the end changes nothing
  CHECK(packed(data, {1}, folder / "elsewhere/deep") == Names{"packing geometry", "packing coat 1"});
  for (const auto& entry : fs::directory_iterator(cache)) CHECK(!is_temporary(entry.path()));
  // What a killed run left behind goes away when something is packed again.
  overwrite(cache / ".moomill-part-1-2-geometry.pack", "half");
  fs::remove(cache / "coat_000.pack");
  CHECK(packed(data, {0}) == Names{"packing coat 0"});
  CHECK(!fs::exists(cache / ".moomill-part-1-2-geometry.pack"));
  // The same bytes from one thread or several.
  const int threads = omp_get_max_threads();
  omp_set_num_threads(threads == 1 ? 3 : 1);
  packed(data, {1}, folder / "again");
  omp_set_num_threads(threads);
  CHECK(text_of(folder / "again/geometry.pack") == text_of(cache / "geometry.pack"));
  CHECK(text_of(folder / "again/coat_001.pack") == text_of(cache / "coat_001.pack"));
}

TEST_CASE("a cache that is stale or damaged is made anew, another's file is left alone") {
  const TemporaryFolder folder;
  const fs::path data = folder / "data", geometry = folder / "data.cache/geometry.pack",
                 coat = folder / "data.cache/coat_000.pack";
  write_tiny_dataset(data, small);
  packed(data, {0});
  const std::string good = text_of(geometry), good_coat = text_of(coat);

  for (const std::size_t size : {good.size() - 1, good.size() / 2, std::size_t{100}, std::size_t{64}, std::size_t{20},
                                 std::size_t{3}, std::size_t{0}}) {
    INFO(size);
    overwrite(geometry, good.substr(0, size));
    CHECK(packed(data, {0}) == Names{"packing geometry"});
    CHECK(text_of(geometry) == good);
  }
  overwrite(geometry, good + "x");
  CHECK(packed(data, {0}) == Names{"packing geometry"});
  for (const std::size_t at : {8, 12, 16, 24, 28, 32, 40, 48, 56, 72}) {  // every field of the header, and the index
    std::string bad = good;
    bad[at] = static_cast<char>(bad[at] ^ 0x10);
    overwrite(geometry, bad);
    INFO(at);
    CHECK(packed(data, {0}) == Names{"packing geometry"});
  }
  for (const std::size_t at : {8, 12, 16, 24, 32, 40, 56}) {
    std::string bad = good_coat;
    bad[at] = static_cast<char>(bad[at] ^ 0x10);
    overwrite(coat, bad);
    INFO(at);
    CHECK(packed(data, {0}) == Names{"packing coat 0"});
  }
  overwrite(coat, good_coat.substr(0, good_coat.size() - 5));
  CHECK(packed(data, {0}) == Names{"packing coat 0"});
  fs::copy_file(geometry, coat, fs::copy_options::overwrite_existing);  // ours, but of another kind
  CHECK(packed(data, {0}) == Names{"packing coat 0"});
  CHECK(text_of(coat) == good_coat);

  // A mask that does not agree with the index is damage found when it is used.
  std::string bad = good;
  bad[64 + 81 * 8 + 24 * 8] = static_cast<char>(bad[64 + 81 * 8 + 24 * 8] ^ 1);  // a corner of the second view
  overwrite(geometry, bad);
  const SampleSource damaged(data, {});
  CHECK(message_of<RunError>([&] {
          damaged.view({1, 1, -1});
        }).find("geometry.pack: is damaged; delete it") != std::string::npos);
  overwrite(geometry, good);

  // The same folder with other poses: every picture changed, so did the records.
  fs::remove_all(data);
  TinyOptions other = small;
  other.seed = 2;
  write_tiny_dataset(data, other);
  CHECK(packed(data, {0}) == Names{"packing geometry", "packing coat 0"});
  CHECK(text_of(geometry) != good);

  overwrite(geometry, "somebody's letter");
  check_refused(data, {}, {"geometry.pack", "is not a cache of netepu", "another folder"});
  CHECK(text_of(geometry) == "somebody's letter");
  fs::remove_all(folder / "data.cache");
  overwrite(folder / "data.cache", "a file where the folder should be");
  CHECK(message_of<RunError>([&] { SampleSource(data, {}); }).find("data.cache") != std::string::npos);
}

TEST_CASE("without a manifest, files that changed are noticed by their size and time") {
  const TemporaryFolder folder;
  const fs::path data = folder / "data";
  write_tiny_dataset(data, small);
  fs::remove(data / manifest_name);
  CHECK(packed(data, {}) == Names{"packing geometry"});
  CHECK(packed(data, {}).empty());
  const fs::path depth = data / "cow_animation_alltextures.blend/Cow_Holstein.tif/003/depth0002.003.exr";
  REQUIRE(fs::exists(depth));
  fs::last_write_time(depth, fs::last_write_time(depth) + std::chrono::seconds(5));
  CHECK(packed(data, {}) == Names{"packing geometry"});
  // So are pictures of a coat.
  CHECK(packed(data, {1}) == Names{"packing coat 1"});
  const fs::path color = data / "cow_animation_alltextures.blend/Cow_brown.png/003/Image0002.003.jpg";
  REQUIRE(fs::exists(color));
  fs::last_write_time(color, fs::last_write_time(color) + std::chrono::seconds(5));
  CHECK(packed(data, {1}) == Names{"packing coat 1"});
}

TEST_CASE("pictures that are broken or of another size are named") {
  const TemporaryFolder folder;
  const fs::path data = folder / "data";
  write_tiny_dataset(data, small);
  const DatasetFolder d = open_dataset(data);
  const auto broken = [&](const fs::path& file, const std::string& content, std::initializer_list<std::string> parts) {
    const std::string good = text_of(file);
    overwrite(file, content);
    INFO(file.string() << " of " << content.size() << " bytes");
    check_refused(data, {0}, parts);
    check_refused(data, {0}, {file.string()});
    overwrite(file, good);
  };
  const auto text = [](const std::vector<std::uint8_t>& bytes) { return std::string(bytes.begin(), bytes.end()); };
  const fs::path mask = d.file(Modality::silhouette, 3, 2), depth = d.file(Modality::depth, 3, 2),
                 nnopcs = d.file(Modality::nnopcs, 3, 2), color = d.file(Modality::rgb, 3, 2, 0);
  broken(mask, "no picture", {"not a PNG"});
  broken(mask, text_of(mask).substr(0, 70), {"is damaged"});
  broken(mask, text(encode_png8(Image8(31, 24, 1))), {"31 x 24", "32 x 24"});
  broken(depth, "no picture", {"EXR"});
  broken(depth, text_of(depth).substr(0, text_of(depth).size() / 2), {"EXR"});
  const std::vector<float> plane(32 * 24, 4.0f), wild(32 * 24, std::nanf(""));
  broken(depth, text(encode_exr(24, 32, {{"R", plane.data()}})), {"24 x 32", "32 x 24"});
  broken(depth, text(encode_exr(32, 24, {{"R", wild.data()}})), {"nan", "inside the silhouette"});
  broken(depth, text(encode_exr(32, 24, {{"Q", plane.data()}})), {"channel R"});
  broken(nnopcs, text(encode_exr(32, 24, {{"R", plane.data()}})), {"NNOPCS 4", "outside [0, 1]"});
  broken(nnopcs, text_of(nnopcs).substr(0, 300), {"EXR"});
  fs::rename(mask, folder / "mask.png");
  check_refused(data, {0}, {mask.string(), "cannot be read"});
  fs::rename(folder / "mask.png", mask);
  CHECK(fs::is_empty(folder / "data.cache"));  // nothing is kept of a failure
  broken(color, "no picture", {"JPEG"});
  broken(color, text(encode_jpeg(Image8(32, 25, 3))), {"32 x 25", "32 x 24"});

  // A whole picture is decoded when it is asked for.
  const SampleSource source(data, {0});
  overwrite(color, "no picture");
  CHECK(message_of<InputError>([&] { source.view({3, 2, 0}); }).find(color.string()) != std::string::npos);
}

TEST_CASE("datasets that cannot be used are refused in one sentence") {
  const TemporaryFolder folder;
  check_refused(folder / "nowhere", {}, {"nowhere", "is not a folder"});
  fs::create_directories(folder / "empty");
  check_refused(folder / "empty", {}, {"empty", "holds no dataset", "manifest.json"});

  const fs::path data = folder / "data";
  write_tiny_dataset(data, small);
  check_refused(data, {2}, {"data", "coat 2", "its coats are 0, 1"});
  check_refused(data, {-1}, {"coat -1"});

  const fs::path csv = open_dataset(data).keypoints_csv();
  const std::string table = text_of(csv);
  const auto row_of = [&](const std::string& row) { return table.substr(0, table.find('\n') + 1) + row + "\n"; };
  overwrite(csv, row_of("1,2,3"));
  check_refused(data, {}, {csv.string() + ":2", "3 columns", "3 x 10"});
  std::string nan = table;
  nan.replace(table.find('\n') + 3, 1, "nan,");
  overwrite(csv, nan);
  check_refused(data, {}, {csv.string() + ":2", "not a finite number"});
  overwrite(csv, table.substr(0, table.rfind('\n', table.size() - 2) + 1));
  check_refused(data, {}, {"9 rows for 10 frames"});
  overwrite(csv, table.substr(0, table.find('\n') + 1));
  check_refused(data, {}, {"no rows"});
  fs::remove(csv);
  check_refused(data, {}, {csv.string(), "cannot be read"});
  overwrite(csv, table);

  const std::string manifest = text_of(data / manifest_name);
  for (const auto& [key, word] : {std::pair<std::string, std::string>{"silhouette", "silhouettes"},
                                  {"depth", "depth"},
                                  {"keypoints_csv", "keypoints"}}) {
    Json json = Json::parse(manifest);
    json["paths"].erase(key);
    overwrite(data / manifest_name, json.dump());
    check_refused(data, {}, {"data", "made without " + word});
  }
  Json json = Json::parse(manifest);
  json["splits"].erase("test");
  overwrite(data / manifest_name, json.dump());
  check_refused(data, {}, {"manifest.json", "\"test\""});
  json = Json::parse(manifest);
  json["cameras"][3]["width"] = 40;
  overwrite(data / manifest_name, json.dump());
  check_refused(data, {}, {"camera 3 has 40 x 24", "one resolution"});
  json = Json::parse(manifest);
  json["cameras"][2]["fx"] = nullptr;
  overwrite(data / manifest_name, json.dump());
  check_refused(data, {}, {"manifest.json"});
  fs::remove(data / manifest_name);
  overwrite(data / journal_name, "{}");
  check_refused(data, {}, {"unfinished"});
  fs::remove(data / journal_name);

  // Now there is no manifest: the tables must do.
  const fs::path cfg = csv.parent_path() / "parameters.cfg";
  const std::string parameters = text_of(cfg);
  replace(cfg, "center_cam_y_m", "centre_y");
  check_refused(data, {}, {"parameters.cfg", "center_cam_y_m"});
  overwrite(cfg, parameters);
  replace(cfg, "sensor_size_mm = 36", "sensor_size_mm = wide");
  check_refused(data, {}, {"sensor_size_mm", "wide"});
  overwrite(cfg, "[intrinsics]\nfocal_length_mm = 100\n");
  check_refused(data, {}, {"parameters.cfg", "extrinsics_Camera"});
  overwrite(cfg, "what is this\n");
  check_refused(data, {}, {"parameters.cfg:1"});
  fs::remove(cfg);
  check_refused(data, {}, {"parameters.cfg", "is missing"});
  overwrite(cfg, parameters);
  overwrite(csv, row_of("1,2,3,4,5"));
  check_refused(data, {}, {"keypoints.csv:2", "5 columns"});
  overwrite(csv, table);
  const fs::path depth = csv.parent_path() / "000/depth0001.000.exr";
  fs::rename(depth, folder / "depth.exr");
  check_refused(data, {}, {"depth0001.000.exr", "with depth"});
  fs::rename(folder / "depth.exr", depth);
  CHECK(packed(data, {0, 1}).size() == 3);
}

TEST_CASE("rows of keypoints go by frame number, else by order") {
  const TemporaryFolder folder;
  const fs::path data = folder / "data";
  write_tiny_dataset(data, small);
  const fs::path csv = open_dataset(data).keypoints_csv();
  const std::string header = text_of(csv).substr(0, text_of(csv).find('\n') + 1);
  const auto rows = [&](const std::function<std::string(int)>& label, bool backwards) {
    std::string text = header;
    for (int i = 1; i <= 10; ++i) {
      const int frame = backwards ? 11 - i : i;
      text += label(frame);
      for (const dvec3& p : tiny_keypoints(tiny_pose(frame))) text += fmt::format(",{},{},{}", p.x, p.y, p.z);
      text += "\r\n";
    }
    return text;
  };
  for (const auto& text :
       {rows([](int f) { return std::to_string(f); }, true), rows([](int f) { return std::to_string(f - 1); }, false),
        rows([](int) { return "0.0"; }, false),
        rows([](int f) { return fmt::format("{}.000e+00", f); }, true) + "\n\n"}) {
    overwrite(csv, text);
    const SampleSource source(data, {});
    for (int frame = 1; frame <= 10; ++frame)
      CHECK(source.view({frame, 0, -1}).keypoints.data_ptr<float>()[3] ==
            static_cast<float>(tiny_keypoints(tiny_pose(frame))[1].x));
  }
}

TEST_CASE("keypoints behind the camera give finite numbers") {
  const TemporaryFolder folder;
  const fs::path data = folder / "data";
  write_tiny_dataset(data, small);
  const fs::path csv = open_dataset(data).keypoints_csv();
  std::string text = text_of(csv).substr(0, text_of(csv).find('\n') + 1);
  for (int frame = 1; frame <= 10; ++frame) {
    text += std::to_string(frame);
    for (int k = 0; k < 10; ++k) text += k % 2 ? ",100,0,-30" : ",0.1,0.1,0";
    text += "\n";
  }
  overwrite(csv, text);
  const SampleSource source(data, {});
  SampleOptions o;
  o.views_per_frame = 8;
  o.silhouette_points = 10;
  const Batch b = source.batch(o, 0, 0);
  CHECK(b.near_depth.min().item<float>() < 0);
  for (const torch::Tensor& t : {b.keypoints_2d, b.near_depth, b.depth_range, b.depth})
    CHECK(torch::isfinite(t).all().item<bool>());

  // All in one place: the depth range keeps its least size.
  text = text.substr(0, text.find('\n') + 1);
  for (int frame = 1; frame <= 10; ++frame) {
    text += std::to_string(frame);
    for (int k = 0; k < 10; ++k) text += ",0.1,0.1,0";
    text += "\n";
  }
  overwrite(csv, text);
  const SampleSource flat(data, {});
  const Batch f = flat.batch(o, 0, 0);
  CHECK(f.depth_range.max().item<float>() == 1e-3f);
  CHECK(torch::isfinite(f.depth).all().item<bool>());
}

TEST_CASE("cameras that vary from frame to frame") {
  const TemporaryFolder folder;
  TinyOptions o{.frames = 10, .rings = 1, .coats = 0};
  Manifest m = tiny_manifest(o);
  m.cameras.clear();
  m.per_frame_cameras = true;
  {
    DatasetWriter writer(folder / "data", m, 1);
    for (int frame : m.frames) {
      o.shift = {0.02 * frame, 0, 0};
      FrameRecord record;
      record.frame = frame;
      record.keypoints = {tiny_keypoints(tiny_pose(frame))};
      for (int c = 0; c < 8; ++c) {
        record.cameras.push_back(tiny_camera(c, o));
        writer.write_view(tiny_view(o, frame, c));
      }
      writer.finish_frame(record);
    }
    writer.finish();
  }
  const SampleSource source(folder / "data", {});
  SampleOptions options;
  options.turn_cameras = true;
  CHECK(message_of<InputError>([&] { source.batch(options, 0, 0); }).find("vary from frame to frame") !=
        std::string::npos);
  options.turn_cameras = false;
  const Batch b = source.batch(options, 0, 0);
  for (std::size_t i = 0; i < b.views.size(); ++i) {
    o.shift = {0.02 * b.views[i].frame, 0, 0};
    const CameraRecord c = tiny_camera(b.views[i].camera, o);
    for (int k = 0; k < 12; ++k)
      CHECK(b.world_to_camera.data_ptr<float>()[12 * i + k] == doctest::Approx(c.world_to_camera[k]).epsilon(1e-5));
  }
}
