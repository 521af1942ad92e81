#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "soopnav/waveform/lte/synthesis.hpp"

namespace soopnav::lte::detail {

/// Random streams of a seed: noise, and the data of each cell.
inline constexpr std::uint64_t kNoiseStream = 0;
[[nodiscard]] constexpr std::uint64_t cell_stream(int cell_id) noexcept {
  return 1U + static_cast<std::uint64_t>(cell_id);
}

/// @throws std::invalid_argument naming the cell (by its place in the list when `index` >= 0) and its parameter.
void check_cell(const CellParameters& cell, int index);

/// Elements of a subframe's grid over all ports.
[[nodiscard]] std::size_t grid_size(const CellParameters& cell) noexcept;

/// `resource_grid` into `out` of `grid_size` elements, for a cell that has been checked. No allocation.
void fill_grid(const CellParameters& cell, int sfn, int subframe, std::uint64_t seed, std::span<Cf32> out);

}  // namespace soopnav::lte::detail
