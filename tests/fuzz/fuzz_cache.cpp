// libFuzzer target: caches with bytes changed. The input is a list of patches to a valid cache (offset u16, length
// u8, the bytes), because a random file hardly gets past HDF5's signature.
#include <unistd.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include "formats/cache.h"
#include "tests/formats/cache_sample.h"

// HDF5 asks for as much memory as a file says and copes when it gets none; and it leaks a little when it refuses a
// file.
extern "C" const char* __asan_default_options() {
  return "allocator_may_return_null=1:max_allocation_size_mb=512";
}
extern "C" int __lsan_is_turned_off() {
  return 1;
}

namespace {

std::filesystem::path scratch_path() {
  const std::filesystem::path memory = "/dev/shm";
  return (std::filesystem::is_directory(memory) ? memory : std::filesystem::temp_directory_path()) /
         ("strandbake_fuzz_" + std::to_string(::getpid()) + ".h5");
}

std::vector<char> valid_cache() {
  const std::filesystem::path path = scratch_path();
  const strandbake::CacheHeader header = strandbake::sample_header(3);
  const strandbake::CacheOptions options = {.velocity = true};
  {
    strandbake::CacheWriter writer(path, header, options);
    for (int number = 1; number <= 2; ++number) writer.write(strandbake::SampleFrame(header, options, number).frame);
    writer.finish();
  }
  std::ifstream file(path, std::ios::binary);
  std::vector<char> bytes(std::istreambuf_iterator<char>(file), {});
  std::filesystem::remove(path);
  return bytes;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const std::vector<char> valid = valid_cache();
  std::vector<char> bytes = valid;
  const std::uint8_t* const end = data + size;
  while (end - data > 3) {
    const std::size_t offset = static_cast<std::size_t>(data[0] + 256 * data[1]) % bytes.size();
    const std::size_t length =
        std::min<std::size_t>({data[2] % 9U + 1U, static_cast<std::size_t>(end - data - 3), bytes.size() - offset});
    std::copy_n(data + 3, length, bytes.begin() + static_cast<std::ptrdiff_t>(offset));
    data += 3 + length;
  }
  // A new file each time: HDF5 may keep a damaged one open and take the next file for the same by its inode.
  const std::filesystem::path path = scratch_path();
  std::ofstream(path, std::ios::binary).write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  try {
    const strandbake::CacheReader reader(path);
    std::vector<Eigen::Vector3f> vectors(reader.vertex_count());
    for (std::size_t index = 0; index < std::min<std::size_t>(reader.frame_count(), 3); ++index) {
      reader.read_position(index, vectors);
      if (reader.has_velocity()) reader.read_velocity(index, vectors);
    }
  } catch (const strandbake::InputError&) {
  }
  std::filesystem::remove(path);
  return 0;
}
