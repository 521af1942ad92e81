#include "soopnav/estimation/observability.hpp"

#include <stdexcept>
#include <string>

namespace soopnav {

Eigen::MatrixXd observability_matrix(const Eigen::Ref<const Eigen::MatrixXd>& F,
                                     const Eigen::Ref<const Eigen::MatrixXd>& H, Eigen::Index rows,
                                     Eigen::Index steps) {
  const Eigen::Index n = H.cols();
  if (n == 0) throw std::invalid_argument("H: no columns; at least one expected");
  if (steps < 1) throw std::invalid_argument("steps: " + std::to_string(steps) + "; it must be at least 1");
  if (rows < 1) throw std::invalid_argument("rows: " + std::to_string(rows) + "; it must be at least 1");
  if (H.rows() != rows && H.rows() != steps * rows) {
    throw std::invalid_argument("H: " + std::to_string(H.rows()) + " rows; " + std::to_string(rows) + " or " +
                                std::to_string(steps * rows) + " expected");
  }
  if (F.cols() != n || (F.rows() != n && (F.rows() % n != 0 || F.rows() < (steps - 1) * n))) {
    throw std::invalid_argument("F: " + std::to_string(F.rows()) + " x " + std::to_string(F.cols()) + "; one matrix (" +
                                std::to_string(n) + ", " + std::to_string(n) + ") or one for each of the " +
                                std::to_string(steps - 1) + " steps between " + std::to_string(steps) +
                                " times expected");
  }
  if (!F.allFinite()) throw std::invalid_argument("F: it holds NaN or infinity");
  if (!H.allFinite()) throw std::invalid_argument("H: it holds NaN or infinity");
  const bool one_f = F.rows() == n;
  const bool one_h = H.rows() == rows;
  Eigen::MatrixXd stack(steps * rows, n);
  Eigen::MatrixXd since_start = Eigen::MatrixXd::Identity(n, n);
  for (Eigen::Index k = 0; k < steps; ++k) {
    stack.middleRows(k * rows, rows).noalias() = H.middleRows(one_h ? 0 : k * rows, rows) * since_start;
    if (k + 1 < steps) since_start = (F.middleRows(one_f ? 0 : k * n, n) * since_start).eval();
  }
  if (!stack.allFinite()) throw std::invalid_argument("F: its products grow beyond what a number can hold");
  return stack;
}

}  // namespace soopnav
