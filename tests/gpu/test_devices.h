// The devices of the machine that runs the tests.
#pragma once

#include <catch2/catch.hpp>
#include <vector>

#include "gpu/devices.h"

namespace strandbake {

inline const std::vector<Device>& devices() {
  static const std::vector<Device> all = [] {
    try {
      return list_devices();
    } catch (const DeviceError&) {
      return std::vector<Device>();
    }
  }();
  if (all.empty()) WARN("skipped: there is no OpenCL device");
  return all;
}

}  // namespace strandbake
