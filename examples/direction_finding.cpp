// From samples of four antennas to a bearing with its covariance (docs/direction_finding.md).

#include <cmath>
#include <cstdio>
#include <memory>
#include <vector>

#include "soopnav/array/direction_finder.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/core/random.hpp"

namespace array = soopnav::array;
using soopnav::Cf32, soopnav::kPi, soopnav::RandomStream;

int main() {
  const array::Direction truth{30.0 * kPi / 180.0, 50.0 * kPi / 180.0};
  const auto table =
      std::make_shared<const array::SteeringTable>(array::Manifold(array::ArrayGeometry::planar(2, 2, 0.2)));
  const array::Manifold& manifold = table->manifold();

  std::vector<Cf32> iq(4 * 2500), signal(2500);
  RandomStream(1).fill_complex_normal(iq);
  RandomStream(2).fill_complex_normal(signal, 3.0);
  array::ComplexVector a;
  if (!manifold.steering(array::unit_vector(truth), table->frequency_hz(), a)) return 1;
  for (std::size_t m = 0; m < 4; ++m) {
    for (std::size_t n = 0; n < 2500; ++n) iq[m * 2500 + n] += Cf32(a[static_cast<Eigen::Index>(m)]) * signal[n];
  }
  const Cf32* const samples = iq.data();

  array::DirectionFinder finder(table, {array::DirectionMethod::kMusic, 1});
  const array::Bearings found = finder.estimate({samples, 4, 2500, 2500});
  if (found.status != array::ArrayStatus::kOk) return 1;
  const array::Bearing& bearing = found.sources[0];
  const double azimuth_sigmas =
      std::abs(bearing.azimuth_rad - truth.azimuth_rad) / std::sqrt(bearing.covariance_rad2(0, 0));
  const double elevation_sigmas =
      std::abs(bearing.elevation_rad - truth.elevation_rad) / std::sqrt(bearing.covariance_rad2(1, 1));
  std::printf("azimuth %.2f deg, elevation %.2f deg: %.1f and %.1f standard deviations off\n",
              bearing.azimuth_rad * 180.0 / kPi, bearing.elevation_rad * 180.0 / kPi, azimuth_sigmas, elevation_sigmas);
  return azimuth_sigmas < 4.5 && elevation_sigmas < 4.5 && bearing.covariance_rad2(0, 0) < 4e-4 ? 0 : 1;
}
