// The kernels once more, without the wider vectors and under another name, for array_test.cpp to compare.
#ifndef SOOPNAV_NO_TARGET_CLONES
#define SOOPNAV_NO_TARGET_CLONES
#endif
#define kernels kernels_baseline
#include "array/kernels.cpp"
