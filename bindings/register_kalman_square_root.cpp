#include "kalman_filter.hpp"
#include "soopnav/estimation/square_root_kalman_filter.hpp"

namespace soopnav::python {

namespace {

struct SquareRoot {
  template <int N>
  using Filter = SquareRootKalmanFilter<ErasedState<N>>;
  static constexpr bool kSigmaPoints = false;
  static constexpr double kPadding = 1.0;
  static constexpr bool kSmallToo = false;
  template <int N>
  static constexpr bool kFewRows = false;

  template <int N, class Square>
  static Filter<N> make(const ErasedState<N>& x, const Square& P, const KalmanSetup& /*setup*/) {
    return {x, P};
  }
  template <class AnyFilter>
  static auto matrix(const AnyFilter& filter) {
    return filter.root();
  }
  template <class AnyFilter, class State, class Square>
  static void restore(AnyFilter& filter, const State& x, const Square& root) {
    filter.restore_root(x, root);
  }
};

}  // namespace

std::unique_ptr<KalmanFilter> make_square_root(const KalmanSetup& setup) { return make_kalman<SquareRoot>(setup); }

}  // namespace soopnav::python
