#include <pybind11/native_enum.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <memory>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "array.hpp"
#include "ground_arrays.hpp"
#include "register.hpp"
#include "soopnav/simulation/ground_scene.hpp"
#include "soopnav/vision/ground_plane.hpp"
#include "soopnav/vision/ground_projection.hpp"
#include "soopnav/vision/rigid_motion.hpp"

namespace soopnav::python {

namespace {

using simulation::CameraView;
using simulation::GroundObject;
using simulation::GroundScene;
using simulation::GroundWall;
using vision::GroundPlane;
using vision::PlaneFitter;
using vision::RigidMotionEstimator;
using FloatArray = py::array_t<float, py::array::c_style | py::array::forcecast>;

std::span<const float> points_of(const FloatArray& points) {
  if (points.ndim() != 2 || points.shape(1) != 3) {
    throw std::invalid_argument("points: numbers of shape (n, 3) expected, got " + describe(points));
  }
  return {points.data(), static_cast<std::size_t>(points.size())};
}

std::string plane_text(const GroundPlane& plane) {
  char text[200];
  if (plane.ok()) {
    std::snprintf(text, sizeof text, "GroundPlane(normal_c=[%.5f, %.5f, %.5f], distance_m=%.4f, %d of %d points)",
                  plane.normal_c.x(), plane.normal_c.y(), plane.normal_c.z(), plane.distance_m, plane.inliers,
                  plane.points);
  } else {
    std::snprintf(text, sizeof text, "GroundPlane(%s, %d points)", name(plane.status), plane.points);
  }
  return text;
}

void register_plane(py::module_& m) {
  using vision::PlaneStatus;
  py::native_enum<PlaneStatus>(m, "PlaneStatus", "enum.Enum", "What became of a plane fit.")
      .value("NONE", PlaneStatus::kNone, "Nothing was fitted.")
      .value("FITTED", PlaneStatus::kFitted, "The only one whose numbers are the ground's.")
      .value("TOO_FEW", PlaneStatus::kTooFew, "Too few finite points.")
      .value("NO_PLANE", PlaneStatus::kNoPlane, "No plane holds the share of the points that it must.")
      .value("WALL", PlaneStatus::kWall, "The plane found leans too much to be the ground.")
      .value("HEIGHT", PlaneStatus::kHeight, "The plane found is too near or too far.")
      .value("DEGENERATE", PlaneStatus::kDegenerate, "The points lie on a line or in one place.")
      .finalize();

  py::class_<GroundPlane>(m, "GroundPlane",
                          "The ground as a camera sees it, normal . p = distance. Frame: x right, y down the image, z "
                          "along the optical axis; the normal points into the ground. Read-only.")
      .def_static(
          "known",
          [](const RealArray<"normal_c">& normal, double distance_m,
             const std::optional<Numbers<"covariance">>& covariance) {
            return GroundPlane::known(small_matrix<3, 1>(normal.span(), "normal_c"), distance_m,
                                      covariance ? small_matrix<3, 3>(covariance->span(), "covariance")
                                                 : Eigen::Matrix3d(Eigen::Matrix3d::Zero()));
          },
          py::arg("normal_c"), py::arg("distance_m"), py::kw_only(), py::arg("covariance") = py::none(),
          "A plane that is known, without uncertainty unless one is given.")
      .def_static(
          "from_tilt",
          [](double a_x_rad, double a_y_rad, double height_m) {
            return GroundPlane::known(vision::normal_of_tilt({a_x_rad, a_y_rad}), height_m);
          },
          py::arg("a_x_rad"), py::arg("a_y_rad"), py::arg("height_m"),
          "The plane below a camera with nielsen's tilt angles.")
      .def_property_readonly("ok", &GroundPlane::ok, "Whether the numbers are the ground's.")
      .def_property_readonly(
          "status", [](const GroundPlane& p) { return p.status; }, "What became of the fit.")
      .def_property_readonly(
          "normal_c", [](const GroundPlane& p) { return matrix_array(p.normal_c); }, "float64 (3,), unit.")
      .def_readonly("distance_m", &GroundPlane::distance_m, "Height of the camera above the ground [m].")
      .def_property_readonly(
          "covariance", [](const GroundPlane& p) { return matrix_array(p.covariance); },
          "float64 (3, 3) of [eta_1, eta_2, distance], [rad, rad, m]: the normal's turn along the body's two axes.")
      .def_property_readonly(
          "axes_c", [](const GroundPlane& p) { return matrix_array(vision::body_axes(p.normal_c)); },
          "float64 (3, 3): axes of the body on the ground as rows, in camera axes.")
      .def_property_readonly(
          "tilt_rad",
          [](const GroundPlane& p) {
            const auto tilt = vision::tilt_of_normal(p.normal_c);
            return py::make_tuple(tilt.a_x_rad, tilt.a_y_rad);
          },
          "nielsen's (a_x, a_y) [rad].")
      .def_property_readonly(
          "nielsen_abcd", [](const GroundPlane& p) { return matrix_array(vision::nielsen_coefficients(p)); },
          "float64 (4,): [A, B, C, D] in nielsen's frame e, whose y runs up the image; C is positive.")
      .def_readonly("points", &GroundPlane::points, "Finite points offered.")
      .def_readonly("inliers", &GroundPlane::inliers, "Points that the numbers come from.")
      .def_readonly("rms_m", &GroundPlane::rms_m, "Of the inliers' distances [m].")
      .def(
          "seen_from",
          [](const GroundPlane& plane, const RealArray<"camera_p_c">& position,
             const std::optional<Numbers<"turn">>& turn) {
            return plane.seen_from(
                small_matrix<3, 1>(position.span(), "camera_p_c"),
                turn ? small_matrix<3, 3>(turn->span(), "turn") : Eigen::Matrix3d(Eigen::Matrix3d::Identity()));
          },
          py::arg("camera_p_c"), py::kw_only(), py::arg("turn") = py::none(),
          "The same ground from another camera, at camera_p_c of this one [m]; the rows of turn are its axes.")
      .def("__repr__", &plane_text)
      .def(py::pickle(
          [](const GroundPlane& p) {
            return py::make_tuple(static_cast<int>(p.status), matrix_array(p.normal_c), p.distance_m,
                                  matrix_array(p.covariance), p.points, p.inliers, p.rms_m);
          },
          [](const py::tuple& t) {
            GroundPlane p;
            p.status = static_cast<vision::PlaneStatus>(t[0].cast<int>());
            p.normal_c = small_matrix<3, 1>(Numbers<"normal_c">(t[1]).span(), "normal_c");
            p.distance_m = t[2].cast<double>();
            p.covariance = small_matrix<3, 3>(Numbers<"covariance">(t[3]).span(), "covariance");
            p.points = t[4].cast<int>();
            p.inliers = t[5].cast<int>();
            p.rms_m = t[6].cast<double>();
            return p;
          }));

  py::class_<PlaneFitter>(m, "PlaneFitter", "Planes of the ground from depth clouds, one after the other.")
      .def(py::init([](const std::string& method, double sigma_m, double sigma_per_m, double band_sigmas, double band_m,
                       double min_share, int min_points, double max_tilt_rad, double min_height_m, double max_height_m,
                       int max_hypotheses, double confidence, double noise_cluster, std::uint64_t seed) {
             if (method != "ransac" && method != "svd") {
               throw std::invalid_argument("method: '" + method + "'; it must be 'ransac' or 'svd'");
             }
             vision::PlaneOptions o;
             o.method = method == "svd" ? vision::PlaneMethod::kSvd : vision::PlaneMethod::kRansac;
             o.sigma_m = sigma_m;
             o.sigma_per_m = sigma_per_m;
             o.band_sigmas = band_sigmas;
             o.band_m = band_m;
             o.min_share = min_share;
             o.min_points = min_points;
             o.max_tilt_rad = max_tilt_rad;
             o.min_height_m = min_height_m;
             o.max_height_m = max_height_m;
             o.max_hypotheses = max_hypotheses;
             o.confidence = confidence;
             o.noise_cluster = noise_cluster;
             o.seed = seed;
             return std::make_unique<PlaneFitter>(o);
           }),
           py::kw_only(), py::arg("method") = "ransac", py::arg("sigma_m") = 0.0005, py::arg("sigma_per_m") = 0.0014,
           py::arg("band_sigmas") = 3.0, py::arg("band_m") = 0.0, py::arg("min_share") = 0.2,
           py::arg("min_points") = 50, py::arg("max_tilt_rad") = 0.7854, py::arg("min_height_m") = 0.05,
           py::arg("max_height_m") = 10.0, py::arg("max_hypotheses") = 400, py::arg("confidence") = 0.9999,
           py::arg("noise_cluster") = 1.0, py::arg("seed") = 0)
      .def(
          "fit",
          [](PlaneFitter& self, const FloatArray& points) {
            const auto values = points_of(points);
            const py::gil_scoped_release release;
            return self.fit(values);
          },
          py::arg("points"), "The plane of points, float32 (n, 3) in camera axes [m].");
}

void register_projection(py::module_& m) {
  m.def(
      "ground_points",
      [](const GroundPlane& plane, const vision::Camera& camera, const Table<"pixels">& pixels) {
        if (!plane.ok())
          throw std::invalid_argument(std::string("plane: ") + name(plane.status) + "; a fitted one is needed");
        if (pixels.rows() > 0 && pixels.columns() != 2) {
          throw std::invalid_argument("pixels: rows of two numbers expected, got " + std::to_string(pixels.columns()));
        }
        std::vector<double> out(2 * pixels.rows(), std::nan(""));
        const vision::GroundProjection projection(plane);
        for (std::size_t i = 0; i < pixels.rows(); ++i) {
          Eigen::Vector3d ray;
          Eigen::Vector2d point;
          if (camera.unproject({pixels.row(i)[0], pixels.row(i)[1]}, ray) && projection.project(ray, point)) {
            out[2 * i] = point.x();
            out[2 * i + 1] = point.y();
          }
        }
        return to_array(std::move(out), {static_cast<py::ssize_t>(pixels.rows()), 2});
      },
      py::arg("plane"), py::arg("camera"), py::arg("pixels"),
      "Where rays of pixels (n, 2) meet the ground: float64 (n, 2) in axes of the body, from the foot below the "
      "camera; "
      "NaN where they do not.");
  m.def(
      "ground_pixels",
      [](const GroundPlane& plane, const vision::Camera& camera, const Table<"points_b">& points) {
        if (!plane.ok())
          throw std::invalid_argument(std::string("plane: ") + name(plane.status) + "; a fitted one is needed");
        if (points.rows() > 0 && points.columns() != 2) {
          throw std::invalid_argument("points_b: rows of two numbers expected, got " +
                                      std::to_string(points.columns()));
        }
        std::vector<double> out(2 * points.rows(), std::nan(""));
        const vision::GroundProjection projection(plane);
        for (std::size_t i = 0; i < points.rows(); ++i) {
          Eigen::Vector2d pixel;
          if (camera.project(projection.to_camera({points.row(i)[0], points.row(i)[1]}), pixel)) {
            out[2 * i] = pixel.x();
            out[2 * i + 1] = pixel.y();
          }
        }
        return to_array(std::move(out), {static_cast<py::ssize_t>(points.rows()), 2});
      },
      py::arg("plane"), py::arg("camera"), py::arg("points_b"), "Inverse of ground_points.");
  const auto increment = [](const RealArray<"increment">& values, bool present) {
    const Eigen::Vector3d v = small_matrix<3, 1>(values.span(), "increment");
    return matrix_array(present ? vision::to_present_axes(v) : vision::to_previous_axes(v));
  };
  m.def(
      "to_present_axes", [=](const RealArray<"increment">& values) { return increment(values, true); },
      py::arg("increment"), "{dx, dy, da_z} in axes of the previous body -> nielsen's, in axes of the present one.");
  m.def(
      "to_previous_axes", [=](const RealArray<"increment">& values) { return increment(values, false); },
      py::arg("increment"), "Inverse of to_present_axes.");
  m.def(
      "frames_round_trip",
      [](const RealArray<"pose">& pose, const RealArray<"tilt_rad">& tilt, double height_m,
         const Table<"points_a">& points) {
        const Eigen::Vector3d p = small_matrix<3, 1>(pose.span(), "pose");
        const Eigen::Vector2d t = small_matrix<2, 1>(tilt.span(), "tilt_rad");
        const vision::NielsenFrames frames{{p.x(), p.y(), p.z()}, {t.x(), t.y()}, height_m};
        std::vector<double> out;
        for (std::size_t i = 0; i < points.rows(); ++i) {
          const Eigen::Vector3d a = small_matrix<3, 1>(points.row(i), "points_a");
          const Eigen::Vector3d b = frames.b_from_a(a), c = frames.c_from_b(b), d = frames.d_from_c(c);
          const Eigen::Vector3d e = frames.e_from_d(d), camera = vision::NielsenFrames::camera_from_e(e);
          for (const auto& v : {a, b, c, d, e, camera, frames.ground_from_camera(camera)}) {
            out.insert(out.end(), v.data(), v.data() + 3);
          }
        }
        return to_array(std::move(out), {static_cast<py::ssize_t>(points.rows()), 7, 3});
      },
      py::arg("pose"), py::arg("tilt_rad"), py::arg("height_m"), py::arg("points_a"),
      "nielsen's chain: float64 (n, 7, 3), each point in frames a, b, c, d, e, the camera's, and a again.");
}

std::vector<Eigen::Vector2d> pixels_of(const TableBase& table, const char* name) {
  if (table.rows() > 0 && table.columns() != 2) {
    throw std::invalid_argument(std::string(name) + ": rows of two numbers expected, got " +
                                std::to_string(table.columns()));
  }
  std::vector<Eigen::Vector2d> out;
  for (std::size_t i = 0; i < table.rows(); ++i) out.emplace_back(table.row(i)[0], table.row(i)[1]);
  return out;
}

void register_rigid_motion(py::module_& m) {
  py::class_<RigidMotionEstimator>(m, "RigidMotionEstimator", "Increments from feature tracks over the ground.")
      .def(py::init([](double min_sigma_px, double inlier_px, int min_tracks, double min_share, int max_hypotheses,
                       double height_sigmas, double height_tolerance, double track_inflation, std::uint64_t seed) {
             vision::RigidMotionOptions o;
             o.min_sigma_px = min_sigma_px;
             o.inlier_px = inlier_px;
             o.min_tracks = min_tracks;
             o.min_share = min_share;
             o.max_hypotheses = max_hypotheses;
             o.height_sigmas = height_sigmas;
             o.height_tolerance = height_tolerance;
             o.track_inflation = track_inflation;
             o.seed = seed;
             return std::make_unique<RigidMotionEstimator>(o);
           }),
           py::kw_only(), py::arg("min_sigma_px") = 0.01, py::arg("inlier_px") = 1.0, py::arg("min_tracks") = 8,
           py::arg("min_share") = 0.25, py::arg("max_hypotheses") = 200, py::arg("height_sigmas") = 6.0,
           py::arg("height_tolerance") = 0.01, py::arg("track_inflation") = 1.0, py::arg("seed") = 0)
      .def(
          "estimate",
          [](RigidMotionEstimator& self, const vision::Camera& camera, const Table<"previous_px">& previous_px,
             const Table<"present_px">& present_px, const GroundPlane& previous, const GroundPlane& present) {
            const auto from = pixels_of(previous_px, "previous_px"), to = pixels_of(present_px, "present_px");
            if (from.size() != to.size()) {
              throw std::invalid_argument("present_px: " + grouped(to.size()) + " rows; as many as previous_px, " +
                                          grouped(from.size()) + ", expected");
            }
            const py::gil_scoped_release release;
            return self.estimate(camera, from, to, previous, present);
          },
          py::arg("camera"), py::arg("previous_px"), py::arg("present_px"), py::arg("previous"), py::arg("present"),
          "The motion between two frames from pixels (n, 2) of the same features and the ground of both.");
}

CameraView view_of(std::span<const double> row) { return {{row[0], row[1], row[2]}, row[3], {row[4], row[5]}}; }

std::vector<GroundObject> objects_of(const Numbers<"objects">& rows) {
  rows.require_axes({2}, "float64 (n, 8)");
  if (rows.shape()[0] > 0 && rows.shape()[1] != 8) {
    throw std::invalid_argument("objects: rows of 8 numbers expected, got " + std::to_string(rows.shape()[1]));
  }
  std::vector<GroundObject> out;
  for (std::size_t i = 0; 8 * i < rows.span().size(); ++i) {
    const auto row = rows.span().subspan(8 * i, 8);
    if (!std::all_of(row.begin(), row.end(), [](double v) { return std::isfinite(v); })) {
      throw std::invalid_argument("objects: row " + std::to_string(i) + " has a number that is not finite");
    }
    out.push_back({{row[0], row[1], row[2]}, row[3], row[4], row[5], row[6], row[7]});
  }
  return out;
}

std::optional<GroundWall> wall_of(const std::optional<RealArray<"wall">>& wall) {
  if (!wall) return std::nullopt;
  const Eigen::Vector3d w = small_matrix<3, 1>(wall->span(), "wall");
  return GroundWall{w.x(), w.y(), w.z()};
}

}  // namespace

void register_ground_plane(py::module_& m) { register_plane(m); }

void register_ground(py::module_& m) {
  register_projection(m);
  register_rigid_motion(m);
}

void register_ground_scene(py::module_& m) {
  py::class_<GroundScene>(m, "GroundScene", "Textured ground below a camera, rendered with exact truth.")
      .def(py::init(
               [](std::uint64_t seed, int size, double texel_m, int finest_texels, double roughness, double contrast) {
                 const simulation::GroundTextureOptions options{size, texel_m, finest_texels, roughness, contrast};
                 const py::gil_scoped_release release;
                 return std::make_unique<GroundScene>(seed, options);
               }),
           py::arg("seed"), py::kw_only(), py::arg("size") = 2048, py::arg("texel_m") = 0.001,
           py::arg("finest_texels") = 4, py::arg("roughness") = 1.0, py::arg("contrast") = 0.22)
      .def(
          "render",
          [](GroundScene& self, const vision::Camera& camera, const Table<"views">& views,
             const RealArray<"shot">& shot, const Numbers<"objects">& objects,
             const std::optional<RealArray<"wall">>& wall, std::uint64_t frame) {
            if (views.columns() != 6) throw std::invalid_argument("views: rows of six numbers expected");
            std::vector<CameraView> during;
            for (std::size_t i = 0; i < views.rows(); ++i) during.push_back(view_of(views.row(i)));
            const auto s = small_matrix<6, 1>(shot.span(), "shot");
            const simulation::ShotOptions options{s[0], s[1], s[2], s[3], s[4], s[5], frame};
            const auto rows = objects_of(objects);
            const auto barrier = wall_of(wall);
            std::vector<std::uint8_t> image(static_cast<std::size_t>(camera.width()) *
                                            static_cast<std::size_t>(camera.height()));
            {
              const py::gil_scoped_release release;
              self.render(camera, during, options, rows, barrier ? &*barrier : nullptr, image);
            }
            return to_array(std::move(image), {camera.height(), camera.width()});
          },
          py::arg("camera"), py::arg("views"), py::arg("shot"), py::arg("objects"), py::arg("wall"), py::arg("frame"))
      .def(
          "depth_cloud",
          [](GroundScene& self, const vision::Camera& camera, const RealArray<"view">& view, std::size_t points,
             const RealArray<"sensor">& sensor, const RealArray<"sensor_p_c">& position,
             const Numbers<"objects">& objects, const std::optional<RealArray<"wall">>& wall, std::uint64_t frame) {
            if (view.size() != 6) throw std::invalid_argument("view: six numbers expected");
            const auto s = small_matrix<5, 1>(sensor.span(), "sensor");
            const simulation::CloudOptions options{
                points, s[0], s[1], s[2], s[3], s[4], small_matrix<3, 1>(position.span(), "sensor_p_c"), frame};
            const auto rows = objects_of(objects);
            const auto barrier = wall_of(wall);
            std::vector<float> xyz(3 * points);
            {
              const py::gil_scoped_release release;
              self.depth_cloud(camera, view_of(view.span()), options, rows, barrier ? &*barrier : nullptr, xyz);
            }
            return to_array(std::move(xyz), {static_cast<py::ssize_t>(points), 3});
          },
          py::arg("camera"), py::arg("view"), py::arg("points"), py::arg("sensor"), py::arg("sensor_p_c"),
          py::arg("objects"), py::arg("wall"), py::arg("frame"))
      .def("brightness", &GroundScene::brightness, py::arg("x_m"), py::arg("y_m"),
           "Of the ground there, 0 black, 1 white.");
  m.def(
      "increment_between",
      [](const RealArray<"previous">& previous, const RealArray<"present">& present) {
        const Eigen::Vector3d a = small_matrix<3, 1>(previous.span(), "previous");
        const Eigen::Vector3d b = small_matrix<3, 1>(present.span(), "present");
        return matrix_array(vision::increment_between({a.x(), a.y(), a.z()}, {b.x(), b.y(), b.z()}));
      },
      py::arg("previous"), py::arg("present"));
}

}  // namespace soopnav::python
