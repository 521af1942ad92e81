#include "soopnav/array/synthetic_aperture.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

#include "array/aperture_search.hpp"
#include "array/require.hpp"
#include "soopnav/core/angle.hpp"

namespace soopnav::array {

namespace {

constexpr std::size_t kFewestSnapshots = 8;
constexpr double kStraightRad = 0.1;  // rms phase that the path's lesser axis makes
constexpr double kFreeStepRad = 0.6;  // a walk of longer steps wraps: its prior is of no use
constexpr double kGap = 6.0;          // e^-6: the second answer counts below
constexpr double kApartRad = 0.1;     // answers nearer than this are one
constexpr double kCoarseRad = 1e-3, kSettledRad = 1e-7;
constexpr int kCoarseSteps = 10, kFineSteps = 100;
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

void require_size(const char* name, std::size_t size, std::size_t expected, const char* rule) {
  if (size != expected) require(false, name, size, std::string(rule) + ": " + std::to_string(expected) + " expected");
}

}  // namespace

std::string_view to_string(ApertureStatus status) noexcept {
  switch (status) {
    case ApertureStatus::kOk:
      return "ok";
    case ApertureStatus::kTwoAnswers:
      return "two answers";
    case ApertureStatus::kSingular:
      return "path does not determine the bearings";
    case ApertureStatus::kTooFewNodes:
      return "too few nodes";
    case ApertureStatus::kTooFewCoherent:
      return "too few coherent links";
    case ApertureStatus::kTooFewSnapshots:
      return "too few snapshots";
    case ApertureStatus::kStepTooLong:
      return "step longer than half a wavelength";
    case ApertureStatus::kPathTooShort:
      return "path shorter than a quarter of a wavelength";
    case ApertureStatus::kNonFinite:
      return "not finite";
    case ApertureStatus::kNoPower:
      return "no power";
    case ApertureStatus::kNoConvergence:
      return "no convergence";
  }
  return "unknown";
}

void require_options(const ApertureOptions& o) {
  const auto positive = [](double v) { return std::isfinite(v) && v >= 0.0; };
  require(positive(o.phase_sigma_rad_per_sqrt_s), "phase_sigma_rad_per_sqrt_s", o.phase_sigma_rad_per_sqrt_s,
          "it must be finite and >= 0");
  require(o.phase != ReceiverPhase::kRandomWalk || o.phase_sigma_rad_per_sqrt_s > 0.0, "phase_sigma_rad_per_sqrt_s",
          o.phase_sigma_rad_per_sqrt_s, "a random walk needs more than 0");
  require(positive(o.max_frequency_hz), "max_frequency_hz", o.max_frequency_hz, "it must be finite and >= 0");
  require(positive(o.path_sigma_m_per_sqrt_step), "path_sigma_m_per_sqrt_step", o.path_sigma_m_per_sqrt_step,
          "it must be finite and >= 0");
  require(positive(o.noise_variance), "noise_variance", o.noise_variance, "it must be finite and >= 0");
  require(o.coherence_threshold >= 0.0 && o.coherence_threshold < 1.0, "coherence_threshold", o.coherence_threshold,
          "it must be in [0, 1)");
  require(o.max_sigma_rad > 0.0 && o.max_sigma_rad <= kPi, "max_sigma_rad", o.max_sigma_rad, "it must be in (0, pi]");
}

void require_data(const ApertureData& data, bool phasors, bool path) {
  const std::size_t n = data.time_s.size(), nodes = data.wavelength_m.size();
  require(nodes >= 1 && nodes <= kMaxApertureNodes, "wavelength_m", nodes, "1 to 16 nodes");
  require(n <= kMaxApertureSnapshots, "time_s", n, "at most 4096 snapshots");
  for (const double v : data.wavelength_m) {
    require(std::isfinite(v) && v > 0.0, "wavelength_m", v, "it must be finite and positive");
  }
  if (phasors) require_size("phasors", data.phasors.size(), n * nodes, "one per snapshot and node");
  if (!path) return;
  require_size("path_m", data.path_m.size(), 2 * n, "two numbers per snapshot");
  const std::size_t block = std::max<std::size_t>(2 * n, 1);
  require(data.path_modes_m.size() % block == 0 && data.path_modes_m.size() / block <= kMaxApertureModes,
          "path_modes_m", data.path_modes_m.size(), "whole modes of 2 n numbers, at most 16");
}

ApertureStatus fill_model(const ApertureData& data, const ApertureOptions& options, bool path, ApertureModel& m,
                          int& index) {
  const std::size_t n = data.time_s.size(), nodes = data.wavelength_m.size();
  m.resize(n, nodes, path && n > 0 ? data.path_modes_m.size() / (2 * n) : 0);
  m.receiver = options.phase;
  m.path_free = !path;
  m.path_error = path && options.path_sigma_m_per_sqrt_step > 0.0;
  if (n < kFewestSnapshots) return ApertureStatus::kTooFewSnapshots;
  const double centre = 0.5 * (data.time_s.front() + data.time_s.back());
  double largest_step = 0.0;
  for (std::size_t k = 0; k < n; ++k) {
    m.t[k] = data.time_s[k] - centre;
    index = static_cast<int>(k);
    if (!std::isfinite(m.t[k]) || (k > 0 && !(m.t[k] > m.t[k - 1]))) return ApertureStatus::kNonFinite;
    m.x0[k] = path ? data.path_m[2 * k] : 0.0;
    m.y0[k] = path ? data.path_m[2 * k + 1] : 0.0;
    if (!std::isfinite(m.x0[k]) || !std::isfinite(m.y0[k])) return ApertureStatus::kNonFinite;
    const double dt = k > 0 ? m.t[k] - m.t[k - 1] : 1.0;
    const double phase = options.phase_sigma_rad_per_sqrt_s * std::sqrt(dt), error = options.path_sigma_m_per_sqrt_step;
    if (k > 0) largest_step = std::max(largest_step, phase);
    m.phase_information[k] = phase > 0.0 ? 1.0 / (phase * phase) : 0.0;
    m.path_information[k] = error > 0.0 ? 1.0 / (error * error) : 0.0;
  }
  if (m.receiver == ReceiverPhase::kRandomWalk && largest_step > kFreeStepRad) m.receiver = ReceiverPhase::kFree;
  for (std::size_t j = 0; j < m.modes; ++j) {
    for (std::size_t k = 0; k < n; ++k) {
      m.mode_x[j * n + k] = data.path_modes_m[2 * (j * n + k)];
      m.mode_y[j * n + k] = data.path_modes_m[2 * (j * n + k) + 1];
      index = static_cast<int>(k);
      if (!std::isfinite(m.mode_x[j * n + k] + m.mode_y[j * n + k])) return ApertureStatus::kNonFinite;
    }
  }
  double longest = 0.0, shortest = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < nodes; ++i) {
    m.wave_number[i] = kTwoPi / data.wavelength_m[i];
    longest = std::max(longest, data.wavelength_m[i]);
    shortest = std::min(shortest, data.wavelength_m[i]);
    m.used[i] = 1;
  }
  for (auto* v : {&m.theta, &m.offset, &m.phi, &m.z, &m.psi, &m.dx, &m.dy}) std::fill(v->begin(), v->end(), 0.0);
  std::fill(m.fixed.begin(), m.fixed.end(), std::uint8_t{0});
  index = -1;
  if (!path) return ApertureStatus::kOk;
  double mean_x = 0.0, mean_y = 0.0, radius = 0.0;
  for (std::size_t k = 0; k < n; ++k) {
    mean_x += m.x0[k] / static_cast<double>(n);
    mean_y += m.y0[k] / static_cast<double>(n);
  }
  for (std::size_t k = 0; k < n; ++k) {
    if (k > 0 && std::hypot(m.x0[k] - m.x0[k - 1], m.y0[k] - m.y0[k - 1]) > 0.5 * shortest) {
      index = static_cast<int>(k);
      return ApertureStatus::kStepTooLong;
    }
  }
  for (std::size_t k = 0; k < n; ++k) {
    m.x0[k] -= mean_x;
    m.y0[k] -= mean_y;
  }
  for (std::size_t k = 0; k < n; ++k) radius = std::max(radius, std::hypot(m.x0[k], m.y0[k]));
  return 2.0 * radius < 0.25 * longest ? ApertureStatus::kPathTooShort : ApertureStatus::kOk;
}

ApertureStatus fill_phasors(const ApertureData& data, const ApertureOptions& options, ApertureModel& m, int& index) {
  for (std::size_t i = 0; i < m.nodes; ++i) {
    double sum = 0.0;
    for (std::size_t k = 0; k < m.n; ++k) {
      m.y[k * m.nodes + i] = data.phasors[k * m.nodes + i];
      sum += std::norm(m.y[k * m.nodes + i]);
    }
    index = static_cast<int>(i);
    if (!std::isfinite(sum)) return ApertureStatus::kNonFinite;
    if (!(sum > 1e-280)) return ApertureStatus::kNoPower;
    m.power[i] = sum / static_cast<double>(m.n);
    m.amplitude[i] = std::sqrt(m.power[i]);
    m.noise[i] = options.noise_variance > 0.0 ? options.noise_variance : 1.0;
  }
  index = -1;
  return ApertureStatus::kOk;
}

void fix_gauge(ApertureModel& m, bool frequency_offsets, std::size_t reference, bool modes) noexcept {
  for (std::size_t i = 0; i < m.nodes; ++i) {
    std::uint8_t* const f = &m.fixed[ApertureModel::kPerNode * i];
    f[ApertureModel::kBearing] = 0;
    f[ApertureModel::kOffset] = !frequency_offsets || (i == reference && m.receiver == ReceiverPhase::kFree);
    f[ApertureModel::kPhase] = i == reference && m.receiver != ReceiverPhase::kKnown;
  }
  for (std::size_t j = 0; j < m.modes; ++j) m.fixed[ApertureModel::kPerNode * m.nodes + j] = modes ? 0 : 1;
}

PathAxis path_axis(const ApertureModel& m) noexcept {
  double xx = 0.0, xy = 0.0, yy = 0.0;
  for (std::size_t k = 0; k < m.n; ++k) {
    xx += m.x0[k] * m.x0[k];
    xy += m.x0[k] * m.y0[k];
    yy += m.y0[k] * m.y0[k];
  }
  const double mean = 0.5 * (xx + yy), half = std::hypot(0.5 * (xx - yy), xy);
  const double longest_wave_number = *std::max_element(m.wave_number.begin(), m.wave_number.end());
  const double lesser = std::sqrt(std::max(0.0, mean - half) / static_cast<double>(m.n));
  return {0.5 * std::atan2(2.0 * xy, xx - yy), longest_wave_number * lesser < kStraightRad};
}

struct SyntheticAperture::Work {
  ApertureModel model;
  ApertureSearch search;
  std::vector<double> bearing, alternative, covariance, frequency, coherence, phase, amplitude, path;
  std::vector<std::uint8_t> los;

  struct Answer {
    std::vector<double> theta, offset, phi, amplitude, z, psi, dx, dy;
    double objective = 0.0;
    bool settled = false;
  } best, second, trial;

  void keep(Answer& a) const {
    a.theta = model.theta;
    a.offset = model.offset;
    a.phi = model.phi;
    a.amplitude = model.amplitude;
    a.z = model.z;
    a.psi = model.psi;
    a.dx = model.dx;
    a.dy = model.dy;
  }
  void put_back(const Answer& a) {
    model.theta = a.theta;
    model.offset = a.offset;
    model.phi = a.phi;
    model.amplitude = a.amplitude;
    model.z = a.z;
    model.psi = a.psi;
    model.dx = a.dx;
    model.dy = a.dy;
    model.aim();
  }
  [[nodiscard]] std::size_t in_use() const noexcept {
    return static_cast<std::size_t>(std::count(model.used.begin(), model.used.end(), std::uint8_t{1}));
  }
  [[nodiscard]] double objective(bool own_noise) const noexcept {
    if (!own_noise) return model.cost();
    return static_cast<double>(model.n * in_use()) * std::log(model.noise[0]) + model.prior_cost();
  }
  [[nodiscard]] bool apart(const Answer& a, const Answer& b) const noexcept {
    for (std::size_t i = 0; i < model.nodes; ++i) {
      if (model.used[i] && std::abs(wrap_to_pi(a.theta[i] - b.theta[i])) > kApartRad) return true;
    }
    return false;
  }
  void fit(const ApertureOptions& options, std::size_t reference, ReceiverPhase receiver, bool path_error, int& steps);
  void measure_coherence(ReceiverPhase receiver, const ApertureOptions& options);
  [[nodiscard]] std::size_t least_coherent_blind();
};

// One reference link: starts, coarse fits, the best two finished. `best` is empty-handed when nothing was found.
void SyntheticAperture::Work::fit(const ApertureOptions& options, std::size_t reference, ReceiverPhase receiver,
                                  bool path_error, int& steps) {
  ApertureModel& m = model;
  const bool own = !(options.noise_variance > 0.0);
  const bool pairs = receiver != ReceiverPhase::kKnown && in_use() >= 3;
  best.objective = second.objective = std::numeric_limits<double>::infinity();
  m.path_error = false;
  m.receiver = pairs ? ReceiverPhase::kFree : ReceiverPhase::kKnown;
  fix_gauge(m, options.frequency_offsets, reference, false);
  const double axis = path_axis(m).angle_rad;
  const std::size_t found = pairs ? search.pairs(m, reference) : search.singles(m);
  const auto consider = [&] {
    std::fill(m.z.begin(), m.z.end(), 0.0);
    std::fill(m.psi.begin(), m.psi.end(), 0.0);
    std::fill(m.dx.begin(), m.dx.end(), 0.0);
    std::fill(m.dy.begin(), m.dy.end(), 0.0);
    for (std::size_t i = 0; i < m.nodes; ++i) m.amplitude[i] = std::sqrt(m.power[i]);
    static_cast<void>(m.solve(kCoarseSteps, kCoarseRad, own, steps));
    keep(trial);
    trial.objective = objective(own);
    if (trial.objective < best.objective) {
      if (apart(trial, best)) std::swap(second, best);
      std::swap(trial, best);
    } else if (trial.objective < second.objective && apart(trial, best)) {
      std::swap(trial, second);
    }
  };
  for (std::size_t s = 0; s < found; ++s) {
    search.start(s, m);
    if (s == 0) {
      for (Answer* const answer : {&best, &second, &trial}) keep(*answer);  // of this problem's sizes, whatever comes
    }
    consider();
  }
  // The mirror image of the best, about the path's long axis.
  put_back(best);
  for (double& v : m.theta) v = wrap_to_pi(2.0 * axis - v);
  consider();
  for (Answer* answer : {&best, &second}) {
    if (!std::isfinite(answer->objective)) continue;
    put_back(*answer);
    m.receiver = receiver;
    m.path_error = path_error;
    fix_gauge(m, options.frequency_offsets, reference, true);
    if (receiver == ReceiverPhase::kRandomWalk && pairs) {
      for (std::size_t k = 1; k < m.n; ++k) m.psi[k] = m.psi[k - 1] + wrap_to_pi(m.psi[k] - m.psi[k - 1]);
    }
    answer->settled = m.solve(kFineSteps, kSettledRad, own, steps);
    const double value = objective(own);
    keep(*answer);
    answer->objective = value;
  }
  if (second.objective < best.objective) std::swap(best, second);
  put_back(best);
  if (own) m.estimate_noise();
}

void SyntheticAperture::Work::measure_coherence(ReceiverPhase receiver, const ApertureOptions& options) {
  ApertureModel& m = model;
  const bool others = receiver == ReceiverPhase::kFree || (receiver == ReceiverPhase::kRandomWalk && in_use() >= 3);
  for (std::size_t i = 0; i < m.nodes; ++i) {
    for (std::size_t k = 0; k < m.n; ++k) {
      phase[k] = m.psi[k];
      if (!others) continue;
      std::complex<double> sum = 0.0;
      for (std::size_t j = 0; j < m.nodes; ++j) {
        if (j == i || !m.used[j]) continue;
        sum += m.amplitude[j] * m.y[k * m.nodes + j] * std::polar(1.0, -m.phase_of(j, k));
      }
      phase[k] = std::arg(sum);
    }
    std::complex<double> sum = 0.0;
    for (std::size_t k = 0; k < m.n; ++k) {
      sum += m.y[k * m.nodes + i] * std::polar(1.0, -m.phase_of(i, k) - phase[k]);
    }
    const double scale = static_cast<double>(m.n) * static_cast<double>(m.n) * m.power[i];
    double value = m.used[i] ? std::norm(sum) / scale : 0.0;
    if (!m.used[i] || value < options.coherence_threshold) {
      value = std::max(value, search.largest(m, i, phase) / scale);
    }
    coherence[i] = std::min(1.0, value);
    los[i] = coherence[i] >= options.coherence_threshold ? 1 : 0;
  }
}

// Coherence of each link with a path of three free numbers per snapshot, and the link with least of it.
std::size_t SyntheticAperture::Work::least_coherent_blind() {
  const ApertureModel& m = model;
  coherence.assign(m.nodes, 0.0);
  for (std::size_t i = 0; i < m.nodes; ++i) {
    std::complex<double> sum = 0.0;
    for (std::size_t k = 0; k < m.n; ++k) sum += m.y[k * m.nodes + i] * std::polar(1.0, -m.phase_of(i, k) - m.psi[k]);
    const auto n = static_cast<double>(m.n);
    coherence[i] = std::min(1.0, std::norm(sum) / (n * n * m.power[i]));
  }
  return static_cast<std::size_t>(std::min_element(coherence.begin(), coherence.end()) - coherence.begin());
}

SyntheticAperture::SyntheticAperture(const ApertureOptions& options) : options_(options) {
  require_options(options);
  work_ = std::make_unique<Work>();
}
SyntheticAperture::~SyntheticAperture() = default;
SyntheticAperture::SyntheticAperture(SyntheticAperture&&) noexcept = default;
SyntheticAperture& SyntheticAperture::operator=(SyntheticAperture&&) noexcept = default;

ApertureBearings SyntheticAperture::estimate(const ApertureData& data) {
  require_data(data, true, true);
  Work& w = *work_;
  ApertureModel& m = w.model;
  ApertureBearings out;
  const auto fail = [&](ApertureStatus status) {
    out.status = status;
    return out;
  };
  if (const auto status = fill_model(data, options_, true, m, out.index); status != ApertureStatus::kOk) {
    return fail(status);
  }
  if (const auto status = fill_phasors(data, options_, m, out.index); status != ApertureStatus::kOk)
    return fail(status);
  const ReceiverPhase receiver = m.receiver;
  const bool path_error = m.path_error;
  const std::size_t nodes = m.nodes, n = m.n;
  for (auto* v : {&w.bearing, &w.alternative, &w.frequency, &w.coherence, &w.amplitude}) v->assign(nodes, kNan);
  w.covariance.assign(nodes * nodes, kNan);
  w.los.assign(nodes, 0);
  w.phase.assign(n, 0.0);
  out.straight = path_axis(m).straight;
  if (receiver == ReceiverPhase::kFree) {
    if (nodes < 3) return fail(ApertureStatus::kTooFewNodes);
    if (out.straight) return fail(ApertureStatus::kSingular);
  }
  w.search.prepare(m, options_.frequency_offsets, options_.max_frequency_hz);
  const std::size_t needed = receiver == ReceiverPhase::kFree ? 3 : 1;
  for (;;) {
    double lowest = std::numeric_limits<double>::infinity();
    std::size_t chosen = nodes, tried = 0;
    bool coherent = false;
    for (std::size_t pass = 0; pass < 2 && !coherent; ++pass) {  // every reference once, the best one again at the end
      for (std::size_t r = 0; r < nodes && !coherent; ++r) {
        if (!m.used[r] || (pass == 1 && r != chosen)) continue;
        w.fit(options_, r, receiver, path_error, out.iterations);
        w.measure_coherence(receiver, options_);
        coherent = true;
        for (std::size_t i = 0; i < nodes; ++i) coherent = coherent && (!m.used[i] || w.los[i]);
        if (pass == 0) {
          ++tried;
          if (w.best.objective < lowest) {
            lowest = w.best.objective;
            chosen = r;
          }
          if (receiver == ReceiverPhase::kKnown || w.in_use() < 3) coherent = true;  // no reference to choose
        }
      }
      if (pass == 0 && !coherent && tried == 1) break;
    }
    std::size_t worst = nodes;
    for (std::size_t i = 0; i < nodes; ++i) {
      if (m.used[i] && !w.los[i] && (worst == nodes || w.coherence[i] < w.coherence[worst])) worst = i;
    }
    if (worst == nodes) break;
    if (w.in_use() <= needed) {
      out.coherence = w.coherence;
      out.los = w.los;
      out.index = static_cast<int>(worst);
      return fail(ApertureStatus::kTooFewCoherent);
    }
    m.used[worst] = 0;
    if (receiver == ReceiverPhase::kKnown) {
      for (std::size_t i = 0; i < nodes; ++i) m.used[i] = w.los[i];
      if (w.in_use() == 0) m.used[worst] = 1;
    }
  }

  out.coherence = w.coherence;
  out.los = w.los;
  out.noise_variance = m.noise[0];
  if (!w.best.settled) return fail(ApertureStatus::kNoConvergence);
  if (!m.invert()) return fail(ApertureStatus::kSingular);
  std::size_t first = 0;
  while (!m.used[first]) ++first;
  std::size_t left = 0;
  const auto variance = [&](std::size_t i) {
    return m.covariance(ApertureModel::kPerNode * i, ApertureModel::kPerNode * i);
  };
  for (std::size_t i = 0; i < nodes; ++i) {
    if (!m.used[i]) continue;
    w.amplitude[i] = m.amplitude[i];
    w.frequency[i] = (m.offset[i] - (receiver == ReceiverPhase::kFree ? m.offset[first] : 0.0)) / kTwoPi;
    if (!(std::sqrt(variance(i)) <= options_.max_sigma_rad)) {
      out.index = static_cast<int>(i);
      continue;
    }
    ++left;
    w.bearing[i] = wrap_to_pi(m.theta[i]);
    for (std::size_t j = 0; j < nodes; ++j) {
      if (!m.used[j] || !(std::sqrt(variance(j)) <= options_.max_sigma_rad)) continue;
      w.covariance[i * nodes + j] = m.covariance(ApertureModel::kPerNode * i, ApertureModel::kPerNode * j);
    }
  }
  if (left == 0) return fail(ApertureStatus::kSingular);
  for (std::size_t k = 0; k < n; ++k) {
    w.phase[k] = wrap_to_pi(m.psi[k] + (receiver == ReceiverPhase::kKnown ? 0.0 : m.phi[first]) +
                            (receiver == ReceiverPhase::kFree ? m.offset[first] * m.t[k] : 0.0));
  }
  out.gap = w.second.objective - w.best.objective;
  bool two = false;
  for (std::size_t i = 0; i < nodes && std::isfinite(out.gap); ++i) {
    if (!std::isfinite(w.bearing[i])) continue;
    double gap = out.gap;
    if (receiver == ReceiverPhase::kKnown && !path_error && m.modes == 0) {  // each node by itself
      gap = static_cast<double>(n) / m.noise[i] *
            (w.best.amplitude[i] * w.best.amplitude[i] - w.second.amplitude[i] * w.second.amplitude[i]);
    }
    const double away = std::abs(wrap_to_pi(w.second.theta[i] - w.best.theta[i]));
    if (gap < kGap && away > std::max(kApartRad, 4.0 * std::sqrt(variance(i)))) {
      w.alternative[i] = wrap_to_pi(w.second.theta[i]);
      two = true;
    }
  }
  out.bearing_rad = w.bearing;
  out.alternative_rad = w.alternative;
  out.covariance_rad2 = w.covariance;
  out.frequency_hz = w.frequency;
  out.amplitude = w.amplitude;
  out.phase_rad = w.phase;
  out.status = two ? ApertureStatus::kTwoAnswers : ApertureStatus::kOk;
  return out;
}

BlindAperture SyntheticAperture::estimate_blind(const ApertureData& data) {
  require_data(data, true, false);
  Work& w = *work_;
  ApertureModel& m = w.model;
  BlindAperture out;
  out.status = fill_model(data, options_, false, m, out.index);
  if (out.status != ApertureStatus::kOk) return out;
  out.status = fill_phasors(data, options_, m, out.index);
  if (out.status != ApertureStatus::kOk) return out;
  out.status = ApertureStatus::kTooFewNodes;
  if (m.nodes < 5) return out;
  m.receiver = ReceiverPhase::kFree;
  out.status = ApertureStatus::kSingular;
  if (!start_blind(m, options_.frequency_offsets)) return out;
  const bool own = !(options_.noise_variance > 0.0);
  const bool settled = m.solve(2 * kFineSteps, kSettledRad, own, out.iterations);
  out.noise_variance = m.noise[0];
  out.status = ApertureStatus::kNoConvergence;
  if (!settled) return out;
  const std::size_t worst = w.least_coherent_blind();
  if (w.coherence[worst] < options_.coherence_threshold) {
    out.index = static_cast<int>(worst);
    out.status = ApertureStatus::kTooFewCoherent;
    return out;
  }
  out.status = ApertureStatus::kSingular;
  if (!m.invert()) return out;
  const std::size_t nodes = m.nodes;
  w.bearing.assign(nodes, 0.0);
  w.covariance.assign(nodes * nodes, 0.0);
  w.path.assign(2 * m.n, 0.0);
  for (std::size_t i = 1; i < nodes; ++i) {
    w.bearing[i] = wrap_to_pi(m.theta[i] - m.theta[0]);
    for (std::size_t j = 1; j < nodes; ++j) {
      w.covariance[i * nodes + j] = m.covariance(ApertureModel::kPerNode * i, ApertureModel::kPerNode * j);
    }
    if (!(w.covariance[i * nodes + i] <= options_.max_sigma_rad * options_.max_sigma_rad)) {
      out.index = static_cast<int>(i);
      return out;
    }
  }
  for (std::size_t k = 0; k < m.n; ++k) {
    w.path[2 * k] = m.dx[k] - m.dx[0];
    w.path[2 * k + 1] = m.dy[k] - m.dy[0];
  }
  out.bearing_rad = w.bearing;
  out.covariance_rad2 = w.covariance;
  out.path_m = w.path;
  out.status = ApertureStatus::kOk;
  return out;
}

Eigen::MatrixXd aperture_crlb(const ApertureData& data, std::span<const double> bearing_rad,
                              std::span<const double> snr, const ApertureOptions& options) {
  require_options(options);
  require_data(data, false, true);
  ApertureModel m;
  int index = -1;
  const ApertureStatus status = fill_model(data, options, true, m, index);
  if (status != ApertureStatus::kOk && status != ApertureStatus::kStepTooLong &&
      status != ApertureStatus::kPathTooShort) {
    throw std::invalid_argument("path_m, time_s: " + std::string(to_string(status)));
  }
  require_size("bearing_rad", bearing_rad.size(), m.nodes, "one per node");
  require_size("snr", snr.size(), m.nodes, "one per node");
  for (std::size_t i = 0; i < m.nodes; ++i) {
    require(std::isfinite(snr[i]) && snr[i] > 0.0, "snr", snr[i], "it must be finite and positive");
    require(std::isfinite(bearing_rad[i]), "bearing_rad", bearing_rad[i], "it must be finite");
    m.theta[i] = bearing_rad[i];
    m.amplitude[i] = std::sqrt(snr[i]);
    m.noise[i] = 1.0;
    m.power[i] = snr[i];
    for (std::size_t k = 0; k < m.n; ++k) m.y[k * m.nodes + i] = 0.0;
  }
  fix_gauge(m, options.frequency_offsets, 0, true);
  if (!m.invert()) {
    throw std::invalid_argument("path_m: this path and these nodes do not determine the bearings (singular)");
  }
  Eigen::MatrixXd out(m.nodes, m.nodes);
  for (std::size_t i = 0; i < m.nodes; ++i) {
    for (std::size_t j = 0; j < m.nodes; ++j) {
      out(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j)) =
          m.covariance(ApertureModel::kPerNode * i, ApertureModel::kPerNode * j);
    }
  }
  return out;
}

}  // namespace soopnav::array
