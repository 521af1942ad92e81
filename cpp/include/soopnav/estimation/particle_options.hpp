#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <string_view>
#include <vector>

#include "soopnav/core/status.hpp"
#include "soopnav/estimation/resampling.hpp"

namespace soopnav {

/// A number of particles that follows the spread of the cloud (doc/particle_filter.md eq. 17; Fox 2003).
struct AdaptiveCount {
  /// Size of a bin along each stored number of the state, in its unit; 0 for a number that does not count. Empty: the
  /// count stays what it is.
  std::vector<double> bin_sizes{};
  std::size_t least = 50;     ///< particles there always are, 1 ... count
  double divergence = 0.05;   ///< the Kullback-Leibler divergence, over the bins, that is to be kept [nat] ...
  double probability = 0.99;  ///< ... with this probability, above 0.5
};

/// How a particle filter is built.
struct ParticleOptions {
  std::size_t count = 1000;  ///< particles, 1 ... 2^31 - 1; with `adaptive` the most there can be, and the first
  std::uint64_t seed = 0;    ///< names the run: the same seed gives the same bits
  int threads = 1;           ///< 1 ... 256, the caller's included; does not change a bit of the result
  Resampling resampling = Resampling::kSystematic;
  /// Resampled before a prediction when the effective sample size is below this share of the count, in 0 ... 1:
  /// 1 resamples every time, 0 never.
  double ess_threshold = 0.5;
  /// Whether a step looks at its observations before it resamples (eq. 12; Pitt and Shephard 1999). Such a step always
  /// resamples. For observations much sharper than the cloud, and process noise no wider than the observation: where a
  /// particle is expected must tell what it will be worth.
  bool auxiliary = false;
  /// Width of the kernel that copies are spread with after resampling (eq. 15), in units of the one that is best for a
  /// normal density; 0 for none. For process noise too small to part the copies.
  double regularisation = 0.0;
  AdaptiveCount adaptive{};  ///< not together with `auxiliary`
  /// Runs the loops compiled for the oldest processor also on newer ones. For tests: the bits are the same.
  bool portable_kernels = false;
};

/// What became of a call to a particle filter.
enum class ParticleStatus : std::uint8_t {
  kAccepted,
  kDegenerate,           ///< no particle explains the observation: the weights are those from before it
  kNonFinite,            ///< NaN or infinity in z, R or an option of the observation: nothing changed
  kNotPositiveDefinite,  ///< R is not symmetric and positive definite, or of the wrong size: nothing changed
  kTooManyRows,          ///< correlated rows beyond what is held without heap: nothing changed
  kTimeNotAdvancing,     ///< the time step is not a positive finite number: nothing changed
};

/// "accepted", "degenerate", "not finite", ...; "unknown" for a value that is no enumerator.
[[nodiscard]] constexpr std::string_view to_string(ParticleStatus status) noexcept {
  switch (status) {
    case ParticleStatus::kAccepted:
      return "accepted";
    case ParticleStatus::kDegenerate:
      return "degenerate";
    case ParticleStatus::kNonFinite:
      return "not finite";
    case ParticleStatus::kNotPositiveDefinite:
      return "not positive definite";
    case ParticleStatus::kTooManyRows:
      return "too many rows";
    case ParticleStatus::kTimeNotAdvancing:
      return "time not advancing";
  }
  return "unknown";
}

/// What a prediction, update or step reports.
struct ParticleReport {
  ParticleStatus status = ParticleStatus::kAccepted;
  /// Estimate of ln p(z_k | z_1 ... z_k-1) (doc/particle_filter.md eq. 5); 0 for a prediction, -infinity when
  /// degenerate, NaN when refused.
  double log_likelihood = 0.0;
  double ess = 0.0;        ///< effective sample size (eq. 4) after the call, 1 ... count
  bool resampled = false;  ///< whether the call began by resampling
  [[nodiscard]] bool accepted() const noexcept { return status == ParticleStatus::kAccepted; }
};

namespace detail {

/// Throws std::invalid_argument naming the option, its value and the rule.
void check_particle_options(const ParticleOptions& options);

[[nodiscard]] constexpr ParticleStatus particle_status(UpdateStatus status) noexcept {
  switch (status) {
    case UpdateStatus::kAccepted:
      return ParticleStatus::kAccepted;
    case UpdateStatus::kNotPositiveDefinite:
      return ParticleStatus::kNotPositiveDefinite;
    case UpdateStatus::kTooManyRows:
      return ParticleStatus::kTooManyRows;
    default:
      return ParticleStatus::kNonFinite;
  }
}

}  // namespace detail
}  // namespace soopnav
