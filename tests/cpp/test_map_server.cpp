// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "ndtree/cell/thin_things.hpp"
#include "ndtree/io/dense_grid.hpp"
#include "ndtree/io/map_builder.hpp"
#include "ndtree/io/map_server.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/point.hpp"
#include "random.hpp"
#include "refusals.hpp"

namespace ndtree::test::test_map_server {
namespace {

/// Boxes of cells, some free and some occupied, about 0.
template <class Map>
Map blocks(double unit, std::uint64_t seed) {
  MapOptions options;
  options.min_cell_size = unit;
  options.max_cell_size = 16 * unit;
  MapBuilder<Map> builder(options);
  Random random(seed);
  for (int i = 0; i < 60; ++i) {
    Lattice<Map::kDim> lower, upper;
    for (std::size_t a = 0; a < Map::kDim; ++a) {
      lower[a] = random.integer(-25, 20);
      upper[a] = lower[a] + random.integer(1, i < 20 ? 12 : 3);
    }
    builder.fill(lower, upper, i % 3 == 0 ? 1.0f : -1.0f);
  }
  return std::move(builder).finish();
}

/// What a pixel must be: the cells of min_cell_size in it are asked one by one.
/// @param cells along a pixel. @param low, high layers [low, high) of a 3-D map.
template <class Map>
std::uint8_t expected(const Map& map, std::int64_t x, std::int64_t y, std::int64_t cells, std::int64_t low,
                      std::int64_t high) {
  const double unit = map.options().min_cell_size;
  bool free = false;
  Lattice<Map::kDim> at;
  for (at[0] = x * cells; at[0] < (x + 1) * cells; ++at[0])
    for (at[1] = y * cells; at[1] < (y + 1) * cells; ++at[1])
      for (std::int64_t z = low; z < high; ++z) {
        Vector<Map::kDim> point;
        if constexpr (Map::kDim == 3) at[2] = z;
        for (int a = 0; a < Map::kDim; ++a)
          point[a] = (static_cast<double>(at[static_cast<std::size_t>(a)]) + 0.5) * unit;
        const CellState here = state(map, point);
        if (here == CellState::occupied) return 0;
        free = free || here == CellState::free;
      }
  return free ? 254 : 205;
}

template <class Map>
void expect_pixels(const Map& map, const MapServerImage& image, std::int64_t cells, std::int64_t low,
                   std::int64_t high) {
  const double pixel = image.cell_size;
  const auto left = std::llround(image.origin.x() / pixel);
  const auto bottom = std::llround(image.origin.y() / pixel);
  ASSERT_EQ(image.pixels.size(), image.width * image.height);
  int counts[3] = {};
  // A margin around it: nothing that is known is left out.
  const auto w = static_cast<std::int64_t>(image.width), h = static_cast<std::int64_t>(image.height);
  for (std::int64_t row = -2; row < h + 2; ++row)
    for (std::int64_t column = -2; column < w + 2; ++column) {
      const bool in = row >= 0 && row < h && column >= 0 && column < w;
      const std::uint8_t found = in ? image.pixels[static_cast<std::size_t>(row * w + column)] : 205;
      ASSERT_EQ(found, expected(map, left + column, bottom + h - 1 - row, cells, low, high))
          << "row " << row << " column " << column;
      ++counts[found == 0 ? 0 : found == 254 ? 1 : 2];
    }
  for (const int count : counts) EXPECT_GT(count, 5);
}

TEST(MapServer, SmallerAndUnevenPixelsCoverTheCells) {
  const auto map = blocks<AdaptiveMap<2, 2>>(0.3, 4);
  const MapServerImage exact = map_server_image(map);
  MapServerOptions options;
  options.cell_size = 0.1;
  const MapServerImage fine = map_server_image(map, options);
  ASSERT_EQ(fine.width, 3 * exact.width);
  ASSERT_EQ(fine.height, 3 * exact.height);
  for (std::size_t row = 0; row < fine.height; ++row)
    for (std::size_t column = 0; column < fine.width; ++column)
      ASSERT_EQ(fine.pixels[row * fine.width + column], exact.pixels[row / 3 * exact.width + column / 3]);
  options.cell_size = 0.37;
  const MapServerImage uneven = map_server_image(map, options);
  int occupied = 0;
  for_each_leaf(map.tree(), [&](const auto& leaf) {
    if (leaf.cell().state() != CellState::occupied) return;
    const Box<2> box = map.tree().box(leaf.index);
    for (double x = box.lower.x() + 0.01; x < box.upper.x(); x += 0.1) {
      const auto column = static_cast<std::size_t>(std::floor((x - uneven.origin.x()) / 0.37));
      const auto up = static_cast<std::size_t>(std::floor((box.lower.y() + 0.01 - uneven.origin.y()) / 0.37));
      ASSERT_EQ(uneven.pixels[(uneven.height - 1 - up) * uneven.width + column], 0);
      ++occupied;
    }
  });
  EXPECT_GT(occupied, 20);
}

TEST(MapServer, SlicesTakeTheLayersThatTheyOverlap) {
  const auto map = blocks<AdaptiveMap<2, 3>>(0.05, 5);
  MapServerOptions options;
  options.height = {0.15, 0.45};  // 3 * 0.05 is a little more than 0.15, and so is 9 * 0.05: layers 3 to 8.
  expect_pixels(map, map_server_image(map, options), 1, 3, 9);
  options.height = {-0.12, 0.01};  // Parts of layers count.
  options.cell_size = 0.1;
  expect_pixels(map, map_server_image(map, options), 2, -3, 1);
  expect_pixels(map, map_server_image(map), 1, -40, 40);
}

TEST(MapServer, FarWallsAreNoThickerThanAsked) {
  // Beams that end anywhere in a metre, with a noise that keeps cells of 0.4 m whole.
  MapOptions map_options;
  map_options.range_sigma = 0.3;
  map_options.max_cell_size = 0.4;
  AdaptiveMap<2, 2> map(map_options);
  Random random(8);
  for (int i = 0; i < 40; ++i) {
    Scan<2> scan;
    scan.origins = Vector<2>(0.02, 0.03);
    scan.endpoints.resize(2, 200);
    for (int k = 0; k < 200; ++k)
      scan.endpoints.col(k) = Vector<2>(random.uniform(4.0, 5.2), random.uniform(-2.0, 2.0));
    map.insert(scan);
  }
  int left_out = 0;
  for (const double depth : {0.05, 0.1, 0.25}) {  // As grids have it, see test_dense_grid.cpp.
    MapServerOptions options;
    options.wall_depth = depth;
    const MapServerImage image = map_server_image(map, options);
    GridGeometry<2> grid{image.origin, image.cell_size, {image.width, image.height}};
    std::vector<std::int8_t> all(grid.size()), near(grid.size());
    states_to_grid(map, grid, std::nullopt, all.data());
    states_to_grid(map, grid, depth, near.data());
    for (std::size_t row = 0; row < image.height; ++row)
      for (std::size_t column = 0; column < image.width; ++column) {
        const std::size_t at = column * image.height + image.height - 1 - row;
        left_out += near[at] != all[at];
        ASSERT_EQ(image.pixels[row * image.width + column], near[at] == 1 ? 0 : near[at] == 0 ? 254 : 205);
      }
  }
  EXPECT_GT(left_out, 500);
  MapServerOptions refused;
  refused.wall_depth = 0.0;
  EXPECT_THROW(static_cast<void>(map_server_image(map, refused)), std::invalid_argument);
}

TEST(MapServer, AFenceIsDrawnAndAWallGetsNoThicker) {
  // Rods of 2 cm every 0.3 m along y = 2, and a wall behind, y = 3 + 0.12 x.
  AdaptiveMap<2, 2> map{MapOptions()};
  for (int i = 0; i < 20; ++i) {
    Scan<2> scan;
    const Vector<2> origin(0.13 * i - 1.3, 0.01 * i);
    scan.origins = origin;
    scan.endpoints.resize(2, 600);
    for (int k = 0; k < 600; ++k) {
      const double angle = 0.4 + 2.3 * k / 600.0;
      const Vector<2> direction(std::cos(angle), std::sin(angle));
      double range = (3.0 + 0.12 * origin.x() - origin.y()) / (direction.y() - 0.12 * direction.x());
      for (int rod = -10; rod <= 10; ++rod) {
        const Vector<2> to = Vector<2>(0.3 * rod + 0.02, 2.02) - origin;
        const double along = to.dot(direction), beside = (to - along * direction).norm();
        if (beside < 0.01) range = std::min(range, along - std::sqrt(1e-4 - beside * beside));
      }
      scan.endpoints.col(k) = origin + range * direction;
    }
    map.insert(scan);
  }
  const ThinThings things(map);
  const auto is_occupied = [&](const Vector<2>& at) { return state(map, at) == CellState::occupied; };
  for (const int parts : {1, 2, 3}) {  // Of a smallest cell's edge are a pixel's.
    MapServerOptions options;
    options.cell_size = 0.05 / parts;
    const MapServerImage image = map_server_image(map, options);
    int single = 0, beside_wall = 0;
    for (std::size_t row = 0; row < image.height; ++row)
      for (std::size_t column = 0; column < image.width; ++column) {
        const Vector<2> pixel(static_cast<double>(column) + 0.5,
                              static_cast<double>(image.height - 1 - row) + 0.5);
        const Vector<2> at = image.origin + image.cell_size * pixel;
        const auto leaf = map.tree().find_leaf(at);
        const bool is_thin = leaf && things.are_in(leaf->cell());
        bool is_beside = false;
        for (int side = 0; side < 4; ++side)
          is_beside = is_beside || is_occupied(at + 0.05 * Vector<2>((side - 1) % 2, (side - 2) % 2));
        single += is_thin && !is_beside;
        beside_wall += is_thin && is_beside;
        ASSERT_EQ(image.pixels[row * image.width + column] == MapServerImage::kOccupied,
                  is_occupied(at) || (is_thin && !is_beside));
      }
    EXPECT_GT(single, 5);
    EXPECT_GT(beside_wall, 5);
  }
}

TEST(MapServer, FilesByHand) {
  MapOptions map_options;
  map_options.min_cell_size = 0.5;
  MapBuilder<PaperMap<2, 2>> builder(map_options);
  builder.fill({-3, 4}, {-2, 5}, 1.0f);
  builder.fill({-2, 3}, {-1, 4}, -1.0f);
  const auto map = std::move(builder).finish();
  const MapServerImage image = map_server_image(map);
  EXPECT_EQ(image.pgm(), std::string("P5\n2 2\n255\n\x00\xcd\xcd\xfe", 15));
  EXPECT_EQ(image.yaml("it's.pgm"),
            "image: 'it''s.pgm'\nmode: trinary\nresolution: 0.5\norigin: [-1.5, 1.5, 0.0]\nnegate: 0\n"
            "occupied_thresh: 0.65\nfree_thresh: 0.196\n");
  const auto folder = std::filesystem::path(testing::TempDir()) / "ndtree_map_server";
  std::filesystem::create_directories(folder);
  save_map_server(image, folder / "hall.yaml");
  EXPECT_EQ(read_file(folder / "hall.pgm"), image.pgm());
  EXPECT_EQ(read_file(folder / "hall.yaml"), image.yaml("hall.pgm"));
  EXPECT_THROW(save_map_server(image, folder / "hall.pgm"), std::invalid_argument);
  std::filesystem::remove_all(folder);
}

TEST(MapServer, NumbersAreNumbersInYaml) {
  MapServerImage image;
  image.cell_size = 1.0;
  image.origin = Vector<2>(1e-5, -3e20);
  EXPECT_NE(image.yaml("a").find("resolution: 1.0\norigin: [1.0e-05, -3.0e+20, 0.0]"), std::string::npos)
      << image.yaml("a");
}

TEST(MapServer, WhatCannotBeDrawnIsRefused) {
  const auto plane = blocks<AdaptiveMap<2, 2>>(0.1, 1);
  const auto space = blocks<AdaptiveMap<2, 3>>(0.1, 1);
  const auto refused = [](const auto& map, const MapServerOptions& options) {
    return refusal_by([&] { static_cast<void>(map_server_image(map, options)); });
  };
  EXPECT_EQ(refused(plane, {0.1, {}}), "accepted");
  EXPECT_NE(refused(plane, {0.0, {}}).find("cell_size"), std::string::npos);
  EXPECT_NE(refused(plane, {INFINITY, {}}).find("cell_size"), std::string::npos);
  EXPECT_NE(refused(plane, {1e-6, {}}).find("at most 2^30"), std::string::npos);
  EXPECT_NE(refused(plane, {{}, {{0.0, 1.0}}}).find("a map in the plane"), std::string::npos);
  EXPECT_NE(refused(space, {{}, {{1.0, 1.0}}}).find("from low to high"), std::string::npos);
  EXPECT_NE(refused(space, {{}, {{50.0, 51.0}}}).find("must be heights of observed cells"),
            std::string::npos);
  EXPECT_NE(refused(AdaptiveMap<2, 2>(), {}).find("the map is empty"), std::string::npos);
}

}  // namespace
}  // namespace ndtree::test::test_map_server
