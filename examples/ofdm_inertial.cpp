// A cheap inertial sensor in a plane, held by the block boundaries of three OFDM transmitters (crosby section 4.1).
//
// Everything that moves is simulated: the way, the sensors, and each second the transmitters' samples.

#include <array>
#include <cmath>
#include <cstdio>
#include <vector>

#include "soopnav/core/random.hpp"
#include "soopnav/navigation/ofdm_inertial_navigator.hpp"
#include "soopnav/simulation/ofdm_link.hpp"
#include "soopnav/simulation/planar_trajectory.hpp"
#include "soopnav/waveform/ofdm/boundary.hpp"

using namespace soopnav;

namespace {

const std::vector<Eigen::Vector2d> kTransmitters{{1000, 1500}, {-2000, 1000}, {500, -2000}};
constexpr double kImuHz = 50.0;
constexpr int kSeconds = 120;

double range_change(const simulation::PlanarTrajectory& way, double t_s, const Eigen::Vector2d& transmitter) {
  return (way.at(t_s)->position_m - transmitter).norm() - (way.at(0.0)->position_m - transmitter).norm();
}

}  // namespace

int main() {
  const auto way = simulation::PlanarTrajectory::continuous_turn();
  const auto imu = simulation::planar_imu(way, kImuHz, inertial::ImuErrorModel::crosby(), RandomStream(1));

  const ofdm::Numerology numerology;  // 64 subcarriers, 16 samples of prefix, 20 MHz
  simulation::OfdmLink link(numerology, 250, {.movement = simulation::Movement::kFractionalDelay});
  std::vector<simulation::BoundarySeries> heard;
  for (std::size_t k = 0; k < kTransmitters.size(); ++k) {
    std::vector<double> delays_m;
    for (int t = 1; t <= kSeconds; ++t) delays_m.push_back(range_change(way, t, kTransmitters[k]));
    heard.push_back(link.measure(delays_m, {}, RandomStream(2 + k), {.snr_db = 10.0}));
  }

  const std::vector<navigation::PlanarStart> start(1);
  navigation::OfdmInertialNavigator navigator(
      kTransmitters, start,
      {.imu = {.gyro_sigma_radps = 0.1, .accelerometer_sigma_mps2 = 0.1}, .ambiguity_m = numerology.ambiguity_m()});
  std::array<navigation::RangeChange, 3> epoch;
  std::array<navigation::RangeChangeReport, 3> reports;
  int accepted = 0;
  double sum_squared = 0.0;
  for (std::size_t i = 0; i < imu.size(); ++i) {
    if (navigator.predict(0, imu[i].sample, 1.0 / kImuHz) != UpdateStatus::kAccepted) return 1;
    if ((i + 1) % 50 != 0) continue;
    const std::size_t second = (i + 1) / 50 - 1;
    for (std::size_t k = 0; k < 3; ++k) {
      epoch[k] = {0, static_cast<int>(k), heard[k].range_m[second], heard[k].sigma_m[second]};
    }
    navigator.update(epoch, reports);
    for (const auto& report : reports) accepted += report.status == UpdateStatus::kAccepted ? 1 : 0;
    sum_squared += (navigator.state()(kPlanarPosition) - way.at(imu[i].t_s)->position_m).squaredNorm();
  }

  const double rms_m = std::sqrt(sum_squared / kSeconds);
  const Eigen::Matrix2d P = navigator.covariance().block<2, 2>(3, 3);
  std::printf("%d of %d boundaries taken, position RMS %.2f m, stated at the end %.2f m\n", accepted, 3 * kSeconds,
              rms_m, std::sqrt(P.trace()));
  return accepted == 3 * kSeconds && rms_m < 8.0 ? 0 : 1;
}
