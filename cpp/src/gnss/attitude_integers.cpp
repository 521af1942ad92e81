#include <algorithm>
#include <array>
#include <cmath>

#include "attitude_information.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/gnss/attitude.hpp"

namespace soopnav::gnss {

namespace {

constexpr double kGridStep = 0.15;          // of the searches, wavelengths
constexpr double kMaxAcquiredCycles = 3.0;  // longest baseline that is searched
constexpr std::size_t kDirections = 48;     // directions of the first baseline that are followed
constexpr std::size_t kTurns = 3;           // turns about each of them that are refined
constexpr double kGoldenAngle = 2.399963229728653;

struct Scored {
  double cost = std::numeric_limits<double>::infinity();
  Eigen::Quaterniond q = Eigen::Quaterniond::Identity();
};

// Keeps the best, ascending.
template <std::size_t N>
void keep(std::array<Scored, N>& list, const Scored& item) noexcept {
  if (!(item.cost < list.back().cost)) return;
  std::size_t i = N - 1;
  for (; i > 0 && list[i - 1].cost > item.cost; --i) list[i] = list[i - 1];
  list[i] = item;
}

// The shortest turn from one unit vector to another; about any axis across when they are opposite. (Eigen's own way
// brings in a singular value decomposition, which takes longer to compile than all of this.)
Eigen::Quaterniond turn_between(const Eigen::Vector3d& from, const Eigen::Vector3d& to) noexcept {
  Eigen::Vector3d axis = from.cross(to);
  const double sine = axis.norm(), cosine = from.dot(to);
  if (sine < 1e-12) {
    if (cosine > 0.0) return Eigen::Quaterniond::Identity();
    Eigen::Index least = 0;
    from.cwiseAbs().minCoeff(&least);
    axis = from.cross(Eigen::Vector3d::Unit(least)).normalized();
    return geometry::quaternion_from_rotation_vector(kPi * axis);
  }
  return geometry::quaternion_from_rotation_vector(axis * (std::atan2(sine, cosine) / sine));
}

// Squared distance of the wrapped phases from whole cycles at an attitude, over baselines [first, last) [cycles^2].
double misfit(const AttitudeModel& model, const Eigen::Matrix3d& T_n_b, std::span<const Eigen::Vector3d> directions,
              const PathDifferences& wrapped, double wavelength_m, std::size_t first, std::size_t last) noexcept {
  double cost = 0.0;
  for (std::size_t k = first; k < last; ++k) {
    const Eigen::Vector3d w = T_n_b * model.baselines_m[k] / wavelength_m;
    for (Eigen::Index s = 0; s < wrapped.cols(); ++s) {
      const Eigen::Vector3d& u = directions[static_cast<std::size_t>(s)];
      const double cycles = wrapped(static_cast<Eigen::Index>(k), s) + w.dot(u);
      if (!std::isfinite(cycles) || !detail::is_direction(u)) continue;
      const double fraction = cycles - std::nearbyint(cycles);
      cost += fraction * fraction;
    }
  }
  return cost;
}

}  // namespace

double resolve_cycles(const AttitudeModel& model, const Eigen::Quaterniond& q_n_b,
                      std::span<const Eigen::Vector3d> directions, const PathDifferences& wrapped_cycles,
                      double wavelength_m, Eigen::Ref<PathMatrix, 0, Eigen::OuterStride<>> path) noexcept {
  path.setConstant(AttitudeFix::kNan);
  const Eigen::Matrix3d T = q_n_b.toRotationMatrix();
  const auto rows = std::min({static_cast<Eigen::Index>(model.baselines_m.size()), wrapped_cycles.rows(), path.rows()});
  const auto columns = std::min({static_cast<Eigen::Index>(directions.size()), wrapped_cycles.cols(), path.cols()});
  double farthest = AttitudeFix::kNan;
  for (Eigen::Index i = 0; i < rows; ++i) {
    const Eigen::Vector3d w = T * model.baselines_m[static_cast<std::size_t>(i)] / wavelength_m;
    const auto off = [&](Eigen::Index s) {
      const Eigen::Vector3d& u = directions[static_cast<std::size_t>(s)];
      return detail::is_direction(u) ? wrapped_cycles(i, s) + w.dot(u) : AttitudeFix::kNan;
    };
    double clock = 0.0;
    if (!model.common_clock) {
      double c = 0.0, sn = 0.0;
      for (Eigen::Index s = 0; s < columns; ++s) {
        const double cycles = off(s);
        if (!std::isfinite(cycles)) continue;
        c += std::cos(kTwoPi * cycles);
        sn += std::sin(kTwoPi * cycles);
      }
      clock = std::atan2(sn, c) / kTwoPi;
    }
    for (Eigen::Index s = 0; s < columns; ++s) {
      const double cycles = off(s) - clock;
      if (!std::isfinite(cycles)) continue;
      const double whole = std::round(cycles);
      path(i, s) = -wavelength_m * (wrapped_cycles(i, s) - whole);
      const double distance = std::abs(cycles - whole);
      if (!(distance <= farthest)) farthest = distance;
    }
  }
  return farthest;
}

AttitudeFix acquire_attitude(const AttitudeModel& model, std::span<const Eigen::Vector3d> directions,
                             const PathDifferences& wrapped_cycles, double wavelength_m, double min_ratio) noexcept {
  AttitudeFix none;
  const auto rows = std::min(static_cast<Eigen::Index>(model.baselines_m.size()), wrapped_cycles.rows());
  const auto columns = std::min({static_cast<Eigen::Index>(directions.size()), wrapped_cycles.cols(),
                                 static_cast<Eigen::Index>(kMaxAttitudeSatellites)});
  none.status = AttitudeStatus::kUnobservable;
  if (rows < 2 || !model.common_clock || !(wavelength_m > 0.0)) return none;
  const Eigen::Vector3d first = model.baselines_m[0];
  double arm = 0.0;  // farthest antenna from the line of the first baseline
  for (const Eigen::Vector3d& b : model.baselines_m) {
    if (b.norm() > kMaxAcquiredCycles * wavelength_m) return none;
    arm = std::max(arm, first.normalized().cross(b).norm());
  }
  if (!(arm > 1e-3 * first.norm())) {
    none.unobservable_b = first.normalized();
    return none;
  }
  const auto wrapped = wrapped_cycles.topLeftCorner(rows, columns);
  const double step = std::min(0.5, kGridStep * wavelength_m / first.norm());
  const auto points = static_cast<int>(std::ceil(4.0 * kPi / (step * step)));
  std::array<Scored, kDirections> followed;
  for (int i = 0; i < points; ++i) {
    const double up = 1.0 - (2.0 * i + 1.0) / points;
    const double level = std::sqrt(std::max(0.0, 1.0 - up * up));
    const Eigen::Vector3d to(level * std::cos(kGoldenAngle * i), level * std::sin(kGoldenAngle * i), up);
    const Eigen::Quaterniond q = turn_between(first.normalized(), to);
    keep(followed, {misfit(model, q.toRotationMatrix(), directions, wrapped, wavelength_m, 0, 1), q});
  }
  const auto turns = static_cast<int>(std::ceil(kTwoPi / std::min(0.5, kGridStep * wavelength_m / arm)));
  std::array<AttitudeFix, 2> best;
  std::array<double, kMaxAttitudeBaselines * kMaxAttitudeSatellites> storage{};
  Eigen::Map<PathMatrix> path(storage.data(), rows, columns);
  for (const Scored& direction : followed) {
    if (!std::isfinite(direction.cost)) continue;
    std::array<Scored, kTurns> turned;
    for (int i = 0; i < turns; ++i) {
      const Eigen::Quaterniond q =
          direction.q * geometry::quaternion_from_rotation_vector(kTwoPi * i / turns * first.normalized());
      keep(turned,
           {misfit(model, q.toRotationMatrix(), directions, wrapped, wavelength_m, 1, static_cast<std::size_t>(rows)),
            q});
    }
    for (const Scored& start : turned) {
      if (!std::isfinite(start.cost)) continue;
      static_cast<void>(resolve_cycles(model, start.q, directions, wrapped, wavelength_m, path));
      const AttitudeFix fix = attitude_fix(model, directions, path, start.q);
      if (fix.status == AttitudeStatus::kTooFewSatellites) return fix;
      if (!fix.solved()) continue;
      const auto same = [&](const AttitudeFix& other) {
        return other.solved() && fix.q_n_b.angularDistance(other.q_n_b) < 0.5 * step &&
               std::abs(fix.chi_square - other.chi_square) <= 1e-6 * (1.0 + fix.chi_square);
      };
      if (same(best[0]) || same(best[1])) continue;
      if (!best[0].solved() || fix.chi_square < best[0].chi_square) {
        best[1] = best[0];
        best[0] = fix;
      } else if (!best[1].solved() || fix.chi_square < best[1].chi_square) {
        best[1] = fix;
      }
    }
  }
  if (!best[0].solved()) {
    none.status = AttitudeStatus::kNotConverged;
    return none;
  }
  best[0].ratio = best[1].solved() ? best[1].chi_square / best[0].chi_square : std::numeric_limits<double>::infinity();
  if (!(best[0].ratio >= min_ratio)) best[0].status = AttitudeStatus::kAmbiguous;
  return best[0];
}

}  // namespace soopnav::gnss
