#pragma once

#include <pybind11/pybind11.h>

/// One function per module of the engine; each fills the submodule it is given.
namespace soopnav::python {

void register_dsp(pybind11::module_& module);
void register_estimation(pybind11::module_& module);
void register_geometry(pybind11::module_& module);
void register_lte(pybind11::module_& module);
void register_navigation(pybind11::module_& module);
void register_simulation(pybind11::module_& module);

}  // namespace soopnav::python
