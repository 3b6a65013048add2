#include "validate/studies/stress.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <ctime>
#include <limits>

#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "generator/dataset/codecs.h"

namespace moomill {
namespace {

struct Group {
  const char* name;
  std::vector<std::vector<StressCase> (*)()> parts;
};
const std::vector<Group>& groups() {
  static const std::vector<Group> table = {
      {"geometry", {geometry_stress, edge_stress}},
      {"skinning", {skinning_stress}},
      {"light", {light_stress, surface_light_stress}},
      {"sampling", {sampling_stress}},
      {"keypoints", {keypoint_stress}},
      {"statistics", {statistics_stress}},
  };
  return table;
}

StressOutcome run_case(const std::string& group, StressCase what, const StressOptions& options) {
  StressOutcome outcome;
  outcome.group = group;
  const std::clock_t start = std::clock();
  try {
    outcome.error = what.measure(options);
    if (std::isnan(outcome.error)) outcome.failure = "the error is not a number";
  } catch (const std::exception& e) {
    outcome.error = std::numeric_limits<double>::infinity();
    outcome.failure = e.what();
  }
  outcome.seconds = static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC;
  outcome.what = std::move(what);
  return outcome;
}

// A cell of a comma-separated table, as RFC 4180 wants it.
std::string csv_cell(const std::string& text) {
  if (text.find_first_of(",\"\n") == std::string::npos) return text;
  std::string quoted = "\"";
  for (const char c : text) quoted += c == '"' ? std::string("\"\"") : std::string(1, c);
  return quoted + "\"";
}

std::string markdown_cell(std::string text) {
  for (std::size_t i = 0; (i = text.find('|', i)) != std::string::npos; i += 2) text.replace(i, 1, "\\|");
  return text;
}

std::string with_unit(double value, const std::string& unit) {
  return fmt::format("{:.3g}{}{}", value, unit.empty() ? "" : " ", unit);
}

}  // namespace

const char* name(Oracle oracle) {
  switch (oracle) {
    case Oracle::analytic:
      return "analytic";
    case Oracle::high_precision:
      return "high precision";
    case Oracle::exact_predicate:
      break;
  }
  return "exact predicate";
}

const std::vector<std::string>& stress_groups() {
  static const std::vector<std::string> names = [] {
    std::vector<std::string> n;
    for (const Group& g : groups()) n.push_back(g.name);
    return n;
  }();
  return names;
}

std::vector<StressCase> stress_cases(const std::string& group) {
  for (const Group& g : groups()) {
    if (g.name != group) continue;
    std::vector<StressCase> all;
    for (const auto part : g.parts)
      for (StressCase& c : part()) all.push_back(std::move(c));
    return all;
  }
  input_error("there is no group '{}' of stress cases; there are {}", group, fmt::join(stress_groups(), ", "));
}

std::vector<StressOutcome> run_stress(const StressOptions& options) {
  set_float_state();  // as on every thread that renders
  std::vector<StressOutcome> outcomes;
  for (const std::string& group : options.group.empty() ? stress_groups() : std::vector<std::string>{options.group})
    for (StressCase& c : stress_cases(group)) {
      if (options.stop && options.stop->load()) run_error("stopped after {} cases, nothing was written; run the same command again, it starts anew", outcomes.size());
      outcomes.push_back(run_case(group, std::move(c), options));
    }
  return outcomes;
}

StudyResult stress_study(const std::vector<StressOutcome>& outcomes) {
  StudyResult result;
  result.title = "Numerical stability on extreme cases";
  result.table =
      "| group | cases | within bounds | nearest to its bound | error / allowed | CPU s |\n|---|--:|--:|---|--:|--:|\n";
  double out_of_bounds = 0;
  for (const std::string& group : stress_groups()) {
    int cases = 0, within = 0;
    double seconds = 0, nearest = -1;
    std::string nearest_name = "none: every bound is 0";
    for (const StressOutcome& o : outcomes) {
      if (o.group != group) continue;
      ++cases;
      within += o.holds();
      seconds += o.seconds;
      if (o.what.allowed > 0 && o.error / o.what.allowed > nearest) {
        nearest = o.error / o.what.allowed;
        nearest_name = o.what.name;
      }
      const double error = o.failure.empty() ? o.error : std::numeric_limits<double>::quiet_NaN();
      result.figures.push_back({group + ": " + o.what.name, error, o.what.unit, o.what.allowed, {}});
    }
    if (cases == 0) continue;
    out_of_bounds += cases - within;
    result.table += fmt::format("| {} | {} | {} | {} | {} | {:.1f} |\n", group, cases, within, nearest_name,
                                nearest < 0 ? "" : fmt::format("{:.2g}", nearest), seconds);
  }
  result.figures.push_back({"cases", static_cast<double>(outcomes.size()), "cases", {}, {}});
  result.figures.push_back({"cases out of bounds", out_of_bounds, "cases", 0.0, {}});
  return result;
}

void write_stress(const std::vector<StressOutcome>& outcomes, const std::filesystem::path& folder) {
  std::string csv = "group,case,what,oracle,error,allowed,unit,holds,why,cpu_seconds,failure\n";
  std::string md =
      "# Numerical stability on extreme cases\n\nWritten by `moomill stress`. An error without a unit is relative.\n";
  std::string group;
  for (const StressOutcome& o : outcomes) {
    const StressCase& c = o.what;
    csv += fmt::format("{},{},{},{},{:.6g},{:.6g},{},{},{},{:.3f},{}\n", o.group, csv_cell(c.name), csv_cell(c.what),
                       name(c.oracle), o.error, c.allowed, c.unit, o.holds() ? "yes" : "no", csv_cell(c.why), o.seconds,
                       csv_cell(o.failure));
    if (group != o.group) {
      group = o.group;
      md += fmt::format(
          "\n## {}\n\n| case | what is done | oracle | error | allowed | | why this bound | CPU s "
          "|\n|---|---|---|--:|--:|---|---|--:|\n",
          group);
    }
    md += fmt::format("| {} | {} | {} | {} | {} | {} | {} | {:.2f} |\n", markdown_cell(c.name), markdown_cell(c.what),
                      name(c.oracle),
                      o.failure.empty() ? with_unit(o.error, c.unit) : markdown_cell("failed: " + o.failure),
                      with_unit(c.allowed, c.unit), o.holds() ? "ok" : "**OUT**", markdown_cell(c.why), o.seconds);
  }
  write_file_atomically(folder / "stress.csv", csv);
  write_file_atomically(folder / "stress.md", md);
}

}  // namespace moomill
