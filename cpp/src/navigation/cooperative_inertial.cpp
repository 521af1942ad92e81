#include "soopnav/navigation/cooperative_inertial.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <sstream>
#include <stdexcept>

#include "soopnav/clock/two_state.hpp"
#include "soopnav/core/joint_process.hpp"
#include "soopnav/estimation/extended_kalman_filter.hpp"
#include "soopnav/estimation/rts_smoother.hpp"
#include "soopnav/inertial/coning_sculling.hpp"
#include "soopnav/inertial/unmodelled_motion.hpp"
#include "soopnav/navigation/cooperative_motion.hpp"

namespace soopnav::navigation {
namespace {

using inertial::ImuIncrement;
using inertial::ImuStatus;
using inertial::kAccelerometerBias;
using inertial::kGyroBias;

constexpr double kInertialSlackS = 1e-9;
constexpr int kSpareSteps = 8;  // of the smoother, for clocks reopened between predictions

void require_inertial(bool holds, const char* name, double value, const char* rule) {
  if (holds) return;
  std::ostringstream text;
  text << name << ": " << value << "; " << rule;
  throw std::invalid_argument(text.str());
}

const InertialPairOptions& checked_inertial(const InertialPairOptions& o) {
  const auto positive = [](double value, const char* name) {
    require_inertial(value > 0.0 && std::isfinite(value), name, value, "it must be positive and finite");
  };
  const auto not_negative = [](double value, const char* name) {
    require_inertial(value >= 0.0 && std::isfinite(value), name, value, "it must be finite and not negative");
  };
  not_negative(o.clock_noise.white_frequency_m2ps, "white_frequency_m2ps");
  not_negative(o.clock_noise.frequency_walk_m2ps3, "frequency_walk_m2ps3");
  not_negative(o.gap.rate_sigma_radps, "rate_sigma_radps");
  not_negative(o.gap.acceleration_sigma_mps2, "acceleration_sigma_mps2");
  positive(o.tilt_sigma_rad, "tilt_sigma_rad");
  positive(o.heading_sigma_rad, "heading_sigma_rad");
  positive(o.gyro_bias_sigma_radps, "gyro_bias_sigma_radps");
  positive(o.accelerometer_bias_sigma_mps2, "accelerometer_bias_sigma_mps2");
  require_inertial(std::abs(o.q_n_b.norm() - 1.0) < 1e-6, "q_n_b", o.q_n_b.norm(), "its norm must be 1");
  require_inertial(o.waiting_samples >= 1 && o.waiting_samples <= (std::size_t{1} << 20), "waiting_samples",
                   static_cast<double>(o.waiting_samples), "it must lie in 1 ... 1048576");
  require_inertial(o.smoother_steps >= 0 && o.smoother_steps <= 1'000'000, "smoother_steps", o.smoother_steps,
                   "it must lie in 0 ... 1000000");
  return o;
}

class StrapdownPairFilter final : public InertialFilter {
 public:
  explicit StrapdownPairFilter(const InertialPairOptions& options)
      : options_(checked_inertial(options)),
        process_{inertial::StrapdownMechanization<EcefFrame>(options.noise), {options.clock_noise}},
        gap_{{options.gap, options.noise}, {options.clock_noise}},
        filter_(State{}, Square::Identity()),
        kept_(filter_),
        smoother_(std::max(options.smoother_steps, 1) + kSpareSteps),
        guard_(options.limits),
        coning_(options.coning_samples),
        pieces_(options.waiting_samples) {
    times_s_.reserve(static_cast<std::size_t>(smoother_.capacity()));
  }

  void restart(double t_s, const PairVector& mean, const PairSquare& P) override {
    require_inertial(std::isfinite(t_s), "t_s", t_s, "it must be finite");
    State x = filter_.state();
    Square full = Square::Zero();
    x.x.head<kPairDim>() = mean;
    full.topLeftCorner<kPairDim, kPairDim>() = P;
    constexpr int kRest = State::kDim - kPairDim;
    if (started_) {
      full.bottomRightCorner<kRest, kRest>() = filter_.covariance().bottomRightCorner<kRest, kRest>();
    } else {
      begin_attitude(mean.head<3>(), x, full);
    }
    filter_ = Filter(x, full);
    kept_ = filter_;
    if (!started_) guard_.start(t_s);
    started_ = true;
    // Samples up to here have been used for nothing: their time is over.
    time_s_ = t_s;
    asked_s_ = t_s;
    drop_before(t_s);
    smoother_.clear();
    times_s_.clear();
    split_ = false;
    spare_used_ = 0;
    open_step(Square::Zero());
    complete_ = true;
    save();
  }

  ImuStatus add_imu(double t_s, const Eigen::Vector3d& delta_theta_b,
                    const Eigen::Vector3d& delta_velocity_b) noexcept override {
    // Ranges are of rates and forces: the increments over the period they speak for.
    const double since = t_s - guard_.last_s();
    const double period = guard_.limits().period_s;
    const double speaks_for = !(since > 0.0) || since > guard_.limits().gap_periods * period ? period : since;
    const auto verdict = guard_.judge(t_s, delta_theta_b / speaks_for, delta_velocity_b / speaks_for);
    if (!(verdict.step_s > 0.0)) return verdict.status;
    double unknown_s = verdict.missing_s;
    if (unknown_s > 0.0 || !verdict.usable()) coning_.reset();
    if (!verdict.usable()) unknown_s += verdict.step_s;
    if (unknown_s > 0.0) push({.end_s = verdict.usable() ? t_s - verdict.step_s : t_s, .dt_s = unknown_s});
    if (verdict.usable()) {
      push({.end_s = t_s,
            .dt_s = verdict.step_s,
            .known = true,
            .increment = coning_.correct({delta_theta_b, delta_velocity_b, verdict.step_s})});
    }
    return verdict.status;
  }

  UpdateStatus predict(double dt_s, PairSquare* cross) noexcept override {
    if (!(dt_s > 0.0) || std::isinf(dt_s)) return UpdateStatus::kTimeNotAdvancing;
    const Saved before = snapshot();
    const Filter filter_before = filter_;
    const Square& P0 = filter_before.covariance();
    const bool wanted = cross != nullptr || options_.smoother_steps > 0;
    phi_ = Square::Identity();
    const double target_s = asked_s_ + dt_s;
    UpdateStatus status = UpdateStatus::kAccepted;
    while (status == UpdateStatus::kAccepted && target_s - time_s_ > kInertialSlackS)
      status = advance(target_s, wanted);
    if (status != UpdateStatus::kAccepted) {
      filter_ = filter_before;
      put_back(before);
      return status;
    }
    asked_s_ = target_s;
    if (wanted) {
      const Square across = P0 * phi_.transpose();
      if (cross != nullptr) *cross = across.topLeftCorner<kPairDim, kPairDim>();
      if (options_.smoother_steps > 0) {
        close_steps(filter_before, before.asked_s);
        open_step(across);
      }
    }
    return status;
  }

  UpdateReport<2> update(const PairModel<>& model, int /*number*/, const PairObservation& observed,
                         const Gate& gate) noexcept override {
    const auto report = filter_.update(model, observed.z, observed.R, gate);
    touched_ = touched_ || report.accepted();
    return report;
  }
  UpdateReport<1> update(const PlaneDistance<>& model, double distance_m, double variance_m2) noexcept override {
    const auto report = filter_.update(model, distance_m, variance_m2);
    touched_ = touched_ || report.accepted();
    return report;
  }
  UpdateStatus reopen_clock(double theta_m2, double alpha_m2ps2) noexcept override {
    if (!(theta_m2 >= 0.0) || !(alpha_m2ps2 >= 0.0) || !std::isfinite(theta_m2 + alpha_m2ps2)) {
      return UpdateStatus::kNonFinite;
    }
    Square P = filter_.covariance();
    P(State::at(kClockBias), State::at(kClockBias)) += theta_m2;
    P(State::at(kClockDrift), State::at(kClockDrift)) += alpha_m2ps2;
    const Filter before = filter_;
    filter_.restore(filter_.state(), P);
    split_step(before);
    return UpdateStatus::kAccepted;
  }
  UpdateStatus shift_clock(double theta_m, double alpha_mps) noexcept override {
    if (!std::isfinite(theta_m + alpha_mps)) return UpdateStatus::kNonFinite;
    State x = filter_.state();
    x.x[State::at(kClockBias)] += theta_m;
    x.x[State::at(kClockDrift)] += alpha_mps;
    const Filter before = filter_;
    filter_.restore(x, filter_.covariance());
    split_step(before);
    return UpdateStatus::kAccepted;
  }
  [[nodiscard]] PairVector mean() const noexcept override { return filter_.state().x.head<kPairDim>(); }
  [[nodiscard]] PairSquare covariance() const noexcept override {
    return filter_.covariance().topLeftCorner<kPairDim, kPairDim>();
  }
  [[nodiscard]] bool smoothable() const noexcept override { return false; }
  void save() noexcept override {
    kept_ = filter_;
    saved_ = snapshot();
    kept_steps_ = {step_, earlier_, step_open_, split_, touched_};
  }
  void load() noexcept override {
    filter_ = kept_;
    put_back(saved_);
    step_ = kept_steps_.step;
    earlier_ = kept_steps_.earlier;
    step_open_ = kept_steps_.open;
    split_ = kept_steps_.split;
    touched_ = kept_steps_.touched;
  }

  [[nodiscard]] InertialPairEstimate estimate() const noexcept override {
    return estimate_of(asked_s_, filter_.state(), filter_.covariance());
  }
  [[nodiscard]] std::vector<InertialPairEstimate> smooth() override {
    std::vector<InertialPairEstimate> out;
    if (options_.smoother_steps == 0) return out;
    close_steps(filter_, asked_s_);
    if (!complete_ || smoother_.smooth() != SmoothStatus::kDone) return out;
    const auto steps = smoother_.smoothed();
    out.reserve(steps.size());
    for (std::size_t k = 0; k < steps.size(); ++k) out.push_back(estimate_of(times_s_[k], steps[k].state, steps[k].P));
    return out;
  }

 private:
  using State = ComposedState<EcefFrame, Role<3, PositionTag>, Role<3, VelocityTag>, Role<1, ClockBiasTag>,
                              Role<1, ClockDriftTag>, Role<3, AttitudeTag>, Role<3, inertial::GyroBiasTag>,
                              Role<3, inertial::AccelerometerBiasTag>>;
  using Filter = ExtendedKalmanFilter<State>;
  using Square = Filter::Square;
  using Process = JointProcess<inertial::StrapdownMechanization<EcefFrame>, clock::TwoState<>>;
  using Gap = JointProcess<inertial::StrapdownGap, clock::TwoState<>>;
  static_assert(State::kDim == InertialPairEstimate::kDim && State::at(kClockDrift) == kPairDim - 1);

  // A stretch of time and what is known of the motion in it.
  struct Piece {
    double end_s = 0.0;
    double dt_s = 0.0;
    bool known = false;
    ImuIncrement increment{};
  };
  // Where a prediction stands: pieces before `read` are used, and of that at `read` all but what follows `time_s`.
  struct Saved {
    double time_s = 0.0, asked_s = 0.0;
    std::size_t read = 0;
    inertial::UnmodelledEpisode episode{};
  };
  [[nodiscard]] Saved snapshot() const noexcept { return {time_s_, asked_s_, read_, episode_}; }
  void put_back(const Saved& saved) noexcept {
    time_s_ = saved.time_s;
    asked_s_ = saved.asked_s;
    // What has been written over since is time that nobody knows of.
    read_ = write_ - saved.read > pieces_.size() ? write_ - pieces_.size() : saved.read;
    episode_ = saved.episode;
  }
  [[nodiscard]] Piece& piece(std::size_t i) noexcept { return pieces_[i % pieces_.size()]; }

  void push(const Piece& next) noexcept {
    if (write_ - read_ == pieces_.size()) {
      // No room: the oldest is integrated now, if the state takes it.
      const double end_s = piece(read_).end_s;
      while (end_s - time_s_ > kInertialSlackS && advance(end_s, false) == UpdateStatus::kAccepted) {
      }
      if (write_ - read_ == pieces_.size()) ++read_;
    }
    piece(write_++) = next;
  }
  void drop_before(double t_s) noexcept {
    while (read_ < write_ && piece(read_).end_s <= t_s + kInertialSlackS) ++read_;
  }

  void begin_attitude(const Eigen::Vector3d& p_e, State& x, Square& P) const {
    const Eigen::Matrix3d enu = east_north_up(p_e);
    Eigen::Matrix3d T_e_n;
    T_e_n << enu.col(1), enu.col(0), -enu.col(2);
    const Eigen::Matrix3d T_n_b = options_.q_n_b.toRotationMatrix();
    const Eigen::Quaterniond q(T_e_n * T_n_b);
    x(kAttitude) << q.w(), q.x(), q.y(), q.z();
    x(kGyroBias).setZero();
    x(kAccelerometerBias).setZero();
    const auto square = [](double s) { return s * s; };
    const Eigen::Vector3d about_n(square(options_.tilt_sigma_rad), square(options_.tilt_sigma_rad),
                                  square(options_.heading_sigma_rad));
    constexpr int kA = State::at(kAttitude);
    P.block<3, 3>(kA, kA) = T_n_b.transpose() * about_n.asDiagonal() * T_n_b;
    P.block<3, 3>(kA + 3, kA + 3) = square(options_.gyro_bias_sigma_radps) * Eigen::Matrix3d::Identity();
    P.block<3, 3>(kA + 6, kA + 6) = square(options_.accelerometer_bias_sigma_mps2) * Eigen::Matrix3d::Identity();
    P = (0.5 * (P + P.transpose())).eval();
  }

  // One piece further, at most to `to_s`.
  UpdateStatus advance(double to_s, bool keep_transition) noexcept {
    while (read_ < write_ && piece(read_).end_s - time_s_ <= kInertialSlackS) ++read_;
    double end_s = to_s;
    bool known = false;
    if (read_ < write_) {
      const Piece& next = piece(read_);
      const double start_s = next.end_s - next.dt_s;
      if (start_s - time_s_ > kInertialSlackS) {
        end_s = std::min(to_s, start_s);
      } else {
        end_s = std::min(to_s, next.end_s);
        known = next.known;
      }
    }
    const double dt_s = end_s - time_s_;
    if (known) {
      const Piece& now = piece(read_);
      ImuIncrement part = now.increment.part(dt_s / now.dt_s);
      part.dt_s = dt_s;
      const UpdateStatus status = move(process_, part, dt_s, keep_transition);
      if (status != UpdateStatus::kAccepted) return status;
      episode_.good(dt_s);
    } else {
      const double factor = episode_.silent(dt_s);
      Gap gap = gap_;
      gap.first.motion.rate_sigma_radps *= factor;
      gap.first.motion.acceleration_sigma_mps2 *= factor;
      const UpdateStatus status = move(gap, detail::NoInput{}, dt_s, keep_transition);
      if (status != UpdateStatus::kAccepted) return status;
    }
    time_s_ = end_s;
    return UpdateStatus::kAccepted;
  }

  // The filter's own prediction, with the transition kept: a smoother needs that of all steps since its last record.
  template <class Model, class Input>
  UpdateStatus move(const Model& model, const Input& input, double dt_s, bool keep_transition) noexcept {
    Transition<State, Model::kNoise> y(filter_.state());
    if (!soopnav::detail::propagate(model, filter_.state(), input, dt_s, ZeroNoise{}, y)) {
      return UpdateStatus::kUndefined;
    }
    y.state.normalize();
    Square A;
    Square P;
    soopnav::detail::propagate_covariance(y, filter_.covariance(), A, P);
    if (!y.state.x.allFinite() || !P.allFinite()) return UpdateStatus::kNonFinite;
    filter_.restore(y.state, P);
    if (keep_transition) phi_ = (y.F.lazyProduct(phi_)).eval();
    return UpdateStatus::kAccepted;
  }

  void open_step(const Square& cross) noexcept {
    step_.predicted = filter_.state();
    step_.P_pred = filter_.covariance();
    step_.cross = cross;
    step_open_ = true;
    touched_ = false;
  }
  // The clock changed in the step that is open, from `before`. Until something is learnt that is noise of the
  // prediction that opened it; from then on it is a prediction of its own that takes no time, with the step cut in two.
  // The first half waits in `earlier_`, for `load` may yet undo the cut.
  void split_step(const Filter& before) noexcept {
    if (options_.smoother_steps == 0 || !step_open_) return;
    if (!touched_) {
      step_.predicted = filter_.state();
      step_.P_pred = filter_.covariance();
      return;
    }
    if (split_) spare_step(asked_s_);
    earlier_ = step_;
    earlier_.filtered = before.state();
    earlier_.P = before.covariance();
    split_ = true;
    open_step(before.covariance());
  }
  void close_steps(const Filter& filtered, double t_s) noexcept {
    if (!step_open_) return;
    if (split_) spare_step(t_s);
    split_ = false;
    step_.filtered = filtered.state();
    step_.P = filtered.covariance();
    step_open_ = false;
    put_down(step_, t_s);
  }
  void spare_step(double t_s) noexcept {
    ++spare_used_;
    put_down(earlier_, t_s);
  }
  void put_down(const StepRecord<State>& step, double t_s) noexcept {
    const int room = std::max(options_.smoother_steps, 1) + std::min(spare_used_, kSpareSteps);
    if (smoother_.size() >= room || smoother_.record(step) != SmoothStatus::kDone) {
      complete_ = false;
      return;
    }
    times_s_.push_back(t_s);
  }

  [[nodiscard]] static InertialPairEstimate estimate_of(double t_s, const State& x, const Square& P) noexcept {
    const auto q = x(kAttitude);
    return {t_s,          x.x.head<kPairDim>(),  Eigen::Quaterniond(q[0], q[1], q[2], q[3]),
            x(kGyroBias), x(kAccelerometerBias), P};
  }

  InertialPairOptions options_;
  Process process_;
  Gap gap_;
  Filter filter_;
  Filter kept_;
  Saved saved_{};
  RtsSmoother<State> smoother_;
  StepRecord<State> step_{};
  StepRecord<State> earlier_{};  // of a step cut in two, the first half
  bool step_open_ = false;
  bool split_ = false;
  bool touched_ = false;  // something was learnt since the step was opened
  int spare_used_ = 0;
  struct {
    StepRecord<State> step{}, earlier{};
    bool open = false, split = false, touched = false;
  } kept_steps_;
  bool complete_ = true;
  std::vector<double> times_s_;
  Square phi_ = Square::Identity();
  inertial::UnmodelledEpisode episode_;
  inertial::ImuGuard guard_;
  inertial::ConingSculling coning_;
  std::vector<Piece> pieces_;
  std::size_t read_ = 0;   // of all pieces ever, that in use
  std::size_t write_ = 0;  // and the next to come
  bool started_ = false;
  double time_s_ = std::numeric_limits<double>::quiet_NaN();   // of the state
  double asked_s_ = std::numeric_limits<double>::quiet_NaN();  // what predictions asked for
};

}  // namespace

std::unique_ptr<InertialFilter> inertial_filter(const InertialPairOptions& options) {
  return std::make_unique<StrapdownPairFilter>(options);
}

}  // namespace soopnav::navigation
