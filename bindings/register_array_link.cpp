#include <pybind11/complex.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <complex>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "array.hpp"
#include "register.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/simulation/array_link.hpp"
#include "soopnav/simulation/eigenvalue_map.hpp"
#include "soopnav/simulation/front_end.hpp"

namespace soopnav::python {

namespace {

using simulation::ArrivingWave;
using simulation::ChannelErrors;
using simulation::FrontEnd;
using simulation::FrontEndOptions;
using simulation::LinkBudget;
using Complex = std::complex<double>;

/// Waves of every epoch as arrays give them: steering (epochs, waves, elements, 2), amplitude (epochs, waves).
class Waves {
 public:
  Waves(const Numbers<"steering">& steering, const Numbers<"amplitude">& amplitude,
        const std::optional<Numbers<"delay_s">>& delay_s) {
    steering.require_axes({4}, "float64 (epochs, waves, elements, 2)");
    amplitude.require_axes({2}, "float64 (epochs, waves)");
    const auto size = [&](std::size_t axis) { return static_cast<std::size_t>(steering.shape()[axis]); };
    epochs = size(0), waves_ = size(1), elements = size(2);
    if (steering.shape()[3] != 2) throw std::invalid_argument("steering: real and imaginary parts expected last");
    if (amplitude.shape()[0] != steering.shape()[0] || amplitude.shape()[1] != steering.shape()[1]) {
      throw std::invalid_argument("amplitude: one per epoch and wave of steering is expected");
    }
    const std::size_t count = epochs * waves_ * elements;
    if (delay_s && delay_s->span().size() != count) {
      throw std::invalid_argument("delay_s: one per epoch, wave and element of steering is expected");
    }
    steering_ = {reinterpret_cast<const Complex*>(steering.span().data()), count};
    amplitude_ = amplitude.span();
    if (delay_s) delay_s_ = delay_s->span();
    of_epoch_.resize(waves_);
  }

  std::span<const ArrivingWave> at(std::size_t epoch) {
    for (std::size_t k = 0; k < waves_; ++k) {
      const std::size_t wave = epoch * waves_ + k;
      of_epoch_[k] = {steering_.subspan(wave * elements, elements), amplitude_[wave],
                      delay_s_.empty() ? std::span<const double>{} : delay_s_.subspan(wave * elements, elements)};
    }
    return of_epoch_;
  }

  std::size_t epochs = 0;
  std::size_t elements = 0;

 private:
  std::size_t waves_ = 0;
  std::span<const Complex> steering_;
  std::span<const double> amplitude_;
  std::span<const double> delay_s_;
  std::vector<ArrivingWave> of_epoch_;
};

simulation::Waveform waveform_of(const std::string& name) {
  if (name == "noise") return simulation::Waveform::kNoise;
  if (name == "tone") return simulation::Waveform::kTone;
  throw std::invalid_argument("waveform: \"" + name + "\"; it must be \"noise\" or \"tone\"");
}

std::vector<ChannelErrors> channels_of(std::size_t channels, const std::vector<Complex>& gain,
                                       const std::vector<double>& phase_delay_rad,
                                       const std::vector<double>& iq_gain_db, const std::vector<double>& iq_phase_rad,
                                       const std::vector<Complex>& dc) {
  std::vector<ChannelErrors> out(channels);
  const auto fill = [&](const auto& values, const char* name, auto member) {
    if (values.size() != channels) {
      throw std::invalid_argument(std::string(name) + ": " + grouped(values.size()) + " elements; one per channel, " +
                                  grouped(channels) + ", expected");
    }
    for (std::size_t m = 0; m < channels; ++m) out[m].*member = values[m];
  };
  fill(gain, "gain", &ChannelErrors::gain);
  fill(phase_delay_rad, "phase_delay_rad", &ChannelErrors::phase_delay_rad);
  fill(iq_gain_db, "iq_gain_db", &ChannelErrors::iq_gain_db);
  fill(iq_phase_rad, "iq_phase_rad", &ChannelErrors::iq_phase_rad);
  fill(dc, "dc", &ChannelErrors::dc);
  return out;
}

void register_front_end(py::module_& m) {
  py::class_<FrontEnd>(m, "FrontEnd", "Receivers in a row, with the faults that a calibration has to find.")
      .def(py::init([](std::size_t channels, double sample_rate_hz, double noise_figure_db,
                       const std::vector<Complex>& gain, const std::vector<double>& phase_delay_rad,
                       const std::vector<double>& iq_gain_db, const std::vector<double>& iq_phase_rad,
                       const std::vector<Complex>& dc, double attenuation_db, double attenuator_step_db,
                       double phase_step_rad, int adc_bits, std::optional<double> full_scale_dbm) {
             return std::make_unique<FrontEnd>(
                 channels_of(channels, gain, phase_delay_rad, iq_gain_db, iq_phase_rad, dc),
                 FrontEndOptions{sample_rate_hz, noise_figure_db, attenuation_db, attenuator_step_db, phase_step_rad,
                                 adc_bits, full_scale_dbm});
           }),
           py::arg("channels"), py::kw_only(), py::arg("sample_rate_hz"), py::arg("noise_figure_db"), py::arg("gain"),
           py::arg("phase_delay_rad"), py::arg("iq_gain_db"), py::arg("iq_phase_rad"), py::arg("dc"),
           py::arg("attenuation_db"), py::arg("attenuator_step_db"), py::arg("phase_step_rad"), py::arg("adc_bits"),
           py::arg("full_scale_dbm"))
      .def_property_readonly("channels", &FrontEnd::channels)
      .def_property_readonly("noise_floor_dbm", &FrontEnd::noise_floor_dbm)
      .def_property_readonly("full_scale_dbm", &FrontEnd::full_scale_dbm)
      .def_property_readonly("stepped_attenuation_db", &FrontEnd::stepped_attenuation_db)
      .def_property_readonly("rest_attenuation_db", &FrontEnd::rest_attenuation_db)
      .def("phase_delay_rad", &FrontEnd::phase_delay_rad, py::arg("channel"))
      .def(
          "apply",
          [](const FrontEnd& self, const IqArray<"iq">& iq, std::uint64_t seed, std::uint64_t stream) {
            std::vector<Cf32> out;
            std::size_t clipped = 0;
            {
              const py::gil_scoped_release release;
              out.assign(iq.span().begin(), iq.span().end());
              clipped = self.apply(out, RandomStream(seed, stream));
            }
            return py::make_tuple(to_array(std::move(out)), clipped);
          },
          py::arg("iq"), py::kw_only(), py::arg("seed"), py::arg("stream") = 0,
          "iq: the channels' rows one after the other. Returns the samples and how many parts were clipped.")
      .def(
          "apply_blocks",
          [](const FrontEnd& self, const IqArray<"iq">& iq, std::size_t blocks, std::uint64_t seed,
             std::uint64_t stream) {
            if (blocks < 1 || iq.span().size() % blocks != 0) {
              throw std::invalid_argument("blocks: " + grouped(blocks) + "; a divisor of the samples' number expected");
            }
            std::vector<Cf32> out;
            {
              const py::gil_scoped_release release;
              out.assign(iq.span().begin(), iq.span().end());
              const RandomStream random(seed, stream);
              const std::size_t size = out.size() / blocks;
              for (std::size_t b = 0; b < blocks; ++b) {
                self.apply(std::span(out).subspan(b * size, size), random.substream(b));
              }
            }
            return to_array(std::move(out));
          },
          py::arg("iq"), py::arg("blocks"), py::kw_only(), py::arg("seed"), py::arg("stream") = 0,
          "Blocks one after the other, each as `apply` has it, with noise of its own. Returns the samples.");
  m.def(
      "down_convert",
      [](const RealArray<"radio">& radio, double sample_rate_hz, double lo_hz, int decimation, double lo_phase_rad) {
        std::vector<Cf32> out;
        {
          const py::gil_scoped_release release;
          std::vector<float> samples(radio.size());
          std::ranges::transform(radio.span(), samples.begin(), [](double x) { return static_cast<float>(x); });
          out = simulation::down_convert(samples, sample_rate_hz, lo_hz, decimation, lo_phase_rad);
        }
        return to_array(std::move(out));
      },
      py::arg("radio"), py::arg("sample_rate_hz"), py::arg("lo_hz"), py::kw_only(), py::arg("decimation"),
      py::arg("lo_phase_rad") = 0.0, "A real radio-frequency signal mixed to baseband and decimated.");
}

}  // namespace

void register_array_link(py::module_& m) {
  register_front_end(m);
  py::class_<LinkBudget>(m, "LinkBudget", "Power of one emitter from its transmitter to the array's receivers.")
      .def(py::init([](double frequency_hz, double sample_rate_hz, double noise_figure_db, double transmit_power_dbm,
                       double transmit_gain_dbi, double receive_gain_dbi, double splitter_loss_db,
                       double delay_system_loss_db, double excess_loss_db) {
             const LinkBudget budget{frequency_hz,       sample_rate_hz,       noise_figure_db,
                                     transmit_power_dbm, transmit_gain_dbi,    receive_gain_dbi,
                                     splitter_loss_db,   delay_system_loss_db, excess_loss_db};
             budget.check();
             return budget;
           }),
           py::kw_only(), py::arg("frequency_hz"), py::arg("sample_rate_hz"), py::arg("noise_figure_db"),
           py::arg("transmit_power_dbm"), py::arg("transmit_gain_dbi"), py::arg("receive_gain_dbi"),
           py::arg("splitter_loss_db"), py::arg("delay_system_loss_db"), py::arg("excess_loss_db"))
      .def_property_readonly("noise_floor_dbm", &LinkBudget::noise_floor_dbm)
      .def(
          "received_power_dbm",
          [](const LinkBudget& self, const RealArray<"distance_m">& distance_m) {
            std::vector<double> out(distance_m.size());
            for (std::size_t i = 0; i < out.size(); ++i) out[i] = self.received_power_dbm(distance_m[i]);
            return to_array(std::move(out));
          },
          py::arg("distance_m"));
  m.def("far_field_limit_m", &simulation::far_field_limit_m, py::arg("aperture_m"), py::arg("frequency_hz"),
        "The distance beyond which waves are flat across an aperture.");
  m.def(
      "array_samples",
      [](const Numbers<"steering">& steering, const Numbers<"amplitude">& amplitude, std::size_t samples,
         double sample_rate_hz, const std::string& waveform, double bandwidth_ratio, double tone_hz,
         double noise_variance, const std::optional<Numbers<"delay_s">>& delay_s, std::uint64_t seed,
         std::uint64_t stream) {
        Waves waves(steering, amplitude, delay_s);
        const std::size_t block = waves.elements * samples;
        std::vector<Cf32> out;
        {
          const py::gil_scoped_release release;
          simulation::ArrayRenderer renderer(waves.elements, samples, sample_rate_hz, waveform_of(waveform),
                                             bandwidth_ratio, tone_hz);
          out.resize(waves.epochs * block);
          const RandomStream random(seed, stream);
          for (std::size_t e = 0; e < waves.epochs; ++e) {
            renderer.render(waves.at(e), noise_variance, random.substream(e), std::span(out).subspan(e * block, block));
          }
        }
        return to_array(std::move(out), {static_cast<py::ssize_t>(waves.epochs),
                                         static_cast<py::ssize_t>(waves.elements), static_cast<py::ssize_t>(samples)});
      },
      py::arg("steering"), py::arg("amplitude"), py::kw_only(), py::arg("samples"), py::arg("sample_rate_hz"),
      py::arg("waveform") = "noise", py::arg("bandwidth_ratio") = 1.0, py::arg("tone_hz") = 0.0,
      py::arg("noise_variance") = 1.0, py::arg("delay_s") = py::none(), py::arg("seed"), py::arg("stream") = 0,
      "Blocks of array samples, shape (epochs, elements, samples). steering: (epochs, waves, elements, 2), amplitude:\n"
      "(epochs, waves), delay_s: (epochs, waves, elements).");
  m.def(
      "sample_covariances",
      [](const Numbers<"steering">& steering, const Numbers<"amplitude">& amplitude, std::size_t snapshots,
         std::uint64_t seed, std::uint64_t stream) {
        Waves waves(steering, amplitude, std::nullopt);
        const std::size_t block = waves.elements * waves.elements;
        std::vector<Complex> out;
        {
          const py::gil_scoped_release release;
          simulation::CovarianceSampler sampler(waves.elements, snapshots);
          out.resize(waves.epochs * block);
          const RandomStream random(seed, stream);
          for (std::size_t e = 0; e < waves.epochs; ++e) {
            if (!sampler.draw(waves.at(e), random.substream(e), std::span(out).subspan(e * block, block))) {
              throw std::invalid_argument("steering, amplitude: not finite in row " + grouped(e));
            }
          }
        }
        const auto elements = static_cast<py::ssize_t>(waves.elements);
        return to_array(std::move(out), {static_cast<py::ssize_t>(waves.epochs), elements, elements});
      },
      py::arg("steering"), py::arg("amplitude"), py::kw_only(), py::arg("snapshots"), py::arg("seed"),
      py::arg("stream") = 0,
      "Sample covariances of waves in unit noise from their exact law, shape (epochs, elements, elements).");
  m.def(
      "eigenvalue_map",
      [](const array::Manifold& manifold, const RealArray<"snr_db">& snr_db, std::size_t snapshots, std::size_t trials,
         double elevation_low_rad, double elevation_high_rad, double step_rad, std::uint64_t seed) {
        simulation::EigenvalueMap map;
        {
          const py::gil_scoped_release release;
          array::GridOptions grid;
          grid.azimuth_step_rad = grid.elevation_step_rad = step_rad;
          map = simulation::eigenvalue_map(std::make_shared<const array::SteeringTable>(manifold, grid), snr_db.span(),
                                           {snapshots, trials, elevation_low_rad, elevation_high_rad},
                                           RandomStream(seed));
        }
        return py::make_tuple(to_array(std::move(map.snr_db)), to_array(std::move(map.ratio)),
                              to_array(std::move(map.azimuth_rms_rad)), to_array(std::move(map.elevation_rms_rad)),
                              to_array(std::move(map.angle_rms_rad)));
      },
      py::arg("manifold"), py::arg("snr_db"), py::kw_only(), py::arg("snapshots"), py::arg("trials"),
      py::arg("elevation_low_rad"), py::arg("elevation_high_rad"), py::arg("step_rad"), py::arg("seed"),
      "SNR, mean eigenvalue ratio, rms errors of azimuth, elevation and direction, shape (k,) each.");
}

}  // namespace soopnav::python
