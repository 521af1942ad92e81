#include <pybind11/complex.h>
#include <pybind11/eigen.h>
#include <pybind11/native_enum.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <complex>
#include <limits>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "array.hpp"
#include "channel_arrays.hpp"
#include "register.hpp"
#include "soopnav/array/aperture_spectrum.hpp"
#include "soopnav/array/synthetic_aperture.hpp"
#include "soopnav/simulation/aperture_link.hpp"

namespace soopnav::python {

namespace {

using array::ApertureData;
using array::ApertureMethod;
using array::ApertureOptions;
using array::ApertureStatus;
using array::ReceiverPhase;
using array::SyntheticAperture;

template <class T>
py::array_t<T> copied(std::span<const T> values, std::vector<py::ssize_t> shape = {}) {
  return to_array(std::vector<T>(values.begin(), values.end()), std::move(shape));
}

py::array_t<double> copied_square(std::span<const double> values, std::size_t nodes) {
  const auto size = static_cast<py::ssize_t>(values.empty() ? 0 : nodes);
  return copied(values, {size, size});
}

ReceiverPhase phase_of_word(const std::string& word) {
  if (word == "free") return ReceiverPhase::kFree;
  if (word == "random_walk") return ReceiverPhase::kRandomWalk;
  if (word == "known") return ReceiverPhase::kKnown;
  throw std::invalid_argument("phase: \"" + word + "\"; it must be one of \"free\", \"random_walk\", \"known\"");
}

ApertureMethod method_of_word(const std::string& word) {
  if (word == "beamforming") return ApertureMethod::kBeamforming;
  if (word == "music") return ApertureMethod::kMusic;
  throw std::invalid_argument("method: \"" + word + "\"; it must be one of \"beamforming\", \"music\"");
}

void require_columns(const TableBase& table, const char* name, std::size_t columns) {
  if (table.rows() > 0 && table.columns() != columns) {
    throw std::invalid_argument(std::string(name) + ": " + std::to_string(table.columns()) + " columns; " +
                                std::to_string(columns) + " expected");
  }
}

std::span<const double> all_of(const TableBase& table) {
  return table.rows() == 0 ? std::span<const double>{}
                           : std::span<const double>(table.row(0).data(), table.rows() * table.columns());
}

void require_phasors(const ComplexTableBase& phasors, std::size_t n, std::size_t nodes) {
  if (phasors.rows() != n || phasors.columns() != nodes) {
    throw std::invalid_argument("phasors: shape (" + std::to_string(phasors.rows()) + ", " +
                                std::to_string(phasors.columns()) + "); (" + std::to_string(n) + ", " +
                                std::to_string(nodes) + "), a row per time and a column per wavelength, expected");
  }
}

py::dict bearings(SyntheticAperture& self, const ComplexTable<"phasors">& phasors, const Table<"path_m">& path_m,
                  const RealArray<"time_s">& time_s, const RealArray<"wavelength_m">& wavelength_m,
                  const Numbers<"path_modes_m">& path_modes_m) {
  require_columns(path_m, "path_m", 2);
  require_phasors(phasors, time_s.size(), wavelength_m.size());
  const ApertureData data{phasors.values(), all_of(path_m), time_s.span(), wavelength_m.span(), path_modes_m.span()};
  array::ApertureBearings found;
  {
    const py::gil_scoped_release release;
    found = self.estimate(data);
  }
  py::dict out;
  out["status"] = found.status;
  out["index"] = found.index;
  out["straight"] = found.straight;
  out["bearing_rad"] = copied(found.bearing_rad);
  out["alternative_rad"] = copied(found.alternative_rad);
  out["covariance_rad2"] = copied_square(found.covariance_rad2, wavelength_m.size());
  out["frequency_hz"] = copied(found.frequency_hz);
  out["amplitude"] = copied(found.amplitude);
  out["coherence"] = copied(found.coherence);
  out["los"] = copied(found.los);
  out["phase_rad"] = copied(found.phase_rad);
  out["noise_variance"] = found.noise_variance;
  out["gap"] = found.gap;
  out["iterations"] = found.iterations;
  return out;
}

py::dict blind(SyntheticAperture& self, const ComplexTable<"phasors">& phasors, const RealArray<"time_s">& time_s,
               const RealArray<"wavelength_m">& wavelength_m) {
  require_phasors(phasors, time_s.size(), wavelength_m.size());
  const ApertureData data{phasors.values(), {}, time_s.span(), wavelength_m.span(), {}};
  array::BlindAperture found;
  {
    const py::gil_scoped_release release;
    found = self.estimate_blind(data);
  }
  py::dict out;
  out["status"] = found.status;
  out["index"] = found.index;
  out["bearing_rad"] = copied(found.bearing_rad);
  out["covariance_rad2"] = copied_square(found.covariance_rad2, wavelength_m.size());
  out["path_m"] = copied(found.path_m, {static_cast<py::ssize_t>(found.path_m.size() / 2), 2});
  out["noise_variance"] = found.noise_variance;
  out["iterations"] = found.iterations;
  return out;
}

}  // namespace

void register_synthetic_aperture(py::module_& m) {
  py::native_enum<ApertureStatus>(m, "ApertureStatus", "enum.IntEnum", "What an aperture's data allowed.")
      .value("OK", ApertureStatus::kOk)
      .value("TWO_ANSWERS", ApertureStatus::kTwoAnswers)
      .value("SINGULAR", ApertureStatus::kSingular)
      .value("TOO_FEW_NODES", ApertureStatus::kTooFewNodes)
      .value("TOO_FEW_COHERENT", ApertureStatus::kTooFewCoherent)
      .value("TOO_FEW_SNAPSHOTS", ApertureStatus::kTooFewSnapshots)
      .value("STEP_TOO_LONG", ApertureStatus::kStepTooLong)
      .value("PATH_TOO_SHORT", ApertureStatus::kPathTooShort)
      .value("NON_FINITE", ApertureStatus::kNonFinite)
      .value("NO_POWER", ApertureStatus::kNoPower)
      .value("NO_CONVERGENCE", ApertureStatus::kNoConvergence)
      .finalize();

  py::class_<ApertureOptions>(m, "ApertureOptions", "What is unknown about an aperture.")
      .def(py::init([](const std::string& phase, double phase_sigma, bool frequency_offsets, double max_frequency_hz,
                       double path_sigma, double noise_variance, double coherence_threshold, double max_sigma_rad) {
             return ApertureOptions{phase_of_word(phase), phase_sigma,    frequency_offsets,   max_frequency_hz,
                                    path_sigma,           noise_variance, coherence_threshold, max_sigma_rad};
           }),
           py::kw_only(), py::arg("phase") = "free", py::arg("phase_sigma_rad_per_sqrt_s") = 0.0,
           py::arg("frequency_offsets") = true, py::arg("max_frequency_hz") = 0.0,
           py::arg("path_sigma_m_per_sqrt_step") = 0.0, py::arg("noise_variance") = 0.0,
           py::arg("coherence_threshold") = 0.7, py::arg("max_sigma_rad") = 0.6);

  py::class_<SyntheticAperture>(m, "SyntheticAperture", "Bearings from phases along a path.")
      .def(py::init<const ApertureOptions&>(), py::arg("options"))
      .def("bearings", &bearings, py::arg("phasors"), py::arg("path_m"), py::arg("time_s"), py::arg("wavelength_m"),
           py::arg("path_modes_m"), "What the links said, by name.")
      .def("blind", &blind, py::arg("phasors"), py::arg("time_s"), py::arg("wavelength_m"),
           "Angles between nodes without a path, by name.");

  m.def(
      "aperture_crlb",
      [](const Table<"path_m">& path_m, const RealArray<"time_s">& time_s,
         const RealArray<"wavelength_m">& wavelength_m, const RealArray<"bearing_rad">& bearing_rad,
         const RealArray<"snr">& snr, const Numbers<"path_modes_m">& path_modes_m, const ApertureOptions& options) {
        require_columns(path_m, "path_m", 2);
        return array::aperture_crlb({{}, all_of(path_m), time_s.span(), wavelength_m.span(), path_modes_m.span()},
                                    bearing_rad.span(), snr.span(), options);
      },
      py::arg("path_m"), py::arg("time_s"), py::arg("wavelength_m"), py::arg("bearing_rad"), py::arg("snr"),
      py::arg("path_modes_m"), py::arg("options"), "Bound of the bearings' covariance.");

  m.def(
      "aperture_spectrum",
      [](const ComplexTable<"phasors">& phasors, const Table<"path_m">& path_m, double wavelength_m,
         const RealArray<"bearing_rad">& bearing_rad, const std::string& method, std::size_t n_sources,
         std::size_t subaperture) {
        require_columns(path_m, "path_m", 2);
        return to_array(array::aperture_spectrum({phasors.values(), all_of(path_m), wavelength_m, subaperture},
                                                 bearing_rad.span(), method_of_word(method), n_sources));
      },
      py::arg("phasors"), py::arg("path_m"), py::arg("wavelength_m"), py::arg("bearing_rad"), py::arg("method"),
      py::arg("n_sources"), py::arg("subaperture"), "Spectrum over bearings.");
  m.def(
      "aperture_directions",
      [](const ComplexTable<"phasors">& phasors, const Table<"path_m">& path_m, double wavelength_m,
         const std::string& method, std::size_t n_sources, std::size_t subaperture) {
        require_columns(path_m, "path_m", 2);
        return to_array(array::aperture_directions({phasors.values(), all_of(path_m), wavelength_m, subaperture},
                                                   method_of_word(method), n_sources));
      },
      py::arg("phasors"), py::arg("path_m"), py::arg("wavelength_m"), py::arg("method"), py::arg("n_sources"),
      py::arg("subaperture"), "Its highest maxima.");

  m.def(
      "check_bearings",
      [](const RealArray<"bearing_rad">& bearing_rad, const Eigen::MatrixXd& covariance_rad2,
         const Table<"nodes_m">& nodes_m, const Eigen::Vector2d& position_m,
         const Eigen::Matrix2d& position_covariance_m2, double heading_rad, double heading_sigma_rad, double gate) {
        require_columns(nodes_m, "nodes_m", 2);
        auto check = array::check_bearings(bearing_rad.span(), covariance_rad2, all_of(nodes_m), position_m,
                                           position_covariance_m2, heading_rad, heading_sigma_rad, gate);
        py::dict out;
        out["residual_rad"] = to_array(std::move(check.residual_rad));
        out["statistic"] = to_array(std::move(check.statistic));
        out["consistent"] = to_array(std::move(check.consistent));
        out["heading_rad"] = check.heading_rad;
        out["total"] = check.total;
        out["degrees_of_freedom"] = check.degrees_of_freedom;
        return out;
      },
      py::arg("bearing_rad"), py::arg("covariance_rad2"), py::arg("nodes_m"), py::arg("position_m"),
      py::arg("position_covariance_m2"), py::arg("heading_rad"), py::arg("heading_sigma_rad"), py::arg("gate"),
      "Whether bearings point where nodes are.");
}

void register_aperture_link(py::module_& m) {
  m.def(
      "render_aperture",
      [](const RealArray<"bearing_rad">& bearing_rad, const RealArray<"wavelength_m">& wavelength_m,
         const RealArray<"snr">& snr, const RealArray<"k_factor">& k_factor,
         const RealArray<"frequency_hz">& frequency_hz, const Table<"path_m">& path_m,
         const RealArray<"time_s">& time_s, const RealArray<"phase_rad">& phase_rad, int waves, std::uint64_t seed) {
        const std::size_t nodes = bearing_rad.size();
        if (wavelength_m.size() != nodes || snr.size() != nodes || k_factor.size() != nodes ||
            frequency_hz.size() != nodes) {
          throw std::invalid_argument("wavelength_m, snr, k_factor, frequency_hz: one per bearing is expected");
        }
        require_columns(path_m, "path_m", 2);
        std::vector<simulation::ApertureLink> links(nodes);
        for (std::size_t i = 0; i < nodes; ++i) {
          links[i] = {bearing_rad[i], wavelength_m[i], snr[i], k_factor[i], frequency_hz[i], waves};
        }
        std::vector<std::complex<double>> out(time_s.size() * nodes);
        simulation::render_aperture(links, all_of(path_m), time_s.span(), phase_rad.span(), RandomStream(seed), out);
        return to_array(std::move(out), {static_cast<py::ssize_t>(time_s.size()), static_cast<py::ssize_t>(nodes)});
      },
      py::arg("bearing_rad"), py::arg("wavelength_m"), py::arg("snr"), py::arg("k_factor"), py::arg("frequency_hz"),
      py::arg("path_m"), py::arg("time_s"), py::arg("phase_rad"), py::arg("waves"), py::arg("seed"),
      "Phasors of nodes along a path.");
  m.def(
      "drift_path",
      [](const Table<"path_m">& path_m, double sigma_m_per_sqrt_step, std::uint64_t seed) {
        require_columns(path_m, "path_m", 2);
        std::vector<double> out(path_m.rows() * 2);
        simulation::drift_path(all_of(path_m), sigma_m_per_sqrt_step, RandomStream(seed), out);
        return to_array(std::move(out), {static_cast<py::ssize_t>(path_m.rows()), 2});
      },
      py::arg("path_m"), py::arg("sigma_m_per_sqrt_step"), py::arg("seed"), "A path as dead reckoning reports it.");
}

}  // namespace soopnav::python
