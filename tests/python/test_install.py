# SPDX-License-Identifier: BSD-3-Clause
"""What others find an installed copy by: CMake, from the oldest on, pkg-config, strict compilers, packages.

The tree is installed by one CMake and moved before another uses it, so that nothing holds on to where it was
built. ``tools/setup`` puts the oldest and the newest CMake into ``build/cmake``.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from snippets import blocks

ROOT = Path(__file__).parents[2]
CONSUMER = ROOT / "tests/cpp/consumer"
VERSION = re.search(r'VERSION "([\d.]+)"', (ROOT / "include/ndtree/version.hpp").read_text())[1]
STRICT = ["-Wall", "-Wextra", "-Wconversion", "-Wsign-conversion", "-Werror"]


def run(*command: str | os.PathLike[str], env: dict[str, str] | None = None) -> str:
    both = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "env": {**os.environ, **(env or {})}}
    done = subprocess.run(command, text=True, **both)
    assert done.returncode == 0, f"{' '.join(map(str, command))}\n{done.stdout}"
    return done.stdout


def program(name: str) -> str:
    path = shutil.which(name)
    return path or pytest.skip(f"no {name} here")


def find_cmake(which: str) -> str:
    """One of those in build/cmake: the oldest, the newest."""
    path = ROOT / "build/cmake" / which / "cmake/data/bin/cmake"
    return str(path) if path.exists() else pytest.skip(f"no {path}: tools/setup test gets it, with a network")


def install(cmake: str, folder: Path) -> Path:
    """Installs the headers with a CMake, and moves them. @returns where they are then."""
    build = folder / "build"
    prefix = f"-DCMAKE_INSTALL_PREFIX={folder / 'first'}"
    run(cmake, "-S", ROOT, "-B", build, "-DNDTREE_BUILD_PREBUILT=OFF", prefix)
    run(cmake, "--build", build)
    run(cmake, "--install", build)
    return (folder / "first").rename(folder / "moved")


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return install(program("cmake"), tmp_path_factory.mktemp("system"))


@pytest.mark.long
@pytest.mark.parametrize(("installer", "user"), [("newest", "oldest"), ("oldest", "newest")])
def test_one_cmake_finds_what_another_installed(tmp_path: Path, installer: str, user: str) -> None:
    prefix = install(find_cmake(installer), tmp_path)
    cmake = find_cmake(user)
    build = tmp_path / "use"
    run(cmake, "-S", CONSUMER, "-B", build, "-DCONSUMER_SOURCE=header.cpp", f"-DCMAKE_PREFIX_PATH={prefix}")
    run(cmake, "--build", build)
    run(build / "consumer")


def test_added_as_a_subdirectory_nothing_of_ours_is_installed(tmp_path: Path) -> None:
    cmake = find_cmake("oldest")
    build = tmp_path / "use"
    run(cmake, "-S", CONSUMER, "-B", build, "-DCONSUMER_SOURCE=header.cpp", f"-DNDTREE_SOURCE_DIR={ROOT}")
    run(cmake, "--build", build)
    run(build / "consumer")
    run(cmake, "--install", build, "--prefix", tmp_path / "prefix")
    assert not list(tmp_path.glob("prefix/**/*ndtree*"))


def test_folders_and_libraries_are_named_for_workspaces_of_ros(tmp_path: Path, installed: Path) -> None:
    """catkin and ament pass on variables of a package: the folders alone suffice, and the libraries alone."""
    (tmp_path / "CMakeLists.txt").write_text(
        f"""
        cmake_minimum_required(VERSION 3.16)
        project(robot LANGUAGES CXX)
        set(CMAKE_CXX_STANDARD 17)
        find_package(ndtree CONFIG REQUIRED)
        add_library(by_folders OBJECT "{CONSUMER}/header.cpp")
        target_include_directories(by_folders PRIVATE ${{ndtree_INCLUDE_DIRS}})
        add_executable(by_libraries "{CONSUMER}/header.cpp")
        target_link_libraries(by_libraries ${{ndtree_LIBRARIES}})
        if(NOT TARGET "${{ndtree_TARGETS}}")
          message(FATAL_ERROR "no target: ${{ndtree_TARGETS}}")
        endif()
        """
    )
    cmake = program("cmake")
    run(cmake, "-S", tmp_path, "-B", tmp_path / "build", f"-DCMAKE_PREFIX_PATH={installed}")
    run(cmake, "--build", tmp_path / "build")


@pytest.mark.long
@pytest.mark.parametrize(("compiler", "standard"), [("g++", "23"), ("clang++", "20")])
def test_strict_compilers_have_nothing_to_say(installed: Path, compiler: str, standard: str) -> None:
    pkg_config = program("pkg-config")
    path = {"PKG_CONFIG_PATH": str(installed / "share/pkgconfig")}
    flags = run(pkg_config, "--cflags", "ndtree", env=path).split()
    assert f"-I{installed}/include" in [flag.replace("share/pkgconfig/../../", "") for flag in flags]
    eigen = run(pkg_config, "--cflags-only-I", "eigen3").replace("-I", "-isystem ").split()
    name = {"23": "c++2b"}.get(standard, f"c++{standard}")  # GCC 11 to 13 know C++23 by its first name.
    words = [f"-std={name}", *STRICT, *flags, *eigen, "-fsyntax-only", str(CONSUMER / "main.cpp")]
    run(program(compiler), *words)


def test_compiled_maps_are_found_by_pkg_config(tmp_path: Path) -> None:
    """Their library itself is compiled and linked by the C++ tests."""
    build = tmp_path / "build"
    where = [f"-DCMAKE_INSTALL_PREFIX={tmp_path / 'prefix'}", "-DCMAKE_INSTALL_LIBDIR=lib/here"]
    run(program("cmake"), "-S", ROOT, "-B", build, *where)
    path = {"PKG_CONFIG_PATH": str(build)}
    pkg_config = program("pkg-config")
    assert "-DNDTREE_PREBUILT" in run(pkg_config, "--cflags", "ndtree-prebuilt", env=path).split()
    assert run(pkg_config, "--modversion", "ndtree-prebuilt", env=path).strip() == VERSION
    libdir = run(pkg_config, "--variable=libdir", "ndtree-prebuilt", env=path).strip()
    assert libdir == f"{build}/../../../lib/here"  # From lib/here/pkgconfig, where it will be.
    # vcpkg, which has one folder of headers for two builds, moves what is said in these words.
    assert "includedir=${prefix}/include" in (build / "ndtree.pc").read_text().splitlines()


def test_without_eigen_one_line_says_what_to_install(tmp_path: Path) -> None:
    call = [program("cmake"), "-S", ROOT, "-B", tmp_path, "-DCMAKE_DISABLE_FIND_PACKAGE_Eigen3=ON"]
    done = subprocess.run(call, capture_output=True, text=True)
    assert done.returncode != 0
    message = " ".join(done.stderr.split())
    assert "Eigen 3.3 or later is missing" in message
    assert "libeigen3-dev" in message
    assert message.count("CMake Error") == 1


@pytest.mark.parametrize(("provides", "name"), [("FetchContent", "folder"), ("a target", "installed")])
def test_eigen_that_a_project_brings_along_is_taken(
    tmp_path: Path, installed: Path, provides: str, name: str
) -> None:
    """With nothing installed that find_package() could find; ndtree as a folder that is installed with the
    project, or as an installed copy."""
    headers = run(program("pkg-config"), "--cflags-only-I", "eigen3").strip().removeprefix("-I")
    eigen = tmp_path / "eigen"
    eigen.mkdir()
    (eigen / "CMakeLists.txt").write_text(
        f"""
        add_library(eigen INTERFACE)
        target_include_directories(eigen SYSTEM INTERFACE "{headers}")
        add_library(Eigen3::Eigen ALIAS eigen)
        """
    )
    bring = {
        "a target": "add_subdirectory(eigen)\nset(CMAKE_DISABLE_FIND_PACKAGE_Eigen3 ON)",
        "FetchContent": """include(FetchContent)
        FetchContent_Declare(Eigen3 SOURCE_DIR "${CMAKE_SOURCE_DIR}/eigen" OVERRIDE_FIND_PACKAGE)""",
    }[provides]
    line = {
        "folder": f'set(NDTREE_INSTALL ON)\nadd_subdirectory("{ROOT}" ndtree)',
        "installed": f'find_package(ndtree REQUIRED PATHS "{installed}" NO_DEFAULT_PATH)',
    }[name]
    (tmp_path / "CMakeLists.txt").write_text(
        f"""
        cmake_minimum_required(VERSION 3.24)
        project(consumer CXX)
        {bring}
        {line}
        add_executable(header "{CONSUMER}/header.cpp")
        target_link_libraries(header ndtree::ndtree)
        """
    )
    cmake = program("cmake")
    run(cmake, "-S", tmp_path, "-B", tmp_path / name, "-DNDTREE_BUILD_PREBUILT=OFF")
    run(cmake, "--build", tmp_path / name, "--target", "header")
    if name == "folder":
        targets = run(cmake, "--install", tmp_path / name, "--prefix", tmp_path / "prefix")
        assert "ndtreeTargets.cmake" in targets


def test_the_lines_for_fetchcontent_are_all_that_a_project_needs(tmp_path: Path) -> None:
    page = (ROOT / "docs/install.md").read_text()
    (lines,) = [code for code in blocks(page, "cmake") if "FetchContent" in code]
    assert len(lines.splitlines()) == 4
    code = lines.replace("/path/to/ndtree", str(ROOT))
    (tmp_path / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.16)\nproject(consumer CXX)\n"
        f'add_executable(robot "{CONSUMER}/header.cpp")\n{code}'
    )
    cmake = program("cmake")
    run(cmake, "-S", tmp_path, "-B", tmp_path / "build")
    run(cmake, "--build", tmp_path / "build", "--target", "robot")


def test_cpack_makes_a_debian_package_of_the_headers(tmp_path: Path) -> None:
    dpkg = program("dpkg-deb")
    cmake = program("cmake")
    run(cmake, "-S", ROOT, "-B", tmp_path, "-DNDTREE_BUILD_PREBUILT=OFF")
    run(program("cpack"), "--config", tmp_path / "CPackConfig.cmake", "-B", tmp_path / "packages")
    (package,) = (tmp_path / "packages").glob("*.deb")
    fields = dict(re.findall(r"^([\w-]+): (.*)$", run(dpkg, "--field", package), re.M))
    assert (fields["Package"], fields["Version"]) == ("libndtree-dev", VERSION)
    assert "libeigen3-dev" in fields["Depends"]
    files = {line.split()[-1] for line in run(dpkg, "--contents", package).splitlines()}
    headers = {f"./usr/{path.relative_to(ROOT)}" for path in (ROOT / "include").rglob("*.hpp")}
    assert len(headers) > 50
    assert headers <= files
    assert {"./usr/share/cmake/ndtree/ndtreeConfig.cmake", "./usr/share/pkgconfig/ndtree.pc"} <= files


def test_all_say_the_same_version() -> None:
    package = ElementTree.parse(ROOT / "package.xml").getroot()
    said = {
        "package.xml": package.findtext("version"),
        "debian/changelog": re.match(r"ndtree \(([\d.]+)", (ROOT / "debian/changelog").read_text())[1],
        "packaging/vcpkg/ndtree/vcpkg.json": json.loads(
            (ROOT / "packaging/vcpkg/ndtree/vcpkg.json").read_text()
        )["version"],
        "CITATION.cff": re.search(r"^version: ([\d.]+)$", (ROOT / "CITATION.cff").read_text(), re.M)[1],
    }
    assert said == dict.fromkeys(said, VERSION)
