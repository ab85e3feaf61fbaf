// sha256 of files, for the provenance in the cache.
#pragma once

#include <cstddef>
#include <filesystem>
#include <span>
#include <string>

namespace strandbake {

// 64 lower-case hexadecimal digits, as sha256sum prints them.
std::string sha256(std::span<const std::byte> bytes);
// Streams the file. Throws InputError if it cannot be read.
std::string sha256_file(const std::filesystem::path& path);

}  // namespace strandbake
