#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

#include "navigation/handset_cloud.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/core/packet.hpp"
#include "soopnav/core/packet_math.hpp"

/// What is done to eight particles at a time; equations are those of doc/handset.md.
namespace soopnav::navigation::detail {

using Lanes = Packet<double>;

/// Whether `p` lies inside the polygon (even-odd rule).
[[nodiscard]] inline bool inside(const std::vector<Eigen::Vector2d>& polygon, const Eigen::Vector2d& p) noexcept {
  bool in = false;
  for (std::size_t i = 0, j = polygon.size() - 1; i < polygon.size(); j = i++) {
    const Eigen::Vector2d &a = polygon[i], &b = polygon[j];
    if ((a[1] > p[1]) != (b[1] > p[1]) && p[0] < (b[0] - a[0]) * (p[1] - a[1]) / (b[1] - a[1]) + a[0]) in = !in;
  }
  return in;
}

/// Whether the way from `a` to `b` crosses the wall x0 y0 x1 y1.
[[nodiscard]] inline bool crosses(const Eigen::Vector4d& wall, const Eigen::Vector2d& a,
                                  const Eigen::Vector2d& b) noexcept {
  const Eigen::Vector2d w0 = wall.head<2>(), w1 = wall.tail<2>();
  const auto side = [](const Eigen::Vector2d& p, const Eigen::Vector2d& q, const Eigen::Vector2d& r) {
    return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]);
  };
  return (side(w0, w1, a) > 0.0) != (side(w0, w1, b) > 0.0) && (side(a, b, w0) > 0.0) != (side(a, b, w1) > 0.0);
}

/// Eight particles.
struct Block {
  double* rows;
  const HandsetLayout& at;
  int first_boolean;
  int active;  ///< numbers in use: without the foot point's, which are the last, while planes are exact

  [[nodiscard]] SOOPNAV_INLINE double* row(int r) const noexcept {
    return rows + static_cast<std::ptrdiff_t>(r) * HandsetCloud::kLanes;
  }
  [[nodiscard]] SOOPNAV_INLINE double* cell(int a, int b) const noexcept {
    return row(at.size + (a >= b ? a * (a + 1) / 2 + b : b * (b + 1) / 2 + a));
  }
  [[nodiscard]] SOOPNAV_INLINE Lanes mean(int i) const noexcept { return Lanes::load(row(i)); }
  [[nodiscard]] SOOPNAV_INLINE Lanes cov(int a, int b) const noexcept { return Lanes::load(cell(a, b)); }
  SOOPNAV_INLINE void set_mean(int i, const Lanes& value) const noexcept { value.store(row(i)); }
  SOOPNAV_INLINE void set_cov(int a, int b, const Lanes& value) const noexcept { value.store(cell(a, b)); }
  SOOPNAV_INLINE void add_mean(int i, const Lanes& value) const noexcept { set_mean(i, mean(i) + value); }
  SOOPNAV_INLINE void add_cov(int a, int b, const Lanes& value) const noexcept { set_cov(a, b, cov(a, b) + value); }

  /// The covariance after number `t` was increased by `k` times number `s`.
  SOOPNAV_INLINE void couple(int t, int s, const Lanes& k) const noexcept {
    const Lanes ts = cov(t, s), ss = cov(s, s);
    add_cov(t, t, k * (Lanes(2.0) * ts + k * ss));
    for (int j = 0; j < active; ++j) {
      if (j != t) add_cov(t, j, k * cov(s, j));
    }
  }
  /// Number `i` becomes independent, of this mean and variance.
  SOOPNAV_INLINE void renew(int i, const Lanes& value, const Lanes& variance) const noexcept {
    for (int j = 0; j < active; ++j) set_cov(i, j, Lanes(0.0));
    set_mean(i, value);
    set_cov(i, i, variance);
  }
  /// The same where `mask` holds.
  SOOPNAV_INLINE void renew(int i, double value, double variance, const Lanes::Mask& mask) const noexcept {
    for (int j = 0; j < active; ++j) {
      set_cov(i, j, select(mask, Lanes(i == j ? variance : 0.0), cov(i, j)));
    }
    set_mean(i, select(mask, Lanes(value), mean(i)));
  }
};

/// A measured row: what it depends on and how.
struct Slope {
  static constexpr int kMax = 10;
  int number[kMax];
  Lanes by[kMax];
  int n = 0;

  SOOPNAV_INLINE void add(int i, const Lanes& value) noexcept {
    number[n] = i;
    by[n++] = value;
  }
  /// P hᵀ into `ph`, and h P hᵀ.
  [[nodiscard]] SOOPNAV_INLINE Lanes spread(const Block& block, Lanes* ph) const noexcept {
    for (int i = 0; i < block.active; ++i) {
      Lanes sum = block.cov(i, number[0]) * by[0];
      for (int k = 1; k < n; ++k) sum += block.cov(i, number[k]) * by[k];
      ph[i] = sum;
    }
    Lanes s = ph[number[0]] * by[0];
    for (int k = 1; k < n; ++k) s += ph[number[k]] * by[k];
    return s;
  }
};

/// Mean and covariance after a measurement of variance `noise`: `ph` = P hᵀ, `over_s` = 1 / S, zero where nothing is to
/// happen. By Cauchy and Schwarz no variance ends below P R / S: where the difference does, it has lost its digits.
SOOPNAV_INLINE void correct(const Block& block, const Lanes* ph, const Lanes& innovation, const Lanes& over_s,
                            const Lanes& noise) noexcept {
  const Lanes step = innovation * over_s, least = noise * over_s;
  double* cell = block.row(block.at.size);
  for (int i = 0; i < block.active; ++i) {
    block.add_mean(i, ph[i] * step);
    const Lanes k = ph[i] * over_s;
    for (int j = 0; j < i; ++j, cell += HandsetCloud::kLanes) (Lanes::load(cell) - k * ph[j]).store(cell);
    const Lanes p = Lanes::load(cell);
    max(p - k * ph[i], p * least).store(cell);
    cell += HandsetCloud::kLanes;
  }
}

SOOPNAV_INLINE Lanes density(const Lanes& innovation, const Lanes& s) noexcept {
  const Lanes over = Lanes(1.0) / s;
  return exp(Lanes(-0.5) * innovation * innovation * over) * sqrt(over * Lanes(1.0 / kTwoPi));
}

/// The noise of the new frame's foot point, in place of the last one's.
SOOPNAV_INLINE void renew_foot(const Block& block, const Eigen::Matrix2d& covariance) noexcept {
  const int f = block.at.foot;
  block.renew(f, Lanes(0.0), Lanes(covariance(0, 0)));
  block.renew(f + 1, Lanes(0.0), Lanes(covariance(1, 1)));
  block.set_cov(f, f + 1, Lanes(covariance(0, 1)));
}

struct MoveWork {
  const HandsetMotion& motion;
  bool foot;

  SOOPNAV_INLINE void operator()(const Block& block, std::size_t) const noexcept {
    const HandsetLayout& at = block.at;
    const auto& C = motion.track_covariance;
    const auto [s, c] = sincos(block.mean(at.heading));
    const Lanes gx = c * Lanes(motion.increment[0]) - s * Lanes(motion.increment[1]);
    const Lanes gy = s * Lanes(motion.increment[0]) + c * Lanes(motion.increment[1]);
    block.add_mean(at.x, gx);
    block.add_mean(at.y, gy);
    block.add_mean(at.heading, Lanes(motion.increment[2]));
    block.couple(at.x, at.heading, -gy);
    block.couple(at.y, at.heading, gx);
    const Lanes cc = c * c, ss = s * s, cs = c * s;
    block.add_cov(at.x, at.x, cc * Lanes(C(0, 0)) - Lanes(2.0) * cs * Lanes(C(0, 1)) + ss * Lanes(C(1, 1)));
    block.add_cov(at.y, at.y, ss * Lanes(C(0, 0)) + Lanes(2.0) * cs * Lanes(C(0, 1)) + cc * Lanes(C(1, 1)));
    block.add_cov(at.x, at.y, cs * Lanes(C(0, 0) - C(1, 1)) + (cc - ss) * Lanes(C(0, 1)));
    block.add_cov(at.x, at.heading, c * Lanes(C(0, 2)) - s * Lanes(C(1, 2)));
    block.add_cov(at.y, at.heading, s * Lanes(C(0, 2)) + c * Lanes(C(1, 2)));
    block.add_cov(at.heading, at.heading, Lanes(C(2, 2)));
    if (foot) renew_foot(block, motion.foot_covariance);
  }
};

struct AdvanceWork {
  double dt_s, speed_variance, turn_variance;  ///< dt_s < 0 without noise: back where it came from

  SOOPNAV_INLINE void operator()(const Block& block, std::size_t) const noexcept {
    const HandsetLayout& at = block.at;
    // The velocity is the mean one of the interval, so that movement is velocity times time exactly.
    for (int axis = 0; axis < 2; ++axis) {
      block.add_cov(at.vx + axis, at.vx + axis, Lanes(speed_variance));
      const Lanes by = block.mean(at.vx + axis) * Lanes(dt_s);
      block.add_mean(at.x + axis, by);
      block.add_mean(at.dx + axis, by);
      block.couple(at.x + axis, at.vx + axis, Lanes(dt_s));
      block.couple(at.dx + axis, at.vx + axis, Lanes(dt_s));
    }
    block.add_cov(at.heading, at.heading, Lanes(turn_variance));
    block.add_cov(at.heading, at.turn, Lanes(turn_variance));
    block.add_cov(at.turn, at.turn, Lanes(turn_variance));
  }
};

/// Rows turn, dx, dy of type 2's measurement, made independent of each other.
struct MotionWork {
  Eigen::Vector3d z;         ///< turn, dx, dy
  Eigen::Matrix3d whitener;  ///< inverse of the noise's Cholesky factor
  Eigen::Matrix2d foot_covariance;
  bool foot;

  MotionWork(const HandsetMotion& motion, bool with_foot) noexcept
      : z(motion.increment[2], motion.increment[0], motion.increment[1]),
        foot_covariance(motion.foot_covariance),
        foot(with_foot) {
    const auto& C = motion.track_covariance;
    Eigen::Matrix3d n;
    n << C(2, 2), C(2, 0), C(2, 1), C(0, 2), C(0, 0), C(0, 1), C(1, 2), C(1, 0), C(1, 1);
    n.diagonal().array() += 1e-14;
    const Eigen::LLT<Eigen::Matrix3d> root(n);
    whitener.setIdentity();
    root.matrixL().solveInPlace(whitener);
  }

  SOOPNAV_INLINE void operator()(const Block& block, std::size_t) const noexcept {
    const HandsetLayout& at = block.at;
    const int f = at.foot;
    if (foot) {  // what the movement began with; then the new frame's own (eq. 4)
      const auto [s, c] = sincos(block.mean(at.heading) - block.mean(at.turn));
      const Lanes e0 = block.mean(f), e1 = block.mean(f + 1);
      block.add_mean(at.dx, s * e1 - c * e0);
      block.add_mean(at.dy, -(s * e0 + c * e1));
      block.couple(at.dx, f, -c);
      block.couple(at.dx, f + 1, s);
      block.couple(at.dy, f, -s);
      block.couple(at.dy, f + 1, -c);
      renew_foot(block, foot_covariance);
    }
    Lanes ph[HandsetCloud::kMaxSize];
    for (int r = 0; r < 3; ++r) {
      const Lanes turn = block.mean(at.turn);
      const auto [s, c] = sincos(block.mean(at.heading) - turn);
      const auto [sin_turn, cos_turn] = sincos(turn);
      const Lanes dx = block.mean(at.dx), dy = block.mean(at.dy);
      const Lanes e0 = foot ? block.mean(f) : Lanes(0.0), e1 = foot ? block.mean(f + 1) : Lanes(0.0);
      const Lanes first = c * dx + s * dy, second = c * dy - s * dx;
      const Lanes a(whitener(r, 0)), b(whitener(r, 1)), d(whitener(r, 2));
      const Lanes innovation = a * (Lanes(z[0]) - turn) + b * (Lanes(z[1]) - first - (cos_turn * e0 - sin_turn * e1)) +
                               d * (Lanes(z[2]) - second - (sin_turn * e0 + cos_turn * e1));
      const Lanes by_heading = b * second - d * first;
      Slope h;
      h.add(at.turn, a - by_heading);
      h.add(at.heading, by_heading);
      h.add(at.dx, b * c - d * s);
      h.add(at.dy, b * s + d * c);
      if (foot) {
        h.add(f, b * cos_turn + d * sin_turn);
        h.add(f + 1, d * cos_turn - b * sin_turn);
      }
      const Lanes over_s = Lanes(1.0) / max(h.spread(block, ph) + Lanes(1.0), Lanes(1.0));
      correct(block, ph, innovation, over_s, Lanes(1.0));
    }
    for (const int i : {at.dx, at.dy, at.turn}) block.renew(i, Lanes(0.0), Lanes(0.0));
  }
};

/// Type 2: the movement since the last frame begins anew.
struct BeginWork {
  SOOPNAV_INLINE void operator()(const Block& block, std::size_t) const noexcept {
    for (const int i : {block.at.dx, block.at.dy, block.at.turn}) block.renew(i, Lanes(0.0), Lanes(0.0));
  }
};

struct DiffuseWork {
  double position_m2, heading_rad2;

  SOOPNAV_INLINE void operator()(const Block& block, std::size_t) const noexcept {
    block.add_cov(block.at.x, block.at.x, Lanes(position_m2));
    block.add_cov(block.at.y, block.at.y, Lanes(position_m2));
    block.add_cov(block.at.heading, block.at.heading, Lanes(heading_rad2));
  }
};

struct LeaveFootWork {
  SOOPNAV_INLINE void operator()(const Block& block, std::size_t) const noexcept {
    const HandsetLayout& at = block.at;
    if (at.vx >= 0) {  // the pose is the handset's already
      block.renew(at.foot, Lanes(0.0), Lanes(0.0));
      block.renew(at.foot + 1, Lanes(0.0), Lanes(0.0));
      return;
    }
    const auto [s, c] = sincos(block.mean(at.heading));
    const Lanes e0 = block.mean(at.foot), e1 = block.mean(at.foot + 1);
    block.add_mean(at.x, s * e1 - c * e0);
    block.add_mean(at.y, -(s * e0 + c * e1));
    block.couple(at.x, at.foot, -c);
    block.couple(at.x, at.foot + 1, s);
    block.couple(at.y, at.foot, -s);
    block.couple(at.y, at.foot + 1, -c);
    block.renew(at.foot, Lanes(0.0), Lanes(0.0));
    block.renew(at.foot + 1, Lanes(0.0), Lanes(0.0));
  }
};

struct EnterFootWork {
  const Eigen::Matrix2d& C;

  SOOPNAV_INLINE void operator()(const Block& block, std::size_t) const noexcept {
    const HandsetLayout& at = block.at;
    if (at.vx >= 0) return renew_foot(block, C);
    const auto [s, c] = sincos(block.mean(at.heading));
    const Lanes cc = c * c, ss = s * s, cs = c * s;
    block.add_cov(at.x, at.x, cc * Lanes(C(0, 0)) - Lanes(2.0) * cs * Lanes(C(0, 1)) + ss * Lanes(C(1, 1)));
    block.add_cov(at.y, at.y, ss * Lanes(C(0, 0)) + Lanes(2.0) * cs * Lanes(C(0, 1)) + cc * Lanes(C(1, 1)));
    block.add_cov(at.x, at.y, cs * Lanes(C(0, 0) - C(1, 1)) + (cc - ss) * Lanes(C(0, 1)));
  }
};

struct AgeWork {
  double dt_s, white, walk, excess, offset;

  SOOPNAV_INLINE void operator()(const Block& block, std::size_t) const noexcept {
    const HandsetLayout& at = block.at;
    for (int k = 0; k < at.clocks; ++k) {
      const int b = at.clock + k;
      if (at.drift >= 0) {
        const int d = at.drift + k;
        block.add_mean(b, block.mean(d) * Lanes(dt_s));
        block.couple(b, d, Lanes(dt_s));
        block.add_cov(b, d, Lanes(0.5 * walk * dt_s * dt_s));
        block.add_cov(d, d, Lanes(walk * dt_s));
      }
      block.add_cov(b, b, Lanes(white * dt_s + walk * dt_s * dt_s * dt_s / 3.0));
    }
    for (int l = 0; l < at.links; ++l) {
      if (at.excess >= 0) block.add_cov(at.excess + l, at.excess + l, Lanes(excess));
      if (at.offset >= 0) block.add_cov(at.offset + l, at.offset + l, Lanes(offset));
    }
  }
};

/// What multipath does to the ranges becomes something else as the handset walks (eq. 8).
struct FadeWork {
  double kept, renewed;

  SOOPNAV_INLINE void operator()(const Block& block, std::size_t) const noexcept {
    for (int m = block.at.multipath; m < block.at.multipath + block.at.links; ++m) {
      block.set_mean(m, block.mean(m) * Lanes(kept));
      for (int j = 0; j < block.active; ++j) {
        if (j != m) block.set_cov(m, j, block.cov(m, j) * Lanes(kept));
      }
      block.set_cov(m, m, block.cov(m, m) * Lanes(kept * kept) + Lanes(renewed));
    }
  }
};

constexpr double kLeastRangeSigma = 1e-4;    // m
constexpr double kLeastBearingSigma = 1e-6;  // rad
/// Of an outlier, also where there are to be none: from 37 sigmas on an observation is one.
constexpr double kLeastDensity = 1e-300;
constexpr double kNoNumber = std::numeric_limits<double>::quiet_NaN();  ///< weight of a particle to be replaced

/// What both kinds of observation share.
struct LinkWork {
  const double* links;
  const double* sigma;
  const Eigen::Vector3d* nodes;
  Eigen::Vector2d ahead;
  bool feet;
  double outlier;
  double* log_weight;
  const double* weight;
  const double* uniform;
  std::size_t stride;
  double* outliers;

  [[nodiscard]] SOOPNAV_INLINE bool heard(int l) const noexcept {
    return std::isfinite(links[l]) && sigma[l] > 0.0 && std::isfinite(sigma[l]);
  }
  /// Better than `least` nothing is taken to be: the linearised model is not, and digits end.
  [[nodiscard]] SOOPNAV_INLINE double variance_of(int l, double least) const noexcept {
    return sigma[l] > least ? sigma[l] * sigma[l] : least * least;
  }
};

struct Sight {
  Lanes x, y, c, s;  ///< from the handset to a node, horizontally; the heading's cosine and sine
};
/// Where node `l` stands from the handset: the pose, the way since its frame, less the foot point's error.
SOOPNAV_INLINE Sight sight(const LinkWork& work, const Block& block, int l) noexcept {
  const HandsetLayout& at = block.at;
  Sight out;
  const auto turned = sincos(block.mean(at.heading));
  out.c = turned.cos;
  out.s = turned.sin;
  Lanes b0(work.ahead[0]), b1(work.ahead[1]);
  if (work.feet) {
    b0 -= block.mean(at.foot);
    b1 -= block.mean(at.foot + 1);
  }
  const int q = at.node[static_cast<std::size_t>(l)];
  const Lanes qx = q >= 0 ? block.mean(q) : Lanes(work.nodes[l][0]);
  const Lanes qy = q >= 0 ? block.mean(q + 1) : Lanes(work.nodes[l][1]);
  out.x = qx - block.mean(at.x) - (out.c * b0 - out.s * b1);
  out.y = qy - block.mean(at.y) - (out.s * b0 + out.c * b1);
  return out;
}
/// Slopes of a function of the sight, d/dx and d/dy of it.
SOOPNAV_INLINE void add_sight(const LinkWork& work, const Block& block, int l, const Sight& to, const Lanes& by_x,
                              const Lanes& by_y, Slope& h) noexcept {
  const HandsetLayout& at = block.at;
  h.add(at.x, -by_x);
  h.add(at.y, -by_y);
  if (work.feet) {
    h.add(at.foot, to.c * by_x + to.s * by_y);
    h.add(at.foot + 1, to.c * by_y - to.s * by_x);
  }
  const int q = at.node[static_cast<std::size_t>(l)];
  if (q >= 0) {
    h.add(q, by_x);
    h.add(q + 1, by_y);
  }
}

struct RangeWork : LinkWork {
  double height_m;
  std::array<double, kMaxHandsetNodes> stay_blocked, get_blocked;  ///< eq. 2
  double outlier_density;                                          ///< of a range that is one
  double excess_mean, excess_variance;

  /// The clock's variance after a range: (P_b rest - cross²) / S has no difference of large numbers (eq. 9).
  SOOPNAV_INLINE static void correct_clock(const Block& block, int b, const Lanes::Mask& used, const Lanes& clock,
                                           const Lanes& rest, const Lanes& cross, const Lanes& s,
                                           const Lanes& noise) noexcept {
    const Lanes left = max(clock * rest - cross * cross, clock * noise) / s;
    block.set_cov(b, b, select(used, left, clock));
  }

  SOOPNAV_INLINE void operator()(const Block& block, std::size_t first) const noexcept {
    const HandsetLayout& at = block.at;
    Lanes gained(0.0), out(0.0);
    for (int l = 0; l < at.links; ++l) {
      if (heard(l)) one(block, first, l, gained, out);
    }
    (Lanes::load(log_weight + first) + gained).store(log_weight + first);
    *outliers += sum(out * Lanes::load(weight + first));
  }

  SOOPNAV_INLINE void one(const Block& block, std::size_t first, int l, Lanes& gained, Lanes& out) const noexcept {
    const HandsetLayout& at = block.at;
    const Sight to = sight(*this, block, l);
    const Lanes up(nodes[l][2] - height_m);
    const Lanes range = sqrt(to.x * to.x + to.y * to.y + up * up + Lanes(1e-6));
    const Lanes over = Lanes(1.0) / range;
    const int b = at.bias_of(l);
    Lanes predicted = range + block.mean(b);
    Slope h;
    add_sight(*this, block, l, to, to.x * over, to.y * over, h);
    if (at.offset >= 0) {
      predicted += block.mean(at.offset + l);
      h.add(at.offset + l, Lanes(1.0));
    }
    if (at.multipath >= 0) {
      predicted += block.mean(at.multipath + l);
      h.add(at.multipath + l, Lanes(1.0));
    }
    Lanes ph[HandsetCloud::kMaxSize];
    // The clock apart from the rest (eq. 9): its variance may be 1e18 of all others'.
    const Lanes noise(variance_of(l, kLeastRangeSigma)), clock = block.cov(b, b);
    const Lanes spread = h.spread(block, ph);
    gained = select(spread < -noise, Lanes(kNoNumber), gained);  // no covariance any more
    const Lanes rest0 = max(spread + noise, noise);
    const Lanes cross0 = ph[b];
    for (int i = 0; i < block.active; ++i) ph[i] += block.cov(i, b);
    const Lanes s0 = max(rest0 + Lanes(2.0) * cross0 + clock, noise);
    const Lanes v0 = Lanes(links[l]) - predicted;
    // An outlier is from anywhere, but that cannot be told from a clock that may be anywhere.
    const Lanes share(1.0 - outlier);
    const Lanes floor =
        max(Lanes(outlier) * min(Lanes(outlier_density), sqrt(Lanes(1.0 / kTwoPi) / s0)), Lanes(kLeastDensity));
    if (at.excess < 0) {
      const Lanes good = share * density(v0, s0);
      const Lanes total = good + floor;
      const auto used = Lanes::load(uniform + static_cast<std::size_t>(l) * stride + first) * total < good;
      gained += log(total);
      out += select(used, Lanes(0.0), Lanes(1.0));
      correct(block, ph, v0, select(used, Lanes(1.0) / s0, Lanes(0.0)), noise);
      correct_clock(block, b, used, clock, rest0, cross0, s0, noise);
      return;
    }
    // With and without excess delay, each given its own likelihood: the Boolean is drawn from what it is given this
    // range, and the weight is what the range was worth (eq. 7).
    const int e = at.excess + l;
    const Lanes cross1 = cross0 + block.cov(e, b);
    const Lanes rest1 = max(rest0 + Lanes(2.0) * (ph[e] - block.cov(e, b)) + block.cov(e, e), noise);
    const Lanes s1 = max(rest1 + Lanes(2.0) * cross1 + clock, noise);
    const Lanes v1 = v0 - block.mean(e);
    double* boolean = block.row(block.first_boolean + l);
    const auto was = Lanes::load(boolean) > Lanes(0.5);
    const Lanes blocked =
        select(was, Lanes(stay_blocked[static_cast<std::size_t>(l)]), Lanes(get_blocked[static_cast<std::size_t>(l)]));
    const Lanes clear_part = share * (Lanes(1.0) - blocked) * density(v0, s0);
    const Lanes blocked_part = share * blocked * density(v1, s1);
    const Lanes total = clear_part + blocked_part + floor;
    gained += log(total);
    const Lanes drawn = Lanes::load(uniform + static_cast<std::size_t>(l) * stride + first) * total;
    const Lanes either = clear_part + blocked_part;
    const auto clear = drawn < clear_part;
    const auto used = drawn < either;
    // An outlier says nothing: the Boolean is drawn from the chain alone, with what is left of the same number.
    const auto is_blocked = (!clear) & ((drawn < either) | (drawn < either + floor * blocked));
    out += select(used, Lanes(0.0), Lanes(1.0));
    const Lanes with = select(is_blocked & used, Lanes(1.0), Lanes(0.0));
    for (int i = 0; i < block.active; ++i) ph[i] += with * block.cov(e, i);
    const Lanes s = select(is_blocked, s1, s0);
    correct(block, ph, select(is_blocked, v1, v0), select(used, Lanes(1.0) / s, Lanes(0.0)), noise);
    correct_clock(block, b, used, clock, select(is_blocked, rest1, rest0), select(is_blocked, cross1, cross0), s,
                  noise);
    block.renew(e, excess_mean, excess_variance, !is_blocked);
    select(is_blocked, Lanes(1.0), Lanes(0.0)).store(boolean);
  }
};

struct BearingWork : LinkWork {
  const double* mirror;
  bool of_body, booleans;

  SOOPNAV_INLINE void operator()(const Block& block, std::size_t first) const noexcept {
    const HandsetLayout& at = block.at;
    Lanes gained(0.0), out(0.0);
    for (int l = 0; l < at.links; ++l) {
      if (heard(l)) one(block, first, l, gained, out);
    }
    (Lanes::load(log_weight + first) + gained).store(log_weight + first);
    *outliers += sum(out * Lanes::load(weight + first));
  }

  SOOPNAV_INLINE void one(const Block& block, std::size_t first, int l, Lanes& gained, Lanes& out) const noexcept {
    const HandsetLayout& at = block.at;
    const Sight to = sight(*this, block, l);
    const Lanes over = Lanes(1.0) / (to.x * to.x + to.y * to.y + Lanes(1e-6));
    Lanes predicted = atan2(to.y, to.x);
    Slope h;
    add_sight(*this, block, l, to, -(to.y * over), to.x * over, h);
    if (of_body) {
      predicted -= block.mean(at.heading);
      h.add(at.heading, Lanes(-1.0));
    }
    Lanes ph[HandsetCloud::kMaxSize];
    const Lanes noise(variance_of(l, kLeastBearingSigma));
    const Lanes spread = h.spread(block, ph);
    gained = select(spread < -noise, Lanes(kNoNumber), gained);
    const Lanes s = max(spread + noise, noise);
    const Lanes v0 = wrap_to_pi(Lanes(links[l]) - predicted);
    const bool two = mirror != nullptr && std::isfinite(mirror[l]);
    const Lanes v1 = two ? wrap_to_pi(Lanes(mirror[l]) - predicted) : v0;
    const Lanes even(1.0 / kTwoPi);
    const Lanes share((1.0 - outlier) * (two ? 0.5 : 1.0));
    const Lanes first_part = share * density(v0, s);
    const Lanes second_part = two ? share * density(v1, s) : Lanes(0.0);
    const Lanes either = first_part + second_part;
    const Lanes total = max(either + Lanes(outlier) * even, Lanes(kLeastDensity));
    const Lanes drawn = Lanes::load(uniform + static_cast<std::size_t>(l) * stride + first) * total;
    // A link with excess delay comes from anywhere.
    const auto is_blocked =
        booleans ? Lanes::load(block.row(block.first_boolean + l)) > Lanes(0.5) : Lanes(0.0) > Lanes(0.5);
    const auto used = (drawn < either) & !is_blocked;
    gained += log(select(is_blocked, even, total));
    out += select(used | is_blocked, Lanes(0.0), Lanes(1.0));
    correct(block, ph, select(drawn < first_part, v0, v1), select(used, Lanes(1.0) / s, Lanes(0.0)), noise);
  }
};

}  // namespace soopnav::navigation::detail
