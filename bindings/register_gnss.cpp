#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/geometry/local_frame.hpp"
#include "soopnav/geometry/wgs84.hpp"
#include "soopnav/gnss/ephemeris.hpp"

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

}  // namespace

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
