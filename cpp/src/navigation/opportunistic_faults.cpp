#include <algorithm>
#include <cmath>

#include "navigation/opportunistic_state.hpp"

// Which fault explains a step's innovations, and its remedy (doc/opportunistic_navigation.md section 3).
namespace soopnav::navigation {

namespace {

// What jumped is opened by so many standard deviations of the jump's own estimate: the data decide anew, and having
// been used to find the jump they count 1 / 30² too much.
constexpr double kOpening = 30.0;
// How much better than a single slip a jump of a clock has to explain an epoch, for slips are far more common.
constexpr double kJumpCost = 10.0;
constexpr double kPivot = 1e-13;  // of the innovations' covariance: below it the epoch is not tested

}  // namespace

// Covariance, whitening and w of the rows that are tested. False when they cannot be.
bool OpportunisticNavigator::Impl::test(OpportunisticReport& report, bool first) noexcept {
  tested.clear();
  used_touched.clear();
  used_variance.clear();
  report.nis = 0.0;
  report.dof = 0;
  for (std::size_t i = 0; i < rows.size(); ++i) {
    if (!rows[i].tested) continue;
    tested.push_back(i);
    used_touched.push_back(touched[i]);
    used_variance.push_back(variance[i]);
  }
  const int m = static_cast<int>(tested.size());
  if (m == 0) return false;
  const auto stride = static_cast<std::size_t>(S_stride);
  filter.innovation_covariance(used_touched, used_variance, S.data(), S_stride);
  if (first) {
    for (int i = 0; i < m; ++i) {
      const auto k = static_cast<std::size_t>(i);
      reports[rows[tested[k]].report].sigma = std::sqrt(S.data()[k * stride + k]);
    }
  }
  if (!detail::factorize_lower(S.data(), m, S_stride, kPivot, true)) return false;
  double* y = whitened.data();
  for (int i = 0; i < m; ++i) y[i] = innovation[tested[static_cast<std::size_t>(i)]];
  detail::solve_lower(S.data(), m, S_stride, y);
  for (int i = 0; i < m; ++i) report.nis += y[i] * y[i];
  report.dof = m;
  // Columns of L⁻¹: what one unit of each observable does to the whitened innovations.
  for (int j = 0; j < m; ++j) {
    double* column = inverse.data() + static_cast<std::size_t>(j) * stride;
    std::fill_n(column, m, 0.0);
    column[j] = 1.0;
    detail::solve_lower(S.data(), m, S_stride, column, j);
  }
  return true;
}

void OpportunisticNavigator::Impl::judge(double dt_s, OpportunisticReport& report) noexcept {
  const auto stride = static_cast<std::size_t>(S_stride);
  const double* y = whitened.data();
  double* g = whitened.data() + S_stride;
  // Signature f of a fault in the tested rows, whitened: its size f' S^-1 nu / f' S^-1 f and how much it explains.
  struct Fault {
    double size = 0.0, information = 0.0, explains = -1.0;
  };
  const auto measure = [&](int m) {
    double gy = 0.0;
    double gg = 0.0;
    for (int i = 0; i < m; ++i) {
      gy += g[i] * y[i];
      gg += g[i] * g[i];
    }
    return gg > 0.0 ? Fault{gy / gg, gg, gy * gy / gg} : Fault{};
  };
  const std::size_t most = 2 * rows.size() + 2;
  bool receiver_open = true;
  for (std::size_t pass = 0; pass < most; ++pass) {
    if (!test(report, pass == 0)) return;
    const int m = static_cast<int>(tested.size());
    enum class What { kNone, kRow, kSource, kReceiver } what = What::kNone;
    Fault best;
    int which = -1;
    double score = threshold;
    for (int j = 0; j < m; ++j) {
      const double* column = inverse.data() + static_cast<std::size_t>(j) * stride;
      double gy = 0.0;
      double gg = 0.0;
      for (int i = j; i < m; ++i) {
        gy += column[i] * y[i];
        gg += column[i] * column[i];
      }
      const Fault fault{gy / gg, gg, gy * gy / gg};
      const std::size_t row = tested[static_cast<std::size_t>(j)];
      if (pass == 0) reports[rows[row].report].w = gy / std::sqrt(gg);
      if (fault.explains > score) {
        score = fault.explains;
        best = fault;
        what = What::kRow;
        which = static_cast<int>(row);
      }
    }
    if (what == What::kNone && report.nis < threshold + kJumpCost) return;
    // A clock shows in several rows: of its source, or of all.
    const auto clock_fault = [&](int slot_number) {
      std::fill_n(g, m, 0.0);
      int count = 0;
      int first_slot = -1;
      bool several = false;
      for (int j = 0; j < m; ++j) {
        const std::size_t row = tested[static_cast<std::size_t>(j)];
        if (slot_number >= 0 && rows[row].slot != slot_number) continue;
        const int at =
            slot_number < 0 ? bias_at : layout.offset(slots[static_cast<std::size_t>(slot_number)].clock) + 1;
        const double f = touched[row].at(at);
        if (f == 0.0) continue;
        const double* column = inverse.data() + static_cast<std::size_t>(j) * stride;
        for (int i = j; i < m; ++i) g[i] += f * column[i];
        ++count;
        several = several || (first_slot >= 0 && first_slot != rows[row].slot);
        first_slot = rows[row].slot;
      }
      const bool apart = slot_number < 0 ? several : count > 1;
      return apart ? measure(m) : Fault{};
    };
    for (const int s : order) {
      if (!layout.holds(slots[static_cast<std::size_t>(s)].clock) || slots[static_cast<std::size_t>(s)].jumped)
        continue;
      const Fault fault = clock_fault(s);
      if (fault.explains - kJumpCost > score) {
        score = fault.explains - kJumpCost;
        best = fault;
        what = What::kSource;
        which = s;
      }
    }
    if (receiver_open) {
      const Fault fault = clock_fault(-1);
      if (fault.explains - kJumpCost > score) {
        score = fault.explains - kJumpCost;
        best = fault;
        what = What::kReceiver;
      }
    }
    if (what == What::kNone) return;

    const double opening = kOpening * kOpening / best.information;
    int place = -1;
    if (what == What::kRow) {
      detail::Row& row = rows[static_cast<std::size_t>(which)];
      detail::Slot& slot = slots[static_cast<std::size_t>(row.slot)];
      slot.contradicted = true;
      row.tested = false;
      if (row.kind == ObservableKind::kPhase && layout.holds(slot.ambiguity)) {
        place = layout.offset(slot.ambiguity);
        reports[row.report].use = ObservableUse::kSlip;
        ++report.slips;
        ++slot.slips;
        ++slot.serial;
        open(place, opening, best.size);
      } else {
        reports[row.report].use = ObservableUse::kGated;
      }
    } else {
      // A drift that jumped shows as a jump of the bias again in the next epoch.
      bool again = receiver_jumped;
      int drift = drift_at;
      if (what == What::kSource) {
        detail::Slot& slot = slots[static_cast<std::size_t>(which)];
        again = slot.jumped_before;
        drift = layout.offset(slot.clock);
        slot.contradicted = slot.jumped = true;
        ++slot.jumps;
        ++slot.serial;
        ++report.source_jumps;
      } else {
        receiver_open = false;
        report.receiver_jump = true;
      }
      place = drift + 1;
      open(place, opening, best.size);
      if (again && dt_s > 0.0) open(drift, best.size * best.size / (dt_s * dt_s), 0.0);
    }
    if (place >= 0) {
      for (std::size_t i = 0; i < rows.size(); ++i) innovation[i] -= touched[i].at(place) * best.size;
    }
  }
}

// A receiver's counter starts anywhere: a first phase beyond the prior of its ambiguity says that the prior was wrong,
// not that all else was. The whole of it goes to the ambiguity, and the others stay where they are.
void OpportunisticNavigator::Impl::judge_fresh(OpportunisticReport& report) noexcept {
  for (std::size_t i = 0; i < rows.size(); ++i) {
    detail::Row& row = rows[i];
    detail::Slot& slot = slots[static_cast<std::size_t>(row.slot)];
    if (row.kind != ObservableKind::kPhase || !slot.fresh || !layout.holds(slot.ambiguity)) continue;
    filter.innovation_covariance({&touched[i], 1}, {&variance[i], 1}, S.data(), S_stride);
    const double s = S.data()[0];
    reports[row.report].sigma = std::sqrt(s);
    const double size = innovation[i];
    if (!(size * size > threshold * s)) continue;
    const int place = layout.offset(slot.ambiguity);
    reports[row.report].use = ObservableUse::kSlip;
    ++report.slips;
    ++slot.slips;
    open(place, kOpening * kOpening * s, size);
    for (std::size_t j = 0; j < rows.size(); ++j) innovation[j] -= touched[j].at(place) * size;
  }
}

}  // namespace soopnav::navigation
