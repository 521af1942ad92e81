#include "soopnav/navigation/phase_stitcher.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

namespace soopnav::navigation {

namespace {

constexpr double kLeastLogWeight = -34.5;  // 1e-15 of the likeliest
constexpr std::size_t kCandidatesEach = 8;
constexpr double kLargestInteger = 1e15;

void require(bool ok, const char* name, double value, const char* rule) {
  if (!ok) {
    throw std::invalid_argument(std::string(name) + " = " + std::to_string(value) + ": " + rule + " expected");
  }
}

}  // namespace

void StitcherOptions::check() const {
  const auto positive = [](double v) { return std::isfinite(v) && v > 0.0; };
  const auto not_negative = [](double v) { return std::isfinite(v) && v >= 0.0; };
  require(fractions >= 1 && fractions <= 64, "fractions", fractions, "1 ... 64");
  require(positive(wavelength_m), "wavelength_m", wavelength_m, "a positive number");
  require(not_negative(clock.white_frequency_m2ps), "clock.white_frequency_m2ps", clock.white_frequency_m2ps,
          "a number not below 0");
  require(not_negative(clock.frequency_walk_m2ps3), "clock.frequency_walk_m2ps3", clock.frequency_walk_m2ps3,
          "a number not below 0");
  require(positive(frequency_sigma_hz), "frequency_sigma_hz", frequency_sigma_hz, "a positive number");
  require(not_negative(rate_sigma_hzps), "rate_sigma_hzps", rate_sigma_hzps, "a number not below 0");
  require(not_negative(rate_walk_hz2ps3), "rate_walk_hz2ps3", rate_walk_hz2ps3, "a number not below 0");
  require(decision_bursts >= 2 && decision_bursts <= 512, "decision_bursts", decision_bursts, "2 ... 512");
  require(posterior > 0.5 && posterior < 1.0, "posterior", posterior, "more than 0.5 and less than 1");
  require(hypotheses >= 2 && hypotheses <= 4096, "hypotheses", hypotheses, "2 ... 4096");
  require(gate_sigma >= 3.0 && gate_sigma <= 10.0, "gate_sigma", gate_sigma, "3 ... 10");
  require(outliers >= 1, "outliers", outliers, "at least 1");
}

std::string_view to_string(BurstStatus status) noexcept {
  switch (status) {
    case BurstStatus::kAccepted:
      return "accepted";
    case BurstStatus::kStarted:
      return "started";
    case BurstStatus::kNotFinite:
      return "not finite";
    case BurstStatus::kNotLater:
      return "not later";
    case BurstStatus::kOutlier:
      return "outlier";
    case BurstStatus::kGapTooLong:
      return "gap too long";
    case BurstStatus::kLost:
      return "lost";
  }
  return "unknown";
}

PhaseStitcher::PhaseStitcher(const StitcherOptions& options)
    : options_((options.check(), options)), window_(static_cast<std::size_t>(options.decision_bursts)) {
  const auto most = static_cast<std::size_t>(options.hypotheses);
  now_.reserve(most);
  next_.reserve(most);
  steps_now_.resize(most * window_);
  steps_next_.resize(most * window_);
  candidates_.reserve(most * kCandidatesEach);
  ring_.resize(window_);
  decided_.reserve(2 * window_ + 2);
}

void PhaseStitcher::restart() noexcept {
  now_.clear();
  pending_ = 0;
  first_ = 0;
  since_start_ = 0;
  misses_ = 0;
  dropped_ = 0.0;
}

void PhaseStitcher::start(const PhaseBurst& burst) noexcept {
  Hypothesis& h = now_.emplace_back();
  const double f = options_.frequency_sigma_hz, r = options_.rate_sigma_hzps;
  h = {{burst.phase_cycles - burst.predicted_cycles, 0.0, 0.0},
       {burst.phase_sigma_cycles * burst.phase_sigma_cycles, 0.0, f * f, 0.0, 0.0, r * r},
       0.0,
       0};
  if (std::isfinite(burst.frequency_hz)) {  // phase and frequency are not correlated yet
    const double R = burst.frequency_sigma_hz * burst.frequency_sigma_hz;
    const double gain = h.P[2] / (h.P[2] + R);
    h.x[1] = gain * (burst.frequency_hz - burst.predicted_rate_cyclesps);
    h.P[2] = gain * R;
  }
  integer_ = 0;
  ++arc_;
  since_start_ = 1;
  last_t_s_ = burst.t_s;
  decided_.push_back({pushed_ - 1, burst.t_s, burst.phase_cycles, burst.phase_sigma_cycles, 0, 0, 1.0, true, arc_});
}

void PhaseStitcher::predict(Hypothesis& h, double dt) const noexcept {
  // P = F P F' + Q with F = [[1, dt, dt²/2], [0, 1, dt], [0, 0, 1]], doc/phase_stitching.md eq. 2.
  const double half = 0.5 * dt * dt;
  h.x[0] += dt * h.x[1] + half * h.x[2];
  h.x[1] += dt * h.x[2];
  double* const P = h.P;
  const double a0 = P[0] + dt * P[1] + half * P[3];  // F P, rows 0 and 1
  const double a1 = P[1] + dt * P[2] + half * P[4];
  const double a2 = P[3] + dt * P[4] + half * P[5];
  const double b1 = P[2] + dt * P[4];
  const double b2 = P[4] + dt * P[5];
  const double per_m2 = 1.0 / (options_.wavelength_m * options_.wavelength_m);
  const double sf = options_.clock.white_frequency_m2ps * per_m2, sg = options_.clock.frequency_walk_m2ps3 * per_m2;
  const double sr = options_.rate_walk_hz2ps3;
  P[0] = a0 + dt * a1 + half * a2 + dt * (sf + dt * dt * (sg / 3.0 + sr * dt * dt / 20.0));
  P[1] = a1 + dt * a2 + dt * dt * (sg / 2.0 + sr * dt * dt / 8.0);
  P[2] = b1 + dt * b2 + dt * (sg + sr * dt * dt / 3.0);
  P[3] = a2 + sr * dt * dt * dt / 6.0;
  P[4] = b2 + sr * dt * dt / 2.0;
  P[5] += sr * dt;
}

namespace {

// Joseph update of phase (at = 0) or frequency (at = 1): log likelihood of the innovation without constants.
template <class Hypothesis>
double stitch_update(Hypothesis& h, int at, double innovation, double R) noexcept {
  double* const P = h.P;
  const double column[3] = {at == 0 ? P[0] : P[1], at == 0 ? P[1] : P[2], at == 0 ? P[3] : P[4]};
  const double S = column[at] + R;
  const double K[3] = {column[0] / S, column[1] / S, column[2] / S};
  for (int i = 0; i < 3; ++i) h.x[i] += K[i] * innovation;
  // (I - K H) P (I - K H)' + K R K' written out: P_ij - K_i c_j - c_i K_j + K_i S K_j.
  int k = 0;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j <= i; ++j, ++k) P[k] += -K[i] * column[j] - column[i] * K[j] + K[i] * S * K[j];
  }
  return -0.5 * (innovation * innovation / S + std::log(S));
}

}  // namespace

BurstStatus PhaseStitcher::branch(const PhaseBurst& burst, double dt) noexcept {
  const double M = options_.fractions, gate = options_.gate_sigma;
  const double z = burst.phase_cycles - burst.predicted_cycles;
  const double R = burst.phase_sigma_cycles * burst.phase_sigma_cycles;
  candidates_.clear();
  double largest = -std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < now_.size(); ++i) {
    Hypothesis h = now_[i];
    predict(h, dt);
    const double S = h.P[0] + R, sigma = std::sqrt(S), y = z - h.x[0];
    const auto room = static_cast<double>(candidates_.capacity() - candidates_.size());
    if (!(2.0 * M * gate * sigma <= room + 1.0)) return BurstStatus::kGapTooLong;
    // n / M within the gate of y; doubles hold these integers exactly for any phase a receiver counts.
    const double low = std::ceil(M * (y - gate * sigma)), high = std::floor(M * (y + gate * sigma));
    if (!(std::abs(low) < kLargestInteger && std::abs(high) < kLargestInteger)) return BurstStatus::kOutlier;
    if (high - low + 1.0 > room) return BurstStatus::kGapTooLong;
    for (double n = low; n <= high; n += 1.0) {
      Hypothesis updated = h;
      double log_weight = h.log_weight + stitch_update(updated, 0, y - n / M, R);
      if (std::isfinite(burst.frequency_hz)) {
        log_weight += stitch_update(updated, 1, burst.frequency_hz - burst.predicted_rate_cyclesps - updated.x[1],
                                    burst.frequency_sigma_hz * burst.frequency_sigma_hz);
      }
      largest = std::max(largest, log_weight);
      candidates_.push_back({static_cast<int>(i), static_cast<std::int64_t>(n), log_weight});
    }
  }
  if (candidates_.empty() || !std::isfinite(largest)) return BurstStatus::kOutlier;
  double all = 0.0, kept = 0.0;
  for (Candidate& c : candidates_) all += std::exp(c.log_weight -= largest);
  const std::size_t most = std::min<std::size_t>(candidates_.size(), static_cast<std::size_t>(options_.hypotheses));
  std::partial_sort(candidates_.begin(), candidates_.begin() + static_cast<std::ptrdiff_t>(most), candidates_.end(),
                    [](const Candidate& a, const Candidate& b) {
                      return a.log_weight != b.log_weight
                                 ? a.log_weight > b.log_weight
                                 : (a.parent != b.parent ? a.parent < b.parent : a.integer < b.integer);
                    });
  next_.clear();
  const std::size_t slot = (first_ + pending_) % window_;
  for (std::size_t k = 0; k < most && candidates_[k].log_weight > kLeastLogWeight; ++k) {
    const Candidate& c = candidates_[k];
    const auto parent = static_cast<std::size_t>(c.parent);
    Hypothesis h = now_[parent];
    predict(h, dt);
    static_cast<void>(stitch_update(h, 0, z - static_cast<double>(c.integer) / M - h.x[0], R));
    if (std::isfinite(burst.frequency_hz)) {
      static_cast<void>(stitch_update(h, 1, burst.frequency_hz - burst.predicted_rate_cyclesps - h.x[1],
                                      burst.frequency_sigma_hz * burst.frequency_sigma_hz));
    }
    const std::int64_t* const old = steps(steps_now_, parent);
    std::int64_t* const fresh = steps(steps_next_, k);
    std::copy(old, old + window_, fresh);
    fresh[slot] = c.integer - h.integer;
    h.integer = c.integer;
    h.log_weight = c.log_weight;
    kept += std::exp(c.log_weight);
    next_.push_back(h);
  }
  dropped_ += (all - kept) / all;
  for (Hypothesis& h : next_) h.log_weight -= std::log(kept);
  now_.swap(next_);
  steps_now_.swap(steps_next_);
  ring_[slot] = {pushed_ - 1, burst.t_s, burst.phase_cycles, burst.phase_sigma_cycles};
  ++pending_;
  ++since_start_;
  last_t_s_ = burst.t_s;
  return BurstStatus::kAccepted;
}

std::size_t PhaseStitcher::best() const noexcept {
  std::size_t at = 0;
  for (std::size_t i = 1; i < now_.size(); ++i) {
    if (now_[i].log_weight > now_[at].log_weight) at = i;
  }
  return at;
}

void PhaseStitcher::emit(bool flush, bool early) noexcept {
  const bool mature = since_start_ >= options_.decision_bursts;
  while (pending_ > 0) {
    const std::int64_t step = steps(steps_now_, best())[first_];
    double agree = 0.0, mean = 0.0, square = 0.0;
    for (std::size_t i = 0; i < now_.size(); ++i) {
      const double w = std::exp(now_[i].log_weight);
      const double d = static_cast<double>(steps(steps_now_, i)[first_] - step);
      if (d == 0.0) agree += w;
      mean += w * d;
      square += w * d * d;
    }
    const double posterior = std::max(0.0, std::min(agree, 1.0) - dropped_);
    const bool fixed = (mature || (flush && early)) && posterior >= options_.posterior;
    if (!fixed && !flush && pending_ < window_) return;
    const Waiting& w = ring_[first_];
    integer_ += step;
    if (!fixed) ++arc_;
    const double M = options_.fractions;
    const double spread = fixed ? 0.0 : std::max(square - mean * mean, 0.0) / (M * M);
    decided_.push_back({w.burst, w.t_s, w.measured - static_cast<double>(integer_) / M,
                        std::sqrt(w.sigma * w.sigma + spread), integer_, step, posterior, fixed, arc_});
    if (fixed && agree < 1.0) {  // what contradicts a fixed step goes
      std::size_t kept = 0;
      for (std::size_t i = 0; i < now_.size(); ++i) {
        if (steps(steps_now_, i)[first_] != step) continue;
        if (kept != i) {
          now_[kept] = now_[i];
          std::copy_n(steps(steps_now_, i), window_, steps(steps_now_, kept));
        }
        ++kept;
      }
      now_.resize(kept);
      for (Hypothesis& h : now_) h.log_weight -= std::log(agree);
    }
    first_ = (first_ + 1) % window_;
    --pending_;
  }
}

BurstStatus PhaseStitcher::push(const PhaseBurst& burst) noexcept {
  decided_.clear();
  ++pushed_;
  const bool sound =
      std::isfinite(burst.t_s) && std::isfinite(burst.phase_cycles) && std::isfinite(burst.phase_sigma_cycles) &&
      burst.phase_sigma_cycles > 0.0 && std::isfinite(burst.predicted_cycles) &&
      std::isfinite(burst.predicted_rate_cyclesps) && !std::isinf(burst.frequency_hz) &&
      (std::isnan(burst.frequency_hz) || (std::isfinite(burst.frequency_sigma_hz) && burst.frequency_sigma_hz > 0.0));
  if (!sound) return BurstStatus::kNotFinite;
  if (!(options_.fractions * std::abs(burst.phase_cycles - burst.predicted_cycles) < kLargestInteger)) {
    return BurstStatus::kOutlier;  // no integer of a double's is right: neither a miss nor a start
  }
  if (now_.empty()) {
    start(burst);
    return BurstStatus::kStarted;
  }
  const double dt = burst.t_s - last_t_s_;
  if (!(dt > 0.0)) return BurstStatus::kNotLater;
  BurstStatus status = branch(burst, dt);
  if (status == BurstStatus::kAccepted) {
    misses_ = 0;
    emit(false, false);
    return status;
  }
  if (status == BurstStatus::kOutlier) {
    if (++misses_ < options_.outliers) return status;
    status = BurstStatus::kLost;
  }
  emit(true, false);
  restart();
  start(burst);
  return status;
}

void PhaseStitcher::finish(bool early) noexcept {
  decided_.clear();
  if (!now_.empty()) emit(true, early);
  restart();
}

double PhaseStitcher::posterior() const noexcept {
  return now_.empty() ? 0.0 : std::max(0.0, std::exp(now_[best()].log_weight) - dropped_);
}

double PhaseStitcher::frequency_error_hz() const noexcept {
  return now_.empty() ? std::numeric_limits<double>::quiet_NaN() : now_[best()].x[1];
}

double PhaseStitcher::frequency_error_sigma_hz() const noexcept {
  return now_.empty() ? std::numeric_limits<double>::quiet_NaN() : std::sqrt(now_[best()].P[2]);
}

}  // namespace soopnav::navigation
