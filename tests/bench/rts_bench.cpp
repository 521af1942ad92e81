// The linear filter and the smoother over whole runs, against the same equations on dynamic Eigen matrices with the
// full Joseph product. Both sides solve the same run and are compared first; the ratio is what counts.

#include <benchmark/benchmark.h>

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <cstddef>
#include <span>
#include <stdexcept>
#include <vector>

#include "soopnav/core/random.hpp"
#include "soopnav/estimation/linear_filter.hpp"
#include "soopnav/estimation/rts_smoother.hpp"

namespace {

using namespace soopnav;

struct Problem {
  RowMajorMatrix F, Q, H, R, P0;
  Eigen::VectorXd x0;
  RowMajorMatrix z;
  [[nodiscard]] LinearSystem system() const { return {F, Q, H, R}; }
  [[nodiscard]] LinearData data() const { return {.z = {z.data(), static_cast<std::size_t>(z.size())}}; }
};

// Blocks of position, velocity and acceleration, the rest offsets; every position measured together with an offset.
Problem make_problem(int n, int steps) {
  RandomStream random(1);
  const int axes = (n - 1) / 3;
  const double dt_s = 0.1;
  Problem p;
  p.F = RowMajorMatrix::Identity(n, n);
  p.Q = 1e-4 * RowMajorMatrix::Identity(n, n);
  p.H = RowMajorMatrix::Zero(axes, n);
  for (int axis = 0; axis < axes; ++axis) {
    const int i = 3 * axis;
    p.F(i, i + 1) = p.F(i + 1, i + 2) = dt_s;
    p.F(i, i + 2) = 0.5 * dt_s * dt_s;
    p.Q(i + 2, i + 2) = 0.09;
    p.H(axis, i) = 1.0;
    p.H(axis, n - 1) = 1.0;
  }
  p.R = 4.0 * RowMajorMatrix::Identity(axes, axes);
  p.P0 = 25.0 * RowMajorMatrix::Identity(n, n);
  p.x0 = Eigen::VectorXd::Zero(n);
  p.z.resize(steps, axes);
  for (int k = 0; k < steps; ++k) {
    for (int i = 0; i < axes; ++i) p.z(k, i) = 0.1 * k + 2.0 * random.normal();
  }
  return p;
}

struct DenseRun {
  std::vector<Eigen::VectorXd> x_pred, x;
  std::vector<Eigen::MatrixXd> P_pred, P;
};

// What one writes from the book: dynamic matrices, a Cholesky solution, Joseph's product.
DenseRun dense_filter(const Problem& p) {
  DenseRun out;
  Eigen::VectorXd x = p.x0;
  Eigen::MatrixXd P = p.P0;
  const Eigen::MatrixXd I = Eigen::MatrixXd::Identity(x.size(), x.size());
  for (Eigen::Index k = 0; k < p.z.rows(); ++k) {
    x = p.F * x;
    P = p.F * P * p.F.transpose() + p.Q;
    out.x_pred.push_back(x);
    out.P_pred.push_back(P);
    const Eigen::MatrixXd S = p.H * P * p.H.transpose() + p.R;
    const Eigen::MatrixXd K = S.llt().solve(p.H * P).transpose();
    x += K * (p.z.row(k).transpose() - p.H * x);
    const Eigen::MatrixXd A = I - K * p.H;
    P = A * P * A.transpose() + K * p.R * K.transpose();
    out.x.push_back(x);
    out.P.push_back(P);
  }
  return out;
}

void dense_smooth(const Problem& p, const DenseRun& run, std::vector<Eigen::VectorXd>& x,
                  std::vector<Eigen::MatrixXd>& P) {
  x = run.x;
  P = run.P;
  for (std::size_t k = x.size() - 1; k-- > 0;) {
    const Eigen::MatrixXd C = run.P_pred[k + 1].llt().solve(p.F * run.P[k]).transpose();
    x[k] += C * (x[k + 1] - run.x_pred[k + 1]);
    P[k] += C * (P[k + 1] - run.P_pred[k + 1]) * C.transpose();
  }
}

struct Smoothed {
  std::vector<double> x, P;
  explicit Smoothed(const LinearRun& run) : x(run.x.size()), P(run.P.size()) {}
};

int smooth(const Problem& p, const LinearRun& run, Smoothed& out) {
  return rts_smooth(p.F, run.x_pred, run.P_pred, run.x, run.P, out.x, out.P);
}

void check(const Problem& p) {
  const LinearRun run = linear_filter(p.system(), p.data(), p.x0, p.P0);
  Smoothed smoothed(run);
  static_cast<void>(smooth(p, run, smoothed));
  std::vector<Eigen::VectorXd> x;
  std::vector<Eigen::MatrixXd> P;
  dense_smooth(p, dense_filter(p), x, P);
  for (int k = 0; k < run.steps; ++k) {
    const auto i = static_cast<std::size_t>(k);
    const Eigen::Map<const Eigen::VectorXd> ours(smoothed.x.data() + static_cast<std::ptrdiff_t>(i) * run.n, run.n);
    const bool same = (ours - x[i]).norm() < 1e-9 * (1.0 + x[i].norm()) &&
                      (LinearRun::matrix(smoothed.P, k, run.n, run.n) - P[i]).norm() < 1e-9 * P[i].norm();
    if (!same) throw std::runtime_error("the two smoothers differ");
  }
}

constexpr int kSteps = 2400;

void BM_RtsDense(benchmark::State& state) {
  const Problem p = make_problem(static_cast<int>(state.range(0)), kSteps);
  const DenseRun run = dense_filter(p);
  std::vector<Eigen::VectorXd> x;
  std::vector<Eigen::MatrixXd> P;
  for (auto _ : state) {
    dense_smooth(p, run, x, P);
    benchmark::DoNotOptimize(P.front().data());
  }
  state.SetItemsProcessed(state.iterations() * kSteps);
}
BENCHMARK(BM_RtsDense)->Arg(4)->Arg(14)->Arg(40)->Unit(benchmark::kMillisecond);

void BM_Rts(benchmark::State& state) {
  const Problem p = make_problem(static_cast<int>(state.range(0)), kSteps);
  check(p);
  const LinearRun run = linear_filter(p.system(), p.data(), p.x0, p.P0);
  Smoothed smoothed(run);
  for (auto _ : state) benchmark::DoNotOptimize(smooth(p, run, smoothed));
  state.SetItemsProcessed(state.iterations() * kSteps);
}
BENCHMARK(BM_Rts)->Arg(4)->Arg(14)->Arg(40)->Unit(benchmark::kMillisecond);

void BM_LinearFilterDense(benchmark::State& state) {
  const Problem p = make_problem(static_cast<int>(state.range(0)), kSteps);
  for (auto _ : state) benchmark::DoNotOptimize(dense_filter(p));
  state.SetItemsProcessed(state.iterations() * kSteps);
}
BENCHMARK(BM_LinearFilterDense)->Arg(4)->Arg(14)->Arg(40)->Unit(benchmark::kMillisecond);

void BM_LinearFilter(benchmark::State& state) {
  const Problem p = make_problem(static_cast<int>(state.range(0)), kSteps);
  for (auto _ : state) benchmark::DoNotOptimize(linear_filter(p.system(), p.data(), p.x0, p.P0));
  state.SetItemsProcessed(state.iterations() * kSteps);
}
BENCHMARK(BM_LinearFilter)->Arg(4)->Arg(14)->Arg(40)->Unit(benchmark::kMillisecond);

}  // namespace
