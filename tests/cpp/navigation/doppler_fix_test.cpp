#include "soopnav/navigation/doppler_fix.hpp"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "soopnav/core/constants.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/estimation/chi_square.hpp"
#include "soopnav/geometry/local_frame.hpp"
#include "soopnav/geometry/orbit.hpp"
#include "support/allocation_count.hpp"

namespace soopnav::navigation {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kFailure = 1e-4;
constexpr double kSigmaHz = 5.0;

// Ten minutes of Iridium over a place at 47 degrees: Dopplers by the exact path of each signal.
struct Sky {
  Eigen::Vector3d p_e = geometry::geodetic_to_ecef(0.82, 0.15, 400.0);
  std::vector<DopplerRow> exact;
  int satellites = 0;

  explicit Sky(double every_s = 10.0) {
    const geometry::LocalFrame frame({0.82, 0.15, 400.0});
    int name = 0;
    for (const geometry::J2Orbit& orbit : geometry::WalkerConstellation::iridium().orbits()) {
      const geometry::SampledOrbit samples = orbit.sampled(-10.0, 630.0);
      ++name;
      const std::size_t before = exact.size();
      for (double t = 0.0; t < 600.0; t += every_s) {
        geometry::Direction seen;
        geometry::SignalPath path;
        geometry::OrbitState state;
        if (!geometry::look_at(samples, t, frame, seen) || seen.elevation_rad < 0.17) continue;
        if (!geometry::signal_path(samples, t, p_e, Eigen::Vector3d::Zero(), path) || !samples.at(t, state)) continue;
        DopplerRow row;
        row.t_s = t;
        row.satellite = name;
        row.doppler_hz = -DopplerFixOptions{}.carrier_hz * path.delay_rate;
        row.sigma_hz = kSigmaHz;
        row.source_p_e = state.p_e;
        row.source_v_e = state.v_e;
        exact.push_back(row);
      }
      if (exact.size() > before) ++satellites;
    }
  }
};

double horizontal_m(const DopplerFix& fix, const Eigen::Vector3d& truth) {
  const geometry::LocalFrame frame(fix.place);
  return frame.position_from_ecef(truth).head<2>().norm();
}

TEST(DopplerFix, PredictsWhatTheExactPathGives) {
  const Sky sky;
  ASSERT_GE(sky.satellites, 3);
  ASSERT_GE(sky.exact.size(), 60U);
  DopplerFixOptions options;
  for (const DopplerRow& row : sky.exact) {
    double doppler = 0.0, by_along = 0.0;
    Eigen::Vector3d by_position;
    ASSERT_TRUE(predict_doppler(row, options, sky.p_e, 0.0, doppler, by_position, by_along));
    EXPECT_NEAR(doppler, row.doppler_hz, 2e-3);  // light time by two-body motion; J2 and the samples' joints remain
  }
}

TEST(DopplerFix, DerivativesAreTheDifferences) {
  const Sky sky;
  DopplerFixOptions options;
  options.velocity_e = {30.0, -200.0, 10.0};
  for (const SourceInstant instant : {SourceInstant::kReception, SourceInstant::kSending}) {
    options.source_instant = instant;
    for (std::size_t i = 0; i < sky.exact.size(); i += 17) {
      const DopplerRow& row = sky.exact[i];
      double at = 0.0, up = 0.0, down = 0.0, by_along = 0.0, unused = 0.0;
      Eigen::Vector3d by_position, other;
      ASSERT_TRUE(predict_doppler(row, options, sky.p_e, 300.0, at, by_position, by_along));
      const double h = 50.0;
      for (int k = 0; k < 3; ++k) {
        const Eigen::Vector3d d = h * Eigen::Vector3d::Unit(k);
        ASSERT_TRUE(predict_doppler(row, options, sky.p_e + d, 300.0, up, other, unused));
        ASSERT_TRUE(predict_doppler(row, options, sky.p_e - d, 300.0, down, other, unused));
        EXPECT_NEAR(by_position[k], (up - down) / (2 * h), 2e-4 * by_position.norm());
      }
      ASSERT_TRUE(predict_doppler(row, options, sky.p_e, 300.0 + h, up, other, unused));
      ASSERT_TRUE(predict_doppler(row, options, sky.p_e, 300.0 - h, down, other, unused));
      EXPECT_NEAR(by_along, (up - down) / (2 * h), 2e-4 * by_position.norm());
    }
  }
}

TEST(DopplerFix, ExactDopplersGiveThePlaceFromAnywhere) {
  const Sky sky;
  std::vector<DopplerRow> rows = sky.exact;
  for (DopplerRow& row : rows) row.doppler_hz += 431.0 + 0.02 * row.t_s;
  DopplerFixOptions options;
  options.height_m = 400.0;
  options.frequency_drift_sigma_hz_per_s = DopplerFixOptions::kFree;
  const DopplerFix fix = doppler_fix(rows, options);
  ASSERT_EQ(fix.status, DopplerStatus::kConverged) << to_string(fix.status);
  EXPECT_LT(horizontal_m(fix, sky.p_e), 0.1);
  EXPECT_NEAR(fix.frequency_bias_hz, 431.0 + 0.02 * fix.reference_s, 2e-3);
  EXPECT_NEAR(fix.frequency_drift_hz_per_s, 0.02, 1e-5);
  EXPECT_EQ(fix.covariance_enu(2, 2), 0.0);
  EXPECT_LT(fix.bias_chi_square, 1e-3);

  options.height_m.reset();
  const DopplerFix free = doppler_fix(rows, options);
  ASSERT_EQ(free.status, DopplerStatus::kConverged);
  EXPECT_LT((free.position_e - sky.p_e).norm(), 1.0);
  EXPECT_GT(free.covariance_enu(2, 2), 1.0);

  // Starts on the other side of the Earth, at its centre's height of a mountain, beside the truth: one answer.
  for (const Eigen::Vector3d& start :
       {Eigen::Vector3d(-sky.p_e), geometry::geodetic_to_ecef(-0.5, 2.0, 8000.0), sky.p_e}) {
    options.start_p_e = start;
    const DopplerFix again = doppler_fix(rows, options);
    ASSERT_EQ(again.status, DopplerStatus::kConverged);
    EXPECT_LT((again.position_e - free.position_e).norm(), 0.05);
  }
}

TEST(DopplerFix, MovingReceiverAndStatesOfSending) {
  const Sky sky;
  DopplerFixOptions options;
  options.source_instant = SourceInstant::kSending;
  options.velocity_e = {100.0, 150.0, -40.0};
  std::vector<DopplerRow> rows;
  Eigen::Vector3d unused;
  for (DopplerRow row : sky.exact) {
    double by_along = 0.0;
    ASSERT_TRUE(predict_doppler(row, options, sky.p_e, 0.0, row.doppler_hz, unused, by_along));
    rows.push_back(row);
  }
  options.height_m = 400.0;
  EXPECT_LT(horizontal_m(doppler_fix(rows, options), sky.p_e), 1e-2);
  options.velocity_e.setZero();  // and without the velocity the place is another: kilometres
  EXPECT_GT(horizontal_m(doppler_fix(rows, options), sky.p_e), 1000.0);
}

// Errors, covariance and the test for biases over many draws: NEES, and p-values where there are no biases.
TEST(DopplerFix, CovarianceIsRightWithAndWithoutBiases) {
  const Sky sky(15.0);
  const geometry::LocalFrame frame({0.82, 0.15, 400.0});
  constexpr int kRuns = 250;
  for (const double bias_hz : {0.0, 3.0}) {
    double nees = 0.0, chi_square = 0.0, scatter = 0.0, reported = 0.0, belongs = 0.0;
    int small_p = 0, dof = 0;
    for (int run = 0; run < kRuns; ++run) {
      RandomStream random(11, static_cast<std::uint64_t>(run) + (bias_hz > 0.0 ? 1000U : 0U));
      std::vector<double> biases(70);
      for (double& b : biases) b = bias_hz * random.normal();
      std::vector<DopplerRow> rows = sky.exact;
      const double clock_hz = 100.0 * random.normal(), height_error_m = 30.0 * random.normal();
      for (DopplerRow& row : rows) {
        row.doppler_hz += clock_hz + biases[static_cast<std::size_t>(row.satellite)] + kSigmaHz * random.normal();
      }
      DopplerFixOptions options;
      options.height_m = 400.0 + height_error_m;
      options.height_sigma_m = 30.0;
      options.satellite_bias_sigma_hz = bias_hz;
      options.search = false;
      options.start_p_e = frame.position_to_ecef({2e4 * random.normal(), 2e4 * random.normal(), 0.0});
      const DopplerFix fix = doppler_fix(rows, options);
      ASSERT_EQ(fix.status, DopplerStatus::kConverged);
      const Eigen::Vector3d error = frame.position_from_ecef(fix.position_e);
      nees += error.dot(fix.covariance_enu.llt().solve(error));
      scatter += error.head<2>().squaredNorm();
      reported += fix.sigma_2d_m * fix.sigma_2d_m;
      chi_square += fix.chi_square;
      dof = fix.degrees_of_freedom;
      belongs += fix.bias_chi_square;
      small_p += fix.bias_probability < 0.01 ? 1 : 0;
    }
    EXPECT_GT(nees, chi_square_quantile(0.5 * kFailure, 3.0 * kRuns)) << bias_hz;
    EXPECT_LT(nees, chi_square_upper_quantile(0.5 * kFailure, 3.0 * kRuns)) << bias_hz;
    EXPECT_GT(chi_square, chi_square_quantile(0.5 * kFailure, kRuns * dof)) << bias_hz;
    EXPECT_LT(chi_square, chi_square_upper_quantile(0.5 * kFailure, kRuns * dof)) << bias_hz;
    // The spread of the squared error is at most that of one degree of freedom.
    EXPECT_NEAR(scatter / reported, 1.0, 3.9 * std::sqrt(2.0 / kRuns)) << bias_hz;
    if (bias_hz == 0.0) {
      EXPECT_GT(belongs, chi_square_quantile(0.5 * kFailure, kRuns * (sky.satellites - 1.0)));
      EXPECT_LT(belongs, chi_square_upper_quantile(0.5 * kFailure, kRuns * (sky.satellites - 1.0)));
      EXPECT_LE(small_p, 11);  // of Poisson 2.5: beyond with 2e-5
    } else {
      EXPECT_GE(small_p, kRuns / 2);
    }
  }
}

TEST(DopplerFix, BiasesLeftOutMakeItOverconfident) {
  const Sky sky(15.0);
  const geometry::LocalFrame frame({0.82, 0.15, 400.0});
  double without = 0.0;
  constexpr int kRuns = 60;
  for (int run = 0; run < kRuns; ++run) {
    RandomStream random(12, static_cast<std::uint64_t>(run));
    std::vector<double> biases(70);
    for (double& b : biases) b = 4.0 * random.normal();
    std::vector<DopplerRow> rows = sky.exact;
    for (DopplerRow& row : rows)
      row.doppler_hz += biases[static_cast<std::size_t>(row.satellite)] + kSigmaHz * random.normal();
    DopplerFixOptions options;
    options.height_m = 400.0;
    options.search = false;
    options.start_p_e = sky.p_e;
    const DopplerFix fix = doppler_fix(rows, options);
    const Eigen::Vector2d error = frame.position_from_ecef(fix.position_e).head<2>();
    without += error.dot(fix.covariance_enu.topLeftCorner<2, 2>().llt().solve(error));
  }
  EXPECT_GT(without, chi_square_upper_quantile(kFailure, 2.0 * kRuns));
}

TEST(DopplerFix, OldElementsMoveTheSatelliteNotThePlace) {
  const Sky sky;
  std::vector<DopplerRow> rows;
  DopplerFixOptions options;
  Eigen::Vector3d unused;
  for (DopplerRow row : sky.exact) {  // each satellite up to 2 km ahead of its ephemeris, by name
    double by_along = 0.0;
    const double ahead_m = 2000.0 * std::sin(7.0 * row.satellite);
    ASSERT_TRUE(predict_doppler(row, options, sky.p_e, ahead_m, row.doppler_hz, unused, by_along));
    row.along_track_sigma_m = 1500.0;
    rows.push_back(row);
  }
  options.height_m = 400.0;
  const DopplerFix fix = doppler_fix(rows, options);
  ASSERT_EQ(fix.status, DopplerStatus::kConverged);
  for (DopplerRow& row : rows) row.along_track_sigma_m = 0.0;
  const DopplerFix believed = doppler_fix(rows, options);
  EXPECT_GT(horizontal_m(believed, sky.p_e), 10.0 * believed.sigma_2d_m / std::sqrt(2.0) * 0.3);
  EXPECT_GT(fix.sigma_2d_m, 2.0 * believed.sigma_2d_m);
  EXPECT_LT(horizontal_m(fix, sky.p_e), 4.0 * fix.sigma_2d_m);
  for (DopplerRow& row : rows) row.age_s = row.satellite % 2 == 0 ? 10.0 * 86400.0 : -3600.0;
  options.max_age_s = 86400.0;
  const DopplerFix fresh = doppler_fix(rows, options);
  for (std::size_t i = 0; i < rows.size(); ++i) {
    EXPECT_EQ(fresh.use[i], rows[i].satellite % 2 == 0 ? DopplerUse::kStale : DopplerUse::kUsed);
  }
}

TEST(DopplerFix, BadRowsAreLeftOutAndTooFewSaidSo) {
  const Sky sky;
  DopplerFixOptions options;
  options.height_m = 400.0;
  EXPECT_EQ(doppler_fix({}, options).status, DopplerStatus::kTooFewRows);
  EXPECT_EQ(doppler_fix(std::span(sky.exact).first(3), options).status, DopplerStatus::kTooFewRows);
  std::vector<DopplerRow> one;
  for (const DopplerRow& row : sky.exact) {
    if (row.satellite == sky.exact[0].satellite) one.push_back(row);
  }
  ASSERT_GE(one.size(), 4U);
  EXPECT_EQ(doppler_fix(one, options).status, DopplerStatus::kTooFewSatellites);
  EXPECT_FALSE(doppler_fix(one, options).position_e.allFinite());

  std::vector<DopplerRow> rows = sky.exact;
  rows[0].doppler_hz = kNan;
  rows[1].source_p_e.x() = kNan;
  rows[2].sigma_hz = 0.0;
  rows[3].sigma_hz = -1.0;
  rows[4].t_s = std::numeric_limits<double>::infinity();
  rows[5].source_p_e.setZero();
  const DopplerFix fix = doppler_fix(rows, options);
  ASSERT_EQ(fix.status, DopplerStatus::kConverged);
  EXPECT_EQ(fix.use[0], DopplerUse::kNotFinite);
  EXPECT_EQ(fix.use[1], DopplerUse::kNotFinite);
  EXPECT_EQ(fix.use[2], DopplerUse::kBadSigma);
  EXPECT_EQ(fix.use[3], DopplerUse::kBadSigma);
  EXPECT_EQ(fix.use[4], DopplerUse::kNotFinite);
  EXPECT_EQ(fix.use[5], DopplerUse::kNotFinite);
  EXPECT_TRUE(std::isnan(fix.residuals_hz[0]));
  EXPECT_LT(horizontal_m(fix, sky.p_e), 0.1);

  // One burst of each of two satellites, twice over: four rows that say two things about three unknowns.
  std::vector<DopplerRow> twice;
  for (const DopplerRow& row : sky.exact) {
    if (twice.empty() || row.satellite != twice[0].satellite) twice.insert(twice.end(), {row, row});
    if (twice.size() == 4) break;
  }
  EXPECT_EQ(doppler_fix(twice, options).status, DopplerStatus::kRankDeficient);
}

TEST(DopplerFix, OptionsAreChecked) {
  const auto refused = [](auto change) {
    DopplerFixOptions options;
    change(options);
    EXPECT_THROW(options.check(), std::invalid_argument);
  };
  EXPECT_NO_THROW(DopplerFixOptions{}.check());
  refused([](DopplerFixOptions& o) { o.carrier_hz = 0.0; });
  refused([](DopplerFixOptions& o) { o.velocity_e.x() = kNan; });
  refused([](DopplerFixOptions& o) { o.height_m = kNan; });
  refused([](DopplerFixOptions& o) { o.height_sigma_m = -1.0; });
  refused([](DopplerFixOptions& o) { o.frequency_bias_sigma_hz = 0.0; });
  refused([](DopplerFixOptions& o) { o.frequency_drift_sigma_hz_per_s = kNan; });
  refused([](DopplerFixOptions& o) { o.satellite_bias_sigma_hz = -1.0; });
  refused([](DopplerFixOptions& o) { o.max_age_s = kNan; });
  refused([](DopplerFixOptions& o) { o.mask_rad = 2.0; });
  refused([](DopplerFixOptions& o) { o.ambiguity_gate = -1.0; });
  refused([](DopplerFixOptions& o) { o.max_iterations = 0; });
  refused([](DopplerFixOptions& o) { o.start_p_e = Eigen::Vector3d::Zero(); });
  refused([](DopplerFixOptions& o) { o.search = false; });
}

TEST(DopplerFix, PredictionDoesNotAllocate) {
  if (!test::kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  const Sky sky(60.0);
  const DopplerFixOptions options;
  double doppler = 0.0, by_along = 0.0;
  Eigen::Vector3d by_position;
  bool good = false;
  EXPECT_EQ(test::allocations_of(
                [&] { good = predict_doppler(sky.exact[0], options, sky.p_e, 10.0, doppler, by_position, by_along); }),
            0);
  EXPECT_TRUE(good);
}

}  // namespace
}  // namespace soopnav::navigation
