// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Integration of whole scans: looked over, thinned to what cells take, and handed down the tree.
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

#include "ndtree/core/cache_lines.hpp"
#include "ndtree/core/parallel.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/mapping/map_options.hpp"
#include "ndtree/mapping/scan/counting_sort.hpp"
#include "ndtree/mapping/scan/cube_map.hpp"
#include "ndtree/mapping/scan/measurements.hpp"
#include "ndtree/mapping/scan/packed_beams.hpp"
#include "ndtree/mapping/scan/subsample.hpp"
#include "ndtree/mapping/scan/tasks.hpp"
#include "ndtree/mapping/scan/walk.hpp"
#include "ndtree/mapping/update_counters.hpp"
#include "ndtree/tree/undo_log.hpp"

namespace ndtree {

/// Integrates all beams of a scan in one walk over the tree. A leaf gets the joint evidence of the beams that
/// cross it over more than a point (see LeafEvidence): a sum of whole numbers, so that neither their order
/// matters nor how they are found. A leaf that splits passes the same beams on to its children, which begin
/// with what is due to them of what it knew. Siblings of which a cell changed are merged on the way back. A
/// leaf that splits and is whole again after the same scan was neither split nor merged.
///
/// A cell that a scan leaves as it was is not updated, and does not count as such. That is so for cells that
/// know as much free space as a cell can remember: where all beams pass, they are not even asked.
template <class Tree, class Refinement, class Sensor>
class ScanUpdate {
  static constexpr int D = Tree::kDim;
  using Walk = ScanWalk<Tree, Refinement, Sensor>;
  using Part = ScanPart<D, Sensor>;

 public:
  ScanUpdate(Tree& tree, const Refinement& refinement, const Sensor& sensor, const MapOptions&,
             UpdateCounters& counters)
      : tree_(tree), refinement_(refinement), sensor_(sensor), counters_(counters) {}

  /// So many that the start of a thread is worth it for each.
  [[nodiscard]] static std::size_t most_workers(Eigen::Index beams) {
    constexpr Eigen::Index kBeamsOfWorker = 1000;
    return static_cast<std::size_t>(std::max<Eigen::Index>(1, beams / kBeamsOfWorker));
  }

  /// Looks over a scan, which must stay where it is until finish() is done; the tree stays as it is.
  /// @throws as survey_exactly().
  ScanSurvey<D> look_over(const Measurements<D, Sensor>& measurements, Workers& workers) {
    measurements_ = &measurements;
    parts_.resize(workers.count());
    workers.for_each_task(parts_.size(), [&](std::size_t, std::size_t p) {
      parts_[p].look_over(measurements, measurements.part(p, parts_.size()), sensor_, tree_.geometry());
    });
    ScanSurvey<D> survey;
    for (const Part& part : parts_) survey.add(part.survey());
    reach_ = survey.reach;
    return survey;
  }

  /// @pre the tree contains what the survey reaches.
  /// The result is the same for every number of workers.
  /// @param undo grows to as many logs as are needed; null if none is to be kept.
  /// @param window of cells of the coarsest level, outside which nothing is to change; null: all may.
  void finish(Workers& workers, std::vector<UndoLog<Tree>>* undo = nullptr,
              const LatticeBox<D>* window = nullptr) {
    prepare(workers);
    if (beams_.size() == 0) return;
    checkpoint();
    window_ = window;
    undo_ = undo;
    if (undo_ != nullptr) undo_->resize(1 + workers.count());
    if (workers.count() <= 1 || !lists_fit_in_memory()) {
      Walk walk(tree_, tree_.main_arena(), refinement_, sensor_, beams_, log(0), window_);
      walk.run();
      add(walk.counters());
    } else {
      run_tasks(workers);
    }
  }

 private:
  /// Puts the beams that some cell may take into arrays, by face and step of chance.
  void prepare(Workers& workers) {
    std::vector<std::vector<std::uint32_t>> numbers;
    numbers.reserve(parts_.size());
    for (Part& part : parts_) numbers.push_back(image_.join(part.image()));
    for (CubeFace<D>& face : image_.faces()) face.divide();
    const auto& geometry = tree_.geometry();
    const SubsampleLimits sampling{refinement_.model.sample_beams(false), geometry.unit(),
                                   geometry.cell_size(coarsest_level())};
    workers.for_each_task(parts_.size(),
                          [&](std::size_t, std::size_t p) { parts_[p].keep(image_, numbers[p], sampling); });
    std::size_t num_beams = 0;
    float depth = 0.0f;
    Eigen::Index any = 0;
    for (const Part& part : parts_) {
      num_beams += part.num_kept();
      depth = std::max(depth, part.depth_of_kept(sampling));
      if (part.num_kept() > 0) any = static_cast<Eigen::Index>(part.kept(0));
    }
    if (num_beams == 0) return;
    std::vector<CubeFace<D>> faces = number_faces(numbers);
    for (CubeFace<D>& face : faces)
      face.num_buckets = face.buckets_within(depth, static_cast<float>(sampling.smallest_cell),
                                             static_cast<float>(sampling.beams));
    const BeamBuckets<D> steps(faces);
    std::vector<std::vector<std::uint32_t>> places(parts_.size());
    workers.for_each_task(
        parts_.size(), [&](std::size_t, std::size_t p) { places[p] = parts_[p].count(steps, numbers[p]); });
    steps.begin(places, workers);
    const std::unique_ptr<std::uint32_t[]> kept(new std::uint32_t[num_beams]);  // Parts initialise that.
    workers.for_each_task(parts_.size(),
                          [&](std::size_t, std::size_t p) { parts_[p].put(places[p], kept.get()); });
    parts_.clear();
    const ScanView<D>& scan = measurements_->scan();
    beams_.resize(num_beams, std::move(faces), std::move(places.back()), scan.origin_per_beam,
                  geometry.coordinates(scan.origin(any)), ends_nearby(), scan.range_sigma != nullptr);
    const bool by_eights = may_go_by_eights();
    std::vector<BeamNoise> noise(workers.count());
    const std::size_t tasks = noise.size();
    workers.for_each_task(tasks, [&](std::size_t, std::size_t task) {
      noise[task] =
          set_beams(kept.get(), num_beams * task / tasks, num_beams * (task + 1) / tasks, by_eights);
    });
    for (std::size_t task = 1; task < tasks; ++task) noise.front().add(noise[task]);
    beams_.finish(noise.front());
  }

  [[nodiscard]] bool ends_nearby() const {
    const double nearby = 0.5 * static_cast<double>(ScanBeams<D>::kNearby) * tree_.geometry().unit();
    return (reach_.upper - reach_.lower).maxCoeff() < nearby;
  }
  /// Whether ScanBeams::set_eight() may do: for scans of one origin, that end nearby.
  [[nodiscard]] bool may_go_by_eights() const {
#ifdef NDTREE_HAS_EIGHTS
    const ScanView<D>& scan = measurements_->scan();
    return std::is_same_v<Sensor, BeamSensorModel> && Simd::width() >= 8 && !scan.origin_per_beam &&
           scan.range_sigma == nullptr && scan.size < std::numeric_limits<std::int32_t>::max() / D &&
           ends_nearby();
#else
    return false;
#endif
  }
  /// FreeMargin::growth, for noise that grows with the square of the range.
  [[nodiscard]] float margin_growth() const {
    const double range = (reach_.upper - reach_.lower).norm();
    const auto margin = [&](double r) {
      const double sigma = sensor_.sigma(r);
      return Sensor::kReachSigmas * sigma + r - sensor_.clearly_free_until(r, sigma) +
             ScanBeams<D>::kThinnestSurface * sigma;
    };
    return static_cast<float>(std::max(0.0, (margin(range) - margin(0.0)) / (range * range)));
  }
  /// Sets beams by number, from the first to before the last. @returns their noise.
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
    if constexpr (std::is_same_v<Sensor, BeamSensorModel>) {
      // Beams come in an order that is not that of the scan, of which the first cache does not hold all.
      constexpr std::size_t kAhead = 32;
      const ScanView<D>& scan = measurements_->scan();
      for (; by_eights && i + 8 <= last; i += 8) {
        if (i + kAhead + 8 <= last)
          for (std::size_t k = 0; k < 8; ++k)
            prefetch<D>(scan.endpoints + std::size_t{D} * kept[i + kAhead + k]);
        bool all_returned = true;
        for (std::size_t k = 0; k < 8; ++k)
          all_returned = all_returned && scan.is_returned(static_cast<Eigen::Index>(kept[i + k]));
        if (!all_returned || !beams_.set_eight(i, geometry, sensor_, *measurements_, kept + i, noise))
          for (std::size_t k = 0; k < 8; ++k) set(i + k);
      }
    }
#endif
    for (; i < last; ++i) set(i);
    return noise;
  }
  /// The faces of which some beams are kept; those of beams that are alone are one.
  /// @param numbers of each part's faces, in the image; then, in the result.
  std::vector<CubeFace<D>> number_faces(std::vector<std::vector<std::uint32_t>>& numbers) const {
    std::vector<std::uint32_t> kept(image_.faces().size(), 0);
    for (std::size_t p = 0; p < parts_.size(); ++p)
      for (std::size_t f = 0; f < numbers[p].size(); ++f) kept[numbers[p][f]] += parts_[p].kept_of_faces()[f];
    std::vector<CubeFace<D>> faces;
    faces.reserve(1 + kept.size());
    faces.emplace_back(Vector<D>::Zero(), 0, false);
    faces.front().num_beams = 1;
    std::vector<std::uint32_t> number(kept.size(), 0);
    for (std::size_t f = 0; f < kept.size(); ++f) {
      const CubeFace<D>& face = image_.faces()[f];
      if (kept[f] > 0 && !face.is_single()) {
        number[f] = static_cast<std::uint32_t>(faces.size());
        faces.push_back(face);
        for (const bool is_well_observed : {false, true})
          faces.back().depth_of_full_sample[is_well_observed] =
              face.depth_for(static_cast<float>(refinement_.model.sample_beams(is_well_observed)),
                             static_cast<float>(tree_.geometry().unit()));
      }
      faces[number[f]].end_of_beams += kept[f];
    }
    for (std::size_t f = 1; f < faces.size(); ++f) faces[f].end_of_beams += faces[f - 1].end_of_beams;
    for (auto& of_part : numbers)
      for (std::uint32_t& face : of_part) face = number[face];
    return faces;
  }

  /// Whether tasks, which all have their lists at the same time, take less than a gigabyte: a beam crosses at
  /// most so many planes between cells of the coarsest level, and one cell more.
  [[nodiscard]] bool lists_fit_in_memory() const {
    constexpr double kMost = 0x1p26;
    const double planes_per_metre = std::sqrt(D) / tree_.geometry().cell_size(coarsest_level());
    const auto n = static_cast<double>(beams_.size());
    const auto fit = [&](double ray) { return n * (1.0 + D) + ray * planes_per_metre < kMost; };
    if (fit(n * (reach_.upper - reach_.lower).norm())) return true;
    return fit(std::accumulate(beams_.rays(), beams_.rays() + beams_.size(), 0.0,
                               [](double sum, const BeamRay<D>& ray) { return sum + ray.t_max; }));
  }

  /// Arenas of threads, which the tree gets back whatever happens.
  class Arenas {
   public:
    struct alignas(kCacheLines) Lent {
      typename Tree::Arena arena;
    };

    Arenas(Tree& tree, std::size_t count) : tree_(tree), arenas_(count) {
      for (Lent& lent : arenas_) tree_.lend(lent.arena);
    }
    Arenas(const Arenas&) = delete;
    Arenas& operator=(const Arenas&) = delete;
    ~Arenas() {
      for (Lent& lent : arenas_) tree_.absorb(lent.arena);
    }
    [[nodiscard]] std::vector<Lent>& all() { return arenas_; }

   private:
    Tree& tree_;
    std::vector<Lent> arenas_;
  };

  [[nodiscard]] int coarsest_level() const {
    return Refinement::coarsest_level(tree_.geometry().finest_level());
  }

  void run_tasks(Workers& workers) {
    Arenas arenas(tree_, workers.count());
    std::vector<Walk> walks;
    walks.reserve(arenas.all().size());
    for (typename Arenas::Lent& lent : arenas.all())
      walks.emplace_back(tree_, lent.arena, refinement_, sensor_, beams_, log(1 + walks.size()), window_);
    ScanTasks<Tree, Walk>(tree_, arenas.all().front().arena, coarsest_level(), workers, walks, log(0))
        .run(beams_.size());
    for (const Walk& walk : walks) add(walk.counters());
  }

  /// One for what one thread does alone, then one for each.
  [[nodiscard]] UndoLog<Tree>* log(std::size_t number) const {
    return undo_ == nullptr ? nullptr : undo_->data() + number;
  }

  void add(const UpdateCounters& counters) {
    counters_.updates += counters.updates;
    counters_.splits += counters.splits;
    counters_.merges += counters.merges;
  }

  Tree& tree_;
  const Refinement& refinement_;
  const Sensor& sensor_;
  UpdateCounters& counters_;
  const Measurements<D, Sensor>* measurements_ = nullptr;
  std::vector<Part> parts_;  // Until the beams are chosen.
  Box<D> reach_;
  CubeMap<D> image_;
  ScanBeams<D> beams_;
  std::vector<UndoLog<Tree>>* undo_ = nullptr;
  const LatticeBox<D>* window_ = nullptr;
};

}  // namespace ndtree
