#include <gtest/gtest.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>
#include <vector>

#include "navigation/handset_walk.hpp"
#include "soopnav/navigation/handset_locator.hpp"
#include "soopnav/simulation/handset_world.hpp"
#include "support/nan.hpp"

namespace soopnav::navigation {
namespace {

using simulation::HandsetWorld;
using simulation::HandsetWorldOptions;
using namespace walks;
using ::soopnav::test::kNan;

TEST(HandsetLocator, StatusesAndRefusals) {
  const HandsetWorld w = walk(8, 3.0);
  HandsetOptions o = start_of(w, 50);
  HandsetLocator f(o);
  const std::vector<double> sigma(6, 1.0), z(w.range_m.begin(), w.range_m.begin() + 6), nothing(6, kNan);
  EXPECT_EQ(f.estimate().status, HandsetStatus::kStarting);
  EXPECT_LT((f.estimate().position_m - o.start_m).norm(), 6.0);
  EXPECT_EQ(f.update_ranges(z, sigma, kNan).use, HandsetUse::kNotFinite);
  EXPECT_EQ(f.update_ranges(std::vector<double>(5, 1.0), sigma, 0.0).use, HandsetUse::kNotFinite);
  EXPECT_EQ(f.update_ranges(nothing, sigma, 0.0).use, HandsetUse::kNothingHeard);
  const HandsetReport good = f.update_ranges(z, sigma, 0.1);
  EXPECT_EQ(good.use, HandsetUse::kUsed);
  EXPECT_EQ(good.heard, 6);
  EXPECT_EQ(f.update_ranges(z, sigma, 0.05).use, HandsetUse::kOutOfOrder);
  EXPECT_EQ(f.estimate().status, HandsetStatus::kCoasting);
  EXPECT_EQ(f.move(step_of({kNan, 0.0, 0.0}), 0.2).use, HandsetUse::kNotFinite);
  HandsetMotion bad = step_of({0.0, 0.0, 0.0});
  bad.track_covariance(0, 0) = -1.0;
  EXPECT_EQ(f.move(bad, 0.2).use, HandsetUse::kNotFinite);
  EXPECT_EQ(f.move(step_of({0.0, 0.0, 0.0}), 0.2).use, HandsetUse::kUsed);
  EXPECT_EQ(f.move(step_of({0.0, 0.0, 0.0}), 0.2).use, HandsetUse::kOutOfOrder);
  EXPECT_EQ(f.estimate().status, HandsetStatus::kTracking);
  EXPECT_EQ(f.coast(0.25).use, HandsetUse::kCoasted);
  for (int k = 0; k < 100; ++k) EXPECT_EQ(f.move(step_of({0.01, 0.0, 0.0}), 0.3 + 0.05 * k).use, HandsetUse::kUsed);
  EXPECT_EQ(f.estimate().status, HandsetStatus::kCameraOnly);
  EXPECT_EQ(f.update_ranges(z, sigma, 1.0).use, HandsetUse::kClocksDisagree);
  const double before = f.estimate().covariance_m2.trace();
  EXPECT_EQ(f.update_ranges(nothing, sigma, 12.0).use, HandsetUse::kNothingHeard);
  EXPECT_EQ(f.estimate().status, HandsetStatus::kCoasting);
  EXPECT_GT(f.estimate().covariance_m2.trace(), before + 3.0);                  // six seconds without a camera
  EXPECT_EQ(f.move(step_of({0.0, 0.0, 0.0}), 12.1).use, HandsetUse::kCoasted);  // begins before what was gone through
  EXPECT_EQ(f.move(step_of({0.0, 0.0, 0.0}), 12.2).use, HandsetUse::kUsed);
  EXPECT_EQ(f.move(step_of({0.0, 0.0, 0.0}), 9.0).use, HandsetUse::kOutOfOrder);
  EXPECT_TRUE(f.estimate().position_m.allFinite());
}

TEST(HandsetLocator, NonsenseNeitherEntersNorStays) {
  const HandsetWorld w = walk(9, 20.0);
  const std::size_t L = w.nodes_m.size();
  HandsetOptions o = start_of(w, 500);
  o.recover_after = 5;
  HandsetLocator f(o);
  int recovered = 0;
  const std::vector<double> sigma(L, 1.0);
  const Played p = play(f, w, 15.0, true, 0.0, [&](std::size_t e, std::vector<double>& z) {
    if (e >= 40 && e < 60) {
      for (std::size_t l = 0; l < L; ++l) z[l] = 1e5 * static_cast<double>(l + 1) * (e % 2 == 0 ? 1.0 : -1.0);
    }
    if (e == 50) recovered = f.update_ranges(z, sigma, w.epoch_s[e]).use == HandsetUse::kUsed ? 0 : 1;
  });
  EXPECT_EQ(recovered, 1);
  EXPECT_TRUE(p.last.position_m.allFinite() && p.last.covariance_m2.allFinite());
  EXPECT_LT(p.rms_m, 3.0);  // found again
}

// A clock unknown by a second, or ranges of a micrometre: variances 1e18 apart in one Gaussian.
TEST(HandsetLocator, FarApartVariancesKeepTheirDigits) {
  const HandsetWorld w = walk(1, 12.0);
  for (const double clock_m : {0.0, 2.5e8}) {
    for (const bool alone : {false, true}) {
      HandsetOptions o = alone ? HandsetOptions::lte_alone(w.nodes_m) : start_of(w);
      double rms[2] = {0.0, 0.0};
      for (const double sigma_m : {1000.0, 3e8}) {
        if (clock_m > sigma_m) continue;
        o.clock_sigma_m = sigma_m;
        HandsetLocator f(o);
        const Played p = play(f, w, 8.0, !alone, 0.0, [&](std::size_t, std::vector<double>& z) {
          for (double& r : z) r += clock_m;
        });
        rms[sigma_m > 1e6 ? 1 : 0] = p.rms_m;
        EXPECT_TRUE(p.last.covariance_m2.allFinite());
        EXPECT_GT(p.last.covariance_m2.determinant(), 1e-8);
        EXPECT_LT(std::abs(p.last.clock_m - clock_m - w.clock_m.back()), alone ? 20.0 : 1.0);
        EXPECT_LT(p.rms_m, alone ? 20.0 : 1.0);
      }
      if (clock_m == 0.0 && alone) {
        EXPECT_NEAR(rms[0], rms[1], 0.05 * rms[0]);
      }
    }
  }
}

TEST(HandsetLocator, RangesOfAMicrometreAreNotTheOrigin) {
  const HandsetWorld w = walk(1, 4.0);
  for (const HandsetFilter kind : {HandsetFilter::kControl, HandsetFilter::kMeasurement}) {
    for (const double sigma_m : {1e-6, 1e-12, 1e-200}) {
      HandsetOptions o = start_of(w, 64);
      o.filter = kind;
      HandsetLocator f(o);
      const std::vector<double> sigma(6, sigma_m);
      for (std::size_t e = 0; e < 20; ++e) {
        (void)f.update_ranges({w.range_m.data() + 6 * e, 6}, sigma, w.epoch_s[e]);
        const HandsetEstimate x = f.estimate();
        ASSERT_TRUE(x.position_m.allFinite());
        ASSERT_GT(x.covariance_m2.determinant(), 0.0);
        ASSERT_TRUE(std::isfinite(x.clock_m) && std::isfinite(x.heading_sigma_rad));
      }
    }
  }
}

// One set of ranges that no clock could explain leaves filters as they are that know no outliers.
TEST(HandsetLocator, RangesBeyondAllSigmasAreOutliersAlways) {
  const HandsetWorld w = walk(2, 4.0);
  for (const bool alone : {false, true}) {
    HandsetOptions o = alone ? HandsetOptions::lte_alone(w.nodes_m) : start_of(w, 64);
    o.outlier_probability = 0.0;
    HandsetLocator f(o);
    const std::vector<double> sigma(6, 1.0);
    for (std::size_t e = 0; e < 20; ++e) {
      (void)f.update_ranges({w.range_m.data() + 6 * e, 6}, sigma, w.epoch_s[e]);
    }
    const HandsetEstimate before = f.estimate();
    for (const double far : {1e160, -1e300, 1e6}) {
      EXPECT_EQ(f.update_ranges(std::vector<double>(6, far), sigma, w.epoch_s[19]).use, HandsetUse::kOutliers);
    }
    EXPECT_LT((f.estimate().position_m - before.position_m).norm(), 1e-6);
    EXPECT_EQ(f.update_ranges({w.range_m.data() + 6 * 20, 6}, sigma, w.epoch_s[20]).use, HandsetUse::kUsed);
  }
}

// What nobody foresaw: particles that are no numbers any more begin anew, and the report says so.
TEST(HandsetLocator, BeginsAnewWhenNoParticleIsANumber) {
  const HandsetWorld w = walk(2, 8.0);
  for (const HandsetFilter kind : {HandsetFilter::kControl, HandsetFilter::kMeasurement}) {
    HandsetOptions o = start_of(w, 100);
    o.filter = kind;
    HandsetLocator f(o);
    const std::vector<double> sigma(6, 1.0);
    HandsetMotion m = step_of({0.01, 0.0, 0.0});
    m.track_covariance.diagonal().setConstant(1e308);
    EXPECT_EQ(f.move(m, 0.05).use, HandsetUse::kUsed);
    m.foot_covariance = m.foot_covariance_previous = 1e308 * Eigen::Matrix2d::Identity();
    (void)f.move(m, 0.1);
    (void)f.move(m, 0.15);
    int recovered = 0;
    for (std::size_t e = 2; e < 40; ++e) {
      const HandsetReport r = f.update_ranges({w.range_m.data() + 6 * e, 6}, sigma, w.epoch_s[e]);
      recovered += r.use == HandsetUse::kRecovered ? 1 : 0;
    }
    if (kind == HandsetFilter::kControl) {
      EXPECT_GE(recovered, 1);  // type 2 takes such steps for measurements that say nothing
    }
    const HandsetEstimate x = f.estimate();
    EXPECT_TRUE(x.position_m.allFinite() && x.covariance_m2.allFinite());
    EXPECT_LT((x.position_m - w.position_m[39]).norm(), 6.0);
    std::vector<double> px(100), py(100), pa(100), weight(100);
    f.particles(px, py, pa, weight);
    EXPECT_TRUE(std::all_of(px.begin(), px.end(), [](double v) { return std::isfinite(v); }));
  }
}

// A speed unknown by that of light takes all digits of a covariance: seen, said and begun anew, then found.
TEST(HandsetLocator, CovariancesThatBreakBeginAnew) {
  const HandsetWorld w = walk(2, 4.0);
  HandsetOptions o = HandsetOptions::lte_alone(w.nodes_m);
  o.start_speed_sigma_mps = 1e9;
  HandsetLocator f(o);
  const std::vector<double> sigma(6, 1.0);
  int recovered = 0;
  for (std::size_t e = 0; e < 40; ++e) {
    const HandsetReport r = f.update_ranges({w.range_m.data() + 6 * e, 6}, sigma, w.epoch_s[e]);
    recovered += r.use == HandsetUse::kRecovered ? 1 : 0;
  }
  EXPECT_GE(recovered, 1);
  EXPECT_LT((f.estimate().position_m - w.position_m[39]).norm(), 20.0);
  EXPECT_GT(f.estimate().covariance_m2.determinant(), 0.0);
}

TEST(HandsetLocator, StepsFasterThanAnyoneWalksCoast) {
  const HandsetWorld w = walk(2, 12.0);
  for (const HandsetFilter kind : {HandsetFilter::kControl, HandsetFilter::kMeasurement}) {
    for (const Eigen::Vector3d& glitch : {Eigen::Vector3d(1000.0, 0.0, 0.0), Eigen::Vector3d(0.0, 1e12, 0.0),
                                          Eigen::Vector3d(1e300, 1e300, 0.0), Eigen::Vector3d(0.0, 0.0, 1e9)}) {
      HandsetOptions o = start_of(w, 100);
      o.filter = kind;
      HandsetLocator f(o);
      const std::vector<double> sigma(6, 1.0);
      for (std::size_t e = 0, k = 0; e < 60; ++e) {
        for (; k + 1 < w.frame_s.size() && w.frame_s[k + 1] <= w.epoch_s[e]; ++k) {
          const bool bad = k == 0 || k == 81;
          EXPECT_EQ(f.move(step_of(bad ? glitch : w.increment[k]), w.frame_s[k + 1]).use,
                    bad ? HandsetUse::kTooFast : HandsetUse::kUsed);
        }
        (void)f.update_ranges({w.range_m.data() + 6 * e, 6}, sigma, w.epoch_s[e]);
      }
      EXPECT_LT((f.estimate().position_m - w.position_m[59]).norm(), 2.0);
    }
  }
  HandsetOptions o = start_of(w, 10);
  o.max_speed_mps = 2.0;
  HandsetLocator slow(o);
  EXPECT_EQ(slow.move(step_of({0.0, 0.0, 0.0}), 0.0).use, HandsetUse::kUsed);
  EXPECT_EQ(slow.move(step_of({0.3, 0.0, 0.0}), 0.1).use, HandsetUse::kTooFast);
  EXPECT_EQ(slow.move(step_of({0.1, 0.0, 0.0}), 0.2).use, HandsetUse::kUsed);
}

// Frames that take 70 ms to come are as good as those that take none.
TEST(HandsetLocator, LateFramesAreTakenWhereTheyBelong) {
  for (const HandsetFilter kind : {HandsetFilter::kControl, HandsetFilter::kMeasurement}) {
    double rms[2] = {0.0, 0.0};
    for (const std::uint64_t seed : {1u, 2u}) {
      const HandsetWorld w = walk(seed, 25.0);
      for (const bool late : {false, true}) {
        HandsetOptions o = start_of(w, 100);
        o.filter = kind;
        HandsetLocator f(o);
        const std::vector<double> sigma(6, 1.0);
        double square = 0.0;
        std::size_t k = 0;
        for (std::size_t e = 0; e < w.epoch_s.size(); ++e) {
          for (; k + 1 < w.frame_s.size() && w.frame_s[k + 1] + (late ? 0.07 : 0.0) <= w.epoch_s[e] + 1e-9; ++k) {
            EXPECT_EQ(f.move(step_of(w.increment[k]), w.frame_s[k + 1]).use, HandsetUse::kUsed);
          }
          (void)f.update_ranges({w.range_m.data() + 6 * e, 6}, sigma, w.epoch_s[e]);
          if (e >= 150) square += (f.estimate().position_m - w.position_m[e]).squaredNorm();
        }
        rms[late ? 1 : 0] += std::sqrt(square / static_cast<double>(w.epoch_s.size() - 150));
      }
    }
    RecordProperty("late over in time", std::to_string(rms[1] / rms[0]));
    EXPECT_LT(rms[1], 1.5 * rms[0]) << rms[0] << " " << rms[1];
  }
}

// Of a movement that was gone through already nothing is added twice.
TEST(HandsetLocatorLaw, LateFramesMoveOnce) {
  for (const bool lost : {false, true}) {
    HandsetOptions o;
    o.nodes_m = {{300.0, 0.0, 0.0}};
    o.filter = HandsetFilter::kMeasurement;
    o.particles = 1;
    o.start_sigma_m = o.start_heading_sigma_rad = 1e-3;
    HandsetLocator f(o);
    const std::vector<double> nothing(1, kNan), sigma(1, 1.0);
    for (int k = 0; k <= 20; ++k) ASSERT_EQ(f.move(step_of({0.05, 0.0, 0.0}), 0.05 * k).use, HandsetUse::kUsed);
    const double begin = f.estimate().position_m[0];
    (void)f.update_ranges(nothing, sigma, 1.3);
    for (int k = 21; k <= 40; ++k) {
      if (lost && k == 22) {
        ASSERT_EQ(f.coast(0.05 * k).use, HandsetUse::kCoasted);
        continue;
      }
      ASSERT_EQ(f.move(step_of({0.05, 0.0, 0.0}), 0.05 * k).use, HandsetUse::kUsed);
    }
    EXPECT_NEAR(f.estimate().position_m[0] - begin, 1.0, 0.01);
  }
}

std::string refusal(const HandsetOptions& o) {
  try {
    const HandsetLocator f(o);
  } catch (const std::invalid_argument& error) {
    return error.what();
  }
  return "";
}

TEST(HandsetLocator, OptionsAreRefusedByName) {
  const auto with = [](auto change) {
    HandsetOptions o;
    o.nodes_m = {{10.0, 0.0, 0.0}};
    change(o);
    return refusal(o);
  };
  EXPECT_EQ(with([](HandsetOptions&) {}), "");
  EXPECT_EQ(with([](HandsetOptions& o) { o.particles = 0; }), "particles: 0; 1 ... 1 000 000 expected");
  EXPECT_NE(with([](HandsetOptions& o) { o.nodes_m.clear(); }).find("nodes_m: 0"), std::string::npos);
  EXPECT_NE(with([](HandsetOptions& o) { o.nodes_m[0][0] = kNan; }).find("nodes_m"), std::string::npos);
  EXPECT_NE(with([](HandsetOptions& o) { o.node_sigma_m = {1.0, 1.0}; }).find("node_sigma_m"), std::string::npos);
  EXPECT_NE(with([](HandsetOptions& o) { o.kernel = 0.0; }).find("kernel: 0"), std::string::npos);
  EXPECT_NE(with([](HandsetOptions& o) { o.excess_max_m = 4.0; }).find("excess_max_m"), std::string::npos);
  EXPECT_EQ(with([](HandsetOptions& o) { o.multipath_sigma_m = -1.0; }), "multipath_sigma_m: -1; at least 0 expected");
  EXPECT_NE(with([](HandsetOptions& o) { o.multipath_length_m = 0.0; }).find("multipath_length_m: 0"),
            std::string::npos);
  EXPECT_NE(with([](HandsetOptions& o) { o.outlier_probability = 0.5; }).find("outlier_probability"),
            std::string::npos);
  EXPECT_NE(with([](HandsetOptions& o) { o.room_m = {{0.0, 0.0}}; }).find("room_m"), std::string::npos);
  EXPECT_NE(with([](HandsetOptions& o) { o.ess_threshold = kNan; }).find("ess_threshold"), std::string::npos);
  EXPECT_NE(with([](HandsetOptions& o) { o.max_speed_mps = 0.0; }).find("max_speed_mps: 0"), std::string::npos);
  EXPECT_EQ(to_string(HandsetUse::kClocksDisagree), "clocks disagree");
  EXPECT_EQ(to_string(HandsetUse::kTooFast), "too fast");
  EXPECT_EQ(to_string(HandsetStatus::kCameraOnly), "camera only");
  EXPECT_EQ(to_string(HandsetFilter::kControl), "control");
  EXPECT_EQ(to_string(HandsetClock::kSeparate), "separate");
}

}  // namespace
}  // namespace soopnav::navigation
