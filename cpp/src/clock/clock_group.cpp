#include "soopnav/clock/clock_group.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/core/constants.hpp"

namespace soopnav::clock {
namespace {

constexpr std::size_t kStates = 2 * PhaseModel::kMaxClocks;
constexpr std::size_t kChannels = PhaseModel::kMaxChannels;
using State = std::array<double, kStates>;

// Row-major with a stride of its own size: the first n x n of it are in use.
struct Block {
  std::array<double, kStates * kStates> a{};
  [[nodiscard]] double& operator()(std::size_t i, std::size_t j) noexcept { return a[i * kStates + j]; }
  [[nodiscard]] double operator()(std::size_t i, std::size_t j) const noexcept { return a[i * kStates + j]; }
};

// Cholesky of the innovation's covariance, in place; false when it is not positive definite.
bool factorise(std::array<double, kChannels * kChannels>& s, std::size_t m) noexcept {
  for (std::size_t j = 0; j < m; ++j) {
    for (std::size_t i = j; i < m; ++i) {
      double sum = s[i * m + j];
      for (std::size_t k = 0; k < j; ++k) sum -= s[i * m + k] * s[j * m + k];
      if (i == j) {
        if (!(sum > 0.0)) return false;
        s[j * m + j] = std::sqrt(sum);
      } else {
        s[i * m + j] = sum / s[j * m + j];
      }
    }
  }
  return true;
}

}  // namespace

struct ClockGroup::Pass {
  struct Epoch {
    State x{};  // predicted
    Block p;
    std::array<double, kChannels> w{};            // L⁻¹ e, S = L Lᵀ
    std::array<double, kChannels * kStates> v{};  // L⁻¹ H
    std::array<double, kStates * kChannels> gain{};
    bool observed = false;
    double filtered[PhaseModel::kMaxClocks]{};
    double variance[PhaseModel::kMaxClocks]{};
  };
  std::size_t first = 0;
  std::vector<Epoch> epochs;
  std::vector<double> offset, slope;  // of the line taken from each channel
};

ClockGroup::ClockGroup(const PhaseModel& model, std::span<const Oscillator> clocks)
    : model_(model), clocks_(clocks.begin(), clocks.end()) {
  check_model(model);
  const std::size_t m = model.channels;
  if (clocks.size() != model.clocks) {
    throw std::invalid_argument("clocks: " + std::to_string(model.clocks) + " expected, got " +
                                std::to_string(clocks.size()));
  }
  if (m > model.clocks) {
    throw std::invalid_argument("channels = " + std::to_string(m) + ": no more than clocks (" +
                                std::to_string(model.clocks) + ") expected");
  }
  for (const Oscillator& clock : clocks) static_cast<void>(clock.noise());  // throws for what is no clock
  double trace = 0.0;
  for (std::size_t i = 0; i < m; ++i) trace += model.covariance_s2[i * m + i];
  unit_s_ = std::sqrt(trace / static_cast<double>(m));
  // Biases of the last clocks from phases: Gauss-Jordan with pivots on a matrix of at most 3 x 3, once.
  std::vector<double> a(2 * m * m, 0.0);
  for (std::size_t i = 0; i < m; ++i) {
    for (std::size_t j = 0; j < m; ++j) a[i * 2 * m + j] = model.mixing[i * model.clocks + (model.clocks - m) + j];
    a[i * 2 * m + m + i] = 1.0;
  }
  for (std::size_t j = 0; j < m; ++j) {
    std::size_t pivot = j;
    for (std::size_t i = j; i < m; ++i) {
      if (std::abs(a[i * 2 * m + j]) > std::abs(a[pivot * 2 * m + j])) pivot = i;
    }
    if (!(std::abs(a[pivot * 2 * m + j]) > 1e-9)) {
      throw std::invalid_argument("mixing: the columns of the last " + std::to_string(m) +
                                  " clocks are dependent: order the clocks so that the phases tell these apart");
    }
    for (std::size_t k = 0; k < 2 * m; ++k) std::swap(a[j * 2 * m + k], a[pivot * 2 * m + k]);
    for (std::size_t k = 2 * m; k-- > j;) a[j * 2 * m + k] /= a[j * 2 * m + j];
    for (std::size_t i = 0; i < m; ++i) {
      if (i == j) continue;
      const double f = a[i * 2 * m + j];
      for (std::size_t k = j; k < 2 * m; ++k) a[i * 2 * m + k] -= f * a[j * 2 * m + k];
    }
  }
  start_.resize(m * m);
  for (std::size_t i = 0; i < m; ++i) {
    for (std::size_t j = 0; j < m; ++j) start_[i * m + j] = a[i * 2 * m + m + j];
  }
}

ClockGroup::Pass ClockGroup::forward(std::span<const double> phase, std::size_t epochs) const {
  const std::size_t m = model_.channels;
  const std::size_t c = model_.clocks;
  const std::size_t n = 2 * c;
  const auto whole = [&](std::size_t k) {
    for (std::size_t i = 0; i < m; ++i) {
      if (!(phase[k * m + i] == phase[k * m + i])) return false;
    }
    return true;
  };
  std::size_t first = epochs;
  std::size_t second = epochs;
  std::size_t last = 0;
  for (std::size_t k = 0; k < epochs; ++k) {
    for (std::size_t i = 0; i < m; ++i) check_phase(phase[k * m + i], k, unit_s_);
    if (!whole(k)) continue;
    if (first == epochs) {
      first = k;
    } else if (second == epochs) {
      second = k;
    }
    last = k;
  }
  if (second == epochs) throw std::invalid_argument("phase_s: at least 2 whole epochs expected");

  Pass pass;
  pass.first = first;
  pass.epochs.resize(epochs);
  for (std::size_t i = 0; i < m; ++i) {
    pass.offset.push_back(phase[first * m + i]);
    pass.slope.push_back((phase[last * m + i] - phase[first * m + i]) / static_cast<double>(last - first));
  }
  const auto reading = [&](std::size_t k, std::size_t i) {
    return (phase[k * m + i] - pass.offset[i] - pass.slope[i] * static_cast<double>(k - first)) / unit_s_;
  };

  State f{};
  State g{};
  double noise = 0.0;  // of a drift read off two phases
  for (std::size_t k = 0; k < c; ++k) {
    const double scale = model_.dt_s / (unit_s_ * unit_s_);
    f[k] = 0.5 * clocks_[k].h0 * scale;
    g[k] = 2.0 * kPi * kPi * clocks_[k].h_minus_2 * scale * model_.dt_s * model_.dt_s;
    noise += f[k] + g[k];
  }
  std::array<double, kChannels * kChannels> r{};
  for (std::size_t i = 0; i < m * m; ++i) r[i] = model_.covariance_s2[i] / (unit_s_ * unit_s_);

  // The last clocks start from the first phases, the others define zero (doc/characterization.md eq. 16).
  State x{};
  Block p;
  double largest = 0.0;
  for (std::size_t i = 0; i < m; ++i) {
    double to_next = 0.0;
    for (std::size_t j = 0; j < m; ++j) {
      to_next += start_[i * m + j] * reading(second, j);
      largest = std::max(largest, std::abs(start_[i * m + j]));
      double sum = 0.0;
      for (std::size_t k = 0; k < m; ++k) {
        for (std::size_t l = 0; l < m; ++l) sum += start_[i * m + k] * r[k * m + l] * start_[j * m + l];
      }
      p(c - m + i, c - m + j) = sum;
    }
    x[c + (c - m) + i] = to_next / static_cast<double>(second - first);
  }
  for (std::size_t i = 0; i < m; ++i) {
    const std::size_t at = c + (c - m) + i;
    p(at, at) = 1e4 * (2.0 * static_cast<double>(m) * largest * largest + noise);
  }

  std::array<double, kChannels * PhaseModel::kMaxClocks> h{};
  for (std::size_t i = 0; i < m; ++i) {
    for (std::size_t k = 0; k < c; ++k) h[i * c + k] = model_.mixing[i * c + k];
  }
  for (std::size_t k = first; k < epochs; ++k) {
    Pass::Epoch& now = pass.epochs[k];
    if (k > first) {
      for (std::size_t i = 0; i < c; ++i) x[i] += x[c + i];
      for (std::size_t i = 0; i < c; ++i) {  // rows, then columns
        for (std::size_t j = 0; j < n; ++j) p(i, j) += p(c + i, j);
      }
      for (std::size_t i = 0; i < n; ++i) {
        for (std::size_t j = 0; j < c; ++j) p(i, j) += p(i, c + j);
      }
      for (std::size_t i = 0; i < c; ++i) {
        p(i, i) += f[i] + g[i] / 3.0;
        p(i, c + i) += 0.5 * g[i];
        p(c + i, i) += 0.5 * g[i];
        p(c + i, c + i) += g[i];
      }
    }
    now.x = x;
    now.p = p;
    now.observed = k > first && whole(k);
    if (now.observed) {
      std::array<double, kChannels * kStates> hp{};  // H P
      for (std::size_t i = 0; i < m; ++i) {
        for (std::size_t l = 0; l < c; ++l) {
          for (std::size_t j = 0; j < n; ++j) hp[i * n + j] += h[i * c + l] * p(l, j);
        }
      }
      auto s = r;
      for (std::size_t i = 0; i < m; ++i) {
        for (std::size_t j = 0; j < m; ++j) {
          for (std::size_t l = 0; l < c; ++l) s[i * m + j] += hp[i * n + l] * h[j * c + l];
        }
      }
      if (!factorise(s, m)) {
        now.observed = false;
      } else {
        std::array<double, kChannels> e{};
        for (std::size_t i = 0; i < m; ++i) {
          e[i] = reading(k, i);
          for (std::size_t l = 0; l < c; ++l) e[i] -= h[i * c + l] * x[l];
        }
        std::array<double, kChannels* kStates> u = hp;  // L⁻¹ H P
        for (std::size_t i = 0; i < m; ++i) {
          now.w[i] = e[i];
          for (std::size_t l = 0; l < c; ++l) now.v[i * n + l] = h[i * c + l];
          for (std::size_t q = 0; q < i; ++q) {
            now.w[i] -= s[i * m + q] * now.w[q];
            for (std::size_t j = 0; j < n; ++j) {
              now.v[i * n + j] -= s[i * m + q] * now.v[q * n + j];
              u[i * n + j] -= s[i * m + q] * u[q * n + j];
            }
          }
          now.w[i] /= s[i * m + i];
          for (std::size_t j = 0; j < n; ++j) {
            now.v[i * n + j] /= s[i * m + i];
            u[i * n + j] /= s[i * m + i];
          }
        }
        for (std::size_t j = 0; j < n; ++j) {  // K = P Hᵀ L⁻ᵀ L⁻¹
          for (std::size_t i = m; i-- > 0;) {
            double sum = u[i * n + j];
            for (std::size_t q = i + 1; q < m; ++q) sum -= s[q * m + i] * now.gain[j * m + q];
            now.gain[j * m + i] = sum / s[i * m + i];
          }
        }
        for (std::size_t j = 0; j < n; ++j) {
          for (std::size_t i = 0; i < m; ++i) x[j] += now.gain[j * m + i] * e[i];
        }
        // Joseph: (I - K H) P (I - K H)ᵀ + K R Kᵀ.
        Block left = p;
        for (std::size_t j = 0; j < n; ++j) {
          for (std::size_t i = 0; i < m; ++i) {
            for (std::size_t l = 0; l < n; ++l) left(j, l) -= now.gain[j * m + i] * hp[i * n + l];
          }
        }
        std::array<double, kStates * kChannels> lh{};  // (I - K H) P Hᵀ - K R, then times Kᵀ
        for (std::size_t j = 0; j < n; ++j) {
          for (std::size_t i = 0; i < m; ++i) {
            for (std::size_t l = 0; l < c; ++l) lh[j * m + i] += left(j, l) * h[i * c + l];
            for (std::size_t q = 0; q < m; ++q) lh[j * m + i] -= now.gain[j * m + q] * r[q * m + i];
          }
        }
        for (std::size_t j = 0; j < n; ++j) {
          for (std::size_t l = 0; l < n; ++l) {
            for (std::size_t i = 0; i < m; ++i) left(j, l) -= lh[j * m + i] * now.gain[l * m + i];
          }
        }
        for (std::size_t j = 0; j < n; ++j) {
          for (std::size_t l = 0; l <= j; ++l) p(j, l) = p(l, j) = 0.5 * (left(j, l) + left(l, j));
        }
      }
    }
    for (std::size_t i = 0; i < c; ++i) {
      now.filtered[i] = x[i];
      now.variance[i] = p(i, i);
    }
  }
  return pass;
}

namespace {

// One step back: information about the state at an epoch in the phases from it on (doc/characterization.md eq. 17).
template <class Epoch>
void back(const Epoch& at, std::size_t m, std::size_t c,
          const std::array<double, kChannels * PhaseModel::kMaxClocks>& h, State& r, Block& information) {
  const std::size_t n = 2 * c;
  for (std::size_t i = 0; i < c; ++i) r[c + i] += r[i];
  for (std::size_t i = 0; i < c; ++i) {
    for (std::size_t j = 0; j < n; ++j) information(c + i, j) += information(i, j);
  }
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t j = 0; j < c; ++j) information(i, c + j) += information(i, j);
  }
  if (!at.observed) return;
  std::array<double, kChannels> kr{};
  for (std::size_t i = 0; i < m; ++i) {
    for (std::size_t j = 0; j < n; ++j) kr[i] += at.gain[j * m + i] * r[j];
  }
  for (std::size_t i = 0; i < m; ++i) {
    for (std::size_t l = 0; l < c; ++l) r[l] -= h[i * c + l] * kr[i];
    for (std::size_t j = 0; j < n; ++j) r[j] += at.v[i * n + j] * at.w[i];
  }
  // (I - K H)ᵀ N (I - K H) + V Vᵀ
  std::array<double, kStates * kChannels> nk{};
  for (std::size_t j = 0; j < n; ++j) {
    for (std::size_t i = 0; i < m; ++i) {
      for (std::size_t l = 0; l < n; ++l) nk[j * m + i] += information(j, l) * at.gain[l * m + i];
    }
  }
  std::array<double, kChannels * kChannels> knk{};
  for (std::size_t i = 0; i < m; ++i) {
    for (std::size_t q = 0; q < m; ++q) {
      for (std::size_t l = 0; l < n; ++l) knk[i * m + q] += at.gain[l * m + i] * nk[l * m + q];
    }
  }
  const auto seen = [&](std::size_t i, std::size_t j) { return j < c ? h[i * c + j] : 0.0; };
  Block next = information;
  for (std::size_t j = 0; j < n; ++j) {
    for (std::size_t l = 0; l < n; ++l) {
      double sum = 0.0;
      for (std::size_t i = 0; i < m; ++i) {
        sum += at.v[i * n + j] * at.v[i * n + l] - nk[j * m + i] * seen(i, l) - seen(i, j) * nk[l * m + i];
        for (std::size_t q = 0; q < m; ++q) sum += seen(i, j) * knk[i * m + q] * seen(q, l);
      }
      next(j, l) += sum;
    }
  }
  for (std::size_t j = 0; j < n; ++j) {
    for (std::size_t l = 0; l <= j; ++l) information(j, l) = information(l, j) = 0.5 * (next(j, l) + next(l, j));
  }
}

}  // namespace

ClockGroupRun ClockGroup::run(std::span<const double> phase_s) const {
  const std::size_t m = model_.channels;
  const std::size_t c = model_.clocks;
  const std::size_t n = 2 * c;
  if (phase_s.size() % m != 0) {
    throw std::invalid_argument("phase_s: " + std::to_string(phase_s.size()) + " numbers are no whole epochs of " +
                                std::to_string(m));
  }
  ClockGroupRun out;
  out.epochs = phase_s.size() / m;
  out.clocks = c;
  const Pass pass = forward(phase_s, out.epochs);
  for (auto* column : {&out.filtered_s, &out.filtered_sigma_s, &out.bias_s, &out.drift, &out.sigma_s}) {
    column->assign(out.epochs * c, std::numeric_limits<double>::quiet_NaN());
  }
  // The line that was taken from the channels belongs to the last clocks.
  std::array<double, PhaseModel::kMaxClocks> offset{};
  std::array<double, PhaseModel::kMaxClocks> slope{};
  for (std::size_t i = 0; i < m; ++i) {
    for (std::size_t j = 0; j < m; ++j) {
      offset[c - m + i] += start_[i * m + j] * pass.offset[j];
      slope[c - m + i] += start_[i * m + j] * pass.slope[j];
    }
  }
  std::array<double, kChannels * PhaseModel::kMaxClocks> h{};
  std::copy_n(model_.mixing.begin(), m * c, h.begin());
  State r{};
  Block information;
  for (std::size_t k = out.epochs; k-- > pass.first;) {
    const auto& at = pass.epochs[k];
    back(at, m, c, h, r, information);
    for (std::size_t i = 0; i < c; ++i) {
      double bias = at.x[i];
      double drift = at.x[c + i];
      double variance = at.p(i, i);
      for (std::size_t j = 0; j < n; ++j) {
        bias += at.p(i, j) * r[j];
        drift += at.p(c + i, j) * r[j];
        for (std::size_t l = 0; l < n; ++l) variance -= at.p(i, j) * information(j, l) * at.p(i, l);
      }
      const double line = offset[i] + slope[i] * static_cast<double>(k - pass.first);
      out.bias_s[k * c + i] = unit_s_ * bias + line;
      out.drift[k * c + i] = (unit_s_ * drift + slope[i]) / model_.dt_s;
      out.sigma_s[k * c + i] = unit_s_ * std::sqrt(std::max(variance, 0.0));
      out.filtered_s[k * c + i] = unit_s_ * at.filtered[i] + line;
      out.filtered_sigma_s[k * c + i] = unit_s_ * std::sqrt(std::max(at.variance[i], 0.0));
    }
  }
  return out;
}

std::vector<double> ClockGroup::error_allan_variance(std::size_t clock, std::span<const std::size_t> factors,
                                                     std::size_t epochs) const {
  const std::size_t m = model_.channels;
  const std::size_t c = model_.clocks;
  const std::size_t n = 2 * c;
  if (clock >= c) throw std::invalid_argument("clock = " + std::to_string(clock) + " of " + std::to_string(c));
  if (epochs < 3) throw std::invalid_argument("epochs = " + std::to_string(epochs) + ": at least 3 expected");
  std::size_t longest = 0;
  for (const std::size_t factor : factors) {
    if (factor == 0) throw std::invalid_argument("factors: 0 steps is no averaging time");
    if (factor >= (epochs + 1) / 2) {
      throw std::invalid_argument("factors: " + std::to_string(factor) +
                                  " steps need more than twice as many epochs, got " + std::to_string(epochs));
    }
    longest = std::max(longest, 2 * factor);
  }
  const std::vector<double> still(epochs * m, 0.0);
  const Pass pass = forward(still, epochs);
  std::array<double, kChannels * PhaseModel::kMaxClocks> h{};
  std::copy_n(model_.mixing.begin(), m * c, h.begin());
  State r{};
  Block information;
  std::vector<State> kept(epochs);  // N P of this clock's bias
  for (std::size_t k = epochs; k-- > 0;) {
    back(pass.epochs[k], m, c, h, r, information);
    for (std::size_t i = 0; i < n; ++i) {
      for (std::size_t j = 0; j < n; ++j) kept[k][i] += information(i, j) * pass.epochs[k].p(j, clock);
    }
  }
  // Cov(e_k, e_k+j) = P_k L_kᵀ ... L_k+j-1ᵀ (I - N_k+j P_k+j), one row of it (doc/characterization.md eq. 18).
  std::vector<std::vector<double>> covariance(longest + 1);
  for (const std::size_t factor : factors) {
    covariance[0].resize(epochs);
    covariance[factor].resize(epochs);
    covariance[2 * factor].resize(epochs);
  }
  for (std::size_t k = 0; k < epochs; ++k) {
    State a{};
    for (std::size_t j = 0; j < n; ++j) a[j] = pass.epochs[k].p(clock, j);
    for (std::size_t j = 0; j <= longest && k + j < epochs; ++j) {
      if (!covariance[j].empty()) {
        double sum = a[clock];
        for (std::size_t i = 0; i < n; ++i) sum -= a[i] * kept[k + j][i];
        covariance[j][k] = sum;
      }
      const auto& at = pass.epochs[k + j];
      if (at.observed) {
        std::array<double, kChannels> ha{};
        for (std::size_t i = 0; i < m; ++i) {
          for (std::size_t l = 0; l < c; ++l) ha[i] += h[i * c + l] * a[l];
        }
        for (std::size_t l = 0; l < n; ++l) {
          for (std::size_t i = 0; i < m; ++i) a[l] -= at.gain[l * m + i] * ha[i];
        }
      }
      for (std::size_t l = 0; l < c; ++l) a[l] += a[c + l];
    }
  }
  std::vector<double> out;
  for (const std::size_t factor : factors) {
    double sum = 0.0;
    const auto& c0 = covariance[0];
    const auto& c1 = covariance[factor];
    const auto& c2 = covariance[2 * factor];
    for (std::size_t k = 0; k + 2 * factor < epochs; ++k) {
      sum += c0[k] + 4.0 * c0[k + factor] + c0[k + 2 * factor] - 4.0 * (c1[k] + c1[k + factor]) + 2.0 * c2[k];
    }
    const double tau = static_cast<double>(factor) * model_.dt_s;
    out.push_back(unit_s_ * unit_s_ * sum / static_cast<double>(epochs - 2 * factor) / (2.0 * tau * tau));
  }
  return out;
}

namespace {

Oscillator from_increments(std::span<const double> bias, std::span<const double> drift, double dt_s) {
  double of_drift = 0.0;
  double of_bias = 0.0;
  for (std::size_t k = 0; k + 1 < bias.size(); ++k) {
    const double d = drift[k + 1] - drift[k];
    const double b = bias[k + 1] - bias[k] - dt_s * drift[k];
    of_drift += d * d;
    of_bias += b * b;
  }
  const auto n = static_cast<double>(bias.size() - 1);
  const double walk = of_drift / n / dt_s;
  const double white = of_bias / n / dt_s - walk * dt_s * dt_s / 3.0;
  return {.h0 = 2.0 * std::max(white, 0.0), .h_minus_2 = walk / (2.0 * kPi * kPi)};
}

// h0 / (2 tau) + (2 pi² / 3) h-2 tau to the overlapping Allan variance at octaves, errors relative, neither below 0.
Oscillator from_allan_fit(std::span<const double> bias, double dt_s) {
  double aa = 0.0;
  double ab = 0.0;
  double bb = 0.0;
  double ay = 0.0;
  double by = 0.0;
  for (std::size_t factor = 1; 4 * factor <= bias.size(); factor *= 2) {
    const double tau = static_cast<double>(factor) * dt_s;
    double sum = 0.0;
    for (std::size_t k = 0; k + 2 * factor < bias.size(); ++k) {
      const double d = bias[k + 2 * factor] - 2.0 * bias[k + factor] + bias[k];
      sum += d * d;
    }
    const double variance = sum / static_cast<double>(bias.size() - 2 * factor) / (2.0 * tau * tau);
    if (!(variance > 0.0)) continue;
    const double a = 0.5 / tau / variance;
    const double b = 2.0 * kPi * kPi / 3.0 * tau / variance;
    aa += a * a;
    ab += a * b;
    bb += b * b;
    ay += a;
    by += b;
  }
  const double det = aa * bb - ab * ab;
  if (!(det > 0.0)) return {};
  Oscillator out{.h0 = (ay * bb - by * ab) / det, .h_minus_2 = (by * aa - ay * ab) / det};
  if (out.h0 < 0.0) out = {.h0 = 0.0, .h_minus_2 = by / bb};
  if (out.h_minus_2 < 0.0) out = {.h0 = ay / aa, .h_minus_2 = 0.0};
  return out;
}

}  // namespace

std::vector<Oscillator> iterate_noise(std::span<const double> phase_s, const PhaseModel& model,
                                      std::span<const Oscillator> start, std::span<const std::size_t> estimated,
                                      NoiseAnalysis analysis, int iterations) {
  check_model(model);
  std::vector<Oscillator> now(start.begin(), start.end());
  std::vector<Oscillator> out = now;
  for (const std::size_t c : estimated) {
    if (c >= now.size()) {
      throw std::invalid_argument("estimated: clock " + std::to_string(c) + " of " + std::to_string(now.size()));
    }
  }
  std::size_t whole = 0;
  for (std::size_t k = 0; (k + 1) * model.channels <= phase_s.size(); ++k) {
    const auto epoch = phase_s.subspan(k * model.channels, model.channels);
    if (std::ranges::none_of(epoch, [](double z) { return std::isnan(z); })) ++whole;
  }
  if (whole < 8) {
    throw std::invalid_argument("phase_s: at least 8 whole epochs expected, got " + std::to_string(whole));
  }
  for (int i = 0; i < iterations; ++i) {
    const ClockGroupRun run = ClockGroup(model, now).run(phase_s);
    for (const std::size_t c : estimated) {
      std::vector<double> bias;
      std::vector<double> drift;
      for (std::size_t k = 0; k < run.epochs; ++k) {
        const double b = run.bias_s[k * run.clocks + c];
        if (!(b == b)) continue;
        bias.push_back(b);
        drift.push_back(run.drift[k * run.clocks + c]);
      }
      // A straight line is no noise, and small numbers keep their digits.
      const double first = bias.front();
      const double slope = (bias.back() - first) / (static_cast<double>(bias.size() - 1) * model.dt_s);
      for (std::size_t k = 0; k < bias.size(); ++k) {
        bias[k] -= first + slope * static_cast<double>(k) * model.dt_s;
        drift[k] -= slope;
      }
      const Oscillator found = analysis == NoiseAnalysis::kIncrements ? from_increments(bias, drift, model.dt_s)
                                                                      : from_allan_fit(bias, model.dt_s);
      now[c] = {.h0 = std::max(found.h0, 1e-12 * start[c].h0),
                .h_minus_2 = std::max(found.h_minus_2, 1e-12 * start[c].h_minus_2)};
    }
    out.insert(out.end(), now.begin(), now.end());
  }
  return out;
}

}  // namespace soopnav::clock
