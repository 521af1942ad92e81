#include <fftw3.h>

#include <algorithm>
#include <array>
#include <cstddef>
#include <mutex>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/dsp/fft.hpp"

namespace soopnav::dsp {
namespace {

// FFTW's planner keeps global tables and is not thread-safe; executing a plan is.
std::mutex& planner_mutex() {
  static std::mutex mutex;
  return mutex;
}

fftwf_complex* as_fftw(Cf32* samples) { return reinterpret_cast<fftwf_complex*>(samples); }

bool is_aligned(const Cf32* samples) {
  return fftwf_alignment_of(const_cast<float*>(reinterpret_cast<const float*>(samples))) == 0;
}

// A plan that promises alignment fails on other pointers, and one that promises none (FFTW_UNALIGNED) runs without
// vector instructions, two to five times slower. So there is one plan for each case that can occur: a complex float is
// either on FFTW's 16-byte grid or 8 bytes beside it, for input and for output. In-place plans are not used: FFTW's
// allocate while they run.
constexpr std::size_t kCases = 4;

std::size_t plan_case(bool in_aligned, bool out_aligned) { return (in_aligned ? 0U : 1U) + (out_aligned ? 0U : 2U); }

}  // namespace

struct Fft::Impl {
  Impl(int n, FftDirection way) : size(n), direction(way), scratch(static_cast<std::size_t>(n)) {
    // FFTW_ESTIMATE neither reads nor writes the arrays; only their alignment counts. It is also what makes two runs
    // on one machine give the same bits: measured plans depend on the load during planning.
    const auto length = static_cast<std::size_t>(n) + 1;
    std::vector<Cf32> a(length), b(length);
    const int sign = way == FftDirection::kForward ? FFTW_FORWARD : FFTW_BACKWARD;
    const unsigned flags = FFTW_ESTIMATE | FFTW_PRESERVE_INPUT;
    const std::size_t base_a = is_aligned(a.data()) ? 0 : 1;
    const std::size_t base_b = is_aligned(b.data()) ? 0 : 1;
    const std::lock_guard lock(planner_mutex());
    for (const bool in_aligned : {true, false}) {
      for (const bool out_aligned : {true, false}) {
        Cf32* in = a.data() + (in_aligned ? base_a : 1 - base_a);
        Cf32* out = b.data() + (out_aligned ? base_b : 1 - base_b);
        plans[plan_case(in_aligned, out_aligned)] = fftwf_plan_dft_1d(n, as_fftw(in), as_fftw(out), sign, flags);
      }
    }
    for (const fftwf_plan plan : plans) {
      if (plan == nullptr) {
        destroy();
        throw std::runtime_error("FFTW could not plan a transform of " + std::to_string(n) + " points");
      }
    }
  }
  ~Impl() {
    const std::lock_guard lock(planner_mutex());
    destroy();
  }
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  // The planner's mutex must be held.
  void destroy() noexcept {
    for (fftwf_plan& plan : plans) {
      if (plan != nullptr) fftwf_destroy_plan(plan);
      plan = nullptr;
    }
  }

  void run(const Cf32* in, Cf32* out) const {
    const fftwf_plan plan = plans[plan_case(is_aligned(in), is_aligned(out))];
    fftwf_execute_dft(plan, as_fftw(const_cast<Cf32*>(in)), as_fftw(out));
  }

  int size;
  FftDirection direction;
  std::array<fftwf_plan, kCases> plans{};
  std::mutex scratch_mutex;
  std::vector<Cf32> scratch;
};

Fft::Fft(int size, FftDirection direction) {
  if (size < 1) throw std::invalid_argument("size: at least 1 required, got " + std::to_string(size));
  impl_ = std::make_unique<Impl>(size, direction);
}
Fft::~Fft() = default;
Fft::Fft(Fft&&) noexcept = default;
Fft& Fft::operator=(Fft&&) noexcept = default;

void Fft::execute(const Cf32* in, Cf32* out) const {
  if (in != out) {
    impl_->run(in, out);
    return;
  }
  const std::lock_guard lock(impl_->scratch_mutex);
  impl_->run(in, impl_->scratch.data());
  std::copy(impl_->scratch.begin(), impl_->scratch.end(), out);
}

int Fft::size() const noexcept { return impl_->size; }
FftDirection Fft::direction() const noexcept { return impl_->direction; }

const char* fft_library() noexcept { return "fftw"; }

}  // namespace soopnav::dsp
