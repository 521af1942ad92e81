#include "soopnav/estimation/fisher_information.hpp"

#include <Eigen/QR>
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

}  // namespace

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
  const Eigen::VectorXd scale = detail::column_scale(rows);
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
