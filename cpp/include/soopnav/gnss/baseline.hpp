#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <string_view>
#include <utility>
#include <vector>

#include "soopnav/core/static_vector.hpp"
#include "soopnav/gnss/lambda.hpp"

namespace soopnav::gnss {

/// Most satellites of one epoch.
inline constexpr std::size_t kMaxBaselineSatellites = 48;

/// One satellite at one epoch, rover minus base, both read on the same signal.
///
/// Model (doc/attitude.md eq. 7; carter eq. 2.25), b from the base antenna to the rover's, u towards the satellite:
///     code_m                     = -u.b + c dt + noise
///     wavelength * phase_cycles  = -u.b + c dt' + wavelength * N + noise,  N an integer
/// after what the satellite's motion between the two receivers' times of transmission adds has been taken off.
struct BaselineSatellite {
  int id = 0;                                           ///< its number, the same from epoch to epoch
  Eigen::Vector3d direction = Eigen::Vector3d::Zero();  ///< unit vector u, east, north, up
  double code_m = 0.0;                                  ///< difference of the pseudoranges
  double phase_cycles = 0.0;                            ///< difference of the carrier phases, growing with range
  bool lost_lock = false;                               ///< either receiver flagged a possible cycle slip
};

/// How integers are searched when the length of the baseline is known.
enum class ConstraintSearch : std::uint8_t {
  kSphere,      ///< all directions of |b| = length, 0.13 wavelengths apart: finds the constrained optimum
  kCandidates,  ///< the best integer vectors without the length, weighed again with it: may miss it
};

/// What a baseline may assume.
struct BaselineOptions {
  double wavelength_m = 299'792'458.0 / 1'575.42e6;  ///< GPS L1, > 0
  double phase_sigma_m = 0.003;                      ///< of one receiver's carrier phase at the zenith, > 0
  double code_phase_ratio = 100.0;                   ///< code sigma over phase sigma, > 1
  double mask_rad = 0.2617993877991494;              ///< elevation below which a satellite is left out, [0, pi/2)
  double ratio = 3.0;                                ///< second-best over best objective that a fix needs, >= 1
  std::optional<double> length_m = std::nullopt;     ///< of the baseline; for the sphere at most 10 m
  ConstraintSearch search = ConstraintSearch::kSphere;
  int candidates = 100;                       ///< of kCandidates, 2 ... 10 000
  double max_pitch_rad = 1.5707963267948966;  ///< with the sphere: |pitch| is known to be at most this, (0, pi/2]
  int max_satellites = 0;                     ///< only so many, the highest ones; 0: all

  /// Throws std::invalid_argument naming the option, its value and the rule.
  void check() const;
};

/// What became of an epoch.
enum class BaselineStatus : std::uint8_t {
  kFixed,             ///< the integers passed the ratio test, and their residuals are of the size stated
  kTracked,           ///< `BaselineTracker`: the integers of earlier epochs still fit
  kFloat,             ///< they did not: `baseline_m` is that of the code
  kTooFewSatellites,  ///< fewer than four above the mask
  kDegenerate,        ///< the directions do not determine three coordinates, or numbers overflowed
};

/// A lower-case phrase: "fixed", "too few satellites", ...
[[nodiscard]] std::string_view to_string(BaselineStatus status) noexcept;

/// A baseline and what it is worth. What does not exist is NaN. Holds its arrays itself: no heap.
struct BaselineFix {
  static constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

  BaselineStatus status = BaselineStatus::kTooFewSatellites;
  Eigen::Vector3d baseline_m = Eigen::Vector3d::Constant(kNan);     ///< base to rover, east, north, up
  Eigen::Matrix3d covariance_m2 = Eigen::Matrix3d::Constant(kNan);  ///< as if the integers were certain when fixed
  double heading_rad = kNan;        ///< of the baseline, from north towards east, [0, 2 pi)
  double heading_sigma_rad = kNan;  ///< NaN for a vertical baseline
  double pitch_rad = kNan;          ///< above the horizon
  double pitch_sigma_rad = kNan;
  double ratio = kNan;                                        ///< second-best objective over the best
  Eigen::Vector3d best_m = Eigen::Vector3d::Constant(kNan);   ///< of the best integers, whatever the ratio
  Eigen::Vector3d float_m = Eigen::Vector3d::Constant(kNan);  ///< of the code alone
  double success_rate = kNan;  ///< bound for the best integers without the length, see `IntegerLeastSquares`
  /// Satellites used, the highest one, to which the others' integers refer, first.
  StaticVector<int, kMaxBaselineSatellites> ids;
  /// Integers of the best candidate in the order of `ids`, minus that of the first (so the first is 0).
  StaticVector<double, kMaxBaselineSatellites> integers;
  /// Phase minus model at `best_m` in the order of `ids`, the common clock removed [m].
  StaticVector<double, kMaxBaselineSatellites> residuals_m;
  StaticVector<int, kMaxBaselineSatellites> slips;  ///< `BaselineTracker`: satellites whose integer was lost

  [[nodiscard]] bool fixed() const noexcept {
    return status == BaselineStatus::kFixed || status == BaselineStatus::kTracked;
  }
};

/// A baseline from one epoch of code and carrier phase of one signal: double differences, integers by LAMBDA or, with a
/// known length, by a search of the sphere, then the ratio test.
///
/// Weights (eq. 8): the variance of a single difference is phase_sigma_m^2 (1 + 1 / sin^2(elevation)), that of the
/// code code_phase_ratio^2 times it. The integers' objective is that of eq. 9, with a known length the smallest that
/// any baseline of this length reaches (eq. 10 to 12); the ratio test compares the best two integer vectors by it.
/// A fix also needs the best objective to be one that right integers stay below with probability 0.999, chi-square of
/// m - 1 degrees of freedom for m satellites, m with the length. This keeps out phases that fit no integers, not all
/// phases without meaning: of random ones of 8 satellites some 3 % pass with a length of 1 m and the ratio 3, 7 %
/// with 2.
///
/// Satellites below the mask, with anything not finite, or with a code or phase above 1e12 are left out. An object
/// keeps its scratch and the grid of directions: `solve` does not allocate. Cost: 6 us without a length, 0.7 ms for a
/// sphere of 1 m, growing with its square.
class BaselineSolver {
 public:
  /// @throws std::invalid_argument for an option out of range.
  explicit BaselineSolver(const BaselineOptions& options = {});

  [[nodiscard]] const BaselineOptions& options() const noexcept { return options_; }
  /// The baseline of one epoch; at most the first `kMaxBaselineSatellites` satellites are read.
  [[nodiscard]] BaselineFix solve(std::span<const BaselineSatellite> satellites) noexcept;
  /// The baseline with the integers `known`, in the order of `satellites`, all of them used: fixed without a test;
  /// degenerate when one of them is no number.
  [[nodiscard]] BaselineFix with_integers(std::span<const BaselineSatellite> satellites,
                                          std::span<const double> known) noexcept;
  /// Whether a satellite may be used: finite, code and phase at most 1e12, a unit direction, above the mask.
  [[nodiscard]] bool usable(const BaselineSatellite& satellite) const noexcept;
  /// Variance of the carrier phase of a single difference [m^2] (eq. 8).
  [[nodiscard]] double phase_variance_m2(const BaselineSatellite& satellite) const noexcept;

 private:
  struct Epoch;
  struct Best;
  bool prepare(std::span<const BaselineSatellite> satellites, Epoch& epoch, BaselineFix& fix) const noexcept;
  static bool inform(Epoch& epoch, double code_phase_ratio, BaselineFix& fix) noexcept;
  bool float_integers(const Epoch& epoch, BaselineFix& fix) noexcept;
  void search_candidates(const Epoch& epoch, Best& best) noexcept;
  void search_sphere(const Epoch& epoch, Best& best) noexcept;
  void bound_block(const Epoch& epoch, std::size_t first, std::size_t count) noexcept;
  void finish(const Epoch& epoch, const Best& best, BaselineFix& fix) const noexcept;

  BaselineOptions options_;
  IntegerLeastSquares ils_;
  double lowest_;                                                       // sine of the mask
  std::array<double, kMaxBaselineSatellites + 1> highest_objective_{};  // of a fix, by degrees of freedom
  std::vector<double> grid_;                                            // x..., y..., z... of the points of the sphere
  std::vector<std::pair<double, std::uint32_t>> order_;                 // their bounds and numbers, as a heap
};

/// Carries the integers from epoch to epoch, as an attitude filter wants it: they are solved once, kept while the phase
/// agrees with them, and repaired or solved again after a cycle slip.
///
/// A satellite loses its integer when it is flagged (`lost_lock`), is not seen, or when without it the others agree and
/// with it they do not: squared residuals over variance per degree of freedom above 5 + 20 / dof, where right integers
/// give 1 and a lost cycle hundreds. All are given up when no single satellite explains it. New integers come from
/// rounding about the baseline of the others when the fraction is below 0.2 cycles. `BaselineFix::slips` names the
/// satellites that lost theirs without setting. Does not allocate after construction.
class BaselineTracker {
 public:
  /// @throws std::invalid_argument for an option out of range.
  explicit BaselineTracker(const BaselineOptions& options = {}) : solver_(options) {}

  [[nodiscard]] BaselineFix step(std::span<const BaselineSatellite> satellites) noexcept;
  /// Forgets all integers.
  void reset() noexcept { known_.clear(); }
  /// Satellites whose integers are known.
  [[nodiscard]] std::size_t tracked() const noexcept { return known_.size(); }

 private:
  struct Known {
    int id = 0;
    double integer = 0.0;  // up to a constant common to all
  };
  struct Satellites;

  [[nodiscard]] const Known* find(int id) const noexcept;
  void forget(int id) noexcept;
  [[nodiscard]] double misfit(const Satellites& satellites, const BaselineFix& fix) const noexcept;
  [[nodiscard]] BaselineFix track(const Satellites& satellites) noexcept;
  [[nodiscard]] bool drop_slipped(Satellites& satellites, BaselineFix& fix) noexcept;
  void add(std::span<const BaselineSatellite> satellites, const BaselineFix& fix) noexcept;

  BaselineSolver solver_;
  StaticVector<Known, kMaxBaselineSatellites> known_;
};

}  // namespace soopnav::gnss
