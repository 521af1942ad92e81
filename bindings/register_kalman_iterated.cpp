#include "kalman_filter.hpp"
#include "soopnav/estimation/iterated_kalman_filter.hpp"

namespace soopnav::python {

namespace {

struct Iterated {
  template <int N>
  using Filter = IteratedKalmanFilter<ErasedState<N>>;
  static constexpr bool kSigmaPoints = false;
  static constexpr double kPadding = 1.0;
  static constexpr bool kSmallToo = false;
  template <int N>
  static constexpr bool kFewRows = false;

  template <int N, class Square>
  static Filter<N> make(const ErasedState<N>& x, const Square& P, const KalmanSetup& setup) {
    IterationOptions options;
    options.max_iterations = static_cast<int>(setup.options[0]);
    options.tolerance = setup.options[1];
    return {x, P, options};
  }
  template <class AnyFilter>
  static auto matrix(const AnyFilter& filter) {
    return filter.covariance();
  }
  template <class AnyFilter, class State, class Square>
  static void restore(AnyFilter& filter, const State& x, const Square& P) {
    filter.restore(x, P);
  }
};

}  // namespace

std::unique_ptr<KalmanFilter> make_iterated(const KalmanSetup& setup) { return make_kalman<Iterated>(setup); }

}  // namespace soopnav::python
