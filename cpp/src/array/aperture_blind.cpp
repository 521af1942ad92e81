#include <algorithm>
#include <array>
#include <cmath>

#include "array/aperture_search.hpp"
#include "soopnav/array/subspace.hpp"
#include "soopnav/core/angle.hpp"

namespace soopnav::array {

namespace {

// Removes mean and, on request, slope over time of a series.
void detrend(std::vector<double>& v, std::size_t offset, std::size_t stride, const std::vector<double>& t, bool slope) {
  const std::size_t n = t.size();
  double mean = 0.0, mean_t = 0.0;
  for (std::size_t k = 0; k < n; ++k) {
    mean += v[offset + k * stride] / static_cast<double>(n);
    mean_t += t[k] / static_cast<double>(n);
  }
  double top = 0.0, bottom = 0.0;
  for (std::size_t k = 0; k < n; ++k) {
    top += (t[k] - mean_t) * (v[offset + k * stride] - mean);
    bottom += (t[k] - mean_t) * (t[k] - mean_t);
  }
  const double rate = slope ? top / bottom : 0.0;
  for (std::size_t k = 0; k < n; ++k) v[offset + k * stride] -= mean + rate * (t[k] - mean_t);
}

struct Circle {
  double q[3];  // of the form a' Q a, scaled to 1 on the ellipse
  double centre[2];
};

// The ellipse through points (eq. 9): least squares of its six numbers, pulled towards a circle until it is one.
bool fit_ellipse(const std::vector<std::array<double, 2>>& points, Circle& out) {
  for (double pull = 0.0; pull < 2e3; pull = pull == 0.0 ? 1e-4 : 4.0 * pull) {
    ComplexMatrix normal = ComplexMatrix::Zero(6, 6);
    const auto add = [&](const std::array<double, 6>& row, double weight) {
      for (Eigen::Index a = 0; a < 6; ++a) {
        for (Eigen::Index b = 0; b < 6; ++b) {
          normal(a, b) += weight * row[static_cast<std::size_t>(a)] * row[static_cast<std::size_t>(b)];
        }
      }
    };
    for (const auto& [x, y] : points) add({x * x, 2.0 * x * y, y * y, 2.0 * x, 2.0 * y, 1.0}, 1.0);
    add({1.0, 0.0, -1.0, 0.0, 0.0, 0.0}, pull);
    add({0.0, 1.0, 0.0, 0.0, 0.0, 0.0}, pull);
    HermitianEigen eigen;
    if (!hermitian_eigen(normal, eigen)) return false;
    // Six real numbers; the vector's common phase is arbitrary.
    Eigen::Index largest = 0;
    for (Eigen::Index a = 1; a < 6; ++a) {
      if (std::abs(eigen.vectors(a, 5)) > std::abs(eigen.vectors(largest, 5))) largest = a;
    }
    const Cf64 turn = std::conj(eigen.vectors(largest, 5)) / std::abs(eigen.vectors(largest, 5));
    double g[6];
    for (Eigen::Index a = 0; a < 6; ++a) g[a] = (eigen.vectors(a, 5) * turn).real();
    const double determinant = g[0] * g[2] - g[1] * g[1];
    if (!(determinant > 1e-6 * (g[0] * g[0] + 2.0 * g[1] * g[1] + g[2] * g[2]))) continue;
    out.centre[0] = -(g[2] * g[3] - g[1] * g[4]) / determinant;
    out.centre[1] = -(g[0] * g[4] - g[1] * g[3]) / determinant;
    const double scale = -(g[3] * out.centre[0] + g[4] * out.centre[1]) - g[5];
    for (int a = 0; a < 3; ++a) out.q[a] = g[a] / scale;
    if (out.q[0] > 0.0 && out.q[2] > 0.0) return true;
  }
  return false;
}

}  // namespace

bool start_blind(ApertureModel& m, bool frequency_offsets) {
  const std::size_t n = m.n, nodes = m.nodes;
  // Phases against the first node, unwrapped over snapshots; then centred over nodes and over time.
  std::vector<double> phase(n * nodes, 0.0);
  for (std::size_t i = 1; i < nodes; ++i) {
    double last = 0.0;
    for (std::size_t k = 0; k < n; ++k) {
      const double now = std::arg(m.y[k * nodes + i] * std::conj(m.y[k * nodes]));
      last = k == 0 ? now : last + wrap_to_pi(now - last);
      phase[k * nodes + i] = last;
    }
  }
  std::vector<double> centred = phase;
  for (std::size_t i = 0; i < nodes; ++i) detrend(centred, i, nodes, m.t, frequency_offsets);
  for (std::size_t k = 0; k < n; ++k) {
    double mean = 0.0;
    for (std::size_t i = 0; i < nodes; ++i) mean += centred[k * nodes + i] / static_cast<double>(nodes);
    for (std::size_t i = 0; i < nodes; ++i) centred[k * nodes + i] -= mean;
  }
  ComplexMatrix gram = ComplexMatrix::Zero(static_cast<Eigen::Index>(nodes), static_cast<Eigen::Index>(nodes));
  for (std::size_t k = 0; k < n; ++k) {
    for (std::size_t i = 0; i < nodes; ++i) {
      for (std::size_t j = 0; j < nodes; ++j) {
        gram(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j)) +=
            centred[k * nodes + i] * centred[k * nodes + j];
      }
    }
  }
  HermitianEigen eigen;
  if (!hermitian_eigen(gram, eigen)) return false;
  if (!(eigen.values[1] > 1e-9 * eigen.values[0])) return false;
  // Real vectors: the Gram matrix is real, and a vector's common phase drops out.
  std::vector<std::array<double, 2>> points(nodes);
  for (Eigen::Index c = 0; c < 2; ++c) {
    Eigen::Index largest = 0;
    for (Eigen::Index i = 1; i < gram.rows(); ++i) {
      if (std::abs(eigen.vectors(i, c)) > std::abs(eigen.vectors(largest, c))) largest = i;
    }
    const Cf64 turn = std::conj(eigen.vectors(largest, c)) / std::abs(eigen.vectors(largest, c));
    for (std::size_t i = 0; i < nodes; ++i) {
      points[i][static_cast<std::size_t>(c)] = (eigen.vectors(static_cast<Eigen::Index>(i), c) * turn).real();
    }
  }
  Circle circle{};
  if (!fit_ellipse(points, circle)) return false;
  // Q = M'M with M upper triangular: directions are M (a - centre) up to a rotation and a mirror image.
  const double m00 = std::sqrt(circle.q[0]), m01 = circle.q[1] / m00;
  const double rest = circle.q[2] - m01 * m01;
  if (!(rest > 0.0)) return false;
  const double m11 = std::sqrt(rest);
  for (std::size_t i = 0; i < nodes; ++i) {
    const double x = points[i][0] - circle.centre[0], y = points[i][1] - circle.centre[1];
    m.theta[i] = std::atan2(m11 * y, m00 * x + m01 * y);
  }
  for (std::size_t i = nodes; i-- > 0;) m.theta[i] = wrap_to_pi(m.theta[i] - m.theta[0]);

  // Path by least squares from the centred phases (eq. 10), in that frame.
  double xx = 0.0, xy = 0.0, yy = 0.0, mean_x = 0.0, mean_y = 0.0;
  for (std::size_t i = 0; i < nodes; ++i) {
    mean_x += m.wave_number[i] * std::cos(m.theta[i]) / static_cast<double>(nodes);
    mean_y += m.wave_number[i] * std::sin(m.theta[i]) / static_cast<double>(nodes);
  }
  const auto ux = [&](std::size_t i) { return m.wave_number[i] * std::cos(m.theta[i]) - mean_x; };
  const auto uy = [&](std::size_t i) { return m.wave_number[i] * std::sin(m.theta[i]) - mean_y; };
  for (std::size_t i = 0; i < nodes; ++i) {
    xx += ux(i) * ux(i);
    xy += ux(i) * uy(i);
    yy += uy(i) * uy(i);
  }
  const double determinant = xx * yy - xy * xy;
  if (!(determinant > 1e-9 * (xx + yy) * (xx + yy))) return false;
  for (std::size_t k = 0; k < n; ++k) {
    double bx = 0.0, by = 0.0;
    for (std::size_t i = 0; i < nodes; ++i) {
      bx += ux(i) * centred[k * nodes + i];
      by += uy(i) * centred[k * nodes + i];
    }
    m.dx[k] = (yy * bx - xy * by) / determinant;
    m.dy[k] = (xx * by - xy * bx) / determinant;
  }
  m.aim();
  std::fill(m.fixed.begin(), m.fixed.end(), std::uint8_t{0});
  m.fixed[ApertureModel::kBearing] = 1;
  // Offsets and phases that path and receiver phase cannot explain: what is left of each node's phases.
  std::vector<double> left(n);
  for (std::size_t i = 0; i < nodes; ++i) {
    for (std::size_t k = 0; k < n; ++k) {
      left[k] = phase[k * nodes + i] - (m.wave_number[i] * std::cos(m.theta[i]) - m.wave_number[0]) * m.dx[k] -
                m.wave_number[i] * std::sin(m.theta[i]) * m.dy[k];
    }
    double mean = 0.0, mean_t = 0.0, top = 0.0, bottom = 0.0;
    for (std::size_t k = 0; k < n; ++k) {
      mean += left[k] / static_cast<double>(n);
      mean_t += m.t[k] / static_cast<double>(n);
    }
    for (std::size_t k = 0; k < n; ++k) {
      top += (m.t[k] - mean_t) * (left[k] - mean);
      bottom += (m.t[k] - mean_t) * (m.t[k] - mean_t);
    }
    m.offset[i] = frequency_offsets ? top / bottom : 0.0;
    m.phi[i] = wrap_to_pi(mean - m.offset[i] * mean_t);
    if (!frequency_offsets) m.fixed[ApertureModel::kPerNode * i + ApertureModel::kOffset] = 1;
  }
  // A shift (and a drift) of the path and of the receiver's phase: three nodes' phases (and offsets) stay as they are.
  std::size_t three[3] = {0, 1, 2};
  double widest = -1.0;
  for (std::size_t b = 1; b < nodes; ++b) {
    for (std::size_t c = b + 1; c < nodes; ++c) {
      const double area = std::abs((std::cos(m.theta[b]) - 1.0) * std::sin(m.theta[c]) -
                                   std::sin(m.theta[b]) * (std::cos(m.theta[c]) - 1.0));
      if (area > widest) {
        widest = area;
        three[1] = b;
        three[2] = c;
      }
    }
  }
  for (const std::size_t i : three) {
    m.fixed[ApertureModel::kPerNode * i + ApertureModel::kOffset] = 1;
    m.fixed[ApertureModel::kPerNode * i + ApertureModel::kPhase] = 1;
  }
  return true;
}

}  // namespace soopnav::array
