#include <pybind11/complex.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <complex>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "array.hpp"
#include "indoor.hpp"
#include "soopnav/simulation/channel_sounder.hpp"

namespace soopnav::python {

namespace {

using simulation::ChannelEmulator;
using simulation::ChannelSounder;
using simulation::EmulatorOptions;
using simulation::SounderOptions;
using Gains = py::array_t<std::complex<double>, py::array::c_style | py::array::forcecast>;
using TapLists = std::vector<std::vector<std::pair<double, std::complex<double>>>>;

std::span<const std::complex<double>> gains_of(const Gains& gains) {
  return {gains.data(), static_cast<std::size_t>(gains.size())};
}

// Ports of all places, then slot by slot: place after place, port after port.
py::tuple record_all(ChannelSounder& sounder, const std::vector<TapLists>& places, std::uint64_t first_slot) {
  const std::size_t ports = places.empty() ? 0 : places.front().size();
  const std::size_t lines = sounder.line_hz().size();
  std::vector<std::complex<double>> out(places.size() * ports * lines);
  std::vector<double> times;
  std::vector<std::int64_t> clipped;
  std::vector<std::uint8_t> finite;
  {
    const py::gil_scoped_release release;
    std::uint64_t slot = first_slot;
    for (std::size_t i = 0; i < places.size(); ++i) {
      if (places[i].size() != ports) throw std::invalid_argument("channels: every place needs as many ports");
      std::vector<std::vector<simulation::Tap>> taps(ports);
      for (std::size_t p = 0; p < ports; ++p) {
        for (const auto& [delay_s, gain] : places[i][p]) taps[p].push_back({delay_s, gain});
      }
      for (std::size_t p = 0; p < ports; ++p, ++slot) {
        const auto report = sounder.record(taps, p, slot, std::span(out).subspan((i * ports + p) * lines, lines));
        times.push_back(report.time_s);
        clipped.push_back(static_cast<std::int64_t>(report.clipped));
        finite.push_back(report.finite ? 1 : 0);
      }
    }
  }
  const auto n = static_cast<py::ssize_t>(places.size()), l = static_cast<py::ssize_t>(ports);
  return py::make_tuple(to_array(std::move(out), {n, l, static_cast<py::ssize_t>(lines)}),
                        to_array(std::move(times), {n, l}), to_array(std::move(clipped), {n, l}),
                        to_array(std::move(finite), {n, l}));
}

py::array_t<std::complex<double>> emulate_all(const ChannelEmulator& emulator, const Gains& lines) {
  if (lines.ndim() != 2) throw std::invalid_argument("lines: shape (n, lines) expected");
  const auto n = static_cast<std::size_t>(lines.shape(0)), size = static_cast<std::size_t>(lines.shape(1));
  const std::size_t taps = emulator.delays_s().size();
  std::vector<std::complex<double>> out(n * taps);
  const auto in = gains_of(lines);
  {
    const py::gil_scoped_release release;
    for (std::size_t i = 0; i < n; ++i) {
      if (!emulator.taps(in.subspan(i * size, size), std::span(out).subspan(i * taps, taps))) {
        std::fill_n(out.begin() + static_cast<std::ptrdiff_t>(i * taps), taps, std::complex<double>(std::nan(""), 0.0));
      }
    }
  }
  return to_array(std::move(out), {static_cast<py::ssize_t>(n), static_cast<py::ssize_t>(taps)});
}

}  // namespace

void register_sounding(py::module_& m) {
  py::class_<ChannelSounder>(m, "ChannelSounder", "Pulse transmitter with switched ports, and its receiver.")
      .def(py::init([](double pulse_s, double rise_s, double period_s, double sample_rate_hz, double if_hz,
                       double filter_hz, int averages, int calibration_averages, double snr_db, double reference_gain,
                       int adc_bits, double headroom, double guard_s, double switch_time_s, double isolation_db,
                       double phase_noise_rad, bool shared_reference, double clock_rad_per_sqrt_s, std::uint64_t seed) {
             SounderOptions o;
             o.pulse_s = pulse_s;
             o.rise_s = rise_s;
             o.period_s = period_s;
             o.sample_rate_hz = sample_rate_hz;
             o.if_hz = if_hz;
             o.filter_hz = filter_hz;
             o.averages = averages;
             o.calibration_averages = calibration_averages;
             o.snr_db = snr_db;
             o.reference_gain = reference_gain;
             o.adc_bits = adc_bits;
             o.headroom = headroom;
             o.guard_s = guard_s;
             o.switch_time_s = switch_time_s;
             o.isolation_db = isolation_db;
             o.phase_noise_rad = phase_noise_rad;
             o.shared_reference = shared_reference;
             o.clock_rad_per_sqrt_s = clock_rad_per_sqrt_s;
             o.seed = seed;
             return ChannelSounder(o);
           }),
           py::kw_only(), py::arg("pulse_s"), py::arg("rise_s"), py::arg("period_s"), py::arg("sample_rate_hz"),
           py::arg("if_hz"), py::arg("filter_hz"), py::arg("averages"), py::arg("calibration_averages"),
           py::arg("snr_db"), py::arg("reference_gain"), py::arg("adc_bits"), py::arg("headroom"), py::arg("guard_s"),
           py::arg("switch_time_s"), py::arg("isolation_db"), py::arg("phase_noise_rad"), py::arg("shared_reference"),
           py::arg("clock_rad_per_sqrt_s"), py::arg("seed"))
      .def_property_readonly(
          "line_hz",
          [](const ChannelSounder& s) { return to_array(std::vector<double>(s.line_hz().begin(), s.line_hz().end())); },
          "Frequencies of the lines.")
      .def_property_readonly(
          "lines",
          [](const ChannelSounder& s) {
            return to_array(std::vector<std::complex<double>>(s.lines().begin(), s.lines().end()));
          },
          "Pulse and filter at each line.")
      .def_property_readonly("slot_s", &ChannelSounder::slot_s, "Guard and averages.")
      .def("line_noise_variance", &ChannelSounder::line_noise_variance, py::arg("averages"), "Of a recorded line.")
      .def("record", &record_all, py::arg("channels"), py::arg("first_slot") = 0,
           "Lines, times, clipped samples and whether finite, of each place and port.")
      .def(
          "calibrate",
          [](ChannelSounder& sounder) {
            std::vector<std::complex<double>> lines(sounder.line_hz().size());
            std::size_t clipped = 0;
            {
              const py::gil_scoped_release release;
              clipped = sounder.calibrate(lines).clipped;
            }
            return py::make_tuple(to_array(std::move(lines)), clipped);
          },
          "Lines over a cable, and clipped samples.");
  m.def(
      "step_sweep",
      [](const Gains& channel, int averages, double snr_db, double reference_gain, int adc_bits, double headroom,
         bool reference_channel, std::uint64_t seed) {
        if (channel.ndim() != 2) throw std::invalid_argument("channel: shape (places, tones) expected");
        const simulation::SweepOptions options{averages, snr_db, reference_gain, adc_bits, headroom, reference_channel};
        std::vector<std::complex<double>> out(static_cast<std::size_t>(channel.size()));
        const auto in = gains_of(channel);
        const auto tones = static_cast<std::size_t>(channel.shape(1));
        {
          const py::gil_scoped_release release;
          simulation::step_sweep(in, tones, options, seed, out);
        }
        return to_array(std::move(out), {channel.shape(0), channel.shape(1)});
      },
      py::arg("channel"), py::kw_only(), py::arg("averages"), py::arg("snr_db"), py::arg("reference_gain"),
      py::arg("adc_bits"), py::arg("headroom"), py::arg("reference_channel"), py::arg("seed"),
      "Gains that a stepped tone measures.");
  py::class_<ChannelEmulator>(m, "ChannelEmulator", "Channels of any bandwidth from recorded lines.")
      .def(py::init([](const RealArray<"line_hz">& line_hz, const Gains& reference, double bandwidth_hz,
                       double delay_low_s, double delay_high_s, double null_db, double noise_to_signal) {
             const EmulatorOptions options{bandwidth_hz, delay_low_s, delay_high_s, null_db, noise_to_signal};
             const py::gil_scoped_release release;
             return ChannelEmulator(line_hz.span(), gains_of(reference), options);
           }),
           py::arg("line_hz"), py::arg("reference"), py::kw_only(), py::arg("bandwidth_hz"), py::arg("delay_low_s"),
           py::arg("delay_high_s"), py::arg("null_db"), py::arg("noise_to_signal"))
      .def_property_readonly(
          "delays_s",
          [](const ChannelEmulator& e) {
            return to_array(std::vector<double>(e.delays_s().begin(), e.delays_s().end()));
          },
          "Of the taps.")
      .def_property_readonly(
          "nulls_hz",
          [](const ChannelEmulator& e) {
            return to_array(std::vector<double>(e.nulls_hz().begin(), e.nulls_hz().end()));
          },
          "Lines that are not divided by.")
      .def_property_readonly("lines_used", &ChannelEmulator::lines_used, "Lines that the taps are fitted to.")
      .def_property_readonly("covered", &ChannelEmulator::covered, "The usable lines reach both ends of the band.")
      .def(
          "sigma",
          [](const ChannelEmulator& e, const RealArray<"frequencies_hz">& f) {
            std::vector<double> out;
            for (const double at : f.span()) out.push_back(e.sigma(at));
            return to_array(std::move(out));
          },
          py::arg("frequencies_hz"), "Relative 1-sigma of the channel.")
      .def("taps", &emulate_all, py::arg("lines"), "Gains of the taps; NaN where lines are not finite.");
}

}  // namespace soopnav::python
