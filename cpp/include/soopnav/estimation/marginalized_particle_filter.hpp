#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <concepts>
#include <cstddef>
#include <limits>
#include <span>
#include <stdexcept>
#include <string>

#include "soopnav/estimation/observed.hpp"
#include "soopnav/estimation/particle_filter.hpp"
#include "soopnav/estimation/prediction.hpp"
#include "soopnav/estimation/transition.hpp"

namespace soopnav {
namespace detail {

/// A process model whose noise reaches only what particles sample.
template <class Process>
struct SampledProcess {
  using Input = InputOf<Process>;
  static constexpr int kNoise = Process::kNoise;

  const Process& process;
  const std::array<bool, static_cast<std::size_t>(kNoise > 0 ? kNoise : 1)>& sampled;

  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& x, const Input& u, double dt_s, const W& w, Y& y) const {
    return detail::propagate(process, x, u, dt_s, Kept<W>{w, sampled}, y);
  }
  template <class X, class W, class Y>
  [[nodiscard]] bool propagate(const X& x, double dt_s, const W& w, Y& y) const {
    return propagate(x, Input{}, dt_s, w, y);
  }

 private:
  template <class W>
  struct Kept {
    const W& w;
    const std::array<bool, static_cast<std::size_t>(kNoise > 0 ? kNoise : 1)>& sampled;
    [[nodiscard]] SOOPNAV_INLINE auto operator[](int i) const {
      const auto drawn = w[i];
      return sampled[static_cast<std::size_t>(i)] ? drawn : drawn * 0.0F;
    }
  };
};

}  // namespace detail

/// Rao-Blackwellised particle filter (doc/particle_filter.md eq. 18 to 22; Schön, Gustafsson and Nordlund 2005): the
/// components of `LinearRoles` have a Kalman filter for each particle instead of being sampled. For clock biases and
/// drifts, whose spread would ask for many particles.
///
/// Given the sampled components the others must be linear, with the same coefficients for every particle: they may
/// drive themselves and enter measurements with constant factors, as clocks do; nothing else may drive them or be
/// driven by them. Their covariance is then common to all particles, and a particle carries just their mean: as stored
/// numbers of the state, where the cloud keeps them. A model that breaks the rule is refused with
/// std::invalid_argument.
///
/// `predict`, `update` and `step` do not allocate. Statuses as those of `ParticleFilter`; a refused call changes
/// nothing, and after a degenerate one the prediction stands.
template <FixedStateType StateType, std::floating_point ScalarType, class... LinearRoles>
requires(sizeof...(LinearRoles) >= 1 && (HoldsRole<StateType, LinearRoles> && ...)) class MarginalizedParticleFilter {
 public:
  using State = StateType;
  using Scalar = ScalarType;
  using Cloud = ParticleFilter<State, Scalar>;
  static constexpr int kDim = State::kDim;
  static constexpr int kLinear = (LinearRoles::kDim + ...);
  static constexpr int kMaxRows = 16;  ///< rows of one update
  using Square = typename Cloud::Square;
  using LinearSquare = Eigen::Matrix<double, kLinear, kLinear>;

  static_assert((!std::same_as<LinearRoles, Role<1, HeadingTag>> && ...) &&
                    (!std::same_as<LinearRoles, Role<3, AttitudeTag>> && ...),
                "a rotation is not linear");

  /// As `ParticleFilter`'s. `P0` must not correlate the linear components with the sampled ones.
  MarginalizedParticleFilter(const State& x0, const Square& P0, const ParticleOptions& options)
      : cloud_(x0, sampled_part(P0), options), P_(linear_part(P0)) {}

  template <ParticleProcessFor<State, Scalar> Process>
  ParticleReport predict(const Process& process, const InputOf<Process>& input, double dt_s) {
    return move<Process, detail::NoInput>(process, input, dt_s, nullptr);
  }
  template <ParticleProcessFor<State, Scalar> Process>
  requires(!detail::kDriven<Process>) ParticleReport predict(const Process& process, double dt_s) {
    return predict(process, detail::NoInput{}, dt_s);
  }

  template <class Model>
  ParticleReport update(const Correlated<Model>& group) {
    Gain gain;
    if (const ParticleStatus status = prepare(group, P_, gain); status != ParticleStatus::kAccepted) {
      return refused(status);
    }
    const ParticleReport report = cloud_.update(Correlated<Model>{group.models, group.z, gain.S});
    if (report.accepted()) correct(group, gain, P_);
    return report;
  }
  template <class Model>
  ParticleReport update(const Observed<Model>& observed) {
    return update(group_of(observed));
  }

  /// `predict` and `update`. `constraints` as those of `ParticleFilter`, on the sampled components.
  template <ParticleProcessFor<State, Scalar> Process, class Model, class... Constraints>
  ParticleReport step(const Process& process, const InputOf<Process>& input, double dt_s,
                      const Correlated<Model>& group, const Constraints&... constraints) {
    return move(process, input, dt_s, &group, constraints...);
  }
  template <ParticleProcessFor<State, Scalar> Process, class Model, class... Constraints>
  requires(!detail::kDriven<Process>) ParticleReport
      step(const Process& process, double dt_s, const Correlated<Model>& group, const Constraints&... constraints) {
    return move(process, detail::NoInput{}, dt_s, &group, constraints...);
  }

  /// The particles: sampled components, and the mean of the linear ones given them.
  [[nodiscard]] const Cloud& cloud() const noexcept { return cloud_; }
  /// Covariance of the linear components given the sampled ones, the same for every particle; in the order of
  /// `LinearRoles`.
  [[nodiscard]] const LinearSquare& linear_covariance() const noexcept { return P_; }
  [[nodiscard]] State mean() const { return cloud_.mean(); }
  /// Of all components: that of the particles, and the linear ones' own (eq. 22).
  [[nodiscard]] Square covariance() const {
    Square P = cloud_.covariance();
    for (std::size_t i = 0; i < kIndices.size(); ++i) {
      for (std::size_t j = 0; j < kIndices.size(); ++j) P(kIndices[i], kIndices[j]) += P_(at(i), at(j));
    }
    return P;
  }
  [[nodiscard]] double ess() const noexcept { return cloud_.ess(); }
  [[nodiscard]] double log_likelihood() const noexcept { return cloud_.log_likelihood(); }

 private:
  using Rows = Eigen::Matrix<double, Eigen::Dynamic, kLinear, Eigen::ColMajor, kMaxRows, kLinear>;
  using RowSquare = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::ColMajor, kMaxRows, kMaxRows>;
  struct Gain {
    Rows H;
    RowSquare S;
    Eigen::Matrix<double, kLinear, Eigen::Dynamic, Eigen::RowMajor, kLinear, kMaxRows> K;
  };

  static constexpr std::array<int, static_cast<std::size_t>(kLinear)> indices() {
    std::array<int, static_cast<std::size_t>(kLinear)> out{};
    std::size_t k = 0;
    const auto append = [&]<class R>(R role) {
      for (int i = 0; i < R::kDim; ++i) out[k++] = State::at(role) + i;
    };
    (append(LinearRoles{}), ...);
    return out;
  }
  static constexpr auto kIndices = indices();  // in the tangent
  static constexpr Eigen::Index at(std::size_t i) { return static_cast<Eigen::Index>(i); }
  static constexpr bool is_linear(int i) {
    for (const int k : kIndices) {
      if (k == i) return true;
    }
    return false;
  }

  static LinearSquare linear_part(const Square& P) {
    LinearSquare out;
    for (std::size_t i = 0; i < kIndices.size(); ++i) {
      for (std::size_t j = 0; j < kIndices.size(); ++j) out(at(i), at(j)) = P(kIndices[i], kIndices[j]);
    }
    return out;
  }
  static Square sampled_part(const Square& P0) {
    check_covariance(P0, "P0");
    Square P = P0;
    for (int i = 0; i < kDim; ++i) {
      for (int j = 0; j < kDim; ++j) {
        if (is_linear(i) != is_linear(j) && P0(i, j) != 0.0) {
          throw std::invalid_argument("P0(" + std::to_string(i) + ", " + std::to_string(j) +
                                      ") correlates a linear component with a sampled one; it must be 0");
        }
        if (is_linear(i) || is_linear(j)) P(i, j) = 0.0;
      }
    }
    return P;
  }
  [[nodiscard]] ParticleReport refused(ParticleStatus status) const noexcept {
    return {status, std::numeric_limits<double>::quiet_NaN(), ess(), false};
  }
  template <class Model>
  static Correlated<Model> group_of(const Observed<Model>& observed) {
    return {std::span<const Model>(&observed.model, 1), observed.z, observed.R};
  }

  // S = H P Hᵀ + R and K = P Hᵀ S⁻¹ of a group, all of its rows checked.
  template <class Model>
  [[nodiscard]] ParticleStatus prepare(const Correlated<Model>& group, const LinearSquare& P, Gain& gain) const {
    const Eigen::Index rows = static_cast<Eigen::Index>(group.models.size()) * Model::kDim;
    if (rows > kMaxRows) return ParticleStatus::kTooManyRows;
    if (rows != group.z.size() || rows != group.R.rows() || rows != group.R.cols()) {
      return ParticleStatus::kNotPositiveDefinite;
    }
    if (!group.z.allFinite()) return ParticleStatus::kNonFinite;
    if (rows == 0) return ParticleStatus::kAccepted;
    const RowSquare R = group.R;
    detail::Whitener<Eigen::Dynamic, kMaxRows> whitener;
    if (const UpdateStatus status = whitener.compute(R); status != UpdateStatus::kAccepted) {
      return detail::particle_status(status);
    }
    read_rows(group.models, gain.H);
    gain.S = R;
    gain.S.noalias() += gain.H * P * gain.H.transpose();
    gain.S = (0.5 * (gain.S + gain.S.transpose())).eval();
    const Eigen::LLT<RowSquare> llt(gain.S);
    if (llt.info() != Eigen::Success) return ParticleStatus::kNotPositiveDefinite;
    Rows solved = gain.H * P;
    llt.solveInPlace(solved);
    gain.K = solved.transpose();
    return ParticleStatus::kAccepted;
  }

  // The linear components' columns of the Jacobian, which two particles must agree on.
  template <class Model>
  void read_rows(std::span<const Model> models, Rows& H) const {
    const Eigen::Index rows = static_cast<Eigen::Index>(models.size()) * Model::kDim;
    H.setZero(rows, kLinear);
    const std::size_t count = cloud_.count();
    Rows other = H;
    for (std::size_t k = 0; k < models.size(); ++k) {
      const Eigen::Index first = static_cast<Eigen::Index>(k) * Model::kDim;
      const std::size_t one = read_model(models[k], 0, first, H);
      if (one >= count) continue;
      if (read_model(models[k], std::max(one + 1, count / 2), first, other) >= count) continue;
      const auto a = H.template middleRows<Model::kDim>(first);
      const auto b = other.template middleRows<Model::kDim>(first);
      if (!((a - b).cwiseAbs().maxCoeff() <= 1e-9 * (a.cwiseAbs().maxCoeff() + b.cwiseAbs().maxCoeff()))) {
        throw std::invalid_argument("measurement model " + std::to_string(k) +
                                    " has factors of the linear components that differ between particles");
      }
    }
  }
  // Rows of one model at the first particle from `from` on where it is defined; answers which.
  template <class Model>
  [[nodiscard]] std::size_t read_model(const Model& model, std::size_t from, Eigen::Index first, Rows& H) const {
    for (std::size_t i = from; i < cloud_.count(); ++i) {
      Prediction<Model::kDim, State> y;
      if (!model.predict(cloud_.particle(i), y) || !y.H.allFinite()) continue;
      for (std::size_t j = 0; j < kIndices.size(); ++j) {
        H.template block<Model::kDim, 1>(first, at(j)) = y.H.col(kIndices[j]);
      }
      return i;
    }
    return cloud_.count();
  }

  // Means of the linear components of every particle, then their covariance (Joseph's form).
  template <class Model>
  void correct(const Correlated<Model>& group, const Gain& gain, LinearSquare& P) {
    if (gain.H.rows() == 0) return;
    cloud_.transform([&group, &gain](const auto& columns, std::size_t /*first*/, std::size_t n) {
      using Pack = Packet<Scalar>;
      detail::ParticleColumns<Scalar, Cloud::kSize> from;
      std::copy(columns.begin(), columns.end(), from.component.begin());
      for (std::size_t i = 0; i < n; i += Pack::kWidth) {
        ParticleView<State, Scalar> x;
        from.load(i, x);
        std::array<Pack, static_cast<std::size_t>(kLinear)> change;
        change.fill(Pack(0));
        int row = 0;
        for (const Model& model : group.models) {
          ValuePrediction<Pack, Model::kDim> y;
          const bool defined = model.predict(x, y);
          for (int k = 0; k < Model::kDim; ++k, ++row) {
            const Pack r =
                detail::residual<Model>(k, Pack(static_cast<Scalar>(group.z[row])), y.z[static_cast<std::size_t>(k)]);
            const auto sound = (r - r) == Pack(0);
            if (!defined) continue;
            for (std::size_t j = 0; j < change.size(); ++j) {
              change[j] += select(sound, r * Pack(static_cast<Scalar>(gain.K(at(j), row))), Pack(0));
            }
          }
        }
        for (std::size_t j = 0; j < change.size(); ++j) {
          const auto column = static_cast<std::size_t>(detail::stored_index<State>(kIndices[j]));
          (x.values[column] + change[j]).store(columns[column] + i);
        }
      }
    });
    const LinearSquare left = LinearSquare::Identity() - gain.K * gain.H;
    const RowSquare R = group.R;
    P = (left * P * left.transpose()).eval();
    P.noalias() += gain.K * R * gain.K.transpose();
    P = (0.5 * (P + P.transpose())).eval();
  }

  template <class Process, class Model = detail::NoInput, class... Constraints>
  ParticleReport move(const Process& process, const InputOf<Process>& input, double dt_s,
                      const Correlated<Model>* group, const Constraints&... constraints) {
    if (!(dt_s > 0.0) || std::isinf(dt_s)) return refused(ParticleStatus::kTimeNotAdvancing);
    constexpr int kNoise = Process::kNoise;
    Transition<State, kNoise> y(cloud_.particle(0));
    if (!detail::propagate(process, cloud_.particle(0), input, dt_s, ZeroNoise{}, y) || !y.F.allFinite() ||
        !y.G.allFinite()) {
      return refused(ParticleStatus::kNonFinite);
    }
    std::array<bool, static_cast<std::size_t>(kNoise > 0 ? kNoise : 1)> sampled{};
    separate(y, sampled);
    LinearSquare P = LinearSquare::Zero();
    LinearSquare F;
    Eigen::Matrix<double, kLinear, kNoise> G;
    for (std::size_t i = 0; i < kIndices.size(); ++i) {
      for (std::size_t j = 0; j < kIndices.size(); ++j) F(at(i), at(j)) = y.F(kIndices[i], kIndices[j]);
      G.row(at(i)) = y.G.row(kIndices[i]);
    }
    P.noalias() = F * P_ * F.transpose();
    P.noalias() += G * G.transpose();
    if (!P.allFinite()) return refused(ParticleStatus::kNonFinite);
    const detail::SampledProcess<Process> moved{process, sampled};
    if constexpr (std::same_as<Model, detail::NoInput>) {
      static_cast<void>(group);
      const ParticleReport report = cloud_.predict(moved, input, dt_s);
      P_ = P;
      return report;
    } else {
      Gain gain;
      if (const ParticleStatus status = prepare(*group, P, gain); status != ParticleStatus::kAccepted) {
        return refused(status);
      }
      const ParticleReport report =
          cloud_.step(moved, input, dt_s, Correlated<Model>{group->models, group->z, gain.S}, constraints...);
      P_ = P;
      if (report.accepted()) correct(*group, gain, P_);
      return report;
    }
  }

  // Which noises particles draw; throws unless the linear components keep to themselves.
  template <class Y, class Sampled>
  static void separate(const Y& y, Sampled& sampled) {
    const auto fail = [](const std::string& what) {
      throw std::invalid_argument("the process model is not linear by itself in the linear components: " + what);
    };
    for (int i = 0; i < kDim; ++i) {
      for (int j = 0; j < kDim; ++j) {
        if (is_linear(i) == is_linear(j) || y.F(i, j) == 0.0) continue;
        fail("component " + std::to_string(j) + " drives component " + std::to_string(i));
      }
    }
    for (int k = 0; k < y.G.cols(); ++k) {
      bool drives_sampled = false;
      bool drives_linear = false;
      for (int i = 0; i < kDim; ++i) {
        if (y.G(i, k) == 0.0) continue;
        (is_linear(i) ? drives_linear : drives_sampled) = true;
      }
      if (drives_sampled && drives_linear) fail("noise " + std::to_string(k) + " drives both kinds");
      sampled[static_cast<std::size_t>(k)] = !drives_linear;
    }
  }

  Cloud cloud_;
  LinearSquare P_;
};

}  // namespace soopnav
