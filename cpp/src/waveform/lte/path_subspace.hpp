#pragma once

#include <array>
#include <complex>
#include <span>

#include "soopnav/waveform/lte/super_resolution.hpp"

namespace soopnav::lte {

/// Signal subspace of a comb with a gap at the carrier (cpp/doc/lte_super_resolution.md section 2).
///
/// Neighbours are averaged until a half has at most 40 elements; snapshots are windows of both halves at the same
/// place, one above the other. Fixed storage, no heap.
class PathSubspace {
 public:
  static constexpr int kHalf = 40;    ///< elements of a half after averaging, at most
  static constexpr int kWindow = 24;  ///< of them in a window, at most
  static constexpr int kRows = 2 * kWindow;

  /// Turns the channel by `centre` (turns per 15 kHz) and makes the covariance and its eigenvectors.
  void compute(const ChannelView& channel, double centre, SubspaceMethod method, bool ignore_gap);

  /// Minimum description length of the eigenvalues, at most `limit`.
  [[nodiscard]] int order(int limit) const;

  /// Delays of `k` paths by shift invariance, turns per 15 kHz; false when the equations have no answer.
  [[nodiscard]] bool delays(int k, std::array<double, kMaxResolved>& out) const;

  /// MUSIC value at `theta` (turns per 15 kHz).
  [[nodiscard]] double music(double theta, int k) const;

  /// Delays repeat after this many turns per 15 kHz.
  [[nodiscard]] double period() const noexcept { return period_; }
  /// Largest order that the window and the snapshots allow.
  [[nodiscard]] int limit() const noexcept { return limit_; }

 private:
  using Column = std::array<std::complex<double>, kRows>;

  int window_ = 0, rows_ = 0, snapshots_ = 0, limit_ = 0;
  double centre_ = 0.0, period_ = 1.0;
  bool ignore_gap_ = false;
  std::array<double, kRows> position_{};            // frequencies of a snapshot's rows, units of 15 kHz
  std::array<double, kMaxResolved> eigenvalues_{};  // the largest, descending
  double trace_ = 0.0, log_determinant_ = 0.0;      // of all that the snapshots fill
  int filled_ = 0;
  std::array<Column, kMaxResolved> signal_{};  // eigenvectors of the largest
};

}  // namespace soopnav::lte
