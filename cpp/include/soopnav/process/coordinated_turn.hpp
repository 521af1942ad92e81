#pragma once

#include <cmath>
#include <type_traits>

#include "soopnav/core/arithmetic.hpp"
#include "soopnav/core/packet.hpp"
#include "soopnav/core/role.hpp"

namespace soopnav {

/// Planar motion along an arc: speed and turn rate nearly constant.
///
/// Model:   d v/dt = omega J v + a,  d p/dt = v,  d omega/dt = n with white a and n; J turns by a right angle from the
///          first axis towards the second. Between the steps the closed form: v turns by omega dt, p follows the arc
///          (doc/process_models.md eq. 8 to 13; Bar-Shalom, Li and Kirubarajan 2001, section 11.7). No limit is taken
///          at omega = 0: straight motion is as exact as a turn.
/// Noise:   of a, the exact covariance at the present turn rate: normals 0, 1 move the velocity and with it the
///          position, 2, 3 the rest of the position. Of n, normals 4, 5: turn rate and turned angle have their exact
///          joint covariance; the position follows the mean rate of the step.
/// Roles:   planar position and velocity, turn rate (positive from the first axis to the second).
/// No allocation.
template <PartOf<2> Position = Role<2, PositionTag>, PartOf<2> Velocity = Role<2, VelocityTag>,
          PartOf<1> TurnRate = Role<1, TurnRateTag>>
struct CoordinatedTurn {
  static constexpr int kNoise = 6;
  double acceleration_psd = 0.0;  ///< of a, each axis, >= 0 [m²/s³]
  double turn_rate_psd = 0.0;     ///< of n, >= 0 [rad²/s³]
  Position position{};
  Velocity velocity{};
  TurnRate turn_rate{};

  /// `x`: a state of doubles or a `Packet` of particles.
  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& x, double dt_s, const W& w, Y& y) const {
    using std::cos;
    using std::sin;
    using std::sqrt;
    const double to_rate = sqrt(turn_rate_psd * dt_s);
    const double rest_of_rate = to_rate / sqrt(12.0);  // of the mean rate over the step
    const double to_v = sqrt(acceleration_psd * dt_s);
    const auto rate = eval(x(turn_rate)[0]);
    const auto half = eval(0.5 * dt_s * (rate + (0.5 * to_rate * w[4] + rest_of_rate * w[5])));
    const auto s = eval(sin(half));
    const auto c = eval(cos(half));
    using T = std::remove_cvref_t<decltype(half)>;
    const T chord = select(half == T(0.0), T(1.0), eval(s / half));  // of the arc, relative to its length
    const auto turn = eval(2.0 * half);
    const auto square = eval(turn * turn);
    // gamma = (turn - sin(turn)) / turn³, by its series where the difference loses digits.
    const auto series =
        eval(1.0 / 6.0 -
             square * (1.0 / 120.0 -
                       square * (1.0 / 5040.0 -
                                 square * (1.0 / 362880.0 - square * (1.0 / 39916800.0 - square / 6227020800.0)))));
    const T gamma = select(square < T(0.25), series, eval((turn - 2.0 * s * c) / (square * turn)));
    // p += dt (along v + across J v), v turns by `turn`.
    const auto along = eval(chord * c);
    const auto across = eval(chord * s);
    const auto cos_turn = eval(1.0 - 2.0 * s * s);
    const auto sin_turn = eval(2.0 * s * c);
    // Share of the velocity's noise in the position's, dt (alpha - beta J), and the root of what is left.
    const auto alpha = eval(0.5 * chord * chord);
    const auto beta = eval(gamma * turn);
    const auto left = eval(sqrt(2.0 * gamma - alpha * alpha - beta * beta));

    const auto v = x(velocity);
    const auto v0 = eval(v[0]);
    const auto v1 = eval(v[1]);
    const auto turned0 = eval(cos_turn * v0 - sin_turn * v1);
    const auto turned1 = eval(sin_turn * v0 + cos_turn * v1);
    const double to_p = dt_s * to_v;
    auto&& next_p = y.next(position);
    auto&& next_v = y.next(velocity);
    next_p[0] += dt_s * (along * v0 - across * v1) + to_p * (alpha * w[0] + beta * w[1] + left * w[2]);
    next_p[1] += dt_s * (across * v0 + along * v1) + to_p * (alpha * w[1] - beta * w[0] + left * w[3]);
    next_v[0] += (turned0 - v0) + to_v * w[0];
    next_v[1] += (turned1 - v1) + to_v * w[1];
    y.next(turn_rate)[0] += to_rate * w[4];
    if constexpr (Y::kJacobian) {
      const double bend = dt_s * dt_s * (beta - across);  // d(along dt)/d omega
      const double lean = dt_s * dt_s * (along - alpha);  // d(across dt)/d omega
      const double by_rate[4] = {bend * v0 - lean * v1, lean * v0 + bend * v1, -dt_s * turned1, dt_s * turned0};
      y.transition(position, velocity) << dt_s * along, -dt_s * across, dt_s * across, dt_s * along;
      y.transition(velocity, velocity) << cos_turn, -sin_turn, sin_turn, cos_turn;
      y.transition(position, turn_rate) << by_rate[0], by_rate[1];
      y.transition(velocity, turn_rate) << by_rate[2], by_rate[3];
      auto&& of_p = y.noise(position);
      auto&& of_v = y.noise(velocity);
      of_p << to_p * alpha, to_p * beta, to_p * left, 0.0, 0.5 * to_rate * by_rate[0], rest_of_rate * by_rate[0],  //
          -to_p * beta, to_p * alpha, 0.0, to_p * left, 0.5 * to_rate * by_rate[1], rest_of_rate * by_rate[1];
      of_v << to_v, 0.0, 0.0, 0.0, 0.5 * to_rate * by_rate[2], rest_of_rate * by_rate[2],  //
          0.0, to_v, 0.0, 0.0, 0.5 * to_rate * by_rate[3], rest_of_rate * by_rate[3];
      y.noise(turn_rate)(0, 4) = to_rate;
    }
    return true;
  }
};

}  // namespace soopnav
