// One strand in doubles, stepped with the passes of the rod as sim/rod_block.h does it, and with what scenes do not
// have: forces on vertices and couples on edges, a root that nothing holds, a far end whose direction is held.
//
// All over the mass of a metre of hair: forces [m^2/s^2], couples and energies [m^3/s^2], momentum [m^2/s].
#pragma once

#include <Eigen/Dense>
#include <vector>

#include "sim/passes/integrate.h"
#include "sim/passes/rod_link.h"
#include "sim/passes/rod_return.h"

namespace strandbake::validation {

using Vec = Vec3<double>;
using Turn = Frame<double>;

inline Vec to_vec(const Eigen::Vector3d& v) {
  return {v.x(), v.y(), v.z()};
}
inline Eigen::Vector3d to_eigen(Vec v) {
  return {v.x, v.y, v.z};
}
inline Eigen::Matrix3d to_eigen(const Symmetric<double>& s) {
  return Eigen::Matrix3d{{s.xx, s.xy, s.xz}, {s.xy, s.yy, s.yz}, {s.xz, s.yz, s.zz}};
}
inline Eigen::Matrix3d to_eigen(const Matrix<double>& m) {
  return Eigen::Matrix3d{{m.x.x, m.x.y, m.x.z}, {m.y.x, m.y.y, m.y.z}, {m.z.x, m.z.y, m.z.z}};
}

struct RodDriver {
  double bend = 0, twist = 0;  // B, C [m^4/s^2]
  double stretch = 0;          // Y [m^2/s^2]; 0: lengths are exact
  Vec gravity = {0, 0, 0};     // [m/s^2]
  double keep = 1;             // share of the velocity kept in a substep
  int iterations = 1;
  bool free_root = false;
  bool held_tip = false;  // the last edge keeps its frame; its vertex goes along

  // By vertex, or by the vertex that an edge ends at.
  std::vector<Vec> at, before, target;  // now, a substep ago, and where it would go on its own
  std::vector<Turn> frame;
  std::vector<double> rest_length, length;
  std::vector<double> share;  // how much heavier than hair a vertex is
  std::vector<Vec> rest_curvature;
  std::vector<Vec> force, couple;
  std::vector<Vec> drawn, handed_back;  // rod_return.h

  // At rest.
  RodDriver(const std::vector<Eigen::Vector3d>& rest, double b, double c) : bend(b), twist(c) {
    const std::size_t n = rest.size();
    for (const Eigen::Vector3d& p : rest) at.push_back(to_vec(p));
    before = target = at;
    const Vec none = {0, 0, 0};
    const Eigen::Vector3d x = (rest[1] - rest[0]).normalized();
    frame.assign(n, {to_vec(x), to_vec(x.unitOrthogonal())});
    rest_curvature.assign(n, none);
    force = couple = drawn = handed_back = rest_curvature;
    share.assign(n, 1);
    rest_length.assign(n, 0);
    for (std::size_t i = 1; i < n; ++i) {
      rest_length[i] = (rest[i] - rest[i - 1]).norm();
      if (i == 1) continue;
      frame[i] = turn_frame(frame[i - 1], at[i] - at[i - 1]);
      rest_curvature[i] = rod_curvature(frame[i - 1], frame[i]);
    }
    length = rest_length;
  }

  std::size_t size() const { return at.size(); }
  std::size_t first() const { return free_root ? 1 : 2; }  // edge that is free
  double after(std::size_t i) const { return i + 1 < size() ? rest_length[i + 1] : 0; }
  // Length of hair that moves with a vertex [m].
  double mass(std::size_t i) const { return 0.5 * share[i] * (rest_length[i] + after(i)); }
  double inverse_length(std::size_t i) const { return inverse_joint_length(rest_length[i - 1], rest_length[i]); }
  Joint<double> joint(std::size_t i, double h) const {
    const double scale = h * h * inverse_length(i);
    return rod_joint(frame[i - 1], frame[i], rest_curvature[i], bend * scale, twist * scale);
  }

  void step(double h) {
    target = at;
    for (std::size_t i = free_root ? 0 : 2; i < size(); ++i) {
      target[i] = integrate(at[i], before[i] + handed_back[i], keep, gravity * (h * h) + force[i] * (h * h / mass(i)));
    }
    const std::vector<Vec> old = before;
    before = at;
    for (std::size_t i = first(); i < size(); ++i) {
      frame[i] = turned_frame(frame[i], edge_turn(old[i] - old[i - 1], before[i] - before[i - 1]) * keep);
      at[i] = at[i - 1] + frame[i].x * length[i];
    }
    for (int k = 0; k < iterations; ++k) iterate(h);
    for (std::size_t i = free_root ? 0 : 2; i < size(); ++i) {
      const Vec now = at[i] - target[i];
      handed_back[i] = drawn_return(now, drawn[i]);
      drawn[i] = now;
    }
  }

  // The iteration of sim/rod_block.h.
  void iterate(double h) {
    const std::size_t n = size(), tip = held_tip ? n - 2 : n - 1;
    std::vector<JointGain<double>> gain(n);
    std::vector<StretchGain<double>> give(n);
    Link<double> link = no_link(0.0);
    for (std::size_t i = tip; i >= first(); --i) {
      double heavy = mass(i);
      if (held_tip && i == tip) {
        const Joint<double> end = joint(n - 1, h);
        link.D = end.matrix;
        link.d = link.d - end.couple;
        heavy += mass(n - 1);
      }
      const Vec x = frame[i].x, edge = x * length[i];
      link = with_vertex(link, heavy, at[i] - target[i], x, edge);
      link.d = link.d - couple[i] * (h * h);
      if (stretch > 0) {
        const double stiffness = edge_stiffness(h * h * stretch, rest_length[i]);
        give[i] = stretch_gain(link, x, stiffness, length[i] - rest_length[i]);
        link = with_stretch(link, x, stiffness, give[i]);
      }
      link = at_near_end(link, edge);
      if (i == 1) break;  // before a free root there is no joint
      const Joined<double> joined = with_joint(link, joint(i, h));
      gain[i] = joined.gain;
      link = joined.link;
    }
    Vec turn = {0, 0, 0}, moved = turn;
    if (free_root) {
      Eigen::Matrix<double, 6, 6> matrix;
      const Eigen::Matrix3d by_x = to_eigen(link.C);
      matrix << to_eigen(link.A) + mass(0) * Eigen::Matrix3d::Identity(), by_x.transpose(), by_x, to_eigen(link.D);
      Eigen::Matrix<double, 6, 1> gradient;
      gradient << to_eigen(link.a + (at[0] - target[0]) * mass(0)), to_eigen(link.d);
      const Eigen::Matrix<double, 6, 1> solved = -matrix.ldlt().solve(gradient);
      moved = to_vec(solved.head<3>());
      turn = to_vec(solved.tail<3>());
      at[0] = at[0] + moved;
    }
    for (std::size_t i = first(); i <= tip; ++i) {
      if (i > 1) turn = turn + joint_turn(gain[i], moved, turn);
      const Turn old = frame[i];
      moved = moved + outer(turn, old.x * length[i]);
      if (stretch > 0) {
        const double change = stretch_by(give[i], moved, turn);
        moved = moved + old.x * change;
        length[i] += change;
      }
      frame[i] = turned_frame(old, turn);
      at[i] = at[i - 1] + frame[i].x * length[i];
    }
    if (held_tip) at[n - 1] = at[tip] + frame[n - 1].x * length[n - 1];
  }

  // Until a substep moves the tip by less than `least` [m]. Returns how many it took, or `most`.
  int settle(double h, double least, int most) {
    for (int k = 1; k < most; ++k) {
      const Vec tip = at.back();
      step(h);
      if ((to_eigen(at.back()) - to_eigen(tip)).norm() < least) return k;
    }
    return most;
  }

  double elastic_energy() const {
    double sum = 0;
    for (std::size_t i = 2; i < size(); ++i) {
      const Vec off = rod_curvature(frame[i - 1], frame[i]) - rest_curvature[i];
      sum += 0.5 * inverse_length(i) * (twist * off.x * off.x + bend * (off.y * off.y + off.z * off.z));
    }
    for (std::size_t i = 1; i < size() && stretch > 0; ++i) {
      const double off = length[i] - rest_length[i];
      sum += 0.5 * stretch * off * off / rest_length[i];
    }
    return sum;
  }
  Eigen::Vector3d velocity(std::size_t i, double h) const { return to_eigen(at[i] - before[i]) / h; }
  double kinetic_energy(double h) const {
    double sum = 0;
    for (std::size_t i = 0; i < size(); ++i) sum += 0.5 * mass(i) * velocity(i, h).squaredNorm();
    return sum;
  }
  Eigen::Vector3d momentum(double h) const {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (std::size_t i = 0; i < size(); ++i) sum += mass(i) * velocity(i, h);
    return sum;
  }
  Eigen::Vector3d angular_momentum(double h) const {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (std::size_t i = 0; i < size(); ++i) sum += mass(i) * to_eigen(at[i]).cross(velocity(i, h));
    return sum;
  }
};

// A strand along a curve with the tangent `direction(s)`: its first edge is clamped at its middle, s = 0, and its tip
// is at s = length. Each edge has the direction of its middle.
template <class Direction>
std::vector<Eigen::Vector3d> clamped_along(std::size_t segments, double length, const Direction& direction) {
  const double l = length / (static_cast<double>(segments) - 0.5);
  std::vector<Eigen::Vector3d> p = {-0.5 * l * direction(0.0)};
  for (std::size_t i = 0; i < segments; ++i) p.push_back(p.back() + l * direction(static_cast<double>(i) * l));
  return p;
}

}  // namespace strandbake::validation
