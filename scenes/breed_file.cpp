// Breed files: a tree of TOML values in which some are draws. It is read once; every individual is that tree with the
// draws made, read by the reader of coat files.
#include "scenes/breed_file.h"

#include <array>
#include <set>

#include "generator/core/random.h"
#include "scenes/coat_file.h"
#include "generator/core/toml.h"

namespace moomill {
namespace {

struct Draw;

// One value of the coat: a plain one, a table, a list, or a draw.
struct Value {
  const toml::node* plain = nullptr;                 // in the parsed file
  std::vector<std::pair<std::string, Value>> table;  // in the order of the file
  std::vector<Value> list;
  std::shared_ptr<const Draw> draw;
  enum class Kind { plain, table, list, draw } kind = Kind::plain;
  // A table may be there by chance, or only where a named draw came out as one of some words.
  double chance = 1;
  std::uint64_t chance_key = 0;
  std::vector<std::pair<std::string, std::vector<std::string>>> when;
};

struct Draw {
  enum class Kind { uniform, log_uniform, normal, choose } kind = Kind::uniform;
  std::vector<double> a, b;  // bounds, or mean and deviation; one number or one per component
  bool is_list = false;
  double lowest = -std::numeric_limits<double>::infinity(), highest = std::numeric_limits<double>::infinity();
  std::vector<Value> options;
  std::vector<double> until;  // of every option: cumulative weight, the last one 1
  std::uint64_t key = 0;
};

// How draws are made: by identity, or at their ends, to try a file.
struct Chooser {
  std::optional<std::pair<std::uint64_t, std::uint64_t>> identity;  // seed, index
  int extreme = 0;        // without identity: -1 lowest, 1 highest
  std::size_t option = 0;  // without identity: of every choice, modulo its number
  std::uint64_t bits(std::uint64_t key) const { return hash_identity({identity->first, identity->second, key}); }
};

bool is_draw(const toml::table& t) {
  return t.contains("uniform") || t.contains("log_uniform") || t.contains("normal") || t.contains("choose");
}

class Compiler {
 public:
  explicit Compiler(std::string file) : file_(std::move(file)) {}

  Value value(const toml::node& node, const std::string& path) {
    Value out;
    if (const toml::table* t = node.as_table()) {
      if (is_draw(*t)) {
        out.kind = Value::Kind::draw;
        out.draw = std::make_shared<Draw>(draw(*t, path));
        return out;
      }
      out.kind = Value::Kind::table;
      TomlReader r(*t, file_, path);
      if (r.has("chance")) {
        out.chance = r.number("chance", 0, 1);
        out.chance_key = hash_text(path + ".chance");
      }
      if (auto when = r.table("when"))
        for (const std::string& name : when->keys()) out.when.emplace_back(name, words(*when, name));
      for (const auto& [k, v] : *t) {
        const std::string key(k.str());
        if (key != "chance" && key != "when") out.table.emplace_back(key, value(v, path + "." + key));
      }
      return out;
    }
    if (const toml::array* list = node.as_array()) {
      out.kind = Value::Kind::list;
      for (std::size_t i = 0; i < list->size(); ++i)
        out.list.push_back(value((*list)[i], fmt::format("{}[{}]", path, i)));
      return out;
    }
    out.plain = &node;
    return out;
  }

  Draw draw(const toml::table& t, const std::string& path) {
    TomlReader r(t, file_, path);
    Draw d;
    d.key = hash_text(r.has("draw") ? "draw " + r.text("draw") : path);
    int kinds = 0;
    const auto found = [&](const char* name, Draw::Kind kind) {
      if (!r.has(name)) return;
      ++kinds;
      d.kind = kind;
      if (kind == Draw::Kind::choose)
        options(r, d, path);
      else
        bounds(r, name, d);
    };
    found("uniform", Draw::Kind::uniform);
    found("log_uniform", Draw::Kind::log_uniform);
    found("normal", Draw::Kind::normal);
    found("choose", Draw::Kind::choose);
    if (kinds != 1) r.refuse("", fmt::format("[{}] must have exactly one of uniform, log_uniform, normal and choose", path));
    if (d.kind == Draw::Kind::normal) {
      if (!r.has("clamp")) r.missing("clamp", "clamp = [0, 1]: the ends no draw may pass");
      const std::vector<double> ends = r.numbers("clamp");
      if (ends.size() != 2 || ends[0] > ends[1]) r.fail("clamp", "must be [lower, upper]");
      d.lowest = ends[0], d.highest = ends[1];
    }
    r.finish();
    return d;
  }

 private:
  static std::vector<std::string> words(TomlReader& r, const std::string& key) {
    const toml::node* n = r.node(key);
    return n && n->is_array() ? r.texts(key) : std::vector<std::string>{r.text(key)};
  }

  void bounds(TomlReader& r, const char* name, Draw& d) {
    const toml::node* n = r.node(name);
    const toml::array* ends = n->as_array();
    if (!ends || ends->size() != 2) r.fail(name, "must be a list of two, e.g. [0.2, 0.6]");
    const auto components = [&](const toml::node& node) {
      std::vector<double> out;
      const auto add = [&](const toml::node& e) {
        const std::optional<double> v = e.value<double>();
        if (!v || !std::isfinite(*v)) r.fail(name, fmt::format("must hold finite numbers, not {}", describe_node(e)));
        out.push_back(*v);
      };
      if (const toml::array* list = node.as_array()) {
        d.is_list = true;
        for (const toml::node& e : *list) add(e);
      } else {
        add(node);
      }
      return out;
    };
    d.a = components((*ends)[0]);
    d.b = components((*ends)[1]);
    if (d.a.size() != d.b.size()) r.fail(name, "must give both ends as many components");
    if (d.kind == Draw::Kind::normal && d.is_list) r.fail(name, "must be two numbers, [mean, deviation]");
    for (std::size_t i = 0; i < d.a.size(); ++i)
      if (d.kind == Draw::Kind::log_uniform && !(d.a[i] > 0 && d.b[i] > 0)) r.fail(name, "must have positive ends");
  }

  void options(TomlReader& r, Draw& d, const std::string& path) {
    const toml::array* list = r.node("choose")->as_array();
    if (!list || list->empty()) r.fail("choose", "must be a list of at least one");
    for (std::size_t i = 0; i < list->size(); ++i)
      d.options.push_back(value((*list)[i], fmt::format("{}.choose[{}]", path, i)));
    std::vector<double> weights(list->size(), 1);
    if (r.has("weights")) weights = r.numbers("weights");
    if (weights.size() != list->size()) r.fail("weights", fmt::format("must hold {} numbers, one per choice", list->size()));
    double sum = 0;
    for (const double w : weights) {
      if (w < 0) r.fail("weights", fmt::format("must hold numbers of at least 0, not {}", w));
      sum += w;
    }
    if (!(sum > 0)) r.fail("weights", "must not all be 0");
    double so_far = 0;
    for (const double w : weights) d.until.push_back((so_far += w) / sum);
    d.until.back() = 1;
  }

  std::string file_;
};

std::size_t option_of(const Draw& d, const Chooser& chooser) {
  if (!chooser.identity) return chooser.option % d.options.size();
  const double u = to_unit(chooser.bits(d.key));
  std::size_t i = 0;
  while (i + 1 < d.until.size() && u >= d.until[i]) ++i;
  return i;
}

std::vector<double> numbers_of(const Draw& d, const Chooser& chooser) {
  std::vector<double> out(d.a.size());
  if (d.kind == Draw::Kind::normal) {
    const double extreme = chooser.extreme < 0 ? d.lowest : d.highest;
    out[0] = chooser.identity ? std::clamp(d.a[0] + d.b[0] * to_normal(chooser.bits(d.key)), d.lowest, d.highest) : extreme;
    return out;
  }
  // One number for all components: a colour lies on the line between two.
  const double u = chooser.identity ? to_unit(chooser.bits(d.key)) : chooser.extreme < 0 ? 0 : 1;
  for (std::size_t i = 0; i < out.size(); ++i) {
    const double lower = std::min(d.a[i], d.b[i]), upper = std::max(d.a[i], d.b[i]);
    out[i] = std::clamp(d.kind == Draw::Kind::uniform
                            ? d.a[i] + u * (d.b[i] - d.a[i])
                            : portable_exp(portable_log(d.a[i]) + u * (portable_log(d.b[i]) - portable_log(d.a[i]))),
                        lower, upper);
  }
  return out;
}

struct Resolver {
  const Chooser& chooser;
  const std::vector<std::pair<std::string, std::string>>& named;  // words the named draws came out as

  bool present(const Value& v) const {
    if (!chooser.identity) return v.chance > 0;
    if (v.chance < 1 && to_unit(chooser.bits(v.chance_key)) >= v.chance) return false;
    for (const auto& [name, words] : v.when) {
      const auto drawn = std::find_if(named.begin(), named.end(), [&](const auto& n) { return n.first == name; });
      if (drawn == named.end() || std::find(words.begin(), words.end(), drawn->second) == words.end()) return false;
    }
    return true;
  }

  toml::table table(const Value& v) const {
    toml::table out;
    for (const auto& [key, child] : v.table) {
      if (!present(child)) continue;
      toml::array one;
      append(child, one);
      out.insert_or_assign(key, std::move(one[0]));
    }
    return out;
  }

  void append(const Value& v, toml::array& out) const {
    switch (v.kind) {
      case Value::Kind::plain:
        out.push_back(*v.plain);
        return;
      case Value::Kind::table:
        out.push_back(table(v));
        return;
      case Value::Kind::list: {
        toml::array list;
        for (const Value& child : v.list)
          if (present(child)) append(child, list);
        out.push_back(std::move(list));
        return;
      }
      case Value::Kind::draw:
        break;
    }
    const Draw& d = *v.draw;
    if (d.kind == Draw::Kind::choose) {
      append(d.options[option_of(d, chooser)], out);
      return;
    }
    const std::vector<double> numbers = numbers_of(d, chooser);
    if (!d.is_list) {
      out.push_back(numbers[0]);
      return;
    }
    toml::array list;
    for (const double n : numbers) list.push_back(n);
    out.push_back(std::move(list));
  }
};

PublishedRange read_range(TomlReader r, double highest) {
  PublishedRange out;
  const auto get = [&](const char* key) -> std::optional<double> {
    return r.has(key) ? std::optional(r.number(key, 0, highest)) : std::nullopt;
  };
  out.mean = get("mean");
  out.deviation = get("sd");
  out.lower = get("lower");
  out.upper = get("upper");
  r.finish();
  return out;
}

}  // namespace

struct BreedCoat {
  toml::table file;  // owns the plain values
  Value coat;
  std::vector<std::pair<std::string, Draw>> draws;  // named words

  ProceduralCoat make(const std::string& file_name, const Chooser& chooser) const {
    std::vector<std::pair<std::string, std::string>> named;
    for (const auto& [name, draw] : draws)
      named.emplace_back(name, draw.options[option_of(draw, chooser)].plain->as_string()->get());
    const toml::table resolved = Resolver{chooser, named}.table(coat);
    TomlReader r(resolved, file_name, "coat");
    ProceduralCoat out = read_procedural_coat(r);
    r.finish();
    return out;
  }
};

namespace {

void read_named_draws(TomlReader& draws, BreedCoat& out) {
  Compiler compiler(draws.file());
  for (const std::string& name : draws.keys()) {
    const toml::node* n = draws.node(name);
    if (!n->is_table() || !n->as_table()->contains("choose"))
      draws.fail(name, "must be {choose = [\"a\", \"b\"], weights = [1, 2]}");
    Draw d = compiler.draw(*n->as_table(), "draws." + name);
    for (const Value& option : d.options)
      if (!option.plain || !option.plain->is_string()) draws.fail(name, "must choose among texts");
    out.draws.emplace_back(name, std::move(d));
  }
}

// Every condition names a draw that is there, and words that it may come out as.
void check_conditions(const Value& v, const BreedCoat& breed, const TomlReader& at) {
  for (const auto& [name, words] : v.when) {
    std::vector<std::string> names, known;
    for (const auto& [n, draw] : breed.draws) {
      names.push_back(n);
      if (n == name)
        for (const Value& option : draw.options) known.push_back(option.plain->as_string()->get());
    }
    if (known.empty()) at.refuse("coat", fmt::format("a 'when' asks for the draw '{}', which [draws] does not have{}", name, suggestion(name, names)));
    for (const std::string& w : words)
      if (std::find(known.begin(), known.end(), w) == known.end())
        at.refuse("coat", fmt::format("a 'when' asks whether '{}' is '{}', which it never is{}", name, w, suggestion(w, known)));
  }
  for (const auto& [key, child] : v.table) check_conditions(child, breed, at);
  for (const Value& child : v.list) check_conditions(child, breed, at);
}

std::size_t most_options(const Value& v) {
  std::size_t most = 1;
  if (v.draw) {
    most = std::max(most, v.draw->options.size());
    for (const Value& o : v.draw->options) most = std::max(most, most_options(o));
  }
  for (const auto& [key, child] : v.table) most = std::max(most, most_options(child));
  for (const Value& child : v.list) most = std::max(most, most_options(child));
  return most;
}

}  // namespace

Breed read_breed(const std::string& name_or_path, const std::string& species,
                 const std::filesystem::path& relative_to) {
  const std::filesystem::path file = find_breed(name_or_path, species, relative_to);
  Breed breed;
  breed.name = file.stem().string();
  breed.species = species;
  breed.file = file.string();
  auto content = std::make_shared<BreedCoat>();
  content->file = TomlReader::parse(file);
  TomlReader r(content->file, breed.file);
  breed.about = r.text("about", "");
  if (r.has("sources")) breed.sources = r.texts("sources");
  if (auto p = r.table("published")) {
    if (auto share = p->table("dark_share")) breed.dark_share = read_range(*share, 1);
    if (auto patches = p->table("patches")) breed.patches = read_range(*patches, 1e6);
    breed.smallest_patch = p->number("smallest_patch_m2", breed.smallest_patch, 0, 100);
    p->finish();
  }
  if (auto draws = r.table("draws")) read_named_draws(*draws, *content);
  const auto coat = r.table("coat");
  if (!coat) r.missing("coat", "[coat.patches] with share = {normal = [0.5, 0.15], clamp = [0.1, 0.9]}");
  r.finish();
  const toml::table& table = *content->file["coat"].as_table();
  if (table.contains("seed"))
    coat->fail("seed", "cannot be given: every individual has its own; leave it out");
  content->coat = Compiler(breed.file).value(table, "coat");
  check_conditions(content->coat, *content, r);
  for (std::size_t option = 0; option < most_options(content->coat); ++option)
    for (const int extreme : {-1, 1}) content->make(breed.file, {std::nullopt, extreme, option});
  breed.coat = std::move(content);
  return breed;
}

std::string individual_name(const std::string& breed, int index) {
  return fmt::format("{}_{:06}", breed, index);
}

Coat individual(const Breed& breed, std::uint64_t seed, int index) {
  check(index >= 0, "individuals count from 0");
  const Chooser chooser{std::pair(seed, static_cast<std::uint64_t>(index)), 0, 0};
  ProceduralCoat made = breed.coat->make(breed.file, chooser);
  made.seed = chooser.bits(hash_text("pattern"));
  Coat coat;
  coat.name = individual_name(breed.name, index);
  coat.source = std::move(made);
  return coat;
}

}  // namespace moomill
