// Searcher and SubframeToaEstimator leave the heap alone once they have seen a capture of the length.
#include <gtest/gtest.h>

#include <optional>
#include <vector>

#include "soopnav/waveform/lte/search.hpp"
#include "soopnav/waveform/lte/time_of_arrival.hpp"
#include "support/allocation_count.hpp"
#include "waveform/lte_scene.hpp"

namespace soopnav::lte {
namespace {

using soopnav::test::allocations_of;
using soopnav::test::kAllocationsCounted;

std::vector<Cf32> two_cells(double rate_hz, std::size_t n) {
  RandomStream random(1);
  std::vector<CellParameters> cells{test::random_cell(random), test::random_cell(random)};
  cells[0].cell_id = 12;
  cells[1].cell_id = 205;
  cells[1].power_db = -5.0;
  return synthesize(cells, rate_hz, n, noise_variance_for_snr(15.0), 2);
}

TEST(ReceiverNoAlloc, LaterSearches) {
  if (!kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  for (const double rate_hz : {1.92e6, 2.4e6}) {
    for (const double max_cfo_hz : {3e3, 50e3}) {
      const auto iq = two_cells(rate_hz, static_cast<std::size_t>(60e-3 * rate_hz));
      Searcher searcher({.sample_rate_hz = rate_hz, .max_cfo_hz = max_cfo_hz});
      ASSERT_EQ(searcher.search(iq), SearchStatus::kOk);
      ASSERT_EQ(searcher.detections().size(), 2U);
      EXPECT_EQ(allocations_of([&] { static_cast<void>(searcher.search(iq)); }), 0) << rate_hz << ' ' << max_cfo_hz;
    }
  }
}

TEST(ReceiverNoAlloc, StreamAfterItsFirstWindow) {
  if (!kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  const auto iq = two_cells(1.92e6, 115200);
  Searcher searcher({.max_cfo_hz = 3e3, .window_s = 30e-3});
  ASSERT_FALSE(searcher.push(std::span(iq).first(57600)).empty());
  std::size_t found = 0;
  EXPECT_EQ(allocations_of([&] {
              for (std::size_t at = 57600; at < iq.size(); at += 1921) {
                found += searcher.push(std::span(iq).subspan(at, std::min<std::size_t>(1921, iq.size() - at))).size();
              }
            }),
            0);
  EXPECT_EQ(found, 2U);
}

TEST(ReceiverNoAlloc, SubframeTimeOfArrival) {
  if (!kAllocationsCounted) GTEST_SKIP() << "allocations are not counted in this build";
  RandomStream random(3);
  for (const int n_ports : {1, 2, 4}) {
    CellParameters cell = test::random_cell(random, 100, n_ports);
    cell.delay_s = 20e-6;
    const auto iq = synthesize({&cell, 1}, 30.72e6, 33792, noise_variance_for_snr(15.0), 4);
    SubframeToaEstimator estimator(30.72e6, test::truth(cell));
    ASSERT_TRUE(estimator.estimate(iq, 0, 20e-6, 0.0));
    std::optional<SubframeToa> toa;
    EXPECT_EQ(allocations_of([&] { toa = estimator.estimate(iq, 0, 20e-6, 0.0); }), 0) << n_ports;
    EXPECT_TRUE(toa);
    EXPECT_EQ(allocations_of([&] { toa = estimator.estimate(std::span(iq).first(100), 0, 20e-6, 0.0); }), 0);
    EXPECT_FALSE(toa);
  }
}

}  // namespace
}  // namespace soopnav::lte
