#include <pybind11/complex.h>
#include <pybind11/native_enum.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <complex>
#include <cstddef>
#include <span>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/array/calibration.hpp"

namespace soopnav::python {

namespace {

using array::CalibrationReport;
using array::CalibrationStatus;
using array::ChannelCorrection;
using array::ChannelReport;

template <class Read>
auto of_channels(const CalibrationReport& report, const Read& read) {
  std::vector<decltype(read(ChannelReport{}))> out;
  out.reserve(report.channels.size());
  for (const ChannelReport& channel : report.channels) out.push_back(read(channel));
  return to_array(std::move(out));
}

}  // namespace

void register_calibration(py::module_& m) {
  py::native_enum<CalibrationStatus>(m, "CalibrationStatus", "enum.IntEnum", "What became of a calibration.")
      .value("OK", CalibrationStatus::kOk)
      .value("TOO_FEW_SAMPLES", CalibrationStatus::kTooFewSamples)
      .value("NON_FINITE", CalibrationStatus::kNonFinite)
      .value("DEAD_CHANNEL", CalibrationStatus::kDeadChannel)
      .value("WEAK_TONE", CalibrationStatus::kWeakTone)
      .value("SATURATED", CalibrationStatus::kSaturated)
      .value("NO_QUADRATURE", CalibrationStatus::kNoQuadrature)
      .finalize();

  py::class_<CalibrationReport>(m, "CalibrationReport", "What a tone said about the channels; arrays of shape (M,).")
      .def_readonly("status", &CalibrationReport::status)
      .def_readonly("channel", &CalibrationReport::channel, "At fault, or -1.")
      .def_readonly("value", &CalibrationReport::value, "Of what was at fault.")
      .def_readonly("tone_hz", &CalibrationReport::tone_hz)
      .def_readonly("tone_sigma_hz", &CalibrationReport::tone_sigma_hz)
      .def_property_readonly("iq_gain",
                             [](const CalibrationReport& self) {
                               return of_channels(self, [](const ChannelReport& c) { return c.correction.iq_gain; });
                             })
      .def_property_readonly("iq_phase_rad",
                             [](const CalibrationReport& self) {
                               return of_channels(self,
                                                  [](const ChannelReport& c) { return c.correction.iq_phase_rad; });
                             })
      .def_property_readonly("dc",
                             [](const CalibrationReport& self) {
                               return of_channels(self, [](const ChannelReport& c) { return c.correction.dc; });
                             })
      .def_property_readonly("gain",
                             [](const CalibrationReport& self) {
                               return of_channels(self, [](const ChannelReport& c) { return c.correction.gain; });
                             })
      .def_property_readonly("tone_amplitude",
                             [](const CalibrationReport& self) {
                               return of_channels(self, [](const ChannelReport& c) { return c.tone_amplitude; });
                             })
      .def_property_readonly("tone_snr_db",
                             [](const CalibrationReport& self) {
                               return of_channels(self, [](const ChannelReport& c) { return c.tone_snr_db; });
                             })
      .def_property_readonly("residual_rms",
                             [](const CalibrationReport& self) {
                               return of_channels(self, [](const ChannelReport& c) { return c.residual_rms; });
                             })
      .def_property_readonly("image_sigma",
                             [](const CalibrationReport& self) {
                               return of_channels(self, [](const ChannelReport& c) { return c.image_sigma; });
                             })
      .def_property_readonly("phase_sigma_rad",
                             [](const CalibrationReport& self) {
                               return of_channels(self, [](const ChannelReport& c) { return c.phase_sigma_rad; });
                             })
      .def("__repr__", [](const CalibrationReport& self) {
        return "CalibrationReport(" + std::string(array::to_string(self.status)) + ", " +
               std::to_string(self.channels.size()) + " channels)";
      });

  m.def(
      "calibrate",
      [](const IqArray<"iq">& iq, std::size_t channels, double sample_rate_hz, double tone_hz, std::size_t reference,
         double tolerance_hz) {
        const py::gil_scoped_release release;
        return array::calibrate(iq.span(), channels, sample_rate_hz, tone_hz, {reference, tolerance_hz});
      },
      py::arg("iq"), py::arg("channels"), py::arg("sample_rate_hz"), py::arg("tone_hz"), py::kw_only(),
      py::arg("reference") = 0, py::arg("tolerance_hz") = 0.0,
      "Faults of channels from a tone that reaches them alike. iq: the channels' rows one after the other.");
  m.def(
      "apply_correction",
      [](const IqArray<"iq">& iq, const std::vector<double>& iq_gain, const std::vector<double>& iq_phase_rad,
         const std::vector<std::complex<double>>& dc, const std::vector<std::complex<double>>& gain) {
        const std::size_t channels = iq_gain.size();
        if (channels == 0 || iq.span().size() % channels != 0 || iq_phase_rad.size() != channels ||
            dc.size() != channels || gain.size() != channels) {
          throw std::invalid_argument("iq, iq_gain, iq_phase_rad, dc, gain: one per channel is expected");
        }
        std::vector<Cf32> out;
        {
          const py::gil_scoped_release release;
          out.assign(iq.span().begin(), iq.span().end());
          const std::size_t samples = out.size() / channels;
          for (std::size_t c = 0; c < channels; ++c) {
            const ChannelCorrection correction{iq_gain[c], iq_phase_rad[c], dc[c], gain[c]};
            if (!correction.valid()) throw std::invalid_argument("channel " + std::to_string(c) + ": cannot be undone");
            array::apply_correction(correction, std::span(out).subspan(c * samples, samples));
          }
        }
        return to_array(std::move(out));
      },
      py::arg("iq"), py::arg("iq_gain"), py::arg("iq_phase_rad"), py::arg("dc"), py::arg("gain"),
      "Undoes the faults of channels, whose rows lie one after the other.");
}

}  // namespace soopnav::python
