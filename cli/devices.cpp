#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <memory>
#include <nlohmann/json.hpp>

#include "cli/console.h"
#include "cli/schemas.h"
#include "cli/verbs.h"
#include "gpu/devices.h"

namespace strandbake {
namespace {

int run_devices(bool json) {
  const std::vector<Device> devices = list_devices();
  nlohmann::ordered_json list = nlohmann::ordered_json::array();
  for (std::size_t d = 0; d < devices.size(); ++d) {
    const Device& device = devices[d];
    if (json) {
      list.push_back({{"device", d},
                      {"name", device.name},
                      {"vendor", device.vendor},
                      {"platform", device.platform_name},
                      {"version", device.version},
                      {"driver", device.driver},
                      {"gpu", device.is_gpu},
                      {"shares_memory", device.shares_memory},
                      {"memory", device.memory},
                      {"largest_buffer", device.largest_buffer},
                      {"local_memory", device.local_memory},
                      {"largest_group", device.largest_group},
                      {"exact_float", device.exact_float},
                      {"exact_double", device.exact_double}});
      continue;
    }
    fmt::print("device {}: {}\n", d, device.name);
    const auto line = [](const char* what, const std::string& value) { fmt::print("  {:<12}{}\n", what, value); };
    line("kind", device.is_gpu ? "GPU" : "CPU or other");
    line("vendor", device.vendor);
    line("version", fmt::format("{}, driver {}, of {}", device.version, device.driver, device.platform_name));
    line("memory", fmt::format("{}, one buffer at most {}, local {}, {} work-items a group",
                               human_bytes(static_cast<double>(device.memory)),
                               human_bytes(static_cast<double>(device.largest_buffer)),
                               human_bytes(static_cast<double>(device.local_memory)), device.largest_group));
    line("float", device.exact_float
                      ? "division and square root are exact: the bytes of the CPU"
                      : "division and square root are not exact: after a frame 5e-7 m from the CPU's hair (root "
                        "mean square), after many by more");
    line("double", device.exact_double ? "exact: the bytes of the CPU" : "none");
  }
  if (json) print_json("devices", {{"devices", list}});
  if (devices.empty()) {
    throw DeviceError("OpenCL is installed but lists no device; install the driver of your graphics card");
  }
  return kGood;
}

}  // namespace

Verb add_devices(CLI::App& app) {
  auto json = std::make_shared<bool>(false);
  app.add_flag("--json", *json, "As one JSON object");
  return [json] { return run_devices(*json); };
}

}  // namespace strandbake
