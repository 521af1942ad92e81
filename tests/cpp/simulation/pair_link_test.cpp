#include "soopnav/simulation/pair_link.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <complex>
#include <limits>
#include <numbers>
#include <stdexcept>
#include <vector>

#include "soopnav/core/constants.hpp"
#include "soopnav/simulation/channel.hpp"
#include "support/allocation_count.hpp"

namespace soopnav::simulation {
namespace {

using geometry::OrbitState;
using geometry::SampledOrbit;
using geometry::SignalPath;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kCarrierHz = 1626.270833e6;
constexpr double kRateHz = 50e3;

/// exp(-(t / 3 ms)²) exp(j 2 pi (2 kHz t + 4e5 t²)): an envelope in closed form.
struct Chirp {
  static std::complex<double> at(double t) {
    const double edge = t / 3e-3;
    return std::polar(std::exp(-edge * edge), kTwoPi * (2e3 * t + 4e5 * t * t));
  }
  void evaluate(double t0_s, double dt_s, double quadratic, std::span<Cf32> out) const {
    for (std::size_t n = 0; n < out.size(); ++n) {
      const auto k = static_cast<double>(n);
      out[n] = Cf32(at(t0_s + dt_s * k + quadratic * k * k));
    }
  }
};

/// A satellite on a circle of 7150 km inclined by 60 degrees, overhead of (R, 0, 0) at time `overhead_s`.
SampledOrbit satellite(double overhead_s, double start_s = -60.0, std::size_t rows = 25, double step_s = 5.0) {
  constexpr double kRadius_m = 7150e3, kRate = 1.0442e-3, kEarth = 7.2921151467e-5;
  std::vector<double> p, v;
  const Eigen::Vector3d x(1.0, 0.0, 0.0), y(0.0, 0.5, std::sqrt(0.75));
  for (std::size_t i = 0; i < rows; ++i) {
    const double t = start_s + step_s * static_cast<double>(i) - overhead_s;
    const Eigen::Vector3d at = kRadius_m * (std::cos(kRate * t) * x + std::sin(kRate * t) * y);
    const Eigen::Vector3d by = kRadius_m * kRate * (-std::sin(kRate * t) * x + std::cos(kRate * t) * y);
    const double c = std::cos(kEarth * t), s = std::sin(kEarth * t);
    const Eigen::Vector3d p_e(c * at.x() + s * at.y(), -s * at.x() + c * at.y(), at.z());
    const Eigen::Vector3d v_e(c * by.x() + s * by.y() + kEarth * p_e.y(), -s * by.x() + c * by.y() - kEarth * p_e.x(),
                              by.z());
    p.insert(p.end(), p_e.data(), p_e.data() + 3);
    v.insert(v.end(), v_e.data(), v_e.data() + 3);
  }
  return SampledOrbit(start_s, step_s, p, v);
}

const Eigen::Vector3d kSite(6378e3, 0.0, 0.0);

PairReceiver receiver(const Eigen::Vector3d& p_e, double bias_s = 0.0, double drift = 0.0) {
  return {SampledOrbit::fixed(p_e), ClockTrack::steady(bias_s, drift), {}};
}

EnvelopeView chirp_view(const Chirp& chirp) { return {chirp, -12e-3, 12e-3}; }

TEST(ClockTrack, MeetsItsInstantsAndRunsOnAtTheEnds) {
  const std::array t{10.0, 12.0, 13.0}, bias{1e-3, 1.004e-3, 1.005e-3}, drift{1e-6, 3e-6, -2e-6};
  const ClockTrack clock(t, bias, drift);
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_NEAR(clock.at(t[i]).bias_s, bias[i], 1e-18);
    EXPECT_NEAR(clock.at(t[i]).drift, drift[i], 1e-18);
  }
  EXPECT_DOUBLE_EQ(clock.at(7.0).bias_s, 1e-3 - 3e-6);
  EXPECT_DOUBLE_EQ(clock.at(20.0).bias_s, 1.005e-3 - 14e-6);
  EXPECT_DOUBLE_EQ(clock.at(20.0).drift, -2e-6);
  for (double at = 9.5; at < 14.0; at += 0.1) {
    const double step = 1e-3;
    EXPECT_NEAR((clock.at(at + step).bias_s - clock.at(at - step).bias_s) / (2.0 * step), clock.at(at).drift, 1e-8);
    const double reading = at + clock.at(at).bias_s;
    EXPECT_NEAR(clock.time_of(reading), at, 1e-14);
  }
  EXPECT_EQ(ClockTrack().at(5.0).bias_s, 0.0);
}

TEST(ClockTrack, SimulatedIsTheTwoStateClock) {
  const std::array t{0.0, 1.0, 2.0};
  const clock::ClockNoise noise = clock::ClockNoise::from_allan(8e-20, 4e-23);
  std::array<clock::ClockState, 3> states;
  clock::simulate(noise, {3e5, 150.0}, t, RandomStream(5), states);
  const ClockTrack clock = ClockTrack::simulated(noise, {3e5, 150.0}, t, RandomStream(5));
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_DOUBLE_EQ(clock.at(t[i]).bias_s, states[i].bias_m / kSpeedOfLightMps);
    EXPECT_DOUBLE_EQ(clock.at(t[i]).drift, states[i].drift_mps / kSpeedOfLightMps);
  }
}

TEST(ClockTrack, Refusals) {
  const std::array<double, 2> t{0.0, 1.0}, zero{0.0, 0.0}, falling{1.0, 1.0}, bad{0.0, kNan}, fast{0.0, 2e-3};
  EXPECT_THROW(ClockTrack({}, {}, {}), std::invalid_argument);
  EXPECT_THROW(ClockTrack(t, std::span(zero).first(1), zero), std::invalid_argument);
  EXPECT_THROW(ClockTrack(falling, zero, zero), std::invalid_argument);
  EXPECT_THROW(ClockTrack(bad, zero, zero), std::invalid_argument);
  EXPECT_THROW(ClockTrack(t, bad, zero), std::invalid_argument);
  EXPECT_THROW(ClockTrack(t, zero, bad), std::invalid_argument);
  EXPECT_THROW(ClockTrack(t, zero, fast), std::invalid_argument);
  EXPECT_THROW(ClockTrack(t, fast, zero), std::invalid_argument);
}

TEST(SampledEnvelope, BandLimitedSignalsToMinusEightyDb) {
  std::vector<Cf32> tone(400);
  for (const double cycles : {-0.4, -0.13, 0.0, 0.27, 0.4}) {  // per sample; half the rate is 0.5
    for (std::size_t n = 0; n < tone.size(); ++n)
      tone[n] = Cf32(std::polar(1.0, kTwoPi * cycles * static_cast<double>(n)));
    const SampledEnvelope envelope(tone, 2.0);
    std::vector<Cf32> out(300);
    envelope.evaluate(20.0137, 0.4571, 1e-5, out);
    for (std::size_t n = 0; n < out.size(); ++n) {
      const auto k = static_cast<double>(n);
      const double at = 2.0 * (20.0137 + 0.4571 * k + 1e-5 * k * k);
      EXPECT_LT(std::abs(std::complex<double>(out[n]) - std::polar(1.0, kTwoPi * cycles * at)), 1e-4)
          << cycles << ' ' << n;
    }
  }
  const SampledEnvelope one(std::vector<Cf32>{{2.0F, -1.0F}}, 1.0);
  std::array<Cf32, 5> out;
  one.evaluate(-20.0, 10.0, 0.0, out);  // -20, -10, 0, 10, 20
  EXPECT_EQ(out[0], Cf32());
  EXPECT_LT(std::abs(out[1]), 1e-6F);
  EXPECT_LT(std::abs(out[2] - Cf32(2.0F, -1.0F)), 1e-6F);
  EXPECT_EQ(out[4], Cf32());
  EXPECT_DOUBLE_EQ(one.begin_s(), -16.0);
  EXPECT_DOUBLE_EQ(one.end_s(), 16.0);
  one.evaluate(kNan, 1.0, 0.0, out);
  EXPECT_EQ(out[2], Cf32());
  EXPECT_THROW(SampledEnvelope({}, 1.0), std::invalid_argument);
  EXPECT_THROW(SampledEnvelope(std::vector<Cf32>{{static_cast<float>(kNan), 0.0F}}, 1.0), std::invalid_argument);
  EXPECT_THROW(SampledEnvelope(tone, 0.0), std::invalid_argument);
}

// The samples one by one, in long double where large numbers meet.
TEST(AddReception, EqualsTheModelSampleBySample) {
  const Chirp chirp;
  const SampledOrbit orbit = satellite(1000.0, 950.0);
  PairReceiver r = receiver(kSite + Eigen::Vector3d(0.0, 7e3, 3e3));
  const std::array t{995.0, 1000.1, 1003.0}, bias{2e-4, 2.003e-4, 2.004e-4}, drift{7e-8, 9e-8, -1e-8};
  r.clock = ClockTrack(t, bias, drift);
  const SampleGrid grid{1000.0, kRateHz, kCarrierHz - 7e3, 0};
  const Transmission sent{1000.013, kCarrierHz + 1234.5, 2.0, 0.3};
  std::vector<Cf32> samples(2500, Cf32(0.25F, 0.0F));
  ASSERT_TRUE(add_reception(r, chirp_view(chirp), orbit, sent, grid, samples));
  double worst = 0.0, peak = 0.0;
  for (std::size_t n = 0; n < samples.size(); ++n) {
    const long double reading = 1000.0L + static_cast<long double>(n) / 50e3L;
    ClockReading clock;
    const double time = r.clock.time_of(static_cast<double>(reading), clock);
    SignalPath path;
    ASSERT_TRUE(geometry::signal_path(orbit, time, kSite + Eigen::Vector3d(0.0, 7e3, 3e3), {0.0, 0.0, 0.0}, path));
    const long double offset = static_cast<long double>(path.delay_s) + static_cast<long double>(clock.bias_s);
    long double turns =
        (static_cast<long double>(sent.carrier_hz) - static_cast<long double>(grid.center_hz)) * reading -
        static_cast<long double>(sent.carrier_hz) * offset;
    turns -= std::round(turns);
    const auto u = static_cast<double>(reading - static_cast<long double>(sent.start_s) - offset);
    const std::complex<double> expected =
        std::abs(u) < 12e-3 ? 2.0 * Chirp::at(u) * std::polar(1.0, 0.3 + kTwoPi * static_cast<double>(turns))
                            : std::complex<double>();
    peak = std::max(peak, std::abs(expected));
    worst = std::max(worst, std::abs(std::complex<double>(samples[n]) - 0.25 - expected));
  }
  EXPECT_GT(peak, 1.99);
  EXPECT_LT(worst, 2e-5);  // single precision of envelope and turning, 1e-12 s of the carrier being 1e-2 rad
}

TEST(AddReception, BlocksAreTheWhole) {
  const Chirp chirp;
  const SampledOrbit orbit = satellite(0.0);
  const PairReceiver r = receiver(kSite, 1e-4, 2e-7);
  const Transmission sent{0.02, kCarrierHz};
  std::vector<Cf32> whole(3000), parts(3000);
  ASSERT_TRUE(add_reception(r, chirp_view(chirp), orbit, sent, {0.0, kRateHz, kCarrierHz, 0}, whole));
  for (std::size_t from = 0; from < whole.size(); from += 700) {
    const std::size_t count = std::min<std::size_t>(700, whole.size() - from);
    ASSERT_TRUE(add_reception(r, chirp_view(chirp), orbit, sent,
                              {0.0, kRateHz, kCarrierHz, static_cast<std::int64_t>(from)},
                              std::span(parts).subspan(from, count)));
  }
  float most = 0.0F;
  for (std::size_t n = 0; n < whole.size(); ++n) {
    EXPECT_LT(std::abs(whole[n] - parts[n]), 1e-5F);
    most = std::max(most, std::abs(whole[n]));
  }
  EXPECT_GT(most, 0.99F);
}

TEST(AddReception, EchoesAddUp) {
  const Chirp chirp;
  const SampledOrbit orbit = satellite(0.0);
  PairReceiver r = receiver(kSite);
  const SampleGrid grid{0.0, kRateHz, kCarrierHz, 0};
  const Transmission sent{0.02, kCarrierHz};
  std::vector<Cf32> direct(2000), later(2000), both(2000);
  ASSERT_TRUE(add_reception(r, chirp_view(chirp), orbit, sent, grid, direct));
  r.taps = {{40e-6, {0.0, 0.5}}};  // two samples
  ASSERT_TRUE(add_reception(r, chirp_view(chirp), orbit, sent, grid, later));
  r.taps = {{0.0, {1.0, 0.0}}, {40e-6, {0.0, 0.5}}};
  ASSERT_TRUE(add_reception(r, chirp_view(chirp), orbit, sent, grid, both));
  for (std::size_t n = 2; n < both.size(); ++n) EXPECT_LT(std::abs(both[n] - direct[n] - later[n]), 1e-5F);
  // An echo keeps the carrier of the path: the envelope alone is later, so its peak is two samples on, a quarter
  // turned.
  std::size_t at = 0, echo = 0;
  for (std::size_t n = 0; n < direct.size(); ++n) {
    if (std::abs(direct[n]) > std::abs(direct[at])) at = n;
    if (std::abs(later[n]) > std::abs(later[echo])) echo = n;
  }
  EXPECT_EQ(echo, at + 2);
  r.taps[1].gain = kNan;
  EXPECT_THROW(PairLink(r, receiver(kSite), kRateHz, kCarrierHz), std::invalid_argument);
}

TEST(AddReception, OutsideTheOrbitOrTheSamples) {
  const Chirp chirp;
  const SampledOrbit orbit = satellite(0.0);  // -60 ... 60 s
  const PairReceiver r = receiver(kSite);
  std::vector<Cf32> samples(100, Cf32(1.0F, 0.0F));
  const SampleGrid grid{0.0, kRateHz, kCarrierHz, 0};
  for (const double start_s : {61.0, -60.001, kNan}) {
    EXPECT_FALSE(add_reception(r, chirp_view(chirp), orbit, {start_s, kCarrierHz}, grid, samples)) << start_s;
  }
  EXPECT_TRUE(add_reception(r, chirp_view(chirp), orbit, {30.0, kCarrierHz}, grid, samples));
  for (const Cf32 x : samples) EXPECT_EQ(x, Cf32(1.0F, 0.0F));
  EXPECT_THROW((SampleGrid{0.0, 0.0, 1.0, 0}.check()), std::invalid_argument);
  EXPECT_THROW((SampleGrid{kNan, 1.0, 1.0, 0}.check()), std::invalid_argument);
  EXPECT_THROW(PairLink(r, r, 1e3, kNan), std::invalid_argument);
}

struct Signs : testing::Test {
  SampledOrbit orbit = satellite(0.0);
  [[nodiscard]] PairTruth of(const PairReceiver& target, const PairReceiver& anchor, double sent_s = 20.0) const {
    PairTruth truth;
    EXPECT_TRUE(PairLink(target, anchor, kRateHz, kCarrierHz).truth(orbit, sent_s, kCarrierHz, truth));
    return truth;
  }
};

TEST_F(Signs, FartherIsLater) {
  const PairTruth truth = of(receiver(kSite - Eigen::Vector3d(3e3, 0.0, 0.0)), receiver(kSite));
  EXPECT_GT(truth.tdoa_s, 0.0);
  EXPECT_NEAR(truth.tdoa_s * kSpeedOfLightMps, truth.target.path.range_m - truth.anchor.path.range_m, 1e-6);
}

TEST_F(Signs, AClockAheadStampsLater) {
  const PairTruth truth = of(receiver(kSite, 5e-6), receiver(kSite));
  EXPECT_NEAR(truth.tdoa_s, 5e-6, 1e-18);
  EXPECT_EQ(truth.fdoa_hz, 0.0);
  EXPECT_NEAR(of(receiver(kSite), receiver(kSite, 5e-6)).tdoa_s, -5e-6, 1e-18);
}

TEST_F(Signs, AFastClockSeesCarriersLower) {
  const PairTruth truth = of(receiver(kSite, 0.0, 1e-6), receiver(kSite));
  EXPECT_NEAR(truth.fdoa_hz, -1e-6 * kCarrierHz, 0.05);
  EXPECT_GT(truth.tdoa_s, 0.0);  // 20 s of it
  EXPECT_NEAR(truth.target.frequency_hz - truth.anchor.frequency_hz, truth.fdoa_hz, 1e-6);
}

TEST_F(Signs, ComingNearerIsHigher) {
  // The satellite leaves along +y: the receiver behind sees it recede faster.
  const Eigen::Vector3d ahead(0.0, 200e3, 300e3);
  EXPECT_GT(of(receiver(kSite + ahead), receiver(kSite)).fdoa_hz, 100.0);
  EXPECT_NEAR(of(receiver(kSite), receiver(kSite)).anchor.frequency_hz,
              kCarrierHz * (1.0 - of(receiver(kSite), receiver(kSite)).anchor.path.delay_rate), 1e-6);
}

TEST_F(Signs, SwappedReceiversSwapTheSigns) {
  const PairReceiver a = receiver(kSite + Eigen::Vector3d(0.0, 9e3, 1e3), 3e-4, 4e-7),
                     b = receiver(kSite, -1e-4, -2e-7);
  const PairTruth one = of(a, b), other = of(b, a);
  EXPECT_EQ(one.tdoa_s, -other.tdoa_s);
  EXPECT_EQ(one.fdoa_hz, -other.fdoa_hz);
}

TEST_F(Signs, DelayRatesAndDriftsAreOneDerivative) {
  // d reading / d sent by differences is the stretch that arrival_of states: f / frequency.
  const PairReceiver r = receiver(kSite, 1e-4, 3e-7);
  Arrival before, at, after;
  ASSERT_TRUE(arrival_of(r, orbit, 9.95, kCarrierHz, before));
  ASSERT_TRUE(arrival_of(r, orbit, 10.0, kCarrierHz, at));
  ASSERT_TRUE(arrival_of(r, orbit, 10.05, kCarrierHz, after));
  EXPECT_NEAR((after.reading_s - before.reading_s) / 0.1, kCarrierHz / at.frequency_hz, 2e-12);
  double sent_s = 0.0;
  ASSERT_TRUE(sent_time(r, orbit, at.reading_s, sent_s));
  EXPECT_NEAR(sent_s, 10.0, 1e-14);
}

TEST(PairLink, NothingOnTheHeap) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  std::vector<Cf32> tone(1625, Cf32(1.0F, 0.0F));
  const SampledEnvelope envelope(tone, kRateHz);
  const SampledOrbit orbit = satellite(0.0);
  const PairLink link(receiver(kSite + Eigen::Vector3d(0.0, 9e3, 1e3), 3e-4, 4e-7), receiver(kSite), kRateHz,
                      kCarrierHz);
  std::vector<Cf32> target(2000), anchor(2000);
  PairTruth truth;
  bool fine = true;
  EXPECT_EQ(test::allocations_of([&] {
              fine = link.truth(orbit, 0.02, kCarrierHz, truth) &&
                     link.render(envelope.view(), orbit, {0.0, kCarrierHz}, 0.0, target, 0.0, anchor);
            }),
            0);
  EXPECT_TRUE(fine);
  EXPECT_GT(mean_power(target), 0.5);
  EXPECT_GT(mean_power(anchor), 0.5);
}

}  // namespace
}  // namespace soopnav::simulation
