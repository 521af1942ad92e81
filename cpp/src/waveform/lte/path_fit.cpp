#include "waveform/lte/path_fit.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "waveform/lte/kernels.hpp"

namespace soopnav::lte {

namespace {
using Complex = std::complex<double>;
constexpr double kTwoPi = 2.0 * std::numbers::pi;
constexpr std::size_t kGrid = 64;  // places of best_pair

Complex dot(const Cf32* a, const Cf32* b, int n) {
  return Complex(kernels::dot_conj(a, b, static_cast<std::size_t>(n)));
}
}  // namespace

PathFit::PathFit() : left_(kElements), grid_(kGrid * kMaxPorts) {}

void PathFit::set(const ChannelView& channel) {
  channel_ = channel;
  count_ = static_cast<int>(channel.frequencies.size());
  half_ = count_ / 2;
  step_ = channel.frequencies[1] - channel.frequencies[0];
  scale_ = static_cast<float>(std::max(std::abs(channel.frequencies.front()), std::abs(channel.frequencies.back())));
  for (int j = 0; j < count_; ++j) {
    const auto u = static_cast<std::size_t>(j);
    frequency_[u] = static_cast<float>(channel.frequencies[u]) / scale_;
  }
}

void PathFit::phasors(double theta, Cf32* out) const {
  const auto half = static_cast<std::size_t>(half_);
  kernels::phasors(-theta * channel_.frequencies[0], -theta * step_, out, half);
  kernels::phasors(-theta * channel_.frequencies[half], -theta * step_, out + half, half);
}

// Amplitudes, residual and information for s.theta.
bool PathFit::solve(Solution& s) {
  const int k = s.paths, ports = channel_.ports;
  SmallMatrix<Complex, kMaxResolved> g0, g1, g2;
  for (int l = 0; l < k; ++l) {
    const auto row = static_cast<std::size_t>(l);
    auto& a = steering_[row];
    auto& w = weighted_[row];
    phasors(s.theta[row], a.data());
    for (std::size_t j = 0; j < static_cast<std::size_t>(count_); ++j) w[j] = a[j] * frequency_[j];
    for (int m = 0; m <= l; ++m) {
      const auto& b = steering_[static_cast<std::size_t>(m)];
      const auto& v = weighted_[static_cast<std::size_t>(m)];
      g0(m, l) = dot(a.data(), b.data(), count_);  // sum conj(b) a
      g1(m, l) = dot(w.data(), b.data(), count_);
      g2(m, l) = dot(w.data(), v.data(), count_);
      g0(l, m) = std::conj(g0(m, l));
      g1(l, m) = std::conj(g1(m, l));
      g2(l, m) = std::conj(g2(m, l));
    }
    for (int p = 0; p < ports; ++p) {
      const auto u = static_cast<std::size_t>(p);
      s.gains[row][u] = dot(channel_.port[u], a.data(), count_);
    }
  }
  SmallCholesky<Complex, kMaxResolved> solver;
  if (!solver.factor(g0, k, 1e-6 * count_)) return false;
  for (int p = 0; p < ports; ++p) solver.solve(&s.gains[0][static_cast<std::size_t>(p)], kMaxPorts);
  auto projected = g1;  // G0^-1 G1
  for (int l = 0; l < k; ++l) solver.solve(&projected(0, l), kMaxResolved);
  for (int l = 0; l < k; ++l) {
    for (int n = 0; n < k; ++n) {
      Complex m = g2(l, n), power = 0.0;
      for (int i = 0; i < k; ++i) m -= product(g1(l, i), projected(i, n));
      for (std::size_t p = 0; p < static_cast<std::size_t>(ports); ++p) {
        power += std::conj(s.gains[static_cast<std::size_t>(l)][p]) * s.gains[static_cast<std::size_t>(n)][p];
      }
      s.information(l, n) = std::pow(kTwoPi * static_cast<double>(scale_), 2) * product(m, power).real();
    }
  }
  s.residual = 0.0;
  return true;
}

bool PathFit::evaluate(int paths, const Delays& theta, Solution& out) {
  out.paths = paths;
  out.theta = theta;
  if (!solve(out)) return false;
  for (int p = 0; p < channel_.ports; ++p) {
    const Cf32* y = channel_.port[static_cast<std::size_t>(p)];
    std::copy_n(y, count_, left_.begin());
    for (int l = 0; l < paths; ++l) {
      const Cf32 gain(out.gains[static_cast<std::size_t>(l)][static_cast<std::size_t>(p)]);
      const auto& a = steering_[static_cast<std::size_t>(l)];
      for (std::size_t j = 0; j < static_cast<std::size_t>(count_); ++j) left_[j] -= kernels::multiply(gain, a[j]);
    }
    out.residual += kernels::energy(left_.data(), static_cast<std::size_t>(count_));
  }
  return true;
}

bool PathFit::polish(int paths, const Delays& theta, double separation, double low, double high, Solution& out) {
  const double cell = 1.0 / (channel_.frequencies.back() - channel_.frequencies.front());
  if (!evaluate(paths, theta, out)) return false;
  double damping = 1e-3;
  Solution trial;
  for (int iteration = 0; iteration < 25; ++iteration) {
    // Gradient of half the residual energy: the residual is orthogonal to the columns, so no projection is needed.
    Delays gradient{};
    for (int p = 0; p < channel_.ports; ++p) {
      std::copy_n(channel_.port[static_cast<std::size_t>(p)], count_, left_.begin());
      for (int l = 0; l < paths; ++l) {
        const Cf32 gain(out.gains[static_cast<std::size_t>(l)][static_cast<std::size_t>(p)]);
        const auto& a = steering_[static_cast<std::size_t>(l)];
        for (std::size_t j = 0; j < static_cast<std::size_t>(count_); ++j) left_[j] -= kernels::multiply(gain, a[j]);
      }
      for (int l = 0; l < paths; ++l) {
        const Complex t = dot(left_.data(), weighted_[static_cast<std::size_t>(l)].data(), count_);
        gradient[static_cast<std::size_t>(l)] +=
            (Complex(0.0, kTwoPi * static_cast<double>(scale_)) *
             std::conj(out.gains[static_cast<std::size_t>(l)][static_cast<std::size_t>(p)]) * t)
                .real();
      }
    }
    bool better = false;
    double moved = 0.0;
    for (int attempt = 0; attempt < 6 && !better; ++attempt) {
      Information h = out.information;
      for (int l = 0; l < paths; ++l) h(l, l) += damping * std::abs(h(l, l)) + 1e-30;
      SmallCholesky<double, kMaxResolved> solver;
      if (!solver.factor(h, paths, 0.0)) {
        damping = std::max(10.0 * damping, 1e-4);
        continue;
      }
      Delays step = gradient;
      solver.solve(step.data());
      moved = 0.0;
      for (int l = 0; l < paths; ++l) moved = std::max(moved, std::abs(step[static_cast<std::size_t>(l)]));
      if (!std::isfinite(moved)) return false;
      const double share = moved > 0.3 * cell ? 0.3 * cell / moved : 1.0;
      Delays next = out.theta;
      for (std::size_t l = 0; l < static_cast<std::size_t>(paths); ++l) next[l] += share * step[l];
      if (evaluate(paths, next, trial) && trial.residual <= out.residual * (1.0 + 1e-7)) {
        better = true;
        out = trial;
        damping = std::max(0.2 * damping, 1e-9);
      } else {
        damping = std::max(10.0 * damping, 1e-4);
      }
    }
    if (!better) {
      if (!evaluate(paths, out.theta, out)) return false;  // what is kept of the steering belongs to it again
      break;
    }
    if (moved < 1e-5 * cell) break;
  }
  Delays sorted = out.theta;
  bool ascending = true;
  for (std::size_t l = 1; l < static_cast<std::size_t>(paths); ++l) {
    for (std::size_t m = l; m > 0 && sorted[m] < sorted[m - 1]; --m) {
      std::swap(sorted[m], sorted[m - 1]);
      ascending = false;
    }
  }
  for (std::size_t l = 0; l + 1 < static_cast<std::size_t>(paths); ++l) {
    if (sorted[l + 1] - sorted[l] < separation) return false;
  }
  if (!(sorted[0] >= low && sorted[static_cast<std::size_t>(paths - 1)] <= high)) return false;
  return ascending || evaluate(paths, sorted, out);
}

std::array<double, 2> PathFit::best_pair(double low, double high, double step) {
  const int places = std::min(static_cast<int>(kGrid), 1 + static_cast<int>((high - low) / step));
  const int ports = channel_.ports;
  Cf32* a = steering_[0].data();
  std::array<Complex, kGrid> overlap;  // of two columns i steps apart, over the count of elements
  for (int i = 0; i < places; ++i) {
    phasors(i * step, a);
    Complex sum = 0.0;
    for (int j = 0; j < count_; ++j) sum += Complex(a[j]);
    overlap[static_cast<std::size_t>(i)] = sum / static_cast<double>(count_);
    phasors(low + i * step, a);
    for (int p = 0; p < ports; ++p) {
      grid_[static_cast<std::size_t>(i * ports + p)] = dot(channel_.port[static_cast<std::size_t>(p)], a, count_);
    }
  }
  double best = -1.0;
  std::array<double, 2> out{low, low + 2.0 * step};
  for (int i = 0; i < places; ++i) {
    for (int m = i + 2; m < places; ++m) {
      const Complex g = overlap[static_cast<std::size_t>(m - i)];  // conj(column i) . column m
      const double determinant = 1.0 - std::norm(g);
      double explained = 0.0;
      for (int p = 0; p < ports; ++p) {
        const Complex u = grid_[static_cast<std::size_t>(i * ports + p)];
        const Complex v = grid_[static_cast<std::size_t>(m * ports + p)];
        explained += std::norm(u) + std::norm(v) - 2.0 * (std::conj(u) * g * v).real();
      }
      explained /= determinant;
      if (explained > best) {
        best = explained;
        out = {low + i * step, low + m * step};
      }
    }
  }
  return out;
}

void PathFit::residual(const Solution& solution, std::array<std::vector<Cf32>, kMaxPorts>& out) const {
  std::array<Cf32, kElements> a;
  for (int p = 0; p < channel_.ports; ++p) {
    auto& to = out[static_cast<std::size_t>(p)];
    std::copy_n(channel_.port[static_cast<std::size_t>(p)], count_, to.begin());
  }
  for (int l = 0; l < solution.paths; ++l) {
    phasors(solution.theta[static_cast<std::size_t>(l)], a.data());
    for (int p = 0; p < channel_.ports; ++p) {
      const Cf32 gain(solution.gains[static_cast<std::size_t>(l)][static_cast<std::size_t>(p)]);
      auto& to = out[static_cast<std::size_t>(p)];
      for (std::size_t j = 0; j < static_cast<std::size_t>(count_); ++j) to[j] -= kernels::multiply(gain, a[j]);
    }
  }
}

}  // namespace soopnav::lte
