#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <limits>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "channel_filter.hpp"
#include "soopnav/clock/characterization.hpp"
#include "soopnav/core/constants.hpp"

namespace soopnav::clock {
namespace {

using detail::ChannelCovariance;
using detail::ChannelNoise;
using detail::ChannelState;
using detail::ChannelUpdate;
using detail::Square;

// In units of the step and of a phase: S_f = h0 / 2, S_g = 2 pi² h-2 (doc/clocks.md eq. 2).
double white_of(double h0, double dt_s, double unit_s) { return 0.5 * h0 * dt_s / (unit_s * unit_s); }
double walk_of(double h_minus_2, double dt_s, double unit_s) {
  return 2.0 * kPi * kPi * h_minus_2 * dt_s * dt_s * dt_s / (unit_s * unit_s);
}

// What one clock's unit density adds to the channels': a aᵀ.
template <std::size_t M>
Square<M> outer(const PhaseModel& model, std::size_t clock) {
  Square<M> out;
  for (std::size_t i = 0; i < M; ++i) {
    for (std::size_t j = 0; j < M; ++j) {
      out(i, j) = model.mixing[i * model.clocks + clock] * model.mixing[j * model.clocks + clock];
    }
  }
  return out;
}

template <std::size_t M>
ChannelNoise<M> noise_of(const PhaseModel& model, std::span<const Oscillator> clocks, double unit_s) {
  ChannelNoise<M> out;
  for (std::size_t c = 0; c < model.clocks; ++c) {
    const Square<M> a = outer<M>(model, c);
    out.f.add(a, white_of(clocks[c].h0, model.dt_s, unit_s));
    out.g.add(a, walk_of(clocks[c].h_minus_2, model.dt_s, unit_s));
  }
  for (std::size_t i = 0; i < M * M; ++i) out.r.a[i] = model.covariance_s2[i] / (unit_s * unit_s);
  return out;
}

// Derivatives of the filter by one parameter.
template <std::size_t M>
struct Sensitivity {
  Square<M> f, g;
  ChannelCovariance<M> p;
  Square<M> s, to_bias, to_drift;
  ChannelState<M> x;

  // doc/characterization.md eqs. 8 and 9.
  void update(const ChannelUpdate<M>& gain, const Square<M>& r) {
    s = p.bb;
    Square<M> rest = p.bb;
    to_bias = gain.factor.right_solve(rest.add(gain.to_bias * s, -1.0));
    rest = p.bd.transposed();
    to_drift = gain.factor.right_solve(rest.add(gain.to_drift * s, -1.0));
    p.bb = (to_bias * r).symmetric();
    p.bd = (to_drift * r).transposed();
    const Square<M> half = to_drift * gain.s * gain.to_drift.transposed();
    p.dd.add(half, -1.0).add(half.transposed(), -1.0).add(gain.to_drift * s * gain.to_drift.transposed(), -1.0);
    p.dd = p.dd.symmetric();
  }
};

// E of the product of two parameters' state sensitivities (doc/characterization.md eq. 11).
template <std::size_t M>
struct SensitivityMoment {
  Square<M> bb, bd, db, dd;

  void predict(double t) noexcept {
    bb.add(bd, t).add(db, t).add(dd, t * t);
    bd.add(dd, t);
    db.add(dd, t);
  }
  void update(const ChannelUpdate<M>& gain, const Sensitivity<M>& i, const Sensitivity<M>& j) noexcept {
    // x+ = (I - K H) x + dK e: the bias part B = I - Kb, the drift part takes -Kd of the bias.
    Square<M> b;
    for (std::size_t k = 0; k < M; ++k) b(k, k) = 1.0;
    b.add(gain.to_bias, -1.0);
    const Square<M> bt = b.transposed();
    const Square<M> kt = gain.to_drift.transposed();
    Square<M> next_dd = dd;
    next_dd.add(gain.to_drift * bd, -1.0).add(db * kt, -1.0).add(gain.to_drift * bb * kt);
    Square<M> next_bd = b * bd;
    next_bd.add(b * bb * kt, -1.0);
    Square<M> next_db = db * bt;
    next_db.add(gain.to_drift * bb * bt, -1.0);
    bb = b * bb * bt;
    bb.add(i.to_bias * gain.s * j.to_bias.transposed());
    bd = next_bd.add(i.to_bias * gain.s * j.to_drift.transposed());
    db = next_db.add(i.to_drift * gain.s * j.to_bias.transposed());
    dd = next_dd.add(i.to_drift * gain.s * j.to_drift.transposed());
  }
};

std::string number(double value) {
  std::array<char, 32> text{};
  static_cast<void>(std::snprintf(text.data(), text.size(), "%g", value));
  return text.data();
}

void check_sizes(const PhaseModel& model) {
  if (model.channels < 1 || model.channels > PhaseModel::kMaxChannels) {
    throw std::invalid_argument("channels = " + std::to_string(model.channels) + ": 1 ... " +
                                std::to_string(PhaseModel::kMaxChannels) + " expected");
  }
  if (model.clocks < 1 || model.clocks > PhaseModel::kMaxClocks) {
    throw std::invalid_argument("clocks = " + std::to_string(model.clocks) + ": 1 ... " +
                                std::to_string(PhaseModel::kMaxClocks) + " expected");
  }
  if (!(model.dt_s >= 1e-12 && model.dt_s <= 1e12)) {
    throw std::invalid_argument("dt_s = " + number(model.dt_s) + ": 1e-12 ... 1e12 s expected");
  }
  const std::size_t m = model.channels;
  for (std::size_t i = 0; i < m; ++i) {
    double seen = 0.0;
    for (std::size_t c = 0; c < model.clocks; ++c) {
      const double a = model.mixing[i * model.clocks + c];
      if (!std::isfinite(a)) throw std::invalid_argument("mixing must be finite");
      seen += std::abs(a);
    }
    if (seen == 0.0) throw std::invalid_argument("mixing: channel " + std::to_string(i) + " sees no clock");
    for (std::size_t j = 0; j < i; ++j) {
      if (!(model.covariance_s2[i * m + j] == model.covariance_s2[j * m + i])) {
        throw std::invalid_argument("phase noise: its covariance must be symmetric");
      }
    }
  }
}

template <std::size_t M>
bool positive_definite(const PhaseModel& model) {
  Square<M> r;
  double largest = 0.0;
  for (std::size_t i = 0; i < M * M; ++i) {
    r.a[i] = model.covariance_s2[i];
    largest = std::max(largest, std::abs(r.a[i]));
  }
  return std::isfinite(largest) && largest > 0.0 && detail::Factor<M>(r.scaled(1.0 / largest)).positive;
}

bool noise_positive(const PhaseModel& model) {
  switch (model.channels) {
    case 1:
      return positive_definite<1>(model);
    case 2:
      return positive_definite<2>(model);
    default:
      return positive_definite<3>(model);
  }
}

}  // namespace

void check_model(const PhaseModel& model) {
  check_sizes(model);
  if (!noise_positive(model)) {
    throw std::invalid_argument(
        "phase noise: positive standard deviations, a positive definite covariance, expected; white noise of a phase "
        "is known from C/N0 and is never zero");
  }
  for (std::size_t i = 0; i < model.channels; ++i) {
    const double variance = model.covariance_s2[i * model.channels + i];
    if (!(variance >= 1e-80 && variance <= 1e40)) {
      throw std::invalid_argument("phase noise: variance " + number(variance) + " s² of record " + std::to_string(i) +
                                  ": 1e-80 ... 1e40 expected");
    }
  }
}

void check_phase(double phase_s, std::size_t epoch, double unit_s) {
  if (std::isinf(phase_s)) {
    throw std::invalid_argument("phase_s[" + std::to_string(epoch) +
                                "] is infinite: finite numbers expected, NaN for a gap");
  }
  if (std::abs(phase_s) / unit_s >= kLargestPhase) {
    throw std::invalid_argument("phase_s[" + std::to_string(epoch) + "] = " + number(phase_s) + ": less than " +
                                number(kLargestPhase) + " times the phases' noise (" + number(unit_s) + " s) expected");
  }
}

PhaseLikelihood::PhaseLikelihood(std::span<const double> phase_s, const PhaseModel& model) : model_(model) {
  check_model(model);
  const std::size_t m = model.channels;
  if (phase_s.size() % m != 0) {
    throw std::invalid_argument("phase_s: " + std::to_string(phase_s.size()) + " numbers are no whole epochs of " +
                                std::to_string(m));
  }
  epochs_ = phase_s.size() / m;
  double trace = 0.0;
  for (std::size_t i = 0; i < m; ++i) trace += model.covariance_s2[i * m + i];
  unit_s_ = std::sqrt(trace / static_cast<double>(m));
  phase_.assign(phase_s.begin(), phase_s.end());
  std::vector<std::size_t> whole;
  whole.reserve(epochs_);
  for (std::size_t k = 0; k < epochs_; ++k) {
    bool there = true;
    for (std::size_t i = 0; i < m; ++i) {
      const double z = phase_[k * m + i];
      check_phase(z, k, unit_s_);
      there = there && z == z;
    }
    if (there) {
      whole.push_back(k);
    } else {
      std::fill_n(phase_.begin() + static_cast<std::ptrdiff_t>(k * m), m, std::numeric_limits<double>::quiet_NaN());
    }
  }
  if (whole.size() < 8) {
    throw std::invalid_argument("phase_s: at least 8 whole epochs expected, got " + std::to_string(whole.size()));
  }
  skipped_ = epochs_ - whole.size();
  first_ = {whole[0], whole[1]};
  // A straight line per channel changes nothing but the numbers' size: the constant and the drift are free.
  const auto span = static_cast<double>(whole.back() - whole.front());
  double bend = 0.0;
  std::size_t bends = 0;
  for (std::size_t i = 0; i < m; ++i) {
    const double start = phase_[whole.front() * m + i];
    const double slope = (phase_[whole.back() * m + i] - start) / span;
    for (const std::size_t k : whole) {
      phase_[k * m + i] = (phase_[k * m + i] - start - slope * static_cast<double>(k - whole.front())) / unit_s_;
    }
    for (std::size_t k = 0; k + 2 < whole.size(); ++k) {
      const auto t1 = static_cast<double>(whole[k + 1] - whole[k]);
      const auto t2 = static_cast<double>(whole[k + 2] - whole[k + 1]);
      const double d = (phase_[whole[k + 2] * m + i] - phase_[whole[k + 1] * m + i]) / t2 -
                       (phase_[whole[k + 1] * m + i] - phase_[whole[k] * m + i]) / t1;
      bend += d * d;
      ++bends;
    }
  }
  bend = bend / static_cast<double>(bends) + 1.0;
  const double of_white = 2.0 * unit_s_ * unit_s_ / model.dt_s;
  const double of_walk = unit_s_ * unit_s_ / (2.0 * kPi * kPi * model.dt_s * model.dt_s * model.dt_s);
  const auto n = static_cast<double>(epochs_);
  low_ = {.h0 = of_white * 1e-2 / n, .h_minus_2 = of_walk * 1e-2 / (n * n * n)};
  high_ = {.h0 = of_white * 1e3 * bend, .h_minus_2 = of_walk * 1e3 * bend};
}

double PhaseLikelihood::operator()(std::span<const Oscillator> clocks) const {
  return dispatch(clocks, {}, false).log_likelihood;
}

PhaseScore PhaseLikelihood::evaluate(std::span<const Oscillator> clocks, std::span<const std::size_t> estimated) const {
  return dispatch(clocks, estimated, true);
}

PhaseScore PhaseLikelihood::dispatch(std::span<const Oscillator> clocks, std::span<const std::size_t> estimated,
                                     bool derivatives) const {
  if (clocks.size() != model_.clocks) {
    throw std::invalid_argument("clocks: " + std::to_string(model_.clocks) + " expected, got " +
                                std::to_string(clocks.size()));
  }
  for (const Oscillator& clock : clocks) static_cast<void>(clock.noise());  // throws for what is no clock
  for (const std::size_t c : estimated) {
    if (c >= model_.clocks) {
      throw std::invalid_argument("estimated: clock " + std::to_string(c) + " of " + std::to_string(model_.clocks));
    }
  }
  switch (model_.channels) {
    case 1:
      return run<1>(clocks, estimated, derivatives);
    case 2:
      return run<2>(clocks, estimated, derivatives);
    default:
      return run<3>(clocks, estimated, derivatives);
  }
}

template <std::size_t M>
PhaseScore PhaseLikelihood::run(std::span<const Oscillator> clocks, std::span<const std::size_t> estimated,
                                bool derivatives) const {
  constexpr double kSettled = 1e-13;
  const ChannelNoise<M> q = noise_of<M>(model_, clocks, unit_s_);
  const std::size_t count = derivatives ? 2 * estimated.size() : 0;
  PhaseScore out;
  out.score.assign(count, 0.0);
  out.information.assign(count * count, 0.0);

  std::vector<Sensitivity<M>> by(count);
  std::vector<SensitivityMoment<M>> moments(count * (count + 1) / 2);
  const auto apart = static_cast<double>(first_[1] - first_[0]);
  for (std::size_t k = 0; k < count; ++k) {
    const std::size_t clock = estimated[k / 2];
    const Square<M> a = outer<M>(model_, clock);
    if (k % 2 == 0) {
      by[k].f = a.scaled(white_of(clocks[clock].h0, model_.dt_s, unit_s_));
    } else {
      by[k].g = a.scaled(walk_of(clocks[clock].h_minus_2, model_.dt_s, unit_s_));
    }
    by[k].p = detail::channel_start<M>(by[k].f, by[k].g, Square<M>{}, apart);
  }

  ChannelCovariance<M> p = detail::channel_start<M>(q.f, q.g, q.r, apart);
  ChannelState<M> x;
  for (std::size_t i = 0; i < M; ++i) {
    x.bias[i] = phase_[first_[1] * M + i];
    x.drift[i] = (x.bias[i] - phase_[first_[0] * M + i]) / apart;
  }
  ChannelUpdate<M> gain;
  bool settled = false;
  double squares = 0.0;
  double log_det = 0.0;
  double product = 1.0;
  std::size_t steps = 0;
  for (std::size_t k = first_[1] + 1; k < epochs_; ++k) {
    ++steps;
    if (!(phase_[k * M] == phase_[k * M])) {
      settled = false;
      continue;
    }
    const auto t = static_cast<double>(steps);
    x.predict(t);
    for (auto& d : by) d.x.predict(t);
    for (auto& c : moments) c.predict(t);
    if (!settled) {
      const Square<M> before_bias = gain.to_bias;
      const Square<M> before_drift = gain.to_drift;
      p.predict(q.f, q.g, t);
      gain.apply(p, q.r);
      if (!gain.factor.positive) {
        out.log_likelihood = -std::numeric_limits<double>::infinity();
        return out;
      }
      double change = std::max(detail::relative_change(gain.to_bias, before_bias),
                               detail::relative_change(gain.to_drift, before_drift));
      for (auto& d : by) {
        const Square<M> was_bias = d.to_bias;
        const Square<M> was_drift = d.to_drift;
        d.p.predict(d.f, d.g, t);
        d.update(gain, q.r);
        change = std::max(
            {change, detail::relative_change(d.to_bias, was_bias), detail::relative_change(d.to_drift, was_drift)});
      }
      settled = steps == 1 && change <= kSettled;
    }
    std::array<double, M> e{};
    for (std::size_t i = 0; i < M; ++i) e[i] = phase_[k * M + i] - x.bias[i];
    const auto w = gain.factor.solve(e);
    const double nis = detail::dot(e, w);
    squares += nis;
    if (nis > out.largest_nis) {
      out.largest_nis = nis;
      out.largest_at = k;
    }
    product *= gain.factor.determinant;
    if (product > 1e200 || product < 1e-200) {
      log_det += std::log(product);
      product = 1.0;
    }
    for (std::size_t i = 0, pair = 0; i < count; ++i) {
      // doc/characterization.md eq. 10; the sensitivity of e is minus that of the predicted bias.
      const auto ds_w = by[i].s.of(w);
      out.score[i] += detail::dot(by[i].x.bias, w) + 0.5 * detail::dot(w, ds_w);
      const Square<M> own = gain.factor.right_solve(by[i].s);
      for (std::size_t j = 0; j < M; ++j) out.score[i] -= 0.5 * own(j, j);
      for (std::size_t j = 0; j <= i; ++j, ++pair) {
        const Square<M> other = gain.factor.right_solve(by[j].s);
        const Square<M> mean = gain.factor.right_solve(moments[pair].bb);
        double sum = 0.5 * detail::trace_of_product(own, other);
        for (std::size_t l = 0; l < M; ++l) sum += mean(l, l);
        out.information[i * count + j] += sum;
        moments[pair].update(gain, by[i], by[j]);
      }
    }
    for (auto& d : by) {
      std::array<double, M> minus{};
      for (std::size_t i = 0; i < M; ++i) minus[i] = -d.x.bias[i];
      d.x.update(gain.to_bias, gain.to_drift, minus);
      d.x.update(d.to_bias, d.to_drift, e);
    }
    x.update(gain.to_bias, gain.to_drift, e);
    steps = 0;
  }
  log_det += std::log(product);
  for (std::size_t i = 0; i < count; ++i) {
    for (std::size_t j = 0; j < i; ++j) out.information[j * count + i] = out.information[i * count + j];
  }
  const auto numbers = static_cast<double>(M * innovations());
  out.mean_nis = squares / numbers;
  out.log_likelihood = -0.5 * (log_det + squares) - numbers * (std::log(unit_s_) + 0.5 * std::log(kTwoPi));
  return out;
}

}  // namespace soopnav::clock
