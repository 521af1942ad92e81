#include "soopnav/array/aperture_spectrum.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>

#include "array/require.hpp"
#include "soopnav/array/subspace.hpp"
#include "soopnav/core/angle.hpp"

namespace soopnav::array {

namespace {

constexpr double kEvenStep = 1e-3;  // of a step
constexpr double kSettledBearing = 1e-9;

struct Spectrum1 {
  std::vector<Cf64> vectors;  // count x n, orthonormal or the looks themselves
  std::vector<double> x, y;
  std::size_t n = 0, count = 0;
  double scale = 1.0;

  [[nodiscard]] double at(double bearing_rad) const noexcept {
    const double c = std::cos(bearing_rad), s = std::sin(bearing_rad);
    double power = 0.0;
    for (std::size_t v = 0; v < count; ++v) {
      Cf64 sum = 0.0;
      for (std::size_t k = 0; k < n; ++k) sum += vectors[v * n + k] * std::polar(1.0, -(c * x[k] + s * y[k]));
      power += std::norm(sum);
    }
    return std::min(1.0, power * scale);
  }
};

Spectrum1 make_spectrum(const ApertureLooks& in, ApertureMethod method, std::size_t n_sources) {
  std::size_t n = in.path_m.size() / 2;
  require(n >= 2 && in.path_m.size() == 2 * n, "path_m", in.path_m.size(), "two numbers for each of two snapshots");
  require(!in.phasors.empty() && in.phasors.size() % n == 0, "phasors", in.phasors.size(),
          "a whole number of looks at every snapshot");
  require(std::isfinite(in.wavelength_m) && in.wavelength_m > 0.0, "wavelength_m", in.wavelength_m,
          "it must be finite and positive");
  for (const double v : in.path_m) require(std::isfinite(v), "path_m", v, "it must be finite");
  const std::size_t given = in.phasors.size() / n;
  std::vector<std::vector<Cf64>> looks(given, std::vector<Cf64>(n));
  double power = 0.0;
  for (std::size_t l = 0; l < given; ++l) {
    for (std::size_t k = 0; k < n; ++k) {
      looks[l][k] = in.phasors[k * given + l];
      power += std::norm(looks[l][k]);
    }
  }
  require(std::isfinite(power) && power > 0.0, "phasors", power, "finite numbers that are not all zero");
  if (in.subaperture > 0) {
    require(in.subaperture >= 2 && in.subaperture < n, "subaperture", in.subaperture, "2 snapshots to all but one");
    const double sx = (in.path_m[2 * (n - 1)] - in.path_m[0]) / static_cast<double>(n - 1);
    const double sy = (in.path_m[2 * (n - 1) + 1] - in.path_m[1]) / static_cast<double>(n - 1);
    const double step = std::hypot(sx, sy);
    for (std::size_t k = 0; k < n; ++k) {
      const double off = std::hypot(in.path_m[2 * k] - in.path_m[0] - sx * static_cast<double>(k),
                                    in.path_m[2 * k + 1] - in.path_m[1] - sy * static_cast<double>(k));
      require(off <= kEvenStep * step, "subaperture", in.subaperture, "the path must be straight with even steps");
    }
    std::vector<std::vector<Cf64>> parts;
    for (const auto& look : looks) {
      for (std::size_t first = 0; first + in.subaperture <= n; ++first) {
        parts.emplace_back(look.begin() + static_cast<std::ptrdiff_t>(first),
                           look.begin() + static_cast<std::ptrdiff_t>(first + in.subaperture));
      }
    }
    looks = std::move(parts);
    n = in.subaperture;
  }
  Spectrum1 out;
  out.n = n;
  const double wave_number = kTwoPi / in.wavelength_m;
  for (std::size_t k = 0; k < n; ++k) {
    out.x.push_back(wave_number * in.path_m[2 * k]);
    out.y.push_back(wave_number * in.path_m[2 * k + 1]);
  }
  if (method == ApertureMethod::kBeamforming) {
    double total = 0.0;
    for (const auto& look : looks) {
      out.vectors.insert(out.vectors.end(), look.begin(), look.end());
      for (const Cf64& v : look) total += std::norm(v);
    }
    out.count = looks.size();
    out.scale = 1.0 / (static_cast<double>(n) * total);
    return out;
  }
  const std::size_t count = looks.size();
  require(count <= static_cast<std::size_t>(kMaxElements), "phasors", count, "at most 32 looks for MUSIC");
  require(n_sources >= 1 && n_sources <= std::min(n, count), "n_sources", n_sources,
          "1 to the number of looks and of snapshots");
  // Signal subspace of the looks from their Gram matrix, which is small: U = Y V / s.
  const auto size = static_cast<Eigen::Index>(count);
  ComplexMatrix gram(size, size);
  for (Eigen::Index a = 0; a < size; ++a) {
    for (Eigen::Index b = 0; b < size; ++b) {
      Cf64 sum = 0.0;
      const auto &p = looks[static_cast<std::size_t>(a)], &q = looks[static_cast<std::size_t>(b)];
      for (std::size_t k = 0; k < n; ++k) sum += std::conj(p[k]) * q[k];
      gram(a, b) = sum;
    }
  }
  HermitianEigen eigen;
  static_cast<void>(hermitian_eigen(gram, eigen));
  for (std::size_t s = 0; s < n_sources; ++s) {
    const auto column = static_cast<Eigen::Index>(s);
    require(eigen.values[column] > 1e-12 * eigen.values[0], "n_sources", n_sources,
            "the looks have not that many dimensions");
    const double scale = 1.0 / std::sqrt(eigen.values[column]);
    for (std::size_t k = 0; k < n; ++k) {
      Cf64 sum = 0.0;
      for (Eigen::Index a = 0; a < size; ++a) sum += looks[static_cast<std::size_t>(a)][k] * eigen.vectors(a, column);
      out.vectors.push_back(sum * scale);
    }
  }
  out.count = n_sources;
  out.scale = 1.0 / static_cast<double>(n);
  return out;
}

}  // namespace

std::vector<double> aperture_spectrum(const ApertureLooks& looks, std::span<const double> bearing_rad,
                                      ApertureMethod method, std::size_t n_sources) {
  const Spectrum1 spectrum = make_spectrum(looks, method, n_sources);
  std::vector<double> out;
  out.reserve(bearing_rad.size());
  for (const double bearing : bearing_rad) out.push_back(spectrum.at(bearing));
  return out;
}

std::vector<double> aperture_directions(const ApertureLooks& looks, ApertureMethod method, std::size_t n_sources) {
  require(n_sources >= 1, "n_sources", n_sources, "at least 1");
  const Spectrum1 spectrum = make_spectrum(looks, method, n_sources);
  double reach = 0.0;
  for (std::size_t k = 0; k < spectrum.n; ++k) {
    reach = std::max(reach, std::hypot(spectrum.x[k] - spectrum.x[0], spectrum.y[k] - spectrum.y[0]));
  }
  const auto grid = static_cast<std::size_t>(std::clamp(10.0 * reach, 72.0, 20000.0));
  const double step = kTwoPi / static_cast<double>(grid);
  std::vector<double> value(grid);
  for (std::size_t g = 0; g < grid; ++g) value[g] = spectrum.at(step * static_cast<double>(g));
  std::vector<std::size_t> peaks;
  for (std::size_t g = 0; g < grid; ++g) {
    if (value[g] > value[(g + grid - 1) % grid] && value[g] >= value[(g + 1) % grid]) peaks.push_back(g);
  }
  std::stable_sort(peaks.begin(), peaks.end(), [&](std::size_t a, std::size_t b) { return value[a] > value[b]; });
  if (peaks.size() > n_sources) peaks.resize(n_sources);
  std::vector<double> out;
  for (const std::size_t peak : peaks) {
    constexpr double kGolden = 0.6180339887498949;
    double low = step * (static_cast<double>(peak) - 1.0), high = low + 2.0 * step;
    double a = high - kGolden * (high - low), b = low + kGolden * (high - low);
    double fa = spectrum.at(a), fb = spectrum.at(b);
    while (high - low > kSettledBearing) {
      if (fa > fb) {
        high = b;
        b = a;
        fb = fa;
        a = high - kGolden * (high - low);
        fa = spectrum.at(a);
      } else {
        low = a;
        a = b;
        fa = fb;
        b = low + kGolden * (high - low);
        fb = spectrum.at(b);
      }
    }
    out.push_back(wrap_to_pi(0.5 * (low + high)));
  }
  return out;
}

BearingCheck check_bearings(std::span<const double> bearing_rad, const Eigen::MatrixXd& covariance_rad2,
                            std::span<const double> node_position_m, const Eigen::Vector2d& position_m,
                            const Eigen::Matrix2d& position_covariance_m2, double heading_rad, double heading_sigma_rad,
                            double gate) {
  const std::size_t nodes = bearing_rad.size();
  require(nodes >= 1 && node_position_m.size() == 2 * nodes, "node_position_m", node_position_m.size(),
          "two numbers per bearing");
  require(
      covariance_rad2.rows() == static_cast<Eigen::Index>(nodes) && covariance_rad2.cols() == covariance_rad2.rows(),
      "covariance_rad2", covariance_rad2.rows(), "a row and a column per bearing");
  require(gate > 0.0, "gate", gate, "it must be positive");
  require(heading_sigma_rad >= 0.0, "heading_sigma_rad", heading_sigma_rad, "it must be >= 0");
  const bool free = std::isinf(heading_sigma_rad);
  require(free || std::isfinite(heading_rad), "heading_rad", heading_rad, "it must be finite");
  require(position_m.allFinite(), "position_m", position_m[0], "it must be finite");
  require(position_covariance_m2.allFinite(), "position_covariance_m2", position_covariance_m2(0, 0),
          "it must be finite");

  BearingCheck out;
  const double nan = std::numeric_limits<double>::quiet_NaN();
  out.residual_rad.assign(nodes, nan);
  out.statistic.assign(nodes, nan);
  out.consistent.assign(nodes, 0);
  std::vector<double> expected(nodes);
  Eigen::MatrixXd H(static_cast<Eigen::Index>(nodes), 2);
  std::vector<std::size_t> in;
  for (std::size_t i = 0; i < nodes; ++i) {
    const double x = node_position_m[2 * i] - position_m[0], y = node_position_m[2 * i + 1] - position_m[1];
    const double squared = x * x + y * y;
    require(std::isfinite(squared) && squared > 0.0, "node_position_m", node_position_m[2 * i],
            "finite, and not where the receiver is");
    expected[i] = std::atan2(y, x);
    H.row(static_cast<Eigen::Index>(i)) << y / squared, -x / squared;
    if (std::isfinite(bearing_rad[i])) in.push_back(i);
  }
  const std::size_t needed = free ? 2 : 1;
  for (;;) {
    out.heading_rad = heading_rad;
    if (free) {  // a first heading that all residuals are small about
      Cf64 sum = 0.0;
      for (const std::size_t i : in) sum += std::polar(1.0, expected[i] - bearing_rad[i]);
      out.heading_rad = std::arg(sum);
    }
    const auto count = static_cast<Eigen::Index>(in.size());
    out.degrees_of_freedom = static_cast<int>(count) - (free ? 1 : 0);
    out.total = 0.0;
    if (in.size() < needed) break;
    Eigen::VectorXd v(count);
    Eigen::MatrixXd S(count, count);
    for (Eigen::Index a = 0; a < count; ++a) {
      const std::size_t i = in[static_cast<std::size_t>(a)];
      v[a] = wrap_to_pi(bearing_rad[i] - expected[i] + out.heading_rad);
      for (Eigen::Index b = 0; b < count; ++b) {
        const auto ii = static_cast<Eigen::Index>(i);
        const auto jj = static_cast<Eigen::Index>(in[static_cast<std::size_t>(b)]);
        S(a, b) = covariance_rad2(ii, jj) + H.row(ii) * position_covariance_m2 * H.row(jj).transpose();
        if (!free) S(a, b) += heading_sigma_rad * heading_sigma_rad;
      }
    }
    const Eigen::LLT<Eigen::MatrixXd> factor(S);
    require(factor.info() == Eigen::Success && S.allFinite(), "covariance_rad2", S(0, 0),
            "positive definite for the bearings that are given");
    Eigen::MatrixXd W = factor.solve(Eigen::MatrixXd::Identity(count, count));
    if (free) {  // the heading projected out
      const Eigen::VectorXd one = W.rowwise().sum();
      const double total = one.sum();
      const double shift = one.dot(v) / total;
      v.array() -= shift;
      out.heading_rad = wrap_to_pi(out.heading_rad - shift);
      W -= one * one.transpose() / total;
    }
    const Eigen::VectorXd Wv = W * v;
    out.total = v.dot(Wv);
    Eigen::Index worst = 0;
    double largest = -1.0;
    for (Eigen::Index a = 0; a < count; ++a) {
      const std::size_t i = in[static_cast<std::size_t>(a)];
      out.residual_rad[i] = v[a];
      out.statistic[i] = Wv[a] * Wv[a] / W(a, a);
      if (out.statistic[i] > largest) {
        largest = out.statistic[i];
        worst = a;
      }
    }
    if (!(largest > gate) || in.size() <= needed) break;
    in.erase(in.begin() + static_cast<std::ptrdiff_t>(worst));
  }
  // Those left out: what they are off by, under the heading that the others have.
  for (std::size_t i = 0; i < nodes; ++i) {
    const bool kept = std::find(in.begin(), in.end(), i) != in.end();
    out.consistent[i] = kept && out.statistic[i] <= gate ? 1 : 0;
    if (!kept && std::isfinite(bearing_rad[i])) {
      out.residual_rad[i] = wrap_to_pi(bearing_rad[i] - expected[i] + out.heading_rad);
    }
  }
  return out;
}

}  // namespace soopnav::array
