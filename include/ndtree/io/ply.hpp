// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Cells as points of a PLY file (binary, little-endian), with their size, probability and state.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/io/byte_stream.hpp"
#include "ndtree/tree/visit.hpp"

namespace ndtree {

/// One more number of each cell.
struct PlyProperty {
  enum class Type { uchar, int_, float_, double_ };
  std::string name;
  Type type = Type::float_;
};

/// Collects the cells of a PLY file. Each is a vertex: x, y, z of its centre (double) and its size (float)
/// [m], its probability (float) and its state (int: -1 unknown, 0 free, 1 occupied), and what else they have.
class PlyCells {
 public:
  explicit PlyCells(std::vector<PlyProperty> more = {}) : more_(std::move(more)) {}

  /// @param more a number for each further property. Those of whole numbers are rounded, and
  ///   kept in bounds.
  void add(const Vector<3>& centre, double size, double probability, CellState state,
           const double* more = nullptr) {
    ++count_;
    for (int a = 0; a < 3; ++a) cells_.put(centre[a]);
    cells_.put(static_cast<float>(size));
    cells_.put(static_cast<float>(probability));
    cells_.put(static_cast<std::int32_t>(state));
    for (std::size_t i = 0; i < more_.size(); ++i) put(more_[i].type, more[i]);
  }
  /// The whole file.
  [[nodiscard]] std::string bytes() {
    std::string text =
        "ply\nformat binary_little_endian 1.0\nelement vertex " + std::to_string(count_) + "\n";
    for (const char* const property :
         {"double x", "double y", "double z", "float size", "float probability", "int state"})
      text += std::string("property ") + property + "\n";
    for (const PlyProperty& property : more_)
      text += "property " + name_of(property.type) + " " + property.name + "\n";
    text += "end_header\n";
    text.reserve(text.size() + cells_.bytes().size());
    return text.append(cells_.bytes());
  }

 private:
  using Type = PlyProperty::Type;

  static std::string name_of(Type type) {
    switch (type) {
      case Type::uchar:
        return "uchar";
      case Type::int_:
        return "int";
      case Type::float_:
        return "float";
      case Type::double_:
        break;
    }
    return "double";
  }
  void put(Type type, double value) {
    if (std::isnan(value) && (type == Type::uchar || type == Type::int_)) value = 0.0;
    switch (type) {
      case Type::uchar:
        cells_.put(static_cast<std::uint8_t>(std::lround(std::clamp(value, 0.0, 255.0))));
        break;
      case Type::int_:
        cells_.put(static_cast<std::int32_t>(std::lround(std::clamp(value, -2147483648.0, 2147483647.0))));
        break;
      case Type::float_:
        cells_.put(static_cast<float>(value));
        break;
      case Type::double_:
        cells_.put(value);
        break;
    }
  }

  std::vector<PlyProperty> more_;
  std::size_t count_ = 0;
  ByteWriter cells_;
};

/// A file of a map's leaves. In the plane, z is 0.
/// @param select which leaves, asked in the order of for_each_leaf(): bool(const ConstRef&).
/// @param more further properties. @param numbers_of the numbers of a leaf for them: it is called as
///   numbers_of(leaf.index, double*).
template <class Map, class Select, class NumbersOf>
[[nodiscard]] std::string ply_bytes(const Map& map, const Select& select, std::vector<PlyProperty> more,
                                    const NumbersOf& numbers_of) {
  constexpr int D = Map::kDim;
  static_assert(D <= 3, "PLY has three dimensions");
  std::vector<double> numbers(more.size());
  PlyCells cells(std::move(more));
  for_each_leaf(map.tree(), [&](const auto& leaf) {
    if (!select(leaf)) return;
    const double size = map.tree().geometry().cell_size(leaf.index.level);
    Vector<3> centre = Vector<3>::Zero();
    centre.template head<D>() = map.tree().box(leaf.index).lower.array() + 0.5 * size;
    numbers_of(leaf.index, numbers.data());
    cells.add(centre, size, leaf.cell().probability(), leaf.cell().state(), numbers.data());
  });
  return cells.bytes();
}
template <class Map, class Select>
[[nodiscard]] std::string ply_bytes(const Map& map, const Select& select) {
  return ply_bytes(map, select, {}, [](const auto&, double*) {});
}

/// Writes ply_bytes() of the occupied cells to a file; it appears whole or not at all.
/// @throws std::filesystem::filesystem_error naming the file and the system's reason.
template <class Map>
void save_ply(const Map& map, const std::filesystem::path& path) {
  write_file(path,
             ply_bytes(map, [](const auto& leaf) { return leaf.cell().state() == CellState::occupied; }));
}

}  // namespace ndtree
