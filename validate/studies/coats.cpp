#include "validate/studies/coats.h"

#include <fmt/format.h>

#include <algorithm>

#include "generator/core/color.h"
#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "generator/dataset/codecs.h"
#include "scenes/scene.h"

namespace moomill {
namespace {

// L*a*b* of a coat at every sample of the hide.
std::vector<dvec3> sampled(const Coat& coat, const Hide& hide) {
  std::vector<dvec3> lab(hide.samples.size());
  if (const auto* procedural = std::get_if<ProceduralCoat>(&coat.source)) {
    const ReadyCoat ready = ready_coat(*procedural, hide);
    parallel_for(lab.size(), 256, [&](std::size_t i) {
      std::vector<float> inside;
      lab[i] = lab_from_linear(
          coat_color(ready, hide_point(hide, hide.samples[i].triangle, dvec3(hide.samples[i].weights), inside)));
    });
  } else if (const auto* file = std::get_if<ImageCoat>(&coat.source)) {
    const Surface& s = *hide.surface;
    if (s.uvs.empty()) input_error("{}: the rig has no UVs, so it cannot wear an image", file->file);
    const Image8 image = read_image8(std::filesystem::path(file->file));
    for (std::size_t i = 0; i < lab.size(); ++i) {
      const uvec3& v = s.triangles[hide.samples[i].triangle];
      const vec3& w = hide.samples[i].weights;
      const vec2 uv = w.x * s.uvs[v.x] + w.y * s.uvs[v.y] + w.z * s.uvs[v.z];
      const int x = std::clamp(static_cast<int>(uv.x * image.width), 0, image.width - 1),
                y = std::clamp(static_cast<int>(uv.y * image.height), 0, image.height - 1);
      vec3 color;
      for (int c = 0; c < 3; ++c) {
        const double v8 = image.at(x, y, image.channels >= 3 ? c : 0) / 255.0;
        color[c] = static_cast<float>(v8 <= 0.04045 ? v8 / 12.92 : std::pow((v8 + 0.055) / 1.055, 2.4));
      }
      lab[i] = lab_from_linear(color);
    }
  } else {
    input_error("coat '{}' is the rig's own materials, which are not compared; name a coat file or an image", coat.name);
  }
  return lab;
}

}  // namespace

CoatComparison compare_coats(const std::string& species, const std::vector<std::string>& coats) {
  const Species animal = read_species(species, NnopcsNormalization::box, {});
  Hide hide = make_hide(animal.rig.surface, animal.rig.part_names, read_finish(species).hair);
  std::vector<Coat> read;
  for (const std::string& name : coats) {
    read.push_back(read_coat(name, species, {}));
    if (const auto* p = std::get_if<ProceduralCoat>(&read.back().source)) know_parts(hide, *p);
  }
  CoatComparison result;
  std::vector<std::vector<dvec3>> lab;
  for (const Coat& c : read) {
    result.names.push_back(c.name);
    lab.push_back(sampled(c, hide));
  }
  const int n = static_cast<int>(read.size());
  for (int i = 0; i < n; ++i)
    for (int j = i + 1; j < n; ++j) {
      std::vector<double> d(hide.samples.size());
      CoatPair pair{i, j};
      for (std::size_t k = 0; k < d.size(); ++k) {
        d[k] = ciede2000(lab[i][k], lab[j][k]);
        pair.mean += d[k] / static_cast<double>(d.size());
        pair.share_above_20 += (d[k] > 20) / static_cast<double>(d.size());
      }
      std::sort(d.begin(), d.end());
      if (!d.empty()) pair.median = d[d.size() / 2];
      pair.meant_alike = read[i].looks_like == read[j].name || read[j].looks_like == read[i].name;
      result.pairs.push_back(pair);
    }
  return result;
}

StudyResult coat_study(const std::string& species) {
  const std::vector<std::string> names = shipped_coats(species);
  if (names.size() < 2) input_error("species '{}' ships {} coats; there is nothing to compare", species, names.size());
  const CoatComparison c = compare_coats(species, names);
  StudyResult result;
  result.title = "Coats of " + species + ": mean CIEDE2000 over the surface";
  const int n = static_cast<int>(names.size());
  std::vector<std::vector<std::string>> cell(n, std::vector<std::string>(n));
  double least = std::numeric_limits<double>::infinity();
  int apart = 0;
  for (const CoatPair& p : c.pairs) {
    cell[p.first][p.second] = cell[p.second][p.first] = p.meant_alike ? fmt::format("**{:.1f}**", p.mean) : fmt::format("{:.1f}", p.mean);
    if (p.meant_alike) {
      const std::string name = fmt::format("{} and {}, meant alike", c.names[p.first], c.names[p.second]);
      result.figures.push_back({name + ": at least", p.mean, "CIEDE2000", {}, 2.0});
      result.figures.push_back({name + ": at most", p.mean, "CIEDE2000", 6.0, {}});
    } else {
      least = std::min(least, p.mean);
      ++apart;
    }
  }
  if (apart > 0) result.figures.push_back({"least of the other pairs", least, "CIEDE2000", {}, 10.0});
  for (const CoatPair& p : c.pairs)
    if (!p.meant_alike)
      result.figures.push_back(
          {fmt::format("{} and {}", c.names[p.first], c.names[p.second]), p.mean, "CIEDE2000", {}, 10.0});
  result.table = "| coat |";
  for (int j = 0; j < n; ++j) result.table += fmt::format(" {} |", j);
  result.table += "\n|---|";
  for (int j = 0; j < n; ++j) result.table += "---|";
  result.table += "\n";
  for (int i = 0; i < n; ++i) {
    result.table += fmt::format("| {} |", c.names[i]);
    for (int j = 0; j < n; ++j) result.table += " " + cell[i][j] + " |";
    result.table += "\n";
  }
  return result;
}

}  // namespace moomill
