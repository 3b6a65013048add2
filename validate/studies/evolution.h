#pragma once
// Minimising a function of a few dozen numbers that has steps and no gradient.
#include <cstdint>
#include <functional>
#include <vector>

namespace moomill {

struct EvolutionOptions {
  int population = 16;    // points tried per generation
  int generations = 100;
  double step = 0.5;      // standard deviation of the first generation, the same in all numbers
  std::uint64_t seed = 0;
};

// MA-ES: an evolution strategy that learns the covariance of good steps without factoring matrices (Beyer and Sendhoff,
// Simplify Your Covariance Matrix Adaptation Evolution Strategy, IEEE TEVC 2017, with its default parameters). Returns
// the best point tried; the start is one of them. The points of a generation are tried in parallel; the result does not
// depend on the number of threads.
std::vector<double> minimise(const std::function<double(const std::vector<double>&)>& f, std::vector<double> start,
                             const EvolutionOptions& options);

// Coordinate search: tries each number a step up and a step down, keeps what is better, lengthens steps that helped and
// halves those that did not, until all are below `smallest` or `tries` calls of f are spent. Mends what an evolution
// leaves over in numbers that matter little. Never worse than the start.
std::vector<double> pattern_search(const std::function<double(const std::vector<double>&)>& f, std::vector<double> start,
                                   double step, double smallest, int tries);

}  // namespace moomill
