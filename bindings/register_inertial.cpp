#include <pybind11/native_enum.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <array>
#include <cstdint>
#include <cstdio>
#include <functional>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "array.hpp"
#include "inertial_arrays.hpp"
#include "register.hpp"
#include "soopnav/geometry/gravity.hpp"
#include "soopnav/geometry/wgs84.hpp"
#include "soopnav/inertial/coning_sculling.hpp"
#include "soopnav/inertial/imu_guard.hpp"
#include "soopnav/inertial/static_alignment.hpp"
#include "soopnav/inertial/strapdown_integrator.hpp"
#include "soopnav/inertial/zero_velocity.hpp"

namespace soopnav::python {

namespace {

using inertial::Alignment;
using inertial::AlignmentStatus;
using inertial::ImuStatus;
using inertial::IntegrationStatus;

// Rows of three numbers from rows of a table.
py::array_t<double> three_each(const TableBase& table, std::size_t columns, const char* name,
                               const std::function<Eigen::Vector3d(std::span<const double>)>& make) {
  require_columns(table, columns, name);
  std::vector<double> out;
  out.reserve(3 * table.rows());
  for (std::size_t i = 0; i < table.rows(); ++i) append(out, make(table.row(i)));
  return to_array(std::move(out), {static_cast<py::ssize_t>(table.rows()), 3});
}

py::array_t<double> one_each(const RealArrayBase& values, double (*make)(double)) {
  std::vector<double> out(values.size());
  for (std::size_t i = 0; i < out.size(); ++i) out[i] = make(values[i]);
  return to_array(std::move(out));
}

py::tuple strapdown(const Table<"delta_theta_b">& delta_theta, const Table<"delta_velocity_b">& delta_velocity,
                    double dt_s, const RealArray<"place">& place, const RealArray<"velocity_mps">& velocity,
                    const RealArray<"quaternion">& quaternion, int coning_samples, bool whole_recording,
                    std::size_t record_every) {
  auto increments = increments_of(delta_theta, delta_velocity, dt_s);
  if (record_every < 1) throw py::value_error("record_every: 0; it must be at least 1");
  if (quaternion.size() != 4) throw py::value_error("quaternion: four numbers w, x, y, z expected");
  const Eigen::Vector3d where = vector_of(place, "place");
  inertial::StrapdownIntegrator integrator(
      {{where[0], where[1], where[2]},
       vector_of(velocity, "velocity_mps"),
       Eigen::Quaterniond(quaternion[0], quaternion[1], quaternion[2], quaternion[3])});
  std::vector<double> places, velocities, quaternions;
  std::vector<std::uint8_t> status(increments.size());
  {
    const py::gil_scoped_release release;
    if (whole_recording) {
      inertial::ConingSculling::correct_all(increments, coning_samples);
    } else {
      inertial::ConingSculling corrector(coning_samples);
      for (auto& u : increments) u = corrector.correct(u);
    }
    for (std::size_t k = 0; k < increments.size(); ++k) {
      status[k] = static_cast<std::uint8_t>(integrator.step(increments[k]));
      if ((k + 1) % record_every != 0) continue;
      const auto& x = integrator.state();
      append(places, Eigen::Vector3d(x.place.latitude_rad, x.place.longitude_rad, x.place.height_m));
      append(velocities, x.v_n_mps);
      append(quaternions, Eigen::Vector4d(x.q_n_b.w(), x.q_n_b.x(), x.q_n_b.y(), x.q_n_b.z()));
    }
  }
  const auto n = static_cast<py::ssize_t>(places.size() / 3);
  return py::make_tuple(to_array(std::move(places), {n, 3}), to_array(std::move(velocities), {n, 3}),
                        to_array(std::move(quaternions), {n, 4}), to_array(std::move(status)));
}

py::tuple judge(const RealArray<"t_s">& t_s, const Table<"gyro_radps">& gyro, const Table<"accelerometer_mps2">& force,
                double period_s, double gap_periods, double duplicate_periods, double gyro_range_radps,
                double accelerometer_range_mps2) {
  if (gyro.rows() != t_s.size() || force.rows() != t_s.size()) {
    throw py::value_error("t_s, gyro_radps, accelerometer_mps2: as many rows as times expected, got " +
                          std::to_string(t_s.size()) + ", " + std::to_string(gyro.rows()) + " and " +
                          std::to_string(force.rows()));
  }
  if (gyro.columns() < 1 || force.columns() < 1) throw py::value_error("gyro_radps: at least one column expected");
  inertial::ImuGuard guard({.period_s = period_s,
                            .gap_periods = gap_periods,
                            .duplicate_periods = duplicate_periods,
                            .gyro_range_radps = gyro_range_radps,
                            .accelerometer_range_mps2 = accelerometer_range_mps2});
  const auto vector = [](std::span<const double> row) {
    return Eigen::Map<const Eigen::VectorXd>(row.data(), static_cast<Eigen::Index>(row.size()));
  };
  std::vector<std::uint8_t> status(t_s.size());
  std::vector<double> missing(t_s.size());
  for (std::size_t k = 0; k < t_s.size(); ++k) {
    const auto verdict = guard.judge(t_s[k], vector(gyro.row(k)), vector(force.row(k)));
    status[k] = static_cast<std::uint8_t>(verdict.status);
    missing[k] = verdict.missing_s;
  }
  return py::make_tuple(to_array(std::move(status)), to_array(std::move(missing)));
}

py::tuple zero_velocity(const Table<"delta_theta_b">& delta_theta, const Table<"delta_velocity_b">& delta_velocity,
                        double dt_s, int window, double accelerometer_sigma_mps2, double gyro_sigma_radps,
                        double threshold, double gravity_mps2) {
  const auto increments = increments_of(delta_theta, delta_velocity, dt_s);
  inertial::ZeroVelocityDetector detector(
      {window, accelerometer_sigma_mps2, gyro_sigma_radps, threshold, gravity_mps2});
  py::array_t<bool> rest(static_cast<py::ssize_t>(increments.size()));
  std::vector<double> statistic(increments.size());
  auto at_rest = rest.mutable_unchecked<1>();
  for (std::size_t k = 0; k < increments.size(); ++k) {
    at_rest(static_cast<py::ssize_t>(k)) = detector.push(increments[k]);
    statistic[k] = detector.full() ? detector.statistic() : std::numeric_limits<double>::infinity();
  }
  return py::make_tuple(rest, to_array(std::move(statistic)));
}

// Row by row, whatever Eigen's order.
py::array_t<double> matrix_of(const Eigen::Matrix3d& m) {
  py::array_t<double> out({3, 3});
  for (py::ssize_t i = 0; i < 3; ++i) {
    for (py::ssize_t j = 0; j < 3; ++j) out.mutable_at(i, j) = m(i, j);
  }
  out.attr("setflags")(py::arg("write") = false);
  return out;
}

std::string repr(const Alignment& a) {
  if (a.status != AlignmentStatus::kAligned) return "Alignment(" + std::string(to_string(a.status)) + ")";
  char text[160];
  std::snprintf(text, sizeof text, "Alignment(aligned, heading by %s, sigma %.3g rad)",
                a.gyrocompass ? "the gyros" : "what was given", a.heading_sigma_rad);
  return text;
}

}  // namespace

void register_gravity(py::module_& m) {
  m.def(
      "normal_gravity_ned",
      [](const Table<"places">& places) {
        return three_each(places, 2, "places", [](auto row) { return geometry::normal_gravity_ned(row[0], row[1]); });
      },
      py::arg("places"),
      "Rows of latitude [rad], height [m] to rows of normal gravity along north, east, down [m/s2].");
  m.def(
      "normal_gravity_ecef",
      [](const Table<"p_e">& p_e) {
        return three_each(p_e, 3, "p_e", [](auto row) { return geometry::normal_gravity_ecef(vector_of(row)); });
      },
      py::arg("p_e"), "Rows of ECEF position [m] to rows of normal gravity [m/s2].");
  m.def(
      "j2_gravitation_ecef",
      [](const Table<"p_e">& p_e, double j2) {
        return three_each(p_e, 3, "p_e", [j2](auto row) { return geometry::j2_gravitation_ecef(vector_of(row), j2); });
      },
      py::arg("p_e"), py::arg("j2") = geometry::kEllipsoidJ2,
      "Rows of ECEF position [m] to rows of gravitation by point mass and J2 [m/s2].");
  m.def(
      "normal_gravity_surface",
      [](const RealArray<"latitude_rad">& latitude) {
        return one_each(latitude, [](double l) { return geometry::normal_gravity_surface_mps2(l); });
      },
      py::arg("latitude_rad"), "Somigliana's normal gravity on the ellipsoid [m/s2].");
  m.def(
      "meridian_radius",
      [](const RealArray<"latitude_rad">& latitude) {
        return one_each(latitude, [](double l) { return geometry::meridian_radius_m(l); });
      },
      py::arg("latitude_rad"), "Radius of curvature in the meridian [m].");
  m.def(
      "prime_vertical_radius",
      [](const RealArray<"latitude_rad">& latitude) {
        return one_each(latitude, [](double l) { return geometry::prime_vertical_radius_m(l); });
      },
      py::arg("latitude_rad"), "Radius of curvature in the prime vertical [m].");
  m.def(
      "earth_rate_ned",
      [](const Table<"latitudes">& latitudes) {
        return three_each(latitudes, 1, "latitudes", [](auto row) { return geometry::earth_rate_ned(row[0]); });
      },
      py::arg("latitudes"), "Rows of latitude [rad] to rows of the Earth's rate along north, east, down [rad/s].");
  m.def(
      "transport_rate_ned",
      [](const Table<"motions">& motions) {
        return three_each(motions, 5, "motions", [](auto row) {
          return geometry::transport_rate_ned(row[0], row[1], vector_of(row.subspan(2)));
        });
      },
      py::arg("motions"),
      "Rows of latitude [rad], height [m], velocity north, east, down [m/s] to rows of the frame's rate [rad/s].");
}

void register_inertial(py::module_& m) {
  py::native_enum<ImuStatus>(m, "ImuStatus", "enum.IntEnum", "What a sample of an inertial unit is worth.")
      .value("OK", ImuStatus::kOk)
      .value("FIRST", ImuStatus::kFirst)
      .value("GAP", ImuStatus::kGap)
      .value("DUPLICATE", ImuStatus::kDuplicate)
      .value("REVERSED", ImuStatus::kReversed)
      .value("SATURATED", ImuStatus::kSaturated)
      .value("NOT_FINITE", ImuStatus::kNonFinite)
      .value("FAR_AHEAD", ImuStatus::kFarAhead)
      .finalize();
  py::native_enum<IntegrationStatus>(m, "IntegrationStatus", "enum.IntEnum", "What became of a step.")
      .value("INTEGRATED", IntegrationStatus::kIntegrated)
      .value("NOT_FINITE", IntegrationStatus::kNonFinite)
      .value("TIME_NOT_ADVANCING", IntegrationStatus::kTimeNotAdvancing)
      .value("NEAR_POLE", IntegrationStatus::kNearPole)
      .finalize();
  py::native_enum<AlignmentStatus>(m, "AlignmentStatus", "enum.IntEnum", "How an alignment ended.")
      .value("ALIGNED", AlignmentStatus::kAligned)
      .value("NO_HEADING", AlignmentStatus::kNoHeading)
      .value("NOT_AT_REST", AlignmentStatus::kNotAtRest)
      .value("NEAR_POLE", AlignmentStatus::kNearPole)
      .value("NOT_FINITE", AlignmentStatus::kNonFinite)
      .finalize();

  m.def(
      "correct_increments",
      [](const Table<"delta_theta_b">& delta_theta, const Table<"delta_velocity_b">& delta_velocity, int previous) {
        auto increments = increments_of(delta_theta, delta_velocity, 1.0);
        inertial::ConingSculling::correct_all(increments, previous);
        return arrays_of(increments);
      },
      py::arg("delta_theta_b"), py::arg("delta_velocity_b"), py::kw_only(), py::arg("previous") = 4,
      "Coning and sculling of a whole recording: corrected (delta_theta_b, delta_velocity_b).");
  m.def("integrate", &strapdown, py::arg("delta_theta_b"), py::arg("delta_velocity_b"), py::arg("dt_s"), py::kw_only(),
        py::arg("place"), py::arg("velocity_mps"), py::arg("quaternion"), py::arg("coning_samples") = 4,
        py::arg("whole_recording") = true, py::arg("record_every") = 1,
        "Strapdown in the moving local level frame: (places, velocities, quaternions, status).");
  m.def("judge_samples", &judge, py::arg("t_s"), py::arg("gyro_radps"), py::arg("accelerometer_mps2"), py::kw_only(),
        py::arg("period_s"), py::arg("gap_periods") = 1.5, py::arg("duplicate_periods") = 0.01,
        py::arg("gyro_range_radps") = std::numeric_limits<double>::infinity(),
        py::arg("accelerometer_range_mps2") = std::numeric_limits<double>::infinity(),
        "What samples are worth: (status, missing_s).");
  m.def("zero_velocity", &zero_velocity, py::arg("delta_theta_b"), py::arg("delta_velocity_b"), py::arg("dt_s"),
        py::kw_only(), py::arg("window"), py::arg("accelerometer_sigma_mps2"), py::arg("gyro_sigma_radps"),
        py::arg("threshold"), py::arg("gravity_mps2"), "Where a body is at rest: (at_rest, statistic).");

  py::class_<Alignment>(m, "Alignment", "Attitude of a body at rest, with what it is worth. Read-only.")
      .def_readonly("status", &Alignment::status, "How it ended; the rest counts when it is ALIGNED.")
      .def_property_readonly(
          "quaternion",
          [](const Alignment& a) {
            return to_array(std::vector<double>{a.q_n_b.w(), a.q_n_b.x(), a.q_n_b.y(), a.q_n_b.z()});
          },
          "w, x, y, z, body to north-east-down; shape (4,).")
      .def_property_readonly(
          "covariance", [](const Alignment& a) { return matrix_of(a.covariance); },
          "Of the rotation vector d about the body's axes with truth = q exp(d) [rad2]; shape (3, 3).")
      .def_property_readonly(
          "cross_gyro_bias", [](const Alignment& a) { return matrix_of(a.cross_gyro_bias); },
          "Covariance of d and the gyro biases; shape (3, 3).")
      .def_property_readonly(
          "cross_accelerometer_bias", [](const Alignment& a) { return matrix_of(a.cross_accelerometer_bias); },
          "Covariance of d and the accelerometer biases; shape (3, 3).")
      .def_readonly("gyrocompass", &Alignment::gyrocompass, "Whether the heading is the gyros' own.")
      .def_readonly("heading_sigma_rad", &Alignment::heading_sigma_rad, "Standard deviation of the heading.")
      .def("__repr__", &repr);
  m.def(
      "static_alignment",
      [](const RealArray<"mean_force_b_mps2">& force, const RealArray<"mean_rate_b_radps">& rate, double duration_s,
         double latitude_rad, double height_m, double gyro_bias_sigma_radps, double accelerometer_bias_sigma_mps2,
         double gyro_density, double accelerometer_density, double max_heading_sigma_rad,
         std::optional<double> heading_rad, double heading_sigma_rad) {
        std::optional<inertial::GivenHeading> heading;
        if (heading_rad) heading = inertial::GivenHeading{*heading_rad, heading_sigma_rad};
        return inertial::static_alignment(vector_of(force, "mean_force_b_mps2"), vector_of(rate, "mean_rate_b_radps"),
                                          duration_s, {latitude_rad, 0.0, height_m},
                                          {gyro_bias_sigma_radps, accelerometer_bias_sigma_mps2, gyro_density,
                                           accelerometer_density, max_heading_sigma_rad},
                                          heading);
      },
      py::arg("mean_force_b_mps2"), py::arg("mean_rate_b_radps"), py::kw_only(), py::arg("duration_s"),
      py::arg("latitude_rad"), py::arg("height_m"), py::arg("gyro_bias_sigma_radps"),
      py::arg("accelerometer_bias_sigma_mps2"), py::arg("gyro_density"), py::arg("accelerometer_density"),
      py::arg("max_heading_sigma_rad"), py::arg("heading_rad") = py::none(), py::arg("heading_sigma_rad") = 0.0,
      "Attitude of a body at rest.");
}

}  // namespace soopnav::python
