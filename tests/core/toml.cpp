#include "generator/core/toml.h"

#include <doctest/doctest.h>

#include "tests/temporary_file.h"

using namespace moomill;
using namespace moomill::test;

namespace {

// The message of reading `text` by `read`, with the temporary folder taken off its front.
template <class Read>
std::string reading(const std::string& text, const Read& read) {
  const TemporaryFile file("a.toml", text);
  std::string message = message_of([&] {
    const toml::table table = TomlReader::parse(file.path);
    TomlReader reader(table, file.path.string());
    read(reader);
    reader.finish();
  });
  const std::string folder = file.folder().string() + "/";
  if (message.compare(0, folder.size(), folder) == 0) message.erase(0, folder.size());
  return message;
}

}  // namespace

TEST_CASE("an unknown key is refused with its line and the nearest known one") {
  CHECK(reading("seed = 1\n\n[camreas]\ncount = 2\n", [](TomlReader& r) {
          r.integer("seed", 0, 0, 9);
          r.table("cameras");
        }) == "a.toml:3: unknown key 'camreas'; did you mean 'cameras'?");
  CHECK(reading("[render]\nsampels = 2\n", [](TomlReader& r) {
          auto t = r.table("render");
          t->integer("samples", 1, 1, 9);
          t->finish();
        }) == "a.toml:2: unknown key 'sampels' in [render]; did you mean 'samples'?");
  CHECK(reading("zebra = 2\n", [](TomlReader& r) {
          r.integer("b", 1, 1, 9);
          r.integer("a", 1, 1, 9);
        }) == "a.toml:1: unknown key 'zebra'; known are a, b");
  CHECK(reading("[[animals]]\nx = 1\n[[animals]]\ny = 1\n", [](TomlReader& r) {
          for (TomlReader& t : r.tables("animals")) {
            t.number("x", 0, 0, 9);
            t.finish();
          }
        }) == "a.toml:4: unknown key 'y' in [animals[1]]; known are x");
}

TEST_CASE("values of the wrong type or out of range are refused with the wanted one") {
  auto integer = [](TomlReader& r) { r.integer("count", 1, 1, 16384); };
  CHECK(reading("count = 0\n", integer) == "a.toml:1: 'count' must be a whole number from 1 to 16384, not 0");
  CHECK(reading("count = 2.5\n", integer) == "a.toml:1: 'count' must be a whole number from 1 to 16384, not 2.5");
  CHECK(reading("count = \"2\"\n", integer) ==
        "a.toml:1: 'count' must be a whole number from 1 to 16384, not the text \"2\"");
  auto number = [](TomlReader& r) { r.number("x", 0, 0, 1e9); };
  CHECK(contains(reading("x = nan\n", number),
                 "a.toml:1: 'x' must be a number from 0 to 1000000000 and finite, not nan"));
  CHECK(contains(reading("x = -inf\n", number), "finite, not -inf"));
  CHECK(contains(reading("x = -1\n", number), "not -1"));
  CHECK(contains(reading("x = {a = 1}\n", number), "not a table"));
  auto vector = [](TomlReader& r) { r.vector3("v"); };
  CHECK(contains(reading("v = [1, 2]\n", vector), "must be a list of three numbers, not of 2"));
  CHECK(contains(reading("v = [1, 2, inf]\n", vector), "finite"));
  CHECK(contains(reading("w = 1\n", vector), "'v' is missing"));
  auto word = [](TomlReader& r) { r.word("kind", "box", {"box", "diagonal"}); };
  CHECK(reading("kind = \"dagonal\"\n", word) ==
        "a.toml:1: 'kind' must be one of box, diagonal, not 'dagonal'; did you mean 'diagonal'?");
  CHECK(contains(reading("names = [1]\n", [](TomlReader& r) { r.texts("names"); }),
                 "must be a list of texts, not hold 1"));
  CHECK(contains(reading("on = 1\n", [](TomlReader& r) { r.boolean("on", false); }), "must be true or false, not 1"));
}

TEST_CASE("a file that cannot be parsed or read is named with the place") {
  CHECK(contains(reading("a = 1\nb = = 2\n", [](TomlReader&) {}), "a.toml:2:"));
  CHECK(contains(reading("a = 1\na = 2\n", [](TomlReader&) {}), "a.toml:2:"));
  CHECK(message_of([] { TomlReader::parse("nowhere/x.toml"); }) ==
        "nowhere/x.toml cannot be read: No such file or directory; check the path");
  CHECK(contains(message_of([] { TomlReader::parse("/"); }), "is a folder"));
}

TEST_CASE("nearest_word finds slips of a third of the word, and nothing further off") {
  CHECK(nearest_word("sihlouette", {"rgb", "silhouette"}) == "silhouette");
  CHECK(nearest_word("RGB", {"rgb", "uv"}) == "rgb");
  CHECK(nearest_word("depht", {"depth"}) == "depth");
  CHECK(nearest_word("banana", {"depth", "uv"}).empty());
  CHECK(nearest_word("a", {"b"}).empty());
}
