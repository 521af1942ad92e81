#pragma once

#include <Eigen/Core>
#include <compare>
#include <cstdint>
#include <optional>
#include <span>

#include "soopnav/core/epoch.hpp"
#include "soopnav/core/static_vector.hpp"
#include "soopnav/core/status.hpp"

namespace soopnav {

/// What an observation is of: a cell, a satellite, a beacon. The number is the user's (an LTE cell id, a PRN, ...).
struct SourceId {
  std::uint32_t value = 0;
  friend constexpr auto operator<=>(const SourceId&, const SourceId&) = default;
};

/// Values observed at one epoch, with their covariance and where each came from.
///
/// One kind of quantity in one unit; the producer's documentation says which (times of arrival [s], ranges [m], ...).
/// Independent values have a diagonal covariance; values that share a reference have a full one (`minus_reference`).
/// At most `kCapacity` values. A plain value: no heap, nothing throws.
class Observation {
 public:
  static constexpr int kCapacity = 16;

  using Values = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kCapacity, 1>;
  using Covariance = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kCapacity, kCapacity>;
  using Sources = StaticVector<SourceId, static_cast<std::size_t>(kCapacity)>;

  Observation() noexcept = default;
  explicit Observation(const Epoch& epoch) noexcept : epoch_(epoch) {}

  /// Adds a value that is independent of those before, with its standard deviation, in the unit of the values.
  /// False, and nothing changed, when the observation is full, is relative to a reference, or a number is not finite or
  /// `sigma` is not positive.
  [[nodiscard]] bool append(double value, double sigma, SourceId source) noexcept;

  /// Replaces everything by `values`, their full covariance and sources; `reference` when each value is "source minus
  /// reference". Returns `kAccepted`, or changes nothing and returns `kNonFinite`, `kNotPositiveDefinite` (also when
  /// not symmetric to 1e-9 of its diagonal) or `kUndefined` (sizes that differ, none, or more than the capacity).
  [[nodiscard]] UpdateStatus assign(const Eigen::Ref<const Eigen::VectorXd>& values,
                                    const Eigen::Ref<const Eigen::MatrixXd>& covariance,
                                    std::span<const SourceId> sources,
                                    std::optional<SourceId> reference = std::nullopt) noexcept;

  /// The differences "value i minus the value of `reference`", one fewer than here and in the same order, with
  /// covariance D R D'. None when `reference` is not among the sources or is the only one, or when these are
  /// differences already. With independent values the covariance is diag(sigma_i^2) + sigma_ref^2 in every element.
  [[nodiscard]] std::optional<Observation> minus_reference(SourceId reference) const noexcept;

  [[nodiscard]] const Epoch& epoch() const noexcept { return epoch_; }
  [[nodiscard]] int size() const noexcept { return static_cast<int>(values_.size()); }
  [[nodiscard]] const Values& values() const noexcept { return values_; }  ///< size() values
  [[nodiscard]] const Covariance& covariance() const noexcept {
    return covariance_;
  }                                                                           ///< size() x size(), unit squared
  [[nodiscard]] const Sources& sources() const noexcept { return sources_; }  ///< one per value
  /// The source subtracted from every value; none when the values are absolute.
  [[nodiscard]] std::optional<SourceId> reference() const noexcept { return reference_; }
  /// Standard deviation of value `i`, 0 <= i < size().
  [[nodiscard]] double sigma(int i) const noexcept;

 private:
  Values values_;
  Covariance covariance_;
  Sources sources_;
  std::optional<SourceId> reference_;
  Epoch epoch_;
};

}  // namespace soopnav
