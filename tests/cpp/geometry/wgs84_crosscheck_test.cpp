// Points of an independent program (a sample of vectors/nav/wgs84.npz; the Python tests read all 408).

#include <gtest/gtest.h>

#include <cmath>

#include "soopnav/core/angle.hpp"
#include "soopnav/geometry/local_frame.hpp"
#include "soopnav/geometry/wgs84.hpp"

namespace soopnav::geometry {
namespace {

struct Point {
  double latitude_deg, longitude_deg, height_m;
  Eigen::Vector3d p_e;
  Eigen::Vector3d p_enu;  // about kOrigin
  double azimuth_deg, elevation_deg, range_m;
};

const Geodetic kOrigin{radians(22.3045966), radians(114.180121), 61.384};

const Point kPoints[] = {
    {0.0,
     0.0,
     0.0,
     {6378137.0, 0.0, 0.0},
     {-5818533.838174602, 1006533.0708237225, -8792178.0045678},
     279.814320741863,
     -56.1141331998592,
     10591073.548637576},
    {90.0,
     0.0,
     0.0,
     {3.9186209248144716e-10, 0.0, 6356752.314245179},
     {0.0, 5896135.309422029, -3962541.8383807465},
     0.0,
     -33.90336949919965,
     7103953.083173556},
    {-45.0,
     -90.0,
     -100.0,
     {2.7661833070169993e-10, -4517520.168170813, -4487277.698187801},
     {1850405.8300880366, -2572429.8163494486, -11890995.55615703},
     144.27169794042973,
     -75.07810132598503,
     12305981.15603196},
    {-85.0393596162477,
     -53.631409451548734,
     595.57609790826,
     {328165.1995083932, -445623.695283474, -6333375.832768794},
     {-116842.35259712208, -5639203.427240427, -9279301.505574381},
     181.18697897718135,
     -58.70671741937328,
     10859083.932842383},
    {-55.50907337637566,
     -123.3893201350426,
     3611.3501831785507,
     {-1993316.0544847623, -3024248.9467459493, -5236660.38470468},
     {3057179.2236607624, -4092637.500888365, -10159692.92025323},
     143.2404573596139,
     -63.306149531324564,
     11371692.343407132},
    {5.260105373464825,
     156.6207780377007,
     5720654.540811898,
     {-11058860.077761585, 4780835.393189579, 1105285.8644592657},
     {8130319.502083982, -2336876.946940477, 2270281.5290930816},
     106.03610341863875,
     15.022532999623554,
     8758839.380445916},
    {-20.877224671564235,
     97.44652763390553,
     10796682.556780485,
     {-2080062.8557711025, 15914402.583707955, -6106276.721464},
     {-4621080.570002642, -11467827.10563976, 5527473.305921436},
     201.94748443520112,
     24.087812214109448,
     13543205.13419833},
    {-38.431615595110834,
     121.58915121736823,
     19531604.25927043,
     {-10635151.146120844, 17294528.09029089, -16083542.785089547},
     {2618095.3871402247, -22506387.48146368, 6147663.974013733},
     173.3647887694006,
     15.1801701767144,
     23477343.82887758},
};

TEST(Wgs84Crosscheck, GeodeticToEcef) {
  for (const Point& point : kPoints) {
    const Eigen::Vector3d p_e =
        geodetic_to_ecef(radians(point.latitude_deg), radians(point.longitude_deg), point.height_m);
    EXPECT_LT((p_e - point.p_e).norm(), 4e-16 * point.p_e.norm() + 1e-9) << point.latitude_deg;
  }
}

TEST(Wgs84Crosscheck, EcefToGeodetic) {
  for (const Point& point : kPoints) {
    const auto place = ecef_to_geodetic(point.p_e);
    ASSERT_TRUE(place);
    EXPECT_NEAR(place->latitude_rad, radians(point.latitude_deg), 5e-16);
    EXPECT_NEAR(place->height_m, point.height_m, 1e-9 + 4e-16 * point.p_e.norm());
    if (std::abs(point.latitude_deg) < 90.0) {
      EXPECT_NEAR(wrap_to_pi(place->longitude_rad - radians(point.longitude_deg)), 0.0, 1e-15);
    }
  }
}

TEST(Wgs84Crosscheck, LocalFrameAndDirections) {
  const LocalFrame enu(kOrigin);
  const LocalFrame ned(kOrigin, LocalAxes::kNed);
  for (const Point& point : kPoints) {
    EXPECT_LT((enu.position_from_ecef(point.p_e) - point.p_enu).norm(), 1e-8);
    EXPECT_LT((swap_enu_ned(ned.position_from_ecef(point.p_e)) - point.p_enu).norm(), 1e-8);
    for (const LocalFrame& frame : {enu, ned}) {
      const auto direction = frame.direction_to(point.p_e);
      ASSERT_TRUE(direction);
      EXPECT_NEAR(angle_difference(direction->azimuth_rad, radians(point.azimuth_deg)), 0.0, 1e-14);
      EXPECT_NEAR(direction->elevation_rad, radians(point.elevation_deg), 1e-14);
      EXPECT_NEAR(direction->range_m, point.range_m, 1e-8);
    }
  }
}

}  // namespace
}  // namespace soopnav::geometry
