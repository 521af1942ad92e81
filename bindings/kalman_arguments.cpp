#include "kalman_arguments.hpp"

#include <pybind11/stl.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <string_view>
#include <utility>

#include "kalman_callable.hpp"

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

std::pair<py::object, py::object> returned_pair(const py::object& object, const char* what) {
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

py::array_t<double> frozen(std::span<const double> numbers, std::vector<py::ssize_t> shape) {
  py::array_t<double> array = new_array(numbers, std::move(shape));
  array.attr("setflags")(py::arg("write") = false);
  return array;
}

std::vector<double> to_vector(std::span<const double> numbers) { return {numbers.begin(), numbers.end()}; }

double* add_array(py::dict& out, const char* name, std::vector<py::ssize_t> shape) {
  py::array_t<double> array(std::move(shape));
  out[name] = array;
  return array.mutable_data();
}

namespace {

double infinity_unless(const std::optional<double>& value, const char* name) {
  if (!value) return std::numeric_limits<double>::infinity();
  if (*value > 0.0) return *value;
  throw py::value_error(std::string(name) + ": expected a positive number, got " +
                        py::repr(py::cast(*value)).cast<std::string>());
}

}  // namespace

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

const double* to_input(const std::optional<Numbers<"input">>& input, std::size_t size, const std::string& kind) {
  const std::size_t given = input ? input->span().size() : 0;
  if (given != size) {
    throw py::value_error("input: " + kind + " expects " + std::to_string(size) + " numbers, got " +
                          std::to_string(given));
  }
  return size == 0 ? nullptr : input->span().data();
}

KalmanReport take_update(const py::object& model, const Numbers<"z">& z, const Numbers<"R">& R,
                         const std::vector<std::size_t>& angle_rows,
                         const std::function<KalmanReport(const Models&, std::span<const double>)>& built_in,
                         const std::function<KalmanReport(const CallableMeasurement&, std::span<const double>)>& own) {
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
    return own(callable, to_square(R, m, "R"));
  }
  if (!angle_rows.empty()) throw py::value_error("angle_rows: go with a callable; models know theirs");
  const Models models = to_models(model);
  const std::size_t rows = rows_of(models);
  if (m != rows) {
    throw py::value_error("z: expected " + std::to_string(rows) + " numbers, the rows of the model, got " +
                          std::to_string(m));
  }
  return built_in(models, to_square(R, rows, "R"));
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
  if (start && !(*start < time[0])) {
    throw py::value_error("start_s: " + std::to_string(*start) +
                          " is not before time_s[0] = " + std::to_string(time[0]));
  }
}

void put_noise(RunGroup& group, const NumbersBase& R, std::size_t T, const std::string& name,
               std::vector<double>& matrix) {
  const auto m = static_cast<std::size_t>(group.rows);
  group.R_each = R.shape().size() == 3;
  if (!group.R_each) {
    matrix = to_square(R, m, name + ": R");
    group.R = matrix.data();
    return;
  }
  if (R.shape()[0] != size_of(T) || R.shape()[1] != size_of(m) || R.shape()[2] != size_of(m)) {
    throw py::value_error(name + ": R: expected " + std::to_string(T) + " matrices of " + std::to_string(m) + " rows");
  }
  group.R = R.span().data();
}

std::vector<RunGroup> to_groups(const GroupArguments& measurements, std::size_t T,
                                std::vector<std::vector<double>>& matrices) {
  const std::string steps = std::to_string(T);
  std::vector<RunGroup> groups;
  matrices.resize(measurements.size());
  for (std::size_t g = 0; g < measurements.size(); ++g) {
    const auto& [models, z, R, mask] = measurements[g];
    const std::string name = "measurements[" + std::to_string(g) + "]";
    RunGroup group;
    group.models = to_models(models);
    const std::size_t m = rows_of(group.models);
    group.rows = static_cast<int>(m);
    if (z.span().size() != T * m || z.shape().empty() || z.shape()[0] != size_of(T)) {
      std::string shape;
      for (const py::ssize_t n : z.shape()) shape += (shape.empty() ? "" : ", ") + std::to_string(n);
      throw py::value_error(name + ": z: expected shape (" + steps + ", " + std::to_string(m) + "), got (" + shape +
                            ")");
    }
    group.z = z.span().data();
    put_noise(group, R, T, name, matrices[g]);
    if (mask) {
      if (mask->ndim() != 1 || mask->shape(0) != size_of(T)) {
        throw py::value_error(name + ": mask: expected shape (" + steps + ",), got " + std::to_string(mask->size()) +
                              " numbers along " + std::to_string(mask->ndim()) + " axes");
      }
      group.mask = mask->data();
    }
    groups.push_back(std::move(group));
  }
  return groups;
}

const double* to_inputs(const std::optional<Numbers<"inputs">>& inputs, std::size_t T, std::size_t size,
                        const std::string& kind) {
  if (size == 0) {
    if (inputs) throw py::value_error("inputs: " + kind + " has none");
    return nullptr;
  }
  if (!inputs || inputs->shape().size() != 2 || inputs->shape()[0] != size_of(T) ||
      inputs->shape()[1] != size_of(size)) {
    throw py::value_error("inputs: " + kind + " expects shape (" + std::to_string(T) + ", " + std::to_string(size) +
                          ")");
  }
  return inputs->span().data();
}

// --- The filter ---

PyKalmanFilter::PyKalmanFilter(std::string which, KalmanSetup with) : kind(std::move(which)), setup(std::move(with)) {
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

}  // namespace soopnav::python
