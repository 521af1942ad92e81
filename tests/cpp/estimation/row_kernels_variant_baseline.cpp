// The kernels once more, without wider vectors and under another name, for row_kernels_law_test.cpp to compare.
#define SOOPNAV_ROW_SETS 0
#define detail detail_baseline
#include "estimation/row_kernels.cpp"
#include "estimation/row_kernels_exercise.hpp"

namespace soopnav::test {
std::vector<double> exercise_baseline(int n, std::uint64_t seed);
std::vector<double> exercise_baseline(int n, std::uint64_t seed) { return exercise(n, seed); }
}  // namespace soopnav::test
