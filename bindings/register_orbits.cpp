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
#include <utility>
#include <vector>

#include "array.hpp"
#include "doppler_fix.hpp"
#include "register.hpp"
#include "soopnav/geometry/orbit.hpp"
#include "soopnav/geometry/sampled_orbit.hpp"
#include "soopnav/navigation/doppler_fix.hpp"

namespace soopnav::python {

namespace {

using geometry::OrbitState;
using geometry::SampledOrbit;
using geometry::WalkerConstellation;

void orbit_columns(const TableBase& table, const char* name, std::size_t rows) {
  if (table.columns() != 3) {
    throw std::invalid_argument(std::string(name) + ": rows of three numbers expected, got " +
                                std::to_string(table.columns()));
  }
  if (table.rows() == rows) return;
  throw std::invalid_argument(std::string(name) + ": " + std::to_string(rows) + " rows expected, got " +
                              std::to_string(table.rows()));
}

Eigen::Vector3d orbit_row(const TableBase& table, std::size_t i) {
  const auto row = table.row(i);
  return {row[0], row[1], row[2]};
}

std::span<const double> orbit_numbers(const TableBase& table) {
  return table.rows() == 0 ? std::span<const double>() : std::span(table.row(0).data(), 3 * table.rows());
}

py::array_t<double> orbit_samples(const SampledOrbit& orbit, bool velocity) {
  std::vector<double> values;
  values.reserve(3 * orbit.samples().size());
  for (const OrbitState& state : orbit.samples()) {
    const Eigen::Vector3d& v = velocity ? state.v_e : state.p_e;
    values.insert(values.end(), v.data(), v.data() + 3);
  }
  const auto n = static_cast<py::ssize_t>(orbit.samples().size());
  return to_array(std::move(values), {n, 3});
}

std::string orbit_repr(const SampledOrbit& orbit) {
  std::array<char, 160> text{};
  const Eigen::Vector3d& p = orbit.samples().front().p_e;
  if (orbit.is_fixed()) {
    std::snprintf(text.data(), text.size(), "SampledOrbit.fixed([%.3f, %.3f, %.3f])", p.x(), p.y(), p.z());
  } else {
    std::snprintf(text.data(), text.size(), "SampledOrbit(%.3f s to %.3f s, %zu samples of %.3f s)", orbit.start_s(),
                  orbit.end_s(), orbit.samples().size(), orbit.step_s());
  }
  return text.data();
}

}  // namespace

void register_orbits(py::module_& m) {
  py::class_<SampledOrbit>(
      m, "SampledOrbit",
      R"(Where a transmitter is over time: ECEF samples at even steps, joined by cubic Hermite polynomials.

Immutable. Times are seconds from a reference of the caller's choice, within days of it.

Parameters
----------
start_s, step_s : float
    Sample i is of start_s + i step_s.
position_e_m, velocity_e_mps : array_like, shape (n, 3)
    ECEF; the velocity relative to the turning Earth. At least two rows.

Raises
------
ValueError
    For shapes that differ, a step that is not positive, numbers that are not finite.)")
      .def(
          py::init([](double start_s, double step_s, const Table<"position_e_m">& p, const Table<"velocity_e_mps">& v) {
            orbit_columns(p, "position_e_m", p.rows());
            orbit_columns(v, "velocity_e_mps", p.rows());
            return SampledOrbit(start_s, step_s, orbit_numbers(p), orbit_numbers(v));
          }),
          py::arg("start_s"), py::arg("step_s"), py::arg("position_e_m"), py::arg("velocity_e_mps"))
      .def_static(
          "fixed",
          [](const RealArray<"position_e_m">& p) {
            if (p.size() != 3) throw std::invalid_argument("position_e_m: three numbers expected");
            return SampledOrbit::fixed({p[0], p[1], p[2]});
          },
          py::arg("position_e_m"), "A transmitter at rest on the Earth, known at any time.")
      .def_property_readonly("is_fixed", &SampledOrbit::is_fixed, "At rest on the Earth.")
      .def_property_readonly("start_s", &SampledOrbit::start_s, "Time of the first sample; minus infinity at rest.")
      .def_property_readonly("end_s", &SampledOrbit::end_s, "Time of the last sample; infinity at rest.")
      .def_property_readonly("step_s", &SampledOrbit::step_s, "From one sample to the next; 0 at rest.")
      .def_property_readonly(
          "position_e_m", [](const SampledOrbit& o) { return orbit_samples(o, false); }, "Samples, shape (n, 3).")
      .def_property_readonly(
          "velocity_e_mps", [](const SampledOrbit& o) { return orbit_samples(o, true); }, "Samples, shape (n, 3).")
      .def(
          "_at",
          [](const SampledOrbit& orbit, const RealArray<"t_s">& t) {
            std::vector<double> p(3 * t.size(), std::numeric_limits<double>::quiet_NaN());
            std::vector<double> v = p;
            {
              const py::gil_scoped_release release;
              OrbitState state;
              for (std::size_t i = 0; i < t.size(); ++i) {
                if (!orbit.at(t[i], state)) continue;
                std::copy_n(state.p_e.data(), 3, p.data() + 3 * i);
                std::copy_n(state.v_e.data(), 3, v.data() + 3 * i);
              }
            }
            const auto n = static_cast<py::ssize_t>(t.size());
            return py::make_tuple(to_array(std::move(p), {n, 3}), to_array(std::move(v), {n, 3}));
          },
          py::arg("t_s"))
      .def(
          "at",
          [](const py::object& self, const py::object& t_s) {
            const py::object times = py::module_::import("numpy").attr("asarray")(t_s, "float64");
            const py::tuple out = self.attr("_at")(times.attr("reshape")(-1));
            const py::object shape = py::tuple(times.attr("shape")) + py::make_tuple(3);
            return py::make_tuple(out[0].attr("reshape")(shape), out[1].attr("reshape")(shape));
          },
          py::arg("t_s"),
          "Positions [m] and velocities [m/s] at times of any shape (...): two arrays (..., 3), NaN outside the "
          "samples.")
      .def("__len__", [](const SampledOrbit& o) { return o.samples().size(); })
      .def("__repr__", &orbit_repr)
      .def(py::pickle(
          [](const SampledOrbit& o) {
            return py::make_tuple(o.start_s(), o.step_s(), orbit_samples(o, false), orbit_samples(o, true));
          },
          [](const py::tuple& state) {
            const Table<"position_e_m"> p(state[2]);
            const Table<"velocity_e_mps"> v(state[3]);
            if (state[1].cast<double>() == 0.0) return SampledOrbit::fixed(orbit_row(p, 0));
            return SampledOrbit(state[0].cast<double>(), state[1].cast<double>(), orbit_numbers(p), orbit_numbers(v));
          }));

  m.def(
      "signal_path",
      [](const SampledOrbit& orbit, const RealArray<"t_s">& t, const Table<"p_e">& p, const Table<"v_e">& v,
         const RealArray<"ahead_s">& ahead, bool gradient) {
        const std::size_t n = t.size();
        orbit_columns(p, "p_e", n);
        orbit_columns(v, "v_e", n);
        if (ahead.size() != n) throw std::invalid_argument("ahead_s: a number for each time expected");
        constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
        std::vector<double> numbers(3 * n, kNan);
        std::vector<double> source_p(3 * n, kNan), source_v(3 * n, kNan), u(3 * n, kNan);
        std::vector<double> derivatives(gradient ? 11 * n : 0, kNan);
        {
          const py::gil_scoped_release release;
          geometry::SignalPath path;
          geometry::PathGradient g;
          for (std::size_t i = 0; i < n; ++i) {
            if (gradient) {
              if (!geometry::signal_path(orbit, t[i], orbit_row(p, i), orbit_row(v, i), path, g, ahead[i])) continue;
              double* out = derivatives.data() + 11 * i;
              std::copy_n(g.delay_p.data(), 3, out);
              std::copy_n(g.rate_p.data(), 3, out + 3);
              std::copy_n(g.rate_v.data(), 3, out + 6);
              out[9] = g.delay_ahead;
              out[10] = g.rate_ahead;
            } else if (!geometry::signal_path(orbit, t[i], orbit_row(p, i), orbit_row(v, i), path, ahead[i])) {
              continue;
            }
            numbers[3 * i] = path.delay_s;
            numbers[3 * i + 1] = path.delay_rate;
            numbers[3 * i + 2] = path.range_m;
            std::copy_n(path.source_p_e.data(), 3, source_p.data() + 3 * i);
            std::copy_n(path.source_v_e.data(), 3, source_v.data() + 3 * i);
            std::copy_n(path.direction_e.data(), 3, u.data() + 3 * i);
          }
        }
        const auto rows = static_cast<py::ssize_t>(n);
        const py::ssize_t columns = gradient ? 11 : 0;
        return py::make_tuple(to_array(std::move(numbers), {rows, 3}), to_array(std::move(source_p), {rows, 3}),
                              to_array(std::move(source_v), {rows, 3}), to_array(std::move(u), {rows, 3}),
                              to_array(std::move(derivatives), {rows, columns}));
      },
      py::arg("orbit"), py::arg("t_s"), py::arg("p_e"), py::arg("v_e"), py::arg("ahead_s"), py::arg("gradient"),
      "Rows of delay, rate, range; source position; source velocity; direction; derivatives. NaN where there is no "
      "path.");

  m.def(
      "look_at",
      [](const std::vector<const SampledOrbit*>& orbits, const RealArray<"t_s">& t, const RealArray<"p_e">& p) {
        if (p.size() != 3) throw std::invalid_argument("p_e: three numbers expected");
        const auto place = geometry::ecef_to_geodetic({p[0], p[1], p[2]});
        if (!place) throw std::invalid_argument("p_e: no place on the Earth");
        std::vector<double> out(3 * orbits.size() * t.size(), std::numeric_limits<double>::quiet_NaN());
        {
          const py::gil_scoped_release release;
          const geometry::LocalFrame frame(*place);
          geometry::Direction seen;
          std::size_t row = 0;
          for (const SampledOrbit* orbit : orbits) {
            for (std::size_t i = 0; i < t.size(); ++i, ++row) {
              if (!geometry::look_at(*orbit, t[i], frame, seen)) continue;
              out[3 * row] = seen.azimuth_rad;
              out[3 * row + 1] = seen.elevation_rad;
              out[3 * row + 2] = seen.range_m;
            }
          }
        }
        return to_array(std::move(out),
                        {static_cast<py::ssize_t>(orbits.size()), static_cast<py::ssize_t>(t.size()), 3});
      },
      py::arg("orbits"), py::arg("t_s"), py::arg("p_e"),
      "Azimuth, elevation [rad], range [m] of each orbit at each time, shape (orbits, times, 3); NaN outside samples.");

  m.def("gmst82", &geometry::gmst82_rad, py::arg("jd_ut1"), py::arg("fraction"),
        "Greenwich mean sidereal time (IAU 1982) [rad] at a Julian date of UT1 in two parts.");
  m.def(
      "teme_to_ecef",
      [](double day, const RealArray<"fraction">& fraction, const Table<"position_m">& p,
         const Table<"velocity_mps">& v) {
        const std::size_t n = fraction.size();
        orbit_columns(p, "position_m", n);
        orbit_columns(v, "velocity_mps", n);
        std::vector<double> p_e(3 * n), v_e(3 * n);
        for (std::size_t i = 0; i < n; ++i) {
          const OrbitState s = geometry::teme_to_ecef(day, fraction[i], orbit_row(p, i), orbit_row(v, i));
          std::copy_n(s.p_e.data(), 3, p_e.data() + 3 * i);
          std::copy_n(s.v_e.data(), 3, v_e.data() + 3 * i);
        }
        const auto rows = static_cast<py::ssize_t>(n);
        return py::make_tuple(to_array(std::move(p_e), {rows, 3}), to_array(std::move(v_e), {rows, 3}));
      },
      py::arg("jd_ut1"), py::arg("fraction"), py::arg("position_m"), py::arg("velocity_mps"),
      "Rows of SGP4's frame in ECEF; Julian dates jd_ut1 + fraction. Polar motion is left out.");

  py::class_<WalkerConstellation>(m, "WalkerConstellation", "Circular orbits in evenly spaced planes.")
      .def_static("delta", &WalkerConstellation::delta, py::arg("total"), py::arg("planes"), py::arg("phasing"),
                  py::arg("inclination_rad"), py::arg("altitude_m"))
      .def_static("star", &WalkerConstellation::star, py::arg("total"), py::arg("planes"), py::arg("phasing"),
                  py::arg("inclination_rad"), py::arg("altitude_m"))
      .def_static("iridium", &WalkerConstellation::iridium)
      .def(
          "sampled",
          [](WalkerConstellation shape, double start_s, double duration_s, double step_s, double gmst_rad,
             double first_node_rad, double first_phase_rad) {
            shape.first_node_rad = first_node_rad;
            shape.first_phase_rad = first_phase_rad;
            if (!(duration_s > 0.0)) throw std::invalid_argument("duration_s: a positive number expected");
            std::vector<SampledOrbit> made;
            for (const geometry::J2Orbit& orbit : shape.orbits(0.0, gmst_rad)) {
              made.push_back(orbit.sampled(start_s - step_s, duration_s + 2.0 * step_s, step_s));
            }
            return made;
          },
          py::arg("start_s"), py::arg("duration_s"), py::arg("step_s"), py::arg("gmst_rad"), py::arg("first_node_rad"),
          py::arg("first_phase_rad"), "A sampled orbit for each satellite, a step longer at both ends.");
}

void register_doppler_fix(py::module_& m) {
  using navigation::DopplerStatus;
  using navigation::DopplerUse;
  py::native_enum<DopplerStatus>(m, "DopplerStatus", "enum.Enum", "How a fix from Dopplers ended.")
      .value("CONVERGED", DopplerStatus::kConverged)
      .value("AMBIGUOUS", DopplerStatus::kAmbiguous)
      .value("TOO_FEW_ROWS", DopplerStatus::kTooFewRows)
      .value("TOO_FEW_SATELLITES", DopplerStatus::kTooFewSatellites)
      .value("TOO_MANY_SATELLITES", DopplerStatus::kTooManySatellites)
      .value("RANK_DEFICIENT", DopplerStatus::kRankDeficient)
      .value("NOT_CONVERGED", DopplerStatus::kNotConverged)
      .finalize();
  py::native_enum<DopplerUse>(m, "DopplerUse", "enum.IntEnum", "What a fix did with a Doppler.")
      .value("USED", DopplerUse::kUsed)
      .value("NOT_FINITE", DopplerUse::kNotFinite)
      .value("BAD_SIGMA", DopplerUse::kBadSigma)
      .value("STALE", DopplerUse::kStale)
      .finalize();
  m.def(
      "doppler_fix",
      [](const Table<"rows">& table, const py::kwargs& arguments) {
        if (table.columns() != 12) throw std::invalid_argument("rows: twelve columns expected");
        std::vector<navigation::DopplerRow> rows(table.rows());
        for (std::size_t i = 0; i < rows.size(); ++i) {
          const auto c = table.row(i);
          rows[i] = {c[0], static_cast<int>(c[1]), c[2], c[3], {c[4], c[5], c[6]}, {c[7], c[8], c[9]}, c[10], c[11]};
        }
        navigation::DopplerFixOptions options;
        const auto number = [&](const char* name, double& value) {
          if (arguments.contains(name)) value = arguments[name].cast<double>();
        };
        const auto vector = [&](const char* name) -> std::optional<Eigen::Vector3d> {
          if (!arguments.contains(name) || arguments[name].is_none()) return std::nullopt;
          const Numbers<"start_e_m, velocity_e_mps"> v(arguments[name]);
          if (v.span().size() != 3) throw std::invalid_argument(std::string(name) + ": three numbers expected");
          return Eigen::Vector3d(v.span()[0], v.span()[1], v.span()[2]);
        };
        number("carrier_hz", options.carrier_hz);
        number("height_sigma_m", options.height_sigma_m);
        number("frequency_bias_sigma_hz", options.frequency_bias_sigma_hz);
        number("frequency_drift_sigma_hz_per_s", options.frequency_drift_sigma_hz_per_s);
        number("satellite_bias_sigma_hz", options.satellite_bias_sigma_hz);
        number("max_age_s", options.max_age_s);
        number("mask_rad", options.mask_rad);
        number("ambiguity_gate", options.ambiguity_gate);
        if (!arguments["height_m"].is_none()) options.height_m = arguments["height_m"].cast<double>();
        options.estimate_sigma = arguments["estimate_sigma"].cast<bool>();
        options.search = arguments["search"].cast<bool>();
        options.max_iterations = arguments["max_iterations"].cast<int>();
        options.source_instant = arguments["at_sending"].cast<bool>() ? navigation::SourceInstant::kSending
                                                                      : navigation::SourceInstant::kReception;
        options.start_p_e = vector("start_e_m");
        if (const auto v = vector("velocity_e_mps")) options.velocity_e = *v;
        navigation::DopplerFix fix;
        {
          const py::gil_scoped_release release;
          fix = navigation::doppler_fix(rows, options);
        }
        py::dict out;
        out["status"] = fix.status;
        const auto three = [](const double* v) { return to_array(std::vector<double>(v, v + 3)); };
        out["position_e_m"] = three(fix.position_e.data());
        out["latitude_rad"] = fix.place.latitude_rad;
        out["longitude_rad"] = fix.place.longitude_rad;
        out["height_m"] = fix.place.height_m;
        const double* c = fix.covariance_enu.data();
        out["covariance_enu_m2"] = to_array(std::vector<double>(c, c + 9), {3, 3});
        out["sigma_2d_m"] = fix.sigma_2d_m;
        out["frequency_bias_hz"] = fix.frequency_bias_hz;
        out["frequency_bias_sigma_hz"] = fix.frequency_bias_sigma_hz;
        out["frequency_drift_hz_per_s"] = fix.frequency_drift_hz_per_s;
        out["frequency_drift_sigma_hz_per_s"] = fix.frequency_drift_sigma_hz_per_s;
        out["reference_s"] = fix.reference_s;
        out["sigma_scale"] = fix.sigma_scale;
        out["chi_square"] = fix.chi_square;
        out["degrees_of_freedom"] = fix.degrees_of_freedom;
        std::vector<double> satellites;
        for (const navigation::DopplerSatellite& s : fix.satellites) {
          satellites.insert(satellites.end(), {static_cast<double>(s.satellite), static_cast<double>(s.rows), s.bias_hz,
                                               s.bias_sigma_hz, s.along_track_m, s.along_track_sigma_m});
        }
        out["satellites"] = to_array(std::move(satellites), {static_cast<py::ssize_t>(fix.satellites.size()), 6});
        std::vector<std::uint8_t> use(fix.use.size());
        std::transform(fix.use.begin(), fix.use.end(), use.begin(),
                       [](DopplerUse u) { return static_cast<std::uint8_t>(u); });
        out["use"] = to_array(std::move(use));
        out["residuals_hz"] = to_array(std::move(fix.residuals_hz));
        std::vector<double> others, excess;
        for (const navigation::DopplerAlternative& a : fix.alternatives) {
          others.insert(others.end(), a.position_e.data(), a.position_e.data() + 3);
          excess.push_back(a.chi_square_excess);
        }
        out["alternatives_e_m"] = to_array(std::move(others), {static_cast<py::ssize_t>(excess.size()), 3});
        out["alternatives_excess"] = to_array(std::move(excess));
        out["bias_chi_square"] = fix.bias_chi_square;
        out["bias_degrees_of_freedom"] = fix.bias_degrees_of_freedom;
        out["bias_probability"] = fix.bias_probability;
        out["iterations"] = fix.iterations;
        return out;
      },
      py::arg("rows"), "Rows of t, satellite, Doppler, sigma, p (3), v (3), along-track sigma, age; see the face.");
}

}  // namespace soopnav::python
