#include "validate/studies/study.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "generator/dataset/codecs.h"

namespace moomill {

bool StudyResult::holds() const {
  return std::all_of(figures.begin(), figures.end(), [](const Figure& f) { return f.holds(); });
}

void require_study_folder(const std::filesystem::path& folder) {
  const std::filesystem::path probe = folder / ".moomill_study";
  write_file_atomically(probe, "");
  std::error_code ignored;
  std::filesystem::remove(probe, ignored);
}

void write_study(const StudyResult& result, const std::filesystem::path& folder) {
  nlohmann::json figures = nlohmann::json::array();
  for (const Figure& f : result.figures) {
    nlohmann::json j{{"name", f.name}, {"unit", f.unit}, {"holds", f.holds()}};
    j["value"] = std::isfinite(f.value) ? nlohmann::json(f.value) : nlohmann::json();
    if (f.at_most) j["at_most"] = *f.at_most;
    if (f.at_least) j["at_least"] = *f.at_least;
    figures.push_back(std::move(j));
  }
  write_file_atomically(folder / "summary.json", nlohmann::json{{"title", result.title}, {"figures", figures}}.dump(2) + "\n");
  write_file_atomically(folder / "table.md", result.table);
}

}  // namespace moomill
