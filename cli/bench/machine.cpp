#include "cli/bench/machine.h"

#include <fmt/format.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <thread>

#include "cli/bench/build_info.h"
#include "cli/bench/commit.h"
#include "sim/solver.h"

namespace strandbake {
namespace {

std::string first_line(const std::filesystem::path& path) {
  std::ifstream in(path);
  std::string line;
  std::getline(in, line);
  return line;
}

// "AMD EPYC, family 25, model 1"; the numbers tell generations apart where a virtual machine hides the name.
std::string processor() {
  std::ifstream in("/proc/cpuinfo");
  std::string line, name = "unknown", family, model;
  while (std::getline(in, line) && !line.empty()) {
    const std::size_t colon = line.find(": ");
    if (colon == std::string::npos) continue;
    const std::string key = line.substr(0, line.find_first_of("\t:")), value = line.substr(colon + 2);
    if (key == "model name") name = value;
    if (key == "cpu family") family = ", family " + value;
    if (key == "model") model = ", model " + value;
  }
  return name + family + model;
}

// "L1 32K, L2 512K, L3 32768K"
std::string caches() {
  std::string text;
  const std::filesystem::path folder = "/sys/devices/system/cpu/cpu0/cache";
  for (int index = 0; index < 8; ++index) {
    const std::filesystem::path cache = folder / fmt::format("index{}", index);
    const std::string level = first_line(cache / "level"), type = first_line(cache / "type");
    if (level.empty() || type == "Instruction") continue;
    text += fmt::format("{}L{} {}", text.empty() ? "" : ", ", level, first_line(cache / "size"));
  }
  return text.empty() ? "unknown" : text;
}

}  // namespace

std::vector<std::pair<std::string, std::string>> describe_machine() {
  std::string lanes;
  for (const int width : available_lanes()) lanes += fmt::format("{}{}", lanes.empty() ? "" : ", ", width);
  const double memory = static_cast<double>(::sysconf(_SC_PHYS_PAGES)) * static_cast<double>(::sysconf(_SC_PAGESIZE));
  return {{"program", "strandbake " STRANDBAKE_BUILD_VERSION},
          {"commit", STRANDBAKE_COMMIT},
          {"processor", processor()},
          {"cores", fmt::format("{}", std::thread::hardware_concurrency())},
          {"caches", caches()},
          {"memory", fmt::format("{:.0f} GiB", memory / (1 << 30))},
          {"lanes", lanes},
          {"compiler", STRANDBAKE_BUILD_COMPILER},
          {"flags", STRANDBAKE_BUILD_FLAGS}};
}

}  // namespace strandbake
