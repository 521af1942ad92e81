#include "soopnav/simulation/eigenvalue_map.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <utility>

#include "simulation/require.hpp"
#include "soopnav/core/angle.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/simulation/array_link.hpp"

namespace soopnav::simulation {

EigenvalueMap eigenvalue_map(std::shared_ptr<const array::SteeringTable> table, std::span<const double> snr_db,
                             const EigenvalueMapOptions& options, const RandomStream& random) {
  require(!snr_db.empty(), "snr_db.size()", 0.0, "at least one is needed");
  require(options.trials >= 10, "trials", static_cast<double>(options.trials), "at least 10 are needed");
  require(options.elevation_low_rad >= -0.5 * kPi && options.elevation_low_rad < options.elevation_high_rad,
          "elevation_low_rad", options.elevation_low_rad, "it must lie below elevation_high_rad, within +-pi/2");
  require(options.elevation_high_rad <= 0.5 * kPi, "elevation_high_rad", options.elevation_high_rad,
          "it must be at most pi/2");
  const array::Manifold& manifold = table->manifold();
  const double frequency_hz = table->frequency_hz();
  const auto m = static_cast<std::size_t>(manifold.size());
  CovarianceSampler sampler(m, options.snapshots);
  array::DirectionFinder finder(std::move(table));
  array::ComplexVector steering(manifold.size());
  array::ComplexMatrix covariance(manifold.size(), manifold.size());
  EigenvalueMap out;
  for (std::size_t i = 0; i < snr_db.size(); ++i) {
    require(std::isfinite(snr_db[i]), "snr_db", snr_db[i], "it must be finite");
    const RandomStream of_snr = random.substream(i);
    double largest = 0.0, others = 0.0, azimuth = 0.0, elevation = 0.0, angle = 0.0;
    std::size_t found = 0;
    for (std::size_t k = 0; k < options.trials; ++k) {
      RandomStream stream = of_snr.substream(k);
      const array::Direction truth{stream.uniform(-kPi, kPi),
                                   stream.uniform(options.elevation_low_rad, options.elevation_high_rad)};
      const Eigen::Vector3d u = array::unit_vector(truth);
      if (!manifold.steering(u, frequency_hz, steering)) continue;
      const std::array wave{ArrivingWave{{steering.data(), m}, std::pow(10.0, snr_db[i] / 20.0)}};
      if (!sampler.draw(wave, stream.substream(1), {covariance.data(), m * m})) continue;
      covariance.transposeInPlace();  // drawn row by row
      const array::Bearings bearings = finder.estimate(covariance, static_cast<double>(options.snapshots));
      if (bearings.status != array::ArrayStatus::kOk) continue;
      const array::Bearing& bearing = bearings.sources.front();
      ++found;
      largest += bearings.eigenvalues.front();
      others += bearings.noise;
      const double off = wrap_to_pi(bearing.azimuth_rad - truth.azimuth_rad);
      azimuth += off * off;
      elevation += (bearing.elevation_rad - truth.elevation_rad) * (bearing.elevation_rad - truth.elevation_rad);
      const Eigen::Vector3d v = array::unit_vector({bearing.azimuth_rad, bearing.elevation_rad});
      const double between = 2.0 * std::asin(std::min(1.0, 0.5 * (u - v).norm()));
      angle += between * between;
    }
    require(found >= options.trials / 2, "snr_db", snr_db[i], "the array finds no direction there");
    const auto n = static_cast<double>(found);
    out.snr_db.push_back(snr_db[i]);
    out.ratio.push_back(largest / others);
    out.azimuth_rms_rad.push_back(std::sqrt(azimuth / n));
    out.elevation_rms_rad.push_back(std::sqrt(elevation / n));
    out.angle_rms_rad.push_back(std::sqrt(angle / n));
  }
  return out;
}

}  // namespace soopnav::simulation
