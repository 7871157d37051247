// SPDX-License-Identifier: BSD-3-Clause
#include <pybind11/pybind11.h>

#include "ndtree/cell/sensor_model.hpp"
#include "ndtree/version.hpp"
#include "python_map.hpp"

namespace {

/// What pybind11 calls for the place of an object whose `__init__` did not run, or threw: it would return
/// uninitialised memory.
void* refuse_unmade(std::size_t) {
  throw pybind11::type_error("an object is used that was never made: its __init__() did not run, or failed");
}

void refuse_unmade_objects(const pybind11::module_& module) {
  namespace py = pybind11;
  for (const auto& [name, held] : module.attr("__dict__").cast<py::dict>()) {
    if (!py::isinstance<py::type>(held)) continue;
    py::detail::type_info* const info =
        py::detail::get_type_info(reinterpret_cast<PyTypeObject*>(held.ptr()));
    if (info != nullptr) info->operator_new = &refuse_unmade;
  }
}

}  // namespace

PYBIND11_MODULE(_core, module) {
  namespace py = pybind11;
  module.doc() = "Compiled part of ndtree.";
  module.attr("__version__") = NDTREE_VERSION;
  module.attr("reach_sigmas") = ndtree::BeamSensorModel::kReachSigmas;
  module.attr("thinnest_surface") = ndtree::kThinnestSurface;
  module.attr("most_cells") = ndtree::python::kMostCells;

  ndtree::python::bind_errors(module);
  ndtree::python::bind_files(module);
  ndtree::python::bind_maps(module);
  ndtree::python::bind_loading(module);
  ndtree::python::bind_exports(module);
  ndtree::python::bind_queries(module);
  ndtree::python::bind_planning(module);
  ndtree::python::bind_changes(module);
  ndtree::python::bind_claims(module);
  ndtree::python::bind_calibration(module);
  ndtree::python::bind_moved(module);
  ndtree::python::bind_history(module);
  ndtree::python::bind_match(module);
  ndtree::python::bind_pose_graph(module);
  ndtree::python::bind_pose_sigma(module);
  ndtree::python::bind_logs(module);
  ndtree::python::bind_points(module);
  ndtree::python::bind_log_sample(module);
#ifdef NDTREE_HAVE_OCTOMAP
  module.attr("has_octomap") = true;
  ndtree::python::bind_octomap(module);
#else
  module.attr("has_octomap") = false;
#endif
  refuse_unmade_objects(module);
}
