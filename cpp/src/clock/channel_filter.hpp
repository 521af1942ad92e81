#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

#include "small_matrix.hpp"

namespace soopnav::clock::detail {

/// Densities of the channels' clocks and the phases' noise, in units of the step and of a phase.
template <std::size_t M>
struct ChannelNoise {
  Square<M> f, g, r;
};

/// Covariance of the channels' biases and drifts.
template <std::size_t M>
struct ChannelCovariance {
  Square<M> bb, bd, dd;  // bd: rows biases, columns drifts

  void predict(const Square<M>& f, const Square<M>& g, double t) noexcept {
    const Square<M> cross = bd.transposed();
    bb.add(bd, t).add(cross, t).add(dd, t * t).add(f, t).add(g, t * t * t / 3.0);
    bd.add(dd, t).add(g, 0.5 * t * t);
    dd.add(g, t);
  }
};

/// After two phases `apart` steps from each other, of which the drift is the difference
/// (doc/characterization.md eq. 6); linear in the densities, so that its derivatives are the same with r = 0.
template <std::size_t M>
[[nodiscard]] ChannelCovariance<M> channel_start(const Square<M>& f, const Square<M>& g, const Square<M>& r,
                                                 double apart) noexcept {
  ChannelCovariance<M> p;
  p.bb = r;
  p.bd = r.scaled(1.0 / apart);
  p.dd = f.scaled(1.0 / apart).add(g, apart / 3.0).add(r, 2.0 / (apart * apart));
  return p;
}

/// Gains of one update, and the covariance after it.
template <std::size_t M>
struct ChannelUpdate {
  Square<M> s, to_bias, to_drift;
  Factor<M> factor{Square<M>{}};

  /// Updates `p`.
  void apply(ChannelCovariance<M>& p, const Square<M>& r) noexcept {
    s = p.bb;
    s.add(r);
    factor = Factor<M>(s);
    to_bias = factor.right_solve(p.bb);
    to_drift = factor.right_solve(p.bd.transposed());
    p.bb = (to_bias * r).symmetric();
    p.bd = (to_drift * r).transposed();
    p.dd.add(to_drift * s * to_drift.transposed(), -1.0);
    p.dd = p.dd.symmetric();
  }
};

/// The largest change of `now` against `before`, in the size of `now`'s largest number.
template <std::size_t M>
[[nodiscard]] double relative_change(const Square<M>& now, const Square<M>& before) noexcept {
  double change = 0.0;
  double size = 1e-300;
  for (std::size_t i = 0; i < M * M; ++i) {
    change = std::max(change, std::abs(now.a[i] - before.a[i]));
    size = std::max(size, std::abs(now.a[i]));
  }
  return change / size;
}

template <std::size_t M>
struct ChannelState {
  std::array<double, M> bias{}, drift{};

  void predict(double t) noexcept {
    for (std::size_t i = 0; i < M; ++i) bias[i] += t * drift[i];
  }
  void update(const Square<M>& to_bias, const Square<M>& to_drift, const std::array<double, M>& e) noexcept {
    const auto b = to_bias.of(e);
    const auto d = to_drift.of(e);
    for (std::size_t i = 0; i < M; ++i) {
      bias[i] += b[i];
      drift[i] += d[i];
    }
  }
};

}  // namespace soopnav::clock::detail
