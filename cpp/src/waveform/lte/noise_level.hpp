#pragma once

namespace soopnav::lte {

/// Level that the largest of `trials` sums of `ports` unit exponentials exceeds with probability `p`
/// (cpp/doc/lte_time_of_arrival.md eq. 9).
[[nodiscard]] double noise_level(int ports, double trials, double p);

}  // namespace soopnav::lte
