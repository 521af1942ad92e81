#include "soopnav/waveform/lte/snapshot_ranger.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <stdexcept>
#include <string>

#include "soopnav/dsp/fft.hpp"
#include "waveform/lte/kernels.hpp"
#include "waveform/lte/subframe_reader.hpp"

namespace soopnav::lte {

namespace {
constexpr double kTwoPi = 2.0 * std::numbers::pi;
constexpr double kSubframeS = 1e-3;

/// Puts the reference signals of one cell into samples, or takes them out.
class CrsRenderer {
 public:
  explicit CrsRenderer(int fft_size)
      : size_(static_cast<std::size_t>(fft_size)),
        inverse_(fft_size, dsp::FftDirection::kInverse),
        bins_(size_),
        symbol_(size_),
        ramp_(size_ / 2),
        rotator_(size_ + size_ / 4) {}

  /// `channel` of each port over the comb, referred to `start` (of the subframe `first`) and to the time of its first
  /// reference symbol; `frequency` in cycles per sample, all that is left included. Adds `sign` times the signals.
  void add(const CrsTracker& tracker, std::span<const Cf32> channel, double start, int first, double frequency,
           float sign, std::span<Cf32> iq) {
    const CrsCell& cell = tracker.cell();
    LinkState state;
    const double slot_samples = 7.5 * static_cast<double>(size_);
    state.frame_start = start - 2 * first * slot_samples;
    const double reference = tracker.useful_start(state, 0, 2 * first, 0);
    const int begin = static_cast<int>(std::floor(-state.frame_start / slot_samples));
    const int end = static_cast<int>(std::ceil((static_cast<double>(iq.size()) - state.frame_start) / slot_samples));
    for (int slot = begin; slot < end; ++slot) {
      const int frame = slot >= 0 ? slot / 20 : -((19 - slot) / 20), within = slot - 20 * frame;
      for (int which = 0; which < (cell.n_ports > 2 ? 3 : 2); ++which) {
        const int symbol = tracker.reference_symbol(which);
        if (!tracker.transmitted(within, symbol)) continue;
        const double useful = tracker.useful_start(state, frame, within, symbol);
        const int prefix = cyclic_prefix_samples(cell.cp, symbol, static_cast<int>(size_));
        const double from = std::ceil(useful - prefix);
        const std::size_t length = size_ + static_cast<std::size_t>(prefix);
        if (from < 0.0 || from + static_cast<double>(length) > static_cast<double>(iq.size())) continue;
        fill(tracker, channel, within, which);
        turn_into_samples(from - useful, sign);
        kernels::phasors(frequency * (from - reference), frequency, rotator_.data(), length);
        Cf32* to = iq.data() + static_cast<std::size_t>(from);
        for (std::size_t n = 0; n < length; ++n) to[n] += kernels::multiply(symbol_[n % size_], rotator_[n]);
      }
    }
  }

 private:
  void fill(const CrsTracker& tracker, std::span<const Cf32> channel, int slot, int which) {
    std::fill(bins_.begin(), bins_.end(), Cf32{});
    const Cf32* reference = tracker.reference(slot, which);
    const auto& f = tracker.element_frequencies();
    const auto elements = static_cast<std::size_t>(tracker.elements());
    const int ports = tracker.cell().n_ports;
    for (int port = which == 2 ? 2 : 0; port < (which == 2 ? ports : std::min(ports, 2)); ++port) {
      const auto half = static_cast<std::size_t>(tracker.parity(port, slot, which));
      const Cf32* h = channel.data() + static_cast<std::size_t>(port) * elements;
      for (std::size_t m = 0; m < elements / 2; ++m) {
        const int k = f[2 * m + half];
        bins_[k < 0 ? size_ - static_cast<std::size_t>(-k) : static_cast<std::size_t>(k)] =
            kernels::multiply_conj(h[2 * m + half], reference[m]);
      }
    }
  }

  // symbol_ = the bins' time samples, `ahead` samples after the useful part's start (negative: in the prefix).
  void turn_into_samples(double ahead, float sign) {
    const float scale = sign / std::sqrt(static_cast<float>(size_));
    kernels::phasors(0.0, ahead / static_cast<double>(size_), ramp_.data(), ramp_.size());
    for (std::size_t k = 1; k < ramp_.size(); ++k) {
      bins_[k] = kernels::multiply(bins_[k], ramp_[k] * scale);
      bins_[size_ - k] = kernels::multiply_conj(bins_[size_ - k], ramp_[k]) * scale;
    }
    inverse_.execute(bins_.data(), symbol_.data());
  }

  std::size_t size_;
  dsp::Fft inverse_;
  std::vector<Cf32> bins_, symbol_, ramp_, rotator_;
};

/// One cell: reader, paths and what of it is out of the samples at present.
struct Link {
  Link(double rate, const Detection& cell, const ResolverOptions& options) : reader(rate, cell), resolver(options) {
    sum.resize(reader.channels().size());
    channel.resize(sum.size());
  }
  SubframeReader reader;
  PathResolver resolver;
  ResolvedPaths paths;
  std::vector<Cf32> sum, channel;
  double start = 0.0;      // samples, of the first subframe that is read
  double offset = 0.0;     // samples from the frame's start to it
  double frequency = 0.0;  // cycles per sample, as given
  double turned = 0.0;     // beyond it, of the channel that is out
  double turn_rad = 0.0;   // beyond it, at the last reading
  double power = 0.0;
  int first = 0, read = 0;
  bool out = false;
};
}  // namespace

struct SnapshotRanger::Impl {
  Impl(double rate, std::span<const Detection> cells, const RangerOptions& o)
      : rate_hz(rate), options(o), renderer(fft_size_for(rate)) {
    links.reserve(cells.size());
    for (const Detection& cell : cells) links.emplace_back(rate, cell, o.resolver);
    results.resize(cells.size());
    order.resize(cells.size());
  }

  double rate_hz;
  RangerOptions options;
  CrsRenderer renderer;
  std::vector<Link> links;
  std::vector<SnapshotRange> results;
  std::vector<std::size_t> order;
  std::vector<Cf32> work;

  bool place(Link& link, std::size_t samples, double frame_start_s, double cfo_hz) const;
  ResolveStatus read(Link& link, IqSpan iq, ChannelView& view) const;
  void resolve(Link& link, IqSpan iq, SnapshotRange& out) const;
  void take_out(Link& link);
  void put_back(Link& link);
};

// Which subframes of the cell the samples hold.
bool SnapshotRanger::Impl::place(Link& link, std::size_t samples, double frame_start_s, double cfo_hz) const {
  link.out = false;
  if (!std::isfinite(frame_start_s) || !std::isfinite(cfo_hz) || std::abs(frame_start_s) > 1e6) return false;
  const CrsTracker& tracker = link.reader.tracker();
  const double margin_s = 4e-6;  // the transform's window begins inside the cyclic prefix
  const double first = std::ceil((margin_s - frame_start_s) / kSubframeS);
  const double duration_s = static_cast<double>(samples) / rate_hz;
  link.frequency = cfo_hz / rate_hz;
  for (int skipped = 0; skipped < 10; ++skipped) {
    const double index = first + skipped;
    link.first = static_cast<int>(index - 10.0 * std::floor(index / 10.0));
    if (!tracker.transmitted(2 * link.first + 1, tracker.reference_symbol(1))) continue;
    link.offset = index * kSubframeS * rate_hz;
    link.start = frame_start_s * rate_hz + link.offset;
    return frame_start_s + (index + 1.0) * kSubframeS <= duration_s + 60e-6;
  }
  return false;
}

// The mean channel over the subframes, phases aligned with the first.
ResolveStatus SnapshotRanger::Impl::read(Link& link, IqSpan iq, ChannelView& view) const {
  const CrsTracker& tracker = link.reader.tracker();
  double noise = 0.0, turn = 0.0;
  link.read = 0;
  for (int i = 0; link.read < options.subframes && i < 20; ++i) {
    const int subframe = (link.first + i) % 10;
    if (!tracker.transmitted(2 * subframe + 1, tracker.reference_symbol(1))) continue;
    const double start = link.start + i * kSubframeS * rate_hz;
    if (!link.reader.read(iq, subframe, start, link.frequency, true)) {
      if (!std::isfinite(link.reader.energy())) return ResolveStatus::kNonFinite;
      break;
    }
    const auto now = link.reader.channels();
    if (link.read == 0) {
      std::copy(now.begin(), now.end(), link.sum.begin());
    } else {
      const Cf32 correlation = kernels::dot_conj(link.sum.data(), now.data(), now.size());
      const float magnitude = std::abs(correlation);
      const Cf32 align = magnitude > 0.0F ? correlation / magnitude : Cf32(1.0F, 0.0F);
      for (std::size_t j = 0; j < now.size(); ++j) link.sum[j] += kernels::multiply(now[j], align);
    }
    noise += link.reader.noise_variance();
    turn += link.reader.turn_rad();
    ++link.read;
  }
  if (link.read < options.subframes) return ResolveStatus::kTooShort;
  const float scale = 1.0F / static_cast<float>(link.read);
  for (Cf32& x : link.sum) x *= scale;
  link.turn_rad = turn / link.read;
  const double energy = kernels::energy(link.sum.data(), link.sum.size());
  const auto elements = static_cast<std::size_t>(link.reader.elements());
  view.ports = link.reader.ports();
  for (std::size_t p = 0; p < static_cast<std::size_t>(view.ports); ++p) view.port[p] = link.sum.data() + p * elements;
  view.frequencies = link.reader.frequencies();
  view.noise_variance = std::max(noise / link.read, 1e-14 * energy) / (2.0 * link.read);
  link.power = energy / static_cast<double>(link.sum.size()) - view.noise_variance;
  return ResolveStatus::kOk;
}

void SnapshotRanger::Impl::resolve(Link& link, IqSpan iq, SnapshotRange& out) const {
  out = {};
  out.cell_id = link.reader.tracker().cell().cell_id;
  ChannelView view;
  out.status = read(link, iq, view);
  if (out.status == ResolveStatus::kOk) out.status = link.resolver.resolve(view, link.paths);
  if (out.status != ResolveStatus::kOk) return;
  const ResolvedPaths& r = link.paths;
  if (std::abs(r.toa_s) > options.search_window_s) {
    out.status = ResolveStatus::kLost;
    return;
  }
  const double frame_start_s = (link.start - link.offset) / rate_hz;
  out.toa_s = frame_start_s + r.toa_s;
  out.sigma_s = r.toa_sigma_s;
  out.first_peak_s = frame_start_s + r.first_peak_s;
  out.first_peak_sigma_s = r.first_peak_sigma_s;
  const ResolvedPath& first = r.paths[static_cast<std::size_t>(r.first)];
  out.first_db = first.power_db;
  for (const ResolvedPath& path : r.paths) {
    if (path.power_db > -1e-9) out.excess_s = std::max(0.0, path.delay_s - first.delay_s);
  }
  out.paths = static_cast<int>(r.paths.size()) - r.first;
  out.snr_db = r.snr_db - 10.0 * std::log10(2.0 * link.read);  // of one element as received
  out.residual_cfo_hz = link.turn_rad / (kTwoPi * 0.5e-3);
  // A second path that the order rule only just leaves out, a fraction of a cell away (eq. 12).
  const double values = static_cast<double>(link.sum.size());
  const double least = 0.5 * (2.0 * link.reader.ports() + 1.0) * std::log(2.0 * values);
  double power = 0.0;
  for (const std::complex<double>& gain : first.gain) power += std::norm(gain);
  const double over_noise = power * static_cast<double>(link.reader.elements()) / std::max(r.noise_variance, 1e-300);
  const auto& f = link.reader.frequencies();
  const double cell_s = 1.0 / ((f.back() - f.front()) * kSubcarrierSpacingHz);
  out.undetected_s = 0.25 * cell_s * std::sqrt(std::min(1.0, least / std::max(over_noise, 1e-300)));
}

void SnapshotRanger::Impl::take_out(Link& link) {
  const auto elements = static_cast<std::size_t>(link.reader.elements());
  const auto& f = link.reader.frequencies();
  std::fill(link.channel.begin(), link.channel.end(), Cf32{});
  for (const ResolvedPath& path : link.paths.paths) {
    const double theta = path.delay_s * kSubcarrierSpacingHz;
    for (std::size_t j = 0; j < elements; ++j) {
      const double turns = theta * f[j], phase = -kTwoPi * (turns - std::floor(turns));
      const Cf32 element(static_cast<float>(std::cos(phase)), static_cast<float>(std::sin(phase)));
      for (std::size_t p = 0; p < static_cast<std::size_t>(link.reader.ports()); ++p) {
        const Cf32 gain(p < 2 ? path.gain[p] : path.gain[p] * std::numbers::sqrt2);  // ports 2 and 3 are kept scaled
        link.channel[p * elements + j] += kernels::multiply(gain, element);
      }
    }
  }
  link.turned = link.turn_rad / (kTwoPi * 0.5e-3) / rate_hz;
  renderer.add(link.reader.tracker(), link.channel, link.start, link.first, link.frequency + link.turned, -1.0F, work);
  link.out = true;
}

void SnapshotRanger::Impl::put_back(Link& link) {
  if (!link.out) return;
  renderer.add(link.reader.tracker(), link.channel, link.start, link.first, link.frequency + link.turned, 1.0F, work);
  link.out = false;
}

SnapshotRanger::SnapshotRanger(double sample_rate_hz, std::span<const Detection> cells, const RangerOptions& options) {
  if (cells.empty()) throw std::invalid_argument("cells: none given; at least one expected");
  for (const Detection& cell : cells) require_receivable(sample_rate_hz, cell);
  const auto refuse = [](const char* name, double value, const char* rule) {
    throw std::invalid_argument(std::string(name) + ": " + std::to_string(value) + "; " + rule);
  };
  if (options.subframes < 1 || options.subframes > 10) refuse("subframes", options.subframes, "1 ... 10 expected");
  if (options.passes < 1 || options.passes > 4) refuse("passes", options.passes, "1 ... 4 expected");
  if (!(options.search_window_s >= 1e-7 && options.search_window_s <= 1e-5)) {
    refuse("search_window_s", options.search_window_s, "1e-7 ... 1e-5 expected");
  }
  impl_ = std::make_unique<Impl>(sample_rate_hz, cells, options);
}
SnapshotRanger::~SnapshotRanger() = default;
SnapshotRanger::SnapshotRanger(SnapshotRanger&&) noexcept = default;
SnapshotRanger& SnapshotRanger::operator=(SnapshotRanger&&) noexcept = default;

int SnapshotRanger::cells() const noexcept { return static_cast<int>(impl_->links.size()); }

std::span<const SnapshotRange> SnapshotRanger::range(IqSpan iq, std::span<const double> frame_start_s,
                                                     std::span<const double> cfo_hz) {
  Impl& m = *impl_;
  const std::size_t n = m.links.size();
  const bool sizes = frame_start_s.size() == n && (cfo_hz.empty() || cfo_hz.size() == n);
  std::size_t usable = 0;
  for (std::size_t l = 0; l < n; ++l) {
    m.results[l] = {};
    m.results[l].cell_id = m.links[l].reader.tracker().cell().cell_id;
    m.results[l].status = ResolveStatus::kTooShort;
    m.links[l].out = false;
    if (sizes && m.place(m.links[l], iq.size(), frame_start_s[l], cfo_hz.empty() ? 0.0 : cfo_hz[l])) {
      m.order[usable++] = l;
    }
  }
  if (!m.options.cancel || usable < 2) {
    for (std::size_t i = 0; i < usable; ++i) m.resolve(m.links[m.order[i]], iq, m.results[m.order[i]]);
    return m.results;
  }
  ChannelView view;
  for (std::size_t i = 0; i < usable; ++i) {
    const ResolveStatus status = m.read(m.links[m.order[i]], iq, view);
    if (status == ResolveStatus::kNonFinite) {
      for (std::size_t k = 0; k < usable; ++k) m.results[m.order[k]].status = status;
      return m.results;
    }
    if (status != ResolveStatus::kOk) m.links[m.order[i]].power = 0.0;
  }
  // Strongest first; then each alone among the others' remains.
  std::sort(m.order.begin(), m.order.begin() + static_cast<std::ptrdiff_t>(usable), [&](std::size_t a, std::size_t b) {
    return m.links[a].power > m.links[b].power || (m.links[a].power == m.links[b].power && a < b);
  });
  m.work.assign(iq.begin(), iq.end());
  for (int pass = 0; pass < m.options.passes; ++pass) {
    for (std::size_t i = 0; i < usable; ++i) {
      Link& link = m.links[m.order[i]];
      SnapshotRange& result = m.results[m.order[i]];
      m.put_back(link);
      m.resolve(link, m.work, result);
      if (result.status == ResolveStatus::kOk) m.take_out(link);
    }
  }
  return m.results;
}

}  // namespace soopnav::lte
