// SPDX-License-Identifier: BSD-3-Clause
#include <pybind11/pybind11.h>

#include <cerrno>
#include <filesystem>

#include "ndtree/version.hpp"
#include "python_map.hpp"

PYBIND11_MODULE(_core, module) {
  namespace py = pybind11;
  module.doc() = "Compiled part of ndtree.";
  module.attr("__version__") = NDTREE_VERSION;

  // Files: the system's error number makes it FileNotFoundError, PermissionError, ...
  py::register_exception_translator([](std::exception_ptr pointer) {
    try {
      if (pointer) std::rethrow_exception(pointer);
    } catch (const std::filesystem::filesystem_error& error) {
      errno = error.code().value();
      PyErr_SetFromErrnoWithFilename(PyExc_OSError, error.path1().string().c_str());
    }
  });

  ndtree::python::bind_maps(module);
  ndtree::python::bind_exports(module);
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
