#include <pybind11/complex.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <complex>
#include <cstdint>
#include <stdexcept>
#include <utility>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/simulation/channel.hpp"
#include "soopnav/simulation/path_loss.hpp"

namespace soopnav::python {

namespace {

template <class Compute>
py::array_t<Cf32> without_gil(const Compute& compute) {
  std::vector<Cf32> out;
  {
    const py::gil_scoped_release release;
    out = compute();
  }
  return to_array(std::move(out));
}

std::vector<Cf32> copy_of(IqSpan iq) { return {iq.begin(), iq.end()}; }

}  // namespace

void register_simulation(py::module_& m) {
  m.def(
      "add_awgn",
      [](const IqArray<"iq">& iq, double variance, std::uint64_t seed, std::uint64_t stream) {
        return without_gil([&] {
          auto out = copy_of(iq.span());
          RandomStream random(seed, stream);
          simulation::add_awgn(out, variance, random);
          return out;
        });
      },
      py::arg("iq"), py::arg("variance"), py::kw_only(), py::arg("seed"), py::arg("stream") = 0,
      "iq plus circular white Gaussian noise.");
  m.def(
      "apply_cfo",
      [](const IqArray<"iq">& iq, double cfo_hz, double sample_rate_hz, double phase_rad) {
        return without_gil([&] {
          auto out = copy_of(iq.span());
          simulation::apply_cfo(out, cfo_hz, sample_rate_hz, phase_rad);
          return out;
        });
      },
      py::arg("iq"), py::arg("cfo_hz"), py::arg("sample_rate_hz"), py::kw_only(), py::arg("phase_rad") = 0.0,
      "iq with its carrier moved.");
  m.def(
      "apply_clock_error",
      [](const IqArray<"iq">& iq, double clock_error_ppm) {
        return without_gil([&] { return simulation::apply_clock_error(iq.span(), clock_error_ppm); });
      },
      py::arg("iq"), py::arg("clock_error_ppm"), "iq as sampled from a transmitter whose clock is off.");
  m.def(
      "apply_taps",
      [](const IqArray<"iq">& iq, double sample_rate_hz,
         const std::vector<std::pair<double, std::complex<double>>>& taps) {
        std::vector<simulation::Tap> paths;
        paths.reserve(taps.size());
        for (const auto& [delay_s, gain] : taps) paths.push_back({delay_s, gain});
        return without_gil([&] { return simulation::apply_taps(iq.span(), sample_rate_hz, paths); });
      },
      py::arg("iq"), py::arg("sample_rate_hz"), py::arg("taps"), "iq over several paths.");
  m.def(
      "mean_power", [](const IqArray<"iq">& iq) { return simulation::mean_power(iq.span()); }, py::arg("iq"),
      "Mean of |x|^2.");
  m.def("noise_variance_for_snr", &simulation::noise_variance_for_snr, py::arg("signal_power"), py::arg("snr_db"),
        "Noise variance per sample that stands snr_db below the signal.");
  m.def("noise_variance_for_element_snr", &simulation::noise_variance_for_element_snr, py::arg("snr_db"), py::kw_only(),
        py::arg("element_power") = 1.0, py::arg("transform_gain") = 1.0,
        "Noise variance per sample for an SNR per resource element.");
  m.def("free_space_path_loss_db", &simulation::free_space_path_loss_db, py::arg("distance_m"), py::arg("frequency_hz"),
        "Free-space path loss.");
  m.def("log_distance_path_loss_db", &simulation::log_distance_path_loss_db, py::arg("distance_m"), py::kw_only(),
        py::arg("exponent"), py::arg("reference_distance_m"), py::arg("reference_loss_db"), "Log-distance path loss.");
  m.def("friis_received_power_dbm", &simulation::friis_received_power_dbm, py::kw_only(), py::arg("transmit_power_dbm"),
        py::arg("transmit_gain_dbi") = 0.0, py::arg("receive_gain_dbi") = 0.0, py::arg("distance_m"),
        py::arg("frequency_hz"), "Power received over free space.");
  m.def("thermal_noise_dbm", &simulation::thermal_noise_dbm, py::arg("bandwidth_hz"), py::arg("noise_figure_db") = 0.0,
        "Thermal noise of a receiver.");
}

}  // namespace soopnav::python
