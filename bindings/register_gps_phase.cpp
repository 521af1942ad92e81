#include <pybind11/native_enum.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <utility>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/gnss/gps_phase.hpp"

namespace soopnav::python {

namespace {

using gnss::PhaseUse;
using gnss::StaticPhaseFix;
using gnss::StaticPhaseStatus;

Eigen::Vector3d gps_phase_vector(const char* name, const RealArrayBase& v) {
  if (v.size() != 3) throw std::invalid_argument(std::string(name) + ": three numbers expected");
  return {v[0], v[1], v[2]};
}

py::array_t<double> gps_phase_matrix(const Eigen::Matrix3d& m) {
  std::vector<double> out;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) out.push_back(m(i, j));
  }
  return to_array(std::move(out), {3, 3});
}

py::dict static_phase(const gnss::EphemerisTable& table, const std::optional<RealArray<"klobuchar">>& klobuchar,
                      const gnss::StaticPhaseOptions& options, const RealArray<"prn">& prn,
                      const RealArray<"week">& week, const RealArray<"time_of_week_s">& second,
                      const Numbers<"code1_m">& code1, const Numbers<"code2_m">& code2,
                      const Numbers<"phase1_cycles">& phase1, const Numbers<"phase2_cycles">& phase2,
                      const Numbers<"lost_lock">& lost) {
  std::vector<int> prns;
  for (std::size_t i = 0; i < prn.size(); ++i) {
    if (!(std::abs(prn[i]) < 1e6)) throw std::invalid_argument("prn: finite numbers expected");
    prns.push_back(static_cast<int>(prn[i]));
  }
  std::vector<std::uint8_t> lock(lost.span().size());
  for (std::size_t m = 0; m < lock.size(); ++m) lock[m] = lost.span()[m] != 0.0 ? 1 : 0;
  std::optional<gnss::Klobuchar> ionosphere;
  if (klobuchar) {
    if (klobuchar->size() != 8) throw std::invalid_argument("klobuchar: eight numbers expected");
    ionosphere.emplace();
    for (std::size_t j = 0; j < 4; ++j) {
      ionosphere->alpha[j] = (*klobuchar)[j];
      ionosphere->beta[j] = (*klobuchar)[4 + j];
    }
  }
  StaticPhaseFix fix;
  {
    const py::gil_scoped_release release;
    fix = gnss::solve_static_phase(
        table, ionosphere,
        {prns, week.span(), second.span(), code1.span(), code2.span(), phase1.span(), phase2.span(), lock}, options);
  }
  const auto n = static_cast<py::ssize_t>(second.size()), s = static_cast<py::ssize_t>(prns.size());
  py::dict out;
  out["status"] = fix.status;
  out["position_m"] = to_array(std::vector<double>{fix.position_e[0], fix.position_e[1], fix.position_e[2]});
  out["covariance_m2"] = gps_phase_matrix(fix.covariance_m2);
  out["formal_m2"] = gps_phase_matrix(fix.formal_m2);
  out["zenith_m"] = fix.zenith_m;
  out["zenith_sigma_m"] = fix.zenith_sigma_m;
  out["phase_rms_m"] = fix.phase_rms_m;
  out["code_rms_m"] = fix.code_rms_m;
  out["phases"] = fix.phases;
  out["codes"] = fix.codes;
  out["rejected"] = fix.rejected;
  out["arcs"] = fix.arcs;
  out["slips"] = fix.slips;
  out["clock_m"] = to_array(std::move(fix.clock_m));
  out["clock_sigma_m"] = to_array(std::move(fix.clock_sigma_m));
  out["range_error_m"] = to_array(std::move(fix.range_error_m));
  out["range_error_sigma_m"] = to_array(std::move(fix.range_error_sigma_m));
  out["range_error_rate_mps"] = to_array(std::move(fix.range_error_rate_mps));
  const auto grid = [&out, n, s](const char* name, auto& values) {
    if (values.size() != static_cast<std::size_t>(n * s)) values.resize(static_cast<std::size_t>(n * s));
    out[name] = to_array(std::move(values), {n, s});
  };
  grid("phase_residual_m", fix.phase_residual_m);
  grid("code_residual_m", fix.code_residual_m);
  grid("elevation_rad", fix.elevation_rad);
  grid("azimuth_rad", fix.azimuth_rad);
  grid("use", fix.use);
  grid("arc", fix.arc);
  grid("phase_m", fix.phase_m);
  grid("code_m", fix.code_m);
  grid("phase_correction_m", fix.phase_correction_m);
  grid("code_correction_m", fix.code_correction_m);
  grid("satellite_clock_m", fix.satellite_clock_m);
  out["satellite_e_m"] = to_array(std::move(fix.satellite_e), {n, s, 3});
  return out;
}

}  // namespace

void register_gps_phase(py::module_& m) {
  py::native_enum<PhaseUse>(m, "PhaseUse", "enum.IntEnum", "What became of a satellite's phase.")
      .value("USED", PhaseUse::kUsed)
      .value("MISSING", PhaseUse::kMissing)
      .value("PARTIAL", PhaseUse::kPartial)
      .value("NO_EPHEMERIS", PhaseUse::kNoEphemeris)
      .value("UNHEALTHY", PhaseUse::kUnhealthy)
      .value("LOW", PhaseUse::kLow)
      .value("SHORT_ARC", PhaseUse::kShortArc)
      .value("REJECTED", PhaseUse::kRejected)
      .value("NO_CLOCK", PhaseUse::kNoClock)
      .finalize();
  py::native_enum<StaticPhaseStatus>(m, "StaticPhaseStatus", "enum.IntEnum", "How a solution ended.")
      .value("SOLVED", StaticPhaseStatus::kSolved)
      .value("TOO_FEW_SATELLITES", StaticPhaseStatus::kTooFewSatellites)
      .value("TOO_SHORT", StaticPhaseStatus::kTooShort)
      .value("RANK_DEFICIENT", StaticPhaseStatus::kRankDeficient)
      .value("TOO_MANY_ARCS", StaticPhaseStatus::kTooManyArcs)
      .finalize();
  py::class_<gnss::StaticPhaseOptions>(m, "StaticPhaseOptions", "What a standing antenna's solution assumes.")
      .def(py::init([](bool dual, double elevation_mask_rad, double code_sigma_m, double phase_sigma_m,
                       double phase_correlation_s, double range_error_sigma_m, double range_error_rate_mps,
                       double zenith_sigma_m, double relative_humidity, double max_gap_s, double slip_m,
                       int min_arc_epochs, bool wind_up, double max_age_s) {
             const gnss::StaticPhaseOptions options{.dual = dual,
                                                    .elevation_mask_rad = elevation_mask_rad,
                                                    .code_sigma_m = code_sigma_m,
                                                    .phase_sigma_m = phase_sigma_m,
                                                    .phase_correlation_s = phase_correlation_s,
                                                    .range_error_sigma_m = range_error_sigma_m,
                                                    .range_error_rate_mps = range_error_rate_mps,
                                                    .zenith_sigma_m = zenith_sigma_m,
                                                    .relative_humidity = relative_humidity,
                                                    .max_gap_s = max_gap_s,
                                                    .slip_m = slip_m,
                                                    .min_arc_epochs = min_arc_epochs,
                                                    .wind_up = wind_up,
                                                    .max_age_s = max_age_s};
             options.check();
             return options;
           }),
           py::kw_only(), py::arg("dual"), py::arg("elevation_mask_rad"), py::arg("code_sigma_m"),
           py::arg("phase_sigma_m"), py::arg("phase_correlation_s"), py::arg("range_error_sigma_m"),
           py::arg("range_error_rate_mps"), py::arg("zenith_sigma_m"), py::arg("relative_humidity"),
           py::arg("max_gap_s"), py::arg("slip_m"), py::arg("min_arc_epochs"), py::arg("wind_up"),
           py::arg("max_age_s"));
  m.def("static_phase", &static_phase, py::arg("table"), py::arg("klobuchar"), py::arg("options"), py::arg("prn"),
        py::arg("week"), py::arg("time_of_week_s"), py::arg("code1_m"), py::arg("code2_m"), py::arg("phase1_cycles"),
        py::arg("phase2_cycles"), py::arg("lost_lock"), "The solution by name.");
  m.def(
      "phase_wind_up",
      [](const RealArray<"satellite_m">& satellite, const RealArray<"receiver_m">& receiver, double week,
         double time_of_week_s, double before) {
        const Epoch t = std::abs(week) < 1e6 ? gnss::gps_epoch(static_cast<std::int64_t>(week), time_of_week_s)
                                             : Epoch::invalid(TimeScale::kGps);
        return gnss::phase_wind_up_cycles(gps_phase_vector("satellite_m", satellite), gnss::sun_direction_e(t),
                                          gps_phase_vector("receiver_m", receiver), before);
      },
      py::arg("satellite_m"), py::arg("receiver_m"), py::arg("week"), py::arg("time_of_week_s"), py::arg("before"),
      "Cycles, or None.");
}

}  // namespace soopnav::python
