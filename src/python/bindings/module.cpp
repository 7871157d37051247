// SPDX-License-Identifier: BSD-3-Clause
#include <pybind11/pybind11.h>

#include "ndtree/version.hpp"
#include "python_map.hpp"

PYBIND11_MODULE(_core, module) {
  namespace py = pybind11;
  module.doc() = "Compiled part of ndtree.";
  module.attr("__version__") = NDTREE_VERSION;

  ndtree::python::bind_errors(module);
  ndtree::python::bind_files(module);
  ndtree::python::bind_maps(module);
  ndtree::python::bind_exports(module);
  ndtree::python::bind_queries(module);
  ndtree::python::bind_changes(module);
  ndtree::python::bind_claims(module);
  ndtree::python::bind_logs(module);
  ndtree::python::bind_statistics(module);
#ifdef NDTREE_HAVE_OCTOMAP
  module.attr("has_octomap") = true;
  ndtree::python::bind_octomap(module);
#else
  module.attr("has_octomap") = false;
#endif
}
