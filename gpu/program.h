// The OpenCL program of a plan: the passes of sim/ and the kernels of gpu/kernels/ with the plan's constants, and the
// folder where built programs wait for the next bake.
#pragma once

#include <filesystem>
#include <string>

#include "gpu/devices.h"

namespace strandbake {

// The text of all passes and kernels, put together by the build.
extern const char* const kProgramSource;

struct BuiltProgram {
  Program program;
  bool from_cache = false;
};

// Builds for one device, or takes what an earlier call has left in `cache_folder` (empty: none). A file there that is
// damaged is built anew and replaced; a folder that cannot be written is no fault. Throws DeviceError where the text
// cannot be built: it tells the first error and the file that has the whole log.
BuiltProgram build_program(cl_context context, const Device& device, const std::string& options,
                           const std::filesystem::path& cache_folder);

// The same for any text.
BuiltProgram build_program(cl_context context, const Device& device, const std::string& source,
                           const std::string& options, const std::filesystem::path& cache_folder);

}  // namespace strandbake
