// What the measurements of convergence say: slopes, equal error, table, plots.
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <set>
#include <tuple>

#include "generator/core/curves.h"
#include "generator/core/error.h"
#include "validate/studies/converge.h"

namespace moomill {
namespace {

using ViewKey = std::pair<int, int>;              // frame, camera
using PictureKey = std::tuple<int, int, int>;     // frame, camera, coat

PictureKey key_of(const ConvergenceRow& r) { return {r.frame, r.camera, r.coat}; }

std::set<PictureKey> pictures_of(const std::vector<ConvergenceRow>& rows) {
  std::set<PictureKey> keys;
  for (const ConvergenceRow& r : rows) keys.insert(key_of(r));
  return keys;
}

// All coats of a view together: times added, errors averaged; ascending in samples.
struct Pooled {
  int samples = 0, coats = 0;
  double seconds = 0, core_seconds = 0;
  PictureError error;
};
using Curves = std::map<std::pair<ViewKey, int>, std::vector<Pooled>>;  // per view and repetition

Curves pool(const std::vector<ConvergenceRow>& rows, const std::set<PictureKey>& wanted) {
  std::map<std::pair<PictureKey, int>, int> seen;
  std::map<std::pair<ViewKey, int>, std::map<int, Pooled>> sums;
  for (const ConvergenceRow& r : rows) {
    if (!wanted.count(key_of(r))) continue;
    const int repetition = seen[{key_of(r), r.samples}]++;
    Pooled& p = sums[{{r.frame, r.camera}, repetition}][r.samples];
    p.samples = r.samples;
    ++p.coats;
    p.seconds += r.seconds;
    p.core_seconds += r.core_seconds;
    p.error.mse += r.error.mse;
    p.error.relative_mse += r.error.relative_mse;
    p.error.ciede2000 += r.error.ciede2000;
  }
  Curves curves;
  for (auto& [key, by_samples] : sums)
    for (auto& [samples, p] : by_samples) {
      p.error.mse /= p.coats;
      p.error.relative_mse /= p.coats;
      p.error.ciede2000 /= p.coats;
      curves[key].push_back(p);
    }
  return curves;
}

double value_of(const PictureError& e, Measure m) {
  return m == Measure::mse ? e.mse : m == Measure::relative_mse ? e.relative_mse : e.ciede2000;
}
double time_of(const Pooled& p, bool core_seconds) { return core_seconds ? p.core_seconds : p.seconds; }

struct MeasureName {
  Measure measure;
  const char* name;
};
constexpr MeasureName measures[] = {{Measure::mse, "MSE"}, {Measure::relative_mse, "relative MSE"}, {Measure::ciede2000, "CIEDE2000"}};

// One curve per number of samples: the mean over views of the median over repetitions.
struct MeanPoint {
  int samples = 0;
  double seconds = 0, core_seconds = 0;
  PictureError error;
};
std::vector<MeanPoint> mean_curve(const Curves& curves) {
  std::map<int, std::map<ViewKey, std::vector<const Pooled*>>> by_samples;
  for (const auto& [key, curve] : curves)
    for (const Pooled& p : curve) by_samples[p.samples][key.first].push_back(&p);
  std::vector<MeanPoint> out;
  for (const auto& [samples, views] : by_samples) {
    const auto mean = [&](const auto& get) {
      double sum = 0;
      for (const auto& [view, points] : views) {
        std::vector<double> values;
        for (const Pooled* p : points) values.push_back(get(*p));
        sum += median(std::move(values));
      }
      return sum / static_cast<double>(views.size());
    };
    out.push_back({samples, mean([](const Pooled& p) { return p.seconds; }), mean([](const Pooled& p) { return p.core_seconds; }),
                   {mean([](const Pooled& p) { return p.error.mse; }), mean([](const Pooled& p) { return p.error.relative_mse; }),
                    mean([](const Pooled& p) { return p.error.ciede2000; })}});
  }
  return out;
}

// Slope over all points of the curves, whose errors are first averaged over the views of a repetition, so that one point
// is one independent experiment.
PowerLaw slope_of(const Curves& curves) {
  std::map<std::pair<int, int>, std::pair<double, int>> sums;  // repetition, samples
  for (const auto& [key, curve] : curves)
    for (const Pooled& p : curve) {
      auto& [sum, count] = sums[{key.second, p.samples}];
      sum += p.error.mse;
      ++count;
    }
  std::vector<double> samples, errors;
  for (const auto& [key, sum] : sums) {
    samples.push_back(key.second);
    errors.push_back(sum.first / sum.second);
  }
  return fit_power_law(samples, errors);
}

std::set<PictureKey> common_pictures(const std::set<PictureKey>& a, const std::set<PictureKey>& b) {
  std::set<PictureKey> both;
  std::set_intersection(a.begin(), a.end(), b.begin(), b.end(), std::inserter(both, both.end()));
  if (both.empty()) {
    const auto say = [](const std::set<PictureKey>& s) {
      const auto [f, c, t] = *s.begin();
      return fmt::format("frame {}, camera {}, coat {}{}", f, c, t, s.size() > 1 ? " and others" : "");
    };
    input_error("--against: no picture was measured in both runs ({} here, {} there); choose the same --frames, --cameras and --coats",
                a.empty() ? "none" : say(a), b.empty() ? "none" : say(b));
  }
  return both;
}

}  // namespace

void require_common_pictures(const SceneSpec& scene, const Against& against) {
  std::set<PictureKey> wanted;
  for (const int frame : scene.frames)
    for (const CameraRecord& camera : cameras_of_frame(scene, frame))
      for (const int coat : scene.coat_indices) wanted.insert({frame, camera.id, coat});
  const std::set<PictureKey> both = common_pictures(wanted, pictures_of(against.rows));
  for (const ConvergenceRow& r : against.rows)
    if (r.samples == against.samples && both.count(key_of(r))) return;
  input_error("--at-spp: the other run was not measured at {} samples; choose a number of its column spp", against.samples);
}

SpeedUp speed_up(const std::vector<ConvergenceRow>& own, const std::vector<ConvergenceRow>& other, int samples, Measure measure,
                 bool core_seconds) {
  const std::set<PictureKey> both = common_pictures(pictures_of(own), pictures_of(other));
  const Curves mine = pool(own, both), theirs = pool(other, both);
  SpeedUp out;
  bool measured = false;
  for (const auto& [key, curve] : theirs) {
    const auto point = std::find_if(curve.begin(), curve.end(), [&](const Pooled& p) { return p.samples == samples; });
    if (point == curve.end()) continue;
    measured = true;
    for (const auto& [own_key, own_curve] : mine) {
      if (own_key.first != key.first) continue;
      std::vector<TimedError> timed;
      for (const Pooled& p : own_curve) timed.push_back({time_of(p, core_seconds), value_of(p.error, measure)});
      const auto seconds = time_for_error(timed, value_of(point->error, measure));
      if (seconds && *seconds > 0)
        out.ratios.push_back(time_of(*point, core_seconds) / *seconds);
      else
        ++out.outside;
    }
  }
  if (!measured) input_error("--at-spp: the other run was not measured at {} samples; choose a number of its column spp", samples);
  return out;
}

StudyResult convergence_study(const std::string& title, const Convergence& measured, double slope_at_most,
                              const std::optional<Against>& against) {
  const std::set<PictureKey> all = pictures_of(measured.rows);
  const Curves curves = pool(measured.rows, all);
  StudyResult result;
  result.title = title;
  std::string& t = result.table;

  // The smallest error a reference must resolve is that of the largest sample count.
  double worst_reference = 0, smallest_reference = std::numeric_limits<double>::infinity();
  for (const ReferenceError& r : measured.references) {
    double least = std::numeric_limits<double>::infinity();
    for (const auto& [key, curve] : pool(measured.rows, {{r.frame, r.camera, r.coat}}))
      for (const Pooled& p : curve) least = std::min(least, p.error.mse);
    worst_reference = std::max(worst_reference, r.mse / least);
    smallest_reference = std::min(smallest_reference, static_cast<double>(r.samples));
  }
  result.figures.push_back({"MSE of a reference over the smallest MSE measured against it", worst_reference, "", 0.1, {}});
  result.figures.push_back({"samples of a reference", smallest_reference, "per pixel", {}, {}});

  t += fmt::format("# {}\n\n", title);
  t += fmt::format(
      "Errors are inside the silhouette, against references of {:.0f} samples a pixel with seeds of their own, whose own MSE (a quarter of the\n"
      "mean squared difference of two independent halves) is at most {:.3g} of the smallest MSE measured against them. Relative MSE:\n"
      "mean of (x - r)^2 / (r^2 + {}), linear Rec. 709. Means over {} pictures of the median over repetitions; seconds are of one view in\n"
      "all coats measured, tracing and its share of preparing the frame, without encoding.\n\n",
      smallest_reference, worst_reference, relative_epsilon, all.size());
  t += "| samples | MSE | relative MSE | CIEDE2000 | seconds | core seconds |\n|---|---|---|---|---|---|\n";
  for (const MeanPoint& p : mean_curve(curves))
    t += fmt::format("| {} | {:.4g} | {:.4g} | {:.3f} | {:.4g} | {:.4g} |\n", p.samples, p.error.mse, p.error.relative_mse, p.error.ciede2000,
                     p.seconds, p.core_seconds);

  const PowerLaw slope = slope_of(curves);
  std::set<int> sample_counts;
  for (const ConvergenceRow& r : measured.rows) sample_counts.insert(r.samples);
  const bool fitted = sample_counts.size() >= 3;
  result.figures.push_back({"slope of MSE against samples", slope.slope, "", fitted ? std::optional(slope_at_most) : std::nullopt, {}});
  result.figures.push_back({"slope, lower end of its 95 % interval", slope.low, "", {}, {}});
  result.figures.push_back({"slope, upper end of its 95 % interval", slope.high, "", {}, {}});
  t += "\n| MSE against samples | slope | 95 % interval | MSE of the reference |\n|---|---|---|---|\n";
  t += fmt::format("| pooled | {:.3f} | {:.3f} to {:.3f} | |\n", slope.slope, slope.low, slope.high);
  for (const ReferenceError& r : measured.references) {
    const PowerLaw s = slope_of(pool(measured.rows, {{r.frame, r.camera, r.coat}}));
    t += fmt::format("| frame {}, camera {}, coat {} | {:.3f} | {:.3f} to {:.3f} | {:.3g} |\n", r.frame, r.camera, r.coat, s.slope, s.low, s.high,
                     r.mse);
  }

  if (against) {
    const std::string name = against->rows.front().renderer;
    t += fmt::format("\n| to the error of {} at {} samples | time there over time here: median | least | greatest | pairs | out of reach |\n"
                     "|---|---|---|---|---|---|\n", name, against->samples);
    for (const MeasureName& m : measures)
      for (const bool core : {false, true}) {
        const SpeedUp s = speed_up(measured.rows, against->rows, against->samples, m.measure, core);
        const auto bounds = std::minmax_element(s.ratios.begin(), s.ratios.end());
        const double nan = std::numeric_limits<double>::quiet_NaN();
        const double least = s.ratios.empty() ? nan : *bounds.first, greatest = s.ratios.empty() ? nan : *bounds.second;
        const char* unit = core ? "core seconds" : "seconds";
        t += fmt::format("| {}, {} | {:.3g} | {:.3g} | {:.3g} | {} | {} |\n", m.name, unit, median(s.ratios), least, greatest, s.ratios.size(), s.outside);
        const std::string figure = fmt::format("speed-up over {} at equal {}, {}", name, m.name, unit);
        result.figures.push_back({figure + ": median", median(s.ratios), "", {}, {}});
        result.figures.push_back({figure + ": least", least, "", {}, {}});
        result.figures.push_back({figure + ": greatest", greatest, "", {}, {}});
      }
  }
  return result;
}

std::vector<std::pair<std::string, std::string>> convergence_plots(const Convergence& measured, const std::optional<Against>& against) {
  const std::set<PictureKey> all = pictures_of(measured.rows);
  struct Named {
    std::string name;
    std::vector<MeanPoint> points;
  };
  // Of the same pictures, where there is another renderer: or the curves would not be comparable.
  const std::set<PictureKey> shown = against ? common_pictures(pictures_of(measured.rows), pictures_of(against->rows)) : all;
  std::vector<Named> timed{{"moomill", mean_curve(pool(measured.rows, shown))}};
  if (against) timed.push_back({against->rows.front().renderer, mean_curve(pool(against->rows, shown))});
  std::vector<Named> by_coat{{"all coats", mean_curve(pool(measured.rows, all))}};
  std::set<int> coats;
  for (const PictureKey& k : all) coats.insert(std::get<2>(k));
  if (coats.size() > 1)
    for (const int coat : coats) {
      if (by_coat.size() == 4) break;  // more lines than that cannot be told apart
      std::set<PictureKey> of_coat;
      for (const PictureKey& k : all)
        if (std::get<2>(k) == coat) of_coat.insert(k);
      by_coat.push_back({fmt::format("coat {}", coat), mean_curve(pool(measured.rows, of_coat))});
    }

  const auto draw = [&](const std::string& title, const std::string& x_title, const std::vector<Named>& named, const auto& x, bool guide) {
    std::vector<Panel> panels;
    for (const MeasureName& m : measures) {
      Panel panel;
      panel.title = m.name;
      for (const Named& n : named) {
        Curve curve{n.name, {}, {}};
        for (const MeanPoint& p : n.points) {
          curve.x.push_back(x(p));
          curve.y.push_back(value_of(p.error, m.measure));
        }
        panel.curves.push_back(std::move(curve));
      }
      if (guide && m.measure != Measure::ciede2000 && !panel.curves[0].x.empty()) {
        const Curve& c = panel.curves[0];
        panel.curves.push_back({"slope -1", {c.x.front(), c.x.back()}, {c.y.front(), c.y.front() * c.x.front() / c.x.back()}, true});
      }
      panels.push_back(std::move(panel));
    }
    return draw_curves(title, x_title, panels, true);
  };
  std::set<int> coats_shown;
  for (const PictureKey& k : shown) coats_shown.insert(std::get<2>(k));
  const std::string of_a_view = fmt::format("seconds of a view in {} coat{}{}", coats_shown.size(), coats_shown.size() > 1 ? "s" : "",
                                            coats_shown.size() < coats.size() ? fmt::format(" (ours: their share of {} made together)", coats.size()) : "");
  return {{"error_samples.svg", draw("Error against samples", "samples per pixel", by_coat, [](const MeanPoint& p) { return double(p.samples); }, true)},
          {"error_seconds.svg", draw("Error against run time", of_a_view, timed, [](const MeanPoint& p) { return p.seconds; }, false)},
          {"error_core_seconds.svg", draw("Error against processor time", "core " + of_a_view, timed, [](const MeanPoint& p) { return p.core_seconds; }, false)}};
}

}  // namespace moomill
