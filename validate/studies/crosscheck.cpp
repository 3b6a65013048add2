#include "validate/studies/crosscheck.h"

#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstring>
#include <map>
#include <thread>

#include "generator/core/data_root.h"
#include "generator/core/error.h"
#include "generator/dataset/codecs.h"
#include "generator/dataset/json.h"
#include "validate/studies/converge.h"

extern char** environ;

namespace moomill {
namespace {

namespace fs = std::filesystem;

constexpr CheckedSurface surfaces[] = {CheckedSurface::diffuse, CheckedSurface::full};
constexpr double picture_gain = 8;  // of the differences in pictures

std::string join(const std::vector<int>& numbers) {
  return fmt::format("{}", fmt::join(numbers, ","));
}

// Runs a program with its output in `log`; its exit status, or 128 + the signal that ended it. Ends it where `stop` is set.
int run_logged(const std::vector<std::string>& words, const fs::path& log, const std::atomic<bool>* stop) {
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addopen(&actions, 0, "/dev/null", O_RDONLY, 0);
  posix_spawn_file_actions_addopen(&actions, 1, log.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0644);
  posix_spawn_file_actions_adddup2(&actions, 1, 2);
  std::vector<char*> arguments;
  for (const std::string& w : words) arguments.push_back(const_cast<char*>(w.c_str()));
  arguments.push_back(nullptr);
  pid_t child = 0;
  const int failed = posix_spawn(&child, arguments[0], &actions, nullptr, arguments.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  if (failed) run_error("{} cannot be started: {}", words[0], std::strerror(failed));
  int status = 0;
  for (bool ended = false; !ended;) {
    const pid_t changed = waitpid(child, &status, stop ? WNOHANG : 0);
    if (changed < 0 && errno != EINTR) run_error("{} was lost: {}", words[0], std::strerror(errno));
    ended = changed == child;
    if (ended || !stop) continue;
    if (stop->load()) ::kill(child, SIGKILL);  // it holds nothing that is not written anew
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  }
  if (stop && stop->load()) run_error("stopped; references that are whole stay in the folder, run the same command again to go on");
  return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
}

fs::path blender_program(const CrosscheckOptions& options) {
  const fs::path program = find_program(options.blender);
  if (program.empty())
    input_error("{} is not there; install Blender 3.4 (section crosscheck of apt-packages.txt) or say where it is by --blender", options.blender);
  return program;
}

fs::path script_file(const char* name) {
  const fs::path script = data_root() / "validate" / "blender" / name;
  if (!fs::exists(script)) input_error("{} is not there; set MOOMILL_HOME to the folder that holds validate/", script.string());
  return script;
}

void run_blender(const CrosscheckOptions& options, const fs::path& folder, const std::vector<std::string>& more) {
  const fs::path program = blender_program(options), script = script_file("crosscheck.py");
  std::vector<std::string> words = {program.string(), "-b", "--factory-startup", "--python-exit-code", "1", "-P", script.string(), "--",
                                    folder.string(), "--threads", std::to_string(options.threads), "--launched", fmt::format("{:.3f}", std::chrono::duration<double>(std::chrono::system_clock::now().time_since_epoch()).count())};
  words.insert(words.end(), more.begin(), more.end());
  const fs::path log = folder / "blender.log";
  if (const int status = run_logged(words, log, options.stop); status != 0)
    run_error("Blender ended with status {}; its last words are in {}", status, log.string());
}

// Hash of all that a picture by Cycles hangs on: what was exported, the scripts, and the version of Blender.
std::string source_hash(const CrosscheckOptions& options, const std::string& export_hash) {
  const fs::path log = options.out / "blender_version.log";
  if (const int status = run_logged({blender_program(options).string(), "--version"}, log, nullptr); status != 0)
    run_error("{} --version ended with status {}; what it said is in {}", options.blender, status, log.string());
  std::string text = export_hash;
  for (const fs::path& file : {log, script_file("crosscheck.py"), script_file("rebuild.py"), script_file("lobes.py")}) {
    const auto bytes = read_file(file);
    text += fmt::format(" {}", xxh64_hex(bytes.data(), bytes.size()));
  }
  return xxh64_hex(text.data(), text.size());
}

// What lies beside a picture that is whole and was made from the same sources; null where it must be rendered.
Json kept_render(const fs::path& picture, const std::string& hash) {
  const fs::path beside = picture.string() + ".json";
  if (!fs::exists(picture) || !fs::exists(beside)) return nullptr;
  const Json j = parse_json_file(beside);
  return j.value("sources", "") == hash ? j : Json(nullptr);
}

// A plane of Blender's file: "View.Depth.Z" and the like, whatever the layer is called.
const std::vector<float>& plane(const ExrImage& image, const std::string& suffix, const fs::path& file) {
  for (std::size_t c = 0; c < image.names.size(); ++c)
    if (image.names[c].ends_with(suffix)) return image.data[c];
  run_error("{} has no channel {}; look at blender.log beside its folder", file.string(), suffix);
}

LabelMaps labels_of_cycles(const fs::path& file, const Scene& scene, int width, int height, int scale) {
  const ExrImage exr = decode_exr(file);
  if (exr.width != width * scale || exr.height != height * scale) run_error("{} is {} x {}, not {} x {}", file.string(), exr.width, exr.height, width * scale, height * scale);
  const auto &index = plane(exr, ".IndexOB.X", file), &depth = plane(exr, ".Depth.Z", file);
  const std::vector<float>* nnopcs[3] = {&plane(exr, ".nnopcs.R", file), &plane(exr, ".nnopcs.G", file), &plane(exr, ".nnopcs.B", file)};
  LabelMaps out{width, height, {}, {}, {}};
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      const std::size_t p = (static_cast<std::size_t>(y) * scale + scale / 2) * exr.width + static_cast<std::size_t>(x) * scale + scale / 2;
      const auto object = static_cast<std::size_t>(std::lround(index[p]));
      const int animal = object == 0 || object > scene.instances.size() ? -1 : scene.instances[object - 1].animal;
      out.animal.push_back(static_cast<std::uint32_t>(animal + 1));
      out.depth.push_back(depth[p]);
      for (const auto* c : nnopcs) out.nnopcs.push_back((*c)[p]);
    }
  return out;
}

LabelMaps labels_of_ours(const View& view) {
  const Map *instance = view.find(Modality::instance), *depth = view.find(Modality::depth), *nnopcs = view.find(Modality::nnopcs);
  check(instance && depth && nnopcs, "the cross-check asks for these maps");
  return {view.width, view.height, instance->u.data, depth->f.data, nnopcs->f.data};
}

ImageF colors_of_cycles(const fs::path& file) {
  const ExrImage exr = decode_exr(file);
  ImageF out(exr.width, exr.height, 4);
  static constexpr const char* suffix[] = {".Combined.R", ".Combined.G", ".Combined.B", ".Combined.A"};
  for (int k = 0; k < 4; ++k) {
    const auto& values = plane(exr, suffix[k], file);
    for (std::size_t p = 0; p < values.size(); ++p) out.data[4 * p + k] = values[p];
  }
  return out;
}

fs::path cycles_file(const fs::path& folder, const char* surface, int camera, int coat, int samples) {
  return folder / "cycles" / fmt::format("rgb_{}_{:03}_{:03}_{}.exr", surface, camera, coat, samples);
}

void write_png(const fs::path& file, const Image8& image) {
  const auto bytes = encode_png8(image);
  write_file_atomically(file, bytes.data(), bytes.size());
}

// The frame, its cameras and its coats, ready for both renderers.
struct Prepared {
  std::unique_ptr<Mill> mill;
  Frame frame;
  std::shared_ptr<const Dressed> dressed;
};

Prepared prepare(const SceneSpec& scene, const CrosscheckOptions& options) {
  if (find_program(options.blender).empty())  // said before anything is baked
    input_error("there is no Blender: {} is not on the PATH; install it (section crosscheck of apt-packages.txt) or say where it is by --blender", options.blender);
  if (options.label_scale < 1 || options.label_scale % 2 == 0) input_error("--label-scale {}: an odd number, or no pixel centre stays one", options.label_scale);
  SceneSpec spec = scene;
  Overrides only;
  only.modalities = {"rgb", "silhouette", "instance", "depth", "nnopcs"};
  only.first_frame = only.last_frame = options.frame.value_or(scene.frames.front());
  apply_overrides(spec, only);
  Prepared p;
  const int frame = spec.frames.front();
  p.mill = std::make_unique<Mill>(std::move(spec));
  if (p.mill->batches() != 1) input_error("--coats: more coats than are shaded at once (128, fewer where render.memory_mb is small); name fewer");
  p.frame = p.mill->prepare(frame);
  p.dressed = p.mill->dress(p.frame, 0);
  return p;
}

// What is summed up over views.
struct Totals {
  LabelDifference labels;
  LabelJudgement exact;
  double mean[2] = {0, 0}, mean_unbent[2] = {0, 0}, block[2] = {0, 0}, alpha = 0, bent = 0, our_seconds = 0;
};

void add(LabelDifference& sum, const LabelDifference& d) {
  sum.pixels += d.pixels;
  sum.differing += d.differing;
  sum.unexplained += d.unexplained;
  sum.compared += d.compared;
  sum.depth_off += d.depth_off;
  sum.nnopcs_off += d.nnopcs_off;
  sum.farthest = std::max(sum.farthest, d.farthest);
  sum.depth_worst = std::max(sum.depth_worst, d.depth_worst);
  sum.nnopcs_worst = std::max(sum.nnopcs_worst, d.nnopcs_worst);
}

void add(LabelJudgement& sum, const LabelJudgement& j) {
  sum.off += j.off;
  sum.off_ours_right += j.off_ours_right;
  sum.off_theirs_right += j.off_theirs_right;
  sum.judged += j.judged;
  sum.our_depth = std::max(sum.our_depth, j.our_depth);
  sum.their_depth = std::max(sum.their_depth, j.their_depth);
  sum.our_nnopcs = std::max(sum.our_nnopcs, j.our_nnopcs);
  sum.their_nnopcs = std::max(sum.their_nnopcs, j.their_nnopcs);
}

double share_within(std::uint64_t off, std::uint64_t of) {
  return of == 0 ? std::numeric_limits<double>::quiet_NaN() : 1 - static_cast<double>(off) / static_cast<double>(of);
}

}  // namespace

fs::path find_program(const std::string& name) {
  const auto runs = [](const fs::path& p) { return fs::is_regular_file(p) && access(p.c_str(), X_OK) == 0; };
  if (name.find('/') != std::string::npos) return runs(name) ? fs::path(name) : fs::path();
  const char* path = std::getenv("PATH");
  std::string folders = path ? path : "";
  for (std::size_t at = 0; at <= folders.size();) {
    const std::size_t end = std::min(folders.find(':', at), folders.size());
    const fs::path candidate = fs::path(folders.substr(at, end - at)) / name;
    if (end > at && runs(candidate)) return candidate;
    at = end + 1;
  }
  return {};
}

StudyResult crosscheck(const SceneSpec& scene, const CrosscheckOptions& options) {
  const Prepared p = prepare(scene, options);
  const std::vector<int>& coats = p.dressed->coats;
  const int samples = p.mill->spec().render.samples;
  export_crosscheck(*p.mill, p.frame, *p.dressed, options.out);
  run_blender(options, options.out,
              {"--labels", "--label-scale", std::to_string(options.label_scale), "--surface", "diffuse,full", "--spp", std::to_string(samples)});

  Totals totals;
  const std::vector<Instance>& instances = p.dressed->scene.instances;
  const bool whole = std::none_of(instances.begin(), instances.end(), [&](const Instance& in) { return p.dressed->scene.cut_out(in); });
  std::string csv = "frame,camera,coat,surface,quantity,value,unit\n";
  std::string labels = "| camera | pixels | silhouette differs | farther than 0.01 px | farthest, px | depth within 1e-4 m | worst, m | median, m | NNOPCS within 1e-4 | worst | median |\n"
                       "|---|---|---|---|---|---|---|---|---|---|---|\n";
  std::string colors = "| surface | camera | coat | ours R, G, B | Cycles R, G, B | worst of the means | without bent normals | alpha | rms of pixels | share of bent normals | worst 16 x 16 block | rms of blocks |\n"
                       "|---|---|---|---|---|---|---|---|---|---|---|---|\n";
  for (const CameraRecord& camera : p.frame.cameras) {
    const LabelMaps ours = labels_of_ours(p.mill->trace_labels(p.frame, camera));
    const LabelMaps theirs = labels_of_cycles(options.out / "cycles" / fmt::format("labels_{:03}.exr", camera.id), p.frame.geometry->scene, camera.width, camera.height, options.label_scale);
    const LabelDifference d = compare_labels(ours, theirs, outlines_in_view(p.frame.geometry->scene, camera));
    add(totals.labels, d);
    // Where parts of surfaces are cut out, the first triangle is not always what is seen.
    LabelJudgement exact;
    std::vector<bool> bent;
    if (whole) {
      const ExactView view(p.frame.geometry->scene, camera);
      exact = judge_labels(ours, theirs, view);
      bent = bent_pixels(view, camera.width, camera.height);
    }
    add(totals.exact, exact);
    write_png(options.out / fmt::format("labels_{:03}.png", camera.id), label_sheet(ours, theirs));
    labels += fmt::format("| {} | {} | {} | {} | {:.4f} | {:.5f} | {:.3g} | {:.3g} | {:.5f} | {:.3g} | {:.3g} |\n", camera.id, d.pixels, d.differing, d.unexplained, d.farthest,
                          share_within(d.depth_off, d.compared), d.depth_worst, d.depth_median, share_within(d.nnopcs_off, d.compared), d.nnopcs_worst, d.nnopcs_median);
    auto row = [&](int coat, const char* surface, const char* quantity, double value, const char* unit) {
      csv += fmt::format("{},{},{},{},{},{:.9g},{}\n", p.frame.number, camera.id, coat < 0 ? "" : std::to_string(coat), surface, quantity, value, unit);
    };
    row(-1, "", "pixels", static_cast<double>(d.pixels), "pixels");
    row(-1, "", "silhouette differs", static_cast<double>(d.differing), "pixels");
    row(-1, "", "silhouette differs farther than 0.01 px from an outline", static_cast<double>(d.unexplained), "pixels");
    row(-1, "", "farthest differing pixel", d.farthest, "px");
    row(-1, "", "depth within 1e-4 m", share_within(d.depth_off, d.compared), "");
    row(-1, "", "depth median difference", d.depth_median, "m");
    row(-1, "", "nnopcs within 1e-4", share_within(d.nnopcs_off, d.compared), "");
    row(-1, "", "nnopcs median difference", d.nnopcs_median, "");
    if (whole) {
      row(-1, "", "off by more than 1e-4 in depth or nnopcs", static_cast<double>(exact.off), "pixels");
      row(-1, "", "of those moomill right in double precision", static_cast<double>(exact.off_ours_right), "pixels");
      row(-1, "", "of those Cycles right in double precision", static_cast<double>(exact.off_theirs_right), "pixels");
      row(-1, "", "worst depth of moomill against double precision", exact.our_depth, "m");
      row(-1, "", "worst depth of Cycles against double precision", exact.their_depth, "m");
    }

    for (const CheckedSurface surface : surfaces) {
      const auto start = std::chrono::steady_clock::now();
      const View view = p.mill->trace_coats(p.frame, camera, with_surface(*p.dressed, surface), {samples, 0, 0, true});  // paths alone, as many samples as Cycles
      totals.our_seconds += std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
      for (const int coat : coats) {
        const char* name = name_of(surface);
        const ImageF& a = view.find(Modality::rgb, coat)->f;
        const ImageF b = colors_of_cycles(cycles_file(options.out, name, camera.id, coat, samples));
        const ColorDifference c = compare_colors(a, b, bent);
        const int s = static_cast<int>(surface);
        totals.mean[s] = std::max(totals.mean[s], c.worst_mean);
        totals.block[s] = std::max(totals.block[s], c.block_rms);
        totals.mean_unbent[s] = std::max(totals.mean_unbent[s], c.worst_mean_without);
        totals.bent = std::max(totals.bent, c.left_out);
        totals.alpha = std::max(totals.alpha, std::abs(c.alpha));
        write_png(options.out / fmt::format("rgb_{}_{:03}_{:03}.png", name, camera.id, coat), difference_sheet(a, b, picture_gain));
        colors += fmt::format("| {} | {} | {} | {:.5f}, {:.5f}, {:.5f} | {:.5f}, {:.5f}, {:.5f} | {:.4f} | {:.4f} | {:+.5f} | {:.4f} | {:.4f} | {:.4f} | {:.4f} |\n", name, camera.id, coat, c.ours.x, c.ours.y,
                              c.ours.z, c.theirs.x, c.theirs.y, c.theirs.z, c.worst_mean, c.worst_mean_without, c.alpha, c.rms, c.left_out, c.block_worst, c.block_rms);
        static constexpr const char* channel[] = {"mean R", "mean G", "mean B"};
        for (int k = 0; k < 3; ++k) row(coat, name, channel[k], c.ours[k] / c.theirs[k] - 1, "relative");
        row(coat, name, "alpha", c.alpha, "relative");
        row(coat, name, "rms of pixels", c.rms, "relative");
        row(coat, name, "within 2 pixels of a normal that Cycles bends", c.left_out, "");
        row(coat, name, "rms of 16 x 16 blocks", c.block_rms, "relative");
      }
    }
  }

  const Json told = parse_json_file(options.out / "cycles" / "build.json");
  double seconds = 0, core_seconds = 0;
  for (const Json& r : told.at("renders")) {
    seconds += r.at("wall_seconds").get<double>();
    core_seconds += r.at("core_seconds").get<double>();
  }
  StudyResult result;
  result.title = fmt::format("Cross-check of frame {} of {} against Blender {}", p.frame.number, fs::path(scene.file).filename().string(), told.at("blender").get<std::string>());
  const LabelDifference& l = totals.labels;
  result.figures = {
      {"silhouette: pixels that either sees", static_cast<double>(l.pixels), "pixels", {}, 1.0},
      {"silhouette: pixels that differ", static_cast<double>(l.differing), "pixels", {}, {}},
      {"silhouette: of those farther than 0.01 px from an outline", static_cast<double>(l.unexplained), "pixels", 0.0, {}},
      {"silhouette: farthest differing pixel from an outline", l.farthest, "px", {}, {}},
      {"depth: share within 1e-4 m", share_within(l.depth_off, l.compared), "", {}, 0.999},
      {"NNOPCS: share within 1e-4", share_within(l.nnopcs_off, l.compared), "", {}, 0.999},
      {"diffuse: worst difference of mean colours", totals.mean[0], "", 0.005, {}},
      {"full: worst difference of mean colours", totals.mean[1], "", 0.03, {}},
      {"diffuse: worst difference of mean colours, without normals that Cycles bends", totals.mean_unbent[0], "", {}, {}},
      {"full: worst difference of mean colours, without normals that Cycles bends", totals.mean_unbent[1], "", {}, {}},
      {"diffuse: worst rms of 16 x 16 blocks", totals.block[0], "", {}, {}},
      {"full: worst rms of 16 x 16 blocks", totals.block[1], "", {}, {}},
      {"blocks: largest share of pixels left out beside normals that Cycles bends", totals.bent, "", {}, {}},
      {"alpha: worst difference of means", totals.alpha, "", 0.005, {}},
      {"time of Cycles, matched surfaces, all renders", seconds, "s", {}, {}},
      {"time of Cycles, matched surfaces, all renders, all cores", core_seconds, "s", {}, {}},
      {"time of moomill, all renders", totals.our_seconds, "s", {}, {}},
  };
  if (whole) {
    const LabelJudgement& e = totals.exact;
    const std::vector<Figure> judged = {
        {"double precision: pixels judged", static_cast<double>(e.judged), "pixels", {}, {}},
        {"double precision: worst depth of moomill", e.our_depth, "m", label_tolerance, {}},
        {"double precision: worst depth of Cycles", e.their_depth, "m", {}, {}},
        {"double precision: worst NNOPCS of moomill", e.our_nnopcs, "", label_tolerance, {}},
        {"double precision: worst NNOPCS of Cycles", e.their_nnopcs, "", {}, {}},
        {"double precision: pixels where the two are off by more than 1e-4", static_cast<double>(e.off), "pixels", {}, {}},
        {"double precision: of those moomill within 1e-4", static_cast<double>(e.off_ours_right), "pixels", {}, static_cast<double>(e.off)},
        {"double precision: of those Cycles within 1e-4", static_cast<double>(e.off_theirs_right), "pixels", {}, {}},
    };
    result.figures.insert(result.figures.end(), judged.begin(), judged.end());
  }
  result.table = fmt::format("# {}\n\n{} x {}, {} samples a pixel, cameras {}, coats {}. Conventions: validate/blender/README.md.\n\n## Labels\n\n{}\n## Colours\n\n"
                             "Means of linear colour over the pixels with alpha; differences relative to Cycles. Blocks leave out what lies within two pixels of a normal that "
                             "Cycles bends, and hold noise as well: rms of pixels / 16 where pixels' errors are independent.\n\n{}",
                             result.title, p.frame.cameras[0].width, p.frame.cameras[0].height, samples,
                             [&] { std::vector<int> ids; for (const auto& c : p.frame.cameras) ids.push_back(c.id); return join(ids); }(), join(coats), labels, colors);
  write_file_atomically(options.out / "crosscheck.csv", csv);
  write_file_atomically(options.out / "crosscheck.md", result.table);
  return result;
}

StudyResult time_cycles(const SceneSpec& scene, const CrosscheckOptions& options) {
  const Prepared p = prepare(scene, options);
  const std::string sources = source_hash(options, export_crosscheck(*p.mill, p.frame, *p.dressed, options.out));
  std::vector<int> samples = options.timing_samples;
  Json kept = Json::array();
  std::vector<std::string> skip;
  if (options.reference_samples > 0) {
    samples.push_back(options.reference_samples);
    for (const CameraRecord& camera : p.frame.cameras)
      for (const int coat : p.dressed->coats) {
        const fs::path picture = cycles_file(options.out, "principled", camera.id, coat, options.reference_samples);
        if (Json render = kept_render(picture, sources); !render.is_null()) {
          kept.push_back(std::move(render));
          skip.push_back(picture.filename().string());
        }
      }
  }
  run_blender(options, options.out, {"--surface", "principled", "--spp", join(samples), "--sources", sources, "--skip", fmt::format("{}", fmt::join(skip, ","))});

  Json told = parse_json_file(options.out / "cycles" / "build.json");
  if (!told.contains("renders")) told["renders"] = Json::array();
  for (const Json& render : kept) told["renders"].push_back(render);
  StudyResult result;
  result.title = fmt::format("Run times of Blender {} on frame {} of {}, {} threads", told.at("blender").get<std::string>(), p.frame.number, fs::path(scene.file).filename().string(),
                             told.at("threads").get<int>());
  std::map<int, ImageU32> masks;  // by camera: where a pixel's centre ray meets an animal, as in `converge`
  if (options.reference_samples > 0)
    for (const CameraRecord& camera : p.frame.cameras) {
      const View labels = p.mill->trace_labels(p.frame, camera);
      const Map* silhouette = labels.find(Modality::silhouette);
      check(silhouette != nullptr, "a scene with animals has a silhouette");
      if (std::none_of(silhouette->u.data.begin(), silhouette->u.data.end(), [](std::uint32_t v) { return v != 0; }))
        input_error("{}: no animal is in frame {} of camera {}; choose another camera", scene.file, p.frame.number, camera.id);
      masks[camera.id] = silhouette->u;
    }
  std::vector<ConvergenceRow> rows;  // references have no error to tell and stay out
  result.table = fmt::format("# {}\n\nStart {:.2f} s and building of the scene {:.2f} s are not in the rows; what Cycles says it took to synchronise is in `seconds`.\n\n"
                             "| camera | coat | spp | seconds | core seconds | synchronised, s | mse | relative mse | CIEDE2000 |\n|---|---|---|---|---|---|---|---|---|\n",
                             result.title, told.at("start_seconds").get<double>(), told.at("build_seconds").get<double>());
  double seconds = 0, core_seconds = 0;
  for (const Json& r : told.at("renders")) {
    const int camera = r.at("camera"), coat = r.at("coat"), spp = r.at("spp");
    ConvergenceRow row{"cycles", p.frame.number, camera, coat, spp, r.at("wall_seconds"), r.at("core_seconds"), {}};
    std::string cells = " | | ";
    if (options.reference_samples > 0 && spp != options.reference_samples) {
      const auto picture = [&](int n) { return colors_of_cycles(cycles_file(options.out, "principled", camera, coat, n)); };
      row.error = picture_error(picture(spp), picture(options.reference_samples), masks.at(camera));
      cells = fmt::format("{:.4g} | {:.4g} | {:.3f}", row.error.mse, row.error.relative_mse, row.error.ciede2000);
      rows.push_back(row);
    }
    seconds += row.seconds;
    core_seconds += row.core_seconds;
    result.table += fmt::format("| {} | {} | {} | {:.3f} | {:.3f} | {:.3f} | {} |\n", camera, coat, spp, row.seconds, row.core_seconds,
                                r.value("synchronization_time", 0.0), cells);
  }
  if (!kept.empty()) result.table += fmt::format("\n{} references were in the folder and are kept, with the times of when they were rendered.\n", kept.size());
  result.figures = {{"seconds of all renders", seconds, "s", {}, {}},
                    {"core seconds of all renders", core_seconds, "s", {}, {}},
                    {"references kept from an earlier run", static_cast<double>(kept.size()), "", {}, {}}};
  if (!rows.empty()) write_file_atomically(options.out / convergence_file, convergence_csv(rows));  // what `converge --against` reads
  return result;
}

}  // namespace moomill
