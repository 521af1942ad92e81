#pragma once

#include <Eigen/Core>
#include <cstddef>
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
};

/// What became of the samples of a run.
struct ImuCounts {
  std::size_t used = 0;
  std::size_t not_after = 0;   ///< at or before the one before them, or of no finite time: passed over
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
  std::vector<RangeChangeReport> reports;         ///< (E, R, K)
  std::vector<UpdateStatus> reference;            ///< (E, K), or empty
  UpdateStatus status = UpdateStatus::kAccepted;  ///< anything else: a prediction was refused, the run ended there
  ImuCounts imu;
};

/// Drives `navigator` through `data`: prediction at the rate of the sensors, updates at the times of the epochs, the
/// sample in progress being split there. A gap of the sensors is bridged by coasting in steps of at most a second, with
/// the updates that fall into it. Epochs before the start are refused with kTooLate; those after the last sample are
/// reached by coasting.
/// @throws std::invalid_argument for spans whose sizes do not fit each other, falling epochs, or no period.
[[nodiscard]] OfdmInertialHistory run(OfdmInertialNavigator& navigator, const OfdmInertialData& data);

}  // namespace soopnav::navigation
