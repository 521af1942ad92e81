// The rates of cell_search_consistency_test.cpp over the numbers of trials that the requirements name. Minutes.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <vector>

#include "soopnav/waveform/lte/search.hpp"
#include "waveform/cell_search_rates.hpp"

namespace soopnav::lte {
namespace {

using test::random_cell;
using test::search_rates;
using test::SearchRates;

// 500 trials: a true rate of 0.96 gives fewer than 462 with probability below 1e-4, and 462 / 500 is above 0.9.
constexpr int kRuns = 500, kAtLeast = 462;

TEST(SearchSensitivitySlow, BothPortsAtMinusFourteen) {
  const SearchRates rates = search_rates(kRuns, -14.0, SyncPorts::kAll, 11);
  EXPECT_GE(rates.found, kAtLeast);
  EXPECT_EQ(rates.misread, 0);
  EXPECT_EQ(rates.false_cells, 0);
}

TEST(SearchSensitivitySlow, OnePortAtMinusTwelve) {
  const SearchRates rates = search_rates(kRuns, -12.0, SyncPorts::kFirst, 12);
  EXPECT_GE(rates.found, kAtLeast);
  EXPECT_EQ(rates.misread, 0);
  EXPECT_EQ(rates.false_cells, 0);
}

TEST(SearchSensitivitySlow, BroadcastChannelAtMinusTen) {
  for (const SyncPorts ports : {SyncPorts::kFirst, SyncPorts::kAll}) {
    const SearchRates rates = search_rates(kRuns, -10.0, ports, 13);
    EXPECT_GE(rates.decoded, kAtLeast);
    EXPECT_EQ(rates.misread, 0);
    EXPECT_EQ(rates.false_cells, 0);
  }
}

TEST(SearchFalseAlarmSlow, ThreeThousandTrialsOfNoise) { EXPECT_EQ(test::cells_in_noise(3000, 3e3, 14), 0); }

TEST(SearchFalseAlarmSlow, ThreeHundredTrialsAtAnyCarrierOffset) { EXPECT_EQ(test::cells_in_noise(300, 150e3, 15), 0); }

TEST(SearchCancellationSlow, ThreeCellsOfAnyIdentity) {
  // 0, -8 and -14 dB. Of 40 trials a true rate of 0.96 leaves fewer than 32 with probability below 1e-4.
  RandomStream random(16);
  Searcher searcher({.sample_rate_hz = 30.72e6});
  int all = 0, others = 0;
  for (int trial = 0; trial < 40; ++trial) {
    std::vector<CellParameters> cells;
    const double first_s = random.uniform(0.0, kFrameS);
    while (cells.size() < 3) {
      CellParameters cell = random_cell(random, 100);
      bool fresh = true;
      for (const CellParameters& other : cells) fresh = fresh && other.cell_id != cell.cell_id;
      if (!fresh) continue;
      cell.delay_s = first_s + (cells.empty() ? 0.0 : random.uniform(0.0, 3e-6));
      cell.power_db = std::array{0.0, -8.0, -14.0}[cells.size()];
      cell.cfo_hz = 500.0;
      cells.push_back(cell);
    }
    const auto iq = synthesize(cells, 30.72e6, 2457600, noise_variance_for_snr(25.0), random.next_u64());
    static_cast<void>(searcher.search(iq));
    int found = 0;
    for (const CellParameters& cell : cells)
      found += test::find(searcher.detections(), cell.cell_id) != nullptr ? 1 : 0;
    others += static_cast<int>(searcher.detections().size()) - found;
    all += found == 3 ? 1 : 0;
  }
  EXPECT_GE(all, 32);
  EXPECT_EQ(others, 0);
}

}  // namespace
}  // namespace soopnav::lte
