#include "scenes/read_distribution.h"

namespace moomill {
namespace {

using Values = std::vector<double>;

const char* wanted(Quantity::Kind kind) {
  switch (kind) {
    case Quantity::Kind::number:
      return "a number";
    case Quantity::Kind::vector:
      return "three numbers [x, y, z]";
    case Quantity::Kind::color:
      return "a colour [r, g, b] or one grey value";
    case Quantity::Kind::text:
      return "a text";
  }
  return "";
}

class Parser {
 public:
  Parser(TomlReader& reader, const std::string& key, const Quantity& quantity)
      : reader_(reader), key_(key), quantity_(quantity) {}

  Distribution parse(const toml::node& node) {
    Distribution d;
    d.key = reader_.path_of(key_);
    const toml::table* table = node.as_table();
    if (!table) {
      add_entry(d, node, true);
      return d;
    }
    TomlReader inner(*table, reader_.file(), d.key);
    int kinds = 0;
    auto found = [&](const char* name, Choice::Kind kind) {
      if (!inner.has(name)) return;
      d.kind = kind;
      ++kinds;
      fill(d, name, *inner.node(name));
    };
    found("uniform", Choice::Kind::uniform);
    found("normal", Choice::Kind::normal);
    found("log_uniform", Choice::Kind::log_uniform);
    found("choose", Choice::Kind::choose);
    const bool clamped = inner.has("clamp");
    d.per_view = inner.word("per", "frame", {"frame", "view"}) == "view";
    if (d.per_view && !quantity_.may_vary_per_view)
      reader_.fail(key_, "must be the same for all cameras of a frame; leave out per = \"view\"");
    inner.finish();
    if (kinds != 1)
      reader_.fail(key_, "must have exactly one of uniform, normal, log_uniform and choose, e.g. {uniform = [a, b]}");
    if (clamped && d.kind != Choice::Kind::normal) reader_.fail(key_, "may have 'clamp' only beside 'normal'");
    if (d.kind == Choice::Kind::normal) finish_normal(d, clamped ? inner.node("clamp") : nullptr);
    return d;
  }

 private:
  [[noreturn]] void fail(const std::string& what) { reader_.fail(key_, what); }
  bool is_text() const { return quantity_.kind == Quantity::Kind::text; }

  double scalar(const toml::node& node, bool in_range) {
    double v = 0;
    if (const auto* i = node.as_integer())
      v = static_cast<double>(i->get());
    else if (const auto* f = node.as_floating_point())
      v = f->get();
    else
      fail(fmt::format("must be {} or a distribution such as {{uniform = [a, b]}}, not {}", wanted(quantity_.kind),
                       describe_node(node)));
    if (!std::isfinite(v)) fail(fmt::format("must be finite, not {}", v));
    if (in_range && (v < quantity_.lowest || v > quantity_.highest))
      fail(fmt::format("must lie from {} to {}, not {}", quantity_.lowest, quantity_.highest, v));
    return v;
  }

  // One value: a number, or a list of three.
  Values entry(const toml::node& node, bool in_range) {
    const toml::array* list = node.as_array();
    if (!list) {
      if (quantity_.kind == Quantity::Kind::vector && (node.is_integer() || node.is_floating_point()))
        fail(fmt::format("must be {}, not {}", wanted(quantity_.kind), describe_node(node)));
      return {scalar(node, in_range)};  // a grey keeps one value, so that draws of it stay grey
    }
    if (quantity_.kind == Quantity::Kind::number)
      fail("must be a number, not a list; a range is written {uniform = [a, b]}");
    if (list->size() != 3) fail(fmt::format("must be {}, not a list of {}", wanted(quantity_.kind), list->size()));
    Values out;
    for (const toml::node& e : *list) out.push_back(scalar(e, in_range));
    return out;
  }

  void add_entry(Distribution& d, const toml::node& node, bool in_range) {
    if (!is_text()) {
      d.values.push_back(entry(node, in_range));
      return;
    }
    if (!node.is_string() || node.as_string()->get().empty())
      fail(fmt::format("must be a text or {{choose = [\"a\", \"b\"]}}, not {}", describe_node(node)));
    d.words.push_back(node.as_string()->get());
  }

  const toml::array& list_of(const char* name, const toml::node& node, std::size_t size) {
    const toml::array* list = node.as_array();
    if (!list) fail(fmt::format("must give {} as a list, not {}", name, describe_node(node)));
    if (size && list->size() != size)
      fail(fmt::format("must give {} as a list of {} values, not of {}", name, size, list->size()));
    if (list->empty()) fail(fmt::format("must not give {} an empty list", name));
    return *list;
  }

  void check_order(const Values& lower, const Values& upper, const char* name) {
    for (std::size_t c = 0; c < std::max(lower.size(), upper.size()); ++c) {
      const double a = lower.size() == 1 ? lower[0] : lower[c], b = upper.size() == 1 ? upper[0] : upper[c];
      if (a > b) fail(fmt::format("must give {} as [lower, upper], not [{}, {}]", name, a, b));
    }
  }

  void fill(Distribution& d, const char* name, const toml::node& node) {
    d.values.clear();
    d.words.clear();
    if (is_text() && d.kind != Choice::Kind::choose) fail(fmt::format("is a text and cannot be drawn by '{}'", name));
    if (d.kind == Choice::Kind::choose) {
      for (const toml::node& e : list_of(name, node, 0)) add_entry(d, e, true);
      return;
    }
    const toml::array& list = list_of(name, node, 2);
    const bool normal = d.kind == Choice::Kind::normal;
    d.values.push_back(entry(list[0], true));
    // A sigma has its own range, and one number serves all components.
    d.values.push_back(normal && !list[1].is_array() ? Values(d.values[0].size(), scalar(list[1], false))
                                                     : entry(list[1], !normal));
    if (normal) {
      for (const double sigma : d.values[1])
        if (sigma < 0) fail(fmt::format("must have a sigma of at least 0, not {}", sigma));
    } else {
      check_order(d.values[0], d.values[1], name);
    }
    if (d.kind == Choice::Kind::log_uniform)
      for (const double v : d.values[0])
        if (v < 1e-300) fail(fmt::format("must have positive bounds for log_uniform, not {}", v));
  }

  void finish_normal(Distribution& d, const toml::node* clamp) {
    const std::size_t n = d.values[0].size();
    if (clamp) {
      const toml::array& list = list_of("clamp", *clamp, 2);
      for (int i = 0; i < 2; ++i)
        d.values.push_back(list[i].is_array() ? entry(list[i], true) : Values(n, scalar(list[i], true)));
      check_order(d.values[2], d.values[3], "clamp");
    } else {
      d.values.push_back(Values(n, quantity_.lowest));
      d.values.push_back(Values(n, quantity_.highest));
    }
  }

  TomlReader& reader_;
  const std::string& key_;
  const Quantity& quantity_;
};

}  // namespace

std::optional<Distribution> read_optional_distribution(TomlReader& reader, const std::string& key,
                                                       const Quantity& quantity) {
  const toml::node* node = reader.node(key);
  if (!node) return std::nullopt;
  return Parser(reader, key, quantity).parse(*node);
}

Distribution read_distribution(TomlReader& reader, const std::string& key, const Quantity& quantity,
                               const Distribution& fallback) {
  return read_optional_distribution(reader, key, quantity).value_or(fallback);
}

}  // namespace moomill
