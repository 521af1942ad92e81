#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>

#include "soopnav/navigation/position_fix.hpp"

namespace soopnav::navigation {
namespace {

// Candidates in D dimensions; `offsets`: what the fixed third coordinate adds to the squared distance of each node.
template <int D>
int candidates_in(const Eigen::Ref<const Eigen::Matrix3Xd>& positions, const Eigen::Ref<const Eigen::VectorXd>& rho,
                  double height, std::array<Eigen::Matrix<double, D + 1, 1>, 3>& out) {
  constexpr int N = D + 1;
  using Vector = Eigen::Matrix<double, N, 1>;
  using Square = Eigen::Matrix<double, N, N>;
  const Eigen::Index n = positions.cols();
  const auto count = static_cast<double>(n);
  // About the mean of the nodes and of the pseudoranges: eq. 11.
  Vector mean = Vector::Zero();
  for (Eigen::Index i = 0; i < n; ++i) {
    mean.template head<D>() += positions.col(i).template head<D>() / count;
    mean[D] += rho[i] / count;
  }
  const auto row = [&](Eigen::Index i) {
    Vector a;
    a << positions.col(i).template head<D>(), rho[i];
    a -= mean;
    return a;
  };
  const auto square = [&](Eigen::Index i, const Vector& a) {
    const double up = D == 2 ? positions(2, i) - height : 0.0;
    return a.template head<D>().squaredNorm() - a[D] * a[D] + up * up;
  };
  double mean_square = 0.0;
  for (Eigen::Index i = 0; i < n; ++i) mean_square += square(i, row(i)) / count;
  Square G = Square::Zero();
  Vector k = Vector::Zero();
  for (Eigen::Index i = 0; i < n; ++i) {
    Vector a = row(i);
    const double right = 0.5 * (square(i, a) - mean_square);
    a[D] = -a[D];
    G += a * a.transpose();
    k += right * a;
  }
  const Eigen::SelfAdjointEigenSolver<Square> eigen(G);
  if (eigen.info() != Eigen::Success) return 0;
  const Vector& lambda = eigen.eigenvalues();  // ascending
  if (!(lambda[N - 1] > 0.0)) return 0;
  constexpr double kSmall = 1e-12;
  // The line y0 + t w of eq. 12, along the weakest direction.
  const Vector w = eigen.eigenvectors().col(0);
  Vector y0 = Vector::Zero();
  for (int j = 1; j < N; ++j) {
    if (lambda[j] > kSmall * lambda[N - 1])
      y0 += eigen.eigenvectors().col(j).dot(k) / lambda[j] * eigen.eigenvectors().col(j);
  }
  const auto lorentz = [](const Vector& a, const Vector& b) {
    return a.template head<D>().dot(b.template head<D>()) - a[D] * b[D];
  };
  // a t² + 2 h t + c = 0, eq. 13
  const double a = lorentz(w, w);
  const double h = lorentz(y0, w);
  const double c = lorentz(y0, y0) + mean_square;
  const double discriminant = h * h - a * c;
  std::array<double, 3> t{};
  std::size_t roots = 0;
  if (std::abs(a) * std::abs(c) < 1e-14 * h * h) {
    // A double root at infinity: one solution.
    t[roots++] = -c / (2.0 * h);
    if (std::abs(a) > 0.0) t[roots++] = -2.0 * h / a;
  } else if (discriminant >= 0.0) {
    const double q = -(h + std::copysign(std::sqrt(discriminant), h));
    t[roots++] = q / a;
    if (q != 0.0) t[roots++] = c / q;
  } else {
    // Noise keeps the surfaces apart: both sides of where they come closest.
    const double apart = std::sqrt(-discriminant) / a;
    t[roots++] = -h / a - apart;
    t[roots++] = -h / a + apart;
  }
  if (lambda[0] > kSmall * lambda[N - 1]) t[roots++] = w.dot(k) / lambda[0];
  int written = 0;
  for (std::size_t i = 0; i < roots; ++i) {
    const Vector y = y0 + t[i] * w + mean;
    if (y.allFinite()) out[static_cast<std::size_t>(written++)] = y;
  }
  return written;
}

template <int D>
int write_candidates(const Eigen::Ref<const Eigen::Matrix3Xd>& positions, const Eigen::Ref<const Eigen::VectorXd>& rho,
                     double height, std::span<ClosedFormFix, 3> candidates) {
  std::array<Eigen::Matrix<double, D + 1, 1>, 3> found;
  const int count = candidates_in<D>(positions, rho, height, found);
  // Those whose distances rho - b are all positive first.
  int written = 0;
  for (const bool wanted : {true, false}) {
    for (int i = 0; i < count; ++i) {
      const auto& y = found[static_cast<std::size_t>(i)];
      if ((rho.minCoeff() >= y[D]) != wanted) continue;
      ClosedFormFix& fix = candidates[static_cast<std::size_t>(written++)];
      fix.position_m << y.template head<D>(), Eigen::Matrix<double, 3 - D, 1>::Constant(height);
      fix.clock_bias_m = y[D];
    }
  }
  return written;
}

}  // namespace

int closed_form_fixes(const Eigen::Ref<const Eigen::Matrix3Xd>& positions_m,
                      const Eigen::Ref<const Eigen::VectorXd>& pseudoranges_m, std::optional<double> height_m,
                      std::span<ClosedFormFix, 3> candidates) noexcept {
  const Eigen::Index needed = height_m ? 3 : 4;
  if (positions_m.cols() < needed || pseudoranges_m.size() != positions_m.cols()) return 0;
  if (!positions_m.allFinite() || !pseudoranges_m.allFinite()) return 0;
  return height_m ? write_candidates<2>(positions_m, pseudoranges_m, *height_m, candidates)
                  : write_candidates<3>(positions_m, pseudoranges_m, 0.0, candidates);
}

}  // namespace soopnav::navigation
