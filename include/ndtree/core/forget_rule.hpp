// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Which parts of space a map forgets, or is told about.
#pragma once

#include "ndtree/core/body.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree {

/// What is to become of a cell, or of all cells in a box.
enum class Fate { keep, forget, divide };

/// What crop() keeps: what shares a volume with a box.
template <int D>
struct CropRule {
  Box<D> box;

  /// The last says whether a cell has parts, which are asked of if it is divided.
  [[nodiscard]] Fate fate(const Box<D>& cell, bool is_leaf, bool /*can_divide*/) const {
    if (!cell.overlaps(box)) return Fate::forget;
    return is_leaf || box.encloses(cell) ? Fate::keep : Fate::divide;
  }
};
/// What clear() keeps: larger cells on the border of the box are divided, smallest ones go.
template <int D>
struct ClearRule {
  Box<D> box;

  [[nodiscard]] Fate fate(const Box<D>& cell, bool /*is_leaf*/, bool can_divide) const {
    if (!cell.overlaps(box)) return Fate::keep;
    return !can_divide || box.encloses(cell) ? Fate::forget : Fate::divide;
  }
};
/// What clear() of a body keeps: cells that share no point with it, borders counted in, as collides() asks.
/// Cells that are only kOnBorder of their edge away from it go, too, so that rounding keeps none that it
/// meets.
template <int D>
struct ShapeRule {
  Body<D> body;  ///< In its pose.

  [[nodiscard]] Fate fate(const Box<D>& cell, bool /*is_leaf*/, bool can_divide) const {
    const Box<D> region = cell.inflated(kOnBorder * (cell.upper[0] - cell.lower[0]));
    bool is_touched = false;
    for (const BodyPart<D>& part : body) {
      if (!touch(part, region)) continue;
      if (!can_divide || encloses(part, cell)) return Fate::forget;
      is_touched = true;
    }
    return is_touched ? Fate::divide : Fate::keep;
  }
};
/// What keep_near() keeps: what is not farther than the radius.
template <int D>
struct NearRule {
  Vector<D> center;
  double radius;

  [[nodiscard]] Fate fate(const Box<D>& cell, bool is_leaf, bool /*can_divide*/) const {
    if (cell.squared_distance(center) > radius * radius) return Fate::forget;
    const double farthest =
        (cell.lower - center).cwiseAbs().cwiseMax((cell.upper - center).cwiseAbs()).squaredNorm();
    return is_leaf || farthest <= radius * radius ? Fate::keep : Fate::divide;
  }
};

/// Beams that the state which mark() gives a smallest cell is worth unless it is said, and at most.
inline constexpr int kMarkBeams = 16;
inline constexpr int kMostMarkBeams = 511;

/// Whether a rule may take something from a region, of whatever cells.
template <class Rule, int D>
[[nodiscard]] bool takes_from(const Rule& rule, const Box<D>& region) {
  return rule.fate(region, false, true) != Fate::keep;
}

}  // namespace ndtree
