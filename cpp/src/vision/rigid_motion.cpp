#include "soopnav/vision/rigid_motion.hpp"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include "soopnav/core/angle.hpp"
#include "soopnav/vision/ground_projection.hpp"
#include "vision/covariance_of.hpp"

namespace soopnav::vision {

namespace {

using Matrix23 = Eigen::Matrix<double, 2, 3>;
using Matrix24 = Eigen::Matrix<double, 2, 4>;

void require(bool holds, const char* name, double value, const char* rule) {
  if (!holds) {
    throw std::invalid_argument(std::string(name) + ": " + std::to_string(value) + "; it must be " + rule);
  }
}

Eigen::Matrix2d rotation(double angle) {
  const double c = std::cos(angle), s = std::sin(angle);
  Eigen::Matrix2d r;
  r << c, -s, s, c;
  return r;
}

}  // namespace

const char* name(MotionStatus status) noexcept {
  switch (status) {
    case MotionStatus::kMeasured:
      return "measured";
    case MotionStatus::kFirst:
      return "first frame";
    case MotionStatus::kBadImage:
      return "nothing to track in the image";
    case MotionStatus::kBadTime:
      return "time stamp not after the previous one";
    case MotionStatus::kNoPlane:
      return "no ground plane";
    case MotionStatus::kTooFewTracks:
      return "too few tracks";
    case MotionStatus::kNoConsensus:
      return "no motion that the tracks agree with";
    case MotionStatus::kDegenerate:
      return "degenerate";
    case MotionStatus::kHeightDisagreement:
      return "tracks and planes disagree about the height";
    case MotionStatus::kRepeated:
      return "repeated frame";
    case MotionStatus::kCoasted:
      return "coasted";
  }
  return "unknown";
}

RigidMotionEstimator::RigidMotionEstimator(const RigidMotionOptions& options)
    : options_(options), random_(options.seed) {
  const auto& o = options_;
  require(std::isfinite(o.min_sigma_px) && o.min_sigma_px > 0.0, "min_sigma_px", o.min_sigma_px, "positive");
  require(std::isfinite(o.inlier_px) && o.inlier_px > 4.0 * o.min_sigma_px, "inlier_px", o.inlier_px,
          "above 4 min_sigma_px");
  require(o.min_tracks >= 3, "min_tracks", o.min_tracks, "at least 3");
  require(o.min_share >= 0.0 && o.min_share <= 1.0, "min_share", o.min_share, "in [0, 1]");
  require(o.max_hypotheses >= 1 && o.max_hypotheses <= 100000, "max_hypotheses", o.max_hypotheses, "in 1 ... 100000");
  require(o.confidence > 0.0 && o.confidence < 1.0, "confidence", o.confidence, "in (0, 1)");
  require(o.height_sigmas > 0.0, "height_sigmas", o.height_sigmas, "positive");
  require(std::isfinite(o.height_tolerance) && o.height_tolerance >= 0.0, "height_tolerance", o.height_tolerance,
          "at least 0");
  require(std::isfinite(o.track_inflation) && o.track_inflation >= 1.0, "track_inflation", o.track_inflation,
          "at least 1");
}

void RigidMotionEstimator::reserve(std::size_t tracks) { tracks_.reserve(tracks); }

int RigidMotionEstimator::count(const Eigen::Vector3d& motion, double scale, double gate_px, bool mark) noexcept {
  const Eigen::Matrix2d back = rotation(motion.z()).transpose();
  const Eigen::Vector2d shift = back * motion.head<2>();
  const double gate = gate_px * gate_px;
  int agree = 0;
  for (Track& track : tracks_) {
    const Eigen::Vector2d miss = track.pixels * (scale * (back * track.from - shift) - track.to);  // eq. 13
    const bool inside = miss.squaredNorm() <= gate;
    agree += inside ? 1 : 0;
    if (mark) track.inlier = inside;
  }
  return agree;
}

int RigidMotionEstimator::search(bool any_scale, Eigen::Vector3d& motion, double& scale) noexcept {
  const auto n = static_cast<double>(tracks_.size());
  const double chance = std::log1p(-options_.confidence);
  double wanted = options_.max_hypotheses;
  int best = 0;
  for (int k = 0; k < options_.max_hypotheses && k < wanted; ++k) {
    const std::uint64_t bits = random_.next_u64();
    const Track& a = tracks_[static_cast<std::size_t>(static_cast<double>(bits >> 32) * 0x1p-32 * n)];
    const Track& b = tracks_[static_cast<std::size_t>(static_cast<double>(bits & 0xffffffff) * 0x1p-32 * n)];
    const Eigen::Vector2d from = b.from - a.from;
    const Eigen::Vector2d to = b.to - a.to;
    // Two of the same place say nothing of the turn. A rigid motion keeps lengths.
    const double per_px = a.per_px.norm() + b.per_px.norm();
    const double length = to.norm(), before = from.norm();
    if (!(length > 10.0 * per_px && before > 10.0 * per_px)) continue;
    if (!any_scale && std::fabs(length - before) > options_.inlier_px * per_px) continue;
    const double stretch = any_scale ? length / before : 1.0;
    Eigen::Vector3d guess;
    guess.z() = std::atan2(to.x() * from.y() - to.y() * from.x(), to.dot(from));
    guess.head<2>() = 0.5 * (a.from + b.from - rotation(guess.z()) * (a.to + b.to) / stretch);
    const int agree = count(guess, stretch, options_.inlier_px, false);
    if (agree <= best) continue;
    best = agree;
    motion = guess;
    scale = stretch;
    const double share = std::min(best / n, 0.999);
    wanted = std::max(10.0, chance / std::log1p(-share * share));
  }
  return best;
}

MotionStatus RigidMotionEstimator::why_none(double ratio_plane, PlanarMotion& out) noexcept {
  Eigen::Vector3d motion;
  double scale = 1.0;
  const int agree = search(true, motion, scale);
  if (agree < options_.min_tracks || agree < options_.min_share * out.used) return MotionStatus::kNoConsensus;
  // They agree once lengths are free (eq. 20): tracks and planes tell different heights, if by more than a hypothesis
  // of two tracks may err.
  if (std::fabs(scale - 1.0) < 2.0 * options_.height_tolerance) return MotionStatus::kNoConsensus;
  out.height_ratio_plane = ratio_plane;
  out.height_ratio = ratio_plane / scale;
  return MotionStatus::kHeightDisagreement;
}

bool RigidMotionEstimator::refine(Eigen::Vector3d& motion, Eigen::Matrix3d& information,
                                  double& square_px) const noexcept {
  for (int step = 0; step < 6; ++step) {
    const Eigen::Matrix2d back = rotation(motion.z()).transpose();
    const Eigen::Vector2d shift = back * motion.head<2>();
    information.setZero();
    Eigen::Vector3d gradient = Eigen::Vector3d::Zero();
    square_px = 0.0;
    for (const Track& track : tracks_) {
      if (!track.inlier) continue;
      const Eigen::Vector2d seen = back * track.from - shift;
      const Eigen::Vector2d miss = track.pixels * (seen - track.to);
      Matrix23 slope;  // eq. 14
      slope.leftCols<2>() = -track.pixels * back;
      slope.col(2) = track.pixels * Eigen::Vector2d(seen.y(), -seen.x());
      information.noalias() += slope.transpose() * slope;
      gradient.noalias() += slope.transpose() * miss;
      square_px += miss.squaredNorm();
    }
    const Eigen::LDLT<Eigen::Matrix3d> solver(information);
    if (solver.info() != Eigen::Success || !(solver.rcond() > 1e-14)) return false;
    const Eigen::Vector3d change = solver.solve(gradient);
    if (!change.allFinite()) return false;
    motion -= change;
    if (change.squaredNorm() < 1e-20) break;
  }
  return true;
}

void RigidMotionEstimator::add_planes(const Eigen::Matrix3d& information, const GroundPlane& previous,
                                      const GroundPlane& present, PlanarMotion& out) const noexcept {
  // Eq. 15-17: how the fit moves with the two planes' errors.
  const Eigen::Matrix2d turn = rotation(out.increment.z());
  const Eigen::Matrix2d back = turn.transpose();
  const Eigen::Vector2d shift = back * out.increment.head<2>();
  Eigen::Matrix3d from_previous = Eigen::Matrix3d::Zero(), from_present = Eigen::Matrix3d::Zero();
  for (const Track& track : tracks_) {
    if (!track.inlier) continue;
    const Eigen::Vector2d seen = back * track.from - shift;
    Matrix23 slope;
    slope.leftCols<2>() = -track.pixels * back;
    slope.col(2) = track.pixels * Eigen::Vector2d(seen.y(), -seen.x());
    from_previous.noalias() -= slope.transpose() * (track.pixels * back * track.from_plane);
    from_present.noalias() += slope.transpose() * (track.pixels * track.to_plane);
  }
  const Eigen::Matrix3d inverse = covariance_of(information);
  from_previous = inverse * from_previous;
  from_present = inverse * from_present;
  out.covariance = out.track_covariance + from_previous * previous.covariance * from_previous.transpose() +
                   from_present * present.covariance * from_present.transpose();
  const Matrix23 foot_previous = from_previous.topRows<2>();
  const Matrix23 foot = back * from_present.topRows<2>();
  out.foot_covariance_previous = foot_previous * previous.covariance * foot_previous.transpose();
  out.foot_covariance = foot * present.covariance * foot.transpose();
}

void RigidMotionEstimator::check_height(const GroundPlane& previous, const GroundPlane& present,
                                        PlanarMotion& out) const noexcept {
  // Eq. 18: f = [C S; -S C] f' - delta, linear in its four numbers.
  Eigen::Matrix4d normal = Eigen::Matrix4d::Zero();
  Eigen::Vector4d right = Eigen::Vector4d::Zero();
  double square = 0.0;
  Eigen::Matrix<double, 4, 3> from_previous = Eigen::Matrix<double, 4, 3>::Zero();
  Eigen::Matrix<double, 4, 3> from_present = from_previous;
  const Eigen::Matrix2d back = rotation(out.increment.z()).transpose();
  for (const Track& track : tracks_) {
    if (!track.inlier) continue;
    Matrix24 row;
    row << track.from.x(), track.from.y(), -1.0, 0.0, track.from.y(), -track.from.x(), 0.0, -1.0;
    const Matrix24 scaled = track.pixels * row;
    normal.noalias() += scaled.transpose() * scaled;
    right.noalias() += scaled.transpose() * (track.pixels * track.to);
    square += (track.pixels * track.to).squaredNorm();
    from_present.noalias() += scaled.transpose() * (track.pixels * track.to_plane);
    from_previous.noalias() -= scaled.transpose() * (track.pixels * back * track.from_plane);
  }
  const Eigen::LDLT<Eigen::Matrix4d> solver(normal);
  const Eigen::Vector4d fit = solver.solve(right);
  const double scale = std::hypot(fit[0], fit[1]);
  if (solver.info() != Eigen::Success || !fit.allFinite() || !(scale > 1e-3)) {
    out.status = MotionStatus::kDegenerate;
    return;
  }
  const Eigen::Vector4d along(fit[0] / scale, fit[1] / scale, 0.0, 0.0);
  const Eigen::Vector4d weights = solver.solve(along);
  // This fit's own residuals: those of the rigid one hold the very stretch that is looked for.
  const double left = std::max(square - right.dot(fit), 0.0) / (2.0 * out.inliers - 4.0);
  const double sigma_px = std::max(std::sqrt(left), options_.min_sigma_px);
  const double variance =
      sigma_px * sigma_px * along.dot(weights) * options_.track_inflation +
      (weights.transpose() * from_previous * previous.covariance * from_previous.transpose() * weights)(0) +
      (weights.transpose() * from_present * present.covariance * from_present.transpose() * weights)(0);
  out.height_ratio_plane = present.distance_m / previous.distance_m;
  out.height_ratio = out.height_ratio_plane / scale;  // eq. 20
  out.height_ratio_sigma = out.height_ratio * std::sqrt(std::max(variance, 0.0));
  const double gate = options_.height_sigmas * out.height_ratio_sigma + options_.height_tolerance;
  if (!(std::fabs(out.height_ratio - out.height_ratio_plane) <= gate)) out.status = MotionStatus::kHeightDisagreement;
}

PlanarMotion RigidMotionEstimator::estimate(const Camera& camera, std::span<const Eigen::Vector2d> previous_px,
                                            std::span<const Eigen::Vector2d> present_px, const GroundPlane& previous,
                                            const GroundPlane& present, std::span<std::uint8_t> inliers) {
  PlanarMotion out;
  const std::size_t offered = std::min(previous_px.size(), present_px.size());
  std::fill(inliers.begin(), inliers.end(), std::uint8_t{0});
  out.tracks = static_cast<int>(offered);
  if (present.ok()) out.height_m = present.distance_m;
  if (!previous.ok() || !present.ok()) {
    out.status = MotionStatus::kNoPlane;
    return out;
  }
  const GroundProjection before(previous), now(present);
  tracks_.clear();
  for (std::size_t i = 0; i < offered; ++i) {
    Track track;
    Eigen::Vector3d ray;
    Camera::UnprojectionJacobian ray_per_px;
    Eigen::Matrix2d to_ray;
    if (!camera.unproject(previous_px[i], ray) || !before.project(ray, track.from, nullptr, &track.from_plane) ||
        !camera.unproject(present_px[i], ray, ray_per_px) || !now.project(ray, track.to, &to_ray, &track.to_plane)) {
      continue;
    }
    track.per_px = to_ray * ray_per_px.topRows<2>();
    const double area = track.per_px.determinant();
    if (!(std::fabs(area) > 1e-18)) continue;
    track.pixels = track.per_px.inverse();
    track.index = i;
    track.inlier = false;
    tracks_.push_back(track);
  }
  out.used = static_cast<int>(tracks_.size());
  if (out.used < options_.min_tracks) {
    out.status = MotionStatus::kTooFewTracks;
    return out;
  }
  Eigen::Vector3d motion = Eigen::Vector3d::Zero();
  double scale = 1.0;
  const double ratio_plane = present.distance_m / previous.distance_m;
  if (search(false, motion, scale) < 2) {
    out.status = why_none(ratio_plane, out);
    return out;
  }
  Eigen::Matrix3d information;
  double square = 0.0, gate = options_.inlier_px;
  for (int pass = 0; pass < 4; ++pass) {
    const int agree = count(motion, 1.0, gate, true);
    out.inliers = agree;
    if (agree < options_.min_tracks || agree < options_.min_share * out.used) {
      out.status = why_none(ratio_plane, out);
      return out;
    }
    if (!refine(motion, information, square)) {
      out.status = MotionStatus::kDegenerate;
      return out;
    }
    out.rms_px = std::sqrt(square / (2.0 * agree - 3.0));
    // Four sigma of both axes together keep 99.97 % of right ones.
    gate = std::clamp(4.0 * out.rms_px, 4.0 * options_.min_sigma_px, options_.inlier_px);
  }
  out.sigma_px = std::max(out.rms_px, options_.min_sigma_px);
  out.increment << motion.x(), motion.y(), wrap_to_pi(motion.z());
  out.track_covariance = covariance_of(information) * (out.sigma_px * out.sigma_px * options_.track_inflation);
  if (!out.track_covariance.allFinite()) {
    out.status = MotionStatus::kDegenerate;
    out.increment.setZero();
    out.track_covariance.setZero();
    return out;
  }
  out.status = MotionStatus::kMeasured;
  add_planes(information, previous, present, out);
  check_height(previous, present, out);
  for (const Track& track : tracks_) {
    if (track.inlier && track.index < inliers.size()) inliers[track.index] = 1;
  }
  if (!out.ok()) {  // an increment nobody should use does not leave
    out.increment.setZero();
    out.covariance.setZero();
    out.track_covariance.setZero();
    out.foot_covariance.setZero();
    out.foot_covariance_previous.setZero();
  }
  return out;
}

}  // namespace soopnav::vision
