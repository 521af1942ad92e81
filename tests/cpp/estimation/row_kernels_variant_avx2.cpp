// The kernels once more, without AVX-512 and under another name, for row_kernels_law_test.cpp to compare. Where AVX2
// cannot be chosen at run time, the baseline again.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__)
#define SOOPNAV_ROW_SETS 1
#else
#define SOOPNAV_ROW_SETS 0
#endif
#define detail detail_avx2
#include "estimation/row_kernels.cpp"
#include "estimation/row_kernels_exercise.hpp"

namespace soopnav::test {
std::vector<double> exercise_avx2(int n, std::uint64_t seed);
std::vector<double> exercise_avx2(int n, std::uint64_t seed) { return exercise(n, seed); }
}  // namespace soopnav::test
