#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "soopnav/gnss/baseline.hpp"

namespace soopnav::gnss {

namespace {

constexpr double kMaxFraction = 0.2;   // of a cycle, for an integer that is rounded
constexpr std::size_t kRedundant = 5;  // satellites from which a wrong integer shows
constexpr double kDistinct = 9.0;      // how much worse than without the culprit it is without another

// Of residuals over their variance, per degree of freedom, while integers are believed: chi-square's 1e-6 or less.
double highest_mean_square(double dof) { return 5.0 + 20.0 / dof; }

}  // namespace

// Satellites of one epoch whose integers are known.
struct BaselineTracker::Satellites {
  std::array<BaselineSatellite, kMaxBaselineSatellites> items;
  std::size_t count = 0;

  void add(const BaselineSatellite& satellite) noexcept {
    if (count < items.size()) items[count++] = satellite;
  }
  void remove(std::size_t i) noexcept {
    for (--count; i < count; ++i) items[i] = items[i + 1];
  }
  [[nodiscard]] std::span<const BaselineSatellite> all() const noexcept { return {items.data(), count}; }
};

const BaselineTracker::Known* BaselineTracker::find(int id) const noexcept {
  for (const Known& known : known_) {
    if (known.id == id) return &known;
  }
  return nullptr;
}

void BaselineTracker::forget(int id) noexcept {
  for (std::size_t i = 0; i < known_.size(); ++i) {
    if (known_[i].id == id) {
      known_.erase_at(i);
      return;
    }
  }
}

// Of the phase residuals over their variances, per degree of freedom; in units of what is believed.
double BaselineTracker::misfit(const Satellites& satellites, const BaselineFix& fix) const noexcept {
  double sum = 0.0;
  for (std::size_t i = 0; i < fix.residuals_m.size(); ++i) {
    for (const BaselineSatellite& satellite : satellites.all()) {
      if (satellite.id != fix.ids[i]) continue;
      sum += fix.residuals_m[i] * fix.residuals_m[i] / solver_.phase_variance_m2(satellite);
      break;
    }
  }
  const double dof = static_cast<double>(fix.residuals_m.size()) - (solver_.options().length_m ? 3.0 : 4.0);
  return sum / (dof * highest_mean_square(dof));
}

BaselineFix BaselineTracker::track(const Satellites& satellites) noexcept {
  StaticVector<double, kMaxBaselineSatellites> integers;
  for (const BaselineSatellite& satellite : satellites.all()) {
    static_cast<void>(integers.push_back(find(satellite.id)->integer));
  }
  return solver_.with_integers(satellites.all(), {integers.data(), integers.size()});
}

// Takes out the one satellite without which the others agree, when no other one would do nearly as well.
bool BaselineTracker::drop_slipped(Satellites& satellites, BaselineFix& fix) noexcept {
  if (satellites.count <= kRedundant) return false;
  std::size_t culprit = satellites.count;
  double best = std::numeric_limits<double>::infinity(), second = best;
  BaselineFix without;
  for (std::size_t i = 0; i < satellites.count; ++i) {
    Satellites others = satellites;
    others.remove(i);
    const BaselineFix attempt = track(others);
    if (!attempt.fixed()) continue;
    const double found = misfit(others, attempt);
    second = std::min(second, std::max(best, found));
    if (!(found < best)) continue;
    best = found;
    culprit = i;
    without = attempt;
  }
  constexpr double kNoise = 0.1;  // about what is left of right integers
  if (!(best <= 1.0) || !(second >= kDistinct * std::max(best, kNoise))) return false;
  without.slips = fix.slips;
  static_cast<void>(without.slips.push_back(satellites.items[culprit].id));
  forget(satellites.items[culprit].id);
  satellites.remove(culprit);
  fix = without;
  return true;
}

// Integers of satellites that have none, by rounding about the baseline; all of them refer to the first one used.
void BaselineTracker::add(std::span<const BaselineSatellite> satellites, const BaselineFix& fix) noexcept {
  const Known* datum = find(fix.ids.front());
  const BaselineSatellite* reference = nullptr;
  for (const BaselineSatellite& satellite : satellites) {
    if (satellite.id == fix.ids.front()) reference = &satellite;
  }
  if (datum == nullptr || reference == nullptr) return;
  const double origin = datum->integer;
  for (const BaselineSatellite& satellite : satellites) {
    if (find(satellite.id) != nullptr || !solver_.usable(satellite)) continue;
    const double path = (reference->direction - satellite.direction).dot(fix.baseline_m);
    const double cycles = satellite.phase_cycles - reference->phase_cycles - path / solver_.options().wavelength_m;
    const double whole = std::round(cycles);
    if (std::abs(cycles - whole) < kMaxFraction) static_cast<void>(known_.push_back({satellite.id, origin + whole}));
  }
}

BaselineFix BaselineTracker::step(std::span<const BaselineSatellite> satellites) noexcept {
  Satellites held;
  StaticVector<int, kMaxBaselineSatellites> slips;
  for (const BaselineSatellite& satellite : satellites) {
    if (!solver_.usable(satellite) || find(satellite.id) == nullptr) continue;
    if (satellite.lost_lock) {
      static_cast<void>(slips.push_back(satellite.id));
    } else {
      held.add(satellite);
    }
  }
  // What is not seen any more, or is flagged, has lost its integer.
  for (std::size_t i = known_.size(); i-- > 0;) {
    bool seen = false;
    for (const BaselineSatellite& satellite : held.all()) seen = seen || satellite.id == known_[i].id;
    if (!seen) known_.erase_at(i);
  }
  if (held.count >= kRedundant) {
    BaselineFix fix = track(held);
    fix.slips = slips;
    bool agree = fix.fixed() && misfit(held, fix) <= 1.0;
    if (fix.fixed() && !agree) agree = drop_slipped(held, fix);
    if (agree) {
      add(satellites, fix);
      return fix;
    }
    for (const BaselineSatellite& satellite : held.all()) static_cast<void>(slips.push_back(satellite.id));
  }
  known_.clear();
  BaselineFix fix = solver_.solve(satellites);
  fix.slips = slips;
  if (fix.fixed()) {
    for (std::size_t i = 0; i < fix.ids.size(); ++i) {
      static_cast<void>(known_.push_back({fix.ids[i], fix.integers[i]}));
    }
  }
  return fix;
}

}  // namespace soopnav::gnss
