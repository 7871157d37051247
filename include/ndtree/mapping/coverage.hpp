// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// How much of a cell the beams of a scan have seen, and whether that is enough to speak of the whole cell.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "ndtree/core/option.hpp"
#include "ndtree/tree/child_index.hpp"

namespace ndtree {

struct CoverageOptions {
  double covered_share = 1.0;   ///< Of a cell without its rim, to be known; 0: whatever a beam passes.
  double coverage_cells = 2.0;  ///< To show what was seen, cells of more than so many smallest ones split.

  /// Calls `visit(name, value, bounds)` for each. @param options of this kind, const or not.
  template <class Options, class Visit>
  static void for_each_bounded(Options& options, Visit&& visit) {
    visit("covered_share", options.covered_share, OptionBounds{0.0, 1.0});
    visit("coverage_cells", options.coverage_cells, OptionBounds{1.0, 1e9});
  }
  /// @throws std::invalid_argument naming the first option that is out of bounds.
  void validate() const { for_each_bounded(*this, require_within); }
};

/// A cell, in two along each of its first axes, of which four count at most: a set of parts fits 16 bits.
template <int N, int D>
struct CellParts {
  static constexpr int kAxes = D < 4 ? D : 4;
  static constexpr int kCount = 1 << kAxes;
  static constexpr int kNumChildren = static_cast<int>(integer_power(N, D));

  /// The part that a child belongs to; of an odd N the middle belongs to the lower half.
  [[nodiscard]] static constexpr int of_child(int number) {
    return kTables.of_child[static_cast<std::size_t>(number)];
  }
  /// Children that belong to a part.
  [[nodiscard]] static constexpr int num_children(int part) {
    return kTables.num_children[static_cast<std::size_t>(part)];
  }

 private:
  struct Tables {
    std::array<std::uint8_t, std::size_t{kNumChildren}> of_child{};
    std::array<std::uint16_t, std::size_t{kCount}> num_children{};
  };
  static constexpr Tables tables() {
    Tables result;
    for (int j = 0; j < kNumChildren; ++j) {
      const Offset<D> offset = child_offset<N, D>(j);
      unsigned part = 0;
      for (std::size_t a = 0; a < static_cast<std::size_t>(kAxes); ++a)
        if (2 * offset[a] >= N) part |= 1u << a;
      result.of_child[static_cast<std::size_t>(j)] = static_cast<std::uint8_t>(part);
      ++result.num_children[part];
    }
    return result;
  }
  static constexpr Tables kTables = tables();
};

/// What the beams of one scan have seen of the children of one cell: sums of whole numbers, so that the order
/// of the beams does not matter.
///
/// A beam stands for its share of solid angle: it sees its way through a child, times its width there on each
/// axis across, which is no more than the child's own.
template <int N, int D>
class ScanCoverage {
 public:
  static constexpr int kNumChildren = static_cast<int>(integer_power(N, D));

  /// What one beam, or several, have seen, in whole numbers of kUnit.
  struct Seen {
    std::int64_t child = 0;  ///< Of the child.
    std::int64_t cell = 0;   ///< Of the cell: its width may be more than the child's.
    std::int64_t way = 0;    ///< Through the child.
  };
  static constexpr std::int64_t kOne = 1 << 20;
  static constexpr float kUnitsOfOne = kOne;

  /// @param way through the child along the main axis of the beam, over the child's edge.
  /// @param width of what the beam stands for there, over the child's edge.
  [[nodiscard]] static Seen seen(float way, float width) {
    const float units = way * kUnitsOfOne;
    return {static_cast<std::int64_t>(std::nearbyint(units * across(std::min(width, 1.0f)))),
            static_cast<std::int64_t>(std::nearbyint(units * across(std::min(width, static_cast<float>(N))))),
            static_cast<std::int64_t>(std::nearbyint(units))};
  }
  void add(int child, const Seen& seen) {
    of_child_[static_cast<std::size_t>(child)] += seen.child;
    of_cell_ += seen.cell;
    way_ += seen.way;
  }
  /// Seen share of a child; more than 1 where beams are closer than they are elsewhere.
  [[nodiscard]] double of_child(int number) const {
    return static_cast<double>(of_child_[static_cast<std::size_t>(number)]) * kUnit;
  }
  [[nodiscard]] std::int64_t units_of_child(int number) const {
    return of_child_[static_cast<std::size_t>(number)];
  }
  /// The same of the whole cell.
  [[nodiscard]] double of_cell() const { return static_cast<double>(of_cell_) * kUnit / kNumChildren; }
  /// Beams that would pass straight through one child if it was seen like those that were.
  [[nodiscard]] double beams_for_child() const {
    std::int64_t seen = 0;
    for (const std::int64_t child : of_child_) seen += child;
    return seen > 0 ? static_cast<double>(way_) / static_cast<double>(seen) : 0.0;
  }

 private:
  static constexpr double kUnit = 1.0 / static_cast<double>(kUnitsOfOne);

  [[nodiscard]] static float across(float width) {
    float area = 1.0f;
    for (int a = 1; a < D; ++a) area *= width;
    return area;
  }

  std::array<std::int64_t, std::size_t{kNumChildren}> of_child_{};
  std::int64_t of_cell_ = 0;
  std::int64_t way_ = 0;
};

/// What follows from what was seen of a cell that was never observed.
struct CoverageVerdict {
  std::uint32_t parts = 0;  ///< Seen by now, one bit for each of CellParts.
  bool is_enough = true;    ///< What the beams say holds for the whole cell.
  bool shows_more = false;  ///< If not: smaller cells would tell what was seen from what was not.
};

/// When a cell may be called free as a whole. A beam through a corner has seen the corner; what it says must
/// not become the state of a cell in which nobody has looked.
///
/// A child is *missing* if less than a quarter of it was seen, and if that is more than chance: n beams would
/// pass it if it was seen like the rest of the cell, and their number scatters by sqrt(n); with sqrt(2) times
/// that, only a child that more than two would pass can be missing. So "half of the cell was never looked
/// into" is told from "few beams, but spread all over it". A cell of which a child is missing splits if it is
/// larger than coverage_cells.
///
/// Other cells are known as soon as enough of them was seen, by one scan, or in parts by several; until then
/// they keep in mind which. Enough of a cell that is s smallest cells wide is covered_share (1 - 1 / s)^D,
/// the volume without a rim half a smallest cell wide: of a smallest cell, whatever a beam passes, as in a
/// map of equal cells; of large ones, nearly all.
class CoverageModel {
 public:
  explicit CoverageModel(const CoverageOptions& options)
      : share_(options.covered_share * kRounding), least_to_split_(options.coverage_cells * (1.0 + 1e-9)) {}

  /// Whether cells have to be seen, and not only passed.
  [[nodiscard]] bool is_on() const { return share_ > 0.0; }

  /// Whether so much was seen of every child that judge() says the same whatever other beams see.
  template <int N, int D>
  [[nodiscard]] static bool is_certain(const ScanCoverage<N, D>& scan) {
    constexpr auto kEnough = static_cast<std::int64_t>(kLeast * ScanCoverage<N, D>::kOne);
    bool is_enough = true;
    for (int j = 0; j < ScanCoverage<N, D>::kNumChildren; ++j) is_enough &= scan.units_of_child(j) >= kEnough;
    return is_enough;
  }
  /// Whether so many parts of a cell are enough to know it. @param size as in judge().
  template <int N, int D>
  [[nodiscard]] bool are_enough(std::uint32_t parts, double size) const {
    return share_of<N, D>(parts) >= enough<D>(size);
  }
  /// @param seen_before parts of the cell, one bit each. @param size the cell's edge, in smallest cells.
  template <int N, int D>
  [[nodiscard]] CoverageVerdict judge(const ScanCoverage<N, D>& scan, std::uint32_t seen_before,
                                      double size) const {
    using Parts = CellParts<N, D>;
    constexpr std::int64_t kOne = ScanCoverage<N, D>::kOne;
    const double missing_below =
        kOne * std::min(kLeast, 1.0 - std::sqrt(2.0 / scan.beams_for_child()));  // In units.
    std::int64_t least = kOne;  // Seen of a child, of those in parts that were not seen before.
    std::array<std::int64_t, Parts::kCount> seen{};  // In units of children.
    for (int j = 0; j < Parts::kNumChildren; ++j) {
      const auto part = static_cast<std::size_t>(Parts::of_child(j));
      const std::int64_t of_child = std::min(kOne, scan.units_of_child(j));
      seen[part] += of_child;
      least = std::min(least, (seen_before >> part & 1u) == 0 ? of_child : kOne);
    }
    const bool is_missing = static_cast<double>(least) < missing_below;
    CoverageVerdict verdict{seen_before};
    for (int p = 0; p < Parts::kCount; ++p) {
      const int children = Parts::num_children(p);
      const bool is_seen =
          static_cast<double>(seen[static_cast<std::size_t>(p)]) >= kLeast * kRounding * kOne * children;
      verdict.parts |= static_cast<std::uint32_t>(is_seen) << p;
    }
    verdict.shows_more = is_missing && size > least_to_split_;
    const double share = std::max(scan.of_cell(), share_of<N, D>(verdict.parts));
    verdict.is_enough = !verdict.shows_more && share >= enough<D>(size);
    return verdict;
  }

 private:
  template <int N, int D>
  [[nodiscard]] static double share_of(std::uint32_t parts) {
    using Parts = CellParts<N, D>;
    int children = 0;
    for (int p = 0; p < Parts::kCount; ++p) children += (parts >> p & 1u) != 0 ? Parts::num_children(p) : 0;
    return static_cast<double>(children) / Parts::kNumChildren;
  }
  template <int D>
  [[nodiscard]] double enough(double size) const {
    double share = share_;
    for (int a = 0; a < D; ++a) share *= 1.0 - 1.0 / size;
    return share;
  }

  static constexpr double kLeast = 0.25;           // Of a child, so that it is not missing.
  static constexpr double kRounding = 1.0 - 1e-4;  // Of ways through cells.

  double share_;
  double least_to_split_;
};

}  // namespace ndtree
