#pragma once

#include <pybind11/pybind11.h>

namespace soopnav::python {

void register_sounding(pybind11::module_& simulation);
void register_node_mapper(pybind11::module_& navigation);

}  // namespace soopnav::python
