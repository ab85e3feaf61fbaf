#include "cli/bench/svg.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

namespace strandbake {
namespace {

constexpr double kWidth = 960, kMargin = 24, kHead = 64;
constexpr double kLinesHeight = 320, kBar = 13, kBarGap = 7;
// Okabe and Ito's colours, which people with colour blindness can tell apart.
constexpr std::array kColours = {"#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000"};

const char* colour(std::size_t series) {
  return kColours[series % kColours.size()];
}

std::string escaped(const std::string& text) {
  std::string out;
  for (const char c : text) {
    if (c == '<') {
      out += "&lt;";
    } else if (c == '>') {
      out += "&gt;";
    } else if (c == '&') {
      out += "&amp;";
    } else {
      out += c;
    }
  }
  return out;
}

std::string short_number(double value) {
  if (std::abs(value) >= 1e5) return fmt::format("{:.0f}k", value / 1000);
  return std::abs(value) >= 1000 ? fmt::format("{:.0f}", value) : fmt::format("{:.4g}", value);
}

struct Box {
  double left, top, right, bottom;
};

// Where the values of an axis lie, and its marks.
class Scale {
 public:
  Scale(const Axis& axis, double low, double high, double from, double to)
      : logarithmic_(axis.logarithmic), from_(from), to_(to) {
    if (logarithmic_) {
      mark_decades(low, high);
    } else {
      mark_steps(axis.from_zero ? std::min(0.0, low) : low, high);
    }
  }

  double at(double value) const {
    const double u = logarithmic_ ? std::log(value / low_) / std::log(high_ / low_) : (value - low_) / (high_ - low_);
    return from_ + u * (to_ - from_);
  }
  const std::vector<double>& marks() const { return marks_; }
  double low() const { return low_; }

 private:
  // 1, 2, 5 of each decade, or powers of ten where there are many.
  void mark_decades(double low, double high) {
    const bool many = high / low > 300;
    std::vector<double> all;
    for (int power = -12; power <= 12; ++power) {
      for (const double digit : {1.0, 2.0, 5.0}) {
        if (digit == 1 || !many) all.push_back(digit * std::pow(10.0, power));
      }
    }
    low_ = *std::prev(std::ranges::upper_bound(all, low * (1 + 1e-9)));
    high_ = *std::ranges::lower_bound(all, high * (1 - 1e-9));
    if (high_ <= low_) high_ = *std::ranges::upper_bound(all, low_ * (1 + 1e-9));
    for (const double mark : all) {
      if (mark >= low_ * (1 - 1e-9) && mark <= high_ * (1 + 1e-9)) marks_.push_back(mark);
    }
  }
  void mark_steps(double low, double high) {
    if (high <= low) high = low + 1;
    const double rough = (high - low) / 5, power = std::pow(10.0, std::floor(std::log10(rough)));
    const double digit = rough / power;
    const double step = power * (digit <= 1 ? 1 : digit <= 2 ? 2 : digit <= 5 ? 5 : 10);
    low_ = std::floor(low / step + 1e-9) * step;
    high_ = std::ceil(high / step - 1e-9) * step;
    for (double k = 0; low_ + k * step <= high_ + step / 2; ++k) marks_.push_back(low_ + k * step);
  }

  bool logarithmic_;
  double from_, to_;
  double low_ = 0, high_ = 1;
  std::vector<double> marks_;
};

class Drawing {
 public:
  std::string body;

  void text(double x, double y, const std::string& words, const char* anchor = "start", const char* style = "") {
    body += fmt::format("<text x=\"{:.1f}\" y=\"{:.1f}\" text-anchor=\"{}\"{}>{}</text>\n", x, y, anchor, style,
                        escaped(words));
  }
  void line(double x0, double y0, double x1, double y1, const char* stroke) {
    body += fmt::format("<line x1=\"{:.1f}\" y1=\"{:.1f}\" x2=\"{:.1f}\" y2=\"{:.1f}\" stroke=\"{}\"/>\n", x0, y0, x1,
                        y1, stroke);
  }
  void rectangle(double x, double y, double width, double height, const char* fill) {
    body += fmt::format("<rect x=\"{:.1f}\" y=\"{:.1f}\" width=\"{:.1f}\" height=\"{:.1f}\" fill=\"{}\"/>\n", x, y,
                        width, height, fill);
  }
  void legend(const Panel& panel, double x, double y) {
    for (std::size_t s = 0; s < panel.series.size(); ++s) {
      if (panel.series[s].name.empty()) continue;
      rectangle(x, y - 9, 12, 10, colour(s));
      text(x + 17, y, panel.series[s].name);
      x += 36 + 6.4 * static_cast<double>(panel.series[s].name.size());
    }
  }
};

// Lowest and highest of all points, by `pick`; of the positive ones where the axis is logarithmic.
template <class Pick>
std::pair<double, double> span_of(const Panel& panel, bool logarithmic, Pick pick) {
  double low = std::numeric_limits<double>::infinity(), high = -low;
  for (const Series& series : panel.series) {
    for (const auto& point : series.points) {
      const double value = pick(point);
      if (logarithmic && value <= 0) continue;
      low = std::min(low, value);
      high = std::max(high, value);
    }
  }
  return low <= high ? std::pair(low, high) : std::pair(1.0, 10.0);
}

void mark_x(Drawing& to, const Scale& scale, const Box& plot, const std::string& label) {
  for (const double mark : scale.marks()) {
    to.line(scale.at(mark), plot.top, scale.at(mark), plot.bottom, "#dddddd");
    to.text(scale.at(mark), plot.bottom + 15, short_number(mark), "middle");
  }
  to.text((plot.left + plot.right) / 2, plot.bottom + 33, label, "middle");
}

void draw_lines(Drawing& to, const Panel& panel, const Box& box) {
  to.text(box.left, box.top + 14, panel.title, "start", " font-weight=\"bold\"");
  to.legend(panel, box.left + 8, box.top + 34);
  const Box plot = {box.left + 56, box.top + 46, box.right - 12, box.bottom - 48};
  const auto [x_low, x_high] = span_of(panel, panel.x.logarithmic, [](const auto& p) { return p.first; });
  const auto [y_low, y_high] = span_of(panel, panel.y.logarithmic, [](const auto& p) { return p.second; });
  const Scale x(panel.x, x_low, x_high, plot.left, plot.right);
  const Scale y(panel.y, y_low, y_high, plot.bottom, plot.top);
  mark_x(to, x, plot, panel.x.label);
  for (const double mark : y.marks()) {
    to.line(plot.left, y.at(mark), plot.right, y.at(mark), "#dddddd");
    to.text(plot.left - 6, y.at(mark) + 4, short_number(mark), "end");
  }
  const double middle = (plot.top + plot.bottom) / 2, side = box.left + 12;
  to.body += fmt::format(
      "<text x=\"{0:.1f}\" y=\"{1:.1f}\" text-anchor=\"middle\" transform=\"rotate(-90 {0:.1f} {1:.1f})\">{2}</text>\n",
      side, middle, escaped(panel.y.label));
  for (std::size_t s = 0; s < panel.series.size(); ++s) {
    std::string path;
    for (const auto& point : panel.series[s].points) {
      if ((panel.x.logarithmic && point.first <= 0) || (panel.y.logarithmic && point.second <= 0)) continue;
      path += fmt::format("{:.1f},{:.1f} ", x.at(point.first), y.at(point.second));
      to.body += fmt::format("<circle cx=\"{:.1f}\" cy=\"{:.1f}\" r=\"3\" fill=\"{}\"/>\n", x.at(point.first),
                             y.at(point.second), colour(s));
    }
    to.body +=
        fmt::format("<polyline points=\"{}\" fill=\"none\" stroke=\"{}\" stroke-width=\"1.6\"/>\n", path, colour(s));
  }
}

double bars_height(const Panel& panel) {
  const auto rows = static_cast<double>(panel.names.size());
  return 46 + rows * (kBar * static_cast<double>(panel.series.size()) + kBarGap) + 48;
}

void draw_bars(Drawing& to, const Panel& panel, const Box& box) {
  to.text(box.left, box.top + 14, panel.title, "start", " font-weight=\"bold\"");
  to.legend(panel, box.left + 8, box.top + 34);
  std::size_t longest = 0;
  for (const std::string& name : panel.names) longest = std::max(longest, name.size());
  const Box plot = {box.left + 16 + 6.6 * static_cast<double>(longest), box.top + 46, box.right - 60, box.bottom - 48};
  const auto [low, high] = span_of(panel, panel.x.logarithmic, [](const auto& p) { return p.second; });
  const Scale x(panel.x, low, high, plot.left, plot.right);
  mark_x(to, x, plot, panel.x.label);
  const double group = kBar * static_cast<double>(panel.series.size()) + kBarGap;
  for (std::size_t n = 0; n < panel.names.size(); ++n) {
    to.text(plot.left - 8, plot.top + group * static_cast<double>(n) + group / 2 + 4, panel.names[n], "end");
  }
  const double zero = x.at(panel.x.logarithmic ? x.low() : 0);
  for (std::size_t s = 0; s < panel.series.size(); ++s) {
    for (const auto& [name, length] : panel.series[s].points) {
      if (panel.x.logarithmic && length <= 0) continue;
      const double top = plot.top + group * name + kBarGap / 2 + kBar * static_cast<double>(s);
      const double end = x.at(length);
      to.rectangle(std::min(zero, end), top, std::abs(end - zero), kBar - 2, colour(s));
      to.text(std::max(zero, end) + 4, top + 10, fmt::format("{:.3g}", length), "start", " font-size=\"10\"");
    }
  }
}

}  // namespace

std::string svg_of(const Figure& figure) {
  Drawing drawing;
  drawing.text(kMargin, 28, figure.title, "start", " font-size=\"17\" font-weight=\"bold\"");
  drawing.text(kMargin, 48, figure.note, "start", " fill=\"#555555\"");
  double top = kHead;
  bool left_taken = false;
  constexpr double kHalf = kWidth / 2;
  for (const Panel& panel : figure.panels) {
    if (!panel.names.empty()) {
      if (left_taken) top += kLinesHeight;
      left_taken = false;
      const double height = bars_height(panel);
      draw_bars(drawing, panel, {kMargin, top, kWidth - kMargin, top + height});
      top += height;
    } else {
      const double left = left_taken ? kHalf : 0;
      draw_lines(drawing, panel, {left + kMargin, top, left + kHalf - kMargin / 2, top + kLinesHeight});
      if (left_taken) top += kLinesHeight;
      left_taken = !left_taken;
    }
  }
  if (left_taken) top += kLinesHeight;
  return fmt::format(
      "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n"
      "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {0:.0f} {1:.0f}\" width=\"{0:.0f}\" height=\"{1:.0f}\" "
      "font-family=\"Helvetica, Arial, sans-serif\" font-size=\"12\">\n"
      "<rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n{2}</svg>\n",
      kWidth, top + kMargin, drawing.body);
}

}  // namespace strandbake
