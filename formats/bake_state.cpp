#include "formats/bake_state.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdint>
#include <string_view>
#include <system_error>
#include <utility>
#include <vector>

#include "formats/digest.h"

namespace strandbake {

namespace {

constexpr std::string_view kMagic = "strandbake state 1\n";
constexpr std::size_t kDigits = 64;

std::filesystem::path with_suffix(std::filesystem::path path, const char* suffix) {
  path += suffix;
  return path;
}

}  // namespace

std::string state_identity(const CacheHeader& header, const std::string& settings) {
  Sha256 sum;
  const auto add = [&](const std::string& text) { sum.add(std::as_bytes(std::span(text.c_str(), text.size() + 1))); };
  add(settings);
  add(header.program_version);
  add(header.scene_text);
  for (const auto* pairs : {&header.inputs, &header.parameters})
    for (const auto& [name, value] : *pairs) {
      add(name);
      add(value);
    }
  return sum.finish();
}

BakeStateFile::BakeStateFile(const std::filesystem::path& cache, std::string identity)
    : path_(with_suffix(cache, ".part.state")),
      new_path_(with_suffix(cache, ".part.state.new")),
      identity_(std::move(identity)) {}

// The magic, the identity, the frame, the state, and a digest of all that.
void BakeStateFile::write(int frame,
                          const std::function<void(const std::function<void(std::span<const std::byte>)>&)>& save) {
  std::ofstream file(new_path_, std::ios::binary);
  Sha256 sum;
  const auto put = [&](std::span<const std::byte> bytes) {
    sum.add(bytes);
    file.write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
  };
  put(std::as_bytes(std::span(kMagic)));
  put(std::as_bytes(std::span(identity_)));
  put(std::as_bytes(std::span(&frame, 1)));
  save(put);
  file << sum.finish();
  file.close();
  if (file) return;
  const int code = errno;
  std::error_code ignored;
  std::filesystem::remove(new_path_, ignored);
  throw DiskError(fmt::format("{}: cannot be written: {}", new_path_.string(), std::generic_category().message(code)));
}

void BakeStateFile::commit() {
  std::error_code ignored;  // the state before it stays
  std::filesystem::rename(new_path_, path_, ignored);
}

std::optional<int> BakeStateFile::find() {
  std::error_code error;
  const std::uint64_t bytes = std::filesystem::file_size(path_, error);
  constexpr std::size_t kHead = kMagic.size() + kDigits + sizeof(int);
  if (error || bytes < kHead + kDigits) return std::nullopt;
  file_ = std::ifstream(path_, std::ios::binary);
  Sha256 sum;
  std::vector<char> block(1 << 16);
  for (left_ = bytes - kDigits; left_ > 0;) {
    const std::size_t count = std::min<std::uint64_t>(left_, block.size());
    if (!file_.read(block.data(), static_cast<std::streamsize>(count))) return std::nullopt;
    sum.add(std::as_bytes(std::span(block).first(count)));
    left_ -= count;
  }
  std::array<char, kDigits> digest;
  if (!file_.read(digest.data(), digest.size()) || std::string_view(digest.data(), kDigits) != sum.finish())
    return std::nullopt;
  file_.seekg(0);
  std::string head(kMagic.size() + kDigits, '\0');
  int frame = 0;
  if (!file_.read(head.data(), static_cast<std::streamsize>(head.size())) || head != std::string(kMagic) + identity_ ||
      !file_.read(reinterpret_cast<char*>(&frame), sizeof frame))
    return std::nullopt;
  left_ = bytes - kHead - kDigits;
  return frame;
}

void BakeStateFile::read(std::span<std::byte> out) {
  if (out.size() > left_ || !file_.read(reinterpret_cast<char*>(out.data()), static_cast<std::streamsize>(out.size())))
    throw InputError(fmt::format("{}: ends too early; delete it", path_.string()));
  left_ -= out.size();
}

void BakeStateFile::require_end() const {
  if (left_ > 0) throw InputError(fmt::format("{}: holds more than was expected; delete it", path_.string()));
}

void BakeStateFile::remove() {
  std::error_code ignored;
  std::filesystem::remove(path_, ignored);
  std::filesystem::remove(new_path_, ignored);
}

}  // namespace strandbake
