// Ranks and precisions of hand-made codes; files of codes.
#include "neural/identify.h"

#include <cmath>
#include <fstream>

#include "generator/core/error.h"
#include "generator/dataset/codecs.h"
#include "neural/commands_infer.h"
#include "tests/neural/doctest_torch.h"
#include "tests/temporary_file.h"

using namespace moomill;
using torch::Tensor;
namespace fs = std::filesystem;

namespace {

struct Row {
  float x, y;
  ViewId view;
};

CodeSet codes(const std::vector<Row>& rows, const std::string& cameras = "rings") {
  CodeSet set;
  set.codes = torch::empty({static_cast<std::int64_t>(rows.size()), 2});
  for (std::size_t i = 0; i < rows.size(); ++i) {
    set.codes[static_cast<std::int64_t>(i)][0] = rows[i].x;
    set.codes[static_cast<std::int64_t>(i)][1] = rows[i].y;
    set.views.push_back(rows[i].view);
    set.names.push_back("coat" + std::to_string(rows[i].view.coat));
  }
  set.cameras = cameras;
  set.dataset = "by hand";
  set.model = "none";
  return set;
}

constexpr CodeDistance euclidean = CodeDistance::euclidean;

}  // namespace

TEST_CASE("distances between codes") {
  const Tensor a = torch::tensor({{3.0f, 0.0f}, {0.0f, 0.0f}}),
               b = torch::tensor({{0.0f, 4.0f}, {6.0f, 0.0f}, {-1.0f, 0.0f}});
  const Tensor e = code_distances(a, b, euclidean), c = code_distances(a, b, CodeDistance::cosine);
  CHECK(e[0][0].item<double>() == doctest::Approx(5));
  CHECK(e[0][1].item<double>() == doctest::Approx(3));
  CHECK(c[0][0].item<double>() == doctest::Approx(1));
  CHECK(c[0][1].item<double>() == doctest::Approx(0));
  CHECK(c[0][2].item<double>() == doctest::Approx(2));
  CHECK(c[1][0].item<double>() == doctest::Approx(1));  // a code of length zero
}

TEST_CASE("rank and average precision of a ranking worked out by hand") {
  // By distance from the query at 0: own, other, own, other, other, other, own.
  const CodeSet query = codes({{0, 0, {1, 0, 5}}});
  const CodeSet gallery = codes({{1, 0, {2, 1, 5}},
                                 {2, 0, {2, 1, 6}},
                                 {3, 0, {2, 2, 5}},
                                 {4, 0, {2, 1, 7}},
                                 {5, 0, {2, 2, 6}},
                                 {6, 0, {2, 2, 7}},
                                 {7, 0, {2, 3, 5}}});
  const std::vector<QueryMatch> m = match_codes(query, gallery, euclidean, {});
  CHECK(m[0].nearest == 0);
  CHECK(m[0].others_before == 0);
  CHECK(m[0].precision == doctest::Approx((1.0 + 2.0 / 3 + 3.0 / 7) / 3));
  const Reidentification r = summarise(m, query);
  CHECK(r.rank1 == 1);
  CHECK(r.mean_precision == doctest::Approx((1.0 + 2.0 / 3 + 3.0 / 7) / 3));
}

TEST_CASE("rank-5 counts a match in fifth place and not one in sixth") {
  std::vector<Row> rows;
  for (int i = 1; i <= 4; ++i) rows.push_back({static_cast<float>(i), 0, {2, 1, 9}});
  rows.push_back({4.5f, 0, {2, 1, 5}});
  const CodeSet query = codes({{0, 0, {1, 0, 5}}});
  Reidentification r = summarise(match_codes(query, codes(rows), euclidean, {}), query);
  CHECK(r.rank1 == 0);
  CHECK(r.rank5 == 1);
  CHECK(r.mean_precision == doctest::Approx(0.2));
  rows.push_back({0.5f, 0, {2, 1, 9}});
  r = summarise(match_codes(query, codes(rows), euclidean, {}), query);
  CHECK(r.rank5 == 0);
}

TEST_CASE("ties count against the query: codes that are all alike identify nobody") {
  std::vector<Row> rows;
  for (int frame = 0; frame < 4; ++frame)
    for (int coat = 0; coat < 3; ++coat) rows.push_back({1, 2, {frame, frame, coat}});
  const CodeSet set = codes(rows);
  for (const CodeDistance distance : {euclidean, CodeDistance::cosine}) {
    const Reidentification r = summarise(match_codes(set, set, distance, {}), set);
    CHECK(r.queries == 12);
    CHECK(r.rank1 == 0);
    // Six others before three of its own: (1/7 + 2/8 + 3/9) / 3.
    CHECK(r.mean_precision == doctest::Approx((1.0 / 7 + 2.0 / 8 + 3.0 / 9) / 3));
  }
}

TEST_CASE("the gallery holds neither the query's pose nor its camera") {
  const CodeSet query = codes({{0, 0, {1, 1, 0}}});
  const CodeSet gallery = codes({{0.0f, 0, {1, 1, 0}},  // itself
                                 {0.1f, 0, {1, 2, 0}},  // its pose
                                 {0.2f, 0, {2, 1, 0}},  // its camera
                                 {0.3f, 0, {2, 2, 1}},  // another coat
                                 {0.4f, 0, {2, 2, 0}}});
  CHECK(match_codes(query, gallery, euclidean, {true, true})[0].nearest == 3);
  CHECK(match_codes(query, gallery, euclidean, {true, true})[0].precision == doctest::Approx(0.5));
  CHECK(match_codes(query, gallery, euclidean, {true, false})[0].nearest == 2);
  CHECK(match_codes(query, gallery, euclidean, {false, true})[0].nearest == 1);
  CHECK(match_codes(query, gallery, euclidean, {false, false})[0].nearest == 0);
  // Cameras of another numbering are other cameras.
  CHECK(disjoint_of(query, gallery).cameras);
  CHECK_FALSE(disjoint_of(codes({{0, 0, {1, 1, 0}}}, "further ones"), gallery).cameras);
  // A photo is of no pose and no camera that is known.
  CHECK(match_codes(codes({{0, 0, {-1, -1, -1}}}), gallery, euclidean, {true, true})[0].nearest == 0);
}

TEST_CASE("queries without a match are counted and left out") {
  const CodeSet query = codes({{0, 0, {1, 1, 0}}, {0, 0, {1, 1, 7}}, {0, 0, {2, 2, 0}}});
  const CodeSet gallery = codes({{1, 0, {2, 2, 0}}, {2, 0, {2, 2, 3}}});
  const std::vector<QueryMatch> m = match_codes(query, gallery, euclidean, {});
  const Reidentification r = summarise(m, query);
  CHECK(r.queries == 1);
  CHECK(r.without_match == 1);  // coat 7 has nobody; the third has nothing to be compared with
  CHECK(r.rank1 == 1);
  CHECK(m[2].nearest == -1);
  CHECK_FALSE(m[2].has_match);
  CHECK(std::isnan(summarise({}, codes({})).rank1));
  CHECK(std::isnan(summarise(m, query, 7).rank1));
}

TEST_CASE("a pair of coats is told apart among these two alone") {
  // Coat 3 lies between; without it 9 and 10 are told apart.
  std::vector<Row> rows;
  for (int frame = 0; frame < 2; ++frame) {
    rows.push_back({0.0f + 0.3f * static_cast<float>(frame), 0, {frame, frame, 9}});
    rows.push_back({1.0f + 0.3f * static_cast<float>(frame), 0, {frame, frame, 10}});
    rows.push_back({0.2f + 0.9f * static_cast<float>(frame), 0, {frame, frame, 3}});
  }
  CodeSet set = codes(rows);
  CHECK(identify_codes(set, set, euclidean).pairs.empty());  // of an animal that is not the cow
  for (std::size_t i = 0; i < rows.size(); ++i)
    if (rows[i].view.coat != 3) set.names[i] = rows[i].view.coat == 9 ? "09_grey" : "10_white";
  const IdentificationResult r = identify_codes(set, set, euclidean);
  REQUIRE(r.pairs.size() == 1);
  CHECK(r.pairs[0].a == 9);
  CHECK(r.pairs[0].figures.queries == 4);
  CHECK(r.pairs[0].figures.without_match == 0);
  CHECK(r.pairs[0].figures.rank1 == 1);
  CHECK(r.all.queries == 6);
  CHECK(r.all.rank1 < 1);
  CHECK(r.coats == std::vector<int>{3, 9, 10});
  int counted = 0;
  for (const auto& row : r.nearest)
    for (const int n : row) counted += n;
  CHECK(counted == 6);
}

TEST_CASE("chunks of queries and threads change nothing") {
  std::vector<Row> rows;
  for (int i = 0; i < 600; ++i)
    rows.push_back({std::sin(static_cast<float>(i * i)), std::cos(static_cast<float>(3 * i)), {i % 20, i % 7, i % 5}});
  const CodeSet all = codes(rows);
  const std::vector<QueryMatch> together = match_codes(all, all, euclidean, {});
  for (const std::size_t i : {0u, 255u, 256u, 599u}) {
    const std::vector<QueryMatch> alone = match_codes(codes({rows[i]}), all, euclidean, {});
    CHECK(alone[0].nearest == together[i].nearest);
    CHECK(alone[0].precision == doctest::Approx(together[i].precision));
  }
}

TEST_CASE("calibration makes what scatters within a coat count for less") {
  // Two coats 1 apart in y; within a coat x scatters by 100 and y by 0.1: plain distance goes by x, calibrated by y.
  std::vector<Row> rows;
  for (int i = 0; i < 40; ++i)
    for (const int coat : {0, 1}) {
      const float x = static_cast<float>(100 * std::sin(1.7 * (i + 7 * coat))), wobble = static_cast<float>(0.1 * std::cos(2.9 * i));
      rows.push_back({x, coat + wobble, {i, i % 5, coat}});
    }
  const CodeSet set = codes(rows);
  const Tensor map = scatter_normalisation(set);
  const CodeSet level = mapped(set, map);
  Tensor scatter = torch::zeros({2, 2}, torch::kDouble);
  for (const int coat : {0, 1}) {
    Tensor own = level.codes.slice(0, coat, 80, 2);
    own = own - own.mean(0, true);
    scatter += own.t().matmul(own) / 78;
  }
  // Not quite the identity: a thousandth of the mean variance (5000 / 2) was added, which is more than y's own.
  CHECK(scatter[0][0].item<double>() == doctest::Approx(1).epsilon(0.01));
  CHECK(scatter[1][1].item<double>() < 1);
  CHECK(std::abs(scatter[0][1].item<double>()) < 0.05);
  const double before = identify_codes(set, set, euclidean).all.rank1, after = identify_codes(level, level, euclidean).all.rank1;
  CHECK(before < 0.5);
  CHECK(after == 1);

  CHECK_THROWS_AS(scatter_normalisation(codes({{1, 2, {0, 0, 0}}, {3, 4, {0, 0, 1}}})), InputError);
  CHECK_THROWS_AS(scatter_normalisation(codes({{1, 2, {0, 0, 0}}, {1, 2, {1, 0, 0}}})), InputError);
  CHECK_THROWS_AS(scatter_normalisation(codes({{1, 2, {0, 0, 0}}, {NAN, 2, {1, 0, 0}}})), InputError);
  CHECK_THROWS_AS(mapped(set, torch::eye(3, torch::kDouble)), InputError);
}

TEST_CASE("codes of different models cannot be compared") {
  CodeSet other = codes({{0, 0, {1, 1, 0}}});
  other.codes = torch::zeros({1, 3});
  CHECK_THROWS_AS(match_codes(other, codes({{0, 0, {1, 1, 0}}}), euclidean, {}), InputError);
}

TEST_CASE("files of codes are read back as written, and broken ones refused") {
  const test::TemporaryFile scratch("empty", "");
  const fs::path folder = scratch.folder();
  const fs::path file = folder / "codes.npy";
  const CodeSet set = codes({{0.25f, -3e-8f, {1, 2, 3}}, {7, 8, {-1, -1, -1}}});
  write_codes(file, set);
  const CodeSet back = read_codes(file);
  CHECK(torch::equal(back.codes, set.codes));
  CHECK((back.views == set.views));
  CHECK(back.names == set.names);
  CHECK(back.cameras == "rings");
  CHECK(back.dataset == "by hand");
  const std::vector<std::uint8_t> bytes = read_file(file);
  CHECK((10 + bytes[8] + 256 * bytes[9]) % 64 == 0);  // as NumPy wants it
  CHECK_THROWS_AS(write_codes(folder / "codes.bin", set), InputError);

  std::vector<std::uint8_t> cut(bytes.begin(), bytes.end() - 4);
  write_file_atomically(file, cut.data(), cut.size());
  CHECK_THROWS_WITH_AS(read_codes(file), doctest::Contains("as many numbers"), InputError);
  write_file_atomically(file, "not numpy at all");
  CHECK_THROWS_WITH_AS(read_codes(file), doctest::Contains("no NumPy file"), InputError);
  write_file_atomically(file, bytes.data(), bytes.size());
  write_file_atomically(folder / "codes.jsonl", "{\"format\": \"something else\"}\n");
  CHECK_THROWS_AS(read_codes(file), InputError);
  CodeSet longer = set;
  longer.codes = torch::cat({set.codes, set.codes});
  longer.views.insert(longer.views.end(), set.views.begin(), set.views.end());
  longer.names.insert(longer.names.end(), set.names.begin(), set.names.end());
  write_codes(folder / "longer.npy", longer);
  fs::copy_file(folder / "longer.jsonl", folder / "codes.jsonl", fs::copy_options::overwrite_existing);
  CHECK_THROWS_WITH_AS(read_codes(file), doctest::Contains("names 4 views"), InputError);
  fs::remove(folder / "codes.jsonl");
  CHECK_THROWS_AS(read_codes(file), InputError);
  CodeSet broken = set;
  broken.codes = torch::full({2, 2}, NAN);
  write_codes(file, broken);
  CHECK_THROWS_WITH_AS(read_codes(file), doctest::Contains("not a finite number"), InputError);
}

TEST_CASE("identify names every query, and says how often that is right where it is known") {
  const test::TemporaryFile scratch("empty", "");
  const fs::path folder = scratch.folder();
  write_codes(folder / "gallery.npy", codes({{1, 0, {1, 1, 4}}, {0, 1, {1, 1, 5}}}));
  write_codes(folder / "photos.npy", codes({{0.9f, 0.1f, {-1, -1, -1}}}, "photo"));
  IdentifyCommand command;
  command.queries = folder / "photos.npy";
  command.gallery = folder / "gallery.npy";
  command.out = folder / "out";
  std::string printed;
  CommandTools tools;
  tools.print = [&](const std::string& text) { printed += text; };
  CHECK(run_identify(command, tools) == 0);
  CHECK(printed.find("query 0: coat4") != std::string::npos);
  CHECK(fs::exists(folder / "out/names.jsonl"));
  CHECK_FALSE(fs::exists(folder / "out/summary.json"));

  write_codes(folder / "known.npy", codes({{0.9f, 0.1f, {2, 2, 4}}, {0.8f, 0.1f, {2, 2, 5}}}));
  command.queries = folder / "known.npy";
  printed.clear();
  CHECK(run_identify(command, tools) == 0);
  CHECK(printed.find("| all | 50.00 |") != std::string::npos);
  CHECK(fs::exists(folder / "out/summary.json"));
  command.enforce = true;
  CHECK(run_identify(command, tools) == 1);
  command.distance = "hamming";
  CHECK_THROWS_AS(run_identify(command, tools), InputError);
}
