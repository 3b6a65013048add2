// Sheets of rigs and scenes, made by the program itself.
#include <doctest/doctest.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <set>

#include "generator/dataset/codecs.h"
#include "tests/rigs/fixtures.h"

using namespace moomill;
namespace fs = std::filesystem;

namespace {

int run(const std::string& arguments) {
  return std::system((std::string("'") + MOOMILL_PROGRAM + "' " + arguments + " >/dev/null 2>&1 </dev/null").c_str());
}

// Colours among the pixels of rows [from, to), shares of the picture's height.
std::set<std::uint32_t> colors(const Image8& image, double from, double to) {
  std::set<std::uint32_t> found;
  for (int y = static_cast<int>(from * image.height); y < static_cast<int>(to * image.height); ++y)
    for (int x = 0; x < image.width; ++x)
      found.insert(image.at(x, y, 0) << 16 | image.at(x, y, 1) << 8 | image.at(x, y, 2));
  return found;
}

}  // namespace

TEST_CASE("a rig, a strip of frames and all coats on a sheet") {
  const TempFolder folder;
  const auto at = [&](const char* name) { return (folder.path / name).string(); };
  write_glb(fixtures::tube(), folder.path / "tube.glb");
  REQUIRE(run("preview '" + at("tube.glb") + "' -o '" + at("rig.png") + "'") == 0);
  const Image8 rig = decode_png8(folder.path / "rig.png");
  CHECK(rig.width > 8 * 50);
  // Six rows: three rings, weights, neutral coordinates, parts. Two joints blend in the fourth; clay is grey, and of the
  // two parts in the last there are two colours beside paper, ink and black.
  CHECK(colors(rig, 0.56, 0.63).size() > 100);
  CHECK(colors(rig, 0.74, 0.79).size() > 100);
  CHECK(colors(rig, 0.90, 0.95).size() <= 6);
  for (const std::uint32_t c : colors(rig, 0.09, 0.45)) {
    const int red = static_cast<int>(c >> 16), blue = static_cast<int>(c & 255);
    CHECK(std::abs(red - blue) < 60);
  }

  // A scene with two coats: one red, one blue.
  const auto png = [&](const char* name, std::uint8_t red, std::uint8_t blue) {
    Image8 image(4, 4, 3);
    for (std::size_t i = 0; i < image.data.size(); i += 3) image.data[i] = red, image.data[i + 2] = blue;
    const std::vector<std::uint8_t> bytes = encode_png8(image);
    write_file_atomically(folder.path / name, bytes.data(), bytes.size());
  };
  png("red.png", 255, 0);
  png("blue.png", 0, 255);
  Rig painted = fixtures::tube();
  painted.surface.uvs.assign(painted.surface.rest.size(), vec2(0.5f));
  write_glb(painted, folder.path / "painted.glb");
  std::ofstream(folder.path / "still.toml")
      << "[[animals]]\nspecies = \"painted.glb\"\ncoats = [\"red.png\", \"blue.png\"]\n"
         "[cameras]\nresolution = [96, 72]\n[render]\nsamples = 2\ncoat_resolution = 16\n";
  REQUIRE(run("preview '" + at("still.toml") + "' --coats -o '" + at("coats.png") + "'") == 0);
  bool red = false, blue = false;
  for (const std::uint32_t c : colors(decode_png8(folder.path / "coats.png"), 0, 1)) {
    const int r = static_cast<int>(c >> 16), b = static_cast<int>(c & 255);
    red = red || r > b + 60;
    blue = blue || b > r + 60;
  }
  CHECK(red);
  CHECK(blue);
  REQUIRE(run("preview '" + at("still.toml") + "' --strip 1 --coat 1 -o '" + at("strip.png") + "'") == 0);
  for (const std::uint32_t c : colors(decode_png8(folder.path / "strip.png"), 0, 1)) CHECK((c >> 16) < (c & 255) + 60);
  CHECK(run("preview '" + at("still.toml") + "' --strip 150 -o '" + at("strip.png") + "'") != 0);
  CHECK(run("preview '" + at("still.toml") + "' --strip 1 --camera 99 -o '" + at("strip.png") + "'") != 0);
}
