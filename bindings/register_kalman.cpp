#include <pybind11/native_enum.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <utility>

#include "array.hpp"
#include "kalman.hpp"
#include "kalman_callable.hpp"
#include "register.hpp"

namespace soopnav::python {

// --- What callables return ---

namespace {

py::array_t<double, py::array::c_style | py::array::forcecast> returned(py::handle object, const char* what,
                                                                        const std::string& shape) {
  auto array = py::array_t<double, py::array::c_style | py::array::forcecast>::ensure(object);
  if (!array) {
    PyErr_Clear();
    throw py::value_error(std::string(what) + ": expected numbers of shape " + shape + ", got " + describe(object));
  }
  return array;
}

[[noreturn]] void refuse_shape(py::handle object, const char* what, const std::string& shape) {
  throw py::value_error(std::string(what) + ": expected shape " + shape + ", got " + describe(object));
}

}  // namespace

RowMajorMatrixXd returned_matrix(py::handle object, const char* what, py::ssize_t rows, py::ssize_t columns) {
  const std::string shape = "(" + std::to_string(rows) + ", " + std::to_string(columns) + ")";
  const auto array = returned(object, what, shape);
  // One column may come without its axis.
  const bool fits = (array.ndim() == 2 && array.shape(0) == rows && array.shape(1) == columns) ||
                    (array.ndim() == 1 && columns == 1 && array.shape(0) == rows);
  if (!fits) refuse_shape(array, what, shape);
  return Eigen::Map<const RowMajorMatrixXd>(array.data(), rows, columns);
}

Eigen::VectorXd returned_vector(py::handle object, const char* what, py::ssize_t rows) {
  const std::string shape = "(" + std::to_string(rows) + ",)";
  const auto array = returned(object, what, shape);
  if (array.size() != rows || array.ndim() > 1) refuse_shape(array, what, shape);
  return Eigen::Map<const Eigen::VectorXd>(array.data(), rows);
}

std::pair<py::object, py::object> returned_pair(py::object object, const char* what) {
  if (!py::isinstance<py::sequence>(object) || py::len(object) != 2) {
    throw py::value_error(std::string(what) + ": expected a pair of value and matrix, got " + describe(object));
  }
  return {object[py::int_(0)], object[py::int_(1)]};
}

py::array_t<double> new_array(std::span<const double> numbers, std::vector<py::ssize_t> shape) {
  py::array_t<double> array(std::move(shape));
  std::copy(numbers.begin(), numbers.end(), array.mutable_data());
  return array;
}

namespace {

py::array_t<double> frozen(std::span<const double> numbers, std::vector<py::ssize_t> shape) {
  py::array_t<double> array = new_array(numbers, std::move(shape));
  array.attr("setflags")(py::arg("write") = false);
  return array;
}

std::vector<double> to_vector(std::span<const double> numbers) { return {numbers.begin(), numbers.end()}; }

py::ssize_t size_of(std::size_t n) { return static_cast<py::ssize_t>(n); }

double infinity_unless(const std::optional<double>& value, const char* name) {
  if (!value) return std::numeric_limits<double>::infinity();
  if (*value > 0.0) return *value;
  throw py::value_error(std::string(name) + ": expected a positive number, got " +
                        py::repr(py::cast(*value)).cast<std::string>());
}

Gate to_gate(const std::optional<double>& nis, const std::optional<double>& residual,
             const std::optional<double>& residual_sigmas) {
  Gate gate{.nis = infinity_unless(nis, "gate_nis"), .residual = infinity_unless(residual, "gate_residual")};
  if (residual_sigmas) gate.residual_sigmas = infinity_unless(residual_sigmas, "gate_residual_sigmas");
  return gate;
}

// A number, variances or a matrix as m x m numbers.
std::vector<double> to_square(const NumbersBase& numbers, std::size_t m, const std::string& name) {
  const auto& shape = numbers.shape();
  const auto values = numbers.span();
  if (shape.size() == 2 && shape[0] == size_of(m) && shape[1] == size_of(m)) return to_vector(values);
  if (shape.empty() || (shape.size() == 1 && shape[0] == size_of(m))) {
    std::vector<double> square(m * m, 0.0);
    for (std::size_t i = 0; i < m; ++i) square[i * (m + 1)] = shape.empty() ? values[0] : values[i];
    return square;
  }
  std::string got = "(";
  for (const auto size : shape) got += std::to_string(size) + ", ";
  const std::string n = std::to_string(m);
  throw py::value_error(name + ": expected a number, " + n + " variances or shape (" + n + ", " + n + "), got shape " +
                        got.substr(0, got.size() - (shape.size() > 1 ? 2 : 1)) + ")");
}

using Models = std::vector<const AnyMeasurement*>;

Models to_models(const py::object& object) {
  Models models;
  if (py::isinstance<AnyMeasurement>(object)) {
    models.push_back(object.cast<const AnyMeasurement*>());
  } else if (py::isinstance<py::sequence>(object)) {
    for (const auto item : object) {
      if (!py::isinstance<AnyMeasurement>(item)) {
        throw py::type_error("model: expected measurement models in the list, got " + describe(item));
      }
      models.push_back(item.cast<const AnyMeasurement*>());
    }
  } else {
    throw py::type_error("model: expected a measurement model, a list of them or a callable, got " + describe(object));
  }
  if (models.empty()) throw py::value_error("model: the list is empty");
  return models;
}

std::size_t rows_of(const Models& models) {
  std::size_t rows = 0;
  for (const AnyMeasurement* model : models) rows += static_cast<std::size_t>(model->rows());
  if (rows > static_cast<std::size_t>(kMostRows)) {
    throw py::value_error("model: " + std::to_string(rows) + " rows at once, more than " + std::to_string(kMostRows));
  }
  return rows;
}

// --- The filter ---

struct PyKalmanFilter {
  std::string kind;
  KalmanSetup setup;
  std::unique_ptr<KalmanFilter> filter;

  PyKalmanFilter(std::string which, KalmanSetup with) : kind(std::move(which)), setup(std::move(with)) {
    static const std::map<std::string_view, std::unique_ptr<KalmanFilter> (*)(const KalmanSetup&)> kMakers{
        {"extended", &make_extended},
        {"iterated", &make_iterated},
        {"unscented", &make_unscented},
        {"square_root", &make_square_root},
        {"information", &make_information}};
    const auto maker = kMakers.find(kind);
    if (maker == kMakers.end()) throw py::value_error("kind: no filter '" + kind + "'");
    filter = maker->second(setup);
    setup.state = filter->state().name;
  }
  PyKalmanFilter(const PyKalmanFilter& other) : kind(other.kind), setup(other.setup), filter(other.filter->clone()) {}
  PyKalmanFilter& operator=(const PyKalmanFilter&) = delete;
  ~PyKalmanFilter() = default;

  [[nodiscard]] std::size_t n() const { return static_cast<std::size_t>(filter->state().roles.size); }
};

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
    if ((input ? input->span().size() : 0) != size) {
      throw py::value_error("input: " + model.kind() + " expects " + std::to_string(size) + " numbers, got " +
                            std::to_string(input ? input->span().size() : 0));
    }
    return self.filter->predict(model, size == 0 ? nullptr : input->span().data(), dt_s);
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
  z.require_axes({0, 1}, "a number or shape (m,)");
  const std::size_t m = z.span().size();
  if (!py::isinstance<AnyMeasurement>(model) && PyCallable_Check(model.ptr())) {
    if (m < 1 || m > static_cast<std::size_t>(kMostRows)) {
      throw py::value_error("z: " + std::to_string(m) + " rows, expected 1 to " + std::to_string(kMostRows));
    }
    CallableMeasurement callable{py::reinterpret_borrow<py::function>(model), std::vector<bool>(m, false)};
    for (const std::size_t row : angle_rows) {
      if (row >= m) throw py::value_error("angle_rows: no row " + std::to_string(row) + " among " + std::to_string(m));
      callable.angles[row] = true;
    }
    return self.filter->update(callable, z.span(), to_square(R, m, "R"), gate);
  }
  if (!angle_rows.empty()) throw py::value_error("angle_rows: go with a callable; models know theirs");
  const Models models = to_models(model);
  const std::size_t rows = rows_of(models);
  if (m != rows) {
    throw py::value_error("z: expected " + std::to_string(rows) + " numbers, the rows of the model, got " +
                          std::to_string(m));
  }
  return self.filter->update(models, z.span(), to_square(R, rows, "R"), gate);
}

// --- Whole runs ---

void check_times(std::span<const double> time, const std::optional<double>& start) {
  if (time.empty()) throw py::value_error("time_s: empty");
  for (std::size_t k = 0; k < time.size(); ++k) {
    if (!std::isfinite(time[k])) throw py::value_error("time_s[" + std::to_string(k) + "] is not finite");
    if (k > 0 && !(time[k] > time[k - 1])) {
      throw py::value_error("time_s[" + std::to_string(k) + "]: time must rise, but it is not after the one before it");
    }
  }
  if (start && !(*start < time[0])) throw py::value_error("start_s: not before time_s[0]");
}

using Flags = py::array_t<std::uint8_t, py::array::c_style | py::array::forcecast>;

py::dict run(PyKalmanFilter& self, const Numbers<"time_s">& time_s, const AnyProcess& process,
             const std::vector<std::tuple<py::object, Numbers<"z">, Numbers<"R">, std::optional<Flags>>>& measurements,
             const std::optional<Numbers<"inputs">>& inputs, const std::optional<double>& start_s,
             const std::optional<double>& gate_nis, const std::optional<double>& gate_residual,
             const std::optional<double>& gate_residual_sigmas, bool smooth, bool history) {
  time_s.require_axes({1}, "shape (T,)");
  check_times(time_s.span(), start_s);
  const std::size_t T = time_s.span().size();
  const std::string steps = std::to_string(T);
  Run run;
  run.time_s = time_s.span();
  run.start_s = start_s;
  run.process = &process;
  run.gate = to_gate(gate_nis, gate_residual, gate_residual_sigmas);
  if (process.input_size() > 0) {
    const std::string shape = "shape (" + steps + ", " + std::to_string(process.input_size()) + ")";
    if (!inputs || inputs->shape().size() != 2 || inputs->shape()[0] != size_of(T) ||
        inputs->shape()[1] != process.input_size()) {
      throw py::value_error("inputs: " + process.kind() + " expects " + shape);
    }
    run.inputs = inputs->span().data();
  } else if (inputs) {
    throw py::value_error("inputs: " + process.kind() + " has none");
  }

  std::vector<std::vector<double>> matrices(measurements.size());
  for (std::size_t g = 0; g < measurements.size(); ++g) {
    const auto& [models, z, R, mask] = measurements[g];
    const std::string name = "measurements[" + std::to_string(g) + "]";
    RunGroup group;
    group.models = to_models(models);
    const std::size_t m = rows_of(group.models);
    group.rows = static_cast<int>(m);
    if (z.span().size() != T * m || z.shape().empty() || z.shape()[0] != size_of(T)) {
      throw py::value_error(name + ": z: expected shape (" + steps + ", " + std::to_string(m) + ")");
    }
    group.z = z.span().data();
    group.R_each = R.shape().size() == 3;
    if (group.R_each) {
      if (R.shape()[0] != size_of(T) || R.shape()[1] != size_of(m) || R.shape()[2] != size_of(m)) {
        throw py::value_error(name + ": R: expected " + steps + " matrices of " + std::to_string(m) + " rows");
      }
      group.R = R.span().data();
    } else {
      matrices[g] = to_square(R, m, name + ": R");
      group.R = matrices[g].data();
    }
    if (mask) {
      if (mask->ndim() != 1 || mask->shape(0) != size_of(T)) {
        throw py::value_error(name + ": mask: expected shape (" + steps + ",)");
      }
      group.mask = mask->data();
    }
    run.groups.push_back(std::move(group));
  }

  const py::ssize_t t = size_of(T);
  const py::ssize_t n = size_of(self.n());
  const py::ssize_t groups = size_of(measurements.size());
  py::dict out;
  const auto add = [&out](const char* name, std::vector<py::ssize_t> shape) {
    py::array_t<double> array(std::move(shape));
    out[name] = array;
    return array.mutable_data();
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
  run.nis = add("nis", {t, groups});
  std::fill_n(run.nis, t * groups, std::numeric_limits<double>::quiet_NaN());
  py::array_t<std::uint8_t> status({t, groups});
  run.status = status.mutable_data();
  std::fill_n(run.status, t * groups, kAbsent);
  py::array_t<std::uint8_t> predict_status(t);
  run.predict_status = predict_status.mutable_data();
  {
    const py::gil_scoped_release release;
    self.filter->run(run);
  }
  out["status"] = status;
  out["predict_status"] = predict_status;
  out["log_likelihood"] = run.log_likelihood;
  return out;
}

py::tuple save(const PyKalmanFilter& self) {
  const KalmanMemory memory = self.filter->save();
  return py::make_tuple(self.kind, self.setup.state, self.setup.options, memory.x, memory.matrix, memory.floor,
                        memory.floor_counts);
}

PyKalmanFilter load(const py::tuple& saved) {
  if (saved.size() != 7) throw py::value_error("saved filter: expected 7 parts, got " + std::to_string(saved.size()));
  KalmanMemory memory{saved[3].cast<std::vector<double>>(), saved[4].cast<std::vector<double>>(),
                      saved[5].cast<std::vector<double>>(), saved[6].cast<std::vector<std::uint64_t>>()};
  const std::size_t n = memory.x.size();
  std::vector<double> identity(n * n, 0.0);
  for (std::size_t i = 0; i < n; ++i) identity[i * (n + 1)] = 1.0;
  PyKalmanFilter filter(saved[0].cast<std::string>(), {saved[1].cast<std::string>(), memory.x, identity,
                                                       saved[2].cast<std::vector<double>>(), false});
  filter.filter->load(memory);
  return filter;
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

void register_kalman(py::module_& m) {
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
      .def("__repr__", &repr);

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
           py::arg("smooth") = false, py::arg("history") = true)
      .def("clone", [](const PyKalmanFilter& f) { return PyKalmanFilter(f); })
      .def(py::pickle(&save, &load));
}

}  // namespace soopnav::python
