// OpenCL, found and loaded when it is first asked for: the program neither links it nor needs it to start.
#pragma once

#define CL_TARGET_OPENCL_VERSION 120
#include <CL/cl.h>

#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace strandbake {

// What a device, or the lack of one, prevents. One sentence.
class DeviceError : public std::runtime_error {
  using std::runtime_error::runtime_error;
};
// Memory that a device does not have.
class DeviceMemoryError : public DeviceError {
  using DeviceError::DeviceError;
};

// The functions that are used of OpenCL 1.2, by their names without "cl".
struct OpenCL {
// clang-format off
#define STRANDBAKE_OPENCL_FUNCTIONS(F) \
  F(GetPlatformIDs) F(GetPlatformInfo) F(GetDeviceIDs) F(GetDeviceInfo) F(CreateContext) F(ReleaseContext) \
  F(CreateCommandQueue) F(ReleaseCommandQueue) F(CreateBuffer) F(ReleaseMemObject) F(CreateProgramWithSource) \
  F(CreateProgramWithBinary) F(BuildProgram) F(GetProgramInfo) F(GetProgramBuildInfo) F(ReleaseProgram) \
  F(CreateKernel) F(ReleaseKernel) F(SetKernelArg) F(EnqueueNDRangeKernel) F(EnqueueReadBuffer) \
  F(EnqueueWriteBuffer) F(EnqueueMapBuffer) F(EnqueueUnmapMemObject) F(WaitForEvents) F(GetEventProfilingInfo) F(ReleaseEvent) F(Flush) F(Finish)
// clang-format on
#define F(name) decltype(&::cl##name) name;
  STRANDBAKE_OPENCL_FUNCTIONS(F)
#undef F
};

// Loads the library. Throws DeviceError where there is none; the next call tries again.
const OpenCL& opencl();

// Throws DeviceError, or DeviceMemoryError, where `status` is no success. `what` was tried: "run a kernel".
void check_opencl(cl_int status, const char* what);

// The name of a status as OpenCL has it, "CL_OUT_OF_RESOURCES".
std::string opencl_status_name(cl_int status);

// Owns an object of OpenCL.
template <class Handle, auto Release>
class Owned {
 public:
  Owned() = default;
  explicit Owned(Handle handle) : handle_(handle) {}
  Owned(Owned&& other) noexcept : handle_(std::exchange(other.handle_, nullptr)) {}
  Owned& operator=(Owned&& other) noexcept {
    std::swap(handle_, other.handle_);
    return *this;
  }
  ~Owned() {
    if (handle_ != nullptr) (opencl().*Release)(handle_);
  }
  Handle get() const { return handle_; }
  explicit operator bool() const { return handle_ != nullptr; }

 private:
  Handle handle_ = nullptr;
};
using Context = Owned<cl_context, &OpenCL::ReleaseContext>;
using Queue = Owned<cl_command_queue, &OpenCL::ReleaseCommandQueue>;
using Buffer = Owned<cl_mem, &OpenCL::ReleaseMemObject>;
using Program = Owned<cl_program, &OpenCL::ReleaseProgram>;
using Kernel = Owned<cl_kernel, &OpenCL::ReleaseKernel>;
using Event = Owned<cl_event, &OpenCL::ReleaseEvent>;

}  // namespace strandbake
