#pragma once

#include <memory>

#include "soopnav/core/iq.hpp"

namespace soopnav::dsp {

/// Direction of a discrete Fourier transform.
enum class FftDirection {
  kForward,  ///< X[k] = sum_n x[n] exp(-j 2 pi k n / N)
  kInverse,  ///< x[n] = sum_k X[k] exp(+j 2 pi k n / N), not scaled by 1/N
};

/// A plan for complex single-precision transforms of one size.
///
/// Planning takes a lock and may be done from any thread; it allocates. `execute` is const, and one plan may be
/// executed from several threads at once: out of place they run side by side (four of them with Eigen, where a fifth
/// waits), in place they share a scratch buffer and take turns with FFTW. Neither direction scales: forward then
/// inverse multiplies by `size`.
///
/// `execute` allocates nothing, except that FFTW makes itself buffers for sizes above 2^18 and for those with a prime
/// factor above 13: take sizes from `fast_fft_size`. Results may differ in the last bits between pointers on a 16-byte
/// boundary and others (another order of additions), never between runs on one machine with the same alignment.
class Fft {
 public:
  /// Plans transforms of `size` >= 1 points.
  /// @throws std::invalid_argument when `size` is below 1.
  Fft(int size, FftDirection direction);
  ~Fft();
  Fft(Fft&&) noexcept;
  Fft& operator=(Fft&&) noexcept;
  Fft(const Fft&) = delete;
  Fft& operator=(const Fft&) = delete;

  /// Transforms `size` samples from `in` to `out`; the same pointer is allowed (in place), overlapping ranges are not.
  /// Any alignment of whole samples; `in` is left as it was unless it is `out`.
  void execute(const Cf32* in, Cf32* out) const;

  [[nodiscard]] int size() const noexcept;
  [[nodiscard]] FftDirection direction() const noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// The smallest size >= `minimum` with no prime factor above 5 (fast in every FFT library).
[[nodiscard]] int fast_fft_size(int minimum);

/// Name of the library behind `Fft`: "fftw" or "eigen".
[[nodiscard]] const char* fft_library() noexcept;

}  // namespace soopnav::dsp
