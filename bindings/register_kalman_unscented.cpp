#include "kalman_filter.hpp"
#include "soopnav/estimation/unscented_kalman_filter.hpp"

namespace soopnav::python {

namespace {

struct Unscented {
  template <int N>
  using Filter = UnscentedKalmanFilter<ErasedState<N>>;
  static constexpr bool kSigmaPoints = true;
  // Sigma points of a component without variance lie at the mean, and with kappa as below weigh as if in it.
  static constexpr double kPadding = 0.0;
  static constexpr bool kSmallToo = false;
  template <int N>
  static constexpr bool kFewRows = false;

  template <int N, class Square>
  static Filter<N> make(const ErasedState<N>& x, const Square& P, const KalmanSetup& setup) {
    const int n = static_cast<int>(setup.x0.size());
    UnscentedOptions options{.alpha = setup.options[0], .beta = setup.options[1], .kappa = setup.options[2]};
    options.check(n);
    options.kappa += n - N;
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

std::unique_ptr<KalmanFilter> make_unscented(const KalmanSetup& setup) { return make_kalman<Unscented>(setup); }

}  // namespace soopnav::python
