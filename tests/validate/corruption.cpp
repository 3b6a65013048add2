// Every corruption must be caught by the check that is meant for it.
#include <fstream>

#include "tests/validate/synthetic.h"

using namespace moomill;
using namespace moomill::test;

namespace {

// One dataset for all cases; each works on a copy.
const fs::path& original() {
  static TemporaryFolder folder;
  static const bool made = (write_synthetic(folder / "data", {.frames = 1}), true);
  (void)made;
  static const fs::path path = folder / "data";
  return path;
}

struct Copy {
  TemporaryFolder folder;
  DatasetFolder data;
  Copy() {
    fs::copy(original(), folder / "data", fs::copy_options::recursive);
    data = open_dataset(folder / "data");
  }
  fs::path file(Modality modality, int camera = 2, int coat = -1) const {
    return data.file(modality, 1, camera, coat, modality == Modality::occlusion ? 0 : -1);
  }
};

void store(const fs::path& file, const std::vector<std::uint8_t>& bytes) {
  write_file_atomically(file, bytes.data(), bytes.size());
}

std::string text_of(const fs::path& file) {
  const auto bytes = read_file(file);
  return {bytes.begin(), bytes.end()};
}

void edit_json(const fs::path& file, const std::function<void(Json&)>& edit) {
  Json json = parse_json_file(file);
  edit(json);
  write_file_atomically(file, dump_json(json));
}

void edit_png(const fs::path& file, const std::function<void(Image8&)>& edit) {
  Image8 image = decode_png8(file);
  edit(image);
  store(file, encode_png8(image));
}

void edit_exr(const fs::path& file, const std::function<void(ExrImage&)>& edit) {
  ExrImage image = decode_exr(file);
  edit(image);
  std::vector<ExrChannel> channels;
  for (std::size_t c = 0; c < image.names.size(); ++c)
    channels.push_back({image.names[c], image.data[c].empty() ? nullptr : image.data[c].data(),
                        image.ids[c].empty() ? nullptr : image.ids[c].data(), 1});
  store(file, encode_exr(image.width, image.height, channels));
}

void edit_text(const fs::path& file, const std::string& from, const std::string& to) {
  std::string text = text_of(file);
  const auto at = text.find(from);
  REQUIRE(at != std::string::npos);
  write_file_atomically(file, text.replace(at, from.size(), to));
}

// A pixel well inside the silhouette.
std::size_t inside(const Copy& copy, int camera = 2) {
  const Image8 mask = decode_png8(copy.file(Modality::silhouette, camera));
  std::vector<std::size_t> all;
  for (std::size_t i = 0; i < mask.data.size(); ++i)
    if (mask.data[i]) all.push_back(i);
  return all[all.size() / 2];
}

void caught_by(const Copy& copy, const std::string& check) {
  const std::vector<CheckResult> results = validate_dataset(copy.folder / "data");
  const CheckResult& r = result_of(results, check);
  CHECK_MESSAGE(r.failure_count > 0, check);
  CHECK(r.failures.size() == std::min<std::uint64_t>(r.failure_count, 20));
}

// Only the checks named may fail.
void caught_only_by(const Copy& copy, const std::vector<std::string>& checks) {
  const std::vector<CheckResult> results = validate_dataset(copy.folder / "data");
  for (const std::string& check : checks) CHECK_MESSAGE(result_of(results, check).failure_count > 0, check);
  for (const CheckResult& r : results) {
    const bool expected = std::any_of(checks.begin(), checks.end(),
                                      [&](const std::string& c) { return r.name.find(c) != std::string::npos; });
    CHECK_MESSAGE((expected || r.passed()), r.name << ": " << (r.failures.empty() ? "" : r.failures.front()));
  }
}

}  // namespace

TEST_CASE("files that are gone, changed, cut short or of the wrong size") {
  Copy copy;
  SUBCASE("gone") {
    fs::remove(copy.file(Modality::rgb, 3, 0));
    caught_only_by(copy, {"size and hash"});
  }
  SUBCASE("one bit of a picture") {
    auto bytes = read_file(copy.file(Modality::rgb, 3, 0));
    bytes[bytes.size() / 2] ^= 1;
    store(copy.file(Modality::rgb, 3, 0), bytes);
    caught_only_by(copy, {"size and hash"});
  }
  SUBCASE("cut short") {
    fs::resize_file(copy.file(Modality::depth), 1000);
    caught_by(copy, "size and hash");
  }
  SUBCASE("missing from the record") {
    edit_json(copy.data.record(1), [](Json& j) { j["files"].erase(j["files"].begin()); });
    caught_by(copy, "size and hash");
  }
  SUBCASE("another size") {
    store(copy.file(Modality::silhouette), encode_png8(Image8(10, 10, 1)));
    caught_by(copy, "size of their camera");
  }
}

TEST_CASE("records") {
  Copy copy;
  SUBCASE("gone") {
    fs::remove(copy.data.record(1));
    caught_by(copy, "has its record");
  }
  SUBCASE("garbage") {
    write_file_atomically(copy.data.record(1), std::string("{"));
    caught_by(copy, "has its record");
  }
  SUBCASE("a view is missing") {
    edit_json(copy.data.record(1), [](Json& j) { j["views"].erase(3); });
    caught_by(copy, "has its record");
  }
  SUBCASE("a bone is missing") {
    edit_json(copy.data.record(1), [](Json& j) { j["animals"][0]["bones"].erase(0); });
    caught_by(copy, "has its record");
  }
}

TEST_CASE("splits and rigs") {
  Copy copy;
  SUBCASE("a frame in two splits") {
    edit_json(copy.folder / "data" / manifest_name, [](Json& j) { j["splits"]["train"].push_back(1); });
    caught_only_by(copy, {"in one split"});
  }
  SUBCASE("frames from 0") {
    edit_json(copy.folder / "data" / manifest_name, [](Json& j) { j["frames"][0] = 0; });
    caught_by(copy, "count from 1");
  }
  SUBCASE("another rig file") {
    write_file_atomically(copy.folder / "data/rigs/cow.glb", text_of(copy.folder / "data/rigs/cow.glb") + " ");
    caught_by(copy, "rig files");
  }
}

TEST_CASE("silhouettes") {
  Copy copy;
  const std::size_t pixel = inside(copy);
  SUBCASE("a grey value") {
    edit_png(copy.file(Modality::silhouette), [&](Image8& i) { i.data[pixel] = 128; });
    caught_by(copy, "0 and 255");
  }
  SUBCASE("three channels") {
    Image8 rgb(synthetic_width, synthetic_height, 3, 255);
    store(copy.file(Modality::silhouette), encode_png8(rgb));
    caught_by(copy, "one channel");
  }
  SUBCASE("a hole") {
    edit_png(copy.file(Modality::silhouette), [&](Image8& i) { i.data[pixel] = 0; });
    caught_by(copy, "silhouette = support of depth");
    caught_by(copy, "silhouette = support of 8-bit NNOPCS");
    caught_by(copy, "only inside the silhouette");
    caught_by(copy, "support of normal, part");
  }
}

TEST_CASE("depth") {
  Copy copy;
  const std::size_t pixel = inside(copy);
  SUBCASE("planes that differ") {
    edit_exr(copy.file(Modality::depth), [&](ExrImage& e) { e.data[e.channel("G")][pixel] *= 1.01f; });
    caught_only_by(copy, {"size and hash", "three equal channels"});
  }
  SUBCASE("one channel only") {
    const ExrImage e = decode_exr(copy.file(Modality::depth));
    store(copy.file(Modality::depth), encode_exr(e.width, e.height, {{"R", e.data[0].data(), nullptr, 1}}));
    caught_by(copy, "three equal channels");
  }
  SUBCASE("distance along the ray instead of z") {
    const double f = copy.data.manifest.cameras[2].fx;
    edit_exr(copy.file(Modality::depth), [&](ExrImage& e) {
      for (auto& plane : e.data)
        for (std::size_t i = 0; i < plane.size(); ++i) {
          const double x = (i % synthetic_width + 0.5 - synthetic_width / 2) / f,
                       y = (i / synthetic_width + 0.5 - synthetic_height / 2) / f;
          plane[i] = static_cast<float>(plane[i] * std::sqrt(1 + x * x + y * y));
        }
    });
    caught_by(copy, "pixel's depth");
  }
  SUBCASE("background that is not 0") {
    edit_exr(copy.file(Modality::depth), [&](ExrImage& e) {
      for (auto& plane : e.data) plane[0] = 1e10f;
    });
    caught_by(copy, "silhouette = support of depth");
  }
}

TEST_CASE("NNOPCS") {
  Copy copy;
  const std::size_t pixel = inside(copy);
  SUBCASE("8-bit off by two steps") {
    edit_png(copy.data.nnopcs8(1, 2), [&](Image8& i) {
      i.data[3 * pixel] =
          static_cast<std::uint8_t>(i.data[3 * pixel] > 100 ? i.data[3 * pixel] - 2 : i.data[3 * pixel] + 2);
    });
    caught_only_by(copy, {"size and hash", "half a step"});
  }
  SUBCASE("a foreground component of 0") {
    edit_png(copy.data.nnopcs8(1, 2), [&](Image8& i) { i.data[3 * pixel + 1] = 0; });
    caught_by(copy, "never has a 0");
  }
  SUBCASE("out of range") {
    edit_exr(copy.file(Modality::nnopcs), [&](ExrImage& e) { e.data[0][pixel] = 1.5f; });
    caught_by(copy, "float NNOPCS lies in [0, 1]");
  }
  SUBCASE("mirrored in one camera") {
    edit_exr(copy.file(Modality::nnopcs), [&](ExrImage& e) {
      const Image8 mask = decode_png8(copy.file(Modality::silhouette));
      auto& x = e.data[e.channel("R")];
      for (std::size_t i = 0; i < x.size(); ++i)
        if (mask.data[i]) x[i] = 1 - x[i];
    });
    caught_by(copy, "the same in two views");
    caught_by(copy, "its triangle and barycentrics");
  }
  SUBCASE("red and blue swapped") {
    edit_exr(copy.file(Modality::nnopcs),
             [&](ExrImage& e) { std::swap(e.data[e.channel("R")], e.data[e.channel("B")]); });
    caught_by(copy, "its triangle and barycentrics");
  }
}

TEST_CASE("labels") {
  Copy copy;
  const std::size_t pixel = inside(copy);
  SUBCASE("part missing at a pixel") {
    auto part = decode_png16(copy.file(Modality::part));
    part.data[pixel] = 0;
    store(copy.file(Modality::part), encode_png16(part));
    caught_only_by(copy, {"size and hash", "support of normal, part"});
  }
  SUBCASE("an animal that does not exist") {
    edit_png(copy.file(Modality::instance), [&](Image8& i) { i.data[pixel] = 9; });
    caught_by(copy, "labels keep to their values");
  }
  SUBCASE("normals that are not unit vectors") {
    edit_exr(copy.file(Modality::normal), [&](ExrImage& e) {
      for (auto& plane : e.data) plane[pixel] *= 1.1f;
    });
    caught_only_by(copy, {"size and hash", "labels keep to their values"});
  }
  SUBCASE("triangles shifted by a pixel") {
    edit_exr(copy.file(Modality::triangle), [&](ExrImage& e) {
      for (auto& plane : e.data) std::rotate(plane.begin(), plane.begin() + (plane.empty() ? 0 : 1), plane.end());
      for (auto& plane : e.ids) std::rotate(plane.begin(), plane.begin() + (plane.empty() ? 0 : 1), plane.end());
    });
    caught_by(copy, "reprojects to the pixel");
  }
  SUBCASE("barycentrics swapped") {
    edit_exr(copy.file(Modality::triangle),
             [&](ExrImage& e) { std::swap(e.data[e.channel("u")], e.data[e.channel("v")]); });
    caught_by(copy, "its triangle and barycentrics");
    caught_by(copy, "reprojects to the pixel");
  }
}

TEST_CASE("occlusion") {
  Copy copy;
  SUBCASE("a visible pixel outside the whole mask") {
    edit_png(copy.file(Modality::occlusion), [&](Image8& i) { i.data[inside(copy)] = 0; });
    caught_only_by(copy, {"size and hash", "visible mask lies in the whole mask"});
  }
  SUBCASE("a wrong fraction") {
    edit_json(copy.data.record(1), [](Json& j) { j["views"][4]["animals"][0]["occlusion"]["hidden_fraction"] = 0.25; });
    caught_only_by(copy, {"visible mask lies in the whole mask"});
  }
}

TEST_CASE("keypoints") {
  Copy copy;
  SUBCASE("a header that NumPy takes for a comment") {
    edit_text(copy.data.keypoints_csv(), "frame", "# frame");
    caught_only_by(copy, {"keypoints.csv"});
  }
  SUBCASE("no header") {
    const std::string text = text_of(copy.data.keypoints_csv());
    write_file_atomically(copy.data.keypoints_csv(), text.substr(text.find('\n') + 1));
    caught_only_by(copy, {"keypoints.csv"});
  }
  SUBCASE("an extra row") {
    write_file_atomically(copy.data.keypoints_csv(), text_of(copy.data.keypoints_csv()) + "2,0,0,0,0,0,0,0,0,0\n");
    caught_only_by(copy, {"keypoints.csv"});
  }
  SUBCASE("another position than the record's") {
    edit_json(copy.data.record(1), [](Json& j) { j["animals"][0]["keypoints_m"][1][2] = 0.5; });
    caught_by(copy, "keypoints.csv");
    caught_by(copy, "through world_to_camera");
  }
  SUBCASE("a 2D position half a pixel off") {
    edit_json(copy.data.record(1), [](Json& j) {
      Json& x = j["views"][4]["animals"][0]["keypoints"]["pixel"][1][0];
      x = x.get<double>() + 0.5;
    });
    caught_only_by(copy, {"through world_to_camera", "through parameters.cfg"});
  }
  SUBCASE("a visibility turned round") {
    edit_json(copy.data.record(1), [](Json& j) {
      Json& k = j["views"][4]["animals"][0]["keypoints"];
      CHECK(k["visibility"][1] == 1);  // in the middle of the box
      k["visibility"][1] = 2;
    });
    caught_only_by(copy, {"visibility"});
  }
  SUBCASE("inside the image, and said to be outside") {
    edit_json(copy.data.record(1), [](Json& j) { j["views"][4]["animals"][0]["keypoints"]["visibility"][1] = 0; });
    caught_only_by(copy, {"visibility"});
  }
}

TEST_CASE("cameras") {
  Copy copy;
  const fs::path manifest = copy.folder / "data" / manifest_name;
  SUBCASE("turned a little in parameters.cfg") {
    edit_text(copy.data.parameters_cfg(), "center_cam_rz_rad = ", "center_cam_rz_rad = 1");
    caught_only_by(copy, {"parameters.cfg gives", "through parameters.cfg"});
  }
  SUBCASE("another lens in parameters.cfg") {
    edit_text(copy.data.parameters_cfg(), "focal_length_mm = 100", "focal_length_mm = 100.1");
    caught_only_by(copy, {"parameters.cfg gives", "through parameters.cfg"});
  }
  SUBCASE("a camera is missing there") {
    edit_text(copy.data.parameters_cfg(), "[extrinsics_Camera.004]", "[extrinsics_Camera.044]");
    caught_by(copy, "parameters.cfg gives");
  }
  SUBCASE("a Y angle") {
    edit_text(copy.data.parameters_cfg(), "center_cam_ry_rad = 0", "center_cam_ry_rad = 0.1");
    caught_by(copy, "no Y angle");
  }
  SUBCASE("a camera out of the ring") {
    edit_json(manifest, [](Json& j) {
      j["cameras"][3]["world_to_camera"][11] = j["cameras"][3]["world_to_camera"][11].get<double>() + 0.01;
    });
    caught_by(copy, "45 degrees");
    caught_by(copy, "through world_to_camera");
    caught_by(copy, "reprojects to the pixel");
  }
  SUBCASE("a principal point half a pixel off") {
    edit_json(manifest, [](Json& j) {
      for (Json& c : j["cameras"]) c["cx"] = c["cx"].get<double>() + 0.5;
    });
    caught_by(copy, "parameters.cfg gives");
    caught_by(copy, "through world_to_camera");
    caught_by(copy, "reprojects to the pixel");
  }
}
