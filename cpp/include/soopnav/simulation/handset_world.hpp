#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <vector>

/// A walk indoors as a handset sees it (nielsen 4.2.3), on the level of its measurements: ranges to radio nodes
/// outside, some of them with excess delay, and the camera's steps. For Monte-Carlo runs; doc/handset.md section 6.
namespace soopnav::simulation {

/// When which link has no line of sight, and how late it is then.
struct NlosOptions {
  int links = 6;                    ///< 1 ... 64
  int max_blocked = 2;              ///< links without line of sight at a time, 0 ... links
  double min_clear_share = 0.4;     ///< of the time that each link has line of sight, in [0, 1]
  double mean_los_s = 10.0;         ///< of the Markov chain where the guards do not intervene, > 0
  double mean_nlos_s = 5.0;         ///< > 0
  double excess_min_m = 4.0;        ///< excess delay begins uniformly between these, and is reflected at them
  double excess_max_m = 20.0;       ///< > excess_min_m >= 0
  double excess_walk_m2ps = 0.025;  ///< its wander: 0.05 m per sample at 10 Hz
  int attempts = 200;               ///< schedules drawn until one keeps `min_clear_share`, >= 1

  /// Throws std::invalid_argument naming the option, its value and the rule.
  void check() const;
};

struct NlosSchedule {
  std::size_t epochs = 0;
  int links = 0;
  std::vector<std::uint8_t> blocked;  ///< epochs x links: 1 without line of sight
  std::vector<double> excess_m;       ///< epochs x links, zero with line of sight
  int attempts = 0;                   ///< schedules drawn
  bool guarded = false;               ///< false: none of `attempts` kept `min_clear_share`; this one is the nearest
  double clear_share = 0.0;           ///< of the link that is worst off

  /// Two-state Markov chains, one for each link, started in their stationary distribution. A link that would be one too
  /// many stays clear (so `max_blocked` holds always); a schedule in which a link is clear for less than
  /// `min_clear_share` is drawn again. Same seed, same bits. Throws std::invalid_argument for the options, no epochs,
  /// or a step that is not positive.
  [[nodiscard]] static NlosSchedule generate(const NlosOptions& options, std::size_t epochs, double step_s,
                                             std::uint64_t seed);
};

struct HandsetWorldOptions {
  NlosOptions nlos;                      ///< its `links` are the nodes
  double duration_s = 60.0;              ///< > 0, at most 10 000
  double room_m = 20.0;                  ///< side of the square that is walked in, > 6; its centre is the origin
  double min_node_m = 25.0;              ///< distance of the nodes from the origin, > 0
  double max_node_m = 60.0;              ///< >= min_node_m
  double min_speed_mps = 0.4;            ///< >= 0
  double max_speed_mps = 1.0;            ///< >= min_speed_mps
  double range_rate_hz = 10.0;           ///< > 0, at most 100
  double range_sigma_m = 1.0;            ///< >= 0
  double clock_walk_m2ps = 0.04;         ///< 0.2 m/sqrt(s)
  double clock_sigma_m = 50.0;           ///< of its start
  double frame_rate_hz = 20.0;           ///< > 0, at most 100
  double step_sigma_m = 0.2e-3;          ///< error of each increment along each axis, >= 0
  double turn_sigma_rad = 3.4906585e-4;  ///< heading's drift at each frame: 0.02 degrees
  double foot_sigma_m = 0.0;             ///< of a frame's foot point along each axis: the plane fit's (eq. 4), >= 0
  double heading_error_rad = 0.17453292519943295;  ///< the heading said at the start is off by at most this, uniformly
  double epoch_offset_s = 0.02;                    ///< radio epochs after frames, >= 0

  void check() const;
};

/// One walk. Times in seconds from its start; headings as navigation::HandsetLocator has them.
struct HandsetWorld {
  std::vector<Eigen::Vector3d> nodes_m;
  double told_heading_rad = 0.0;

  std::vector<double> frame_s;             ///< n frames, the first at zero
  std::vector<Eigen::Vector3d> pose;       ///< x, y, a_z at each
  std::vector<Eigen::Vector3d> increment;  ///< n - 1, in the axes of the previous body
  std::vector<double> walked_m;            ///< length of the way up to each frame

  std::vector<double> epoch_s;              ///< m radio epochs
  std::vector<Eigen::Vector2d> position_m;  ///< at each
  std::vector<double> range_m;              ///< m x links
  std::vector<double> clock_m;              ///< m
  NlosSchedule nlos;

  /// Walks between random points of the room, turning at no more than 0.8 rad/s, the speed swinging between its limits;
  /// the handset looks along the way and sways by 20 degrees. Nodes stand all round, each within a third of its sector.
  /// Same seed, same bits. Throws std::invalid_argument for the options.
  [[nodiscard]] static HandsetWorld generate(const HandsetWorldOptions& options, std::uint64_t seed);
};

}  // namespace soopnav::simulation
