#include "soopnav/core/observation.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

namespace soopnav {

bool Observation::append(double value, double sigma, SourceId source) noexcept {
  const double variance = sigma * sigma;
  if (!std::isfinite(value) || !std::isfinite(variance) || !(sigma > 0.0) || !(variance > 0.0)) return false;
  if (reference_ || !sources_.push_back(source)) return false;
  const Eigen::Index n = values_.size();
  values_.conservativeResize(n + 1);
  values_[n] = value;
  covariance_.conservativeResize(n + 1, n + 1);
  covariance_.row(n).setZero();
  covariance_.col(n).setZero();
  covariance_(n, n) = variance;
  return true;
}

UpdateStatus Observation::assign(const Eigen::Ref<const Eigen::VectorXd>& values,
                                 const Eigen::Ref<const Eigen::MatrixXd>& covariance, std::span<const SourceId> sources,
                                 std::optional<SourceId> reference) noexcept {
  const Eigen::Index n = values.size();
  if (n < 1 || n > kCapacity || covariance.rows() != n || covariance.cols() != n ||
      sources.size() != static_cast<std::size_t>(n)) {
    return UpdateStatus::kUndefined;
  }
  if (!values.allFinite() || !covariance.allFinite()) return UpdateStatus::kNonFinite;
  for (Eigen::Index i = 0; i < n; ++i) {
    for (Eigen::Index j = 0; j < i; ++j) {
      const double scale = std::sqrt(std::abs(covariance(i, i)) * std::abs(covariance(j, j)));
      if (!(std::abs(covariance(i, j) - covariance(j, i)) <= 1e-9 * scale)) return UpdateStatus::kNotPositiveDefinite;
    }
  }
  const Covariance symmetric = 0.5 * (covariance + covariance.transpose());
  if (Eigen::LLT<Covariance>(symmetric).info() != Eigen::Success) return UpdateStatus::kNotPositiveDefinite;
  values_ = values;
  covariance_ = symmetric;
  sources_.clear();
  for (const SourceId source : sources) {
    if (!sources_.push_back(source)) return UpdateStatus::kUndefined;
  }
  reference_ = reference;
  return UpdateStatus::kAccepted;
}

std::optional<Observation> Observation::minus_reference(SourceId reference) const noexcept {
  const SourceId* const found = std::find(sources_.begin(), sources_.end(), reference);
  if (reference_ || found == sources_.end() || size() < 2) return std::nullopt;
  const Eigen::Index r = found - sources_.begin();
  const Eigen::Index n = values_.size() - 1;
  Observation differences(epoch_);
  differences.values_.resize(n);
  differences.covariance_.resize(n, n);
  differences.reference_ = reference;
  const auto skip = [r](Eigen::Index i) { return i < r ? i : i + 1; };
  for (Eigen::Index i = 0; i < n; ++i) {
    const Eigen::Index a = skip(i);
    differences.values_[i] = values_[a] - values_[r];
    if (!differences.sources_.push_back(sources_[static_cast<std::size_t>(a)])) return std::nullopt;
    for (Eigen::Index j = 0; j < n; ++j) {
      const Eigen::Index b = skip(j);
      differences.covariance_(i, j) = covariance_(a, b) - covariance_(a, r) - covariance_(r, b) + covariance_(r, r);
    }
  }
  return differences;
}

double Observation::sigma(int i) const noexcept { return std::sqrt(covariance_(i, i)); }

}  // namespace soopnav
