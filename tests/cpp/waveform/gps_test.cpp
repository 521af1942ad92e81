// GPS L1 C/A: codes, signals, loop noise.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <cstdlib>
#include <functional>
#include <limits>
#include <stdexcept>
#include <vector>

#include "soopnav/core/constants.hpp"
#include "soopnav/dsp/fft.hpp"
#include "soopnav/waveform/gps/ca_code.hpp"
#include "soopnav/waveform/gps/synthesis.hpp"
#include "soopnav/waveform/gps/tracking_noise.hpp"
#include "support/allocation_count.hpp"

namespace soopnav::gps {
namespace {

// IS-GPS-200N table 3-Ia: the first ten chips in octal, and the chips by which G2 is delayed.
constexpr std::array<int, 37> kFirstChips{01440, 01620, 01710, 01744, 01133, 01455, 01131, 01454, 01626, 01504,
                                          01642, 01750, 01764, 01772, 01775, 01776, 01156, 01467, 01633, 01715,
                                          01746, 01763, 01063, 01706, 01743, 01761, 01770, 01774, 01127, 01453,
                                          01625, 01712, 01745, 01713, 01134, 01456, 01713};
constexpr std::array<int, 37> kDelays{5,   6,   7,   8,   17,  18,  139, 140, 141, 251, 252, 254, 255,
                                      256, 257, 258, 469, 470, 471, 472, 473, 474, 509, 512, 513, 514,
                                      515, 516, 859, 860, 861, 862, 863, 950, 947, 948, 950};

TEST(CaCode, FirstChipsOfTheTable) {
  for (int prn = 1; prn <= 37; ++prn) {
    const CaCode code = ca_code(prn);
    int octal = 0;
    for (std::size_t i = 0; i < 10; ++i) octal = 2 * octal + (code[i] < 0 ? 1 : 0);
    EXPECT_EQ(octal, kFirstChips[static_cast<std::size_t>(prn - 1)]) << prn;
  }
  for (const int prn : {0, -1, 38}) EXPECT_THROW(static_cast<void>(ca_code(prn)), std::invalid_argument);
}

// The other definition of the same table: G1 times G2 delayed. Recurrences straight from the polynomials.
TEST(CaCode, IsG1TimesDelayedG2) {
  std::vector<int> g1(1023, 1);
  std::vector<int> g2(1023, 1);
  for (std::size_t n = 10; n < 1023; ++n) {
    g1[n] = (g1[n - 3] + g1[n - 10]) % 2;
    g2[n] = (g2[n - 2] + g2[n - 3] + g2[n - 6] + g2[n - 8] + g2[n - 9] + g2[n - 10]) % 2;
  }
  for (int prn = 1; prn <= 37; ++prn) {
    const CaCode code = ca_code(prn);
    const auto delay = static_cast<std::size_t>(kDelays[static_cast<std::size_t>(prn - 1)]);
    for (std::size_t n = 0; n < 1023; ++n) {
      ASSERT_EQ(code[n], 1 - 2 * ((g1[n] + g2[(n + 1023 - delay) % 1023]) % 2)) << prn << " chip " << n;
    }
  }
}

TEST(CaCode, CorrelationsOfAGoldCode) {
  const auto correlation = [](const CaCode& a, const CaCode& b, std::size_t shift) {
    int sum = 0;
    for (std::size_t n = 0; n < kCodeLength; ++n) sum += a[n] * b[(n + shift) % kCodeLength];
    return sum;
  };
  const CaCode a = ca_code(3);
  const CaCode b = ca_code(19);
  EXPECT_EQ(correlation(a, a, 0), 1023);
  for (std::size_t shift = 0; shift < kCodeLength; ++shift) {
    if (shift > 0) {
      const int own = correlation(a, a, shift);
      ASSERT_TRUE(own == -1 || own == -65 || own == 63) << shift << ": " << own;
    }
    const int cross = correlation(a, b, shift);
    ASSERT_TRUE(cross == -1 || cross == -65 || cross == 63) << shift << ": " << cross;
  }
  int ones = 0;
  for (const std::int8_t chip : a) ones += chip < 0 ? 1 : 0;
  EXPECT_EQ(ones, 512);  // balanced, as half of the codes are
}

SatelliteSignal satellite(int prn, double delay_s, double doppler_hz) {
  SatelliteSignal s;
  s.prn = prn;
  s.delay_s = delay_s;
  s.doppler_hz = doppler_hz;
  return s;
}

// A satellite is found where it was put: circular correlation over one code, by transforms, over Dopplers.
TEST(Signal, DelayAndDopplerAreFound) {
  constexpr double kRate = 4.092e6;
  constexpr std::size_t kSamples = 4092;  // one code
  constexpr std::size_t kBlocks = 4;
  const double delay_s = 0.3137e-3;
  const double doppler_hz = 2250.0;
  std::vector<SatelliteSignal> sky{satellite(12, delay_s, doppler_hz), satellite(25, 0.8e-3, -1300.0)};
  sky[0].cn0_dbhz = sky[1].cn0_dbhz = 48.0;
  const SignalGenerator generator(sky, kRate);
  std::vector<Cf32> received(kSamples * kBlocks);
  generator.render(0, received, RandomStream(11));

  SatelliteSignal replica = satellite(12, 0.0, 0.0);
  replica.cn0_dbhz = 10.0 * std::log10(kRate);  // amplitude 1
  std::vector<Cf32> code(kSamples);
  SignalGenerator({replica}, kRate).render(0, code);
  const dsp::Fft forward(static_cast<int>(kSamples), dsp::FftDirection::kForward);
  const dsp::Fft inverse(static_cast<int>(kSamples), dsp::FftDirection::kInverse);
  std::vector<Cf32> spectrum(kSamples);
  std::vector<Cf32> work(kSamples);
  std::vector<Cf32> product(kSamples);
  forward.execute(code.data(), spectrum.data());
  double best = 0.0;
  double mean = 0.0;
  std::size_t cells = 0;
  double found_delay = 0.0;
  double found_doppler = 0.0;
  for (double f = -4000.0; f <= 4000.0; f += 250.0) {
    std::vector<double> power(kSamples, 0.0);
    for (std::size_t block = 0; block < kBlocks; ++block) {
      for (std::size_t n = 0; n < kSamples; ++n) {
        const double turn = f * static_cast<double>(n) / kRate;
        work[n] = received[block * kSamples + n] * Cf32(std::polar(1.0, -kTwoPi * turn));
      }
      forward.execute(work.data(), product.data());
      for (std::size_t n = 0; n < kSamples; ++n) product[n] *= std::conj(spectrum[n]);
      inverse.execute(product.data(), work.data());
      for (std::size_t n = 0; n < kSamples; ++n) power[n] += static_cast<double>(std::norm(work[n]));
    }
    for (std::size_t n = 0; n < kSamples; ++n) {
      mean += power[n];
      ++cells;
      if (power[n] <= best) continue;
      best = power[n];
      found_delay = static_cast<double>(n) / kRate;
      found_doppler = f;
    }
  }
  EXPECT_NEAR(found_delay, delay_s, 1.0 / kRate);
  EXPECT_EQ(found_doppler, doppler_hz);
  // Coherent over 1 ms: (C/N0 = 48 dBHz) * 1 ms = 63 times the noise, four blocks added; a noise cell of four blocks
  // exceeds 8 times its mean once in 5e10.
  EXPECT_GT(best * static_cast<double>(cells) / mean, 20.0);
}

TEST(Signal, PhaseDataAndCodeFollowTheirLaws) {
  constexpr double kRate = 2.046e6;
  SatelliteSignal s = satellite(5, 0.25e-3, 1234.5);
  s.phase_cycles = 0.2;
  s.cn0_dbhz = 10.0 * std::log10(kRate);
  s.bits = {1, -1, -1};
  const SignalGenerator generator({s}, kRate, 1e5);
  std::vector<Cf32> x(static_cast<std::size_t>(kRate * 0.05));
  generator.render(0, x);
  const CaCode code = ca_code(5);
  double worst = 0.0;
  for (std::size_t n = 0; n < x.size(); ++n) {
    const double t = static_cast<double>(n) / kRate;
    const double sent = (1.0 + s.doppler_hz / kCarrierHz) * t - s.delay_s;
    const double chip = sent * kChipRateHz;
    if (std::abs(chip - std::round(chip)) < 1e-6) continue;  // on the edge of a chip either is right
    const auto k = static_cast<long>(std::floor(chip));
    const auto bit = static_cast<long>(std::floor(sent / kBitPeriodS));
    const double sign = code[static_cast<std::size_t>(((k % 1023) + 1023) % 1023)] *
                        static_cast<double>(s.bits[static_cast<std::size_t>(((bit % 3) + 3) % 3)]);
    const std::complex<double> expected = sign * std::polar(1.0, kTwoPi * ((1e5 + s.doppler_hz) * t + 0.2));
    worst = std::max(worst, std::abs(std::complex<double>(x[n]) - expected));
  }
  EXPECT_LT(worst, 1e-4);
}

TEST(Signal, BlocksJoinWithoutASeam) {
  SatelliteSignal s = satellite(9, -0.7e-3, -3210.0);
  s.bits = {-1, 1};
  const SignalGenerator generator({s, satellite(1, 0.0, 100.0)}, 5e6, 1.2e6);
  std::vector<Cf32> whole(9000);
  generator.render(1000, whole, RandomStream(2));
  std::vector<Cf32> part(4000);
  generator.render(6000, part, RandomStream(2));
  double worst = 0.0;
  for (std::size_t n = 0; n < part.size(); ++n) {
    worst = std::max(worst, static_cast<double>(std::abs(part[n] - whole[5000 + n])));
  }
  EXPECT_LT(worst, 1e-5);
  std::vector<Cf32> again(9000);
  generator.render(1000, again, RandomStream(2));
  EXPECT_TRUE(std::equal(whole.begin(), whole.end(), again.begin()));
}

TEST(Signal, PowerIsTheStatedDensity) {
  SatelliteSignal s = satellite(4, 0.0, 0.0);
  s.cn0_dbhz = 45.0;
  const double rate = 4e6;
  std::vector<Cf32> x(40'000);
  SignalGenerator({s}, rate).render(0, x);
  double power = 0.0;
  for (const Cf32& v : x) power += static_cast<double>(std::norm(v));
  EXPECT_NEAR(10.0 * std::log10(power / static_cast<double>(x.size()) * rate), 45.0, 1e-3);
}

TEST(Signal, Refusals) {
  const auto refuses = [](const std::function<void(SatelliteSignal&)>& spoil, double rate = 4e6, double f = 0.0) {
    SatelliteSignal s;
    spoil(s);
    EXPECT_THROW(SignalGenerator({s}, rate, f), std::invalid_argument);
  };
  const double nan = std::numeric_limits<double>::quiet_NaN();
  refuses([](SatelliteSignal& s) { s.prn = 38; });
  refuses([nan](SatelliteSignal& s) { s.delay_s = nan; });
  refuses([](SatelliteSignal& s) { s.doppler_hz = 2e6; });
  refuses([nan](SatelliteSignal& s) { s.phase_cycles = nan; });
  refuses([nan](SatelliteSignal& s) { s.cn0_dbhz = nan; });
  refuses([](SatelliteSignal& s) { s.bits = {1, 0}; });
  refuses([](SatelliteSignal&) {}, 0.0);
  refuses([](SatelliteSignal&) {}, 4e6, 3e6);
}

TEST(LoopNoise, Values) {
  // carter eq. 2.24: B_l 15 Hz at 42 dB-Hz is 0.0308 rad, 0.93 mm.
  EXPECT_NEAR(phase_sigma_rad(42.0), std::sqrt(15.0 / std::pow(10.0, 4.2)), 1e-15);
  EXPECT_NEAR(phase_sigma_m(42.0), 0.93e-3, 0.005e-3);
  EXPECT_NEAR(phase_sigma_rad(48.0) / phase_sigma_rad(28.0), 0.1, 1e-12);
  const PhaseLoop loop{.bandwidth_hz = 15.0, .power_fraction = 0.5, .oscillator_rad = 0.03, .dynamics_rad = 0.04};
  EXPECT_NEAR(std::pow(phase_sigma_rad(42.0, loop), 2), 2.0 * 15.0 / std::pow(10.0, 4.2) + 0.0025, 1e-15);
  EXPECT_GT(phase_sigma_rad(25.0, {.integration_s = 1e-3}), 1.4 * phase_sigma_rad(25.0));
  EXPECT_NEAR(code_sigma_m(45.0), kSpeedOfLightMps / kChipRateHz * std::sqrt(0.125 / 31622.7766), 0.002);
  EXPECT_LT(code_sigma_m(45.0, {.early_late_chips = 0.1}), 0.5 * code_sigma_m(45.0));
  EXPECT_TRUE(std::isnan(phase_sigma_rad(std::nan(""))));
}

TEST(LoopNoise, Refusals) {
  EXPECT_THROW(PhaseLoop{.bandwidth_hz = 0.0}.check(), std::invalid_argument);
  EXPECT_THROW(PhaseLoop{.power_fraction = 1.1}.check(), std::invalid_argument);
  EXPECT_THROW(PhaseLoop{.oscillator_rad = -1.0}.check(), std::invalid_argument);
  EXPECT_THROW(PhaseLoop{.dynamics_rad = -1.0}.check(), std::invalid_argument);
  EXPECT_THROW(PhaseLoop{.integration_s = 0.0}.check(), std::invalid_argument);
  EXPECT_THROW(CodeLoop{.bandwidth_hz = 0.0}.check(), std::invalid_argument);
  EXPECT_THROW(CodeLoop{.early_late_chips = 1.5}.check(), std::invalid_argument);
  EXPECT_THROW(CodeLoop{.integration_s = 0.0}.check(), std::invalid_argument);
}

TEST(NoAllocation, Render) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "this allocator cannot be counted";
  const SignalGenerator generator({satellite(2, 0.0, 10.0)}, 4e6);
  std::vector<Cf32> x(1000);
  EXPECT_EQ(test::allocations_of([&] { generator.render(0, x, RandomStream(1)); }), 0);
  EXPECT_GT(test::allocations_of([&] { x.reserve(5000); }), 0);
}

}  // namespace
}  // namespace soopnav::gps
