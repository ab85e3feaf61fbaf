// The verbs of the program, one file each. A verb adds its options to the command line and says what to run.
#pragma once

#include <cstddef>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

namespace CLI {
class App;
}

namespace strandbake {

// Exit codes of every verb.
enum ExitCode {
  kGood = 0,
  kInvalid = 1,    // the result is not what was asked for
  kUsage = 2,      // the command line makes no sense
  kInput = 3,      // a scene, groom, animation or cache cannot be used
  kDevice = 4,     // a device is missing or has failed
  kDisk = 5,       // an output cannot be written
  kNonFinite = 6,  // the simulation left the numbers
  kInterrupted = 130,
};

// Called after parsing; returns the exit code.
using Verb = std::function<int()>;

Verb add_bake(CLI::App& app);
Verb add_check(CLI::App& app);
Verb add_info(CLI::App& app);
Verb add_compare(CLI::App& app);
Verb add_digest(CLI::App& app);
Verb add_preview(CLI::App& app);
Verb add_view(CLI::App& app);
Verb add_groom(CLI::App& app);
Verb add_devices(CLI::App& app);
Verb add_docs(CLI::App& app);
Verb add_bench(CLI::App& app);

// For --frames: empty, or what is wrong with the text.
std::string check_frames(const std::string& text);

// How many threads a bake takes where nobody says: all cores, or as many as the groom keeps busy. Starting more and
// waiting for them takes longer than what they would do.
int default_threads(std::size_t vertices);

// What bake and check share: the scene and how it is changed from the command line.
struct SceneOptions {
  std::filesystem::path scene;
  std::vector<std::string> overrides;
  std::vector<std::filesystem::path> search;
  void add_to(CLI::App& app);
};

}  // namespace strandbake
