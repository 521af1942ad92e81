#include "soopnav/dsp/resample.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>

#include "dsp/kaiser.hpp"
#include "dsp/kernels.hpp"

namespace soopnav::dsp {
namespace {

__extension__ typedef __int128 Wide;

constexpr std::uint64_t kMaxUp = 1024;
constexpr double kMaxStep = 1024.0;
constexpr double kMaxStart = 0x1p50;
constexpr double kMaxCoefficients = 0x1p24;
constexpr std::size_t kStreamChunk = 4096;
// How far below the design's ripple the error of interpolating between filters is kept.
constexpr double kGridMarginDb = 12.0;

void check(const ResampleDesign& design) {
  if (!(design.passband > 0.0 && design.passband < 1.0)) {
    throw std::invalid_argument("passband: in (0, 1) of half the lower rate required, got " +
                                std::to_string(design.passband));
  }
  if (!(design.stopband > design.passband && design.stopband <= 2.0 - design.passband + 1e-12)) {
    throw std::invalid_argument("stopband: above the passband and at most 2 - passband required, got " +
                                std::to_string(design.stopband));
  }
  if (!(design.attenuation_db >= 20.0 && design.attenuation_db <= 110.0)) {
    throw std::invalid_argument("attenuation_db: 20 to 110 required, got " + std::to_string(design.attenuation_db));
  }
}

void check_start(double start) {
  if (!(std::abs(start) <= kMaxStart)) {
    throw std::invalid_argument("start_samples: finite and at most 2^50 in magnitude required, got " +
                                std::to_string(start));
  }
}

void check_rate(const char* name, double rate_hz) {
  if (!(std::isfinite(rate_hz) && rate_hz > 0.0)) {
    throw std::invalid_argument(std::string(name) + ": finite and positive required, got " + std::to_string(rate_hz));
  }
}

std::uint64_t fraction_bits(double fraction) { return static_cast<std::uint64_t>(std::ldexp(fraction, 64)); }

struct Ratio {
  int up;
  int down;
};

// The convergents of in / out, until one gives the rates back exactly.
std::optional<Ratio> small_ratio(double in_rate_hz, double out_rate_hz) {
  double x = in_rate_hz / out_rate_hz;
  double down = std::floor(x), up = 1.0, last_down = 1.0, last_up = 0.0;
  while (up <= static_cast<double>(kMaxUp) && down <= kMaxStep * up) {
    if (down >= 1.0 && in_rate_hz * up == out_rate_hz * down) {
      return Ratio{static_cast<int>(up), static_cast<int>(down)};
    }
    const double rest = x - std::floor(x);
    if (!(rest > 1e-12)) break;
    x = 1.0 / rest;
    const double term = std::floor(x);
    last_down = std::exchange(down, term * down + last_down);
    last_up = std::exchange(up, term * up + last_up);
  }
  return std::nullopt;
}

}  // namespace

Resampler Resampler::rational(int up, int down, const ResampleDesign& design, double start_samples) {
  if (up < 1) throw std::invalid_argument("up: at least 1 required, got " + std::to_string(up));
  if (down < 1) throw std::invalid_argument("down: at least 1 required, got " + std::to_string(down));
  const int divisor = std::gcd(up, down);
  const auto reduced_up = static_cast<std::uint64_t>(up / divisor);
  const auto reduced_down = static_cast<std::uint64_t>(down / divisor);
  if (reduced_up > kMaxUp) {
    throw std::invalid_argument("up: at most 1024 after reduction required, got " + std::to_string(reduced_up));
  }
  const double step = static_cast<double>(reduced_down) / static_cast<double>(reduced_up);
  if (step > kMaxStep) {
    throw std::invalid_argument("down: at most 1024 times up required, got " + std::to_string(down));
  }
  return {reduced_up, reduced_down, step, design, start_samples};
}

Resampler Resampler::arbitrary(double step_samples, const ResampleDesign& design, double start_samples) {
  if (!(step_samples >= 1.0 / kMaxStep && step_samples <= kMaxStep)) {
    throw std::invalid_argument("step_samples: in [1/1024, 1024] required, got " + std::to_string(step_samples));
  }
  return {0, 0, step_samples, design, start_samples};
}

Resampler Resampler::between(double in_rate_hz, double out_rate_hz, const ResampleDesign& design,
                             double start_samples) {
  check_rate("in_rate_hz", in_rate_hz);
  check_rate("out_rate_hz", out_rate_hz);
  if (const auto ratio = small_ratio(in_rate_hz, out_rate_hz)) {
    return rational(ratio->up, ratio->down, design, start_samples);
  }
  return arbitrary(in_rate_hz / out_rate_hz, design, start_samples);
}

Resampler::Resampler(std::uint64_t up, std::uint64_t down, double step, const ResampleDesign& design, double start)
    : start_(start), step_(step), up_(up) {
  check(design);
  check_start(start);

  // Everything relative to the input's rate: the lower of the two rates sets the band.
  const double band = std::min(1.0, 1.0 / step);
  const double width_rad = std::numbers::pi * band * (design.stopband - design.passband);
  const double attenuation_db = design.attenuation_db + detail::kMarginDb;
  const double span = detail::kaiser_span(attenuation_db, width_rad);
  const double grid_error = std::pow(10.0, -(design.attenuation_db + kGridMarginDb) / 20.0);
  if (up_ == 0) {
    const double rows = std::numbers::pi * band * design.stopband / std::sqrt(8.0 * grid_error);
    while (std::ldexp(1.0, static_cast<int>(phase_bits_)) < rows || phase_bits_ < 2) ++phase_bits_;
  }
  phases_ = up_ != 0 ? static_cast<std::size_t>(up_) : std::size_t{1} << phase_bits_;
  const std::size_t rows = up_ != 0 ? phases_ : phases_ + 1;
  if (!(2.0 * span * static_cast<double>(rows) <= kMaxCoefficients)) {
    throw std::invalid_argument("design: at most 2^24 coefficients required, got " + std::to_string(rows) +
                                " phases of " + std::to_string(span) + " taps");
  }
  const double chunks = std::ceil(span / static_cast<double>(detail::kDotSamples));
  taps_ = detail::kDotSamples * static_cast<std::size_t>(chunks);

  const double whole = std::floor(start);
  double fraction = start - whole;
  origin_.sample = static_cast<std::int64_t>(whole);
  if (up_ != 0) {
    const auto phases = static_cast<double>(up_);
    const double phase = std::min(std::floor(fraction * phases), phases - 1.0);
    origin_.fraction = static_cast<std::uint64_t>(phase);
    fraction -= phase / phases;
    advance_ = {static_cast<std::int64_t>(down / up), down % up};
  } else {
    origin_.fraction = fraction_bits(fraction);
    fraction = 0.0;
    const double step_whole = std::floor(step);
    advance_ = {static_cast<std::int64_t>(step_whole), fraction_bits(step - step_whole)};
  }

  const detail::KaiserSinc kernel(0.5 * band * (design.passband + design.stopband), static_cast<double>(taps_),
                                  attenuation_db);
  table_.resize(2 * rows * taps_);
  const double centre = 0.5 * static_cast<double>(taps_) - 1.0;
  for (std::size_t row = 0; row < rows; ++row) {
    const double phase = static_cast<double>(row) / static_cast<double>(phases_) + fraction;
    for (std::size_t k = 0; k < taps_; ++k) {
      const auto tap = static_cast<float>(kernel(phase + centre - static_cast<double>(k)));
      table_[2 * (row * taps_ + k)] = tap;
      table_[2 * (row * taps_ + k) + 1] = tap;
    }
  }
  edge_.resize(taps_);
  buffer_.resize(taps_ + std::max(taps_, kStreamChunk));
  reset();
}

Resampler::Position Resampler::position(std::int64_t output) const noexcept {
  if (up_ != 0) {
    const auto up = static_cast<std::int64_t>(up_);
    const std::int64_t down = advance_.sample * up + static_cast<std::int64_t>(advance_.fraction);
    const std::int64_t turns = output >= 0 ? output / up : -((up - 1 - output) / up);
    const std::int64_t phase = (output - turns * up) * down + static_cast<std::int64_t>(origin_.fraction);
    return {origin_.sample + turns * down + phase / up, static_cast<std::uint64_t>(phase % up)};
  }
  const Wide fraction = static_cast<Wide>(output) * advance_.fraction + origin_.fraction;
  return {origin_.sample + output * advance_.sample + static_cast<std::int64_t>(fraction >> 64),
          static_cast<std::uint64_t>(fraction)};
}

Resampler::Position Resampler::after(Position p) const noexcept {
  p.sample += advance_.sample;
  p.fraction += advance_.fraction;
  if (up_ == 0) {
    if (p.fraction < advance_.fraction) ++p.sample;  // the sum wrapped
  } else if (p.fraction >= up_) {
    p.fraction -= up_;
    ++p.sample;
  }
  return p;
}

// Outputs m >= 0 whose time lies before that input sample.
std::uint64_t Resampler::outputs_before(std::int64_t sample) const noexcept {
  const double estimate = std::ceil((static_cast<double>(sample) - start_) / step_);
  auto count = static_cast<std::int64_t>(std::max(estimate, 0.0));
  while (count > 0 && position(count - 1).sample >= sample) --count;
  while (position(count).sample < sample) ++count;
  return static_cast<std::uint64_t>(count);
}

std::int64_t Resampler::window_begin(Position p) const noexcept {
  return p.sample - static_cast<std::int64_t>(taps_ / 2) + 1;
}

Cf32 Resampler::output(Position p, const Cf32* window) const noexcept {
  const std::size_t row_size = 2 * taps_;
  if (up_ != 0) return detail::dot(table_.data() + p.fraction * row_size, window, taps_);
  const float* low = table_.data() + (p.fraction >> (64U - phase_bits_)) * row_size;
  const auto between = static_cast<float>(std::ldexp(static_cast<double>(p.fraction << phase_bits_), -64));
  return detail::dot_between(low, low + row_size, between, window, taps_);
}

std::size_t Resampler::output_size(std::size_t n_in) const noexcept {
  return static_cast<std::size_t>(outputs_before(static_cast<std::int64_t>(n_in)));
}

void Resampler::apply(IqSpan in, std::int64_t first, std::span<Cf32> out) {
  const auto n_in = static_cast<std::int64_t>(in.size());
  const auto n_taps = static_cast<std::int64_t>(taps_);
  Position p = position(first);
  for (Cf32& y : out) {
    const std::int64_t begin = window_begin(p);
    if (begin >= 0 && begin + n_taps <= n_in) {
      y = output(p, in.data() + begin);
    } else {
      const std::int64_t low = std::clamp<std::int64_t>(-begin, 0, n_taps);
      const std::int64_t high = std::clamp<std::int64_t>(n_in - begin, low, n_taps);
      std::fill(edge_.begin(), edge_.begin() + low, Cf32{});
      if (high > low) std::copy(in.data() + (begin + low), in.data() + (begin + high), edge_.begin() + low);
      std::fill(edge_.begin() + high, edge_.end(), Cf32{});
      y = output(p, edge_.data());
    }
    p = after(p);
  }
}

// Appends `n_in` samples (zeros when `in` is null), the first of them input number `index`, and writes what is then
// complete, up to `limit` outputs in all.
std::size_t Resampler::feed(const Cf32* in, std::uint64_t n_in, std::int64_t index, std::uint64_t limit, Cf32* out) {
  std::size_t count = 0;
  while (n_in > 0) {
    const std::int64_t wanted = buffer_begin_ + static_cast<std::int64_t>(filled_);
    if (index < wanted) {  // a start beyond the first sample, or a step longer than the filter
      const std::uint64_t skipped = std::min(n_in, static_cast<std::uint64_t>(wanted - index));
      index += static_cast<std::int64_t>(skipped);
      n_in -= skipped;
      if (in != nullptr) in += skipped;
      continue;
    }
    const auto copied = static_cast<std::size_t>(std::min<std::uint64_t>(buffer_.size() - filled_, n_in));
    if (in != nullptr) {
      std::copy_n(in, copied, buffer_.data() + filled_);
      in += copied;
    } else {
      std::fill_n(buffer_.data() + filled_, copied, Cf32{});
    }
    filled_ += copied;
    index += static_cast<std::int64_t>(copied);
    n_in -= copied;
    const std::int64_t end = buffer_begin_ + static_cast<std::int64_t>(filled_);
    while (written_ < limit && window_begin(next_) + static_cast<std::int64_t>(taps_) <= end) {
      out[count++] = output(next_, buffer_.data() + (window_begin(next_) - buffer_begin_));
      next_ = after(next_);
      ++written_;
    }
    if (filled_ == buffer_.size()) {
      const std::int64_t keep = window_begin(next_);
      const std::int64_t used = std::min(keep - buffer_begin_, static_cast<std::int64_t>(filled_));
      std::copy(buffer_.begin() + used, buffer_.end(), buffer_.begin());
      filled_ -= static_cast<std::size_t>(used);
      buffer_begin_ = filled_ == 0 ? keep : buffer_begin_ + used;
    }
  }
  return count;
}

std::size_t Resampler::push_size(std::size_t n_in) const noexcept {
  if (n_in == 0) return 0;
  const auto end = static_cast<std::int64_t>(seen_ + n_in);
  return static_cast<std::size_t>(outputs_before(end - static_cast<std::int64_t>(taps_ / 2)) - written_);
}

std::size_t Resampler::push(IqSpan in, std::span<Cf32> out) {
  const std::size_t needed = push_size(in.size());
  if (out.size() < needed) {
    throw std::invalid_argument("out: at least push_size() = " + std::to_string(needed) + " samples required, got " +
                                std::to_string(out.size()));
  }
  if (in.empty()) return 0;
  const std::uint64_t limit = written_ + needed;
  std::size_t count = 0;
  if (seen_ == 0 && buffer_begin_ < 0) {
    count = feed(nullptr, static_cast<std::uint64_t>(-buffer_begin_), buffer_begin_, limit, out.data());
  }
  count += feed(in.data(), in.size(), static_cast<std::int64_t>(seen_), limit, out.data() + count);
  seen_ += in.size();
  return count;
}

std::size_t Resampler::flush_size() const noexcept {
  if (seen_ == 0) return 0;
  const std::uint64_t whole = outputs_before(static_cast<std::int64_t>(seen_));
  return static_cast<std::size_t>(whole - written_);
}

std::size_t Resampler::flush(std::span<Cf32> out) {
  const std::size_t needed = flush_size();
  if (out.size() < needed) {
    throw std::invalid_argument("out: at least flush_size() = " + std::to_string(needed) + " samples required, got " +
                                std::to_string(out.size()));
  }
  const std::size_t count = feed(nullptr, taps_, static_cast<std::int64_t>(seen_), written_ + needed, out.data());
  reset();
  return count;
}

void Resampler::reset() noexcept {
  filled_ = 0;
  seen_ = 0;
  written_ = 0;
  next_ = position(0);
  buffer_begin_ = window_begin(next_);
}

std::vector<Cf32> resample(IqSpan in, double in_rate_hz, double out_rate_hz, const ResampleDesign& design) {
  Resampler resampler = Resampler::between(in_rate_hz, out_rate_hz, design);
  std::vector<Cf32> out(resampler.output_size(in.size()));
  resampler.apply(in, 0, out);
  return out;
}

}  // namespace soopnav::dsp
