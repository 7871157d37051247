// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <vector>

#include "at_a_time.hpp"
#include "ndtree/cell/evidence_model.hpp"
#include "ndtree/mapping/insert/cube_map.hpp"
#include "ndtree/mapping/insert/packed_beams.hpp"
#include "ndtree/mapping/insert/partition.hpp"
#include "ndtree/mapping/insert/sampling.hpp"
#include "ndtree/mapping/map_options.hpp"
#include "ndtree/tree/child_index.hpp"
#include "ndtree/tree/lattice.hpp"
#include "random.hpp"
#include "shapes.hpp"

namespace ndtree::test::test_scan_sampling {
namespace {

constexpr double kUnit = 0.05;

/// A face with `count` beams, spread evenly or on a line, and its buckets, of which only the first have
/// beams.
template <int D>
CubeFace<D> random_face(Random& random, const EvidenceModel& model, std::size_t num_buckets_before) {
  Vector<D> origin;
  for (int a = 0; a < D; ++a) origin[a] = random.uniform(-1.0, 1.0);
  CubeFace<D> face(origin, random.integer(0, D - 1), random.chance(0.5));
  face.num_beams =
      static_cast<std::uint32_t>(random.chance(0.1) ? 2 : std::pow(10.0, random.uniform(1.0, 5.0)));
  for (std::size_t k = 0; k + 1 < D; ++k) {
    face.lower[k] = static_cast<float>(random.uniform(-1.0, 0.0));
    face.upper[k] = random.chance(0.2) ? face.lower[k] : static_cast<float>(random.uniform(0.0, 1.0));
  }
  face.make_pixels();
  for (const bool uses_small_sample : {false, true})
    face.depth_of_full_sample[uses_small_sample] =
        face.depth_for(static_cast<float>(model.sample_beams(uses_small_sample)), static_cast<float>(kUnit));
  face.first_bucket = num_buckets_before;
  const auto all = static_cast<std::uint32_t>(face.num_all_buckets());
  face.num_buckets =
      random.chance(0.5) ? all : 1 + static_cast<std::uint32_t>(random.integer(0, static_cast<int>(all) - 1));
  return face;
}

template <class S>
class SharesOf : public ::testing::Test {};
TYPED_TEST_SUITE(SharesOf, Shapes, ShapeNames);

/// Leaves that are asked together take what each of them takes if it is asked alone, to the last bit.
TYPED_TEST(SharesOf, ChildrenTogetherAreThoseOfEach) {
  NDTREE_SHAPE;
  Random random(410);
  SCOPED_TRACE(random.trace());
  const LatticeGeometry<N, D> geometry(kUnit, 3);
  std::size_t all = 0;
  std::size_t some = 0;
  std::size_t cut = 0;
  for (int i = 0; i < 60; ++i) {
    MapOptions options;
    options.sample_beams = i % 3 == 0 ? 1.0 : std::pow(10.0, random.uniform(-1.5, 1.5));
    const EvidenceModel model(options, options);
    const CubeFace<D> face = random_face<D>(random, model, i % 2 == 0 ? 0 : 5);
    // Each step has some beams, or none.
    std::vector<std::uint32_t> begins(face.first_bucket + face.num_buckets + 1);
    for (std::uint32_t& begin : begins) begin = static_cast<std::uint32_t>(random.integer(0, 2));
    std::partial_sum(begins.begin(), begins.end(), begins.begin());
    CubeFace<D> counted = face;
    counted.end_of_beams = begins.back();
    ScanBeams<D> beams;
    beams.resize(begins.back(), {counted}, begins, false, {}, true, false);
    for (const int at_a_time : {1, 8}) {
      const AtATime loops(at_a_time);
      const BeamSampling<N, D> shares(geometry, beams, model);
      for (int k = 0; k < 30; ++k) {
        CellIndex<D> node;
        node.level = random.integer(geometry.finest_level() + 1, 0);
        const std::int64_t edge = geometry.edge(node.level);
        for (auto& lower : node.lower) lower = edge * random.integer(-100, 100);
        const typename BeamSampling<N, D>::Children children(shares, node, counted);
        for (int c = 0; c < ChildPartition<N, D>::kNumChildren; ++c) {
          const CellIndex<D> leaf = geometry.child(node, child_offset<N, D>(c));
          const auto child = static_cast<std::size_t>(c);
          for (const bool uses_small_sample : {false, true}) {
            const FaceSample<D> expected =
                shares.sample_of(counted, shares.of(leaf, counted, uses_small_sample));
            const FaceSample<D> sample = children.of(child, uses_small_sample);
            ASSERT_EQ(sample.face, &counted);
            ASSERT_EQ(sample.fraction, expected.fraction);
            ASSERT_EQ(sample.end, expected.end);
            ++(expected.fraction < 1.0f ? some : all);
            cut += expected.fraction < 1.0f && expected.end == counted.end_of_beams;
          }
        }
      }
    }
  }
  EXPECT_GT(all, 100u);
  EXPECT_GT(some, D == 1 ? 0u : 100u);
  EXPECT_GT(cut, D == 1 ? 0u : 10u) << "there were no steps behind the last that some cell takes";
}

}  // namespace
}  // namespace ndtree::test::test_scan_sampling
