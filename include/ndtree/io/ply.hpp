// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Cells as points of a PLY file (binary, little-endian), with their size, probability and state.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>
#include <utility>

#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/io/byte_stream.hpp"
#include "ndtree/tree/visit.hpp"

namespace ndtree {

/// One vertex a leaf: x, y, z of its centre (double) and size (float) [m], probability (float) and state
/// (char: -1 unknown, 0 free, 1 occupied). In the plane, z is 0.
/// @param select which leaves, asked in the order of for_each_leaf(): bool(const ConstRef&).
template <class Map, class Select>
[[nodiscard]] std::string ply_bytes(const Map& map, const Select& select) {
  constexpr int D = Map::kDim;
  static_assert(D <= 3, "PLY has three dimensions");
  const auto& tree = map.tree();
  ByteWriter cells;
  std::size_t count = 0;
  for_each_leaf(tree, [&](const auto& leaf) {
    if (!select(leaf)) return;
    ++count;
    const Box<D> box = tree.box(leaf.index);
    const double size = tree.geometry().cell_size(leaf.index.level);
    for (int a = 0; a < 3; ++a) cells.put(a < D ? box.lower[a] + 0.5 * size : 0.0);
    cells.put(static_cast<float>(size));
    cells.put(static_cast<float>(leaf.cell().probability()));
    cells.put(static_cast<std::int8_t>(leaf.cell().state()));
  });
  std::string bytes = "ply\nformat binary_little_endian 1.0\nelement vertex " + std::to_string(count) + "\n";
  for (const char* const property :
       {"double x", "double y", "double z", "float size", "float probability", "char state"})
    bytes += std::string("property ") + property + "\n";
  bytes += "end_header\n";
  return bytes + cells.bytes();
}

/// Writes ply_bytes() of the occupied cells to a file; it appears whole or not at all.
/// @throws std::filesystem::filesystem_error naming the file and the system's reason.
template <class Map>
void save_ply(const Map& map, const std::filesystem::path& path) {
  write_file(path,
             ply_bytes(map, [](const auto& leaf) { return leaf.cell().state() == CellState::occupied; }));
}

}  // namespace ndtree
