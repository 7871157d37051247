# SPDX-License-Identifier: BSD-3-Clause
"""Tries what ``conan create`` made: the consumer finds it, links the compiled maps and runs."""

from pathlib import Path

from conan import ConanFile
from conan.tools.build import can_run
from conan.tools.cmake import CMake, CMakeDeps, CMakeToolchain, cmake_layout


class Consumer(ConanFile):
    settings = "os", "arch", "compiler", "build_type"

    def requirements(self):
        self.requires(self.tested_reference_str)

    def layout(self):
        cmake_layout(self)

    def generate(self):
        CMakeDeps(self).generate()
        toolchain = CMakeToolchain(self)
        toolchain.user_presets_path = False  # Nothing beside the sources, except in build/.
        toolchain.generate()

    def build(self):
        cmake = CMake(self)
        cmake.configure({"NDTREE_LIBRARY": "ndtree::prebuilt"})
        cmake.build()

    def test(self):
        if can_run(self):
            program = Path(self.build_folder, self.cpp.build.bindir, "consumer")
            self.run(f'"{program}"', env="conanrun")
