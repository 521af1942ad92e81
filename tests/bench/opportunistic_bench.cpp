// Fifty sources with unknown clocks: 158 states, 100 observables an epoch, in both forms, against the same filter on
// dynamic Eigen matrices with the full Joseph product. Both solve the same run and are compared first; `realtime` is
// how many times faster than 10 Hz an epoch is.

#include <benchmark/benchmark.h>

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <cmath>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/clock/oscillator.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/navigation/opportunistic_navigator.hpp"

namespace {

using namespace soopnav;
using namespace soopnav::navigation;

constexpr int kSources = 50;
constexpr int kEpochs = 60;
constexpr double kDt = 0.1;
constexpr double kCarrierHz = 1.9e9;
constexpr double kLambda = kSpeedOfLightMps / kCarrierHz;
constexpr double kPhaseSigma = 1e-3;
constexpr double kRangeSigma = 3.0;
constexpr double kAcceleration = 0.1;

struct Problem {
  Eigen::Vector3d p0{-740000.0, -5470000.0, 3200000.0};
  std::vector<Eigen::Vector3d> q;
  std::vector<std::vector<OpportunisticObservation>> epochs;
};

Problem make_problem() {
  Problem out;
  RandomStream random(1);
  std::vector<double> bias, drift, ambiguity;
  for (int k = 0; k < kSources; ++k) {
    out.q.push_back(out.p0 + 3000.0 * Eigen::Vector3d(random.normal(), random.normal(), random.normal()));
    bias.push_back(100.0 * random.normal());
    drift.push_back(0.05 * random.normal());
    ambiguity.push_back(300.0 * random.normal());
  }
  for (int e = 0; e < kEpochs; ++e) {
    auto& observed = out.epochs.emplace_back();
    for (int k = 0; k < kSources; ++k) {
      const auto i = static_cast<std::size_t>(k);
      // Plain ranges: the turn of the Earth is a centimetre that the clocks take.
      const double range = (out.q[i] - out.p0).norm() + 20.0 + 0.3 * kDt * e - bias[i] - drift[i] * kDt * e;
      observed.push_back(
          {k, ObservableKind::kPhase, range / kLambda + ambiguity[i] + kPhaseSigma * random.normal(), kPhaseSigma});
      observed.push_back({k, ObservableKind::kPseudorange, range + kRangeSigma * random.normal(), kRangeSigma});
    }
  }
  return out;
}

OpportunisticNavigator make_navigator(const Problem& problem, OpportunisticForm form) {
  OpportunisticStart start;
  start.position_e_m = problem.p0;
  start.position_covariance_m2 = 0.01 * Eigen::Matrix3d::Identity();  // so near that nothing is iterated
  start.velocity_covariance_m2ps2 = 0.01 * Eigen::Matrix3d::Identity();
  start.clock_covariance << 2500.0, 0.0, 0.0, 1.0;
  OpportunisticOptions options;
  options.motion = OpportunisticMotion::kVelocity;
  options.form = form;
  options.time_tag = TimeTag::kSystem;
  options.max_sources = kSources;
  options.clock = clock::Oscillator::tcxo().noise();
  options.acceleration_psd_m2ps3 = kAcceleration;
  OpportunisticNavigator navigator(start, options);
  for (int k = 0; k < kSources; ++k) {
    OpportunisticSource source;
    source.name = std::to_string(k);
    source.carrier_hz = kCarrierHz;
    source.position_e_m = problem.q[static_cast<std::size_t>(k)];
    source.clock_estimated = true;
    source.clock_noise = clock::Oscillator::ocxo().noise();
    source.clock_covariance << 1e4, 0.0, 0.0, 0.01;
    source.ambiguity_sigma_cycles = 300.0;
    navigator.add_source(source);
  }
  return navigator;
}

// The same by the book: dense F, Q, H, one update of 100 rows, (I - K H) P (I - K H)' + K R K'.
struct Dense {
  static constexpr int kDim = 8 + 3 * kSources;
  Eigen::VectorXd x = Eigen::VectorXd::Zero(kDim);
  Eigen::MatrixXd P = Eigen::MatrixXd::Zero(kDim, kDim), F = Eigen::MatrixXd::Identity(kDim, kDim),
                  Q = Eigen::MatrixXd::Zero(kDim, kDim), H = Eigen::MatrixXd::Zero(2 * kSources, kDim);

  explicit Dense(const Problem& problem) {
    x.segment<3>(3) = problem.p0;
    const auto clock = [&](int at, const clock::ClockNoise& n) {
      F(at + 1, at) = kDt;
      Q(at, at) = n.frequency_walk_m2ps3 * kDt;
      Q(at, at + 1) = Q(at + 1, at) = 0.5 * n.frequency_walk_m2ps3 * kDt * kDt;
      Q(at + 1, at + 1) = n.white_frequency_m2ps * kDt + n.frequency_walk_m2ps3 * kDt * kDt * kDt / 3.0;
    };
    for (int i = 0; i < 3; ++i) {
      P(i, i) = 0.01;
      P(3 + i, 3 + i) = 0.01;
      F(3 + i, i) = kDt;
      Q(i, i) = kAcceleration * kDt;
      Q(i, 3 + i) = Q(3 + i, i) = 0.5 * kAcceleration * kDt * kDt;
      Q(3 + i, 3 + i) = kAcceleration * kDt * kDt * kDt / 3.0;
    }
    P(6, 6) = 1.0;
    P(7, 7) = 2500.0;
    clock(6, clock::Oscillator::tcxo().noise());
    for (int k = 0; k < kSources; ++k) {
      const int at = 8 + 3 * k;
      P(at, at) = 0.01;
      P(at + 1, at + 1) = 1e4;
      P(at + 2, at + 2) = 9e4;
      clock(at, clock::Oscillator::ocxo().noise());
    }
  }

  void step(const Problem& problem, const std::vector<OpportunisticObservation>& observed, bool first) {
    if (!first) {
      x = (F * x).eval();
      P = (F * P * F.transpose() + Q).eval();
    }
    Eigen::VectorXd nu(2 * kSources), R(2 * kSources);
    for (int k = 0; k < kSources; ++k) {
      const Eigen::Vector3d& q = problem.q[static_cast<std::size_t>(k)];
      const Eigen::Vector3d line = x.segment<3>(3) - q;
      const double omega = wgs84::kEarthRateRadps / kSpeedOfLightMps;
      const double range =
          line.norm() + omega * (q.x() * x[4] - q.y() * x[3]);  // the turn of the Earth, to first order
      const int at = 8 + 3 * k;
      for (int kind = 0; kind < 2; ++kind) {
        const int row = 2 * k + kind;
        const double scale = kind == 0 ? 1.0 / kLambda : 1.0;
        H.block<1, 3>(row, 3) = scale * line.transpose() / line.norm();
        H(row, 7) = scale;
        H(row, at + 1) = -scale;
        H(row, at) = scale * range / kSpeedOfLightMps;
        if (kind == 0) H(row, at + 2) = 1.0;
        nu[row] = observed[static_cast<std::size_t>(row)].value -
                  scale * (range + x[7] - x[at + 1] + x[at] * range / kSpeedOfLightMps) - (kind == 0 ? x[at + 2] : 0.0);
        R[row] = kind == 0 ? kPhaseSigma * kPhaseSigma : kRangeSigma * kRangeSigma;
      }
    }
    const Eigen::MatrixXd PH = P * H.transpose();
    Eigen::MatrixXd S = H * PH;
    S.diagonal() += R;
    const Eigen::MatrixXd K = S.llt().solve(PH.transpose()).transpose();
    x += K * nu;
    const Eigen::MatrixXd A = Eigen::MatrixXd::Identity(kDim, kDim) - K * H;
    P = (A * P * A.transpose() + K * R.asDiagonal() * K.transpose()).eval();
    P = (0.5 * (P + P.transpose())).eval();
  }
};

void navigator_case(benchmark::State& state, OpportunisticForm form) {
  const Problem problem = make_problem();
  {
    OpportunisticNavigator navigator = make_navigator(problem, form);
    Dense dense(problem);
    for (int e = 0; e < kEpochs; ++e) {
      const auto report = navigator.step(kDt * e, problem.epochs[static_cast<std::size_t>(e)]);
      if (report.accepted != 2 * kSources) throw std::runtime_error("an observable was refused");
      dense.step(problem, problem.epochs[static_cast<std::size_t>(e)], e == 0);
    }
    const Eigen::VectorXd ours = navigator.covariance().diagonal();
    if (((navigator.mean() - dense.x).array() / ours.array().sqrt()).abs().maxCoeff() > 0.02) {
      throw std::runtime_error("the means differ");
    }
    if (((ours - dense.P.diagonal()).array() / ours.array()).abs().maxCoeff() > 1e-3) {
      throw std::runtime_error("the variances differ");
    }
  }
  for (auto _ : state) {
    state.PauseTiming();
    OpportunisticNavigator navigator = make_navigator(problem, form);
    state.ResumeTiming();
    for (int e = 0; e < kEpochs; ++e) {
      benchmark::DoNotOptimize(navigator.step(kDt * e, problem.epochs[static_cast<std::size_t>(e)]));
    }
  }
  state.counters["realtime"] =
      benchmark::Counter(kDt * kEpochs * static_cast<double>(state.iterations()), benchmark::Counter::kIsRate);
}

void SquareRoot(benchmark::State& state) { navigator_case(state, OpportunisticForm::kSquareRoot); }
void Joseph(benchmark::State& state) { navigator_case(state, OpportunisticForm::kJoseph); }

void DenseJoseph(benchmark::State& state) {
  const Problem problem = make_problem();
  for (auto _ : state) {
    Dense dense(problem);
    for (int e = 0; e < kEpochs; ++e) dense.step(problem, problem.epochs[static_cast<std::size_t>(e)], e == 0);
    benchmark::DoNotOptimize(dense.x);
  }
  state.counters["realtime"] =
      benchmark::Counter(kDt * kEpochs * static_cast<double>(state.iterations()), benchmark::Counter::kIsRate);
}

BENCHMARK(SquareRoot)->Unit(benchmark::kMillisecond);
BENCHMARK(Joseph)->Unit(benchmark::kMillisecond);
BENCHMARK(DenseJoseph)->Unit(benchmark::kMillisecond);

}  // namespace
