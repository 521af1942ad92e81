#include "soopnav/estimation/linear_filter.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "estimation/row_kernels.hpp"
#include "estimation/series_check.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/estimation/covariance_check.hpp"

namespace soopnav {

namespace {

using detail::padded;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

std::size_t product(int a, int b, int c = 1) {
  return static_cast<std::size_t>(a) * static_cast<std::size_t>(b) * static_cast<std::size_t>(c);
}

// Sizes of a run, checked.
struct Shape {
  int steps, n, m, p;
};

Shape check(const LinearSystem& s, const LinearData& data, const Eigen::Ref<const Eigen::VectorXd>& x0,
            const Eigen::Ref<const Eigen::MatrixXd>& P0) {
  Shape shape{0, s.F.rows, s.H.rows, s.B.columns};
  if (shape.n < 1) throw std::invalid_argument("F: empty");
  if (shape.m < 1) throw std::invalid_argument("H: empty");
  const auto m = static_cast<std::size_t>(shape.m);
  if (data.z.size() % m != 0) {
    throw std::invalid_argument("z: " + std::to_string(data.z.size()) + " numbers, no whole steps of " +
                                std::to_string(shape.m));
  }
  if (data.z.size() / m > static_cast<std::size_t>(std::numeric_limits<int>::max())) {
    throw std::invalid_argument("z: too many steps");
  }
  shape.steps = static_cast<int>(data.z.size() / m);
  detail::check_series(s.F, "F", shape.n, shape.n, shape.steps);
  detail::check_series(s.H, "H", shape.m, shape.n, shape.steps);
  detail::check_covariance_series(s.Q, "Q", shape.n, shape.steps, false);
  detail::check_covariance_series(s.R, "R", shape.m, shape.steps, true);
  if (x0.size() != shape.n) {
    throw std::invalid_argument("x0: " + std::to_string(x0.size()) + " numbers, expected " + std::to_string(shape.n));
  }
  if (!x0.allFinite()) throw std::invalid_argument("x0: not finite");
  if (P0.rows() != shape.n || P0.cols() != shape.n) {
    throw std::invalid_argument("P0: shape (" + std::to_string(P0.rows()) + ", " + std::to_string(P0.cols()) +
                                "), expected (" + std::to_string(shape.n) + ", " + std::to_string(shape.n) + ")");
  }
  check_covariance(P0, "P0");
  if ((shape.p == 0) != data.u.empty() && shape.steps > 0) {
    throw std::invalid_argument(shape.p == 0 ? "u: given without B" : "B: given without u");
  }
  if (shape.p > 0) {
    detail::check_series(s.B, "B", shape.n, shape.p, shape.steps);
    detail::check_table(data.u, "u", shape.steps, shape.p);
  }
  if (data.present.empty()) {
    detail::check_table(data.z, "z", shape.steps, shape.m);
  } else {
    if (data.present.size() != data.z.size()) {
      throw std::invalid_argument("mask: " + std::to_string(data.present.size()) + " flags, expected " +
                                  std::to_string(data.z.size()));
    }
    for (std::size_t i = 0; i < data.z.size(); ++i) {
      if (data.present[i] != 0 && !std::isfinite(data.z[i])) {
        throw std::invalid_argument("z: step " + std::to_string(i / m) + " is marked as present and not finite");
      }
    }
  }
  return shape;
}

LinearRun make_run(const Shape& shape) {
  LinearRun run;
  run.steps = shape.steps;
  run.n = shape.n;
  run.m = shape.m;
  const std::size_t sizes[] = {product(shape.steps, shape.n),         product(shape.steps, shape.n, shape.n),
                               product(shape.steps, shape.n),         product(shape.steps, shape.n, shape.n),
                               product(shape.steps, shape.m),         product(shape.steps, shape.m, shape.m),
                               static_cast<std::size_t>(shape.steps), static_cast<std::size_t>(shape.steps)};
  std::span<double>* const spans[] = {&run.x_pred,     &run.P_pred, &run.x,   &run.P,
                                      &run.innovation, &run.S,      &run.nis, &run.step_log_likelihood};
  std::size_t total = 0;
  for (const std::size_t size : sizes) total += size;
  run.numbers = std::make_unique_for_overwrite<double[]>(total);
  double* at = run.numbers.get();
  for (std::size_t i = 0; i < std::size(sizes); ++i) {
    *spans[i] = {at, sizes[i]};
    at += sizes[i];
  }
  const auto steps = static_cast<std::size_t>(shape.steps);
  run.status_bytes = std::make_unique_for_overwrite<StepStatus[]>(steps);
  run.status = {run.status_bytes.get(), steps};
  return run;
}

std::size_t workspace(const Shape& s) {
  const int stride = padded(s.n);
  return product(5, s.n, stride) + product(3, s.m, stride) + product(3, s.m, padded(s.m)) + product(2, 1, stride) +
         product(3, 1, padded(s.m));
}

// The state of a run and what a step needs, padded (row_kernels.hpp).
class Worker {
 public:
  Worker(const LinearSystem& system, const LinearData& data, const Shape& shape)
      : system_(system),
        data_(data),
        n_(shape.n),
        m_(shape.m),
        p_(shape.p),
        stride_(padded(shape.n)),
        m_stride_(padded(shape.m)),
        F_(shape.n, shape.n),
        H_(shape.m, shape.n),
        present_rows_(static_cast<std::size_t>(shape.m)),
        H_present_(static_cast<std::size_t>(shape.m) * static_cast<std::size_t>(shape.n)),
        arena_(workspace(shape)) {
    for (double** square : {&P_, &P_pred_, &FP_, &PFt_, &half_}) *square = arena_.take(n_, stride_);
    for (double** wide : {&HP_, &Kt_, &G_}) *wide = arena_.take(m_, stride_);
    S_ = arena_.take(m_, m_stride_);
    U_ = arena_.take(m_, m_stride_);
    DU_ = arena_.take(m_, m_stride_);
    x_ = arena_.take(1, stride_);
    x_pred_ = arena_.take(1, stride_);
    for (double** row : {&d_, &inverse_d_, &nu_}) *row = arena_.take(1, m_stride_);
  }

  void start(const Eigen::Ref<const Eigen::VectorXd>& x0, const Eigen::Ref<const Eigen::MatrixXd>& P0) {
    for (int i = 0; i < n_; ++i) {
      x_[i] = x0[i];
      for (int j = 0; j < n_; ++j) P_[i * stride_ + j] = 0.5 * (P0(i, j) + P0(j, i));
    }
  }

  void step(int k, LinearRun& run) {
    const auto step = static_cast<std::size_t>(k);
    const auto n = static_cast<std::size_t>(n_);
    StepStatus status = predict(k) ? StepStatus::kUpdated : StepStatus::kNonFinite;
    std::memcpy(run.x_pred.data() + step * n, x_pred_, n * sizeof(double));
    detail::store_rows(P_pred_, n_, n_, stride_, run.P_pred.data() + step * n * n);
    double log_likelihood = kNan;
    double nis = kNan;
    if (status == StepStatus::kUpdated) {
      select_present(k);
      innovate(k, run);
      if (rows_ == 0) {
        status = StepStatus::kNoObservation;
        log_likelihood = 0.0;
      } else {
        status = update(k, nis, log_likelihood);
      }
    } else {
      std::fill_n(run.innovation.data() + step * static_cast<std::size_t>(m_), m_, kNan);
      std::fill_n(run.S.data() + step * product(m_, m_), m_ * m_, kNan);
    }
    if (status != StepStatus::kUpdated) {
      std::swap(P_, P_pred_);
      std::swap(x_, x_pred_);
    }
    std::memcpy(run.x.data() + step * n, x_, n * sizeof(double));
    detail::store_rows(P_, n_, n_, stride_, run.P.data() + step * n * n);
    run.nis[step] = nis;
    run.step_log_likelihood[step] = log_likelihood;
    run.log_likelihood += log_likelihood;
    run.status[step] = status;
  }

 private:
  // Eqs. 3 and 4. False, with the last state as prediction, where a number overflows.
  bool predict(int k) {
    if (k == 0 || system_.F.count > 1) F_.assign(system_.F.at(k), n_, n_);
    std::fill_n(x_pred_, stride_, 0.0);
    for (int i = 0; i < n_; ++i) x_pred_[i] = F_.dot(i, x_);
    if (p_ > 0) {
      const double* const B = system_.B.at(k);
      const double* const u = data_.u.data() + product(k, p_);
      for (int i = 0; i < n_; ++i) {
        for (int j = 0; j < p_; ++j) x_pred_[i] += B[i * p_ + j] * u[j];
      }
    }
    // F (F P)ᵀ + Q: P is symmetric to the bit, so that (F P)ᵀ is P Fᵀ.
    detail::multiply(F_, P_, n_, stride_, false, FP_);
    detail::transpose(FP_, n_, stride_, PFt_);
    detail::multiply(F_, PFt_, n_, stride_, true, P_pred_);
    const double* const Q = system_.Q.at(k);
    for (int i = 0; i < n_; ++i) {
      for (int j = i; j < n_; ++j) P_pred_[i * stride_ + j] += Q[i * n_ + j];
    }
    detail::mirror(P_pred_, n_, stride_);
    if (detail::all_finite(P_pred_, n_, stride_) && detail::all_finite(x_pred_, 1, stride_)) return true;
    std::memcpy(P_pred_, P_, product(n_, stride_) * sizeof(double));
    std::memcpy(x_pred_, x_, static_cast<std::size_t>(stride_) * sizeof(double));
    return false;
  }

  // The rows of this step that were observed, and H without the others.
  void select_present(int k) {
    const bool all_before = rows_ == m_;
    rows_ = 0;
    const std::uint8_t* const present = data_.present.empty() ? nullptr : data_.present.data() + product(k, m_);
    for (int i = 0; i < m_; ++i) {
      if (present == nullptr || present[i] != 0) present_rows_[static_cast<std::size_t>(rows_++)] = i;
    }
    const double* const H = system_.H.at(k);
    if (rows_ == m_) {
      if (!all_before || system_.H.count > 1) H_.assign(H, m_, n_);
      return;
    }
    const auto n = static_cast<std::size_t>(n_);
    for (int a = 0; a < rows_; ++a) {
      const auto from = static_cast<std::size_t>(present_rows_[static_cast<std::size_t>(a)]) * n;
      std::memcpy(H_present_.data() + static_cast<std::size_t>(a) * n, H + from, n * sizeof(double));
    }
    H_.assign(H_present_.data(), rows_, n_);
  }

  // Innovation, H P and S = H P Hᵀ + R (eqs. 5, 6), into the run as well.
  void innovate(int k, LinearRun& run) {
    double* const innovation = run.innovation.data() + product(k, m_);
    double* const S = run.S.data() + product(k, m_, m_);
    if (rows_ < m_) {
      std::fill_n(innovation, m_, kNan);
      std::fill_n(S, m_ * m_, kNan);
    }
    std::fill_n(nu_, m_stride_, 0.0);
    std::fill_n(S_, rows_ * m_stride_, 0.0);
    detail::multiply(H_, P_pred_, rows_, stride_, false, HP_);
    const double* const R = system_.R.at(k);
    const double* const z = data_.z.data() + product(k, m_);
    for (int a = 0; a < rows_; ++a) {
      const int row = present_rows_[static_cast<std::size_t>(a)];
      nu_[a] = z[row] - H_.dot(a, x_pred_);
      innovation[row] = nu_[a];
      for (int b = a; b < rows_; ++b) {
        const int column = present_rows_[static_cast<std::size_t>(b)];
        const double s = H_.dot(b, HP_ + a * stride_) + 0.5 * (R[row * m_ + column] + R[column * m_ + row]);
        S_[a * m_stride_ + b] = s;
        S_[b * m_stride_ + a] = s;
        S[row * m_ + column] = s;
        S[column * m_ + row] = s;
      }
    }
  }

  // The gain (eq. 8), the state (9), and the covariance in the rank form of Joseph's update (13 to 15).
  StepStatus update(int k, double& nis, double& log_likelihood) {
    if (!detail::all_finite(S_, rows_, m_stride_) || !detail::all_finite(nu_, 1, m_stride_)) {
      return StepStatus::kNonFinite;
    }
    std::memcpy(Kt_, HP_, product(rows_, stride_) * sizeof(double));
    if (!detail::factorize(S_, rows_, m_stride_, 0.0, DU_, U_, d_, inverse_d_, Kt_, stride_)) {
      return StepStatus::kNotPositiveDefinite;
    }
    detail::solve_upper(U_, inverse_d_, rows_, m_stride_, Kt_, stride_);
    detail::combine_rows(x_pred_, nu_, Kt_, rows_, stride_, x_);
    // Transposed throughout, so that all sums run along rows: first (P - K (P Hᵀ)ᵀ)ᵀ, then its product with Hᵀ less K
    // R.
    detail::subtract_product(P_pred_, HP_, Kt_, rows_, n_, stride_, half_);
    detail::multiply(H_, half_, rows_, stride_, false, G_);
    const double* const R = system_.R.at(k);
    for (int a = 0; a < rows_; ++a) {
      const int row = present_rows_[static_cast<std::size_t>(a)];
      for (int b = 0; b < rows_; ++b) {
        const double r = R[row * m_ + present_rows_[static_cast<std::size_t>(b)]];
        if (r == 0.0) continue;
        for (int i = 0; i < n_; ++i) G_[a * stride_ + i] -= r * Kt_[b * stride_ + i];
      }
    }
    detail::subtract_product(half_, Kt_, G_, rows_, n_, stride_, P_);
    detail::symmetrize(P_, n_, stride_);
    if (!detail::all_finite(P_, n_, stride_) || !detail::all_finite(x_, 1, stride_)) return StepStatus::kNonFinite;
    whiten(nis, log_likelihood);
    return StepStatus::kUpdated;
  }

  // NIS and log-likelihood (eqs. 16, 17) from S = Uᵀ D U.
  void whiten(double& nis, double& log_likelihood) {
    nis = 0.0;
    double log_determinant = 0.0;
    for (int a = 0; a < rows_; ++a) {
      for (int b = 0; b < a; ++b) nu_[a] -= U_[b * m_stride_ + a] * nu_[b];
      nis += nu_[a] * nu_[a] * inverse_d_[a];
      log_determinant += std::log(d_[a]);
    }
    log_likelihood = -0.5 * (nis + log_determinant + rows_ * std::log(kTwoPi));
  }

  const LinearSystem& system_;
  const LinearData& data_;
  int n_, m_, p_, stride_, m_stride_;
  int rows_ = -1;  // observed in this step
  detail::SparseRows F_, H_;
  std::vector<int> present_rows_;
  std::vector<double> H_present_;
  detail::RowArena arena_;
  double *P_, *P_pred_, *FP_, *PFt_, *half_, *HP_, *Kt_, *G_, *S_, *U_, *DU_, *x_, *x_pred_, *d_, *inverse_d_, *nu_;
};

}  // namespace

LinearRun linear_filter(const LinearSystem& system, const LinearData& data, const Eigen::Ref<const Eigen::VectorXd>& x0,
                        const Eigen::Ref<const Eigen::MatrixXd>& P0) {
  const Shape shape = check(system, data, x0, P0);
  LinearRun run = make_run(shape);
  Worker worker(system, data, shape);
  worker.start(x0, P0);
  for (int k = 0; k < shape.steps; ++k) worker.step(k, run);
  return run;
}

}  // namespace soopnav
