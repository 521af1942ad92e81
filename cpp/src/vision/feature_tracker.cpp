#include "soopnav/vision/feature_tracker.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <opencv2/core.hpp>
#include <opencv2/core/utility.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace soopnav::vision {
namespace {

constexpr double kMostlyAlike = 0.98;  // share of pixels that makes a frame dark or saturated
constexpr int kDarkLevel = 6;
constexpr int kSaturatedLevel = 249;
constexpr double kMiddleLevel = 128.0;
constexpr double kFlatEnergy = 0.02;   // mean squared gradient [levels^2/px^2]: less than the noise of any camera
constexpr double kBlurredBelow = 0.3;  // of the usual sharpness
constexpr double kSharpnessMemory = 0.1;
constexpr double kWellFollowed = 0.5;  // share of tracks below which another start is tried
constexpr double kLeastFollowed = 0.05;
constexpr int kPredictedLevels = 1;
constexpr int kQuarter = 4;
constexpr int kOverlapWidth = 80;  // of the images whose overlap is searched [px]

[[noreturn]] void refuse(const char* name, const std::string& value, const char* rule) {
  throw std::invalid_argument(std::string(name) + ": " + value + "; " + rule);
}

void need(bool good, const char* name, int value, const char* rule) {
  if (!good) refuse(name, std::to_string(value), rule);
}

void need(bool good, const char* name, double value, const char* rule) {
  if (!good) refuse(name, std::to_string(value), rule);
}

void check(int width, int height, const FeatureTrackerOptions& o) {
  need(width >= 32 && width <= 16384, "width", width, "32 to 16384 pixels are possible");
  need(height >= 32 && height <= 16384, "height", height, "32 to 16384 pixels are possible");
  need(o.tracks >= 1 && o.tracks <= 20000, "tracks", o.tracks, "1 to 20000 are possible");
  need(o.cell_px >= 8, "cell_px", o.cell_px, "at least 8 is needed");
  need(o.quality > 0.0 && o.quality < 1.0, "quality", o.quality, "it must lie between 0 and 1");
  need(o.least_eigenvalue > 0.0 && std::isfinite(o.least_eigenvalue), "least_eigenvalue", o.least_eigenvalue,
       "it must be positive");
  need(o.min_distance_px >= 1.0 && o.min_distance_px <= 100.0, "min_distance_px", o.min_distance_px,
       "1 to 100 is possible");
  need(o.border_px >= 2 && 2 * o.border_px + 8 <= std::min(width, height), "border_px", o.border_px,
       "at least 2, and less than half of the image, is needed");
  need(o.redetect_share >= 0.0 && o.redetect_share <= 1.0, "redetect_share", o.redetect_share, "0 to 1 is possible");
  need(o.window_px >= 5 && o.window_px <= 63 && o.window_px % 2 == 1, "window_px", o.window_px,
       "an odd number from 5 to 63 is needed");
  need(o.levels >= 0 && o.levels <= 8, "levels", o.levels, "0 to 8 are possible");
  need(o.iterations >= 1 && o.iterations <= 100, "iterations", o.iterations, "1 to 100 are possible");
  need(o.epsilon_px > 0.0 && o.epsilon_px < 1.0, "epsilon_px", o.epsilon_px, "it must lie between 0 and 1");
  need(o.round_trip_px > 0.0 && std::isfinite(o.round_trip_px), "round_trip_px", o.round_trip_px,
       "it must be positive");
  need(o.most_flow_px > 0.0 && std::isfinite(o.most_flow_px), "most_flow_px", o.most_flow_px, "it must be positive");
  need(o.patience >= 0, "patience", o.patience, "it must not be negative");
  need(o.smoothing_px >= 0.0 && o.smoothing_px <= 5.0, "smoothing_px", o.smoothing_px, "0 to 5 is possible");
}

// Runs what calls OpenCV in this thread alone: inside a parallel loop, here one of a single step, OpenCV starts no
// other. Its number of threads, which belongs to the whole process, is left alone. False when it threw.
template <class Body>
bool serially(const Body& body) noexcept {
  try {
    cv::parallel_for_(cv::Range(0, 1), [&](const cv::Range&) { body(); });
    return true;
  } catch (...) {
    return false;
  }
}

Eigen::Vector2d vector_of(const cv::Point2f& p) { return {p.x, p.y}; }

cv::Point2f point_of(const Eigen::Vector2d& p) { return {static_cast<float>(p.x()), static_cast<float>(p.y())}; }

struct Corner {
  int rank;  // among those of its cell
  float eigenvalue;
  int u, v;
};

// A frame, and what is compared of it.
struct Frame {
  cv::Mat raw;
  cv::Mat smooth;
  std::vector<cv::Mat> pyramid;
  int levels = 0;
};

// Tracks followed from one start.
struct Attempt {
  std::vector<cv::Point2f> start, to, back;
  std::vector<unsigned char> forth_found, back_found, good;
  std::vector<float> round_trip;
  int followed = 0;
};

}  // namespace

class FeatureTracker::Impl {
 public:
  Impl(int width, int height, const FeatureTrackerOptions& options)
      : options_(options),
        size_(width, height),
        cells_u_((width + options.cell_px - 1) / options.cell_px),
        cells_v_((height + options.cell_px - 1) / options.cell_px) {
    const auto n = static_cast<std::size_t>(options.tracks);
    tracks_.reserve(n);
    from_.reserve(n);
    flows_.reserve(n);
    for (Attempt* attempt : {&best_, &other_}) {
      attempt->start.reserve(n);
      attempt->to.reserve(n);
      attempt->back.reserve(n);
      attempt->good.reserve(n);
      attempt->round_trip.reserve(n);
    }
    in_cell_.resize(static_cast<std::size_t>(cells_u_) * static_cast<std::size_t>(cells_v_));
    taken_ = cv::Mat(size_, CV_8U);
    // Reached by a frame that is nothing but corners: one in every 2 x 2 pixels.
    corners_.reserve(static_cast<std::size_t>(width) * static_cast<std::size_t>(height) / 4 + 1);
    cv::createHanningWindow(hann_, quarter(), CV_32F);
  }

  TrackedFrame track(const ImageView& image, std::span<const Eigen::Vector2d> predicted) noexcept {
    TrackedFrame report;
    if (image.data == nullptr || image.width != size_.width || image.height != size_.height ||
        image.stride < image.width) {
      return report;
    }
    if (!serially([&] { report = next(image, predicted); })) report = {};
    return report;
  }

  void prune(std::span<const std::uint8_t> keep) noexcept {
    if (keep.size() != tracks_.size()) return;
    std::size_t kept = 0;
    for (std::size_t i = 0; i < tracks_.size(); ++i) {
      if (keep[i] != 0) tracks_[kept++] = tracks_[i];
    }
    tracks_.resize(kept);
  }

  void reset() noexcept {
    tracks_.clear();
    has_reference_ = false;
    useless_ = 0;
    usual_energy_ = 0.0;
  }

  std::span<const FeatureTrack> tracks() const noexcept { return tracks_; }
  const FeatureTrackerOptions& options() const noexcept { return options_; }

 private:
  cv::Size quarter() const { return {size_.width / kQuarter, size_.height / kQuarter}; }

  TrackedFrame next(const ImageView& image, std::span<const Eigen::Vector2d> predicted) {
    TrackedFrame report;
    const cv::Mat view(size_, CV_8U, const_cast<std::uint8_t*>(image.data), static_cast<std::size_t>(image.stride));
    if (has_reference_ && same_pixels(view)) {
      report.status = FrameStatus::kRepeated;
      report.skipped = useless_;
      return report;
    }
    prepare(view);
    const double energy = gradient_energy();
    report.sharpness = usual_energy_ > 0.0 ? energy / usual_energy_ : 1.0;
    report.skipped = useless_;
    const FrameStatus useless = judge(energy, report.sharpness);
    const bool hopeless = useless != FrameStatus::kLost && useless != FrameStatus::kBlurred;
    if (has_reference_ && !tracks_.empty() && !hopeless) follow(predicted, report);
    const bool followed = report.followed >= std::max(1.0, kLeastFollowed * static_cast<double>(tracks_.size()));
    if (followed) {
      take_over(report);
      report.status = FrameStatus::kTracked;
      if (report.followed < options_.redetect_share * options_.tracks) report.born = detect();
      accept(energy);
      return report;
    }
    report.lost = static_cast<int>(tracks_.size());
    report.followed = 0;
    if (useless != FrameStatus::kLost) {
      report.status = useless;
      if (++useless_ > options_.patience) reset();
      return report;
    }
    // A good frame on which nothing was found again.
    const bool first = !has_reference_ || tracks_.empty();
    tracks_.clear();
    report.born = detect();
    if (report.born == 0) {
      report.status = FrameStatus::kFlat;
      if (++useless_ > options_.patience) reset();
      return report;
    }
    report.status = first ? FrameStatus::kFirst : FrameStatus::kLost;
    accept(energy);
    return report;
  }

  bool same_pixels(const cv::Mat& view) const {
    for (int v = 0; v < size_.height; ++v) {
      if (std::memcmp(view.ptr(v), reference_.raw.ptr(v), static_cast<std::size_t>(size_.width)) != 0) return false;
    }
    return true;
  }

  void prepare(const cv::Mat& view) {
    view.copyTo(current_.raw);
    if (options_.smoothing_px > 0.0) {
      cv::GaussianBlur(current_.raw, current_.smooth, cv::Size(), options_.smoothing_px);
    } else {
      current_.raw.copyTo(current_.smooth);
    }
    // Less the mean of the surroundings: a flickering lamp would move the patches that have little to hold on to.
    const int reach = 2 * options_.window_px + 1;
    cv::blur(current_.smooth, mean_, {reach, reach});
    cv::addWeighted(current_.smooth, 1.0, mean_, -1.0, kMiddleLevel, current_.smooth);
    current_.levels = cv::buildOpticalFlowPyramid(current_.smooth, current_.pyramid, window(), options_.levels, true,
                                                  cv::BORDER_REFLECT_101, cv::BORDER_CONSTANT, false);
  }

  cv::Size window() const { return {options_.window_px, options_.window_px}; }

  // Mean squared difference between neighbours, over every fourth row.
  double gradient_energy() const {
    double sum = 0.0;
    long count = 0;
    for (int v = 1; v + 1 < size_.height; v += 4) {
      const std::uint8_t* row = current_.smooth.ptr(v);
      const std::uint8_t* below = current_.smooth.ptr(v + 1);
      int row_sum = 0;
      for (int u = 0; u + 1 < size_.width; ++u) {
        const int along = row[u + 1] - row[u], down = below[u] - row[u];
        row_sum += along * along + down * down;
      }
      sum += row_sum;
      count += size_.width - 1;
    }
    return sum / static_cast<double>(count);
  }

  // Why nothing can be followed; kLost when the frame itself is good.
  FrameStatus judge(double energy, double sharpness) const {
    long dark = 0, bright = 0, count = 0;
    for (int v = 0; v < size_.height; v += 4) {
      const std::uint8_t* row = current_.raw.ptr(v);
      for (int u = 0; u < size_.width; ++u) {
        dark += row[u] <= kDarkLevel ? 1 : 0;
        bright += row[u] >= kSaturatedLevel ? 1 : 0;
      }
      count += size_.width;
    }
    const double most = kMostlyAlike * static_cast<double>(count);
    if (static_cast<double>(dark) >= most) return FrameStatus::kDark;
    if (static_cast<double>(bright) >= most) return FrameStatus::kSaturated;
    if (energy < kFlatEnergy) return FrameStatus::kFlat;
    if (has_reference_ && !tracks_.empty() && sharpness < kBlurredBelow) return FrameStatus::kBlurred;
    return FrameStatus::kLost;
  }

  void accept(double energy) {
    usual_energy_ = usual_energy_ > 0.0 ? usual_energy_ + kSharpnessMemory * (energy - usual_energy_) : energy;
    std::swap(current_, reference_);
    has_reference_ = true;
    useless_ = 0;
  }

  void follow(std::span<const Eigen::Vector2d> predicted, TrackedFrame& report) {
    from_.clear();
    for (const FeatureTrack& track : tracks_) from_.push_back(point_of(track.pixel));
    const double enough = kWellFollowed * static_cast<double>(tracks_.size());
    best_.followed = -1;
    if (predicted.size() == tracks_.size() && start_at(predicted)) {
      attempt(other_, kPredictedLevels);
      keep_better(FlowStart::kPrediction, report);
    }
    if (best_.followed < enough) {
      const Eigen::Vector2d shift = whole_shift(report.shift_response);
      report.shift_px = shift;
      start_at(shift);
      attempt(other_, options_.levels);
      keep_better(FlowStart::kPhaseCorrelation, report);
      if (best_.followed < enough) {
        start_at(best_overlap());
        attempt(other_, options_.levels);
        keep_better(FlowStart::kOverlap, report);
      }
    }
    report.followed = std::max(0, best_.followed);
  }

  void keep_better(FlowStart start, TrackedFrame& report) {
    if (other_.followed <= best_.followed) return;
    std::swap(other_, best_);
    report.start = start;
  }

  // Starts at the predictions; where there is none, at the mean flow of the others. False when there is none at all.
  bool start_at(std::span<const Eigen::Vector2d> predicted) {
    Eigen::Vector2d mean = Eigen::Vector2d::Zero();
    int count = 0;
    for (std::size_t i = 0; i < tracks_.size(); ++i) {
      if (!predicted[i].allFinite()) continue;
      mean += predicted[i] - tracks_[i].pixel;
      ++count;
    }
    if (count == 0) return false;
    mean /= count;
    other_.to.clear();
    for (std::size_t i = 0; i < tracks_.size(); ++i) {
      other_.to.push_back(predicted[i].allFinite() ? point_of(predicted[i]) : point_of(tracks_[i].pixel + mean));
    }
    return true;
  }

  void start_at(const Eigen::Vector2d& shift) {
    other_.to.clear();
    for (const FeatureTrack& track : tracks_) other_.to.push_back(point_of(track.pixel + shift));
  }

  // Shift of the whole image from the reference to this frame (doc/feature_tracks.md eq. 5).
  Eigen::Vector2d whole_shift(double& response) {
    cv::resize(reference_.smooth, small_, quarter(), 0.0, 0.0, cv::INTER_AREA);
    small_.convertTo(small_reference_, CV_32F);
    cv::resize(current_.smooth, small_, quarter(), 0.0, 0.0, cv::INTER_AREA);
    small_.convertTo(small_current_, CV_32F);
    const cv::Point2d shift = cv::phaseCorrelate(small_reference_, small_current_, hann_, &response);
    if (!std::isfinite(shift.x) || !std::isfinite(shift.y)) return Eigen::Vector2d::Zero();
    return {shift.x * size_.width / quarter().width, shift.y * size_.height / quarter().height};
  }

  // The shift at which what both frames show is most alike, over all that leave a quarter of them in common: slow and
  // coarse, for steps so long that a window leaves phase correlation nothing (doc/feature_tracks.md eq. 6).
  Eigen::Vector2d best_overlap() {
    const int factor = (size_.width + kOverlapWidth - 1) / kOverlapWidth;
    const cv::Size small(size_.width / factor, std::max(1, size_.height / factor));
    const auto shrink = [&](const cv::Mat& image, cv::Mat& out) {
      cv::resize(image, small_, small, 0.0, 0.0, cv::INTER_AREA);
      small_.convertTo(out, CV_32F, 1.0, -cv::mean(small_)[0]);
    };
    shrink(reference_.smooth, small_reference_);
    shrink(current_.smooth, small_current_);
    double best = 0.0;
    cv::Point found(0, 0);
    for (int dv = -small.height * 3 / 4; dv <= small.height * 3 / 4; ++dv) {
      for (int du = -small.width * 3 / 4; du <= small.width * 3 / 4; ++du) {
        const int columns = small.width - std::abs(du), rows = small.height - std::abs(dv);
        if (4 * columns * rows < small.area()) continue;
        float ab = 0.0F, aa = 0.0F, bb = 0.0F;
        for (int v = 0; v < rows; ++v) {
          const float* a = small_reference_.ptr<float>(v + std::max(0, -dv)) + std::max(0, -du);
          const float* b = small_current_.ptr<float>(v + std::max(0, dv)) + std::max(0, du);
          for (int u = 0; u < columns; ++u) {
            ab += a[u] * b[u];
            aa += a[u] * a[u];
            bb += b[u] * b[u];
          }
        }
        if (!(aa > 0.0F) || !(bb > 0.0F)) continue;
        // A likeness by chance shrinks with the root of the pixels in common.
        const double alike = static_cast<double>(ab) / std::sqrt(static_cast<double>(aa) * static_cast<double>(bb)) *
                             std::sqrt(static_cast<double>(columns) * rows);
        if (alike <= best) continue;
        best = alike;
        found = {du, dv};
      }
    }
    return {static_cast<double>(found.x) * factor, static_cast<double>(found.y) * factor};
  }

  // Forwards from other_.to, and backwards; fills `a`.
  void attempt(Attempt& a, int levels) {
    levels = std::min({levels, reference_.levels, current_.levels});
    const std::size_t n = from_.size();
    const cv::TermCriteria stop(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, options_.iterations,
                                options_.epsilon_px);
    a.back.resize(n);
    a.start.assign(a.to.begin(), a.to.end());
    a.good.assign(n, 0);
    a.round_trip.assign(n, 0.0F);
    const cv::Rect2f within(0.0F, 0.0F, static_cast<float>(size_.width - 1), static_cast<float>(size_.height - 1));
    cv::calcOpticalFlowPyrLK(reference_.pyramid, current_.pyramid, from_, a.to, a.forth_found, cv::noArray(), window(),
                             levels, stop, cv::OPTFLOW_USE_INITIAL_FLOW);
    for (std::size_t i = 0; i < n; ++i) {
      if (a.forth_found[i] == 0 || !within.contains(a.to[i])) {
        a.forth_found[i] = 0;
        a.to[i] = from_[i];
      }
      // Not from where it should end: a wrong place that looks like the right one would agree with itself.
      a.back[i] = a.to[i] - a.start[i] + from_[i];
    }
    cv::calcOpticalFlowPyrLK(current_.pyramid, reference_.pyramid, a.to, a.back, a.back_found, cv::noArray(), window(),
                             levels, stop, cv::OPTFLOW_USE_INITIAL_FLOW);
    a.followed = 0;
    const auto border = static_cast<float>(options_.border_px);
    const float right = static_cast<float>(size_.width - 1) - border;
    const float below = static_cast<float>(size_.height - 1) - border;
    for (std::size_t i = 0; i < n; ++i) {
      if (a.forth_found[i] == 0 || a.back_found[i] == 0) continue;
      const cv::Point2f miss = a.back[i] - from_[i];
      a.round_trip[i] = std::sqrt(miss.dot(miss));
      a.to[i] -= 0.5F * miss;
      const cv::Point2f flow = a.to[i] - from_[i];
      const bool inside = a.to[i].x >= border && a.to[i].y >= border && a.to[i].x <= right && a.to[i].y <= below;
      const bool good = inside && static_cast<double>(a.round_trip[i]) <= options_.round_trip_px &&
                        cv::norm(flow) <= options_.most_flow_px;  // NaN fails
      a.good[i] = good ? 1 : 0;
      a.followed += good ? 1 : 0;
    }
  }

  void take_over(TrackedFrame& report) {
    std::size_t kept = 0;
    flows_.clear();
    for (std::size_t i = 0; i < tracks_.size(); ++i) {
      if (best_.good[i] == 0) continue;
      FeatureTrack track = tracks_[i];
      track.pixel_previous = track.pixel;
      track.pixel = vector_of(best_.to[i]);
      track.round_trip_px = best_.round_trip[i];
      ++track.age;
      flows_.push_back((track.pixel - track.pixel_previous).norm());
      tracks_[kept++] = track;
    }
    report.lost = static_cast<int>(tracks_.size() - kept);
    tracks_.resize(kept);
    const auto middle = flows_.begin() + static_cast<std::ptrdiff_t>(flows_.size() / 2);
    std::nth_element(flows_.begin(), middle, flows_.end());
    report.median_flow_px = *middle;
  }

  // New corners on the current frame, beside the tracks there are.
  int detect() {
    cv::cornerMinEigenVal(current_.smooth, eigenvalues_, 5, 3);
    double largest = 0.0;
    cv::minMaxLoc(eigenvalues_, nullptr, &largest);
    const auto threshold = static_cast<float>(std::max(options_.quality * largest, options_.least_eigenvalue));
    std::fill(in_cell_.begin(), in_cell_.end(), 0);
    taken_.setTo(0);
    for (const FeatureTrack& track : tracks_) occupy(track.pixel);
    collect(threshold);
    std::sort(corners_.begin(), corners_.end(), [](const Corner& a, const Corner& b) {
      if (a.rank != b.rank) return a.rank < b.rank;
      if (a.eigenvalue != b.eigenvalue) return a.eigenvalue > b.eigenvalue;
      return a.v != b.v ? a.v < b.v : a.u < b.u;
    });
    int born = 0;
    for (const Corner& corner : corners_) {
      if (tracks_.size() >= static_cast<std::size_t>(options_.tracks)) break;
      if (taken_.at<unsigned char>(corner.v, corner.u) != 0) continue;
      FeatureTrack track;
      track.id = next_id_++;
      track.pixel = {static_cast<double>(corner.u), static_cast<double>(corner.v)};
      track.pixel_previous = track.pixel;
      tracks_.push_back(track);
      occupy(track.pixel);
      ++born;
    }
    return born;
  }

  std::size_t cell_of(int u, int v) const {
    return static_cast<std::size_t>(v / options_.cell_px) * static_cast<std::size_t>(cells_u_) +
           static_cast<std::size_t>(u / options_.cell_px);
  }

  void occupy(const Eigen::Vector2d& pixel) {
    const int u = static_cast<int>(std::lround(pixel.x())), v = static_cast<int>(std::lround(pixel.y()));
    const int reach = static_cast<int>(std::ceil(options_.min_distance_px)) - 1;
    const double limit = options_.min_distance_px * options_.min_distance_px;
    for (int y = std::max(0, v - reach); y <= std::min(size_.height - 1, v + reach); ++y) {
      for (int x = std::max(0, u - reach); x <= std::min(size_.width - 1, u + reach); ++x) {
        if ((x - u) * (x - u) + (y - v) * (y - v) < limit) taken_.at<unsigned char>(y, x) = 1;
      }
    }
    ++in_cell_[cell_of(std::clamp(u, 0, size_.width - 1), std::clamp(v, 0, size_.height - 1))];
  }

  // Local maxima above the threshold, cell by cell the strongest first; tracks count as the cell's first ones.
  void collect(float threshold) {
    corners_.clear();
    const int border = options_.border_px, cell = options_.cell_px;
    for (int cell_v = 0; cell_v < cells_v_; ++cell_v) {
      for (int cell_u = 0; cell_u < cells_u_; ++cell_u) {
        const std::size_t first = corners_.size();
        const int top = std::max(border, cell_v * cell), left = std::max(border, cell_u * cell);
        const int bottom = std::min(size_.height - border, (cell_v + 1) * cell);
        const int right = std::min(size_.width - border, (cell_u + 1) * cell);
        for (int v = top; v < bottom; ++v) {
          const float* above = eigenvalues_.ptr<float>(v - 1);
          const float* here = eigenvalues_.ptr<float>(v);
          const float* below = eigenvalues_.ptr<float>(v + 1);
          for (int u = left; u < right; ++u) {
            const float value = here[u];
            if (value < threshold || taken_.at<unsigned char>(v, u) != 0) continue;
            const bool peak = value > here[u - 1] && value >= here[u + 1] && value > above[u - 1] && value > above[u] &&
                              value > above[u + 1] && value >= below[u - 1] && value >= below[u] &&
                              value >= below[u + 1];
            if (peak) corners_.push_back({0, value, u, v});
          }
        }
        std::sort(corners_.begin() + static_cast<std::ptrdiff_t>(first), corners_.end(),
                  [](const Corner& a, const Corner& b) {
                    if (a.eigenvalue != b.eigenvalue) return a.eigenvalue > b.eigenvalue;
                    return a.v != b.v ? a.v < b.v : a.u < b.u;
                  });
        int rank = in_cell_[static_cast<std::size_t>(cell_v) * static_cast<std::size_t>(cells_u_) +
                            static_cast<std::size_t>(cell_u)];
        for (std::size_t i = first; i < corners_.size(); ++i) corners_[i].rank = rank++;
      }
    }
  }

  FeatureTrackerOptions options_;
  cv::Size size_;
  int cells_u_, cells_v_;
  Frame reference_, current_;
  bool has_reference_ = false;
  int useless_ = 0;
  double usual_energy_ = 0.0;
  std::uint64_t next_id_ = 0;
  std::vector<FeatureTrack> tracks_;
  std::vector<cv::Point2f> from_;
  std::vector<double> flows_;
  Attempt best_, other_;
  cv::Mat mean_, eigenvalues_, taken_, hann_, small_, small_reference_, small_current_;
  std::vector<int> in_cell_;
  std::vector<Corner> corners_;
};

bool tracking_available() noexcept { return true; }

std::string_view opencv_version() noexcept { return CV_VERSION; }

FeatureTracker::FeatureTracker(int width, int height, const FeatureTrackerOptions& options) {
  check(width, height, options);
  impl_ = std::make_unique<Impl>(width, height, options);
}
FeatureTracker::FeatureTracker(FeatureTracker&&) noexcept = default;
FeatureTracker& FeatureTracker::operator=(FeatureTracker&&) noexcept = default;
FeatureTracker::~FeatureTracker() = default;

TrackedFrame FeatureTracker::track(const ImageView& image, std::span<const Eigen::Vector2d> predicted) noexcept {
  return impl_->track(image, predicted);
}

std::span<const FeatureTrack> FeatureTracker::tracks() const noexcept { return impl_->tracks(); }

void FeatureTracker::prune(std::span<const std::uint8_t> keep) noexcept { impl_->prune(keep); }

void FeatureTracker::reset() noexcept { impl_->reset(); }

const FeatureTrackerOptions& FeatureTracker::options() const noexcept { return impl_->options(); }

}  // namespace soopnav::vision
