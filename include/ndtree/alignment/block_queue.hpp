// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Blocks of poses, the most promising first.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace ndtree {

/// Poses of one rotation whose translations are up to 2^level - 1 steps from `steps`.
template <int D>
struct PoseBlock {
  std::array<std::int32_t, std::size_t{D}> steps{};
  std::int32_t next = 0;        ///< For BlockQueue.
  std::uint32_t rotation : 24;  ///< Its number; there are 1e6 at most.
  std::uint32_t level : 8;
  std::int64_t bound = 0;  ///< No pose in it has a larger score.

  PoseBlock() : rotation(0), level(0) {}
};

/// Blocks by their bounds, in a list for each bound; for many points, for each range of bounds. O(1).
template <int D>
class BlockQueue {
 public:
  /// @param largest bound.
  explicit BlockQueue(std::int64_t largest) {
    while ((largest >> shift_) >= kLists) ++shift_;
    first_.assign(static_cast<std::size_t>(largest >> shift_) + 2, kNone);
  }
  void push(const PoseBlock<D>& block) {
    const std::size_t list = block.bound == 0 ? 0 : 1 + static_cast<std::size_t>(block.bound >> shift_);
    std::int32_t place = free_;
    if (place == kNone) {
      place = static_cast<std::int32_t>(blocks_.size());
      blocks_.emplace_back();
    } else {
      free_ = blocks_[static_cast<std::size_t>(place)].next;
    }
    PoseBlock<D>& kept = blocks_[static_cast<std::size_t>(place)];
    kept = block;
    kept.next = first_[list];
    first_[list] = place;
    top_ = std::max(top_, list);
  }
  /// Not less than the bound of any block; -1 if there is none.
  [[nodiscard]] std::int64_t bound() {
    while (top_ > 0 && first_[top_] == kNone) --top_;
    if (top_ == 0) return first_[0] == kNone ? -1 : 0;
    return (static_cast<std::int64_t>(top_) << shift_) - 1;
  }
  /// One of the list with the largest bounds. @pre bound() said that there is one.
  [[nodiscard]] PoseBlock<D> pop() {
    const std::int32_t place = first_[top_];
    PoseBlock<D>& block = blocks_[static_cast<std::size_t>(place)];
    first_[top_] = block.next;
    block.next = free_;
    free_ = place;
    return block;
  }

 private:
  static constexpr std::int32_t kNone = -1;
  static constexpr std::int64_t kLists = std::int64_t{1} << 20;

  int shift_ = 0;
  std::size_t top_ = 0;
  std::int32_t free_ = kNone;
  std::vector<std::int32_t> first_;  // Of each list; that of 0 by itself.
  std::vector<PoseBlock<D>> blocks_;
};

}  // namespace ndtree
