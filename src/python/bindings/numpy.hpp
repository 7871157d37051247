// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// NumPy arrays in and out: no copy where they are C-contiguous float64, one copy otherwise, clear shape
/// errors.
#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "beam_pointers.hpp"

namespace ndtree::python {

namespace py = pybind11;

using DoubleArray = py::array_t<double, py::array::c_style>;
using BoolArray = py::array_t<bool, py::array::c_style>;

/// More smallest cells on a beam, from one scan's origin to the next, or along an axis of points alone, than
/// sensors, robots and files have: with cells of 0.05 m they are 1 km.
inline constexpr double kMostCells = 20000.0;

/// A number as Python writes it: no shorter than it needs to be.
std::string number_text(double value);

/// "(3, 2)", as NumPy writes it.
std::string shape_text(const py::array& array);

/// What NumPy makes of an object. @throws TypeError with this text where it is none of NumPy's arrays, with
/// NumPy's error as its cause; whatever else the conversion raises, such as KeyboardInterrupt, MemoryError or
/// an error of the object's own, is passed on.
py::array as_array(const py::object& object, const std::string& what_is_wrong);

/// An array of numbers as contiguous float64. @throws TypeError naming the argument for anything but numbers,
/// and as as_array().
DoubleArray as_doubles(const py::object& object, const char* name);

/// An (n, dim) array. @throws ValueError naming the argument, its shape and the one expected.
DoubleArray as_points(const py::object& object, const char* name, int dim);

/// The lower and the upper corner of a box, a (2, dim) array. @throws as as_points().
DoubleArray as_corners(const py::object& object, const char* name, int dim);

/// A (dim,) or an (n, dim) array, one for all or one each. @throws ValueError naming both shapes.
DoubleArray as_points_or_one(const py::object& object, const char* name, int dim, py::ssize_t n);

/// An (n,) array of bool, or none. @throws TypeError or ValueError.
py::object as_mask(const py::object& object, const char* name, py::ssize_t n);

/// An (n,) array of numbers, or none. @throws TypeError or ValueError.
py::object as_one_each(const py::object& object, const char* name, py::ssize_t n);

/// The arguments of one scan, checked; they keep the arrays alive while the pointers are used.
struct BeamArrays {
  DoubleArray endpoints;
  DoubleArray origins;
  py::object returned;                  // None or BoolArray
  py::object range_sigma;               // None or DoubleArray
  std::optional<std::uint64_t> number;  ///< See ScanView::number.

  BeamArrays(const py::object& points, const py::object& origin, const py::object& mask, int dimension,
             const py::object& sigma = py::none());

  /// @throws ValueError if it is negative.
  void set_number(const std::optional<std::int64_t>& given);
  /// A Python warning where a beam that is not cut by max_range is absurdly long beside the cells, before
  /// anything changes. O(beams). @throws ValueError where most are: their cells would fill any memory.
  void require_scale(double cell_size, double max_range) const;
  [[nodiscard]] BeamPointers pointers() const;
};

/// The arrays of scans of one dimension, kept alive.
struct ScanArrays {
  std::vector<BeamArrays> beams;
  int dim = 0;  ///< 0 without scans.

  /// @param scans of ndtree.Scan. @throws ValueError naming the scan whose dimension is not that of the
  /// first, or not 2, 3 or 4.
  explicit ScanArrays(const py::iterable& scans) {
    for (const py::handle scan : scans) {
      if (beams.empty()) dim = dim_of(scan, 0);
      try {
        beams.emplace_back(scan.attr("endpoints"), scan.attr("origin"), scan.attr("returned"), dim);
      } catch (const py::value_error& error) {
        throw py::value_error("scan " + std::to_string(beams.size()) + ": " + error.what());
      }
    }
  }

  [[nodiscard]] static int dim_of(const py::handle& scan, std::size_t number) {
    const int dim = scan.attr("dim").cast<int>();
    if (dim < 2 || dim > 4)
      throw py::value_error("scan " + std::to_string(number) + ": dim = " + std::to_string(dim) +
                            ": must be 2, 3 or 4");
    return dim;
  }

  [[nodiscard]] std::vector<BeamPointers> pointers() const {
    std::vector<BeamPointers> pointers;
    pointers.reserve(beams.size());
    for (const BeamArrays& scan : beams) pointers.push_back(scan.pointers());
    return pointers;
  }
};

/// A pose as a homogeneous (dim + 1, dim + 1) matrix. @param numbers see pose_of().
[[nodiscard]] py::array_t<double> matrix_of(const std::vector<double>& numbers, int dim);

/// A one-dimensional array that takes over a vector's memory.
template <class T>
py::array_t<T> take(std::vector<T>&& values) {
  auto* owned = new std::vector<T>(std::move(values));
  const py::capsule owner(owned, [](void* p) { delete static_cast<std::vector<T>*>(p); });
  return py::array_t<T>(static_cast<py::ssize_t>(owned->size()), owned->data(), owner);
}

/// An (n, dim) array that takes over a vector of n * dim numbers.
template <class T>
py::array_t<T> take(std::vector<T>&& values, int dim) {
  py::array_t<T> flat = take(std::move(values));
  return flat.reshape({static_cast<py::ssize_t>(-1), static_cast<py::ssize_t>(dim)});
}

}  // namespace ndtree::python
