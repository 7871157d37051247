// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <random>
#include <string>

#include "ndtree/ndtree.hpp"
#include "refusals.hpp"
#include "shapes.hpp"

namespace ndtree::test::test_map_file {
namespace {

template <class Type>
class MapFile : public testing::Test {
 public:
  static constexpr int N = Type::kBranching;
  static constexpr int D = Type::kDim;

  static Scan<D> scan(std::uint32_t seed) {
    std::mt19937 random(seed);
    const auto uniform = [&] { return static_cast<double>(random()) / 4294967296.0 * 2.0 - 1.0; };
    Scan<D> scan;
    scan.origins.resize(D, 1);
    scan.endpoints.resize(D, 60);
    for (int a = 0; a < D; ++a) {
      scan.origins(a, 0) = uniform();
      for (int i = 0; i < 60; ++i) scan.endpoints(a, i) = 3.0 * uniform();
    }
    return scan;
  }

  template <class Map>
  static Map filled() {
    MapOptions options;
    options.min_cell_size = 0.1;
    options.max_cell_size = 0.9;
    options.range_sigma = 0.0215;
    Map map(options);
    for (std::uint32_t seed = 1; seed <= 20; ++seed) map.insert(scan(seed));
    return map;
  }

  template <class Map>
  static void expect_round_trip() {
    Map map = filled<Map>();
    ASSERT_GT(map.stats().observed_leaves, 5u);
    const std::string bytes = to_bytes(map);
    Map again = from_bytes<Map>(bytes);
    EXPECT_EQ(to_bytes(again), bytes);
    EXPECT_EQ(map_file_header(bytes).refinement, Map::RefinementType::kName);
    EXPECT_EQ(again.stats().observed_leaves, map.stats().observed_leaves);
    EXPECT_EQ(again.stats().nodes, map.stats().nodes);
    EXPECT_EQ(again.counters().updates, map.counters().updates);
    map.insert(scan(99));
    again.insert(scan(99));
    EXPECT_EQ(to_bytes(again), to_bytes(map)) << "a loaded map goes on as the original";
  }
};

TYPED_TEST_SUITE(MapFile, TwoShapes, ShapeNames);

TYPED_TEST(MapFile, SaveLoadSaveIsByteEqual) {
  using Self = TestFixture;
  this->template expect_round_trip<AdaptiveMap<Self::N, Self::D>>();
  this->template expect_round_trip<PaperMap<Self::N, Self::D>>();
  this->template expect_round_trip<FixedMap<Self::N, Self::D>>();
}

TYPED_TEST(MapFile, NothingBeforeTheEndIsAMap) {
  using Map = PaperMap<TestFixture::N, TestFixture::D>;
  const std::string bytes = to_bytes(this->template filled<Map>());
  int refused = 0;
  const std::size_t step = bytes.size() / 200 + 1;
  for (std::size_t length = 0; length < bytes.size(); length += step) {
    EXPECT_THROW(static_cast<void>(from_bytes<Map>(bytes.substr(0, length))), std::runtime_error) << length;
    ++refused;
  }
  EXPECT_GT(refused, 50);
  EXPECT_THROW(static_cast<void>(from_bytes<Map>(bytes + '\0')), std::runtime_error);
}

/// A file whose checksum is right, although its content is not.
std::string with_checksum(std::string bytes) {
  bytes.resize(bytes.size() - 4);
  ByteWriter end;
  end.put(crc32(bytes));
  return bytes + end.bytes();
}

TEST(MapFileContent, ImpossibleContentIsRefusedDespiteAGoodChecksum) {
  using Map = PaperMap<2, 2>;
  Map map;
  Scan<2> scan;
  scan.origins = Vector<2>(0.1, 0.1);
  scan.endpoints = Vector<2>(1.0, 1.0);
  map.insert(scan);
  const std::string bytes = to_bytes(map);
  ASSERT_NO_THROW(static_cast<void>(from_bytes<Map>(with_checksum(bytes))));
  int refused = 0;
  for (std::size_t i = 20; i + 4 < bytes.size(); ++i) {
    std::string broken = bytes;
    broken[i] = static_cast<char>(broken[i] ^ 0x80);
    try {  // Some bytes may have any value; then the map must at least be consistent.
      Map accepted = from_bytes<Map>(with_checksum(broken));
      accepted.check_invariants();
      for (const double x : {-30.0, 30.0})
        for (const double y : {-30.0, 30.0}) {
          scan.endpoints = Vector<2>(x, y);
          if (accepted.options().min_cell_size > 0.01) accepted.insert(scan, 50.0);
        }
    } catch (const std::runtime_error&) {
      ++refused;
    }
  }
  EXPECT_GT(refused, 20);
}

TEST(MapFileContent, ErrorsNameWhatIsWrong) {
  const auto message = [](const std::string& bytes) {
    return refusal_by<std::runtime_error>([&] { static_cast<void>(from_bytes<PaperMap<2, 2>>(bytes)); });
  };
  const std::string good = to_bytes(PaperMap<2, 2>());
  std::string version = good;
  version[8] = 7;
  std::string damaged = good;
  damaged[good.size() / 2] ^= 1;
  const struct {
    std::string bytes;
    const char* expected;
  } rows[] = {
      {"", "the file is empty: not an ndtree map"},
      {"hello, world", "not an ndtree map"},
      {version, "format version 7: this ndtree reads versions 2 to 6"},
      {good.substr(0, good.size() - 3), "truncated or overlong"},
      {damaged, "damaged: the checksum does not match"},
      {to_bytes(PaperMap<2, 3>()),
       "holds a map with branching 2, dim 3 and refinement 'paper', not branching 2"},
      {to_bytes(FixedMap<2, 2>()), "refinement 'fixed', not branching 2, dim 2 and 'paper'"},
  };
  for (const auto& row : rows)
    EXPECT_NE(message(row.bytes).find(row.expected), std::string::npos) << message(row.bytes);
}

TEST(MapFileContent, ARootThatCouldNotGrowOnIsRefused) {
  using Map = PaperMap<2, 2>;
  const Map map;
  std::string bytes = to_bytes(map);
  const std::size_t node = bytes.size() - 8;  // The one leaf, before the checksum.
  const std::size_t level = node - 2 * sizeof(std::int64_t) - sizeof(std::int32_t);
  bytes[level] = static_cast<char>(map.tree().geometry().coarsest_level());
  EXPECT_THROW(static_cast<void>(from_bytes<Map>(with_checksum(bytes))), std::runtime_error);
}

class MapFileOnDisk : public testing::Test {
 protected:
  void SetUp() override {
    folder_ =
        std::filesystem::temp_directory_path() /
        ("ndtree_test_" + std::to_string(std::random_device{}()) + std::to_string(std::random_device{}()));
    std::filesystem::create_directory(folder_);
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }
  std::filesystem::path folder_;
};

TEST_F(MapFileOnDisk, AppearsWholeAndAlone) {
  PaperMap<2, 3> map;
  Scan<3> scan;
  scan.origins = Vector<3>(0.0, 0.0, 0.0);
  scan.endpoints = Vector<3>(1.0, 2.0, 3.0);
  save(map, folder_ / "hall.ndt");
  map.insert(scan);
  save(map, folder_ / "hall.ndt");
  EXPECT_EQ(to_bytes(load<PaperMap<2, 3>>(folder_ / "hall.ndt")), to_bytes(map));
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(folder_), {}), 1);
}

TEST_F(MapFileOnDisk, FailuresNameTheFileAndLeaveNothing) {
  const PaperMap<2, 3> map;
  try {
    save(map, folder_ / "missing" / "hall.ndt");
    FAIL() << "wrote into a folder that does not exist";
  } catch (const std::filesystem::filesystem_error& error) {
    EXPECT_NE(std::string(error.what()).find("hall.ndt"), std::string::npos) << error.what();
    EXPECT_EQ(error.code(), std::errc::no_such_file_or_directory);
  }
  std::filesystem::create_directory(folder_ / "taken");
  EXPECT_THROW(save(map, folder_ / "taken"), std::filesystem::filesystem_error);
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(folder_), {}), 1);
  EXPECT_THROW(static_cast<void>(load<PaperMap<2, 3>>(folder_ / "none.ndt")),
               std::filesystem::filesystem_error);
  std::ofstream(folder_ / "text.ndt") << "not a map";
  expect_refused<std::runtime_error>([&] { static_cast<void>(load<PaperMap<2, 3>>(folder_ / "text.ndt")); },
                                     "text.ndt: not an ndtree map");
  expect_refused<std::invalid_argument>([&] { save(map, folder_ / "hall.bt"); }, "hall.bt: another format");
}

TEST(Crc32, IsThatOfIso3309) {
  EXPECT_EQ(crc32("123456789"), 0xcbf43926u);  // The check value of the CRC catalogue.
  EXPECT_EQ(crc32(""), 0u);
}

TEST(ByteStream, NumbersAreLittleEndianAndComeBack) {
  ByteWriter out;
  out.put(std::uint32_t{0x01020304u});
  out.put(-2.5);
  out.put(std::int64_t{-7});
  out.put(1.5f);
  out.put_text("abc");
  EXPECT_EQ(out.bytes().substr(0, 4), std::string("\x04\x03\x02\x01"));
  ByteReader in(out.bytes());
  EXPECT_EQ(in.get<std::uint32_t>(), 0x01020304u);
  EXPECT_EQ(in.get<double>(), -2.5);
  EXPECT_EQ(in.get<std::int64_t>(), -7);
  EXPECT_EQ(in.get<float>(), 1.5f);
  EXPECT_EQ(in.get_text(), "abc");
  EXPECT_TRUE(in.at_end());
  EXPECT_THROW(static_cast<void>(in.get<std::uint8_t>()), std::runtime_error);
}

}  // namespace
}  // namespace ndtree::test::test_map_file
