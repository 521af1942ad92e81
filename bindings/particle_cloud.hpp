#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "particle_steps.hpp"
#include "soopnav/estimation/particle_options.hpp"

/// A particle filter of a state that is chosen at run time.
namespace soopnav::python {

/// Where particles are drawn from. Which members count follows from what is not empty.
struct ParticlePrior {
  Eigen::VectorXd x0;   ///< Gaussian: mean ...
  Eigen::MatrixXd P0;   ///< ... and covariance
  Eigen::VectorXd low;  ///< uniform between these
  Eigen::VectorXd high;
  Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> samples;  ///< the particles, one per row
};

/// What a cloud is, but for its prior.
struct CloudSettings {
  std::string state;  ///< "position2", ...; "custom"
  RoleMap roles;
  std::vector<std::string> names;  ///< of the components
  ParticleOptions options;
  bool single = false;   ///< kept in single precision
  bool restart = false;  ///< drawn anew from the prior when every weight vanishes
  /// Columns of the clock when it is kept exact for each particle (Rao-Blackwellised); empty: all are sampled.
  std::vector<int> clock{};
};

/// Everything that changes: what a pickle keeps. `components` is component by component.
struct CloudSnapshot {
  std::vector<double> components;
  std::vector<double> log_weights;
  double log_likelihood = 0.0;
  std::uint64_t steps = 0;
  std::uint64_t restarts = 0;
  std::vector<double> clock_covariance;  ///< of an exact clock
};

/// Measurements of a run: one row of `z` for each time.
struct RunObservations {
  std::vector<const AnyMeasurement*> models;
  std::span<const double> z;
  std::span<const double> noise;          ///< variances (m) or covariance (m, m), one or one for each time
  bool full = false;                      ///< a covariance
  bool each = false;                      ///< one for each time
  std::span<const std::uint8_t> present;  ///< empty: always
  double probability = 0.0;
  double density = 0.0;
};

struct CloudRun {
  std::vector<double> mean;
  std::vector<double> covariance;
  std::vector<double> ess;
  std::vector<double> log_likelihood;
  std::vector<std::uint8_t> status;
  std::vector<std::uint8_t> resampled;
  std::vector<std::uint64_t> count;
};

/// One call at a time: every public function locks. Functions that take models throw std::invalid_argument for those
/// the state does not fit, and have then changed nothing.
class ParticleCloud {
 public:
  virtual ~ParticleCloud() = default;
  ParticleCloud(const ParticleCloud&) = delete;
  ParticleCloud& operator=(const ParticleCloud&) = delete;
  ParticleCloud(ParticleCloud&&) = delete;
  ParticleCloud& operator=(ParticleCloud&&) = delete;

  [[nodiscard]] static std::unique_ptr<ParticleCloud> make(CloudSettings settings, ParticlePrior prior);

  [[nodiscard]] const CloudSettings& settings() const noexcept { return settings_; }
  /// Particles there are now, and the most there can be.
  [[nodiscard]] std::size_t count() const;
  [[nodiscard]] std::size_t most() const noexcept { return settings_.options.count; }
  [[nodiscard]] std::size_t size() const noexcept { return settings_.names.size(); }

  /// Resamples when it is due, moves by `process` when there is one (else dt_s and input are not read), weighs.
  ParticleReport step(const AnyProcess* process, std::span<const double> input, double dt_s,
                      std::span<const Observations> observations);
  /// The same with next states as they are: for process models that are Python callables.
  ParticleReport step_to(std::span<const double> next, std::span<const Observations> observations);
  ParticleReport update(std::span<const Observations> observations);
  /// Adds log-likelihoods, one for each particle; resamples first when asked to and due.
  ParticleReport reweight(std::span<const double> log_likelihood, bool may_resample);
  /// Constraints on every step from now on; a box also on every update. Applies the box at once.
  ParticleReport constrain(Constraints constraints);
  void resample();

  /// Particles as the next prediction will find them, resampled when that is due; and its standard normals. Row-major.
  [[nodiscard]] std::vector<double> next_particles();
  [[nodiscard]] std::vector<double> next_noise(std::size_t numbers) const;

  /// `time_s` must rise; `start_s` is the time of the prior.
  [[nodiscard]] CloudRun run(std::span<const double> time_s, std::optional<double> start_s, const AnyProcess* process,
                             std::span<const double> inputs, std::span<const RunObservations> observations,
                             bool covariance);

  [[nodiscard]] Eigen::VectorXd mean() const;
  [[nodiscard]] Eigen::MatrixXd covariance() const;
  [[nodiscard]] double ess() const;
  [[nodiscard]] double log_likelihood() const;
  [[nodiscard]] std::size_t storage_bytes() const;
  /// Particles, component by component; normalised weights.
  [[nodiscard]] std::vector<double> particles() const;
  [[nodiscard]] std::vector<double> weights() const;
  double histogram(int component, double low, double high, std::span<double> bins) const;

  [[nodiscard]] CloudSnapshot save() const;
  void restore(const CloudSnapshot& snapshot);

 protected:
  explicit ParticleCloud(CloudSettings settings) : settings_(std::move(settings)) {}
  [[nodiscard]] bool wide() const noexcept;
  /// Transition and noise of an exact clock over the step planned.
  void set_clock_step(const Eigen::MatrixXd& F, const Eigen::MatrixXd& Q) {
    clock_F_ = F;
    clock_Q_ = Q;
  }

 private:
  // What is done for one state and precision.
  virtual void plan_move(const AnyProcess& process, const double* input, double dt_s) = 0;
  virtual void plan_move(std::span<const double> next) = 0;
  [[nodiscard]] virtual UpdateStatus plan_weights(std::span<const Observations> observations,
                                                  const Constraints* constraints) = 0;
  virtual ParticleReport do_step(double dt_s) = 0;  // as planned
  virtual ParticleReport do_update() = 0;           // as planned
  virtual ParticleReport do_reweight(std::span<const double> log_likelihood) = 0;
  virtual void do_resample() = 0;
  [[nodiscard]] virtual std::size_t get_count() const = 0;
  // Of an exact clock: its columns of the planned rows' Jacobian; false when no particle has any. And the change of its
  // means, K times the residuals of the planned rows.
  [[nodiscard]] virtual bool get_clock_factors(Eigen::Index rows, Eigen::MatrixXd& H) const = 0;
  virtual void do_correct_clock(const Eigen::MatrixXd& K) = 0;
  [[nodiscard]] virtual bool resampling_due() const = 0;
  [[nodiscard]] virtual bool next_ancestors(std::span<std::uint32_t> out) = 0;
  [[nodiscard]] virtual RandomStream next_noise_stream(std::uint64_t& stride) const = 0;
  virtual void do_restart(std::uint64_t number) = 0;
  virtual void get_mean(double* out) const = 0;
  virtual void get_covariance(double* out) const = 0;
  [[nodiscard]] virtual double get_ess() const = 0;
  [[nodiscard]] virtual double get_log_likelihood() const = 0;
  [[nodiscard]] virtual std::size_t get_storage_bytes() const = 0;
  virtual void get_component(int c, double* out) const = 0;
  virtual void get_weights(std::span<double> out) const = 0;
  virtual double get_histogram(int c, double low, double high, std::span<double> bins) const = 0;
  virtual void get_snapshot(CloudSnapshot& snapshot) const = 0;
  virtual void set_snapshot(const CloudSnapshot& snapshot) = 0;

  void check(std::span<const Observations> observations) const;
  [[nodiscard]] ParticleReport refused(UpdateStatus status) const;
  ParticleReport finish(const ParticleReport& report);
  ParticleReport locked_step(const AnyProcess* process, const double* input, double dt_s,
                             std::span<const Observations> observations);
  ParticleReport weigh_with_clock(const AnyProcess* process, double dt_s, std::span<const Observations> observations,
                                  const Constraints& constraints, bool may_resample);
  void covariance_into(double* out) const;
  bool resample_when_due();

  CloudSettings settings_;
  Eigen::MatrixXd clock_P_;  // given the sampled components
  Eigen::MatrixXd clock_P0_;
  Eigen::MatrixXd clock_F_;
  Eigen::MatrixXd clock_Q_;
  Constraints constraints_;
  std::uint64_t restarts_ = 0;
  mutable std::mutex mutex_;
};

/// Clouds of 1 to 4 and of 5 to 8 plain components, of 2 and 5 in single precision, and those with a heading. Null for
/// other sizes.
[[nodiscard]] std::unique_ptr<ParticleCloud> make_small_cloud(CloudSettings& settings, ParticlePrior& prior);
[[nodiscard]] std::unique_ptr<ParticleCloud> make_large_cloud(CloudSettings& settings, ParticlePrior& prior);
[[nodiscard]] std::unique_ptr<ParticleCloud> make_single_cloud(CloudSettings& settings, ParticlePrior& prior);
[[nodiscard]] std::unique_ptr<ParticleCloud> make_heading_cloud(CloudSettings& settings, ParticlePrior& prior);

}  // namespace soopnav::python
