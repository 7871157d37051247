// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Which points of a log returned from what moved: from space that other scans surely saw empty.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <numeric>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "ndtree/core/beta.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/lanes.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/parallel.hpp"
#include "ndtree/core/scan.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/core/unfused.hpp"
#include "ndtree/evaluation/beam_image.hpp"
#include "ndtree/evaluation/cell_numbers.hpp"
#include "ndtree/evaluation/range_pyramid.hpp"

namespace ndtree {

/// How sure a scan must be that a place is empty.
struct MovedOptions {
  double cell_size = 0.05;             ///< Points of one cell have one answer [m].
  double range_sigma = 0.03;           ///< Standard deviation of a range r is this [m], pose errors included,
  double range_sigma_quadratic = 0.0;  ///< plus this times r² [1/m].
  double noise_sigmas = 2.0;           ///< Of a range, that a point and a beam each may be wrong by.
  double error_rate = 0.2;             ///< Fraction of the scans that see through what stands, at most.
  int most_scans = 12;  ///< Scans in a row that see through and outweigh any that found it before.

  /// @throws std::invalid_argument naming the first option that is out of bounds.
  void validate() const {
    require_option(cell_size > 0.0 && std::isfinite(cell_size), "cell_size", cell_size, "> 0 m and finite");
    require_option(range_sigma >= 0.0 && std::isfinite(range_sigma), "range_sigma", range_sigma,
                   ">= 0 m and finite");
    require_option(range_sigma_quadratic >= 0.0 && std::isfinite(range_sigma_quadratic),
                   "range_sigma_quadratic", range_sigma_quadratic, ">= 0 1/m and finite");
    require_option(noise_sigmas > 0.0 && noise_sigmas <= 100.0, "noise_sigmas", noise_sigmas, "in (0, 100]");
    require_option(error_rate > 0.0 && error_rate < 0.5, "error_rate", error_rate, "in (0, 0.5)");
    require_option(most_scans >= 1 && most_scans <= 1000, "most_scans", most_scans, "in [1, 1000]");
  }
};

/// Evidence that space where beams ended was empty at other times.
///
/// All scans are given twice, first to add(), then to look(). The first pass collects the cells in which
/// beams ended. In the second each scan, as a RangePyramid, is asked about each of them that is in its view:
/// do the beams around it surely pass it, by a cell and by `noise_sigmas` of both ranges, or do they end
/// there? Cells that the scan cannot see are skipped together, by balls around eight cells, around eight of
/// these balls, and so on.
///
/// A scan sees through a cell only if its beams are close enough together to meet what is there: the first
/// pass measures how wide and high that is, in the images of the scans that hit it, and each rectangle of
/// that size around the cell's points must hold a beam that passed. A rod that no two neighbouring beams meet
/// is never seen through, nor is ground so oblique that neighbouring beams end far apart. Nor does a scan
/// whose own beams end in a cell see through it.
///
/// Let v scans have seen through a cell, and h found a surface there, in r rows of scans between which others
/// saw through. If something stands there, mostly a fraction of the scans of at most e = error_rate sees
/// through it; but of a part t of what stands any fraction does: fences, foliage, glass. And scans see
/// through what stands at any time, by chance, so that of all orders of v and h scans none is more probable.
/// What moved was there without a break, and after a stay comes back with a probability of q. With both
/// equally likely before, and fractions uniform,
///
///     P(moved) = m / (m + s),  m = (1 - I_e(v + 1, h + 1)) / (1 - e) q^(r - 1) / p(r),
///     s = (1 - t) I_e(v + 1, h + 1) / e + t,  p(r) = C(h - 1, r - 1) C(v + 1, r) / C(v + h, h),
///
/// I being the incomplete beta function, and p(r) the fraction of orders with r rows. That is 1/2 without any
/// scan, less without one that saw through, and less the more found it or the more often it was found again.
///
/// Once `most_scans` in a row have seen through, h counts for no more than these outweigh: what stood for
/// long and left goes.
///
/// The same log gives the same answers to the last bit, whatever the number of threads.
template <int D>
class MovedEvidence {
 public:
  /// @throws std::invalid_argument as MovedOptions::validate().
  explicit MovedEvidence(const MovedOptions& options)
      : options_(validated(options)), below_(options.error_rate), log_factorials_(kFactorials, 0.0) {
    for (std::size_t n = 2; n < kFactorials; ++n)
      log_factorials_[n] = log_factorials_[n - 1] + std::log(static_cast<double>(n));
    const auto passes = static_cast<std::uint32_t>(options.most_scans);
    while (probability(passes, outweighed_ + 1, 1) > 0.5F) ++outweighed_;
  }

  /// The first pass: where returned beams end. Beams of a length of 0, longer than `max_range` or with a
  /// number that is not finite have no end point. O(beams).
  /// @throws std::invalid_argument after look(), or if an end point is farther from the first than a million
  ///   cells.
  void add(const ScanView<D>& scan, double max_range = std::numeric_limits<double>::infinity());

  /// The second pass. O(beams + cells in view).
  /// @param threads >= 1; those of the first call.
  void look(const ScanView<D>& scan, double max_range = std::numeric_limits<double>::infinity(),
            std::size_t threads = 1);

  /// That what returned at points was not part of what stands; 0.5 where no beam ended. O(n).
  void probabilities(const double* points, std::size_t n, float* out) const {
    typename CellNumbers<D>::Cursor cursor;
    for_each_paced(n, 2, [&](std::size_t i) {
      const std::uint32_t number = numbers_
                                       ? numbers_->find(Eigen::Map<const Vector<D>>(points + i * D), cursor)
                                       : CellNumbers<D>::kNone;
      if (number == CellNumbers<D>::kNone) {
        out[i] = 0.5F;
        return;
      }
      const Tally tally = workers_ ? tallies_[number] : Tally();
      out[i] = probability(tally.through, tally.found, tally.stays);
    });
  }
  /// Of a cell that `through` scans saw through, and in which `found` found a surface, in `stays` rows of
  /// scans without one that saw through. @pre stays <= found, and > 0 if found > 0.
  [[nodiscard]] float probability(std::uint32_t through, std::uint32_t found, std::uint32_t stays) const {
    if (through == 0 && found == 0) return 0.5F;
    const double below = std::clamp(below_(through + 1.0, found + 1.0), 0.0, 1.0);
    double moved = (1.0 - below) / (1.0 - options_.error_rate);
    const double stands = (1.0 - kThin) * below / options_.error_rate + kThin;
    if (found > 0)
      moved *= std::exp((stays - 1.0) * std::log(kReturns) + log_choices(through + found, found) -
                        log_choices(found - 1, stays - 1) - log_choices(through + 1, stays));
    return static_cast<float>(moved / (moved + stands));
  }

  [[nodiscard]] const MovedOptions& options() const { return options_; }
  [[nodiscard]] std::size_t num_cells() const { return numbers_ ? numbers_->size() : 0; }

 private:
  using Point = Eigen::Matrix<float, D, 1>;
  static constexpr std::size_t kFanOut = 8;
  static constexpr std::size_t kWidths = 12;
  static constexpr std::size_t kSides = D - 1;
  static constexpr float kMostWidth = 8.0F;  // Of a surface, in cells: all wider ones are alike.
  static constexpr std::size_t kFactorials = 1024;
  static constexpr std::uint8_t kMostMeasured = 24;  // Surfaces in a cell: more change its width little.
  // Fitted on simulated worlds in which nothing moves, and in which one thing does:
  static constexpr double kThin = 0.1;            // Of what stands, that any fraction of scans sees through.
  static constexpr double kReturns = 0.3;         // Of stays in a cell, that another one follows.
  static constexpr double kNarrower = 1.0 / 3.0;  // Of a cell's surfaces, that look narrower than they are.
  static constexpr float kCore = 0.25F;  // Of a width: least distance of a surface's middle from its border.

  struct Cell {
    Point mean = Point::Zero();  // Of the points in it, relative to base_ [m].
    float sigma = 0.0F;          // Of their ranges, on average [m].
    std::uint32_t points = 0;
    std::uint32_t scan = 0;  // The last with a surface that was measured: a scan's other ones look alike.
    std::uint8_t measured = 0;
    // By axis, numbers of points on surfaces of widths, see width_of().
    std::array<std::array<std::uint8_t, kWidths>, kSides> widths{};
  };
  /// Balls around kFanOut cells or balls each, by the order of the tree; a few behind the last are empty.
  struct Balls {
    std::array<std::vector<float>, std::size_t{D}> centers;
    std::vector<float> radius;
    std::vector<float> margin;  // The largest of their cells.
    std::size_t size = 0;
  };

  /// What scans said of a cell.
  struct Tally {
    std::uint32_t through = 0;   // Scans that saw through it,
    std::uint32_t streak = 0;    // of these the last in a row,
    std::uint32_t found = 0;     // and scans that found a surface there,
    std::uint32_t stays = 0;     // in how many rows without one that saw through.
    std::uint32_t own_scan = 0;  // The last with a beam that ended in it.

    void find() {
      stays += found == 0 || streak > 0 ? 1 : 0;
      ++found;
      streak = 0;
    }
  };

  static const MovedOptions& validated(const MovedOptions& options) {
    options.validate();
    return options;
  }
  [[nodiscard]] double sigma_at(double range) const {
    return options_.range_sigma + unfused(options_.range_sigma_quadratic * range) * range;
  }
  [[nodiscard]] Point relative(const Vector<D>& point) const {
    return (point - base_).template cast<float>();
  }
  /// Counts what the scan says of a cell in which none of its own beams ended.
  void count(std::size_t i, bool is_passed, float distance) {
    Tally& tally = tallies_[i];
    if (tally.own_scan == looked_) return;
    if (!is_passed) {
      tally.find();
      return;
    }
    Point way;
    for (std::size_t k = 0; k < D; ++k)
      way[static_cast<int>(k)] = means_[k][i] - origin_[static_cast<int>(k)];
    typename BeamImage<D>::Offset size;
    typename BeamImage<D>::Offset core;
    for (std::size_t k = 0; k < kSides; ++k) {
      size[k] = sizes_[k][i] / distance;
      core[k] = kCore * size[k];
    }
    if (!image_.surely_meets(way / distance, size, core, distance + margins_[i])) return;
    ++tally.through;
    if (++tally.streak >= static_cast<std::uint32_t>(options_.most_scans)) {
      tally.found = std::min(tally.found, outweighed_);
      tally.stays = std::min(tally.stays, outweighed_);
    }
  }
  [[nodiscard]] double log_factorial(std::uint32_t n) const {
    return n < log_factorials_.size() ? log_factorials_[n] : std::lgamma(n + 1.0);
  }
  /// In how many ways some of several can be chosen; of more than there are, as one.
  [[nodiscard]] double log_choices(std::uint32_t of, std::uint32_t chosen) const {
    if (chosen > of) return 0.0;
    return log_factorial(of) - log_factorial(chosen) - log_factorial(of - chosen);
  }
  /// By how much a beam must pass the middle of a cell's points [m].
  [[nodiscard]] float margin_of(const Cell& cell) const {
    return static_cast<float>(options_.cell_size) + static_cast<float>(options_.noise_sigmas) * cell.sigma;
  }
  /// Widths of surfaces by half octaves, from a quarter of a cell on; 0: less.
  [[nodiscard]] std::size_t width_class(float width) const {
    std::size_t found = 0;
    while (found + 1 < kWidths && width >= least_width(found + 1)) ++found;
    return found;
  }
  [[nodiscard]] float least_width(std::size_t of_class) const {
    constexpr std::array<float, 2> kHalfOctaves{1.0F, 1.41421354F};
    if (of_class == 0) return 0.0F;
    return static_cast<float>(options_.cell_size) * 0.25F * kHalfOctaves[(of_class - 1) % 2] *
           static_cast<float>(1U << (of_class - 1) / 2);
  }
  /// Counts a surface of a size in a cell.
  void count_size(Cell& cell, const typename BeamImage<D>::Offset& size) const {
    for (std::size_t k = 0; k < kSides; ++k) ++cell.widths[k][width_class(size[k])];
  }
  /// Of what a cell's points are on, along an axis [m]: at most a fraction of kNarrower looks narrower.
  [[nodiscard]] float width_of(const Cell& cell, std::size_t axis) const {
    std::uint32_t below = 0;
    for (std::size_t i = 0; i < kWidths; ++i) {
      below += cell.widths[axis][i];
      if (static_cast<double>(below) > kNarrower * static_cast<double>(cell.measured)) return least_width(i);
    }
    return least_width(kWidths - 1);
  }
  void plant(std::size_t threads);
  /// Calls `use(first, last)` for beams from one origin: those of a sweep in motion whose origins are within
  /// half a cell are taken for one scan.
  template <class Use>
  void for_each_origin(const ScanView<D>& scan, const Use& use) const;
  /// Fills the image with beams from one origin.
  void see(const ScanView<D>& scan, Eigen::Index first, Eigen::Index last, double max_range);
  /// Length of a beam that an image has [m]; 0 of one without a direction or an end.
  [[nodiscard]] static double range_in_image(const ScanView<D>& scan, Eigen::Index i) {
    const double range = (scan.endpoint(i) - scan.origin(i)).norm();
    return range > 0.0 && std::isfinite(range) ? range : 0.0;
  }
  [[nodiscard]] float sure_range(const ScanView<D>& scan, Eigen::Index i, double range,
                                 double max_range) const;
  void add_from(const ScanView<D>& scan, Eigen::Index first, Eigen::Index last, double max_range);
  /// Counts a scan for the cells in which its own beams end.
  void find_own(const ScanView<D>& scan, Eigen::Index first, Eigen::Index last, double max_range);
  void look_from();
  /// Whether a scan cannot say anything of a ball's cells.
  [[nodiscard]] bool is_hidden(const Balls& balls, std::size_t number) const;
  /// Asks the scan about the cells of a ball that is not hidden.
  void visit(std::size_t level, std::size_t number);
#ifdef NDTREE_HAS_EIGHTS
  /// is_hidden() of eight balls, a bit each.
  NDTREE_BY_EIGHTS [[nodiscard]] unsigned hidden_by_eights(const Balls& balls, std::size_t first) const;
  /// What visit() does for the cells [i, end) of a ball of level 0.
  NDTREE_BY_EIGHTS void ask_by_eights(std::size_t i, std::size_t end);
  bool by_eights_ = Simd::width() >= 8;
#endif

  MovedOptions options_;
  QuickIncompleteBeta below_;              // Of error_rate.
  std::vector<double> log_factorials_;     // Of numbers below kFactorials.
  std::uint32_t outweighed_ = 0;           // Scans that found a surface, by most_scans that saw through.
  Vector<D> base_ = Vector<D>::Zero();     // Near the first end point, so that floats are exact enough.
  std::optional<CellNumbers<D>> numbers_;  // From the first end point on.
  std::vector<Cell> cells_;                // By number; none after plant().
  // After plant(), of cells in the order of the tree, and a few behind the last:
  std::array<std::vector<float>, std::size_t{D}> means_;  // Of their points, relative to base_ [m].
  std::vector<float> margins_;                            // By how much a beam must pass them [m].
  std::array<std::vector<float>, kSides> sizes_;          // Of what they are on, see width_of() [m].
  std::vector<Tally> tallies_;
  std::vector<Balls> balls_;  // Level 0 holds cells, each other one balls of the level below.
  std::size_t task_level_ = 0;
  std::uint32_t scans_ = 0;   // That were added,
  std::uint32_t looked_ = 0;  // and that were asked.
  BeamImage<D> image_;
  RangePyramid<D> pyramid_;
  Point origin_ = Point::Zero();
  float in_view_ = 0.0F;  // The radius that beams around a cell must surround [m].
  std::unique_ptr<Workers> workers_;
};

template <int D>
void MovedEvidence<D>::add(const ScanView<D>& scan, double max_range) {
  if (workers_) throw std::invalid_argument("add() after look(): add all scans before");
  for_each_origin(scan,
                  [&](Eigen::Index first, Eigen::Index last) { add_from(scan, first, last, max_range); });
}

template <int D>
void MovedEvidence<D>::add_from(const ScanView<D>& scan, Eigen::Index first, Eigen::Index last,
                                double max_range) {
  Pace pace;
  typename CellNumbers<D>::Cursor cursor;
  see(scan, first, last, max_range);
  ++scans_;
  std::size_t seen = 0;
  for (Eigen::Index i = first; i < last; ++i) {
    pace.spend(2);
    const double range = range_in_image(scan, i);
    if (range == 0.0) continue;
    const std::size_t beam = seen++;
    if (!scan.is_returned(i) || range > max_range) continue;
    const Vector<D> end = scan.endpoint(i);
    if (!numbers_) {
      base_ = end;
      numbers_.emplace(options_.cell_size, base_);
    }
    const std::uint32_t number = numbers_->put(end, cursor);
    if (number == CellNumbers<D>::kNone)
      throw std::invalid_argument("beam " + std::to_string(i) + ": ends more than a million cells of " +
                                  describe_number(options_.cell_size) + " m from the log's first end point");
    if (number == cells_.size()) cells_.emplace_back();
    Cell& cell = cells_[number];
    ++cell.points;
    const float part = 1.0F / static_cast<float>(cell.points);
    const Point point = relative(end);
    for (int k = 0; k < D; ++k) cell.mean[k] = unfused((point[k] - cell.mean[k]) * part) + cell.mean[k];
    const auto sigma =
        static_cast<float>(scan.range_sigma != nullptr ? scan.range_sigma[i] : sigma_at(range));
    cell.sigma = unfused((sigma - cell.sigma) * part) + cell.sigma;
    if (cell.scan == scans_ || cell.measured == kMostMeasured) continue;
    cell.scan = scans_;
    ++cell.measured;
    count_size(cell, image_.size_of_surface(beam, static_cast<float>(options_.noise_sigmas) * sigma,
                                            kMostWidth * static_cast<float>(options_.cell_size)));
  }
}

template <int D>
void MovedEvidence<D>::plant(std::size_t threads) {
  // Cells in Morton order: eight in a row are near each other, and so are eight of these.
  const std::size_t n = cells_.size();
  std::vector<std::uint64_t> place(n, 0);
  constexpr int kBits = 21;
  for (std::size_t i = 0; i < n; ++i)
    for (int k = 0; k < D; ++k) {
      const auto shifted =
          static_cast<std::uint64_t>(numbers_->cell(static_cast<std::uint32_t>(i))[k] + (1 << (kBits - 1)));
      for (int bit = 0; bit < kBits; ++bit) place[i] |= (shifted >> bit & 1U) << (bit * D + k);
    }
  std::vector<std::uint32_t> order(n);
  std::iota(order.begin(), order.end(), 0U);
  std::sort(order.begin(), order.end(),
            [&](std::uint32_t a, std::uint32_t b) { return place[a] < place[b]; });
  std::vector<Cell> sorted(n);
  std::vector<std::uint32_t> now(n);
  for (std::size_t i = 0; i < n; ++i) {
    sorted[i] = cells_[order[i]];
    now[order[i]] = static_cast<std::uint32_t>(i);
  }
  cells_ = std::move(sorted);
  if (numbers_) numbers_->renumber(now);
  for (std::size_t width = kFanOut; n > 0; width *= kFanOut) {
    Balls& level = balls_.emplace_back();
    for (std::size_t begin = 0; begin < n; begin += width) {
      const std::size_t end = std::min(n, begin + width);
      Point lower = cells_[begin].mean;
      Point upper = lower;
      float margin = 0.0F;
      for (std::size_t i = begin; i < end; ++i) {
        lower = lower.cwiseMin(cells_[i].mean);
        upper = upper.cwiseMax(cells_[i].mean);
        margin = std::max(margin, margin_of(cells_[i]));
      }
      const Point center = 0.5F * (lower + upper);
      for (std::size_t k = 0; k < D; ++k) level.centers[k].push_back(center[static_cast<int>(k)]);
      level.radius.push_back(0.5F * (upper - lower).norm());
      level.margin.push_back(margin);
    }
    level.size = level.radius.size();
    const std::size_t padded = (level.size + kFanOut - 1) / kFanOut * kFanOut;
    for (std::vector<float>& center : level.centers) center.resize(padded, 0.0F);
    level.radius.resize(padded, 0.0F);
    level.margin.resize(padded, 0.0F);
    if (level.size <= kFanOut) break;
  }
  const std::size_t padded = (n + kFanOut - 1) / kFanOut * kFanOut;
  for (std::size_t k = 0; k < D; ++k) {
    means_[k].assign(padded, 0.0F);
    for (std::size_t i = 0; i < n; ++i) means_[k][i] = cells_[i].mean[static_cast<int>(k)];
  }
  margins_.assign(padded, 0.0F);
  for (std::vector<float>& size : sizes_) size.assign(padded, 0.0F);
  for (std::size_t i = 0; i < n; ++i) {
    margins_[i] = margin_of(cells_[i]);
    for (std::size_t k = 0; k < kSides; ++k) sizes_[k][i] = width_of(cells_[i], k);
  }
  tallies_.assign(n, {});
  cells_ = {};
  workers_ = std::make_unique<Workers>(threads);
  constexpr std::size_t kTasksPerThread = 8;
  task_level_ = balls_.empty() ? 0 : balls_.size() - 1;
  while (task_level_ > 0 && balls_[task_level_].size < kTasksPerThread * workers_->count()) --task_level_;
}

template <int D>
template <class Use>
void MovedEvidence<D>::for_each_origin(const ScanView<D>& scan, const Use& use) const {
  Eigen::Index first = 0;
  while (first < scan.size) {
    Eigen::Index last = scan.origin_per_beam ? first + 1 : scan.size;
    while (last < scan.size && (scan.origin(last) - scan.origin(first)).norm() <= 0.5 * options_.cell_size)
      ++last;
    use(first, last);
    first = last;
  }
}

template <int D>
void MovedEvidence<D>::look(const ScanView<D>& scan, double max_range, std::size_t threads) {
  if (!workers_) plant(threads);
  if (balls_.empty()) return;
  for_each_origin(scan, [&](Eigen::Index first, Eigen::Index last) {
    if (!scan.origin(first).allFinite()) return;
    see(scan, first, last, max_range);
    ++looked_;
    find_own(scan, first, last, max_range);
    origin_ = relative(scan.origin(first));
    pyramid_.build(origin_, image_);
    look_from();
  });
}

template <int D>
float MovedEvidence<D>::sure_range(const ScanView<D>& scan, Eigen::Index i, double range,
                                   double max_range) const {
  double sure = std::min(range, max_range);
  if (scan.is_returned(i) && range <= max_range)
    sure -= options_.noise_sigmas * (scan.range_sigma != nullptr ? scan.range_sigma[i] : sigma_at(range));
  return static_cast<float>(std::max(sure, 0.0));
}

template <int D>
void MovedEvidence<D>::see(const ScanView<D>& scan, Eigen::Index first, Eigen::Index last, double max_range) {
  image_.reset();
  for (Eigen::Index i = first; i < last; ++i) {
    const double range = range_in_image(scan, i);
    if (range == 0.0) continue;
    const Vector<D> way = scan.endpoint(i) - scan.origin(i);
    image_.add((way / range).template cast<float>(), sure_range(scan, i, range, max_range));
  }
  image_.build();
}

template <int D>
void MovedEvidence<D>::find_own(const ScanView<D>& scan, Eigen::Index first, Eigen::Index last,
                                double max_range) {
  typename CellNumbers<D>::Cursor cursor;
  for (Eigen::Index i = first; i < last; ++i) {
    if (!scan.is_returned(i)) continue;
    const double range = range_in_image(scan, i);
    if (range == 0.0 || range > max_range) continue;
    const std::uint32_t number = numbers_->find(scan.endpoint(i), cursor);
    if (number == CellNumbers<D>::kNone || tallies_[number].own_scan == looked_) continue;
    tallies_[number].own_scan = looked_;
    tallies_[number].find();
  }
}

template <int D>
void MovedEvidence<D>::look_from() {
  in_view_ = static_cast<float>(0.25 * options_.cell_size + options_.noise_sigmas * options_.range_sigma);
  workers_->for_each_task(balls_[task_level_].size, [this](std::size_t, std::size_t task) {
    if (!is_hidden(balls_[task_level_], task)) visit(task_level_, task);
  });
}

template <int D>
bool MovedEvidence<D>::is_hidden(const Balls& balls, std::size_t number) const {
  Point center;
  for (std::size_t k = 0; k < D; ++k) center[static_cast<int>(k)] = balls.centers[k][number];
  const Point way = center - origin_;
  float square = 0.0F;
  for (int k = 0; k < D; ++k) square = unfused(way[k] * way[k]) + square;
  const float radius = balls.radius[number];
  const float nearest = std::sqrt(square) - radius - balls.margin[number];
  return nearest > 0.0F && pyramid_.hides(center, radius + in_view_, nearest);
}

template <int D>
void MovedEvidence<D>::visit(std::size_t level, std::size_t number) {
  const std::size_t first = kFanOut * number;
  if (level > 0) {
    const Balls& inner = balls_[level - 1];
    const std::size_t count = std::min(kFanOut, inner.size - first);
#ifdef NDTREE_HAS_EIGHTS
    if (by_eights_) {
      const unsigned hidden = hidden_by_eights(inner, first);
      for (std::size_t i = 0; i < count; ++i)
        if ((hidden >> i & 1U) == 0) visit(level - 1, first + i);
      return;
    }
#endif
    for (std::size_t i = first; i < first + count; ++i)
      if (!is_hidden(inner, i)) visit(level - 1, i);
    return;
  }
  const std::size_t end = std::min(first + kFanOut, num_cells());
#ifdef NDTREE_HAS_EIGHTS
  if (by_eights_) {
    ask_by_eights(first, end);
    return;
  }
#endif
  for (std::size_t i = first; i < end; ++i) {
    Point mean;
    for (std::size_t k = 0; k < D; ++k) mean[static_cast<int>(k)] = means_[k][i];
    const Point way = mean - origin_;
    float sum = 0.0F;
    for (int k = 0; k < D; ++k) sum = unfused(way[k] * way[k]) + sum;
    const float distance = std::sqrt(sum);
    const float margin = margins_[i];
    const float passed = pyramid_.surely_passed(mean, distance, in_view_, std::max(distance - margin, 0.0F));
    if (passed >= 0.0F) count(i, passed > distance + margin, distance);
  }
}

#ifdef NDTREE_HAS_EIGHTS
template <int D>
NDTREE_BY_EIGHTS unsigned MovedEvidence<D>::hidden_by_eights(const Balls& balls, std::size_t first) const {
  std::array<EightFloats, std::size_t{D}> center;
  EightFloats square = 0.0F;
  for (std::size_t k = 0; k < D; ++k) {
    center[k] = EightFloats::load(balls.centers[k].data() + first);
    const EightFloats way = center[k] - origin_[static_cast<int>(k)];
    square = unfused(way * way) + square;
  }
  const EightFloats radius = EightFloats::load(balls.radius.data() + first);
  const EightFloats nearest = sqrt_of(square) - radius - EightFloats::load(balls.margin.data() + first);
  return (pyramid_.hides(center, radius + in_view_, nearest) & (nearest > 0.0F)).set();
}

template <int D>
NDTREE_BY_EIGHTS void MovedEvidence<D>::ask_by_eights(std::size_t i, std::size_t end) {
  static_assert(kFanOut == EightFloats::kWidth, "a ball of eight cells");
  std::array<EightFloats, std::size_t{D}> mean;
  EightFloats sum = 0.0F;
  for (std::size_t k = 0; k < D; ++k) {
    mean[k] = EightFloats::load(means_[k].data() + i);
    const EightFloats way = mean[k] - origin_[static_cast<int>(k)];
    sum = unfused(way * way) + sum;
  }
  const EightFloats distance = sqrt_of(sum);
  const EightFloats margin = EightFloats::load(margins_.data() + i);
  const EightFloats passed = pyramid_.surely_passed(mean, distance, in_view_, max_of(distance - margin, 0.0F),
                                                    EightMask::first(end - i));
  const unsigned beyond = (passed > distance + margin).set();
  unsigned answers = (passed >= 0.0F).set();
  std::array<float, 8> distances{};
  distance.store(distances.data());
  for (std::size_t k = 0; answers != 0; answers >>= 1U, ++k)
    if ((answers & 1U) != 0) count(i + k, (beyond >> k & 1U) != 0, distances[k]);
}
#endif

}  // namespace ndtree
