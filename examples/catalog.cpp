// What a navigator takes from a snapshot of the shared database, without a network (docs/signal_database.md).

#include <array>
#include <cmath>
#include <cstdio>

#include "soopnav/core/constants.hpp"
#include "soopnav/geometry/wgs84.hpp"
#include "soopnav/navigation/sop_catalog.hpp"

namespace navigation = soopnav::navigation;
using soopnav::kSpeedOfLightMps;

int main(int argc, char** argv) {
  // As `soopnav sopdb pull` writes one; without an argument, one made here.
  constexpr std::int64_t kNoonUs = 1'772'366'400'000'000;  // 2026-03-01 12:00 UTC
  navigation::SopSource tower;
  tower.id = "tower-7";
  tower.name = "PN 168, north sector";
  tower.kind = navigation::SopKind::kCdma;
  tower.carrier_hz = 881.52e6;
  tower.contributions = 3;
  tower.newest_us = tower.at_us = kNoonUs;
  tower.grade = 'A';
  tower.position = navigation::SopPosition{};
  tower.position->value = soopnav::geometry::geodetic_to_ecef(0.5286, -1.7057, 210.0);
  tower.clock = navigation::SopClock{};
  tower.clock->value = {2.5e-7, 4e-12};
  tower.clock->covariance << 1e-18, 0.0, 0.0, 1e-24;
  tower.noise = navigation::SopNoise{{std::log(3e-25), std::log(3e-27)}, 0.1 * Eigen::Matrix2d::Identity()};

  const auto catalog = argc > 1 ? navigation::SopCatalog::open(argv[1])
                                : navigation::SopCatalog::read(navigation::write_snapshot({&tower, 1}, kNoonUs));
  const Eigen::Vector3d here = soopnav::geometry::geodetic_to_ecef(0.5290, -1.7050, 150.0);
  std::array<const navigation::SopSource*, 8> found{};
  const std::size_t count = catalog.near(here, 20e3, found);
  std::printf("%zu of %zu sources within 20 km\n", count, catalog.sources().size());
  if (argc > 1) return 0;
  if (count != 1) return 1;

  const soopnav::Epoch an_hour_later = soopnav::Epoch(soopnav::TimeScale::kUtc, kNoonUs / 1'000'000 + 3600, 0.0);
  navigation::SopPrior prior;
  if (!navigation::prior(*found[0], an_hour_later, prior)) return 1;
  std::printf("%s: clock %.1f m ahead, to %.2f m; drift to %.1e\n", found[0]->name.c_str(), prior.clock[0],
              std::sqrt(prior.clock_covariance(0, 0)), std::sqrt(prior.clock_covariance(1, 1)) / kSpeedOfLightMps);
  const double expected_m = kSpeedOfLightMps * (2.5e-7 + 3600.0 * 4e-12);
  return std::abs(prior.clock[0] - expected_m) < 1e-6 && prior.clock_covariance(0, 0) > 9.0 ? 0 : 1;
}
