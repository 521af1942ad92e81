#include "multiple_model.hpp"

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>

#include "kalman_filter.hpp"
#include "soopnav/estimation/interacting_multiple_model.hpp"

namespace soopnav::python {

namespace {

// One size for all states: components that a state lacks have variance one and nothing to do with the others.
constexpr int kN = kMaxCustomDim;
using State = ErasedState<kN>;
using Square = Eigen::Matrix<double, kN, kN>;
using Process = ErasedProcess<kN>;

template <class Sequence>
struct EstimatorOf;
template <std::size_t... J>
struct EstimatorOf<std::index_sequence<J...>> {
  template <std::size_t>
  using Same = Process;
  using Type = InteractingMultipleModel<State, Same<J>...>;
};

// What copies of an estimator share; the erased processes point into it.
struct Parts {
  StateInfo info;
  std::vector<ProcessSource> sources;
};

State padded_state(const StateInfo& info, const double* numbers) {
  State x;
  std::copy_n(numbers, info.roles.size, x.x.data());
  if (info.roles.heading >= 0) x.angles = 1U << static_cast<unsigned>(info.roles.heading);
  return x;
}

Square padded_matrix(const double* numbers, int n) {
  Square P = Square::Identity();
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) P(i, j) = numbers[i * n + j];
  }
  return P;
}

// Row by row; covariances are symmetric, so columns serve.
double* write_matrix(const Square& P, int n, double* to) {
  for (int j = 0; j < n; ++j) to = std::copy_n(P.col(j).data(), n, to);
  return to;
}

template <std::size_t Count>
class MultipleModelOf final : public MultipleModel {
 public:
  static constexpr std::size_t kModes = Count;
  using Estimator = typename EstimatorOf<std::make_index_sequence<kModes>>::Type;
  using Probabilities = typename Estimator::Probabilities;

  MultipleModelOf(std::shared_ptr<const Parts> parts, const MultipleModelSetup& setup)
      : parts_(std::move(parts)), n_(parts_->info.roles.size), estimator_(make(*parts_, setup)) {}

  [[nodiscard]] std::unique_ptr<MultipleModel> clone() const override {
    return std::make_unique<MultipleModelOf>(*this);
  }
  [[nodiscard]] const StateInfo& state() const noexcept override { return parts_->info; }
  [[nodiscard]] std::vector<double> x() const override {
    const auto& x = estimator_.state().x;
    return {x.data(), x.data() + n_};
  }
  [[nodiscard]] std::vector<double> covariance() const override {
    std::vector<double> numbers(static_cast<std::size_t>(n_ * n_));
    write_matrix(estimator_.covariance(), n_, numbers.data());
    return numbers;
  }
  [[nodiscard]] std::vector<double> probabilities() const override {
    const Probabilities& p = estimator_.probabilities();
    return {p.data(), p.data() + kModes};
  }

  [[nodiscard]] MultipleModelMemory save() const override {
    MultipleModelMemory memory;
    memory.probabilities = probabilities();
    memory.fresh = fresh_;
    const auto n = static_cast<std::size_t>(n_);
    for (std::size_t j = 0; j < kModes; ++j) {
      const auto& mode = estimator_.modes()[j];
      memory.x.insert(memory.x.end(), mode.state().x.data(), mode.state().x.data() + n_);
      memory.P.resize(memory.P.size() + n * n);
      write_matrix(mode.covariance(), n_, &memory.P[j * n * n]);
      const auto& floor = mode.covariance_floor();
      if (floor.active) memory.floor.assign(floor.variance.data(), floor.variance.data() + n_);
      for (std::size_t i = 0; i < n; ++i) memory.floor_counts.push_back(floor.counts[i] + earlier_counts_[j * n + i]);
    }
    return memory;
  }
  void load(const MultipleModelMemory& memory) override {
    const auto n = static_cast<std::size_t>(n_);
    if (memory.x.size() != kModes * n || memory.P.size() != kModes * n * n || memory.probabilities.size() != kModes ||
        memory.floor_counts.size() != kModes * n) {
      throw std::invalid_argument("saved estimator: of another size");
    }
    if (!memory.floor.empty()) set_floor(memory.floor);
    std::copy(memory.floor_counts.begin(), memory.floor_counts.end(), earlier_counts_.begin());
    fresh_ = memory.fresh;
    if (fresh_) return;
    typename Estimator::Modes modes = estimator_.modes();
    for (std::size_t j = 0; j < kModes; ++j) {
      modes[j].restore(padded_state(parts_->info, &memory.x[j * n]), padded_matrix(&memory.P[j * n * n], n_));
    }
    estimator_.restore(modes, Eigen::Map<const Probabilities>(memory.probabilities.data()));
  }
  void set_floor(std::span<const double> variance) override {
    if (variance.size() != static_cast<std::size_t>(n_)) {
      throw std::invalid_argument("variance: expected " + std::to_string(n_) + " numbers, got " +
                                  std::to_string(variance.size()));
    }
    typename Estimator::Tangent floor = Estimator::Tangent::Zero();
    std::copy(variance.begin(), variance.end(), floor.data());
    estimator_.set_covariance_floor(floor);
    earlier_counts_ = {};
  }

  UpdateStatus predict(const double* input, double dt_s) override {
    std::array<double, 3> u{};
    if (input != nullptr) std::copy_n(input, 3, u.begin());
    const UpdateStatus status = estimator_.predict(u, dt_s);
    if (status == UpdateStatus::kAccepted) fresh_ = false;
    return status;
  }
  KalmanReport update(std::span<const AnyMeasurement* const> models, std::span<const double> z,
                      std::span<const double> R, const Gate& gate) override {
    return take_in(detail::rows_of<kN>(models, parts_->info), z.data(), R.data(), gate);
  }
  KalmanReport update(const CallableMeasurement& model, std::span<const double> z, std::span<const double> R,
                      const Gate& gate) override {
    const CallableRows<kN, false> rows(model, z.size(), estimator_, parts_->info.roles);
    return take_in(rows.rows(), z.data(), R.data(), gate);
  }

  void run(MultipleModelRun& run) override {
    std::vector<std::vector<ErasedRow<kN>>> rows;
    for (const RunGroup& group : run.groups) rows.push_back(detail::rows_of<kN>(group.models, parts_->info));
    double now = run.start_s ? *run.start_s : run.time_s[0];
    const std::size_t groups = run.groups.size();
    for (std::size_t k = 0; k < run.time_s.size(); ++k) {
      UpdateStatus moved = UpdateStatus::kAccepted;
      if (k > 0 || run.start_s) {
        moved = predict(run.inputs == nullptr ? nullptr : run.inputs + 3 * k, run.time_s[k] - now);
        if (moved == UpdateStatus::kAccepted) now = run.time_s[k];
      }
      run.predict_status[k] = static_cast<std::uint8_t>(moved);
      write_probabilities(run.predicted_probabilities, k);
      for (std::size_t g = 0; g < groups; ++g) {
        const RunGroup& group = run.groups[g];
        if (group.mask != nullptr && group.mask[k] == 0) continue;
        std::uint8_t& status = run.status[k * groups + g];
        status = static_cast<std::uint8_t>(moved);
        if (moved != UpdateStatus::kAccepted) continue;
        const auto m = static_cast<std::size_t>(group.rows);
        const double* R = group.R + (group.R_each ? k * m * m : 0);
        const KalmanReport report = take_in(rows[g], group.z + k * m, R, run.gate);
        status = static_cast<std::uint8_t>(report.status);
        run.nis[k * groups + g] = report.nis;
        if (report.status == UpdateStatus::kAccepted) run.log_likelihood += report.log_likelihood;
      }
      write_probabilities(run.probabilities, k);
      if (run.x == nullptr) continue;
      const auto n = static_cast<std::size_t>(n_);
      std::copy_n(estimator_.state().x.data(), n, run.x + k * n);
      write_matrix(estimator_.covariance(), n_, run.P + k * n * n);
    }
  }

 private:
  static Estimator make(const Parts& parts, const MultipleModelSetup& setup) {
    using Transitions = typename Estimator::Transitions;
    Transitions transition;
    for (std::size_t i = 0; i < kModes * kModes; ++i) {
      transition(static_cast<Eigen::Index>(i / kModes), static_cast<Eigen::Index>(i % kModes)) = setup.transition[i];
    }
    const Eigen::Map<const Probabilities> probabilities(setup.probabilities.data());
    return [&]<std::size_t... J>(std::index_sequence<J...>) {
      return Estimator(padded_state(parts.info, setup.x0.data()), padded_matrix(setup.P0.data(), parts.info.roles.size),
                       transition, probabilities, Process{&parts.sources[J], &parts.info.roles}...);
    }
    (std::make_index_sequence<kModes>{});
  }

  KalmanReport take_in(const std::vector<ErasedRow<kN>>& rows, const double* z, const double* R, const Gate& gate) {
    const auto m = static_cast<Eigen::Index>(rows.size());
    const Correlated<ErasedRow<kN>> group{rows, Eigen::Map<const Eigen::VectorXd>(z, m),
                                          Eigen::Map<const Eigen::MatrixXd>(R, m, m)};
    KalmanReport report = detail::to_report(estimator_.template update<kMostRows>(group, gate));
    const bool accepted = report.status == UpdateStatus::kAccepted;
    report.log_likelihood = accepted ? estimator_.log_likelihood() : std::numeric_limits<double>::quiet_NaN();
    if (accepted) fresh_ = false;
    return report;
  }
  void write_probabilities(double* to, std::size_t step) const {
    std::copy_n(estimator_.probabilities().data(), kModes, to + step * kModes);
  }

  std::shared_ptr<const Parts> parts_;
  int n_;
  Estimator estimator_;
  bool fresh_ = true;
  std::array<std::uint64_t, kModes* static_cast<std::size_t>(kN)> earlier_counts_{};
};

}  // namespace

std::unique_ptr<MultipleModel> make_multiple_model(const MultipleModelSetup& setup) {
  auto parts = std::make_shared<Parts>();
  parts->info = state_info(setup.state, setup.x0.size());
  for (const AnyProcess& process : setup.processes) parts->sources.push_back(process_source(process, parts->info));
  std::unique_ptr<MultipleModel> made;
  const auto attempt = [&]<std::size_t Count>(std::integral_constant<std::size_t, Count>) {
    if (setup.processes.size() == Count) made = std::make_unique<MultipleModelOf<Count>>(std::move(parts), setup);
  };
  [&]<std::size_t... M>(std::index_sequence<M...>) { (attempt(std::integral_constant<std::size_t, M + 1>{}), ...); }
  (std::make_index_sequence<kMostModes>{});
  if (!made) {
    throw std::invalid_argument("processes: " + std::to_string(setup.processes.size()) + ", expected 1 to " +
                                std::to_string(kMostModes));
  }
  return made;
}

}  // namespace soopnav::python
