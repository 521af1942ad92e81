#include <pybind11/native_enum.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
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
#include "soopnav/gnss/ephemeris.hpp"
#include "soopnav/gnss/single_point.hpp"
#include "soopnav/simulation/gnss_observables.hpp"

namespace soopnav::python {

namespace {

using gnss::Ephemeris;
using gnss::EphemerisTable;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

// The columns of a table of ephemerides that are real numbers, in the order of Python's records.
constexpr std::array kRealFields{
    &Ephemeris::toe_s,           &Ephemeris::toc_s,         &Ephemeris::af0_s,       &Ephemeris::af1,
    &Ephemeris::af2_ps,          &Ephemeris::tgd_s,         &Ephemeris::sqrt_a,      &Ephemeris::eccentricity,
    &Ephemeris::m0_rad,          &Ephemeris::delta_n_radps, &Ephemeris::omega_rad,   &Ephemeris::omega0_rad,
    &Ephemeris::omega_dot_radps, &Ephemeris::i0_rad,        &Ephemeris::i_dot_radps, &Ephemeris::cuc_rad,
    &Ephemeris::cus_rad,         &Ephemeris::crc_m,         &Ephemeris::crs_m,       &Ephemeris::cic_rad,
    &Ephemeris::cis_rad,         &Ephemeris::fit_interval_s};
constexpr std::size_t kWholeFields = 4;  // prn, week, health, iode
constexpr std::size_t kFields = kWholeFields + kRealFields.size();

EphemerisTable make_table(const Table<"ephemerides">& rows) {
  std::vector<Ephemeris> all;
  if (rows.rows() > 0 && rows.columns() != kFields) {
    throw std::invalid_argument("ephemerides: rows of " + std::to_string(kFields) + " numbers expected, got " +
                                std::to_string(rows.columns()));
  }
  for (std::size_t i = 0; i < rows.rows(); ++i) {
    const auto row = rows.row(i);
    for (std::size_t j = 0; j < kWholeFields; ++j) {
      if (!(std::abs(row[j]) < 1e9)) {
        throw std::invalid_argument("ephemerides[" + std::to_string(i) + "]: every number must be finite");
      }
    }
    Ephemeris& eph = all.emplace_back();
    eph.prn = static_cast<int>(row[0]);
    eph.week = static_cast<std::int64_t>(row[1]);
    eph.health = static_cast<int>(row[2]);
    eph.iode = static_cast<int>(row[3]);
    for (std::size_t j = 0; j < kRealFields.size(); ++j) eph.*kRealFields[j] = row[kWholeFields + j];
  }
  return EphemerisTable(std::move(all));
}

py::array_t<double> rows_of(std::span<const Ephemeris> all) {
  std::vector<double> out;
  out.reserve(all.size() * kFields);
  for (const Ephemeris& eph : all) {
    out.insert(out.end(), {static_cast<double>(eph.prn), static_cast<double>(eph.week), static_cast<double>(eph.health),
                           static_cast<double>(eph.iode)});
    for (const auto field : kRealFields) out.push_back(eph.*field);
  }
  return to_array(std::move(out), {static_cast<py::ssize_t>(all.size()), static_cast<py::ssize_t>(kFields)});
}

void require_size(const char* name, std::size_t size, std::size_t expected) {
  if (size == expected) return;
  throw std::invalid_argument(std::string(name) + ": " + std::to_string(expected) + " numbers expected, got " +
                              std::to_string(size));
}

Eigen::Vector3d vector_of(const char* name, const RealArrayBase& values) {
  require_size(name, values.size(), 3);
  return {values[0], values[1], values[2]};
}

void append(std::vector<double>& out, const Eigen::Vector3d& v) { out.insert(out.end(), {v[0], v[1], v[2]}); }

gnss::Klobuchar klobuchar_of(const char* name, const RealArrayBase& values) {
  require_size(name, values.size(), 8);
  gnss::Klobuchar out;
  for (std::size_t j = 0; j < 4; ++j) {
    out.alpha[j] = values[j];
    out.beta[j] = values[4 + j];
  }
  return out;
}

const Ephemeris* look_up(const EphemerisTable& table, double prn, const Epoch& t, double max_age_s) {
  return std::abs(prn) < 1e6 ? table.find(static_cast<int>(prn), t, max_age_s) : nullptr;
}

// (position (n, 3), velocity (n, 3), clock_s (n,), clock_rate (n,)) of satellite i at time i; NaN without ephemeris.
py::tuple satellite_states(const EphemerisTable& table, const RealArray<"prn">& prn, const RealArray<"week">& week,
                           const RealArray<"time_of_week_s">& second, double max_age_s) {
  const std::size_t n = prn.size();
  require_size("week", week.size(), n);
  require_size("time_of_week_s", second.size(), n);
  std::vector<double> position, velocity, clock, rate;
  for (std::size_t i = 0; i < n; ++i) {
    const Epoch t = std::abs(week[i]) < 1e9 ? gnss::gps_epoch(static_cast<std::int64_t>(week[i]), second[i])
                                            : Epoch::invalid(TimeScale::kGps);
    const Ephemeris* eph = look_up(table, prn[i], t, max_age_s);
    const auto state = eph != nullptr ? gnss::satellite_state(*eph, t) : std::nullopt;
    append(position, state ? state->position_e : Eigen::Vector3d::Constant(kNan));
    append(velocity, state ? state->velocity_e : Eigen::Vector3d::Constant(kNan));
    clock.push_back(state ? state->clock_s : kNan);
    rate.push_back(state ? state->clock_rate : kNan);
  }
  const auto rows = static_cast<py::ssize_t>(n);
  return py::make_tuple(to_array(std::move(position), {rows, 3}), to_array(std::move(velocity), {rows, 3}),
                        to_array(std::move(clock)), to_array(std::move(rate)));
}

// What a receiver at one place sees at each time of each satellite: (position (t, s, 3), velocity, direction,
// range (t, s), range rate, azimuth, elevation, clock_s, clock_rate).
py::tuple sights(const EphemerisTable& table, const RealArray<"prn">& prn, const RealArray<"week">& week,
                 const RealArray<"time_of_week_s">& second, const RealArray<"receiver_position_m">& receiver,
                 const RealArray<"receiver_velocity_mps">& speed, double max_age_s) {
  require_size("time_of_week_s", second.size(), week.size());
  const Eigen::Vector3d p = vector_of("receiver_position_m", receiver);
  const Eigen::Vector3d v = vector_of("receiver_velocity_mps", speed);
  const auto place = geometry::ecef_to_geodetic(p);
  if (!place)
    throw std::invalid_argument("receiver_position_m: an ECEF position is expected, at least 1e6 m from the centre");
  const geometry::LocalFrame frame(*place);
  std::array<std::vector<double>, 3> vectors;
  std::array<std::vector<double>, 6> numbers;
  for (std::size_t k = 0; k < week.size(); ++k) {
    const Epoch t = std::abs(week[k]) < 1e9 ? gnss::gps_epoch(static_cast<std::int64_t>(week[k]), second[k])
                                            : Epoch::invalid(TimeScale::kGps);
    for (std::size_t i = 0; i < prn.size(); ++i) {
      const Ephemeris* eph = look_up(table, prn[i], t, max_age_s);
      const auto seen = eph != nullptr ? gnss::sight(*eph, t, p, v) : std::nullopt;
      if (!seen) {
        for (auto& column : vectors) append(column, Eigen::Vector3d::Constant(kNan));
        for (auto& column : numbers) column.push_back(kNan);
        continue;
      }
      append(vectors[0], seen->position_e);
      append(vectors[1], seen->velocity_e);
      append(vectors[2], seen->direction_e);
      const auto direction = frame.direction_to(seen->position_e);
      const std::array values{seen->range_m,
                              seen->range_rate_mps,
                              direction ? direction->azimuth_rad : kNan,
                              direction ? direction->elevation_rad : kNan,
                              seen->at_transmission.clock_s,
                              seen->at_transmission.clock_rate};
      for (std::size_t j = 0; j < values.size(); ++j) numbers[j].push_back(values[j]);
    }
  }
  const std::vector<py::ssize_t> flat{static_cast<py::ssize_t>(week.size()), static_cast<py::ssize_t>(prn.size())};
  const std::vector<py::ssize_t> deep{flat[0], flat[1], 3};
  return py::make_tuple(to_array(std::move(vectors[0]), deep), to_array(std::move(vectors[1]), deep),
                        to_array(std::move(vectors[2]), deep), to_array(std::move(numbers[0]), flat),
                        to_array(std::move(numbers[1]), flat), to_array(std::move(numbers[2]), flat),
                        to_array(std::move(numbers[3]), flat), to_array(std::move(numbers[4]), flat),
                        to_array(std::move(numbers[5]), flat));
}

// The fixes of many epochs, column by column; see `PointFixes` in Python.
py::tuple single_points(const EphemerisTable& table, const std::optional<RealArray<"klobuchar">>& coefficients,
                        const gnss::PointOptions& options, const RealArray<"prn">& prn, const RealArray<"week">& week,
                        const RealArray<"time_of_week_s">& second, const Numbers<"code_m">& code,
                        const Numbers<"range_rate_mps">& rate, const Numbers<"sigmas_m">& sigma) {
  const std::size_t n = week.size();
  const std::size_t s = prn.size();
  require_size("time_of_week_s", second.size(), n);
  if (s > gnss::kMaxSatellites) {
    throw std::invalid_argument("prn: at most " + std::to_string(gnss::kMaxSatellites) + " satellites, got " +
                                std::to_string(s));
  }
  const auto require_table = [n, s](const char* name, const NumbersBase& values) {
    const std::vector<py::ssize_t> expected{static_cast<py::ssize_t>(n), static_cast<py::ssize_t>(s)};
    if (values.shape() == expected) return;
    throw std::invalid_argument(std::string(name) + ": shape (" + std::to_string(n) + ", " + std::to_string(s) +
                                ") expected, one row for each epoch and one column for each satellite");
  };
  require_table("code_m", code);
  require_table("range_rate_mps", rate);
  require_table("sigmas_m", sigma);
  std::optional<gnss::Klobuchar> klobuchar;
  if (coefficients) klobuchar = klobuchar_of("klobuchar", *coefficients);
  const gnss::SinglePoint solver(table, klobuchar, options);

  std::vector<std::uint8_t> status(n), use(n * s);
  std::vector<std::int64_t> freedom(n), iterations(n);
  std::vector<double> position(3 * n), covariance(9 * n), level(9 * n), bias(n), bias_sigma(n), dop(5 * n), square(n),
      velocity(3 * n), velocity_covariance(9 * n), drift(n), open(16 * n, kNan), residual(n * s), azimuth(n * s),
      elevation(n * s);
  {
    const py::gil_scoped_release release;
    std::vector<gnss::PointMeasurement> measured(s);
    for (std::size_t k = 0; k < n; ++k) {
      for (std::size_t i = 0; i < s; ++i) {
        measured[i].prn = std::abs(prn[i]) < 1e6 ? static_cast<int>(prn[i]) : 0;
        measured[i].pseudorange_m = code.span()[k * s + i];
        measured[i].range_rate_mps = rate.span()[k * s + i];
        measured[i].sigma_m = sigma.span()[k * s + i];
      }
      const Epoch t = std::abs(week[k]) < 1e9 ? gnss::gps_epoch(static_cast<std::int64_t>(week[k]), second[k])
                                              : Epoch::invalid(TimeScale::kGps);
      const gnss::PointFix fix = solver.fix(t, measured);
      status[k] = static_cast<std::uint8_t>(fix.status);
      freedom[k] = fix.degrees_of_freedom;
      iterations[k] = fix.iterations;
      const auto offset = [k](std::vector<double>& column, std::size_t width) { return column.data() + k * width; };
      Eigen::Map<Eigen::Vector3d>(offset(position, 3)) = fix.position_e;
      Eigen::Map<Eigen::Matrix3d>(offset(covariance, 9)) = fix.covariance_m2;
      Eigen::Map<Eigen::Matrix3d>(offset(level, 9)) = fix.covariance_enu_m2;
      Eigen::Map<Eigen::Vector3d>(offset(velocity, 3)) = fix.velocity_e;
      Eigen::Map<Eigen::Matrix3d>(offset(velocity_covariance, 9)) = fix.velocity_covariance;
      bias[k] = fix.clock_bias_m;
      bias_sigma[k] = fix.clock_sigma_m;
      drift[k] = fix.clock_drift_mps;
      square[k] = fix.chi_square;
      Eigen::Map<Eigen::Matrix<double, 5, 1>>(offset(dop, 5)) << fix.dop.gdop, fix.dop.pdop, fix.dop.hdop, fix.dop.vdop,
          fix.dop.tdop;
      for (Eigen::Index j = 0; j < fix.unobservable.cols(); ++j) {
        for (Eigen::Index i = 0; i < 4; ++i)
          open[k * 16 + static_cast<std::size_t>(4 * j + i)] = fix.unobservable(i, j);
      }
      for (std::size_t i = 0; i < s; ++i) {
        use[k * s + i] = static_cast<std::uint8_t>(fix.use[i]);
        residual[k * s + i] = fix.residuals_m[i];
        azimuth[k * s + i] = fix.azimuths_rad[i];
        elevation[k * s + i] = fix.elevations_rad[i];
      }
    }
  }
  const auto rows = static_cast<py::ssize_t>(n);
  const std::vector<py::ssize_t> square_shape{rows, 3, 3};
  const std::vector<py::ssize_t> each{rows, static_cast<py::ssize_t>(s)};
  return py::make_tuple(
      to_array(std::move(status)), to_array(std::move(position), {rows, 3}),
      to_array(std::move(covariance), square_shape), to_array(std::move(level), square_shape),
      to_array(std::move(bias)), to_array(std::move(bias_sigma)), to_array(std::move(dop), {rows, 5}),
      to_array(std::move(square)), to_array(std::move(freedom)), to_array(std::move(iterations)),
      to_array(std::move(velocity), {rows, 3}), to_array(std::move(velocity_covariance), square_shape),
      to_array(std::move(drift)), to_array(std::move(open), {rows, 4, 4}), to_array(std::move(use), each),
      to_array(std::move(residual), each), to_array(std::move(azimuth), each), to_array(std::move(elevation), each));
}

// Observables of antennas (a, n, 3) over epochs: nine tables (a, n, s), the satellites and the integers (a, s).
py::tuple simulate_gnss(const EphemerisTable& table, const simulation::GnssObservableOptions& options,
                        const Numbers<"positions_m">& positions, const Numbers<"velocities_mps">& velocities,
                        const RealArray<"week">& week, const RealArray<"time_of_week_s">& second,
                        const Numbers<"clock_bias_m">& bias, const Numbers<"clock_drift_mps">& drift,
                        std::uint64_t seed, std::uint64_t stream) {
  const std::size_t n = week.size();
  require_size("time_of_week_s", second.size(), n);
  positions.require_axes({3}, "positions of shape (antennas, epochs, 3)");
  const auto antennas = static_cast<std::size_t>(positions.shape()[0]);
  const std::vector<py::ssize_t> path{positions.shape()[0], static_cast<py::ssize_t>(n), 3};
  const std::vector<py::ssize_t> flat{path[0], path[1]};
  if (positions.shape() != path || velocities.shape() != path || bias.shape() != flat || drift.shape() != flat) {
    throw std::invalid_argument("positions_m: shape (antennas, " + std::to_string(n) +
                                ", 3) expected, one place for each epoch, and clocks to go with them");
  }
  simulation::GnssObservables simulator(table, options, antennas, RandomStream(seed, stream));
  const std::size_t s = simulator.prns().size();
  std::array<std::vector<double>, 8> columns;
  for (auto& column : columns) column.resize(antennas * n * s);
  {
    const py::gil_scoped_release release;
    std::vector<simulation::GnssObservable> seen(s);
    for (std::size_t a = 0; a < antennas; ++a) {
      for (std::size_t k = 0; k < n; ++k) {
        const std::size_t at = a * n + k;
        const Epoch t = std::abs(week[k]) < 1e9 ? gnss::gps_epoch(static_cast<std::int64_t>(week[k]), second[k])
                                                : Epoch::invalid(TimeScale::kGps);
        const Eigen::Vector3d p(positions.span()[3 * at], positions.span()[3 * at + 1], positions.span()[3 * at + 2]);
        const Eigen::Vector3d v(velocities.span()[3 * at], velocities.span()[3 * at + 1],
                                velocities.span()[3 * at + 2]);
        simulator.observe(a, k, t, p, v, bias.span()[at], drift.span()[at], seen);
        for (std::size_t i = 0; i < s; ++i) {
          const simulation::GnssObservable& o = seen[i];
          const std::array values{o.code_m,  o.phase_cycles,   o.doppler_hz,  o.cn0_dbhz,
                                  o.range_m, o.range_rate_mps, o.azimuth_rad, o.elevation_rad};
          for (std::size_t j = 0; j < values.size(); ++j) columns[j][at * s + i] = values[j];
        }
      }
    }
  }
  const std::vector<py::ssize_t> shape{path[0], path[1], static_cast<py::ssize_t>(s)};
  std::vector<int> prns(simulator.prns().begin(), simulator.prns().end());
  std::vector<double> integers;
  for (std::size_t a = 0; a < antennas; ++a) {
    integers.insert(integers.end(), simulator.integers(a).begin(), simulator.integers(a).end());
  }
  py::list tables;
  for (auto& column : columns) tables.append(to_array(std::move(column), shape));
  return py::make_tuple(tables, to_array(std::move(prns)), to_array(std::move(integers), {shape[0], shape[2]}));
}

}  // namespace

void register_gnss_simulation(py::module_& m) {
  using simulation::GnssObservableOptions;
  py::class_<GnssObservableOptions>(m, "GnssObservableOptions", "What a simulated GNSS receiver is like.")
      .def(py::init([](double elevation_mask_rad, double cn0_zenith_dbhz, double cn0_drop_db, bool noise,
                       double phase_bandwidth_hz, double code_bandwidth_hz, double early_late_chips,
                       double integration_s, std::optional<double> code_sigma_m, std::optional<double> phase_sigma_m,
                       double doppler_sigma_hz, double multipath_sigma_m, double multipath_time_s,
                       double multipath_phase_ratio, const std::optional<RealArray<"ionosphere">>& ionosphere,
                       bool troposphere, double relative_humidity, bool integers, double max_age_s) {
             GnssObservableOptions options;
             options.elevation_mask_rad = elevation_mask_rad;
             options.cn0_zenith_dbhz = cn0_zenith_dbhz;
             options.cn0_drop_db = cn0_drop_db;
             options.noise = noise;
             options.phase_loop.bandwidth_hz = phase_bandwidth_hz;
             options.code_loop = {code_bandwidth_hz, early_late_chips, integration_s};
             options.code_sigma_m = code_sigma_m;
             options.phase_sigma_m = phase_sigma_m;
             options.doppler_sigma_hz = doppler_sigma_hz;
             options.multipath_sigma_m = multipath_sigma_m;
             options.multipath_time_s = multipath_time_s;
             options.multipath_phase_ratio = multipath_phase_ratio;
             if (ionosphere) options.ionosphere = klobuchar_of("ionosphere", *ionosphere);
             options.troposphere = troposphere;
             options.relative_humidity = relative_humidity;
             options.integers = integers;
             options.max_age_s = max_age_s;
             options.check();
             return options;
           }),
           py::kw_only(), py::arg("elevation_mask_rad"), py::arg("cn0_zenith_dbhz"), py::arg("cn0_drop_db"),
           py::arg("noise"), py::arg("phase_bandwidth_hz"), py::arg("code_bandwidth_hz"), py::arg("early_late_chips"),
           py::arg("integration_s"), py::arg("code_sigma_m"), py::arg("phase_sigma_m"), py::arg("doppler_sigma_hz"),
           py::arg("multipath_sigma_m"), py::arg("multipath_time_s"), py::arg("multipath_phase_ratio"),
           py::arg("ionosphere"), py::arg("troposphere"), py::arg("relative_humidity"), py::arg("integers"),
           py::arg("max_age_s"));
  m.def("simulate_gnss", &simulate_gnss, py::arg("table"), py::arg("options"), py::arg("positions_m"),
        py::arg("velocities_mps"), py::arg("week"), py::arg("time_of_week_s"), py::arg("clock_bias_m"),
        py::arg("clock_drift_mps"), py::arg("seed"), py::arg("stream"),
        "([code, phase, Doppler, C/N0, range, range rate, azimuth, elevation], prns, integers).");
}

void register_gnss(py::module_& m) {
  py::class_<EphemerisTable>(m, "EphemerisTable", "Broadcast orbits, ready to be looked up.")
      .def(py::init(&make_table), py::arg("ephemerides"))
      .def("__len__", [](const EphemerisTable& table) { return table.all().size(); })
      .def("prns", &EphemerisTable::prns, "The satellites' numbers, ascending.")
      .def(
          "rows", [](const EphemerisTable& table) { return rows_of(table.all()); }, "All numbers, sorted.");
  m.def("satellite_states", &satellite_states, py::arg("table"), py::arg("prn"), py::arg("week"),
        py::arg("time_of_week_s"), py::arg("max_age_s"), "(position, velocity, clock_s, clock_rate).");
  m.def("sights", &sights, py::arg("table"), py::arg("prn"), py::arg("week"), py::arg("time_of_week_s"),
        py::arg("receiver_position_m"), py::arg("receiver_velocity_mps"), py::arg("max_age_s"),
        "(position, velocity, direction, range, range rate, azimuth, elevation, clock_s, clock_rate).");
  py::native_enum<gnss::PointStatus>(m, "PointStatus", "enum.IntEnum", "How a fix ended.")
      .value("CONVERGED", gnss::PointStatus::kConverged)
      .value("INCONSISTENT", gnss::PointStatus::kInconsistent)
      .value("TOO_FEW_SATELLITES", gnss::PointStatus::kTooFewSatellites)
      .value("RANK_DEFICIENT", gnss::PointStatus::kRankDeficient)
      .value("NOT_CONVERGED", gnss::PointStatus::kNotConverged)
      .finalize();
  py::native_enum<gnss::SatelliteUse>(m, "SatelliteUse", "enum.IntEnum", "What a fix did with a satellite.")
      .value("USED", gnss::SatelliteUse::kUsed)
      .value("NOT_FINITE", gnss::SatelliteUse::kNotFinite)
      .value("NO_EPHEMERIS", gnss::SatelliteUse::kNoEphemeris)
      .value("STALE", gnss::SatelliteUse::kStale)
      .value("UNHEALTHY", gnss::SatelliteUse::kUnhealthy)
      .value("LOW", gnss::SatelliteUse::kLow)
      .value("REJECTED", gnss::SatelliteUse::kRejected)
      .finalize();
  py::class_<gnss::PointOptions>(m, "PointOptions", "What a fix assumes.")
      .def(py::init([](double elevation_mask_rad, double sigma_m, double sigma_rate_mps, bool weight_by_elevation,
                       bool ionosphere, bool troposphere, double relative_humidity, bool reject_outliers,
                       double false_alarm_probability, double max_age_s, int max_iterations) {
             const gnss::PointOptions options{.elevation_mask_rad = elevation_mask_rad,
                                              .sigma_m = sigma_m,
                                              .sigma_rate_mps = sigma_rate_mps,
                                              .weight_by_elevation = weight_by_elevation,
                                              .ionosphere = ionosphere,
                                              .troposphere = troposphere,
                                              .relative_humidity = relative_humidity,
                                              .reject_outliers = reject_outliers,
                                              .false_alarm_probability = false_alarm_probability,
                                              .max_age_s = max_age_s,
                                              .max_iterations = max_iterations};
             options.check();
             return options;
           }),
           py::kw_only(), py::arg("elevation_mask_rad"), py::arg("sigma_m"), py::arg("sigma_rate_mps"),
           py::arg("weight_by_elevation"), py::arg("ionosphere"), py::arg("troposphere"), py::arg("relative_humidity"),
           py::arg("reject_outliers"), py::arg("false_alarm_probability"), py::arg("max_age_s"),
           py::arg("max_iterations"));
  m.def("single_points", &single_points, py::arg("table"), py::arg("klobuchar"), py::arg("options"), py::arg("prn"),
        py::arg("week"), py::arg("time_of_week_s"), py::arg("code_m"), py::arg("range_rate_mps"), py::arg("sigmas_m"),
        "The fixes of many epochs, column by column.");
  m.def(
      "walker_constellation",
      [](int satellites, int planes, int phasing, double inclination_rad, double radius_m, std::int64_t week,
         double toe_s, double first_node_rad, double fit_interval_s) {
        return rows_of(gnss::walker_constellation({.satellites = satellites,
                                                   .planes = planes,
                                                   .phasing = phasing,
                                                   .inclination_rad = inclination_rad,
                                                   .radius_m = radius_m,
                                                   .week = week,
                                                   .toe_s = toe_s,
                                                   .first_node_rad = first_node_rad,
                                                   .fit_interval_s = fit_interval_s}));
      },
      py::arg("satellites"), py::arg("planes"), py::arg("phasing"), py::arg("inclination_rad"), py::arg("radius_m"),
      py::arg("week"), py::arg("toe_s"), py::arg("first_node_rad"), py::arg("fit_interval_s"),
      "Ephemerides of a Walker constellation.");
}

}  // namespace soopnav::python
