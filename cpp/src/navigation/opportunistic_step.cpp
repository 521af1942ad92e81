#include <algorithm>
#include <cmath>

#include "navigation/opportunistic_state.hpp"

// One step of an OpportunisticNavigator: prediction, models, faults, update (doc/opportunistic_navigation.md).
namespace soopnav::navigation {

namespace {

using detail::Slot;
using detail::TouchedRow;

constexpr double kLight = kSpeedOfLightMps;
constexpr int kIterations = 6;
constexpr double kNonlinear = 0.05;
constexpr double kNearM = 1e-6;  // coincident points
// Further from its prediction an observable has no digits left, and the filter's squares would overflow before long.
constexpr double kFarthest = 1e15;    // [cycles or m]
constexpr double kLongestStep = 1e9;  // [s]

// The way from a source at rest, estimated or given: rho = |R(w rho / c) q - p|, with its exact derivatives.
struct Way {
  double range = 0.0;
  Eigen::Vector3d to_p = Eigen::Vector3d::Zero();  // d range / d p
  Eigen::Vector3d to_q = Eigen::Vector3d::Zero();  // d range / d q
  double to_time = 0.0;                            // d range / d t
};

bool way_from_rest(const Eigen::Vector3d& q, const Eigen::Vector3d& p, Way& way) noexcept {
  double range = (q - p).norm();
  Eigen::Vector3d turned = q;
  double angle = 0.0;
  for (int i = 0; i < 4; ++i) {
    angle = wgs84::kEarthRateRadps * range / kLight;
    const double c = std::cos(angle);
    const double s = std::sin(angle);
    turned = {c * q.x() + s * q.y(), c * q.y() - s * q.x(), q.z()};
    const double next = (turned - p).norm();
    const bool done = std::abs(next - range) <= 1e-9;
    range = next;
    if (done) break;
  }
  if (!(range > kNearM) || !std::isfinite(range)) return false;
  const Eigen::Vector3d u = (turned - p) / range;
  // d rho = u . (R dq + (dR/drho q) drho - dp)
  const double turn = (u.x() * turned.y() - u.y() * turned.x()) * wgs84::kEarthRateRadps / kLight;
  const double scale = 1.0 / (1.0 - turn);
  const double c = std::cos(angle);
  const double s = std::sin(angle);
  way.range = range;
  way.to_p = -scale * u;
  way.to_q = scale * Eigen::Vector3d(c * u.x() - s * u.y(), s * u.x() + c * u.y(), u.z());
  way.to_time = 0.0;
  return true;
}

}  // namespace

void OpportunisticNavigator::Impl::ask(int place, double noise) noexcept {
  const int uid = members[static_cast<std::size_t>(place)].uid;
  for (auto& p : pending) {
    if (p.place == uid) {
      p.variance += noise;
      return;
    }
  }
  if (pending.size() ==
      pending.capacity()) {  // there is room for what is present: the rest is of sources that have left
    std::erase_if(pending, [this](const detail::PlaceNoise& p) {
      return std::none_of(members.begin(), members.end(), [&p](const detail::Member& m) { return m.uid == p.place; });
    });
  }
  pending.push_back({uid, noise, 0.0});
}

void OpportunisticNavigator::Impl::open(int place, double noise, double shift) noexcept {
  filter.x()[place] += shift;
  filter.add_noise(place, noise);
  if (noises.size() < noises.capacity()) noises.push_back({place, noise, shift});
}

void OpportunisticNavigator::Impl::predict(double dt_s) noexcept {
  pairs.clear();
  noises.clear();
  const auto pair = [&](int from, int to, double white, double walk) {
    pairs.push_back({from, to, walk * dt_s, 0.5 * walk * dt_s * dt_s, white * dt_s + walk * dt_s * dt_s * dt_s / 3.0});
  };
  const auto walk = [&](int place, double density) {
    if (density > 0.0) noises.push_back({place, density * dt_s, 0.0});
  };
  for (int i = 0; i < 3 && velocity_at >= 0; ++i) {
    pair(velocity_at + i, position_at + i, 0.0, options.acceleration_psd_m2ps3);
  }
  for (int i = 0; i < 3 && velocity_at < 0 && position_at >= 0; ++i) walk(position_at + i, options.position_walk_m2ps);
  pair(drift_at, bias_at, options.clock.white_frequency_m2ps, options.clock.frequency_walk_m2ps3);
  for (const int s : order) {
    const Slot& slot = slots[static_cast<std::size_t>(s)];
    if (layout.holds(slot.position)) {
      for (int i = 0; i < 3; ++i) walk(layout.offset(slot.position) + i, slot.given.position_walk_m2ps);
    }
    if (layout.holds(slot.clock)) {
      const int at = layout.offset(slot.clock);
      pair(at, at + 1, slot.given.clock_noise.white_frequency_m2ps, slot.given.clock_noise.frequency_walk_m2ps3);
    }
    if (layout.holds(slot.ambiguity)) walk(layout.offset(slot.ambiguity), slot.given.ambiguity_walk_cycles2ps);
  }
  for (const auto& p : pairs) {
    filter.move(p.to, p.from, dt_s);
    if (p.value > 0.0) filter.add_noise(p.from, p.to, p.rate, p.cross, p.value);
  }
  for (const auto& n : noises) filter.add_noise(n.place, n.variance);
}

// What an observable should be at the present state, and the row of its Jacobian. False where there is no value.
bool OpportunisticNavigator::Impl::model(const OpportunisticObservation& o, const Slot& slot, double at_s,
                                         TouchedRow& row, double& predicted) const noexcept {
  const double* x = filter.x();
  const Eigen::Vector3d p =
      position_at < 0 ? known_position : Eigen::Vector3d(Eigen::Map<const Eigen::Vector3d>(x + position_at));
  const double bias = x[bias_at];
  const bool by_receiver = options.time_tag == TimeTag::kReceiver;
  const double received_s = by_receiver ? at_s - bias / kLight : at_s;

  Way way;
  if (slot.given.orbit) {
    geometry::SignalPath path;
    geometry::PathGradient gradient;
    if (!geometry::signal_path(*slot.given.orbit, received_s, p, Eigen::Vector3d::Zero(), path, gradient)) return false;
    way.range = path.range_m;
    way.to_p = kLight * gradient.delay_p;
    way.to_time = kLight * path.delay_rate;
  } else if (slot.has_rest) {
    if (!way_from_rest(slot.rest.samples().front().p_e, p, way)) return false;
  } else if (layout.holds(slot.position)) {
    if (!way_from_rest(Eigen::Map<const Eigen::Vector3d>(x + layout.offset(slot.position)), p, way)) return false;
  } else {
    const Eigen::Vector3d line = p - o.source_position_e_m;
    way.range = line.norm();
    if (!(way.range > kNearM) || !std::isfinite(way.range)) return false;
    way.to_p = line / way.range;
  }

  // The source's clock at transmission: its state is of at_s.
  const double lag_s = (by_receiver ? bias / kLight : 0.0) + way.range / kLight;
  double source_clock = 0.0;
  const bool estimates_clock = layout.holds(slot.clock) && std::isnan(o.source_clock_m);
  if (estimates_clock) {
    const int at = layout.offset(slot.clock);
    source_clock = x[at + 1] - lag_s * x[at];
  } else if (!std::isnan(o.source_clock_m)) {
    source_clock = o.source_clock_m;
  } else {
    source_clock = slot.given.clock_bias_m + slot.given.clock_drift_mps * (at_s - lag_s - slot.given.clock_epoch_s);
  }
  const bool phase = o.kind == ObservableKind::kPhase;
  const double scale = phase ? 1.0 / slot.wavelength_m : 1.0;
  predicted = scale * (way.range + bias - source_clock + o.correction_m);
  row.count = 0;
  for (int i = 0; i < 3 && position_at >= 0; ++i) row.add(position_at + i, scale * way.to_p[i]);
  row.add(bias_at, scale * (1.0 - (by_receiver ? way.to_time / kLight : 0.0)));
  if (layout.holds(slot.position)) {
    for (int i = 0; i < 3; ++i) row.add(layout.offset(slot.position) + i, scale * way.to_q[i]);
  }
  if (estimates_clock) {
    const int at = layout.offset(slot.clock);
    row.add(at, scale * lag_s);
    row.add(at + 1, -scale);
  }
  if (phase) {
    if (layout.holds(slot.ambiguity)) {
      const int at = layout.offset(slot.ambiguity);
      predicted += x[at];
      row.add(at, 1.0);
    } else {
      predicted += slot.given.ambiguity_cycles;
    }
  }
  return std::isfinite(predicted);
}

// Mean square of what the model bends within the prediction's uncertainty, (2 tr((D P)²) + tr(D P)²) / 4 with the
// second derivative D = (I - u u') / range by the relative position (the second-order filter of Bar-Shalom, Li and
// Kirubarajan 2001, section 10.3.2, its mean left in the noise): metres beside a phase's millimetre as long as a mast
// or the receiver is known to metres.
double OpportunisticNavigator::Impl::bend(const Slot& slot, const TouchedRow& row) const noexcept {
  const int at = layout.holds(slot.position) ? layout.offset(slot.position) : -1;
  Eigen::Vector3d line = known_position;
  Eigen::Matrix3d P = position_P;
  if (position_at >= 0) line = Eigen::Map<const Eigen::Vector3d>(filter.x() + position_at);
  if (at >= 0) {
    line -= Eigen::Map<const Eigen::Vector3d>(filter.x() + at);
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) {
        P(i, j) += filter.covariance(at + i, at + j);
        if (position_at < 0) continue;
        P(i, j) -= filter.covariance(position_at + i, at + j) + filter.covariance(at + i, position_at + j);
      }
    }
  } else if (slot.has_rest) {
    line -= *slot.given.position_e_m;
  } else {
    return 0.0;  // satellites: 1e-5 m at 10 m
  }
  const double range = line.norm();
  if (!(range > kNearM)) return 0.0;
  const Eigen::Vector3d u = line / range;
  const Eigen::Matrix3d across = Eigen::Matrix3d::Identity() - u * u.transpose();
  const Eigen::Matrix3d M = across * P * across;
  const double scale = std::abs(row.at(bias_at));
  const double mean = M.trace();
  return 0.25 * scale * scale * (2.0 * M.squaredNorm() + mean * mean) / (range * range);
}

bool OpportunisticNavigator::Impl::build(const OpportunisticObservation& o, double at_s, std::size_t number,
                                         ObservableReport& report) noexcept {
  const int s = slot_of(o.source);
  if (s < 0) {
    report.use = ObservableUse::kUnknownSource;
    return false;
  }
  const Slot& slot = slots[static_cast<std::size_t>(s)];
  if (!std::isfinite(o.value) || !std::isfinite(o.correction_m) || !(o.sigma > 0.0) || std::isinf(o.sigma)) {
    report.use = ObservableUse::kNonFinite;
    return false;
  }
  if (slot.suspended) {
    report.use = ObservableUse::kSuspended;
    return false;
  }
  TouchedRow row;
  double predicted = 0.0;
  if (!model(o, slot, at_s, row, predicted)) {
    report.use = ObservableUse::kUndefined;
    return false;
  }
  const double nu = o.value - predicted;
  if (!(std::abs(nu) <= kFarthest) || !std::isnormal(o.sigma * o.sigma)) {
    report.use = ObservableUse::kNonFinite;
    return false;
  }
  const bool is_fresh = o.kind == ObservableKind::kPhase && layout.holds(slot.ambiguity) && slot.fresh;
  report.use = ObservableUse::kAccepted;
  report.innovation = nu;
  rows.push_back({number, s, o.kind, !is_fresh});
  touched.push_back(row);
  innovation.push_back(nu);
  variance.push_back(o.sigma * o.sigma + bend(slot, row));
  return true;
}

// Everything that stands, linearised at the (opened) prediction; again at the result while that was too far off.
void OpportunisticNavigator::Impl::use_all(double at_s, std::span<const OpportunisticObservation> observed) noexcept {
  const int n = filter.dim();
  double* x0 = start_x.data();
  double* x1 = start_x.data() + filter.stride();
  filter.save();
  std::copy_n(filter.x(), n, x0);
  const auto stands = [&](std::size_t i) { return reports[rows[i].report].use != ObservableUse::kGated; };
  for (int iteration = 1;; ++iteration) {
    used_touched.clear();
    used_innovation.clear();
    used_variance.clear();
    for (std::size_t i = 0; i < rows.size(); ++i) {
      if (!stands(i)) continue;
      used_touched.push_back(touched[i]);
      used_innovation.push_back(innovation[i]);
      used_variance.push_back(variance[i]);
    }
    used.assign(used_touched.size(), 0);
    filter.update(used_touched, used_innovation, used_variance, used);
    if (iteration == kIterations) return;
    // How far the linear models are off where they led to, in standard deviations of the noise.
    double worst = 0.0;
    bool defined = true;
    std::copy_n(filter.x(), n, x1);
    for (int i = 0; i < n; ++i) x1[i] -= x0[i];
    next_touched.clear();
    next_innovation.clear();
    for (std::size_t i = 0; i < rows.size(); ++i) {
      TouchedRow row;
      double predicted = 0.0;
      const auto& o = observed[rows[i].report];
      defined = defined && model(o, slots[static_cast<std::size_t>(rows[i].slot)], at_s, row, predicted);
      const double again = o.value - predicted + row.dot(x1);
      const double off = (o.value - predicted) - (innovation[i] - touched[i].dot(x1));
      if (stands(i)) worst = std::max(worst, std::abs(off) / std::sqrt(variance[i]));
      next_touched.push_back(row);
      next_innovation.push_back(again);
    }
    if (!defined || !(worst > kNonlinear) || std::isinf(worst)) return;
    filter.restore();
    touched.swap(next_touched);
    innovation.swap(next_innovation);
  }
}

// What a place's correction d leaves wrong between it and a phase's constant: the covariance ties them by directions
// that have turned by d / range since, so that d (d / 2 + what is still uncertain) / range is open again.
void OpportunisticNavigator::Impl::loosen() noexcept {
  const double* x = filter.x();
  const double* x0 = start_x.data();
  for (const int s : order) {
    Slot& slot = slots[static_cast<std::size_t>(s)];
    const bool constant = layout.holds(slot.ambiguity);
    if (!slot.observed || (!constant && !layout.holds(slot.clock))) continue;
    const int at = layout.holds(slot.position) ? layout.offset(slot.position) : -1;
    if (at < 0 && (!slot.has_rest || position_at < 0)) continue;
    Eigen::Vector3d move = Eigen::Vector3d::Zero();
    Eigen::Vector3d line = position_at < 0 ? known_position : Eigen::Vector3d::Zero();
    double uncertain = 0.0;
    for (int i = 0; i < 3; ++i) {
      if (position_at >= 0) {
        move[i] += x[position_at + i] - x0[position_at + i];
        line[i] += x[position_at + i];
        uncertain += filter.covariance(position_at + i, position_at + i);
      }
      if (at >= 0) {
        move[i] -= x[at + i] - x0[at + i];
        uncertain += filter.covariance(at + i, at + i);
        if (position_at >= 0) uncertain -= 2.0 * filter.covariance(position_at + i, at + i);
      }
      line[i] -= at >= 0 ? x[at + i] : (*slot.given.position_e_m)[i];
    }
    const double range = line.norm();
    if (!(range > kNearM)) continue;
    const double across = (move - line * (line.dot(move) / (range * range))).norm();
    const double open_m = across * (0.5 * across + std::sqrt(std::max(uncertain, 0.0))) / range;
    if (open_m < 1e-5 * slot.wavelength_m) continue;
    const double sigma = constant ? open_m / slot.wavelength_m : open_m;
    ask(constant ? layout.offset(slot.ambiguity) : layout.offset(slot.clock) + 1, sigma * sigma);
  }
}

void OpportunisticNavigator::Impl::remember(double at_s) noexcept {
  past_head = (past_head + 1) % detail::kObservedEpochs;
  past_epochs = std::min(past_epochs + 1, detail::kObservedEpochs);
  const auto head = static_cast<std::size_t>(past_head);
  past_t[head] = at_s;
  past_count[head] = 0;
  for (std::size_t i = 0; i < rows.size(); ++i) {
    if (used[i] == 0) continue;
    detail::PastRow& past_row = past[head * max_rows() + static_cast<std::size_t>(past_count[head]++)];
    const TouchedRow& row = touched[i];
    const Slot& slot = slots[static_cast<std::size_t>(rows[i].slot)];
    const double scale = 1.0 / std::sqrt(variance[i]);
    past_row.count = row.count;
    past_row.source = slot.id;
    past_row.serial = slot.serial;
    for (int c = 0; c < row.count; ++c) {
      const auto k = static_cast<std::size_t>(c);
      past_row.uid[k] = members[static_cast<std::size_t>(row.index[k])].uid;
      past_row.value[k] = scale * row.value[k];
    }
  }
}

OpportunisticReport OpportunisticNavigator::Impl::step(double at_s,
                                                       std::span<const OpportunisticObservation> observed) noexcept {
  OpportunisticReport out;
  const bool first = std::isnan(t_s);
  const double dt_s = first ? 0.0 : at_s - t_s;
  reported = std::min(observed.size(), max_rows());
  for (std::size_t i = 0; i < reported; ++i) reports[i] = {};
  if (!std::isfinite(at_s) || dt_s > kLongestStep) {
    out.status = UpdateStatus::kNonFinite;
  } else if (!first && !(dt_s > 0.0)) {
    out.status = UpdateStatus::kTimeNotAdvancing;
  }
  if (out.status != UpdateStatus::kAccepted) {
    out.rejected = static_cast<int>(observed.size());
    return out;
  }
  const bool recording = recorder.active() && recorder.begin(at_s, dt_s, members);
  pairs.clear();
  noises.clear();
  if (!first) predict(dt_s);
  for (const auto& p : pending) {
    for (std::size_t place = 0; place < members.size(); ++place) {
      if (members[place].uid == p.place && p.variance > 0.0) open(static_cast<int>(place), p.variance, 0.0);
    }
  }
  pending.clear();
  t_s = at_s;

  for (int i = 0; i < 3 && position_at >= 0; ++i) {
    for (int j = 0; j < 3; ++j) position_P(i, j) = filter.covariance(position_at + i, position_at + j);
  }
  rows.clear();
  touched.clear();
  innovation.clear();
  variance.clear();
  for (const int s : order) {
    Slot& slot = slots[static_cast<std::size_t>(s)];
    slot.jumped_before = slot.jumped;
    slot.jumped = slot.contradicted = slot.observed = false;
  }
  for (std::size_t i = 0; i < observed.size(); ++i) {
    if (i >= reported) {
      ++out.rejected;  // more than there is room for
      continue;
    }
    if (build(observed[i], at_s, i, reports[i])) {
      slots[static_cast<std::size_t>(rows.back().slot)].observed = true;
    } else {
      ++out.rejected;
    }
  }
  judge(dt_s, out);
  judge_fresh(out);
  receiver_jumped = out.receiver_jump;
  if (out.receiver_jump) past_epochs = 0;
  if (recording) recorder.predicted(filter, pairs, noises);

  use_all(at_s, observed);
  if (recording) recorder.filtered(filter);

  loosen();

  // What came of each.
  std::size_t k = 0;
  for (std::size_t i = 0; i < rows.size(); ++i) {
    ObservableReport& report = reports[rows[i].report];
    Slot& slot = slots[static_cast<std::size_t>(rows[i].slot)];
    if (report.use == ObservableUse::kGated) {
      ++out.rejected;
      continue;
    }
    if (used[k++] == 0) {
      report.use = ObservableUse::kNotPositiveDefinite;
      ++out.rejected;
      continue;
    }
    ++out.accepted;
    if (rows[i].kind == ObservableKind::kPhase) slot.fresh = false;
  }
  used.resize(rows.size());
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const ObservableUse use = reports[rows[i].report].use;
    used[i] = use == ObservableUse::kAccepted || use == ObservableUse::kSlip;
  }
  remember(at_s);
  for (const int s : order) {
    Slot& slot = slots[static_cast<std::size_t>(s)];
    if (!slot.observed) continue;
    slot.slip_rate += ((slot.contradicted ? 1.0 : 0.0) - slot.slip_rate) / options.suspend_memory;
    if (slot.contradicted && slot.slip_rate > options.suspend_share) slot.suspended = true;
  }
  return out;
}

}  // namespace soopnav::navigation
