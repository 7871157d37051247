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
#include "ndtree/mapping/scan/beams.hpp"

namespace ndtree {

/// Beams that cross a node over more than a point, in the order of their numbers; distances from the origin
/// [m]. Whoever reads many at a time may read, and whoever writes may write, up to kSlack behind the last.
struct Crossings {
  static constexpr std::size_t kSlack = 16;

  std::uint32_t* beam = nullptr;  ///< Their numbers; the distances lie `stride` and twice as far behind.
  std::size_t stride = 0;
  std::size_t size = 0;

  /// Where each beam enters the node, and where it leaves it [m].
  [[nodiscard]] float* enter() const { return reinterpret_cast<float*>(beam + stride); }
  [[nodiscard]] float* exit() const { return reinterpret_cast<float*>(beam + 2 * stride); }
  [[nodiscard]] bool empty() const { return size == 0; }
  [[nodiscard]] std::uint32_t first_beam() const { return beam[0]; }
  [[nodiscard]] std::uint32_t last_beam() const { return beam[size - 1]; }
  /// The place of the first beam, from a place on, that has this number or more.
  [[nodiscard]] std::size_t find(std::uint32_t number, std::size_t from = 0) const {
    return find(number, from, size);
  }
  /// The same up to a place, which it is if none has. By halves, without a branch that nobody can foresee.
  [[nodiscard]] std::size_t find(std::uint32_t number, std::size_t from, std::size_t to) const {
    if (from == to || beam[to - 1] < number) return to;
    for (std::size_t left = to - from; left > 1; left -= left / 2)
      from += beam[from + left / 2 - 1] < number ? left / 2 : 0;
    return from + (beam[from] < number);
  }
  [[nodiscard]] Crossings part(std::size_t first, std::size_t last) const {
    return {beam + first, stride, last - first};
  }
};

/// Adds one list to another, which has room for it, in the same memory only before it. @pre its beams come
/// after those that are there.
inline void append(const Crossings& list, Crossings& to) {
  std::copy_n(list.beam, list.size, to.beam + to.size);
  std::copy_n(list.enter(), list.size, to.enter() + to.size);
  std::copy_n(list.exit(), list.size, to.exit() + to.size);
  to.size += list.size;
}

/// So few beams fit one vector, and are not worth telling apart by what cells below take.
inline constexpr std::size_t kFewBeams = 8;

#ifdef NDTREE_HAS_EIGHTS
/// Where at most eight beams cross the children of a node: so few need no lists. Those that cross a child are
/// a set of bits, of their places among the eight.
template <int D, int kCount>
struct FewCrossings {
  static constexpr std::size_t kMost = kFewBeams;
  explicit FewCrossings(EightBeams<D>& them) : beams(them) {}  // The rest is not initialised.

  EightBeams<D>& beams;
  alignas(32) std::array<std::array<float, kMost>, std::size_t{kCount}> enter;
  alignas(32) std::array<std::array<float, kMost>, std::size_t{kCount}> exit;
  std::array<std::uint32_t, std::size_t{kCount}> set;      ///< Those that cross each child, and of these
  std::array<std::uint32_t, std::size_t{kCount}> passing;  ///< those that clearly pass it.

  // Of a set of beams that is not empty:
  [[nodiscard]] std::uint32_t first_of(std::uint32_t set_of_beams) const {
    return beams.number[static_cast<std::size_t>(__builtin_ctz(set_of_beams))];
  }
  [[nodiscard]] std::uint32_t last_of(std::uint32_t set_of_beams) const {
    return beams.number[static_cast<std::size_t>(31 - __builtin_clz(set_of_beams))];
  }
  /// Of all, the set of those with smaller numbers than this.
  NDTREE_BY_EIGHTS [[nodiscard]] std::uint32_t before(std::uint32_t number) const {
    const __m256i numbers = _mm256_load_si256(reinterpret_cast<const __m256i*>(beams.number.data()));
    const __m256i larger = _mm256_max_epu32(numbers, _mm256_set1_epi32(static_cast<int>(number)));
    return ~static_cast<std::uint32_t>(
        _mm256_movemask_ps(_mm256_castsi256_ps(_mm256_cmpeq_epi32(larger, numbers))));
  }
};

/// Those of few beams that cross one child.
template <int D, int kCount>
struct FewOfChild {
  const FewCrossings<D, kCount>& of;
  std::size_t child;

  [[nodiscard]] std::uint32_t set() const { return of.set[child]; }
  [[nodiscard]] bool all_pass() const { return of.passing[child] == of.set[child]; }
  [[nodiscard]] std::size_t size() const { return static_cast<std::size_t>(__builtin_popcount(set())); }
  [[nodiscard]] std::uint32_t first_beam() const { return of.first_of(set()); }
  [[nodiscard]] std::uint32_t last_beam() const { return of.last_of(set()); }
  [[nodiscard]] bool is_one() const { return (set() & (set() - 1)) == 0; }
  [[nodiscard]] float enter_of_first() const { return of.enter[child][place_of_first()]; }
  [[nodiscard]] float exit_of_first() const { return of.exit[child][place_of_first()]; }

 private:
  [[nodiscard]] std::size_t place_of_first() const { return static_cast<std::size_t>(__builtin_ctz(set())); }
};

/// Where one beam crosses the children of a node, by their numbers; those that it crosses are a set of bits.
struct LoneCrossing {
  static constexpr std::size_t kMostChildren = 8;
  alignas(32) std::array<float, kMostChildren> enter;
  alignas(32) std::array<float, kMostChildren> exit;
  std::uint32_t set;
};
#endif

/// The lists of a node's children, in one piece of memory.
template <int kCount>
struct SiblingLists {
  Crossings memory;  ///< Of all; its size does not count.
  std::array<std::size_t, std::size_t{kCount}>
      first;  ///< Where the list of each child begins there, and ends.
  std::array<std::size_t, std::size_t{kCount}> last;

  [[nodiscard]] Crossings of(int child) const {
    const auto c = static_cast<std::size_t>(child);
    return memory.part(first[c], last[c]);
  }
  /// Moves the lists together. @returns how much of the memory they take.
  std::size_t pack() {
    std::size_t end = 0;
    for (std::size_t c = 0; c < kCount; ++c) {
      const std::size_t size = last[c] - first[c];
      if (first[c] != end) {
        Crossings moved = memory.part(end, end);
        append(memory.part(first[c], last[c]), moved);
      }
      first[c] = end;
      last[c] = end + size;
      end += size + Crossings::kSlack;
    }
    return end;
  }
};

/// Memory for lists: what is allocated last is given back first.
class CrossingStack {
 public:
  /// What was allocated up to some time.
  struct Mark {
    std::size_t block = 0;
    std::size_t used = 0;
  };
  CrossingStack() = default;
  CrossingStack(CrossingStack&&) noexcept = default;
  CrossingStack& operator=(CrossingStack&&) noexcept = default;
  CrossingStack(const CrossingStack&) = delete;
  CrossingStack& operator=(const CrossingStack&) = delete;
  ~CrossingStack() = default;

  [[nodiscard]] Mark mark() const { return {block_, used_}; }
  void release(const Mark& mark) {
    block_ = mark.block;
    used_ = mark.used;
  }

  /// Leaves room for n to the list that was allocated last.
  void shrink(const Crossings& list, std::size_t n) {
    used_ = static_cast<std::size_t>(list.beam -
                                     reinterpret_cast<const std::uint32_t*>(blocks_[block_].bytes.get())) +
            n;
  }

  /// Frees a list, and what was allocated after it, if it is in the block in use.
  void free_from(const Crossings& list) {
    if (block_ == blocks_.size()) return;
    const auto* const begin = reinterpret_cast<const std::uint32_t*>(blocks_[block_].bytes.get());
    if (std::less_equal<>()(begin, list.beam) && std::less<>()(list.beam, begin + used_)) shrink(list, 0);
  }

  /// An empty list with room for n, the slack included.
  [[nodiscard]] NDTREE_ALWAYS_INLINE Crossings allocate(std::size_t n) {
    if (block_ == blocks_.size() || used_ + n > blocks_[block_].room) next_block(n);
    const Block& block = blocks_[block_];
    const Crossings list{reinterpret_cast<std::uint32_t*>(block.bytes.get()) + used_, block.room, 0};
    used_ += n;
    return list;
  }

 private:
  static constexpr std::size_t kBlock = std::size_t{1} << 15;
  static constexpr std::size_t kBytes = sizeof(std::uint32_t) + 2 * sizeof(float);
  struct Block {
    std::size_t room;
    std::unique_ptr<std::byte[]> bytes;  // Not initialised: what is not used is not resident.
    explicit Block(std::size_t n) : room(n), bytes(new std::byte[n * kBytes]) {}
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

/// Children's lists of a long list that is clipped piece by piece: so they take memory for the beams that
/// there are, and not for those that there could be.
template <int kCount>
class PiecewiseLists {
 public:
  /// Where a piece's lists belong.
  [[nodiscard]] CrossingStack& memory() { return memory_; }
  /// @pre the piece was allocated last, and its beams come after those of the pieces before.
  void add(SiblingLists<kCount> piece) {
    memory_.shrink(piece.memory, piece.pack());
    pieces_.push_back(piece);
  }
  /// All pieces as one, which are then forgotten; the list of the last child comes first.
  [[nodiscard]] SiblingLists<kCount> join(CrossingStack& stack) {
    SiblingLists<kCount> all;
    std::size_t room = 0;
    for (std::size_t c = kCount; c-- > 0;) {
      all.first[c] = all.last[c] = room;
      for (const SiblingLists<kCount>& piece : pieces_) room += piece.last[c] - piece.first[c];
      room += Crossings::kSlack;
    }
    all.memory = stack.allocate(room);
    for (std::size_t c = 0; c < kCount; ++c) {
      Crossings list = all.of(static_cast<int>(c));
      for (const SiblingLists<kCount>& piece : pieces_) append(piece.of(static_cast<int>(c)), list);
      all.last[c] += list.size;
    }
    pieces_.clear();
    memory_.release({});
    return all;
  }

 private:
  CrossingStack memory_;
  std::vector<SiblingLists<kCount>> pieces_;
};

}  // namespace ndtree
