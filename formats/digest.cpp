#include "formats/digest.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <nettle/sha2.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <system_error>

#include "formats/error.h"

namespace strandbake {

namespace {

std::string hex_digest(sha256_ctx& context) {
  std::array<std::uint8_t, SHA256_DIGEST_SIZE> digest = {};
  sha256_digest(&context, digest.size(), digest.data());
  std::string text;
  for (const std::uint8_t byte : digest) text += fmt::format("{:02x}", byte);
  return text;
}

}  // namespace

std::string sha256(std::span<const std::byte> bytes) {
  sha256_ctx context;
  sha256_init(&context);
  sha256_update(&context, bytes.size(), reinterpret_cast<const std::uint8_t*>(bytes.data()));
  return hex_digest(context);
}

std::string sha256_file(const std::filesystem::path& path) {
  const auto refuse = [&path](int code) {
    return InputError(fmt::format("{}: cannot be read: {}", path.string(), std::generic_category().message(code)));
  };
  const int descriptor = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (descriptor < 0) throw refuse(errno);
  sha256_ctx context;
  sha256_init(&context);
  std::array<std::uint8_t, 65536> block;
  ssize_t count = 0;
  do {
    count = ::read(descriptor, block.data(), block.size());
    if (count > 0) sha256_update(&context, static_cast<std::size_t>(count), block.data());
  } while (count > 0 || (count < 0 && errno == EINTR));
  const int code = errno;
  ::close(descriptor);
  if (count < 0) throw refuse(code);
  return hex_digest(context);
}

}  // namespace strandbake
