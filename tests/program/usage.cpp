// Runs the program itself: exit status 2 and one sentence with the mend for everything a user can get wrong.
#include <doctest/doctest.h>
#include <fmt/format.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <string>

namespace fs = std::filesystem;

namespace {

struct Outcome {
  int status = -1;
  std::string out, err;
};

std::string read_all(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

struct Folder {
  Folder() : path(fs::temp_directory_path() / ("moomill_program_" + std::to_string(::getpid()))) {
    fs::create_directories(path);
  }
  ~Folder() {
    std::error_code ignored;
    fs::remove_all(path, ignored);
  }
  std::string file(const std::string& name, const std::string& text) const {
    std::ofstream(path / name) << text;
    return (path / name).string();
  }
  fs::path path;
};

const Folder& folder() {
  static const Folder f;
  return f;
}

Outcome run(const std::string& arguments) {
  const fs::path out = folder().path / "stdout", err = folder().path / "stderr";
  const std::string command = std::string("'") + MOOMILL_PROGRAM + "' " + arguments + " >'" + out.string() + "' 2>'" +
                              err.string() + "' </dev/null";
  const int status = std::system(command.c_str());
  return {WIFEXITED(status) ? WEXITSTATUS(status) : -1, read_all(out), read_all(err)};
}

bool contains(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

// Status 2, nothing on stdout, one line on stderr that holds `part`.
void check_usage_error(const std::string& arguments, const std::string& part) {
  const Outcome o = run(arguments);
  INFO(arguments, " -> ", o.err);
  CHECK(o.status == 2);
  CHECK(o.out.empty());
  CHECK(contains(o.err, part));
  CHECK(o.err.rfind("moomill: ", 0) == 0);
  CHECK(o.err.find('\n') == o.err.size() - 1);
}

std::string in_quotes(const fs::path& file) { return fmt::format("'{}'", file.string()); }

std::string scene(const std::string& name, const std::string& text) { return in_quotes(folder().file(name, text)); }

}  // namespace

TEST_CASE("a wrong command line") {
  check_usage_error("", "a command is missing; known are plan, generate");
  check_usage_error("generat", "unknown command 'generat'; did you mean 'generate'?");
  check_usage_error("rig inf", "unknown command 'inf'; did you mean 'info'?");
  check_usage_error("plan --jsn x.toml", "unknown option '--jsn'; did you mean '--json'?");
  check_usage_error("generate x.toml", "--out is required; `moomill generate --help` has an example");
  check_usage_error("generate x.toml -o y --spp many", "--spp");
  check_usage_error("generate x.toml -o y --layout coco", "--layout: coco not in {nepumoo}");
  check_usage_error("plan x.toml y.toml", "unexpected argument 'y.toml'");
}

TEST_CASE("a file that is not there") {
  check_usage_error("plan nowhere.toml", "nowhere.toml cannot be read: No such file or directory; check the path");
  check_usage_error("rig info nowhere.glb", "there is no file nowhere.glb");
  check_usage_error("rig check unicorn", "there is no species 'unicorn'");
  check_usage_error("preview nowhere -o x.png", "there is no species 'nowhere'");
  check_usage_error("preview nowhere.toml -o x.png", "there is no file nowhere.toml");
  check_usage_error("preview cow --strip 3 -o x.png", "--strip needs a scene file, and cow is none");
  check_usage_error("preview cow --coats -o x.png", "--coats needs a scene file, and cow is none");
  check_usage_error("preview cow -o x.jpg", "must end in .png");
  check_usage_error("rig compare cow --against nowhere.toml -o x", "there is no file nowhere.toml");
  check_usage_error("validate nowhere", "nowhere");
}

TEST_CASE("a wrong scene file") {
  check_usage_error("plan " + scene("key.toml", "[[animals]]\nspecies = \"cow\"\n[render]\nsampels = 3\n"),
                    "key.toml:4: unknown key 'sampels' in [render]; did you mean 'samples'?");
  check_usage_error("plan " + scene("modality.toml", "modalities = [\"dpeth\"]\n[[animals]]\nspecies = \"cow\"\n"),
                    "modality.toml:1: there is no modality 'dpeth' (did you mean 'depth'?); the modalities are rgb,");
  check_usage_error("plan " + scene("size.toml", "[[animals]]\nspecies = \"cow\"\n[cameras]\nresolution = [0, 0]\n"),
                    "size.toml:4: 'resolution' in [cameras] must be [width, height]");
  check_usage_error("plan " + scene("syntax.toml", "seed = \n"), "syntax.toml:1:");
  check_usage_error("plan " + scene("species.toml", "[[animals]]\nspecies = \"cwo\"\n"),
                    "species.toml:2: there is no species 'cwo'");
  const std::string turning = "[[animals]]\nspecies = \"cow\"\n[light]\nenvironment_strength = {uniform = [1, 2], per = \"view\"}\n";
  const std::string per_view = "light.environment_strength is drawn per view, but render.surface_light gathers light once per frame";
  check_usage_error("plan " + scene("turning.toml", turning + "[render]\nsurface_light = true\n"), per_view);
  check_usage_error("generate " + scene("turning.toml", turning) + " --surface-light -o x", per_view);
  check_usage_error("generate " + scene("cow.toml", "[[animals]]\nspecies = \"cow\"\n") + " --target-error 0.0001 -o x", "--target-error: 0.0001 is not possible; from 0.001 to 1");
  check_usage_error("generate " + scene("cow.toml", "[[animals]]\nspecies = \"cow\"\n") + " --target-error 0.02 --spp 8 -o x", "name one of the two");
  check_usage_error("plan " + scene("cow.toml", "[[animals]]\nspecies = \"cow\"\n[render]\ntarget_error = 1e-5\n"), "render.target_error is 1e-05; 0 for none, or from 0.001 to 1");
}

TEST_CASE("options that the scene cannot follow") {
  const std::string good = scene("good.toml", "[[animals]]\nspecies = \"cow\"\n");
  check_usage_error("plan " + good + " --resolution 0x0", "--resolution: 0x0 is not possible");
  check_usage_error("plan " + good + " --resolution big", "--resolution: 'big' is no size; write WIDTHxHEIGHT");
  check_usage_error("plan " + good + " --frames 5:2", "--frames: the range 5:2 runs backwards");
  check_usage_error("plan " + good + " --frames x", "--frames: 'x' is no range");
  check_usage_error("plan " + good + " --cameras 24", "--cameras: there is no 24");
  check_usage_error("plan " + good + " --coats 1,x", "--coats: '1,x' is no list of numbers; write e.g. 0,2,5:7");
  check_usage_error("plan " + good + " --modalities rbg",
                    "--modalities: there is no modality 'rbg' (did you mean 'rgb'?)");
  check_usage_error("generate " + good + " -o x --shard 4/4", "--shard: '4/4' is no shard");
  check_usage_error("render " + good + " --frame 99 --camera 0 -o x.exr",
                    "has no frame 99; its frames run from 1 to 10");
  check_usage_error("render " + good + " --frame 1 --camera 24 -o x.exr", "has no camera 24; its ids run from 0 to 23");
  check_usage_error("render " + good + " --frame 1 --camera 0 --coat 12 -o x.exr",
                    "has no coat 12; its coats are 0 to 11");
  check_usage_error("render " + good + " --frame 1 --camera 0 -o x.png", "must end in .exr");
  check_usage_error("plan " + good + " --probe nan", "--probe: nan is not a number");
  check_usage_error("converge " + good + " -o x --slope-at-most nan", "--slope-at-most: nan is not a number");
  check_usage_error("crosscheck " + good + " -o x --timing 0", "--timing: 0 is no number of samples; 1 to");
  check_usage_error("crosscheck " + good + " -o x --timing 4 --reference -5", "--reference: Value -5 not in range");
  const fs::path out = folder().path / "refused";
  const std::string lamp = scene("lamp.toml", "[[animals]]\nspecies = \"cow\"\n[[light.rectangles]]\nposition = [0, 0, 1]\ntarget = [0, 0, 1]\n");
  check_usage_error("generate " + lamp + " -o " + in_quotes(out), "a rectangular light stands at its own target in frame 1");
  CHECK_FALSE(fs::exists(out));
}

TEST_CASE("help, version and plan succeed") {
  CHECK(run("--version").out.rfind("moomill ", 0) == 0);
  CHECK(run("--version").status == 0);
  for (const char* command : {"", "plan", "generate", "render", "merge", "preview", "validate", "rig", "rig info",
                              "rig check", "rig build"}) {
    const Outcome o = run(std::string(command) + " --help");
    INFO(command);
    CHECK(o.status == 0);
    CHECK(contains(o.out, "Example:\n  moomill "));
  }
  const Outcome o = run("plan " + scene("three.toml", "seed = 3\n[[animals]]\nspecies = \"cow\"\n"));
  CHECK(o.status == 0);
  CHECK(o.err.empty());
  CHECK(contains(o.out, "10 frames x 24 cameras x 12 coats = 2880 views of 1024 x 768"));
  const Outcome json =
      run("plan " + scene("three.toml", "[[animals]]\nspecies = \"cow\"\n") + " --json --coats 3 --frames 2:3");
  CHECK(contains(json.out, "\"views\": 48"));
}

TEST_CASE("a study that could not be written is not begun") {
  const std::string good = scene("good.toml", "[[animals]]\nspecies = \"cow\"\n"), file = in_quotes(folder().file("file", "x"));
  for (const std::string& command : {"stress -o " + file, "converge " + good + " -o " + file, "leave-out " + good + " -o " + file}) {
    const Outcome o = run(command);
    INFO(command, " -> ", o.err);
    CHECK(o.status == 1);
    CHECK(o.out.empty());
    CHECK(contains(o.err, "a part of the path is a file; move it away or choose another folder"));
  }
}

TEST_CASE("what fails while running has exit status 1") {
  const std::string good = scene("good.toml", "[[animals]]\nspecies = \"cow\"\n[cameras]\nresolution = [8, 6]\n");
  const std::string blocked = folder().file("blocked", "a file where a folder should be");
  const Outcome o = run("render " + good + " --frame 1 --camera 0 --spp 1 -o '" + blocked + "/x.exr'");
  INFO(o.err);
  CHECK(o.status == 1);
  CHECK(contains(o.err, "blocked"));
}

TEST_CASE("a rig is built, described and checked") {
  const std::string glb = in_quotes(folder().path / "cow.glb");
  const Outcome built = run("rig build cow -o " + glb);
  CHECK(built.status == 0);
  const Outcome info = run("rig info " + glb);
  CHECK(info.status == 0);
  CHECK(contains(info.out, "left_fore_carpus"));
  CHECK(run("rig check cow").status == 0);
}
