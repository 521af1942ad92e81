#include <pybind11/complex.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <array>
#include <complex>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/waveform/tracking/loop.hpp"
#include "soopnav/waveform/tracking/tracker.hpp"

namespace soopnav::python {

namespace {

constexpr std::size_t kTrackingColumns = 19;

// An epoch's numbers, in the façade's order.
void append_epoch(std::vector<double>& rows, const tracking::Epoch& e) {
  const std::array<double, kTrackingColumns> row{e.t_s,
                                                 e.carrier_phase_cycles,
                                                 e.carrier_phase_sigma_cycles,
                                                 e.delay_s,
                                                 e.delay_sigma_s,
                                                 e.doppler_hz,
                                                 e.doppler_sigma_hz,
                                                 e.cn0_hz,
                                                 e.cn0_sigma_hz,
                                                 e.cn0_dbhz,
                                                 e.loop_t_s,
                                                 e.loop_phase_cycles,
                                                 e.phase_lock,
                                                 e.prompt.real(),
                                                 e.prompt.imag(),
                                                 static_cast<double>(e.arc),
                                                 static_cast<double>(e.bad_samples),
                                                 static_cast<double>(e.state),
                                                 (e.phase_locked ? 1.0 : 0.0) + (e.code_locked ? 2.0 : 0.0)};
  rows.insert(rows.end(), row.begin(), row.end());
}

}  // namespace

void register_tracking(py::module_& m) {
  m.def(
      "design_loop",
      [](int order, double bandwidth_hz, double interval_s) {
        return tracking::design_loop(order, bandwidth_hz, interval_s).gain;
      },
      py::arg("order"), py::arg("bandwidth_hz"), py::arg("interval_s"), "Gains of a loop.");
  m.def(
      "loop_variance",
      [](int order, double bandwidth_hz, double interval_s, double mean_variance, double white, double walk) {
        const tracking::Loop loop = tracking::design_loop(order, bandwidth_hz, interval_s);
        const tracking::LoopVariance thermal = tracking::noise_variance(loop, mean_variance);
        const tracking::LoopVariance oscillator = tracking::oscillator_variance(loop, {white, walk});
        return std::array<double, 4>{thermal.phase, oscillator.phase, thermal.rate, oscillator.rate};
      },
      py::arg("order"), py::arg("bandwidth_hz"), py::arg("interval_s"), py::kw_only(), py::arg("mean_variance"),
      py::arg("white"), py::arg("walk"), "Variances of a settled loop.");
  m.def(
      "phase_noise",
      [](double h0, double h_minus_2, double carrier_hz) {
        const tracking::PhaseNoise noise = tracking::PhaseNoise::from_allan(h0, h_minus_2, carrier_hz);
        return std::pair(noise.white_frequency_cycles2ps, noise.frequency_walk_cycles2ps3);
      },
      py::arg("h0"), py::arg("h_minus_2"), py::arg("carrier_hz"), "Densities of an oscillator's phase.");
  m.def(
      "window_variance",
      [](double white, double walk, double s) {
        return tracking::window_variance({white, walk}, s);
      },
      py::arg("white"), py::arg("walk"), py::arg("window_s"), "Mean of a window against its middle.");
  m.def("phase_variance", &tracking::phase_variance, py::arg("cn0_hz"), py::arg("interval_s"), "Thermal phase noise.");
  m.def("costas_phase_variance", &tracking::costas_phase_variance, py::arg("cn0_hz"), py::arg("interval_s"),
        py::arg("integration_s"), "The same with data wiped by themselves.");
  m.def("code_variance", &tracking::code_variance, py::arg("cn0_hz"), py::arg("interval_s"), py::arg("integration_s"),
        py::arg("spacing_chips"), "Thermal code noise.");
  py::class_<tracking::Tracker>(m, "Tracker", "Tracks one signal.")
      .def(py::init([](const IqArray<"chips">& chips, double chip_rate_hz, double carrier_hz, double symbol_s,
                       double code_slope, double sample_rate_hz, double intermediate_hz, double delay_s,
                       double doppler_hz, double integration_s, double pll_bandwidth_hz, int pll_order,
                       double dll_bandwidth_hz, double early_late_chips, double epoch_s, double pull_in_s,
                       double pull_in_integration_s, double pull_in_bandwidth_hz, double fll_bandwidth_hz,
                       bool symbol_known, double loss_s) {
             const tracking::Signal signal{
                 {chips.span().begin(), chips.span().end()}, chip_rate_hz, carrier_hz, symbol_s, code_slope};
             return std::make_unique<tracking::Tracker>(
                 signal, tracking::TrackerOptions{sample_rate_hz, intermediate_hz, delay_s, doppler_hz, integration_s,
                                                  pll_bandwidth_hz, pll_order, dll_bandwidth_hz, early_late_chips,
                                                  epoch_s, pull_in_s, pull_in_integration_s, pull_in_bandwidth_hz,
                                                  fll_bandwidth_hz, symbol_known, loss_s});
           }),
           py::arg("chips"), py::kw_only(), py::arg("chip_rate_hz"), py::arg("carrier_hz"), py::arg("symbol_s"),
           py::arg("code_slope"), py::arg("sample_rate_hz"), py::arg("intermediate_hz"), py::arg("delay_s"),
           py::arg("doppler_hz"), py::arg("integration_s"), py::arg("pll_bandwidth_hz"), py::arg("pll_order"),
           py::arg("dll_bandwidth_hz"), py::arg("early_late_chips"), py::arg("epoch_s"), py::arg("pull_in_s"),
           py::arg("pull_in_integration_s"), py::arg("pull_in_bandwidth_hz"), py::arg("fll_bandwidth_hz"),
           py::arg("symbol_known"), py::arg("loss_s"))
      .def_property_readonly("state", [](const tracking::Tracker& t) { return static_cast<int>(t.state()); })
      .def_property_readonly("samples", &tracking::Tracker::samples)
      .def(
          "push",
          [](tracking::Tracker& tracker, const IqArray<"iq">& iq) {
            std::vector<double> rows;
            {
              const py::gil_scoped_release release;
              tracker.push(iq.span(), [&](const tracking::Epoch& e) { append_epoch(rows, e); });
            }
            const auto count = static_cast<py::ssize_t>(rows.size() / kTrackingColumns);
            return to_array(std::move(rows), {count, static_cast<py::ssize_t>(kTrackingColumns)});
          },
          py::arg("iq"), "Rows of the epochs that are complete.");
}

}  // namespace soopnav::python
