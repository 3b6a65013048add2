#include "rigs/warp.h"

#include <cmath>

namespace moomill {

dvec3 Warp::apply(const dvec3& p) const {
  dvec3 q = linear * p + shift;
  for (std::size_t i = 0; i < centres.size(); ++i) q += glm::length(p - centres[i]) * weights[i];
  return q;
}

bool fit_warp(const std::vector<dvec3>& from, const std::vector<dvec3>& to, Warp& warp) {
  const std::size_t n = from.size(), m = n + 4;
  // [K P; P' 0] [w; a] = [to; 0], solved by elimination with pivoting.
  std::vector<std::vector<double>> a(m, std::vector<double>(m + 3, 0.0));
  Box reach;
  for (const dvec3& p : from) reach.add(p);
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t j = 0; j < n; ++j) a[i][j] = glm::length(from[i] - from[j]);
    a[i][n] = a[n][i] = 1;
    for (int k = 0; k < 3; ++k) a[i][n + 1 + k] = a[n + 1 + k][i] = from[i][k], a[i][m + k] = to[i][k];
  }
  for (std::size_t c = 0; c < m; ++c) {
    std::size_t pivot = c;
    for (std::size_t r = c; r < m; ++r)
      if (std::abs(a[r][c]) > std::abs(a[pivot][c])) pivot = r;
    if (!(std::abs(a[pivot][c]) > 1e-9 * std::max(1.0, reach.diagonal()))) return false;
    std::swap(a[c], a[pivot]);
    for (std::size_t r = 0; r < m; ++r) {
      if (r == c || a[r][c] == 0) continue;
      const double f = a[r][c] / a[c][c];
      for (std::size_t k = c; k < m + 3; ++k) a[r][k] -= f * a[c][k];
    }
  }
  const auto solution = [&](std::size_t i) {
    return dvec3(a[i][m], a[i][m + 1], a[i][m + 2]) / a[i][i];
  };
  warp.centres = from;
  warp.weights.clear();
  for (std::size_t i = 0; i < n; ++i) warp.weights.push_back(solution(i));
  warp.shift = solution(n);
  for (int k = 0; k < 3; ++k) warp.linear[k] = solution(n + 1 + k);
  return true;
}

}  // namespace moomill
