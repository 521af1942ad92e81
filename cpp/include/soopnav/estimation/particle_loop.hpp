#pragma once

#include <cstddef>

// Loops over packets are compiled for the baseline and for AVX2, and chosen between at run time. Not for anything with
// fused multiply-adds: a user's compiler would contract to them, and the bits would depend on the processor.
#if !defined(SOOPNAV_NO_TARGET_CLONES) && defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__)
#define SOOPNAV_WIDE_LOOPS 1
#else
#define SOOPNAV_WIDE_LOOPS 0
#endif

namespace soopnav::detail {

/// Calls `body(i)` with everything it does compiled into it, for the baseline instruction set or for AVX2.
template <class Body>
struct CompiledLoop {
  const Body& body;
  bool wide;

  void operator()(std::size_t piece) const {
#if SOOPNAV_WIDE_LOOPS
    if (wide) {
      run_wide(body, piece);
      return;
    }
#endif
    run_portable(body, piece);
  }

 private:
  [[gnu::flatten]] static void run_portable(const Body& b, std::size_t piece) { b(piece); }
#if SOOPNAV_WIDE_LOOPS
  [[gnu::flatten, gnu::target("avx2")]] static void run_wide(const Body& b, std::size_t piece) { b(piece); }
#endif
};

/// Whether this processor has the wider of the two.
[[nodiscard]] inline bool has_wide_loops() noexcept {
#if SOOPNAV_WIDE_LOOPS
  return __builtin_cpu_supports("avx2") != 0;
#else
  return false;
#endif
}

}  // namespace soopnav::detail
