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

/// CRC-32 (ISO 3309, reflected polynomial 0xedb88320), as in gzip and PNG.
[[nodiscard]] inline std::uint32_t crc32(std::string_view bytes) {
  static const std::array<std::uint32_t, 256> table = [] {
    std::array<std::uint32_t, 256> entries{};
    for (std::uint32_t i = 0; i < 256; ++i) {
      std::uint32_t value = i;
      for (int bit = 0; bit < 8; ++bit) value = (value >> 1) ^ ((value & 1u) != 0 ? 0xedb88320u : 0u);
      entries[i] = value;
    }
    return entries;
  }();
  std::uint32_t crc = 0xffffffffu;
  for (const char c : bytes) crc = table[(crc ^ static_cast<unsigned char>(c)) & 0xffu] ^ (crc >> 8);
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
    for (std::size_t i = 0; i < sizeof(T); ++i) bytes_.push_back(static_cast<char>(bits >> (8 * i) & 0xffu));
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
    throw FileError(path, EINVAL, "is no regular file, expected one");
  errno = 0;
  std::ifstream in(path, std::ios::binary);
  if (!in.is_open()) throw file_error("cannot read", path, errno);
  std::string bytes((std::istreambuf_iterator<char>(in)), std::istreambuf_iterator<char>());
  if (in.bad()) throw file_error("cannot read", path, errno);
  return bytes;
}

}  // namespace ndtree
