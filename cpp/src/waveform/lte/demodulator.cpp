#include "waveform/lte/demodulator.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "waveform/lte/kernels.hpp"

namespace soopnav::lte {

Demodulator::Demodulator(int fft_size)
    : size_(fft_size),
      scale_(1.0F / std::sqrt(static_cast<float>(fft_size))),
      fft_(fft_size, dsp::FftDirection::kForward),
      rotator_(static_cast<std::size_t>(fft_size), Cf32(1.0F, 0.0F)),
      window_(static_cast<std::size_t>(fft_size)),
      spectrum_(static_cast<std::size_t>(fft_size)),
      ramp_(static_cast<std::size_t>(fft_size)) {}

void Demodulator::set_frequency(double cycles_per_sample) {
  frequency_ = cycles_per_sample;
  kernels::phasors(0.0, -cycles_per_sample, rotator_.data(), rotator_.size());
}

bool Demodulator::transform(IqSpan iq, double start, int back) {
  const double first = std::floor(start) - back;
  if (!(first >= 0.0) || first + size_ > static_cast<double>(iq.size())) return false;
  advance_ = start - first;
  const double cycles = -frequency_ * first;
  const double phase = 2.0 * std::numbers::pi * (cycles - std::floor(cycles));
  const Cf32 scale(scale_ * static_cast<float>(std::cos(phase)), scale_ * static_cast<float>(std::sin(phase)));
  kernels::multiply_scaled(iq.data() + static_cast<std::size_t>(first), rotator_.data(), scale, window_.data(),
                           window_.size());
  fft_.execute(window_.data(), spectrum_.data());
  return true;
}

void Demodulator::subcarriers(int half, Cf32* out) const {
  const double step = advance_ / size_;
  kernels::phasors(-half * step, step, ramp_.data(), static_cast<std::size_t>(half));
  kernels::multiply(spectrum_.data() + (size_ - half), ramp_.data(), out, static_cast<std::size_t>(half));
  kernels::phasors(step, step, ramp_.data(), static_cast<std::size_t>(half));
  kernels::multiply(spectrum_.data() + 1, ramp_.data(), out + half, static_cast<std::size_t>(half));
}

void Demodulator::pilots(int first, int count, const Cf32* reference_conj, Cf32* out) const {
  const double step = advance_ / size_;
  const int negative = std::clamp((-first + 5) / 6, 0, count);  // elements below the carrier
  kernels::phasors(first * step, 6.0 * step, ramp_.data(), static_cast<std::size_t>(negative));
  for (int i = 0; i < negative; ++i) {
    const auto u = static_cast<std::size_t>(i);
    out[u] = spectrum_[static_cast<std::size_t>(size_ + first + 6 * i)];
  }
  kernels::phasors((first + 6 * negative + 1) * step, 6.0 * step, ramp_.data() + negative,
                   static_cast<std::size_t>(count - negative));
  for (int i = negative; i < count; ++i) {
    out[static_cast<std::size_t>(i)] = spectrum_[static_cast<std::size_t>(first + 6 * i + 1)];
  }
  kernels::multiply(out, ramp_.data(), out, static_cast<std::size_t>(count));
  kernels::multiply(out, reference_conj, out, static_cast<std::size_t>(count));
}

}  // namespace soopnav::lte
