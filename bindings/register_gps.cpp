#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <cstddef>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/waveform/gps/ca_code.hpp"
#include "soopnav/waveform/gps/synthesis.hpp"
#include "soopnav/waveform/gps/tracking_noise.hpp"

namespace soopnav::python {

namespace {

template <class Of>
py::array_t<double> mapped(const NumbersBase& values, Of of) {
  std::vector<double> out;
  out.reserve(values.span().size());
  for (const double value : values.span()) out.push_back(of(value));
  return to_array(std::move(out), values.shape());
}

// Rows: prn, delay_s, doppler_hz, phase_cycles, cn0_dbhz.
std::vector<gps::SatelliteSignal> signals_of(const TableBase& rows, const std::vector<std::vector<int>>& bits) {
  if (rows.rows() > 0 && rows.columns() != 5) throw std::invalid_argument("signals: rows of five numbers expected");
  if (bits.size() != rows.rows()) throw std::invalid_argument("bits: one sequence for each signal expected");
  std::vector<gps::SatelliteSignal> signals;
  for (std::size_t i = 0; i < rows.rows(); ++i) {
    const auto row = rows.row(i);
    gps::SatelliteSignal& signal = signals.emplace_back();
    signal.prn = row[0] >= 1.0 && row[0] <= gps::kMaxPrn ? static_cast<int>(row[0]) : 0;
    signal.delay_s = row[1];
    signal.doppler_hz = row[2];
    signal.phase_cycles = row[3];
    signal.cn0_dbhz = row[4];
    for (const int bit : bits[i]) signal.bits.push_back(bit == 1 || bit == -1 ? static_cast<std::int8_t>(bit) : 0);
  }
  return signals;
}

py::array_t<Cf32> synthesize(const Table<"signals">& rows, const std::vector<std::vector<int>>& bits,
                             std::size_t samples, double sample_rate_hz, double intermediate_hz, std::uint64_t first,
                             std::optional<std::uint64_t> seed, std::uint64_t stream) {
  const gps::SignalGenerator generator(signals_of(rows, bits), sample_rate_hz, intermediate_hz);
  std::vector<Cf32> out(samples);
  {
    const py::gil_scoped_release release;
    if (seed) {
      generator.render(first, out, RandomStream(*seed, stream));
    } else {
      generator.render(first, out);
    }
  }
  return to_array(std::move(out));
}

}  // namespace

void register_gps(py::module_& m) {
  m.def(
      "ca_code",
      [](int prn) {
        const gps::CaCode code = gps::ca_code(prn);
        return to_array(std::vector<std::int8_t>(code.begin(), code.end()));
      },
      py::arg("prn"), "Chips of a C/A code, +1 and -1.");
  m.def("synthesize", &synthesize, py::arg("signals"), py::arg("bits"), py::arg("samples"), py::kw_only(),
        py::arg("sample_rate_hz"), py::arg("intermediate_hz"), py::arg("first"), py::arg("seed"), py::arg("stream"),
        "The sum of satellites' signals.");
  m.def(
      "phase_sigma_rad",
      [](const Numbers<"cn0_dbhz">& cn0, double bandwidth_hz, double power_fraction, double oscillator_rad,
         double dynamics_rad, double integration_s) {
        const gps::PhaseLoop loop{bandwidth_hz, power_fraction, oscillator_rad, dynamics_rad, integration_s};
        loop.check();
        return mapped(cn0, [&](double c) { return gps::phase_sigma_rad(c, loop); });
      },
      py::arg("cn0_dbhz"), py::kw_only(), py::arg("bandwidth_hz"), py::arg("power_fraction"), py::arg("oscillator_rad"),
      py::arg("dynamics_rad"), py::arg("integration_s"), "Phase noise of a carrier loop.");
  m.def(
      "code_sigma_m",
      [](const Numbers<"cn0_dbhz">& cn0, double bandwidth_hz, double early_late_chips, double integration_s) {
        const gps::CodeLoop loop{bandwidth_hz, early_late_chips, integration_s};
        loop.check();
        return mapped(cn0, [&](double c) { return gps::code_sigma_m(c, loop); });
      },
      py::arg("cn0_dbhz"), py::kw_only(), py::arg("bandwidth_hz"), py::arg("early_late_chips"),
      py::arg("integration_s"), "Noise of a code loop.");
}

}  // namespace soopnav::python
