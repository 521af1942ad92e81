#include "waveform/lte/mib_reader.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "waveform/lte/kernels.hpp"

namespace soopnav::lte {

namespace {
constexpr int kElements = 24;
constexpr int kCentral = 72;
constexpr std::array<int, 3> kPortCounts{1, 2, 4};
}  // namespace

MibReader::MibReader() : observation_(std::make_unique<PbchObservation>()), average_(kElements) {
  Eigen::VectorXd all(kCentral);
  for (int k = 0; k < kCentral; ++k) all(k) = k < 36 ? k - 36 : k - 35;
  for (int offset = 0; offset < 3; ++offset) {
    Eigen::VectorXd f(kElements);
    for (int j = 0; j < kElements; ++j) {
      const int centred = 3 * j + offset - 36;
      f(j) = centred < 0 ? centred : centred + 1;
    }
    comb_.emplace_back(f, -1.0e-6, 4.0e-6, 1e-2);
    comb_.back().set_targets(all);
  }
}

void MibReader::equalise(IqSpan iq, const LinkState& state, CrsTracker& tracker, const LinkTracker& link, int reach) {
  for (auto& soft : soft_) soft.clear();
  indices_.clear();
  const auto& frames = tracker.frames();
  const DelaySubspace& subspace = comb_[static_cast<std::size_t>(tracker.first_offset())];
  Demodulator& demodulator = tracker.demodulator();
  demodulator.set_frequency(state.frequency);
  for (std::size_t f = 0; f < frames.size(); ++f) {
    bool whole = true;
    for (int symbol = 0; symbol < 4 && whole; ++symbol) {
      whole = demodulator.transform(iq, tracker.useful_start(state, frames[f].index, 1, symbol), tracker.back());
      if (whole) demodulator.subcarriers(kCentral / 2, observation_->received[static_cast<std::size_t>(symbol)].data());
    }
    if (!whole || (!indices_.empty() && frames[f].index != indices_.back() + 1)) {
      if (indices_.empty()) continue;
      break;
    }
    const double own = link.frames()[f].phase;
    const std::size_t low = f >= static_cast<std::size_t>(reach) ? f - static_cast<std::size_t>(reach) : 0;
    const std::size_t high = std::min(frames.size(), f + static_cast<std::size_t>(reach) + 1);
    for (int port = 0; port < tracker.cell().n_ports; ++port) {
      std::fill(average_.begin(), average_.end(), Cf32{});
      float weight = 0.0F;
      for (std::size_t g = low; g < high; ++g) {
        const double phase = 2.0 * std::numbers::pi * (own - link.frames()[g].phase);
        const auto w = static_cast<float>(frames[g].symbols);
        const Cf32 turn(w * static_cast<float>(std::cos(phase)), w * static_cast<float>(std::sin(phase)));
        const Cf32* x = tracker.channel(g, port);
        for (std::size_t j = 0; j < kElements; ++j) average_[j] += kernels::multiply(x[j], turn);
        weight += w;
      }
      for (Cf32& x : average_) x /= weight;
      auto& channel = observation_->channel[static_cast<std::size_t>(port)];
      subspace.interpolate(average_.data(), channel[0].data());
      for (std::size_t symbol = 1; symbol < 4; ++symbol) channel[symbol] = channel[0];
    }
    observation_->noise_variance = static_cast<float>(std::max(tracker.noise_variance(), 1e-12));
    for (std::size_t i = 0; i < kPortCounts.size(); ++i) {
      if (kPortCounts[i] > tracker.cell().n_ports) continue;
      soft_[i].emplace_back();
      demodulate_pbch(*observation_, tracker.cell().cell_id, tracker.cell().cp, kPortCounts[i], soft_[i].back());
    }
    indices_.push_back(frames[f].index);
  }
}

std::optional<MibReader::Result> MibReader::read(IqSpan iq, const LinkState& state, CrsTracker& tracker,
                                                 const LinkTracker& link) {
  // As many ports as carry reference signals clearly above noise come first, then the others.
  const auto power = [&](int port) { return kernels::energy(link.mean_channel(port), kElements) / kElements; };
  const auto heard = [&](int port) { return power(port) > std::max(6.0 * link.mean_channel_noise(), 0.05 * power(0)); };
  const std::size_t likely = heard(2) && heard(3) ? 2 : heard(1) ? 1 : 0;
  std::array<std::size_t, 3> order{likely, likely == 1 ? 0U : 1U, likely == 2 ? 0U : 2U};
  // The channel of one frame follows fading; that of seven frames is quieter.
  for (const int reach : {0, 3}) {
    equalise(iq, state, tracker, link, reach);
    if (indices_.empty()) return std::nullopt;
    for (const std::size_t i : order) {
      if (soft_[i].empty()) continue;
      const auto result = decoder_.decode(soft_[i], tracker.cell().cell_id, tracker.cell().cp, kPortCounts[i]);
      if (result) return Result{result->mib, result->n_ports, indices_.front()};
    }
  }
  return std::nullopt;
}

}  // namespace soopnav::lte
