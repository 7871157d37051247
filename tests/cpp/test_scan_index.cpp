// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <algorithm>
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
  std::map<std::int64_t, float> chance;  // By number.
  ScanIndex<D> index;

  void add(const Vector<D>& origin, const Vector<D>& path, bool returned, double t_end, double t_free,
           double t_surface) {
    ScanBeam<D> beam;
    beam.path = path;
    beam.origin = origin;
    beam.range = path.norm();
    beam.sigma = 0.01;
    beam.range_in_sigmas = beam.range / beam.sigma;
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
    all.push_back(beam);
    index.add(origin, beam);
  }
};

/// One origin or several; everywhere, in a cone, in a plane, or on a grid of exact numbers.
template <int D>
Beams<D> random_beams(Random& random, int kind, int count) {
  Beams<D> beams;
  const bool exact = kind % 2 == 1;
  const auto place = [&](double x) { return exact ? std::round(4.0 * x) / 4.0 : x; };
  std::vector<Vector<D>> origins;
  for (int i = 0; i < (kind < 4 ? 1 : 5); ++i) {
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
  beams.index.sort();
  return beams;
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
    const Beams<D> beams = random_beams<D>(random, kind, kind == 6 ? 1 : 300);
    for (int i = 0; i < 200; ++i) {
      const double size = 0.25 * std::pow(2.0, random.integer(-2, 4));
      Box<D> box;
      for (int a = 0; a < D; ++a)
        box.lower[a] = kind % 2 == 1 ? 0.25 * random.integer(-14, 14) : random.uniform(-3.5, 3.5);
      box.upper = box.lower.array() + size;

      std::map<std::int64_t, Found<D>> expected;
      for (const auto& beam : beams.all) {
        double t_enter = 0.0;
        double t_exit = beam.t_end;
        if (clip_to_box<D>(box.lower - beam.origin, box.upper - beam.origin, beam.path, t_enter, t_exit))
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
        // All ends inside, and no more than those of other beams that look there, too.
        std::set<std::int64_t> found_ends;
        beams.index.for_each_end(
            view, box, [&](const auto& end) { return found_ends.insert(end[0]).second; },
            [] { return true; });
        EXPECT_TRUE(std::includes(found_ends.begin(), found_ends.end(), ends.begin(), ends.end()));
        int visited = 0;
        beams.index.for_each_end(
            view, box, [](const auto&) { return true; }, [&] { return ++visited < 2; });
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

TEST(ScanIndex, FindsWhatCrossesEachBox) {
  finds_what_crosses_each_box<1>(160);
  finds_what_crosses_each_box<2>(161);
  finds_what_crosses_each_box<3>(162);
  finds_what_crosses_each_box<4>(163);
}

TEST(ScanIndex, StopsWhenToldTo) {
  Random random(164);
  const Beams<2> beams = random_beams<2>(random, 0, 500);
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

}  // namespace
}  // namespace ndtree::test
