#include "soopnav/array/calibration.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "soopnav/core/constants.hpp"
#include "soopnav/core/random.hpp"
#include "support/allocation_count.hpp"

namespace soopnav::array {
namespace {

using Complex = std::complex<double>;
constexpr double kRate = 1e6;
constexpr double kTone = 61e3;

std::vector<Cf32> tone(std::size_t samples, double frequency_hz, double amplitude = 0.5, double phase_rad = 0.3) {
  std::vector<Cf32> out(samples);
  for (std::size_t n = 0; n < samples; ++n) {
    out[n] = Cf32(std::polar(amplitude, phase_rad + kTwoPi * std::fmod(frequency_hz / kRate * double(n), 1.0)));
  }
  return out;
}

// The model of ChannelCorrection, written out again.
std::vector<Cf32> faulty(const std::vector<Cf32>& x, const ChannelCorrection& c) {
  std::vector<Cf32> out(x.size());
  for (std::size_t n = 0; n < x.size(); ++n) {
    const Complex y = c.gain * Complex(x[n]);
    const double q = c.iq_gain * (y.imag() * std::cos(c.iq_phase_rad) + y.real() * std::sin(c.iq_phase_rad));
    out[n] = Cf32(Complex(y.real(), q) + c.dc);
  }
  return out;
}

ChannelCorrection fault(double gain_db, double phase_deg, Complex dc, Complex gain) {
  return {std::pow(10.0, gain_db / 20.0), phase_deg * kPi / 180.0, dc, gain};
}

std::vector<Cf32> rows(const std::vector<std::vector<Cf32>>& channels) {
  std::vector<Cf32> out;
  for (const auto& row : channels) out.insert(out.end(), row.begin(), row.end());
  return out;
}

TEST(Calibration, UndoesTheModelExactly) {
  const ChannelCorrection c = fault(2.0, 10.0, {0.05, -0.03}, std::polar(0.8, 2.0));
  const auto x = tone(200, 33e3);
  auto y = faulty(x, c);
  apply_correction(c, y);
  for (std::size_t n = 0; n < x.size(); ++n) EXPECT_NEAR(std::abs(y[n] - x[n]), 0.0F, 5e-7F);
  EXPECT_NEAR(20.0 * std::log10(std::abs(c.image())), -16.82, 0.01);
  EXPECT_TRUE(c.valid());
  EXPECT_FALSE((ChannelCorrection{0.0, 0.0, {}, 1.0}).valid());
}

TEST(Calibration, RecoversFaultsWithoutNoiseAndAFrequencyThatIsOff) {
  const std::vector<ChannelCorrection> faults{fault(2.0, 10.0, {0.05, -0.03}, 1.0),
                                              fault(-1.5, -8.0, {0.0, 0.02}, std::polar(0.7, -2.9)),
                                              fault(0.0, 0.0, {}, std::polar(1.4, 1.0))};
  for (const double sign : {1.0, -1.0}) {
    std::vector<std::vector<Cf32>> channels;
    for (const auto& c : faults) channels.push_back(faulty(tone(5000, sign * (kTone + 470.0)), c));
    const auto report = calibrate(rows(channels), 3, kRate, sign * kTone);
    ASSERT_EQ(report.status, CalibrationStatus::kOk);
    EXPECT_NEAR(report.tone_hz, sign * (kTone + 470.0), 1e-4);
    for (std::size_t m = 0; m < 3; ++m) {
      const ChannelCorrection& c = report.channels[m].correction;
      EXPECT_NEAR(c.iq_gain, faults[m].iq_gain, 1e-7);
      EXPECT_NEAR(c.iq_phase_rad, faults[m].iq_phase_rad, 1e-7);
      EXPECT_LT(std::abs(c.dc - faults[m].dc), 1e-8);
      EXPECT_LT(std::abs(c.gain - faults[m].gain), 2e-7);
      EXPECT_NEAR(report.channels[m].tone_amplitude, 0.5 * std::abs(faults[m].gain), 1e-6);
      EXPECT_GT(report.channels[m].tone_snr_db, 100.0);
    }
  }
}

// 2 dB / 10 degrees at 30 dB: errors as large as reported, so image and phase by many sigmas inside their bars.
TEST(Calibration, ErrorsAreAsReported) {
  constexpr std::size_t kSamples = 10000;
  const std::vector<ChannelCorrection> faults{fault(2.0, 10.0, {}, 1.0), fault(2.0, 10.0, {}, std::polar(1.0, 2.0))};
  double image = 0.0, phase = 0.0, frequency = 0.0, worst_image = 0.0;
  constexpr int kRuns = 60;
  for (int run = 0; run < kRuns; ++run) {
    std::vector<std::vector<Cf32>> channels;
    for (std::size_t m = 0; m < 2; ++m) {
      auto x = tone(kSamples, kTone);
      RandomStream random(static_cast<std::uint64_t>(run), m);
      random.add_complex_normal(x, 0.25e-3);
      channels.push_back(faulty(x, faults[m]));
    }
    const auto report = calibrate(rows(channels), 2, kRate, kTone);
    ASSERT_EQ(report.status, CalibrationStatus::kOk);
    EXPECT_NEAR(report.channels[0].tone_snr_db, 30.0, 0.5);
    for (std::size_t m = 0; m < 2; ++m) {
      const auto& channel = report.channels[m];
      const double error = std::abs(channel.correction.image() - faults[m].image());
      image += error * error / (channel.image_sigma * channel.image_sigma);
      worst_image = std::max(worst_image, error);
    }
    const auto& second = report.channels[1];
    phase += std::pow((std::arg(second.correction.gain) - 2.0) / second.phase_sigma_rad, 2);
    frequency += std::pow((report.tone_hz - kTone) / report.tone_sigma_hz, 2);
  }
  EXPECT_LT(20.0 * std::log10(worst_image), -55.0);  // 120 draws of sigma -70 dB
  // Mean squares over 120 complex, 60 and 60 real draws; sigma of a mean of 60 chi-squares is 0.18. The faults colour
  // the noise, which the reported values take for white: a tenth.
  EXPECT_NEAR(image / (2 * kRuns), 1.0, 0.6);
  EXPECT_NEAR(phase / kRuns, 1.0, 0.85);
  EXPECT_NEAR(frequency / kRuns, 1.0, 0.85);
}

TEST(Calibration, SaysWhatIsWrongWithWhichChannel) {
  const auto good = tone(4000, kTone);
  const auto status = [](const std::vector<Cf32>& second, double tone_hz = kTone) {
    const auto report = calibrate(rows({tone(second.size(), kTone), second}), 2, kRate, tone_hz);
    EXPECT_TRUE(report.channels.empty());
    return std::pair(report.status, report.channel);
  };
  auto bad = good;
  bad[77] = {0.0F, std::numeric_limits<float>::quiet_NaN()};
  EXPECT_EQ(status(bad), std::pair(CalibrationStatus::kNonFinite, 1));
  EXPECT_EQ(status(std::vector<Cf32>(4000, Cf32(0.1F, 0.2F))), std::pair(CalibrationStatus::kDeadChannel, 1));
  EXPECT_EQ(status(tone(4000, kTone, 1e-5)), std::pair(CalibrationStatus::kDeadChannel, 1));
  EXPECT_EQ(status(tone(4000, 3.0 * kTone)), std::pair(CalibrationStatus::kWeakTone, 1));
  bad = good;
  for (Cf32& x : bad) x = {std::clamp(x.real(), -0.45F, 0.45F), std::clamp(x.imag(), -0.45F, 0.45F)};
  EXPECT_EQ(status(bad), std::pair(CalibrationStatus::kSaturated, 1));
  bad = good;
  for (Cf32& x : bad) x = {x.real(), 0.0F};
  EXPECT_EQ(status(bad), std::pair(CalibrationStatus::kNoQuadrature, 1));
  EXPECT_EQ(status(tone(60, kTone)), std::pair(CalibrationStatus::kTooFewSamples, -1));
  EXPECT_EQ(status(good, 500.0), std::pair(CalibrationStatus::kTooFewSamples, -1));    // two turns
  EXPECT_EQ(status(good, 499.5e3), std::pair(CalibrationStatus::kTooFewSamples, -1));  // nearly its own image
}

TEST(Calibration, ACoarseConverterIsNotSaturated) {
  for (const double bits : {4.0, 6.0, 8.0}) {
    const double levels = std::exp2(bits - 1.0) - 1.0;
    auto x = tone(8000, kTone, 1.0);
    for (Cf32& s : x) {
      s = {static_cast<float>(std::rint(double(s.real()) * levels) / levels),
           static_cast<float>(std::rint(double(s.imag()) * levels) / levels)};
    }
    EXPECT_EQ(calibrate(x, 1, kRate, kTone).status, CalibrationStatus::kOk) << bits;
  }
}

TEST(Calibration, Refusals) {
  const auto x = tone(100, kTone);
  EXPECT_THROW(static_cast<void>(calibrate(x, 0, kRate, kTone)), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(calibrate(x, 3, kRate, kTone)), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(calibrate(x, 1, kRate, 0.0)), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(calibrate(x, 1, kRate, 0.6 * kRate)), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(calibrate(x, 1, 0.0, kTone)), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(calibrate(x, 1, kRate, kTone, {1, 0.0})), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(calibrate(x, 1, kRate, kTone, {0, -1.0})), std::invalid_argument);
}

TEST(CalibrationNoAlloc, Correction) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  auto x = tone(1000, kTone);
  const ChannelCorrection c = fault(2.0, 10.0, {0.05, -0.03}, std::polar(0.8, 2.0));
  EXPECT_EQ(test::allocations_of([&] { apply_correction(c, x); }), 0);
}

}  // namespace
}  // namespace soopnav::array
