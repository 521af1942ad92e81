#include "soopnav/waveform/lte/measurement_stream.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/waveform/lte/search.hpp"
#include "soopnav/waveform/lte/super_resolution.hpp"
#include "waveform/lte/subframe_reader.hpp"

namespace soopnav::lte {

namespace {
constexpr double kSubframeS = 1e-3;

constexpr double kLongestSkipS = 3600.0;  // each of its epochs is made

void require(bool good, const char* name, double value, const char* rule) {
  if (!good) throw std::invalid_argument(std::string(name) + ": " + std::to_string(value) + "; " + rule);
}

/// A cell that is followed.
struct Follower {
  Follower(const StreamOptions& o, const Detection& cell, std::int64_t first_sample)
      : loop({.sample_rate_hz = o.sample_rate_hz,
              .carrier_hz = o.carrier_hz,
              .pll_bandwidth_hz = o.pll_bandwidth_hz,
              .dll_bandwidth_hz = o.dll_bandwidth_hz},
             cell),
        resolver(o.sample_rate_hz, cell, {.max_paths = 3}),
        origin(first_sample) {}
  CrsLoop loop;
  SubframePathResolver resolver;
  std::int64_t origin;  // sample that the loop's times count from
  std::int64_t frames_before = 0;
  double heard_s = 0.0;  // of the last good update, loop time
  int arc = 0;
  ResolvedPaths paths;
};
}  // namespace

Observation StreamEpoch::toa() const noexcept {
  Observation out(Epoch::from_seconds(TimeScale::kCapture, time_s));
  for (const CellMeasurement& c : cells) {
    if (c.status != LoopStatus::kTracking) continue;
    const bool resolved = c.paths > 0;
    static_cast<void>(out.append(resolved ? c.first_path_s : c.toa_s, resolved ? c.first_path_sigma_s : c.sigma_s,
                                 SourceId{static_cast<std::uint32_t>(c.cell_id)}));
  }
  return out;
}

Observation StreamEpoch::carrier_phase() const noexcept {
  Observation out(Epoch::from_seconds(TimeScale::kCapture, time_s));
  for (const CellMeasurement& c : cells) {
    if (c.status != LoopStatus::kTracking) continue;
    static_cast<void>(
        out.append(c.carrier_phase_cycles, c.phase_sigma_cycles, SourceId{static_cast<std::uint32_t>(c.cell_id)}));
  }
  return out;
}

struct MeasurementStream::Impl {
  explicit Impl(const StreamOptions& o) : options(o) {
    history_size = static_cast<std::size_t>(std::max(o.search ? o.search_window_s : 0.0, 4e-3) * o.sample_rate_hz);
    history.reserve(2 * history_size);
    followers.reserve(kMaxStreamCells);
    if (o.search) {
      searcher.emplace(
          SearchOptions{.sample_rate_hz = o.sample_rate_hz, .max_cfo_hz = o.max_cfo_hz, .max_cells = o.max_cells});
    }
    next_search = static_cast<std::int64_t>(o.search_window_s * o.sample_rate_hz);
  }

  StreamOptions options;
  std::optional<Searcher> searcher;
  std::vector<Follower> followers;
  std::vector<Cf32> history, clean;  // the last samples, up to `position`
  std::size_t history_size = 0;
  std::int64_t position = 0, epoch = 1, next_search = 0;
  std::vector<StreamEpoch> epochs;

  [[nodiscard]] std::int64_t epoch_sample() const {
    return static_cast<std::int64_t>(std::ceil(static_cast<double>(epoch) / options.rate_hz * options.sample_rate_hz));
  }
  void follow(const Detection& cell, std::int64_t first_sample, bool replay);
  void feed(Follower& f, IqSpan block) const;
  void search();
  void make_epoch();
  void resolve(Follower& f, double time_s, CellMeasurement& out);
  void advance(IqSpan block);
};

void MeasurementStream::Impl::feed(Follower& f, IqSpan block) const {
  for (const LoopUpdate& u : f.loop.push(block)) {
    if (u.status == LoopStatus::kTracking || u.status == LoopStatus::kPullIn) f.heard_s = u.time_s;
  }
}

void MeasurementStream::Impl::follow(const Detection& cell, std::int64_t first_sample, bool replay) {
  if (static_cast<int>(followers.size()) >= options.max_cells) return;
  Follower f(options, cell, first_sample);
  // Counting of whole frames begins with the stream.
  const double start_s = static_cast<double>(first_sample) / options.sample_rate_hz + cell.frame_start_s;
  f.frames_before = static_cast<std::int64_t>(std::floor(start_s / kFrameS + 1e-9));
  if (replay) feed(f, history);
  followers.push_back(std::move(f));
}

void MeasurementStream::Impl::search() {
  if (searcher->search(history) != SearchStatus::kOk) return;
  const std::int64_t first = position - static_cast<std::int64_t>(history.size());
  for (const Detection& found : searcher->detections()) {
    const bool known = std::any_of(followers.begin(), followers.end(),
                                   [&](const Follower& f) { return f.loop.cell().cell_id == found.cell_id; });
    if (!known) follow(found, first, true);
  }
}

// Paths in the last whole subframe that the loop read.
void MeasurementStream::Impl::resolve(Follower& f, double time_s, CellMeasurement& out) {
  const double rate = options.sample_rate_hz;
  const double begin_s = static_cast<double>(position - f.origin - static_cast<std::int64_t>(history.size())) / rate;
  const double end_s = time_s - static_cast<double>(f.origin) / rate;
  const double toa_s = f.loop.toa_at(end_s);
  auto index = static_cast<std::int64_t>(std::floor((end_s - toa_s) / kSubframeS)) - 1;
  const bool tdd = f.loop.cell().duplex == Duplex::kTdd;
  while (tdd && ((index % 5) + 5) % 5 != 0) --index;
  const double start_s = toa_s + static_cast<double>(index) * kSubframeS - begin_s;
  if (start_s < 1e-5) return;
  const int subframe = static_cast<int>(((index % 10) + 10) % 10);
  if (f.resolver.resolve(history, subframe, 1, start_s, f.loop.last().cfo_hz, f.paths) != ResolveStatus::kOk) return;
  const ResolvedPath& first = f.paths.paths[static_cast<std::size_t>(f.paths.first)];
  // One subframe places the paths against each other; where the whole lies the loop knows better, but for the bias that
  // paths give its single delay: that is the subframe's too.
  out.first_path_s = out.toa_s + (f.paths.toa_s - start_s);
  out.first_path_sigma_s = f.paths.toa_sigma_s;
  out.paths = static_cast<int>(f.paths.paths.size()) - f.paths.first;
  for (const ResolvedPath& path : f.paths.paths) {
    if (path.power_db > -1e-9) out.excess_s = std::max(0.0, path.delay_s - first.delay_s);
  }
}

void MeasurementStream::Impl::make_epoch() {
  StreamEpoch out;
  out.time_s = static_cast<double>(epoch) / options.rate_hz;
  for (std::size_t i = 0; i < followers.size();) {
    Follower& f = followers[i];
    const double own_s = out.time_s - static_cast<double>(f.origin) / options.sample_rate_hz;
    if (f.loop.last().status == LoopStatus::kLost && own_s - f.heard_s > options.drop_after_s) {
      followers.erase(followers.begin() + static_cast<std::ptrdiff_t>(i));
      continue;
    }
    const LoopUpdate& u = f.loop.last();
    CellMeasurement c;
    c.cell_id = f.loop.cell().cell_id;
    c.status = own_s - f.heard_s > 50e-3 && u.status == LoopStatus::kTracking ? LoopStatus::kCoasting : u.status;
    c.toa_s = f.loop.toa_at(own_s) + static_cast<double>(f.origin) / options.sample_rate_hz -
              static_cast<double>(f.frames_before) * kFrameS;
    c.sigma_s = u.toa_sigma_s;
    c.carrier_phase_cycles = f.loop.phase_at(own_s);
    c.phase_sigma_cycles = u.phase_sigma_cycles;
    c.cfo_hz = u.cfo_hz;
    c.cn0_dbhz = u.cn0_dbhz;
    c.first_path_s = c.toa_s;
    c.first_path_sigma_s = c.sigma_s;
    c.arc = u.arc;
    c.slip = u.arc != f.arc;
    f.arc = u.arc;
    if (options.resolve && c.status == LoopStatus::kTracking) resolve(f, out.time_s, c);
    static_cast<void>(out.cells.push_back(c));
    ++i;
  }
  epochs.push_back(out);
  ++epoch;
}

void MeasurementStream::Impl::advance(IqSpan block) {
  if (history.size() + block.size() > history.capacity()) {
    const std::size_t keep = std::min(history.size(), history_size);
    history.erase(history.begin(), history.end() - static_cast<std::ptrdiff_t>(keep));
  }
  history.insert(history.end(), block.begin(), block.end());
  position += static_cast<std::int64_t>(block.size());
  for (Follower& f : followers) feed(f, block);
}

MeasurementStream::MeasurementStream(const StreamOptions& o, std::span<const Detection> cells) {
  require(o.rate_hz >= 0.1 && o.rate_hz <= 100.0, "rate_hz", o.rate_hz, "0.1 ... 100 expected");
  require(o.search_interval_s >= 0.1 && o.search_interval_s <= 3600.0, "search_interval_s", o.search_interval_s,
          "0.1 ... 3600 expected");
  require(o.search_window_s >= 10e-3 && o.search_window_s <= 0.2, "search_window_s", o.search_window_s,
          "10e-3 ... 0.2 expected");
  require(o.max_cells >= 1 && o.max_cells <= kMaxStreamCells, "max_cells", o.max_cells, "1 ... 16 expected");
  require(static_cast<int>(cells.size()) <= o.max_cells, "cells", static_cast<double>(cells.size()),
          "at most max_cells expected");
  require(o.drop_after_s >= 0.1 && o.drop_after_s <= 3600.0, "drop_after_s", o.drop_after_s, "0.1 ... 3600 expected");
  require_receivable(o.sample_rate_hz, Detection{});
  impl_ = std::make_unique<Impl>(o);
  for (const Detection& cell : cells) impl_->follow(cell, 0, false);
}
MeasurementStream::~MeasurementStream() = default;
MeasurementStream::MeasurementStream(MeasurementStream&&) noexcept = default;
MeasurementStream& MeasurementStream::operator=(MeasurementStream&&) noexcept = default;

std::span<const StreamEpoch> MeasurementStream::push(IqSpan block) {
  Impl& m = *impl_;
  m.epochs.clear();
  // Pieces that end where an epoch or a search falls due, and fit into the history.
  const std::size_t longest = m.history_size;
  while (!block.empty() || m.epoch_sample() <= m.position) {
    if (m.epoch_sample() <= m.position) {
      m.make_epoch();
      continue;
    }
    std::int64_t until = m.epoch_sample();
    if (m.searcher && m.next_search > m.position) until = std::min(until, m.next_search);
    std::size_t take = std::min(block.size(), longest);
    take = std::min(take, static_cast<std::size_t>(until - m.position));
    const IqSpan piece = block.first(take);
    const bool finite = std::all_of(piece.begin(), piece.end(),
                                    [](const Cf32& x) { return std::isfinite(x.real()) && std::isfinite(x.imag()); });
    if (finite) {
      m.advance(piece);
    } else {
      m.clean.assign(piece.begin(), piece.end());
      for (Cf32& x : m.clean) {
        if (!std::isfinite(x.real()) || !std::isfinite(x.imag())) x = Cf32{};
      }
      m.advance(m.clean);
    }
    block = block.subspan(take);
    if (m.searcher && m.position >= m.next_search &&
        m.history.size() >= static_cast<std::size_t>(m.options.search_window_s * m.options.sample_rate_hz)) {
      if (static_cast<int>(m.followers.size()) < m.options.max_cells) m.search();
      m.next_search = m.position + static_cast<std::int64_t>(m.options.search_interval_s * m.options.sample_rate_hz);
    }
  }
  return m.epochs;
}

void MeasurementStream::skip(std::int64_t samples) {
  if (samples <= 0) return;
  Impl& m = *impl_;
  const double skipped_s = static_cast<double>(samples) / m.options.sample_rate_hz;
  require(skipped_s <= kLongestSkipS, "samples", static_cast<double>(samples),
          "at most an hour of samples expected; after more, begin anew");
  m.position += samples;
  m.history.clear();
  for (Follower& f : m.followers) f.loop.skip(samples);
  if (m.searcher) {
    m.next_search = std::max(
        m.next_search, m.position + static_cast<std::int64_t>(m.options.search_window_s * m.options.sample_rate_hz));
  }
}

std::int64_t MeasurementStream::position() const noexcept { return impl_->position; }
int MeasurementStream::cells() const noexcept { return static_cast<int>(impl_->followers.size()); }

}  // namespace soopnav::lte
