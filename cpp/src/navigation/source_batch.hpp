#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "navigation/source_filter.hpp"

/// The methods that solve for all bearings at once.
namespace soopnav::navigation::detail {

/// Sum of the triangles' centres.
struct TripleSum {
  std::array<double, 3> sum{};
  std::array<std::array<double, 3>, 3> squares{};
  std::size_t count = 0;
};

/// Adds the centre of the triangle that three bearings make (carter 5.2 or 5.3), when every two of them cross at least
/// at `min_crossing_rad` modulo half a turn and every intersection lies ahead of both.
void add_triple(const Kept& a, const Kept& b, const Kept& c, bool incenter, bool space, double min_crossing_rad,
                TripleSum& out) noexcept;

/// What a search ended with.
struct Solution {
  bool solved = false;     ///< false: nothing to state
  bool converged = false;  ///< a minimum
  Vector x{};
  Matrix covariance{};
  double cost = 0.0;  ///< minus the log-likelihood
  double chi_square = 0.0;
  std::size_t angles = 0;  ///< in `chi_square`
  std::size_t outliers = 0;
};

/// Pseudo-linear least squares (carter 5.8): unweighted as printed, or with Stansfield's weights 1 / (r² sigma²), the
/// ranges iterated. Not solved where the bearings are parallel or from one place.
[[nodiscard]] Solution pseudo_linear(std::size_t dimensions, std::span<const Kept> bearings, bool weighted,
                                     int iterations) noexcept;

/// What a Newton search works on.
struct Problem {
  Layout layout;
  std::span<const Kept> bearings;
  double t_s = 0.0;      ///< time of the state
  double outlier = 0.0;  ///< 0: least squares
  double bias_sigma = 0.0;
  int iterations = 50;
};

/// Levenberg and Marquardt on the negative log-likelihood, from `x`.
[[nodiscard]] Solution search(const Problem& problem, const Vector& x) noexcept;

/// The log-likelihood over a square, to which bearings are added as they come (doc/source_location.md section 5).
class SearchGrid {
 public:
  explicit SearchGrid(int size);
  void clear() noexcept;
  /// Brings the grid up to `bearings` within `radius_m` of (x, y), all over when the square moves.
  void fill(std::span<const Kept> bearings, double x, double y, double radius_m, double outlier) noexcept;
  /// The best local maxima, best first, each refined on two finer grids. Returns how many.
  std::size_t peaks(std::span<const Kept> bearings, double outlier, std::span<std::array<double, 2>> out) noexcept;

 private:
  void add(std::span<const Kept> bearings, std::span<const double> x, std::span<const double> y, double outlier,
           std::span<double> values) noexcept;

  std::size_t size_;
  double x_ = 0.0, y_ = 0.0, radius_ = 0.0;
  std::size_t filled_ = 0;
  std::vector<double> px_, py_, values_;
};

}  // namespace soopnav::navigation::detail
