#include "soopnav/navigation/cooperative_filter.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "navigation/cooperative_checks.hpp"
#include "navigation/cooperative_iterate.hpp"
#include "navigation/cooperative_rows.hpp"
#include "soopnav/clock/two_state.hpp"
#include "soopnav/core/joint_process.hpp"
#include "soopnav/estimation/information_filter.hpp"
#include "soopnav/estimation/layout_kalman_filter.hpp"
#include "soopnav/process/nearly_constant_velocity.hpp"
#include "soopnav/process/random_walk.hpp"

namespace soopnav::navigation {

namespace {

using PairMotion = JointProcess<NearlyConstantVelocity<3>, clock::TwoState<>>;
using ClockWalk = JointProcess<RandomWalk<Role<1, ClockBiasTag>>, RandomWalk<Role<1, ClockDriftTag>>>;

// A clock's reading and rate are other ones from now on.
struct ClockShift {
  static constexpr int kNoise = 0;
  double theta_m, alpha_mps;
  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& /*x*/, double /*dt_s*/, const W& /*w*/, Y& y) const {
    y.next(kClockBias)[0] += theta_m;
    y.next(kClockDrift)[0] += alpha_mps;
    return true;
  }
};
// A number's regression on all that was there before it: what it shares with them.
struct Regression {
  static constexpr int kNoise = 1;  // none
  Block<1> block;
  std::span<const Block<1>> before;
  const Eigen::VectorXd& factors;  // of p, v, theta, alpha and of `before`

  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& /*x*/, double /*dt_s*/, const W& /*w*/, Y& y) const {
    y.transition(block, kPosition) = factors.head<3>().transpose();
    y.transition(block, kVelocity) = factors.segment<3>(3).transpose();
    y.transition(block, kClockBias)(0, 0) = factors[6];
    y.transition(block, kClockDrift)(0, 0) = factors[7];
    for (std::size_t k = 0; k < before.size(); ++k) {
      y.transition(block, before[k])(0, 0) = factors[kPairDim + static_cast<Eigen::Index>(k)];
    }
    return true;
  }
};
constexpr std::size_t kMostJoint = detail::kMaxTouched - kPairDim;

PairState pair_state(const PairVector& mean) {
  PairState state;
  state.x = mean;
  return state;
}

// P F': the position moves with the velocity, theta with alpha.
void cross_covariance(const PairSquare& P, double dt_s, PairSquare& cross) noexcept {
  cross = P;
  for (int i = 0; i < 3; ++i) cross.col(i) += dt_s * P.col(3 + i);
  cross.col(6) += dt_s * P.col(7);
}

PairMotion motion_of(const PairFilterOptions& o) {
  using pair_options::refuse;
  using pair_options::zero_or_more;
  zero_or_more("clock_noise.white_frequency_m2ps", o.clock_noise.white_frequency_m2ps);
  zero_or_more("clock_noise.frequency_walk_m2ps3", o.clock_noise.frequency_walk_m2ps3);
  zero_or_more("acceleration_psd_m2ps3", o.acceleration_psd_m2ps3);
  if (o.iterations < 1 || o.iterations > 20) refuse("iterations", o.iterations, "1 ... 20 expected");
  if (o.max_along_track < 0 || o.max_along_track > 64)
    refuse("max_along_track", o.max_along_track, "0 ... 64 expected");
  const double q = o.acceleration_psd_m2ps3;
  return {NearlyConstantVelocity<3>{{q, q, q}}, clock::TwoState<>{o.clock_noise}};
}

class JosephFilter final : public LinearisedFilter {
  using Filter = ExtendedKalmanFilter<LayoutState<EcefFrame, Role<3, PositionTag>, Role<3, VelocityTag>,
                                                  Role<1, ClockBiasTag>, Role<1, ClockDriftTag>>>;
  using AheadModel = PairModel<Known<3>, Known<3>, Block<1>>;

 public:
  explicit JosephFilter(const PairFilterOptions& options)
      : motion_(motion_of(options)),
        iterations_(options.iterations),
        room_(options.max_along_track),
        now_{Filter(PairState{}, PairSquare::Identity(), kPairDim + room_, room_), {}},
        kept_(now_),
        before_(now_),
        taken_(now_) {
    for (Kept* k : {&now_, &kept_, &before_, &taken_}) k->ahead.reserve(static_cast<std::size_t>(room_));
  }

  void restart(double /*t_s*/, const PairVector& mean, const PairSquare& P) override {
    now_.filter = Filter(pair_state(mean), P, kPairDim + room_, room_);
    now_.ahead.clear();
  }

  UpdateStatus predict(double dt_s, PairSquare* cross) noexcept override {
    const PairSquare P = covariance();
    const UpdateStatus status = now_.filter.predict(motion_, dt_s);
    if (status == UpdateStatus::kAccepted && cross != nullptr) cross_covariance(P, dt_s, *cross);
    return status;
  }

  UpdateReport<2> update(const PairModel<>& model, int number, const PairObservation& o,
                         const Gate& gate) noexcept override {
    if (iterations_ > 1) before_ = now_;
    const Ahead* ahead = find(number);
    if (ahead == nullptr) {
      const auto report = now_.filter.update(model, o.z, o.R, gate);
      if (report.accepted()) {
        iterate_pair(*this, model, LinearPair<>{}, 0.0, iterations_,
                     [&](const LinearPair<>& rows) { return now_.filter.update(rows, o.z, o.R).accepted(); });
      }
      return report;
    }
    const Block<1> block = ahead->block;
    const AheadModel along{model.beacon, model.t_s, model.anchor_p, model.anchor_v, block, model.anchor_drift_mps};
    const double before_m = now_.filter.state()(block)[0];
    const auto report = now_.filter.update(along, o.z, o.R, gate);
    if (report.accepted()) {
      iterate_pair(*this, model, LinearPair<Block<1>>{.rows = {}, .at = {}, .along_track = block}, before_m,
                   iterations_,
                   [&](const LinearPair<Block<1>>& rows) { return now_.filter.update(rows, o.z, o.R).accepted(); });
    }
    return report;
  }

  UpdateReport<2> update(const LinearPair<>& rows, int number, const PairObservation& o,
                         const Gate& gate) noexcept override {
    const Ahead* ahead = find(number);
    if (ahead == nullptr) return now_.filter.update(rows, o.z, o.R, gate);
    return now_.filter.update(LinearPair<Block<1>>{rows.rows, rows.at, ahead->block, rows.ahead_m}, o.z, o.R, gate);
  }
  UpdateReport<1> update(const PlaneDistance<>& model, double distance_m, double variance_m2) noexcept override {
    return now_.filter.update(model, distance_m, variance_m2);
  }

  UpdateStatus reopen_clock(double theta_m2, double alpha_m2ps2) noexcept override {
    if (!(theta_m2 >= 0.0) || !(alpha_m2ps2 >= 0.0)) return UpdateStatus::kNotPositiveDefinite;
    return now_.filter.predict(ClockWalk{{kClockBias, {theta_m2}}, {kClockDrift, {alpha_m2ps2}}}, 1.0);
  }
  UpdateStatus shift_clock(double theta_m, double alpha_mps) noexcept override {
    return now_.filter.predict(ClockShift{theta_m, alpha_mps}, 1.0);
  }

  [[nodiscard]] PairVector mean() const noexcept override { return now_.filter.state().x().head<kPairDim>(); }
  [[nodiscard]] PairSquare covariance() const noexcept override {
    return now_.filter.covariance().topLeftCorner<kPairDim, kPairDim>();
  }

  bool join_along_track(int number, double sigma_m) noexcept override {
    if (find(number) != nullptr) return true;
    if (static_cast<int>(now_.ahead.size()) >= room_) return false;
    const Block<1> block = now_.filter.join(0.0, sigma_m * sigma_m, "along-track error");
    if (!now_.filter.state().layout().holds(block)) return false;
    now_.ahead.push_back({number, block});
    return true;
  }
  bool join_along_track(std::span<const int> numbers, const Eigen::VectorXd& mean_m,
                        const Eigen::MatrixXd& joint) noexcept override {
    const auto n = static_cast<Eigen::Index>(numbers.size());
    if (!now_.ahead.empty() || static_cast<int>(n) > room_ || numbers.size() > kMostJoint || mean_m.size() < n ||
        joint.rows() < kPairDim + n || joint.cols() < kPairDim + n) {
      return false;
    }
    std::vector<Block<1>> before;
    for (Eigen::Index i = 0; i < n; ++i) {
      const Eigen::Index k = kPairDim + i;
      const Eigen::VectorXd scale = joint.diagonal().head(k).cwiseSqrt();
      const Eigen::MatrixXd alike =
          scale.cwiseInverse().asDiagonal() * joint.topLeftCorner(k, k) * scale.cwiseInverse().asDiagonal();
      const Eigen::VectorXd across = joint.col(k).head(k);
      const Eigen::VectorXd scaled = alike.ldlt().solve(across.cwiseQuotient(scale));
      const Eigen::VectorXd factors = scaled.cwiseQuotient(scale);
      const double left = std::max(joint(k, k) - factors.dot(across), 1e-9 * joint(k, k));
      const Block<1> block = now_.filter.join(mean_m[i], left, "along-track error");
      const bool held = now_.filter.state().layout().holds(block);
      if (held) now_.ahead.push_back({numbers[static_cast<std::size_t>(i)], block});
      if (!held || now_.filter.predict(Regression{block, before, factors}, 1.0) != UpdateStatus::kAccepted) {
        while (!now_.ahead.empty()) leave_along_track(now_.ahead.back().number);
        return false;
      }
      before.push_back(block);
    }
    return true;
  }
  void leave_along_track(int number) noexcept override {
    for (std::size_t i = 0; i < now_.ahead.size(); ++i) {
      if (now_.ahead[i].number != number) continue;
      now_.filter.marginalise(now_.ahead[i].block);
      now_.ahead.erase(now_.ahead.begin() + static_cast<std::ptrdiff_t>(i));
      return;
    }
  }
  [[nodiscard]] bool along_track(int number, double& mean_m, double& sigma_m) const noexcept override {
    const Ahead* ahead = find(number);
    if (ahead == nullptr) return false;
    const int at = now_.filter.state().layout().offset(ahead->block);
    mean_m = now_.filter.state().x()[at];
    sigma_m = std::sqrt(now_.filter.covariance()(at, at));
    return true;
  }
  [[nodiscard]] Eigen::VectorXd whole_mean() const override { return now_.filter.state().x(); }
  [[nodiscard]] Eigen::MatrixXd whole_covariance() const override { return now_.filter.covariance(); }
  [[nodiscard]] bool smoothable() const noexcept override { return room_ == 0; }

  void save() noexcept override { kept_ = now_; }
  void load() noexcept override { now_ = kept_; }
  /// Back to what it was before the update that runs.
  void revert() noexcept {
    taken_ = now_;
    now_ = before_;
  }
  /// As it was when it last reverted.
  void restore_taken() noexcept { now_ = taken_; }

 private:
  struct Ahead {
    int number;
    Block<1> block;
  };
  struct Kept {
    Filter filter;
    std::vector<Ahead> ahead;
  };
  [[nodiscard]] const Ahead* find(int number) const noexcept {
    for (const Ahead& ahead : now_.ahead) {
      if (ahead.number == number) return &ahead;
    }
    return nullptr;
  }

  PairMotion motion_;
  int iterations_;
  int room_;
  Kept now_;
  Kept kept_;
  Kept before_;
  Kept taken_;
};

class PairInformationFilter final : public CooperativeFilter {
  using Filter = InformationFilter<PairState>;

 public:
  explicit PairInformationFilter(const PairFilterOptions& options)
      : motion_(motion_of(options)),
        iterations_(options.iterations),
        now_(PairState{}, PairSquare::Identity()),
        kept_(now_),
        before_(now_),
        taken_(now_) {}

  void restart(double /*t_s*/, const PairVector& mean, const PairSquare& P) override {
    now_ = Filter(pair_state(mean), P);
  }
  UpdateStatus predict(double dt_s, PairSquare* cross) noexcept override {
    return now_.predict(motion_, detail::NoInput{}, dt_s, cross);
  }
  UpdateReport<2> update(const PairModel<>& model, int /*number*/, const PairObservation& o,
                         const Gate& gate) noexcept override {
    if (iterations_ > 1) before_ = now_;
    const auto report = now_.update(model, o.z, o.R, gate);
    if (report.accepted()) {
      iterate_pair(*this, model, LinearPair<>{}, 0.0, iterations_,
                   [&](const LinearPair<>& rows) { return now_.update(rows, o.z, o.R).accepted(); });
    }
    return report;
  }
  UpdateReport<1> update(const PlaneDistance<>& model, double distance_m, double variance_m2) noexcept override {
    return now_.update(model, distance_m, variance_m2);
  }
  UpdateStatus reopen_clock(double theta_m2, double alpha_m2ps2) noexcept override {
    if (!(theta_m2 >= 0.0) || !(alpha_m2ps2 >= 0.0)) return UpdateStatus::kNotPositiveDefinite;
    return now_.predict(ClockWalk{{kClockBias, {theta_m2}}, {kClockDrift, {alpha_m2ps2}}}, 1.0);
  }
  UpdateStatus shift_clock(double theta_m, double alpha_mps) noexcept override {
    if (!std::isfinite(theta_m + alpha_mps)) return UpdateStatus::kNonFinite;
    PairState state = now_.state();
    state.x[6] += theta_m;
    state.x[7] += alpha_mps;
    now_.restore_information(state, now_.information());
    return UpdateStatus::kAccepted;
  }
  [[nodiscard]] PairVector mean() const noexcept override { return now_.state().x; }
  [[nodiscard]] PairSquare covariance() const noexcept override { return now_.covariance(); }
  void save() noexcept override { kept_ = now_; }
  void load() noexcept override { now_ = kept_; }
  void revert() noexcept {
    taken_ = now_;
    now_ = before_;
  }
  void restore_taken() noexcept { now_ = taken_; }

 private:
  PairMotion motion_;
  int iterations_;
  Filter now_;
  Filter kept_;
  Filter before_;
  Filter taken_;
};

}  // namespace

std::unique_ptr<CooperativeFilter> joseph_filter(const PairFilterOptions& options) {
  return std::make_unique<JosephFilter>(options);
}

std::unique_ptr<LinearisedFilter> linearised_filter(const PairFilterOptions& options) {
  return std::make_unique<JosephFilter>(options);
}

std::unique_ptr<CooperativeFilter> information_filter(const PairFilterOptions& options) {
  if (options.max_along_track != 0) {
    throw std::invalid_argument("max_along_track: " + std::to_string(options.max_along_track) +
                                "; the information form has no along-track states, 0 expected");
  }
  return std::make_unique<PairInformationFilter>(options);
}

}  // namespace soopnav::navigation
