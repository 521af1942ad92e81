#pragma once

#include <Eigen/Core>
#include <memory>
#include <span>

#include "soopnav/clock/clock_noise.hpp"
#include "soopnav/core/status.hpp"
#include "soopnav/estimation/update_report.hpp"
#include "soopnav/navigation/cooperative_model.hpp"

namespace soopnav::navigation {

/// Components of what every engine of a `CooperativeTracker` estimates: p, v (ECEF) [m, m/s], theta [m], alpha [m/s].
inline constexpr int kPairDim = 8;
using PairVector = Eigen::Matrix<double, kPairDim, 1>;
using PairSquare = Eigen::Matrix<double, kPairDim, kPairDim>;

/// The engine a `CooperativeTracker` drives: one target's [p v theta alpha] and whatever it keeps besides.
///
/// The tracker judges, orders and counts measurements and knows the beacons; an engine predicts and updates. Anything
/// but `kAccepted` leaves an engine as it was. After construction nothing allocates but `clone`.
class CooperativeFilter {
 public:
  CooperativeFilter() = default;
  CooperativeFilter(const CooperativeFilter&) = delete;
  CooperativeFilter& operator=(const CooperativeFilter&) = delete;
  virtual ~CooperativeFilter() = default;

  /// Begins anew at `t_s` from a mean and a positive definite covariance; along-track states leave.
  virtual void restart(double t_s, const PairVector& mean, const PairSquare& P) = 0;
  /// Moves by `dt_s` > 0. `cross`, when given, receives Cov(x_k, x_k+1) = P F' for a smoother.
  virtual UpdateStatus predict(double dt_s, PairSquare* cross) noexcept = 0;
  /// One burst of beacon `number`.
  virtual UpdateReport<2> update(const PairModel<>& model, int number, const PairObservation& observed,
                                 const Gate& gate) noexcept = 0;
  /// What is known of the position besides: `model` is `distance_m` with variance `variance_m2`.
  virtual UpdateReport<1> update(const PlaneDistance<>& model, double distance_m, double variance_m2) noexcept = 0;
  /// Adds to the variances of theta [m²] and alpha [m²/s²], after a jump of a clock. All modes, all copies.
  virtual UpdateStatus reopen_clock(double theta_m2, double alpha_m2ps2) noexcept = 0;
  /// Moves the means of theta [m] and alpha [m/s] and leaves the covariance. An engine that cannot answers kUndefined,
  /// as this does: the tracker then adds the squares to the variances, which rounding limits to small jumps.
  virtual UpdateStatus shift_clock(double /*theta_m*/, double /*alpha_mps*/) noexcept {
    return UpdateStatus::kUndefined;
  }
  [[nodiscard]] virtual PairVector mean() const noexcept = 0;
  [[nodiscard]] virtual PairSquare covariance() const noexcept = 0;

  /// Lets the along-track error of beacon `number` join with deviation `sigma_m`. False when this engine has no such
  /// states or no room: the tracker then adds the error to R.
  virtual bool join_along_track(int /*number*/, double /*sigma_m*/) noexcept { return false; }
  /// Lets those of several beacons join right after `restart`, as a batch left them: `mean_m` of each, and `joint`, the
  /// covariance of [p v theta alpha] and of them behind it, whose first part `restart` was given. False: none joined.
  virtual bool join_along_track(std::span<const int> /*numbers*/, const Eigen::VectorXd& /*mean_m*/,
                                const Eigen::MatrixXd& /*joint*/) noexcept {
    return false;
  }
  /// Lets it leave; what it taught the others stays.
  virtual void leave_along_track(int /*number*/) noexcept {}
  /// Whether it is estimated; mean and deviation [m].
  [[nodiscard]] virtual bool along_track(int /*number*/, double& /*mean_m*/, double& /*sigma_m*/) const noexcept {
    return false;
  }
  /// Whether the errors of p, v, theta, alpha alone make a Markov chain, so that a fixed-interval smoother over
  /// `mean`, `covariance` and `cross` is right: not while along-track states are in use.
  [[nodiscard]] virtual bool smoothable() const noexcept { return true; }

  /// What `save` kept comes back with `load`: one place, the latest (a trial update, a measurement that came late).
  virtual void save() noexcept = 0;
  virtual void load() noexcept = 0;
};

/// What the built-in engines run on.
struct PairFilterOptions {
  clock::ClockNoise clock_noise{};      ///< of target and anchor together (their sum)
  double acceleration_psd_m2ps3 = 0.0;  ///< white acceleration of each axis; 0 for a target that stands
  int iterations = 1;                   ///< linearisations of each update, 1 ... 20
  int max_along_track = 0;              ///< room for beacons' along-track states (Joseph's form only), 0 ... 64
};

/// Extended Kalman filter in Joseph's form on [p v theta alpha] and the along-track errors of beacons that join and
/// leave. Throws std::invalid_argument, as does `information_filter`, for options out of range.
[[nodiscard]] std::unique_ptr<CooperativeFilter> joseph_filter(const PairFilterOptions& options);

/// The same in information form, P⁻¹ = P⁻¹ + H' R⁻¹ H (mei 6c): the same numbers. No along-track states.
[[nodiscard]] std::unique_ptr<CooperativeFilter> information_filter(const PairFilterOptions& options);

}  // namespace soopnav::navigation
