#include "soopnav/navigation/ofdm_inertial_navigator.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include "soopnav/clock/two_state.hpp"
#include "soopnav/measurement/range_difference.hpp"

namespace soopnav::navigation {

namespace {

constexpr double kLeastSigma = 1e-9;

// Where the roles of a planar receiver lie in the navigator's state: at its fixed roles, or at blocks.
struct FixedParts {
  static constexpr auto at(Role<1, HeadingTag> role) noexcept { return role; }
  static constexpr auto at(Role<2, VelocityTag> role) noexcept { return role; }
  static constexpr auto at(Role<2, PositionTag> role) noexcept { return role; }
};
struct BlockParts {
  Block<1> heading;
  Block<2> velocity;
  Block<2> position;
  [[nodiscard]] Block<1> at(Role<1, HeadingTag>) const noexcept { return heading; }
  [[nodiscard]] Block<2> at(Role<2, VelocityTag>) const noexcept { return velocity; }
  [[nodiscard]] Block<2> at(Role<2, PositionTag>) const noexcept { return position; }
};

// The mechanisation of one receiver, as a process model of the whole state.
template <class Parts, bool Coupled>
struct ReceiverProcess {
  using Input = inertial::PlanarImuSample;
  static constexpr int kNoise = inertial::PlanarMechanization::kNoise;
  inertial::PlanarMechanization mechanization;
  Parts parts;

  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& x, const Input& u, double dt_s, const W& w, Y& y) const {
    Writer<Y> writer{y, parts};
    return mechanization.propagate(Reader<X>{x, parts}, u, dt_s, w, writer);
  }

 private:
  template <class X>
  struct Reader {
    const X& x;
    const Parts& parts;
    template <class R>
    [[nodiscard]] auto operator()(R role) const {
      return x(parts.at(role));
    }
  };
  template <class Y>
  struct Writer {
    static constexpr bool kJacobian = Y::kJacobian;
    Y& y;
    const Parts& parts;
    template <class R>
    [[nodiscard]] auto next(R role) {
      return y.next(parts.at(role));
    }
    template <class To, class From>
    [[nodiscard]] auto transition(To to, From from) {
      if constexpr (Coupled || !std::same_as<From, Role<1, HeadingTag>>) {
        return y.transition(parts.at(to), parts.at(from));
      } else {
        return DiscardedJacobian{};
      }
    }
    template <class R>
    [[nodiscard]] auto noise(R role) {
      return y.noise(parts.at(role));
    }
  };
};

// A block that may be absent.
bool present(const Block<1>& block) noexcept { return block.slot >= 0; }

// The boundary of one link.
template <class Receiver>
struct LinkModel {
  using Frame = PlanarFrame;
  static constexpr int kDim = 1;
  RangeDifference<PlanarFrame, Known<2>, Known<2>, Receiver> range;
  Block<1> clock{};      // of the transmitter, where estimated
  Block<1> multipath{};  // where estimated
  Block<1> reference{};  // error of the reference receiver's boundary, where differenced
  double ambiguity_m = std::numeric_limits<double>::infinity();

  template <class X, class Y>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    if (!range.predict(x, y)) return false;
    add(x, y, clock, -1.0);
    add(x, y, multipath, 1.0);
    add(x, y, reference, -1.0);
    return true;
  }
  [[nodiscard]] double residual(int /*row*/, double z, double predicted) const noexcept {
    return std::isfinite(ambiguity_m) ? std::remainder(z - predicted, ambiguity_m) : z - predicted;
  }

 private:
  template <class X, class Y>
  static void add(const X& x, Y& y, const Block<1>& block, double sign) {
    if (!present(block)) return;
    y.value(0) += sign * x(block)[0];
    y.jacobian(block)(0) += sign;
  }
};

// The boundary of a receiver that stands still, where the clocks are states: minus the clock.
struct ReferenceModel {
  static constexpr int kDim = 1;
  Block<1> clock{};
  double ambiguity_m = std::numeric_limits<double>::infinity();

  template <class X, class Y>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    y.value(0) = -x(clock)[0];
    y.jacobian(clock)(0) = -1.0;
    return true;
  }
  [[nodiscard]] double residual(int /*row*/, double z, double predicted) const noexcept {
    return std::isfinite(ambiguity_m) ? std::remainder(z - predicted, ambiguity_m) : z - predicted;
  }
};

// b <- e^(-dt/tau) b + what keeps its variance.
struct GaussMarkov {
  static constexpr int kNoise = 1;
  MultipathBias bias;
  Block<1> part{};

  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& x, double dt_s, const W& w, Y& y) const {
    const double decay = std::exp(-dt_s / bias.time_constant_s);
    const double gain = bias.sigma_m * std::sqrt(std::max(0.0, 1.0 - decay * decay));
    y.next(part)[0] = decay * x(part)[0] + gain * w[0];
    if constexpr (Y::kJacobian) {
      y.transition(part, part)(0, 0) = decay;
      y.noise(part)(0, 0) = gain;
    }
    return true;
  }
};

std::string indexed(const char* name, std::size_t i, const char* field) {
  return std::string(name) + "[" + std::to_string(i) + "]." + field;
}
[[noreturn]] void refuse(const std::string& name, double value, const char* rule) {
  throw std::invalid_argument(name + " = " + std::to_string(value) + ": " + rule);
}
void require_sigma(const std::string& name, double value) {
  if (!(value >= 0.0) || std::isinf(value)) refuse(name, value, "a standard deviation, zero or more, expected");
}
void require_finite(const std::string& name, const Eigen::Vector2d& v) {
  for (int i = 0; i < 2; ++i) {
    if (!std::isfinite(v[i])) refuse(name + "[" + std::to_string(i) + "]", v[i], "a finite number expected");
  }
}
void require_positive(const std::string& name, double value, bool infinite) {
  if (!(value > 0.0) || (std::isinf(value) && !infinite)) refuse(name, value, "a positive number expected");
}
double variance(double sigma) noexcept { return std::pow(std::max(sigma, kLeastSigma), 2); }

void check(const PlanarStart& start, std::size_t i) {
  if (!std::isfinite(start.heading_rad)) {
    refuse(indexed("starts", i, "heading_rad"), start.heading_rad, "a finite number expected");
  }
  require_finite(indexed("starts", i, "velocity_mps"), start.velocity_mps);
  require_finite(indexed("starts", i, "position_m"), start.position_m);
  require_sigma(indexed("starts", i, "heading_sigma_rad"), start.heading_sigma_rad);
  require_sigma(indexed("starts", i, "velocity_sigma_mps"), start.velocity_sigma_mps);
  require_sigma(indexed("starts", i, "position_sigma_m"), start.position_sigma_m);
}

void check(const OfdmInertialOptions& options) {
  require_sigma("imu.gyro_sigma_radps", options.imu.gyro_sigma_radps);
  require_sigma("imu.accelerometer_sigma_mps2", options.imu.accelerometer_sigma_mps2);
  require_positive("ambiguity_m", options.ambiguity_m, true);
  if (!(options.gate.nis > 0.0)) refuse("gate.nis", options.gate.nis, "a positive number expected");
  if (!(options.gate.residual > 0.0)) refuse("gate.residual", options.gate.residual, "a positive number expected");
  require_sigma("gate.residual_sigmas", options.gate.residual_sigmas);
  if (options.transmitter_clock) {
    require_sigma("transmitter_clock.white_frequency_m2ps", options.transmitter_clock->white_frequency_m2ps);
    require_sigma("transmitter_clock.frequency_walk_m2ps3", options.transmitter_clock->frequency_walk_m2ps3);
  }
  require_sigma("clock_drift_sigma_mps", options.clock_drift_sigma_mps);
  if (options.multipath) {
    require_sigma("multipath.sigma_m", options.multipath->sigma_m);
    require_positive("multipath.time_constant_s", options.multipath->time_constant_s, false);
  }
  require_sigma("unmodelled.acceleration_mps2", options.unmodelled.acceleration_mps2);
  require_sigma("unmodelled.yaw_rate_radps", options.unmodelled.yaw_rate_radps);
  require_positive("yaw_rate_range_radps", options.yaw_rate_range_radps, true);
  require_positive("specific_force_range_mps2", options.specific_force_range_mps2, true);
}

std::size_t check_counts(std::span<const Eigen::Vector2d> transmitters_m, std::span<const PlanarStart> starts,
                         const OfdmInertialOptions& options) {
  using Nav = OfdmInertialNavigator;
  if (starts.empty() || starts.size() > static_cast<std::size_t>(Nav::kMaxReceivers)) {
    throw std::invalid_argument("starts: 1 ... " + std::to_string(Nav::kMaxReceivers) + " receivers expected, got " +
                                std::to_string(starts.size()));
  }
  if (transmitters_m.size() > static_cast<std::size_t>(Nav::kMaxTransmitters)) {
    throw std::invalid_argument("transmitters_m: at most " + std::to_string(Nav::kMaxTransmitters) + " expected, got " +
                                std::to_string(transmitters_m.size()));
  }
  const std::size_t states = Nav::kReceiverStates * starts.size() +
                             (options.transmitter_clock ? 2 * transmitters_m.size() : 0) +
                             (options.multipath ? starts.size() * transmitters_m.size() : 0);
  if (states > static_cast<std::size_t>(Nav::kMaxStates)) {
    throw std::invalid_argument("the receivers, clocks and multipath biases make " + std::to_string(states) +
                                " states; at most " + std::to_string(Nav::kMaxStates) + " are possible");
  }
  for (std::size_t i = 0; i < transmitters_m.size(); ++i) {
    require_finite("transmitters_m[" + std::to_string(i) + "]", transmitters_m[i]);
  }
  for (std::size_t i = 0; i < starts.size(); ++i) check(starts[i], i);
  check(options);
  return states;
}

OfdmInertialNavigator::State::Fixed fixed_of(const PlanarStart& start) {
  OfdmInertialNavigator::State::Fixed x;
  x.x << start.heading_rad, start.velocity_mps, start.position_m;
  return x;
}
Eigen::Matrix<double, 5, 5> covariance_of(const PlanarStart& start) {
  const double v = variance(start.velocity_sigma_mps);
  const double p = variance(start.position_sigma_m);
  return Eigen::Matrix<double, 5, 1>(variance(start.heading_sigma_rad), v, v, p, p).asDiagonal();
}

ExtendedKalmanFilter<OfdmInertialNavigator::State> make_filter(std::span<const Eigen::Vector2d> transmitters_m,
                                                               std::span<const PlanarStart> starts,
                                                               const OfdmInertialOptions& options) {
  const std::size_t states = check_counts(transmitters_m, starts, options);
  // One more for the reference's error of each transmitter.
  return {fixed_of(starts[0]), covariance_of(starts[0]), static_cast<int>(states + transmitters_m.size()),
          static_cast<int>(states + transmitters_m.size())};
}

}  // namespace

OfdmInertialNavigator::OfdmInertialNavigator(std::span<const Eigen::Vector2d> transmitters_m,
                                             std::span<const PlanarStart> starts, const OfdmInertialOptions& options)
    : options_(options), filter_(make_filter(transmitters_m, starts, options)) {
  for (std::size_t i = 0; i < starts.size(); ++i) {
    const PlanarStart& start = starts[i];
    Receiver receiver;
    receiver.start_m = start.position_m;
    if (i > 0) {
      const std::string name = "receiver " + std::to_string(i);
      receiver.heading =
          filter_.join(start.heading_rad, variance(start.heading_sigma_rad), name + " heading", BlockKind::kAngle);
      receiver.velocity = filter_.join<2>(
          start.velocity_mps, variance(start.velocity_sigma_mps) * Eigen::Matrix2d::Identity(), name + " velocity");
      receiver.position = filter_.join<2>(
          start.position_m, variance(start.position_sigma_m) * Eigen::Matrix2d::Identity(), name + " position");
    }
    receivers_.push_back(receiver);
  }
  for (std::size_t k = 0; k < transmitters_m.size(); ++k) {
    Transmitter transmitter;
    transmitter.position_m = transmitters_m[k];
    if (options_.transmitter_clock) {
      const std::string name = "transmitter " + std::to_string(k);
      transmitter.bias = filter_.join(0.0, variance(0.0), name + " clock bias");
      transmitter.drift = filter_.join(0.0, variance(options_.clock_drift_sigma_mps), name + " clock drift");
    }
    transmitters_.push_back(transmitter);
  }
  multipath_.resize(receivers_.size() * transmitters_.size());
  if (options_.multipath) {
    for (std::size_t i = 0; i < multipath_.size(); ++i) {
      multipath_[i] = filter_.join(
          0.0, variance(options_.multipath->sigma_m),
          "path " + std::to_string(i / transmitters_.size()) + "-" + std::to_string(i % transmitters_.size()));
    }
  }
}

int OfdmInertialNavigator::receiver_at(int receiver) const noexcept {
  if (receiver < 0 || receiver >= receivers()) return -1;
  if (receiver == 0) return 0;
  return state().layout().offset(receivers_[static_cast<std::size_t>(receiver)].heading);
}

int OfdmInertialNavigator::clock_at(int transmitter) const noexcept {
  if (transmitter < 0 || transmitter >= transmitters() || !options_.transmitter_clock) return -1;
  return state().layout().offset(transmitters_[static_cast<std::size_t>(transmitter)].bias);
}

int OfdmInertialNavigator::multipath_at(int receiver, int transmitter) const noexcept {
  if (!options_.multipath || receiver < 0 || receiver >= receivers() || transmitter < 0 ||
      transmitter >= transmitters()) {
    return -1;
  }
  return state().layout().offset(
      multipath_[static_cast<std::size_t>(receiver) * transmitters_.size() + static_cast<std::size_t>(transmitter)]);
}

UpdateStatus OfdmInertialNavigator::move(int receiver, const inertial::PlanarImuSample& sample,
                                         const inertial::PlanarImuNoise& noise, double dt_s) {
  if (receiver < 0 || receiver >= receivers()) return UpdateStatus::kStaleHandle;
  const Receiver& r = receivers_[static_cast<std::size_t>(receiver)];
  const inertial::PlanarMechanization mechanization{noise};
  const BlockParts parts{r.heading, r.velocity, r.position};
  if (options_.coupling == HeadingCoupling::kLiteral) {
    return receiver == 0 ? filter_.predict(ReceiverProcess<FixedParts, false>{mechanization, {}}, sample, dt_s)
                         : filter_.predict(ReceiverProcess<BlockParts, false>{mechanization, parts}, sample, dt_s);
  }
  return receiver == 0 ? filter_.predict(ReceiverProcess<FixedParts, true>{mechanization, {}}, sample, dt_s)
                       : filter_.predict(ReceiverProcess<BlockParts, true>{mechanization, parts}, sample, dt_s);
}

UpdateStatus OfdmInertialNavigator::predict(int receiver, const inertial::PlanarImuSample& sample, double dt_s) {
  if (!sample.all_finite()) return coast(receiver, dt_s);
  const bool saturated = std::abs(sample.yaw_rate_radps) >= options_.yaw_rate_range_radps ||
                         sample.specific_force_b_mps2.cwiseAbs().maxCoeff() >= options_.specific_force_range_mps2;
  // The motion is at least what a saturated sensor reads, and is off by as much as a vehicle may do.
  if (saturated) {
    const UpdateStatus status = move_unmodelled(receiver, sample, dt_s);
    return status == UpdateStatus::kNonFinite ? coast(receiver, dt_s) : status;
  }
  const UpdateStatus status = move(receiver, sample, options_.imu, dt_s);
  if (status == UpdateStatus::kNonFinite) return coast(receiver, dt_s);
  if (status == UpdateStatus::kAccepted) receivers_[static_cast<std::size_t>(receiver)].episode.good(dt_s);
  return status;
}

UpdateStatus OfdmInertialNavigator::coast(int receiver, double dt_s) { return move_unmodelled(receiver, {}, dt_s); }

UpdateStatus OfdmInertialNavigator::move_unmodelled(int receiver, const inertial::PlanarImuSample& sample,
                                                    double dt_s) {
  if (receiver < 0 || receiver >= receivers()) return UpdateStatus::kStaleHandle;
  inertial::UnmodelledEpisode& episode = receivers_[static_cast<std::size_t>(receiver)].episode;
  inertial::UnmodelledEpisode next = episode;
  const double factor = next.silent(dt_s);
  const UnmodelledMotion& motion = options_.unmodelled;
  const UpdateStatus status =
      move(receiver, sample, {factor * motion.yaw_rate_radps, factor * motion.acceleration_mps2}, dt_s);
  if (status == UpdateStatus::kAccepted) episode = next;
  return status;
}

UpdateStatus OfdmInertialNavigator::predict_links(double dt_s) {
  if (!(dt_s > 0.0) || std::isinf(dt_s)) return UpdateStatus::kTimeNotAdvancing;
  if (options_.transmitter_clock) {
    for (const Transmitter& t : transmitters_) {
      const clock::TwoState process{*options_.transmitter_clock, t.bias, t.drift};
      const UpdateStatus status = filter_.predict(process, dt_s);
      if (status != UpdateStatus::kAccepted) return status;
    }
  }
  if (options_.multipath) {
    for (const Block<1>& bias : multipath_) {
      const UpdateStatus status = filter_.predict(GaussMarkov{*options_.multipath, bias}, dt_s);
      if (status != UpdateStatus::kAccepted) return status;
    }
  }
  return UpdateStatus::kAccepted;
}

namespace {

RangeChangeReport summary(const UpdateReport<1>& report) {
  return {report.status, report.innovation[0], report.covariance(0, 0), report.nis};
}

}  // namespace

RangeChange OfdmInertialNavigator::predicted(int receiver, int transmitter) const {
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  RangeChange out{receiver, transmitter, kNan, kNan};
  if (receiver < 0 || receiver >= receivers() || transmitter < 0 || transmitter >= transmitters()) return out;
  const Receiver& r = receivers_[static_cast<std::size_t>(receiver)];
  const Transmitter& t = transmitters_[static_cast<std::size_t>(transmitter)];
  const Block<1>& multipath =
      multipath_[static_cast<std::size_t>(receiver) * transmitters_.size() + static_cast<std::size_t>(transmitter)];
  const auto ask = [&](auto part) {
    const LinkModel<decltype(part)> model{
        {Known<2>(t.position_m), Known<2>(r.start_m), part}, t.bias, multipath, {}, options_.ambiguity_m};
    LayoutPrediction<1, State> y(filter_.state());
    if (!model.predict(filter_.state(), y)) return;
    const auto P = filter_.covariance();
    double variance = 0.0;
    for (int a = 0; a < y.touched.size(); ++a) {
      for (int b = 0; b < y.touched.size(); ++b) {
        variance += y.H(0, a) * y.H(0, b) * P(y.touched.component(a), y.touched.component(b));
      }
    }
    out.range_change_m = y.z[0];
    out.sigma_m = std::sqrt(std::max(0.0, variance));
  };
  receiver == 0 ? ask(kPlanarPosition) : ask(r.position);
  return out;
}

RangeChangeReport OfdmInertialNavigator::take_reference(const RangeChange& row) {
  Transmitter& t = transmitters_[static_cast<std::size_t>(row.transmitter)];
  if (options_.transmitter_clock) {
    return summary(filter_.update(ReferenceModel{t.bias, options_.ambiguity_m}, row.range_change_m,
                                  row.sigma_m * row.sigma_m, options_.gate));
  }
  RangeChangeReport report;
  if (!std::isfinite(row.range_change_m)) {
    report.status = UpdateStatus::kNonFinite;
  } else if (!options_.reference_receiver || present(t.reference_error)) {
    report.status = UpdateStatus::kTooManyRows;
  } else {
    t.reference_m = row.range_change_m;
    t.reference_error = filter_.join(0.0, row.sigma_m * row.sigma_m, "reference error");
    report.status = UpdateStatus::kAccepted;
  }
  return report;
}

RangeChangeReport OfdmInertialNavigator::take(const RangeChange& row) {
  const bool known = row.transmitter >= 0 && row.transmitter < transmitters() && row.receiver >= kReferenceReceiver &&
                     row.receiver < receivers();
  if (!known) {
    RangeChangeReport report;
    report.status = UpdateStatus::kStaleHandle;
    return report;
  }
  if (row.receiver == kReferenceReceiver) return take_reference(row);
  const Receiver& r = receivers_[static_cast<std::size_t>(row.receiver)];
  const Transmitter& t = transmitters_[static_cast<std::size_t>(row.transmitter)];
  const bool differenced = options_.reference_receiver && !options_.transmitter_clock;
  if (differenced && !present(t.reference_error)) {
    RangeChangeReport report;
    report.status = UpdateStatus::kNonFinite;
    return report;
  }
  const double z = row.range_change_m - (differenced ? t.reference_m : 0.0);
  const Block<1>& multipath = multipath_[static_cast<std::size_t>(row.receiver) * transmitters_.size() +
                                         static_cast<std::size_t>(row.transmitter)];
  const auto take_at = [&](auto receiver) {
    const LinkModel<decltype(receiver)> model{{Known<2>(t.position_m), Known<2>(r.start_m), receiver},
                                              t.bias,
                                              multipath,
                                              t.reference_error,
                                              options_.ambiguity_m};
    return summary(filter_.update(model, z, row.sigma_m * row.sigma_m, options_.gate));
  };
  return row.receiver == 0 ? take_at(kPlanarPosition) : take_at(r.position);
}

void OfdmInertialNavigator::update(std::span<const RangeChange> epoch, std::span<RangeChangeReport> reports) {
  const std::size_t rows = std::min(epoch.size(), reports.size());
  for (std::size_t i = 0; i < rows; ++i) {
    const double sigma = epoch[i].sigma_m;
    if (sigma > 0.0 && std::isfinite(sigma)) {
      reports[i] = take(epoch[i]);
    } else {
      reports[i] =
          RangeChangeReport{std::isfinite(sigma) ? UpdateStatus::kNotPositiveDefinite : UpdateStatus::kNonFinite};
    }
  }
  for (Transmitter& t : transmitters_) {
    if (!present(t.reference_error)) continue;
    static_cast<void>(filter_.marginalise(t.reference_error));
    t.reference_error = {};
    t.reference_m = std::numeric_limits<double>::quiet_NaN();
  }
}

}  // namespace soopnav::navigation
