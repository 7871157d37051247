// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What lies below an inner node, in one word, so that queries can skip it.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstring>

#include "ndtree/cell/occupancy_cell.hpp"

namespace ndtree {

/// The states of all leaves below a node, an upper bound of their log-odds, and whether all are saturated: as
/// long as beams pass, a scan leaves them as they are. The summary_word() of an inner node is such a word; 0
/// is a stale summary, of a node that is being changed.
class Summary {
 public:
  Summary() = default;
  explicit Summary(std::uint32_t word) : word_(word) {}
  template <class Cell>
  [[nodiscard]] static Summary of_cell(const Cell& cell, bool is_saturated = false) {
    const float value = cell.log_odds();
    std::uint32_t bits = 0;
    std::memcpy(&bits, &value, sizeof bits);
    const std::uint32_t sign = bits >> 31;
    const std::uint32_t state = value == 0.0f ? flag(CellState::unknown) : flag(CellState::occupied) << sign;
    return Summary(kValid | (is_saturated ? 0u : kUnsaturated) | state | bound(bits, sign));
  }
  /// Of a leaf, or of an inner node as it is written there. A leaf is not taken for saturated.
  template <class NodeType>
  [[nodiscard]] static Summary of(const NodeType& node) {
    return node.is_leaf() ? of_cell(node.cell()) : Summary(node.summary_word());
  }
  /// Of a leaf, which is saturated if `is_saturated(cell)`, or of an inner node as it is written
  /// there.
  template <class NodeType, class IsSaturated>
  [[nodiscard]] static Summary of(const NodeType& node, const IsSaturated& is_saturated) {
    return node.is_leaf() ? of_cell(node.cell(), is_saturated(node.cell())) : Summary(node.summary_word());
  }

  [[nodiscard]] std::uint32_t word() const { return word_; }
  /// False if stale.
  [[nodiscard]] bool is_valid() const { return (word_ & kValid) != 0; }
  /// Whether some leaf has, or might have, this state.
  [[nodiscard]] bool may_contain(CellState state) const { return !is_valid() || (word_ & flag(state)) != 0; }
  /// Whether it is certain that all leaves have the same state, and not that of unknown space.
  [[nodiscard]] bool is_uniform() const {
    const std::uint32_t states = word_ & kStates;
    return states == flag(CellState::free) || states == flag(CellState::occupied);
  }
  /// Whether every leaf is saturated.
  [[nodiscard]] bool is_saturated() const { return is_valid() && (word_ & kUnsaturated) == 0; }
  /// No leaf has more, and one has at least this but for a 32,768th. @pre is_valid().
  [[nodiscard]] float max_log_odds() const {
    const std::uint32_t bits = float_bits(word_ & kBound);
    float value = 0.0f;
    std::memcpy(&value, &bits, sizeof value);
    return value;
  }
  void add(const Summary& other) {
    word_ = ((word_ | other.word_) & ~kBound) | std::max(word_ & kBound, other.word_ & kBound);
  }

 private:
  template <int kCount>
  friend class EvidenceSummary;

  static constexpr std::uint32_t kValid = 1;
  static constexpr std::uint32_t kStates = 2 | 4 | 8;
  static constexpr std::uint32_t kUnsaturated = 16;
  static constexpr std::uint32_t kBound = 0xffffff00u;  // The upper 24 bits of a float, ordered as it is.

  /// That of free space is twice that of occupied.
  [[nodiscard]] static constexpr std::uint32_t flag(CellState state) {
    return state == CellState::occupied ? 2u : state == CellState::free ? 4u : 8u;
  }
  /// Inverse of what bound() makes of a float's bits, so that they are ordered as floats are.
  [[nodiscard]] static std::uint32_t float_bits(std::uint32_t ordered) {
    return (ordered & 0x80000000u) != 0 ? ordered & 0x7fffffffu : ~ordered;
  }
  [[nodiscard]] static std::uint32_t bound(std::uint32_t bits, std::uint32_t sign) {
    return ((bits ^ ((0u - sign) | 0x80000000u)) + 0xffu) & kBound;  // Upwards.
  }

  std::uint32_t word_ = 0;
};

/// The summary of siblings.
struct SummaryOfSiblings {
  Summary summary;         ///< Stale if that of one of them is.
  bool are_leaves = true;  ///< All of them.
};

/// @param is_saturated whether a cell is.
template <class NodeType, class IsSaturated>
SummaryOfSiblings summary_of_siblings(const NodeType* siblings, int count, const IsSaturated& is_saturated) {
  SummaryOfSiblings result;
  bool is_valid = true;
  for (int j = 0; j < count; ++j) {
    const Summary sibling = Summary::of(siblings[j], is_saturated);
    is_valid = is_valid && sibling.is_valid();
    result.are_leaves = result.are_leaves && siblings[j].is_leaf();
    result.summary.add(sibling);
  }
  if (!is_valid) result.summary = {};
  return result;
}

/// Writes the summary of an inner node from those of its children. @returns it; stale if one of them is.
/// @param is_saturated whether a cell is.
template <class Tree, class IsSaturated>
Summary summarise(Tree& tree, typename Tree::NodeType& parent, const IsSaturated& is_saturated) {
  const Summary summary =
      summary_of_siblings(tree.children(parent), Tree::kNumChildren, is_saturated).summary;
  parent.set_summary_word(summary.word());
  return summary;
}

/// Writes the summaries of a node and of all below it that are 0. O(inner nodes that have or had one, and
/// their children).
template <class Tree, class IsSaturated>
void summarise_stale(Tree& tree, typename Tree::NodeType& node, const IsSaturated& is_saturated) {
  if (node.is_leaf() || node.summary_word() != 0) return;
  auto* const children = tree.children(node);
  for (int j = 0; j < Tree::kNumChildren; ++j) summarise_stale(tree, children[j], is_saturated);
  summarise(tree, node, is_saturated);
}

/// All summaries of a tree become stale. O(nodes).
template <class Tree>
void forget_summaries(Tree& tree) {
  const auto descend = [&](const auto& self, typename Tree::NodeType& node) -> void {
    if (node.is_leaf()) return;
    node.set_summary_word(0);
    auto* const children = tree.children(node);
    for (int j = 0; j < Tree::kNumChildren; ++j) self(self, children[j]);
  };
  descend(descend, *tree.root().node);
}

}  // namespace ndtree
