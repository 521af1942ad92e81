// What a stranger's program does with soopnav: link modules by name, and get numbers.
#include <cmath>
#include <complex>
#include <cstdio>
#include <vector>

#include "soopnav/dsp/fft.hpp"
#include "soopnav/waveform/lte/sequences.hpp"

int main() {
  // The secondary sequence has 62 elements of -1 and +1, so its energy is 62; a transform over 128 points keeps it.
  std::vector<soopnav::Cf32> grid(128), time(128);
  const auto sequence = soopnav::lte::sss(301, 0);
  for (std::size_t i = 0; i < sequence.size(); ++i) grid[i] = sequence[i];
  soopnav::dsp::Fft(128, soopnav::dsp::FftDirection::kInverse).execute(grid.data(), time.data());
  double energy = 0.0;
  for (const auto sample : time) energy += static_cast<double>(std::norm(sample)) / 128.0;
  std::printf("FFT by %s: energy %.4f\n", soopnav::dsp::fft_library(), energy);
  return std::abs(energy - 62.0) < 1e-3 ? 0 : 1;
}
