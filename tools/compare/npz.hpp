// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Arrays of a NumPy .npz file: a zip of .npy files, each stored or deflated.
///
/// The package reads recordings of this format by NumPy (ndtree/logs/formats/npz.py), which is kept by many;
/// ndtree-compare and the benchmarks, whose recordings are .npz, have to read them without Python. So there
/// are two readers. tests/python/test_compare_tool.py tests that they take the same layouts of arrays, read
/// the same from each file that both read, and refuse every damage of an array.
#pragma once

#include <cstddef>
#include <map>
#include <string>
#include <string_view>
#include <vector>

namespace ndtree {

/// One array of numbers, of up to two dimensions.
struct NpyArray {
  char kind = 'f';            ///< f floating point, i signed, u unsigned, b boolean.
  std::size_t item_size = 0;  ///< Bytes an element.
  bool fortran_order = false;
  std::vector<std::size_t> shape;
  std::string data;

  [[nodiscard]] std::size_t rows() const { return shape.empty() ? 1 : shape[0]; }
  [[nodiscard]] std::size_t columns() const { return shape.size() < 2 ? 1 : shape[1]; }
  /// Any element as a double; integers above 2^53 are rounded.
  [[nodiscard]] double at(std::size_t row, std::size_t column = 0) const;
  /// As Python writes it: "float32 (100, 3)".
  [[nodiscard]] std::string description() const;
};

/// Whether bytes begin as a zip file does.
[[nodiscard]] bool looks_like_zip(std::string_view bytes);

/// Those of the named arrays that the file holds; others are not unpacked.
/// @throws std::runtime_error naming the array and what was expected, if the zip is damaged, encrypted or
///   compressed otherwise, or if an array is not of little-endian numbers.
[[nodiscard]] std::map<std::string, NpyArray> read_npz(std::string_view bytes,
                                                       const std::vector<std::string>& names);

}  // namespace ndtree
