#include <pybind11/pybind11.h>

#include "register.hpp"

namespace soopnav::python {

void register_sop_catalog([[maybe_unused]] pybind11::module_& module) {}

}  // namespace soopnav::python
