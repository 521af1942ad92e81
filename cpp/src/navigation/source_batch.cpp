#include "navigation/source_batch.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "soopnav/core/angle.hpp"
#include "soopnav/core/constants.hpp"

namespace soopnav::navigation::detail {
namespace {

using Point = std::array<double, 2>;

constexpr std::size_t kPiece = 96;     // bearings handed to a kernel at a time
constexpr std::size_t kFineSide = 16;  // of the grids that refine a peak
constexpr int kFineLevels = 2;

// Where two bearings cross. False unless ahead of both.
bool crossing(const Kept& a, const Kept& b, Point& out) noexcept {
  const double turn = a.b.cos_azimuth * b.b.sin_azimuth - a.b.sin_azimuth * b.b.cos_azimuth;
  const double dx = b.b.x - a.b.x;
  const double dy = b.b.y - a.b.y;
  const double along_a = (dx * b.b.sin_azimuth - dy * b.b.cos_azimuth) / turn;
  const double along_b = (dx * a.b.sin_azimuth - dy * a.b.cos_azimuth) / turn;
  if (!(along_a > 0.0 && along_b > 0.0)) return false;
  out = {a.b.x + along_a * a.b.cos_azimuth, a.b.y + along_a * a.b.sin_azimuth};
  return std::isfinite(out[0]) && std::isfinite(out[1]);
}

double distance(const Point& a, const Point& b) noexcept { return std::hypot(a[0] - b[0], a[1] - b[1]); }

// One row of the pseudo-linear system: a . x = c, and the error of c per radian.
struct Row {
  std::array<double, 3> a{};
  double c = 0.0;
};
Row azimuth_row(const Kept& k) noexcept {
  Row row;
  row.a = {k.b.sin_azimuth, -k.b.cos_azimuth, 0.0};
  row.c = row.a[0] * k.b.x + row.a[1] * k.b.y;
  return row;
}
Row elevation_row(const Kept& k) noexcept {
  Row row;
  const double s = std::sin(k.b.elevation);
  row.a = {-s * k.b.cos_azimuth, -s * k.b.sin_azimuth, std::cos(k.b.elevation)};
  row.c = row.a[0] * k.b.x + row.a[1] * k.b.y + row.a[2] * k.b.z;
  return row;
}

// Cost, gradient and curvature of a problem at x.
struct Shape {
  double cost = 0.0;
  Vector gradient{};
  Matrix curvature{};
  double chi_square = 0.0;
  std::size_t angles = 0;
  std::size_t outliers = 0;
};

void evaluate(const Problem& p, const Vector& x, Shape& out) noexcept {
  out = {};
  const std::size_t n = p.layout.size();
  const std::size_t rows = p.layout.dimensions - 1;
  const double floor = p.outlier / (rows == 2 ? kTwoPi * kPi : kTwoPi);
  Angles angles;
  for (const Kept& kept : p.bearings) {
    if (!predict(p.layout, x, p.t_s, kept, angles)) {
      out.cost += 20.0;  // at the platform: as unlikely as an outlier of a very good bearing
      continue;
    }
    double square = 0.0;
    double volume = 1.0;
    for (std::size_t r = 0; r < rows; ++r) {
      square += angles.residual[r] * angles.residual[r] / angles.variance[r];
      volume *= kTwoPi * angles.variance[r];
    }
    double share = 1.0;
    if (p.outlier > 0.0) {
      const double normal = (1.0 - p.outlier) * std::exp(-0.5 * square) / std::sqrt(volume);
      share = normal / (normal + floor);
      out.cost -= std::log(normal + floor);
    } else {
      out.cost += 0.5 * (square + std::log(volume));
    }
    if (share >= 0.5) {
      out.chi_square += square;
      out.angles += rows;
    } else {
      ++out.outliers;
    }
    if (share < 1e-12) continue;
    for (std::size_t r = 0; r < rows; ++r) {
      const Vector& h = angles.gradient[r];
      const double weight = share / angles.variance[r];
      for (std::size_t i = 0; i < n; ++i) {
        const double wh = weight * h[i];
        out.gradient[i] += wh * angles.residual[r];
        for (std::size_t j = 0; j <= i; ++j) out.curvature[i][j] += wh * h[j];
      }
    }
  }
  if (p.layout.biased) {
    const std::size_t b = p.layout.bias();
    const double weight = 1.0 / (p.bias_sigma * p.bias_sigma);
    out.cost += 0.5 * weight * x[b] * x[b];
    out.gradient[b] -= weight * x[b];
    out.curvature[b][b] += weight;
  }
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t j = i + 1; j < n; ++j) out.curvature[i][j] = out.curvature[j][i];
  }
}

}  // namespace

void add_triple(const Kept& a, const Kept& b, const Kept& c, bool incenter, bool space, double min_crossing_rad,
                TripleSum& out) noexcept {
  const auto apart = [&](const Kept& p, const Kept& q) {
    const double turn = std::abs(wrap_to_pi(p.azimuth - q.azimuth));
    return std::min(turn, kPi - turn) >= min_crossing_rad;
  };
  Point ab;
  Point bc;
  Point ca;
  if (!apart(a, b) || !apart(b, c) || !apart(c, a)) return;
  if (!crossing(a, b, ab) || !crossing(b, c, bc) || !crossing(c, a, ca)) return;
  // The side opposite to a corner joins the two others.
  std::array<double, 3> weight{1.0, 1.0, 1.0};
  if (incenter) weight = {distance(bc, ca), distance(ca, ab), distance(ab, bc)};
  const double total = weight[0] + weight[1] + weight[2];
  std::array<double, 3> centre{};
  if (total > 0.0) {
    for (std::size_t i = 0; i < 2; ++i) centre[i] = (weight[0] * ab[i] + weight[1] * bc[i] + weight[2] * ca[i]) / total;
  } else {
    centre = {ab[0], ab[1], 0.0};
  }
  if (space) {
    for (const Kept* k : {&a, &b, &c}) {
      centre[2] += (k->b.z + std::hypot(centre[0] - k->b.x, centre[1] - k->b.y) * std::tan(k->b.elevation)) / 3.0;
    }
  }
  if (!std::isfinite(centre[0]) || !std::isfinite(centre[1]) || !std::isfinite(centre[2])) return;
  ++out.count;
  for (std::size_t i = 0; i < 3; ++i) {
    out.sum[i] += centre[i];
    for (std::size_t j = 0; j < 3; ++j) out.squares[i][j] += centre[i] * centre[j];
  }
}

Solution pseudo_linear(std::size_t dimensions, std::span<const Kept> bearings, bool weighted, int iterations) noexcept {
  Solution out;
  const Layout layout{dimensions, false, false};
  const std::size_t rows = dimensions - 1;
  Matrix L{};
  Matrix A{};
  for (int pass = 0; pass <= (weighted ? iterations : 0); ++pass) {
    A = {};
    Vector c{};
    for (const Kept& k : bearings) {
      // Distance of the estimate: what a radian of error moves the row by.
      double level = 1.0;
      double range = 1.0;
      if (pass > 0) {
        level = std::max(std::hypot(out.x[0] - k.b.x, out.x[1] - k.b.y), 1e-3);
        range = dimensions == 3 ? std::hypot(level, out.x[2] - k.b.z) : level;
      }
      for (std::size_t r = 0; r < rows; ++r) {
        const Row row = r == 0 ? azimuth_row(k) : elevation_row(k);
        const double variance = r == 0 ? k.b.variance_azimuth : k.b.variance_elevation;
        double error = (r == 0 ? level * level : range * range) * variance;
        if (pass > 0) {
          error += row.a[0] * row.a[0] * k.b.xx + row.a[1] * row.a[1] * k.b.yy + row.a[2] * row.a[2] * k.b.zz +
                   2.0 * (row.a[0] * row.a[1] * k.b.xy + row.a[0] * row.a[2] * k.b.xz + row.a[1] * row.a[2] * k.b.yz);
        }
        const double weight = weighted ? 1.0 / error : 1.0;
        for (std::size_t i = 0; i < dimensions; ++i) {
          c[i] += weight * row.a[i] * row.c;
          for (std::size_t j = 0; j < dimensions; ++j) A[i][j] += weight * row.a[i] * row.a[j];
        }
      }
    }
    if (!factor(dimensions, A, L)) return out;
    Vector x{};
    solve(dimensions, L, c, x);
    double moved = 0.0;
    double size = 0.0;
    for (std::size_t i = 0; i < dimensions; ++i) {
      if (!std::isfinite(x[i])) return out;
      moved = std::max(moved, std::abs(x[i] - out.x[i]));
      size = std::max(size, std::abs(x[i]));
    }
    out.x = x;
    out.solved = true;
    out.converged = !weighted || (pass > 1 && moved <= 1e-6 + 1e-9 * size);
    if (weighted && out.converged) break;
  }
  invert(dimensions, L, out.covariance);
  // Residuals of the angles, and for the unweighted form the covariance that its neglect of the weights leaves.
  Matrix middle{};
  Angles angles;
  for (const Kept& k : bearings) {
    if (!predict(layout, out.x, 0.0, k, angles)) continue;
    for (std::size_t r = 0; r < rows; ++r) {
      out.chi_square += angles.residual[r] * angles.residual[r] / angles.variance[r];
      ++out.angles;
      if (weighted) continue;
      const Row row = r == 0 ? azimuth_row(k) : elevation_row(k);
      const double range = r == 0 || dimensions == 2 ? angles.level : std::hypot(angles.level, out.x[2] - k.b.z);
      for (std::size_t i = 0; i < dimensions; ++i) {
        for (std::size_t j = 0; j < dimensions; ++j) {
          middle[i][j] += range * range * angles.variance[r] * row.a[i] * row.a[j];
        }
      }
    }
  }
  if (!weighted) {
    Matrix half{};
    Matrix whole{};
    for (std::size_t i = 0; i < dimensions; ++i) {
      for (std::size_t j = 0; j < dimensions; ++j) {
        for (std::size_t k = 0; k < dimensions; ++k) half[i][j] += out.covariance[i][k] * middle[k][j];
      }
    }
    for (std::size_t i = 0; i < dimensions; ++i) {
      for (std::size_t j = 0; j < dimensions; ++j) {
        for (std::size_t k = 0; k < dimensions; ++k) whole[i][j] += half[i][k] * out.covariance[k][j];
      }
    }
    out.covariance = whole;
  }
  return out;
}

Solution search(const Problem& problem, const Vector& start) noexcept {
  const std::size_t n = problem.layout.size();
  Solution out;
  Vector x = start;
  Shape here;
  evaluate(problem, x, here);
  double damping = 1e-3;
  Shape there;
  Matrix L{};
  for (int iteration = 0; iteration < problem.iterations && !out.converged; ++iteration) {
    bool better = false;
    for (int attempt = 0; attempt < 20 && !better && !out.converged; ++attempt) {
      Matrix damped = here.curvature;
      for (std::size_t i = 0; i < n; ++i) damped[i][i] *= 1.0 + damping;
      Vector step{};
      if (factor(n, damped, L)) {
        solve(n, L, here.gradient, step);
        double decrement = 0.0;
        Vector next = x;
        for (std::size_t i = 0; i < n; ++i) {
          next[i] += step[i];
          decrement += step[i] * here.gradient[i];
        }
        evaluate(problem, next, there);
        // Half the decrement is what the cost would still fall by: a millionth of a sigma.
        const bool done = decrement < 1e-12 * (1.0 + damping);
        if (there.cost < here.cost || done) {
          better = there.cost <= here.cost;
          if (better) {
            x = next;
            here = there;
          }
          out.converged = done;
          damping = std::max(damping * 0.1, 1e-12);
          continue;
        }
        // Cost that no longer falls because of rounding alone.
        if (decrement < 1e-9 && there.cost - here.cost < 1e-12 * (1.0 + std::abs(here.cost))) {
          out.converged = true;
          continue;
        }
      }
      damping = std::max(damping * 8.0, 1e-9);
    }
    if (!better) break;
  }
  if (!factor(n, here.curvature, L)) return out;
  invert(n, L, out.covariance);
  out.solved = true;
  out.x = x;
  out.cost = here.cost;
  out.chi_square = here.chi_square;
  out.angles = here.angles;
  out.outliers = here.outliers;
  for (std::size_t i = 0; i < n; ++i) out.solved = out.solved && std::isfinite(x[i]);
  return out;
}

SearchGrid::SearchGrid(int size)
    : size_((static_cast<std::size_t>(size) + 7) / 8 * 8),
      px_(size_ * size_),
      py_(size_ * size_),
      values_(size_ * size_) {}

void SearchGrid::clear() noexcept {
  filled_ = 0;
  radius_ = 0.0;
}

void SearchGrid::add(std::span<const Kept> bearings, std::span<const double> x, std::span<const double> y,
                     double outlier, std::span<double> values) noexcept {
  std::array<PackedBearing, kPiece> packed;
  for (std::size_t from = 0; from < bearings.size(); from += kPiece) {
    const std::size_t n = std::min(kPiece, bearings.size() - from);
    for (std::size_t i = 0; i < n; ++i) packed[i] = bearings[from + i].b;
    add_log_likelihood({packed.data(), n}, {x, y, {}}, outlier, values);
  }
}

void SearchGrid::fill(std::span<const Kept> bearings, double x, double y, double radius_m, double outlier) noexcept {
  if (filled_ > bearings.size() || x != x_ || y != y_ || radius_ != radius_m) {
    x_ = x;
    y_ = y;
    radius_ = radius_m;
    filled_ = 0;
    const double cell = 2.0 * radius_ / static_cast<double>(size_);
    for (std::size_t j = 0; j < size_; ++j) {
      for (std::size_t i = 0; i < size_; ++i) {
        px_[j * size_ + i] = x_ - radius_ + cell * (static_cast<double>(i) + 0.5);
        py_[j * size_ + i] = y_ - radius_ + cell * (static_cast<double>(j) + 0.5);
      }
    }
    std::fill(values_.begin(), values_.end(), 0.0);
  }
  add(bearings.subspan(filled_), px_, py_, outlier, values_);
  filled_ = bearings.size();
}

std::size_t SearchGrid::peaks(std::span<const Kept> bearings, double outlier,
                              std::span<std::array<double, 2>> out) noexcept {
  constexpr std::size_t kMost = 8;
  std::array<std::size_t, kMost> best{};
  std::size_t count = 0;
  const std::size_t most = std::min(out.size(), kMost);
  for (std::size_t j = 0; j < size_; ++j) {
    for (std::size_t i = 0; i < size_; ++i) {
      const std::size_t at = j * size_ + i;
      bool peak = true;
      for (std::size_t v = j > 0 ? j - 1 : 0; v <= std::min(j + 1, size_ - 1) && peak; ++v) {
        for (std::size_t u = i > 0 ? i - 1 : 0; u <= std::min(i + 1, size_ - 1); ++u) {
          if (values_[v * size_ + u] > values_[at]) peak = false;
        }
      }
      if (!peak) continue;
      std::size_t rank = count;
      while (rank > 0 && values_[best[rank - 1]] < values_[at]) --rank;
      if (rank >= most) continue;
      count = std::min(count + 1, most);
      for (std::size_t k = count - 1; k > rank; --k) best[k] = best[k - 1];
      best[rank] = at;
    }
  }
  constexpr std::size_t kFine = kFineSide * kFineSide;
  std::array<double, kFine> x;
  std::array<double, kFine> y;
  std::array<double, kFine> values;
  for (std::size_t k = 0; k < count; ++k) {
    out[k] = {px_[best[k]], py_[best[k]]};
    double half = 1.5 * 2.0 * radius_ / static_cast<double>(size_);
    for (int level = 0; level < kFineLevels; ++level) {
      const double cell = 2.0 * half / static_cast<double>(kFineSide);
      for (std::size_t i = 0; i < kFine; ++i) {
        x[i] = out[k][0] - half + cell * (static_cast<double>(i % kFineSide) + 0.5);
        y[i] = out[k][1] - half + cell * (static_cast<double>(i / kFineSide) + 0.5);
      }
      values.fill(0.0);
      add(bearings, x, y, outlier, values);
      const auto top = static_cast<std::size_t>(std::max_element(values.begin(), values.end()) - values.begin());
      out[k] = {x[top], y[top]};
      half = 1.5 * cell;
    }
  }
  return count;
}

}  // namespace soopnav::navigation::detail
