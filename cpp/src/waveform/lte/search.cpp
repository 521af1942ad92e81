#include "soopnav/waveform/lte/search.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <stdexcept>
#include <string>

#include "soopnav/dsp/resample.hpp"
#include "waveform/lte/canceller.hpp"
#include "waveform/lte/cell_test.hpp"
#include "waveform/lte/crs_tracker.hpp"
#include "waveform/lte/kernels.hpp"
#include "waveform/lte/link_tracker.hpp"
#include "waveform/lte/mib_reader.hpp"
#include "waveform/lte/pss_correlator.hpp"

namespace soopnav::lte {

namespace {

constexpr int kWideWindow = 40;     // half-frames of the first pass over all carrier offsets: 200 ms
constexpr int kNarrowWindow = 200;  // half-frames of the later passes: 1 s
constexpr int kWideCandidates = 32;
constexpr int kNarrowCandidates = 10;
constexpr double kNarrowHz =
    4.5e3;  // cells of one receiver differ by less: what differs is theirs, 0.1 ppm, and Doppler
constexpr double kMaxDriftPpm = 90.0;
constexpr std::size_t kShortest = kHalfFrameSamples + 2 * kSearchFft + 20;

template <class T>
void require(bool good, const char* name, T value, const char* rule) {
  if (!good) throw std::invalid_argument(std::string(name) + ": " + std::to_string(value) + "; " + rule);
}

// Carrier offsets within a few kHz are searched at full rate; a wide bank pays for its width with a coarser grid.
PssCorrelator::Options first_pass(double max_cfo_hz) {
  PssCorrelator::Options options{};
  const bool narrow = max_cfo_hz <= 12e3;
  options.max_cfo_hz = max_cfo_hz;
  options.spacing_hz = narrow ? 5.0625e3 : 7.5e3;
  options.inverse_size = 6144;
  options.max_drift_ppm = kMaxDriftPpm;
  options.max_half_frames = kWideWindow;
  options.in_band = narrow;
  return options;
}

PssCorrelator::Options later_passes() {
  return {.max_cfo_hz = kNarrowHz,
          .spacing_hz = 3.0e3,
          .inverse_size = 10240,
          .max_drift_ppm = 0.0,
          .max_half_frames = kNarrowWindow,
          .in_band = true};
}

}  // namespace

struct Searcher::Impl {
  explicit Impl(const SearchOptions& o)
      : options(o), first(first_pass(o.max_cfo_hz)), later(later_passes()), tracker(kSearchFft) {
    detections.reserve(static_cast<std::size_t>(o.max_cells));
    if (o.sample_rate_hz != kBaseRateHz) {
      // +-540 kHz of signal and the carrier offset stay whole.
      resampler.emplace(dsp::Resampler::between(o.sample_rate_hz, kBaseRateHz,
                                                {.passband = 0.72, .stopband = 1.28, .attenuation_db = 60.0}));
    }
  }

  SearchOptions options;
  std::optional<dsp::Resampler> resampler;
  std::vector<Cf32> base, residual, shifted, stream;
  PssCorrelator first, later;
  CellTest test;
  CrsTracker tracker;
  LinkTracker link;
  Canceller canceller;
  MibReader mib;
  std::vector<PssCandidate> candidates;
  std::vector<ConfirmedCell> confirmed;
  std::vector<Detection> detections;

  [[nodiscard]] bool known(int cell_id) const {
    return std::any_of(detections.begin(), detections.end(), [&](const Detection& d) { return d.cell_id == cell_id; });
  }

  void search(IqSpan iq);
  void first_search(IqSpan iq);
  void later_search();
  bool accept(const ConfirmedCell& cell);
};

// The strongest cells, at any carrier offset, window by window until one is found.
void Searcher::Impl::first_search(IqSpan iq) {
  const std::size_t step = static_cast<std::size_t>(kWideWindow) * kHalfFrameSamples;
  for (std::size_t start = 0; start + kShortest <= iq.size(); start += step) {
    const IqSpan window = iq.subspan(start, std::min(iq.size() - start, step + kSearchFft));
    first.clear();
    for (std::size_t at = 0; at + kSearchFft < window.size(); at += kHalfFrameSamples) first.add(window, at);
    first.peaks(kWideCandidates, candidates);
    for (const PssCandidate& candidate : candidates) {
      confirmed.clear();
      test.examine(
          window, candidate, false, [this](int id) { return known(id); }, confirmed);
      for (ConfirmedCell& cell : confirmed) {
        cell.frame_start += static_cast<double>(start);
        accept(cell);
        if (!detections.empty()) return;
      }
    }
  }
}

// Estimates, decodes and cancels a confirmed cell, in what the cells before have left.
bool Searcher::Impl::accept(const ConfirmedCell& cell) {
  const IqSpan iq = residual;
  if (known(cell.cell_id)) return false;
  LinkState state{cell.frame_start, cell.drift, cell.cfo_hz / kBaseRateHz};
  tracker.configure({cell.cell_id, cell.cp, cell.duplex, 6, 1});
  // The receiver's clock is the same for all; base stations differ by 0.05 ppm at most (TS 36.104 6.5.1).
  double drift_sigma = 20e-6;
  if (!detections.empty()) {
    const Detection& first_cell = detections.front();
    state.drift = 1.0 / (1.0 + first_cell.clock_error_ppm * 1e-6) - 1.0;
    drift_sigma = 1e-6 * std::hypot(first_cell.clock_error_sigma_ppm, 0.1);
  }
  if (!link.track(tracker, iq, state, 3, drift_sigma)) return false;

  // All four ports, for the broadcast channel and for what is to be cancelled.
  tracker.configure({cell.cell_id, cell.cp, cell.duplex, 6, 4});
  tracker.read(iq, state, 10);
  if (tracker.frames().empty()) tracker.read(iq, state, 1);
  Detection d;
  d.cell_id = cell.cell_id;
  d.cp = cell.cp;
  d.duplex = cell.duplex;
  int ports = 1;
  std::optional<MibReader::Result> found;
  std::optional<int> state_sfn;  // of the frame at state.frame_start
  if (!tracker.frames().empty()) {
    link.align(tracker, 0, tracker.frames().size());
    if (options.decode_mib) {
      found = mib.read(iq, state, tracker, link);
      if (found) {
        d.n_rb = found->mib.n_rb;
        d.n_ports = found->n_ports;
        state_sfn = found->mib.sfn - found->frame;
        ports = found->n_ports;
      }
    }
    if (!d.n_ports) {
      for (int port = 1; port < kMaxPorts; ++port) {
        const double power = kernels::energy(link.mean_channel(port), 24) / 24.0;
        if (power > 6.0 * link.mean_channel_noise()) ports = port == 1 ? 2 : 4;
      }
    }
  }
  // Every port that is there sharpens the estimates, and is what there is to cancel.
  tracker.configure({cell.cell_id, cell.cp, cell.duplex, 6, ports});
  if (!link.track(tracker, iq, state, 2, drift_sigma)) return false;
  const double frame_samples = 19200.0 * (1.0 + state.drift);
  const double whole = std::floor(state.frame_start / frame_samples);  // frames between the state's and the first one
  if (state_sfn) d.sfn = (((*state_sfn - static_cast<int>(whole)) % 1024) + 1024) % 1024;
  d.frame_start_s = (state.frame_start - whole * frame_samples) / kBaseRateHz;
  if (d.frame_start_s >= kFrameS) {
    // A slow cell's frames are longer than 10 ms. The one before has begun less than that excess before the capture:
    // it counts as the first, its start as modulo 10 ms.
    d.frame_start_s -= kFrameS;
    if (d.sfn) d.sfn = (*d.sfn + 1023) % 1024;
  }
  d.cfo_hz = state.frequency * kBaseRateHz;
  d.cfo_sigma_hz = link.frequency_sigma() * kBaseRateHz;
  d.clock_error_ppm = -state.drift / (1.0 + state.drift) * 1e6;
  d.clock_error_sigma_ppm = link.drift_sigma() * 1e6;
  d.snr_db = 10.0 * std::log10(link.snr());
  d.power_db = 10.0 * std::log10(link.power());
  d.crs_statistic = cell.evidence;
  detections.push_back(d);

  tracker.read(residual, state, 10);
  if (tracker.frames().empty()) tracker.read(residual, state, 1);
  canceller.subtract(state, tracker, residual);
  if (found && found->mib.spare == 0) {
    MasterInformationBlock block = found->mib;
    block.sfn = *state_sfn;
    canceller.subtract_pbch(state, tracker, block, residual);
  }
  return true;
}

// Weaker cells at the carrier offset and clock drift of those found, below what has been cancelled.
void Searcher::Impl::later_search() {
  bool found = true;
  while (found && static_cast<int>(detections.size()) < options.max_cells) {
    found = false;
    const double cfo_hz = detections.front().cfo_hz;
    const double drift = 1.0 / (1.0 + detections.front().clock_error_ppm * 1e-6) - 1.0;
    shifted.resize(residual.size());
    for (std::size_t at = 0; at < residual.size(); at += 1024) {
      const std::size_t count = std::min<std::size_t>(1024, residual.size() - at);
      std::array<Cf32, 1024> turn;
      kernels::phasors(-cfo_hz / kBaseRateHz * static_cast<double>(at), -cfo_hz / kBaseRateHz, turn.data(), count);
      kernels::multiply(residual.data() + at, turn.data(), shifted.data() + at, count);
    }
    later.clear();
    for (int h = 0; h < kNarrowWindow; ++h) {
      const auto at =
          static_cast<std::size_t>(std::llround(h * static_cast<double>(kHalfFrameSamples) * (1.0 + drift)));
      if (at + kSearchFft >= shifted.size()) break;
      later.add(shifted, at);
    }
    later.peaks(kNarrowCandidates, candidates);
    for (PssCandidate& candidate : candidates) {
      candidate.cfo_hz += cfo_hz;
      candidate.drift = drift;
      confirmed.clear();
      test.examine(
          residual, candidate, true, [this](int id) { return known(id); }, confirmed);
      std::sort(confirmed.begin(), confirmed.end(),
                [](const ConfirmedCell& a, const ConfirmedCell& b) { return a.evidence > b.evidence; });
      for (const ConfirmedCell& cell : confirmed) {
        if (static_cast<int>(detections.size()) < options.max_cells) found = accept(cell) || found;
        if (found) break;
      }
      if (found) break;
    }
  }
}

void Searcher::Impl::search(IqSpan iq) {
  detections.clear();
  residual.assign(iq.begin(), iq.end());
  first_search(iq);
  if (!detections.empty()) later_search();
  std::sort(detections.begin(), detections.end(),
            [](const Detection& a, const Detection& b) { return a.power_db > b.power_db; });
}

Searcher::Searcher(const SearchOptions& options) {
  require(options.sample_rate_hz >= 1.4e6 && options.sample_rate_hz <= 100e6, "sample_rate_hz", options.sample_rate_hz,
          "1.4e6 ... 100e6 expected");
  require(options.max_cfo_hz >= 0.0 && options.max_cfo_hz <= 250e3, "max_cfo_hz", options.max_cfo_hz,
          "0 ... 250e3 expected");
  require(options.window_s >= 10e-3 && options.window_s <= 2.0, "window_s", options.window_s, "0.01 ... 2 expected");
  require(options.max_cells >= 1 && options.max_cells <= 64, "max_cells", options.max_cells, "1 ... 64 expected");
  impl_ = std::make_unique<Impl>(options);
}

Searcher::~Searcher() = default;
Searcher::Searcher(Searcher&&) noexcept = default;
Searcher& Searcher::operator=(Searcher&&) noexcept = default;

SearchStatus Searcher::search(IqSpan iq) {
  impl_->detections.clear();
  for (const Cf32 x : iq) {
    if (!std::isfinite(x.real()) || !std::isfinite(x.imag())) return SearchStatus::kNonFinite;
  }
  IqSpan base = iq;
  if (impl_->resampler) {
    impl_->base.resize(impl_->resampler->output_size(iq.size()));
    impl_->resampler->apply(iq, 0, impl_->base);
    base = impl_->base;
  }
  if (base.size() < kShortest) return SearchStatus::kTooShort;
  impl_->search(base);
  return SearchStatus::kOk;
}

std::span<const Detection> Searcher::push(IqSpan block) {
  Impl& impl = *impl_;
  impl.detections.clear();
  const auto window = static_cast<std::size_t>(std::llround(impl.options.window_s * impl.options.sample_rate_hz));
  impl.stream.reserve(window);
  for (const Cf32 x : block) {
    impl.stream.push_back(std::isfinite(x.real()) && std::isfinite(x.imag()) ? x : Cf32{});
    if (impl.stream.size() == window) {
      search(impl.stream);
      impl.stream.clear();
    }
  }
  return impl.detections;
}

std::span<const Detection> Searcher::detections() const noexcept { return impl_->detections; }

}  // namespace soopnav::lte
