// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The nodes of an OctoMap file, from a map.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/cell/summary.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/io/byte_stream.hpp"
#include "ndtree/io/coarser.hpp"
#include "ndtree/io/octomap_tree.hpp"

namespace ndtree {

namespace detail {

/// Nodes of an OctoMap tree, depth first.
struct OctomapNode {
  float log_odds = 0.0f;
  OctomapColor color = kOctomapNoColor;
  std::uint8_t children = 0;  ///< One bit for each that exists; 0 for a leaf.
  std::uint32_t size = 1;     ///< Nodes of the subtree, this one included.
};

/// Asks a map for OctoMap's cells by the rule of coarser.hpp, and divides no cube in which all answers are
/// the same.
///
/// The map's nodes that a cube overlaps are passed on from cube to cube, each divided as long as it is
/// larger than the cube: so a cube costs what it overlaps, not the way from the root. A cube that is an inner
/// node of the map is divided unasked, as equal siblings are joined anyway; where children halve, it is
/// copied. With cells of the map's own size that is nearly all, and takes O(nodes).
template <class Map>
class OctomapSampler {
  using Tree = typename Map::Tree;
  using Ref = typename Tree::ConstRef;
  static constexpr std::size_t kSteps = 16;  // Of a question to the map.

 public:
  /// @param colors may be null.
  OctomapSampler(const Map& map, OctomapFormat format, double cell_size, const OctomapColors<Map>* colors)
      : tree_(map.tree()),
        known_(tree_.box(tree_.root().index)),
        colors_(colors),
        cells_(map.options().min_cell_size, 0.0, cell_size),
        binary_(format == OctomapFormat::binary),
        coarser_(cells_.are_coarser()),
        cell_size_(cell_size) {
    require_reach(tree_.root(), static_cast<double>(kOctomapZero) * cell_size);
  }

  [[nodiscard]] std::vector<OctomapNode> nodes() {
    nodes_.reserve(tree_.num_nodes() / 2);
    Asked all;
    for (std::size_t a = 0; a < 3; ++a) set(all, a, 0, std::int64_t{1} << kOctomapLevels);
    refs_.push_back(tree_.root());
    if (sample(all, kOctomapLevels, 0, 1) && binary_ && nodes_.size() == 1) {
      const OctomapNode leaf = nodes_[0];  // Such a file says nothing of the root itself.
      nodes_.insert(nodes_.end(), 8, leaf);
      nodes_[0].children = 0xff;
      nodes_[0].size = 9;
    }
    return std::move(nodes_);
  }

 private:
  /// The cells of a cube.
  struct Asked {
    OctomapKey key;
    Box<3> centres;                      ///< From the first to the last, closed [m].
    std::array<double, 3> lower, upper;  ///< Of the cube, half-open, in the map's smallest cells.
  };

  void require_reach(const Ref& ref, double reach) const {
    const Box<3> box = tree_.box(ref.index);
    if (box.lower.minCoeff() >= -reach && box.upper.maxCoeff() <= reach) return;
    if (!ref.is_leaf()) {
      for (int j = 0; j < Tree::kNumChildren; ++j) require_reach(tree_.child(ref, j), reach);
    } else if (ref.cell().state() != CellState::unknown) {
      throw std::invalid_argument("a cell at " + describe_point(box.lower) + " m: with cells of " +
                                  describe_number(cell_size_) + " m, OctoMap's 16 levels end " +
                                  describe_number(reach) +
                                  " m from 0; shift the map, or choose a larger cell_size");
    }
  }
  [[nodiscard]] double centre(std::int64_t key) const {
    return (static_cast<double>(key - kOctomapZero) + 0.5) * cell_size_;
  }
  /// Sets a cube's cells along an axis.
  void set(Asked& asked, std::size_t a, std::int64_t begin, std::int64_t end) const {
    asked.key[a] = begin;
    asked.centres.lower[static_cast<int>(a)] = centre(begin);
    asked.centres.upper[static_cast<int>(a)] = centre(end - 1);
    asked.lower[a] = cells_.border(begin - kOctomapZero);
    asked.upper[a] = cells_.border(end - kOctomapZero);
  }
  /// What is written for a cell; 0 for nothing.
  template <class Cell>
  [[nodiscard]] float value_of(const Cell& cell) const {
    if (!binary_) return cell.log_odds();
    return static_cast<float>(cell.state() == CellState::occupied) -
           static_cast<float>(cell.state() == CellState::free);
  }

  /// Appends the nodes of a cube, if anything in it is known. @returns whether it is.
  /// @param first, last the map's nodes that its parent overlaps, in refs_.
  bool sample(const Asked& asked, int level, std::size_t first, std::size_t last) {
    pace_.spend(kSteps);
    const std::size_t begin = refs_.size();
    for (std::size_t i = first; i < last; ++i) narrow(Ref(refs_[i]), asked);
    const bool has_any = sample_refs(asked, level, begin, refs_.size());
    refs_.resize(begin);
    return has_any;
  }
  /// Appends to refs_ what a node has to say of a cube: itself, or those below it that are no larger.
  void narrow(const Ref& ref, const Asked& asked) {
    if (!matters(ref, asked)) return;
    const auto edge = static_cast<double>(tree_.geometry().edge(ref.index.level));
    if (ref.is_leaf() || edge <= asked.upper[0] - asked.lower[0]) {
      refs_.push_back(ref);
      return;
    }
    for (int j = 0; j < Tree::kNumChildren; ++j) narrow(tree_.child(ref, j), asked);
  }

  bool sample_refs(const Asked& asked, int level, std::size_t first, std::size_t last) {
    if (first == last) return false;
    std::optional<float> value;
    if (level == 0 && coarser_) {
      value = 0.0f;
      for (std::size_t i = first; i < last; ++i) take_largest(refs_[i], asked, *value);
    } else if (level == 0) {
      value = value_at(asked.centres.lower, first, last);
    } else if (!is_inner_node(asked, first, last)) {
      if (!known_.encloses(asked.centres)) value = 0.0f;
      for (std::size_t i = first; i < last; ++i) {
        if (is_uniform(refs_[i], asked, value)) continue;
        value.reset();
        break;
      }
    } else if (is_unknown(*refs_[first].node)) {
      return false;
    } else if (Map::kBranching == 2 && !coarser_ && colors_ == nullptr) {
      return copy(*refs_[first].node);
    }
    if (value && *value == 0.0f) return false;
    MeanValue<3> color;
    if (value && (colors_ == nullptr || has_one_color(colors_->tree().root(), asked, color) || level == 0)) {
      OctomapNode leaf;
      leaf.log_odds = *value;
      leaf.color = octomap_color(color);
      nodes_.push_back(leaf);
      return true;
    }
    return divide(asked, level, first, last);
  }
  [[nodiscard]] bool is_inner_node(const Asked& asked, std::size_t first, std::size_t last) const {
    if (last - first != 1 || refs_[first].is_leaf()) return false;
    const CellIndex<3>& index = refs_[first].index;
    const auto edge = static_cast<double>(tree_.geometry().edge(index.level));
    for (std::size_t a = 0; a < 3; ++a) {
      const auto lower = static_cast<double>(index.lower[a]);
      if (lower != asked.lower[a] || lower + edge != asked.upper[a]) return false;
    }
    return true;
  }
  [[nodiscard]] float value_at(const Vector<3>& point, std::size_t first, std::size_t last) const {
    if (!tree_.geometry().in_reach(point)) return 0.0f;
    const Lattice<3> coordinates = tree_.geometry().coordinates(point);
    for (std::size_t i = first; i < last; ++i) {
      Ref ref = refs_[i];
      if (!tree_.geometry().contains(ref.index, coordinates)) continue;
      while (!ref.is_leaf()) ref = tree_.child_towards(ref, coordinates);
      return value_of(ref.cell());
    }
    return 0.0f;
  }

  bool divide(const Asked& asked, int level, std::size_t first, std::size_t last) {
    std::array<Asked, 2> halves;
    const std::int64_t edge = std::int64_t{1} << (level - 1);
    for (std::size_t a = 0; a < 3; ++a) {
      set(halves[0], a, asked.key[a], asked.key[a] + edge);
      set(halves[1], a, asked.key[a] + edge, asked.key[a] + 2 * edge);
    }
    return append_inner([&](int child) {
      Asked part;
      for (std::size_t a = 0; a < 3; ++a) {
        const Asked& half = halves[static_cast<std::size_t>(child >> a & 1)];
        const int axis = static_cast<int>(a);
        part.key[a] = half.key[a];
        part.centres.lower[axis] = half.centres.lower[axis];
        part.centres.upper[axis] = half.centres.upper[axis];
        part.lower[a] = half.lower[a];
        part.upper[a] = half.upper[a];
      }
      return sample(part, level - 1, first, last);
    });
  }
  /// Appends the nodes of a cube that is a node of the map, whose children are those of the cube.
  bool copy(const typename Tree::NodeType& node) {
    if (node.is_leaf()) {
      OctomapNode leaf;
      leaf.log_odds = value_of(node.cell());
      if (leaf.log_odds == 0.0f) return false;
      nodes_.push_back(leaf);
      return true;
    }
    pace_.spend(kSteps);
    const auto* const children = tree_.children(node);
    return append_inner([&](int child) { return copy(children[child]); });
  }
  /// Appends an inner node and what it has below, or a leaf instead of eight that are alike.
  /// @param append_child appends a child by its number: bool(int). @returns whether any has appended one.
  template <class Append>
  bool append_inner(const Append& append_child) {
    const std::size_t here = nodes_.size();
    nodes_.emplace_back();
    unsigned children = 0;
    bool alike = true;
    float most = -std::numeric_limits<float>::infinity();
    unsigned colored = 0;
    std::array<unsigned, 3> sum{};
    for (int child = 0; child < 8; ++child) {
      const std::size_t at = nodes_.size();
      if (!append_child(child)) continue;
      children |= 1u << child;
      most = std::max(most, nodes_[at].log_odds);
      alike = alike && nodes_[at].children == 0 && nodes_[at].log_odds == nodes_[here + 1].log_odds &&
              nodes_[at].color == nodes_[here + 1].color;
      if (nodes_[at].color == kOctomapNoColor) continue;
      ++colored;
      for (std::size_t i = 0; i < 3; ++i) sum[i] += nodes_[at].color[i];
    }
    if (children == 0) {
      nodes_.resize(here);
      return false;
    }
    if (alike && children == 0xff) {
      nodes_.resize(here + 1);
      children = 0;
    }
    nodes_[here].log_odds = most;
    nodes_[here].children = static_cast<std::uint8_t>(children);
    nodes_[here].size = static_cast<std::uint32_t>(nodes_.size() - here);
    for (std::size_t i = 0; i < 3 && colored > 0; ++i)
      nodes_[here].color[i] = static_cast<std::uint8_t>(sum[i] / colored);
    return true;
  }

  /// Whether a node says anything of what is asked.
  [[nodiscard]] bool matters(const Ref& ref, const Asked& asked) const {
    if (!coarser_) return asked.centres.touches(tree_.box(ref.index));
    return overlaps(ref.index, asked);
  }
  [[nodiscard]] bool overlaps(const CellIndex<3>& cell, const Asked& asked) const {
    const std::int64_t edge = tree_.geometry().edge(cell.level);
    for (std::size_t a = 0; a < 3; ++a) {
      const std::int64_t begin = cell.lower[a];
      if (static_cast<double>(begin) >= asked.upper[a] || static_cast<double>(begin + edge) <= asked.lower[a])
        return false;
    }
    return true;
  }
  /// Whether nothing is known in all of a node.
  [[nodiscard]] static bool is_unknown(const typename Tree::NodeType& node) {
    const Summary summary = Summary::of(node);
    return !summary.may_contain(CellState::free) && !summary.may_contain(CellState::occupied);
  }
  /// Whether all leaves that matter have one value, and that of `value` if it has one already; else `value`
  /// becomes theirs.
  bool is_uniform(const Ref& ref, const Asked& asked, std::optional<float>& value) const {
    if (!matters(ref, asked)) return true;
    const bool unknown = is_unknown(*ref.node);
    if (ref.is_leaf() || unknown) {
      const float here = unknown ? 0.0f : value_of(ref.cell());
      if (!value) value = here;
      return *value == here;
    }
    for (int j = 0; j < Tree::kNumChildren; ++j)
      if (!is_uniform(tree_.child(ref, j), asked, value)) return false;
    return true;
  }
  /// Whether a cube has one colour, or none, all over. @param joined becomes that of all that overlaps it.
  bool has_one_color(const typename OctomapColors<Map>::Tree::ConstRef& ref, const Asked& asked,
                     MeanValue<3>& joined) const {
    if (!overlaps(ref.index, asked)) return true;
    if (ref.is_leaf()) {
      if (ref.cell().value.is_empty()) return true;
      joined.join(ref.cell().value);
      const auto edge = static_cast<double>(tree_.geometry().edge(ref.index.level));
      for (std::size_t a = 0; a < 3; ++a) {
        const auto begin = static_cast<double>(ref.index.lower[a]);
        if (begin > asked.lower[a] || begin + edge < asked.upper[a]) return false;
      }
      return true;
    }
    bool one = true;
    for (int j = 0; j < Tree::kNumChildren; ++j)
      one = has_one_color(colors_->tree().child(ref, j), asked, joined) && one;
    return one;
  }
  /// The largest value of the leaves that matter and are not unknown.
  void take_largest(const Ref& ref, const Asked& asked, float& value) const {
    if (!matters(ref, asked)) return;
    if (is_unknown(*ref.node)) return;
    if (ref.is_leaf()) {
      const float here = value_of(ref.cell());
      if (here != 0.0f && (value == 0.0f || here > value)) value = here;
      return;
    }
    for (int j = 0; j < Tree::kNumChildren; ++j) take_largest(tree_.child(ref, j), asked, value);
  }

  const Tree& tree_;
  Box<3> known_;  // The root's.
  const OctomapColors<Map>* colors_;
  CellsAlong cells_;
  bool binary_;
  bool coarser_;
  double cell_size_;
  std::vector<OctomapNode> nodes_;
  std::vector<Ref> refs_;  // Nodes of the map, those of a cube behind those of the cubes around it.
  Pace pace_;
};

inline void write_octomap_full(const std::vector<OctomapNode>& nodes, bool colored, ByteWriter& out) {
  out.bytes().reserve(out.bytes().size() + nodes.size() * (colored ? 8 : 5));
  for (const OctomapNode& node : nodes) {
    out.put(node.log_odds);
    for (std::size_t i = 0; i < 3 && colored; ++i) out.put(node.color[i]);
    out.put(node.children);
  }
}

/// @param at an inner node.
inline void write_octomap_binary(const std::vector<OctomapNode>& nodes, std::size_t at, ByteWriter& out) {
  std::uint16_t bits = 0;
  std::array<std::size_t, 8> inner{};
  std::size_t num_inner = 0;
  std::size_t next = at + 1;
  for (int child = 0; child < 8; ++child) {
    if ((nodes[at].children >> child & 1) == 0) continue;
    const OctomapNode& node = nodes[next];
    const int kind = node.children != 0 ? 3 : node.log_odds > 0.0f ? 2 : 1;
    bits = static_cast<std::uint16_t>(bits | kind << 2 * child);
    if (kind == 3) inner[num_inner++] = next;
    next += node.size;
  }
  out.put(bits);
  for (std::size_t i = 0; i < num_inner; ++i) write_octomap_binary(nodes, inner[i], out);
}

}  // namespace detail

}  // namespace ndtree
