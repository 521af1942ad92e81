#pragma once

// Counts heap allocations of the whole program. Include it in exactly one source file of a test program: it replaces
// malloc and its kin, which operator new and Eigen both end in. Without glibc, and under sanitizers, which bring their
// own malloc, nothing is counted and `kAllocationsCounted` is false: skip the test then.

#include <atomic>
#include <cstddef>
#include <cstdlib>

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define SOOPNAV_TEST_COUNTS_ALLOCATIONS 0
#elif defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer)
#define SOOPNAV_TEST_COUNTS_ALLOCATIONS 0
#endif
#endif
#if !defined(SOOPNAV_TEST_COUNTS_ALLOCATIONS)
#if defined(__GLIBC__)
#define SOOPNAV_TEST_COUNTS_ALLOCATIONS 1
#else
#define SOOPNAV_TEST_COUNTS_ALLOCATIONS 0
#endif
#endif

namespace soopnav::test {

inline constexpr bool kAllocationsCounted = SOOPNAV_TEST_COUNTS_ALLOCATIONS != 0;
inline std::atomic<long> allocation_count{0};

/// Allocations made by `body()`.
template <class Body>
long allocations_of(Body&& body) {
  const long before = allocation_count.load();
  body();
  return allocation_count.load() - before;
}

}  // namespace soopnav::test

#if SOOPNAV_TEST_COUNTS_ALLOCATIONS
extern "C" {
void* __libc_malloc(std::size_t size);                           // NOLINT
void* __libc_calloc(std::size_t count, std::size_t size);        // NOLINT
void* __libc_realloc(void* pointer, std::size_t size);           // NOLINT
void* __libc_memalign(std::size_t alignment, std::size_t size);  // NOLINT

void* malloc(std::size_t size) {
  soopnav::test::allocation_count.fetch_add(1, std::memory_order_relaxed);
  return __libc_malloc(size);
}
void* calloc(std::size_t count, std::size_t size) {
  soopnav::test::allocation_count.fetch_add(1, std::memory_order_relaxed);
  return __libc_calloc(count, size);
}
void* realloc(void* pointer, std::size_t size) {
  soopnav::test::allocation_count.fetch_add(1, std::memory_order_relaxed);
  return __libc_realloc(pointer, size);
}
void* aligned_alloc(std::size_t alignment, std::size_t size) {
  soopnav::test::allocation_count.fetch_add(1, std::memory_order_relaxed);
  return __libc_memalign(alignment, size);
}
}
#endif
