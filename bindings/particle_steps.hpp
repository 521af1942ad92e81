#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "models.hpp"
#include "particle_columns.hpp"
#include "soopnav/core/random.hpp"
#include "soopnav/core/status.hpp"
#include "soopnav/estimation/particle_kernel.hpp"
#include "soopnav/estimation/particle_terms.hpp"

/// What moves and weighs the particles of a cloud whose models are chosen at run time, chunk by chunk.
///
/// Models are compiled once each, for columns of numbers, not once for each state; a step of a cloud calls them through
/// pointers, some five hundred particles at a time.
namespace soopnav::python {

/// Rows that may have a common covariance.
inline constexpr std::size_t kMaxGroupRows = 16;

/// Measurements with a common covariance, or (a diagonal one, `variances`) without.
struct Observations {
  std::vector<const AnyMeasurement*> models;
  Eigen::VectorXd z;
  Eigen::MatrixXd R;          ///< of all rows; empty when `variances` are given
  Eigen::VectorXd variances;  ///< of each row
  double probability = 0.0;   ///< that one of `models` is an outlier; only with `variances`
  double density = 0.0;       ///< of an outlier, per model
};

/// What a step is held against beside measurements.
struct Constraints {
  Walls<2> walls;
  std::vector<double> low;  ///< for each component; empty: none
  std::vector<double> high;
  [[nodiscard]] bool empty() const noexcept { return walls.walls.empty() && low.empty(); }
};

/// Throws std::invalid_argument when a state lacks what the measurement reads.
void check_readable(const AnyMeasurement& measurement, const RoleMap& roles, std::string_view state);

/// Motion, clock and diffusion of a step, made ready.
template <class T>
class MoveStep {
 public:
  /// `diffusion`: square roots of power densities, one for each column. Throws std::invalid_argument when the state
  /// lacks what the process moves.
  void prepare(const AnyProcess& process, std::span<const double> diffusion, const RoleMap& roles,
               std::string_view state, const double* input, double dt_s, bool wide);
  /// Next states as they are: `count` rows of one number for each column.
  void prepare(const double* next, std::size_t count, std::size_t columns, const RoleMap& roles, bool wide);

  template <int Size>
  [[nodiscard]] bool move(const soopnav::detail::MoveChunk<T, Size>& chunk) const {
    return move(chunk.before.data(), chunk.after.data(), chunk.log_likelihood, chunk.n, chunk.first, chunk.noise,
                chunk.stride, chunk.noisy);
  }
  /// From now on: whether the clock is kept exact for each particle, so that its noise is not drawn.
  void keep_clock_exact(bool exact) noexcept { exact_clock_ = exact; }

  using Kernel = void (*)(const void* motion, const double* input, double dt_s, const RoleMap& roles,
                          const T* const* before, T* const* after, const float* normals, std::size_t n, bool wide);

 private:
  static constexpr std::size_t kMaxNormals = 16;
  struct Motions {
    NearlyConstantVelocity<1> velocity1;
    NearlyConstantVelocity<2> velocity2;
    NearlyConstantVelocity<3> velocity3;
    PiecewiseConstantAcceleration<1> acceleration1;
    PiecewiseConstantAcceleration<2> acceleration2;
    PiecewiseConstantAcceleration<3> acceleration3;
    CoordinatedTurn<> turn;
    inertial::PlanarMechanization inertial;
    PlanarOdometry odometry;
    clock::TwoState<> clock;
  };
  [[nodiscard]] bool move(const T* const* before, T* const* after, T* log_likelihood, std::size_t n, std::size_t first,
                          const RandomStream& noise, std::uint64_t stride, bool noisy) const;

  RoleMap roles_;
  bool exact_clock_ = false;
  std::size_t columns_ = 0;
  bool wide_ = false;
  double dt_s_ = 0.0;
  const double* input_ = nullptr;
  Motions motions_;
  const void* motion_ = nullptr;
  Kernel kernel_ = nullptr;
  std::size_t motion_normals_ = 0;
  bool clock_ = false;
  std::array<T, kMaxColumns> sigma_{};     // of the diffusion, per step
  std::array<bool, kMaxColumns> moved_{};  // columns that motion or clock write
  std::size_t first_diffusion_ = 0;        // number of its first normal
  const double* next_ = nullptr;
  std::size_t count_ = 0;
};

/// Measurements and constraints of a step, made ready.
template <class T>
class WeighStep {
 public:
  void clear() noexcept {
    used_ = 0;
    constraints_ = nullptr;
  }
  /// Adds measurements, which must outlive the step. Models were checked with `check_readable`.
  [[nodiscard]] UpdateStatus add(const Observations& observations);
  void prepare(const RoleMap& roles, const Constraints* constraints, bool wide) noexcept {
    roles_ = roles;
    constraints_ = constraints != nullptr && !constraints->empty() ? constraints : nullptr;
    wide_ = wide;
  }
  [[nodiscard]] bool empty() const noexcept { return used_ == 0 && constraints_ == nullptr; }
  /// Sum of the logarithms of the peaks.
  [[nodiscard]] double constant() const noexcept;
  void weigh(const T* const* before, const T* const* after, T* log_likelihood, std::size_t n) const;
  /// z - h of all rows, at most kMaxGroupRows: row i of particle k is `out[i * kParticleChunk + k]`.
  void residuals(const T* const* columns, T* out, std::size_t n) const;

  using Kernel = void (*)(const void* model, const T* z, const RoleMap& roles, const T* const* columns, T* residuals,
                          std::size_t n, bool wide);
  /// Adds the log-likelihoods of independent rows of `count` models of one kind, `weights` being 1 / sigma of each row.
  using AlikeKernel = void (*)(const void* const* models, std::size_t count, const T* z, const T* weights,
                               const RoleMap& roles, const T* const* columns, T* log_likelihood, std::size_t n,
                               bool wide);

 private:
  struct Part {
    const void* model;
    Kernel kernel;
    std::size_t rows;
    AlikeKernel alike;
  };
  struct Group {
    std::vector<Part> parts;
    std::vector<const void*> models;  // of the parts
    bool alike = false;               // parts of one kind, rows independent, no outliers
    std::size_t rows = 0;
    bool diagonal = true;
    bool contaminated = false;
    std::array<T, kMaxGroupRows> z{};
    std::array<T, kMaxGroupRows * kMaxGroupRows> W{};
    double constant = 0.0;
    T log_normal{};
    T log_outlier{};
  };
  Group& next_group();

  RoleMap roles_;
  bool wide_ = false;
  const Constraints* constraints_ = nullptr;
  std::vector<Group> groups_;
  std::size_t used_ = 0;
};

/// A `WeighStep` as a term of `ParticleFilter`.
template <class T>
struct WeighTerm {
  const WeighStep<T>* step;
  [[nodiscard]] UpdateStatus check(double& constant) const noexcept {
    constant += step->constant();
    return UpdateStatus::kAccepted;
  }
  template <class State>
  void add(const soopnav::detail::TermChunk<State, T>& chunk) const {
    step->weigh(chunk.before.component.data(), chunk.after.component.data(), chunk.log_likelihood, chunk.n);
  }
};

extern template class MoveStep<double>;
extern template class MoveStep<float>;
extern template class WeighStep<double>;
extern template class WeighStep<float>;

}  // namespace soopnav::python
