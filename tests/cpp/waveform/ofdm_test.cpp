// Synthesis and correlator against their definitions, and what is refused.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <complex>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/waveform/ofdm/boundary.hpp"
#include "soopnav/waveform/ofdm/correlator.hpp"
#include "soopnav/waveform/ofdm/synthesis.hpp"
#include "soopnav/waveform/ofdm/two_ray.hpp"
#include "support/nan.hpp"

namespace soopnav::ofdm {
namespace {

using testing::StartsWith;

using ::soopnav::test::kNan;

std::vector<Cf32> string_of(const Numerology& numerology, int symbols, std::uint64_t seed = 1) {
  std::vector<Cf32> out(static_cast<std::size_t>(symbols * numerology.symbol_samples()));
  RandomStream random(seed);
  Synthesizer(numerology).fill(out, random);
  return out;
}

template <class Call>
std::string refusal(Call&& call) {
  try {
    call();
  } catch (const std::invalid_argument& error) {
    return error.what();
  }
  return "";
}

TEST(OfdmNumerology, LengthsOfTheDefault) {
  const Numerology numerology;
  EXPECT_EQ(numerology.symbol_samples(), 80);
  EXPECT_DOUBLE_EQ(numerology.symbol_s(), 4e-6);
  EXPECT_NEAR(numerology.ambiguity_m(), 1199.169832, 1e-9);
  EXPECT_NEAR(numerology.sample_m(), 14.9896229, 1e-9);
}

TEST(OfdmRefusals, NameTheParameterItsValueAndTheRule) {
  EXPECT_EQ(refusal([] { check({1, 16, 20e6}); }), "subcarriers: 1; it must be 2 to 65536");
  EXPECT_THAT(refusal([] { check({64, 64, 20e6}); }), StartsWith("prefix: 64; it must be at least 1 and below"));
  EXPECT_THAT(refusal([] { check({64, 0, 20e6}); }), StartsWith("prefix: 0"));
  EXPECT_THAT(refusal([] { check({64, 16, kNan}); }), StartsWith("sample_rate_hz: nan"));
  EXPECT_THAT(refusal([] { CyclicPrefixCorrelator({}, 0); }), StartsWith("symbols: 0; it must be 1 to"));
  EXPECT_THAT(refusal([] { CyclicPrefixCorrelator({}, 1, 0); }), StartsWith("oversampling: 0"));
  EXPECT_THAT(refusal([] {
                BoundaryEstimator({}, 250, 1, {BoundaryMethod::kInterpolated, kNan});
              }),
              StartsWith("snr_db: nan; it must lie between -60 and 100"));
  EXPECT_THAT(refusal([] {
                BoundaryEstimator({}, 250, 15, {BoundaryMethod::kInterpolated, {}});
              }),
              StartsWith("oversampling: 15; it must be 1 for interpolated"));
  EXPECT_THAT(refusal([] {
                BoundaryEstimator({512, 36, 7.68e6}, 250, 1, {BoundaryMethod::kInterpolated, {}});
              }),
              StartsWith("subcarriers + prefix: 548"));
  EXPECT_THAT(refusal([] { TwoRayTiming({}, 250, {9.0, 30.0, 1.0}); }), StartsWith("reach_samples: 9"));
  EXPECT_THAT(refusal([] { TwoRayTiming({}, 250, {3.0, 50.0, 1.0}); }), StartsWith("snr_db: 50"));
  EXPECT_THAT(refusal([] { static_cast<void>(delay_crlb_m(0.0, 0)); }), StartsWith("symbols: 0"));
  EXPECT_THAT(refusal([] { static_cast<void>(delay_crlb_m(kNan, 1)); }), StartsWith("snr_db: nan"));
}

TEST(OfdmSynthesis, PrefixAndInverseTransformOfConstellationPoints) {
  for (const auto constellation : {Constellation::kQpsk, Constellation::kQam16, Constellation::kQam64}) {
    const Numerology numerology{48, 12, 1e6};
    Synthesizer synthesizer(numerology, constellation);
    RandomStream random(7);
    std::vector<Cf32> x(60 * 400 + 5, Cf32(9.0F, 9.0F));
    synthesizer.fill(x, random);
    EXPECT_EQ(random.position(), 400 * synthesizer.draws_per_symbol());
    for (std::size_t i = 60 * 400; i < x.size(); ++i) EXPECT_EQ(x[i], Cf32{});
    const double side = constellation == Constellation::kQpsk ? 2 : constellation == Constellation::kQam16 ? 4 : 8;
    const double unit = 1.0 / std::sqrt(2.0 / 3.0 * (side * side - 1.0));
    double power = 0.0, extreme = 0.0;
    for (std::size_t s = 0; s < 400; s += 37) {
      const Cf32* symbol = &x[60 * s];
      for (std::size_t i = 0; i < 12; ++i) EXPECT_EQ(symbol[i], symbol[48 + i]);
      for (int k = 0; k < 48; ++k) {  // the transform written out
        std::complex<double> point{};
        for (int n = 0; n < 48; ++n) {
          point += std::complex<double>(symbol[12 + n]) * std::polar(1.0 / std::sqrt(48.0), -2.0 * M_PI * k * n / 48.0);
        }
        for (const double part : {point.real(), point.imag()}) {
          const double level = part / unit;  // an odd whole number
          EXPECT_NEAR(std::remainder(level - 1.0, 2.0), 0.0, 1e-4);
          extreme = std::max(extreme, std::abs(level));
        }
      }
    }
    EXPECT_NEAR(extreme, side - 1.0, 1e-3);
    for (std::size_t i = 0; i < 60 * 400; ++i) power += static_cast<double>(std::norm(x[i])) / (60 * 400);
    EXPECT_NEAR(power, 1.0, 0.04);  // 19200 points; 64-QAM's |X|^2 has a standard deviation of 0.62
  }
}

TEST(OfdmCorrelator, EqualsTheDoubleSum) {
  struct Case {
    Numerology numerology;
    int symbols, oversampling;
  };
  for (const Case& c : {Case{{}, 250, 1}, Case{{12, 5, 1e6}, 7, 1}, Case{{64, 16, 20e6}, 3, 15},
                        Case{{10, 9, 1e6}, 70, 3}, Case{{2, 1, 1e6}, 1, 1}}) {
    CyclicPrefixCorrelator correlator(c.numerology, c.symbols, c.oversampling);
    std::vector<Cf32> y(correlator.required_samples());
    RandomStream random(3);
    random.fill_complex_normal(y);
    ASSERT_EQ(correlator.fold(y, true), BoundaryStatus::kOk);
    const std::size_t period = correlator.period(), lag = correlator.lag(), window = correlator.window();
    double scale = 0.0, error = 0.0, energy_error = 0.0;
    for (std::size_t m = 0; m < period; ++m) {
      std::complex<double> sum{};
      for (std::size_t k = 0; k < correlator.symbols(); ++k) {
        for (std::size_t i = m; i < m + window; ++i) {
          sum += std::complex<double>(y[period * k + i]) * std::conj(std::complex<double>(y[period * k + i + lag]));
        }
      }
      scale = std::max(scale, std::abs(sum));
      error = std::max(error, std::abs(sum - correlator.gamma()[m]));
    }
    for (std::size_t i = 0; i + 1 < period + window; ++i) {
      double sum = 0.0;
      for (std::size_t k = 0; k < correlator.symbols(); ++k) {
        sum += std::norm(std::complex<double>(y[period * k + i])) +
               std::norm(std::complex<double>(y[period * k + i + lag]));
      }
      energy_error = std::max(energy_error, std::abs(sum - correlator.energies()[i]) / sum);
    }
    EXPECT_LT(error, 1e-5 * scale) << c.symbols;
    EXPECT_LT(energy_error, 2e-6) << c.symbols;
    EXPECT_EQ(correlator.fold(std::span(y).first(y.size() - 1), true), BoundaryStatus::kTooShort);
  }
}

TEST(OfdmBoundary, EveryStatus) {
  for (const auto method : {BoundaryMethod::kNearestSample, BoundaryMethod::kMagnitude,
                            BoundaryMethod::kMaximumLikelihood, BoundaryMethod::kInterpolated}) {
    BoundaryEstimator estimator({}, 10, 1, {method, std::nullopt});
    auto y = string_of({}, 11);
    EXPECT_EQ(estimator.estimate(y).status, BoundaryStatus::kOk);
    EXPECT_EQ(estimator.estimate(std::span(y).first(878)).status, BoundaryStatus::kTooShort);
    EXPECT_EQ(estimator.estimate(std::span(y).first(879)).status, BoundaryStatus::kOk);
    EXPECT_EQ(estimator.estimate({}).status, BoundaryStatus::kTooShort);
    for (const std::size_t at : {0U, 79U, 399U, 800U, 877U}) {
      for (const float bad : {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity(), 1e30F}) {
        auto z = y;
        z[at] = {0.0F, bad};
        const Boundary b = estimator.estimate(z);
        EXPECT_EQ(b.status, BoundaryStatus::kNonFinite) << at << " " << bad;
        EXPECT_EQ(b.boundary_m, 0.0);
      }
    }
    const std::vector<Cf32> silence(880);
    EXPECT_EQ(estimator.estimate(silence).status, BoundaryStatus::kNoSignal);
    EXPECT_EQ(estimator.estimate(y).status, BoundaryStatus::kOk);  // nothing stays behind
  }
  EXPECT_EQ(to_string(BoundaryStatus::kNoBoundary), "no boundary");
  EXPECT_EQ(to_string(static_cast<BoundaryStatus>(99)), "unknown");
}

TEST(OfdmTwoRay, EveryStatus) {
  TwoRayTiming timing({}, 250);
  BoundaryEstimator estimator({}, 250);
  const auto y = string_of({}, 251);
  ASSERT_EQ(estimator.estimate(y).status, BoundaryStatus::kOk);
  std::vector<double> folded(80);
  estimator.folded_differences(folded);
  const auto found = timing.estimate(folded, 3.0, 1.0);
  EXPECT_EQ(found.status, BoundaryStatus::kOk);
  EXPECT_FALSE(found.two_rays);
  EXPECT_NEAR(found.range_m, 0.0, 1.0);
  EXPECT_NEAR(timing.estimate(folded, 3.0 + 5.0 * Numerology{}.ambiguity_m(), 1.0).range_m,
              5.0 * Numerology{}.ambiguity_m(), 1.0);
  EXPECT_EQ(timing.estimate(folded, 600.0, 1.0).status, BoundaryStatus::kNoBoundary);
  EXPECT_EQ(timing.estimate(std::span(folded).first(79), 0.0, 1.0).status, BoundaryStatus::kTooShort);
  EXPECT_EQ(timing.estimate(folded, kNan, 1.0).status, BoundaryStatus::kNonFinite);
  EXPECT_EQ(timing.estimate(folded, 0.0, kNan).status, BoundaryStatus::kNonFinite);
  folded[3] = kNan;
  EXPECT_EQ(timing.estimate(folded, 0.0, 1.0).status, BoundaryStatus::kNonFinite);
  EXPECT_EQ(timing.estimate(std::vector<double>(80), 0.0, 1.0).status, BoundaryStatus::kNoSignal);
  EXPECT_THROW(estimator.folded_differences(std::span(folded).first(79)), std::invalid_argument);
}

// Laws.

TEST(OfdmBoundaryLaw, ASampleLaterIsASampleMoreAndAGainChangesNothing) {
  const auto y = string_of({}, 260);
  const auto louder = [](std::vector<Cf32> z) {
    for (Cf32& x : z) x *= Cf32(-0.03F, 40.0F);
    return z;
  };
  for (const auto method : {BoundaryMethod::kNearestSample, BoundaryMethod::kMagnitude,
                            BoundaryMethod::kMaximumLikelihood, BoundaryMethod::kInterpolated}) {
    BoundaryEstimator estimator({}, 250, 1, {method, std::nullopt});
    for (const std::size_t late : {0U, 1U, 2U, 39U, 79U}) {
      const Boundary b = estimator.estimate(std::span(y).subspan(80 - late));
      EXPECT_NEAR(std::remainder(b.boundary_samples - static_cast<double>(late), 80.0), 0.0, 0.01);
      EXPECT_NEAR(std::remainder(b.boundary_m - static_cast<double>(late) * Numerology{}.sample_m(),
                                 Numerology{}.ambiguity_m()),
                  0.0, 0.2);
      EXPECT_GT(b.metric, 0.999);
      EXPECT_LE(b.metric, 1.0);
      EXPECT_NEAR(b.cfo_hz, 0.0, 1.0);
    }
    const auto z = louder(y);
    const Boundary one = estimator.estimate(std::span(y).subspan(7)),
                   other = estimator.estimate(std::span(z).subspan(7));
    EXPECT_NEAR(one.boundary_samples, other.boundary_samples, 1e-3);
    EXPECT_NEAR(one.metric, other.metric, 1e-5);
  }
}

TEST(OfdmBoundaryLaw, CarrierOffsetsComeBackWithTheirSign) {
  for (const auto method : {BoundaryMethod::kNearestSample, BoundaryMethod::kMagnitude,
                            BoundaryMethod::kMaximumLikelihood, BoundaryMethod::kInterpolated}) {
    BoundaryEstimator estimator({}, 250, 1, {method, std::nullopt});
    for (const double cfo_hz : {-40e3, -1e3, 25e3}) {
      auto y = string_of({}, 251);
      for (std::size_t n = 0; n < y.size(); ++n) {
        y[n] *= Cf32(std::polar(1.0, 2.0 * M_PI * cfo_hz * static_cast<double>(n) / 20e6));
      }
      const Boundary b = estimator.estimate(std::span(y).subspan(0));
      EXPECT_NEAR(b.cfo_hz, cfo_hz, 2.0);
      EXPECT_NEAR(std::remainder(b.boundary_samples, 80.0), 0.0, 0.01);
    }
  }
}

TEST(OfdmBoundaryLaw, MagnitudesDoNotMindACarrierOffset) {
  auto y = string_of({}, 251);
  for (std::size_t n = 0; n < y.size(); ++n) {  // nearly half the carriers' spacing: the sum's real part is negative
    y[n] *= Cf32(std::polar(1.0, 2.0 * M_PI * 150e3 * static_cast<double>(n) / 20e6));
  }
  for (const auto method :
       {BoundaryMethod::kMagnitude, BoundaryMethod::kMaximumLikelihood, BoundaryMethod::kInterpolated}) {
    const Boundary b = BoundaryEstimator({}, 250, 1, {method, std::nullopt}).estimate(y);
    EXPECT_NEAR(std::remainder(b.boundary_samples, 80.0), 0.0, 0.01);
    EXPECT_NEAR(b.cfo_hz, 150e3, 2.0);
  }
  const Boundary real = BoundaryEstimator({}, 250).estimate(y);
  EXPECT_GT(std::abs(std::remainder(real.boundary_samples, 80.0)), 5.0);
}

TEST(OfdmBoundaryLaw, TheBoundShrinksWithSymbolsAndSnr) {
  EXPECT_NEAR(delay_crlb_m(3.0, 100) / delay_crlb_m(3.0, 400), 2.0, 1e-9);
  EXPECT_NEAR(delay_crlb_m(3.0, 9, {64, 16, 10e6}) / delay_crlb_m(3.0, 9), 2.0, 1e-9);
  for (double snr_db = -20.0; snr_db < 30.0; snr_db += 1.0) {
    EXPECT_GT(delay_crlb_m(snr_db, 250), delay_crlb_m(snr_db + 1.0, 250));
  }
  // A fraction and its mirror image know as much; far below 0 dB sigma goes with the inverse of the SNR.
  EXPECT_NEAR(delay_crlb_samples(5.0, 250, {}, 0.2) / delay_crlb_samples(5.0, 250, {}, 0.8), 1.0, 1e-3);
  EXPECT_NEAR(delay_crlb_samples(-50.0, 1, {}, 0.3) / delay_crlb_samples(-40.0, 1, {}, 0.3), 10.0, 0.01);
}

}  // namespace
}  // namespace soopnav::ofdm
