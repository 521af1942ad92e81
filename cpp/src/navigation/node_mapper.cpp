#include "soopnav/navigation/node_mapper.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <sstream>
#include <stdexcept>
#include <string_view>

#include "soopnav/core/constants.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/estimation/chi_square.hpp"

namespace soopnav::navigation {
namespace {

using Eigen::Index;
using Eigen::Matrix4d;
using Eigen::MatrixXd;
using Eigen::Vector2d;
using Eigen::Vector4d;
using Eigen::VectorXd;
using Wide = Eigen::Matrix<double, 4, Eigen::Dynamic>;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kStartSigma = 1e-5;  // metres and radians that the frame is held by
constexpr double kClockPriorM = 1e6;  // about its start: only holds epochs without ranges
constexpr double kLeastStepM = 1e-4;  // per epoch: a track that is said to be exact
constexpr double kLeastTurnRad = 1e-5;
constexpr double kPoorFitProbability = 1e-6;
constexpr double kSingular = 1e-10;
constexpr int kMirrorRounds = 5;
constexpr double kSettled = 1e-4;  // of the cost: a hundredth of a sigma

void require(bool holds, std::string_view name, double value, std::string_view rule) {
  if (holds) return;
  std::ostringstream message;
  message << name << ": " << value << "; " << rule;
  throw std::invalid_argument(message.str());
}

// What does not change while one walk is solved.
struct Problem {
  const NodeMapperOptions* options = nullptr;
  std::vector<double> dt;  // n - 1
  std::vector<Vector2d> track, move;
  std::vector<std::size_t> heard;              // nodes that are, in the order of their columns
  std::vector<double> range, weight, height2;  // n x heard; weight 0: not heard
  int observations = 0;

  [[nodiscard]] std::size_t epochs() const noexcept { return track.size(); }
  [[nodiscard]] std::size_t nodes() const noexcept { return heard.size(); }
  [[nodiscard]] Index unknowns() const noexcept { return 3 * static_cast<Index>(nodes()) - 1; }
};

struct Solution {
  std::vector<Vector4d> chain;  // x, y, heading error, clock
  std::vector<Vector2d> q;
  std::vector<double> offset;  // of the first: 0
  double cost = std::numeric_limits<double>::infinity();
  bool converged = false;
  int iterations = 0;
};

struct Weights {
  double step, turn, clock;
};

Weights weights_of(const Problem& p, std::size_t k) noexcept {
  const auto& o = *p.options;
  const double root = std::sqrt(p.dt[k]);
  const double step = std::max(kLeastStepM, o.track_m_per_sqrt_s * root);
  const double turn = std::max(kLeastTurnRad, o.heading_rad_per_sqrt_s * root);
  const double clock = o.clock_m_per_sqrt_s * root;
  return {1.0 / (step * step), 1.0 / (turn * turn),
          o.clock == ClockMotion::kFree ? 0.0 : 1.0 / std::max(1e-8, clock * clock)};
}

Vector2d turned(double angle, const Vector2d& v) noexcept {
  const double c = std::cos(angle), s = std::sin(angle);
  return {c * v.x() - s * v.y(), s * v.x() + c * v.y()};
}

double cost_of(const Problem& p, const Solution& s) {
  double cost = 0.0;
  const std::size_t n = p.epochs(), links = p.nodes();
  for (std::size_t k = 0; k < n; ++k) {
    const Vector4d& x = s.chain[k];
    for (std::size_t l = 0; l < links; ++l) {
      const double w = p.weight[k * links + l];
      if (w == 0.0) continue;
      const double d = std::sqrt((s.q[l] - x.head<2>()).squaredNorm() + p.height2[k * links + l]);
      const double r = p.range[k * links + l] - d - x[3] - s.offset[l];
      cost += w * r * r;
    }
    if (k + 1 == n) break;
    const Weights w = weights_of(p, k);
    const Vector4d& y = s.chain[k + 1];
    cost += w.step * (y.head<2>() - x.head<2>() - turned(x[2], p.move[k])).squaredNorm();
    cost += w.turn * (y[2] - x[2]) * (y[2] - x[2]) + w.clock * (y[3] - x[3]) * (y[3] - x[3]);
  }
  const double hold = 1.0 / (kStartSigma * kStartSigma);
  return cost + hold * ((s.chain[0].head<2>() - p.track[0]).squaredNorm() + s.chain[0][2] * s.chain[0][2]);
}

// Normal equations with the chain eliminated epoch by epoch; keeps what the step back needs.
struct Normal {
  MatrixXd reduced;  // of the nodes: positions, then offsets without the first
  VectorXd right;
  std::vector<Wide> carried;     // D^-1 [B r], per epoch
  std::vector<Matrix4d> onward;  // D^-1 O, per epoch
  MatrixXd own;
  VectorXd own_right;

  explicit Normal(const Problem& p)
      : carried(p.epochs(), Wide(4, p.unknowns() + 1)), onward(p.epochs(), Matrix4d::Zero()) {}

  void make(const Problem& p, const Solution& s) {
    const std::size_t n = p.epochs(), links = p.nodes();
    const Index g = p.unknowns();
    const auto offsets = 2 * static_cast<Index>(links);
    reduced = MatrixXd::Zero(g, g);
    right = VectorXd::Zero(g);
    Wide b(4, g + 1), previous(4, g + 1);
    Matrix4d d = Matrix4d::Zero(), from_before = Matrix4d::Zero();
    Vector4d r_before = Vector4d::Zero();
    const double hold = 1.0 / (kStartSigma * kStartSigma);
    for (std::size_t k = 0; k < n; ++k) {
      const Vector4d& x = s.chain[k];
      d = from_before;
      b.setZero();
      b.col(g) = r_before;
      d(3, 3) += 1.0 / (kClockPriorM * kClockPriorM);
      if (k == 0) {
        d.diagonal().head<3>().array() += hold;
        b.col(g).head<2>() += hold * (p.track[0] - x.head<2>());
        b(2, g) -= hold * x[2];
      }
      for (std::size_t l = 0; l < links; ++l) {
        const double w = p.weight[k * links + l];
        if (w == 0.0) continue;
        const Vector2d away = s.q[l] - x.head<2>();
        const double range = std::max(1e-6, std::sqrt(away.squaredNorm() + p.height2[k * links + l]));
        const Vector2d u = away / range;
        const double r = p.range[k * links + l] - range - x[3] - s.offset[l];
        const Vector4d j(-u.x(), -u.y(), 0.0, 1.0);
        d.noalias() += w * j * j.transpose();
        b.col(g) += w * r * j;
        const Index c = 2 * static_cast<Index>(l), o = offsets + static_cast<Index>(l) - 1;
        b.middleCols<2>(c).noalias() += w * j * u.transpose();
        reduced.block<2, 2>(c, c).noalias() += w * u * u.transpose();
        right.segment<2>(c) += w * r * u;
        if (l == 0) continue;
        b.col(o) += w * j;
        reduced(o, o) += w;
        reduced.block<2, 1>(c, o) += w * u;
        reduced.block<1, 2>(o, c) += w * u.transpose();
        right[o] += w * r;
      }
      Matrix4d to_next = Matrix4d::Zero();
      Matrix4d next = Matrix4d::Zero();
      Vector4d r_next = Vector4d::Zero();
      if (k + 1 < n) {
        // Residual e = y - f(x): x gets F^T W F and F^T W e, y gets W and -W e, between them -F^T W.
        const Weights w = weights_of(p, k);
        const Vector4d weight(w.step, w.step, w.turn, w.clock);
        const Vector2d moved = turned(x[2], p.move[k]);
        Matrix4d f = Matrix4d::Identity();
        f(0, 2) = -moved.y();
        f(1, 2) = moved.x();
        const Vector4d& y = s.chain[k + 1];
        Vector4d e = y - x;
        e.head<2>() -= moved;
        const Matrix4d fw = f.transpose() * weight.asDiagonal();
        d.noalias() += fw * f;
        b.col(g) += fw * e;
        to_next = -fw;
        next = weight.asDiagonal();
        r_next = -weight.cwiseProduct(e);
      }
      if (k > 0) b.noalias() -= onward[k - 1].transpose() * previous;  // O^T D^-1 [B r] of the epoch before
      const Eigen::LLT<Matrix4d> factor(d);
      carried[k] = factor.solve(b);
      onward[k] = factor.solve(to_next);
      reduced.noalias() -= b.leftCols(g).transpose() * carried[k].leftCols(g);
      right.noalias() -= b.leftCols(g).transpose() * carried[k].col(g);
      from_before = next - to_next.transpose() * onward[k];
      r_before = r_next;
      previous.swap(b);
    }
  }

  // The chain's step for a step of the nodes.
  void back(const VectorXd& step, std::vector<Vector4d>& chain) const {
    const Index g = step.size();
    for (std::size_t k = chain.size(); k-- > 0;) {
      chain[k] = carried[k].col(g) - carried[k].leftCols(g) * step;
      if (k + 1 < chain.size()) chain[k] -= onward[k] * chain[k + 1];
    }
  }
};

void improve(const Problem& p, Normal& normal, Solution& s) {
  const std::size_t n = p.epochs(), links = p.nodes();
  const auto offsets = 2 * static_cast<Index>(links);
  s.cost = cost_of(p, s);
  s.converged = false;
  double damping = 1e-3;
  std::vector<Vector4d> chain(n);
  bool fresh = true;
  for (s.iterations = 0; s.iterations < p.options->max_iterations; ++s.iterations) {
    if (fresh) normal.make(p, s);
    MatrixXd a = normal.reduced;
    a.diagonal() *= 1.0 + damping;
    a.diagonal().array() += 1e-12;
    const VectorXd step = a.ldlt().solve(normal.right);
    normal.back(step, chain);
    Solution next = s;
    for (std::size_t k = 0; k < n; ++k) next.chain[k] += chain[k];
    for (std::size_t l = 0; l < links; ++l) {
      next.q[l] += step.segment<2>(2 * static_cast<Index>(l));
      if (l > 0) next.offset[l] += step[offsets + static_cast<Index>(l) - 1];
    }
    next.cost = cost_of(p, next);
    fresh = next.cost <= s.cost;  // false for NaN too
    if (fresh) {
      const bool settled = s.cost - next.cost < kSettled;
      const int iterations = s.iterations;
      s = std::move(next);
      s.iterations = iterations;
      if (settled && (damping < 1e-1 || step.norm() < 1e-4)) {
        s.converged = true;
        return;
      }
      damping = std::max(1e-9, 0.2 * damping);
    } else {
      damping *= 8.0;
      if (!(damping < 1e10)) {
        s.converged = step.norm() < 1e-4;
        return;
      }
    }
  }
}

// Nodes from the clock, each by its grid; and the clock from the nodes; the track as measured.
Solution begin(const Problem& p, int start, RandomStream random) {
  const std::size_t n = p.epochs(), links = p.nodes();
  Solution s;
  s.chain.resize(n);
  s.q.assign(links, Vector2d::Zero());
  s.offset.assign(links, 0.0);
  Vector2d middle = Vector2d::Zero();
  for (const Vector2d& at : p.track) middle += at / static_cast<double>(n);
  double span = 0.0;
  for (const Vector2d& at : p.track) span = std::max(span, (at - middle).norm());
  std::vector<double> clock(n, 0.0), column(n), mean(links, 0.0);
  const auto heard = [&](std::size_t k, std::size_t l) { return p.weight[k * links + l] > 0.0; };
  for (std::size_t l = 0; l < links; ++l) {  // a time far away is no help to anyone
    double sum = 0.0, count = 0.0;
    for (std::size_t k = 0; k < n; ++k) {
      if (!heard(k, l)) continue;
      sum += p.range[k * links + l];
      count += 1.0;
    }
    mean[l] = count > 0.0 ? sum / count : 0.0;
  }
  const auto take_clock = [&](const auto& expected) {
    for (std::size_t k = 0; k < n; ++k) {
      double sum = 0.0, count = 0.0;
      for (std::size_t l = 0; l < links; ++l) {
        if (!heard(k, l)) continue;
        sum += p.range[k * links + l] - expected(k, l);
        count += 1.0;
      }
      clock[k] = count > 0.0 ? sum / count : k > 0 ? clock[k - 1] : 0.0;
    }
  };
  const auto take_nodes = [&] {
    for (std::size_t l = 0; l < links; ++l) {
      double height2 = 0.0;
      for (std::size_t k = 0; k < n; ++k) {
        column[k] = heard(k, l) ? p.range[k * links + l] - clock[k] : kNan;
        height2 += p.height2[k * links + l] / static_cast<double>(n);
      }
      const NodeStart found = start_node(p.track, column, 1.0, p.options->max_distance_m, std::sqrt(height2));
      if (!found.ok) continue;
      // Later starts also try the other side.
      const bool other = start > 1 && random.uniform() < 0.5 && found.mirror_cost < 4.0 * found.cost + 10.0;
      s.q[l] = other ? found.mirror_m : found.position_m;
      s.offset[l] = other ? found.mirror_offset_m : found.offset_m;
    }
  };
  const auto predicted = [&](std::size_t k, std::size_t l) {
    return std::sqrt((s.q[l] - p.track[k]).squaredNorm() + p.height2[k * links + l]) + s.offset[l];
  };
  const bool free = p.options->clock == ClockMotion::kFree;
  int rounds = free ? 6 : 2;
  if (start == 0 && !free) {
    take_nodes();  // a clock that hardly moves
  } else if (start <= 1) {
    take_clock([&](std::size_t, std::size_t l) { return mean[l]; });  // nodes all around average out
  } else {
    for (std::size_t l = 0; l < links; ++l) {
      const double radius = std::max(1.0, span) * std::exp(random.uniform(-0.7, 1.5));
      const double azimuth = 2.0 * kPi * random.uniform();
      s.q[l] = middle + radius * Vector2d(std::cos(azimuth), std::sin(azimuth));
      s.offset[l] = 0.0;
      double sum = 0.0;
      for (std::size_t k = 0; k < n; ++k) sum += predicted(k, l);
      s.offset[l] = mean[l] - sum / static_cast<double>(n);
    }
    take_clock(predicted);
  }
  for (; rounds > 0; --rounds) {
    take_nodes();
    take_clock(predicted);
  }
  const double common = s.offset[0];  // the first node's time is everyone's zero
  for (std::size_t l = 0; l < links; ++l) s.offset[l] -= common;
  for (std::size_t k = 0; k < n; ++k) {
    s.chain[k] << p.track[k].x(), p.track[k].y(), 0.0, clock[k] + common;
  }
  return s;
}

double side_of(const Vector2d& q, const Vector2d& middle, const Vector2d& axis) noexcept {
  return axis.x() * (q.y() - middle.y()) - axis.y() * (q.x() - middle.x());
}

}  // namespace

NodeMapper::NodeMapper(const NodeMapperOptions& options) : options_(options) {
  const auto& o = options_;
  const auto not_negative = [](std::string_view name, double value) {
    require(std::isfinite(value) && value >= 0.0, name, value, "it must be finite and 0 or more");
  };
  not_negative("clock_m_per_sqrt_s", o.clock_m_per_sqrt_s);
  not_negative("track_m_per_sqrt_s", o.track_m_per_sqrt_s);
  not_negative("heading_rad_per_sqrt_s", o.heading_rad_per_sqrt_s);
  require(std::isfinite(o.max_distance_m) && o.max_distance_m > 0.0, "max_distance_m", o.max_distance_m,
          "it must be positive");
  require(o.starts >= 1 && o.starts <= 1000, "starts", o.starts, "it must be 1 ... 1000");
  require(o.max_iterations >= 1 && o.max_iterations <= 10000, "max_iterations", o.max_iterations, "1 ... 10000");
  require(std::isfinite(o.ambiguity_cost) && o.ambiguity_cost > 0.0, "ambiguity_cost", o.ambiguity_cost,
          "it must be positive");
}

NodeMap NodeMapper::locate(std::span<const double> t_s, std::span<const Eigen::Vector3d> track_m,
                           std::span<const double> range_m, std::span<const double> sigma_m,
                           std::span<const double> heights_m) const {
  const std::size_t n = track_m.size(), all = heights_m.size();
  require(n >= 3 && n <= 1'000'000, "track_m", static_cast<double>(n), "3 to 1e6 epochs are needed");
  require(t_s.size() == n, "t_s", static_cast<double>(t_s.size()), "one for each place of the track");
  require(all >= 1 && all <= 64, "heights_m", static_cast<double>(all), "1 to 64 nodes");
  require(range_m.size() == n * all, "range_m", static_cast<double>(range_m.size()), "epochs x nodes");
  require(sigma_m.size() == 1 || sigma_m.size() == n * all, "sigma_m", static_cast<double>(sigma_m.size()),
          "one, or one for each range");
  for (const double sigma : sigma_m) {
    require(std::isfinite(sigma) && sigma > 0.0, "sigma_m", sigma, "it must be finite and positive");
  }
  for (const double height : heights_m) require(std::isfinite(height), "heights_m", height, "it must be finite");
  Problem p;
  p.options = &options_;
  for (std::size_t k = 0; k < n; ++k) {
    require(track_m[k].allFinite(), "track_m", static_cast<double>(k), "this place is not finite");
    require(std::isfinite(t_s[k]) && (k == 0 || t_s[k] > t_s[k - 1]), "t_s", t_s[k], "times must be finite and rise");
    p.track.emplace_back(track_m[k].head<2>());
    if (k == 0) continue;
    p.dt.push_back(t_s[k] - t_s[k - 1]);
    p.move.emplace_back(p.track[k] - p.track[k - 1]);
  }

  NodeMap map;
  const Vector2d none(kNan, kNan);
  const auto size = static_cast<Index>(2 * all);
  map.position_m.assign(all, none);
  map.mirror_m.assign(all, none);
  map.mirrored.assign(all, false);
  map.offset_m.assign(all, kNan);
  map.offset_sigma_m.assign(all, kNan);
  map.covariance_m2 = MatrixXd::Constant(size, size, kNan);
  map.clock_m.assign(n, kNan);
  map.heading_rad.assign(n, 0.0);
  map.track_m = p.track;
  for (std::size_t l = 0; l < all; ++l) {
    std::size_t count = 0;
    for (std::size_t k = 0; k < n; ++k) count += std::isfinite(range_m[k * all + l]) ? 1U : 0U;
    if (count >= 4) p.heard.push_back(l);
  }
  const std::size_t links = p.nodes();
  std::size_t shared = 0;  // epochs with any range: each spends one on a free clock
  for (std::size_t k = 0; k < n; ++k) {
    bool any = false;
    for (const std::size_t l : p.heard) {
      const double z = range_m[k * all + l];
      const double sigma = sigma_m.size() == 1 ? sigma_m[0] : sigma_m[k * all + l];
      const bool good = std::isfinite(z);
      const double up = heights_m[l] - (std::isfinite(track_m[k].z()) ? track_m[k].z() : 0.0);
      p.range.push_back(good ? z : 0.0);
      p.weight.push_back(good ? 1.0 / (sigma * sigma) : 0.0);
      p.height2.push_back(up * up);
      p.observations += good ? 1 : 0;
      any = any || good;
    }
    shared += any ? 1 : 0;
  }
  map.observations = p.observations;
  const bool free = options_.clock == ClockMotion::kFree;
  const std::size_t nuisances = free ? shared : 1;
  if (links == 0 || (free && links < 3) ||
      p.observations <= static_cast<int>(nuisances) + static_cast<int>(p.unknowns())) {
    return map;
  }
  map.degrees_of_freedom = p.observations - static_cast<int>(p.unknowns()) - static_cast<int>(nuisances);
  const double dof = map.degrees_of_freedom;
  const double fits = chi_square_upper_quantile(1e-3, dof);

  Normal normal(p);
  Solution best;
  for (int start = 0; start < options_.starts; ++start) {
    Solution s = begin(p, start, RandomStream(options_.seed, 0x40de).substream(static_cast<std::uint64_t>(start)));
    improve(p, normal, s);
    ++map.starts;
    if (s.cost < best.cost || best.chain.empty()) best = std::move(s);
    if (best.converged && best.cost < fits) break;
  }

  // Each node on the other side of the walk: the same ranges within the noise?
  Vector2d middle = Vector2d::Zero();
  for (const Vector2d& at : p.track) middle += at / static_cast<double>(n);
  double xx = 0.0, xy = 0.0, yy = 0.0;
  for (const Vector2d& at : p.track) {
    const Vector2d d = at - middle;
    xx += d.x() * d.x();
    xy += d.x() * d.y();
    yy += d.y() * d.y();
  }
  const double along = 0.5 * std::atan2(2.0 * xy, xx - yy);
  const Vector2d axis(std::cos(along), std::sin(along));
  std::vector<Solution> others(links);
  for (int round = 0; round < kMirrorRounds; ++round) {
    bool better = false;
    for (std::size_t l = 0; l < links; ++l) {
      Solution s = best;
      const double side = side_of(best.q[l], middle, axis);
      s.q[l] += 2.0 * side * Vector2d(axis.y(), -axis.x());
      improve(p, normal, s);
      others[l] = std::move(s);
      // In the last round nobody moves any more, so that all are compared with the same best one.
      if (round + 1 == kMirrorRounds || !(others[l].cost < best.cost - 1e-2)) continue;
      best = others[l];
      better = true;
    }
    if (!better) break;
  }
  normal.make(p, best);
  const Index g = p.unknowns();
  const VectorXd scale = normal.reduced.diagonal().array().max(1e-300).sqrt().inverse();
  const MatrixXd scaled = scale.asDiagonal() * normal.reduced * scale.asDiagonal();
  const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(scaled);
  VectorXd inverse = VectorXd::Zero(g);
  for (Index i = 0; i < g; ++i) {
    if (eigen.eigenvalues()[i] > kSingular) {
      inverse[i] = 1.0 / eigen.eigenvalues()[i];
    } else {
      ++map.undetermined;
    }
  }
  const MatrixXd covariance = scale.asDiagonal() * eigen.eigenvectors() * inverse.asDiagonal() *
                              eigen.eigenvectors().transpose() * scale.asDiagonal();
  const auto offsets = 2 * static_cast<Index>(links);
  for (std::size_t l = 0; l < links; ++l) {
    const auto a = 2 * static_cast<Index>(l);
    const auto to = 2 * static_cast<Index>(p.heard[l]);
    map.position_m[p.heard[l]] = best.q[l];
    map.offset_m[p.heard[l]] = best.offset[l];
    const Index o = offsets + static_cast<Index>(l) - 1;
    map.offset_sigma_m[p.heard[l]] = l == 0 ? 0.0 : std::sqrt(std::max(0.0, covariance(o, o)));
    for (std::size_t m = 0; m < links; ++m) {
      map.covariance_m2.block<2, 2>(to, 2 * static_cast<Index>(p.heard[m])) =
          covariance.block<2, 2>(a, 2 * static_cast<Index>(m));
    }
    const Solution& other = others[l];
    // The same valley again is no second answer: it must lie on the other side.
    const bool across = !other.q.empty() &&
                        side_of(other.q[l], middle, axis) * side_of(best.q[l], middle, axis) < 0.0 &&
                        (other.q[l] - best.q[l]).squaredNorm() > 4.0 * covariance.block<2, 2>(a, a).trace() / 100.0;
    if (across && other.cost - best.cost < options_.ambiguity_cost) {
      map.mirrored[p.heard[l]] = true;
      map.mirror_m[p.heard[l]] = other.q[l];
    }
  }
  for (std::size_t k = 0; k < n; ++k) {
    map.track_m[k] = best.chain[k].head<2>();
    map.heading_rad[k] = best.chain[k][2];
    map.clock_m[k] = best.chain[k][3];
  }
  map.cost = best.cost;
  map.iterations = best.iterations;
  if (!(best.cost < std::numeric_limits<double>::infinity()) || !best.converged) {
    map.status = NodeMapStatus::kNotConverged;
  } else if (map.undetermined > 0) {
    map.status = NodeMapStatus::kUndetermined;
  } else if (best.cost > chi_square_upper_quantile(kPoorFitProbability, dof)) {
    map.status = NodeMapStatus::kPoorFit;
  } else {
    map.status = NodeMapStatus::kOk;
  }
  return map;
}

}  // namespace soopnav::navigation
