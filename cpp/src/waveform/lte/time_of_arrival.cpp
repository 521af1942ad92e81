#include "soopnav/waveform/lte/time_of_arrival.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <optional>
#include <stdexcept>
#include <string>

#include "soopnav/dsp/resample.hpp"
#include "waveform/lte/crs_tracker.hpp"
#include "waveform/lte/kernels.hpp"
#include "waveform/lte/link_tracker.hpp"
#include "waveform/lte/path_model.hpp"
#include "waveform/lte/subframe_reader.hpp"

namespace soopnav::lte {

namespace {

constexpr std::size_t kBlock = 10;  // frames whose channel is taken as one

void require_rate(double sample_rate_hz) {
  if (!(sample_rate_hz >= 1.4e6 && sample_rate_hz <= 100e6)) {
    throw std::invalid_argument("sample_rate_hz: " + std::to_string(sample_rate_hz) + "; 1.4e6 ... 100e6 expected");
  }
}

}  // namespace

struct ToaEstimator::Impl {
  explicit Impl(double rate)
      : sample_rate_hz(rate),
        fft_size(fft_size_for(rate)),
        rate_hz(fft_size * kSubcarrierSpacingHz),
        tracker(fft_size) {
    if (std::abs(rate_hz - rate) > 1e-6) {
      resampler.emplace(
          dsp::Resampler::between(rate, rate_hz, {.passband = 0.93, .stopband = 1.07, .attenuation_db = 80.0}));
    }
  }

  double sample_rate_hz;
  int fft_size;
  double rate_hz;
  std::optional<dsp::Resampler> resampler;
  std::vector<Cf32> resampled;
  CrsTracker tracker;
  LinkTracker link;
  PathModel model;

  ToaStatus estimate(IqSpan iq, const Detection& cell, TimeOfArrival& out);
  double weigh_ports(int ports);
  void profile(int ports, double weight, double first_delay, TimeOfArrival& out);
};

// Ports 2 and 3 have fewer reference symbols than 0 and 1. Scaled by the root of their share, the elements of all ports
// are equally noisy, and the sums over ports weigh them as maximum likelihood does (eq. 5). Returns the weights' sum.
double ToaEstimator::Impl::weigh_ports(int ports) {
  double total = std::min(ports, 2);
  for (std::size_t f = 0; f < tracker.frames().size(); ++f) {
    const double all = tracker.symbols(f, 0, 0) + tracker.symbols(f, 0, 1);
    for (int p = 2; p < ports; ++p) {
      const double share = (tracker.symbols(f, p, 0) + tracker.symbols(f, p, 1)) / all;
      if (f == 0) total += share;
      Cf32* x = tracker.channel(f, p);
      for (int j = 0; j < tracker.elements(); ++j) x[j] *= static_cast<float>(std::sqrt(share));
    }
  }
  return total;
}

// Magnitude of the impulse response, a cyclic prefix before the first path and two after it.
void ToaEstimator::Impl::profile(int ports, double weight, double first_delay, TimeOfArrival& out) {
  std::array<const Cf32*, kMaxPorts> mean{};
  for (int p = 0; p < ports; ++p) mean[static_cast<std::size_t>(p)] = link.mean_channel(p);
  static_cast<void>(link.coarse().estimate(mean.data(), ports, tracker.elements(), fft_size));
  const auto& power = link.coarse().profile();
  const int size = static_cast<int>(power.size());
  const double step_s = 1.0 / (3.0 * kSubcarrierSpacingHz * size);
  const int begin = static_cast<int>(std::floor((first_delay / rate_hz - 2e-6) / step_s));
  const int count = std::min(size, static_cast<int>(10e-6 / step_s));
  out.impulse_response.clear();
  const auto norm = static_cast<float>(1.0 / tracker.elements());
  for (int i = begin; i < begin + count; ++i) {
    out.impulse_response.push_back(
        norm * std::sqrt(power[static_cast<std::size_t>(((i % size) + size) % size)] / static_cast<float>(weight)));
  }
  out.impulse_response_step_s = step_s;
  out.impulse_response_start_s = begin * step_s - first_delay / rate_hz;
}

ToaStatus ToaEstimator::Impl::estimate(IqSpan iq, const Detection& cell, TimeOfArrival& out) {
  out = {};
  if (!is_cell(cell)) return ToaStatus::kBadCell;
  for (const Cf32 x : iq) {
    if (!std::isfinite(x.real()) || !std::isfinite(x.imag())) return ToaStatus::kNonFinite;
  }
  if (resampler) {
    resampled.resize(resampler->output_size(iq.size()));
    resampler->apply(iq, 0, resampled);
    iq = resampled;
  }
  const int ports = cell.n_ports.value_or(1);
  tracker.configure({cell.cell_id, cell.cp, cell.duplex, usable_rb(cell.n_rb.value_or(6), sample_rate_hz), ports});
  LinkState state;
  state.drift = 1.0 / (1.0 + cell.clock_error_ppm * 1e-6) - 1.0;
  state.frame_start = cell.frame_start_s * rate_hz;
  state.frequency = cell.cfo_hz / rate_hz;
  // A detection that does not say how well it knows the clock may be off by a crystal's tolerance.
  const double known_ppm = cell.clock_error_sigma_ppm > 0.0 ? 3.0 * cell.clock_error_sigma_ppm : 20.0;
  const double drift_sigma = 1e-6 * std::clamp(known_ppm, 0.03, 60.0);
  if (!link.track(tracker, iq, state, 2, drift_sigma)) return ToaStatus::kTooShort;
  if (cell.duplex == Duplex::kTdd) tracker.find_downlink_subframes(iq, state);
  if (!link.track(tracker, iq, state, 2, drift_sigma)) return ToaStatus::kTooShort;
  const auto& frames = tracker.frames();
  const double mean_power =
      kernels::energy(link.mean_channel(0), static_cast<std::size_t>(tracker.elements())) / tracker.elements();
  if (mean_power < (1.0 + 6.0 / std::sqrt(static_cast<double>(tracker.elements()))) * link.mean_channel_noise()) {
    return ToaStatus::kLost;
  }
  out.cfo_hz = state.frequency * rate_hz;
  out.clock_error_ppm = -state.drift / (1.0 + state.drift) * 1e6;
  out.snr_db = 10.0 * std::log10(link.snr());
  out.noise_variance = tracker.noise_variance() * sample_rate_hz / rate_hz;  // a resampled transform is longer
  const double weight = weigh_ports(ports);

  const double unit = fft_size / 128;
  const LinkState& read = link.read_state();  // the frames' delays count from its line
  const double frame_samples = 19200.0 * unit * (1.0 + read.drift);
  // A transform sees the delay at the middle of its window, half a symbol of drift after the symbol's start (eq. 6 of
  // cpp/doc/lte_time_of_arrival.md).
  const double until_middle = state.drift * (0.5 * fft_size - tracker.back());
  PathModel::Limits limits;
  limits.window_samples = 4.7e-6 * rate_hz;
  std::array<const Cf32*, kMaxPorts> mean{}, shape{}, y{};
  for (std::size_t begin = 0; begin < frames.size(); begin += kBlock) {
    const std::size_t end = std::min(begin + kBlock, frames.size());
    link.align(tracker, begin, end);
    for (int p = 0; p < ports; ++p) mean[static_cast<std::size_t>(p)] = link.mean_channel(p);
    if (!model.fit(mean.data(), ports, tracker.element_frequencies().data(), tracker.elements(), fft_size,
                   link.mean_channel_noise(), limits, link.coarse())) {
      continue;
    }
    if (begin == 0) {
      double strongest = 0.0;
      for (int l = 0; l < model.paths(); ++l) strongest = std::max(strongest, model.power(l));
      for (int l = model.first(); l < model.paths(); ++l) {
        out.paths.push_back(
            {(model.delay(l) - model.delay(model.first())) / rate_hz, 10.0 * std::log10(model.power(l) / strongest)});
      }
      profile(ports, weight, model.delay(model.first()), out);
    }
    double shape_energy = 0.0;
    for (int p = 0; p < ports; ++p) {
      shape[static_cast<std::size_t>(p)] = model.channel(p);
      shape_energy += kernels::energy(model.channel(p), static_cast<std::size_t>(tracker.elements()));
    }
    // Each frame's delay is that of the whole channel; the first path's place in it comes from the block.
    const double common = model.paths() > 1 ? model.first_sigma() : 0.0;
    for (std::size_t f = begin; f < end; ++f) {
      for (int p = 0; p < ports; ++p) y[static_cast<std::size_t>(p)] = tracker.channel(f, p);
      const DelayFit fit = refine_delay(y.data(), shape.data(), ports, tracker.element_frequencies().data(),
                                        tracker.elements(), fft_size, 0.0);
      if (!fit.converged) continue;
      const double noise = tracker.noise_variance() / (0.5 * frames[f].symbols);
      const double own = std::sqrt(noise / (2.0 * std::max(shape_energy * fit.curvature, 1e-30)));
      const double arrival =
          read.frame_start + frames[f].index * frame_samples + model.delay(model.first()) + fit.tau - until_middle;
      out.toa_s.push_back(arrival / rate_hz - frames[f].index * kFrameS);
      out.sigma_s.push_back(std::hypot(own, common) / rate_hz);
      out.frame_index.push_back(frames[f].index);
    }
  }
  if (out.toa_s.empty()) return ToaStatus::kLost;
  double wrap = kFrameS * std::floor(out.toa_s.front() / kFrameS);
  if (out.toa_s.front() - wrap >= kFrameS) wrap += kFrameS;  // a hair below zero rounds to a whole frame
  for (double& t : out.toa_s) t -= wrap;
  return ToaStatus::kOk;
}

ToaEstimator::ToaEstimator(double sample_rate_hz) {
  require_rate(sample_rate_hz);
  impl_ = std::make_unique<Impl>(sample_rate_hz);
}
ToaEstimator::~ToaEstimator() = default;
ToaEstimator::ToaEstimator(ToaEstimator&&) noexcept = default;
ToaEstimator& ToaEstimator::operator=(ToaEstimator&&) noexcept = default;

ToaStatus ToaEstimator::estimate(IqSpan iq, const Detection& cell, TimeOfArrival& out) {
  return impl_->estimate(iq, cell, out);
}

struct SubframeToaEstimator::Impl {
  Impl(double rate, const Detection& cell) : reader(rate, cell) {}
  SubframeReader reader;
  CoarseDelay coarse;
};

SubframeToaEstimator::SubframeToaEstimator(double sample_rate_hz, const Detection& cell) {
  require_receivable(sample_rate_hz, cell);
  impl_ = std::make_unique<Impl>(sample_rate_hz, cell);
}
SubframeToaEstimator::~SubframeToaEstimator() = default;
SubframeToaEstimator::SubframeToaEstimator(SubframeToaEstimator&&) noexcept = default;
SubframeToaEstimator& SubframeToaEstimator::operator=(SubframeToaEstimator&&) noexcept = default;

std::optional<SubframeToa> SubframeToaEstimator::estimate(IqSpan iq, int subframe, double start_s, double cfo_hz) {
  SubframeReader& reader = impl_->reader;
  if (subframe < 0 || subframe > 9 || !std::isfinite(start_s) || !std::isfinite(cfo_hz)) return std::nullopt;
  const double rate_hz = reader.rate_hz();
  if (!reader.read(iq, subframe, start_s * rate_hz, cfo_hz / rate_hz, true)) return std::nullopt;
  std::array<const Cf32*, kMaxPorts> y{};
  for (int p = 0; p < reader.ports(); ++p) y[static_cast<std::size_t>(p)] = reader.channel(p);
  const double start = impl_->coarse.estimate(y.data(), reader.ports(), reader.elements(), reader.fft_size());
  const DelayFit fit = refine_delay(y.data(), nullptr, reader.ports(), reader.frequencies().data(), reader.elements(),
                                    reader.fft_size(), start);
  if (!fit.converged) return std::nullopt;
  // sigma^2 = noise / (2 sum_p |a_p|^2 B), B the effective squared bandwidth sum; fit.power = sum_p |count a_p|^2.
  const double signal = fit.power / reader.elements();
  const double noise = reader.noise_variance();
  SubframeToa out;
  out.toa_s = start_s + fit.tau / rate_hz;
  out.sigma_s = std::sqrt(0.5 * noise / (2.0 * signal * fit.curvature)) / rate_hz;
  out.noise_variance = noise;
  out.residual_cfo_hz = reader.turn_rad() / (2.0 * std::numbers::pi * 0.5e-3);
  out.snr_db =
      10.0 * std::log10(std::max(1e-9, (signal / reader.elements() / reader.port_weight()) / std::max(noise, 1e-30)));
  return out;
}

}  // namespace soopnav::lte
