#pragma once
// Suggestions for misspelt words, apart from toml.h so that few files see toml++.
#include <string>
#include <vector>

namespace moomill {

// The nearest of `candidates` within a third of the word's length in edits (insert, delete, replace, swap), whatever
// the case; empty when none is near.
std::string nearest_word(const std::string& word, const std::vector<std::string>& candidates);

// "; did you mean 'x'?" when a candidate is near, else "; LEAD a, b, c" ("; there are a, b, c").
std::string suggestion(const std::string& word, const std::vector<std::string>& candidates,
                       const std::string& lead = "there are");

}  // namespace moomill
