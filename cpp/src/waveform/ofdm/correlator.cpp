#include "soopnav/waveform/ofdm/correlator.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "waveform/ofdm/kernels.hpp"
#include "waveform/ofdm/require.hpp"

namespace soopnav::ofdm {
namespace {

constexpr int kMaxSymbols = 1 << 20;
constexpr int kMaxOversampling = 64;

std::complex<double> product(Cf32 a, Cf32 b) noexcept {
  const auto ar = static_cast<double>(a.real()), ai = static_cast<double>(a.imag());
  const auto br = static_cast<double>(b.real()), bi = static_cast<double>(b.imag());
  return {ar * br + ai * bi, ai * br - ar * bi};
}

double square(Cf32 a) noexcept {
  const auto re = static_cast<double>(a.real()), im = static_cast<double>(a.imag());
  return re * re + im * im;
}

}  // namespace

std::string_view to_string(BoundaryStatus status) noexcept {
  switch (status) {
    case BoundaryStatus::kOk:
      return "ok";
    case BoundaryStatus::kTooShort:
      return "too short";
    case BoundaryStatus::kNonFinite:
      return "not finite";
    case BoundaryStatus::kNoSignal:
      return "no signal";
    case BoundaryStatus::kNoBoundary:
      return "no boundary";
  }
  return "unknown";
}

CyclicPrefixCorrelator::CyclicPrefixCorrelator(const Numerology& numerology, int symbols, int oversampling)
    : numerology_(numerology), oversampling_(oversampling) {
  check(numerology);
  require(symbols >= 1 && symbols <= kMaxSymbols, "symbols", symbols, "it must be 1 to 1048576");
  require(oversampling >= 1 && oversampling <= kMaxOversampling, "oversampling", oversampling, "it must be 1 to 64");
  const auto factor = static_cast<std::size_t>(oversampling);
  rows_ = static_cast<std::size_t>(symbols);
  columns_ = factor * static_cast<std::size_t>(numerology.symbol_samples());
  lag_ = factor * static_cast<std::size_t>(numerology.subcarriers);
  window_ = factor * static_cast<std::size_t>(numerology.prefix);
  same_.resize(2 * columns_);
  swap_.resize(2 * columns_);
  power_.resize(2 * columns_);
  products_.resize(columns_ + window_ - 1);
  energies_.resize(columns_ + window_ - 1);
  gamma_.resize(columns_);
}

BoundaryStatus CyclicPrefixCorrelator::fold(IqSpan iq, bool with_energy) noexcept {
  if (iq.size() < required_samples()) return BoundaryStatus::kTooShort;
  const Cf32* const y = iq.data();
  std::fill(same_.begin(), same_.end(), 0.0);
  std::fill(swap_.begin(), swap_.end(), 0.0);
  std::fill(power_.begin(), power_.end(), 0.0);
  kernels::fold(y, rows_, columns_, lag_, same_.data(), swap_.data(), with_energy ? power_.data() : nullptr);
  for (std::size_t i = 0; i < columns_; ++i) {
    products_[i] = {same_[2 * i] + same_[2 * i + 1], swap_[2 * i + 1] - swap_[2 * i]};
  }
  const Cf32* const end = y + rows_ * columns_;  // symbol K, which replaces symbol 0 beyond column M - 1
  for (std::size_t j = 0; j + 1 < window_; ++j) {
    products_[columns_ + j] = products_[j] - product(y[j], y[j + lag_]) + product(end[j], end[j + lag_]);
  }
  std::complex<double> sum{};
  for (std::size_t i = 0; i < window_; ++i) sum += products_[i];
  gamma_[0] = sum;
  for (std::size_t m = 1; m < columns_; ++m) {
    sum += products_[m + window_ - 1] - products_[m - 1];
    gamma_[m] = sum;
  }
  if (with_energy) {
    double total = 0.0;
    for (std::size_t i = 0; i < columns_; ++i) {
      power_[i] = power_[2 * i] + power_[2 * i + 1];
      total += power_[i];
    }
    mean_power_ = total / static_cast<double>(rows_ * columns_);
    const auto folded = [&](std::size_t i) {
      return i < columns_ ? power_[i] : power_[i - columns_] - square(y[i - columns_]) + square(end[i - columns_]);
    };
    double most = 0.0;
    for (std::size_t i = 0; i < energies_.size(); ++i) {
      energies_[i] = folded(i) + folded(i + lag_);
      most = std::max(most, energies_[i]);
    }
    if (!(most < static_cast<double>(std::numeric_limits<float>::max()))) return BoundaryStatus::kNonFinite;
  }
  // What is not finite stays in the running sum up to its end.
  if (!std::isfinite(sum.real()) || !std::isfinite(sum.imag())) return BoundaryStatus::kNonFinite;
  if (with_energy && !std::isfinite(mean_power_)) return BoundaryStatus::kNonFinite;
  const auto silent = [](std::complex<double> product) { return product == std::complex<double>{}; };
  if (std::all_of(products_.begin(), products_.end(), silent)) return BoundaryStatus::kNoSignal;
  return BoundaryStatus::kOk;
}

}  // namespace soopnav::ofdm
