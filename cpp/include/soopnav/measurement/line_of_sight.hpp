#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <type_traits>

#include "soopnav/measurement/arithmetic.hpp"

namespace soopnav {

/// The line from a source q to a receiver p, in `N` dimensions: what every geometric model starts from.
template <class Scalar, int N>
struct LineOfSight {
  std::array<Scalar, static_cast<std::size_t>(N)> d;  ///< p - q [m]
  Scalar range;                                       ///< |p - q| [m]

  [[nodiscard]] const Scalar& operator[](int i) const noexcept { return d[static_cast<std::size_t>(i)]; }

  /// Adds `scale` times d range / d p = (p - q) / range to the receiver's columns, and its negative to the source's.
  template <class ReceiverColumns, class SourceColumns>
  void add_gradient(ReceiverColumns&& to_p, SourceColumns&& to_q, double scale = 1.0) const {
    for (int i = 0; i < N; ++i) {
      const Scalar u = scale * (*this)[i] / range;
      to_p(0, i) += u;
      to_q(0, i) -= u;
    }
  }
};

/// From anything with components: states, packets of particles, knowns.
template <int N, class P, class Q>
[[nodiscard]] auto line_of_sight(const P& p, const Q& q) {
  using std::sqrt;
  using Scalar = std::remove_cvref_t<decltype(eval(p[0] - q[0]))>;
  LineOfSight<Scalar, N> line;
  for (int i = 0; i < N; ++i) line.d[static_cast<std::size_t>(i)] = eval(p[i] - q[i]);
  Scalar square = eval(line[0] * line[0]);
  for (int i = 1; i < N; ++i) square = eval(square + line[i] * line[i]);
  line.range = eval(sqrt(square));
  return line;
}

/// A line of sight whose ends move: range and range rate.
template <class Line, class Speed, class Rate, int N>
struct MovingLine {
  Line line;
  std::array<Speed, static_cast<std::size_t>(N)> v;  ///< velocity of the receiver less that of the source [m/s]
  Rate rate;                                         ///< d range / dt, positive when receding [m/s]

  /// Adds `scale` times the gradient of the rate: (v - rate u) / range for positions, u for velocities, each to the
  /// receiver's columns and negated to the source's.
  template <class ToP, class ToQ, class ToVp, class ToVq>
  void add_gradient(ToP&& to_p, ToQ&& to_q, ToVp&& to_vp, ToVq&& to_vq, double scale = 1.0) const {
    for (int i = 0; i < N; ++i) {
      const auto u = line[i] / line.range;
      const auto across = scale * (v[static_cast<std::size_t>(i)] - rate * u) / line.range;
      to_p(0, i) += across;
      to_q(0, i) -= across;
      to_vp(0, i) += scale * u;
      to_vq(0, i) -= scale * u;
    }
  }
};

/// From positions `p`, `q` and velocities `vp`, `vq` of receiver and source.
template <int N, class P, class Q, class Vp, class Vq>
[[nodiscard]] auto moving_line(const P& p, const Q& q, const Vp& vp, const Vq& vq) {
  const auto line = line_of_sight<N>(p, q);
  using Speed = std::remove_cvref_t<decltype(eval(vp[0] - vq[0]))>;
  std::array<Speed, static_cast<std::size_t>(N)> v;
  for (int i = 0; i < N; ++i) v[static_cast<std::size_t>(i)] = eval(vp[i] - vq[i]);
  auto along = eval(line[0] * v[0]);
  for (int i = 1; i < N; ++i) along = eval(along + line[i] * v[static_cast<std::size_t>(i)]);
  const auto rate = eval(along / line.range);
  return MovingLine<std::remove_const_t<decltype(line)>, Speed, std::remove_const_t<decltype(rate)>, N>{line, v, rate};
}

}  // namespace soopnav
