#include "soopnav/estimation/linear_filter.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <functional>
#include <stdexcept>
#include <string>
#include <vector>

#include "estimation/linear_systems.hpp"
#include "support/nan.hpp"

namespace soopnav {
namespace {

using test::DenseSystem;
using test::matrix_at;
using test::vector_at;

using ::soopnav::test::kNan;

DenseSystem scalar(double F, double Q, double H, double R, double x0, double P0) {
  const auto one = [](double v) { return RowMajorMatrix(RowMajorMatrix::Constant(1, 1, v)); };
  DenseSystem s;
  s.F = one(F);
  s.Q = one(Q);
  s.H = one(H);
  s.R = one(R);
  s.P0 = one(P0);
  s.x0 = Eigen::VectorXd::Constant(1, x0);
  return s;
}

LinearRun run(const DenseSystem& s, const LinearData& data) { return linear_filter(s.view(), data, s.x0, s.P0); }

TEST(LinearFilter, OneStepByHand) {
  const std::vector<double> z{5.0};
  const auto s = scalar(2.0, 1.0, 1.0, 3.0, 1.0, 2.0);
  const LinearRun r = run(s, {.z = z});
  // P- = 4 * 2 + 1 = 9, S = 12, K = 3/4.
  EXPECT_DOUBLE_EQ(r.x_pred[0], 2.0);
  EXPECT_DOUBLE_EQ(r.P_pred[0], 9.0);
  EXPECT_DOUBLE_EQ(r.innovation[0], 3.0);
  EXPECT_DOUBLE_EQ(r.S[0], 12.0);
  EXPECT_DOUBLE_EQ(r.x[0], 4.25);
  EXPECT_DOUBLE_EQ(r.P[0], 2.25);
  EXPECT_DOUBLE_EQ(r.nis[0], 0.75);
  EXPECT_NEAR(r.log_likelihood, -0.5 * (0.75 + std::log(2.0 * kPi * 12.0)), 1e-15);
  EXPECT_EQ(r.step_log_likelihood[0], r.log_likelihood);
  EXPECT_EQ(r.status[0], StepStatus::kUpdated);
}

// The steady state of x <- F x + w, z = x + v solves P² + (R (1 - F²) - Q) P - Q R = 0 for the predicted variance.
TEST(LinearFilter, SettlesAtTheRiccatiSolution) {
  for (const double F : {0.5, 1.0, 1.2}) {
    const double Q = 0.7;
    const double R = 2.5;
    const auto s = scalar(F, Q, 1.0, R, 0.0, 100.0);
    const std::vector<double> z(200, 0.0);
    const LinearRun r = run(s, {.z = z});
    const double b = R * (1.0 - F * F) - Q;
    const double predicted = 0.5 * (-b + std::sqrt(b * b + 4.0 * Q * R));
    EXPECT_NEAR(r.P_pred.back(), predicted, 1e-13 * predicted) << F;
    EXPECT_NEAR(r.P.back(), predicted * R / (predicted + R), 1e-13 * predicted) << F;
  }
}

// Sizes on both sides of whole vectors, more and fewer measurements than states.
TEST(LinearFilter, EqualsTheBookForAnySize) {
  constexpr int kSteps = 12;
  for (const auto& [n, m] : {std::pair{1, 1},
                             {1, 3},
                             {2, 1},
                             {3, 2},
                             {4, 5},
                             {5, 4},
                             {8, 1},
                             {13, 6},
                             {16, 16},
                             {17, 3},
                             {33, 20},
                             {70, 9}}) {
    SCOPED_TRACE(testing::Message() << n << " states, " << m << " measured");
    const auto s = test::dense_system(n, m, 100 + static_cast<std::uint64_t>(n));
    const auto data = test::simulate(s, kSteps, 7);
    const LinearRun r = run(s, {.z = data.values()});
    test::BookFilter<long double> book(s);
    for (int k = 0; k < kSteps; ++k) {
      book.step(data.z.row(k).transpose());
      const double P_size = static_cast<double>(book.P_pred.norm());
      const double x_size = 1.0 + static_cast<double>(book.x_pred.norm());
      EXPECT_LT((vector_at(r.x_pred, k, n) - book.x_pred.cast<double>()).norm(), 1e-12 * x_size);
      EXPECT_LT((vector_at(r.x, k, n) - book.x.cast<double>()).norm(), 1e-12 * x_size);
      EXPECT_LT((matrix_at(r.P_pred, k, n, n) - book.P_pred.cast<double>()).norm(), 1e-12 * P_size);
      EXPECT_LT((matrix_at(r.P, k, n, n) - book.P.cast<double>()).norm(), 1e-12 * P_size);
      EXPECT_LT((matrix_at(r.S, k, m, m) - book.S.cast<double>()).norm(), 1e-12 * static_cast<double>(book.S.norm()));
      EXPECT_LT((vector_at(r.innovation, k, m) - book.innovation.cast<double>()).norm(), 1e-11 * x_size * m);
      const auto step = static_cast<std::size_t>(k);
      EXPECT_NEAR(r.nis[step], static_cast<double>(book.nis), 1e-10 * static_cast<double>(book.nis));
      EXPECT_NEAR(r.step_log_likelihood[step], static_cast<double>(book.log_likelihood), 1e-9);
    }
  }
}

TEST(LinearFilter, CovariancesAreSymmetricToTheBit) {
  const auto s = test::dense_system(11, 3, 5);
  const auto data = test::simulate(s, 30, 8);
  const LinearRun r = run(s, {.z = data.values()});
  for (int k = 0; k < 30; ++k) {
    EXPECT_EQ(matrix_at(r.P_pred, k, 11, 11), matrix_at(r.P_pred, k, 11, 11).transpose());
    EXPECT_EQ(matrix_at(r.P, k, 11, 11), matrix_at(r.P, k, 11, 11).transpose());
  }
}

TEST(LinearFilter, MatricesForEachStep) {
  // The same matrix repeated gives the same bits as the matrix once.
  const auto s = test::constant_velocity();
  constexpr int kSteps = 9;
  const auto data = test::simulate(s, kSteps, 3);
  const auto repeat = [](const RowMajorMatrix& M) {
    std::vector<double> values;
    for (int k = 0; k < kSteps; ++k) values.insert(values.end(), M.data(), M.data() + M.size());
    return values;
  };
  const auto F = repeat(s.F);
  const auto Q = repeat(s.Q);
  const auto H = repeat(s.H);
  const auto R = repeat(s.R);
  const LinearSystem series{{F, 4, 4, kSteps}, {Q, 4, 4, kSteps}, {H, 2, 4, kSteps}, {R, 2, 2, kSteps}};
  const LinearRun once = run(s, {.z = data.values()});
  const LinearRun each = linear_filter(series, {.z = data.values()}, s.x0, s.P0);
  EXPECT_TRUE(std::ranges::equal(once.x, each.x));
  EXPECT_TRUE(std::ranges::equal(once.P, each.P));

  // And a series that does change is read step by step: three scalar steps by hand.
  const std::vector<double> f{1.0, 2.0, -1.0};
  const std::vector<double> q{0.0, 1.0, 2.0};
  const std::vector<double> h{1.0, 0.5, 3.0};
  const std::vector<double> r{1.0, 2.0, 4.0};
  const std::vector<double> z{1.0, -2.0, 0.5};
  const LinearSystem scalars{{f, 1, 1, 3}, {q, 1, 1, 3}, {h, 1, 1, 3}, {r, 1, 1, 3}};
  const LinearRun got = linear_filter(scalars, {.z = z}, Eigen::VectorXd::Ones(1), Eigen::MatrixXd::Ones(1, 1));
  double x = 1.0;
  double P = 1.0;
  for (std::size_t k = 0; k < 3; ++k) {
    x = f[k] * x;
    P = f[k] * P * f[k] + q[k];
    const double S = h[k] * P * h[k] + r[k];
    x += P * h[k] / S * (z[k] - h[k] * x);
    P -= P * h[k] / S * h[k] * P;
    EXPECT_NEAR(got.x[k], x, 1e-14);
    EXPECT_NEAR(got.P[k], P, 1e-14);
  }
}

TEST(LinearFilter, InputsMoveThePrediction) {
  auto s = test::constant_velocity();
  constexpr int kSteps = 5;
  const auto data = test::simulate(s, kSteps, 4);
  RowMajorMatrix B(4, 1);
  B << 0.125, 0.5, 0.0, 0.0;
  const std::vector<double> u{1.0, -2.0, 0.0, 4.0, 0.5};
  LinearSystem with = s.view();
  with.B = B;
  const LinearRun r = linear_filter(with, {.z = data.values(), .u = u}, s.x0, s.P0);
  const LinearRun without = run(s, {.z = data.values()});
  Eigen::VectorXd x = s.x0;
  for (int k = 0; k < kSteps; ++k) {
    EXPECT_LT((vector_at(r.x_pred, k, 4) - (s.F * x + B * u[static_cast<std::size_t>(k)])).norm(), 1e-13);
    x = vector_at(r.x, k, 4);
  }
  EXPECT_TRUE(std::ranges::equal(r.P, without.P));
}

TEST(LinearFilter, MissingComponentsAreLeftOut) {
  const auto s = test::constant_velocity();
  auto data = test::simulate(s, 4, 5);
  const std::vector<std::uint8_t> present{1, 1, 0, 1, 0, 0, 1, 0};
  for (std::size_t i = 0; i < present.size(); ++i) {
    if (present[i] == 0) data.z.data()[i] = kNan;
  }
  const LinearRun r = run(s, {.z = data.values(), .present = present});
  EXPECT_THAT(std::vector<StepStatus>(r.status.begin(), r.status.end()),
              testing::ElementsAre(StepStatus::kUpdated, StepStatus::kUpdated, StepStatus::kNoObservation,
                                   StepStatus::kUpdated));
  Eigen::VectorXd x = s.x0;
  Eigen::MatrixXd P = s.P0;
  double log_likelihood = 0.0;
  for (int k = 0; k < 4; ++k) {
    x = s.F * x;
    P = s.F * P * s.F.transpose() + s.Q;
    std::vector<int> rows;
    for (int i = 0; i < 2; ++i) {
      if (present[static_cast<std::size_t>(2 * k + i)] != 0) rows.push_back(i);
    }
    if (!rows.empty()) {
      const Eigen::MatrixXd H = s.H(rows, Eigen::all);
      const Eigen::MatrixXd R = s.R(rows, rows);
      const Eigen::VectorXd z = data.z.row(k).transpose()(rows);
      const Eigen::MatrixXd S = H * P * H.transpose() + R;
      const Eigen::MatrixXd K = S.llt().solve(H * P).transpose();
      const Eigen::VectorXd nu = z - H * x;
      const double nis = nu.dot(S.llt().solve(nu));
      EXPECT_NEAR(r.nis[static_cast<std::size_t>(k)], nis, 1e-12);
      log_likelihood -= 0.5 * (nis + std::log((kTwoPi * S).determinant()));
      x += K * nu;
      P -= K * H * P;
    } else {
      EXPECT_TRUE(std::isnan(r.nis[static_cast<std::size_t>(k)]));
    }
    EXPECT_LT((vector_at(r.x, k, 4) - x).norm(), 1e-12);
    EXPECT_LT((matrix_at(r.P, k, 4, 4) - P).norm(), 1e-12);
    for (int i = 0; i < 2; ++i) {
      const bool there = present[static_cast<std::size_t>(2 * k + i)] != 0;
      EXPECT_EQ(std::isnan(vector_at(r.innovation, k, 2)[i]), !there);
      EXPECT_EQ(std::isnan(matrix_at(r.S, k, 2, 2)(i, i)), !there);
    }
  }
  EXPECT_NEAR(r.log_likelihood, log_likelihood, 1e-12);
}

// A step whose prediction overflows is refused, and the state stays finite.
TEST(LinearFilter, OverflowIsRefused) {
  const auto s = scalar(1e60, 0.0, 1.0, 1.0, 1.0, 1.0);
  const std::vector<double> z(6, 0.0);
  std::vector<std::uint8_t> nothing(6, 0);
  const LinearRun r = run(s, {.z = z, .present = nothing});
  EXPECT_EQ(r.status[1], StepStatus::kNoObservation);
  EXPECT_EQ(r.status[2], StepStatus::kNonFinite);
  EXPECT_EQ(r.status[5], StepStatus::kNonFinite);
  EXPECT_EQ(r.x[5], r.x[1]);
  EXPECT_EQ(r.P[5], r.P[1]);
  EXPECT_TRUE(std::isnan(r.log_likelihood));
  EXPECT_TRUE(std::isnan(r.S[5]));
}

TEST(LinearFilter, UpdateThatOverflowsIsRefused) {
  const auto s = scalar(1.0, 0.0, 1.0, 1.0, 0.0, 1.0);
  const std::vector<double> z{1e200, 1.0};
  const LinearRun r = run(s, {.z = z});
  // nis overflows in the first step only when it is squared: the state takes the value, as a linear filter must.
  EXPECT_EQ(r.status[0], StepStatus::kUpdated);
  const auto steep = scalar(1.0, 0.0, 1e200, 1.0, 0.0, 1.0);
  const LinearRun refused = run(steep, {.z = z});
  EXPECT_EQ(refused.status[0], StepStatus::kNonFinite);
  EXPECT_EQ(refused.x[0], 0.0);
  EXPECT_EQ(refused.P[0], 1.0);
}

// A measurement far finer than what is known of it: what remains is the variance of the measurement. Subtraction leaves
// nothing, or less.
TEST(LinearFilter, ExtremeRatioKeepsTheVarianceOfTheMeasurement) {
  const std::vector<double> z{1.0};
  for (const double P0 : {1e10, 1e14, 1e20, 1e100}) {
    const LinearRun r = run(scalar(1.0, 0.0, 1.0, 1e-6, 0.0, P0), {.z = z});
    EXPECT_NEAR(r.P[0], 1e-6, 1e-18) << P0;
  }
}

TEST(LinearFilter, LargeRatioStaysPositive) {
  auto s = test::constant_velocity();
  s.H << 1.0, 0.0, 0.7, 0.0, -0.4, 0.0, 1.3, 0.0;
  s.P0 *= 1e6;
  s.R *= 1e-6;
  s.Q *= 1e-6;
  const auto data = test::simulate(s, 20, 6);
  const LinearRun r = run(s, {.z = data.values()});
  for (int k = 0; k < 20; ++k) {
    const Eigen::Matrix4d P = matrix_at(r.P, k, 4, 4);
    EXPECT_EQ(Eigen::MatrixXd(P).llt().info(), Eigen::Success) << k;  // positive definite
  }
}

TEST(LinearFilter, NoSteps) {
  const auto s = test::constant_velocity();
  const LinearRun r = run(s, {});
  EXPECT_EQ(r.steps, 0);
  EXPECT_TRUE(r.x.empty());
  EXPECT_EQ(r.log_likelihood, 0.0);
}

TEST(LinearFilter, MovesWithItsSpans) {
  const auto s = test::constant_velocity();
  const auto data = test::simulate(s, 3, 5);
  LinearRun first = run(s, {.z = data.values()});
  const double last = first.x.back();
  const LinearRun second = std::move(first);
  EXPECT_EQ(second.x.back(), last);
  EXPECT_EQ(second.x.data(), second.x_pred.data() + second.x_pred.size() + second.P_pred.size());
}

TEST(LinearFilter, RefusalsNameTheParameter) {
  const auto good = test::constant_velocity();
  const auto data = test::simulate(good, 3, 5);
  const auto refusal = [&](const std::function<void(DenseSystem&, LinearData&)>& spoil) -> std::string {
    DenseSystem s = good;
    LinearData d{.z = data.values()};
    spoil(s, d);
    try {
      static_cast<void>(linear_filter(s.view(), d, s.x0, s.P0));
    } catch (const std::invalid_argument& e) {
      return e.what();
    }
    return "accepted";
  };
  using testing::StartsWith;
  EXPECT_EQ(refusal([](auto&, auto&) {}), "accepted");
  EXPECT_EQ(refusal([](auto& s, auto&) { s.F = RowMajorMatrix::Zero(4, 3); }), "F: shape (4, 3), expected (4, 4)");
  EXPECT_EQ(refusal([](auto& s, auto&) { s.F.resize(0, 0); }), "F: empty");
  EXPECT_EQ(refusal([](auto& s, auto&) { s.H.resize(0, 4); }), "H: empty");
  EXPECT_EQ(refusal([](auto& s, auto&) { s.F(1, 1) = kNan; }), "F: not finite");
  EXPECT_EQ(refusal([](auto& s, auto&) { s.H = RowMajorMatrix::Zero(2, 3); }), "H: shape (2, 3), expected (2, 4)");
  EXPECT_EQ(refusal([](auto& s, auto&) { s.Q = RowMajorMatrix::Zero(3, 3); }), "Q: shape (3, 3), expected (4, 4)");
  EXPECT_THAT(refusal([](auto& s, auto&) { s.Q(0, 0) = -1.0; }),
              StartsWith("Q: not positive semi-definite (smallest eigenvalue -"));
  EXPECT_THAT(refusal([](auto& s, auto&) { s.R(0, 1) += 0.1; }), StartsWith("R: not symmetric"));
  EXPECT_THAT(refusal([](auto& s, auto&) { s.R(1, 1) = -3.1e-4; }), StartsWith("R: not positive definite"));
  EXPECT_THAT(refusal([](auto& s, auto&) { s.R.setZero(); }), StartsWith("R: not positive definite"));
  EXPECT_EQ(refusal([](auto& s, auto&) { s.R(0, 0) = kNan; }), "R: not finite");
  EXPECT_THAT(refusal([](auto& s, auto&) { s.P0(2, 2) = -1.0; }), StartsWith("P0: not positive semi-definite"));
  EXPECT_EQ(refusal([](auto& s, auto&) { s.P0 = RowMajorMatrix::Identity(3, 3); }),
            "P0: shape (3, 3), expected (4, 4)");
  EXPECT_EQ(refusal([](auto& s, auto&) { s.x0 = Eigen::VectorXd::Zero(5); }), "x0: 5 numbers, expected 4");
  EXPECT_EQ(refusal([](auto& s, auto&) { s.x0[3] = kNan; }), "x0: not finite");
  EXPECT_EQ(refusal([](auto&, auto& d) { d.z = d.z.first(5); }), "z: 5 numbers, no whole steps of 2");
  const std::vector<double> gap{1.0, 2.0, kNan, 0.0};
  EXPECT_EQ(refusal([&](auto&, auto& d) { d.z = gap; }), "z: step 1 is not finite");
  const std::vector<std::uint8_t> flags(4, 1);
  EXPECT_EQ(refusal([&](auto&, auto& d) { d = {.z = gap, .present = flags}; }),
            "z: step 1 is marked as present and not finite");
  EXPECT_EQ(refusal([&](auto&, auto& d) { d.present = flags; }), "mask: 4 flags, expected 6");
  EXPECT_EQ(refusal([&](auto&, auto& d) { d.u = gap; }), "u: given without B");

  LinearSystem system = good.view();
  const std::vector<double> two(32, 0.5);
  system.F = {two, 4, 4, 2};
  const auto message = [&]() -> std::string {
    try {
      static_cast<void>(linear_filter(system, {.z = data.values()}, good.x0, good.P0));
    } catch (const std::invalid_argument& e) {
      return e.what();
    }
    return "accepted";
  };
  EXPECT_EQ(message(), "F: 2 matrices for 3 steps; one, or one for each step, is expected");
  system.F = good.F;
  std::vector<double> R;
  for (int k = 0; k < 3; ++k) R.insert(R.end(), {1.0, 0.0, 0.0, k == 2 ? -1.0 : 1.0});
  system.R = {R, 2, 2, 3};
  EXPECT_EQ(message(), "R[2]: not positive definite (smallest eigenvalue -1)");
  system.R = good.R;
  const RowMajorMatrix B = RowMajorMatrix::Zero(4, 1);
  system.B = B;
  EXPECT_EQ(message(), "B: given without u");
}

TEST(StepStatus, HasAPhrase) {
  EXPECT_EQ(to_string(StepStatus::kUpdated), "updated");
  EXPECT_EQ(to_string(StepStatus::kNoObservation), "no observation");
  EXPECT_EQ(to_string(StepStatus::kNonFinite), "not finite");
  EXPECT_EQ(to_string(StepStatus::kNotPositiveDefinite), "not positive definite");
  EXPECT_EQ(to_string(static_cast<StepStatus>(99)), "unknown");
}

}  // namespace
}  // namespace soopnav
