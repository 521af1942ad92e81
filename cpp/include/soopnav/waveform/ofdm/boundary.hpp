#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <span>

#include "soopnav/waveform/ofdm/correlator.hpp"

namespace soopnav::ofdm {

/// How a boundary is taken from the correlator.
enum class BoundaryMethod : std::uint8_t {
  kNearestSample,      ///< argmax of Re gamma (crosby 2.4)
  kMagnitude,          ///< argmax of |gamma|: the same for any carrier offset
  kMaximumLikelihood,  ///< argmax of |gamma| - rho Phi, the energy term Phi included (van de Beek et al. 1997)
  kInterpolated,       ///< between samples: likelihood of the folded pairs against band-limited profiles
};

/// Where symbols start in an epoch's samples.
struct Boundary {
  BoundaryStatus status = BoundaryStatus::kNoSignal;
  double boundary_samples = 0.0;  ///< in 0 .. M, of the receiver's own samples, as the method finds it
  double sigma_samples = 0.0;     ///< standard deviation of it
  double boundary_m = 0.0;        ///< c (boundary - offset) / f_s in 0 .. ambiguity: grows with the path's length
  double sigma_m = 0.0;
  double cfo_hz = 0.0;  ///< carrier offset, positive when the signal lies above; known modulo f_s / N
  double metric = 0.0;  ///< |gamma| / Phi at the boundary: 1 without noise, SNR / (1 + SNR) on average
  double snr_db = 0.0;  ///< per sample, from the metric (interpolated: from the pairs and the fitted profile)
};

struct BoundaryOptions {
  BoundaryMethod method = BoundaryMethod::kNearestSample;
  /// SNR per sample, when known. Without one it is estimated in each epoch.
  std::optional<double> snr_db{};
};

/// Blind estimator of the symbol boundary from K + 1 symbols.
///
/// kNearestSample, kMagnitude and kMaximumLikelihood give whole samples. kInterpolated (doc/ofdm.md eq. 9 to 11)
/// compares the folded pairs with the correlation profiles of 64 fractions of a sample: coarse by the correlator's top
/// +- 1 sample
/// (+- 3 below 3 dB), every fourth fraction, then its neighbours, then a parabola. It needs critical sampling and M <=
/// 256. Sigma holds for a signal in white noise without reflections: quantisation, self-noise, noise, and the chance
/// that the top is a wrong one; interpolated from the likelihood's curvature times what dependent pairs cost (eq. 14),
/// joined with the likelihood's spread over its grid. The constructor makes the tables (interpolated: about 10 ms);
/// `estimate` allocates nothing. One object serves one thread at a time.
class BoundaryEstimator {
 public:
  /// @throws std::invalid_argument as `CyclicPrefixCorrelator`; for an SNR that is not finite or outside -60 .. 100 dB;
  /// and
  ///         for kInterpolated with oversampling or more than 256 samples per symbol.
  BoundaryEstimator(const Numerology& numerology, int symbols, int oversampling = 1,
                    const BoundaryOptions& options = {});
  ~BoundaryEstimator();
  BoundaryEstimator(BoundaryEstimator&&) noexcept;
  BoundaryEstimator& operator=(BoundaryEstimator&&) noexcept;

  /// The boundary in the first `required_samples()` of `iq`. Anything but kOk leaves every number zero.
  [[nodiscard]] Boundary estimate(IqSpan iq) noexcept;

  [[nodiscard]] std::size_t required_samples() const noexcept { return correlator_.required_samples(); }
  /// Where the method finds the boundary of a signal with delay 0 [samples]: -(Q - 1) / 2 for whole samples at
  /// oversampling Q, because the prefix's v samples span (v - 1) Q + 1 of the fine ones and the window v Q; 0 else.
  [[nodiscard]] double offset_samples() const noexcept { return offset_; }
  [[nodiscard]] const BoundaryOptions& options() const noexcept { return options_; }
  [[nodiscard]] const CyclicPrefixCorrelator& correlator() const noexcept { return correlator_; }

  /// e(i) = sum_k |y(M k + i) - y(M k + i + N) exp(j phi)|^2 / P, i = 0 .. M - 1, of the last `estimate` that was kOk:
  /// the folded differences, carrier offset taken out, over the mean power: what `TwoRayTiming` takes. Allocates
  /// nothing.
  /// @throws std::invalid_argument unless `out` has M elements.
  void folded_differences(std::span<double> out) const;

 private:
  struct Tables;

  [[nodiscard]] Boundary whole(std::size_t top, double phase, double rho) const noexcept;
  void interpolate(std::size_t top, double phase, Boundary& out) noexcept;

  BoundaryOptions options_;
  CyclicPrefixCorrelator correlator_;
  double offset_;
  double known_rho_ = 0.0;  // 0: not known
  double phase_ = 0.0;
  std::unique_ptr<Tables> tables_;
};

/// Bound of the delay's standard deviation [samples] from the Fisher information of the folded pairs (doc/ofdm.md eq.
/// 12): pairs y(i), y(i + N) as independent complex Gaussians with the correlation of a band-limited stream at a
/// fractional delay. `fraction` is the delay's fractional part; without one, the information is averaged over
/// fractions, which bounds the rms over delays of any fraction. At whole delays the information vanishes as the noise
/// grows: the profile's slope is zero there (infinity is returned for none at all).
/// @throws std::invalid_argument for a bad numerology, symbols below 1, or an SNR outside -60 .. 100 dB.
[[nodiscard]] double delay_crlb_samples(double snr_db, int symbols, const Numerology& numerology = {},
                                        std::optional<double> fraction = std::nullopt);

/// The same in metres.
[[nodiscard]] double delay_crlb_m(double snr_db, int symbols, const Numerology& numerology = {},
                                  std::optional<double> fraction = std::nullopt);

}  // namespace soopnav::ofdm
