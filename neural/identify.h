#pragma once
// Who is it: nearest codes of a gallery, and how well that tells individuals apart.
#include <torch/torch.h>

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "neural/codes.h"
#include "neural/report.h"

namespace moomill {

enum class CodeDistance { cosine, euclidean };
const char* name_of(CodeDistance distance);

// [Q, z], [G, z] to [Q, G], double. Cosine: 1 - cos; a code of length zero is at distance 1 from all.
torch::Tensor code_distances(const torch::Tensor& queries, const torch::Tensor& gallery, CodeDistance distance);

// Within-class covariance normalisation (Hatch, Kajarekar and Stolcke 2006): the map [z, z], double, after which codes of one coat
// (rows times the map) scatter alike in every direction, learnt from codes whose coats are known. A thousandth of the mean variance
// is added to each, so that a code's idle directions are not blown up. InputError where no coat has two codes.
torch::Tensor scatter_normalisation(const CodeSet& known);
CodeSet mapped(CodeSet set, const torch::Tensor& map);

// Which gallery codes a query may not be compared with: those of its own pose, those of its own camera. Unknown (-1) is
// nobody's.
struct Disjoint {
  bool frames = true, cameras = true;
};
// Frames always; cameras where both sets number the same cameras (those of novel views are others in any case).
Disjoint disjoint_of(const CodeSet& queries, const CodeSet& gallery);

// A query against what it may be compared with. Equal distances count against the query: others come before its own
// kind, so that codes that are all alike identify nobody.
struct QueryMatch {
  int nearest = -1;        // gallery row, the first of the nearest; -1: nothing to compare with
  double distance = 0;     // to it
  int others_before = 0;   // gallery rows of other coats no further than the nearest one of its own coat
  double precision = 0;    // average precision over the rows of its own coat
  bool has_match = false;  // there is a row of its own coat
};
// coats: those that take part, on both sides; empty: all. Queries of other coats get nearest = -1.
std::vector<QueryMatch> match_codes(const CodeSet& queries, const CodeSet& gallery, CodeDistance distance,
                                    const Disjoint& disjoint, const std::vector<int>& coats = {});

struct Reidentification {
  int queries = 0;                                  // with a match to find
  int without_match = 0;                            // left out
  double rank1 = 0, rank5 = 0, mean_precision = 0;  // shares; NaN without queries
};
// coat: of its queries alone; -1: of all.
Reidentification summarise(const std::vector<QueryMatch>& matches, const CodeSet& queries, int coat = -1);

// The cow's coats that look alike by eye, by name: numbers mean other animals in other datasets.
inline constexpr std::pair<const char*, const char*> hard_pairs[] = {{"09_grey", "10_white"}, {"01_brown_spotted", "11_limousin"}};

struct IdentificationResult {
  std::string queries, gallery;  // as described by the sets
  std::string calibration;       // of the codes that normalised the scatter; empty: none did
  std::int64_t query_count = 0, gallery_count = 0;
  CodeDistance distance = CodeDistance::euclidean;
  Disjoint disjoint;
  Reidentification all, other;  // other: by the other distance
  std::vector<int> coats;
  std::vector<std::string> names;
  std::vector<Reidentification> per_coat;  // parallel to coats
  struct Pair {
    int a, b;
    Reidentification figures;
  };
  std::vector<Pair> pairs;                // gallery and queries of these two coats only; those that there are
  std::vector<std::vector<int>> nearest;  // [coats][coats]: queries of a coat by the coat of their nearest code
};
IdentificationResult identify_codes(const CodeSet& queries, const CodeSet& gallery, CodeDistance distance);

std::vector<Measure> measures_of(const IdentificationResult& result);
nlohmann::json to_json(const IdentificationResult& result);
std::string markdown(const IdentificationResult& result);
void write_identification(const IdentificationResult& result, const std::filesystem::path& folder);

}  // namespace moomill
