#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <memory>
#include <span>
#include <vector>

#include "soopnav/array/covariance.hpp"
#include "soopnav/array/manifold.hpp"
#include "soopnav/array/subspace.hpp"
#include "soopnav/array/types.hpp"

namespace soopnav::array {

/// The grid that a search starts from; what the array cannot tell apart is left out of it.
struct GridOptions {
  double azimuth_step_rad = 0.017453292519943295;    ///< a turn is divided evenly into steps of at most this
  double elevation_step_rad = 0.017453292519943295;  ///< likewise from the lowest elevation to 90 degrees
  double elevation_min_rad = 0.0;                    ///< lowest elevation; lines of elements have a grid of their own
  double azimuth_start_rad = 0.0;                    ///< of the first column
  double frequency_hz = 0.0;                         ///< of the signal; 0: the geometry's
};

/// Steering vectors of a manifold over a grid of directions, once made and shared by estimators: single precision,
/// normalised, in groups of 16 directions, for the scan; and the directions.
///
/// Rows are elevations from the lowest up, columns azimuths. A horizontal line of elements has one row of half a turn,
/// a vertical one a column of elevations. Directions that a measured manifold does not reach are left out of the
/// search.
class SteeringTable {
 public:
  /// @throws std::invalid_argument for steps that are not in (0, 45] degrees or make more than 16 million directions, a
  ///         lowest elevation outside -90 .. 89 degrees, a frequency that is negative or not finite, a manifold that
  ///         reaches none of the directions, or a line of elements that is neither horizontal nor vertical.
  explicit SteeringTable(Manifold manifold, const GridOptions& options = {});

  [[nodiscard]] const Manifold& manifold() const noexcept { return manifold_; }
  [[nodiscard]] const GridOptions& options() const noexcept { return options_; }
  [[nodiscard]] double frequency_hz() const noexcept { return frequency_hz_; }
  [[nodiscard]] std::size_t rows() const noexcept { return elevations_.size(); }
  [[nodiscard]] std::size_t columns() const noexcept { return azimuths_.size(); }
  [[nodiscard]] std::size_t size() const noexcept { return rows() * columns(); }
  [[nodiscard]] const std::vector<double>& azimuths_rad() const noexcept { return azimuths_; }
  [[nodiscard]] const std::vector<double>& elevations_rad() const noexcept { return elevations_; }
  [[nodiscard]] bool periodic() const noexcept { return periodic_; }  ///< columns go round
  /// 1 along azimuth, 2 along elevation, 3 both: what the array tells.
  [[nodiscard]] int active() const noexcept { return active_; }
  /// Directions and their mirror images look alike: one side is reported. So for every line, and for a plane unless its
  /// measured responses tell the two sides of it apart and the grid has both.
  [[nodiscard]] bool mirror() const noexcept { return mirror_; }
  [[nodiscard]] std::span<const float> values() const noexcept { return values_; }
  [[nodiscard]] std::size_t groups() const noexcept { return groups_; }
  [[nodiscard]] Direction direction(std::size_t index) const noexcept {
    return {azimuths_[index % columns()], elevations_[index / columns()]};
  }

 private:
  [[nodiscard]] bool sides_alike() const noexcept;

  Manifold manifold_;
  GridOptions options_;
  double frequency_hz_;
  std::vector<double> azimuths_, elevations_;
  bool periodic_ = true;
  int active_ = 3;
  bool mirror_ = false;
  std::size_t groups_ = 0;
  std::vector<float> values_;
};

/// One source's direction.
struct Bearing {
  double azimuth_rad = 0.0;  ///< (-pi, pi]
  double elevation_rad = 0.0;
  /// Of [azimuth, elevation], from the asymptotic law of MUSIC (or of the fit), doc/array.md eq. 10. Near the zenith
  /// azimuth's grows as 1 / cos^2(elevation). No direction's standard deviation exceeds pi/2 before that; what an array
  /// does not tell (a line) has an infinite variance and no correlation.
  Eigen::Matrix2d covariance_rad2 = Eigen::Matrix2d::Zero();
  double power = 0.0;     ///< of the source at an ideal element, in the covariance's units; noise taken out
  double spectrum = 0.0;  ///< the method's normalised spectrum there: a^H W a / a^H a, 1 is all MUSIC can reach
};

/// What one block of samples gave. Views into the estimator, valid until its next call.
struct Bearings {
  ArrayStatus status = ArrayStatus::kNoSource;
  int channel = -1;                     ///< at fault, for kNonFinite and kDeadChannel
  std::span<const Bearing> sources;     ///< strongest first; empty unless kOk or kUnresolved
  std::span<const double> eigenvalues;  ///< M, largest first; empty when there is no finite covariance
  double noise = 0.0;                   ///< mean noise eigenvalue
  bool mirror = false;  ///< each source may as well be its image behind the array: `SteeringTable::mirror`
};

enum class DirectionMethod : std::uint8_t {
  kMusic,
  kCapon,
  kBartlett,
  kSubspaceFitting,    ///< Viberg and Ottersten 1991: all sources at once, efficient, coherent ones too
  kMaximumLikelihood,  ///< deterministic maximum likelihood, all at once
};

struct FinderOptions {
  DirectionMethod method = DirectionMethod::kMusic;
  int n_sources = 1;     ///< 0: by MDL in each block
  double loading = 0.0;  ///< Capon: of the diagonal, times the mean power
  bool average = false;  ///< forward-backward
};

/// Directions from samples: covariance, eigenvectors, scan of a grid, peaks, refinement off the grid.
///
/// The scan sums a^H W a over the signal's eigenvectors in single precision; each peak is then followed by Newton's
/// method on the continuous function in double precision, on the sphere's tangent plane (regular at zenith and
/// horizon), until it moves less than 1e-11 rad: the grid's phase leaves no trace. A planar array's maximum is looked
/// for on the reported side. Of several sources the highest separate peaks count. The two fits start from them, or
/// from alternating projections when they are too few.
///
/// Made once; nothing in `estimate` allocates. One object serves one thread at a time. 4 elements, 2500 snapshots, 360
/// x 91 directions: about 50 us.
class DirectionFinder {
 public:
  /// @throws std::invalid_argument for n_sources outside 0 .. M-1 or a loading that is negative or not finite.
  explicit DirectionFinder(std::shared_ptr<const SteeringTable> table, const FinderOptions& options = {});
  ~DirectionFinder();
  DirectionFinder(DirectionFinder&&) noexcept;
  DirectionFinder& operator=(DirectionFinder&&) noexcept;

  [[nodiscard]] Bearings estimate(const ChannelSpan& iq) noexcept;
  /// From a covariance of `n_snapshots`, at least M, which scale the bearings' covariance and the source count.
  [[nodiscard]] Bearings estimate(const ComplexMatrix& R, double n_snapshots) noexcept;

  [[nodiscard]] const SteeringTable& table() const noexcept { return *table_; }
  [[nodiscard]] const FinderOptions& options() const noexcept { return options_; }

 private:
  struct Work;

  Bearings fail(ArrayStatus status, int channel = -1) const noexcept;

  std::shared_ptr<const SteeringTable> table_;
  FinderOptions options_;
  std::unique_ptr<Work> work_;
};

}  // namespace soopnav::array
