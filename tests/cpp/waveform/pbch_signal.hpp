#pragma once

#include <array>
#include <cmath>
#include <complex>
#include <cstddef>
#include <cstdint>
#include <numbers>
#include <random>
#include <vector>

#include "soopnav/waveform/lte/pbch.hpp"

namespace soopnav::lte::test {

/// The PBCH of one frame through a flat channel with noise, precoded as TS 36.211 6.3.4.3 has it.
struct PbchSender {
  int cell_id = 0;
  int n_ports = 1;
  CyclicPrefix cp = CyclicPrefix::kNormal;
  std::array<std::complex<double>, 4> channel{1.0, 1.0, 1.0, 1.0};
  double noise_variance = 1e-6;
  double signal = 1.0;  ///< 0: noise alone

  [[nodiscard]] PbchObservation frame(const MasterInformationBlock& mib, std::mt19937_64& random) const {
    const auto per_frame = static_cast<std::size_t>(pbch_bits_per_frame(cp));
    std::vector<std::uint8_t> bits(4 * per_frame);
    encode_pbch(mib, cell_id, n_ports, cp, bits);
    const std::size_t first = static_cast<std::size_t>(mib.sfn % 4) * per_frame;
    std::vector<std::complex<double>> d(per_frame / 2);
    for (std::size_t i = 0; i < d.size(); ++i) {
      d[i] = {bits[first + 2 * i] ? -1.0 : 1.0, bits[first + 2 * i + 1] ? -1.0 : 1.0};
      d[i] *= std::numbers::sqrt2 / 2.0;
    }
    std::array<PbchElement, 240> elements;
    pbch_elements(cell_id, cp, elements);
    PbchObservation out{};
    out.noise_variance = static_cast<float>(noise_variance);
    for (std::size_t port = 0; port < 4; ++port) {
      for (auto& row : out.channel[port]) row.fill(std::complex<float>(channel[port]));
    }
    std::normal_distribution<double> normal(0.0, std::sqrt(noise_variance / 2.0));
    const auto put = [&](std::size_t i, std::complex<double> value) {
      const double re = normal(random), im = normal(random);
      out.received[elements[i].symbol][elements[i].subcarrier] =
          std::complex<float>(signal * value + std::complex<double>(re, im));
    };
    const double r = std::numbers::sqrt2 / 2.0;
    const auto& h = channel;
    for (std::size_t i = 0; i < d.size(); i += 4) {
      if (n_ports == 1) {
        for (std::size_t k = i; k < i + 4; ++k) put(k, h[0] * d[k]);
      } else if (n_ports == 2) {
        for (std::size_t k = i; k < i + 4; k += 2) {
          put(k, r * (h[0] * d[k] - h[1] * std::conj(d[k + 1])));
          put(k + 1, r * (h[0] * d[k + 1] + h[1] * std::conj(d[k])));
        }
      } else {
        put(i, r * (h[0] * d[i] - h[2] * std::conj(d[i + 1])));
        put(i + 1, r * (h[0] * d[i + 1] + h[2] * std::conj(d[i])));
        put(i + 2, r * (h[1] * d[i + 2] - h[3] * std::conj(d[i + 3])));
        put(i + 3, r * (h[1] * d[i + 3] + h[3] * std::conj(d[i + 2])));
      }
    }
    return out;
  }

  /// Soft bits of `n` frames from `mib.sfn` on.
  [[nodiscard]] std::vector<PbchSoftBits> soft_bits(MasterInformationBlock mib, std::size_t n,
                                                    std::mt19937_64& random) const {
    std::vector<PbchSoftBits> out(n);
    for (PbchSoftBits& soft : out) {
      demodulate_pbch(frame(mib, random), cell_id, cp, n_ports, soft);
      mib.sfn = (mib.sfn + 1) % 1024;
    }
    return out;
  }
};

}  // namespace soopnav::lte::test
