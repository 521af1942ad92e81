#include <pybind11/native_enum.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <cstddef>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/navigation/phase_stitcher.hpp"

namespace soopnav::python {

namespace {

using navigation::BurstStatus;
using navigation::PhaseBurst;
using navigation::PhaseStitcher;
using navigation::StitchedBurst;

// Rows burst, t, phase, sigma, integer, step, posterior, fixed, arc.
constexpr std::size_t kStitchedColumns = 9;

void append_stitched(std::vector<double>& rows, std::span<const StitchedBurst> decided) {
  for (const StitchedBurst& b : decided) {
    rows.insert(rows.end(),
                {static_cast<double>(b.burst), b.t_s, b.phase_cycles, b.sigma_cycles, static_cast<double>(b.integer),
                 static_cast<double>(b.step), b.posterior, b.fixed ? 1.0 : 0.0, static_cast<double>(b.arc)});
  }
}

py::array_t<double> stitched_rows(std::vector<double>&& rows) {
  const auto n = static_cast<py::ssize_t>(rows.size() / kStitchedColumns);
  return to_array(std::move(rows), {n, static_cast<py::ssize_t>(kStitchedColumns)});
}

// Rows t, phase, sigma, frequency, sigma, predicted, predicted rate.
py::tuple stitch_all(PhaseStitcher& stitcher, const Table<"bursts">& bursts) {
  if (bursts.rows() > 0 && bursts.columns() != 7) {
    throw std::invalid_argument("bursts: rows of 7 numbers expected, got " + std::to_string(bursts.columns()));
  }
  std::vector<double> rows;
  std::vector<std::uint8_t> status(bursts.rows());
  {
    const py::gil_scoped_release release;
    rows.reserve((bursts.rows() + stitcher.waiting()) * kStitchedColumns);
    for (std::size_t i = 0; i < bursts.rows(); ++i) {
      const auto r = bursts.row(i);
      status[i] = static_cast<std::uint8_t>(stitcher.push({r[0], r[1], r[2], r[3], r[4], r[5], r[6]}));
      append_stitched(rows, stitcher.decided());
    }
  }
  return py::make_tuple(to_array(std::move(status)), stitched_rows(std::move(rows)));
}

}  // namespace

void register_phase_stitcher(py::module_& m) {
  py::native_enum<BurstStatus>(m, "BurstStatus", "enum.IntEnum", "What became of a burst.")
      .value("ACCEPTED", BurstStatus::kAccepted)
      .value("STARTED", BurstStatus::kStarted)
      .value("NOT_FINITE", BurstStatus::kNotFinite)
      .value("NOT_LATER", BurstStatus::kNotLater)
      .value("OUTLIER", BurstStatus::kOutlier)
      .value("GAP_TOO_LONG", BurstStatus::kGapTooLong)
      .value("LOST", BurstStatus::kLost)
      .finalize();
  py::class_<PhaseStitcher>(m, "PhaseStitcher", "One continuous phase of bursts with random fractions of a cycle.")
      .def(py::init([](int fractions, double wavelength_m, double white_frequency_m2ps, double frequency_walk_m2ps3,
                       double frequency_sigma_hz, double rate_sigma_hzps, double rate_walk_hz2ps3, int decision_bursts,
                       double posterior, int hypotheses, double gate_sigma, int outliers) {
             return PhaseStitcher({.fractions = fractions,
                                   .wavelength_m = wavelength_m,
                                   .clock = {white_frequency_m2ps, frequency_walk_m2ps3},
                                   .frequency_sigma_hz = frequency_sigma_hz,
                                   .rate_sigma_hzps = rate_sigma_hzps,
                                   .rate_walk_hz2ps3 = rate_walk_hz2ps3,
                                   .decision_bursts = decision_bursts,
                                   .posterior = posterior,
                                   .hypotheses = hypotheses,
                                   .gate_sigma = gate_sigma,
                                   .outliers = outliers});
           }),
           py::kw_only(), py::arg("fractions"), py::arg("wavelength_m"), py::arg("white_frequency_m2ps"),
           py::arg("frequency_walk_m2ps3"), py::arg("frequency_sigma_hz"), py::arg("rate_sigma_hzps"),
           py::arg("rate_walk_hz2ps3"), py::arg("decision_bursts"), py::arg("posterior"), py::arg("hypotheses"),
           py::arg("gate_sigma"), py::arg("outliers"))
      .def("push", &stitch_all, py::arg("bursts"), "(statuses, rows decided).")
      .def(
          "finish",
          [](PhaseStitcher& self, bool early) {
            self.finish(early);
            std::vector<double> rows;
            append_stitched(rows, self.decided());
            return stitched_rows(std::move(rows));
          },
          py::arg("early"), "Rows decided.")
      .def_property_readonly("hypotheses", &PhaseStitcher::hypotheses)
      .def_property_readonly("waiting", &PhaseStitcher::waiting)
      .def_property_readonly("posterior", &PhaseStitcher::posterior)
      .def_property_readonly("frequency_error_hz", &PhaseStitcher::frequency_error_hz)
      .def_property_readonly("frequency_error_sigma_hz", &PhaseStitcher::frequency_error_sigma_hz);
}

}  // namespace soopnav::python
