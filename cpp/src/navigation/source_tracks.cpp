#include "soopnav/navigation/source_tracks.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "navigation/source_bank.hpp"
#include "navigation/source_filter.hpp"
#include "soopnav/estimation/chi_square.hpp"

namespace soopnav::navigation {

using namespace detail;  // NOLINT(google-build-using-namespace): the parts of this very class

namespace {

constexpr std::size_t kMost = kMaxTracks + kMaxScanBearings;
constexpr double kForbidden = 1e6;  // a cost that no assignment pays while it can stay free

}  // namespace

void SourceTrackOptions::check() const {
  SourceOptions bank = source;
  bank.method = SourceMethod::kEkfBank;
  bank.check();
  const auto require = [](bool holds, const char* name, double value, const char* rule) {
    if (!holds) throw std::invalid_argument(std::string(name) + " = " + std::to_string(value) + ": " + rule);
  };
  require(source.bank_azimuths == 0, "bank_azimuths", source.bank_azimuths, "0 expected: tracks start along bearings");
  require(gate_probability > 0.0 && gate_probability < 0.5, "gate_probability", gate_probability,
          "between 0 and 0.5 expected");
  require(clutter_density_per_rad > 0.0 && std::isfinite(clutter_density_per_rad), "clutter_density_per_rad",
          clutter_density_per_rad, "a positive number expected");
  require(confirm_hits >= 2, "confirm_hits", confirm_hits, "at least 2 expected");
  require(confirm_epochs >= confirm_hits && confirm_epochs <= 60, "confirm_epochs", confirm_epochs,
          "confirm_hits ... 60 expected");
  require(drop_misses >= 1, "drop_misses", drop_misses, "at least 1 expected");
}

void assign(std::span<const double> cost, std::size_t rows, std::size_t columns,
            std::span<std::size_t> column_of) noexcept {
  // Potentials u, v; rows enter one at a time along the cheapest augmenting path. Index 0 is the path's start.
  std::array<double, kMost + 1> u{};
  std::array<double, kMost + 1> v{};
  std::array<std::size_t, kMost + 1> row_at{};
  for (std::size_t row = 1; row <= rows; ++row) {
    std::array<double, kMost + 1> least;
    least.fill(std::numeric_limits<double>::infinity());
    std::array<bool, kMost + 1> done{};
    std::array<std::size_t, kMost + 1> from{};
    row_at[0] = row;
    std::size_t column = 0;
    do {
      done[column] = true;
      const std::size_t r = row_at[column];
      double delta = std::numeric_limits<double>::infinity();
      std::size_t next = 0;
      for (std::size_t j = 1; j <= columns; ++j) {
        if (done[j]) continue;
        const double reduced = cost[(r - 1) * columns + (j - 1)] - u[r] - v[j];
        if (reduced < least[j]) {
          least[j] = reduced;
          from[j] = column;
        }
        if (least[j] < delta) {
          delta = least[j];
          next = j;
        }
      }
      if (next == 0) return;  // a cost was not finite
      for (std::size_t j = 0; j <= columns; ++j) {
        if (done[j]) {
          u[row_at[j]] += delta;
          v[j] -= delta;
        } else {
          least[j] -= delta;
        }
      }
      column = next;
    } while (row_at[column] != 0);
    while (column != 0) {
      const std::size_t back = from[column];
      row_at[column] = row_at[back];
      column = back;
    }
  }
  for (std::size_t j = 1; j <= columns; ++j) {
    if (row_at[j] != 0) column_of[row_at[j] - 1] = j - 1;
  }
}

struct SourceTracks::Impl {
  SourceTrackOptions options;
  Layout layout;
  double gate;
  std::vector<EkfBank> banks;  // as many as tracks may be; `slot` says whose
  std::array<std::size_t, kMaxTracks> slot{};
  std::array<int, kMaxTracks> age{};
  std::vector<SourceTrack> tracks;
  std::array<double, kMaxScanBearings * kMost> cost{};
  std::uint32_t next_id = 1;
  double t_s = -std::numeric_limits<double>::infinity();

  explicit Impl(const SourceTrackOptions& o) : options(o) {
    options.source.method = SourceMethod::kEkfBank;
    layout = {static_cast<std::size_t>(o.source.dimensions), o.source.motion == SourceMotion::kConstantVelocity,
              o.source.heading_bias_sigma_rad > 0.0};
    gate = chi_square_upper_quantile(o.gate_probability, static_cast<double>(layout.dimensions - 1));
    banks.reserve(kMaxTracks);
    tracks.reserve(kMaxTracks);
    for (std::size_t i = 0; i < kMaxTracks; ++i) banks.emplace_back(options.source, layout);
    for (std::size_t i = 0; i < kMaxTracks; ++i) slot[i] = i;
  }

  void drop(std::size_t i) noexcept {
    const std::size_t free = slot[i];
    banks[free].clear();
    for (std::size_t k = i; k + 1 < tracks.size(); ++k) {
      tracks[k] = tracks[k + 1];
      slot[k] = slot[k + 1];
      age[k] = age[k + 1];
    }
    slot[tracks.size() - 1] = free;
    tracks.pop_back();
  }

  void refresh(SourceTrack& track, std::size_t i, const Kept* newest) noexcept {
    Gaussian g;
    track.fix.dimensions = options.source.dimensions;
    if (!banks[slot[i]].moments(g)) {
      track.fix.status = SourceStatus::kDiverged;
      return;
    }
    write_state(layout, g.x, g.P, track.fix);
    track.fix.used = static_cast<std::size_t>(track.hits);
    if (newest == nullptr) return;
    const Eigen::Vector2d away(track.fix.position_m[0] - newest->b.x, track.fix.position_m[1] - newest->b.y);
    const Eigen::Matrix3d& P = track.fix.covariance_m2;
    const double largest = 0.5 * (P(0, 0) + P(1, 1)) + std::hypot(0.5 * (P(0, 0) - P(1, 1)), P(0, 1));
    const bool known = std::sqrt(largest) <= 0.5 * away.norm();
    track.fix.status = known ? SourceStatus::kConverged : SourceStatus::kUnobservable;
  }

  [[nodiscard]] bool same(const SourceFix& a, const SourceFix& b) const noexcept {
    if (a.status != SourceStatus::kConverged || b.status != SourceStatus::kConverged) return false;
    Matrix C{};
    Matrix L{};
    Vector miss{};
    for (std::size_t i = 0; i < layout.dimensions; ++i) {
      const auto row = static_cast<Eigen::Index>(i);
      miss[i] = a.position_m[row] - b.position_m[row];
      for (std::size_t j = 0; j < layout.dimensions; ++j) {
        const auto column = static_cast<Eigen::Index>(j);
        C[i][j] = a.covariance_m2(row, column) + b.covariance_m2(row, column);
      }
    }
    if (!factor(layout.dimensions, C, L)) return false;
    Vector scaled{};
    solve(layout.dimensions, L, miss, scaled);
    double square = 0.0;
    for (std::size_t i = 0; i < layout.dimensions; ++i) square += miss[i] * scaled[i];
    return square < 1.0;
  }

  void step(std::span<const SourceBearing> bearings) noexcept {
    std::array<Kept, kMaxScanBearings> scan;
    std::array<int, kMaxScanBearings> index{};
    std::size_t m = 0;
    for (std::size_t i = 0; i < bearings.size() && m < kMaxScanBearings; ++i) {
      if (pack(bearings[i], layout.dimensions, scan[m]) != BearingUse::kUsed || scan[m].t_s < t_s) continue;
      index[m] = static_cast<int>(i);
      ++m;
    }
    for (std::size_t i = 0; i < m; ++i) t_s = std::max(t_s, scan[i].t_s);
    const std::size_t n = tracks.size();
    const std::size_t columns = n + m;
    const double free = -std::log(options.clutter_density_per_rad);
    for (std::size_t i = 0; i < m; ++i) {
      for (std::size_t j = 0; j < n; ++j) {
        double density = 0.0;
        double nis = 0.0;
        const bool fits = banks[slot[j]].score(scan[i], density, nis) && nis <= gate && -density < free;
        cost[i * columns + j] = fits ? -density : kForbidden;
      }
      for (std::size_t j = n; j < columns; ++j) cost[i * columns + j] = free;
    }
    std::array<std::size_t, kMaxScanBearings> column{};
    if (m > 0) assign({cost.data(), m * columns}, m, columns, column);
    for (std::size_t j = 0; j < n; ++j) {
      tracks[j].bearing = -1;
      ++age[j];
    }
    for (std::size_t i = 0; i < m; ++i) {
      if (column[i] >= n) continue;
      SourceTrack& track = tracks[column[i]];
      static_cast<void>(banks[slot[column[i]]].step(scan[i]));
      track.bearing = index[i];
      ++track.hits;
    }
    for (std::size_t j = 0; j < n; ++j) {
      SourceTrack& track = tracks[j];
      track.misses = track.bearing < 0 ? track.misses + 1 : 0;
      refresh(track, j, m > 0 ? &scan[0] : nullptr);
      if (track.state == TrackState::kTentative && track.hits >= options.confirm_hits) {
        track.state = TrackState::kConfirmed;
      }
    }
    for (std::size_t j = tracks.size(); j-- > 0;) {
      const SourceTrack& track = tracks[j];
      const bool late = track.state == TrackState::kTentative && age[j] >= options.confirm_epochs;
      const bool lost = track.state == TrackState::kConfirmed && track.misses >= options.drop_misses;
      bool twice = false;
      for (std::size_t k = 0; k < j && !twice; ++k) twice = same(tracks[k].fix, track.fix);
      if (late || lost || twice || track.fix.status == SourceStatus::kDiverged) drop(j);
    }
    for (std::size_t i = 0; i < m && tracks.size() < kMaxTracks; ++i) {
      if (column[i] < n) continue;
      const std::size_t at = tracks.size();
      EkfBank& bank = banks[slot[at]];
      bank.clear();
      if (bank.step(scan[i]) != BearingUse::kUsed) continue;
      SourceTrack track;
      track.id = next_id++;
      track.hits = 1;
      track.bearing = index[i];
      age[at] = 1;
      tracks.push_back(track);
      refresh(tracks[at], at, &scan[i]);
    }
  }
};

SourceTracks::SourceTracks(const SourceTrackOptions& options) {
  options.check();
  impl_ = std::make_unique<Impl>(options);
}
SourceTracks::SourceTracks(SourceTracks&&) noexcept = default;
SourceTracks& SourceTracks::operator=(SourceTracks&&) noexcept = default;
SourceTracks::~SourceTracks() = default;

void SourceTracks::step(std::span<const SourceBearing> bearings) noexcept { impl_->step(bearings); }
std::span<const SourceTrack> SourceTracks::tracks() const noexcept {
  return {impl_->tracks.data(), impl_->tracks.size()};
}

}  // namespace soopnav::navigation
