#include "soopnav/gnss/lambda.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

namespace soopnav::gnss {

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
// A pivot below this share of its diagonal element is rounding, not variance.
constexpr double kRelativePivot = 1e-14;
constexpr double kLargest = 4503599627370496.0;  // 2^52: up to it fractions of a half and all integers are numbers

}  // namespace

std::string_view to_string(IntegerStatus status) noexcept {
  switch (status) {
    case IntegerStatus::kSolved:
      return "solved";
    case IntegerStatus::kNonFinite:
      return "not finite";
    case IntegerStatus::kNotPositiveDefinite:
      return "not positive definite";
    case IntegerStatus::kWrongSize:
      return "wrong size";
    case IntegerStatus::kSearchLimit:
      return "search limit";
    case IntegerStatus::kTooLarge:
      return "too large";
  }
  return "unknown";
}

IntegerLeastSquares::IntegerLeastSquares(int candidates, std::int64_t max_nodes)
    : wanted_(candidates), max_nodes_(max_nodes) {
  if (candidates < 1 || candidates > 10'000) {
    throw std::invalid_argument("candidates = " + std::to_string(candidates) + ": 1 ... 10 000 expected");
  }
  if (max_nodes < 1) throw std::invalid_argument("max_nodes = " + std::to_string(max_nodes) + ": at least 1 expected");
  const auto slots = static_cast<std::size_t>(candidates);
  found_.resize(slots * kMaxAmbiguities);
  norms_.resize(slots);
  order_.resize(slots);
}

std::span<const double> IntegerLeastSquares::candidate(int k) const noexcept {
  return {found_.data() + order_[static_cast<std::size_t>(k)] * kMaxAmbiguities, static_cast<std::size_t>(d_.size())};
}

double IntegerLeastSquares::ratio() const noexcept {
  if (count_ < 2) return kNan;
  return squared_norm(0) > 0.0 ? squared_norm(1) / squared_norm(0) : kInfinity;
}

double IntegerLeastSquares::success_rate() const noexcept {
  if (d_.size() == 0) return kNan;
  double rate = 1.0;
  // 2 Phi(x) - 1 = erf(x / sqrt(2)), x = 1 / (2 sigma).
  for (const double variance : d_) rate *= std::erf(1.0 / std::sqrt(8.0 * variance));
  return rate;
}

// Q = L' D L with L unit lower triangular, from the last row upwards (eq. 2). False when a pivot is not positive.
bool IntegerLeastSquares::factorise(const Eigen::Ref<const Eigen::MatrixXd>& Q) noexcept {
  const Eigen::Index n = Q.rows();
  L_ = Q;
  d_.resize(n);
  for (Eigen::Index i = n - 1; i >= 0; --i) {
    const double pivot = L_(i, i);
    if (!(pivot > kRelativePivot * Q(i, i))) return false;
    d_[i] = pivot;
    for (Eigen::Index j = 0; j < i; ++j) {
      const double factor = L_(i, j) / pivot;
      for (Eigen::Index k = 0; k <= j; ++k) L_(j, k) -= factor * L_(i, k);
    }
    for (Eigen::Index j = 0; j < i; ++j) L_(i, j) /= pivot;
    L_(i, i) = 1.0;
  }
  return true;
}

// z_j loses a whole multiple of z_i, so that |L(i, j)| <= 1/2 (eq. 3).
void IntegerLeastSquares::gauss(Eigen::Index i, Eigen::Index j) noexcept {
  const double mu = std::round(L_(i, j));
  if (mu == 0.0) return;
  const Eigen::Index n = d_.size();
  L_.col(j).tail(n - i) -= mu * L_.col(i).tail(n - i);
  Z_.col(j) -= mu * Z_.col(i);
  z_inverse_.row(i) += mu * z_inverse_.row(j);
}

// Exchanges z_j and z_j+1 (eq. 4).
void IntegerLeastSquares::swap(Eigen::Index j) noexcept {
  const Eigen::Index n = d_.size();
  const double l = L_(j + 1, j);
  const double total = d_[j] + l * l * d_[j + 1];
  const double eta = d_[j] / total;
  const double lambda = d_[j + 1] * l / total;
  d_[j] = eta * d_[j + 1];
  d_[j + 1] = total;
  for (Eigen::Index k = 0; k < j; ++k) {
    const double upper = L_(j, k);
    const double lower = L_(j + 1, k);
    L_(j, k) = lower - l * upper;
    L_(j + 1, k) = eta * upper + lambda * lower;
  }
  L_(j + 1, j) = lambda;
  L_.col(j).tail(n - j - 2).swap(L_.col(j + 1).tail(n - j - 2));
  Z_.col(j).swap(Z_.col(j + 1));
  z_inverse_.row(j).swap(z_inverse_.row(j + 1));
}

// Brings the small conditional variances to the end, where the search begins.
void IntegerLeastSquares::reduce() noexcept {
  const Eigen::Index n = d_.size();
  Z_.setIdentity(n, n);
  z_inverse_.setIdentity(n, n);
  Eigen::Index clean = n - 2;  // columns above it are reduced already
  for (Eigen::Index j = n - 2; j >= 0;) {
    if (j <= clean) {
      for (Eigen::Index i = j + 1; i < n; ++i) gauss(i, j);
    }
    const double l = L_(j + 1, j);
    // A swap must gain something that rounding cannot undo, or the loop might not end.
    if (d_[j] + l * l * d_[j + 1] < (1.0 - 1e-9) * d_[j + 1]) {
      swap(j);
      clean = j;
      j = n - 2;
    } else {
      --j;
    }
  }
}

IntegerStatus IntegerLeastSquares::decorrelate(const Eigen::Ref<const Eigen::MatrixXd>& Q) noexcept {
  count_ = 0;
  nodes_ = 0;
  d_.resize(0);
  const Eigen::Index n = Q.rows();
  if (n < 1 || n > kMaxAmbiguities || Q.cols() != n) return IntegerStatus::kWrongSize;
  for (Eigen::Index j = 0; j < n; ++j) {
    for (Eigen::Index i = j; i < n; ++i) {
      if (!std::isfinite(Q(i, j))) return IntegerStatus::kNonFinite;
    }
  }
  if (!factorise(Q)) {
    d_.resize(0);
    return IntegerStatus::kNotPositiveDefinite;
  }
  reduce();
  return IntegerStatus::kSolved;
}

// Puts a vector among the candidates, ascending; the worst leaves when they are full.
void IntegerLeastSquares::keep(const Vector& z, double norm) noexcept {
  const auto full = count_ == wanted_;
  const std::size_t slot = full ? order_[static_cast<std::size_t>(count_ - 1)] : static_cast<std::size_t>(count_);
  if (!full) ++count_;
  auto place = static_cast<std::size_t>(count_ - 1);
  while (place > 0 && norms_[order_[place - 1]] > norm) {
    order_[place] = order_[place - 1];
    --place;
  }
  order_[place] = slot;
  norms_[slot] = norm;
  std::copy(z.begin(), z.end(), found_.begin() + static_cast<std::ptrdiff_t>(slot * kMaxAmbiguities));
}

// Depth first from the last integer; at each level the nearest integer first, then to both sides in turn (eq. 5).
bool IntegerLeastSquares::search(const Vector& z_float) noexcept {
  const Eigen::Index n = d_.size();
  Vector z(n), centre(n), step(n), partial(n), residual(n);
  double radius = kInfinity;
  const auto enter = [&](Eigen::Index i) {
    double c = z_float[i];
    for (Eigen::Index j = i + 1; j < n; ++j) c -= L_(j, i) * residual[j];
    centre[i] = c;
    z[i] = std::round(c);
    step[i] = c > z[i] ? 1.0 : -1.0;
  };
  const auto next = [&](Eigen::Index i) {
    z[i] += step[i];
    step[i] = step[i] > 0.0 ? -step[i] - 1.0 : -step[i] + 1.0;
  };
  Eigen::Index i = n - 1;
  enter(i);
  while (true) {
    if (++nodes_ > max_nodes_) return false;
    residual[i] = centre[i] - z[i];
    const double above = i + 1 < n ? partial[i + 1] : 0.0;
    const double norm = above + residual[i] * residual[i] / d_[i];
    if (norm < radius) {
      if (i > 0) {
        partial[i] = norm;
        enter(--i);
        continue;
      }
      keep(z, norm);
      if (count_ == wanted_) radius = norms_[order_[static_cast<std::size_t>(wanted_ - 1)]];
      next(0);
    } else {
      if (i == n - 1) return true;
      next(++i);
    }
  }
}

IntegerStatus IntegerLeastSquares::solve(const Eigen::Ref<const Eigen::VectorXd>& a,
                                         const Eigen::Ref<const Eigen::MatrixXd>& Q) noexcept {
  count_ = 0;
  if (a.size() != Q.rows()) {
    d_.resize(0);
    return IntegerStatus::kWrongSize;
  }
  const IntegerStatus status = decorrelate(Q);
  if (status != IntegerStatus::kSolved) return status;
  if (!a.allFinite()) return IntegerStatus::kNonFinite;
  if (a.cwiseAbs().maxCoeff() > kLargest) return IntegerStatus::kTooLarge;
  const Eigen::Index n = a.size();
  // Whole cycles apart from the fractions: the transformed fractions stay small, so nothing is lost to rounding.
  Vector whole(n), fraction(n);
  for (Eigen::Index i = 0; i < n; ++i) {
    whole[i] = std::round(a[i]);
    fraction[i] = a[i] - whole[i];
  }
  Vector z_float(n);
  z_float.noalias() = Z_.transpose() * fraction;
  if (!(z_float.cwiseAbs().maxCoeff() <= kLargest)) return IntegerStatus::kTooLarge;
  const bool complete = search(z_float);
  for (int k = 0; k < count_; ++k) {
    const auto slot = static_cast<std::ptrdiff_t>(order_[static_cast<std::size_t>(k)] * kMaxAmbiguities);
    Eigen::Map<Eigen::VectorXd> z(found_.data() + slot, n);
    fraction = z;
    for (Eigen::Index i = 0; i < n; ++i) z[i] = std::round(z_inverse_.col(i).dot(fraction)) + whole[i];
    if (!(z.cwiseAbs().maxCoeff() <= 2.0 * kLargest)) {
      count_ = 0;
      return IntegerStatus::kTooLarge;
    }
  }
  return complete ? IntegerStatus::kSolved : IntegerStatus::kSearchLimit;
}

}  // namespace soopnav::gnss
