// How the program speaks: results to stdout, everything else to stderr.
#pragma once

#include <chrono>
#include <string>
#include <string_view>

#include "formats/error.h"
#include "formats/scene.h"

namespace strandbake {

// "strandbake: error: ..." and "strandbake: warning: ..." on stderr.
void print_error(std::string_view message);
void print_warning(std::string_view message);
// "the scene has 2 faults"
std::string count_faults(const Faults& faults);
// Each fault on a line of its own, "scene.toml:14:3: ...", then how many there were.
void print_faults(const Faults& faults);

// "12.3 MiB"
std::string human_bytes(double bytes);
// "2 min 5 s"
std::string human_seconds(double seconds);

// Progress of a loop whose length is known: a bar with the time left on a terminal, otherwise a plain line now and
// then.
class Progress {
 public:
  enum class Style { Silent, Lines, Bar };
  // Bar where stderr is a terminal, else Lines; Silent if quiet.
  static Style choose(bool quiet);

  Progress(Style style, std::size_t total, std::string what);
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;
  void update(std::size_t done, std::string_view note);

 private:
  using Clock = std::chrono::steady_clock;
  Style style_;
  std::size_t total_;
  std::string what_;
  Clock::time_point start_ = Clock::now();
  Clock::time_point last_line_ = start_;
};

}  // namespace strandbake
