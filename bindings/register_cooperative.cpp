#include <pybind11/native_enum.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "array.hpp"
#include "cooperative_options.hpp"
#include "register.hpp"

namespace soopnav::python {

using navigation::CooperativeOptions;
using navigation::CooperativeTracker;
using navigation::PairBeacon;
using navigation::PairForm;
using navigation::PairMeasurement;
using navigation::PairSquare;
using navigation::PairStart;
using navigation::PairStartOptions;
using navigation::PairUse;
using navigation::PairVector;

namespace {

// Reads each option it is asked for; what nobody asked for is an error.
class PairKeywords {
 public:
  explicit PairKeywords(const py::dict& given) : given_(given) {}
  template <class T>
  void operator()(const char* name, T& value) {
    known_.emplace_back(name);
    if (!given_.contains(name)) return;
    try {
      value = given_[name].cast<T>();
    } catch (const py::cast_error&) {
      throw std::invalid_argument(std::string(name) + ": a value of another kind expected, got " +
                                  py::repr(given_[name]).cast<std::string>());
    }
  }
  void operator()(const char* name, clock::ClockNoise& noise) {
    std::pair<double, double> densities{noise.white_frequency_m2ps, noise.frequency_walk_m2ps3};
    (*this)(name, densities);
    noise = {densities.first, densities.second};
  }
  void done() const {
    for (const auto& item : given_) {
      const auto name = item.first.cast<std::string>();
      if (std::find(known_.begin(), known_.end(), name) != known_.end()) continue;
      std::string text = name + ": no such option; known are ";
      for (const std::string& k : known_) text += (&k == known_.data() ? "" : ", ") + k;
      throw std::invalid_argument(text);
    }
  }

 private:
  const py::dict& given_;
  std::vector<std::string> known_;
};

Eigen::Vector3d pair_point(const std::vector<double>& v, const char* name) {
  if (v.size() != 3) throw std::invalid_argument(std::string(name) + ": three numbers expected");
  return {v[0], v[1], v[2]};
}

PairStartOptions search_options(const py::dict& given, bool whole) {
  PairStartOptions o;
  PairKeywords read(given);
  if (whole) {
    read("clock_noise", o.clock_noise);
    read("acceleration_psd_m2ps3", o.acceleration_psd_m2ps3);
    read("velocity_sigma_mps", o.velocity_sigma_mps);
    read("height_m", o.height_m);
    read("height_sigma_m", o.height_sigma_m);
    read("mask_rad", o.mask_rad);
    read("anchor_drift_mps", o.anchor_drift_mps);
    read("orbit_sigma_m", o.orbit_sigma_m);
  }
  std::vector<double> guess;
  read("guess_p_e", guess);
  if (!guess.empty()) o.guess_p_e = pair_point(guess, "guess_p_e");
  read("search_radius_m", o.search_radius_m);
  read("cell_m", o.cell_m);
  read("candidates", o.candidates);
  read("min_bursts", o.min_bursts);
  read("ambiguous_chi_square", o.ambiguous_chi_square);
  read("alpha_sigma_mps", o.alpha_sigma_mps);
  read("max_sigma_m", o.max_sigma_m);
  read.done();
  return o;
}

py::array_t<double> pair_array(const double* data, std::size_t n, std::vector<py::ssize_t> shape) {
  return to_array(std::vector<double>(data, data + n), std::move(shape));
}
py::array_t<double> mean_array(const PairVector& x) { return pair_array(x.data(), 8, {8}); }
py::array_t<double> covariance_array(const PairSquare& P) { return pair_array(P.data(), 64, {8, 8}); }

PairVector mean_from(const RealArrayBase& numbers) {
  if (numbers.size() != 8) {
    throw std::invalid_argument("mean: eight numbers p, v, theta, alpha expected, got " +
                                std::to_string(numbers.size()));
  }
  return Eigen::Map<const PairVector>(numbers.span().data());
}
PairSquare covariance_from(const TableBase& table) {
  if (table.rows() != 8 || table.columns() != 8) throw std::invalid_argument("covariance: shape (8, 8) expected");
  return Eigen::Map<const Eigen::Matrix<double, 8, 8, Eigen::RowMajor>>(table.row(0).data());
}

// One row of what a run leaves.
struct RunRows {
  std::vector<double> mean, covariance, innovation, nis, variance;
  std::vector<std::int64_t> use;
  explicit RunRows(std::size_t n) {
    mean.reserve(8 * n);
    covariance.reserve(64 * n);
    innovation.reserve(2 * n);
    variance.reserve(4 * n);
    nis.reserve(n);
    use.reserve(n);
  }
  void add(const navigation::PairReport& report, const navigation::PairEstimate& now) {
    mean.insert(mean.end(), now.mean.data(), now.mean.data() + 8);
    covariance.insert(covariance.end(), now.covariance.data(), now.covariance.data() + 64);
    innovation.insert(innovation.end(), report.innovation.data(), report.innovation.data() + 2);
    variance.insert(variance.end(), report.covariance.data(), report.covariance.data() + 4);
    nis.push_back(report.nis);
    use.push_back(static_cast<std::int64_t>(report.use));
  }
  py::tuple arrays() {
    const auto n = static_cast<py::ssize_t>(nis.size());
    return py::make_tuple(to_array(std::move(mean), {n, 8}), to_array(std::move(covariance), {n, 8, 8}),
                          to_array(std::move(innovation), {n, 2}), to_array(std::move(variance), {n, 2, 2}),
                          to_array(std::move(nis)), to_array(std::move(use)));
  }
};

void register_pair_results(py::module_& m) {
  py::native_enum<PairUse>(m, "PairUse", "enum.Enum", "What became of a burst.")
      .value("ACCEPTED", PairUse::kAccepted)
      .value("GATED", PairUse::kGated)
      .value("BELOW_HORIZON", PairUse::kBelowHorizon)
      .value("OUTSIDE_EPHEMERIS", PairUse::kOutsideEphemeris)
      .value("NOT_FINITE", PairUse::kNotFinite)
      .value("NOT_ADVANCING", PairUse::kNotAdvancing)
      .value("UNKNOWN_BEACON", PairUse::kUnknownBeacon)
      .value("BAD_COVARIANCE", PairUse::kBadCovariance)
      .value("NOT_STARTED", PairUse::kNotStarted)
      .value("CLOCK_JUMP", PairUse::kClockJump)
      .value("FREQUENCY_JUMP", PairUse::kFrequencyJump)
      .value("BAD_STATE", PairUse::kBadState)
      .finalize();
  using navigation::PairStartStatus;
  py::native_enum<PairStartStatus>(m, "PairStartStatus", "enum.Enum", "How a start from a batch of bursts ended.")
      .value("FOUND", PairStartStatus::kFound)
      .value("AMBIGUOUS", PairStartStatus::kAmbiguous)
      .value("VAGUE", PairStartStatus::kVague)
      .value("POOR_FIT", PairStartStatus::kPoorFit)
      .value("NOT_CONVERGED", PairStartStatus::kNotConverged)
      .value("NO_VIEW", PairStartStatus::kNoView)
      .value("TOO_FEW", PairStartStatus::kTooFew)
      .finalize();
  py::class_<PairStart>(m, "PairStart", "What a start from a batch of bursts found. Read-only; NaN where nothing.")
      .def_readonly("status", &PairStart::status, "How it ended.")
      .def_readonly("t_s", &PairStart::t_s, "Time of the last burst, which the solution is of.")
      .def_property_readonly(
          "mean", [](const PairStart& s) { return mean_array(s.best.mean); },
          "p, v (ECEF), theta, alpha [m, m/s]; shape (8,).")
      .def_property_readonly(
          "covariance", [](const PairStart& s) { return covariance_array(s.best.covariance); }, "Shape (8, 8).")
      .def_property_readonly(
          "chi_square", [](const PairStart& s) { return s.best.chi_square; }, "Of the residuals.")
      .def_readonly("degrees_of_freedom", &PairStart::degrees_of_freedom, "Of it.")
      .def_property_readonly(
          "alternatives",
          [](const PairStart& s) {
            std::vector<double> out;
            for (const auto& other : s.alternatives) {
              out.insert(out.end(), other.mean.data(), other.mean.data() + 8);
            }
            return to_array(std::move(out), {static_cast<py::ssize_t>(s.alternatives.size()), 8});
          },
          "Means of other places that fit as well, best first; shape (k, 8).")
      .def_readonly("cells", &PairStart::cells, "Of the grid that see the beacons.")
      .def_readonly("iterations", &PairStart::iterations, "Linearisations of the best.")
      .def_property_readonly(
          "used",
          [](const PairStart& s) {
            std::vector<std::uint8_t> used = s.used;
            return to_array(std::move(used)).attr("astype")("bool");
          },
          "Which measurements are in the solution; shape (n,).")
      .def_property_readonly("ok", &PairStart::ok, "Found, and no other place fits.")
      .def("__repr__", [](const PairStart& s) {
        const auto used = std::count(s.used.begin(), s.used.end(), std::uint8_t{1});
        return "PairStart(" + std::string(to_string(s.status)) + ", " + std::to_string(used) + " of " +
               std::to_string(s.used.size()) + " bursts, " + std::to_string(s.alternatives.size()) + " alternatives)";
      });
}

}  // namespace

std::vector<PairBeacon> pair_beacons(const py::list& orbits, std::span<const double> epoch_s) {
  if (!epoch_s.empty() && epoch_s.size() != orbits.size()) {
    throw std::invalid_argument("epoch_s: one number for each of " + std::to_string(orbits.size()) +
                                " beacons expected, got " + std::to_string(epoch_s.size()));
  }
  std::vector<PairBeacon> beacons;
  for (std::size_t i = 0; i < orbits.size(); ++i) {
    try {
      beacons.push_back({orbits[i].cast<geometry::SampledOrbit>(),
                         epoch_s.empty() ? std::numeric_limits<double>::quiet_NaN() : epoch_s[i]});
    } catch (const py::cast_error&) {
      throw std::invalid_argument("beacons: number " + std::to_string(i) +
                                  " is no SampledOrbit: " + py::repr(orbits[i]).cast<std::string>());
    }
  }
  return beacons;
}

CooperativeOptions pair_options(const py::dict& given) {
  CooperativeOptions o;
  PairKeywords read(given);
  read("target_clock", o.target_clock);
  read("anchor_clock", o.anchor_clock);
  read("acceleration_psd_m2ps3", o.acceleration_psd_m2ps3);
  read("velocity_sigma_mps", o.velocity_sigma_mps);
  bool information = false;
  read("information_form", information);
  o.form = information ? PairForm::kInformation : PairForm::kJoseph;
  read("iterations", o.iterations);
  read("gate_probability", o.gate_probability);
  read("mask_rad", o.mask_rad);
  read("anchor_drift_mps", o.anchor_drift_mps);
  read("height_m", o.height_m);
  read("height_sigma_m", o.height_sigma_m);
  std::vector<std::vector<double>> road;
  read("road_p_e", road);
  for (const auto& point : road) o.road_p_e.push_back(pair_point(point, "road_p_e"));
  read("road_sigma_m", o.road_sigma_m);
  read("orbit_sigma_m", o.orbit_sigma_m);
  read("orbit_sigma_mps", o.orbit_sigma_mps);
  read("along_track_states", o.along_track_states);
  read("forget_after_s", o.forget_after_s);
  read("jump_after", o.jump_after);
  read("smoother_capacity", o.smoother_capacity);
  read.done();
  return o;
}

PairMeasurement pair_measurement(std::span<const double> row) {
  PairMeasurement m;
  m.t_s = row[0];
  m.tdoa_s = row[1];
  m.fdoa_hz = row[2];
  m.covariance << row[3], row[4], row[5], row[6];
  m.carrier_hz = row[7];
  m.anchor_p_e << row[8], row[9], row[10];
  m.anchor_v_e << row[11], row[12], row[13];
  m.beacon = std::abs(row[14]) < 1e9 ? static_cast<int>(row[14]) : -1;
  return m;
}

std::vector<PairMeasurement> pair_measurements(const TableBase& table) {
  if (table.columns() != kPairColumns && table.rows() > 0) {
    throw std::invalid_argument("bursts: 15 columns expected, got " + std::to_string(table.columns()));
  }
  std::vector<PairMeasurement> out;
  out.reserve(table.rows());
  for (std::size_t i = 0; i < table.rows(); ++i) out.push_back(pair_measurement(table.row(i)));
  return out;
}

void register_cooperative(py::module_& m) {
  register_pair_results(m);
  py::class_<CooperativeTracker>(m, "CooperativeTracker", "A target's place and clock from bursts an anchor heard too.")
      .def(py::init([](const py::list& orbits, const RealArray<"epoch_s">& epoch_s, const py::dict& options) {
             return CooperativeTracker(pair_beacons(orbits, epoch_s.span()), pair_options(options));
           }),
           py::arg("beacons"), py::arg("epoch_s"), py::arg("options"))
      .def(
          "start_at",
          [](CooperativeTracker& self, double t_s, const RealArray<"mean">& mean, const Table<"covariance">& P) {
            self.start_at(t_s, mean_from(mean), covariance_from(P));
          },
          py::arg("t_s"), py::arg("mean"), py::arg("covariance"), "From a known mean and covariance.")
      .def(
          "start",
          [](CooperativeTracker& self, const Table<"bursts">& bursts, const py::dict& search) {
            const auto measurements = pair_measurements(bursts);
            const PairStartOptions options = search_options(search, false);
            const py::gil_scoped_release release;
            return self.start(measurements, options);
          },
          py::arg("bursts"), py::arg("search"), "From bursts alone.")
      .def(
          "run",
          [](CooperativeTracker& self, const Table<"bursts">& bursts) {
            const auto measurements = pair_measurements(bursts);
            RunRows rows(measurements.size());
            {
              const py::gil_scoped_release release;
              for (const PairMeasurement& measurement : measurements) {
                const auto report = self.update(measurement);
                rows.add(report, self.estimate());
              }
            }
            return rows.arrays();
          },
          py::arg("bursts"), "Each burst in turn.")
      .def("coast", &CooperativeTracker::coast, py::arg("t_s"), "To a time without a burst.")
      .def(
          "estimate",
          [](const CooperativeTracker& self) {
            const auto now = self.estimate();
            return py::make_tuple(now.t_s, mean_array(now.mean), covariance_array(now.covariance), now.silent_s);
          },
          "Time, mean, covariance, seconds since a burst was accepted.")
      .def_property_readonly("started", &CooperativeTracker::started, "Whether there is an estimate.")
      .def_property_readonly(
          "counts",
          [](const CooperativeTracker& self) { return std::vector<long>(self.counts().begin(), self.counts().end()); },
          "How often each PairUse occurred.")
      .def(
          "along_track",
          [](const CooperativeTracker& self, int beacon) -> py::object {
            double mean = 0.0, sigma = 0.0;
            if (!self.along_track(beacon, mean, sigma)) return py::none();
            return py::make_tuple(mean, sigma);
          },
          py::arg("beacon"), "Along-track error of a beacon and its deviation [m]; None when not estimated.")
      .def(
          "smooth",
          [](CooperativeTracker& self) {
            const SmoothStatus status = self.smooth();
            const auto states = self.smoothed();
            std::vector<double> mean, covariance, t(self.smoothed_t_s().begin(), self.smoothed_t_s().end());
            for (const auto& state : states) {
              mean.insert(mean.end(), state.state.x.data(), state.state.x.data() + 8);
              covariance.insert(covariance.end(), state.P.data(), state.P.data() + 64);
            }
            const auto n = static_cast<py::ssize_t>(states.size());
            return py::make_tuple(std::string(to_string(status)), to_array(std::move(t)),
                                  to_array(std::move(mean), {n, 8}), to_array(std::move(covariance), {n, 8, 8}));
          },
          "Fixed-interval smoothing.");
  m.def(
      "start_pair",
      [](const py::list& orbits, const Table<"bursts">& bursts, const py::dict& search) {
        std::vector<geometry::SampledOrbit> beacons;
        for (auto& beacon : pair_beacons(orbits, {})) beacons.push_back(std::move(beacon.orbit));
        const auto measurements = pair_measurements(bursts);
        const PairStartOptions options = search_options(search, true);
        const py::gil_scoped_release release;
        return navigation::start_pair(beacons, measurements, options);
      },
      py::arg("beacons"), py::arg("bursts"), py::arg("search"), "A target's place and clock from bursts alone.");
  m.def(
      "pair_geometry",
      [](const geometry::SampledOrbit& beacon, const Table<"bursts">& bursts, const Table<"mean">& means,
         const RealArray<"along_track_m">& along, double anchor_drift_mps) {
        const auto measurements = pair_measurements(bursts);
        if (means.rows() != measurements.size() || means.columns() != 8 || along.size() != measurements.size()) {
          throw std::invalid_argument("mean: a row of eight numbers for each burst expected");
        }
        std::vector<double> value(2 * measurements.size(), std::numeric_limits<double>::quiet_NaN());
        {
          const py::gil_scoped_release release;
          for (std::size_t i = 0; i < measurements.size(); ++i) {
            const PairMeasurement& b = measurements[i];
            const Eigen::Map<const PairVector> x(means.row(i).data());
            navigation::PairGeometry g;
            if (!navigation::pair_geometry(beacon, b.t_s, {x.head<3>(), x.segment<3>(3)}, {b.anchor_p_e, b.anchor_v_e},
                                           x[6], x[7], anchor_drift_mps, along[i], g)) {
              continue;
            }
            value[2 * i] = g.value[0] / kSpeedOfLightMps;
            value[2 * i + 1] = -g.value[1] * b.carrier_hz / kSpeedOfLightMps;
          }
        }
        return to_array(std::move(value), {static_cast<py::ssize_t>(measurements.size()), 2});
      },
      py::arg("beacon"), py::arg("bursts"), py::arg("mean"), py::arg("along_track_m"), py::arg("anchor_drift_mps"),
      "TDOA [s] and FDOA [Hz] that the model expects.");
}

}  // namespace soopnav::python
