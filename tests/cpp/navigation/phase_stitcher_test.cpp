#include "soopnav/navigation/phase_stitcher.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/clock/clock_simulator.hpp"
#include "soopnav/core/random.hpp"
#include "support/allocation_count.hpp"

namespace soopnav::navigation {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

struct Pass {
  std::vector<PhaseBurst> bursts;
  std::vector<double> truth;           // phase less gamma
  std::vector<std::int64_t> integers;  // n, from 0
};

StitcherOptions pass_options() {
  StitcherOptions options;
  options.clock = clock::ClockNoise::from_allan(1e-23, 1e-25);
  return options;
}

// `times` of reception; sigmas of 45 dB-Hz unless given.
Pass make_pass(std::uint64_t seed, const std::vector<double>& times, int fractions = 4, double sigma = 0.00695,
               double sigma_f = 2.91, double doppler_hz = 5.0, double rate_hzps = 0.3) {
  RandomStream random(seed);
  const StitcherOptions options = pass_options();
  clock::ClockSimulator wander(options.clock, random.substream(1));
  const double f = random.normal(0.0, doppler_hz), r = random.normal(0.0, rate_hzps);
  Pass pass;
  std::int64_t first = 0;
  for (std::size_t k = 0; k < times.size(); ++k) {
    if (k > 0) {
      EXPECT_TRUE(wander.advance(times[k] - times[k - 1]));
    }
    const double t = times[k] - times[0];
    const double x = f * t + 0.5 * r * t * t + wander.state().bias_m / options.wavelength_m;
    const auto n = static_cast<std::int64_t>(random.next_u32() % 64U) - 32;
    if (k == 0) first = n;
    const double predicted = 1000.0 * t, M = fractions;
    pass.truth.push_back(x + predicted);
    pass.integers.push_back(n - first);
    pass.bursts.push_back({times[k], x + predicted + static_cast<double>(n) / M + random.normal(0.0, sigma), sigma,
                           f + r * t + 1000.0 + random.normal(0.0, sigma_f), sigma_f, predicted, 1000.0});
  }
  return pass;
}

std::vector<double> even_times(std::size_t count, double gap = 0.09) {
  std::vector<double> times(count);
  for (std::size_t k = 0; k < count; ++k) times[k] = 10.0 + gap * static_cast<double>(k);
  return times;
}

std::vector<StitchedBurst> stitch(PhaseStitcher& stitcher, const std::vector<PhaseBurst>& bursts, bool early = false) {
  std::vector<StitchedBurst> out;
  for (const PhaseBurst& burst : bursts) {
    static_cast<void>(stitcher.push(burst));
    out.insert(out.end(), stitcher.decided().begin(), stitcher.decided().end());
  }
  stitcher.finish(early);
  out.insert(out.end(), stitcher.decided().begin(), stitcher.decided().end());
  return out;
}

TEST(PhaseStitcher, IntegersOfAPassAreRightAndItsPhaseContinuous) {
  int wrong = 0, fixed = 0;
  for (std::uint64_t seed = 1; seed <= 60; ++seed) {
    const Pass pass = make_pass(seed, even_times(60));
    PhaseStitcher stitcher(pass_options());
    const auto out = stitch(stitcher, pass.bursts);
    ASSERT_EQ(out.size(), pass.bursts.size());
    bool right = true;
    for (std::size_t k = 0; k < out.size(); ++k) {
      EXPECT_EQ(out[k].burst, k);
      right = right && out[k].integer == pass.integers[k];
    }
    wrong += right ? 0 : 1;
    if (!out.back().fixed) continue;
    ++fixed;
    EXPECT_EQ(out.back().arc, out.front().arc);
    if (!right) continue;
    const double gamma = out[0].phase_cycles - pass.truth[0];
    for (std::size_t k = 0; k < out.size(); ++k) EXPECT_NEAR(out[k].phase_cycles - pass.truth[k], gamma, 0.07);
  }
  EXPECT_LE(wrong, 3);  // one in a thousand each
  EXPECT_GE(fixed, 50);
}

TEST(PhaseStitcher, WithoutFrequencyAliasesStayAndAreSaid) {
  Pass pass = make_pass(3, even_times(60));
  for (PhaseBurst& burst : pass.bursts) burst.frequency_hz = kNan;
  PhaseStitcher stitcher(pass_options());
  const auto out = stitch(stitcher, pass.bursts);
  // The prior of 5 Hz holds several frequencies 1 / (4 * 90 ms) apart: none can have a posterior of 0.999.
  for (std::size_t k = 1; k < out.size(); ++k) {
    EXPECT_FALSE(out[k].fixed);
    EXPECT_LT(out[k].posterior, 0.7);
    EXPECT_EQ(out[k].arc, out[k - 1].arc + 1);
  }
  // The spread over the hypotheses is in the sigma: steps of a quarter cycle.
  EXPECT_GT(out[30].sigma_cycles, 0.05);
}

TEST(PhaseStitcher, UnequalGapsAndMissedBursts) {
  RandomStream random(5);
  int right = 0, all = 0;
  for (std::uint64_t seed = 100; seed < 130; ++seed) {
    std::vector<double> times{0.0};
    while (times.size() < 60) times.push_back(times.back() + 0.09 * (1.0 + std::floor(3.0 * random.uniform())));
    const Pass pass = make_pass(seed, times);
    PhaseStitcher stitcher(pass_options());
    const auto out = stitch(stitcher, pass.bursts);
    for (std::size_t k = 1; k < out.size(); ++k) {
      ++all;
      right += out[k].step == pass.integers[k] - pass.integers[k - 1] ? 1 : 0;
    }
  }
  EXPECT_GE(right, all - 3 * 59);
}

TEST(PhaseStitcher, StreamsOnceTheFrequencyIsClear) {
  const Pass pass = make_pass(7, even_times(150));
  StitcherOptions options = pass_options();
  PhaseStitcher stitcher(options);
  std::size_t total = 0;
  for (std::size_t k = 0; k < pass.bursts.size(); ++k) {
    const BurstStatus status = stitcher.push(pass.bursts[k]);
    EXPECT_EQ(status, k == 0 ? BurstStatus::kStarted : BurstStatus::kAccepted);
    total += stitcher.decided().size();
    if (k > 0 && k + 1 < 60) {
      EXPECT_EQ(total, 1U);
    }
    if (k >= 60) {
      EXPECT_EQ(stitcher.decided().size(), 1U);  // at once
    }
  }
  EXPECT_EQ(stitcher.waiting(), 0U);
  EXPECT_EQ(stitcher.hypotheses(), 1);
  EXPECT_GT(stitcher.posterior(), 0.999);
  EXPECT_LT(stitcher.frequency_error_sigma_hz(), 0.2);
}

TEST(PhaseStitcher, RefusesBadBurstsAndStaysAsItWas) {
  const Pass pass = make_pass(8, even_times(70));
  PhaseStitcher clean(pass_options()), dirty(pass_options());
  std::vector<StitchedBurst> a, b;
  for (const PhaseBurst& burst : pass.bursts) {
    static_cast<void>(clean.push(burst));
    a.insert(a.end(), clean.decided().begin(), clean.decided().end());
    PhaseBurst bad = burst;
    for (double PhaseBurst::*field : {&PhaseBurst::t_s, &PhaseBurst::phase_cycles, &PhaseBurst::phase_sigma_cycles,
                                      &PhaseBurst::predicted_cycles, &PhaseBurst::predicted_rate_cyclesps}) {
      for (const double value : {kNan, std::numeric_limits<double>::infinity()}) {
        bad = burst;
        bad.*field = value;
        EXPECT_EQ(dirty.push(bad), BurstStatus::kNotFinite);
      }
    }
    bad = burst;
    bad.frequency_sigma_hz = 0.0;
    EXPECT_EQ(dirty.push(bad), BurstStatus::kNotFinite);
    const auto status = dirty.push(burst);
    EXPECT_TRUE(status == BurstStatus::kStarted || status == BurstStatus::kAccepted);
    b.insert(b.end(), dirty.decided().begin(), dirty.decided().end());
    EXPECT_EQ(dirty.push(burst), BurstStatus::kNotLater);
  }
  ASSERT_EQ(a.size(), b.size());
  for (std::size_t k = 0; k < a.size(); ++k) EXPECT_EQ(a[k].phase_cycles, b[k].phase_cycles);
}

TEST(PhaseStitcher, OutliersAreLeftOutAndManyBeginAnew) {
  Pass pass = make_pass(9, even_times(100));
  for (std::size_t k = 70; k < 100; ++k) pass.bursts[k].phase_cycles += 0.11;  // nearly half a cell
  PhaseStitcher stitcher(pass_options());
  int outliers = 0, lost = 0;
  for (const PhaseBurst& burst : pass.bursts) {
    const BurstStatus status = stitcher.push(burst);
    outliers += status == BurstStatus::kOutlier ? 1 : 0;
    lost += status == BurstStatus::kLost ? 1 : 0;
  }
  EXPECT_EQ(outliers, 4);
  EXPECT_EQ(lost, 1);
}

TEST(PhaseStitcher, NoNumberOfOneBurstThrowsThePassAway) {
  const Pass pass = make_pass(12, even_times(70));
  PhaseStitcher clean(pass_options()), dirty(pass_options());
  std::vector<StitchedBurst> a, b;
  const auto spoil = [&dirty](const PhaseBurst& burst, double PhaseBurst::*field, double value) {
    PhaseBurst bad = burst;
    bad.*field = value;
    EXPECT_EQ(dirty.push(bad), BurstStatus::kOutlier) << value;
    EXPECT_TRUE(dirty.decided().empty());
  };
  for (const PhaseBurst& burst : pass.bursts) {
    for (const double value : {1e16, -1e16, 1e300}) spoil(burst, &PhaseBurst::phase_cycles, value);
    if (&burst != pass.bursts.data()) {
      spoil(burst, &PhaseBurst::frequency_hz, 1e300);
      spoil(burst, &PhaseBurst::predicted_rate_cyclesps, 1e300);
    }
    static_cast<void>(clean.push(burst));
    a.insert(a.end(), clean.decided().begin(), clean.decided().end());
    static_cast<void>(dirty.push(burst));
    b.insert(b.end(), dirty.decided().begin(), dirty.decided().end());
  }
  EXPECT_EQ(dirty.waiting(), clean.waiting());
  ASSERT_EQ(a.size(), b.size());
  for (std::size_t k = 0; k < a.size(); ++k) {
    EXPECT_EQ(a[k].integer, b[k].integer);
    EXPECT_EQ(a[k].fixed, b[k].fixed);
    EXPECT_EQ(a[k].arc, b[k].arc);
  }
}

TEST(PhaseStitcher, TooLongAGapBeginsAnotherArc) {
  const Pass pass = make_pass(10, even_times(80));
  PhaseStitcher stitcher(pass_options());
  std::uint32_t arc = 0;
  for (const PhaseBurst& burst : pass.bursts) {
    static_cast<void>(stitcher.push(burst));
    for (const StitchedBurst& b : stitcher.decided()) arc = b.arc;
  }
  PhaseBurst later = pass.bursts.back();
  later.t_s += 5000.0;
  EXPECT_EQ(stitcher.push(later), BurstStatus::kGapTooLong);
  ASSERT_EQ(stitcher.decided().size(), 1U);
  EXPECT_GT(stitcher.decided().back().arc, arc);
  EXPECT_EQ(stitcher.decided().back().integer, 0);
  EXPECT_EQ(stitcher.waiting(), 0U);
}

TEST(PhaseStitcher, EarlyDecisionsOnDemand) {
  const Pass pass = make_pass(11, even_times(40), 4, 0.00695, 0.3);  // a frequency that tells at once
  PhaseStitcher waits(pass_options()), early(pass_options());
  for (const StitchedBurst& b : stitch(waits, pass.bursts)) EXPECT_EQ(b.fixed, b.step == 0 && b.burst == 0);
  for (const StitchedBurst& b : stitch(early, pass.bursts, true)) {
    EXPECT_TRUE(b.fixed);
    EXPECT_EQ(b.integer, pass.integers[b.burst]);
  }
}

TEST(PhaseStitcher, OptionsAreChecked) {
  const auto refused = [](auto change, const char* name) {
    StitcherOptions options;
    change(options);
    try {
      const PhaseStitcher stitcher(options);
      ADD_FAILURE() << name << " was taken";
    } catch (const std::invalid_argument& error) {
      EXPECT_EQ(std::string(error.what()).rfind(name, 0), 0U) << error.what();
    }
  };
  refused([](auto& o) { o.fractions = 0; }, "fractions");
  refused([](auto& o) { o.wavelength_m = kNan; }, "wavelength_m");
  refused([](auto& o) { o.clock.white_frequency_m2ps = -1.0; }, "clock.white");
  refused([](auto& o) { o.clock.frequency_walk_m2ps3 = kNan; }, "clock.frequency");
  refused([](auto& o) { o.frequency_sigma_hz = 0.0; }, "frequency_sigma_hz");
  refused([](auto& o) { o.rate_sigma_hzps = -1.0; }, "rate_sigma_hzps");
  refused([](auto& o) { o.rate_walk_hz2ps3 = -1.0; }, "rate_walk_hz2ps3");
  refused([](auto& o) { o.decision_bursts = 1; }, "decision_bursts");
  refused([](auto& o) { o.posterior = 1.0; }, "posterior");
  refused([](auto& o) { o.hypotheses = 1; }, "hypotheses");
  refused([](auto& o) { o.gate_sigma = 1.0; }, "gate_sigma");
  refused([](auto& o) { o.outliers = 0; }, "outliers");
  for (int k = 0; k <= static_cast<int>(BurstStatus::kLost); ++k) {
    EXPECT_NE(to_string(static_cast<BurstStatus>(k)), "unknown");
  }
}

TEST(PhaseStitcher, DoesNotAllocate) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  const Pass pass = make_pass(12, even_times(130));
  PhaseStitcher stitcher(pass_options());
  EXPECT_EQ(test::allocations_of([&] {
              for (const PhaseBurst& burst : pass.bursts) static_cast<void>(stitcher.push(burst));
              stitcher.finish();
            }),
            0);
}

}  // namespace
}  // namespace soopnav::navigation
