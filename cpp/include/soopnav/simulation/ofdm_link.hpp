#pragma once

#include <complex>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "soopnav/core/iq.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/waveform/ofdm/boundary.hpp"
#include "soopnav/waveform/ofdm/synthesis.hpp"

namespace soopnav::simulation {

/// How the distance gets into the samples.
enum class Movement : std::uint8_t {
  /// crosby 3.4: interpolated by 15 (eight taps per phase), then shifted round by floor(distance / fine sample) fine
  /// samples of c / (15 f_s), 0.9993 m at 20 MHz. The string of K + 1 symbols is a circle.
  kInterpolateAndShift,
  /// A delay by any real number of samples, exact for the band-limited periodic string (a phase ramp over its
  /// spectrum).
  kFractionalDelay,
};

/// A second ray.
struct Reflection {
  double extra_m = 0.0;            ///< its path is longer by this
  std::complex<double> gain{0.0};  ///< over the line of sight's
};

struct OfdmLinkOptions {
  int oversampling = 1;  ///< of the receiver: 1, or 15 (all fine samples)
  Movement movement = Movement::kInterpolateAndShift;
  ofdm::Constellation constellation = ofdm::Constellation::kQpsk;
  double cfo_hz = 0.0;  ///< carrier offset seen by the receiver
  /// Noise made at the critical rate and interpolated, instead of white at the receiver's own rate.
  bool band_limited_noise = false;
};

/// What an epoch's measurement gave, a row per epoch.
struct BoundarySeries {
  std::vector<double> range_m;  ///< in 0 .. ambiguity
  std::vector<double> sigma_m;
  std::vector<double> metric;
  std::vector<ofdm::BoundaryStatus> status;
  std::vector<double> folded;  ///< [epochs][M Q] folded differences (`BoundaryEstimator::folded_differences`), or empty
};

/// One transmitter as a receiver hears it: an epoch is a string of fresh OFDM symbols of power 1, moved by the path's
/// length, with a reflection, white noise and a carrier offset.
///
/// The longer the path, the later, and so larger, the boundary. SNR is per sample of the receiver, over the line of
/// sight alone. An epoch's symbols are those of substream 0 of its random stream, its noise those of substream 1: noise
/// and delays do not change the symbols. Only the phases of the interpolation that the receiver samples are computed.
/// One object serves one thread at a time.
class OfdmLink {
 public:
  /// @throws std::invalid_argument for a bad numerology, symbols outside 1 .. 2^16, oversampling other than 1 and 15, a
  ///         strings too long (2^24 samples), or a carrier offset that is not finite.
  OfdmLink(const ofdm::Numerology& numerology, int symbols, const OfdmLinkOptions& options = {});
  ~OfdmLink();
  OfdmLink(OfdmLink&&) noexcept;
  OfdmLink& operator=(OfdmLink&&) noexcept;

  /// Samples of an epoch: (K + 1) M, times the oversampling.
  [[nodiscard]] std::size_t epoch_samples() const noexcept;

  /// The samples of one epoch. Allocates nothing.
  /// @throws std::invalid_argument unless delay, extra path and gain are finite (lengths up to 1e9 m), snr_db, if any,
  /// is
  ///         in -60 .. 100 and `out` has `epoch_samples()`.
  void epoch(double delay_m, const RandomStream& random, std::span<Cf32> out,
             std::optional<double> snr_db = std::nullopt, const std::optional<Reflection>& reflection = std::nullopt);

  struct Measure {
    ofdm::BoundaryMethod method = ofdm::BoundaryMethod::kNearestSample;
    std::optional<double> snr_db{};  ///< of the samples; the estimator is not told
    bool folded = false;             ///< keep the folded differences
    int threads = 1;
  };

  /// Simulates and measures one epoch per element of `delays_m`: epoch e has the samples of
  /// `epoch(delays_m[e], random.substream(e))`. The same bits for any number of threads. `reflections` is empty or has
  /// an element per epoch; a gain of 0 is none.
  /// @throws std::invalid_argument as `epoch`, for reflections of another number, threads outside 1 .. 256, and as
  ///         `BoundaryEstimator`.
  [[nodiscard]] BoundarySeries measure(std::span<const double> delays_m, std::span<const Reflection> reflections,
                                       const RandomStream& random, const Measure& how);

  [[nodiscard]] const ofdm::Numerology& numerology() const noexcept { return numerology_; }
  [[nodiscard]] const OfdmLinkOptions& options() const noexcept { return options_; }
  [[nodiscard]] int symbols() const noexcept { return symbols_; }

 private:
  class Renderer;
  struct Worker;

  ofdm::Numerology numerology_;
  int symbols_;
  OfdmLinkOptions options_;
  std::unique_ptr<Renderer> renderer_;
  std::vector<std::unique_ptr<Worker>> workers_;  // of the last `measure`
};

}  // namespace soopnav::simulation
