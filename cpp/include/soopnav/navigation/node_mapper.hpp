#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

namespace soopnav::navigation {

/// How the receiver's clock goes from epoch to epoch.
enum class ClockMotion : std::uint8_t {
  kRandomWalk,  ///< by `clock_m_per_sqrt_s`
  kFree,        ///< anywhere at each epoch: three nodes are needed
};

struct NodeMapperOptions {
  ClockMotion clock = ClockMotion::kRandomWalk;
  double clock_m_per_sqrt_s = 0.2;      ///< of the receiver's clock against the nodes', as length
  double track_m_per_sqrt_s = 0.0;      ///< random walk of the track's position error, each axis
  double heading_rad_per_sqrt_s = 0.0;  ///< random walk of its heading error
  double max_distance_m = 150.0;        ///< of a node from the walk's middle: where starts are looked for
  int starts = 16;                      ///< at most; fewer when the fit is as good as the noise
  int max_iterations = 200;
  double ambiguity_cost = 13.8;  ///< another solution counts if its cost is less above the best (odds 1 : 1000)
  std::uint64_t seed = 0;
};

enum class NodeMapStatus : std::uint8_t {
  kOk,
  kTooFew,        ///< fewer ranges than unknowns; no positions
  kUndetermined,  ///< the information is singular: `undetermined` directions; positions without meaning in those
  kNotConverged,  ///< iterations ran out
  kPoorFit,       ///< residuals beyond the noise (probability below 1e-6): NLOS, or a wrong sigma or drift
};

/// Nodes found from a walk. Frame: the walk's own: its first place and its first heading are the measured track's.
struct NodeMap {
  NodeMapStatus status = NodeMapStatus::kTooFew;
  std::vector<Eigen::Vector2d> position_m;  ///< of L nodes; NaN where a node was not heard
  Eigen::MatrixXd covariance_m2;            ///< 2 L x 2 L, of all positions
  std::vector<double> offset_m;             ///< of each node's time as length, against the first node that is heard
  std::vector<double> offset_sigma_m;
  std::vector<bool> mirrored;             ///< the node may as well be at `mirror_m`: the walk does not tell its side
  std::vector<Eigen::Vector2d> mirror_m;  ///< NaN unless `mirrored`
  std::vector<double> clock_m;            ///< receiver's at each epoch, against the first node's
  std::vector<Eigen::Vector2d> track_m;   ///< corrected
  std::vector<double> heading_rad;        ///< by which the track's axes have turned since its start
  double cost = 0.0;                      ///< sum of squared residuals over their sigmas
  int degrees_of_freedom = 0;
  int observations = 0;
  int undetermined = 0;  ///< directions that the ranges say nothing of, the common time not counted
  int iterations = 0;    ///< of the start that won
  int starts = 0;        ///< tried
};

/// Finds nodes that are at unknown places, each with a time of its own, from ranges along a walk (nielsen section 4;
/// doc/node_mapping.md).
///
/// Model:  z_kl = |p_k - q_l| + b_k + o_l + n,   p_{k+1} = p_k + R(psi_k) dm_k + w_p,   psi_{k+1} = psi_k + w_psi
///         m_k the measured track (odometry), so its drift is estimated too; b_k free or a random walk.
/// Batch least squares (Levenberg-Marquardt): the chain of p, psi, b is eliminated epoch by epoch, so that a solve
/// costs n (3 L)^2. Starts come from a polar grid for each node, with the clock from the other nodes, and from random
/// ones.
///
/// What no walk can tell: one time common to clock and nodes (o of the first node is set to 0) and where the walk's
/// frame lies in the world. What a straight walk cannot tell: each node's side (`mirrored`).
/// `track_m`: n x 2, or n x 3 with `heights_m` of the nodes: heights are known, not estimated. `range_m`: n x L, row by
/// row, NaN: not heard. `sigma_m`: one, or n x L. Allocates.
/// @throws std::invalid_argument naming the argument: sizes that do not fit, times that do not rise, a track that is
/// not finite, sigma not positive, fewer than 3 epochs.
class NodeMapper {
 public:
  explicit NodeMapper(const NodeMapperOptions& options);
  [[nodiscard]] const NodeMapperOptions& options() const noexcept { return options_; }

  [[nodiscard]] NodeMap locate(std::span<const double> t_s, std::span<const Eigen::Vector3d> track_m,
                               std::span<const double> range_m, std::span<const double> sigma_m,
                               std::span<const double> heights_m) const;

 private:
  NodeMapperOptions options_;
};

/// One node from a walk that is taken as exact, with a constant offset: what a filter starts a new node from.
struct NodeStart {
  bool ok = false;  ///< at least 4 ranges, a solution within the distance
  Eigen::Vector2d position_m = Eigen::Vector2d::Zero();
  /// The best solution on the walk's other side; NaN when there is none.
  Eigen::Vector2d mirror_m = Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());
  double offset_m = 0.0;  ///< of the range: node's time and clock together
  double mirror_offset_m = 0.0;
  double cost = 0.0;                                             ///< sum of squares over sigma^2
  double mirror_cost = std::numeric_limits<double>::infinity();  ///< close to `cost`: the side is not known
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();          ///< of position and offset
};

/// Best start of one node: polar grid about the walk's middle, offset in closed form, then Gauss-Newton, on either side
/// of the walk. `range_m`: one for each place, NaN: not heard; `height_m` of the node over the places. Cost: some
/// 600 cells x the ranges, of which at most 64 are used for the grid. Allocates nothing.
[[nodiscard]] NodeStart start_node(std::span<const Eigen::Vector2d> place_m, std::span<const double> range_m,
                                   double sigma_m, double max_distance_m, double height_m = 0.0) noexcept;

}  // namespace soopnav::navigation
