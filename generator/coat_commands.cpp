// `moomill coat ...`.
#include <spdlog/spdlog.h>

#include <chrono>

#include "generator/command_tools.h"
#include "generator/commands.h"
#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "generator/dataset/codecs.h"
#include "scenes/breed_file.h"
#include "scenes/scene.h"
#include "validate/studies/coats.h"
#include "validate/studies/individuals.h"

namespace moomill {

namespace {

// Individuals of a breed as pictures NAME_000000.png, ... in a folder; tells how long the baking itself took.
int bake_individuals(const CoatBakeCommand& command) {
  const std::string species = find_species(command.rig, {}).stem().string();
  const Breed breed = read_breed(command.breed, species, {});
  const Species animal = read_species(command.rig, NnopcsNormalization::box, {});
  using Clock = std::chrono::steady_clock;
  const auto start = Clock::now();
  Hide hide = make_hide(animal.rig.surface, animal.rig.part_names, read_finish(species).hair);
  const TexelMap texels = map_texels(hide, command.resolution);
  const auto ready = Clock::now();
  std::chrono::duration<double> baking{0};
  constexpr int together = 64;
  for (int first = 0; first < command.count; first += together) {
    const int n = std::min(together, command.count - first);
    std::vector<Image8> images(n);
    const auto begin = Clock::now();
    std::vector<Coat> coats;
    for (int i = 0; i < n; ++i) {
      coats.push_back(individual(breed, command.seed, command.first + first + i));
      know_parts(hide, std::get<ProceduralCoat>(coats.back().source));
    }
    parallel_for(n, 1, [&](std::size_t i) {
      images[i] = bake_coat(ready_coat(std::get<ProceduralCoat>(coats[i].source), hide), hide, texels);
    });
    baking += Clock::now() - begin;
    parallel_for(n, 1, [&](std::size_t i) {
      const std::vector<std::uint8_t> bytes = encode_png8(images[i]);
      write_file_atomically(std::filesystem::path(command.out) / (coats[i].name + ".png"), bytes.data(), bytes.size());
    });
  }
  spdlog::info("{} holds {} individuals of {} on {}, {} x {}; hide and texels {:.1f} s, baking {:.1f} s, {:.1f} s in all",
               command.out, command.count, breed.name, animal.name, command.resolution, command.resolution,
               std::chrono::duration<double>(ready - start).count(), baking.count(),
               std::chrono::duration<double>(Clock::now() - start).count());
  return 0;
}

}  // namespace

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
  if (!command.breed.empty()) return bake_individuals(command);
  if (command.coat.empty()) input_error("coat bake: name a coat, or a breed with --breed");
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

int run_coat_individuals(const IndividualsCommand& command) {
  return finish_study(individuals_study({command.species, command.breed, command.count, command.seed}), command.out);
}

int run_coat_compare(const std::string& species, const std::string& folder) {
  return finish_study(coat_study(species), folder);
}

}  // namespace moomill
