#include "soopnav/vision/ego_motion.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

#include "soopnav/vision/ground_projection.hpp"

namespace soopnav::vision {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kEnoughMature = 0.6;  // share of the tracks followed that must be old enough to do without the others
constexpr double kFarGaps = 100.0;     // a time more than so many max_gap_s away is doubted
constexpr int kBelieved = 3;           // times in a row, each above the one before, that are far away and believed

void need(bool good, const char* name, double value, const char* rule) {
  if (good) return;
  throw std::invalid_argument(std::string(name) + ": " + std::to_string(value) + "; " + rule);
}

void check(const EgoMotionOptions& o) {
  const auto positive = [](double value) { return std::isfinite(value) && value > 0.0; };
  need(o.depth_offset_m.allFinite() && o.depth_offset_m.norm() < 10.0, "depth_offset_m", o.depth_offset_m.norm(),
       "a finite vector below 10 m is needed");
  need(o.min_age >= 1, "min_age", o.min_age, "at least 1 is needed");
  need(o.outlier_frames >= 1, "outlier_frames", o.outlier_frames, "at least 1 is needed");
  need(positive(o.max_gap_s), "max_gap_s", o.max_gap_s, "it must be positive");
  need(positive(o.acceleration_mps2), "acceleration_mps2", o.acceleration_mps2, "it must be positive");
  need(positive(o.speed_mps), "speed_mps", o.speed_mps, "it must be positive");
  need(positive(o.turn_rate_radps), "turn_rate_radps", o.turn_rate_radps, "it must be positive");
  need(positive(o.coast_s), "coast_s", o.coast_s, "it must be positive");
  need(positive(o.surprise_mps), "surprise_mps", o.surprise_mps, "it must be positive");
  need(o.rival_share > 0.0 && o.rival_share <= 1.0, "rival_share", o.rival_share, "it must lie between 0 and 1");
}

const EgoMotionOptions& checked(const EgoMotionOptions& options) {
  check(options);
  return options;
}

bool tracks_over(FrameStatus status) {
  return status == FrameStatus::kFirst || status == FrameStatus::kTracked || status == FrameStatus::kLost;
}

}  // namespace

EgoMotion::EgoMotion(const Camera& camera, const EgoMotionOptions& options)
    : camera_(camera),
      options_(checked(options)),
      tracker_(camera.width(), camera.height(), options.tracker),
      fitter_(options.plane),
      rigid_(options.rigid) {
  const auto n = static_cast<std::size_t>(options.tracker.tracks);
  rigid_.reserve(n);
  anchor_tracks_.reserve(n);
  for (auto* list : {&predicted_, &from_, &to_, &from_rival_, &to_rival_}) list->reserve(n);
  for (auto* list : {&fits_, &fits_rival_, &agrees_, &keep_}) list->reserve(n);
  which_.reserve(n);
  which_rival_.reserve(n);
}

void EgoMotion::reset() noexcept {
  tracker_.reset();
  frame_ = {};
  plane_ = {};
  started_ = anchored_ = moving_ = false;
  reference_plane_ = {};
  anchor_tracks_.clear();
  agrees_.clear();
  skipped_ = 0;
  doubted_ = 0;
}

// Whether the frame's time is to be used. One that is far away would leave all that follow behind it.
bool EgoMotion::believe(double t_s) noexcept {
  if (!std::isfinite(t_s)) return false;
  if (!started_) return true;
  const bool far = std::fabs(t_s - t_s_) > kFarGaps * options_.max_gap_s;
  if (!far) {
    doubted_ = 0;
    return t_s >= t_s_;
  }
  doubted_ = doubted_ > 0 && t_s > doubted_t_s_ ? doubted_ + 1 : 1;
  doubted_t_s_ = t_s;
  if (doubted_ < kBelieved) return false;
  doubted_ = 0;
  if (t_s < t_s_) {
    reset();
  } else {
    tracker_.reset();  // what it last saw is too old; the interval is coasted over
  }
  return true;
}

PlanarMotion EgoMotion::step(const ImageView& image, double t_s, std::span<const float> points) noexcept {
  return step(image, t_s, fitter_.fit(points).seen_from(-options_.depth_offset_m));
}

PlanarMotion EgoMotion::step(const ImageView& image, double t_s, const GroundPlane& plane) noexcept {
  PlanarMotion out;
  out.t_s = t_s;
  if (!believe(t_s)) {
    out.status = MotionStatus::kBadTime;
    return out;
  }
  if (started_ && t_s == t_s_) {
    out.status = MotionStatus::kRepeated;
    return out;
  }
  t_s_ = t_s;
  plane_ = plane;
  predict(t_s - reference_t_s_);
  frame_ = tracker_.track(image, predicted_);
  agrees_.assign(tracker_.tracks().size(), 0);
  if (tracks_over(frame_.status)) {
    reference_t_s_ = t_s;
    reference_plane_ = plane;
  }
  if (!started_) {
    started_ = tracks_over(frame_.status);
    if (started_) {
      anchor();
      out.status = MotionStatus::kFirst;
      out.height_m = plane_.ok() ? plane_.distance_m : 0.0;
      out.tracks = static_cast<int>(tracker_.tracks().size());
      return out;
    }
    out.status = MotionStatus::kBadImage;
    return out;
  }
  out = measure();
  out.t_s = t_s;
  out.height_m = plane_.ok() ? plane_.distance_m : 0.0;
  return out;
}

// Increment expected over dt_s by the last velocity.
Eigen::Vector3d EgoMotion::expected(double dt_s) const noexcept {
  const double since = std::max(0.0, anchor_t_s_ - measured_t_s_);
  return velocity_ * options_.coast_s * std::exp(-since / options_.coast_s) * -std::expm1(-dt_s / options_.coast_s);
}

// Where the tracks of the tracker's last frame are expected now (doc/feature_tracks.md eq. 4).
void EgoMotion::predict(double dt_s) {
  predicted_.clear();
  if (!started_ || !moving_ || !plane_.ok() || !reference_plane_.ok()) return;
  const GroundProjection before(reference_plane_), now(plane_);
  const Eigen::Vector3d motion = velocity_ * dt_s;
  const double c = std::cos(motion.z()), s = std::sin(motion.z());
  for (const FeatureTrack& track : tracker_.tracks()) {
    Eigen::Vector2d pixel(kNan, kNan), ground;
    Eigen::Vector3d ray;
    if (camera_.unproject(track.pixel, ray) && before.project(ray, ground)) {
      const Eigen::Vector2d moved = ground - motion.head<2>();
      if (!camera_.project(now.to_camera({c * moved.x() + s * moved.y(), -s * moved.x() + c * moved.y()}), pixel)) {
        pixel.setConstant(kNan);
      }
    }
    predicted_.push_back(pixel);
  }
}

// Tracks that the anchor has as well. Names grow along both lists.
void EgoMotion::pair_up() {
  from_.clear();
  to_.clear();
  which_.clear();
  const auto tracks = tracker_.tracks();
  for (const int least : {options_.min_age, 1}) {
    std::size_t a = 0;
    int alive = 0;
    for (std::size_t i = 0; i < tracks.size(); ++i) {
      while (a < anchor_tracks_.size() && anchor_tracks_[a].id < tracks[i].id) ++a;
      if (a == anchor_tracks_.size()) break;
      if (anchor_tracks_[a].id != tracks[i].id || tracks[i].age < 1) continue;
      ++alive;
      if (tracks[i].age < least) continue;
      from_.push_back(anchor_tracks_[a].pixel);
      to_.push_back(tracks[i].pixel);
      which_.push_back(i);
    }
    if (static_cast<double>(which_.size()) >= std::max<double>(options_.rigid.min_tracks, kEnoughMature * alive))
      return;
    if (least == 1) return;
    from_.clear();
    to_.clear();
    which_.clear();
  }
}

PlanarMotion EgoMotion::without(MotionStatus why) {
  ++skipped_;
  PlanarMotion out;
  out.status = why;
  if (t_s_ - anchor_t_s_ > options_.max_gap_s || !anchored_) {
    out = coast();
    if (frame_.status != FrameStatus::kTracked) {
      // The tracks still lie where the last good frame had them: motion since then is in `out` and must not be measured
      // again from this time on. The next tracked frame coasts up to itself and is the anchor.
      anchor_tracks_.clear();
      anchored_ = false;
    }
  }
  return out;
}

PlanarMotion EgoMotion::measure() {
  if (frame_.status == FrameStatus::kRepeated) {
    PlanarMotion out;
    out.status = MotionStatus::kRepeated;
    return out;
  }
  if (frame_.status == FrameStatus::kLost || frame_.status == FrameStatus::kFirst) {
    ++skipped_;
    return coast();  // what the anchor had is gone for good
  }
  if (frame_.status != FrameStatus::kTracked) return without(MotionStatus::kBadImage);
  if (!anchored_) return without(MotionStatus::kTooFewTracks);
  if (!plane_.ok()) return without(MotionStatus::kNoPlane);
  pair_up();
  fits_.assign(from_.size(), 0);
  PlanarMotion out = rigid_.estimate(camera_, from_, to_, anchor_plane_, plane_, fits_);
  if (out.ok()) out = prefer(out);
  if (!out.ok()) {
    const MotionStatus why = out.status;
    const bool hopeless = static_cast<int>(from_.size()) < options_.rigid.min_tracks;
    PlanarMotion failed = hopeless ? (++skipped_, coast()) : without(why);
    failed.tracks = out.tracks;
    failed.used = out.used;
    failed.inliers = out.inliers;
    failed.height_ratio = out.height_ratio;
    failed.height_ratio_plane = out.height_ratio_plane;
    failed.height_ratio_sigma = out.height_ratio_sigma;
    return failed;
  }
  out.dt_s = t_s_ - anchor_t_s_;
  out.skipped = skipped_;
  velocity_ = out.increment / out.dt_s;
  measured_t_s_ = t_s_;
  moving_ = true;
  mark_tracks();
  anchor();
  return out;
}

// A second motion among the tracks that disagree with the first, and which of the two is the ground's.
PlanarMotion EgoMotion::prefer(const PlanarMotion& majority) {
  const int others = majority.used - majority.inliers;
  if (others < std::max<double>(options_.rigid.min_tracks, options_.rival_share * majority.used)) return majority;
  from_rival_.clear();
  to_rival_.clear();
  which_rival_.clear();
  for (std::size_t i = 0; i < from_.size(); ++i) {
    if (fits_[i] != 0) continue;
    from_rival_.push_back(from_[i]);
    to_rival_.push_back(to_[i]);
    which_rival_.push_back(i);
  }
  fits_rival_.assign(from_rival_.size(), 0);
  PlanarMotion rival = rigid_.estimate(camera_, from_rival_, to_rival_, anchor_plane_, plane_, fits_rival_);
  PlanarMotion out = majority;
  if (!rival.ok() || rival.inliers < options_.rival_share * majority.used) return out;
  out.rival_share = static_cast<double>(rival.inliers) / majority.used;
  if (!moving_) return out;
  const double dt_s = t_s_ - anchor_t_s_;
  const Eigen::Vector3d hoped = expected(dt_s);
  const double allowed = options_.surprise_mps * dt_s;
  const auto surprise = [&](const PlanarMotion& m) { return (m.increment - hoped).head<2>().norm(); };
  if (surprise(majority) <= allowed || surprise(rival) > allowed) return out;
  rival.rival_share = static_cast<double>(majority.inliers) / majority.used;
  rival.tracks = majority.tracks;
  rival.used = majority.used;
  std::fill(fits_.begin(), fits_.end(), std::uint8_t{0});
  for (std::size_t k = 0; k < which_rival_.size(); ++k) fits_[which_rival_[k]] = fits_rival_[k];
  return rival;
}

// Tracks that disagree again and again are given up; agrees_ is in the order of those that stay.
void EgoMotion::mark_tracks() {
  const auto tracks = tracker_.tracks();
  keep_.assign(tracks.size(), 1);
  for (std::size_t k = 0; k < which_.size(); ++k) agrees_[which_[k]] = fits_[k];
  std::size_t a = 0, kept = 0;
  bool any = false;
  std::size_t pair = 0;
  for (std::size_t i = 0; i < tracks.size(); ++i) {
    while (a < anchor_tracks_.size() && anchor_tracks_[a].id < tracks[i].id) ++a;
    const bool paired = pair < which_.size() && which_[pair] == i;
    if (paired && a < anchor_tracks_.size() && anchor_tracks_[a].id == tracks[i].id) {
      Named& named = anchor_tracks_[a];
      named.outlier = fits_[pair] != 0 ? 0 : named.outlier + 1;
      if (named.outlier >= options_.outlier_frames) {
        keep_[i] = 0;
        any = true;
      }
    }
    pair += paired ? 1 : 0;
    if (keep_[i] != 0) agrees_[kept++] = agrees_[i];
  }
  if (!any) return;
  agrees_.resize(kept);
  tracker_.prune(keep_);
}

// The next increment starts at this frame.
void EgoMotion::anchor() {
  // Counts of disagreement go over to the tracks that stay.
  const auto tracks = tracker_.tracks();
  std::size_t a = 0, n = 0;
  keep_.assign(tracks.size(), 0);
  for (std::size_t i = 0; i < tracks.size(); ++i) {
    while (a < anchor_tracks_.size() && anchor_tracks_[a].id < tracks[i].id) ++a;
    if (a < anchor_tracks_.size() && anchor_tracks_[a].id == tracks[i].id) {
      keep_[i] = static_cast<std::uint8_t>(std::min(anchor_tracks_[a].outlier, 255));
    }
  }
  anchor_tracks_.clear();
  for (const FeatureTrack& track : tracks) anchor_tracks_.push_back({track.id, track.pixel, keep_[n++]});
  anchor_t_s_ = t_s_;
  anchor_plane_ = plane_;
  anchored_ = plane_.ok() && !anchor_tracks_.empty();
  skipped_ = 0;
}

PlanarMotion EgoMotion::coast() {
  PlanarMotion out;
  out.status = MotionStatus::kCoasted;
  out.dt_s = t_s_ - anchor_t_s_;
  out.skipped = std::max(0, skipped_ - 1);
  if (moving_) out.increment = expected(out.dt_s);
  // Variances whose sum over the steps is that of the whole gap (eq. 8).
  const double from = std::max(0.0, anchor_t_s_ - measured_t_s_), to = from + out.dt_s;
  const auto moved = [&](double after) {
    return std::min(0.5 * options_.acceleration_mps2 * after * after, options_.speed_mps * after);
  };
  const auto turned = [&](double after) { return options_.turn_rate_radps * after; };
  if (moving_) {
    out.covariance(0, 0) = out.covariance(1, 1) = moved(to) * moved(to) - moved(from) * moved(from);
    out.covariance(2, 2) = turned(to) * turned(to) - turned(from) * turned(from);
  } else {
    out.covariance(0, 0) = out.covariance(1, 1) = std::pow(options_.speed_mps * out.dt_s, 2);
    out.covariance(2, 2) = std::pow(options_.turn_rate_radps * out.dt_s, 2);
  }
  out.track_covariance = out.covariance;
  anchor();
  return out;
}

}  // namespace soopnav::vision
