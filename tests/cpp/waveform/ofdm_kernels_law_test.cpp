// The width of the vectors changes no bit.

#include <gtest/gtest.h>

#include <span>
#include <vector>

#include "soopnav/core/random.hpp"
#include "waveform/ofdm/kernels.hpp"

namespace soopnav::ofdm {

namespace kernels_baseline {
// kernels.cpp compiled for the baseline only, in ofdm_kernels_baseline.cpp.
void fold(const Cf32* y, std::size_t rows, std::size_t columns, std::size_t lag, double* same, double* swap,
          double* power) noexcept;
double pair_weights(const float* gap, float floor, float rho, float* weight, float* twice, std::size_t n) noexcept;
float dot2(const float* a, const float* x, const float* b, const float* y, std::size_t n) noexcept;
double mixture_cost(const float* e, const float* a, const float* b, float floor, float share, std::size_t n) noexcept;
}  // namespace kernels_baseline

namespace {

TEST(OfdmKernelsLaw, SameBitsForAnyVectorWidth) {
  RandomStream random(1);
  for (const std::size_t columns : {3U, 16U, 80U, 83U, 1200U}) {
    for (const std::size_t rows : {1U, 9U, 70U}) {
      const std::size_t lag = columns - 1;
      std::vector<Cf32> y(rows * columns + lag);
      random.fill_complex_normal(y);
      std::vector<double> a(6 * columns), b(6 * columns);
      const auto part = [columns](std::vector<double>& all, std::size_t i) { return all.data() + 2 * i * columns; };
      kernels::fold(y.data(), rows, columns, lag, part(a, 0), part(a, 1), part(a, 2));
      kernels_baseline::fold(y.data(), rows, columns, lag, part(b, 0), part(b, 1), part(b, 2));
      EXPECT_EQ(a, b) << columns << " " << rows;
    }
  }
  for (const std::size_t n : {8U, 80U, 256U}) {
    std::vector<float> x(n), y(n), u(n), v(n), w(n), t(n), w2(n), t2(n);
    for (std::vector<float>* values : {&x, &y, &u, &v}) {
      for (float& value : *values) value = static_cast<float>(random.uniform(1e-4, 1.0));
    }
    EXPECT_EQ(kernels::dot2(x.data(), y.data(), u.data(), v.data(), n),
              kernels_baseline::dot2(x.data(), y.data(), u.data(), v.data(), n));
    EXPECT_EQ(kernels::pair_weights(x.data(), 0.01F, 0.99F, w.data(), t.data(), n),
              kernels_baseline::pair_weights(x.data(), 0.01F, 0.99F, w2.data(), t2.data(), n));
    EXPECT_EQ(w, w2);
    EXPECT_EQ(t, t2);
    EXPECT_EQ(kernels::mixture_cost(x.data(), y.data(), u.data(), 0.002F, 0.3F, n - 3),
              kernels_baseline::mixture_cost(x.data(), y.data(), u.data(), 0.002F, 0.3F, n - 3));
  }
}

}  // namespace
}  // namespace soopnav::ofdm
