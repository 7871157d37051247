// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "ndtree/io/byte_stream.hpp"
#include "ndtree/io/map_builder.hpp"
#include "ndtree/io/ply.hpp"
#include "ndtree/mapping/occupancy_map.hpp"

namespace ndtree::test::test_ply {
namespace {

const std::string kHeader =
    "property double x\nproperty double y\nproperty double z\nproperty float size\n"
    "property float probability\nproperty int state\nend_header\n";

template <class Map>
Map two_cells() {
  MapOptions options;
  options.min_cell_size = 0.5;
  options.max_cell_size = 4.0;
  MapBuilder<Map> builder(options);
  Lattice<Map::kDim> lower{}, upper;
  upper.fill(4);
  builder.fill(lower, upper, -1.0f);  // One leaf of 2 m.
  lower.fill(-1);
  upper.fill(0);
  builder.fill(lower, upper, 2.0f);
  return std::move(builder).finish();
}

TEST(Ply, BytesByHand) {
  const auto map = two_cells<PaperMap<2, 3>>();
  const std::string bytes =
      ply_bytes(map, [](const auto& leaf) { return leaf.cell().state() != CellState::unknown; });
  const std::string header = "ply\nformat binary_little_endian 1.0\nelement vertex 2\n" + kHeader;
  ASSERT_EQ(bytes.substr(0, header.size()), header);
  ByteReader in(std::string_view(bytes).substr(header.size()));
  for (const double place : {-0.25, 1.0}) {
    for (int a = 0; a < 3; ++a) EXPECT_EQ(in.get<double>(), place);
    EXPECT_EQ(in.get<float>(), place < 0 ? 0.5f : 2.0f);
    EXPECT_FLOAT_EQ(in.get<float>(), static_cast<float>(probability(place < 0 ? 2.0 : -1.0)));
    EXPECT_EQ(in.get<std::int32_t>(), place < 0 ? 1 : 0);
  }
  EXPECT_TRUE(in.at_end());
}

TEST(Ply, ThePlaneLiesAtZeroAndFilesHoldTheOccupied) {
  const auto map = two_cells<AdaptiveMap<2, 2>>();
  const auto path = std::filesystem::path(testing::TempDir()) / "ndtree_cells.ply";
  save_ply(map, path);
  const std::string bytes = read_file(path);
  const std::string header = "ply\nformat binary_little_endian 1.0\nelement vertex 1\n" + kHeader;
  ASSERT_EQ(bytes.substr(0, header.size()), header);
  ByteReader in(std::string_view(bytes).substr(header.size()));
  for (const double place : {-0.25, -0.25, 0.0}) EXPECT_EQ(in.get<double>(), place);
  EXPECT_EQ(bytes.size(), header.size() + 24 + 4 + 4 + 4);
  std::filesystem::remove(path);
}

TEST(Ply, LeavesAreAskedInTheirOrder) {
  const auto map = two_cells<AdaptiveMap<3, 3>>();
  std::vector<bool> asked;
  std::size_t leaves = 0;
  for_each_leaf(map.tree(), [&](const auto&) { ++leaves; });
  const std::string bytes = ply_bytes(map, [&](const auto&) {
    asked.push_back(asked.size() % 2 == 0);
    return asked.back();
  });
  EXPECT_EQ(asked.size(), leaves);
  EXPECT_NE(bytes.find("element vertex " + std::to_string((leaves + 1) / 2) + "\n"), std::string::npos);
}

}  // namespace
}  // namespace ndtree::test::test_ply
