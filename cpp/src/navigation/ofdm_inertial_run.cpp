#include "soopnav/navigation/ofdm_inertial_run.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

namespace soopnav::navigation {

namespace {

constexpr double kGapPeriods = 1.5;
constexpr double kCoastStepS = 1.0;
constexpr double kSameTimeS = 1e-9;  // rounding of times that are meant to be one

void require_size(const char* name, std::size_t got, std::size_t expected) {
  if (got == expected) return;
  throw std::invalid_argument(std::string(name) + ": " + std::to_string(expected) + " numbers expected, got " +
                              std::to_string(got));
}

double median_step(std::span<const double> t) {
  std::vector<double> steps;
  for (std::size_t i = 1; i < t.size(); ++i) {
    if (t[i] > t[i - 1] && std::isfinite(t[i] - t[i - 1])) steps.push_back(t[i] - t[i - 1]);
  }
  if (steps.empty()) return 0.0;
  const auto middle = steps.begin() + static_cast<std::ptrdiff_t>(steps.size() / 2);
  std::nth_element(steps.begin(), middle, steps.end());
  return *middle;
}

class Runner {
 public:
  Runner(OfdmInertialNavigator& navigator, const OfdmInertialData& data, const RangeTiming& timing)
      : nav_(navigator),
        data_(data),
        timing_(timing),
        receivers_(static_cast<std::size_t>(navigator.receivers())),
        transmitters_(static_cast<std::size_t>(navigator.transmitters())),
        now_(data.start_s) {
    check();
    out_.dim = static_cast<std::size_t>(nav_.state().dim());
    const std::size_t rows = data_.imu_t_s.size() / data_.record_every + 2;
    out_.t_s.reserve(rows);
    out_.state.reserve(rows * out_.dim);
    out_.covariance.reserve(rows * out_.dim * out_.dim);
    out_.reports.resize(data_.epoch_t_s.size() * receivers_ * transmitters_);
    out_.range_change_m.assign(data_.range_change_m.begin(), data_.range_change_m.end());
    out_.range_change_m.resize(out_.reports.size(), std::numeric_limits<double>::quiet_NaN());
    if (referenced_) out_.reference.assign(data_.epoch_t_s.size() * transmitters_, UpdateStatus::kUndefined);
    rows_.resize((receivers_ + 1) * transmitters_);
    reports_.resize(rows_.size());
    period_ = data_.imu_period_s > 0.0 ? data_.imu_period_s : median_step(data_.imu_t_s);
    if (!(period_ > 0.0) && data_.imu_t_s.size() == 1) period_ = data_.imu_t_s[0] - data_.start_s;
    if (!(period_ > 0.0) && !data_.imu_t_s.empty()) {
      throw std::invalid_argument("imu_t_s: times do not advance; no period can be found");
    }
  }

  OfdmInertialHistory finish() {
    while (epoch_ < data_.epoch_t_s.size() && !(data_.epoch_t_s[epoch_] >= now_)) refuse(UpdateStatus::kTooLate);
    take_epochs();
    record();
    for (std::size_t k = 0; k < data_.imu_t_s.size() && sound(); ++k) {
      const double t = data_.imu_t_s[k];
      if (!(t > now_) || !(t - now_ <= data_.max_gap_s)) {
        ++out_.imu.not_after;
        continue;
      }
      const double gap = t - now_ > kGapPeriods * period_ ? t - period_ - now_ : 0.0;
      if (gap > 0.0) {
        ++out_.imu.gaps;
        out_.imu.gap_s += gap;
        advance(now_ + gap, kCoasting);
      }
      count(k);
      advance(t, k);
      ++out_.imu.used;
      if (out_.imu.used % data_.record_every == 0) record();
    }
    while (sound() && epoch_ < data_.epoch_t_s.size() && data_.epoch_t_s[epoch_] - now_ <= data_.max_gap_s) {
      advance(data_.epoch_t_s[epoch_], kCoasting);
    }
    while (sound() && epoch_ < data_.epoch_t_s.size()) refuse(UpdateStatus::kTimeNotAdvancing);
    if (out_.t_s.back() < now_) record();
    return std::move(out_);
  }

 private:
  static constexpr std::size_t kCoasting = static_cast<std::size_t>(-1);

  void check() {
    const std::size_t n = data_.imu_t_s.size();
    const std::size_t links = data_.epoch_t_s.size() * transmitters_;
    require_size("yaw_rate_radps", data_.yaw_rate_radps.size(), receivers_ * n);
    require_size("specific_force_b_mps2", data_.specific_force_b_mps2.size(), receivers_ * n * 2);
    require_size("range_change_m", data_.range_change_m.size(), timing_ ? 0 : links * receivers_);
    require_size("range_sigma_m", data_.range_sigma_m.size(), timing_ ? 0 : links * receivers_);
    referenced_ = !data_.reference_range_change_m.empty();
    if (referenced_ || !data_.reference_sigma_m.empty()) {
      require_size("reference_range_change_m", data_.reference_range_change_m.size(), links);
      require_size("reference_sigma_m", data_.reference_sigma_m.size(), links);
    }
    if (nav_.options().reference_receiver && !referenced_ && links > 0) {
      throw std::invalid_argument(
          "reference_range_change_m: the navigator was made for a reference receiver, whose "
          "boundaries are missing");
    }
    if (!std::isfinite(data_.start_s)) throw std::invalid_argument("start_s: a finite number expected");
    if (!(data_.imu_period_s >= 0.0)) throw std::invalid_argument("imu_period_s: zero or more expected");
    if (!(data_.max_gap_s > 0.0)) throw std::invalid_argument("max_gap_s: a positive number expected");
    if (data_.record_every == 0) throw std::invalid_argument("record_every: at least 1 expected");
    for (std::size_t e = 0; e < data_.epoch_t_s.size(); ++e) {
      if (!std::isfinite(data_.epoch_t_s[e]) || (e > 0 && data_.epoch_t_s[e] < data_.epoch_t_s[e - 1])) {
        throw std::invalid_argument("epoch_t_s[" + std::to_string(e) + "] = " + std::to_string(data_.epoch_t_s[e]) +
                                    ": finite times that do not fall expected");
      }
    }
  }

  [[nodiscard]] bool sound() const noexcept { return out_.status == UpdateStatus::kAccepted; }

  [[nodiscard]] inertial::PlanarImuSample sample(std::size_t receiver, std::size_t k) const noexcept {
    const std::size_t i = receiver * data_.imu_t_s.size() + k;
    return {data_.yaw_rate_radps[i], {data_.specific_force_b_mps2[2 * i], data_.specific_force_b_mps2[2 * i + 1]}};
  }
  void count(std::size_t k) noexcept {
    for (std::size_t r = 0; r < receivers_; ++r) {
      const auto u = sample(r, k);
      if (!u.all_finite()) {
        ++out_.imu.not_finite;
      } else if (std::abs(u.yaw_rate_radps) >= nav_.options().yaw_rate_range_radps ||
                 u.specific_force_b_mps2.cwiseAbs().maxCoeff() >= nav_.options().specific_force_range_mps2) {
        ++out_.imu.saturated;
      }
    }
  }

  // Carries everything to `t`, on sample `k` or coasting, with the epochs on the way.
  void advance(double t, std::size_t k) {
    while (sound() && now_ < t) {
      double next = t;
      if (k == kCoasting) next = std::min(next, now_ + kCoastStepS);
      if (epoch_ < data_.epoch_t_s.size()) next = std::min(next, data_.epoch_t_s[epoch_]);
      step(next - now_, k);
      now_ = next;
      take_epochs();
    }
  }
  void step(double dt_s, std::size_t k) {
    for (std::size_t r = 0; r < receivers_ && sound(); ++r) {
      const int receiver = static_cast<int>(r);
      out_.status = k == kCoasting ? nav_.coast(receiver, dt_s) : nav_.predict(receiver, sample(r, k), dt_s);
    }
    if (sound()) out_.status = nav_.predict_links(dt_s);
  }

  void refuse(UpdateStatus status) {
    const auto first = static_cast<std::ptrdiff_t>(epoch_ * receivers_ * transmitters_);
    std::fill_n(out_.reports.begin() + first, receivers_ * transmitters_, RangeChangeReport{status});
    ++epoch_;
  }

  void take_epochs() {
    while (sound() && epoch_ < data_.epoch_t_s.size() && data_.epoch_t_s[epoch_] <= now_ + kSameTimeS) {
      std::size_t n = 0;
      if (referenced_) {
        for (std::size_t q = 0; q < transmitters_; ++q) {
          const std::size_t i = epoch_ * transmitters_ + q;
          rows_[n++] = {kReferenceReceiver, static_cast<int>(q), data_.reference_range_change_m[i],
                        data_.reference_sigma_m[i]};
        }
      }
      const std::size_t mobile = n;
      for (std::size_t r = 0; r < receivers_; ++r) {
        for (std::size_t q = 0; q < transmitters_; ++q) {
          const std::size_t i = (epoch_ * receivers_ + r) * transmitters_ + q;
          rows_[n] = timing_ ? timed(static_cast<int>(r), static_cast<int>(q))
                             : RangeChange{static_cast<int>(r), static_cast<int>(q), data_.range_change_m[i],
                                           data_.range_sigma_m[i]};
          out_.range_change_m[i] = rows_[n++].range_change_m;
        }
      }
      nav_.update(std::span(rows_).first(n), std::span(reports_).first(n));
      for (std::size_t i = 0; i < mobile; ++i) out_.reference[epoch_ * transmitters_ + i] = reports_[i].status;
      std::copy(reports_.begin() + static_cast<std::ptrdiff_t>(mobile),
                reports_.begin() + static_cast<std::ptrdiff_t>(n),
                out_.reports.begin() + static_cast<std::ptrdiff_t>(epoch_ * receivers_ * transmitters_));
      ++epoch_;
    }
  }

  // What `timing` measures of a link, from where the navigator expects it.
  [[nodiscard]] RangeChange timed(int receiver, int transmitter) const {
    RangeChange predicted = nav_.predicted(receiver, transmitter);
    if (referenced_ && !nav_.options().transmitter_clock) {
      const std::size_t i = epoch_ * transmitters_ + static_cast<std::size_t>(transmitter);
      predicted.range_change_m += data_.reference_range_change_m[i];
      predicted.sigma_m = std::hypot(predicted.sigma_m, data_.reference_sigma_m[i]);
    }
    RangeChange measured{receiver, transmitter, std::numeric_limits<double>::quiet_NaN(), 1.0};
    if (std::isfinite(predicted.range_change_m) && std::isfinite(predicted.sigma_m)) {
      measured = timing_(epoch_, predicted);
      measured.receiver = receiver;
      measured.transmitter = transmitter;
    }
    return measured;
  }

  void record() {
    const auto x = nav_.state().x();
    const auto P = nav_.covariance();
    out_.t_s.push_back(now_);
    out_.state.insert(out_.state.end(), x.data(), x.data() + x.size());
    for (Eigen::Index i = 0; i < P.rows(); ++i) {
      for (Eigen::Index j = 0; j < P.cols(); ++j) out_.covariance.push_back(P(i, j));
    }
  }

  OfdmInertialNavigator& nav_;
  const OfdmInertialData& data_;
  const RangeTiming& timing_;
  std::size_t receivers_;
  std::size_t transmitters_;
  double now_;
  double period_ = 0.0;
  bool referenced_ = false;
  std::size_t epoch_ = 0;
  std::vector<RangeChange> rows_;
  std::vector<RangeChangeReport> reports_;
  OfdmInertialHistory out_;
};

}  // namespace

OfdmInertialHistory run(OfdmInertialNavigator& navigator, const OfdmInertialData& data, const RangeTiming& timing) {
  return Runner(navigator, data, timing).finish();
}

}  // namespace soopnav::navigation
