#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "erased_model.hpp"
#include "soopnav/core/status.hpp"
#include "soopnav/estimation/adaptive_noise.hpp"
#include "soopnav/estimation/update_report.hpp"

/// Kalman filters of any kind and state behind one interface.
namespace soopnav::python {

/// Rows that one update takes at most.
inline constexpr int kMostRows = 16;
/// The status of a step at which a group has no measurement.
inline constexpr std::uint8_t kAbsent = 255;

/// What became of an update, for Python.
struct KalmanReport {
  UpdateStatus status = UpdateStatus::kUndefined;
  int rows = 0;
  std::array<double, kMostRows> innovation{};
  std::array<double, kMostRows * kMostRows> covariance{};  ///< rows x rows, row by row
  double nis = 0.0;
  double log_likelihood = 0.0;
};

/// Measurements of one kind over a run: `rows` numbers at each step, all taken in at once.
struct RunGroup {
  std::vector<const AnyMeasurement*> models;
  int rows = 0;
  const double* z = nullptr;
  const double* R = nullptr;  ///< rows x rows, one or one for each step
  bool R_each = false;
  const std::uint8_t* mask = nullptr;  ///< null: always there
};

/// A whole run and where its results go. Arrays are row-major; those of a history may be null.
struct Run {
  std::span<const double> time_s;
  std::optional<double> start_s;
  const AnyProcess* process = nullptr;
  const double* inputs = nullptr;
  std::vector<RunGroup> groups;
  Gate gate;
  AdaptiveProcessNoise* noise = nullptr;  ///< learns from each update and scales the process' noise; null: as it is
  double* noise_multiplier = nullptr;     ///< after each step
  double *x = nullptr, *P = nullptr, *x_pred = nullptr, *P_pred = nullptr;
  double *x_smooth = nullptr, *P_smooth = nullptr;
  double* nis = nullptr;
  std::uint8_t* status = nullptr;
  std::uint8_t* predict_status = nullptr;
  double log_likelihood = 0.0;
};

/// What a filter is made of, in the order in which a pickle keeps it.
struct KalmanMemory {
  std::vector<double> x;
  std::vector<double> matrix;  ///< covariance, its root or the information, as the filter keeps it
  std::vector<double> floor;   ///< empty without one
  std::vector<std::uint64_t> floor_counts;
};

/// A user's model: a Python callable, and which of its rows are angles.
struct CallableMeasurement {
  pybind11::function f;
  std::vector<bool> angles;
};

class KalmanFilter {
 public:
  KalmanFilter() = default;
  KalmanFilter(const KalmanFilter&) = default;
  KalmanFilter& operator=(const KalmanFilter&) = delete;
  virtual ~KalmanFilter() = default;

  [[nodiscard]] virtual std::unique_ptr<KalmanFilter> clone() const = 0;
  [[nodiscard]] virtual const StateInfo& state() const noexcept = 0;
  [[nodiscard]] virtual std::vector<double> x() const = 0;
  [[nodiscard]] virtual std::vector<double> P() const = 0;
  [[nodiscard]] virtual KalmanMemory save() const = 0;
  virtual void load(const KalmanMemory& memory) = 0;
  virtual void set_floor(std::span<const double> variance) = 0;

  /// `cross`, unless null, receives n x n numbers for a smoother where the step was accepted (see StepRecord).
  virtual UpdateStatus predict(const AnyProcess& process, const double* input, double dt_s,
                               std::vector<double>* cross) = 0;
  /// `f(x, dt_s)` gives (x_next, F); of an unscented filter, `f(X, dt_s)` the images of all sigma points.
  virtual UpdateStatus predict(const pybind11::function& f, std::span<const double> Q, double dt_s) = 0;
  virtual KalmanReport update(std::span<const AnyMeasurement* const> models, std::span<const double> z,
                              std::span<const double> R, const Gate& gate) = 0;
  /// `f(x)` gives (h, H); of an unscented filter, `f(X)` the values at all sigma points.
  virtual KalmanReport update(const CallableMeasurement& model, std::span<const double> z, std::span<const double> R,
                              const Gate& gate) = 0;
  /// Throws std::invalid_argument, the filter as it was, when a state or process does not fit or smoothing fails.
  virtual void run(Run& run) = 0;
};

/// A filter as Python asks for it.
struct KalmanSetup {
  std::string state;
  std::vector<double> x0;
  std::vector<double> P0;       ///< n x n; the information where `information` says so
  std::vector<double> options;  ///< of the kind
  bool information = false;     ///< P0 is an information matrix
};

/// `process` with `multiplier` times the covariance of its noise.
[[nodiscard]] AnyProcess scaled_noise(const AnyProcess& process, double multiplier);
/// Lets `noise` learn from an innovation whose measurement noise had covariance `R`, rows x rows numbers.
bool learn(AdaptiveProcessNoise& noise, const KalmanReport& report, const double* R) noexcept;

[[nodiscard]] std::unique_ptr<KalmanFilter> make_extended(const KalmanSetup& setup);
[[nodiscard]] std::unique_ptr<KalmanFilter> make_iterated(const KalmanSetup& setup);
[[nodiscard]] std::unique_ptr<KalmanFilter> make_unscented(const KalmanSetup& setup);
[[nodiscard]] std::unique_ptr<KalmanFilter> make_square_root(const KalmanSetup& setup);
[[nodiscard]] std::unique_ptr<KalmanFilter> make_information(const KalmanSetup& setup);

}  // namespace soopnav::python
