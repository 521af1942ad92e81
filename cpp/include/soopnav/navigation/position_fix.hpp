#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "soopnav/core/static_vector.hpp"
#include "soopnav/estimation/dop.hpp"

/// The systems: a position from times of arrival.
namespace soopnav::navigation {

/// Most nodes a fix takes.
inline constexpr std::size_t kMaxNodes = 64;

/// A transmitter at a known place.
struct Node {
  Eigen::Vector3d position_m = Eigen::Vector3d::Zero();  ///< antenna in one local level frame: east, north, up [m]
  double clock_offset_s = 0.0;  ///< how much later than the common time it transmits [s]; subtracted from its arrivals
  double sigma_s = 0.0;         ///< 1-sigma of that offset and of the surveyed position, as time [s], >= 0
};

/// How many coordinates of the position are estimated.
enum class FixDimension : std::uint8_t {
  /// Three with at least four usable nodes, else two at the stated height. Two as well when a height is stated and the
  /// three are ambiguous or not determined.
  kAuto,
  kPlanar,   ///< east and north, at the stated height
  kSpatial,  ///< east, north, up
};

/// What a fix may assume. Lengths in metres in the nodes' frame.
struct PositionFixOptions {
  FixDimension dimension = FixDimension::kAuto;
  std::optional<double> height_m = std::nullopt;  ///< the receiver's third coordinate in a planar fix
  std::optional<Eigen::Vector3d> near_m =
      std::nullopt;         ///< where two positions fit equally, the one nearer to this is taken
  double period_s = 10e-3;  ///< times of arrival repeat after this (LTE radio frame); infinity: they do not
  bool reject_outliers = true;
  double false_alarm_probability = 1e-3;  ///< of each test of a fix whose nodes are all good, in (0, 0.5)
  int max_iterations = 50;                ///< of each solution, at least 1

  /// Throws std::invalid_argument naming the option, its value and the rule.
  void check() const;
};

/// How a fix ended.
enum class FixStatus : std::uint8_t {
  kConverged,      ///< one position explains the times of arrival
  kAmbiguous,      ///< `position_m` and each of `alternatives_m` explain them equally
  kInconsistent,   ///< no position explains them and the node at fault cannot be told; `position_m` fits all of them
  kTooFewNodes,    ///< fewer usable nodes than unknowns; no position
  kRankDeficient,  ///< directions of `unobservable()` are not determined: `position_m` is one of many
  kNotConverged,   ///< no minimum found; `position_m` is the best point seen
};

/// The name of a status in words.
[[nodiscard]] std::string_view to_string(FixStatus status) noexcept;

/// What a fix did with a node.
enum class NodeUse : std::uint8_t {
  kUsed,
  kRejected,   ///< its residual lies outside the gate
  kNotFinite,  ///< its time of arrival or standard deviation is NaN or infinite
  kBadSigma,   ///< its standard deviation is zero or negative
};

/// A position, what it is worth, and what became of each node. Holds its arrays itself: no heap.
///
/// Values that do not exist are NaN. The covariances follow from the stated standard deviations; they are not scaled by
/// the residuals.
struct PositionFix {
  static constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

  FixStatus status = FixStatus::kTooFewNodes;
  int dimensions = 0;      ///< 3, or 2 at a stated height
  bool fell_back = false;  ///< kAuto: the stated height was used because three dimensions were not determined
  Eigen::Vector3d position_m = Eigen::Vector3d::Constant(kNan);     ///< east, north, up in the nodes' frame
  Eigen::Matrix3d covariance_m2 = Eigen::Matrix3d::Constant(kNan);  ///< of `position_m`; zero for a stated height
  double clock_bias_s = kNan;  ///< receiver clock minus common time, modulo the period, in [-period/2, period/2)
  double clock_sigma_s = kNan;
  Dop dop;                         ///< of the nodes used, as if all were equally good
  double chi_square = kNan;        ///< sum of squared residuals of the nodes used, in their standard deviations
  int degrees_of_freedom = 0;      ///< of `chi_square`
  double chi_square_limit = kNan;  ///< what it exceeds with the false-alarm probability, of at least one degree

  // One entry for each node, in the order given.
  StaticVector<NodeUse, kMaxNodes> use;
  /// Measured minus predicted [m]: of the fit for a node used, of the others' prediction for a node rejected.
  StaticVector<double, kMaxNodes> residuals_m;
  /// What |residual| may reach; NaN for a node that no other one controls.
  StaticVector<double, kMaxNodes> gates_m;

  StaticVector<std::size_t, kMaxNodes>
      suspects;  ///< kInconsistent: nodes of which one is at fault, when they are known

  /// Columns: the other positions that fit as well, and their clock biases.
  Eigen::Matrix<double, 3, Eigen::Dynamic, 0, 3, 4> alternatives_m{3, 0};
  Eigen::Matrix<double, Eigen::Dynamic, 1, 0, 4, 1> alternative_clock_biases_s{0};

  /// Columns: orthonormal directions (east, north, up, c * clock bias) that the nodes do not determine.
  Eigen::Matrix<double, 4, Eigen::Dynamic, 0, 4, 4> unobservable_basis{4, 0};
  bool nodes_in_line =
      false;  ///< (planar) or in one plane (spatial), to 2 % of their spread: the fix has a mirror image

  /// Whether node `i` took part in the solution.
  [[nodiscard]] bool used(std::size_t i) const noexcept { return use[i] == NodeUse::kUsed; }
  [[nodiscard]] std::size_t used_count() const noexcept;
  /// The undetermined directions in words: "up", "0.80 clock bias + 0.60 east". Empty when all is determined.
  /// Allocates.
  [[nodiscard]] std::vector<std::string> unobservable() const;
  /// One sentence: what the fix is, or why there is none. Nodes are named by their index. Allocates.
  [[nodiscard]] std::string message() const;
};

/// Position and receiver clock from times of arrival at one receiver, by weighted least squares.
///
/// Model (doc/position_fix.md eq. 1): toa_i = |p - q_i| / c + clock bias + clock_offset_i, modulo `period_s`; the
/// differences between the nodes' arrivals, clock offsets removed, must lie within half a period. Each is weighted by
/// 1 / (sigmas_s[i]² + nodes[i].sigma_s²).
///
/// Starts come in closed form from the nodes (eq. 11 to 13), so none is asked for; where two positions fit, both are
/// reported. With at least two nodes more than unknowns one outlier is found and rejected at a time: the one without
/// which the others agree best, if it lies outside the gate of their prediction and the second best is 19 times less
/// likely. Among at most 20 nodes two are sought together where one does not explain the disagreement.
///
/// `nodes`, `toas_s`, `sigmas_s`: one for each node, at most `kMaxNodes`, in any order. A node whose time or standard
/// deviation is not finite, or whose standard deviation is not positive, is left out: see `PositionFix::use`.
/// Throws std::invalid_argument when the lengths differ, a node's own numbers are not finite or its sigma negative, and
/// for `options`; measured data never throws. No allocation.
[[nodiscard]] PositionFix position_fix(std::span<const Node> nodes, std::span<const double> toas_s,
                                       std::span<const double> sigmas_s, const PositionFixOptions& options = {});

/// A receiver position and clock that closed form gives for pseudoranges.
struct ClosedFormFix {
  Eigen::Vector3d position_m;
  double clock_bias_m = 0.0;
};

/// The one to three candidates that squared pseudoranges allow (doc/position_fix.md eq. 11 to 13): exact for exact data
/// and the minimum number of nodes, starts for `solve_from` otherwise.
///
/// `positions_m`: (3, n), n at least 3 (planar) or 4. `pseudoranges_m`: n. `height_m`: planar when given. Candidates
/// with a pseudorange shorter than the clock bias (a negative distance) come last. Returns how many were written to
/// `candidates`. No allocation.
[[nodiscard]] int closed_form_fixes(const Eigen::Ref<const Eigen::Matrix3Xd>& positions_m,
                                    const Eigen::Ref<const Eigen::VectorXd>& pseudoranges_m,
                                    std::optional<double> height_m, std::span<ClosedFormFix, 3> candidates) noexcept;

}  // namespace soopnav::navigation
