#include <pybind11/native_enum.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/waveform/iridium/burst.hpp"
#include "soopnav/waveform/iridium/channel_plan.hpp"

namespace soopnav::python {

namespace {

py::list iridium_candidates(double received_hz, double max_doppler_hz) {
  std::array<iridium::ChannelCandidate, iridium::kChannels> found;
  const std::size_t n = iridium::channel_candidates(received_hz, found, max_doppler_hz);
  py::list rows;
  for (std::size_t i = 0; i < n; ++i) {
    rows.append(py::make_tuple(found[i].channel, found[i].frequency_hz, found[i].doppler_hz));
  }
  return rows;
}

py::array_t<Cf32> iridium_symbols(const iridium::Burst& burst) {
  std::vector<Cf32> out(burst.size());
  for (std::size_t k = 0; k < out.size(); ++k) out[k] = burst.symbol(k);
  return to_array(std::move(out));
}

void register_iridium_burst(py::module_& m) {
  using iridium::Burst;
  py::native_enum<iridium::BurstKind>(m, "BurstKind", "enum.Enum", "What a burst is made of.")
      .value("RING_ALERT", iridium::BurstKind::kRingAlert, "preamble 64, unique word 12, payload; 20.32 ms at most")
      .value("SIMPLEX", iridium::BurstKind::kSimplex, "as RING_ALERT, on the other simplex channels")
      .value("DUPLEX", iridium::BurstKind::kDuplex, "preamble 16, unique word 12, payload; 8.28 ms at most")
      .value("LONG", iridium::BurstKind::kLong, "payload only, of any length: for simulation")
      .finalize();
  py::native_enum<iridium::BurstDirection>(m, "BurstDirection", "enum.Enum", "Downlink or uplink: preamble and word.")
      .value("DOWNLINK", iridium::BurstDirection::kDownlink)
      .value("UPLINK", iridium::BurstDirection::kUplink)
      .finalize();

  py::class_<Burst>(m, "Burst", "A burst as a function of continuous time.")
      .def(py::init([](const IqArray<"symbols">& symbols) { return Burst(symbols.span()); }), py::arg("symbols"),
           "A burst of given symbols.")
      .def_static(
          "make",
          [](iridium::BurstKind kind, std::uint64_t seed, std::uint64_t stream, double duration_s,
             iridium::BurstDirection direction) {
            return Burst::make(kind, RandomStream(seed, stream), duration_s, direction);
          },
          py::arg("kind"), py::arg("seed"), py::kw_only(), py::arg("stream"), py::arg("duration_s"),
          py::arg("direction"), "A burst of a kind with random payload.")
      .def(
          "evaluate",
          [](const Burst& burst, double t0_s, double dt_s, std::size_t samples, double quadratic_s) {
            std::vector<Cf32> out(samples);
            {
              const py::gil_scoped_release release;
              burst.evaluate(t0_s, dt_s, quadratic_s, out);
            }
            return to_array(std::move(out));
          },
          py::arg("t0_s"), py::arg("dt_s"), py::arg("samples"), py::arg("quadratic_s") = 0.0,
          "complex64 (samples,): the envelope at t0_s + dt_s n + quadratic_s n^2, n = 0 ... samples - 1.")
      .def(
          "at",
          [](const Burst& burst, const Numbers<"t_s">& t_s) {
            std::vector<Cf32> out(t_s.span().size());
            {
              const py::gil_scoped_release release;
              burst.evaluate(t_s.span(), out);
            }
            return to_array(std::move(out), t_s.shape());
          },
          py::arg("t_s"), "complex64, shape of t_s: the envelope at these times, seconds after the burst's start.")
      .def(
          "render",
          [](const Burst& burst, std::size_t samples, double sample_rate_hz, double delay_s, double delay_rate,
             double delay_acceleration, double doppler_hz, double doppler_rate_hz_per_s, double phase_rad,
             double amplitude) {
            const iridium::Arrival arrival{sample_rate_hz,        delay_s,   delay_rate, delay_acceleration, doppler_hz,
                                           doppler_rate_hz_per_s, phase_rad, amplitude};
            arrival.check();
            std::vector<Cf32> out(samples);
            {
              const py::gil_scoped_release release;
              burst.render(arrival, out);
            }
            return to_array(std::move(out));
          },
          py::arg("samples"), py::arg("sample_rate_hz"), py::kw_only(), py::arg("delay_s") = 0.0,
          py::arg("delay_rate") = 0.0, py::arg("delay_acceleration") = 0.0, py::arg("doppler_hz") = 0.0,
          py::arg("doppler_rate_hz_per_s") = 0.0, py::arg("phase_rad") = 0.0, py::arg("amplitude") = 1.0,
          "complex64 (samples,): what a receiver samples: amplitude * s(t - delay(t)) * exp(j phase(t)), t = n /\n"
          "sample_rate_hz, delay(t) = delay_s + delay_rate t + delay_acceleration t^2 / 2 (positive: later, "
          "stretched),\n"
          "phase(t) = phase_rad + 2 pi (doppler_hz t + doppler_rate_hz_per_s t^2 / 2).")
      .def_property_readonly("duration_s", &Burst::duration_s, "Symbols times 40 us.")
      .def_property_readonly("payload_start", &Burst::payload_start, "Symbol with which the payload begins.")
      .def_property_readonly("symbols", &iridium_symbols, "complex64 (n,): the symbols.")
      .def_property_readonly(
          "quadrants",
          [](const Burst& burst) {
            return to_array(std::vector<std::uint8_t>(burst.quadrants().begin(), burst.quadrants().end()));
          },
          "uint8 (n,): q of the symbols exp(j (pi/4 + q pi/2)); empty for a burst of given symbols.")
      .def("__len__", &Burst::size)
      .def("__repr__", [](const Burst& burst) {
        return "<Burst: " + std::to_string(burst.size()) + " symbols, " +
               std::to_string(burst.duration_s() * 1e3).substr(0, 6) + " ms>";
      });

  m.def(
      "pulse",
      [](const Numbers<"t_symbols">& t) {
        std::vector<double> out;
        out.reserve(t.span().size());
        for (const double value : t.span()) out.push_back(iridium::pulse(value));
        return to_array(std::move(out), t.shape());
      },
      py::arg("t_symbols"), "The pulse g at times in symbols.");
  m.def(
      "matched_filter",
      [](const IqArray<"iq">& iq, double sample_rate_hz, double start_s, double frequency_hz, std::size_t symbols) {
        std::vector<Cf32> out(symbols);
        {
          const py::gil_scoped_release release;
          iridium::matched_filter(iq.span(), sample_rate_hz, start_s, frequency_hz, out);
        }
        return to_array(std::move(out));
      },
      py::arg("iq"), py::arg("sample_rate_hz"), py::kw_only(), py::arg("start_s"), py::arg("frequency_hz"),
      py::arg("symbols"), "Symbols by the matched filter.");
}

}  // namespace

void register_iridium(py::module_& m) {
  m.attr("__doc__") = "Iridium: channels, bursts, their detection.";
  m.def("channel_frequency_hz", &iridium::channel_frequency_hz, py::arg("channel"), "Centre of a channel.");
  py::native_enum<iridium::ChannelUse>(m, "ChannelUse", "enum.Enum", "What a channel is for.")
      .value("DUPLEX", iridium::ChannelUse::kDuplex, "traffic and broadcast in both directions")
      .value("RING_ALERT", iridium::ChannelUse::kRingAlert, "simplex: who is called, where the satellite is")
      .value("MESSAGING", iridium::ChannelUse::kMessaging, "simplex: pagers")
      .value("GUARD", iridium::ChannelUse::kGuard, "simplex: kept free")
      .finalize();
  m.def("channel_use", &iridium::channel_use, py::arg("channel"), "What a channel is for.");
  m.def("channel_candidates", &iridium_candidates, py::arg("received_hz"), py::kw_only(), py::arg("max_doppler_hz"),
        "Tuples (channel, its centre, Doppler) of the channels near a carrier, nearest first.");
  register_iridium_burst(m);
}

}  // namespace soopnav::python
