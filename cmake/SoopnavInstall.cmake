# Install rules and the package files that find_package(soopnav) reads. A wheel takes only the component "python",
# which is the extension.
include(CMakePackageConfigHelpers)
get_property(soopnav_modules GLOBAL PROPERTY SOOPNAV_MODULES)
set(soopnav_targets ${soopnav_modules})
list(TRANSFORM soopnav_targets PREPEND soopnav_)
set(soopnav_package_dir ${CMAKE_INSTALL_LIBDIR}/cmake/soopnav)

install(TARGETS ${soopnav_targets} EXPORT soopnavTargets)
install(DIRECTORY cpp/include/soopnav DESTINATION ${CMAKE_INSTALL_INCLUDEDIR})
install(EXPORT soopnavTargets NAMESPACE soopnav:: DESTINATION ${soopnav_package_dir})
configure_package_config_file(cmake/soopnavConfig.cmake.in soopnavConfig.cmake
  INSTALL_DESTINATION ${soopnav_package_dir})
write_basic_package_version_file(soopnavConfigVersion.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${CMAKE_CURRENT_BINARY_DIR}/soopnavConfig.cmake ${CMAKE_CURRENT_BINARY_DIR}/soopnavConfigVersion.cmake
              cmake/FindFFTW3f.cmake cmake/FindOpenCVVideo.cmake cmake/FindRandom123.cmake
        DESTINATION ${soopnav_package_dir})
