#include "waveform/lte/synthesis_grid.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <sstream>
#include <stdexcept>
#include <string>
#include <string_view>

#include "soopnav/core/random.hpp"
#include "soopnav/waveform/lte/pbch.hpp"
#include "soopnav/waveform/lte/sequences.hpp"

namespace soopnav::lte {
namespace {

enum class SubframeKind : char { kDownlink = 'D', kSpecial = 'S', kUplink = 'U' };

// TS 36.211 table 4.2-2.
constexpr std::array<std::string_view, 7> kTddConfigurations{"DSUUUDSUUU", "DSUUDDSUUD", "DSUDDDSUDD", "DSUUUDDDDD",
                                                             "DSUUDDDDDD", "DSUDDDDDDD", "DSUUUDSUUD"};

// TS 36.211 table 4.2-1, DwPTS in whole symbols.
constexpr std::array<int, 10> kDwPtsNormal{3, 9, 10, 11, 12, 3, 9, 10, 11, 6};
constexpr std::array<int, 8> kDwPtsExtended{3, 8, 9, 10, 3, 8, 9, 5};

SubframeKind subframe_kind(const CellParameters& cell, int subframe) noexcept {
  if (cell.duplex == Duplex::kFdd) return SubframeKind::kDownlink;
  const auto& row = kTddConfigurations[static_cast<std::size_t>(cell.tdd_configuration)];
  return static_cast<SubframeKind>(row[static_cast<std::size_t>(subframe)]);
}

float amplitude(double power_db) noexcept { return static_cast<float>(std::pow(10.0, power_db / 20.0)); }

}  // namespace

int downlink_symbols(const CellParameters& cell, int subframe) noexcept {
  switch (subframe_kind(cell, subframe)) {
    case SubframeKind::kDownlink:
      return 2 * symbols_per_slot(cell.cp);
    case SubframeKind::kSpecial: {
      const auto i = static_cast<std::size_t>(cell.special_subframe_configuration);
      return cell.cp == CyclicPrefix::kNormal ? kDwPtsNormal[i] : kDwPtsExtended[i];
    }
    case SubframeKind::kUplink:
      break;
  }
  return 0;
}

double noise_variance_for_snr(double snr_db, double power_db) noexcept {
  return std::pow(10.0, (power_db - snr_db) / 10.0);
}

namespace detail {

void check_cell(const CellParameters& cell, int index) {
  const auto refuse = [index](std::string_view name, auto value, std::string_view rule) {
    std::ostringstream text;
    if (index >= 0) text << "cells[" << index << "].";
    text << name << ": " << value << ", must be " << rule;
    throw std::invalid_argument(text.str());
  };
  const auto integer = [&](std::string_view name, int value, int low, int high) {
    if (value < low || value > high) refuse(name, value, std::to_string(low) + " ... " + std::to_string(high));
  };
  const auto finite = [&](std::string_view name, double value) {
    if (!std::isfinite(value)) refuse(name, value, "finite");
  };
  const auto decibels = [&](std::string_view name, double value) {
    if (!(std::abs(value) <= 300.0)) refuse(name, value, "-300 ... 300 dB");
  };
  const auto delay = [&](std::string_view name, double value) {
    if (!(std::abs(value) <= 1e6)) refuse(name, value, "-1e6 ... 1e6 s");
  };
  integer("cell_id", cell.cell_id, 0, kCells - 1);
  if (std::find(kBandwidthsRb.begin(), kBandwidthsRb.end(), cell.n_rb) == kBandwidthsRb.end()) {
    refuse("n_rb", cell.n_rb, "6, 15, 25, 50, 75 or 100");
  }
  if (cell.n_ports != 1 && cell.n_ports != 2 && cell.n_ports != 4) refuse("n_ports", cell.n_ports, "1, 2 or 4");
  integer("tdd_configuration", cell.tdd_configuration, 0, 6);
  const bool normal = cell.cp == CyclicPrefix::kNormal;
  if (normal || cell.duplex == Duplex::kTdd) {
    integer("special_subframe_configuration", cell.special_subframe_configuration, 0, normal ? 9 : 7);
  }
  integer("start_sfn", cell.start_sfn, 0, 1023);
  integer("phich_resource", cell.phich_resource, 0, 3);
  delay("delay_s", cell.delay_s);
  decibels("power_db", cell.power_db);
  decibels("crs_boost_db", cell.crs_boost_db);
  decibels("sync_boost_db", cell.sync_boost_db);
  finite("cfo_hz", cell.cfo_hz);
  finite("carrier_phase_rad", cell.carrier_phase_rad);
  if (!(std::abs(cell.clock_error_ppm) <= 1000.0)) {
    refuse("clock_error_ppm", cell.clock_error_ppm, "-1000 ... 1000");
  }
  if (!(cell.data_load >= 0.0 && cell.data_load <= 1.0)) refuse("data_load", cell.data_load, "0 ... 1");
  for (std::size_t i = 0; i < cell.port_gain.size(); ++i) {
    const std::string name = "port_gain[" + std::to_string(i) + "]";
    finite(name, cell.port_gain[i].real());
    finite(name, cell.port_gain[i].imag());
  }
  for (std::size_t i = 0; i < cell.taps.size(); ++i) {
    const std::string name = "taps[" + std::to_string(i) + "]";
    delay(name + ".delay_s", cell.taps[i].delay_s);
    finite(name + ".gain", cell.taps[i].gain.real());
    finite(name + ".gain", cell.taps[i].gain.imag());
  }
}

std::size_t grid_size(const CellParameters& cell) noexcept {
  return static_cast<std::size_t>(cell.n_ports * 2 * symbols_per_slot(cell.cp) * 12 * cell.n_rb);
}

namespace {

/// A grid being filled: the elements of one port and symbol as a span.
struct Canvas {
  std::span<Cf32> values;
  int n_symbols;
  int n_subcarriers;

  [[nodiscard]] std::span<Cf32> row(int port, int symbol) const noexcept {
    return values.subspan(static_cast<std::size_t>((port * n_symbols + symbol) * n_subcarriers),
                          static_cast<std::size_t>(n_subcarriers));
  }
  void clear(int port, int symbol, int first, int count) const noexcept {
    const auto part = row(port, symbol).subspan(static_cast<std::size_t>(first), static_cast<std::size_t>(count));
    std::fill(part.begin(), part.end(), Cf32{});
  }
};

void fill_data(const CellParameters& cell, int sfn, int subframe, std::uint64_t seed, int n_downlink,
               const Canvas& canvas) {
  // A stream for each subframe of each cell, and in it fixed places for each row: any subframe can be made alone.
  constexpr std::uint64_t kPlacesPerRow = 128;  // sixteen elements to a place; 1200 / 16 = 75
  RandomStream random =
      RandomStream(seed, cell_stream(cell.cell_id)).substream(static_cast<std::uint64_t>(16 * sfn + subframe));
  const float a = static_cast<float>(std::sqrt(0.5 / cell.n_ports));
  const std::array<Cf32, 4> qpsk{Cf32{a, a}, Cf32{-a, a}, Cf32{a, -a}, Cf32{-a, -a}};
  std::array<std::uint32_t, kPlacesPerRow> words;
  for (int port = 0; port < cell.n_ports; ++port) {
    for (int symbol = 0; symbol < n_downlink; ++symbol) {
      const auto row = canvas.row(port, symbol);
      random.seek(static_cast<std::uint64_t>(port * canvas.n_symbols + symbol) * kPlacesPerRow);
      random.fill_u32(std::span(words).first((row.size() + 15) / 16));
      for (std::size_t i = 0; i < row.size(); ++i) row[i] = qpsk[(words[i / 16] >> (2 * (i % 16))) & 3U];
    }
  }
  if (cell.data_load >= 1.0) return;
  random.seek(0);
  for (int rb = 0; rb < cell.n_rb; ++rb) {
    if (random.uniform() < cell.data_load) continue;
    for (int port = 0; port < cell.n_ports; ++port) {
      for (int symbol = 0; symbol < n_downlink; ++symbol) canvas.clear(port, symbol, 12 * rb, 12);
    }
  }
}

/// PSS or SSS, and the reserved elements either side (TS 36.211 6.11.1.2, 6.11.2.2).
void fill_sync(const CellParameters& cell, int subframe, int n_downlink, const Canvas& canvas) {
  const int per_slot = symbols_per_slot(cell.cp);
  const bool fdd = cell.duplex == Duplex::kFdd;
  // FDD: PSS in the last symbol of slots 0 and 10, SSS before it. TDD: PSS in the third symbol of subframes 1 and 6,
  // SSS in the last one before those subframes.
  int pss_symbol = -1, sss_symbol = -1;
  if (subframe % 5 == 0) sss_symbol = fdd ? per_slot - 2 : 2 * per_slot - 1;
  if (fdd && subframe % 5 == 0) pss_symbol = per_slot - 1;
  if (!fdd && subframe % 5 == 1) pss_symbol = 2;
  const float a = amplitude(cell.sync_boost_db);
  const auto centre = static_cast<std::size_t>(6 * cell.n_rb);
  for (int port = 0; port < cell.n_ports; ++port) {
    const bool sends = port == 0 || cell.sync_ports == SyncPorts::kAll;
    for (const int symbol : {pss_symbol, sss_symbol}) {
      if (symbol < 0 || symbol >= n_downlink) continue;
      canvas.clear(port, symbol, 6 * cell.n_rb - 36, 72);
      if (!sends) continue;
      const auto row = canvas.row(port, symbol).subspan(centre - 31, kSyncSubcarriers);
      if (symbol == pss_symbol) {
        std::transform(pss(cell.cell_id % 3).begin(), pss(cell.cell_id % 3).end(), row.begin(),
                       [a](Cf32 d) { return a * d; });
      } else {
        const auto d = sss(cell.cell_id, subframe);
        std::transform(d.begin(), d.end(), row.begin(), [a](float x) { return Cf32{a * x, 0.0F}; });
      }
    }
  }
}

/// PBCH with transmit diversity (TS 36.211 6.6, 6.3.3.3, 6.3.4.3).
void fill_pbch(const CellParameters& cell, int sfn, const Canvas& canvas) {
  const int per_slot = symbols_per_slot(cell.cp);
  for (int port = 0; port < cell.n_ports; ++port) {
    for (int l = 0; l < 4; ++l) canvas.clear(port, per_slot + l, 6 * cell.n_rb - 36, 72);
  }
  std::array<std::uint8_t, 1920> bits;
  const int per_frame = pbch_bits_per_frame(cell.cp);
  const MasterInformationBlock mib{cell.n_rb, sfn, cell.extended_phich, cell.phich_resource, 0};
  encode_pbch(mib, cell.cell_id, cell.n_ports, cell.cp, std::span(bits).first(static_cast<std::size_t>(4 * per_frame)));
  const auto frame_bits =
      std::span(bits).subspan(static_cast<std::size_t>(sfn % 4 * per_frame), static_cast<std::size_t>(per_frame));
  std::array<PbchElement, 240> elements;
  const auto n = static_cast<std::size_t>(pbch_elements(cell.cell_id, cell.cp, elements));
  constexpr float kHalfRoot = static_cast<float>(std::numbers::sqrt2 / 2.0);
  const auto put = [&](std::size_t port, std::size_t i, Cf32 value) {
    const auto row = canvas.row(static_cast<int>(port), per_slot + elements[i].symbol);
    row[static_cast<std::size_t>(6 * cell.n_rb - 36) + elements[i].subcarrier] = value;
  };
  const auto symbol = [&](std::size_t i) {
    return Cf32{frame_bits[2 * i] != 0 ? -kHalfRoot : kHalfRoot, frame_bits[2 * i + 1] != 0 ? -kHalfRoot : kHalfRoot};
  };
  for (std::size_t i = 0; i < n; i += 2) {
    const Cf32 a = symbol(i), b = symbol(i + 1);
    if (cell.n_ports == 1) {
      put(0, i, a);
      put(0, i + 1, b);
      continue;
    }
    const std::size_t first = cell.n_ports == 4 && i % 4 != 0 ? 1 : 0;
    const std::size_t second = cell.n_ports == 4 ? first + 2 : 1;
    put(first, i, kHalfRoot * a);
    put(first, i + 1, kHalfRoot * b);
    put(second, i, -kHalfRoot * std::conj(b));
    put(second, i + 1, kHalfRoot * std::conj(a));
  }
}

void fill_crs(const CellParameters& cell, int subframe, int n_downlink, const Canvas& canvas) {
  const int per_slot = symbols_per_slot(cell.cp);
  const float a = amplitude(cell.crs_boost_db);
  std::array<Cf32, 2 * kMaxRb> storage;
  const auto values = std::span(storage).first(static_cast<std::size_t>(2 * cell.n_rb));
  for (int symbol = 0; symbol < n_downlink; ++symbol) {
    const int slot = 2 * subframe + symbol / per_slot;
    const int l = symbol % per_slot;
    if (!has_crs(l, 0, cell.cp) && !has_crs(l, 2, cell.cp)) continue;
    crs_values(cell.cell_id, slot, l, cell.cp, cell.n_rb, values);
    for (int port = 0; port < cell.n_ports; ++port) {
      if (!has_crs(l, port, cell.cp)) continue;
      const auto first = static_cast<std::size_t>(crs_first_subcarrier(cell.cell_id, slot, l, port));
      for (int other = 0; other < cell.n_ports; ++other) {
        const auto row = canvas.row(other, symbol);
        for (std::size_t m = 0; m < values.size(); ++m) row[first + 6 * m] = other == port ? a * values[m] : Cf32{};
      }
    }
  }
}

}  // namespace

void fill_grid(const CellParameters& cell, int sfn, int subframe, std::uint64_t seed, std::span<Cf32> out) {
  const Canvas canvas{out, 2 * symbols_per_slot(cell.cp), 12 * cell.n_rb};
  std::fill(out.begin(), out.end(), Cf32{});
  const int n_downlink = downlink_symbols(cell, subframe);
  if (n_downlink == 0) return;
  if (cell.data_load > 0.0) fill_data(cell, sfn, subframe, seed, n_downlink, canvas);
  fill_sync(cell, subframe, n_downlink, canvas);
  if (subframe == 0) fill_pbch(cell, sfn, canvas);
  fill_crs(cell, subframe, n_downlink, canvas);
}

}  // namespace detail

ResourceGrid resource_grid(const CellParameters& cell, int sfn, int subframe, std::uint64_t seed) {
  detail::check_cell(cell, -1);
  if (sfn < 0 || sfn > 1023) throw std::invalid_argument("sfn: " + std::to_string(sfn) + ", must be 0 ... 1023");
  if (subframe < 0 || subframe > 9) {
    throw std::invalid_argument("subframe: " + std::to_string(subframe) + ", must be 0 ... 9");
  }
  ResourceGrid grid{cell.n_ports, 2 * symbols_per_slot(cell.cp), 12 * cell.n_rb, {}};
  grid.values.resize(detail::grid_size(cell));
  detail::fill_grid(cell, sfn, subframe, seed, grid.values);
  return grid;
}

}  // namespace soopnav::lte
