#include <pybind11/pybind11.h>

#include "register.hpp"

namespace soopnav::python {

void register_gps_phase([[maybe_unused]] pybind11::module_& module) {}

}  // namespace soopnav::python
