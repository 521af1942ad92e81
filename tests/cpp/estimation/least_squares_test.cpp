#include "soopnav/estimation/least_squares.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <limits>
#include <random>
#include <stdexcept>
#include <vector>

#include "soopnav/estimation/unobservable.hpp"
#include "soopnav/measurement/pseudorange.hpp"
#include "soopnav/measurement/range.hpp"
#include "support/nan.hpp"

namespace soopnav {
namespace {

using State = PositionClock<EnuFrame>;
using Pr = Pseudorange<EnuFrame>;
using ::soopnav::test::kNan;
constexpr double kInf = std::numeric_limits<double>::infinity();

const std::vector<Eigen::Vector3d> kSources{
    {1000, 0, 30}, {-800, 900, 100}, {-500, -900, 40}, {300, 1500, 10}, {0, -2000, 400}};

State make(const Eigen::Vector3d& p, double b) {
  State s;
  s.x << p, b;
  return s;
}

std::vector<Observed<Pr>> observe(const State& truth, double variance = 9.0) {
  std::vector<Observed<Pr>> out;
  for (const auto& q : kSources) out.emplace_back(Pr{q}, (truth.x.head<3>() - q).norm() + truth.x[3], variance);
  return out;
}

// Two rows a, b of position, correlated: a model of more than one row.
struct TwoAxes {
  static constexpr int kDim = 2;
  template <class X, class Y>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    const auto p = x(kPosition);
    y.value(0) = p[0] + p[2];
    y.value(1) = p[1];
    if constexpr (Y::kJacobian) {
      auto j = y.jacobian(kPosition);
      j << 1.0, 0.0, 1.0, 0.0, 1.0, 0.0;
    }
    return true;
  }
};

TEST(Solve, FindsTheExactPoint) {
  const State truth = make({100, -50, 20}, 1234.0);
  const auto r = solve(State{}, {}, observe(truth));
  EXPECT_EQ(r.status, SolveStatus::kConverged);
  EXPECT_NEAR((r.state.x - truth.x).norm(), 0.0, 1e-8);
  EXPECT_EQ(r.rank, 4);
  EXPECT_EQ(r.degrees_of_freedom, 1);
  EXPECT_EQ(r.unobservable.cols(), 0);
  EXPECT_NEAR(r.chi_square, 0.0, 1e-16);
  EXPECT_LE(r.iterations, 10);
  EXPECT_EQ(r.residuals.size(), 5);
}

TEST(Solve, ReportsCovarianceAndDopOfTheGeometry) {
  const State truth = make({100, -50, 20}, 1234.0);
  const auto r = solve(truth, {}, observe(truth, 9.0));
  Eigen::Matrix<double, 5, 4> H;
  for (int i = 0; i < 5; ++i) {
    H.row(i) << (truth.x.head<3>() - kSources[static_cast<std::size_t>(i)]).normalized().transpose(), 1.0;
  }
  const Eigen::Matrix4d Q = (H.transpose() * H).fullPivLu().solve(Eigen::Matrix4d::Identity());
  EXPECT_LT((r.covariance - 9.0 * Q).norm(), 1e-9 * r.covariance.norm());
  EXPECT_NEAR(r.dop.gdop, std::sqrt(Q.trace()), 1e-9);
  EXPECT_NEAR(r.dop.pdop, std::sqrt(Q.topLeftCorner<3, 3>().trace()), 1e-9);
  EXPECT_NEAR(r.dop.hdop, std::sqrt(Q(0, 0) + Q(1, 1)), 1e-9);
  EXPECT_NEAR(r.dop.vdop, std::sqrt(Q(2, 2)), 1e-9);
  EXPECT_NEAR(r.dop.tdop, std::sqrt(Q(3, 3)), 1e-9);
}

TEST(Solve, DopHasNoVerticalInAPlaneOrInEcef) {
  using Plane = PlanarPositionClock<EnuFrame>;
  const auto truth = Plane::make({100, -50, 20}, 0.0);
  std::vector<Observed<Pr>> z;
  for (const auto& q : kSources) z.emplace_back(Pr{q}, (truth(kPosition) - q).norm(), 1.0);
  const auto r = solve(Plane::make({0, 0, 20}, 0.0), {}, z);
  EXPECT_EQ(r.status, SolveStatus::kConverged);
  EXPECT_TRUE(std::isnan(r.dop.vdop));
  EXPECT_EQ(r.dop.pdop, r.dop.hdop);
  EXPECT_NEAR(r.dop.gdop * r.dop.gdop, r.dop.hdop * r.dop.hdop + r.dop.tdop * r.dop.tdop, 1e-12);

  using Ecef = PositionClock<EcefFrame>;
  std::vector<Observed<Pseudorange<>>> e;
  for (const auto& q : kSources) e.emplace_back(Pseudorange{q}, (Eigen::Vector3d(100, -50, 20) - q).norm(), 1.0);
  const auto s = solve(Ecef{}, {}, e);
  EXPECT_EQ(s.status, SolveStatus::kConverged);
  EXPECT_TRUE(std::isnan(s.dop.hdop) && std::isnan(s.dop.vdop));
  EXPECT_GT(s.dop.pdop, 0.0);
}

TEST(Solve, MixesGroupsOfDifferentModels) {
  const State truth = make({100, -50, 20}, 77.0);
  Eigen::Matrix2d R;
  R << 4.0, 1.0, 1.0, 2.0;
  const Observed<TwoAxes> axes({}, Eigen::Vector2d(120.0, -50.0), R);
  const Observed<Range<EnuFrame>> range({Eigen::Vector3d(500, 0, 300)},
                                        (truth.x.head<3>() - Eigen::Vector3d(500, 0, 300)).norm(), 1.0);
  const Observed<Pr> pr({kSources[0]}, (truth.x.head<3>() - kSources[0]).norm() + 77.0, 1.0);
  const auto r = solve(State{}, {}, axes, range, pr);
  EXPECT_EQ(r.status, SolveStatus::kConverged);
  EXPECT_NEAR((r.state.x - truth.x).norm(), 0.0, 1e-7);
  EXPECT_EQ(r.residuals.size(), 4);
  EXPECT_EQ(r.degrees_of_freedom, 0);
  // Nothing controls anything: no residual can be tested.
  EXPECT_EQ(r.normalized_residuals.norm(), 0.0);
}

TEST(Solve, ConvergesFromOutsideTheSources) {
  const State truth = make({100, -50, 20}, 1234.0);
  for (const Eigen::Vector3d& far :
       {Eigen::Vector3d(3e3, 0, 0), Eigen::Vector3d(-2e3, 2.5e3, -1e3), Eigen::Vector3d(1e3, 1e3, -4e3)}) {
    const auto r = solve(make(far, 0.0), {}, observe(truth));
    EXPECT_EQ(r.status, SolveStatus::kConverged) << far.transpose();
    EXPECT_NEAR((r.state.x - truth.x).norm(), 0.0, 1e-6) << far.transpose();
  }
}

TEST(Solve, DoesNotClaimAPointInAValleyWithoutAFloor) {
  // From 50 km the sum of squares falls towards infinity: that is no solution, and the status says so.
  const State truth = make({100, -50, 20}, 1234.0);
  for (const Eigen::Vector3d& far : {Eigen::Vector3d(5e4, 0, 0), Eigen::Vector3d(-2e4, 3e4, 1e3)}) {
    const auto r = solve(make(far, -3e4), {.max_iterations = 200}, observe(truth));
    if (r.status == SolveStatus::kConverged) {
      EXPECT_NEAR((r.state.x - truth.x).norm(), 0.0, 1e-6) << far.transpose();
    } else {
      EXPECT_EQ(r.status, SolveStatus::kNotConverged) << far.transpose();
      EXPECT_GT(r.chi_square, 1.0) << far.transpose();
    }
  }
}

TEST(Solve, DampsWhereGaussNewtonDiverges) {
  // Two ranges and a start almost on the line of their sources: the full Gauss-Newton step leaves the continent.
  const Eigen::Vector3d p(0.0, 300.0, 0.0);
  std::vector<Observed<Range<EnuFrame>>> z;
  for (const Eigen::Vector3d& q :
       {Eigen::Vector3d(-400, 0, 0), Eigen::Vector3d(400, 0, 0), Eigen::Vector3d(0, 0, 600)}) {
    z.emplace_back(Range<EnuFrame>{q}, (p - q).norm(), 1.0);
  }
  using PointState = ComposedState<EnuFrame, Role<3, PositionTag>>;
  PointState start;
  start.x << 1.0, 1e-4, 3.0;
  const auto r = solve(start, {.max_iterations = 200}, z);
  EXPECT_EQ(r.status, SolveStatus::kConverged);
  EXPECT_NEAR(std::abs(r.state.x[1]), 300.0, 1e-6);
  EXPECT_LT(r.chi_square, 1e-12);
}

TEST(Solve, ResidualsAreMeasuredMinusPredicted) {
  const State truth = make({100, -50, 20}, 0.0);
  auto z = observe(truth, 1.0);
  z[2].z[0] += 6.0;
  const auto r = solve(truth, {}, z);
  EXPECT_EQ(r.status, SolveStatus::kConverged);
  EXPECT_GT(r.residuals[2], 0.0);
  for (int i = 0; i < 5; ++i) {
    const auto k = static_cast<std::size_t>(i);
    EXPECT_NEAR(r.residuals[i], z[k].z[0] - (r.state.x.head<3>() - kSources[k]).norm() - r.state.x[3], 1e-9);
  }
  EXPECT_NEAR(r.redundancy.sum(), 1.0, 1e-9);
  // One degree of freedom: every controlled row shows the same |w|, the root of chi-square.
  for (int i = 0; i < 5; ++i) EXPECT_NEAR(std::abs(r.normalized_residuals[i]), std::sqrt(r.chi_square), 1e-3);
}

TEST(Solve, TooFewMeasurementsNamesWhatIsFree) {
  const State truth = make({100, -50, 20}, 0.0);
  const auto all = observe(truth);
  const std::vector<Observed<Pr>> one(all.begin(), all.begin() + 1);
  const auto r = solve(truth, {}, one);
  EXPECT_EQ(r.status, SolveStatus::kTooFewMeasurements);
  EXPECT_EQ(r.rank, 1);
  EXPECT_EQ(r.unobservable.cols(), 3);
  EXPECT_TRUE(std::isnan(r.covariance(0, 0)));
  EXPECT_EQ(r.state.x, truth.x);
  const std::vector<Observed<Pr>> none;
  const auto e = solve(truth, {}, none);
  EXPECT_EQ(e.status, SolveStatus::kTooFewMeasurements);
  EXPECT_EQ(e.rank, 0);
  EXPECT_THAT(name_directions<State>(e.unobservable), testing::ElementsAre("east", "north", "up", "clock bias"));
}

TEST(Solve, RankDeficiencyIsNamed) {
  // All sources at the height of the receiver: nothing tells its height.
  const State truth = make({100, -50, 20}, 5.0);
  std::vector<Observed<Pr>> z;
  for (Eigen::Vector3d q : kSources) {
    q[2] = 20.0;
    z.emplace_back(Pr{q}, (truth.x.head<3>() - q).norm() + 5.0, 1.0);
  }
  const auto r = solve(make({0, 0, 20}, 0.0), {}, z);
  EXPECT_EQ(r.status, SolveStatus::kRankDeficient);
  EXPECT_EQ(r.rank, 3);
  EXPECT_THAT(name_directions<State>(r.unobservable), testing::ElementsAre("up"));
  EXPECT_NEAR((r.state.x - truth.x).norm(), 0.0, 1e-6);
  EXPECT_TRUE(std::isnan(r.covariance(2, 2)));
  EXPECT_TRUE(std::isnan(r.dop.vdop));

  // Ranges know no clock.
  std::vector<Observed<Range<EnuFrame>>> ranges;
  for (const auto& q : kSources) ranges.emplace_back(Range<EnuFrame>{q}, (truth.x.head<3>() - q).norm(), 1.0);
  const auto s = solve(State{}, {}, ranges);
  EXPECT_EQ(s.status, SolveStatus::kRankDeficient);
  EXPECT_THAT(name_directions<State>(s.unobservable), testing::ElementsAre("clock bias"));
}

TEST(Solve, RunsOutOfIterations) {
  const auto r = solve(make({9e3, 9e3, 9e3}, 0.0), {.max_iterations = 2}, observe(make({100, -50, 20}, 0.0)));
  EXPECT_EQ(r.status, SolveStatus::kNotConverged);
  EXPECT_EQ(r.iterations, 2);
}

TEST(Solve, DataThatCannotBeUsedGivesAStatus) {
  const State truth = make({100, -50, 20}, 0.0);
  for (const double bad : {kNan, kInf}) {
    auto z = observe(truth);
    z[1].z[0] = bad;
    EXPECT_EQ(solve(truth, {}, z).status, SolveStatus::kNonFinite);
    z = observe(truth);
    z[1].R(0, 0) = bad;
    EXPECT_EQ(solve(truth, {}, z).status, SolveStatus::kNonFinite);
    z = observe(truth);
    z[1].model.source_p.value[0] = bad;
    EXPECT_EQ(solve(truth, {}, z).status, SolveStatus::kNonFinite);
    EXPECT_EQ(solve(make({bad, 0, 0}, 0.0), {}, observe(truth)).status, SolveStatus::kNonFinite);
  }
  for (const double bad : {0.0, -1.0}) {
    auto z = observe(truth);
    z[3].R(0, 0) = bad;
    EXPECT_EQ(solve(truth, {}, z).status, SolveStatus::kNotPositiveDefinite);
  }
  Eigen::Matrix2d indefinite;
  indefinite << 1.0, 2.0, 2.0, 1.0;
  EXPECT_EQ(solve(truth, {}, Observed<TwoAxes>({}, Eigen::Vector2d::Zero(), indefinite)).status,
            SolveStatus::kNotPositiveDefinite);
  EXPECT_EQ(solve(make(kSources[0], 0.0), {}, observe(truth)).status, SolveStatus::kUndefined);
  EXPECT_EQ(solve<4>(truth, {}, observe(truth)).status, SolveStatus::kTooManyMeasurements);
  EXPECT_EQ(solve<5>(truth, {}, observe(truth)).status, SolveStatus::kConverged);
}

TEST(Solve, CorrelatedGroupsAreChecked) {
  const State truth = make({100, -50, 20}, 0.0);
  const std::vector<Pr> models{Pr{kSources[0]}, Pr{kSources[1]}};
  const Eigen::Vector2d z(1.0, 2.0);
  Eigen::Matrix2d R;
  R << 1.0, 2.0, 2.0, 1.0;
  EXPECT_EQ(solve(truth, {}, Correlated<Pr>{models, z, R}).status, SolveStatus::kNotPositiveDefinite);
  EXPECT_EQ(solve(truth, {}, Correlated<Pr>{models, z, Eigen::Matrix3d::Identity()}).status,
            SolveStatus::kNotPositiveDefinite);
  EXPECT_EQ(solve(truth, {}, Correlated<Pr>{models, Eigen::Vector2d(kNan, 1.0), Eigen::Matrix2d::Identity()}).status,
            SolveStatus::kNonFinite);
}

TEST(Solve, OptionsAreChecked) {
  const auto z = observe(State{});
  const auto message = [&](const LeastSquaresOptions& options) -> std::string {
    try {
      static_cast<void>(solve(State{}, options, z));
    } catch (const std::invalid_argument& e) {
      return e.what();
    }
    return "";
  };
  EXPECT_THAT(message({.max_iterations = 0}), testing::HasSubstr("max_iterations: 0"));
  EXPECT_THAT(message({.step_tolerance = 0.0}), testing::HasSubstr("step_tolerance"));
  EXPECT_THAT(message({.step_tolerance = kNan}), testing::HasSubstr("step_tolerance"));
  EXPECT_THAT(message({.rank_tolerance = 1.0}), testing::HasSubstr("rank_tolerance"));
  EXPECT_THAT(message({.distinct_sigmas = -1.0}), testing::HasSubstr("distinct_sigmas"));
}

TEST(Solve, EveryStatusHasAName) {
  for (int i = 0; i <= static_cast<int>(SolveStatus::kNotPositiveDefinite); ++i) {
    EXPECT_NE(to_string(static_cast<SolveStatus>(i)), "unknown") << i;
  }
  EXPECT_EQ(to_string(static_cast<SolveStatus>(99)), "unknown");
}

TEST(SolveFrom, ReportsBothSidesOfAMirror) {
  using Plane = PlanarPositionClock<EnuFrame>;
  const auto truth = Plane::make({100, 70, 0}, 3.0);
  std::vector<Observed<Pr>> z;
  for (const double x : {-900.0, 0.0, 500.0, 1500.0})
    z.emplace_back(Pr{{x, 0.0, 0.0}}, (truth(kPosition) - Eigen::Vector3d(x, 0, 0)).norm() + 3.0, 1.0);
  const std::vector<Plane> starts{Plane::make({0, 50, 0}, 0), Plane::make({0, -50, 0}, 0), Plane::make({10, 60, 0}, 0)};
  const auto r = solve_from(std::span<const Plane>(starts), {}, 6.6, z);
  EXPECT_EQ(r.best.status, SolveStatus::kAmbiguous);
  ASSERT_EQ(r.alternative_count, 1);
  EXPECT_NEAR(r.best.state(kPosition)[1] + r.alternatives[0].state(kPosition)[1], 0.0, 1e-6);
  EXPECT_NEAR(std::abs(r.best.state(kPosition)[1]), 70.0, 1e-6);
  // A source off the line settles it.
  z.emplace_back(Pr{{0.0, 800.0, 0.0}}, (truth(kPosition) - Eigen::Vector3d(0, 800, 0)).norm() + 3.0, 1.0);
  const auto s = solve_from(std::span<const Plane>(starts), {}, 6.6, z);
  EXPECT_EQ(s.best.status, SolveStatus::kConverged);
  EXPECT_NEAR(s.best.state(kPosition)[1], 70.0, 1e-6);
}

TEST(SolveFrom, WithoutStartsIsUndefined) {
  const auto r = solve_from(std::span<const State>(), {}, 6.6, observe(State{}));
  EXPECT_EQ(r.best.status, SolveStatus::kUndefined);
  EXPECT_EQ(r.alternative_count, 0);
}

TEST(Fisher, EqualsTheSumOverMeasurements) {
  const State truth = make({100, -50, 20}, 1234.0);
  const auto f = fisher_information(truth, observe(truth, 4.0));
  EXPECT_EQ(f.status, SolveStatus::kConverged);
  Eigen::Matrix4d sum = Eigen::Matrix4d::Zero();
  for (const auto& q : kSources) {
    Eigen::Vector4d h;
    h << (truth.x.head<3>() - q).normalized(), 1.0;
    sum += h * h.transpose() / 4.0;
  }
  EXPECT_LT((f.information - sum).norm(), 1e-12 * sum.norm());
  EXPECT_LT((f.information * f.bound - Eigen::Matrix4d::Identity()).norm(), 1e-9);
}

TEST(Fisher, OneNodeHasRankOneAndStatusesPassThrough) {
  const State truth = make({100, -50, 20}, 1234.0);
  auto z = observe(truth);
  const auto one = fisher_information(truth, z[0]);
  EXPECT_EQ(one.status, SolveStatus::kRankDeficient);
  EXPECT_EQ(one.rank, 1);
  EXPECT_EQ(one.unobservable.cols(), 3);
  const Eigen::MatrixXd basis = one.unobservable;
  EXPECT_LT((one.information * basis).norm(), 1e-12);
  EXPECT_LT((basis.transpose() * basis - Eigen::Matrix3d::Identity()).norm(), 1e-12);
  EXPECT_EQ(fisher_information(make(kSources[0], 0.0), z).status, SolveStatus::kUndefined);
  EXPECT_EQ(fisher_information(make({kNan, 0, 0}, 0.0), z[0]).status, SolveStatus::kUndefined);
  z[0].R(0, 0) = -1.0;
  EXPECT_EQ(fisher_information(truth, z).status, SolveStatus::kNotPositiveDefinite);
}

}  // namespace
}  // namespace soopnav
