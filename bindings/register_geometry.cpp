#include <pybind11/native_enum.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <array>
#include <cstddef>
#include <cstdio>
#include <limits>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/geometry/local_frame.hpp"
#include "soopnav/geometry/wgs84.hpp"

namespace soopnav::python {

namespace {

using geometry::Geodetic;
using geometry::LocalAxes;
using geometry::LocalFrame;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

Eigen::Vector3d vector3(std::span<const double> row) { return {row[0], row[1], row[2]}; }

std::array<double, 3> row_of(const Eigen::Vector3d& v) { return {v.x(), v.y(), v.z()}; }

std::array<double, 3> row_of(const std::optional<Geodetic>& place) {
  if (!place) return {kNan, kNan, kNan};
  return {place->latitude_rad, place->longitude_rad, place->height_m};
}

std::array<double, 3> row_of(const std::optional<geometry::Direction>& seen) {
  if (!seen) return {kNan, kNan, kNan};
  return {seen->azimuth_rad, seen->elevation_rad, seen->range_m};
}

/// A table of n rows of three, `make(i)` giving row i.
template <class Make>
py::array_t<double> rows(std::size_t n, const Make& make) {
  std::vector<double> values;
  {
    const py::gil_scoped_release release;
    values.reserve(3 * n);
    for (std::size_t i = 0; i < n; ++i) {
      const std::array<double, 3> row = make(i);
      values.insert(values.end(), row.begin(), row.end());
    }
  }
  return to_array(std::move(values), {static_cast<py::ssize_t>(n), 3});
}

void need_three_columns(const TableBase& table, const char* name) {
  if (table.columns() == 3) return;
  throw std::invalid_argument(std::string(name) + ": rows of three numbers expected, got " +
                              std::to_string(table.columns()));
}

Geodetic place(std::span<const double> row) { return {row[0], row[1], row[2]}; }

}  // namespace

void register_geometry(py::module_& m) {
  m.def(
      "geodetic_to_ecef",
      [](const Table<"places">& places) {
        need_three_columns(places, "places");
        return rows(places.rows(), [&](std::size_t i) { return row_of(geodetic_to_ecef(place(places.row(i)))); });
      },
      py::arg("places"), "Rows of latitude, longitude [rad], height [m] to rows of ECEF position [m].");
  m.def(
      "ecef_to_geodetic",
      [](const Table<"p_e">& p_e) {
        need_three_columns(p_e, "p_e");
        return rows(p_e.rows(), [&](std::size_t i) { return row_of(geometry::ecef_to_geodetic(vector3(p_e.row(i)))); });
      },
      py::arg("p_e"), "Rows of ECEF position [m] to rows of latitude, longitude [rad], height [m]; NaN where none is.");
  m.def(
      "direction_enu",
      [](const Table<"from_enu_m">& from, const Table<"to_enu_m">& to) {
        need_three_columns(from, "from_enu_m");
        need_three_columns(to, "to_enu_m");
        if (from.rows() != to.rows()) throw std::invalid_argument("to_enu_m: as many rows as from_enu_m expected");
        return rows(from.rows(), [&](std::size_t i) {
          return row_of(geometry::direction_enu(vector3(from.row(i)), vector3(to.row(i))));
        });
      },
      py::arg("from_enu_m"), py::arg("to_enu_m"),
      "Rows of azimuth, elevation [rad], range [m]; NaN where they coincide.");

  py::native_enum<LocalAxes>(m, "LocalAxes", "enum.Enum", "Axes of a local frame.")
      .value("ENU", LocalAxes::kEnu)
      .value("NED", LocalAxes::kNed)
      .finalize();

  py::class_<LocalFrame>(m, "LocalFrame", "A Cartesian frame fixed to the Earth in one place. Immutable.")
      .def(py::init([](double latitude_rad, double longitude_rad, double height_m, LocalAxes axes) {
             return LocalFrame({latitude_rad, longitude_rad, height_m}, axes);
           }),
           py::arg("latitude_rad"), py::arg("longitude_rad"), py::arg("height_m"), py::kw_only(),
           py::arg_v("axes", LocalAxes::kEnu, "LocalAxes.ENU"))
      .def_property_readonly("latitude_rad", [](const LocalFrame& f) { return f.origin().latitude_rad; })
      .def_property_readonly("longitude_rad", [](const LocalFrame& f) { return f.origin().longitude_rad; })
      .def_property_readonly("height_m", [](const LocalFrame& f) { return f.origin().height_m; })
      .def_property_readonly("axes", &LocalFrame::axes)
      .def(
          "position_from_ecef",
          [](const LocalFrame& f, const Table<"p_e">& p_e) {
            need_three_columns(p_e, "p_e");
            return rows(p_e.rows(), [&](std::size_t i) { return row_of(f.position_from_ecef(vector3(p_e.row(i)))); });
          },
          py::arg("p_e"))
      .def(
          "position_to_ecef",
          [](const LocalFrame& f, const Table<"p_l">& p_l) {
            need_three_columns(p_l, "p_l");
            return rows(p_l.rows(), [&](std::size_t i) { return row_of(f.position_to_ecef(vector3(p_l.row(i)))); });
          },
          py::arg("p_l"))
      .def(
          "position_from_geodetic",
          [](const LocalFrame& f, const Table<"places">& places) {
            need_three_columns(places, "places");
            return rows(places.rows(),
                        [&](std::size_t i) { return row_of(f.position_from_geodetic(place(places.row(i)))); });
          },
          py::arg("places"))
      .def(
          "position_to_geodetic",
          [](const LocalFrame& f, const Table<"p_l">& p_l) {
            need_three_columns(p_l, "p_l");
            return rows(p_l.rows(), [&](std::size_t i) { return row_of(f.position_to_geodetic(vector3(p_l.row(i)))); });
          },
          py::arg("p_l"))
      .def(
          "direction_to",
          [](const LocalFrame& f, const Table<"p_e">& p_e) {
            need_three_columns(p_e, "p_e");
            return rows(p_e.rows(), [&](std::size_t i) { return row_of(f.direction_to(vector3(p_e.row(i)))); });
          },
          py::arg("p_e"))
      .def("__repr__", [](const LocalFrame& f) {
        constexpr double kDegrees = 57.29577951308232;
        std::array<char, 160> text{};
        std::snprintf(text.data(), text.size(), "LocalFrame(%s at %.7f deg, %.7f deg, %.2f m)",
                      f.axes() == LocalAxes::kEnu ? "ENU" : "NED", f.origin().latitude_rad * kDegrees,
                      f.origin().longitude_rad * kDegrees, f.origin().height_m);
        return std::string(text.data());
      });
}

}  // namespace soopnav::python
