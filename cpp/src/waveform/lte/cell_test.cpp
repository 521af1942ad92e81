#include "waveform/lte/cell_test.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "soopnav/waveform/lte/sequences.hpp"
#include "waveform/lte/frame_layout.hpp"
#include "waveform/lte/kernels.hpp"

namespace soopnav::lte {

namespace {
using kernels::multiply;
using kernels::multiply_conj;

constexpr int kDelays = 9;    // -4 ... 4 samples about the candidate
constexpr int kOffsets = 17;  // carrier offsets about the candidate, 500 Hz apart
constexpr double kOffsetStepHz = 500.0;
constexpr int kPieces = 8;  // of 16 samples: carrier offsets within +-4 kHz barely turn inside one
constexpr int kBack = 3;    // samples of cyclic prefix left before the window
constexpr int kCentral = 72;
constexpr float kLeastZ = 3.6F;  // of the 2688 SSS hypotheses, noise alone reaches this about once in two candidates

CyclicPrefix cp_of(int mode) noexcept { return mode % 2 == 0 ? CyclicPrefix::kNormal : CyclicPrefix::kExtended; }
Duplex duplex_of(int mode) noexcept { return mode < 2 ? Duplex::kFdd : Duplex::kTdd; }

Cf32 cis(double cycles) noexcept {
  const double phase = 2.0 * std::numbers::pi * (cycles - std::floor(cycles));
  return {static_cast<float>(std::cos(phase)), static_cast<float>(std::sin(phase))};
}

// Moving average over `reach` neighbours each side.
void smooth(const Cf32* in, int n, int reach, Cf32* out) noexcept {
  for (int k = 0; k < n; ++k) {
    const int low = std::max(0, k - reach), high = std::min(n - 1, k + reach);
    Cf32 sum{};
    for (int i = low; i <= high; ++i) sum += in[i];
    out[k] = sum / static_cast<float>(high - low + 1);
  }
}
}  // namespace

CellTest::CellTest() : demodulator_(kSearchFft) {
  for (int size = 32; size <= kTransform; size *= 2) segment_fft_.emplace_back(size, dsp::FftDirection::kForward);
  dsp::Fft symbol(kSearchFft, dsp::FftDirection::kInverse);
  for (int n_id_2 = 0; n_id_2 < 3; ++n_id_2) {
    auto& table = sss_[static_cast<std::size_t>(n_id_2)];
    table.reserve(168 * 2 * kSyncSubcarriers);
    for (int n_id_1 = 0; n_id_1 < 168; ++n_id_1) {
      for (const int subframe : {0, 5}) {
        const auto d = sss(3 * n_id_1 + n_id_2, subframe);
        table.insert(table.end(), d.begin(), d.end());
      }
    }
    std::array<Cf32, kSearchFft> bins{}, time{};
    const auto& sequence = pss(n_id_2);
    for (int n = 0; n < kSyncSubcarriers; ++n) {
      bins[static_cast<std::size_t>(n < 31 ? kSearchFft - 31 + n : n - 30)] = sequence[static_cast<std::size_t>(n)];
    }
    symbol.execute(bins.data(), time.data());
    auto& conj = pss_time_conj_[static_cast<std::size_t>(n_id_2)];
    for (const Cf32 x : time) conj.push_back(std::conj(x) / std::sqrt(62.0F * kSearchFft));
  }
  for (int f = 0; f < kOffsets; ++f) {
    const double hz = (f - kOffsets / 2) * kOffsetStepHz;
    for (int p = 0; p < kPieces; ++p) offset_turn_.push_back(cis(-hz * (16.0 * p + 8.0) / kBaseRateHz));
  }
  for (int t = 0; t < kTaps; ++t) {
    for (int k = 0; k < kCentral; ++k) {
      const int f = k < kCentral / 2 ? k - kCentral / 2 : k - kCentral / 2 + 1;
      undo_.push_back(cis(static_cast<double>(f) * (t - kTaps / 2) / kSearchFft));
    }
  }
  for (const CyclicPrefix cp : {CyclicPrefix::kNormal, CyclicPrefix::kExtended}) {
    const int second = symbols_per_slot(cp) - 3;
    const double gap_s = (symbol_start_samples(cp, second, kSearchFft) + cyclic_prefix_samples(cp, second, kSearchFft) -
                          cyclic_prefix_samples(cp, 0, kSearchFft)) /
                         kBaseRateHz;
    for (std::size_t plan = 0; plan < segment_fft_.size(); ++plan) {
      const int size = segment_fft_[plan].size();
      for (int alias = -1; alias <= 1; ++alias) {
        for (int b = 0; b < size; ++b) {
          const double hz = (b < size / 2 ? b : b - size) * 2000.0 / size + 2000.0 * alias;
          gap_turn_[cp == CyclicPrefix::kNormal ? 0 : 1][plan].push_back(cis(-hz * gap_s));
        }
      }
    }
  }
  power_.resize(static_cast<std::size_t>(kMaxHalfFrames * kDelays * kOffsets));
  sync_.resize(static_cast<std::size_t>(kMaxHalfFrames * (1 + kModes) * kSyncSubcarriers));
  series_.resize(kTransform);
  spectrum_a_.resize(kTransform);
  spectrum_b_.resize(kTransform);
  bin_power_.resize(kTransform);
}

void CellTest::refine(IqSpan iq, const PssCandidate& candidate) {
  n_id_2_ = candidate.n_id_2;
  grid_mode_ = -1;
  const auto& reference = pss_time_conj_[static_cast<std::size_t>(n_id_2_)];
  std::array<Cf32, kSearchFft> rotator, rotated;
  kernels::phasors(0.0, -candidate.cfo_hz / kBaseRateHz, rotator.data(), rotator.size());
  kernels::multiply(rotator.data(), reference.data(), rotated.data(), rotated.size());

  // Power of each half-frame over delay and offset; the drift is searched afterwards on these.
  half_frames_ = 0;
  std::array<double, kMaxHalfFrames> starts{};
  for (int h = 0; half_frames_ < kMaxHalfFrames; ++h) {
    const double tau = candidate.tau + h * static_cast<double>(kHalfFrameSamples) * (1.0 + candidate.drift);
    const double low = std::round(tau) - kDelays / 2;
    if (low + kDelays + kSearchFft > static_cast<double>(iq.size())) break;
    float* power = power_.data() + static_cast<std::size_t>(half_frames_ * kDelays * kOffsets);
    for (int d = 0; d < kDelays; ++d) {
      if (low + d < 0.0) {
        std::fill(power + d * kOffsets, power + (d + 1) * kOffsets, 0.0F);
        continue;
      }
      const Cf32* y = iq.data() + static_cast<std::size_t>(low + d);
      std::array<Cf32, kPieces> piece;
      for (std::size_t p = 0; p < kPieces; ++p) piece[p] = kernels::short_dot(y + 16 * p, rotated.data() + 16 * p, 16);
      for (std::size_t f = 0; f < kOffsets; ++f) {
        const Cf32 sum = kernels::short_dot(piece.data(), offset_turn_.data() + f * kPieces, kPieces);
        power[static_cast<std::size_t>(d) * kOffsets + f] = std::norm(sum);
      }
    }
    starts[static_cast<std::size_t>(half_frames_)] = std::round(tau) - tau;
    ++half_frames_;
  }

  // Joint maximum over delay, offset and a drift of -3 ... 3 samples over the capture.
  double best = -1.0;
  int best_d = 0, best_f = 0, best_s = 0;
  const int drifts = half_frames_ > 1 ? 3 : 0;
  std::array<std::array<double, kOffsets>, kDelays> at_best{};
  for (int s = -drifts; s <= drifts; ++s) {
    std::array<std::array<double, kOffsets>, kDelays> sum{};
    for (int h = 0; h < half_frames_; ++h) {
      const double share = half_frames_ > 1 ? static_cast<double>(h) / (half_frames_ - 1) : 0.0;
      const int shift = static_cast<int>(std::lround(s * share - starts[static_cast<std::size_t>(h)]));
      const float* power = power_.data() + static_cast<std::size_t>(h * kDelays * kOffsets);
      for (int d = 0; d < kDelays; ++d) {
        const int from = d + shift;
        if (from < 0 || from >= kDelays) continue;
        for (int f = 0; f < kOffsets; ++f) {
          sum[static_cast<std::size_t>(d)][static_cast<std::size_t>(f)] +=
              static_cast<double>(power[from * kOffsets + f]);
        }
      }
    }
    for (int d = 1; d < kDelays - 1; ++d) {
      for (int f = 0; f < kOffsets; ++f) {
        const double v = sum[static_cast<std::size_t>(d)][static_cast<std::size_t>(f)];
        if (v > best) {
          best = v;
          best_d = d;
          best_f = f;
          best_s = s;
          at_best = sum;
        }
      }
    }
  }
  const auto vertex = [](double a, double b, double c) {
    const double curvature = a - 2.0 * b + c;
    return curvature < 0.0 ? std::clamp(0.5 * (a - c) / curvature, -0.5, 0.5) : 0.0;
  };
  const auto d = static_cast<std::size_t>(best_d), f = static_cast<std::size_t>(best_f);
  double delay = best_d - kDelays / 2, offset = best_f - kOffsets / 2;
  if (best_d > 0 && best_d < kDelays - 1) delay += vertex(at_best[d - 1][f], at_best[d][f], at_best[d + 1][f]);
  if (best_f > 0 && best_f < kOffsets - 1) offset += vertex(at_best[d][f - 1], at_best[d][f], at_best[d][f + 1]);
  tau_ = candidate.tau + delay;
  cfo_hz_ = candidate.cfo_hz + offset * kOffsetStepHz;
  drift_ = candidate.drift;
  if (half_frames_ > 1) drift_ += best_s / (static_cast<double>(kHalfFrameSamples) * (half_frames_ - 1));
}

void CellTest::offer(const Hypothesis& h) {
  for (Hypothesis& old : hypotheses_) {
    if (old.z > 0.0F && old.mode == h.mode && old.cell_id == h.cell_id && old.parity == h.parity) {
      old.z = std::max(old.z, h.z);
      return;
    }
  }
  auto lowest = std::min_element(hypotheses_.begin(), hypotheses_.end(),
                                 [](const Hypothesis& a, const Hypothesis& b) { return a.z < b.z; });
  if (h.z > lowest->z) *lowest = h;
}

void CellTest::rank(IqSpan iq) {
  hypotheses_.fill({});
  demodulator_.set_frequency(cfo_hz_ / kBaseRateHz);
  const auto& sequence = pss(n_id_2_);
  const int stride = (1 + kModes) * kSyncSubcarriers;
  std::array<Cf32, kSyncSubcarriers> flat{};
  std::array<Cf32, kMaxHalfFrames> sum_of{};
  std::array<std::array<bool, 1 + kModes>, kMaxHalfFrames> valid{};
  for (int h = 0; h < half_frames_; ++h) {
    Cf32* row = sync_.data() + static_cast<std::size_t>(h * stride);
    const double tau = tau_ + h * static_cast<double>(kHalfFrameSamples) * (1.0 + drift_);
    auto& ok = valid[static_cast<std::size_t>(h)];
    ok[0] = demodulator_.transform(iq, tau, kBack);
    if (!ok[0]) continue;
    demodulator_.subcarriers(31, row);
    for (std::size_t k = 0; k < kSyncSubcarriers; ++k) {
      row[k] = multiply_conj(row[k], sequence[k]);
      sum_of[static_cast<std::size_t>(h)] += row[k];
    }
    for (int mode = 0; mode < kModes; ++mode) {
      ok[static_cast<std::size_t>(mode + 1)] =
          demodulator_.transform(iq, tau - sss_before_pss(duplex_of(mode), cp_of(mode)), kBack);
      if (ok[static_cast<std::size_t>(mode + 1)]) demodulator_.subcarriers(31, row + (mode + 1) * kSyncSubcarriers);
    }
  }

  // Phase from half-frame to half-frame: the residual offset modulo 200 Hz, by the largest coherent sum.
  std::fill(series_.begin(), series_.end(), Cf32{});
  std::copy_n(sum_of.begin(), half_frames_, series_.begin());
  segment_fft_.back().execute(series_.data(), spectrum_a_.data());
  const auto top = std::max_element(spectrum_a_.begin(), spectrum_a_.end(),
                                    [](Cf32 a, Cf32 b) { return std::norm(a) < std::norm(b); });
  const auto bin = static_cast<int>(top - spectrum_a_.begin());
  const double residual = static_cast<double>(bin < kTransform / 2 ? bin : bin - kTransform) / kTransform;  // cycles
  for (int h = 0; h < half_frames_; ++h) {
    if (!valid[static_cast<std::size_t>(h)][0]) continue;
    const Cf32* row = sync_.data() + static_cast<std::size_t>(h * stride);
    const Cf32 turn = cis(-residual * h);
    for (std::size_t k = 0; k < kSyncSubcarriers; ++k) flat[k] += multiply(row[k], turn);
  }
  std::array<Cf32, kSyncSubcarriers> steady;
  smooth(flat.data(), kSyncSubcarriers, 10, steady.data());

  // Two channel estimates: the half-frame's own (a few subcarriers wide) and the coherent one of the whole capture.
  const auto& table = sss_[static_cast<std::size_t>(n_id_2_)];
  std::array<Cf32, kSyncSubcarriers> own;
  const int kinds = half_frames_ > 1 ? 2 : 1;  // of one half-frame they are the same
  for (int kind = 0; kind < kinds; ++kind) {
    for (int mode = 0; mode < kModes; ++mode) {
      std::array<std::array<float, kSyncSubcarriers>, 2> z{};
      double scale = 0.0;
      for (int h = 0; h < half_frames_; ++h) {
        const auto& ok = valid[static_cast<std::size_t>(h)];
        if (!ok[0] || !ok[static_cast<std::size_t>(mode + 1)]) continue;
        const Cf32* row = sync_.data() + static_cast<std::size_t>(h * stride);
        const Cf32* y = row + (mode + 1) * kSyncSubcarriers;
        if (kind == 0) {
          smooth(row, kSyncSubcarriers, 4, own.data());
        } else {
          const Cf32 turn = cis(residual * h);
          for (std::size_t k = 0; k < kSyncSubcarriers; ++k) own[k] = multiply(steady[k], turn);
        }
        auto& sum = z[static_cast<std::size_t>(h % 2)];
        for (std::size_t k = 0; k < kSyncSubcarriers; ++k) {
          sum[k] += multiply_conj(y[k], own[k]).real();
          scale += 0.5 * static_cast<double>(std::norm(y[k])) * static_cast<double>(std::norm(own[k]));
        }
      }
      if (!(scale > 0.0)) continue;
      const auto norm = static_cast<float>(1.0 / std::sqrt(scale));
      for (int n_id_1 = 0; n_id_1 < 168; ++n_id_1) {
        const float* s0 = table.data() + static_cast<std::size_t>(n_id_1 * 2) * kSyncSubcarriers;
        const float* s5 = s0 + kSyncSubcarriers;
        for (int parity = 0; parity < 2; ++parity) {  // 0: the first half-frame is the frame's first
          const auto p = static_cast<std::size_t>(parity);
          const float v = norm * (kernels::dot(s0, z[p].data(), kSyncSubcarriers) +
                                  kernels::dot(s5, z[1 - p].data(), kSyncSubcarriers));
          if (v > kLeastZ) offer({mode, 3 * n_id_1 + n_id_2_, parity, v});
        }
      }
    }
  }
  std::sort(hypotheses_.begin(), hypotheses_.end(), [](const Hypothesis& a, const Hypothesis& b) { return a.z > b.z; });

  // Finer delay from the slope of the coherent channel over frequency; offset by the residual nearest to the estimate.
  Cf32 slope{};
  for (std::size_t k = 0; k + 1 < kSyncSubcarriers; ++k) {
    if (k != 30) slope += multiply_conj(flat[k + 1], flat[k]);  // 30 to 31 steps over the carrier
  }
  const double delay = -static_cast<double>(std::arg(slope)) / (2.0 * std::numbers::pi) * kSearchFft;
  tau_ += std::clamp(delay, -0.7, 0.7);
  const double step_hz = kBaseRateHz / (static_cast<double>(kHalfFrameSamples) * (1.0 + drift_));  // 200 Hz
  cfo_hz_ += residual * step_hz;
}

void CellTest::read_grid(IqSpan iq, int mode) {
  if (grid_mode_ == mode) return;
  grid_mode_ = mode;
  const CyclicPrefix cp = cp_of(mode);
  const double half_frame = tau_ - pss_in_half_frame(duplex_of(mode), cp);
  const double slot = 960.0 * (1.0 + drift_);
  grid_first_slot_ = static_cast<int>(std::ceil(-half_frame / slot));
  grid_slots_ = std::max(
      0, static_cast<int>(std::floor((static_cast<double>(iq.size()) - half_frame) / slot)) - grid_first_slot_);
  grid_slots_ = std::min(grid_slots_, 16 * kSegmentSlots);
  grid_.resize(static_cast<std::size_t>(grid_slots_ * 2 * kCentral));
  grid_valid_.assign(static_cast<std::size_t>(grid_slots_ * 2), 0);
  demodulator_.set_frequency(cfo_hz_ / kBaseRateHz);
  for (int s = 0; s < grid_slots_; ++s) {
    for (int which = 0; which < 2; ++which) {
      const int symbol = which == 0 ? 0 : symbols_per_slot(cp) - 3;
      const double in_slot =
          symbol_start_samples(cp, symbol, kSearchFft) + cyclic_prefix_samples(cp, symbol, kSearchFft);
      const double start = half_frame + (960.0 * (s + grid_first_slot_) + in_slot) * (1.0 + drift_);
      if (!demodulator_.transform(iq, start, kBack)) continue;
      demodulator_.subcarriers(kCentral / 2, grid_.data() + static_cast<std::size_t>((s * 2 + which) * kCentral));
      grid_valid_[static_cast<std::size_t>(s * 2 + which)] = 1;
    }
  }
}

bool CellTest::confirm(IqSpan iq, const Hypothesis& h, bool drift_known, ConfirmedCell& out) {
  read_grid(iq, h.mode);
  const CyclicPrefix cp = cp_of(h.mode);
  const int second = symbols_per_slot(cp) - 3;
  constexpr int kPilots = 12;
  taps_.assign(static_cast<std::size_t>(2 * kTaps * grid_slots_), Cf32{});
  pilots_.assign(static_cast<std::size_t>(2 * grid_slots_ * kPilots), Cf32{});

  std::array<Cf32, kPilots> reference;
  std::array<Cf32, static_cast<std::size_t>(kTaps * kPilots)> undo;
  const auto slot_in_frame = [&](int s) { return (((s + grid_first_slot_ + 10 * h.parity) % 20) + 20) % 20; };
  const auto usable = [&](int slot, int which) {
    if (duplex_of(h.mode) == Duplex::kFdd) return true;
    const int subframe = slot / 2;
    return subframe == 0 || subframe == 5 || ((subframe == 1 || subframe == 6) && slot % 2 == 0 && which == 0);
  };
  for (int which = 0; which < 2; ++which) {
    for (int slot = 0; slot < 20; ++slot) {
      if (!usable(slot, which)) continue;
      crs_values(h.cell_id, slot, which == 0 ? 0 : second, cp, 6, reference);
      const int first = crs_first_subcarrier(h.cell_id, slot, which == 0 ? 0 : second, 0);
      for (int t = 0; t < kTaps; ++t) {
        for (int m = 0; m < kPilots; ++m) {
          undo[static_cast<std::size_t>(t * kPilots + m)] =
              undo_[static_cast<std::size_t>(t * kCentral + 6 * m + first)];
        }
      }
      for (int s = 0; s < grid_slots_; ++s) {
        if (slot_in_frame(s) != slot || grid_valid_[static_cast<std::size_t>(s * 2 + which)] == 0) continue;
        const Cf32* y = grid_.data() + static_cast<std::size_t>((s * 2 + which) * kCentral);
        Cf32* z = pilots_.data() + static_cast<std::size_t>((which * grid_slots_ + s) * kPilots);
        for (int m = 0; m < kPilots; ++m)
          z[m] = multiply_conj(y[6 * m + first], reference[static_cast<std::size_t>(m)]);
        for (int t = 1; t < kTaps - 1; ++t) {
          const Cf32 sum = kernels::short_dot(z, undo.data() + static_cast<std::size_t>(t * kPilots), kPilots);
          taps_[static_cast<std::size_t>((which * kTaps + t) * grid_slots_ + s)] = sum;
        }
      }
    }
  }

  double total = 0.0, best_any = -1.0, best_hz = 0.0, best_delay = 0.0, best_slope = 0.0;
  int segments = 0;
  for (int begin = 0; begin < grid_slots_; begin += kSegmentSlots) {
    const int count = std::min(kSegmentSlots, grid_slots_ - begin);
    if (segments > 0 && count < kSegmentSlots / 2) break;
    double energy = 0.0, paired = 0.0;
    Cf32 repeat{};
    for (int which = 0; which < 2; ++which) {
      for (int s = begin; s < begin + count; ++s) {
        const Cf32* z = pilots_.data() + static_cast<std::size_t>((which * grid_slots_ + s) * kPilots);
        const double e = kernels::energy(z, kPilots);
        energy += e;
        if (s + 20 < begin + count) {
          repeat += kernels::dot_conj(z + 20 * kPilots, z, kPilots);
          paired += e;
        }
      }
    }
    if (!(energy > 0.0)) continue;
    ++segments;
    // What repeats from frame to frame (a stronger cell's reference signals do) adds up in step whatever the cell.
    const double repetition = paired > 0.0 ? std::min(1.0, static_cast<double>(std::abs(repeat)) / paired) : 0.0;
    const double penalty = 1.0 + std::max(0.0, count / 20.0 - 1.0) * repetition;
    // Delay, drift of what is left (none where it is known or the segment is short) and frequency by a transform.
    const int slopes = drift_known || count < 32 ? 0 : 1;
    std::size_t plan = 0;
    while (plan + 1 < segment_fft_.size() && segment_fft_[plan].size() < 2 * count) ++plan;
    const int size = segment_fft_[plan].size();
    const auto bins = static_cast<std::size_t>(size);
    const Cf32* turns = gap_turn_[cp == CyclicPrefix::kNormal ? 0 : 1][plan].data();
    double best = -1.0;
    for (int slope = -slopes; slope <= slopes; ++slope) {
      for (int tap = 2; tap < kTaps - 2; ++tap) {
        for (int which = 0; which < 2; ++which) {
          for (int s = 0; s < count; ++s) {
            const double share = count > 1 ? static_cast<double>(s) / (count - 1) - 0.5 : 0.0;
            const int t = tap + (slope == 0 ? 0 : static_cast<int>(std::lround(2.0 * slope * share)));
            series_[static_cast<std::size_t>(s)] =
                taps_[static_cast<std::size_t>((which * kTaps + t) * grid_slots_ + begin + s)];
          }
          std::fill(series_.begin() + count, series_.begin() + size, Cf32{});
          segment_fft_[plan].execute(series_.data(), which == 0 ? spectrum_a_.data() : spectrum_b_.data());
        }
        for (int alias = -1; alias <= 1; ++alias) {
          kernels::power_of_sum(spectrum_a_.data(), spectrum_b_.data(), turns + (alias + 1) * size, bin_power_.data(),
                                bins);
          const auto p = static_cast<double>(kernels::maximum(bin_power_.data(), bins));
          if (p <= best) continue;
          best = p;
          if (p / energy / penalty <= best_any) continue;
          best_any = p / energy / penalty;
          const int b =
              static_cast<int>(std::max_element(bin_power_.begin(), bin_power_.begin() + size) - bin_power_.begin());
          best_hz = (b < size / 2 ? b : b - size) * 2000.0 / size + 2000.0 * alias;
          best_slope = count > 1 ? 2.0 * slope / (960.0 * count) : 0.0;
          best_delay = tap - kTaps / 2 - best_slope * 960.0 * (begin + count / 2 + grid_first_slot_);
        }
      }
    }
    total += best / energy / penalty;
  }
  if (segments == 0) return false;
  constexpr double kNoiseMaximum = 11.0;  // what the maximum over delays, slopes and offsets takes in noise
  out.evidence = std::max(best_any, total - kNoiseMaximum * (segments - 1));
  if (out.evidence < kEvidence) return false;
  out.cell_id = h.cell_id;
  out.cp = cp;
  out.duplex = duplex_of(h.mode);
  const double half_frame = tau_ - pss_in_half_frame(out.duplex, cp) + best_delay;
  out.frame_start = half_frame - (h.parity == 1 ? static_cast<double>(kHalfFrameSamples) * (1.0 + drift_) : 0.0);
  out.cfo_hz = cfo_hz_ + best_hz;
  out.drift = drift_ + best_slope;
  return true;
}

}  // namespace soopnav::lte
