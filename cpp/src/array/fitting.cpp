#include "array/fitting.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <sstream>
#include <string>

#include "array/kernels.hpp"
#include "array/require.hpp"
#include "soopnav/array/crlb.hpp"
#include "soopnav/core/constants.hpp"

namespace soopnav::array {

namespace {

constexpr double kEps = std::numeric_limits<double>::epsilon();
constexpr int kMaxFits = 60;
constexpr double kWidest = kPi / 2;

// Steering vectors of K sources and their derivatives, 2 K columns, azimuth before elevation.
using Wide = Eigen::Matrix<Cf64, Eigen::Dynamic, Eigen::Dynamic, Eigen::ColMajor, kMaxElements, 2 * kMaxElements>;
using Information =
    Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::ColMajor, 2 * kMaxElements, 2 * kMaxElements>;
using Step = Eigen::Matrix<double, Eigen::Dynamic, 1, Eigen::ColMajor, 2 * kMaxElements, 1>;

double conjugate(double x) { return x; }
Cf64 conjugate(const Cf64& x) { return std::conj(x); }

/// L L^H = A in place of the lower triangle; false when A is not positive definite, by `least` of its diagonal.
template <class Square>
bool factor(Square& A, double least) {
  for (Eigen::Index j = 0; j < A.rows(); ++j) {
    const double before = std::real(A(j, j));
    double pivot = before;
    for (Eigen::Index k = 0; k < j; ++k) pivot -= std::norm(A(j, k));
    if (!(pivot > least * before) || !std::isfinite(pivot)) return false;
    const double root = std::sqrt(pivot);
    A(j, j) = root;
    for (Eigen::Index i = j + 1; i < A.rows(); ++i) {
      auto sum = A(i, j);
      for (Eigen::Index k = 0; k < j; ++k) sum -= A(i, k) * conjugate(A(j, k));
      A(i, j) = sum / root;
    }
  }
  return true;
}

/// Solves L L^H X = B in place.
template <class Square, class Right>
void solve(const Square& L, Right& B) {
  for (Eigen::Index c = 0; c < B.cols(); ++c) {
    for (Eigen::Index i = 0; i < L.rows(); ++i) {
      for (Eigen::Index k = 0; k < i; ++k) B(i, c) -= L(i, k) * B(k, c);
      B(i, c) /= L(i, i);
    }
    for (Eigen::Index i = L.rows() - 1; i >= 0; --i) {
      for (Eigen::Index k = i + 1; k < L.rows(); ++k) B(i, c) -= conjugate(L(k, i)) * B(k, c);
      B(i, c) /= L(i, i);
    }
  }
}

/// Inverse of a Hermitian matrix; false when it is not positive definite.
template <class Square>
bool invert(const Square& matrix, Square& inverse) {
  Square lower = matrix;
  if (!factor(lower, 1e-13)) return false;
  inverse.setIdentity(matrix.rows(), matrix.rows());
  solve(lower, inverse);
  return true;
}

/// A, its pseudo-inverse and P_A^perp D at the directions u.
struct Subspace {
  ComplexMatrix A, inverse, pseudo;  // M x K, (A^H A)^-1, K x M
  Wide D;                            // projected

  bool at(const Manifold& manifold, double frequency_hz, int active, std::span<const Eigen::Vector3d> u) {
    const Eigen::Index elements = manifold.size(), sources = static_cast<Eigen::Index>(u.size());
    const Eigen::Index each = active == 3 ? 2 : 1;
    A.resize(elements, sources);
    D.resize(elements, each * sources);
    SteeringJet jet;
    for (Eigen::Index k = 0; k < sources; ++k) {
      const Eigen::Vector3d& at = u[static_cast<std::size_t>(k)];
      const Tangents tangents(at);
      if (!manifold.steering(at, tangents.azimuth, tangents.elevation, frequency_hz, jet)) return false;
      A.col(k) = jet.value;
      if (active == 3) {
        D.col(2 * k) = jet.first[0];
        D.col(2 * k + 1) = jet.first[1];
      } else {
        D.col(k) = jet.first[active - 1];
      }
    }
    const ComplexMatrix gram = A.adjoint().lazyProduct(A);
    if (!invert(gram, inverse)) return false;
    pseudo = inverse.lazyProduct(A.adjoint());
    const Wide inside = pseudo.lazyProduct(D);
    D -= A.lazyProduct(inside);
    return true;
  }

  /// Re tr(P_A B).
  [[nodiscard]] double captured(const ComplexMatrix& B) const {
    const ComplexMatrix BA = B.lazyProduct(A);
    double sum = 0.0;
    for (Eigen::Index k = 0; k < A.cols(); ++k) {
      for (Eigen::Index m = 0; m < A.rows(); ++m) sum += (pseudo(k, m) * BA(m, k)).real();
    }
    return sum;
  }

  /// Re[(D^H P D) o (T)^T], T being K x K, each entry for every pair of angles.
  [[nodiscard]] Information weighted(const ComplexMatrix& T) const {
    const Eigen::Index columns = D.cols(), each = columns / A.cols();
    Information out(columns, columns);
    for (Eigen::Index i = 0; i < columns; ++i) {
      for (Eigen::Index j = 0; j < columns; ++j) {
        const Cf64 product = D.col(i).dot(D.col(j));
        out(i, j) = (product * T(j / each, i / each)).real();
      }
    }
    return out;
  }
};

}  // namespace

Tangents::Tangents(const Eigen::Vector3d& u) noexcept {
  const double flat = std::hypot(u[0], u[1]);
  const double c = flat > 1e-12 ? u[0] / flat : 1.0, s = flat > 1e-12 ? u[1] / flat : 0.0;
  azimuth = {-s, c, 0.0};
  elevation = {-u[2] * c, -u[2] * s, flat};
}

Eigen::Matrix2d in_angles(const Eigen::Matrix2d& tangent, const Eigen::Vector3d& u) noexcept {
  const double stretch = 1.0 / std::max(1e-6, std::hypot(u[0], u[1]));
  Eigen::Matrix2d out = tangent;
  out.row(0) *= stretch;
  out.col(0) *= stretch;
  return out;
}

Eigen::Matrix2d bounded_inverse(const Eigen::Matrix2d& information, int active) noexcept {
  constexpr double kLeast = 1.0 / (kWidest * kWidest);
  Eigen::Matrix2d out = Eigen::Matrix2d::Zero();
  if (active != 3) {
    const int told = active - 1;
    out(told, told) = 1.0 / std::max(kLeast, information(told, told));
    out(1 - told, 1 - told) = std::numeric_limits<double>::infinity();
    return out;
  }
  const double mean = 0.5 * (information(0, 0) + information(1, 1));
  const double half = std::hypot(0.5 * (information(0, 0) - information(1, 1)), information(0, 1));
  const double angle = 0.5 * std::atan2(2.0 * information(0, 1), information(0, 0) - information(1, 1));
  const double c = std::cos(angle), s = std::sin(angle);
  const double v1 = 1.0 / std::max(kLeast, mean + half);
  const double least = (information(0, 0) * information(1, 1) - information(0, 1) * information(0, 1)) / (mean + half);
  const double v2 = 1.0 / (mean + half > 0.0 ? std::max(kLeast, least) : kLeast);
  out << c * c * v1 + s * s * v2, c * s * (v1 - v2), c * s * (v1 - v2), s * s * v1 + c * c * v2;
  return out;
}

bool fit_directions(const Manifold& manifold, double frequency_hz, int active, const ComplexMatrix& R,
                    const HermitianEigen& eigen, double noise, double n_snapshots, bool subspace,
                    std::span<Eigen::Vector3d> u, std::span<Eigen::Matrix2d> covariance) noexcept {
  const auto sources = static_cast<Eigen::Index>(u.size());
  const Eigen::Index elements = R.rows(), each = active == 3 ? 2 : 1;
  const double floor = std::max(noise, kEps * eigen.values[0]);
  ComplexMatrix B = R;
  if (subspace) {
    B.setZero(elements, elements);
    for (Eigen::Index k = 0; k < sources; ++k) {
      const double above = std::max(0.0, eigen.values[k] - floor);
      const double weight = above * above / std::max(eigen.values[k], floor);
      for (Eigen::Index i = 0; i < elements; ++i) {
        for (Eigen::Index j = 0; j < elements; ++j) {
          B(i, j) += weight * eigen.vectors(i, k) * std::conj(eigen.vectors(j, k));
        }
      }
    }
  }
  Subspace here;
  if (!here.at(manifold, frequency_hz, active, u)) return false;
  double captured = here.captured(B);
  std::array<Eigen::Vector3d, kMaxElements> tried;
  double damping = 1e-3;
  for (int iteration = 0; iteration < kMaxFits; ++iteration) {
    const ComplexMatrix pseudo_B = here.pseudo.lazyProduct(B);
    const ComplexMatrix T = pseudo_B.lazyProduct(here.pseudo.adjoint());
    const Information curvature = here.weighted(T);
    Step gradient(each * sources);
    for (Eigen::Index i = 0; i < gradient.size(); ++i) {
      Cf64 sum = 0.0;
      for (Eigen::Index m = 0; m < elements; ++m) sum += pseudo_B(i / each, m) * here.D(m, i);
      gradient[i] = sum.real();
    }
    bool moved = false;
    double length = 0.0;
    for (int attempt = 0; attempt < 10 && !moved; ++attempt) {
      Information damped = curvature;
      for (Eigen::Index i = 0; i < damped.rows(); ++i) damped(i, i) *= 1.0 + damping;
      if (!factor(damped, 0.0)) {
        damping = std::max(1e-6, 10.0 * damping);
        continue;
      }
      Step step = gradient;
      solve(damped, step);
      length = step.norm();
      if (!std::isfinite(length)) return false;
      if (length > 0.2) step *= 0.2 / length;
      for (Eigen::Index k = 0; k < sources; ++k) {
        const Eigen::Vector3d& from = u[static_cast<std::size_t>(k)];
        const Tangents tangents(from);
        Eigen::Vector3d to = from;
        if (active != 2) to += step[each * k] * tangents.azimuth;
        if (active != 1) to += step[each * k + each - 1] * tangents.elevation;
        tried[static_cast<std::size_t>(k)] = to.normalized();
      }
      Subspace there;
      const auto next = std::span(tried).first(u.size());
      if (there.at(manifold, frequency_hz, active, next)) {
        const double value = there.captured(B);
        if (value >= captured * (1.0 - 1e-15) || length < 1e-8) {
          std::copy(next.begin(), next.end(), u.begin());
          here = there;
          captured = value;
          damping = std::max(1e-9, 0.1 * damping);
          moved = true;
          break;
        }
      }
      damping = std::max(1e-6, 10.0 * damping);
    }
    if (!moved || length < 1e-11) break;
  }
  // doc/array.md eq. 13: the fit of the subspace reaches the stochastic bound; maximum likelihood has its sandwich.
  const ComplexMatrix pseudo_B = here.pseudo.lazyProduct(B);
  const ComplexMatrix T = pseudo_B.lazyProduct(here.pseudo.adjoint());
  Information inverse;
  const Information outer = here.weighted(T);
  bool regular = false;
  if (subspace) {
    regular = invert(outer, inverse);
  } else {
    const ComplexMatrix S = T - floor * here.inverse;
    regular = invert(here.weighted(S), inverse);
    if (regular) inverse = Information(Information(inverse.lazyProduct(outer)).lazyProduct(inverse));
  }
  for (Eigen::Index k = 0; k < sources; ++k) {
    Eigen::Matrix2d information = Eigen::Matrix2d::Zero();
    if (regular) {
      const Eigen::Matrix2d block = each == 2 ? Eigen::Matrix2d(inverse.block<2, 2>(2 * k, 2 * k))
                                              : Eigen::Matrix2d(Eigen::Matrix2d::Identity() * inverse(k, k));
      const double determinant = block(0, 0) * block(1, 1) - block(0, 1) * block(1, 0);
      information << block(1, 1), -block(0, 1), -block(1, 0), block(0, 0);
      information *= 2.0 * n_snapshots / (floor * determinant);
    }
    covariance[static_cast<std::size_t>(k)] = bounded_inverse(information, active);
  }
  return true;
}

void alternating_projections(const SteeringTable& table, const ComplexMatrix& R,
                             std::span<Eigen::Vector3d> u) noexcept {
  const Eigen::Index elements = R.rows();
  ComplexVector a;
  std::size_t known = 0;
  const std::size_t rounds = u.size() == 1 ? 1 : 2 * u.size();
  for (std::size_t turn = 0; turn < rounds; ++turn) {
    const std::size_t k = turn % u.size();
    // P^perp of the others, by Gram-Schmidt.
    ComplexMatrix basis(elements, static_cast<Eigen::Index>(u.size()));
    Eigen::Index size = 0;
    for (std::size_t other = 0; other < known; ++other) {
      if (other == k || !table.manifold().steering(u[other], table.frequency_hz(), a)) continue;
      for (int pass = 0; pass < 2; ++pass) {
        for (Eigen::Index b = 0; b < size; ++b) a -= basis.col(b) * basis.col(b).dot(a);
      }
      if (a.norm() > 1e-6) basis.col(size++) = a.normalized();
    }
    ComplexMatrix projected = R;
    for (Eigen::Index b = 0; b < size; ++b) {
      const ComplexVector v = basis.col(b);
      projected -= v.lazyProduct(v.adjoint().lazyProduct(projected));
      const ComplexVector w = projected.lazyProduct(v);
      projected -= w.lazyProduct(v.adjoint());
    }
    double best = -1.0;
    std::size_t found = 0;
    for (std::size_t i = 0; i < table.size(); ++i) {
      const float* const at = table.values().data() +
                              i / kernels::kLanes * 2 * static_cast<std::size_t>(elements) * kernels::kLanes +
                              i % kernels::kLanes;
      a.resize(elements);
      for (Eigen::Index m = 0; m < elements; ++m) {
        const float* const value = at + 2 * static_cast<std::size_t>(m) * kernels::kLanes;
        a[m] = Cf64(static_cast<double>(value[0]), static_cast<double>(value[kernels::kLanes]));
      }
      double rest = a.squaredNorm();
      for (Eigen::Index b = 0; b < size; ++b) rest -= std::norm(basis.col(b).dot(a));
      if (!(rest > 1e-3)) continue;  // a direction that is already taken
      double form = 0.0;
      for (Eigen::Index j = 0; j < elements; ++j) {
        Cf64 sum = 0.0;
        for (Eigen::Index m = 0; m < elements; ++m) sum += std::conj(a[m]) * projected(m, j);
        form += (sum * a[j]).real();
      }
      if (form / rest > best) {
        best = form / rest;
        found = i;
      }
    }
    u[k] = unit_vector(table.direction(found));
    known = std::max(known, k + 1);
  }
}

void source_powers(const ComplexMatrix& A, const ComplexMatrix& R, double noise, std::span<double> out) noexcept {
  std::fill(out.begin(), out.end(), 0.0);
  if (out.empty()) return;
  ComplexMatrix inverse;
  const ComplexMatrix gram = A.adjoint().lazyProduct(A);
  if (!invert(gram, inverse)) return;
  const ComplexMatrix pseudo = inverse.lazyProduct(A.adjoint());
  const ComplexMatrix product = pseudo.lazyProduct(R);
  for (std::size_t k = 0; k < out.size(); ++k) {
    const auto i = static_cast<Eigen::Index>(k);
    double power = -noise * inverse(i, i).real();
    for (Eigen::Index m = 0; m < R.rows(); ++m) power += (product(i, m) * std::conj(pseudo(i, m))).real();
    out[k] = std::max(0.0, power);
  }
}

namespace {

std::string shown(std::span<const Direction> directions) {
  std::ostringstream text;
  const char* gap = "";
  for (const Direction& direction : directions) {
    text << gap << "azimuth " << direction.azimuth_rad << ", elevation " << direction.elevation_rad << " rad";
    gap = " and ";
  }
  return text.str();
}

Eigen::MatrixXd bound(const Manifold& manifold, std::span<const Direction> directions, const ComplexMatrix& powers,
                      double noise, double n_snapshots, CrlbKind kind, int active) {
  const Eigen::Index sources = static_cast<Eigen::Index>(directions.size());
  require(sources >= 1 && sources < manifold.size(), "directions", sources,
          "1 to the number of elements less one expected");
  require(powers.rows() == sources && powers.cols() == sources, "powers", powers.rows(),
          "a K x K matrix for K directions expected");
  require(std::isfinite(noise) && noise > 0.0, "noise", noise, "a positive finite variance expected");
  require(std::isfinite(n_snapshots) && n_snapshots > 0.0, "n_snapshots", n_snapshots, "a positive number expected");
  for (Eigen::Index i = 0; i < sources; ++i) {
    require(powers(i, i).real() > 0.0 && std::isfinite(powers(i, i).real()), "powers", powers(i, i).real(),
            "positive finite powers expected");
    for (Eigen::Index j = 0; j < sources; ++j) {
      const double scale = std::sqrt(powers(i, i).real() * powers(j, j).real());
      require(std::abs(powers(i, j) - std::conj(powers(j, i))) <= 1e-9 * scale &&
                  std::abs(powers(i, j)) <= scale * (1 + 1e-9),
              "powers", powers(i, j), "a Hermitian, positive semidefinite matrix expected");
    }
  }
  std::array<Eigen::Vector3d, kMaxElements> u;
  for (std::size_t k = 0; k < directions.size(); ++k) {
    u[k] = unit_vector(directions[k]);
    require(u[k].allFinite(), "directions", k, "this direction is not finite");
  }
  Subspace at;
  const bool regular = at.at(manifold, manifold.geometry().frequency_hz(), active,
                             std::span<const Eigen::Vector3d>(u).first(directions.size()));
  if (!regular) require(false, "directions", shown(directions), "the array cannot tell these directions apart");
  ComplexMatrix T = powers;
  if (kind == CrlbKind::kStochastic) {
    const ComplexMatrix R = ComplexMatrix(ComplexMatrix(at.A.lazyProduct(powers)).lazyProduct(at.A.adjoint())) +
                            noise * ComplexMatrix::Identity(at.A.rows(), at.A.rows());
    ComplexMatrix lower = R;
    require(factor(lower, 0.0), "powers", sources, "a positive semidefinite matrix expected");
    ComplexMatrix solved = at.A.lazyProduct(powers);  // A S
    const ComplexMatrix AS = solved;
    solve(lower, solved);
    T = AS.adjoint().lazyProduct(solved);
  }
  Information inverse;
  const bool determined = invert(Information(at.weighted(T) * (2.0 * n_snapshots / noise)), inverse);
  if (!determined) require(false, "directions", shown(directions), "the array does not determine these angles");
  if (active == 3) {
    for (Eigen::Index k = 0; k < sources; ++k) {
      const Eigen::Vector3d& direction = u[static_cast<std::size_t>(k)];
      const double flat = std::hypot(direction[0], direction[1]);
      require(flat > 1e-9, "directions", k, "azimuth does not exist at the zenith");
      inverse.row(2 * k) /= flat;
      inverse.col(2 * k) /= flat;
    }
  } else {
    for (Eigen::Index k = 0; k < sources; ++k) {
      const double flat = std::cos(directions[static_cast<std::size_t>(k)].elevation_rad);
      inverse.row(k) /= flat;
      inverse.col(k) /= flat;
    }
  }
  return inverse;
}

}  // namespace

Eigen::MatrixXd crlb(const Manifold& manifold, std::span<const Direction> directions, const ComplexMatrix& powers,
                     double noise, double n_snapshots, CrlbKind kind) {
  return bound(manifold, directions, powers, noise, n_snapshots, kind, 3);
}

Eigen::MatrixXd azimuth_crlb(const Manifold& manifold, std::span<const Direction> directions,
                             const ComplexMatrix& powers, double noise, double n_snapshots, CrlbKind kind) {
  return bound(manifold, directions, powers, noise, n_snapshots, kind, 1);
}

}  // namespace soopnav::array
