#include <pybind11/native_enum.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <limits>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/vision/camera.hpp"
#include "soopnav/vision/ego_motion.hpp"
#include "soopnav/vision/feature_tracker.hpp"
#include "soopnav/vision/planar_motion.hpp"

namespace soopnav::python {
namespace {

using vision::Camera;
using vision::Lens;

constexpr double kNoPixel = std::numeric_limits<double>::quiet_NaN();

Lens lens_named(std::string_view name) {
  if (name == "pinhole") return Lens::kPinhole;
  if (name == "radial_tangential") return Lens::kRadialTangential;
  if (name == "fisheye") return Lens::kFisheye;
  throw std::invalid_argument("lens: '" + std::string(name) + "'; pinhole, radial_tangential or fisheye is needed");
}

const char* name_of(Lens lens) {
  return lens == Lens::kPinhole ? "pinhole" : lens == Lens::kRadialTangential ? "radial_tangential" : "fisheye";
}

void need_columns(const TableBase& table, const char* name, std::size_t columns) {
  if (table.columns() == columns) return;
  throw std::invalid_argument(std::string(name) + ": rows of " + (columns == 2 ? "two" : "three") +
                              " numbers expected, got " + std::to_string(table.columns()));
}

py::array_t<double> project(const Camera& camera, const Table<"points_c">& points) {
  need_columns(points, "points_c", 3);
  std::vector<double> pixels(2 * points.rows(), kNoPixel);
  {
    const py::gil_scoped_release release;
    for (std::size_t i = 0; i < points.rows(); ++i) {
      const auto row = points.row(i);
      if (Eigen::Vector2d pixel; camera.project({row[0], row[1], row[2]}, pixel)) {
        pixels[2 * i] = pixel.x();
        pixels[2 * i + 1] = pixel.y();
      }
    }
  }
  return to_array(std::move(pixels), {static_cast<py::ssize_t>(points.rows()), 2});
}

py::array_t<double> unproject(const Camera& camera, const Table<"pixels">& pixels) {
  need_columns(pixels, "pixels", 2);
  std::vector<double> rays(3 * pixels.rows(), kNoPixel);
  {
    const py::gil_scoped_release release;
    for (std::size_t i = 0; i < pixels.rows(); ++i) {
      const auto row = pixels.row(i);
      if (Eigen::Vector3d ray; camera.unproject({row[0], row[1]}, ray)) {
        for (Eigen::Index k = 0; k < 3; ++k) rays[3 * i + static_cast<std::size_t>(k)] = ray[k];
      }
    }
  }
  return to_array(std::move(rays), {static_cast<py::ssize_t>(pixels.rows()), 3});
}

std::string camera_text(const Camera& camera) {
  char text[160];
  std::snprintf(text, sizeof text, "Camera(%d x %d, %s, f=[%.2f, %.2f], c=[%.2f, %.2f] px)", camera.width(),
                camera.height(), name_of(camera.lens()), camera.fx(), camera.fy(), camera.cx(), camera.cy());
  return text;
}

/// Grey pixels of a NumPy array: uint8, (h, w), pixels of a row side by side. Never a copy.
vision::ImageView image_of(const py::object& image) {
  const auto refuse = [&] {
    throw std::invalid_argument("image: grey pixels expected, uint8 (height, width), got " + describe(image));
  };
  if (!py::isinstance<py::array>(image)) refuse();
  const auto array = py::reinterpret_borrow<py::array>(image);
  if (array.ndim() != 2 || !array.dtype().is(py::dtype::of<std::uint8_t>())) refuse();
  if (array.shape(0) > 0 && array.shape(1) > 1 && (array.strides(1) != 1 || array.strides(0) < array.shape(1))) {
    throw std::invalid_argument("image: the pixels of a row must lie side by side; np.ascontiguousarray makes it so");
  }
  return {static_cast<const std::uint8_t*>(array.data()), static_cast<int>(array.shape(1)),
          static_cast<int>(array.shape(0)), array.strides(0)};
}

/// Points of a NumPy array: float32 (n, 3), C-contiguous, without a copy; anything else is converted.
struct Points {
  explicit Points(const py::object& points) {
    array = py::array_t<float, py::array::c_style | py::array::forcecast>::ensure(points);
    if (!array) PyErr_Clear();
    if (!array || array.ndim() != 2 || array.shape(1) != 3) {
      throw std::invalid_argument("points: rows of three numbers expected, got " + describe(points));
    }
  }
  [[nodiscard]] std::span<const float> span() const { return {array.data(), static_cast<std::size_t>(array.size())}; }
  py::array_t<float, py::array::c_style | py::array::forcecast> array;
};

/// n x columns numbers, `get(i, column)`.
template <class Get>
py::array_t<double> table(std::size_t n, std::size_t columns, const Get& get) {
  std::vector<double> values;
  values.reserve(n * columns);
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t k = 0; k < columns; ++k) values.push_back(get(i, k));
  }
  return to_array(std::move(values), {static_cast<py::ssize_t>(n), static_cast<py::ssize_t>(columns)});
}

/// id, age, pixel and previous pixel of tracks.
py::tuple track_arrays(std::span<const vision::FeatureTrack> tracks) {
  std::vector<std::uint64_t> ids;
  std::vector<int> ages;
  for (const auto& track : tracks) {
    ids.push_back(track.id);
    ages.push_back(track.age);
  }
  const auto at = [](const Eigen::Vector2d& p, std::size_t k) { return p[static_cast<Eigen::Index>(k)]; };
  return py::make_tuple(
      to_array(std::move(ids)), to_array(std::move(ages)),
      table(tracks.size(), 2, [&](std::size_t i, std::size_t k) { return at(tracks[i].pixel, k); }),
      table(tracks.size(), 2, [&](std::size_t i, std::size_t k) { return at(tracks[i].pixel_previous, k); }));
}

/// Options by their names; `try_field` says whether it knows one.
template <class Options, class TryField>
Options options_of(const py::dict& given, const char* whose, const TryField& try_field) {
  Options options;
  for (const auto& [key, value] : given) {
    const auto name = key.template cast<std::string>();
    const auto set = [&, held = value](const char* field, auto& where) {
      if (name != field) return false;
      try {
        where = py::cast<std::remove_reference_t<decltype(where)>>(held);
      } catch (const py::cast_error&) {
        using Value = std::remove_reference_t<decltype(where)>;
        const char* wanted = !std::is_integral_v<Value>  ? "a number"
                             : std::is_unsigned_v<Value> ? "a whole number from 0 on"
                                                         : "a whole number";
        const bool number = py::isinstance<py::int_>(held) || py::isinstance<py::float_>(held);
        throw std::invalid_argument(name + ": " + wanted + " expected, got " +
                                    (number ? std::string(py::str(held)) : describe(held)));
      }
      return true;
    };
    if (!try_field(options, set)) throw std::invalid_argument(name + ": no such option of the " + whose);
  }
  return options;
}

vision::FeatureTrackerOptions tracker_options(const py::dict& given) {
  return options_of<vision::FeatureTrackerOptions>(given, "tracker", [](auto& o, const auto& set) {
    return set("tracks", o.tracks) || set("cell_px", o.cell_px) || set("quality", o.quality) ||
           set("least_eigenvalue", o.least_eigenvalue) || set("min_distance_px", o.min_distance_px) ||
           set("border_px", o.border_px) || set("redetect_share", o.redetect_share) || set("window_px", o.window_px) ||
           set("levels", o.levels) || set("iterations", o.iterations) || set("epsilon_px", o.epsilon_px) ||
           set("round_trip_px", o.round_trip_px) || set("most_flow_px", o.most_flow_px) ||
           set("patience", o.patience) || set("smoothing_px", o.smoothing_px);
  });
}

vision::EgoMotionOptions ego_options(const py::dict& given) {
  return options_of<vision::EgoMotionOptions>(given, "camera's motion", [](auto& o, const auto& set) {
    auto& plane = o.plane;
    auto& rigid = o.rigid;
    std::array<double, 3> offset{};
    if (set("depth_offset_m", offset)) {
      o.depth_offset_m = {offset[0], offset[1], offset[2]};
      return true;
    }
    std::uint64_t seed = 0;
    if (set("seed", seed)) {
      plane.seed = rigid.seed = seed;
      return true;
    }
    return set("min_age", o.min_age) || set("outlier_frames", o.outlier_frames) || set("max_gap_s", o.max_gap_s) ||
           set("acceleration_mps2", o.acceleration_mps2) || set("speed_mps", o.speed_mps) ||
           set("turn_rate_radps", o.turn_rate_radps) || set("coast_s", o.coast_s) ||
           set("surprise_mps", o.surprise_mps) || set("rival_share", o.rival_share) ||
           set("plane_sigma_m", plane.sigma_m) || set("plane_sigma_per_m", plane.sigma_per_m) ||
           set("plane_min_share", plane.min_share) || set("plane_band_sigmas", plane.band_sigmas) ||
           set("plane_band_m", plane.band_m) || set("plane_noise_cluster", plane.noise_cluster) ||
           set("plane_min_points", plane.min_points) || set("plane_max_tilt_rad", plane.max_tilt_rad) ||
           set("max_tilt_rad", plane.max_tilt_rad) || set("min_height_m", plane.min_height_m) ||
           set("max_height_m", plane.max_height_m) || set("min_sigma_px", rigid.min_sigma_px) ||
           set("inlier_px", rigid.inlier_px) || set("min_tracks", rigid.min_tracks) ||
           set("min_share", rigid.min_share) || set("height_sigmas", rigid.height_sigmas) ||
           set("height_tolerance", rigid.height_tolerance) || set("track_inflation", rigid.track_inflation);
  });
}

template <int kRows, int kColumns>
py::array_t<double> numbers(const Eigen::Matrix<double, kRows, kColumns>& m) {
  std::vector<double> values;
  for (int i = 0; i < kRows; ++i) {
    for (int k = 0; k < kColumns; ++k) values.push_back(m(i, k));
  }
  if (kColumns == 1) return to_array(std::move(values));
  return to_array(std::move(values), {kRows, kColumns});
}

std::string motion_text(const vision::PlanarMotion& m) {
  char text[240];
  std::snprintf(text, sizeof text,
                "PlanarMotion(%s, [%.2f, %.2f] mm, %.4f deg in %.3f s, height %.4f m, %d of %d tracks agree)",
                vision::name(m.status), 1e3 * m.increment.x(), 1e3 * m.increment.y(),
                m.increment.z() * 180.0 / 3.141592653589793, m.dt_s, m.height_m, m.inliers, m.used);
  return text;
}

void register_frames(py::module_& m) {
  using vision::FlowStart;
  using vision::FrameStatus;
  using vision::TrackedFrame;
  py::native_enum<FrameStatus>(m, "FrameStatus", "enum.Enum", "What became of a frame.")
      .value("FIRST", FrameStatus::kFirst)
      .value("TRACKED", FrameStatus::kTracked)
      .value("REPEATED", FrameStatus::kRepeated)
      .value("DARK", FrameStatus::kDark)
      .value("SATURATED", FrameStatus::kSaturated)
      .value("FLAT", FrameStatus::kFlat)
      .value("BLURRED", FrameStatus::kBlurred)
      .value("LOST", FrameStatus::kLost)
      .value("BAD_IMAGE", FrameStatus::kBadImage)
      .finalize();
  py::native_enum<FlowStart>(m, "FlowStart", "enum.Enum", "Where the search for the tracks started.")
      .value("NONE", FlowStart::kNone)
      .value("PREDICTION", FlowStart::kPrediction)
      .value("PHASE_CORRELATION", FlowStart::kPhaseCorrelation)
      .value("OVERLAP", FlowStart::kOverlap)
      .finalize();
  py::class_<TrackedFrame>(m, "TrackedFrame", "What a tracker says of a frame. Read-only.")
      .def_readonly("status", &TrackedFrame::status, "What became of it.")
      .def_readonly("start", &TrackedFrame::start, "Where the search started.")
      .def_readonly("followed", &TrackedFrame::followed, "Tracks that came over from the frame before.")
      .def_readonly("lost", &TrackedFrame::lost, "Tracks that did not.")
      .def_readonly("born", &TrackedFrame::born, "Corners found on this frame.")
      .def_readonly("skipped", &TrackedFrame::skipped, "Useless frames since the one it was compared with.")
      .def_readonly("median_flow_px", &TrackedFrame::median_flow_px, "Of the tracks followed.")
      .def_readonly("sharpness", &TrackedFrame::sharpness, "Mean squared gradient over that of the frames before.")
      .def_property_readonly(
          "shift_px", [](const TrackedFrame& f) { return numbers<2, 1>(f.shift_px); },
          "Shift of the whole image, where it was asked.")
      .def_readonly("shift_response", &TrackedFrame::shift_response, "How clear the shift was, 0 to 1.")
      .def("__repr__", [](const TrackedFrame& f) {
        return "TrackedFrame(" + std::to_string(f.followed) + " followed, " + std::to_string(f.lost) + " lost, " +
               std::to_string(f.born) + " born)";
      });
  py::class_<vision::FeatureTracker>(m, "FeatureTracker")
      .def(py::init([](int width, int height, const py::dict& options) {
             return vision::FeatureTracker(width, height, tracker_options(options));
           }),
           py::arg("width"), py::arg("height"), py::arg("options"))
      .def(
          "track",
          [](vision::FeatureTracker& self, const py::object& image,
             const std::optional<Table<"predicted">>& predicted) {
            const auto view = image_of(image);
            std::vector<Eigen::Vector2d> places;
            if (predicted) {
              need_columns(*predicted, "predicted", 2);
              if (predicted->rows() != self.tracks().size()) {
                throw std::invalid_argument("predicted: one row per track expected, " +
                                            std::to_string(self.tracks().size()) + ", got " +
                                            std::to_string(predicted->rows()));
              }
              for (std::size_t i = 0; i < predicted->rows(); ++i) {
                places.emplace_back(predicted->row(i)[0], predicted->row(i)[1]);
              }
            }
            const py::gil_scoped_release release;
            return self.track(view, places);
          },
          py::arg("image"), py::arg("predicted") = py::none())
      .def("tracks", [](const vision::FeatureTracker& self) { return track_arrays(self.tracks()); })
      .def(
          "prune",
          [](vision::FeatureTracker& self, const std::vector<bool>& keep) {
            if (keep.size() != self.tracks().size()) {
              throw std::invalid_argument("keep: one value per track expected, " +
                                          std::to_string(self.tracks().size()) + ", got " +
                                          std::to_string(keep.size()));
            }
            std::vector<std::uint8_t> flags;
            for (const bool kept : keep) flags.push_back(kept ? 1 : 0);
            self.prune(flags);
          },
          py::arg("keep"))
      .def("reset", &vision::FeatureTracker::reset);
}

void register_motion(py::module_& m) {
  using vision::EgoMotion;
  using vision::MotionStatus;
  using vision::PlanarMotion;
  py::native_enum<MotionStatus>(m, "MotionStatus", "enum.Enum", "What became of an increment of motion.")
      .value("MEASURED", MotionStatus::kMeasured)
      .value("FIRST", MotionStatus::kFirst)
      .value("BAD_IMAGE", MotionStatus::kBadImage)
      .value("BAD_TIME", MotionStatus::kBadTime)
      .value("NO_PLANE", MotionStatus::kNoPlane)
      .value("TOO_FEW_TRACKS", MotionStatus::kTooFewTracks)
      .value("NO_CONSENSUS", MotionStatus::kNoConsensus)
      .value("DEGENERATE", MotionStatus::kDegenerate)
      .value("HEIGHT_DISAGREEMENT", MotionStatus::kHeightDisagreement)
      .value("REPEATED", MotionStatus::kRepeated)
      .value("COASTED", MotionStatus::kCoasted)
      .finalize();
  py::class_<PlanarMotion>(m, "PlanarMotion",
                           "Motion of a camera over the ground between two frames, as it enters a filter. Read-only.")
      .def_readonly("status", &PlanarMotion::status, "What became of it.")
      .def_property_readonly("ok", &PlanarMotion::ok, "Whether the increment was measured.")
      .def_property_readonly(
          "increment", [](const PlanarMotion& p) { return numbers<3, 1>(p.increment); },
          "{dx, dy, da_z} [m, m, rad]: displacement in axes of the previous body, turn counterclockwise from above.")
      .def_property_readonly(
          "covariance", [](const PlanarMotion& p) { return numbers<3, 3>(p.covariance); },
          "Of this increment alone, everything included.")
      .def_property_readonly(
          "track_covariance", [](const PlanarMotion& p) { return numbers<3, 3>(p.track_covariance); },
          "The part that is independent from increment to increment.")
      .def_property_readonly(
          "foot_covariance_previous", [](const PlanarMotion& p) { return numbers<2, 2>(p.foot_covariance_previous); },
          "Of the point below the camera by the previous frame's plane, in axes of the previous body [m^2].")
      .def_property_readonly(
          "foot_covariance", [](const PlanarMotion& p) { return numbers<2, 2>(p.foot_covariance); },
          "Of the point below the camera by this frame's plane, in axes of this body [m^2].")
      .def_readonly("height_m", &PlanarMotion::height_m, "Of the camera above the ground.")
      .def_readonly("height_ratio", &PlanarMotion::height_ratio, "h_t / h_(t-1) by the tracks alone.")
      .def_readonly("height_ratio_plane", &PlanarMotion::height_ratio_plane, "The same by the planes.")
      .def_readonly("height_ratio_sigma", &PlanarMotion::height_ratio_sigma, "Of the difference of the two.")
      .def_readonly("tracks", &PlanarMotion::tracks, "Pairs of pixels offered.")
      .def_readonly("used", &PlanarMotion::used, "Those whose rays meet the ground.")
      .def_readonly("inliers", &PlanarMotion::inliers, "Those that agree with the motion.")
      .def_readonly("sigma_px", &PlanarMotion::sigma_px, "Noise of a track that the covariance stands for.")
      .def_readonly("rms_px", &PlanarMotion::rms_px, "Of the residuals, per axis.")
      .def_readonly("t_s", &PlanarMotion::t_s, "Time of this frame.")
      .def_readonly("dt_s", &PlanarMotion::dt_s, "Interval that the increment covers; 0 where it covers none.")
      .def_readonly("skipped", &PlanarMotion::skipped, "Frames within it that gave no increment.")
      .def_readonly("rival_share", &PlanarMotion::rival_share, "Of the tracks, those that agree with another motion.")
      .def("__repr__", &motion_text);
  py::class_<EgoMotion>(m, "EgoMotion")
      .def(py::init([](const Camera& camera, const py::dict& tracker, const py::dict& options) {
             vision::EgoMotionOptions all = ego_options(options);
             all.tracker = tracker_options(tracker);
             return EgoMotion(camera, all);
           }),
           py::arg("camera"), py::arg("tracker"), py::arg("options"))
      .def(
          "step_plane",
          [](EgoMotion& self, const py::object& image, double t_s, const vision::GroundPlane& plane) {
            const auto view = image_of(image);
            const py::gil_scoped_release release;
            return self.step(view, t_s, plane);
          },
          py::arg("image"), py::arg("t_s"), py::arg("plane"))
      .def(
          "step_points",
          [](EgoMotion& self, const py::object& image, double t_s, const py::object& points) {
            const auto view = image_of(image);
            const Points cloud(points);
            const auto span = cloud.span();
            const py::gil_scoped_release release;
            return self.step(view, t_s, span);
          },
          py::arg("image"), py::arg("t_s"), py::arg("points"))
      .def("reset", &EgoMotion::reset)
      .def("frame", &EgoMotion::frame)
      .def("plane", &EgoMotion::plane)
      .def("tracks", [](const EgoMotion& self) { return track_arrays(self.tracks()); })
      .def("inliers", [](const EgoMotion& self) {
        std::vector<bool> flags;
        for (const auto flag : self.inliers()) flags.push_back(flag != 0);
        return flags;
      });
}

}  // namespace

void register_vision(py::module_& m) {
  m.def("tracking_available", &vision::tracking_available, "Whether this build can track images.");
  m.def("opencv_version", &vision::opencv_version, "Version of the OpenCV in use; empty without one.");

  py::class_<Camera>(m, "Camera",
                     "A calibrated camera. Frame: x right, y down the image, z along the optical axis; whole pixels at "
                     "their centres. Read-only.")
      .def(py::init([](int width, int height, double fx, double fy, double cx, double cy, std::string_view lens,
                       const RealArray<"distortion">& distortion) {
             return Camera(width, height, fx, fy, cx, cy, lens_named(lens), distortion.span());
           }),
           py::arg("width"), py::arg("height"), py::arg("fx"), py::arg("fy"), py::arg("cx"), py::arg("cy"),
           py::kw_only(), py::arg("lens") = "pinhole", py::arg("distortion") = py::tuple())
      .def_property_readonly("width", &Camera::width, "Pixels.")
      .def_property_readonly("height", &Camera::height, "Pixels.")
      .def_property_readonly("fx", &Camera::fx, "Focal length along u [px].")
      .def_property_readonly("fy", &Camera::fy, "Focal length along v [px].")
      .def_property_readonly("cx", &Camera::cx, "u of the optical axis [px].")
      .def_property_readonly("cy", &Camera::cy, "v of the optical axis [px].")
      .def_property_readonly(
          "lens", [](const Camera& camera) { return name_of(camera.lens()); },
          "'pinhole', 'radial_tangential' or 'fisheye'.")
      .def_property_readonly(
          "distortion",
          [](const Camera& camera) {
            const auto k = camera.distortion();
            return std::vector<double>(k.begin(), k.end());
          },
          "Coefficients of the lens, in OpenCV's order.")
      .def_property_readonly("max_angle_rad", &Camera::max_angle_rad,
                             "Largest angle from the optical axis that is mapped.")
      .def("project", &project, py::arg("points_c"),
           "Pixels (n, 2) of points (n, 3) of the camera frame; NaN where there is none.")
      .def("unproject", &unproject, py::arg("pixels"),
           "Rays (n, 3), their z = 1, of pixels (n, 2); NaN where there is none.")
      .def("resized", &Camera::resized, py::arg("width"), py::arg("height"),
           "The same camera whose images are brought to another size.")
      .def("__repr__", &camera_text)
      .def(py::pickle(
          [](const Camera& c) {
            const auto k = c.distortion();
            return py::make_tuple(c.width(), c.height(), c.fx(), c.fy(), c.cx(), c.cy(), name_of(c.lens()),
                                  std::vector<double>(k.begin(), k.end()));
          },
          [](const py::tuple& t) {
            const auto k = t[7].cast<std::vector<double>>();
            return Camera(t[0].cast<int>(), t[1].cast<int>(), t[2].cast<double>(), t[3].cast<double>(),
                          t[4].cast<double>(), t[5].cast<double>(), lens_named(t[6].cast<std::string>()), k);
          }));
  register_frames(m);
  register_motion(m);
}

}  // namespace soopnav::python
