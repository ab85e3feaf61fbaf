#include "gpu/devices.h"

#include <algorithm>
#include <filesystem>
#include <system_error>

namespace strandbake {
namespace {

// 0 where the device does not answer: drivers of devices without double precision may not.
template <class T>
T number(cl_device_id device, cl_device_info what) {
  T value{};
  if (opencl().GetDeviceInfo(device, what, sizeof value, &value, nullptr) != CL_SUCCESS) return T{};
  return value;
}

std::string without_padding(std::string text) {
  text.resize(text.find_last_not_of(std::string(" \0", 2)) + 1);
  return text.substr(std::min(text.find_first_not_of(' '), text.size()));
}

// `query`: clGetDeviceInfo or clGetPlatformInfo.
template <class Query, class Object>
std::string text(Query query, Object object, cl_uint what) {
  std::size_t size = 0;
  check_opencl(query(object, what, 0, nullptr, &size), "tell about itself");
  std::string value(size, '\0');
  check_opencl(query(object, what, size, value.data(), nullptr), "tell about itself");
  return without_padding(value);
}

Device describe(cl_platform_id platform, cl_device_id id) {
  const OpenCL& cl = opencl();
  Device device;
  device.platform = platform;
  device.id = id;
  device.platform_name = text(cl.GetPlatformInfo, platform, CL_PLATFORM_NAME);
  device.name = text(cl.GetDeviceInfo, id, CL_DEVICE_NAME);
  device.vendor = text(cl.GetDeviceInfo, id, CL_DEVICE_VENDOR);
  device.version = text(cl.GetDeviceInfo, id, CL_DEVICE_VERSION);
  device.driver = text(cl.GetDeviceInfo, id, CL_DRIVER_VERSION);
  const auto type = number<cl_device_type>(id, CL_DEVICE_TYPE);
  device.is_gpu = (type & CL_DEVICE_TYPE_GPU) != 0;
  // All that the CPU's bytes rest on. A CPU divides exactly, whether its driver says so or not.
  constexpr cl_device_fp_config kExact =
      CL_FP_CORRECTLY_ROUNDED_DIVIDE_SQRT | CL_FP_DENORM | CL_FP_INF_NAN | CL_FP_ROUND_TO_NEAREST;
  device.exact_float = (number<cl_device_fp_config>(id, CL_DEVICE_SINGLE_FP_CONFIG) & kExact) == kExact ||
                       (type & CL_DEVICE_TYPE_CPU) != 0;
  device.exact_double = number<cl_device_fp_config>(id, CL_DEVICE_DOUBLE_FP_CONFIG) != 0;
  device.shares_memory = number<cl_bool>(id, CL_DEVICE_HOST_UNIFIED_MEMORY) != CL_FALSE;
  device.memory = number<cl_ulong>(id, CL_DEVICE_GLOBAL_MEM_SIZE);
  device.largest_buffer = number<cl_ulong>(id, CL_DEVICE_MAX_MEM_ALLOC_SIZE);
  device.local_memory = number<cl_ulong>(id, CL_DEVICE_LOCAL_MEM_SIZE);
  device.largest_group = number<std::size_t>(id, CL_DEVICE_MAX_WORK_GROUP_SIZE);
  return device;
}

}  // namespace

std::vector<Device> list_devices() {
  const OpenCL& cl = opencl();
  std::vector<Device> devices;
  cl_uint count = 0;
  // An ICD loader that knows no platform answers with an error of its own, -1001.
  if (cl.GetPlatformIDs(0, nullptr, &count) != CL_SUCCESS || count == 0) return devices;
  std::vector<cl_platform_id> platforms(count);
  check_opencl(cl.GetPlatformIDs(count, platforms.data(), nullptr), "list its platforms");
  for (cl_platform_id platform : platforms) {
    if (cl.GetDeviceIDs(platform, CL_DEVICE_TYPE_ALL, 0, nullptr, &count) != CL_SUCCESS || count == 0) continue;
    std::vector<cl_device_id> ids(count);
    check_opencl(cl.GetDeviceIDs(platform, CL_DEVICE_TYPE_ALL, count, ids.data(), nullptr), "list its devices");
    for (cl_device_id id : ids) {
      try {
        devices.push_back(describe(platform, id));
      } catch (const DeviceError&) {
        // One that cannot say what it is must not hide the others.
      }
    }
  }
  return devices;
}

Device find_device(int number) {
  const std::vector<Device> devices = list_devices();
  if (devices.empty()) {
    throw DeviceError(
        "OpenCL is installed but lists no device; install the driver of your graphics card, or bake "
        "with --backend openmp");
  }
  if (number < 0 || static_cast<std::size_t>(number) >= devices.size()) {
    throw DeviceError(
        "there is no device " + std::to_string(number) + "; `strandbake devices` lists " +
        (devices.size() == 1 ? std::string("device 0 alone") : "devices 0 to " + std::to_string(devices.size() - 1)));
  }
  return devices[static_cast<std::size_t>(number)];
}

int exact_gpu_of(const std::vector<Device>& devices, bool needs_double) {
  for (std::size_t d = 0; d < devices.size(); ++d) {
    if (devices[d].is_gpu && (needs_double ? devices[d].exact_double : devices[d].exact_float)) {
      return static_cast<int>(d);
    }
  }
  return -1;
}

int find_exact_gpu(bool needs_double) {
  std::error_code error;
  bool has_node = false;
  for (const char* node : {"/dev/dri", "/dev/nvidiactl", "/dev/kfd", "/dev/dxg"}) {
    has_node |= std::filesystem::exists(node, error);
  }
  if (!has_node) return -1;
  try {
    return exact_gpu_of(list_devices(), needs_double);
  } catch (const DeviceError&) {
    return -1;
  }
}

}  // namespace strandbake
