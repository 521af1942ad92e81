#include "soopnav/dsp/ambiguity.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <complex>
#include <limits>
#include <numbers>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/core/random.hpp"
#include "support/allocation_count.hpp"

namespace soopnav::dsp {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kSymbols = 25e3;

double root_raised_cosine(double t, double rolloff) {
  const double edge = std::abs(4.0 * rolloff * t);
  if (std::abs(t) < 1e-9) return 1.0 - rolloff + 4.0 * rolloff / kPi;
  if (std::abs(edge - 1.0) < 1e-7) {
    const double x = kPi / (4.0 * rolloff);
    return rolloff / std::numbers::sqrt2 * ((1.0 + 2.0 / kPi) * std::sin(x) + (1.0 - 2.0 / kPi) * std::cos(x));
  }
  return (std::sin(kPi * t * (1.0 - rolloff)) + 4.0 * rolloff * t * std::cos(kPi * t * (1.0 + rolloff))) /
         (kPi * t * (1.0 - edge * edge));
}

/// QPSK symbols as a function of time: what both receivers hear, power 1.
class Burst {
 public:
  Burst(double duration_s, RandomStream random)
      : symbols_(static_cast<std::size_t>(std::round(duration_s * kSymbols))) {
    for (auto& s : symbols_) s = std::polar(1.0, kPi / 2.0 * static_cast<double>(random.next_u32() % 4) + kPi / 4.0);
    for (std::size_t i = 0; i < table_.size(); ++i) {
      table_[i] = root_raised_cosine(static_cast<double>(i) / kSteps - kSpan, 0.4);
    }
  }
  std::complex<double> operator()(double t_s) const {
    const double at = t_s * kSymbols;
    const auto middle = static_cast<std::ptrdiff_t>(std::lround(at));
    std::complex<double> sum{};
    for (std::ptrdiff_t k = middle - kSpan + 1; k < middle + kSpan; ++k) {
      if (k < 0 || k >= static_cast<std::ptrdiff_t>(symbols_.size())) continue;
      const double x = (at - static_cast<double>(k) + kSpan) * kSteps;
      const auto i = static_cast<std::size_t>(x);
      const double mu = x - static_cast<double>(i);
      sum += symbols_[static_cast<std::size_t>(k)] * ((1.0 - mu) * table_[i] + mu * table_[i + 1]);
    }
    return sum;
  }

 private:
  static constexpr std::ptrdiff_t kSpan = 8;
  static constexpr double kSteps = 512.0;
  std::vector<std::complex<double>> symbols_;
  std::vector<double> table_ = std::vector<double>(2 * kSpan * 512 + 2);
};

struct Scene {
  double rate_hz = 250e3;
  double duration_s = 0.02;
  double snr_db = 20.0;  // of both, in 25 kHz
  double tdoa_s = 0.0, fdoa_hz = 0.0, tdoa_rate = 0.0;
  double center_hz = 0.0;   // of the signal in b
  double lead_s = 0.0;      // noise before the burst, and as much after it
  double tone_db = -300.0;  // of a tone in both, against the burst
  double tone_hz = 4e3;
  bool burst = true;
};

struct Pair {
  std::vector<Cf32> a, b;
};

Pair recorded(const Scene& scene, std::uint64_t seed) {
  const RandomStream random(seed, 7);
  const Burst burst(scene.duration_s, random.substream(0));
  const auto n = static_cast<std::size_t>(std::lround((scene.duration_s + 2.0 * scene.lead_s) * scene.rate_hz));
  Pair pair{std::vector<Cf32>(n), std::vector<Cf32>(n)};
  const double noise = scene.rate_hz / kSymbols * std::pow(10.0, -0.1 * scene.snr_db);
  random.substream(1).fill_complex_normal(pair.a, noise);
  random.substream(2).fill_complex_normal(pair.b, noise);
  const double middle = 0.5 * static_cast<double>(n) / scene.rate_hz;
  const double tone = std::pow(10.0, 0.05 * scene.tone_db);
  for (std::size_t i = 0; i < n; ++i) {
    const double t = static_cast<double>(i) / scene.rate_hz;
    std::complex<double> a{}, b{};
    if (scene.burst) {
      const double delay = scene.tdoa_s + scene.tdoa_rate * (t - middle);
      a = burst(t - scene.lead_s - delay) * std::polar(1.0, 2.0 * kPi * (scene.center_hz + scene.fdoa_hz) * t + 1.0);
      b = burst(t - scene.lead_s) * std::polar(1.0, 2.0 * kPi * scene.center_hz * t);
    }
    a += std::polar(tone, 2.0 * kPi * scene.tone_hz * t);
    b += std::polar(tone, 2.0 * kPi * (scene.tone_hz + 210.0) * t);
    pair.a[i] += Cf32(a);
    pair.b[i] += Cf32(b);
  }
  return pair;
}

AmbiguityOptions options(const Pair& pair, double rate_hz = 250e3) {
  AmbiguityOptions o;
  o.sample_rate_hz = rate_hz;
  o.max_samples = pair.a.size();
  o.bandwidth_hz = 35e3;
  return o;
}

AmbiguityPeak measured(const Pair& pair, const AmbiguityOptions& o) {
  return CrossAmbiguity(o).measure(pair.a, pair.b);
}

TEST(CrossAmbiguity, MeasuresWhatWasPutIn) {
  struct Case {
    double rate_hz, duration_s, tdoa_s, fdoa_hz, center_hz;
  };
  for (const Case& c : {Case{250e3, 0.02, 0.0, 0.0, 0.0}, Case{250e3, 0.02, 13.37e-6, -4321.0, 20e3},
                        Case{250e3, 0.02, -18e-6, 38e3, -30e3}, Case{50e3, 0.03, 5e-6, 12.0, 0.0},
                        Case{2e6, 0.01, 19e-6, 2222.0, 400e3}, Case{250e3, 0.00828, 3e-6, 100.0, 0.0}}) {
    SCOPED_TRACE(std::to_string(c.rate_hz) + " " + std::to_string(c.fdoa_hz));
    const Pair pair = recorded({.rate_hz = c.rate_hz,
                                .duration_s = c.duration_s,
                                .tdoa_s = c.tdoa_s,
                                .fdoa_hz = c.fdoa_hz,
                                .center_hz = c.center_hz},
                               1);
    const AmbiguityPeak peak = measured(pair, options(pair, c.rate_hz));
    ASSERT_EQ(peak.status, AmbiguityStatus::kOk) << to_string(peak.status);
    const TdoaFdoaBound bound = stein_bound(kSymbols, c.duration_s, 100.0, 100.0, SpectrumShape::kRaisedCosine);
    EXPECT_NEAR(peak.tdoa_s, c.tdoa_s, 5.0 * bound.sigma_tdoa_s);
    EXPECT_NEAR(peak.fdoa_hz, c.fdoa_hz, 5.0 * bound.sigma_fdoa_hz);
    EXPECT_NEAR(peak.sigma_tdoa_s / bound.sigma_tdoa_s, 1.0, 0.35);
    EXPECT_NEAR(peak.sigma_fdoa_hz / bound.sigma_fdoa_hz, 1.0, 0.35);
    EXPECT_NEAR(peak.center_b_hz, c.center_hz, 3e3);
    EXPECT_NEAR(peak.epoch_s, 0.5 * c.duration_s, 0.1 * c.duration_s);
    EXPECT_GT(peak.snr_db, peak.threshold_db);
  }
}

TEST(CrossAmbiguity, SwappedRecordingsTurnTheSigns) {
  const Pair pair = recorded({.tdoa_s = 7e-6, .fdoa_hz = 900.0}, 2);
  const AmbiguityPeak ab = measured(pair, options(pair)), ba = measured({pair.b, pair.a}, options(pair));
  EXPECT_GT(ab.tdoa_s, 0.0);   // a is later
  EXPECT_GT(ab.fdoa_hz, 0.0);  // and higher
  EXPECT_NEAR(ab.tdoa_s, -ba.tdoa_s, 0.3 * ab.sigma_tdoa_s);
  EXPECT_NEAR(ab.fdoa_hz, -ba.fdoa_hz, 0.3 * ab.sigma_fdoa_hz);
  EXPECT_NEAR(std::remainder(ab.phase_rad + ba.phase_rad, 2.0 * kPi), 0.0, 0.6);
}

TEST(CrossAmbiguity, LevelsDoNotMatter) {
  Pair pair = recorded({.tdoa_s = 7e-6, .fdoa_hz = 900.0}, 14);
  const AmbiguityPeak plain = measured(pair, options(pair));
  for (const float gain : {1e12F, 1e10F}) {  // up to 1e22 and down to 1e-22, whose squares no float holds
    for (Cf32& x : pair.a) x *= gain;
    for (Cf32& x : pair.b) x /= gain;
    const AmbiguityPeak scaled = measured(pair, options(pair));
    ASSERT_EQ(scaled.status, AmbiguityStatus::kOk) << to_string(scaled.status);
    EXPECT_NEAR(scaled.tdoa_s, plain.tdoa_s, 0.01 * plain.sigma_tdoa_s);
    EXPECT_NEAR(scaled.sigma_tdoa_s / plain.sigma_tdoa_s, 1.0, 0.01);
    EXPECT_NEAR(scaled.snr_b_db, plain.snr_b_db, 0.01);
  }
  // A box that falls between two bins passes nothing: no answer, and no NaN.
  AmbiguityOptions o = options(pair);
  o.max_samples = 89;
  o.bandwidth_hz = 50.0;
  o.max_delay_s = 9e-6;
  o.max_doppler_hz = 1e3;
  o.prefilter = AmbiguityPrefilter::kBox;
  const AmbiguityPeak none =
      measured({{pair.a.begin(), pair.a.begin() + 89}, {pair.b.begin(), pair.b.begin() + 89}}, o);
  EXPECT_TRUE(std::isfinite(none.tdoa_s) && std::isfinite(none.fdoa_hz) && std::isfinite(none.epoch_s));
}

TEST(CrossAmbiguity, PhaseIsThatOfAAgainstBAtTheEpoch) {
  const Scene scene{.snr_db = 30.0, .tdoa_s = 4e-6, .fdoa_hz = 150.0, .center_hz = 2e3};
  const Pair pair = recorded(scene, 3);
  const AmbiguityPeak peak = measured(pair, options(pair));
  // a(t) = s(t - tdoa) exp(j 2 pi (center + fdoa) t + j), b(t) = s(t) exp(j 2 pi center t).
  const double expected =
      1.0 + 2.0 * kPi * (scene.fdoa_hz * peak.epoch_s + (scene.center_hz + scene.fdoa_hz) * peak.tdoa_s);
  EXPECT_NEAR(std::remainder(peak.phase_rad - expected, 2.0 * kPi), 0.0, 0.05);
}

TEST(CrossAmbiguity, FindsBandwidthBurstAndSnr) {
  const Pair pair = recorded({.snr_db = 12.0, .tdoa_s = 2e-6, .center_hz = -40e3, .lead_s = 0.03}, 4);
  AmbiguityOptions o = options(pair);
  o.bandwidth_hz = 0.0;
  const AmbiguityPeak peak = measured(pair, o);
  ASSERT_EQ(peak.status, AmbiguityStatus::kOk);
  EXPECT_NEAR(peak.bandwidth_hz, 35e3, 9e3);
  EXPECT_NEAR(peak.center_b_hz, -40e3, 2e3);
  EXPECT_NEAR(peak.start_s, 0.03, 0.003);
  EXPECT_NEAR(peak.duration_s, 0.02, 0.004);
  EXPECT_NEAR(peak.snr_a_db, 12.0, 2.0);
  EXPECT_NEAR(peak.snr_b_db, 12.0, 2.0);
  EXPECT_NEAR(peak.tdoa_s, 2e-6, 5.0 * peak.sigma_tdoa_s);
}

TEST(CrossAmbiguity, WideDelayByLagsAndByDopplerBins) {
  for (const double max_doppler : {40e3, 30.0}) {
    const Pair pair = recorded({.tdoa_s = 11.111e-3, .fdoa_hz = 21.0, .lead_s = 0.02}, 5);
    AmbiguityOptions o = options(pair);
    o.max_delay_s = 20e-3;
    o.max_doppler_hz = max_doppler;
    const AmbiguityPeak peak = measured(pair, o);
    ASSERT_EQ(peak.status, AmbiguityStatus::kOk) << max_doppler;
    EXPECT_NEAR(peak.tdoa_s, 11.111e-3, 5.0 * peak.sigma_tdoa_s);
    EXPECT_NEAR(peak.fdoa_hz, 21.0, 5.0 * peak.sigma_fdoa_hz);
  }
}

// Block sums are rounded up to 16 samples: a length just above 64 * 16 k ended in a 65th block beyond the buffers.
TEST(CrossAmbiguity, LongRecordingsOfAnyLengthStayInsideTheBuffers) {
  const RandomStream random(31, 7);
  std::vector<Cf32> a(1024 * 88 + 63), b(a.size());
  random.substream(0).fill_complex_normal(a, 1.0);
  random.substream(1).fill_complex_normal(b, 1.0);
  for (const double bandwidth : {25e3, 45e3}) {     // the second is searched at twice the rate
    for (const double max_delay : {20e-6, 0.05}) {  // by lags, by Doppler bins
      for (const std::size_t beyond :
           max_delay > 1e-3 ? std::vector<std::size_t>{1} : std::vector<std::size_t>{0, 1, 63}) {
        AmbiguityOptions o;
        o.sample_rate_hz = 50e3;
        o.max_samples = 1024 * 88 + beyond;
        o.bandwidth_hz = bandwidth;
        o.center_a_hz = o.center_b_hz = 0.0;
        o.max_delay_s = max_delay;
        o.max_doppler_hz = max_delay > 1e-3 ? 0.5 : 5.0;
        o.false_alarm = 1e-6;
        const AmbiguityPeak peak = CrossAmbiguity(o).measure({a.data(), o.max_samples}, {b.data(), o.max_samples});
        EXPECT_EQ(peak.status, AmbiguityStatus::kNotDetected) << bandwidth << ' ' << max_delay << ' ' << beyond;
      }
    }
  }
}

TEST(CrossAmbiguity, StretchIsTakenOutWhetherGivenByTheCarrierOrEstimated) {
  // 100 ppm over 0.4 s: the delay runs through 40 us, a symbol.
  const double rate = 1e-4, carrier = 1.6e9 / 1000.0;
  const Pair pair =
      recorded({.rate_hz = 100e3, .duration_s = 0.4, .tdoa_s = 3e-6, .fdoa_hz = -rate * carrier, .tdoa_rate = rate}, 6);
  AmbiguityOptions plain = options(pair, 100e3);
  plain.max_doppler_hz = 1e3;
  AmbiguityOptions given = plain, carried = plain, estimated = plain;
  given.tdoa_rate = rate;
  carried.carrier_hz = carrier;
  estimated.estimate_rate = true;
  estimated.max_tdoa_rate = 1.5e-4;
  const TdoaFdoaBound bound = stein_bound(kSymbols, 0.4, 100.0, 100.0, SpectrumShape::kRaisedCosine);
  const AmbiguityPeak without = measured(pair, plain);
  for (const AmbiguityOptions& o : {given, carried, estimated}) {
    const AmbiguityPeak peak = measured(pair, o);
    ASSERT_EQ(peak.status, AmbiguityStatus::kOk);
    // The truth is stated at the middle of the recording, the measurement at its epoch.
    EXPECT_NEAR(peak.tdoa_s, 3e-6 + rate * (peak.epoch_s - 0.2), 6.0 * bound.sigma_tdoa_s);
    // The stretch shifts what lies beside the recording's centre besides.
    EXPECT_NEAR(peak.fdoa_hz, -rate * (carrier + peak.center_b_hz), 6.0 * bound.sigma_fdoa_hz);
    EXPECT_NEAR(peak.tdoa_rate, rate, 1e-6);
    EXPECT_GT(peak.coherence, 1.05 * without.coherence);
  }
}

TEST(CrossAmbiguity, ToneAboveTheBurstDoesNotCaptureTheAnswer) {
  for (const double tone_hz : {4e3, 60e3}) {  // inside the burst's band, and far from it
    const Pair pair = recorded(
        {.duration_s = 0.06, .snr_db = 15.0, .tdoa_s = -9e-6, .fdoa_hz = 700.0, .tone_db = 20.0, .tone_hz = tone_hz},
        8);
    const AmbiguityPeak peak = measured(pair, options(pair));
    ASSERT_EQ(peak.status, AmbiguityStatus::kOk) << tone_hz;
    EXPECT_NEAR(peak.tdoa_s, -9e-6, 6.0 * peak.sigma_tdoa_s);
    EXPECT_NEAR(peak.fdoa_hz, 700.0, 6.0 * peak.sigma_fdoa_hz);
    EXPECT_EQ(peak.tones, tone_hz < 10e3 ? 2U : 0U);
  }
  // Left in, it does.
  const Pair pair =
      recorded({.duration_s = 0.06, .snr_db = 15.0, .tdoa_s = -9e-6, .fdoa_hz = 700.0, .tone_db = 20.0}, 8);
  AmbiguityOptions left = options(pair);
  left.reject_tones = false;
  EXPECT_NEAR(measured(pair, left).fdoa_hz, -210.0, 5.0);
}

TEST(CrossAmbiguity, ToneInsteadOfBurstIsRefused) {
  const Pair pair = recorded({.duration_s = 0.06, .tone_db = 0.0, .burst = false}, 9);
  for (const double bandwidth : {35e3, 0.0}) {
    AmbiguityOptions o = options(pair);
    o.bandwidth_hz = bandwidth;
    const AmbiguityPeak peak = measured(pair, o);
    EXPECT_EQ(peak.status, AmbiguityStatus::kTone) << to_string(peak.status) << bandwidth;
    EXPECT_FALSE(peak.detected());
    EXPECT_TRUE(std::isinf(peak.sigma_tdoa_s));
  }
}

// Two tones further apart than the Doppler searched are no tone in common.
TEST(CrossAmbiguity, TonesFurtherApartThanTheDopplerSearchedAreNotOne) {
  Pair pair = recorded({.duration_s = 0.06, .burst = false}, 15);
  const auto add = [](std::vector<Cf32>& x, double hz) {
    for (std::size_t i = 0; i < x.size(); ++i)
      x[i] += Cf32(std::polar(1.0, 2.0 * kPi * hz * static_cast<double>(i) / 250e3));
  };
  add(pair.a, 9e3);
  add(pair.b, -9e3);
  for (const double bandwidth : {35e3, 0.0}) {
    AmbiguityOptions o = options(pair);
    o.bandwidth_hz = bandwidth;
    o.center_a_hz = o.center_b_hz = 0.0;
    o.max_doppler_hz = 1e3;
    EXPECT_EQ(measured(pair, o).status, AmbiguityStatus::kNotDetected) << bandwidth;
    o.max_doppler_hz = 20e3;
    EXPECT_EQ(measured(pair, o).status, AmbiguityStatus::kTone) << bandwidth;
  }
}

// A carrier that is keyed is not steady: nothing is subtracted, and its delay is that of two edges nobody models.
TEST(CrossAmbiguity, PulseOfACarrierIsATone) {
  constexpr double kRate = 125e3;
  for (const double edge_s : {1e-6, 1e-3}) {
    for (const double amplitude : {1.0, 3.0}) {  // times 10: over the noise of a sample
      for (std::uint64_t seed = 0; seed < 4; ++seed) {
        const RandomStream random(40 + seed, 7);
        Pair pair{std::vector<Cf32>(4000), std::vector<Cf32>(4000)};
        random.substream(1).fill_complex_normal(pair.a, 0.01);
        random.substream(2).fill_complex_normal(pair.b, 0.01);
        const auto pulse = [&](double t) {
          const double u = std::clamp(std::min(t - 0.008, 0.024 - t) / edge_s, 0.0, 1.0);
          return amplitude * (0.5 - 0.5 * std::cos(kPi * u));
        };
        for (std::size_t i = 0; i < 4000; ++i) {
          const double t = static_cast<double>(i) / kRate;
          pair.a[i] += Cf32(std::polar(pulse(t - 7e-6), 2.0 * kPi * 4.2e3 * t));
          pair.b[i] += Cf32(std::polar(pulse(t), 2.0 * kPi * 4e3 * t));
        }
        for (const double bandwidth : {35e3, 0.0}) {
          AmbiguityOptions o = options(pair, kRate);
          o.bandwidth_hz = bandwidth;
          const AmbiguityPeak peak = measured(pair, o);
          EXPECT_EQ(peak.status, AmbiguityStatus::kTone) << to_string(peak.status) << ' ' << edge_s << ' ' << bandwidth;
          EXPECT_TRUE(std::isinf(peak.sigma_tdoa_s));
        }
      }
    }
  }
}

// A burst that begins with 64 symbols of bare carrier, as an Iridium ring alert does, is one.
TEST(CrossAmbiguity, UnmodulatedPreambleIsNoTone) {
  constexpr double kRate = 125e3;
  const Burst burst(0.02032, RandomStream(16, 7));
  const RandomStream random(17, 7);
  Pair pair{std::vector<Cf32>(3000), std::vector<Cf32>(3000)};
  random.substream(1).fill_complex_normal(pair.a, 0.05);
  random.substream(2).fill_complex_normal(pair.b, 0.05);
  const auto at = [&](double t) { return t < 64.0 / kSymbols ? std::complex<double>(t > 0.0 ? 1.0 : 0.0) : burst(t); };
  for (std::size_t i = 0; i < pair.a.size(); ++i) {
    const double t = static_cast<double>(i) / kRate - 1e-3;
    pair.a[i] += Cf32(at(t - 6e-6) * std::polar(1.0, 2.0 * kPi * 500.0 * t));
    pair.b[i] += Cf32(at(t));
  }
  const AmbiguityPeak peak = measured(pair, options(pair, kRate));
  ASSERT_EQ(peak.status, AmbiguityStatus::kOk) << to_string(peak.status);
  EXPECT_NEAR(peak.tdoa_s, 6e-6, 5.0 * peak.sigma_tdoa_s);
}

// With the band to be found, a burst that is a few bins wide, or a few symbols long, is not taken for a line.
TEST(CrossAmbiguity, NarrowBandsAreFoundInWideRecordings) {
  struct Case {
    double rate_hz, duration_s;
  };
  for (const Case& c : {Case{2e6, 0.006}, Case{6e6, 0.006}, Case{10e6, 0.005}, Case{1e6, 0.0025}, Case{250e3, 0.0025},
                        Case{250e3, 0.004}}) {
    const Pair pair = recorded(
        {.rate_hz = c.rate_hz, .duration_s = c.duration_s, .snr_db = 15.0, .tdoa_s = 6e-6, .fdoa_hz = 800.0}, 18);
    AmbiguityOptions o = options(pair, c.rate_hz);
    o.bandwidth_hz = 0.0;
    o.max_doppler_hz = 2e3;
    const AmbiguityPeak peak = measured(pair, o);
    ASSERT_EQ(peak.status, AmbiguityStatus::kOk) << c.rate_hz << ' ' << to_string(peak.status);
    EXPECT_NEAR(peak.tdoa_s, 6e-6, 5.0 * peak.sigma_tdoa_s) << c.rate_hz << ' ' << c.duration_s;
    EXPECT_LT(peak.bandwidth_hz, 200e3);
    // Nor where the band is stated: too few samples for bins much narrower than it.
    o.bandwidth_hz = 35e3;
    EXPECT_EQ(measured(pair, o).status, AmbiguityStatus::kOk) << c.rate_hz << ' ' << c.duration_s;
  }
  // 3 and 6 kbaud at 2 Msps: the same bursts, 8 and 4 times slower.
  for (const double slower : {25.0 / 3.0, 25.0 / 6.0}) {
    const Pair pair =
        recorded({.rate_hz = 2e6 * slower, .duration_s = 0.03 / slower, .snr_db = 15.0, .tdoa_s = 1e-6}, 19);
    AmbiguityOptions o = options(pair, 2e6);
    o.bandwidth_hz = 0.0;
    o.max_doppler_hz = 2e3;
    const AmbiguityPeak peak = measured(pair, o);
    ASSERT_EQ(peak.status, AmbiguityStatus::kOk) << slower << ' ' << to_string(peak.status);
    EXPECT_NEAR(peak.tdoa_s, slower * 1e-6, 5.0 * peak.sigma_tdoa_s);
    EXPECT_GT(peak.sigma_tdoa_s, 0.5 * slower * stein_bound(kSymbols, 0.03 / slower, 31.6, 31.6).sigma_tdoa_s);
  }
}

// Noise over 10 Msps shows no band; the search of all of it over +-1 ms, a minute's work, is not made.
TEST(CrossAmbiguity, LongSearchOfABandThatIsNotSeenIsNotMade) {
  const RandomStream random(20, 7);
  Pair pair{std::vector<Cf32>(300'000), std::vector<Cf32>(300'000)};
  random.substream(1).fill_complex_normal(pair.a, 1.0);
  random.substream(2).fill_complex_normal(pair.b, 1.0);
  AmbiguityOptions o = options(pair, 10e6);
  o.bandwidth_hz = 0.0;
  o.max_delay_s = 1e-3;
  const AmbiguityPeak peak = measured(pair, o);
  EXPECT_EQ(peak.status, AmbiguityStatus::kNotDetected);
  EXPECT_TRUE(std::isinf(peak.sigma_tdoa_s));
}

TEST(CrossAmbiguity, IdenticalRecordingsAreFlagged) {
  Pair pair = recorded({}, 10);
  pair.b = pair.a;
  EXPECT_TRUE(measured(pair, options(pair)).identical());
  for (Cf32& x : pair.b) x *= Cf32(0.3F, -0.4F);
  const AmbiguityPeak peak = measured(pair, options(pair));
  EXPECT_TRUE(peak.identical());
  EXPECT_EQ(peak.tdoa_s, 0.0);
  EXPECT_EQ(peak.fdoa_hz, 0.0);
}

TEST(CrossAmbiguity, BadSamplesGiveAStatus) {
  const Pair good = recorded({}, 11);
  CrossAmbiguity caf(options(good));
  const auto status = [&](const std::vector<Cf32>& a, const std::vector<Cf32>& b) {
    const AmbiguityPeak peak = caf.measure(a, b);
    EXPECT_TRUE(std::isfinite(peak.tdoa_s) && std::isfinite(peak.fdoa_hz) && std::isfinite(peak.snr_db));
    EXPECT_TRUE(peak.detected() || std::isinf(peak.sigma_tdoa_s));
    return peak.status;
  };
  const std::vector<Cf32> zeros(good.a.size()), few(good.a.begin(), good.a.begin() + 30);
  const std::vector<Cf32> less(good.a.begin(), good.a.end() - 1), more(good.a.size() + 1, Cf32(1.0F, 0.0F));
  EXPECT_EQ(status({}, {}), AmbiguityStatus::kTooShort);
  EXPECT_EQ(status(few, few), AmbiguityStatus::kTooShort);
  EXPECT_EQ(status(more, more), AmbiguityStatus::kTooLong);
  EXPECT_EQ(status(good.a, less), AmbiguityStatus::kLengthMismatch);
  EXPECT_EQ(status(good.a, zeros), AmbiguityStatus::kNoPower);
  EXPECT_EQ(status(zeros, good.b), AmbiguityStatus::kNoPower);
  for (const float bad : {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity()}) {
    for (const std::size_t at : {std::size_t{0}, good.a.size() / 2, good.a.size() - 1}) {
      std::vector<Cf32> broken = good.a;
      broken[at] = {0.0F, bad};
      EXPECT_EQ(status(broken, good.b), AmbiguityStatus::kNotFinite);
      EXPECT_EQ(status(good.b, broken), AmbiguityStatus::kNotFinite);
    }
  }
  EXPECT_EQ(status(good.a, good.b), AmbiguityStatus::kOk);  // nothing of it stayed
  std::vector<double> cells(6);
  const std::vector<double> delays{0.0, 1e-6}, doppler{-10.0, 0.0, 10.0};
  EXPECT_TRUE(caf.surface(delays, doppler, cells));
  EXPECT_FALSE(caf.surface(delays, delays, cells));
  static_cast<void>(caf.measure({}, {}));
  EXPECT_FALSE(caf.surface(delays, doppler, cells));
}

TEST(CrossAmbiguity, SurfacePeaksAtTheAnswer) {
  const Pair pair = recorded({.tdoa_s = 6e-6, .fdoa_hz = 500.0}, 12);
  CrossAmbiguity caf(options(pair));
  const AmbiguityPeak peak = caf.measure(pair.a, pair.b);
  std::vector<double> delays, doppler;
  for (int i = -20; i <= 20; ++i) {
    delays.push_back(6e-6 + 1e-6 * i);
    doppler.push_back(500.0 + 5.0 * i);
  }
  std::vector<double> cells(delays.size() * doppler.size());
  ASSERT_TRUE(caf.surface(delays, doppler, cells));
  const auto at = static_cast<std::size_t>(std::max_element(cells.begin(), cells.end()) - cells.begin());
  EXPECT_EQ(at / doppler.size(), 20U);
  EXPECT_EQ(at % doppler.size(), 20U);
  EXPECT_NEAR(cells[at], peak.coherence * peak.coherence, 0.05);
}

// Noise alone, as often called a signal as was asked for: 600 trials at 10 %. The count is binomial; the bounds are
// left by a right threshold with probability below 1e-4, and the threshold's formula is an approximation within a
// third.
TEST(CrossAmbiguity, FalseAlarmRateIsKept) {
  Scene scene{.rate_hz = 50e3, .duration_s = 0.01, .burst = false};
  int alarms = 0;
  constexpr int kTrials = 600;
  AmbiguityOptions o = options(recorded(scene, 0), 50e3);
  o.bandwidth_hz = 25e3;
  o.center_a_hz = o.center_b_hz = 0.0;
  o.max_delay_s = 500e-6;
  o.max_doppler_hz = 1e3;
  o.false_alarm = 0.1;
  CrossAmbiguity caf(o);
  for (int i = 0; i < kTrials; ++i) {
    const Pair pair = recorded(scene, 1000 + static_cast<std::uint64_t>(i));
    alarms += caf.measure(pair.a, pair.b).detected() ? 1 : 0;
  }
  const double expected = 0.1 * kTrials;
  EXPECT_GT(alarms, 0.6 * expected - 4.0 * std::sqrt(expected));
  EXPECT_LT(alarms, 1.3 * expected + 4.0 * std::sqrt(expected));
}

// 150 bursts of 20 ms at 0 and 12 dB: errors over the reported sigmas have unit variance, within what 150 draws allow
// (chi-square, 1e-4 either side: 0.62 ... 1.47) and a tenth for the bound being one.
TEST(CrossAmbiguity, SigmasAreThoseOfTheErrors) {
  for (const double snr_db : {0.0, 12.0}) {
    double delay = 0.0, doppler = 0.0;
    constexpr int kTrials = 150;
    Scene scene{.rate_hz = 62.5e3, .snr_db = snr_db};
    const Pair first = recorded(scene, 0);
    CrossAmbiguity caf(options(first, 62.5e3));
    for (int i = 0; i < kTrials; ++i) {
      scene.tdoa_s = 15e-6 * std::sin(0.7 * i);
      scene.fdoa_hz = 300.0 * std::cos(1.1 * i);
      const Pair pair = recorded(scene, 2000 + static_cast<std::uint64_t>(i));
      const AmbiguityPeak peak = caf.measure(pair.a, pair.b);
      ASSERT_TRUE(peak.detected());
      delay += std::pow((peak.tdoa_s - scene.tdoa_s) / peak.sigma_tdoa_s, 2);
      doppler += std::pow((peak.fdoa_hz - scene.fdoa_hz) / peak.sigma_fdoa_hz, 2);
    }
    EXPECT_GT(delay / kTrials, 0.56) << snr_db;
    EXPECT_LT(delay / kTrials, 1.47 * 1.21) << snr_db;
    EXPECT_GT(doppler / kTrials, 0.56) << snr_db;
    EXPECT_LT(doppler / kTrials, 1.47 * 1.21) << snr_db;
  }
}

// Just above the threshold the variance is half as much again as eq. 8 says; the reported one follows (eq. 10). 200
// draws: chi-square, 1e-3 either side, 0.71 ... 1.34; without, 1.6 for the delay.
TEST(CrossAmbiguity, SigmasHoldNearTheThreshold) {
  double delay = 0.0, doppler = 0.0;
  int detected = 0;
  Scene scene{.rate_hz = 50e3, .duration_s = 0.09, .snr_db = -9.0};
  AmbiguityOptions o = options(recorded(scene, 0), 50e3);
  o.max_doppler_hz = 1e3;
  CrossAmbiguity caf(o);
  for (int i = 0; i < 200; ++i) {
    scene.tdoa_s = 15e-6 * std::sin(0.7 * i);
    const Pair pair = recorded(scene, 5000 + static_cast<std::uint64_t>(i));
    const AmbiguityPeak peak = caf.measure(pair.a, pair.b);
    if (!peak.detected()) continue;
    ++detected;
    delay += std::pow((peak.tdoa_s - scene.tdoa_s) / peak.sigma_tdoa_s, 2);
    doppler += std::pow((peak.fdoa_hz - scene.fdoa_hz) / peak.sigma_fdoa_hz, 2);
  }
  ASSERT_GT(detected, 160);
  EXPECT_GT(delay / detected, 0.71);
  EXPECT_LT(delay / detected, 1.34);
  EXPECT_GT(doppler / detected, 0.71);
  EXPECT_LT(doppler / detected, 1.34);
}

TEST(CrossAmbiguity, MeasuringDoesNotAllocate) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted here";
  const Pair pair = recorded({.tdoa_s = 5e-6, .fdoa_hz = 40.0, .tone_db = 10.0}, 13);
  for (const double max_delay : {20e-6, 5e-3}) {
    AmbiguityOptions o = options(pair);
    o.max_delay_s = max_delay;
    o.max_doppler_hz = max_delay > 1e-3 ? 60.0 : 40e3;
    o.carrier_hz = 1.6e9;
    o.estimate_rate = max_delay > 1e-3;
    o.bandwidth_hz = max_delay > 1e-3 ? 0.0 : 35e3;
    CrossAmbiguity caf(o);
    AmbiguityPeak peak;
    EXPECT_EQ(test::allocations_of([&] { peak = caf.measure(pair.a, pair.b); }), 0);
    EXPECT_EQ(peak.status, AmbiguityStatus::kOk);
  }
}

}  // namespace
}  // namespace soopnav::dsp
