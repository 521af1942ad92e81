#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <Eigen/Core>
#include <cstdio>
#include <optional>
#include <stdexcept>
#include <string>
#include <tuple>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/estimation/dop.hpp"
#include "soopnav/estimation/error_ellipse.hpp"

namespace soopnav::python {

namespace {

Eigen::Matrix2d matrix2(const TableBase& table) {
  if (table.rows() != 2 || table.columns() != 2) throw std::invalid_argument("covariance_m2: expected shape (2, 2)");
  Eigen::Matrix2d m;
  m << table.row(0)[0], table.row(0)[1], table.row(1)[0], table.row(1)[1];
  return m;
}

void check_probability(double probability) {
  if (!(probability > 0.0 && probability < 1.0)) {
    throw std::invalid_argument("probability: " + std::to_string(probability) + " is outside 0 ... 1");
  }
}

constexpr const char* kNotCovariance = "covariance_m2: not a covariance (finite, symmetric, no negative eigenvalue)";

}  // namespace

void register_estimation(py::module_& m) {
  py::class_<Dop>(m, "Dop", "Dilution of precision, from geometry alone; NaN where one does not apply. Read-only.")
      .def_readonly("gdop", &Dop::gdop, "Position and clock bias.")
      .def_readonly("pdop", &Dop::pdop, "Position.")
      .def_readonly("hdop", &Dop::hdop, "Horizontal position.")
      .def_readonly("vdop", &Dop::vdop, "Vertical position.")
      .def_readonly("tdop", &Dop::tdop, "Speed of light times clock bias.")
      .def("__repr__", [](const Dop& d) {
        char text[160];
        std::snprintf(text, sizeof text, "Dop(gdop=%.2f, pdop=%.2f, hdop=%.2f, vdop=%.2f, tdop=%.2f)", d.gdop, d.pdop,
                      d.hdop, d.vdop, d.tdop);
        return std::string(text);
      });

  py::class_<ErrorEllipse>(m, "ErrorEllipse", "Curve of constant density of a two-dimensional error. Read-only.")
      .def_readonly("semi_major_m", &ErrorEllipse::semi_major_m, "Half the long axis.")
      .def_readonly("semi_minor_m", &ErrorEllipse::semi_minor_m, "Half the short axis.")
      .def_readonly("angle_rad", &ErrorEllipse::angle_rad, "Of the long axis, from the first axis towards the second.")
      .def(py::pickle([](const ErrorEllipse& e) { return py::make_tuple(e.semi_major_m, e.semi_minor_m, e.angle_rad); },
                      [](const py::tuple& t) {
                        if (t.size() != 3) throw py::value_error("ErrorEllipse: three items expected");
                        return ErrorEllipse{t[0].cast<double>(), t[1].cast<double>(), t[2].cast<double>()};
                      }))
      .def("__repr__", [](const ErrorEllipse& e) {
        char text[128];
        std::snprintf(text, sizeof text, "ErrorEllipse(semi_major_m=%.3f, semi_minor_m=%.3f, angle_rad=%+.3f)",
                      e.semi_major_m, e.semi_minor_m, e.angle_rad);
        return std::string(text);
      });

  m.def(
      "error_ellipse",
      [](const Table<"covariance_m2">& covariance, std::optional<double> probability) {
        if (probability) check_probability(*probability);
        const auto P = matrix2(covariance);
        const auto ellipse = probability ? error_ellipse(P, *probability) : error_ellipse(P);
        if (!ellipse) throw std::invalid_argument(kNotCovariance);
        return *ellipse;
      },
      py::arg("covariance_m2"), py::kw_only(), py::arg("probability") = py::none(),
      "Ellipse that holds the error with a probability; without one the 1-sigma ellipse.");
  m.def(
      "circular_error_m",
      [](const Table<"covariance_m2">& covariance, double probability) {
        check_probability(probability);
        const auto radius = circular_error_m(matrix2(covariance), probability);
        if (!radius) throw std::invalid_argument(kNotCovariance);
        return *radius;
      },
      py::arg("covariance_m2"), py::kw_only(), py::arg("probability") = 0.5,
      "Radius of the circle that holds the error with a probability.");
}

}  // namespace soopnav::python
