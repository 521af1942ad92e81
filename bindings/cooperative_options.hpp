#pragma once

#include <pybind11/pybind11.h>

#include <cstddef>
#include <span>
#include <vector>

#include "array.hpp"
#include "soopnav/navigation/cooperative_tracker.hpp"

/// What every way of making a cooperative tracker from Python reads.
namespace soopnav::python {

/// Beacons from a list of `SampledOrbit` and the epochs of their elements (empty, or one each; NaN: fresh).
std::vector<navigation::PairBeacon> pair_beacons(const py::list& orbits, std::span<const double> epoch_s);

/// Options by their C++ names; clocks as pairs (white_frequency_m2ps, frequency_walk_m2ps3), the road as rows (n, 3).
/// What is not an option of the tracker is an error.
navigation::CooperativeOptions pair_options(const py::dict& given);

/// Bursts as rows of 15 numbers: t_s, tdoa_s, fdoa_hz, the covariance's four, carrier_hz, anchor p_e and v_e, beacon.
navigation::PairMeasurement pair_measurement(std::span<const double> row);
inline constexpr std::size_t kPairColumns = 15;
std::vector<navigation::PairMeasurement> pair_measurements(const TableBase& table);

}  // namespace soopnav::python
