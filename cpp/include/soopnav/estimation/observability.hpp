#pragma once

#include <Eigen/Core>

#include "soopnav/estimation/fisher_information.hpp"

namespace soopnav {

/// What a sequence of measurements says about the state at its start, when the transitions are known and without noise
/// (doc/fisher_information.md eq. 11): the stack of whitened H_k F_{k-1} ... F_0, kept as its triangular root.
///
/// `bound()` gives its singular values, rank and the directions that stay free; they are the null space of the
/// observability Gramian. With process noise the numbers are optimistic (`PosteriorCrlb` gives those), the rank is not.
/// No heap.
template <FixedStateType StateType>
class SequenceObservability {
 public:
  using State = StateType;
  static constexpr int kDim = State::kDim;
  using Matrix = Eigen::Matrix<double, kDim, kDim>;

  /// Adds measurements at the state of now. Groups as for `solve`. kConverged, or the reason and nothing added.
  template <int MaxRows = 32, MeasurementGroupFor<State>... Groups>
  [[nodiscard]] SolveStatus add(const State& state, const Groups&... groups) {
    InformationSum<State> here;
    const SolveStatus status = here.template add<MaxRows>(state, groups...);
    if (status != SolveStatus::kConverged) return status;
    const Matrix rows = here.root() * since_start_;
    return sum_.add_whitened(rows) ? SolveStatus::kConverged : SolveStatus::kNonFinite;
  }

  /// Moves on: `F` takes the tangent of now to that of the next time. False, and nothing changed, when the product is
  /// not finite.
  [[nodiscard]] bool propagate(const Matrix& F) {
    const Matrix next = F * since_start_;
    if (!next.allFinite()) return false;
    since_start_ = next;
    return true;
  }

  /// Rank, singular values, free directions and bound of the state at the start.
  [[nodiscard]] CramerRaoBound<kDim> bound(double tolerance = kRankTolerance) const { return sum_.bound(tolerance); }
  /// The observability Gramian.
  [[nodiscard]] Matrix gramian() const noexcept { return sum_.information(); }

 private:
  InformationSum<State> sum_;
  Matrix since_start_ = Matrix::Identity();
};

/// The observability matrix [H_0; H_1 F_0; H_2 F_1 F_0; ...] of a sequence (eq. 11), sizes known at run time.
///
/// `F`: one (n, n) matrix for all steps, or `steps` - 1 (or more) of them one below the other. `H`: one (m, n) matrix
/// given with `rows` = m, or `steps` of them one below the other. Returns (steps * rows, n). Throws
/// std::invalid_argument naming the argument when shapes do not fit or a number is not finite. Allocates.
[[nodiscard]] Eigen::MatrixXd observability_matrix(const Eigen::Ref<const Eigen::MatrixXd>& F,
                                                   const Eigen::Ref<const Eigen::MatrixXd>& H, Eigen::Index rows,
                                                   Eigen::Index steps);

}  // namespace soopnav
