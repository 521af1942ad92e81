#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>
#include <string>
#include <string_view>

#include "navigation/opportunistic_state.hpp"
#include "soopnav/estimation/detail/symmetric_eigen.hpp"
#include "soopnav/estimation/unobservable.hpp"

// Batches, and what a batch does not show (doc/opportunistic_navigation.md section 6).
namespace soopnav::navigation {

namespace {

void require_cells(std::size_t size, std::size_t expected, bool optional_size, const char* name) {
  if (size == expected || (optional_size && size == 0)) return;
  throw std::invalid_argument(std::string(name) + ": " + std::to_string(size) + " numbers; " +
                              std::to_string(expected) + " expected");
}

void require_sigmas(std::span<const double> sigma, std::size_t cells, std::size_t columns, bool needed,
                    const char* name) {
  if (!needed && sigma.empty()) return;
  if (sigma.size() == columns) return;
  require_cells(sigma.size(), cells, false, name);
}

}  // namespace

OpportunisticRun OpportunisticNavigator::run(const OpportunisticBatch& in, bool record) {
  Impl& me = *impl_;
  const std::size_t n = in.t_s.size();
  const std::size_t s = in.sources.size();
  const std::size_t cells = n * s;
  require_cells(in.phase_cycles.size(), cells, true, "phase_cycles");
  require_cells(in.pseudorange_m.size(), cells, true, "pseudorange_m");
  require_sigmas(in.phase_sigma_cycles, cells, s, !in.phase_cycles.empty(), "phase_sigma_cycles");
  require_sigmas(in.pseudorange_sigma_m, cells, s, !in.pseudorange_m.empty(), "pseudorange_sigma_m");
  require_cells(in.phase_correction_m.size(), cells, true, "phase_correction_m");
  require_cells(in.range_correction_m.size(), cells, true, "range_correction_m");
  require_cells(in.source_position_e_m.size(), 3 * cells, true, "source_position_e_m");
  require_cells(in.source_clock_m.size(), cells, true, "source_clock_m");
  for (const int id : in.sources) {
    if (me.slot_of(id) < 0) throw std::invalid_argument("sources: " + std::to_string(id) + " is not present");
  }
  if (record && !me.recorder.active() && n > 0) start_recording(static_cast<int>(n));

  OpportunisticRun out;
  out.dim = dim();
  const std::size_t d = static_cast<std::size_t>(out.dim);
  out.mean.resize(n * d);
  out.sigma.resize(n * d);
  if (in.covariance) out.covariance.resize(n * d * d);
  const auto missing = static_cast<std::uint8_t>(ObservableUse::kMissing);
  out.phase_use.assign(cells, missing);
  out.pseudorange_use.assign(cells, missing);
  out.phase_innovation_cycles.assign(cells, std::numeric_limits<double>::quiet_NaN());
  out.pseudorange_innovation_m = out.phase_innovation_cycles;
  out.nis.resize(n);
  out.dof.resize(n);
  out.receiver_jump.resize(n);
  out.status.resize(n);

  const auto sigma_at = [&](std::span<const double> sigma, std::size_t cell, std::size_t column) {
    return sigma.size() == s ? sigma[column] : sigma[cell];
  };
  me.batch.reserve(2 * s);
  for (std::size_t k = 0; k < n; ++k) {
    me.batch.clear();
    for (const ObservableKind kind : {ObservableKind::kPhase, ObservableKind::kPseudorange}) {
      const bool phase = kind == ObservableKind::kPhase;
      const auto values = phase ? in.phase_cycles : in.pseudorange_m;
      if (values.empty()) continue;
      const auto corrections = phase ? in.phase_correction_m : in.range_correction_m;
      for (std::size_t j = 0; j < s; ++j) {
        const std::size_t cell = k * s + j;
        if (std::isnan(values[cell])) continue;
        OpportunisticObservation o;
        o.source = in.sources[j];
        o.kind = kind;
        o.value = values[cell];
        o.sigma = sigma_at(phase ? in.phase_sigma_cycles : in.pseudorange_sigma_m, cell, j);
        if (!corrections.empty()) o.correction_m = corrections[cell];
        if (!in.source_position_e_m.empty()) {
          o.source_position_e_m = Eigen::Map<const Eigen::Vector3d>(in.source_position_e_m.data() + 3 * cell);
        }
        if (!in.source_clock_m.empty()) o.source_clock_m = in.source_clock_m[cell];
        me.batch.push_back(o);
      }
    }
    const OpportunisticReport report = me.step(in.t_s[k], me.batch);
    std::size_t next = 0;
    for (const ObservableKind kind : {ObservableKind::kPhase, ObservableKind::kPseudorange}) {
      const bool phase = kind == ObservableKind::kPhase;
      const auto values = phase ? in.phase_cycles : in.pseudorange_m;
      if (values.empty()) continue;
      for (std::size_t j = 0; j < s; ++j) {
        const std::size_t cell = k * s + j;
        if (std::isnan(values[cell])) continue;
        const bool kept = next < me.reported;
        const auto use = static_cast<std::uint8_t>(kept ? me.reports[next].use : ObservableUse::kTooMany);
        (phase ? out.phase_use : out.pseudorange_use)[cell] = use;
        if (kept) {
          (phase ? out.phase_innovation_cycles : out.pseudorange_innovation_m)[cell] = me.reports[next].innovation;
        }
        ++next;
      }
    }
    out.nis[k] = report.nis;
    out.dof[k] = report.dof;
    out.receiver_jump[k] = report.receiver_jump ? 1 : 0;
    out.status[k] = report.status;
    std::copy_n(me.filter.x(), d, out.mean.data() + k * d);
    for (std::size_t i = 0; i < d; ++i) {
      const int place = static_cast<int>(i);
      out.sigma[k * d + i] = std::sqrt(me.filter.covariance(place, place));
    }
    if (in.covariance) me.filter.covariance(out.covariance.data() + k * d * d);
  }
  return out;
}

std::vector<std::string> OpportunisticNavigator::unobservable(int epochs, double tolerance) const {
  const Impl& me = *impl_;
  const int n = dim();
  const int back = std::min({epochs, me.past_epochs, detail::kObservedEpochs});
  Eigen::MatrixXd J = Eigen::MatrixXd::Zero(n, n);
  Eigen::VectorXd h(n), unit = Eigen::VectorXd::Ones(n);
  const auto place_of = [&](int uid) {
    const auto found =
        std::find_if(me.members.begin(), me.members.end(), [&](const detail::Member& m) { return m.uid == uid; });
    return found == me.members.end() ? -1 : static_cast<int>(found - me.members.begin());
  };
  for (int i = 0; i < n; ++i) {
    const detail::Member& m = me.members[static_cast<std::size_t>(i)];
    if (m.part == 8) unit[i] = 1.0 / me.slots[static_cast<std::size_t>(me.slot_of(m.source))].wavelength_m;
  }
  for (int e = 0; e < back; ++e) {
    const auto at = static_cast<std::size_t>((me.past_head - e + detail::kObservedEpochs) % detail::kObservedEpochs);
    const double age_s = me.t_s - me.past_t[at];
    for (int r = 0; r < me.past_count[at]; ++r) {
      const detail::PastRow& row = me.past[at * me.max_rows() + static_cast<std::size_t>(r)];
      const int s = me.slot_of(row.source);
      if (s < 0 || me.slots[static_cast<std::size_t>(s)].serial != row.serial) continue;
      h.setZero();
      for (int c = 0; c < row.count; ++c) {
        const int place = place_of(row.uid[static_cast<std::size_t>(c)]);
        if (place < 0) continue;
        const double value = row.value[static_cast<std::size_t>(c)];
        h[place] += value;
        // What it was then, by what it is now: less its rate times the age.
        const detail::Member& m = me.members[static_cast<std::size_t>(place)];
        if (m.part == 7) h[place - 1] -= age_s * value;
        if (m.source < 0 && m.part >= 3 && m.part < 6 && me.velocity_at >= 0) {
          h[me.velocity_at + m.part - 3] -= age_s * value;
        }
      }
      h.array() *= unit.array();
      J.noalias() += h * h.transpose();
    }
  }
  // Each component to its own information; what has none is a direction by itself.
  Eigen::VectorXd scale(n);
  for (int i = 0; i < n; ++i) scale[i] = J(i, i) > 0.0 ? 1.0 / std::sqrt(J(i, i)) : 0.0;
  Eigen::MatrixXd scaled = scale.asDiagonal() * J * scale.asDiagonal();
  Eigen::VectorXd values(n);
  Eigen::MatrixXd vectors(n, n);
  soopnav::detail::symmetric_eigen(scaled.data(), n, values.data(), vectors.data());
  const double least = tolerance * std::max(values[n - 1], 0.0);
  std::vector<Eigen::VectorXd> free;
  for (int k = 0; k < n; ++k) {
    if (values[k] > least) continue;
    Eigen::VectorXd v = vectors.col(k);
    for (int i = 0; i < n; ++i) v[i] *= scale[i] > 0.0 ? scale[i] : 1.0;
    v.normalize();
    free.push_back(v);
  }
  // Reduced to echelon form, in metres and metres per second: as few components in each as there can be.
  const int count = static_cast<int>(free.size());
  int done = 0;
  for (int i = 0; i < n && done < count; ++i) {
    int pivot = done;
    for (int k = done; k < count; ++k) {
      if (std::abs(free[static_cast<std::size_t>(k)][i]) > std::abs(free[static_cast<std::size_t>(pivot)][i]))
        pivot = k;
    }
    Eigen::VectorXd& chosen = free[static_cast<std::size_t>(pivot)];
    if (std::abs(chosen[i]) < 1e-6 * chosen.norm()) continue;
    chosen /= chosen[i];
    chosen.swap(free[static_cast<std::size_t>(done)]);
    for (int k = 0; k < count; ++k) {
      Eigen::VectorXd& other = free[static_cast<std::size_t>(k)];
      if (k != done) other -= other[i] * free[static_cast<std::size_t>(done)];
    }
    ++done;
  }
  std::vector<std::string_view> names;
  for (const detail::Member& m : me.members) names.emplace_back(me.names[static_cast<std::size_t>(m.uid)]);
  std::vector<std::string> out;
  for (const Eigen::VectorXd& v : free) {
    if (v.norm() > 0.0) out.push_back(name_directions(v.normalized(), names).front());
  }
  return out;
}

}  // namespace soopnav::navigation
