// The same bytes for any number of threads, after a kill, and from shards: whole folders compared file by file.
#include <doctest/doctest.h>
#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <map>
#include <string>
#include <thread>
#include <vector>

namespace fs = std::filesystem;

namespace {

struct Folder {
  fs::path path = fs::temp_directory_path() / ("moomill_same_bytes_" + std::to_string(::getpid()));
  Folder() { fs::create_directories(path); }
  ~Folder() {
    std::error_code ignored;
    fs::remove_all(path, ignored);
  }
};

pid_t start(std::vector<std::string> arguments) {
  arguments.insert(arguments.begin(), MOOMILL_PROGRAM);
  std::vector<char*> argv;
  for (std::string& a : arguments) argv.push_back(a.data());
  argv.push_back(nullptr);
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addopen(&actions, 2, "/dev/null", O_WRONLY, 0);
  pid_t pid = 0;
  REQUIRE(posix_spawn(&pid, MOOMILL_PROGRAM, &actions, nullptr, argv.data(), environ) == 0);
  posix_spawn_file_actions_destroy(&actions);
  return pid;
}

int run(const std::vector<std::string>& arguments) {
  int status = 0;
  waitpid(start(arguments), &status, 0);
  return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

std::map<std::string, std::string> contents(const fs::path& folder) {
  std::map<std::string, std::string> files;
  for (const auto& e : fs::recursive_directory_iterator(folder))
    if (e.is_regular_file()) {
      std::ifstream in(e.path(), std::ios::binary);
      files[fs::relative(e.path(), folder).string()] = std::string(std::istreambuf_iterator<char>(in), {});
    }
  return files;
}

void check_equal(const fs::path& a, const fs::path& b) {
  const auto x = contents(a), y = contents(b);
  CHECK(x.size() > 300);
  CHECK(x.size() == y.size());
  for (const auto& [name, bytes] : x) {
    INFO(name);
    const auto other = y.find(name);
    REQUIRE(other != y.end());
    CHECK(other->second == bytes);
  }
}

// The shipped quick scene, smaller: all its stages, four frames.
std::vector<std::string> generate(const fs::path& out, std::vector<std::string> more) {
  std::vector<std::string> a = {"generate", MOOMILL_SOURCE_DIR "/scenes/quick.toml", "-o", out.string(), "--resolution", "128x96", "--spp", "4"};
  a.insert(a.end(), more.begin(), more.end());
  return a;
}

}  // namespace

TEST_CASE("a dataset has the same bytes on one thread and on two, killed and resumed, and merged from shards") {
  const Folder folder;
  const fs::path one = folder.path / "one";
  REQUIRE(run(generate(one, {"--threads", "1"})) == 0);

  const fs::path two = folder.path / "two";
  REQUIRE(run(generate(two, {"--threads", "2"})) == 0);
  check_equal(one, two);

  // Killed without warning as soon as a first frame is in the journal, a few times over.
  const fs::path killed = folder.path / "killed";
  int kills = 0;
  for (int round = 0; round < 3; ++round) {
    const pid_t pid = start(generate(killed, {"--threads", "2"}));
    int status = 0;
    bool ended = false;
    std::size_t before = 0;
    const auto records = [&] {
      std::error_code ignored;
      std::size_t n = 0;
      for (fs::directory_iterator i(killed / "frames", ignored), end; !ignored && i != end; i.increment(ignored)) ++n;
      return n;
    };
    before = records();
    for (int wait = 0; wait < 12000 && !ended && records() <= before; ++wait) {
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
      ended = waitpid(pid, &status, WNOHANG) == pid;
    }
    if (!ended) {
      kill(pid, SIGKILL);
      waitpid(pid, &status, 0);
      ++kills;
    }
  }
  CHECK(kills >= 1);
  REQUIRE(run(generate(killed, {})) == 0);
  check_equal(one, killed);

  const fs::path a = folder.path / "a", b = folder.path / "b", merged = folder.path / "merged";
  REQUIRE(run(generate(a, {"--shard", "0/2"})) == 0);
  REQUIRE(run(generate(b, {"--shard", "1/2"})) == 0);
  REQUIRE(run({"merge", a.string(), b.string(), "-o", merged.string()}) == 0);
  check_equal(one, merged);

  CHECK(run({"validate", one.string()}) == 0);
  CHECK(run({"validate", merged.string()}) == 0);
}
