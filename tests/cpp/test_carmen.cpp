// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// CARMEN records become scans: geometry computed by hand, and what is refused with which words.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <sstream>
#include <string>
#include <vector>

#include "ndtree/logs/carmen.hpp"
#include "refusals.hpp"

namespace ndtree::test::test_carmen {
namespace {

using ndtree::CarmenOptions;
using ndtree::CarmenParser;
using ndtree::FieldOfViewSource;
using ndtree::Scan;

constexpr double kPi = 3.14159265358979324;
const std::string kTail = " 1 2 0.5  9 9 9  12.25 host 13.5";

std::string ranges(int n, const std::string& value = " 1") {
  std::string text;
  for (int i = 0; i < n; ++i) text += value;
  return text;
}

std::string message_of(const std::vector<std::string>& lines, CarmenOptions options = {}) {
  CarmenParser parser(options);
  return refusal_by<std::runtime_error>([&] {
    for (const std::string& line : lines) parser.parse_line(line);
  });
}

TEST(Carmen, FieldOfViewIsCentredAhead) {
  CarmenOptions options;
  options.field_of_view = 1.5 * kPi;
  const auto scan = CarmenParser(options).parse_line("FLASER 3 1 1 1 0 0 0");
  ASSERT_TRUE(scan);
  const double diagonal = std::sqrt(0.5);
  const ndtree::Points<2> expected =
      (ndtree::Points<2>(2, 3) << -diagonal, 1, -diagonal, -diagonal, 0, diagonal).finished();
  EXPECT_TRUE(scan->endpoints.isApprox(expected, 1e-12)) << scan->endpoints;
  EXPECT_EQ(scan->stamp, 0.0);
}

TEST(Carmen, TheLogOrTheNumberOfBeamsSaysTheFieldOfView) {
  struct Case {
    const char* params;
    int beams;
    double degrees;
    FieldOfViewSource source;
  };
  const Case cases[] = {
      {"", 180, 180, FieldOfViewSource::beams},
      {"", 181, 180, FieldOfViewSource::beams},
      {"", 360, 180, FieldOfViewSource::beams},
      {"", 361, 180, FieldOfViewSource::beams},
      {"", 401, 100, FieldOfViewSource::beams},
      {"", 682, 240, FieldOfViewSource::beams},
      {"", 541, 270, FieldOfViewSource::beams},
      {"", 1081, 270, FieldOfViewSource::beams},
      {"", 77, 180, FieldOfViewSource::none},
      {"PARAM laser_front_laser_fov 240.0 nohost 0", 682, 240, FieldOfViewSource::param},
      {"PARAM laser_front_laser_fov 270 nohost 0\r", 1081, 270, FieldOfViewSource::param},
      {"PARAM laser_front_laser_fov 190 0 host 0", 181, 190, FieldOfViewSource::param},
      {"PARAM robot_front_laser_fov 90 0 host 0", 91, 90, FieldOfViewSource::param},
      {"PARAM laser_laser1_fov 3.14159265358979 host 0", 513, 180, FieldOfViewSource::param},
      {"PARAM laser_front_laser_resolution 0.25 host 0", 721, 180, FieldOfViewSource::param},
      {"PARAM laser_front_laser_resolution 0.5 host 0", 500, 250, FieldOfViewSource::param},
      {"PARAM laser_front_laser_resolution 1.0 host 0", 361, 180, FieldOfViewSource::beams},
      {"PARAM laser_rear_laser_fov 240 host 0", 101, 180, FieldOfViewSource::none},
      {"PARAM laser_laser2_fov 240 host 0", 101, 180, FieldOfViewSource::none},
      {"PARAM laser_front_laser_fov auto host 0", 101, 180, FieldOfViewSource::none},
      {"PARAM laser_front_laser_fov 0 host 0", 101, 180, FieldOfViewSource::none},
      {"PARAM camera_fov 60 host 0", 101, 180, FieldOfViewSource::none},
  };
  for (const Case& c : cases) {
    const std::string record = "FLASER " + std::to_string(c.beams) + ranges(c.beams, " 2.5") + kTail;
    CarmenOptions overruled;
    overruled.field_of_view = 1.0;
    for (const bool is_overruled : {false, true}) {
      CarmenParser parser(is_overruled ? overruled : CarmenOptions());
      EXPECT_FALSE(parser.field_of_view());
      EXPECT_FALSE(parser.parse_line(c.params));
      const auto scan = parser.parse_line(record);
      ASSERT_TRUE(scan) << c.params;
      EXPECT_EQ(scan->origins, Points<2>(Vector<2>(1.0, 2.0)));
      EXPECT_EQ(scan->stamp, 12.25);
      const double fov = is_overruled ? 1.0 : c.degrees * kPi / 180.0;
      const double last = 0.5 + 0.5 * fov - (c.beams % 2 == 0 ? fov / c.beams : 0.0);
      EXPECT_NEAR(scan->endpoints(0, 0), 1.0 + 2.5 * std::cos(0.5 - 0.5 * fov), 1e-9) << c.params << c.beams;
      EXPECT_NEAR(scan->endpoints(1, c.beams - 1), 2.0 + 2.5 * std::sin(last), 1e-9) << c.params << c.beams;
      EXPECT_EQ(parser.field_of_view()->second, is_overruled ? FieldOfViewSource::option : c.source)
          << c.params;
    }
  }
}

TEST(Carmen, ContradictingParametersAreDecidedByTheBeamsOrRefused) {
  const std::string fov = "PARAM laser_front_laser_fov ";
  const std::string step = "PARAM laser_front_laser_resolution ";
  struct Case {
    std::string fov;
    std::string step;
    int beams;
    double degrees;  // 0: refused
  };
  for (const Case& c : std::vector<Case>{{"240.0", "0.352", 682, 240},
                                         {"240", "0.3515625", 683, 240},
                                         {"270", "0.375", 721, 270},
                                         {"180", "1.0", 361, 180},
                                         {"180", "0.5", 541, 270},
                                         {"240", "0.352", 341, 240},
                                         {"200", "1.0", 801, 200},
                                         {"180", "1.0", 541, 0},
                                         {"100", "0.25", 700, 0}}) {
    const std::string beams = "FLASER " + std::to_string(c.beams) + ranges(c.beams) + " 0 0 0";
    if (c.degrees > 0.0) {
      CarmenParser parser;
      for (const std::string& line : {fov + c.fov, step + c.step}) EXPECT_FALSE(parser.parse_line(line));
      ASSERT_TRUE(parser.parse_line(beams));
      EXPECT_NEAR(parser.field_of_view()->first, c.degrees * kPi / 180.0, 1e-9) << c.beams;
    } else {
      EXPECT_NE(message_of({fov + c.fov, step + c.step, beams})
                    .find("line 3: FLASER: " + std::to_string(c.beams) +
                          " ranges, but PARAM records declare " + c.fov + ".0 degrees in steps of " + c.step +
                          ", expected them to fit, or the field of view as"),
                std::string::npos)
          << message_of({fov + c.fov, step + c.step, beams});
    }
  }
}

TEST(Carmen, AByteOrderMarkIsNoPartOfTheFirstRecord) {
  EXPECT_TRUE(
      CarmenParser().parse_line("\xEF\xBB\xBF"
                                "FLASER 3 1 1 1 0 0 0"));
}

TEST(Carmen, ReadingsAtTheMaximumDidNotReturn) {
  const auto scan = CarmenParser().parse_line("FLASER 6 79.99 80 81.83 81.91 inf 3" + kTail);
  ASSERT_TRUE(scan);
  const std::vector<bool> expected = {true, false, false, false, false, true};
  for (int i = 0; i < 6; ++i) EXPECT_EQ(scan->returned[i], expected[static_cast<std::size_t>(i)]) << i;
  const auto length = [&](int i) { return (scan->endpoints.col(i) - scan->origins.col(0)).norm(); };
  EXPECT_NEAR(length(2), 81.83, 1e-9) << "the end point stays where the log has it";
  EXPECT_FALSE(scan->endpoints.col(4).allFinite());
}

TEST(Carmen, UselessReadingsBecomeBeamsThatSayNothing) {
  const auto scan = CarmenParser().parse_line("FLASER 4 0 nan -1.5 0.0" + kTail);
  ASSERT_TRUE(scan);
  ASSERT_EQ(scan->size(), 4);
  EXPECT_EQ(scan->endpoints.col(0), scan->origins.col(0));
  EXPECT_TRUE(scan->endpoints.col(1).array().isNaN().all());
  EXPECT_TRUE(scan->endpoints.col(2).array().isNaN().all());
  EXPECT_EQ(scan->endpoints.col(3), scan->origins.col(0));
}

TEST(Carmen, RobotLaserCarriesItsOwnGeometry) {
  // type, start, field of view, resolution, maximum, accuracy, remission mode, n
  const std::string line =
      "ROBOTLASER1 0 -1 2 0.5 20 0.01 1 4 2 20 35 inf 2 700 800 "
      "3 4 0.25 3.1 4.1 0.2 0 0 0.5 0.4 1e6 99.5 robot 0.1\r";
  const auto scan = CarmenParser().parse_line(line);
  ASSERT_TRUE(scan);
  ASSERT_EQ(scan->size(), 4);
  EXPECT_EQ(scan->stamp, 99.5);
  EXPECT_EQ(scan->origins.col(0), ndtree::Vector<2>(3, 4));
  const std::vector<double> lengths = {2, 20, 20, 20};  // nothing is free beyond the stated maximum
  for (int i = 0; i < 4; ++i) {
    const double angle = 0.25 - 1.0 + 0.5 * i;
    const double length = lengths[static_cast<std::size_t>(i)];
    EXPECT_NEAR(scan->endpoints(0, i), 3 + length * std::cos(angle), 1e-12) << i;
    EXPECT_NEAR(scan->endpoints(1, i), 4 + length * std::sin(angle), 1e-12) << i;
    EXPECT_EQ(scan->returned[i], i == 0) << i;
  }
}

TEST(Carmen, RobotLaserWithoutAMaximumUsesTheOption) {
  const auto scan = CarmenParser().parse_line("ROBOTLASER1 0 0 0 0 0 0 0 2 79 81.91 0 0 0 0");
  ASSERT_TRUE(scan);
  EXPECT_TRUE(scan->returned[0]);
  EXPECT_FALSE(scan->returned[1]);
  EXPECT_NEAR(scan->endpoints(0, 1), 81.91, 1e-9);
}

TEST(Carmen, OtherLinesAreNoScansButCount) {
  CarmenParser parser;
  std::size_t lines = 0;
  for (const char* line : {"", "   \t", "# FLASER 1 1 0 0 0", "ODOM 1 2 3", "PARAM robot_x on",
                           "RLASER 1 1 0 0 0", "FLASERX 2", "ROBOTLASER2 0", "NEFF 8.4", "\r"}) {
    EXPECT_FALSE(parser.parse_line(line)) << line;
    EXPECT_EQ(parser.line_number(), ++lines);
  }
  EXPECT_EQ(lines, 10u);
}

TEST(Carmen, ErrorsNameLineRecordAndExpectation) {
  struct Case {
    std::string line;
    std::string expected;
  };
  const std::string robot = "ROBOTLASER1 0 -1 2 0.5 20 0.01 0 ";
  const std::string state = " 1 2 3 1 2 3 0 0 0 0 0 5.5 host 1";
  const std::vector<Case> cases = {
      {"FLASER 360" + ranges(212) + kTail, "FLASER: expected 360 ranges, found 212"},
      {"FLASER 360" + ranges(361) + kTail, "FLASER: expected 360 ranges, found 361"},
      {"FLASER 360" + ranges(212), "FLASER: expected 360 ranges, found 212"},
      {"FLASER 3 1 1 1 0 0", "FLASER: expected x y theta behind 3 ranges, found 2 numbers"},
      {"FLASER 3 1 1", "FLASER: expected 3 ranges, found 2"},
      {"FLASER", "FLASER: expected the number of ranges, found the end"},
      {"FLASER 2.5 1 1 0 0 0", "FLASER: expected the number of ranges, found 2.5"},
      {"FLASER -1 1 1 0 0 0", "FLASER: expected the number of ranges, found -1.0"},
      {"FLASER 1e300 1 1 0 0 0", "FLASER: expected the number of ranges, found 1e+300"},
      {"FLASER 3 1 1,5 1 0 0 0", "FLASER: expected a number in field 4, found '1,5'"},
      {"FLASER 2 1 1 0 0 0 0 0 0 7 host", "FLASER: expected a number in field 12, found 'host'"},
      {"FLASER 0 h 0", "FLASER: expected 0 ranges and 7 more numbers before the host name, found 0 numbers"},
      {"FLASER 0 1 2 3 4 5 6 h 0",
       "FLASER: expected 0 ranges and 7 more numbers before the host name, found 6 numbers"},
      {"FLASER 1 1 2 h 0",
       "FLASER: expected 1 ranges and 7 more numbers before the host name, found 2 numbers"},
      {"ROBOTLASER1 0 -1.57 3.14 0.0174 80 0.01 0 3 1 2 3 0 h 1.6",
       "ROBOTLASER1: expected 0 remissions and 12 more numbers before the host name, found 0 numbers"},
      {robot + "3 1 1", "ROBOTLASER1: expected 3 ranges, found 2"},
      {robot + "3 1 1 1", "ROBOTLASER1: expected the number of remissions behind 3 ranges, found the end"},
      {robot + "2 1 1 1.5 0" + state,
       "ROBOTLASER1: expected the number of remissions behind 2 ranges, found 1.5"},
      {robot + "2 1 1 3 50 60" + state, "ROBOTLASER1: expected 3 remissions, found 2"},
      {robot + "1 1 1" + state, "ROBOTLASER1: expected 1 remissions, found 0"},
      {robot + "1 1 0 1 2", "ROBOTLASER1: expected x y theta behind 0 remissions, found 2 numbers"},
      {"ROBOTLASER1 0 1 2", "ROBOTLASER1: expected the number of ranges, found the end"}};
  for (const Case& c : cases)
    EXPECT_EQ(message_of({"", "# second", c.line}), "line 3: " + c.expected) << c.line;
  EXPECT_EQ(cases.size(), 22u);
}

TEST(Carmen, RecordsCutShortAnywhereAreWholeScansOrErrors) {
  const std::vector<std::string> records = {
      "FLASER 3 1 1 1 1 2 0.5 9 9 9 12.25", "FLASER 0 1 2 0.5 9 9 9 12.25",
      "ROBOTLASER1 0 -1 2 0.5 20 0.01 0 2 1 1 1 700 1 2 0.5 1 2 3 0 0 0 0 0 5.5",
      "ROBOTLASER1 0 -1 2 0.5 20 0.01 0 0 0 1 2 0.5 1 2 3 0 0 0 0 0 5.5"};
  int scans = 0;
  for (const std::string& record : records) {
    for (std::size_t end = record.find(' '); end != std::string::npos; end = record.find(' ', end + 1)) {
      for (const char* const tail : {"", " host 1.5"}) {
        try {
          const auto scan = CarmenParser().parse_line(record.substr(0, end) + tail);
          ASSERT_TRUE(scan);
          ++scans;
          EXPECT_EQ(scan->origins.col(0), ndtree::Vector<2>(1, 2)) << record.substr(0, end) + tail;
        } catch (const std::runtime_error& error) {
          EXPECT_NE(std::string(error.what()).find("line 1: "), std::string::npos) << error.what();
        }
      }
    }
  }
  EXPECT_GT(scans, 10);
}

TEST(Carmen, ReadCarmenVisitsTheScansInOrderAndReportsTheLine) {
  std::istringstream log("# a log\nODOM 0 0 0\nFLASER 1 1 1 0 0\nFLASER 2 1 1 2 0 0\r\nFLASER 1 1 3 0 0");
  std::vector<double> xs;
  ndtree::read_carmen(log, [&](Scan<2>&& scan) { xs.push_back(scan.origins(0, 0)); });
  EXPECT_EQ(xs, (std::vector<double>{1, 2, 3}));

  std::istringstream broken("\nFLASER 1 x 0 0 0\n");
  EXPECT_EQ(refusal_by<std::runtime_error>([&] { ndtree::read_carmen(broken, [](Scan<2>&&) {}); }),
            "line 2: FLASER: expected a number in field 3, found 'x'");
}

TEST(Carmen, NumbersAreReadExactlyWhateverTheirSize) {
  using ndtree::detail::parse_number;
  EXPECT_EQ(parse_number("0.1"), 0.1);
  EXPECT_EQ(parse_number("+1.5e3"), 1500.0);
  EXPECT_EQ(parse_number("-0"), 0.0);
  EXPECT_EQ(parse_number("1e-400"), 0.0);
  EXPECT_EQ(parse_number("-1e400"), -std::numeric_limits<double>::infinity());
  EXPECT_TRUE(std::isnan(parse_number("nan").value()));
  for (const char* bad : {"", "+", "-", "+-1", "1,5", "1.5x", "0x10", " 1", "1 "})
    EXPECT_FALSE(parse_number(bad)) << bad;
}

TEST(Carmen, OptionsAreChecked) {
  const auto refusal = [](CarmenOptions options) {
    return refusal_by([&] { CarmenParser parser(options); });
  };
  CarmenOptions options;
  EXPECT_EQ(refusal(options), "accepted");
  options.max_range = 0.0;
  EXPECT_EQ(refusal(options), "max_range = 0.0 m: must be > 0");
  options.max_range = 50.0;
  options.field_of_view = 7.0;
  EXPECT_EQ(refusal(options), "field_of_view = 7.0 rad: must be in (0, 2 pi]");
}

}  // namespace
}  // namespace ndtree::test::test_carmen
