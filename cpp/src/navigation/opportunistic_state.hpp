#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

#include "navigation/opportunistic_filter.hpp"
#include "soopnav/core/constants.hpp"
#include "soopnav/core/role.hpp"
#include "soopnav/estimation/state_layout.hpp"
#include "soopnav/navigation/opportunistic_navigator.hpp"

/// What an `OpportunisticNavigator` is made of. Private to its source files and its tests.
namespace soopnav::navigation {

namespace detail {

inline constexpr int kMaxNameLength = 20;
inline constexpr int kObservedEpochs = 64;  // that observability looks back on

/// What component `place` of the state is, for ever: the source it belongs to (-1: the receiver) and its part there.
struct Member {
  int uid = -1;     ///< counts the components that ever joined
  int source = -1;  ///< id
  int part = 0;     ///< receiver: 0-2 velocity, 3-5 position; source: 3-5 position; both: 6 drift, 7 bias; 8 ambiguity
};

/// A transition x_to += dt x_from with noise on both: what is recorded of a prediction.
struct RatePair {
  int from = 0, to = 0;
  double rate = 0.0, cross = 0.0, value = 0.0;  ///< noise [[rate, cross], [cross, value]]
};
struct PlaceNoise {
  int place = 0;
  double variance = 0.0;
  double shift = 0.0;  ///< added to the mean besides
};

/// A source that is present.
struct Slot {
  bool present = false;
  int id = -1;
  std::array<char, kMaxNameLength + 1> name{};
  double wavelength_m = 1.0;
  OpportunisticSource given;  // its name is not kept
  geometry::SampledOrbit rest;
  bool has_rest = false;
  Block<3> position;
  Block<2> clock;  // drift, bias
  Block<1> ambiguity;
  bool fresh = true;  // the ambiguity was not observed since it was opened
  int serial = 0;     // grows when a part of it is opened again
  bool jumped = false, jumped_before = false, suspended = false;
  bool contradicted = false, observed = false;  // in this step
  double slip_rate = 0.0;
  int slips = 0, jumps = 0;
  Slot() : rest(geometry::SampledOrbit::fixed(Eigen::Vector3d::Zero())) {}
};

/// An observable that is used in a step.
struct Row {
  std::size_t report = 0;  // its place among the observations
  int slot = 0;
  ObservableKind kind = ObservableKind::kPhase;
  bool tested = true;
};

/// A whitened row of a past step, for observability.
struct PastRow {
  int count = 0;
  int source = -1;
  int serial = 0;
  std::array<int, TouchedRow::kMax> uid{};
  std::array<double, TouchedRow::kMax> value{};
};

/// Steps as a smoother needs them, in memory that is reserved once.
class Recorder {
 public:
  struct Step {
    bool leave = false;  // a snapshot before a component left, not a step
    double t_s = 0.0;
    double dt_s = 0.0;  // 0: nothing led here
    int n = 0;
    std::size_t members = 0, pairs = 0, noises = 0;
    int pair_count = 0, noise_count = 0;
    std::size_t predicted = 0, filtered = 0, matrix = 0;  // matrix: packed lower P_pred or its root; leave: P
  };
  Recorder() = default;
  void reserve(int epochs, int max_dim, int max_pairs, int max_noises);
  [[nodiscard]] bool active() const noexcept { return active_; }
  [[nodiscard]] int steps() const noexcept { return count_; }
  void stop() noexcept { active_ = false; }
  /// Begins a step; false, and recording stops, when there is no room.
  bool begin(double t_s, double dt_s, std::span<const Member> members) noexcept;
  void predicted(const OpportunisticFilter& filter, std::span<const RatePair> pairs,
                 std::span<const PlaceNoise> noises) noexcept;
  void filtered(const OpportunisticFilter& filter) noexcept;
  void leaving(double t_s, std::span<const Member> members, const OpportunisticFilter& filter) noexcept;

  [[nodiscard]] std::span<const Step> all() const noexcept { return steps_; }
  [[nodiscard]] const double* number(std::size_t at) const noexcept { return numbers_.data() + at; }
  [[nodiscard]] const Member* member(std::size_t at) const noexcept { return members_.data() + at; }
  [[nodiscard]] const RatePair* pair(std::size_t at) const noexcept { return pairs_.data() + at; }
  [[nodiscard]] const PlaceNoise* noise(std::size_t at) const noexcept { return noises_.data() + at; }
  /// P of the last recorded step after its update, column-major.
  [[nodiscard]] const double* last() const noexcept { return last_.data(); }

 private:
  void pack(const OpportunisticFilter& filter) noexcept;
  bool active_ = false;
  int count_ = 0;
  int capacity_ = 0;
  std::vector<Step> steps_;
  std::vector<double> numbers_;
  std::vector<Member> members_;
  std::vector<RatePair> pairs_;
  std::vector<PlaceNoise> noises_;
  std::vector<double> last_;
};

}  // namespace detail

struct OpportunisticNavigator::Impl {
  Impl(const OpportunisticStart& start, const OpportunisticOptions& options);

  OpportunisticOptions options;
  Eigen::Vector3d known_position;
  Eigen::Matrix3d position_P = Eigen::Matrix3d::Zero();  // the receiver's at the prediction
  detail::OpportunisticFilter filter;
  StateLayout layout;
  std::vector<detail::Member> members;  // of each component present
  std::vector<detail::Slot> slots;
  std::vector<int> order;          // slots of the sources present, in the order of joining
  std::vector<std::string> names;  // of every component that ever joined, by uid
  std::vector<int> owners;         // source of each
  int next_id = 0, next_uid = 0;
  double t_s = std::numeric_limits<double>::quiet_NaN();
  int velocity_at = -1, position_at = -1, drift_at = 0, bias_at = 1;  // places in the state
  bool receiver_jumped = false;
  std::vector<detail::PlaceNoise> pending;  // place: uid. Noise that the next step adds
  double threshold = 0.0;

  // Of a step.
  std::vector<detail::Row> rows;
  std::vector<detail::TouchedRow> touched, used_touched, next_touched;
  std::vector<double> innovation, variance, used_innovation, used_variance, next_innovation;
  std::vector<std::size_t> tested;  // rows that are
  std::vector<unsigned char> used;
  std::vector<ObservableReport> reports;
  std::size_t reported = 0;
  std::vector<detail::RatePair> pairs;
  std::vector<detail::PlaceNoise> noises;
  detail::AlignedDoubles S, inverse, whitened, start_x;
  int S_stride = 0;

  // What was observed, for observability.
  std::vector<detail::PastRow> past;  // kObservedEpochs x max_observables
  std::array<int, detail::kObservedEpochs> past_count{};
  std::array<double, detail::kObservedEpochs> past_t{};
  int past_head = 0, past_epochs = 0;

  detail::Recorder recorder;
  std::vector<OpportunisticObservation> batch;

  [[nodiscard]] int slot_of(int id) const noexcept;
  [[nodiscard]] std::size_t max_rows() const noexcept { return reports.size(); }

  void predict(double dt_s) noexcept;
  // Model, Jacobian and innovation of one observable; false: `report.use` says why not.
  bool build(const OpportunisticObservation& o, double at_s, std::size_t number, ObservableReport& report) noexcept;
  // Noise on a component from outside a step; and in one.
  void ask(int place, double variance) noexcept;
  void open(int place, double variance, double shift) noexcept;
  bool model(const OpportunisticObservation& o, const detail::Slot& slot, double at_s, detail::TouchedRow& row,
             double& predicted) const noexcept;
  void use_all(double at_s, std::span<const OpportunisticObservation> observed) noexcept;
  // Finds and remedies faults; returns what was done in `report`.
  void judge(double dt_s, OpportunisticReport& report) noexcept;
  // The first phases of open ambiguities, each by itself.
  void judge_fresh(OpportunisticReport& report) noexcept;
  bool test(OpportunisticReport& report, bool final_pass) noexcept;
  double bend(const detail::Slot& slot, const detail::TouchedRow& row) const noexcept;
  void loosen() noexcept;
  void remember(double at_s) noexcept;
  OpportunisticReport step(double at_s, std::span<const OpportunisticObservation> observed) noexcept;
};

}  // namespace soopnav::navigation
