#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstdint>
#include <limits>
#include <sstream>
#include <stdexcept>
#include <string_view>

namespace soopnav::inertial {

/// What a sample of an inertial measurement unit is worth.
enum class ImuStatus : std::uint8_t {
  kOk,         ///< one period after the last
  kFirst,      ///< the first: nothing to integrate from
  kGap,        ///< good, but samples are missing before it
  kDuplicate,  ///< as old as the last one: to be left out
  kReversed,   ///< older than the last one: to be left out
  kSaturated,  ///< a rate or a force at the end of its range: its time has passed, its motion is unknown
  kNonFinite,  ///< NaN or infinity in it: its time has passed, its motion is unknown (unless its time is not finite)
  kFarAhead,   ///< later than anything missing explains, so its time is wrong: to be left out
};

/// A lower-case phrase for reports: "ok", "gap", ...; "unknown" for a value that is no enumerator.
[[nodiscard]] constexpr std::string_view to_string(ImuStatus status) noexcept {
  constexpr std::string_view kNames[] = {"ok",       "first",     "gap",        "duplicate",
                                         "reversed", "saturated", "not finite", "far ahead"};
  const auto i = static_cast<std::size_t>(status);
  return i < std::size(kNames) ? kNames[i] : "unknown";
}

/// What an `ImuGuard` holds samples against.
struct ImuLimits {
  double period_s = 0.01;           ///< time between samples
  double gap_periods = 1.5;         ///< more than so many periods after the last: samples are missing
  double max_gap_s = 600.0;         ///< more than this after the last: its time is wrong
  double duplicate_periods = 0.01;  ///< nearer to the last than this: the same sample again
  double gyro_range_radps = std::numeric_limits<double>::infinity();          ///< saturated at or above, any axis
  double accelerometer_range_mps2 = std::numeric_limits<double>::infinity();  ///< saturated at or above, any axis

  /// Throws std::invalid_argument naming the parameter, its value and the rule.
  void check() const {
    const auto require = [](bool holds, const char* name, double value, const char* rule) {
      if (holds) return;
      std::ostringstream text;
      text << name << ": " << value << "; " << rule;
      throw std::invalid_argument(text.str());
    };
    require(period_s > 0.0 && std::isfinite(period_s), "period_s", period_s, "it must be positive and finite");
    require(gap_periods > 1.0, "gap_periods", gap_periods, "it must be above 1");
    require(max_gap_s > 0.0, "max_gap_s", max_gap_s, "it must be positive");
    require(duplicate_periods >= 0.0 && duplicate_periods < 1.0, "duplicate_periods", duplicate_periods,
            "it must lie in [0, 1)");
    require(gyro_range_radps > 0.0, "gyro_range_radps", gyro_range_radps, "it must be positive");
    require(accelerometer_range_mps2 > 0.0, "accelerometer_range_mps2", accelerometer_range_mps2,
            "it must be positive");
  }
};

/// Says of each sample what it is worth, by its time stamp and its numbers; for a planar unit (one gyro, two
/// accelerometers) as for a full one. Nothing allocates or throws behind the constructor.
class ImuGuard {
 public:
  struct Verdict {
    ImuStatus status = ImuStatus::kFirst;
    double missing_s = 0.0;  ///< before the sample's own period: nobody knows what happened in it
    double step_s = 0.0;     ///< that the sample speaks for; 0 where it is left out
    /// The sample's numbers may be integrated over `step_s`.
    [[nodiscard]] bool usable() const noexcept { return status == ImuStatus::kOk || status == ImuStatus::kGap; }
  };

  /// Throws std::invalid_argument for limits that make no sense.
  explicit ImuGuard(const ImuLimits& limits) : limits_(limits) { limits_.check(); }

  [[nodiscard]] const ImuLimits& limits() const noexcept { return limits_; }
  /// Time of the last sample that was not left out; NaN before the first.
  [[nodiscard]] double last_s() const noexcept { return last_s_; }
  /// Begins at `t_s`: the next sample is no first one.
  void start(double t_s) noexcept { last_s_ = t_s; }

  /// Judges the sample at the end of its period, and remembers its time. Rates [rad/s] and forces [m/s²], any size.
  template <class Gyro, class Accelerometer>
  [[nodiscard]] Verdict judge(double t_s, const Eigen::MatrixBase<Gyro>& gyro_radps,
                              const Eigen::MatrixBase<Accelerometer>& accelerometer_mps2) noexcept {
    Verdict verdict;
    if (!std::isfinite(t_s)) {
      verdict.status = ImuStatus::kNonFinite;
      return verdict;
    }
    const bool first = std::isnan(last_s_);
    const double step = first ? limits_.period_s : t_s - last_s_;
    if (!first) {
      const double same = limits_.duplicate_periods * limits_.period_s;
      if (step <= same) {
        verdict.status = step < -same ? ImuStatus::kReversed : ImuStatus::kDuplicate;
        return verdict;
      }
      if (step > limits_.max_gap_s) {
        verdict.status = ImuStatus::kFarAhead;
        return verdict;
      }
    }
    last_s_ = t_s;
    const bool gap = step > limits_.gap_periods * limits_.period_s;
    verdict.step_s = first ? 0.0 : gap ? limits_.period_s : step;
    verdict.missing_s = gap ? step - limits_.period_s : 0.0;
    verdict.status = first ? ImuStatus::kFirst : gap ? ImuStatus::kGap : ImuStatus::kOk;
    if (!gyro_radps.allFinite() || !accelerometer_mps2.allFinite()) {
      verdict.status = ImuStatus::kNonFinite;
    } else if (!(gyro_radps.cwiseAbs().maxCoeff() < kFull * limits_.gyro_range_radps) ||
               !(accelerometer_mps2.cwiseAbs().maxCoeff() < kFull * limits_.accelerometer_range_mps2)) {
      verdict.status = ImuStatus::kSaturated;
    }
    return verdict;
  }

 private:
  static constexpr double kFull = 1.0 - 1e-6;  // an increment over its time is rounded
  ImuLimits limits_;
  double last_s_ = std::numeric_limits<double>::quiet_NaN();
};

}  // namespace soopnav::inertial
