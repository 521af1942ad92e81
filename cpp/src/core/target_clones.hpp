#pragma once

#include <cstddef>  // defines __GLIBC__ where it applies

/// Compiles a hot kernel twice, for AVX2 and for the baseline, and picks one when the program is loaded.
///
/// Kernels marked so must give the same bits either way: element by element, or summed in a fixed number of lanes in a
/// fixed order. That is why the wider set is AVX2 alone and not x86-64-v3: given FMA instructions, GCC 12 fuses complex
/// products into them (vfmaddsub) even under -ffp-contract=off. Empty where the compiler or the C
/// library cannot choose at load time, and when SOOPNAV_NO_TARGET_CLONES is defined (sanitizer builds).
#ifndef SOOPNAV_TARGET_CLONES
#if !defined(SOOPNAV_NO_TARGET_CLONES) && defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__) && \
    !defined(__clang__)
#define SOOPNAV_TARGET_CLONES __attribute__((target_clones("avx2", "default")))
#else
#define SOOPNAV_TARGET_CLONES
#endif
#endif

/// As SOOPNAV_TARGET_CLONES with AVX-512 besides, for kernels of real arithmetic element by element: AVX-512 has fused
/// multiply-adds, which -ffp-contract=off keeps out of everything but complex products.
#ifndef SOOPNAV_TARGET_CLONES_WIDE
#if !defined(SOOPNAV_NO_TARGET_CLONES) && defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__) && \
    !defined(__clang__)
#define SOOPNAV_TARGET_CLONES_WIDE __attribute__((target_clones("avx512f", "avx2", "default")))
#else
#define SOOPNAV_TARGET_CLONES_WIDE
#endif
#endif
