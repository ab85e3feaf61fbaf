#include "gpu/opencl.h"

#include <dlfcn.h>

#include <type_traits>

namespace strandbake {
namespace {

OpenCL load() {
  void* const library = dlopen("libOpenCL.so.1", RTLD_NOW | RTLD_LOCAL);
  if (library == nullptr) {
    throw DeviceError(std::string("no OpenCL library can be loaded (") + dlerror() +
                      "); install your graphics driver's OpenCL, or bake with --backend openmp");
  }
  OpenCL functions{};
  const auto find = [&](auto& function, const char* name) {
    void* const address = dlsym(library, name);
    if (address == nullptr) {
      throw DeviceError(std::string("libOpenCL.so.1 has no ") + name + "; OpenCL 1.2 or newer is needed");
    }
    function = reinterpret_cast<std::remove_reference_t<decltype(function)>>(address);
  };
#define F(name) find(functions.name, "cl" #name);
  STRANDBAKE_OPENCL_FUNCTIONS(F)
#undef F
  return functions;
}

}  // namespace

const OpenCL& opencl() {
  static const OpenCL functions = load();
  return functions;
}

std::string opencl_status_name(cl_int status) {
  switch (status) {
#define CASE(name) \
  case name:       \
    return #name;
    CASE(CL_DEVICE_NOT_FOUND)
    CASE(CL_DEVICE_NOT_AVAILABLE)
    CASE(CL_COMPILER_NOT_AVAILABLE)
    CASE(CL_MEM_OBJECT_ALLOCATION_FAILURE)
    CASE(CL_OUT_OF_RESOURCES)
    CASE(CL_OUT_OF_HOST_MEMORY)
    CASE(CL_BUILD_PROGRAM_FAILURE)
    CASE(CL_INVALID_VALUE)
    CASE(CL_INVALID_DEVICE)
    CASE(CL_INVALID_BINARY)
    CASE(CL_INVALID_BUILD_OPTIONS)
    CASE(CL_INVALID_KERNEL_NAME)
    CASE(CL_INVALID_KERNEL_ARGS)
    CASE(CL_INVALID_WORK_GROUP_SIZE)
    CASE(CL_INVALID_BUFFER_SIZE)
    CASE(CL_INVALID_COMMAND_QUEUE)
    CASE(CL_EXEC_STATUS_ERROR_FOR_EVENTS_IN_WAIT_LIST)
#undef CASE
    default:
      return "OpenCL error " + std::to_string(status);
  }
}

void check_opencl(cl_int status, const char* what) {
  if (status == CL_SUCCESS) return;
  const std::string message = std::string("the device cannot ") + what + ": " + opencl_status_name(status);
  if (status == CL_MEM_OBJECT_ALLOCATION_FAILURE || status == CL_INVALID_BUFFER_SIZE) throw DeviceMemoryError(message);
  throw DeviceError(message);
}

}  // namespace strandbake
