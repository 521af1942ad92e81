#pragma once

#include <Eigen/Core>
#include <array>
#include <limits>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>

#include "kalman.hpp"
#include "kalman_callable.hpp"
#include "soopnav/estimation/covariance_check.hpp"
#include "soopnav/estimation/observed.hpp"

namespace soopnav::python {

namespace detail {

template <class Report>
KalmanReport to_report(const Report& from) {
  KalmanReport report;
  report.status = from.status;
  report.rows = static_cast<int>(from.innovation.size());
  report.nis = from.nis;
  report.log_likelihood = from.log_likelihood();
  for (int i = 0; i < report.rows; ++i) {
    report.innovation[static_cast<std::size_t>(i)] = from.innovation[i];
    for (int j = 0; j < report.rows; ++j) {
      report.covariance[static_cast<std::size_t>(i * report.rows + j)] = from.covariance(i, j);
    }
  }
  return report;
}

/// The rows of the models of one update, which must outlive them.
template <int N>
std::vector<ErasedRow<N>> rows_of(std::span<const AnyMeasurement* const> models, const StateInfo& state) {
  std::vector<ErasedRow<N>> rows;
  for (const AnyMeasurement* model : models) {
    for (const RowSource& source : row_sources(*model, state)) {
      rows.push_back({source.context, &state.roles, source.evaluate, source.row, source.angle});
    }
  }
  return rows;
}

}  // namespace detail

/// `Kind` says which filter, how it keeps its uncertainty, and whether it asks callables for sigma points. `N`: most
/// components; those that the state lacks have variance `Kind::kPadding` and nothing to do with the others.
template <class Kind, int N>
class KalmanFilterOf final : public KalmanFilter {
 public:
  using State = ErasedState<N>;
  using Filter = typename Kind::template Filter<N>;
  using Vector = Eigen::Matrix<double, N, 1>;
  using Square = Eigen::Matrix<double, N, N>;

  KalmanFilterOf(StateInfo info, const KalmanSetup& setup)
      : info_(std::move(info)),
        n_(info_.roles.size),
        filter_(Kind::template make<N>(start(info_, setup.x0), padded(setup.P0, n_), setup)) {}

  [[nodiscard]] std::unique_ptr<KalmanFilter> clone() const override { return std::make_unique<KalmanFilterOf>(*this); }
  [[nodiscard]] const StateInfo& state() const noexcept override { return info_; }
  [[nodiscard]] std::vector<double> x() const override {
    const auto& x = filter_.state().x;
    return {x.data(), x.data() + n_};
  }
  [[nodiscard]] std::vector<double> P() const override { return unpadded(filter_.covariance()); }

  [[nodiscard]] KalmanMemory save() const override {
    KalmanMemory memory{.x = x(), .matrix = unpadded(Kind::matrix(filter_)), .floor = {}, .floor_counts = {}};
    const auto& floor = filter_.covariance_floor();
    if (floor.active) memory.floor.assign(floor.variance.data(), floor.variance.data() + n_);
    for (std::size_t i = 0; i < static_cast<std::size_t>(n_); ++i) {
      memory.floor_counts.push_back(floor.counts[i] + earlier_counts_[i]);
    }
    return memory;
  }
  void load(const KalmanMemory& memory) override {
    const auto n = static_cast<std::size_t>(n_);
    if (memory.x.size() != n || memory.matrix.size() != n * n || memory.floor_counts.size() != n) {
      throw std::invalid_argument("saved filter: of another size");
    }
    if (!memory.floor.empty()) set_floor(memory.floor);
    Kind::restore(filter_, start(info_, memory.x), padded(memory.matrix, n_));
    std::copy_n(memory.floor_counts.begin(), n, earlier_counts_.begin());
  }
  void set_floor(std::span<const double> variance) override {
    if (variance.size() != static_cast<std::size_t>(n_)) {
      throw std::invalid_argument("variance: expected " + std::to_string(n_) + " numbers, got " +
                                  std::to_string(variance.size()));
    }
    Vector floor = Vector::Zero();
    std::copy(variance.begin(), variance.end(), floor.data());
    filter_.set_covariance_floor(floor);
    earlier_counts_ = {};
  }

  UpdateStatus predict(const AnyProcess& process, const double* input, double dt_s,
                       std::vector<double>* cross) override {
    Square between;
    const UpdateStatus status = move(process, input, dt_s, cross == nullptr ? nullptr : &between);
    if (cross != nullptr && status == UpdateStatus::kAccepted) *cross = unpadded(between);
    return status;
  }
  UpdateStatus predict(const py::function& f, std::span<const double> Q, double dt_s) override {
    const CallableProcess<N, Kind::kSigmaPoints> process(f, Q, filter_, n_, dt_s);
    return filter_.predict(process, {}, dt_s);
  }
  KalmanReport update(std::span<const AnyMeasurement* const> models, std::span<const double> z,
                      std::span<const double> R, const Gate& gate) override {
    const auto rows = detail::rows_of<N>(models, info_);
    return take_in(rows, z.data(), R.data(), gate);
  }
  KalmanReport update(const CallableMeasurement& model, std::span<const double> z, std::span<const double> R,
                      const Gate& gate) override {
    const CallableRows<N, Kind::kSigmaPoints> rows(model, z.size(), filter_, info_.roles);
    return take_in(rows.rows(), z.data(), R.data(), gate);
  }

  void run(Run& run) override {
    std::vector<std::vector<ErasedRow<N>>> rows;
    for (const RunGroup& group : run.groups) rows.push_back(detail::rows_of<N>(group.models, info_));
    const Filter before = filter_;
    const std::optional<AdaptiveProcessNoise> noise_before =
        run.noise == nullptr ? std::nullopt : std::optional(*run.noise);
    try {
      with_process(*run.process, [&](const auto& concrete, auto to_input) {
        if (run.x_smooth == nullptr) {
          loop<false>(run, rows, concrete, to_input);
        } else {
          loop<true>(run, rows, concrete, to_input);
        }
      });
    } catch (...) {
      filter_ = before;
      if (noise_before) *run.noise = *noise_before;
      throw;
    }
  }

 private:
  [[nodiscard]] static State start(const StateInfo& info, const std::vector<double>& numbers) {
    State x;
    std::copy(numbers.begin(), numbers.end(), x.x.data());
    if (info.roles.heading >= 0) x.angles = 1U << static_cast<unsigned>(info.roles.heading);
    return x;
  }
  // Row-major n x n numbers among components of their own.
  [[nodiscard]] static Square padded(const std::vector<double>& numbers, int n) {
    Square P = Kind::kPadding * Square::Identity();
    for (int i = 0; i < n; ++i) {
      for (int j = 0; j < n; ++j) P(i, j) = numbers[static_cast<std::size_t>(i * n + j)];
    }
    return P;
  }
  [[nodiscard]] std::vector<double> unpadded(const Square& P) const {
    std::vector<double> numbers;
    for (int i = 0; i < n_; ++i) {
      for (int j = 0; j < n_; ++j) numbers.push_back(P(i, j));
    }
    return numbers;
  }
  // For the smoother every component has a variance.
  [[nodiscard]] PaddedRecord padded_record() const {
    PaddedRecord record;
    record.predicted.angles = filter_.state().angles;
    record.predicted.x.template head<N>() = filter_.state().x;
    record.P_pred.setIdentity();
    record.P_pred.topLeftCorner(n_, n_) = filter_.covariance().topLeftCorner(n_, n_);
    record.cross.setZero();
    return record;
  }

  [[gnu::noinline]] UpdateStatus move(const AnyProcess& process, const double* input, double dt_s, Square* cross) {
    UpdateStatus status = UpdateStatus::kUndefined;
    with_process(process, [&](const auto& concrete, auto to_input) {
      status = filter_.predict(concrete, to_input(input), dt_s, cross);
    });
    return status;
  }
  // Calls f(process, to_input), where to_input makes the process's input of plain numbers.
  template <class F>
  void with_process(const AnyProcess& process, F&& f) {
    if constexpr (requires { Kind::template with_hot<N>(process, info_, f); }) {
      if (Kind::template with_hot<N>(process, info_, f)) return;
    }
    const ProcessSource source = process_source(process, info_);
    f(ErasedProcess<N>{&source, &info_.roles}, [](const double* numbers) {
      return numbers == nullptr ? std::array<double, 3>{} : std::array{numbers[0], numbers[1], numbers[2]};
    });
  }

  [[gnu::noinline]] KalmanReport take_in(const std::vector<ErasedRow<N>>& rows, const double* z, const double* R,
                                         const Gate& gate) {
    if constexpr (Kind::template kFewRows<N>) {
      if (rows.size() == 1) return take_few<1>(rows, z, R, gate);
      if (rows.size() == 2) return take_few<2>(rows, z, R, gate);
      if (rows.size() == 3) return take_few<3>(rows, z, R, gate);
    }
    const auto m = static_cast<Eigen::Index>(rows.size());
    const Correlated<ErasedRow<N>> group{rows, Eigen::Map<const Eigen::VectorXd>(z, m),
                                         Eigen::Map<const Eigen::MatrixXd>(R, m, m)};
    return detail::to_report(filter_.template update<kMostRows>(group, gate));
  }
  template <int M>
  KalmanReport take_few(const std::vector<ErasedRow<N>>& rows, const double* z, const double* R, const Gate& gate) {
    const Eigen::Map<const Eigen::Matrix<double, M, 1>> values(z);
    const Eigen::Map<const Eigen::Matrix<double, M, M>> covariance(R);
    return detail::to_report(filter_.update(ErasedRows<N, M>{rows.data()}, values, covariance, gate));
  }

  void write(double* x, double* P, std::size_t step) const {
    if (x == nullptr) return;
    const auto n = static_cast<std::size_t>(n_);
    std::copy_n(filter_.state().x.data(), n, x + step * n);
    const Square covariance = filter_.covariance();
    for (int j = 0; j < n_; ++j) {
      std::copy_n(covariance.col(j).data(), n, P + (step * n + static_cast<std::size_t>(j)) * n);
    }
  }

  template <bool kSmooth, class Process, class ToInput>
  void loop(Run& run, const std::vector<std::vector<ErasedRow<N>>>& rows, const Process& process, ToInput to_input) {
    std::vector<PaddedRecord> records;
    if constexpr (kSmooth) records.reserve(run.time_s.size());
    double now = run.start_s ? *run.start_s : run.time_s[0];
    const std::size_t groups = run.groups.size();
    for (std::size_t k = 0; k < run.time_s.size(); ++k) {
      UpdateStatus moved = UpdateStatus::kAccepted;
      Square cross;
      if (k > 0 || run.start_s) {
        const double* input = run.inputs == nullptr ? nullptr : run.inputs + 3 * k;
        if constexpr (kSmooth) cross = filter_.covariance();
        const double dt_s = run.time_s[k] - now;
        if (run.noise == nullptr) {
          moved = filter_.predict(process, to_input(input), dt_s, kSmooth ? &cross : nullptr);
        } else {
          const AnyProcess scaled = scaled_noise(*run.process, run.noise->multiplier());
          moved = move(scaled, input, dt_s, kSmooth ? &cross : nullptr);
        }
        if (moved == UpdateStatus::kAccepted) now = run.time_s[k];
      } else if constexpr (kSmooth) {
        cross = filter_.covariance();
      }
      run.predict_status[k] = static_cast<std::uint8_t>(moved);
      write(run.x_pred, run.P_pred, k);
      if constexpr (kSmooth) {
        records.push_back(padded_record());
        records.back().cross.topLeftCorner(n_, n_) = cross.topLeftCorner(n_, n_);
      }
      for (std::size_t g = 0; g < groups; ++g) {
        const RunGroup& group = run.groups[g];
        if (group.mask != nullptr && group.mask[k] == 0) continue;
        std::uint8_t& status = run.status[k * groups + g];
        if (moved != UpdateStatus::kAccepted) {
          status = static_cast<std::uint8_t>(moved);
          continue;
        }
        const auto m = static_cast<std::size_t>(group.rows);
        const double* R = group.R + (group.R_each ? k * m * m : 0);
        const KalmanReport report = take_in(rows[g], group.z + k * m, R, run.gate);
        status = static_cast<std::uint8_t>(report.status);
        run.nis[k * groups + g] = report.nis;
        if (report.status == UpdateStatus::kAccepted) run.log_likelihood += report.log_likelihood;
        if (run.noise != nullptr) learn(*run.noise, report, R);
      }
      if (run.noise != nullptr) run.noise_multiplier[k] = run.noise->multiplier();
      write(run.x, run.P, k);
      if constexpr (kSmooth) {
        const PaddedRecord after = padded_record();
        records.back().filtered = after.predicted;
        records.back().P = after.P_pred;
      }
    }
    if constexpr (kSmooth) {
      if (!smooth_run(records, n_, run.x_smooth, run.P_smooth)) {
        throw std::invalid_argument("smooth: a step of the run has no finite covariance to smooth with");
      }
    }
  }

  StateInfo info_;
  int n_;
  Filter filter_;
  std::array<std::uint64_t, static_cast<std::size_t>(N)> earlier_counts_{};
};

/// The filter of `Kind` for the state that `setup` names.
template <class Kind>
std::unique_ptr<KalmanFilter> make_kalman(const KalmanSetup& setup) {
  StateInfo info = state_info(setup.state, setup.x0.size());
  if constexpr (Kind::kSmallToo) {
    if (info.roles.size <= 5) return std::make_unique<KalmanFilterOf<Kind, 5>>(std::move(info), setup);
  }
  return std::make_unique<KalmanFilterOf<Kind, kMaxCustomDim>>(std::move(info), setup);
}

}  // namespace soopnav::python
