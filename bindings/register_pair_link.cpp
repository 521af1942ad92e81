#include <pybind11/complex.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <complex>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/simulation/channel.hpp"
#include "soopnav/simulation/pair_link.hpp"
#include "soopnav/waveform/iridium/burst.hpp"

namespace soopnav::python {

namespace {

using geometry::SampledOrbit;
using simulation::ClockReading;
using simulation::ClockTrack;
using simulation::EnvelopeView;
using simulation::PairLink;
using simulation::PairReceiver;
using simulation::PairTruth;
using simulation::SampledEnvelope;
using simulation::SampleGrid;
using simulation::Transmission;

using PairWaveform = std::variant<const iridium::Burst*, const SampledEnvelope*>;

/// The pulses at a burst's ends reach 12 symbols beyond it.
EnvelopeView burst_view(const iridium::Burst& burst) {
  constexpr double kOver_s = iridium::Burst::kReach / iridium::kSymbolRateHz;
  return {burst, -kOver_s, burst.duration_s() + kOver_s};
}

EnvelopeView waveform_view(const PairWaveform& waveform) {
  if (const auto* burst = std::get_if<const iridium::Burst*>(&waveform)) return burst_view(**burst);
  return std::get<const SampledEnvelope*>(waveform)->view();
}

[[noreturn]] void pair_outside(std::size_t number) {
  throw std::invalid_argument("beacon: transmission " + std::to_string(number) +
                              " needs an instant outside the samples of its transmitter or of an antenna");
}

using Beacons = std::vector<const SampledOrbit*>;

const SampledOrbit& beacon_at(const Beacons& beacons, std::span<const double> index, std::size_t i) {
  const double number = index[i];
  if (!(number >= 0.0 && number < static_cast<double>(beacons.size()))) {
    throw std::invalid_argument("beacon[" + std::to_string(i) + "] = " + std::to_string(number) + ": one of " +
                                std::to_string(beacons.size()) + " beacons expected");
  }
  return *beacons[static_cast<std::size_t>(number)];
}

void require_pair_size(std::size_t size, std::size_t expected, const char* name) {
  if (size == expected) return;
  throw std::invalid_argument(std::string(name) + ": " + grouped(size) + " numbers; one per transmission, " +
                              grouped(expected) + ", expected");
}

/// Columns of `pair_truth`: one row per transmission.
constexpr std::size_t kTruthColumns = 16;

void truth_row(const PairTruth& truth, double* row) {
  const auto put = [&row](double value) { *row++ = value; };
  put(truth.tdoa_s);
  put(truth.fdoa_hz);
  for (const simulation::Arrival* at : {&truth.target, &truth.anchor}) {
    put(at->t_s);
    put(at->reading_s);
    put(at->frequency_hz);
    put(at->path.delay_s);
    put(at->path.delay_rate);
    put(at->clock.bias_s);
    put(at->clock.drift);
  }
}

py::array_t<double> pair_truth(const PairLink& link, const Beacons& beacons, const RealArray<"beacon">& beacon,
                               const RealArray<"sent_s">& sent_s, const RealArray<"carrier_hz">& carrier_hz) {
  const std::size_t n = sent_s.size();
  require_pair_size(beacon.size(), n, "beacon");
  require_pair_size(carrier_hz.size(), n, "carrier_hz");
  std::vector<double> out(n * kTruthColumns);
  {
    const py::gil_scoped_release release;
    for (std::size_t i = 0; i < n; ++i) {
      PairTruth truth;
      if (!link.truth(beacon_at(beacons, beacon.span(), i), sent_s[i], carrier_hz[i], truth)) pair_outside(i);
      truth_row(truth, out.data() + i * kTruthColumns);
    }
  }
  return to_array(std::move(out), {static_cast<py::ssize_t>(n), static_cast<py::ssize_t>(kTruthColumns)});
}

void add_pair_noise(std::span<Cf32> samples, double variance, RandomStream random) {
  if (variance > 0.0) simulation::add_awgn(samples, variance, random);
}

void require_pair_level(double value, const char* name) {
  if (value >= 0.0 && value < 1e300) return;
  throw std::invalid_argument(std::string(name) + ": " + std::to_string(value) +
                              "; it must be finite and not negative");
}

py::tuple pair_render(const PairLink& link, const PairWaveform& waveform, const SampledOrbit& beacon, double start_s,
                      double carrier_hz, double phase_rad, double target_amplitude, double anchor_amplitude,
                      double target_start_s, std::size_t target_samples, double anchor_start_s,
                      std::size_t anchor_samples, double center_hz, double noise_variance, std::uint64_t seed,
                      std::uint64_t stream) {
  require_pair_level(noise_variance, "noise_variance");
  SampleGrid{0.0, link.sample_rate_hz(), center_hz, 0}.check();
  const EnvelopeView envelope = waveform_view(waveform);
  std::vector<Cf32> target(target_samples), anchor(anchor_samples);
  {
    const py::gil_scoped_release release;
    const Transmission at_target{start_s, carrier_hz, target_amplitude, phase_rad};
    const Transmission at_anchor{start_s, carrier_hz, anchor_amplitude, phase_rad};
    const double rate = link.sample_rate_hz();
    if (!simulation::add_reception(link.target(), envelope, beacon, at_target, {target_start_s, rate, center_hz, 0},
                                   target) ||
        !simulation::add_reception(link.anchor(), envelope, beacon, at_anchor, {anchor_start_s, rate, center_hz, 0},
                                   anchor)) {
      pair_outside(0);
    }
    const RandomStream random(seed, stream);
    add_pair_noise(target, noise_variance, random.substream(0));
    add_pair_noise(anchor, noise_variance, random.substream(1));
  }
  return py::make_tuple(to_array(std::move(target)), to_array(std::move(anchor)));
}

/// Random bursts, one after the other, each in a snippet of its own: payload i from substream (i, 0), noise from (i, 1)
/// and (i, 2) of `seed`.
py::tuple pair_bursts(const PairLink& link, double duration_s, const Beacons& beacons,
                      const RealArray<"beacon">& beacon, const RealArray<"start_s">& start_s,
                      const RealArray<"carrier_hz">& carrier_hz, const RealArray<"target_start_s">& target_start_s,
                      const RealArray<"anchor_start_s">& anchor_start_s, std::size_t samples,
                      const RealArray<"center_hz">& center_hz, const RealArray<"target_amplitude">& target_amplitude,
                      const RealArray<"anchor_amplitude">& anchor_amplitude, double noise_variance, std::uint64_t seed,
                      std::uint64_t stream) {
  const std::size_t n = start_s.size();
  require_pair_level(noise_variance, "noise_variance");
  require_pair_size(beacon.size(), n, "beacon");
  require_pair_size(carrier_hz.size(), n, "carrier_hz");
  require_pair_size(center_hz.size(), n, "center_hz");
  require_pair_size(target_start_s.size(), n, "target_start_s");
  require_pair_size(anchor_start_s.size(), n, "anchor_start_s");
  require_pair_size(target_amplitude.size(), n, "target_amplitude");
  require_pair_size(anchor_amplitude.size(), n, "anchor_amplitude");
  std::vector<Cf32> target(n * samples), anchor(n * samples);
  {
    const py::gil_scoped_release release;
    const double rate = link.sample_rate_hz();
    for (std::size_t i = 0; i < n; ++i) {
      SampleGrid{0.0, rate, center_hz[i], 0}.check();
      const RandomStream random = RandomStream(seed, stream).substream(i);
      const auto burst = iridium::Burst::make(iridium::BurstKind::kLong, random.substream(0), duration_s);
      const EnvelopeView envelope = burst_view(burst);
      const SampledOrbit& orbit = beacon_at(beacons, beacon.span(), i);
      const auto at_target = std::span(target).subspan(i * samples, samples);
      const auto at_anchor = std::span(anchor).subspan(i * samples, samples);
      if (!simulation::add_reception(link.target(), envelope, orbit, {start_s[i], carrier_hz[i], target_amplitude[i]},
                                     {target_start_s[i], rate, center_hz[i], 0}, at_target) ||
          !simulation::add_reception(link.anchor(), envelope, orbit, {start_s[i], carrier_hz[i], anchor_amplitude[i]},
                                     {anchor_start_s[i], rate, center_hz[i], 0}, at_anchor)) {
        pair_outside(i);
      }
      add_pair_noise(at_target, noise_variance, random.substream(1));
      add_pair_noise(at_anchor, noise_variance, random.substream(2));
    }
  }
  const std::vector<py::ssize_t> shape{static_cast<py::ssize_t>(n), static_cast<py::ssize_t>(samples)};
  return py::make_tuple(to_array(std::move(target), shape), to_array(std::move(anchor), shape));
}

void pair_receive(const PairReceiver& receiver, const PairWaveform& waveform, const SampledOrbit& beacon,
                  double start_s, double carrier_hz, double amplitude, double phase_rad, double grid_start_s,
                  double sample_rate_hz, double center_hz, std::int64_t first_sample,
                  py::array_t<Cf32, py::array::c_style>& samples) {
  if (samples.ndim() != 1) throw std::invalid_argument("samples: complex64 of one dimension expected");
  const SampleGrid grid{grid_start_s, sample_rate_hz, center_hz, first_sample};
  grid.check();
  const std::span<Cf32> out(samples.mutable_data(), static_cast<std::size_t>(samples.size()));
  const EnvelopeView envelope = waveform_view(waveform);
  const py::gil_scoped_release release;
  if (!simulation::add_reception(receiver, envelope, beacon, {start_s, carrier_hz, amplitude, phase_rad}, grid, out)) {
    pair_outside(0);
  }
}

std::vector<simulation::Tap> pair_taps(const std::vector<double>& delay_s,
                                       const std::vector<std::complex<double>>& gain) {
  if (delay_s.size() != gain.size()) {
    throw std::invalid_argument("taps: " + grouped(delay_s.size()) + " delays and " + grouped(gain.size()) + " gains");
  }
  std::vector<simulation::Tap> taps(gain.size());
  for (std::size_t i = 0; i < taps.size(); ++i) taps[i] = {delay_s[i], gain[i]};
  return taps;
}

void register_clock_track(py::module_& m) {
  py::class_<ClockTrack>(m, "ClockTrack", "A receiver's clock over system time.")
      .def(
          py::init([](const RealArray<"t_s">& t_s, const RealArray<"bias_s">& bias_s, const RealArray<"drift">& drift) {
            return ClockTrack(t_s.span(), bias_s.span(), drift.span());
          }),
          py::arg("t_s"), py::arg("bias_s"), py::arg("drift"))
      .def_static("steady", &ClockTrack::steady, py::arg("bias_s"), py::arg("drift"), py::arg("epoch_s"))
      .def(
          "at",
          [](const ClockTrack& self, const RealArray<"t_s">& t_s) {
            std::vector<double> bias(t_s.size()), drift(t_s.size());
            for (std::size_t i = 0; i < t_s.size(); ++i) {
              const ClockReading reading = self.at(t_s[i]);
              bias[i] = reading.bias_s;
              drift[i] = reading.drift;
            }
            return py::make_tuple(to_array(std::move(bias)), to_array(std::move(drift)));
          },
          py::arg("t_s"))
      .def(
          "time_of",
          [](const ClockTrack& self, const RealArray<"reading_s">& reading_s) {
            std::vector<double> t(reading_s.size());
            for (std::size_t i = 0; i < t.size(); ++i) t[i] = self.time_of(reading_s[i]);
            return to_array(std::move(t));
          },
          py::arg("reading_s"))
      .def_property_readonly(
          "t_s", [](py::object self) { return view_array(py::cast<const ClockTrack&>(self).times_s(), self); });
}

}  // namespace

void register_pair_link(pybind11::module_& m) {
  register_clock_track(m);
  py::class_<SampledEnvelope>(m, "SampledEnvelope", "Samples of any waveform as a continuous envelope.")
      .def(py::init([](const IqArray<"samples">& samples, double rate) {
             return std::make_unique<SampledEnvelope>(samples.span(), rate);
           }),
           py::arg("samples"), py::arg("sample_rate_hz"))
      .def_property_readonly("begin_s", &SampledEnvelope::begin_s)
      .def_property_readonly("end_s", &SampledEnvelope::end_s);
  py::class_<PairReceiver>(m, "PairReceiver", "Antenna, clock and echoes of one receiver.")
      .def(py::init([](const SampledOrbit& antenna, const ClockTrack& clock, const std::vector<double>& delay_s,
                       const std::vector<std::complex<double>>& gain) {
             PairReceiver receiver{antenna, clock, pair_taps(delay_s, gain)};
             receiver.check();
             return receiver;
           }),
           py::arg("antenna"), py::arg("clock"), py::arg("tap_delay_s"), py::arg("tap_gain"))
      .def("receive", &pair_receive, py::arg("waveform"), py::arg("beacon"), py::kw_only(), py::arg("start_s"),
           py::arg("carrier_hz"), py::arg("amplitude"), py::arg("phase_rad"), py::arg("grid_start_s"),
           py::arg("sample_rate_hz"), py::arg("center_hz"), py::arg("first_sample"), py::arg("samples").noconvert(),
           "Adds what it hears of a transmission to `samples`.");
  py::class_<PairLink>(m, "PairLink", "Two receivers of one transmission after the other.")
      .def(py::init<PairReceiver, PairReceiver, double, double>(), py::arg("target"), py::arg("anchor"),
           py::arg("sample_rate_hz"), py::arg("center_hz"))
      .def("truth", &pair_truth, py::arg("beacons"), py::arg("beacon"), py::arg("sent_s"), py::arg("carrier_hz"),
           "Rows of tdoa_s, fdoa_hz and, of target and anchor, t_s, reading_s, frequency_hz, delay_s, delay_rate, "
           "bias_s, drift.")
      .def(
          "sent_s",
          [](const PairLink& self, const Beacons& beacons, const RealArray<"beacon">& beacon,
             const RealArray<"anchor_reading_s">& reading_s) {
            require_pair_size(beacon.size(), reading_s.size(), "beacon");
            std::vector<double> sent(reading_s.size());
            for (std::size_t i = 0; i < sent.size(); ++i) {
              if (!simulation::sent_time(self.anchor(), beacon_at(beacons, beacon.span(), i), reading_s[i], sent[i])) {
                pair_outside(i);
              }
            }
            return to_array(std::move(sent));
          },
          py::arg("beacons"), py::arg("beacon"), py::arg("anchor_reading_s"))
      .def("render", &pair_render, py::arg("waveform"), py::arg("beacon"), py::kw_only(), py::arg("start_s"),
           py::arg("carrier_hz"), py::arg("phase_rad"), py::arg("target_amplitude"), py::arg("anchor_amplitude"),
           py::arg("target_start_s"), py::arg("target_samples"), py::arg("anchor_start_s"), py::arg("anchor_samples"),
           py::arg("center_hz"), py::arg("noise_variance"), py::arg("seed"), py::arg("stream"))
      .def("bursts", &pair_bursts, py::arg("duration_s"), py::arg("beacons"), py::kw_only(), py::arg("beacon"),
           py::arg("start_s"), py::arg("carrier_hz"), py::arg("target_start_s"), py::arg("anchor_start_s"),
           py::arg("samples"), py::arg("center_hz"), py::arg("target_amplitude"), py::arg("anchor_amplitude"),
           py::arg("noise_variance"), py::arg("seed"), py::arg("stream"));
}

}  // namespace soopnav::python
