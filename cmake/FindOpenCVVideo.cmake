# Finds the libraries core, imgproc and video of OpenCV 4 or later, and makes the target OpenCVVideo::OpenCVVideo. OpenCV's
# own package file is asked first; distributions that split OpenCV ship it only beside all of its libraries, so then
# headers and libraries are looked for by themselves.
find_package(OpenCV 4 QUIET CONFIG COMPONENTS core imgproc video)
if(OpenCV_FOUND)
  set(OpenCVVideo_VERSION ${OpenCV_VERSION})
  set(OpenCVVideo_INCLUDE_DIR ${OpenCV_INCLUDE_DIRS})
  set(OpenCVVideo_libraries opencv_video opencv_imgproc opencv_core)
  set(OpenCVVideo_LIBRARY opencv_video)
else()
  find_path(OpenCVVideo_INCLUDE_DIR opencv2/video/tracking.hpp PATH_SUFFIXES opencv4 opencv5)
  set(OpenCVVideo_libraries "")
  # Dependants first, as static libraries want it.
  foreach(part IN ITEMS video imgproc core)
    find_library(OpenCVVideo_${part}_LIBRARY opencv_${part})
    mark_as_advanced(OpenCVVideo_${part}_LIBRARY)
    list(APPEND OpenCVVideo_libraries "${OpenCVVideo_${part}_LIBRARY}")
  endforeach()
  set(OpenCVVideo_LIBRARY "${OpenCVVideo_video_LIBRARY}")
  if(NOT OpenCVVideo_imgproc_LIBRARY OR NOT OpenCVVideo_core_LIBRARY)
    set(OpenCVVideo_LIBRARY "OpenCVVideo_LIBRARY-NOTFOUND")
  endif()
  if(OpenCVVideo_INCLUDE_DIR AND EXISTS "${OpenCVVideo_INCLUDE_DIR}/opencv2/core/version.hpp")
    file(STRINGS "${OpenCVVideo_INCLUDE_DIR}/opencv2/core/version.hpp" OpenCVVideo_lines
      REGEX "#define CV_VERSION_(MAJOR|MINOR|REVISION)")
    string(REGEX REPLACE ".*MAJOR +([0-9]+).*MINOR +([0-9]+).*REVISION +([0-9]+).*" "\\1.\\2.\\3" OpenCVVideo_VERSION
      "${OpenCVVideo_lines}")
  endif()
endif()
include(FindPackageHandleStandardArgs)
find_package_handle_standard_args(OpenCVVideo REQUIRED_VARS OpenCVVideo_LIBRARY OpenCVVideo_INCLUDE_DIR
  VERSION_VAR OpenCVVideo_VERSION)
if(OpenCVVideo_FOUND AND NOT TARGET OpenCVVideo::OpenCVVideo)
  add_library(OpenCVVideo::OpenCVVideo INTERFACE IMPORTED)
  set_target_properties(OpenCVVideo::OpenCVVideo PROPERTIES
    INTERFACE_LINK_LIBRARIES "${OpenCVVideo_libraries}" INTERFACE_INCLUDE_DIRECTORIES "${OpenCVVideo_INCLUDE_DIR}")
endif()
mark_as_advanced(OpenCVVideo_INCLUDE_DIR)
