// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Simulated worlds: exact queries against marching, noise within its settings, a way that sees everything.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "ndtree/logs/simulator.hpp"
#include "options.hpp"

namespace ndtree::test::test_simulator {
namespace {

using ndtree::Random;  // the simulator's, not that of properties

constexpr double kPi = 3.14159265358979324;

SimulationOptions perfect(std::size_t scans) {
  SimulationOptions options;
  options.scans = scans;
  options.noise_scale = 0.0;
  options.outlier_rate = 0.0;
  options.no_return_rate = 0.0;
  return options;
}

template <int D>
Vector<D> random_direction(Random& random) {
  Vector<D> direction;
  for (int k = 0; k < D; ++k) direction[k] = random.normal();
  return direction.normalized();
}

template <int D>
Vector<D> random_point(const Box<D>& box, Random& random) {
  Vector<D> point;
  for (int k = 0; k < D; ++k) point[k] = random.uniform(box.lower[k], box.upper[k]);
  return point;
}

/// distance() and contains() of one world, against each other and against every shape on its own.
template <int D>
void expect_distance_equals_marching(const SimulatedLog<D>& log, int beams, double reach) {
  constexpr double step = 0.01;
  constexpr double hair = 1e-6;  // grazing beams cut less than this off a corner
  Random random(42);
  const Box<D> bounds = log.world.bounds().value();
  int from_outside = 0;
  int from_inside = 0;
  int hits = 0;
  for (int beam = 0; beam < beams; ++beam) {
    // Half of the beams start at the sensor, half anywhere; many of the latter inside something.
    const Vector<D> origin = beam % 2 == 0
                                 ? Vector<D>(log.T_map_sensor[random.next() % log.size()].translation())
                                 : random_point(bounds, random);
    const Vector<D> direction = random_direction<D>(random);
    const auto distance = log.world.distance(origin, direction, reach);
    double by_shape = std::numeric_limits<double>::infinity();
    bool contained = false;
    for (const ::ndtree::Shape<D>& shape : log.world.shapes()) {
      by_shape = std::min(by_shape, shape.distance(origin, direction).value_or(by_shape));
      contained = contained || shape.contains(origin);
    }
    ASSERT_EQ(distance.value_or(-1.0), by_shape <= reach ? by_shape : -1.0) << "beam " << beam;
    ASSERT_EQ(log.world.contains(origin), contained) << "beam " << beam;
    if (contained) {
      ASSERT_EQ(distance.value_or(-1.0), 0.0) << "beam " << beam;
      ++from_inside;
      continue;
    }
    ++from_outside;
    for (double t = 0.0; t < distance.value_or(reach) - hair; t += step)
      ASSERT_FALSE(log.world.contains(origin + t * direction)) << "beam " << beam << " at " << t;
    if (!distance) continue;
    ++hits;
    ASSERT_FALSE(log.world.contains(origin + (*distance - hair) * direction)) << "beam " << beam;
    ASSERT_TRUE(log.world.contains(origin + (*distance + 1e-9) * direction)) << "beam " << beam;
  }
  EXPECT_GT(from_outside, beams / 2);
  EXPECT_GT(from_inside, beams / 100);
  EXPECT_GT(hits, beams / 4);
}

TEST(World, DistanceEqualsMarchingInTheOffice) {
  expect_distance_equals_marching(simulate_office(perfect(50)), 2000, 30.0);
}
TEST(World, DistanceEqualsMarchingInTheApartment) {
  expect_distance_equals_marching(simulate_apartment(perfect(50)), 1500, 6.0);
}
TEST(World, DistanceEqualsMarchingInTheStreet) {
  expect_distance_equals_marching(simulate_street(perfect(50)), 400, 60.0);
}

::ndtree::Shape<3> shape_at_two(int round_axes) {
  ::ndtree::Shape<3> shape;
  shape.center << 2, 0, 0;
  shape.half << 1, 1, 1;
  shape.round_axes = round_axes;
  return shape;
}

TEST(World, BeamsListedByHand) {
  struct Case {
    int round_axes;
    Vector<3> origin;
    Vector<3> direction;
    double expected;  // -1: none
  };
  const double slant = std::sqrt(0.5);
  const std::vector<Case> cases = {
      {0, {0, 0, 0}, {1, 0, 0}, 1.0},
      {0, {0, 1, 0}, {1, 0, 0}, 1.0},                      // along a face, which belongs to the box
      {0, {0, 1, 1}, {1, 0, 0}, 1.0},                      // along an edge
      {0, {0, 0, -1}, {slant, slant, 0}, std::sqrt(2.0)},  // to an edge's corner, where it only touches
      {0, {0, 1.0000001, 0}, {1, 0, 0}, -1.0},
      {0, {1, 0, 0}, {-1, 0, 0}, 0.0},       // starts on the surface
      {0, {2, 0, 0}, {0, 0, 1}, 0.0},        // starts inside
      {2, {2, 0, 5}, {0, 0, -1}, 4.0},       // onto the lid, parallel to the cylinder's axis
      {2, {2.9, 0.9, 5}, {0, 0, -1}, -1.0},  // parallel to the axis, in the box's corner
      {2, {0, 1, 0}, {1, 0, 0}, 2.0},        // tangent
      {3, {2, 0, 0.5}, {1, 0, 0}, 0.0}};
  for (std::size_t i = 0; i < cases.size(); ++i) {
    const Case& c = cases[i];
    const World<3> world({shape_at_two(c.round_axes)});
    EXPECT_DOUBLE_EQ(world.distance(c.origin, c.direction, 100.0).value_or(-1.0), c.expected) << "case " << i;
  }
  const World<3> world({shape_at_two(0)});
  EXPECT_TRUE(world.distance({0, 0, 0}, {1, 0, 0}, 1.0)) << "max_range itself is in reach";
  EXPECT_FALSE(world.distance({0, 0, 0}, {1, 0, 0}, 0.999999));
}

TEST(World, EmptyAndBrokenWorlds) {
  const World<2> empty;
  EXPECT_FALSE(empty.contains({0, 0}));
  EXPECT_FALSE(empty.distance({0, 0}, {1, 0}, 10.0));
  EXPECT_FALSE(empty.bounds());
  ::ndtree::Shape<3> flat = shape_at_two(0);
  flat.half[1] = 0.0;
  try {
    const World<3> world({shape_at_two(0), flat});
    FAIL() << "accepted";
  } catch (const std::invalid_argument& error) {
    EXPECT_STREQ(error.what(), "shape 1: must be finite, with extents > 0 and round_axes from 0 to 3");
  }
}

/// End points of perfect sensors, just before and just behind: outside and inside of something.
template <int D>
void expect_endpoints_on_surfaces(const SimulatedLog<D>& log, Eigen::Index least) {
  Eigen::Index checked = 0;
  for (std::size_t i = 0; i < log.size(); ++i) {
    const Scan<D> scan = log.scan(i);
    ASSERT_EQ(scan.view().size, scan.size());
    ASSERT_EQ(scan.size(), log.directions.cols());
    const Vector<D> origin = scan.origins.col(0);
    for (Eigen::Index k = 0; k < scan.size(); k += 7) {
      const Vector<D> endpoint = scan.endpoints.col(k);
      const Vector<D> direction = log.T_map_sensor[i].linear() * log.directions.col(k);
      if (!scan.returned[k]) {
        if (log.range.no_echo == NoEcho::no_measurement) {
          ASSERT_TRUE(endpoint.array().isNaN().all());
        } else {
          ASSERT_NEAR((endpoint - origin).norm(), log.range.max_range, 1e-9);
          ASSERT_FALSE(log.world.distance(origin, direction, log.range.max_range));
        }
        continue;
      }
      ASSERT_TRUE(log.world.contains(endpoint + 1e-9 * direction)) << "scan " << i << " beam " << k;
      ASSERT_FALSE(log.world.contains(endpoint - 1e-9 * direction)) << "scan " << i << " beam " << k;
      ASSERT_NEAR((endpoint - origin).normalized().dot(direction), 1.0, 1e-12);
      ++checked;
    }
  }
  EXPECT_GT(checked, least);
}

TEST(Simulator, PerfectEndpointsLieOnSurfaces) {
  expect_endpoints_on_surfaces(simulate_office(perfect(40)), 2000);
  expect_endpoints_on_surfaces(simulate_apartment(perfect(5)), 10000);
  expect_endpoints_on_surfaces(simulate_street(perfect(3)), 10000);
}

template <int D>
bool equal(const Scan<D>& a, const Scan<D>& b) {
  if (a.size() != b.size() || a.origins != b.origins || (a.returned != b.returned).any()) return false;
  for (Eigen::Index i = 0; i < a.endpoints.size(); ++i) {
    const double x = a.endpoints.data()[i];
    const double y = b.endpoints.data()[i];
    if (x != y && !(std::isnan(x) && std::isnan(y))) return false;
  }
  return true;
}

TEST(Simulator, SeedsRepeatBitForBitInAnyOrder) {
  SimulationOptions options;
  options.scans = 30;
  options.position_sigma = 0.02;
  options.heading_sigma = 0.01;
  const auto log = simulate_office(options);
  std::vector<Scan<2>> forward;
  for (std::size_t i = 0; i < log.size(); ++i) forward.push_back(log.scan(i));
  const auto again = simulate_office(options);
  for (std::size_t i = log.size(); i-- > 0;) EXPECT_TRUE(equal(again.scan(i), forward[i])) << i;
  options.seed = 2;
  const auto other = simulate_office(options);
  for (std::size_t i = 0; i < log.size(); ++i) EXPECT_FALSE(equal(other.scan(i), forward[i])) << i;

  DepthCamera small;
  small.width = 32;
  small.height = 24;
  options.scans = 5;
  const auto camera = simulate_apartment(options, small);
  const Scan<3> last = camera.scan(4);
  EXPECT_FALSE(equal(camera.scan(0), last));
  EXPECT_TRUE(equal(camera.scan(4), last));
}

TEST(Simulator, TheGeneratorIsTheSameEverywhere) {
  // Worked out in another language from the algorithm's definition.
  Random random(1234567);
  EXPECT_EQ(random.next(), 0xAF8E93104E9165A2ULL);
  EXPECT_EQ(random.next(), 0xE8B317CB489D5241ULL);
  EXPECT_EQ(Random(1234567, 1).next(), 0x5C6D05D909E46436ULL);
  constexpr int draws = 200000;
  double sum = 0.0;
  double squares = 0.0;
  double fourths = 0.0;
  for (int i = 0; i < draws; ++i) {
    const double x = random.normal();
    sum += x;
    squares += x * x;
    fourths += x * x * x * x;
    const double u = random.uniform();
    ASSERT_TRUE(u >= 0.0 && u < 1.0);
  }
  EXPECT_NEAR(sum / draws, 0.0, 5.0 / std::sqrt(draws));
  EXPECT_NEAR(squares / draws, 1.0, 5.0 * std::sqrt(2.0 / draws));
  EXPECT_NEAR(fourths / draws, 3.0, 5.0 * std::sqrt(96.0 / draws));
}

TEST(Simulator, RatesAndNoiseAreWhatTheSettingsSay) {
  SimulationOptions options = perfect(300);
  options.outlier_rate = 0.03;
  options.no_return_rate = 0.05;
  options.noise_scale = 1.5;
  const auto log = simulate_office(options);
  const double sigma = 1.5 * log.range.sigma;
  double n = 0.0, missing = 0.0, early = 0.0, far = 0.0, kept = 0.0, squares = 0.0;
  for (std::size_t i = 0; i < log.size(); ++i) {
    const Scan<2> scan = log.scan(i);
    for (Eigen::Index k = 0; k < scan.size(); ++k) {
      const Vector<2> origin = scan.origins.col(0);
      const Vector<2> direction = log.T_map_sensor[i].linear() * log.directions.col(k);
      const auto truth = log.world.distance(origin, direction, log.range.max_range);
      if (!truth || *truth < 1.0) continue;
      ++n;
      if (!scan.returned[k]) {
        ++missing;
        continue;
      }
      const double error = (Vector<2>(scan.endpoints.col(k)) - origin).dot(direction) - *truth;
      if (error < -6.0 * sigma) {
        // An outlier is uniform from the smallest range to the surface; those next to it pass for noise.
        early += (*truth - log.range.min_range) / (*truth - log.range.min_range - 6.0 * sigma);
      } else {
        far += error > 6.0 * sigma;
        squares += error * error;
        ++kept;
      }
    }
  }
  const auto tolerance = [n](double p) { return 5.0 * std::sqrt(p * (1.0 - p) / n); };
  EXPECT_GT(n, 80000);
  EXPECT_EQ(far, 0.0);
  EXPECT_NEAR(missing / n, 0.05, tolerance(0.05));
  EXPECT_NEAR(early / n, 0.03, tolerance(0.03));
  EXPECT_NEAR(std::sqrt(squares / kept), sigma, 0.02 * sigma);
}

TEST(Simulator, CameraNoiseGrowsWithTheSquareOfTheRange) {
  SimulationOptions options = perfect(20);
  options.noise_scale = 1.0;
  DepthCamera camera;
  camera.width = 64;
  camera.height = 48;
  const auto log = simulate_apartment(options, camera);
  double n = 0.0;
  double squares = 0.0;
  for (std::size_t i = 0; i < log.size(); ++i) {
    const Scan<3> scan = log.scan(i);
    for (Eigen::Index k = 0; k < scan.size(); ++k) {
      if (!scan.returned[k]) continue;
      const Vector<3> origin = scan.origins.col(0);
      const Vector<3> direction = log.T_map_sensor[i].linear() * log.directions.col(k);
      const double truth = log.world.distance(origin, direction, 20.0).value();
      if (truth < 0.5 || truth > 5.5) continue;
      const double error = (Vector<3>(scan.endpoints.col(k)) - origin).dot(direction) - truth;
      squares += std::pow(error / (0.002 + 0.0015 * truth * truth), 2.0);
      ++n;
    }
  }
  EXPECT_GT(n, 30000);
  EXPECT_NEAR(squares / n, 1.0, 5.0 * std::sqrt(2.0 / n));
}

TEST(Simulator, PoseErrorsMoveWhatIsStatedNotWhatIsMeasured) {
  SimulationOptions options = perfect(400);
  const PlanarLaser laser{kPi, 3, {}};
  const auto exact = simulate_office(options, laser);
  options.position_sigma = 0.05;
  options.heading_sigma = 0.02;
  const auto shaken = simulate_office(options, laser);
  double squares = 0.0;
  double turns = 0.0;
  for (std::size_t i = 0; i < exact.size(); ++i) {
    const Scan<2> a = exact.scan(i);
    const Scan<2> b = shaken.scan(i);
    const Vector<2> shift = b.origins.col(0) - a.origins.col(0);
    squares += shift.squaredNorm() / 2.0;
    const Vector<2> u = a.endpoints.col(1) - a.origins.col(0);
    const Vector<2> v = b.endpoints.col(1) - b.origins.col(0);
    ASSERT_NEAR(u.norm(), v.norm(), 1e-9);
    turns += std::pow(std::atan2(u.x() * v.y() - u.y() * v.x(), u.dot(v)), 2.0);
  }
  EXPECT_NEAR(std::sqrt(squares / 400.0), 0.05, 0.05 * 0.2);
  EXPECT_NEAR(std::sqrt(turns / 400.0), 0.02, 0.02 * 0.2);
}

/// No sensor inside a solid, nor nearer than `clearance` to one at its own height.
template <int D>
void expect_way_is_clear(const SimulatedLog<D>& log, double clearance) {
  for (std::size_t i = 0; i < log.size(); ++i) {
    const Vector<D> position = log.T_map_sensor[i].translation();
    ASSERT_FALSE(log.world.contains(position)) << "scan " << i;
    for (int k = 0; k < 36; ++k) {
      Vector<D> direction = Vector<D>::Zero();
      direction.template head<2>() << std::cos(k * kPi / 18.0), std::sin(k * kPi / 18.0);
      ASSERT_FALSE(log.world.distance(position, direction, clearance)) << "scan " << i << " at " << position;
    }
    ASSERT_TRUE(log.T_map_sensor[i].linear().isUnitary(1e-12));
    ASSERT_GT(log.T_map_sensor[i].linear().determinant(), 0.0);
  }
}

TEST(Simulator, TheWayKeepsClearOfEverything) {
  const auto office = simulate_office();
  EXPECT_EQ(office.size(), 720u);
  EXPECT_EQ(office.directions.cols(), 361);
  expect_way_is_clear(office, 0.2);
  const auto apartment = simulate_apartment();
  EXPECT_EQ(apartment.size(), 300u);
  EXPECT_EQ(apartment.directions.cols(), 160 * 120);
  expect_way_is_clear(apartment, 0.15);
  const auto street = simulate_street();
  EXPECT_EQ(street.size(), 80u);
  EXPECT_EQ(street.directions.cols(), 64 * 512);
  expect_way_is_clear(street, 1.0);
}

TEST(Simulator, EveryRoomOfTheOfficeIsReachedAndSeen) {
  SimulationOptions options = perfect(720);
  options.yaw = 0.0;  // the rooms are given in the office's own frame
  const auto log = simulate_office(options);
  Random random(3);
  const std::vector<Box<2>> rooms = office_rooms();
  ASSERT_EQ(rooms.size(), 12u);
  for (std::size_t room = 0; room < rooms.size(); ++room) {
    int inside = 0;
    for (const auto& pose : log.T_map_sensor) inside += rooms[room].contains(pose.translation());
    EXPECT_GE(inside, 15) << "room " << room;
    int free = 0;
    int seen = 0;
    while (free < 150) {
      const Vector<2> point = random_point(rooms[room], random);
      if (log.world.contains(point)) continue;
      ++free;
      for (std::size_t i = 0; i < log.size(); i += 3) {
        const Vector<2> offset = point - log.T_map_sensor[i].translation();
        const double ahead = offset.dot(log.T_map_sensor[i].linear().col(0));
        if (ahead < 0.0 || log.world.distance(point, -offset.normalized(), offset.norm())) continue;
        ++seen;
        break;
      }
    }
    EXPECT_GE(seen, 150 * 9 / 10) << "room " << room;
  }
}

TEST(Simulator, YawTurnsTheWorldAndTheWayTogether) {
  SimulationOptions options = perfect(25);
  options.yaw = 0.0;
  const auto straight = simulate_street(options, {4, 32});
  options.yaw = 0.7;
  const auto turned = simulate_street(options, {4, 32});
  const Eigen::Matrix3d turn = Eigen::AngleAxisd(0.7, Vector<3>::UnitZ()).toRotationMatrix();
  for (std::size_t i = 0; i < straight.size(); i += 6) {
    const Scan<3> a = straight.scan(i);
    const Scan<3> b = turned.scan(i);
    ASSERT_TRUE((a.returned == b.returned).all());
    ASSERT_LT((turn * a.endpoints - b.endpoints).cwiseAbs().maxCoeff(), 1e-6);
  }
}

// Both turns are as short: the last bits of sines and cosines must not choose.
TEST(Simulator, ATurnStraightBackIsClockwiseAtAnyYaw) {
  for (int i = 0; i < 600; ++i) {
    const double c = std::cos(0.01 * i);
    const double s = std::sin(0.01 * i);
    const std::vector<PlanarPose> way =
        drive({{0.3 * c, 0.3 * s}, {1.7 * c, 1.7 * s}, {0.3 * c, 0.3 * s}}, 7, 1.0);
    ASSERT_NEAR(way.back().heading - way.front().heading, -kPi, 1e-9) << "yaw " << 0.01 * i;
  }
}

TEST(Sensors, BeamsStandInTheOrderThatIsDocumented) {
  const Points<2> laser = PlanarLaser{}.directions();
  for (Eigen::Index i = 0; i < laser.cols(); ++i)
    ASSERT_NEAR(std::atan2(laser(1, i), laser(0, i)), (-90.0 + 0.5 * static_cast<double>(i)) * kPi / 180.0,
                1e-12);

  const DepthCamera camera;
  const Points<3> rays = camera.directions();
  const double focal_length = 80.0 / std::tan(0.51);
  for (int v = 0; v < camera.height; v += 17)
    for (int u = 0; u < camera.width; u += 13) {
      const Vector<3> ray = rays.col(v * camera.width + u);
      ASSERT_NEAR(ray.x() / ray.z() * focal_length + 80.0, u + 0.5, 1e-9);
      ASSERT_NEAR(ray.y() / ray.z() * focal_length + 60.0, v + 0.5, 1e-9);
    }

  const RingLidar lidar;
  const Points<3> beams = lidar.directions();
  for (int ring = 0; ring < lidar.rings; ring += 9)
    for (int i = 0; i < lidar.azimuths; i += 31) {
      const Vector<3> beam = beams.col(ring * lidar.azimuths + i);
      ASSERT_NEAR(std::asin(beam.z()), (-25.0 + 40.0 * ring / 63.0) * kPi / 180.0, 1e-9);
      ASSERT_NEAR(std::remainder(std::atan2(beam.y(), beam.x()) - 2.0 * kPi * i / 512.0, 2.0 * kPi), 0.0,
                  1e-9);
    }
  EXPECT_TRUE(laser.colwise().norm().isOnes(1e-12));
  EXPECT_TRUE(rays.colwise().norm().isOnes(1e-12));
  EXPECT_TRUE(beams.colwise().norm().isOnes(1e-12));
}

TEST(Sensors, CameraLooksAlongTheWayWithItsTopUp) {
  const auto log = simulate_apartment(perfect(40));
  for (const auto& pose : log.T_map_sensor) {
    EXPECT_NEAR(pose.linear()(2, 0), 0.0, 1e-12) << "the right border of the image is level";
    EXPECT_LT(pose.linear()(2, 1), -0.7) << "rows go down";
  }
}

TEST(Sensors, TooNearIsNoMeasurement) {
  ::ndtree::Shape<2> wall;
  wall.center << 0.2, 0.0;
  wall.half << 0.1, 5.0;
  SimulatedLog<2> log{World<2>({wall}), PlanarLaser{kPi, 3, {}}.directions(), {}, {}, perfect(1), {}, {}};
  log.T_map_sensor.push_back(SimulatedLog<2>::Pose::Identity());
  log.range.min_range = 0.15;
  const Scan<2> scan = log.scan(0);
  EXPECT_FALSE(scan.returned[1]);
  EXPECT_TRUE(scan.endpoints.col(1).array().isNaN().all());
  EXPECT_NEAR((scan.endpoints.col(0) - Vector<2>(0.0, -30.0)).norm(), 0.0, 1e-9);
  EXPECT_FALSE(scan.returned[0]);
}

template <typename Options, typename Value>
std::string refusal(Value Options::*member, Value value) {
  Options options;
  options.*member = value;
  return refusal_of(options);
}

TEST(Simulator, BrokenOptionsAreRefusedByName) {
  using O = SimulationOptions;
  EXPECT_EQ(refusal_of(O{}), "accepted");
  EXPECT_EQ(refusal(&O::outlier_rate, 1.5), "outlier_rate = 1.5: must be in [0, 1]");
  EXPECT_EQ(refusal(&O::outlier_rate, -0.1), "outlier_rate = -0.1: must be in [0, 1]");
  EXPECT_EQ(refusal(&O::no_return_rate, 0.9985), "no_return_rate = 0.9985: must be in [0, 1 - outlier_rate]");
  EXPECT_EQ(refusal(&O::noise_scale, -1.0), "noise_scale = -1.0: must be >= 0");
  EXPECT_EQ(refusal(&O::position_sigma, -1.0), "position_sigma = -1.0 m: must be >= 0");
  EXPECT_EQ(refusal(&O::heading_sigma, -1.0), "heading_sigma = -1.0 rad: must be >= 0");
  EXPECT_EQ(refusal(&O::yaw, std::nan("")), "yaw = nan rad: must be finite");
  O none;
  none.scans = 0;
  EXPECT_EQ(refusal_of(none), "scans = 0: must be >= 1");
  EXPECT_THROW(simulate_office(none), std::invalid_argument);

  using R = RangeModel;
  EXPECT_EQ(refusal(&R::min_range, -1.0), "min_range = -1.0 m: must be >= 0");
  EXPECT_EQ(refusal(&R::max_range, 0.05), "max_range = 0.05 m: must be > min_range");
  EXPECT_EQ(refusal(&R::sigma, std::nan("")), "sigma = nan m: must be >= 0");
  EXPECT_EQ(refusal(&R::sigma_quadratic, -1.0), "sigma_quadratic = -1.0 1/m: must be >= 0");

  using L = PlanarLaser;
  EXPECT_EQ(refusal_of(L{}), "accepted");
  EXPECT_EQ(refusal(&L::beams, 0), "beams = 0: must be >= 1");
  EXPECT_EQ(refusal(&L::field_of_view, 0.0), "field_of_view = 0.0 rad: must be in (0, 2 pi]");
  using C = DepthCamera;
  EXPECT_EQ(refusal_of(C{}), "accepted");
  EXPECT_EQ(refusal(&C::width, 0), "width = 0 pixels: must be >= 1");
  EXPECT_EQ(refusal(&C::height, -3), "height = -3 pixels: must be >= 1");
  EXPECT_EQ(refusal(&C::field_of_view, 3.2), "field_of_view = 3.2 rad: must be in (0, pi)");
  using S = RingLidar;
  EXPECT_EQ(refusal_of(S{}), "accepted");
  EXPECT_EQ(refusal(&S::rings, 0), "rings = 0: must be >= 1");
  EXPECT_EQ(refusal(&S::azimuths, 0), "azimuths = 0: must be >= 1");
  EXPECT_EQ(refusal(&S::lowest, -2.0), "lowest = -2.0 rad: must be in [-pi / 2, pi / 2]");
  EXPECT_EQ(refusal(&S::highest, -1.0), "highest = -1.0 rad: must be in [lowest, pi / 2]");
}

/// Beams of some scans: those that moved end on something that moves, and the others as if nothing did.
template <int D, class Simulate>
void expect_exact_truth_of_what_moves(Simulate&& simulate, SimulationOptions options, int least) {
  options.noise_scale = 0.0;
  options.outlier_rate = 0.0;
  options.no_return_rate = 0.0;
  const SimulatedLog<D> log = simulate(options);
  int moved = 0;
  int stood = 0;
  for (std::size_t i = 0; i < log.size(); ++i) {
    const auto scan = log.scan(i);
    const std::vector<bool> truth = log.moved(i);
    ASSERT_EQ(truth.size(), static_cast<std::size_t>(scan.size()));
    std::vector<::ndtree::Shape<D>> things;
    for (const auto& thing : log.moving)
      for (const auto& shape : thing.shapes(log.times[i], scan.origins.col(0))) things.push_back(shape);
    for (Eigen::Index k = 0; k < scan.size(); k += 7) {
      const Vector<D> end = scan.endpoints.col(k);
      if (!end.allFinite() || !scan.returned[k]) continue;
      const Vector<D> direction = (end - scan.origins.col(0)).normalized();
      const double range = (end - scan.origins.col(0)).norm();
      double nearest = std::numeric_limits<double>::infinity();
      for (const auto& shape : things)
        if (const auto d = shape.distance(scan.origins.col(0), direction)) nearest = std::min(nearest, *d);
      const auto standing = log.world.distance(scan.origins.col(0), direction, log.range.max_range);
      if (truth[static_cast<std::size_t>(k)]) {
        EXPECT_NEAR(range, nearest, 1e-6);
        EXPECT_TRUE(!standing || *standing >= range - 1e-6);
        ++moved;
      } else {
        ASSERT_TRUE(standing);
        EXPECT_NEAR(range, *standing, 1e-6);
        ++stood;
      }
    }
  }
  EXPECT_GT(moved, least);
  EXPECT_GT(stood, 10 * least);
}

TEST(Simulator, TruthOfWhatMovesIsExact) {
  SimulationOptions options = perfect(120);
  options.people = 6;
  options.doors = 12;
  expect_exact_truth_of_what_moves<2>([](const auto& o) { return simulate_office(o); }, options, 200);
  options = perfect(12);
  options.people = 3;
  expect_exact_truth_of_what_moves<3>([](const auto& o) { return simulate_apartment(o); }, options, 200);
  options = perfect(6);
  options.people = 4;
  options.cars = 6;
  expect_exact_truth_of_what_moves<3>([](const auto& o) { return simulate_street(o); }, options, 200);
}

TEST(Simulator, WhatMovesChangesNoOtherBeam) {
  SimulationOptions options;
  options.scans = 60;
  const auto still = simulate_office(options);
  options.people = 5;
  const auto moving = simulate_office(options);
  int same = 0;
  int outliers = 0;
  for (std::size_t i = 0; i < 60; ++i) {
    const auto a = still.scan(i);
    const auto b = moving.scan(i);
    const auto truth = moving.moved(i);
    EXPECT_EQ(still.moved(i), std::vector<bool>(truth.size(), false));
    for (Eigen::Index k = 0; k < a.size(); ++k) {
      const bool is_same = a.endpoints.col(k) == b.endpoints.col(k);
      same += is_same ? 1 : 0;
      if (is_same || truth[static_cast<std::size_t>(k)]) continue;
      ++outliers;  // From before the nearest surface.
    }
    EXPECT_GE(b.stamp, i == 0 ? 0.0 : moving.times[i - 1]);
  }
  EXPECT_GT(same, 60 * 361 * 9 / 10);
  EXPECT_LT(outliers, 60);
}

}  // namespace
}  // namespace ndtree::test::test_simulator
