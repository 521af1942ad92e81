#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string_view>

namespace soopnav {

/// A dynamic matrix whose rows lie one behind another, as NumPy's do.
using RowMajorMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// Row-major matrices of one size, one behind another: one for each step, or a single one that serves every step.
/// A view: what it was made from must outlive it.
struct MatrixSeries {
  std::span<const double> values;  ///< count * rows * columns numbers
  int rows = 0;
  int columns = 0;
  int count = 0;

  MatrixSeries() = default;
  MatrixSeries(std::span<const double> numbers, int matrix_rows, int matrix_columns, int matrix_count) noexcept
      : values(numbers), rows(matrix_rows), columns(matrix_columns), count(matrix_count) {}
  /// One matrix for every step.
  MatrixSeries(const RowMajorMatrix& constant) noexcept  // NOLINT(google-explicit-constructor): a matrix is a series
      : values(constant.data(), static_cast<std::size_t>(constant.size())),
        rows(static_cast<int>(constant.rows())),
        columns(static_cast<int>(constant.cols())),
        count(1) {}
  MatrixSeries(RowMajorMatrix&&) = delete;

  /// First number of the matrix of step `k`.
  [[nodiscard]] const double* at(int k) const noexcept {
    const auto one = static_cast<std::size_t>(rows) * static_cast<std::size_t>(columns);
    return values.data() + (count == 1 ? 0 : one * static_cast<std::size_t>(k));
  }
};

/// x_k = F x_{k-1} + B u_k + w, w ~ N(0, Q);  z_k = H x_k + v, v ~ N(0, R)   (doc/kalman_filter.md eqs. 1, 2)
///
/// n states, m measured components; F and Q n x n, H m x n, R m x m, B n x p or empty.
struct LinearSystem {
  MatrixSeries F;  ///< into step k
  MatrixSeries Q;  ///< positive semi-definite
  MatrixSeries H;
  MatrixSeries R;  ///< positive definite
  MatrixSeries B{};
};

/// What a run of T steps is given.
struct LinearData {
  std::span<const double> z;                ///< T x m
  std::span<const double> u{};              ///< T x p, empty without B
  std::span<const std::uint8_t> present{};  ///< T x m, 0 where a component of z is missing; empty: all are there
};

/// How a step of a linear filter ended.
enum class StepStatus : std::uint8_t {
  kUpdated,              ///< predicted, and updated with the components that were there
  kNoObservation,        ///< predicted; nothing was observed
  kNonFinite,            ///< the prediction or the update overflowed and was refused
  kNotPositiveDefinite,  ///< rounding left the innovation's covariance without a Cholesky factor; the update was
                         ///< refused
};

/// A lower-case phrase for reports; "unknown" for a value that is no enumerator.
[[nodiscard]] constexpr std::string_view to_string(StepStatus status) noexcept {
  switch (status) {
    case StepStatus::kUpdated:
      return "updated";
    case StepStatus::kNoObservation:
      return "no observation";
    case StepStatus::kNonFinite:
      return "not finite";
    case StepStatus::kNotPositiveDefinite:
      return "not positive definite";
  }
  return "unknown";
}

/// A filtered run; row-major, in one block of memory. The spans stay good when it is moved.
struct LinearRun {
  int steps = 0;
  int n = 0;
  int m = 0;
  std::span<double> x_pred;               ///< T x n, before the update of each step
  std::span<double> P_pred;               ///< T x n x n
  std::span<double> x;                    ///< T x n, after it
  std::span<double> P;                    ///< T x n x n, symmetric to the bit
  std::span<double> innovation;           ///< T x m, z - H x_pred; NaN where a component was missing
  std::span<double> S;                    ///< T x m x m, covariance of the innovation; NaN likewise
  std::span<double> nis;                  ///< T, over the components that were there; NaN without any
  std::span<double> step_log_likelihood;  ///< T, log of the density of z_k given the past; 0 without observation
  std::span<StepStatus> status;           ///< T
  double log_likelihood = 0.0;            ///< the sum; NaN if a step was refused

  /// Matrix of step `k` in one of the spans of T matrices.
  [[nodiscard]] static Eigen::Map<const RowMajorMatrix> matrix(std::span<const double> series, int k, int rows,
                                                               int columns) noexcept {
    const std::size_t one = static_cast<std::size_t>(rows) * static_cast<std::size_t>(columns);
    return {series.data() + one * static_cast<std::size_t>(k), rows, columns};
  }

  std::unique_ptr<double[]> numbers;           ///< what the spans lie in
  std::unique_ptr<StepStatus[]> status_bytes;  ///< what `status` lies in
};

/// Kalman filter over a whole run of a linear Gaussian system of any size.
///
/// `x0`, `P0` are before the first prediction. The covariance update is Joseph's in its rank form (doc/kalman_filter.md
/// eqs. 13 to 15): as stable as the full product, and a quarter of its work for 14 states and 4 measurements. Zeros of
/// F and H cost nothing. The same bits on every processor.
///
/// A component that is missing is left out of its step with its row of H and its rows and columns of R; its z is not
/// read. A step whose prediction overflows is refused (and so are those that follow from it): its x_pred, x, P_pred and
/// P are those of the step before.
///
/// Throws std::invalid_argument, naming the parameter, for sizes that do not fit, numbers that are not finite, P0 or Q
/// not symmetric positive semi-definite, R not symmetric positive definite. Allocates its result and its workspace
/// once.
[[nodiscard]] LinearRun linear_filter(const LinearSystem& system, const LinearData& data,
                                      const Eigen::Ref<const Eigen::VectorXd>& x0,
                                      const Eigen::Ref<const Eigen::MatrixXd>& P0);

}  // namespace soopnav
