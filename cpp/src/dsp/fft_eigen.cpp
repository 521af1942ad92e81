#include <algorithm>
#include <array>
#include <cstddef>
#include <mutex>
#include <stdexcept>
#include <string>
#include <unsupported/Eigen/FFT>
#include <vector>

#include "soopnav/dsp/fft.hpp"

namespace soopnav::dsp {
namespace {

// KissFFT keeps scratch inside its plan and cannot work in place, so what one call needs is a slot that it owns while
// it runs. With as many threads as slots no call waits for another.
constexpr std::size_t kSlots = 4;

struct Slot {
  std::mutex mutex;
  Eigen::FFT<float> fft;
  std::vector<Cf32> scratch;
};

}  // namespace

struct Fft::Impl {
  Impl(int n, FftDirection way) : size(n), direction(way) {
    if (n == 1) return;  // KissFFT cannot; execute() copies
    const std::vector<Cf32> zeros(static_cast<std::size_t>(n));
    for (Slot& slot : slots) {
      slot.fft.SetFlag(Eigen::FFT<float>::Unscaled);
      slot.scratch.resize(zeros.size());
      transform(slot, zeros.data(), slot.scratch.data());  // makes the tables, so that execute() allocates nothing
    }
  }

  void transform(Slot& slot, const Cf32* in, Cf32* out) const {
    if (direction == FftDirection::kForward) {
      slot.fft.fwd(out, in, size);
    } else {
      slot.fft.inv(out, in, size);
    }
  }

  void run(Slot& slot, const Cf32* in, Cf32* out) const {
    if (in == out) {
      transform(slot, in, slot.scratch.data());
      std::copy(slot.scratch.begin(), slot.scratch.end(), out);
    } else {
      transform(slot, in, out);
    }
  }

  int size;
  FftDirection direction;
  mutable std::array<Slot, kSlots> slots;
};

Fft::Fft(int size, FftDirection direction) {
  if (size < 1) throw std::invalid_argument("size: at least 1 required, got " + std::to_string(size));
  impl_ = std::make_unique<Impl>(size, direction);
}
Fft::~Fft() = default;
Fft::Fft(Fft&&) noexcept = default;
Fft& Fft::operator=(Fft&&) noexcept = default;

void Fft::execute(const Cf32* in, Cf32* out) const {
  if (impl_->size == 1) {
    *out = *in;
    return;
  }
  for (Slot& slot : impl_->slots) {
    const std::unique_lock lock(slot.mutex, std::try_to_lock);
    if (!lock) continue;
    impl_->run(slot, in, out);
    return;
  }
  const std::lock_guard lock(impl_->slots[0].mutex);
  impl_->run(impl_->slots[0], in, out);
}

int Fft::size() const noexcept { return impl_->size; }
FftDirection Fft::direction() const noexcept { return impl_->direction; }

const char* fft_library() noexcept { return "eigen"; }

}  // namespace soopnav::dsp
