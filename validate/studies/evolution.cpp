#include "validate/studies/evolution.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "generator/core/random.h"

namespace moomill {

std::vector<double> minimise(const std::function<double(const std::vector<double>&)>& f, std::vector<double> start,
                             const EvolutionOptions& o) {
  const std::size_t n = start.size();
  check(n > 0 && o.population >= 4, "nothing to minimise over");
  const auto lambda = static_cast<std::size_t>(o.population), mu = lambda / 2;
  std::vector<double> weights(mu);
  for (std::size_t i = 0; i < mu; ++i) weights[i] = std::log((lambda + 1) / 2.0) - std::log(i + 1.0);
  const double sum = std::accumulate(weights.begin(), weights.end(), 0.0);
  double squares = 0;
  for (double& w : weights) w /= sum, squares += w * w;
  const double mu_effective = 1 / squares, dim = static_cast<double>(n);
  const double c_step = (mu_effective + 2) / (dim + mu_effective + 5);
  const double c_one = 2 / ((dim + 1.3) * (dim + 1.3) + mu_effective);
  const double c_mu = std::min(1 - c_one, 2 * (mu_effective - 2 + 1 / mu_effective) / ((dim + 2) * (dim + 2) + mu_effective));
  const double damping = 1 + c_step + 2 * std::max(0.0, std::sqrt((mu_effective - 1) / (dim + 1)) - 1);
  const double expected_norm = std::sqrt(dim) * (1 - 1 / (4 * dim) + 1 / (21 * dim * dim));

  std::vector<double> mean = start, path(n, 0.0), best = start, matrix(n * n, 0.0);
  for (std::size_t i = 0; i < n; ++i) matrix[i * n + i] = 1;
  double best_value = f(start), step = o.step;
  std::vector<std::vector<double>> z(lambda, std::vector<double>(n)), d = z, x = z;
  std::vector<double> values(lambda);
  std::vector<std::size_t> order(lambda);
  for (int g = 0; g < o.generations; ++g) {
    parallel_for(lambda, 1, [&](std::size_t k) {
      for (std::size_t i = 0; i < n; ++i)
        z[k][i] = to_normal(hash_identity({o.seed, static_cast<std::uint64_t>(g), k, i}));
      for (std::size_t i = 0; i < n; ++i) {
        d[k][i] = 0;
        for (std::size_t j = 0; j < n; ++j) d[k][i] += matrix[i * n + j] * z[k][j];
        x[k][i] = mean[i] + step * d[k][i];
      }
      values[k] = f(x[k]);
    });
    std::iota(order.begin(), order.end(), 0u);
    std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return values[a] < values[b]; });
    if (values[order[0]] < best_value) best_value = values[order[0]], best = x[order[0]];
    std::vector<double> mean_z(n, 0.0);
    for (std::size_t i = 0; i < mu; ++i)
      for (std::size_t j = 0; j < n; ++j) {
        mean_z[j] += weights[i] * z[order[i]][j];
        mean[j] += step * weights[i] * d[order[i]][j];
      }
    double norm2 = 0;
    for (std::size_t j = 0; j < n; ++j) {
      path[j] = (1 - c_step) * path[j] + std::sqrt(mu_effective * c_step * (2 - c_step)) * mean_z[j];
      norm2 += path[j] * path[j];
    }
    // matrix *= 1 + c_one / 2 (path path' - 1) + c_mu / 2 (sum of w z z' - 1)
    std::vector<double> change(n * n, 0.0), product(n * n, 0.0);
    for (std::size_t i = 0; i < n; ++i)
      for (std::size_t j = 0; j < n; ++j) {
        double covariance = 0;
        for (std::size_t k = 0; k < mu; ++k) covariance += weights[k] * z[order[k]][i] * z[order[k]][j];
        change[i * n + j] = 0.5 * (c_one * path[i] * path[j] + c_mu * covariance);
        if (i == j) change[i * n + j] += 1 - 0.5 * (c_one + c_mu);
      }
    for (std::size_t i = 0; i < n; ++i)
      for (std::size_t k = 0; k < n; ++k)
        for (std::size_t j = 0; j < n; ++j) product[i * n + j] += matrix[i * n + k] * change[k * n + j];
    matrix = product;
    step *= std::exp(c_step / damping * (std::sqrt(norm2) / expected_norm - 1));
  }
  if (f(mean) < best_value) return mean;
  return best;
}

std::vector<double> pattern_search(const std::function<double(const std::vector<double>&)>& f, std::vector<double> start,
                                   double step, double smallest, int tries) {
  std::vector<double> x = std::move(start), steps(x.size(), step);
  double value = f(x);
  for (int tried = 1; tried < tries;) {
    bool any = false;
    for (std::size_t i = 0; i < x.size() && tried < tries; ++i) {
      if (std::abs(steps[i]) < smallest) continue;
      any = true;
      bool better = false;
      for (int side = 0; side < 2 && !better && tried < tries; ++side, ++tried) {
        const double before = x[i];
        x[i] += steps[i];
        if (const double now = f(x); now < value) {
          value = now, better = true;
        } else {
          x[i] = before, steps[i] = -steps[i];  // the other way, now and next time
        }
      }
      steps[i] *= better ? 1.5 : 0.5;
    }
    if (!any) break;
  }
  return x;
}

}  // namespace moomill
