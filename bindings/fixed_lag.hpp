#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "kalman.hpp"

/// Late measurements for any Kalman filter: FixedLagFilter over filters behind their interface.
namespace soopnav::python {

/// An observation or an input as it was handed in; all that is needed to hand it in again.
struct LagArrival {
  double time_s = 0.0;
  std::vector<double> input;           ///< three numbers, or none
  std::vector<AnyMeasurement> models;  ///< none: an input, or a step in time
  std::vector<double> z;
  std::vector<double> R;  ///< rows x rows
  Gate gate;
};

/// What a filter is made of, in the order in which a pickle keeps it.
struct LagMemory {
  double time_s = 0.0;        ///< of the filter before the events kept
  std::vector<double> input;  ///< in force then
  double oldest_time_s = 0.0;
  double last_input_s = 0.0;
  std::vector<LagArrival> arrivals;
  int capacity = 1;
};

/// A whole run and where its results go: arrivals in turn. Arrays are row-major; those of a history may be null.
struct LagRun {
  /// One of the events: an input (`group` -1), or a row of a group.
  struct Event {
    double time_s = 0.0;
    int group = -1;
    std::size_t row = 0;
  };
  std::vector<Event> events;
  std::vector<RunGroup> groups;
  const double* inputs = nullptr;
  Gate gate;
  double* time_s = nullptr;
  double *x = nullptr, *P = nullptr;
  double* nis = nullptr;
  std::uint8_t* status = nullptr;
};

class LagFilter {
 public:
  LagFilter() = default;
  LagFilter(const LagFilter&) = default;
  LagFilter& operator=(const LagFilter&) = delete;
  virtual ~LagFilter() = default;

  [[nodiscard]] virtual std::unique_ptr<LagFilter> clone() const = 0;
  /// The filter after all events.
  [[nodiscard]] virtual const KalmanFilter& filter() const noexcept = 0;
  /// The filter before the events kept.
  [[nodiscard]] virtual std::unique_ptr<KalmanFilter> first() const = 0;
  [[nodiscard]] virtual LagMemory save() const = 0;
  [[nodiscard]] virtual double time_s() const noexcept = 0;
  [[nodiscard]] virtual double oldest_time_s() const noexcept = 0;
  [[nodiscard]] virtual int size() const noexcept = 0;
  [[nodiscard]] virtual int capacity() const noexcept = 0;

  virtual UpdateStatus advance(double time_s, const double* input) = 0;
  virtual KalmanReport update(std::span<const AnyMeasurement* const> models, std::span<const double> z,
                              std::span<const double> R, double time_s, const Gate& gate) = 0;
  /// Throws std::invalid_argument, the filter as it was, when a model does not fit.
  virtual void run(LagRun& run) = 0;
  /// Smooths over the events kept: their times, and n and n x n numbers for each.
  [[nodiscard]] virtual bool smooth(std::vector<double>& time_s, std::vector<double>& x, std::vector<double>& P) = 0;
};

/// `input`: three numbers, in force from the start.
[[nodiscard]] std::unique_ptr<LagFilter> make_lag_filter(const KalmanFilter& filter, const AnyProcess& process,
                                                         double start_s, int capacity, std::span<const double> input);
/// The one that `save` was asked of; `first` as it was then.
[[nodiscard]] std::unique_ptr<LagFilter> load_lag_filter(const KalmanFilter& first, const AnyProcess& process,
                                                         const LagMemory& memory);

}  // namespace soopnav::python
