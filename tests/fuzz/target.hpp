// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What fuzz targets have in common: numbers out of bytes, and promises that must hold.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <limits>
#include <new>
#include <stdexcept>
#include <string>
#include <string_view>

namespace ndtree::fuzz {

/// Bytes that somebody else chose. At their end come zeros.
class Bytes {
 public:
  Bytes(const std::uint8_t* data, std::size_t size) : at_(data), end_(data + size) {}

  [[nodiscard]] bool at_end() const { return at_ == end_; }
  std::uint8_t byte() { return at_end() ? std::uint8_t{0} : *at_++; }
  /// In [0, n).
  std::size_t below(std::size_t n) { return byte() % n; }
  bool flag() { return (byte() & 1u) != 0; }
  double raw_double() {
    std::array<std::uint8_t, sizeof(double)> bytes;
    for (std::uint8_t& b : bytes) b = byte();
    double value = 0.0;
    std::memcpy(&value, bytes.data(), sizeof value);
    return value;
  }
  /// A length: mostly some `unit`s, on their borders and beside them; else anything.
  double length(double unit) {
    constexpr double kInfinity = std::numeric_limits<double>::infinity();
    const std::uint8_t kind = byte();
    const auto steps = static_cast<double>(static_cast<std::int8_t>(byte()));
    switch (kind % 32) {
      case 0:
        return std::numeric_limits<double>::quiet_NaN();
      case 1:
        return steps < 0 ? -kInfinity : kInfinity;
      case 2:
        return steps * std::numeric_limits<double>::denorm_min();
      case 3:
        return raw_double();
      case 4:
        return std::nextafter(steps * unit, kInfinity);
      case 5:
        return std::nextafter(steps * unit, -kInfinity);
      case 6:
        return steps * unit * 0x1p10;
      case 7:
        return steps * unit * 0x1p31;
      case 8:
        return steps * 1e300;
      case 9:
      case 10:
      case 11:
        return steps * unit;
      default:
        return (steps / 8.0 + static_cast<double>(byte()) / 2048.0) * unit;
    }
  }
  /// All that is left.
  [[nodiscard]] std::string_view rest() const {
    return {reinterpret_cast<const char*>(at_), static_cast<std::size_t>(end_ - at_)};
  }

 private:
  const std::uint8_t* at_;
  const std::uint8_t* end_;
};

/// Ends the program, for the fuzzer to keep what it was given.
inline void require(bool holds, const char* promise) {
  if (holds) return;
  std::fprintf(stderr, "broken promise: %s\n", promise);
  std::abort();
}

/// Runs `call`, which may refuse its input by what readers and maps throw. The one line that is said of it
/// must be one, and short. @returns whether it was accepted.
template <class Call>
bool accepted(const Call& call) {
  std::string text;
  try {
    call();
    return true;
  } catch (const std::invalid_argument& error) {
    text = error.what();
  } catch (const std::length_error& error) {
    text = error.what();
  } catch (const std::runtime_error& error) {
    text = error.what();
  } catch (const std::bad_alloc&) {
    return false;
  }
  require(!text.empty() && text.size() < 600, "errors are short");
  require(text.find_first_of("\n") == std::string::npos, "errors are one line");
  return false;
}

using Target = void (*)(Bytes);
void insertion(Bytes bytes);
void map_file(Bytes bytes);
void octomap_file(Bytes bytes);
void carmen(Bytes bytes);
void xyz(Bytes bytes);
void npz(Bytes bytes);

}  // namespace ndtree::fuzz
