// What region.hair stands for. Young's modulus, radius and density of dry hair as in C. R. Robbins, "Chemical and
// Physical Behavior of Human Hair"; water takes more than half of the modulus and swells hair by a seventh.
#pragma once

namespace strandbake {

struct HairPreset {
  const char* name;
  double young;    // [Pa]
  double radius;   // [m]
  double density;  // [kg/m^3]
};
inline constexpr HairPreset kHairPresets[] = {{"fine", 4e9, 25e-6, 1300},
                                              {"medium", 4e9, 35e-6, 1300},
                                              {"coarse", 4e9, 45e-6, 1300},
                                              {"wet", 1.6e9, 40e-6, 1280}};

}  // namespace strandbake
