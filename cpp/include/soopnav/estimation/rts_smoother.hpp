#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "soopnav/estimation/detail/small_matrix.hpp"
#include "soopnav/estimation/detail/symmetric_eigen.hpp"
#include "soopnav/estimation/linear_filter.hpp"
#include "soopnav/estimation/state.hpp"

namespace soopnav {

/// A pivot of the factorisation of a predicted covariance below this, relative to its variance and for each state,
/// means that the covariance is singular to rounding (doc/rts_smoother.md, section 3).
inline constexpr double kSmootherRankTolerance = 1e-14;

/// Rauch-Tung-Striebel smoother over a whole linear run (doc/rts_smoother.md eqs. 3 to 5).
///
/// `F` leads into each step, as for linear_filter: n x n, one or T of them (the first of T is not used). `x_pred` and
/// `x` are T x n, `P_pred` and `P` T x n x n row-major, before and after the update of each step. Written are
/// `x_smooth` (T x n) and `P_smooth` (T x n x n, symmetric to the bit); the last step is that of the filter. They must
/// not overlap the inputs.
///
/// The gain comes from a factorisation Uᵀ D U of P_pred. Where P_pred is singular (a state known exactly) the solution
/// of least norm among components scaled to unit variance is taken: what has no variance is left as the filter had it.
/// Returned is the number of steps at which that happened.
///
/// Throws std::invalid_argument, naming the parameter, for sizes that do not fit, and for numbers that are not finite
/// or a covariance that is not symmetric (to 1e-9 of its diagonal), in which case the output is partly written.
/// Allocates its workspace once (and once more at each singular step).
int rts_smooth(const MatrixSeries& F, std::span<const double> x_pred, std::span<const double> P_pred,
               std::span<const double> x, std::span<const double> P, std::span<double> x_smooth,
               std::span<double> P_smooth);

/// What a filter notes of a step, for a smoother: tangents are at the states beside them.
template <FixedStateType State>
struct StepRecord {
  using Covariance = Eigen::Matrix<double, State::kDim, State::kDim>;

  State predicted;    ///< before the step's updates
  Covariance P_pred;  ///< its covariance
  State filtered;     ///< after them; `predicted` where nothing was observed
  Covariance P;       ///< its covariance
  Covariance cross;   ///< of the errors of the last step's `filtered` (rows) and this `predicted` (columns): P Fᵀ of
                      ///< the prediction, or the sum over sigma points. Not used in the first record
};

/// A state given all measurements of a run.
template <FixedStateType State>
struct SmoothedState {
  State state;
  Eigen::Matrix<double, State::kDim, State::kDim> P;
};

/// What became of a smoother's call.
enum class SmoothStatus : std::uint8_t {
  kDone,       ///< recorded, or smoothed
  kFull,       ///< no room for another record; nothing was kept of it
  kNonFinite,  ///< NaN or infinity in the record, or a smoothed step overflowed
};

/// A lower-case phrase for reports; "unknown" for a value that is no enumerator.
[[nodiscard]] constexpr std::string_view to_string(SmoothStatus status) noexcept {
  switch (status) {
    case SmoothStatus::kDone:
      return "done";
    case SmoothStatus::kFull:
      return "full";
    case SmoothStatus::kNonFinite:
      return "not finite";
  }
  return "unknown";
}

namespace detail {

/// X = P⁺ B for a positive semi-definite P, by LLT when it is definite, else by the least-norm solution among
/// components scaled to unit variance. Returns whether it was definite. No heap for fixed sizes.
template <class Square, class Right>
bool solve_covariance(const Square& P, const Right& B, Right& X) {
  const Eigen::Index n = P.rows();
  const double tolerance = kSmootherRankTolerance * static_cast<double>(n);
  const CholeskyFactor<Square> factor(P);
  bool definite = factor.definite;
  for (Eigen::Index i = 0; i < n && definite; ++i) {
    const double pivot = factor.L.coeff(i, i);
    definite = pivot * pivot > tolerance * P.coeff(i, i);
  }
  X = B;
  if (definite) {
    solve_lower(factor.L.data(), n, X.data(), X.cols());
    solve_lower_transposed(factor.L.data(), n, X.data(), X.cols());
    return true;
  }
  // P = S C S with S the standard deviations and C the correlations: X = S⁻¹ C⁺ S⁻¹ B. A component without variance has
  // no correlation either; one is put for its deviation.
  Eigen::Matrix<double, Square::RowsAtCompileTime, 1> scale(n);
  for (Eigen::Index i = 0; i < n; ++i) scale[i] = P.coeff(i, i) > 0.0 ? 1.0 / std::sqrt(P.coeff(i, i)) : 1.0;
  Square correlation = P;
  for (Eigen::Index j = 0; j < n; ++j) {
    for (Eigen::Index i = 0; i < n; ++i) correlation.coeffRef(i, j) *= scale[i] * scale[j];
  }
  Eigen::Matrix<double, Square::RowsAtCompileTime, 1> inverse(n);
  Square vectors(n, n);
  symmetric_eigen(correlation.data(), static_cast<int>(n), inverse.data(), vectors.data());
  double largest = 0.0;
  for (Eigen::Index i = 0; i < n; ++i) largest = std::max(largest, std::abs(inverse[i]));
  for (Eigen::Index i = 0; i < n; ++i) inverse[i] = inverse[i] > tolerance * largest ? 1.0 / inverse[i] : 0.0;
  Right turned = B;
  for (Eigen::Index j = 0; j < X.cols(); ++j) {
    for (Eigen::Index i = 0; i < n; ++i) {
      X.coeffRef(i, j) *= scale[i];
      turned.coeffRef(i, j) = 0.0;
    }
  }
  accumulate_transposed_product<1>(vectors, X, turned);
  for (Eigen::Index j = 0; j < X.cols(); ++j) {
    for (Eigen::Index i = 0; i < n; ++i) turned.coeffRef(i, j) *= inverse[i];
  }
  product(vectors, turned, X);
  for (Eigen::Index j = 0; j < X.cols(); ++j) {
    for (Eigen::Index i = 0; i < n; ++i) X.coeffRef(i, j) *= scale[i];
  }
  return false;
}

}  // namespace detail

/// Rauch-Tung-Striebel smoother for any filter over a fixed state (doc/rts_smoother.md eqs. 8 to 10).
///
/// It works on what the filter recorded, in the tangent space, with the state's `retract` and `local`: headings go the
/// short way round and quaternions stay unit. The covariances of the tangents at the predicted and at the smoothed
/// state are taken for the same, as the extended filter itself does. All memory is reserved by the constructor; nothing
/// else allocates.
template <FixedStateType State>
class RtsSmoother {
 public:
  using Record = StepRecord<State>;
  using Covariance = typename Record::Covariance;

  /// Room for `capacity` >= 1 steps; otherwise throws std::invalid_argument.
  explicit RtsSmoother(int capacity) {
    if (capacity < 1) throw std::invalid_argument("capacity: " + std::to_string(capacity) + " is not positive");
    records_.reserve(static_cast<std::size_t>(capacity));
    smoothed_.reserve(static_cast<std::size_t>(capacity));
    capacity_ = capacity;
  }

  /// Takes the next step. Only kDone keeps it; its covariances are expected to be symmetric.
  [[nodiscard]] SmoothStatus record(const Record& step) noexcept {
    if (size() == capacity_) return SmoothStatus::kFull;
    const bool finite = step.predicted.x.allFinite() && step.filtered.x.allFinite() && step.P_pred.allFinite() &&
                        step.P.allFinite() && (records_.empty() || step.cross.allFinite());
    if (!finite) return SmoothStatus::kNonFinite;
    records_.push_back(step);
    return SmoothStatus::kDone;
  }

  [[nodiscard]] int size() const noexcept { return static_cast<int>(records_.size()); }
  [[nodiscard]] int capacity() const noexcept { return capacity_; }
  [[nodiscard]] std::span<const Record> records() const noexcept { return records_; }

  /// Smooths all steps recorded so far; `smoothed()` holds them afterwards, the last as the filter left it. More steps
  /// may be recorded later and the whole smoothed again. kNonFinite, with no smoothed step, when a number overflows.
  [[nodiscard]] SmoothStatus smooth() noexcept {
    smoothed_.clear();
    singular_steps_ = 0;
    if (records_.empty()) return SmoothStatus::kDone;
    smoothed_.resize(records_.size());
    const std::size_t last = records_.size() - 1;
    smoothed_[last] = {records_[last].filtered, records_[last].P};
    for (std::size_t k = last; k-- > 0;) {
      if (!step_back(records_[k], records_[k + 1], smoothed_[k + 1], smoothed_[k])) {
        smoothed_.clear();
        return SmoothStatus::kNonFinite;
      }
    }
    return SmoothStatus::kDone;
  }

  /// The smoothed steps, in order of time; empty before `smooth()`.
  [[nodiscard]] std::span<const SmoothedState<State>> smoothed() const noexcept { return smoothed_; }
  /// Steps of the last `smooth()` whose predicted covariance was singular, so that the gain is a least-norm one.
  [[nodiscard]] int singular_steps() const noexcept { return singular_steps_; }

  /// Forgets all steps; the memory stays reserved.
  void clear() noexcept {
    records_.clear();
    smoothed_.clear();
    singular_steps_ = 0;
  }

 private:
  bool step_back(const Record& now, const Record& next, const SmoothedState<State>& later,
                 SmoothedState<State>& out) noexcept {
    const Covariance from_next = next.cross.transpose();
    Covariance gain_transposed;
    if (!detail::solve_covariance(next.P_pred, from_next, gain_transposed)) ++singular_steps_;  // eq. 8
    const typename State::Tangent correction = next.predicted.local(later.state);
    typename State::Tangent move = State::Tangent::Zero();
    detail::accumulate_transposed_product<1>(gain_transposed, correction, move);
    out.state = now.filtered.retract(move);  // eq. 9
    Covariance difference = later.P;
    for (Eigen::Index i = 0; i < difference.size(); ++i) difference.data()[i] -= next.P_pred.data()[i];
    Covariance half;
    detail::product(difference, gain_transposed, half);
    Covariance P = now.P;
    detail::accumulate_transposed_product<1>(gain_transposed, half, P);  // eq. 10
    for (int j = 0; j < State::kDim; ++j) {
      for (int i = 0; i < State::kDim; ++i) out.P.coeffRef(i, j) = 0.5 * (P.coeff(i, j) + P.coeff(j, i));
    }
    return detail::all_finite(out.state.x) && detail::all_finite(out.P);
  }

  std::vector<Record> records_;
  std::vector<SmoothedState<State>> smoothed_;
  int capacity_ = 0;
  int singular_steps_ = 0;
};

}  // namespace soopnav
