#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <vector>

#include "soopnav/core/random.hpp"
#include "soopnav/estimation/least_squares.hpp"
#include "soopnav/measurement/pseudorange.hpp"

namespace soopnav {
namespace {

using State = PositionClock<EnuFrame>;
using Pr = Pseudorange<EnuFrame>;

struct Case {
  State truth;
  std::vector<Observed<Pr>> z;
};

// Seven sources around a receiver, noise of 3 m.
Case make_case(std::uint64_t seed) {
  RandomStream random(seed);
  Case c;
  c.truth.x << random.uniform(-300, 300), random.uniform(-300, 300), random.uniform(-300, 300),
      random.uniform(-1e3, 1e3);
  for (int i = 0; i < 7; ++i) {
    Eigen::Vector3d q(random.normal(), random.normal(), random.normal());
    q *= 2000.0 / q.norm();
    const double sigma = random.uniform(1.0, 5.0);
    c.z.emplace_back(Pr{q}, (c.truth.x.head<3>() - q).norm() + c.truth.x[3] + sigma * random.normal(), sigma * sigma);
  }
  return c;
}

Eigen::Vector3d vector(const Known<3>& known) { return {known[0], known[1], known[2]}; }

// Difference of two pseudoranges: no clock. Its noise is shared with the others' reference.
struct Difference {
  using Frame = EnuFrame;
  static constexpr int kDim = 1;
  Eigen::Vector3d source, reference;
  template <class X, class Y>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    const Eigen::Vector3d a = x(kPosition) - source;
    const Eigen::Vector3d b = x(kPosition) - reference;
    y.value(0) = a.norm() - b.norm();
    if constexpr (Y::kJacobian) y.jacobian(kPosition) = (a.normalized() - b.normalized()).transpose();
    return true;
  }
};

TEST(SolveLaw, DifferencesWithTheirFullCovarianceEqualPseudorangesWithAClock) {
  using Point = ComposedState<EnuFrame, Role<3, PositionTag>>;
  for (std::uint64_t seed = 0; seed < 20; ++seed) {
    const Case c = make_case(seed);
    const auto n = static_cast<Eigen::Index>(c.z.size()) - 1;
    std::vector<Difference> models;
    Eigen::VectorXd d(n);
    Eigen::MatrixXd R = Eigen::MatrixXd::Constant(n, n, c.z[0].R(0, 0));
    for (Eigen::Index i = 0; i < n; ++i) {
      const auto& o = c.z[static_cast<std::size_t>(i) + 1];
      models.push_back({vector(o.model.source_p), vector(c.z[0].model.source_p)});
      d[i] = o.z[0] - c.z[0].z[0];
      R(i, i) += o.R(0, 0);
    }
    const auto a = solve(c.truth, {}, c.z);
    Point start;
    start.x = c.truth.x.head<3>();
    const auto b = solve(start, {}, Correlated<Difference>{models, d, R});
    ASSERT_EQ(a.status, SolveStatus::kConverged);
    ASSERT_EQ(b.status, SolveStatus::kConverged);
    EXPECT_NEAR((a.state.x.head<3>() - b.state.x).norm(), 0.0, 1e-5) << seed;
    EXPECT_LT((a.covariance.topLeftCorner<3, 3>() - b.covariance).norm(), 1e-7 * b.covariance.norm()) << seed;
    EXPECT_NEAR(a.chi_square, b.chi_square, 1e-7 * (1.0 + a.chi_square)) << seed;
    // Taking a difference out asks the same question as taking its source out.
    for (Eigen::Index i = 0; i < n; ++i) {
      EXPECT_NEAR(a.normalized_residuals[i + 1], b.normalized_residuals[i], 1e-5) << seed << " " << i;
    }
  }
}

TEST(SolveLaw, OrderOfMeasurementsDoesNotMatter) {
  Case c = make_case(3);
  const auto a = solve(c.truth, {}, c.z);
  std::reverse(c.z.begin(), c.z.end());
  const auto b = solve(c.truth, {}, c.z);
  EXPECT_NEAR((a.state.x - b.state.x).norm(), 0.0, 1e-6);
  EXPECT_NEAR((a.residuals - b.residuals.reverse()).norm(), 0.0, 1e-6);
}

TEST(SolveLaw, SplittingAGroupChangesNothing) {
  const Case c = make_case(4);
  const std::vector<Observed<Pr>> head(c.z.begin(), c.z.begin() + 3);
  const std::vector<Observed<Pr>> tail(c.z.begin() + 3, c.z.end());
  const auto a = solve(c.truth, {}, c.z);
  const auto b = solve(c.truth, {}, head, tail);
  EXPECT_EQ(a.state.x, b.state.x);
  EXPECT_EQ(a.residuals, b.residuals);
  EXPECT_EQ(a.covariance, b.covariance);
}

TEST(SolveLaw, RotationAndTranslationCarryOver) {
  const Case c = make_case(5);
  const Eigen::Matrix3d turn = Eigen::AngleAxisd(1.1, Eigen::Vector3d(1, 2, -1).normalized()).toRotationMatrix();
  const Eigen::Vector3d shift(400.0, -7.0, 30.0);
  Case moved = c;
  for (auto& o : moved.z) o.model.source_p = turn * vector(o.model.source_p) + shift;
  State start = c.truth;
  start.x.head<3>() = turn * c.truth.x.head<3>() + shift;
  const auto a = solve(c.truth, {}, c.z);
  const auto b = solve(start, {}, moved.z);
  EXPECT_NEAR((turn * a.state.x.head<3>() + shift - b.state.x.head<3>()).norm(), 0.0, 1e-6);
  const Eigen::Matrix3d P = turn * a.covariance.topLeftCorner<3, 3>() * turn.transpose();
  EXPECT_LT((P - b.covariance.topLeftCorner<3, 3>()).norm(), 1e-6 * P.norm());
  EXPECT_NEAR(a.dop.pdop, b.dop.pdop, 1e-6);
}

TEST(SolveLaw, VarianceScalesCovarianceAndLeavesTheState) {
  const Case c = make_case(6);
  Case scaled = c;
  for (auto& o : scaled.z) o.R *= 100.0;
  const auto a = solve(c.truth, {}, c.z);
  const auto b = solve(c.truth, {}, scaled.z);
  EXPECT_NEAR((a.state.x - b.state.x).norm(), 0.0, 1e-4);
  EXPECT_LT((100.0 * a.covariance - b.covariance).norm(), 1e-6 * b.covariance.norm());
  EXPECT_NEAR(a.chi_square / 100.0, b.chi_square, 1e-6 * a.chi_square);
}

TEST(SolveLaw, SquaredWIsWhatLeavingOutSaves) {
  // Baarda's w² equals the fall of chi-square when the row is left out; nearly, since the model bends.
  const Case c = make_case(7);
  const auto all = solve(c.truth, {}, c.z);
  for (std::size_t i = 0; i < c.z.size(); ++i) {
    auto rest = c.z;
    rest.erase(rest.begin() + static_cast<std::ptrdiff_t>(i));
    const auto r = solve(c.truth, {}, rest);
    ASSERT_EQ(r.status, SolveStatus::kConverged);
    const double w = all.normalized_residuals[static_cast<Eigen::Index>(i)];
    EXPECT_NEAR(all.chi_square - r.chi_square, w * w, 0.02 * (0.1 + w * w)) << i;
  }
}

}  // namespace
}  // namespace soopnav
