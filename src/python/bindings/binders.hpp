// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The parts of the module, each in a file of its own.
#pragma once

#include <pybind11/pybind11.h>

namespace ndtree::python {

/// Remembers the thread that imports the module, in which Python calls the handlers of signals, unless
/// another one is its main thread. What the library throws becomes an exception of Python's in one readable
/// line; and `ReplacedFile`.
void bind_errors(pybind11::module_& module);
void bind_files(pybind11::module_& module);
void bind_maps(pybind11::module_& module);
/// Maps from files, bytes and grids. @pre as bind_exports().
void bind_loading(pybind11::module_& module);
/// @pre bind_maps() has run: it adds methods to its classes.
void bind_exports(pybind11::module_& module);
/// @pre as bind_exports().
void bind_queries(pybind11::module_& module);
/// @pre bind_queries() has run.
void bind_planning(pybind11::module_& module);
/// @pre as bind_exports().
void bind_changes(pybind11::module_& module);
/// @pre as bind_exports().
void bind_claims(pybind11::module_& module);
/// @pre as bind_exports().
void bind_calibration(pybind11::module_& module);
/// @pre as bind_exports().
void bind_moved(pybind11::module_& module);
/// @pre as bind_exports().
void bind_history(pybind11::module_& module);
/// @pre as bind_exports().
void bind_match(pybind11::module_& module);
void bind_pose_graph(pybind11::module_& module);
void bind_pose_sigma(pybind11::module_& module);
void bind_logs(pybind11::module_& module);
void bind_points(pybind11::module_& module);
void bind_log_sample(pybind11::module_& module);
void bind_octomap(pybind11::module_& module);

}  // namespace ndtree::python
