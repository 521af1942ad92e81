#include "soopnav/clock/clock_fit.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Core>
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

// Phases in units of their second differences and time in units of the step, so that all numbers are near one.
struct Record {
  std::vector<double> phase;
  std::size_t first = 0;  // the two that the filter starts from
  std::size_t second = 0;
  std::size_t innovations = 0;
};

// White frequency, random walk of frequency and white phase noise, in the record's units.
struct Densities {
  double f = 0.0;
  double g = 0.0;
  double r = 0.0;
};

struct Likelihood {
  double squares = 0.0;  // sum of e² / s
  double log_det = 0.0;  // sum of log s
  std::size_t count = 0;

  // At the factor on all densities that suits best.
  [[nodiscard]] double factor() const { return squares / static_cast<double>(count); }
  [[nodiscard]] double profile() const {
    return -0.5 * (log_det + static_cast<double>(count) * (std::log(factor()) + 1.0));
  }
  [[nodiscard]] double at(double log_factor) const {
    return -0.5 * (log_det + static_cast<double>(count) * log_factor + squares * std::exp(-log_factor));
  }
};

// doc/clocks.md eqs. 13 to 15: the filter starts exactly, from the first two phases, and predicts across gaps.
Likelihood filter(const Record& record, const Densities& q) {
  Likelihood out;
  const auto& z = record.phase;
  const auto apart = static_cast<double>(record.second - record.first);
  double b = z[record.second];
  double d = (b - z[record.first]) / apart;
  double p00 = q.r;
  double p01 = q.r / apart;
  double p11 = q.f / apart + q.g * apart / 3.0 + 2.0 * q.r / (apart * apart);
  double product = 1.0;  // of the innovations' variances, whose logarithm is taken now and then
  double gain0 = 0.0;
  double gain1 = 0.0;
  double s = 1.0;
  bool settled = false;
  std::size_t steps = 0;
  for (std::size_t i = record.second + 1; i < z.size(); ++i) {
    ++steps;
    if (!(z[i] == z[i])) {
      settled = false;
      continue;
    }
    const auto dt = static_cast<double>(steps);
    b += dt * d;
    if (!settled || steps != 1) {
      const double before0 = gain0;
      const double before1 = gain1;
      const double a00 = p00 + dt * (2.0 * p01 + dt * p11) + q.f * dt + q.g * dt * dt * dt / 3.0;
      const double a01 = p01 + dt * p11 + 0.5 * q.g * dt * dt;
      const double a11 = p11 + q.g * dt;
      s = a00 + q.r;
      gain0 = a00 / s;
      gain1 = a01 / s;
      p00 = gain0 * q.r;
      p01 = gain1 * q.r;
      p11 = a11 - gain1 * a01;
      settled = steps == 1 && std::abs(gain0 - before0) <= 1e-14 * gain0 && std::abs(gain1 - before1) <= 1e-14 * gain1;
    }
    const double e = z[i] - b;
    b += gain0 * e;
    d += gain1 * e;
    out.squares += e * e / s;
    product *= s;
    if (product > 1e200 || product < 1e-200) {
      out.log_det += std::log(product);
      product = 1.0;
    }
    ++out.count;
    steps = 0;
  }
  out.log_det += std::log(product);
  return out;
}

Record make_record(std::span<const double> phase_s, double& unit) {
  Record record;
  std::vector<std::size_t> there;
  for (std::size_t i = 0; i < phase_s.size(); ++i) {
    if (std::isinf(phase_s[i])) {
      throw std::invalid_argument("phase_s[" + std::to_string(i) +
                                  "] is infinite: finite numbers expected, NaN for a gap");
    }
    if (phase_s[i] == phase_s[i]) there.push_back(i);
  }
  if (there.size() < 8) {
    throw std::invalid_argument("phase_s: at least 8 phases expected, got " + std::to_string(there.size()));
  }
  record.first = there[0];
  record.second = there[1];
  record.innovations = there.size() - 2;
  // Bends from one phase to the one after next, whatever lies between.
  double squares = 0.0;
  for (std::size_t k = 2; k < there.size(); ++k) {
    const auto before = static_cast<double>(there[k - 1] - there[k - 2]);
    const auto after = static_cast<double>(there[k] - there[k - 1]);
    const double bend =
        (phase_s[there[k]] - phase_s[there[k - 1]]) / after - (phase_s[there[k - 1]] - phase_s[there[k - 2]]) / before;
    squares += bend * bend;
  }
  unit = std::sqrt(squares / static_cast<double>(record.innovations));
  if (!(unit > 0.0)) throw std::invalid_argument("phase_s: on a straight line, no noise to fit");
  // From a line through both ends, which the model does not see, so that the numbers are small.
  const double origin = phase_s[there.front()];
  const double slope = (phase_s[there.back()] - origin) / static_cast<double>(there.back() - there.front());
  record.phase.resize(phase_s.size());
  for (std::size_t i = 0; i < phase_s.size(); ++i) {
    record.phase[i] = ((phase_s[i] - origin) - slope * static_cast<double>(i - there.front())) / unit;
  }
  return record;
}

// Largest value of a function of one peak between two ends, by golden sections.
template <class Function>
double maximise(double low, double high, double tolerance, const Function& value) {
  constexpr double kGolden = 0.6180339887498949;
  double a = high - kGolden * (high - low);
  double b = low + kGolden * (high - low);
  double at_a = value(a);
  double at_b = value(b);
  while (high - low > tolerance) {
    if (at_a > at_b) {
      high = b;
      b = a;
      at_b = at_a;
      a = high - kGolden * (high - low);
      at_a = value(a);
    } else {
      low = a;
      a = b;
      at_a = at_b;
      b = low + kGolden * (high - low);
      at_b = value(b);
    }
  }
  return 0.5 * (low + high);
}

template <class Function>
double maximise_on_grid(double low, double high, double step, double tolerance, const Function& value) {
  double best = low;
  double most = -std::numeric_limits<double>::infinity();
  for (double at = low; at <= high + 1e-9; at += step) {
    const double here = value(at);
    if (here > most) {
      most = here;
      best = at;
    }
  }
  return maximise(std::max(low, best - step), std::min(high, best + step), tolerance, value);
}

constexpr double kNever = -1e9;  // log of a density that is nothing

double density(double log_value) { return log_value == kNever ? 0.0 : std::exp(log_value); }

Densities densities(const std::array<double, 3>& log) { return {density(log[0]), density(log[1]), density(log[2])}; }

// Where, from a peak and away from it, the profile has fallen by a half: as logarithm of the ratio.
template <class Function>
double fallen_by_half(double from, double towards, double top, const Function& value) {
  double low = from;
  double high = towards;
  for (int i = 0; i < 40; ++i) {
    const double middle = 0.5 * (low + high);
    (value(middle) > top - 0.5 ? low : high) = middle;
  }
  return 0.5 * (low + high);
}

// Standard deviations of the logarithms of those densities that are not nothing.
struct Spread {
  std::array<double, 3> sigma{};
  double correlation = 0.0;  // of the first two
};

Spread spread(const Record& record, const std::array<double, 3>& log) {
  std::array<std::size_t, 3> active{};
  Eigen::Index n = 0;
  for (std::size_t i = 0; i < 3; ++i) {
    if (log[i] != kNever) active[static_cast<std::size_t>(n++)] = i;
  }
  const double h = 0.02;
  const auto value = [&](std::size_t i, double si, std::size_t j, double sj) {
    auto moved = log;
    moved[i] += si * h;
    moved[j] += sj * h;
    return filter(record, densities(moved)).at(0.0);
  };
  const double centre = filter(record, densities(log)).at(0.0);
  Eigen::Matrix3d information = Eigen::Matrix3d::Identity();
  for (Eigen::Index r = 0; r < n; ++r) {
    const std::size_t i = active[static_cast<std::size_t>(r)];
    information(r, r) = -(value(i, 1.0, i, 0.0) - 2.0 * centre + value(i, -1.0, i, 0.0)) / (h * h);
    for (Eigen::Index c = 0; c < r; ++c) {
      const std::size_t j = active[static_cast<std::size_t>(c)];
      const double mixed =
          (value(i, 1.0, j, 1.0) - value(i, 1.0, j, -1.0) - value(i, -1.0, j, 1.0) + value(i, -1.0, j, -1.0)) /
          (4.0 * h * h);
      information(r, c) = information(c, r) = -mixed;
    }
  }
  // Rows that are not there are those of the identity.
  const Eigen::Matrix3d P = information.ldlt().solve(Eigen::Matrix3d::Identity());
  Spread out;
  for (Eigen::Index r = 0; r < n; ++r) {
    out.sigma[active[static_cast<std::size_t>(r)]] =
        P(r, r) > 0.0 ? std::sqrt(P(r, r)) : std::numeric_limits<double>::infinity();
  }
  if (n >= 2 && active[0] == 0 && active[1] == 1 && P(0, 0) > 0.0 && P(1, 1) > 0.0) {
    out.correlation = P(0, 1) / std::sqrt(P(0, 0) * P(1, 1));
  }
  return out;
}

}  // namespace

ClockFit fit_clock(std::span<const double> phase_s, double dt_s, const ClockFitOptions& options) {
  if (!(dt_s > 0.0) || std::isinf(dt_s)) {
    throw std::invalid_argument("dt_s = " + std::to_string(dt_s) + " must be positive and finite");
  }
  double unit = 1.0;
  const Record record = make_record(phase_s, unit);
  const double reach = 2.0 * std::log(static_cast<double>(phase_s.size()));
  const double low = -reach - 4.0;  // log(S_g dt² / S_f): a random walk that even the whole record hides
  const double high = 14.0;         // white noise that even one step hides
  const auto with = [](double log_ratio, double log_phase) {
    return std::array<double, 3>{-0.5 * log_ratio, 0.5 * log_ratio, log_phase};
  };
  const auto likelihood = [&](double log_ratio, double log_phase) {
    return filter(record, densities(with(log_ratio, log_phase))).profile();
  };
  // Phase noise against the frequency noise that a step near it would have; nothing when not asked for.
  double log_phase = kNever;
  double ratio = 0.0;
  if (options.phase_noise) {
    const auto best_phase = [&](double at, double tolerance) {
      return maximise_on_grid(-12.0 - 0.5 * std::abs(at), 12.0 + 0.5 * std::abs(at), 4.0, tolerance,
                              [&](double r) { return likelihood(at, r); });
    };
    const double limit = std::max(low, -24.0);
    ratio = maximise_on_grid(limit, high, 4.0, 0.05, [&](double at) { return likelihood(at, best_phase(at, 0.2)); });
    for (int i = 0; i < 6; ++i) {
      log_phase = best_phase(ratio, 1e-4);
      ratio = maximise(std::max(limit, ratio - 1.0), std::min(high, ratio + 1.0), 1e-4,
                       [&](double at) { return likelihood(at, log_phase); });
    }
  } else {
    ratio = maximise_on_grid(low, high, 2.0, 1e-5, [&](double at) { return likelihood(at, kNever); });
  }
  const double top = likelihood(ratio, log_phase);
  // Where one frequency noise is changed the phase noise stays in its ratio to the other.
  const auto of_walk = [&](double at) {
    return likelihood(at, log_phase == kNever ? kNever : log_phase - 0.5 * (at - ratio));
  };
  const auto of_white = [&](double at) {
    return likelihood(at, log_phase == kNever ? kNever : log_phase + 0.5 * (at - ratio));
  };
  auto log = with(ratio, log_phase);
  const bool walk_seen = of_walk(low) < top - 0.5;
  const bool white_seen = of_white(high) < top - 0.5;
  if (!walk_seen) log = {0.0, kNever, log_phase == kNever ? kNever : log_phase + 0.5 * ratio};
  if (walk_seen && !white_seen) log = {kNever, 0.0, log_phase == kNever ? kNever : log_phase - 0.5 * ratio};
  const Likelihood best = filter(record, densities(log));
  const double factor = std::log(best.factor());
  for (double& value : log) value += value == kNever ? 0.0 : factor;

  // Back to seconds: S_f in unit² / dt, S_g in unit² / dt³, halved and divided as in doc/clocks.md eq. 2.
  const double of_f = 2.0 * unit * unit / dt_s;
  const double of_g = unit * unit / (2.0 * kPi * kPi * dt_s * dt_s * dt_s);
  const Spread errors = spread(record, log);
  ClockFit out;
  out.clock.h0 = of_f * density(log[0]);
  out.clock.h_minus_2 = of_g * density(log[1]);
  out.sigma_h0 = out.clock.h0 * errors.sigma[0];
  out.sigma_h_minus_2 = out.clock.h_minus_2 * errors.sigma[1];
  out.phase_noise_s = unit * std::sqrt(density(log[2]));
  out.correlation = walk_seen && white_seen ? errors.correlation : 0.0;
  out.log_likelihood = best.profile() - static_cast<double>(best.count) * (std::log(unit) + 0.5 * std::log(kTwoPi));
  if (!walk_seen) {
    const double up_to = fallen_by_half(ratio, high, top, of_walk);
    out.sigma_h_minus_2 = of_g * density(log[0]) * std::exp(up_to);
  } else if (!white_seen) {
    const double down_to = fallen_by_half(ratio, low, top, of_white);
    out.sigma_h0 = of_f * density(log[1]) * std::exp(-down_to);
  }
  return out;
}

}  // namespace soopnav::clock
