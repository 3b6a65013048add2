#include "tests/dataset/helpers.h"

using namespace moomill;
using namespace moomill::test;

namespace {

Manifest cow(Subset subset) {
  Manifest m;
  m.subset = subset;
  m.animals = subset == Subset::occlusions ? std::vector<std::string>{"cow", "cow"} : std::vector<std::string>{"cow"};
  for (int i = 0; i < 12; ++i) m.coats.push_back("coat" + std::to_string(i));
  m.coat_indices =
      subset == Subset::occlusions ? std::vector<int>{11} : std::vector<int>{0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11};
  return m;
}

}  // namespace

TEST_CASE("the main set lies where the public loader looks") {
  const Manifest m = cow(Subset::main);
  const char* names[] = {"Cow_Holstein.tif",  "Cow_brown.png",          "Cow_brown2.png",    "Cow_freckles.png",
                         "Cow_freckles2.png", "Cow_holstein2.png",      "Cow_holstein3.png", "Cow_holstein4.png",
                         "Cow_holstein5.png", "Cow_Limousine_Spec.tif", "Cow_white.png"};
  for (int i = 0; i < 11; ++i)
    CHECK(file_of(m, Modality::rgb, 1, 0, i, -1) ==
          fmt::format("cow_animation_alltextures.blend/{}/000/Image0001.000.jpg", names[i]));
  CHECK(file_of(m, Modality::rgb, 910, 23, 11, -1) == "cow_animation_Limousine.blend/023/Image0910.023.jpg");
  CHECK(file_of(m, Modality::silhouette, 7, 3, -1, -1) ==
        "cow_animation_alltextures.blend/Cow_Holstein.tif/003/objectID0007.003.png");
  CHECK(file_of(m, Modality::depth, 7, 3, -1, -1) ==
        "cow_animation_alltextures.blend/Cow_Holstein.tif/003/depth0007.003.exr");
  CHECK(expand_template(nnopcs8_template(m), 7, 3) == "cow_positional_encoding/003/Image0007.003.png");
  CHECK(file_of(m, Modality::nnopcs, 7, 3, -1, -1) == "cow_positional_encoding/003/nnopcs0007.003.exr");
  CHECK(file_of(m, Modality::part, 7, 3, -1, -1) == "part/003/part0007.003.png");
  CHECK(file_of(m, Modality::triangle, 7, 3, -1, -1) == "triangle/003/triangle0007.003.exr");
  CHECK(file_of(m, Modality::occlusion, 7, 3, -1, 0) == "occlusion/003/occlusion0007.003.png");
  CHECK(keypoints_csv_path(m) == "cow_animation_alltextures.blend/Cow_Holstein.tif/keypoints.csv");
  CHECK(parameters_cfg_path(m) == "cow_animation_alltextures.blend/Cow_Holstein.tif/parameters.cfg");
  CHECK(expand_template(record_template(), 12, 0) == "frames/0012.json");
}

TEST_CASE("novel views") {
  const Manifest m = cow(Subset::novel_views);
  CHECK(file_of(m, Modality::rgb, 91, 22, 10, -1) ==
        "cow_animation_alltextures_10newcameras.blend/Cow_white.png/022/Image0091.022.jpg");
  CHECK(file_of(m, Modality::rgb, 91, 22, 11, -1) ==
        "cow_animation_alltextures_10newcameras.blend/Cow_Limousine.tif/022/Image0091.022.jpg");
  CHECK(file_of(m, Modality::depth, 91, 22, -1, -1) ==
        "cow_animation_alltextures_10newcameras.blend/Cow_Holstein.tif/022/depth0091.022.exr");
  CHECK(expand_template(nnopcs8_template(m), 91, 1) ==
        "cow_animation_positional_encoding_10newcameras.blend/001/Image0091.001.png");
  CHECK(keypoints_csv_path(m) == "cow_animation_alltextures_10newcameras.blend/Cow_Holstein.tif/keypoints.csv");
}

TEST_CASE("occlusions") {
  const Manifest m = cow(Subset::occlusions);
  CHECK(file_of(m, Modality::rgb, 50, 6, 11, -1) == "cow_occlusions/006/Image0050.006.jpg");
  CHECK(file_of(m, Modality::silhouette, 50, 6, -1, -1) == "cow_occlusions/006/objectID0050.006.png");
  CHECK(file_of(m, Modality::occlusion, 50, 6, -1, 0) == "cow_occlusions/006/objectID_complete_mask_0050.006.png");
  CHECK(keypoints_csv_path(m) == "cow_occlusions/keypoints.csv");
  CHECK(parameters_cfg_path(m) == "cow_occlusions/parameters.cfg");
}

TEST_CASE("other species") {
  Manifest m;
  m.species = "horse";
  m.coats = {"bay", "my/pictures/dapple.png", "../sly"};
  m.coat_indices = {0, 1};
  m.animals = {"horse"};
  CHECK(file_of(m, Modality::rgb, 1, 2, 0, -1) == "horse_animation_alltextures/bay/002/Image0001.002.jpg");
  CHECK(coat_folder(m, 1) == "horse_animation_alltextures/my_pictures_dapple.png");
  CHECK(coat_folder(m, 2).find("/..") == std::string::npos);
  CHECK(expand_template(nnopcs8_template(m), 1, 2) == "horse_positional_encoding/002/Image0001.002.png");
}

TEST_CASE("no two modalities, coats, animals, frames or cameras share a path") {
  for (Subset subset : {Subset::main, Subset::novel_views, Subset::occlusions}) {
    Manifest m = cow(subset);
    m.animals = {"cow", "cow", "cow"};
    std::map<std::string, int> seen;
    for (int frame : {1, 2, 12345})
      for (int camera : {0, 23})
        for (const ModalityRow& r : modality_table()) {
          if (r.storage == Storage::record) continue;
          if (r.per_coat)
            for (int coat : m.coat_indices) ++seen[file_of(m, r.id, frame, camera, coat, -1)];
          else if (r.id == Modality::occlusion)
            for (int animal = 0; animal < 3; ++animal) ++seen[file_of(m, r.id, frame, camera, -1, animal)];
          else
            ++seen[file_of(m, r.id, frame, camera, -1, -1)];
          if (r.id == Modality::nnopcs) ++seen[expand_template(nnopcs8_template(m), frame, camera)];
        }
    for (const auto& [path, count] : seen) CHECK_MESSAGE(count == 1, path);
  }
}

TEST_CASE("permutation and splits are NumPy's") {
  CHECK(numpy_permutation(0, 10) == std::vector<int>{2, 8, 4, 9, 1, 6, 7, 3, 0, 5});
  CHECK(numpy_permutation(0, 0).empty());
  CHECK(numpy_permutation(0, 1) == std::vector<int>{0});
  std::vector<int> frames;
  for (int f = 1; f <= 910; ++f) frames.push_back(f);
  const Splits s = make_splits(frames);
  CHECK(s.train.size() == 630);
  CHECK(s.validate.size() == 90);
  CHECK(s.test.size() == 190);
  std::vector<int> all;
  for (const auto* split : {&s.train, &s.validate, &s.test}) all.insert(all.end(), split->begin(), split->end());
  std::sort(all.begin(), all.end());
  CHECK(all == frames);
  const std::vector<int> order = numpy_permutation(0, 91);
  CHECK(std::binary_search(s.train.begin(), s.train.end(), order[0] * 10 + 1));
  CHECK(std::binary_search(s.validate.begin(), s.validate.end(), order[63] * 10 + 1));
  CHECK(std::binary_search(s.test.begin(), s.test.end(), order[90] * 10 + 10));

  frames.resize(9);
  CHECK(make_splits(frames).test.size() == 9);
  CHECK(make_splits(frames).train.empty());
  frames.resize(1);
  CHECK(make_splits({5}).test == std::vector<int>{5});
  std::vector<int> odd;
  for (int f = 1; f <= 95; ++f) odd.push_back(f);
  const Splits t = make_splits(odd);
  CHECK(t.train.size() + t.validate.size() + t.test.size() == 95);
}

TEST_CASE("a manifest reads back as it was") {
  Manifest m = small_manifest(12);
  m.cameras[0].centre = {1.0 / 3, -0.1, 1e-17};
  m.held_frames = {2, 4};
  const Json json = manifest_to_json(m);
  const Manifest back = manifest_from_json(Json::parse(json.dump()), "manifest.json");
  CHECK(manifest_to_json(back) == json);
  CHECK(back.cameras[0].centre == m.cameras[0].centre);
  CHECK(back.held_frames == m.held_frames);
  CHECK(manifest_identity(back) == manifest_identity(m));
  CHECK(json.at("splits").at("test").size() + json.at("splits").at("train").size() +
            json.at("splits").at("validate").size() ==
        12);
  for (const Json& entry : json.at("modalities")) CHECK(entry.contains("background"));

  Json foreign = json;
  foreign["schema_version"] = 99;
  CHECK(message_of<InputError>([&] { manifest_from_json(foreign, "x/manifest.json"); }).find("x/manifest.json") == 0);
  foreign = json;
  foreign.erase("cameras");
  CHECK(message_of<InputError>([&] { manifest_from_json(foreign, "m"); }).find("cameras") != std::string::npos);
  foreign = json;
  foreign["keypoints"]["skeleton"] = Json::parse("[[0, 7]]");
  CHECK_THROWS_AS(manifest_from_json(foreign, "m"), InputError);
  CHECK_THROWS_AS(manifest_from_json(Json::array(), "m"), InputError);
}
