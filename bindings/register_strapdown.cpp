#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <cstdint>
#include <cstdio>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "array.hpp"
#include "inertial_arrays.hpp"
#include "register.hpp"
#include "soopnav/navigation/strapdown_navigator.hpp"
#include "soopnav/simulation/spatial_trajectory.hpp"

namespace soopnav::python {

namespace {

using navigation::StrapdownNavigator;
using navigation::StrapdownOptions;
using navigation::StrapdownRun;
using simulation::Oscillation;
using simulation::SpatialTrajectory;

Oscillation oscillation_of(const RealArrayBase& values, const char* name) {
  const Eigen::Vector3d v = vector_of(values, name);
  return {v[0], v[1], v[2]};
}

std::vector<Eigen::Vector3d> points_of(const TableBase& table, const char* name) {
  require_columns(table, 3, name);
  std::vector<Eigen::Vector3d> out(table.rows());
  for (std::size_t i = 0; i < out.size(); ++i) out[i] = vector_of(table.row(i));
  return out;
}

Eigen::Vector4d numbers_of(const Eigen::Quaterniond& q) { return {q.w(), q.x(), q.y(), q.z()}; }

py::tuple motion(const SpatialTrajectory& self, const RealArray<"t_s">& t_s) {
  std::vector<double> p, v, a, q, w;
  {
    const py::gil_scoped_release release;
    for (const double t : t_s.span()) {
      const auto m = self.at(t);
      append(p, m.p_n_m);
      append(v, m.v_n_mps);
      append(a, m.a_n_mps2);
      append(q, numbers_of(m.q_n_b));
      append(w, m.w_nb_b_radps);
    }
  }
  const auto n = static_cast<py::ssize_t>(t_s.size());
  return py::make_tuple(to_array(std::move(p), {n, 3}), to_array(std::move(v), {n, 3}), to_array(std::move(a), {n, 3}),
                        to_array(std::move(q), {n, 4}), to_array(std::move(w), {n, 3}));
}

py::tuple navigation_states(const SpatialTrajectory& self, const RealArray<"t_s">& t_s) {
  std::vector<double> place, v, q;
  for (const double t : t_s.span()) {
    const auto x = self.navigation_state(t);
    append(place, Eigen::Vector3d(x.place.latitude_rad, x.place.longitude_rad, x.place.height_m));
    append(v, x.v_n_mps);
    append(q, numbers_of(x.q_n_b));
  }
  const auto n = static_cast<py::ssize_t>(t_s.size());
  return py::make_tuple(to_array(std::move(place), {n, 3}), to_array(std::move(v), {n, 3}),
                        to_array(std::move(q), {n, 4}));
}

// The run as it is kept for Python: its numbers of rows beside its arrays.
struct PyRun {
  StrapdownRun run;
  py::ssize_t records = 0, epochs = 0, transmitters = 0;
};

// Which rows a field has.
enum class Rows : std::uint8_t { kRecords, kEpochs, kSamples };

// A field as a read-only array. One type for all of them: each costs a wrapper of its own otherwise.
template <class T>
py::cpp_function field(std::vector<T> StrapdownRun::*member, Rows rows, std::vector<py::ssize_t> columns = {}) {
  return [member, rows, columns = std::move(columns)](const py::object& self) -> py::array_t<T> {
    const auto& me = self.cast<const PyRun&>();
    const auto& values = me.run.*member;
    std::vector<py::ssize_t> shape;
    if (rows == Rows::kRecords) {
      shape.push_back(me.records);
    } else if (rows == Rows::kEpochs) {
      shape = {me.epochs, me.transmitters};
    } else {
      shape.push_back(static_cast<py::ssize_t>(values.size()));
    }
    shape.insert(shape.end(), columns.begin(), columns.end());
    return view_array<T>({values.data(), values.size()}, self, std::move(shape));
  };
}

StrapdownNavigator::State state_of(const RealArrayBase& quaternion, const RealArrayBase& velocity,
                                   const RealArrayBase& position, const RealArrayBase& gyro_bias,
                                   const RealArrayBase& accelerometer_bias) {
  if (quaternion.size() != 4) throw py::value_error("quaternion: four numbers w, x, y, z expected");
  StrapdownNavigator::State x;
  x(kAttitude) << quaternion[0], quaternion[1], quaternion[2], quaternion[3];
  x(kVelocity) = vector_of(velocity, "velocity_mps");
  x(kPosition) = vector_of(position, "position_m");
  x(inertial::kGyroBias) = vector_of(gyro_bias, "gyro_bias_radps");
  x(inertial::kAccelerometerBias) = vector_of(accelerometer_bias, "accelerometer_bias_mps2");
  return x;
}

StrapdownNavigator make_navigator(const Table<"transmitters_m">& transmitters, const RealArray<"origin">& origin,
                                  const RealArray<"reference_m">& reference, double start_s,
                                  const RealArray<"quaternion">& quaternion, const RealArray<"velocity_mps">& velocity,
                                  const RealArray<"position_m">& position,
                                  const RealArray<"gyro_bias_radps">& gyro_bias,
                                  const RealArray<"accelerometer_bias_mps2">& accelerometer_bias,
                                  const Table<"covariance">& covariance, const StrapdownOptions& options) {
  if (covariance.rows() != 15 || covariance.columns() != 15) {
    throw py::value_error("covariance: expected shape (15, 15), got (" + std::to_string(covariance.rows()) + ", " +
                          std::to_string(covariance.columns()) + ")");
  }
  StrapdownNavigator::Filter::Square P0;
  for (std::size_t i = 0; i < 15; ++i) {
    for (std::size_t j = 0; j < 15; ++j) {
      P0(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j)) = covariance.row(i)[j];
    }
  }
  const Eigen::Vector3d place = vector_of(origin, "origin");
  return {{place[0], place[1], place[2]},
          points_of(transmitters, "transmitters_m"),
          vector_of(reference, "reference_m"),
          start_s,
          state_of(quaternion, velocity, position, gyro_bias, accelerometer_bias),
          P0,
          options};
}

StrapdownNavigator::State state_of(std::span<const double> row) {
  StrapdownNavigator::State x;
  x.x = Eigen::Map<const Eigen::Matrix<double, 16, 1>>(row.data());
  x.normalize();
  return x;
}

py::array_t<double> local(const Table<"estimates">& estimates, const Table<"truths">& truths) {
  require_columns(estimates, 16, "estimates");
  require_columns(truths, 16, "truths");
  if (estimates.rows() != truths.rows()) throw py::value_error("truths: as many rows as estimates expected");
  std::vector<double> out;
  out.reserve(15 * estimates.rows());
  for (std::size_t i = 0; i < estimates.rows(); ++i) {
    append(out, state_of(estimates.row(i)).local(state_of(truths.row(i))));
  }
  return to_array(std::move(out), {static_cast<py::ssize_t>(estimates.rows()), 15});
}

py::array_t<double> retract(const Table<"states">& states, const Table<"errors">& errors) {
  require_columns(states, 16, "states");
  require_columns(errors, 15, "errors");
  if (states.rows() != errors.rows()) throw py::value_error("errors: as many rows as states expected");
  std::vector<double> out;
  out.reserve(16 * states.rows());
  for (std::size_t i = 0; i < states.rows(); ++i) {
    const StrapdownNavigator::State::Tangent d = Eigen::Map<const Eigen::Matrix<double, 15, 1>>(errors.row(i).data());
    append(out, state_of(states.row(i)).retract(d).x);
  }
  return to_array(std::move(out), {static_cast<py::ssize_t>(states.rows()), 16});
}

PyRun run(const StrapdownNavigator& self, const RealArray<"t_s">& t_s, const Numbers<"delta_theta_b">& delta_theta,
          const Numbers<"delta_velocity_b">& delta_velocity, const RealArray<"epochs_s">& epochs_s,
          const Numbers<"range_changes_m">& range_changes, std::size_t record_every, bool covariance) {
  delta_theta.require_axes({2}, "shape (n, 3)");
  delta_velocity.require_axes({2}, "shape (n, 3)");
  range_changes.require_axes({2}, "shape (epochs, transmitters)");
  PyRun out;
  out.epochs = static_cast<py::ssize_t>(epochs_s.size());
  out.transmitters = static_cast<py::ssize_t>(self.transmitters());
  const py::gil_scoped_release release;
  out.run = self.run({t_s.span(), delta_theta.span(), delta_velocity.span(), epochs_s.span(), range_changes.span(),
                      record_every, covariance});
  out.records = static_cast<py::ssize_t>(out.run.t_s.size());
  return out;
}

}  // namespace

void register_spatial_trajectory(py::module_& m) {
  const auto attitude = [](const RealArrayBase& roll, const RealArrayBase& pitch) {
    return SpatialTrajectory::Attitude{oscillation_of(roll, "roll"), oscillation_of(pitch, "pitch")};
  };
  py::class_<SpatialTrajectory>(m, "SpatialTrajectory", "A smooth path in three dimensions. Immutable.")
      .def(py::init([attitude](const geometry::LocalFrame& frame, const Table<"control_points_m">& points,
                               double knot_s, const RealArray<"roll">& roll, const RealArray<"pitch">& pitch) {
             return SpatialTrajectory(frame, points_of(points, "control_points_m"), knot_s, attitude(roll, pitch));
           }),
           py::arg("frame"), py::arg("control_points_m"), py::arg("knot_s"), py::kw_only(), py::arg("roll"),
           py::arg("pitch"))
      .def_static(
          "through",
          [attitude](const geometry::LocalFrame& frame, const Table<"waypoints_m">& waypoints, double speed_mps,
                     double max_acceleration_mps2, std::optional<double> rest_s, const RealArray<"roll">& roll,
                     const RealArray<"pitch">& pitch) {
            return SpatialTrajectory::through(frame, points_of(waypoints, "waypoints_m"),
                                              {speed_mps, max_acceleration_mps2, rest_s}, attitude(roll, pitch));
          },
          py::arg("frame"), py::arg("waypoints_m"), py::kw_only(), py::arg("speed_mps"),
          py::arg("max_acceleration_mps2"), py::arg("rest_s"), py::arg("roll"), py::arg("pitch"))
      .def_property_readonly("duration_s", &SpatialTrajectory::duration_s)
      .def_property_readonly("knot_s", &SpatialTrajectory::knot_s)
      .def_property_readonly("greatest_acceleration_mps2", &SpatialTrajectory::greatest_acceleration_mps2)
      .def("at", &motion, py::arg("t_s"), "Position, velocity, acceleration, quaternion, rate at times.")
      .def("navigation_states", &navigation_states, py::arg("t_s"),
           "Latitude, longitude, height; velocity and quaternion in the moving north-east-down frame.")
      .def(
          "imu_increments",
          [](const SpatialTrajectory& self, double rate_hz, double start_s, double end_s) {
            std::vector<inertial::ImuIncrement> increments;
            {
              const py::gil_scoped_release release;
              increments = self.imu_increments(rate_hz, start_s, end_s);
            }
            return arrays_of(increments);
          },
          py::arg("rate_hz"), py::arg("start_s"), py::arg("end_s"), "Exact increments of rate and specific force.");
}

void register_strapdown(py::module_& m) {
  m.def("strapdown_local", &local, py::arg("estimates"), py::arg("truths"),
        "Errors of 15 states, truth = estimate moved by the error; rows of 16 numbers each.");
  m.def("strapdown_retract", &retract, py::arg("states"), py::arg("errors"), "States moved by errors of 15 states.");
  py::class_<PyRun>(m, "StrapdownRun", "What came of a run of a StrapdownNavigator. Read-only.")
      .def_property_readonly("t_s", field(&StrapdownRun::t_s, Rows::kRecords), "Times of the records; shape (r,).")
      .def_property_readonly("position_m", field(&StrapdownRun::position_m, Rows::kRecords, {3}),
                             "North, east, down of the origin; shape (r, 3).")
      .def_property_readonly("velocity_mps", field(&StrapdownRun::velocity_mps, Rows::kRecords, {3}), "Shape (r, 3).")
      .def_property_readonly("quaternion", field(&StrapdownRun::quaternion, Rows::kRecords, {4}),
                             "w, x, y, z, body to north-east-down; shape (r, 4).")
      .def_property_readonly("gyro_bias_radps", field(&StrapdownRun::gyro_bias_radps, Rows::kRecords, {3}),
                             "Shape (r, 3).")
      .def_property_readonly("accelerometer_bias_mps2",
                             field(&StrapdownRun::accelerometer_bias_mps2, Rows::kRecords, {3}), "Shape (r, 3).")
      .def_property_readonly("sigma", field(&StrapdownRun::sigma, Rows::kRecords, {15}),
                             "Standard deviations of the 15 error states; shape (r, 15).")
      .def_property_readonly(
          "covariance",
          [](const py::object& self) -> std::optional<py::array_t<double>> {
            const auto& me = self.cast<const PyRun&>();
            if (me.run.covariance.empty()) return std::nullopt;
            return view_array<double>({me.run.covariance.data(), me.run.covariance.size()}, self, {me.records, 15, 15});
          },
          "Shape (r, 15, 15), or None where it was not asked for.")
      .def_property_readonly("innovation_m", field(&StrapdownRun::innovation_m, Rows::kEpochs),
                             "Measured minus predicted; NaN where there was none; shape (e, transmitters).")
      .def_property_readonly("innovation_sigma_m", field(&StrapdownRun::innovation_sigma_m, Rows::kEpochs),
                             "Its standard deviation; shape (e, transmitters).")
      .def_property_readonly("nis", field(&StrapdownRun::nis, Rows::kEpochs), "Shape (e, transmitters).")
      .def_property_readonly("update_status", field(&StrapdownRun::update_status, Rows::kEpochs),
                             "UpdateStatus as numbers; shape (e, transmitters).")
      .def_property_readonly("imu_status", field(&StrapdownRun::imu_status, Rows::kSamples),
                             "ImuStatus of each sample, as numbers; shape (n,).")
      .def_property_readonly(
          "zero_velocity_updates", [](const PyRun& self) { return self.run.zero_velocity_updates; },
          "Zero-velocity updates taken in.")
      .def("__repr__", [](const PyRun& self) {
        char text[160];
        std::snprintf(text, sizeof text, "StrapdownRun(%zd records, %zd epochs of %zd transmitters, %zu samples)",
                      self.records, self.epochs, self.transmitters, self.run.imu_status.size());
        return std::string(text);
      });

  py::class_<StrapdownNavigator>(m, "StrapdownNavigator", "Inertial navigation aided by range changes.")
      .def(py::init([](const Table<"transmitters_m">& transmitters, const RealArray<"origin">& origin,
                       const RealArray<"reference_m">& reference, double start_s,
                       const RealArray<"quaternion">& quaternion, const RealArray<"velocity_mps">& velocity,
                       const RealArray<"position_m">& position, const RealArray<"gyro_bias_radps">& gyro_bias,
                       const RealArray<"accelerometer_bias_mps2">& accelerometer_bias,
                       const Table<"covariance">& covariance, const RealArray<"noise">& noise, double period_s,
                       double gap_periods, double gyro_range_radps, double accelerometer_range_mps2,
                       double gap_rate_sigma_radps, double gap_acceleration_sigma_mps2, int coning_samples,
                       double range_sigma_m, double ambiguity_m, double gate_sigmas, double gate_floor_m,
                       const std::optional<RealArray<"zero_velocity">>& zero_velocity, double zero_velocity_sigma_mps,
                       bool hold_heading, double zero_rate_sigma_radps) {
             if (noise.size() != 6) throw py::value_error("noise: six numbers expected");
             StrapdownOptions options;
             options.noise = {noise[0], noise[1], noise[2], noise[3], noise[4], noise[5]};
             options.limits.period_s = period_s;
             options.limits.gap_periods = gap_periods;
             options.limits.gyro_range_radps = gyro_range_radps;
             options.limits.accelerometer_range_mps2 = accelerometer_range_mps2;
             options.gap = {gap_rate_sigma_radps, gap_acceleration_sigma_mps2};
             options.coning_samples = coning_samples;
             options.range_sigma_m = range_sigma_m;
             options.ambiguity_m = ambiguity_m;
             options.gate_sigmas = gate_sigmas;
             options.gate_floor_m = gate_floor_m;
             options.zero_velocity_sigma_mps = zero_velocity_sigma_mps;
             options.hold_heading = hold_heading;
             options.zero_rate_sigma_radps = zero_rate_sigma_radps;
             if (zero_velocity) {
               const auto& z = *zero_velocity;
               if (z.size() != 5) throw py::value_error("zero_velocity: five numbers expected");
               options.zero_velocity = inertial::ZeroVelocityOptions{static_cast<int>(z[0]), z[1], z[2], z[3], z[4]};
             }
             return make_navigator(transmitters, origin, reference, start_s, quaternion, velocity, position, gyro_bias,
                                   accelerometer_bias, covariance, options);
           }),
           py::arg("transmitters_m"), py::kw_only(), py::arg("origin"), py::arg("reference_m"), py::arg("start_s"),
           py::arg("quaternion"), py::arg("velocity_mps"), py::arg("position_m"), py::arg("gyro_bias_radps"),
           py::arg("accelerometer_bias_mps2"), py::arg("covariance"), py::arg("noise"), py::arg("period_s"),
           py::arg("gap_periods"), py::arg("gyro_range_radps"), py::arg("accelerometer_range_mps2"),
           py::arg("gap_rate_sigma_radps"), py::arg("gap_acceleration_sigma_mps2"), py::arg("coning_samples"),
           py::arg("range_sigma_m"), py::arg("ambiguity_m"), py::arg("gate_sigmas"), py::arg("gate_floor_m"),
           py::arg("zero_velocity"), py::arg("zero_velocity_sigma_mps"), py::arg("hold_heading"),
           py::arg("zero_rate_sigma_radps"))
      .def("run", &run, py::arg("t_s"), py::arg("delta_theta_b"), py::arg("delta_velocity_b"), py::kw_only(),
           py::arg("epochs_s"), py::arg("range_changes_m"), py::arg("record_every"), py::arg("covariance"),
           "A whole run; the navigator stays as it is.");
}

}  // namespace soopnav::python
