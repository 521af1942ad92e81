#include <gtest/gtest.h>

#include <atomic>
#include <cstdlib>
#include <memory>
#include <new>

#include "dsp/signals.hpp"
#include "soopnav/dsp/correlate.hpp"
#include "soopnav/dsp/fft.hpp"
#include "soopnav/dsp/fractional_delay.hpp"
#include "soopnav/dsp/peak.hpp"
#include "soopnav/dsp/resample.hpp"

// A sanitizer's own allocator may not be replaced; there only operator new is counted.
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__) || !defined(__GLIBC__)
#define SOOPNAV_COUNT_MALLOC 0
#else
#define SOOPNAV_COUNT_MALLOC 1
#endif
#if defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer)
#undef SOOPNAV_COUNT_MALLOC
#define SOOPNAV_COUNT_MALLOC 0
#endif
#endif

namespace {
std::atomic<long> allocations{0};
}

#if SOOPNAV_COUNT_MALLOC
extern "C" {
void* __libc_malloc(std::size_t size);
void* __libc_calloc(std::size_t count, std::size_t size);
void* __libc_realloc(void* old, std::size_t size);
void* __libc_memalign(std::size_t alignment, std::size_t size);

void* malloc(std::size_t size) {
  ++allocations;
  return __libc_malloc(size);
}
void* calloc(std::size_t count, std::size_t size) {
  ++allocations;
  return __libc_calloc(count, size);
}
void* realloc(void* old, std::size_t size) {
  ++allocations;
  return __libc_realloc(old, size);
}
void* memalign(std::size_t alignment, std::size_t size) {
  ++allocations;
  return __libc_memalign(alignment, size);
}
void* aligned_alloc(std::size_t alignment, std::size_t size) {
  ++allocations;
  return __libc_memalign(alignment, size);
}
int posix_memalign(void** out, std::size_t alignment, std::size_t size) {
  ++allocations;
  *out = __libc_memalign(alignment, size);
  return *out == nullptr ? 12 : 0;
}
}
#else
// Out of line, or GCC takes the inlined halves for a mismatch.
#define SOOPNAV_NOINLINE __attribute__((noinline))
SOOPNAV_NOINLINE void* operator new(std::size_t size) {
  ++allocations;
  if (void* memory = std::malloc(size)) return memory;
  throw std::bad_alloc();
}
SOOPNAV_NOINLINE void operator delete(void* memory) noexcept { std::free(memory); }
SOOPNAV_NOINLINE void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }
#endif

namespace soopnav::dsp {
namespace {

using testing::noise;

template <class Call>
long allocations_of(Call&& call) {
  const long before = allocations;
  call();
  return allocations - before;
}

TEST(NoAllocation, TheCounterCounts) {
  EXPECT_GT(allocations_of([] { std::vector<Cf32>(1000).swap(*std::make_unique<std::vector<Cf32>>()); }), 0);
}

TEST(NoAllocation, Fft) {
  for (const int size : {1, 62, 64, 75, 128, 600, 1536, 1920, 2048, 9600, 32768, 153600}) {
    for (const FftDirection direction : {FftDirection::kForward, FftDirection::kInverse}) {
      const Fft fft(size, direction);
      auto in = noise(static_cast<std::size_t>(size) + 1, 1);
      std::vector<Cf32> out(in.size());
      for (const std::size_t shift : {0U, 1U}) {
        EXPECT_EQ(allocations_of([&] { fft.execute(in.data() + shift, out.data()); }), 0) << size;
        EXPECT_EQ(allocations_of([&] { fft.execute(in.data(), out.data() + shift); }), 0) << size;
        EXPECT_EQ(allocations_of([&] { fft.execute(in.data() + shift, in.data() + shift); }), 0) << size;
      }
    }
  }
}

TEST(NoAllocation, OverlapSave) {
  OverlapSave filter(noise(137, 1), FilterKind::kCorrelation);
  const auto x = noise(20000, 2);
  std::vector<Cf32> y(20200);
  EXPECT_EQ(allocations_of([&] {
              filter.apply(x, -100, y);
              std::size_t n = filter.push(x, y);
              n += filter.push(std::span(x).first(17), std::span(y).subspan(n));
              filter.flush(std::span(y).subspan(n));
              filter.reset();
            }),
            0);
}

TEST(NoAllocation, FractionalDelay) {
  auto sinc = FractionalDelay::windowed_sinc(0.3);
  auto lagrange = FractionalDelay::lagrange(0.3, 7);
  const auto x = noise(5000, 2);
  std::vector<Cf32> y(5000);
  std::vector<double> taps(static_cast<std::size_t>(sinc_tap_count({})));
  bool ok = true;
  EXPECT_EQ(allocations_of([&] {
              for (auto* filter : {&sinc, &lagrange}) {
                ok = filter->set_delay(1.7) && ok;
                filter->apply(x, -20, y);
              }
              sinc_delay_taps(0.2, {}, taps);
              lagrange_delay_taps(1.2, std::span(taps).first(4));
            }),
            0);
  EXPECT_TRUE(ok);
}

TEST(NoAllocation, Resampler) {
  const auto x = noise(20000, 2);
  std::vector<Cf32> y(40000);
  for (auto resampler : {Resampler::rational(1, 10), Resampler::rational(3, 2), Resampler::arbitrary(0.777)}) {
    EXPECT_EQ(allocations_of([&] {
                resampler.apply(x, -100, y);
                std::size_t n = resampler.push(x, y);
                n += resampler.flush(std::span(y).subspan(n));
                resampler.reset();
              }),
              0);
  }
}

TEST(NoAllocation, Peak) {
  const PeakRefiner refiner;
  std::vector<Cf32> r(100);
  r[49] = r[51] = {0.6F, 0.0F};
  r[50] = {1.0F, 0.0F};
  std::optional<Peak> a, b;
  std::optional<std::size_t> index;
  EXPECT_EQ(allocations_of([&] {
              index = largest_sample(r);
              a = parabolic_peak(r, 50);
              b = refiner.refine(r, 50);
            }),
            0);
  EXPECT_TRUE(a && b && index);
}

}  // namespace
}  // namespace soopnav::dsp
