#pragma once
// What the command lines of both programs share: signals, usage errors in one sentence, exit status.
//
// Exit status: 0 done, 1 failed while running, 2 bad usage or bad input.
#include <CLI/CLI.hpp>

#include <atomic>
#include <functional>
#include <string>

namespace moomill {

inline constexpr int failed_status = 1, usage_status = 2;

// Set by the first SIGINT or SIGTERM: what is in flight is finished and saved. The second signal kills.
extern std::atomic<bool> stop_wanted;

void add_example(CLI::App* app, const std::string& example);

// Declares a command and what it runs; its status ends up in `status`.
template <class Run>
CLI::App* add_command(CLI::App& app, const char* name, const char* about, const char* example, int& status, Run run) {
  CLI::App* command = app.add_subcommand(name, about);
  command->callback([&status, run] { status = run(); });
  add_example(command, example);
  return command;
}

// Parses and runs the command; a mistake is told in one sentence with the mend.
int parse_and_run(CLI::App& app, int argc, char** argv, const int& status);

// The whole of main() but for memory: logging, signals, and errors turned into sentences and exit codes. `program` names it in messages;
// `memory_mend` is what to do when memory runs out.
int run_program(const char* program, const char* memory_mend, const std::function<int()>& run);

}  // namespace moomill
