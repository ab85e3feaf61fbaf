#include "cli/bench/head_motion.h"

#include <fmt/format.h>

#include <cmath>
#include <numbers>

namespace strandbake {

std::string swaying_head_bvh(int frames, double fps) {
  std::string text = fmt::format(
      "HIERARCHY\nROOT Head\n{{\n  OFFSET 0 0 0\n  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation "
      "Yrotation\n  End Site\n  {{\n    OFFSET 0 0.1 0\n  }}\n}}\nMOTION\nFrames: {}\nFrame Time: {:.9f}\n",
      frames, 1 / fps);
  for (int frame = 0; frame < frames; ++frame) {
    text += fmt::format("{:.6f} 0 0 0 0 {:.6f}\n", 0.1 * std::sin(0.07 * frame),
                        0.3 * 180 / std::numbers::pi * std::sin(0.1 * frame));
  }
  return text;
}

}  // namespace strandbake
