# SPDX-License-Identifier: BSD-3-Clause
# Target ndtree_octomap_baseline: OctoMap behind our own interface, for comparisons. It exists only where
# OctoMap does; whoever links it sees NDTREE_HAVE_OCTOMAP and octomap_baseline.hpp, but no OctoMap header.

find_package(octomap CONFIG QUIET)
if(NOT octomap_FOUND)
  message(STATUS "OctoMap not found: building without the OctoMap baseline")
  return()
endif()

# The static library keeps a wheel free of system libraries, if it may go into a shared object.
set(octomap_libraries ${OCTOMAP_LIBRARIES})
if(TARGET octomap-static AND TARGET octomath-static)
  include(CheckCXXSourceCompiles)
  set(CMAKE_REQUIRED_FLAGS -fPIC)
  set(CMAKE_REQUIRED_LINK_OPTIONS -shared)
  set(CMAKE_REQUIRED_LIBRARIES octomap-static octomath-static)
  check_cxx_source_compiles("
    #include <octomap/AbstractOcTree.h>
    octomap::AbstractOcTree* read(const char* file) { return octomap::AbstractOcTree::read(file); }
    int main() { return read(\"\") != nullptr; }" NDTREE_OCTOMAP_STATIC_IS_PIC)
  unset(CMAKE_REQUIRED_FLAGS)
  unset(CMAKE_REQUIRED_LINK_OPTIONS)
  unset(CMAKE_REQUIRED_LIBRARIES)
  if(NDTREE_OCTOMAP_STATIC_IS_PIC)
    set(octomap_libraries octomap-static octomath-static)
  endif()
endif()
if(NDTREE_BUILD_PYTHON AND NOT NDTREE_OCTOMAP_STATIC_IS_PIC)
  message(STATUS "OctoMap is linked as a shared library: the Python module needs it at run time")
endif()

add_library(ndtree_octomap_baseline STATIC "${PROJECT_SOURCE_DIR}/tools/compare/octomap_baseline.cpp")
set_target_properties(ndtree_octomap_baseline PROPERTIES
  POSITION_INDEPENDENT_CODE ON CXX_VISIBILITY_PRESET hidden VISIBILITY_INLINES_HIDDEN ON)
target_include_directories(ndtree_octomap_baseline PUBLIC "${PROJECT_SOURCE_DIR}/tools/compare")
target_include_directories(ndtree_octomap_baseline SYSTEM PRIVATE ${OCTOMAP_INCLUDE_DIRS})
target_compile_definitions(ndtree_octomap_baseline PUBLIC NDTREE_HAVE_OCTOMAP)
target_link_libraries(ndtree_octomap_baseline
  PUBLIC ndtree::ndtree PRIVATE ndtree_build_options ${octomap_libraries})
