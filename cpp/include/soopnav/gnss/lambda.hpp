#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

/// Satellite navigation: positions, carrier phase, integers and attitude.
namespace soopnav::gnss {

/// Most integers that are estimated together.
inline constexpr int kMaxAmbiguities = 48;

/// How an integer least-squares problem ended.
enum class IntegerStatus : std::uint8_t {
  kSolved,               ///< the candidates are the best ones, in order
  kNonFinite,            ///< NaN or infinity in the float estimate or its covariance
  kNotPositiveDefinite,  ///< the covariance has no positive definite lower triangle
  kWrongSize,            ///< no integer at all, more than `kMaxAmbiguities`, or a covariance of another size
  kSearchLimit,          ///< the search was given up: the candidates are the best seen, not surely the best there are
  kTooLarge,             ///< a float estimate, or an integer met on the way, above 2^52: neighbours are not told apart
};

/// A lower-case phrase: "solved", "not positive definite", ...
[[nodiscard]] std::string_view to_string(IntegerStatus status) noexcept;

/// Integer least squares: the integer vectors nearest to a float estimate in the metric of its covariance.
///
///     minimise  |a - z|^2_Q = (a - z)' Q^-1 (a - z)   over z in Z^n,  best `candidates` of them   (doc/attitude.md eq.
///     1)
///
/// LAMBDA: Q = L' D L, then integer Gauss steps and swaps make L's off-diagonals small and order D, which turns the
/// long thin ellipsoid into a rounder one by a unimodular Z (Teunissen 1995; de Jonge and Tiberius 1996); then a
/// depth-first search, nearest integer first at each level, inside an ellipsoid that shrinks to the worst candidate
/// kept (doc/attitude.md eq. 2 to 5). Units of `a`: cycles; of Q: cycles^2.
///
/// An object keeps the scratch: construction allocates, nothing else does. Cost for one epoch of code and phase: some
/// microseconds for 8 integers, 10 ms for 40 whose second best is far away.
class IntegerLeastSquares {
 public:
  using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kMaxAmbiguities, kMaxAmbiguities>;
  using Vector = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMaxAmbiguities, 1>;

  /// Keeps the best `candidates`. Gives up after visiting `max_nodes` partial vectors.
  /// @throws std::invalid_argument when `candidates` is not 1 ... 10 000 or `max_nodes` is below 1.
  explicit IntegerLeastSquares(int candidates = 2, std::int64_t max_nodes = 20'000'000);

  /// The candidates of `a` with covariance `Q`, of which only the lower triangle is read. Does not allocate.
  [[nodiscard]] IntegerStatus solve(const Eigen::Ref<const Eigen::VectorXd>& a,
                                    const Eigen::Ref<const Eigen::MatrixXd>& Q) noexcept;

  /// Only the first half of `solve`: L, D and Z of `Q`, for `success_rate` and `Z`.
  [[nodiscard]] IntegerStatus decorrelate(const Eigen::Ref<const Eigen::MatrixXd>& Q) noexcept;

  /// Candidates found by the last `solve`: as asked for, or fewer after `kSearchLimit`; 0 when it failed.
  [[nodiscard]] int count() const noexcept { return count_; }
  /// Candidate `k`, integers as doubles, n of them.
  [[nodiscard]] std::span<const double> candidate(int k) const noexcept;
  /// Its squared norm |a - z|^2_Q, ascending with `k`.
  [[nodiscard]] double squared_norm(int k) const noexcept { return norms_[order_[static_cast<std::size_t>(k)]]; }
  /// Second squared norm over the first: the ratio test's number; infinite when the first is 0, NaN below two
  /// candidates.
  [[nodiscard]] double ratio() const noexcept;

  /// Probability that integer bootstrapping (and so at least that of the best candidate) is right, for a float estimate
  /// with covariance Q: the product of 2 Phi(1 / (2 sigma_i|i+1...n)) - 1 (doc/attitude.md eq. 6). NaN before
  /// `decorrelate` or `solve`.
  [[nodiscard]] double success_rate() const noexcept;
  /// The unimodular transformation, z = Z' a; its entries are integers.
  [[nodiscard]] const Matrix& Z() const noexcept { return Z_; }
  /// Conditional variances of z, the last integer first to be fixed [cycles^2].
  [[nodiscard]] const Vector& conditional_variances() const noexcept { return d_; }
  /// Partial vectors that the last search visited.
  [[nodiscard]] std::int64_t nodes() const noexcept { return nodes_; }

 private:
  bool factorise(const Eigen::Ref<const Eigen::MatrixXd>& Q) noexcept;
  void reduce() noexcept;
  void gauss(Eigen::Index i, Eigen::Index j) noexcept;
  void swap(Eigen::Index j) noexcept;
  bool search(const Vector& z_float) noexcept;
  void keep(const Vector& z, double norm) noexcept;

  int wanted_;
  std::int64_t max_nodes_;
  std::int64_t nodes_ = 0;
  int count_ = 0;
  Matrix L_, Z_, z_inverse_;
  Vector d_;
  std::vector<double> found_;       // [slot * kMaxAmbiguities + i]
  std::vector<double> norms_;       // [slot]
  std::vector<std::size_t> order_;  // slots by ascending norm
};

}  // namespace soopnav::gnss
