#include "soopnav/array/synthetic_aperture.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <complex>
#include <limits>
#include <vector>

#include "soopnav/array/aperture_spectrum.hpp"
#include "soopnav/core/angle.hpp"
#include "soopnav/core/random.hpp"
#include "support/allocation_count.hpp"

namespace soopnav::array {
namespace {

using Cf64 = std::complex<double>;
constexpr double kLambda = 0.15;

struct Walk {
  std::vector<double> path, time, wavelength, bearing, offset_hz;
  std::vector<Cf64> y;
  [[nodiscard]] ApertureData data() const { return {y, path, time, wavelength, {}}; }
};

// A loop of `lengths` wavelengths; share 1 closes it. The model written out again.
Walk walk(std::size_t n, const std::vector<double>& bearing, double snr, std::uint64_t seed, double share = 1.0,
          bool free_phase = true, bool straight = false) {
  Walk w;
  const RandomStream random(seed);
  RandomStream noise = random.substream(0), draw = random.substream(1);
  w.bearing = bearing;
  w.wavelength.assign(bearing.size(), kLambda);
  std::vector<double> phi;
  for (std::size_t i = 0; i < bearing.size(); ++i) {
    w.offset_hz.push_back(free_phase ? draw.uniform(-3.0, 3.0) : 0.0);
    phi.push_back(draw.uniform(0.0, kTwoPi));
  }
  const double radius = 5.0 * kLambda / kTwoPi;
  for (std::size_t k = 0; k < n; ++k) {
    const double s = static_cast<double>(k) / static_cast<double>(n), at = kTwoPi * share * s;
    w.path.push_back(straight ? 5.0 * kLambda * s * std::cos(0.4) : radius * std::cos(at));
    w.path.push_back(straight ? 5.0 * kLambda * s * std::sin(0.4) : radius * std::sin(at));
    w.time.push_back(0.04 * static_cast<double>(k));
    const double psi = free_phase ? draw.uniform(0.0, kTwoPi) : 0.0;
    for (std::size_t i = 0; i < bearing.size(); ++i) {
      const double phase =
          psi + phi[i] + kTwoPi * w.offset_hz[i] * w.time[k] +
          kTwoPi / kLambda * (std::cos(bearing[i]) * w.path[2 * k] + std::sin(bearing[i]) * w.path[2 * k + 1]);
      const double re = noise.normal(0.0, std::sqrt(0.5));
      w.y.push_back(std::polar(std::sqrt(snr), phase) + Cf64(re, noise.normal(0.0, std::sqrt(0.5))));
    }
  }
  return w;
}

TEST(SyntheticAperture, FindsBearingsAndOffsetsUnderAFreeReceiverPhase) {
  SyntheticAperture aperture;
  for (std::uint64_t seed = 1; seed <= 6; ++seed) {
    RandomStream draw(seed + 100);
    std::vector<double> bearing;
    for (int i = 0; i < 3 + static_cast<int>(seed % 3); ++i) bearing.push_back(2.0 * i + draw.uniform(-0.4, 0.4));
    const Walk w = walk(50, bearing, 1e6, seed);
    const ApertureBearings found = aperture.estimate(w.data());
    ASSERT_EQ(found.status, ApertureStatus::kOk) << seed << " " << to_string(found.status);
    for (std::size_t i = 0; i < bearing.size(); ++i) {
      EXPECT_NEAR(wrap_to_pi(found.bearing_rad[i] - bearing[i]), 0.0, 6e-4);
      EXPECT_NEAR(found.frequency_hz[i], w.offset_hz[i] - w.offset_hz[0], 1e-3);
      EXPECT_NEAR(found.amplitude[i], 1e3, 1.0);
      EXPECT_GT(found.coherence[i], 0.9999);
      EXPECT_EQ(found.los[i], 1);
    }
    EXPECT_NEAR(found.noise_variance, 1.0, 0.7);
  }
}

// Turning path and nodes together turns the bearings; a path that moves as a whole changes nothing.
TEST(SyntheticAperture, BearingsTurnWithTheFrame) {
  const std::vector<double> bearing{0.3, 2.2, -1.4, -2.8};
  const Walk w = walk(50, bearing, 10.0, 3);
  SyntheticAperture aperture({.path_sigma_m_per_sqrt_step = 5e-4});
  const ApertureBearings first = aperture.estimate(w.data());
  ASSERT_EQ(first.status, ApertureStatus::kOk);
  const std::vector<double> before(first.bearing_rad.begin(), first.bearing_rad.end());
  const double sigma = std::sqrt(first.covariance_rad2[5]), turn = 1.1;
  Walk turned = w;
  for (std::size_t k = 0; k < 50; ++k) {
    const double x = w.path[2 * k], y = w.path[2 * k + 1];
    turned.path[2 * k] = std::cos(turn) * x - std::sin(turn) * y + 3.0;
    turned.path[2 * k + 1] = std::sin(turn) * x + std::cos(turn) * y - 7.0;
  }
  const ApertureBearings second = aperture.estimate(turned.data());
  ASSERT_EQ(second.status, ApertureStatus::kOk);
  for (std::size_t i = 0; i < bearing.size(); ++i) {
    EXPECT_NEAR(wrap_to_pi(second.bearing_rad[i] - before[i] - turn), 0.0, 1e-5);
  }
  EXPECT_NEAR(std::sqrt(second.covariance_rad2[5]), sigma, 1e-4 * sigma);
}

TEST(SyntheticAperture, AStraightPathNeverAnswersAlone) {
  const Walk w = walk(50, {1.3, -0.9}, 10.0, 4, 1.0, false, true);
  SyntheticAperture quiet({.phase = ReceiverPhase::kKnown, .frequency_offsets = false});
  const ApertureBearings found = quiet.estimate(w.data());
  ASSERT_EQ(found.status, ApertureStatus::kTwoAnswers) << to_string(found.status);
  EXPECT_TRUE(found.straight);
  for (std::size_t i = 0; i < 2; ++i) {
    const double mirror = 0.8 - w.bearing[i];
    const double direct = std::abs(wrap_to_pi(found.bearing_rad[i] - w.bearing[i]));
    const double swapped = std::abs(wrap_to_pi(found.bearing_rad[i] - mirror));
    EXPECT_LT(std::min(direct, swapped), 0.05);
    EXPECT_NEAR(wrap_to_pi(found.alternative_rad[i] + found.bearing_rad[i] - 0.8), 0.0, 1e-5);
  }
  const Walk free = walk(50, {1.3, -0.9, 2.9}, 10.0, 4, 1.0, true, true);
  const ApertureBearings refused = SyntheticAperture().estimate(free.data());
  EXPECT_EQ(refused.status, ApertureStatus::kSingular);
  EXPECT_TRUE(refused.straight);
  EXPECT_TRUE(refused.bearing_rad.empty());
}

TEST(SyntheticAperture, SaysWhatItCannotDo) {
  const std::vector<double> bearing{0.3, 2.2, -1.4};
  SyntheticAperture aperture;
  const Walk good = walk(40, bearing, 100.0, 5);
  ASSERT_EQ(aperture.estimate(good.data()).status, ApertureStatus::kOk);
  EXPECT_EQ(aperture.estimate(walk(7, bearing, 100.0, 5).data()).status, ApertureStatus::kTooFewSnapshots);
  EXPECT_EQ(aperture.estimate(walk(40, {0.3, 2.2}, 100.0, 5).data()).status, ApertureStatus::kTooFewNodes);
  Walk bad = good;
  bad.y[17] = {std::numeric_limits<double>::quiet_NaN(), 0.0};
  ApertureBearings r = aperture.estimate(bad.data());
  EXPECT_EQ(r.status, ApertureStatus::kNonFinite);
  EXPECT_EQ(r.index, 2);
  bad = good;
  bad.path[9] = std::numeric_limits<double>::infinity();
  EXPECT_EQ(aperture.estimate(bad.data()).status, ApertureStatus::kNonFinite);
  bad = good;
  bad.time[5] = bad.time[4];
  EXPECT_EQ(aperture.estimate(bad.data()).status, ApertureStatus::kNonFinite);
  bad = good;
  for (std::size_t k = 0; k < 40; ++k) bad.y[3 * k + 1] = 0.0;
  EXPECT_EQ(aperture.estimate(bad.data()).status, ApertureStatus::kNoPower);
  bad = good;
  for (double& v : bad.path) v *= 0.1;
  EXPECT_EQ(aperture.estimate(bad.data()).status, ApertureStatus::kPathTooShort);
  bad = good;
  bad.path[40] += 0.5;
  EXPECT_EQ(aperture.estimate(bad.data()).status, ApertureStatus::kStepTooLong);
  // An L of even speed: the nodes' offsets take one direction of every bearing's differences.
  bad = good;
  for (std::size_t k = 0; k < 40; ++k) {
    bad.path[2 * k] = 0.0375 * static_cast<double>(std::min<std::size_t>(k, 20));
    bad.path[2 * k + 1] = 0.0375 * static_cast<double>(k > 20 ? k - 20 : 0);
  }
  for (std::size_t k = 0; k < 40; ++k) {
    for (std::size_t i = 0; i < 3; ++i) {
      bad.y[3 * k + i] =
          std::polar(10.0, 0.7 * static_cast<double>(k * k) + kTwoPi / kLambda *
                                                                  (std::cos(bearing[i]) * bad.path[2 * k] +
                                                                   std::sin(bearing[i]) * bad.path[2 * k + 1])) +
          0.001 * bad.y[3 * k + i];
    }
  }
  r = aperture.estimate(bad.data());
  EXPECT_EQ(r.status, ApertureStatus::kSingular) << to_string(r.status);
  SyntheticAperture no_offsets({.frequency_offsets = false});
  r = no_offsets.estimate(bad.data());
  ASSERT_EQ(r.status, ApertureStatus::kOk) << to_string(r.status);
  for (std::size_t i = 0; i < 3; ++i) EXPECT_NEAR(wrap_to_pi(r.bearing_rad[i] - bearing[i]), 0.0, 1e-2);
}

TEST(SyntheticAperture, LeavesOutALinkThatFades) {
  Walk w = walk(60, {0.3, 2.2, -1.4, -2.6}, 10.0, 8);
  RandomStream noise(77);
  for (const std::size_t lost : {std::size_t{0}, std::size_t{2}}) {
    Walk faded = w;
    for (std::size_t k = 0; k < 60; ++k) {
      const double re = noise.normal(0.0, 2.3);
      faded.y[4 * k + lost] = {re, noise.normal(0.0, 2.3)};
    }
    SyntheticAperture aperture;
    const ApertureBearings found = aperture.estimate(faded.data());
    ASSERT_EQ(found.status, ApertureStatus::kOk) << to_string(found.status);
    for (std::size_t i = 0; i < 4; ++i) {
      EXPECT_EQ(found.los[i], i == lost ? 0 : 1);
      if (i == lost) {
        EXPECT_TRUE(std::isnan(found.bearing_rad[i]));
      } else {
        EXPECT_NEAR(wrap_to_pi(found.bearing_rad[i] - w.bearing[i]), 0.0, 0.1);
      }
    }
  }
}

TEST(SyntheticAperture, BlindFindsAnglesUpToAMirror) {
  const std::vector<double> bearing{0.4, 1.5, 2.9, -2.2, -0.8, 0.9};
  const Walk w = walk(120, bearing, 1000.0, 9);
  SyntheticAperture aperture({.frequency_offsets = true});
  ApertureData data = w.data();
  data.path_m = {};
  const BlindAperture found = aperture.estimate_blind(data);
  ASSERT_EQ(found.status, ApertureStatus::kOk) << to_string(found.status);
  const double sign = std::sin(found.bearing_rad[1]) * std::sin(bearing[1] - bearing[0]) > 0.0 ? 1.0 : -1.0;
  for (std::size_t i = 0; i < bearing.size(); ++i) {
    const double sigma = std::sqrt(found.covariance_rad2[7 * i]);
    EXPECT_LT(sigma, 0.2);
    EXPECT_LE(std::abs(wrap_to_pi(sign * found.bearing_rad[i] - bearing[i] + bearing[0])), 5.0 * sigma);
  }
  const Walk four = walk(120, {0.4, 1.5, 2.9, -2.2}, 1000.0, 9);
  EXPECT_EQ(aperture.estimate_blind(four.data()).status, ApertureStatus::kTooFewNodes);
}

// Three free numbers per snapshot fit much of anything: only coherence tells signals from noise.
TEST(SyntheticAperture, BlindRefusesNoise) {
  Walk w = walk(50, {0.4, 1.5, 2.9, -2.2, -0.8, 0.9}, 1.0, 9);
  SyntheticAperture aperture;
  for (const std::uint64_t seed : {1U, 3U}) {
    RandomStream noise(seed + 500);
    for (Cf64& y : w.y) {
      const double re = noise.normal(0.0, 1.0);
      y = {re, noise.normal(0.0, 1.0)};
    }
    const BlindAperture found = aperture.estimate_blind(w.data());
    EXPECT_EQ(found.status, ApertureStatus::kTooFewCoherent) << to_string(found.status);
    EXPECT_GE(found.index, 0);
    EXPECT_TRUE(found.bearing_rad.empty());
  }
}

TEST(SyntheticAperture, BlindNamesALinkThatFades) {
  const std::size_t nodes = 6, lost = 2;
  int named = 0;
  for (const std::uint64_t seed : {1U, 3U, 4U}) {
    Walk w = walk(150, {0.4, 1.5, 2.9, -2.2, -0.8, 0.9}, 100.0, seed);
    const Walk clean = walk(150, w.bearing, 1e12, seed);
    RandomStream draw(seed + 500);
    std::vector<double> direction, phase;
    for (int q = 0; q < 24; ++q) {
      direction.push_back(draw.uniform(0.0, kTwoPi));
      phase.push_back(draw.uniform(0.0, kTwoPi));
    }
    for (std::size_t k = 0; k < 150; ++k) {  // the direct wave of one link gives way to plane waves from all around
      const double x = w.path[2 * k], y = w.path[2 * k + 1];
      Cf64 sum = 0.0;
      for (std::size_t q = 0; q < 24; ++q) {
        sum += std::polar(std::sqrt(100.0 / 24.0),
                          phase[q] + kTwoPi / kLambda * (std::cos(direction[q]) * x + std::sin(direction[q]) * y));
      }
      const double direct = std::arg(clean.y[k * nodes + lost]);
      const double way = kTwoPi / kLambda * (std::cos(w.bearing[lost]) * x + std::sin(w.bearing[lost]) * y);
      w.y[k * nodes + lost] += sum * std::polar(1.0, direct - way) - std::polar(10.0, direct);
    }
    const BlindAperture found = SyntheticAperture().estimate_blind(w.data());
    EXPECT_NE(found.status, ApertureStatus::kOk) << seed;
    if (found.status == ApertureStatus::kTooFewCoherent && found.index == static_cast<int>(lost)) ++named;
  }
  EXPECT_EQ(named, 3);
}

TEST(SyntheticAperture, RefusesBadSetUp) {
  EXPECT_THROW(SyntheticAperture({.noise_variance = -1.0}), std::invalid_argument);
  EXPECT_THROW(SyntheticAperture({.coherence_threshold = 1.0}), std::invalid_argument);
  EXPECT_THROW(SyntheticAperture({.max_sigma_rad = 0.0}), std::invalid_argument);
  EXPECT_THROW(SyntheticAperture({.phase = ReceiverPhase::kRandomWalk}), std::invalid_argument);
  const Walk w = walk(20, {0.1, 1.0, 2.0}, 10.0, 1);
  ApertureData data = w.data();
  data.phasors = data.phasors.first(30);
  SyntheticAperture aperture;
  EXPECT_THROW(static_cast<void>(aperture.estimate(data)), std::invalid_argument);
  data = w.data();
  data.path_m = data.path_m.first(30);
  EXPECT_THROW(static_cast<void>(aperture.estimate(data)), std::invalid_argument);
}

TEST(SyntheticAperture, LaterCallsDoNotTouchTheHeap) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted here";
  const Walk w = walk(50, {0.3, 2.2, -1.4, -2.8}, 10.0, 3);
  for (const ReceiverPhase phase : {ReceiverPhase::kFree, ReceiverPhase::kKnown}) {
    SyntheticAperture aperture({.phase = phase, .path_sigma_m_per_sqrt_step = 5e-4});
    static_cast<void>(aperture.estimate(w.data()));
    EXPECT_EQ(test::allocations_of([&] { static_cast<void>(aperture.estimate(w.data())); }), 0);
  }
}

TEST(ApertureSpectrum, MusicPartsCoherentPathsThatBeamformingMerges) {
  std::vector<double> path;
  std::vector<Cf64> y;
  RandomStream noise(5);
  const double first = 1.2, second = 1.55;
  for (int k = 0; k < 40; ++k) {
    const double x = 0.4 * kLambda * k;
    path.push_back(x);
    path.push_back(0.0);
    const double wave = kTwoPi / kLambda * x;
    const double re = noise.normal(0.0, 0.02);
    y.push_back(std::polar(1.0, wave * std::cos(first)) + std::polar(0.8, wave * std::cos(second) + 0.5) +
                Cf64(re, noise.normal(0.0, 0.02)));
  }
  const ApertureLooks looks{y, path, kLambda, 20};
  const std::vector<double> found = aperture_directions(looks, ApertureMethod::kMusic, 2);
  ASSERT_EQ(found.size(), 2U);
  for (const double v : found) EXPECT_LT(std::min(std::abs(std::abs(v) - first), std::abs(std::abs(v) - second)), 0.01);
  const std::vector<double> at{first, -first, 1.35, 0.2};
  const auto music = aperture_spectrum(looks, at, ApertureMethod::kMusic, 2);
  EXPECT_GT(music[0], 0.99);
  EXPECT_NEAR(music[0], music[1], 1e-9);
  EXPECT_LT(music[3], 0.2);
  EXPECT_THROW(static_cast<void>(aperture_spectrum({y, path, kLambda, 0}, at, ApertureMethod::kMusic, 2)),
               std::invalid_argument);
  std::vector<double> bent = path;
  bent[41] += 0.05;
  EXPECT_THROW(static_cast<void>(aperture_spectrum({y, bent, kLambda, 20}, at, ApertureMethod::kMusic, 2)),
               std::invalid_argument);
}

TEST(BearingCheck, FindsTheReflection) {
  const std::vector<double> nodes{20.0, 0.0, 0.0, 25.0, -30.0, 5.0, 10.0, -18.0};
  const Eigen::Vector2d position(1.0, 2.0);
  const Eigen::Matrix2d fix = 0.09 * Eigen::Matrix2d::Identity();
  const Eigen::MatrixXd R = std::pow(0.015, 2) * Eigen::MatrixXd::Identity(4, 4);
  const double heading = 0.7;
  std::vector<double> bearing;
  for (std::size_t i = 0; i < 4; ++i) {
    bearing.push_back(wrap_to_pi(std::atan2(nodes[2 * i + 1] - 2.0, nodes[2 * i] - 1.0) - heading));
  }
  const double unknown = std::numeric_limits<double>::infinity();
  BearingCheck check = check_bearings(bearing, R, nodes, position, fix, 0.0, unknown);
  EXPECT_NEAR(check.heading_rad, heading, 1e-9);
  EXPECT_NEAR(check.total, 0.0, 1e-12);
  EXPECT_EQ(check.degrees_of_freedom, 3);
  bearing[2] += 0.5;
  check = check_bearings(bearing, R, nodes, position, fix, 0.0, unknown);
  EXPECT_EQ(check.consistent, (std::vector<std::uint8_t>{1, 1, 0, 1}));
  EXPECT_NEAR(check.heading_rad, heading, 1e-9);
  EXPECT_NEAR(check.residual_rad[2], 0.5, 1e-9);
  check = check_bearings(bearing, R, nodes, position, fix, heading, 0.01);
  EXPECT_EQ(check.consistent, (std::vector<std::uint8_t>{1, 1, 0, 1}));
  EXPECT_THROW(static_cast<void>(check_bearings(bearing, -R, nodes, position, fix * 0.0, 0.0, 0.0)),
               std::invalid_argument);
}

}  // namespace
}  // namespace soopnav::array
