// SPDX-License-Identifier: BSD-3-Clause
// What threads may do with maps at the same time, for ThreadSanitizer to watch: insertions that use several
// threads, into different maps at once; questions of several threads to one map; snapshots that are read and
// changed while the map goes on; insertions that are cancelled, or run out of memory. Prints what went wrong;
// exit status 0 if nothing did.
#include <atomic>
#include <cstdio>
#include <string>
#include <thread>
#include <vector>

#include "ndtree/core/cancel.hpp"
#include "ndtree/io/map_file.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/point.hpp"
#include "ndtree/query/ray.hpp"
#include "random.hpp"

namespace {

using namespace ndtree;  // NOLINT(google-build-using-namespace)
using Map = AdaptiveMap<2, 3>;

Scan<3> scan_of(std::uint64_t seed, double reach) {
  test::Random random(seed);
  Scan<3> scan;
  scan.origins = Vector<3>::Constant(0.1 * static_cast<double>(seed % 5));
  scan.endpoints.resize(3, 3100);
  for (Eigen::Index i = 0; i < scan.size(); ++i)
    for (int a = 0; a < 3; ++a) scan.endpoints(a, i) = random.uniform(-reach, reach);
  return scan;
}

std::atomic<int> failures{0};
void expect(bool holds, const char* what) {
  if (holds) return;
  std::printf("threads: %s\n", what);
  ++failures;
}

void insert_and_ask(std::uint64_t seed, std::string& bytes) {
  MapOptions options;
  options.min_cell_size = 0.1;
  Map map(options);
  for (std::uint64_t i = 0; i < 2; ++i) map.insert(scan_of(seed + i, 4.0), kUnlimitedRange, 3);
  const Map& shared = map;
  const auto ask = [&shared](std::uint64_t number, double& sum) {
    test::Random random(number);
    for (int i = 0; i < 300; ++i) {
      const Vector<3> point(random.uniform(-4, 4), random.uniform(-4, 4), random.uniform(-4, 4));
      sum += probability(shared, point) + cast_ray(shared, Vector<3>(0, 0, 0), point, 9.0).value_or(0.0);
    }
    sum += static_cast<double>(to_bytes(shared).size() + shared.stats().leaves);
  };
  double sums[3] = {0, 0, 0};
  std::vector<std::thread> threads;
  for (double& sum : sums) threads.emplace_back([&ask, &sum] { ask(7, sum); });
  for (std::thread& thread : threads) thread.join();
  expect(sums[0] == sums[1] && sums[1] == sums[2], "threads get different answers");
  bytes = to_bytes(map);
}

/// One thread goes on, with helpers, while others read what was, make copies of it, and change those.
void go_on_beside_snapshots() {
  MapOptions options;
  options.min_cell_size = 0.1;
  Map map(options);
  Map alone(options);
  std::vector<std::thread> readers;
  for (std::uint64_t i = 0; i < 6; ++i) {
    readers.emplace_back([snapshot = map.snapshot(), expected = to_bytes(map), i]() mutable {
      expect(to_bytes(snapshot) == expected, "a snapshot has changed");
      Map copy = snapshot.snapshot();
      copy.insert(scan_of(20 + i, 3.0), kUnlimitedRange, 2);
      if (i % 2 == 0) snapshot.crop({Vector<3>::Constant(-1.0), Vector<3>::Constant(1.0)});
      expect(i % 2 == 0 || to_bytes(snapshot) == expected, "a copy has changed what it was copied from");
    });
    map.insert(scan_of(i, 4.0), kUnlimitedRange, 3);
    alone.insert(scan_of(i, 4.0), kUnlimitedRange, 1);
  }
  for (std::thread& reader : readers) reader.join();
  expect(to_bytes(map) == to_bytes(alone), "a map with snapshots is not as one without");
}

}  // namespace

int main() {
  std::string one, two;
  std::thread other([&] { insert_and_ask(1, two); });
  insert_and_ask(1, one);
  other.join();
  expect(one == two, "maps made at the same time differ");

  go_on_beside_snapshots();

  MapOptions options;
  options.min_cell_size = 0.02;
  Map map(options);
  map.insert(scan_of(9, 1.0), kUnlimitedRange, 3);
  const std::string before = to_bytes(map);
  for (int i = 0; i < 3; ++i) {
    std::atomic<bool> stop{i == 0};
    std::thread stopper([&] { stop = true; });
    try {
      const CancelScope scope([&] { return stop.load(); });
      map.insert(scan_of(10, 6.0), kUnlimitedRange, 3);
      expect(false, "an insertion was not cancelled");
    } catch (const Cancelled&) {
    }
    stopper.join();
    expect(to_bytes(map) == before, "a cancelled insertion left something");
  }
  options.max_memory = 1e6;
  Map bounded(options);
  try {
    bounded.insert(scan_of(11, 9.0), kUnlimitedRange, 3);
    expect(false, "memory was not bounded");
  } catch (const MemoryLimitReached&) {
  }
  bounded.check_invariants();
  expect(bounded.memory_bytes() <= 1000000, "a map holds more than max_memory");
  return failures == 0 ? 0 : 1;
}
