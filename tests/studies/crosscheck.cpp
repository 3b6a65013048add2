// The cross-check against Cycles: what is exported can be read back, and known differences are measured as what they are.
#include "validate/studies/crosscheck.h"

#include <doctest/doctest.h>

#include <cstring>

#include "generator/dataset/codecs.h"
#include "generator/dataset/json.h"
#include "tests/rigs/fixtures.h"
#include "tests/temporary_file.h"

using namespace moomill;

namespace {

SceneSpec tiny_scene() {
  SceneSpec scene = read_scene(data_root() / "scenes/quick.toml");
  Overrides o;
  o.resolution = {48, 36};
  o.samples = 16;
  o.cameras = {3};
  o.coats = {0};
  apply_overrides(scene, o);
  scene.render.coat_resolution = 64;
  return scene;
}

// A tube in its bind pose, which is there in no time; the rig lies in the folder.
SceneSpec tube_scene(const std::filesystem::path& folder) {
  write_glb(fixtures::tube(), folder / "tube.glb");
  std::ofstream(folder / "tube.toml") << "[[animals]]\nspecies = \"tube.glb\"\n";
  SceneSpec scene = read_scene(folder / "tube.toml");
  Overrides o;
  o.resolution = {48, 36};
  o.samples = 4;
  o.cameras = {19};
  apply_overrides(scene, o);
  return scene;
}

template <class T>
std::vector<T> values_of(const std::filesystem::path& folder, const Json& name) {
  const auto bytes = read_file(folder / name.get<std::string>());
  std::vector<T> out(bytes.size() / sizeof(T));
  std::memcpy(out.data(), bytes.data(), bytes.size());
  return out;
}

// A disc of radius 8 pixels in the middle of 24 x 24, two metres away.
LabelMaps disc() {
  LabelMaps m{24, 24, std::vector<std::uint32_t>(576), std::vector<float>(576), std::vector<float>(3 * 576)};
  for (int y = 0; y < 24; ++y)
    for (int x = 0; x < 24; ++x)
      if (std::hypot(x - 11.5, y - 11.5) < 8) {
        m.animal[24 * y + x] = 1;
        m.depth[24 * y + x] = 2;
        for (int k = 0; k < 3; ++k) m.nnopcs[3 * (24 * y + x) + k] = 0.5f;
      }
  return m;
}

ImageF flat_picture(int width, int height, float level) {
  ImageF image(width, height, 4, level);
  for (std::size_t p = 3; p < image.data.size(); p += 4) image.data[p] = 1;
  return image;
}

double value_of(const StudyResult& r, const std::string& name) {
  for (const Figure& f : r.figures)
    if (f.name == name) return f.value;
  FAIL("no figure ", name);
  return 0;
}

}  // namespace

TEST_CASE("an exported frame holds the posed mesh, the camera, the lights and the coat as they are") {
  const test::TemporaryFile here("x", "");
  SceneSpec spec = tiny_scene();
  const Mill mill(spec);
  const Frame frame = mill.prepare(1);
  const auto dressed = mill.dress(frame, 0);
  export_crosscheck(mill, frame, *dressed, here.folder());
  const Json j = parse_json_file(here.folder() / "scene.json");
  const Instance& in = frame.geometry->scene.instances.at(0);
  const Json& e = j.at("instances").at(0);
  const auto positions = values_of<vec3>(here.folder(), e.at("positions"));
  CHECK(positions == in.posed.positions);
  CHECK(values_of<vec3>(here.folder(), e.at("normals")) == in.posed.normals);
  CHECK(values_of<vec3>(here.folder(), e.at("nnopcs")) == in.surface->nnopcs);
  CHECK(values_of<uvec3>(here.folder(), e.at("faces")) == in.surface->triangles);
  CHECK(values_of<std::uint16_t>(here.folder(), e.at("parts")) == in.surface->parts);
  CHECK(e.at("vertices") == positions.size());

  // A vertex lands in the same pixel by the exported camera, relative to the origin, and by the recorded one.
  const CameraRecord& camera = frame.cameras.at(0);
  const Json& c = j.at("cameras").at(0);
  CHECK(c.at("id") == 3);
  for (int r = 0; r < 3; ++r) {
    double relative = c.at("world_to_camera").at(4 * r + 3), world = camera.world_to_camera[4 * r + 3];
    const dvec3 p = dvec3(positions[100]) + frame.geometry->scene.origin;
    for (int k = 0; k < 3; ++k) {
      relative += c.at("world_to_camera").at(4 * r + k).get<double>() * positions[100][k];
      world += camera.world_to_camera[4 * r + k] * p[k];
    }
    CHECK(relative == doctest::Approx(world).epsilon(1e-12));
  }
  // quick.toml names no light: an even sky of 0.5 and a sun.
  const Json& lights = c.at("lights");
  CHECK(lights.at("environment").at("constant").at(0) == doctest::Approx(0.5));
  CHECK(lights.at("environment").at("map").is_null());
  REQUIRE(lights.at("suns").size() == 1);
  CHECK(lights.at("suns")[0].at("irradiance").at(0) == doctest::Approx(1.6));

  const Json& material = j.at("materials").at(e.at("materials").at(0).get<std::size_t>());
  const Json& paint = j.at("paints").at(material.at("paint").get<std::size_t>());
  REQUIRE(paint.size() == 1);
  const Json& texture = j.at("textures").at(paint[0].at("texture").get<std::size_t>());
  CHECK(texture.at("width") == 64);
  const Paint& ours = *dressed->scene.appearance->paints.at(dressed->scene.appearance->materials[in.materials[0]].paint);
  std::vector<std::uint8_t> texels = ours.stack;  // one coat: not interleaved; and eight bytes of padding
  texels.resize(texels.size() - 8);
  CHECK(values_of<std::uint8_t>(here.folder(), texture.at("file")) == texels);
}

TEST_CASE("diffuse surfaces have neither shine nor bumps, and nothing else changes") {
  const Mill mill(tiny_scene());
  const auto dressed = mill.dress(mill.prepare(1), 0);
  const Dressed diffuse = with_surface(*dressed, CheckedSurface::diffuse);
  for (const Material& m : diffuse.scene.appearance->materials) {
    CHECK(m.specular == 0);
    CHECK(m.normal_texture == -1);
  }
  CHECK(diffuse.scene.appearance->paints == dressed->scene.appearance->paints);
  CHECK(dressed->scene.appearance->materials.at(0).specular == 1);
}

TEST_CASE("silhouettes that differ are counted, and excused only beside an outline") {
  const LabelMaps ours = disc();
  LabelMaps theirs = ours;
  CHECK(compare_labels(ours, theirs, {}).differing == 0);
  theirs.animal[24 * 11 + 11] = 0;  // a hole in the middle
  theirs.animal[24 * 2 + 2] = 1;    // a speck beside it
  const std::vector<OutlineSegment> through_speck = {{{2.505, 0}, {2.505, 24}}};  // 0.005 pixels from its centre
  const LabelDifference d = compare_labels(ours, theirs, through_speck);
  CHECK(d.differing == 2);
  CHECK(d.unexplained == 1);
  CHECK(d.farthest == doctest::Approx(8.995));
  CHECK(d.compared + 2 == d.pixels);
}

TEST_CASE("depth and neutral coordinates off by more than 1e-4 are counted") {
  const LabelMaps ours = disc();
  LabelMaps theirs = ours;
  theirs.depth[24 * 11 + 11] += 2e-4f;
  theirs.depth[24 * 11 + 12] += 0.5e-4f;
  theirs.nnopcs[3 * (24 * 12 + 11) + 1] += 3e-4f;
  const LabelDifference d = compare_labels(ours, theirs, {});
  CHECK(d.depth_off == 1);
  CHECK(d.nnopcs_off == 1);
  CHECK(d.depth_worst == doctest::Approx(2e-4).epsilon(0.01));
  CHECK(d.nnopcs_worst == doctest::Approx(3e-4).epsilon(0.01));
  theirs.depth[24 * 11 + 13] = std::numeric_limits<float>::quiet_NaN();  // never within anything
  CHECK(compare_labels(ours, theirs, {}).depth_off == 2);
}

TEST_CASE("colours: a brighter picture, a structured difference") {
  const ImageF grey = flat_picture(64, 48, 0.2f);
  ImageF other = flat_picture(64, 48, 0.2f * 1.01f);
  ColorDifference d = compare_colors(other, grey);
  CHECK(d.worst_mean == doctest::Approx(0.01).epsilon(1e-3));
  CHECK(d.block_rms == doctest::Approx(0.01).epsilon(1e-3));
  CHECK(d.alpha == 0);
  // Half brighter, half darker: the means agree, the blocks do not.
  for (int y = 0; y < 48; ++y)
    for (int x = 0; x < 64; ++x)
      for (int k = 0; k < 3; ++k) other.at(x, y, k) = x < 32 ? 0.21f : 0.19f;
  d = compare_colors(other, grey);
  CHECK(d.worst_mean < 1e-6);
  CHECK(d.block_rms == doctest::Approx(0.05).epsilon(1e-3));
  const Image8 sheet = difference_sheet(other, grey, 10);
  CHECK(sheet.at(128, 0, 0) > 140);
  CHECK(sheet.at(191, 0, 0) < 116);
}

TEST_CASE("outlines of the cow lie where its silhouette ends") {
  SceneSpec spec = tiny_scene();
  Overrides o;
  o.modalities = {"instance", "depth", "nnopcs"};
  apply_overrides(spec, o);
  const Mill mill(spec);
  const Frame frame = mill.prepare(1);
  const View view = mill.trace_labels(frame, frame.cameras.at(0));
  const ImageU32& animal = view.find(Modality::instance)->u;
  const auto outlines = outlines_in_view(frame.geometry->scene, frame.cameras.at(0));
  CHECK(outlines.size() > 100);
  int borders = 0;
  for (int y = 0; y < animal.height; ++y)
    for (int x = 0; x + 1 < animal.width; ++x) {
      if ((animal.at(x, y) == 0) == (animal.at(x + 1, y) == 0)) continue;
      ++borders;  // between two centres a pixel apart there is an edge, so it is near one of them
      CHECK(std::min(distance_to_outline({x + 0.5, y + 0.5}, outlines), distance_to_outline({x + 1.5, y + 0.5}, outlines)) <= 0.5);
    }
  CHECK(borders > 20);
}

TEST_CASE("a double-precision ray through every triangle finds what the renderer finds") {
  const test::TemporaryFile here("x", "");
  SceneSpec spec = tube_scene(here.folder());
  Overrides o;
  o.modalities = {"instance", "depth", "nnopcs"};
  apply_overrides(spec, o);
  const Mill mill(spec);
  const Frame frame = mill.prepare(spec.frames.front());
  const View view = mill.trace_labels(frame, frame.cameras.at(0));
  const ExactView exact(frame.geometry->scene, frame.cameras.at(0));
  LabelMaps ours{view.width, view.height, view.find(Modality::instance)->u.data, view.find(Modality::depth)->f.data, view.find(Modality::nnopcs)->f.data};
  std::size_t seen = 0;
  for (std::size_t p = 0; p < ours.animal.size(); p += 2) {
    const ExactView::Hit hit = exact.first_hit(static_cast<int>(p % ours.width), static_cast<int>(p / ours.width));
    REQUIRE(hit.animal == ours.animal[p]);
    if (hit.animal == 0) continue;
    ++seen;
    CHECK(ours.depth[p] == doctest::Approx(hit.depth).epsilon(1e-6));
    for (int k = 0; k < 3; ++k) CHECK(std::abs(ours.nnopcs[3 * p + k] - hit.nnopcs[k]) < 1e-5);
  }
  CHECK(seen > 20);

  // Of two that are off from each other, the one that was moved is told to be wrong, at every pixel where it is.
  LabelMaps theirs = ours;
  std::uint64_t moved = 0;
  for (std::size_t p = 0; p < theirs.animal.size(); ++p)
    if (theirs.animal[p] != 0 && p % 5 == 0) {
      (p % 2 ? theirs.depth[p] : theirs.nnopcs[3 * p]) += 3e-4f;
      ++moved;
    }
  const LabelJudgement j = judge_labels(ours, theirs, exact, 10);
  CHECK(j.off == moved);
  CHECK(j.off_ours_right == moved);
  CHECK(j.off_theirs_right == 0);
  CHECK(j.judged > moved);
  CHECK(j.our_depth < 1e-5);
  CHECK(j.their_depth == doctest::Approx(3e-4).epsilon(0.05));
  const LabelJudgement swapped = judge_labels(theirs, ours, exact, 10);
  CHECK(swapped.off_ours_right == 0);
  CHECK(swapped.off_theirs_right == moved);
}

TEST_CASE("Cycles bends a normal whose mirrored eye would leave under the triangle; blocks can do without") {
  ExactView::Hit hit;
  hit.geometric = {0, 0, 1};
  hit.normal = {0, 0, 1};
  hit.eye = glm::normalize(dvec3(1, 0, 0.3));
  CHECK_FALSE(bent_by_cycles(hit));
  hit.normal = glm::normalize(dvec3(-0.2, 0, 1));  // leans away from the eye: N.I = 0.09
  CHECK(bent_by_cycles(hit));
  hit.normal = glm::normalize(dvec3(0.2, 0, 1));
  CHECK_FALSE(bent_by_cycles(hit));

  const ImageF grey = flat_picture(64, 48, 0.2f);
  ImageF other = grey;
  std::vector<bool> spot(64 * 48, false);
  for (int y = 10; y < 14; ++y)
    for (int x = 20; x < 24; ++x) {
      other.at(x, y, 1) = 0.4f;
      spot[64 * y + x] = true;
    }
  CHECK(compare_colors(other, grey).block_rms > 0.01);
  const ColorDifference without = compare_colors(other, grey, spot);
  CHECK(without.block_rms == 0);
  CHECK(without.left_out == doctest::Approx(16 / (64.0 * 48)));
  CHECK(without.worst_mean_without == 0);
  CHECK(without.worst_mean == doctest::Approx(compare_colors(other, grey).worst_mean));
}

TEST_CASE("references of an export that has not changed are kept, others are rendered again") {
  const test::TemporaryFile here("blender", R"sh(#!/bin/sh
# Stands in for Blender: copies a picture for every render asked for, and notes which.
[ "$1" = --version ] && { echo "Blender $(cat "$(dirname "$0")/version")"; exit 0; }
here=$(dirname "$0")
while [ "$1" != -- ]; do shift; done
folder=$2
shift 2
while [ $# -gt 0 ]; do
  case $1 in
    --spp) spp=$2;;
    --sources) sources=$2;;
    --skip) skip=$2;;
  esac
  shift 2
done
mkdir -p "$folder/cycles"
: > "$here/rendered"
renders=
for n in $(echo "$spp" | tr , ' '); do
  name=rgb_principled_019_000_$n.exr
  [ "$name" = "$skip" ] && continue
  cp "$here/picture.exr" "$folder/cycles/$name"
  echo "$n" >> "$here/rendered"
  render="\"camera\": 19, \"coat\": 0, \"spp\": $n, \"surface\": \"principled\", \"wall_seconds\": $n, \"core_seconds\": $n"
  echo "{\"sources\": \"$sources\", $render}" > "$folder/cycles/$name.json"
  renders="$renders${renders:+, }{$render}"
done
echo "{\"blender\": \"3.4.1\", \"threads\": 2, \"start_seconds\": 1, \"build_seconds\": 1, \"renders\": [$renders]}" > "$folder/cycles/build.json"
)sh");
  const auto write = [&](const char* name, const std::string& text) { std::ofstream(here.folder() / name, std::ios::binary) << text; };
  std::filesystem::permissions(here.path, std::filesystem::perms::owner_all);
  write("version", "3.4.1");
  std::vector<float> level(48 * 36, 0.25f);
  std::vector<ExrChannel> channels;
  for (const char* name : {"View.Combined.A", "View.Combined.B", "View.Combined.G", "View.Combined.R"}) channels.push_back({name, level.data()});
  const auto picture = encode_exr(48, 36, channels);
  write("picture.exr", std::string(picture.begin(), picture.end()));

  CrosscheckOptions options;
  options.out = here.folder() / "out";
  options.blender = here.path.string();
  options.timing_samples = {4};
  options.reference_samples = 64;
  const SceneSpec scene = tube_scene(here.folder());
  const auto run = [&](const SceneSpec& of) {
    const StudyResult r = time_cycles(of, options);
    const auto bytes = read_file(here.folder() / "rendered");
    CHECK(value_of(r, "seconds of all renders") == 68);  // kept ones keep their times
    return std::string(bytes.begin(), bytes.end());
  };
  CHECK(run(scene) == "4\n64\n");
  CHECK(run(scene) == "4\n");
  SceneSpec other = scene;
  other.render.max_bounces = 3;
  CHECK(run(other) == "4\n64\n");
  CHECK(run(other) == "4\n");
  write("version", "3.6.0");  // another Blender may render other pictures
  CHECK(run(other) == "4\n64\n");
  std::filesystem::remove(options.out / "cycles" / "rgb_principled_019_000_64.exr.json");  // killed in the middle of it
  CHECK(run(other) == "4\n64\n");
}

TEST_CASE("without Blender one sentence says so") {
  const test::TemporaryFile here("x", "");
  CrosscheckOptions options;
  options.out = here.folder();
  options.blender = "no-such-blender";
  const std::string said = test::message_of([&] { crosscheck(tiny_scene(), options); });
  CHECK(test::contains(said, "no-such-blender"));
  CHECK(test::contains(said, "--blender"));
}

TEST_CASE("Cycles sees the same tiny cow" * doctest::skip(find_program("blender").empty())) {
  const test::TemporaryFile here("x", "");
  CrosscheckOptions options;
  options.out = here.folder();
  options.label_scale = 15;  // a pixel is 8 cm wide
  options.threads = 2;
  const StudyResult r = crosscheck(tiny_scene(), options);
  CHECK(value_of(r, "silhouette: of those farther than 0.01 px from an outline") == 0);
  CHECK(value_of(r, "depth: share within 1e-4 m") >= 0.99);  // of few pixels
  CHECK(value_of(r, "NNOPCS: share within 1e-4") >= 0.99);
  CHECK(value_of(r, "diffuse: worst difference of mean colours") < 0.03);  // 16 samples of a few hundred pixels: noise
  CHECK(value_of(r, "full: worst difference of mean colours") < 0.06);
  CHECK(std::filesystem::file_size(here.folder() / "crosscheck.csv") > 500);
  CHECK(std::filesystem::exists(here.folder() / "labels_003.png"));
}
