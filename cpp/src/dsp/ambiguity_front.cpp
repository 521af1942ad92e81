#include "dsp/ambiguity_front.hpp"

#include <algorithm>
#include <cmath>
#include <complex>
#include <numbers>

#include "dsp/ambiguity_kernels.hpp"
#include "dsp/kaiser.hpp"
#include "dsp/kernels.hpp"

namespace soopnav::dsp::detail {
namespace {

using Cf64 = std::complex<double>;

constexpr double kTwoPi = 2.0 * std::numbers::pi;
constexpr double kAttenuationDb = 50.0;
constexpr std::size_t kTurnSamples = 64;  // a rotation is computed afresh after this many steps

std::size_t rounded_up(std::size_t n, std::size_t grid) { return (n + grid - 1) / grid * grid; }

// Low-pass for a decimation by `factor` that keeps |f| < passband free of aliases, unit gain, a multiple of 16 taps.
std::vector<double> low_pass(std::size_t factor, double passband) {
  const double rate = 1.0 / static_cast<double>(factor);
  const double stopband = std::max(rate - passband, passband + 0.02 * rate);
  const double span = kaiser_span(kAttenuationDb, kTwoPi * (stopband - passband));
  const std::size_t n = rounded_up(static_cast<std::size_t>(std::ceil(span)), kDotSamples);
  const KaiserSinc kernel(passband + stopband, static_cast<double>(n), kAttenuationDb);
  std::vector<double> taps(n);
  double sum = 0.0;
  for (std::size_t k = 0; k < n; ++k) {
    taps[k] = kernel(static_cast<double>(k) - static_cast<double>(n / 2));
    sum += taps[k];
  }
  for (double& tap : taps) tap /= sum;
  return taps;
}

// Calls body(i, exp(j 2 pi frequency i)) for i in [0, n).
template <class Body>
void turning(double frequency, std::size_t n, const Body& body) {
  const Cf64 step = std::polar(1.0, kTwoPi * frequency);
  Cf64 turn{};
  for (std::size_t i = 0; i < n; ++i) {
    if (i % kTurnSamples == 0) {
      const double cycles = frequency * static_cast<double>(i);
      turn = std::polar(1.0, kTwoPi * (cycles - std::nearbyint(cycles)));
    }
    body(i, turn);
    turn = {turn.real() * step.real() - turn.imag() * step.imag(),
            turn.real() * step.imag() + turn.imag() * step.real()};
  }
}

Cf64 product(Cf64 a, Cf64 b) {
  return {a.real() * b.real() - a.imag() * b.imag(), a.real() * b.imag() + a.imag() * b.real()};
}
Cf64 wide(Cf32 x) { return {static_cast<double>(x.real()), static_cast<double>(x.imag())}; }
Cf32 narrow(Cf64 x) { return {static_cast<float>(x.real()), static_cast<float>(x.imag())}; }

// Runs body(first output, outputs, window of the first) over the outputs m in [0, n_out) whose windows begin at
// m stride - reach: those inside the capture at once, those over its edges one by one, with zeros outside.
template <class Body>
void windows(IqSpan in, std::size_t stride, std::size_t reach, std::size_t taps, std::size_t n_out,
             std::vector<Cf32>& edge, const Body& body) {
  const auto n = static_cast<std::ptrdiff_t>(in.size());
  const std::size_t first = std::min(n_out, (reach + stride - 1) / stride);
  const std::size_t fits = in.size() + reach >= taps ? (in.size() + reach - taps) / stride + 1 : 0;
  const std::size_t last = std::clamp(fits, first, n_out);
  const auto single = [&](std::size_t m) {
    const std::ptrdiff_t begin = static_cast<std::ptrdiff_t>(m * stride) - static_cast<std::ptrdiff_t>(reach);
    for (std::size_t k = 0; k < taps; ++k) {
      const std::ptrdiff_t i = begin + static_cast<std::ptrdiff_t>(k);
      edge[k] = i >= 0 && i < n ? in[static_cast<std::size_t>(i)] : Cf32{};
    }
    body(m, std::size_t{1}, edge.data());
  };
  for (std::size_t m = 0; m < first; ++m) single(m);
  if (last > first) body(first, last - first, in.data() + (first * stride - reach));
  for (std::size_t m = last; m < n_out; ++m) single(m);
}

}  // namespace

BandDecimator::BandDecimator(std::size_t factor, double passband, std::size_t max_samples) {
  if (factor == 1) return;
  second_ = factor >= 8 && factor % 4 == 0 ? 4 : 1;
  first_ = factor / second_;
  prototype_ = low_pass(first_, passband);
  real_.resize(2 * prototype_.size());
  imaginary_.resize(2 * prototype_.size());
  std::size_t longest = prototype_.size();
  if (second_ > 1) {
    const std::vector<double> taps = low_pass(second_, passband * static_cast<double>(first_));
    for (const double tap : taps) taps_.insert(taps_.end(), 2, static_cast<float>(tap));
    longest = std::max(longest, taps.size());
    middle_.resize(max_samples / first_ + 1);
  }
  edge_.resize(longest);
}

std::size_t BandDecimator::apply(IqSpan in, double frequency, double gain, Cf32* out) noexcept {
  if (first_ == 1) {
    turning(-frequency, in.size(),
            [&](std::size_t i, Cf64 turn) { out[i] = narrow(product(gain * wide(in[i]), turn)); });
    return in.size();
  }
  const std::size_t n_taps = prototype_.size();
  const auto reach = static_cast<std::ptrdiff_t>(n_taps / 2);
  for (std::size_t k = 0; k < n_taps; ++k) {
    const double cycles = -frequency * (static_cast<double>(k) - static_cast<double>(reach));
    const Cf64 tap = gain * prototype_[k] * std::polar(1.0, kTwoPi * cycles);
    real_[2 * k] = real_[2 * k + 1] = static_cast<float>(tap.real());
    imaginary_[2 * k] = imaginary_[2 * k + 1] = static_cast<float>(tap.imag());
  }
  Cf32* first_out = second_ > 1 ? middle_.data() : out;
  const std::size_t n_first = in.size() / first_;
  windows(in, first_, n_taps / 2, n_taps, n_first, edge_, [&](std::size_t m, std::size_t count, const Cf32* window) {
    decimate(real_.data(), imaginary_.data(), n_taps, window, first_, count, first_out + m);
  });
  turning(-frequency * static_cast<double>(first_), n_first,
          [&](std::size_t m, Cf64 turn) { first_out[m] = narrow(product(wide(first_out[m]), turn)); });
  if (second_ == 1) return n_first;
  const std::size_t n_second_taps = taps_.size() / 2;
  const std::size_t n_out = n_first / second_;
  windows({middle_.data(), n_first}, second_, n_second_taps / 2, n_second_taps, n_out, edge_,
          [&](std::size_t m, std::size_t count, const Cf32* window) {
            decimate(taps_.data(), n_second_taps, window, second_, count, out + m);
          });
  return n_out;
}

namespace {

constexpr std::size_t kStretchTaps = 32;
constexpr std::size_t kStretchPhases = 128;

}  // namespace

Stretcher::Stretcher(std::size_t max_samples)
    : table_((kStretchPhases + 1) * 2 * kStretchTaps), padded_(max_samples + 2 * kStretchTaps) {
  const KaiserSinc kernel(1.0, static_cast<double>(kStretchTaps), 90.0);
  for (std::size_t p = 0; p <= kStretchPhases; ++p) {
    const double fraction = static_cast<double>(p) / kStretchPhases;
    for (std::size_t k = 0; k < kStretchTaps; ++k) {
      // Sample k of the window lies at k - (taps / 2 - 1) from the whole part of the instant.
      const double t = static_cast<double>(k) - (kStretchTaps / 2.0 - 1.0) - fraction;
      const auto tap = static_cast<float>(kernel(t));
      table_[(p * kStretchTaps + k) * 2] = table_[(p * kStretchTaps + k) * 2 + 1] = tap;
    }
  }
}

void Stretcher::apply(Cf32* x, std::size_t n, double rate, double pivot) noexcept {
  std::fill_n(padded_.begin(), kStretchTaps, Cf32{});
  std::copy_n(x, n, padded_.begin() + kStretchTaps);
  std::fill_n(padded_.begin() + static_cast<std::ptrdiff_t>(kStretchTaps + n), kStretchTaps, Cf32{});
  for (std::size_t i = 0; i < n; ++i) {
    const double at = static_cast<double>(i) + rate * (static_cast<double>(i) - pivot);
    if (!(at >= 0.0 && at <= static_cast<double>(n) - 1.0)) {
      x[i] = {};
      continue;
    }
    const double whole = std::floor(at);
    const double phase = (at - whole) * kStretchPhases;
    const double row = std::min(std::floor(phase), kStretchPhases - 1.0);
    const float* low = table_.data() + static_cast<std::size_t>(row) * 2 * kStretchTaps;
    const Cf32* window = padded_.data() + kStretchTaps + static_cast<std::size_t>(whole) + 1 - kStretchTaps / 2;
    x[i] = dot_between(low, low + 2 * kStretchTaps, static_cast<float>(phase - row), window, kStretchTaps);
  }
}

namespace {

constexpr double kLineStep = 40.0;  // a line's bin stands out of the band's mean by this much
constexpr std::size_t kSegments = 4;

// Sums of x exp(-j 2 pi frequency i) over the quarters of x.
void demodulate(std::span<const Cf32> x, double frequency, Cf64 (&sums)[kSegments]) {
  for (Cf64& s : sums) s = {};
  const std::size_t length = x.size() / kSegments;
  turning(-frequency, length * kSegments,
          [&](std::size_t i, Cf64 turn) { sums[i / length] += product(wide(x[i]), turn); });
}

}  // namespace

std::size_t subtract_lines(std::span<Cf32> x, const Fft& fft, double band, Cf32* work, Cf32* spectrum,
                           std::span<Line> lines) noexcept {
  const auto size = static_cast<std::size_t>(fft.size());
  const auto transform = [&] {
    std::copy(x.begin(), x.end(), work);
    std::fill(work + x.size(), work + size, Cf32{});
    fft.execute(work, spectrum);
  };
  transform();
  std::size_t found = 0;
  while (found < lines.size()) {
    std::size_t at = 0, bins = 0;
    double largest = 0.0, sum = 0.0;
    for (std::size_t k = 0; k < size; ++k) {
      const double f =
          (k < (size + 1) / 2 ? static_cast<double>(k) : static_cast<double>(k) - static_cast<double>(size)) /
          static_cast<double>(size);
      if (std::abs(f) > band) continue;
      const double p = static_cast<double>(std::norm(spectrum[k]));
      sum += p;
      ++bins;
      if (p > largest) {
        largest = p;
        at = k;
      }
    }
    // The peak itself is left out of the mean it is held against.
    const double mean = (sum - largest) / static_cast<double>(std::max<std::size_t>(bins, 2) - 1);
    if (bins < 64 || !(largest > kLineStep * mean)) break;
    double frequency =
        (at < (size + 1) / 2 ? static_cast<double>(at) : static_cast<double>(at) - static_cast<double>(size)) /
        static_cast<double>(size);
    const std::size_t length = x.size() / kSegments;
    Cf64 sums[kSegments];
    for (int pass = 0; pass < 4; ++pass) {
      demodulate(x, frequency, sums);
      Cf64 turn{};
      for (std::size_t s = 1; s < kSegments; ++s) turn += product(sums[s], std::conj(sums[s - 1]));
      frequency += std::arg(turn) / (kTwoPi * static_cast<double>(length));
    }
    demodulate(x, frequency, sums);
    // Steady: every quarter holds its share. A burst's preamble does not.
    double least = std::abs(sums[0]), total = 0.0;
    Cf64 together{};
    for (const Cf64& s : sums) {
      least = std::min(least, std::abs(s));
      total += std::abs(s);
      together += s;
    }
    if (!(least > 0.4 * total / kSegments) || !(std::abs(together) > 0.6 * total)) break;
    const Cf64 amplitude = together / static_cast<double>(length * kSegments);
    turning(frequency, x.size(),
            [&](std::size_t i, Cf64 turn) { x[i] = narrow(wide(x[i]) - product(amplitude, turn)); });
    lines[found++] = {frequency, std::abs(amplitude)};
    transform();
  }
  return found;
}

std::size_t excise(std::span<Cf32> spectrum, double frequency, double level, std::size_t limit) noexcept {
  const auto size = static_cast<std::ptrdiff_t>(spectrum.size());
  const auto at = static_cast<std::ptrdiff_t>(std::llround(frequency * static_cast<double>(size)));
  std::size_t zeroed = 0;
  for (const std::ptrdiff_t way : {std::ptrdiff_t{1}, std::ptrdiff_t{-1}}) {
    constexpr std::ptrdiff_t kGroup = 6;
    for (std::ptrdiff_t out = 0; out < static_cast<std::ptrdiff_t>(limit); out += kGroup) {
      double power = 0.0;
      for (std::ptrdiff_t j = 0; j < kGroup; ++j) {
        const std::ptrdiff_t k = ((at + way * (out + j)) % size + size) % size;
        power += static_cast<double>(std::norm(spectrum[static_cast<std::size_t>(k)]));
      }
      if (power <= 3.0 * level * kGroup) break;
      for (std::ptrdiff_t j = 0; j < kGroup; ++j, ++zeroed) {
        const std::ptrdiff_t k = ((at + way * (out + j)) % size + size) % size;
        spectrum[static_cast<std::size_t>(k)] = {};
      }
    }
  }
  return zeroed;
}

BlockRange burst_blocks(std::span<const double> energy, double samples_per_block, double noise_power,
                        double independent) noexcept {
  const std::size_t n = energy.size();
  BlockRange all{0, n};
  if (n < 4) return all;
  double noise = noise_power * samples_per_block;
  if (!(noise > 0.0)) {
    // Not known: where the quietest quarter is far below the loudest, it is noise.
    const double most = *std::max_element(energy.begin(), energy.end());
    double sum = 0.0;
    std::size_t count = 0;
    for (const double e : energy) {
      if (e < 0.25 * most) {
        sum += e;
        ++count;
      }
    }
    if (count < 2) return all;
    noise = std::max(sum / static_cast<double>(count), 1e-12 * most);
  }
  // Largest sum of excesses in units of its own noise; it ends where the excess has fallen to half its mean.
  const double unit = std::sqrt(independent);
  double best = -1e300, whole = 0.0;
  BlockRange range = all;
  for (std::size_t i = 0; i < n; ++i) {
    double sum = 0.0;
    for (std::size_t j = i; j < n; ++j) {
      sum += energy[j] / noise - 1.0;
      const double score = sum * unit / std::sqrt(static_cast<double>(j + 1 - i));
      if (i == 0 && j + 1 == n) whole = score;
      if (score > best) {
        best = score;
        range = {i, j + 1};
      }
    }
  }
  if (best < whole + 3.0 || best < 6.0) return all;
  return {range.first > 0 ? range.first - 1 : 0, std::min(n, range.last + 1)};
}

}  // namespace soopnav::dsp::detail
