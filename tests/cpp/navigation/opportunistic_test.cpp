#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/clock/clock_simulator.hpp"
#include "soopnav/clock/oscillator.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/geometry/orbit.hpp"
#include "soopnav/navigation/opportunistic_navigator.hpp"
#include "soopnav/navigation/opportunistic_smoother.hpp"
#include "support/allocation_count.hpp"

namespace soopnav::navigation {
namespace {

const Eigen::Vector3d kPlace(-740289.9, -5457071.7, 3207245.6);
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kL1Hz = 1575.42e6;
constexpr double kCdmaHz = 1.9e9;

std::shared_ptr<const geometry::SampledOrbit> gps_orbit(int number) {
  const double node = 2.6 + 0.5 * number;
  const geometry::J2Orbit orbit({26.56e6, 0.0, 0.96, node, 0.0, 1.1 * number}, 0.0, 0.0);
  return std::make_shared<const geometry::SampledOrbit>(orbit.sampled(-30.0, 400.0));
}

OpportunisticStart a_start() {
  OpportunisticStart start;
  start.position_e_m = kPlace;
  start.position_covariance_m2 = 100.0 * Eigen::Matrix3d::Identity();
  start.clock_covariance << 1e4, 0.0, 0.0, 1.0;
  return start;
}

OpportunisticOptions options_of(OpportunisticForm form, OpportunisticMotion motion = OpportunisticMotion::kStatic) {
  OpportunisticOptions o;
  o.form = form;
  o.motion = motion;
  o.max_sources = 12;
  o.clock = clock::Oscillator::tcxo().noise();
  o.acceleration_psd_m2ps3 = 0.01;
  return o;
}

OpportunisticSource a_satellite(int number) {
  OpportunisticSource s;
  s.name = "G" + std::to_string(number);
  s.carrier_hz = kL1Hz;
  s.orbit = gps_orbit(number);
  s.clock_bias_m = 3.0;
  s.clock_drift_mps = 0.01;
  s.ambiguity_sigma_cycles = 500.0;
  return s;
}

OpportunisticSource a_mast(int number, bool surveyed = true) {
  OpportunisticSource s;
  s.name = "C" + std::to_string(number);
  s.carrier_hz = kCdmaHz;
  s.position_e_m = kPlace + Eigen::Vector3d(1500.0 + 300.0 * number, -800.0 * number, 900.0);
  if (!surveyed) s.position_covariance_m2 = 25.0 * Eigen::Matrix3d::Identity();
  s.clock_estimated = true;
  s.clock_noise = clock::Oscillator::ocxo().noise();
  s.clock_bias_m = 12.0;
  s.clock_drift_mps = -0.02;
  s.clock_covariance << 400.0, 0.0, 0.0, 1e-3;
  s.ambiguity_sigma_cycles = 500.0;
  return s;
}

// What all sources of a navigator would give at its present state, with noise.
std::vector<OpportunisticObservation> observe(const OpportunisticNavigator& navigator, double t_s, RandomStream& random,
                                              double phase_sigma = 2e-3, double range_sigma = 1.0) {
  std::vector<OpportunisticObservation> out;
  std::vector<double> row(static_cast<std::size_t>(navigator.dim()));
  for (const int id : navigator.sources()) {
    for (const ObservableKind kind : {ObservableKind::kPhase, ObservableKind::kPseudorange}) {
      OpportunisticObservation o;
      o.source = id;
      o.kind = kind;
      o.sigma = kind == ObservableKind::kPhase ? phase_sigma : range_sigma;
      EXPECT_TRUE(navigator.expected(t_s, o, o.value, row));
      o.value += o.sigma * random.normal();
      out.push_back(o);
    }
  }
  return out;
}

// Of two covariances, each component to its sigma.
double relative_difference(const OpportunisticNavigator& a, const OpportunisticNavigator& b) {
  const Eigen::MatrixXd P = a.covariance();
  const Eigen::VectorXd weight = P.diagonal().cwiseSqrt().cwiseInverse();
  return (weight.asDiagonal() * (P - b.covariance()).eval() * weight.asDiagonal()).eval().cwiseAbs().maxCoeff();
}

// Of two means: metres, m/s and cycles. ECEF coordinates and phases of satellites are rounded to 1e-9 and 1e-8.
double difference(const OpportunisticNavigator& a, const OpportunisticNavigator& b) {
  return (a.mean() - b.mean()).cwiseAbs().maxCoeff();
}

TEST(OpportunisticModels, JacobiansAreThoseOfDifferences) {
  // A state is moved by moving the start or the prior of what is moved.
  struct Case {
    OpportunisticSource source;
    bool needs_position = false;
  };
  std::vector<Case> cases{{a_satellite(1)}, {a_mast(1)}, {a_mast(2, false)}};
  OpportunisticSource bare = a_mast(3);
  bare.position_e_m.reset();
  cases.push_back({bare, true});
  for (const TimeTag tag : {TimeTag::kReceiver, TimeTag::kSystem}) {
    for (const Case& c : cases) {
      for (const ObservableKind kind : {ObservableKind::kPhase, ObservableKind::kPseudorange}) {
        OpportunisticObservation o;
        o.source = 0;
        o.kind = kind;
        o.correction_m = 4.5;
        if (c.needs_position) o.source_position_e_m = kPlace + Eigen::Vector3d(1.7e5, 2.2e7, 1.0e7);
        const auto at = [&](int component, double by, std::vector<double>& row) {
          OpportunisticStart start = a_start();
          OpportunisticSource source = c.source;
          start.clock_bias_m = 3e4;  // 0.1 ms: satellites move 0.4 m in it
          // Components: p 0-2, drift 3, bias 4, then of the source.
          int next = 5;
          if (component < 3) start.position_e_m[component] += by;
          if (component == 3) start.clock_drift_mps += by;
          if (component == 4) start.clock_bias_m += by;
          if (source.position_covariance_m2) {
            if (component >= next && component < next + 3) (*source.position_e_m)[component - next] += by;
            next += 3;
          }
          if (source.clock_estimated) {
            if (component == next) source.clock_drift_mps += by;
            if (component == next + 1) source.clock_bias_m += by;
            next += 2;
          }
          if (component == next) source.ambiguity_cycles += by;
          OpportunisticOptions options = options_of(OpportunisticForm::kSquareRoot);
          options.time_tag = tag;
          OpportunisticNavigator navigator(start, options);
          EXPECT_EQ(navigator.add_source(source), 0);
          double value = kNaN;
          row.assign(static_cast<std::size_t>(navigator.dim()), kNaN);
          EXPECT_TRUE(navigator.expected(17.25, o, value, row));
          return value;
        };
        std::vector<double> row, unused;
        at(-1, 0.0, row);
        const double scale = kind == ObservableKind::kPhase ? c.source.carrier_hz / kSpeedOfLightMps : 1.0;
        for (int i = 0; i < static_cast<int>(row.size()); ++i) {
          const double step = i == static_cast<int>(row.size()) - 1 ? 1.0 : 0.5;
          const double slope = (at(i, step, unused) - at(i, -step, unused)) / (2.0 * step);
          EXPECT_NEAR(row[static_cast<std::size_t>(i)], slope, 1e-7 * scale)
              << "component " << i << " of " << c.source.name << ", tag " << static_cast<int>(tag);
        }
      }
    }
  }
}

TEST(OpportunisticModels, SignsAreThoseOfTheHouse) {
  OpportunisticNavigator navigator(a_start(), options_of(OpportunisticForm::kSquareRoot));
  const int mast = navigator.add_source(a_mast(1));
  std::vector<double> row(static_cast<std::size_t>(navigator.dim()));
  OpportunisticObservation o;
  o.source = mast;
  double phase = kNaN, range = kNaN;
  ASSERT_TRUE(navigator.expected(0.0, o, phase, row));
  EXPECT_GT(row[4], 0.0);  // a fast receiver clock lengthens
  EXPECT_LT(row[6], 0.0);  // a fast source clock shortens
  EXPECT_EQ(row[7], 1.0);
  o.kind = ObservableKind::kPseudorange;
  ASSERT_TRUE(navigator.expected(0.0, o, range, row));
  EXPECT_NEAR(phase * kSpeedOfLightMps / kCdmaHz, range, 1e-6);
  EXPECT_NEAR(range, (*a_mast(1).position_e_m - kPlace).norm() - 12.0, 0.05);  // the Earth's turn: centimetres
}

// A run in which sources come and go, by two navigators at once.
template <class Each>
void run_with_joins(std::vector<OpportunisticNavigator*> navigators, int steps, Each&& each) {
  RandomStream random(7);
  int next = 0;
  for (int k = 0; k < steps; ++k) {
    const double t_s = 0.1 * k;
    if (k % 10 == 0) {
      const OpportunisticSource joining = next % 3 == 0 ? a_mast(next, next % 2 == 0) : a_satellite(next);
      for (auto* n : navigators) n->add_source(joining);
      ++next;
      if (next > 6) {
        for (auto* n : navigators) ASSERT_TRUE(n->remove_source(n->sources()[static_cast<std::size_t>(next % 4)]));
      }
    }
    const auto observed = observe(*navigators.front(), t_s, random);
    for (auto* n : navigators) each(*n, t_s, observed);
  }
}

TEST(OpportunisticForms, BothGiveTheSameNumbers) {
  for (const OpportunisticMotion motion :
       {OpportunisticMotion::kKnown, OpportunisticMotion::kStatic, OpportunisticMotion::kVelocity}) {
    OpportunisticNavigator root(a_start(), options_of(OpportunisticForm::kSquareRoot, motion));
    OpportunisticNavigator joseph(a_start(), options_of(OpportunisticForm::kJoseph, motion));
    run_with_joins({&root, &joseph}, 150, [](OpportunisticNavigator& n, double t_s, const auto& observed) {
      const auto report = n.step(t_s, observed);
      ASSERT_EQ(report.accepted, static_cast<int>(observed.size()));
    });
    // A covariance of 250 000 cycles² loses digits beside phases of 4e-6.
    EXPECT_LT(relative_difference(root, joseph), 1e-4);
    EXPECT_LT(difference(root, joseph), 1e-4);
    const Eigen::MatrixXd P = root.covariance();
    EXPECT_EQ(P, P.transpose());
    EXPECT_EQ(P.llt().info(), Eigen::Success);
  }
}

TEST(OpportunisticForms, AgreeToNineDigitsWhereDoublesAllowIt) {
  // Linear, and well conditioned. A position that is weakly observable amplifies the rounding of ECEF coordinates.
  auto gentle = [](OpportunisticForm form) {
    OpportunisticNavigator n(a_start(), options_of(form, OpportunisticMotion::kKnown));
    for (int k = 0; k < 5; ++k) {
      OpportunisticSource s = k < 3 ? a_satellite(k) : a_mast(k);
      s.ambiguity_sigma_cycles = 1.0;
      n.add_source(s);
    }
    return n;
  };
  OpportunisticNavigator root = gentle(OpportunisticForm::kSquareRoot);
  OpportunisticNavigator joseph = gentle(OpportunisticForm::kJoseph);
  RandomStream random(3);
  for (int k = 0; k < 50; ++k) {
    const auto observed = observe(root, 0.1 * k, random, 0.05, 2.0);
    ASSERT_EQ(root.step(0.1 * k, observed).accepted, 10);
    ASSERT_EQ(joseph.step(0.1 * k, observed).accepted, 10);
  }
  EXPECT_LT(relative_difference(root, joseph), 1e-9);
  EXPECT_LT(difference(root, joseph), 3e-7);
}

TEST(OpportunisticForms, TheRootStaysPositiveWhereJosephLosesDigits) {
  // Phases of 1e-6 cycles beside a clock known to 1 s: a ratio of 1e30 in the covariance.
  OpportunisticStart start = a_start();
  start.clock_covariance << 1e17, 0.0, 0.0, 1e4;
  start.position_covariance_m2 *= 1e4;
  OpportunisticOptions options = options_of(OpportunisticForm::kSquareRoot);
  options.time_tag = TimeTag::kSystem;
  OpportunisticNavigator root(start, options);
  for (int k = 0; k < 6; ++k) root.add_source(k < 4 ? a_satellite(k) : a_mast(k));
  RandomStream random(5);
  for (int k = 0; k < 100; ++k) {
    const auto report = root.step(0.1 * k, observe(root, 0.1 * k, random, 1e-6, 1.0));
    ASSERT_EQ(report.accepted, 12) << k;
  }
  // The sum of clock and ambiguity is known to microcycles, though each alone is not; and it is consistent.
  const Eigen::MatrixXd P = root.covariance();
  EXPECT_TRUE(P.allFinite());
  EXPECT_GT(P.diagonal().minCoeff(), 0.0);
  std::vector<double> row(static_cast<std::size_t>(root.dim()));
  const auto observed = observe(root, 10.0, random, 1e-6, 1.0);
  const auto report = root.step(10.0, observed);
  EXPECT_LT(report.nis, 60.0);  // chi-square of 12: 1e-7
  EXPECT_GT(report.nis, 0.5);
}

TEST(OpportunisticLaws, ASourceThatIsNotObservedChangesNothing) {
  for (const OpportunisticForm form : {OpportunisticForm::kSquareRoot, OpportunisticForm::kJoseph}) {
    OpportunisticNavigator with(a_start(), options_of(form)), without(a_start(), options_of(form));
    for (auto* n : {&with, &without}) {
      for (int k = 0; k < 3; ++k) n->add_source(a_satellite(k));
    }
    RandomStream random(2);
    for (int k = 0; k < 30; ++k) {
      if (k == 10) with.add_source(a_mast(9, false));
      const auto observed = observe(without, 0.1 * k, random);
      ASSERT_EQ(with.step(0.1 * k, observed).accepted, 6);
      ASSERT_EQ(without.step(0.1 * k, observed).accepted, 6);
    }
    const Eigen::Index n = without.dim();
    EXPECT_LT((with.mean().head(n) - without.mean()).cwiseAbs().maxCoeff(), 1e-9);
    EXPECT_LT((with.covariance().topLeftCorner(n, n) - without.covariance()).cwiseAbs().maxCoeff(), 1e-9);
    EXPECT_LT(with.covariance().bottomLeftCorner(6, n).cwiseAbs().maxCoeff(), 1e-12);
  }
}

TEST(OpportunisticLaws, RemovingIsMarginalising) {
  for (const OpportunisticForm form : {OpportunisticForm::kSquareRoot, OpportunisticForm::kJoseph}) {
    OpportunisticNavigator n(a_start(), options_of(form));
    for (int k = 0; k < 4; ++k) n.add_source(k == 1 ? a_mast(1, false) : a_satellite(k));
    RandomStream random(2);
    for (int k = 0; k < 20; ++k) n.step(0.1 * k, observe(n, 0.1 * k, random));
    const Eigen::MatrixXd P = n.covariance();
    const Eigen::VectorXd x = n.mean();
    const auto names = n.component_names();
    ASSERT_TRUE(n.remove_source(1));
    EXPECT_FALSE(n.remove_source(1));
    std::vector<Eigen::Index> kept;
    for (std::size_t i = 0; i < names.size(); ++i) {
      if (names[i].rfind("C1", 0) != 0) kept.push_back(static_cast<Eigen::Index>(i));
    }
    ASSERT_EQ(static_cast<std::size_t>(n.dim()), kept.size());
    EXPECT_EQ(n.mean(), Eigen::VectorXd(x(kept)));
    const Eigen::MatrixXd expected = P(kept, kept);
    EXPECT_LT(((n.covariance() - expected).array().abs() / P.diagonal().maxCoeff()).maxCoeff(), 1e-13);
    EXPECT_EQ(n.find_source("C1"), -1);
    EXPECT_FALSE(n.source(1).has_value());
  }
}

TEST(OpportunisticLaws, TheOrderOfObservablesDoesNotMatter) {
  // With a position, H differs by what ECEF coordinates are rounded to, which weak directions amplify.
  struct Case {
    OpportunisticMotion motion;
    double of_covariance, of_mean;
  };
  for (const Case& c :
       {Case{OpportunisticMotion::kKnown, 1e-7, 2e-7}, Case{OpportunisticMotion::kStatic, 1e-4, 5e-5}}) {
    OpportunisticNavigator one(a_start(), options_of(OpportunisticForm::kSquareRoot, c.motion));
    OpportunisticNavigator other(a_start(), options_of(OpportunisticForm::kSquareRoot, c.motion));
    for (auto* n : {&one, &other}) {
      for (int k = 0; k < 6; ++k) n->add_source(k < 4 ? a_satellite(k) : a_mast(k));
    }
    RandomStream random(2);
    for (int k = 0; k < 20; ++k) {
      auto observed = observe(one, 0.1 * k, random);
      ASSERT_EQ(one.step(0.1 * k, observed).accepted, 12);
      std::reverse(observed.begin(), observed.end());
      ASSERT_EQ(other.step(0.1 * k, observed).accepted, 12);
    }
    EXPECT_LT(relative_difference(one, other), c.of_covariance);
    EXPECT_LT(difference(one, other), c.of_mean);
  }
}

// A receiver that has settled on three satellites and a mast.
OpportunisticNavigator a_settled(OpportunisticForm form, RandomStream& random) {
  OpportunisticNavigator n(a_start(), options_of(form, OpportunisticMotion::kVelocity));
  for (int k = 0; k < 3; ++k) n.add_source(a_satellite(k));
  n.add_source(a_mast(1));
  for (int k = 0; k < 30; ++k) EXPECT_EQ(n.step(0.1 * k, observe(n, 0.1 * k, random)).accepted, 8);
  return n;
}

// How far the first `count` components of two means are apart, in standard deviations of the second.
double in_sigmas(const OpportunisticNavigator& a, const OpportunisticNavigator& b, int count) {
  const Eigen::ArrayXd sigma = b.covariance().diagonal().array().sqrt();
  return ((a.mean() - b.mean()).array().abs() / sigma).head(count).maxCoeff();
}

TEST(OpportunisticFaults, AFirstPhaseBeyondItsPriorMovesOnlyItsAmbiguity) {
  struct Case {
    double sigma, offset;
  };
  for (const OpportunisticForm form : {OpportunisticForm::kSquareRoot, OpportunisticForm::kJoseph}) {
    for (const Case& c : {Case{100.0, 1e5}, Case{100.0, -1e7}, Case{1e4, 1e8}, Case{1e4, 1e11}}) {
      RandomStream random(4), same(4);
      OpportunisticNavigator with = a_settled(form, random), without = a_settled(form, same);
      OpportunisticSource joining = a_mast(2, false);
      joining.ambiguity_sigma_cycles = c.sigma;
      const int id = with.add_source(joining);
      without.add_source(joining);
      const int others = with.dim() - 1;
      auto observed = observe(with, 3.0, random);
      observed[8].value += c.offset;
      const auto report = with.step(3.0, observed);
      const ObservableReport first = with.reports()[8];
      EXPECT_EQ(first.use, ObservableUse::kSlip);
      EXPECT_NEAR(first.innovation / c.offset, 1.0, 0.01);
      EXPECT_LT(first.sigma, 3e4);
      EXPECT_EQ(report.slips, 1);
      EXPECT_EQ(report.accepted, 10);
      EXPECT_NEAR(with.source(id)->ambiguity_cycles / c.offset, 1.0, 0.01);
      EXPECT_GT(with.source(id)->ambiguity_sigma_cycles, 5.0);
      observed.erase(observed.begin() + 8);
      without.step(3.0, observed);
      EXPECT_LT(in_sigmas(with, without, others), 1e-3) << c.offset;
      // It is listened to from then on.
      for (int k = 1; k < 5; ++k) EXPECT_EQ(with.step(3.0 + 0.1 * k, observe(with, 3.0 + 0.1 * k, random)).slips, 0);
      EXPECT_FALSE(with.source(id)->suspended);
    }
  }
}

TEST(OpportunisticFaults, AFirstPhaseWithinItsPriorIsNoFault) {
  RandomStream random(4);
  OpportunisticNavigator n = a_settled(OpportunisticForm::kSquareRoot, random);
  OpportunisticSource joining = a_satellite(3);
  joining.ambiguity_sigma_cycles = 100.0;
  n.add_source(joining);
  auto observed = observe(n, 3.0, random);
  observed[8].value += 400.0;
  EXPECT_EQ(n.step(3.0, observed).slips, 0);
  EXPECT_EQ(n.reports()[8].use, ObservableUse::kAccepted);
}

TEST(OpportunisticFaults, WhatWasAskedOfAPresentSourceOutlivesSourcesThatLeave) {
  OpportunisticOptions options = options_of(OpportunisticForm::kSquareRoot);
  options.max_sources = 2;
  OpportunisticNavigator n(a_start(), options);
  const int stays = n.add_source(a_mast(1));
  n.step(0.0, {});
  ASSERT_TRUE(n.open_clock(stays, 1000.0, 1.0));
  for (int k = 0; k < 40; ++k) {
    const int leaves = n.add_source(a_mast(2));
    ASSERT_TRUE(n.open_clock(leaves, 10.0, 1.0));
    ASSERT_TRUE(n.remove_source(leaves));
  }
  n.step(1.0, {});
  EXPECT_NEAR(n.source(stays)->clock_covariance(0, 0), 1e6, 1e3);
}

TEST(OpportunisticNavigatorMemory, NothingIsAllocatedInAStep) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted here";
  for (const OpportunisticForm form : {OpportunisticForm::kSquareRoot, OpportunisticForm::kJoseph}) {
    OpportunisticNavigator n(a_start(), options_of(form, OpportunisticMotion::kVelocity));
    for (int k = 0; k < 8; ++k) n.add_source(k % 2 == 0 ? a_mast(k, k == 0) : a_satellite(k));
    n.start_recording(60);
    RandomStream random(2);
    for (int k = 0; k < 50; ++k) {
      auto observed = observe(n, 0.1 * k, random);
      if (k == 20) observed[0].value += 3.0;                          // a slip
      if (k == 25) observed[1].value += 500.0;                        // an outlier
      if (k == 30) observed[2].value = kNaN;                          // not a number
      if (k == 35) observed.insert(observed.end(), 30, observed[0]);  // too many
      OpportunisticReport report;
      const long count = test::allocations_of([&] {
        report = n.step(0.1 * k, observed);
        if (k == 40) n.open_ambiguity(1, 10.0);
        if (k == 41) n.open_clock(-1, 10.0, 0.1);
        if (k == 45) n.remove_source(3);
      });
      EXPECT_EQ(count, 0) << "step " << k;
      EXPECT_GT(report.accepted, 0);
      EXPECT_EQ(report.slips, k == 20 ? 1 : 0);
      if (k == 35) {
        EXPECT_EQ(report.rejected, static_cast<int>(observed.size()) - 24);
      }
    }
    EXPECT_EQ(n.recorded(), 50);
  }
}

TEST(OpportunisticRefusals, SetUpSaysWhatIsWrong) {
  const auto refused = [](auto&& change, const char* word) {
    OpportunisticStart start = a_start();
    OpportunisticOptions options = options_of(OpportunisticForm::kSquareRoot);
    change(start, options);
    try {
      const OpportunisticNavigator n(start, options);
      ADD_FAILURE() << word << " was taken";
    } catch (const std::invalid_argument& error) {
      EXPECT_NE(std::string(error.what()).find(word), std::string::npos) << error.what();
    }
  };
  refused([](auto& s, auto&) { s.position_e_m[1] = kNaN; }, "position_e_m");
  refused([](auto& s, auto&) { s.position_covariance_m2(0, 0) = -1.0; }, "position_covariance_m2");
  refused([](auto& s, auto&) { s.clock_covariance.setZero(); }, "clock_covariance");
  refused([](auto& s, auto&) { s.clock_bias_m = kNaN; }, "clock_bias_m");
  refused([](auto&, auto& o) { o.max_sources = 0; }, "max_sources");
  refused([](auto&, auto& o) { o.clock.white_frequency_m2ps = -1.0; }, "clock.white_frequency_m2ps");
  refused([](auto&, auto& o) { o.fault_probability = 0.0; }, "fault_probability");
  refused([](auto&, auto& o) { o.suspend_share = 1.5; }, "suspend_share");
  refused([](auto&, auto& o) { o.suspend_memory = 0.0; }, "suspend_memory");

  OpportunisticNavigator n(a_start(), options_of(OpportunisticForm::kSquareRoot));
  n.add_source(a_mast(1));
  const auto source_refused = [&n](auto&& change, const char* word) {
    OpportunisticSource s = a_mast(2);
    change(s);
    const int before = n.dim();
    try {
      n.add_source(s);
      ADD_FAILURE() << word << " was taken";
    } catch (const std::invalid_argument& error) {
      EXPECT_NE(std::string(error.what()).find(word), std::string::npos) << error.what();
    }
    EXPECT_EQ(n.dim(), before);
    EXPECT_EQ(n.sources().size(), 1U);
  };
  source_refused([](auto& s) { s.name = "C1"; }, "a source of this name is present");
  source_refused([](auto& s) { s.name.clear(); }, "name");
  source_refused([](auto& s) { s.name.assign(21, 'x'); }, "name");
  source_refused([](auto& s) { s.carrier_hz = 0.0; }, "carrier_hz");
  source_refused([](auto& s) { s.orbit = gps_orbit(1); }, "orbit");
  source_refused([](auto& s) { (*s.position_e_m)[0] = kNaN; }, "position_e_m");
  source_refused([](auto& s) { s.clock_covariance(1, 1) = -1.0; }, "clock_covariance");
  source_refused([](auto& s) { s.clock_noise.frequency_walk_m2ps3 = kNaN; }, "clock_noise.frequency_walk_m2ps3");
  source_refused([](auto& s) { s.ambiguity_sigma_cycles = 0.0; }, "ambiguity_sigma_cycles");
  source_refused([](auto& s) { s.clock_drift_mps = kNaN; }, "clock_drift_mps");
  for (int k = 2; k < 13; ++k) n.add_source(a_mast(k));
  EXPECT_THROW(n.add_source(a_mast(20)), std::invalid_argument);
  EXPECT_THROW(n.start_recording(0), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(n.smooth()), std::invalid_argument);
}

TEST(OpportunisticRefusals, DataGiveStatuses) {
  OpportunisticNavigator n(a_start(), options_of(OpportunisticForm::kSquareRoot));
  const int sat = n.add_source(a_satellite(1));
  OpportunisticSource bare = a_mast(3);
  bare.position_e_m.reset();
  const int nowhere = n.add_source(bare);
  RandomStream random(1);
  std::vector<OpportunisticObservation> observed(6);
  for (auto& o : observed) {
    o.source = sat;
    o.value = 1.0;
    o.sigma = 1.0;
  }
  observed[0].value = kNaN;
  observed[1].sigma = 0.0;
  observed[2].source = 77;
  observed[3].source = nowhere;
  observed[4].correction_m = std::numeric_limits<double>::infinity();
  observed[5].sigma = kNaN;
  const Eigen::VectorXd x = n.mean();
  const auto report = n.step(0.0, observed);
  EXPECT_EQ(report.accepted, 0);
  EXPECT_EQ(report.rejected, 6);
  EXPECT_TRUE(report.coasted());
  const ObservableUse expected[] = {ObservableUse::kNonFinite, ObservableUse::kNonFinite, ObservableUse::kUnknownSource,
                                    ObservableUse::kUndefined, ObservableUse::kNonFinite, ObservableUse::kNonFinite};
  for (std::size_t i = 0; i < 6; ++i) EXPECT_EQ(n.reports()[i].use, expected[i]) << i;
  EXPECT_EQ(n.mean(), x);
  // Time that stands or is none.
  EXPECT_EQ(n.step(0.0, {}).status, UpdateStatus::kTimeNotAdvancing);
  EXPECT_EQ(n.step(-1.0, {}).status, UpdateStatus::kTimeNotAdvancing);
  EXPECT_EQ(n.step(kNaN, {}).status, UpdateStatus::kNonFinite);
  EXPECT_EQ(n.t_s(), 0.0);
  // Beyond the orbit's samples.
  std::vector<OpportunisticObservation> one{{sat, ObservableKind::kPseudorange, 2.2e7, 1.0}};
  n.step(1000.0, one);
  EXPECT_EQ(n.reports()[0].use, ObservableUse::kUndefined);
  EXPECT_TRUE(n.mean().allFinite());
  for (int use = 0; use < 10; ++use) EXPECT_NE(to_string(static_cast<ObservableUse>(use)), "unknown");
  EXPECT_EQ(to_string(static_cast<ObservableUse>(99)), "unknown");
}

TEST(OpportunisticRefusals, HugeNumbersLeaveTheStateAlone) {
  for (const OpportunisticForm form : {OpportunisticForm::kSquareRoot, OpportunisticForm::kJoseph}) {
    for (const double huge : {2e15, -1e20, 1e160, -1e308}) {
      for (const std::size_t row : {0U, 1U, 6U, 7U}) {
        RandomStream random(4), same(4);
        OpportunisticNavigator with = a_settled(form, random), without = a_settled(form, same);
        auto observed = observe(with, 3.0, random);
        auto rest = observed;
        rest.erase(rest.begin() + static_cast<std::ptrdiff_t>(row));
        observed[row].value = huge;
        const auto report = with.step(3.0, observed);
        EXPECT_EQ(with.reports()[row].use, ObservableUse::kNonFinite);
        EXPECT_EQ(report.rejected, 1);
        EXPECT_TRUE(std::isfinite(report.nis));
        without.step(3.0, rest);
        EXPECT_EQ(with.mean(), without.mean());
        EXPECT_EQ(with.covariance(), without.covariance());
      }
    }
  }
  RandomStream random(4);
  OpportunisticNavigator n = a_settled(OpportunisticForm::kSquareRoot, random);
  const Eigen::VectorXd x = n.mean();
  const Eigen::MatrixXd P = n.covariance();
  for (const double t_s : {2e9, 1e200})
    EXPECT_EQ(n.step(t_s, observe(n, 3.0, random)).status, UpdateStatus::kNonFinite);
  EXPECT_EQ(n.mean(), x);
  EXPECT_EQ(n.covariance(), P);
  EXPECT_NEAR(n.t_s(), 2.9, 1e-12);
  auto observed = observe(n, 3.0, random);
  observed[2].sigma = 1e-170;  // its square is no number
  EXPECT_EQ(n.step(3.0, observed).accepted, 7);
  EXPECT_EQ(n.reports()[2].use, ObservableUse::kNonFinite);
}

TEST(OpportunisticRefusals, PhasesNearTheLimitDoNoHarmToOthers) {
  for (const double offset : {1e10, 1e14, 9e14}) {
    RandomStream random(4), same(4);
    OpportunisticNavigator with = a_settled(OpportunisticForm::kSquareRoot, random);
    OpportunisticNavigator without = a_settled(OpportunisticForm::kSquareRoot, same);
    for (int k = 30; k < 60; ++k) {
      auto observed = observe(without, 0.1 * k, random);
      without.step(0.1 * k, observed);
      if (k < 45) observed[0].value += offset;
      with.step(0.1 * k, observed);
    }
    EXPECT_LT(in_sigmas(with, without, 8), 3.0) << offset;
    EXPECT_TRUE(with.covariance().allFinite());
  }
}

}  // namespace
}  // namespace soopnav::navigation
