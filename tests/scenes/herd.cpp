// Individuals of a breed: pure functions of (file, seed, index); herds in scenes; batches of any size, same pictures.
#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <cstring>

#include "generator/core/parallel.h"
#include "generator/dataset/reader.h"
#include "scenes/appearance.h"
#include "scenes/breed_file.h"
#include "scenes/generate.h"
#include "scenes/runner.h"
#include "tests/temporary_file.h"

using namespace moomill;
using test::contains;
using test::message_of;
using test::TemporaryFile;

namespace {

const PatchPattern& patches_of(const Coat& coat) {
  return std::get<PatchPattern>(std::get<ProceduralCoat>(coat.source).base);
}

bool same(const Coat& a, const Coat& b) {
  const auto &x = std::get<ProceduralCoat>(a.source), &y = std::get<ProceduralCoat>(b.source);
  bool equal = a.name == b.name && x.seed == y.seed && x.fur == y.fur && x.marks.size() == y.marks.size() &&
               x.shades.size() == y.shades.size() && x.parts.size() == y.parts.size();
  for (std::size_t i = 0; equal && i < x.marks.size(); ++i)
    equal = x.marks[i].at == y.marks[i].at && x.marks[i].radii == y.marks[i].radii && x.marks[i].color == y.marks[i].color;
  const PatchPattern &p = patches_of(a), &q = patches_of(b);
  return equal && p.share == q.share && p.scale == q.scale && p.ground == q.ground && p.patch == q.patch && p.low == q.low;
}

std::string breed_text(const std::string& more = "", const std::string& share = "{ normal = [0.5, 0.1], clamp = [0.2, 0.8] }") {
  return "[coat.patches]\nshare = " + share + "\n" + more;
}

std::string refusal(const std::string& text) {
  const TemporaryFile file("breed.toml", text);
  return message_of([&] { read_breed(file.path.string(), "cow", {}); });
}

std::string herd_scene(const std::string& coats, const std::string& more = "") {
  return "modalities = [\"rgb\", \"silhouette\"]\n[[animals]]\nspecies = \"cow\"\ncoats = " + coats +
         "\nposes = [{ clip = \"walk\", count = 1 }]\n[cameras]\nresolution = [32, 24]\nonly = [2]\n[render]\nsamples = 2\n"
         "coat_resolution = 64\n" + more;
}

SceneSpec scene_of(const std::string& text) {
  const TemporaryFile file("scene.toml", text);
  return read_scene(file.path);
}

}  // namespace

TEST_CASE("an individual is a function of breed, seed and index alone, on any thread") {
  const Breed breed = read_breed("holstein", "cow", {});
  std::vector<Coat> herd(600);
  parallel_for(herd.size(), 7, [&](std::size_t i) { herd[i] = individual(breed, 7, static_cast<int>(i)); });
  CHECK(herd[500].name == "holstein_000500");
  CHECK(same(herd[500], individual(read_breed("holstein", "cow", {}), 7, 500)));
  for (int i = 0; i < 600; i += 37) CHECK(same(herd[i], individual(breed, 7, i)));
  CHECK_FALSE(same(herd[500], individual(breed, 8, 500)));
  CHECK(patches_of(herd[500]).share != patches_of(herd[499]).share);
}

TEST_CASE("draws have the distributions that the file gives them") {
  const TemporaryFile file("breed.toml", R"([draws]
head = { choose = ["star", "plain", "none"], weights = [5, 3, 2] }
[coat]
fur = { uniform = [0.1, 0.3] }
[coat.patches]
share = { normal = [0.5, 0.1], clamp = [0.3, 0.9], draw = "dark" }
low = { normal = [0.3, -0.05], clamp = [0.1, 0.5], draw = "dark" }
scale_m = { log_uniform = [0.1, 1] }
patch = { uniform = [[0, 0.1, 0.2], [0.1, 0.3, 0.2]] }
[[coat.marks]]
when = { head = "star" }
at = [1, 0, 0]
radii_m = [0.1, { uniform = [0.1, 0.2] }, 0.1]
[[coat.marks]]
chance = 0.25
at = [2, 0, 0]
radii_m = [0.1, 0.1, 0.1]
)");
  const Breed breed = read_breed(file.path.string(), "cow", {});
  constexpr int n = 20000;
  double share = 0, squares = 0, fur = 0, log_scale = 0, stars = 0, by_chance = 0, least = 1;
  for (int i = 0; i < n; ++i) {
    const Coat coat = individual(breed, 1, i);
    const auto& c = std::get<ProceduralCoat>(coat.source);
    const PatchPattern& p = patches_of(coat);
    share += p.share / n;
    squares += p.share * p.share / n;
    least = std::min(least, p.share);
    fur += c.fur / n;
    log_scale += std::log10(p.scale) / n;
    // One draw, turned round: dark animals have low limits.
    if (p.share > 0.301 && p.low > 0.101 && p.low < 0.499) CHECK(p.low == doctest::Approx(0.3 - 0.5 * (p.share - 0.5)));
    CHECK(p.patch.y == doctest::Approx(0.1 + 2 * p.patch.x));  // on the line between the two
    for (const Mark& m : c.marks) (m.at.x == 1 ? stars : by_chance) += 1.0 / n;
  }
  // Bounds of five standard errors.
  CHECK(std::abs(share - 0.5) < 5 * 0.1 / std::sqrt(n) + 0.001);  // the clamp cuts 2.3 % on the lower side
  CHECK(std::sqrt(squares - share * share) == doctest::Approx(0.098).epsilon(0.03));
  CHECK(least == 0.3);
  CHECK(std::abs(fur - 0.2) < 5 * 0.058 / std::sqrt(n));
  CHECK(std::abs(log_scale + 0.5) < 5 * 0.289 / std::sqrt(n));
  CHECK(std::abs(stars - 0.5) < 5 * 0.5 / std::sqrt(n));
  CHECK(std::abs(by_chance - 0.25) < 5 * 0.433 / std::sqrt(n));
}

TEST_CASE("every breed that ships can be drawn from") {
  const std::vector<std::string> names = shipped_breeds("cow");
  CHECK(std::count(names.begin(), names.end(), "holstein") == 1);
  for (const std::string& name : names) {
    INFO(name);
    const Breed breed = read_breed(name, "cow", {});
    CHECK_FALSE(breed.about.empty());
    CHECK_FALSE(breed.sources.empty());
    for (int i = 0; i < 200; ++i) CHECK(individual(breed, 3, i).name == individual_name(name, i));
  }
}

TEST_CASE("a bad breed file is refused when it is read, whatever its draws would have come out as") {
  CHECK(contains(message_of([] { read_breed("holstien", "cow", {}); }), "did you mean 'holstein'?"));
  CHECK(contains(refusal("about = \"x\"\n"), "'coat' is missing"));
  CHECK(contains(refusal(breed_text("", "{ uniform = [0.2, 1.2] }")), "'share' in [coat.patches] must be a number from 0 to 1, not 1.2"));
  CHECK(contains(refusal(breed_text("", "{ normal = [0.5, 0.1] }")), "'clamp' in [coat.patches.share] is missing"));
  CHECK(contains(refusal(breed_text("", "{ uniform = [0.2, 0.4], choose = [1] }")), "exactly one of"));
  CHECK(contains(refusal(breed_text("", "{ choose = [0.2, 0.3], weights = [1] }")), "must hold 2 numbers"));
  CHECK(contains(refusal(breed_text("sahre = 2\n")), "unknown key 'sahre'"));
  CHECK(contains(refusal(breed_text("[coat]\nseed = 3\n")), "'seed' in [coat] cannot be given"));
  CHECK(contains(refusal(breed_text("[[coat.marks]]\nwhen = { head = \"star\" }\nat = [0, 0, 0]\nradii_m = [1, 1, 1]\n")),
                 "the draw 'head', which [draws] does not have"));
  CHECK(contains(refusal("[draws]\nhead = { choose = [\"a\", \"b\"] }\n" +
                         breed_text("[[coat.marks]]\nwhen = { head = \"c\" }\nat = [0, 0, 0]\nradii_m = [1, 1, 1]\n")),
                 "which it never is"));
  // One of several choices, far from the first.
  CHECK(contains(refusal(breed_text("", "{ choose = [0.1, 0.2, 0.3, 7] }")), "not 7"));
}

TEST_CASE("scenes name herds, alone and among other coats") {
  const SceneSpec s = scene_of(herd_scene("[\"00_holstein\", { breed = \"holstein\", count = 3, seed = 7, first = 5 }, { breed = \"holstein\", count = 1, seed = 8 }]"));
  CHECK(s.animals[0].coats == std::vector<std::string>{"00_holstein", "holstein_000005", "holstein_000006", "holstein_000007",
                                                       "holstein_seed8_000000"});
  CHECK(s.animals[0].individual(0) == nullptr);
  CHECK(*s.animals[0].individual(3) == Individual{"holstein", 7, 7});
  CHECK(s.coat_indices.size() == 5);
  const Json coats = s.resolved["animals"][0]["coats"];
  CHECK(coats == Json::parse(R"(["00_holstein", {"breed": "holstein", "count": 3, "first": 5, "seed": 7},
                                {"breed": "holstein", "count": 1, "first": 0, "seed": 8}])"));
  SceneSpec few = scene_of(herd_scene("{ breed = \"holstein\", count = 1000, seed = 7 }"));
  CHECK(few.animals[0].coats.size() == 1000);
  Overrides o;
  o.coats = {0, 12, 999};
  apply_overrides(few, o);
  CHECK(few.coat_indices == o.coats);
  const std::string text = plan(few).text;
  CHECK(contains(text, "3 of 1000, traced in one go"));
}

TEST_CASE("what a herd cannot be is refused") {
  const auto refused = [](const std::string& coats, const std::string& more = "") {
    return message_of([&] { scene_of(herd_scene(coats, more)); });
  };
  CHECK(contains(refused("{ breed = \"holstien\", count = 3 }"), "did you mean 'holstein'?"));
  CHECK(contains(refused("{ breed = \"holstein\", count = 0 }"), "'count' in [animals[0].coats] must be a whole number from 1 to"));
  CHECK(contains(refused("{ breed = \"holstein\", count = -4 }"), "'count' in [animals[0].coats] must be a whole number from 1 to"));
  CHECK(contains(refused("{ breed = \"holstein\" }"), "'count' in [animals[0].coats] is missing"));
  CHECK(contains(refused("{ breed = \"holstein\", count = 2, sede = 1 }"), "did you mean 'seed'?"));
  CHECK(contains(refused("[{ breed = \"holstein\", count = 2 }, { breed = \"holstein\", count = 2 }]"), "a second time"));
  CHECK(contains(refused("[3]"), "must hold names and tables"));
  CHECK(contains(refused("7"), "must be a list of names, or a table"));
  SceneSpec large = scene_of(herd_scene("{ breed = \"holstein\", count = 2 }", "memory_mb = 100\n"));
  large.render.coat_resolution = 8192;
  CHECK(contains(message_of([&] { const Mill mill(large); }), "render.memory_mb = 100 is too little for one coat of 8192 x 8192"));
}

TEST_CASE("more coats than are shaded at once come in batches; a coat's picture does not depend on them") {
  SceneSpec herd = scene_of(herd_scene("{ breed = \"holstein\", count = 40, seed = 7 }"));
  CHECK(plan_batches(herd).coats == 40);
  herd.render.memory_mb = 8 * 3 * 64 * 64 * 32.5 / 1e6;
  const Mill mill(herd);
  const Frame frame = mill.prepare(1);
  CHECK(mill.batches() == 2);
  const View all = mill.trace(frame, frame.cameras.at(0));
  CHECK(mill.counts().first_hits == 1);  // labels once, whatever the batches
  CHECK(mill.counts().coats == 40);      // each baked once
  mill.trace(frame, frame.cameras.at(0));
  CHECK(mill.counts().coats == 40);
  CHECK(all.maps.size() == 41);
  // So little memory that few coats fit, and only the first batch is kept.
  SceneSpec tight = herd;
  tight.render.coat_resolution = 64;
  tight.render.memory_mb = 8 * 3 * 64 * 64 * 3.5 / 1e6;
  const BatchPlan plan = plan_batches(tight);
  CHECK(plan.coats == 3);
  const Mill small(tight);
  CHECK(small.batches() == 14);
  const View again = small.trace(small.prepare(1), frame.cameras.at(0));
  for (int coat = 0; coat < 40; ++coat) CHECK(again.find(Modality::rgb, coat)->f.data == all.find(Modality::rgb, coat)->f.data);
  // Alone.
  for (const int coat : {0, 39}) {
    SceneSpec one = herd;
    Overrides o;
    o.coats = {coat};
    apply_overrides(one, o);
    const Mill lone(one);
    const View view = lone.trace(lone.prepare(1), frame.cameras.at(0));
    CHECK(view.find(Modality::rgb, coat)->f.data == all.find(Modality::rgb, coat)->f.data);
  }
  CHECK(all.find(Modality::rgb, 0)->f.data != all.find(Modality::rgb, 1)->f.data);
}

TEST_CASE("a dataset of a herd says whose coat is whose, in folders of their names") {
  const TemporaryFile file("scene.toml", herd_scene("[\"00_holstein\", { breed = \"holstein\", count = 34, seed = 7 }]"));
  GenerateOptions options;
  options.out = file.folder() / "out";
  generate(read_scene(file.path), options);
  const DatasetFolder made = open_dataset(options.out);
  const Manifest& m = made.manifest;
  REQUIRE(m.individuals.size() == 35);
  CHECK_FALSE(m.individuals[0]);
  CHECK(*m.individuals[12] == Individual{"holstein", 7, 11});
  CHECK(coat_folder(m, 0) == "cow_animation_alltextures.blend/Cow_Holstein.tif");
  CHECK(coat_folder(m, 11) == "cow_animation_alltextures.blend/holstein_000010");
  CHECK(coat_folder(m, 34) == "cow_animation_alltextures.blend/holstein_000033");
  for (int coat = 0; coat < 35; ++coat)
    CHECK(std::filesystem::is_regular_file(options.out / file_of(m, Modality::rgb, 1, 2, coat, -1)));
}
