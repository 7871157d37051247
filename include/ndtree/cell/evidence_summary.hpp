// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The summary of siblings with evidence, eight at a time.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/evidence_model.hpp"
#include "ndtree/cell/summary.hpp"
#include "ndtree/core/lanes.hpp"
#include "ndtree/core/simd.hpp"

namespace ndtree {

/// summary_of_siblings() of kCount nodes of the size of a cell.
template <int kCount>
class EvidenceSummary {
 public:
  explicit EvidenceSummary(const EvidenceModel& model) : model_(model), width_(Simd::width()) {
    std::array<std::uint32_t, kWords> saturated;
    static_assert(sizeof(EvidenceCell) == sizeof saturated, "a cell is its words");
    std::memcpy(saturated.data(), &model.saturated(), sizeof saturated);
    saturated_first_.fill(model.forgets_nothing() ? saturated[0] : kOfNoLeaf);
    saturated_third_.fill(saturated[2]);
    valid_.fill(Summary::kValid);
    bound_.fill(Summary::kBound);
    occupied_.fill(Summary::flag(CellState::occupied));
    unknown_.fill(Summary::flag(CellState::unknown));
    unsaturated_.fill(Summary::kUnsaturated);
  }

  template <class NodeType>
  [[nodiscard]] SummaryOfSiblings operator()(const NodeType* siblings) const {
#ifdef NDTREE_HAS_EIGHTS
    if (width_ >= 8) return call_by_eights(siblings);
#endif
    // Cells of any kind, by what they say of themselves; vectors read the words of evidence cells.
    return summary_of_siblings(siblings, kCount,
                               [this](const EvidenceCell& cell) { return model_.is_saturated(cell); });
  }

 private:
  static constexpr int kWords = EvidenceCell::kNumWords;
  static constexpr std::uint32_t kOfNoLeaf = 0xffffffffu;  // A first word.
  struct alignas(32) EightWords : std::array<std::uint32_t, 8> {};

#ifdef NDTREE_HAS_EIGHTS
  template <class NodeType>
  NDTREE_BY_EIGHTS [[nodiscard]] SummaryOfSiblings call_by_eights(const NodeType* siblings) const {
    static_assert(sizeof(NodeType) == kWords * sizeof(std::uint32_t), "a node is a cell, or a link");
    return by_eights(reinterpret_cast<const std::uint32_t*>(siblings));
  }
  struct Words {
    EightInts first, second, third;
  };
  /// The words of eight nodes, or of all, some of them more than once, in any order.
  NDTREE_BY_EIGHTS [[nodiscard]] NDTREE_ALWAYS_INLINE static Words words_of_eight(const std::uint32_t* nodes,
                                                                                  int from) {
    static_assert(kWords == 3, "three columns");
    Words words;
    if constexpr (kCount >= 8) {  // The last eight again if there are fewer left.
      load_eight_rows_of_three(nodes + kWords * std::min(from, kCount - 8), words.first, words.second,
                               words.third);
    } else if constexpr (kCount == 4) {
      load_four_rows_of_three(nodes, words.first, words.second, words.third);
    } else {
      std::array<EightWords, kWords> columns;
      for (int i = 0; i < 8; ++i)
        for (int w = 0; w < kWords; ++w)
          columns[static_cast<std::size_t>(w)][static_cast<std::size_t>(i)] =
              nodes[kWords * std::min(i, kCount - 1) + w];
      words = {load(columns[0]), load(columns[1]), load(columns[2])};
    }
    return words;
  }
  NDTREE_BY_EIGHTS [[nodiscard]] NDTREE_ALWAYS_INLINE static EightInts load(const EightWords& eight) {
    return EightInts::load(eight.data());
  }
  /// @param nodes words: of a leaf, the second is its log-odds; of an inner node, the first has its top bit
  ///   set, and the second is the summary.
  NDTREE_BY_EIGHTS [[nodiscard]] NDTREE_ALWAYS_INLINE SummaryOfSiblings
  by_eights(const std::uint32_t* nodes) const {
    const EightInts valid = load(valid_);
    const EightInts bound = load(bound_);
    EightInts all = 0;  // All words or-ed, without the bound, and with the valid bit inverted.
    EightInts most = 0;
    EightInts firsts = 0;
#pragma GCC unroll 2
    for (int from = 0; from < kCount; from += 8) {
      const auto [first, second, third] = words_of_eight(nodes, from);
      const EightMask is_inner = EightInts(0) > first;
      const EightInts sign = unsigned_shifted_right(second, 31);
      const EightMask is_saturated = ((first & EvidenceCell::kComparedBits) == load(saturated_first_)) &
                                     (third == load(saturated_third_));
      const EightMask is_unknown = float_of(second) == 0.0f;
      const EightInts state = select(is_unknown, load(unknown_), shifted_left(load(occupied_), sign));
      const EightInts ordered = second ^ (shifted_right(second, 31) | 0x80000000u);
      const EightInts leaf =
          ((ordered + 0xff) & bound) | valid | state | load(unsaturated_).without(is_saturated);
      const EightInts words = select(is_inner, second, leaf);
      all = all | (words ^ valid);
      most = unsigned_max_of(most, words & bound);
      firsts = firsts | first;
    }
    const std::uint32_t word = any_bits_of(all);
    SummaryOfSiblings result;
    result.are_leaves = (EightInts(0) > firsts).set() == 0;
    if ((word & Summary::kValid) == 0)
      result.summary = Summary((word & ~Summary::kBound) | Summary::kValid | unsigned_largest_of(most));
    return result;
  }
#endif

  const EvidenceModel& model_;
  int width_;
  // Eight times each: compilers would put them together from parts for each node.
  EightWords saturated_first_;
  EightWords saturated_third_;
  EightWords valid_;
  EightWords bound_;
  EightWords occupied_;
  EightWords unknown_;
  EightWords unsaturated_;
};

}  // namespace ndtree
