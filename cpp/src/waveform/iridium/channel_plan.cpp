#include "soopnav/waveform/iridium/channel_plan.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

namespace soopnav::iridium {
namespace {

double centre_hz(int channel) { return kBandStartHz + (channel - 0.5) * kChannelSpacingHz; }

void check_channel(int channel) {
  if (channel < 1 || channel > kChannels) {
    throw std::invalid_argument("channel = " + std::to_string(channel) + " must be in 1 ... 252");
  }
}

}  // namespace

double channel_frequency_hz(int channel) {
  check_channel(channel);
  return centre_hz(channel);
}

ChannelUse channel_use(int channel) {
  check_channel(channel);
  switch (channel - kDuplexChannels) {
    case 7:
      return ChannelUse::kRingAlert;
    case 3:
    case 4:
    case 10:
    case 11:
      return ChannelUse::kMessaging;
    default:
      return channel > kDuplexChannels ? ChannelUse::kGuard : ChannelUse::kDuplex;
  }
}

std::size_t channel_candidates(double received_hz, std::span<ChannelCandidate> out, double max_doppler_hz) noexcept {
  if (!std::isfinite(received_hz) || !(max_doppler_hz >= 0.0) || out.empty()) return 0;
  std::size_t count = 0;
  // Channel numbers go outwards from the nearest, so the list is in order.
  const double at = (received_hz - kBandStartHz) / kChannelSpacingHz + 0.5;
  const double nearest = std::clamp(std::round(at), 1.0, static_cast<double>(kChannels));
  int low = static_cast<int>(nearest), high = low + 1;
  while (count < out.size()) {
    const double below = low >= 1 ? std::abs(received_hz - centre_hz(low)) : HUGE_VAL;
    const double above = high <= kChannels ? std::abs(received_hz - centre_hz(high)) : HUGE_VAL;
    const bool down = below <= above;
    if (!(std::min(below, above) <= max_doppler_hz) || (low < 1 && high > kChannels)) break;
    const int channel = down ? low-- : high++;
    out[count++] = {channel, centre_hz(channel), received_hz - centre_hz(channel)};
  }
  return count;
}

}  // namespace soopnav::iridium
