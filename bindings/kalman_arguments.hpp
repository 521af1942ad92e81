#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <tuple>
#include <vector>

#include "array.hpp"
#include "kalman.hpp"

/// What the bindings of the Gaussian filters share: arguments as the engine takes them, and results as NumPy does.
/// Refusals are ValueErrors (TypeErrors for models that are none) that begin with the argument's name.
namespace soopnav::python {

[[nodiscard]] inline py::ssize_t size_of(std::size_t n) { return static_cast<py::ssize_t>(n); }
[[nodiscard]] std::vector<double> to_vector(std::span<const double> numbers);
/// A new array of that shape that cannot be written to.
[[nodiscard]] py::array_t<double> frozen(std::span<const double> numbers, std::vector<py::ssize_t> shape);
/// A new array of doubles under that name, to be filled.
double* add_array(py::dict& out, const char* name, std::vector<py::ssize_t> shape);

[[nodiscard]] Gate to_gate(const std::optional<double>& nis, const std::optional<double>& residual,
                           const std::optional<double>& residual_sigmas);
/// A number, `m` variances or an m x m matrix as m x m numbers.
[[nodiscard]] std::vector<double> to_square(const NumbersBase& numbers, std::size_t m, const std::string& name);

using Models = std::vector<const AnyMeasurement*>;
/// A model, or a list of them that is not empty.
[[nodiscard]] Models to_models(const py::object& object);
/// Rows of all models, `kMostRows` at most.
[[nodiscard]] std::size_t rows_of(const Models& models);
/// The numbers of an input, null for a process that has none.
[[nodiscard]] const double* to_input(const std::optional<Numbers<"input">>& input, std::size_t size,
                                     const std::string& kind);

/// Checks z, R and the model against each other and hands them to what takes built-in models or a callable.
[[nodiscard]] KalmanReport take_update(
    const py::object& model, const Numbers<"z">& z, const Numbers<"R">& R, const std::vector<std::size_t>& angle_rows,
    const std::function<KalmanReport(const Models&, std::span<const double>)>& built_in,
    const std::function<KalmanReport(const CallableMeasurement&, std::span<const double>)>& own);

// --- Whole runs ---

using Flags = py::array_t<std::uint8_t, py::array::c_style | py::array::forcecast>;
using GroupArguments = std::vector<std::tuple<py::object, Numbers<"z">, Numbers<"R">, std::optional<Flags>>>;

/// Times that rise and are finite, after `start`.
void check_times(std::span<const double> time, const std::optional<double>& start);
/// One R for all of `T` steps as m x m numbers in `matrix`, or one each, as they are; sets `group.R` and `R_each`.
void put_noise(RunGroup& group, const NumbersBase& R, std::size_t T, const std::string& name,
               std::vector<double>& matrix);
/// The groups of a run of `T` steps. `matrices` keeps what they point to, and must outlive them.
[[nodiscard]] std::vector<RunGroup> to_groups(const GroupArguments& measurements, std::size_t T,
                                              std::vector<std::vector<double>>& matrices);
/// The inputs of a run of `T` steps, null for a process that has none.
[[nodiscard]] const double* to_inputs(const std::optional<Numbers<"inputs">>& inputs, std::size_t T, std::size_t size,
                                      const std::string& kind);

// --- The filter ---

struct PyKalmanFilter {
  std::string kind;
  KalmanSetup setup;
  std::unique_ptr<KalmanFilter> filter;

  PyKalmanFilter(std::string which, KalmanSetup with);
  PyKalmanFilter(std::string which, KalmanSetup with, std::unique_ptr<KalmanFilter> made)
      : kind(std::move(which)), setup(std::move(with)), filter(std::move(made)) {}
  PyKalmanFilter(const PyKalmanFilter& other) : kind(other.kind), setup(other.setup), filter(other.filter->clone()) {}
  PyKalmanFilter& operator=(const PyKalmanFilter&) = delete;
  ~PyKalmanFilter() = default;

  [[nodiscard]] std::size_t n() const { return static_cast<std::size_t>(filter->state().roles.size); }
};

/// A filter as a pickle keeps it.
[[nodiscard]] py::tuple save(const PyKalmanFilter& self);
[[nodiscard]] PyKalmanFilter load(const py::tuple& saved);

}  // namespace soopnav::python
