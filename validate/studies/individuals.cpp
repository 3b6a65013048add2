#include "validate/studies/individuals.h"

#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <bit>
#include <cmath>

#include "generator/core/color.h"
#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "generator/core/statistics.h"
#include "scenes/breed_file.h"
#include "scenes/scene.h"

namespace moomill {
namespace {

constexpr double different = 20;     // CIEDE2000
constexpr double bar_share = 0.05;   // of the surface
constexpr double bar_animals = 0.995;
constexpr int point_count = 2048;
constexpr int counted_for_patches = 1000;  // individuals whose patches are counted, on every vertex
// S_L = 1 + 0.015 (L - 50)^2 / sqrt(20 + (L - 50)^2) is largest at L = 0 and 100.
const double largest_sl = 1 + 0.015 * 2500 / std::sqrt(2520.0);

// The L* below which points count as dark, so that as many pairs of points as possible are told apart by bits alone.
double best_dark_limit(const SampledHerd& herd, double gap) {
  std::array<double, 101> until{};  // share of points of L* at most i
  for (const auto& c : herd.lab) until[static_cast<int>(std::clamp(c[0], 0.0f, 99.99f)) + 1] += 1;
  std::partial_sum(until.begin(), until.end(), until.begin());
  double best = 0, most = -1;
  for (int a = 1; a + gap < 100; ++a) {
    const double lower = until[a], upper = until[100] - until[std::min(100, static_cast<int>(std::ceil(a + gap)))];
    if (lower * upper > most) most = lower * upper, best = a;
  }
  return best;
}

double exact_share(const SampledHerd& herd, int i, int j, double enough) {
  const auto a = herd.of(i), b = herd.of(j);
  int count = 0;
  const int stop = static_cast<int>(std::ceil(enough * herd.points));
  for (int p = 0; p < herd.points && count < stop; ++p)
    count += ciede2000({a[p][0], a[p][1], a[p][2]}, {b[p][0], b[p][1], b[p][2]}) > different;
  return static_cast<double>(count) / herd.points;
}

}  // namespace

Neighbours nearest_neighbours(const SampledHerd& herd, double bar) {
  Neighbours out;
  const int n = herd.size();
  const double gap = different * largest_sl + 0.01;
  out.dark = best_dark_limit(herd, gap);
  out.light = out.dark + gap;
  const int words = (herd.points + 63) / 64;
  std::vector<std::uint64_t> dark(static_cast<std::size_t>(n) * words, 0), light(dark);
  parallel_for(n, 16, [&](std::size_t i) {
    const auto c = herd.of(static_cast<int>(i));
    for (int p = 0; p < herd.points; ++p) {
      if (c[p][0] < out.dark) dark[i * words + p / 64] |= 1ull << (p % 64);
      if (c[p][0] > out.light) light[i * words + p / 64] |= 1ull << (p % 64);
    }
  });
  out.share.assign(n, 1);
  std::atomic<std::uint64_t> exact{0};
  // Each animal against all others: twice the work of each pair once, but no two threads share a result.
  parallel_for(n, 8, [&](std::size_t i) {
    double nearest = 1;
    std::vector<std::pair<int, int>> candidates;  // lower bound in points, individual
    for (int j = 0; j < n; ++j) {
      if (j == static_cast<int>(i)) continue;
      int count = 0;
      const std::uint64_t *di = &dark[i * words], *li = &light[i * words], *dj = &dark[static_cast<std::size_t>(j) * words],
                          *lj = &light[static_cast<std::size_t>(j) * words];
      for (int w = 0; w < words; ++w) count += std::popcount((di[w] & lj[w]) | (li[w] & dj[w]));
      if (count < bar * herd.points)
        candidates.emplace_back(count, j);
      else
        nearest = std::min(nearest, static_cast<double>(count) / herd.points);
    }
    std::sort(candidates.begin(), candidates.end());
    for (const auto& [bound, j] : candidates) {
      if (static_cast<double>(bound) / herd.points >= nearest) break;  // no nearer, for certain
      ++exact;
      nearest = std::min(nearest, exact_share(herd, static_cast<int>(i), j, nearest));
      // Of breeds of one colour every pair is a candidate: one near neighbour is all that needs to be known.
      if (candidates.size() > 2000 && nearest < bar) break;
    }
    out.share[i] = nearest;
  });
  out.pairs = static_cast<std::uint64_t>(n) * (n - 1) / 2;
  out.exact = exact;
  return out;
}

namespace {

Moments moments_of(const std::vector<double>& v) {
  Moments m;
  for (const double x : v) m.add(x);
  return m;
}
double mean_of(const std::vector<double>& v) { return v.empty() ? 0 : moments_of(v).mean(); }
double deviation_of(const std::vector<double>& v) { return v.empty() ? 0 : moments_of(v).deviation(); }
double quantile(std::vector<double> v, double q) {
  if (v.empty()) return 0;
  std::sort(v.begin(), v.end());
  return v[std::min(v.size() - 1, static_cast<std::size_t>(q * static_cast<double>(v.size())))];
}
double share_where(const std::vector<double>& v, double above, double below) {
  const auto n = std::count_if(v.begin(), v.end(), [&](double x) { return x >= above && x < below; });
  return v.empty() ? 0 : static_cast<double>(n) / static_cast<double>(v.size());
}

// Points of the hide with what they refer to.
struct Points {
  std::vector<std::vector<float>> inside;
  std::vector<HidePoint> at;
  void add(const Hide& hide, std::uint32_t triangle, const dvec3& weights, bool streak) {
    inside.emplace_back();
    at.push_back(hide_point(hide, triangle, weights, inside.back(), streak));
  }
};

bool is_hair(const ReadyCoat& coat, const HidePoint& p) {
  for (const int part : coat.color_parts)
    if (part >= 0 && p.inside[part] > 0) return false;
  return true;
}

struct PatchCount {
  int dark = 0, light = 0;
};

// Connected sets of vertices, over the mesh's edges, of at least `smallest` square metres.
PatchCount count_patches(const Hide& hide, const std::vector<std::uint8_t>& state, const std::vector<double>& area,
                         double smallest) {
  PatchCount out;
  std::vector<std::uint8_t> seen(state.size(), 0);
  std::vector<std::uint32_t> open;
  for (std::uint32_t v = 0; v < state.size(); ++v) {
    if (seen[v] || state[v] == 2) continue;
    double sum = 0;
    open.assign(1, v);
    seen[v] = 1;
    while (!open.empty()) {
      const std::uint32_t u = open.back();
      open.pop_back();
      sum += area[u];
      for (std::uint32_t k = hide.neighbour_begin[u]; k < hide.neighbour_begin[u + 1]; ++k) {
        const std::uint32_t w = hide.neighbours[k];
        if (!seen[w] && state[w] == state[v]) seen[w] = 1, open.push_back(w);
      }
    }
    if (sum >= smallest) ++(state[v] ? out.dark : out.light);
  }
  return out;
}

std::string published_row(const std::string& name, const std::vector<double>& v, const PublishedRange& p, int digits) {
  const auto text = [&](const std::optional<double>& x) { return x ? fmt::format("{:.{}f}", *x, digits) : std::string("-"); };
  return fmt::format("| {} | {:.{}f} | {:.{}f} | {:.{}f} to {:.{}f} | {} | {} | {} to {} |\n", name, mean_of(v), digits,
                     deviation_of(v), digits, quantile(v, 0), digits, quantile(v, 1), digits, text(p.mean),
                     text(p.deviation), text(p.lower), text(p.upper));
}

}  // namespace

StudyResult individuals_study(const IndividualsRequest& request) {
  const Breed breed = read_breed(request.breed, request.species, {});
  const Species animal = read_species(request.species, NnopcsNormalization::box, {});
  Hide hide = make_hide(animal.rig.surface, animal.rig.part_names, read_finish(request.species).hair);
  const int n = request.count;
  // Parts by chance: all that any individual names must be known before the points are made.
  std::vector<Coat> coats(n);
  parallel_for(n, 16, [&](std::size_t i) { coats[i] = individual(breed, request.seed, static_cast<int>(i)); });
  const auto procedural = [&](std::size_t i) -> const ProceduralCoat& { return std::get<ProceduralCoat>(coats[i].source); };
  for (int i = 0; i < n; ++i) know_parts(hide, procedural(i));

  Points points, vertices;
  const std::size_t stride = std::max<std::size_t>(1, hide.samples.size() / point_count);
  points.inside.reserve(hide.samples.size());
  for (std::size_t i = stride / 2; i < hide.samples.size(); i += stride)
    points.add(hide, hide.samples[i].triangle, dvec3(hide.samples[i].weights), true);
  // Every vertex once, with a third of the area of the triangles around it.
  std::vector<double> vertex_area(hide.welded_count, 0.0);
  std::vector<std::pair<std::uint32_t, int>> corner(hide.welded_count, {0u, -1});
  const Surface& s = animal.rig.surface;
  for (std::uint32_t t = 0; t < s.triangles.size(); ++t) {
    const uvec3& v = s.triangles[t];
    const double a = 0.5 * glm::length(glm::cross(dvec3(s.rest[v.y]) - dvec3(s.rest[v.x]), dvec3(s.rest[v.z]) - dvec3(s.rest[v.x])));
    for (int k = 0; k < 3; ++k) {
      vertex_area[hide.welded[v[k]]] += a / 3;
      corner[hide.welded[v[k]]] = {t, k};
    }
  }
  std::vector<std::uint8_t> used(hide.welded_count, 1);
  vertices.inside.reserve(hide.welded_count);
  for (std::size_t v = 0; v < hide.welded_count; ++v) {
    used[v] = corner[v].second >= 0;
    dvec3 weights(0);
    weights[std::max(0, corner[v].second)] = 1;
    vertices.add(hide, corner[v].first, weights, false);
  }

  SampledHerd herd;
  herd.points = static_cast<int>(points.at.size());
  herd.lab.resize(static_cast<std::size_t>(n) * herd.points);
  std::vector<std::uint8_t> hair(static_cast<std::size_t>(n) * herd.points);
  const int step = std::max(1, n / counted_for_patches);
  std::vector<std::vector<vec3>> vertex_colors((n + step - 1) / step);
  std::vector<std::vector<std::uint8_t>> vertex_hair(vertex_colors.size());
  parallel_for(n, 4, [&](std::size_t i) {
    const ReadyCoat ready = ready_coat(procedural(i), hide);
    for (int p = 0; p < herd.points; ++p) {
      const dvec3 lab = lab_from_linear(coat_color(ready, points.at[p]));
      herd.lab[i * herd.points + p] = {static_cast<float>(lab.x), static_cast<float>(lab.y), static_cast<float>(lab.z)};
      hair[i * herd.points + p] = is_hair(ready, points.at[p]);
    }
    if (i % step) return;
    std::vector<vec3>& colors = vertex_colors[i / step];
    for (const HidePoint& p : vertices.at) {
      colors.push_back(coat_color(ready, p));
      vertex_hair[i / step].push_back(is_hair(ready, p));
    }
  });
  const Neighbours near = nearest_neighbours(herd, bar_share);

  const double middle = 0.5 * (near.dark + near.light);
  std::vector<double> dark_share(n), dark_patches, light_patches;
  for (int i = 0; i < n; ++i) {
    double all = 0, dark = 0;
    for (int p = 0; p < herd.points; ++p) {
      if (!hair[static_cast<std::size_t>(i) * herd.points + p]) continue;
      all += 1;
      dark += herd.lab[static_cast<std::size_t>(i) * herd.points + p][0] < middle;
    }
    dark_share[i] = all > 0 ? dark / all : 0;
  }
  std::vector<PatchCount> counts(vertex_colors.size());
  parallel_for(counts.size(), 1, [&](std::size_t k) {
    std::vector<std::uint8_t> state(hide.welded_count, 2);  // 0 light, 1 dark, 2 no hair
    for (std::size_t v = 0; v < state.size(); ++v)
      if (used[v] && vertex_hair[k][v]) state[v] = lab_from_linear(vertex_colors[k][v]).x < middle;
    counts[k] = count_patches(hide, state, vertex_area, breed.smallest_patch);
  });
  for (const PatchCount& c : counts) {
    dark_patches.push_back(c.dark);
    light_patches.push_back(c.light);
  }

  const double distinct = share_where(near.share, bar_share, 2);
  StudyResult result;
  result.title = fmt::format("Individuals of {}: {} animals of herd {}", breed.name, n, request.seed);
  result.figures.push_back({fmt::format("animals that differ from their nearest neighbour by CIEDE2000 above 20 on at least {:.0f} % of the surface", 100 * bar_share),
                            distinct, "", {}, bar_animals});
  result.figures.push_back({"same, on at least 6 % (two standard errors more)", share_where(near.share, 0.06, 2), "", {}, {}});
  result.figures.push_back({"nearest pair, share of the surface", *std::min_element(near.share.begin(), near.share.end()), "", {}, {}});
  result.figures.push_back({"median distance to the nearest neighbour, share of the surface", quantile(near.share, 0.5), "", {}, {}});
  result.figures.push_back({"share of dark hair, mean", mean_of(dark_share), "", {}, {}});
  result.figures.push_back({"share of dark hair, standard deviation", deviation_of(dark_share), "", {}, {}});
  result.figures.push_back({"dark patches, mean", mean_of(dark_patches), "", {}, {}});
  result.figures.push_back({"dark patches, standard deviation", deviation_of(dark_patches), "", {}, {}});

  const double error = std::sqrt(bar_share * (1 - bar_share) / herd.points);
  std::string& t = result.table;
  t = fmt::format("{} individuals of {} (seed {}), {} points of equal area; {} pairs, of which {} were too near for the bound by "
                  "bits (dark: L* below {:.0f}, light: above {:.1f}) and were compared by CIEDE2000. Standard error of a share of "
                  "5 %: {:.2f} %.\n\n",
                  n, breed.name, request.seed, herd.points, near.pairs, near.exact, near.dark, near.light, 100 * error);
  t += "| distance to the nearest neighbour | share of the surface |\n|---|---|\n";
  for (const auto& [name, q] : {std::pair("least", 0.0), std::pair("1 of 1000", 0.001), std::pair("1 of 200", 0.005),
                                std::pair("1 of 20", 0.05), std::pair("median", 0.5)})
    t += fmt::format("| {} | {:.1f} % |\n", name, 100 * quantile(near.share, q));
  t += "\n| statistic | mean | sd | range | published mean | sd | range |\n|---|---|---|---|---|---|---|\n";
  t += published_row("share of dark hair", dark_share, breed.dark_share, 3);
  t += published_row(fmt::format("dark patches of at least {:.0f} cm2, {} animals", 1e4 * breed.smallest_patch, dark_patches.size()),
                     dark_patches, breed.patches, 1);
  t += published_row("light patches, alike", light_patches, {}, 1);
  t += fmt::format("\nAnimals under 40 % dark: {:.1f} %, 40 to 60 %: {:.1f} %, above: {:.1f} %.\n",
                   100 * share_where(dark_share, 0, 0.4), 100 * share_where(dark_share, 0.4, 0.6), 100 * share_where(dark_share, 0.6, 2));
  if (!breed.sources.empty()) {
    t += "\nPublished:\n";
    for (const std::string& source : breed.sources) t += "- " + source + "\n";
  }
  return result;
}

}  // namespace moomill
