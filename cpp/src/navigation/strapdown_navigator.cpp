#include "soopnav/navigation/strapdown_navigator.hpp"

#include <algorithm>
#include <sstream>
#include <stdexcept>
#include <string>
#include <utility>

namespace soopnav::navigation {
namespace {

using inertial::ImuIncrement;
using inertial::ImuStatus;
using inertial::kAccelerometerBias;
using inertial::kGyroBias;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kTimeSlackS = 1e-9;

void require(bool holds, const char* name, double value, const char* rule) {
  if (holds) return;
  std::ostringstream text;
  text << name << ": " << value << "; " << rule;
  throw std::invalid_argument(text.str());
}

void require_size(std::size_t got, std::size_t expected, const char* name) {
  if (got == expected) return;
  throw std::invalid_argument(std::string(name) + ": " + std::to_string(got) + " numbers; " + std::to_string(expected) +
                              " expected");
}

const StrapdownOptions& checked(const StrapdownOptions& options) {
  const auto positive = [](double value, const char* name) {
    require(value > 0.0, name, value, "it must be positive");
  };
  require(options.range_sigma_m > 0.0 && std::isfinite(options.range_sigma_m), "range_sigma_m", options.range_sigma_m,
          "it must be positive and finite");
  positive(options.ambiguity_m, "ambiguity_m");
  positive(options.gate_sigmas, "gate_sigmas");
  require(options.gate_floor_m >= 0.0, "gate_floor_m", options.gate_floor_m, "it must not be negative");
  require(options.gap.rate_sigma_radps >= 0.0 && std::isfinite(options.gap.rate_sigma_radps), "rate_sigma_radps",
          options.gap.rate_sigma_radps, "it must be finite and not negative");
  require(options.gap.acceleration_sigma_mps2 >= 0.0 && std::isfinite(options.gap.acceleration_sigma_mps2),
          "acceleration_sigma_mps2", options.gap.acceleration_sigma_mps2, "it must be finite and not negative");
  require(options.zero_velocity_sigma_mps > 0.0 && std::isfinite(options.zero_velocity_sigma_mps),
          "zero_velocity_sigma_mps", options.zero_velocity_sigma_mps, "it must be positive and finite");
  require(options.zero_rate_sigma_radps > 0.0 && std::isfinite(options.zero_rate_sigma_radps), "zero_rate_sigma_radps",
          options.zero_rate_sigma_radps, "it must be positive and finite");
  return options;
}

Eigen::Vector3d row3(std::span<const double> values, std::size_t i) {
  return {values[3 * i], values[3 * i + 1], values[3 * i + 2]};
}

template <class Vector>
void append(std::vector<double>& out, const Vector& values) {
  for (Eigen::Index i = 0; i < values.size(); ++i) out.push_back(values[i]);
}

void record(double t_s, const StrapdownNavigator::State& x, const StrapdownNavigator::Filter::Square& P,
            bool covariance, StrapdownRun& out) {
  out.t_s.push_back(t_s);
  append(out.position_m, x(kPosition));
  append(out.velocity_mps, x(kVelocity));
  append(out.quaternion, x(kAttitude));
  append(out.gyro_bias_radps, x(kGyroBias));
  append(out.accelerometer_bias_mps2, x(kAccelerometerBias));
  for (Eigen::Index i = 0; i < P.rows(); ++i) out.sigma.push_back(std::sqrt(P(i, i)));
  if (covariance) out.covariance.insert(out.covariance.end(), P.data(), P.data() + P.size());
}

}  // namespace

StrapdownNavigator::StrapdownNavigator(const geometry::Geodetic& origin,
                                       const std::vector<Eigen::Vector3d>& transmitters_m,
                                       const Eigen::Vector3d& reference_m, double start_s, const State& x0,
                                       const Filter::Square& P0, const StrapdownOptions& options)
    : options_(checked(options)),
      process_(origin, options.noise),
      gap_{options.gap, options.noise},
      filter_(x0, P0),
      guard_(options.limits),
      coning_(options.coning_samples),
      time_s_(start_s) {
  require(std::isfinite(start_s), "start_s", start_s, "it must be finite");
  require(reference_m.allFinite(), "reference_m", reference_m.sum(), "it must be finite");
  require(std::abs(x0(kAttitude).norm() - 1.0) < 1e-6, "quaternion", x0(kAttitude).norm(), "its norm must be 1");
  models_.reserve(transmitters_m.size());
  for (const Eigen::Vector3d& q : transmitters_m) {
    require(q.allFinite(), "transmitters_m", q.sum(), "they must be finite");
    models_.push_back({{Known<3>(q), Known<3>(reference_m)}, options.ambiguity_m});
  }
  if (std::isfinite(options.gate_sigmas)) {
    gate_.residual = options.gate_floor_m;
    gate_.residual_sigmas = options.gate_sigmas;
  }
  if (options.zero_velocity) detector_.emplace(*options.zero_velocity);
  guard_.start(start_s);
}

StrapdownNavigator::Sample StrapdownNavigator::take(double t_s, const Eigen::Vector3d& delta_theta_b,
                                                    const Eigen::Vector3d& delta_velocity_b) noexcept {
  Sample sample;
  // Ranges are of rates and forces: the increments over the period they speak for.
  const double since = t_s - guard_.last_s();
  const double period = guard_.limits().period_s;
  const double speaks_for = since > guard_.limits().gap_periods * period || !(since > 0.0) ? period : since;
  const auto verdict = guard_.judge(t_s, delta_theta_b / speaks_for, delta_velocity_b / speaks_for);
  sample.status = verdict.status;
  sample.counts = verdict.step_s > 0.0;
  if (!sample.counts) return sample;
  sample.end_s = t_s;
  sample.gap_s = verdict.missing_s;
  if (sample.gap_s > 0.0 || !verdict.usable()) {
    coning_.reset();
    if (detector_) detector_->reset();
  }
  if (!verdict.usable()) {
    sample.gap_s += verdict.step_s;
    return sample;
  }
  const ImuIncrement raw{delta_theta_b, delta_velocity_b, verdict.step_s};
  sample.increment = coning_.correct(raw);
  sample.at_rest = detector_ && detector_->push(raw);
  return sample;
}

void StrapdownNavigator::advance(Sample& sample, double to_s) noexcept {
  if (sample.gap_s > 0.0) {
    const double gap_end = sample.end_s - sample.increment.dt_s;
    const double part = std::min(to_s, gap_end) - time_s_;
    if (part > 0.0) {
      // What a step does not take (a state no longer finite) leaves the filter as it was; time goes on all the same.
      const double factor = episode_.silent(part);
      inertial::StrapdownGap gap = gap_;
      gap.motion.rate_sigma_radps *= factor;
      gap.motion.acceleration_sigma_mps2 *= factor;
      static_cast<void>(filter_.predict(gap, part));
      time_s_ += part;
    }
    if (to_s < gap_end) return;
    sample.gap_s = 0.0;
    time_s_ = gap_end;
  }
  if (!(sample.increment.dt_s > 0.0)) return;
  const bool all = to_s >= sample.end_s;
  const double left = sample.end_s - time_s_;
  const double fraction = all ? 1.0 : (to_s - time_s_) / left;
  if (!(fraction > 0.0)) return;
  const ImuIncrement now = sample.increment.part(fraction);
  static_cast<void>(filter_.predict(process_, now, now.dt_s));
  episode_.good(now.dt_s);
  sample.increment = sample.increment.part(1.0 - fraction);
  if (all) sample.increment = {};
  time_s_ = all ? sample.end_s : to_s;
}

bool StrapdownNavigator::rest(const Sample& sample) noexcept {
  ++since_rest_;
  if (!sample.at_rest || since_rest_ < options_.zero_velocity->window) return false;
  since_rest_ = 0;  // windows must not overlap: their noise is used once
  const double v = options_.zero_velocity_sigma_mps;
  const auto report = filter_.update(inertial::ZeroVelocity{}, Eigen::Vector3d::Zero().eval(),
                                     (v * v * Eigen::Matrix3d::Identity()).eval());
  if (report.accepted() && options_.hold_heading) {
    const double window_s = options_.zero_velocity->window * guard_.limits().period_s;
    const double white = options_.noise.gyro_density * options_.noise.gyro_density / window_s;
    const double variance = options_.zero_rate_sigma_radps * options_.zero_rate_sigma_radps + white;
    static_cast<void>(filter_.update(inertial::ZeroAngularRate{process_.earth_rate()}, detector_->mean_rate(),
                                     (variance * Eigen::Matrix3d::Identity()).eval()));
  }
  return report.accepted();
}

inertial::ImuStatus StrapdownNavigator::add_imu(double t_s, const Eigen::Vector3d& delta_theta_b,
                                                const Eigen::Vector3d& delta_velocity_b) noexcept {
  Sample sample = take(t_s, delta_theta_b, delta_velocity_b);
  if (!sample.counts) return sample.status;
  advance(sample, sample.end_s);
  if (detector_) static_cast<void>(rest(sample));
  return sample.status;
}

UpdateReport<1> StrapdownNavigator::update_range_change(std::size_t transmitter, double range_change_m) noexcept {
  if (transmitter >= models_.size()) return UpdateReport<1>{};
  return filter_.update(models_[transmitter], range_change_m, options_.range_sigma_m * options_.range_sigma_m, gate_);
}

StrapdownRun StrapdownNavigator::run(const StrapdownData& data) const {
  const std::size_t n = data.t_s.size();
  const std::size_t epochs = data.epochs_s.size();
  const std::size_t sources = models_.size();
  require_size(data.delta_theta_b.size(), 3 * n, "delta_theta_b");
  require_size(data.delta_velocity_b.size(), 3 * n, "delta_velocity_b");
  require_size(data.range_changes_m.size(), epochs * sources, "range_changes_m");
  require(data.record_every >= 1, "record_every", static_cast<double>(data.record_every), "it must be at least 1");
  StrapdownNavigator self = *this;
  StrapdownRun out;
  out.innovation_m.assign(epochs * sources, kNan);
  out.innovation_sigma_m.assign(epochs * sources, kNan);
  out.nis.assign(epochs * sources, kNan);
  out.update_status.assign(epochs * sources, static_cast<std::uint8_t>(UpdateStatus::kTimeNotAdvancing));
  out.imu_status.resize(n);
  const std::size_t records = n / data.record_every;
  out.t_s.reserve(records);
  for (auto* three : {&out.position_m, &out.velocity_mps, &out.gyro_bias_radps, &out.accelerometer_bias_mps2}) {
    three->reserve(3 * records);
  }
  out.quaternion.reserve(4 * records);
  out.sigma.reserve(15 * records);
  if (data.covariance) out.covariance.reserve(225 * records);

  std::size_t epoch = 0;
  const auto take_epoch = [&](bool late) {
    for (std::size_t i = 0; i < sources; ++i) {
      const std::size_t at = epoch * sources + i;
      if (late) {
        out.update_status[at] = static_cast<std::uint8_t>(UpdateStatus::kTooLate);
        continue;
      }
      const auto report = self.update_range_change(i, data.range_changes_m[at]);
      out.update_status[at] = static_cast<std::uint8_t>(report.status);
      out.innovation_m[at] = report.innovation[0];
      out.innovation_sigma_m[at] = std::sqrt(report.covariance(0, 0));
      out.nis[at] = report.nis;
    }
    ++epoch;
  };
  for (std::size_t k = 0; k < n; ++k) {
    Sample sample = self.take(data.t_s[k], row3(data.delta_theta_b, k), row3(data.delta_velocity_b, k));
    out.imu_status[k] = static_cast<std::uint8_t>(sample.status);
    if (sample.counts) {
      // `!(>)`: an epoch without a time is late, not waited for.
      while (epoch < epochs && !(data.epochs_s[epoch] > sample.end_s + kTimeSlackS)) {
        const double due = data.epochs_s[epoch];
        const bool late = !(due >= self.time_s_ - kTimeSlackS);
        if (!late) self.advance(sample, std::abs(due - sample.end_s) <= kTimeSlackS ? sample.end_s : due);
        take_epoch(late);
      }
      self.advance(sample, sample.end_s);
      if (self.detector_ && self.rest(sample)) ++out.zero_velocity_updates;
    }
    if ((k + 1) % data.record_every == 0) {
      record(self.time_s_, self.filter_.state(), self.filter_.covariance(), data.covariance, out);
    }
  }
  return out;
}

}  // namespace soopnav::navigation
