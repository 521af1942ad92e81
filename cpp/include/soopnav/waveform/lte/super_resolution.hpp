#pragma once

#include <array>
#include <complex>
#include <cstdint>
#include <memory>
#include <span>

#include "soopnav/core/static_vector.hpp"
#include "soopnav/waveform/lte/types.hpp"

/// Paths closer together than the bandwidth resolves, from the reference signals of one cell
/// (nielsen 2.3 and its phase II; cpp/doc/lte_super_resolution.md).
namespace soopnav::lte {

inline constexpr int kMaxResolved = 6;  ///< paths that PathResolver can tell apart

/// How many paths there are.
enum class OrderRule : std::uint8_t {
  kMdl,    ///< minimum description length of the maximum-likelihood fits (eq. 9)
  kAic,    ///< Akaike's criterion: finds weaker paths, and now and then one too many
  kFixed,  ///< `max_paths`
};

/// Subspace that starts the fits.
enum class SubspaceMethod : std::uint8_t {
  kEsprit,        ///< forward-backward covariance
  kMatrixPencil,  ///< the forward data alone
};

/// Window over frequency of the first-peak rule.
enum class PeakWindow : std::uint8_t { kRectangular, kHann };

struct ResolverOptions {
  OrderRule order = OrderRule::kMdl;
  int max_paths = 4;  ///< 1 ... 6
  SubspaceMethod subspace = SubspaceMethod::kEsprit;
  double window_s = 2e-6;        ///< paths are looked for so far before and after the strongest, 1e-7 ... 1e-5
  double min_separation = 0.1;   ///< of a resolution cell; closer ones are one path, 0.02 ... 1
  double earliest_db = -20.0;    ///< a first path weaker than this below the strongest is not taken as such, <= 0
  double peak_threshold = 0.35;  ///< of the largest magnitude, for the first-peak rule, 0.05 ... 1
  PeakWindow peak_window = PeakWindow::kRectangular;
  bool polish = true;       ///< false: the subspace's own delays, amplitudes by least squares
  bool ignore_gap = false;  ///< the subspace takes the comb for uniform across the carrier: biased, to compare
};

/// A channel over frequency: of each port the values at `frequencies`, elements of equal noise.
struct ChannelView {
  std::array<const Cf32*, kMaxPorts> port{};
  int ports = 0;                     ///< 1 ... 4
  std::span<const int> frequencies;  ///< in units of 15 kHz from the carrier, ascending; as many below it as above,
                                     ///< each half in equal steps: the comb of reference elements
  double noise_variance = 0.0;       ///< of one value; 0: not known, the fit's residual is taken
};

/// One path that was told apart.
struct ResolvedPath {
  double delay_s = 0.0;
  double sigma_s = 0.0;   ///< Cramer-Rao bound with all other delays and all amplitudes unknown, at the noise measured
  double power_db = 0.0;  ///< mean over ports, relative to the strongest path
  std::array<std::complex<double>, kMaxPorts> gain{};  ///< per port, at the carrier
};

/// Delays count from the symbol's start that the channel is referred to.
struct ResolvedPaths {
  StaticVector<ResolvedPath, kMaxResolved> paths;  ///< ascending delay
  int first = 0;             ///< the path that counts as the first (`ResolverOptions::earliest_db`)
  double toa_s = 0.0;        ///< its delay
  double toa_sigma_s = 0.0;  ///< and deviation
  std::array<std::array<double, kMaxResolved>, kMaxResolved> covariance_s2{};  ///< of the paths' delays
  StaticVector<double, kMaxResolved> subspace_delays_s;  ///< for that order before the polish; may be fewer
  int subspace_order = 0;                                ///< minimum description length of the covariance's eigenvalues
  double single_path_s = 0.0;                            ///< maximum likelihood of one path
  double first_peak_s = 0.0;        ///< first local maximum of the impulse response over the threshold
  double first_peak_sigma_s = 0.0;  ///< of a lone path there: noise only, what paths within a cell shift is not in it
  double noise_variance = 0.0;      ///< of one value, as used for the deviations
  double fit = 0.0;                 ///< residual per degree of freedom over the variance given; 1 when the model holds
  double snr_db = 0.0;              ///< signal over noise of one value, mean over ports
};

enum class ResolveStatus : std::uint8_t {
  kOk,
  kTooShort,   ///< a subframe asked for is not wholly in the samples, or has no reference signals (TDD)
  kNonFinite,  ///< a value is NaN or infinite, or all are zero
  kLost,       ///< no path stands out of the noise
};

/// Tells paths apart in a channel over frequency, amplitudes and phases free per path and port.
///
/// Subspace of windows that slide in both halves of the comb at once, so that its gap at the carrier is exact; order by
/// minimum description length; delays by maximum likelihood with the amplitudes projected out, started from the
/// subspace, from a search over pairs and from what the path before left. Nothing is allocated after the first channel
/// of a size. About 0.6 ms for 400 elements, two ports and two paths.
class PathResolver {
 public:
  /// @throws std::invalid_argument naming the option that is out of range.
  explicit PathResolver(const ResolverOptions& options = {});
  ~PathResolver();
  PathResolver(PathResolver&&) noexcept;
  PathResolver& operator=(PathResolver&&) noexcept;

  /// Resolves a channel of 12 ... 440 elements. `out` is not changed unless kOk; kTooShort for a comb that is none.
  [[nodiscard]] ResolveStatus resolve(const ChannelView& channel, ResolvedPaths& out);

  /// MUSIC pseudo-spectrum 1 / (1 - |E' a|^2 / |a|^2) of the last channel at `delays_s`, with `order` signal vectors
  /// (0: those of the last result). Ambiguous over `music_period_s()`. Zeros before the first channel.
  void music(std::span<const double> delays_s, int order, std::span<double> out) const noexcept;
  [[nodiscard]] double music_period_s() const noexcept;

  /// Impulse response of the last channel under a rectangular window: magnitude summed in power over ports, scaled so
  /// that a lone path of unit gain on every port has 1.
  void impulse_response(std::span<const double> delays_s, std::span<double> out) const noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// PathResolver on samples: reads the reference signals of one cell from one or several subframes.
class SubframePathResolver {
 public:
  /// `cell` gives identity, cyclic prefix, duplex mode, bandwidth and ports (six blocks and one port when unknown).
  /// @throws std::invalid_argument as SubframeToaEstimator and PathResolver do.
  SubframePathResolver(double sample_rate_hz, const Detection& cell, const ResolverOptions& options = {});
  ~SubframePathResolver();
  SubframePathResolver(SubframePathResolver&&) noexcept;
  SubframePathResolver& operator=(SubframePathResolver&&) noexcept;

  /// Subframe `first` of its frame (0 ... 9) begins near `start_s` (within 2 us) after the span's first sample; it and
  /// the `count` - 1 (1 ... 10 together) after it are averaged, phases aligned, TDD's uplink left out. Delays of `out`
  /// count from the span's first sample too: `toa_s` is the start of subframe `first` by the first path.
  /// Allocates nothing after the first call.
  [[nodiscard]] ResolveStatus resolve(IqSpan iq, int first, int count, double start_s, double cfo_hz,
                                      ResolvedPaths& out);

  /// The channel that the last `resolve` saw: values of `port`, and their frequencies in units of 15 kHz.
  [[nodiscard]] std::span<const Cf32> channel(int port) const noexcept;
  [[nodiscard]] std::span<const int> frequencies() const noexcept;
  [[nodiscard]] int ports() const noexcept;
  [[nodiscard]] const PathResolver& resolver() const noexcept;
  /// Carrier offset left beside the one given, in the last `resolve` [Hz].
  [[nodiscard]] double residual_cfo_hz() const noexcept;
  /// Start that the delays of `resolver()` count from, as given to the last `resolve` [s].
  [[nodiscard]] double start_s() const noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace soopnav::lte
