// What must change, and what must not, when a capture is shifted, turned or scaled.
#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "soopnav/waveform/lte/search.hpp"
#include "waveform/lte_scene.hpp"

namespace soopnav::lte {
namespace {

using test::random_cell;

constexpr std::size_t kLength = 134400;  // 70 ms of 1.92 Msps

class SearchLaw : public ::testing::Test {
 protected:
  void SetUp() override {
    RandomStream random(1);
    for (const int id : {412, 77}) {
      cells_.push_back(random_cell(random));
      cells_.back().cell_id = id;
      cells_.back().cfo_hz = 900.0;
      cells_.back().power_db = -5.0 * static_cast<double>(cells_.size() - 1);
      cells_.back().clock_error_ppm = 3.0;
    }
    iq_ = synthesize(cells_, kBaseRateHz, kLength + 30000, noise_variance_for_snr(20.0), 2);
    reference_ = search(std::span(iq_).first(kLength));
    ASSERT_EQ(reference_.size(), 2U);
  }

  std::vector<Detection> search(IqSpan iq) {
    EXPECT_EQ(searcher_.search(iq), SearchStatus::kOk);
    return {searcher_.detections().begin(), searcher_.detections().end()};
  }

  // Everything but what the caller moves: bounds of six standard deviations of the estimates' own noise.
  void expect_moved(const std::vector<Detection>& found, double by_s, double by_hz, double time_tolerance_s,
                    double frequency_tolerance_hz) {
    ASSERT_EQ(found.size(), reference_.size());
    for (std::size_t i = 0; i < found.size(); ++i) {
      const Detection &a = reference_[i], &b = found[i];
      EXPECT_EQ(b.cell_id, a.cell_id);
      EXPECT_EQ(b.n_rb, a.n_rb);
      EXPECT_EQ(b.n_ports, a.n_ports);
      EXPECT_EQ(b.cp, a.cp);
      EXPECT_EQ(b.duplex, a.duplex);
      // Frames are not 10 ms long: what is left after whole ones of the cell's own.
      const double frame_s = kFrameS / (1.0 + 1e-6 * a.clock_error_ppm);
      EXPECT_LT(std::abs(std::remainder(b.frame_start_s - a.frame_start_s - by_s, frame_s)), time_tolerance_s);
      EXPECT_NEAR(b.cfo_hz, a.cfo_hz + by_hz, frequency_tolerance_hz);
      EXPECT_NEAR(b.clock_error_ppm, a.clock_error_ppm, time_tolerance_s / 10e-9);
      EXPECT_NEAR(b.snr_db, a.snr_db, 0.2);
    }
  }

  std::vector<CellParameters> cells_;
  std::vector<Cf32> iq_;
  std::vector<Detection> reference_;
  Searcher searcher_{{.max_cfo_hz = 30e3}};
};

TEST_F(SearchLaw, LaterCaptureMovesTheFrameStartAndTheFrameNumber) {
  for (const std::size_t k : {1U, 7U, 960U, 9601U, 19193U, 29999U}) {
    SCOPED_TRACE(k);
    const double by_s = -static_cast<double>(k) / kBaseRateHz;
    const auto found = search(std::span(iq_).subspan(k, kLength));
    expect_moved(found, by_s, 0.0, 25e-9, 1.0);
    for (std::size_t i = 0; i < found.size(); ++i) {
      const double frames = std::round((found[i].frame_start_s - reference_[i].frame_start_s - by_s) / kFrameS);
      ASSERT_TRUE(found[i].sfn && reference_[i].sfn);
      EXPECT_EQ(*found[i].sfn, (*reference_[i].sfn + static_cast<int>(frames) + 1024) % 1024);
    }
  }
}

TEST_F(SearchLaw, FrequencyShiftMovesTheCarrierOffsetAlone) {
  for (const double by_hz : {-17e3, -60.0, 333.0, 25e3}) {
    SCOPED_TRACE(by_hz);
    std::vector<Cf32> turned(iq_.begin(), iq_.begin() + kLength);
    for (std::size_t n = 0; n < turned.size(); ++n) {
      const double cycles = by_hz / kBaseRateHz * static_cast<double>(n);
      turned[n] *= Cf32(std::polar(1.0, kTwoPi * (cycles - std::floor(cycles))));
    }
    const auto found = search(turned);
    expect_moved(found, 0.0, by_hz, 5e-9, 0.5);
    for (std::size_t i = 0; i < found.size(); ++i) EXPECT_EQ(found[i].sfn, reference_[i].sfn);
  }
}

TEST_F(SearchLaw, PowersOfTwoScaleNothingAtAll) {
  for (const float scale : {0x1p-20F, 0x1p-7F, 0x1p+15F}) {
    SCOPED_TRACE(scale);
    std::vector<Cf32> scaled(iq_.begin(), iq_.begin() + kLength);
    for (Cf32& x : scaled) x *= scale;
    const auto found = search(scaled);
    ASSERT_EQ(found.size(), reference_.size());
    for (std::size_t i = 0; i < found.size(); ++i) {
      EXPECT_EQ(found[i].cell_id, reference_[i].cell_id);
      EXPECT_EQ(found[i].sfn, reference_[i].sfn);
      EXPECT_EQ(found[i].frame_start_s, reference_[i].frame_start_s);
      EXPECT_EQ(found[i].cfo_hz, reference_[i].cfo_hz);
      EXPECT_EQ(found[i].cfo_sigma_hz, reference_[i].cfo_sigma_hz);
      EXPECT_EQ(found[i].clock_error_ppm, reference_[i].clock_error_ppm);
      EXPECT_EQ(found[i].snr_db, reference_[i].snr_db);
      EXPECT_EQ(found[i].crs_statistic, reference_[i].crs_statistic);
    }
  }
}

TEST_F(SearchLaw, AmplitudeAndPhaseChangeNothing) {
  for (const Cf32 factor : {Cf32(3.7e-4F, 0.0F), Cf32(-1.0F, 0.0F), Cf32(0.0F, 211.0F), Cf32(0.6F, -0.8F)}) {
    std::vector<Cf32> scaled(iq_.begin(), iq_.begin() + kLength);
    for (Cf32& x : scaled) x *= factor;
    const auto found = search(scaled);
    expect_moved(found, 0.0, 0.0, 1e-9, 0.05);
    for (std::size_t i = 0; i < found.size(); ++i) EXPECT_EQ(found[i].sfn, reference_[i].sfn);
  }
}

TEST_F(SearchLaw, TheSameCaptureGivesTheSameBits) {
  const auto first = search(std::span(iq_).first(kLength));
  Searcher other({.max_cfo_hz = 30e3});
  ASSERT_EQ(other.search(std::span(iq_).first(kLength)), SearchStatus::kOk);
  ASSERT_EQ(other.detections().size(), first.size());
  for (std::size_t i = 0; i < first.size(); ++i) {
    EXPECT_EQ(first[i].frame_start_s, reference_[i].frame_start_s);
    EXPECT_EQ(other.detections()[i].frame_start_s, reference_[i].frame_start_s);
    EXPECT_EQ(other.detections()[i].cfo_hz, reference_[i].cfo_hz);
  }
}

TEST_F(SearchLaw, ConjugateCaptureHasNoCell) {
  // A receiver with I and Q swapped mirrors the spectrum: PSS of N_ID_2 1 and 2 change places, SSS and CRS fit nothing.
  std::vector<Cf32> mirrored(iq_.begin(), iq_.begin() + kLength);
  for (Cf32& x : mirrored) x = std::conj(x);
  EXPECT_TRUE(search(mirrored).empty());
}

}  // namespace
}  // namespace soopnav::lte
