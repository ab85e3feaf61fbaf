// The state of a solver as a stream of bytes that depends neither on lanes, threads nor backend: what the next frame
// grows out of, strand after strand in the order of the groom, in the solver's own precision.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <span>
#include <utility>
#include <vector>

#include "sim/solver.h"
#include "sim/strand_blocks.h"

namespace strandbake {

// Calls visit(placed, lane, strand) in the order of the groom.
template <class Scalar, class Visit>
void visit_strands(const StrandBlocks<Scalar>& blocks, const Visit& visit) {
  std::vector<std::pair<std::uint32_t, std::uint32_t>> place(blocks.strand_order.size());  // block and lane
  for (std::uint32_t b = 0; b < blocks.blocks.size(); ++b) {
    const Placed<Scalar>& placed = blocks.blocks[b];
    for (int lane = 0; lane < placed.count; ++lane) {
      place[blocks.strand_order[placed.first + static_cast<std::size_t>(lane)]] = {b, static_cast<std::uint32_t>(lane)};
    }
  }
  for (std::size_t s = 0; s < place.size(); ++s) {
    visit(blocks.blocks[place[s].first], static_cast<int>(place[s].second), s);
  }
}

template <class Scalar>
struct LastingArray {
  Scalar* array;                       // nullptr: the block has none
  std::size_t components, first, end;  // vertices of a strand
};

// What of a strand lasts from frame to frame: positions now and before, frames, tensions, what rods have drawn and
// where they are pressed, where the block has them.
// Only a rod turns the frame of its tip on, and the first two vertices are held, so others' are not among it.
template <class Scalar>
std::array<LastingArray<Scalar>, 8> lasting_arrays(const Block<Scalar>& block, bool swapped, std::size_t vertices) {
  Scalar *now = block.position, *before = block.previous;
  if (swapped) std::swap(now, before);
  const std::size_t frames = block.rest_curvature != nullptr ? vertices : vertices - 1;
  return {{{now, 3, 0, vertices},
           {before, 3, 0, vertices},
           {block.frame_x, 3, 0, frames},
           {block.frame_y, 3, 0, frames},
           {block.tension, 1, 2, vertices},
           {block.drawn, 3, 2, vertices},
           {block.handed_back, 3, 2, vertices},
           {block.pressed, 1, 2, vertices}}};
}

// Calls visit(number) for each number of the strand in a lane.
template <class Scalar, class Visit>
void visit_numbers(const LastingArray<Scalar>& lasting, std::size_t width, int lane, const Visit& visit) {
  for (std::size_t k = lasting.first * lasting.components; k < lasting.end * lasting.components; ++k)
    visit(lasting.array[k * width + static_cast<std::size_t>(lane)]);
}

template <class Scalar>
void save_state(const StrandBlocks<Scalar>& blocks, const std::vector<std::uint64_t>& offset, bool swapped,
                const Origin& origin, double substep_before, const Solver::Sink& out) {
  const Eigen::Vector3d &now = origin.now(), &moved = origin.moved();
  const std::array shared = {substep_before, now.x(), now.y(), now.z(), moved.x(), moved.y(), moved.z()};
  out(std::as_bytes(std::span(shared)));
  const auto width = static_cast<std::size_t>(blocks.width);
  std::vector<Scalar> numbers;
  visit_strands(blocks, [&](const Placed<Scalar>& placed, int lane, std::size_t strand) {
    for (const auto& lasting : lasting_arrays(placed.block, swapped, offset[strand + 1] - offset[strand])) {
      if (lasting.array == nullptr) continue;
      numbers.clear();
      // Whether a zero is -0 may depend on what was skipped, and nothing else does.
      visit_numbers(lasting, width, lane, [&](Scalar number) { numbers.push_back(number + 0); });
      out(std::as_bytes(std::span(numbers)));
    }
  });
}

// The counterpart; positions before stand in Block::previous then. Hands back the substep before.
template <class Scalar>
double load_state(StrandBlocks<Scalar>& blocks, const std::vector<std::uint64_t>& offset, Origin& origin,
                  const Solver::Source& in) {
  std::array<double, 7> shared{};
  in(std::as_writable_bytes(std::span(shared)));
  origin.set({shared[1], shared[2], shared[3]}, {shared[4], shared[5], shared[6]});
  const auto width = static_cast<std::size_t>(blocks.width);
  std::vector<Scalar> numbers;
  visit_strands(blocks, [&](const Placed<Scalar>& placed, int lane, std::size_t strand) {
    for (const auto& lasting : lasting_arrays(placed.block, false, offset[strand + 1] - offset[strand])) {
      if (lasting.array == nullptr) continue;
      numbers.resize(lasting.components * (lasting.end - lasting.first));
      in(std::as_writable_bytes(std::span(numbers)));
      const auto store = [&](int to) {
        const Scalar* next = numbers.data();
        visit_numbers(lasting, width, to, [&](Scalar& number) { number = *next++; });
      };
      store(lane);
      // Lanes without a strand repeat the first.
      for (int to = placed.count; lane == 0 && to < blocks.width; ++to) store(to);
    }
  });
  for (Placed<Scalar>& placed : blocks.blocks) placed.block.at_rest = false;
  return shared[0];
}

}  // namespace strandbake
