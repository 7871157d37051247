// SPDX-License-Identifier: BSD-3-Clause
// Points that are looked at together, against a look at every box for each of them.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <set>
#include <type_traits>
#include <vector>

#include "ndtree/core/box_tree.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/cells.hpp"
#include "ndtree/query/distance_transform.hpp"
#include "ndtree/query/field_grid.hpp"
#include "ndtree/query/point_packet.hpp"
#include "random.hpp"
#include "random_maps.hpp"

namespace ndtree::test::test_point_packet {
namespace {

template <int D>
Box<D> random_box(Random& random, double size) {
  Box<D> box;
  for (int a = 0; a < D; ++a) {
    box.lower[a] = random.uniform(-3.0, 3.0);
    box.upper[a] = box.lower[a] + random.uniform(0.01, size);
  }
  return box;
}

/// A grid with a block that is a packet, or a part of one.
template <int D>
struct Points {
  FieldGrid<D> grid;
  GridBlock<D> block;

  explicit Points(Random& random) : grid(Vector<D>::Constant(-2.0), random.uniform(0.05, 0.5), shape()) {
    for (std::size_t a = 0; a < D; ++a) {
      const int longest = static_cast<int>(detail::PointPacket<D>::kSide);
      block.first[a] = static_cast<std::size_t>(random.integer(0, 20));
      block.last[a] = block.first[a] + static_cast<std::size_t>(random.integer(1, longest));
    }
  }
  [[nodiscard]] static typename FieldGrid<D>::Shape shape() {
    typename FieldGrid<D>::Shape shape;
    shape.fill(40);
    return shape;
  }
  /// Gives all points of the block a squared distance.
  void start(detail::PointPacket<D>& packet, float squared) const {
    detail::any_place(block.first, block.last, [&](const auto& at) {
      packet.squared()[detail::PointPacket<D>::lane(block, at)] = squared;
      return false;
    });
  }
};

template <int D>
using Dimension = std::integral_constant<int, D>;
template <class T>
class PacketOfDimension : public testing::Test {};
using Dimensions = testing::Types<Dimension<2>, Dimension<3>, Dimension<5>>;
TYPED_TEST_SUITE(PacketOfDimension, Dimensions);

TYPED_TEST(PacketOfDimension, KeepsTheNearestOfAllBoxesBitForBit) {
  constexpr int D = TypeParam::value;
  using Packet = detail::PointPacket<D>;
  Random random(41);
  std::size_t nearer = 0;
  std::size_t farther = 0;
  for (int round = 0; round < 200; ++round) {
    const Points<D> points(random);
    const double most = random.uniform(0.5, 12.0);
    std::vector<Box<D>> boxes;
    for (int i = random.integer(0, 12); i > 0; --i) boxes.push_back(random_box<D>(random, 1.5));
    Packet packet(points.grid, points.block);
    Simd::limit(1);
    Packet plain(points.grid, points.block);
    Simd::limit(Simd::kWidest);
    for (Packet* one : {&packet, &plain}) points.start(*one, static_cast<float>(most * most));
    for (const Box<D>& box : boxes) {
      const auto before = packet.squared();
      const bool is_nearer = packet.is_nearer(box);
      EXPECT_EQ(plain.is_nearer(box), is_nearer);
      EXPECT_TRUE(packet.is_nearer({box.lower.array() - 0.1, box.upper.array() + 0.3}) || !is_nearer);
      packet.take(box);
      plain.take(box);
      EXPECT_EQ(packet.squared() != before, is_nearer);
      EXPECT_EQ(packet.squared(), plain.squared());
      EXPECT_FALSE(packet.is_nearer(box));
      EXPECT_FALSE(plain.is_nearer(box));
      ++(is_nearer ? nearer : farther);
    }
    Pace pace;
    detail::DistanceTransform<D> transform(points.grid, points.block, most, pace);
    const std::vector<float> all = transform.squared_distances(boxes);
    std::size_t i = 0;
    detail::any_place(points.block.first, points.block.last, [&](const auto& at) {
      EXPECT_EQ(packet.squared()[Packet::lane(points.block, at)], all[i++]);
      return false;
    });
    // Points that the block lacks take no part.
    EXPECT_EQ(static_cast<std::size_t>(std::count(packet.squared().begin(), packet.squared().end(), -1.0f)),
              Packet::kPoints - points.block.size());
    ASSERT_FALSE(testing::Test::HasFailure()) << "round " << round;
  }
  EXPECT_GT(nearer, 200u);
  EXPECT_GT(farther, 50u);
}

template <class Map>
class PacketOfMap : public testing::Test {};
using Maps = testing::Types<AdaptiveMap<3, 2>, AdaptiveMap<2, 3>>;
TYPED_TEST_SUITE(PacketOfMap, Maps);

TYPED_TEST(PacketOfMap, IsShownTheNearestCells) {
  constexpr int D = TypeParam::kDim;
  using Packet = detail::PointPacket<D>;
  MapOptions options;
  options.min_cell_size = 0.1;
  options.max_cell_size = 0.1 * TypeParam::kBranching * TypeParam::kBranching;
  options.range_sigma = 0.02;
  Random random(43);
  Pace pace;
  std::size_t near = 0;
  TypeParam map(options);
  for (int round = 0; round < 60; ++round) {  // The first ask a map whose root is a leaf.
    if (round % 10 == 3) map.insert(scan_about<D>(random, 0.0, 60, 1.0, 2.5));
    RegionStates states;
    states.occupied = round % 3 != 0;
    states.free = round % 3 == 0;
    states.unknown = round % 4 == 0;
    const Points<D> points(random);
    const auto most = static_cast<float>(random.uniform(0.1, 9.0));
    Packet shown(points.grid, points.block);
    points.start(shown, most);
    Packet expected = shown;
    detail::PacketSearch<TypeParam>(map, states, pace).show(shown);
    for_each_leaf_of(map, points.grid.box().inflated(50.0), states,
                     [&](const auto& leaf) { expected.take(map.tree().box(leaf.index)); });
    ASSERT_EQ(shown.squared(), expected.squared()) << "round " << round;
    near += static_cast<std::size_t>(std::count_if(shown.squared().begin(), shown.squared().end(),
                                                   [&](float squared) { return squared < most; }));
  }
  EXPECT_GT(near, 500u);
}

TEST(BoxTree, VisitsWhatIsWithinADistanceUnlessItDoesNotMatter) {
  Random random(47);
  std::size_t found = 0;
  for (int round = 0; round < 50; ++round) {
    std::vector<Box<3>> boxes;
    for (int i = random.integer(0, 80); i > 0; --i) boxes.push_back(random_box<3>(random, 0.5));
    const BoxTree<3> tree(boxes);
    const Box<3> region = random_box<3>(random, 2.0);
    const double squared = random.uniform(0.0, 2.0);
    std::set<std::size_t> visited;
    tree.for_each_within(
        region, squared, [](const Box<3>&) { return true; },
        [&](std::uint32_t number) { visited.insert(tree.index(number)); });
    std::set<std::size_t> expected;
    for (std::size_t i = 0; i < boxes.size(); ++i)
      if (region.squared_distance(boxes[i]) <= squared) expected.insert(i);
    EXPECT_EQ(visited, expected);
    found += expected.size();
    tree.for_each_within(
        region, squared, [](const Box<3>&) { return false; },
        [](std::uint32_t) { ADD_FAILURE() << "nothing matters"; });
  }
  EXPECT_GT(found, 100u);
}

/// Of any size and at any place, some of them thin, long, or sharing their borders.
template <int D>
std::vector<Box<D>> random_boxes(Random& random, std::size_t n) {
  std::vector<Box<D>> boxes;
  for (std::size_t i = 0; i < n; ++i) {
    Box<D> box;
    for (int a = 0; a < D; ++a) {
      box.lower[a] = random.uniform(-3.0, 3.0);
      if (random.chance(0.5)) box.lower[a] = std::floor(box.lower[a] * 4.0) / 4.0;
      box.upper[a] = box.lower[a] + (random.chance(0.5) ? 0.25 : random.uniform(0.01, 2.0));
    }
    boxes.push_back(box);
  }
  return boxes;
}

template <class T>
class OfDimension : public testing::Test {};
TYPED_TEST_SUITE(OfDimension, Dimensions);

TYPED_TEST(OfDimension, FindsTheNearestOfAllBoxes) {
  constexpr int D = TypeParam::value;
  using Shape = typename FieldGrid<D>::Shape;
  Random random(31);
  std::size_t near = 0;
  std::size_t far = 0;
  for (int round = 0; round < 40; ++round) {
    Shape shape;
    for (std::size_t& n : shape)
      n = static_cast<std::size_t>(random.integer(1, D == 2 ? 40 : D == 3 ? 18 : 5));
    const double spacing = random.chance(0.5) ? 0.25 : random.uniform(0.05, 0.6);
    const FieldGrid<D> grid(Vector<D>::Constant(-2.0), spacing, shape);
    const double most = random.uniform(0.1, 4.0);
    const auto boxes = random_boxes<D>(
        random, static_cast<std::size_t>(random.integer(0, round % 8 == 7 && D < 4 ? 400 : 60)));
    Pace pace;
    const GridBlock<D> whole{{}, shape};
    detail::DistanceTransform<D> transform(grid, whole, most, pace);
    const std::vector<float> found = transform.squared_distances(boxes);
    ASSERT_EQ(found.size(), whole.size());
    detail::any_place(whole.first, whole.last, [&](const Shape& at) {
      Vector<D> point;
      for (std::size_t a = 0; a < at.size(); ++a) point[static_cast<int>(a)] = grid.center(a, at[a]);
      double nearest = most * most;
      for (const Box<D>& box : boxes)
        nearest =
            std::min(nearest, (box.lower - point).cwiseMax(point - box.upper).cwiseMax(0.0).squaredNorm());
      const auto squared = static_cast<double>(found[whole.index(at)]);
      EXPECT_NEAR(squared, nearest, 1e-6 * (1.0 + nearest));
      EXPECT_EQ(squared == 0.0, nearest == 0.0);
      ++(nearest < most * most ? near : far);
      return testing::Test::HasFailure();
    });
    ASSERT_FALSE(testing::Test::HasFailure()) << "round " << round;

    // The same bits for parts of the grid, farther reach, boxes in parts, and without eight at a time.
    GridBlock<D> part = whole;
    for (std::size_t a = 0; a < shape.size(); ++a) {
      part.first[a] = static_cast<std::size_t>(random.integer(0, static_cast<int>(shape[a]) - 1));
      part.last[a] = static_cast<std::size_t>(
          random.integer(static_cast<int>(part.first[a]) + 1, static_cast<int>(shape[a])));
    }
    std::vector<Box<D>> parts;
    for (const Box<D>& box : boxes) {
      const double middle = 0.5 * (box.lower[0] + box.upper[0]);
      parts.push_back(box);
      parts.back().upper[0] = middle;
      parts.push_back(box);
      parts.back().lower[0] = middle;
    }
    std::reverse(parts.begin(), parts.end());
    Simd::limit(1);
    detail::DistanceTransform<D> other(grid, part, 1.5 * most, pace);
    Simd::limit(Simd::kWidest);
    const std::vector<float> again = other.squared_distances(parts);
    detail::any_place(part.first, part.last, [&](const Shape& at) {
      EXPECT_EQ(std::min(again[part.index(at)], transform.limit()), found[whole.index(at)]);
      return testing::Test::HasFailure();
    });
    ASSERT_FALSE(testing::Test::HasFailure()) << "round " << round;
  }
  EXPECT_GT(near, 1000u);
  EXPECT_GT(far, 1000u);
}

}  // namespace
}  // namespace ndtree::test::test_point_packet
