#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <concepts>
#include <cstddef>
#include <limits>
#include <ranges>
#include <span>
#include <type_traits>
#include <utility>
#include <vector>

#include "soopnav/core/constants.hpp"
#include "soopnav/core/packet.hpp"
#include "soopnav/core/packet_math.hpp"
#include "soopnav/core/status.hpp"
#include "soopnav/estimation/observed.hpp"
#include "soopnav/estimation/particle_view.hpp"
#include "soopnav/estimation/prediction.hpp"

namespace soopnav {

/// An observation that is an outlier with `probability`, in 0 ... 1, and then has `density` (1 over the product of the
/// units of z) wherever it falls: the likelihood is (1 - probability) N(z; h, R) + probability * density
/// (doc/particle_filter.md eq. 6). No particle can then be ruled out by one wild value.
template <class ModelType>
struct Contaminated {
  using Model = ModelType;
  static constexpr int kDim = Model::kDim;
  Observed<Model> observed;
  double probability = 0.0;
  double density = 0.0;
};

/// A hard constraint from a function of the particles: `inside(x)` answers a `PacketMask`, or `bool` for single states.
/// Particles where it is false lose their weight.
template <class Inside>
struct Region {
  Inside inside;
  template <class X>
  [[nodiscard]] SOOPNAV_INLINE auto allows(const X& /*before*/, const X& after) const {
    return inside(after);
  }
};
template <class Inside>
Region(Inside) -> Region<Inside>;

/// A wall in a plane, from `a` to `b` [m].
struct Wall {
  Eigen::Vector2d a;
  Eigen::Vector2d b;
};

/// Walls nobody walks through: particles whose step crosses or touches one lose their weight (nielsen Annex A, PF4).
///
/// Reads the first two components of a position of `Dim` components, before and after the step. A particle at rest
/// off the walls touches none.
template <int Dim = 2>
struct Walls {
  std::vector<Wall> walls;

  template <class X>
  [[nodiscard]] SOOPNAV_INLINE auto allows(const X& before, const X& after) const {
    const auto p = before(kPositionOf<Dim>);
    const auto q = after(kPositionOf<Dim>);
    auto free = p[0] == p[0];
    for (const Wall& wall : walls) {
      const double ax = wall.a[0];
      const double ay = wall.a[1];
      const double wx = wall.b[0] - ax;
      const double wy = wall.b[1] - ay;
      // Sides of the wall's line the step begins and ends on, sides of the step's line the wall's ends lie on.
      const auto from = (p[1] - ay) * wx - (p[0] - ax) * wy;
      const auto to = (q[1] - ay) * wx - (q[0] - ax) * wy;
      const auto sx = q[0] - p[0];
      const auto sy = q[1] - p[1];
      const auto end_a = sx * (ay - p[1]) - sy * (ax - p[0]);
      const auto end_b = sx * (wall.b[1] - p[1]) - sy * (wall.b[0] - p[0]);
      // Both ends of the step beyond the same end of the wall.
      const auto along_p = (p[0] - ax) * wx + (p[1] - ay) * wy;
      const auto along_q = (q[0] - ax) * wx + (q[1] - ay) * wy;
      const double length2 = wx * wx + wy * wy;
      const auto past = ((along_p < 0.0) & (along_q < 0.0)) | ((along_p > length2) & (along_q > length2));
      // Or both beside the wall's box, which also settles a particle at rest and a wall that is a point.
      const double left = std::min(ax, wall.b[0]);
      const double right = std::max(ax, wall.b[0]);
      const double low = std::min(ay, wall.b[1]);
      const double high = std::max(ay, wall.b[1]);
      const auto beside = ((p[0] < left) & (q[0] < left)) | ((p[0] > right) & (q[0] > right)) |
                          ((p[1] < low) & (q[1] < low)) | ((p[1] > high) & (q[1] > high));
      free = free & (past | beside | (from * to > 0.0) | (end_a * end_b > 0.0));
    }
    return free;
  }
};

/// What a particle filter takes beside observations: something that allows the step of a particle from `before` to
/// `after` or not.
template <class C, class View>
concept ParticleConstraint = requires(const C& c, const View& x) {
  c.allows(x, x);
};

namespace detail {

template <class T>
inline constexpr bool kIsObserved = false;
template <class Model>
inline constexpr bool kIsObserved<Observed<Model>> = true;
template <class T>
inline constexpr bool kIsContaminated = false;
template <class Model>
inline constexpr bool kIsContaminated<Contaminated<Model>> = true;
template <class T>
inline constexpr bool kIsCorrelated = false;
template <class Model>
inline constexpr bool kIsCorrelated<Correlated<Model>> = true;

/// What a chunk of particles looks like to a term: `n` (a multiple of the packet's width) of them before and after the
/// step, and the log-likelihoods that the term adds to.
template <class State, class T>
struct TermChunk {
  ParticleColumns<T, kStateSize<State>> before;
  ParticleColumns<T, kStateSize<State>> after;
  T* log_likelihood;
  std::size_t n;
};

// Lower triangular inverse W of the Cholesky factor of R (R⁻¹ = Wᵀ W) and -log sqrt(det(2 pi R)).
template <int M, int MaxM>
struct Whitener {
  using Square = Eigen::Matrix<double, M, M, 0, MaxM, MaxM>;
  Square W;
  double log_peak = 0.0;

  Whitener() noexcept {
    if constexpr (M != Eigen::Dynamic) W.setIdentity();
  }
  [[nodiscard]] UpdateStatus compute(const Square& R) noexcept {
    const auto rows = R.rows();
    if (!R.allFinite()) return UpdateStatus::kNonFinite;
    const double scale = R.diagonal().cwiseAbs().maxCoeff();
    if (!((R - R.transpose()).cwiseAbs().maxCoeff() <= 1e-9 * scale)) return UpdateStatus::kNotPositiveDefinite;
    const Eigen::LLT<Square> llt(R);
    if (llt.info() != Eigen::Success) return UpdateStatus::kNotPositiveDefinite;
    W.setIdentity(rows, rows);
    llt.matrixL().solveInPlace(W);
    log_peak = -0.5 * static_cast<double>(rows) * std::log(kTwoPi);
    for (Eigen::Index i = 0; i < rows; ++i) log_peak += std::log(W(i, i));
    return W.allFinite() && std::isfinite(log_peak) ? UpdateStatus::kAccepted : UpdateStatus::kNotPositiveDefinite;
  }
};

/// One observation, ready for packets: the exponent -|W (z - h)|^2 / 2.
template <class T, class Model>
struct GaussianTerm {
  static constexpr int kM = Model::kDim;
  static constexpr std::size_t kRows = static_cast<std::size_t>(kM);
  const Model* model = nullptr;
  std::array<T, kRows> z{};
  std::array<T, kRows * kRows> W{};
  T log_normal{};  // of (1 - probability) times the peak, and of probability * density: for outliers
  T log_outlier{};

  void set(const Observed<Model>& observed, const Whitener<kM, kM>& whitener) noexcept {
    model = &observed.model;
    for (int i = 0; i < kM; ++i) {
      z[static_cast<std::size_t>(i)] = static_cast<T>(observed.z[i]);
      for (int j = 0; j < kM; ++j) W[static_cast<std::size_t>(i * kM + j)] = static_cast<T>(whitener.W(i, j));
    }
  }
  template <class State>
  [[nodiscard]] SOOPNAV_INLINE Packet<T> operator()(const ParticleView<State, T>& x) const {
    using P = Packet<T>;
    ValuePrediction<P, kM> y;
    const bool defined = model->predict(x, y);
    std::array<P, kRows> r;
    P square(T{0});
    for (std::size_t i = 0; i < kRows; ++i) {
      r[i] = residual<Model>(static_cast<int>(i), P(z[i]), y.z[i]);
      P white = r[0] * P(W[i * kRows]);
      for (std::size_t j = 1; j <= i; ++j) white += r[j] * P(W[i * kRows + j]);
      square += white * white;
    }
    const P exponent = square * P(static_cast<T>(-0.5));
    return defined ? exponent : P(-std::numeric_limits<T>::infinity());
  }
  // log(e^a + e^b), a the Gaussian and b the outlier.
  template <class State>
  [[nodiscard]] SOOPNAV_INLINE Packet<T> mixture(const ParticleView<State, T>& x) const {
    using P = Packet<T>;
    const P a = (*this)(x) + P(log_normal);
    const P b(log_outlier);
    return max(a, b) + log(P(1) + exp(-abs(a - b)));
  }
};

// ---- Terms as given, checked and made ready once for a step (`check`), then added chunk by chunk (`add`).

template <class T, class Item>
struct ItemTraits;
template <class T, class M>
struct ItemTraits<T, Observed<M>> {
  using Model = M;
  static const Observed<M>& observed(const Observed<M>& item) noexcept { return item; }
  static bool sound(const Observed<M>& /*item*/) noexcept { return true; }
  static double constant(const Observed<M>& /*item*/, double log_peak) noexcept { return log_peak; }
  static void finish(const Observed<M>& /*item*/, double /*log_peak*/, GaussianTerm<T, M>& /*term*/) noexcept {}
  template <class State>
  static SOOPNAV_INLINE Packet<T> value(const GaussianTerm<T, M>& term, const ParticleView<State, T>& x) {
    return term(x);
  }
};
template <class T, class M>
struct ItemTraits<T, Contaminated<M>> {
  using Model = M;
  static const Observed<M>& observed(const Contaminated<M>& item) noexcept { return item.observed; }
  static bool sound(const Contaminated<M>& item) noexcept {
    return item.probability >= 0.0 && item.probability <= 1.0 && item.density >= 0.0 && std::isfinite(item.density);
  }
  static double constant(const Contaminated<M>& /*item*/, double /*log_peak*/) noexcept { return 0.0; }
  static void finish(const Contaminated<M>& item, double log_peak, GaussianTerm<T, M>& term) noexcept {
    // A log of zero would make the difference of two infinities.
    constexpr double kNothing = sizeof(T) == 8 ? -1e300 : -1e30;
    const auto log_or_nothing = [](double x) { return x > 0.0 ? std::log(x) : kNothing; };
    term.log_normal = static_cast<T>(log_or_nothing(1.0 - item.probability) + log_peak);
    term.log_outlier = static_cast<T>(log_or_nothing(item.probability * item.density));
  }
  template <class State>
  static SOOPNAV_INLINE Packet<T> value(const GaussianTerm<T, M>& term, const ParticleView<State, T>& x) {
    return term.mixture(x);
  }
};

/// Observations one by one, independent: a span of them, or one.
template <class T, class Item>
class ItemsTerm {
  using Traits = ItemTraits<T, Item>;
  using Model = typename Traits::Model;
  static constexpr std::size_t kBatch = 8;

 public:
  explicit ItemsTerm(std::span<const Item> items) noexcept : items_(items) {}

  [[nodiscard]] UpdateStatus check(double& constant) noexcept {
    Whitener<Model::kDim, Model::kDim> whitener;
    for (const Item& item : items_) {
      const auto& observed = Traits::observed(item);
      if (!observed.z.allFinite() || !Traits::sound(item)) return UpdateStatus::kNonFinite;
      const UpdateStatus status = whitener.compute(observed.R);
      if (status != UpdateStatus::kAccepted) return status;
      constant += Traits::constant(item, whitener.log_peak);
    }
    if (items_.size() <= kBatch) prepare(0, items_.size(), terms_);
    return UpdateStatus::kAccepted;
  }

  template <class State>
  SOOPNAV_INLINE void add(const TermChunk<State, T>& chunk) const {
    if (items_.size() <= kBatch) {
      add(chunk, terms_, items_.size());
      return;
    }
    std::array<GaussianTerm<T, Model>, kBatch> terms;
    for (std::size_t first = 0; first < items_.size(); first += kBatch) {
      const std::size_t count = std::min(kBatch, items_.size() - first);
      prepare(first, count, terms);
      add(chunk, terms, count);
    }
  }

 private:
  void prepare(std::size_t first, std::size_t count, std::array<GaussianTerm<T, Model>, kBatch>& terms) const noexcept {
    Whitener<Model::kDim, Model::kDim> whitener;
    for (std::size_t k = 0; k < count; ++k) {
      const Item& item = items_[first + k];
      static_cast<void>(whitener.compute(Traits::observed(item).R));
      terms[k].set(Traits::observed(item), whitener);
      Traits::finish(item, whitener.log_peak, terms[k]);
    }
  }
  template <class State>
  SOOPNAV_INLINE void add(const TermChunk<State, T>& chunk, const std::array<GaussianTerm<T, Model>, kBatch>& terms,
                          std::size_t count) const {
    using P = Packet<T>;
    ParticleView<State, T> x;
    for (std::size_t at = 0; at < chunk.n; at += P::kWidth) {
      chunk.after.load(at, x);
      P sum = P::load(chunk.log_likelihood + at);
      for (std::size_t k = 0; k < count; ++k) sum += Traits::value(terms[k], x);
      sum.store(chunk.log_likelihood + at);
    }
  }

  std::span<const Item> items_;
  std::array<GaussianTerm<T, Model>, kBatch> terms_;
};

/// Observations with a common covariance, at most kMaxRows rows.
template <class T, class Model>
class CorrelatedTerm {
  static constexpr int kMaxRows = 16;

 public:
  explicit CorrelatedTerm(const Correlated<Model>& group) noexcept : group_(&group) {}

  [[nodiscard]] UpdateStatus check(double& constant) noexcept {
    const auto rows = static_cast<Eigen::Index>(group_->models.size()) * Model::kDim;
    if (rows > kMaxRows) return UpdateStatus::kTooManyRows;
    if (rows != group_->z.size() || rows != group_->R.rows() || rows != group_->R.cols()) {
      return UpdateStatus::kNotPositiveDefinite;
    }
    rows_ = static_cast<int>(rows);
    if (rows_ == 0) return UpdateStatus::kAccepted;
    if (!group_->z.allFinite()) return UpdateStatus::kNonFinite;
    Whitener<Eigen::Dynamic, kMaxRows> whitener;
    const UpdateStatus status = whitener.compute(group_->R);
    if (status != UpdateStatus::kAccepted) return status;
    constant += whitener.log_peak;
    for (int i = 0; i < rows_; ++i) {
      z_[static_cast<std::size_t>(i)] = static_cast<T>(group_->z[i]);
      for (int j = 0; j < rows_; ++j) W_[static_cast<std::size_t>(i * kMaxRows + j)] = static_cast<T>(whitener.W(i, j));
    }
    return UpdateStatus::kAccepted;
  }

  template <class State>
  SOOPNAV_INLINE void add(const TermChunk<State, T>& chunk) const {
    using P = Packet<T>;
    constexpr auto kM = static_cast<std::size_t>(Model::kDim);
    if (rows_ == 0) return;
    ParticleView<State, T> x;
    std::array<P, static_cast<std::size_t>(kMaxRows)> r;
    for (std::size_t at = 0; at < chunk.n; at += P::kWidth) {
      chunk.after.load(at, x);
      bool defined = true;
      std::size_t row = 0;
      for (const Model& model : group_->models) {
        ValuePrediction<P, Model::kDim> y;
        defined = model.predict(x, y) && defined;
        for (std::size_t i = 0; i < kM; ++i, ++row) r[row] = residual<Model>(static_cast<int>(i), P(z_[row]), y.z[i]);
      }
      P square = r[0] * P(W_[0]);
      square *= square;
      for (std::size_t i = 1; i < row; ++i) {
        P white = r[0] * P(W_[i * kMaxRows]);
        for (std::size_t j = 1; j <= i; ++j) white += r[j] * P(W_[i * kMaxRows + j]);
        square += white * white;
      }
      const P value = defined ? square * P(static_cast<T>(-0.5)) : P(-std::numeric_limits<T>::infinity());
      (P::load(chunk.log_likelihood + at) + value).store(chunk.log_likelihood + at);
    }
  }

 private:
  const Correlated<Model>* group_;
  int rows_ = 0;
  std::array<T, static_cast<std::size_t>(kMaxRows)> z_{};
  std::array<T, static_cast<std::size_t>(kMaxRows* kMaxRows)> W_{};
};

template <class T, class Constraint>
class ConstraintTerm {
 public:
  explicit ConstraintTerm(const Constraint& constraint) noexcept : constraint_(&constraint) {}
  [[nodiscard]] UpdateStatus check(double& /*constant*/) const noexcept { return UpdateStatus::kAccepted; }

  template <class State>
  SOOPNAV_INLINE void add(const TermChunk<State, T>& chunk) const {
    using P = Packet<T>;
    ParticleView<State, T> before;
    ParticleView<State, T> after;
    for (std::size_t at = 0; at < chunk.n; at += P::kWidth) {
      chunk.before.load(at, before);
      chunk.after.load(at, after);
      const P old = P::load(chunk.log_likelihood + at);
      select(constraint_->allows(before, after), old, P(-std::numeric_limits<T>::infinity()))
          .store(chunk.log_likelihood + at);
    }
  }

 private:
  const Constraint* constraint_;
};

/// A term that works on whole chunks and is ready as it is: for models that are only known at run time.
template <class Term, class State, class T>
concept ChunkTerm = requires(const Term& term, const TermChunk<State, T>& chunk, double& constant) {
  { term.check(constant) } -> std::same_as<UpdateStatus>;
  term.add(chunk);
};

template <class State, class T, class Term>
[[nodiscard]] auto make_term(const Term& term) {
  if constexpr (ChunkTerm<Term, State, T>) {
    return term;
  } else if constexpr (kIsObserved<Term> || kIsContaminated<Term>) {
    return ItemsTerm<T, Term>(std::span<const Term>(&term, 1));
  } else if constexpr (kIsCorrelated<Term>) {
    return CorrelatedTerm<T, typename Term::Model>(term);
  } else if constexpr (std::ranges::contiguous_range<Term>) {
    using Item = std::ranges::range_value_t<Term>;
    return ItemsTerm<T, Item>(std::span<const Item>(term));
  } else {
    static_assert(ParticleConstraint<Term, ParticleView<State, T>>,
                  "a term is an Observed, a Contaminated, a contiguous range of either, a Correlated or a constraint");
    return ConstraintTerm<T, Term>(term);
  }
}

}  // namespace detail
}  // namespace soopnav
