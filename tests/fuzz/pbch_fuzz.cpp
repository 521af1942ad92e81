// PBCH decoding of arbitrary soft bits, finite or not: whatever is decoded is a valid block that packs to itself.
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <vector>

#include "soopnav/waveform/lte/pbch.hpp"

namespace lte = soopnav::lte;

namespace {

void demand(bool condition) {
  if (!condition) std::abort();
}

bool is_bandwidth(int n_rb) {
  for (const int known : lte::kBandwidthsRb) {
    if (n_rb == known) return true;
  }
  return false;
}

void check_mib(const lte::MasterInformationBlock& mib) {
  demand(is_bandwidth(mib.n_rb));
  demand(mib.sfn >= 0 && mib.sfn < 1024);
  demand(mib.phich_resource >= 0 && mib.phich_resource < 4);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size < 4) return 0;
  const int cell_id = (data[0] * 256 + data[1]) % lte::kCells;
  const auto cp = data[2] % 2 == 0 ? lte::CyclicPrefix::kNormal : lte::CyclicPrefix::kExtended;
  constexpr std::array<int, 3> kPorts{1, 2, 4};
  const int n_ports = kPorts[data[2] / 2 % 3];
  const std::size_t n_frames = data[3] % 9;
  data += 4;
  size -= 4;

  lte::MibBits bits{};
  for (std::size_t i = 0; i < bits.size(); ++i) bits[i] = size == 0 ? 0 : data[i % size] & 1U;
  if (const auto mib = lte::unpack_mib(bits)) {
    check_mib(*mib);
    demand(lte::pack_mib(*mib) == bits);
  }

  // Soft bits: the input's bytes as floats of any kind, over and over; then the same on the scale of real ones.
  std::vector<lte::PbchSoftBits> frames(n_frames);
  for (const bool raw : {true, false}) {
    std::size_t at = 0;
    for (auto& frame : frames) {
      for (auto& value : frame) {
        std::uint32_t word = 0;
        for (int k = 0; k < 4; ++k) word = word << 8U | (size == 0 ? 0U : data[at++ % size]);
        std::memcpy(&value, &word, sizeof value);
        if (!raw) value = static_cast<float>(word & 0xFFU) / 16.0F - 8.0F;
      }
    }
    lte::PbchDecoder decoder;
    if (const auto result = decoder.decode(frames, cell_id, cp, n_ports)) {
      check_mib(result->mib);
      demand(result->n_ports == n_ports);
      demand(std::isfinite(result->margin));
    }
  }
  return 0;
}
