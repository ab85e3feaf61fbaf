// The devices of a machine that speak OpenCL.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "gpu/opencl.h"

namespace strandbake {

struct Device {
  cl_platform_id platform = nullptr;
  cl_device_id id = nullptr;
  std::string name, vendor, version, driver, platform_name;  // version: "OpenCL 1.2 ..."
  bool is_gpu = false;
  bool exact_float = false;          // division and square root are rounded right, so bytes are those of the CPU
  bool exact_double = false;         // has double precision (whose division and square root always are)
  bool shares_memory = false;        // with the CPU
  std::uint64_t memory = 0;          // [bytes]
  std::uint64_t largest_buffer = 0;  // [bytes]
  std::uint64_t local_memory = 0;    // [bytes], of a work-group
  std::size_t largest_group = 0;     // work-items
};

// All devices of all platforms, in the order in which OpenCL lists them: --device N means entry N. Throws DeviceError
// where no OpenCL can be loaded; may be empty.
std::vector<Device> list_devices();

// Device `number` of the list. Throws DeviceError where there is no such one.
Device find_device(int number);

// What `auto` takes: the first GPU whose bytes are those of the CPU; -1: none, or no OpenCL. Without a device node of
// a graphics driver no OpenCL is loaded.
int find_exact_gpu(bool needs_double);

// The first GPU of a list that computes exactly in the precision asked for; -1: none.
int exact_gpu_of(const std::vector<Device>& devices, bool needs_double);

}  // namespace strandbake
