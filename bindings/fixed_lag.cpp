#include "fixed_lag.hpp"

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>
#include <utility>

#include "kalman_filter.hpp"
#include "soopnav/estimation/fixed_lag_filter.hpp"

namespace soopnav::python {

namespace {

constexpr int kN = kMaxCustomDim;
using Input = std::array<double, 3>;

Epoch at(double time_s) noexcept { return Epoch::from_seconds(TimeScale::kCapture, time_s); }

// The erased process, and the model it was made from, which is what filters behind their interface take.
struct AnyStep : ErasedProcess<kN> {
  const AnyProcess* model = nullptr;
};

// Models with as many rows as any update may have; rows that these do not have are zero, of variance one.
struct PaddedModels {
  static constexpr int kDim = kMostRows;
  std::shared_ptr<const std::vector<AnyMeasurement>> models;
  int rows = 0;
};
using Observation = Observed<PaddedModels>;

// A filter behind its interface as a value.
class AnyFilter {
 public:
  using State = ErasedState<kN>;
  using Square = Eigen::Matrix<double, kN, kN>;

  explicit AnyFilter(const KalmanFilter& filter) : filter_(filter.clone()) {}
  AnyFilter(const AnyFilter& other) : filter_(other.filter_->clone()) {}
  AnyFilter(AnyFilter&&) noexcept = default;
  AnyFilter& operator=(const AnyFilter& other) {
    if (this != &other) filter_ = other.filter_->clone();
    return *this;
  }
  AnyFilter& operator=(AnyFilter&&) noexcept = default;
  ~AnyFilter() = default;

  [[nodiscard]] const KalmanFilter& get() const noexcept { return *filter_; }
  [[nodiscard]] State state() const {
    const std::vector<double> numbers = filter_->x();
    State x;
    std::copy(numbers.begin(), numbers.end(), x.x.data());
    const int heading = filter_->state().roles.heading;
    if (heading >= 0) x.angles = 1U << static_cast<unsigned>(heading);
    return x;
  }
  // For the smoother every component has a variance.
  [[nodiscard]] Square covariance() const { return padded(filter_->P(), Square::Identity()); }

  UpdateStatus predict(const AnyStep& process, const Input& input, double dt_s, Square* cross) {
    std::vector<double> between;
    const UpdateStatus status = filter_->predict(*process.model, input.data(), dt_s, &between);
    if (status == UpdateStatus::kAccepted) *cross = padded(between, Square::Zero());
    return status;
  }
  UpdateReport<kMostRows> update(const Observation& observed, const Gate& gate) {
    std::vector<const AnyMeasurement*> models;
    for (const AnyMeasurement& model : *observed.model.models) models.push_back(&model);
    const auto rows = static_cast<std::size_t>(observed.model.rows);
    std::vector<double> R;
    for (std::size_t i = 0; i < rows; ++i) {
      const double* const column = observed.R.col(static_cast<Eigen::Index>(i)).data();
      R.insert(R.end(), column, column + rows);
    }
    const KalmanReport from = filter_->update(models, {observed.z.data(), rows}, R, gate);
    UpdateReport<kMostRows> report;
    report.status = from.status;
    report.nis = from.nis;
    for (std::size_t i = 0; i < rows; ++i) {
      report.innovation[static_cast<Eigen::Index>(i)] = from.innovation[i];
      for (std::size_t j = 0; j < rows; ++j) {
        report.covariance(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j)) = from.covariance[i * rows + j];
      }
    }
    return report;
  }

 private:
  [[nodiscard]] Square padded(const std::vector<double>& numbers, Square P) const {
    const int n = filter_->state().roles.size;
    for (int i = 0; i < n; ++i) {
      for (int j = 0; j < n; ++j) P(i, j) = numbers[static_cast<std::size_t>(i * n + j)];
    }
    return P;
  }

  std::unique_ptr<KalmanFilter> filter_;
};

// The first `rows` rows of a report.
KalmanReport unpadded(const UpdateReport<kMostRows>& from, int rows) {
  UpdateReport<Eigen::Dynamic, kMostRows> report(rows);
  report.status = from.status;
  report.nis = from.nis;
  report.innovation = from.innovation.head(rows);
  report.covariance = from.covariance.topLeftCorner(rows, rows);
  return detail::to_report(report);
}

// What copies of a filter share; the erased process points into it.
struct Parts {
  StateInfo info;
  AnyProcess process;
  ProcessSource source;
};

Input to_three(std::span<const double> numbers) {
  Input input{};
  std::copy(numbers.begin(), numbers.end(), input.begin());
  return input;
}

Observation to_observation(std::span<const AnyMeasurement* const> models, std::span<const double> z,
                           std::span<const double> R) {
  auto kept = std::make_shared<std::vector<AnyMeasurement>>();
  for (const AnyMeasurement* model : models) kept->push_back(*model);
  const auto rows = static_cast<int>(z.size());
  Observation observed({std::move(kept), rows}, Eigen::Matrix<double, kMostRows, 1>::Zero(),
                       Eigen::Matrix<double, kMostRows, kMostRows>::Identity());
  observed.z.head(rows) = Eigen::Map<const Eigen::VectorXd>(z.data(), rows);
  observed.R.topLeftCorner(rows, rows) = Eigen::Map<const Eigen::MatrixXd>(R.data(), rows, rows);
  return observed;
}

class LagFilterOf final : public LagFilter {
 public:
  using Lag = FixedLagFilter<AnyFilter, AnyStep, PaddedModels>;

  LagFilterOf(std::shared_ptr<const Parts> parts, const Lag& lag) : parts_(std::move(parts)), lag_(lag) {}

  static AnyStep step(const Parts& parts) { return {{&parts.source, &parts.info.roles}, &parts.process}; }
  static Lag::Memory to_memory(const KalmanFilter& first, const LagMemory& memory) {
    Lag::Memory to{AnyFilter(first),         at(memory.time_s),       to_three(memory.input),
                   at(memory.oldest_time_s), at(memory.last_input_s), {},
                   memory.capacity};
    for (const LagArrival& arrival : memory.arrivals) {
      Lag::Arrival kept;
      kept.epoch = at(arrival.time_s);
      if (!arrival.input.empty()) kept.input = to_three(arrival.input);
      if (!arrival.models.empty()) {
        std::vector<const AnyMeasurement*> models;
        for (const AnyMeasurement& model : arrival.models) models.push_back(&model);
        kept.observation = to_observation(models, arrival.z, arrival.R);
      }
      kept.gate = arrival.gate;
      to.arrivals.push_back(std::move(kept));
    }
    return to;
  }

  [[nodiscard]] std::unique_ptr<LagFilter> clone() const override { return std::make_unique<LagFilterOf>(*this); }
  [[nodiscard]] const KalmanFilter& filter() const noexcept override { return lag_.filter().get(); }
  [[nodiscard]] std::unique_ptr<KalmanFilter> first() const override { return lag_.memory().filter.get().clone(); }
  [[nodiscard]] LagMemory save() const override {
    const Lag::Memory memory = lag_.memory();
    LagMemory to{.time_s = memory.epoch.seconds_since_origin(),
                 .input = {memory.input.begin(), memory.input.end()},
                 .oldest_time_s = memory.oldest.seconds_since_origin(),
                 .last_input_s = memory.last_input.seconds_since_origin(),
                 .arrivals = {},
                 .capacity = memory.capacity};
    for (const Lag::Arrival& kept : memory.arrivals) {
      LagArrival arrival;
      arrival.time_s = kept.epoch.seconds_since_origin();
      arrival.gate = kept.gate;
      if (kept.input) arrival.input.assign(kept.input->begin(), kept.input->end());
      if (const auto* observed = std::get_if<Observation>(&kept.observation)) {
        const int rows = observed->model.rows;
        arrival.models = *observed->model.models;
        arrival.z.assign(observed->z.data(), observed->z.data() + rows);
        for (int i = 0; i < rows; ++i) {
          arrival.R.insert(arrival.R.end(), observed->R.col(i).data(), observed->R.col(i).data() + rows);
        }
      }
      to.arrivals.push_back(std::move(arrival));
    }
    return to;
  }
  [[nodiscard]] double time_s() const noexcept override { return lag_.epoch().seconds_since_origin(); }
  [[nodiscard]] double oldest_time_s() const noexcept override { return lag_.oldest_epoch().seconds_since_origin(); }
  [[nodiscard]] int size() const noexcept override { return lag_.size(); }
  [[nodiscard]] int capacity() const noexcept override { return lag_.capacity(); }

  UpdateStatus advance(double time_s, const double* input) override {
    if (!std::isfinite(time_s)) return UpdateStatus::kNonFinite;
    if (input == nullptr) return lag_.advance(at(time_s));
    const Input u = to_three({input, 3});
    // An input is in force after its time: one that is no number would be noticed by what follows only.
    if (!std::all_of(u.begin(), u.end(), [](double value) { return std::isfinite(value); })) {
      return UpdateStatus::kNonFinite;
    }
    return lag_.advance(at(time_s), u);
  }
  KalmanReport update(std::span<const AnyMeasurement* const> models, std::span<const double> z,
                      std::span<const double> R, double time_s, const Gate& gate) override {
    const auto rows = static_cast<int>(z.size());
    if (!std::isfinite(time_s)) {
      UpdateReport<kMostRows> report;
      report.status = UpdateStatus::kNonFinite;
      return unpadded(report, rows);
    }
    return unpadded(lag_.update(to_observation(models, z, R), at(time_s), gate), rows);
  }

  void run(LagRun& run) override {
    for (const RunGroup& group : run.groups) {
      for (const AnyMeasurement* model : group.models) require_readable(*model, parts_->info.name);
    }
    const auto n = static_cast<std::size_t>(parts_->info.roles.size);
    for (std::size_t k = 0; k < run.events.size(); ++k) {
      const LagRun::Event& event = run.events[k];
      if (event.group < 0) {
        run.status[k] = static_cast<std::uint8_t>(advance(event.time_s, run.inputs + 3 * event.row));
      } else {
        const RunGroup& group = run.groups[static_cast<std::size_t>(event.group)];
        const auto m = static_cast<std::size_t>(group.rows);
        const double* R = group.R + (group.R_each ? event.row * m * m : 0);
        const KalmanReport report =
            update(group.models, {group.z + event.row * m, m}, {R, m * m}, event.time_s, run.gate);
        run.status[k] = static_cast<std::uint8_t>(report.status);
        run.nis[k] = report.nis;
      }
      run.time_s[k] = time_s();
      if (run.x == nullptr) continue;
      const std::vector<double> x = filter().x();
      const std::vector<double> P = filter().P();
      std::copy(x.begin(), x.end(), run.x + k * n);
      std::copy(P.begin(), P.end(), run.P + k * n * n);
    }
  }

  [[nodiscard]] bool smooth(std::vector<double>& time_s, std::vector<double>& x, std::vector<double>& P) override {
    if (lag_.smooth() != SmoothStatus::kDone) return false;
    const int n = parts_->info.roles.size;
    for (const Epoch& epoch : lag_.smoothed_epochs()) time_s.push_back(epoch.seconds_since_origin());
    for (const auto& step : lag_.smoothed()) {
      x.insert(x.end(), step.state.x.data(), step.state.x.data() + n);
      for (int j = 0; j < n; ++j) P.insert(P.end(), step.P.col(j).data(), step.P.col(j).data() + n);
    }
    return true;
  }

 private:
  std::shared_ptr<const Parts> parts_;
  Lag lag_;
};

std::shared_ptr<const Parts> make_parts(const KalmanFilter& filter, const AnyProcess& process) {
  return std::make_shared<const Parts>(Parts{filter.state(), process, process_source(process, filter.state())});
}

}  // namespace

std::unique_ptr<LagFilter> make_lag_filter(const KalmanFilter& filter, const AnyProcess& process, double start_s,
                                           int capacity, std::span<const double> input) {
  const auto parts = make_parts(filter, process);
  return std::make_unique<LagFilterOf>(
      parts, LagFilterOf::Lag(AnyFilter(filter), LagFilterOf::step(*parts), at(start_s), capacity, to_three(input)));
}

std::unique_ptr<LagFilter> load_lag_filter(const KalmanFilter& first, const AnyProcess& process,
                                           const LagMemory& memory) {
  const auto parts = make_parts(first, process);
  return std::make_unique<LagFilterOf>(
      parts, LagFilterOf::Lag(LagFilterOf::step(*parts), LagFilterOf::to_memory(first, memory)));
}

}  // namespace soopnav::python
