#include <pybind11/native_enum.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <cstddef>
#include <cstdio>
#include <limits>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/vision/camera.hpp"
#include "soopnav/vision/feature_tracker.hpp"

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
}

}  // namespace soopnav::python
