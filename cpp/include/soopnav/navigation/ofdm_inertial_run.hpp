#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <functional>
#include <span>
#include <vector>

#include "soopnav/navigation/ofdm_inertial_navigator.hpp"

namespace soopnav::navigation {

/// A recorded or simulated run of `R` receivers and `K` transmitters. Spans are read, never kept.
///
/// Samples are what the sensors measured over the interval that ends at their time. A number that is NaN is absent.
struct OfdmInertialData {
  double start_s = 0.0;                                ///< time of the starts
  std::span<const double> imu_t_s;                     ///< (N)
  std::span<const double> yaw_rate_radps;              ///< (R, N)
  std::span<const double> specific_force_b_mps2;       ///< (R, N, 2)
  double imu_period_s = 0.0;                           ///< 0: the median of the steps between samples
  std::span<const double> epoch_t_s;                   ///< (E), not falling
  std::span<const double> range_change_m;              ///< (E, R, K)
  std::span<const double> range_sigma_m;               ///< (E, R, K)
  std::span<const double> reference_range_change_m{};  ///< (E, K), or empty
  std::span<const double> reference_sigma_m{};         ///< (E, K), or empty
  std::size_t record_every = 1;                        ///< IMU samples between recorded states
  double max_gap_s = 600.0;                            ///< a sample farther ahead has a wrong time: passed over
};

/// Timing with the filter in the loop: gets the number of an epoch and what the navigator expects of a link there (in
/// difference to nothing: a reference receiver's boundary is added), and answers with what it measured. A value that is
/// NaN is absent.
using RangeTiming = std::function<RangeChange(std::size_t epoch, const RangeChange& predicted)>;

/// What became of the samples of a run.
struct ImuCounts {
  std::size_t used = 0;
  /// At or before the one before them, more than `max_gap_s` after it, or of no finite time: passed over.
  std::size_t not_after = 0;
  std::size_t not_finite = 0;  ///< of a receiver: it coasted over them
  std::size_t saturated = 0;   ///< of a receiver: used, with `UnmodelledMotion` for their noise
  std::size_t gaps = 0;        ///< longer than 1.5 periods: bridged by coasting
  double gap_s = 0.0;          ///< in all
};

/// A run's history: one row for the start, for every `record_every`-th sample, and for the last.
struct OfdmInertialHistory {
  std::size_t dim = 0;                            ///< states
  std::vector<double> t_s;                        ///< (M)
  std::vector<double> state;                      ///< (M, dim)
  std::vector<double> covariance;                 ///< (M, dim, dim)
  std::vector<double> range_change_m;             ///< (E, R, K), as it was offered; NaN: absent
  std::vector<RangeChangeReport> reports;         ///< (E, R, K)
  std::vector<UpdateStatus> reference;            ///< (E, K), or empty
  UpdateStatus status = UpdateStatus::kAccepted;  ///< anything else: a prediction was refused, the run ended there
  ImuCounts imu;
};

/// Drives `navigator` through `data`: prediction at the rate of the sensors, updates at the times of the epochs, the
/// sample in progress being split there. A gap of the sensors is bridged by coasting in steps of at most a second, with
/// the updates that fall into it. Epochs before the start are refused with kTooLate; those after the last sample are
/// reached by coasting.
/// With a `timing`, boundaries are asked of it, all of an epoch before the first goes in; `range_change_m` and
/// `range_sigma_m` of the data are then empty.
/// @throws std::invalid_argument for spans whose sizes do not fit each other, falling epochs, or no period; what
/// `timing`
///         throws passes on.
[[nodiscard]] OfdmInertialHistory run(OfdmInertialNavigator& navigator, const OfdmInertialData& data,
                                      const RangeTiming& timing = {});

}  // namespace soopnav::navigation
