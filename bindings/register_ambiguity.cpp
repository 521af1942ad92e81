#include <pybind11/pybind11.h>

#include "register.hpp"

namespace soopnav::python {

void register_ambiguity(pybind11::module_& /*module*/) {}

}  // namespace soopnav::python
