#include "validate/checks.h"

#include <atomic>

#include "generator/core/error.h"
#include "generator/core/parallel.h"
#include "generator/dataset/codecs.h"
#include "validate/context.h"

namespace moomill {
namespace {

// Every file that the manifest's templates promise of one frame.
std::vector<std::filesystem::path> promised_files(const DatasetFolder& d, int frame,
                                                  const std::vector<CameraRecord>& cameras) {
  const Manifest& m = d.manifest;
  std::vector<std::filesystem::path> out;
  for (const CameraRecord& c : cameras)
    for (const ModalityRow& r : modality_table()) {
      if (!m.modalities.has(r.id) || r.storage == Storage::record) continue;
      if (r.per_coat)
        for (int coat : m.coat_indices) out.push_back(d.file(r.id, frame, c.id, coat));
      else if (r.id == Modality::occlusion)
        for (int animal = 0; animal < static_cast<int>(m.animals.size()); ++animal)
          out.push_back(d.file(r.id, frame, c.id, -1, animal));
      else
        out.push_back(d.file(r.id, frame, c.id));
      if (r.id == Modality::nnopcs) out.push_back(d.nnopcs8(frame, c.id));
    }
  return out;
}

void check_files(const Context& context, const StoredFrame& frame, const std::vector<CameraRecord>& cameras,
                 Tally& tally) {
  const DatasetFolder& d = context.dataset;
  for (const auto& [path, entry] : frame.files) {
    tally.compared(Check::files);
    try {
      const std::vector<std::uint8_t> bytes = read_file(d.folder / path);
      if (bytes.size() != entry.bytes)
        tally.failed(Check::files, fmt::format("{}: has {} bytes and the record {}.", (d.folder / path).string(),
                                               bytes.size(), entry.bytes));
      else if (xxh64_hex(bytes.data(), bytes.size()) != entry.xxh64)
        tally.failed(Check::files, fmt::format("{}: has another hash than the record.", (d.folder / path).string()));
    } catch (const InputError& e) {
      tally.failed(Check::files, std::string(e.what()) + ".");
    }
  }
  for (const std::filesystem::path& file : promised_files(d, frame.frame.frame, cameras)) {
    tally.compared(Check::files);
    if (!frame.files.count(file.lexically_relative(d.folder).string()))
      tally.failed(Check::files,
                   fmt::format("{}: is not in the record of frame {}.", file.string(), frame.frame.frame));
  }
}

void check_record(const Context& context, const StoredFrame& frame, const std::vector<CameraRecord>& cameras,
                  Tally& tally) {
  const Manifest& m = context.dataset.manifest;
  const auto wrong = [&](const std::string& what) {
    tally.failed(Check::frames, fmt::format("Frame {}: {}.", frame.frame.frame, what));
  };
  tally.compared(Check::frames);
  if (frame.views.size() != cameras.size())
    wrong(fmt::format("it has {} views and {} cameras", frame.views.size(), cameras.size()));
  const std::size_t labelled = static_cast<std::size_t>(labelled_animal), count = m.keypoint_names.size();
  if (count > 0) {
    if (frame.frame.keypoints.size() <= labelled || frame.frame.keypoints[labelled].size() != count)
      wrong(fmt::format("the labelled animal has not {} keypoints", count));
    if (m.modalities.has(Modality::keypoints))
      for (const View& view : frame.views)
        if (view.keypoints.size() <= labelled || view.keypoints[labelled].size() != count)
          wrong(fmt::format("camera {} has not {} keypoints", view.camera, count));
    tally.compared(Check::keypoints_csv, count);
    const auto row = context.csv.find(frame.frame.frame);
    double apart = row == context.csv.end() ? INFINITY : 0;
    if (row != context.csv.end() && frame.frame.keypoints.size() > labelled)
      for (std::size_t k = 0; k < std::min(row->second.size(), frame.frame.keypoints[labelled].size()); ++k)
        apart = std::max(apart, glm::distance(row->second[k], frame.frame.keypoints[labelled][k]));
    tally.worst(Check::keypoints_csv, apart);
    if (!(apart <= 1e-9))
      tally.failed(Check::keypoints_csv,
                   fmt::format("Frame {}: keypoints.csv is {} m from the record.", frame.frame.frame, apart));
  }
  for (const CameraRecord& c : frame.frame.cameras) {  // cameras of this frame alone
    const Pinhole euler = pinhole_from_euler(c.centre, c.euler_xyz, c.focal_mm, c.sensor_mm, c.width, c.height);
    const double apart =
        pinhole_difference(euler, pinhole_from_matrix(c), c.width, c.height, std::max(1.0, glm::length(c.centre)));
    tally.within(Check::parameters, apart, 1e-4, [&] {
      return fmt::format("Frame {}, camera {}: Euler angles and matrix are {} px apart.", frame.frame.frame, c.id,
                         apart);
    });
  }
}

PosedMeshes pose(Context& context, const StoredFrame& frame, Tally& tally) {
  PosedMeshes out(context.meshes.size());
  const bool dual_quaternion = context.dataset.manifest.skinning == "dual_quaternion";
  for (std::size_t a = 0; a < out.size(); ++a) {
    if (!context.meshes[a]) continue;
    tally.compared(Check::frames);
    const Rig& rig = context.meshes[a]->rig;
    if (frame.frame.bones.size() <= a || frame.frame.bones[a].size() != rig.bones.size()) {
      tally.failed(Check::frames, fmt::format("Frame {}: animal {} has not the {} bones of its rig.", frame.frame.frame,
                                              a, rig.bones.size()));
      continue;
    }
    const std::vector<double> weights =
        frame.frame.morph_weights.size() > a ? frame.frame.morph_weights[a] : std::vector<double>{};
    out[a] = skinned(rig, frame.frame.bones[a], weights, dual_quaternion);
    if (!out[a]) context.collector.note(Check::surface_pixel, "dual quaternion skinning of bones that are not rigid");
  }
  return out;
}

void check_frame(Context& context, int frame, Tally& tally) {
  const StoredFrame stored = read_frame(context.dataset, frame);
  const std::vector<CameraRecord>& cameras = cameras_of(context.dataset, stored);
  check_record(context, stored, cameras, tally);
  check_files(context, stored, cameras, tally);
  const PosedMeshes posed = pose(context, stored, tally);
  ViewData previous;
  for (const View& view : stored.views) {
    const auto camera =
        std::find_if(cameras.begin(), cameras.end(), [&](const CameraRecord& c) { return c.id == view.camera; });
    tally.compared(Check::frames);
    if (camera == cameras.end()) {
      tally.failed(Check::frames, fmt::format("Frame {}: there is no camera {}.", frame, view.camera));
      continue;
    }
    ViewData data = load_view(context, view, *camera, tally);
    check_maps(context, data, tally);
    check_keypoints(context, stored, data, tally);
    check_surface(context, posed, data, tally);
    if (previous.view) {
      check_two_views(context, previous, data, tally);
      check_two_views(context, data, previous, tally);
    }
    previous = std::move(data);
  }
}

}  // namespace

std::vector<CheckResult> validate_dataset(const std::filesystem::path& folder,
                                          const std::function<void(std::size_t, std::size_t)>& progress) {
  Context context;
  context.dataset = open_dataset(folder);
  const Manifest& m = context.dataset.manifest;
  read_rigs(context);
  check_tables(context);
  check_manifest(context);
  if (!m.modalities.has(Modality::nnopcs) && !m.modalities.has(Modality::triangle))
    for (Check check : {Check::surface_nnopcs, Check::surface_pixel, Check::surface_depth, Check::two_views})
      context.collector.note(check, "there are neither NNOPCS nor triangle maps");
  std::mutex mutex;
  std::size_t done = 0;
  parallel_for(m.held_frames.size(), 1, [&](std::size_t i) {
    Tally tally;
    try {
      check_frame(context, m.held_frames[i], tally);
    } catch (const InputError& e) {
      tally.compared(Check::frames);
      tally.failed(Check::frames, std::string(e.what()) + ".");
    }
    context.collector.add(m.held_frames[i], std::move(tally));
    std::lock_guard lock(mutex);
    ++done;
    if (progress) progress(done, m.held_frames.size());
  });
  return context.collector.results();
}

}  // namespace moomill
