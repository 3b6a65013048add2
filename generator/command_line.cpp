#include "generator/command_line.h"

#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <csignal>
#include <cstdio>
#include <cstring>

#include "generator/core/error.h"
#include "generator/core/words.h"

namespace moomill {

std::atomic<bool> stop_wanted{false};

namespace {

const char* program_name = "moomill";  // set once, before any handler

void stop_on_signal() {
  struct sigaction action {};
  action.sa_handler = [](int) {
    stop_wanted.store(true);
    // Only what a signal handler may call; the handler is gone after the first signal, so a second one ends at once.
    constexpr char text[] = ": stopping after what is in flight; once more ends at once\n";
    [[maybe_unused]] auto written = ::write(2, "\n", 1);
    written = ::write(2, program_name, std::strlen(program_name));
    written = ::write(2, text, sizeof text - 1);
  };
  action.sa_flags = SA_RESETHAND;
  sigemptyset(&action.sa_mask);
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
}

void log_to_stderr() {
  auto logger = spdlog::stderr_color_mt(program_name);
  logger->set_pattern("%^%l%$: %v");
  spdlog::set_default_logger(logger);
}

void complain(const std::string& sentence) {
  fmt::print(stderr, "{}: {}\n", program_name, sentence);
}

// The command that was named, down to `rig info`.
const CLI::App* innermost(const CLI::App* app) {
  for (auto found = app->get_subcommands(); !found.empty(); found = app->get_subcommands()) app = found.front();
  return app;
}

std::string full_name(const CLI::App* app) {
  if (!app->get_parent()) return app->get_name();
  return full_name(app->get_parent()) + " " + app->get_name();
}

// What is wrong with the command line, in one sentence with the mend.
std::string usage_sentence(const CLI::App& app, const CLI::ParseError& error) {
  const CLI::App* command = innermost(&app);
  const std::string help = fmt::format("`{} --help` has an example", full_name(command));
  std::vector<std::string> commands, options;
  for (const CLI::App* c : command->get_subcommands([](const CLI::App*) { return true; }))
    commands.push_back(c->get_name());
  for (const CLI::Option* o : command->get_options())
    for (const std::string& name : o->get_lnames()) options.push_back("--" + name);
  for (const std::string& word : command->remaining(true)) {
    if (word.rfind("-", 0) == 0)
      return fmt::format("unknown option '{}'{}", word,
                         suggestion(word.substr(0, word.find('=')), options, help + "; known are"));
    if (!commands.empty()) return fmt::format("unknown command '{}'{}", word, suggestion(word, commands, "known are"));
    return fmt::format("unexpected argument '{}'; {}", word, help);
  }
  std::string what = error.what();
  while (!what.empty() && (what.back() == '.' || what.back() == '\n')) what.pop_back();
  std::replace(what.begin(), what.end(), '\n', ' ');
  if (!commands.empty()) return fmt::format("a command is missing{}", suggestion("", commands, "known are"));
  return fmt::format("{}; {}", what, help);
}

}  // namespace

void add_example(CLI::App* app, const std::string& example) {
  app->footer("\nExample:\n  " + example);
}

int parse_and_run(CLI::App& app, int argc, char** argv, const int& status) {
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    if (e.get_exit_code() == 0) return app.exit(e);  // --help and --version
    complain(usage_sentence(app, e));
    return usage_status;
  }
  return status;
}

int run_program(const char* program, const char* memory_mend, const std::function<int()>& run) {
  program_name = program;
  try {
    log_to_stderr();
    stop_on_signal();
    return run();
  } catch (const InputError& e) {
    complain(e.what());
    return usage_status;
  } catch (const std::bad_alloc&) {
    complain(std::string("there is not enough memory; ") + memory_mend);
  } catch (const std::exception& e) {
    complain(e.what());
  }
  return failed_status;
}

}  // namespace moomill
