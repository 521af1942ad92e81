#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <cstddef>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <utility>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/waveform/cdma/acquisition.hpp"
#include "soopnav/waveform/cdma/pilot_code.hpp"
#include "soopnav/waveform/cdma/synthesis.hpp"

namespace soopnav::python {

namespace {

// Rows: pn_offset, delay_s, doppler_hz, phase_cycles, cn0_dbhz.
std::vector<cdma::PilotSignal> cdma_signals(const TableBase& rows,
                                            const std::vector<std::vector<std::pair<std::size_t, double>>>& channels) {
  if (rows.rows() > 0 && rows.columns() != 5) throw std::invalid_argument("signals: rows of five numbers expected");
  if (channels.size() != rows.rows()) throw std::invalid_argument("channels: one sequence for each signal expected");
  std::vector<cdma::PilotSignal> signals;
  for (std::size_t i = 0; i < rows.rows(); ++i) {
    const auto row = rows.row(i);
    cdma::PilotSignal& signal = signals.emplace_back();
    signal.pn_offset = row[0] >= 0.0 && row[0] < cdma::kOffsets ? static_cast<int>(row[0]) : -1;
    signal.delay_s = row[1];
    signal.doppler_hz = row[2];
    signal.phase_cycles = row[3];
    signal.cn0_dbhz = row[4];
    for (const auto& [index, power_db] : channels[i]) signal.channels.push_back({index, power_db});
  }
  return signals;
}

py::array_t<Cf32> cdma_synthesize(const Table<"signals">& rows,
                                  const std::vector<std::vector<std::pair<std::size_t, double>>>& channels,
                                  std::size_t samples, double sample_rate_hz, double intermediate_hz, double carrier_hz,
                                  bool filtered, std::uint64_t data_seed, std::uint64_t first,
                                  std::optional<std::uint64_t> seed, std::uint64_t stream) {
  const cdma::PilotGenerator generator(
      cdma_signals(rows, channels), {sample_rate_hz, intermediate_hz, carrier_hz,
                                     filtered ? cdma::ChipShape::kStandard : cdma::ChipShape::kRectangular, data_seed});
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

void register_cdma(py::module_& m) {
  m.def(
      "pilot_code", [](int pn_offset) { return to_array(cdma::pilot_code(pn_offset)); }, py::arg("pn_offset"),
      "One period of a pilot.");
  m.def(
      "baseband_filter",
      []() {
        const auto taps = cdma::baseband_filter();
        return to_array(std::vector<double>(taps.begin(), taps.end()));
      },
      "Taps of the base station's filter.");
  m.def("synthesize", &cdma_synthesize, py::arg("signals"), py::arg("channels"), py::arg("samples"), py::kw_only(),
        py::arg("sample_rate_hz"), py::arg("intermediate_hz"), py::arg("carrier_hz"), py::arg("filtered"),
        py::arg("data_seed"), py::arg("first"), py::arg("seed"), py::arg("stream"), "The sum of pilots.");
  m.def(
      "offset_candidates",
      [](double delay_s, double start_s, double start_error_s, double max_travel_s) {
        std::vector<int> out(cdma::kOffsets);
        out.resize(cdma::offset_candidates(delay_s, start_s, start_error_s, max_travel_s, out));
        return out;
      },
      py::arg("delay_s"), py::kw_only(), py::arg("start_s"), py::arg("start_error_s"), py::arg("max_travel_s"),
      "Offsets that explain a delay.");
  py::class_<cdma::PilotSearcher>(m, "PilotSearcher", "Search for pilots of all offsets.")
      .def(py::init([](double sample_rate_hz, double intermediate_hz, double carrier_hz, double max_doppler_hz,
                       double coherent_s, std::size_t noncoherent, double false_alarm_probability,
                       std::size_t max_pilots) {
             return cdma::PilotSearcher({sample_rate_hz, intermediate_hz, carrier_hz, max_doppler_hz, coherent_s,
                                         noncoherent, false_alarm_probability, max_pilots});
           }),
           py::kw_only(), py::arg("sample_rate_hz"), py::arg("intermediate_hz"), py::arg("carrier_hz"),
           py::arg("max_doppler_hz"), py::arg("coherent_s"), py::arg("noncoherent"), py::arg("false_alarm_probability"),
           py::arg("max_pilots"))
      .def_property_readonly("samples", &cdma::PilotSearcher::samples)
      .def_property_readonly("cells", &cdma::PilotSearcher::cells)
      .def_property_readonly("threshold", &cdma::PilotSearcher::threshold)
      .def_property_readonly("cell_false_alarm", &cdma::PilotSearcher::cell_false_alarm)
      .def(
          "search",
          [](cdma::PilotSearcher& searcher, const IqArray<"iq">& iq) {
            std::vector<double> rows;
            std::size_t count = 0;
            {
              const py::gil_scoped_release release;
              for (const cdma::Acquisition& a : searcher.search(iq.span())) {
                rows.insert(rows.end(), {a.delay_s, a.sigma_delay_s, a.doppler_hz, a.sigma_doppler_hz, a.cn0_dbhz,
                                         a.sigma_cn0_db, a.statistic, static_cast<double>(a.pn_offset), a.excess_s});
                ++count;
              }
            }
            return to_array(std::move(rows), {static_cast<py::ssize_t>(count), 9});
          },
          py::arg("iq"), "Rows of what was found.");
}

}  // namespace soopnav::python
