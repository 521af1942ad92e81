#include "waveform/lte/path_model.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "waveform/lte/kernels.hpp"
#include "waveform/lte/noise_level.hpp"

namespace soopnav::lte {

double noise_level(int ports, double trials, double p) {
  double x = 1.0;
  for (int i = 0; i < 100; ++i) {  // survival = exp(-x) sum_{k < ports} x^k / k!; fixed point of its logarithm
    double sum = 1.0, term = 1.0;
    for (int k = 1; k < ports; ++k) {
      term *= x / k;
      sum += term;
    }
    const double next = std::log(trials / p) + std::log(sum);
    if (std::abs(next - x) < 1e-9) break;
    x = next;
  }
  return x;
}

PathModel::PathModel() {
  for (auto& a : amplitudes_) a.resize(0);
}

double PathModel::power(int path) const noexcept {
  double sum = 0.0;
  for (int p = 0; p < ports_; ++p) sum += std::norm(amplitudes_[static_cast<std::size_t>(p)](path));
  return sum / ports_;
}

void PathModel::solve_amplitudes(const Cf32* const* y) {
  steering_.resize(count_, paths_);
  for (int l = 0; l < paths_; ++l) {
    const double step = -2.0 * std::numbers::pi * delays_[static_cast<std::size_t>(l)] / fft_size_;
    for (int j = 0; j < count_; ++j) steering_(j, l) = std::polar(1.0, step * frequencies_[j]);
  }
  const Eigen::MatrixXcd gram = steering_.adjoint() * steering_;
  const Eigen::LDLT<Eigen::MatrixXcd> solver(gram);
  for (int p = 0; p < ports_; ++p) {
    const Eigen::Map<const Eigen::VectorXcf> data(y[p], count_);
    amplitudes_[static_cast<std::size_t>(p)] = solver.solve(steering_.adjoint() * data.cast<std::complex<double>>());
  }
}

// Gauss-Newton on the delays; the amplitudes follow by least squares (variable projection). False when two delays
// merge.
bool PathModel::refine(const Cf32* const* y) {
  const double omega = 2.0 * std::numbers::pi / fft_size_;
  const double span = frequencies_[count_ - 1] - frequencies_[0];
  const double cell = fft_size_ / span;  // samples per resolution cell
  Eigen::VectorXd f(count_);
  for (int j = 0; j < count_; ++j) f(j) = frequencies_[j];
  for (int iteration = 0; iteration < 30; ++iteration) {
    solve_amplitudes(y);
    const Eigen::LDLT<Eigen::MatrixXcd> gram(Eigen::MatrixXcd(steering_.adjoint() * steering_));
    information_ = Eigen::MatrixXd::Zero(paths_, paths_);
    Eigen::VectorXd gradient = Eigen::VectorXd::Zero(paths_);
    for (int p = 0; p < ports_; ++p) {
      const auto& a = amplitudes_[static_cast<std::size_t>(p)];
      const Eigen::Map<const Eigen::VectorXcf> data(y[p], count_);
      const Eigen::VectorXcd residual = data.cast<std::complex<double>>() - steering_ * a;
      Eigen::MatrixXcd jacobian(count_, paths_);
      for (int l = 0; l < paths_; ++l) {
        jacobian.col(l) = (std::complex<double>(0.0, -omega) * a(l)) *
                          (f.cast<std::complex<double>>().cwiseProduct(steering_.col(l)));
      }
      jacobian -= steering_ * gram.solve(steering_.adjoint() * jacobian);
      information_ += (jacobian.adjoint() * jacobian).real();
      gradient += (jacobian.adjoint() * residual).real();
    }
    Eigen::VectorXd step = information_.ldlt().solve(gradient);
    if (!step.allFinite()) return false;
    const double largest = step.cwiseAbs().maxCoeff();
    if (largest > 0.25 * cell) step *= 0.25 * cell / largest;
    for (int l = 0; l < paths_; ++l) delays_[static_cast<std::size_t>(l)] += step(l);
    for (int l = 0; l < paths_; ++l) {
      for (int m = l + 1; m < paths_; ++m) {
        const double gap = std::abs(delays_[static_cast<std::size_t>(l)] - delays_[static_cast<std::size_t>(m)]);
        if (gap < 0.3 * cell) return false;
      }
    }
    if (largest < 1e-6) break;
  }
  solve_amplitudes(y);
  return true;
}

void PathModel::make_model() {
  for (int p = 0; p < ports_; ++p) {
    const auto u = static_cast<std::size_t>(p);
    model_[u].resize(static_cast<std::size_t>(count_));
    Eigen::Map<Eigen::VectorXcf>(model_[u].data(), count_) = (steering_ * amplitudes_[u]).cast<Cf32>();
  }
}

bool PathModel::fit(const Cf32* const* y, int ports, const int* frequencies, int count, int fft_size, double noise,
                    const Limits& limits, CoarseDelay& coarse) {
  ports_ = ports;
  count_ = count;
  fft_size_ = fft_size;
  frequencies_ = frequencies;
  paths_ = 0;
  const double cell = static_cast<double>(fft_size) / (frequencies[count - 1] - frequencies[0]);
  const double trials = std::max(2.0, 2.0 * 2.0 * limits.window_samples / cell);
  const double level = noise_level(ports, trials, limits.false_path);
  std::array<const Cf32*, kMaxPorts> residual{};
  for (int p = 0; p < ports; ++p) {
    const auto u = static_cast<std::size_t>(p);
    residual_[u].assign(y[p], y[p] + count);
    residual[u] = residual_[u].data();
  }
  double strongest = 0.0, floor = noise;
  while (paths_ < kMaxPaths) {
    static_cast<void>(coarse.estimate(residual.data(), ports, count, fft_size));
    const auto& profile = coarse.profile();
    const int size = static_cast<int>(profile.size());
    const double lag = fft_size / 3.0 / size;  // samples per element
    const int reach = std::min(size / 2 - 1, static_cast<int>(limits.window_samples / lag));
    float top = -1.0F;
    int at = 0;
    for (int i = -reach; i <= reach; ++i) {
      const float v = profile[static_cast<std::size_t>((i + size) % size)];
      if (v > top) {
        top = v;
        at = i;
      }
    }
    const double power = static_cast<double>(top) / count;  // of one port's sum of unit exponentials, times the noise
    // Another cell's reference signals repeat from frame to frame and survive the average: what lies outside the window
    // of possible delays shows how much.
    double outside = 0.0;
    int lags = 0;
    for (int i = reach + 1; i < size - reach; ++i, ++lags)
      outside += static_cast<double>(profile[static_cast<std::size_t>(i)]);
    floor = lags > size / 8 ? std::max(noise, outside / (static_cast<double>(lags) * count * ports)) : noise;
    if (power < level * floor) break;
    if (paths_ > 0 && power < std::pow(10.0, limits.weakest_db / 10.0) * strongest) break;
    const auto saved_delays = delays_;
    const auto saved_amplitudes = amplitudes_;
    const int saved_paths = paths_;
    delays_[static_cast<std::size_t>(paths_)] = at * lag;
    ++paths_;
    const bool good = refine(y);
    bool inside = true;
    for (int l = 0; l < paths_; ++l) {
      inside = inside && std::abs(delays_[static_cast<std::size_t>(l)]) < limits.window_samples + cell;
    }
    if (!good || !inside) {
      delays_ = saved_delays;
      amplitudes_ = saved_amplitudes;
      paths_ = saved_paths;
      break;
    }
    strongest = 0.0;
    for (int l = 0; l < paths_; ++l) strongest = std::max(strongest, this->power(l) * ports * count);
    make_model();
    for (int p = 0; p < ports; ++p) {
      const auto u = static_cast<std::size_t>(p);
      for (std::size_t j = 0; j < residual_[u].size(); ++j) residual_[u][j] = y[p][j] - model_[u][j];
    }
  }
  if (paths_ == 0) return false;
  std::sort(delays_.begin(), delays_.begin() + paths_);
  static_cast<void>(refine(y));
  make_model();
  strongest = 0.0;
  for (int l = 0; l < paths_; ++l) strongest = std::max(strongest, power(l));
  first_ = 0;
  while (first_ < paths_ - 1 && power(first_) < std::pow(10.0, limits.earliest_db / 10.0) * strongest) ++first_;
  Eigen::VectorXd unit = Eigen::VectorXd::Zero(paths_);
  unit(first_) = 1.0;
  const double variance = information_.ldlt().solve(unit)(first_) * floor / 2.0;
  first_sigma_ = std::sqrt(std::max(variance, 0.0));
  return true;
}

}  // namespace soopnav::lte
