#include "waveform/lte/delay_subspace.hpp"

#include <Eigen/Eigenvalues>
#include <cmath>
#include <complex>
#include <numbers>

#include "soopnav/waveform/lte/types.hpp"

namespace soopnav::lte {

namespace {
// E[H(f) conj(H(g))] for power spread evenly over [earliest, latest].
std::complex<double> covariance(double f, double g, double earliest_s, double latest_s) {
  const double w = 2.0 * std::numbers::pi * kSubcarrierSpacingHz * (f - g);
  const double half = 0.5 * (latest_s - earliest_s), centre = 0.5 * (latest_s + earliest_s);
  const double x = w * half;
  const double sinc = std::abs(x) < 1e-9 ? 1.0 : std::sin(x) / x;
  return std::polar(1.0, -w * centre) * sinc;
}
}  // namespace

DelaySubspace::DelaySubspace(const Eigen::VectorXd& from, double earliest_s, double latest_s, double floor)
    : from_(from), earliest_s_(earliest_s), latest_s_(latest_s) {
  const Eigen::Index n = from.size();
  Eigen::MatrixXcd r(n, n);
  for (Eigen::Index i = 0; i < n; ++i) {
    for (Eigen::Index j = 0; j < n; ++j) r(i, j) = covariance(from(i), from(j), earliest_s, latest_s);
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXcd> solver(r);
  Eigen::Index rank = 0;
  while (rank < n && solver.eigenvalues()(n - 1 - rank) > floor * solver.eigenvalues()(n - 1)) ++rank;
  basis_ = solver.eigenvectors().rightCols(rank).cast<Cf32>();
  eigenvalues_ = solver.eigenvalues().tail(rank);
}

void DelaySubspace::set_targets(const Eigen::VectorXd& to) {
  Eigen::MatrixXcd cross(to.size(), from_.size());
  for (Eigen::Index i = 0; i < to.size(); ++i) {
    for (Eigen::Index j = 0; j < from_.size(); ++j) cross(i, j) = covariance(to(i), from_(j), earliest_s_, latest_s_);
  }
  target_ = (cross * basis_.cast<std::complex<double>>() * eigenvalues_.cwiseInverse().asDiagonal()).cast<Cf32>();
}

void DelaySubspace::project(const Cf32* in, Cf32* out) const {
  const Eigen::Map<const Eigen::VectorXcf> x(in, basis_.rows());
  Eigen::Map<Eigen::VectorXcf> y(out, basis_.rows());
  Eigen::Matrix<Cf32, Eigen::Dynamic, 1, 0, 32, 1> c(basis_.cols());
  c.noalias() = basis_.adjoint().lazyProduct(x);
  y.noalias() = basis_.lazyProduct(c);
}

void DelaySubspace::interpolate(const Cf32* in, Cf32* out) const {
  const Eigen::Map<const Eigen::VectorXcf> x(in, basis_.rows());
  Eigen::Map<Eigen::VectorXcf> y(out, target_.rows());
  Eigen::Matrix<Cf32, Eigen::Dynamic, 1, 0, 32, 1> c(basis_.cols());
  c.noalias() = basis_.adjoint().lazyProduct(x);
  y.noalias() = target_.lazyProduct(c);
}

}  // namespace soopnav::lte
