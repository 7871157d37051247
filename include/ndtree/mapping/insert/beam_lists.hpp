// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Lists of the beams that cross a node, and the memory that they live in while a tree is walked.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include "ndtree/core/simd.hpp"

namespace ndtree {

/// The beams that cross a node over more than a point: ascending beam numbers. Entry and exit are recomputed
/// from the planes (CellCrossings), which costs less than storing them. Vector code may write up to kSlack
/// entries past the end; pad() then fills them with valid beam numbers, so that vector code may read them.
struct BeamList {
  static constexpr std::size_t kSlack = 16;
  static constexpr std::uint32_t kAll = 0xffffffff;  ///< No beam has this number.

  std::uint32_t* beam = nullptr;
  std::size_t size = 0;

  [[nodiscard]] bool empty() const { return size == 0; }
  [[nodiscard]] std::uint32_t first_beam() const { return beam[0]; }
  [[nodiscard]] std::uint32_t last_beam() const { return beam[size - 1]; }
  void pad() { std::fill_n(beam + size, kSlack, 0u); }
  /// Index of the first beam, at or after index `from`, whose number is at least this. Size if there is none.
  [[nodiscard]] std::size_t find(std::uint32_t number, std::size_t from = 0) const {
    return find(number, from, size);
  }
  /// find() among indices [from, to); `to` if there is none. Bisection without unpredictable branches, O(log
  /// n).
  [[nodiscard]] std::size_t find(std::uint32_t number, std::size_t from, std::size_t to) const {
    if (from == to || beam[to - 1] < number) return to;
    for (std::size_t left = to - from; left > 1; left -= left / 2)
      from += beam[from + left / 2 - 1] < number ? left / 2 : 0;
    return from + (beam[from] < number);
  }
  [[nodiscard]] BeamList part(std::size_t first, std::size_t last) const {
    return {beam + first, last - first};
  }
};

/// Appends a list to another one, which must have room for it, and does not pad it.
/// @pre the numbers of `list` are larger than those of `to`; if both share memory, `to` lies before `list`.
inline void append(const BeamList& list, BeamList& to) {
  std::copy_n(list.beam, list.size, to.beam + to.size);
  to.size += list.size;
}

/// The lists of a node's children, in one piece of memory.
template <int kCount>
struct SiblingLists {
  BeamList memory;  ///< Of all lists; its size has no meaning.
  std::array<std::size_t, std::size_t{kCount}>
      first;  ///< Index in `memory` of each child's list; `last` is that of its end.
  std::array<std::size_t, std::size_t{kCount}> last;

  [[nodiscard]] BeamList of(int child) const {
    const auto c = static_cast<std::size_t>(child);
    return memory.part(first[c], last[c]);
  }
  void pad() {
    for (int c = 0; c < kCount; ++c) of(c).pad();
  }
  /// Moves the lists to the front of the memory, without padding. @returns the entries that they take.
  std::size_t pack() {
    std::size_t end = 0;
    for (std::size_t c = 0; c < kCount; ++c) {
      const std::size_t size = last[c] - first[c];
      if (first[c] != end) {
        BeamList moved = memory.part(end, end);
        append(memory.part(first[c], last[c]), moved);
      }
      first[c] = end;
      last[c] = end + size;
      end += size + BeamList::kSlack;
    }
    return end;
  }
};

/// Memory for lists, released in the opposite order of its allocation.
class ListStack {
 public:
  /// A state of the stack, to which release() returns.
  struct Mark {
    std::size_t block = 0;
    std::size_t used = 0;
  };
  ListStack() = default;
  ListStack(ListStack&&) noexcept = default;
  ListStack& operator=(ListStack&&) noexcept = default;
  ListStack(const ListStack&) = delete;
  ListStack& operator=(const ListStack&) = delete;
  ~ListStack() = default;

  [[nodiscard]] Mark mark() const { return {block_, used_}; }
  void release(const Mark& mark) {
    block_ = mark.block;
    used_ = mark.used;
  }

  /// Reduces the list that was allocated last to n entries.
  void shrink(const BeamList& list, std::size_t n) {
    used_ = static_cast<std::size_t>(list.beam - blocks_[block_].beams.get()) + n;
  }

  /// Releases a list and everything that was allocated after it, if the list is in the current block.
  void free_from(const BeamList& list) {
    if (block_ == blocks_.size()) return;
    const auto* const begin = blocks_[block_].beams.get();
    if (std::less_equal<>()(begin, list.beam) && std::less<>()(list.beam, begin + used_)) shrink(list, 0);
  }

  /// An empty list with room for n entries, kSlack included.
  [[nodiscard]] NDTREE_ALWAYS_INLINE BeamList allocate(std::size_t n) {
    if (block_ == blocks_.size() || used_ + n > blocks_[block_].room) next_block(n);
    const Block& block = blocks_[block_];
    const BeamList list{block.beams.get() + used_, 0};
    used_ += n;
#ifndef NDEBUG
    std::fill_n(list.beam, n,
                BeamList::kAll);  // No beam's number, so that tests notice reads of unwritten ones.
#endif
    return list;
  }

 private:
  static constexpr std::size_t kBlock = std::size_t{1} << 15;
  struct Block {
    std::size_t room;
    std::unique_ptr<std::uint32_t[]> beams;  // Not initialised, so that unused pages are not resident.
    explicit Block(std::size_t n) : room(n), beams(new std::uint32_t[n]) {}
  };

  NDTREE_NEVER_INLINE void next_block(std::size_t n) {
    if (block_ < blocks_.size()) ++block_;
    while (block_ < blocks_.size() && n > blocks_[block_].room) ++block_;
    if (block_ == blocks_.size()) blocks_.emplace_back(std::max(n, kBlock));
    used_ = 0;
  }

  std::vector<Block> blocks_;
  std::size_t block_ = 0;
  std::size_t used_ = 0;  // Of the block.
};

/// Releases at its end the memory of lists that were allocated in its scope.
class ListScope {
 public:
  explicit ListScope(ListStack& stack) : stack_(stack), mark_(stack.mark()) {}
  ListScope(const ListScope&) = delete;
  ListScope& operator=(const ListScope&) = delete;
  ~ListScope() { stack_.release(mark_); }

 private:
  ListStack& stack_;
  const ListStack::Mark mark_;
};

/// The children's lists of a long list that is partitioned in pieces. They take memory for the beams that
/// cross each child, where one partition would reserve memory for all beams in each child.
template <int kCount>
class PiecewiseLists {
 public:
  /// The stack on which a piece's lists are allocated.
  [[nodiscard]] ListStack& memory() { return memory_; }
  /// Adds the lists of a piece. @pre they were allocated last, and their numbers follow those of earlier
  /// pieces.
  void add(SiblingLists<kCount> piece) {
    memory_.shrink(piece.memory, piece.pack());
    pieces_.push_back(piece);
  }
  /// Joins and removes all pieces. The list of the last child is first in memory.
  [[nodiscard]] SiblingLists<kCount> join(ListStack& stack) {
    SiblingLists<kCount> all;
    std::size_t room = 0;
    for (std::size_t c = kCount; c-- > 0;) {
      all.first[c] = all.last[c] = room;
      for (const SiblingLists<kCount>& piece : pieces_) room += piece.last[c] - piece.first[c];
      room += BeamList::kSlack;
    }
    all.memory = stack.allocate(room);
    for (std::size_t c = 0; c < kCount; ++c) {
      BeamList list = all.of(static_cast<int>(c));
      for (const SiblingLists<kCount>& piece : pieces_) append(piece.of(static_cast<int>(c)), list);
      list.pad();
      all.last[c] += list.size;
    }
    pieces_.clear();
    memory_.release({});
    return all;
  }

 private:
  ListStack memory_;
  std::vector<SiblingLists<kCount>> pieces_;
};

}  // namespace ndtree
