#pragma once

#include <complex>
#include <cstddef>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "dsp/ambiguity_band.hpp"
#include "dsp/ambiguity_front.hpp"
#include "dsp/kaiser.hpp"
#include "soopnav/core/iq.hpp"
#include "soopnav/dsp/ambiguity.hpp"
#include "soopnav/dsp/fft.hpp"

namespace soopnav::dsp::detail {

/// The peak before it is put into seconds and hertz of the recordings.
struct StagePeak {
  double lag = 0.0;         ///< samples of the stage's inner rate
  double doppler_hz = 0.0;  ///< between the two sides as they were mixed
  double rate = 0.0;        ///< of the delay, left after stretching
  std::complex<double> value;
  double noise = 1.0;  ///< mean |value|^2 of noise beside the peak
  // Minus the curvature of |value|^2 / |value|^2 in lag, doppler and both.
  double lag_curvature = 0.0, doppler_curvature = 0.0, mixed_curvature = 0.0;
};

/// Everything at one decimation: buffers, plans, the search and the refinement.
class AmbiguityStage {
 public:
  AmbiguityStage(const AmbiguityOptions& options, std::size_t factor, double bandwidth_hz);

  [[nodiscard]] std::size_t factor() const noexcept { return decimator_.factor(); }
  /// Half the range of Doppler that the search spans once both sides are mixed to zero.
  [[nodiscard]] double doppler_reach_hz() const noexcept { return reach_hz_; }

  /// Mixes, decimates, cleans and cuts both sides; the search spans Doppler from `low_hz` to `high_hz`.
  void load(IqSpan a, IqSpan b, const Bands& bands, double low_hz, double high_hz) noexcept;
  /// The peak in delay and Doppler with the coarse prefilter.
  StagePeak search(double rate) noexcept;
  /// The peak by maximum likelihood, near `coarse`; fills everything of `result` but status and threshold.
  void refine(const StagePeak& coarse, double carrier_hz, AmbiguityPeak& result) noexcept;
  /// Power ratio that noise alone exceeds with the probability asked for, over the region searched.
  [[nodiscard]] double threshold() const noexcept;
  bool surface(std::span<const double> delays_s, std::span<const double> doppler_hz, std::span<double> out) noexcept;

  /// Whether lines were subtracted from both sides that are no further apart than the Doppler searched.
  [[nodiscard]] bool tone_pair() const noexcept { return tone_pair_; }
  /// Work of `search` in operations, about 0.6 ns each.
  [[nodiscard]] double search_cost() const noexcept { return search_cost_; }
  /// Of the peak refined: its spectrum is a line's (or a pulse of one), whose delay cannot be seen.
  [[nodiscard]] bool line_like() const noexcept { return line_like_; }
  /// Of the peak refined: the signal fills so little of the band that its spectrum is not resolved.
  [[nodiscard]] bool narrow() const noexcept { return narrow_; }
  /// Where it then lies, relative to a's centre, and a band that is sure to hold it.
  [[nodiscard]] double narrow_center_hz() const noexcept { return narrow_center_hz_; }
  [[nodiscard]] double narrow_band_hz() const noexcept { return 4.0 * rate_hz_ / static_cast<double>(kBands); }

 private:
  static constexpr std::size_t kBands = 64;
  static constexpr std::size_t kMaxBlocks = 80;
  static constexpr std::ptrdiff_t kReach = 10;  // lags to either side in the table
  static constexpr std::size_t kLags = 2 * kReach + 1;

  using Bins = std::vector<Cf32>;
  using Cf64 = std::complex<double>;

  struct Shape {
    double width;  // noise bandwidth, cycles per decimated sample
    double rolloff;
  };

  [[nodiscard]] static double raised_cosine(double f, const Shape& shape) noexcept;
  void make_templates() noexcept;

  [[nodiscard]] double bin_frequency(std::size_t k) const noexcept;  // cycles per decimated sample
  void cut(std::vector<Cf32>& x, double noise_density, std::size_t& first, std::size_t& last) noexcept;
  void transform(const std::vector<Cf32>& x, Bins& out, double shift) noexcept;
  void coarse_weights() noexcept;
  void filter(const Bins& spectrum, std::vector<Cf32>& out) noexcept;
  void measure_noise() noexcept;
  void measure_energy() noexcept;
  [[nodiscard]] double noise_factor(double doppler_hz) const noexcept;
  [[nodiscard]] double noise_at(std::ptrdiff_t lag, double doppler_hz) const noexcept;
  void search_lags() noexcept;
  void search_doppler() noexcept;
  void tabulate(std::ptrdiff_t lag, double doppler_hz) noexcept;
  void climb(StagePeak& peak, bool with_rate) noexcept;
  void concentration(Cf64 sum, double duration) noexcept;
  void likelihood_weights(const StagePeak& peak, AmbiguityPeak& result) noexcept;
  void covariance(const StagePeak& peak, AmbiguityPeak& result) const noexcept;

  AmbiguityOptions options_;
  double widest_hz_;     // band the stage is made for
  double bandwidth_hz_;  // band of the pair loaded
  BandDecimator decimator_;
  double rate_hz_;  // after decimation
  std::size_t up_;  // inner rate / rate_hz_
  double inner_hz_;
  double reach_hz_;
  std::size_t max_samples_;  // after decimation
  std::ptrdiff_t lag_first_, lag_last_;
  std::size_t margin_;
  std::size_t sum_;  // products summed before the transform over Doppler
  Stretcher stretcher_;
  KaiserSinc kernel_;
  Fft forward_, inverse_;
  std::optional<Fft> doppler_;                      // the search by lags
  std::optional<Fft> wide_forward_, wide_inverse_;  // the search by Doppler bins

  std::size_t n_ = 0;  // samples after decimation of the pair loaded
  Bands bands_;
  double mix_a_hz_ = 0.0, mix_b_hz_ = 0.0;
  double low_hz_ = 0.0, high_hz_ = 0.0;  // Doppler searched, between the sides as mixed
  double stretched_ = 0.0;
  std::size_t tones_a_ = 0, tones_b_ = 0;
  bool tone_pair_ = false, line_like_ = false, narrow_ = false;
  double narrow_center_hz_ = 0.0, search_cost_ = 0.0;
  std::size_t first_a_ = 0, last_a_ = 0, first_b_ = 0, last_b_ = 0;
  std::vector<Cf32> xa_, xb_, stretch_, work_, wide_a_, wide_b_;
  Bins bins_a_, bins_b_;
  std::vector<float> weight_;          // of each bin
  std::vector<Cf32> a_, b_, swapped_;  // filtered; a_ with margins
  std::vector<Cf32> product_, spectrum_;
  std::vector<float> inverse_noise_;
  std::vector<float> best_power_, best_doppler_;
  std::vector<double> noise_factor_;  // by shift in bands
  double noise_width_rad_ = 0.0, noise_duration_rad_ = 0.0;
  std::vector<double> energy_a_, energy_b_;
  std::size_t block_ = 16, blocks_ = 0;
  std::vector<std::complex<double>> table_;  // [block][lag]
  std::ptrdiff_t table_lag_ = 0;
  double table_doppler_hz_ = 0.0;
  double epoch_ = 0.0;  // energy's centre, inner samples
  // Of the refined peak, by band.
  std::vector<Shape> shapes_;
  std::vector<double> templates_;  // [shape][band]
  double templates_hz_ = 0.0;      // bandwidth they are made for
  std::vector<double> cross_, auto_a_, auto_b_, band_weight_;
};

}  // namespace soopnav::dsp::detail
