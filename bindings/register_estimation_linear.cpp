#include <pybind11/native_enum.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/estimation/linear_filter.hpp"
#include "soopnav/estimation/rts_smoother.hpp"

namespace soopnav::python {

namespace {

// (rows, columns) or (T, rows, columns).
MatrixSeries series(const NumbersBase& numbers) {
  numbers.require_axes({2, 3}, "one matrix, or one for each step along the first axis");
  const auto& shape = numbers.shape();
  const std::size_t last = shape.size() - 1;
  const auto size = [&shape](std::size_t axis) { return static_cast<int>(shape[axis]); };
  return {numbers.span(), size(last - 1), size(last), last == 2 ? size(0) : 1};
}

// "z: shape (30, 3), expected (T, 2): H has 2 rows".
std::string width(const char* name, const NumbersBase& got, int expected, const char* whose, const char* what) {
  const std::string columns = std::to_string(expected);
  std::string text = name;
  text.append(": shape (").append(std::to_string(got.shape()[0])).append(", ");
  text.append(std::to_string(got.shape()[1])).append("), expected (T, ").append(columns).append("): ");
  return text.append(whose).append(" ").append(columns).append(" ").append(what);
}

py::tuple filter(const Numbers<"F">& F, const Numbers<"Q">& Q, const Numbers<"H">& H, const Numbers<"R">& R,
                 const Numbers<"z">& z, const Numbers<"x0">& x0, const Numbers<"P0">& P0,
                 const std::optional<Numbers<"B">>& B, const std::optional<Numbers<"u">>& u,
                 const std::optional<py::array_t<std::uint8_t, py::array::c_style | py::array::forcecast>>& mask) {
  LinearSystem system{series(F), series(Q), series(H), series(R)};
  z.require_axes({2}, "shape (T, m)");
  if (z.shape()[1] != system.H.rows) {
    throw py::value_error(width("z", z, system.H.rows, "H has", "rows"));
  }
  x0.require_axes({1}, "shape (n,)");
  P0.require_axes({2}, "shape (n, n)");
  LinearData data{.z = z.span()};
  if (B) system.B = series(*B);
  if (u) {
    u->require_axes({2}, "shape (T, p)");
    if (B && u->shape()[1] != system.B.columns) {
      throw py::value_error(width("u", *u, system.B.columns, "B has", "columns"));
    }
    data.u = u->span();
  }
  if (mask) data.present = {mask->data(), static_cast<std::size_t>(mask->size())};
  const Eigen::Map<const Eigen::VectorXd> start(x0.span().data(), static_cast<Eigen::Index>(x0.span().size()));
  const Eigen::MatrixXd covariance = Eigen::Map<const RowMajorMatrix>(P0.span().data(), P0.shape()[0], P0.shape()[1]);

  std::unique_ptr<LinearRun> run;
  {
    const py::gil_scoped_release release;
    run = std::make_unique<LinearRun>(linear_filter(system, data, start, covariance));
  }
  const LinearRun& r = *run;
  const py::capsule owner(run.get(), [](void* p) noexcept { delete static_cast<LinearRun*>(p); });
  static_cast<void>(run.release());
  const py::ssize_t T = r.steps;
  const py::ssize_t n = r.n;
  const py::ssize_t m = r.m;
  const auto array = [&owner](std::span<const double> values, std::vector<py::ssize_t> shape) {
    return view_array(values, owner, std::move(shape));
  };
  const std::span status(reinterpret_cast<const std::uint8_t*>(r.status.data()), r.status.size());
  return py::make_tuple(array(r.x_pred, {T, n}), array(r.P_pred, {T, n, n}), array(r.x, {T, n}), array(r.P, {T, n, n}),
                        array(r.innovation, {T, m}), array(r.S, {T, m, m}), array(r.nis, {T}),
                        array(r.step_log_likelihood, {T}), view_array(status, owner), r.log_likelihood);
}

py::tuple smooth(const Numbers<"F">& F, const Numbers<"x_pred">& x_pred, const Numbers<"P_pred">& P_pred,
                 const Numbers<"x">& x, const Numbers<"P">& P) {
  const MatrixSeries transitions = series(F);
  x.require_axes({2}, "shape (T, n)");
  if (x.shape()[1] != transitions.rows) {
    throw py::value_error(width("x", x, transitions.rows, "F has", "rows"));
  }
  x_pred.require_axes({2}, "shape (T, n)");
  P_pred.require_axes({3}, "shape (T, n, n)");
  P.require_axes({3}, "shape (T, n, n)");
  const py::ssize_t steps = x.shape()[0];
  const py::ssize_t n = x.shape()[1];
  py::array_t<double> x_smooth({steps, n});
  py::array_t<double> P_smooth({steps, n, n});
  const std::span<double> x_out(x_smooth.mutable_data(), static_cast<std::size_t>(x_smooth.size()));
  const std::span<double> P_out(P_smooth.mutable_data(), static_cast<std::size_t>(P_smooth.size()));
  {
    const py::gil_scoped_release release;
    rts_smooth(transitions, x_pred.span(), P_pred.span(), x.span(), P.span(), x_out, P_out);
  }
  return py::make_tuple(std::move(x_smooth), std::move(P_smooth));
}

}  // namespace

void register_estimation_linear(py::module_& m) {
  static_assert(std::is_same_v<std::underlying_type_t<StepStatus>, std::uint8_t>);
  py::native_enum<StepStatus>(m, "StepStatus", "enum.IntEnum", "How a step of a linear filter ended.")
      .value("UPDATED", StepStatus::kUpdated)
      .value("NO_OBSERVATION", StepStatus::kNoObservation)
      .value("NON_FINITE", StepStatus::kNonFinite)
      .value("NOT_POSITIVE_DEFINITE", StepStatus::kNotPositiveDefinite)
      .finalize();
  m.def("linear_filter", &filter, py::arg("F"), py::arg("Q"), py::arg("H"), py::arg("R"), py::arg("z"), py::arg("x0"),
        py::arg("P0"), py::kw_only(), py::arg("B") = py::none(), py::arg("u") = py::none(),
        py::arg("mask") = py::none(),
        "Kalman filter over a whole run: x_pred, P_pred, x, P, innovation, S, nis, step_log_likelihood, status, "
        "log_likelihood.");
  m.def("rts_smooth", &smooth, py::arg("F"), py::arg("x_pred"), py::arg("P_pred"), py::arg("x"), py::arg("P"),
        "Rauch-Tung-Striebel smoother over a whole run: x, P.");
}

}  // namespace soopnav::python
