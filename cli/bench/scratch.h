// A folder for the files of a benchmark, gone at its end.
#pragma once

#include <filesystem>
#include <string>

namespace strandbake {

class Scratch {
 public:
  // A new folder in `parent`. Throws DiskError.
  explicit Scratch(const std::filesystem::path& parent);
  ~Scratch();
  Scratch(const Scratch&) = delete;
  Scratch& operator=(const Scratch&) = delete;

  std::filesystem::path operator/(const std::filesystem::path& name) const { return folder_ / name; }

 private:
  std::filesystem::path folder_;
};

// Writes a small text file. Throws DiskError.
void write_text_file(const std::filesystem::path& path, const std::string& text);

}  // namespace strandbake
