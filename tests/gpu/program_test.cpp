// The folder of built programs, and what a driver's refusal is told as.
#include "gpu/program.h"

#include <catch2/catch.hpp>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <optional>

#include "tests/gpu/test_devices.h"

using namespace strandbake;
namespace fs = std::filesystem;

namespace {

const char* const kDoubler = "__kernel void doubler(__global float* x) { x[get_global_id(0)] *= FACTOR; }\n";

struct Bench {
  Device device;
  Context context;
  Queue queue;

  explicit Bench(const Device& of) : device(of) {
    cl_int status = CL_SUCCESS;
    context = Context(opencl().CreateContext(nullptr, 1, &device.id, nullptr, nullptr, &status));
    check_opencl(status, "be opened");
    queue = Queue(opencl().CreateCommandQueue(context.get(), device.id, 0, &status));
    check_opencl(status, "open a queue");
  }

  // What the program makes of 3.
  float result(const BuiltProgram& built) const {
    const OpenCL& cl = opencl();
    cl_int status = CL_SUCCESS;
    float x = 3;
    const Kernel kernel(cl.CreateKernel(built.program.get(), "doubler", &status));
    check_opencl(status, "make a kernel");
    const Buffer buffer(
        cl.CreateBuffer(context.get(), CL_MEM_READ_WRITE | CL_MEM_COPY_HOST_PTR, sizeof x, &x, &status));
    check_opencl(status, "reserve memory");
    cl_mem const handle = buffer.get();
    check_opencl(cl.SetKernelArg(kernel.get(), 0, sizeof handle, &handle), "take an argument");
    const std::size_t one = 1;
    check_opencl(cl.EnqueueNDRangeKernel(queue.get(), kernel.get(), 1, nullptr, &one, nullptr, 0, nullptr, nullptr),
                 "run");
    check_opencl(cl.EnqueueReadBuffer(queue.get(), handle, CL_TRUE, 0, sizeof x, &x, 0, nullptr, nullptr), "read");
    return x;
  }
};

std::optional<Bench> bench() {
  if (devices().empty()) return std::nullopt;
  return std::optional<Bench>(std::in_place, devices().front());
}

// Of a test, removed at its end.
struct Folder {
  fs::path path;
  Folder() {
    std::string name = (fs::temp_directory_path() / "strandbake-programs-XXXXXX").string();
    REQUIRE(mkdtemp(name.data()) != nullptr);
    path = name;
  }
  ~Folder() { fs::remove_all(path); }
  std::vector<fs::path> files() const {
    std::vector<fs::path> found;
    for (const auto& entry : fs::directory_iterator(path)) found.push_back(entry.path());
    return found;
  }
};

std::string bytes_of(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}
void put(const fs::path& path, const std::string& bytes) {
  std::ofstream(path, std::ios::binary) << bytes;
}

}  // namespace

TEST_CASE("a program is built once, and once more for other options or another text") {
  const auto on = bench();
  if (!on) return;
  const Folder folder;
  const auto build = [&](const std::string& text, const char* options) {
    return build_program(on->context.get(), on->device, text, options, folder.path / "new" / "folder");
  };
  const BuiltProgram first = build(kDoubler, "-DFACTOR=2");
  CHECK_FALSE(first.from_cache);
  CHECK(on->result(first) == 6);
  const BuiltProgram second = build(kDoubler, "-DFACTOR=2");
  CHECK(second.from_cache);
  CHECK(on->result(second) == 6);
  const BuiltProgram other_options = build(kDoubler, "-DFACTOR=5");
  CHECK_FALSE(other_options.from_cache);
  CHECK(on->result(other_options) == 15);
  CHECK_FALSE(build(kDoubler + std::string("\n"), "-DFACTOR=2").from_cache);
}

TEST_CASE("a damaged program is built anew and replaced") {
  const auto on = bench();
  if (!on) return;
  const Folder folder;
  const auto build = [&] { return build_program(on->context.get(), on->device, kDoubler, "-DFACTOR=2", folder.path); };
  build();
  REQUIRE(folder.files().size() == 1);
  const fs::path file = folder.files().front();
  const std::string whole = bytes_of(file);
  std::string damaged = whole;
  SECTION("truncated") {
    damaged.resize(whole.size() / 2);
  }
  SECTION("cut in its digest") {
    damaged.resize(20);
  }
  SECTION("cut after its digest") {
    damaged.resize(64);
  }
  SECTION("empty") {
    damaged.clear();
  }
  SECTION("a bit of the program turned") {
    damaged[whole.size() - 100] ^= 4;
  }
  SECTION("a bit of the digest turned") {
    damaged[3] ^= 1;
  }
  SECTION("longer") {
    damaged += 'x';
  }
  put(file, damaged);
  const BuiltProgram rebuilt = build();
  CHECK_FALSE(rebuilt.from_cache);
  CHECK(on->result(rebuilt) == 6);
  CHECK(folder.files() == std::vector<fs::path>{file});
  const BuiltProgram replaced = build();
  CHECK(replaced.from_cache);
  CHECK(on->result(replaced) == 6);
}

TEST_CASE("a folder where the file should be is no fault") {
  const auto on = bench();
  if (!on) return;
  const Folder folder;
  const auto build = [&] { return build_program(on->context.get(), on->device, kDoubler, "-DFACTOR=2", folder.path); };
  build();
  const fs::path file = folder.files().front();
  fs::remove(file);
  fs::create_directories(file / "full");
  CHECK(on->result(build()) == 6);
  CHECK(folder.files() == std::vector<fs::path>{file});
}

TEST_CASE("a folder that cannot be written is no fault") {
  const auto on = bench();
  if (!on) return;
  for (const char* folder : {"/proc/nowhere", "/dev/null/programs", ""}) {
    CAPTURE(folder);
    for (int time = 0; time < 2; ++time) {
      const BuiltProgram built = build_program(on->context.get(), on->device, kDoubler, "-DFACTOR=2", fs::path(folder));
      CHECK_FALSE(built.from_cache);
      CHECK(on->result(built) == 6);
    }
  }
}

TEST_CASE("a text with errors is refused with the first of them and the place of the log") {
  const auto on = bench();
  if (!on) return;
  const Folder folder;
  const std::string text =
      "__kernel void doubler(__global float* x) { x[0] = first_unknown; }\n"
      "__kernel void other(__global float* x) { x[0] = second_unknown; }\n";
  std::string message;
  try {
    build_program(on->context.get(), on->device, text, "", folder.path);
  } catch (const DeviceError& e) {
    message = e.what();
  }
  CAPTURE(message);
  CHECK(message.find(on->device.name) != std::string::npos);
  CHECK(message.find("first_unknown") != std::string::npos);
  CHECK(message.find("second_unknown") == std::string::npos);
  CHECK(message.find('\n') == std::string::npos);
  CHECK(folder.files().empty());
  const std::string before = "the whole log is in ";
  REQUIRE(message.find(before) != std::string::npos);
  const fs::path log = message.substr(message.find(before) + before.size());
  REQUIRE(fs::exists(log));
  CHECK(bytes_of(log).find("second_unknown") != std::string::npos);
  fs::remove(log);
}
