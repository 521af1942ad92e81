// A van between four base stations: pseudoranges once a second, one of them with a clock of its own that is estimated
// too. Everything comes from the seed; the program fails unless the filter's errors are what its covariance says.
#include <Eigen/Core>
#include <array>
#include <cmath>
#include <cstdio>

#include "soopnav/core/joint_process.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/estimation/consistency.hpp"
#include "soopnav/estimation/layout_kalman_filter.hpp"
#include "soopnav/measurement/pseudorange.hpp"
#include "soopnav/process/random_walk.hpp"

using namespace soopnav;

namespace {

using Van = LayoutState<EnuFrame, Role<3, PositionTag>, Role<1, ClockBiasTag>>;
using Filter = ExtendedKalmanFilter<Van>;

const std::array<Eigen::Vector3d, 4> kStations{
    Eigen::Vector3d(900, 200, 40), {-700, 800, 35}, {-300, -900, 50}, {600, -700, 300}};

}  // namespace

int main() {
  RandomStream random(1);
  Van::Fixed truth;
  truth.x << 20, -10, 1, 30;
  double station_clock = 5.0;

  Van::Fixed guess = truth;
  for (int i = 0; i < 4; ++i) guess.x[i] += 10.0 * random.normal();
  Filter filter(guess, 100.0 * Eigen::Matrix4d::Identity(), 8, 4);
  const Block<1> clock = filter.join(0.0, 25.0, "clock of station 3");

  const JointProcess motion{RandomWalk{kPosition, {4.0, 4.0, 0.01}}, RandomWalk{kClockBias, {1.0}}};
  const RandomWalk<Block<1>> wander{clock, {0.04}};
  double sum_nis = 0.0;
  int accepted = 0;
  for (int second = 1; second <= 200; ++second) {
    truth.x += Eigen::Vector4d(2.0 * random.normal(), 2.0 * random.normal(), 0.1 * random.normal(), random.normal());
    station_clock += 0.2 * random.normal();
    if (filter.predict(motion, 1.0) != UpdateStatus::kAccepted) return 1;
    if (filter.predict(wander, 1.0) != UpdateStatus::kAccepted) return 1;
    for (std::size_t i = 0; i < kStations.size(); ++i) {
      const double range = (truth.x.head<3>() - kStations[i]).norm() + truth.x[3];
      const bool own_clock = i == 3;
      const double z = range - (own_clock ? station_clock : 0.0) + 1.5 * random.normal();
      const auto report = own_clock
                              ? filter.update(Pseudorange<EnuFrame, Block<1>>{kStations[i], clock}, z, 2.25)
                              : filter.update(Pseudorange<EnuFrame>{kStations[i]}, z, 2.25, Gate::probability(1e-6, 1));
      if (report.accepted()) {
        sum_nis += report.nis;
        ++accepted;
      }
    }
  }

  const Eigen::Vector3d error = filter.state()(kPosition) - truth.x.head<3>();
  const Eigen::Matrix3d P = filter.covariance().topLeftCorner<3, 3>();
  const double squared = nees(error, P).value_or(1e9);
  std::printf("position %.1f %.1f %.1f m, error %.2f m, NEES %.1f of 3\n", filter.state()(kPosition)[0],
              filter.state()(kPosition)[1], filter.state()(kPosition)[2], error.norm(), squared);
  std::printf("clock of station 3: %.2f m, truth %.2f m\n", filter.state()(clock)[0], station_clock);
  std::printf("%d of 800 pseudoranges taken, mean NIS %.3f\n", accepted, sum_nis / accepted);
  // Bounds that a consistent filter leaves once in 10 000 seeds.
  const MeanBounds bounds = mean_nees_bounds(1.0, accepted, 1e-4);
  const bool right = sum_nis / accepted > bounds.lower && sum_nis / accepted < bounds.upper && squared < 21.1;
  return right ? 0 : 1;
}
