#include <fcntl.h>
#include <sys/wait.h>

#include <fstream>
#include <thread>

#include "generator/dataset/json.h"
#include "tests/dataset/helpers.h"

using namespace moomill;
using namespace moomill::test;

namespace {

void write_all_frames(const fs::path& folder, const Manifest& m) {
  DatasetWriter writer(folder, m, 2);
  write_small_rig(writer);
  for (int frame : m.held_frames.empty() ? m.frames : m.held_frames)
    if (!writer.is_done(frame)) write_frame(writer, m, frame);
  writer.finish();
}

std::string first_line(const std::string& text) {
  return text.substr(0, text.find('\n'));
}

}  // namespace

TEST_CASE("a dataset holds what was written") {
  TemporaryFolder folder;
  const Manifest m = small_manifest(3);
  write_all_frames(folder, m);
  CHECK_FALSE(fs::exists(folder / journal_name));
  const DatasetFolder d = open_dataset(folder);
  CHECK(d.manifest.held_frames == m.frames);
  for (int frame : m.frames) {
    const StoredFrame stored = read_frame(d, frame);
    REQUIRE(stored.views.size() == 2);
    CHECK(stored.views[1].keypoints[0][1].pixel == dvec2(4.5, 1.0 / 3));
    CHECK(stored.views[1].keypoints[0][1].cause == HiddenBy::self);
    CHECK(stored.views[0].occlusion[0].whole_pixels == 60);
    CHECK(stored.frame.keypoints == small_record(m, frame).keypoints);
    CHECK(stored.files.size() == 2 * 13);
    for (const auto& [path, entry] : stored.files) {
      const auto bytes = read_file(folder / path);
      CHECK(bytes.size() == entry.bytes);
      CHECK(xxh64_hex(bytes.data(), bytes.size()) == entry.xxh64);
    }
    const View view = small_view(m, frame, 1);
    const ExrImage depth = decode_exr(d.file(Modality::depth, frame, 1));
    CHECK(depth.names == std::vector<std::string>{"B", "G", "R"});
    for (const auto& plane : depth.data) CHECK(plane == view.find(Modality::depth)->f.data);
    const Image8 mask = decode_png8(d.file(Modality::silhouette, frame, 1));
    CHECK(mask.channels == 1);
    CHECK(mask.at(3, 5) == 255);
    CHECK(mask.at(2, 5) == 0);
    const Image8 nnopcs8 = decode_png8(d.nnopcs8(frame, 1));
    CHECK(nnopcs8.at(4, 6, 2) == static_cast<int>(view.find(Modality::nnopcs)->f.at(4, 6, 2) * 255.0f + 0.5f));
    CHECK(decode_png16(d.file(Modality::part, frame, 1)).at(4, 6) == view.find(Modality::part)->u.at(4, 6));
    const ExrImage triangle = decode_exr(d.file(Modality::triangle, frame, 1));
    CHECK(triangle.ids[triangle.channel("id")] == view.find(Modality::triangle)->u.data);
    CHECK(triangle.data[triangle.channel("v")][5 * 12 + 3] == view.find(Modality::triangle)->f.at(3, 5, 1));
    CHECK(decode_exr(d.file(Modality::uv, frame, 1)).data[0][0] == -1);
    CHECK(decode_jpeg(d.file(Modality::rgb, frame, 1, 1)).width == 12);
  }
  const auto csv = read_file(d.keypoints_csv());
  const std::string text(csv.begin(), csv.end());
  CHECK(first_line(text) == "frame,nose_x,nose_y,nose_z,tail_tip_x,tail_tip_y,tail_tip_z");
  CHECK(std::count(text.begin(), text.end(), '\n') == 4);
  CHECK(text.find("\n1,0.3333333333333333,0.1,-0.2,1e-09,2,3\n") != std::string::npos);
  const auto cfg = read_file(d.parameters_cfg());
  const std::string ini(cfg.begin(), cfg.end());
  CHECK(ini.starts_with("[intrinsics]\nfocal_length_mm = 100\n"));
  CHECK(ini.find("[extrinsics_Camera.001]\ncenter_cam_x_m = 1.3333333333333333\n") != std::string::npos);
}

TEST_CASE("a run killed at any point and resumed ends in the same bytes") {
  const Manifest m = small_manifest(4);
  TemporaryFolder straight;
  write_all_frames(straight, m);
  const auto expected = tree(straight);

  TemporaryFolder killed;
  {
    DatasetWriter writer(killed, m, 1);
    write_small_rig(writer);
    write_frame(writer, m, 1);
    write_frame(writer, m, 3);
    writer.write_view(small_view(m, 2, 0));  // in flight
  }
  CHECK(message_of<InputError>([&] { open_dataset(killed); }).find("unfinished") != std::string::npos);
  std::ofstream(killed / "frames/.moomill-part-1-2-0002.json") << "half";
  std::ofstream(killed / journal_name, std::ios::app) << "frame 2 0123";  // a line cut short
  {
    DatasetWriter writer(killed, m, 3);
    CHECK(writer.is_done(1));
    CHECK_FALSE(writer.is_done(2));
    CHECK(writer.is_done(3));
    write_frame(writer, m, 4);
  }
  // Between two runs a finished frame loses a file, another its record.
  fs::remove(killed / file_of(m, Modality::depth, 1, 0, -1, -1));
  fs::resize_file(killed / "frames/0003.json", 10);
  {
    DatasetWriter writer(killed, m, 2);
    CHECK_FALSE(writer.is_done(1));
    CHECK_FALSE(writer.is_done(3));
    CHECK(writer.is_done(4));
  }
  write_all_frames(killed, m);
  CHECK(tree(killed) == expected);

  DatasetWriter again(killed, m, 1);
  CHECK(again.is_complete());
  CHECK(again.is_done(2));
  again.finish();
  CHECK(tree(killed) == expected);
}

TEST_CASE("killed between the manifest and the end of the journal") {
  const Manifest m = small_manifest(2);
  TemporaryFolder straight, killed;
  write_all_frames(straight, m);
  std::string journal;
  {
    DatasetWriter writer(killed, m, 1);
    write_small_rig(writer);
    for (int f : m.frames) write_frame(writer, m, f);
    const auto bytes = read_file(killed / journal_name);
    journal.assign(bytes.begin(), bytes.end());
    writer.finish();
  }
  write_file_atomically(killed / journal_name, journal);
  write_all_frames(killed, m);
  CHECK(tree(killed) == tree(straight));
}

TEST_CASE("an empty journal of a run killed at its start") {
  const Manifest m = small_manifest(1);
  TemporaryFolder straight, killed;
  write_all_frames(straight, m);
  write_file_atomically(killed / journal_name, std::string("moomill jour"));
  write_all_frames(killed, m);
  CHECK(tree(killed) == tree(straight));
}

TEST_CASE("many threads write the same bytes as one") {
  const Manifest m = small_manifest(6);
  TemporaryFolder straight, threaded;
  write_all_frames(straight, m);
  {
    DatasetWriter writer(threaded, m, 4);
    write_small_rig(writer);
    std::vector<std::thread> threads;
    for (int t = 0; t < 3; ++t)
      threads.emplace_back([&, t] {
        for (int frame = 6 - t; frame >= 1; frame -= 3) write_frame(writer, m, frame);
      });
    for (std::thread& thread : threads) thread.join();
    writer.finish();
  }
  CHECK(tree(threaded) == tree(straight));
}

TEST_CASE("a folder of another scene, or of something else, is refused") {
  TemporaryFolder folder;
  Manifest m = small_manifest(2);
  write_all_frames(folder, m);
  m.seed = 8;
  CHECK(message_of<InputError>([&] { DatasetWriter(folder, m, 1); }).find("differs in: seed") != std::string::npos);
  m = small_manifest(2);
  m.scene["samples"] = 2;
  CHECK(message_of<InputError>([&] { DatasetWriter(folder, m, 1); }).find("scene") != std::string::npos);

  TemporaryFolder unfinished;
  { DatasetWriter writer(unfinished, small_manifest(2), 1); }
  CHECK_THROWS_AS(DatasetWriter(unfinished, m, 1), InputError);

  TemporaryFolder foreign;
  std::ofstream(foreign / "letter.txt") << "dear cow";
  CHECK(message_of<InputError>([&] { DatasetWriter(foreign, m, 1); }).find("not empty") != std::string::npos);
  CHECK(fs::exists(foreign / "letter.txt"));

  TemporaryFolder damaged;
  std::ofstream(damaged / manifest_name) << "{]";
  CHECK(message_of<InputError>([&] { DatasetWriter(damaged, m, 1); }).find(manifest_name) != std::string::npos);
  CHECK_THROWS_AS(open_dataset(damaged), InputError);
  CHECK_THROWS_AS(open_dataset(damaged / "nowhere"), InputError);
  std::ofstream(foreign / journal_name) << "shopping list\n";
  CHECK_THROWS_AS(DatasetWriter(foreign, m, 1), InputError);
}

TEST_CASE("two writers of one folder") {
  TemporaryFolder folder;
  const Manifest m = small_manifest(1);
  DatasetWriter writer(folder, m, 1);
  CHECK(message_of<RunError>([&] { DatasetWriter(folder, m, 1); }).find("another process") != std::string::npos);
}

TEST_CASE("an unwritable folder") {
  if (::geteuid() == 0) {  // root may write anywhere: a path through a file cannot be made by anybody
    TemporaryFolder folder;
    std::ofstream(folder / "file") << "x";
    CHECK_THROWS_AS(DatasetWriter(folder / "file" / "data", small_manifest(1), 1), RunError);
    CHECK(message_of<RunError>([&] { DatasetWriter("/proc/moomill", small_manifest(1), 1); }).find("/proc/moomill") ==
          0);
    return;
  }
  TemporaryFolder folder;
  fs::permissions(folder, fs::perms::owner_read | fs::perms::owner_exec);
  CHECK_THROWS_AS(DatasetWriter(folder / "data", small_manifest(1), 1), RunError);
}

TEST_CASE("shards merge into the bytes of one run") {
  Manifest m = small_manifest(5);
  TemporaryFolder straight, a, b, out;
  write_all_frames(straight, m);
  Manifest part = m;
  part.held_frames = {1, 3, 5};
  write_all_frames(a, part);
  CHECK(open_dataset(a).json.at("held_frames").size() == 3);
  part.held_frames = {2, 3, 4};  // an overlap with the same bytes is fine
  write_all_frames(b, part);
  merge_datasets({a, b}, out / "all", false);
  CHECK(tree(out / "all") == tree(straight));
  merge_datasets({b, a}, out / "all", false);  // done before: nothing to do
  CHECK(tree(out / "all") == tree(straight));

  SUBCASE("a second shard may also go straight into the folder of the first") {
    write_all_frames(a, part);
    CHECK(tree(a) == tree(straight));
  }
  SUBCASE("missing frames") {
    CHECK(message_of<InputError>([&] { merge_datasets({a}, out / "gap", false); }).find("frames 2, 4") !=
          std::string::npos);
    merge_datasets({a}, out / "gap", true);
    CHECK(tree(out / "gap") == tree(a));
  }
  SUBCASE("another seed") {
    Manifest other = m;
    other.seed = 9;
    TemporaryFolder c;
    write_all_frames(c, other);
    CHECK_THROWS_AS(merge_datasets({a, c}, out / "bad", true), InputError);
  }
  SUBCASE("a damaged file is not passed on") {
    const fs::path file = a / file_of(m, Modality::depth, 1, 0, -1, -1);
    auto bytes = read_file(file);
    bytes.back() ^= 1;
    write_file_atomically(file, bytes.data(), bytes.size());
    CHECK(message_of<InputError>([&] { merge_datasets({a, b}, out / "bad", false); }).find(file.string()) == 0);
  }
  SUBCASE("an overlap with other bytes") {
    const fs::path record = b / "frames/0003.json";
    Json json = parse_json_file(record);
    json["animals"][0]["keypoints_m"][0][0] = 99.0;
    write_file_atomically(record, dump_json(json));
    CHECK(message_of<InputError>([&] {
            merge_datasets({a, b}, out / "bad", false);
          }).find("frame 3") != std::string::npos);
  }
  SUBCASE("an unfinished shard, none at all, the output among the shards") {
    TemporaryFolder c;
    { DatasetWriter writer(c, m, 1); }
    CHECK_THROWS_AS(merge_datasets({a, c}, out / "bad", true), InputError);
    CHECK_THROWS_AS(merge_datasets({}, out / "bad", true), InputError);
    CHECK_THROWS_AS(merge_datasets({a, b}, a, true), InputError);
  }
}

TEST_CASE("cameras that vary lie in the records, those of the first frame in parameters.cfg") {
  Manifest m = small_manifest(2);
  TemporaryFolder folder;
  m.per_frame_cameras = true;
  write_all_frames(folder, m);
  const DatasetFolder d = open_dataset(folder);
  CHECK(cameras_of(d, read_frame(d, 2))[1].centre.z == 2.5);
  const auto bytes = read_file(d.parameters_cfg());
  const std::string ini(bytes.begin(), bytes.end());
  CHECK(ini.starts_with("# The cameras of this dataset vary"));
  CHECK(ini.find("center_cam_z_m = 1.5") != std::string::npos);
}
