// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Plain-text beams: separators, grouping into scans, and what is refused with which words.
#include <gtest/gtest.h>

#include <cmath>
#include <iomanip>
#include <sstream>
#include <string>
#include <vector>

#include "ndtree/core/random.hpp"
#include "ndtree/logs/xyz.hpp"
#include "refusals.hpp"

namespace ndtree::test::test_xyz {
namespace {

using ndtree::Scan;

template <int D>
std::vector<Scan<D>> read(const std::string& text) {
  std::istringstream in(text);
  std::vector<Scan<D>> scans;
  ndtree::read_xyz<D>(in, [&](Scan<D>&& scan) { scans.push_back(std::move(scan)); });
  return scans;
}

template <int D>
std::string message_of(const std::string& text) {
  return refusal_by<std::runtime_error>([&] { read<D>(text); });
}

std::string dimension_of(const std::string& text) {
  std::istringstream in(text);
  try {
    return std::to_string(ndtree::xyz_dimension(in));
  } catch (const std::runtime_error& error) {
    return error.what();
  }
}

TEST(Xyz, AllSeparatorsReadAlike) {
  for (const char* line : {"1 2 -3 4.5", "1,2,-3,4.5", "1;2;-3;4.5", "1\t2\t-3\t4.5", "  1 , 2\t; -3 ,4.5  ",
                           "1 2 -3 4.5 # a comment", "1 2 -3 4.5\r", "+1 2e0 -3 45e-1", "1,2,-3,4.5,",
                           "1 2 -3 4.5 1", "\xEF\xBB\xBF\x31 2 -3 4.5"}) {
    const auto scans = read<2>(line);
    ASSERT_EQ(scans.size(), 1u) << line;
    EXPECT_EQ(scans[0].origins.col(0), ndtree::Vector<2>(1, 2)) << line;
    ASSERT_EQ(scans[0].size(), 1) << line;
    EXPECT_EQ(scans[0].endpoints.col(0), ndtree::Vector<2>(-3, 4.5)) << line;
    EXPECT_TRUE(scans[0].returned[0]) << line;
  }
}

TEST(Xyz, ConsecutiveEqualOriginsAreOneScan) {
  const auto scans = read<3>(
      "# origin, end point, returned\n"
      "0 0 0  1 0 0  1\n"
      "0 0 0  2 0 0  0\n"
      "\n"
      "# still the same scan\n"
      "0 0 -0  3 0 0\n"
      "0 0 1  4 0 0\n"
      "0 0 0  5 0 0\n"
      "0 0 0  nan nan nan\n");
  ASSERT_EQ(scans.size(), 3u);
  ASSERT_EQ(scans[0].size(), 3);
  EXPECT_EQ(scans[0].endpoints.row(0), (Eigen::RowVector3d(1, 2, 3)));
  EXPECT_TRUE(scans[0].returned[0]);
  EXPECT_FALSE(scans[0].returned[1]);
  EXPECT_TRUE(scans[0].returned[2]);
  EXPECT_EQ(scans[1].origins.col(0), ndtree::Vector<3>(0, 0, 1));
  EXPECT_EQ(scans[1].size(), 1);
  ASSERT_EQ(scans[2].size(), 2);
  EXPECT_TRUE(scans[2].endpoints.col(1).array().isNaN().all());
  for (const Scan<3>& scan : scans) EXPECT_EQ(scan.view().size, scan.size());
}

TEST(Xyz, NothingInNothingOut) {
  EXPECT_TRUE(read<2>("").empty());
  EXPECT_TRUE(read<3>("# only words\n\n  \t\r\n").empty());
}

TEST(Xyz, NumbersWrittenInFullComeBackBitForBit) {
  ndtree::Random random(7);
  std::ostringstream text;
  text << std::setprecision(17);
  ndtree::Points<3> expected(3, 500);
  for (Eigen::Index i = 0; i < expected.cols(); ++i) {
    text << "1e6 -2 3";
    for (int k = 0; k < 3; ++k) {
      expected(k, i) = random.normal() * std::pow(10.0, random.uniform(-12.0, 12.0));
      text << ' ' << expected(k, i);
    }
    text << '\n';
  }
  const auto scans = read<3>(text.str());
  ASSERT_EQ(scans.size(), 1u);
  EXPECT_EQ(scans[0].endpoints, expected);
}

TEST(Xyz, ErrorsNameLineAndExpectation) {
  EXPECT_EQ(message_of<2>("1 2 3 4\n1 2 3"), "line 2: expected 4 or 5 numbers, found 3");
  EXPECT_EQ(message_of<2>("\n1 2 3 4 1 0"), "line 2: expected 4 or 5 numbers, found 6");
  EXPECT_EQ(message_of<3>("1 2 3 4"), "line 1: expected 6 or 7 numbers, found 4");
  EXPECT_EQ(message_of<3>("1 2 3 4 5 6 7 8 9 10"), "line 1: expected 6 or 7 numbers, found 10");
  EXPECT_EQ(message_of<2>("#\n#\n1 2 three 4"), "line 3: expected a number in column 3, found 'three'");
  EXPECT_EQ(message_of<2>("1,2,,4"), "line 1: expected a number in column 3, found ''");
  EXPECT_EQ(message_of<2>(",1,2,3,4"), "line 1: expected a number in column 1, found ''");
  EXPECT_EQ(message_of<2>("1 2 3 4 0.5"), "line 1: expected 0 or 1 in column 5, found 0.5");
  EXPECT_EQ(message_of<2>("1 2 3 4 nan"), "line 1: expected 0 or 1 in column 5, found nan");
  EXPECT_EQ(message_of<2>(std::string(50, 'x')),
            "line 1: expected a number in column 1, found '" + std::string(40, 'x') + "...'");
}

TEST(Xyz, DimensionComesFromTheFirstLineWithNumbers) {
  EXPECT_EQ(dimension_of("# x y\n\n1 2 3 4\n1 2"), "2");
  EXPECT_EQ(dimension_of("1 2 3 4 1"), "2");
  EXPECT_EQ(dimension_of("1;2;3;4;5;6"), "3");
  EXPECT_EQ(dimension_of("1 2 3 4 5 6 0\n"), "3");
  EXPECT_EQ(dimension_of("\n1 2 3"), "line 2: expected 4 or 5 numbers in 2-D, 6 or 7 in 3-D, found 3");
  EXPECT_EQ(dimension_of("1 2 3 4 5 6 7 8"),
            "line 1: expected 4 or 5 numbers in 2-D, 6 or 7 in 3-D, found 8");
  EXPECT_EQ(dimension_of("# empty\n"), "no line with numbers: expected an origin and an end point a line");

  std::istringstream in("first line read by somebody else\n1 2 3 4");
  std::string line;
  std::getline(in, line);
  EXPECT_EQ(ndtree::xyz_dimension(in), 2);
  std::getline(in, line);
  EXPECT_EQ(line, "1 2 3 4") << "the stream is left where it was";
}

}  // namespace
}  // namespace ndtree::test::test_xyz
