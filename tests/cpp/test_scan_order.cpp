// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <random>
#include <tuple>
#include <vector>

#include "ndtree/mapping/scan/order.hpp"

namespace ndtree {
namespace {

auto everything_of(const KeptBeam& beam) { return std::make_tuple(beam.face, beam.chance, beam.number); }

/// What threads do, one after the other: parts count and put their beams, then ranges of buckets are sorted.
std::vector<KeptBeam> in_buckets(const std::vector<KeptBeam>& beams, std::size_t num_faces,
                                 std::size_t num_parts, std::size_t num_ranges) {
  std::uint32_t largest = 0;
  for (const KeptBeam& beam : beams) largest = std::max(largest, beam.chance);
  std::vector<std::uint32_t> ends(num_faces, 0);
  for (const KeptBeam& beam : beams)
    for (std::size_t f = beam.face; f < num_faces; ++f) ++ends[f];
  BeamBuckets buckets(ends, largest);
  const auto first = [&](std::size_t part) { return beams.size() * part / num_parts; };
  std::vector<std::vector<std::uint32_t>> places(num_parts);
  for (std::size_t p = 0; p < num_parts; ++p) {
    places[p].resize(buckets.count());
    for (std::size_t i = first(p); i < first(p + 1); ++i)
      ++places[p][buckets.of(beams[i].face, beams[i].chance)];
  }
  buckets.begin(places);
  std::vector<KeptBeam> sorted(beams.size());
  for (std::size_t p = 0; p < num_parts; ++p)
    for (std::size_t i = first(p); i < first(p + 1); ++i)
      sorted[places[p][buckets.of(beams[i].face, beams[i].chance)]++] = beams[i];
  std::size_t end = 0;
  for (std::size_t r = 0; r < num_ranges; ++r) {
    const std::size_t begin = buckets.next_begin(beams.size() * r / num_ranges);
    EXPECT_EQ(begin, end);  // Ranges follow each other.
    end = buckets.next_begin(beams.size() * (r + 1) / num_ranges);
    buckets.sort(sorted.data(), begin, end);
  }
  EXPECT_EQ(end, beams.size());
  return sorted;
}

TEST(BeamBuckets, AreInTheOrderOfASortForAllPartsAndRanges) {
  std::mt19937 random(1);
  int cases = 0;
  for (const std::size_t n : {1u, 2u, 3u, 7u, 180u, 3000u})
    for (const std::size_t num_faces : {1u, 2u, 5u, 181u})
      for (const std::uint32_t most : {0u, 1u, 1000u, 0xffffffu}) {
        if (num_faces > n + 1) continue;
        std::vector<KeptBeam> beams(n);
        for (std::size_t i = 0; i < n; ++i)
          beams[i] = {static_cast<std::uint32_t>(random() % (most + 1)),
                      static_cast<std::uint32_t>(random() % num_faces), static_cast<std::uint32_t>(i)};
        if (most == 1000u)  // Most are of one bucket.
          for (std::size_t i = 0; i < n; i += 3) beams[i].chance = 0xffffff;
        std::vector<KeptBeam> expected = beams;
        const auto is_before = [](const auto& a, const auto& b) {
          return everything_of(a) < everything_of(b);
        };
        std::sort(expected.begin(), expected.end(), is_before);
        for (const std::size_t parts : {1u, 2u, 5u})
          for (const std::size_t ranges : {1u, 2u, 7u}) {
            std::vector<KeptBeam> sorted = in_buckets(beams, num_faces, parts, ranges);
            ASSERT_TRUE(std::is_sorted(sorted.begin(), sorted.end())) << n << ' ' << num_faces << ' ' << most;
            std::sort(sorted.begin(), sorted.end(), is_before);  // Equal ones are in any order.
            for (std::size_t i = 0; i < n; ++i)
              ASSERT_EQ(everything_of(sorted[i]), everything_of(expected[i]));
            ++cases;
          }
      }
  EXPECT_GT(cases, 500);
}

TEST(BeamBuckets, HoldAFewBeamsEach) {
  const BeamBuckets dense({100'000}, 0xffffff);
  EXPECT_GT(dense.count(), 100'000u / 4);
  EXPECT_LE(dense.count(), 100'000u / 2);
  const BeamBuckets small_chances({100'000}, 0xffff);
  EXPECT_EQ(small_chances.of(0, 0xffff), small_chances.count() - 1);  // They are spread over the buckets.
}

TEST(BeamBuckets, AreManyForFacesOfManyBeams) {
  const BeamBuckets buckets({0, 100'000, 100'000, 100'010}, 0xffffff);
  EXPECT_EQ(buckets.of(1, 0), 0u);  // None for those without any.
  EXPECT_GT(buckets.of(3, 0), 100'000u / 4);
  EXPECT_LE(buckets.count() - buckets.of(3, 0), 5u);
}

}  // namespace
}  // namespace ndtree
