#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <tuple>
#include <utility>

#include "fixed_lag.hpp"
#include "kalman_arguments.hpp"
#include "register.hpp"

namespace soopnav::python {

namespace {

struct PyLagFilter {
  std::string kind;   // of the filter inside
  KalmanSetup setup;  // likewise
  AnyProcess process;
  std::unique_ptr<LagFilter> lag;

  PyLagFilter(const PyKalmanFilter& filter, const AnyProcess& with, std::unique_ptr<LagFilter> made)
      : kind(filter.kind), setup(filter.setup), process(with), lag(std::move(made)) {}
  PyLagFilter(const PyLagFilter& other)
      : kind(other.kind), setup(other.setup), process(other.process), lag(other.lag->clone()) {}
  PyLagFilter& operator=(const PyLagFilter&) = delete;
  ~PyLagFilter() = default;

  [[nodiscard]] std::size_t n() const { return static_cast<std::size_t>(lag->filter().state().roles.size); }
  [[nodiscard]] std::size_t input_size() const { return static_cast<std::size_t>(process.input_size()); }
};

PyLagFilter make_filter(const PyKalmanFilter& filter, const AnyProcess& process, double start_s, int capacity,
                        const std::optional<Numbers<"input">>& input) {
  if (!std::isfinite(start_s)) throw py::value_error("start_s: not finite");
  std::vector<double> numbers;
  if (input) {
    static_cast<void>(to_input(input, static_cast<std::size_t>(process.input_size()), process.kind()));
    numbers = to_vector(input->span());
    for (const double value : numbers) {
      if (!std::isfinite(value)) throw py::value_error("input: not finite");
    }
  }
  return {filter, process, make_lag_filter(*filter.filter, process, start_s, capacity, numbers)};
}

UpdateStatus advance(PyLagFilter& self, double time_s, const std::optional<Numbers<"input">>& input) {
  return self.lag->advance(time_s, input ? to_input(input, self.input_size(), self.process.kind()) : nullptr);
}

KalmanReport update(PyLagFilter& self, const py::object& model, const Numbers<"z">& z, const Numbers<"R">& R,
                    double time_s, const std::optional<double>& gate_nis, const std::optional<double>& gate_residual,
                    const std::optional<double>& gate_residual_sigmas) {
  const Gate gate = to_gate(gate_nis, gate_residual, gate_residual_sigmas);
  return take_update(
      model, z, R, {},
      [&](const Models& models, std::span<const double> noise) {
        return self.lag->update(models, z.span(), noise, time_s, gate);
      },
      [](const CallableMeasurement&, std::span<const double>) -> KalmanReport {
        throw py::type_error("model: a callable cannot be asked again when something older comes in");
      });
}

// --- Whole runs ---

using LateGroup = std::tuple<py::object, Numbers<"z">, Numbers<"R">, Numbers<"time_s">, Numbers<"arrival_s">>;

void check_finite(std::span<const double> numbers, const std::string& name) {
  for (std::size_t k = 0; k < numbers.size(); ++k) {
    if (!std::isfinite(numbers[k])) throw py::value_error(name + "[" + std::to_string(k) + "] is not finite");
  }
}

struct Due {
  double arrival_s;
  LagRun::Event event;
};

RunGroup to_group(const LateGroup& late, const std::string& name, int index, std::vector<double>& matrix,
                  std::vector<Due>& due) {
  const auto& [models, z, R, time_s, arrival_s] = late;
  RunGroup group;
  group.models = to_models(models);
  const std::size_t m = rows_of(group.models);
  group.rows = static_cast<int>(m);
  if (time_s.shape().size() != 1) throw py::value_error(name + ": time_s: expected shape (T,)");
  const std::size_t T = time_s.span().size();
  if (z.span().size() != T * m || z.shape().empty() || z.shape()[0] != size_of(T)) {
    throw py::value_error(name + ": z: expected shape (" + std::to_string(T) + ", " + std::to_string(m) + ")");
  }
  if (arrival_s.shape() != time_s.shape()) {
    throw py::value_error(name + ": arrival_s: expected shape (" + std::to_string(T) + ",), as time_s has");
  }
  group.z = z.span().data();
  put_noise(group, R, T, name, matrix);
  check_finite(time_s.span(), name + ": time_s");
  check_finite(arrival_s.span(), name + ": arrival_s");
  for (std::size_t k = 0; k < T; ++k) {
    if (arrival_s.span()[k] < time_s.span()[k]) {
      throw py::value_error(name + ": arrival_s[" + std::to_string(k) + "]: before the time of the measurement");
    }
    due.push_back({arrival_s.span()[k], {time_s.span()[k], index, k}});
  }
  return group;
}

py::dict run(PyLagFilter& self, const std::vector<LateGroup>& measurements,
             const std::optional<Numbers<"inputs">>& inputs, const std::optional<Numbers<"input_time_s">>& input_time_s,
             const std::optional<double>& gate_nis, const std::optional<double>& gate_residual,
             const std::optional<double>& gate_residual_sigmas, bool history) {
  LagRun run;
  run.gate = to_gate(gate_nis, gate_residual, gate_residual_sigmas);
  std::vector<Due> due;
  if (inputs.has_value() != input_time_s.has_value()) {
    throw py::value_error("inputs: go with input_time_s, and the other way round");
  }
  if (inputs) {
    input_time_s->require_axes({1}, "shape (T,)");
    const auto times = input_time_s->span();
    run.inputs = to_inputs(inputs, times.size(), self.input_size(), self.process.kind());
    check_finite(times, "input_time_s");
    for (std::size_t k = 0; k < times.size(); ++k) due.push_back({times[k], {times[k], -1, k}});
  }
  std::vector<std::vector<double>> matrices(measurements.size());
  for (std::size_t g = 0; g < measurements.size(); ++g) {
    const std::string name = "measurements[" + std::to_string(g) + "]";
    run.groups.push_back(to_group(measurements[g], name, static_cast<int>(g), matrices[g], due));
  }
  std::stable_sort(due.begin(), due.end(), [](const Due& a, const Due& b) { return a.arrival_s < b.arrival_s; });

  const py::ssize_t events = size_of(due.size());
  const py::ssize_t n = size_of(self.n());
  py::dict out;
  double* arrival_s = add_array(out, "arrival_s", {events});
  double* measured_s = add_array(out, "measured_s", {events});
  py::array_t<std::int64_t> group(events);
  py::array_t<std::int64_t> row(events);
  for (std::size_t k = 0; k < due.size(); ++k) {
    const LagRun::Event& event = due[k].event;
    run.events.push_back(event);
    arrival_s[k] = due[k].arrival_s;
    measured_s[k] = event.time_s;
    group.mutable_data()[k] = event.group;
    row.mutable_data()[k] = static_cast<std::int64_t>(event.row);
  }
  run.time_s = add_array(out, "time_s", {events});
  if (history) {
    run.x = add_array(out, "x", {events, n});
    run.P = add_array(out, "P", {events, n, n});
  }
  run.nis = add_array(out, "nis", {events});
  std::fill_n(run.nis, events, std::numeric_limits<double>::quiet_NaN());
  py::array_t<std::uint8_t> status(events);
  run.status = status.mutable_data();
  // Another thread may use the filter meanwhile: what runs without the interpreter's lock is a copy.
  std::unique_ptr<LagFilter> copy = self.lag->clone();
  {
    const py::gil_scoped_release release;
    copy->run(run);
  }
  self.lag = std::move(copy);
  out["group"] = group;
  out["row"] = row;
  out["status"] = status;
  return out;
}

py::tuple smooth(PyLagFilter& self) {
  std::vector<double> time_s;
  std::vector<double> x;
  std::vector<double> P;
  if (!self.lag->smooth(time_s, x, P)) {
    throw py::value_error("smooth: an event that is kept has no finite covariance to smooth with");
  }
  const py::ssize_t t = size_of(time_s.size());
  const py::ssize_t n = size_of(self.n());
  return py::make_tuple(frozen(time_s, {t}), frozen(x, {t, n}), frozen(P, {t, n, n}));
}

// --- Memory ---

PyKalmanFilter inside(const PyLagFilter& self, std::unique_ptr<KalmanFilter> filter) {
  return {self.kind, self.setup, std::move(filter)};
}

py::tuple save_filter(const PyLagFilter& self) {
  const LagMemory memory = self.lag->save();
  py::list arrivals;
  for (const LagArrival& a : memory.arrivals) {
    arrivals.append(
        py::make_tuple(a.time_s, a.input, a.models, a.z, a.R, a.gate.nis, a.gate.residual, a.gate.residual_sigmas));
  }
  return py::make_tuple(save(inside(self, self.lag->first())), self.process, memory.time_s, memory.input,
                        memory.oldest_time_s, memory.last_input_s, memory.capacity, arrivals);
}

PyLagFilter load_filter(const py::tuple& saved) {
  if (saved.size() != 8) throw py::value_error("saved filter: expected 8 parts, got " + std::to_string(saved.size()));
  using Numbers = std::vector<double>;
  LagMemory memory{.time_s = saved[2].cast<double>(),
                   .input = saved[3].cast<Numbers>(),
                   .oldest_time_s = saved[4].cast<double>(),
                   .last_input_s = saved[5].cast<double>(),
                   .arrivals = {},
                   .capacity = saved[6].cast<int>()};
  for (const py::handle item : saved[7].cast<py::list>()) {
    const auto a = item.cast<py::tuple>();
    memory.arrivals.push_back({.time_s = a[0].cast<double>(),
                               .input = a[1].cast<Numbers>(),
                               .models = a[2].cast<std::vector<AnyMeasurement>>(),
                               .z = a[3].cast<Numbers>(),
                               .R = a[4].cast<Numbers>(),
                               .gate = {a[5].cast<double>(), a[6].cast<double>(), a[7].cast<double>()}});
  }
  const PyKalmanFilter first = load(saved[0].cast<py::tuple>());
  const auto process = saved[1].cast<AnyProcess>();
  return {first, process, load_lag_filter(*first.filter, process, memory)};
}

}  // namespace

void register_fixed_lag(py::module_& m) {
  py::class_<PyLagFilter>(m, "FixedLagFilter", "A Kalman filter with late measurements: see soopnav_cpp.estimation.")
      .def(py::init(&make_filter), py::arg("filter"), py::arg("process"), py::arg("start_s"), py::arg("capacity"),
           py::arg("input") = py::none())
      .def_property_readonly("x", [](const PyLagFilter& f) { return frozen(f.lag->filter().x(), {size_of(f.n())}); })
      .def_property_readonly("P",
                             [](const PyLagFilter& f) {
                               return frozen(f.lag->filter().P(), {size_of(f.n()), size_of(f.n())});
                             })
      .def_property_readonly("filter", [](const PyLagFilter& f) { return inside(f, f.lag->filter().clone()); })
      .def_property_readonly("kind", [](const PyLagFilter& f) { return f.kind; })
      .def_property_readonly("process", [](const PyLagFilter& f) { return f.process; })
      .def_property_readonly("time_s", [](const PyLagFilter& f) { return f.lag->time_s(); })
      .def_property_readonly("oldest_time_s", [](const PyLagFilter& f) { return f.lag->oldest_time_s(); })
      .def_property_readonly("size", [](const PyLagFilter& f) { return f.lag->size(); })
      .def_property_readonly("capacity", [](const PyLagFilter& f) { return f.lag->capacity(); })
      .def("advance", &advance, py::arg("time_s"), py::arg("input") = py::none())
      .def("update", &update, py::arg("model"), py::arg("z"), py::arg("R"), py::arg("time_s"), py::kw_only(),
           py::arg("gate_nis") = py::none(), py::arg("gate_residual") = py::none(),
           py::arg("gate_residual_sigmas") = py::none())
      .def("run", &run, py::arg("measurements"), py::kw_only(), py::arg("inputs") = py::none(),
           py::arg("input_time_s") = py::none(), py::arg("gate_nis") = py::none(),
           py::arg("gate_residual") = py::none(), py::arg("gate_residual_sigmas") = py::none(),
           py::arg("history") = true)
      .def("smooth", &smooth)
      .def("clone", [](const PyLagFilter& f) { return PyLagFilter(f); })
      .def(py::pickle(&save_filter, &load_filter));
}

}  // namespace soopnav::python
