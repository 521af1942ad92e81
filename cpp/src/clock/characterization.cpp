#include "soopnav/clock/characterization.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <span>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "soopnav/estimation/chi_square.hpp"

namespace soopnav::clock {
namespace {

constexpr double kPriorSigma = 6.907755278982137;  // ln 1000
constexpr std::size_t kNone = static_cast<std::size_t>(-1);

// Solves a symmetric positive definite system in place by Cholesky; false when it is not.
bool solve_spd(std::vector<double> a, std::vector<double>& x) {
  const std::size_t n = x.size();
  for (std::size_t j = 0; j < n; ++j) {
    for (std::size_t i = j; i < n; ++i) {
      double sum = a[i * n + j];
      for (std::size_t k = 0; k < j; ++k) sum -= a[i * n + k] * a[j * n + k];
      if (i == j) {
        if (!(sum > 0.0)) return false;
        a[j * n + j] = std::sqrt(sum);
      } else {
        a[i * n + j] = sum / a[j * n + j];
      }
    }
  }
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t k = 0; k < i; ++k) x[i] -= a[i * n + k] * x[k];
    x[i] /= a[i * n + i];
  }
  for (std::size_t i = n; i-- > 0;) {
    for (std::size_t k = i + 1; k < n; ++k) x[i] -= a[k * n + i] * x[k];
    x[i] /= a[i * n + i];
  }
  return true;
}

// Eigenvalues and vectors (rows of `v`) of a small symmetric matrix by Jacobi's rotations.
void eigen_of(std::vector<double> a, std::vector<double>& values, std::vector<double>& v) {
  const std::size_t n = values.size();
  v.assign(n * n, 0.0);
  for (std::size_t i = 0; i < n; ++i) v[i * n + i] = 1.0;
  for (int sweep = 0; sweep < 40; ++sweep) {
    for (std::size_t p = 0; p < n; ++p) {
      for (std::size_t q = p + 1; q < n; ++q) {
        const double apq = a[p * n + q];
        if (apq == 0.0) continue;
        const double theta = 0.5 * (a[q * n + q] - a[p * n + p]) / apq;
        const double t = (theta >= 0.0 ? 1.0 : -1.0) / (std::abs(theta) + std::hypot(theta, 1.0));
        const double c = 1.0 / std::hypot(t, 1.0);
        const double s = t * c;
        for (std::size_t k = 0; k < n; ++k) {
          const double kp = a[k * n + p];
          const double kq = a[k * n + q];
          a[k * n + p] = c * kp - s * kq;
          a[k * n + q] = s * kp + c * kq;
        }
        for (std::size_t k = 0; k < n; ++k) {
          const double pk = a[p * n + k];
          const double qk = a[q * n + k];
          a[p * n + k] = c * pk - s * qk;
          a[q * n + k] = s * pk + c * qk;
          const double vp = v[p * n + k];
          const double vq = v[q * n + k];
          v[p * n + k] = c * vp - s * vq;
          v[q * n + k] = s * vp + c * vq;
        }
      }
    }
  }
  for (std::size_t i = 0; i < n; ++i) values[i] = a[i * n + i];
}

struct Search {
  const PhaseLikelihood& likelihood;
  std::span<const std::size_t> estimated;
  const CharacterizationOptions& options;
  std::array<double, 4> bounds;  // ln of the least and greatest h0 and h-2

  Search(const PhaseLikelihood& of, std::span<const std::size_t> which, const CharacterizationOptions& with)
      : likelihood(of), estimated(which), options(with) {
    const auto range = of.range();
    bounds = {std::log(range[0].h0), std::log(range[1].h0), std::log(range[0].h_minus_2), std::log(range[1].h_minus_2)};
  }
  [[nodiscard]] double lower(std::size_t i) const { return bounds[i % 2 == 0 ? 0 : 2]; }
  [[nodiscard]] double upper(std::size_t i) const { return bounds[i % 2 == 0 ? 1 : 3]; }

  void put(const std::vector<double>& theta, std::vector<Oscillator>& clocks) const {
    for (std::size_t i = 0; i < theta.size(); i += 2) {
      Oscillator& clock = clocks[estimated[i / 2]];
      clock = {.h0 = std::exp(theta[i]), .h_minus_2 = std::exp(theta[i + 1])};
    }
  }

  // Fisher scoring; a step's length is damped until the likelihood rises, a parameter at its bound rests there, and so
  // does the one that is `held`.
  [[nodiscard]] NoiseMaximum from(std::vector<Oscillator> clocks, std::size_t held = kNone) const {
    const std::size_t n = 2 * estimated.size();
    std::vector<double> theta(n);
    for (std::size_t i = 0; i < n; ++i) {
      const Oscillator& clock = clocks[estimated[i / 2]];
      const double h = i % 2 == 0 ? clock.h0 : clock.h_minus_2;
      theta[i] = std::clamp(h > 0.0 ? std::log(h) : lower(i), lower(i), upper(i));
    }
    NoiseMaximum out;
    put(theta, clocks);
    PhaseScore now = likelihood.evaluate(clocks, estimated);
    double damping = 1e-3;
    for (; out.iterations < options.max_iterations && !out.converged; ++out.iterations) {
      std::vector<double> a(n * n, 0.0);
      std::vector<double> step(n, 0.0);
      const auto rests = [&](std::size_t i) {
        return i == held || (theta[i] <= lower(i) && now.score[i] < 0.0) ||
               (theta[i] >= upper(i) && now.score[i] > 0.0);
      };
      for (std::size_t i = 0; i < n; ++i) {
        step[i] = rests(i) ? 0.0 : now.score[i];
        for (std::size_t j = 0; j < n && !rests(i); ++j) {
          if (!rests(j)) a[i * n + j] = now.information[i * n + j];
        }
        a[i * n + i] += rests(i) ? 1.0 : damping * (now.information[i * n + i] + 1e-3);
      }
      const std::vector<double> gradient = step;
      if (!solve_spd(a, step)) {
        damping = std::max(10.0 * damping, 1e-3);
        continue;
      }
      double promised = 0.0;
      for (std::size_t i = 0; i < n; ++i) promised += gradient[i] * step[i];
      if (promised < 1e-6 && damping < 1.0) {
        out.converged = true;
        break;
      }
      std::vector<double> next = theta;
      for (std::size_t i = 0; i < n; ++i) {
        next[i] = std::clamp(theta[i] + std::clamp(step[i], -3.0, 3.0), lower(i), upper(i));
      }
      put(next, clocks);
      const double value = likelihood(clocks);
      if (value > now.log_likelihood) {
        theta = next;
        now = likelihood.evaluate(clocks, estimated);
        damping = std::max(0.2 * damping, 1e-9);
      } else {
        damping = std::max(8.0 * damping, 1e-4);
        if (damping > 1e9) out.converged = true;  // nothing rises any more: rounding
      }
    }
    put(theta, clocks);
    out.clocks = std::move(clocks);
    out.log_likelihood = now.log_likelihood;
    return out;
  }

  [[nodiscard]] bool same(const NoiseMaximum& a, const NoiseMaximum& b) const {
    for (const std::size_t c : estimated) {
      if (std::abs(std::log(a.clocks[c].h0 / b.clocks[c].h0)) > 0.5 ||
          std::abs(std::log(a.clocks[c].h_minus_2 / b.clocks[c].h_minus_2)) > 0.5) {
        return false;
      }
    }
    return true;
  }
};

// One start per split of a common noise among the estimated clocks: alike, and each by itself a hundred times the
// others.
std::vector<std::vector<Oscillator>> starts_of(const PhaseLikelihood& likelihood, std::vector<Oscillator> clocks,
                                               std::span<const std::size_t> estimated,
                                               const CharacterizationOptions& options) {
  const auto range = likelihood.range();
  const Oscillator middle{.h0 = std::sqrt(range[0].h0 * range[1].h0), .h_minus_2 = 0.0};
  for (const std::size_t c : estimated) clocks[c] = {middle.h0, 1e-2 * middle.h0};
  const Search search(likelihood, estimated, options);
  std::vector<std::vector<Oscillator>> out{search.from(clocks).clocks};
  if (estimated.size() == 1) return out;
  Oscillator total{};
  for (const std::size_t c : estimated) {
    total.h0 += out[0][c].h0;
    total.h_minus_2 += out[0][c].h_minus_2;
  }
  for (const std::size_t dominant : estimated) {
    auto split = clocks;
    for (const std::size_t c : estimated) {
      const double share = c == dominant ? 1.0 : 1e-2;
      split[c] = {.h0 = share * total.h0, .h_minus_2 = share * total.h_minus_2};
    }
    out.push_back(split);
  }
  return out;
}

}  // namespace

CharacterizationResult characterize(const PhaseLikelihood& likelihood, std::span<const Oscillator> clocks,
                                    std::span<const std::size_t> estimated, bool search,
                                    const CharacterizationOptions& options) {
  if (estimated.empty()) throw std::invalid_argument("estimated: at least one clock expected, the rest is known");
  for (std::size_t i = 0; i < estimated.size(); ++i) {
    for (std::size_t j = 0; j < i; ++j) {
      if (estimated[i] == estimated[j]) {
        throw std::invalid_argument("estimated: clock " + std::to_string(estimated[i]) + " is named twice");
      }
    }
  }
  const std::vector<Oscillator> given(clocks.begin(), clocks.end());
  static_cast<void>(likelihood.evaluate(given, estimated));  // refuses what does not fit
  const Search by(likelihood, estimated, options);
  std::vector<NoiseMaximum> maxima;
  for (const auto& start :
       search ? starts_of(likelihood, given, estimated, options) : std::vector<std::vector<Oscillator>>{given}) {
    maxima.push_back(by.from(start));
  }
  std::ranges::sort(maxima, [](const auto& a, const auto& b) { return a.log_likelihood > b.log_likelihood; });

  CharacterizationResult out;
  out.best = maxima.front();
  for (std::size_t i = 1; i < maxima.size(); ++i) {
    if (maxima[i].log_likelihood < out.best.log_likelihood - options.alternative_drop) continue;
    bool known = by.same(maxima[i], out.best);
    for (const auto& other : out.alternatives) known = known || by.same(maxima[i], other);
    if (!known) out.alternatives.push_back(maxima[i]);
  }
  const std::size_t n = 2 * estimated.size();
  const PhaseScore at = likelihood.evaluate(out.best.clocks, estimated);
  out.information = at.information;
  out.mean_nis = at.mean_nis;
  out.largest_nis = at.largest_nis;
  out.largest_at = at.largest_at;
  const double chance = 1e-6 / static_cast<double>(likelihood.innovations());
  out.jumped = at.largest_nis > chi_square_upper_quantile(chance, static_cast<double>(likelihood.model().channels));

  std::vector<double> values(n);
  std::vector<double> vectors;
  eigen_of(at.information, values, vectors);
  // Least known first; rounding may leave the information of what is not seen a little below zero.
  std::vector<std::size_t> order(n);
  for (std::size_t i = 0; i < n; ++i) order[i] = i;
  std::ranges::sort(order, [&](std::size_t a, std::size_t b) { return values[a] < values[b]; });
  out.ln_covariance.assign(n * n, 0.0);
  for (const std::size_t k : order) {
    const double variance = 1.0 / (std::max(values[k], 0.0) + 1.0 / (kPriorSigma * kPriorSigma));
    out.direction_sigma.push_back(std::sqrt(variance));
    for (std::size_t i = 0; i < n; ++i) {
      out.directions.push_back(vectors[k * n + i]);
      for (std::size_t j = 0; j < n; ++j)
        out.ln_covariance[i * n + j] += variance * vectors[k * n + i] * vectors[k * n + j];
    }
  }
  for (std::size_t i = 0; i < n; ++i) {
    bool known = std::sqrt(out.ln_covariance[i * n + i]) <= options.identifiable_sigma;
    // Several clocks: a likelihood is far from quadratic along the split of a sum. Two sigmas down it must have fallen
    // by two, whatever the others do.
    if (known && estimated.size() > 1) {
      auto less = out.best.clocks;
      double& h = i % 2 == 0 ? less[estimated[i / 2]].h0 : less[estimated[i / 2]].h_minus_2;
      h *= std::exp(-2.0 * options.identifiable_sigma);
      known = by.from(less, i).log_likelihood < out.best.log_likelihood - 2.0;
    }
    out.identifiable.push_back(known);
  }
  return out;
}

}  // namespace soopnav::clock
