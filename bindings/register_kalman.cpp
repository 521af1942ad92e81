#include <pybind11/native_enum.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <string>
#include <string_view>
#include <utility>

#include "array.hpp"
#include "kalman.hpp"
#include "kalman_arguments.hpp"
#include "register.hpp"

namespace soopnav::python {

namespace {

PyKalmanFilter make_filter(const std::string& kind, const std::string& state, const Numbers<"x0">& x0,
                           const Numbers<"P0">& P0, const std::vector<double>& options, bool information) {
  x0.require_axes({1}, "shape (n,)");
  // Names the state before shapes are held against it.
  const StateInfo info = state_info(state, x0.span().size());
  return {kind,
          {info.name, to_vector(x0.span()), to_square(P0, x0.span().size(), information ? "information" : "P0"),
           options, information}};
}

UpdateStatus predict(PyKalmanFilter& self, const py::object& process, double dt_s,
                     const std::optional<Numbers<"input">>& input, const std::optional<Numbers<"Q">>& Q) {
  if (py::isinstance<AnyProcess>(process)) {
    const auto& model = process.cast<const AnyProcess&>();
    if (Q) throw py::value_error("Q: goes with a callable; " + model.kind() + " knows its own noise");
    const auto size = static_cast<std::size_t>(model.input_size());
    return self.filter->predict(model, to_input(input, size, model.kind()), dt_s, nullptr);
  }
  if (!PyCallable_Check(process.ptr())) {
    throw py::type_error("process: expected a process model or a callable, got " + describe(process));
  }
  if (!Q) throw py::value_error("Q: a callable needs the covariance of its noise");
  if (input) throw py::value_error("input: a callable keeps its own");
  if (!(dt_s > 0.0) || std::isinf(dt_s)) return UpdateStatus::kTimeNotAdvancing;
  return self.filter->predict(py::reinterpret_borrow<py::function>(process), to_square(*Q, self.n(), "Q"), dt_s);
}

KalmanReport update(PyKalmanFilter& self, const py::object& model, const Numbers<"z">& z, const Numbers<"R">& R,
                    const std::optional<double>& gate_nis, const std::optional<double>& gate_residual,
                    const std::optional<double>& gate_residual_sigmas, const std::vector<std::size_t>& angle_rows) {
  const Gate gate = to_gate(gate_nis, gate_residual, gate_residual_sigmas);
  return take_update(
      model, z, R, angle_rows,
      [&](const Models& models, std::span<const double> noise) {
        return self.filter->update(models, z.span(), noise, gate);
      },
      [&](const CallableMeasurement& own, std::span<const double> noise) {
        return self.filter->update(own, z.span(), noise, gate);
      });
}

py::dict run(PyKalmanFilter& self, const Numbers<"time_s">& time_s, const AnyProcess& process,
             const GroupArguments& measurements, const std::optional<Numbers<"inputs">>& inputs,
             const std::optional<double>& start_s, const std::optional<double>& gate_nis,
             const std::optional<double>& gate_residual, const std::optional<double>& gate_residual_sigmas, bool smooth,
             bool history, std::optional<AdaptiveProcessNoise*> noise) {
  time_s.require_axes({1}, "shape (T,)");
  check_times(time_s.span(), start_s);
  const std::size_t T = time_s.span().size();
  Run run;
  run.time_s = time_s.span();
  run.start_s = start_s;
  run.process = &process;
  run.gate = to_gate(gate_nis, gate_residual, gate_residual_sigmas);
  // Another thread may use the filter meanwhile: what runs without the interpreter's lock is a copy.
  std::unique_ptr<KalmanFilter> copy = self.filter->clone();
  std::optional<AdaptiveProcessNoise> learnt;
  if (noise) learnt = **noise;
  run.noise = learnt ? &*learnt : nullptr;
  run.inputs = to_inputs(inputs, T, static_cast<std::size_t>(process.input_size()), process.kind());
  std::vector<std::vector<double>> matrices;
  run.groups = to_groups(measurements, T, matrices);

  const py::ssize_t t = size_of(T);
  const py::ssize_t n = size_of(self.n());
  const py::ssize_t groups = size_of(measurements.size());
  py::dict out;
  const auto add = [&out](const char* name, std::vector<py::ssize_t> shape) {
    return add_array(out, name, std::move(shape));
  };
  if (history) {
    run.x_pred = add("x_pred", {t, n});
    run.P_pred = add("P_pred", {t, n, n});
    run.x = add("x", {t, n});
    run.P = add("P", {t, n, n});
  }
  if (smooth) {
    run.x_smooth = add("x_smooth", {t, n});
    run.P_smooth = add("P_smooth", {t, n, n});
  }
  if (run.noise != nullptr) run.noise_multiplier = add("noise_multiplier", {t});
  run.nis = add("nis", {t, groups});
  std::fill_n(run.nis, t * groups, std::numeric_limits<double>::quiet_NaN());
  py::array_t<std::uint8_t> status({t, groups});
  run.status = status.mutable_data();
  std::fill_n(run.status, t * groups, kAbsent);
  py::array_t<std::uint8_t> predict_status(t);
  run.predict_status = predict_status.mutable_data();
  {
    const py::gil_scoped_release release;
    copy->run(run);
  }
  self.filter = std::move(copy);
  if (noise) **noise = *learnt;
  out["status"] = status;
  out["predict_status"] = predict_status;
  out["log_likelihood"] = run.log_likelihood;
  return out;
}

std::string repr(const KalmanReport& report) {
  const auto number = [](double value) { return py::str("{:.4g}").format(value).cast<std::string>(); };
  std::string text = "KalmanReport(" + std::string(to_string(report.status));
  if (!std::isnan(report.nis)) {
    text += ", innovation [";
    for (int i = 0; i < report.rows; ++i) {
      text += (i > 0 ? ", " : "") + number(report.innovation[static_cast<std::size_t>(i)]);
    }
    text += "], nis " + number(report.nis) + " (expected " + std::to_string(report.rows) + ")";
  }
  return text + ")";
}

}  // namespace

void register_kalman_report(py::module_& m) {
  static_assert(std::is_same_v<std::underlying_type_t<UpdateStatus>, std::uint8_t>);
  py::native_enum<UpdateStatus>(m, "UpdateStatus", "enum.IntEnum",
                                "What became of an observation or a step. All but ACCEPTED left the filter as it was.")
      .value("ACCEPTED", UpdateStatus::kAccepted)
      .value("GATED", UpdateStatus::kGated)
      .value("UNDEFINED", UpdateStatus::kUndefined)
      .value("NON_FINITE", UpdateStatus::kNonFinite)
      .value("NOT_POSITIVE_DEFINITE", UpdateStatus::kNotPositiveDefinite)
      .value("STALE_HANDLE", UpdateStatus::kStaleHandle)
      .value("WRONG_TIME_SCALE", UpdateStatus::kWrongTimeScale)
      .value("TIME_NOT_ADVANCING", UpdateStatus::kTimeNotAdvancing)
      .value("TOO_LATE", UpdateStatus::kTooLate)
      .value("TOO_MANY_ROWS", UpdateStatus::kTooManyRows)
      .value("ABSENT", static_cast<UpdateStatus>(kAbsent))
      .finalize();

  py::class_<KalmanReport>(m, "KalmanReport", "What became of an update. Read-only.")
      .def_property_readonly(
          "status", [](const KalmanReport& r) { return r.status; }, "An `UpdateStatus`.")
      .def_property_readonly(
          "accepted", [](const KalmanReport& r) { return r.status == UpdateStatus::kAccepted; },
          "Whether the state was updated.")
      .def_property_readonly(
          "innovation",
          [](const KalmanReport& r) {
            return frozen({r.innovation.data(), static_cast<std::size_t>(r.rows)}, {r.rows});
          },
          "z - h(x), angles the short way round; shape (m,). NaN where refused before it was known.")
      .def_property_readonly(
          "covariance",
          [](const KalmanReport& r) {
            return frozen({r.covariance.data(), static_cast<std::size_t>(r.rows * r.rows)}, {r.rows, r.rows});
          },
          "Of the innovation, H P Hᵀ + R; shape (m, m).")
      .def_readonly("nis", &KalmanReport::nis, "Normalised innovation squared.")
      .def_readonly("log_likelihood", &KalmanReport::log_likelihood, "Logarithm of the innovation's density.")
      .def("__repr__", &repr)
      .def(py::pickle(
          [](const KalmanReport& r) {
            return py::make_tuple(static_cast<int>(r.status), r.rows, r.innovation, r.covariance, r.nis,
                                  r.log_likelihood);
          },
          [](const py::tuple& t) {
            if (t.size() != 6) throw py::value_error("KalmanReport: six items expected");
            KalmanReport r;
            r.status = static_cast<UpdateStatus>(t[0].cast<int>());
            r.rows = t[1].cast<int>();
            if (r.rows < 0 || r.rows > kMostRows) throw py::value_error("KalmanReport: too many rows");
            r.innovation = t[2].cast<decltype(r.innovation)>();
            r.covariance = t[3].cast<decltype(r.covariance)>();
            r.nis = t[4].cast<double>();
            r.log_likelihood = t[5].cast<double>();
            return r;
          }));
}

void register_kalman(py::module_& m) {
  py::class_<PyKalmanFilter>(m, "KalmanFilter", "A Kalman filter of any kind: see soopnav_cpp.estimation.")
      .def(py::init(&make_filter), py::arg("kind"), py::arg("state"), py::arg("x0"), py::arg("P0"),
           py::arg("options") = std::vector<double>{}, py::arg("information") = false)
      .def_property_readonly("x", [](const PyKalmanFilter& f) { return frozen(f.filter->x(), {size_of(f.n())}); })
      .def_property_readonly("P",
                             [](const PyKalmanFilter& f) {
                               return frozen(f.filter->P(), {size_of(f.n()), size_of(f.n())});
                             })
      .def_property_readonly("state", [](const PyKalmanFilter& f) { return f.filter->state().name; })
      .def_property_readonly("component_names",
                             [](const PyKalmanFilter& f) { return py::tuple(py::cast(f.filter->state().components)); })
      .def_property_readonly("covariance_floor_counts",
                             [](const PyKalmanFilter& f) { return py::tuple(py::cast(f.filter->save().floor_counts)); })
      .def(
          "set_covariance_floor",
          [](PyKalmanFilter& f, const Numbers<"variance">& variance) { f.filter->set_floor(variance.span()); },
          py::arg("variance"))
      .def("predict", &predict, py::arg("process"), py::arg("dt_s"), py::arg("input") = py::none(),
           py::arg("Q") = py::none())
      .def("update", &update, py::arg("model"), py::arg("z"), py::arg("R"), py::kw_only(),
           py::arg("gate_nis") = py::none(), py::arg("gate_residual") = py::none(),
           py::arg("gate_residual_sigmas") = py::none(), py::arg("angle_rows") = std::vector<std::size_t>{})
      .def("run", &run, py::arg("time_s"), py::arg("process"), py::arg("measurements"), py::kw_only(),
           py::arg("inputs") = py::none(), py::arg("start_s") = py::none(), py::arg("gate_nis") = py::none(),
           py::arg("gate_residual") = py::none(), py::arg("gate_residual_sigmas") = py::none(),
           py::arg("smooth") = false, py::arg("history") = true, py::arg("adaptive_noise") = py::none())
      .def("clone", [](const PyKalmanFilter& f) { return PyKalmanFilter(f); })
      .def(py::pickle(&save, &load));
}

}  // namespace soopnav::python
