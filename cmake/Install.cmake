# SPDX-License-Identifier: BSD-3-Clause
# What is installed beside programs: the headers and the compiled maps, and what CMake, pkg-config and the workspaces
# of ROS find them by. With CPack, the same as Debian packages.
include(CMakePackageConfigHelpers)

# Headers alone are the same for all machines.
if(NDTREE_BUILD_PREBUILT)
  set(package_root "${CMAKE_INSTALL_LIBDIR}")
  set(full_package_root "${CMAKE_INSTALL_FULL_LIBDIR}")
  set(targets ndtree ndtree_prebuilt)
else()
  set(package_root "${CMAKE_INSTALL_DATADIR}")
  set(full_package_root "${CMAKE_INSTALL_FULL_DATADIR}")
  set(targets ndtree)
  set(arch_independent ARCH_INDEPENDENT)
endif()

install(DIRECTORY "${PROJECT_SOURCE_DIR}/include/ndtree" DESTINATION "${CMAKE_INSTALL_INCLUDEDIR}"
  COMPONENT development FILES_MATCHING PATTERN "*.hpp")
install(TARGETS ${targets} EXPORT ndtreeTargets
  ARCHIVE DESTINATION "${CMAKE_INSTALL_LIBDIR}" COMPONENT development)

# find_package(ndtree CONFIG)
set(package_dir "${package_root}/cmake/ndtree")
install(EXPORT ndtreeTargets NAMESPACE ndtree:: DESTINATION "${package_dir}" COMPONENT development)
configure_package_config_file("${PROJECT_SOURCE_DIR}/cmake/ndtreeConfig.cmake.in"
  "${PROJECT_BINARY_DIR}/ndtreeConfig.cmake" INSTALL_DESTINATION "${package_dir}" NO_SET_AND_CHECK_MACRO)
write_basic_package_version_file("${PROJECT_BINARY_DIR}/ndtreeConfigVersion.cmake"
  COMPATIBILITY SameMinorVersion ${arch_independent})
install(FILES "${PROJECT_BINARY_DIR}/ndtreeConfig.cmake" "${PROJECT_BINARY_DIR}/ndtreeConfigVersion.cmake"
  DESTINATION "${package_dir}" COMPONENT development)

# pkg-config: folders relative to the file's own, so that an installed tree may be moved, and by way of "prefix", which
# vcpkg and "pkg-config --define-prefix" replace.
file(RELATIVE_PATH pc_to_prefix "${full_package_root}/pkgconfig" "${CMAKE_INSTALL_PREFIX}")
string(REGEX REPLACE "/$" "" pc_to_prefix "${pc_to_prefix}")  # A folder above is "../" in CMake's words.
file(RELATIVE_PATH prefix_to_include "${CMAKE_INSTALL_PREFIX}" "${CMAKE_INSTALL_FULL_INCLUDEDIR}")
file(RELATIVE_PATH prefix_to_lib "${CMAKE_INSTALL_PREFIX}" "${CMAKE_INSTALL_FULL_LIBDIR}")
set(pc_files ndtree.pc)
if(NDTREE_BUILD_PREBUILT)
  list(APPEND pc_files ndtree-prebuilt.pc)
endif()
foreach(file IN LISTS pc_files)
  configure_file("${PROJECT_SOURCE_DIR}/cmake/${file}.in" "${PROJECT_BINARY_DIR}/${file}" @ONLY)
  install(FILES "${PROJECT_BINARY_DIR}/${file}" DESTINATION "${package_root}/pkgconfig" COMPONENT development)
endforeach()

# colcon and catkin read package.xml; "ros2 pkg" knows a package by an empty file of its name.
install(FILES "${PROJECT_SOURCE_DIR}/package.xml" DESTINATION "${CMAKE_INSTALL_DATADIR}/ndtree" COMPONENT development)
file(WRITE "${PROJECT_BINARY_DIR}/ament_index/ndtree" "")
install(FILES "${PROJECT_BINARY_DIR}/ament_index/ndtree"
  DESTINATION "${CMAKE_INSTALL_DATADIR}/ament_index/resource_index/packages" COMPONENT development)

if(ndtree_is_top_level)
  include("${PROJECT_SOURCE_DIR}/cmake/Packages.cmake")
endif()
