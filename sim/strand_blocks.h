// How a solver keeps its strands: in blocks of strands of one region and nearly one length, near each other in space,
// with their rest state in the solver's own arithmetic; and what a frame's input becomes for them. All backends share
// it.
#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <span>
#include <type_traits>
#include <vector>

#include "sim/block.h"
#include "sim/frame_input.h"
#include "sim/groom.h"
#include "sim/passes/strand_math.h"
#include "sim/plan.h"
#include "sim/solver.h"

namespace strandbake {

template <class Scalar>
Vec3<Scalar> to_vec3(const Eigen::Vector3d& v) {
  // Adding +0 makes -0 to +0, which no later operation could tell from it but a comparison of bytes can.
  return {static_cast<Scalar>(v.x()) + 0, static_cast<Scalar>(v.y()) + 0, static_cast<Scalar>(v.z()) + 0};
}

// From the rest pose to the head's orientation now; where the head is, is the origin's matter.
template <class Scalar>
struct HeadTurn {
  Scalar rotation[9];

  explicit HeadTurn(const Eigen::Isometry3d& head) {
    for (int row = 0; row < 3; ++row) {
      for (int column = 0; column < 3; ++column)
        rotation[3 * row + column] = static_cast<Scalar>(head.linear()(row, column));
    }
  }
  Vec3<Scalar> turn(Vec3<Scalar> v) const {
    const Scalar* r = rotation;
    return rotate_by_rows<Scalar>({r[0], r[1], r[2]}, {r[3], r[4], r[5]}, {r[6], r[7], r[8]}, v);
  }
};

// The origin of positions: about the centre of the groom, on the head.
class Origin {
 public:
  Origin(const Eigen::Vector3d& rest_center, const Eigen::Isometry3d& head)
      : rest_center_(rest_center), now_(head * rest_center), moved_(0, 0, 0) {}

  const Eigen::Vector3d& now() const { return now_; }      // world [m]
  const Eigen::Vector3d& moved() const { return moved_; }  // in the last substep [m]
  // Goes back to where it once was.
  void set(const Eigen::Vector3d& now, const Eigen::Vector3d& moved) {
    now_ = now;
    moved_ = moved;
  }
  void follow(const Eigen::Isometry3d& head) {
    const Eigen::Vector3d next = head * rest_center_;
    moved_ = next - now_;
    now_ = next;
  }

 private:
  Eigen::Vector3d rest_center_, now_, moved_;
};

// A position of the solver in the world. Adding an origin without -0 makes -0 to 0: which of them it is may depend on
// what was skipped, and nothing else does.
template <class Out, class Scalar>
Out in_world(Scalar position, double origin) {
  using Wider = std::common_type_t<Out, Scalar>;
  return static_cast<Out>(static_cast<Wider>(position) + (static_cast<Wider>(origin) + 0));
}

template <class Scalar>
struct Placed {  // a block and the strands in its lanes
  Block<Scalar> block;
  std::uint32_t region;
  std::size_t first;  // of `count` entries in StrandBlocks::strand_order
  int count;
};

// Which strands share a block, and the memory that the plan asks for. float and double.
template <class Scalar>
struct StrandBlocks {
  int width;  // strands in a block
  std::vector<std::uint32_t> strand_order;
  std::vector<Placed<Scalar>> blocks;
  std::size_t longest = 0;          // vertices of the longest strand
  Eigen::Vector3d center{0, 0, 0};  // about that of the groom, at rest [m]; rest positions are relative to it

  // Throws std::invalid_argument where a strand has fewer than two vertices or names a region that the plan does not
  // have.
  StrandBlocks(const Groom& groom, const Plan& plan, int strands_in_a_block, int threads, const Skip& skip);

  // Hands out memory from `base` on; returns how many numbers that takes. nullptr: only counts. `scratch`: by
  // region, how many numbers of a vertex blocks hold that are in a thread's workspace else; empty: none.
  std::size_t lay_out(const Plan& plan, const std::vector<std::size_t>& scratch, Scalar* base);

  // Writes the rest state of the strands of one block, and puts them at rest on the head. `rest_weight` as in
  // region_step().
  void fill(const Groom& groom, const Plan& plan, const HeadTurn<Scalar>& head, const Eigen::Vector3d& rest_weight,
            const Placed<Scalar>& placed) const;

  // Where row `vertex` of an array of vectors begins, for the strand in `lane`.
  std::size_t row_at(std::size_t vertex, int lane) const {
    return vertex * 3 * static_cast<std::size_t>(width) + static_cast<std::size_t>(lane);
  }
};

// A region's parameters for the substeps of a frame. `substep_before`: length of those of the frame before [s], 0 in
// the first. `rest_weight`: the gravity that sag-free hair is in balance with, in the rest frame [m/s^2].
template <class Scalar>
RegionStep<Scalar> region_step(const RegionParams& params, const RegionPlan& plan, const Eigen::Vector3d& rest_weight,
                               const FrameInput& input, double substep_before, const Skip& skip);

template <class Scalar>
struct FrameSteps {
  std::vector<Substep<Scalar>> substeps;
  std::vector<Scalar> spheres;  // of all substeps; they point into it
};
// `origin` goes along, to the end of the frame.
template <class Scalar>
FrameSteps<Scalar> frame_steps(const FrameInput& input, Origin& origin);

// Spheres relative to an origin: x, y, z, radius of each.
template <class Scalar>
void append_spheres(std::span<const Sphere> spheres, const Eigen::Vector3d& origin, std::vector<Scalar>& numbers);

// What the plan left out has no memory to run on: throws std::invalid_argument.
void check_against_plan(const Plan& plan, const FrameInput& input);
void check_measured(const Plan& plan);

}  // namespace strandbake
