#include <type_traits>

#include "kalman_filter.hpp"
#include "soopnav/estimation/extended_kalman_filter.hpp"

namespace soopnav::python {

namespace {

struct Extended {
  template <int N>
  using Filter = ExtendedKalmanFilter<ErasedState<N>>;
  static constexpr bool kSigmaPoints = false;
  static constexpr double kPadding = 1.0;
  static constexpr bool kSmallToo = true;
  template <int N>
  static constexpr bool kFewRows = N == PlanarInertialState::kDim;

  template <int N, class Square>
  static Filter<N> make(const ErasedState<N>& x, const Square& P, const KalmanSetup& /*setup*/) {
    return {x, P};
  }
  template <class AnyFilter>
  static auto matrix(const AnyFilter& filter) {
    return filter.covariance();
  }
  template <class AnyFilter, class State, class Square>
  static void restore(AnyFilter& filter, const State& x, const Square& P) {
    filter.restore(x, P);
  }
  // The inertial mechanisation is worth a loop of its own: thousands of steps between two measurements.
  template <int N, class F>
  requires(N == PlanarInertialState::kDim) static bool with_hot(const AnyProcess& process, const StateInfo& state,
                                                                F&& f) {
    if (state.name != kStateName<PlanarInertialState> || process.motion() != MotionKind::kPlanarMechanization) {
      return false;
    }
    process.check_clock(false, state.name);
    using Process = ComposedProcess<PlanarInertialState, inertial::PlanarMechanization>;
    f(PlacedProcess<PlanarInertialState, Process>{compose<PlanarInertialState>(process,
                                                                               process.planar_mechanization())},
      [](const double* numbers) {
        constexpr std::array<double, 3> kNone{};
        return input_of<Process>(numbers == nullptr ? kNone.data() : numbers);
      });
    return true;
  }
};

}  // namespace

std::unique_ptr<KalmanFilter> make_extended(const KalmanSetup& setup) { return make_kalman<Extended>(setup); }

}  // namespace soopnav::python
