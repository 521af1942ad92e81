#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <limits>
#include <string>
#include <utility>

#include "kalman_arguments.hpp"
#include "multiple_model.hpp"
#include "register.hpp"

namespace soopnav::python {

namespace {

struct PyMultipleModel {
  MultipleModelSetup setup;
  std::unique_ptr<MultipleModel> estimator;
  std::size_t input_size = 0;  // of its driven modes
  std::string driven;          // the kind of one of them

  explicit PyMultipleModel(MultipleModelSetup with) : setup(std::move(with)), estimator(make_multiple_model(setup)) {
    setup.state = estimator->state().name;
    for (const AnyProcess& process : setup.processes) {
      if (driven.empty() || process.input_size() > 0) driven = process.kind();
      input_size = std::max(input_size, static_cast<std::size_t>(process.input_size()));
    }
  }
  PyMultipleModel(const PyMultipleModel& other)
      : setup(other.setup), estimator(other.estimator->clone()), input_size(other.input_size), driven(other.driven) {}
  PyMultipleModel& operator=(const PyMultipleModel&) = delete;
  ~PyMultipleModel() = default;

  [[nodiscard]] std::size_t n() const { return static_cast<std::size_t>(estimator->state().roles.size); }
  [[nodiscard]] std::size_t modes() const { return setup.processes.size(); }
};

PyMultipleModel make_estimator(const std::string& state, const Numbers<"x0">& x0, const Numbers<"P0">& P0,
                               const std::vector<AnyProcess>& processes, const Numbers<"transition">& transition,
                               const Numbers<"probabilities">& probabilities) {
  x0.require_axes({1}, "shape (n,)");
  const StateInfo info = state_info(state, x0.span().size());
  const std::size_t modes = processes.size();
  if (modes < 1 || modes > kMostModes) {
    throw py::value_error("processes: " + std::to_string(modes) + ", expected 1 to " + std::to_string(kMostModes));
  }
  const std::string count = std::to_string(modes);
  if (transition.shape() != std::vector{size_of(modes), size_of(modes)}) {
    throw py::value_error("transition: expected shape (" + count + ", " + count + "), a row for each process");
  }
  if (probabilities.shape() != std::vector{size_of(modes)}) {
    throw py::value_error("probabilities: expected shape (" + count + ",), one for each process");
  }
  return PyMultipleModel({info.name, to_vector(x0.span()), to_square(P0, x0.span().size(), "P0"), processes,
                          to_vector(transition.span()), to_vector(probabilities.span())});
}

UpdateStatus predict(PyMultipleModel& self, double dt_s, const std::optional<Numbers<"input">>& input) {
  return self.estimator->predict(to_input(input, self.input_size, self.driven), dt_s);
}

KalmanReport update(PyMultipleModel& self, const py::object& model, const Numbers<"z">& z, const Numbers<"R">& R,
                    const std::optional<double>& gate_nis, const std::optional<double>& gate_residual,
                    const std::optional<double>& gate_residual_sigmas, const std::vector<std::size_t>& angle_rows) {
  const Gate gate = to_gate(gate_nis, gate_residual, gate_residual_sigmas);
  return take_update(
      model, z, R, angle_rows,
      [&](const Models& models, std::span<const double> noise) {
        return self.estimator->update(models, z.span(), noise, gate);
      },
      [&](const CallableMeasurement& own, std::span<const double> noise) {
        return self.estimator->update(own, z.span(), noise, gate);
      });
}

py::dict run(PyMultipleModel& self, const Numbers<"time_s">& time_s, const GroupArguments& measurements,
             const std::optional<Numbers<"inputs">>& inputs, const std::optional<double>& start_s,
             const std::optional<double>& gate_nis, const std::optional<double>& gate_residual,
             const std::optional<double>& gate_residual_sigmas, bool history) {
  time_s.require_axes({1}, "shape (T,)");
  check_times(time_s.span(), start_s);
  const std::size_t T = time_s.span().size();
  MultipleModelRun run;
  run.time_s = time_s.span();
  run.start_s = start_s;
  run.gate = to_gate(gate_nis, gate_residual, gate_residual_sigmas);
  run.inputs = to_inputs(inputs, T, self.input_size, self.driven);
  std::vector<std::vector<double>> matrices;
  run.groups = to_groups(measurements, T, matrices);

  const py::ssize_t t = size_of(T);
  const py::ssize_t n = size_of(self.n());
  const py::ssize_t modes = size_of(self.modes());
  const py::ssize_t groups = size_of(measurements.size());
  py::dict out;
  if (history) {
    run.x = add_array(out, "x", {t, n});
    run.P = add_array(out, "P", {t, n, n});
  }
  run.predicted_probabilities = add_array(out, "predicted_probabilities", {t, modes});
  run.probabilities = add_array(out, "probabilities", {t, modes});
  run.nis = add_array(out, "nis", {t, groups});
  std::fill_n(run.nis, t * groups, std::numeric_limits<double>::quiet_NaN());
  py::array_t<std::uint8_t> status({t, groups});
  run.status = status.mutable_data();
  std::fill_n(run.status, t * groups, kAbsent);
  py::array_t<std::uint8_t> predict_status(t);
  run.predict_status = predict_status.mutable_data();
  // Another thread may use the filter meanwhile: what runs without the interpreter's lock is a copy.
  std::unique_ptr<MultipleModel> copy = self.estimator->clone();
  {
    const py::gil_scoped_release release;
    copy->run(run);
  }
  self.estimator = std::move(copy);
  out["status"] = status;
  out["predict_status"] = predict_status;
  out["log_likelihood"] = run.log_likelihood;
  return out;
}

py::tuple save_estimator(const PyMultipleModel& self) {
  const MultipleModelMemory memory = self.estimator->save();
  return py::make_tuple(self.setup.state, self.setup.x0, self.setup.P0, self.setup.processes, self.setup.transition,
                        self.setup.probabilities, memory.x, memory.P, memory.probabilities, memory.floor,
                        memory.floor_counts, memory.fresh);
}

PyMultipleModel load_estimator(const py::tuple& saved) {
  if (saved.size() != 12) {
    throw py::value_error("saved estimator: expected 12 parts, got " + std::to_string(saved.size()));
  }
  const auto numbers = [&saved](std::size_t i) { return saved[i].cast<std::vector<double>>(); };
  PyMultipleModel made({saved[0].cast<std::string>(), numbers(1), numbers(2), saved[3].cast<std::vector<AnyProcess>>(),
                        numbers(4), numbers(5)});
  made.estimator->load({numbers(6), numbers(7), numbers(8), numbers(9), saved[10].cast<std::vector<std::uint64_t>>(),
                        saved[11].cast<bool>()});
  return made;
}

}  // namespace

void register_multiple_model(py::module_& m) {
  py::class_<PyMultipleModel>(m, "InteractingMultipleModel",
                              "A Kalman filter for each process model: see soopnav_cpp.estimation.")
      .def(py::init(&make_estimator), py::arg("state"), py::arg("x0"), py::arg("P0"), py::arg("processes"),
           py::arg("transition"), py::arg("probabilities"))
      .def_property_readonly("x", [](const PyMultipleModel& e) { return frozen(e.estimator->x(), {size_of(e.n())}); })
      .def_property_readonly("P",
                             [](const PyMultipleModel& e) {
                               return frozen(e.estimator->covariance(), {size_of(e.n()), size_of(e.n())});
                             })
      .def_property_readonly(
          "probabilities",
          [](const PyMultipleModel& e) { return frozen(e.estimator->probabilities(), {size_of(e.modes())}); })
      .def_property_readonly("mode_x",
                             [](const PyMultipleModel& e) {
                               return frozen(e.estimator->save().x, {size_of(e.modes()), size_of(e.n())});
                             })
      .def_property_readonly(
          "mode_P",
          [](const PyMultipleModel& e) {
            return frozen(e.estimator->save().P, {size_of(e.modes()), size_of(e.n()), size_of(e.n())});
          })
      .def_property_readonly("state", [](const PyMultipleModel& e) { return e.estimator->state().name; })
      .def_property_readonly(
          "component_names",
          [](const PyMultipleModel& e) { return py::tuple(py::cast(e.estimator->state().components)); })
      .def_property_readonly("processes",
                             [](const PyMultipleModel& e) { return py::tuple(py::cast(e.setup.processes)); })
      .def_property_readonly("transition",
                             [](const PyMultipleModel& e) {
                               return frozen(e.setup.transition, {size_of(e.modes()), size_of(e.modes())});
                             })
      .def_property_readonly("covariance_floor_counts",
                             [](const PyMultipleModel& e) {
                               const std::vector<std::uint64_t> counts = e.estimator->save().floor_counts;
                               py::list modes;
                               for (std::size_t j = 0; j < e.modes(); ++j) {
                                 const auto first = counts.begin() + size_of(j * e.n());
                                 modes.append(py::tuple(py::cast(std::vector(first, first + size_of(e.n())))));
                               }
                               return py::tuple(modes);
                             })
      .def(
          "set_covariance_floor",
          [](PyMultipleModel& e, const Numbers<"variance">& variance) { e.estimator->set_floor(variance.span()); },
          py::arg("variance"))
      .def("predict", &predict, py::arg("dt_s"), py::arg("input") = py::none())
      .def("update", &update, py::arg("model"), py::arg("z"), py::arg("R"), py::kw_only(),
           py::arg("gate_nis") = py::none(), py::arg("gate_residual") = py::none(),
           py::arg("gate_residual_sigmas") = py::none(), py::arg("angle_rows") = std::vector<std::size_t>{})
      .def("run", &run, py::arg("time_s"), py::arg("measurements"), py::kw_only(), py::arg("inputs") = py::none(),
           py::arg("start_s") = py::none(), py::arg("gate_nis") = py::none(), py::arg("gate_residual") = py::none(),
           py::arg("gate_residual_sigmas") = py::none(), py::arg("history") = true)
      .def("clone", [](const PyMultipleModel& e) { return PyMultipleModel(e); })
      .def(py::pickle(&save_estimator, &load_estimator));
}

}  // namespace soopnav::python
