#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>

#include "soopnav/navigation/source_locator.hpp"

namespace soopnav::navigation {

inline constexpr std::size_t kMaxTracks = 32;        ///< sources followed at a time
inline constexpr std::size_t kMaxScanBearings = 32;  ///< bearings of one epoch; more are left out

/// How far a track has come.
enum class TrackState : std::uint8_t { kTentative, kConfirmed };

/// Rules for several sources.
struct SourceTrackOptions {
  SourceOptions source;            ///< of each track's bank; its method is set to kEkfBank
  double gate_probability = 1e-4;  ///< of leaving out a source's own bearing, in (0, 0.5)
  double clutter_density_per_rad =
      0.01;                ///< of false bearings in an epoch, per radian (in space: per square radian), > 0
  int confirm_hits = 5;    ///< bearings within `confirm_epochs` that confirm a track, >= 2
  int confirm_epochs = 8;  ///< a tentative track has so long; 2 ... 60
  int drop_misses = 30;    ///< epochs in a row without a bearing that end a confirmed track, >= 1

  /// Throws std::invalid_argument naming the option, its value and the rule.
  void check() const;
};

/// One source as it stands.
struct SourceTrack {
  std::uint32_t id = 0;  ///< never used twice
  TrackState state = TrackState::kTentative;
  SourceFix fix;
  int hits = 0;      ///< bearings taken
  int misses = 0;    ///< epochs in a row without one
  int bearing = -1;  ///< index of this epoch's bearing; -1: none
};

/// Several sources at once: bearings of an epoch are shared out among banks of extended Kalman filters (`kEkfBank`).
///
/// Association is by global nearest neighbour: the assignment of bearings to tracks with the largest likelihood, a
/// bearing outside a track's gate or less likely than clutter staying free (doc/source_location.md section 9). A free
/// bearing good enough to start a bank starts a tentative track; hits confirm it, misses end it. A track that comes to
/// stand on another one's source (positions within the joint one-sigma, both well known) ends, the younger first.
/// `step` allocates nothing. Same options and bearings, same bits. Move-only.
class SourceTracks {
 public:
  /// Throws std::invalid_argument for the options.
  explicit SourceTracks(const SourceTrackOptions& options);
  SourceTracks(SourceTracks&&) noexcept;
  SourceTracks& operator=(SourceTracks&&) noexcept;
  ~SourceTracks();

  /// One epoch: bearings from one place at one time. Those that are not finite or have a bad sigma are left out, as is
  /// an epoch before the last one.
  void step(std::span<const SourceBearing> bearings) noexcept;
  /// Tentative and confirmed, oldest first.
  [[nodiscard]] std::span<const SourceTrack> tracks() const noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// The assignment of rows to columns with the least sum of costs (Kuhn and Munkres, by shortest augmenting paths).
/// `cost`: rows x columns, row after row, finite, rows <= columns <= 64. `column_of` gets each row's column. O(rows²
/// columns), no allocation.
void assign(std::span<const double> cost, std::size_t rows, std::size_t columns,
            std::span<std::size_t> column_of) noexcept;

}  // namespace soopnav::navigation
