// Position fixes per second against a Gauss-Newton iteration written out by hand on dense Eigen matrices, and the parts
// of a fix by themselves. Every case solves the same problems from the same starts; the ratio is what counts.

#include <benchmark/benchmark.h>

#include <Eigen/Dense>
#include <cstdint>
#include <stdexcept>
#include <vector>

#include "soopnav/core/constants.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/estimation/chi_square.hpp"
#include "soopnav/estimation/least_squares.hpp"
#include "soopnav/measurement/pseudorange.hpp"
#include "soopnav/navigation/position_fix.hpp"

namespace {

using namespace soopnav;
using State = PositionClock<EnuFrame>;
using Pr = Pseudorange<EnuFrame>;

struct Problem {
  std::vector<Eigen::Vector3d> sources;
  std::vector<double> pseudoranges_m;
  std::vector<double> sigmas_m;
  std::vector<Observed<Pr>> observed;
  std::vector<navigation::Node> nodes;
  std::vector<double> toas_s;
  std::vector<double> sigmas_s;
  Eigen::Vector4d truth;
};

// A receiver among `n` sources two kilometres away in all directions, noise of 1 to 5 m.
Problem make_problem(std::size_t n, std::uint64_t seed) {
  RandomStream random(seed);
  Problem p;
  p.truth << random.uniform(-300, 300), random.uniform(-300, 300), random.uniform(-300, 300), random.uniform(-1e3, 1e3);
  for (std::size_t i = 0; i < n; ++i) {
    Eigen::Vector3d q(random.normal(), random.normal(), random.normal());
    q *= 2000.0 / q.norm();
    const double sigma = random.uniform(1.0, 5.0);
    const double z = (p.truth.head<3>() - q).norm() + p.truth[3] + sigma * random.normal();
    p.sources.push_back(q);
    p.pseudoranges_m.push_back(z);
    p.sigmas_m.push_back(sigma);
    p.observed.emplace_back(Pr{q}, z, sigma * sigma);
    p.nodes.push_back({.position_m = q});
    p.toas_s.push_back(z / kSpeedOfLightMps);
    p.sigmas_s.push_back(sigma / kSpeedOfLightMps);
  }
  return p;
}

struct DenseResult {
  Eigen::VectorXd x;
  Eigen::MatrixXd covariance;
};

// What one writes on a first afternoon: dynamic matrices, weighted normal equations, an iteration to 1e-6 sigma.
DenseResult dense_gauss_newton(const Problem& p) {
  const auto n = static_cast<Eigen::Index>(p.sources.size());
  Eigen::VectorXd x = Eigen::VectorXd::Zero(4);
  Eigen::MatrixXd A;
  for (int iteration = 0; iteration < 50; ++iteration) {
    Eigen::MatrixXd H(n, 4);
    Eigen::VectorXd r(n);
    Eigen::VectorXd w(n);
    for (Eigen::Index i = 0; i < n; ++i) {
      const auto k = static_cast<std::size_t>(i);
      const Eigen::Vector3d d = x.head<3>() - p.sources[k];
      const double range = d.norm();
      H.row(i) << d.transpose() / range, 1.0;
      r[i] = p.pseudoranges_m[k] - range - x[3];
      w[i] = 1.0 / (p.sigmas_m[k] * p.sigmas_m[k]);
    }
    A = H.transpose() * w.asDiagonal() * H;
    const Eigen::VectorXd g = H.transpose() * w.asDiagonal() * r;
    const Eigen::VectorXd step = A.ldlt().solve(g);
    x += step;
    if (step.dot(g) < 1e-12) break;
  }
  return {x, A.llt().solve(Eigen::MatrixXd::Identity(4, 4))};
}

void check(const Eigen::VectorXd& a, const Eigen::VectorXd& b) {
  if (!((a - b).norm() < 1e-3)) throw std::runtime_error("the two solutions differ");
}

void BM_DenseGaussNewton(benchmark::State& state) {
  const Problem p = make_problem(static_cast<std::size_t>(state.range(0)), 1);
  for (auto _ : state) benchmark::DoNotOptimize(dense_gauss_newton(p));
  state.SetItemsProcessed(state.iterations());
}
BENCHMARK(BM_DenseGaussNewton)->Arg(5)->Arg(8)->Arg(16);

void BM_Solve(benchmark::State& state) {
  const Problem p = make_problem(static_cast<std::size_t>(state.range(0)), 1);
  check(solve(State{}, {}, p.observed).state.x, dense_gauss_newton(p).x);
  for (auto _ : state) benchmark::DoNotOptimize(solve(State{}, {}, p.observed));
  state.SetItemsProcessed(state.iterations());
}
BENCHMARK(BM_Solve)->Arg(5)->Arg(8)->Arg(16);

void BM_PositionFix(benchmark::State& state) {
  const Problem p = make_problem(static_cast<std::size_t>(state.range(0)), 1);
  const auto fix = navigation::position_fix(p.nodes, p.toas_s, p.sigmas_s);
  check(fix.position_m, dense_gauss_newton(p).x.head<3>());
  for (auto _ : state) benchmark::DoNotOptimize(navigation::position_fix(p.nodes, p.toas_s, p.sigmas_s));
  state.SetItemsProcessed(state.iterations());
}
BENCHMARK(BM_PositionFix)->Arg(5)->Arg(8)->Arg(16);

void BM_PositionFixWithOneOutlier(benchmark::State& state) {
  Problem p = make_problem(static_cast<std::size_t>(state.range(0)), 1);
  p.toas_s[2] += 300e-9;
  for (auto _ : state) benchmark::DoNotOptimize(navigation::position_fix(p.nodes, p.toas_s, p.sigmas_s));
  state.SetItemsProcessed(state.iterations());
}
BENCHMARK(BM_PositionFixWithOneOutlier)->Arg(8)->Arg(16);

void BM_ChiSquareUpperQuantile(benchmark::State& state) {
  double p = 1e-3;
  for (auto _ : state) {
    benchmark::DoNotOptimize(p);
    benchmark::DoNotOptimize(chi_square_upper_quantile(p, 5.0));
  }
}
BENCHMARK(BM_ChiSquareUpperQuantile);

}  // namespace
