// The kernels once more, without the wider vectors and under another name, for law_test.cpp to compare.
#ifndef SOOPNAV_NO_TARGET_CLONES
#define SOOPNAV_NO_TARGET_CLONES
#endif
#define detail detail_baseline
#include "dsp/kernels.cpp"
