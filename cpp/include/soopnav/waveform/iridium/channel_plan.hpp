#pragma once

#include <array>
#include <cstddef>
#include <span>

/// Iridium's L band: channels, time slots, bursts and their detection.
///
/// The air interface as published: ICAO, Manual for the Iridium aeronautical mobile satellite (route) service, part 2,
/// and what the free receivers gr-iridium and iridium-toolkit found on the air.
namespace soopnav::iridium {

inline constexpr double kBandStartHz = 1616.0e6;               ///< lower edge of the band
inline constexpr double kBandEndHz = 1626.5e6;                 ///< upper edge of the band
inline constexpr double kChannelSpacingHz = 1e6 / 24.0;        ///< 41 666.7 Hz: an eighth of a sub-band
inline constexpr int kDuplexSubBands = 30;                     ///< of 333 333 Hz, from the band's start
inline constexpr int kChannelsPerSubBand = 8;                  ///< duplex channels
inline constexpr int kDuplexChannels = 240;                    ///< numbers 1 ... 240
inline constexpr int kSimplexChannels = 12;                    ///< numbers 241 ... 252, above 1626 MHz, downlink only
inline constexpr int kChannels = 252;                          ///< all
inline constexpr int kRingAlertChannel = kDuplexChannels + 7;  ///< at 1626.270833 MHz
inline constexpr double kRingAlertHz = kBandStartHz + 246.5 * kChannelSpacingHz;  ///< 1626.270833 MHz
inline constexpr double kMaxDopplerHz = 38e3;  ///< of a satellite at 780 km seen from the ground, rounded up

inline constexpr double kSymbolRateHz = 25e3;
inline constexpr double kRollOff = 0.4;            ///< of the root-raised-cosine pulse
inline constexpr double kFrameS = 90e-3;           ///< a TDMA frame: simplex, 4 uplink and 4 downlink slots
inline constexpr double kSimplexSlotS = 20.32e-3;  ///< 508 symbols, first in the frame
inline constexpr double kDuplexSlotS = 8.28e-3;    ///< 207 symbols
inline constexpr int kDuplexSlots = 4;             ///< in each direction
inline constexpr double kGuardsS = kFrameS - kSimplexSlotS - 2.0 * kDuplexSlots * kDuplexSlotS;  ///< together, 3.44 ms

/// Centre of a channel [Hz]: 1616 MHz + (number - 1/2) / 24 MHz. Channels 1 ... 240 are duplex, eight to a sub-band;
/// 241 ... 252 are simplex, among them the ring alert, 247.
/// @throws std::invalid_argument for a number outside 1 ... 252.
[[nodiscard]] double channel_frequency_hz(int channel);

/// What a channel is for.
enum class ChannelUse {
  kDuplex,     ///< traffic and broadcast in both directions, time slots
  kRingAlert,  ///< simplex: who is called, and where the satellite is
  kMessaging,  ///< simplex: pagers (four of the twelve channels)
  kGuard,      ///< simplex: kept free
};

/// @throws std::invalid_argument for a number outside 1 ... 252.
[[nodiscard]] ChannelUse channel_use(int channel);

/// A channel that a received carrier may belong to.
struct ChannelCandidate {
  int channel = 0;            ///< 1 ... 252
  double frequency_hz = 0.0;  ///< its centre
  double doppler_hz = 0.0;    ///< received minus centre: positive when the satellite approaches
};

/// The channels whose centre lies within `max_doppler_hz` of a received carrier, nearest first; returns how many.
/// With the satellites' Doppler there are one or two, and none outside the band: the carrier alone does not say which.
/// At most `out.size()` are written. Not finite in, none out. No allocation.
std::size_t channel_candidates(double received_hz, std::span<ChannelCandidate> out,
                               double max_doppler_hz = kMaxDopplerHz) noexcept;

}  // namespace soopnav::iridium
