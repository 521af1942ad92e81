#include <cstdint>

#include "soopnav/waveform/cdma/pilot_code.hpp"
#include "soopnav/waveform/gps/ca_code.hpp"
#include "soopnav/waveform/tracking/tracker.hpp"

namespace soopnav::tracking {

Signal Signal::gps_l1(int prn) {
  Signal signal;
  for (const std::int8_t chip : gps::ca_code(prn)) signal.chips.emplace_back(static_cast<float>(chip), 0.0F);
  signal.chip_rate_hz = gps::kChipRateHz;
  signal.carrier_hz = gps::kCarrierHz;
  signal.symbol_s = gps::kBitPeriodS;
  return signal;
}

Signal Signal::cdma_pilot(double carrier_hz, int pn_offset) {
  Signal signal;
  signal.chips = cdma::pilot_code(pn_offset);
  signal.chip_rate_hz = cdma::kChipRateHz;
  signal.carrier_hz = carrier_hz;
  return signal;
}

}  // namespace soopnav::tracking
