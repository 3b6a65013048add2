#include "neural/identify.h"

#include <ATen/Parallel.h>
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <set>

#include "generator/core/error.h"
#include "generator/dataset/codecs.h"
#include "generator/dataset/json.h"

namespace moomill {

using torch::Tensor;

const char* name_of(CodeDistance distance) {
  return distance == CodeDistance::cosine ? "cosine" : "euclidean";
}

Tensor code_distances(const Tensor& queries, const Tensor& gallery, CodeDistance distance) {
  const Tensor q = queries.to(torch::kDouble), g = gallery.to(torch::kDouble);
  if (distance == CodeDistance::cosine) {
    const auto unit = [](const Tensor& t) { return t / t.norm(2, 1, true).clamp_min(1e-12); };
    return 1 - unit(q).matmul(unit(g).t());
  }
  const Tensor squared = q.square().sum(1, true) + g.square().sum(1).unsqueeze(0) - 2 * q.matmul(g.t());
  return squared.clamp_min(0).sqrt();
}

Tensor scatter_normalisation(const CodeSet& known) {
  const auto z = known.codes.size(1);
  Tensor scatter = torch::zeros({z, z}, torch::kDouble);
  std::int64_t freedom = 0;
  std::map<int, std::vector<std::int64_t>> rows_of_coat;
  for (std::size_t i = 0; i < known.views.size(); ++i)
    if (known.views[i].coat >= 0) rows_of_coat[known.views[i].coat].push_back(static_cast<std::int64_t>(i));
  for (const auto& [coat, rows] : rows_of_coat) {
    Tensor codes = known.codes.index_select(0, torch::tensor(rows, torch::kLong)).to(torch::kDouble);
    codes = codes - codes.mean(0, true);
    scatter += codes.t().matmul(codes);
    freedom += static_cast<std::int64_t>(rows.size()) - 1;
  }
  if (freedom < 1) input_error("no coat has two codes, so nothing tells how codes of one coat scatter; embed more views of the training split");
  scatter /= static_cast<double>(freedom);
  const double mean_variance = scatter.diag().mean().item<double>();
  if (!(mean_variance > 0) || !std::isfinite(mean_variance))
    input_error("codes of one coat are all alike, or not finite, so nothing tells how they scatter; embed them with a trained model");
  scatter += 1e-3 * mean_variance * torch::eye(z, torch::kDouble);
  // scatter = L L^T; rows times L^-T have the identity as their scatter.
  return torch::linalg_inv(torch::linalg_cholesky(scatter)).t().contiguous();
}

CodeSet mapped(CodeSet set, const Tensor& map) {
  if (set.codes.size(1) != map.size(0))
    input_error("codes of {} numbers cannot be compared with codes of {}; embed both with the same model", set.codes.size(1),
                map.size(0));
  set.codes = set.codes.to(torch::kDouble).matmul(map);
  return set;
}

Disjoint disjoint_of(const CodeSet& queries, const CodeSet& gallery) {
  return {true, queries.cameras == gallery.cameras};
}

std::vector<QueryMatch> match_codes(const CodeSet& queries, const CodeSet& gallery, CodeDistance distance,
                                    const Disjoint& disjoint, const std::vector<int>& coats) {
  if (queries.codes.size(1) != gallery.codes.size(1))
    input_error("codes of {} numbers cannot be compared with codes of {}; embed both with the same model",
                queries.codes.size(1), gallery.codes.size(1));
  const auto takes_part = [&](int coat) {
    return coats.empty() || std::find(coats.begin(), coats.end(), coat) != coats.end();
  };
  std::vector<QueryMatch> out(queries.views.size());
  constexpr std::int64_t rows = 256;  // queries at a time: their distances to a large gallery stay in bounds
  for (std::int64_t begin = 0; begin < queries.codes.size(0); begin += rows) {
    const std::int64_t end = std::min(queries.codes.size(0), begin + rows);
    const Tensor table = code_distances(queries.codes.slice(0, begin, end), gallery.codes, distance).contiguous();
    at::parallel_for(begin, end, 1, [&](std::int64_t from, std::int64_t to) {
      std::vector<double> own, others;
      for (std::int64_t i = from; i < to; ++i) {
        const ViewId& query = queries.views[static_cast<std::size_t>(i)];
        if (!takes_part(query.coat)) continue;
        QueryMatch& match = out[static_cast<std::size_t>(i)];
        own.clear();
        others.clear();
        double least = std::numeric_limits<double>::infinity();
        const double* row = table.data_ptr<double>() + (i - begin) * table.size(1);
        for (std::size_t j = 0; j < gallery.views.size(); ++j) {
          const ViewId& candidate = gallery.views[j];
          if (!takes_part(candidate.coat) || (disjoint.frames && query.frame >= 0 && candidate.frame == query.frame) ||
              (disjoint.cameras && query.camera >= 0 && candidate.camera == query.camera))
            continue;
          if (row[j] < least) {
            least = row[j];
            match.nearest = static_cast<int>(j);
          }
          (query.coat >= 0 && candidate.coat == query.coat ? own : others).push_back(row[j]);
        }
        match.distance = least;
        match.has_match = !own.empty();
        if (own.empty()) continue;
        std::sort(own.begin(), own.end());
        std::sort(others.begin(), others.end());
        // Rows of other coats that come before the k-th of its own; equal distances: before.
        const auto before = [&](double d) {
          return std::upper_bound(others.begin(), others.end(), d) - others.begin();
        };
        match.others_before = static_cast<int>(before(own[0]));
        double sum = 0;
        for (std::size_t k = 0; k < own.size(); ++k) sum += (k + 1.0) / (k + 1.0 + static_cast<double>(before(own[k])));
        match.precision = sum / static_cast<double>(own.size());
      }
    });
  }
  return out;
}

Reidentification summarise(const std::vector<QueryMatch>& matches, const CodeSet& queries, int coat) {
  Reidentification r;
  double first = 0, fifth = 0, precision = 0;
  for (std::size_t i = 0; i < matches.size(); ++i) {
    const QueryMatch& m = matches[i];
    if (coat >= 0 && queries.views[i].coat != coat) continue;
    if (!m.has_match) {
      r.without_match += m.nearest >= 0;  // those of coats that take no part had nothing to be compared with
      continue;
    }
    ++r.queries;
    first += m.others_before < 1;
    fifth += m.others_before < 5;
    precision += m.precision;
  }
  const double count = r.queries > 0 ? r.queries : std::numeric_limits<double>::quiet_NaN();
  r.rank1 = first / count;
  r.rank5 = fifth / count;
  r.mean_precision = precision / count;
  return r;
}

IdentificationResult identify_codes(const CodeSet& queries, const CodeSet& gallery, CodeDistance distance) {
  IdentificationResult r;
  r.queries = queries.dataset;
  r.gallery = gallery.dataset;
  r.query_count = queries.codes.size(0);
  r.gallery_count = gallery.codes.size(0);
  r.distance = distance;
  r.disjoint = disjoint_of(queries, gallery);
  const std::vector<QueryMatch> matches = match_codes(queries, gallery, distance, r.disjoint);
  r.all = summarise(matches, queries);
  const CodeDistance other = distance == CodeDistance::cosine ? CodeDistance::euclidean : CodeDistance::cosine;
  r.other = summarise(match_codes(queries, gallery, other, r.disjoint), queries);
  std::map<int, std::string> names;
  for (const CodeSet* set : {&queries, &gallery})
    for (std::size_t i = 0; i < set->views.size(); ++i)
      if (set->views[i].coat >= 0) names[set->views[i].coat] = set->names[i];
  std::map<int, std::size_t> place;
  for (const auto& [coat, name] : names) {
    place[coat] = r.coats.size();
    r.coats.push_back(coat);
    r.names.push_back(name);
    r.per_coat.push_back(summarise(matches, queries, coat));
  }
  r.nearest.assign(r.coats.size(), std::vector<int>(r.coats.size(), 0));
  for (std::size_t i = 0; i < matches.size(); ++i) {
    const int coat = queries.views[i].coat;
    if (matches[i].nearest < 0 || coat < 0) continue;
    const int named = gallery.views[static_cast<std::size_t>(matches[i].nearest)].coat;
    if (named >= 0) ++r.nearest[place.at(coat)][place.at(named)];
  }
  const auto coat_named = [&](const std::string& wanted) {
    const auto found = std::find_if(names.begin(), names.end(), [&](const auto& entry) { return entry.second == wanted; });
    return found == names.end() ? -1 : found->first;
  };
  for (const auto& [first, second] : hard_pairs) {
    const int a = coat_named(first), b = coat_named(second);
    if (a < 0 || b < 0) continue;
    r.pairs.push_back({a, b, summarise(match_codes(queries, gallery, distance, r.disjoint, {a, b}), queries)});
  }
  return r;
}

namespace {

nlohmann::json to_json(const Reidentification& r) {
  return {{"queries", r.queries},
          {"without_match", r.without_match},
          {"rank1", number_json(r.rank1)},
          {"rank5", number_json(r.rank5)},
          {"map", number_json(r.mean_precision)}};
}

std::string rule_of(const Disjoint& d) {
  if (d.frames && d.cameras) return "gallery codes of the query's own pose or own camera are left out";
  return d.frames ? "gallery codes of the query's own pose are left out (the cameras are others anyway)"
                  : "nothing is left out of the gallery";
}

std::string cells(const Reidentification& r) {
  return fmt::format("{} | {} | {} | {}", figure_text(100 * r.rank1, 2), figure_text(100 * r.rank5, 2),
                     figure_text(100 * r.mean_precision, 2), r.queries);
}

}  // namespace

std::vector<Measure> measures_of(const IdentificationResult& r) {
  std::vector<Measure> out{
      {"rank-1", 100 * r.all.rank1, "%", {}, 95},
      {"rank-5", 100 * r.all.rank5, "%", {}, {}},
      {"mean average precision", 100 * r.all.mean_precision, "%", {}, {}},
      {fmt::format("rank-1 by {} distance",
                   name_of(r.distance == CodeDistance::cosine ? CodeDistance::euclidean : CodeDistance::cosine)),
       100 * r.other.rank1,
       "%",
       {},
       {}},
      {"queries", static_cast<double>(r.all.queries), "", {}, {}},
      {"queries without a match", static_cast<double>(r.all.without_match), "", {}, {}}};
  for (const IdentificationResult::Pair& p : r.pairs) {
    out.push_back({fmt::format("rank-1 within coats {} and {}", p.a, p.b), 100 * p.figures.rank1, "%", {}, 95});
    out.push_back({fmt::format("mean average precision within coats {} and {}", p.a, p.b),
                   100 * p.figures.mean_precision,
                   "%",
                   {},
                   {}});
  }
  for (std::size_t i = 0; i < r.coats.size(); ++i)
    out.push_back({fmt::format("rank-1 of coat {}", r.coats[i]), 100 * r.per_coat[i].rank1, "%", {}, {}});
  return out;
}

nlohmann::json to_json(const IdentificationResult& r) {
  nlohmann::json coats = nlohmann::json::array(), pairs = nlohmann::json::array();
  for (std::size_t i = 0; i < r.coats.size(); ++i) {
    nlohmann::json coat = to_json(r.per_coat[i]);
    coat["coat"] = r.coats[i];
    coat["name"] = r.names[i];
    coat["nearest_by_coat"] = r.nearest[i];
    coats.push_back(std::move(coat));
  }
  for (const IdentificationResult::Pair& p : r.pairs) {
    nlohmann::json pair = to_json(p.figures);
    pair["coats"] = {p.a, p.b};
    pairs.push_back(std::move(pair));
  }
  return {{"queries", r.queries},
          {"gallery", r.gallery},
          {"query_codes", r.query_count},
          {"gallery_codes", r.gallery_count},
          {"distance", name_of(r.distance)},
          {"calibration", r.calibration},
          {"left_out", {{"same_frame", r.disjoint.frames}, {"same_camera", r.disjoint.cameras}}},
          {"all", to_json(r.all)},
          {"by_other_distance", to_json(r.other)},
          {"pairs", pairs},
          {"coats", coats}};
}

std::string markdown(const IdentificationResult& r) {
  std::string out = fmt::format("# Identification\n\nQueries: {} codes of {}\n\nGallery: {} codes of {}\n\n", r.query_count,
                                r.queries, r.gallery_count, r.gallery);
  if (!r.calibration.empty())
    out += fmt::format("Scatter of a coat's codes made alike in every direction, as learnt from {}\n\n", r.calibration);
  out += fmt::format(
      "Nearest code by {} distance; {}. Equal distances count against the query. Shares in percent.\n\n"
      "| queries | rank-1 | rank-5 | mAP | number |\n|---|---|---|---|---|\n",
      name_of(r.distance), rule_of(r.disjoint));
  out += fmt::format("| all | {} |\n", cells(r.all));
  for (const IdentificationResult::Pair& p : r.pairs)
    out += fmt::format("| within coats {} and {} | {} |\n", p.a, p.b, cells(p.figures));
  for (std::size_t i = 0; i < r.coats.size(); ++i)
    out += fmt::format("| {} {} | {} |\n", r.coats[i], r.names[i], cells(r.per_coat[i]));
  out += fmt::format("| all, {} distance | {} |\n",
                     name_of(r.distance == CodeDistance::cosine ? CodeDistance::euclidean : CodeDistance::cosine),
                     cells(r.other));
  if (r.all.without_match > 0)
    out += fmt::format("\n{} queries had no code of their own coat to find and are left out.\n", r.all.without_match);
  out +=
      "\nThe paper shows a t-SNE of its codes, in which novel views fall into the right cluster; it gives no rank or "
      "mAP to compare with.\n";
  return out;
}

void write_identification(const IdentificationResult& result, const std::filesystem::path& folder) {
  write_file_atomically(folder / "results.json", dump_json(to_json(result)));
  write_file_atomically(folder / "summary.json", summary_json("Identification", measures_of(result)));
  write_file_atomically(folder / "table.md", markdown(result));
}

}  // namespace moomill
