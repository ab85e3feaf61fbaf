// What bake.quality stands for: points on the front of run time against error (docs/ACCURACY.md).
#pragma once

namespace strandbake {

struct Quality {
  const char* name;
  int substeps;
  int local_method;
};
inline constexpr Quality kQualities[] = {{"draft", 1, 3}, {"normal", 4, 3}, {"fine", 16, 3}};

}  // namespace strandbake
