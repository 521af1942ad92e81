#include "particle_cloud.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <utility>
#include <variant>

#include "soopnav/estimation/covariance_check.hpp"
#include "soopnav/estimation/particle_loop.hpp"

namespace soopnav::python {

namespace {

// Whether a state holds every role among the template arguments of a model.
template <class Part>
bool holds(const RoleMap& roles, std::type_identity<Part>) {
  if constexpr (RoleType<Part>) {
    return roles.find(Part{}) >= 0;
  } else {
    return true;
  }
}
template <template <class...> class Model, class... Parts>
bool readable(const RoleMap& roles, const Model<Parts...>& /*model*/) {
  return (holds(roles, std::type_identity<Parts>{}) && ...);
}
template <class Frame, int Dim, class Part>
bool readable(const RoleMap& roles, const PositionFix<Frame, Dim, Part>& /*model*/) {
  return holds(roles, std::type_identity<Part>{});
}

std::size_t rows_of(std::span<const AnyMeasurement* const> models) {
  std::size_t rows = 0;
  for (const AnyMeasurement* model : models) rows += static_cast<std::size_t>(model->rows());
  return rows;
}

[[noreturn]] void refuse(const std::string& what) { throw std::invalid_argument(what); }

// Covariance of the clock, which it takes out of the prior: what is exact is not sampled.
Eigen::MatrixXd exact_clock(const CloudSettings& settings, ParticlePrior& prior) {
  if (prior.x0.size() == 0) refuse("prior: Gaussian expected with marginalized_clock");
  soopnav::check_covariance(prior.P0, "P0");
  const auto n = static_cast<Eigen::Index>(settings.clock.size());
  Eigen::MatrixXd P(n, n);
  const auto is_clock = [&settings](Eigen::Index c) {
    return std::find(settings.clock.begin(), settings.clock.end(), static_cast<int>(c)) != settings.clock.end();
  };
  for (Eigen::Index i = 0; i < n; ++i) {
    for (Eigen::Index j = 0; j < n; ++j) {
      P(i, j) = prior.P0(settings.clock[static_cast<std::size_t>(i)], settings.clock[static_cast<std::size_t>(j)]);
    }
  }
  for (Eigen::Index i = 0; i < prior.P0.rows(); ++i) {
    for (Eigen::Index j = 0; j < prior.P0.cols(); ++j) {
      if (is_clock(i) != is_clock(j) && prior.P0(i, j) != 0.0) {
        refuse("prior.P0[" + std::to_string(i) + ", " + std::to_string(j) +
               "] correlates the clock with another component; it must be 0 with marginalized_clock");
      }
      if (is_clock(i) || is_clock(j)) prior.P0(i, j) = 0.0;
    }
  }
  return P;
}

// All observations as one with a common covariance, which a clock in all of them makes it.
UpdateStatus join(std::span<const Observations> observations, Observations& all) {
  Eigen::Index rows = 0;
  for (const Observations& o : observations) rows += o.z.size();
  if (rows > static_cast<Eigen::Index>(kMaxGroupRows)) return UpdateStatus::kTooManyRows;
  all.z.resize(rows);
  all.R.setZero(rows, rows);
  Eigen::Index first = 0;
  for (const Observations& o : observations) {
    if (o.probability > 0.0) refuse("outlier_probability: not with marginalized_clock");
    all.models.insert(all.models.end(), o.models.begin(), o.models.end());
    const Eigen::Index m = o.z.size();
    all.z.segment(first, m) = o.z;
    if (o.R.size() != 0) {
      all.R.block(first, first, m, m) = o.R;
    } else {
      all.R.block(first, first, m, m).diagonal() = o.variances;
    }
    first += m;
  }
  return UpdateStatus::kAccepted;
}

}  // namespace

void check_readable(const AnyMeasurement& measurement, const RoleMap& roles, std::string_view state) {
  const bool fits = std::visit([&roles](const auto& model) { return readable(roles, model); }, measurement.model());
  if (!fits) detail::refuse_state(measurement, state);
}

std::unique_ptr<ParticleCloud> ParticleCloud::make(CloudSettings settings, ParticlePrior prior) {
  const auto n = static_cast<Eigen::Index>(settings.names.size());
  const auto fits = [n](const char* name, Eigen::Index have) {
    if (have != n) {
      refuse(std::string(name) + " has " + std::to_string(have) + " components; the state has " + std::to_string(n));
    }
  };
  if (prior.samples.size() != 0) {
    fits("samples", prior.samples.cols());
    if (static_cast<std::size_t>(prior.samples.rows()) != settings.options.count) {
      refuse("samples: " + std::to_string(prior.samples.rows()) +
             " rows, expected count = " + std::to_string(settings.options.count));
    }
  } else if (prior.x0.size() != 0) {
    fits("x0", prior.x0.size());
    if (prior.P0.rows() != n || prior.P0.cols() != n) {
      refuse("P0: shape (" + std::to_string(prior.P0.rows()) + ", " + std::to_string(prior.P0.cols()) +
             "), expected (" + std::to_string(n) + ", " + std::to_string(n) + ")");
    }
  } else {
    fits("low", prior.low.size());
    fits("high", prior.high.size());
  }
  std::unique_ptr<ParticleCloud> cloud;
  Eigen::MatrixXd clock_P0;
  if (!settings.clock.empty()) clock_P0 = exact_clock(settings, prior);
  if (settings.single) {
    if (settings.roles.heading < 0) cloud = make_single_cloud(settings, prior);
    if (!cloud) refuse("precision: 'float' is for states of 2 or 5 components without a heading");
  } else if (settings.roles.heading >= 0) {
    cloud = make_heading_cloud(settings, prior);
  } else {
    cloud = make_small_cloud(settings, prior);
    if (!cloud) cloud = make_large_cloud(settings, prior);
    if (!cloud) refuse("state: " + std::to_string(n) + " components; 1 to 8 expected");
  }
  cloud->clock_P_ = cloud->clock_P0_ = clock_P0;
  return cloud;
}

bool ParticleCloud::wide() const noexcept {
  return !settings_.options.portable_kernels && soopnav::detail::has_wide_loops();
}

void ParticleCloud::check(std::span<const Observations> observations) const {
  for (const Observations& o : observations) {
    for (const AnyMeasurement* model : o.models) check_readable(*model, settings_.roles, settings_.state);
  }
}

ParticleReport ParticleCloud::refused(UpdateStatus status) const {
  const ParticleStatus ours = status == UpdateStatus::kTimeNotAdvancing ? ParticleStatus::kTimeNotAdvancing
                                                                        : soopnav::detail::particle_status(status);
  return {ours, std::numeric_limits<double>::quiet_NaN(), get_ess(), false};
}

ParticleReport ParticleCloud::finish(const ParticleReport& report) {
  if (report.status != ParticleStatus::kDegenerate || !settings_.restart) return report;
  do_restart(++restarts_);
  clock_P_ = clock_P0_;
  ParticleReport restarted = report;
  restarted.ess = get_ess();
  return restarted;
}

std::size_t ParticleCloud::count() const {
  const std::scoped_lock lock(mutex_);
  return get_count();
}

bool ParticleCloud::resample_when_due() {
  if (!resampling_due()) return false;
  do_resample();
  return true;
}

ParticleReport ParticleCloud::locked_step(const AnyProcess* process, const double* input, double dt_s,
                                          std::span<const Observations> observations) {
  if (process == nullptr) {
    if (observations.empty() && constraints_.empty()) return {ParticleStatus::kAccepted, 0.0, get_ess(), false};
    if (!settings_.clock.empty()) return weigh_with_clock(nullptr, 0.0, observations, constraints_, true);
    if (const UpdateStatus status = plan_weights(observations, &constraints_); status != UpdateStatus::kAccepted) {
      return refused(status);
    }
    const bool resampled = resample_when_due();
    ParticleReport report = do_update();
    report.resampled = resampled;
    return finish(report);
  }
  if (!(dt_s > 0.0) || !std::isfinite(dt_s)) return refused(UpdateStatus::kTimeNotAdvancing);
  for (int i = 0; i < process->input_size(); ++i) {
    if (!std::isfinite(input[i])) return refused(UpdateStatus::kNonFinite);
  }
  plan_move(*process, input, dt_s);
  if (!settings_.clock.empty()) return weigh_with_clock(process, dt_s, observations, constraints_, true);
  if (const UpdateStatus status = plan_weights(observations, &constraints_); status != UpdateStatus::kAccepted) {
    return refused(status);
  }
  return finish(do_step(dt_s));
}

// A step as planned (or, without a process, an update) whose clock has a Kalman filter for each particle
// (doc/particle_filter.md eq. 18 to 22).
ParticleReport ParticleCloud::weigh_with_clock(const AnyProcess* process, double dt_s,
                                               std::span<const Observations> observations,
                                               const Constraints& constraints, bool may_resample) {
  Eigen::MatrixXd P = clock_P_;
  if (process != nullptr) P = (clock_F_ * clock_P_ * clock_F_.transpose() + clock_Q_).eval();
  if (!P.allFinite()) return refused(UpdateStatus::kNonFinite);
  Observations all;
  if (const UpdateStatus status = join(observations, all); status != UpdateStatus::kAccepted) return refused(status);
  const Eigen::Index rows = all.z.size();
  Eigen::MatrixXd H;
  Eigen::MatrixXd S;
  const Eigen::MatrixXd R = all.R;
  if (rows > 0) {
    if (const UpdateStatus status = plan_weights({&all, 1}, nullptr); status != UpdateStatus::kAccepted) {
      return refused(status);
    }
    if (!get_clock_factors(rows, H)) H.setZero(rows, P.rows());
    S = R + H * P * H.transpose();
    all.R = S = (0.5 * (S + S.transpose())).eval();
  }
  const std::span<const Observations> planned(&all, rows > 0 ? 1 : 0);
  if (const UpdateStatus status = plan_weights(planned, &constraints); status != UpdateStatus::kAccepted) {
    return refused(status);
  }
  ParticleReport report;
  if (process != nullptr) {
    report = do_step(dt_s);
    clock_P_ = P;
  } else {
    const bool resampled = may_resample && resample_when_due();
    report = do_update();
    report.resampled = resampled;
  }
  if (report.accepted() && rows > 0) {
    const Eigen::MatrixXd K = S.llt().solve(H * P).transpose();
    do_correct_clock(K);
    const Eigen::MatrixXd left = Eigen::MatrixXd::Identity(P.rows(), P.rows()) - K * H;
    P = (left * P * left.transpose() + K * R * K.transpose()).eval();
    clock_P_ = 0.5 * (P + P.transpose());
  }
  return finish(report);
}

ParticleReport ParticleCloud::step(const AnyProcess* process, std::span<const double> input, double dt_s,
                                   std::span<const Observations> observations) {
  const std::scoped_lock lock(mutex_);
  check(observations);
  if (process != nullptr && input.size() != static_cast<std::size_t>(process->input_size())) {
    refuse("input: " + std::to_string(input.size()) + " numbers; " + process->kind() + " takes " +
           std::to_string(process->input_size()));
  }
  return locked_step(process, input.data(), dt_s, observations);
}

ParticleReport ParticleCloud::step_to(std::span<const double> next, std::span<const Observations> observations) {
  const std::scoped_lock lock(mutex_);
  check(observations);
  if (next.size() != get_count() * size()) refuse("next: wrong size");
  if (!settings_.clock.empty()) refuse("process: a process model expected with marginalized_clock");
  if (settings_.options.auxiliary) refuse("process: a process model expected with auxiliary");
  plan_move(next);
  if (const UpdateStatus status = plan_weights(observations, &constraints_); status != UpdateStatus::kAccepted) {
    return refused(status);
  }
  return finish(do_step(1.0));
}

ParticleReport ParticleCloud::update(std::span<const Observations> observations) {
  const std::scoped_lock lock(mutex_);
  check(observations);
  const Constraints box{{}, constraints_.low, constraints_.high};
  if (!settings_.clock.empty()) return weigh_with_clock(nullptr, 0.0, observations, box, false);
  if (const UpdateStatus status = plan_weights(observations, &box); status != UpdateStatus::kAccepted) {
    return refused(status);
  }
  return finish(do_update());
}

ParticleReport ParticleCloud::reweight(std::span<const double> log_likelihood, bool may_resample) {
  const std::scoped_lock lock(mutex_);
  if (log_likelihood.size() != get_count()) {
    refuse("log_likelihood: " + std::to_string(log_likelihood.size()) + " numbers; one for each of " +
           std::to_string(get_count()) + " particles expected");
  }
  const bool resampled = may_resample && resample_when_due();
  ParticleReport report = do_reweight(log_likelihood);
  report.resampled = resampled;
  return finish(report);
}

ParticleReport ParticleCloud::constrain(Constraints constraints) {
  const std::scoped_lock lock(mutex_);
  if (!constraints.walls.walls.empty() && settings_.roles.position_dim < 2) {
    refuse("walls: state '" + settings_.state + "' has no position in a plane");
  }
  for (const Wall& wall : constraints.walls.walls) {
    if (!wall.a.allFinite() || !wall.b.allFinite()) refuse("walls: a number is not finite");
  }
  if (!constraints.low.empty()) {
    if (constraints.low.size() != size()) {
      refuse("inside: " + std::to_string(constraints.low.size()) + " rows; one for each of " + std::to_string(size()) +
             " components expected");
    }
    for (std::size_t c = 0; c < size(); ++c) {
      if (!(constraints.low[c] <= constraints.high[c])) {
        refuse("inside[" + std::to_string(c) + "]: low <= high expected");
      }
    }
  }
  constraints_ = std::move(constraints);
  const Constraints box{{}, constraints_.low, constraints_.high};
  if (box.empty()) return {ParticleStatus::kAccepted, 0.0, get_ess(), false};
  static_cast<void>(plan_weights({}, &box));
  return finish(do_update());
}

void ParticleCloud::resample() {
  const std::scoped_lock lock(mutex_);
  do_resample();
}

std::vector<double> ParticleCloud::next_particles() {
  const std::scoped_lock lock(mutex_);
  // A new number of particles or spread copies cannot be looked at beforehand.
  const bool beforehand = settings_.options.adaptive.bin_sizes.empty() && settings_.options.regularisation == 0.0;
  if (!beforehand) static_cast<void>(resample_when_due());
  const std::size_t n = get_count();
  std::vector<std::uint32_t> ancestors(n);
  const bool resampled = beforehand && next_ancestors(ancestors);
  std::vector<double> rows(n * size());
  std::vector<double> component(n);
  for (std::size_t c = 0; c < size(); ++c) {
    get_component(static_cast<int>(c), component.data());
    for (std::size_t i = 0; i < n; ++i) rows[i * size() + c] = component[resampled ? ancestors[i] : i];
  }
  return rows;
}

std::vector<double> ParticleCloud::next_noise(std::size_t numbers) const {
  const std::scoped_lock lock(mutex_);
  std::uint64_t stride = 0;
  RandomStream stream = next_noise_stream(stride);
  const std::size_t n = get_count();
  std::vector<double> rows(n * numbers);
  std::vector<float> column(n);
  for (std::size_t k = 0; k < numbers; ++k) {
    stream.seek(k * stride);
    stream.fill_normal(std::span(column));
    for (std::size_t i = 0; i < n; ++i) rows[i * numbers + k] = static_cast<double>(column[i]);
  }
  return rows;
}

CloudRun ParticleCloud::run(std::span<const double> time_s, std::optional<double> start_s, const AnyProcess* process,
                            std::span<const double> inputs, std::span<const RunObservations> observations,
                            bool covariance) {
  const std::scoped_lock lock(mutex_);
  const std::size_t steps = time_s.size();
  const std::size_t n = size();
  double before = start_s.value_or(-std::numeric_limits<double>::infinity());
  for (std::size_t k = 0; k < steps; ++k) {
    if (!std::isfinite(time_s[k])) refuse("time_s[" + std::to_string(k) + "] is not finite");
    if (!(time_s[k] > before)) {
      refuse("time_s[" + std::to_string(k) + "] = " + std::to_string(time_s[k]) + " is not after " +
             std::to_string(before) + (k == 0 ? " = start_s" : ", the time before it"));
    }
    before = time_s[k];
  }
  const auto input_size = static_cast<std::size_t>(process != nullptr ? process->input_size() : 0);
  if (inputs.size() != steps * input_size) {
    refuse("inputs: " + std::to_string(inputs.size()) + " numbers; " + std::to_string(input_size) +
           " for each time expected");
  }
  std::vector<Observations> groups(observations.size());
  for (std::size_t g = 0; g < groups.size(); ++g) {
    const RunObservations& from = observations[g];
    for (const AnyMeasurement* model : from.models) check_readable(*model, settings_.roles, settings_.state);
    const std::size_t m = rows_of(from.models);
    const std::size_t per_time = from.full ? m * m : m;
    const std::string name = "measurements[" + std::to_string(g) + "]";
    if (from.z.size() != steps * m) {
      refuse(name + ": z has " + std::to_string(from.z.size()) + " numbers, expected " + std::to_string(m) +
             " for each time");
    }
    if (from.noise.size() != (from.each ? steps : 1) * per_time) {
      refuse(name + ": sigma or R has " + std::to_string(from.noise.size()) + " numbers, expected " +
             std::to_string(per_time) + (from.each ? " for each time" : ""));
    }
    if (!from.present.empty() && from.present.size() != steps) {
      refuse(name + ": mask has " + std::to_string(from.present.size()) + " numbers, expected one for each time");
    }
  }

  CloudRun out;
  out.mean.resize(steps * n);
  if (covariance) out.covariance.resize(steps * n * n);
  out.ess.resize(steps);
  out.log_likelihood.resize(steps);
  out.status.resize(steps);
  out.resampled.resize(steps);
  out.count.resize(steps);
  for (std::size_t k = 0; k < steps; ++k) {
    groups.resize(observations.size());
    std::size_t there = 0;
    for (const RunObservations& from : observations) {
      if (!from.present.empty() && from.present[k] == 0) continue;
      Observations& o = groups[there++];
      const auto m = static_cast<Eigen::Index>(rows_of(from.models));
      o.models = from.models;
      o.z = Eigen::Map<const Eigen::VectorXd>(from.z.data() + static_cast<Eigen::Index>(k) * m, m);
      const double* noise = from.noise.data();
      if (from.each) noise += static_cast<Eigen::Index>(k) * (from.full ? m * m : m);
      if (from.full) {
        o.R = Eigen::Map<const Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>>(noise, m, m);
        o.variances.resize(0);
      } else {
        o.R.resize(0, 0);
        o.variances = Eigen::Map<const Eigen::VectorXd>(noise, m);
      }
      o.probability = from.probability;
      o.density = from.density;
    }
    const std::span<const Observations> present(groups.data(), there);
    const bool moves = process != nullptr && (k > 0 || start_s);
    const double dt_s = moves ? time_s[k] - (k > 0 ? time_s[k - 1] : *start_s) : 0.0;
    ParticleReport report = locked_step(moves ? process : nullptr, inputs.data() + k * input_size, dt_s, present);
    out.ess[k] = report.ess;
    out.log_likelihood[k] = report.log_likelihood;
    out.status[k] = static_cast<std::uint8_t>(report.status);
    out.resampled[k] = report.resampled ? 1 : 0;
    get_mean(out.mean.data() + k * n);
    if (covariance) covariance_into(out.covariance.data() + k * n * n);
    out.count[k] = get_count();
  }
  return out;
}

Eigen::VectorXd ParticleCloud::mean() const {
  const std::scoped_lock lock(mutex_);
  Eigen::VectorXd x(static_cast<Eigen::Index>(size()));
  get_mean(x.data());
  return x;
}

Eigen::MatrixXd ParticleCloud::covariance() const {
  const std::scoped_lock lock(mutex_);
  const auto n = static_cast<Eigen::Index>(size());
  Eigen::MatrixXd P(n, n);
  covariance_into(P.data());
  return P;
}

void ParticleCloud::covariance_into(double* out) const {
  get_covariance(out);
  // That of the particles, and an exact clock's own.
  for (std::size_t i = 0; i < settings_.clock.size(); ++i) {
    for (std::size_t j = 0; j < settings_.clock.size(); ++j) {
      out[static_cast<std::size_t>(settings_.clock[i]) * size() + static_cast<std::size_t>(settings_.clock[j])] +=
          clock_P_(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j));
    }
  }
}

double ParticleCloud::ess() const {
  const std::scoped_lock lock(mutex_);
  return get_ess();
}

double ParticleCloud::log_likelihood() const {
  const std::scoped_lock lock(mutex_);
  return get_log_likelihood();
}

std::size_t ParticleCloud::storage_bytes() const {
  const std::scoped_lock lock(mutex_);
  return get_storage_bytes();
}

std::vector<double> ParticleCloud::particles() const {
  const std::scoped_lock lock(mutex_);
  const std::size_t n = get_count();
  std::vector<double> components(n * size());
  for (std::size_t c = 0; c < size(); ++c) get_component(static_cast<int>(c), components.data() + c * n);
  return components;
}

std::vector<double> ParticleCloud::weights() const {
  const std::scoped_lock lock(mutex_);
  std::vector<double> w(get_count());
  get_weights(w);
  return w;
}

double ParticleCloud::histogram(int component, double low, double high, std::span<double> bins) const {
  const std::scoped_lock lock(mutex_);
  return get_histogram(component, low, high, bins);
}

CloudSnapshot ParticleCloud::save() const {
  const std::scoped_lock lock(mutex_);
  CloudSnapshot snapshot;
  get_snapshot(snapshot);
  snapshot.restarts = restarts_;
  snapshot.clock_covariance.assign(clock_P_.data(), clock_P_.data() + clock_P_.size());
  return snapshot;
}

void ParticleCloud::restore(const CloudSnapshot& snapshot) {
  const std::scoped_lock lock(mutex_);
  if (snapshot.clock_covariance.size() != static_cast<std::size_t>(clock_P_.size())) {
    refuse("clock_covariance: wrong size");
  }
  set_snapshot(snapshot);
  restarts_ = snapshot.restarts;
  std::copy(snapshot.clock_covariance.begin(), snapshot.clock_covariance.end(), clock_P_.data());
}

}  // namespace soopnav::python
