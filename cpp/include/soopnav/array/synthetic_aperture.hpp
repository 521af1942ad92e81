#pragma once

#include <Eigen/Core>
#include <complex>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string_view>

namespace soopnav::array {

/// Most nodes, modes of the path's error and snapshots of one aperture.
inline constexpr std::size_t kMaxApertureNodes = 16;
inline constexpr std::size_t kMaxApertureModes = 16;
inline constexpr std::size_t kMaxApertureSnapshots = 4096;

/// What an aperture's data allowed. Bearings are there with kOk and kTwoAnswers only.
enum class ApertureStatus : std::uint8_t {
  kOk,
  kTwoAnswers,       ///< a second set of bearings fits as well (a straight path: its mirror image); both are reported
  kSingular,         ///< the path's shape does not determine the bearings
  kTooFewNodes,      ///< fewer than three nodes and a receiver phase that is free; fewer than five to go blind
  kTooFewCoherent,   ///< too few of the nodes' links are coherent along the path
  kTooFewSnapshots,  ///< fewer than eight
  kStepTooLong,      ///< a step of the path exceeds half a wavelength
  kPathTooShort,     ///< the path spans less than a quarter of a wavelength
  kNonFinite,        ///< NaN or infinity, times that do not rise
  kNoPower,          ///< a node's phasors are all zero
  kNoConvergence,
};

/// A lower-case phrase for reports.
[[nodiscard]] std::string_view to_string(ApertureStatus status) noexcept;

/// The receiver's phase common to all nodes.
enum class ReceiverPhase : std::uint8_t {
  kFree,        ///< unknown at every snapshot: any oscillator, three nodes at least
  kRandomWalk,  ///< with independent normal increments, phase_sigma_rad_per_sqrt_s; more than 0.6 rad per step is kFree
  kKnown,       ///< constant: an oscillator of 1e-11 and better, or a phase that has been removed
};

struct ApertureOptions {
  ReceiverPhase phase = ReceiverPhase::kFree;
  double phase_sigma_rad_per_sqrt_s = 0.0;  ///< of the random walk
  bool frequency_offsets = true;  ///< a constant one per node; with a free receiver phase relative to the first
  double max_frequency_hz = 0.0;  ///< of the search; 0: all that even snapshots tell apart, twice that at most
  double path_sigma_m_per_sqrt_step = 0.0;  ///< random walk of the path's error, per axis; 0: the path is exact
  double noise_variance = 0.0;              ///< of every phasor, E|noise|^2; 0: one for all nodes, from the residuals
  double coherence_threshold = 0.7;         ///< links below count as not line of sight and are left out; 0: none are
  double max_sigma_rad = 0.6;               ///< bearings less certain than this count as undetermined: kSingular
};

/// One aperture's data. Everything is finite, or the estimate says kNonFinite.
///
/// Model: y_ki = A_i exp(j (psi_k + phi_i + w_i t_k + 2 pi / lambda_i u(theta_i) . p_k)) + noise, u = [cos, sin]
/// (doc/synthetic_aperture.md eq. 1): moving towards a node advances its phase, as in this module's steering vectors.
/// Frames: path and bearings in one planar right-handed frame, the handset's when the camera gives the path.
struct ApertureData {
  std::span<const std::complex<double>> phasors;  ///< n x L, a row per snapshot
  std::span<const double> path_m;                 ///< n x 2
  std::span<const double> time_s;                 ///< n, rising
  std::span<const double> wavelength_m;           ///< L
  /// Errors of the path that unit normals scale, m x n x 2 [m]: of an IMU's speed, of its accelerometers, of a scale.
  /// A constant velocity is told from no frequency offsets, and needs no mode when those are free.
  std::span<const double> path_modes_m = {};
};

/// What the links of one aperture said. Views into the estimator, valid until its next call; all of L nodes.
struct ApertureBearings {
  ApertureStatus status = ApertureStatus::kNoPower;
  int index = -1;  ///< node or snapshot at fault
  bool straight = false;
  std::span<const double> bearing_rad;      ///< [-pi, pi); NaN for links left out
  std::span<const double> alternative_rad;  ///< the other answer of kTwoAnswers; NaN where there is none
  std::span<const double> covariance_rad2;  ///< L x L, the bound at the estimate; NaN likewise
  std::span<const double> frequency_hz;     ///< relative to the first link in use when the receiver's phase is free
  std::span<const double> amplitude;        ///< of the coherent part
  std::span<const double> coherence;        ///< 0 .. 1, the receiver's phase taken from the other links
  std::span<const std::uint8_t> los;        ///< coherence reaches the threshold
  std::span<const double> phase_rad;        ///< n, the receiver's, psi_k
  double noise_variance = 0.0;              ///< as given or as found
  double gap = 0.0;                         ///< log likelihood of the answer over the alternative's
  int iterations = 0;
};

/// What phases alone say when the path is unknown too. Views likewise.
struct BlindAperture {
  ApertureStatus status = ApertureStatus::kNoPower;
  int index = -1;
  std::span<const double> bearing_rad;      ///< relative to the first node's, which is 0; the whole may be mirrored
  std::span<const double> covariance_rad2;  ///< L x L, row and column of the first are 0
  std::span<const double> path_m;           ///< n x 2 in the frame of the first node's direction, from its first point
  double noise_variance = 0.0;
  int iterations = 0;
};

/// Bearings of radio nodes from the phase of their signals along a path that a camera or an IMU measured: a synthetic
/// array (nielsen section 3.3.1 and its phase II; doc/synthetic_aperture.md).
///
/// Maximum likelihood of all nodes at once. A crude oscillator's phase is a free number at every snapshot, which the
/// nodes share and which is eliminated in closed form; each node has a constant frequency offset. Pairs of nodes are
/// searched over both bearings and the offset's difference, the best starts are followed by Gauss-Newton steps whose
/// normal equations keep per-node parameters after snapshots are eliminated one after the other (phase and path error
/// as a random walk, eq. 5). Links that do not cohere are left out as long as three stay.
///
/// One object serves one thread at a time. It allocates in the constructor and where a call is larger than all before
/// it. 50 snapshots of 4 nodes: 6 ms with a search over all frequencies, growing as n^2.
class SyntheticAperture {
 public:
  /// @throws std::invalid_argument for sigmas, variances, frequencies that are negative or not finite, a threshold
  ///         outside [0, 1), a largest sigma outside (0, pi].
  explicit SyntheticAperture(const ApertureOptions& options = {});
  ~SyntheticAperture();
  SyntheticAperture(SyntheticAperture&&) noexcept;
  SyntheticAperture& operator=(SyntheticAperture&&) noexcept;

  /// @throws std::invalid_argument for spans whose sizes do not fit or exceed the most.
  [[nodiscard]] ApertureBearings estimate(const ApertureData& data);

  /// Angles between five or more nodes without a path (path_m is not read): phases of small steps are unwrapped,
  /// centred over nodes and factorised as points seen by a moving camera are; the circle that directions lie on fixes
  /// the affine freedom (eq. 9), and maximum likelihood over bearings and path polishes. Never absolute, and the mirror
  /// image fits as well. A step may turn the phase between two nodes by less than half a turn, noise included.
  /// No link is left out: one whose coherence with the answer is below the threshold (noise alone, a link that fades)
  /// makes it kTooFewCoherent with that link's index; the others may be tried without it while five remain.
  [[nodiscard]] BlindAperture estimate_blind(const ApertureData& data);

  [[nodiscard]] const ApertureOptions& options() const noexcept { return options_; }

 private:
  struct Work;
  ApertureOptions options_;
  std::unique_ptr<Work> work_;
};

/// Cramer-Rao bound of the bearings, L x L [rad^2], everything else of the model unknown: receiver phase, offsets,
/// amplitudes, path error (with its prior: the hybrid bound), doc/synthetic_aperture.md eq. 6. Phasors of `data` are
/// not read.
///
/// @param snr amplitude^2 over E|noise|^2 of a phasor, per node.
/// @throws std::invalid_argument for sizes that do not fit, an SNR that is not positive, or a path that does not
///         determine the bearings.
[[nodiscard]] Eigen::MatrixXd aperture_crlb(const ApertureData& data, std::span<const double> bearing_rad,
                                            std::span<const double> snr, const ApertureOptions& options = {});

}  // namespace soopnav::array
