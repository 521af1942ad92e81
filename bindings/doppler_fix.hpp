#pragma once

#include <pybind11/pybind11.h>

namespace soopnav::python {

/// Adds `doppler_fix` to a module; the face is soopnav_cpp/_doppler_fix.py.
void register_doppler_fix(pybind11::module_& m);

}  // namespace soopnav::python
