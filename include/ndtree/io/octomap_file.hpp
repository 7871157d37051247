// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// OctoMap's own files, .bt and .ot: any 3-D map into them, and them into a map.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <optional>
#include <sstream>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/cell/summary.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/io/byte_stream.hpp"
#include "ndtree/io/coarser.hpp"
#include "ndtree/io/map_builder.hpp"
#include "ndtree/layers/layer.hpp"
#include "ndtree/layers/values.hpp"
#include "ndtree/tree/visit.hpp"

namespace ndtree {

/// The two kinds of files.
enum class OctomapFormat {
  full,   ///< .ot: every leaf with its log-odds.
  binary  ///< .bt: every leaf free or occupied, and no more.
};

// OctoMap (Hornung et al. 2013) is an octree of 16 levels about 0, of 65536 cells on each axis; a cell has
// the key floor(x / cell size) + 32768. Children are numbered with x in bit 0, y in bit 1, z in bit 2.
// Unknown space has no node. An inner node has the largest log-odds of its children. A file is a text header,
// which ends with a line "data", and the nodes depth first: in .ot a float and a byte that says which
// children there are; in .bt, for each inner node, two bits a child, 1 free, 2 occupied, 3 with children of
// its own. A ColorOcTree's .ot has a node's red, green and blue between the two, white where there is none;
// an inner node has the mean of its children's. Its .bt is that of an OcTree.

/// Colours of cells, from 0 to 255 each.
template <class Map>
using OctomapColors = Layer<Map::kBranching, 3, MeanValue<3>>;

namespace detail {

inline constexpr int kOctomapLevels = 16;
inline constexpr std::int64_t kOctomapZero = 32768;  // The key of the cell [0, cell size).
inline constexpr std::string_view kOctomapFullMagic = "# Octomap OcTree file";
inline constexpr std::string_view kOctomapBinaryMagic = "# Octomap OcTree binary file";

using OctomapKey = std::array<std::int64_t, 3>;

[[nodiscard]] inline OctomapKey octomap_child(OctomapKey key, int child, std::int64_t edge) {
  for (std::size_t a = 0; a < 3; ++a) key[a] += (child >> a & 1) * edge;
  return key;
}

using OctomapColor = std::array<std::uint8_t, 3>;
inline constexpr OctomapColor kOctomapNoColor = {255, 255, 255};

/// A colour as OctoMap has it, that of white things a little darker: white is none.
[[nodiscard]] inline OctomapColor octomap_color(const MeanValue<3>& value) {
  if (value.is_empty()) return kOctomapNoColor;
  OctomapColor color;
  for (std::size_t i = 0; i < 3; ++i)
    color[i] = static_cast<std::uint8_t>(std::lround(std::clamp(value.mean()[i], 0.0f, 255.0f)));
  return color == kOctomapNoColor ? OctomapColor{254, 254, 254} : color;
}

/// Nodes of an OctoMap tree, depth first.
struct OctomapNode {
  float log_odds = 0.0f;
  OctomapColor color = kOctomapNoColor;
  std::uint8_t children = 0;  ///< One bit for each that exists; 0 for a leaf.
  std::uint32_t size = 1;     ///< Nodes of the subtree, this one included.
};

/// Asks a map for OctoMap's cells by the rule of coarser.hpp, and divides no cube in which all answers are
/// the same.
template <class Map>
class OctomapSampler {
  using Tree = typename Map::Tree;
  static constexpr std::size_t kSteps = 16;  // Of a question to the map.

 public:
  /// @param colors may be null.
  OctomapSampler(const Map& map, OctomapFormat format, double cell_size, const OctomapColors<Map>* colors)
      : tree_(map.tree()),
        colors_(colors),
        cells_(map.options().min_cell_size, 0.0, cell_size),
        binary_(format == OctomapFormat::binary),
        coarser_(cells_.are_coarser()),
        cell_size_(cell_size) {
    const double reach = static_cast<double>(kOctomapZero) * cell_size;
    for_each_leaf(tree_, [&](const auto& leaf) {
      if (leaf.cell().state() == CellState::unknown) return;
      const Box<3> box = tree_.box(leaf.index);
      if (box.lower.minCoeff() < -reach || box.upper.maxCoeff() > reach)
        throw std::invalid_argument("a cell at " + text(box.lower) + " m: with cells of " +
                                    describe_number(cell_size) + " m, OctoMap's 16 levels end " +
                                    describe_number(reach) +
                                    " m from 0; shift the map, or choose a larger cell_size");
    });
  }

  [[nodiscard]] std::vector<OctomapNode> nodes() {
    const OctomapKey first{};
    if (sample(first, kOctomapLevels) && binary_ && nodes_.size() == 1) {
      const OctomapNode leaf = nodes_[0];  // Such a file says nothing of the root itself.
      nodes_.insert(nodes_.end(), 8, leaf);
      nodes_[0].children = 0xff;
      nodes_[0].size = 9;
    }
    return std::move(nodes_);
  }

 private:
  static std::string text(const Vector<3>& point) {
    return "(" + describe_number(point.x()) + ", " + describe_number(point.y()) + ", " +
           describe_number(point.z()) + ")";
  }
  [[nodiscard]] double centre(std::int64_t key) const {
    return (static_cast<double>(key - kOctomapZero) + 0.5) * cell_size_;
  }
  /// What is written for a cell; 0 for nothing.
  template <class Cell>
  [[nodiscard]] float value_of(const Cell& cell) const {
    if (!binary_) return cell.log_odds();
    return static_cast<float>(cell.state() == CellState::occupied) -
           static_cast<float>(cell.state() == CellState::free);
  }

  /// Appends the nodes of a cube, if anything in it is known. @returns whether it is.
  bool sample(const OctomapKey& key, int level) {
    pace_.spend(kSteps);
    const Asked asked = asked_of(key, std::int64_t{1} << level);
    std::optional<float> value;
    if (level == 0 && coarser_) {
      value = 0.0f;
      take_largest(tree_.root(), asked, *value);
    } else if (level == 0) {
      const auto leaf = tree_.find_leaf(asked.centres.lower);
      value = leaf ? value_of(leaf->cell()) : 0.0f;
    } else {
      if (!tree_.box(tree_.root().index).encloses(asked.centres)) value = 0.0f;
      if (!is_uniform(tree_.root(), asked, value)) value.reset();
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
    return divide(key, level);
  }

  bool divide(const OctomapKey& key, int level) {
    const std::size_t here = nodes_.size();
    nodes_.emplace_back();
    unsigned children = 0;
    bool alike = true;
    float most = -std::numeric_limits<float>::infinity();
    unsigned colored = 0;
    std::array<unsigned, 3> sum{};
    for (int child = 0; child < 8; ++child) {
      const std::size_t at = nodes_.size();
      if (!sample(octomap_child(key, child, std::int64_t{1} << (level - 1)), level - 1)) continue;
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

  /// The cells of a cube.
  struct Asked {
    Box<3> centres;                      ///< From the first to the last, closed [m].
    std::array<double, 3> lower, upper;  ///< Of the cube, half-open, in the map's smallest cells.
  };
  [[nodiscard]] Asked asked_of(const OctomapKey& key, std::int64_t edge) const {
    Asked asked;
    for (std::size_t a = 0; a < 3; ++a) {
      asked.centres.lower[static_cast<int>(a)] = centre(key[a]);
      asked.centres.upper[static_cast<int>(a)] = centre(key[a] + edge - 1);
      asked.lower[a] = cells_.border(key[a] - kOctomapZero);
      asked.upper[a] = cells_.border(key[a] - kOctomapZero + edge);
    }
    return asked;
  }
  /// Whether a node says anything of what is asked.
  [[nodiscard]] bool matters(const typename Tree::ConstRef& ref, const Asked& asked) const {
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
  /// Whether all leaves that matter have one value, and that of `value` if it has one already; else `value`
  /// becomes theirs.
  bool is_uniform(const typename Tree::ConstRef& ref, const Asked& asked, std::optional<float>& value) const {
    if (!matters(ref, asked)) return true;
    const Summary summary = Summary::of(*ref.node);
    const bool unknown = !summary.may_contain(CellState::free) && !summary.may_contain(CellState::occupied);
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
  void take_largest(const typename Tree::ConstRef& ref, const Asked& asked, float& value) const {
    if (!matters(ref, asked)) return;
    const Summary summary = Summary::of(*ref.node);
    if (!summary.may_contain(CellState::free) && !summary.may_contain(CellState::occupied)) return;
    if (ref.is_leaf()) {
      const float here = value_of(ref.cell());
      if (here != 0.0f && (value == 0.0f || here > value)) value = here;
      return;
    }
    for (int j = 0; j < Tree::kNumChildren; ++j) take_largest(tree_.child(ref, j), asked, value);
  }

  const Tree& tree_;
  const OctomapColors<Map>* colors_;
  CellsAlong cells_;
  bool binary_;
  bool coarser_;
  double cell_size_;
  std::vector<OctomapNode> nodes_;
  Pace pace_;
};

inline void write_octomap_full(const std::vector<OctomapNode>& nodes, bool colored, ByteWriter& out) {
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

/// A leaf of an OctoMap file.
struct OctomapLeaf {
  OctomapKey key;
  int level;  ///< 0 for the smallest cells.
  float log_odds;
  OctomapColor color = kOctomapNoColor;
};

/// Reads the nodes behind the header.
class OctomapReader {
 public:
  /// @param log_odds_free, log_odds_occupied what a .bt file's leaves mean.
  OctomapReader(std::string_view data, float log_odds_free, float log_odds_occupied)
      : in_(data), free_(log_odds_free), occupied_(log_odds_occupied) {}

  /// @param nodes as the header says. @throws std::runtime_error where the data cannot be such a tree.
  /// @param colored whether nodes of an .ot have colours.
  std::vector<OctomapLeaf> read(OctomapFormat format, std::uint64_t nodes, bool colored) {
    colored_ = colored;
    if (nodes > 0) {
      if (format == OctomapFormat::full) {
        read_full({}, kOctomapLevels);
      } else {
        ++nodes_;
        read_binary({}, kOctomapLevels);
      }
    }
    if (nodes_ != nodes)
      throw std::runtime_error("found " + std::to_string(nodes_) + " nodes, expected " +
                               std::to_string(nodes) + " as the header says");
    if (!in_.at_end())
      throw std::runtime_error("nodes end at byte " + std::to_string(in_.position()) +
                               " of the data, expected them to fill it");
    return std::move(leaves_);
  }

 private:
  void read_full(const OctomapKey& key, int level) {
    pace_.spend();
    ++nodes_;
    const auto log_odds = in_.get<float>();
    OctomapColor color = kOctomapNoColor;
    for (std::size_t i = 0; i < 3 && colored_; ++i) color[i] = in_.get<std::uint8_t>();
    const auto children = in_.get<std::uint8_t>();
    if (std::isnan(log_odds)) fail("a node's log-odds is not a number");
    if (children == 0) {
      leaves_.push_back({key, level, log_odds, color});
      return;
    }
    if (level == 0) fail("a node below the 16th level");
    for (int child = 0; child < 8; ++child)
      if ((children >> child & 1) != 0)
        read_full(octomap_child(key, child, std::int64_t{1} << (level - 1)), level - 1);
  }
  void read_binary(const OctomapKey& key, int level) {
    pace_.spend();
    const auto bits = in_.get<std::uint16_t>();
    if (level == 0) fail("a node below the 16th level");
    for (int child = 0; child < 8; ++child) {
      const int kind = bits >> 2 * child & 3;
      if (kind == 0) continue;
      ++nodes_;
      if (kind != 3)
        leaves_.push_back({octomap_child(key, child, std::int64_t{1} << (level - 1)), level - 1,
                           kind == 2 ? occupied_ : free_, kOctomapNoColor});
    }
    for (int child = 0; child < 8; ++child)
      if ((bits >> 2 * child & 3) == 3)
        read_binary(octomap_child(key, child, std::int64_t{1} << (level - 1)), level - 1);
  }
  [[noreturn]] void fail(const char* what) const {
    throw std::runtime_error(std::string(what) + ", at byte " + std::to_string(in_.position()) +
                             " of the data");
  }

  ByteReader in_;
  float free_;
  float occupied_;
  bool colored_ = false;
  std::uint64_t nodes_ = 0;
  std::vector<OctomapLeaf> leaves_;
  Pace pace_;
};

struct OctomapHeader {
  OctomapFormat format = OctomapFormat::full;
  std::uint64_t nodes = 0;
  double cell_size = 0.0;
  bool colored = false;   ///< Of a ColorOcTree.
  std::string_view data;  ///< All that follows.
};

/// Files of before OctoMap 1.0, all .bt: a type of tree, 3, the resolution, the number of nodes, and nodes.
inline constexpr std::string_view kOctomapLegacyMagic{"\3\0\0\0", 4};

inline OctomapHeader read_octomap_legacy_header(std::string_view bytes) {
  OctomapHeader header;
  header.format = OctomapFormat::binary;
  ByteReader in(bytes.substr(kOctomapLegacyMagic.size()));
  header.cell_size = in.get<double>();
  header.nodes = in.get<std::uint32_t>();
  if (!(header.cell_size > 0.0) || !std::isfinite(header.cell_size))
    throw std::runtime_error("found a cell size of " + describe_number(header.cell_size) +
                             " m in the header of a file of before OctoMap 1.0, expected > 0 m");
  header.data = bytes.substr(kOctomapLegacyMagic.size() + sizeof(double) + sizeof(std::uint32_t));
  return header;
}

/// @throws std::runtime_error naming the line that is wrong.
inline OctomapHeader read_octomap_header(std::string_view bytes) {
  OctomapHeader header;
  if (bytes.substr(0, kOctomapLegacyMagic.size()) == kOctomapLegacyMagic)
    return read_octomap_legacy_header(bytes);
  const auto begins_with = [&](std::string_view text) { return bytes.substr(0, text.size()) == text; };
  if (begins_with(kOctomapBinaryMagic))
    header.format = OctomapFormat::binary;
  else if (!begins_with(kOctomapFullMagic))
    throw std::runtime_error("not an OctoMap file: expected '" + std::string(kOctomapFullMagic) + "' or '" +
                             std::string(kOctomapBinaryMagic) + "' in the first line");
  bool has_nodes = false;
  for (int number = 1;; ++number) {
    const std::size_t end = bytes.find('\n');
    if (end == std::string_view::npos || end > 4096)
      throw std::runtime_error("line " + std::to_string(number) +
                               ": expected the header of an OctoMap file, up to a line 'data'");
    const std::string line(bytes.substr(0, end));
    bytes.remove_prefix(end + 1);
    std::istringstream words(line);
    std::string name, rest;
    words >> name;
    if (name.empty() || name[0] == '#') continue;
    bool good = true;
    if (name == "data") {
      break;
    } else if (name == "id") {
      good = static_cast<bool>(words >> rest) && (rest == "OcTree" || rest == "ColorOcTree");
      header.colored = rest == "ColorOcTree";
    } else if (name == "size") {
      good = has_nodes = static_cast<bool>(words >> header.nodes);
    } else if (name == "res") {
      good = static_cast<bool>(words >> header.cell_size) && header.cell_size > 0.0 &&
             std::isfinite(header.cell_size);
    }
    if (!good)
      throw std::runtime_error(
          "line " + std::to_string(number) + ": found " + describe_text(line) +
          ", expected 'id OcTree' or 'id ColorOcTree', 'size' with a number of nodes, or 'res' with a cell "
          "size > 0 m");
  }
  if (!has_nodes || header.cell_size == 0.0)
    throw std::runtime_error("a header without 'size' or 'res', expected both");
  header.data = bytes;
  return header;
}

/// The colours of a file's leaves, those of an .ot of a ColorOcTree.
/// @param map what the leaves became.
template <class Map>
std::optional<OctomapColors<Map>> colors_of(const Map& map, const OctomapHeader& header,
                                            const std::vector<OctomapLeaf>& leaves) {
  if (!header.colored || header.format != OctomapFormat::full) return std::nullopt;
  const auto& geometry = map.tree().geometry();
  OctomapColors<Map> colors(geometry);
  for (const OctomapLeaf& leaf : leaves) {
    if (leaf.color == kOctomapNoColor || state_of(leaf.log_odds) == CellState::unknown) continue;
    MeanValue<3> value;
    value.add({static_cast<float>(leaf.color[0]), static_cast<float>(leaf.color[1]),
               static_cast<float>(leaf.color[2])});
    // The leaf itself where the map may have such cells, else the largest of the map's that fit.
    const int level =
        Map::kBranching == 2 ? std::min(geometry.finest_level() + leaf.level, 0) : geometry.finest_level();
    const std::int64_t step = geometry.edge(level);
    Lattice<3> lower, at;
    for (std::size_t a = 0; a < 3; ++a) lower[a] = leaf.key[a] - kOctomapZero;
    const std::int64_t edge = std::int64_t{1} << leaf.level;
    for (at[0] = lower[0]; at[0] < lower[0] + edge; at[0] += step)
      for (at[1] = lower[1]; at[1] < lower[1] + edge; at[1] += step)
        for (at[2] = lower[2]; at[2] < lower[2] + edge; at[2] += step) {
          const CellIndex<3> cell{at, level};
          const Box<3> box = map.tree().box(cell);
          colors.join(cell, 0.5 * (box.lower + box.upper), value);
        }
  }
  return colors;
}

}  // namespace detail

/// A 3-D map as the bytes of an OctoMap file.
///
/// Cells of OctoMap's follow from the map's by the rule of coarser.hpp. With the map's own min_cell_size that
/// is exact: cells of both have the same borders. Equal siblings are joined, so that leaves of every size
/// stay as large as they are, or become larger. Unknown space, and a log-odds of exactly 0, has no node.
/// @param cell_size OctoMap's resolution [m]; the map's min_cell_size if left out.
/// @param colors of the map's cells, may be null: with them, an .ot is of a ColorOcTree.
/// @throws std::invalid_argument if the cell size is not > 0, or something known lies beyond OctoMap's reach,
///   32768 cells from 0.
template <class Map>
[[nodiscard]] std::string octomap_bytes(const Map& map, OctomapFormat format,
                                        std::optional<double> cell_size = {},
                                        const OctomapColors<Map>* colors = nullptr) {
  static_assert(Map::kDim == 3, "OctoMap has three dimensions");
  const double size = cell_size.value_or(map.options().min_cell_size);
  const bool binary = format == OctomapFormat::binary;
  const bool colored = colors != nullptr && !binary;
  const std::vector<detail::OctomapNode> nodes =
      detail::OctomapSampler<Map>(map, format, size, colored ? colors : nullptr).nodes();
  ByteWriter out;
  out.bytes().append(binary ? detail::kOctomapBinaryMagic : detail::kOctomapFullMagic);
  out.bytes() += std::string(colored ? "\nid ColorOcTree" : "\nid OcTree") + "\nsize " +
                 std::to_string(nodes.size()) + "\nres " + shortest_text(size) + "\ndata\n";
  if (nodes.empty()) return std::move(out.bytes());
  if (binary)
    detail::write_octomap_binary(nodes, 0, out);
  else
    detail::write_octomap_full(nodes, colored, out);
  return std::move(out.bytes());
}

/// What a file of this name holds. @throws std::invalid_argument unless it ends in .bt or .ot.
[[nodiscard]] inline OctomapFormat octomap_format_of(const std::filesystem::path& path) {
  if (path.extension() == ".bt") return OctomapFormat::binary;
  if (path.extension() == ".ot") return OctomapFormat::full;
  throw std::invalid_argument(path.string() + ": the name of an OctoMap file must end in .bt or .ot");
}

/// Writes octomap_bytes() to a file, .bt or .ot; it appears whole or not at all.
/// @throws std::invalid_argument as octomap_bytes() and octomap_format_of().
/// @throws std::filesystem::filesystem_error naming the file and the system's reason.
template <class Map>
void save_octomap(const Map& map, const std::filesystem::path& path, std::optional<double> cell_size = {}) {
  write_file(path, octomap_bytes(map, octomap_format_of(path), cell_size));
}

/// The map in an OctoMap file's bytes: leaves of the same borders and states, which MapBuilder gives their
/// log-odds. Leaves of a .bt file get log_odds_min or log_odds_max. Those at exactly 0 are unknown here.
/// @param options of the map, but for min_cell_size, which is the file's resolution; max_cell_size and the
///   bounds of the log-odds are widened to what the file holds.
/// @param colors if given, becomes the colours of a ColorOcTree's .ot, and empty for any other file.
/// @throws std::runtime_error if the bytes are not those of such a file, MemoryLimitReached if the map would
///   hold more than max_memory.
template <class Map>
[[nodiscard]] Map octomap_from_bytes(std::string_view bytes, typename Map::Options options = {},
                                     std::optional<OctomapColors<Map>>* colors = nullptr) {
  static_assert(Map::kDim == 3, "OctoMap has three dimensions");
  options.validate();
  const detail::OctomapHeader header = detail::read_octomap_header(bytes);
  const std::vector<detail::OctomapLeaf> leaves =
      detail::OctomapReader(header.data, static_cast<float>(options.log_odds_min),
                            static_cast<float>(options.log_odds_max))
          .read(header.format, header.nodes, header.colored && header.format == OctomapFormat::full);
  options.min_cell_size = header.cell_size;
  options.max_cell_size = std::max(options.max_cell_size, header.cell_size);
  for (const detail::OctomapLeaf& leaf : leaves) {
    options.max_cell_size = std::max(options.max_cell_size, std::ldexp(header.cell_size, leaf.level));
    if (!std::isfinite(leaf.log_odds)) continue;
    options.log_odds_min = std::min(options.log_odds_min, static_cast<double>(leaf.log_odds));
    options.log_odds_max = std::max(options.log_odds_max, static_cast<double>(leaf.log_odds));
  }
  try {
    MapBuilder<Map> builder(options);
    double cells = 0.0;
    for (const detail::OctomapLeaf& leaf : leaves)
      if (state_of(leaf.log_odds) != CellState::unknown) cells += std::ldexp(1.0, 3 * leaf.level);
    builder.expect_cells(cells);
    for (const detail::OctomapLeaf& leaf : leaves) {
      Lattice<3> lower, upper;
      for (std::size_t a = 0; a < 3; ++a) {
        lower[a] = leaf.key[a] - detail::kOctomapZero;
        upper[a] = lower[a] + (std::int64_t{1} << leaf.level);
      }
      builder.fill(lower, upper, leaf.log_odds);
    }
    Map map = std::move(builder).finish();
    if (colors != nullptr) *colors = detail::colors_of(map, header, leaves);
    return map;
  } catch (const std::invalid_argument& error) {  // A resolution that no map can have.
    throw std::runtime_error(std::string("'res' or a leaf's log-odds: ") + error.what());
  }
}

/// Whether bytes begin as those of an OctoMap file do.
[[nodiscard]] inline bool is_octomap_file(std::string_view bytes) {
  const auto begins_with = [&](std::string_view text) { return bytes.substr(0, text.size()) == text; };
  return begins_with(detail::kOctomapFullMagic) || begins_with(detail::kOctomapBinaryMagic) ||
         begins_with(detail::kOctomapLegacyMagic);
}

/// Reads an OctoMap file, .bt or .ot, whatever its name.
/// @throws std::filesystem::filesystem_error if it cannot be read, std::runtime_error naming it if it is
///   damaged.
template <class Map>
[[nodiscard]] Map load_octomap(const std::filesystem::path& path, const typename Map::Options& options = {}) {
  const std::string bytes = read_file(path);
  try {
    return octomap_from_bytes<Map>(bytes, options);
  } catch (const std::runtime_error& error) {
    throw std::runtime_error(path.string() + ": " + error.what());
  }
}

}  // namespace ndtree
