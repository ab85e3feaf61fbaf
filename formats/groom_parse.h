// The inside of the groom readers: checked access to a file's bytes, one parser per format, and what they share.
#pragma once

#include <fmt/format.h>

#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>
#include <string>
#include <string_view>
#include <utility>

#include "formats/error.h"
#include "sim/groom.h"

namespace strandbake::detail {

static_assert(std::endian::native == std::endian::little, "the binary groom formats are little-endian");

// The bytes of a binary file. Nothing outside them is read, and no count is believed before it was compared with them.
class FileBytes {
 public:
  FileBytes(std::span<const std::byte> bytes, std::string name) : bytes_(bytes), name_(std::move(name)) {}

  std::uint64_t size() const { return bytes_.size(); }
  const std::string& name() const { return name_; }

  [[noreturn]] void fail(std::uint64_t offset, std::string_view what) const {
    throw InputError(fmt::format("{}: byte {}: {}", name_, offset, what));
  }

  // Throws unless `count` items of `stride` bytes lie at `offset`; returns where they end.
  std::uint64_t require(std::uint64_t offset, std::uint64_t count, std::uint64_t stride, std::string_view what) const {
    if (offset > size() || count > (size() - offset) / stride) {
      fail(offset, fmt::format("{} ({} times {} bytes) should be here, but the file ends at byte {}; it is cut or its "
                               "counts are wrong",
                               what, count, stride, size()));
    }
    return offset + count * stride;
  }

  template <class T>
  T get(std::uint64_t offset) const {
    require(offset, 1, sizeof(T), "a number");
    T value;
    std::memcpy(&value, bytes_.data() + offset, sizeof(T));
    return value;
  }

 private:
  std::span<const std::byte> bytes_;
  std::string name_;
};

Groom parse_hair(const FileBytes& file, Warnings& warnings);
Groom parse_tfx(const FileBytes& file, Warnings& warnings);
Groom parse_obj(std::string_view text, const std::string& name, Warnings& warnings);

// Refuses a strand with fewer than two vertices.
void require_two_vertices(const std::string& place, std::uint64_t strand, std::uint64_t vertices);

// Warns of bytes after the end of the groom.
void warn_of_extra_bytes(const FileBytes& file, std::uint64_t end, Warnings& warnings);

// The last step of every reader: refuses coordinates that are not finite floats, makes -0 to 0, counts coincident
// neighbours.
void check_positions(Groom& groom, const std::string& name, Warnings& warnings);

}  // namespace strandbake::detail
