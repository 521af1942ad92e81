#include "soopnav/waveform/ofdm/synthesis.hpp"

#include <algorithm>
#include <cmath>

#include "soopnav/core/constants.hpp"
#include "waveform/ofdm/require.hpp"

namespace soopnav::ofdm {
namespace {

constexpr int kMaxSubcarriers = 65536;

const Numerology& checked(const Numerology& numerology) {
  check(numerology);
  return numerology;
}

unsigned bits_of(Constellation constellation) {
  switch (constellation) {
    case Constellation::kQpsk:
      return 2;
    case Constellation::kQam16:
      return 4;
    case Constellation::kQam64:
      return 6;
  }
  require(false, "constellation", static_cast<int>(constellation), "it must be QPSK, 16-QAM or 64-QAM");
  return 0;
}

}  // namespace

double Numerology::ambiguity_m() const noexcept { return kSpeedOfLightMps * symbol_s(); }
double Numerology::sample_m() const noexcept { return kSpeedOfLightMps / sample_rate_hz; }

void check(const Numerology& numerology) {
  require(numerology.subcarriers >= 2 && numerology.subcarriers <= kMaxSubcarriers, "subcarriers",
          numerology.subcarriers, "it must be 2 to 65536");
  require(numerology.prefix >= 1 && numerology.prefix < numerology.subcarriers, "prefix", numerology.prefix,
          "it must be at least 1 and below the number of subcarriers");
  require(std::isfinite(numerology.sample_rate_hz) && numerology.sample_rate_hz > 0.0, "sample_rate_hz",
          numerology.sample_rate_hz, "it must be finite and positive");
}

Synthesizer::Synthesizer(const Numerology& numerology, Constellation constellation)
    : numerology_(checked(numerology)),
      constellation_(constellation),
      bits_(bits_of(constellation)),
      fft_(numerology.subcarriers, dsp::FftDirection::kInverse),
      points_(std::size_t{1} << bits_),
      spectrum_(static_cast<std::size_t>(numerology.subcarriers)) {
  const unsigned half = bits_ / 2;
  const unsigned side = 1U << half;
  // Levels -(side-1), .., side-1 in steps of 2: mean square (side^2 - 1) / 3 in each of two parts.
  const double scale = 1.0 / std::sqrt(2.0 / 3.0 * (side * side - 1.0) * numerology.subcarriers);
  for (unsigned group = 0; group < points_.size(); ++group) {
    const auto level = [side, scale](unsigned bits) { return static_cast<float>(scale * (2.0 * bits - (side - 1.0))); };
    points_[group] = {level(group & (side - 1)), level(group >> half)};
  }
  const std::size_t per_word = 32 / bits_;
  words_.resize((spectrum_.size() + per_word - 1) / per_word);
}

void Synthesizer::fill(std::span<Cf32> out, RandomStream& random) noexcept {
  const auto subcarriers = static_cast<std::size_t>(numerology_.subcarriers);
  const auto prefix = static_cast<std::size_t>(numerology_.prefix);
  const std::size_t per_word = 32 / bits_;
  const std::uint32_t mask = (1U << bits_) - 1;
  while (out.size() >= subcarriers + prefix) {
    random.fill_u32(words_);
    for (std::size_t k = 0, word = 0; k < subcarriers; ++word) {
      std::uint32_t bits = words_[word];
      for (const std::size_t end = std::min(subcarriers, k + per_word); k < end; ++k, bits >>= bits_) {
        spectrum_[k] = points_[bits & mask];
      }
    }
    fft_.execute(spectrum_.data(), out.data() + prefix);
    std::copy_n(out.begin() + static_cast<std::ptrdiff_t>(subcarriers), prefix, out.begin());
    out = out.subspan(subcarriers + prefix);
  }
  std::fill(out.begin(), out.end(), Cf32{});
}

}  // namespace soopnav::ofdm
