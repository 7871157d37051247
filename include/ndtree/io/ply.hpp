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

/// Collects the cells of a PLY file. Each is a vertex: x, y, z of its centre (double) and its size (float)
/// [m], its probability (float) and its state (int: -1 unknown, 0 free, 1 occupied).
class PlyCells {
 public:
  void add(const Vector<3>& centre, double size, double probability, CellState state) {
    ++count_;
    for (int a = 0; a < 3; ++a) cells_.put(centre[a]);
    cells_.put(static_cast<float>(size));
    cells_.put(static_cast<float>(probability));
    cells_.put(static_cast<std::int32_t>(state));
  }
  /// The whole file.
  [[nodiscard]] std::string bytes() {
    std::string text =
        "ply\nformat binary_little_endian 1.0\nelement vertex " + std::to_string(count_) + "\n";
    for (const char* const property :
         {"double x", "double y", "double z", "float size", "float probability", "int state"})
      text += std::string("property ") + property + "\n";
    return text + "end_header\n" + cells_.bytes();
  }

 private:
  std::size_t count_ = 0;
  ByteWriter cells_;
};

/// A file of a map's leaves. In the plane, z is 0.
/// @param select which leaves, asked in the order of for_each_leaf(): bool(const ConstRef&).
template <class Map, class Select>
[[nodiscard]] std::string ply_bytes(const Map& map, const Select& select) {
  constexpr int D = Map::kDim;
  static_assert(D <= 3, "PLY has three dimensions");
  PlyCells cells;
  for_each_leaf(map.tree(), [&](const auto& leaf) {
    if (!select(leaf)) return;
    const double size = map.tree().geometry().cell_size(leaf.index.level);
    Vector<3> centre = Vector<3>::Zero();
    centre.template head<D>() = map.tree().box(leaf.index).lower.array() + 0.5 * size;
    cells.add(centre, size, leaf.cell().probability(), leaf.cell().state());
  });
  return cells.bytes();
}

/// Writes ply_bytes() of the occupied cells to a file; it appears whole or not at all.
/// @throws std::filesystem::filesystem_error naming the file and the system's reason.
template <class Map>
void save_ply(const Map& map, const std::filesystem::path& path) {
  write_file(path,
             ply_bytes(map, [](const auto& leaf) { return leaf.cell().state() == CellState::occupied; }));
}

}  // namespace ndtree
