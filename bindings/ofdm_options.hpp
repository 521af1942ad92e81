#pragma once

#include <optional>
#include <string>

#include "soopnav/simulation/ofdm_link.hpp"
#include "soopnav/waveform/ofdm/boundary.hpp"
#include "soopnav/waveform/ofdm/synthesis.hpp"

/// The words that Python has for the OFDM enumerations; any other raises ValueError that lists them.
namespace soopnav::python {

ofdm::Constellation constellation_of(const std::string& word);
ofdm::BoundaryMethod boundary_method_of(const std::string& word);
const char* word_of(ofdm::BoundaryMethod method) noexcept;
simulation::Movement movement_of(const std::string& word);

}  // namespace soopnav::python
