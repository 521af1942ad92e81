#include "soopnav/array/direction_finder.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include "array/fitting.hpp"
#include "array/kernels.hpp"
#include "array/require.hpp"
#include "soopnav/core/constants.hpp"

namespace soopnav::array {

namespace {

constexpr int kMaxSteps = 30;
constexpr double kSettledRad = 1e-11;
constexpr double kEps = std::numeric_limits<double>::epsilon();
constexpr std::size_t kSpare = 8;

double real_dot(const Cf64& a, const Cf64& b) { return a.real() * b.real() + a.imag() * b.imag(); }

/// sum conj(v) a.
Cf64 inner(const Cf64* v, const ComplexVector& a) {
  double re = 0.0, im = 0.0;
  for (Eigen::Index m = 0; m < a.size(); ++m) {
    re += v[m].real() * a[m].real() + v[m].imag() * a[m].imag();
    im += v[m].real() * a[m].imag() - v[m].imag() * a[m].real();
  }
  return {re, im};
}

/// F(u) = a^H W a / a^H a with W = sum_k w_k e_k e_k^H, its gradient and Hessian on the tangent plane.
struct Form {
  const HermitianEigen* eigen = nullptr;
  RealVector weights;
  int count = 0;

  [[nodiscard]] double value(const ComplexVector& a) const noexcept {
    double top = 0.0;
    for (int k = 0; k < count; ++k) top += weights[k] * std::norm(inner(&eigen->vectors(0, k), a));
    return top / a.squaredNorm();
  }

  void expand(const SteeringJet& jet, double& value, double gradient[2], double hessian[3]) const noexcept {
    double top = 0.0, top1[2] = {0.0, 0.0}, top2[3] = {0.0, 0.0, 0.0};
    for (int k = 0; k < count; ++k) {
      const Cf64* const v = &eigen->vectors(0, k);
      const double w = weights[k];
      const Cf64 s = inner(v, jet.value), d0 = inner(v, jet.first[0]), d1 = inner(v, jet.first[1]);
      top += w * std::norm(s);
      top1[0] += 2.0 * w * real_dot(s, d0);
      top1[1] += 2.0 * w * real_dot(s, d1);
      top2[0] += 2.0 * w * (std::norm(d0) + real_dot(s, inner(v, jet.second[0])));
      top2[1] += 2.0 * w * (real_dot(d0, d1) + real_dot(s, inner(v, jet.second[1])));
      top2[2] += 2.0 * w * (std::norm(d1) + real_dot(s, inner(v, jet.second[2])));
    }
    const ComplexVector& a = jet.value;
    const double norm = a.squaredNorm();
    const auto dot = [](const ComplexVector& x, const ComplexVector& y) { return inner(x.data(), y).real(); };
    const double norm1[2] = {2.0 * dot(a, jet.first[0]), 2.0 * dot(a, jet.first[1])};
    const double norm2[3] = {2.0 * (jet.first[0].squaredNorm() + dot(a, jet.second[0])),
                             2.0 * (dot(jet.first[0], jet.first[1]) + dot(a, jet.second[1])),
                             2.0 * (jet.first[1].squaredNorm() + dot(a, jet.second[2]))};
    value = top / norm;
    for (int i = 0; i < 2; ++i) gradient[i] = (top1[i] - value * norm1[i]) / norm;
    hessian[0] = (top2[0] - value * norm2[0] - 2.0 * gradient[0] * norm1[0]) / norm;
    hessian[1] = (top2[1] - value * norm2[1] - gradient[0] * norm1[1] - gradient[1] * norm1[0]) / norm;
    hessian[2] = (top2[2] - value * norm2[2] - 2.0 * gradient[1] * norm1[1]) / norm;
  }
};

struct Candidate {
  float power;
  std::size_t index;
};

}  // namespace

struct DirectionFinder::Work {
  explicit Work(std::size_t directions) : power(directions) {}
  std::vector<float> power;
  HermitianEigen eigen;
  ComplexMatrix R, steering;
  Form form;
  std::array<Candidate, kMaxElements + kSpare> candidates;
  std::size_t n_candidates = 0;
  std::array<Bearing, kMaxElements> bearings;
  std::array<Eigen::Vector3d, kMaxElements> u;
  std::array<Eigen::Matrix2d, kMaxElements> spread;

  void find_peaks(const SteeringTable& table, std::size_t best, std::size_t wanted) noexcept;
  Eigen::Vector3d refine(const SteeringTable& table, std::size_t index, double& value) const noexcept;
  Eigen::Matrix2d music_covariance(const SteeringTable& table, const Eigen::Vector3d& at, double noise,
                                   double n_snapshots, int n_sources) const noexcept;
};

// Local maxima of the scan, highest first: only `best` for one source. A row at a pole is one point.
void DirectionFinder::Work::find_peaks(const SteeringTable& table, std::size_t best, std::size_t wanted) noexcept {
  candidates[0] = {power[best], best};
  n_candidates = 1;
  if (wanted == 1) return;
  n_candidates = 0;
  const std::size_t rows = table.rows(), columns = table.columns();
  const std::size_t room = std::min(candidates.size(), 2 * wanted + kSpare);
  const auto pole = [&](std::size_t row) {
    return columns > 1 && std::abs(table.elevations_rad()[row]) > kPi / 2 - 1e-9;
  };
  for (std::size_t row = 0; row < rows; ++row) {
    const bool at_pole = pole(row);
    const std::size_t last = at_pole ? 1 : columns;
    for (std::size_t column = 0; column < last; ++column) {
      const std::size_t at = row * columns + column;
      const float here = power[at];
      if (!(here > 0.0F)) continue;
      if (!at_pole) {  // most points fall here
        if (column + 1 < columns && power[at + 1] > here) continue;
        if (column > 0 && power[at - 1] >= here) continue;
        if (row + 1 < rows && power[at + columns] > here) continue;
        if (row > 0 && power[at - columns] >= here) continue;
      }
      if (n_candidates == room && !(here > candidates[room - 1].power)) continue;
      bool peak = true;
      for (std::size_t r = row == 0 ? 0 : row - 1; peak && r <= std::min(rows - 1, row + 1); ++r) {
        if (at_pole && r != row) {
          const float* const ring = power.data() + r * columns;
          peak = std::all_of(ring, ring + columns, [here](float p) { return p <= here; });
          continue;
        }
        for (int step = -1; peak && step <= 1; ++step) {
          if ((r == row && step == 0) || (at_pole && r == row)) continue;
          std::size_t c = column + columns + static_cast<std::size_t>(step + 1) - 1;
          if (!table.periodic() && (c < columns || c >= 2 * columns)) continue;
          c %= columns;
          const std::size_t other = r * columns + c;
          peak = other < at ? power[other] < here : power[other] <= here;
        }
      }
      if (!peak) continue;
      std::size_t place = n_candidates < room ? n_candidates++ : room - 1;
      for (; place > 0 && candidates[place - 1].power < here; --place) candidates[place] = candidates[place - 1];
      candidates[place] = {here, at};
    }
  }
}

// Newton's method; uphill by the gradient where the function is not concave; no step is longer than the grid's.
Eigen::Vector3d DirectionFinder::Work::refine(const SteeringTable& table, std::size_t index,
                                              double& value) const noexcept {
  Eigen::Vector3d at = unit_vector(table.direction(index));
  const bool along[2] = {(table.active() & 1) != 0, (table.active() & 2) != 0};
  const double longest = std::max(table.options().azimuth_step_rad, table.options().elevation_step_rad);
  SteeringJet jet;
  ComplexVector a;
  value = 0.0;
  for (int step = 0; step < kMaxSteps; ++step) {
    const Tangents tangents(at);
    if (!table.manifold().steering(at, tangents.azimuth, tangents.elevation, table.frequency_hz(), jet)) return at;
    double g[2], h[3];
    form.expand(jet, value, g, h);
    double move[2] = {0.0, 0.0};
    if (along[0] && along[1]) {
      const double mean = 0.5 * (h[0] + h[2]), half = std::hypot(0.5 * (h[0] - h[2]), h[1]);
      // Eigenvalues of -H made positive: the same step as Newton's where the function is concave.
      double s1 = -(mean + half), s2 = -(mean - half);
      const double angle = 0.5 * std::atan2(2.0 * h[1], h[0] - h[2]);
      const double c = std::cos(angle), s = std::sin(angle);
      const double floor = 1e-9 * (std::abs(s1) + std::abs(s2)) + 1e-300;
      s1 = std::max(std::abs(s1), floor);
      s2 = std::max(std::abs(s2), floor);
      const double p = (c * g[0] + s * g[1]) / s1, q = (-s * g[0] + c * g[1]) / s2;
      move[0] = c * p - s * q;
      move[1] = s * p + c * q;
    } else {
      const int i = along[0] ? 0 : 1;
      move[i] = g[i] / std::max(std::abs(h[i == 0 ? 0 : 2]), 1e-300);
    }
    double length = std::hypot(move[0], move[1]);
    if (!(length > kSettledRad) || !std::isfinite(length)) break;
    if (length > longest) {
      move[0] *= longest / length;
      move[1] *= longest / length;
      length = longest;
    }
    bool better = false;
    for (int halving = 0; halving < 12 && !better; ++halving) {
      const Eigen::Vector3d next = (at + move[0] * tangents.azimuth + move[1] * tangents.elevation).normalized();
      if (length < 1e-7) {  // below the function's rounding: Newton's step is better than a comparison
        at = next;
        better = true;
        break;
      }
      if (table.manifold().steering(next, table.frequency_hz(), a) && form.value(a) >= value - 1e-15) {
        at = next;
        better = true;
      } else {
        move[0] *= 0.5;
        move[1] *= 0.5;
        length *= 0.5;
      }
    }
    if (!better) break;
  }
  return table.mirror() ? table.manifold().geometry().reported_side(at) : at;
}

// Stoica and Nehorai 1989, generalised to two angles: doc/array.md eq. 10.
Eigen::Matrix2d DirectionFinder::Work::music_covariance(const SteeringTable& table, const Eigen::Vector3d& at,
                                                        double noise, double n_snapshots,
                                                        int n_sources) const noexcept {
  const Tangents tangents(at);
  SteeringJet jet;
  if (!table.manifold().steering(at, tangents.azimuth, tangents.elevation, table.frequency_hz(), jet)) {
    return bounded_inverse(Eigen::Matrix2d::Zero(), table.active());
  }
  double gain = 0.0;
  const double floor = std::max(noise, kEps * eigen.values[0]);
  double information[3] = {jet.first[0].squaredNorm(), inner(jet.first[0].data(), jet.first[1]).real(),
                           jet.first[1].squaredNorm()};
  for (int k = 0; k < n_sources; ++k) {
    const Cf64* const v = &eigen.vectors(0, k);
    const double above = std::max(eigen.values[k] - floor, 1e-3 * floor);
    gain += std::norm(inner(v, jet.value)) * floor * eigen.values[k] / (above * above);
    const Cf64 d0 = inner(v, jet.first[0]), d1 = inner(v, jet.first[1]);
    information[0] -= std::norm(d0);
    information[1] -= real_dot(d0, d1);
    information[2] -= std::norm(d1);
  }
  Eigen::Matrix2d matrix;
  matrix << information[0], information[1], information[1], information[2];
  return bounded_inverse(matrix * (2.0 * n_snapshots / gain), table.active());
}

DirectionFinder::DirectionFinder(std::shared_ptr<const SteeringTable> table, const FinderOptions& options)
    : table_(std::move(table)), options_(options) {
  require(table_ != nullptr, "table", 0, "a steering table expected");
  require(options.n_sources >= 0 && options.n_sources < table_->manifold().size(), "n_sources", options.n_sources,
          "0 (by MDL) to the number of elements less one expected");
  require(std::isfinite(options.loading) && options.loading >= 0.0, "loading", options.loading,
          "a finite number >= 0 expected");
  work_ = std::make_unique<Work>(table_->groups() * kernels::kLanes);
}

DirectionFinder::~DirectionFinder() = default;
DirectionFinder::DirectionFinder(DirectionFinder&&) noexcept = default;
DirectionFinder& DirectionFinder::operator=(DirectionFinder&&) noexcept = default;

Bearings DirectionFinder::fail(ArrayStatus status, int channel) const noexcept {
  Bearings out;
  out.status = status;
  out.channel = channel;
  out.mirror = table_->mirror();
  return out;
}

Bearings DirectionFinder::estimate(const ChannelSpan& iq) noexcept {
  if (iq.channels != static_cast<std::size_t>(table_->manifold().size())) return fail(ArrayStatus::kWrongSize);
  const CovarianceReport report = covariance(iq, work_->R);
  if (report.status != ArrayStatus::kOk) return fail(report.status, report.channel);
  return estimate(work_->R, static_cast<double>(iq.snapshots));
}

Bearings DirectionFinder::estimate(const ComplexMatrix& covariance, double n_snapshots) noexcept {
  Work& work = *work_;
  const SteeringTable& table = *table_;
  const int elements = table.manifold().size();
  if (covariance.rows() != elements || covariance.cols() != elements) return fail(ArrayStatus::kWrongSize);
  if (!(n_snapshots >= elements) || !std::isfinite(n_snapshots)) return fail(ArrayStatus::kTooFewSnapshots);
  if (options_.average) {
    work.R = forward_backward(covariance);
  } else if (&covariance != &work.R) {
    work.R = covariance;
  }
  if (!hermitian_eigen(work.R, work.eigen)) return fail(ArrayStatus::kNonFinite);
  const HermitianEigen& eigen = work.eigen;
  Bearings out = fail(ArrayStatus::kSingular);
  out.eigenvalues = {eigen.values.data(), static_cast<std::size_t>(elements)};
  if (!has_rank(eigen, 1)) return out;
  int sources = options_.n_sources;
  if (sources == 0) {
    sources = std::min(elements - 1, source_count(SourceCount::kMdl, out.eigenvalues, n_snapshots));
    if (sources < 1) {
      out.status = ArrayStatus::kNoSource;
      out.noise = noise_variance(eigen, 0);
      return out;
    }
  }
  out.noise = noise_variance(eigen, sources);
  const bool fitted =
      options_.method == DirectionMethod::kSubspaceFitting || options_.method == DirectionMethod::kMaximumLikelihood;
  if (!has_rank(eigen, fitted ? 1 : sources)) return out;

  // Every method maximises a^H W a / a^H a, W = sum_k w_k e_k e_k^H (doc/array.md eq. 6).
  Form& form = work.form;
  form.eigen = &work.eigen;
  form.count = sources;
  form.weights.setOnes(elements);
  if (options_.method == DirectionMethod::kBartlett) {
    form.count = elements;
    for (int k = 0; k < elements; ++k) form.weights[k] = std::max(0.0, eigen.values[k]) / eigen.values[0];
  } else if (options_.method == DirectionMethod::kCapon) {
    const double load = options_.loading * eigen.values.mean();
    const double least = eigen.values[elements - 1] + load;
    if (!(least > elements * kEps * (eigen.values[0] + load))) return out;
    form.count = elements - 1;
    for (int k = 0; k < elements; ++k) form.weights[k] = 1.0 - least / (eigen.values[k] + load);
  }
  std::array<float, 2 * kMaxElements * kMaxElements> vectors;
  float* next = vectors.data();
  for (int k = 0; k < form.count; ++k) {
    const double root = std::sqrt(form.weights[k]);
    for (int m = 0; m < elements; ++m) {
      *next++ = static_cast<float>(root * eigen.vectors(m, k).real());
      *next++ = static_cast<float>(root * eigen.vectors(m, k).imag());
    }
  }
  const std::size_t best = kernels::scan(table.values().data(), table.groups(), static_cast<std::size_t>(elements),
                                         vectors.data(), static_cast<std::size_t>(form.count), work.power.data());
  work.find_peaks(table, best, static_cast<std::size_t>(sources));

  const double step = std::max(table.options().azimuth_step_rad, table.options().elevation_step_rad);
  int found = 0;
  for (std::size_t i = 0; i < work.n_candidates && found < sources; ++i) {
    double value = 0.0;
    const Eigen::Vector3d u = work.refine(table, work.candidates[i].index, value);
    const bool twin = std::any_of(work.u.begin(), work.u.begin() + found,
                                  [&](const Eigen::Vector3d& other) { return (u - other).norm() < 0.5 * step; });
    if (twin) continue;
    work.u[static_cast<std::size_t>(found)] = u;
    work.bearings[static_cast<std::size_t>(found)].spectrum = value;
    ++found;
  }
  bool fit = fitted;
  if (fitted) {
    const auto all = std::span(work.u).first(static_cast<std::size_t>(sources));
    if (found < sources) alternating_projections(table, work.R, all);
    fit = fit_directions(table.manifold(), table.frequency_hz(), table.active(), work.R, eigen, out.noise, n_snapshots,
                         options_.method == DirectionMethod::kSubspaceFitting, all, work.spread);
    if (fit) found = sources;
  }
  ComplexVector a;
  work.steering.resize(elements, found);
  for (int k = 0; k < found; ++k) {
    Eigen::Vector3d& u = work.u[static_cast<std::size_t>(k)];
    Bearing& bearing = work.bearings[static_cast<std::size_t>(k)];
    if (table.mirror()) u = table.manifold().geometry().reported_side(u);
    const Direction direction = direction_of(u);
    bearing.azimuth_rad = direction.azimuth_rad;
    bearing.elevation_rad = direction.elevation_rad;
    const Eigen::Matrix2d spread = fit ? work.spread[static_cast<std::size_t>(k)]
                                       : work.music_covariance(table, u, out.noise, n_snapshots, sources);
    bearing.covariance_rad2 = table.active() == 3 ? in_angles(spread, u) : spread;
    if (table.manifold().steering(u, table.frequency_hz(), a)) {
      if (fitted) bearing.spectrum = form.value(a);
    } else {
      a.setOnes(elements);
    }
    work.steering.col(k) = a;
  }
  std::array<double, kMaxElements> powers{};
  source_powers(work.steering, work.R, out.noise, std::span(powers).first(static_cast<std::size_t>(found)));
  for (int k = 0; k < found; ++k)
    work.bearings[static_cast<std::size_t>(k)].power = powers[static_cast<std::size_t>(k)];
  std::sort(work.bearings.begin(), work.bearings.begin() + found, [](const Bearing& x, const Bearing& y) {
    return x.power > y.power || (x.power == y.power && x.azimuth_rad < y.azimuth_rad);
  });
  out.sources = std::span(work.bearings).first(static_cast<std::size_t>(found));
  out.status = found == sources ? ArrayStatus::kOk : ArrayStatus::kUnresolved;
  return out;
}

}  // namespace soopnav::array
