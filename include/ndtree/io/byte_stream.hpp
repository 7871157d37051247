// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Little-endian values into and out of a byte string, its checksum, and whole files.
#pragma once

#include <array>
#include <cerrno>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <limits>
#include <locale>
#include <sstream>
#include <stdexcept>
#include <string>
#include <string_view>
#include <system_error>
#include <type_traits>

#include "ndtree/io/replaced_file.hpp"

namespace ndtree {

namespace detail {

/// Entry [0] is the table of one byte; entry [i] is that of a byte with i bytes of 0 behind it.
inline const std::array<std::array<std::uint32_t, 256>, 8>& crc32_tables() {
  static const auto tables = [] {
    std::array<std::array<std::uint32_t, 256>, 8> entries{};
    for (std::uint32_t i = 0; i < 256; ++i) {
      std::uint32_t value = i;
      for (int bit = 0; bit < 8; ++bit) value = (value >> 1) ^ ((value & 1u) != 0 ? 0xedb88320u : 0u);
      entries[0][i] = value;
    }
    for (std::size_t n = 1; n < 8; ++n)
      for (std::size_t i = 0; i < 256; ++i)
        entries[n][i] = entries[0][entries[n - 1][i] & 0xffu] ^ (entries[n - 1][i] >> 8);
    return entries;
  }();
  return tables;
}

}  // namespace detail

/// CRC-32 (ISO 3309, reflected polynomial 0xedb88320), as in gzip and PNG; eight bytes at a time.
[[nodiscard]] inline std::uint32_t crc32(std::string_view bytes) {
  const auto& table = detail::crc32_tables();
  const auto at = [&](std::size_t i) {
    return static_cast<std::uint32_t>(static_cast<unsigned char>(bytes[i]));
  };
  std::uint32_t crc = 0xffffffffu;
  std::size_t i = 0;
  for (; i + 8 <= bytes.size(); i += 8) {
    crc ^= at(i) | at(i + 1) << 8 | at(i + 2) << 16 | at(i + 3) << 24;
    crc = table[7][crc & 0xffu] ^ table[6][crc >> 8 & 0xffu] ^ table[5][crc >> 16 & 0xffu] ^
          table[4][crc >> 24] ^ table[3][at(i + 4)] ^ table[2][at(i + 5)] ^ table[1][at(i + 6)] ^
          table[0][at(i + 7)];
  }
  for (; i < bytes.size(); ++i) crc = table[0][(crc ^ at(i)) & 0xffu] ^ (crc >> 8);
  return ~crc;
}

/// Appends numbers to a byte string, little-endian whatever the machine.
class ByteWriter {
 public:
  template <class T>
  void put(T value) {
    static_assert(std::is_arithmetic_v<T> && sizeof(T) <= 8);
    std::uint64_t bits = 0;
    if constexpr (std::is_floating_point_v<T>) {
      std::conditional_t<sizeof(T) == 4, std::uint32_t, std::uint64_t> raw;
      std::memcpy(&raw, &value, sizeof(T));
      bits = raw;
    } else {
      bits = static_cast<std::uint64_t>(value);
    }
    std::array<char, sizeof(T)> text;
    for (std::size_t i = 0; i < sizeof(T); ++i) text[i] = static_cast<char>(bits >> (8 * i) & 0xffu);
    bytes_.append(text.data(), text.size());
  }
  /// Writes over what stands at a position.
  template <class T>
  void put_at(std::size_t position, T value) {
    ByteWriter one;
    one.put(value);
    bytes_.replace(position, one.bytes_.size(), one.bytes_);
  }
  void put_text(std::string_view text) {
    put(static_cast<std::uint16_t>(text.size()));
    bytes_.append(text);
  }
  [[nodiscard]] std::string& bytes() { return bytes_; }

 private:
  std::string bytes_;
};

/// Reads what ByteWriter wrote. @throws std::runtime_error where the bytes end too soon.
class ByteReader {
 public:
  explicit ByteReader(std::string_view bytes) : bytes_(bytes) {}

  template <class T>
  [[nodiscard]] T get() {
    std::uint64_t bits = 0;
    const std::string_view raw = take(sizeof(T));
    for (std::size_t i = 0; i < sizeof(T); ++i)
      bits |= static_cast<std::uint64_t>(static_cast<unsigned char>(raw[i])) << (8 * i);
    if constexpr (std::is_floating_point_v<T>) {
      const auto word = static_cast<std::conditional_t<sizeof(T) == 4, std::uint32_t, std::uint64_t>>(bits);
      T value;
      std::memcpy(&value, &word, sizeof(T));
      return value;
    } else {
      return static_cast<T>(bits);
    }
  }
  [[nodiscard]] std::string get_text() { return std::string(take(get<std::uint16_t>())); }
  [[nodiscard]] std::string_view take(std::size_t count) {
    if (count > bytes_.size() - position_)
      throw std::runtime_error("the data end at byte " + std::to_string(bytes_.size()) + ", inside a value");
    position_ += count;
    return bytes_.substr(position_ - count, count);
  }
  [[nodiscard]] std::size_t position() const { return position_; }
  [[nodiscard]] bool at_end() const { return position_ == bytes_.size(); }

 private:
  std::string_view bytes_;
  std::size_t position_ = 0;
};

/// A finite number with as few digits as tell it from all others.
[[nodiscard]] inline std::string shortest_text(double value) {
  for (int digits = 6;; ++digits) {
    std::ostringstream text;
    text.imbue(std::locale::classic());
    text.precision(digits);
    text << value;
    if (digits >= std::numeric_limits<double>::max_digits10 || std::stod(text.str()) == value)
      return text.str();
  }
}

/// A whole file. Others than regular ones are refused: a FIFO may wait, and a device have no end.
/// @throws std::filesystem::filesystem_error naming the file and the reason.
[[nodiscard]] inline std::string read_file(const std::filesystem::path& path) {
  std::error_code error;
  const auto status = std::filesystem::status(path, error);
  if (std::filesystem::is_directory(status)) throw file_error("cannot read", path, EISDIR);
  if (std::filesystem::exists(status) && !std::filesystem::is_regular_file(status))
    throw FileError(path, EINVAL, "is not a regular file, expected one");
  errno = 0;
  std::ifstream in(path, std::ios::binary);
  if (!in.is_open()) throw file_error("cannot read", path, errno);
  const std::uintmax_t size = std::filesystem::file_size(path, error);
  std::string bytes(error ? 0 : static_cast<std::size_t>(size), '\0');
  in.read(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  bytes.resize(static_cast<std::size_t>(in.gcount()));
  if (in.good())
    bytes.append(std::istreambuf_iterator<char>(in), {});  // It grew, or is one that tells no size.
  if (in.bad()) throw file_error("cannot read", path, errno);
  return bytes;
}

}  // namespace ndtree
