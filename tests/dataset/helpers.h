#pragma once
// What the dataset tests share: temporary folders, a small manifest and views with known content.
#include <doctest/doctest.h>
#include <unistd.h>

#include <cmath>
#include <cstdint>
#include <filesystem>
#include <map>
#include <string>

#include "generator/core/error.h"
#include "generator/dataset/codecs.h"
#include "generator/dataset/dataset.h"
#include "generator/dataset/reader.h"

namespace moomill::test {

namespace fs = std::filesystem;

// Removed at the end of the test.
struct TemporaryFolder {
  fs::path path;
  TemporaryFolder() {
    static int counter = 0;
    path = fs::temp_directory_path() / fmt::format("moomill-test-{}-{}", ::getpid(), counter++);
    fs::create_directories(path);
  }
  ~TemporaryFolder() {
    std::error_code ignored;
    fs::permissions(path, fs::perms::owner_all, fs::perm_options::add, ignored);
    fs::remove_all(path, ignored);
  }
  operator const fs::path&() const { return path; }
  fs::path operator/(const fs::path& name) const { return path / name; }
};

// Deterministic noise.
inline std::uint32_t hash(std::uint32_t v) {
  v ^= v >> 16;
  v *= 0x7feb352du;
  v ^= v >> 15;
  v *= 0x846ca68bu;
  return v ^ (v >> 16);
}

inline Manifest small_manifest(int frames, int cameras = 2) {
  Manifest m;
  m.scene = {{"about", "test"}, {"samples", 1}};
  m.seed = 7;
  for (int f = 1; f <= frames; ++f) m.frames.push_back(f);
  for (int c = 0; c < cameras; ++c) {
    CameraRecord camera;
    camera.id = c;
    camera.centre = {1.0 / 3 + c, -2, 0.5};
    camera.euler_xyz = {1.5, 0, 0.1 * c};
    camera.width = 12;
    camera.height = 20;
    m.cameras.push_back(camera);
  }
  m.coats = {"holstein", "brown"};
  m.coat_indices = {0, 1};
  m.animals = {"cow"};
  m.keypoint_names = {"nose", "tail_tip"};
  m.skeleton = {{0, 1}};
  m.keypoint_tolerance = {0.02, 0.02};
  for (Modality modality :
       {Modality::rgb, Modality::silhouette, Modality::coverage, Modality::depth, Modality::nnopcs, Modality::normal,
        Modality::uv, Modality::part, Modality::instance, Modality::triangle, Modality::keypoints, Modality::occlusion})
    m.modalities.add(modality);
  m.rig_files = {"rigs/cow.glb"};
  return m;
}

inline View small_view(const Manifest& m, int frame, int camera) {
  View v;
  v.frame = frame;
  v.camera = camera;
  v.width = 12;
  v.height = 20;
  for (const ModalityRow& r : modality_table()) {
    if (!m.modalities.has(r.id) || r.id == Modality::keypoints) continue;
    for (int coat : r.per_coat ? m.coat_indices : std::vector<int>{-1}) {
      Map map;
      map.modality = r.id;
      map.coat = coat;
      map.animal = r.id == Modality::occlusion ? 0 : -1;
      const bool ids = r.storage == Storage::exr_ids;
      const bool integers = (r.storage == Storage::png8 && r.id != Modality::coverage) || r.storage == Storage::png16;
      if (!integers) map.f = ImageF(v.width, v.height, ids ? 2 : r.channels, static_cast<float>(r.background));
      if (integers || ids) map.u = ImageU32(v.width, v.height, 1);
      for (int y = 5; y < 15; ++y)
        for (int x = 3; x < 9; ++x) {
          const std::uint32_t seed = hash(static_cast<std::uint32_t>(frame * 131 + camera * 17 + y * 7 + x + coat));
          for (int c = 0; c < map.f.channels; ++c)
            map.f.at(x, y, c) =
                r.id == Modality::rgb && c == 3 ? 1.0f : 0.1f + static_cast<float>(hash(seed + c) % 1000) / 1200.0f;
          if (!map.u.empty())
            map.u.at(x, y) = r.id == Modality::silhouette || r.id == Modality::occlusion ? 255 : 1 + seed % 5;
        }
      v.maps.push_back(map);
    }
  }
  v.keypoints = {{KeypointView{{1.25, 2.5}, 3.0, Visibility::visible, HiddenBy::nothing, -1, -0.01},
                  KeypointView{{4.5, 1.0 / 3}, 3.5, Visibility::hidden, HiddenBy::self, -1, 0.25}}};
  v.occlusion = {OcclusionView{60, 60, 0, {0}}};
  return v;
}

inline FrameRecord small_record(const Manifest& m, int frame) {
  FrameRecord r;
  r.frame = frame;
  r.keypoints = {{dvec3(frame / 3.0, 0.1, -0.2), dvec3(1e-9 * frame, 2, 3)}};
  r.bone_names = {{"root"}};
  r.bones = {{dmat4(1.0)}};
  r.placement = {dmat4(1.0)};
  r.morph_weights = {{}};
  if (m.per_frame_cameras) {
    r.cameras = m.cameras;
    for (CameraRecord& c : r.cameras) c.centre.z += frame;
  }
  return r;
}

inline void write_frame(DatasetWriter& writer, const Manifest& m, int frame) {
  for (const CameraRecord& c : m.cameras) writer.write_view(small_view(m, frame, c.id));
  FrameRecord record = small_record(m, frame);
  writer.finish_frame(record);
}

inline void write_small_rig(DatasetWriter& writer) {
  writer.write_rig(0, [](const fs::path& file) { write_file_atomically(file, std::string("glTF of the test")); });
}

// Every file of a tree with its content, for comparing datasets byte for byte.
inline std::map<std::string, std::string> tree(const fs::path& folder) {
  std::map<std::string, std::string> out;
  for (const auto& entry : fs::recursive_directory_iterator(folder)) {
    if (!entry.is_regular_file()) continue;
    const std::vector<std::uint8_t> bytes = read_file(entry.path());
    out[fs::relative(entry.path(), folder).string()] = std::string(bytes.begin(), bytes.end());
  }
  return out;
}

// What an exception of the wanted type says; fails the test when there is none.
template <class Error, class Body>
std::string message_of(const Body& body) {
  try {
    body();
  } catch (const Error& e) {
    return e.what();
  } catch (const std::exception& e) {
    FAIL("another kind of error: " << std::string(e.what()));
  }
  FAIL("no error at all");
  return {};
}

}  // namespace moomill::test
