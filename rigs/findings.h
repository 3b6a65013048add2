#pragma once
// How the linter's two halves (check.cpp: rigs, check_species.cpp: species) say what they find. Not for others.
#include <fmt/format.h>

#include "rigs/check.h"

namespace moomill {

using Findings = std::vector<Finding>;

template <class... Args>
void wrong(Findings& findings, fmt::format_string<Args...> format, Args&&... args) {
  findings.push_back({Finding::Level::wrong, fmt::format(format, std::forward<Args>(args)...)});
}
template <class... Args>
void suspicious(Findings& findings, fmt::format_string<Args...> format, Args&&... args) {
  findings.push_back({Finding::Level::suspicious, fmt::format(format, std::forward<Args>(args)...)});
}

// "beak, comb and 3 more"
std::string list_names(const std::vector<std::string>& names);

// "at (0.12, -0.30, 1.05) m, part 'torso'": the centroid of a triangle.
std::string triangle_place(const Rig& rig, std::size_t triangle);

}  // namespace moomill
