// SPDX-License-Identifier: BSD-3-Clause
#include <pybind11/pybind11.h>
#include <pybind11/stl/filesystem.h>

#include <filesystem>
#include <utility>
#include <vector>

#include "docstrings.hpp"
#include "ndtree/io/replaced_file.hpp"
#include "python_map.hpp"

namespace ndtree::python {

void bind_files(pybind11::module_& module) {
  namespace py = pybind11;
  using namespace pybind11::literals;  // NOLINT(google-build-using-namespace): "name"_a
  py::class_<ReplacedFile>(module, "ReplacedFile", doc::ReplacedFile)
      .def(py::init<std::filesystem::path>(), "path"_a,
           "OSError if what is there cannot be replaced, or nothing can be written beside it.")
      .def_property_readonly(
          "temporary", [](const ReplacedFile& file) { return file.temporary().string(); },
          doc::ReplacedFile_temporary)
      .def("discard", &ReplacedFile::discard, doc::ReplacedFile_discard);
  module.def(
      "commit_together",
      [](const py::list& files) {
        std::vector<ReplacedFile> moved;
        for (const py::handle file : files) moved.push_back(std::move(file.cast<ReplacedFile&>()));
        const py::gil_scoped_release released;
        commit_together(moved);
      },
      "files"_a, doc::commit_together);
}

}  // namespace ndtree::python
