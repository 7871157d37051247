// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Simulated logs that Python gives, for files that need not know what is in them.
#pragma once

#include <pybind11/pybind11.h>

namespace ndtree {
template <int D>
struct SimulatedLog;
}

namespace ndtree::python {

/// A Python object's log; null for None. Of 2 and 3 dimensions. @throws ValueError if it is anything else.
template <int D>
const SimulatedLog<D>* simulated_log(const pybind11::object& object);
extern template const SimulatedLog<2>* simulated_log<2>(const pybind11::object&);
extern template const SimulatedLog<3>* simulated_log<3>(const pybind11::object&);

}  // namespace ndtree::python
