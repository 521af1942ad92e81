#include "navigation/source_bank.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "soopnav/core/constants.hpp"

namespace soopnav::navigation::detail {
namespace {

// Members below this share of the best are not followed any further.
constexpr double kDead = -30.0;
// Heading bias that a member is started with at most (1 sigma): a bank of unsplit ones is sure of a wrong range.
constexpr double kBiasPiece = 0.02;
constexpr double kBiasSpan = 3.0;  // sigmas that the pieces cover to either side
constexpr std::size_t kMostPieces = 61;

// Pieces of the prior of the heading bias, 2 `piece` apart.
struct BiasPieces {
  std::size_t count = 1;
  double piece = 0.0;
};
BiasPieces bias_pieces(const SourceOptions& options) noexcept {
  const double sigma_rad = options.heading_bias_sigma_rad;
  // A search that begins at the bank's answer corrects it.
  if (!(sigma_rad > kBiasPiece) || options.method != SourceMethod::kEkfBank) return {1, sigma_rad};
  const double wanted = std::ceil(kBiasSpan * sigma_rad / (2.0 * kBiasPiece));
  const std::size_t half = std::min(static_cast<std::size_t>(std::min(wanted, 1e3)), (kMostPieces - 1) / 2);
  return {2 * half + 1, kBiasSpan * sigma_rad / (2.0 * static_cast<double>(half))};
}

}  // namespace

void finish_start(const SourceOptions& options, const Layout& layout, Gaussian& g) noexcept {
  if (layout.moving) {
    for (std::size_t i = 0; i < layout.dimensions; ++i) {
      g.P[layout.dimensions + i][layout.dimensions + i] = options.start_speed_sigma_mps * options.start_speed_sigma_mps;
    }
  }
  if (layout.biased) {
    g.P[layout.bias()][layout.bias()] = options.heading_bias_sigma_rad * options.heading_bias_sigma_rad;
  }
}

void start_along(const SourceOptions& options, const Layout& layout, const Kept& kept, double azimuth,
                 double sigma_azimuth_rad, double range_m, double sigma_range_m, Gaussian& g) noexcept {
  g = {};
  const double c = std::cos(azimuth);
  const double s = std::sin(azimuth);
  const bool space = layout.dimensions == 3;
  const double ce = space ? std::cos(kept.b.elevation) : 1.0;
  const double se = space ? std::sin(kept.b.elevation) : 0.0;
  const std::array<std::array<double, 3>, 3> axes = {
      {{ce * c, ce * s, se}, {-s, c, 0.0}, {-se * c, -se * s, ce}}};  // outward, to the left, up
  const std::array<double, 3> sigma = {sigma_range_m, std::max(range_m * ce, 1e-3) * sigma_azimuth_rad,
                                       range_m * std::sqrt(kept.b.variance_elevation)};
  const std::array<double, 3> place = {kept.b.x, kept.b.y, kept.b.z};
  const std::array<double, 6> pose = {kept.b.xx, kept.b.xy, kept.b.yy, kept.b.xz, kept.b.yz, kept.b.zz};
  for (std::size_t i = 0; i < layout.dimensions; ++i) {
    g.x[i] = place[i] + range_m * axes[0][i];
    for (std::size_t j = 0; j < layout.dimensions; ++j) {
      for (std::size_t k = 0; k < layout.dimensions; ++k) {
        g.P[i][j] += sigma[k] * sigma[k] * axes[k][i] * axes[k][j];
      }
      g.P[i][j] += pose[std::max(i, j) == 2 ? 3 + std::min(i, j) : i + j];
    }
  }
  finish_start(options, layout, g);
  if (layout.biased) {  // the bearing that places the state carries the bias across
    const std::size_t b = layout.bias();
    const double variance = g.P[b][b];
    const double across = range_m * ce;
    for (std::size_t i = 0; i < 2; ++i) {
      g.P[i][b] = g.P[b][i] = -across * axes[1][i] * variance;
      for (std::size_t j = 0; j < 2; ++j) g.P[i][j] += across * across * axes[1][i] * axes[1][j] * variance;
    }
  }
}

EkfBank::EkfBank(const SourceOptions& options, const Layout& layout) : options_(options), layout_(layout) {
  const bool needed = options.method == SourceMethod::kEkfBank ||
                      (layout.moving && (options.method == SourceMethod::kMaximumLikelihood ||
                                         options.method == SourceMethod::kLeastSquares));
  if (needed) {
    members_.resize(static_cast<std::size_t>(options.filters) *
                    static_cast<std::size_t>(std::max(options.bank_azimuths, 1)) * bias_pieces(options).count);
  }
}

void EkfBank::clear() noexcept { started_ = false; }

double EkfBank::weight(std::size_t i) const noexcept {
  double total = 0.0;
  for (const Member& m : members_) total += std::exp(m.log_weight);
  return std::exp(members_[i].log_weight) / total;
}

void EkfBank::start(const Kept& kept) noexcept {
  const auto ranges = static_cast<std::size_t>(options_.filters);
  const auto directions = static_cast<std::size_t>(std::max(options_.bank_azimuths, 1));
  const double ratio = std::pow(options_.max_range_m / options_.min_range_m, 1.0 / (static_cast<double>(ranges) - 1.0));
  // Neighbours meet at one sigma.
  const double spread = (ratio - 1.0) / (ratio + 1.0);
  double range = options_.min_range_m;
  const double sigma_bias = options_.heading_bias_sigma_rad;
  const BiasPieces biases = bias_pieces(options_);
  SourceOptions piece = options_;
  piece.heading_bias_sigma_rad = biases.piece;
  // The pieces' centres vary by what their own width leaves of the prior.
  const double variance = sigma_bias * sigma_bias - biases.piece * biases.piece;
  std::size_t next = 0;
  for (std::size_t i = 0; i < ranges; ++i) {
    for (std::size_t k = 0; k < directions; ++k) {
      const bool all_round = options_.bank_azimuths > 0;
      const double width = kTwoPi / static_cast<double>(directions);
      const double azimuth = all_round ? width * static_cast<double>(k) : kept.azimuth;
      const double sigma = all_round ? 0.5 * width : std::sqrt(kept.b.variance_azimuth);
      for (std::size_t j = 0; j < biases.count; ++j) {
        const double bias = (2.0 * static_cast<double>(j) - static_cast<double>(biases.count - 1)) * biases.piece;
        Member& m = members_[next++];
        start_along(piece, layout_, kept, azimuth - bias, sigma, range, spread * range, m.g);
        if (layout_.biased) m.g.x[layout_.bias()] = bias;
        m.log_weight = biases.count > 1 ? -0.5 * bias * bias / variance : 0.0;
      }
    }
    range *= ratio;
  }
  started_ = true;
  t_s_ = kept.t_s;
}

BearingUse EkfBank::step(const Kept& kept) noexcept {
  const bool all_round = options_.bank_azimuths > 0;
  if (!started_) {
    const double limit = options_.bank_sigma_rad * options_.bank_sigma_rad;
    const bool good = kept.b.variance_azimuth < limit && (layout_.dimensions == 2 || kept.b.variance_elevation < limit);
    if (!all_round && !good) return BearingUse::kWaiting;
    start(kept);
    if (!all_round) return BearingUse::kUsed;  // the bearing is where they stand
  }
  const double dt_s = kept.t_s - t_s_;
  t_s_ = kept.t_s;
  const double floor = options_.outlier_probability / (layout_.dimensions == 3 ? kTwoPi * kPi : kTwoPi);
  bool any = false;
  double best = -std::numeric_limits<double>::infinity();
  for (Member& m : members_) {
    if (m.log_weight < kDead) continue;
    propagate(layout_, dt_s, options_.acceleration_psd, m.g);
    double density = 0.0;
    if (update(layout_, kept.t_s, kept, m.g, density)) {
      // With the floor one bearing from anywhere cannot wake a wrong member. All are moved by it: one that refused
      // bearings would stay where it went wrong.
      const double normal = (1.0 - options_.outlier_probability) * std::exp(density);
      m.log_weight += floor > 0.0 ? std::log(normal + floor) : density;
      any = true;
    } else {
      m.log_weight += kDead;  // it stands on the platform, from where the bearing has no density
    }
    best = std::max(best, m.log_weight);
  }
  for (Member& m : members_) m.log_weight = std::max(m.log_weight - best, 2.0 * kDead);
  return any ? BearingUse::kUsed : BearingUse::kUndefined;
}

bool EkfBank::score(const Kept& kept, double& log_density, double& nis) const noexcept {
  const std::size_t n = layout_.size();
  double total = 0.0;
  double density = 0.0;
  nis = std::numeric_limits<double>::infinity();
  for (const Member& m : members_) {
    if (m.log_weight < kDead) continue;
    const double weight = std::exp(m.log_weight);
    total += weight;
    Gaussian g = m.g;
    propagate(layout_, kept.t_s - t_s_, options_.acceleration_psd, g);
    Angles angles;
    if (!predict(layout_, g.x, kept.t_s, kept, angles)) continue;
    double square = 0.0;
    double volume = 1.0;
    for (std::size_t row = 0; row + 1 < layout_.dimensions; ++row) {  // the angles taken as independent
      double s = angles.variance[row];
      for (std::size_t i = 0; i < n; ++i) {
        for (std::size_t j = 0; j < n; ++j) s += angles.gradient[row][i] * g.P[i][j] * angles.gradient[row][j];
      }
      square += angles.residual[row] * angles.residual[row] / s;
      volume *= kTwoPi * s;
    }
    density += weight * std::exp(-0.5 * square) / std::sqrt(volume);
    if (weight > 0.01) nis = std::min(nis, square);
  }
  if (!(density > 0.0) || !(total > 0.0)) return false;
  log_density = std::log(density / total);
  return true;
}

bool EkfBank::moments(Gaussian& merged) const noexcept {
  if (!started_) return false;
  const std::size_t n = layout_.size();
  merged = {};
  double total = 0.0;
  for (const Member& m : members_) {
    if (m.log_weight < kDead) continue;
    const double w = std::exp(m.log_weight);
    total += w;
    for (std::size_t i = 0; i < n; ++i) merged.x[i] += w * m.g.x[i];
  }
  if (!(total > 0.0)) return false;
  for (std::size_t i = 0; i < n; ++i) merged.x[i] /= total;
  for (const Member& m : members_) {
    if (m.log_weight < kDead) continue;
    const double w = std::exp(m.log_weight) / total;
    for (std::size_t i = 0; i < n; ++i) {
      for (std::size_t j = 0; j < n; ++j) {
        merged.P[i][j] += w * (m.g.P[i][j] + (m.g.x[i] - merged.x[i]) * (m.g.x[j] - merged.x[j]));
      }
      if (!std::isfinite(merged.x[i])) return false;
    }
  }
  return true;
}

}  // namespace soopnav::navigation::detail
