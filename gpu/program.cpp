#include "gpu/program.h"

#include <nettle/sha2.h>
#include <unistd.h>

#include <array>
#include <fstream>
#include <optional>
#include <sstream>
#include <system_error>
#include <vector>

namespace strandbake {
namespace {

using Digest = std::array<std::uint8_t, SHA256_DIGEST_SIZE>;

Digest digest_of(const std::vector<std::string_view>& parts) {
  sha256_ctx context;
  sha256_init(&context);
  for (const std::string_view part : parts) {
    // The length first, so that no text can pass for another one cut elsewhere.
    const std::string length = std::to_string(part.size()) + ":";
    sha256_update(&context, length.size(), reinterpret_cast<const std::uint8_t*>(length.data()));
    sha256_update(&context, part.size(), reinterpret_cast<const std::uint8_t*>(part.data()));
  }
  Digest digest;
  sha256_digest(&context, digest.size(), digest.data());
  return digest;
}

std::string hex(const Digest& digest) {
  std::string text;
  for (const std::uint8_t byte : digest) {
    text += "0123456789abcdef"[byte >> 4];
    text += "0123456789abcdef"[byte & 15];
  }
  return text;
}

// A file of the cache: the digest of the binary, then the binary. Drivers may crash on bytes that are not theirs.
std::optional<std::string> read_cached(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  std::ostringstream read;
  read << file.rdbuf();  // what cannot be read fails here; an iterator over it would throw
  const std::string bytes = read.str();
  constexpr std::size_t kHex = 2 * SHA256_DIGEST_SIZE;
  if (bytes.size() <= kHex) return std::nullopt;
  std::string binary = bytes.substr(kHex);
  if (bytes.substr(0, kHex) != hex(digest_of({binary}))) return std::nullopt;
  return binary;
}

void write_cached(const std::filesystem::path& path, const std::string& binary) {
  std::error_code error;
  std::filesystem::create_directories(path.parent_path(), error);
  // A name of our own first: two bakes may write the same entry, and each reader sees a whole one.
  const std::filesystem::path part = path.string() + "." + std::to_string(::getpid());
  {
    std::ofstream file(part, std::ios::binary);
    file << hex(digest_of({binary})) << binary;
    if (!file.flush()) error = std::make_error_code(std::errc::io_error);
  }
  if (!error) std::filesystem::rename(part, path, error);
  if (error) std::filesystem::remove(part, error);
}

std::string binary_of(cl_program program) {
  std::size_t size = 0;
  if (opencl().GetProgramInfo(program, CL_PROGRAM_BINARY_SIZES, sizeof size, &size, nullptr) != CL_SUCCESS) return {};
  std::string binary(size, '\0');
  unsigned char* to = reinterpret_cast<unsigned char*>(binary.data());
  if (opencl().GetProgramInfo(program, CL_PROGRAM_BINARIES, sizeof to, &to, nullptr) != CL_SUCCESS) return {};
  return binary;
}

std::string build_log(cl_program program, cl_device_id device) {
  std::size_t size = 0;
  if (opencl().GetProgramBuildInfo(program, device, CL_PROGRAM_BUILD_LOG, 0, nullptr, &size) != CL_SUCCESS) return {};
  std::string log(size, '\0');
  opencl().GetProgramBuildInfo(program, device, CL_PROGRAM_BUILD_LOG, size, log.data(), nullptr);
  while (!log.empty() && (log.back() == '\0' || log.back() == '\n')) log.pop_back();
  return log;
}

[[noreturn]] void fail(const std::string& log, const Device& device, const std::string& options, cl_int status) {
  std::string first = opencl_status_name(status);
  const std::size_t found = log.find("error");
  if (found != std::string::npos) {
    const std::size_t begin = log.rfind('\n', found) == std::string::npos ? 0 : log.rfind('\n', found) + 1;
    first = log.substr(begin, log.find('\n', found) - begin);
  }
  std::error_code error;
  const std::filesystem::path path =
      std::filesystem::temp_directory_path(error) / ("strandbake-opencl-" + std::to_string(::getpid()) + ".log");
  std::ofstream file(path);
  file << device.name << ", " << device.driver << "\n" << options << "\n" << log << "\n";
  throw DeviceError("the driver of " + device.name + " cannot build the solver: " + first +
                    (file.flush() ? "; the whole log is in " + path.string() : ""));
}

}  // namespace

BuiltProgram build_program(cl_context context, const Device& device, const std::string& options,
                           const std::filesystem::path& cache_folder) {
  return build_program(context, device, kProgramSource, options, cache_folder);
}

BuiltProgram build_program(cl_context context, const Device& device, const std::string& source,
                           const std::string& options, const std::filesystem::path& cache_folder) {
  const OpenCL& cl = opencl();
  std::filesystem::path path;
  if (!cache_folder.empty()) {
    path = cache_folder /
           (hex(digest_of({source, options, device.platform_name, device.name, device.version, device.driver})) +
            ".clbin");
    if (const auto binary = read_cached(path)) {
      const auto* bytes = reinterpret_cast<const unsigned char*>(binary->data());
      const std::size_t size = binary->size();
      cl_int loaded = CL_SUCCESS, status = CL_SUCCESS;
      Program program(cl.CreateProgramWithBinary(context, 1, &device.id, &size, &bytes, &loaded, &status));
      if (status == CL_SUCCESS && loaded == CL_SUCCESS &&
          cl.BuildProgram(program.get(), 1, &device.id, options.c_str(), nullptr, nullptr) == CL_SUCCESS) {
        return {std::move(program), true};
      }
    }
  }
  const char* text = source.data();
  const std::size_t length = source.size();
  cl_int status = CL_SUCCESS;
  Program program(cl.CreateProgramWithSource(context, 1, &text, &length, &status));
  check_opencl(status, "take the solver's program");
  status = cl.BuildProgram(program.get(), 1, &device.id, options.c_str(), nullptr, nullptr);
  if (status != CL_SUCCESS) fail(build_log(program.get(), device.id), device, options, status);
  if (!path.empty()) {
    if (const std::string binary = binary_of(program.get()); !binary.empty()) write_cached(path, binary);
  }
  return {std::move(program), false};
}

}  // namespace strandbake
