// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// How much of a cell the beams of a scan have seen, and whether that is enough to speak of the whole cell.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "ndtree/core/lanes.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/tree/child_index.hpp"

namespace ndtree {

struct CoverageOptions {
  /// Fraction of each part (CellParts: half, quadrant, octant) to be seen for a cell to be observed, half of
  /// that for parts that are smallest cells, and more of cells larger than 2 N smallest ones: what is left
  /// out of a part is no deeper. Few beams have to see this fraction of the whole cell. 0: any beam is
  /// enough. (Whether an observed cell is *covered* is another question: CoverageVerdict.)
  double covered_share = 0.5;
  /// Cells whose edge is longer than this many smallest cells split to show what was seen.
  double coverage_cells = 2.0;
};

/// A cell's parts: it is halved along each of its first axes, at most four, so that a set of parts fits 16
/// bits.
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
  static constexpr bool kAreChildren = kCount == kNumChildren;  ///< Each part is a child.
  static constexpr std::uint32_t kAll = (1u << kCount) - 1u;    ///< The set of all parts.

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

/// The volume that the beams of one scan have seen of each child of a cell: sums of whole numbers, so that
/// the order of the beams does not matter.
///
/// A beam stands for its solid angle. The volume that it sees of a child is its way through the child, along
/// the main axis of the beam, times the part of its width that lies in the child, on each axis across: a beam
/// along a border sees one side of a child, not its middle.
template <int N, int D>
class ScanCoverage {
 public:
  static constexpr int kNumChildren = static_cast<int>(integer_power(N, D));

  /// Of one beam, or of several, over a whole child, in 1 / kOne.
  template <class Ints>
  struct Passed {
    Ints way;    ///< Sum of ways.
    Ints slice;  ///< Volume of the beam's slice, as wide as the cell at most, wherever it lies.
  };
  static constexpr std::int64_t kOne = 1 << 20;
  static constexpr float kUnitsOfOne = kOne;

  /// @param way through the cell along the main axis of the beam, over a child's edge, times kOne.
  /// @param width of the beam's solid angle there, over a child's edge.
  template <class Floats>
  [[nodiscard]] NDTREE_ALWAYS_INLINE static auto passed(const Floats& way, const Floats& width) {
    constexpr float kWidest = N;
    return Passed<decltype(nearest_integer(way))>{
        nearest_integer(way), nearest_integer(Floats(way * across(min_of(width, Floats(kWidest)))))};
  }
  /// The part of a beam's width that lies in a child, over the child's edge.
  /// @param from_middle distance of the beam from the middle of the child, on an axis across.
  template <class Floats>
  [[nodiscard]] NDTREE_ALWAYS_INLINE static Floats overlap(const Floats& from_middle, const Floats& width) {
    return max_of(Floats(0.0f), min_of(0.5f + 0.5f * width - from_middle, min_of(width, 1.0f)));
  }
  /// The mean of overlap() over all places: 2 h - h² with h = min(half_width, 1).
  [[nodiscard]] static double mean_overlap(double half_width) {
    const double half = std::min(half_width, 1.0);
    return half * (2.0 - half);
  }
  /// @param sums of whole numbers, of one beam or several.
  template <class Number>
  void add(const Passed<Number>& sums) {
    way_ += sums.way;
    slice_ += sums.slice;
  }
  /// @param seen volume of a child, in 1 / kOne: the way through it, times the product of overlap() over the
  ///   axes across.
  void add(int child, std::int64_t seen) { of_child_[static_cast<std::size_t>(child)] += seen; }
  /// Seen fraction of a child; more than 1 where beams are closer than they are elsewhere.
  [[nodiscard]] double of_child(int number) const {
    return static_cast<double>(of_child_[static_cast<std::size_t>(number)]) * kUnit;
  }
  [[nodiscard]] std::int64_t units_of_child(int number) const {
    return of_child_[static_cast<std::size_t>(number)];
  }
  /// Whether each child has at least this many units.
  [[nodiscard]] bool all_have(std::int64_t units) const {
    return *std::min_element(of_child_.begin(), of_child_.end()) >= units;
  }
  /// The set of children with fewer units. @pre at most 32 children.
  [[nodiscard]] std::uint32_t set_below(std::int64_t units) const {
    std::uint32_t below = 0;
#ifdef __GNUC__
#pragma GCC unroll 16
#endif
    for (int j = kNumChildren - 1; j >= 0; --j)  // The sign of a difference is its last bit.
      below =
          2 * below + static_cast<std::uint32_t>(static_cast<std::uint64_t>(units_of_child(j) - units) >> 63);
    return below;
  }
  /// Sum of the beams' ways, in 1 / kOne.
  [[nodiscard]] std::int64_t way() const { return way_; }
  /// Beams that would pass straight through one child if it was seen like the seen children.
  [[nodiscard]] NDTREE_ALWAYS_INLINE double beams_for_child() const { return ratio(way_, slice_); }
  /// The share of beams' widths that lies in the child that they cross, in the mean over all places of beams:
  /// the rest is seen of children that they do not cross.
  [[nodiscard]] double mean_share() const {
    const double width = this->width();
    return width > 0.0 ? across(mean_overlap(0.5 * width) / std::min(width, 1.0)) : 1.0;
  }
  /// Seen fraction of the cell. What several beams see of a child is not more than the child; where a beam is
  /// wider than that, a seen child stands for those beside it which the beam covers.
  [[nodiscard]] double volume() const {
    std::int64_t seen = 0;
    for (const std::int64_t of_child : of_child_) seen += std::min(kOne, of_child);
    return static_cast<double>(seen) * (kUnit / kNumChildren) * std::max(1.0, ratio(slice_, way_));
  }

 private:
  static constexpr double kUnit = 1.0 / static_cast<double>(kUnitsOfOne);

  template <class Floats>
  [[nodiscard]] NDTREE_ALWAYS_INLINE static Floats across(const Floats& width) {
    Floats area = 1.0f;
    for (int a = 1; a < D; ++a) area = area * width;
    return area;
  }
  /// Of the beams, over a child's edge.
  [[nodiscard]] double width() const {
    const double area = ratio(slice_, way_);
    if constexpr (D <= 2) return area;
    return D == 3 ? std::sqrt(area) : std::pow(area, 1.0 / std::max(1, D - 1));
  }
  [[nodiscard]] NDTREE_ALWAYS_INLINE static double ratio(std::int64_t part, std::int64_t of) {
    return of > 0 ? static_cast<double>(part) / static_cast<double>(of) : 0.0;
  }

  std::array<std::int64_t, std::size_t{kNumChildren}> of_child_{};
  std::int64_t way_ = 0;
  std::int64_t slice_ = 0;
};

/// What CoverageModel asks of cells of one size.
struct CoverageLimits {
  double size;           ///< The cell's edge, in smallest cells.
  double least_seen;     ///< Seen fraction of a child that is not missing,
  double least_of_part;  ///< and of a part that was seen.
  std::int64_t covered;  ///< Units of each child of a covered cell.
  std::int64_t certain;  ///< Units of each child from which on further beams change nothing.
};

/// The verdict about a cell that was never observed, or not covered.
struct CoverageVerdict {
  std::uint32_t parts = 0;  ///< Seen by now, one bit for each of CellParts.
  bool is_enough = true;    ///< The beams' evidence holds for the whole cell.
  bool shows_more = false;  ///< Split: smaller cells would separate seen from unseen space.
  bool is_covered = false;  ///< CoverageModel::is_covered(), if it was asked for.
};

/// When a cell may be called free as a whole. A beam through a corner has seen the corner; its
/// evidence must not become the state of the unseen rest.
///
/// A part of a cell, see CellParts, is *seen* once one scan has seen covered_share of it, and none of its
/// children is missing, of which less than least_of() was seen. A cell is observed once all its parts were
/// seen, by one scan or by several. A smallest cell is observed as soon as any beam passes it, so one with an
/// edge of two smallest cells asks for less: half of covered_share, of half of its parts. Of one with an edge
/// of N smallest cells, few beams do not tell the parts apart: if they are so far apart that fewer than two
/// would pass a smallest cell, a part and covered_share of the volume are enough.
/// Until then the cell stores which parts were seen. Thresholds for parts, volumes and missing children are
/// scaled by ScanCoverage::mean_share(); those for a covered cell and for a missing child in a plane are not.
///
/// A cell that is not observed, and whose edge is longer than coverage_cells smallest cells, splits where the
/// unseen part is significant:
/// - by one scan, if a child is missing that at least two beams would pass;
/// - by all scans so far, if kBeamsOfPart beams would have passed each part if all were seen alike; then few
///   beams split a cell with an edge of N smallest cells, too, whatever coverage_cells.
///
/// A cell of any size splits that still has an unseen part when it remembers no more beams: so a cell that
/// equal beams clip in every scan does not stay unknown for ever.
class CoverageModel {
 public:
  explicit CoverageModel(const CoverageOptions& options)
      : covered_share_(options.covered_share), least_to_split_(options.coverage_cells * (1.0 + 1e-9)) {}

  /// False if a cell is observed as soon as a beam has passed it.
  [[nodiscard]] bool is_on() const { return covered_share_ > 0.0; }

  /// @param size the cell's edge, in smallest cells.
  template <int N>
  [[nodiscard]] CoverageLimits limits(double size) const {
    // Of a cell of 2 N smallest ones covered_share; of larger ones what is left out has the same depth.
    const double least_seen =
        is_of_two(size) ? 0.5 * covered_share_ : 1.0 - (1.0 - covered_share_) * std::min(1.0, 2.0 * N / size);
    const double covered = 1.0 - std::min(0.5, N / size);  // All but one smallest cell in depth.
    const auto units = [](double fraction) {
      return static_cast<std::int64_t>(fraction * kRounding * kUnitsOfChild);
    };
    return {size, least_seen, is_of_two(size) ? 0.5 * covered_share_ : covered_share_, units(covered),
            units(std::max(least_seen, covered))};
  }
  /// True if every child was seen so well that further beams cannot change what judge() and is_covered()
  /// return.
  template <int N, int D>
  [[nodiscard]] static bool is_certain(const ScanCoverage<N, D>& scan, const CoverageLimits& limits) {
    return scan.all_have(limits.certain);
  }
  /// Whether a cell with these seen parts is observed. @param size as in limits().
  template <int N, int D>
  [[nodiscard]] bool are_enough(std::uint32_t parts, double size) const {
    using Parts = CellParts<N, D>;
    if (!is_of_two(size)) return parts == Parts::kAll;
    int children = 0;
    for (int p = 0; p < Parts::kCount; ++p) children += (parts >> p & 1u) != 0 ? Parts::num_children(p) : 0;
    return 2 * children >= Parts::kNumChildren;
  }
  /// @param seen_before parts of the cell, one bit each.
  /// @param beams mean passes that its evidence for free space is worth, of this scan and before.
  /// @param adds_nothing scans like this one leave the cell as it is, or show no more of it: it remembers no
  ///   more beams, or the scan's have no neighbours.
  /// @param fraction of the beams that were sampled.
  template <int N, int D>
  [[nodiscard]] CoverageVerdict judge(const ScanCoverage<N, D>& scan, std::uint32_t seen_before,
                                      const CoverageLimits& limits, double beams, bool adds_nothing = false,
                                      double fraction = 1.0) const {
    using Parts = CellParts<N, D>;
    const double beams_for_child = scan.beams_for_child();
    const double mean_share = scan.mean_share();
    std::int64_t missing_below = 0;
    if (beams_for_child > least_to_miss<D>(fraction))
      missing_below = units_from(
          std::min(mean_share * limits.least_seen, least_of<D>(beams_for_child, mean_share, fraction)));
    const double seen_from = mean_share * limits.least_of_part * kRounding;
    std::uint32_t with_missing = 0;  // Parts of which a child is missing.
    std::uint32_t are_seen = 0;      // Parts of which enough was seen.
    if constexpr (Parts::kAreChildren) {
      if (missing_below > 0) with_missing = scan.set_below(missing_below);
      are_seen = Parts::kAll & ~scan.set_below(units_from(seen_from));
    } else {
      std::array<std::int64_t, Parts::kCount> seen{};  // In units of children.
      for (int j = 0; j < Parts::kNumChildren; ++j) {
        const auto part = static_cast<std::size_t>(Parts::of_child(j));
        seen[part] += std::min(ScanCoverage<N, D>::kOne, scan.units_of_child(j));
        with_missing |= static_cast<std::uint32_t>(scan.units_of_child(j) < missing_below) << part;
      }
      for (int p = 0; p < Parts::kCount; ++p)
        are_seen |= static_cast<std::uint32_t>(seen[static_cast<std::size_t>(p)] >=
                                               units_from(seen_from * Parts::num_children(p)))
                    << p;
    }
    CoverageVerdict verdict{seen_before | (are_seen & ~with_missing)};
    // Beams so far apart that fewer than two would pass a smallest cell cannot tell parts that size.
    const bool are_few = limits.size < N + 0.5 && beams_for_child < 2.0;
    const bool has_enough =
        are_enough<N, D>(verdict.parts, limits.size) ||
        (are_few && verdict.parts != 0 && scan.volume() >= mean_share * covered_share_ * kRounding);
    const bool may_split = this->may_split(limits);
    const bool is_due = beams > kBeamsOfPart<D> * (Parts::kCount / 2) && (may_split || are_few);
    verdict.shows_more = ((with_missing & ~seen_before) != 0 && may_split && may_miss(scan)) ||
                         (!has_enough && (is_due || adds_nothing));
    verdict.is_enough = !verdict.shows_more && has_enough;
    return verdict;
  }
  /// Whether a cell splits if a child is missing that was not seen before.
  [[nodiscard]] bool may_split(const CoverageLimits& limits) const { return limits.size > least_to_split_; }
  /// Whether a cell may split for a missing child: then one that no beam has crossed is missing.
  template <int N, int D>
  [[nodiscard]] NDTREE_ALWAYS_INLINE static bool may_miss(const ScanCoverage<N, D>& scan) {
    return scan.beams_for_child() > 2.0 * kRounding;
  }
  /// Whether a scan has seen all of a cell, but for a smallest cell in depth.
  template <int N, int D>
  [[nodiscard]] static bool is_covered(const ScanCoverage<N, D>& scan, const CoverageLimits& limits) {
    return scan.all_have(limits.covered);
  }

 private:
  /// Seen fraction of a child, at least, if n beams would pass it: their number may be less. In a plane beams
  /// are evenly spaced, and those nearest to the child's borders leave half a width out, at most; n beams of
  /// a sample have the variance n (1 - fraction). In space, where rows and columns differ, n.
  template <int D>
  [[nodiscard]] static double least_of(double n, double mean_share, double fraction) {
    if (D != 2) return mean_share * (1.0 - std::sqrt(2.0 * kRounding / n));
    constexpr double kOfWidths = 0.95;  // Beams are not exactly as far apart as their mean angle.
    return kOfWidths * (1.0 - unfused(kRounding * (0.5 / n + std::sqrt(2.0 * (1.0 - fraction) / n))));
  }
  /// From how many beams on a child can be missing: least_of() is more than 0.
  template <int D>
  [[nodiscard]] static double least_to_miss(double fraction) {
    return (D == 2 ? 3.0 - 2.0 * fraction : 2.0) * kRounding;
  }
  /// The least number of units that is not less than a fraction of a child. @param fraction not negative.
  [[nodiscard]] static std::int64_t units_from(double fraction) {
    const double units = fraction * kUnitsOfChild;
    const auto whole = static_cast<std::int64_t>(units);
    return whole + (static_cast<double>(whole) < units);
  }
  /// True if the cell has an edge of two smallest cells.
  [[nodiscard]] static bool is_of_two(double size) { return size < 2.5; }

  static constexpr double kUnitsOfChild = static_cast<double>(ScanCoverage<2, 2>::kOne);  // For any N and D.
  static constexpr double kRounding = 1.0 - 1e-4;  // Of ways through cells.
  template <int D>
  static constexpr double kBeamsOfPart = D == 2 ? 4.0 : 8.0;

  double covered_share_;
  double least_to_split_;
};

}  // namespace ndtree
