// How a parameter is declared: once, in a function fields(visitor, struct) beside the struct, one line each.
//
//   template <class V> void fields(V& v, WindParams& p) {
//     v("gust", p.gust, at_least(0).keyed(), "1", "How far the wind strays from its mean, as a share of it.");
//     v("local", p.local, "Local shape: keeps bends and curls.");                        // a nested struct
//   }
//
// The scene reader, its range checks, `strandbake check`, docs/SCENE.md, the key-framing and the provenance in the
// cache are visitors of it.
#pragma once

#include <Eigen/Core>
#include <limits>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace strandbake {

// What a text may be: one of these words, or anything where there are none.
struct Text {
  std::vector<const char*> choices;
};
inline Text any_text() {
  return {};
}
inline Text one_of(std::vector<const char*> choices) {
  return {std::move(choices)};
}

// What a switch may be.
struct Switch {};

// What a number may be. For a vector the range holds for each component.
struct Range {
  double low = -std::numeric_limits<double>::infinity();
  double high = std::numeric_limits<double>::infinity();
  bool low_open = false;  // low itself is outside
  bool is_keyed = false;  // a scene may give a table over time, {1 = 0.3, 48 = 0.8}, in place of one value

  constexpr Range keyed() const {
    Range r = *this;
    r.is_keyed = true;
    return r;
  }
  constexpr bool contains(double v) const { return (low_open ? v > low : v >= low) && v <= high; }  // false for NaN
};
constexpr Range any_number() {
  return {-std::numeric_limits<double>::max(), std::numeric_limits<double>::max()};
}
constexpr Range between(double low, double high) {
  return {low, high};
}
constexpr Range at_least(double low) {
  return {low, std::numeric_limits<double>::max()};
}
constexpr Range more_than(double low) {
  return {low, std::numeric_limits<double>::max(), true};
}

// A whole number that can be left to the program: in the range, or the word "auto", which empties the field.
struct RangeOrAuto {
  Range range;
};
constexpr RangeOrAuto or_auto(Range range) {
  return {range};
}

// A value over time: straight lines between keys, held before the first and after the last. A scalar uses x alone.
struct Curve {
  std::vector<double> frame;           // strictly increasing scene frames, at least one
  std::vector<Eigen::Vector3d> value;  // as many

  Eigen::Vector3d at(double when) const {
    if (when <= frame.front()) return value.front();
    for (std::size_t k = 1; k < frame.size(); ++k) {
      if (when < frame[k]) {
        const double u = (when - frame[k - 1]) / (frame[k] - frame[k - 1]);
        return value[k - 1] + u * (value[k] - value[k - 1]);
      }
    }
    return value.back();
  }
};

// A struct of parameters, some of which move over time: keys name the field by its dotted path, "local.stiffness".
template <class Params>
struct Animated {
  Params base;
  std::vector<std::pair<std::string, Curve>> keys;

  // The parameters at a scene frame (fractions are allowed).
  Params at(double frame) const;
};

namespace detail {

// Sets the one field whose dotted path matches; its twin for nested structs goes one level down.
struct SetField {
  std::string_view path;
  Eigen::Vector3d value;

  void operator()(std::string_view name, double& field, const Range&, const char*, const char*) {
    if (name == path) field = value.x();
  }
  void operator()(std::string_view name, Eigen::Vector3d& field, const Range&, const char*, const char*) {
    if (name == path) field = value;
  }
  // Only numbers and vectors can be keyed.
  template <class T, class Allowed>
  void operator()(std::string_view, T&, const Allowed&, const char*, const char*) {}
  template <class T>
  void operator()(std::string_view name, T& nested, const char*) {
    if (path.size() > name.size() && path.substr(0, name.size()) == name && path[name.size()] == '.') {
      SetField inner{path.substr(name.size() + 1), value};
      fields(inner, nested);
    }
  }
};

}  // namespace detail

template <class Params>
Params Animated<Params>::at(double frame) const {
  Params now = base;
  for (const auto& [path, curve] : keys) {
    detail::SetField set{path, curve.at(frame)};
    fields(set, now);
  }
  return now;
}

}  // namespace strandbake
