// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The parts that all drivers share: a log read from `run convert`, and two timed passes over it. A driver
/// inserts each scan into one mapper, and prints a line of JSON.
#pragma once

#include <malloc.h>
#include <time.h>

#include <Eigen/Core>
#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <stdexcept>
#include <string>
#include <vector>

#ifdef WITH_CALLGRIND
#include <valgrind/callgrind.h>
#else
#define CALLGRIND_ZERO_STATS
#define CALLGRIND_DUMP_STATS_AT(name)
#endif

namespace bench {

/// The head of a log, as `run convert` writes it.
struct Header {
  char magic[4];
  std::int32_t dim;
  std::int32_t width;   ///< Of a pinhole camera's image [px]; 0 without one.
  std::int32_t height;  ///< [px]
  std::int64_t scans;
  std::int64_t beams;
  double focal;            ///< [px]
  double center[2];        ///< [px]
  double max_range;        ///< [m]
  double cell;             ///< Edge of the smallest cells [m].
  double sigma;            ///< Of a range [m].
  double sigma_quadratic;  ///< Its growth with the squared range [1/m].
} __attribute__((packed));

/// End points in the world, and the pixel of each (row * width + column, or -1).
struct Scan {
  Eigen::Matrix4d pose;  ///< T_world_sensor
  std::vector<float> points;
  std::vector<std::int32_t> pixels;

  [[nodiscard]] std::size_t size() const { return pixels.size(); }
  [[nodiscard]] Eigen::Vector3d origin() const { return pose.topRightCorner<3, 1>(); }
  [[nodiscard]] Eigen::Vector3d point(std::size_t i) const {
    return {points[3 * i], points[3 * i + 1], points[3 * i + 2]};
  }
};

struct Log {
  Header head;
  std::vector<Scan> scans;
  std::string mode;
};

/// Of a planar log, z is the middle of a layer of cells.
inline Log read(const char* path) {
  std::FILE* file = std::fopen(path, "rb");
  Log log;
  const auto take = [&](void* to, std::size_t size, std::size_t count) {
    if (std::fread(to, size, count, file) != count)
      throw std::runtime_error(std::string(path) + ": too short");
  };
  if (!file) throw std::runtime_error(std::string(path) + ": cannot be opened");
  take(&log.head, sizeof log.head, 1);
  if (std::memcmp(log.head.magic, "PEER", 4) != 0) throw std::runtime_error(std::string(path) + ": no log");
  log.scans.resize(static_cast<std::size_t>(log.head.scans));
  for (Scan& scan : log.scans) {
    std::int64_t count = 0;
    Eigen::Matrix<double, 4, 4, Eigen::RowMajor> pose;
    take(pose.data(), sizeof(double), 16);
    take(&count, sizeof count, 1);
    scan.pose = pose;
    scan.points.resize(3 * static_cast<std::size_t>(count));
    scan.pixels.resize(static_cast<std::size_t>(count));
    take(scan.points.data(), sizeof(float), scan.points.size());
    take(scan.pixels.data(), sizeof(std::int32_t), scan.pixels.size());
    if (log.head.dim != 2) continue;
    scan.pose(2, 3) = 0.5 * log.head.cell;
    for (std::size_t i = 0; i < scan.size(); ++i) scan.points[3 * i + 2] = float(0.5 * log.head.cell);
  }
  std::fclose(file);
  return log;
}

/// Processor time of this process [s].
inline double seconds() {
  timespec now{};
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return double(now.tv_sec) + 1e-9 * double(now.tv_nsec);
}

/// Memory of this process that no file backs [MiB].
inline double resident() {
  double kilobytes = 0.0;
  char line[256];
  if (std::FILE* status = std::fopen("/proc/self/status", "r")) {
    while (std::fgets(line, sizeof line, status))
      if (std::sscanf(line, "RssAnon: %lf", &kilobytes) == 1) break;
    std::fclose(status);
  }
  return kilobytes / 1024.0;
}

template <class Peer>
__attribute__((noinline)) double insert_all(Peer& peer, const Log& log) {
  const double begin = seconds();
  for (std::size_t i = 0; i < log.scans.size(); ++i) peer.insert(i);
  peer.finish();
  return seconds() - begin;
}

/// Peer: Peer(const Log&) converts points to its types, create() makes an empty map, insert(scan's number),
/// finish().
template <class Peer>
int run(const char* name, int count, char** arguments) {
  if (count < 3) {
    std::fprintf(stderr, "usage: %s LOG MODE\n", arguments[0]);
    return 2;
  }
  Log log = read(arguments[1]);
  log.mode = arguments[2];
  Peer peer(log);
  malloc_trim(0);
  const double before = resident();
  CALLGRIND_ZERO_STATS;
  const double begin = seconds();
  peer.create();
  const double made = seconds() - begin;
  const double first = made + insert_all(peer, log);
  CALLGRIND_DUMP_STATS_AT("empty");
  const double grown = resident() - before;
  CALLGRIND_ZERO_STATS;
  const double again = insert_all(peer, log);
  CALLGRIND_DUMP_STATS_AT("again");
  const double beams = 1e-6 * double(log.head.beams);
  std::printf(
      "{\"peer\": \"%s\", \"mode\": \"%s\", \"beams\": %lld, \"empty\": %.4f, \"again\": %.4f, \"mib\": "
      "%.2f}\n",
      name, arguments[2], static_cast<long long>(log.head.beams), beams / first, beams / again, grown);
  return 0;
}

}  // namespace bench
