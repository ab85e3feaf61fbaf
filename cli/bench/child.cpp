#include "cli/bench/child.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <spawn.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <filesystem>
#include <stdexcept>
#include <system_error>

#include "cli/bench/timing.h"

namespace strandbake {
namespace {

double seconds_of(const timeval& time) {
  return static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_usec);
}

}  // namespace

ChildRun run_child(const std::vector<std::string>& arguments) {
  const auto fail = [](int code, const char* what) {
    if (code != 0) throw std::system_error(code, std::generic_category(), what);
  };
  std::vector<std::string> words = {"/proc/self/exe"};
  words.insert(words.end(), arguments.begin(), arguments.end());
  std::vector<char*> argv;
  for (std::string& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);

  std::array<int, 2> output{};
  if (::pipe2(output.data(), O_CLOEXEC) != 0) fail(errno, "pipe");
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_adddup2(&actions, output[1], STDOUT_FILENO);
  const std::string program = std::filesystem::read_symlink(words.front());
  const auto start = Clock::now();
  pid_t child = 0;
  const int spawned = ::posix_spawn(&child, program.c_str(), &actions, nullptr, argv.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  ::close(output[1]);
  if (spawned != 0) {
    ::close(output[0]);
    fail(spawned, "starting a process");
  }

  ChildRun run;
  std::string text;
  std::array<char, 4096> buffer{};
  for (ssize_t count = 0; (count = ::read(output[0], buffer.data(), buffer.size())) != 0;) {
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) break;
    if (run.before_frames > 0) continue;
    text.append(buffer.data(), static_cast<std::size_t>(count));
    if (text.find("\"event\":\"start\"") != std::string::npos) run.before_frames = seconds_since(start);
  }
  ::close(output[0]);
  int status = 0;
  struct rusage usage = {};
  while (::wait4(child, &status, 0, &usage) < 0 && errno == EINTR) continue;
  run.seconds = seconds_since(start);
  if (!WIFEXITED(status) || WEXITSTATUS(status) != 0) {
    std::string command;
    for (const std::string& argument : arguments) command += ' ' + argument;
    throw std::runtime_error(fmt::format("`strandbake{}` failed", command));
  }
  run.user = seconds_of(usage.ru_utime);
  run.system = seconds_of(usage.ru_stime);
  run.peak_bytes = 1024.0 * static_cast<double>(usage.ru_maxrss);
  return run;
}

}  // namespace strandbake
