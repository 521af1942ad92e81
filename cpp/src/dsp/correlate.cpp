#include "soopnav/dsp/correlate.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "dsp/kernels.hpp"
#include "soopnav/dsp/fft.hpp"

namespace soopnav::dsp {
namespace {

constexpr std::size_t kMaxKernel = std::size_t{1} << 26;

// Work per output of a transform of `size` points: n log n, with the passes over memory counted in.
double cost_per_output(double size, double kernel) { return size * (std::log2(size) + 3.0) / (size - kernel + 1.0); }

// Powers of two from the first that holds the kernel twice; past 2^15 points the transform leaves the second-level
// cache, and only a long kernel makes that worth it.
int choose_fft_size(std::size_t kernel) {
  std::size_t size = 64;
  while (size < 2 * kernel) size *= 2;
  const auto k = static_cast<double>(kernel);
  while (size < (std::size_t{1} << 15) &&
         cost_per_output(2.0 * static_cast<double>(size), k) < cost_per_output(static_cast<double>(size), k)) {
    size *= 2;
  }
  return static_cast<int>(size);
}

int checked_fft_size(IqSpan kernel, int fft_size) {
  if (kernel.empty() || kernel.size() > kMaxKernel) {
    throw std::invalid_argument("kernel: 1 to 2^26 samples required, got " + std::to_string(kernel.size()));
  }
  for (std::size_t k = 0; k < kernel.size(); ++k) {
    if (!std::isfinite(kernel[k].real()) || !std::isfinite(kernel[k].imag())) {
      throw std::invalid_argument("kernel: finite samples required, sample " + std::to_string(k) + " is not");
    }
  }
  if (fft_size == 0) return choose_fft_size(kernel.size());
  if (fft_size < 0 || static_cast<std::size_t>(fft_size) < kernel.size()) {
    throw std::invalid_argument("fft_size: 0 or at least the kernel's " + std::to_string(kernel.size()) +
                                " required, got " + std::to_string(fft_size));
  }
  return fft_size;
}

}  // namespace

// Both kinds are the causal filter c[m] = sum_k g[k] x[m - k] with K taps: convolution has g = h and y[n] = c[n],
// correlation g[k] = conj(h[K - 1 - k]) and y[n] = c[n + K - 1].
struct OverlapSave::Impl {
  Impl(IqSpan kernel, FilterKind filter_kind, int n_fft)
      : kind(filter_kind),
        taps(kernel.size()),
        block(static_cast<std::size_t>(n_fft) - kernel.size() + 1),
        lead(filter_kind == FilterKind::kCorrelation ? kernel.size() - 1 : 0),
        forward(n_fft, FftDirection::kForward),
        inverse(n_fft, FftDirection::kInverse),
        response(static_cast<std::size_t>(n_fft)),
        spectrum(response.size()),
        work(response.size()),
        window(response.size()),
        stream(response.size()) {
    const float scale = 1.0F / static_cast<float>(n_fft);  // the transforms themselves do not scale
    for (std::size_t k = 0; k < taps; ++k) {
      work[k] = scale * (kind == FilterKind::kConvolution ? kernel[k] : std::conj(kernel[taps - 1 - k]));
    }
    forward.execute(work.data(), response.data());
  }

  // `samples`: fft_size inputs, the last `block` of them new. Leaves c for the new ones at work[taps - 1].
  void transform(const Cf32* samples) {
    forward.execute(samples, spectrum.data());
    detail::multiply(spectrum.data(), response.data(), spectrum.size());
    inverse.execute(spectrum.data(), work.data());
  }

  // Transforms the stream's buffer and writes its outputs except those before y[0] and those past `limit` in all.
  std::size_t finish_block(std::uint64_t limit, std::span<Cf32> out, std::size_t at) {
    transform(stream.data());
    const std::uint64_t begin = std::max<std::uint64_t>(done, lead);
    const std::uint64_t end = std::min<std::uint64_t>(done + block, limit);
    std::size_t count = 0;
    if (end > begin) {
      count = static_cast<std::size_t>(end - begin);
      std::copy_n(work.data() + taps - 1 + (begin - done), count, out.data() + at);
    }
    std::copy(stream.begin() + static_cast<std::ptrdiff_t>(block), stream.end(), stream.begin());
    done += block;
    filled = 0;
    return count;
  }

  FilterKind kind;
  std::size_t taps;
  std::size_t block;
  std::size_t lead;  // outputs c[0..lead-1] lie before y[0]
  Fft forward;
  Fft inverse;
  std::vector<Cf32> response;
  std::vector<Cf32> spectrum;
  std::vector<Cf32> work;
  std::vector<Cf32> window;  // inputs of a block that reaches over the capture's edge
  std::vector<Cf32> stream;  // taps - 1 old inputs, then up to `block` new ones
  std::size_t filled = 0;    // new inputs in `stream`
  std::uint64_t done = 0;    // outputs c computed so far
  std::uint64_t seen = 0;    // inputs so far
};

OverlapSave::OverlapSave(IqSpan kernel, FilterKind kind, int fft_size)
    : impl_(std::make_unique<Impl>(kernel, kind, checked_fft_size(kernel, fft_size))) {}
OverlapSave::~OverlapSave() = default;
OverlapSave::OverlapSave(OverlapSave&&) noexcept = default;
OverlapSave& OverlapSave::operator=(OverlapSave&&) noexcept = default;

void OverlapSave::apply(IqSpan in, std::int64_t first, std::span<Cf32> out) {
  Impl& self = *impl_;
  const auto n_in = static_cast<std::int64_t>(in.size());
  const auto n_taps = static_cast<std::int64_t>(self.taps);
  const auto n_fft = static_cast<std::int64_t>(self.work.size());
  for (std::size_t at = 0; at < out.size(); at += self.block) {
    const std::size_t count = std::min(self.block, out.size() - at);
    const std::int64_t causal = first + static_cast<std::int64_t>(at + self.lead);
    const std::int64_t begin = causal - (n_taps - 1);  // the first input of this block's transform
    const std::int64_t low = std::clamp<std::int64_t>(-begin, 0, n_fft);
    const std::int64_t high = std::clamp<std::int64_t>(n_in - begin, low, n_fft);
    if (high <= low) {
      std::fill_n(out.data() + at, count, Cf32{});
      continue;
    }
    if (low == 0 && high == n_fft) {
      self.transform(in.data() + begin);
    } else {
      std::fill(self.window.begin(), self.window.begin() + low, Cf32{});
      std::copy(in.data() + (begin + low), in.data() + (begin + high), self.window.begin() + low);
      std::fill(self.window.begin() + high, self.window.end(), Cf32{});
      self.transform(self.window.data());
    }
    std::copy_n(self.work.data() + self.taps - 1, count, out.data() + at);
  }
}

std::size_t OverlapSave::push_size(std::size_t n_in) const noexcept {
  const Impl& self = *impl_;
  const std::uint64_t blocks = (self.filled + n_in) / self.block;
  const std::uint64_t end = std::max<std::uint64_t>(self.done + blocks * self.block, self.lead);
  const std::uint64_t begin = std::max<std::uint64_t>(self.done, self.lead);
  return static_cast<std::size_t>(end - begin);
}

std::size_t OverlapSave::push(IqSpan in, std::span<Cf32> out) {
  Impl& self = *impl_;
  if (const std::size_t needed = push_size(in.size()); out.size() < needed) {
    throw std::invalid_argument("out: at least push_size() = " + std::to_string(needed) + " samples required, got " +
                                std::to_string(out.size()));
  }
  std::size_t written = 0;
  self.seen += in.size();
  while (!in.empty()) {
    const std::size_t count = std::min(self.block - self.filled, in.size());
    std::copy_n(in.data(), count, self.stream.data() + self.taps - 1 + self.filled);
    self.filled += count;
    in = in.subspan(count);
    if (self.filled == self.block) {
      written += self.finish_block(std::numeric_limits<std::uint64_t>::max(), out, written);
    }
  }
  return written;
}

std::size_t OverlapSave::flush_size() const noexcept {
  const Impl& self = *impl_;
  if (self.seen == 0) return 0;
  const std::uint64_t end = self.seen + self.taps - 1;
  return static_cast<std::size_t>(end - std::max<std::uint64_t>(self.done, self.lead));
}

std::size_t OverlapSave::flush(std::span<Cf32> out) {
  Impl& self = *impl_;
  const std::size_t needed = flush_size();
  if (out.size() < needed) {
    throw std::invalid_argument("out: at least flush_size() = " + std::to_string(needed) + " samples required, got " +
                                std::to_string(out.size()));
  }
  const std::uint64_t limit = self.seen + self.taps - 1;
  std::size_t written = 0;
  while (written < needed) {
    std::fill(self.stream.begin() + static_cast<std::ptrdiff_t>(self.taps - 1 + self.filled), self.stream.end(),
              Cf32{});
    written += self.finish_block(limit, out, written);
  }
  reset();
  return written;
}

void OverlapSave::reset() noexcept {
  Impl& self = *impl_;
  std::fill(self.stream.begin(), self.stream.end(), Cf32{});
  self.filled = 0;
  self.done = 0;
  self.seen = 0;
}

std::size_t OverlapSave::kernel_size() const noexcept { return impl_->taps; }
std::size_t OverlapSave::block_size() const noexcept { return impl_->block; }
int OverlapSave::fft_size() const noexcept { return impl_->forward.size(); }
FilterKind OverlapSave::kind() const noexcept { return impl_->kind; }

}  // namespace soopnav::dsp
