#pragma once

#include <cmath>
#include <concepts>

#include "soopnav/core/angle.hpp"
#include "soopnav/core/role.hpp"
#include "soopnav/core/stacked.hpp"
#include "soopnav/measurement/arithmetic.hpp"
#include "soopnav/measurement/azimuth.hpp"

namespace soopnav {

/// Angle of a source above the receiver's horizontal plane.
///
/// Model:   z = atan2(up, sqrt(east² + north²)) of q - p          (doc/measurement_models.md eq. 13; carter eq. 5.7)
/// [rad] Frames:  p receiver, q source, both in `FrameTag` [m]: up is the third axis of `EnuFrame` and `PlanarFrame`,
/// and
///          against it in `NedFrame`. Not defined in `EcefFrame`.
/// Signs:   positive above, pi/2 overhead.
/// Roles:   as for `Azimuth`.
/// Refused: `predict` with a Jacobian answers false where the source is straight above or below, within `kMinRangeM`
///          horizontally. No allocation.
template <class FrameTag, PartOf<3> Source = Known<3>, PartOf<3> Receiver = Role<3, PositionTag>>
struct Elevation {
  static_assert(!std::same_as<FrameTag, EcefFrame>, "an elevation is stated in a local frame");
  using Frame = FrameTag;
  static constexpr int kDim = 1;
  static constexpr double kUp = std::same_as<FrameTag, NedFrame> ? -1.0 : 1.0;  ///< the third axis' share of up
  Source source_p{};                                                            ///< q [m]
  Receiver receiver_p{};                                                        ///< p [m]

  template <class X, class Y>
  requires Provides<X, Elevation, Source, Receiver>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    using std::atan2;
    using std::sqrt;
    const auto p = x(receiver_p);
    const auto q = x(source_p);
    const auto a = eval(q[0] - p[0]);
    const auto b = eval(q[1] - p[1]);
    const auto up = eval(kUp * (q[2] - p[2]));
    const auto level = eval(sqrt(a * a + b * b));
    y.value(0) = atan2(up, level);
    if constexpr (Y::kJacobian) {
      if (!(level > kMinRangeM)) return false;
      const double square = level * level + up * up;
      const double bend = up / (level * square);
      const double gradient[3] = {-a * bend, -b * bend, kUp * level / square};  // with respect to q
      auto&& to_p = y.jacobian(receiver_p);
      auto&& to_q = y.jacobian(source_p);
      for (int i = 0; i < 3; ++i) {
        to_p(0, i) -= gradient[i];
        to_q(0, i) += gradient[i];
      }
    }
    return true;
  }
};

/// Azimuth and elevation of a source: the rows of `Azimuth` and `Elevation`, with an R of their own.
template <class FrameTag, PartOf<1> Heading = Known<1>, PartOf<3> Source = Known<3>,
          PartOf<3> Receiver = Role<3, PositionTag>>
struct AzimuthElevation {
  using Frame = FrameTag;
  using Rows = Stacked<Azimuth<FrameTag, Heading, Source, Receiver>, Elevation<FrameTag, Source, Receiver>>;
  static constexpr int kDim = 2;
  Source source_p{};      ///< q [m]
  Heading heading{};      ///< psi [rad]
  Receiver receiver_p{};  ///< p [m]

  template <class X, class Y>
  requires Provides<X, AzimuthElevation, Heading, Source, Receiver>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    return Rows({source_p, heading, receiver_p}, {source_p, receiver_p}).predict(x, y);
  }

  /// The difference; of the azimuth, the short way round.
  template <class T>
  [[nodiscard]] static T residual(int row, const T& z, const T& predicted) {
    return Rows::residual(row, z, predicted);
  }
};

/// Direction to a source as an array on a tilted body sees it: the angles from the body's own axes.
///
/// Model:   with d = Cᵀ (q - p), C the rotation of the attitude:
///          z = [atan2(d_2, d_1), atan2(d_3, sqrt(d_1² + d_2²))]  (doc/measurement_models.md eq. 14) [rad]
/// Frames:  p receiver, q source, in `FrameTag` (any, ECEF too) [m]; the attitude turns body axes into it.
/// Signs:   the first angle from the body's first axis towards its second, the second from their plane towards the
///          third: with a third axis that points down, sources above have a negative one.
/// Roles:   attitude; the receiver's position, and the source's when it is a `Block` or a role.
/// Residual: of the first angle wrapped to [-pi, pi).
/// Refused: `predict` with a Jacobian answers false within `kMinRangeM` of the body's third axis. No allocation.
template <class FrameTag, PartOf<3> Source = Known<3>, PartOf<3> Receiver = Role<3, PositionTag>>
struct BodyDirection {
  using Frame = FrameTag;
  static constexpr int kDim = 2;
  Source source_p{};      ///< q [m]
  Receiver receiver_p{};  ///< p [m]

  template <class X, class Y>
  requires Provides<X, BodyDirection, Source, Receiver, Role<3, AttitudeTag>>
  [[nodiscard]] bool predict(const X& x, Y& y) const {
    using std::atan2;
    using std::sqrt;
    const auto p = x(receiver_p);
    const auto q = x(source_p);
    const auto k = x(kAttitude);  // quaternion w, x, y, z
    const auto n0 = eval(q[0] - p[0]);
    const auto n1 = eval(q[1] - p[1]);
    const auto n2 = eval(q[2] - p[2]);
    const auto c00 = eval(1.0 - 2.0 * (k[2] * k[2] + k[3] * k[3])), c01 = eval(2.0 * (k[1] * k[2] - k[0] * k[3])),
               c02 = eval(2.0 * (k[1] * k[3] + k[0] * k[2])), c10 = eval(2.0 * (k[1] * k[2] + k[0] * k[3])),
               c11 = eval(1.0 - 2.0 * (k[1] * k[1] + k[3] * k[3])), c12 = eval(2.0 * (k[2] * k[3] - k[0] * k[1])),
               c20 = eval(2.0 * (k[1] * k[3] - k[0] * k[2])), c21 = eval(2.0 * (k[2] * k[3] + k[0] * k[1])),
               c22 = eval(1.0 - 2.0 * (k[1] * k[1] + k[2] * k[2]));
    const auto a = eval(c00 * n0 + c10 * n1 + c20 * n2);
    const auto b = eval(c01 * n0 + c11 * n1 + c21 * n2);
    const auto up = eval(c02 * n0 + c12 * n1 + c22 * n2);
    const auto level = eval(sqrt(a * a + b * b));
    y.value(0) = wrap_to_pi(eval(atan2(b, a)));
    y.value(1) = atan2(up, level);
    if (detail::too_near(eval(level * level))) return false;
    if constexpr (Y::kJacobian) {
      if (std::isnan(level)) return false;
      const double square = level * level + up * up;
      const double bend = up / (level * square);
      // Rows of the gradient with respect to d, then through d = Cᵀ (q - p) and d(exp(t)ᵀ d)/dt = d x.
      const double g[2][3] = {{-b / (level * level), a / (level * level), 0.0}, {-a * bend, -b * bend, level / square}};
      const double c[3][3] = {{c00, c01, c02}, {c10, c11, c12}, {c20, c21, c22}};
      const double d[3] = {a, b, up};
      auto&& to_p = y.jacobian(receiver_p);
      auto&& to_q = y.jacobian(source_p);
      auto&& to_attitude = y.jacobian(kAttitude);
      for (int row = 0; row < 2; ++row) {
        for (int i = 0; i < 3; ++i) {
          const double u = g[row][0] * c[i][0] + g[row][1] * c[i][1] + g[row][2] * c[i][2];
          to_p(row, i) -= u;
          to_q(row, i) += u;
          const int j = (i + 1) % 3;
          const int l = (i + 2) % 3;
          to_attitude(row, i) += g[row][j] * d[l] - g[row][l] * d[j];
        }
      }
    }
    return true;
  }

  /// The difference; of the first angle, the short way round.
  template <class T>
  [[nodiscard]] static T residual(int row, const T& z, const T& predicted) {
    const T difference = z - predicted;
    return row == 0 ? wrap_to_pi(difference) : difference;
  }
};

}  // namespace soopnav
