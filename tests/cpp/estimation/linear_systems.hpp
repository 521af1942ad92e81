#pragma once

// Linear systems and straightforward references for the tests of the linear filter and the smoothers.

#include <Eigen/Core>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <span>
#include <stdexcept>
#include <vector>

#include "soopnav/core/constants.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/estimation/detail/gaussian_update.hpp"
#include "soopnav/estimation/linear_filter.hpp"

namespace soopnav::test {

struct DenseSystem {
  RowMajorMatrix F, Q, H, R, P0;
  Eigen::VectorXd x0;
  [[nodiscard]] LinearSystem view() const { return {F, Q, H, R}; }
  [[nodiscard]] int n() const { return static_cast<int>(F.rows()); }
  [[nodiscard]] int m() const { return static_cast<int>(H.rows()); }
};

/// Two axes of nearly constant velocity, positions measured: [x vx y vy].
inline DenseSystem constant_velocity(double dt_s = 0.5, double q = 0.3) {
  DenseSystem s;
  s.F = RowMajorMatrix::Identity(4, 4);
  s.Q = RowMajorMatrix::Zero(4, 4);
  for (int axis = 0; axis < 4; axis += 2) {
    s.F(axis, axis + 1) = dt_s;
    s.Q(axis, axis) = q * dt_s * dt_s * dt_s / 3.0;
    s.Q(axis, axis + 1) = s.Q(axis + 1, axis) = q * dt_s * dt_s / 2.0;
    s.Q(axis + 1, axis + 1) = q * dt_s;
  }
  s.H = RowMajorMatrix::Zero(2, 4);
  s.H(0, 0) = s.H(1, 2) = 1.0;
  s.R.resize(2, 2);
  s.R << 2.0, 0.4, 0.4, 1.5;
  s.P0 = 10.0 * RowMajorMatrix::Identity(4, 4);
  s.x0 = Eigen::Vector4d(3.0, -1.0, 0.5, 2.0);
  return s;
}

/// Three axes of position, velocity and acceleration with an offset each, and a clock: fourteen states, four sums of
/// them measured. Offsets and clock are hardly observable, so rounding has time to act.
inline DenseSystem fourteen_states() {
  DenseSystem s;
  constexpr double dt_s = 0.1;
  s.F = RowMajorMatrix::Identity(14, 14);
  s.Q = 1e-9 * RowMajorMatrix::Identity(14, 14);
  const Eigen::Vector3d g(0.5 * dt_s * dt_s, dt_s, 1.0);
  for (int axis = 0; axis < 9; axis += 3) {
    s.F.block<3, 3>(axis, axis) << 1, dt_s, 0.5 * dt_s * dt_s, 0, 1, dt_s, 0, 0, 0.98;
    s.Q.block<3, 3>(axis, axis) += 0.09 * g * g.transpose();
  }
  s.F(12, 13) = dt_s;
  for (int i = 9; i < 12; ++i) s.Q(i, i) = 1e-4;
  s.Q(12, 12) = 1e-3;
  s.Q(13, 13) = 1.0001e-5;
  s.H = RowMajorMatrix::Zero(4, 14);
  for (int i = 0; i < 3; ++i) s.H(i, 3 * i) = s.H(i, 9 + i) = s.H(i, 12) = 1.0;
  s.H(3, 0) = s.H(3, 12) = 1.0;
  s.H(3, 3) = -1.0;
  s.R = Eigen::Vector4d(4.0, 4.0, 4.0, 9.0).asDiagonal();
  s.P0 = 25.0 * RowMajorMatrix::Identity(14, 14);
  s.x0 = Eigen::VectorXd::Zero(14);
  return s;
}

/// A system of any size without zeros: a slow rotation of all states, correlated noises.
inline DenseSystem dense_system(int n, int m, std::uint64_t seed) {
  RandomStream random(seed);
  const auto matrix = [&random](int rows, int columns) {
    RowMajorMatrix M(rows, columns);
    for (int i = 0; i < rows; ++i) {
      for (int j = 0; j < columns; ++j) M(i, j) = random.normal();
    }
    return M;
  };
  DenseSystem s;
  s.F = 0.9 * RowMajorMatrix::Identity(n, n) + 0.3 / n * matrix(n, n);
  const RowMajorMatrix q = matrix(n, n);
  const RowMajorMatrix r = matrix(m, m);
  const RowMajorMatrix p = matrix(n, n);
  s.Q = q * q.transpose() / n;
  s.R = r * r.transpose() + RowMajorMatrix::Identity(m, m);
  s.P0 = p * p.transpose() + RowMajorMatrix::Identity(n, n);
  s.H = matrix(m, n);
  s.x0 = matrix(n, 1);
  return s;
}

struct Simulated {
  RowMajorMatrix truth;  ///< T x n
  RowMajorMatrix z;      ///< T x m
  [[nodiscard]] std::span<const double> values() const { return {z.data(), static_cast<std::size_t>(z.size())}; }
};

/// A run drawn from the system itself, its start included.
inline Simulated simulate(const DenseSystem& s, int steps, std::uint64_t seed) {
  RandomStream random(seed);
  const auto draw = [&random](const RowMajorMatrix& covariance) -> Eigen::VectorXd {
    Eigen::MatrixXd root(covariance.rows(), covariance.cols());
    if (!detail::semidefinite_root(Eigen::MatrixXd(covariance), root))
      throw std::invalid_argument("a covariance without a root");
    Eigen::VectorXd w(covariance.rows());
    for (double& value : w) value = random.normal();
    return root * w;
  };
  Simulated out{RowMajorMatrix(steps, s.n()), RowMajorMatrix(steps, s.m())};
  Eigen::VectorXd x = s.x0 + draw(s.P0);
  for (int k = 0; k < steps; ++k) {
    x = s.F * x + draw(s.Q);
    out.truth.row(k) = x.transpose();
    out.z.row(k) = (s.H * x + draw(s.R)).transpose();
  }
  return out;
}

inline Eigen::Map<const Eigen::VectorXd> vector_at(std::span<const double> series, int k, int n) {
  return {series.data() + static_cast<std::ptrdiff_t>(k) * n, n};
}
inline Eigen::Map<const RowMajorMatrix> matrix_at(std::span<const double> series, int k, int rows, int columns) {
  return LinearRun::matrix(series, k, rows, columns);
}

/// The filter as the books write it, in any precision, with the full Joseph product. Products and the inverse are
/// loops: Eigen's for one more type of number cost more to compile than all these tests.
template <class Real>
struct BookFilter {
  using Matrix = Eigen::Matrix<Real, Eigen::Dynamic, Eigen::Dynamic>;
  Matrix F, Q, H, R, P, P_pred, S;
  Matrix x, x_pred, innovation;  // columns
  Real nis = 0;
  Real log_likelihood = 0;

  explicit BookFilter(const DenseSystem& s)
      : F(s.F.cast<Real>()),
        Q(s.Q.cast<Real>()),
        H(s.H.cast<Real>()),
        R(s.R.cast<Real>()),
        P(s.P0.cast<Real>()),
        x(s.x0.cast<Real>()) {}

  static Matrix transposed(const Matrix& A) {
    Matrix T(A.cols(), A.rows());
    for (Eigen::Index i = 0; i < A.rows(); ++i) {
      for (Eigen::Index j = 0; j < A.cols(); ++j) T.coeffRef(j, i) = A.coeff(i, j);
    }
    return T;
  }
  // C + sign A B; without C, A B.
  static Matrix sum(Matrix C, Real sign, const Matrix& A, const Matrix& B) {
    for (Eigen::Index i = 0; i < A.rows(); ++i) {
      for (Eigen::Index j = 0; j < B.cols(); ++j) {
        Real dot = 0;
        for (Eigen::Index k = 0; k < A.cols(); ++k) dot += A.coeff(i, k) * B.coeff(k, j);
        C.coeffRef(i, j) += sign * dot;
      }
    }
    return C;
  }
  static Matrix times(const Matrix& A, const Matrix& B) { return sum(Matrix::Zero(A.rows(), B.cols()), 1, A, B); }
  // Inverse of a positive definite matrix by Gauss-Jordan elimination, and the logarithm of its determinant.
  static Matrix inverse(Matrix A, Real& log_determinant) {
    const Eigen::Index n = A.rows();
    Matrix inverse = Matrix::Identity(n, n);
    log_determinant = 0;
    for (Eigen::Index k = 0; k < n; ++k) {
      const Real pivot = A.coeff(k, k);
      log_determinant += std::log(pivot);
      for (Eigen::Index j = 0; j < n; ++j) {
        A.coeffRef(k, j) /= pivot;
        inverse.coeffRef(k, j) /= pivot;
      }
      for (Eigen::Index i = 0; i < n; ++i) {
        const Real factor = A.coeff(i, k);
        for (Eigen::Index j = 0; i != k && j < n; ++j) {
          A.coeffRef(i, j) -= factor * A.coeff(k, j);
          inverse.coeffRef(i, j) -= factor * inverse.coeff(k, j);
        }
      }
    }
    return inverse;
  }

  void step(const Eigen::VectorXd& z) {
    x_pred = times(F, x);
    P_pred = sum(Q, 1, times(F, P), transposed(F));
    innovation = sum(Matrix(z.cast<Real>()), -1, H, x_pred);
    const Matrix PHt = times(P_pred, transposed(H));
    S = sum(R, 1, H, PHt);
    Real log_determinant = 0;
    const Matrix S_inverse = inverse(S, log_determinant);
    const Matrix K = times(PHt, S_inverse);
    const Matrix A = sum(Matrix::Identity(P.rows(), P.cols()), -1, K, H);
    x = sum(x_pred, 1, K, innovation);
    P = sum(times(times(A, P_pred), transposed(A)), 1, times(K, R), transposed(K));
    nis = times(times(transposed(innovation), S_inverse), innovation)(0, 0);
    log_likelihood = -(nis + log_determinant + static_cast<Real>(S.rows()) * std::log(static_cast<Real>(kTwoPi))) / 2;
  }
};

}  // namespace soopnav::test
