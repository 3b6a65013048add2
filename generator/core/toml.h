#pragma once
// Strict reading of TOML: every key must be known, every value of the right type and range; a mistake is one sentence
// with file, line and mend ("scenes/a.toml:12: unknown key 'camreas' in [render]; did you mean 'cameras'?").
// The only header that shows toml++.
#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "generator/core/error.h"
#include "generator/core/math.h"
#include "generator/core/words.h"

// The parser is compiled once, in toml.cpp.
#define TOML_HEADER_ONLY 0
#define TOML_ENABLE_FORMATTERS 0
#include <toml++/toml.h>

namespace moomill {

// A table being read. Reading a key marks it as known; finish() refuses keys nobody asked for, suggesting the nearest
// of those that were.
class TomlReader {
 public:
  static toml::table parse(const std::filesystem::path& file);  // InputError with line and column
  TomlReader(const toml::table& table, std::string file, std::string where = "");

  bool has(const std::string& key);
  double number(const std::string& key, double fallback, double lowest, double highest);
  double number(const std::string& key, double lowest, double highest);  // required
  std::int64_t integer(const std::string& key, std::int64_t fallback, std::int64_t lowest, std::int64_t highest);
  bool boolean(const std::string& key, bool fallback);
  std::string text(const std::string& key);
  std::string text(const std::string& key, const std::string& fallback);
  // One of the allowed words; the message lists them.
  std::string word(const std::string& key, const std::string& fallback, const std::vector<std::string>& allowed);
  dvec3 vector3(const std::string& key);
  dvec3 vector3(const std::string& key, const dvec3& fallback);
  std::vector<double> numbers(const std::string& key);
  std::vector<std::string> texts(const std::string& key);
  std::optional<TomlReader> table(const std::string& key);
  std::vector<TomlReader> tables(const std::string& key);  // array of tables; empty when absent
  const toml::node* node(const std::string& key);          // anything; nullptr when absent
  std::vector<std::string> keys() const;                   // all keys present (for free-form tables)
  void finish();

  // "file:line: 'key' in [where] WHAT"; the line is the key's, or the table's when the key is absent.
  [[noreturn]] void fail(const std::string& key, const std::string& what) const;
  [[noreturn]] void refuse(const std::string& key, const std::string& sentence) const;  // "file:line: SENTENCE"
  // Runs `look_up`; what it refuses is told with the place of the key.
  template <class LookUp>
  auto at_key(const std::string& key, const LookUp& look_up) const {
    try {
      return look_up();
    } catch (const InputError& e) {
      refuse(key, e.what());
    }
  }
  [[noreturn]] void missing(const std::string& key, const std::string& example) const;  // example: "file = \"cow.glb\""
  const std::string& file() const { return file_; }
  const std::string& where() const { return where_; }  // dotted path of the table; empty for the file itself
  std::string path_of(const std::string& key) const { return where_.empty() ? key : where_ + "." + key; }
  int line(const std::string& key) const;           // 0 for a table made while running, not read from a file
  std::string place(const std::string& key) const;  // "file:line", or "file" where there is no line

 private:
  double checked_number(const std::string& key, const toml::node& value, double lowest, double highest) const;
  const toml::array& numbers_array(const std::string& key);
  const toml::table* table_;
  std::string file_, where_;
  std::set<std::string> known_;
};

// What a TOML value is, for messages: "the text \"a\"", "0.5", "a table", ...
std::string describe_node(const toml::node& node);

}  // namespace moomill
