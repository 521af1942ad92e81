#include <pybind11/native_enum.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/waveform/iridium/burst.hpp"
#include "soopnav/waveform/iridium/burst_detector.hpp"
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

/// A detector that several Python threads may hold: calls wait for each other.
struct IridiumDetector {
  explicit IridiumDetector(const iridium::DetectorOptions& options) : detector(options) {}
  std::mutex mutex;
  iridium::BurstDetector detector;
};

using IridiumFound = std::vector<iridium::DetectedBurst>;

// In pieces, as one call reports so many at most.
IridiumFound iridium_push(IridiumDetector& self, IqSpan samples, bool end) {
  constexpr std::size_t kPiece = 1 << 20;
  IridiumFound found;
  const py::gil_scoped_release release;
  const std::lock_guard lock(self.mutex);
  while (!samples.empty()) {
    const IqSpan piece = samples.first(std::min(kPiece, samples.size()));
    const auto some = self.detector.push(piece);
    found.insert(found.end(), some.begin(), some.end());
    samples = samples.subspan(piece.size());
  }
  if (end) {
    const auto some = self.detector.flush();
    found.insert(found.end(), some.begin(), some.end());
  }
  return found;
}

const char* iridium_word(iridium::SignalClass kind) {
  switch (kind) {
    case iridium::SignalClass::kTone:
      return "tone";
    case iridium::SignalClass::kContinuous:
      return "continuous";
    default:
      return "burst";
  }
}

std::string iridium_text(const iridium::DetectedBurst& b) {
  std::array<char, 200> text{};
  std::snprintf(text.data(), text.size(), "<DetectedBurst: %s at %.3f ms, %.2f ms, %.6f MHz, %.1f kHz wide, %.1f dB%s>",
                iridium_word(b.kind), b.start_s * 1e3, b.duration_s * 1e3, b.frequency_hz * 1e-6, b.bandwidth_hz * 1e-3,
                b.snr_db, b.cut_start || b.cut_end ? ", cut" : "");
  return text.data();
}

void register_iridium_detector(py::module_& m) {
  using iridium::DetectedBurst;
  py::native_enum<iridium::SignalClass>(m, "SignalClass", "enum.Enum", "What was found in the spectrum.")
      .value("BURST", iridium::SignalClass::kBurst, "begins and ends, with a bandwidth like a burst's")
      .value("TONE", iridium::SignalClass::kTone, "most of its power within 6 kHz: interference")
      .value("CONTINUOUS", iridium::SignalClass::kContinuous, "longer than any burst")
      .finalize();
  py::class_<DetectedBurst>(m, "DetectedBurst", "A signal found in a recording; times from its first sample.")
      .def_readonly("kind", &DetectedBurst::kind)
      .def_readonly("start_s", &DetectedBurst::start_s)
      .def_readonly("duration_s", &DetectedBurst::duration_s)
      .def_readonly("frequency_hz", &DetectedBurst::frequency_hz, "Of the carrier, the centre frequency added.")
      .def_readonly("frequency_sigma_hz", &DetectedBurst::frequency_sigma_hz, "Its standard deviation.")
      .def_readonly("bandwidth_hz", &DetectedBurst::bandwidth_hz, "Of the middle 90 % of the power.")
      .def_readonly("snr_db", &DetectedBurst::snr_db, "Power over the noise's in 25 kHz.")
      .def_readonly("cut_start", &DetectedBurst::cut_start, "It was there when the recording began.")
      .def_readonly("cut_end", &DetectedBurst::cut_end, "It was there when the recording ended, or it got too long.")
      .def_readonly("fine_frequency", &DetectedBurst::fine_frequency,
                    "The carrier comes from the symbols, not from the spectrum's centre of gravity.")
      .def("__repr__", &iridium_text);
  py::class_<IridiumDetector>(m, "BurstDetector", "Finds bursts in a wide band as the samples come.")
      .def(py::init(
               [](double sample_rate_hz, double center_frequency_hz, double false_alarms_per_s, double max_burst_s) {
                 const iridium::DetectorOptions options{sample_rate_hz, center_frequency_hz, false_alarms_per_s,
                                                        max_burst_s};
                 return std::make_unique<IridiumDetector>(options);
               }),
           py::arg("sample_rate_hz"), py::kw_only(), py::arg("center_frequency_hz") = 0.0,
           py::arg("false_alarms_per_s") = 1e-3, py::arg("max_burst_s") = 0.1)
      .def(
          "push", [](IridiumDetector& self, const IqArray<"iq">& iq) { return iridium_push(self, iq.span(), false); },
          py::arg("iq"), "The signals that ended in these samples, in the order of their ends.")
      .def(
          "flush", [](IridiumDetector& self) { return iridium_push(self, {}, true); },
          "Ends the stream: the signals still open.")
      .def_property_readonly(
          "samples", [](const IridiumDetector& self) { return self.detector.samples(); }, "Of the stream so far.")
      .def_property_readonly(
          "rejected_samples", [](const IridiumDetector& self) { return self.detector.rejected_samples(); },
          "Samples that were not finite and counted as zero.")
      .def_property_readonly(
          "dropped", [](const IridiumDetector& self) { return self.detector.dropped(); },
          "Signals that found no place in a report.")
      .def_property_readonly(
          "threshold", [](const IridiumDetector& self) { return self.detector.threshold(); },
          "Of the mean power over noise; 0 while the noise is learnt.");
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
  register_iridium_detector(m);
}

}  // namespace soopnav::python
