#include "formats/animation.h"

#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <cstdio>

#include "formats/quoted_list.h"
#include "formats/similar_names.h"

namespace strandbake {
namespace {

using Eigen::Matrix3d;
using Eigen::Matrix4d;
using Eigen::Quaterniond;
using Eigen::Vector3d;

Vector3d blend(const Vector3d& a, const Vector3d& b, double u) {
  return a + u * (b - a);
}

// Shortest-arc slerp by halving: the normalised sum of two unit quaternions is exactly half way, and once the arc is
// tiny the chord serves (its error goes with the cube of the angle). Unlike the closed form it needs no sin and acos,
// whose last bit differs between machines.
Quaterniond blend(const Quaterniond& from, const Quaterniond& to, double u) {
  Eigen::Vector4d a = from.coeffs();
  Eigen::Vector4d b = to.coeffs();
  if (a.dot(b) < 0) b = -b;
  for (int halving = 0; halving < 18; ++halving) {  // pi/2 / 2^18 = 6e-6, cubed: below the rounding of a double
    const Eigen::Vector4d middle = (a + b).normalized();
    if (u < 0.5) {
      b = middle;
      u = 2 * u;
    } else {
      a = middle;
      u = 2 * u - 1;
    }
  }
  const Eigen::Vector4d result = (a + u * (b - a)).normalized();
  return Quaterniond(result);
}

template <class T>
T sample(const Keys<T>& keys, double time, const T& none) {
  if (keys.time.empty()) return none;
  const auto next = std::upper_bound(keys.time.begin(), keys.time.end(), time);
  if (next == keys.time.begin()) return keys.value.front();
  const auto k = static_cast<std::size_t>(next - keys.time.begin()) - 1;
  if (next == keys.time.end() || time == keys.time[k]) return keys.value[k];
  return blend(keys.value[k], keys.value[k + 1], (time - keys.time[k]) / (keys.time[k + 1] - keys.time[k]));
}

Matrix4d local_matrix(const AnimationNode& node, double time) {
  if (!node.animated) return node.local;
  const Vector3d scale = sample(node.scale, time, Vector3d(1, 1, 1));
  Matrix4d m = Matrix4d::Identity();
  m.topLeftCorner<3, 3>() =
      sample(node.rotation, time, Quaterniond(1, 0, 0, 0)).toRotationMatrix() * scale.asDiagonal();
  m.topRightCorner<3, 1>() = sample(node.translation, time, Vector3d(0, 0, 0));
  return m;
}

std::string path_of(const std::vector<AnimationNode>& nodes, std::size_t node) {
  std::string path;
  for (int n = static_cast<int>(node); n >= 0; n = nodes[n].parent) {
    if (nodes[n].name.empty()) continue;
    path = path.empty() ? nodes[n].name : nodes[n].name + "/" + path;
  }
  return path;
}

// "Neck/Head" stands for every path that ends so, "/Root/Head" for that one alone.
bool matches(const std::string& path, std::string_view asked) {
  if (asked.front() == '/') return path == asked.substr(1);
  return path == asked || path.ends_with("/" + std::string(asked));
}

// The names nearest to what was asked for, best first, each once.
std::vector<std::string> nearest_nodes(const std::vector<AnimationNode>& nodes, std::string_view asked) {
  std::vector<std::string> names;
  for (const AnimationNode& node : nodes) {
    if (!node.name.empty()) names.push_back(node.name);
  }
  std::sort(names.begin(), names.end());
  names.erase(std::unique(names.begin(), names.end()), names.end());
  return nearest(asked.substr(asked.rfind('/') + 1), names, 4);
}

std::string seconds(double time) {
  char text[64];
  std::snprintf(text, sizeof text, "%.6g s", time);
  return text;
}

}  // namespace

std::size_t Animation::find_node(std::string_view name_or_path) const {
  const auto ask = [&] { return source + ": node \"" + std::string(name_or_path) + "\""; };
  if (name_or_path.empty()) throw InputError(source + ": the name of a node is empty");
  std::vector<std::size_t> found;
  for (std::size_t n = 0; n < nodes.size(); ++n) {
    if (nodes[n].name == name_or_path) found.push_back(n);
  }
  if (found.empty() && name_or_path.find('/') != std::string_view::npos) {
    for (std::size_t n = 0; n < nodes.size(); ++n) {
      if (!nodes[n].name.empty() && matches(path_of(nodes, n), name_or_path)) found.push_back(n);
    }
  }
  if (found.size() == 1) return found[0];
  if (found.empty()) {
    const std::vector<std::string> near = nearest_nodes(nodes, name_or_path);
    throw InputError(ask() + " is not there; " +
                     (near.empty() ? "no node of the file has a name" : "the closest names are " + quoted_list(near)));
  }
  std::vector<std::string> paths;
  for (const std::size_t n : found) paths.push_back(path_of(nodes, n));
  std::vector<std::string> distinct = paths;
  std::sort(distinct.begin(), distinct.end());
  const bool told_apart = std::unique(distinct.begin(), distinct.end()) == distinct.end();
  throw InputError(ask() + " stands for " + std::to_string(found.size()) + " nodes, " + quoted_list(paths) +
                   (told_apart ? "; give as much of the path as tells them apart, from the root with a / in front"
                               : "; rename one of them in the file"));
}

Matrix4d Animation::world(std::size_t node, double time) const {
  Matrix4d m = local_matrix(nodes[node], time);
  for (int n = nodes[node].parent; n >= 0; n = nodes[n].parent) m = local_matrix(nodes[n], time) * m;
  return m;
}

Eigen::Isometry3d Animation::pose(std::size_t node, double time) const {
  const Matrix4d m = world(node, time);
  const auto complain = [&](const char* what) {
    return InputError(source + ": node \"" + path_of(nodes, node) + "\" " + what + " at " + seconds(time) +
                      " of its clip; choose another node or repair its scale keys");
  };
  if (!m.allFinite()) throw complain("has a transform that is not finite");
  Matrix3d linear = m.topLeftCorner<3, 3>();
  if (linear.determinant() < 0) linear = -linear;
  const Eigen::JacobiSVD<Matrix3d> svd(linear, Eigen::ComputeFullU | Eigen::ComputeFullV);
  // Below this ratio rounding alone decides where the flat axis points.
  constexpr double flat = 1e-10;
  if (!(svd.singularValues()[2] > flat * svd.singularValues()[0])) throw complain("is squashed flat");

  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.linear() = up * (svd.matrixU() * svd.matrixV().transpose());
  pose.translation() = up * (unit * m.topRightCorner<3, 1>());
  if (!pose.translation().allFinite()) throw complain("has a transform that is not finite");
  return pose;
}

}  // namespace strandbake
