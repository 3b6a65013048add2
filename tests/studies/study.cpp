#include "validate/studies/study.h"

#include <doctest/doctest.h>

#include <filesystem>
#include <fstream>
#include <limits>
#include <nlohmann/json.hpp>

using namespace moomill;

TEST_CASE("a study writes its figures and says which hold") {
  const auto folder = std::filesystem::temp_directory_path() / "moomill_study_test";
  std::filesystem::remove_all(folder);
  StudyResult r{"slip", {{"walk", 0.01, "m", 0.02, {}}, {"trot", 0.03, "m", 0.02, {}}, {"free", 3, "", {}, {}},
                         {"broken", std::numeric_limits<double>::quiet_NaN(), "", 1.0, {}}}, "| a |\n"};
  CHECK_FALSE(r.holds());
  write_study(r, folder);
  std::ifstream in(folder / "summary.json");
  const auto j = nlohmann::json::parse(in);
  CHECK(j["figures"][0]["holds"] == true);
  CHECK(j["figures"][1]["holds"] == false);
  CHECK(j["figures"][2]["holds"] == true);
  CHECK(j["figures"][3]["holds"] == false);
  CHECK(j["figures"][3]["value"].is_null());
  CHECK(std::filesystem::file_size(folder / "table.md") == 6);
  std::filesystem::remove_all(folder);
}
