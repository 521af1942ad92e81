#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <string>
#include <utility>

#include "array.hpp"
#include "erased_model.hpp"
#include "register.hpp"

namespace soopnav::python {

namespace {

py::tuple predict(const AnyMeasurement& self, const std::string& state, const Numbers<"x">& x) {
  x.require_axes({1}, "shape (n,)");
  const StateInfo info = state_info(state, x.span().size());
  const auto rows = row_sources(self, info);
  py::array_t<double> h(static_cast<py::ssize_t>(rows.size()));
  py::array_t<double> H({static_cast<py::ssize_t>(rows.size()), static_cast<py::ssize_t>(info.roles.size)});
  std::fill_n(H.mutable_data(), H.size(), 0.0);
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const auto row = static_cast<py::ssize_t>(i);
    if (!rows[i].evaluate(rows[i].context, rows[i].row, info.roles, x.span().data(), h.mutable_data(row),
                          H.mutable_data(row, 0))) {
      throw py::value_error("x: " + self.kind() + " is undefined there");
    }
  }
  return py::make_tuple(h, H);
}

AnyMeasurement make(const std::string& kind, Parameters::Values parameters) {
  return {kind, Parameters(std::move(parameters))};
}

}  // namespace

void register_measurement(py::module_& m) {
  py::class_<AnyMeasurement>(m, "Measurement", "A measurement model: see soopnav_cpp.measurement. Immutable.")
      .def(py::init(&make), py::arg("kind"), py::arg("parameters"))
      .def_property_readonly("kind", &AnyMeasurement::kind, "Name of the model.")
      .def_property_readonly("rows", &AnyMeasurement::rows, "Numbers of one measurement.")
      .def("predict", &predict, py::arg("state"), py::arg("x"),
           "Value and Jacobian at a state: (h, H) of shapes (m,) and (m, n). ValueError where undefined.")
      .def("__repr__", &AnyMeasurement::text)
      .def(
          "__eq__", [](const AnyMeasurement& a, const AnyMeasurement& b) { return a == b; }, py::is_operator())
      .def("__hash__", [](const AnyMeasurement& a) { return std::hash<std::string>{}(a.text()); })
      .def(py::pickle([](const AnyMeasurement& a) { return py::make_tuple(a.kind(), a.parameters().values()); },
                      [](const py::tuple& saved) {
                        return make(saved[0].cast<std::string>(), saved[1].cast<Parameters::Values>());
                      }));
}

}  // namespace soopnav::python
