#include "soopnav/estimation/fisher_information.hpp"

#include <Eigen/Cholesky>
#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <string>

namespace soopnav {
namespace {

std::string shape(const Eigen::Ref<const Eigen::MatrixXd>& m) {
  return "(" + std::to_string(m.rows()) + ", " + std::to_string(m.cols()) + ")";
}

std::string shortest(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%g", value);
  return text;
}

// Room for sizes that need no heap, and for those that do.
template <int Max>
using BoundedSquare = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::ColMajor, Max, Max>;
template <int Max>
using BoundedVector = Eigen::Matrix<double, Eigen::Dynamic, 1, Eigen::ColMajor, Max, 1>;
constexpr int kBounded = 32;

template <int Max>
int bound(const double* root_data, int n, double tolerance, double* information_data, double* covariance_data,
          double* sigma, double* s, double* unobservable_data) noexcept {
  constexpr double kInf = std::numeric_limits<double>::infinity();
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  using Square = BoundedSquare<Max>;
  const Eigen::Map<const Square> root(root_data, n, n);
  Eigen::Map<Square> information(information_data, n, n);
  Eigen::Map<Square> covariance(covariance_data, n, n);
  Eigen::Map<Square> unobservable(unobservable_data, n, n);
  information.setZero();
  detail::accumulate_transposed_product<1>(root, root, information);
  if (!detail::all_finite(root)) return -1;

  BoundedVector<Max> scale(n);
  detail::column_scale(root_data, n, n, scale.data());
  Square scaled = root;
  for (int j = 0; j < n; ++j) scaled.col(j) /= scale[j];
  Square V(n, n);
  BoundedVector<Max> values(n);
  if (!detail::square_svd(scaled.data(), n, values.data(), nullptr, V.data())) return -1;
  std::copy_n(values.data(), n, s);
  int rank = 0;
  while (rank < n && s[rank] > tolerance * s[0]) ++rank;

  for (int i = 0; i < n; ++i) {
    for (int j = 0; j <= i; ++j) {
      double sum = 0.0;
      for (int k = 0; k < rank; ++k) sum += V(i, k) / s[k] * (V(j, k) / s[k]);
      covariance(i, j) = covariance(j, i) = sum / scale[i] / scale[j];
    }
  }
  for (int i = 0; i < n; ++i) {
    double squares = 0.0;
    for (int k = rank; k < n; ++k) squares += V(i, k) * V(i, k);
    if (squares <= detail::kOutsideNull * detail::kOutsideNull) continue;
    covariance.row(i).setConstant(kNan);
    covariance.col(i).setConstant(kNan);
    covariance(i, i) = kInf;
  }
  for (int i = 0; i < n; ++i) sigma[i] = std::sqrt(covariance(i, i));

  for (int k = rank; k < n; ++k) {
    // Back to unscaled components, then at right angles to those before: Gram-Schmidt, twice, which is enough.
    BoundedVector<Max> v = V.col(k).cwiseQuotient(scale) * scale.minCoeff();
    v.normalize();
    for (int pass = 0; pass < 2; ++pass) {
      for (int j = 0; j < k - rank; ++j) {
        const double along = unobservable.col(j).dot(v);
        v -= along * unobservable.col(j);
      }
      v.normalize();
    }
    unobservable.col(k - rank) = v;
  }
  return rank;
}

template <int Max>
bool root_of_information(const double* information, int n, double* root) noexcept {
  const Eigen::Map<const BoundedSquare<Max>> J(information, n, n);
  BoundedVector<Max> scale = J.diagonal();
  for (int i = 0; i < n; ++i) {
    if (scale[i] < 0.0) return false;
    scale[i] = scale[i] > 0.0 ? std::sqrt(scale[i]) : 1.0;
  }
  BoundedSquare<Max> scaled(n, n);
  for (int j = 0; j < n; ++j) {
    for (int i = 0; i < n; ++i) scaled(i, j) = J(i, j) / scale[i] / scale[j];
  }
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < i; ++j) {
      if (!(std::abs(scaled(i, j) - scaled(j, i)) <= 1e-9)) return false;
      scaled(i, j) = scaled(j, i) = 0.5 * (scaled(i, j) + scaled(j, i));
    }
  }
  BoundedVector<Max> values(n);
  BoundedSquare<Max> vectors(n, n);
  detail::symmetric_eigen(scaled.data(), n, values.data(), vectors.data());
  if (!detail::all_finite(values)) return false;
  const double largest = n > 0 ? values.maxCoeff() : 0.0;
  for (int i = 0; i < n; ++i) {
    if (values[i] < -1e-9 * largest) return false;
    const double length = std::sqrt(std::max(values[i], 0.0));
    for (int j = 0; j < n; ++j) root[i + n * j] = length * vectors(j, i) * scale[j];
  }
  return true;
}

template <int Max>
void marginal(const double* nuisance, const double* wanted, int n, int count, double tolerance,
              double* information) noexcept {
  // What of the wanted columns lies at right angles to everything the nuisance parameters can explain.
  BoundedVector<Max> scale(n);
  detail::column_scale(nuisance, n, n, scale.data());
  BoundedSquare<Max> scaled = Eigen::Map<const BoundedSquare<Max>>(nuisance, n, n);
  for (int j = 0; j < n; ++j) scaled.col(j) /= scale[j];
  BoundedVector<Max> s(n);
  BoundedSquare<Max> U(n, n);
  const bool known = detail::all_finite(scaled) && detail::square_svd(scaled.data(), n, s.data(), U.data(), nullptr);
  std::fill_n(information, count * count, known ? 0.0 : std::numeric_limits<double>::quiet_NaN());
  if (!known) return;
  BoundedVector<Max> row(count);
  for (int k = 0; k < n; ++k) {
    if (s[k] > tolerance * s[0]) continue;
    for (int c = 0; c < count; ++c) {
      row[c] = 0.0;
      for (int i = 0; i < n; ++i) row[c] += U(i, k) * wanted[i + n * c];
    }
    for (int c = 0; c < count; ++c) {
      for (int r = 0; r < count; ++r) information[r + count * c] += row[r] * row[c];
    }
  }
}

}  // namespace

namespace detail {

void column_scale(const double* root, Eigen::Index rows, Eigen::Index n, double* scale) noexcept {
  double largest = 0.0;
  for (Eigen::Index j = 0; j < n; ++j) {
    scale[j] = Eigen::Map<const Eigen::VectorXd>(root + rows * j, rows).norm();
    largest = std::max(largest, scale[j]);
  }
  for (Eigen::Index j = 0; j < n; ++j) {
    if (!(scale[j] > kZeroColumn * largest)) scale[j] = largest > 0.0 ? largest : 1.0;
  }
}

int bound_of_root(const double* root, int n, double tolerance, double* information, double* covariance, double* sigma,
                  double* singular_values, double* unobservable) noexcept {
  return n <= kBounded
             ? bound<kBounded>(root, n, tolerance, information, covariance, sigma, singular_values, unobservable)
             : bound<Eigen::Dynamic>(root, n, tolerance, information, covariance, sigma, singular_values, unobservable);
}

bool information_root(const double* information, int n, double* root) noexcept {
  return n <= kBounded ? root_of_information<kBounded>(information, n, root)
                       : root_of_information<Eigen::Dynamic>(information, n, root);
}

void marginal_information(const double* nuisance, const double* wanted, int n, int count, double tolerance,
                          double* information) noexcept {
  n <= kBounded ? marginal<kBounded>(nuisance, wanted, n, count, tolerance, information)
                : marginal<Eigen::Dynamic>(nuisance, wanted, n, count, tolerance, information);
}

}  // namespace detail

Eigen::MatrixXd root_of_rows(const Eigen::Ref<const Eigen::MatrixXd>& H, const Eigen::Ref<const Eigen::MatrixXd>& R) {
  const Eigen::Index m = H.rows();
  const Eigen::Index n = H.cols();
  if (n == 0) throw std::invalid_argument("H: shape " + shape(H) + "; at least one column expected");
  if (!H.allFinite()) throw std::invalid_argument("H: it holds NaN or infinity");
  const Eigen::Index b = R.rows();
  const bool variances = R.cols() == 1 && b == m && m > 1;
  if (!variances && (R.cols() != b || (b == 0 ? m > 0 : m % b != 0))) {
    throw std::invalid_argument("R: shape " + shape(R) + "; (" + std::to_string(m) + ", " + std::to_string(m) +
                                "), a block of it that repeats, or (" + std::to_string(m) + ", 1) expected, for the " +
                                std::to_string(m) + " rows of H");
  }
  if (!R.allFinite()) throw std::invalid_argument("R: it holds NaN or infinity");
  if (m == 0) return Eigen::MatrixXd::Zero(n, n);
  Eigen::MatrixXd rows(std::max(m, n), n);
  rows.setZero();
  rows.topRows(m) = H;
  if (variances) {
    for (Eigen::Index i = 0; i < m; ++i) {
      if (!(R(i, 0) > 0.0)) {
        throw std::invalid_argument("R: variance " + std::to_string(i) + " is " + shortest(R(i, 0)) +
                                    "; it must be positive");
      }
      rows.row(i) /= std::sqrt(R(i, 0));
    }
  } else {
    const double size = R.diagonal().cwiseAbs().maxCoeff();
    if (!((R - R.transpose()).cwiseAbs().maxCoeff() <= 1e-9 * size)) {
      throw std::invalid_argument("R: it must be symmetric");
    }
    const Eigen::LLT<Eigen::MatrixXd> llt(R);
    if (llt.info() != Eigen::Success) throw std::invalid_argument("R: it must be positive definite");
    for (Eigen::Index first = 0; first < m; first += b) {
      auto block = rows.middleRows(first, b);
      llt.matrixL().solveInPlace(block);
    }
  }
  // Columns of length one while the reflections run, so that small ones keep their digits beside large ones.
  Eigen::VectorXd scale(n);
  detail::column_scale(rows.data(), rows.rows(), n, scale.data());
  rows = (rows * scale.cwiseInverse().asDiagonal()).eval();
  const Eigen::HouseholderQR<Eigen::MatrixXd> qr(rows);
  Eigen::MatrixXd root = Eigen::MatrixXd::Zero(n, n);
  root = qr.matrixQR().topRows(n).triangularView<Eigen::Upper>();
  return root * scale.asDiagonal();
}

CramerRaoBound<Eigen::Dynamic> cramer_rao_bound(const Eigen::Ref<const Eigen::MatrixXd>& H,
                                                const Eigen::Ref<const Eigen::MatrixXd>& R,
                                                const Eigen::Ref<const Eigen::MatrixXd>& prior_information,
                                                double tolerance) {
  if (!(tolerance > 0.0 && tolerance < 1.0)) {
    throw std::invalid_argument("tolerance: " + shortest(tolerance) + "; it must lie between 0 and 1");
  }
  Eigen::MatrixXd root = root_of_rows(H, R);
  if (prior_information.size() > 0) {
    const Eigen::Index n = H.cols();
    if (prior_information.rows() != n || prior_information.cols() != n) {
      throw std::invalid_argument("prior_information: shape " + shape(prior_information) + "; (" + std::to_string(n) +
                                  ", " + std::to_string(n) + ") expected, for the columns of H");
    }
    const auto prior = information_root<Eigen::Dynamic>(Eigen::MatrixXd(prior_information));
    if (!prior) {
      throw std::invalid_argument("prior_information: it must be finite, symmetric and positive semidefinite");
    }
    for (Eigen::Index i = 0; i < n; ++i) {
      Eigen::RowVectorXd h = prior->row(i);
      detail::absorb_row<Eigen::Dynamic>(root, h);
    }
  }
  return bound_of_root<Eigen::Dynamic>(root, tolerance);
}

}  // namespace soopnav
