// The method once more, as the paper words it: one strand at a time, in double, with transforms and quaternions.
// Slow on purpose, and it shares nothing with sim/passes: a second opinion for the solver.
// Where the paper is silent (units of damping and stiffness, fade, wind) it follows the words in sim/passes.
#pragma once

#include <Eigen/Geometry>
#include <cmath>
#include <vector>

#include "sim/groom.h"
#include "sim/gusts.h"
#include "sim/params.h"
#include "sim/solver.h"

namespace strandbake::paper {

using Eigen::Isometry3d;
using Eigen::Quaterniond;
using Eigen::Vector3d;

inline Isometry3d transform(const Eigen::Matrix3d& rotation, const Vector3d& translation) {
  Isometry3d t = Isometry3d::Identity();
  t.linear() = rotation;
  t.translation() = translation;
  return t;
}

// Basis vectors of vertex 0 (section 4.1) and its place.
inline Isometry3d root_transform(const Vector3d& p0, const Vector3d& p1) {
  const Vector3d x = (p1 - p0).norm() > 0 ? Vector3d((p1 - p0).normalized()) : Vector3d::UnitX();
  Vector3d arbitrary = Vector3d::UnitZ();
  if (x.cross(arbitrary).norm() < 0.1) arbitrary = Vector3d::UnitX();
  const Vector3d y = x.cross(arbitrary).normalized();
  Eigen::Matrix3d axes;
  axes << x, y, x.cross(y);
  return transform(axes, p0);
}

// i-1Ti (Algorithm 2, lines 7 and 8): rotation from (1, 0, 0) to i-1x_i, translation i-1P_i.
inline Isometry3d local_transform(const Isometry3d& global_before, const Vector3d& p) {
  const Vector3d local = global_before.linear().transpose() * (p - global_before.translation());
  if (local.norm() == 0) return Isometry3d::Identity();
  const auto rotation = Quaterniond::FromTwoVectors(Vector3d::UnitX(), local.normalized());
  return transform(rotation.toRotationMatrix(), local);
}

// Equation 1, wTi = wTi-1 · i-1Ti. Rounding is kept from making the product something else than a rotation.
inline Isometry3d compose(const Isometry3d& global_before, const Isometry3d& local) {
  const Isometry3d product = global_before * local;
  return transform(Quaterniond(product.linear()).normalized().toRotationMatrix(), product.translation());
}

// All wTi of a strand (Algorithm 2).
inline std::vector<Isometry3d> initialize_transforms(const std::vector<Vector3d>& p) {
  std::vector<Isometry3d> global = {root_transform(p[0], p[1])};
  for (std::size_t i = 1; i < p.size(); ++i) {
    global.push_back(compose(global.back(), local_transform(global.back(), p[i])));
  }
  return global;
}

// The paper's stiffness belongs to a step of 1/60 s; as a compliance it has a meaning at any other.
inline double stiffness_of_substep(double stiffness, double h) {
  if (stiffness == 0) return 0;
  const double h0 = 1.0 / 60;
  return 1 / (1 + (h0 / h) * (h0 / h) * (1 - stiffness) / stiffness);
}

class Strand {
 public:
  Strand(const std::vector<Vector3d>& rest, const std::vector<bool>& pinned, std::size_t number, const Isometry3d& head)
      : number_(number), rest_(rest), pinned_(pinned), rest_global_(initialize_transforms(rest)) {
    pinned_[0] = pinned_[1] = true;
    for (const Vector3d& p : rest_) p_.push_back(head * p);
    q_ = p_;
    for (const Isometry3d& t : rest_global_) global_.push_back(head * t);
  }

  const std::vector<Vector3d>& positions() const { return p_; }
  // Moves the start a little, velocity and all, for estimates of how errors grow.
  void disturb(std::size_t i, const Vector3d& by) {
    if (!pinned_[i]) p_[i] += by, q_[i] += by;
  }

  // One substep of Algorithm 1. velocity_scale: h over the substep before.
  void substep(const RegionParams& region, const FrameInput& input, std::size_t moment, double velocity_scale) {
    const double h = input.substep;
    const Isometry3d& head = input.head[moment];
    // pow is rounded to float in every precision (DESIGN, "functions that libraries round differently").
    const double keep = static_cast<float>(std::pow(1 - region.damping, 60 * h)) * velocity_scale;
    integrate(region, input, moment, keep, head);
    global_shape(region.global, h, head);
    const double local_stiffness = stiffness_of_substep(region.local.stiffness, h);
    reaction_ = region.local.reaction && region.local.method != 3;
    for (int iteration = 0; local_stiffness > 0 && iteration < region.local.iterations; ++iteration) {
      if (region.local.method == 1) local_shape_1(local_stiffness, head);
      if (region.local.method == 2) local_shape_2(local_stiffness, head);
      if (region.local.method == 3) local_shape_3(local_stiffness, head);
      if (region.local.method == 4) local_shape_4(local_stiffness, head);
    }
    for (int iteration = 0; iteration < region.lengths.iterations; ++iteration) edge_lengths();
    if (!input.spheres.empty()) collide(input.spheres[moment]);
  }

 private:
  std::size_t size() const { return rest_.size(); }

  void integrate(const RegionParams& region, const FrameInput& input, std::size_t moment, double keep,
                 const Isometry3d& head) {
    const double h = input.substep;
    Vector3d wind = Vector3d::Zero();
    if (!input.wind.empty()) {
      const auto weight = wind_weights(number_);
      for (std::size_t j = 0; j < 4; ++j) wind += weight[j] * input.wind[moment][j];
    }
    std::vector<Vector3d> next(size());
    for (std::size_t i = 0; i < size(); ++i) {
      if (pinned_[i]) {
        next[i] = head * rest_[i];
        continue;
      }
      const Vector3d segment = p_[i] - p_[i - 1];
      Vector3d across = wind;
      if (segment.norm() > 0) across -= wind.dot(segment.normalized()) * segment.normalized();
      const Vector3d acceleration = input.gravity + region.drag * across;
      next[i] = p_[i] + keep * (p_[i] - q_[i]) + acceleration * h * h;
    }
    q_ = p_;
    p_ = next;
  }

  // Equation 2, with S_G fading to the end of its range.
  void global_shape(const GlobalShapeParams& global, double h, const Isometry3d& head) {
    double total = 0;
    for (std::size_t i = 1; i < size(); ++i) total += (rest_[i] - rest_[i - 1]).norm();
    double along = 0;
    for (std::size_t i = 1; i < size(); ++i) {
      along += (rest_[i] - rest_[i - 1]).norm();
      if (pinned_[i] || global.stiffness == 0 || global.range == 0 || along > global.range * total) continue;
      const double weight = 1 - global.fade * (along / total) / global.range;
      p_[i] += stiffness_of_substep(global.stiffness * weight, h) * (head * rest_[i] - p_[i]);
    }
  }

  // Equation 4 with its minus sign, in the local frame i - 1 with the given orientation, then back to the world.
  void apply_local_constraint(std::size_t i, double stiffness, const Eigen::Matrix3d& orientation) {
    if (reaction_) return react(i, stiffness, orientation);
    const Isometry3d to_world = transform(orientation, p_[i - 1]);
    const Vector3d rest_local = rest_global_[i - 1].inverse() * rest_[i];
    Vector3d local = to_world.inverse() * p_[i];
    Vector3d local_before = Vector3d::Zero();  // i-1Pi-1
    const Vector3d d = rest_local - local;
    local_before -= 0.5 * stiffness * d;
    local += 0.5 * stiffness * d;
    if (!pinned_[i - 1]) p_[i - 1] = to_world * local_before;
    if (!pinned_[i]) p_[i] = to_world * local;
  }

  // Not of the paper: the couple of the constraint is given to the edge before, as two forces across the frame's x.
  // Weights are those of the energy's gradient on hair that is straight.
  void react(std::size_t i, double stiffness, const Eigen::Matrix3d& orientation) {
    const double length = (rest_[i] - rest_[i - 1]).norm(), before = (rest_[i - 1] - rest_[i - 2]).norm();
    const double arm = before > 0 ? std::max(before, length / 4) : 0;
    const double rho = arm > 0 ? length / arm : 0;
    const double w1 = pinned_[i - 1] ? 0 : 1, w2 = pinned_[i - 2] ? 0 : 1;
    const double weight = 1 + w1 * (1 + rho) * (1 + rho) + w2 * rho * rho;
    const Vector3d goal = orientation * (rest_global_[i - 1].inverse() * rest_[i]);
    const Vector3d move = stiffness / (stiffness * weight + 2 * (1 - stiffness)) * (goal - (p_[i] - p_[i - 1]));
    const Vector3d couple = goal.cross(move);
    const Vector3d back = arm > 0 ? Vector3d(orientation.col(0).cross(couple) / arm) : Vector3d::Zero();
    if (!pinned_[i]) p_[i] += move;
    p_[i - 1] += w1 * (back - move);
    p_[i - 2] -= w2 * back;
  }
  std::size_t batches() const { return reaction_ ? 3 : 2; }

  // Algorithm 3.
  void local_shape_1(double stiffness, const Isometry3d& head) {
    global_[0] = head * rest_global_[0];
    global_[1] = head * rest_global_[1];
    for (std::size_t i = 2; i < size(); ++i) {
      apply_local_constraint(i, stiffness, global_[i - 1].linear());
      global_[i - 1].translation() = p_[i - 1];
      global_[i] = compose(global_[i - 1], local_transform(global_[i - 1], p_[i]));
    }
  }

  // Algorithm 4, in the batches of section 5. The constraint also names wTH (line 13): the pinned root's frames are
  // those of the head now.
  void local_shape_2(double stiffness, const Isometry3d& head) {
    std::vector<Isometry3d> temp = global_;
    temp[0] = global_[0] = head * rest_global_[0];
    temp[1] = global_[1] = head * rest_global_[1];
    for (std::size_t batch = 2; batch < 2 + batches(); ++batch) {
      for (std::size_t i = batch; i < size(); i += batches())
        apply_local_constraint(i, stiffness, temp[i - 1].linear());
    }
    for (std::size_t i = 2; i < size(); ++i) {
      temp[i - 1].translation() = p_[i - 1];
      global_[i] = compose(temp[i - 1], local_transform(temp[i - 1], p_[i]));
    }
  }

  // Algorithm 5, in batches.
  void local_shape_3(double stiffness, const Isometry3d& head) {
    for (std::size_t batch = 2; batch <= 3; ++batch) {
      for (std::size_t i = batch; i < size(); i += 2) {
        apply_local_constraint(i, stiffness, (head * rest_global_[i - 1]).linear());
      }
    }
  }

  // Not of the paper: the frames of Algorithm 3, all of them before the constraints, which go in batches.
  void local_shape_4(double stiffness, const Isometry3d& head) {
    global_[0] = head * rest_global_[0];
    global_[1] = head * rest_global_[1];
    for (std::size_t i = 2; i < size(); ++i) {
      global_[i - 1].translation() = p_[i - 1];
      global_[i] = compose(global_[i - 1], local_transform(global_[i - 1], p_[i]));
    }
    for (std::size_t batch = 2; batch < 2 + batches(); ++batch) {
      for (std::size_t i = batch; i < size(); i += batches())
        apply_local_constraint(i, stiffness, global_[i - 1].linear());
    }
  }

  // Position based dynamics, equations 10 and 11: even edges, then odd ones.
  void edge_lengths() {
    for (std::size_t batch = 2; batch <= 3; ++batch) {
      for (std::size_t i = batch; i < size(); i += 2) {
        const double w0 = pinned_[i - 1] ? 0 : 1, w1 = pinned_[i] ? 0 : 1;
        const double length = (p_[i] - p_[i - 1]).norm();
        if (w0 + w1 == 0 || length == 0) continue;
        const Vector3d n = (p_[i] - p_[i - 1]) / length;
        const double error = length - (rest_[i] - rest_[i - 1]).norm();
        p_[i - 1] += w0 / (w0 + w1) * error * n;
        p_[i] -= w1 / (w0 + w1) * error * n;
      }
    }
  }

  // Section 3.5: to the closest point of the surface.
  void collide(const std::vector<Sphere>& spheres) {
    for (std::size_t i = 0; i < size(); ++i) {
      if (pinned_[i]) continue;
      for (const Sphere& sphere : spheres) {
        const Vector3d out = p_[i] - sphere.center;
        if (out.norm() < sphere.radius) {
          p_[i] = sphere.center + sphere.radius * (out.norm() > 0 ? Vector3d(out.normalized()) : Vector3d::UnitY());
        }
      }
    }
  }

  std::size_t number_;
  std::vector<Vector3d> rest_, p_, q_;
  std::vector<bool> pinned_;
  bool reaction_ = false;
  std::vector<Isometry3d> rest_global_;  // wTi of the rest state
  std::vector<Isometry3d> global_;       // wTi, state of method 2
};

// A whole groom.
class Reference {
 public:
  Reference(const Groom& groom, const Isometry3d& head) : region_(groom.region) {
    region_.resize(groom.strand_count(), 0);
    for (std::size_t s = 0; s < groom.strand_count(); ++s) {
      std::vector<Vector3d> rest;
      std::vector<bool> pinned;
      for (std::size_t v = groom.offset[s]; v < groom.offset[s + 1]; ++v) {
        rest.push_back(groom.position[v]);
        pinned.push_back(!groom.pinned.empty() && groom.pinned[v] != 0);
      }
      strands_.emplace_back(rest, pinned, s, head);
    }
  }

  std::vector<Strand>& strands() { return strands_; }

  void advance(const FrameInput& input) {
    for (std::size_t s = 0; s < strands_.size(); ++s) {
      for (std::size_t moment = 0; moment < input.substeps(); ++moment) {
        const double scale = moment == 0 && substep_before_ > 0 ? input.substep / substep_before_ : 1;
        strands_[s].substep(input.regions[region_[s]], input, moment, scale);
      }
    }
    substep_before_ = input.substep;
  }

  std::vector<Vector3d> positions() const {
    std::vector<Vector3d> all;
    for (const Strand& strand : strands_) all.insert(all.end(), strand.positions().begin(), strand.positions().end());
    return all;
  }

 private:
  std::vector<Strand> strands_;
  std::vector<std::uint32_t> region_;
  double substep_before_ = 0;
};

}  // namespace strandbake::paper
