#include "cli/console.h"

#include <fmt/format.h>
#include <unistd.h>

#include <cmath>
#include <cstdio>

namespace strandbake {

void print_error(std::string_view message) {
  fmt::print(stderr, "strandbake: error: {}\n", message);
}

void print_warning(std::string_view message) {
  fmt::print(stderr, "strandbake: warning: {}\n", message);
}

std::string count_faults(const Faults& faults) {
  return fmt::format("the scene has {} fault{}", faults.size(), faults.size() == 1 ? "" : "s");
}

void print_faults(const Faults& faults) {
  for (const Fault& fault : faults) fmt::print(stderr, "{}: {}\n", fault.place, fault.what);
  print_error(count_faults(faults));
}

std::string human_bytes(double bytes) {
  const char* const units[] = {"B", "KiB", "MiB", "GiB", "TiB"};
  std::size_t unit = 0;
  while (bytes >= 1024 && unit + 1 < std::size(units)) {
    bytes /= 1024;
    ++unit;
  }
  return unit == 0 ? fmt::format("{:.0f} B", bytes) : fmt::format("{:.1f} {}", bytes, units[unit]);
}

std::string human_seconds(double seconds) {
  if (seconds < 10) return fmt::format("{:.1f} s", seconds);
  const auto whole = std::lround(seconds);
  if (whole < 60) return fmt::format("{} s", whole);
  if (whole < 3600) return fmt::format("{} min {} s", whole / 60, whole % 60);
  return fmt::format("{} h {} min", whole / 3600, whole % 3600 / 60);
}

Progress::Style Progress::choose(bool quiet) {
  if (quiet) return Style::Silent;
  return isatty(STDERR_FILENO) != 0 ? Style::Bar : Style::Lines;
}

Progress::Progress(Style style, std::size_t total, std::string what)
    : style_(style), total_(total), what_(std::move(what)) {}

Progress::~Progress() {
  if (style_ == Style::Bar) fmt::print(stderr, "\r\033[K");
}

void Progress::update(std::size_t done, std::string_view note) {
  if (style_ == Style::Silent || total_ == 0) return;
  const auto now = Clock::now();
  const double elapsed = std::chrono::duration<double>(now - start_).count();
  const double left = done == 0 ? 0 : elapsed * static_cast<double>(total_ - done) / static_cast<double>(done);
  if (style_ == Style::Bar) {
    constexpr std::size_t kWidth = 30;
    const std::size_t full = kWidth * done / total_;
    fmt::print(stderr, "\r\033[K{} [{}{}] {}/{}  {} left  {}", what_, std::string(full, '#'),
               std::string(kWidth - full, '.'), done, total_, human_seconds(left), note);
    std::fflush(stderr);
    return;
  }
  constexpr auto kBetweenLines = std::chrono::seconds(5);
  if (now - last_line_ < kBetweenLines && done != total_) return;
  last_line_ = now;
  fmt::print(stderr, "{} {}/{}, {} left, {}\n", what_, done, total_, human_seconds(left), note);
}

}  // namespace strandbake
