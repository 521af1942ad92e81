#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>
#include <vector>

#include "soopnav/core/random.hpp"
#include "soopnav/estimation/error_ellipse.hpp"
#include "soopnav/estimation/extended_kalman_filter.hpp"
#include "soopnav/estimation/posterior_crlb.hpp"
#include "soopnav/estimation/statistics.hpp"
#include "soopnav/measurement/pseudorange.hpp"
#include "support/nan.hpp"

namespace soopnav {
namespace {

using Eigen::Matrix4d;
using Eigen::MatrixXd;
using ::soopnav::test::kNan;

// Position and clock wander; the pseudoranges of five sources measure them.
using State = PositionClock<EnuFrame>;
using Pr = Pseudorange<EnuFrame>;
struct Wander {
  static constexpr int kNoise = 4;
  double sigma_m = 1.0;
  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& x, double dt_s, const W& w, Y& y) const {
    const double gain = sigma_m * std::sqrt(dt_s);
    for (int i = 0; i < 3; ++i) y.next(kPosition)[i] = x(kPosition)[i] + gain * w[i];
    y.next(kClockBias)[0] = x(kClockBias)[0] + gain * w[3];
    if constexpr (Y::kJacobian) {
      y.noise(kPosition).template leftCols<3>() = gain * Eigen::Matrix3d::Identity();
      y.noise(kClockBias)(0, 3) = gain;
    }
    return true;
  }
};

TEST(PosteriorCrlbConsistency, IsReachedByTheFilterWhereLinearisationIsValid) {
  // Sources kilometres away, errors of metres: the filter's errors follow the bound taken at the truth. 240 runs of one
  // NEES each, four degrees of freedom, two-sided 1e-5; covariances 25 % too large or too small leave the bounds.
  const std::vector<Eigen::Vector3d> sources{
      {9000, 500, 4000}, {-7000, 6000, 5000}, {-4000, -8000, 6000}, {3000, -6000, 9000}, {800, 7000, 7000}};
  const Wander process{0.8};
  double sum = 0.0;
  constexpr int kRuns = 240;
  for (int run = 0; run < kRuns; ++run) {
    RandomStream random(2024, static_cast<std::uint64_t>(run));
    const Matrix4d P0 = 25.0 * Matrix4d::Identity();
    State truth;
    State start;
    for (int i = 0; i < 4; ++i) start.x[i] = random.normal(0.0, 5.0);
    ExtendedKalmanFilter<State> filter(start, P0);
    PosteriorCrlb<4> bound(P0);
    for (int k = 0; k < 15; ++k) {
      ASSERT_TRUE(bound.predict_at(truth, process, 1.0));
      static_cast<void>(filter.predict(process, 1.0));
      for (int i = 0; i < 4; ++i) truth.x[i] += random.normal(0.0, 0.8);
      for (const auto& q : sources) {
        const double z = (truth.x.head<3>() - q).norm() + truth.x[3] + random.normal(0.0, 2.0);
        const Observed<Pr> one(Pr{q}, z, 4.0);
        ASSERT_EQ(bound.update_at(truth, one), SolveStatus::kConverged);
        static_cast<void>(filter.update(one));
      }
    }
    sum += nees(truth.local(filter.state()), bound.bound().covariance).value_or(kNan);
  }
  const MeanBounds limits = mean_nees_bounds(4.0, kRuns, 1e-5);
  EXPECT_GT(sum / kRuns, limits.lower);
  EXPECT_LT(sum / kRuns, limits.upper);
  EXPECT_GT(limits.lower, 0.8 * 4.0) << "the bounds are as sharp as promised";
  EXPECT_LT(limits.upper, 1.25 * 4.0);
}

TEST(StatisticsConsistency, OfGaussianErrorsAreWhatTheCovarianceSays) {
  // 4000 draws. Shares within the binomial bounds at 1e-5 two-sided; a covariance wrong by 15 % leaves them.
  constexpr int kDraws = 4000;
  RandomStream random(5);
  Eigen::Matrix2d P;
  P << 9.0, 3.0, 3.0, 4.0;
  const Eigen::Matrix2d L = P.llt().matrixL();
  MatrixXd errors(kDraws, 2);
  MatrixXd covariances(2 * kDraws, 2);
  for (int i = 0; i < kDraws; ++i) {
    const double a = random.normal();
    const double b = random.normal();
    errors.row(i) = (L * Eigen::Vector2d(a, b)).transpose();
    covariances.middleRows(2 * i, 2) = P;
  }
  for (const double p : {0.1, 0.5, 0.9}) {
    const auto limits = coverage_bounds(p, kDraws, 1e-5);
    const double share = coverage(errors, covariances, p);
    EXPECT_GE(share, limits.lower);
    EXPECT_LE(share, limits.upper);
    const double radius = circular_error_m(P, p).value_or(0.0);
    const double inside =
        static_cast<double>((errors.rowwise().norm().array() <= radius).count()) / static_cast<double>(kDraws);
    EXPECT_GE(inside, limits.lower);
    EXPECT_LE(inside, limits.upper);
  }
  const auto middle = coverage_bounds(0.5, kDraws, 1e-5);
  EXPECT_LT(coverage(errors, covariances / 1.15, 0.5), middle.lower + 0.02);
  const MeanBounds limits = mean_nees_bounds(2.0, kDraws, 1e-5);
  const double mean = nees_series(errors, covariances).mean();
  EXPECT_GT(mean, limits.lower);
  EXPECT_LT(mean, limits.upper);
  EXPECT_GT(1.15 * limits.lower, limits.upper);
}

}  // namespace
}  // namespace soopnav
