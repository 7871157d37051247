// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What OctoMap's own files, .bt and .ot, hold: its tree, keys and colours.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "ndtree/layers/layer.hpp"
#include "ndtree/layers/values.hpp"

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

}  // namespace detail

}  // namespace ndtree
