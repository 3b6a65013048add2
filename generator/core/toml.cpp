#define TOML_IMPLEMENTATION
#include "generator/core/toml.h"

#include <cerrno>
#include <cstring>
#include <fstream>
#include <sstream>

namespace moomill {
namespace {

std::string join(const std::vector<std::string>& words) {
  std::string out;
  for (const std::string& w : words) out += (out.empty() ? "" : ", ") + w;
  return out;
}

std::string range_text(double lowest, double highest) {
  const bool below = std::isfinite(lowest), above = std::isfinite(highest) && highest < 1e300;
  if (below && above) return fmt::format(" from {} to {}", lowest, highest);
  if (below) return fmt::format(" of at least {}", lowest);
  if (above) return fmt::format(" of at most {}", highest);
  return "";
}

}  // namespace

std::string describe_node(const toml::node& node) {
  if (const auto* s = node.as_string()) return fmt::format("the text \"{}\"", s->get());
  if (const auto* i = node.as_integer()) return fmt::format("{}", i->get());
  if (const auto* f = node.as_floating_point()) return fmt::format("{}", f->get());
  if (const auto* b = node.as_boolean()) return b->get() ? "true" : "false";
  if (node.is_table()) return "a table";
  if (const auto* a = node.as_array()) return fmt::format("a list of {}", a->size());
  return "a date or time";
}

toml::table TomlReader::parse(const std::filesystem::path& file) {
  std::error_code ignored;
  if (std::filesystem::is_directory(file, ignored))
    input_error("{} is a folder; name the .toml file in it", file.string());
  std::ifstream in(file, std::ios::binary);
  if (!in) input_error("{} cannot be read: {}; check the path", file.string(), std::strerror(errno));
  std::stringstream text;
  text << in.rdbuf();
  try {
    return toml::parse(text.str(), file.string());
  } catch (const toml::parse_error& e) {
    std::string what(e.description());
    std::replace(what.begin(), what.end(), '\n', ' ');
    input_error("{}:{}:{}: not valid TOML: {}", file.string(), e.source().begin.line, e.source().begin.column, what);
  }
}

TomlReader::TomlReader(const toml::table& table, std::string file, std::string where)
    : table_(&table), file_(std::move(file)), where_(std::move(where)) {}

int TomlReader::line(const std::string& key) const {
  for (const auto& [k, v] : *table_)
    if (k.str() == key) return static_cast<int>(k.source().begin.line);
  return static_cast<int>(table_->source().begin.line);
}

std::string TomlReader::place(const std::string& key) const {
  const int number = line(key);
  return number > 0 ? fmt::format("{}:{}", file_, number) : file_;
}

void TomlReader::fail(const std::string& key, const std::string& what) const {
  const std::string in = where_.empty() ? "" : fmt::format(" in [{}]", where_);
  throw InputError(fmt::format("{}: '{}'{} {}", place(key), key, in, what));
}

void TomlReader::refuse(const std::string& key, const std::string& sentence) const {
  throw InputError(fmt::format("{}: {}", place(key), sentence));
}

void TomlReader::missing(const std::string& key, const std::string& example) const {
  fail(key, fmt::format("is missing; add e.g. {}", example));
}

bool TomlReader::has(const std::string& key) {
  return node(key) != nullptr;
}

const toml::node* TomlReader::node(const std::string& key) {
  known_.insert(key);
  return table_->get(key);
}

std::vector<std::string> TomlReader::keys() const {
  std::vector<std::string> out;
  for (const auto& [k, v] : *table_) out.emplace_back(k.str());
  return out;
}

double TomlReader::checked_number(const std::string& key, const toml::node& value, double lowest,
                                  double highest) const {
  const std::string wanted = "must be a number" + range_text(lowest, highest);
  double v = 0;
  if (const auto* i = value.as_integer())
    v = static_cast<double>(i->get());
  else if (const auto* f = value.as_floating_point())
    v = f->get();
  else
    fail(key, fmt::format("{}, not {}", wanted, describe_node(value)));
  if (!std::isfinite(v)) fail(key, fmt::format("{} and finite, not {}", wanted, v));
  if (v < lowest || v > highest) fail(key, fmt::format("{}, not {}", wanted, v));
  return v;
}

double TomlReader::number(const std::string& key, double fallback, double lowest, double highest) {
  const toml::node* n = node(key);
  return n ? checked_number(key, *n, lowest, highest) : fallback;
}

double TomlReader::number(const std::string& key, double lowest, double highest) {
  const toml::node* n = node(key);
  if (!n) fail(key, fmt::format("is missing; add a number{}", range_text(lowest, highest)));
  return checked_number(key, *n, lowest, highest);
}

std::int64_t TomlReader::integer(const std::string& key, std::int64_t fallback, std::int64_t lowest,
                                 std::int64_t highest) {
  const toml::node* n = node(key);
  if (!n) return fallback;
  const bool open = highest == std::numeric_limits<std::int64_t>::max();
  const std::string wanted = open ? fmt::format("must be a whole number of at least {}", lowest)
                                  : fmt::format("must be a whole number from {} to {}", lowest, highest);
  const auto* i = n->as_integer();
  if (!i || i->get() < lowest || i->get() > highest) fail(key, fmt::format("{}, not {}", wanted, describe_node(*n)));
  return i->get();
}

bool TomlReader::boolean(const std::string& key, bool fallback) {
  const toml::node* n = node(key);
  if (!n) return fallback;
  if (!n->is_boolean()) fail(key, fmt::format("must be true or false, not {}", describe_node(*n)));
  return n->as_boolean()->get();
}

std::string TomlReader::text(const std::string& key) {
  const toml::node* n = node(key);
  if (!n) fail(key, "is missing; add a text in quotes");
  if (!n->is_string()) fail(key, fmt::format("must be a text in quotes, not {}", describe_node(*n)));
  if (n->as_string()->get().empty()) fail(key, "must not be empty");
  return n->as_string()->get();
}

std::string TomlReader::text(const std::string& key, const std::string& fallback) {
  return has(key) ? text(key) : fallback;
}

std::string TomlReader::word(const std::string& key, const std::string& fallback,
                             const std::vector<std::string>& allowed) {
  if (!has(key)) return fallback;
  const std::string w = text(key);
  if (std::find(allowed.begin(), allowed.end(), w) == allowed.end()) {
    const std::string near = nearest_word(w, allowed);
    const std::string hint = near.empty() ? "" : fmt::format("; did you mean '{}'?", near);
    fail(key, fmt::format("must be one of {}, not '{}'{}", join(allowed), w, hint));
  }
  return w;
}

const toml::array& TomlReader::numbers_array(const std::string& key) {
  const toml::node* n = node(key);
  if (!n) fail(key, "is missing; add a list of numbers");
  if (!n->is_array()) fail(key, fmt::format("must be a list of numbers, not {}", describe_node(*n)));
  return *n->as_array();
}

std::vector<double> TomlReader::numbers(const std::string& key) {
  constexpr double huge = std::numeric_limits<double>::max();
  std::vector<double> out;
  for (const toml::node& e : numbers_array(key)) out.push_back(checked_number(key, e, -huge, huge));
  return out;
}

dvec3 TomlReader::vector3(const std::string& key) {
  if (!has(key)) fail(key, "is missing; add a list of three numbers");
  const std::vector<double> v = numbers(key);
  if (v.size() != 3) fail(key, fmt::format("must be a list of three numbers, not of {}", v.size()));
  return {v[0], v[1], v[2]};
}

dvec3 TomlReader::vector3(const std::string& key, const dvec3& fallback) {
  return has(key) ? vector3(key) : fallback;
}

std::vector<std::string> TomlReader::texts(const std::string& key) {
  const toml::node* n = node(key);
  if (!n) fail(key, "is missing; add a list of texts");
  if (!n->is_array()) fail(key, fmt::format("must be a list of texts, not {}", describe_node(*n)));
  std::vector<std::string> out;
  for (const toml::node& e : *n->as_array()) {
    if (!e.is_string()) fail(key, fmt::format("must be a list of texts, not hold {}", describe_node(e)));
    if (e.as_string()->get().empty()) fail(key, "must not hold an empty text");
    out.push_back(e.as_string()->get());
  }
  return out;
}

std::optional<TomlReader> TomlReader::table(const std::string& key) {
  const toml::node* n = node(key);
  if (!n) return std::nullopt;
  if (!n->is_table()) fail(key, fmt::format("must be a table, [{}], not {}", path_of(key), describe_node(*n)));
  return TomlReader(*n->as_table(), file_, path_of(key));
}

std::vector<TomlReader> TomlReader::tables(const std::string& key) {
  std::vector<TomlReader> out;
  const toml::node* n = node(key);
  if (!n) return out;
  const toml::array* list = n->as_array();
  if (!list) fail(key, fmt::format("must be a list of tables, [[{}]], not {}", path_of(key), describe_node(*n)));
  for (std::size_t i = 0; i < list->size(); ++i) {
    const toml::table* t = (*list)[i].as_table();
    if (!t) fail(key, fmt::format("must hold tables, [[{}]], not {}", path_of(key), describe_node((*list)[i])));
    out.emplace_back(*t, file_, fmt::format("{}[{}]", path_of(key), i));
  }
  return out;
}

void TomlReader::finish() {
  const std::vector<std::string> known(known_.begin(), known_.end());
  // The first unknown key in the order of the file, not of the alphabet.
  const toml::key* first = nullptr;
  for (const auto& [k, v] : *table_)
    if (!known_.count(std::string(k.str())))
      if (!first || k.source().begin.line < first->source().begin.line) first = &k;
  if (!first) return;
  const std::string in = where_.empty() ? "" : fmt::format(" in [{}]", where_);
  throw InputError(fmt::format("{}: unknown key '{}'{}{}", place(std::string(first->str())), first->str(), in, suggestion(std::string(first->str()), known, "known are")));
}

}  // namespace moomill
