#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string_view>

/// Corners of an image followed from frame to frame (nielsen §4.2.2 and Annex A). Needs OpenCV's core, imgproc and
/// video.
namespace soopnav::vision {

/// Grey pixels, row by row: not owned.
struct ImageView {
  const std::uint8_t* data = nullptr;
  int width = 0;              ///< [px]
  int height = 0;             ///< [px]
  std::ptrdiff_t stride = 0;  ///< from row to row [bytes]
};

/// Whether this build can track: it was made with OpenCV. Without it FeatureTracker and EgoMotion throw
/// std::runtime_error with a sentence that says so; cameras, planes and motions work either way.
[[nodiscard]] bool tracking_available() noexcept;

/// Version of the OpenCV in use, such as "4.6.0"; empty without one.
[[nodiscard]] std::string_view opencv_version() noexcept;

/// What became of a frame.
enum class FrameStatus {
  kFirst,      ///< nothing to compare with: corners were found, none has moved yet
  kTracked,    ///< tracks came over from the frame before
  kRepeated,   ///< every pixel is that of the frame before; tracks are untouched
  kDark,       ///< nothing followed, nearly all pixels at the lower end
  kSaturated,  ///< nothing followed, nearly all pixels at the upper end
  kFlat,       ///< nothing followed, no corner in sight
  kBlurred,    ///< nothing followed, and far less sharp than the frames before
  kLost,       ///< nothing followed on a good frame, which becomes the first again
  kBadImage,   ///< another size than the tracker was made for, no pixels, or OpenCV failed: nothing changed
};

/// Where the search for a track started.
enum class FlowStart {
  kNone,              ///< nothing was searched
  kPrediction,        ///< at the places the caller predicted
  kPhaseCorrelation,  ///< at the shift of the whole image
  kOverlap,           ///< at the shift of the whole image under which both frames are most alike: long steps
};

/// One corner on two consecutive frames. Pixels as Camera's: whole numbers at the centres of pixels.
struct FeatureTrack {
  std::uint64_t id = 0;                                      ///< never used twice by a tracker
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();           ///< on the frame just given [px]
  Eigen::Vector2d pixel_previous = Eigen::Vector2d::Zero();  ///< on the frame before; of a new corner its `pixel` [px]
  int age = 0;                                               ///< frames it has been followed over; 0: found on this one
  float round_trip_px = 0.0F;  ///< how far from its start it comes back when followed backwards
};

struct FeatureTrackerOptions {
  int tracks = 300;                ///< wanted at a time
  int cell_px = 40;                ///< side of the cells over which corners are spread, quota = tracks / cells
  double quality = 0.02;           ///< least smaller eigenvalue of a corner over the largest on the frame
  double least_eigenvalue = 2e-5;  ///< and over nothing, for images of [0, 1]: below it is noise
  double min_distance_px = 8.0;    ///< between tracks when one is born
  int border_px = 12;              ///< no track is nearer to the edge (nielsen: bnd_limit)
  double redetect_share = 0.8;     ///< below this share of `tracks` new corners are looked for
  int window_px = 21;              ///< side of the patch that is compared; odd
  int levels = 3;                  ///< pyramid levels above the image
  int iterations = 30;             ///< of Lucas-Kanade on each level, at most
  double epsilon_px = 0.003;       ///< step at which they stop
  double round_trip_px = 0.5;      ///< forward-backward gate
  double most_flow_px = 200.0;     ///< longest displacement between frames (nielsen: dist_th)
  int patience = 5;                ///< useless frames in a row over which the last good one is kept
  double smoothing_px = 0.8;       ///< sigma of the Gaussian over each image (nielsen: gaus_sig); 0: none
};

/// What `FeatureTracker::track` reports.
struct TrackedFrame {
  FrameStatus status = FrameStatus::kBadImage;
  FlowStart start = FlowStart::kNone;
  int followed = 0;             ///< tracks that came over from the frame before
  int lost = 0;                 ///< that did not
  int born = 0;                 ///< corners found on this frame
  int skipped = 0;              ///< useless frames between this one and the one it was compared with
  double median_flow_px = 0.0;  ///< of those followed
  double sharpness = 0.0;       ///< mean squared gradient over that of recent frames; a blurred frame is below 0.3
  Eigen::Vector2d shift_px = Eigen::Vector2d::Zero();  ///< of the whole image, where phase correlation was asked
  double shift_response = 0.0;                         ///< and how clear its peak was, 0 to 1
};

/// Follows up to `tracks` corners: smaller eigenvalue of the gradients' matrix (Shi-Tomasi), spread over cells;
/// pyramidal Lucas-Kanade forwards and backwards, from a predicted place or from the shift found by phase correlation
/// at a quarter of the size; where most tracks are lost from one start, the next is tried, last the shift of the best
/// overlap. The flow is the mean of the forward one and the backward one reversed (doc/feature_tracks.md eq. 3), which
/// takes most of the bias of interpolation out.
///
/// The same frames give the same bits, whatever the number of threads: OpenCV's own are not used and its settings are
/// left alone. One object per camera; objects in different threads are independent. No exception of OpenCV leaves it.
/// Cost: about 8 ms for 640 x 480 and 300 tracks; our own lists are allocated once, OpenCV's scratch each time.
class FeatureTracker {
 public:
  /// For images of `width` x `height` pixels. Throws std::invalid_argument for an option out of its range, naming it,
  /// and std::runtime_error without OpenCV.
  FeatureTracker(int width, int height, const FeatureTrackerOptions& options = {});
  FeatureTracker(FeatureTracker&& other) noexcept;
  FeatureTracker& operator=(FeatureTracker&& other) noexcept;
  FeatureTracker(const FeatureTracker&) = delete;
  FeatureTracker& operator=(const FeatureTracker&) = delete;
  ~FeatureTracker();

  /// The next frame. `predicted`: where each of `tracks()` is expected on it (as many, in their order), NaN for a track
  /// without expectation; empty for none at all. A frame that is dark, saturated, flat or blurred is left out: the next
  /// one is compared with the last good frame, until `patience` of them came in a row and everything starts anew.
  TrackedFrame track(const ImageView& image, std::span<const Eigen::Vector2d> predicted = {}) noexcept;

  /// The tracks on the last frame, oldest first. Valid until the next call.
  [[nodiscard]] std::span<const FeatureTrack> tracks() const noexcept;

  /// Gives tracks up, such as those that a motion was fitted without: `keep[i] == 0` drops track i; as many as tracks,
  /// else nothing happens.
  void prune(std::span<const std::uint8_t> keep) noexcept;

  /// Forgets every frame.
  void reset() noexcept;

  [[nodiscard]] const FeatureTrackerOptions& options() const noexcept;

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace soopnav::vision
