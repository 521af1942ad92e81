#pragma once

#include <Eigen/Core>
#include <array>
#include <complex>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "soopnav/core/random.hpp"
#include "soopnav/simulation/channel.hpp"

namespace soopnav::simulation {

/// What a wall is made of: relative permittivity a and conductivity c f^d (f in GHz) of ITU-R P.2040-2, table 3.
enum class Material : std::uint8_t { kConcrete, kBrick, kPlaster, kWood, kGlass, kMetal };

/// A plane wave at a slab of one material, E parallel to the slab and across the plane of incidence ("perpendicular"),
/// or in the plane of incidence ("parallel").
struct SlabResponse {
  std::complex<double> reflection;    ///< against the wave at the slab's face
  std::complex<double> transmission;  ///< against the wave that would be there without the slab
  double delay_s = 0.0;               ///< by which the slab's phase velocity holds up what passes, >= 0
};

/// Reflection and transmission of a slab in air (ITU-R P.2040-2, single layer): all echoes inside the slab are summed.
///
///     q = 2 pi thickness / lambda sqrt(eta - sin^2 t),   r of a single face,
///     R = r (1 - e^-2jq) / (1 - r^2 e^-2jq),   T = (1 - r^2) e^-jq / (1 - r^2 e^-2jq) e^{jk thickness cos t}
///
/// `cos_incidence` in (0, 1] is that of the angle from the slab's normal; `parallel` names the polarisation.
/// @throws std::invalid_argument unless the frequency and thickness are positive and the cosine is in (0, 1].
[[nodiscard]] SlabResponse slab_response(Material material, double thickness_m, double cos_incidence,
                                         double frequency_hz, bool parallel = false);

/// A vertical wall on a straight line of the floor plan, from the floor to the room's height.
struct Wall {
  Eigen::Vector2d from_m = Eigen::Vector2d::Zero();
  Eigen::Vector2d to_m = Eigen::Vector2d::Zero();
  Material material = Material::kConcrete;
  double thickness_m = 0.2;
};

/// The four walls of a rectangle with a corner at (0, 0): south, east, north, west. Allocates.
[[nodiscard]] std::vector<Wall> rectangle_walls(double width_m, double depth_m, Material material = Material::kConcrete,
                                                double thickness_m = 0.2);

/// `wall` with a piece of another material between `start_m` and `stop_m`, counted along it: two or three walls.
/// @throws std::invalid_argument unless 0 <= start < stop <= the wall's length.
[[nodiscard]] std::vector<Wall> with_opening(const Wall& wall, double start_m, double stop_m,
                                             Material material = Material::kGlass, double thickness_m = 0.006);

struct IndoorRoomOptions {
  double carrier_hz = 2.0e9;
  int order = 2;                  ///< reflections on a path, 0 ... 3
  double height_m = 3.0;          ///< of walls and ceiling above the floor z = 0; what lies above passes over
  bool floor_and_ceiling = true;  ///< reflect, once per path, where the bounce lies inside the walls' bounding box
  Material floor_material = Material::kConcrete;
  double floor_thickness_m = 0.3;
  double path_range_db = 40.0;    ///< weaker paths than the strongest by more than this are left out
  double detect_range_db = 20.0;  ///< the first detectable path is at most this much weaker than the strongest
  double los_loss_db = 3.0;       ///< line of sight: walls take no more than this from the direct path
  double tail_db = -10.0;         ///< mean power of the diffuse tail over that of the paths; -inf: no tail
  double tail_decay_s = 30e-9;    ///< its power falls by e in this time
  double tail_spacing_s = 10e-9;  ///< mean time from tap to tap
  int tail_taps = 16;             ///< 0 ... 64
  std::uint64_t seed = 0;         ///< of the tail
};

/// How a link came out. Codes of arrays in Python.
enum class LinkStatus : std::uint8_t {
  kOk,
  kNotFinite,  ///< the place has a NaN or an infinity; no taps
  kTooClose,   ///< the place is nearer to the node than 0.1 m; no taps
  kDark,       ///< no path is stronger than free space less 120 dB: shielded; no taps
};

/// What one place hears of one node. Lengths are geometric; nothing here knows a clock.
struct IndoorLink {
  LinkStatus status = LinkStatus::kNotFinite;
  bool line_of_sight = false;   ///< walls take at most `los_loss_db` from the direct path
  double distance_m = 0.0;      ///< straight
  double wall_loss_db = 0.0;    ///< of the direct path, through walls; infinite through metal
  double power_db = 0.0;        ///< sum of |gain|^2 over the taps, against what is sent: minus the path loss
  double excess_delay_s = 0.0;  ///< of the first detectable path over the straight line in free space, >= 0
  int paths = 0;                ///< of the taps, those that are reflected or direct; the rest are the tail
  std::vector<Tap> taps;        ///< sorted by delay; gain = amplitude at the carrier, e^{-j 2 pi f delay} included
};

/// A transmitter made ready: its mirror images in the walls and the waves of its diffuse tail.
class RoomNode {
 public:
  [[nodiscard]] const Eigen::Vector3d& position_m() const noexcept { return position_m_; }
  /// Mirror images kept, the node itself included.
  [[nodiscard]] std::size_t images() const noexcept { return images_.size(); }

 private:
  friend class IndoorRoom;
  struct Image {
    double x = 0.0, y = 0.0;
    int wall = -1;    // last mirror
    int parent = -1;  // image it was made of
  };
  static constexpr std::size_t kWaves = 16;
  struct TailTap {
    double delay_s = 0.0;  // after the first path
    double power = 0.0;    // share of the tail's
    std::array<double, kWaves> kx{}, ky{}, phase{};
  };
  Eigen::Vector3d position_m_ = Eigen::Vector3d::Zero();
  std::vector<Image> images_;
  std::vector<TailTap> tail_;
};

/// Propagation in and into a room by the image method (doc/indoor_propagation.md).
///
/// Model:  h = sum of paths  lambda / (4 pi s) prod R prod T e^{-j 2 pi f s / c}  +  diffuse tail
///         A path is reflected by up to `order` walls (mirror images; reflection of a slab, E vertical), perhaps once
///         by floor or ceiling, and passes through the walls that it meets, each with the slab's transmission and
///         delay. No diffraction and no scattering from furniture: the tail stands for those. Its taps are sums of 16
///         plane waves, so each is a complex normal field over the places with the correlation J0(2 pi d / lambda):
///         places within a tenth of a wavelength hear nearly the same, and 0.38 wavelengths apart independent ones.
/// Frames: floor plan x, y; z up from the floor [m]. Nodes may be outside: 25-60 m off, through the walls.
///
/// The same seed, node and place give the same bits, whatever was asked before.
class IndoorRoom {
 public:
  /// @throws std::invalid_argument naming what is out of range: walls of no length, thickness or coordinates not
  /// finite, order beyond 0 ... 3, more than 64 walls, ranges not positive.
  IndoorRoom(std::vector<Wall> walls, const IndoorRoomOptions& options);

  [[nodiscard]] const std::vector<Wall>& walls() const noexcept { return walls_; }
  [[nodiscard]] const IndoorRoomOptions& options() const noexcept { return options_; }

  /// Mirrors the node. Allocates.
  /// @throws std::invalid_argument unless the position is finite.
  [[nodiscard]] RoomNode node(const Eigen::Vector3d& position_m) const;

  /// A link whose vectors will never grow with nodes of this room. Allocates.
  [[nodiscard]] IndoorLink make_link() const;

  /// The channel from a node to a place. Nothing throws; a bad place is said in the status and leaves no taps.
  /// Allocates nothing with a `link` of `make_link`. Cost: some 50 ns per image, 0.3 us per tap of the tail.
  void link(const RoomNode& node, const Eigen::Vector3d& place_m, IndoorLink& link) const;

  /// What walls take from the straight path [dB], 0 with none between. NaN for places not finite. Allocates nothing.
  [[nodiscard]] double wall_loss_db(const Eigen::Vector3d& a_m, const Eigen::Vector3d& b_m) const;

 private:
  static constexpr std::size_t kSlabAngles = 129;
  struct Plane {
    double x = 0.0, y = 0.0, dx = 0.0, dy = 0.0;  // start, unit direction
    double length = 0.0;
    int line = 0;                                // walls on one straight line share it
    std::array<SlabResponse, kSlabAngles> slab;  // over cos incidence 0 ... 1
  };
  struct Leg;
  struct Profile;
  void through(const Leg& leg, const Profile& profile, std::complex<double>& gain, double& delay_s) const noexcept;
  bool path(const RoomNode& node, std::size_t image, const Eigen::Vector3d& place_m, int vertical,
            Tap& tap) const noexcept;

  std::vector<Wall> walls_;
  IndoorRoomOptions options_;
  std::vector<Plane> planes_;
  std::array<SlabResponse, kSlabAngles> floor_{};
  double box_[4] = {0.0, 0.0, 0.0, 0.0};  // x low, x high, y low, y high
  double lambda_m_ = 0.0;
};

/// How a link's range is too long while its line of sight is shut: what a whole system sees of `IndoorRoom`'s excess
/// delay when it moves through a building, without the building.
struct ExcessDelayOptions {
  double low_m = 4.0;  ///< bias at the moment the sight shuts, uniform between low and high
  double high_m = 20.0;
  double wander_m_per_sqrt_s = 0.158;  ///< then a random walk; 0.05 m per 0.1 s sample
  double floor_m = 0.0;                ///< reflected here: an excess is never less
};

/// Fills `excess_m` (n x links, row by row) for the flags `line_of_sight` (the same shape): 0 where in sight, else a
/// bias drawn at the moment the sight shut plus its wander. Link l draws from `random.substream(l)`, 2 numbers per
/// epoch, so that neither other links nor earlier flags shift a draw. Allocates nothing.
/// @throws std::invalid_argument unless 0 <= floor <= low <= high, the wander is >= 0, dt positive, sizes fit.
void excess_delays(std::span<const std::uint8_t> line_of_sight, std::size_t links, double dt_s,
                   const ExcessDelayOptions& options, const RandomStream& random, std::span<double> excess_m);

}  // namespace soopnav::simulation
