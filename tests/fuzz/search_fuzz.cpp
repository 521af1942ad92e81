// Cell search and time of arrival over arbitrary samples and parameters: refused with a status or answered within
// range.
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <limits>
#include <stdexcept>
#include <vector>

#include "soopnav/waveform/lte/search.hpp"
#include "soopnav/waveform/lte/time_of_arrival.hpp"

namespace lte = soopnav::lte;

namespace {

void demand(bool condition) {
  if (!condition) std::abort();
}

void check_cell(const lte::Detection& cell) {
  demand(cell.cell_id >= 0 && cell.cell_id < lte::kCells);
  demand(cell.frame_start_s >= 0.0 && cell.frame_start_s < lte::kFrameS);
  demand(std::isfinite(cell.cfo_hz) && std::isfinite(cell.clock_error_ppm) && std::isfinite(cell.snr_db));
  demand(!cell.sfn || (*cell.sfn >= 0 && *cell.sfn < 1024));
}

/// The input's bytes, over and over, as 8-bit I and Q; `data[2]` chooses how many and what is wrong with them.
std::vector<soopnav::Cf32> samples(const std::uint8_t* data, std::size_t size) {
  std::vector<soopnav::Cf32> iq(data[2] % 8 == 0 ? size : 11'600 + data[2] * std::size_t{16});
  for (std::size_t i = 0; i < iq.size(); ++i) {
    const auto at = [&](std::size_t k) { return (static_cast<float>(data[k % size]) - 127.5F) / 128.0F; };
    iq[i] = {at(2 * i), at(2 * i + 1)};
  }
  if (data[2] % 16 == 1) iq[iq.size() / 2] = {std::numeric_limits<float>::quiet_NaN(), 0.0F};
  if (data[2] % 16 == 2) iq.back() = {0.0F, std::numeric_limits<float>::infinity()};
  return iq;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size < 4) return 0;
  constexpr std::array<double, 8> kRates{1.92e6, 1.92e6, 2.0e6, 1.4e6, 0.0, -1.0, 1e300, -0.0};
  lte::SearchOptions options;
  options.sample_rate_hz = kRates[data[0] % 8];
  options.max_cfo_hz = data[1] % 16 == 0 ? -1.0 : 1e3 * (data[1] % 8);
  options.max_cells = data[3] % 5;
  const auto iq = samples(data, size);
  try {
    lte::Searcher searcher(options);
    if (searcher.search(iq) == lte::SearchStatus::kOk) {
      demand(searcher.detections().size() <= static_cast<std::size_t>(options.max_cells));
      for (const auto& cell : searcher.detections()) check_cell(cell);
    }
    lte::Detection cell;
    cell.cell_id = (data[0] * 256 + data[1]) % lte::kCells;
    cell.frame_start_s = 1e-4 * (data[3] % 100);
    cell.cfo_hz = 100.0 * (data[1] - 128.0);
    lte::ToaEstimator estimator(options.sample_rate_hz);
    lte::TimeOfArrival toa;
    if (estimator.estimate(iq, cell, toa) == lte::ToaStatus::kOk) {
      demand(!toa.toa_s.empty() && toa.toa_s.size() == toa.sigma_s.size());
      for (const double toa_s : toa.toa_s) demand(std::isfinite(toa_s));
      for (const double sigma_s : toa.sigma_s) demand(sigma_s > 0.0);
    }
  } catch (const std::invalid_argument&) {
    demand(options.sample_rate_hz < 1.4e6 || options.sample_rate_hz > 100e6 || options.max_cfo_hz < 0.0 ||
           options.max_cells < 1);
  }
  return 0;
}
