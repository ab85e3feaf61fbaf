#include "cli/draw/part_file.h"

#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <string>
#include <system_error>
#include <utility>

namespace strandbake {

PartFile::PartFile(const std::filesystem::path& path)
    : path_(path), part_(path.string() + "." + std::to_string(::getpid()) + ".part") {
  file_ = std::fopen(part_.c_str(), "wb");
  if (file_ == nullptr) throw DiskError(path_.string() + ": cannot create the file: " + std::strerror(errno));
}

PartFile::~PartFile() {
  if (file_ == nullptr) return;
  std::fclose(file_);
  std::error_code ignored;
  std::filesystem::remove(part_, ignored);
}

void PartFile::write(std::span<const std::byte> bytes) {
  if (!bytes.empty() && std::fwrite(bytes.data(), 1, bytes.size(), file_) != bytes.size())
    fail("write the file", errno);
}

void PartFile::finish() {
  if (std::fflush(file_) != 0 || ::fsync(::fileno(file_)) != 0) fail("write the file", errno);
  if (std::rename(part_.c_str(), path_.c_str()) != 0) fail("give the file its name", errno);
  std::fclose(std::exchange(file_, nullptr));
}

void PartFile::fail(const char* what, int error) {
  throw DiskError(path_.string() + ": cannot " + what + ": " + std::strerror(error));
}

}  // namespace strandbake
