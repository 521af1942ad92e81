#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "soopnav/clock/clock_noise.hpp"
#include "soopnav/core/status.hpp"
#include "soopnav/navigation/opportunistic_source.hpp"

namespace soopnav::navigation {

class OpportunisticSmoother;

/// What of the receiver's motion is estimated.
enum class OpportunisticMotion : std::uint8_t {
  kKnown,     ///< nothing: it stands at the start's position
  kStatic,    ///< a position that stands, or walks by `position_walk_m2ps`
  kVelocity,  ///< position and velocity under white acceleration (pesyna eq. 9)
};

/// In which shape the covariance is carried. The same numbers; the root keeps them in ill-conditioned runs.
enum class OpportunisticForm : std::uint8_t {
  kSquareRoot,  ///< triangular root: Carlson's update, Givens rotations for noise; never loses its sign
  kJoseph,      ///< Joseph's form on the lower triangle
};

/// What the time of a step is.
enum class TimeTag : std::uint8_t {
  kReceiver,  ///< the receiver's clock reading t_R (pesyna eq. 4): geometry is that of t_R - b / c
  kSystem,    ///< system time: geometry is that of t itself
};

struct OpportunisticOptions {
  OpportunisticMotion motion = OpportunisticMotion::kStatic;
  OpportunisticForm form = OpportunisticForm::kSquareRoot;
  TimeTag time_tag = TimeTag::kReceiver;
  int max_sources = 16;                 ///< 1 ... 1000 present at a time
  int max_observables = 0;              ///< of one step; 0: two for each source
  clock::ClockNoise clock{};            ///< of the receiver
  double position_walk_m2ps = 0.0;      ///< kStatic: random walk of each axis [m²/s]
  double acceleration_psd_m2ps3 = 1.0;  ///< kVelocity: white acceleration of each axis [m²/s³]
  /// Probability at which a good observable is taken for a fault; in (0, 0.1].
  double fault_probability = 1e-7;
  /// A source that contradicts its prediction in more than this share of its recent epochs is suspended; in (0, 1].
  double suspend_share = 0.6;
  double suspend_memory = 20.0;  ///< how many epochs "recent" is; >= 1
};

/// Where a run starts. Covariances positive definite; those of what is not estimated are not read.
struct OpportunisticStart {
  Eigen::Vector3d position_e_m = Eigen::Vector3d::Zero();
  Eigen::Matrix3d position_covariance_m2 = Eigen::Matrix3d::Identity() * 1e4;
  Eigen::Vector3d velocity_e_mps = Eigen::Vector3d::Zero();
  Eigen::Matrix3d velocity_covariance_m2ps2 = Eigen::Matrix3d::Identity();
  double clock_bias_m = 0.0;
  double clock_drift_mps = 0.0;
  Eigen::Matrix2d clock_covariance = (Eigen::Matrix2d() << 9e10, 0.0, 0.0, 9e4).finished();  ///< bias, drift
};

/// Rows of a batch, one epoch after another; columns are the sources of `sources`. Spans are row-major and empty where
/// there is nothing of the kind.
struct OpportunisticBatch {
  std::span<const double> t_s;                  ///< n
  std::span<const int> sources;                 ///< s ids
  std::span<const double> phase_cycles;         ///< n x s, NaN: not observed
  std::span<const double> phase_sigma_cycles;   ///< n x s, or s
  std::span<const double> pseudorange_m;        ///< n x s
  std::span<const double> pseudorange_sigma_m;  ///< n x s, or s
  std::span<const double> phase_correction_m;   ///< n x s
  std::span<const double> range_correction_m;   ///< n x s
  std::span<const double> source_position_e_m;  ///< n x s x 3
  std::span<const double> source_clock_m;       ///< n x s
  bool covariance = false;                      ///< whole covariances are kept, not only standard deviations
};

/// What a batch did. `dim` components as `component_names` says; row-major.
struct OpportunisticRun {
  int dim = 0;
  std::vector<double> mean;                      ///< n x dim
  std::vector<double> sigma;                     ///< n x dim
  std::vector<double> covariance;                ///< n x dim x dim, when asked for
  std::vector<std::uint8_t> phase_use;           ///< n x s, `ObservableUse`
  std::vector<std::uint8_t> pseudorange_use;     ///< n x s
  std::vector<double> phase_innovation_cycles;   ///< n x s
  std::vector<double> pseudorange_innovation_m;  ///< n x s
  std::vector<double> nis;                       ///< n
  std::vector<int> dof;                          ///< n
  std::vector<std::uint8_t> receiver_jump;       ///< n
  std::vector<UpdateStatus> status;              ///< n
};

/// Tightly-coupled opportunistic navigator: one estimator for the receiver and all signals it hears (pesyna eqs. 1 to
/// 11; doc/opportunistic_navigation.md).
///
/// State: receiver position, velocity, clock bias and drift, and of each source what is not known of its position,
/// clock bias and drift, and carrier-phase ambiguity. Sources join and leave at any time; what one leaves behind in the
/// others stays. All observables of a step are linearised together, at the prediction and again at the result while
/// the models bend by more than 0.05 sigma in between, so that their order does not matter.
/// Models, with c * time in metres and lambda = c / carrier:
///   phase       = (|p - R q(t_tx)| + b - b_q(t_tx) + correction) / lambda + gamma   [cycles]
///   pseudorange =  |p - R q(t_tx)| + b - b_q(t_tx) + correction                     [m]
/// with light time solved at the receiver's estimated time, R the Earth's turn during the flight, and the source's
/// clock taken at transmission.
/// Faults: of each step's observables taken together, the single fault that explains most (a slip of one phase, an
/// outlier, a jump of one source's clock, a jump of the receiver's clock) is remedied while it is significant: noise is
/// added to what jumped, an outlier is left out. A source that contradicts too often (one that moves) is suspended.
/// After construction `step` and the other calls marked noexcept do not allocate. Not thread-safe; move-only.
class OpportunisticNavigator {
 public:
  /// @throws std::invalid_argument naming the option, its value and the rule.
  OpportunisticNavigator(const OpportunisticStart& start, const OpportunisticOptions& options);
  OpportunisticNavigator(OpportunisticNavigator&&) noexcept;
  OpportunisticNavigator& operator=(OpportunisticNavigator&&) noexcept;
  ~OpportunisticNavigator();

  /// Lets a source join, its prior at the time of the last step. Returns its id, >= 0, never used again.
  /// @throws std::invalid_argument for numbers out of range, a name that is present already, or no room.
  int add_source(const OpportunisticSource& source);
  /// Marginalises a source away. False for an id that is not present.
  bool remove_source(int source) noexcept;
  /// Ids of the sources present, in the order of their joining. Allocates.
  [[nodiscard]] std::vector<int> sources() const;
  /// -1 when there is none of that name.
  [[nodiscard]] int find_source(std::string_view name) const noexcept;
  /// None for an id that is not present.
  [[nodiscard]] std::optional<OpportunisticSourceState> source(int source) const noexcept;

  /// Moves to `t_s` and uses what was observed then. The first step moves nothing. `t_s` equal to the last step's is
  /// kTimeNotAdvancing, as is an earlier one; one more than 1e9 s later, or none at all, is kNonFinite. Nothing has
  /// changed then.
  OpportunisticReport step(double t_s, std::span<const OpportunisticObservation> observed) noexcept;
  /// One report for each observable of the last step.
  [[nodiscard]] std::span<const ObservableReport> reports() const noexcept;

  /// What an observable of a present source should be at the present state, as if it were of `t_s`, and its derivatives
  /// by the `dim()` components. False, nothing written, for a source that is not present, a model without a value here,
  /// or a row of another size.
  [[nodiscard]] bool expected(double t_s, const OpportunisticObservation& observed, double& value,
                              std::span<double> jacobian) const noexcept;

  /// Runs `step` over a batch; records for a smoother when `record`. NaN values are kMissing, and are not given to the
  /// filter. Allocates its result. @throws std::invalid_argument for sizes that do not fit.
  [[nodiscard]] OpportunisticRun run(const OpportunisticBatch& batch, bool record = false);

  /// Opens the ambiguity of a source again, as after a loss of lock: adds `sigma_cycles`² to its variance (pesyna eq.
  /// 6's eta is an ambiguity of each burst: open it by M-th cycles at each). False when it is not estimated.
  bool open_ambiguity(int source, double sigma_cycles) noexcept;
  /// Adds noise to the clock of a source, or of the receiver (`source` = -1), after an announced jump. False when it is
  /// not estimated, or a number is negative or not finite.
  bool open_clock(int source, double bias_sigma_m, double drift_sigma_mps) noexcept;
  /// Replaces the noise of a source's clock, or of the receiver's (`source` = -1), from the next step on.
  bool set_clock_noise(int source, const clock::ClockNoise& noise) noexcept;
  /// Listens to a suspended source again. False when it was not suspended.
  bool readmit(int source) noexcept;

  [[nodiscard]] bool started() const noexcept;
  [[nodiscard]] double t_s() const noexcept;  ///< of the last step; NaN before the first
  [[nodiscard]] int dim() const noexcept;
  /// Components: "velocity x" ..., "position x" ..., "clock drift", "clock bias" of the receiver (in this order, those
  /// that are estimated), then of each source "<name> position x" ..., "<name> clock drift", "<name> clock bias",
  /// "<name> ambiguity". Metres, m/s, cycles. Allocates.
  [[nodiscard]] std::vector<std::string> component_names() const;
  [[nodiscard]] Eigen::VectorXd mean() const;        ///< allocates
  [[nodiscard]] Eigen::MatrixXd covariance() const;  ///< symmetric to the bit; allocates
  [[nodiscard]] Eigen::Vector3d position_e_m() const noexcept;
  [[nodiscard]] Eigen::Matrix3d position_covariance_m2() const noexcept;
  [[nodiscard]] Eigen::Vector3d velocity_e_mps() const noexcept;
  [[nodiscard]] double clock_bias_m() const noexcept;
  [[nodiscard]] double clock_drift_mps() const noexcept;
  [[nodiscard]] Eigen::Matrix2d clock_covariance() const noexcept;  ///< bias, drift

  /// Directions of the state that the observables of the last `epochs` steps (at most 64) say nothing of, in words:
  /// "clock bias", "0.71 clock bias + 0.71 A ambiguity". Ambiguities count in metres there. From the whitened rows,
  /// moved to now without noise; `tolerance`: a direction whose information is below so much of the largest, after
  /// scaling each component to its own. Allocates.
  [[nodiscard]] std::vector<std::string> unobservable(int epochs = 32, double tolerance = 1e-13) const;

  /// Reserves room for the records of `epochs` steps at the full size of the state and begins recording; what was
  /// recorded is dropped. Steps beyond are not recorded. Allocates.
  void start_recording(int epochs);
  [[nodiscard]] int recorded() const noexcept;
  /// The Rauch-Tung-Striebel smoother over what was recorded. @throws std::invalid_argument when nothing was, and
  /// std::runtime_error when the records are not finite.
  [[nodiscard]] OpportunisticSmoother smooth(bool with_gains = false) const;

 private:
  friend class OpportunisticSmoother;
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace soopnav::navigation
