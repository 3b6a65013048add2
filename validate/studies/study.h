#pragma once
// What every study leaves behind: named figures with units in summary.json, and a table that people read.
//
// A study is a command that measures something the project claims (motion, deformation, coats, silhouettes, ...). To add
// one: a file here with a function that returns its StudyResult, and a command in generator/study_commands.cpp.
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace moomill {

// One measured number, and the bound it is held against, where there is one.
struct Figure {
  std::string name;  // "walk: worst slip of a bearing foot"
  double value = 0;
  std::string unit;  // "m"; empty for a ratio
  std::optional<double> at_most, at_least;
  bool holds() const { return (!at_most || value <= *at_most) && (!at_least || value >= *at_least); }
};

struct StudyResult {
  std::string title;
  std::vector<Figure> figures;
  std::string table;  // Markdown, for people
  bool holds() const;
};

// RunError where nothing can be written into the folder, which is made: asked before hours are spent.
void require_study_folder(const std::filesystem::path& folder);

// Writes summary.json ({"title", "figures": [{name, value, unit, at_most?, at_least?, holds}]}) and table.md into the
// folder, which is made. Not-a-number becomes null and never holds. Throws RunError when it cannot be written.
void write_study(const StudyResult& result, const std::filesystem::path& folder);

}  // namespace moomill
