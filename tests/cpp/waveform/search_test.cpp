// The cell search on captures made by the synthesiser: what it reports, and what it refuses.
#include "soopnav/waveform/lte/search.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/waveform/lte/time_of_arrival.hpp"
#include "waveform/lte_scene.hpp"

namespace soopnav::lte {
namespace {

using test::find;
using test::noise;
using test::random_cell;
using test::wrapped_s;
using ::testing::HasSubstr;

std::size_t samples(double duration_s, double rate_hz) {
  return static_cast<std::size_t>(std::llround(duration_s * rate_hz));
}

std::vector<Cf32> capture(const CellParameters& cell, double rate_hz, double duration_s, double snr_db,
                          std::uint64_t seed) {
  return synthesize({&cell, 1}, rate_hz, samples(duration_s, rate_hz), noise_variance_for_snr(snr_db), seed);
}

// Identity, broadcast channel, timing and offsets of the only detection. At 15 dB the bounds on the standard deviations
// are 5 ns, 0.1 Hz and 0.15 ppm in the worst of these cases, one port in TDD with two whole subframes of 60 ms.
void expect_only(const Searcher& searcher, const CellParameters& cell) {
  ASSERT_EQ(searcher.detections().size(), 1U);
  const Detection& d = searcher.detections().front();
  EXPECT_EQ(d.cell_id, cell.cell_id);
  EXPECT_EQ(d.cp, cell.cp);
  EXPECT_EQ(d.duplex, cell.duplex);
  EXPECT_EQ(d.n_rb, cell.n_rb);
  EXPECT_EQ(d.n_ports, cell.n_ports);
  EXPECT_EQ(d.sfn, cell.start_sfn);
  EXPECT_GE(d.frame_start_s, 0.0);
  EXPECT_LT(d.frame_start_s, kFrameS);
  EXPECT_NEAR(d.frame_start_s, cell.delay_s, 0.1e-6);
  EXPECT_NEAR(d.cfo_hz, cell.cfo_hz, 5.0);
  EXPECT_NEAR(d.clock_error_ppm, cell.clock_error_ppm, 0.9);
  EXPECT_NEAR(d.clock_error_ppm, cell.clock_error_ppm, 6.0 * d.clock_error_sigma_ppm + 0.02);
}

// Every bandwidth with either cyclic prefix and duplex mode; ports, uplink-downlink and special subframe
// configurations, identity, SFN, offsets of carrier and clock (each of its own sign) by lot.
class SearchKinds : public ::testing::TestWithParam<std::tuple<int, CyclicPrefix, Duplex>> {};

TEST_P(SearchKinds, AreFoundWhole) {
  const auto [n_rb, cp, duplex] = GetParam();
  RandomStream random(static_cast<std::uint64_t>(n_rb),
                      static_cast<std::uint64_t>(cp) * 2U + static_cast<std::uint64_t>(duplex));
  Searcher searcher({});
  for (const int n_ports : {1, 2, 4}) {
    SCOPED_TRACE(n_ports);
    CellParameters cell = random_cell(random, n_rb, n_ports);
    cell.cp = cp;
    cell.duplex = duplex;
    cell.tdd_configuration = test::whole(random, 7);
    cell.special_subframe_configuration = test::whole(random, cp == CyclicPrefix::kNormal ? 10 : 8);
    cell.cfo_hz = random.uniform(-100e3, 100e3);
    cell.clock_error_ppm = random.uniform(-20.0, 20.0);
    const auto iq = capture(cell, kBaseRateHz, 60e-3, 15.0, random.next_u64());
    ASSERT_EQ(searcher.search(iq), SearchStatus::kOk);
    expect_only(searcher, cell);
  }
}

INSTANTIATE_TEST_SUITE_P(All, SearchKinds,
                         ::testing::Combine(::testing::ValuesIn(kBandwidthsRb),
                                            ::testing::Values(CyclicPrefix::kNormal, CyclicPrefix::kExtended),
                                            ::testing::Values(Duplex::kFdd, Duplex::kTdd)));

TEST(Search, EveryTddConfiguration) {
  RandomStream random(3);
  Searcher searcher({.max_cfo_hz = 5e3});
  for (int configuration = 0; configuration < 7; ++configuration) {
    SCOPED_TRACE(configuration);
    CellParameters cell = random_cell(random, 15, 2);
    cell.duplex = Duplex::kTdd;
    cell.tdd_configuration = configuration;
    cell.special_subframe_configuration = configuration;
    const auto iq = capture(cell, kBaseRateHz, 60e-3, 15.0, random.next_u64());
    ASSERT_EQ(searcher.search(iq), SearchStatus::kOk);
    expect_only(searcher, cell);
  }
}

struct RateCase {
  double rate_hz;
  int n_rb;
};

class SearchRates : public ::testing::TestWithParam<RateCase> {};

TEST_P(SearchRates, AnyRateWillDo) {
  const auto [rate_hz, n_rb] = GetParam();
  RandomStream random(4, static_cast<std::uint64_t>(rate_hz));
  CellParameters cell = random_cell(random, n_rb, 2);
  cell.cfo_hz = -21e3;
  cell.clock_error_ppm = 7.0;
  const auto iq = capture(cell, rate_hz, 60e-3, 15.0, 5);
  Searcher searcher({.sample_rate_hz = rate_hz});
  ASSERT_EQ(searcher.search(iq), SearchStatus::kOk);
  expect_only(searcher, cell);
}

INSTANTIATE_TEST_SUITE_P(All, SearchRates,
                         ::testing::Values(RateCase{1.4e6, 6}, RateCase{1.92e6, 6}, RateCase{2.048e6, 6},
                                           RateCase{2.4e6, 6}, RateCase{3.84e6, 15}, RateCase{5.76e6, 25},
                                           RateCase{7.68e6, 25}, RateCase{10e6, 50}, RateCase{11.52e6, 50},
                                           RateCase{15.36e6, 75}, RateCase{19.2e6, 100}, RateCase{20e6, 100},
                                           RateCase{23.04e6, 100}, RateCase{25e6, 100}, RateCase{30.72e6, 100}));

TEST(Search, CarrierOffsetsOutToTheEdge) {
  RandomStream random(6);
  Searcher searcher({.max_cfo_hz = 150e3});
  for (const double cfo_hz : {-145e3, -146.3e3, -101e3, -63.7e3, -7.4e3, 0.0, 3.75e3, 31e3, 88.8e3, 132e3, 145e3}) {
    SCOPED_TRACE(cfo_hz);
    CellParameters cell = random_cell(random);
    cell.cfo_hz = cfo_hz;
    const auto iq = capture(cell, kBaseRateHz, 40e-3, 15.0, random.next_u64());
    ASSERT_EQ(searcher.search(iq), SearchStatus::kOk);
    expect_only(searcher, cell);
  }
}

TEST(Search, ClockErrorIsNotTheCarriersOffset) {
  // Sign: a cell whose clock is fast has frames that are short in samples.
  RandomStream random(7);
  Searcher searcher({.max_cfo_hz = 5e3});
  for (const double ppm : {-20.0, -5.0, 0.0, 5.0, 20.0}) {
    for (const double cfo_hz : {-3e3, 0.0, 3e3}) {
      SCOPED_TRACE(ppm);
      CellParameters cell = random_cell(random);
      cell.cfo_hz = cfo_hz;
      cell.clock_error_ppm = ppm;
      const auto iq = capture(cell, kBaseRateHz, 80e-3, 15.0, random.next_u64());
      ASSERT_EQ(searcher.search(iq), SearchStatus::kOk);
      expect_only(searcher, cell);
    }
  }
}

TEST(Search, SfnOfTheFirstFrameAcrossTheCountersEnd) {
  RandomStream random(8);
  Searcher searcher({.max_cfo_hz = 3e3});
  for (const int sfn : {0, 3, 1020, 1021, 1022, 1023}) {
    CellParameters cell = random_cell(random);
    cell.start_sfn = sfn;
    ASSERT_EQ(searcher.search(capture(cell, kBaseRateHz, 60e-3, 10.0, 9)), SearchStatus::kOk);
    expect_only(searcher, cell);
  }
}

// Frames of a slow cell are longer than 10 ms: the first start may lie beyond, and counts modulo 10 ms.
TEST(Search, FrameStartNextToTheWrapWithClockError) {
  RandomStream random(12);
  Searcher searcher({.max_cfo_hz = 3e3});
  for (const double ppm : {-50.0, 50.0}) {
    for (const double delay_s : {-0.3e-6, -0.05e-6, 0.05e-6, 0.3e-6}) {
      SCOPED_TRACE(delay_s);
      CellParameters cell = random_cell(random);
      cell.clock_error_ppm = ppm;
      cell.delay_s = delay_s;
      const auto iq = capture(cell, kBaseRateHz, 60e-3, 30.0, 13);
      ASSERT_EQ(searcher.search(iq), SearchStatus::kOk);
      ASSERT_EQ(searcher.detections().size(), 1U);
      const Detection& d = searcher.detections().front();
      EXPECT_GE(d.frame_start_s, 0.0);
      EXPECT_LT(d.frame_start_s, kFrameS);
      EXPECT_LT(std::abs(wrapped_s(d.frame_start_s - delay_s)), 0.6e-6);  // 50 ppm of a frame, and noise
      ToaEstimator estimator(kBaseRateHz);
      TimeOfArrival toa;
      ASSERT_EQ(estimator.estimate(iq, d, toa), ToaStatus::kOk);
      EXPECT_GE(toa.toa_s.front(), 0.0);
      EXPECT_LT(toa.toa_s.front(), kFrameS);
    }
  }
}

TEST(Search, FrameStartNextToTheWrap) {
  RandomStream random(10);
  Searcher searcher({.max_cfo_hz = 3e3});
  for (const double delay_s : {20e-9, 0.4e-6, 3e-6, kFrameS - 3e-6, kFrameS - 0.4e-6, kFrameS - 20e-9}) {
    SCOPED_TRACE(delay_s);
    CellParameters cell = random_cell(random);
    cell.delay_s = delay_s;
    ASSERT_EQ(searcher.search(capture(cell, kBaseRateHz, 60e-3, 30.0, 11)), SearchStatus::kOk);
    expect_only(searcher, cell);
  }
}

TEST(Search, ShortestCaptureStillGivesTheCell) {
  // One PSS and one SSS: identity, timing and carrier, no broadcast channel guaranteed.
  RandomStream random(12);
  Searcher searcher({.max_cfo_hz = 5e3});
  for (int i = 0; i < 8; ++i) {
    CellParameters cell = random_cell(random);
    cell.cfo_hz = random.uniform(-4e3, 4e3);
    ASSERT_EQ(searcher.search(capture(cell, kBaseRateHz, 6e-3, 20.0, random.next_u64())), SearchStatus::kOk);
    ASSERT_EQ(searcher.detections().size(), 1U) << cell.cell_id;
    const Detection& d = searcher.detections().front();
    EXPECT_EQ(d.cell_id, cell.cell_id);
    EXPECT_LT(std::abs(wrapped_s(d.frame_start_s - cell.delay_s)), 0.3e-6);
    EXPECT_NEAR(d.cfo_hz, cell.cfo_hz, 40.0);
  }
}

TEST(Search, SnrPerReferenceElement) {
  RandomStream random(13);
  Searcher searcher({.max_cfo_hz = 3e3});
  for (const double snr_db : {-6.0, 0.0, 10.0, 20.0}) {
    CellParameters cell = random_cell(random);
    ASSERT_EQ(searcher.search(capture(cell, kBaseRateHz, 60e-3, snr_db, 14)), SearchStatus::kOk);
    ASSERT_EQ(searcher.detections().size(), 1U);
    // 24 elements of two ports, each seen 120 times: relative variance of the power 2 / (5760 snr), six deviations.
    const double sigma_db = 10.0 / std::log(10.0) * std::sqrt(2.0 / 5760.0 / std::pow(10.0, snr_db / 10.0));
    EXPECT_NEAR(searcher.detections().front().snr_db, snr_db, 6.0 * sigma_db + 0.1);
  }
}

TEST(Search, BroadcastChannelOnlyWhenAsked) {
  RandomStream random(15);
  const CellParameters cell = random_cell(random);
  Searcher searcher({.max_cfo_hz = 3e3, .decode_mib = false});
  ASSERT_EQ(searcher.search(capture(cell, kBaseRateHz, 60e-3, 15.0, 16)), SearchStatus::kOk);
  const Detection* d = find(searcher.detections(), cell.cell_id);
  ASSERT_NE(d, nullptr);
  EXPECT_FALSE(d->n_rb || d->n_ports || d->sfn);
}

TEST(Search, SeveralCells) {
  // Two of one N_ID_2, overlapping in time, their reference signals on the same subcarriers; one of its own timing.
  RandomStream random(17);
  std::vector<CellParameters> cells;
  for (const int id : {300, 117, 64}) {
    cells.push_back(random_cell(random, 25));
    cells.back().cell_id = id;
    cells.back().power_db = -3.0 * static_cast<double>(cells.size() - 1);
    cells.back().cfo_hz = 1200.0;
  }
  cells[1].delay_s = cells[0].delay_s + 1.1e-6;
  const auto iq = synthesize(cells, 7.68e6, samples(80e-3, 7.68e6), noise_variance_for_snr(25.0), 18);
  Searcher searcher({.sample_rate_hz = 7.68e6});
  ASSERT_EQ(searcher.search(iq), SearchStatus::kOk);
  ASSERT_EQ(searcher.detections().size(), 3U);
  for (const CellParameters& cell : cells) {
    SCOPED_TRACE(cell.cell_id);
    const Detection* d = find(searcher.detections(), cell.cell_id);
    ASSERT_NE(d, nullptr);
    EXPECT_EQ(d->n_rb, 25);
    EXPECT_EQ(d->sfn, cell.start_sfn);
    EXPECT_LT(std::abs(wrapped_s(d->frame_start_s - cell.delay_s)), 0.1e-6);
    EXPECT_NEAR(d->cfo_hz, 1200.0, 5.0);
  }
  for (std::size_t i = 1; i < 3; ++i) {
    EXPECT_LE(searcher.detections()[i].power_db, searcher.detections()[i - 1].power_db);
  }
}

TEST(Search, NoMoreCellsThanAskedFor) {
  RandomStream random(19);
  std::vector<CellParameters> cells;
  for (const int id : {5, 91, 240}) {
    cells.push_back(random_cell(random));
    cells.back().cell_id = id;
    cells.back().power_db = -4.0 * static_cast<double>(cells.size() - 1);
  }
  const auto iq = synthesize(cells, kBaseRateHz, samples(80e-3, kBaseRateHz), noise_variance_for_snr(25.0), 20);
  for (const int limit : {1, 2, 3}) {
    Searcher searcher({.max_cfo_hz = 5e3, .max_cells = limit});
    ASSERT_EQ(searcher.search(iq), SearchStatus::kOk);
    EXPECT_EQ(searcher.detections().size(), static_cast<std::size_t>(limit));
    EXPECT_NE(find(searcher.detections(), 5), nullptr);
  }
}

// What is not a capture of LTE.

TEST(SearchBadInput, TooShort) {
  Searcher searcher({});
  EXPECT_EQ(searcher.search({}), SearchStatus::kTooShort);
  const auto one = noise(1, 1.0, 1);
  EXPECT_EQ(searcher.search(one), SearchStatus::kTooShort);
  EXPECT_EQ(searcher.search(noise(9600, 1.0, 1)), SearchStatus::kTooShort);  // a half-frame
  EXPECT_TRUE(searcher.detections().empty());
  EXPECT_EQ(searcher.search(noise(9984, 1.0, 1)), SearchStatus::kOk);  // 5.2 ms
  Searcher resampling({.sample_rate_hz = 2.4e6});
  EXPECT_EQ(resampling.search({}), SearchStatus::kTooShort);
  EXPECT_EQ(resampling.search(one), SearchStatus::kTooShort);
  EXPECT_EQ(resampling.search(noise(12000, 1.0, 1)), SearchStatus::kTooShort);
}

TEST(SearchBadInput, ShortCaptureForgetsTheLastOnesCells) {
  RandomStream random(21);
  Searcher searcher({.max_cfo_hz = 3e3});
  ASSERT_EQ(searcher.search(capture(random_cell(random), kBaseRateHz, 40e-3, 15.0, 1)), SearchStatus::kOk);
  ASSERT_EQ(searcher.detections().size(), 1U);
  EXPECT_EQ(searcher.search({}), SearchStatus::kTooShort);
  EXPECT_TRUE(searcher.detections().empty());
}

TEST(SearchBadInput, NonFiniteAnywhere) {
  RandomStream random(22);
  for (const double rate_hz : {1.92e6, 2.4e6}) {
    Searcher searcher({.sample_rate_hz = rate_hz, .max_cfo_hz = 3e3});
    const auto good = capture(random_cell(random), rate_hz, 20e-3, 15.0, 1);
    constexpr float kNan = std::numeric_limits<float>::quiet_NaN(), kInf = std::numeric_limits<float>::infinity();
    for (const Cf32 bad : {Cf32(kNan, 0.0F), Cf32(0.0F, kNan), Cf32(kInf, 0.0F), Cf32(0.0F, -kInf)}) {
      for (const std::size_t at : {std::size_t{0}, good.size() / 2, good.size() - 1}) {
        auto iq = good;
        iq[at] = bad;
        EXPECT_EQ(searcher.search(iq), SearchStatus::kNonFinite) << at;
        EXPECT_TRUE(searcher.detections().empty());
      }
    }
    EXPECT_EQ(searcher.search(good), SearchStatus::kOk);  // and nothing of it stays
    EXPECT_EQ(searcher.detections().size(), 1U);
  }
}

TEST(SearchBadInput, NothingInSignalsThatAreNoCell) {
  const std::size_t n = 115200;
  std::vector<std::pair<std::string, std::vector<Cf32>>> signals;
  signals.emplace_back("zero", std::vector<Cf32>(n));
  signals.emplace_back("direct current", std::vector<Cf32>(n, Cf32(0.7F, -0.3F)));
  signals.emplace_back("direct current, clipped noise", noise(n, 1e-3, 23));
  for (Cf32& x : signals.back().second) {
    x = {std::clamp(x.real() + 1.0F, -1.0F, 1.0F), std::clamp(x.imag() - 1.0F, -1.0F, 1.0F)};
  }
  for (const double frequency_hz : {1e3, 105e3, -480e3}) {
    std::vector<Cf32> tone(n);
    for (std::size_t i = 0; i < n; ++i) {
      tone[i] = Cf32(std::polar(1.0, kTwoPi * std::fmod(frequency_hz / kBaseRateHz * static_cast<double>(i), 1.0)));
    }
    signals.emplace_back("tone " + std::to_string(frequency_hz), tone);
  }
  for (const std::size_t period : {2U, 128U, 137U, 960U, 1920U, 9600U, 19200U}) {
    std::vector<Cf32> square(n);
    for (std::size_t i = 0; i < n; ++i) square[i] = (i % period) < period / 2 ? Cf32(1.0F, 1.0F) : Cf32(-1.0F, -1.0F);
    signals.emplace_back("square wave " + std::to_string(period), square);
  }
  std::vector<Cf32> impulses(n), ramp(n);
  for (std::size_t i = 0; i < n; i += 9600) impulses[i] = 1.0F;
  for (std::size_t i = 0; i < n; ++i) ramp[i] = static_cast<float>(i);
  signals.emplace_back("an impulse per half-frame", impulses);
  signals.emplace_back("ramp", ramp);
  auto frame = noise(19200, 1.0, 24);  // repeats as synchronisation signals do
  std::vector<Cf32> repeated;
  while (repeated.size() < n) repeated.insert(repeated.end(), frame.begin(), frame.end());
  signals.emplace_back("noise repeated each frame", repeated);
  for (const double max_cfo_hz : {3e3, 150e3}) {
    Searcher searcher({.max_cfo_hz = max_cfo_hz});
    for (const auto& [name, iq] : signals) {
      EXPECT_EQ(searcher.search(iq), SearchStatus::kOk) << name;
      EXPECT_TRUE(searcher.detections().empty()) << name << ": cell " << searcher.detections().front().cell_id;
    }
  }
}

TEST(SearchBadInput, HardLimitedCellIsStillFound) {
  RandomStream random(25);
  CellParameters cell = random_cell(random);
  cell.cfo_hz = 2.2e3;
  auto iq = capture(cell, kBaseRateHz, 60e-3, 20.0, 26);
  for (Cf32& x : iq) x = {std::copysign(1.0F, x.real()), std::copysign(1.0F, x.imag())};
  Searcher searcher({.max_cfo_hz = 5e3});
  ASSERT_EQ(searcher.search(iq), SearchStatus::kOk);
  expect_only(searcher, cell);
}

TEST(SearchBadInput, WrongRateGivesNoFalseLock) {
  RandomStream random(27);
  CellParameters cell = random_cell(random, 100);
  const auto iq = capture(cell, 19.2e6, 60e-3, 20.0, 28);
  for (const double declared_hz : {15.36e6, 20e6, 19.0e6, 30.72e6, 1.92e6}) {
    Searcher searcher({.sample_rate_hz = declared_hz});
    ASSERT_EQ(searcher.search(iq), SearchStatus::kOk);
    EXPECT_TRUE(searcher.detections().empty()) << declared_hz;
  }
}

std::string refusal(const SearchOptions& options) {
  try {
    const Searcher searcher(options);
  } catch (const std::invalid_argument& error) {
    return error.what();
  }
  return "accepted";
}

TEST(SearchBadInput, OptionsOutOfRangeAreNamed) {
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  for (const double rate : {0.0, -1.92e6, 1.39e6, 100.1e6, kNan}) {
    EXPECT_THAT(refusal({.sample_rate_hz = rate}), HasSubstr("sample_rate_hz")) << rate;
  }
  EXPECT_THAT(refusal({.sample_rate_hz = 1e6}), HasSubstr("1000000"));
  EXPECT_THAT(refusal({.sample_rate_hz = 1e6}), HasSubstr("1.4e6 ... 100e6"));
  for (const double cfo : {-1.0, 250.1e3, kNan}) EXPECT_THAT(refusal({.max_cfo_hz = cfo}), HasSubstr("max_cfo_hz"));
  for (const double s : {0.0, 9.9e-3, 2.1, kNan}) EXPECT_THAT(refusal({.window_s = s}), HasSubstr("window_s"));
  for (const int n : {-1, 0, 65}) EXPECT_THAT(refusal({.max_cells = n}), HasSubstr("max_cells"));
  EXPECT_THAT(refusal({.max_cells = 65}), HasSubstr("65"));
  for (const SearchOptions& good :
       {SearchOptions{.sample_rate_hz = 1.4e6}, SearchOptions{.max_cfo_hz = 0.0}, SearchOptions{.window_s = 10e-3},
        SearchOptions{.max_cells = 1}, SearchOptions{.max_cells = 64}}) {
    EXPECT_EQ(refusal(good), "accepted");
  }
}

// Streams.

void expect_same(std::span<const Detection> a, std::span<const Detection> b) {
  ASSERT_EQ(a.size(), b.size());
  for (std::size_t i = 0; i < a.size(); ++i) {
    EXPECT_EQ(a[i].cell_id, b[i].cell_id);
    EXPECT_EQ(a[i].sfn, b[i].sfn);
    EXPECT_EQ(a[i].n_rb, b[i].n_rb);
    EXPECT_EQ(a[i].n_ports, b[i].n_ports);
    EXPECT_EQ(a[i].frame_start_s, b[i].frame_start_s);
    EXPECT_EQ(a[i].cfo_hz, b[i].cfo_hz);
    EXPECT_EQ(a[i].clock_error_ppm, b[i].clock_error_ppm);
    EXPECT_EQ(a[i].snr_db, b[i].snr_db);
    EXPECT_EQ(a[i].crs_statistic, b[i].crs_statistic);
  }
}

TEST(SearchStream, BlocksGiveWhatTheWindowsGive) {
  RandomStream random(29);
  for (const double rate_hz : {1.92e6, 2.4e6}) {
    const SearchOptions options{.sample_rate_hz = rate_hz, .max_cfo_hz = 5e3, .window_s = 20e-3};
    const std::size_t window = samples(options.window_s, rate_hz);
    const auto iq = capture(random_cell(random), rate_hz, 70e-3, 15.0, 30);
    Searcher whole(options), stream(options);
    for (const std::size_t block : {std::size_t{1021}, std::size_t{7}, window, window / 3 + 1}) {
      std::size_t done = 0;
      for (std::size_t at = 0; at < 3 * window; at += block) {
        const std::size_t end = std::min(at + block, 3 * window);
        const auto found = stream.push(std::span(iq).subspan(at, end - at));
        if (end / window == done) {
          EXPECT_TRUE(found.empty());
          continue;
        }
        ASSERT_EQ(whole.search(std::span(iq).subspan(done * window, window)), SearchStatus::kOk);
        ++done;
        EXPECT_EQ(whole.detections().size(), 1U);
        expect_same(found, whole.detections());
      }
      EXPECT_EQ(done, 3U);
    }
  }
}

TEST(SearchStream, NonFiniteSamplesCountAsZero) {
  RandomStream random(31);
  const SearchOptions options{.max_cfo_hz = 5e3, .window_s = 20e-3};
  auto iq = capture(random_cell(random), kBaseRateHz, 20e-3, 15.0, 32);
  auto zeroed = iq;
  for (std::size_t i = 100; i < iq.size(); i += 5000) {
    iq[i] = {std::numeric_limits<float>::quiet_NaN(), 0.0F};
    iq[i + 1] = {1.0F, std::numeric_limits<float>::infinity()};
    zeroed[i] = zeroed[i + 1] = Cf32{};
  }
  Searcher stream(options), whole(options);
  const auto found = stream.push(iq);
  ASSERT_EQ(whole.search(zeroed), SearchStatus::kOk);
  EXPECT_EQ(whole.detections().size(), 1U);
  expect_same(found, whole.detections());
}

TEST(SearchStream, ABlockOfSeveralWindowsGivesTheLast) {
  RandomStream random(33);
  const SearchOptions options{.max_cfo_hz = 5e3, .window_s = 20e-3};
  const auto iq = capture(random_cell(random), kBaseRateHz, 50e-3, 15.0, 34);
  Searcher stream(options), whole(options);
  const auto found = stream.push(iq);
  ASSERT_EQ(whole.search(std::span(iq).subspan(38400, 38400)), SearchStatus::kOk);
  EXPECT_EQ(whole.detections().size(), 1U);
  expect_same(found, whole.detections());
}

TEST(SearchStream, AnEmptyBlockIsNothing) {
  Searcher searcher({});
  EXPECT_TRUE(searcher.push({}).empty());
}

}  // namespace
}  // namespace soopnav::lte
