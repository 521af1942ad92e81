#include "erased_model.hpp"

#include <Eigen/Core>
#include <algorithm>

namespace soopnav::python {

namespace {

template <class State>
RoleTable table_of() {
  RoleTable table{.size = State::kDim};
  if constexpr (kPositionDim<State> != 0) {
    constexpr int kDim = kPositionDim<State>;
    table.position = State::at(Role<kDim, PositionTag>{});
    table.position_dim = kDim;
    if constexpr (kMoves<State>) table.velocity = State::at(Role<kDim, VelocityTag>{});
  }
  const auto place = [&table]<class R>(R role, int RoleTable::*entry) {
    if constexpr (HoldsRole<State, R>) table.*entry = State::at(role);
  };
  place(kHeading, &RoleTable::heading);
  place(kTurnRate, &RoleTable::turn_rate);
  place(kClockBias, &RoleTable::clock_bias);
  place(kClockDrift, &RoleTable::clock_drift);
  return table;
}

// What models see of a state: numbers where the table says.
template <class FrameTag>
struct RoleView {
  using Frame = FrameTag;
  const double* x;
  const RoleTable& roles;

  template <int Dim, class Tag>
  [[nodiscard]] const double* operator()(Role<Dim, Tag> role) const noexcept {
    return x + roles.at(role);
  }
  template <int Dim>
  [[nodiscard]] const Known<Dim>& operator()(const Known<Dim>& known) const noexcept {
    return known;
  }
};

// Values and Jacobian, M rows, column-major in place.
template <int M>
struct RowsAndJacobian {
  static constexpr bool kJacobian = true;
  const RoleTable& roles;
  std::array<double, static_cast<std::size_t>(M)> z{};
  std::array<double, static_cast<std::size_t>(M* kMaxCustomDim)> H{};

  [[nodiscard]] double& value(int i) noexcept { return z[static_cast<std::size_t>(i)]; }
  template <int Dim, class Tag>
  [[nodiscard]] Eigen::Map<Eigen::Matrix<double, M, Dim>> jacobian(Role<Dim, Tag> role) noexcept {
    return Eigen::Map<Eigen::Matrix<double, M, Dim>>(H.data() + M * roles.at(role));
  }
  template <int Dim>
  [[nodiscard]] DiscardedJacobian jacobian(const Known<Dim>&) noexcept {
    return {};
  }
};

template <class Model>
bool evaluate_row(const void* context, int row, const RoleTable& roles, const double* x, double* z, double* gradient) {
  constexpr int kM = Model::kDim;
  const auto& model = *static_cast<const Model*>(context);
  const RoleView<typename Model::Frame> view{x, roles};
  if (gradient == nullptr) {
    ValuePrediction<double, kM> y;
    if (!model.predict(view, y)) return false;
    *z = y.value(row);
    return true;
  }
  RowsAndJacobian<kM> y{roles};
  if (!model.predict(view, y)) return false;
  *z = y.value(row);
  for (int i = 0; i < roles.size; ++i) gradient[i] = y.H[static_cast<std::size_t>(kM * i + row)];
  return true;
}

// An angle's residual of 4 comes back as 4 - 2 pi.
template <class Model>
bool is_angle(int row) {
  return soopnav::detail::residual<Model>(row, 4.0, 0.0) < 0.0;
}

// Next state, transition and noise where the table says; the part's noise begins at `column`.
template <bool Jacobian>
struct PartSink {
  static constexpr bool kJacobian = Jacobian;
  using Columns = Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::ColMajor>>;
  const RoleTable& roles;
  StepSink& y;
  int column;

  template <int Dim, class Tag>
  [[nodiscard]] double* next(Role<Dim, Tag> role) noexcept {
    return y.next + roles.at(role);
  }
  template <class To, class From>
  [[nodiscard]] auto transition(To to, From from) noexcept {
    ask(y.F_asked, roles.at(to), To::kDim, roles.at(from), From::kDim);
    return Columns(y.F, y.stride, roles.size).template block<To::kDim, From::kDim>(roles.at(to), roles.at(from));
  }
  template <int First, int Count, class R>
  [[nodiscard]] auto noise(R role) noexcept {
    ask(y.G_asked, roles.at(role), R::kDim, column + First, Count);
    return Columns(y.G, y.stride, column + First + Count)
        .template block<R::kDim, Count>(roles.at(role), column + First);
  }

 private:
  void ask(std::uint64_t& asked, int row, int rows, int from, int columns) const noexcept {
    for (int j = from; j < from + columns; ++j) {
      for (int i = row; i < row + rows; ++i) {
        const int bit = i + y.stride * j;
        if (bit < 64) asked |= std::uint64_t{1} << bit;
      }
    }
  }
};

// The number of noise columns is the process's own: models may ask for all of them.
template <class Process, bool Jacobian>
struct WholeSink : PartSink<Jacobian> {
  template <int First = 0, int Count = Process::kNoise, class R>
  [[nodiscard]] auto noise(R role) noexcept {
    return PartSink<Jacobian>::template noise<First, Count>(role);
  }
};

template <class Process, bool Jacobian>
bool run_part(const Process& process, const RoleTable& roles, const double* x, const double* u, double dt_s, int column,
              StepSink& y) {
  WholeSink<Process, Jacobian> sink{{roles, y, column}};
  return soopnav::detail::propagate(process, RoleView<PlanarFrame>{x, roles}, input_of<Process>(u), dt_s, ZeroNoise{},
                                    sink);
}

template <class Motion>
bool step(const void* motion, const RoleTable& roles, const double* x, const double* u, double dt_s, StepSink& y) {
  const auto& process = *static_cast<const Motion*>(motion);
  return y.F != nullptr ? run_part<Motion, true>(process, roles, x, u, dt_s, 0, y)
                        : run_part<Motion, false>(process, roles, x, u, dt_s, 0, y);
}

template <class Motion>
void put(ProcessSource& source, const Motion& motion) {
  source.motion = std::make_shared<const Motion>(motion);
  source.step = &step<Motion>;
  source.motion_noise = Motion::kNoise;
}

template <int Dim>
void put_straight(ProcessSource& source, const AnyProcess& process) {
  if (process.motion() == MotionKind::kNearlyConstantVelocity) {
    put(source, NearlyConstantVelocity<Dim>{.acceleration_psd = process.per_axis<Dim>()});
  } else {
    put(source, PiecewiseConstantAcceleration<Dim>{.acceleration_sigma_mps2 = process.per_axis<Dim>()});
  }
}

}  // namespace

StateInfo state_info(std::string_view name, std::size_t size) {
  return with_state(name, size, []<class State>(std::type_identity<State>) {
    return StateInfo{std::string(kStateName<State>), table_of<State>(), component_names<State>()};
  });
}

std::vector<RowSource> row_sources(const AnyMeasurement& measurement, const StateInfo& state) {
  require_readable(measurement, state.name);
  return std::visit(
      []<class Model>(const Model& model) {
        std::vector<RowSource> rows;
        for (int i = 0; i < Model::kDim; ++i) rows.push_back({&evaluate_row<Model>, &model, i, is_angle<Model>(i)});
        return rows;
      },
      measurement.model());
}

bool ProcessSource::propagate(const RoleTable& roles, const double* x, const double* u, double dt_s,
                              StepSink& y) const {
  if (!step(motion.get(), roles, x, u, dt_s, y)) return false;
  int column = motion_noise;
  if (clock.noise) {
    const bool defined = y.F != nullptr ? run_part<OptionalClock, true>(clock, roles, x, u, dt_s, column, y)
                                        : run_part<OptionalClock, false>(clock, roles, x, u, dt_s, column, y);
    if (!defined) return false;
    column += OptionalClock::kNoise;
  }
  if (y.G == nullptr) return true;
  const double root = std::sqrt(dt_s);
  for (int i = 0; i < roles.size; ++i) {
    const double element = sigma[static_cast<std::size_t>(i)] * root;
    if (element == 0.0) continue;
    const int at = i + y.stride * (column + i);
    y.G[at] = element;
    if (at < 64) y.G_asked |= std::uint64_t{1} << at;
  }
  return true;
}

ProcessSource process_source(const AnyProcess& process, const StateInfo& state) {
  const RoleTable& roles = state.roles;
  ProcessSource source;
  source.input_size = process.input_size();
  source.clock.noise = process.clock();
  source.sigma = process.diffusion_sigma(roles.size);
  if (process.motion() != MotionKind::kRandomWalk || process.clock()) {
    process.check_clock(roles.clock_bias >= 0 && roles.clock_drift >= 0, state.name);
  }
  switch (process.motion()) {
    case MotionKind::kRandomWalk:
      put(source, Still{});
      break;
    case MotionKind::kNearlyConstantVelocity:
    case MotionKind::kPiecewiseConstantAcceleration:
      if (roles.velocity < 0) process.refuse_state(state.name, "a velocity");
      if (roles.position_dim == 1) put_straight<1>(source, process);
      if (roles.position_dim == 2) put_straight<2>(source, process);
      if (roles.position_dim == 3) put_straight<3>(source, process);
      break;
    case MotionKind::kCoordinatedTurn:
      if (roles.turn_rate < 0) process.refuse_state(state.name, "a turn rate");
      put(source, process.coordinated_turn());
      break;
    case MotionKind::kPlanarMechanization:
      if (roles.heading < 0 || roles.velocity < 0) process.refuse_state(state.name, "a heading and a velocity");
      put(source, process.planar_mechanization());
      break;
    case MotionKind::kPlanarOdometry:
      if (roles.heading < 0) process.refuse_state(state.name, "a heading");
      put(source, process.planar_odometry());
      break;
  }
  return source;
}

bool smooth_run(std::span<const PaddedRecord> records, int n, double* x, double* P) {
  if (records.empty()) return true;
  RtsSmoother<ErasedState<kMaxCustomDim>> smoother(static_cast<int>(records.size()));
  for (const PaddedRecord& record : records) {
    if (smoother.record(record) != SmoothStatus::kDone) return false;
  }
  if (smoother.smooth() != SmoothStatus::kDone) return false;
  for (const auto& step : smoother.smoothed()) {
    x = std::copy_n(step.state.x.data(), n, x);
    for (int j = 0; j < n; ++j) P = std::copy_n(step.P.col(j).data(), n, P);  // symmetric: rows or columns are alike
  }
  return true;
}

}  // namespace soopnav::python
