// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <map>
#include <set>
#include <vector>

#include "ndtree/core/linear_table.hpp"
#include "ndtree/mapping/scan_index.hpp"
#include "random.hpp"

namespace ndtree::test {
namespace {

template <int D>
struct Found {
  double t_enter, t_exit;
};

/// Beams with what they are recognised by, their end, numbered.
template <int D>
struct Beams {
  std::vector<ScanBeam<D>> all;
  std::vector<Vector<D>> origins;
  std::map<std::int64_t, float> chance;           // By number.
  std::map<std::int64_t, std::uint32_t> face_of;  // By number; for beams from one place.
  std::map<std::array<int, 2>, std::uint32_t> faces;
  ScanIndex<D> index;

  void add(const Vector<D>& origin, const Vector<D>& path, bool returned, double t_end, double t_free,
           double t_surface) {
    ScanBeam<D> beam;
    beam.path = path;
    beam.range = path.norm();
    beam.sigma = 0.01;
    beam.t_end = t_end;
    beam.t_clearly_free = t_free;
    beam.t_surface = t_surface;
    for (int a = 0; a < D; ++a)
      beam.end[static_cast<std::size_t>(a)] =
          static_cast<std::int64_t>(std::floor((origin[a] + path[a]) / 0.125));
    beam.end[0] = beam.end[0] * 100000 + static_cast<std::int64_t>(all.size());  // Its number, too.
    beam.returned = returned;
    beam.chance = chance_of<D>(origin + path);
    chance[beam.end[0]] = beam.chance;
    int axis = 0;
    for (int a = 1; a < D; ++a)
      if (std::abs(path[a]) > std::abs(path[axis])) axis = a;
    const auto next = static_cast<std::uint32_t>(faces.size());  // Numbered as they first appear.
    face_of[beam.end[0]] = faces.emplace(std::array<int, 2>{axis, path[axis] < 0.0}, next).first->second;
    all.push_back(beam);
    origins.push_back(origin);
  }

  /// As so many threads do it, each with beams that follow each other.
  void sort(const typename ScanIndex<D>::Sampling& sampling, std::size_t threads) {
    Workers workers(threads);
    index.begin(threads, all.size() / threads + 1);
    workers.for_each_task(threads, [&](std::size_t, std::size_t part) {
      for (std::size_t i = all.size() * part / threads; i < all.size() * (part + 1) / threads; ++i)
        index.part(part).add(origins[i], all[i].path, all[i].t_end, all[i].sigma, all[i].chance,
                             static_cast<std::uint32_t>(i));
    });
    index.sort(
        sampling, workers, [&](std::uint32_t number) { return all.at(number).path; },
        [&](std::uint32_t number) { return all.at(number); });
    EXPECT_EQ(index.num_beams(), all.size());
  }
};

/// One origin or several; everywhere, in a cone, in a plane, or on a grid of exact numbers.
template <int D>
void add_random_beams(Random& random, int kind, int count, Beams<D>& beams) {
  const bool exact = kind % 2 == 1;
  const auto place = [&](double x) { return exact ? std::round(4.0 * x) / 4.0 : x; };
  std::vector<Vector<D>> origins;
  for (int i = 0; i < (kind < 4 ? 1 : kind == 7 ? 300 : 5); ++i) {
    Vector<D> origin;
    for (int a = 0; a < D; ++a) origin[a] = place(random.uniform(-1.0, 1.0));
    origins.push_back(origin);
  }
  for (int i = 0; i < count; ++i) {
    Vector<D> path;
    for (int a = 0; a < D; ++a) path[a] = place(random.uniform(-3.0, 3.0));
    if (kind % 4 >= 2) path[0] *= 4.0;  // Mostly along one axis.
    if (exact && random.chance(0.3)) path[random.integer(0, D - 1)] = 0.0;
    if (!(path.norm() > 0.0)) path[0] = 1.0;
    const bool returned = random.chance(0.8);
    beams.add(origins[static_cast<std::size_t>(random.integer(0, static_cast<int>(origins.size()) - 1))],
              path, returned, returned ? 1.0 + random.uniform(0.0, 0.2) : 0.7,
              returned ? random.uniform(0.8, 1.0) : 0.7, returned ? random.uniform(0.0, 0.1) : 0.0);
  }
  beams.sort({1e9, 0.1, 1.0}, static_cast<std::size_t>(random.integer(1, 3)));
}

template <int D>
void finds_what_crosses_each_box(std::uint64_t seed) {
  Random random(seed);
  SCOPED_TRACE(random.trace());
  std::size_t crossings = 0;
  std::size_t taken = 0;
  int passed = 0;
  int unseen = 0;
  int without_end = 0;
  for (int kind = 0; kind < 8; ++kind) {
    Beams<D> beams;
    add_random_beams(random, kind, kind == 6 ? 1 : 300, beams);
    for (int i = 0; i < 200; ++i) {
      const double size = 0.25 * std::pow(2.0, random.integer(-2, 4));
      Box<D> box;
      for (int a = 0; a < D; ++a)
        box.lower[a] = kind % 2 == 1 ? 0.25 * random.integer(-14, 14) : random.uniform(-3.5, 3.5);
      box.upper = box.lower.array() + size;

      std::map<std::int64_t, Found<D>> expected;
      for (std::size_t b = 0; b < beams.all.size(); ++b) {
        const ScanBeam<D>& beam = beams.all[b];
        const Vector<D>& origin = beams.origins[b];
        double t_enter = 0.0;
        double t_exit = beam.t_end;
        if (clip_to_box<D>(box.lower - origin, box.upper - origin, beam.path, t_enter, t_exit))
          expected[beam.end[0]] = {t_enter, t_exit};
      }
      std::size_t found = 0;
      for (std::uint32_t face = 0; face < beams.index.num_faces(); ++face) {
        typename ScanIndex<D>::View view;
        if (!beams.index.look(face, box, view)) {
          ++unseen;
          continue;
        }
        std::set<std::int64_t> ends;
        std::set<std::int64_t> crossing_here;
        beams.index.for_each_crossing(view, box, [&](const Crossing<D>* crossing, std::size_t n) {
          for (std::size_t k = 0; k < n; ++k) {
            const auto match = expected.find(crossing[k].beam->end[0]);
            EXPECT_NE(match, expected.end()) << "a beam that does not cross the box";
            if (match == expected.end()) continue;
            EXPECT_NEAR(crossing[k].t_enter, match->second.t_enter, 1e-12);
            EXPECT_NEAR(crossing[k].t_exit, match->second.t_exit, 1e-12);
            EXPECT_EQ(crossing[k].t_enter >= 1.0, match->second.t_enter >= 1.0);
            EXPECT_EQ(crossing[k].t_exit >= 1.0, match->second.t_exit >= 1.0);
            EXPECT_TRUE(!view.all_pass || match->second.t_exit <
                                              crossing[k].beam->t_clearly_free - crossing[k].beam->t_surface);
            const bool ends_inside =
                crossing[k].beam->returned && match->second.t_enter < 1.0 && match->second.t_exit > 1.0;
            EXPECT_TRUE(!view.no_end || !ends_inside);
            if (ends_inside) ends.insert(crossing[k].beam->end[0]);
            crossing_here.insert(crossing[k].beam->end[0]);
            ++found;
          }
          return true;
        });
        passed += view.all_pass;
        without_end += view.no_end;
        std::set<std::int64_t> found_ends;
        beams.index.for_each_end(view, box, [&](const ScanBeam<D>& beam) {
          EXPECT_TRUE(beam.returned);
          EXPECT_TRUE(found_ends.insert(beam.end[0]).second) << "visited twice";
          return true;
        });
        EXPECT_TRUE(std::includes(found_ends.begin(), found_ends.end(), ends.begin(), ends.end()));
        int visited = 0;
        beams.index.for_each_end(view, box, [&](const ScanBeam<D>&) { return ++visited < 2; });
        EXPECT_EQ(visited, std::min<int>(2, static_cast<int>(found_ends.size())));
        // A sample has all beams of a smaller chance in it that the whole has, once.
        const double share = random.uniform(0.0, 0.6);
        std::map<std::int64_t, int> in_sample;
        beams.index.for_each_crossing(
            view, box,
            [&](const Crossing<D>* crossing, std::size_t n) {
              for (std::size_t k = 0; k < n; ++k) {
                ++in_sample[crossing[k].beam->end[0]];
                ++taken;
              }
              return true;
            },
            share);
        for (const auto& [number, times] : in_sample) {
          EXPECT_EQ(times, 1);
          EXPECT_EQ(crossing_here.count(number), 1u);
        }
        for (const std::int64_t number : crossing_here)
          if (static_cast<double>(beams.chance.at(number)) < share) {
            EXPECT_EQ(in_sample.count(number), 1u);
          }
      }
      EXPECT_EQ(found, expected.size());
      crossings += found;
      if (::testing::Test::HasFailure()) return;
    }
  }
  EXPECT_GT(crossings, 2000u);
  EXPECT_GT(taken, crossings / 5);
  if (D > 1) {
    EXPECT_LT(taken, crossings);
  }
  EXPECT_GT(passed, 50);
  EXPECT_GT(without_end, passed);
  EXPECT_GT(unseen, 50);
}

/// Of beams that are denser than cells need, those that no cell of some size takes are not kept; but all that
/// one does.
template <int D>
void keeps_what_some_cell_takes(std::uint64_t seed) {
  Random random(seed);
  SCOPED_TRACE(random.trace());
  int taken = 0;
  int left_out = 0;
  for (const double beams_of_a_cell : {0.02, 0.3, 2.0}) {
    constexpr double kSmallest = 0.25;
    constexpr double kLargest = 1.0;
    Beams<D> beams;
    const Vector<D> origin = Vector<D>::Constant(0.03);
    for (int i = 0; i < 2000; ++i) {
      Vector<D> path;
      for (int a = 0; a < D; ++a) path[a] = random.uniform(-1.0, 1.0);
      path[0] = random.uniform(0.5, 5.0);
      beams.add(origin, path, true, 1.05, 0.9, 0.02);
    }
    beams.sort({beams_of_a_cell, kSmallest, kLargest}, static_cast<std::size_t>(random.integer(1, 3)));
    for (int i = 0; i < 300; ++i) {
      const double size = kSmallest * std::pow(2.0, random.integer(0, 2));
      Box<D> cell;
      for (int a = 0; a < D; ++a) cell.lower[a] = size * std::floor(random.uniform(-2.0, 6.0) / size);
      cell.upper = cell.lower.array() + size;
      std::set<std::int64_t> found;
      for (std::uint32_t face = 0; face < beams.index.num_faces(); ++face) {
        typename ScanIndex<D>::View view;
        if (!beams.index.look(face, cell, view)) continue;
        beams.index.for_each_crossing(view, cell, [&](const Crossing<D>* crossing, std::size_t n) {
          for (std::size_t k = 0; k < n; ++k) found.insert(crossing[k].beam->end[0]);
          return true;
        });
      }
      for (const ScanBeam<D>& beam : beams.all) {
        double t_enter = 0.0;
        double t_exit = beam.t_end;
        if (!clip_to_box<D>(cell.lower - origin, cell.upper - origin, beam.path, t_enter, t_exit)) continue;
        const std::uint32_t face = beams.face_of.at(beam.end[0]);
        const bool is_taken =
            static_cast<double>(beam.chance) * beams.index.expected_beams(face, cell, kSmallest) <
            beams_of_a_cell;
        if (is_taken) {
          EXPECT_EQ(found.count(beam.end[0]), 1u);
        }
        taken += is_taken;
        left_out += found.count(beam.end[0]) == 0;
      }
      if (::testing::Test::HasFailure()) return;
    }
  }
  EXPECT_GT(taken, 100);
  if (D > 1) {
    EXPECT_GT(left_out, D == 4 ? 20 : 1000);
  }
}

TEST(ScanIndex, KeepsWhatSomeCellTakes) {
  keeps_what_some_cell_takes<1>(166);
  keeps_what_some_cell_takes<2>(167);
  keeps_what_some_cell_takes<3>(168);
  keeps_what_some_cell_takes<4>(169);
}

TEST(ScanIndex, FindsWhatCrossesEachBox) {
  finds_what_crosses_each_box<1>(160);
  finds_what_crosses_each_box<2>(161);
  finds_what_crosses_each_box<3>(162);
  finds_what_crosses_each_box<4>(163);
}

TEST(ScanIndex, StopsWhenToldTo) {
  Random random(164);
  Beams<2> beams;
  add_random_beams(random, 0, 500, beams);
  const Box<2> box{Vector<2>::Constant(-4.0), Vector<2>::Constant(4.0)};
  int visits = 0;
  int faces = 0;
  for (std::uint32_t face = 0; face < beams.index.num_faces(); ++face) {
    ScanIndex<2>::View view;
    ASSERT_TRUE(beams.index.look(face, box, view));
    ++faces;
    EXPECT_FALSE(beams.index.for_each_crossing(view, box, [&](const Crossing<2>*, std::size_t n) {
      ++visits;
      EXPECT_LE(n, ScanIndex<2>::kBatch);
      return false;
    }));
  }
  EXPECT_EQ(faces, 4);
  EXPECT_EQ(visits, faces);
}

TEST(LinearTable, IsWithinItsErrorAndMonotone) {
  int places = 0;
  double last = 0.0;
  for (double x = -7.0; x < 7.0; x += 0.0037, ++places) {
    const double value = normal_cdf_table()(x);
    ASSERT_NEAR(value, normal_cdf(x), 1e-6) << x;
    ASSERT_GE(value, last);
    last = value;
  }
  EXPECT_GT(places, 3000);
  const LinearTable<4> line(-1.0, 3.0, [](double x) { return 2.0 * x + 1.0; });
  for (const double x : {-1.0, -0.3, 0.0, 1.7, 3.0}) EXPECT_NEAR(line(x), 2.0 * x + 1.0, 1e-6) << x;
  EXPECT_EQ(line(-100.0), -1.0);
  EXPECT_EQ(line(100.0), 7.0);
  EXPECT_EQ(line(std::nan("")), -1.0);
}

TEST(ScanIndex, AChanceSaysNothingAboutWhatABeamMeasured) {
  Random random(165);
  SCOPED_TRACE(random.trace());
  constexpr int kClasses = 16;
  // Of end points that a sensor gives: single precision, or of 1 mm, near each other; by their range.
  for (const double step : {0.0, 0.001}) {
    int count[2][kClasses] = {};
    constexpr int kBeams = 40000;
    for (int i = 0; i < kBeams; ++i) {
      const double angle = 1e-4 * i;
      double range = 2.0 + 0.01 * random.uniform();
      const bool is_near = range < 2.005;
      if (step > 0.0) range = std::round(range / step) * step;
      Vector<3> end(range * std::cos(angle), range * std::sin(angle), 0.3);
      if (step == 0.0) end = end.cast<float>().cast<double>();
      const float chance = chance_of<3>(end);
      ASSERT_GE(chance, 0.0f);
      ASSERT_LT(chance, 1.0f);
      ++count[is_near][static_cast<int>(chance * kClasses)];
    }
    for (const auto& row : count) {
      double sum = 0.0;
      for (const int n : row) sum += n;
      double chi_square = 0.0;
      for (const int n : row) chi_square += std::pow(n - sum / kClasses, 2) / (sum / kClasses);
      EXPECT_LT(chi_square, 44.0) << "15 degrees of freedom: one in ten thousand is larger";
    }
  }
  EXPECT_EQ(chance_of<2>(Vector<2>(0.1, 0.2)), chance_of<2>(Vector<2>(0.1, 0.2)));
  EXPECT_NE(chance_of<2>(Vector<2>(0.1, 0.2)), chance_of<2>(Vector<2>(0.2, 0.1)));
}

}  // namespace
}  // namespace ndtree::test
