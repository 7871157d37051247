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
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "ndtree/core/cancel.hpp"
#include "ndtree/core/lanes.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/parallel.hpp"
#include "ndtree/core/scan.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/evaluation/beam_image.hpp"
#include "ndtree/evaluation/moved_posterior.hpp"
#include "ndtree/evaluation/range_pyramid.hpp"
#include "ndtree/evaluation/surface_cells.hpp"

namespace ndtree {

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
/// What scans say of a cell together is in MovedPosterior. Where beams passed tells of the cells around, too:
/// no rod of a fence is ever passed through its middle. The same log gives the same answers to the last bit,
/// whatever the number of threads.
template <int D>
class MovedEvidence {
 public:
  /// @throws std::invalid_argument as MovedOptions::validate().
  explicit MovedEvidence(const MovedOptions& options)
      : options_(options), posterior_(options), cells_(options.cell_size) {}

  /// The first pass: where returned beams end. Beams of a length of 0, longer than `max_range` or with a
  /// number that is not finite have no end point. O(beams).
  /// @throws std::invalid_argument after look(), if max_range is not > 0, or if an end point is farther from
  ///   the first than a million cells.
  void add(const ScanView<D>& scan, double max_range = std::numeric_limits<double>::infinity());

  /// The second pass. O(beams + cells in view).
  /// @param threads >= 1; those of the first call.
  /// @throws std::invalid_argument if max_range is not > 0.
  void look(const ScanView<D>& scan, double max_range = std::numeric_limits<double>::infinity(),
            std::size_t threads = 1);

  /// That what returned at points was not part of what stands; 0.5 where no beam ended. O(n).
  void probabilities(const double* points, std::size_t n, float* out) const {
    if (!workers_) {
      std::fill_n(out, n, 0.5F);
      return;
    }
    // Points beside each other are in the same cells and blocks.
    constexpr std::size_t kRemembered = 4096;
    constexpr std::uint32_t kNone = SurfaceCells<D>::kNone;
    std::vector<std::pair<std::uint32_t, float>> remembered(std::min(n, kRemembered), {kNone, 0.5F});
    std::vector<float> thin(blocks_.size(), std::numeric_limits<float>::quiet_NaN());
    typename SurfaceCells<D>::Cursor cursor;
    for_each_paced(n, 2, [&](std::size_t i) {
      const std::uint32_t number = cells_.find(Eigen::Map<const Vector<D>>(points + i * D), cursor);
      out[i] = 0.5F;
      if (number == kNone) return;
      auto& [before, probability] = remembered[number % remembered.size()];
      if (before != number) {
        before = number;
        float& around = thin[block_of(number)];
        if (std::isnan(around)) around = thin_in(block_of(number));
        probability = posterior_(tallies_[number], around);
      }
      out[i] = probability;
    });
  }

  /// What scans said of the cell of a point; nothing where no beam ended.
  [[nodiscard]] MovedTally tally(const Vector<D>& point) const {
    typename SurfaceCells<D>::Cursor cursor;
    const std::uint32_t number = cells_.find(point, cursor);
    return number == SurfaceCells<D>::kNone || !workers_ ? MovedTally() : tallies_[number];
  }

  /// The mean of each cell's points [m], D numbers each, in an order that depends on the log alone; none
  /// before look(). O(cells).
  [[nodiscard]] std::vector<double> means() const {
    std::vector<double> found;
    found.reserve(tallies_.size() * D);
    for (std::size_t i = 0; i < tallies_.size(); ++i)
      for (std::size_t k = 0; k < D; ++k)
        found.push_back(cells_.base()[static_cast<int>(k)] + static_cast<double>(means_[k][i]));
    return found;
  }

  [[nodiscard]] const MovedOptions& options() const { return options_; }
  [[nodiscard]] std::size_t num_cells() const { return cells_.size(); }

 private:
  using Point = Eigen::Matrix<float, D, 1>;
  static constexpr std::size_t kFanOut = CellBalls<D>::kFanOut;
  static constexpr std::size_t kSides = D - 1;
  // Of ranges beside each other on one surface: three standard deviations of their difference.
  static constexpr float kOneSurface = 4.24264069F;
  static constexpr float kCore = 0.25F;  // Of a width: least distance of a surface's middle from its border.

  [[nodiscard]] double sigma_at(double range) const {
    return options_.range_sigma + unfused(options_.range_sigma_quadratic * range) * range;
  }
  /// Standard deviation of a beam's range by itself [m].
  [[nodiscard]] double sigma_of(const ScanView<D>& scan, Eigen::Index i, double range) const {
    return scan.range_sigma != nullptr ? scan.range_sigma[i] : sigma_at(range);
  }
  /// The radius around a place at a distance that beams must surround, and pass [m]: by errors of poses, its
  /// points are displaced across the beam.
  [[nodiscard]] float in_view(float distance) const { return unfused(distance * turned_) + in_view_; }
  [[nodiscard]] Point direction_of(std::size_t i, float distance) const {
    Point way;
    for (std::size_t k = 0; k < D; ++k)
      way[static_cast<int>(k)] = means_[k][i] - origin_[static_cast<int>(k)];
    return way / distance;
  }
  /// count() where beams are farther apart than what must be in view.
  void ask_beams(std::size_t i, float distance) {
    if (tallies_[i].own_scan == looked_) return;
    using Seen = typename BeamImage<D>::Seen;
    const Seen seen = image_.look(direction_of(i, distance), in_view(distance) / distance,
                                  std::max(distance - margins_[i], 0.0F), distance + margins_[i]);
    if (seen == Seen::beside)
      ++tallies_[i].unsure;
    else if (seen != Seen::nothing)
      count(i, seen == Seen::passed, distance);
  }
  /// Counts what the scan says of a cell in which none of its own beams ended.
  void count(std::size_t i, bool is_passed, float distance) {
    MovedTally& tally = tallies_[i];
    if (tally.own_scan == looked_) return;
    if (!is_passed) {
      tally.find();
      return;
    }
    typename BeamImage<D>::Offset size;
    typename BeamImage<D>::Offset core;
    for (std::size_t k = 0; k < kSides; ++k) {
      size[k] = sizes_[k][i] / distance;
      core[k] = kCore * size[k];
    }
    const Point direction = direction_of(i, distance);
    const float least = distance + margins_[i];
    if (!image_.surely_meets(direction, size, core, least)) {
      ++tally.unsure;
      return;
    }
    posterior_.pass(tally);
    const auto beside = image_.beside(direction, size, core, least, MovedPosterior::kRod / distance);
    for (std::size_t k = 0; k < kSides; ++k)
      tally.thin[k] += MovedPosterior::odds_of_thin(beside[k].nearest * distance, beside[k].gap * distance);
  }
  [[nodiscard]] std::size_t block_of(std::uint32_t number) const {
    return static_cast<std::size_t>(std::upper_bound(blocks_.begin(), blocks_.end(), number) -
                                    blocks_.begin()) -
           1;
  }
  /// MovedTally::thin of all cells of a block, along the axis along which it is larger.
  [[nodiscard]] float thin_in(std::size_t block) const {
    std::array<float, kSides> sums{};
    const std::size_t end = block + 1 < blocks_.size() ? blocks_[block + 1] : tallies_.size();
    for (std::size_t i = blocks_[block]; i < end; ++i)
      for (std::size_t k = 0; k < kSides; ++k) sums[k] += tallies_[i].thin[k];
    return *std::max_element(sums.begin(), sums.end());
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
  static void require(double max_range) {
    if (!(max_range > 0.0))
      throw std::invalid_argument("max_range = " + describe_number(max_range) + " m: must be > 0");
  }
  void add_from(const ScanView<D>& scan, Eigen::Index first, Eigen::Index last, double max_range);
  /// Counts a scan for the cells in which its own beams end.
  void find_own(const ScanView<D>& scan, Eigen::Index first, Eigen::Index last, double max_range);
  void look_from();
  /// Whether a scan cannot say anything of a ball's cells.
  [[nodiscard]] bool is_hidden(const CellBalls<D>& balls, std::size_t number) const;
  /// Asks the scan about the cells of a ball that is not hidden.
  void visit(std::size_t level, std::size_t number);
#ifdef NDTREE_HAS_EIGHTS
  NDTREE_BY_EIGHTS NDTREE_ALWAYS_INLINE EightFloats in_view_by_eights(const EightFloats& distance) const {
    return unfused(distance * turned_) + in_view_;
  }
  /// is_hidden() of eight balls, a bit each.
  NDTREE_BY_EIGHTS [[nodiscard]] unsigned hidden_by_eights(const CellBalls<D>& balls,
                                                           std::size_t first) const;
  /// What visit() does for the cells [i, end) of a ball of level 0.
  NDTREE_BY_EIGHTS void ask_by_eights(std::size_t i, std::size_t end);
  bool by_eights_ = Simd::width() >= 8;
#endif

  MovedOptions options_;
  MovedPosterior posterior_;
  SurfaceCells<D> cells_;
  // After plant(), of cells in the order of the tree, and a few behind the last:
  std::array<std::vector<float>, std::size_t{D}> means_;  // Of their points, relative [m].
  std::vector<float> margins_;                            // By how much a beam must pass them [m].
  std::array<std::vector<float>, kSides> sizes_;          // Of what they are on [m].
  std::vector<MovedTally> tallies_;
  std::vector<std::uint32_t> blocks_;  // First cells, see SurfaceCells::blocks().
  std::vector<CellBalls<D>> balls_;
  std::size_t task_level_ = 0;
  std::uint32_t scans_ = 0;   // That were added,
  std::uint32_t looked_ = 0;  // and that were asked.
  BeamImage<D> image_;
  RangePyramid<D> pyramid_;
  Point origin_ = Point::Zero();
  float in_view_ = 0.0F;  // See in_view(): at the sensor [m],
  float turned_ = 0.0F;   // and for each metre.
  std::unique_ptr<Workers> workers_;
};

template <int D>
void MovedEvidence<D>::add(const ScanView<D>& scan, double max_range) {
  require(max_range);
  if (workers_) throw std::invalid_argument("add() after look(): add all scans before");
  for_each_origin(scan,
                  [&](Eigen::Index first, Eigen::Index last) { add_from(scan, first, last, max_range); });
}

template <int D>
void MovedEvidence<D>::add_from(const ScanView<D>& scan, Eigen::Index first, Eigen::Index last,
                                double max_range) {
  Pace pace;
  typename SurfaceCells<D>::Cursor cursor;
  see(scan, first, last, max_range);
  ++scans_;
  std::size_t seen = 0;
  for (Eigen::Index i = first; i < last; ++i) {
    pace.spend(2);
    const double range = range_in_image(scan, i);
    if (range == 0.0) continue;
    const std::size_t beam = seen++;
    if (!scan.is_returned(i) || range > max_range) continue;
    const auto sigma = static_cast<float>(sigma_of(scan, i, range));
    const std::uint32_t number =
        cells_.add(scan.endpoint(i), sigma + static_cast<float>(0.5 * options_.place_sigma), cursor);
    if (number == SurfaceCells<D>::kNone)
      throw std::invalid_argument("beam " + std::to_string(i) + ": ends more than a million cells of " +
                                  describe_number(options_.cell_size) + " m from the log's first end point");
    if (!cells_.wants_size(number, scans_)) continue;
    cells_.measure(number, image_.size_of_surface(beam, kOneSurface * sigma, cells_.largest_size()));
  }
}

template <int D>
void MovedEvidence<D>::plant(std::size_t threads) {
  cells_.sort();
  const std::size_t n = cells_.size();
  const std::size_t padded = (n + kFanOut - 1) / kFanOut * kFanOut;
  for (std::vector<float>& mean : means_) mean.assign(padded, 0.0F);
  for (std::vector<float>& size : sizes_) size.assign(padded, 0.0F);
  margins_.assign(padded, 0.0F);
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t k = 0; k < D; ++k) means_[k][i] = cells_.mean(i)[static_cast<int>(k)];
    for (std::size_t k = 0; k < kSides; ++k) sizes_[k][i] = cells_.width(i, k);
    margins_[i] =
        static_cast<float>(options_.cell_size) + static_cast<float>(options_.noise_sigmas) * cells_.sigma(i);
  }
  balls_ = CellBalls<D>::around(cells_, margins_);
  blocks_ = cells_.blocks();
  cells_.forget();
  tallies_.assign(n, {});
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
  require(max_range);
  if (!workers_) plant(threads);
  if (balls_.empty()) return;
  for_each_origin(scan, [&](Eigen::Index first, Eigen::Index last) {
    if (!scan.origin(first).allFinite()) return;
    see(scan, first, last, max_range);
    ++looked_;
    find_own(scan, first, last, max_range);
    origin_ = cells_.relative(scan.origin(first));
    pyramid_.build(origin_, image_);
    look_from();
  });
}

template <int D>
float MovedEvidence<D>::sure_range(const ScanView<D>& scan, Eigen::Index i, double range,
                                   double max_range) const {
  double sure = std::min(range, max_range);
  if (scan.is_returned(i) && range <= max_range)
    sure -= options_.noise_sigmas * (sigma_of(scan, i, range) + 0.5 * options_.place_sigma);
  return static_cast<float>(std::max(sure, 0.0));
}

template <int D>
void MovedEvidence<D>::see(const ScanView<D>& scan, Eigen::Index first, Eigen::Index last, double max_range) {
  image_.reset();
  for (Eigen::Index i = first; i < last; ++i) {
    const double range = range_in_image(scan, i);
    if (range == 0.0) continue;
    const Vector<D> way = scan.endpoint(i) - scan.origin(i);
    image_.add((way / range).template cast<float>(), sure_range(scan, i, range, max_range),
               scan.is_returned(i) && range <= max_range);
  }
  image_.build();
}

template <int D>
void MovedEvidence<D>::find_own(const ScanView<D>& scan, Eigen::Index first, Eigen::Index last,
                                double max_range) {
  typename SurfaceCells<D>::Cursor cursor;
  for (Eigen::Index i = first; i < last; ++i) {
    if (!scan.is_returned(i)) continue;
    const double range = range_in_image(scan, i);
    if (range == 0.0 || range > max_range) continue;
    const std::uint32_t number = cells_.find(scan.endpoint(i), cursor);
    if (number == SurfaceCells<D>::kNone || tallies_[number].own_scan == looked_) continue;
    tallies_[number].own_scan = looked_;
    tallies_[number].find();
  }
}

template <int D>
void MovedEvidence<D>::look_from() {
  const double sigmas = options_.noise_sigmas;
  in_view_ = static_cast<float>(0.25 * options_.cell_size + sigmas * options_.range_sigma +
                                sigmas * options_.place_sigma);
  turned_ = static_cast<float>(sigmas * options_.turn_sigma);
  workers_->for_each_task(balls_[task_level_].size, [this](std::size_t, std::size_t task) {
    if (!is_hidden(balls_[task_level_], task)) visit(task_level_, task);
  });
}

template <int D>
bool MovedEvidence<D>::is_hidden(const CellBalls<D>& balls, std::size_t number) const {
  Point center;
  for (std::size_t k = 0; k < D; ++k) center[static_cast<int>(k)] = balls.centers[k][number];
  const Point way = center - origin_;
  float square = 0.0F;
  for (int k = 0; k < D; ++k) square = unfused(way[k] * way[k]) + square;
  const float radius = balls.radius[number];
  const float distance = std::sqrt(square);
  const float nearest = distance - radius - balls.margin[number];
  return nearest > 0.0F && pyramid_.hides(center, radius + in_view(distance + radius), nearest);
}

template <int D>
void MovedEvidence<D>::visit(std::size_t level, std::size_t number) {
  const std::size_t first = kFanOut * number;
  if (level > 0) {
    const CellBalls<D>& inner = balls_[level - 1];
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
    const float passed =
        pyramid_.surely_passed(mean, distance, in_view(distance), std::max(distance - margin, 0.0F));
    if (passed >= 0.0F) count(i, passed > distance + margin, distance);
    if (passed == RangePyramid<D>::kSparse) ask_beams(i, distance);
  }
}

#ifdef NDTREE_HAS_EIGHTS
template <int D>
NDTREE_BY_EIGHTS unsigned MovedEvidence<D>::hidden_by_eights(const CellBalls<D>& balls,
                                                             std::size_t first) const {
  std::array<EightFloats, std::size_t{D}> center;
  EightFloats square = 0.0F;
  for (std::size_t k = 0; k < D; ++k) {
    center[k] = EightFloats::load(balls.centers[k].data() + first);
    const EightFloats way = center[k] - origin_[static_cast<int>(k)];
    square = unfused(way * way) + square;
  }
  const EightFloats radius = EightFloats::load(balls.radius.data() + first);
  const EightFloats distance = sqrt_of(square);
  const EightFloats nearest = distance - radius - EightFloats::load(balls.margin.data() + first);
  return (pyramid_.hides(center, radius + in_view_by_eights(distance + radius), nearest) & (nearest > 0.0F))
      .set();
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
  const EightFloats passed =
      pyramid_.surely_passed(mean, distance, in_view_by_eights(distance), max_of(distance - margin, 0.0F),
                             EightMask::first(end - i));
  const unsigned beyond = (passed > distance + margin).set();
  unsigned answers = (passed >= 0.0F).set();
  unsigned sparse = (passed == RangePyramid<D>::kSparse).set();
  std::array<float, 8> distances{};
  distance.store(distances.data());
  for (std::size_t k = 0; answers != 0; answers >>= 1U, ++k)
    if ((answers & 1U) != 0) count(i + k, (beyond >> k & 1U) != 0, distances[k]);
  for (std::size_t k = 0; sparse != 0; sparse >>= 1U, ++k)
    if ((sparse & 1U) != 0) ask_beams(i + k, distances[k]);
}
#endif

}  // namespace ndtree
