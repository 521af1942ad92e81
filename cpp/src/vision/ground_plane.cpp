#include "soopnav/vision/ground_plane.hpp"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

#include "soopnav/core/packet.hpp"
#include "vision/covariance_of.hpp"

namespace soopnav::vision {

namespace {

using Wide = Packet<float>;
constexpr std::size_t kLanes = Wide::kWidth;
constexpr std::size_t kSubset = 512;  // whole packets
constexpr float kNoPoint = std::numeric_limits<float>::quiet_NaN();
constexpr double kAnyBand = 1e30;

[[noreturn]] void refuse(const char* name, double value, const char* rule) {
  throw std::invalid_argument(std::string(name) + ": " + std::to_string(value) + "; it must be " + rule);
}

void require(bool holds, const char* name, double value, const char* rule) {
  if (!holds) refuse(name, value, rule);
}

std::size_t padded(std::size_t n) { return (n + kLanes - 1) / kLanes * kLanes; }

}  // namespace

/// Points in rows of whole packets; where there is none the last row has NaN.
struct PlaneFitter::Rows {
  const float* x;
  std::size_t row;     // floats from one row to the next
  std::size_t points;  // in the first ceil(points / kLanes) packets
  const PlaneOptions* options;
  [[nodiscard]] const float* y() const noexcept { return x + row; }
  [[nodiscard]] const float* z() const noexcept { return x + 2 * row; }
  [[nodiscard]] const float* gain() const noexcept { return x + 3 * row; }
  [[nodiscard]] Eigen::Vector3d point(std::size_t i) const noexcept {
    return {static_cast<double>(x[i]), static_cast<double>(y()[i]), static_cast<double>(z()[i])};
  }
  [[nodiscard]] int inside(const GroundPlane& plane) const noexcept;
  [[nodiscard]] Moments moments(const GroundPlane& plane, double widened) const noexcept;
  [[nodiscard]] double limit(const GroundPlane& plane, double widened) const noexcept {
    return widened * (options->band_m > 0.0 ? options->band_m : options->band_sigmas * plane.distance_m);
  }
};

/// Weighted sums over the points inside a plane's band.
struct PlaneFitter::Moments {
  double weight = 0.0;                                // sum of w
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();     // sum of w p / sum of w
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();  // sum of w (p - mean)(p - mean)'
  double square = 0.0;                                // sum of e^2 by the plane they were collected with [m^2]
  int count = 0;
};

const char* name(PlaneStatus status) noexcept {
  switch (status) {
    case PlaneStatus::kNone:
      return "none";
    case PlaneStatus::kFitted:
      return "fitted";
    case PlaneStatus::kTooFew:
      return "too few points";
    case PlaneStatus::kNoPlane:
      return "no plane";
    case PlaneStatus::kWall:
      return "wall";
    case PlaneStatus::kHeight:
      return "implausible height";
    case PlaneStatus::kDegenerate:
      return "degenerate";
  }
  return "unknown";
}

Eigen::Matrix3d body_axes(const Eigen::Vector3d& normal_c) noexcept {
  // Eq. 2.
  const double lean = std::sqrt(std::max(1.0 - normal_c.x() * normal_c.x(), 1e-12));
  const Eigen::Vector3d first = (Eigen::Vector3d::UnitX() - normal_c.x() * normal_c) / lean;
  Eigen::Matrix3d axes;
  axes.row(0) = first.transpose();
  axes.row(1) = first.cross(normal_c).transpose();  // -n x b_1
  axes.row(2) = -normal_c.transpose();
  return axes;
}

GroundPlane GroundPlane::known(const Eigen::Vector3d& normal_c, double distance_m, const Eigen::Matrix3d& covariance) {
  const double length = normal_c.norm();
  require(std::isfinite(length) && normal_c.z() > 1e-9 * length, "normal_c: z", normal_c.z(),
          "positive: the normal points from the camera into the ground");
  require(std::isfinite(distance_m) && distance_m > 0.0, "distance_m", distance_m, "positive");
  require(covariance.allFinite() && (covariance.diagonal().array() >= 0.0).all(), "covariance", covariance.trace(),
          "finite, with a diagonal of at least 0");
  GroundPlane plane;
  plane.status = PlaneStatus::kFitted;
  plane.normal_c = normal_c / length;
  plane.distance_m = distance_m;
  plane.covariance = covariance;
  return plane;
}

GroundPlane GroundPlane::seen_from(const Eigen::Vector3d& camera_p_c, const Eigen::Matrix3d& turn) const noexcept {
  GroundPlane out = *this;
  if (!ok()) return out;
  out.normal_c = (turn * normal_c).normalized();
  out.distance_m = distance_m - normal_c.dot(camera_p_c);
  const Eigen::Matrix<double, 2, 3> axes = body_axes(normal_c).topRows<2>();
  Eigen::Matrix3d to_new = Eigen::Matrix3d::Zero();  // eq. 6
  to_new.topLeftCorner<2, 2>() = body_axes(out.normal_c).topRows<2>() * turn * axes.transpose();
  to_new.bottomLeftCorner<1, 2>() = -(axes * camera_p_c).transpose();
  to_new(2, 2) = 1.0;
  out.covariance = to_new * covariance * to_new.transpose();
  if (!(out.normal_c.z() > 0.0)) {
    out.status = PlaneStatus::kWall;
  } else if (!(out.distance_m > 0.0)) {
    out.status = PlaneStatus::kHeight;
  }
  return out;
}

PlaneFitter::PlaneFitter(const PlaneOptions& options) : options_(options), random_(options.seed) {
  const auto& o = options_;
  require(std::isfinite(o.sigma_m) && o.sigma_m >= 0.0, "sigma_m", o.sigma_m, "at least 0");
  require(std::isfinite(o.sigma_per_m) && o.sigma_per_m >= 0.0, "sigma_per_m", o.sigma_per_m, "at least 0");
  require(o.sigma_m + o.sigma_per_m > 0.0, "sigma_m", o.sigma_m, "positive where sigma_per_m is 0");
  require(o.band_sigmas >= 0.5 && o.band_sigmas <= 100.0, "band_sigmas", o.band_sigmas, "in 0.5 ... 100");
  require(std::isfinite(o.band_m) && o.band_m >= 0.0, "band_m", o.band_m, "at least 0");
  require(o.min_share > 0.0 && o.min_share <= 1.0, "min_share", o.min_share, "in (0, 1]");
  require(o.min_points >= 4, "min_points", o.min_points, "at least 4");
  require(o.max_tilt_rad > 0.0 && o.max_tilt_rad < 1.5, "max_tilt_rad", o.max_tilt_rad, "in (0, 1.5)");
  require(o.min_height_m > 0.0 && std::isfinite(o.min_height_m), "min_height_m", o.min_height_m, "positive");
  require(o.max_height_m > o.min_height_m && std::isfinite(o.max_height_m), "max_height_m", o.max_height_m,
          "above min_height_m");
  require(o.max_hypotheses >= 1 && o.max_hypotheses <= 100000, "max_hypotheses", o.max_hypotheses, "in 1 ... 100000");
  require(o.confidence > 0.0 && o.confidence < 1.0, "confidence", o.confidence, "in (0, 1)");
  require(o.noise_cluster >= 1.0 && std::isfinite(o.noise_cluster), "noise_cluster", o.noise_cluster, "at least 1");
  subset_.resize(4 * kSubset);
}

void PlaneFitter::reserve(std::size_t points) {
  const std::size_t row = padded(points);
  if (row > row_) {
    row_ = row;
    cloud_.resize(4 * row_);
  }
}

std::size_t PlaneFitter::load(std::span<const float> xyz) {
  const std::size_t offered = xyz.size() / 3;
  reserve(offered);
  float* const x = cloud_.data();
  float* const y = x + row_;
  float* const z = y + row_;
  float* const gain = z + row_;
  const auto a = static_cast<float>(options_.sigma_m);
  const auto b = static_cast<float>(options_.sigma_per_m);
  constexpr float kFar = 1e6F;  // metres; also false for NaN and infinity
  std::size_t n = 0;
  for (std::size_t i = 0; i < offered; ++i) {
    const float px = xyz[3 * i];
    const float py = xyz[3 * i + 1];
    const float pz = xyz[3 * i + 2];
    x[n] = px;
    y[n] = py;
    z[n] = pz;
    n += static_cast<std::size_t>((std::fabs(px) < kFar) & (std::fabs(py) < kFar) & (pz > 1e-3F) & (pz < kFar));
  }
  for (std::size_t i = 0; i < n; ++i) gain[i] = z[i] / (a + b * z[i] * z[i]);
  for (std::size_t i = n; i < padded(n); ++i) {
    x[i] = y[i] = z[i] = 0.0F;
    gain[i] = kNoPoint;
  }
  return n;
}

PlaneFitter::Rows PlaneFitter::draw_subset(std::size_t points) {
  const Rows all{cloud_.data(), row_, points, &options_};
  const std::size_t take = std::min(points, kSubset);
  float* const out = subset_.data();
  for (std::size_t i = 0; i < kSubset; ++i) {
    const bool real = i < take;
    std::size_t from = i;
    if (real && take < points) {  // one from each of 512 stretches of the cloud
      const double at =
          (static_cast<double>(i) + random_.uniform()) * static_cast<double>(points) / static_cast<double>(kSubset);
      from = std::min(static_cast<std::size_t>(at), points - 1);
    }
    out[i] = real ? all.x[from] : 0.0F;
    out[kSubset + i] = real ? all.y()[from] : 0.0F;
    out[2 * kSubset + i] = real ? all.z()[from] : 0.0F;
    out[3 * kSubset + i] = real ? all.gain()[from] : kNoPoint;
  }
  return {out, kSubset, take, &options_};
}

int PlaneFitter::Rows::inside(const GroundPlane& plane) const noexcept {
  // |e| z / sigma(z) <= band d (eq. 3): the noise lies along the ray. Or |e| <= band; g - g + 1 is 1, or NaN for none.
  const Wide nx(plane.normal_c.x()), ny(plane.normal_c.y()), nz(plane.normal_c.z()), d(plane.distance_m);
  const Wide most(limit(plane, 1.0)), one(1.0F), none(0.0F);
  const bool fixed = options->band_m > 0.0;
  Wide count(0.0F);
  for (std::size_t i = 0; i < points; i += kLanes) {
    const Wide e = nx * Wide::load(x + i) + ny * Wide::load(y() + i) + nz * Wide::load(z() + i) - d;
    const Wide g = Wide::load(gain() + i);
    count += select(abs(e) * (fixed ? g - g + one : g) <= most, one, none);
  }
  return static_cast<int>(sum(count));
}

PlaneFitter::Moments PlaneFitter::Rows::moments(const GroundPlane& plane, double widened) const noexcept {
  const Wide nx(plane.normal_c.x()), ny(plane.normal_c.y()), nz(plane.normal_c.z());
  const Wide most(std::min(limit(plane, widened), 1e30)), one(1.0F), none(0.0F);
  const bool fixed = options->band_m > 0.0;
  // Centred at a point of the plane on the optical axis, so that single precision is enough for the products.
  const double centre = plane.distance_m / std::max(plane.normal_c.z(), 0.1);
  const Wide cz(centre);
  const Wide rest(plane.distance_m - plane.normal_c.z() * centre);
  const Wide height(plane.distance_m), least(0.5 * plane.distance_m);
  const Wide a(options->sigma_m), b(options->sigma_per_m);
  double total[12]{};
  for (std::size_t begin = 0; begin < points; begin += 64 * kLanes) {
    Wide s[12];
    for (auto& each : s) each = none;
    const std::size_t end = std::min(begin + 64 * kLanes, points);
    for (std::size_t i = begin; i < end; i += kLanes) {
      const Wide px = Wide::load(x + i), py = Wide::load(y() + i), pz = Wide::load(z() + i) - cz;
      const Wide e = nx * px + ny * py + nz * pz - rest;
      // The depth at which the ray meets the plane. By the measured one, points that erred towards the camera would
      // weigh more and pull the plane up. Nothing nearer than half the way is on the plane.
      const Wide z = (pz + cz) * height / max(e + height, least);
      const Wide real = Wide::load(gain() + i);
      const Wide g = z / (a + b * z * z) + (real - real);
      const auto in = abs(e) * (fixed ? g - g + one : g) <= most;
      const Wide w = select(in, g * g, none);
      const Wide wx = w * px, wy = w * py, wz = w * pz;
      s[0] += w;
      s[1] += wx;
      s[2] += wy;
      s[3] += wz;
      s[4] += wx * px;
      s[5] += wx * py;
      s[6] += wx * pz;
      s[7] += wy * py;
      s[8] += wy * pz;
      s[9] += wz * pz;
      s[10] += select(in, e * e, none);
      s[11] += select(in, one, none);
    }
    for (int k = 0; k < 12; ++k) total[k] += static_cast<double>(sum(s[k]));
  }
  Moments m;
  m.weight = total[0];
  m.square = total[10];
  m.count = static_cast<int>(total[11]);
  if (!(m.weight > 0.0)) return m;
  const Eigen::Vector3d shifted = Eigen::Vector3d(total[1], total[2], total[3]) / m.weight;
  m.scatter << total[4], total[5], total[6], total[5], total[7], total[8], total[6], total[8], total[9];
  m.scatter -= m.weight * shifted * shifted.transpose();
  m.mean = shifted + Eigen::Vector3d(0.0, 0.0, centre);
  return m;
}

void PlaneFitter::solve(const Moments& moments, GroundPlane& plane) const noexcept {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(moments.scatter);  // eq. 4
  Eigen::Vector3d normal = eigen.eigenvectors().col(0);
  if (normal.dot(moments.mean) < 0.0) normal = -normal;
  plane.normal_c = normal;
  plane.distance_m = normal.dot(moments.mean);
}

void PlaneFitter::solve_svd(const Rows& all, GroundPlane& plane) const noexcept {
  // Q'Q has the right singular vectors of the N x 4 matrix Q; in double precision the squares leave enough digits.
  Eigen::Matrix4d square = Eigen::Matrix4d::Zero();
  for (std::size_t i = 0; i < all.points; ++i) {
    const Eigen::Vector4d row = all.point(i).homogeneous();
    square.noalias() += row * row.transpose();
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d> eigen(square);
  Eigen::Vector4d coefficients = eigen.eigenvectors().col(0);
  const double length = coefficients.head<3>().norm();
  if (!(length > 1e-12)) return;
  coefficients /= length;
  if (coefficients[3] > 0.0) coefficients = -coefficients;  // n . p = d with d > 0
  plane.normal_c = coefficients.head<3>();
  plane.distance_m = -coefficients[3];
}

PlaneStatus PlaneFitter::plausible(const GroundPlane& plane) const noexcept {
  if (!(plane.normal_c.z() >= std::cos(options_.max_tilt_rad))) return PlaneStatus::kWall;
  if (!(plane.distance_m >= options_.min_height_m && plane.distance_m <= options_.max_height_m)) {
    return PlaneStatus::kHeight;
  }
  return PlaneStatus::kFitted;
}

PlaneStatus PlaneFitter::search(const Rows& subset, GroundPlane& plane) {
  const auto points = static_cast<double>(subset.points);
  const auto draw = [&](std::uint64_t bits) {
    return static_cast<std::size_t>(static_cast<double>(bits & 0x1fffff) * 0x1p-21 * points);
  };
  const double chance = std::log1p(-options_.confidence);
  int best = 0, best_other = 0;
  PlaneStatus other = PlaneStatus::kDegenerate;
  double wanted = options_.max_hypotheses;
  for (int k = 0; k < options_.max_hypotheses && k < wanted; ++k) {
    const std::uint64_t bits = random_.next_u64();
    const Eigen::Vector3d p = subset.point(draw(bits));
    const Eigen::Vector3d a = subset.point(draw(bits >> 21)) - p;
    const Eigen::Vector3d b = subset.point(draw(bits >> 42)) - p;
    const Eigen::Vector3d cross = a.cross(b);
    const double area = cross.norm();
    if (!(area > 1e-3 * a.norm() * b.norm())) continue;  // a point twice, or three on a line
    GroundPlane guess;
    guess.normal_c = cross / area;
    guess.distance_m = guess.normal_c.dot(p);
    if (guess.distance_m < 0.0) {
      guess.normal_c = -guess.normal_c;
      guess.distance_m = -guess.distance_m;
    }
    if (!(guess.distance_m > 0.0)) continue;
    const PlaneStatus kind = plausible(guess);
    int count = subset.inside(guess);
    if (kind != PlaneStatus::kFitted) {
      if (count > best_other) {
        best_other = count;
        other = kind;
      }
      continue;
    }
    if (count <= best) continue;
    // Three points with noise miss many that belong to them: a refit to those around comes nearer.
    GroundPlane better = guess;
    for (int pass = 0; pass < 2; ++pass) {
      const Moments m = subset.moments(better, 2.0);
      if (m.count < 4) break;
      solve(m, better);
    }
    const int more = subset.inside(better);
    if (more > count && plausible(better) == PlaneStatus::kFitted) {
      count = more;
      guess = better;
    }
    best = count;
    plane.normal_c = guess.normal_c;
    plane.distance_m = guess.distance_m;
    const double share = std::min(best / points, 0.999);
    wanted = std::max(20.0, chance / std::log1p(-share * share * share));
  }
  const double least = options_.min_share * points;
  if (best >= least) return PlaneStatus::kFitted;
  if (best_other >= least) return other;
  return best == 0 && best_other == 0 ? PlaneStatus::kDegenerate : PlaneStatus::kNoPlane;
}

void PlaneFitter::state_covariance(const Moments& moments, GroundPlane& plane) const noexcept {
  const Eigen::Matrix3d axes = body_axes(plane.normal_c);
  const Eigen::Matrix<double, 2, 3> flat = axes.topRows<2>();
  const Eigen::Vector2d mean = flat * moments.mean;
  Eigen::Matrix3d information;  // of [eta_1 eta_2 d]: e changes by (u, v, -1) (eq. 5)
  information.topLeftCorner<2, 2>() =
      flat * moments.scatter * flat.transpose() + moments.weight * mean * mean.transpose();
  information.topRightCorner<2, 1>() = -moments.weight * mean;
  information.bottomLeftCorner<1, 2>() = information.topRightCorner<2, 1>().transpose();
  information(2, 2) = moments.weight;
  const double along = std::max(plane.normal_c.dot(moments.scatter * plane.normal_c), 0.0);
  const double offset = plane.normal_c.dot(moments.mean) - plane.distance_m;
  const double square = along + moments.weight * offset * offset;
  const double variance = square / std::max(moments.count - 3, 1);
  plane.covariance = covariance_of(information) * (variance * options_.noise_cluster);
  plane.inliers = moments.count;
  plane.rms_m = std::sqrt(moments.square / std::max(moments.count, 1));
}

GroundPlane PlaneFitter::fit(std::span<const float> xyz) {
  GroundPlane plane;
  const std::size_t points = load(xyz);
  plane.points = static_cast<int>(points);
  const auto refused = [&](PlaneStatus status) {  // numbers of what is not the ground do not leave
    GroundPlane none;
    none.status = status;
    none.points = static_cast<int>(points);
    return none;
  };
  if (plane.points < options_.min_points) return refused(PlaneStatus::kTooFew);
  const Rows all{cloud_.data(), row_, points, &options_};
  Moments moments;
  if (options_.method == PlaneMethod::kSvd) {
    solve_svd(all, plane);
    moments = all.moments(plane, kAnyBand);
    plane.status = PlaneStatus::kFitted;
  } else {
    plane.status = search(draw_subset(points), plane);
    if (!plane.ok()) return refused(plane.status);
    double widened = 2.0;
    for (int pass = 0; pass < 8; ++pass) {
      moments = all.moments(plane, widened);
      if (moments.count < options_.min_points) return refused(PlaneStatus::kNoPlane);
      const Eigen::Vector3d before = plane.normal_c;
      solve(moments, plane);
      if (widened == 1.0 && (plane.normal_c - before).squaredNorm() < 1e-14) break;
      widened = 1.0;
    }
  }
  const PlaneStatus kind = plausible(plane);
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> spread(moments.scatter, Eigen::EigenvaluesOnly);
  const double thin = std::max(spread.eigenvalues()[0], 0.0);
  // Points on a line have no spread across it beyond their noise; all points together may well be thick.
  const bool robust = options_.method == PlaneMethod::kRansac;
  if (!(moments.weight > 0.0) || (robust && !(spread.eigenvalues()[1] > 25.0 * thin)) ||
      !(spread.eigenvalues()[1] > (robust ? 1e-6 : 1e-4) * spread.eigenvalues()[2])) {
    return refused(PlaneStatus::kDegenerate);
  }
  if (kind != PlaneStatus::kFitted) return refused(kind);
  if (moments.count < options_.min_share * plane.points) return refused(PlaneStatus::kNoPlane);
  state_covariance(moments, plane);
  return plane.covariance.allFinite() ? plane : refused(PlaneStatus::kDegenerate);
}

}  // namespace soopnav::vision
