# SPDX-License-Identifier: BSD-3-Clause
"""Conan 2: the headers, and the usual maps compiled."""

import re
from pathlib import Path

from conan import ConanFile
from conan.tools.build import check_min_cppstd
from conan.tools.cmake import CMake, CMakeDeps, CMakeToolchain, cmake_layout
from conan.tools.files import copy


class Ndtree(ConanFile):
    name = "ndtree"
    description = "Occupancy mapping in N^d-trees whose cells adapt to the measurements"
    license = "BSD-3-Clause"
    topics = ("occupancy-grid", "mapping", "octree", "robotics", "lidar")
    package_type = "static-library"
    settings = "os", "arch", "compiler", "build_type"
    exports_sources = "CMakeLists.txt", "LICENSE", "package.xml", "cmake/*", "include/*", "src/prebuilt/*"
    exports = "include/ndtree/version.hpp"
    test_package_folder = "tests/cpp/consumer"

    def set_version(self):
        header = Path(self.recipe_folder, "include/ndtree/version.hpp").read_text()
        self.version = re.search(r'define NDTREE_VERSION "([\d.]+)"', header)[1]

    def requirements(self):
        self.requires("eigen/[>=3.3 <6]", transitive_headers=True)

    def validate(self):
        check_min_cppstd(self, 17)

    def layout(self):
        cmake_layout(self)

    def generate(self):
        CMakeDeps(self).generate()
        CMakeToolchain(self).generate()

    def build(self):
        cmake = CMake(self)
        cmake.configure()
        cmake.build()

    def package(self):
        CMake(self).install()
        copy(self, "LICENSE", self.source_folder, str(Path(self.package_folder, "licenses")))

    def package_info(self):
        self.cpp_info.set_property("cmake_file_name", "ndtree")
        headers = self.cpp_info.components["ndtree"]
        headers.set_property("cmake_target_name", "ndtree::ndtree")
        headers.requires = ["eigen::eigen"]
        if self.settings.os in ("Linux", "FreeBSD"):
            headers.system_libs = ["pthread"]
        prebuilt = self.cpp_info.components["prebuilt"]
        prebuilt.set_property("cmake_target_name", "ndtree::prebuilt")
        prebuilt.set_property("pkg_config_name", "ndtree-prebuilt")
        prebuilt.libs = ["ndtree_prebuilt"]
        prebuilt.defines = ["NDTREE_PREBUILT"]
        prebuilt.requires = ["ndtree"]
