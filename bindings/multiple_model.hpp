#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "kalman.hpp"

/// The interacting multiple model estimator with a number of modes that is known at run time.
namespace soopnav::python {

/// Modes that are compiled.
inline constexpr std::size_t kMostModes = 6;

/// A whole run and where its results go. Arrays are row-major; those of a history may be null.
struct MultipleModelRun {
  std::span<const double> time_s;
  std::optional<double> start_s;
  const double* inputs = nullptr;
  std::vector<RunGroup> groups;
  Gate gate;
  double *x = nullptr, *P = nullptr;
  double *predicted_probabilities = nullptr, *probabilities = nullptr;
  double* nis = nullptr;
  std::uint8_t* status = nullptr;
  std::uint8_t* predict_status = nullptr;
  double log_likelihood = 0.0;
};

/// What an estimator is made of, in the order in which a pickle keeps it.
struct MultipleModelMemory {
  std::vector<double> x;  ///< of the modes, one behind the other
  std::vector<double> P;  ///< of the modes, n x n each
  std::vector<double> probabilities;
  std::vector<double> floor;  ///< empty without one
  std::vector<std::uint64_t> floor_counts;
  bool fresh = true;  ///< all modes are still at the start
};

/// What an estimator is made from.
struct MultipleModelSetup {
  std::string state;
  std::vector<double> x0;
  std::vector<double> P0;  ///< n x n
  std::vector<AnyProcess> processes;
  std::vector<double> transition;  ///< modes x modes, row by row
  std::vector<double> probabilities;
};

class MultipleModel {
 public:
  MultipleModel() = default;
  MultipleModel(const MultipleModel&) = default;
  MultipleModel& operator=(const MultipleModel&) = delete;
  virtual ~MultipleModel() = default;

  [[nodiscard]] virtual std::unique_ptr<MultipleModel> clone() const = 0;
  [[nodiscard]] virtual const StateInfo& state() const noexcept = 0;
  [[nodiscard]] virtual std::vector<double> x() const = 0;
  [[nodiscard]] virtual std::vector<double> covariance() const = 0;
  [[nodiscard]] virtual std::vector<double> probabilities() const = 0;
  [[nodiscard]] virtual MultipleModelMemory save() const = 0;
  virtual void load(const MultipleModelMemory& memory) = 0;
  virtual void set_floor(std::span<const double> variance) = 0;

  virtual UpdateStatus predict(const double* input, double dt_s) = 0;
  /// The log-likelihood of the report is that of the mixture; NaN unless accepted.
  virtual KalmanReport update(std::span<const AnyMeasurement* const> models, std::span<const double> z,
                              std::span<const double> R, const Gate& gate) = 0;
  virtual KalmanReport update(const CallableMeasurement& model, std::span<const double> z, std::span<const double> R,
                              const Gate& gate) = 0;
  /// Throws std::invalid_argument, the estimator as it was, when a model does not fit.
  virtual void run(MultipleModelRun& run) = 0;
};

[[nodiscard]] std::unique_ptr<MultipleModel> make_multiple_model(const MultipleModelSetup& setup);

}  // namespace soopnav::python
