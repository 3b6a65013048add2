// `moomill coat ...`.
#include <spdlog/spdlog.h>

#include <chrono>

#include "generator/command_tools.h"
#include "generator/commands.h"
#include "generator/core/error.h"
#include "generator/dataset/codecs.h"
#include "scenes/scene.h"
#include "validate/studies/coats.h"

namespace moomill {

int run_coat_list(const std::string& species) {
  const std::vector<std::string> names = shipped_coats(species);
  if (names.empty()) {
    find_species(species, {});  // says so where there is no such species at all
    input_error("species '{}' ships no coats; write textures/{}/NAME.toml, or wear an image or \"own\"", species, species);
  }
  for (std::size_t i = 0; i < names.size(); ++i)
    print(fmt::format("{:>3}  {:<28} {}\n", i, names[i], read_coat(names[i], species, {}).about));
  return 0;
}

int run_coat_bake(const CoatBakeCommand& command) {
  require_extension("-o", command.out, ".png");
  const Coat coat = read_coat(command.coat, command.rig, {});
  const auto* procedural = std::get_if<ProceduralCoat>(&coat.source);
  if (!procedural) input_error("coat '{}' is {} already; only coat files are baked", command.coat,
                               std::holds_alternative<ImageCoat>(coat.source) ? "an image" : "the rig's own");
  const Species species = read_species(command.rig, NnopcsNormalization::box, {});
  Hide hide = make_hide(species.rig.surface, species.rig.part_names, read_finish(command.rig).hair);
  const auto begin = std::chrono::steady_clock::now();
  const Image8 image = bake_coat(*procedural, hide, command.resolution);
  const std::chrono::duration<double> took = std::chrono::steady_clock::now() - begin;
  const std::vector<std::uint8_t> bytes = encode_png8(image);
  write_file_atomically(command.out, bytes.data(), bytes.size());
  spdlog::info("{} holds {} on {}, {} x {}, baked in {:.2f} s", command.out, coat.name, species.name, image.width,
               image.height, took.count());
  return 0;
}

int run_coat_compare(const std::string& species, const std::string& folder) {
  return finish_study(coat_study(species), folder);
}

}  // namespace moomill
