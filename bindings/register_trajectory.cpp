#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/inertial/imu_errors.hpp"
#include "soopnav/simulation/planar_trajectory.hpp"

namespace soopnav::python {

namespace {

using inertial::ImuErrorModel;
using inertial::ReadingStatus;
using inertial::SensorErrorModel;
using simulation::PlanarMotion;
using simulation::PlanarTrajectory;

// Motions as columns, which arrays look at.
struct Columns {
  std::vector<double> t_s, heading_rad, velocity_mps, position_m, yaw_rate_radps, specific_force_b_mps2;

  void add(const PlanarMotion& m) {
    t_s.push_back(m.t_s);
    heading_rad.push_back(m.heading_rad);
    yaw_rate_radps.push_back(m.yaw_rate_radps);
    for (Eigen::Index i = 0; i < 2; ++i) {
      velocity_mps.push_back(m.velocity_mps[i]);
      position_m.push_back(m.position_m[i]);
      specific_force_b_mps2.push_back(m.specific_force_b_mps2[i]);
    }
  }
};

struct Trajectory {
  PlanarTrajectory motion;
  Columns columns;

  explicit Trajectory(PlanarTrajectory&& made) : motion(std::move(made)) {
    for (const PlanarMotion& m : motion.points()) columns.add(m);
  }
};

Eigen::Vector2d pair(const std::array<double, 2>& numbers) { return {numbers[0], numbers[1]}; }

std::vector<Eigen::Vector2d> pairs(const TableBase& table, const char* name) {
  if (table.rows() > 0 && table.columns() != 2) {
    throw py::value_error(std::string(name) + ": expected shape (n, 2), got (" + std::to_string(table.rows()) + ", " +
                          std::to_string(table.columns()) + ")");
  }
  std::vector<Eigen::Vector2d> out;
  for (std::size_t i = 0; i < table.rows(); ++i) out.emplace_back(table.row(i)[0], table.row(i)[1]);
  return out;
}

py::ssize_t count_of(const std::vector<double>& column) { return static_cast<py::ssize_t>(column.size()); }

py::array_t<double> as_pairs(std::vector<double>&& column) {
  const py::ssize_t rows = count_of(column) / 2;
  return to_array(std::move(column), {rows, 2});
}

// A property that looks at one column of a trajectory.
template <std::vector<double> Columns::*Column, py::ssize_t Width>
py::array_t<double> view(const py::object& self) {
  const auto& values = self.cast<const Trajectory&>().columns.*Column;
  std::vector<py::ssize_t> shape{count_of(values) / Width};
  if (Width > 1) shape.push_back(Width);
  return view_array(std::span<const double>(values), self, std::move(shape));
}

py::tuple at(const Trajectory& self, const RealArray<"t_s">& t_s) {
  Columns out;
  for (std::size_t i = 0; i < t_s.size(); ++i) {
    const auto motion = self.motion.at(t_s[i]);
    if (!motion) {
      throw py::value_error("t_s[" + std::to_string(i) + "] = " + std::to_string(t_s[i]) + ": 0 ... " +
                            std::to_string(self.motion.duration_s()) + " expected");
    }
    out.add(*motion);
  }
  return py::make_tuple(to_array(std::move(out.heading_rad)), as_pairs(std::move(out.velocity_mps)),
                        as_pairs(std::move(out.position_m)), to_array(std::move(out.yaw_rate_radps)),
                        as_pairs(std::move(out.specific_force_b_mps2)));
}

py::tuple imu(const Trajectory& self, double rate_hz, const ImuErrorModel& errors, const std::string& sampling,
              std::uint64_t seed, std::uint64_t stream) {
  using simulation::PlanarSampling;
  PlanarSampling how = PlanarSampling::kMean;
  if (sampling == "centre") {
    how = PlanarSampling::kCentre;
  } else if (sampling == "left") {
    how = PlanarSampling::kLeft;
  } else if (sampling != "mean") {
    throw py::value_error("sampling: expected 'mean', 'centre' or 'left', got '" + sampling + "'");
  }
  std::vector<double> t_s, rate, force;
  std::vector<std::uint8_t> saturated;
  {
    const py::gil_scoped_release release;
    for (const auto& reading : simulation::planar_imu(self.motion, rate_hz, errors, RandomStream(seed, stream), how)) {
      t_s.push_back(reading.t_s);
      rate.push_back(reading.sample.yaw_rate_radps);
      force.push_back(reading.sample.specific_force_b_mps2[0]);
      force.push_back(reading.sample.specific_force_b_mps2[1]);
      saturated.push_back(reading.status == ReadingStatus::kSaturated ? 1 : 0);
    }
  }
  return py::make_tuple(to_array(std::move(t_s)), to_array(std::move(rate)), as_pairs(std::move(force)),
                        to_array(std::move(saturated)));
}

template <int Gyros, int Accelerometers>
py::tuple apply_of(const ImuErrorModel& errors, const TableBase& rate, const TableBase& force, double dt_s,
                   std::uint64_t seed, std::uint64_t stream) {
  inertial::ImuErrors<Gyros, Accelerometers> unit(errors, RandomStream(seed, stream));
  std::vector<double> w, f;
  std::vector<std::uint8_t> saturated;
  for (std::size_t k = 0; k < rate.rows(); ++k) {
    Eigen::Matrix<double, Gyros, 1> u;
    Eigen::Matrix<double, Accelerometers, 1> a;
    for (int i = 0; i < Gyros; ++i) u[i] = rate.row(k)[static_cast<std::size_t>(i)];
    for (int i = 0; i < Accelerometers; ++i) a[i] = force.row(k)[static_cast<std::size_t>(i)];
    const ReadingStatus status = unit.apply(u, a, dt_s);
    if (status == ReadingStatus::kRejected) {
      throw py::value_error("row " + std::to_string(k) + ": rates and forces must be finite");
    }
    for (int i = 0; i < Gyros; ++i) w.push_back(u[i]);
    for (int i = 0; i < Accelerometers; ++i) f.push_back(a[i]);
    saturated.push_back(status == ReadingStatus::kSaturated ? 1 : 0);
  }
  const auto rows = static_cast<py::ssize_t>(rate.rows());
  return py::make_tuple(to_array(std::move(w), {rows, Gyros}), to_array(std::move(f), {rows, Accelerometers}),
                        to_array(std::move(saturated)));
}

py::tuple apply(const ImuErrorModel& errors, const Table<"rate_radps">& rate, const Table<"force_mps2">& force,
                double rate_hz, std::uint64_t seed, std::uint64_t stream) {
  if (!(rate_hz > 0.0) || std::isinf(rate_hz)) {
    throw py::value_error("rate_hz = " + std::to_string(rate_hz) + " must be positive and finite");
  }
  if (rate.rows() != force.rows()) {
    throw py::value_error("force_mps2: " + std::to_string(rate.rows()) + " rows expected, got " +
                          std::to_string(force.rows()));
  }
  if (rate.columns() == 3 && force.columns() == 3)
    return apply_of<3, 3>(errors, rate, force, 1.0 / rate_hz, seed, stream);
  if (rate.columns() == 1 && force.columns() == 2)
    return apply_of<1, 2>(errors, rate, force, 1.0 / rate_hz, seed, stream);
  throw py::value_error("rate_radps and force_mps2: shapes (n, 3) and (n, 3), or (n, 1) and (n, 2), expected");
}

using Field = double SensorErrorModel::*;
constexpr std::array<std::pair<const char*, Field>, 10> kFields{{
    {"sample_sigma", &SensorErrorModel::sample_sigma},
    {"white_density", &SensorErrorModel::white_density},
    {"turn_on_sigma", &SensorErrorModel::turn_on_sigma},
    {"bias_walk_density", &SensorErrorModel::bias_walk_density},
    {"markov_sigma", &SensorErrorModel::markov_sigma},
    {"markov_time_s", &SensorErrorModel::markov_time_s},
    {"scale_sigma", &SensorErrorModel::scale_sigma},
    {"misalignment_sigma", &SensorErrorModel::misalignment_sigma},
    {"saturation", &SensorErrorModel::saturation},
    {"quantum", &SensorErrorModel::quantum},
}};

// Only what differs from a perfect sensor.
std::string text(const SensorErrorModel& model) {
  const SensorErrorModel perfect;
  std::ostringstream out;
  for (const auto& [name, field] : kFields) {
    if (model.*field != perfect.*field) out << (out.tellp() > 0 ? ", " : "") << name << "=" << model.*field;
  }
  return "SensorErrorModel(" + out.str() + ")";
}

bool same(const SensorErrorModel& a, const SensorErrorModel& b) {
  for (const auto& [name, field] : kFields) {
    if (a.*field != b.*field) return false;
  }
  return true;
}

py::tuple saved(const SensorErrorModel& model) {
  py::tuple out(kFields.size());
  for (std::size_t i = 0; i < kFields.size(); ++i) out[i] = model.*kFields[i].second;
  return out;
}

SensorErrorModel restored(const py::tuple& numbers) {
  SensorErrorModel model;
  for (std::size_t i = 0; i < kFields.size(); ++i) model.*kFields[i].second = numbers[i].cast<double>();
  return model;
}

void register_errors(py::module_& m) {
  py::class_<SensorErrorModel> sensor(m, "SensorErrorModel",
                                      "Errors of a sensor's equal axes; all zero by default. Unit: rad/s or m/s².");
  sensor
      .def(py::init([](double sample_sigma, double white_density, double turn_on_sigma, double bias_walk_density,
                       double markov_sigma, double markov_time_s, double scale_sigma, double misalignment_sigma,
                       double saturation, double quantum) {
             const SensorErrorModel model{sample_sigma, white_density, turn_on_sigma, bias_walk_density,
                                          markov_sigma, markov_time_s, scale_sigma,   misalignment_sigma,
                                          saturation,   quantum};
             static_cast<void>(inertial::SensorErrors<1>(model, RandomStream{}, "SensorErrorModel"));
             return model;
           }),
           py::kw_only(), py::arg("sample_sigma") = 0.0, py::arg("white_density") = 0.0, py::arg("turn_on_sigma") = 0.0,
           py::arg("bias_walk_density") = 0.0, py::arg("markov_sigma") = 0.0, py::arg("markov_time_s") = 0.0,
           py::arg("scale_sigma") = 0.0, py::arg("misalignment_sigma") = 0.0,
           py::arg_v("saturation", std::numeric_limits<double>::infinity(), "float('inf')"), py::arg("quantum") = 0.0,
           "White noise of each sample and by density [unit/√Hz], bias at start, its walk [unit/√s], a Gauss-Markov "
           "bias, relative scale, small angles [rad], largest reading and converter step.")
      .def("__repr__", &text)
      .def("__eq__", &same, py::is_operator())
      .def("__hash__", [](const SensorErrorModel& self) { return py::hash(saved(self)); })
      .def(py::pickle(&saved, &restored));
  for (const auto& [name, field] : kFields) {
    sensor.def_property_readonly(name, [field = field](const SensorErrorModel& self) { return self.*field; });
  }
  py::class_<ImuErrorModel>(m, "ImuErrorModel", "Errors of a unit's gyros [rad/s] and accelerometers [m/s²].")
      .def(py::init([](const SensorErrorModel& gyro, const SensorErrorModel& accelerometer) {
             ImuErrorModel model;
             model.gyro = gyro;
             model.accelerometer = accelerometer;
             return model;
           }),
           py::arg_v("gyro", SensorErrorModel{}, "SensorErrorModel()"),
           py::arg_v("accelerometer", SensorErrorModel{}, "SensorErrorModel()"), "Perfect by default.")
      .def_static("crosby", &ImuErrorModel::crosby, "White, 0.1 rad/s and 0.1 m/s² per sample (crosby section 4.1).")
      .def_static("consumer", &ImuErrorModel::consumer, "200 µg/√Hz, 0.01 °/s/√Hz; biases 5 mg, 50 °/h.")
      .def_static("industrial", &ImuErrorModel::industrial, "60 µg/√Hz, 0.15 °/√h; biases 0.5 mg, 5 °/h.")
      .def_static("tactical", &ImuErrorModel::tactical, "30 µg/√Hz, 0.05 °/√h; biases 0.3 mg, 1 °/h.")
      .def_readonly("gyro", &ImuErrorModel::gyro)
      .def_readonly("accelerometer", &ImuErrorModel::accelerometer)
      .def("apply", &apply, py::arg("rate_radps"), py::arg("force_mps2"), py::arg("rate_hz"), py::kw_only(),
           py::arg("seed"), py::arg("stream") = 0,
           "What a unit with these errors says of true rows: (rates, forces, whether saturated). Shapes (n, 3) and "
           "(n, 3) in space, (n, 1) and (n, 2) in the plane.")
      .def("__repr__",
           [](const ImuErrorModel& self) {
             return "ImuErrorModel(gyro=" + text(self.gyro) + ", accelerometer=" + text(self.accelerometer) + ")";
           })
      .def(
          "__eq__",
          [](const ImuErrorModel& a, const ImuErrorModel& b) {
            return same(a.gyro, b.gyro) && same(a.accelerometer, b.accelerometer);
          },
          py::is_operator())
      .def("__hash__",
           [](const ImuErrorModel& self) {
             return py::hash(py::make_tuple(saved(self.gyro), saved(self.accelerometer)));
           })
      .def(py::pickle(
          [](const ImuErrorModel& self) { return py::make_tuple(saved(self.gyro), saved(self.accelerometer)); },
          [](const py::tuple& state) {
            ImuErrorModel model;
            model.gyro = restored(state[0].cast<py::tuple>());
            model.accelerometer = restored(state[1].cast<py::tuple>());
            return model;
          }));
}

}  // namespace

void register_trajectory(py::module_& m) {
  register_errors(m);
  using Pair = std::array<double, 2>;
  py::class_<Trajectory>(m, "PlanarTrajectory", "A planar trajectory; made by the functions of soopnav_cpp.simulation.")
      .def_static(
          "continuous_turn",
          [](double duration_s, double speed_mps, double ramp_s, double turn_rate_radps, double turn_amplitude_radps,
             double turn_period_s, double heading_rad, const Pair& position_m, double rate_hz) {
            const py::gil_scoped_release release;
            return Trajectory(
                PlanarTrajectory::continuous_turn({duration_s, speed_mps, ramp_s, turn_rate_radps, turn_amplitude_radps,
                                                   turn_period_s, heading_rad, pair(position_m)},
                                                  rate_hz));
          },
          py::kw_only(), py::arg("duration_s"), py::arg("speed_mps"), py::arg("ramp_s"), py::arg("turn_rate_radps"),
          py::arg("turn_amplitude_radps"), py::arg("turn_period_s"), py::arg("heading_rad"), py::arg("position_m"),
          py::arg("rate_hz"), "From rest into a turn that never settles.")
      .def_static(
          "through",
          [](const Table<"waypoints_m">& waypoints_m, double speed_mps, double acceleration, double lateral,
             double smoothing_s, double rate_hz) {
            const auto points = pairs(waypoints_m, "waypoints_m");
            const py::gil_scoped_release release;
            return Trajectory(
                PlanarTrajectory::through(points, {speed_mps, acceleration, lateral, smoothing_s}, rate_hz));
          },
          py::arg("waypoints_m"), py::kw_only(), py::arg("speed_mps"), py::arg("acceleration_mps2"),
          py::arg("lateral_acceleration_mps2"), py::arg("smoothing_s"), py::arg("rate_hz"),
          "From rest to rest along a smooth way.")
      .def_static(
          "from_profiles",
          [](const RealArray<"yaw_rate_radps">& rate, const Table<"specific_force_b_mps2">& force, double rate_hz,
             double heading_rad, const Pair& velocity_mps, const Pair& position_m) {
            const auto forces = pairs(force, "specific_force_b_mps2");
            const py::gil_scoped_release release;
            return Trajectory(PlanarTrajectory::from_profiles(rate.span(), forces, rate_hz,
                                                              {heading_rad, pair(velocity_mps), pair(position_m)}));
          },
          py::arg("yaw_rate_radps"), py::arg("specific_force_b_mps2"), py::arg("rate_hz"), py::kw_only(),
          py::arg("heading_rad"), py::arg("velocity_mps"), py::arg("position_m"), "Profiles integrated by trapezoids.")
      .def_property_readonly("t_s", &view<&Columns::t_s, 1>)
      .def_property_readonly("heading_rad", &view<&Columns::heading_rad, 1>)
      .def_property_readonly("velocity_mps", &view<&Columns::velocity_mps, 2>)
      .def_property_readonly("position_m", &view<&Columns::position_m, 2>)
      .def_property_readonly("yaw_rate_radps", &view<&Columns::yaw_rate_radps, 1>)
      .def_property_readonly("specific_force_b_mps2", &view<&Columns::specific_force_b_mps2, 2>)
      .def_property_readonly("rate_hz", [](const Trajectory& self) { return self.motion.rate_hz(); })
      .def_property_readonly("duration_s", [](const Trajectory& self) { return self.motion.duration_s(); })
      .def("at", &at, py::arg("t_s"), "(heading, velocity, position, yaw rate, specific force) at times.")
      .def("imu", &imu, py::arg("rate_hz"), py::kw_only(), py::arg("errors"), py::arg("sampling"), py::arg("seed"),
           py::arg("stream"), "(t_s, yaw rate, specific force, whether saturated) of a simulated unit.");
}

}  // namespace soopnav::python
