#include "soopnav/gnss/gps_phase.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include "phase_normal.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/geometry/local_frame.hpp"
#include "soopnav/gnss/single_point.hpp"

namespace soopnav::gnss {

namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr int kPasses = 4;
constexpr double kOutlierSigmas = 5.0;

void phase_size(const char* name, std::size_t size, std::size_t expected) {
  if (size == expected) return;
  throw std::invalid_argument(std::string(name) + ": " + std::to_string(expected) + " numbers expected, got " +
                              std::to_string(size));
}

// One solution on its way.
class StaticSolution {
 public:
  StaticSolution(const EphemerisTable& ephemerides, const std::optional<Klobuchar>& klobuchar, const PhaseTable& table,
                 const StaticPhaseOptions& options)
      : ephemerides_(ephemerides),
        klobuchar_(klobuchar),
        table_(table),
        options_(options),
        n_(table.time_of_week_s.size()),
        s_(table.prn.size()) {}

  StaticPhaseFix solve();

 private:
  [[nodiscard]] std::size_t at(std::size_t k, std::size_t i) const noexcept { return k * s_ + i; }
  [[nodiscard]] Epoch epoch(std::size_t k) const noexcept {
    return gps_epoch(static_cast<std::int64_t>(table_.week[k]), table_.time_of_week_s[k]);
  }
  void combine();
  bool start();
  void model();
  void find_arcs();
  bool normal_equations();
  bool reject();
  void covariances();

  // Columns: position 0 ... 2, zenith 3, then error and its rate of each satellite, then a constant of each arc.
  [[nodiscard]] std::size_t error_column(std::size_t i) const noexcept { return 4 + 2 * i; }
  [[nodiscard]] std::size_t arc_column(int arc) const noexcept { return 4 + 2 * s_ + static_cast<std::size_t>(arc); }
  struct Row {
    std::size_t column[7];
    double value[7];
    int count = 0;
    double y = 0.0, weight = 0.0;
  };
  [[nodiscard]] Row row(std::size_t k, std::size_t i, bool phase) const noexcept;
  [[nodiscard]] bool code_used(std::size_t m) const noexcept { return code_ok_[m] != 0; }
  [[nodiscard]] bool phase_used(std::size_t m) const noexcept {
    return fix_.use[m] == static_cast<std::uint8_t>(PhaseUse::kUsed) && fix_.arc[m] >= 0;
  }

  const EphemerisTable& ephemerides_;
  const std::optional<Klobuchar>& klobuchar_;
  const PhaseTable& table_;
  const StaticPhaseOptions& options_;
  std::size_t n_, s_;
  StaticPhaseFix fix_;
  Eigen::Vector3d p_ = Eigen::Vector3d::Zero();
  std::vector<double> t_, predicted_, mapping_, sigma_factor_, wide_, narrow_, wind_up_;
  std::vector<Eigen::Vector3d> direction_;
  std::vector<std::uint8_t> code_ok_;
  std::vector<const Ephemeris*> pinned_;
  std::vector<std::size_t> active_;
  PhaseNormal normal_;
  std::vector<double> right_, theta_;
  int arcs_ = 0;
  double middle_s_ = 0.0;
  double lasting_ = 1.0;  // variance of a phase that counts, over that of its noise
};

void StaticSolution::combine() {
  const std::size_t all = n_ * s_;
  auto fill = [all](std::vector<double>& v) { v.assign(all, kNan); };
  for (auto* v : {&fix_.phase_residual_m, &fix_.code_residual_m, &fix_.elevation_rad, &fix_.azimuth_rad, &fix_.phase_m,
                  &fix_.code_m, &fix_.phase_correction_m, &fix_.code_correction_m, &fix_.satellite_clock_m, &predicted_,
                  &mapping_, &sigma_factor_, &wide_, &narrow_}) {
    fill(*v);
  }
  fix_.satellite_e.assign(3 * all, kNan);
  fix_.use.assign(all, static_cast<std::uint8_t>(PhaseUse::kMissing));
  fix_.arc.assign(all, -1);
  fix_.clock_m.assign(n_, kNan);
  fix_.clock_sigma_m.assign(n_, kNan);
  direction_.assign(all, Eigen::Vector3d::Zero());
  wind_up_.assign(all, 0.0);
  code_ok_.assign(all, 0);
  pinned_.assign(all, nullptr);
  t_.resize(n_);
  for (std::size_t k = 0; k < n_; ++k) {
    t_[k] = (table_.week[k] - table_.week[0]) * kWeekS + (table_.time_of_week_s[k] - table_.time_of_week_s[0]);
  }
  if (n_ > 1) {
    std::vector<double> steps(n_ - 1);
    for (std::size_t k = 1; k < n_; ++k) steps[k - 1] = t_[k] - t_[k - 1];
    const auto middle = steps.begin() + static_cast<std::ptrdiff_t>(steps.size() / 2);
    std::nth_element(steps.begin(), middle, steps.end());
    lasting_ = 1.0 + 2.0 * options_.phase_correlation_s / *middle;
  }
  middle_s_ = n_ > 0 ? 0.5 * (t_.front() + t_.back()) : 0.0;
  const double l1 = kSpeedOfLightMps / kL1Hz, l2 = kSpeedOfLightMps / kL2Hz;
  for (std::size_t m = 0; m < all; ++m) {
    const double c1 = table_.code1_m[m], p1 = table_.phase1_cycles[m];
    if (!options_.dual) {
      if (std::isfinite(c1)) fix_.code_m[m] = c1;
      if (std::isfinite(p1)) fix_.phase_m[m] = l1 * p1;
    } else {
      const double c2 = table_.code2_m[m], p2 = table_.phase2_cycles[m];
      if (std::isfinite(c1) && std::isfinite(c2)) fix_.code_m[m] = ionosphere_free_m(c1, c2);
      if (std::isfinite(p1) && std::isfinite(p2)) {
        fix_.phase_m[m] = ionosphere_free_m(l1 * p1, l2 * p2);
        narrow_[m] = l1 * p1 - l2 * p2;
        if (std::isfinite(c1) && std::isfinite(c2)) wide_[m] = wide_lane_cycles(p1, p2, c1, c2);
      }
      if (std::isfinite(c1) || std::isfinite(p1) || std::isfinite(c2) || std::isfinite(p2)) {
        fix_.use[m] = static_cast<std::uint8_t>(PhaseUse::kPartial);
      }
    }
    if (std::isfinite(fix_.code_m[m]) && std::isfinite(fix_.phase_m[m])) {
      fix_.use[m] = static_cast<std::uint8_t>(PhaseUse::kUsed);
    } else if (!options_.dual && (std::isfinite(c1) || std::isfinite(p1))) {
      fix_.use[m] = static_cast<std::uint8_t>(PhaseUse::kPartial);
    }
  }
}

// Each epoch's clock by code, the median of their positions, and one ephemeris for each satellite and stretch.
bool StaticSolution::start() {
  PointOptions point;
  point.elevation_mask_rad = options_.elevation_mask_rad;
  point.ionosphere = !options_.dual;
  point.relative_humidity = options_.relative_humidity;
  point.max_age_s = options_.max_age_s;
  const SinglePoint single(ephemerides_, options_.dual ? std::nullopt : klobuchar_, point);
  std::vector<PointMeasurement> measured;
  std::array<std::vector<double>, 3> places;
  for (std::size_t k = 0; k < n_; ++k) {
    const Epoch now = epoch(k);
    measured.clear();
    for (std::size_t i = 0; i < s_; ++i) {
      const std::size_t m = at(k, i);
      const Ephemeris* eph = k > 0 ? pinned_[at(k - 1, i)] : nullptr;
      const double limit = eph == nullptr             ? 0.0
                           : options_.max_age_s > 0.0 ? options_.max_age_s
                                                      : 0.5 * eph->fit_interval_s;
      if (eph == nullptr || !(std::abs((now - eph->toe()).value_or(kNan)) <= limit)) {
        eph = ephemerides_.find(table_.prn[i], now, options_.max_age_s);
      }
      pinned_[m] = eph;
      if (fix_.use[m] != static_cast<std::uint8_t>(PhaseUse::kUsed)) continue;
      if (eph == nullptr || eph->health != 0) {
        fix_.use[m] = static_cast<std::uint8_t>(eph == nullptr ? PhaseUse::kNoEphemeris : PhaseUse::kUnhealthy);
        continue;
      }
      PointMeasurement& one = measured.emplace_back();
      one.prn = table_.prn[i];
      one.pseudorange_m = fix_.code_m[m] + (options_.dual ? kSpeedOfLightMps * eph->tgd_s : 0.0);
    }
    const PointFix got = single.fix(now, measured);
    if (got.status != PointStatus::kConverged) continue;
    fix_.clock_m[k] = got.clock_bias_m;
    for (int j = 0; j < 3; ++j) places[static_cast<std::size_t>(j)].push_back(got.position_e[j]);
  }
  if (places[0].empty()) return false;
  for (int j = 0; j < 3; ++j) {
    auto& v = places[static_cast<std::size_t>(j)];
    std::nth_element(v.begin(), v.begin() + static_cast<std::ptrdiff_t>(v.size() / 2), v.end());
    p_[j] = v[v.size() / 2];
  }
  return true;
}

// All that is predicted at the position of now.
void StaticSolution::model() {
  const auto place = geometry::ecef_to_geodetic(p_);
  if (!place) return;
  const geometry::LocalFrame frame(*place);
  std::vector<double> before(s_, 0.0);
  const double wind_m = options_.dual ? kSpeedOfLightMps / (kL1Hz + kL2Hz) : kSpeedOfLightMps / kL1Hz;
  const double zenith_m = troposphere_delay_m(*place, 0.5 * kPi, options_.relative_humidity);
  for (std::size_t k = 0; k < n_; ++k) {
    const bool clock = std::isfinite(fix_.clock_m[k]);
    const Epoch received = epoch(k) + (clock ? -fix_.clock_m[k] / kSpeedOfLightMps : 0.0);
    const Eigen::Vector3d sun = sun_direction_e(received);
    for (std::size_t i = 0; i < s_; ++i) {
      const std::size_t m = at(k, i);
      auto& use = fix_.use[m];
      if (use != static_cast<std::uint8_t>(PhaseUse::kUsed) && use != static_cast<std::uint8_t>(PhaseUse::kLow) &&
          use != static_cast<std::uint8_t>(PhaseUse::kRejected)) {
        continue;
      }
      if (!clock) {
        use = static_cast<std::uint8_t>(PhaseUse::kNoClock);
        continue;
      }
      const auto seen = sight(*pinned_[m], received, p_);
      const auto direction = seen ? frame.direction_to(seen->position_e) : std::nullopt;
      if (!direction) {
        use = static_cast<std::uint8_t>(PhaseUse::kNoEphemeris);
        continue;
      }
      const double el = direction->elevation_rad, az = direction->azimuth_rad;
      fix_.elevation_rad[m] = el;
      fix_.azimuth_rad[m] = az;
      const bool high = el >= options_.elevation_mask_rad;
      if (use != static_cast<std::uint8_t>(PhaseUse::kRejected)) {
        use = static_cast<std::uint8_t>(high ? PhaseUse::kUsed : PhaseUse::kLow);
      }
      const double sin_el = std::sin(std::max(el, 0.05));
      sigma_factor_[m] = 1.0 / sin_el;
      direction_[m] = seen->direction_e;
      const double dry = troposphere_delay_m(*place, el, options_.relative_humidity);
      mapping_[m] = zenith_m > 0.0 ? dry / zenith_m : 0.0;
      if (options_.wind_up) {
        before[i] = phase_wind_up_cycles(seen->position_e, sun, p_, before[i]).value_or(before[i]);
        wind_up_[m] = wind_m * before[i];
      }
      const double ionosphere =
          !options_.dual && klobuchar_
              ? ionosphere_delay_m(*klobuchar_, *place, az, el, std::fmod(table_.time_of_week_s[k], kWeekS))
              : 0.0;
      fix_.satellite_clock_m[m] =
          kSpeedOfLightMps * (seen->at_transmission.clock_s + (options_.dual ? pinned_[m]->tgd_s : 0.0));
      fix_.code_correction_m[m] = dry + ionosphere;
      fix_.phase_correction_m[m] = dry - ionosphere + wind_up_[m];
      predicted_[m] = seen->range_m - fix_.satellite_clock_m[m];
      for (int j = 0; j < 3; ++j) fix_.satellite_e[3 * m + static_cast<std::size_t>(j)] = seen->position_e[j];
    }
  }
}

// Numbers the stretches of unbroken phase.
void StaticSolution::find_arcs() {
  struct Last {
    std::size_t m = 0;
    double t_s = 0.0, against = 0.0, wide = 0.0;
    int wide_count = 0, arc = -1;
    const Ephemeris* eph = nullptr;
  };
  std::vector<Last> last(s_);
  std::vector<double> moved;
  std::vector<int> length;
  double phase_clock = 0.0;  // the receiver's clock by phase, from an arbitrary start
  for (std::size_t k = 0; k < n_; ++k) {
    // The change of clock since the epoch before: the median over the satellites that both have.
    moved.clear();
    for (std::size_t i = 0; i < s_; ++i) {
      const std::size_t m = at(k, i);
      if (fix_.use[m] != static_cast<std::uint8_t>(PhaseUse::kUsed) || k == 0 || last[i].arc < 0 ||
          last[i].m != at(k - 1, i)) {
        continue;
      }
      moved.push_back(fix_.phase_m[m] - predicted_[m] - fix_.phase_correction_m[m] - phase_clock - last[i].against);
    }
    const bool clock = moved.size() >= 3;
    if (clock) {
      const auto middle = moved.begin() + static_cast<std::ptrdiff_t>(moved.size() / 2);
      std::nth_element(moved.begin(), middle, moved.end());
      phase_clock += *middle;
    }
    for (std::size_t i = 0; i < s_; ++i) {
      const std::size_t m = at(k, i);
      if (fix_.use[m] != static_cast<std::uint8_t>(PhaseUse::kUsed)) continue;
      Last& l = last[i];
      const double against = fix_.phase_m[m] - predicted_[m] - fix_.phase_correction_m[m] - phase_clock;
      const double gap = t_[k] - l.t_s;
      bool broken = l.arc < 0 || !clock || gap > options_.max_gap_s || l.eph != pinned_[m];
      broken = broken || (!table_.lost_lock.empty() && (table_.lost_lock[m] & 1U) != 0);
      broken = broken || std::abs(against - l.against) > options_.slip_m + 0.002 * gap;
      if (options_.dual && !broken) {
        broken = std::abs(narrow_[m] - narrow_[l.m]) > options_.slip_m + 0.002 * gap ||
                 (std::isfinite(wide_[m]) && l.wide_count > 9 && std::abs(wide_[m] - l.wide) > 8.0);
      }
      if (broken) {
        if (l.arc >= 0) ++fix_.slips;
        l.arc = static_cast<int>(length.size());
        length.push_back(0);
        l.wide_count = 0;
        l.wide = 0.0;
      }
      if (std::isfinite(wide_[m])) l.wide += (wide_[m] - l.wide) / std::min(++l.wide_count, 60);
      ++length[static_cast<std::size_t>(l.arc)];
      fix_.arc[m] = l.arc;
      l.m = m;
      l.t_s = t_[k];
      l.against = against;
      l.eph = pinned_[m];
    }
  }
  // Short ones go; the others are numbered anew.
  std::vector<int> number(length.size(), -1);
  for (std::size_t a = 0; a < length.size(); ++a) {
    if (length[a] >= options_.min_arc_epochs) number[a] = arcs_++;
  }
  for (std::size_t m = 0; m < fix_.arc.size(); ++m) {
    if (fix_.arc[m] < 0) continue;
    fix_.arc[m] = number[static_cast<std::size_t>(fix_.arc[m])];
    code_ok_[m] = 1;
    if (fix_.arc[m] < 0) fix_.use[m] = static_cast<std::uint8_t>(PhaseUse::kShortArc);
  }
  fix_.arcs = static_cast<std::size_t>(arcs_);
}

StaticSolution::Row StaticSolution::row(std::size_t k, std::size_t i, bool phase) const noexcept {
  const std::size_t m = at(k, i);
  Row r;
  const auto add = [&r](std::size_t column, double value) {
    r.column[r.count] = column;
    r.value[r.count++] = value;
  };
  for (int j = 0; j < 3; ++j) add(static_cast<std::size_t>(j), -direction_[m][j]);
  add(3, mapping_[m]);
  add(error_column(i), 1.0);
  add(error_column(i) + 1, t_[k] - middle_s_);
  if (phase) add(arc_column(fix_.arc[m]), 1.0);
  r.y = phase ? fix_.phase_m[m] - predicted_[m] - fix_.phase_correction_m[m]
              : fix_.code_m[m] - predicted_[m] - fix_.code_correction_m[m];
  const double sigma = (phase ? options_.phase_sigma_m : options_.code_sigma_m) * sigma_factor_[m];
  r.weight = 1.0 / (sigma * sigma * (phase ? lasting_ : 1.0));
  return r;
}

// A' W A with every epoch's clock eliminated: u = A' W 1 of the epoch, N -= u u' / (1' W 1).
bool StaticSolution::normal_equations() {
  const std::size_t size = arc_column(arcs_);
  normal_.reset(size);
  right_.assign(static_cast<std::size_t>(size), 0.0);
  std::vector<double> u(right_.size());
  std::vector<Row> rows;
  for (std::size_t k = 0; k < n_; ++k) {
    rows.clear();
    for (std::size_t i = 0; i < s_; ++i) {
      const std::size_t m = at(k, i);
      if (phase_used(m)) rows.push_back(row(k, i, true));
      if (code_used(m)) rows.push_back(row(k, i, false));
    }
    if (rows.size() < 2) continue;
    std::fill(u.begin(), u.end(), 0.0);
    double weights = 0.0, sum = 0.0;
    active_.clear();
    for (const Row& r : rows) {
      weights += r.weight;
      sum += r.weight * r.y;
      for (int a = 0; a < r.count; ++a) {
        if (u[r.column[a]] == 0.0) active_.push_back(r.column[a]);
        u[r.column[a]] += r.weight * r.value[a];
        right_[r.column[a]] += r.weight * r.value[a] * r.y;
        for (int b = 0; b < r.count; ++b) {
          if (r.column[b] <= r.column[a]) normal_.at(r.column[a], r.column[b]) += r.weight * r.value[a] * r.value[b];
        }
      }
    }
    std::sort(active_.begin(), active_.end());
    active_.erase(std::unique(active_.begin(), active_.end()), active_.end());
    for (const std::size_t a : active_) {
      right_[a] -= u[a] * sum / weights;
      for (const std::size_t b : active_) {
        if (b <= a) normal_.at(a, b) -= u[a] * u[b] / weights;
      }
    }
  }
  const auto prior = [this](std::size_t column, double sigma) { normal_.at(column, column) += 1.0 / (sigma * sigma); };
  prior(3, std::max(options_.zenith_sigma_m, 1e-6));
  for (std::size_t i = 0; i < s_; ++i) {
    prior(error_column(i), options_.range_error_sigma_m);
    prior(error_column(i) + 1, options_.range_error_rate_mps);
  }
  // Arcs are never better known than this; it keeps one that is all rejected from opening the system.
  for (int a = 0; a < arcs_; ++a) prior(arc_column(a), 1e6);
  if (!normal_.factor()) return false;
  // Directions that the satellites leave open show as metres by the thousand.
  const auto block = normal_.covariance(3);
  for (std::size_t j = 0; j < 3; ++j) {
    if (!(block[j][j] < 1e8)) return false;
  }
  theta_ = normal_.solve(right_);
  return std::all_of(theta_.begin(), theta_.end(), [](double v) { return std::isfinite(v); });
}

// Residuals and each epoch's clock; true when something new was thrown out.
bool StaticSolution::reject() {
  bool changed = false;
  double phase_sum = 0.0, code_sum = 0.0;
  fix_.phases = fix_.codes = 0;
  for (std::size_t k = 0; k < n_; ++k) {
    double weights = 0.0, sum = 0.0;
    const auto rest = [this](const Row& r) {
      double y = r.y;
      for (int a = 0; a < r.count; ++a) y -= r.value[a] * theta_[r.column[a]];
      return y;
    };
    for (std::size_t i = 0; i < s_; ++i) {
      const std::size_t m = at(k, i);
      for (const bool phase : {true, false}) {
        if (!(phase ? phase_used(m) : code_used(m))) continue;
        const Row r = row(k, i, phase);
        const double weight = r.weight * (phase ? lasting_ : 1.0);  // between epochs the phase is as good as its noise
        weights += weight;
        sum += weight * rest(r);
      }
    }
    if (!(weights > 0.0)) {
      fix_.clock_m[k] = kNan;
      continue;
    }
    const double clock = sum / weights;
    fix_.clock_m[k] = clock;
    for (std::size_t i = 0; i < s_; ++i) {
      const std::size_t m = at(k, i);
      for (const bool phase : {true, false}) {
        auto& residuals = phase ? fix_.phase_residual_m : fix_.code_residual_m;
        residuals[m] = kNan;
        if (!(phase ? phase_used(m) : code_used(m))) continue;
        const Row r = row(k, i, phase);
        const double v = rest(r) - clock;
        residuals[m] = v;
        if (v * v * r.weight * (phase ? lasting_ : 1.0) > kOutlierSigmas * kOutlierSigmas) {
          changed = true;
          ++fix_.rejected;
          if (phase) {
            fix_.use[m] = static_cast<std::uint8_t>(PhaseUse::kRejected);
          } else {
            code_ok_[m] = 0;
          }
          continue;
        }
        (phase ? phase_sum : code_sum) += v * v;
        ++(phase ? fix_.phases : fix_.codes);
      }
    }
  }
  fix_.phase_rms_m = fix_.phases > 0 ? std::sqrt(phase_sum / static_cast<double>(fix_.phases)) : kNan;
  fix_.code_rms_m = fix_.codes > 0 ? std::sqrt(code_sum / static_cast<double>(fix_.codes)) : kNan;
  return changed;
}

void StaticSolution::covariances() {
  const std::size_t size = arc_column(arcs_);
  const auto all = normal_.covariance(size);
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) {
      fix_.covariance_m2(static_cast<int>(i), static_cast<int>(j)) = 0.5 * (all[i][j] + all[j][i]);
    }
  }
  fix_.zenith_m = theta_[3];
  fix_.zenith_sigma_m = std::sqrt(all[3][3]);
  fix_.range_error_m.assign(s_, kNan);
  fix_.range_error_sigma_m.assign(s_, kNan);
  fix_.range_error_rate_mps.assign(s_, kNan);
  for (std::size_t i = 0; i < s_; ++i) {
    bool any = false;
    for (std::size_t k = 0; k < n_ && !any; ++k) any = phase_used(at(k, i)) || code_used(at(k, i));
    if (!any) continue;
    const std::size_t c = error_column(i);
    fix_.range_error_m[i] = theta_[c];
    fix_.range_error_rate_mps[i] = theta_[c + 1];
    fix_.range_error_sigma_m[i] = std::sqrt(all[c][c]);
  }
  std::vector<double> u(size);
  for (std::size_t k = 0; k < n_; ++k) {
    if (!std::isfinite(fix_.clock_m[k])) continue;
    std::fill(u.begin(), u.end(), 0.0);
    active_.clear();
    double weights = 0.0;
    for (std::size_t i = 0; i < s_; ++i) {
      for (const bool phase : {true, false}) {
        if (!(phase ? phase_used(at(k, i)) : code_used(at(k, i)))) continue;
        const Row r = row(k, i, phase);
        const double weight = r.weight * (phase ? lasting_ : 1.0);
        weights += weight;
        for (int a = 0; a < r.count; ++a) {
          u[r.column[a]] += weight * r.value[a];
          active_.push_back(r.column[a]);
        }
      }
    }
    std::sort(active_.begin(), active_.end());
    active_.erase(std::unique(active_.begin(), active_.end()), active_.end());
    double variance = 0.0;
    for (const std::size_t a : active_) {
      for (const std::size_t b : active_) variance += u[a] * all[a][b] * u[b];
    }
    fix_.clock_sigma_m[k] = std::sqrt(1.0 / weights + variance / (weights * weights));
  }
  for (std::size_t m = 0; m < mapping_.size(); ++m) {
    const double extra = mapping_[m] * fix_.zenith_m;
    fix_.phase_correction_m[m] += extra;
    fix_.code_correction_m[m] += extra;
  }
  // The same without the satellites' errors: what the noise alone leaves.
  for (std::size_t i = 0; i < s_; ++i) {
    normal_.fix(error_column(i));
    normal_.fix(error_column(i) + 1);
  }
  if (!normal_.factor()) return;
  const auto formal = normal_.covariance(3);
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) fix_.formal_m2(static_cast<int>(i), static_cast<int>(j)) = formal[i][j];
  }
}

StaticPhaseFix StaticSolution::solve() {
  combine();
  if (n_ == 0 || s_ == 0 || !start()) {
    fix_.status = StaticPhaseStatus::kTooFewSatellites;
    return std::move(fix_);
  }
  model();
  find_arcs();
  if (arcs_ == 0 || static_cast<std::size_t>(arcs_) > kMaxPhaseArcs) {
    fix_.status = arcs_ == 0 ? StaticPhaseStatus::kTooShort : StaticPhaseStatus::kTooManyArcs;
    return std::move(fix_);
  }
  for (int pass = 0;; ++pass) {
    if (!normal_equations()) {
      fix_.status = StaticPhaseStatus::kRankDeficient;
      return std::move(fix_);
    }
    const bool changed = reject();
    const Eigen::Vector3d moved = Eigen::Vector3d(theta_[0], theta_[1], theta_[2]);
    if (pass >= kPasses || (!changed && moved.norm() < 1e-5)) break;
    p_ += moved;
    model();
  }
  fix_.status = StaticPhaseStatus::kSolved;
  fix_.position_e = p_ + Eigen::Vector3d(theta_[0], theta_[1], theta_[2]);
  covariances();
  return std::move(fix_);
}

}  // namespace

StaticPhaseFix solve_static_phase(const EphemerisTable& ephemerides, const std::optional<Klobuchar>& klobuchar,
                                  const PhaseTable& table, const StaticPhaseOptions& options) {
  options.check();
  if (klobuchar) klobuchar->check();
  const std::size_t n = table.time_of_week_s.size(), s = table.prn.size();
  if (s > kMaxPhaseSatellites)
    throw std::invalid_argument("satellites = " + std::to_string(s) + ": at most 32 expected");
  phase_size("week", table.week.size(), n);
  phase_size("code1_m", table.code1_m.size(), n * s);
  phase_size("phase1_cycles", table.phase1_cycles.size(), n * s);
  if (options.dual) {
    phase_size("code2_m", table.code2_m.size(), n * s);
    phase_size("phase2_cycles", table.phase2_cycles.size(), n * s);
  }
  if (!table.lost_lock.empty()) phase_size("lost_lock", table.lost_lock.size(), n * s);
  for (std::size_t k = 0; k < n; ++k) {
    const double t = table.time_of_week_s[k], w = table.week[k];
    if (!std::isfinite(t) || !(w >= 0.0 && w < 1e6) || w != std::floor(w)) {
      throw std::invalid_argument("time_of_week_s, week: row " + std::to_string(k) +
                                  " is no GPS time (whole weeks, finite seconds)");
    }
    if (k > 0 && !((w - table.week[k - 1]) * kWeekS + t - table.time_of_week_s[k - 1] > 0.0)) {
      throw std::invalid_argument("time_of_week_s: row " + std::to_string(k) + " is not after the row before");
    }
  }
  return StaticSolution(ephemerides, klobuchar, table, options).solve();
}

}  // namespace soopnav::gnss
