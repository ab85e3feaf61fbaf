// Plots as SVG: what the benchmarks need, lines over an axis and bars beside names.
#pragma once

#include <string>
#include <utility>
#include <vector>

namespace strandbake {

struct Axis {
  std::string label;  // with its unit
  bool logarithmic = false;
  bool from_zero = true;  // where it is not logarithmic
};

struct Series {
  std::string name;                               // empty: not in the legend
  std::vector<std::pair<double, double>> points;  // bars: (index of the name, length)
};

struct Panel {
  std::string title;
  Axis x, y;                       // bars: y is not used, and x is the axis of their lengths
  std::vector<std::string> names;  // of bars, from top to bottom; empty: lines
  std::vector<Series> series;      // points that are not positive are left out where the axis is logarithmic
};

struct Figure {
  std::string title;
  std::string note;  // a line below the title
  std::vector<Panel> panels;
};

// Panels two in a row; bars take a row of their own.
std::string svg_of(const Figure& figure);

}  // namespace strandbake
