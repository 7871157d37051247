// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <sstream>
#include <string>
#include <tuple>
#include <vector>

#include "ndtree/io/octomap_file.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/point.hpp"
#include "random.hpp"
#include "refusals.hpp"
#include "trees.hpp"

#ifdef NDTREE_HAVE_OCTOMAP
#include "octomap_baseline.hpp"
#endif

namespace ndtree::test::test_octomap_file {
namespace {

MapOptions room_options(double min_cell_size) {
  MapOptions options;
  options.min_cell_size = min_cell_size;
  options.max_cell_size = 16 * min_cell_size;
  return options;
}

/// Beams from two places to the walls of a room, some without return.
template <class Map>
Map room(double min_cell_size = 0.1) {
  Map map(room_options(min_cell_size));
  Random random(5);
  for (int s = 0; s < 2; ++s) {
    Scan<3> scan;
    scan.origins = Vector<3>::Constant(s == 0 ? 0.013 : -0.777);
    scan.endpoints.resize(3, 1500);
    scan.returned.resize(1500);
    for (Eigen::Index i = 0; i < scan.endpoints.cols(); ++i) {
      Vector<3> way(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
      scan.endpoints.col(i) = scan.origins.col(0) + way * (1.3 / way.cwiseAbs().maxCoeff());
      scan.returned[i] = i % 9 != 0;
    }
    map.insert(scan);
  }
  return map;
}

/// Centres of the cells of an OctoMap of this resolution in and around the room.
std::vector<Vector<3>> centres(double cell_size) {
  const int n = static_cast<int>(std::ceil(2.0 / cell_size));
  std::vector<Vector<3>> result;
  for (int x = -n; x < n; ++x)
    for (int y = -n; y < n; ++y)
      for (int z = -n; z < n; ++z) result.push_back((Vector<3>(x, y, z).array() + 0.5).matrix() * cell_size);
  return result;
}

TEST(OctomapFile, LeavesOfTwoChildrenAnAxisKeepTheirSize) {
  const auto map = room<PaperMap<2, 3>>();
  const auto again = octomap_from_bytes<PaperMap<2, 3>>(octomap_bytes(map, OctomapFormat::full));
  std::size_t large = 0;
  for_each_leaf(map.tree(), [&](const auto& leaf) {
    if (leaf.cell().state() == CellState::unknown) return;
    const Box<3> box = map.tree().box(leaf.index);
    const auto other = again.tree().find_leaf(Vector<3>(0.5 * (box.lower + box.upper)));
    ASSERT_TRUE(other);
    EXPECT_GE(again.tree().geometry().cell_size(other->index.level),
              map.tree().geometry().cell_size(leaf.index.level) * (1 - 1e-12));
    EXPECT_EQ(other->cell().log_odds(), leaf.cell().log_odds());
    large += map.tree().geometry().edge(leaf.index.level) > 1;
  });
  EXPECT_GT(large, 100u);
  EXPECT_LE(again.stats().observed_leaves, map.stats().observed_leaves);
  EXPECT_EQ(octomap_bytes(again, OctomapFormat::full), octomap_bytes(map, OctomapFormat::full));
}

TEST(OctomapFile, EvidenceKeepsStatesAndNearlyLogOdds) {
  const auto map = room<PaperMap<2, 3>>();
  auto loaded = octomap_from_bytes<AdaptiveMap<2, 3>>(octomap_bytes(map, OctomapFormat::full));
  loaded.check_invariants();
  const auto fixed = octomap_from_bytes<FixedMap<2, 3>>(octomap_bytes(map, OctomapFormat::full));
  fixed.check_invariants();
  std::size_t known = 0;
  for (const Vector<3>& point : centres(0.1)) {
    const auto cell = cell_at(map, point);
    ASSERT_EQ(state(loaded, point), cell.state());
    ASSERT_NEAR(cell_at(loaded, point).log_odds(), cell.log_odds(), 0.008);
    ASSERT_EQ(cell_at(fixed, point).log_odds(), cell.log_odds());
    known += cell.state() != CellState::unknown;
  }
  EXPECT_GT(known, 10000u);
  Scan<3> scan;  // It goes on.
  scan.origins = Vector<3>::Zero();
  scan.endpoints = Vector<3>(2.0, 0.1, 0.1);
  EXPECT_EQ(loaded.insert(scan).returned, 1u);
  loaded.check_invariants();
}

TEST(OctomapFile, LogOddsWithinTheMemoryAreMet) {
  for (const float value : {-4.5f, -2.0f, -0.3f, -0.01f, -1e-6f, 1e-6f, 0.01f, 0.3f, 2.0f, 3.5f, 5.8f}) {
    MapOptions options;
    options.log_odds_min = -5.0;
    options.log_odds_max = 6.0;
    MapBuilder<AdaptiveMap<2, 3>> builder(options);
    builder.fill({0, 0, 0}, {1, 1, 1}, value);
    const auto map = std::move(builder).finish();
    const auto cell = cell_at(map, Vector<3>(0.01, 0.01, 0.01));
    EXPECT_NEAR(cell.log_odds(), value, 0.008);
    EXPECT_EQ(cell.state(), state_of(value));
  }
}

TEST(OctomapFile, BytesByHand) {
  MapOptions options;
  options.min_cell_size = 0.5;
  PaperMap<2, 3> empty(options);
  EXPECT_EQ(octomap_bytes(empty, OctomapFormat::binary),
            "# Octomap OcTree binary file\nid OcTree\nsize 0\nres 0.5\ndata\n");
  MapBuilder<PaperMap<2, 3>> builder(options);
  builder.fill({0, 0, 0}, {1, 1, 1}, 2.0f);   // Key 32768 on all axes: child 7, and then 15 times child 0.
  builder.fill({1, 0, 0}, {2, 1, 1}, -1.0f);  // The same, but child 1 in the end.
  const auto map = std::move(builder).finish();
  const std::string binary = octomap_bytes(map, OctomapFormat::binary);
  std::string data{"\x00\xc0", 2};  // Child 7 has children: the upper two bits of the second byte.
  for (int i = 0; i < 14; ++i) data += std::string{"\x03\x00", 2};
  data += std::string{"\x06\x00", 2};  // 2 occupied, 1 free.
  EXPECT_EQ(binary, "# Octomap OcTree binary file\nid OcTree\nsize 18\nres 0.5\ndata\n" + data);
  const std::string full = octomap_bytes(map, OctomapFormat::full);
  ByteWriter nodes;
  for (int i = 0; i < 16; ++i) {
    nodes.put(2.0f);  // The largest below.
    nodes.put(static_cast<std::uint8_t>(i == 0 ? 0x80 : i < 15 ? 0x01 : 0x03));
  }
  for (const float value : {2.0f, -1.0f}) {
    nodes.put(value);
    nodes.put(std::uint8_t{0});
  }
  EXPECT_EQ(full, "# Octomap OcTree file\nid OcTree\nsize 18\nres 0.5\ndata\n" + nodes.bytes());
}

TEST(OctomapFile, AWholeWorldOfOneStateHasEightLeaves) {
  MapOptions options;
  options.min_cell_size = 1.0;
  options.max_cell_size = 32768.0;
  MapBuilder<PaperMap<2, 3>> builder(options);
  builder.fill({-32768, -32768, -32768}, {32768, 32768, 32768}, -1.0f);
  const auto map = std::move(builder).finish();
  EXPECT_EQ(map.stats().observed_leaves, 8u);
  for (const OctomapFormat format : {OctomapFormat::binary, OctomapFormat::full}) {
    const std::string bytes = octomap_bytes(map, format);
    const auto again = octomap_from_bytes<PaperMap<2, 3>>(bytes);
    for (const double far : {-32767.5, 0.5, 32767.5})
      EXPECT_EQ(state(again, Vector<3>::Constant(far)), CellState::free);
    EXPECT_EQ(state(again, Vector<3>::Constant(32768.5)), CellState::unknown);
  }
}

TEST(OctomapFile, WhatLiesTooFarIsRefused) {
  MapOptions options;
  options.min_cell_size = 0.1;
  MapBuilder<PaperMap<2, 3>> builder(options);
  builder.fill({32768, 0, 0}, {32769, 1, 1}, 1.0f);
  const auto map = std::move(builder).finish();
  expect_refused([&] { static_cast<void>(octomap_bytes(map, OctomapFormat::full)); }, "16 levels end 3276.8");
  const auto coarse = octomap_from_bytes<PaperMap<2, 3>>(octomap_bytes(map, OctomapFormat::full, 0.3));
  EXPECT_EQ(coarse.stats().observed_leaves, 1u);
  EXPECT_THROW(static_cast<void>(octomap_bytes(map, OctomapFormat::full, 0.0)), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(octomap_bytes(map, OctomapFormat::full, NAN)), std::invalid_argument);
}

TEST(OctomapFile, ColoursComeBackWithTheirCells) {
  const auto map = room<AdaptiveMap<2, 3>>();
  Layer<2, 3, MeanValue<3>> colors(map.tree().geometry());
  Random random(8);
  std::size_t colored = 0;
  for_each_leaf(map.tree(), [&](const auto& leaf) {
    if (leaf.cell().state() != CellState::occupied || random.chance(0.2)) return;
    MeanValue<3> value;
    const auto level = [&] { return static_cast<float>(random.integer(0, 3) * 80); };
    value.add({level(), level(), level()});
    const Box<3> box = map.tree().box(leaf.index);
    colors.join(leaf.index, 0.5 * (box.lower + box.upper), value);
    ++colored;
  });
  ASSERT_GT(colored, 200u);
  const std::string bytes = octomap_bytes(map, OctomapFormat::full, {}, &colors);
  EXPECT_NE(bytes.substr(0, 200).find("\nid ColorOcTree\n"), std::string::npos);
  std::optional<OctomapColors<PaperMap<2, 3>>> again;
  const auto loaded = octomap_from_bytes<PaperMap<2, 3>>(bytes, {}, &again);
  ASSERT_TRUE(again);
  EXPECT_EQ(octomap_bytes(loaded, OctomapFormat::full, {}, &*again), bytes);
  std::size_t found = 0;
  for_each_leaf(map.tree(), [&](const auto& leaf) {
    const Box<3> box = map.tree().box(leaf.index);
    const Vector<3> centre = 0.5 * (box.lower + box.upper);
    const auto other = loaded.tree().find_leaf(centre);
    if (leaf.cell().state() == CellState::unknown) return;
    ASSERT_EQ(other->cell().log_odds(), leaf.cell().log_odds());
    const MeanValue<3> own = colors.of(leaf.index);
    const MeanValue<3> theirs = again->of(leaf.index);
    ASSERT_EQ(theirs.is_empty(), own.is_empty());
    if (own.is_empty()) return;
    ASSERT_EQ(theirs.mean(), own.mean());
    ++found;
  });
  EXPECT_EQ(found, colored);
  // In larger cells, the mean of what overlaps.
  const std::string coarse = octomap_bytes(map, OctomapFormat::full, 0.2, &colors);
  static_cast<void>(octomap_from_bytes<PaperMap<2, 3>>(coarse, {}, &again));
  ASSERT_TRUE(again);
  int means = 0;
  again->for_each([&](const auto&, const Vector<3>& centre, const MeanValue<3>& value) {
    MeanValue<3> joined;
    colors.for_each([&](const auto&, const Vector<3>& part, const MeanValue<3>& own) {
      if (((part - centre).cwiseAbs().maxCoeff()) < 0.1) joined.join(own);
    });
    if (joined.is_empty()) return;  // Of a larger leaf.
    for (std::size_t i = 0; i < 3; ++i) ASSERT_NEAR(value.mean()[i], joined.mean()[i], 0.51f);
    ++means;
  });
  EXPECT_GT(means, 100);
  static_cast<void>(octomap_from_bytes<PaperMap<2, 3>>(octomap_bytes(map, OctomapFormat::full), {}, &again));
  EXPECT_FALSE(again);
}

TEST(OctomapFile, WhiteThingsAreNotWithoutColour) {
  MeanValue<3> white;
  white.add({255.0f, 255.0f, 255.0f});
  EXPECT_EQ(detail::octomap_color(white), (detail::OctomapColor{254, 254, 254}));
  EXPECT_EQ(detail::octomap_color({}), detail::kOctomapNoColor);
}

TEST(OctomapFile, OldHeadersAndThoseOfColorOcTreeAreRead) {
  const auto map = room<PaperMap<2, 3>>();
  const std::string now = octomap_bytes(map, OctomapFormat::binary);
  const auto header = detail::read_octomap_header(now);
  ByteWriter old;
  old.put(std::int32_t{3});
  old.put(header.cell_size);
  old.put(static_cast<std::uint32_t>(header.nodes));
  old.bytes().append(header.data);
  ASSERT_TRUE(is_octomap_file(old.bytes()));
  const auto loaded = octomap_from_bytes<PaperMap<2, 3>>(old.bytes());
  EXPECT_EQ(octomap_bytes(loaded, OctomapFormat::binary), now);
  std::string colored = now;
  colored.replace(colored.find("id OcTree"), 9, "id ColorOcTree");
  std::optional<OctomapColors<PaperMap<2, 3>>> none;
  const auto same = octomap_from_bytes<PaperMap<2, 3>>(colored, {}, &none);
  EXPECT_EQ(octomap_bytes(same, OctomapFormat::binary), now) << "its payload is an OcTree's";
  EXPECT_FALSE(none);
  for (const std::size_t cut : {3u, 4u, 9u, 15u, 17u})
    EXPECT_THROW(static_cast<void>(octomap_from_bytes<PaperMap<2, 3>>(old.bytes().substr(0, cut))),
                 std::runtime_error);
}

TEST(OctomapFile, ZeroLogOddsIsUnknown) {
  MapOptions options;
  PaperMap<2, 3> map(options);
  MapBuilder<PaperMap<2, 3>> builder(options);
  builder.fill({0, 0, 0}, {1, 1, 1}, 1.0f);
  builder.fill({0, 0, 0}, {1, 1, 1}, 0.0f);
  const auto filled = std::move(builder).finish();
  filled.check_invariants();
  EXPECT_EQ(octomap_bytes(filled, OctomapFormat::full), octomap_bytes(map, OctomapFormat::full));
}

std::string refusal(const std::string& bytes) {
  return refusal_by<std::runtime_error>(
      [&] { static_cast<void>(octomap_from_bytes<PaperMap<2, 3>>(bytes)); });
}

TEST(OctomapFile, DamagedFilesAreRefused) {
  const auto map = room<PaperMap<2, 3>>(0.3);
  int cut = 0;
  for (const OctomapFormat format : {OctomapFormat::binary, OctomapFormat::full}) {
    const std::string bytes = octomap_bytes(map, format);
    ASSERT_EQ(refusal(bytes), "accepted");
    for (std::size_t n = 0; n < bytes.size(); n += n < 100 ? 1 : 97, ++cut)
      EXPECT_NE(refusal(bytes.substr(0, n)), "accepted") << n << " bytes of " << bytes.size();
    EXPECT_NE(refusal(bytes + '\0').find("nodes end at byte"), std::string::npos);
  }
  EXPECT_GT(cut, 200);
  const auto with = [](const std::string& header, const std::string& data = "") {
    return refusal("# Octomap OcTree file\n" + header + "data\n" + data);
  };
  EXPECT_EQ(with("# a remark\n\nid OcTree\nsize 0\nres 0.1\n"), "accepted");
  EXPECT_NE(with("id CountingOcTree\nsize 0\nres 0.1\n").find("line 2: found 'id CountingOcTree'"),
            std::string::npos);
  EXPECT_NE(with("id OcTree\nsize many\nres 0.1\n").find("line 3: found 'size many'"), std::string::npos);
  EXPECT_NE(with("id OcTree\nsize 0\nres -1\n").find("line 4: found 'res -1'"), std::string::npos);
  EXPECT_NE(with("id OcTree\nsize 0\nres 1e-320\n"), "accepted");
  EXPECT_NE(with("id OcTree\nres 0.1\n").find("without 'size' or 'res'"), std::string::npos);
  const std::string leaf("\0\0\x80\x3f\0", 5);  // 1.0f without children
  EXPECT_EQ(with("size 1\nres 0.1\n", leaf), "accepted");
  EXPECT_NE(with("size 2\nres 0.1\n", leaf).find("found 1 nodes, expected 2"), std::string::npos);
  const std::string nan("\0\0\xc0\x7f\0", 5);
  EXPECT_NE(with("size 1\nres 0.1\n", nan).find("not a number, at byte 5"), std::string::npos);
  std::string deep;
  for (int i = 0; i < 18; ++i) deep += std::string("\0\0\x80\x3f\x01", 5);
  EXPECT_NE(with("size 18\nres 0.1\n", deep).find("below the 16th level"), std::string::npos);
  EXPECT_NE(refusal("hello\n").find("not an OctoMap file"), std::string::npos);
}

TEST(OctomapFile, FilesAreWrittenByName) {
  const auto folder = std::filesystem::path(testing::TempDir()) / "ndtree_octomap_file";
  std::filesystem::create_directories(folder);
  const auto map = room<AdaptiveMap<2, 3>>(0.3);
  save_octomap(map, folder / "room.bt");
  save_octomap(map, folder / "room.ot", 0.6);
  EXPECT_EQ(read_file(folder / "room.bt"), octomap_bytes(map, OctomapFormat::binary));
  EXPECT_EQ(read_file(folder / "room.ot"), octomap_bytes(map, OctomapFormat::full, 0.6));
  const auto loaded = load_octomap<PaperMap<2, 3>>(folder / "room.ot");
  EXPECT_EQ(loaded.options().min_cell_size, 0.6);
  EXPECT_THROW(save_octomap(map, folder / "room.txt"), std::invalid_argument);
  EXPECT_FALSE(std::filesystem::exists(folder / "room.txt"));
  write_file(folder / "cut.bt", read_file(folder / "room.bt").substr(0, 90));
  expect_refused<std::runtime_error>(
      [&] { static_cast<void>(load_octomap<PaperMap<2, 3>>(folder / "cut.bt")); }, "cut.bt: ");
  std::filesystem::remove_all(folder);
}

#ifdef NDTREE_HAVE_OCTOMAP

/// Leaves by their smallest corner in cells, and their edge.
std::map<std::tuple<long, long, long, long>, float> leaves_of(const OctomapBaseline& map) {
  const OctomapLeaves all = map.leaves();
  std::map<std::tuple<long, long, long, long>, float> result;
  const double unit = map.cell_size();
  for (Eigen::Index i = 0; i < all.size.size(); ++i)
    result[{std::lround(all.lower(0, i) / unit), std::lround(all.lower(1, i) / unit),
            std::lround(all.lower(2, i) / unit), std::lround(all.size[i] / unit)}] = all.log_odds[i];
  return result;
}

template <class Map>
class OctomapFile : public testing::Test {};
using Maps = testing::Types<FixedMap<2, 3>, PaperMap<2, 3>, AdaptiveMap<3, 3>>;
TYPED_TEST_SUITE(OctomapFile, Maps, );

TYPED_TEST(OctomapFile, OctomapItselfReadsIt) {
  const auto map = room<TypeParam>();
  for (const double size : {0.1, 0.07}) {
    std::size_t known = 0;
    std::istringstream ot(octomap_bytes(map, OctomapFormat::full, size));
    std::istringstream bt(octomap_bytes(map, OctomapFormat::binary, size));
    const auto full = OctomapBaseline::read_octomap(ot);
    const auto binary = OctomapBaseline::read_octomap(bt);
    EXPECT_EQ(full.cell_size(), size);
    for (const Vector<3>& point : centres(size)) {
      const auto cell = cell_at(map, point);
      ASSERT_EQ(full.log_odds(point).value_or(0.0f), cell.log_odds()) << point.transpose();
      ASSERT_EQ(state(binary, point), cell.state()) << point.transpose();
      ASSERT_EQ(binary.log_odds(point).has_value(), cell.state() != CellState::unknown);
      known += cell.state() != CellState::unknown;
    }
    EXPECT_GT(known, 4000u);
    EXPECT_EQ(full.stats().leaves, full.stats().leaves_pruned) << "nothing is left to prune";
    std::ostringstream again;
    full.write_ot(again);
    std::istringstream of_theirs(again.str());
    EXPECT_EQ(leaves_of(OctomapBaseline::read_octomap(of_theirs)), leaves_of(full))
        << "inner nodes are right";
  }
}

TEST(OctomapFile, WhatOctomapWroteIsRead) {
  OctomapBaseline octomap(0.1, room_options(0.1), OctomapInsertion::scan_at_once);
  Random random(7);
  Scan<3> scan;
  scan.origins = Vector<3>::Constant(0.01);
  scan.endpoints.resize(3, 1000);
  for (Eigen::Index i = 0; i < 1000; ++i)
    scan.endpoints.col(i) =
        Vector<3>(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1)).normalized() * 2.0;
  for (int i = 0; i < 8; ++i) octomap.insert(scan);  // Until log-odds saturate and leaves are pruned.
  std::ostringstream ot, bt;
  octomap.write_ot(ot);
  octomap.write_bt(bt);
  const auto full = octomap_from_bytes<PaperMap<2, 3>>(ot.str());
  const auto binary = octomap_from_bytes<PaperMap<2, 3>>(bt.str());
  std::size_t known = 0;
  for (const Vector<3>& point : centres(0.1)) {
    ASSERT_EQ(cell_at(full, point).log_odds(), octomap.log_odds(point).value_or(0.0f));
    ASSERT_EQ(state(binary, point), state(octomap, point));
    known += octomap.log_odds(point).has_value();
  }
  EXPECT_GT(known, 10000u);
  std::istringstream ours(octomap_bytes(full, OctomapFormat::full));
  EXPECT_EQ(leaves_of(OctomapBaseline::read_octomap(ours)).size(), octomap.stats().leaves_pruned);
}

#endif  // NDTREE_HAVE_OCTOMAP

}  // namespace
}  // namespace ndtree::test::test_octomap_file
