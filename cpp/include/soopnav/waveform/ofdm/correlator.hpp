#pragma once

#include <complex>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

#include "soopnav/core/iq.hpp"
#include "soopnav/waveform/ofdm/numerology.hpp"

namespace soopnav::ofdm {

/// What became of one epoch's samples.
enum class BoundaryStatus : std::uint8_t {
  kOk,
  kTooShort,    ///< fewer samples than `required_samples()`
  kNonFinite,   ///< a sample is NaN or infinite, or its square is beyond single precision
  kNoSignal,    ///< every sample is zero
  kNoBoundary,  ///< no boundary stands out (two-ray timing: nothing near the prediction)
};

/// A lower-case phrase: "ok", "too short", ...; "unknown" for a value that is no enumerator.
[[nodiscard]] std::string_view to_string(BoundaryStatus status) noexcept;

/// Cyclic-prefix correlator over many symbols (crosby 2.4 and 2.5; doc/ofdm.md eq. 2 to 5).
///
/// Model:  gamma(m) = sum_{k=0}^{K-1} sum_{i=m}^{m+v-1} y(M k + i) y*(M k + i + N), m = 0 .. M-1, counted from 0 (the
///         print counts samples from 1). Its real part is largest where a symbol starts; with a carrier offset f its
///         phase there is -2 pi f N / f_s.
/// The products are first summed over the symbols (folded), then over the window with a running sum. Beyond M - 1 the
/// folded products are those of symbols 1 .. K, not 0 .. K-1: f(M + j) != f(j).
/// `oversampling` multiplies M, N, v and the rate of the samples.
/// Cost: two multiply-adds per product in single precision, summed on in double: 1e-6 of the largest value exact.
/// The constructor allocates, nothing else does. One object serves one thread at a time.
class CyclicPrefixCorrelator {
 public:
  /// @throws std::invalid_argument for a bad numerology, symbols outside 1 .. 2^20 or oversampling outside 1 .. 64.
  CyclicPrefixCorrelator(const Numerology& numerology, int symbols, int oversampling = 1);

  /// Samples that K symbols and the last window take: (K + 1) M - 1.
  [[nodiscard]] std::size_t required_samples() const noexcept { return (rows_ + 1) * columns_ - 1; }

  /// Folds the first `required_samples()` of `iq`; `with_energy` also folds |y|^2. The results below are only good
  /// after kOk.
  [[nodiscard]] BoundaryStatus fold(IqSpan iq, bool with_energy) noexcept;

  /// f(i) = sum_k y(M k + i) y*(M k + i + N), i = 0 .. M + v - 2.
  [[nodiscard]] std::span<const std::complex<double>> products() const noexcept { return products_; }
  /// sum_k |y(M k + i)|^2 + |y(M k + i + N)|^2, i = 0 .. M + v - 2; of the last fold with energy.
  [[nodiscard]] std::span<const double> energies() const noexcept { return energies_; }
  /// gamma(m), m = 0 .. M - 1.
  [[nodiscard]] std::span<const std::complex<double>> gamma() const noexcept { return gamma_; }

  [[nodiscard]] std::size_t period() const noexcept { return columns_; }  ///< M in samples
  [[nodiscard]] std::size_t lag() const noexcept { return lag_; }         ///< N in samples
  [[nodiscard]] std::size_t window() const noexcept { return window_; }   ///< v in samples
  [[nodiscard]] std::size_t symbols() const noexcept { return rows_; }    ///< K
  [[nodiscard]] const Numerology& numerology() const noexcept { return numerology_; }
  [[nodiscard]] int oversampling() const noexcept { return oversampling_; }
  [[nodiscard]] double sample_rate_hz() const noexcept { return numerology_.sample_rate_hz * oversampling_; }

  /// Mean of |y|^2 over the first K symbols of the last fold with energy.
  [[nodiscard]] double mean_power() const noexcept { return mean_power_; }

 private:
  Numerology numerology_;
  int oversampling_;
  std::size_t rows_;
  std::size_t columns_;
  std::size_t lag_;
  std::size_t window_;
  double mean_power_ = 0.0;
  std::vector<double> same_, swap_, power_;
  std::vector<std::complex<double>> products_;
  std::vector<double> energies_;
  std::vector<std::complex<double>> gamma_;
};

}  // namespace soopnav::ofdm
