#pragma once

// Counts every call of malloc and operator new in the program. Include it in one source file of an executable.
// Sanitizers bring their own allocator, so there the count is not available and tests skip.

#include <atomic>
#include <cstddef>
#include <cstdlib>
#include <new>

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define SOOPNAV_COUNTS_ALLOCATIONS 0
#elif defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer)
#define SOOPNAV_COUNTS_ALLOCATIONS 0
#endif
#endif
#if !defined(SOOPNAV_COUNTS_ALLOCATIONS)
#if defined(__GLIBC__)
#define SOOPNAV_COUNTS_ALLOCATIONS 1
#else
#define SOOPNAV_COUNTS_ALLOCATIONS 0
#endif
#endif

namespace soopnav::test {
inline std::atomic<long> allocations{0};
}  // namespace soopnav::test

#if SOOPNAV_COUNTS_ALLOCATIONS
// The C library's own entry; operator new and Eigen's aligned allocation both end in malloc.
extern "C" void* __libc_malloc(std::size_t size);
extern "C" void* malloc(std::size_t size) {
  soopnav::test::allocations.fetch_add(1, std::memory_order_relaxed);
  return __libc_malloc(size);
}
#endif
