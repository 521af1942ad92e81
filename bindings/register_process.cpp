#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <string>
#include <utility>

#include "array.hpp"
#include "erased_model.hpp"
#include "register.hpp"

namespace soopnav::python {

namespace {

py::tuple propagate(const AnyProcess& self, const std::string& state, const Numbers<"x">& x, double dt_s,
                    const std::optional<Numbers<"input">>& input) {
  x.require_axes({1}, "shape (n,)");
  const StateInfo info = state_info(state, x.span().size());
  const ProcessSource source = process_source(self, info);
  if (!(dt_s > 0.0) || std::isinf(dt_s)) throw py::value_error("dt_s: not a positive finite number");
  const auto size = static_cast<std::size_t>(source.input_size);
  if ((input ? input->span().size() : 0) != size) {
    throw py::value_error("input: " + self.kind() + " expects " + std::to_string(size) + " numbers");
  }
  constexpr std::array<double, 3> kNone{};
  const Eigen::Index n = info.roles.size;
  Eigen::VectorXd next = Eigen::Map<const Eigen::VectorXd>(x.span().data(), n);
  Eigen::MatrixXd F = Eigen::MatrixXd::Identity(n, n);
  Eigen::MatrixXd G = Eigen::MatrixXd::Zero(n, n + kMostMotionNoise<kMaxCustomDim>);
  StepSink sink{
      .next = next.data(), .F = F.data(), .G = G.data(), .stride = static_cast<int>(n), .F_asked = 0, .G_asked = 0};
  if (!source.propagate(info.roles, x.span().data(), size == 0 ? kNone.data() : input->span().data(), dt_s, sink)) {
    throw py::value_error("x: " + self.kind() + " is undefined there");
  }
  if (info.roles.heading >= 0) next[info.roles.heading] = wrap_to_pi(next[info.roles.heading]);
  const Eigen::MatrixXd Q = G * G.transpose();
  py::array_t<double> out_x(n);
  py::array_t<double> out_F({n, n});
  py::array_t<double> out_Q({n, n});
  for (Eigen::Index i = 0; i < n; ++i) {
    out_x.mutable_at(i) = next[i];
    for (Eigen::Index j = 0; j < n; ++j) {
      out_F.mutable_at(i, j) = F(i, j);
      out_Q.mutable_at(i, j) = Q(i, j);
    }
  }
  return py::make_tuple(out_x, out_F, out_Q);
}

AnyProcess make(const std::string& kind, Parameters::Values parameters) {
  return {kind, Parameters(std::move(parameters))};
}

}  // namespace

void register_process(py::module_& m) {
  py::class_<AnyProcess>(m, "Process", "A process model: see soopnav_cpp.process. Immutable.")
      .def(py::init(&make), py::arg("kind"), py::arg("parameters"))
      .def_property_readonly("kind", &AnyProcess::kind, "Name of the model.")
      .def_property_readonly("input_size", &AnyProcess::input_size, "Numbers of an input; 0 when driven by nothing.")
      .def("propagate", &propagate, py::arg("state"), py::arg("x"), py::arg("dt_s"), py::arg("input") = py::none(),
           "One step: (x_next, F, Q) of shapes (n,), (n, n) and (n, n).")
      .def("__repr__", &AnyProcess::text)
      .def(
          "__eq__", [](const AnyProcess& a, const AnyProcess& b) { return a == b; }, py::is_operator())
      .def("__hash__", [](const AnyProcess& a) { return std::hash<std::string>{}(a.text()); })
      .def(py::pickle([](const AnyProcess& a) { return py::make_tuple(a.kind(), a.parameters().values()); },
                      [](const py::tuple& saved) {
                        return make(saved[0].cast<std::string>(), saved[1].cast<Parameters::Values>());
                      }));
}

}  // namespace soopnav::python
