// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The leaves of an OctoMap file, in their order.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <sstream>
#include <stdexcept>
#include <string>
#include <string_view>

#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/io/byte_stream.hpp"
#include "ndtree/io/octomap_tree.hpp"

namespace ndtree {

namespace detail {

/// A leaf of an OctoMap file.
struct OctomapLeaf {
  OctomapKey key;
  int level;  ///< 0 for the smallest cells.
  float log_odds;
  OctomapColor color = kOctomapNoColor;
};

struct OctomapHeader {
  OctomapFormat format = OctomapFormat::full;
  std::uint64_t nodes = 0;
  double cell_size = 0.0;
  bool colored = false;   ///< Whether nodes have colours: those of the .ot of a ColorOcTree.
  std::string_view data;  ///< All that follows.
};

/// Reads the nodes behind the header.
class OctomapReader {
 public:
  /// @param log_odds_free, log_odds_occupied what a .bt file's leaves mean.
  OctomapReader(const OctomapHeader& header, float log_odds_free, float log_odds_occupied)
      : header_(header), in_(header.data), free_(log_odds_free), occupied_(log_odds_occupied) {}

  /// Calls visit(const OctomapLeaf&) for each leaf, depth first.
  /// @throws std::runtime_error where the data cannot be such a tree, which may be behind leaves that can.
  template <class Visit>
  void for_each_leaf(const Visit& visit) {
    nodes_ = 0;
    in_ = ByteReader(header_.data);
    if (header_.nodes > 0) {
      if (header_.format == OctomapFormat::full) {
        read_full({}, kOctomapLevels, visit);
      } else {
        ++nodes_;
        read_binary({}, kOctomapLevels, visit);
      }
    }
    if (nodes_ != header_.nodes)
      throw std::runtime_error("found " + std::to_string(nodes_) + " nodes, expected " +
                               std::to_string(header_.nodes) + " as the header says");
    if (!in_.at_end())
      throw std::runtime_error("nodes end at byte " + std::to_string(in_.position()) +
                               " of the data, expected them to fill it");
  }

 private:
  template <class Visit>
  void read_full(const OctomapKey& key, int level, const Visit& visit) {
    pace_.spend();
    ++nodes_;
    const auto log_odds = in_.get<float>();
    OctomapColor color = kOctomapNoColor;
    for (std::size_t i = 0; i < 3 && header_.colored; ++i) color[i] = in_.get<std::uint8_t>();
    const auto children = in_.get<std::uint8_t>();
    if (std::isnan(log_odds)) fail("a node's log-odds is not a number");
    if (children == 0) {
      visit(OctomapLeaf{key, level, log_odds, color});
      return;
    }
    if (level == 0) fail("a node below the 16th level");
    for (int child = 0; child < 8; ++child)
      if ((children >> child & 1) != 0)
        read_full(octomap_child(key, child, std::int64_t{1} << (level - 1)), level - 1, visit);
  }
  template <class Visit>
  void read_binary(const OctomapKey& key, int level, const Visit& visit) {
    pace_.spend();
    const auto bits = in_.get<std::uint16_t>();
    if (level == 0) fail("a node below the 16th level");
    for (int child = 0; child < 8; ++child) {
      const int kind = bits >> 2 * child & 3;
      if (kind == 0) continue;
      ++nodes_;
      if (kind != 3)
        visit(OctomapLeaf{octomap_child(key, child, std::int64_t{1} << (level - 1)), level - 1,
                          kind == 2 ? occupied_ : free_, kOctomapNoColor});
    }
    for (int child = 0; child < 8; ++child)
      if ((bits >> 2 * child & 3) == 3)
        read_binary(octomap_child(key, child, std::int64_t{1} << (level - 1)), level - 1, visit);
  }
  [[noreturn]] void fail(const char* what) const {
    throw std::runtime_error(std::string(what) + ", at byte " + std::to_string(in_.position()) +
                             " of the data");
  }

  OctomapHeader header_;
  ByteReader in_;
  float free_;
  float occupied_;
  std::uint64_t nodes_ = 0;
  Pace pace_;
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
  header.colored = header.colored && header.format == OctomapFormat::full;
  header.data = bytes;
  return header;
}

/// The colours of a file's leaves.
/// @param map what the leaves became.
template <class Map>
OctomapColors<Map> colors_of(const Map& map, OctomapReader& reader) {
  const auto& geometry = map.tree().geometry();
  OctomapColors<Map> colors(geometry);
  reader.for_each_leaf([&](const OctomapLeaf& leaf) {
    if (leaf.color == kOctomapNoColor || state_of(leaf.log_odds) == CellState::unknown) return;
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
  });
  return colors;
}

}  // namespace detail

}  // namespace ndtree
