// SPDX-License-Identifier: BSD-3-Clause
// What scans saw: against every beam looked at, on fans whose view is known, and in a world with a ball.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <optional>
#include <stdexcept>
#include <type_traits>
#include <utility>
#include <vector>

#include "ndtree/evaluation/claims.hpp"
#include "options.hpp"
#include "random.hpp"
#include "refusals.hpp"
#include "shapes.hpp"

namespace elsewhere {

/// A map of another house: on the x axis unknown, then free from 0, then occupied from 1, then unknown again
/// from 2.
struct Stripes {};

ndtree::CellState state(const Stripes&, const ndtree::Vector<2>& point) {
  return point.x() < 0.0 || point.x() >= 2.0 ? ndtree::CellState::unknown
         : point.x() < 1.0                   ? ndtree::CellState::free
                                             : ndtree::CellState::occupied;
}

}  // namespace elsewhere

namespace ndtree::test::test_claims {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kDegree = 3.14159265358979324 / 180.0;

template <int D>
std::vector<ScanView<D>> views(const std::vector<Scan<D>>& scans) {
  std::vector<ScanView<D>> result;
  for (const Scan<D>& scan : scans) result.push_back(scan.view());
  return result;
}

/// The beams of a scan from one origin.
template <int D>
struct Lookout {
  Vector<D> origin;
  std::vector<Vector<D>> directions;
  std::vector<double> lengths;
  std::vector<bool> returned;
  double spacing = 0.0;  // The median.
};

/// All lookouts of a log but those with one beam.
template <int D>
std::vector<Lookout<D>> lookouts(const std::vector<Scan<D>>& scans) {
  std::vector<Lookout<D>> result;
  for (const Scan<D>& scan : scans) {
    std::vector<Lookout<D>> of_scan;
    for (Eigen::Index i = 0; i < scan.size(); ++i) {
      const Vector<D> origin = scan.origins.col(scan.origins.cols() == 1 ? 0 : i);
      const Vector<D> way = scan.endpoints.col(i) - origin;
      if (!(way.norm() > 0.0)) continue;  // Also where it is not a number.
      auto own = std::find_if(of_scan.begin(), of_scan.end(),
                              [&](const Lookout<D>& other) { return other.origin == origin; });
      if (own == of_scan.end()) own = of_scan.insert(of_scan.end(), Lookout<D>{origin, {}, {}, {}, 0.0});
      own->directions.push_back(way / way.norm());
      own->lengths.push_back(way.norm());
      own->returned.push_back(scan.returned.size() == 0 || scan.returned[i]);
    }
    for (Lookout<D>& lookout : of_scan) {
      const std::size_t n = lookout.directions.size();
      if (n < 2) continue;
      std::vector<double> spacings(n, HUGE_VAL);
      for (std::size_t i = 0; i < n; ++i)
        for (std::size_t k = 0; k < n; ++k)
          if (k != i)
            spacings[i] = std::min(spacings[i], (lookout.directions[i] - lookout.directions[k]).norm());
      std::sort(spacings.begin(), spacings.end());
      lookout.spacing = (spacings[(n - 1) / 2] + spacings[n / 2]) / 2.0;
      result.push_back(lookout);
    }
  }
  return result;
}

/// Whether a point is seen: every beam is looked at, as the text of the measure has it.
/// @param is_open whether the world lets through from an origin to a point; none: the beams say.
template <int D, class IsOpen = std::nullptr_t>
bool sees(const Lookout<D>& from, const Vector<D>& point, double max_range, const ClaimsOptions& options,
          const IsOpen& is_open = nullptr) {
  const double distance = (point - from.origin).norm();
  std::size_t nearest = 0;
  double angle = HUGE_VAL;
  for (std::size_t i = 0; i < from.directions.size(); ++i) {
    const double other = (from.directions[i] - (point - from.origin) / distance).norm();
    if (other < angle) nearest = i;
    angle = std::min(angle, other);
  }
  if (angle > options.spacings * from.spacing) return false;
  const double length = from.lengths[nearest];
  if constexpr (!std::is_same_v<IsOpen, std::nullptr_t>)
    return distance <= max_range && is_open(from.origin, point);
  else if (length > max_range || !from.returned[nearest])
    return distance <= std::min(length, max_range);
  else
    return distance - options.tolerance <= length;
}

/// Scans of beams all around or in a part of the view, of which some did not return, some are invalid, and
/// the longest are beyond 3 m; some scans have three origins, some but one beam.
template <int D>
std::vector<Scan<D>> random_log(test::Random& random) {
  std::vector<Scan<D>> scans(12);
  for (std::size_t s = 0; s < scans.size(); ++s) {
    Scan<D>& scan = scans[s];
    const int n = s == 0 ? 1 : s == 1 ? 0 : random.integer(2, 90);
    const bool own_origins = s % 3 == 2;
    Points<D> origins(D, 3);
    for (Eigen::Index i = 0; i < origins.size(); ++i) origins.data()[i] = random.uniform(-1.0, 1.0);
    scan.endpoints.resize(D, n);
    scan.origins.resize(D, own_origins ? n : 1);
    scan.origins.col(0).setZero();
    if (s % 4 != 0) scan.returned.setConstant(n, true);
    if (!own_origins) scan.origins = origins.col(0);
    for (Eigen::Index i = 0; i < n; ++i) {
      Vector<D> way;
      for (int a = 0; a < D; ++a) way[a] = random.uniform(-1.0, 1.0);
      if (s % 2 == 0) way[0] = std::abs(way[0]) + 1.0;
      const Vector<D> origin = origins.col(own_origins ? random.integer(0, 2) : 0);
      if (own_origins) scan.origins.col(i) = origin;
      scan.endpoints.col(i) = origin + random.uniform(0.5, 3.5) / way.norm() * way;
      if (random.chance(0.1)) scan.endpoints.col(i) = origin;
      if (random.chance(0.1)) scan.endpoints(0, i) = kNan;
      if (scan.returned.size() != 0) scan.returned[i] = random.chance(0.7);
    }
  }
  return scans;
}

template <class Shape>
class SeenSpaceOf : public ::testing::Test {};
TYPED_TEST_SUITE(SeenSpaceOf, test::TwoShapes, test::ShapeNames);

TYPED_TEST(SeenSpaceOf, EveryBeamLookedAtSaysTheSame) {
  constexpr int D = TypeParam::kDim;
  test::Random random(83);
  int seen = 0;
  int unseen = 0;
  for (int log = 0; log < 6; ++log) {
    const std::vector<Scan<D>> scans = random_log<D>(random);
    ClaimsOptions options;
    options.samples = 300;
    options.seed = static_cast<std::uint64_t>(log);
    options.spacings = log % 2 == 0 ? 1.5 : 0.7;
    options.tolerance = log % 3 == 0 ? 0.5 : 0.1;
    const double max_range = log == 5 ? kUnlimitedRange : 3.0;
    const SeenSpace<D> space(views(scans), max_range, options);
    const std::vector<Lookout<D>> all = lookouts(scans);
    ASSERT_EQ(space.points().cols(), 300);
    ASSERT_EQ(space.seen().size(), 300);
    for (Eigen::Index i = 0; i < 300; ++i) {
      const Vector<D> point = space.points().col(i);
      const bool expected = std::any_of(all.begin(), all.end(), [&](const Lookout<D>& from) {
        return sees<D>(from, point, max_range, options);
      });
      ASSERT_EQ(space.seen()[i], expected) << "log " << log << ", point " << point.transpose();
      ++(expected ? seen : unseen);
    }
  }
  EXPECT_GT(seen, 150);
  EXPECT_GT(unseen, 100);
}

/// A solid ball, and nothing else.
template <int D>
struct Ball {
  Vector<D> center;
  double radius;

  [[nodiscard]] std::optional<double> distance(const Vector<D>& origin, const Vector<D>& direction,
                                               double max_range) const {
    const double along = (center - origin).dot(direction);
    const double chord = along * along - (center - origin).squaredNorm() + radius * radius;
    if (chord < 0.0 || along - std::sqrt(chord) < 0.0 || along - std::sqrt(chord) > max_range)
      return std::nullopt;
    return along - std::sqrt(chord);
  }
};

TYPED_TEST(SeenSpaceOf, WhereTheWorldIsKnownItSaysWhatIsBetween) {
  constexpr int D = TypeParam::kDim;
  test::Random random(84);
  int seen = 0;
  int hidden = 0;
  for (int log = 0; log < 6; ++log) {
    const std::vector<Scan<D>> scans = random_log<D>(random);
    ClaimsOptions options;
    options.samples = 300;
    options.spacings = 4.0;
    const Ball<D> ball{Vector<D>::Constant(1.5), 0.45 * std::sqrt(D)};  // No origin is inside.
    const SeenSpace<D> space(views(scans), 3.0, options, ball);
    // Nothing is between if no point of the way, without its last 0.1 m, is in the ball.
    const auto is_open = [&](const Vector<D>& origin, const Vector<D>& point) {
      const double length = (point - origin).norm();
      if (length <= 0.1) return true;
      const Vector<D> end = origin + (1.0 - 0.1 / length) * (point - origin);
      const double along = (ball.center - origin).dot(end - origin) / (end - origin).squaredNorm();
      const Vector<D> nearest = origin + std::clamp(along, 0.0, 1.0) * (end - origin);
      return (nearest - ball.center).norm() > ball.radius;
    };
    const auto lets_all_through = [](const Vector<D>&, const Vector<D>&) { return true; };
    const std::vector<Lookout<D>> all = lookouts(scans);
    for (Eigen::Index i = 0; i < 300; ++i) {
      const Vector<D> point = space.points().col(i);
      const auto is_seen = [&](const auto& open) {
        return std::any_of(all.begin(), all.end(),
                           [&](const Lookout<D>& from) { return sees<D>(from, point, 3.0, options, open); });
      };
      ASSERT_EQ(space.seen()[i], is_seen(is_open)) << "log " << log << ", point " << point.transpose();
      seen += space.seen()[i];
      hidden += !space.seen()[i] && is_seen(lets_all_through);
    }
  }
  EXPECT_GT(seen, 200);
  EXPECT_GT(hidden, 5);
}

TYPED_TEST(SeenSpaceOf, BoxHoldsTheMiddleOfTheEndPoints) {
  constexpr int D = TypeParam::kDim;
  test::Random random(85);
  const std::vector<Scan<D>> scans = random_log<D>(random);
  for (const double middle : {1.0, 0.98, 0.5}) {
    for (const double max_range : {kUnlimitedRange, 2.0}) {
      ClaimsOptions options;
      options.middle = middle;
      options.margin = 0.25;
      options.samples = 2000;
      const SeenSpace<D> space(views(scans), max_range, options);
      ASSERT_TRUE(space.box().has_value());
      for (int a = 0; a < D; ++a) {
        std::vector<double> ends;
        for (const Scan<D>& scan : scans)
          for (Eigen::Index i = 0; i < scan.size(); ++i) {
            const Vector<D> origin = scan.origins.col(scan.origins.cols() == 1 ? 0 : i);
            const Vector<D> way = scan.endpoints.col(i) - origin;
            const double length = way.norm();
            if (length > 0.0) ends.push_back(origin[a] + std::min(1.0, max_range / length) * way[a]);
          }
        std::sort(ends.begin(), ends.end());
        const auto at = [&](double share) {
          const double place = share * static_cast<double>(ends.size() - 1);
          const auto below = static_cast<std::size_t>(place);
          const std::size_t above = std::min(below + 1, ends.size() - 1);
          const double part = place - static_cast<double>(below);
          return (1.0 - part) * ends[below] + part * ends[above];
        };
        const double lower = at((1.0 - middle) / 2.0) - 0.25;
        const double upper = at((1.0 + middle) / 2.0) + 0.25;
        EXPECT_NEAR(space.box()->lower[a], lower, 1e-9);
        EXPECT_NEAR(space.box()->upper[a], upper, 1e-9);
        const auto row = space.points().row(a).array();
        EXPECT_GE(row.minCoeff(), space.box()->lower[a]);
        EXPECT_LT(row.maxCoeff(), space.box()->upper[a]);
        // Uniform: the mean of 2000 is within five standard errors.
        EXPECT_NEAR(row.mean(), 0.5 * (lower + upper), 5.0 * (upper - lower) / std::sqrt(12.0 * 2000.0));
        EXPECT_GT((row < lower + 0.1 * (upper - lower)).count(), 130);
        EXPECT_GT((row > upper - 0.1 * (upper - lower)).count(), 130);
      }
    }
  }
}

/// A beam every degree from `first` to `last` [degrees], all `range` long, from the origin.
Scan<2> fan(int first, int last, double range) {
  Scan<2> scan;
  scan.origins = Vector<2>(0.0, 0.0);
  scan.endpoints.resize(2, last - first + 1);
  for (int i = first; i <= last; ++i)
    scan.endpoints.col(i - first) << range * std::cos(i * kDegree), range * std::sin(i * kDegree);
  return scan;
}

TEST(SeenSpace, WithoutABeamThereIsNothingToAsk) {
  Scan<2> invalid = fan(0, 3, 1.0);
  invalid.endpoints.setConstant(kNan);
  const std::vector<std::vector<Scan<2>>> logs{
      {}, {Scan<2>{Points<2>(2, 0), Points<2>(2, 0), {}, 0.0, {}}}, {invalid}};
  for (const auto& scans : logs) {
    const SeenSpace<2> space(views(scans), kUnlimitedRange);
    EXPECT_FALSE(space.box().has_value());
    EXPECT_EQ(space.points().cols(), 0);
    EXPECT_EQ(space.seen().size(), 0);
    const Claims found = claims(elsewhere::Stripes{}, space);
    EXPECT_EQ(found.points, 0u);
    EXPECT_EQ(found.free_unseen(), std::nullopt);
    EXPECT_EQ(found.seen_unknown(), std::nullopt);
    EXPECT_EQ(found.wrong_volume(), std::nullopt);
  }
}

TEST(SeenSpace, PointsAreTheSameOnEveryPlatform) {
  Scan<2> scan;
  scan.origins = Vector<2>(0.5, 0.5);
  scan.endpoints.resize(2, 4);
  scan.endpoints << 0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0;
  ClaimsOptions options;
  options.margin = 0.0;
  options.middle = 1.0;
  options.samples = 2;
  const SeenSpace<2> space(views<2>({scan}), kUnlimitedRange, options);
  Points<2> expected(2, 2);
  expected << 0x1.342cc6e8c9d48p-3, 0x1.a1f47bd7e7836p-1, 0x1.c4a3d2455e8e8p-1, 0x1.f526d3e0fccfcp-2;
  EXPECT_EQ(space.points(), expected);
  options.seed = 1;
  EXPECT_NE(SeenSpace<2>(views<2>({scan}), kUnlimitedRange, options).points(), expected);
}

TEST(Claims, SharesAreOfWhatWasCounted) {
  ClaimsOptions options;
  options.margin = 3.0;
  const SeenSpace<2> space(views<2>({fan(-45, 45, 2.0)}), kUnlimitedRange, options);
  const Claims found = claims(elsewhere::Stripes{}, space);
  Claims expected;
  for (Eigen::Index i = 0; i < space.points().cols(); ++i) {
    const double x = space.points()(0, i);
    ++expected.points;
    if (space.seen()[i]) ++expected.seen;
    if (x >= 0.0 && x < 1.0) ++expected.free;
    if (x >= 0.0 && x < 1.0 && !space.seen()[i]) ++expected.free_and_unseen;
    if ((x < 0.0 || x >= 2.0) && space.seen()[i]) ++expected.unknown_and_seen;
  }
  EXPECT_EQ(found.points, 40000u);
  EXPECT_EQ(found.seen, expected.seen);
  EXPECT_EQ(found.free, expected.free);
  EXPECT_EQ(found.free_and_unseen, expected.free_and_unseen);
  EXPECT_EQ(found.unknown_and_seen, expected.unknown_and_seen);
  // Up to x = 1 the fan is a triangle, of 1.5 degrees more on both sides; the stripe is as high as the box.
  const double stripe = space.box()->upper.y() - space.box()->lower.y();
  EXPECT_NEAR(found.free_unseen().value(), 1.0 - std::tan(46.5 * kDegree) / stripe, 0.02);
  EXPECT_GT(found.unknown_and_seen, 20u);

  Claims by_hand;
  by_hand.points = 100;
  by_hand.seen = 20;
  by_hand.free = 40;
  by_hand.free_and_unseen = 30;
  by_hand.unknown_and_seen = 5;
  EXPECT_DOUBLE_EQ(by_hand.free_unseen().value(), 0.75);
  EXPECT_DOUBLE_EQ(by_hand.seen_unknown().value(), 0.25);
  EXPECT_DOUBLE_EQ(by_hand.wrong_volume().value(), 1.75);
}

TEST(ClaimsOptions, OutOfBoundsAreNamed) {
  const auto with = [](auto member, auto value) {
    ClaimsOptions options;
    options.*member = value;
    return options;
  };
  using Options = ClaimsOptions;
  const std::pair<Options, const char*> cases[] = {
      {with(&Options::samples, std::size_t{0}), "samples = 0.0: must be in [1, 1e9]"},
      {with(&Options::samples, std::size_t{1000000001}), "samples = 1e+09: must be in [1, 1e9]"},
      {with(&Options::spacings, 0.0), "spacings = 0.0: must be > 0 and finite"},
      {with(&Options::spacings, HUGE_VAL), "spacings = inf: must be > 0 and finite"},
      {with(&Options::tolerance, -0.1), "tolerance = -0.1: must be >= 0 m and finite"},
      {with(&Options::tolerance, kNan), "tolerance = nan: must be >= 0 m and finite"},
      {with(&Options::margin, -1.0), "margin = -1.0: must be >= 0 m and finite"},
      {with(&Options::middle, 0.0), "middle = 0.0: must be in (0, 1]"},
      {with(&Options::middle, 1.01), "middle = 1.01: must be in (0, 1]"},
  };
  for (const auto& [options, message] : cases) {
    EXPECT_EQ(test::refusal_of(options), message);
    EXPECT_THROW(SeenSpace<2>({}, kUnlimitedRange, options), std::invalid_argument) << message;
  }
  EXPECT_EQ(test::refusal_of(ClaimsOptions{}), "accepted");
  for (const double max_range : {0.0, -1.0, kNan}) {
    EXPECT_EQ(refusal_by([&] { const SeenSpace<2> space({}, max_range); }),
              "max_range = " + describe_number(max_range) + " m: must be > 0");
  }
}

}  // namespace
}  // namespace ndtree::test::test_claims
