#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "soopnav/clock/clock_noise.hpp"
#include "soopnav/clock/clock_simulator.hpp"
#include "soopnav/core/iq.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/geometry/sampled_orbit.hpp"

namespace soopnav::simulation {

/// One of a receiver's front ends.
struct OpportunityBand {
  double carrier_hz = 1575.42e6;
  double sample_rate_hz = 2.048e6;
  double intermediate_hz = 0.0;  ///< where `carrier_hz` lies in the samples
};

/// A transmitter of a spread signal: a satellite or a base station.
///
/// Its code runs by its own clock and begins anew at whole multiples of its period of that clock's time: GPS at every
/// millisecond, a cdma2000 pilot at every even second.
struct OpportunitySource {
  std::size_t band = 0;             ///< in which it is heard, on that band's carrier
  std::vector<Cf32> chips{};        ///< one code period of unit power, rectangular chips
  double chip_rate_hz = 0.0;        ///< > 0
  std::vector<std::int8_t> bits{};  ///< +1 or -1, repeated, `symbol_s` each from clock time 0 on; empty: none
  double symbol_s = 0.0;            ///< with bits: a whole number of code periods
  geometry::SampledOrbit orbit = geometry::SampledOrbit::fixed(Eigen::Vector3d(7e6, 0.0, 0.0));  ///< in system time
  clock::ClockNoise clock{};
  clock::ClockState clock_start{};  ///< at the start: bias positive when its clock is ahead
  double cn0_dbhz = 45.0;           ///< carrier to noise density at the receiver

  /// Code and rate of L1 C/A, 20 ms bits; throws as `gps::ca_code`.
  [[nodiscard]] static OpportunitySource gps(int prn);
};

struct OpportunityLinkOptions {
  Eigen::Vector3d position_e = Eigen::Vector3d::Zero();  ///< of the antenna at the start, ECEF [m]
  Eigen::Vector3d velocity_e = Eigen::Vector3d::Zero();  ///< constant [m/s]
  double start_s = 0.0;             ///< what the receiver's clock reads at its first sample, in system time's seconds
  double duration_s = 1.0;          ///< of the samples that can be made
  double step_s = 1e-3;             ///< between nodes: clocks and ranges run on straight lines from one to the next
  clock::ClockNoise clock{};        ///< of the receiver's one oscillator
  clock::ClockState clock_start{};  ///< bias positive when it is ahead
  std::vector<double> clock_bias_s{};  ///< instead of noise: its bias at every node
};

/// Samples of every band of a receiver with one oscillator, which drives the mixers and the converters (tight coupling,
/// pesyna section II-A).
///
/// The receiver's reading is t_R, system time t = t_R - δt(t). What it hears of source s at t_R left by
///     Δ(t_R) = τ + δt - δt_s                                              (doc/gps_acquisition.md eq. 13)
/// before, by the source's own clock: τ the light time with the Earth's turn in it (`geometry::signal_path`), δt_s the
/// source's clock as what arrives left it. A carrier f, mixed by f - f_if of the receiver's own time, becomes
///     A c(t_R - Δ) d(t_R - Δ) exp(j 2 pi (f_if t_R - f Δ)),
/// so that a receiver clock that is ahead delays codes and lowers carriers of all bands alike, phases growing with
/// range. A = sqrt(10^(C/N0 / 10) / f_s) beside complex noise of variance 1 a sample. Chips are rectangular.
///
/// Everything is a function of seed and sample number: blocks of any sizes have the same bits, and bands may be read in
/// any order.
class OpportunityLink {
 public:
  /// Draws all clocks and solves all ranges. Throws std::invalid_argument naming the field that breaks its rule, also
  /// when an orbit's samples do not cover the time, or a clock, drawn or given, moves a delay by half a node step or
  /// more from one node to the next. Allocates 16 bytes for each source and node.
  OpportunityLink(std::vector<OpportunityBand> bands, std::vector<OpportunitySource> sources,
                  const OpportunityLinkOptions& options, const RandomStream& random);

  [[nodiscard]] std::span<const OpportunityBand> bands() const noexcept { return bands_; }
  [[nodiscard]] std::span<const OpportunitySource> sources() const noexcept { return sources_; }
  [[nodiscard]] const OpportunityLinkOptions& options() const noexcept { return options_; }
  [[nodiscard]] std::uint64_t samples(std::size_t band) const noexcept;  ///< that can be made; 0 for no band

  /// Samples `first` ... of a band, noise included, overwriting `out`. False, `out` untouched, for a band that is not
  /// there or samples beyond the last. No allocation; some 5 ns a sample for each source and 5 ns for the noise.
  [[nodiscard]] bool render(std::size_t band, std::uint64_t first, std::span<Cf32> out) const noexcept;
  /// The same without noise.
  [[nodiscard]] bool render_clean(std::size_t band, std::uint64_t first, std::span<Cf32> out) const noexcept;

  [[nodiscard]] std::size_t nodes() const noexcept { return receiver_.size(); }  ///< at receiver times i step_s
  [[nodiscard]] std::span<const double> receiver_bias_s() const noexcept { return receiver_; }
  [[nodiscard]] std::span<const double> delay_s(std::size_t source) const;        ///< Δ at the nodes
  [[nodiscard]] std::span<const double> source_bias_s(std::size_t source) const;  ///< δt_s at the nodes

 private:
  void check_slopes(std::size_t k) const;

  std::vector<OpportunityBand> bands_;
  std::vector<OpportunitySource> sources_;
  OpportunityLinkOptions options_;
  RandomStream random_;
  std::vector<double> receiver_;
  std::vector<std::vector<double>> delay_;
  std::vector<std::vector<double>> source_;
};

}  // namespace soopnav::simulation
