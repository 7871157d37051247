// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What moved: images of ranges against brute force, and evidence with any number of threads and of lanes.
#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstring>
#include <limits>
#include <string>
#include <vector>

#include "moved_answers.hpp"
#include "ndtree/core/random.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/evaluation/beam_image.hpp"
#include "ndtree/evaluation/moved.hpp"
#include "ndtree/evaluation/moved_posterior.hpp"
#include "ndtree/evaluation/range_pyramid.hpp"
#include "ndtree/evaluation/surface_cells.hpp"
#include "ndtree/logs/simulator.hpp"
#include "refusals.hpp"

namespace ndtree::test::test_moved {
namespace {

template <class Type>
class RangePyramidTest : public ::testing::Test {};
struct TwoD {
  static constexpr int kDim = 2;
};
struct ThreeD {
  static constexpr int kDim = 3;
};
using Dims = ::testing::Types<TwoD, ThreeD>;
TYPED_TEST_SUITE(RangePyramidTest, Dims);

template <int D>
Eigen::Matrix<float, D, 1> random_direction(ndtree::Random& random) {
  Eigen::Matrix<float, D, 1> way;
  do {
    for (int k = 0; k < D; ++k) way[k] = static_cast<float>(random.uniform(-1.0, 1.0));
  } while (way.norm() > 1.0F || way.norm() < 0.1F);
  return way.normalized();
}

TYPED_TEST(RangePyramidTest, NeverSaysMoreThanTheBeamsAroundAPoint) {
  constexpr int D = TypeParam::kDim;
  using Point = Eigen::Matrix<float, D, 1>;
  ndtree::Random random(801, D);
  int answers = 0;
  int hidden = 0;
  int at_edges = 0;
  for (int round = 0; round < 10; ++round) {
    const int beams = D == 2 ? 400 : 6000;
    RangePyramid<D> pyramid;
    const Point origin = Point::Constant(static_cast<float>(random.uniform(-5.0, 5.0)));
    BeamImage<D> image;
    std::vector<Point> directions;
    std::vector<float> sure;
    for (int i = 0; i < beams; ++i) {
      const Point way = random_direction<D>(random);
      if (round % 2 == 1 && way[0] < 0.2F) continue;  // A sensor with a field of view.
      directions.push_back(way);
      sure.push_back(static_cast<float>(random.uniform(3.0, 4.0)) + (way[1] > 0.0F ? 6.0F : 0.0F));
      image.add(way, sure.back());
    }
    image.build();
    pyramid.build(origin, image);
    for (int i = 0; i < 2000; ++i) {
      const float distance = static_cast<float>(random.uniform(1.5, 9.0));
      const float radius = static_cast<float>(random.uniform(0.02, 0.15));
      Point direction = random_direction<D>(random);
      if (i % 2 == 1) {  // Near an edge of the cube, where pixels of two faces do not line up.
        const int axis = random.uniform(0.0, 1.0) < 0.5 ? 0 : 1;
        direction[axis] = direction[(axis + 1) % D] * static_cast<float>(random.uniform(0.97, 1.03));
      }
      const Point point = origin + distance * direction.normalized();
      const Point way = (point - origin).normalized();
      float least = std::numeric_limits<float>::infinity();
      float most = 0.0F;
      for (std::size_t k = 0; k < directions.size(); ++k) {
        const float across = (directions[k] - directions[k].dot(way) * way).norm();
        if (directions[k].dot(way) > 0.0F && across * distance < 0.5F * radius)
          least = std::min(least, sure[k]);
        if (directions[k].dot(way) > 0.0F && across * distance < radius) most = std::max(most, sure[k]);
      }
      const float passed = pyramid.surely_passed(point, distance, radius, 0.0F);
      if (passed >= 0.0F) {
        ++answers;
        const Point sizes = way.cwiseAbs();
        for (int k = 0; k < D; ++k)
          at_edges += sizes[k] != sizes.maxCoeff() && sizes[k] > 0.95F * sizes.maxCoeff() ? 1 : 0;
        EXPECT_LE(passed, least) << "a beam within half the radius ends before";
        // No more is said with a larger least than with none.
        EXPECT_EQ(pyramid.surely_passed(point, distance, radius, passed), passed);
        EXPECT_LT(pyramid.surely_passed(point, distance, radius, passed + 0.01F), 0.0F);
      }
      if (pyramid.hides(point, radius, distance)) {
        ++hidden;
        EXPECT_LE(most, distance) << "a beam through the ball passed farther";
      }
      EXPECT_TRUE(round % 2 == 0 || way[0] > -0.3F || passed < 0.0F) << "no beam is there";
    }
  }
  EXPECT_GT(answers, 150);
  EXPECT_GT(at_edges, 300);
  EXPECT_GT(hidden, 30);
}

TEST(RangePyramid, ABeamAcrossAnEdgeOfTheCubeIsNotOverlooked) {
  // All beams pass but single ones, each near an edge of the cube: a point beside it, on the other face or
  // on the same, is not seen through. Beams are as dense as pixels are wide.
  using Point = Eigen::Matrix<float, 3, 1>;
  ndtree::Random random(805, 3);
  int asked = 0;
  int across = 0;
  for (int round = 0; round < 12; ++round) {
    BeamImage<3> image;
    for (int i = 0; i < 40'000; ++i) image.add(random_direction<3>(random), 10.0F);
    std::vector<Point> blocked;
    std::vector<int> edges;  // The axis that each one's edge is along.
    for (int i = 0; i < 200; ++i) {
      const int axis = static_cast<int>(random.uniform(0.0, 3.0)) % 3;
      Point way;
      way[axis] = random.uniform(0.0, 1.0) < 0.5 ? 1.0F : -1.0F;
      way[(axis + 1) % 3] = static_cast<float>(random.uniform(0.985, 1.015));
      way[(axis + 2) % 3] = static_cast<float>(random.uniform(-0.95, 0.95));
      blocked.push_back(way.normalized());
      edges.push_back((axis + 2) % 3);
      image.add(blocked.back(), 3.0F);
    }
    image.build();
    RangePyramid<3> pyramid;
    pyramid.build(Point::Zero(), image);
    for (std::size_t b = 0; b < blocked.size(); ++b)
      for (int i = 0; i < 250; ++i) {
        constexpr float kDistance = 5.0F;
        const Point& beam = blocked[b];
        const int along = edges[b];
        // As wide as a pixel: one on each side along the edge surrounds the point.
        const float depth = kDistance * beam.cwiseAbs().maxCoeff();
        const float radius = 1.9F * depth / static_cast<float>(image.side());
        Point aside = random_direction<3>(random) * 0.35F * radius;
        aside[along] = static_cast<float>(random.uniform(-0.92, 0.92)) * radius;
        const Point point = (kDistance * beam + aside).normalized() * kDistance;
        CubeFaces<3>::Place place;
        across += CubeFaces<3>::face_of(point, place) != CubeFaces<3>::face_of(beam, place) ? 1 : 0;
        const float passed = pyramid.surely_passed(point, kDistance, radius, 0.0F);
        if (passed < 0.0F) continue;
        ++asked;
        EXPECT_LE(passed, 3.0F) << point.transpose();
      }
  }
  EXPECT_GT(asked, 30'000);
  EXPECT_GT(across, 5'000);
}

/// Beams of columns and rows, in degrees; `range_of(direction)` tells how far each passed.
template <class RangeOf>
BeamImage<3> image_of(float column, int columns, float row, int rows, const RangeOf& range_of) {
  constexpr float kDegree = 0.0174532925F;
  BeamImage<3> image;
  for (int i = -columns; i <= columns; ++i)
    for (int j = -rows; j <= rows; ++j) {
      const float around = column * static_cast<float>(i) * kDegree;
      const float up = row * static_cast<float>(j) * kDegree;
      const BeamImage<3>::Point way(std::cos(around) * std::cos(up), std::sin(around) * std::cos(up),
                                    std::sin(up));
      image.add(way, range_of(way));
    }
  image.build();
  return image;
}

TEST(BeamImage, BeamsFarApartAreAskedOneByOne) {
  using Seen = BeamImage<3>::Seen;
  const BeamImage<3>::Point ahead =
      BeamImage<3>::Point(std::cos(0.035F), std::sin(0.035F), 0.0F);  // Between columns at 0 and 4 degrees.
  const auto all_pass = image_of(4.0F, 8, 0.35F, 40, [](const auto&) { return 9.0F; });
  EXPECT_EQ(all_pass.look(ahead, 0.03F, 2.9F, 3.1F), Seen::passed);
  EXPECT_EQ(all_pass.look(ahead, 0.03F, 8.9F, 9.1F), Seen::nothing) << "none within the radius";
  EXPECT_EQ(all_pass.look({1.0F, 0.0F, 0.0F}, 0.03F, 8.9F, 9.1F), Seen::end);
  EXPECT_EQ(all_pass.look({-1.0F, 0.0F, 0.0F}, 0.03F, 2.9F, 3.1F), Seen::nothing) << "no beam is there";
  const BeamImage<3>::Point beside(std::cos(0.6F), std::sin(0.6F), 0.0F);
  EXPECT_EQ(all_pass.look(beside, 0.03F, 2.9F, 3.1F), Seen::nothing) << "beside the last column";
  EXPECT_EQ(all_pass.look({std::cos(0.27F), 0.0F, std::sin(0.27F)}, 0.1F, 2.9F, 3.1F), Seen::beside)
      << "above the highest row, but with beams within the radius";
  // A wall that the column on one side meets at 3 m; the ground below, from 3 m on.
  const auto wall =
      image_of(4.0F, 8, 0.35F, 40, [](const auto& way) { return way[1] > 0.03F ? 3.0F : 9.0F; });
  EXPECT_EQ(wall.look(ahead, 0.01F, 2.9F, 3.1F), Seen::nothing);
  // The edge of a right angle at 3 m that points to the sensor, between two columns: both sides recede.
  const auto edge = image_of(4.0F, 8, 0.35F, 40, [&](const auto& way) {
    const float away = std::abs(way[1] * 3.0F - ahead[1] * 3.0F);
    return 3.0F + away;
  });
  EXPECT_EQ(edge.look(ahead, 0.01F, 2.95F, 3.02F), Seen::nothing);
}

TEST(BeamImage, GapsAroundADirectionAreAlongEachAxis) {
  constexpr float kDegree = 0.0174532925F;
  const BeamImage<3>::Offset wide{0.3F, 0.3F};
  const auto image = image_of(4.0F, 8, 0.5F, 30, [](const auto&) { return 9.0F; });
  const BeamImage<3>::Point ahead(std::cos(kDegree), std::sin(kDegree), 0.0F);  // Columns at 0 and 4 degrees.
  const auto both = image.beside(ahead, wide, {0.02F, 0.02F}, 8.0F, 0.001F);
  EXPECT_NEAR(both[0].nearest, kDegree, 1e-3F);
  EXPECT_NEAR(both[0].gap, 4.0F * kDegree, 1e-3F);
  EXPECT_NEAR(both[1].nearest, 0.0F, 1e-3F) << "a row at this height";
  const auto narrow = image.beside(ahead, wide, {0.01F, 0.01F}, 8.0F, 0.001F);
  EXPECT_GT(narrow[1].gap, 1.0F) << "no column is so near";
  EXPECT_NEAR(narrow[0].gap, 4.0F * kDegree, 1e-3F);
  EXPECT_GT(image.beside(ahead, wide, {0.02F, 0.02F}, 9.5F, 0.001F)[0].nearest, 1.0F) << "none passes";
  const auto near = image.beside({1.0F, 0.0F, 0.0F}, wide, {0.02F, 0.02F}, 8.0F, 0.001F);
  EXPECT_LT(near[0].nearest, 0.001F) << "through the middle";
  EXPECT_NEAR(near[0].gap, 4.0F * kDegree, 1e-3F) << "to the next one, on the other side";
}

TEST(BeamImage, BeamsFarApartDoNotTellOfOneSurface) {
  // Neighbours meet two rods of a row at the same range: 0.5 m apart that is no surface of 0.4 m.
  const auto coarse = [](float most) {
    auto image = image_of(15.0F, 3, 3.0F, 3, [](const auto&) { return 2.0F; });
    return image.size_of_surface(24, 0.1F, most)[0];
  };
  EXPECT_EQ(coarse(0.4F), 0.0F);
  EXPECT_GT(coarse(0.8F), 0.4F);
}

TEST(BeamImage, WhatEndsNowhereOrMayBeSomethingElseIsNoPartOfASurface) {
  // Beams in the plane: at `range`, and beside it `other`, which may end on nothing.
  const auto width = [](float apart, float range, float other, bool returned) {
    BeamImage<2> image;
    for (int i = -20; i <= 20; ++i) {
      const float angle = apart * static_cast<float>(i);
      image.add({std::cos(angle), std::sin(angle)},
                i == 0   ? range
                : i == 1 ? other
                         : 1.0F,
                i != 1 || returned);
    }
    image.build();
    return image.size_of_surface(20, 0.03F, 2.0F)[0];
  };
  EXPECT_GT(width(0.07F, 10.0F, 10.4F, true), 0.6F);
  EXPECT_EQ(width(0.07F, 10.0F, 10.4F, false), 0.0F) << "nothing returned there";
  EXPECT_EQ(width(0.07F, 10.0F, 11.0F, true), 0.0F) << "15 % of all ranges are as near";
  EXPECT_GT(width(0.01F, 10.0F, 10.19F, true), 0.0F) << "a slope of 63 degrees, where beams are dense";
  EXPECT_EQ(width(0.01F, 10.0F, 10.25F, true), 0.0F);
}

TEST(BeamImage, SurfacesAreAsWideAsNeighboursTellWhateverTheirSpacing) {
  // A wall at 2 m, a rod before it that one column meets; columns 2 degrees apart, rows 0.2. And turned, so
  // that some are behind a cube's edge.
  constexpr float kDegree = 0.0174532925F;
  for (const float turn : {0.0F, 44.0F, 90.0F}) {
    BeamImage<3> image;
    std::size_t on_rod = 0;
    std::size_t on_wall = 0;
    for (int column = -10; column <= 10; ++column)
      for (int row = -20; row <= 20; ++row) {
        const float around = (2.0F * static_cast<float>(column) + turn) * kDegree;
        const float up = 0.2F * static_cast<float>(row) * kDegree;
        if (column == 0 && row == 0) on_rod = image.beams().size();
        if (column == 5 && row == 0) on_wall = image.beams().size();
        image.add({std::cos(around) * std::cos(up), std::sin(around) * std::cos(up), std::sin(up)},
                  column == 0 ? 1.0F : 2.0F);
      }
    image.build();
    const auto wall = image.size_of_surface(on_wall, 0.02F, 0.8F);
    EXPECT_NEAR(wall[0], 2.0F * 9.5F * 2.0F * kDegree, 0.04F) << turn;
    EXPECT_GT(wall[1], 0.2F) << turn;
    EXPECT_EQ(image.size_of_surface(on_rod, 0.02F, 0.8F)[0], 0.0F) << turn;
    const auto place = image.beams()[on_wall].direction;
    EXPECT_TRUE(image.surely_meets(place, {2.1F * kDegree, 0.3F * kDegree}, {0.0F, 0.0F}, 1.5F)) << turn;
    const float between = (11.0F + turn) * kDegree;
    const BeamImage<3>::Point gap(std::cos(between), std::sin(between), 0.0F);
    EXPECT_TRUE(image.surely_meets(gap, {2.1F * kDegree, 0.3F * kDegree}, {0.0F, 0.0F}, 1.5F)) << turn;
    EXPECT_FALSE(image.surely_meets(gap, {1.5F * kDegree, 2.0F * kDegree}, {0.0F, 0.0F}, 1.5F))
        << "no column";
    EXPECT_FALSE(image.surely_meets(gap, {2.1F * kDegree, 0.3F * kDegree}, {0.0F, 0.0F}, 2.5F))
        << "none passes";
  }
}

TYPED_TEST(RangePyramidTest, CellsKeepTheirNumbers) {
  constexpr int D = TypeParam::kDim;
  ndtree::Random random(802, D);
  const Vector<D> origin = Vector<D>::Constant(1e6);
  CellNumbers<D> numbers(0.1, origin);
  typename CellNumbers<D>::Cursor cursor;
  std::vector<Vector<D>> points;
  std::vector<std::uint32_t> given;
  for (int i = 0; i < 3000; ++i) {
    Vector<D> point = origin;
    for (int k = 0; k < D; ++k) point[k] += random.uniform(-3.0, 3.0);
    points.push_back(point);
    given.push_back(numbers.put(point, cursor));
  }
  typename CellNumbers<D>::Cursor other;
  for (std::size_t i = 0; i < points.size(); ++i) {
    EXPECT_EQ(numbers.find(points[i], other), given[i]);
    for (int k = 0; k < D; ++k)
      EXPECT_EQ(numbers.cell(given[i])[k], static_cast<int>(std::floor((points[i][k] - origin[k]) / 0.1)));
  }
  EXPECT_EQ(numbers.find(origin + Vector<D>::Constant(50.0), other), CellNumbers<D>::kNone);
  EXPECT_EQ(numbers.put(Vector<D>::Constant(-1e9), cursor), CellNumbers<D>::kNone);
  std::vector<std::uint32_t> reversed(numbers.size());
  for (std::size_t i = 0; i < reversed.size(); ++i)
    reversed[i] = static_cast<std::uint32_t>(reversed.size() - 1 - i);
  numbers.renumber(reversed);
  for (std::size_t i = 0; i < points.size(); ++i)
    EXPECT_EQ(numbers.find(points[i], other), reversed[given[i]]);
}

TEST(Moved, ProbabilityIsThatOfBayes) {
  MovedOptions options;
  const MovedPosterior posterior(options);
  EXPECT_EQ(posterior(0U, 0U, 0U), 0.5F);
  const double e = options.error_rate;
  constexpr double kThin = 0.2;
  constexpr double kReturns = 0.15;
  int cases = 0;
  for (std::uint32_t v = 0; v < 7; ++v)
    for (std::uint32_t h = 0; h < 7; ++h) {
      // The mean likelihoods over all fractions below e, above, and between 0 and 1, by the middle rule, and
      // of all numbers of rows.
      double moved = 0.0;
      double stands = 0.0;
      double all = 0.0;
      constexpr int kSteps = 20000;
      for (int i = 0; i < kSteps; ++i) {
        const double q = (i + 0.5) / kSteps;
        const double large = e + (1.0 - e) * q;
        moved += std::pow(large, v) * std::pow(1.0 - large, h) / kSteps;
        stands += std::pow(e * q, v) * std::pow(1.0 - e * q, h) / kSteps;
        all += std::pow(q, v) * std::pow(1.0 - q, h) / kSteps;
      }
      for (std::uint32_t r = h == 0 ? 0 : 1; r <= std::min(h, v + 1); ++r, ++cases) {
        const double stays = h == 0 ? 1.0 : std::pow(kReturns, r - 1.0);
        const double likely = moved * stays;
        const double other = ((1.0 - kThin) * stands + kThin * all) / (h == 0 ? 1 : std::min(h, v + 1));
        EXPECT_NEAR(posterior(v, h, r), likely / (likely + other), 1e-4);
        EXPECT_TRUE(v > 0 || posterior(v, h, r) <= 0.5F);
      }
    }
  EXPECT_GT(cases, 100);
  for (const std::uint32_t h : {100U, 1000U, 100000U}) EXPECT_LT(posterior(0U, h, 1U), 0.5F) << h;
  EXPECT_GT(posterior(20000U, 20000U, 1U), 0.9F) << "numbers stay finite";
  MovedTally tally;
  tally.find();
  for (int i = 0; i < 9; ++i) posterior.pass(tally);
  EXPECT_GT(posterior(tally, -1e-3F), 0.8F);
  EXPECT_EQ(posterior(tally, 0.0F), 0.5F) << "no beam passed the place itself";
  EXPECT_EQ(posterior(tally, 50.0F), 0.5F) << "thin things may stand: it is not said that they do";
  tally.unsure = 3;
  EXPECT_EQ(posterior(tally, 50.0F), 0.5F) << "with beams too far apart, neither";
  EXPECT_GT(posterior(tally, -50.0F), 0.8F);
  for (int i = 0; i < options.most_scans - 1; ++i) tally.find();
  EXPECT_GT(posterior(tally, -50.0F), 0.5F);
  tally.find();
  EXPECT_EQ(posterior(tally, -50.0F), 0.5F) << "it came, and stands";
  posterior.pass(tally);
  EXPECT_GT(posterior(tally, -50.0F), 0.5F);
}

TEST(Moved, BeamsPassARodBesideAndAnEmptyPlaceAnywhere) {
  // A beam in the middle of a gap, in all places of it with the same probability: no odds on average, or
  // less.
  constexpr float kInfinite = std::numeric_limits<float>::infinity();
  for (const float gap : {0.03F, 0.1F, 0.3F}) {
    double sum = 0.0;
    constexpr int kPlaces = 1000;
    for (int i = 0; i < kPlaces; ++i) {
      const float left = gap * (static_cast<float>(i) + 0.5F) / kPlaces;
      sum += std::exp(MovedPosterior::odds_of_thin(std::min(left, gap - left), gap)) / kPlaces;
    }
    EXPECT_LT(sum, 1.01) << gap;
    EXPECT_GT(sum, 0.7) << gap;
    EXPECT_GT(MovedPosterior::odds_of_thin(0.5F * gap, gap), 0.0F);
    EXPECT_LT(MovedPosterior::odds_of_thin(0.0F, gap), 0.0F);
  }
  EXPECT_EQ(MovedPosterior::odds_of_thin(0.3F, kInfinite), 0.0F) << "at a border of the view";
}

TEST(Moved, ThreadsChangeNothing) {
  SimulationOptions simulation;
  simulation.scans = 4;
  simulation.people = 3;
  MovedOptions options;
  options.range_sigma = 0.02;
  const auto scans = scans_of(simulate_apartment(simulation));
  const std::vector<float> one = moved_answers(scans, options, 1);
  for (const std::size_t threads : {2u, 5u}) {
    const std::vector<float> many = moved_answers(scans, options, threads);
    ASSERT_EQ(one.size(), many.size());
    EXPECT_EQ(std::memcmp(one.data(), many.data(), one.size() * sizeof(float)), 0);
  }
}

TEST(Moved, NumbersAtATimeChangeNothing) {
  SimulationOptions simulation;
  simulation.people = 3;
  MovedOptions options;
  options.range_sigma = 0.02;
  options.place_sigma = 0.01;
  options.turn_sigma = 0.005;
  const auto compare = [&](const auto& log) {
    const auto scans = scans_of(log);
    Simd::limit(1);
    const std::vector<float> one = moved_answers(scans, options, 1);
    Simd::limit(Simd::kWidest);
    const std::vector<float> many = moved_answers(scans, options, 1);
    ASSERT_EQ(one.size(), many.size());
    EXPECT_GT(one.size(), 10'000U);
    EXPECT_EQ(std::memcmp(one.data(), many.data(), one.size() * sizeof(float)), 0);
  };
  simulation.scans = 40;
  compare(simulate_office(simulation));
  simulation.scans = 3;
  compare(simulate_apartment(simulation));
  compare(simulate_street(simulation, {32, 256}));
}

TEST(Moved, ScansWithoutBeamsAndWrongCalls) {
  MovedEvidence<2> evidence({});
  Scan<2> scan;
  scan.endpoints.resize(2, 0);
  scan.origins = Vector<2>(0.0, 0.0);
  evidence.add(scan.view());
  evidence.look(scan.view());
  float answer = 0.0F;
  const Vector<2> point(1.0, 2.0);
  evidence.probabilities(point.data(), 1, &answer);
  EXPECT_EQ(answer, 0.5F);
  EXPECT_THROW(evidence.add(scan.view()), std::invalid_argument) << "after look()";
  scan.endpoints.resize(2, 2);
  scan.endpoints << 1.0, 1e9, 1.0, 0.0;
  MovedEvidence<2> other({});
  EXPECT_THROW(other.add(scan.view()), std::invalid_argument) << "too far from the first";
  for (const char* name : {"cell_size", "range_sigma", "range_sigma_quadratic", "place_sigma", "turn_sigma",
                           "noise_sigmas", "error_rate"}) {
    MovedOptions options;
    const std::string wanted = name;
    (wanted == "cell_size"               ? options.cell_size
     : wanted == "range_sigma"           ? options.range_sigma
     : wanted == "range_sigma_quadratic" ? options.range_sigma_quadratic
     : wanted == "place_sigma"           ? options.place_sigma
     : wanted == "turn_sigma"            ? options.turn_sigma
     : wanted == "noise_sigmas"          ? options.noise_sigmas
                                         : options.error_rate) = -1.0;
    expect_refused([&] { const MovedEvidence<3> wrong(options); }, wanted);
  }
}

}  // namespace
}  // namespace ndtree::test::test_moved
