// SPDX-License-Identifier: BSD-3-Clause
// Prints a digest of the scans of each simulated world, turned by several angles, and of a CARMEN log.
#include <cstdint>
#include <cstdio>
#include <sstream>

#include "ndtree/logs/carmen.hpp"
#include "ndtree/logs/simulator.hpp"

namespace {

class Digest {
 public:
  template <class Matrix>
  void add(const Matrix& numbers) {
    const auto* bytes = reinterpret_cast<const unsigned char*>(numbers.data());
    for (std::size_t i = 0; i < sizeof(double) * static_cast<std::size_t>(numbers.size()); ++i)
      value_ = (value_ ^ bytes[i]) * 1099511628211U;
  }
  void print() const { std::printf("%016llx\n", static_cast<unsigned long long>(value_)); }

 private:
  std::uint64_t value_ = 1469598103934665603U;
};

template <int D>
void print(const ndtree::SimulatedLog<D>& log) {
  Digest digest;
  for (std::size_t i = 0; i < log.size(); ++i) digest.add(log.T_map_sensor[i].matrix());
  for (std::size_t i = 0; i < log.size(); i += 7) digest.add(log.scan(i).endpoints);
  digest.print();
}

}  // namespace

int main(int count, char**) {
  for (int i = 0; i < 3; ++i) {
    ndtree::SimulationOptions options;
    options.scans = 8;
    options.yaw = 0.35 * i * count;  // Not known to the compiler, whose sines are others than the library's.
    options.heading_sigma = 0.01;
    print(ndtree::simulate_office(options));
    print(ndtree::simulate_apartment(options));
    print(ndtree::simulate_street(options));
  }
  Digest digest;
  for (int i = 0; i < 50; ++i) {
    std::ostringstream line;
    line << "FLASER 7 1.1 2.3 3.7 5.3 7.1 11.3 13.7 " << 0.7 * i << " " << 1.3 * i << " " << 0.1 * i
         << " 0 0 0 1 host 1\n";
    std::istringstream in(line.str());
    ndtree::read_carmen(in, [&](const ndtree::Scan<2>& scan) { digest.add(scan.endpoints); });
  }
  digest.print();
  return 0;
}
