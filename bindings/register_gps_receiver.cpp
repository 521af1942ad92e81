#include <pybind11/complex.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <complex>
#include <cstddef>
#include <cstdint>
#include <span>
#include <stdexcept>
#include <utility>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/waveform/gps/acquisition.hpp"
#include "soopnav/waveform/gps/aided_correlator.hpp"

namespace soopnav::python {

namespace {

using gps::Acquirer;
using gps::AidedCorrelator;

py::tuple acquisition_row(const gps::Acquisition& a) {
  return py::make_tuple(a.prn, static_cast<int>(a.status), a.delay_s, a.doppler_hz, a.cn0_dbhz, a.statistic, a.bin,
                        a.sample);
}

py::list acquire_all(Acquirer& acquirer, const IqArray<"iq">& iq, const std::vector<int>& prns) {
  std::vector<gps::Acquisition> found;
  {
    const py::gil_scoped_release release;
    for (const int prn : prns) found.push_back(acquirer.search(iq.span(), prn));
  }
  py::list rows;
  for (const gps::Acquisition& a : found) rows.append(acquisition_row(a));
  return rows;
}

using ComplexSums = py::array_t<std::complex<double>, py::array::c_style | py::array::forcecast>;

py::array_t<double> frequencies_of(const ComplexSums& sums, double block_s, double variance, double first_hz,
                                   double step_hz, std::size_t count, std::size_t coherent_blocks) {
  if (sums.ndim() != 2) throw py::value_error("sums: shape (blocks, codes) expected");
  const auto codes = static_cast<std::size_t>(sums.shape(1));
  const std::span<const std::complex<double>> all(sums.data(), static_cast<std::size_t>(sums.size()));
  std::vector<double> out(codes * count);
  bool done = false;
  {
    const py::gil_scoped_release release;
    done = gps::search_frequencies(all, codes, block_s, variance, {first_hz, step_hz, count}, coherent_blocks, out);
  }
  if (!done) {
    throw py::value_error(
        "sums, block_s, variance, frequencies and coherent_blocks: finite numbers, a positive block and variance, at "
        "least one frequency and one whole coherent sum expected");
  }
  return to_array(std::move(out), {static_cast<py::ssize_t>(codes), static_cast<py::ssize_t>(count)});
}

}  // namespace

void register_gps_receiver(py::module_& m) {
  py::class_<Acquirer>(m, "Acquirer", "Searches samples for satellites' codes.")
      .def(py::init([](double sample_rate_hz, double intermediate_hz, int coherent_ms, int noncoherent,
                       double min_doppler_hz, double max_doppler_hz, double doppler_step_hz,
                       double false_alarm_probability, double noise_variance) {
             return Acquirer({.sample_rate_hz = sample_rate_hz,
                              .intermediate_hz = intermediate_hz,
                              .coherent_ms = coherent_ms,
                              .noncoherent = noncoherent,
                              .min_doppler_hz = min_doppler_hz,
                              .max_doppler_hz = max_doppler_hz,
                              .doppler_step_hz = doppler_step_hz,
                              .false_alarm_probability = false_alarm_probability,
                              .noise_variance = noise_variance});
           }),
           py::kw_only(), py::arg("sample_rate_hz"), py::arg("intermediate_hz"), py::arg("coherent_ms"),
           py::arg("noncoherent"), py::arg("min_doppler_hz"), py::arg("max_doppler_hz"), py::arg("doppler_step_hz"),
           py::arg("false_alarm_probability"), py::arg("noise_variance"))
      .def_property_readonly("samples", &Acquirer::samples)
      .def_property_readonly("delays", &Acquirer::delays)
      .def_property_readonly("dopplers", &Acquirer::dopplers)
      .def_property_readonly("cells", &Acquirer::cells)
      .def_property_readonly("cell_false_alarm", &Acquirer::cell_false_alarm)
      .def_property_readonly("threshold", &Acquirer::threshold)
      .def("doppler_hz", &Acquirer::doppler_hz, py::arg("bin"), "Of a row of the surface.")
      .def("search", &acquire_all, py::arg("iq"), py::arg("prns"), "Rows of (prn, status, delay_s, doppler_hz, ...).")
      .def(
          "surface",
          [](const Acquirer& acquirer) {
            const auto all = acquirer.surface();
            return to_array(std::vector<float>(all.begin(), all.end()), {static_cast<py::ssize_t>(acquirer.dopplers()),
                                                                         static_cast<py::ssize_t>(acquirer.delays())});
          },
          "Statistics of the last search, a row for each Doppler.");
  m.def("cell_loss", &gps::cell_loss, py::arg("delay_error_chips"), py::arg("doppler_error_hz"), py::arg("coherent_s"),
        "Share of a signal's power in a cell that is off.");
  py::class_<AidedCorrelator>(m, "AidedCorrelator", "Correlates a weak satellite with what is predicted of it.")
      .def(py::init([](int prn, double sample_rate_hz, double intermediate_hz, double block_s, std::size_t max_blocks,
                       int half_chips, const std::vector<int>& bits) {
             gps::AidedOptions options{.sample_rate_hz = sample_rate_hz,
                                       .intermediate_hz = intermediate_hz,
                                       .block_s = block_s,
                                       .max_blocks = max_blocks,
                                       .half_chips = half_chips};
             for (const int bit : bits) {
               options.bits.push_back(bit == 1 || bit == -1 ? static_cast<std::int8_t>(bit) : std::int8_t{0});
             }
             return AidedCorrelator(prn, options);
           }),
           py::arg("prn"), py::kw_only(), py::arg("sample_rate_hz"), py::arg("intermediate_hz"), py::arg("block_s"),
           py::arg("max_blocks"), py::arg("half_chips"), py::arg("bits"))
      .def_property_readonly("block_samples", &AidedCorrelator::block_samples)
      .def_property_readonly("block_s", &AidedCorrelator::block_s)
      .def_property_readonly("codes", &AidedCorrelator::codes)
      .def_property_readonly("blocks", &AidedCorrelator::blocks)
      .def("delay_chips", &AidedCorrelator::delay_chips, py::arg("code"), "Of a column of the sums.")
      .def(
          "push",
          [](AidedCorrelator& correlator, const IqArray<"iq">& iq, double transmit_time_s, double carrier_phase_cycles,
             double doppler_hz, double doppler_rate_hzps) {
            const py::gil_scoped_release release;
            return correlator.push(iq.span(), {.transmit_time_s = transmit_time_s,
                                               .carrier_phase_cycles = carrier_phase_cycles,
                                               .doppler_hz = doppler_hz,
                                               .doppler_rate_hzps = doppler_rate_hzps});
          },
          py::arg("iq"), py::kw_only(), py::arg("transmit_time_s"), py::arg("carrier_phase_cycles"),
          py::arg("doppler_hz"), py::arg("doppler_rate_hzps"), "Takes a block; False when refused.")
      .def(
          "sums",
          [](const AidedCorrelator& correlator) {
            const auto all = correlator.sums();
            return to_array(
                std::vector<std::complex<double>>(all.begin(), all.end()),
                {static_cast<py::ssize_t>(correlator.blocks()), static_cast<py::ssize_t>(correlator.codes())});
          },
          "Sums so far, (blocks, codes).");
  m.def("search_frequencies", &frequencies_of, py::arg("sums"), py::kw_only(), py::arg("block_s"), py::arg("variance"),
        py::arg("first_hz"), py::arg("step_hz"), py::arg("count"), py::arg("coherent_blocks"),
        "Statistics (codes, frequencies) of sums (blocks, codes).");
}

}  // namespace soopnav::python
