#include "soopnav/core/observation.hpp"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <limits>
#include <vector>

#include "support/nan.hpp"

namespace soopnav {
namespace {

using ::soopnav::test::kNan;
const Epoch kEpoch(TimeScale::kGps, 1000, 0.5);

Observation three() {
  Observation observation(kEpoch);
  EXPECT_TRUE(observation.append(10.0, 1.0, SourceId{7}));
  EXPECT_TRUE(observation.append(20.0, 2.0, SourceId{8}));
  EXPECT_TRUE(observation.append(40.0, 3.0, SourceId{9}));
  return observation;
}

TEST(Observation, AppendsIndependentValues) {
  const Observation observation = three();
  ASSERT_EQ(observation.size(), 3);
  EXPECT_EQ(observation.values()[2], 40.0);
  EXPECT_EQ(observation.sources()[1], SourceId{8});
  EXPECT_EQ(observation.sigma(2), 3.0);
  EXPECT_EQ(observation.epoch(), kEpoch);
  EXPECT_FALSE(observation.reference());
  EXPECT_EQ(Eigen::MatrixXd(observation.covariance()), Eigen::MatrixXd(Eigen::Vector3d(1.0, 4.0, 9.0).asDiagonal()));
}

TEST(Observation, AppendRefusesWhatIsNoMeasurement) {
  Observation observation = three();
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  EXPECT_FALSE(observation.append(kNan, 1.0, SourceId{1}));
  EXPECT_FALSE(observation.append(kInfinity, 1.0, SourceId{1}));
  EXPECT_FALSE(observation.append(1.0, 0.0, SourceId{1}));
  EXPECT_FALSE(observation.append(1.0, -1.0, SourceId{1}));
  EXPECT_FALSE(observation.append(1.0, kNan, SourceId{1}));
  EXPECT_FALSE(observation.append(1.0, 1e200, SourceId{1}));   // its square is infinite
  EXPECT_FALSE(observation.append(1.0, 1e-200, SourceId{1}));  // its square is zero
  EXPECT_EQ(observation.size(), 3);
  for (int i = 3; i < Observation::kCapacity; ++i) EXPECT_TRUE(observation.append(1.0, 1.0, SourceId{1}));
  EXPECT_FALSE(observation.append(1.0, 1.0, SourceId{1}));
  EXPECT_EQ(observation.size(), Observation::kCapacity);
  EXPECT_EQ(observation.covariance().rows(), Observation::kCapacity);
}

TEST(Observation, DifferencesShareTheirReference) {
  const auto differences = three().minus_reference(SourceId{8});
  ASSERT_TRUE(differences);
  ASSERT_EQ(differences->size(), 2);
  EXPECT_EQ(differences->values()[0], -10.0);
  EXPECT_EQ(differences->values()[1], 20.0);
  EXPECT_EQ(differences->sources()[0], SourceId{7});
  EXPECT_EQ(differences->sources()[1], SourceId{9});
  EXPECT_EQ(differences->reference(), SourceId{8});
  EXPECT_EQ(differences->epoch(), kEpoch);
  Eigen::Matrix2d expected;
  expected << 1.0 + 4.0, 4.0, 4.0, 9.0 + 4.0;
  EXPECT_EQ(Eigen::MatrixXd(differences->covariance()), Eigen::MatrixXd(expected));
}

TEST(Observation, DifferencesOfCorrelatedValuesFollowDRD) {
  Eigen::Matrix3d R;
  R << 2.0, 0.5, 0.2, 0.5, 3.0, -0.4, 0.2, -0.4, 1.5;
  const std::vector<SourceId> sources{SourceId{1}, SourceId{2}, SourceId{3}};
  Observation observation(kEpoch);
  ASSERT_EQ(observation.assign(Eigen::Vector3d(1.0, 2.0, 4.0), R, sources), UpdateStatus::kAccepted);
  const auto differences = observation.minus_reference(SourceId{3});
  ASSERT_TRUE(differences);
  Eigen::Matrix<double, 2, 3> D;
  D << 1.0, 0.0, -1.0, 0.0, 1.0, -1.0;
  const Eigen::Matrix2d expected = D * R * D.transpose();
  EXPECT_LT((Eigen::Matrix2d(differences->covariance()) - expected).norm(), 1e-15);
}

TEST(Observation, DifferencesNeedAReferenceAndAnother) {
  EXPECT_FALSE(three().minus_reference(SourceId{1}));
  Observation alone(kEpoch);
  ASSERT_TRUE(alone.append(1.0, 1.0, SourceId{4}));
  EXPECT_FALSE(alone.minus_reference(SourceId{4}));
  EXPECT_FALSE(Observation(kEpoch).minus_reference(SourceId{4}));
  auto differences = three().minus_reference(SourceId{7});
  ASSERT_TRUE(differences);
  EXPECT_FALSE(differences->minus_reference(SourceId{8}));   // differences already
  EXPECT_FALSE(differences->append(1.0, 1.0, SourceId{3}));  // not independent of the others
}

TEST(Observation, AssignChecksBeforeItChanges) {
  Observation observation = three();
  const std::vector<SourceId> two{SourceId{1}, SourceId{2}};
  const Eigen::Vector2d z(1.0, 2.0);
  Eigen::Matrix2d R;
  R << 1.0, 0.5, 0.5, 1.0;
  const auto refused = [&](const Eigen::VectorXd& values, const Eigen::MatrixXd& covariance) {
    const UpdateStatus status = observation.assign(values, covariance, two);
    EXPECT_EQ(observation.values()[2], 40.0);
    EXPECT_EQ(observation.size(), 3);
    return status;
  };
  EXPECT_EQ(refused(Eigen::Vector3d::Zero(), R), UpdateStatus::kUndefined);
  EXPECT_EQ(refused(z, Eigen::Matrix3d::Identity()), UpdateStatus::kUndefined);
  EXPECT_EQ(refused(Eigen::VectorXd(0), Eigen::MatrixXd(0, 0)), UpdateStatus::kUndefined);
  EXPECT_EQ(refused(Eigen::Vector2d(kNan, 0.0), R), UpdateStatus::kNonFinite);
  EXPECT_EQ(refused(z, (Eigen::Matrix2d() << 1.0, kNan, kNan, 1.0).finished()), UpdateStatus::kNonFinite);
  EXPECT_EQ(refused(z, (Eigen::Matrix2d() << 1.0, 2.0, 2.0, 1.0).finished()), UpdateStatus::kNotPositiveDefinite);
  EXPECT_EQ(refused(z, (Eigen::Matrix2d() << 1.0, 0.5, 0.4, 1.0).finished()), UpdateStatus::kNotPositiveDefinite);
  EXPECT_EQ(refused(z, Eigen::Matrix2d::Zero()), UpdateStatus::kNotPositiveDefinite);

  EXPECT_EQ(observation.assign(z, R, two, SourceId{9}), UpdateStatus::kAccepted);
  EXPECT_EQ(observation.size(), 2);
  EXPECT_EQ(observation.reference(), SourceId{9});
  EXPECT_EQ(observation.covariance()(0, 1), 0.5);
}

TEST(Observation, AssignHoldsAtMostItsCapacity) {
  const int n = Observation::kCapacity + 1;
  Observation observation(kEpoch);
  const std::vector<SourceId> sources(static_cast<std::size_t>(n));
  EXPECT_EQ(observation.assign(Eigen::VectorXd::Ones(n), Eigen::MatrixXd::Identity(n, n), sources),
            UpdateStatus::kUndefined);
}

}  // namespace
}  // namespace soopnav
