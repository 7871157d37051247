// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Integration of a whole scan: the pipeline from its survey to the walk over the tree.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <numeric>
#include <type_traits>
#include <utility>
#include <vector>

#include "ndtree/core/parallel.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/mapping/insert/counting_sort.hpp"
#include "ndtree/mapping/insert/cube_map.hpp"
#include "ndtree/mapping/insert/measurements.hpp"
#include "ndtree/mapping/insert/packed_beams.hpp"
#include "ndtree/mapping/insert/subsample.hpp"
#include "ndtree/mapping/insert/task_lists.hpp"
#include "ndtree/mapping/insert/tasks.hpp"
#include "ndtree/mapping/insert/walk.hpp"
#include "ndtree/mapping/map_options.hpp"
#include "ndtree/mapping/update_counters.hpp"
#include "ndtree/tree/cube_set.hpp"
#include "ndtree/tree/undo_log.hpp"

namespace ndtree {

/// Integrates a scan as a whole, in one walk over the tree, for n beams by p workers:
///
/// 1. survey: beams -> face, depth and sampling key of each, numbers of outcomes, and the scan's reach. O(n),
///    parallel.
/// 2. measure faces: directions -> number and extent of the beams of each face of the cube map, hence its
///    density. O(n), parallel, in the same pass over the beams as 1.
/// 3. subsample: faces, depths and keys -> the beams that some cell can sample. O(n), parallel.
/// 4. counting sort: kept beams -> their numbers by face and bucket. O(n + p * buckets), parallel.
/// 5. pack: sorted numbers -> two table rows per beam, see ScanBeams. O(n), parallel.
/// 6. walk: rows and tree -> changed cells, their summaries, counters. O(pairs of a beam and a node that it
///    crosses, without saturated subtrees that all beams clearly pass), parallel by tasks, see ScanTasks.
///
/// survey() does 1 and 2 for each part of the scan; finish() joins the parts' cube maps, and does the others.
///
/// Invariants:
/// - Same scan, same map, bit for bit. A leaf's evidence is a sum of whole numbers over the beams that it
///   samples and that cross it over more than a point (see LeafEvidence), so neither the order of the beams
///   nor the number of workers nor the width of loops matters.
/// - A leaf that splits passes on its list, not only its sample (without beams that no leaf below can
///   sample); its children sample it again, and start with parts of its evidence. Siblings are merged on the
///   way back if one of them changed. A leaf that splits and re-merges within the scan counts neither as
///   split nor as merged.
/// - A cell that the scan leaves as it was does not count as updated. A saturated cell is skipped if all its
///   beams clearly pass.
/// - survey() does not change the tree, so that a scan with an error leaves the map as it was.
template <class Tree, class Refinement, class Sensor>
class ScanUpdate {
  static constexpr int D = Tree::kDim;
  using Walk = ScanWalk<Tree, Refinement, Sensor>;
  using Part = ScanPart<D, Sensor>;

 public:
  ScanUpdate(Tree& tree, const Refinement& refinement, const Sensor& sensor, const MapOptions&,
             UpdateCounters& counters)
      : tree_(tree), refinement_(refinement), sensor_(sensor), counters_(counters) {}

  /// Number of workers that a scan of this many beams is worth.
  [[nodiscard]] static std::size_t most_workers(Eigen::Index beams) {
    constexpr Eigen::Index kBeamsOfWorker = 1000;
    return static_cast<std::size_t>(std::max<Eigen::Index>(1, beams / kBeamsOfWorker));
  }

  /// Surveys a scan and measures the faces of its cube map. The tree stays as it is.
  /// @param measurements must stay where they are until finish() returns. @throws as survey_exactly().
  ScanSurvey<D> survey(const Measurements<D, Sensor>& measurements, Workers& workers) {
    measurements_ = &measurements;
    parts_.resize(workers.count());
    workers.for_each_task(parts_.size(), [&](std::size_t, std::size_t p) {
      parts_[p].survey_beams(measurements, measurements.part(p, parts_.size()));
    });
    const ScanSurvey<D> whole = join_surveys(tree_.geometry(), sensor_, measurements, parts_);
    reach_ = whole.reach;
    return whole;
  }

  /// Integrates the surveyed scan. The result is the same for every number of workers.
  /// @pre the tree contains the survey's reach.
  /// @param undo gets logs of changed nodes, see ScanWalks; null: nothing is logged.
  /// @param window nodes of the coarsest level that do not overlap it stay as they are, with all below them.
  void finish(Workers& workers, std::vector<UndoLog<Tree>>* undo = nullptr,
              const ChangeWindow<D>& window = {}) {
    prepare(workers);
    if (beams_.size() == 0) return;
    checkpoint();
    if (workers.count() <= 1 || !lists_fit_in_memory()) {
      if (undo != nullptr) undo->resize(1);
      Walk walk(tree_, tree_.main_arena(), refinement_, sensor_, beams_,
                undo == nullptr ? nullptr : undo->data(), window);
      walk.run();
      counters_.add(walk.counters());
      return;
    }
    ScanWalks<Tree, Walk> walks(tree_, workers, undo, [&](auto& all, auto& arena, UndoLog<Tree>* log) {
      all.emplace_back(tree_, arena, refinement_, sensor_, beams_, log, window);
    });
    walks.run(coarsest_level(), beams_.size());
    walks.add_to(counters_);
  }

 private:
  /// Subsamples, sorts and packs the beams.
  void prepare(Workers& workers) {
    // Subsample: one cube map of all parts, then each part drops the beams that no cell can sample.
    std::vector<std::vector<std::uint32_t>> numbers;  // [part][face]: its number in the cube map.
    numbers.reserve(parts_.size());
    for (Part& part : parts_) numbers.push_back(cube_map_.join(part.cube_map()));
    for (CubeFace<D>& face : cube_map_.faces()) face.make_pixels();
    const auto& geometry = tree_.geometry();
    const int finest = finest_level();
    const SubsampleLimits sampling{refinement_.model.sample_beams(false), geometry.cell_size(finest),
                                   geometry.cell_size(coarsest_level())};
    workers.for_each_task(
        parts_.size(), [&](std::size_t, std::size_t p) { parts_[p].keep(cube_map_, numbers[p], sampling); });
    std::size_t num_beams = 0;
    float depth = 0.0f;
    Eigen::Index any = 0;
    for (const Part& part : parts_) {
      num_beams += part.num_kept();
      depth = std::max(depth, part.depth_of_kept(sampling));
      if (part.num_kept() > 0) any = static_cast<Eigen::Index>(part.kept(0));
    }
    if (num_beams == 0) return;
    // Counting sort by face and bucket.
    std::vector<CubeFace<D>> faces = number_faces(numbers, static_cast<float>(sampling.smallest_cell));
    for (CubeFace<D>& face : faces)
      face.num_buckets = face.buckets_within(depth, static_cast<float>(sampling.smallest_cell),
                                             static_cast<float>(sampling.beams));
    const BeamBuckets<D> buckets(faces);
    std::vector<std::vector<std::uint32_t>> indices(parts_.size());
    workers.for_each_task(parts_.size(), [&](std::size_t, std::size_t p) {
      indices[p] = parts_[p].count(buckets, numbers[p]);
    });
    buckets.prefix_sum(indices, workers);
    const std::unique_ptr<std::uint32_t[]> kept(new std::uint32_t[num_beams]);  // Parts write it.
    workers.for_each_task(parts_.size(),
                          [&](std::size_t, std::size_t p) { parts_[p].scatter(indices[p], kept.get()); });
    parts_.clear();
    // Pack.
    const ScanView<D>& scan = measurements_->scan();
    beams_.resize(num_beams, std::move(faces), std::move(indices.back()), scan.origin_per_beam,
                  geometry.coordinates(scan.origin(any)), ends_fit_32_bits(), scan.range_sigma != nullptr);
    const bool by_eights = may_go_by_eights();
    std::vector<BeamNoise> noise(workers.count());
    const std::size_t tasks = noise.size();
    workers.for_each_task(tasks, [&](std::size_t, std::size_t task) {
      noise[task] =
          set_beams(kept.get(), num_beams * task / tasks, num_beams * (task + 1) / tasks, by_eights);
    });
    for (std::size_t task = 1; task < tasks; ++task) noise.front().add(noise[task]);
    beams_.finish(noise.front(), finest);
  }

  /// See ScanBeams::finest_level().
  [[nodiscard]] int finest_level() const {
    return tree_.geometry().level_of(refinement_.model.noise_sigmas() * measurements_->least_sigma());
  }

  /// True if any two cells of the reach are near enough that ScanBeams::ends_fit_32_bits() holds.
  [[nodiscard]] bool ends_fit_32_bits() const {
    const double nearby = 0.5 * static_cast<double>(ScanBeams<D>::kNearby) * tree_.geometry().unit();
    return (reach_.upper - reach_.lower).maxCoeff() < nearby;
  }
  /// True if the scan meets the preconditions of ScanBeams::set_eight().
  [[nodiscard]] bool may_go_by_eights() const {
#ifdef NDTREE_HAS_EIGHTS
    const ScanView<D>& scan = measurements_->scan();
    return kPacksByEights<Sensor> && Simd::width() >= 8 && !scan.origin_per_beam &&
           scan.range_sigma == nullptr && scan.size < std::numeric_limits<std::int32_t>::max() / D &&
           ends_fit_32_bits();
#else
    return false;
#endif
  }
  /// FreeMargin::growth that fits the sensor's noise at both ends of the scan.
  [[nodiscard]] float margin_growth() const {
    const double range = (reach_.upper - reach_.lower).norm();
    const auto margin = [&](double r) {
      const double sigma = measurements_->sigma_at(r);
      return Sensor::kReachSigmas * sigma + r - sensor_.clearly_free_until(r, sigma) +
             kThinnestSurface * sigma;
    };
    return static_cast<float>(std::max(0.0, (margin(range) - margin(0.0)) / (range * range)));
  }
  /// Packs the beams [first, last) of the sorted array. @returns their noise.
  BeamNoise set_beams(const std::uint32_t* kept, std::size_t first, std::size_t last,
                      [[maybe_unused]] bool by_eights) {
    BeamNoise noise(margin_growth());
    const auto& geometry = tree_.geometry();
    const auto set = [&](std::size_t i) {
      beams_.set(i, geometry, sensor_, *measurements_, static_cast<Eigen::Index>(kept[i]), noise);
    };
    if (first < last) set(first);
    std::size_t i = first + 1;
#ifdef NDTREE_HAS_EIGHTS
    if constexpr (kPacksByEights<Sensor>) {
      // Sorted beams lie scattered in the scan's array, which the first cache does not hold: prefetch.
      constexpr std::size_t kAhead = 32;
      const ScanView<D>& scan = measurements_->scan();
      for (; by_eights && i + 8 <= last; i += 8) {
        if (i + kAhead + 8 <= last)
          for (std::size_t k = 0; k < 8; ++k)
            prefetch<D>(scan.endpoints + std::size_t{D} * kept[i + kAhead + k]);
        unsigned returned = 0;
        for (std::size_t k = 0; k < 8; ++k)
          returned |= unsigned{scan.is_returned(static_cast<Eigen::Index>(kept[i + k]))} << k;
        if (!beams_.set_eight(i, geometry, sensor_, *measurements_, kept + i, returned, noise))
          for (std::size_t k = 0; k < 8; ++k) set(i + k);
      }
    }
#endif
    for (; i < last; ++i) set(i);
    return noise;
  }
  /// The faces that have kept beams. Face 0 stands for all faces with a single beam.
  /// @param numbers of each part's faces in the cube map; on return, in the result.
  std::vector<CubeFace<D>> number_faces(std::vector<std::vector<std::uint32_t>>& numbers,
                                        float smallest_cell) const {
    std::vector<std::uint32_t> kept(cube_map_.faces().size(), 0);
    for (std::size_t p = 0; p < parts_.size(); ++p)
      for (std::size_t f = 0; f < numbers[p].size(); ++f) kept[numbers[p][f]] += parts_[p].kept_of_faces()[f];
    std::vector<CubeFace<D>> faces;
    faces.reserve(1 + kept.size());
    faces.emplace_back(Vector<D>::Zero(), 0, false);
    faces.front().num_beams = 1;
    std::vector<std::uint32_t> number(kept.size(), 0);
    for (std::size_t f = 0; f < kept.size(); ++f) {
      const CubeFace<D>& face = cube_map_.faces()[f];
      if (kept[f] > 0 && !face.is_single()) {
        number[f] = static_cast<std::uint32_t>(faces.size());
        faces.push_back(face);
        for (const bool uses_small_sample : {false, true})
          faces.back().depth_of_full_sample[uses_small_sample] = face.depth_for(
              static_cast<float>(refinement_.model.sample_beams(uses_small_sample)), smallest_cell);
      }
      faces[number[f]].end_of_beams += kept[f];
    }
    for (std::size_t f = 1; f < faces.size(); ++f) faces[f].end_of_beams += faces[f - 1].end_of_beams;
    for (auto& of_part : numbers)
      for (std::uint32_t& face : of_part) face = number[face];
    return faces;
  }

  /// True if the lists of all tasks, which exist at the same time, surely take less than a gigabyte.
  [[nodiscard]] bool lists_fit_in_memory() const {
    constexpr double kMost = 0x1p26;
    const double cell_size = tree_.geometry().cell_size(coarsest_level());
    const auto n = static_cast<double>(beams_.size());
    const auto fit = [&](double metres) { return most_crossings<D>(n, metres, cell_size) < kMost; };
    if (fit(n * (reach_.upper - reach_.lower).norm())) return true;
    return fit(std::accumulate(beams_.rays(), beams_.rays() + beams_.size(), 0.0,
                               [](double sum, const BeamRay<D>& ray) { return sum + ray.t_max; }));
  }

  /// The level of cells that are tasks, above which nothing is merged.
  [[nodiscard]] int coarsest_level() const {
    return Refinement::coarsest_level(tree_.geometry().finest_level());
  }

  Tree& tree_;
  const Refinement& refinement_;
  const Sensor& sensor_;
  UpdateCounters& counters_;
  const Measurements<D, Sensor>* measurements_ = nullptr;
  std::vector<Part> parts_;  // Until the beams are sorted.
  Box<D> reach_;
  CubeMap<D> cube_map_;
  ScanBeams<D> beams_;
};

}  // namespace ndtree
