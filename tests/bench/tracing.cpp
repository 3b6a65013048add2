// What the mill costs: first hits against a raw Embree loop, hierarchies, geometry-only views to disk, one coat
// against twelve, memory. All on our cow, built fine enough for 100,000 triangles and more.
#include <benchmark/benchmark.h>
#include <embree3/rtcore.h>
#include <fcntl.h>
#include <spawn.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <tbb/global_control.h>
#include <unistd.h>

#include <chrono>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <sstream>

#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "generator/core/stage_times.h"
#include "generator/dataset/codecs.h"
#include "generator/render/labels.h"
#include "generator/render/path.h"
#include "scenes/generate.h"
#include "scenes/runner.h"

using namespace moomill;
namespace fs = std::filesystem;

namespace {

double now() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

double median(std::vector<double> v) {
  std::sort(v.begin(), v.end());
  return v[v.size() / 2];
}

fs::path scratch() {
  static const fs::path folder = [] {
    const fs::path f = fs::temp_directory_path() / fmt::format("moomill-bench-{}", getpid());
    fs::create_directories(f);
    return f;
  }();
  return folder;
}

// The cow with finer triangles, as a species file of its own beside the scenes of the benchmark.
std::string fine_cow() {
  const fs::path file = scratch() / "cow.toml";
  if (!fs::exists(file)) {
    std::ifstream in(data_root() / "rigs/cow/cow.toml");
    std::stringstream text;
    text << in.rdbuf();
    std::string s = text.str();
    const auto at = s.find("target_edge_m");
    s.replace(at, s.find('\n', at) - at, "target_edge_m = 0.0125");
    fs::copy(data_root() / "rigs/cow/motion", scratch() / "motion");  // clips lie beside their species
    std::ofstream(file) << s;
  }
  return file.string();
}

fs::path write_scene(const std::string& name, const std::string& text) {
  const fs::path file = scratch() / (name + ".toml");
  std::ofstream(file) << text;
  return file;
}

std::string scene_text(const std::string& modalities, const std::string& coats, int frames, const std::string& more) {
  return fmt::format("seed = 1\nmodalities = [{}]\n[[animals]]\nspecies = \"{}\"\ncoats = [{}]\n[[animals.poses]]\nclip = \"walk\"\ncount = {}\n{}",
                     modalities, fine_cow(), coats, frames, more);
}

std::string coat_list(int n) {
  std::string s;
  const auto names = shipped_coats("cow");
  for (int i = 0; i < n; ++i) s += fmt::format("{}\"{}\"", i ? ", " : "", (data_root() / "textures/cow" / (names.at(i) + ".toml")).string());
  return s;
}

// --- first hits ---

void first_hits_against_raw_embree(benchmark::State& state) {
  const Mill mill(read_scene(write_scene("first_hits", scene_text("\"depth\"", coat_list(1), 4, ""))));
  const Frame frame = mill.prepare(1);
  const Scene& scene = frame.geometry->scene;
  const Accel& accel = *frame.geometry->accel;

  // The same geometry, flags and rays for the raw loop.
  RTCDevice device = rtcNewDevice("isa=avx2");
  RTCScene raw = rtcNewScene(device);
  rtcSetSceneFlags(raw, RTC_SCENE_FLAG_ROBUST);
  const Instance& in = scene.instances[0];
  RTCGeometry g = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
  std::memcpy(rtcSetNewGeometryBuffer(g, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12, in.posed.positions.size()),
              in.posed.positions.data(), 12 * in.posed.positions.size());
  std::memcpy(rtcSetNewGeometryBuffer(g, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12, in.surface->triangles.size()),
              in.surface->triangles.data(), 12 * in.surface->triangles.size());
  rtcCommitGeometry(g);
  rtcAttachGeometry(raw, g);
  rtcCommitScene(raw);

  // Elapsed time tells what a serial stretch costs; processor time tells the same on a machine that does other work too.
  std::vector<double> single_rate, packet_rate, our_rate, ratio, processor_ratio;
  for (auto _ : state) {
    double t_single = 0, t_packet = 0, t_ours = 0, p_single = 0, p_packet = 0, p_ours = 0;
    double t = 0, p0 = 0;
    const auto begin = [&] { p0 = process_processor_seconds(), t = now(); };
    const auto end = [&](double& elapsed, double& processor) { elapsed += now() - t, processor += process_processor_seconds() - p0; };
    std::uint64_t rays = 0, our_rays = 0;
    for (const CameraRecord& r : frame.cameras) {
      if (r.id % 3) continue;
      const Camera camera = Camera::from_matrix(r.world_to_camera, r.fx, r.fy, r.cx, r.cy, r.width, r.height);
      const PixelMask mask = footprint(scene, camera, 0);
      // Rays in the order of 4 x 2 blocks, ready made.
      alignas(32) static std::vector<RTCRayHit8> packets;
      std::vector<int> active;
      packets.clear();
      const dvec3 origin = camera.centre - scene.origin;
      for (int y = 0; y < camera.height; y += 2)
        for (int x = 0; x < camera.width; x += 4) {
          RTCRayHit8 p{};
          int on = 0;
          for (int i = 0; i < 8; ++i) {
            const int px = x + (i & 3), py = y + (i >> 2);
            if (!mask.get(px, py)) continue;
            on |= 1 << i;
            const dvec3 d = camera.direction(px + 0.5, py + 0.5);
            p.ray.org_x[i] = float(origin.x), p.ray.org_y[i] = float(origin.y), p.ray.org_z[i] = float(origin.z);
            p.ray.dir_x[i] = float(d.x), p.ray.dir_y[i] = float(d.y), p.ray.dir_z[i] = float(d.z);
            p.ray.tfar[i] = 1e30f;
            p.ray.mask[i] = ~0u;
            p.hit.geomID[i] = RTC_INVALID_GEOMETRY_ID;
            ++rays;
          }
          if (on) packets.push_back(p), active.push_back(on);
        }
      const std::size_t n = packets.size(), grain = 64;
      begin();
      std::atomic<std::uint64_t> found{0};
      parallel_for((n + grain - 1) / grain, 4, [&](std::size_t b) {
        RTCIntersectContext context;
        rtcInitIntersectContext(&context);
        context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
        std::uint64_t hit = 0;
        for (std::size_t k = b * grain; k < std::min(n, (b + 1) * grain); ++k) {
          alignas(32) RTCRayHit8 p = packets[k];
          alignas(32) int valid[8];
          for (int i = 0; i < 8; ++i) valid[i] = active[k] >> i & 1 ? -1 : 0;
          rtcIntersect8(valid, raw, &context, &p);
          for (int i = 0; i < 8; ++i) hit += valid[i] && p.hit.geomID[i] != RTC_INVALID_GEOMETRY_ID;
        }
        found += hit;
      });
      end(t_packet, p_packet);
      benchmark::DoNotOptimize(found.load());
      begin();
      parallel_for((n + grain - 1) / grain, 4, [&](std::size_t b) {
        RTCIntersectContext context;
        rtcInitIntersectContext(&context);
        context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
        std::uint64_t hit = 0;
        for (std::size_t k = b * grain; k < std::min(n, (b + 1) * grain); ++k)
          for (int i = 0; i < 8; ++i)
            if (active[k] >> i & 1) {
              RTCRayHit q{};
              q.ray.org_x = packets[k].ray.org_x[i], q.ray.org_y = packets[k].ray.org_y[i], q.ray.org_z = packets[k].ray.org_z[i];
              q.ray.dir_x = packets[k].ray.dir_x[i], q.ray.dir_y = packets[k].ray.dir_y[i], q.ray.dir_z = packets[k].ray.dir_z[i];
              q.ray.tfar = 1e30f;
              q.ray.mask = ~0u;
              q.hit.geomID = RTC_INVALID_GEOMETRY_ID;
              rtcIntersect1(raw, &context, &q);
              hit += q.hit.geomID != RTC_INVALID_GEOMETRY_ID;
            }
        found += hit;
      });
      end(t_single, p_single);
      begin();
      const FirstHits hits = trace_first_hits(scene, accel, camera, mask);
      end(t_ours, p_ours);
      our_rays += hits.rays;
      benchmark::DoNotOptimize(hits.depth.data());
    }
    check(rays == our_rays, "both passes trace the same rays");
    single_rate.push_back(rays / t_single / 1e6);
    packet_rate.push_back(rays / t_packet / 1e6);
    our_rate.push_back(rays / t_ours / 1e6);
    ratio.push_back(our_rate.back() / std::max(single_rate.back(), packet_rate.back()));
    processor_ratio.push_back(std::min(p_single, p_packet) / p_ours);
  }
  rtcReleaseGeometry(g);
  rtcReleaseScene(raw);
  rtcReleaseDevice(device);
  state.counters["triangles"] = static_cast<double>(in.surface->triangles.size());
  state.counters["raw_single_Mrays"] = median(single_rate);
  state.counters["raw_packet_Mrays"] = median(packet_rate);
  state.counters["ours_Mrays"] = median(our_rate);
  state.counters["ratio"] = median(ratio);
  state.counters["processor_ratio"] = median(processor_ratio);
}
BENCHMARK(first_hits_against_raw_embree)->Iterations(25)->Unit(benchmark::kMillisecond)->UseRealTime();

// --- hierarchies: rebuild or refit, and what tracing costs after either ---

void hierarchy(benchmark::State& state) {
  const Mill mill(read_scene(write_scene("hierarchy", scene_text("\"depth\"", coat_list(1), 8, ""))));
  std::vector<double> rebuild, refit, trace_rebuilt, trace_refit;
  const Frame first = mill.prepare(1);
  Scene moving = first.geometry->scene;
  Accel refitted(moving, BuildKind::refit);
  int number = 1;
  for (auto _ : state) {
    number = number % 8 + 1;
    const Frame frame = mill.prepare(number);
    moving.instances[0].posed = frame.geometry->scene.instances[0].posed;
    double t = now();
    const Accel built(frame.geometry->scene);
    rebuild.push_back(1e3 * (now() - t));
    t = now();
    refitted.update();
    refit.push_back(1e3 * (now() - t));
    double a = 0, b = 0;
    for (int c = 0; c < 8; ++c) {
      const CameraRecord& r = frame.cameras[c];
      const Camera camera = Camera::from_matrix(r.world_to_camera, r.fx, r.fy, r.cx, r.cy, r.width, r.height);
      const PixelMask mask = footprint(moving, camera, 0);
      t = now();
      benchmark::DoNotOptimize(trace_first_hits(frame.geometry->scene, built, camera, mask).rays);
      a += now() - t;
      t = now();
      benchmark::DoNotOptimize(trace_first_hits(moving, refitted, camera, mask).rays);
      b += now() - t;
    }
    trace_rebuilt.push_back(1e3 * a * 3);
    trace_refit.push_back(1e3 * b * 3);
  }
  state.counters["rebuild_ms"] = median(rebuild);
  state.counters["refit_ms"] = median(refit);
  state.counters["trace24_rebuilt_ms"] = median(trace_rebuilt);
  state.counters["trace24_refit_ms"] = median(trace_refit);
}
BENCHMARK(hierarchy)->Iterations(7)->Unit(benchmark::kMillisecond)->UseRealTime();

// --- geometry-only views a second, written to disk ---

void geometry_views_to_disk(benchmark::State& state) {
  const SceneSpec scene = read_scene(
      write_scene("geometry", scene_text("\"silhouette\", \"depth\", \"nnopcs\", \"keypoints\"", coat_list(1), 4, "")));
  std::vector<double> rate;
  for (auto _ : state) {
    const fs::path out = scratch() / "geometry";
    fs::remove_all(out);
    double begin = -1, end = 0;
    std::size_t views = 0;
    GenerateOptions options;
    options.out = out;
    options.progress = [&](const Progress& p) {
      if (p.stage == "rendering" && begin < 0) begin = p.seconds;
      end = p.seconds;
      views = p.views_done;
    };
    generate(scene, options);
    rate.push_back(views / (end - begin));
  }
  state.counters["views_per_s"] = median(rate);
}
BENCHMARK(geometry_views_to_disk)->Iterations(3)->Unit(benchmark::kMillisecond)->UseRealTime();

// --- 64-sample colour of one coat and of twelve ---

void rgb_one_and_twelve_coats(benchmark::State& state) {
  const Mill one(read_scene(write_scene("rgb1", scene_text("\"rgb\"", coat_list(1), 1, ""))));
  const Mill twelve(read_scene(write_scene("rgb12", scene_text("\"rgb\"", coat_list(12), 1, ""))));
  const Frame a = one.prepare(1), b = twelve.prepare(1);
  std::vector<double> t1, t12, ratio;
  for (auto _ : state) {
    double t = now();
    benchmark::DoNotOptimize(one.trace(a, a.cameras[10]).maps.size());
    t1.push_back(now() - t);
    t = now();
    benchmark::DoNotOptimize(twelve.trace(b, b.cameras[10]).maps.size());
    t12.push_back(now() - t);
    ratio.push_back(t12.back() / t1.back());
  }
  state.counters["one_coat_s"] = median(t1);
  state.counters["twelve_coats_s"] = median(t12);
  state.counters["ratio"] = median(ratio);
}
BENCHMARK(rgb_one_and_twelve_coats)->Iterations(5)->Unit(benchmark::kMillisecond)->UseRealTime();

// --- memory: a child process each, so that peaks are its own ---

// Runs this program again with MOOMILL_BENCH_CHILD set; returns its peak resident set in MiB and what it printed.
double child_peak_mib(const std::string& what, std::string* printed) {
  const fs::path log = scratch() / "child.txt";
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addopen(&actions, 1, log.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0644);
  std::string variable = "MOOMILL_BENCH_CHILD=" + what, scratch_variable = "MOOMILL_BENCH_SCRATCH=" + scratch().string();
  std::vector<char*> environment;
  for (char** e = environ; *e; ++e) environment.push_back(*e);
  environment.push_back(variable.data());
  environment.push_back(scratch_variable.data());
  environment.push_back(nullptr);
  char name[] = "moomill_bench";
  char* arguments[] = {name, nullptr};
  pid_t pid = 0;
  check(posix_spawn(&pid, "/proc/self/exe", &actions, nullptr, arguments, environment.data()) == 0, "spawning the child");
  int status = 0;
  rusage usage{};
  wait4(pid, &status, 0, &usage);
  check(status == 0, "the child of the memory benchmark failed");
  std::ifstream in(log);
  std::stringstream text;
  text << in.rdbuf();
  *printed = text.str();
  return usage.ru_maxrss / 1024.0;
}

double resident_mib() {
  std::ifstream in("/proc/self/statm");
  double pages = 0, resident = 0;
  in >> pages >> resident;
  return resident * static_cast<double>(sysconf(_SC_PAGESIZE)) / (1 << 20);
}

void memory(benchmark::State& state) {
  write_scene("twelve", scene_text("\"rgb\", \"silhouette\", \"depth\", \"nnopcs\", \"keypoints\"", coat_list(12), 2,
                                   "[cameras]\nrings = {count = 2}\n[render]\nsamples = 4\ncoat_resolution = 2048\n"));
  write_scene("long", scene_text("\"rgb\", \"silhouette\", \"depth\", \"nnopcs\", \"normal\", \"triangle\", \"keypoints\"", coat_list(2), 220,
                                 "[cameras]\nrings = {count = 1}\n[render]\nsamples = 1\ncoat_resolution = 512\n"));
  for (auto _ : state) {
    std::string printed;
    state.counters["peak_12_coats_MiB"] = child_peak_mib("twelve", &printed);
    child_peak_mib("long", &printed);
    double at20 = 0, at200 = 0;
    std::sscanf(printed.c_str(), "%lf %lf", &at20, &at200);
    state.counters["resident_frame_20_MiB"] = at20;
    state.counters["resident_frame_200_MiB"] = at200;
    state.counters["growth"] = at200 / at20;
  }
}
BENCHMARK(memory)->Iterations(1)->Unit(benchmark::kMillisecond)->UseRealTime();

}  // namespace

// The child of the memory benchmark; returns false when this process is not one.
bool run_memory_child() {
  const char* what = std::getenv("MOOMILL_BENCH_CHILD");
  if (!what) return false;
  const fs::path folder = std::getenv("MOOMILL_BENCH_SCRATCH");
  const SceneSpec scene = read_scene(folder / (std::string(what) + ".toml"));
  GenerateOptions options;
  options.out = folder / what;
  fs::remove_all(options.out);
  double at20 = 0, at200 = 0;
  options.progress = [&](const Progress& p) {
    if (p.views_total == 0) return;
    const double frames = static_cast<double>(scene.frames.size()) * p.views_done / p.views_total;
    // The largest of some frames: how many views are in flight at one moment is chance.
    if (frames > 10 && frames <= 20) at20 = std::max(at20, resident_mib());
    if (frames > 190 && frames <= 200) at200 = std::max(at200, resident_mib());
  };
  generate(scene, options);
  std::printf("%f %f\n", at20, at200);
  return true;
}

void remove_bench_scratch() { fs::remove_all(scratch()); }
