#include "soopnav/waveform/lte/synthesis.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <limits>
#include <numbers>
#include <stdexcept>
#include <string>
#include <vector>

#include "soopnav/waveform/lte/pbch.hpp"
#include "soopnav/waveform/lte/sequences.hpp"
#include "waveform/naive_pbch.hpp"

namespace soopnav::lte {
namespace {

using Cf64 = std::complex<double>;
using ::testing::HasSubstr;

CellParameters cell_of(int id, int n_rb, int n_ports, CyclicPrefix cp = CyclicPrefix::kNormal,
                       Duplex duplex = Duplex::kFdd) {
  CellParameters cell;
  cell.cell_id = id;
  cell.n_rb = n_rb;
  cell.n_ports = n_ports;
  cell.cp = cp;
  cell.duplex = duplex;
  return cell;
}

std::size_t index(int i) { return static_cast<std::size_t>(i); }

// ---- The grid -----------------------------------------------------------------------------------------------------

/// What the standard puts at an element, worked out one element at a time.
enum class Kind { kSilent, kReference, kPrimary, kSecondary, kReserved, kBroadcast, kData };

struct Place {
  Kind kind = Kind::kData;
  int port = -1;    // of a reference element
  int number = -1;  // of the element in its sequence
};

Place place_of(const CellParameters& cell, int subframe, int symbol, int subcarrier, int n_downlink,
               const std::vector<std::pair<int, int>>& pbch) {
  const bool normal = cell.cp == CyclicPrefix::kNormal;
  const int per_slot = normal ? 7 : 6;
  const int l = symbol % per_slot;
  if (symbol >= n_downlink) return {Kind::kSilent, -1, -1};
  for (int port = 0; port < cell.n_ports; ++port) {
    const int last = normal ? 4 : 3;
    int v = -1;
    if (port == 0 && l == 0) v = 0;
    if (port == 0 && l == last) v = 3;
    if (port == 1 && l == 0) v = 3;
    if (port == 1 && l == last) v = 0;
    const int odd_slot = symbol / per_slot;  // slot number modulo 2
    if (port == 2 && l == 1) v = 3 * odd_slot;
    if (port == 3 && l == 1) v = 3 + 3 * odd_slot;
    if (v >= 0 && subcarrier % 6 == (v + cell.cell_id) % 6) return {Kind::kReference, port, subcarrier / 6};
  }
  const int from_centre = subcarrier - 6 * cell.n_rb;  // -36 ... 35 is the middle
  const bool middle = from_centre >= -36 && from_centre < 36;
  bool primary = false, secondary = false;
  if (cell.duplex == Duplex::kFdd) {
    primary = subframe % 5 == 0 && symbol == per_slot - 1;
    secondary = subframe % 5 == 0 && symbol == per_slot - 2;
  } else {
    primary = subframe % 5 == 1 && symbol == 2;
    secondary = subframe % 5 == 0 && symbol == 2 * per_slot - 1;
  }
  if (middle && (primary || secondary)) {
    if (from_centre < -31 || from_centre >= 31) return {Kind::kReserved, -1, -1};
    return {primary ? Kind::kPrimary : Kind::kSecondary, -1, from_centre + 31};
  }
  if (middle && subframe == 0 && symbol >= per_slot && l < 4) {
    const auto at = std::find(pbch.begin(), pbch.end(), std::pair(l, from_centre + 36));
    if (at == pbch.end()) return {Kind::kReserved, -1, -1};
    return {Kind::kBroadcast, -1, static_cast<int>(at - pbch.begin())};
  }
  return {Kind::kData, -1, -1};
}

struct GridCase {
  Duplex duplex;
  CyclicPrefix cp;
  int n_ports;
};

class Grid : public ::testing::TestWithParam<GridCase> {};

INSTANTIATE_TEST_SUITE_P(Formats, Grid,
                         ::testing::Values(GridCase{Duplex::kFdd, CyclicPrefix::kNormal, 1},
                                           GridCase{Duplex::kFdd, CyclicPrefix::kNormal, 2},
                                           GridCase{Duplex::kFdd, CyclicPrefix::kExtended, 4},
                                           GridCase{Duplex::kTdd, CyclicPrefix::kNormal, 4},
                                           GridCase{Duplex::kTdd, CyclicPrefix::kExtended, 2}));

TEST_P(Grid, HasEverySignalInItsPlace) {
  // All 504 cells; bandwidths, subframes, TDD configurations and start frames go round with them.
  std::array<int, 7> seen{};
  for (int id = 0; id < 504; ++id) {
    CellParameters cell = cell_of(id, kBandwidthsRb[index(id % 4 == 3 ? id % 6 : 0)], GetParam().n_ports, GetParam().cp,
                                  GetParam().duplex);
    cell.tdd_configuration = id % 7;
    cell.special_subframe_configuration = id % (cell.cp == CyclicPrefix::kNormal ? 10 : 8);
    cell.sync_ports = id % 2 == 0 ? SyncPorts::kFirst : SyncPorts::kAll;
    const bool normal = cell.cp == CyclicPrefix::kNormal;
    const int subframe = id % 3 == 0 ? 0 : (id % 3 == 1 ? 5 : id % 10);
    const int sfn = (id * 37) % 1024;
    const ResourceGrid grid = resource_grid(cell, sfn, subframe, 9);
    ASSERT_EQ(grid.n_symbols, normal ? 14 : 12);
    ASSERT_EQ(grid.n_subcarriers, 12 * cell.n_rb);
    const int n_downlink = downlink_symbols(cell, subframe);

    const auto pbch = test::naive_pbch_places(id, normal);
    const auto bandwidth =
        static_cast<int>(std::find(kBandwidthsRb.begin(), kBandwidthsRb.end(), cell.n_rb) - kBandwidthsRb.begin());
    const auto bits = test::naive_pbch_bits(test::naive_mib(bandwidth, false, 2, sfn), id, cell.n_ports, normal);
    const auto d = [&](int i) {
      const auto b = index(sfn % 4) * (normal ? 480 : 432) + index(2 * i);
      return Cf64(1 - 2 * bits[b], 1 - 2 * bits[b + 1]) / std::numbers::sqrt2;
    };
    // Transmit diversity, 36.211 6.3.4.3, written out.
    const auto broadcast = [&](int port, int i) -> Cf64 {
      const double r = 1.0 / std::numbers::sqrt2;
      const int even = i - i % 2;
      const Cf64 own = r * d(i), crossed = i % 2 == 0 ? -r * std::conj(d(i + 1)) : r * std::conj(d(even));
      if (cell.n_ports == 1) return d(i);
      if (cell.n_ports == 2) return port == 0 ? own : crossed;
      const bool first_pair = i % 4 < 2;
      if (port == 0) return first_pair ? own : 0.0;
      if (port == 1) return first_pair ? 0.0 : own;
      if (port == 2) return first_pair ? crossed : 0.0;
      return first_pair ? 0.0 : crossed;
    };
    const auto secondary = sss(id, subframe == 5 ? 5 : 0);
    std::vector<Cf32> reference(index(2 * cell.n_rb));
    for (int symbol = 0; symbol < grid.n_symbols; ++symbol) {
      const int per_slot = normal ? 7 : 6;
      crs_values(id, 2 * subframe + symbol / per_slot, symbol % per_slot, cell.cp, cell.n_rb, reference);
      for (int k = 0; k < grid.n_subcarriers; ++k) {
        const Place place = place_of(cell, subframe, symbol, k, n_downlink, pbch);
        ++seen[index(static_cast<int>(place.kind))];
        for (int port = 0; port < cell.n_ports; ++port) {
          const Cf64 value(grid.at(port, symbol, k));
          const bool sends_sync = port == 0 || cell.sync_ports == SyncPorts::kAll;
          Cf64 expected = 0.0;
          switch (place.kind) {
            case Kind::kSilent:
            case Kind::kReserved:
              break;
            case Kind::kReference:
              if (port == place.port) expected = reference[index(place.number)];
              break;
            case Kind::kPrimary:
              if (sends_sync) expected = pss(id % 3)[index(place.number)];
              break;
            case Kind::kSecondary:
              if (sends_sync) expected = static_cast<double>(secondary[index(place.number)]);
              break;
            case Kind::kBroadcast:
              expected = broadcast(port, place.number);
              break;
            case Kind::kData:
              ASSERT_NEAR(std::norm(value) * cell.n_ports, 1.0, 1e-6) << id << ' ' << port << ' ' << symbol << ' ' << k;
              ASSERT_NEAR(std::abs(value.real()), std::abs(value.imag()), 1e-7);
              continue;
          }
          ASSERT_LT(std::abs(value - expected), 1e-6) << id << ' ' << port << ' ' << symbol << ' ' << k;
        }
      }
    }
  }
  for (std::size_t kind = 0; kind < seen.size(); ++kind) {
    if (kind == 0 && GetParam().duplex == Duplex::kFdd) continue;
    EXPECT_GT(seen[kind], 0) << "no element of kind " << kind;
  }
}

TEST(GridTdd, SubframesOfEveryConfiguration) {
  // TS 36.211 table 4.2-2 by its uplink subframes.
  const std::array<std::string, 7> uplink{"234789", "2378", "27", "234", "23", "2", "23478"};
  for (int configuration = 0; configuration < 7; ++configuration) {
    CellParameters cell = cell_of(0, 6, 1, CyclicPrefix::kNormal, Duplex::kTdd);
    cell.tdd_configuration = configuration;
    cell.special_subframe_configuration = 9;
    for (int subframe = 0; subframe < 10; ++subframe) {
      const bool up = uplink[index(configuration)].find(static_cast<char>('0' + subframe)) != std::string::npos;
      const bool special = subframe == 1 || (subframe == 6 && (configuration < 3 || configuration == 6));
      EXPECT_EQ(downlink_symbols(cell, subframe), up ? 0 : (special ? 6 : 14)) << configuration << ' ' << subframe;
    }
  }
}

TEST(GridTdd, DwPtsOfEveryConfiguration) {
  // TS 36.211 table 4.2-1 in units of T_s: a symbol is 2208 or 2192 (normal), 2560 (extended).
  const std::vector<int> normal{6592, 19760, 21952, 24144, 26336, 6592, 19760, 21952, 24144, 13168};
  const std::vector<int> extended{7680, 20480, 23040, 25600, 7680, 20480, 23040, 12800};
  CellParameters cell = cell_of(0, 6, 1, CyclicPrefix::kNormal, Duplex::kTdd);
  for (int i = 0; i < 10; ++i) {
    cell.special_subframe_configuration = i;
    const int n = downlink_symbols(cell, 1);
    int ticks = 0;
    for (int symbol = 0; symbol < n; ++symbol) ticks += symbol % 7 == 0 ? 2208 : 2192;
    EXPECT_EQ(ticks, normal[index(i)]) << i;
  }
  cell.cp = CyclicPrefix::kExtended;
  for (int i = 0; i < 8; ++i) {
    cell.special_subframe_configuration = i;
    EXPECT_EQ(2560 * downlink_symbols(cell, 1), extended[index(i)]) << i;
  }
}

TEST(GridData, DependsOnSeedCellAndTimeAlone) {
  const CellParameters cell = cell_of(17, 15, 2);
  const ResourceGrid first = resource_grid(cell, 5, 3, 1);
  EXPECT_EQ(first.values, resource_grid(cell, 5, 3, 1).values);
  CellParameters moved = cell;
  moved.delay_s = 1e-3;
  moved.power_db = -20.0;
  EXPECT_EQ(first.values, resource_grid(moved, 5, 3, 1).values);
  EXPECT_NE(first.values, resource_grid(cell, 5, 3, 2).values);
  EXPECT_NE(first.values, resource_grid(cell, 5, 4, 1).values);
  EXPECT_NE(first.values, resource_grid(cell, 6, 3, 1).values);
}

TEST(GridData, LoadIsTheShareOfBlocksThatCarryData) {
  for (const double load : {0.0, 0.3, 1.0}) {
    CellParameters cell = cell_of(8, 100, 1);
    cell.data_load = load;
    int filled = 0, blocks = 0;
    for (int sfn = 0; sfn < 10; ++sfn) {
      const ResourceGrid grid = resource_grid(cell, sfn, 2, 4);
      for (int rb = 0; rb < 100; ++rb) {
        int elements = 0;  // symbol 2 has no reference signals: all of a block or nothing
        for (int k = 12 * rb; k < 12 * rb + 12; ++k) elements += grid.at(0, 2, k) != Cf32{} ? 1 : 0;
        ASSERT_TRUE(elements == 0 || elements == 12);
        filled += elements / 12;
        ++blocks;
      }
      EXPECT_NE(grid.at(0, 0, crs_first_subcarrier(8, 4, 0, 0)), Cf32{});
    }
    EXPECT_NEAR(static_cast<double>(filled) / blocks, load, 5.0 * std::sqrt(load * (1.0 - load) / blocks) + 1e-9);
  }
}

TEST(GridBoost, RaisesWhatItNames) {
  CellParameters cell = cell_of(0, 6, 1);
  cell.crs_boost_db = 6.0;
  cell.sync_boost_db = -3.0;
  const ResourceGrid grid = resource_grid(cell, 0, 0);
  EXPECT_NEAR(10.0 * std::log10(std::norm(Cf64(grid.at(0, 0, 0)))), 6.0, 1e-5);
  EXPECT_NEAR(10.0 * std::log10(std::norm(Cf64(grid.at(0, 6, 36)))), -3.0, 1e-5);
  EXPECT_NEAR(10.0 * std::log10(std::norm(Cf64(grid.at(0, 5, 36)))), -3.0, 1e-5);
  EXPECT_NEAR(std::abs(grid.at(0, 2, 0)), 1.0, 1e-6);
}

// ---- Samples ------------------------------------------------------------------------------------------------------

/// Sample `n` of one cell straight from the definition: find the symbol, sum its subcarriers at that very time.
Cf64 naive_sample(const CellParameters& cell, double rate_hz, std::int64_t n, std::uint64_t seed) {
  Cf64 sum = 0.0;
  const double stretch = 1.0 + 1e-6 * cell.clock_error_ppm;
  const double half_band_hz = 90e3 * cell.n_rb * stretch + std::abs(cell.cfo_hz);
  for (const PathTap& tap : cell.taps) {
    const double t = (static_cast<double>(n) / rate_hz - cell.delay_s - tap.delay_s) * stretch;
    const auto q = static_cast<int>(std::floor(t / 1e-3 + 1e-9));
    double into = (t - q * 1e-3) * 30.72e6;  // T_s within the subframe
    const int subframe = ((q % 10) + 10) % 10;
    const int sfn = ((cell.start_sfn + (q - subframe) / 10) % 1024 + 1024) % 1024;
    const ResourceGrid grid = resource_grid(cell, sfn, subframe, seed);
    int symbol = 0;
    double prefix = 0.0;
    while (true) {
      const bool first = symbol % (grid.n_symbols / 2) == 0;
      prefix = cell.cp == CyclicPrefix::kExtended ? 512.0 : (first ? 160.0 : 144.0);
      if (into < prefix + 2048.0 - 1e-5) break;
      into -= prefix + 2048.0;
      ++symbol;
    }
    const double since_s = (into - prefix) / 30.72e6;
    for (int k = 0; k < grid.n_subcarriers; ++k) {
      const int units = k < 6 * cell.n_rb ? k - 6 * cell.n_rb : k - 6 * cell.n_rb + 1;
      if (half_band_hz >= 0.5 * rate_hz && std::abs(15e3 * units * stretch + cell.cfo_hz) > 0.45 * rate_hz) continue;
      Cf64 amplitude = 0.0;
      for (int port = 0; port < cell.n_ports; ++port) {
        amplitude += cell.port_gain[index(port)] * Cf64(grid.at(port, symbol, k));
      }
      sum += tap.gain * amplitude * std::polar(1.0, 2.0 * std::numbers::pi * 15e3 * units * since_s);
    }
  }
  const double carrier =
      2.0 * std::numbers::pi * cell.cfo_hz * static_cast<double>(n) / rate_hz + cell.carrier_phase_rad;
  return sum * std::polar(std::sqrt(15e3 / rate_hz) * std::pow(10.0, cell.power_db / 20.0), carrier);
}

double power(std::span<const Cf32> x) {
  double sum = 0.0;
  for (const Cf32 v : x) sum += std::norm(Cf64(v));
  return sum / static_cast<double>(x.size());
}

/// Unitary transform at one frequency (units of 15 kHz) over one symbol without its prefix.
Cf64 demodulate(std::span<const Cf32> x, std::size_t first, int size, int units) {
  Cf64 sum = 0.0;
  for (int i = 0; i < size; ++i) {
    const auto turns = static_cast<double>((static_cast<std::int64_t>(units) * i) % size) / size;
    sum += Cf64(x[first + index(i)]) * std::polar(1.0, -2.0 * std::numbers::pi * turns);
  }
  return sum / std::sqrt(static_cast<double>(size));
}

struct SampleCase {
  const char* name;
  double rate_hz;
  CellParameters cell;
};

std::vector<SampleCase> sample_cases() {
  std::vector<SampleCase> cases;
  CellParameters cell = cell_of(101, 6, 2);
  cell.port_gain[1] = {0.3, -0.8};
  cases.push_back({"whole", 1.92e6, cell});
  cell.delay_s = 3.217e-3 + 17e-12;
  cell.cfo_hz = -7321.7;
  cell.carrier_phase_rad = 0.9;
  cell.power_db = -3.0;
  cell.start_sfn = 1022;
  cell.taps = {{0.0, {1.0, 0.0}}, {1.37e-6, {-0.4, 0.3}}, {-0.21e-6, {0.0, 0.2}}};
  cases.push_back({"taps", 1.92e6, cell});
  cell.clock_error_ppm = 20.0;
  cases.push_back({"clock", 1.92e6, cell});
  cell.cp = CyclicPrefix::kExtended;
  cell.n_ports = 4;
  cell.delay_s = -0.0123456;
  cases.push_back({"odd_rate", 2.0e6, cell});
  CellParameters wide = cell_of(335, 100, 1);
  wide.delay_s = 0.4e-6;
  wide.cfo_hz = 20e3;
  cases.push_back({"wide", 1.92e6, wide});
  wide.n_rb = 25;
  cases.push_back({"wide_odd_rate", 2.5e6, wide});
  wide.n_rb = 100;
  cases.push_back({"capture_19_2", 19.2e6, wide});
  CellParameters tdd = cell_of(7, 6, 1, CyclicPrefix::kNormal, Duplex::kTdd);
  tdd.delay_s = 1.25e-3;
  cases.push_back({"tdd", 3.84e6, tdd});
  return cases;
}

class Samples : public ::testing::TestWithParam<SampleCase> {};

INSTANTIATE_TEST_SUITE_P(Cells, Samples, ::testing::ValuesIn(sample_cases()),
                         [](const auto& entry) { return std::string(entry.param.name); });

TEST_P(Samples, EqualTheDefinition) {
  const auto& [name, rate_hz, cell] = GetParam();
  const std::vector<CellParameters> cells{cell};
  const auto n = static_cast<std::size_t>(12e-3 * rate_hz);
  const auto x = synthesize(cells, rate_hz, n, 0.0, 77);
  const double rms = std::sqrt(power(x));
  ASSERT_GT(rms, 0.01);
  double worst = 0.0;
  for (std::size_t i = 0; i < n; i += n / 150 + 1) {  // coprime enough to fall everywhere in a symbol
    worst = std::max(worst, std::abs(Cf64(x[i]) - naive_sample(cell, rate_hz, static_cast<std::int64_t>(i), 77)));
  }
  EXPECT_LT(worst, 1e-5 * rms);
}

TEST_P(Samples, DoNotDependOnTheBlocks) {
  const auto& [name, rate_hz, cell] = GetParam();
  const std::vector<CellParameters> cells{cell};
  constexpr std::size_t kSamples = 9000;
  const auto whole = synthesize(cells, rate_hz, kSamples, 0.5, 77);
  Synthesizer blocks(cells, rate_hz, 0.5, 77);
  std::vector<Cf32> pieces(kSamples);
  std::size_t at = 0;
  for (std::size_t size = 1; at < kSamples; size = 3 * size + 1) {
    const std::size_t now = std::min(size, kSamples - at);
    EXPECT_EQ(blocks.position(), static_cast<std::int64_t>(at));
    blocks.generate(std::span(pieces).subspan(at, now));
    at += now;
  }
  EXPECT_EQ(whole, pieces);
  blocks.seek(5000);
  blocks.generate(std::span(pieces).first(100));
  EXPECT_TRUE(std::equal(pieces.begin(), pieces.begin() + 100, whole.begin() + 5000));
}

TEST(SampleLaws, ADelayIsALinearPhase) {
  // 17 ps are 5 mm. The slope of the phase over frequency gives the delay back to less than 1e-13 s.
  constexpr int kSize = 2048;
  constexpr double kRate = kSize * 15e3;
  const std::vector<CellParameters> still{cell_of(3, 100, 1)};
  const auto reference = synthesize(still, kRate, 2 * kSize + 400, 0.0, 1);
  for (const double delay_s : {17e-12, 1e-9, 0.37 / kRate, -0.49 / kRate, 1e-6}) {
    auto moved = still;
    moved[0].delay_s = delay_s;
    const auto x = synthesize(moved, kRate, 2 * kSize + 400, 0.0, 1);
    const std::size_t first = 160;  // of symbol 0 after its prefix
    double weighted = 0.0, weights = 0.0, worst = 0.0;
    for (int units = -600; units <= 600; units += 25) {
      if (units == 0) continue;
      // A window 60 samples early stays within prefix and symbol for all of these delays.
      const Cf64 h = demodulate(x, first - 60, kSize, units) / demodulate(reference, first - 60, kSize, units);
      const double f = 15e3 * units;
      const Cf64 rest = h * std::polar(1.0, 2.0 * std::numbers::pi * f * delay_s);
      worst = std::max(worst, std::abs(rest - 1.0));
      weighted += -std::arg(rest) * 2.0 * std::numbers::pi * f;
      weights += std::pow(2.0 * std::numbers::pi * f, 2);
    }
    EXPECT_LT(worst, 3e-6) << delay_s;
    EXPECT_LT(std::abs(weighted / weights), 1e-13) << delay_s;
  }
}

TEST(SampleLaws, DemodulatesToItsGridOverAllPorts) {
  for (const CyclicPrefix cp : {CyclicPrefix::kNormal, CyclicPrefix::kExtended}) {
    CellParameters cell = cell_of(210, 15, 2, cp);
    cell.start_sfn = 9;
    cell.port_gain = {Cf64(0.6, 0.2), Cf64(-0.1, 0.9), 1.0, 1.0};
    const std::vector<CellParameters> cells{cell};
    constexpr int kSize = 384;  // three times 128
    const auto x = synthesize(cells, kSize * 15e3, kSize * 15 + 10, 0.0, 6);
    const ResourceGrid grid = resource_grid(cell, 9, 0, 6);
    for (int symbol = 0; symbol < grid.n_symbols; ++symbol) {
      const int per_slot = symbols_per_slot(cp);
      const auto first =
          index(symbol / per_slot * (kSize * 15 / 2) + symbol_start_samples(cp, symbol % per_slot, kSize) +
                cyclic_prefix_samples(cp, symbol % per_slot, kSize));
      for (int k = 0; k < grid.n_subcarriers; k += 7) {
        const Cf64 expected =
            cell.port_gain[0] * Cf64(grid.at(0, symbol, k)) + cell.port_gain[1] * Cf64(grid.at(1, symbol, k));
        ASSERT_LT(std::abs(demodulate(x, first, kSize, subcarrier_index(k, 15)) - expected), 3e-6)
            << symbol << ' ' << k;
      }
      // Nothing at zero frequency nor beside the band.
      for (const int units : {0, 91, -91, 150}) EXPECT_LT(std::abs(demodulate(x, first, kSize, units)), 3e-6);
    }
  }
}

TEST(SampleLaws, ParsevalHoldsForEverySymbol) {
  const CellParameters cell = cell_of(44, 25, 1);
  const std::vector<CellParameters> cells{cell};
  constexpr int kSize = 512;
  const auto x = synthesize(cells, kSize * 15e3, kSize * 15, 0.0, 3);
  const ResourceGrid grid = resource_grid(cell, 0, 0, 3);
  for (int symbol = 0; symbol < 14; ++symbol) {
    const auto first = index(symbol / 7 * (kSize * 15 / 2) + symbol_start_samples(cell.cp, symbol % 7, kSize) +
                             cyclic_prefix_samples(cell.cp, symbol % 7, kSize));
    double sent = 0.0;
    for (int k = 0; k < 300; ++k) sent += std::norm(Cf64(grid.at(0, symbol, k)));
    EXPECT_NEAR(power(std::span(x).subspan(first, kSize)) * kSize / sent, 1.0, 1e-5) << symbol;
  }
}

TEST(SampleLaws, CellsAddUp) {
  CellParameters a = cell_of(30, 6, 2), b = cell_of(182, 100, 1, CyclicPrefix::kExtended);
  a.delay_s = 2.2e-3;
  b.cfo_hz = 321.0;
  b.clock_error_ppm = -3.0;
  const std::vector<CellParameters> both{a, b}, only_a{a}, only_b{b};
  const auto sum = synthesize(both, 1.92e6, 20000, 0.0, 5);
  const auto xa = synthesize(only_a, 1.92e6, 20000, 0.0, 5), xb = synthesize(only_b, 1.92e6, 20000, 0.0, 5);
  for (std::size_t i = 0; i < sum.size(); ++i) ASSERT_LT(std::abs(sum[i] - xa[i] - xb[i]), 2e-6F) << i;
}

TEST(SampleLaws, TapsAndGainsAreLinear) {
  CellParameters cell = cell_of(30, 6, 1);
  cell.delay_s = 1e-7;
  cell.taps = {{0.0, 1.0}, {2.5e-6, {0.0, 0.5}}};
  const std::vector<CellParameters> two{cell};
  auto first = two, second = two;
  first[0].taps = {{0.0, 1.0}};
  second[0].taps = {{0.0, 1.0}};
  second[0].delay_s += 2.5e-6;
  const auto x = synthesize(two, 1.92e6, 5000), a = synthesize(first, 1.92e6, 5000),
             b = synthesize(second, 1.92e6, 5000);
  for (std::size_t i = 0; i < x.size(); ++i) ASSERT_LT(std::abs(x[i] - a[i] - Cf32{0.0F, 0.5F} * b[i]), 3e-6F) << i;
}

TEST(SampleLaws, CarrierOffsetTurnsTheSamples) {
  CellParameters cell = cell_of(250, 6, 1);
  const std::vector<CellParameters> still{cell};
  cell.cfo_hz = 35123.4;
  const std::vector<CellParameters> moved{cell};
  const auto x = synthesize(still, 3.84e6, 40000), y = synthesize(moved, 3.84e6, 40000);
  for (std::size_t i = 0; i < x.size(); i += 17) {
    const Cf64 turn = std::polar(1.0, 2.0 * std::numbers::pi * 35123.4 * static_cast<double>(i) / 3.84e6);
    ASSERT_LT(std::abs(Cf64(y[i]) - turn * Cf64(x[i])), 3e-6) << i;
  }
}

TEST(SampleLaws, AFasterClockShortensFrames) {
  // At +100 ppm, frame 1 starts 10 ms / 1.0001 after frame 0, and looks there like a cell that started then.
  CellParameters fast = cell_of(77, 6, 1);
  fast.clock_error_ppm = 100.0;
  CellParameters later = fast;
  later.delay_s = 10e-3 / 1.0001;
  later.start_sfn = 1;
  const std::vector<CellParameters> a{fast}, b{later};
  const auto x = synthesize(a, 1.92e6, 24000), y = synthesize(b, 1.92e6, 24000);
  for (std::size_t i = 0; i < x.size(); ++i) ASSERT_LT(std::abs(x[i] - y[i]), 1e-5F) << i;
}

TEST(SampleLaws, SignalExistsBeforeTheFirstFrame) {
  CellParameters cell = cell_of(77, 6, 1);
  cell.delay_s = 7.3e-3;
  cell.start_sfn = 0;
  CellParameters earlier = cell;  // the same air, told from the frame before
  earlier.delay_s -= 10e-3;
  earlier.start_sfn = 1023;
  const std::vector<CellParameters> a{cell}, b{earlier};
  const auto x = synthesize(a, 1.92e6, 30000), y = synthesize(b, 1.92e6, 30000);
  EXPECT_GT(power(std::span(x).first(1000)), 0.3);
  for (std::size_t i = 0; i < x.size(); ++i) ASSERT_LT(std::abs(x[i] - y[i]), 1e-5F) << i;
}

TEST(SampleLaws, TddIsSilentInUplinkAndGuard) {
  CellParameters cell = cell_of(301, 6, 1, CyclicPrefix::kNormal, Duplex::kTdd);
  cell.tdd_configuration = 2;  // D S U D D D S U D D
  cell.special_subframe_configuration = 5;
  const std::vector<CellParameters> cells{cell};
  const auto x = synthesize(cells, 1.92e6, 19200);
  for (const std::size_t subframe : {1U, 6U}) {
    const auto dw_pts = std::size_t{138 + 137 + 137};
    EXPECT_GT(power(std::span(x).subspan(subframe * 1920, dw_pts)), 0.2);
    EXPECT_EQ(power(std::span(x).subspan(subframe * 1920 + dw_pts, 1920 - dw_pts)), 0.0);
    EXPECT_EQ(power(std::span(x).subspan((subframe + 1) * 1920, 1920)), 0.0);
    EXPECT_GT(power(std::span(x).subspan((subframe + 2) * 1920, 1920)), 0.3);
  }
}

TEST(SampleNoise, HasTheStatedVarianceAndIsWhite) {
  const std::vector<CellParameters> none;
  constexpr std::size_t kSamples = 200000;
  const auto x = synthesize(none, 1.92e6, kSamples, 0.25, 8);
  const double sigma = 1.0 / std::sqrt(static_cast<double>(kSamples));
  EXPECT_NEAR(power(x), 0.25, 5.0 * 0.25 * sigma);
  for (const std::size_t lag : {1U, 2U, 128U}) {
    Cf64 sum = 0.0;
    for (std::size_t i = lag; i < kSamples; ++i) sum += Cf64(x[i]) * std::conj(Cf64(x[i - lag]));
    EXPECT_LT(std::abs(sum) / static_cast<double>(kSamples), 5.0 * 0.25 * sigma) << lag;
  }
  EXPECT_NE(x, synthesize(none, 1.92e6, kSamples, 0.25, 9));
}

TEST(SampleNoise, SnrIsPerReferenceElement) {
  EXPECT_NEAR(noise_variance_for_snr(10.0), 0.1, 1e-12);
  EXPECT_NEAR(noise_variance_for_snr(-10.0, -3.0), std::pow(10.0, 0.7), 1e-12);
}

TEST(SynthesizerSetup, NamesWhatItRefuses) {
  const auto message = [](auto&& change, double rate_hz = 1.92e6, double variance = 0.0) -> std::string {
    std::vector<CellParameters> cells{cell_of(0, 6, 1), cell_of(1, 6, 1)};
    change(cells[1]);
    try {
      Synthesizer synthesizer(cells, rate_hz, variance);
    } catch (const std::invalid_argument& error) {
      return error.what();
    }
    return "accepted";
  };
  using C = CellParameters;
  const auto nothing = [](C&) {};
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(message(nothing), "accepted");
  EXPECT_EQ(message([](C& c) { c.cell_id = 504; }), "cells[1].cell_id: 504, must be 0 ... 503");
  EXPECT_THAT(message([](C& c) { c.cell_id = -1; }), HasSubstr("cells[1].cell_id: -1"));
  EXPECT_THAT(message([](C& c) { c.n_rb = 20; }), HasSubstr("n_rb: 20, must be 6, 15, 25, 50, 75 or 100"));
  EXPECT_THAT(message([](C& c) { c.n_ports = 3; }), HasSubstr("n_ports: 3"));
  EXPECT_THAT(message([](C& c) { c.tdd_configuration = 7; }), HasSubstr("tdd_configuration: 7"));
  EXPECT_THAT(message([](C& c) { c.special_subframe_configuration = 10; }),
              HasSubstr("special_subframe_configuration"));
  EXPECT_THAT(message([](C& c) {
                c.cp = CyclicPrefix::kExtended;
                c.duplex = Duplex::kTdd;
                c.special_subframe_configuration = 8;
              }),
              HasSubstr("special_subframe_configuration: 8, must be 0 ... 7"));
  EXPECT_THAT(message([](C& c) { c.start_sfn = 1024; }), HasSubstr("start_sfn: 1024"));
  EXPECT_THAT(message([](C& c) { c.phich_resource = 4; }), HasSubstr("phich_resource: 4"));
  EXPECT_THAT(message([nan](C& c) { c.delay_s = nan; }), HasSubstr("delay_s: nan"));
  EXPECT_THAT(message([nan](C& c) { c.cfo_hz = nan; }), HasSubstr("cfo_hz: nan, must be finite"));
  EXPECT_THAT(message([nan](C& c) { c.carrier_phase_rad = nan; }), HasSubstr("carrier_phase_rad"));
  EXPECT_THAT(message([](C& c) { c.power_db = 400.0; }), HasSubstr("power_db: 400"));
  EXPECT_THAT(message([](C& c) { c.crs_boost_db = -400.0; }), HasSubstr("crs_boost_db"));
  EXPECT_THAT(message([nan](C& c) { c.sync_boost_db = nan; }), HasSubstr("sync_boost_db"));
  EXPECT_THAT(message([](C& c) { c.clock_error_ppm = 1001.0; }), HasSubstr("clock_error_ppm: 1001"));
  EXPECT_THAT(message([](C& c) { c.data_load = 1.5; }), HasSubstr("data_load: 1.5, must be 0 ... 1"));
  EXPECT_THAT(message([nan](C& c) { c.port_gain[2] = nan; }), HasSubstr("port_gain[2]: nan"));
  EXPECT_THAT(message([nan](C& c) { c.taps[0].gain = {0.0, nan}; }), HasSubstr("taps[0].gain"));
  EXPECT_THAT(message([nan](C& c) { c.taps[0].delay_s = nan; }), HasSubstr("taps[0].delay_s"));
  EXPECT_THAT(message(nothing, 1.3e6), HasSubstr("sample_rate_hz: 1.3e+06, must be 1.4e6 ... 100e6"));
  EXPECT_THAT(message(nothing, nan), HasSubstr("sample_rate_hz: nan"));
  EXPECT_THAT(message(nothing, 1.92e6, -1.0), HasSubstr("noise_variance: -1"));
  EXPECT_THROW(static_cast<void>(resource_grid(cell_of(0, 6, 1), 1024, 0)), std::invalid_argument);
  EXPECT_THROW(static_cast<void>(resource_grid(cell_of(0, 6, 1), 0, 10)), std::invalid_argument);
}

TEST(SynthesizerSetup, EmptyInputs) {
  EXPECT_TRUE(synthesize({}, 1.92e6, 0).empty());
  const auto silence = synthesize({}, 1.92e6, 10);
  EXPECT_EQ(power(silence), 0.0);
  CellParameters cell = cell_of(0, 6, 1);
  cell.taps.clear();
  const std::vector<CellParameters> cells{cell};
  EXPECT_EQ(power(synthesize(cells, 1.92e6, 100)), 0.0);
}

}  // namespace
}  // namespace soopnav::lte
