#pragma once

#include <array>
#include <complex>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "soopnav/waveform/lte/types.hpp"

namespace soopnav::lte {

/// One propagation path of a cell.
struct PathTap {
  double delay_s = 0.0;             ///< after the cell's `delay_s`; any finite value, exact
  std::complex<double> gain = 1.0;  ///< amplitude and phase
};

/// Which antenna ports send PSS and SSS. The standard leaves it open (TS 36.211 6.11.1.2); a receiver sees the sum.
enum class SyncPorts : std::uint8_t { kFirst, kAll };

/// One eNodeB as it reaches the receiver.
///
/// Scale: at `power_db` = 0 a resource element of one port has |X| = 1 after a unitary transform (factor 1/sqrt(N) for
/// N samples of 1/15 kHz) when the path's and the port's gains are 1. PSS, SSS and CRS elements have that power on each
/// port that sends them; PBCH and data have it summed over the ports.
struct CellParameters {
  int cell_id = 0;  ///< 0 ... 503
  int n_rb = 6;     ///< 6, 15, 25, 50, 75 or 100
  int n_ports = 1;  ///< 1, 2 or 4
  CyclicPrefix cp = CyclicPrefix::kNormal;
  Duplex duplex = Duplex::kFdd;
  int tdd_configuration = 1;               ///< uplink-downlink configuration 0 ... 6 (TS 36.211 table 4.2-2)
  int special_subframe_configuration = 7;  ///< 0 ... 9, extended cyclic prefix 0 ... 7 (TS 36.211 table 4.2-1)
  int start_sfn = 0;                       ///< 0 ... 1023, of the frame that starts at `delay_s`
  bool extended_phich = false;             ///< in the MIB only
  int phich_resource = 2;                  ///< in the MIB only: 0 = 1/6, 1 = 1/2, 2 = 1, 3 = 2

  double delay_s = 0.0;            ///< capture time at which frame `start_sfn` starts; any real number, exact
  double power_db = 0.0;           ///< of all elements
  double cfo_hz = 0.0;             ///< where the carrier lies in the baseband spectrum; phase continuous from sample 0
  double clock_error_ppm = 0.0;    ///< the cell's clock over the receiver's: positive makes frames short; +-1000
  double carrier_phase_rad = 0.0;  ///< at capture time 0
  std::array<std::complex<double>, kMaxPorts> port_gain{1.0, 1.0, 1.0, 1.0};  ///< channel of each port, before the taps
  std::vector<PathTap> taps{PathTap{}};

  SyncPorts sync_ports = SyncPorts::kFirst;
  double crs_boost_db = 0.0;   ///< power of CRS over the other elements
  double sync_boost_db = 0.0;  ///< power of PSS and SSS over the other elements
  double data_load = 1.0;      ///< share of resource blocks (of a subframe) that carry data, 0 ... 1; 0: none
};

/// One subframe of one cell, as sent: ports x symbols x subcarriers.
struct ResourceGrid {
  int n_ports = 0;
  int n_symbols = 0;  ///< 14, or 12 with the extended cyclic prefix
  int n_subcarriers = 0;
  std::vector<Cf32> values;  ///< [port][symbol][subcarrier], lowest frequency first, zero frequency not counted

  [[nodiscard]] Cf32 at(int port, int symbol, int subcarrier) const noexcept {
    return values[static_cast<std::size_t>((port * n_symbols + symbol) * n_subcarriers + subcarrier)];
  }
};

/// Downlink symbols of a subframe: all, none (uplink), or the DwPTS of a special one (TS 36.211 tables 4.2-1
/// and 4.2-2). `subframe`: 0 ... 9; the cell's parameters as `Synthesizer` accepts them.
[[nodiscard]] int downlink_symbols(const CellParameters& cell, int subframe) noexcept;

/// The resource elements of a subframe: CRS (6.10.1), PSS and SSS (6.11), PBCH with its MIB (6.6), elsewhere random
/// QPSK, independent on each port (no transmit diversity). Empty are: elements where another port sends CRS, the five
/// either side of PSS and SSS, those the PBCH leaves for the CRS of four ports, uplink subframes and what follows the
/// DwPTS. Boosts are in the grid; `power_db`, gains and phases are not.
/// The data depend on `seed`, cell, `sfn` and `subframe` alone.
/// @throws std::invalid_argument naming the parameter that is out of range.
[[nodiscard]] ResourceGrid resource_grid(const CellParameters& cell, int sfn, int subframe, std::uint64_t seed = 0);

/// Noise variance per sample that gives a CRS element of unit gain `snr_db`, boosts aside. With the scale of
/// `CellParameters`, the variance of a sample is that of a resource element.
[[nodiscard]] double noise_variance_for_snr(double snr_db, double power_db = 0.0) noexcept;

/// Samples of several cells and of white noise at one receiver (TS 36.211 6.12).
///
/// Sample n is the sum over cells and taps of s((n / rate - delay) (1 + clock error)) turned by the carrier offset at
/// time n / rate, where s is the continuous-time signal: each symbol's subcarriers are evaluated at the samples' own
/// times, so delays of any fraction of a sample are exact (below 1e-14 s per 100 s of capture), and so are clock errors
/// and rates that no transform size fits. A symbol's samples are those whose time lies in it. Frames run from the
/// infinite past to the infinite future. A band wider than the rate is cut to the subcarriers within +-0.45 of the
/// rate, as a receiver's filter would; a band that fits (offset included) is kept whole.
///
/// The same seed gives the same samples however they are divided into blocks, and for each cell the same data whatever
/// the other cells are. `generate` allocates nothing.
class Synthesizer {
 public:
  /// @throws std::invalid_argument naming the parameter, its value and the rule. `sample_rate_hz`: 1.4e6 ... 100e6;
  /// `noise_variance`: per complex sample, >= 0.
  Synthesizer(std::span<const CellParameters> cells, double sample_rate_hz, double noise_variance = 0.0,
              std::uint64_t seed = 0);
  ~Synthesizer();
  Synthesizer(Synthesizer&&) noexcept;
  Synthesizer& operator=(Synthesizer&&) noexcept;

  /// Writes the next out.size() samples.
  void generate(std::span<Cf32> out);

  /// The sample that `generate` begins with; 0 at first. Negative ones are before the capture's time 0.
  [[nodiscard]] std::int64_t position() const noexcept;
  void seek(std::int64_t sample) noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// The first `n_samples` of `Synthesizer`.
/// @throws std::invalid_argument as its constructor.
[[nodiscard]] std::vector<Cf32> synthesize(std::span<const CellParameters> cells, double sample_rate_hz,
                                           std::size_t n_samples, double noise_variance = 0.0, std::uint64_t seed = 0);

}  // namespace soopnav::lte
