#include "soopnav/waveform/lte/pbch.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <stdexcept>
#include <string>

#include "soopnav/waveform/lte/sequences.hpp"
#include "waveform/lte/pbch_code.hpp"

namespace soopnav::lte {

MibBits pack_mib(const MasterInformationBlock& mib) noexcept {
  const auto found = std::find(kBandwidthsRb.begin(), kBandwidthsRb.end(), mib.n_rb);
  const auto bandwidth = static_cast<unsigned>(found - kBandwidthsRb.begin());
  MibBits bits{};
  std::size_t place = 0;
  const auto put = [&](unsigned value, unsigned width) {
    for (unsigned i = width; i-- > 0;) bits[place++] = static_cast<std::uint8_t>((value >> i) & 1U);
  };
  put(bandwidth, 3);
  put(mib.extended_phich ? 1U : 0U, 1);
  put(static_cast<unsigned>(mib.phich_resource), 2);
  put(static_cast<unsigned>(mib.sfn) / 4U, 8);
  put(mib.spare, 10);
  return bits;
}

std::optional<MasterInformationBlock> unpack_mib(const MibBits& bits) noexcept {
  std::size_t place = 0;
  const auto take = [&](unsigned width) {
    unsigned value = 0;
    for (unsigned i = 0; i < width; ++i) value = (value << 1) | bits[place++];
    return value;
  };
  const unsigned bandwidth = take(3);
  if (bandwidth >= kBandwidthsRb.size()) return std::nullopt;
  MasterInformationBlock mib;
  mib.n_rb = kBandwidthsRb[bandwidth];
  mib.extended_phich = take(1) != 0U;
  mib.phich_resource = static_cast<int>(take(2));
  mib.sfn = 4 * static_cast<int>(take(8));
  mib.spare = static_cast<std::uint16_t>(take(10));
  return mib;
}

int pbch_elements(int cell_id, CyclicPrefix cp, std::span<PbchElement, 240> out) noexcept {
  const int last_crs = symbols_per_slot(cp) - 3;
  std::size_t n = 0;
  for (int symbol = 0; symbol < 4; ++symbol) {
    const bool crs = symbol <= 1 || symbol == last_crs;
    int to_crs = cell_id % 3;  // subcarriers up to the next one that a port of four may use: every third
    for (int subcarrier = 0; subcarrier < 72; ++subcarrier, --to_crs) {
      if (to_crs == 0) {
        to_crs = 3;
        if (crs) continue;
      }
      out[n++] = {static_cast<std::uint8_t>(symbol), static_cast<std::uint8_t>(subcarrier)};
    }
  }
  return static_cast<int>(n);
}

void encode_pbch(const MasterInformationBlock& mib, int cell_id, int n_ports, CyclicPrefix cp,
                 std::span<std::uint8_t> out) {
  const auto refuse = [](const char* name, int value, const char* rule) {
    throw std::invalid_argument(std::string(name) + ": " + std::to_string(value) + ", must be " + rule);
  };
  if (std::find(kBandwidthsRb.begin(), kBandwidthsRb.end(), mib.n_rb) == kBandwidthsRb.end()) {
    refuse("mib.n_rb", mib.n_rb, "6, 15, 25, 50, 75 or 100");
  }
  if (mib.sfn < 0 || mib.sfn > 1023) refuse("mib.sfn", mib.sfn, "0 ... 1023");
  if (mib.phich_resource < 0 || mib.phich_resource > 3) refuse("mib.phich_resource", mib.phich_resource, "0 ... 3");
  if (mib.spare > 1023) refuse("mib.spare", mib.spare, "0 ... 1023");
  if (cell_id < 0 || cell_id >= kCells) refuse("cell_id", cell_id, "0 ... 503");
  if (n_ports != 1 && n_ports != 2 && n_ports != 4) refuse("n_ports", n_ports, "1, 2 or 4");
  const auto n_bits = static_cast<std::size_t>(4 * pbch_bits_per_frame(cp));
  if (out.size() != n_bits) {
    refuse("out", static_cast<int>(out.size()), "1920 bits (normal cyclic prefix) or 1728 (extended)");
  }

  const MibBits bits = pack_mib(mib);
  std::uint32_t payload = 0;
  for (std::size_t i = 0; i < bits.size(); ++i) payload |= std::uint32_t{bits[i]} << i;
  const detail::CodedWord word = detail::encode_linear(payload) ^ detail::mask_word(n_ports);
  GoldSequence scrambling(static_cast<std::uint32_t>(cell_id));
  for (std::size_t first = 0; first < n_bits; first += 32) {
    const std::uint32_t c = scrambling.next_word();
    for (std::size_t i = first; i < std::min(first + 32, n_bits); ++i) {
      out[i] = static_cast<std::uint8_t>((word.bit(i % detail::kCodedBits) ? 1U : 0U) ^ ((c >> (i - first)) & 1U));
    }
  }
}

namespace {

// conj(h) * r without the checks for infinities that the library's product makes.
inline Cf32 conj_times(Cf32 h, Cf32 r) noexcept {
  return {h.real() * r.real() + h.imag() * r.imag(), h.real() * r.imag() - h.imag() * r.real()};
}

}  // namespace

void demodulate_pbch(const PbchObservation& observation, int cell_id, CyclicPrefix cp, int n_ports, PbchSoftBits& out) {
  std::array<PbchElement, 240> elements;
  const auto n = static_cast<std::size_t>(pbch_elements(cell_id, cp, elements));
  // A bit has amplitude 1/sqrt(2), an element's real part noise of variance N0 / 2: log P(0)/P(1) = 2 sqrt(2) Re{h* r}
  // / N0. Transmit diversity takes another 1/sqrt(2) of the amplitude (TS 36.211 6.3.4.3).
  const float scale =
      (n_ports == 1 ? 2.0F * static_cast<float>(std::numbers::sqrt2) : 2.0F) / observation.noise_variance;
  const auto received = [&](PbchElement e) { return observation.received[e.symbol][e.subcarrier]; };
  const auto channel = [&](std::size_t port, PbchElement e) {
    return observation.channel[port][e.symbol][e.subcarrier];
  };
  const auto put = [&](std::size_t symbol, Cf32 z) {
    out[2 * symbol] = scale * z.real();
    out[2 * symbol + 1] = scale * z.imag();
  };
  if (n_ports == 1) {
    for (std::size_t i = 0; i < n; ++i) put(i, conj_times(channel(0, elements[i]), received(elements[i])));
  } else {
    // Element pair (i, i + 1): one port sends x_i then x_{i+1}, the other -x_{i+1}* then x_i*. With four ports, ports
    // 0 and 2 send the first pair of each four elements, ports 1 and 3 the second.
    for (std::size_t i = 0; i < n; i += 2) {
      const std::size_t first = n_ports == 4 && i % 4 != 0 ? 1 : 0;
      const std::size_t second = n_ports == 4 ? first + 2 : 1;
      const PbchElement p = elements[i], q = elements[i + 1];
      const Cf32 rp = received(p), rq = received(q);
      put(i, conj_times(channel(first, p), rp) + std::conj(conj_times(channel(second, q), rq)));
      put(i + 1, conj_times(channel(first, q), rq) - std::conj(conj_times(channel(second, p), rp)));
    }
  }
  std::fill(out.begin() + static_cast<std::ptrdiff_t>(2 * n), out.end(), 0.0F);
}

}  // namespace soopnav::lte
