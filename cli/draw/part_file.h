// A file that appears under its name only when it is whole.
#pragma once

#include <cstddef>
#include <cstdio>
#include <filesystem>
#include <span>
#include <string_view>

#include "formats/error.h"

namespace strandbake {

// Writes `path` + ".PID.part", which is nobody else's; finish() puts it on the device and gives it its name. Left
// without finish(), nothing stays. Throws DiskError.
class PartFile {
 public:
  explicit PartFile(const std::filesystem::path& path);
  ~PartFile();
  PartFile(const PartFile&) = delete;
  PartFile& operator=(const PartFile&) = delete;

  const std::filesystem::path& path() const { return path_; }
  const std::filesystem::path& part() const { return part_; }
  void write(std::span<const std::byte> bytes);
  void write(std::string_view text) { write(std::as_bytes(std::span(text))); }
  void finish();

 private:
  [[noreturn]] void fail(const char* what, int error);

  std::filesystem::path path_, part_;
  std::FILE* file_ = nullptr;
};

}  // namespace strandbake
