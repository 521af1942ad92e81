#pragma once

#include <memory>
#include <span>

#include "soopnav/clock/clock_noise.hpp"
#include "soopnav/navigation/cooperative_filter.hpp"

namespace soopnav::navigation {

/// What a `ManoeuvreFilter` knows of how a target moves: nearly at rest or in a straight line, or turning and braking.
struct ManoeuvreOptions {
  clock::ClockNoise clock_noise{};             ///< of target and anchor together (their sum)
  double calm_psd_m2ps3 = 0.01;                ///< white horizontal acceleration of the calm mode, q > 0
  double manoeuvre_psd_m2ps3 = 9.0;            ///< and of the manoeuvring one, above the calm one's
  double calm_vertical_psd_m2ps3 = 1e-4;       ///< white vertical acceleration of the calm mode, >= 0
  double manoeuvre_vertical_psd_m2ps3 = 0.01;  ///< and of the manoeuvring one, >= 0
  double mean_calm_s = 20.0;                   ///< how long it stays calm on average, > 0
  double mean_manoeuvre_s = 10.0;              ///< and manoeuvring, > 0
  double calm_probability = 0.5;               ///< of being calm at the start, 0 ... 1
};

/// Engine for a target that manoeuvres: an interacting multiple model over two motions, each [p v theta alpha].
///
/// Model:   `GroundConstantVelocity` with two densities, and `clock::TwoState`; a Markov chain in continuous time goes
///          from calm to manoeuvring at the rate 1 / mean_calm_s and back at 1 / mean_manoeuvre_s, its transition over
///          a step of any length taken exactly            (doc/cooperative_motion.md eq. 1-4; Blom and Bar-Shalom 1988)
/// Smoother: `cross` is that of the mixture taken for one Gaussian: both modes have the same transition, so P F' of the
///          mixture is exact and its noise is the modes' mean (eq. 5). Modes are not weighed again by later
///          measurements.
/// No allocation after construction; about 10 us for a prediction with its update.
class ManoeuvreFilter : public CooperativeFilter {
 public:
  static constexpr int kModes = 2;
  /// Probabilities that the target is calm and that it manoeuvres; they sum to one.
  [[nodiscard]] virtual std::span<const double, kModes> probabilities() const noexcept = 0;
};

/// At p = v = theta = alpha = 0 and unit variances until `restart`. Throws std::invalid_argument naming the option, its
/// value and the rule.
[[nodiscard]] std::unique_ptr<ManoeuvreFilter> manoeuvre_filter(const ManoeuvreOptions& options);

}  // namespace soopnav::navigation
