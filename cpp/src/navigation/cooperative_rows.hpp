#pragma once

#include <Eigen/Core>
#include <memory>

#include "soopnav/core/role.hpp"
#include "soopnav/estimation/state.hpp"
#include "soopnav/navigation/cooperative_filter.hpp"

namespace soopnav::navigation {

/// The fixed roles of a pair, in the order of `PairVector`.
using PairState = PositionVelocityClock<EcefFrame, 3>;
static_assert(PairState::kDim == kPairDim);

/// A pair's rows linearised once, at `at`: an iterated update and the batch start ask them at other places.
///
/// Model: z = value + H (x - at), and the beacon's along-track error about `ahead_m`.
template <PartOf<1> AlongTrack = Known<1>>
struct LinearPair {
  using Frame = EcefFrame;
  static constexpr int kDim = 2;
  PairGeometry rows;
  PairVector at;
  AlongTrack along_track{};
  double ahead_m = 0.0;

  /// False where `model` is undefined at `x`.
  [[nodiscard]] bool linearise(const PairModel<>& model, const PairVector& x, double along_track_m) noexcept {
    at = x;
    ahead_m = along_track_m;
    const auto vector = [](const Known<3>& v) { return Eigen::Vector3d(v[0], v[1], v[2]); };
    return model.beacon != nullptr && pair_geometry(*model.beacon, model.t_s, {x.head<3>(), x.segment<3>(3)},
                                                    {vector(model.anchor_p), vector(model.anchor_v)}, x[6], x[7],
                                                    model.anchor_drift_mps, along_track_m, rows);
  }

  template <class X, class Y>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    const auto p = x(kPosition);
    const auto v = x(kVelocity);
    const double theta = x(kClockBias)[0] - at[6];
    const double alpha = x(kClockDrift)[0] - at[7];
    const double ahead = x(along_track)[0] - ahead_m;
    for (int i = 0; i < 2; ++i) {
      double value = rows.value[i] + rows.theta[i] * theta + rows.alpha[i] * alpha + rows.along_track[i] * ahead;
      for (int k = 0; k < 3; ++k) {
        value += rows.target_p(i, k) * (p[k] - at[k]) + rows.target_v(i, k) * (v[k] - at[3 + k]);
      }
      y.value(i) = value;
    }
    if constexpr (Y::kJacobian) {
      auto&& to_p = y.jacobian(kPosition);
      auto&& to_v = y.jacobian(kVelocity);
      auto&& to_theta = y.jacobian(kClockBias);
      auto&& to_alpha = y.jacobian(kClockDrift);
      auto&& to_ahead = y.jacobian(along_track);
      for (int i = 0; i < 2; ++i) {
        for (int k = 0; k < 3; ++k) {
          to_p(i, k) += rows.target_p(i, k);
          to_v(i, k) += rows.target_v(i, k);
        }
        to_theta(i, 0) += rows.theta[i];
        to_alpha(i, 0) += rows.alpha[i];
        to_ahead(i, 0) += rows.along_track[i];
      }
    }
    return true;
  }
};

/// An engine that takes rows linearised elsewhere: what the batch start runs over its bursts.
class LinearisedFilter : public CooperativeFilter {
 public:
  using CooperativeFilter::update;
  /// Of beacon `number`, whose along-track error is in them where it has joined.
  virtual UpdateReport<2> update(const LinearPair<>& rows, int number, const PairObservation& observed,
                                 const Gate& gate) noexcept = 0;
  /// Mean and covariance of all that is estimated, the along-track errors in the order of joining.
  [[nodiscard]] virtual Eigen::VectorXd whole_mean() const = 0;
  [[nodiscard]] virtual Eigen::MatrixXd whole_covariance() const = 0;
};
[[nodiscard]] std::unique_ptr<LinearisedFilter> linearised_filter(const PairFilterOptions& options);

}  // namespace soopnav::navigation
