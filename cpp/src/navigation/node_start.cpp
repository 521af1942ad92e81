#include <Eigen/Dense>
#include <array>
#include <cmath>
#include <limits>

#include "soopnav/core/constants.hpp"
#include "soopnav/navigation/node_mapper.hpp"

namespace soopnav::navigation {
namespace {

constexpr std::size_t kSamples = 64;  // of the grid's cost
constexpr int kAzimuths = 48;
constexpr int kRadii = 14;
constexpr int kSteps = 25;

struct Fit {
  double x = 0.0, y = 0.0, offset = 0.0;
  double cost = std::numeric_limits<double>::infinity();  // sum of squares, in metres
};

template <class Each>
void for_heard(std::span<const Eigen::Vector2d> place, std::span<const double> range, const Each& each) {
  for (std::size_t k = 0; k < place.size(); ++k) {
    if (std::isfinite(range[k]) && place[k].allFinite()) each(place[k].x(), place[k].y(), range[k]);
  }
}

Fit refine(std::span<const Eigen::Vector2d> place, std::span<const double> range, double h2, Fit at,
           Eigen::Matrix3d& information) {
  double damping = 1e-3;
  const auto normal = [&](const Fit& f, Eigen::Matrix3d& a, Eigen::Vector3d& g) {
    a.setZero();
    g.setZero();
    double cost = 0.0;
    for_heard(place, range, [&](double px, double py, double z) {
      const double dx = f.x - px, dy = f.y - py;
      const double d = std::max(1e-6, std::sqrt(dx * dx + dy * dy + h2));
      const double r = z - d - f.offset;
      const Eigen::Vector3d j(dx / d, dy / d, 1.0);
      a.noalias() += j * j.transpose();
      g += r * j;
      cost += r * r;
    });
    return cost;
  };
  Eigen::Vector3d gradient;
  at.cost = normal(at, information, gradient);
  for (int i = 0; i < kSteps; ++i) {
    Eigen::Matrix3d a = information;
    a.diagonal() *= 1.0 + damping;
    a.diagonal().array() += 1e-12;
    const Eigen::Vector3d step = a.ldlt().solve(gradient);
    Fit next{at.x + step.x(), at.y + step.y(), at.offset + step.z()};
    Eigen::Matrix3d next_information;
    Eigen::Vector3d next_gradient;
    next.cost = normal(next, next_information, next_gradient);
    if (next.cost < at.cost) {
      const bool settled = at.cost - next.cost < 1e-10 * (1.0 + at.cost);
      at = next;
      information = next_information;
      gradient = next_gradient;
      damping = std::max(1e-9, 0.2 * damping);
      if (settled) break;
    } else {
      damping *= 8.0;
      if (!(damping < 1e9)) break;
    }
  }
  return at;
}

}  // namespace

NodeStart start_node(std::span<const Eigen::Vector2d> place_m, std::span<const double> range_m, double sigma_m,
                     double max_distance_m, double height_m) noexcept {
  NodeStart out;
  if (place_m.size() != range_m.size() || !(sigma_m > 0.0) || !(max_distance_m > 0.0) || !std::isfinite(height_m)) {
    return out;
  }
  std::size_t heard = 0;
  Eigen::Vector2d middle = Eigen::Vector2d::Zero();
  for_heard(place_m, range_m, [&](double px, double py, double) {
    ++heard;
    middle += Eigen::Vector2d(px, py);
  });
  if (heard < 4) return out;
  middle /= static_cast<double>(heard);
  double xx = 0.0, xy = 0.0, yy = 0.0;
  std::array<double, kSamples> sx{}, sy{}, sz{};
  std::size_t seen = 0, n = 0;
  for_heard(place_m, range_m, [&](double px, double py, double z) {
    const double dx = px - middle.x(), dy = py - middle.y();
    xx += dx * dx;
    xy += dx * dy;
    yy += dy * dy;
    // Evenly over the walk, the last one included.
    if (n < kSamples && seen * (std::min(heard, kSamples) - 1) >= n * (heard - 1)) {
      sx[n] = px;
      sy[n] = py;
      sz[n] = z;
      ++n;
    }
    ++seen;
  });
  const double along = 0.5 * std::atan2(2.0 * xy, xx - yy);
  const double ax = std::cos(along), ay = std::sin(along);
  const double h2 = height_m * height_m;
  std::array<Fit, 2> best;  // left and right of the walk's axis
  const double nearest = max_distance_m / 60.0;
  for (int i = 0; i < kRadii; ++i) {
    const double radius = nearest * std::pow(60.0, static_cast<double>(i) / (kRadii - 1));
    for (int j = 0; j < kAzimuths; ++j) {
      const double azimuth = along + 2.0 * kPi * (j + 0.5) / kAzimuths;
      const double qx = middle.x() + radius * std::cos(azimuth), qy = middle.y() + radius * std::sin(azimuth);
      double sum = 0.0, squares = 0.0;
      for (std::size_t k = 0; k < n; ++k) {
        const double dx = qx - sx[k], dy = qy - sy[k];
        const double r = sz[k] - std::sqrt(dx * dx + dy * dy + h2) - sz[0];  // of size of the walk, whatever the time
        sum += r;
        squares += r * r;
      }
      const double cost = squares - sum * sum / static_cast<double>(n);
      Fit& side = best[ax * (qy - middle.y()) - ay * (qx - middle.x()) >= 0.0 ? 0 : 1];
      if (cost < side.cost) side = {qx, qy, sz[0] + sum / static_cast<double>(n), cost};
    }
  }
  std::array<Eigen::Matrix3d, 2> information;
  for (std::size_t s = 0; s < 2; ++s) best[s] = refine(place_m, range_m, h2, best[s], information[s]);
  const std::size_t first = best[0].cost <= best[1].cost ? 0 : 1;
  const Fit& a = best[first];
  const Fit& b = best[1 - first];
  const double variance = sigma_m * sigma_m;
  out.position_m = {a.x, a.y};
  out.offset_m = a.offset;
  out.cost = a.cost / variance;
  const auto side = [&](const Fit& f) { return ax * (f.y - middle.y()) - ay * (f.x - middle.x()); };
  if (side(a) * side(b) < 0.0) {  // it may have run into the same answer
    out.mirror_m = {b.x, b.y};
    out.mirror_offset_m = b.offset;
    out.mirror_cost = b.cost / variance;
  }
  const Eigen::LDLT<Eigen::Matrix3d> factor(information[first]);
  const bool regular = factor.rcond() > 1e-12;
  if (regular) out.covariance = variance * factor.solve(Eigen::Matrix3d::Identity());
  out.ok = regular && out.position_m.allFinite() && (out.position_m - middle).norm() < 2.0 * max_distance_m;
  return out;
}

}  // namespace soopnav::navigation
