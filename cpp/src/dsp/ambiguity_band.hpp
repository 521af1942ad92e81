#pragma once

#include <cstddef>
#include <vector>

#include "soopnav/core/iq.hpp"
#include "soopnav/dsp/fft.hpp"

namespace soopnav::dsp::detail {

/// Where the signal of a pair of recordings lies.
struct Bands {
  double center_a_hz = 0.0;
  double center_b_hz = 0.0;
  double bandwidth_hz = 0.0;  ///< occupied
  double noise_a = 0.0;       ///< noise density [power / Hz] at unit power of the recording, 0: could not be told
  double noise_b = 0.0;
  double power_a = 1.0;  ///< mean power of the recording
  double power_b = 1.0;
  bool seen = true;        ///< a band stands out of the noise; else `bandwidth_hz` is all there is
  bool line_pair = false;  ///< narrow lines stand out of both spectra, no further apart than the Doppler searched
};

/// What is known of them beforehand; NaN centres and a zero bandwidth are found.
struct BandRequest {
  double center_a_hz;
  double center_b_hz;
  double bandwidth_hz;
  double max_doppler_hz;
  double doppler_center_hz;
  double power_a = 1.0;  ///< mean powers, which the spectra are brought to one by
  double power_b = 1.0;
};

/// Finds the band of the strongest signal that two spectra can share (doc/ambiguity.md section 2).
class BandFinder {
 public:
  BandFinder(double sample_rate_hz, double bandwidth_hz, std::size_t max_samples);

  /// Needs `min_samples()`. Allocates nothing.
  Bands find(IqSpan a, IqSpan b, const BandRequest& request) noexcept;

  [[nodiscard]] std::size_t min_samples() const noexcept { return 4 * size_; }

 private:
  struct Side {
    std::vector<double> raw;    // mean power spectrum, lowest frequency first [power / Hz]
    std::vector<double> clean;  // without narrow lines
    std::vector<double> sums;   // running sums of clean / floor - 1
    std::vector<char> line;     // bins that stand out as lines do
    double averages = 1.0;
    double floor = 0.0;
    bool floor_known = false;
  };
  struct Window {
    std::size_t first_a = 0, first_b = 0, width = 1;
    double score = 0.0;
  };

  void spectrum(IqSpan iq, double power, std::size_t step, std::size_t hop, Side& side) noexcept;
  void remove_lines(Side& side) noexcept;
  [[nodiscard]] bool lines_pair(const BandRequest& request) const noexcept;
  void sum(Side& side, bool excluded, std::size_t first, std::size_t width) noexcept;
  [[nodiscard]] double excess(const Side& side, std::size_t first, std::size_t width) const noexcept;
  // The best pair of windows; one that stays below `floor` may break the limit on Doppler.
  Window best(const BandRequest& request, std::size_t width, double floor) const noexcept;
  Window search(const BandRequest& request) noexcept;
  Window search_twice(const BandRequest& request) noexcept;  // the floor outside the first answer known
  [[nodiscard]] double centroid(const Side& side, std::size_t first, std::size_t width) const noexcept;
  [[nodiscard]] double frequency(double bin) const noexcept;

  double rate_;
  std::size_t size_;
  bool lines_told_;  // whether a line is told from a band by its width
  Fft fft_;
  std::vector<float> window_, scaled_;
  double window_power_ = 0.0;
  std::vector<Cf32> input_, output_;
  std::vector<double> sorted_;
  Side a_, b_;
};

}  // namespace soopnav::dsp::detail
