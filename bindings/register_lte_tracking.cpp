#include "register.hpp"

namespace soopnav::python {

void register_lte_tracking(pybind11::module_&) {}

}  // namespace soopnav::python
