#include "soopnav/gnss/baseline.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <string>

#include "eigen.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/estimation/chi_square.hpp"

namespace soopnav::gnss {

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kMaxSphereM = 10.0;
constexpr double kGridStep = 0.13;        // of the sphere, wavelengths
constexpr std::size_t kBlock = 64;        // points of the sphere at a time
constexpr double kMinInformation = 1e-6;  // smallest over largest eigenvalue of a determined position
constexpr double kLowestSine = 1e-3;      // of an elevation: weights stay finite without a mask
constexpr double kLargest = 1e12;         // code [m] or phase [cycles]; its differences still tell 1e-3 cycles
constexpr double kRefusedFixes = 1e-3;    // probability that right integers have residuals that refuse them

[[noreturn]] void refuse(const char* name, double value, const char* rule) {
  throw std::invalid_argument(std::string(name) + " = " + std::to_string(value) + ": " + rule + " expected");
}

// Nearest whole number of |x| < 2^51, in a form that compilers vectorise.
inline double nearest(double x) noexcept {
  constexpr double kShift = 6755399441055744.0;  // 1.5 * 2^52
  return (x + kShift) - kShift;
}

}  // namespace

std::string_view to_string(BaselineStatus status) noexcept {
  switch (status) {
    case BaselineStatus::kFixed:
      return "fixed";
    case BaselineStatus::kTracked:
      return "tracked";
    case BaselineStatus::kFloat:
      return "float";
    case BaselineStatus::kTooFewSatellites:
      return "too few satellites";
    case BaselineStatus::kDegenerate:
      return "degenerate";
  }
  return "unknown";
}

void BaselineOptions::check() const {
  const auto positive = [](double x) { return x > 0.0 && std::isfinite(x); };
  if (!positive(wavelength_m)) refuse("wavelength_m", wavelength_m, "a positive number");
  if (!positive(phase_sigma_m)) refuse("phase_sigma_m", phase_sigma_m, "a positive number");
  if (!(code_phase_ratio > 1.0 && std::isfinite(code_phase_ratio))) {
    refuse("code_phase_ratio", code_phase_ratio, "a number above 1");
  }
  if (!(mask_rad >= 0.0 && mask_rad < 0.5 * kPi)) refuse("mask_rad", mask_rad, "0 ... pi/2");
  if (!(ratio >= 1.0 && std::isfinite(ratio))) refuse("ratio", ratio, "at least 1");
  if (length_m && !positive(*length_m)) refuse("length_m", *length_m, "a positive number");
  if (length_m && search == ConstraintSearch::kSphere && *length_m > kMaxSphereM) {
    refuse("length_m", *length_m, "at most 10 m for the search of the sphere (take the candidates)");
  }
  if (candidates < 2 || candidates > 10'000) refuse("candidates", candidates, "2 ... 10 000");
  if (!(max_pitch_rad > 0.0 && max_pitch_rad <= 0.5 * kPi)) refuse("max_pitch_rad", max_pitch_rad, "(0, pi/2]");
  if (max_satellites != 0 && max_satellites < 4) refuse("max_satellites", max_satellites, "0 (all) or at least 4");
}

// The satellites used, highest first, and the quadratic forms of one epoch.
struct BaselineSolver::Epoch {
  std::size_t m = 0;
  std::array<std::size_t, kMaxBaselineSatellites> source{};  // index in the caller's list
  std::array<double, kMaxBaselineSatellites> x{}, y{}, z{};  // rows -u of the design matrix
  std::array<double, kMaxBaselineSatellites> code{};         // minus the first's [m]
  std::array<double, kMaxBaselineSatellites> fraction{};     // phase minus the first's minus `whole` [m]
  std::array<double, kMaxBaselineSatellites> whole{};        // [cycles]
  std::array<double, kMaxBaselineSatellites> weight{};       // of the phase, 1 / variance
  double total_weight = 0.0;
  Eigen::Vector3d mean_row = Eigen::Vector3d::Zero();  // weighted mean of the rows
  Eigen::Matrix3d code_information, information;       // of the code alone, of both with integers known
  Eigen::Matrix3d covariance, code_covariance;         // their inverses, the latter's first
  Eigen::Matrix3d axes;                                // eigenvectors of `information`
  Eigen::Vector3d curvature;                           // its eigenvalues, ascending
  Eigen::Vector3d float_b;

  [[nodiscard]] Eigen::Vector3d row(std::size_t s) const noexcept { return {x[s], y[s], z[s]}; }
};

// The two best integer vectors so far.
struct BaselineSolver::Best {
  using Integers = std::array<double, kMaxBaselineSatellites>;
  std::array<double, 2> objective{kInfinity, kInfinity};
  std::array<Integers, 2> integers{};
  std::array<Eigen::Vector3d, 2> b{Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()};

  [[nodiscard]] bool holds(const Integers& n, std::size_t m) const noexcept {
    for (std::size_t k = 0; k < 2; ++k) {
      if (objective[k] < kInfinity &&
          std::equal(n.begin(), n.begin() + static_cast<std::ptrdiff_t>(m), integers[k].begin())) {
        return true;
      }
    }
    return false;
  }
  void offer(const Integers& n, const Eigen::Vector3d& at, double value) noexcept {
    if (!(value < objective[1])) return;
    const std::size_t slot = value < objective[0] ? 0 : 1;
    if (slot == 0) {
      objective[1] = objective[0];
      integers[1] = integers[0];
      b[1] = b[0];
    }
    objective[slot] = value;
    integers[slot] = n;
    b[slot] = at;
  }
};

namespace {

// The point of |b| = length where (b - c)' M (b - c) is least, M with eigenvectors `axes` and ascending eigenvalues
// `curvature` (eq. 11): b = (M + mu I)^-1 M c, mu the root above -curvature[0] of the secular equation |b(mu)| =
// length.
Eigen::Vector3d nearest_on_sphere(const Eigen::Matrix3d& axes, const Eigen::Vector3d& curvature,
                                  const Eigen::Vector3d& c, double length) noexcept {
  const Eigen::Vector3d p = curvature.cwiseProduct(axes.transpose() * c);
  const auto at = [&](double mu) -> Eigen::Vector3d { return p.array() / (curvature.array() + mu); };
  // |b| >= |p_0| / (curvature_0 + mu), so the root lies above `low`; |b| <= |p| / (curvature_0 + mu): below `high`.
  double low = -curvature[0] + std::abs(p[0]) / length;
  double high = -curvature[0] + p.norm() / length;
  const double floor = -curvature[0] + 1e-14 * curvature[2];
  low = std::max(low, floor);
  high = std::max(high, floor);
  double mu = low;
  Eigen::Vector3d b = at(mu);
  for (int i = 0; i < 60 && high > low; ++i) {
    const double norm = b.norm();
    if (std::abs(norm - length) <= 1e-12 * length) break;
    (norm > length ? low : high) = mu;
    // Newton on 1/|b| - 1/length, nearly linear in mu.
    const double slope = -(b.array().square() / (curvature.array() + mu)).sum() / norm;
    double next = mu + (norm / length - 1.0) * norm / -slope;
    if (!(next > low && next < high)) next = 0.5 * (low + high);
    if (next == mu) break;
    mu = next;
    b = at(mu);
  }
  // Without a root (c on the plane of the stiff axes): what is missing lies along the soft axis, either way.
  const double missing = length * length - b.squaredNorm();
  if (missing > 1e-9 * length * length) b[0] = std::copysign(std::sqrt(missing + b[0] * b[0]), b[0]);
  b = axes * b;
  return b * (length / b.norm());
}

}  // namespace

BaselineSolver::BaselineSolver(const BaselineOptions& options)
    : options_(options),
      ils_(options.length_m && options.search == ConstraintSearch::kCandidates ? std::max(2, options.candidates) : 2),
      lowest_(std::sin(options.mask_rad)) {
  options.check();
  for (std::size_t dof = 1; dof < highest_objective_.size(); ++dof) {
    highest_objective_[dof] = chi_square_upper_quantile(kRefusedFixes, static_cast<double>(dof));
  }
  if (!options.length_m || options.search != ConstraintSearch::kSphere) return;
  // Golden-angle points between the latitudes allowed: about equally far from each other everywhere.
  const double step = kGridStep * options.wavelength_m / *options.length_m;
  const double top = std::min(1.0, std::sin(std::min(options.max_pitch_rad + step, 0.5 * kPi)));
  const auto count = static_cast<std::size_t>(std::max(64.0, std::ceil(4.0 * kPi * top / (step * step))));
  grid_.resize(3 * count);
  order_.resize(count);
  constexpr double kGoldenAngle = 2.399963229728653;
  for (std::size_t i = 0; i < count; ++i) {
    const double up = top * (1.0 - (2.0 * static_cast<double>(i) + 1.0) / static_cast<double>(count));
    const double level = std::sqrt(std::max(0.0, 1.0 - up * up));
    const double turn = kGoldenAngle * static_cast<double>(i);
    grid_[i] = *options.length_m * level * std::cos(turn);
    grid_[count + i] = *options.length_m * level * std::sin(turn);
    grid_[2 * count + i] = *options.length_m * up;
  }
}

bool BaselineSolver::usable(const BaselineSatellite& satellite) const noexcept {
  return satellite.direction.allFinite() && std::abs(satellite.direction.squaredNorm() - 1.0) < 1e-6 &&
         std::abs(satellite.code_m) <= kLargest && std::abs(satellite.phase_cycles) <= kLargest &&
         satellite.direction.z() >= std::max(lowest_, kLowestSine);
}

double BaselineSolver::phase_variance_m2(const BaselineSatellite& satellite) const noexcept {
  const double sine = satellite.direction.z();
  return options_.phase_sigma_m * options_.phase_sigma_m * (1.0 + 1.0 / (sine * sine));
}

bool BaselineSolver::prepare(std::span<const BaselineSatellite> satellites, Epoch& epoch,
                             BaselineFix& fix) const noexcept {
  for (std::size_t i = 0; i < satellites.size() && epoch.m < kMaxBaselineSatellites; ++i) {
    if (usable(satellites[i])) epoch.source[epoch.m++] = i;
  }
  const auto begin = epoch.source.begin();
  std::sort(begin, begin + static_cast<std::ptrdiff_t>(epoch.m), [&](std::size_t a, std::size_t b) {
    const double up = satellites[a].direction.z(), other = satellites[b].direction.z();
    return up != other ? up > other : a < b;
  });
  if (options_.max_satellites > 0) epoch.m = std::min(epoch.m, static_cast<std::size_t>(options_.max_satellites));
  for (std::size_t s = 0; s < epoch.m; ++s) static_cast<void>(fix.ids.push_back(satellites[epoch.source[s]].id));
  if (epoch.m < 4) {
    fix.status = BaselineStatus::kTooFewSatellites;
    return false;
  }
  const BaselineSatellite& first = satellites[epoch.source[0]];
  for (std::size_t s = 0; s < epoch.m; ++s) {
    const BaselineSatellite& satellite = satellites[epoch.source[s]];
    epoch.x[s] = -satellite.direction.x();
    epoch.y[s] = -satellite.direction.y();
    epoch.z[s] = -satellite.direction.z();
    epoch.code[s] = satellite.code_m - first.code_m;
    const double cycles = satellite.phase_cycles - first.phase_cycles;
    epoch.whole[s] = std::round(cycles);
    epoch.fraction[s] = (cycles - epoch.whole[s]) * options_.wavelength_m;
    epoch.weight[s] = 1.0 / phase_variance_m2(satellite);
    epoch.total_weight += epoch.weight[s];
    epoch.mean_row += epoch.weight[s] * epoch.row(s);
  }
  epoch.mean_row /= epoch.total_weight;
  return true;
}

// b from the code, and the information that code and phase carry (eq. 8).
bool BaselineSolver::inform(Epoch& epoch, double code_phase_ratio, BaselineFix& fix) noexcept {
  Eigen::Matrix3d phase_information = Eigen::Matrix3d::Zero();
  Eigen::Vector3d right = Eigen::Vector3d::Zero();
  for (std::size_t s = 0; s < epoch.m; ++s) {
    const Eigen::Vector3d row = epoch.row(s) - epoch.mean_row;
    phase_information += epoch.weight[s] * row * row.transpose();
    right += epoch.weight[s] * epoch.code[s] * row;
  }
  const double share = 1.0 / (code_phase_ratio * code_phase_ratio);
  epoch.code_information = share * phase_information;
  epoch.information = phase_information + epoch.code_information;
  const detail::SymmetricEigen<3> eigen(epoch.information);
  epoch.axes = eigen.vectors;
  epoch.curvature = eigen.values;
  if (!(epoch.curvature[0] > kMinInformation * epoch.curvature[2])) {
    fix.status = BaselineStatus::kDegenerate;
    return false;
  }
  epoch.covariance = epoch.axes * epoch.curvature.cwiseInverse().asDiagonal() * epoch.axes.transpose();
  epoch.code_covariance = epoch.covariance * ((1.0 + share) / share);
  epoch.float_b = (epoch.covariance * right) * (1.0 + share);
  fix.float_m = epoch.float_b;
  return true;
}

// Float integers and their covariance in cycles, decorrelated (eq. 9).
bool BaselineSolver::float_integers(const Epoch& epoch, BaselineFix& fix) noexcept {
  const auto n = static_cast<Eigen::Index>(epoch.m - 1);
  Eigen::Matrix<double, Eigen::Dynamic, 3, 0, kMaxAmbiguities, 3> G(n, 3);
  IntegerLeastSquares::Vector a(n);
  for (Eigen::Index s = 0; s < n; ++s) {
    const auto k = static_cast<std::size_t>(s) + 1;
    G.row(s) = (epoch.row(k) - epoch.row(0)).transpose();
    a[s] = (epoch.fraction[k] - G.row(s).dot(epoch.float_b)) / options_.wavelength_m;
  }
  IntegerLeastSquares::Matrix Q(n, n);
  Q.noalias() = G.lazyProduct(epoch.code_covariance).lazyProduct(G.transpose());
  Q.array() += 1.0 / epoch.weight[0];
  for (Eigen::Index s = 0; s < n; ++s) Q(s, s) += 1.0 / epoch.weight[static_cast<std::size_t>(s) + 1];
  Q /= options_.wavelength_m * options_.wavelength_m;
  const bool sphere = options_.length_m && options_.search == ConstraintSearch::kSphere;
  const IntegerStatus status = sphere ? ils_.decorrelate(Q) : ils_.solve(a, Q);
  if (status != IntegerStatus::kSolved) {
    fix.status = BaselineStatus::kDegenerate;
    return false;
  }
  fix.success_rate = ils_.success_rate();
  return true;
}

namespace {

// Gradient of the phase's objective at b with integers n: sum of w (row - mean row) (phase - lambda n - row b).
template <class Epoch, class Integers>
Eigen::Vector3d phase_gradient(const Epoch& epoch, const Integers& n, double wavelength,
                               const Eigen::Vector3d& b) noexcept {
  Eigen::Vector3d gradient = Eigen::Vector3d::Zero();
  for (std::size_t s = 0; s < epoch.m; ++s) {
    const double r = epoch.fraction[s] - wavelength * n[s] - epoch.row(s).dot(b);
    gradient += epoch.weight[s] * r * (epoch.row(s) - epoch.mean_row);
  }
  return gradient;
}

// The unconstrained baseline of integers n, by one step from the code's (exact: the problem is linear).
template <class Epoch, class Integers>
Eigen::Vector3d fixed_baseline(const Epoch& epoch, const Integers& n, double wavelength) noexcept {
  return epoch.float_b + epoch.covariance * phase_gradient(epoch, n, wavelength, epoch.float_b);
}

// (phase residuals)' W (phase residuals) + (b - code's b)' M_code (b - code's b): eq. 9 at any b.
template <class Epoch, class Integers>
double objective(const Epoch& epoch, const Integers& n, double wavelength, const Eigen::Vector3d& b) noexcept {
  double squares = 0.0, sum = 0.0;
  for (std::size_t s = 0; s < epoch.m; ++s) {
    const double r = epoch.fraction[s] - wavelength * n[s] - epoch.row(s).dot(b);
    squares += epoch.weight[s] * r * r;
    sum += epoch.weight[s] * r;
  }
  const Eigen::Vector3d off = b - epoch.float_b;
  return squares - sum * sum / epoch.total_weight + off.dot(epoch.code_information * off);
}

}  // namespace

void BaselineSolver::search_candidates(const Epoch& epoch, Best& best) noexcept {
  const double wavelength = options_.wavelength_m;
  for (int k = 0; k < ils_.count(); ++k) {
    const auto z = ils_.candidate(k);
    Best::Integers n{};
    std::copy(z.begin(), z.end(), n.begin() + 1);
    Eigen::Vector3d b = fixed_baseline(epoch, n, wavelength);
    if (options_.length_m) b = nearest_on_sphere(epoch.axes, epoch.curvature, b, *options_.length_m);
    best.offer(n, b, options_.length_m ? objective(epoch, n, wavelength, b) : ils_.squared_norm(k));
  }
}

// A lower bound of the objective for the integers to which each of `count` points of the sphere rounds (eq. 12).
void BaselineSolver::bound_block(const Epoch& epoch, std::size_t first, std::size_t count) noexcept {
  const std::size_t points = order_.size();
  const double wavelength = options_.wavelength_m;
  const double per_cycle = 1.0 / wavelength;
  std::array<double, kBlock> bx{}, by{}, bz{}, sum{}, squares{}, gx{}, gy{}, gz{};
  for (std::size_t i = 0; i < count; ++i) {
    bx[i] = grid_[first + i];
    by[i] = grid_[points + first + i];
    bz[i] = grid_[2 * points + first + i];
  }
  for (std::size_t s = 1; s < epoch.m; ++s) {
    const double hx = epoch.x[s] - epoch.x[0], hy = epoch.y[s] - epoch.y[0], hz = epoch.z[s] - epoch.z[0];
    const double phase = epoch.fraction[s], w = epoch.weight[s];
    const double wx = w * epoch.x[s], wy = w * epoch.y[s], wz = w * epoch.z[s];
    for (std::size_t i = 0; i < kBlock; ++i) {
      const double full = phase - (hx * bx[i] + hy * by[i] + hz * bz[i]);
      const double r = full - wavelength * nearest(full * per_cycle);
      sum[i] += w * r;
      squares[i] += w * r * r;
      gx[i] += wx * r;
      gy[i] += wy * r;
      gz[i] += wz * r;
    }
  }
  const double per_weight = 1.0 / epoch.total_weight;
  const double length = *options_.length_m;
  for (std::size_t i = 0; i < count; ++i) {
    const Eigen::Vector3d b(bx[i], by[i], bz[i]);
    const Eigen::Vector3d off = epoch.float_b - b;
    const Eigen::Vector3d pull = epoch.code_information * off;
    const Eigen::Vector3d gradient = Eigen::Vector3d(gx[i], gy[i], gz[i]) - epoch.mean_row * sum[i] + pull;
    const Eigen::Vector3d step = epoch.covariance * gradient;
    const double free = squares[i] - sum[i] * sum[i] * per_weight + off.dot(pull) - gradient.dot(step);
    const double gap = (b + step).norm() - length;
    order_[first + i] = {free + epoch.curvature[0] * gap * gap, static_cast<std::uint32_t>(first + i)};
  }
}

// Every point of the sphere rounds to integers; the objective is worked out in the order of its lower bounds until
// these exceed the second best.
void BaselineSolver::search_sphere(const Epoch& epoch, Best& best) noexcept {
  const std::size_t points = order_.size();
  for (std::size_t first = 0; first < points; first += kBlock) {
    bound_block(epoch, first, std::min(kBlock, points - first));
  }
  const double wavelength = options_.wavelength_m;
  const auto later = [](const auto& a, const auto& b) { return a > b; };
  std::make_heap(order_.begin(), order_.end(), later);
  for (auto end = order_.end(); end != order_.begin(); --end) {
    std::pop_heap(order_.begin(), end, later);
    const auto [bound, index] = *(end - 1);
    if (bound > best.objective[1]) return;
    const Eigen::Vector3d point(grid_[index], grid_[points + index], grid_[2 * points + index]);
    Best::Integers n{};
    for (std::size_t s = 1; s < epoch.m; ++s) {
      n[s] = nearest((epoch.fraction[s] - (epoch.row(s) - epoch.row(0)).dot(point)) / wavelength);
    }
    if (best.holds(n, epoch.m)) continue;
    const Eigen::Vector3d b =
        nearest_on_sphere(epoch.axes, epoch.curvature, fixed_baseline(epoch, n, wavelength), *options_.length_m);
    best.offer(n, b, objective(epoch, n, wavelength, b));
  }
}

namespace {

// Heading and pitch of a baseline with their sigmas (eq. 13).
void read_angles(BaselineFix& fix) noexcept {
  const Eigen::Vector3d& b = fix.baseline_m;
  const double level2 = b.head<2>().squaredNorm();
  const double full2 = b.squaredNorm();
  if (!(full2 > 0.0)) return;
  const double level = std::sqrt(level2);
  fix.pitch_rad = std::atan2(b.z(), level);
  if (!(level > 1e-9 * std::sqrt(full2))) return;
  fix.heading_rad = std::atan2(b.x(), b.y());
  if (fix.heading_rad < 0.0) fix.heading_rad += kTwoPi;
  const Eigen::Vector3d heading_row(b.y() / level2, -b.x() / level2, 0.0);
  const Eigen::Vector3d pitch_row(-b.x() * b.z() / (level * full2), -b.y() * b.z() / (level * full2), level / full2);
  fix.heading_sigma_rad = std::sqrt(heading_row.dot(fix.covariance_m2 * heading_row));
  fix.pitch_sigma_rad = std::sqrt(pitch_row.dot(fix.covariance_m2 * pitch_row));
}

// What is left of `information` on the tangent plane of the sphere at b.
Eigen::Matrix3d on_sphere(const Eigen::Matrix3d& information, const Eigen::Vector3d& b) noexcept {
  Eigen::Vector3d normal = b.normalized();
  Eigen::Index least = 0;
  normal.cwiseAbs().minCoeff(&least);
  Eigen::Matrix<double, 3, 2> tangent;
  tangent.col(0) = normal.cross(Eigen::Vector3d::Unit(least)).normalized();
  tangent.col(1) = normal.cross(tangent.col(0));
  const Eigen::Matrix2d inner = tangent.transpose() * information * tangent;
  return tangent * inner.llt().solve(tangent.transpose());
}

}  // namespace

void BaselineSolver::finish(const Epoch& epoch, const Best& best, BaselineFix& fix) const noexcept {
  if (!std::isfinite(best.b[0].squaredNorm()) || !std::isfinite(epoch.float_b.squaredNorm())) {
    fix.status = BaselineStatus::kDegenerate;  // no angles could be read
    return;
  }
  fix.best_m = best.b[0];
  double mean = 0.0;
  for (std::size_t s = 0; s < epoch.m; ++s) {
    static_cast<void>(fix.integers.push_back(best.integers[0][s] + epoch.whole[s]));
    const double r = epoch.fraction[s] - options_.wavelength_m * best.integers[0][s] - epoch.row(s).dot(best.b[0]);
    static_cast<void>(fix.residuals_m.push_back(r));
    mean += epoch.weight[s] * r / epoch.total_weight;
  }
  for (double& r : fix.residuals_m) r -= mean;
  if (fix.fixed()) {
    fix.baseline_m = best.b[0];
    fix.covariance_m2 = options_.length_m ? on_sphere(epoch.information, best.b[0]) : epoch.covariance;
  } else {
    fix.baseline_m = epoch.float_b;
    fix.covariance_m2 = epoch.code_covariance;
  }
  read_angles(fix);
}

BaselineFix BaselineSolver::solve(std::span<const BaselineSatellite> satellites) noexcept {
  BaselineFix fix;
  Epoch epoch;
  if (!prepare(satellites, epoch, fix) || !inform(epoch, options_.code_phase_ratio, fix) ||
      !float_integers(epoch, fix)) {
    return fix;
  }
  Best best;
  if (options_.length_m && options_.search == ConstraintSearch::kSphere) {
    search_sphere(epoch, best);
  } else {
    search_candidates(epoch, best);
  }
  if (!(best.objective[0] < kInfinity)) {  // numbers beyond all measure
    fix.status = BaselineStatus::kDegenerate;
    return fix;
  }
  fix.ratio = best.objective[0] > 0.0 ? best.objective[1] / best.objective[0] : kInfinity;
  // The ratio alone is also high for phases that fit no integers at all, when one bad vector is better than the others.
  const bool fits = best.objective[0] <= highest_objective_[options_.length_m ? epoch.m : epoch.m - 1];
  fix.status = fits && fix.ratio >= options_.ratio ? BaselineStatus::kFixed : BaselineStatus::kFloat;
  finish(epoch, best, fix);
  return fix;
}

BaselineFix BaselineSolver::with_integers(std::span<const BaselineSatellite> satellites,
                                          std::span<const double> known) noexcept {
  BaselineFix fix;
  Epoch epoch;
  if (!prepare(satellites, epoch, fix) || !inform(epoch, options_.code_phase_ratio, fix)) return fix;
  Best best;
  Best::Integers n{};
  for (std::size_t s = 0; s < epoch.m; ++s) {
    n[s] = known[epoch.source[s]] - known[epoch.source[0]] - epoch.whole[s];
  }
  Eigen::Vector3d b = fixed_baseline(epoch, n, options_.wavelength_m);
  if (options_.length_m) b = nearest_on_sphere(epoch.axes, epoch.curvature, b, *options_.length_m);
  best.offer(n, b, objective(epoch, n, options_.wavelength_m, b));
  if (!(best.objective[0] < kInfinity)) {
    fix.status = BaselineStatus::kDegenerate;
    return fix;
  }
  fix.status = BaselineStatus::kTracked;
  finish(epoch, best, fix);
  return fix;
}

}  // namespace soopnav::gnss
