// Rates of the cell search, fixed seeds, and weak cells below strong ones. Longer runs: cell_search_slow_test.cpp.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <set>
#include <string>
#include <vector>

#include "soopnav/dsp/resample.hpp"
#include "soopnav/waveform/lte/time_of_arrival.hpp"
#include "waveform/cell_search_rates.hpp"
#include "waveform/lte/cell_test.hpp"
#include "waveform/lte/frame_layout.hpp"
#include "waveform/lte/pss_correlator.hpp"

namespace soopnav::lte {
namespace {

using test::find;
using test::random_cell;
using test::search_rates;
using test::SearchRates;
using test::wrapped_s;

// The bar is a rate of 0.9. In 60 trials a true rate of 0.96 gives fewer than 50 with probability below 1e-4
// (binomial).
constexpr int kRuns = 60, kAtLeast = 50;

TEST(SearchSensitivity, IdentityAtMinusFourteenDecibelsWithSyncOnBothPorts) {
  const SearchRates rates = search_rates(kRuns, -14.0, SyncPorts::kAll, 1);
  EXPECT_GE(rates.found, kAtLeast);
  EXPECT_EQ(rates.misread, 0);
  EXPECT_EQ(rates.false_cells, 0);
}

TEST(SearchSensitivity, IdentityAtMinusTwelveDecibelsWithSyncOnOnePort) {
  const SearchRates rates = search_rates(kRuns, -12.0, SyncPorts::kFirst, 2);
  EXPECT_GE(rates.found, kAtLeast);
  EXPECT_EQ(rates.misread, 0);
  EXPECT_EQ(rates.false_cells, 0);
}

TEST(SearchSensitivity, BroadcastChannelAtMinusTenDecibels) {
  for (const SyncPorts ports : {SyncPorts::kFirst, SyncPorts::kAll}) {
    const SearchRates rates = search_rates(kRuns, -10.0, ports, 3);
    EXPECT_GE(rates.found, kAtLeast);
    EXPECT_GE(rates.decoded, kAtLeast);
    EXPECT_EQ(rates.misread, 0);
    EXPECT_EQ(rates.false_cells, 0);
  }
}

TEST(SearchSensitivity, HasAnEnd) {
  // Six decibels further down the signal is gone: the rates above measure the search, not the test.
  const SearchRates rates = search_rates(20, -20.0, SyncPorts::kFirst, 4);
  EXPECT_LT(rates.found, 4);
  EXPECT_EQ(rates.misread, 0);
}

TEST(SearchFalseAlarm, NoiseHoldsNoCell) {
  EXPECT_EQ(test::cells_in_noise(60, 3e3, 5), 0);
  EXPECT_EQ(test::cells_in_noise(10, 150e3, 6), 0);
}

TEST(SearchConsistency, ReportedDeviationsAreThoseOfTheErrors) {
  // 60 trials: the mean of a chi-square variable of one degree lies in 0.4 ... 2.0 with probability 1 - 1e-4.
  RandomStream random(7);
  Searcher searcher({.max_cfo_hz = 3e3, .decode_mib = false});
  double cfo = 0.0, clock = 0.0;
  constexpr int kTrials = 60;
  for (int i = 0; i < kTrials; ++i) {
    CellParameters cell = random_cell(random);
    cell.cfo_hz = random.uniform(-2e3, 2e3);
    cell.clock_error_ppm = random.uniform(-10.0, 10.0);
    const auto iq = synthesize({&cell, 1}, kBaseRateHz, 115200, noise_variance_for_snr(5.0), random.next_u64());
    ASSERT_EQ(searcher.search(iq), SearchStatus::kOk);
    const Detection* d = find(searcher.detections(), cell.cell_id);
    ASSERT_NE(d, nullptr);
    cfo += std::pow((d->cfo_hz - cell.cfo_hz) / d->cfo_sigma_hz, 2) / kTrials;
    clock += std::pow((d->clock_error_ppm - cell.clock_error_ppm) / d->clock_error_sigma_ppm, 2) / kTrials;
  }
  EXPECT_GT(cfo, 0.4);
  EXPECT_LT(cfo, 2.0);
  EXPECT_GT(clock, 0.4);
  EXPECT_LT(clock, 2.0);
}

// Three cells of 100 resource blocks at 0, -8 and -14 dB, 80 ms: the weakest lies below the other two's correlations.
class ThreeCells : public ::testing::Test {
 protected:
  static constexpr double kRateHz = 30.72e6;

  void SetUp() override {
    RandomStream random(8);
    const double first_s = random.uniform(1e-3, 8e-3);
    for (const int id : {30, 31, 182}) {
      cells_.push_back(random_cell(random, 100));
      CellParameters& cell = cells_.back();
      cell.cell_id = id;
      cell.start_sfn = 200;
      cell.cfo_hz = 500.0;
    }
    cells_[0].delay_s = first_s;
    cells_[1].delay_s = first_s + 0.83e-6;
    cells_[2].delay_s = first_s + 2.71e-6;
    cells_[1].power_db = -8.0;
    cells_[2].power_db = -14.0;
    iq_ = synthesize(cells_, kRateHz, static_cast<std::size_t>(80e-3 * kRateHz), noise_variance_for_snr(25.0), 9);
  }

  std::vector<CellParameters> cells_;
  std::vector<Cf32> iq_;
};

TEST_F(ThreeCells, AllAreFoundAndTheirDelayDifferencesHold) {
  Searcher searcher({.sample_rate_hz = kRateHz});
  ASSERT_EQ(searcher.search(iq_), SearchStatus::kOk);
  ASSERT_EQ(searcher.detections().size(), 3U);
  ToaEstimator estimator(kRateHz);
  std::array<double, 3> toa_s{};
  for (std::size_t i = 0; i < 3; ++i) {
    const Detection& d = searcher.detections()[i];  // strongest first
    ASSERT_EQ(d.cell_id, cells_[i].cell_id);
    EXPECT_EQ(d.n_rb, 100);
    EXPECT_EQ(d.n_ports, 2);
    EXPECT_EQ(d.sfn, 200);
    TimeOfArrival toa;
    ASSERT_EQ(estimator.estimate(iq_, d, toa), ToaStatus::kOk);
    toa_s[i] = std::accumulate(toa.toa_s.begin(), toa.toa_s.end(), 0.0) / static_cast<double>(toa.toa_s.size());
  }
  const auto tdoa_error_m = [&](std::size_t i) {
    return kSpeedOfLightMps * wrapped_s((toa_s[i] - toa_s[0]) - (cells_[i].delay_s - cells_[0].delay_s));
  };
  RecordProperty("tdoa_error_m_8_db", std::to_string(tdoa_error_m(1)));
  RecordProperty("tdoa_error_m_14_db", std::to_string(tdoa_error_m(2)));
  EXPECT_LT(std::abs(tdoa_error_m(1)), 0.25);
  EXPECT_LT(std::abs(tdoa_error_m(2)), 0.5);
}

TEST_F(ThreeCells, TheWeakestIsNotThereWithoutCancelling) {
  const auto base =
      dsp::resample(iq_, kRateHz, kBaseRateHz, {.passband = 0.72, .stopband = 1.28, .attenuation_db = 60.0});
  PssCorrelator correlator({.max_cfo_hz = 4.5e3,
                            .spacing_hz = 3e3,
                            .inverse_size = 10240,
                            .max_drift_ppm = 0.0,
                            .max_half_frames = 16,
                            .in_band = true});
  for (std::size_t at = 0; at + kSearchFft < base.size(); at += kHalfFrameSamples) correlator.add(base, at);
  std::vector<PssCandidate> candidates;
  correlator.peaks(24, candidates);
  ASSERT_EQ(candidates.size(), 24U);
  const double pss_at = pss_in_half_frame(Duplex::kFdd, CyclicPrefix::kNormal);
  const auto away = [&](const PssCandidate& c, std::size_t cell) {
    return std::abs(std::remainder(c.tau - cells_[cell].delay_s * kBaseRateHz - pss_at, 1.0 * kHalfFrameSamples));
  };
  EXPECT_EQ(candidates[0].n_id_2, 0);  // the strongest cell is
  EXPECT_LT(away(candidates[0], 0), 1.0);
  for (std::size_t i = 0; i < 10; ++i) {
    EXPECT_FALSE(candidates[i].n_id_2 == 2 && away(candidates[i], 2) < 3.0) << "candidate " << i;
  }
  // Nor does testing every one of them find it.
  CellTest cell_test;
  std::vector<ConfirmedCell> confirmed;
  for (const PssCandidate& candidate : candidates) {
    cell_test.examine(
        base, candidate, true, [](int) { return false; }, confirmed);
  }
  std::set<int> ids;
  for (const ConfirmedCell& cell : confirmed) ids.insert(cell.cell_id);
  EXPECT_EQ(ids.count(30), 1U);
  EXPECT_EQ(ids.count(182), 0U);
}

}  // namespace
}  // namespace soopnav::lte
