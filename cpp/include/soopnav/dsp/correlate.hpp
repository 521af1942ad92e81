#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>

#include "soopnav/core/iq.hpp"

namespace soopnav::dsp {

/// What an `OverlapSave` computes from the input x and its kernel h of K samples.
enum class FilterKind {
  kConvolution,  ///< y[n] = sum_{k=0}^{K-1} h[k] x[n - k]
  kCorrelation,  ///< y[n] = sum_{k=0}^{K-1} conj(h[k]) x[n + k]: peaks where x holds h starting at sample n
};

/// Convolution or correlation with a kernel known in advance, by overlap-save in the frequency domain.
///
/// x is zero outside the capture. Results equal the direct sum within 1e-5 of max|x| * sum|h| (single-precision FFTs;
/// Oppenheim & Schafer, Discrete-Time Signal Processing, section 8.7.3).
///
/// An object holds the kernel's spectrum, its plans and its buffers: the constructor allocates, nothing else does
/// (but see `Fft` for transforms above 2^18 points, which kernels above 2^17 samples need).
/// Two ways to use it, independent of each other: `apply` on a capture in memory, and `push`/`flush` on a stream.
/// Both carry scratch, so one object serves one thread at a time.
class OverlapSave {
 public:
  /// @param kernel    1 to 2^26 finite samples; copied.
  /// @param fft_size  points per transform, at least kernel.size(); 0 picks the cheapest per sample.
  /// @throws std::invalid_argument otherwise.
  OverlapSave(IqSpan kernel, FilterKind kind, int fft_size = 0);
  ~OverlapSave();
  OverlapSave(OverlapSave&&) noexcept;
  OverlapSave& operator=(OverlapSave&&) noexcept;
  OverlapSave(const OverlapSave&) = delete;
  OverlapSave& operator=(const OverlapSave&) = delete;

  /// out[i] = y[first + i]. Any range may be asked for: the whole convolution is first = 0 with n + K - 1 outputs, the
  /// correlations that lie wholly inside the capture are first = 0 with n - K + 1 outputs.
  /// `out` may not overlap `in`. Allocates nothing; leaves a stream in progress alone.
  void apply(IqSpan in, std::int64_t first, std::span<Cf32> out);

  /// Takes the next samples of a stream and writes the outputs that are complete, y[0] first; returns how many.
  /// Outputs come in whole blocks of `block_size()`. Allocates nothing.
  /// @throws std::invalid_argument when `out` is shorter than `push_size(in.size())`; the stream is then as it was.
  std::size_t push(IqSpan in, std::span<Cf32> out);
  /// Ends the stream: writes the outputs left, up to y[n + K - 2] (convolution) or y[n - 1] (correlation) for a stream
  /// of n samples, and starts afresh. Allocates nothing.
  /// @throws std::invalid_argument when `out` is shorter than `flush_size()`; the stream is then as it was.
  std::size_t flush(std::span<Cf32> out);
  /// Forgets the stream so far.
  void reset() noexcept;

  /// Outputs the next `push` of `n_in` samples will write.
  [[nodiscard]] std::size_t push_size(std::size_t n_in) const noexcept;
  /// Outputs `flush` would write now.
  [[nodiscard]] std::size_t flush_size() const noexcept;

  [[nodiscard]] std::size_t kernel_size() const noexcept;  ///< K
  [[nodiscard]] std::size_t block_size() const noexcept;   ///< outputs per transform, fft_size() - K + 1
  [[nodiscard]] int fft_size() const noexcept;
  [[nodiscard]] FilterKind kind() const noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace soopnav::dsp
