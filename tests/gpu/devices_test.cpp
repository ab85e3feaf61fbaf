#include "gpu/devices.h"

#include <catch2/catch.hpp>
#include <cstdlib>

#include "tests/gpu/test_devices.h"

using namespace strandbake;

namespace {

std::string message_of(int number) {
  try {
    find_device(number);
  } catch (const DeviceError& e) {
    return e.what();
  }
  return {};
}

Device made_up(bool is_gpu, bool exact_float, bool exact_double) {
  Device device;
  device.is_gpu = is_gpu;
  device.exact_float = exact_float;
  device.exact_double = exact_double;
  return device;
}

}  // namespace

TEST_CASE("devices are found by their number, and told apart from those that do not exist") {
  if (devices().empty()) return;
  const int count = static_cast<int>(devices().size());
  for (int number = 0; number < count; ++number) {
    const Device device = find_device(number);
    CHECK(device.id == devices()[static_cast<std::size_t>(number)].id);
    CHECK_FALSE(device.name.empty());
    CHECK(device.version.substr(0, 7) == "OpenCL ");
    CHECK(device.memory > 0);
    CHECK(device.largest_buffer > 0);
    CHECK(device.local_memory > 0);
    CHECK(device.largest_group > 0);
  }
  const std::string there_are = count == 1 ? "device 0 alone" : "devices 0 to " + std::to_string(count - 1);
  for (const int number : {-1, count, 1000000}) {
    CHECK(message_of(number) ==
          "there is no device " + std::to_string(number) + "; `strandbake devices` lists " + there_are);
  }
}

TEST_CASE("without a driver there is no device, and one sentence says so", "[no-driver]") {
  // Only in the process that ctest starts without one.
  if (std::getenv("STRANDBAKE_NO_DRIVER") == nullptr) return;
  CHECK(list_devices().empty());
  CHECK(message_of(0).substr(0, 41) == "OpenCL is installed but lists no device; ");
  CHECK(find_exact_gpu(false) == -1);
}

TEST_CASE("auto takes the first GPU that computes exactly") {
  const Device cpu = made_up(false, true, true), plain = made_up(true, false, false),
               floats = made_up(true, true, false), doubles = made_up(true, false, true),
               full = made_up(true, true, true);
  CHECK(exact_gpu_of({}, false) == -1);
  CHECK(exact_gpu_of({cpu}, false) == -1);
  CHECK(exact_gpu_of({cpu, plain}, false) == -1);
  CHECK(exact_gpu_of({cpu, plain, floats, full}, false) == 2);
  CHECK(exact_gpu_of({cpu, plain, floats, full}, true) == 3);
  CHECK(exact_gpu_of({plain, doubles, floats}, true) == 1);
  CHECK(exact_gpu_of({plain, doubles, floats}, false) == 2);
  CHECK(exact_gpu_of({floats, floats}, true) == -1);
}
