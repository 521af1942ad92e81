#include "soopnav/clock/noise_bank.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "channel_filter.hpp"
#include "soopnav/core/constants.hpp"

namespace soopnav::clock {

struct NoiseBank::Filters {
  PhaseModel model;
  double unit_s = 1.0;
  std::size_t count = 0;
  std::size_t whole = 0;
  std::size_t steps = 0;
  std::array<double, PhaseModel::kMaxChannels> first{};
  std::vector<double> weights, log_prior, log_likelihood;

  Filters() = default;
  Filters(const Filters&) = delete;
  Filters& operator=(const Filters&) = delete;
  virtual ~Filters() = default;
  virtual void start(const double* z, double apart) noexcept = 0;
  virtual void step(const double* z, double t) noexcept = 0;

  void weigh() noexcept {
    double most = -std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < count; ++i) most = std::max(most, log_prior[i] + log_likelihood[i]);
    if (!std::isfinite(most)) return;  // no candidate is left: the weights stay
    double sum = 0.0;
    for (std::size_t i = 0; i < count; ++i) sum += weights[i] = std::exp(log_prior[i] + log_likelihood[i] - most);
    for (double& w : weights) w /= sum;
  }
};

namespace {

template <std::size_t M>
struct Bank final : NoiseBank::Filters {
  struct Candidate {
    detail::ChannelNoise<M> q;
    detail::ChannelCovariance<M> p;
    detail::ChannelState<M> x;
    detail::ChannelUpdate<M> gain;
    double log_det = 0.0;
    bool settled = false;
    bool broken = false;
  };
  std::vector<Candidate> all;

  void add(std::span<const Oscillator> clocks) {
    Candidate candidate;
    const double squared = unit_s * unit_s;
    for (std::size_t c = 0; c < model.clocks; ++c) {
      const double f = 0.5 * clocks[c].h0 * model.dt_s / squared;
      const double g = 2.0 * kPi * kPi * clocks[c].h_minus_2 * model.dt_s * model.dt_s * model.dt_s / squared;
      for (std::size_t i = 0; i < M; ++i) {
        for (std::size_t j = 0; j < M; ++j) {
          const double a = model.mixing[i * model.clocks + c] * model.mixing[j * model.clocks + c];
          candidate.q.f(i, j) += a * f;
          candidate.q.g(i, j) += a * g;
        }
      }
    }
    for (std::size_t i = 0; i < M * M; ++i) candidate.q.r.a[i] = model.covariance_s2[i] / squared;
    all.push_back(candidate);
  }

  void start(const double* z, double apart) noexcept override {
    for (auto& c : all) {
      c.p = detail::channel_start<M>(c.q.f, c.q.g, c.q.r, apart);
      for (std::size_t i = 0; i < M; ++i) {
        c.x.bias[i] = z[i];
        c.x.drift[i] = z[i] / apart;  // the first phases are zero
      }
    }
  }

  void step(const double* z, double t) noexcept override {
    const double constant = static_cast<double>(M) * (std::log(unit_s) + 0.5 * std::log(kTwoPi));
    for (std::size_t n = 0; n < count; ++n) {
      Candidate& c = all[n];
      if (c.broken) continue;
      c.x.predict(t);
      if (!c.settled || t != 1.0) {
        const auto before_bias = c.gain.to_bias;
        const auto before_drift = c.gain.to_drift;
        c.p.predict(c.q.f, c.q.g, t);
        c.gain.apply(c.p, c.q.r);
        if (!c.gain.factor.positive) {
          c.broken = true;
          log_likelihood[n] = -std::numeric_limits<double>::infinity();
          continue;
        }
        c.log_det = std::log(c.gain.factor.determinant);
        c.settled = t == 1.0 && detail::relative_change(c.gain.to_bias, before_bias) <= 1e-13 &&
                    detail::relative_change(c.gain.to_drift, before_drift) <= 1e-13;
      }
      std::array<double, M> e{};
      for (std::size_t i = 0; i < M; ++i) e[i] = z[i] - c.x.bias[i];
      log_likelihood[n] -= 0.5 * (c.log_det + detail::dot(e, c.gain.factor.solve(e))) + constant;
      if (!std::isfinite(log_likelihood[n])) {
        c.broken = true;
        log_likelihood[n] = -std::numeric_limits<double>::infinity();
        continue;
      }
      c.x.update(c.gain.to_bias, c.gain.to_drift, e);
    }
  }
};

template <std::size_t M>
std::unique_ptr<NoiseBank::Filters> make(const PhaseModel& model, std::span<const Oscillator> candidates) {
  auto bank = std::make_unique<Bank<M>>();
  bank->model = model;
  double trace = 0.0;
  for (std::size_t i = 0; i < M; ++i) trace += model.covariance_s2[i * M + i];
  bank->unit_s = std::sqrt(trace / static_cast<double>(M));
  bank->count = candidates.size() / model.clocks;
  bank->all.reserve(bank->count);
  for (std::size_t i = 0; i < bank->count; ++i) bank->add(candidates.subspan(i * model.clocks, model.clocks));
  return bank;
}

}  // namespace

NoiseBank::NoiseBank(const PhaseModel& model, std::span<const Oscillator> candidates, std::span<const double> prior) {
  check_model(model);
  if (candidates.empty() || candidates.size() % model.clocks != 0) {
    throw std::invalid_argument("candidates: " + std::to_string(candidates.size()) +
                                " oscillators: at least one candidate expected, each of " +
                                std::to_string(model.clocks));
  }
  for (const Oscillator& clock : candidates) static_cast<void>(clock.noise());  // throws for what is no clock
  const std::size_t count = candidates.size() / model.clocks;
  std::vector<double> log_prior(count, 0.0);
  if (!prior.empty()) {
    if (prior.size() != count) {
      throw std::invalid_argument("prior: " + std::to_string(count) + " weights expected, got " +
                                  std::to_string(prior.size()));
    }
    double sum = 0.0;
    for (std::size_t i = 0; i < count; ++i) {
      if (!(prior[i] >= 0.0) || std::isinf(prior[i])) {
        throw std::invalid_argument("prior[" + std::to_string(i) + "] = " + std::to_string(prior[i]) +
                                    " must be finite and >= 0");
      }
      sum += prior[i];
      log_prior[i] = std::log(prior[i]);
    }
    if (!(sum > 0.0)) throw std::invalid_argument("prior: one weight above 0 expected");
  }
  filters_ = model.channels == 1   ? make<1>(model, candidates)
             : model.channels == 2 ? make<2>(model, candidates)
                                   : make<3>(model, candidates);
  filters_->weights.resize(count);
  filters_->log_prior = std::move(log_prior);
  filters_->log_likelihood.assign(count, 0.0);
  filters_->weigh();
}

NoiseBank::NoiseBank(NoiseBank&&) noexcept = default;
NoiseBank& NoiseBank::operator=(NoiseBank&&) noexcept = default;
NoiseBank::~NoiseBank() = default;

bool NoiseBank::push(std::span<const double> phase_s) noexcept {
  Filters& f = *filters_;
  const std::size_t m = f.model.channels;
  if (f.whole > 0) ++f.steps;
  const auto counts = [&f](double z) { return std::abs(z) / f.unit_s < kLargestPhase; };  // so do its squares
  if (phase_s.size() != m || !std::ranges::all_of(phase_s, counts)) return false;
  if (f.whole == 0) std::copy_n(phase_s.begin(), m, f.first.begin());
  std::array<double, PhaseModel::kMaxChannels> z{};
  for (std::size_t i = 0; i < m; ++i) z[i] = (phase_s[i] - f.first[i]) / f.unit_s;
  if (f.whole == 1) {
    f.start(z.data(), static_cast<double>(f.steps));
  } else if (f.whole > 1) {
    f.step(z.data(), static_cast<double>(f.steps));
    f.weigh();
  }
  ++f.whole;
  f.steps = 0;
  return true;
}

std::size_t NoiseBank::candidates() const noexcept { return filters_->count; }
std::size_t NoiseBank::innovations() const noexcept { return filters_->whole > 2 ? filters_->whole - 2 : 0; }
const PhaseModel& NoiseBank::model() const noexcept { return filters_->model; }
std::span<const double> NoiseBank::weights() const noexcept { return filters_->weights; }
std::span<const double> NoiseBank::log_likelihoods() const noexcept { return filters_->log_likelihood; }

}  // namespace soopnav::clock
