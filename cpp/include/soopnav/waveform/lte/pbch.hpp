#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>

#include "soopnav/waveform/lte/types.hpp"

namespace soopnav::lte {

/// Master information block (TS 36.331): what the PBCH says.
struct MasterInformationBlock {
  int n_rb = 6;                 ///< 6, 15, 25, 50, 75 or 100
  int sfn = 0;                  ///< 0 ... 1023; only sfn / 4 is in the payload
  bool extended_phich = false;  ///< PHICH duration
  int phich_resource = 2;       ///< N_g: 0 = 1/6, 1 = 1/2, 2 = 1, 3 = 2
  std::uint16_t spare = 0;      ///< ten bits
};

using MibBits = std::array<std::uint8_t, 24>;  ///< first transmitted bit first

/// The 24 bits of `mib`. Fields out of range give a reserved bandwidth or lose their high bits; `encode_pbch` refuses
/// them.
[[nodiscard]] MibBits pack_mib(const MasterInformationBlock& mib) noexcept;
/// nullopt when the bandwidth field is one of the two reserved values. `sfn` comes back as a multiple of 4.
[[nodiscard]] std::optional<MasterInformationBlock> unpack_mib(const MibBits& bits) noexcept;

/// Bits of one frame's PBCH: 480 with the normal cyclic prefix, 432 with the extended one.
[[nodiscard]] constexpr int pbch_bits_per_frame(CyclicPrefix cp) noexcept {
  return cp == CyclicPrefix::kNormal ? 480 : 432;
}

/// One element of the PBCH: symbol 0 ... 3 of slot 1, subcarrier 0 ... 71 of the central six resource blocks.
struct PbchElement {
  std::uint8_t symbol;
  std::uint8_t subcarrier;
};

/// Elements of the PBCH in mapping order (TS 36.211 6.6.4): reference elements of four ports are always left out.
/// 240 (normal) or 216 (extended) are valid; returns their number. `cell_id`: 0 ... 503.
int pbch_elements(int cell_id, CyclicPrefix cp, std::span<PbchElement, 240> out) noexcept;

/// CRC with the port mask (TS 36.212 5.3.1.1), tail-biting convolutional code (5.1.3.1), rate matching (5.1.4.2) and
/// scrambling (TS 36.211 6.6.1): the bits of the four frames of `mib`'s 40 ms. `out` holds
/// 4 * pbch_bits_per_frame(cp); `n_ports` is 1, 2 or 4. No allocation.
/// @throws std::invalid_argument naming the argument that is out of range.
void encode_pbch(const MasterInformationBlock& mib, int cell_id, int n_ports, CyclicPrefix cp,
                 std::span<std::uint8_t> out);

/// What equalisation needs of one frame's PBCH: received elements, channel of each port, noise.
struct PbchObservation {
  std::array<std::array<Cf32, 72>, 4> received;                        ///< [symbol of slot 1][subcarrier]
  std::array<std::array<std::array<Cf32, 72>, 4>, kMaxPorts> channel;  ///< [port][symbol][subcarrier]
  float noise_variance = 1.0F;                                         ///< of one element, > 0
};

/// Soft bits of one frame, scrambled as received: log P(0)/P(1), first bit first. Only 432 count with the extended
/// prefix.
using PbchSoftBits = std::array<float, 480>;

/// Undoes the transmit diversity of 1, 2 (SFBC) or 4 (SFBC-FSTD) ports (TS 36.211 6.3.3.3, 6.3.4.3) by maximum-ratio
/// combining, the channel taken as equal over the two elements of a pair; QPSK soft bits out. `cell_id`: 0 ... 503;
/// `n_ports`: 1, 2 or 4. Unused entries of `out` are zero. No allocation.
void demodulate_pbch(const PbchObservation& observation, int cell_id, CyclicPrefix cp, int n_ports, PbchSoftBits& out);

/// A decoded broadcast channel.
struct PbchResult {
  MasterInformationBlock mib;  ///< `sfn` is that of frames[0] (all ten bits)
  int n_ports = 1;
  double margin = 0.0;  ///< soft bits' correlation with the re-encoded word over its standard deviation without signal
};

/// Decodes the PBCH from the soft bits of consecutive radio frames, combining within a 40 ms period and across its
/// border (the counter's step changes known bits of the linear code, whichever of its carry patterns it is).
///
/// Each of the four phases of the period is tried, then each pattern of carries, over windows of 8, 16 and 32 frames; a
/// strong signal ends that at once, 2000 attempts end it in any case. One attempt is a tail-biting Viterbi search;
/// where its CRC fails although a word of the code could still correlate well enough, the best of the words with a
/// right CRC is sought by ordered statistics (cpp/doc/pbch_decoding.md).
///
/// The scratch is made by the constructor: `decode` allocates nothing. One object per thread.
class PbchDecoder {
 public:
  PbchDecoder();
  ~PbchDecoder();
  PbchDecoder(PbchDecoder&&) noexcept;
  PbchDecoder& operator=(PbchDecoder&&) noexcept;

  /// `frames`: soft bits of consecutive frames, as equalised for `n_ports`; the word must carry that number's CRC mask.
  /// A word also has to agree with the soft bits: without signal the `margin` of the best of all words stays below 7.7
  /// (8 frames or fewer; 8.15 after that) but for one call in 10^5. Soft bits that promise much more than the word
  /// explains (those of another number of ports, say) are refused as well, so their scale should be right to 1.5 times.
  /// Frames with a NaN or an infinity are left out. nullopt when nothing was found, or when `cell_id` is not 0 ... 503
  /// or `n_ports` not 1, 2 or 4.
  [[nodiscard]] std::optional<PbchResult> decode(std::span<const PbchSoftBits> frames, int cell_id, CyclicPrefix cp,
                                                 int n_ports);

 private:
  struct Scratch;
  std::unique_ptr<Scratch> scratch_;
};

}  // namespace soopnav::lte
