#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "soopnav/clock/clock_noise.hpp"
#include "soopnav/core/epoch.hpp"
#include "soopnav/navigation/sop_fusion.hpp"

namespace soopnav::navigation {

/// What kind of signal a source sends; values as snapshots have them.
enum class SopKind : std::uint8_t { kOther = 0, kCdma, kGps, kIridium, kLte, kOfdm, kFm };

/// "other", "cdma", "gps", "iridium", "lte", "ofdm", "fm"; "unknown" for a value that is no enumerator.
[[nodiscard]] std::string_view to_string(SopKind kind) noexcept;

/// A source as the shared database knows it, at one time. Times are microseconds of UTC as POSIX counts, from 1970.
struct SopSource {
  std::string id;    ///< the database's, printable too, 1 to 40 bytes
  std::string name;  ///< UTF-8 without control characters, at most 400 bytes
  SopKind kind = SopKind::kOther;
  double carrier_hz = 0.0;
  std::uint32_t contributions = 0;  ///< that it is fused from
  std::int64_t newest_us = 0;       ///< of the newest of them
  std::int64_t at_us = 0;           ///< of position, clock and noise
  char grade = 'D';                 ///< 'A' to 'D', when the snapshot was made
  std::optional<SopPosition> position;
  std::optional<SopClock> clock;  ///< offset [s], drift [s/s]; its t_s is not used
  std::optional<SopNoise> noise;
};

/// What a navigator starts a source with: metres and metres per second, as filters have clocks.
struct SopPrior {
  double carrier_hz = 0.0;
  bool has_position = false;
  Eigen::Vector3d p_e_m = Eigen::Vector3d::Zero();  ///< ECEF
  Eigen::Matrix3d position_covariance_m2 = Eigen::Matrix3d::Zero();
  bool has_clock = false;
  Eigen::Vector2d clock = Eigen::Vector2d::Zero();             ///< c offset [m], c drift [m/s]
  Eigen::Matrix2d clock_covariance = Eigen::Matrix2d::Zero();  ///< of them
  bool has_noise = false;                                      ///< otherwise `noise` is a TCXO's
  clock::ClockNoise noise{};                                   ///< mean of the uncertain coefficients
};

/// Sources of a snapshot of the shared database, to work from without a network (format: doc/signal_database.md).
///
/// Reading allocates; queries and `prior` do not, nor do they throw.
class SopCatalog {
 public:
  SopCatalog() = default;

  /// Reads a snapshot.
  /// @throws std::invalid_argument that says what was expected and where, for anything that is not one: too short,
  /// another magic, a newer version, a count that does not fit the size, a checksum that does not fit, values out of
  /// range.
  [[nodiscard]] static SopCatalog read(std::span<const std::byte> bytes);
  /// Of a file; the sentence starts with its name. Also when it cannot be read.
  [[nodiscard]] static SopCatalog open(const std::filesystem::path& path);

  [[nodiscard]] std::span<const SopSource> sources() const noexcept { return sources_; }  ///< ordered by id
  [[nodiscard]] std::int64_t created_us() const noexcept { return created_us_; }          ///< when it was written

  /// The source with this id; null when there is none. O(log n).
  [[nodiscard]] const SopSource* find(std::string_view id) const noexcept;

  /// Sources of a kind within `tolerance_hz` of a carrier, ordered by id. Writes as many as `out` holds.
  /// @returns how many there are. O(n).
  std::size_t find(SopKind kind, double carrier_hz, double tolerance_hz,
                   std::span<const SopSource*> out) const noexcept;

  /// Sources within `radius_m` of an ECEF position, nearest first: the nearest that `out` holds. O(n log m) and m
  /// moves for each found.
  /// @returns how many there are; 0 for a position or radius that is not finite.
  std::size_t near(const Eigen::Vector3d& p_e_m, double radius_m, std::span<const SopSource*> out) const noexcept;

 private:
  std::vector<SopSource> sources_;
  std::int64_t created_us_ = 0;
};

/// What a navigator may suppose about a source at a time: its clock run on by the clock model and every covariance
/// grown, the clock's by E[h] of its uncertain coefficients (or by a TCXO's where none are known), position and
/// coefficients by the ageing that the database uses. Backwards as `move_clock`. No allocation.
/// @returns false, and `out` is as it was, unless `at` is a valid epoch of UTC.
[[nodiscard]] bool prior(const SopSource& source, const Epoch& at, SopPrior& out) noexcept;

/// A snapshot of sources, in any order: bytes for `SopCatalog::read`. Allocates.
/// @throws std::invalid_argument that names the source and the rule: an id that is empty, too long or not the only one,
/// a name too long, numbers that are not finite, variances that are not positive.
[[nodiscard]] std::vector<std::byte> write_snapshot(std::span<const SopSource> sources, std::int64_t created_us);

}  // namespace soopnav::navigation
