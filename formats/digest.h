// sha256 of files, for the provenance in the cache, and of what comes piece by piece.
#pragma once

#include <cstddef>
#include <filesystem>
#include <memory>
#include <span>
#include <string>

namespace strandbake {

// 64 lower-case hexadecimal digits, as sha256sum prints them.
std::string sha256(std::span<const std::byte> bytes);
class Sha256 {
 public:
  Sha256();
  ~Sha256();
  void add(std::span<const std::byte> bytes);
  // As above. What is added after it begins anew.
  std::string finish();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

// Streams the file. Throws InputError if it cannot be read.
std::string sha256_file(const std::filesystem::path& path);

}  // namespace strandbake
