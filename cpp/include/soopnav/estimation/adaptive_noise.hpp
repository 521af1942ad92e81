#pragma once

#include <Eigen/Core>
#include <cmath>

#include "soopnav/core/arithmetic.hpp"
#include "soopnav/core/joint_process.hpp"
#include "soopnav/core/status.hpp"
#include "soopnav/estimation/detail/gaussian_update.hpp"
#include "soopnav/estimation/update_report.hpp"

namespace soopnav {

/// A process model whose noise has `scale` times the standard deviation; its motion is the same.
template <class Process>
struct ScaledNoise {
  static constexpr int kNoise = Process::kNoise;
  Process process;
  double scale = 1.0;  ///< of standard deviations, >= 0

  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& x, double dt_s, const W& w, Y& y) const {
    return propagate(x, detail::NoInput{}, dt_s, w, y);
  }
  template <class X, class U, class W, class Y>
  [[nodiscard]] bool propagate(const X& x, const U& u, double dt_s, const W& w, Y& y) const {
    if (!detail::propagate(process, x, u, dt_s, Scaled<W>{w, scale}, y)) return false;
    if constexpr (Y::kJacobian) y.scale_noise(scale);
    return true;
  }

 private:
  template <class W>
  struct Scaled {
    const W& w;
    double scale;
    [[nodiscard]] auto operator[](int i) const { return eval(scale * w[i]); }
  };
};

namespace detail {

template <class Process>
struct ProcessInput<ScaledNoise<Process>> {
  using Type = InputOf<Process>;
};

}  // namespace detail

/// How `AdaptiveProcessNoise` learns.
struct AdaptiveNoiseOptions {
  double initial = 1.0;            ///< multiplier at the start, within the bounds
  double lower = 1e-4;             ///< least multiplier, > 0
  double upper = 1e4;              ///< largest multiplier, > lower
  double memory = 500.0;           ///< updates after which their weight has fallen to 1/e, >= 1
  double prior_information = 5.0;  ///< weight of `initial` at the start, as Fisher information of log(multiplier), > 0

  /// Throws std::invalid_argument naming the option that breaks its rule.
  void check() const;
};

/// A multiplier on the process noise (its covariance), estimated from innovations (doc/kalman_filter.md eqs. 30 to 33).
///
/// Each innovation moves log(multiplier) along the gradient of its Gaussian likelihood in the direction in which the
/// predicted part of its covariance, S - R, grows, divided by the Fisher information gathered so far; both are
/// forgotten exponentially. The gradient is zero in the mean exactly where innovations are as large as S says, whatever
/// that direction is. What is known of the multiplier grows with what innovations tell about it: where R covers them
/// nothing moves. The measurement noise is taken to be right: a wrong R is answered by a wrong Q.
///
///     filter.predict(noise.scaled(process), dt_s);
///     noise.observe(filter.update(model, z, R), R);
///
/// No heap.
class AdaptiveProcessNoise {
 public:
  /// Throws std::invalid_argument naming the option that breaks its rule.
  explicit AdaptiveProcessNoise(const AdaptiveNoiseOptions& options = {});

  /// Factor on the covariance of the process noise.
  [[nodiscard]] double multiplier() const noexcept { return std::exp(log_multiplier_); }
  /// Its logarithm, which is what is estimated.
  [[nodiscard]] double log_multiplier() const noexcept { return log_multiplier_; }
  /// Fisher information about log(multiplier) in memory.
  [[nodiscard]] double information() const noexcept { return information_; }
  [[nodiscard]] const AdaptiveNoiseOptions& options() const noexcept { return options_; }

  /// Puts back what this object (or another of the same options) had learnt.
  void restore(double log_multiplier, double information) noexcept {
    log_multiplier_ = log_multiplier;
    information_ = information;
  }

  /// `process` with its noise as it is estimated now.
  template <class Process>
  [[nodiscard]] ScaledNoise<Process> scaled(const Process& process) const {
    return {process, std::exp(0.5 * log_multiplier_)};
  }

  /// Learns from an innovation whose measurement noise had covariance `R`. Gated ones count too: a filter whose noise
  /// is far too small gates everything. Others, shapes that do not fit and an `R` that is no covariance of noise change
  /// nothing; false then.
  template <class Report, class RMatrix>
  bool observe(const Report& report, const Eigen::MatrixBase<RMatrix>& R) noexcept {
    if (report.status != UpdateStatus::kAccepted && report.status != UpdateStatus::kGated) return false;
    if (R.rows() != report.covariance.rows() || R.cols() != report.covariance.cols()) return false;
    const typename Report::Square noise = R;
    if (detail::check_noise(noise) != UpdateStatus::kAccepted) return false;
    const detail::CholeskyFactor<typename Report::Square> root(report.covariance);
    if (!root.definite) return false;
    // U = L⁻¹ (S - R) L⁻ᵀ and the whitened innovation e: score (eᵀ U e - tr U) / 2, information |U|² / 2.
    typename Report::Square U = report.covariance - noise;
    detail::solve_lower(root.L.data(), U.rows(), U.data(), U.cols());
    detail::solve_right_lower_transposed(root.L.data(), U.cols(), U.data(), U.rows());
    typename Report::Vector e = report.innovation;
    root.whiten(e);
    double trace = 0.0;
    double squares = 0.0;
    for (Eigen::Index i = 0; i < U.cols(); ++i) {
      trace += U.coeff(i, i);
      for (Eigen::Index k = 0; k < U.rows(); ++k) squares += U.coeff(k, i) * U.coeff(k, i);
    }
    return learn(0.5 * (detail::quadratic_form(U, e) - trace), 0.5 * squares);
  }
  bool observe(const UpdateReport<1>& report, double variance) noexcept {
    return observe(report, Eigen::Matrix<double, 1, 1>(variance));
  }

 private:
  bool learn(double score, double information) noexcept;

  AdaptiveNoiseOptions options_;
  double keep_;
  double log_multiplier_;
  double information_;
};

}  // namespace soopnav
