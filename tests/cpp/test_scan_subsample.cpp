// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <set>
#include <tuple>
#include <vector>

#include "at_a_time.hpp"
#include "ndtree/core/parallel.hpp"
#include "ndtree/core/scan.hpp"
#include "ndtree/mapping/insert/counting_sort.hpp"
#include "ndtree/mapping/insert/cube_map.hpp"
#include "ndtree/mapping/insert/measurements.hpp"
#include "ndtree/mapping/insert/subsample.hpp"
#include "ndtree/tree/beam_traversal.hpp"
#include "ndtree/tree/lattice.hpp"
#include "random.hpp"

namespace ndtree::test::test_scan_subsample {
namespace {

template <int D>
std::array<float, D> floats(const Vector<D>& v) {
  std::array<float, D> result;
  for (std::size_t a = 0; a < D; ++a) result[a] = static_cast<float>(v[static_cast<int>(a)]);
  return result;
}

/// One origin or many; beams in a cone or all around, some of length 0, with NaN, without return, or long.
template <int D>
Scan<D> random_scan(Random& random, int count, int kind) {
  Scan<D> scan;
  const Eigen::Index origins = kind % 2 == 0 ? 1 : count;
  scan.origins.resize(D, origins);
  scan.endpoints.resize(D, count);
  scan.returned.resize(count);
  for (Eigen::Index i = 0; i < count; ++i) {
    for (int a = 0; a < D; ++a) {
      if (i < origins) scan.origins(a, i) = random.uniform(-1.0, 1.0);
      scan.endpoints(a, i) = random.uniform(-5.0, 5.0) + (kind >= 2 && a == 0 ? 8.0 : 0.0);
    }
    if (random.chance(0.02)) scan.endpoints.col(i) = scan.origins.col(origins == 1 ? 0 : i);
    if (random.chance(0.02)) scan.endpoints(random.integer(0, D - 1), i) = std::nan("");
    if (random.chance(0.02)) scan.endpoints(0, i) = kUnlimitedRange;
    if (random.chance(0.02)) scan.endpoints(0, i) = 1e200;
    scan.returned[i] = random.chance(0.8);
  }
  return scan;
}

template <int D>
void surveys_as_one_by_one(std::uint64_t seed) {
  Random random(seed);
  SCOPED_TRACE(random.trace());
  const LatticeGeometry<2, D> geometry(0.05, 3);
  const SensorOptions options;
  const BeamSensorModel sensor(options);
  std::array<std::uint64_t, 4> outcomes{};
  for (int kind = 0; kind < 4; ++kind)
    for (const int count : {1, 7, 8, 40, 700}) {
      const Scan<D> scan = random_scan<D>(random, count, kind);
      const Measurements<D, BeamSensorModel> measurements(scan.view(), 6.0, sensor);
      const ScanSurvey<D> exact = survey_exactly(geometry, measurements, measurements.all());
      for (const int at_a_time : {1, 8}) {
        std::vector<ScanPart<D, BeamSensorModel>> parts(1);
        ScanPart<D, BeamSensorModel>& part = parts.front();
        {
          const AtATime loops(at_a_time);
          part.survey_beams(measurements, measurements.all());
        }
        const ScanSurvey<D> survey = join_surveys(geometry, sensor, measurements, parts);
        EXPECT_EQ(survey.outcomes, exact.outcomes);
        if (exact.num_valid() == 0) continue;
        EXPECT_TRUE((survey.reach.lower.array() <= exact.reach.lower.array()).all());
        EXPECT_TRUE((survey.reach.upper.array() >= exact.reach.upper.array()).all());
        // If a cell samples all beams of a scan, all are kept.
        CubeMap<D> cube_map;
        const auto numbers = cube_map.join(part.cube_map());
        std::uint64_t beams = 0;
        for (CubeFace<D>& face : cube_map.faces()) {
          beams += face.num_beams;
          face.make_pixels();
        }
        EXPECT_EQ(beams, exact.num_valid());
        part.keep(cube_map, numbers, {1e9, 0.05, 0.4});
        EXPECT_EQ(part.num_kept(), exact.num_valid());
        for (std::size_t k = 0; k < part.num_kept(); ++k) {
          const auto i = static_cast<Eigen::Index>(part.kept(k));
          const Beam<D> beam = measurements.beam(i);
          const CubeFace<D>& face = cube_map.face(numbers[part.face(k)]);
          EXPECT_EQ(face.origin, beam.origin);
          EXPECT_EQ(std::abs(beam.displacement[face.axis]), beam.displacement.cwiseAbs().maxCoeff());
          EXPECT_EQ(beam.displacement[face.axis] < 0.0, face.negative);
          if (beam.range < 100.0) {
            EXPECT_EQ(part.key(k), sampling_key_of<D>(floats<D>(beam.displacement)));
          }
        }
        if (::testing::Test::HasFailure()) return;
      }
      for (std::size_t i = 0; i < outcomes.size(); ++i) outcomes[i] += exact.outcomes[i];
    }
  for (const std::uint64_t n : outcomes) EXPECT_GT(n, 20u);
}

TEST(ScanSample, SurveysAsOneByOne) {
  surveys_as_one_by_one<2>(171);
  surveys_as_one_by_one<3>(172);
  surveys_as_one_by_one<4>(173);
}

/// Where beams are denser than cells need, beams that no cell samples are dropped, and no beam that some
/// cell, of any size, samples.
template <int D>
void keeps_what_some_cell_samples(std::uint64_t seed) {
  Random random(seed);
  SCOPED_TRACE(random.trace());
  const LatticeGeometry<2, D> geometry(0.25, 2);
  SensorOptions options;
  options.range_sigma = 0.02;
  const BeamSensorModel sensor(options);
  int sampled = 0;
  std::size_t left_out = 0;
  for (const double beams_of_a_cell : {0.02, 0.3, 2.0}) {
    Scan<D> scan;
    scan.origins = Vector<D>::Constant(0.03);
    scan.endpoints.resize(D, 2000);
    for (Eigen::Index i = 0; i < scan.size(); ++i) {
      for (int a = 0; a < D; ++a) scan.endpoints(a, i) = 0.03 + random.uniform(-1.0, 1.0);
      scan.endpoints(0, i) = 0.03 + random.uniform(0.5, 5.0);
    }
    const Measurements<D, BeamSensorModel> measurements(scan.view(), kUnlimitedRange, sensor);
    ScanPart<D, BeamSensorModel> part;
    part.survey_beams(measurements, measurements.all());
    CubeMap<D> cube_map;
    const auto numbers = cube_map.join(part.cube_map());
    for (CubeFace<D>& face : cube_map.faces()) face.make_pixels();
    const SubsampleLimits sampling{beams_of_a_cell, 0.25, 1.0};
    part.keep(cube_map, numbers, sampling);
    std::set<std::uint32_t> kept;
    for (std::size_t k = 0; k < part.num_kept(); ++k) {
      kept.insert(part.kept(k));
      const CubeFace<D>& face = cube_map.face(numbers[part.face(k)]);
      EXPECT_LT(face.bucket_of(part.key(k)),
                face.buckets_within(part.depth_of_kept(sampling), 0.25f, static_cast<float>(beams_of_a_cell)))
          << "each has a bucket";
    }
    left_out += 2000 - kept.size();
    for (int i = 0; i < 300; ++i) {
      const double size = 0.25 * std::pow(2.0, random.integer(0, 2));
      Box<D> cell;
      for (int a = 0; a < D; ++a) cell.lower[a] = size * std::floor(random.uniform(-2.0, 6.0) / size);
      cell.upper = cell.lower.array() + size;
      for (Eigen::Index k = 0; k < scan.size(); ++k) {
        const Beam<D> beam = measurements.beam(k);
        double t_enter = 0.0;
        double t_exit = BeamSensorModel::t_end(beam, 0.02);
        if (!clip_to_box<D>(cell.lower - beam.origin, cell.upper - beam.origin, beam.displacement, t_enter,
                            t_exit))
          continue;
        Eigen::Index axis = 0;
        beam.displacement.cwiseAbs().maxCoeff(&axis);
        for (const CubeFace<D>& face : cube_map.faces()) {
          if (face.axis != axis || face.negative != (beam.displacement[axis] < 0.0)) continue;
          const float expected =
              face.expected_beams(face.depth_of(cell.lower[axis], cell.upper[axis]), 0.25f);
          const std::uint32_t bucket = face.bucket_of(sampling_key_of<D>(floats<D>(beam.displacement)));
          if (!(face.fraction_below(bucket) * expected < static_cast<float>(beams_of_a_cell))) continue;
          EXPECT_EQ(kept.count(static_cast<std::uint32_t>(k)), 1u);
          ++sampled;
        }
      }
      if (::testing::Test::HasFailure()) return;
    }
  }
  EXPECT_GT(sampled, 100);
  EXPECT_GT(left_out, D == 4 ? 20u : 1000u);
}

TEST(ScanSample, KeepsWhatSomeCellSamples) {
  keeps_what_some_cell_samples<2>(167);
  keeps_what_some_cell_samples<3>(168);
  keeps_what_some_cell_samples<4>(169);
}

/// Density, pixels and expected beams of a face whose beams are spread evenly.
TEST(CubeMap, FacesAreAsDenseAsTheirBeams) {
  CubeMap<3> cube_map;
  const Vector<3> origin(1.0, 2.0, 3.0);
  const std::uint32_t number = cube_map.face_of(cube_map.cube_of(origin), origin, 2);
  CubeFace<3>& face = cube_map.faces()[number];
  EXPECT_EQ(face.axis, 1);
  EXPECT_FALSE(face.negative);
  face.lower = {-0.5f, -0.25f};
  face.upper = {0.5f, 0.25f};
  face.num_beams = 5000;  // On an area of 1 / 2: a hundred pixels in a row of length 1.
  face.make_pixels();
  EXPECT_NEAR(face.density, 100.0f, 1e-4f);
  EXPECT_NEAR(face.expected_beams(2.0f, 0.1f), 25.0f, 1e-4f);
  EXPECT_EQ(face.expected_beams(0.01f, 0.1f), face.pixels[0] * face.pixels[1]) << "no more than there are";
  EXPECT_NEAR(face.width_of_beam(), 0.01f, 1e-6f);
  EXPECT_EQ(face.depth_of(4.0, 5.0), 2.5f);
  EXPECT_EQ(face.depth_of(1.0, 4.0), 1.5f) << "half the edge, if the origin is in the cell";
  EXPECT_LE(face.expected_beams(face.depth_for(7.0f, 0.1f), 0.1f), 7.0f);
  EXPECT_NEAR(face.expected_beams(face.depth_for(7.0f, 0.1f), 0.1f), 7.0f, 1e-3f);
}

TEST(CubeMap, InAPlaneBeamsAreAsWideAsTheyAreApartByAngle) {
  const double step = 0.01;
  for (const double first : {-0.78, -0.2, 0.3}) {
    CubeFace<2> face(Vector<2>::Zero(), 0, false);
    face.lower = {static_cast<float>(std::tan(first))};
    const int count = static_cast<int>((0.78 - first) / step);
    face.upper = {static_cast<float>(std::tan(first + step * count))};
    face.num_beams = static_cast<std::uint32_t>(count);
    face.make_pixels();
    for (int i = 0; i < count; ++i) {
      const double between = std::tan(first + step * (i + 1)) - std::tan(first + step * i);
      const double slant = std::cos(first + step * (i + 0.5));
      EXPECT_NEAR(static_cast<double>(face.width_of_beam()) / (slant * slant), between, 0.02 * between) << i;
    }
  }
}

TEST(BeamBuckets, OfFacesFollowEachOther) {
  std::vector<CubeFace<3>> faces(3, CubeFace<3>(Vector<3>::Zero(), 0, false));
  const int shifts[] = {24, 10, 4};
  const std::uint32_t counts[] = {1, 0x40, 0x1000};
  for (std::size_t f = 0; f < faces.size(); ++f) {
    faces[f].key_shift = shifts[f];
    faces[f].num_buckets = counts[f];
  }
  const BeamBuckets<3> buckets(faces);
  EXPECT_EQ(faces[1].first_bucket, 1u);
  EXPECT_EQ(buckets.count(), 0x1041u);
  EXPECT_EQ(buckets.of(2, 0xffff), buckets.count() - 1);
}

/// A face has a power of two of buckets, with one to two beams in each in the mean.
TEST(CubeMap, BucketsAreOneOrTwoBeamsOfAFace) {
  for (const std::uint32_t beams : {1u, 2u, 3u, 4u, 7u, 100u, 300'000u, 1u << 24, 0xffffffffu}) {
    CubeFace<3> face(Vector<3>::Zero(), 0, false);
    face.num_beams = beams;
    face.lower = {-0.5f, -0.5f};
    face.upper = {0.5f, 0.5f};
    face.make_pixels();
    const double buckets = static_cast<double>(face.num_all_buckets());
    EXPECT_GE(buckets, std::min(0.5 * beams + 0.5, 0x1p24));
    EXPECT_LE(buckets, std::min(static_cast<double>(beams), 0x1p24));
    EXPECT_EQ(face.bucket_of(0), 0u);
    EXPECT_EQ(face.bucket_of(0xffffff), static_cast<std::uint32_t>(buckets) - 1);
    EXPECT_EQ(face.fraction_below(0), 0.0f);
    EXPECT_EQ(face.fraction_below(static_cast<std::uint32_t>(buckets)), 1.0f);
    // At the depth at which a cell expects ten beams: all buckets for 20, a tenth of them for one.
    if (beams < 100) continue;
    const float depth = face.depth_for(10.0f, 0.05f);
    EXPECT_EQ(face.buckets_within(depth, 0.05f, 20.0f), static_cast<std::uint32_t>(buckets));
    EXPECT_NEAR(face.buckets_within(depth, 0.05f, 1.0f), 0.1 * buckets, 1.0 + 1e-3 * buckets);
  }
}

TEST(ScanSample, KeysAreIndependentOfWhatBeamsMeasured) {
  Random random(165);
  constexpr int kClasses = 16;
  // End points near each other, exact or rounded to 1 mm, in two classes of range.
  for (const double rounding : {0.0, 0.001}) {
    int count[2][kClasses] = {};
    constexpr int kBeams = 40000;
    for (int i = 0; i < kBeams; ++i) {
      const double angle = 1e-4 * i;
      double range = 2.0 + 0.01 * random.uniform();
      const bool is_near = range < 2.005;
      if (rounding > 0.0) range = std::round(range / rounding) * rounding;
      const std::uint32_t key =
          sampling_key_of<3>(floats<3>({range * std::cos(angle), range * std::sin(angle), 0.3}));
      ASSERT_LT(key, 1u << 24);
      ++count[is_near][key >> 20];
    }
    for (const auto& row : count) {
      double sum = 0.0;
      for (const int n : row) sum += n;
      double chi_square = 0.0;
      for (const int n : row) chi_square += std::pow(n - sum / kClasses, 2) / (sum / kClasses);
      EXPECT_LT(chi_square, 44.0) << "15 degrees of freedom: one in ten thousand is larger";
    }
  }
  EXPECT_EQ(sampling_key_of<2>({0.1f, 0.2f}), sampling_key_of<2>({0.1f, 0.2f}));
  EXPECT_NE(sampling_key_of<2>({0.1f, 0.2f}), sampling_key_of<2>({0.2f, 0.1f}));
}

TEST(ScanSample, AShiftFarBelowAMillimetreLeavesKeysAsTheyAre) {
  Random random(166);
  constexpr int kBeams = 10000;
  int kept = 0, kept_far = 0;
  for (int i = 0; i < kBeams; ++i) {
    const Vector<2> at(random.uniform(-20.0, 20.0), random.uniform(-20.0, 20.0));
    const std::uint32_t key = sampling_key_of<2>(floats<2>(at));
    kept += key == sampling_key_of<2>(floats<2>(at + Vector<2>::Constant(2e-5)));
    kept_far += key == sampling_key_of<2>(floats<2>(at + Vector<2>::Constant(2e-3)));
  }
  EXPECT_GT(kept, 0.94 * kBeams);
  EXPECT_LT(kept_far, 0.01 * kBeams);
}

}  // namespace
}  // namespace ndtree::test::test_scan_subsample
