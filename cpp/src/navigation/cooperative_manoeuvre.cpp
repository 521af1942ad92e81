#include "soopnav/navigation/cooperative_manoeuvre.hpp"

#include <cmath>
#include <sstream>
#include <stdexcept>

#include "soopnav/clock/two_state.hpp"
#include "soopnav/core/joint_process.hpp"
#include "soopnav/estimation/interacting_multiple_model.hpp"
#include "soopnav/estimation/state.hpp"
#include "soopnav/navigation/cooperative_motion.hpp"

namespace soopnav::navigation {
namespace {

void require_manoeuvre(bool holds, const char* name, double value, const char* rule) {
  if (holds) return;
  std::ostringstream text;
  text << name << ": " << value << "; " << rule;
  throw std::invalid_argument(text.str());
}

const ManoeuvreOptions& checked_manoeuvre(const ManoeuvreOptions& o) {
  const auto positive = [](double value, const char* name) {
    require_manoeuvre(value > 0.0 && std::isfinite(value), name, value, "it must be positive and finite");
  };
  const auto density = [](double value, const char* name) {
    require_manoeuvre(value >= 0.0 && std::isfinite(value), name, value, "it must be finite and not negative");
  };
  positive(o.calm_psd_m2ps3, "calm_psd_m2ps3");
  positive(o.manoeuvre_psd_m2ps3, "manoeuvre_psd_m2ps3");
  require_manoeuvre(o.manoeuvre_psd_m2ps3 > o.calm_psd_m2ps3, "manoeuvre_psd_m2ps3", o.manoeuvre_psd_m2ps3,
                    "it must be above calm_psd_m2ps3");
  density(o.calm_vertical_psd_m2ps3, "calm_vertical_psd_m2ps3");
  density(o.manoeuvre_vertical_psd_m2ps3, "manoeuvre_vertical_psd_m2ps3");
  density(o.clock_noise.white_frequency_m2ps, "white_frequency_m2ps");
  density(o.clock_noise.frequency_walk_m2ps3, "frequency_walk_m2ps3");
  positive(o.mean_calm_s, "mean_calm_s");
  positive(o.mean_manoeuvre_s, "mean_manoeuvre_s");
  require_manoeuvre(o.calm_probability >= 0.0 && o.calm_probability <= 1.0, "calm_probability", o.calm_probability,
                    "it must lie in [0, 1]");
  return o;
}

class MultipleModelFilter final : public ManoeuvreFilter {
 public:
  explicit MultipleModelFilter(const ManoeuvreOptions& options)
      : options_(checked_manoeuvre(options)),
        imm_(State{}, PairSquare::Identity(), chain(1.0), start(),
             Process{{options.calm_psd_m2ps3, options.calm_vertical_psd_m2ps3}, {options.clock_noise}},
             Process{{options.manoeuvre_psd_m2ps3, options.manoeuvre_vertical_psd_m2ps3}, {options.clock_noise}}),
        kept_(imm_) {}

  void restart(double /*t_s*/, const PairVector& mean, const PairSquare& P) override {
    State x;
    x.x = mean;
    const Imm::Filter mode(x, P);
    imm_.restore({mode, mode}, start());
  }

  UpdateStatus predict(double dt_s, PairSquare* cross) noexcept override {
    if (!(dt_s > 0.0) || std::isinf(dt_s)) return UpdateStatus::kTimeNotAdvancing;
    PairSquare before = imm_.covariance();
    imm_.set_transition(chain(dt_s));
    const UpdateStatus status = imm_.predict(dt_s);
    if (status == UpdateStatus::kAccepted && cross != nullptr) {
      // P F', F = I but for dt_s from velocity to position and from drift to bias: the same in both modes.
      before.leftCols<3>() += dt_s * before.middleCols<3>(State::at(kVelocity));
      before.col(State::at(kClockBias)) += dt_s * before.col(State::at(kClockDrift));
      *cross = before;
    }
    return status;
  }

  UpdateReport<2> update(const PairModel<>& model, int /*number*/, const PairObservation& observed,
                         const Gate& gate) noexcept override {
    return imm_.update(model, observed.z, observed.R, gate);
  }
  UpdateReport<1> update(const PlaneDistance<>& model, double distance_m, double variance_m2) noexcept override {
    return imm_.update(model, distance_m, variance_m2);
  }

  UpdateStatus reopen_clock(double theta_m2, double alpha_m2ps2) noexcept override {
    if (!(theta_m2 >= 0.0) || !(alpha_m2ps2 >= 0.0) || !std::isfinite(theta_m2 + alpha_m2ps2)) {
      return UpdateStatus::kNonFinite;
    }
    Imm::Modes modes = imm_.modes();
    for (auto& mode : modes) {
      PairSquare P = mode.covariance();
      P(State::at(kClockBias), State::at(kClockBias)) += theta_m2;
      P(State::at(kClockDrift), State::at(kClockDrift)) += alpha_m2ps2;
      mode.restore(mode.state(), P);
    }
    imm_.restore(modes, imm_.probabilities());
    return UpdateStatus::kAccepted;
  }
  UpdateStatus shift_clock(double theta_m, double alpha_mps) noexcept override {
    if (!std::isfinite(theta_m + alpha_mps)) return UpdateStatus::kNonFinite;
    Imm::Modes modes = imm_.modes();
    for (auto& mode : modes) {
      State x = mode.state();
      x.x[State::at(kClockBias)] += theta_m;
      x.x[State::at(kClockDrift)] += alpha_mps;
      mode.restore(x, mode.covariance());
    }
    imm_.restore(modes, imm_.probabilities());
    return UpdateStatus::kAccepted;
  }

  [[nodiscard]] PairVector mean() const noexcept override { return imm_.state().x; }
  [[nodiscard]] PairSquare covariance() const noexcept override { return imm_.covariance(); }
  [[nodiscard]] std::span<const double, kModes> probabilities() const noexcept override {
    return std::span<const double, kModes>(imm_.probabilities().data(), kModes);
  }
  void save() noexcept override { kept_ = imm_; }
  void load() noexcept override { imm_ = kept_; }

 private:
  using State = PositionVelocityClock<EcefFrame, 3>;
  using Process = JointProcess<GroundConstantVelocity<>, clock::TwoState<>>;
  using Imm = InteractingMultipleModel<State, Process, Process>;
  static_assert(State::kDim == kPairDim && State::at(kVelocity) == 3 && State::at(kClockBias) == 6);

  // doc/cooperative_motion.md eq. 3
  [[nodiscard]] Imm::Transitions chain(double dt_s) const noexcept {
    const double leave = 1.0 / options_.mean_calm_s;
    const double back = 1.0 / options_.mean_manoeuvre_s;
    const double mixed = -std::expm1(-(leave + back) * dt_s) / (leave + back);
    Imm::Transitions T;
    T << 1.0 - leave * mixed, leave * mixed, back * mixed, 1.0 - back * mixed;
    return T;
  }
  [[nodiscard]] Imm::Probabilities start() const noexcept {
    return {options_.calm_probability, 1.0 - options_.calm_probability};
  }

  ManoeuvreOptions options_;
  Imm imm_;
  Imm kept_;
};

}  // namespace

std::unique_ptr<ManoeuvreFilter> manoeuvre_filter(const ManoeuvreOptions& options) {
  return std::make_unique<MultipleModelFilter>(options);
}

}  // namespace soopnav::navigation
