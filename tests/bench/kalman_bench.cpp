// Kalman filters beside the loops one would write by hand for the same state.
#include <benchmark/benchmark.h>

#include <Eigen/Cholesky>
#include <Eigen/Dense>
#include <array>
#include <cmath>
#include <vector>

#include "soopnav/core/joint_process.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/estimation/extended_kalman_filter.hpp"
#include "soopnav/estimation/layout_kalman_filter.hpp"
#include "soopnav/estimation/unscented_kalman_filter.hpp"
#include "soopnav/inertial/planar_mechanization.hpp"
#include "soopnav/measurement/azimuth.hpp"
#include "soopnav/measurement/pseudorange.hpp"
#include "soopnav/process/random_walk.hpp"

namespace soopnav {
namespace {

constexpr double kDt = 0.02;
using Planar = PlanarInertialState;
using Matrix5 = Eigen::Matrix<double, 5, 5>;
using Vector5 = Eigen::Matrix<double, 5, 1>;

// Three differences of ranges to the start, in one update.
struct ThreeRangeDifferences {
  using Frame = PlanarFrame;
  static constexpr int kDim = 3;
  std::array<Eigen::Vector2d, 3> source;
  template <class X, class Y>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    const auto p = x(kPlanarPosition);
    for (int i = 0; i < 3; ++i) {
      const Eigen::Vector2d& q = source[static_cast<std::size_t>(i)];
      const double dx = p[0] - q[0];
      const double dy = p[1] - q[1];
      const double range = std::sqrt(dx * dx + dy * dy);
      y.value(i) = q.norm() - range;
      if constexpr (Y::kJacobian) {
        auto H = y.jacobian(kPlanarPosition);
        H(i, 0) = -dx / range;
        H(i, 1) = -dy / range;
      }
    }
    return true;
  }
};

struct Run {
  std::vector<inertial::PlanarImuSample> imu;
  std::vector<Eigen::Vector3d> z;
  ThreeRangeDifferences model{{Eigen::Vector2d(3000, 1000), {-2000, 4000}, {500, -3500}}};
  Planar x0;
  Matrix5 P0 = Vector5(0.0025, 1, 1, 0.01, 0.01).asDiagonal();

  Run() {
    RandomStream random(1);
    for (int k = 0; k < 6000; ++k) {
      imu.push_back({0.02 * random.normal(), {0.1 * random.normal(), 0.1 * random.normal()}});
    }
    x0.x << 0.1, 9, 1, 0, 0;
    for (int k = 1; k <= 120; ++k) {
      Planar at = x0;
      at.x.tail<2>() = k * Eigen::Vector2d(9, 1);
      ValuePrediction<double, 3> y;
      static_cast<void>(model.predict(at, y));
      z.emplace_back(y.z[0] + 5 * random.normal(), y.z[1] + 5 * random.normal(), y.z[2] + 5 * random.normal());
    }
  }
};

template <class Filter>
void planar_ins(benchmark::State& state) {
  const Run run;
  const JointProcess process{inertial::PlanarMechanization{{0.05, 1.5}, inertial::PlanarIntegration::kEuler},
                             RandomWalk{kPlanarPosition, {5e-5, 5e-5}}};
  const Eigen::Matrix3d R = 25.0 * Eigen::Matrix3d::Identity();
  for (auto _ : state) {
    Filter filter(run.x0, run.P0);
    for (std::size_t k = 0; k < run.imu.size(); ++k) {
      static_cast<void>(filter.predict(process, run.imu[k], kDt));
      if ((k + 1) % 50 == 0) static_cast<void>(filter.update(run.model, run.z[k / 50], R));
    }
    benchmark::DoNotOptimize(filter.state().x.sum());
  }
  state.SetItemsProcessed(state.iterations() * 6000);
}
void BM_EkfPlanarIns(benchmark::State& state) { planar_ins<ExtendedKalmanFilter<Planar>>(state); }
void BM_UkfPlanarIns(benchmark::State& state) { planar_ins<UnscentedKalmanFilter<Planar>>(state); }

// The same filter, written out for this one system: Euler mechanisation, Joseph's form, nothing checked.
void BM_EkfPlanarInsByHand(benchmark::State& state) {
  const Run run;
  const Eigen::Matrix3d R = 25.0 * Eigen::Matrix3d::Identity();
  for (auto _ : state) {
    Vector5 x = run.x0.x;
    Matrix5 P = run.P0;
    for (std::size_t k = 0; k < run.imu.size(); ++k) {
      const double c = std::cos(x[0]);
      const double s = std::sin(x[0]);
      const auto& f = run.imu[k].specific_force_b_mps2;
      const double ax = c * f[0] - s * f[1];
      const double ay = s * f[0] + c * f[1];
      Matrix5 F = Matrix5::Identity();
      F(1, 0) = -kDt * ay;
      F(2, 0) = kDt * ax;
      F(3, 1) = F(4, 2) = kDt;
      Eigen::Matrix<double, 5, 5> G = Eigen::Matrix<double, 5, 5>::Zero();
      G(0, 0) = kDt * 0.05;
      G(1, 1) = kDt * 1.5 * c;
      G(1, 2) = -kDt * 1.5 * s;
      G(2, 1) = kDt * 1.5 * s;
      G(2, 2) = kDt * 1.5 * c;
      G(3, 3) = G(4, 4) = std::sqrt(5e-5 * kDt);
      x << x[0] + kDt * run.imu[k].yaw_rate_radps, x[1] + kDt * ax, x[2] + kDt * ay, x[3] + kDt * x[1],
          x[4] + kDt * x[2];
      P = (F * P * F.transpose() + G * G.transpose()).eval();
      if ((k + 1) % 50 == 0) {
        Eigen::Matrix<double, 3, 5> H = Eigen::Matrix<double, 3, 5>::Zero();
        Eigen::Vector3d r;
        for (int i = 0; i < 3; ++i) {
          const Eigen::Vector2d& q = run.model.source[static_cast<std::size_t>(i)];
          const Eigen::Vector2d d = x.tail<2>() - q;
          const double range = d.norm();
          H.row(i).tail<2>() = -d.transpose() / range;
          r[i] = run.z[k / 50][i] - (q.norm() - range);
        }
        const Eigen::Matrix<double, 5, 3> PH = P * H.transpose();
        const Eigen::Matrix3d S = H * PH + R;
        const Eigen::Matrix<double, 5, 3> K = S.llt().solve(PH.transpose()).transpose();
        x += K * r;
        const Matrix5 A = Matrix5::Identity() - K * H;
        P = (A * P * A.transpose() + K * R * K.transpose()).eval();
      }
    }
    benchmark::DoNotOptimize(x.sum());
    benchmark::DoNotOptimize(P.sum());
  }
  state.SetItemsProcessed(state.iterations() * 6000);
}

using Pvt = PositionVelocityClock<EcefFrame, 3>;
struct Sky {
  std::vector<Eigen::Vector3d> q;
  std::vector<double> z;
  Pvt x0;
  Sky() {
    RandomStream random(2);
    x0.x << 6378e3, 1e3, 2e3, 0, 0, 0, 100, 0;
    for (int i = 0; i < 8; ++i) {
      q.push_back(26e6 * Eigen::Vector3d(random.normal(), random.normal(), random.normal()).normalized());
      z.push_back((x0.x.head<3>() - q.back()).norm() + 97.0);
    }
  }
};
void BM_EkfPseudorange(benchmark::State& state) {
  const Sky sky;
  ExtendedKalmanFilter<Pvt> filter(sky.x0, 100.0 * Eigen::Matrix<double, 8, 8>::Identity());
  const auto P0 = filter.covariance();
  std::size_t k = 0;
  for (auto _ : state) {
    if (k % 64 == 0) filter.restore(sky.x0, P0);
    benchmark::DoNotOptimize(filter.update(Pseudorange{sky.q[k % 8], Known<1>{3.0}}, sky.z[k % 8], 1.0).nis);
    ++k;
  }
}
void BM_EkfPseudorangeByHand(benchmark::State& state) {
  const Sky sky;
  Eigen::Matrix<double, 8, 1> x = sky.x0.x;
  const Eigen::Matrix<double, 8, 8> P0 = 100.0 * Eigen::Matrix<double, 8, 8>::Identity();
  Eigen::Matrix<double, 8, 8> P = P0;
  std::size_t k = 0;
  for (auto _ : state) {
    if (k % 64 == 0) {
      x = sky.x0.x;
      P = P0;
    }
    const Eigen::Vector3d d = x.head<3>() - sky.q[k % 8];
    const double range = d.norm();
    Eigen::Matrix<double, 1, 8> H = Eigen::Matrix<double, 1, 8>::Zero();
    H.head<3>() = d.transpose() / range;
    H[6] = 1.0;
    const Eigen::Matrix<double, 8, 1> PH = P * H.transpose();
    const double S = (H * PH)(0) + 1.0;
    const double innovation = sky.z[k % 8] - (range + x[6] - 3.0);
    const Eigen::Matrix<double, 8, 1> K = PH / S;
    x += K * innovation;
    P.noalias() -= K * PH.transpose();
    const Eigen::Matrix<double, 8, 1> C = P * H.transpose() - K;
    P.noalias() -= C * K.transpose();
    benchmark::DoNotOptimize(innovation * innovation / S);
    ++k;
  }
}

// A receiver among 50 sources whose clocks are estimated: 108 components.
using Receiver =
    LayoutState<EcefFrame, Role<3, PositionTag>, Role<3, VelocityTag>, Role<1, ClockBiasTag>, Role<1, ClockDriftTag>>;
void BM_LayoutUpdate108(benchmark::State& state) {
  const Sky sky;
  Receiver::Fixed x0;
  x0.x = sky.x0.x;
  ExtendedKalmanFilter<Receiver> filter(x0, 100.0 * Eigen::Matrix<double, 8, 8>::Identity(), 108, 100);
  std::vector<Block<1>> clocks;
  for (int i = 0; i < 100; ++i) clocks.push_back(filter.join(0.0, 100.0, "clock"));
  std::size_t k = 0;
  for (auto _ : state) {
    const std::size_t i = k % 50;
    static_cast<void>(filter.predict(RandomWalk<Block<1>>{clocks[2 * i], {1.0}}, 1.0));
    benchmark::DoNotOptimize(
        filter.update(Pseudorange<EcefFrame, Block<1>>{sky.q[k % 8], clocks[2 * i]}, sky.z[k % 8], 1.0).nis);
    ++k;
  }
}
void BM_DenseUpdate108(benchmark::State& state) {
  constexpr int kN = 108;
  Eigen::MatrixXd P = 100.0 * Eigen::MatrixXd::Identity(kN, kN);
  Eigen::VectorXd x = Eigen::VectorXd::Zero(kN);
  for (auto _ : state) {
    P(9, 9) += 1.0;
    Eigen::MatrixXd H = Eigen::MatrixXd::Zero(1, kN);
    H(0, 0) = 0.6;
    H(0, 1) = 0.8;
    H(0, 6) = 1.0;
    H(0, 9) = -1.0;
    const Eigen::VectorXd PH = P * H.transpose();
    const double S = (H * PH)(0) + 1.0;
    const Eigen::VectorXd K = PH / S;
    x += K * 0.1;
    const Eigen::MatrixXd A = Eigen::MatrixXd::Identity(kN, kN) - K * H;
    P = (A * P * A.transpose() + K * K.transpose()).eval();
    benchmark::DoNotOptimize(x.sum());
  }
}

BENCHMARK(BM_EkfPlanarIns)->Unit(benchmark::kMicrosecond);
BENCHMARK(BM_EkfPlanarInsByHand)->Unit(benchmark::kMicrosecond);
BENCHMARK(BM_UkfPlanarIns)->Unit(benchmark::kMicrosecond);
BENCHMARK(BM_EkfPseudorange);
BENCHMARK(BM_EkfPseudorangeByHand);
BENCHMARK(BM_LayoutUpdate108)->Unit(benchmark::kMicrosecond);
BENCHMARK(BM_DenseUpdate108)->Unit(benchmark::kMicrosecond);

}  // namespace
}  // namespace soopnav
