#include "neural/training_loop.h"

#include <chrono>
#include <numbers>

#include "generator/core/curves.h"
#include "generator/core/error.h"
#include "generator/core/random.h"
#include "generator/dataset/codecs.h"
#include "neural/adamw.h"

namespace moomill {
namespace {

using Clock = std::chrono::steady_clock;
namespace fs = std::filesystem;

double seconds_since(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

// Where a run is. Everything but the weights and the optimiser's moments.
struct Position {
  int epoch = 0, batch = 0;  // of the next step
  std::int64_t step = 0;
  double seconds = 0;        // of training and validation so far, over all calls
  double best = std::numeric_limits<double>::infinity();
  double first_loss = 0;     // of the run, to notice a diverging one
  std::vector<double> sums;  // of the loss terms since the last validation
  std::int64_t summed = 0;   // steps in it
  nlohmann::json rows = nlohmann::json::array();  // of scalars.csv
};

// How many times its first value the loss may become before the run counts as diverging.
constexpr double divergence_factor = 1e4;

std::string moment_name(std::size_t i, const char* what) {
  return fmt::format("optimiser.{:04}.{}", i, what);
}

std::vector<torch::Tensor> all_parameters(const Stage& stage) {
  std::vector<torch::Tensor> all;
  for (const auto& group : stage.groups) all.insert(all.end(), group.begin(), group.end());
  return all;
}

// Scales the gradients of a group down to a norm of at most `most` (0: leaves them) and returns the norm they had. Sums in one order,
// whatever the number of threads.
double clip_gradients(const std::vector<torch::Tensor>& group, double most) {
  torch::NoGradGuard fixed;
  double square = 0;
  for (const torch::Tensor& p : group) {
    if (!p.grad().defined()) continue;
    const torch::Tensor g = p.grad().cpu().contiguous();
    const float* v = g.data_ptr<float>();
    for (std::int64_t from = 0; from < g.numel(); from += 4096) {  // lanes of partial sums, so that the compiler may vectorise
      const std::int64_t to = std::min(g.numel(), from + 4096);
      double lanes[8] = {};
      std::int64_t i = from;
      for (; i + 8 <= to; i += 8)
        for (int k = 0; k < 8; ++k) lanes[k] += double(v[i + k]) * double(v[i + k]);
      for (; i < to; ++i) lanes[0] += double(v[i]) * double(v[i]);
      for (const double lane : lanes) square += lane;
    }
  }
  const double norm = std::sqrt(square);
  if (most > 0 && norm > most)
    for (const torch::Tensor& p : group)
      if (p.grad().defined()) p.grad().mul_(most / norm);
  return norm;
}

// The optimiser keys its state by the address of a parameter.
torch::optim::AdamWParamState* state_of(torch::optim::AdamW& optimiser, const torch::Tensor& parameter) {
  const auto found = optimiser.state().find(c10::guts::to_string(parameter.unsafeGetTensorImpl()));
  return found == optimiser.state().end() ? nullptr : static_cast<torch::optim::AdamWParamState*>(found->second.get());
}

void save_state(const fs::path& file, const NetepuConfig& config, const Stage& stage, const std::string& dataset,
                torch::optim::AdamW& optimiser, const Position& at) {
  TensorFile contents;
  contents.header = {{"kind", "state"},        {"stage", stage.name},     {"config", to_json(config)},  {"epoch", at.epoch},
                     {"batch", at.batch},      {"step", at.step},         {"seconds", at.seconds},      {"first_loss", at.first_loss},
                     {"sums", at.sums},        {"summed", at.summed},     {"rows", at.rows},           {"dataset", dataset},
                     {"base", stage.base}};
  if (std::isfinite(at.best)) contents.header["best"] = at.best;
  store_module(*stage.module, "weights.", false, contents.tensors);
  const std::vector<torch::Tensor> parameters = all_parameters(stage);
  for (std::size_t i = 0; i < parameters.size(); ++i)
    if (const auto* s = state_of(optimiser, parameters[i])) {
      contents.tensors[moment_name(i, "mean")] = s->exp_avg();
      contents.tensors[moment_name(i, "square")] = s->exp_avg_sq();
      contents.tensors[moment_name(i, "step")] = torch::tensor(s->step(), torch::kLong);
    }
  write_tensor_file(file, contents);
}

// The first key that two configurations differ in, as "texture.rate"; empty when they agree on what the stage needs. The number
// of epochs may differ: a run can be prolonged.
std::string difference(const nlohmann::json& a, const nlohmann::json& b, const std::vector<std::string>& sections) {
  for (const std::string& section : sections) {
    if (!a.contains(section)) return section;
    if (a.at(section) == b.at(section)) continue;
    if (!b.at(section).is_object()) return section;
    for (const auto& [key, value] : b.at(section).items())
      if (key != "epochs" && (!a.at(section).contains(key) || a.at(section).at(key) != value)) return section + "." + key;
  }
  return {};
}

Position load_state(const fs::path& file, const NetepuConfig& config, const Stage& stage, const std::string& dataset,
                    torch::optim::AdamW& optimiser) {
  TensorFile contents = read_tensor_file(file);
  Position at;
  try {
    const nlohmann::json& h = contents.header;
    if (h.at("kind") != "state" || h.at("stage") != stage.name)
      input_error("{}: is not a training state of the {}; name another folder with -o", file.string(), stage.name);
    if (const std::string key = difference(h.at("config"), to_json(config), {"seed", "model", stage.name}); !key.empty())
      input_error("{}: was trained with another '{}'; use that configuration again, or name another folder with -o", file.string(),
                  key);
    if (h.at("dataset") != dataset)
      input_error("{}: was trained on another dataset ({}); give that one again, or name another folder with -o", file.string(),
                  h.at("dataset").get<std::string>());
    if (h.at("base") != stage.base)
      input_error("{}: was trained on another geometry model; give that one again, or name another folder with -o", file.string());
    at.epoch = h.at("epoch"), at.batch = h.at("batch"), at.step = h.at("step"), at.seconds = h.at("seconds");
    at.first_loss = h.at("first_loss"), at.sums = h.at("sums").get<std::vector<double>>(), at.summed = h.at("summed");
    at.rows = h.at("rows");
    if (h.contains("best")) at.best = h.at("best");
  } catch (const nlohmann::json::exception&) {
    input_error("{}: its header is not that of a training state; remove the folder to start anew", file.string());
  }
  std::map<std::string, torch::Tensor> weights;
  for (const auto& [name, tensor] : contents.tensors)
    if (name.starts_with("weights.")) weights[name] = tensor;
  restore_module(*stage.module, "weights.", weights, file.string());
  const std::vector<torch::Tensor> parameters = all_parameters(stage);
  for (std::size_t i = 0; i < parameters.size(); ++i) {
    if (!contents.tensors.contains(moment_name(i, "step"))) continue;
    auto s = std::make_unique<torch::optim::AdamWParamState>();
    s->exp_avg(contents.tensors[moment_name(i, "mean")].to(parameters[i].device()));
    s->exp_avg_sq(contents.tensors[moment_name(i, "square")].to(parameters[i].device()));
    s->step(contents.tensors[moment_name(i, "step")].item<std::int64_t>());
    optimiser.state()[c10::guts::to_string(parameters[i].unsafeGetTensorImpl())] = std::move(s);
  }
  return at;
}

// scalars.csv and the two pictures.
void write_history(const fs::path& out, const Stage& stage, const nlohmann::json& rows) {
  if (rows.empty()) return;
  std::vector<std::string> names;
  for (const nlohmann::json& pair : rows.front()) names.push_back(pair.at(0));
  std::string csv;
  for (const std::string& name : names) csv += (csv.empty() ? "" : ",") + name;
  csv += "\n";
  std::map<std::string, std::vector<double>> columns;
  for (const nlohmann::json& row : rows) {
    std::string line;
    for (const nlohmann::json& pair : row) {
      const double v = pair.at(1).is_null() ? NAN : pair.at(1).get<double>();
      columns[pair.at(0)].push_back(v);
      line += (line.empty() ? "" : ",") + fmt::format("{:.7g}", v);
    }
    csv += line + "\n";
  }
  write_file_atomically(out / "scalars.csv", csv);
  const auto panels = [&](const std::string& x, const std::string& prefix) {
    std::vector<Panel> all;
    for (const std::string& name : names)
      if (name.starts_with(prefix)) all.push_back({name.substr(prefix.size()), {{"", columns[x], columns[name]}}, 0, ""});
    return all;
  };
  std::vector<double> minutes = columns["seconds"];
  for (double& m : minutes) m /= 60;
  columns["minutes"] = minutes;
  write_file_atomically(out / "curves.svg", draw_curves(stage.name + ": weighted terms of the training loss", "epoch", panels("epoch", "train: ")));
  write_file_atomically(out / "error.svg", draw_curves(stage.name + ": validation against run time", "minutes", panels("minutes", "validate: ")));
}

std::string clock_text(double seconds) {
  const auto s = static_cast<long long>(seconds + 0.5);
  return s >= 3600 ? fmt::format("{}:{:02}:{:02}", s / 3600, s / 60 % 60, s % 60) : fmt::format("{}:{:02}", s / 60, s % 60);
}

}  // namespace

double rate_of(const RateSchedule& s, std::int64_t step, std::int64_t steps_per_epoch, int epochs) {
  double rate = s.rate;
  if (s.decay_epochs > 0) rate *= std::pow(s.decay_factor, static_cast<double>(step / steps_per_epoch / s.decay_epochs));
  if (step < s.warmup_steps) return rate * static_cast<double>(step + 1) / s.warmup_steps;
  if (s.final_share < 1) {
    const auto total = static_cast<double>(std::max<std::int64_t>(1, steps_per_epoch * epochs - 1 - s.warmup_steps));
    const double share = std::min(1.0, static_cast<double>(step - s.warmup_steps) / total);
    rate *= s.final_share + (1 - s.final_share) * 0.5 * (1 + std::cos(std::numbers::pi * share));
  }
  return rate;
}

torch::Tensor keyed_normal(std::uint64_t key, std::vector<std::int64_t> shape) {
  torch::Tensor t = torch::empty(shape);
  float* v = t.data_ptr<float>();
  for (std::int64_t i = 0; i < t.numel(); ++i)
    v[i] = static_cast<float>(to_normal(hash_identity({key, static_cast<std::uint64_t>(i)})));
  return t;
}

TrainingEnd run_training(const SampleSource& source, const NetepuConfig& config, Stage& stage, const fs::path& out,
                         const TrainingControl& control) {
  const std::vector<torch::Tensor> parameters = all_parameters(stage);
  torch::optim::AdamW optimiser(parameters,
                                torch::optim::AdamWOptions(stage.optimiser.schedule.rate).weight_decay(stage.optimiser.weight_decay));
  const fs::path state_file = out / "state.netepu";
  const std::string dataset = source.describe();
  Position at;
  std::error_code ignored;
  if (fs::exists(out, ignored) && !fs::is_directory(out, ignored))
    input_error("-o {}: is a file; name a folder for the run", out.string());
  const int batches = source.batches_per_epoch(stage.samples);
  if (stage.validation) source.batches_per_epoch(*stage.validation);  // refuses a dataset without validation split before the first step
  const bool resumed = fs::exists(state_file, ignored);
  if (resumed) {
    at = load_state(state_file, config, stage, dataset, optimiser);
    control.log(fmt::format("going on in epoch {} of {}, after step {}", std::min(at.epoch + 1, stage.epochs), stage.epochs, at.step));
  }
  if (at.epoch >= stage.epochs) {
    control.log("finished before; nothing to do");
    return TrainingEnd::finished;
  }
  control.log(fmt::format("{}: {} parameters, {} batches of {} an epoch, {} epochs", stage.name, count_parameters(*stage.module),
                          batches, stage.samples.batch, stage.epochs));
  Prefetcher prefetcher(source, stage.samples, at.epoch, at.batch);
  const Clock::time_point start = Clock::now();
  const double seconds_before = at.seconds;
  const std::int64_t first_step = at.step, total_steps = static_cast<std::int64_t>(batches) * stage.epochs;
  double drawing = 0, computing = 0, updating = 0;
  bool saved = resumed;
  const auto save_at = [&](const Position& position) {
    write_file_atomically(out / "config.json", to_json(config).dump(2) + "\n");
    save_state(state_file, config, stage, dataset, optimiser, position);
    saved = true;
  };
  const auto save = [&] {
    at.seconds = seconds_before + seconds_since(start);
    save_at(at);
  };
  while (at.epoch < stage.epochs) {
    for (; at.batch < batches; ) {
      if ((control.stop && control.stop->load()) || (control.max_steps > 0 && at.step - first_step >= control.max_steps)) {
        save();
        control.log(fmt::format("stopped in epoch {} at step {}; the same command goes on from here", at.epoch + 1, at.step));
        return TrainingEnd::stopped;
      }
      Clock::time_point mark = Clock::now();
      const auto lap = [&] {
        const double s = seconds_since(mark);
        mark = Clock::now();
        return s;
      };
      const Batch batch = prefetcher.next();
      drawing += lap();
      stage.module->train();
      optimiser.zero_grad();
      const Scalars terms = stage.accumulate(batch, at.step);
      computing += lap();
      const double rate = rate_of(stage.optimiser.schedule, at.step, batches, stage.epochs);
      const auto diverged = [&](const std::string& what) {
        run_error("{}: diverged in epoch {}, step {}, at rate {:.3g}: {}; lower [{}] rate, or look at frame {} of the dataset. {}",
                  out.string(), at.epoch + 1, at.step, rate, what, stage.name, batch.views.empty() ? 0 : batch.views.front().frame,
                  saved ? "The last saved state is kept" : "Nothing was saved yet");
      };
      double loss = 0;
      for (const auto& [name, value] : terms) {
        if (!std::isfinite(value)) diverged(fmt::format("the term '{}' is not finite", name));
        loss += value;
      }
      if (at.step == 0) at.first_loss = loss;
      if (loss > divergence_factor * std::max(1e-3, at.first_loss))
        diverged(fmt::format("the loss grew from {:.3g} to {:.3g}", at.first_loss, loss));
      for (const auto& group : stage.groups) {
        if (!std::isfinite(clip_gradients(group, stage.optimiser.clip_norm))) diverged("a gradient is not finite");
      }
      for (auto& group : optimiser.param_groups())
        static_cast<torch::optim::AdamWOptions&>(group.options()).lr(rate);
      if (control.device.is_cpu())
        adamw_step(optimiser);
      else
        optimiser.step();
      updating += lap();
      at.sums.resize(terms.size(), 0.0);
      for (std::size_t i = 0; i < terms.size(); ++i) at.sums[i] += terms[i].second;
      ++at.summed, ++at.step, ++at.batch;
      if (at.batch < batches || ((at.epoch + 1) % stage.validate_every != 0 && at.epoch + 1 < stage.epochs)) continue;
      // The last batch of an epoch that is validated.
      Scalars figures;
      {
        torch::NoGradGuard fixed;
        stage.module->eval();
        figures = stage.validate();
      }
      at.seconds = seconds_before + seconds_since(start);
      nlohmann::json row = nlohmann::json::array();
      row.push_back({"epoch", at.epoch + 1}), row.push_back({"step", at.step});
      row.push_back({"seconds", at.seconds}), row.push_back({"rate", rate});
      std::string line;
      for (std::size_t i = 0; i < terms.size(); ++i) {
        const double mean = at.sums[i] / static_cast<double>(at.summed);
        row.push_back({"train: " + terms[i].first, mean});
        line += fmt::format("  {} {:.4g}", terms[i].first, mean);
      }
      line += "  |";
      for (const auto& [name, value] : figures) {
        row.push_back({"validate: " + name, value});
        line += fmt::format("  {} {:.4g}", name, value);
      }
      at.rows.push_back(row);
      at.sums.assign(terms.size(), 0.0), at.summed = 0;
      const double per_step = seconds_since(start) / static_cast<double>(at.step - first_step);
      control.log(fmt::format("epoch {}/{}{}  |  {:.2f} steps/s, {} left", at.epoch + 1, stage.epochs, line, 1 / per_step,
                              clock_text(per_step * static_cast<double>(total_steps - at.step))));
      if (control.profile)
        control.log(fmt::format("  a step: waiting for data {:.0f} ms, forward and backward {:.0f} ms, update {:.0f} ms",
                                1e3 * drawing / static_cast<double>(at.step - first_step),
                                1e3 * computing / static_cast<double>(at.step - first_step),
                                1e3 * updating / static_cast<double>(at.step - first_step)));
      if (!figures.empty() && figures.front().second < at.best) {
        at.best = figures.front().second;
        stage.save_best(out / "model.netepu", {{"dataset", source.describe()},
                                               {"epoch", at.epoch + 1},
                                               {"step", at.step},
                                               {"minutes", std::round(at.seconds / 6) / 10},
                                               {"validation", figures}});
      }
      write_history(out, stage, at.rows);
      // The position after this epoch, so that a kill loses at most what came since the last validation.
      Position next = at;
      ++next.epoch, next.batch = 0;
      save_at(next);
    }
    ++at.epoch, at.batch = 0;
  }
  return TrainingEnd::finished;
}

}  // namespace moomill
