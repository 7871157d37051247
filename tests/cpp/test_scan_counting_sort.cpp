// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <random>
#include <tuple>
#include <vector>

#include "ndtree/core/parallel.hpp"
#include "ndtree/mapping/insert/counting_sort.hpp"
#include "ndtree/mapping/insert/cube_map.hpp"

namespace ndtree {
namespace {

/// A beam before the sort.
struct Drawn {
  std::uint32_t face, key, number;
};

using Faces = std::vector<CubeFace<3>>;

/// One face for each shift, with this number of buckets.
Faces faces_with_buckets(const std::vector<int>& shifts, const std::vector<std::uint32_t>& counts) {
  Faces faces(shifts.size(), CubeFace<3>(Vector<3>::Zero(), 0, false));
  for (std::size_t f = 0; f < faces.size(); ++f) {
    faces[f].key_shift = shifts[f];
    faces[f].num_buckets = counts[f];
  }
  return faces;
}

struct Ordered {
  std::vector<Drawn> beams;
  Faces faces;
  std::vector<std::uint32_t> begins;
};

/// Sorts beams as threads do, part by part: each part counts its beams, and writes them where they belong.
Ordered counting_sorted(const std::vector<Drawn>& beams, const std::vector<int>& shifts,
                        std::size_t num_parts) {
  std::vector<std::uint32_t> counts(shifts.size(), 1);
  for (const Drawn& beam : beams)
    counts[beam.face] = std::max(counts[beam.face], (beam.key >> shifts[beam.face]) + 1);
  Ordered result{std::vector<Drawn>(beams.size()), faces_with_buckets(shifts, counts), {}};
  const BeamBuckets<3> buckets(result.faces);
  const auto first = [&](std::size_t part) { return beams.size() * part / num_parts; };
  std::vector<std::vector<std::uint32_t>> indices(num_parts);
  for (std::size_t p = 0; p < num_parts; ++p) {
    indices[p] = buckets.counts();
    for (std::size_t i = first(p); i < first(p + 1); ++i)
      ++indices[p][1 + buckets.of(beams[i].face, beams[i].key)];
  }
  Workers workers(num_parts);
  buckets.prefix_sum(indices, workers);
  for (std::size_t p = 0; p < num_parts; ++p)
    for (std::size_t i = first(p); i < first(p + 1); ++i)
      result.beams[indices[p][1 + buckets.of(beams[i].face, beams[i].key)]++] = beams[i];
  result.begins = indices.back();
  return result;
}

TEST(BeamBuckets, AreInTheOrderOfFacesBucketsAndNumbersForAllParts) {
  std::mt19937 random(1);
  int cases = 0;
  for (const std::size_t n : {1u, 2u, 3u, 7u, 180u, 3000u})
    for (const std::size_t num_faces : {1u, 2u, 5u, 181u})
      for (const std::uint32_t most : {0u, 1u, 1000u, 0xffffffu}) {
        if (num_faces > n + 1) continue;
        std::vector<int> shifts(num_faces);
        for (int& shift : shifts) shift = 10 + static_cast<int>(random() % 15);
        std::vector<Drawn> beams(n);
        for (std::size_t i = 0; i < n; ++i)
          beams[i] = {static_cast<std::uint32_t>(random() % num_faces),
                      static_cast<std::uint32_t>(random() % (most + 1)), static_cast<std::uint32_t>(i)};
        std::vector<Drawn> expected = beams;
        const auto order = [&](const Drawn& beam) {
          return std::make_tuple(beam.face, beam.key >> shifts[beam.face], beam.number);
        };
        std::sort(expected.begin(), expected.end(),
                  [&](const Drawn& a, const Drawn& b) { return order(a) < order(b); });
        for (const std::size_t parts : {1u, 2u, 5u}) {
          const Ordered result = counting_sorted(beams, shifts, parts);
          for (std::size_t i = 0; i < n; ++i) {
            ASSERT_EQ(result.beams[i].face, expected[i].face);
            ASSERT_EQ(result.beams[i].number, expected[i].number);
          }
          // Begins of buckets: the number of beams in smaller buckets and faces.
          for (std::size_t f = 0; f < num_faces; ++f)
            for (std::uint32_t bucket = 0; bucket <= result.faces[f].num_buckets; ++bucket) {
              const auto before = std::count_if(expected.begin(), expected.end(), [&](const Drawn& beam) {
                return beam.face < f || (beam.face == f && beam.key >> shifts[f] < bucket);
              });
              ASSERT_EQ(result.begins[result.faces[f].first_bucket + bucket],
                        static_cast<std::uint32_t>(before));
              if (n > 1000 && bucket > 3) bucket += result.faces[f].num_buckets / 5;
            }
          ++cases;
        }
      }
  EXPECT_GT(cases, 150);
}

TEST(BeamBuckets, OfFacesFollowEachOther) {
  Faces faces = faces_with_buckets({24, 10, 4}, {1, 0x40, 0x1000});
  const BeamBuckets<3> buckets(faces);
  EXPECT_EQ(faces[1].first_bucket, 1u);
  EXPECT_EQ(faces[1].num_buckets, 0x40u);
  EXPECT_EQ(buckets.count(), 0x1041u);
  EXPECT_EQ(buckets.of(2, 0xffff), buckets.count() - 1);
}

/// A face has a power of two of buckets, with one to two beams in each in the mean.
TEST(BeamBuckets, AreOneOrTwoBeamsOfAFace) {
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

}  // namespace
}  // namespace ndtree
