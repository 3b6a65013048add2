#include "tests/validate/synthetic.h"

using namespace moomill;
using namespace moomill::test;

namespace {

void all_pass(const std::vector<CheckResult>& results) {
  for (const CheckResult& r : results) {
    CHECK_MESSAGE(r.passed(), r.name << ": " << (r.failures.empty() ? "" : r.failures.front()));
    CHECK(r.failures.size() == r.failure_count);
  }
}

}  // namespace

TEST_CASE("a right dataset passes every check, and every check compares something") {
  TemporaryFolder folder;
  write_synthetic(folder / "data");
  std::size_t last = 0;
  const std::vector<CheckResult> results = validate_dataset(folder / "data", [&](std::size_t done, std::size_t total) {
    CHECK(done <= total);
    last = done;
  });
  CHECK(last == 2);
  all_pass(results);
  for (const CheckResult& r : results) CHECK_MESSAGE(r.tested > 0, r.name << ": " << r.note);
  MESSAGE("worst reprojection: " << result_of(results, "reprojects").worst
                                 << " px, depth: " << result_of(results, "pixel's depth").worst
                                 << " m, two views: " << result_of(results, "two views").worst << " m");
  CHECK(result_of(results, "reprojects").worst < 1e-3);
}

TEST_CASE("without triangle maps the surface point is found by its NNOPCS") {
  TemporaryFolder folder;
  write_synthetic(folder / "data", {.triangles = false});
  const std::vector<CheckResult> results = validate_dataset(folder / "data");
  all_pass(results);
  CHECK(result_of(results, "its triangle and barycentrics").tested == 0);
  CHECK(result_of(results, "reprojects").tested > 1000);
  CHECK(result_of(results, "pixel's depth").tested > 1000);
}

TEST_CASE("dual quaternion skinning") {
  TemporaryFolder folder;
  write_synthetic(folder / "data", {.dual_quaternion = true});
  const std::vector<CheckResult> results = validate_dataset(folder / "data");
  all_pass(results);
  CHECK(result_of(results, "reprojects").tested > 1000);
}

TEST_CASE("a renderer that slips by half a pixel is caught") {
  TemporaryFolder folder;
  write_synthetic(folder / "data", {.frames = 1, .half_pixel_slip = true});
  const std::vector<CheckResult> results = validate_dataset(folder / "data");
  CHECK(result_of(results, "reprojects").failure_count > 100);
  CHECK(result_of(results, "reprojects").worst == doctest::Approx(std::sqrt(0.5)).epsilon(0.01));
}

TEST_CASE("checks that compare nothing say so") {
  TemporaryFolder folder;
  Manifest m = small_manifest(1);
  m.modalities = {};
  m.modalities.add(Modality::silhouette);
  {
    DatasetWriter writer(folder / "data", m, 1);
    write_frame(writer, m, 1);
    writer.finish();
  }
  const std::vector<CheckResult> results = validate_dataset(folder / "data");
  const CheckResult& surface = result_of(results, "reprojects");
  CHECK(surface.tested == 0);
  CHECK_FALSE(surface.note.empty());
  CHECK_THROWS_AS(validate_dataset(folder / "nowhere"), InputError);
}
