#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <span>
#include <vector>

#include "soopnav/core/iq.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/dsp/fft.hpp"
#include "soopnav/simulation/ofdm_link.hpp"
#include "soopnav/waveform/ofdm/synthesis.hpp"

namespace soopnav::simulation {

/// Makes the samples of epochs; arguments are checked by its owner.
class OfdmLink::Renderer {
 public:
  Renderer(const ofdm::Numerology& numerology, int symbols, const OfdmLinkOptions& options);

  void render(double delay_m, const RandomStream& random, std::span<Cf32> out, std::optional<double> snr_db,
              const std::optional<Reflection>& reflection);

 private:
  static constexpr int kFine = 15;
  static constexpr int kTaps = 8;
  static constexpr int kBefore = 3;  // samples of the window before the one at or before an output
  static constexpr std::size_t kBlock = 256;

  void extend(std::vector<Cf32>& string);
  void shift_in(const std::vector<Cf32>& string, long long fine_shift, std::complex<double> gain, bool add,
                std::span<Cf32> out);
  void delay_in(double delay_samples, const std::optional<Reflection>& reflection, double extra_samples, bool noisy,
                std::span<Cf32> out);
  void ramp(std::size_t bins, double turns_per_bin);

  ofdm::Numerology numerology_;
  OfdmLinkOptions options_;
  std::size_t length_;  // of the string at the critical rate
  std::size_t kept_;    // samples that an epoch hands out of it
  ofdm::Synthesizer synthesizer_;
  std::array<std::array<float, kTaps>, kFine> taps_{};
  std::vector<Cf32> string_, noise_;
  std::vector<Cf32> block_;
  std::optional<dsp::Fft> forward_, inverse_;
  std::vector<Cf32> spectrum_, turned_, phase_;
  std::vector<std::complex<double>> ramp_;
};

}  // namespace soopnav::simulation
