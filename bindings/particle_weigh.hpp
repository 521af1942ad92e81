#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <variant>

#include "particle_steps.hpp"
#include "soopnav/core/packet_math.hpp"
#include "soopnav/estimation/particle_loop.hpp"
#include "soopnav/estimation/prediction.hpp"

/// The bodies of `WeighStep`, for the sources that instantiate it.
namespace soopnav::python {

namespace weigh_detail {

inline constexpr std::size_t kChunk = soopnav::detail::kParticleChunk;

// Residuals of one model: row i of them at `out` + i * kChunk. NaN where it has no value.
template <class Model, class T>
struct ResidualBody {
  const Model& model;
  const T* z;
  const RoleMap& roles;
  const T* const* columns;
  T* out;
  std::size_t n;

  void operator()(std::size_t /*piece*/) const {
    using P = Packet<T>;
    constexpr auto kRows = static_cast<std::size_t>(Model::kDim);
    for (std::size_t at = 0; at < n; at += P::kWidth) {
      ColumnView<typename Model::Frame, T> x{roles, columns, at};
      ValuePrediction<P, Model::kDim> y;
      const bool defined = model.predict(x, y);
      for (std::size_t i = 0; i < kRows; ++i) {
        P r = soopnav::detail::residual<Model>(static_cast<int>(i), P(z[i]), y.z[i]);
        if (!defined) r = P(std::numeric_limits<T>::quiet_NaN());
        r.store(out + i * kChunk + at);
      }
    }
  }
};

template <class Model, class T>
void run_residuals(const void* model, const T* z, const RoleMap& roles, const T* const* columns, T* out, std::size_t n,
                   bool wide) {
  const ResidualBody<Model, T> body{*static_cast<const Model*>(model), z, roles, columns, out, n};
  soopnav::detail::CompiledLoop<ResidualBody<Model, T>>{body, wide}(0);
}

// Models of one kind, rows independent of each other: without residuals in between.
template <class Model, class T>
struct AlikeBody {
  const void* const* models;
  std::size_t count;
  const T* z;
  const T* weights;
  const RoleMap& roles;
  const T* const* columns;
  T* log_likelihood;
  std::size_t n;

  void operator()(std::size_t /*piece*/) const {
    using P = Packet<T>;
    constexpr auto kRows = static_cast<std::size_t>(Model::kDim);
    const P nothing(-std::numeric_limits<T>::infinity());
    for (std::size_t at = 0; at < n; at += P::kWidth) {
      const ColumnView<typename Model::Frame, T> x{roles, columns, at};
      P square(T{0});
      bool defined = true;
      for (std::size_t k = 0; k < count; ++k) {
        ValuePrediction<P, Model::kDim> y;
        defined = static_cast<const Model*>(models[k])->predict(x, y) && defined;
        for (std::size_t i = 0; i < kRows; ++i) {
          const std::size_t row = k * kRows + i;
          const P r = soopnav::detail::residual<Model>(static_cast<int>(i), P(z[row]), y.z[i]) * P(weights[row]);
          square += r * r;
        }
      }
      const P exponent = square * P(static_cast<T>(-0.5));
      const P value = defined ? select(exponent <= P(T{0}), exponent, nothing) : nothing;
      (P::load(log_likelihood + at) + value).store(log_likelihood + at);
    }
  }
};

template <class Model, class T>
void run_alike(const void* const* models, std::size_t count, const T* z, const T* weights, const RoleMap& roles,
               const T* const* columns, T* log_likelihood, std::size_t n, bool wide) {
  const AlikeBody<Model, T> body{models, count, z, weights, roles, columns, log_likelihood, n};
  soopnav::detail::CompiledLoop<AlikeBody<Model, T>>{body, wide}(0);
}

// Log-likelihoods from residuals: -|W r|²/2, with or without a share of outliers.
template <class T>
struct GroupBody {
  const T* residuals;
  const T* W;
  std::size_t rows;
  bool diagonal;
  bool contaminated;
  T log_normal;
  T log_outlier;
  T* log_likelihood;
  std::size_t n;

  void operator()(std::size_t /*piece*/) const {
    using P = Packet<T>;
    const P nothing(-std::numeric_limits<T>::infinity());
    for (std::size_t at = 0; at < n; at += P::kWidth) {
      const P start = P::load(residuals + at) * P(W[0]);
      P square = start * start;
      for (std::size_t i = 1; i < rows; ++i) {
        P white = P::load(residuals + i * kChunk + at) * P(W[i * kMaxGroupRows + i]);
        if (!diagonal) {
          for (std::size_t j = 0; j < i; ++j) {
            white += P::load(residuals + j * kChunk + at) * P(W[i * kMaxGroupRows + j]);
          }
        }
        square += white * white;
      }
      const P exponent = square * P(static_cast<T>(-0.5));
      P value = select(exponent <= P(T{0}), exponent, nothing);
      if (contaminated) {  // log(e^a + e^b)
        const P a = max(value + P(log_normal), P(std::numeric_limits<T>::lowest()));
        const P b(log_outlier);
        value = max(a, b) + log(P(T{1}) + exp(-abs(a - b)));
      }
      (P::load(log_likelihood + at) + value).store(log_likelihood + at);
    }
  }
};

// The first two components of a position, for walls.
template <class T>
struct GroundView {
  const T* const* first;
  std::size_t at;
  struct Components {
    const T* const* first;
    std::size_t at;
    [[nodiscard]] SOOPNAV_INLINE Packet<T> operator[](int i) const noexcept { return Packet<T>::load(first[i] + at); }
  };
  [[nodiscard]] SOOPNAV_INLINE Components operator()(Role<2, PositionTag>) const noexcept { return {first, at}; }
};

template <class T>
struct ConstraintBody {
  const Constraints& constraints;
  const Walls<2>& walls;
  const RoleMap& roles;
  const T* const* before;
  const T* const* after;
  T* log_likelihood;
  std::size_t n;

  void operator()(std::size_t /*piece*/) const {
    using P = Packet<T>;
    const P nothing(-std::numeric_limits<T>::infinity());
    for (std::size_t at = 0; at < n; at += P::kWidth) {
      P l = P::load(log_likelihood + at);
      for (std::size_t c = 0; c < constraints.low.size(); ++c) {
        const P x = P::load(after[c] + at);
        const auto inside =
            (x >= P(static_cast<T>(constraints.low[c]))) & (x <= P(static_cast<T>(constraints.high[c])));
        l = select(inside, l, nothing);
      }
      if (!walls.walls.empty()) {
        const GroundView<T> from{before + roles.position, at};
        const GroundView<T> to{after + roles.position, at};
        l = select(walls.allows(from, to), l, nothing);
      }
      l.store(log_likelihood + at);
    }
  }
};

}  // namespace weigh_detail

template <class T>
typename WeighStep<T>::Group& WeighStep<T>::next_group() {
  if (used_ == groups_.size()) groups_.emplace_back();
  Group& group = groups_[used_++];
  group.parts.clear();
  group.models.clear();
  group.alike = false;
  group.rows = 0;
  group.diagonal = true;
  group.contaminated = false;
  group.constant = 0.0;
  return group;
}

template <class T>
UpdateStatus WeighStep<T>::add(const Observations& observations) {
  using soopnav::detail::Whitener;
  if (!observations.z.allFinite()) return UpdateStatus::kNonFinite;
  const bool full = observations.R.size() != 0;
  if (full && observations.z.size() > static_cast<Eigen::Index>(kMaxGroupRows)) return UpdateStatus::kTooManyRows;
  const std::size_t before = used_;
  Group* group = nullptr;
  Eigen::Index row = 0;
  for (const AnyMeasurement* measurement : observations.models) {
    const auto rows = static_cast<std::size_t>(measurement->rows());
    const bool contaminated = !full && observations.probability > 0.0;
    if (group == nullptr || contaminated || group->rows + rows > kMaxGroupRows) group = &next_group();
    const auto part = std::visit(
        []<class Model>(const Model& model) {
          return Part{&model, &weigh_detail::run_residuals<Model, T>, 0, &weigh_detail::run_alike<Model, T>};
        },
        measurement->model());
    group->alike = !full && !contaminated && (group->parts.empty() || group->parts[0].alike == part.alike) &&
                   (group->parts.empty() || group->alike);
    group->parts.push_back({part.model, part.kernel, rows, part.alike});
    group->models.push_back(part.model);
    for (std::size_t i = 0; i < rows; ++i, ++row) {
      const std::size_t at = group->rows + i;
      group->z[at] = static_cast<T>(observations.z[row]);
      if (full) continue;
      const double variance = observations.variances[row];
      if (!std::isfinite(variance)) return used_ = before, UpdateStatus::kNonFinite;
      const double weight = 1.0 / std::sqrt(variance);
      if (!(variance > 0.0) || !std::isfinite(weight)) return used_ = before, UpdateStatus::kNotPositiveDefinite;
      group->W[at * kMaxGroupRows + at] = static_cast<T>(weight);
      group->constant += std::log(weight) - 0.5 * std::log(kTwoPi);
    }
    group->rows += rows;
    if (contaminated) {
      // A log of zero would make the difference of two infinities.
      constexpr double kNothing = sizeof(T) == 8 ? -1e300 : -1e30;
      const auto log_or_nothing = [](double x) { return x > 0.0 ? std::log(x) : kNothing; };
      group->contaminated = true;
      group->log_normal = static_cast<T>(log_or_nothing(1.0 - observations.probability) + group->constant);
      group->log_outlier = static_cast<T>(log_or_nothing(observations.probability * observations.density));
      group->constant = 0.0;
    }
  }
  if (!full || group == nullptr) return UpdateStatus::kAccepted;
  Whitener<Eigen::Dynamic, static_cast<int>(kMaxGroupRows)> whitener;
  const UpdateStatus status = whitener.compute(observations.R);
  if (status != UpdateStatus::kAccepted) return used_ = before, status;
  group->diagonal = false;
  group->constant = whitener.log_peak;
  for (std::size_t i = 0; i < group->rows; ++i) {
    for (std::size_t j = 0; j <= i; ++j) {
      group->W[i * kMaxGroupRows + j] =
          static_cast<T>(whitener.W(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j)));
    }
  }
  return UpdateStatus::kAccepted;
}

template <class T>
double WeighStep<T>::constant() const noexcept {
  double sum = 0.0;
  for (std::size_t g = 0; g < used_; ++g) sum += groups_[g].constant;
  return sum;
}

template <class T>
void WeighStep<T>::residuals(const T* const* columns, T* out, std::size_t n) const {
  std::size_t row = 0;
  for (std::size_t g = 0; g < used_; ++g) {
    const T* z = groups_[g].z.data();
    for (const Part& part : groups_[g].parts) {
      part.kernel(part.model, z, roles_, columns, out + row * weigh_detail::kChunk, n, wide_);
      z += part.rows;
      row += part.rows;
    }
  }
}

template <class T>
void WeighStep<T>::weigh(const T* const* before, const T* const* after, T* log_likelihood, std::size_t n) const {
  using namespace weigh_detail;
  std::array<T, kMaxGroupRows * kChunk> residuals;
  for (std::size_t g = 0; g < used_; ++g) {
    const Group& group = groups_[g];
    if (group.alike) {
      std::array<T, kMaxGroupRows> weights;
      for (std::size_t i = 0; i < group.rows; ++i) weights[i] = group.W[i * kMaxGroupRows + i];
      group.parts[0].alike(group.models.data(), group.models.size(), group.z.data(), weights.data(), roles_, after,
                           log_likelihood, n, wide_);
      continue;
    }
    std::size_t row = 0;
    for (const Part& part : group.parts) {
      part.kernel(part.model, group.z.data() + row, roles_, after, residuals.data() + row * kChunk, n, wide_);
      row += part.rows;
    }
    const GroupBody<T> body{residuals.data(),  group.W.data(),     group.rows,
                            group.diagonal,    group.contaminated, group.log_normal,
                            group.log_outlier, log_likelihood,     n};
    soopnav::detail::CompiledLoop<GroupBody<T>>{body, wide_}(0);
  }
  if (constraints_ == nullptr) return;
  const ConstraintBody<T> body{*constraints_, constraints_->walls, roles_, before, after, log_likelihood, n};
  soopnav::detail::CompiledLoop<ConstraintBody<T>>{body, wide_}(0);
}

}  // namespace soopnav::python
