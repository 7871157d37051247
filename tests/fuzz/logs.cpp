// SPDX-License-Identifier: BSD-3-Clause
// Readers of logs, given bytes.
#include <sstream>
#include <string>

#include "ndtree/io/byte_stream.hpp"
#include "ndtree/logs/carmen.hpp"
#include "ndtree/logs/xyz.hpp"
#include "npz.hpp"
#include "target.hpp"

namespace ndtree::fuzz {

namespace {

template <int D>
void expect_sound(const Scan<D>& scan) {
  (void)scan.view();  // Throws std::invalid_argument if sizes disagree: of a scan that a reader has made.
}

/// A zip file of one stored member with the checksum that belongs to it.
std::string zip_of(const std::string& name, std::string_view content) {
  const auto size = static_cast<std::uint32_t>(content.size());
  const auto header = [&](ByteWriter& out) {
    out.put(std::uint16_t{20});
    for (int i = 0; i < 4; ++i) out.put(std::uint16_t{0});
    out.put(crc32(content));
    out.put(size);
    out.put(size);
    out.put(static_cast<std::uint16_t>(name.size()));
    out.put(std::uint16_t{0});
  };
  ByteWriter zip;
  zip.bytes() += "PK\x03\x04";
  header(zip);
  zip.bytes() += name;
  zip.bytes().append(content);
  const auto directory = static_cast<std::uint32_t>(zip.bytes().size());
  zip.bytes() += "PK\x01\x02";
  zip.put(std::uint16_t{20});
  header(zip);
  for (int i = 0; i < 7; ++i) zip.put(std::uint16_t{0});
  zip.bytes() += name;
  const auto length = static_cast<std::uint32_t>(zip.bytes().size()) - directory;
  zip.bytes() += "PK\x05\x06";
  for (const int n : {0, 0, 1, 1}) zip.put(static_cast<std::uint16_t>(n));
  zip.put(length);
  zip.put(directory);
  zip.put(std::uint16_t{0});
  return zip.bytes();
}

}  // namespace

/// The first byte: whether the rest is an array's file, or a zip file.
void npz(Bytes bytes) {
  const bool is_array = bytes.flag();
  const std::string file = is_array ? zip_of("points.npy", bytes.rest()) : std::string(bytes.rest());
  accepted([&] {
    for (const auto& [name, array] : read_npz(file, {"points", "origins", "offsets", "no_return"})) {
      double sum = 0.0;
      for (std::size_t row = 0; row < array.rows(); ++row)
        for (std::size_t column = 0; column < array.columns(); ++column) sum += array.at(row, column);
      require(array.rows() == 0 || array.columns() == 0 || sum == sum || array.kind == 'f',
              "arrays are whole");
    }
  });
}

void carmen(Bytes bytes) {
  CarmenOptions options;
  if (bytes.flag()) options.max_range = 80.0;
  std::istringstream in{std::string(bytes.rest())};
  accepted([&] {
    read_carmen(
        in, [](Scan<2>&& scan) { expect_sound(scan); }, options);
  });
}

void xyz(Bytes bytes) {
  std::istringstream in{std::string(bytes.rest())};
  accepted([&] {
    if (xyz_dimension(in) == 2)
      read_xyz<2>(in, [](Scan<2>&& scan) { expect_sound(scan); });
    else
      read_xyz<3>(in, [](Scan<3>&& scan) { expect_sound(scan); });
  });
}

}  // namespace ndtree::fuzz
