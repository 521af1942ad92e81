#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstddef>
#include <sstream>
#include <stdexcept>
#include <vector>

#include "soopnav/core/role.hpp"
#include "soopnav/estimation/state.hpp"
#include "soopnav/geometry/rotation.hpp"
#include "soopnav/inertial/imu_increment.hpp"
#include "soopnav/inertial/strapdown_state.hpp"

namespace soopnav::inertial {

/// What `ZeroVelocityDetector` tells rest by.
struct ZeroVelocityOptions {
  int window = 50;                         ///< samples that are looked at together
  double accelerometer_sigma_mps2 = 0.02;  ///< of a sample's mean force at rest
  double gyro_sigma_radps = 0.005;         ///< of a sample's mean rate at rest, bias included
  double threshold = 3.0;                  ///< of the mean statistic, about 6 / 2 at rest
  double gravity_mps2 = 9.80665;
};

/// Tells rest from motion: the generalised likelihood ratio of "force is gravity in one direction, rate is zero" over a
/// window of samples (Skog, Haendel, Nilsson and Rantakokko, IEEE Trans. Biomed. Eng. 57, 2010, the SHOE detector).
///
/// Model:   T = 1/W sum (|f_k - g f / |f||² / sigma_f² + |w_k|² / sigma_w²), f the window's mean force; at rest when
///          T < `threshold`                                                                   (doc/strapdown.md eq. 39)
/// The mean of T at rest is 6 less what the direction takes, when the deviations are right. A window that is not full,
/// or has a sample that is not finite, is in motion. Nothing allocates behind the constructor.
class ZeroVelocityDetector {
 public:
  /// Throws std::invalid_argument for a window outside 2 ... 1e6 or deviations, threshold, gravity that are not
  /// positive.
  explicit ZeroVelocityDetector(const ZeroVelocityOptions& options) : options_(options) {
    const auto require = [](bool holds, const char* name, double value, const char* rule) {
      if (holds) return;
      std::ostringstream text;
      text << name << ": " << value << "; " << rule;
      throw std::invalid_argument(text.str());
    };
    const auto positive = [&](double value, const char* name) {
      require(value > 0.0 && std::isfinite(value), name, value, "it must be positive and finite");
    };
    require(options.window >= 2 && options.window <= 1'000'000, "window", options.window, "2 ... 1 000 000 samples");
    positive(options.accelerometer_sigma_mps2, "accelerometer_sigma_mps2");
    positive(options.gyro_sigma_radps, "gyro_sigma_radps");
    positive(options.threshold, "threshold");
    positive(options.gravity_mps2, "gravity_mps2");
    samples_.resize(static_cast<std::size_t>(options.window));
  }

  /// Takes a sample in; whether the window that ends with it is at rest.
  [[nodiscard]] bool push(const ImuIncrement& increment) noexcept {
    if (!increment.all_finite() || !(increment.dt_s > 0.0)) {
      reset();
      return false;
    }
    samples_[next_] = {increment.delta_velocity_b / increment.dt_s, increment.delta_theta_b / increment.dt_s};
    next_ = (next_ + 1) % samples_.size();
    if (seen_ < samples_.size()) ++seen_;
    return at_rest();
  }
  /// Whether the last window was at rest.
  [[nodiscard]] bool at_rest() const noexcept { return full() && statistic() < options_.threshold; }
  [[nodiscard]] bool full() const noexcept { return seen_ == samples_.size(); }
  /// T of the samples so far; infinite without any.
  [[nodiscard]] double statistic() const noexcept {
    if (seen_ == 0) return std::numeric_limits<double>::infinity();
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    for (std::size_t i = 0; i < seen_; ++i) mean += samples_[i].force;
    const double size = mean.norm();
    if (size > 0.0) mean *= options_.gravity_mps2 / size;
    double forces = 0.0;
    double rates = 0.0;
    for (std::size_t i = 0; i < seen_; ++i) {
      forces += (samples_[i].force - mean).squaredNorm();
      rates += samples_[i].rate.squaredNorm();
    }
    const double f = options_.accelerometer_sigma_mps2;
    const double w = options_.gyro_sigma_radps;
    return (forces / (f * f) + rates / (w * w)) / static_cast<double>(seen_);
  }
  /// Mean rate of the samples so far [rad/s].
  [[nodiscard]] Eigen::Vector3d mean_rate() const noexcept {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (std::size_t i = 0; i < seen_; ++i) sum += samples_[i].rate;
    return seen_ == 0 ? sum : Eigen::Vector3d(sum / static_cast<double>(seen_));
  }
  void reset() noexcept { seen_ = next_ = 0; }

 private:
  struct Sample {
    Eigen::Vector3d force = Eigen::Vector3d::Zero();
    Eigen::Vector3d rate = Eigen::Vector3d::Zero();
  };
  ZeroVelocityOptions options_;
  std::vector<Sample> samples_;
  std::size_t seen_ = 0;
  std::size_t next_ = 0;
};

/// The body does not move: z = v = 0 [m/s], along the axes of the state's frame (doc/strapdown.md eq. 40).
///
/// Roles: velocity. The noise is what "at rest" allows: a running engine, a swaying mast. No allocation.
struct ZeroVelocity {
  static constexpr int kDim = 3;
  template <class X, class Y>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    const auto v = x(kVelocity);
    for (int i = 0; i < 3; ++i) y.value(i) = v[i];
    if constexpr (Y::kJacobian) {
      auto&& H = y.jacobian(kVelocity);
      H.setZero();
      for (int i = 0; i < 3; ++i) H(i, i) = 1.0;
    }
    return true;
  }
};

/// The body does not turn: the mean rate it reads at rest is bias and Earth rate, z = b_g + C_b_n w_ie_n [rad/s]
/// (doc/strapdown.md eq. 41). Holds the heading, and finds the gyro biases.
///
/// Roles: gyro bias, attitude. No allocation.
struct ZeroAngularRate {
  static constexpr int kDim = 3;
  Eigen::Vector3d earth_rate_n = Eigen::Vector3d::Zero();  ///< w_ie_n [rad/s]

  template <class X, class Y>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    const detail::Quaternion4 q = x(kAttitude);
    const Eigen::Vector3d rate_b = Eigen::Quaterniond(q[0], q[1], q[2], q[3]).conjugate() * earth_rate_n;
    const auto b = x(kGyroBias);
    for (int i = 0; i < 3; ++i) y.value(i) = b[i] + rate_b[i];
    if constexpr (Y::kJacobian) {
      y.jacobian(kGyroBias) = Eigen::Matrix3d::Identity();
      y.jacobian(kAttitude) = geometry::skew(rate_b);
    }
    return true;
  }
};

}  // namespace soopnav::inertial
